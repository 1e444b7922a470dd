//! Jackknife standard deviations.

/// Jackknife standard deviation (Tukey 1958) from leave-one-out values.
///
/// Each value omits one of as many equal parts of the recording, so that changes along the
/// recording count as well as chance.
pub(crate) fn jackknife_sd(without_one: &[f64]) -> f64 {
    let n = without_one.len().max(1) as f64;
    let mean = without_one.iter().sum::<f64>() / n;
    ((n - 1.0) / n * without_one.iter().map(|value| (value - mean).powi(2)).sum::<f64>()).sqrt()
}

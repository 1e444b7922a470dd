//! Outlier-resistant means.

/// Tukey's biweight: zero weight beyond this many standard deviations; 95 % efficient for normal
/// values.
const BIWEIGHT_SD: f64 = 4.685;
/// Standard deviation of a normal distribution over its median absolute deviation.
const SD_OF_MEDIAN: f64 = 1.4826;
const ROUNDS: usize = 10;

/// Weighted mean of `(value, weight)` by Tukey's biweight, and its standard deviation.
///
/// Starts at the weighted median. Weights are proportional to inverse variances; the standard
/// deviation comes from the scatter of the values. NaN without values.
pub(super) fn robust_mean(values: impl Iterator<Item = (f64, f64)>) -> (f64, f64) {
    let mut values: Vec<(f64, f64)> = values.filter(|(x, w)| x.is_finite() && *w > 0.0).collect();
    values.sort_by(|a, b| a.0.total_cmp(&b.0));
    let Some(mut mean) = weighted_median(&values) else { return (f64::NAN, f64::NAN) };
    let mut sd = 0.0;
    for _ in 0..ROUNDS {
        let mut scores: Vec<f64> = values.iter().map(|(x, w)| (x - mean).abs() * w.sqrt()).collect();
        let middle = scores.len() / 2;
        let scale = SD_OF_MEDIAN * *scores.select_nth_unstable_by(middle, f64::total_cmp).1;
        // At least half of the values equal the mean.
        if scale == 0.0 {
            return (mean, 0.0);
        }
        let (mut sum, mut weights, mut square) = (0.0, 0.0, 0.0);
        for &(x, w) in &values {
            let score = (x - mean) * w.sqrt() / (BIWEIGHT_SD * scale);
            if score.abs() < 1.0 {
                let weight = w * (1.0 - score * score).powi(2);
                sum += weight * (x - mean);
                weights += weight;
                square += (weight * (x - mean)).powi(2);
            }
        }
        mean += sum / weights;
        sd = square.sqrt() / weights;
    }
    (mean, sd)
}

/// Weighted median of ascending values.
fn weighted_median(values: &[(f64, f64)]) -> Option<f64> {
    let half = 0.5 * values.iter().map(|(_, weight)| weight).sum::<f64>();
    let mut sum = 0.0;
    values
        .iter()
        .find(|(_, weight)| {
            sum += weight;
            sum >= half
        })
        .map(|(value, _)| *value)
}

/// Isotonic regression of `(value, standard deviation)`: decreasing neighbours are pooled.
pub(super) fn pooled(values: &[(f64, f64)]) -> Vec<f64> {
    let mut runs: Vec<(f64, f64, usize)> = Vec::new();
    for &(value, sd) in values {
        let mut run = (value, 1.0 / (sd * sd).max(1e-12), 1);
        while let Some(last) = runs.last().filter(|last| last.0 > run.0).copied() {
            runs.pop();
            let weight = last.1 + run.1;
            run = ((last.0 * last.1 + run.0 * run.1) / weight, weight, last.2 + run.2);
        }
        runs.push(run);
    }
    runs.into_iter().flat_map(|(value, _, count)| std::iter::repeat_n(value, count)).collect()
}

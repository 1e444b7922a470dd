//! Equations of triples of single echoes.

use nalgebra::DVector;

/// Tukey's biweight is zero beyond this many standard deviations.
pub(super) const REACH_SD: f64 = 4.0;

/// Equation of one triple.
pub(super) struct AmplitudeRow {
    pub shot: u64,
    /// Stretch of the recording.
    pub stretch: usize,
    /// Second difference of the times of flight beyond the prior walk, ns, and its SD by noise.
    pub difference_ns: f64,
    pub noise_ns: f64,
    /// Logarithms of the amplitudes over the reference.
    pub ln_amplitudes: [f64; 3],
    /// Nodes on both sides of each amplitude, and their factors in the second difference.
    pub terms: [(usize, f64); 6],
}

impl AmplitudeRow {
    /// Second difference of a walk's delays, ns.
    pub fn walk_ns(&self, coefficients_ns: &DVector<f64>) -> f64 {
        self.terms.iter().map(|&(node, factor)| factor * coefficients_ns[node]).sum()
    }
}

/// Tukey's biweight of a residual over its SD, divided by the variance.
pub(super) fn weight(residual_ns: f64, sd_ns: f64) -> f64 {
    let u = residual_ns / (REACH_SD * sd_ns);
    if sd_ns.is_finite() && u.abs() < 1.0 { ((1.0 - u * u) / sd_ns).powi(2) } else { 0.0 }
}

/// Difference of the largest and smallest logarithm of the amplitudes.
pub(super) fn spread_ln(row: &AmplitudeRow) -> f64 {
    let [a, b, c] = row.ln_amplitudes;
    a.max(b).max(c) - a.min(b).min(c)
}

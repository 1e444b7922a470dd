//! Pulse acceptance thresholds shared by the scalar and the SIMD kernels.

pub(crate) mod response_error;

/// Distance after a stronger pulse, in widths, beyond which its filter response is subtracted from a
/// candidate's statistic.
pub(crate) const TOLD_WIDTHS: f64 = 1.5;
/// Start of a pulse before its peak, in its widths (8 ns for 4.25).
pub(crate) const BEGINS_WIDTHS: f64 = 1.9;
/// Distance in widths below which pulses are fitted jointly.
pub(crate) const CLUSTER_WIDTHS: f64 = 3.0;
/// Minimum separation of two pulses, in calibrated widths; at least one sample.
pub(crate) const LEAST_SEPARATION_WIDTHS: f64 = 0.25;
/// Smallest decrease of chi-square by an added pulse, relative to the squared threshold.
pub(crate) const GAIN_PART: f64 = 0.8;
/// Smallest maximum of the filtered residual for which a pulse is tried, relative to the threshold.
pub(crate) const TRIAL_PART: f64 = 0.75;
/// Width ratio above which a pulse may hide two.
pub(crate) const HIDING_WIDTH_RATIO: f64 = 1.04;
/// Initial energy fractions of the first half of a split pulse.
pub(crate) const DIVIDED_PARTS: [f64; 3] = [0.5, 0.8, 0.2];
/// Background above which samples of 0 are excluded, in standard deviations of the noise: they are
/// caused by the undershoot of a strong pulse.
pub(crate) const CLEAR_OF_ZERO_SD: f64 = 5.0;

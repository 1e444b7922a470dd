//! What decides over pulses, once for the plain and the fast kernels: they must not differ in it.

/// Standard deviation of a Gaussian over its full width at half maximum.
pub(super) const SD_OF_FWHM: f64 = 0.424_660_900_144_009_5;
/// Two maxima are two candidates only with a dip between them that is this part of the threshold deep: what noise makes on
/// the back of one wide pulse is one candidate.
pub(super) const DIP_PART: f64 = 0.5;
/// How far behind a pulse its echo in the filter is told, samples.
pub(super) const ECHO_SAMPLES: usize = 256;
/// What is seen of a candidate's strength is told from what stronger ones leave there from so many widths on.
pub(super) const TOLD_WIDTHS: f64 = 1.5;
/// A pulse begins so many of its widths before its peak (8 ns of 4.25).
pub(super) const BEGINS_WIDTHS: f64 = 1.9;
/// Pulses nearer than so many of their widths are fitted jointly and bear on each other.
pub(super) const CLUSTER_WIDTHS: f64 = 3.0;
/// Nearer than so many calibrated widths, and in any case than one sample, two pulses are one.
pub(super) const LEAST_SEPARATION_WIDTHS: f64 = 0.25;
/// A pulse is added when it lowers chi-square by this part of the threshold's square.
pub(super) const GAIN_PART: f64 = 0.8;
/// Maxima of the filtered residual from this part of the threshold on are worth a trial.
pub(super) const TRIAL_PART: f64 = 0.75;
/// A pulse wider than this times the calibrated width may hide two.
pub(super) const HIDING_WIDTH_RATIO: f64 = 1.04;
/// Parts of the energy that the first of two pulses starts with, where a widened one is divided.
pub(super) const DIVIDED_PARTS: [f64; 3] = [0.5, 0.8, 0.2];
/// A sample of 0 is cut off where the background stands so many standard deviations of the noise above that: it is what
/// the undershoot of a strong pulse leaves.
pub(super) const CLEAR_OF_ZERO_SD: f64 = 5.0;

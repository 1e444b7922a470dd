//! One pulse: its parameters, and its values as a Gaussian.

use std::ops::Range;

/// `4 ln 2`: a Gaussian of full width `W` at half maximum is `exp(-4 ln 2 (x/W)²)`.
pub(crate) const FOUR_LN_2: f64 = 2.772_588_722_239_781;
/// Half extent of a pulse, in widths.
///
/// Beyond it a pulse is zero in double precision (`exp(-4 ln 2 · 3.65²) = 1e-16`).
const SUPPORT_WIDTHS: f64 = 3.65;
/// Bounds of the log width ratio; a fit outside them is not meaningful.
pub(crate) const LN_WIDTH_BOUNDS: [f64; 2] = [-1.5, 3.2];
/// Standard deviation of a Gaussian over its full width at half maximum.
pub(crate) const SD_OF_FWHM: f64 = 0.424_660_900_144_009_5;

/// Subset of the samples of a block.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Lane {
    All,
    Even,
    Odd,
}

impl Lane {
    /// First sample of the lane at or after `first`.
    pub(crate) fn from(self, first: usize) -> usize {
        match self {
            Lane::All => first,
            Lane::Even => first + first % 2,
            Lane::Odd => first + (first + 1) % 2,
        }
    }

    /// Distance of consecutive samples of the lane.
    pub(crate) fn step(self) -> usize {
        if self == Lane::All { 1 } else { 2 }
    }
}

/// One pulse.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pulse {
    /// Height of the peak above the background, DN.
    pub height_dn: f64,
    /// Position of the peak, samples from the block's first.
    pub position_samples: f64,
    /// Logarithm of the width over the calibrated width.
    pub ln_width_ratio: f64,
    /// Precision `1/s²` of the prior on `ln_width_ratio` about 0; 0 for no prior.
    pub ln_width_precision: f64,
}

impl Pulse {
    /// Adds `sign` times the pulse as a Gaussian to the samples of a lane.
    ///
    /// `fwhm_samples` is the calibrated width.
    pub(crate) fn add_lane_to(&self, fwhm_samples: f64, sign: f64, lane: Lane, values: &mut [f64]) {
        let width = fwhm_samples * self.ln_width_ratio.exp();
        let (first, end) = support(self.position_samples, width, values.len());
        for (k, value) in values.iter_mut().enumerate().take(end).skip(lane.from(first)).step_by(lane.step())
        {
            let x = (k as f64 - self.position_samples) / width;
            *value += sign * self.height_dn * (-FOUR_LN_2 * x * x).exp();
        }
    }

    /// Writes the Gaussian's derivatives by height, position and log width to columns of block
    /// length.
    ///
    /// Returns the samples that can differ from zero.
    pub(crate) fn add_derivatives_to(
        &self,
        fwhm_samples: f64,
        lane: Lane,
        columns: [&mut [f64]; 3],
    ) -> Range<usize> {
        let [by_height, by_position, by_width] = columns;
        let width = fwhm_samples * self.ln_width_ratio.exp();
        let (first, end) = support(self.position_samples, width, by_height.len());
        for k in (lane.from(first)..end).step_by(lane.step()) {
            let x = (k as f64 - self.position_samples) / width;
            let shape = (-FOUR_LN_2 * x * x).exp();
            let slope = 2.0 * FOUR_LN_2 * x * self.height_dn * shape;
            by_height[k] = shape;
            by_position[k] = slope / width;
            by_width[k] = slope * x;
        }
        first..end.max(first)
    }
}

/// Range `first..end` of samples in which a pulse is not zero.
fn support(position: f64, width: f64, samples: usize) -> (usize, usize) {
    let reach = SUPPORT_WIDTHS * width;
    let first = (position - reach).ceil().max(0.0) as usize;
    let end = ((position + reach).floor() + 1.0).max(0.0) as usize;
    (first.min(samples), end.min(samples))
}

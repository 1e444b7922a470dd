//! Typical parameters of the outgoing pulses of a scan line.

use super::Outgoing;
use crate::decompose::Return;

/// Threshold of the summed squares of positive height and width scores; exceeded by 0.1 % of clean
/// pulses.
const UNUSUAL: f64 = 12.0;
/// Threshold above which the pulse may contain an undetected echo; exceeded by 10 % of clean
/// pulses.
const DOUBTFUL: f64 = 3.0;
/// Spreads above the median deviation ratio that make a pulse unusual.
pub(super) const UNUSUAL_DEVIATION: f64 = 5.0;
/// Displacement by an undetected echo, in widths, per relative increase of the height.
const MOVE_BY_HEIGHT: f64 = 0.35;
/// The same per relative increase of the width.
const MOVE_BY_WIDTH: f64 = 0.6;
/// Smallest spread of the logarithms of heights and widths.
const LEAST_SPREAD: f64 = 1e-3;
/// Smallest SD of the position prior, samples: emissions are uniform within a sample.
const LEAST_PLACE_SD: f64 = 0.3;

/// A block with an outgoing pulse.
#[derive(Debug, Clone, Copy)]
pub struct ReferenceBlock<'a> {
    /// The block's samples.
    pub samples: &'a [u16],
    /// Time of the block's first sample after the shot's clock, samples.
    pub start_samples: f64,
}

/// Median and spread of a quantity.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Spread {
    pub(super) median: f64,
    /// Standard deviation of the fitted values.
    pub(super) sd: f64,
    /// Standard deviation of the pulses themselves, without fit errors.
    pub(super) true_sd: f64,
}

impl Spread {
    /// Number of spreads above the median; 0 below it.
    fn score(&self, value: f64) -> f64 {
        ((value - self.median) / self.sd).max(0.0)
    }
}

/// Typical parameters of the outgoing pulses of a scan line.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Usual {
    pub(super) ln_height: Spread,
    pub(super) ln_width: Spread,
    deviation: Spread,
    /// Position after the shot's clock, samples.
    pub(super) place: Spread,
    /// Residual variance of typical fits over the noise variance; at least 1.
    pub(super) noise_factor: f64,
}

impl Usual {
    pub(super) fn of(fitted: &[(&ReferenceBlock<'_>, &Outgoing)]) -> Usual {
        let lower = |value: &dyn Fn(&Return) -> (f64, f64)| {
            // Echoes make pulses higher and wider, so the spread of clean pulses is that of the
            // lower half.
            let [low, median, _] = percentiles(fitted.iter().map(|(_, o)| value(&o.pulse).0));
            let error = percentiles(fitted.iter().map(|(_, o)| value(&o.pulse).1))[1];
            let sd = (median - low).max(LEAST_SPREAD);
            Spread { median, sd, true_sd: (sd * sd - error * error).max(0.04 * sd * sd).sqrt() }
        };
        let [_, median, high] = percentiles(fitted.iter().map(|(_, o)| o.pulse.deviation_ratio));
        let deviation = Spread { median, sd: (high - median).max(1.0), true_sd: 0.0 };
        let places = fitted.iter().map(|(block, o)| block.start_samples + o.pulse.position_samples);
        let [low, middle, high] = percentiles(places);
        let sd = 0.5 * (high - low);
        Usual {
            ln_height: lower(&|p| (p.amplitude_dn.ln(), p.amplitude_sd_dn / p.amplitude_dn)),
            ln_width: lower(&|p| (p.width_ratio.ln(), p.width_ratio_sd / p.width_ratio)),
            deviation,
            place: Spread { median: middle, sd, true_sd: sd.max(LEAST_PLACE_SD) },
            noise_factor: 1.0,
        }
    }

    /// Sum of the squared positive scores in height and width.
    fn squares(&self, pulse: &Return) -> f64 {
        let height = self.ln_height.score(pulse.amplitude_dn.ln());
        let width = self.ln_width.score(pulse.width_ratio.ln());
        height * height + width * width
    }

    pub(super) fn is_unusual(&self, pulse: &Return, place: f64) -> bool {
        self.squares(pulse) > UNUSUAL
            || self.deviation.score(pulse.deviation_ratio) > UNUSUAL_DEVIATION
            || self.is_displaced(place)
    }

    /// Standard deviation of the displacement by an undetected echo, samples.
    pub(super) fn unseen_move_sd(&self, pulse: &Return, fwhm_samples: f64) -> f64 {
        let doubt = ((self.squares(pulse) - DOUBTFUL) / (UNUSUAL - DOUBTFUL)).clamp(0.0, 1.0);
        let height = (pulse.amplitude_dn.ln() - self.ln_height.median).max(0.0);
        let width = (pulse.width_ratio.ln() - self.ln_width.median).max(0.0);
        doubt.sqrt() * fwhm_samples * (MOVE_BY_HEIGHT * height + MOVE_BY_WIDTH * width)
    }

    pub(super) fn is_displaced(&self, place: f64) -> bool {
        (place - self.place.median).abs() > (5.0 * self.place.sd).max(1.5)
    }

    /// Whether the position in the block is predictable to one sample.
    pub(super) fn knows_place(&self) -> bool {
        self.place.sd < 1.0
    }
}

/// Percentiles 15.87, 50 and 84.13 (median ± 1 SD of a normal distribution); NaN without values.
pub(super) fn percentiles(values: impl Iterator<Item = f64>) -> [f64; 3] {
    let mut values: Vec<f64> = values.filter(|value| value.is_finite()).collect();
    let Some(last) = values.len().checked_sub(1) else { return [f64::NAN; 3] };
    [0.1587, 0.5, 0.8413].map(|part| {
        let index = (part * last as f64).round() as usize;
        *values.select_nth_unstable_by(index, f64::total_cmp).1
    })
}

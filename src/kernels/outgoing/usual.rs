//! What the outgoing pulses of a scan line have in common.

use super::Outgoing;
use crate::kernels::decompose::Return;

/// A pulse is unusual where the squares of its positive scores in height and width exceed this: 0.1 % of clean pulses.
const UNUSUAL: f64 = 12.0;
/// From this on the pulse may hold an unseen echo: 10 % of clean pulses.
const DOUBTFUL: f64 = 3.0;
/// A pulse is unusual where its deviation ratio is this many spreads above the median.
pub(super) const UNUSUAL_DEVIATION: f64 = 5.0;
/// An unseen echo that raises the pulse by a part of its height moves it by about that part of so many widths.
const MOVE_BY_HEIGHT: f64 = 0.35;
/// The same for a part of its width.
const MOVE_BY_WIDTH: f64 = 0.6;
/// Least spread of logarithms of heights and widths.
const LEAST_SPREAD: f64 = 1e-3;
/// Least standard deviation of the prior on the place, samples: emissions are uniform within a sample.
const LEAST_PLACE_SD: f64 = 0.3;

/// A block with an outgoing pulse.
#[derive(Debug, Clone, Copy)]
pub struct ReferenceBlock<'a> {
    /// The block's samples.
    pub samples: &'a [u16],
    /// The block's first sample after the shot's clock, samples.
    pub start_samples: f64,
}

/// A quantity's usual value and its spread.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Spread {
    pub(super) median: f64,
    /// Of fitted values.
    pub(super) sd: f64,
    /// Of the pulses themselves, without the error of the fits.
    pub(super) true_sd: f64,
}

impl Spread {
    /// How many spreads a value lies above the median; 0 below.
    fn score(&self, value: f64) -> f64 {
        ((value - self.median) / self.sd).max(0.0)
    }
}

/// What the outgoing pulses of a scan line have in common.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Usual {
    pub(super) ln_height: Spread,
    pub(super) ln_width: Spread,
    deviation: Spread,
    /// After the shot's clock, samples.
    pub(super) place: Spread,
    /// What usual fits leave, over the variance of the noise; at least 1.
    pub(super) noise_factor: f64,
}

impl Usual {
    pub(super) fn of(fitted: &[(&ReferenceBlock<'_>, &Outgoing)]) -> Usual {
        let lower = |value: &dyn Fn(&Return) -> (f64, f64)| {
            // Echoes make pulses higher and wider, so the spread of clean ones is that of the lower half.
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

    /// Squares of the pulse's positive scores in height and width.
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

    /// Standard deviation of the move by an echo too weak to be seen, samples.
    pub(super) fn unseen_move_sd(&self, pulse: &Return, fwhm_samples: f64) -> f64 {
        let doubt = ((self.squares(pulse) - DOUBTFUL) / (UNUSUAL - DOUBTFUL)).clamp(0.0, 1.0);
        let height = (pulse.amplitude_dn.ln() - self.ln_height.median).max(0.0);
        let width = (pulse.width_ratio.ln() - self.ln_width.median).max(0.0);
        doubt.sqrt() * fwhm_samples * (MOVE_BY_HEIGHT * height + MOVE_BY_WIDTH * width)
    }

    pub(super) fn is_displaced(&self, place: f64) -> bool {
        (place - self.place.median).abs() > (5.0 * self.place.sd).max(1.5)
    }

    /// Whether the place of the pulse in its block is known to a sample beforehand.
    pub(super) fn knows_place(&self) -> bool {
        self.place.sd < 1.0
    }
}

/// The percentiles of one standard deviation below the median, the median, and one above; NaN without values.
pub(super) fn percentiles(values: impl Iterator<Item = f64>) -> [f64; 3] {
    let mut values: Vec<f64> = values.filter(|value| value.is_finite()).collect();
    let Some(last) = values.len().checked_sub(1) else { return [f64::NAN; 3] };
    [0.1587, 0.5, 0.8413].map(|part| {
        let index = (part * last as f64).round() as usize;
        *values.select_nth_unstable_by(index, f64::total_cmp).1
    })
}

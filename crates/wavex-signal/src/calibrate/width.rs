//! Pulse width for a flat target: the narrow end of the observed widths.

/// Fewest single pulses for a mode.
const MIN_PULSES: usize = 10;
/// Fraction of the worst-fitting pulses that is omitted.
const WORST_PART: f64 = 0.1;
/// Half width of the averaging window about the mode, in standard deviations of one measured width,
/// and its minimum.
const WINDOW_SD: f64 = 1.5;
const LEAST_WINDOW: f64 = 0.015;
/// SD of the mode of a normal distribution, times the root of the count in the window, in its SD.
///
/// The mode is the mean of the window of 1.5 standard deviations about itself: `√0.552/(1 -
/// 0.448)`, with 0.552 the variance of the values in the window and 0.448 the fraction of a shift
/// of the window that its mean follows.
const SPREAD_OF_MODE: f64 = 1.346;
/// Fewest values of a mode, absolute and relative to the fullest window; smaller maxima may be due
/// to chance.
const LEAST_IN_MODE: usize = 30;
const LEAST_PART_OF_MODE: f64 = 0.1;

/// Width of one single pulse.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Width {
    /// Logarithm of the width, in ns or as a ratio.
    pub(crate) ln_width: f64,
    /// Its standard deviation.
    pub(crate) sd: f64,
    /// Deviation ratio of its fit.
    pub(crate) deviation_ratio: f64,
}

/// Selects well-fitted pulses near the narrowest mode of the widths: those not widened by the
/// target.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Narrow {
    worst_deviation_ratio: f64,
    ln_width: f64,
    half_window: f64,
}

impl Narrow {
    /// Finds the narrowest mode; `times_least_window` enlarges the smallest window.
    pub(crate) fn of(pulses: &[Width], times_least_window: f64) -> Narrow {
        let mut deviations: Vec<f64> = pulses.iter().map(|pulse| pulse.deviation_ratio).collect();
        deviations.sort_by(f64::total_cmp);
        let fitting = deviations.len() - (deviations.len() as f64 * WORST_PART) as usize;
        let worst_deviation_ratio = deviations[..fitting].last().copied().unwrap_or(f64::INFINITY);
        let fitting = || pulses.iter().filter(|pulse| pulse.deviation_ratio <= worst_deviation_ratio);
        let mut sds: Vec<f64> = fitting().map(|pulse| pulse.sd).collect();
        sds.sort_by(f64::total_cmp);
        let mut ln_widths: Vec<f64> = fitting().map(|pulse| pulse.ln_width).collect();
        ln_widths.sort_by(f64::total_cmp);
        let sd = sds.get(sds.len() / 2).copied().unwrap_or(0.0);
        let half_window = (WINDOW_SD * sd).max(times_least_window * LEAST_WINDOW);
        Narrow { worst_deviation_ratio, ln_width: narrowest_mode(&ln_widths, half_window), half_window }
    }

    /// The mode: logarithm of the width.
    pub(crate) fn ln_width(&self) -> f64 {
        self.ln_width
    }

    fn fits(&self, pulse: &Width) -> bool {
        pulse.deviation_ratio <= self.worst_deviation_ratio
    }

    /// Whether a pulse belongs to the selection.
    pub(crate) fn holds(&self, pulse: &Width) -> bool {
        self.fits(pulse) && (pulse.ln_width - self.ln_width).abs() <= self.half_window
    }
}

/// Widths of single pulses.
#[derive(Debug, Clone, Default)]
pub(super) struct Widths(pub(super) Vec<Width>);

/// Population of pulses not widened by the target.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct NarrowPopulation {
    pub(super) fwhm_ns: f64,
    pub(super) fwhm_sd_ns: f64,
    /// Standard deviation of `fwhm_ns` itself.
    pub(super) fwhm_uncertainty_ns: f64,
    pub(super) pulses: u64,
}

impl Widths {
    /// Narrowest mode of the widths, refined as the mean of a window about it.
    ///
    /// Mean and median are biased by widened pulses. The spread is that of the widths below the
    /// mode.
    pub(super) fn narrow_population(&self) -> Option<NarrowPopulation> {
        if self.0.len() < MIN_PULSES {
            return None;
        }
        let narrow = Narrow::of(&self.0, 1.0);
        let mut widths: Vec<f64> = self.0.iter().filter(|w| narrow.fits(w)).map(|w| w.ln_width).collect();
        widths.sort_by(f64::total_cmp);
        let mut mode = narrow.ln_width;
        let mut count = 0;
        for _ in 0..20 {
            let near = || widths.iter().filter(|w| (**w - mode).abs() <= narrow.half_window);
            count = near().count();
            if count == 0 {
                break;
            }
            mode = near().sum::<f64>() / count as f64;
        }
        let below: Vec<f64> = widths.iter().map(|w| mode - w).take_while(|d| *d >= 0.0).collect();
        // Two thirds of the values below the mode are within one SD of it; `below` is descending.
        let spread = below.get((below.len() as f64 * 0.317_311) as usize).copied().unwrap_or(0.0);
        let fwhm_ns = mode.exp();
        Some(NarrowPopulation {
            fwhm_ns,
            fwhm_sd_ns: spread * fwhm_ns,
            fwhm_uncertainty_ns: SPREAD_OF_MODE * spread * fwhm_ns / (count.max(1) as f64).sqrt(),
            pulses: widths.len() as u64,
        })
    }
}

/// Narrowest mode of sorted values.
///
/// It is the centre of the first window of this half width with a local maximum of the count, and
/// with at least twice the count of some window between it and any fuller one. Pulses widened by
/// leaves and dense crowns have a mode of their own, which is the higher one over forest.
fn narrowest_mode(sorted: &[f64], half_width: f64) -> f64 {
    // One window starts at each value.
    let end = |i: usize| sorted.partition_point(|value| *value <= sorted[i] + 2.0 * half_width);
    let highest = (0..sorted.len()).map(|i| end(i) - i).max().unwrap_or(0);
    let least = LEAST_IN_MODE.max((LEAST_PART_OF_MODE * highest as f64) as usize);
    let mut best = 0..0;
    for i in 0..sorted.len() {
        let count = end(i) - i;
        if count > best.len() {
            best = i..end(i);
        } else if best.len() >= least && 2 * count < best.len() {
            break;
        }
    }
    sorted[best.clone()].iter().sum::<f64>() / best.len().max(1) as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulated::Random;

    #[test]
    fn the_mode_lies_where_values_are_densest() {
        assert_eq!(narrowest_mode(&[], 0.1), 0.0);
        assert_eq!(narrowest_mode(&[3.0], 0.1), 3.0);
        assert!((narrowest_mode(&[0.0, 5.0, 5.1, 5.2, 9.0, 14.0], 0.1) - 5.1).abs() < 0.06);
    }

    /// A third as many narrow as wide values, and a few outliers below both.
    #[test]
    fn of_two_modes_the_narrow_one_counts() {
        let mut random = Random::new(12);
        let mut normal = |mean: f64, count: usize| -> Vec<f64> {
            (0..count).map(|_| mean + 0.03 * random.normal()).collect()
        };
        let mut widths = [normal(1.5, 300), normal(1.9, 900), normal(1.2, 10)].concat();
        widths.sort_by(f64::total_cmp);
        let mode = narrowest_mode(&widths, 0.03);
        assert!((mode - 1.5).abs() < 0.01, "{mode}");
    }

    /// 60 % of pulses of 4.2 ns with a spread of 3 %, the others widened by up to 60 %.
    #[test]
    fn widened_pulses_do_not_draw_the_width() {
        let mut random = Random::new(11);
        let widths = Widths(
            (0..2000)
                .map(|i| {
                    let widened = if i % 5 < 3 { 0.0 } else { 0.1 + 0.4 * random.uniform() };
                    let ln_width = 4.2f64.ln() + 0.03 * random.normal() + widened;
                    Width { ln_width, sd: 0.03, deviation_ratio: random.normal() }
                })
                .collect(),
        );
        let narrow = widths.narrow_population().unwrap();
        assert!((narrow.fwhm_ns - 4.2).abs() < 0.03, "{narrow:?}");
        assert!((narrow.fwhm_sd_ns - 0.126).abs() < 0.03, "{narrow:?}");
        assert_eq!(narrow.pulses, 1800);
        assert_eq!(Widths(widths.0[..9].to_vec()).narrow_population(), None);
    }
}

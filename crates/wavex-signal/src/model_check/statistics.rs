//! Measurements of waveforms, as independent of the compared model as possible.

use super::KernelContext;
use crate::calibrate::{Narrow, NoiseStatistics, Width, noise_by_differences_dn};
use crate::decompose::{
    BatchDecomposer, DecomposeSettings, Decomposition, Decompositions, Mode, OVERDRIVEN_PART, Return,
    Waveform,
};
use crate::flags;
use crate::sensor_model::{Background, ChannelModel, ModelError};
use crate::shape::{Pulse, Shape};

/// Prior SD of the background, in standard deviations of the noise and DN: hardly any.
const FREE_LEVEL_SD: f64 = 30.0;
const FREE_LEVEL_DN: f64 = 10.0;
/// Largest fitted signal of quiet samples, standard deviations of the noise by differences.
const QUIET_SD: f64 = 2.0;
/// Shortest quiet stretch, samples.
const MIN_STRETCH: usize = 8;
/// Largest variance of a stretch over the median of all; others contain a pulse without a fit.
const LARGEST_VARIANCE: f64 = 4.0;
/// Fewest quiet samples.
const MIN_QUIET: u64 = 1000;
/// Smallest height of clear echoes, standard deviations of the noise.
const CLEAR_SD: f64 = 20.0;
/// Largest height of other returns of a clear single echo, relative to it …
const MINOR_PART: f64 = 0.12;
/// … and their smallest distance after it, widths.
const APART_WIDTHS: f64 = 1.5;
/// Largest relative height of other returns of an echo that shows the shape, if clear single echoes are
/// too few: a wrong tail is fitted as such returns …
const TAIL_PART: f64 = 0.3;
/// … and the smallest residual that then counts, half of `MINOR_PART`: a wrong tail that hides single echoes
/// is higher.
const TAIL_RESIDUAL: f64 = 0.06;
/// Fewest clear single echoes.
const MIN_SINGLES: usize = 50;
/// Largest distance of the width of narrow echoes from the mode, logarithm.
const NARROW: f64 = 0.1;
/// Lags of the residual: widths before and after the peak, and at most this many samples after it.
const BEFORE_WIDTHS: f64 = 2.0;
const AFTER_WIDTHS: f64 = 15.0;
const MAX_AFTER: f64 = 80.0;
/// Fraction of the worst-fitting echoes that is omitted.
const WORST_PART: f64 = 0.05;
/// Chi-square over the median from which a fit has another cause than the response, such as an echo cut by the
/// end of the block.
const WILD: f64 = 10.0;

/// Median and robust SD of a sample.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct Location {
    pub(super) median: f64,
    pub(super) sd: f64,
    pub(super) count: usize,
}

impl Location {
    /// Median and robust SD of the values, whose order changes.
    pub(super) fn of(values: &mut [f64]) -> Location {
        let count = values.len();
        let mut at = |part: f64| {
            let rank = (part * count as f64) as usize;
            if rank < count { *values.select_nth_unstable_by(rank, f64::total_cmp).1 } else { 0.0 }
        };
        let [median, low, high] = [0.5, 0.158_655, 0.841_345].map(&mut at);
        Location { median, sd: 0.5 * (high - low), count }
    }

    /// SD of the median of a normal distribution.
    pub(super) fn median_sd(&self) -> f64 {
        1.2533 * self.sd / (self.count.max(1) as f64).sqrt()
    }
}

/// Noise at quiet samples.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Quiet {
    /// At lags from 0, DN².
    pub(super) autocovariance: Vec<f64>,
    pub(super) samples: u64,
}

/// Mean chi-square of echoes per degree of freedom, and the part that the template error explains.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct Fits {
    pub(super) count: usize,
    /// Degrees of freedom of a waveform.
    pub(super) freedom: f64,
    pub(super) chi_square: f64,
    pub(super) expected_excess: f64,
}

impl Fits {
    /// Averages chi-square, degrees of freedom and expected excess without the worst fits.
    fn of(mut all: Vec<[f64; 3]>) -> Fits {
        let over_expected = |[chi_square, freedom, excess]: &[f64; 3]| chi_square / (freedom + excess);
        all.sort_by(|a, b| over_expected(a).total_cmp(&over_expected(b)));
        all.truncate(all.len() - (WORST_PART * all.len() as f64) as usize);
        let median = all.get(all.len() / 2).map_or(0.0, over_expected);
        all.retain(|fit| over_expected(fit) <= WILD * median);
        let sum = |i: usize| all.iter().map(|fit| fit[i]).sum::<f64>();
        let freedom = sum(1).max(1.0);
        let mean = freedom / all.len().max(1) as f64;
        Fits {
            count: all.len(),
            freedom: mean,
            chi_square: sum(0) / freedom,
            expected_excess: sum(2) / freedom,
        }
    }

    /// Root of chi-square over the expected one, at least 1.
    pub(super) fn excess_factor(&self) -> f64 {
        (self.chi_square / (1.0 + self.expected_excess)).max(1.0).sqrt()
    }

    /// Variance of the mean chi-square per degree of freedom.
    pub(super) fn variance(&self) -> f64 {
        2.0 / (self.freedom * self.count as f64).max(1.0)
    }
}

/// Measurements of a channel.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Statistics {
    pub(super) waveforms: usize,
    /// White noise by fourth differences, DN.
    pub(super) differences_dn: f64,
    pub(super) quiet: Option<Quiet>,
    /// Level of the waveforms about the background of the model, DN.
    pub(super) offset_dn: Location,
    /// Waveforms with an echo.
    pub(super) with_echo: usize,
    /// Lower mode of the logarithm of the width ratio of single echoes; its count is that of the mode.
    pub(super) ln_width: Option<Location>,
    /// Residual of narrow single echoes over their height, by lag in samples.
    pub(super) residual: Vec<(i32, Location)>,
    /// Smallest relative residual that counts as a shape error.
    pub(super) least_residual: f64,
    /// Fits of the weak and of the strong third of the narrow single echoes.
    pub(super) fits: [Fits; 2],
}

/// A clear single echo.
struct Single {
    /// Index of its block.
    block: usize,
    found: Return,
    offset_dn: f64,
}

impl Statistics {
    pub(super) fn of(
        blocks: &[Waveform<'_>],
        model: &ChannelModel,
        with: &KernelContext,
    ) -> Result<Statistics, ModelError> {
        let differences_dn = noise_by_differences_dn(blocks.iter().copied());
        let free = with_free_background(model)?;
        let settings = DecomposeSettings {
            explains_all: false,
            split_evidence: None,
            max_added: 4,
            ..DecomposeSettings::default()
        };
        let decomposer = decomposer(&free, &settings, with)?;
        let shape = decomposer.shape().clone();
        let mut residual = Residual::of(&free, &shape);
        let mut stretches = Vec::new();
        let (mut offsets, mut singles, mut with_tail, mut with_echo) =
            (Vec::new(), Vec::new(), Vec::new(), 0);
        decompose(decomposer, blocks, |index, outcome| {
            with_echo += usize::from(outcome.counts.n_candidates > 0);
            if outcome.saturated {
                return;
            }
            offsets.push(outcome.background_offset_dn);
            residual.subtract(blocks[index], outcome.returns, outcome.background_offset_dn);
            residual.add_quiet(QUIET_SD * differences_dn, &mut stretches);
            let clear = CLEAR_SD * free.noise_sd_dn.max(differences_dn)..OVERDRIVEN_PART * free.full_scale_dn;
            for (minor_part, of_part) in [(MINOR_PART, &mut singles), (TAIL_PART, &mut with_tail)] {
                if let Some(found) = single(outcome, minor_part, free.fwhm_samples())
                    && clear.contains(&found.amplitude_dn)
                {
                    let offset_dn = outcome.background_offset_dn;
                    of_part.push(Single { block: index, found: *found, offset_dn });
                }
            }
        });
        let ln_width = mode_of_widths(&singles);
        let mode = ln_width.map_or(0.0, |mode| mode.median);
        let is_narrow = |single: &&Single| (single.found.width_ratio.ln() - mode).abs() <= NARROW;
        let narrow: Vec<&Single> = singles.iter().filter(is_narrow).collect();
        let (of_shape, least_residual) =
            if narrow.len() < MIN_SINGLES { (&with_tail, TAIL_RESIDUAL) } else { (&singles, 0.0) };
        let of_shape: Vec<&Single> = of_shape.iter().filter(is_narrow).collect();
        Ok(Statistics {
            waveforms: blocks.len(),
            differences_dn,
            quiet: quiet(stretches),
            offset_dn: Location::of(&mut offsets),
            with_echo,
            ln_width,
            residual: residual.by_lag(blocks, &of_shape),
            least_residual,
            fits: fits(blocks, &narrow, model, with)?,
        })
    }
}

/// The model with the level as a free parameter of each waveform.
fn with_free_background(model: &ChannelModel) -> Result<ChannelModel, ModelError> {
    let mut free = model.clone();
    free.background = Background::PerWaveform;
    free.background_sd_dn = model.background_sd_dn.max(FREE_LEVEL_SD * model.noise_sd_dn + FREE_LEVEL_DN);
    // Levels are estimated only with a measured correlation.
    let mut lags = [0.0; 6];
    model.noise()?.autocovariance_into(&mut lags);
    free.autocorrelation = lags[1..].iter().map(|lag| lag / lags[0]).collect();
    Ok(free)
}

fn decomposer(
    model: &ChannelModel,
    settings: &DecomposeSettings,
    with: &KernelContext,
) -> Result<BatchDecomposer, ModelError> {
    BatchDecomposer::new(model, with.tables.of(model), settings, Mode::Refined, with.simd)
}

/// Decomposes blocks; `take` gets the index of each.
fn decompose(
    mut decomposer: BatchDecomposer,
    blocks: &[Waveform<'_>],
    mut take: impl FnMut(usize, &Decomposition<'_>),
) {
    let mut outcomes = Decompositions::default();
    decomposer.decompose(blocks, &mut outcomes);
    outcomes.iter().enumerate().for_each(|(index, outcome)| take(index, &outcome));
}

/// Residual of a block, and its fit.
struct Residual<'a> {
    model: &'a ChannelModel,
    shape: &'a Shape,
    /// Samples less background and fit, DN.
    residual_dn: Vec<f64>,
    /// Fitted signal, DN.
    fitted_dn: Vec<f64>,
}

impl<'a> Residual<'a> {
    fn of(model: &'a ChannelModel, shape: &'a Shape) -> Residual<'a> {
        Residual { model, shape, residual_dn: Vec::new(), fitted_dn: Vec::new() }
    }

    /// Subtracts background and returns from a block.
    fn subtract(&mut self, block: Waveform<'_>, returns: &[Return], offset_dn: f64) {
        self.residual_dn.clear();
        self.model.signal_into(block.samples, &mut self.residual_dn);
        self.fitted_dn.clear();
        self.fitted_dn.resize(self.residual_dn.len(), 0.0);
        for found in returns {
            let pulse = Pulse {
                height_dn: found.amplitude_dn,
                position_samples: found.position_samples,
                ln_width_ratio: found.width_ratio.ln(),
                ln_width_precision: 0.0,
            };
            self.shape.add(&pulse, 1.0, &mut self.fitted_dn);
        }
        for (signal, fitted) in self.residual_dn.iter_mut().zip(&self.fitted_dn) {
            *signal = *signal - fitted - offset_dn;
        }
    }

    /// Adds the stretches where the fitted signal is low.
    fn add_quiet(&self, quiet_dn: f64, stretches: &mut Vec<Vec<f64>>) {
        let is_quiet = |fitted_dn: &f64| fitted_dn.abs() <= quiet_dn;
        let mut first = 0;
        for of_kind in self.fitted_dn.chunk_by(|a, b| is_quiet(a) == is_quiet(b)) {
            let stretch = first..first + of_kind.len();
            first = stretch.end;
            if of_kind.len() >= MIN_STRETCH && is_quiet(&of_kind[0]) {
                stretches.push(self.residual_dn[stretch].to_vec());
            }
        }
    }

    /// Residual of single echoes relative to their height, by lag; without lags that few of them reach.
    ///
    /// Other returns are not subtracted: those caused by a wrong shape belong to the residual, and the
    /// median does not see those of other targets.
    fn by_lag(&mut self, blocks: &[Waveform<'_>], singles: &[&Single]) -> Vec<(i32, Location)> {
        let fwhm = self.model.fwhm_samples();
        let first = (-BEFORE_WIDTHS * fwhm).floor() as i32;
        let last = (AFTER_WIDTHS * fwhm).min(MAX_AFTER) as i32;
        let mut by_lag: Vec<Vec<f64>> = (first..=last).map(|_| Vec::with_capacity(singles.len())).collect();
        for single in singles {
            self.subtract(blocks[single.block], std::slice::from_ref(&single.found), single.offset_dn);
            // Sample and lag from which both are in range.
            let before = -single.found.position_samples.round() as i32 - first;
            let [sample, lag] = [-before, before].map(|skipped| skipped.max(0) as usize);
            let residual_dn = self.residual_dn.iter().skip(sample);
            for (values, residual) in by_lag.iter_mut().skip(lag).zip(residual_dn) {
                values.push(residual / single.found.amplitude_dn);
            }
        }
        let reached = (first..).zip(by_lag).filter(|(_, values)| values.len() >= MIN_SINGLES);
        reached.map(|(lag, mut values)| (lag, Location::of(&mut values))).collect()
    }
}

/// Noise of the quiet stretches, without those that contain signal; `None` with too few.
fn quiet(stretches: Vec<Vec<f64>>) -> Option<Quiet> {
    let variance = |values: &[f64]| {
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / values.len() as f64
    };
    let mut variances: Vec<f64> = stretches.iter().map(|stretch| variance(stretch)).collect();
    let largest = LARGEST_VARIANCE * Location::of(&mut variances).median;
    let mut statistics = NoiseStatistics::about(0.0);
    stretches
        .iter()
        .filter(|stretch| variance(stretch) <= largest)
        .for_each(|stretch| statistics.add(stretch, 0));
    let autocovariance =
        statistics.autocovariance_without_drift().unwrap_or_else(|| statistics.autocovariance());
    let is_enough = statistics.samples() >= MIN_QUIET && autocovariance.first().is_some_and(|lag| *lag > 0.0);
    is_enough.then(|| Quiet { autocovariance, samples: statistics.samples() })
}

/// The strongest return, if it is complete, and others are at most this part of it and well after it.
fn single<'a>(outcome: &Decomposition<'a>, minor_part: f64, fwhm_samples: f64) -> Option<&'a Return> {
    let strongest = outcome.returns.iter().max_by(|a, b| a.amplitude_dn.total_cmp(&b.amplitude_dn))?;
    let is_minor = |other: &Return| {
        std::ptr::eq(other, strongest)
            || (other.amplitude_dn <= minor_part * strongest.amplitude_dn
                && other.position_samples - strongest.position_samples > APART_WIDTHS * fwhm_samples)
    };
    let bad = flags::SATURATED | flags::TRUNCATED | flags::DIVERGED;
    (strongest.flags & bad == 0 && outcome.returns.iter().all(is_minor)).then_some(strongest)
}

/// Lower mode of the logarithms of the width ratios; `None` with too few echoes.
fn mode_of_widths(singles: &[Single]) -> Option<Location> {
    if singles.len() < MIN_SINGLES {
        return None;
    }
    let width = |single: &Single| Width {
        ln_width: single.found.width_ratio.ln(),
        sd: single.found.width_ratio_sd / single.found.width_ratio,
        deviation_ratio: single.found.deviation_ratio,
    };
    let widths: Vec<Width> = singles.iter().map(width).collect();
    let narrow = Narrow::of(&widths, 1.0);
    let mut in_mode: Vec<f64> =
        widths.iter().filter(|width| narrow.holds(width)).map(|width| width.ln_width).collect();
    let sd = Location::of(&mut in_mode).sd;
    Some(Location { median: narrow.ln_width(), sd, count: in_mode.len() })
}

/// Chi-square of the weak and of the strong third of single echoes, as a run decomposes them.
fn fits(
    blocks: &[Waveform<'_>],
    singles: &[&Single],
    model: &ChannelModel,
    with: &KernelContext,
) -> Result<[Fits; 2], ModelError> {
    let mut by_height: Vec<&Single> = singles.to_vec();
    by_height.sort_by(|a, b| a.found.amplitude_dn.total_cmp(&b.found.amplitude_dn));
    let settings = DecomposeSettings {
        explains_all: false,
        split_evidence: None,
        max_added: 0,
        ..DecomposeSettings::default()
    };
    let third = by_height.len() / 3;
    let [weak, strong] = [&by_height[..third], &by_height[by_height.len() - third..]];
    let chosen: Vec<Waveform<'_>> = weak.iter().chain(strong).map(|single| blocks[single.block]).collect();
    let mut all = [Vec::new(), Vec::new()];
    decompose(decomposer(model, &settings, with)?, &chosen, |index, outcome| {
        let freedom = outcome.degrees_of_freedom() as f64;
        if freedom > 0.0 {
            let fit = [outcome.chi_square, freedom, outcome.expected_excess];
            all[usize::from(index >= third)].push(fit);
        }
    });
    Ok(all.map(Fits::of))
}

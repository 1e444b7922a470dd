//! Estimates a channel's system response from single echoes (docs/explanation/method.md, Calibration).
//!
//! Blocks are decomposed with the current model. From the strong, unsaturated single echoes those
//! of the narrow population are selected, and their heights and positions are fitted with fixed
//! width. A linear least-squares problem in the whitened domain then gives the splines of the
//! response, with which the next round starts. Time zero is the peak; width ratio 1 is the mode of
//! the widths.

use crate::calibrate::{
    CalibrationError, CalibrationSettings, GROUPS, Narrow, WeakPulses, Width, decompose_each, evenly,
    jackknife_sd, quiet,
};
use crate::decompose::{DecomposeSettings, Decomposition, OVERDRIVEN_PART, Return, Waveform};
use crate::flags;
use crate::parallel::map_parts;
use crate::sensor_model::response::{ResponseNode, STEPS_PER_SAMPLE, SystemResponse, normalised};
use crate::sensor_model::{ChannelModel, ModelError, NoiseSource, ResponseSource};
use crate::shape::Shape;
use quality::Quality;
use solve::SolverProblem;
use spline::Basis;

mod all_waveforms;
mod even_odd;
mod outgoing;
mod quality;
mod solve;
mod spline;
#[cfg(test)]
mod tests;

pub use even_odd::EvenOdd;
pub use outgoing::{comparable_height_dn, is_too_narrow, with_outgoing_pulse};

/// Fewest usable single echoes for a response.
pub const MIN_ECHOES: usize = 150;
/// Largest height of further echoes of a block relative to the strongest, by round.
///
/// A Gaussian model reports the after-pulse as an echo, and a first response may leave some of it.
const MINOR_PARTS: [f64; 4] = [0.1, 0.03, 0.0, 0.0];
/// Assumed error of the response by round, relative to the height.
const ERRORS: [f64; 4] = [0.02, 0.02, 0.01, 0.005];
/// Largest number of echoes per height node, by round.
///
/// All but the last response only serve to select and locate the echoes of the next round.
const MOST_ECHOES: [usize; 4] = [500, 500, 500, 2_000];
/// Number of usable echoes in the first rounds below which all blocks are decomposed.
const ENOUGH_FIRST: usize = 1_000;
/// Largest number of blocks in the first rounds, evenly spaced, if enough of their echoes are single.
const MOST_FIRST: usize = 2_000;
/// Largest number of echoes in the even/odd test; they determine the factor to 3 %.
const MOST_SCORED: usize = 1_000;
/// Number of partial sums of the equations of a response, each by one thread.
const SUMS: usize = 8;
/// Smallest height of usable echoes, in standard deviations of the noise; they must also not
/// overdrive the receiver.
const STRONG_SD: f64 = 30.0;
/// Heights with their own response, relative to full scale (155, 171, 182 and 200 of 255 DN).
const NODE_PARTS: [f64; 4] = [155.0 / 255.0, 171.0 / 255.0, 182.0 / 255.0, 200.0 / 255.0];
/// Number of echoes in the window below which it is doubled.
///
/// Noise then matters more than blur.
const ENOUGH_NARROW: usize = 300;
/// Smallest extent of the response after the peak, in pulse widths (62 ns for 4.4 ns).
const LEAST_REACH_WIDTHS: f64 = 14.0;
/// Smallest error of a response borrowed from another receiver, relative to the height, where the
/// response exceeds this.
///
/// Both receivers see the same laser pulse, and a Gaussian has no after-pulse at all.
const BORROWED_ERROR: f64 = 0.02;
/// Largest relative width difference of receivers that share a response.
const BORROWED_WIDTH: f64 = 0.15;

/// A single echo.
#[derive(Debug, Clone, Copy)]
struct Single<'a> {
    block: Waveform<'a>,
    fitted: Return,
    /// Background above that of the channel, DN.
    offset_dn: f64,
    /// Chi-square of the block, and its degrees of freedom.
    chi_square: f64,
    degrees_of_freedom: f64,
    /// Its index among the single echoes.
    index: usize,
}

impl Single<'_> {
    fn width(&self) -> Width {
        let Return { width_ratio, width_ratio_sd, deviation_ratio, .. } = self.fitted;
        Width { ln_width: width_ratio.ln(), sd: width_ratio_sd / width_ratio, deviation_ratio }
    }
}

/// Result of the response calibration.
#[derive(Debug, Clone, PartialEq)]
pub struct Calibrated {
    /// The model, with a response if there are at least [`MIN_ECHOES`] usable echoes, otherwise
    /// unchanged.
    pub model: ChannelModel,
    /// Number of usable single echoes.
    pub usable_echoes: usize,
}

/// Adds the system response to a calibrated model.
///
/// The model must be from [`crate::calibrate::calibrate`] with the same blocks.
pub fn calibrate_response<'a>(
    blocks: impl Iterator<Item = Waveform<'a>> + Clone,
    model: &ChannelModel,
    settings: &CalibrationSettings,
) -> Result<Calibrated, CalibrationError> {
    let mut blocks = chosen_evenly(blocks, settings.max_blocks);
    let longest = blocks.iter().map(|block| block.samples.len()).max().unwrap_or(0);
    let mut model = ChannelModel { response: None, pulse_error_factor: 1.0, ..model.clone() };
    let gaussian = model.clone();
    let all = blocks.clone();
    let without_response = |usable_echoes| -> Result<Calibrated, CalibrationError> {
        let model = quiet::separate_noise(all.iter().copied(), &gaussian, settings)?;
        Ok(Calibrated { model, usable_echoes })
    };
    // The first responses only serve to select the echoes of the last.
    let few = chosen_evenly(blocks.iter().copied(), MOST_FIRST);
    let mut usable_echoes = 0;
    for (round, ((minor_part, error), most)) in
        MINOR_PARTS.into_iter().zip(ERRORS).zip(MOST_ECHOES).enumerate()
    {
        let is_first = round < 2;
        let mut singles =
            self::singles(if is_first { &few } else { &blocks }, &model, settings, minor_part, error)?;
        if is_first && singles.len() < ENOUGH_FIRST && few.len() < blocks.len() {
            singles = self::singles(&blocks, &model, settings, minor_part, error)?;
        }
        usable_echoes = singles.len();
        if usable_echoes < MIN_ECHOES {
            return without_response(usable_echoes);
        }
        if !is_first {
            // Blocks without a nearly single echo are not used again.
            blocks = singles.iter().map(|single| single.block).collect();
        }
        match better_response(&singles, &model, longest, most)? {
            Some(response) => model = with_response(&model, response),
            None => return without_response(usable_echoes),
        }
    }
    model.provenance.response = ResponseSource::Echoes;
    model = quiet::separate_noise(all.iter().copied(), &model, settings)?;
    let singles = self::singles(&blocks, &model, settings, 0.0, ERRORS[3])?;
    Quality::of(&model, &singles, longest)?.apply_to(&mut model);
    model.uncertainty.pulse_fwhm_ns = fwhm_sd_ns(&model, &singles);
    Ok(Calibrated { model, usable_echoes })
}

/// Selects at most `most` evenly spaced blocks.
fn chosen_evenly<'a>(blocks: impl Iterator<Item = Waveform<'a>> + Clone, most: usize) -> Vec<Waveform<'a>> {
    let count = blocks.clone().count().max(1);
    let most = most.min(count);
    let is_chosen = |i: usize| (i + 1) * most / count > i * most / count;
    blocks.enumerate().filter(|(i, _)| is_chosen(*i)).map(|(_, block)| block).collect()
}

/// Copies another receiver's response to a channel.
///
/// For channels whose own echoes do not determine a response. The response for weak echoes and the
/// error factor are copied; its echo count is 0. `None` if the other receiver has no response, or
/// the channel's own pulses differ in width.
pub fn with_response_of(model: &ChannelModel, other: &ChannelModel) -> Option<ChannelModel> {
    let known = other.response.as_ref()?;
    let node = known.nodes.first()?.clone();
    let is_other_pulse = (model.pulse_fwhm_ns / other.pulse_fwhm_ns).ln().abs() > BORROWED_WIDTH;
    if is_other_pulse && model.pulses > 0 {
        return None;
    }
    let mut response = SystemResponse { nodes: vec![node], echoes: 0, ..known.clone() };
    response.template_error = least_errors(&response, BORROWED_ERROR);
    let mut borrowed = with_response(model, response);
    borrowed.provenance.response = ResponseSource::OtherReceiver;
    borrowed.pulse_error_factor = other.pulse_error_factor;
    borrowed.uncertainty.pulse_error_factor = other.uncertainty.pulse_error_factor;
    borrowed.uncertainty.pulse_fwhm_ns = BORROWED_ERROR * borrowed.pulse_fwhm_ns;
    Some(borrowed)
}

/// Template error of a response, at least this where the response exceeds it.
fn least_errors(response: &SystemResponse, least: f64) -> Vec<f64> {
    let values = response.nodes.first().map_or(&[][..], |node| &node.values);
    let error = |k: usize| {
        // Values within half a sample of the time of the error.
        let (from, to) =
            ((k * STEPS_PER_SAMPLE).saturating_sub(STEPS_PER_SAMPLE / 2), (2 * k + 1) * STEPS_PER_SAMPLE / 2);
        let is_high =
            values[from.min(values.len())..to.min(values.len())].iter().any(|value| value.abs() >= least);
        let measured = response.template_error.get(k).copied().unwrap_or(0.0);
        if is_high { measured.max(least) } else { measured }
    };
    (0..values.len() / STEPS_PER_SAMPLE).map(error).collect()
}

fn with_response(model: &ChannelModel, response: SystemResponse) -> ChannelModel {
    let pulses = response.echoes;
    let fwhm_ns = response.fwhm_samples() * model.sampling_interval_ns;
    let pulse_fwhm_ns = if fwhm_ns > 0.0 { fwhm_ns } else { model.pulse_fwhm_ns };
    ChannelModel { response: Some(response), pulse_fwhm_ns, pulses, ..model.clone() }
}

/// Smallest height of usable echoes, DN.
///
/// The residuals of fits contain the shape error, which grows with the height. Noise estimated from
/// them gives no threshold.
fn strong_dn(model: &ChannelModel) -> f64 {
    let by_differences_dn = model.provenance.noise_by_differences_dn;
    match model.provenance.noise {
        NoiseSource::Residuals if by_differences_dn > 0.0 => STRONG_SD * by_differences_dn,
        _ => STRONG_SD * model.noise_sd_dn,
    }
}

/// Selects the usable single echoes of the blocks.
fn singles<'a>(
    blocks: &[Waveform<'a>],
    model: &ChannelModel,
    settings: &CalibrationSettings,
    minor_part: f64,
    template_error: f64,
) -> Result<Vec<Single<'a>>, CalibrationError> {
    let decompose = DecomposeSettings {
        explains_all: false,
        max_added: if model.response.is_some() { 4 } else { 0 },
        split_evidence: None,
        template_error,
        ..settings.decompose.clone()
    };
    let heights = strong_dn(model)..model.overdriven_dn(OVERDRIVEN_PART);
    let mut found = Vec::new();
    // The last rounds determine the response.
    let weak = if minor_part > 0.0 { WeakPulses::Drop } else { WeakPulses::FitAgain };
    decompose_each(blocks.iter().copied(), model, &decompose, settings, weak, |block, outcome| {
        let single = strongest(outcome, minor_part, model.fwhm_samples());
        if let Some(fitted) = single.filter(|r| heights.contains(&r.amplitude_dn)) {
            found.push(Single {
                block,
                fitted: *fitted,
                offset_dn: outcome.background_offset_dn,
                chi_square: outcome.chi_square,
                degrees_of_freedom: outcome.degrees_of_freedom() as f64,
                index: found.len(),
            });
        }
    })?;
    Ok(found)
}

/// The strongest return, if it is complete and others are minor and well after it.
pub(super) fn strongest<'a>(
    outcome: &Decomposition<'a>,
    minor_part: f64,
    fwhm_samples: f64,
) -> Option<&'a Return> {
    let bad = flags::SATURATED | flags::TRUNCATED | flags::DIVERGED;
    strongest_without(bad, outcome, minor_part, fwhm_samples)
}

/// The same without these flags.
pub(super) fn strongest_without<'a>(
    bad: u16,
    outcome: &Decomposition<'a>,
    minor_part: f64,
    fwhm_samples: f64,
) -> Option<&'a Return> {
    let returns = outcome.returns;
    let strongest = returns.iter().max_by(|a, b| a.amplitude_dn.total_cmp(&b.amplitude_dn))?;
    let minor = |r: &Return| {
        std::ptr::eq(r, strongest)
            || (r.amplitude_dn <= minor_part * strongest.amplitude_dn
                && r.position_samples - strongest.position_samples > 1.5 * fwhm_samples)
    };
    (strongest.flags & bad == 0 && returns.iter().all(minor)).then_some(strongest)
}

/// Echoes of similar height.
struct Group<'a> {
    /// Height of the node that they determine, DN.
    peak_dn: f64,
    singles: Vec<Single<'a>>,
}

/// Groups the echoes by ascending height.
///
/// Neighbouring nodes of [`NODE_PARTS`] with too few echoes share one response at their mean
/// height. The first node also covers all weaker echoes.
fn by_height<'a>(singles: &[Single<'a>], full_scale_dn: f64) -> Vec<Group<'a>> {
    let heights = NODE_PARTS.map(|part| part * full_scale_dn);
    let mut groups: Vec<Group<'a>> = Vec::new();
    // Echoes not yet in a group, in descending order of nodes.
    let mut open: Vec<Single<'a>> = Vec::new();
    // From the highest: echoes too few for a node of their own join the next lower one.
    for (i, &height) in heights.iter().enumerate().rev() {
        let low = if i > 0 { 0.5 * (heights[i - 1] + height) } else { 0.0 };
        let high = heights.get(i + 1).map_or(f64::INFINITY, |next| 0.5 * (height + next));
        let shared = !open.is_empty();
        open.extend(singles.iter().filter(|s| (low..high).contains(&s.fitted.amplitude_dn)));
        if open.len() >= MIN_ECHOES || (i == 0 && groups.is_empty()) {
            let mean = open.iter().map(|s| s.fitted.amplitude_dn).sum::<f64>() / open.len().max(1) as f64;
            let peak_dn = if shared && i > 0 { mean } else { height };
            groups.push(Group { peak_dn, singles: std::mem::take(&mut open) });
        }
    }
    // Needed for the outgoing pulse, which is always strong.
    if let Some(lowest) = groups.last_mut() {
        lowest.singles.append(&mut open);
    }
    groups.reverse();
    groups
}

/// Selects well-fitted, unwidened echoes of a group: those near the mode of the widths.
fn narrow_population<'a>(singles: &[Single<'a>]) -> Vec<Single<'a>> {
    let widths: Vec<Width> = singles.iter().map(Single::width).collect();
    let within = |times_least: f64| -> Vec<Single<'a>> {
        let narrow = Narrow::of(&widths, times_least);
        let kept = singles.iter().zip(&widths).filter(|(_, width)| narrow.holds(width));
        kept.map(|(single, _)| *single).collect()
    };
    let narrow = within(1.0);
    if narrow.len() >= ENOUGH_NARROW { narrow } else { within(2.0) }
}

/// Standard deviation of the response's width, ns.
///
/// It is that of the mean width of the selected echoes, by a jackknife over consecutive groups with
/// a new selection each time.
fn fwhm_sd_ns(model: &ChannelModel, singles: &[Single<'_>]) -> f64 {
    let per_group = singles.len().div_ceil(GROUPS).max(1);
    let groups: Vec<usize> = (0..singles.len().div_ceil(per_group)).collect();
    let mean_without = |group: &[usize]| {
        let before = group[0] * per_group;
        let after = (before + per_group).min(singles.len());
        let narrow = narrow_population(&[&singles[..before], &singles[after..]].concat());
        narrow.iter().map(|single| single.width().ln_width).sum::<f64>() / narrow.len().max(1) as f64
    };
    jackknife_sd(&map_parts(&groups, 1, mean_without)) * model.pulse_fwhm_ns
}

/// Least-squares response from at most `most` echoes per height node; `None` for singular
/// equations.
fn better_response(
    singles: &[Single<'_>],
    model: &ChannelModel,
    longest: usize,
    most: usize,
) -> Result<Option<SystemResponse>, ModelError> {
    // A receiver that compresses strong echoes makes them wider: each height has its own mode of
    // the widths.
    let groups = by_height(singles, model.full_scale_dn);
    let narrow: Vec<_> = groups
        .iter()
        .flat_map(|group| evenly(&narrow_population(&group.singles), most).collect::<Vec<_>>())
        .collect();
    let nodes: Vec<f64> = groups.iter().map(|group| group.peak_dn).collect();
    response_of(&narrow, model, longest, &nodes)
}

/// Least-squares response at these heights, from these echoes; `None` for singular equations.
fn response_of(
    narrow: &[Single<'_>],
    model: &ChannelModel,
    longest: usize,
    nodes: &[f64],
) -> Result<Option<SystemResponse>, ModelError> {
    let fwhm = model.fwhm_samples();
    // To the end of the longest block: the tail missing from a truncated response is detected as returns.
    let reach = (LEAST_REACH_WIDTHS * fwhm).max(longest as f64 + 2.0 * fwhm);
    let basis = Basis::new(fwhm, reach);
    let shape = Shape::of(model)?;
    // A fixed number of sums, so that rounding does not depend on the number of threads.
    let problems = map_parts(narrow, narrow.len().div_ceil(SUMS), |part| {
        let mut problem = SolverProblem::new(model, &basis, nodes, shape.clone(), longest)?;
        part.iter().for_each(|single| problem.add(single));
        Ok(problem)
    });
    let problems = problems.into_iter().collect::<Result<Vec<_>, ModelError>>()?;
    let Some(problem) = problems.into_iter().reduce(SolverProblem::merged) else { return Ok(None) };
    let Some(solution) = problem.solve() else { return Ok(None) };
    let first_sample = basis.extent().start.floor() as i32;
    let last_sample = basis.extent().end.ceil() as i32;
    let first_step = i64::from(first_sample) * STEPS_PER_SAMPLE as i64;
    let steps = ((last_sample - first_sample) as usize) * STEPS_PER_SAMPLE + 1;
    let mut response = SystemResponse {
        first_sample,
        nodes: Vec::new(),
        template_error: Vec::new(),
        echoes: narrow.len() as u64,
        excess_part: 1.0,
        shape_sd: solution.shape_sd,
    };
    for (&peak_dn, coefficients) in nodes.iter().zip(&solution.coefficients) {
        let value = |k: usize| {
            let time = (first_step + k as i64) as f64 / STEPS_PER_SAMPLE as f64;
            basis.at(time).map(|(j, value)| value * coefficients[j]).sum::<f64>()
        };
        let values: Vec<f64> = (0..steps).map(value).collect();
        let Some(values) = normalised(&values, first_step, fwhm) else { return Ok(None) };
        response.nodes.push(ResponseNode { peak_dn, values });
    }
    Ok(response.check().is_ok().then_some(response))
}

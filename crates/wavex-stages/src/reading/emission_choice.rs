//! Choice of the emission reference by the smoothness of points.
//!
//! Points of neighbouring single echoes form a smooth line. The second differences of three
//! consecutive points along the beam show the jitter that a wrong emission time adds. They also bound
//! the jitter of the clock from above: terrain and echo positions add to it.

use wavex_line::scan_line::{Block, Blocks, Channel, Emission, EmissionReference, InputInfo, ScanLine};
use wavex_line::stage::{Context, Source};
use wavex_signal::fusion::peak_above_half;
use wavex_simd::statistics::median;

mod check;

pub(crate) use check::EmissionCheck;

/// References between which recordings with outgoing pulses decide, in order of preference.
pub(crate) const WITH_OUTGOING: &[EmissionReference] =
    &[EmissionReference::OutgoingPulse, EmissionReference::OutgoingPulseFraction, EmissionReference::Clock];
/// The reference of recordings with neither outgoing pulses nor return locations.
pub(crate) const WITHOUT: &[EmissionReference] = &[EmissionReference::Clock];
/// References between which recordings with return locations decide, in order of preference.
pub(crate) const WITH_LOCATIONS: &[EmissionReference] =
    &[EmissionReference::ReturnLocations, EmissionReference::Clock];
/// Largest number of references of a recording.
const REFERENCES: usize = 3;

/// Fewest triples for a decision.
const LEAST_TRIPLES: usize = 100;
/// Number of triples that suffice.
const ENOUGH_TRIPLES: usize = 5000;
/// Largest number of shots read ahead.
const MOST_SHOTS: usize = 100_000;
/// A reference is ruled out if another leaves less than this part of its second differences.
const CLEARLY_SMOOTHER: f64 = 0.8;
/// Smallest height of an echo, in noise standard deviations.
const LEAST_SNR: f64 = 20.0;
/// Largest relative height of other samples beside a single echo.
const BESIDE: f64 = 0.3;
/// Smallest noise of a digitised signal, DN: the rounding error.
const LEAST_NOISE_DN: f64 = 0.3;
/// Second difference of independent values over their SD.
const SECOND_DIFFERENCE: f64 = 2.449_489_742_783_178;
/// Distance from a whole number of samples within which second differences count as that number; others up
/// to twice as far are their neighbours …
const NEAR_SAMPLE: f64 = 0.2;
/// … and its largest value for displaced shots, where it is the SD of the second differences.
const MOST_NEAR_SAMPLE: f64 = 0.3;
/// Significance of an excess of second differences of one sample and of two, standard deviations of the count.
const JUMPS_SD: f64 = 3.0;
const DISPLACED_SD: f64 = 2.0;
/// Largest distance of two points in the search for displaced shots: one shot between them may have no point.
const MOST_STEP: usize = 2;
/// Standard deviation of a normal distribution over the lower quartile of absolute values.
const SD_OF_LOWER_QUARTILE: f64 = 3.138_344;
/// Standard deviation of a normal distribution over its median absolute deviation.
const SD_OF_MEDIAN: f64 = 1.4826;

/// Second differences of neighbouring single echoes, by emission reference.
pub(crate) struct Smoothness {
    references: &'static [EmissionReference],
    shots: usize,
    /// Second differences of points along the beam and of ranges, ns, by reference.
    points_ns: Vec<[f64; REFERENCES]>,
    ranges_ns: Vec<[f64; REFERENCES]>,
    /// The same of points between which one shot may have no single echo.
    spaced_ns: Vec<[f64; REFERENCES]>,
    /// Peaks of outgoing pulses after the clock, ns.
    outgoing_ns: Vec<f64>,
    /// Emission times of all shots with an outgoing pulse, by reference, ns.
    emissions_ns: Vec<[f64; REFERENCES]>,
    interval_ns: f64,
}

/// A shot with a single echo.
#[derive(Clone, Copy)]
struct SampledEcho {
    echo_ns: f64,
    /// Emission time, by reference.
    emission_ns: [f64; REFERENCES],
    outgoing_ns: Option<f64>,
}

/// Robust SD of second differences, ns.
#[derive(Clone, Copy)]
struct SecondDifference {
    whole_ns: f64,
    /// Of the first and of the second half of the triples.
    halves_ns: [f64; 2],
}

/// The chosen reference and what to report about it.
pub(crate) struct Choice {
    pub(crate) reference: EmissionReference,
    /// See [`InputInfo::clock_sd_ns`].
    clock_sd_ns: Option<f64>,
    /// See [`InputInfo::emission_choice_sd_ns`].
    choice_sd_ns: f64,
    pub(crate) message: Option<ChoiceMessage>,
}

impl Choice {
    /// Metadata of the recording with this choice.
    pub(crate) fn describe(&self, input: &InputInfo) -> InputInfo {
        InputInfo {
            emission_reference: self.reference,
            clock_sd_ns: self.clock_sd_ns,
            emission_choice_sd_ns: self.choice_sd_ns,
            ..input.clone()
        }
    }
}

/// A message of a reader about its recording.
pub(crate) enum ChoiceMessage {
    Finding(String),
    Warning(String),
}

impl ChoiceMessage {
    pub(crate) fn report(self, cx: &mut Context) {
        match self {
            ChoiceMessage::Finding(text) => cx.info(text),
            ChoiceMessage::Warning(text) => cx.warn(text),
        }
    }
}

impl Smoothness {
    fn by(references: &'static [EmissionReference]) -> Smoothness {
        Smoothness {
            references,
            shots: 0,
            points_ns: Vec::new(),
            ranges_ns: Vec::new(),
            spaced_ns: Vec::new(),
            outgoing_ns: Vec::new(),
            emissions_ns: Vec::new(),
            interval_ns: f64::NAN,
        }
    }

    /// Whether more shots would change nothing.
    fn is_enough(&self) -> bool {
        self.points_ns.len() >= ENOUGH_TRIPLES
    }

    /// Reads a recording ahead, until it suffices for a decision.
    ///
    /// A read error ends the look-ahead; the run reports it.
    pub(crate) fn look_ahead(
        source: &mut dyn Source,
        references: &'static [EmissionReference],
    ) -> Smoothness {
        let mut found = Smoothness::by(references);
        // Warnings about the recording belong to the run: this context logs none.
        let mut cx = Context::default();
        while !found.is_enough() && found.shots < MOST_SHOTS {
            let Ok(Some(mut line)) = source.next(&mut cx) else { break };
            line.mark_copies();
            found.add(&line);
        }
        found
    }

    fn add(&mut self, line: &ScanLine) {
        self.shots += line.emissions.len();
        self.interval_ns = line.input.sampling_interval_ns;
        let Some(blocks) = line.blocks() else { return };
        let mut singles = vec![None; line.emissions.len()];
        for (index, of_shot) in blocks.by_emission() {
            if let Some(single) = singles.get_mut(index as usize) {
                *single = single_echo(blocks, of_shot, index, self.references);
            }
            if let Some(outgoing) = OutgoingPeak::of(blocks, of_shot) {
                let of = |reference: &EmissionReference| outgoing.emission_ns(*reference).unwrap_or(0.0);
                let mut emission_ns = [0.0; REFERENCES];
                emission_ns.iter_mut().zip(self.references).for_each(|(ns, reference)| *ns = of(reference));
                self.emissions_ns.push(emission_ns);
            }
        }
        self.outgoing_ns.extend(singles.iter().flatten().filter_map(|single| single.outgoing_ns));
        let metres_per_ns = line.input.group_velocity_mps * 0.5e-9;
        // The second difference of a waveform and its copies would be 0.
        let distinct =
            line.emissions.iter().copied().zip(singles).filter(|(emission, _)| !emission.is_copy());
        let echoes: Vec<(usize, Emission, SampledEcho)> = (distinct.enumerate())
            .filter_map(|(place, (emission, single))| Some((place, emission, single?)))
            .collect();
        for &[(i, a, x), (j, b, y), (k, c, z)] in echoes.array_windows() {
            let steps = [j - i, k - j];
            if steps[0].max(steps[1]) > MOST_STEP {
                continue;
            }
            // The middle point less the line through the others, times -2.
            let of_first = 2.0 * steps[1] as f64 / (k - i) as f64;
            let factors = [of_first, -2.0, 2.0 - of_first];
            let [mut points_ns, mut ranges_ns] = [[f64::NAN; REFERENCES]; 2];
            for reference in 0..self.references.len() {
                let flight_ns = [x, y, z].map(|single| single.echo_ns - single.emission_ns[reference]);
                ranges_ns[reference] = flight_ns.iter().zip(factors).map(|(ns, factor)| ns * factor).sum();
                points_ns[reference] = along_beam_ns([a, b, c], flight_ns, factors, metres_per_ns);
            }
            self.spaced_ns.push(points_ns);
            if steps == [1, 1] {
                self.points_ns.push(points_ns);
                self.ranges_ns.push(ranges_ns);
            }
        }
    }

    /// Decides for the reference of the smoothest points.
    ///
    /// A reference is ruled out if another leaves less than 0.8 of its second differences in both
    /// halves of the triples. The default is kept unless it is ruled out. `is_stated`: the file
    /// states its reference, so no decision is needed.
    pub(crate) fn choose(&self, default: EmissionReference, is_stated: bool) -> Choice {
        let n = self.points_ns.len();
        if n < LEAST_TRIPLES {
            let why = format!(
                "{n} triples of neighbouring single echoes in the first {} shots, {LEAST_TRIPLES} needed",
                self.shots
            );
            return self.keep(default, is_stated, self.references, &why);
        }
        let figures = self.figures(&self.points_ns);
        let is_ruled_out = |of: &SecondDifference| figures.iter().any(|(_, by)| by.is_clearly_below(of));
        let left: Vec<EmissionReference> =
            figures.iter().filter(|(_, of)| !is_ruled_out(of)).map(|(reference, _)| *reference).collect();
        match left[..] {
            [only] => self.set(only),
            [first, ..] if !left.contains(&default) => {
                let choice_sd_ns = self.choice_sd_ns(&left);
                Choice { choice_sd_ns, message: self.finding(first, choice_sd_ns), ..self.take(first) }
            }
            _ => self.keep(default, is_stated, &left, &self.text()),
        }
    }

    /// Takes a reference without a comparison.
    pub(crate) fn take(&self, reference: EmissionReference) -> Choice {
        let clock_sd_ns = self.clock_sd_ns();
        Choice { reference, clock_sd_ns, choice_sd_ns: 0.0, message: self.finding(reference, 0.0) }
    }

    /// The finding about a reference; `None` without second differences.
    fn finding(&self, reference: EmissionReference, choice_sd_ns: f64) -> Option<ChoiceMessage> {
        let mut text = format!("emission times by `emission = \"{}\"`: {}", name(reference), self.text());
        if let (EmissionReference::Clock, Some(sd_ns)) = (reference, self.clock_sd_ns()) {
            text.push_str(&format!(
                "; standard deviations of ranges include a jitter of the clock of {sd_ns:.2} ns, an upper bound by \
                 the smoothest quarter of these points"
            ));
        }
        if choice_sd_ns > 0.0 {
            text.push_str(&format!("; {}", with_choice(choice_sd_ns)));
        }
        (!self.points_ns.is_empty()).then_some(ChoiceMessage::Finding(text))
    }

    /// Keeps the default without a decision between the references that are `left`.
    fn keep(
        &self,
        default: EmissionReference,
        is_stated: bool,
        left: &[EmissionReference],
        why: &str,
    ) -> Choice {
        if is_stated {
            let choice = self.set(default);
            let message = choice.message.filter(|_| self.points_ns.len() >= LEAST_TRIPLES);
            return Choice { message, ..choice };
        }
        let choice_sd_ns = self.choice_sd_ns(left);
        let message = ChoiceMessage::Warning(format!(
            "the source of emission times is uncertain ({why}): `emission = \"{}\"` is assumed, and ranges may \
             have a constant error; {}; set `emission` of the reader if the instrument's description states it",
            name(default),
            with_choice(choice_sd_ns)
        ));
        Choice { choice_sd_ns, message: Some(message), ..self.take(default) }
    }

    /// SD of the clock, ns, if the points prove it to be below the SD of a position within one sample.
    ///
    /// From the lower quartile of absolute second differences: terrain only makes small ones rarer, so any
    /// quantile bounds a normal jitter from above, and a low one includes less of the terrain. The larger
    /// of the two halves of the triples: what one half shows must hold for the other.
    ///
    /// A clock that is a sample of the digitiser drifts through its phases: neighbouring shots then have
    /// nearly the same error, except where it jumps by a sample. Such jumps disprove the bound.
    fn clock_sd_ns(&self) -> Option<f64> {
        let clock = self.references.iter().position(|reference| *reference == EmissionReference::Clock)?;
        let (first, second) = self.points_ns.split_at(self.points_ns.len() / 2);
        let halves_ns = [first, second].map(|half| sd_of_lower_quartile(half.iter().map(|of| of[clock])));
        let sd_ns = halves_ns.into_iter().fold(0.0, f64::max) / SECOND_DIFFERENCE;
        let is_proof = self.points_ns.len() >= LEAST_TRIPLES && sd_ns < self.interval_ns / 12f64.sqrt();
        let of_clock: Vec<f64> = self.points_ns.iter().map(|of| of[clock] / self.interval_ns).collect();
        (is_proof && part_at(&of_clock, 1.0, NEAR_SAMPLE, JUMPS_SD) == 0.0).then_some(sd_ns)
    }

    /// Part of the second differences that are two samples, if they are significantly more than others.
    fn displaced_part(&self, reference: usize) -> f64 {
        let of_points: Vec<f64> = self.spaced_ns.iter().map(|of| of[reference] / self.interval_ns).collect();
        let sd = sd_of_lower_quartile(of_points.iter().copied());
        part_at(&of_points, 2.0, sd.clamp(NEAR_SAMPLE, MOST_NEAR_SAMPLE), DISPLACED_SD)
    }

    /// SD of emission times for a choice between references, ns.
    ///
    /// Their differences in each shot, without the constant part, over √12; the RMS over the shots.
    fn choice_sd_ns(&self, left: &[EmissionReference]) -> f64 {
        let usual_ns: Vec<f64> = (0..self.references.len())
            .map(|i| median(self.emissions_ns.iter().map(|of| of[i])).unwrap_or(f64::NAN))
            .collect();
        let spread_ns = |of: &[f64; REFERENCES]| {
            let (mut least_ns, mut most_ns) = (f64::INFINITY, f64::NEG_INFINITY);
            for ((reference, usual_ns), emission_ns) in self.references.iter().zip(&usual_ns).zip(of) {
                if left.contains(reference) {
                    let ns = emission_ns - usual_ns;
                    (least_ns, most_ns) = (least_ns.min(ns), most_ns.max(ns));
                }
            }
            (most_ns - least_ns).max(0.0)
        };
        let n = self.emissions_ns.len().max(1) as f64;
        (self.emissions_ns.iter().map(|of| spread_ns(of).powi(2)).sum::<f64>() / n / 12.0).sqrt()
    }

    /// Whether origins of shots move with their outgoing pulses.
    ///
    /// Points are then smooth by the clock, and ranges only by the outgoing pulse.
    pub(crate) fn origins_follow_outgoing(&self) -> bool {
        let figures = self.figures(&self.ranges_ns);
        let of = |wanted| figures.iter().find(|(reference, _)| *reference == wanted).map(|(_, of)| *of);
        match (of(EmissionReference::OutgoingPulse), of(EmissionReference::Clock)) {
            (Some(pulse), Some(clock)) => {
                self.ranges_ns.len() >= LEAST_TRIPLES && pulse.is_clearly_below(&clock)
            }
            _ => false,
        }
    }

    /// Median peak of the outgoing pulses after the clock, ns; 0 without any.
    pub(crate) fn outgoing_ns(&self) -> f64 {
        median(self.outgoing_ns.iter().copied()).unwrap_or(0.0)
    }

    /// The second differences of all references.
    pub(crate) fn text(&self) -> String {
        let of = |(reference, of): &(EmissionReference, SecondDifference)| {
            format!("{} {:.2} ns", name(*reference), of.whole_ns)
        };
        let figures: Vec<String> = self.figures(&self.points_ns).iter().map(of).collect();
        let n = self.points_ns.len();
        format!("second differences of points along the beam {} (robust SD of {n})", figures.join(", "))
    }

    fn figures(&self, differences: &[[f64; REFERENCES]]) -> Vec<(EmissionReference, SecondDifference)> {
        let (first, second) = differences.split_at(differences.len() / 2);
        let of = |i: usize| SecondDifference {
            whole_ns: robust_sd(differences.iter().map(|of| of[i])),
            halves_ns: [first, second].map(|half| robust_sd(half.iter().map(|of| of[i]))),
        };
        self.references.iter().enumerate().map(|(i, &reference)| (reference, of(i))).collect()
    }
}

impl SecondDifference {
    fn is_clearly_below(&self, other: &SecondDifference) -> bool {
        self.is_below(CLEARLY_SMOOTHER, other)
    }

    /// Whether it is less than this part of another one in both halves.
    fn is_below(&self, part: f64, other: &SecondDifference) -> bool {
        self.halves_ns.iter().zip(other.halves_ns).all(|(own, other)| *own < part * other)
    }
}

/// Name of a reference, as the container and the keys of readers write it.
pub(crate) fn name(reference: EmissionReference) -> &'static str {
    crate::container_info::reference_of(reference).name()
}

/// Sum of three points along the middle beam, multiplied by these factors, ns.
fn along_beam_ns(
    emissions: [Emission; 3],
    flight_ns: [f64; 3],
    factors: [f64; 3],
    metres_per_ns: f64,
) -> f64 {
    let beam = |of: &Emission| of.direction.map(|x| x * of.frame_scale * metres_per_ns);
    let middle = beam(&emissions[1]);
    let square: f64 = middle.iter().map(|x| x * x).sum();
    let mut sum = 0.0;
    for ((of, flight_ns), factor) in emissions.iter().zip(flight_ns).zip(factors) {
        let beam = beam(of);
        sum += factor
            * (0..3).map(|axis| (of.origin_m[axis] + beam[axis] * flight_ns) * middle[axis]).sum::<f64>();
    }
    sum / square
}

/// The echo of a shot with one block, if it is single, with the emission times by all references.
fn single_echo(
    blocks: &Blocks,
    of_shot: &[Block],
    index: u32,
    references: &[EmissionReference],
) -> Option<SampledEcho> {
    let mut echoes = of_shot.iter().filter(|block| block.channel.is_echo());
    let (Some(block), None) = (echoes.next(), echoes.next()) else { return None };
    let samples = blocks.samples(block);
    let echo_ns = block.time_ns(single_peak(samples, true)?);
    let outgoing = OutgoingPeak::of(blocks, of_shot);
    let location_ns = match blocks.online_of(index) {
        [online] => Some(online.time_ns),
        _ => None,
    };
    let mut emission_ns = [0.0; REFERENCES];
    for (emission_ns, reference) in emission_ns.iter_mut().zip(references) {
        *emission_ns = match reference {
            EmissionReference::ReturnLocations => echo_ns - location_ns?,
            EmissionReference::Clock => 0.0,
            _ => outgoing.as_ref()?.emission_ns(*reference)?,
        };
    }
    Some(SampledEcho { echo_ns, emission_ns, outgoing_ns: outgoing.map(|outgoing| outgoing.peak_ns) })
}

/// Peak of the outgoing pulse of a shot.
struct OutgoingPeak {
    /// After the clock, ns.
    peak_ns: f64,
    /// After the nearest sample, ns.
    fraction_ns: f64,
}

impl OutgoingPeak {
    fn of(blocks: &Blocks, of_shot: &[Block]) -> Option<OutgoingPeak> {
        let block = of_shot.iter().find(|block| block.channel == Channel::Reference)?;
        let position = single_peak(blocks.samples(block), false)?;
        let fraction_ns = (position - position.round()) * block.interval_ns;
        Some(OutgoingPeak { peak_ns: block.time_ns(position), fraction_ns })
    }

    /// Emission time after the clock, ns; `None` by return locations.
    fn emission_ns(&self, reference: EmissionReference) -> Option<f64> {
        match reference {
            EmissionReference::OutgoingPulse => Some(self.peak_ns),
            EmissionReference::OutgoingPulseFraction => Some(self.fraction_ns),
            EmissionReference::Clock => Some(0.0),
            EmissionReference::ReturnLocations => None,
        }
    }
}

/// States that standard deviations include the choice.
fn with_choice(sd_ns: f64) -> String {
    format!("standard deviations of ranges include {sd_ns:.2} ns for the choice")
}

/// Peak of an outgoing pulse, samples from the first of its block.
pub(crate) fn outgoing_peak(samples: &[u16]) -> Option<f64> {
    single_peak(samples, false)
}

/// Position of the peak of a block with a single echo, samples.
pub(crate) fn lone_peak(samples: &[u16]) -> Option<f64> {
    single_peak(samples, true)
}

/// Position of the highest peak of a block, samples.
///
/// With `is_alone`, `None` if other samples are high as well.
fn single_peak(samples: &[u16], is_alone: bool) -> Option<f64> {
    // A quarter of the samples is free of signal even in short blocks.
    if samples.is_empty() {
        return None;
    }
    let mut sorted = samples.to_vec();
    let background = f64::from(*sorted.select_nth_unstable(samples.len() / 4).1);
    let signal: Vec<f64> = samples.iter().map(|&sample| f64::from(sample) - background).collect();
    let (peak, above_half) = peak_above_half(&signal)?;
    if !is_above_noise(peak.height_dn, &signal) {
        return None;
    }
    let near = above_half.start.saturating_sub(above_half.len())..above_half.end + above_half.len();
    let is_disturbed =
        signal.iter().enumerate().any(|(i, &dn)| !near.contains(&i) && dn > BESIDE * peak.height_dn);
    (!is_alone || !is_disturbed).then_some(peak.position_samples)
}

/// Whether a height is at least [`LEAST_SNR`] times the noise SD.
///
/// The noise SD is that from the median absolute second difference of the samples. Counting those
/// below the limit compares it without sorting.
fn is_above_noise(height_dn: f64, signal: &[f64]) -> bool {
    let largest_dn = height_dn * 6f64.sqrt() / (LEAST_SNR * SD_OF_MEDIAN);
    let is_small = |of: &[f64; 3]| (of[0] - 2.0 * of[1] + of[2]).abs() <= largest_dn;
    let small = signal.array_windows().filter(|of| is_small(of)).count();
    height_dn >= LEAST_SNR * LEAST_NOISE_DN && 2 * small > signal.len().saturating_sub(2)
}

/// Part of the second differences, in samples, that are `near` this number, if they are more than those a
/// little below and above by `excess_sd` standard deviations of the count; else 0.
fn part_at(differences: &[f64], samples: f64, near: f64, excess_sd: f64) -> f64 {
    let within = |least: f64, most: f64| {
        let is_within = |of: &&f64| (least..most).contains(&(of.abs() - samples).abs());
        differences.iter().filter(is_within).count() as f64
    };
    let (at, beside) = (within(0.0, near), within(near, 2.0 * near));
    let is_excess = at > beside + excess_sd * (beside + 1.0).sqrt();
    if is_excess { at / differences.len() as f64 } else { 0.0 }
}

/// SD of a normal distribution whose absolute values have the lower quartile of these; NaN without values.
fn sd_of_lower_quartile(values: impl Iterator<Item = f64>) -> f64 {
    let mut sizes: Vec<f64> = values.map(f64::abs).collect();
    let at = sizes.len() / 4;
    if sizes.is_empty() {
        return f64::NAN;
    }
    SD_OF_LOWER_QUARTILE * *sizes.select_nth_unstable_by(at, f64::total_cmp).1
}

/// Robust SD; NaN without values.
fn robust_sd(values: impl Iterator<Item = f64> + Clone) -> f64 {
    let centre = median(values.clone()).unwrap_or(f64::NAN);
    SD_OF_MEDIAN * median(values.map(|value| (value - centre).abs())).unwrap_or(f64::NAN)
}

#[cfg(test)]
mod tests;

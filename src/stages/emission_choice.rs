//! Choice of the emission reference by the smoothness of points.
//!
//! Points of neighbouring single echoes form a smooth line. The second differences of three
//! consecutive points along the beam show the jitter that a wrong emission time adds.

use tracing::subscriber::{NoSubscriber, with_default};

use crate::scan_line::{Block, Blocks, Channel, Emission, EmissionReference, ScanLine};
use crate::stage::{Context, Source};
use wavex_signal::fusion::peak_above_half;

/// References between which recordings with outgoing pulses decide, in order of preference.
pub(super) const WITH_OUTGOING: &[EmissionReference] =
    &[EmissionReference::OutgoingPulse, EmissionReference::OutgoingPulseFraction, EmissionReference::Clock];
/// References between which recordings with return locations decide, in order of preference.
pub(super) const WITH_LOCATIONS: &[EmissionReference] =
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
/// Smallest noise of a digitised signal, DN: that of rounding.
const LEAST_NOISE_DN: f64 = 0.3;
/// Standard deviation of a normal distribution over its median absolute deviation.
const SD_OF_MEDIAN: f64 = 1.4826;

/// Second differences of neighbouring single echoes, by emission reference.
pub(super) struct Smoothness {
    references: &'static [EmissionReference],
    shots: usize,
    /// Second differences of points along the beam and of ranges, ns, by reference.
    points_ns: Vec<[f64; REFERENCES]>,
    ranges_ns: Vec<[f64; REFERENCES]>,
    /// Peaks of outgoing pulses after the clock, ns.
    outgoing_ns: Vec<f64>,
}

/// A shot with a single echo.
#[derive(Clone, Copy)]
struct SingleEcho {
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
pub(super) struct Choice {
    pub(super) reference: EmissionReference,
    pub(super) message: Option<Message>,
}

/// A message of a reader about its recording.
pub(super) enum Message {
    Finding(String),
    Warning(String),
}

impl Message {
    pub(super) fn report(self, cx: &mut Context) {
        match self {
            Message::Finding(text) => cx.info(text),
            Message::Warning(text) => cx.warn(text),
        }
    }
}

impl Smoothness {
    /// Reads a recording ahead, until it suffices for a decision.
    ///
    /// A read error ends the look-ahead; the run reports it.
    pub(super) fn look_ahead(
        source: &mut dyn Source,
        references: &'static [EmissionReference],
    ) -> Smoothness {
        let mut found = Smoothness {
            references,
            shots: 0,
            points_ns: Vec::new(),
            ranges_ns: Vec::new(),
            outgoing_ns: Vec::new(),
        };
        // Warnings about the recording belong to the run.
        with_default(NoSubscriber::default(), || {
            let mut cx = Context::default();
            while found.points_ns.len() < ENOUGH_TRIPLES && found.shots < MOST_SHOTS {
                let Ok(Some(line)) = source.next(&mut cx) else { break };
                found.add(&line);
            }
        });
        found
    }

    fn add(&mut self, line: &ScanLine) {
        self.shots += line.emissions.len();
        let Some(blocks) = line.blocks() else { return };
        let mut singles = vec![None; line.emissions.len()];
        for (index, of_shot) in blocks.by_emission() {
            if let Some(single) = singles.get_mut(index as usize) {
                *single = single_echo(blocks, of_shot, index, self.references);
            }
        }
        self.outgoing_ns.extend(singles.iter().flatten().filter_map(|single| single.outgoing_ns));
        let metres_per_ns = line.input.group_velocity_mps * 0.5e-9;
        for (emissions, singles) in line.emissions.windows(3).zip(singles.windows(3)) {
            let (&[a, b, c], &[Some(x), Some(y), Some(z)]) = (emissions, singles) else { continue };
            let [mut points_ns, mut ranges_ns] = [[f64::NAN; REFERENCES]; 2];
            for i in 0..self.references.len() {
                let flight_ns = [x, y, z].map(|single| single.echo_ns - single.emission_ns[i]);
                ranges_ns[i] = flight_ns[0] - 2.0 * flight_ns[1] + flight_ns[2];
                points_ns[i] = along_beam_ns([a, b, c], flight_ns, metres_per_ns);
            }
            self.points_ns.push(points_ns);
            self.ranges_ns.push(ranges_ns);
        }
    }

    /// Decides for the reference of the smoothest points.
    ///
    /// A reference is ruled out if another leaves less than 0.8 of its second differences in both
    /// halves of the triples. The default is kept unless it is ruled out. `is_stated`: the file
    /// states its reference, so no decision is needed.
    pub(super) fn choose(&self, default: EmissionReference, is_stated: bool) -> Choice {
        let n = self.points_ns.len();
        if n < LEAST_TRIPLES {
            let why = format!(
                "{n} triples of neighbouring single echoes in the first {} shots, {LEAST_TRIPLES} needed",
                self.shots
            );
            return self.keep(default, is_stated, &why);
        }
        let figures = self.figures(&self.points_ns);
        let is_ruled_out = |of: &SecondDifference| figures.iter().any(|(_, by)| by.is_clearly_below(of));
        let left: Vec<EmissionReference> =
            figures.iter().filter(|(_, of)| !is_ruled_out(of)).map(|(reference, _)| *reference).collect();
        match left[..] {
            [only] => self.take(only),
            [first, ..] if !left.contains(&default) => self.take(first),
            _ => self.keep(default, is_stated, &self.text()),
        }
    }

    /// Takes a reference, decided or set by the job.
    pub(super) fn take(&self, reference: EmissionReference) -> Choice {
        let text = format!("emission times by `emission = \"{}\"`: {}", name(reference), self.text());
        Choice { reference, message: (!self.points_ns.is_empty()).then_some(Message::Finding(text)) }
    }

    /// Keeps the default without a decision.
    fn keep(&self, default: EmissionReference, is_stated: bool, why: &str) -> Choice {
        let message = match is_stated {
            true if self.points_ns.len() < LEAST_TRIPLES => None,
            true => self.take(default).message,
            false => Some(Message::Warning(format!(
                "the source of emission times is uncertain ({why}): `emission = \"{}\"` is assumed, and \
                 ranges may have a constant error and a jitter of some samples; set `emission` of the reader \
                 if the instrument's description states it",
                name(default)
            ))),
        };
        Choice { reference: default, message }
    }

    /// Whether origins of shots move with their outgoing pulses.
    ///
    /// Points are then smooth by the clock, and ranges only by the outgoing pulse.
    pub(super) fn origins_follow_outgoing(&self) -> bool {
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
    pub(super) fn outgoing_ns(&self) -> f64 {
        if self.outgoing_ns.is_empty() { 0.0 } else { median(self.outgoing_ns.iter().copied()) }
    }

    /// The second differences of all references.
    pub(super) fn text(&self) -> String {
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
        self.halves_ns.iter().zip(other.halves_ns).all(|(own, other)| *own < CLEARLY_SMOOTHER * other)
    }
}

/// Name of a reference, as the container and the keys of readers write it.
pub(super) fn name(reference: EmissionReference) -> &'static str {
    super::container_info::reference_of(reference).name()
}

/// Second difference of three points along the middle beam, ns.
fn along_beam_ns(emissions: [Emission; 3], flight_ns: [f64; 3], metres_per_ns: f64) -> f64 {
    let beam = |of: &Emission| of.direction.map(|x| x * of.frame_scale * metres_per_ns);
    let middle = beam(&emissions[1]);
    let square: f64 = middle.iter().map(|x| x * x).sum();
    let mut sum = 0.0;
    for ((of, flight_ns), factor) in emissions.iter().zip(flight_ns).zip([1.0, -2.0, 1.0]) {
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
) -> Option<SingleEcho> {
    let mut echoes = of_shot.iter().filter(|block| block.channel.is_echo());
    let (Some(block), None) = (echoes.next(), echoes.next()) else { return None };
    let echo_ns = block.time_ns(single_peak(blocks.samples(block), true)?);
    let outgoing = of_shot.iter().find(|block| block.channel == Channel::Reference).and_then(|block| {
        let position = single_peak(blocks.samples(block), false)?;
        Some((block.time_ns(position), (position - position.round()) * block.interval_ns))
    });
    let location_ns = match blocks.online_of(index) {
        [online] => Some(online.time_ns),
        _ => None,
    };
    let mut emission_ns = [0.0; REFERENCES];
    for (emission_ns, reference) in emission_ns.iter_mut().zip(references) {
        *emission_ns = match reference {
            EmissionReference::OutgoingPulse => outgoing?.0,
            EmissionReference::OutgoingPulseFraction => outgoing?.1,
            EmissionReference::ReturnLocations => echo_ns - location_ns?,
            EmissionReference::Clock => 0.0,
        };
    }
    Some(SingleEcho { echo_ns, emission_ns, outgoing_ns: outgoing.map(|(time_ns, _)| time_ns) })
}

/// Peak of an outgoing pulse, samples from the first of its block.
pub(super) fn outgoing_peak(samples: &[u16]) -> Option<f64> {
    single_peak(samples, false)
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

/// Robust SD; NaN without values.
fn robust_sd(values: impl Iterator<Item = f64> + Clone) -> f64 {
    let centre = median(values.clone());
    SD_OF_MEDIAN * median(values.map(|value| (value - centre).abs()))
}

/// Median, the upper of the middle two; NaN without values.
fn median(values: impl Iterator<Item = f64>) -> f64 {
    let mut values: Vec<f64> = values.collect();
    let middle = values.len() / 2;
    if values.is_empty() { f64::NAN } else { *values.select_nth_unstable_by(middle, f64::total_cmp).1 }
}

#[cfg(test)]
mod tests;

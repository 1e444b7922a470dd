//! Range walk: delay of a receiver by amplitude, where the instrument has no table of it.

use std::path::{Path, PathBuf};

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::tables::{TwoTables, receiver_of};
use super::width::{CHANNELS, NOT_PLAIN, name};
use crate::process::calibrate::{Auto, load_model};
use wavex_formats::Error;
use wavex_line::scan_line::{LineStats, Return, ReturnChannel, ScanLine};
use wavex_line::stage::{Context, Result};
use wavex_returns::range_walk::{LearntWalk, RangeWalk, SingleEcho, Triple};
use wavex_signal::sensor_model::SensorModel;

/// Distance of the shots of different lines in the numbering of triples.
const LINE_GAP: u64 = 1000;

/// Note on the walk of a loaded model; a range table wins over it.
const LOADED: &str =
    "ranges without a range table are corrected for the delay by amplitude of the loaded sensor model";

/// Source of the range walk.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(untagged)]
pub enum WalkKey {
    /// Learnt from the first waveforms.
    Auto(Auto),
    /// That of the sensor model that `calibrate` loaded.
    Loaded(Loaded),
    /// `false`: none.
    #[schemars(extend("const" = false))]
    Without(bool),
    /// That of a saved sensor model.
    File(PathBuf),
}

/// The word `model`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Loaded {
    /// The loaded sensor model.
    Model,
}

impl WalkKey {
    pub(super) fn file(&self) -> Option<&Path> {
        match self {
            WalkKey::File(path) => Some(path),
            _ => None,
        }
    }

    pub(super) fn is_auto(&self) -> bool {
        matches!(self, WalkKey::Auto(_))
    }
}

/// Walk of one receiver.
#[derive(Clone, Debug, PartialEq)]
enum Walk {
    /// It is subtracted.
    Applied(RangeWalk),
    /// It was seen and did not prove itself: it enters the standard deviations.
    Possible(RangeWalk),
}

/// Walks of the low-power and of the high-power receiver.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Walks([Option<Walk>; 2]);

impl Walks {
    /// The walks of a sensor model.
    fn from_model(model: &SensorModel) -> Walks {
        let walks = [&model.low_power_range_walk, &model.high_power_range_walk];
        Walks(walks.map(|walk| walk.clone().map(Walk::Applied)))
    }

    /// The walks of a saved sensor model.
    pub(super) fn open(path: &Path) -> Result<Walks> {
        let walks = Walks::from_model(&load_model(path)?);
        if walks.is_empty() {
            let remedy =
                "give a model that `save_model` of correct wrote with a walk, or set `range_walk` to false";
            return Err(Error::unusable(path, "the sensor model has no range walk", remedy).into());
        }
        Ok(walks)
    }

    /// Whether no walk is subtracted.
    pub(super) fn is_empty(&self) -> bool {
        !(self.has(0) || self.has(1))
    }

    /// The model with the walks that are subtracted.
    pub(super) fn with_walks(&self, model: &SensorModel) -> SensorModel {
        let [low_power_range_walk, high_power_range_walk] = self.0.each_ref().map(|walk| match walk {
            Some(Walk::Applied(walk)) => Some(walk.clone()),
            _ => None,
        });
        SensorModel { low_power_range_walk, high_power_range_walk, ..model.clone() }
    }

    /// Walks of the sensor model of the lines, with a note.
    pub(super) fn of_model(lines: &[ScanLine], cx: &mut Context) -> Walks {
        let walks = Walks::of_lines(lines);
        if !walks.is_empty() {
            cx.info(LOADED);
        }
        walks
    }

    fn of_lines(lines: &[ScanLine]) -> Walks {
        let model = lines.iter().find_map(|line| line.model.as_deref());
        model.map(Walks::from_model).unwrap_or_default()
    }

    /// Walks learnt from the lines, for receivers without a range table; the walk of the sensor
    /// model is what they are expected to be, and is used where none proves itself.
    ///
    /// None are learnt if both receivers are fused: their ranges are aligned already, and each walk
    /// has its own zero.
    pub(super) fn learnt(lines: &[ScanLine], tables: &TwoTables, cx: &mut Context) -> Walks {
        if lines.iter().any(|line| line.fusion.is_some()) {
            cx.info("no delay by amplitude was learnt: both receivers are fused");
            return Walks::of_model(lines, cx);
        }
        let mut walks = Walks::of_lines(lines);
        for channel in CHANNELS {
            let receiver = receiver_of(channel);
            if tables[receiver].is_none() {
                let expected = walks.0[receiver].take();
                walks.0[receiver] = learn(lines, channel, expected, cx);
            }
        }
        walks
    }

    /// Whether the ranges of a receiver are corrected.
    pub(super) fn has(&self, receiver: usize) -> bool {
        matches!(self.0[receiver], Some(Walk::Applied(_)))
    }

    /// Subtracts the walk of the receiver from a return.
    pub(super) fn correct(&self, r: &mut Return, half_speed_m_per_ns: f64, stats: &mut LineStats) {
        let walk = match r.channel {
            // The fit in both receivers has no single delay.
            ReturnChannel::Joint => return,
            channel => &self.0[receiver_of(channel)],
        };
        let (amplitude_dn, amplitude_sd_dn) = r.amplitude_at_unit_gain_dn();
        let (late_ns, late_sd_ns) = match walk {
            None => return,
            Some(Walk::Possible(walk)) => (0.0, walk.not_applied_sd_ns(amplitude_dn)),
            Some(Walk::Applied(walk)) => {
                let correction = walk.correction(amplitude_dn);
                let by_amplitude_ns = walk.slope_ns_per_dn(amplitude_dn) * amplitude_sd_dn;
                (correction.late_ns, correction.remaining_sd_ns.hypot(by_amplitude_ns))
            }
        };
        r.time_of_flight_ns -= late_ns;
        r.time_of_flight_sd_ns = r.time_of_flight_sd_ns.hypot(late_sd_ns);
        r.range_m -= half_speed_m_per_ns * late_ns;
        r.range_sd_m = r.range_sd_m.hypot(half_speed_m_per_ns * late_sd_ns);
        stats.np_ibrc += u64::from(late_ns != 0.0);
    }
}

/// Delays at a few amplitudes, in words.
fn delays(walk: &RangeWalk) -> String {
    let [least_dn, most_dn] = walk.amplitudes_dn;
    let middle = |dn: f64| (dn * walk.reference_dn).sqrt();
    let at = |dn: f64| {
        let (late_ns, sd_ns) = walk.late_ns(dn);
        format!("{:+.0} ± {:.0} ps at {dn:.0} DN", 1e3 * late_ns, 1e3 * sd_ns)
    };
    let texts = [least_dn, middle(least_dn), middle(most_dn), most_dn].map(at).join(", ");
    format!("{texts} against {:.0} DN", walk.reference_dn)
}

/// Learns the walk of a receiver, with a finding; `expected` is the walk of the loaded model.
///
/// `expected` again if the recording shows none that proves itself.
fn learn(
    lines: &[ScanLine],
    channel: ReturnChannel,
    expected: Option<Walk>,
    cx: &mut Context,
) -> Option<Walk> {
    let triples = triples(lines, channel);
    if triples.is_empty() && expected.is_none() {
        return None;
    }
    let before = match &expected {
        Some(Walk::Applied(walk)) => Some(walk),
        _ => None,
    };
    let name = name(channel);
    let (walk, proof) = match RangeWalk::learn(&triples, before) {
        Ok(LearntWalk { walk, proof }) => (walk, proof),
        Err(reason) => {
            let kept = if expected.is_some() { "; that of the loaded sensor model is used" } else { "" };
            cx.info(format!("{name}: no delay by amplitude was learnt: {reason}{kept}"));
            return expected;
        }
    };
    let delays = delays(&walk);
    let Some(refusal) = proof.refusal() else {
        let [first, second] = proof.halves;
        cx.info(format!(
            "{name}: ranges are corrected for the delay by amplitude, learnt from {} triples of neighbouring single \
             returns: {delays}. Proof: the delay from one half of the lines explains {:.2} ± {:.2} of the delay in the other \
             half, and {:.2} ± {:.2} with the halves exchanged (1 is all of it); with the correction, second differences of \
             ranges fall by {:.1} standard deviations",
            walk.triples,
            first.value,
            first.sd,
            second.value,
            second.sd,
            proof.fall.ratio(),
        ));
        return Some(Walk::Applied(walk));
    };
    if expected.is_some() {
        cx.info(format!(
            "{name}: the delay by amplitude of the loaded sensor model is kept, because that of the recording is not \
             proven: {refusal}"
        ));
        return expected;
    }
    let is_seen = walk.is_seen();
    let seen = if is_seen {
        "what was seen enters the standard deviations of ranges"
    } else {
        "none is significant"
    };
    cx.info(format!(
        "{name}: ranges are not corrected for a delay by amplitude, because it is not proven: {refusal}; {seen} \
         ({delays})"
    ));
    is_seen.then_some(Walk::Possible(walk))
}

/// Single returns of three consecutive shots of a line.
fn triples(lines: &[ScanLine], channel: ReturnChannel) -> Vec<Triple> {
    let mut triples = Vec::new();
    let mut first_shot = 0;
    for line in lines {
        let mut singles = vec![None; line.emissions.len()];
        for r in line.returns().into_iter().flatten() {
            let is_single = r.number_of_returns == 1 && r.channel == channel && r.flags & NOT_PLAIN == 0;
            if let Some(single) = singles.get_mut(r.emission as usize).filter(|_| is_single) {
                *single = Some(SingleEcho {
                    flight_ns: r.time_of_flight_ns,
                    flight_sd_ns: r.time_of_flight_sd_ns,
                    amplitude_dn: r.amplitude_at_unit_gain_dn().0,
                });
            }
        }
        // The second difference of a waveform and its copies would be 0.
        for (single, emission) in singles.iter_mut().zip(&line.emissions) {
            *single = single.take().filter(|_| !emission.is_copy());
        }
        for (shot, singles) in (first_shot..).zip(singles.windows(3)) {
            if let &[Some(a), Some(b), Some(c)] = singles {
                triples.push(Triple { echoes: [a, b, c], shot });
            }
        }
        first_shot += singles.len() as u64 + LINE_GAP;
    }
    triples
}

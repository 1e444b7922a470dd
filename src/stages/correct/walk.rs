//! Range walk: delay of a receiver by amplitude, where the instrument has no table of it.

use std::path::{Path, PathBuf};

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::tables::{Both, receiver_of};
use super::width::{CHANNELS, NOT_PLAIN, name};
use crate::scan_line::{LineStats, Return, ReturnChannel, ScanLine};
use crate::stage::{Context, Result};
use crate::stages::calibrate::{Auto, load_model};
use wavex_formats::Error;
use wavex_signal::range_walk::{RangeWalk, SingleEcho, Triple};
use wavex_signal::sensor_model::SensorModel;

/// Distance of the shots of different lines in the numbering of triples.
const LINE_GAP: u64 = 1000;

/// Source of the range walk.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(untagged)]
pub enum WalkKey {
    /// That of the loaded sensor model, otherwise learnt from the first waveforms.
    Auto(Auto),
    /// `false`: none.
    Without(bool),
    /// That of a saved sensor model.
    File(PathBuf),
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

/// Walks of the low-power and of the high-power receiver.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Walks([Option<RangeWalk>; 2]);

impl Walks {
    /// The walks of a sensor model.
    fn from_model(model: &SensorModel) -> Walks {
        Walks([model.low_power_range_walk, model.high_power_range_walk])
    }

    /// The walks of a saved sensor model.
    pub(super) fn open(path: &Path) -> Result<Walks> {
        let walks = Walks::from_model(&load_model(path)?);
        if walks.is_empty() {
            let remedy = "give a model that `save_model` of correct wrote with a walk, or leave `range_walk` at \"auto\"";
            return Err(Error::unusable(path, "the sensor model has no range walk", remedy).into());
        }
        Ok(walks)
    }

    pub(super) fn is_empty(&self) -> bool {
        self.0.iter().all(Option::is_none)
    }

    /// The model with these walks.
    pub(super) fn with_walks(&self, model: &SensorModel) -> SensorModel {
        let [low_power_range_walk, high_power_range_walk] = self.0;
        SensorModel { low_power_range_walk, high_power_range_walk, ..model.clone() }
    }

    /// Walks of the model of the lines, otherwise those learnt from them, for receivers without a
    /// range table.
    ///
    /// None if both receivers are fused: their ranges are aligned already, and each walk has its own
    /// zero.
    pub(super) fn learnt(lines: &[ScanLine], tables: &Both, cx: &mut Context) -> Walks {
        if let Some(walks) = lines.iter().find_map(|line| line.model.as_deref()).map(Walks::from_model)
            && !walks.is_empty()
        {
            cx.info("ranges are corrected for the delay by amplitude of the loaded sensor model");
            return walks;
        }
        if lines.iter().any(|line| line.fusion.is_some()) {
            cx.info("no delay by amplitude was learnt: both receivers are fused");
            return Walks::default();
        }
        let mut walks = Walks::default();
        for channel in CHANNELS {
            let receiver = receiver_of(channel);
            if tables[receiver].is_none() {
                walks.0[receiver] = learn(lines, channel, cx);
            }
        }
        walks
    }

    /// Whether the ranges of a receiver are corrected.
    pub(super) fn has(&self, receiver: usize) -> bool {
        self.0[receiver].is_some()
    }

    /// Subtracts the walk of the receiver from a return.
    pub(super) fn correct(&self, r: &mut Return, half_speed_m_per_ns: f64, stats: &mut LineStats) {
        let walk = match r.channel {
            // The fit in both receivers has no single delay.
            ReturnChannel::Joint => return,
            channel => &self.0[receiver_of(channel)],
        };
        let Some(walk) = walk else { return };
        let (amplitude_dn, amplitude_sd_dn) = r.amplitude_at_unit_gain_dn();
        let (late_ns, walk_sd_ns) = walk.late_ns(amplitude_dn);
        let late_sd_ns = walk_sd_ns.hypot(walk.slope_ns_per_dn(amplitude_dn) * amplitude_sd_dn);
        r.time_of_flight_ns -= late_ns;
        r.time_of_flight_sd_ns = r.time_of_flight_sd_ns.hypot(late_sd_ns);
        r.range_m -= half_speed_m_per_ns * late_ns;
        r.range_sd_m = r.range_sd_m.hypot(half_speed_m_per_ns * late_sd_ns);
        stats.np_ibrc += 1;
    }
}

/// Learns the walk of a receiver; `None`, with a finding, if the recording does not show one.
fn learn(lines: &[ScanLine], channel: ReturnChannel, cx: &mut Context) -> Option<RangeWalk> {
    let triples = triples(lines, channel);
    if triples.is_empty() {
        return None;
    }
    match RangeWalk::learn(&triples) {
        Ok(walk) => {
            let [least_dn, most_dn] = walk.amplitudes_dn;
            let at = |dn: f64| {
                let (late_ns, sd_ns) = walk.late_ns(dn);
                format!("{:+.0} ± {:.0} ps at {dn:.0} DN", 1e3 * late_ns, 1e3 * sd_ns)
            };
            cx.info(format!(
                "{}: ranges are corrected for the delay by amplitude, learnt from {} triples of neighbouring \
                 single returns: {}, {}, {}, {} against {:.0} DN",
                name(channel),
                walk.triples,
                at(least_dn),
                at((least_dn * walk.reference_dn).sqrt()),
                at((most_dn * walk.reference_dn).sqrt()),
                at(most_dn),
                walk.reference_dn
            ));
            Some(walk)
        }
        Err(reason) => {
            cx.info(format!("{}: no delay by amplitude was learnt: {reason}", name(channel)));
            None
        }
    }
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
        for (shot, singles) in (first_shot..).zip(singles.windows(3)) {
            if let &[Some(a), Some(b), Some(c)] = singles {
                triples.push(Triple { echoes: [a, b, c], shot });
            }
        }
        first_shot += singles.len() as u64 + LINE_GAP;
    }
    triples
}

//! Results of one shot in metres.

use wavex_footprints::{Candidate, FootprintMode, HEIGHTS, Measured, WithSd};
use wavex_geodesy::vertical::down_at;
use wavex_line::scan_line::{
    Block, Emission, Footprint, FootprintRecord, GroundCandidate, InputInfo, Return, footprint_flags,
};

/// LAS class of the ground.
const GROUND_CLASS: u8 = 2;
/// Probability from which the ground is not ambiguous.
const CLEAR: f64 = 0.9;
/// Most returns of a shot in LAS.
const MOST_RETURNS: usize = 15;

/// Footprint of a shot, with its modes as returns.
pub(super) struct ShotFootprint {
    pub(super) footprint: Footprint,
    pub(super) returns: Vec<Return>,
}

impl ShotFootprint {
    /// Converts what was measured in a block.
    pub(super) fn of(
        measured: &Measured,
        block: &Block,
        shot: &Emission,
        record: Option<&FootprintRecord>,
        input: &InputInfo,
        reflectance_ratio: f64,
    ) -> ShotFootprint {
        let metres = Metres::of(block, shot, input);
        let ground = measured.ground;
        let candidate = |found: Option<Candidate>| {
            let mode = found.and_then(|found| measured.modes.get(found.mode));
            GroundCandidate {
                range_m: mode.map_or(WithSd::UNKNOWN, |mode| metres.range(mode.position_samples)),
                probability: found.map_or(0.0, |found| found.probability),
            }
        };
        let height = |height: &WithSd| metres.height_m * height.value;
        let height_sd = |height: &WithSd| metres.height_m * height.sd;
        let all = |of: &dyn Fn(&WithSd) -> f64| {
            let mut values = Box::new([f32::NAN; HEIGHTS]);
            values
                .iter_mut()
                .zip(measured.heights_samples.iter())
                .for_each(|(to, from)| *to = of(from) as f32);
            values
        };
        let cover = cover(measured.ground_energy_ratio, reflectance_ratio);
        let footprint = Footprint {
            emission: block.emission,
            shot_number: record.map_or(shot.shot, |record| record.shot_number),
            ground: candidate(ground),
            top_range_m: metres.range(measured.top_samples),
            heights_m: all(&height),
            heights_sd_m: all(&height_sd),
            modes: measured.modes.len() as u32,
            energy_dn: measured.energy_dn,
            ground_energy_ratio: measured.ground_energy_ratio,
            cover,
            plant_area_index: plant_area_index(cover),
            sensitivity: measured.sensitivity,
            deviation_ratio: measured.deviation_ratio,
            flags: flags(measured, record),
            columns: record.map(|record| record.columns.clone()).unwrap_or_default(),
        };
        let lowest = measured.modes.len().saturating_sub(MOST_RETURNS);
        let modes = measured.modes.get(lowest..).unwrap_or_default();
        let returns = (lowest..).zip(modes).map(|(index, mode)| Return {
            emission: block.emission,
            return_number: (index - lowest + 1) as u8,
            number_of_returns: modes.len() as u8,
            class: if ground.is_some_and(|ground| ground.mode == index) { GROUND_CLASS } else { 0 },
            deviation_ratio: measured.deviation_ratio,
            ..metres.of_mode(mode, measured.background_dn)
        });
        ShotFootprint { returns: returns.collect(), footprint }
    }
}

/// Metres of the samples of a block.
struct Metres {
    /// Range of the first sample, m.
    first_m: f64,
    /// Range per sample, m.
    range_m: f64,
    /// Height per sample, m: vertical if the frame knows the vertical, else along the beam.
    height_m: f64,
    start_ns: f64,
    interval_ns: f64,
}

impl Metres {
    fn of(block: &Block, shot: &Emission, input: &InputInfo) -> Metres {
        let m_per_ns = 0.5e-9 * input.group_velocity_mps;
        let range_m = m_per_ns * block.interval_ns;
        let down = down_at(input.frame, shot.origin_m);
        let cosine =
            down.map_or(1.0, |down| down.iter().zip(shot.direction).map(|(a, b)| a * b).sum::<f64>().abs());
        Metres {
            first_m: m_per_ns * block.start_ns,
            range_m,
            height_m: range_m * shot.frame_scale * cosine,
            start_ns: block.start_ns,
            interval_ns: block.interval_ns,
        }
    }

    fn range(&self, position: WithSd) -> WithSd {
        WithSd { value: self.first_m + self.range_m * position.value, sd: self.range_m * position.sd }
    }

    fn of_mode(&self, mode: &FootprintMode, background_dn: f64) -> Return {
        let range_m = self.range(mode.position_samples);
        Return {
            time_of_flight_ns: self.start_ns + self.interval_ns * mode.position_samples.value,
            time_of_flight_sd_ns: self.interval_ns * mode.position_samples.sd,
            range_m: range_m.value,
            range_sd_m: range_m.sd,
            amplitude_dn: mode.amplitude_dn.value,
            amplitude_sd_dn: mode.amplitude_dn.sd,
            peak_dn: background_dn + mode.amplitude_dn.value,
            peak_sd_dn: mode.amplitude_dn.sd,
            intensity: mode.amplitude_dn.value,
            intensity_sd: mode.amplitude_dn.sd,
            width_ratio: f64::NAN,
            thickness_m: f64::NAN,
            ..Return::default()
        }
    }
}

/// Canopy cover from the ground's part of the energy: what the beam does not pass, for canopy and ground of these
/// reflectances.
fn cover(ground: WithSd, reflectance_ratio: f64) -> WithSd {
    let of_canopy = 1.0 - ground.value;
    let sum = of_canopy + reflectance_ratio * ground.value;
    WithSd { value: of_canopy / sum, sd: reflectance_ratio / sum.powi(2) * ground.sd }
}

/// Plant area index for randomly oriented leaves, whose projection is a half: twice the logarithm of the gaps.
fn plant_area_index(cover: WithSd) -> WithSd {
    let gaps = 1.0 - cover.value;
    WithSd { value: -2.0 * libm::log(gaps), sd: 2.0 * cover.sd / gaps }
}

fn flags(measured: &Measured, record: Option<&FootprintRecord>) -> u8 {
    let ground = measured.ground;
    let set = |bit: u8, is_set: bool| if is_set { bit } else { 0 };
    let [is_top_cut, _] = measured.is_cut;
    set(footprint_flags::GROUND_MISSING, ground.is_none())
        | set(footprint_flags::TOP_MISSING, is_top_cut)
        | set(footprint_flags::AMBIGUOUS, ground.is_some_and(|ground| ground.probability < CLEAR))
        | set(footprint_flags::DEGRADED, record.is_some_and(|record| record.is_degraded))
}

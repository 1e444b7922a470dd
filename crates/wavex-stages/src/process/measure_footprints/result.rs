//! Results of one shot in metres.

use wavex_footprints::{FootprintMode, HEIGHTS, Measured, WithSd, cover, plant_area_index};
use wavex_geodesy::vertical::down_at;
use wavex_line::scan_line::{
    Block, Emission, Footprint, FootprintRecord, InputInfo, Return, footprint_flags,
};

/// LAS class of the ground.
pub const GROUND_CLASS: u8 = 2;
/// Probability from which the ground is not ambiguous.
const CLEAR: f64 = 0.9;
/// Most returns of a shot in LAS.
const MOST_RETURNS: usize = 15;

/// One shot: its block, what the recording says of it, and whether samples are clipped.
pub(super) struct MeasuredShot<'a> {
    pub(super) block: &'a Block,
    pub(super) emission: &'a Emission,
    pub(super) record: Option<&'a FootprintRecord>,
    pub(super) is_clipped: bool,
    pub(super) input: &'a InputInfo,
}

impl MeasuredShot<'_> {
    /// The footprint, with its modes as returns.
    pub(super) fn footprint(&self, measured: &Measured, reflectance_ratio: f64) -> (Footprint, Vec<Return>) {
        let metres = Metres::of(self.block, self.emission, self.input);
        let ground = measured.ground();
        let of_ground = |value: fn(&FootprintMode) -> WithSd| ground.map_or(WithSd::UNKNOWN, value);
        let cover = cover(measured.ground_energy_ratio, reflectance_ratio);
        let footprint = Footprint {
            emission: self.block.emission,
            shot_number: self.record.map_or(self.emission.shot, |record| record.shot_number),
            ground_range_m: metres.range(of_ground(|mode| mode.position_samples)),
            ground_probability: measured.ground_probability,
            ground_total_sd_m: metres.range_m * measured.ground_total_sd_samples,
            second_ground_height_m: metres.second_height(measured),
            second_ground_probability: measured.second_ground.map_or(f64::NAN, |second| second.probability),
            ground_amplitude_dn: of_ground(|mode| mode.amplitude_dn),
            ground_half_width_ratios: ground.map_or([f64::NAN; 2], |mode| mode.half_width_ratios),
            heights_m: metres.heights(measured, |height| height.value),
            heights_sd_m: metres.heights(measured, |height| height.sd),
            modes: measured.modes.len() as u32,
            energy_dn: measured.energy_dn,
            ground_energy_ratio: measured.ground_energy_ratio,
            cover,
            plant_area_index: plant_area_index(cover),
            sensitivity: measured.sensitivity,
            deviation: measured.deviation,
            flags: self.flags(measured),
            columns: self.record.map(|record| record.columns.clone()).unwrap_or_default(),
        };
        (footprint, self.returns(measured, &metres))
    }

    /// The lowest modes as returns; that of the ground has its class.
    fn returns(&self, measured: &Measured, metres: &Metres) -> Vec<Return> {
        let modes = measured.modes.as_slice();
        let lowest = modes.get(modes.len().saturating_sub(MOST_RETURNS)..).unwrap_or_default();
        let has_ground = measured.ground().is_some();
        let class = |number: usize| if has_ground && number == lowest.len() { GROUND_CLASS } else { 0 };
        let numbered = (1..).zip(lowest).map(|(number, mode)| Return {
            emission: self.block.emission,
            return_number: number as u8,
            number_of_returns: lowest.len() as u8,
            class: class(number),
            ..metres.of_mode(mode, measured.background_dn)
        });
        numbered.collect()
    }

    fn flags(&self, measured: &Measured) -> u8 {
        let set = |bit: u8, is_set: bool| if is_set { bit } else { 0 };
        let [is_top_cut, _] = measured.is_cut;
        set(footprint_flags::GROUND_MISSING, measured.ground().is_none())
            | set(footprint_flags::TOP_MISSING, is_top_cut)
            | set(footprint_flags::CLIPPED, self.is_clipped)
            | set(footprint_flags::AMBIGUOUS, measured.ground_probability < CLEAR)
            | set(footprint_flags::DEGRADED, self.record.is_some_and(|record| record.is_degraded))
    }
}

/// Height per range along the beam of a shot: vertical if the frame knows the vertical, else along the beam.
pub(super) fn height_per_range(shot: &Emission, input: &InputInfo) -> f64 {
    let down = down_at(input.frame, shot.origin_m);
    let cosine =
        down.map_or(1.0, |down| down.iter().zip(shot.direction).map(|(a, b)| a * b).sum::<f64>().abs());
    shot.frame_scale * cosine
}

/// Metres of the samples of a block.
struct Metres {
    /// Range of the first sample, m.
    first_m: f64,
    /// Range per sample, m.
    range_m: f64,
    /// Height per sample, m.
    height_m: f64,
    start_ns: f64,
    interval_ns: f64,
}

impl Metres {
    fn of(block: &Block, shot: &Emission, input: &InputInfo) -> Metres {
        let m_per_ns = 0.5e-9 * input.group_velocity_mps;
        let range_m = m_per_ns * block.interval_ns;
        Metres {
            first_m: m_per_ns * block.start_ns,
            range_m,
            height_m: range_m * height_per_range(shot, input),
            start_ns: block.start_ns,
            interval_ns: block.interval_ns,
        }
    }

    fn range(&self, position: WithSd) -> WithSd {
        WithSd { value: self.first_m + self.range_m * position.value, sd: self.range_m * position.sd }
    }

    /// Height of the second candidate above the ground.
    fn second_height(&self, measured: &Measured) -> WithSd {
        let both = measured.ground().zip(measured.second_ground);
        both.map_or(WithSd::UNKNOWN, |(ground, second)| {
            let above_samples = ground.position_samples.value - second.position_samples.value;
            WithSd { value: self.height_m * above_samples, sd: self.height_m * second.position_samples.sd }
        })
    }

    fn heights(&self, measured: &Measured, part: fn(&WithSd) -> f64) -> Box<[f32; HEIGHTS]> {
        let mut heights_m = Box::new([f32::NAN; HEIGHTS]);
        for (to, height) in heights_m.iter_mut().zip(measured.heights_samples.iter()) {
            *to = (self.height_m * part(height)) as f32;
        }
        heights_m
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
            deviation_ratio: f64::NAN,
            ..Return::default()
        }
    }
}

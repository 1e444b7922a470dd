//! Applies the corrections to the returns of a line.

use std::sync::Arc;

use super::tables::{TableSources, TwoTables, delay_in_fusion_s, receiver_of};
use super::walk::Walks;
use super::width::{WidthCorrection, name};
use super::{Correct, Incidence};
use wavex_formats::lookup_tables::LookupTables;
use wavex_geodesy::vertical::down_at;
use wavex_line::scan_line::{Emission, InputInfo, LineStats, Return, ReturnChannel, ScanLine, flags};
use wavex_line::stage::{Cause, Context, Result};
use wavex_returns::radiometry::{LEAST_COS_INCIDENCE, RangeAndAir, target_thickness_m};

/// Corrections applied to every return of a run.
pub(super) struct Corrections {
    sources: TableSources,
    range_and_air: RangeAndAir,
    incidence: Incidence,
    /// Tables of the current recording.
    tables: Option<RecordingTables>,
}

/// The tables for one recording.
struct RecordingTables {
    input: Arc<InputInfo>,
    range: TwoTables,
    amplitude: TwoTables,
}

impl Corrections {
    /// `range` and `amplitude` are the tables of the files named by the keys.
    pub(super) fn new(
        keys: &Correct,
        range: Option<LookupTables>,
        amplitude: Option<LookupTables>,
    ) -> Result<Corrections> {
        let range_and_air = RangeAndAir {
            reference_range_m: keys.reference_range_m.number(),
            attenuation_db_per_km: keys.attenuation_db_per_km.number(),
        };
        let sources = TableSources::new(keys, range, amplitude)?;
        Ok(Corrections { sources, range_and_air, incidence: keys.incidence, tables: None })
    }

    /// Range tables of a recording.
    pub(super) fn range_tables(&self, input: &InputInfo) -> TwoTables {
        self.sources.range(input)
    }

    /// Corrects the returns of a line.
    pub(super) fn apply(
        &mut self,
        line: &mut ScanLine,
        returns: &mut [Return],
        widths: [&WidthCorrection; 2],
        walks: &Walks,
        cx: &mut Context,
    ) {
        let tables = match self.tables.take() {
            Some(tables) if Arc::ptr_eq(&tables.input, &line.input) => tables,
            _ => RecordingTables {
                input: Arc::clone(&line.input),
                range: self.sources.range(&line.input),
                amplitude: self.sources.amplitude(&line.input),
            },
        };
        note_what_is_missing(self.sources.wanted(), &tables, walks, returns, cx);
        let in_fusion_s = match (&line.fusion, &line.model) {
            (Some(fusion), Some(model)) => delay_in_fusion_s(&tables.range, model, fusion.gain_ratio),
            _ => 0.0,
        };
        let half_speed_m_per_ns = 0.5e-9 * line.input.group_velocity_mps;
        // Tables and widths apply to computed returns only, not to the instrument's returns.
        for r in returns.iter_mut().filter(|r| r.flags & flags::INSTRUMENT == 0) {
            match tables.range[receiver_of(r.channel)] {
                Some(_) => correct_range(r, &tables.range, in_fusion_s, half_speed_m_per_ns, &mut line.stats),
                None => walks.correct(r, half_speed_m_per_ns, &mut line.stats),
            }
            correct_width(r, widths, half_speed_m_per_ns);
            take_amplitude(r, &tables.amplitude, &mut line.stats);
        }
        put_in_order(returns);
        self.correct_intensities(line, returns, cx);
        self.tables = Some(tables);
    }

    /// Corrects intensities for range, attenuation and incidence.
    fn correct_intensities(&self, line: &mut ScanLine, returns: &mut [Return], cx: &mut Context) {
        let frame = line.input.frame;
        let range_and_air = self.range_and_air(&line.input, cx);
        for of_shot in returns.chunk_by_mut(|a, b| a.emission == b.emission) {
            let emission = of_shot.first().and_then(|r| line.emissions.get(r.emission as usize));
            let cos_incidence = match self.incidence {
                Incidence::None => 1.0,
                Incidence::Flat => match emission.and_then(|emission| cos_to_vertical(frame, emission)) {
                    Some(cosine) => cosine.max(LEAST_COS_INCIDENCE),
                    None => {
                        cx.consequence(Cause::NoTrajectory, "intensities are not corrected for incidence");
                        1.0
                    }
                },
            };
            for r in of_shot {
                let (factor, slope_per_m) = range_and_air.factor(r.range_m);
                let by_range = r.intensity * slope_per_m * r.range_sd_m;
                r.intensity_sd = (r.intensity_sd * factor).hypot(by_range) / cos_incidence;
                r.intensity *= factor / cos_incidence;
            }
        }
        let n = returns.len() as u64;
        line.stats.np_range += if range_and_air.reference_range_m.is_some() { n } else { 0 };
        line.stats.np_atm += if range_and_air.attenuation_db_per_km.is_some() { n } else { 0 };
    }

    /// The range and attenuation corrections; none if the sensor position is unknown.
    fn range_and_air(&self, input: &InputInfo, cx: &mut Context) -> RangeAndAir {
        if input.origin_is_sensor || self.range_and_air == RangeAndAir::default() {
            return self.range_and_air;
        }
        cx.warn(
            "intensities are not corrected for range and attenuation: the recording does not contain the sensor position, \
             and ranges count from a point near the waveform; read the original recording of the instrument, or set \
             `reference_range_m` and `attenuation_db_per_km` to false",
        );
        RangeAndAir::default()
    }
}

/// Notes tables that are requested but missing: without a range table, ranges depend on amplitude.
fn note_what_is_missing(
    wanted: [bool; 2],
    tables: &RecordingTables,
    walks: &Walks,
    returns: &[Return],
    cx: &mut Context,
) {
    let kinds = [
        (wanted[0], &tables.range, "range", "ranges are not corrected for amplitude"),
        (wanted[1], &tables.amplitude, "amplitude", "intensities are pulse heights"),
    ];
    for (is_wanted, both, kind, so) in kinds {
        for channel in [ReturnChannel::Low, ReturnChannel::High] {
            let receiver = receiver_of(channel);
            if kind == "range" && walks.has(receiver) {
                continue;
            }
            let is_of = |r: &Return| receiver_of(r.channel) == receiver;
            if is_wanted && both[receiver].is_none() && returns.iter().any(is_of) {
                let text = format!(
                    "{}: there is no {kind} table: {so}; set {kind}_table to a file, or to false if none is wanted",
                    name(channel)
                );
                if kind == "range" { cx.warn(text) } else { cx.info(text) }
            }
        }
    }
}

/// Cosine of the angle between a beam and straight down; `None` if the frame has no vertical.
fn cos_to_vertical(frame: wavex_line::scan_line::Frame, emission: &Emission) -> Option<f64> {
    let down = down_at(frame, emission.origin_m)?;
    Some(emission.direction.iter().zip(down).map(|(a, b)| a * b).sum())
}

/// Subtracts the value of the range table.
fn correct_range(
    r: &mut Return,
    ranges: &TwoTables,
    in_fusion_s: f64,
    half_speed_m_per_ns: f64,
    stats: &mut LineStats,
) {
    let receiver = receiver_of(r.channel);
    let Some(table) = &ranges[receiver] else { return };
    let in_fusion_s = if receiver == 1 { in_fusion_s } else { 0.0 };
    let late_ns = 1e9 * (table.at(r.peak_dn) - in_fusion_s);
    let late_sd_ns = 1e9 * table.slope(r.peak_dn) * r.peak_sd_dn;
    r.time_of_flight_ns -= late_ns;
    r.time_of_flight_sd_ns = r.time_of_flight_sd_ns.hypot(late_sd_ns);
    r.range_m -= half_speed_m_per_ns * late_ns;
    r.range_sd_m = r.range_sd_m.hypot(half_speed_m_per_ns * late_sd_ns);
    stats.np_ibrc += 1;
}

/// Normalises widths so that a flat target has the width of the calibrated pulse.
///
/// Returns of joint fits are left unchanged: neither receiver's curve applies.
fn correct_width(r: &mut Return, [low, high]: [&WidthCorrection; 2], half_speed_m_per_ns: f64) {
    let correction = match r.channel {
        ReturnChannel::Low => low,
        ReturnChannel::High => high,
        ReturnChannel::Joint => return,
    };
    let flat_target = correction.flat_target(r.amplitude_at_unit_gain_dn().0);
    if *correction == WidthCorrection::None || !flat_target.is_finite() || flat_target <= 0.0 {
        return;
    }
    let calibrated_ns = r.fwhm_ns / r.width_ratio;
    r.width_ratio /= flat_target;
    r.width_ratio_sd /= flat_target;
    r.fwhm_ns = calibrated_ns * r.width_ratio;
    (r.thickness_m, r.thickness_sd_m) =
        target_thickness_m(half_speed_m_per_ns, calibrated_ns, r.width_ratio, r.width_ratio_sd);
}

/// Sets amplitude and intensity, before the corrections for range, attenuation and incidence.
fn take_amplitude(r: &mut Return, amplitudes: &TwoTables, stats: &mut LineStats) {
    match &amplitudes[receiver_of(r.channel)] {
        Some(table) => {
            let amplitude = table.amplitude(r.peak_dn, r.peak_sd_dn);
            (r.amplitude_db, r.intensity, r.intensity_sd) =
                (amplitude.db, amplitude.linear, amplitude.linear_sd);
            stats.np_ibic += 1;
        }
        None => {
            (r.intensity, r.intensity_sd) = r.amplitude_at_unit_gain_dn();
            r.amplitude_db = f64::NAN;
        }
    }
}

/// Sorts the returns of a shot by corrected time.
fn put_in_order(returns: &mut [Return]) {
    for of_shot in returns.chunk_by_mut(|a, b| a.emission == b.emission) {
        if of_shot.is_sorted_by(|a, b| a.time_of_flight_ns <= b.time_of_flight_ns) {
            continue;
        }
        of_shot.sort_by(|a, b| a.time_of_flight_ns.total_cmp(&b.time_of_flight_ns));
        for (i, r) in of_shot.iter_mut().enumerate() {
            r.return_number = (i + 1).min(255) as u8;
        }
    }
}

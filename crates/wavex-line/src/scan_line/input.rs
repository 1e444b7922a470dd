//! Metadata of a recording.

use std::path::PathBuf;

use serde::{Deserialize, Serialize};

use super::Emission;
use wavex_geodesy::crs::units_of_wkt;
use wavex_geodesy::frames::Vector;
use wavex_geodesy::time::TimeScale;
use wavex_geodesy::time_axis::Alignment;
use wavex_geodesy::vertical::Frame;

/// Metadata of an input, shared by all stages of a run.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct InputInfo {
    /// Path of the file; empty if simulated.
    #[serde(skip)]
    pub path: PathBuf,
    /// Base name of outputs: the file name without its extension.
    #[serde(skip)]
    pub stem: String,
    /// Description of the format, such as `PulseWaves 0.3`.
    pub format: String,
    /// Name of the instrument.
    pub instrument: Option<String>,
    /// Serial number of the instrument.
    pub serial: Option<String>,
    /// Default sampling interval, ns; each block has its own.
    pub sampling_interval_ns: f64,
    /// Delay of odd samples relative to nominal time, samples.
    pub odd_sample_shift: f64,
    /// Largest value of the digitiser, if known.
    ///
    /// Samples of this value are saturated.
    pub full_scale_dn: Option<u16>,
    /// Whether the job gives `full_scale_dn`, not the recording.
    pub full_scale_is_set: bool,
    /// Automatic gain control of the recording.
    pub gain_control: GainControl,
    /// Group velocity of the pulse in air, m/s.
    pub group_velocity_mps: f64,
    /// Nominal pulse repetition rate, Hz.
    pub pulse_rate_hz: Option<f64>,
    /// Time scale of `gps_time_s`.
    pub time_scale: TimeScale,
    /// Whether the time scale is only inferred from the size of the times.
    pub time_scale_is_inferred: bool,
    /// GPS week of the first shot.
    pub gps_week: Option<u32>,
    /// Date of the recording as (day of year from 1, year).
    ///
    /// Outputs are dated with it, so they are identical in every run.
    pub recorded: Option<(u16, u16)>,
    /// Whether `recorded` is the creation date of the file, for lack of the day of the recording.
    pub is_file_date: bool,
    /// Frame of origins and directions.
    pub frame: Frame,
    /// Coordinate reference system as WKT.
    ///
    /// Of the frame, if that is projected; after `georeference`, of the points.
    pub crs_wkt: Option<String>,
    /// Problems of the file's records of its CRS, with what is used instead; for messages.
    pub crs_problems: Vec<String>,
    /// Scale and offset of stored coordinates.
    ///
    /// Of the input, or required by `georeference`. Outputs use the same offset, and also the scale
    /// if it is in degrees.
    pub coordinate_grid: Option<([f64; 3], [f64; 3])>,
    /// Source of the emission time.
    pub emission_reference: EmissionReference,
    /// SD of emission times that count from the clock, ns, if points prove one; an upper bound.
    ///
    /// `None`: only a position within one sample is known.
    pub clock_sd_ns: Option<f64>,
    /// SD of emission times for the choice between several references, ns; 0 if it is certain.
    pub emission_choice_sd_ns: f64,
    /// Whether shot origins are sensor positions.
    ///
    /// They are then the origin of ranges. Otherwise they are points on the beams near the
    /// waveforms, and ranges count from there.
    pub origin_is_sensor: bool,
    /// First shot; `None` before it.
    #[serde(skip)]
    pub first_shot: Option<FirstShot>,
    /// Name of the beam, of an instrument with several.
    pub beam: Option<String>,
    /// Power of the beam, `full` or `coverage`, of an instrument whose beams differ.
    #[serde(skip)]
    pub beam_power: Option<&'static str>,
    /// Names of further values that a recording of large footprints has of each shot.
    #[serde(skip)]
    pub columns: Vec<&'static str>,
    /// Whether points have heights above the ground.
    #[serde(skip)]
    pub has_heights_above_ground: bool,
    /// Amplitude table of the low-power channel: digitiser steps to dB.
    pub amplitude_low: Option<AmplitudeTable>,
    /// Amplitude table of the high-power channel: digitiser steps to dB.
    pub amplitude_high: Option<AmplitudeTable>,
    /// Range table of the low-power channel: digitiser steps to seconds.
    pub range_low: Option<AmplitudeTable>,
    /// Range table of the high-power channel: digitiser steps to seconds.
    pub range_high: Option<AmplitudeTable>,
}

impl InputInfo {
    /// SD of an emission time that counts from the clock, ns: the proven one, at most that of a position
    /// within one sample.
    pub fn clock_or_sample_sd_ns(&self) -> f64 {
        let within_a_sample_ns = self.sampling_interval_ns / 12f64.sqrt();
        self.clock_sd_ns.map_or(within_a_sample_ns, |sd_ns| sd_ns.min(within_a_sample_ns))
    }

    /// Unit of the coordinates, m: 1 but for maps in feet.
    pub fn map_unit_m(&self) -> f64 {
        let wkt = self.crs_wkt.as_deref().filter(|_| self.frame == Frame::Map);
        wkt.map_or(1.0, |wkt| units_of_wkt(wkt)[0])
    }

    /// Converts a time of the recording to adjusted GPS time, s; `None` if the week is unknown.
    pub fn adjusted_gps_time(&self, gps_time_s: f64) -> Option<f64> {
        self.time_scale.adjusted_s(self.gps_week, gps_time_s)
    }
}

impl Default for InputInfo {
    /// Unknown recording, sampled every nanosecond, in vacuum.
    fn default() -> InputInfo {
        InputInfo {
            path: PathBuf::new(),
            stem: String::new(),
            format: String::new(),
            instrument: None,
            serial: None,
            sampling_interval_ns: 1.0,
            odd_sample_shift: 0.0,
            full_scale_dn: None,
            full_scale_is_set: false,
            gain_control: GainControl::Off,
            group_velocity_mps: 299_792_458.0,
            pulse_rate_hz: None,
            time_scale: TimeScale::Unknown,
            time_scale_is_inferred: false,
            gps_week: None,
            recorded: None,
            is_file_date: false,
            frame: Frame::Scanner,
            crs_wkt: None,
            crs_problems: Vec::new(),
            coordinate_grid: None,
            emission_reference: EmissionReference::Clock,
            clock_sd_ns: None,
            emission_choice_sd_ns: 0.0,
            origin_is_sensor: true,
            first_shot: None,
            beam: None,
            beam_power: None,
            columns: Vec::new(),
            has_heights_above_ground: false,
            amplitude_low: None,
            amplitude_high: None,
            range_low: None,
            range_high: None,
        }
    }
}

/// First shot of a recording.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FirstShot {
    /// Origin in the frame of the recording, m.
    pub origin_m: Vector,
    /// GPS time if it has one, else time of the instrument clock, s.
    pub time_s: f64,
    /// Maps times of the recording to times of its trajectory.
    pub alignment: Option<Alignment>,
}

impl FirstShot {
    /// The first shot of a recording without an alignment.
    pub fn of(shot: &Emission) -> FirstShot {
        FirstShot { origin_m: shot.origin_m, time_s: shot.time_s(), alignment: None }
    }
}

/// Automatic gain control of a recording.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, Serialize)]
pub enum GainControl {
    /// None: each receiver has one gain.
    #[default]
    Off,
    /// Each sample block has its gain.
    Recorded,
    /// The gain varies but is not recorded: intensities are not comparable.
    NotRecorded,
}

/// Source of the emission time.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize)]
pub enum EmissionReference {
    /// The outgoing pulse of each shot was recorded and is fitted.
    OutgoingPulse,
    /// Outgoing pulse, without the time of its first sample.
    ///
    /// The shot's clock is the sample nearest to its peak. The fitted position is relative to that
    /// sample and within half a sample of it.
    OutgoingPulseFraction,
    /// The return locations in the file.
    ///
    /// Their mean difference to the fitted echoes.
    ReturnLocations,
    /// Only the clock of the shot.
    Clock,
}

/// Table of digitiser steps and values, ascending in steps.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
#[serde(try_from = "Vec<(f64, f64)>", into = "Vec<(f64, f64)>")]
pub struct AmplitudeTable {
    pairs: Vec<(f64, f64)>,
}

impl TryFrom<Vec<(f64, f64)>> for AmplitudeTable {
    type Error = &'static str;

    fn try_from(pairs: Vec<(f64, f64)>) -> Result<AmplitudeTable, &'static str> {
        AmplitudeTable::new(pairs).ok_or("a table with fewer than two defined pairs")
    }
}

impl From<AmplitudeTable> for Vec<(f64, f64)> {
    fn from(table: AmplitudeTable) -> Vec<(f64, f64)> {
        table.pairs
    }
}

impl AmplitudeTable {
    /// Creates a table of at least two defined pairs.
    ///
    /// Entries that are not finite or beyond ±1e30 are undefined and omitted.
    pub fn new(pairs: impl IntoIterator<Item = (f64, f64)>) -> Option<AmplitudeTable> {
        let defined = |&(x, y): &(f64, f64)| x.is_finite() && y.is_finite() && y.abs() < 1e30;
        let mut pairs: Vec<(f64, f64)> = pairs.into_iter().filter(defined).collect();
        pairs.sort_by(|a, b| a.0.total_cmp(&b.0));
        pairs.dedup_by(|a, b| a.0 == b.0);
        (pairs.len() >= 2).then_some(AmplitudeTable { pairs })
    }

    /// Returns the defined pairs.
    pub fn pairs(&self) -> &[(f64, f64)] {
        &self.pairs
    }

    /// Interpolates the value at `dn` digitiser steps (background + amplitude) linearly.
    ///
    /// Clamped to the defined part.
    pub fn at(&self, dn: f64) -> f64 {
        let after = self.pairs.partition_point(|pair| pair.0 <= dn);
        let Some(&(x1, y1)) = self.pairs.get(after) else {
            return self.pairs[self.pairs.len() - 1].1;
        };
        let Some(&(x0, y0)) = after.checked_sub(1).and_then(|before| self.pairs.get(before)) else {
            return y1;
        };
        y0 + (y1 - y0) * (dn - x0) / (x1 - x0)
    }

    /// Returns the change of the value per digitiser step.
    ///
    /// A central difference over two steps at `dn`.
    pub fn slope(&self, dn: f64) -> f64 {
        (self.at(dn + 1.0) - self.at(dn - 1.0)) / 2.0
    }

    /// Returns the amplitude of a peak by a dB table.
    ///
    /// The peak is at `peak_dn` digitiser steps, with an SD of `peak_sd_dn`.
    pub fn amplitude(&self, peak_dn: f64, peak_sd_dn: f64) -> LinearAmplitude {
        let linear = |dn: f64| 7.0 * 10f64.powf(self.at(dn) / 10.0);
        let slope = (linear(peak_dn + 1.0) - linear(peak_dn - 1.0)) / 2.0;
        LinearAmplitude { db: self.at(peak_dn), linear: linear(peak_dn), linear_sd: slope.abs() * peak_sd_dn }
    }
}

/// Amplitude according to the instrument's table.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LinearAmplitude {
    /// Amplitude above the detection limit, dB.
    pub db: f64,
    /// Linear amplitude `7 · 10^(dB / 10)`.
    ///
    /// Proportional to received power, in digitiser steps of weak echoes.
    pub linear: f64,
    /// Standard deviation of `linear`.
    pub linear_sd: f64,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_table_is_linear_inside_and_clamped_outside() {
        let table = AmplitudeTable::new([(1.0, -2e37), (9.0, 0.0), (11.0, 1.0), (21.0, 2.0)]).unwrap();
        let at = [8.0, 9.0, 10.0, 16.0, 21.0, 300.0].map(|dn| table.at(dn));
        assert_eq!(at, [0.0, 0.0, 0.5, 1.5, 2.0, 2.0]);
        assert_eq!(AmplitudeTable::new([(1.0, -2e37), (2.0, 3.0)]), None);
    }

    #[test]
    fn decibels_make_a_linear_amplitude_with_its_deviation() {
        let table = AmplitudeTable::new(
            (9..=200).map(|dn| (f64::from(dn), 10.0 * (f64::from(dn - 2) / 7.0).log10())),
        );
        let table = table.unwrap();
        let amplitude = table.amplitude(102.0, 1.5);
        assert!((amplitude.db - 10.0 * (100f64 / 7.0).log10()).abs() < 1e-12);
        assert!((amplitude.linear - 100.0).abs() < 1e-9 && (amplitude.linear_sd - 1.5).abs() < 1e-9);
        assert!((table.slope(102.0) - 10.0 / (100.0 * std::f64::consts::LN_10)).abs() < 1e-5);
        assert_eq!(table.amplitude(300.0, 1.5).linear_sd, 0.0, "beyond its end a table is flat");
    }
}

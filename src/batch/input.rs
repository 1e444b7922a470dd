//! What is known of a recording as a whole.

use std::path::PathBuf;

/// Facts about one input that every stage of a run may need.
#[derive(Clone, Debug, PartialEq)]
pub struct InputInfo {
    /// The file; empty for a simulated one.
    pub path: PathBuf,
    /// What outputs are named after: the file's name without its extension.
    pub stem: String,
    /// The format in words: `PulseWaves 0.3`.
    pub format: String,
    /// The instrument's name.
    pub instrument: Option<String>,
    /// The instrument's serial number.
    pub serial: Option<String>,
    /// The usual time between samples, ns; a block says its own.
    pub sampling_interval_ns: f64,
    /// Odd samples of a block were taken so much later than their index says, samples.
    pub odd_sample_shift: f64,
    /// The largest value that the digitiser can give, where known: a sample there is saturated.
    pub full_scale_dn: Option<u16>,
    /// What is known of automatic gain control.
    pub gain_control: GainControl,
    /// Speed of the pulse in air, m/s.
    pub group_velocity_mps: f64,
    /// The nominal pulse rate, Hz.
    pub pulse_rate_hz: Option<f64>,
    /// What `gps_time_s` counts.
    pub time_scale: TimeScale,
    /// The GPS week of the first shot.
    pub gps_week: Option<u32>,
    /// When it was recorded, as (day of year from 1, year): dates outputs, so that they repeat to the bit.
    pub recorded: Option<(u16, u16)>,
    /// The frame of origins and directions.
    pub frame: Frame,
    /// The coordinate reference system, as WKT: of the frame, where that is a map; behind `georeference` of the points.
    pub crs_wkt: Option<String>,
    /// Scale and offset with which the input stores coordinates, where it does, or which those of `georeference` need:
    /// outputs take the same offset, and the scale where it is one of degrees.
    pub coordinate_grid: Option<([f64; 3], [f64; 3])>,
    /// How the moment of emission is known.
    pub emission_reference: EmissionReference,
    /// Whether the origins of shots are where the sensor was, so that ranges count from it. Else they are points on the
    /// beams near the waveforms, and ranges count from there.
    pub origin_is_sensor: bool,
    /// Amplitude tables of the low and of the high power channel.
    pub amplitude_low: Option<AmplitudeTable>,
    /// See `amplitude_low`.
    pub amplitude_high: Option<AmplitudeTable>,
    /// Range tables: digitiser steps to seconds.
    pub range_low: Option<AmplitudeTable>,
    /// See `range_low`.
    pub range_high: Option<AmplitudeTable>,
}

impl Default for InputInfo {
    /// A recording of which nothing is known but that it was sampled every nanosecond in vacuum.
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
            gain_control: GainControl::Off,
            group_velocity_mps: 299_792_458.0,
            pulse_rate_hz: None,
            time_scale: TimeScale::Unknown,
            gps_week: None,
            recorded: None,
            frame: Frame::Scanner,
            crs_wkt: None,
            coordinate_grid: None,
            emission_reference: EmissionReference::Clock,
            origin_is_sensor: true,
            amplitude_low: None,
            amplitude_high: None,
            range_low: None,
            range_high: None,
        }
    }
}

/// What a recording says of automatic gain control.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum GainControl {
    /// Nothing: the receivers have one gain.
    #[default]
    Off,
    /// Each sample block says its gain.
    Recorded,
    /// The gain changes, and blocks do not say it: intensities are not comparable.
    NotRecorded,
}

/// What GPS times count.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TimeScale {
    /// Seconds of the GPS week.
    Week,
    /// Seconds of the day.
    Day,
    /// Seconds since 1980-01-06 minus 1e9.
    Adjusted,
    /// Not said by the file.
    Unknown,
}

/// The frame of a geometry.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Frame {
    /// The scanner's own.
    Scanner,
    /// The aircraft's: forward, right, down.
    Body,
    /// A map's: already georeferenced, in the coordinate reference system that the input names.
    Map,
    /// The earth's: geocentric (ECEF) metres. Shots come there with a trajectory.
    Earth,
}

/// How the moment of emission is known.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EmissionReference {
    /// The outgoing pulse was recorded with each shot and is fitted.
    OutgoingPulse,
    /// The outgoing pulse was recorded without the time of its first sample: the shot's clock is the sample nearest to
    /// its peak, so that its fitted position counts from there and lies within half a sample.
    OutgoingPulseFraction,
    /// The file's own return locations carry it: their mean difference to the fitted echoes.
    ReturnLocations,
    /// Only the shot's clock is known.
    Clock,
}

/// Pairs of digitiser steps and what they mean, in ascending order of the steps.
#[derive(Clone, Debug, PartialEq)]
pub struct AmplitudeTable {
    pairs: Vec<(f64, f64)>,
}

impl AmplitudeTable {
    /// A table of at least two defined pairs; entries that are not finite or beyond ±1e30 are undefined and left out.
    pub fn new(pairs: impl IntoIterator<Item = (f64, f64)>) -> Option<AmplitudeTable> {
        let defined = |&(x, y): &(f64, f64)| x.is_finite() && y.is_finite() && y.abs() < 1e30;
        let mut pairs: Vec<(f64, f64)> = pairs.into_iter().filter(defined).collect();
        pairs.sort_by(|a, b| a.0.total_cmp(&b.0));
        pairs.dedup_by(|a, b| a.0 == b.0);
        (pairs.len() >= 2).then_some(AmplitudeTable { pairs })
    }

    /// The defined pairs.
    pub fn pairs(&self) -> &[(f64, f64)] {
        &self.pairs
    }

    /// The value at `dn` digitiser steps (background + amplitude), linear between entries, clamped to the defined part.
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

    /// How much the value changes per digitiser step around `dn`: the central difference over two steps.
    pub fn slope(&self, dn: f64) -> f64 {
        (self.at(dn + 1.0) - self.at(dn - 1.0)) / 2.0
    }

    /// What a table of decibels says of a peak at `peak_dn` digitiser steps with its standard deviation.
    pub fn amplitude(&self, peak_dn: f64, peak_sd_dn: f64) -> LinearAmplitude {
        let linear = |dn: f64| 7.0 * 10f64.powf(self.at(dn) / 10.0);
        let slope = (linear(peak_dn + 1.0) - linear(peak_dn - 1.0)) / 2.0;
        LinearAmplitude { db: self.at(peak_dn), linear: linear(peak_dn), linear_sd: slope.abs() * peak_sd_dn }
    }
}

/// An amplitude by the instrument's table.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LinearAmplitude {
    /// Above the detection limit, dB.
    pub db: f64,
    /// `7 · 10^(dB / 10)`: in proportion to the light, digitiser steps of weak echoes.
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

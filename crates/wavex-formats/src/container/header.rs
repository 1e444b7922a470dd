//! Metadata of a container, which describes the whole recording.

use std::sync::Arc;

use arrow_schema::{Metadata, SchemaRef};
use serde::{Deserialize, Serialize};
use wavex_geodesy::calendar;

use super::layout::{KEYS, LayoutOptions};
use super::location::ContainerLocation;
use super::{VERSION, VERSION_OF_FRACTIONS, layout};
use crate::{Error, Result};

/// Metadata of a recording; see [`layout::KEYS`].
#[derive(Clone, Debug, PartialEq)]
pub struct ContainerHeader {
    /// Name of the instrument.
    pub instrument: Option<String>,
    /// Serial number of the instrument.
    pub serial: Option<String>,
    /// Default sampling interval, ns; finite and above 0.
    pub sampling_interval_ns: f64,
    /// Group velocity in air, m/s; above 0, at most the speed of light in vacuum.
    pub group_velocity_mps: f64,
    /// Nominal pulse rate, Hz; finite and above 0.
    pub pulse_rate_hz: Option<f64>,
    /// What `gps_time_s` counts.
    pub time_scale: TimeScale,
    /// GPS week of the first shot.
    pub gps_week: Option<u32>,
    /// Frame of origins and directions.
    pub frame: Frame,
    /// Coordinate reference system of the frame, WKT.
    pub crs_wkt: Option<String>,
    /// Digitiser steps to dB, low power; undefined pairs are dropped when read.
    pub amplitude_low: Option<Vec<(f64, f64)>>,
    /// Digitiser steps to dB, high power.
    pub amplitude_high: Option<Vec<(f64, f64)>>,
    /// Digitiser steps to seconds, low power.
    pub range_low: Option<Vec<(f64, f64)>>,
    /// Digitiser steps to seconds, high power.
    pub range_high: Option<Vec<(f64, f64)>>,
    /// Day of the recording, as (day of the year from 1, year from 1 to 9999).
    pub recorded: Option<(u16, u16)>,
    /// Day on which the file of the recording was created, in the same form; without effect if `recorded`
    /// is known.
    pub created: Option<(u16, u16)>,
    /// Largest value of the digitiser.
    pub full_scale_dn: Option<u16>,
    /// Scale and offset of the coordinates in the recording's own file.
    pub coordinate_grid: Option<([f64; 3], [f64; 3])>,
    /// Source of the emission time; `None`: determined from the blocks.
    pub emission_reference: Option<EmissionReference>,
    /// Standard deviation of emission times that count from the clock, ns; finite, not negative.
    pub clock_sd_ns: Option<f64>,
    /// Standard deviation of emission times for the choice of `emission_reference`, ns; as above.
    pub emission_choice_sd_ns: Option<f64>,
    /// Automatic gain control; `None`: determined from the blocks.
    pub gain_control: Option<GainControl>,
    /// Meaning of `origin`.
    ///
    /// `None`: the sensor position, unless emission times are from return locations.
    pub origin: Option<Origin>,
    /// Whether samples are fractions of a digitiser step, which version 2 of the layout stores.
    pub has_fractions: bool,
}

impl ContainerHeader {
    /// Creates a header for the scanner frame without optional values.
    ///
    /// Units and bounds: see the fields.
    pub fn new(sampling_interval_ns: f64, group_velocity_mps: f64) -> ContainerHeader {
        ContainerHeader {
            instrument: None,
            serial: None,
            sampling_interval_ns,
            group_velocity_mps,
            pulse_rate_hz: None,
            time_scale: TimeScale::Unknown,
            gps_week: None,
            frame: Frame::Scanner,
            crs_wkt: None,
            amplitude_low: None,
            amplitude_high: None,
            range_low: None,
            range_high: None,
            recorded: None,
            created: None,
            full_scale_dn: None,
            coordinate_grid: None,
            emission_reference: None,
            clock_sd_ns: None,
            emission_choice_sd_ns: None,
            gain_control: None,
            origin: None,
            has_fractions: false,
        }
    }

    /// Version of the layout, the value of `wavex.container`.
    pub fn version(&self) -> &'static str {
        if self.has_fractions { VERSION_OF_FRACTIONS } else { VERSION }
    }

    /// Arrow schema of a container with this header.
    pub fn schema(&self) -> SchemaRef {
        Arc::new(layout::schema(self.to_metadata(), self.options()))
    }
}

/// An enumeration whose values have names in the metadata.
macro_rules! named {
    ($(#[$doc:meta])* $name:ident { $($(#[$value_doc:meta])* $value:ident = $text:literal,)+ }) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub enum $name {
            $($(#[$value_doc])* $value,)+
        }

        impl $name {
            /// As the metadata writes it.
            pub fn name(self) -> &'static str {
                match self {
                    $($name::$value => $text,)+
                }
            }

            fn of(text: &str) -> Option<$name> {
                match text {
                    $($text => Some($name::$value),)+
                    _ => None,
                }
            }
        }
    };
}

named! {
    /// What `gps_time_s` counts.
    TimeScale {
        /// Seconds of the GPS week.
        Week = "week",
        /// Seconds of the day.
        Day = "day",
        /// Seconds since 1980-01-06 minus 1e9.
        Adjusted = "adjusted",
        /// Unknown.
        Unknown = "unknown",
    }
}

named! {
    /// The frame of `origin` and `direction`.
    Frame {
        /// Scanner.
        Scanner = "scanner",
        /// Aircraft: forward, right, down.
        Body = "body",
        /// Map, or another frame of the named coordinate reference system.
        Map = "map",
        /// Geocentric (ECEF), m.
        Earth = "earth",
    }
}

named! {
    /// Source of the emission time.
    EmissionReference {
        /// Outgoing pulse recorded with each shot.
        OutgoingPulse = "outgoing_pulse",
        /// Outgoing pulse without the time of its first sample.
        ///
        /// The clock is the sample nearest to its peak.
        OutgoingPulseFraction = "outgoing_pulse_fraction",
        /// Return locations of the recording's own file.
        ReturnLocations = "return_locations",
        /// Clock of the shot.
        Clock = "clock",
    }
}

named! {
    /// Automatic gain control.
    GainControl {
        /// Each block has its gain.
        Recorded = "recorded",
        /// The gain varies but is not recorded.
        NotRecorded = "not_recorded",
    }
}

named! {
    /// Meaning of the origins of shots.
    Origin {
        /// Sensor position, from which ranges count.
        Sensor = "sensor",
        /// Point on the beam near the waveform; the sensor position is unknown.
        Waveform = "waveform",
    }
}

/// The value of `wavex.tables`.
///
/// NaN is written as null.
#[derive(Default, Serialize, Deserialize)]
#[serde(default)]
struct StoredTables {
    #[serde(skip_serializing_if = "Option::is_none")]
    amplitude_low: Option<StoredTable>,
    #[serde(skip_serializing_if = "Option::is_none")]
    amplitude_high: Option<StoredTable>,
    #[serde(skip_serializing_if = "Option::is_none")]
    range_low: Option<StoredTable>,
    #[serde(skip_serializing_if = "Option::is_none")]
    range_high: Option<StoredTable>,
}

type StoredTable = Vec<(Option<f64>, Option<f64>)>;

/// The value of `wavex.coordinate_grid`.
#[derive(Serialize, Deserialize)]
struct CoordinateGrid {
    scale: [f64; 3],
    offset: [f64; 3],
}

/// Speed of light in vacuum, m/s, the upper limit of the group velocity.
const LIGHT_MPS: f64 = 299_792_458.0;

impl ContainerHeader {
    fn options(&self) -> LayoutOptions {
        let has_gain = self.gain_control == Some(GainControl::Recorded);
        LayoutOptions { has_gain, has_fractions: self.has_fractions }
    }

    /// Converts the header to metadata.
    pub(super) fn to_metadata(&self) -> Metadata {
        let number = |value: f64| value.to_string();
        let grid = self.coordinate_grid.map(|(scale, offset)| json(&CoordinateGrid { scale, offset }));
        let values = [
            ("wavex.container", Some(self.version().to_string())),
            ("wavex.instrument", self.instrument.clone()),
            ("wavex.serial", self.serial.clone()),
            ("wavex.sampling_interval_ns", Some(number(self.sampling_interval_ns))),
            ("wavex.group_velocity_mps", Some(number(self.group_velocity_mps))),
            ("wavex.pulse_rate_hz", self.pulse_rate_hz.map(number)),
            ("wavex.time_scale", Some(self.time_scale.name().to_string())),
            ("wavex.gps_week", self.gps_week.map(|week| week.to_string())),
            ("wavex.frame", Some(self.frame.name().to_string())),
            ("wavex.crs", self.crs_wkt.clone()),
            ("wavex.tables", self.tables()),
            ("wavex.recorded", self.recorded.and_then(iso_date)),
            ("wavex.created", self.created.and_then(iso_date)),
            ("wavex.full_scale_dn", self.full_scale_dn.map(|dn| dn.to_string())),
            ("wavex.coordinate_grid", grid),
            ("wavex.emission_reference", self.emission_reference.map(|by| by.name().to_string())),
            ("wavex.clock_sd_ns", self.clock_sd_ns.map(number)),
            ("wavex.emission_choice_sd_ns", self.emission_choice_sd_ns.map(number)),
            ("wavex.gain_control", self.gain_control.map(|control| control.name().to_string())),
            ("wavex.origin", self.origin.map(|origin| origin.name().to_string())),
        ];
        debug_assert!(values.iter().map(|value| value.0).eq(KEYS.iter().map(|key| key.name)));
        values.into_iter().filter_map(|(key, value)| Some((key, value?))).collect()
    }

    fn tables(&self) -> Option<String> {
        let table = |pairs: &Option<Vec<(f64, f64)>>| {
            let defined = |&(x, y): &(f64, f64)| (Some(x), Some(y));
            pairs.as_ref().map(|pairs| pairs.iter().map(defined).collect::<StoredTable>())
        };
        let tables = StoredTables {
            amplitude_low: table(&self.amplitude_low),
            amplitude_high: table(&self.amplitude_high),
            range_low: table(&self.range_low),
            range_high: table(&self.range_high),
        };
        let text = json(&tables);
        (text != "{}").then_some(text)
    }

    /// Parses the header from metadata; errors name the key.
    pub(super) fn from_metadata(metadata: &Metadata, location: ContainerLocation) -> Result<ContainerHeader> {
        let keys = MetadataKeys { metadata, location };
        let has_fractions = keys.version()? == VERSION_OF_FRACTIONS;
        let tables: StoredTables = keys.json("wavex.tables")?.unwrap_or_default();
        let grid: Option<CoordinateGrid> = keys.json("wavex.coordinate_grid")?;
        let positive = |value: &f64| value.is_finite() && *value > 0.0;
        let not_negative = |value: &f64| value.is_finite() && *value >= 0.0;
        let speed = |value: &f64| *value > 0.0 && *value <= LIGHT_MPS;
        Ok(ContainerHeader {
            instrument: keys.text("wavex.instrument").map(str::to_string),
            serial: keys.text("wavex.serial").map(str::to_string),
            sampling_interval_ns: keys.needed("wavex.sampling_interval_ns", |text| number(text, positive))?,
            group_velocity_mps: keys.needed("wavex.group_velocity_mps", |text| number(text, speed))?,
            pulse_rate_hz: keys.value("wavex.pulse_rate_hz", |text| number(text, positive))?,
            time_scale: keys.needed("wavex.time_scale", TimeScale::of)?,
            gps_week: keys.value("wavex.gps_week", |text| text.parse().ok())?,
            frame: keys.needed("wavex.frame", Frame::of)?,
            crs_wkt: keys.text("wavex.crs").map(str::to_string),
            amplitude_low: tables.amplitude_low.map(defined),
            amplitude_high: tables.amplitude_high.map(defined),
            range_low: tables.range_low.map(defined),
            range_high: tables.range_high.map(defined),
            recorded: keys.value("wavex.recorded", day_of_year)?,
            created: keys.value("wavex.created", day_of_year)?,
            full_scale_dn: keys.value("wavex.full_scale_dn", |text| text.parse().ok())?,
            coordinate_grid: grid.map(|grid| (grid.scale, grid.offset)),
            emission_reference: keys.value("wavex.emission_reference", EmissionReference::of)?,
            clock_sd_ns: keys.value("wavex.clock_sd_ns", |text| number(text, not_negative))?,
            emission_choice_sd_ns: keys
                .value("wavex.emission_choice_sd_ns", |text| number(text, not_negative))?,
            gain_control: keys.value("wavex.gain_control", GainControl::of)?,
            origin: keys.value("wavex.origin", Origin::of)?,
            has_fractions,
        })
    }
}

/// The metadata, with errors that name the key.
struct MetadataKeys<'a> {
    metadata: &'a Metadata,
    location: ContainerLocation<'a>,
}

impl<'a> MetadataKeys<'a> {
    fn text(&self, key: &str) -> Option<&'a str> {
        self.metadata.get(key).map(String::as_str)
    }

    fn version(&self) -> Result<&'a str> {
        match self.text("wavex.container") {
            Some(known @ (VERSION | VERSION_OF_FRACTIONS)) => Ok(known),
            Some(other) => Err(Error::unusable(
                self.location.file,
                format!(
                    "a waveform container of version `{other}`, where {VERSION} and {VERSION_OF_FRACTIONS} are known"
                ),
                "use a newer wavex",
            )),
            None => Err(Error::unusable(
                self.location.file,
                "an Arrow file, but no waveform container: its metadata has no key `wavex.container`",
                "give its schema the metadata that schemas/container.json lists",
            )),
        }
    }

    fn value<T>(&self, key: &str, parse: impl Fn(&'a str) -> Option<T>) -> Result<Option<T>> {
        self.text(key).map(|text| parse(text).ok_or_else(|| self.wrong(key, text))).transpose()
    }

    fn needed<T>(&self, key: &str, parse: impl Fn(&'a str) -> Option<T>) -> Result<T> {
        self.value(key, parse)?.ok_or_else(|| {
            let remedy = format!("add it to the schema's metadata: {}", form(key));
            self.location.bad(format!("metadata `{key}`"), "is missing", &remedy)
        })
    }

    fn json<T: Deserialize<'a>>(&self, key: &str) -> Result<Option<T>> {
        self.value(key, |text| serde_json::from_str(text).ok())
    }

    fn wrong(&self, key: &str, text: &str) -> Error {
        let shown: String = text.chars().take(60).collect();
        let remedy = format!("write a {}", form(key));
        self.location.bad(format!("metadata `{key}`"), format!("`{shown}` is no value for it"), &remedy)
    }
}

fn form(key: &str) -> &'static str {
    layout::KEYS.iter().find(|known| known.name == key).map_or("string", |known| known.form)
}

fn json(value: &impl Serialize) -> String {
    serde_json::to_string(value).unwrap_or_default()
}

fn number(text: &str, fits: impl Fn(&f64) -> bool) -> Option<f64> {
    text.trim().parse().ok().filter(fits)
}

fn defined(table: StoredTable) -> Vec<(f64, f64)> {
    table.into_iter().filter_map(|(x, y)| Some((x?, y?))).collect()
}

/// (day of the year from 1, year) as ISO 8601; `None` if there is no such day.
fn iso_date((day, year): (u16, u16)) -> Option<String> {
    let [year, month, day] = calendar::date_in_year(year.into(), day.into())?;
    (1..=9999).contains(&year).then(|| format!("{year:04}-{month:02}-{day:02}"))
}

/// The inverse of [`iso_date`].
fn day_of_year(text: &str) -> Option<(u16, u16)> {
    let mut parts = text.splitn(3, '-');
    let mut part = |digits: usize| {
        let part = parts.next()?;
        let plain = part.len() == digits && part.bytes().all(|byte| byte.is_ascii_digit());
        plain.then(|| part.parse::<u16>().ok()).flatten()
    };
    let date = [part(4)?, part(2)?, part(2)?];
    let (year, of_calendar) = (date[0], date.map(i64::from));
    let is_valid = year > 0 && calendar::is_date(of_calendar);
    is_valid.then(|| (calendar::day_of_year(of_calendar) as u16, year))
}

#[cfg(test)]
mod tests;

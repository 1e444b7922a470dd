//! Pulses of SPD (Sorted Pulse Data), versions 3 and 4.
//!
//! Sources of names, units and types: SPDLib (version 3: `SPDPulse.h`, `SPDFile.h`, `SPDFileWriter.cpp`,
//! `SPDCommon.h`) and pylidar (version 4: its format description, `spdv4.py`).

use std::path::Path;

use wavex_formats::{Error, Result};

use super::attribute::Attributes;
use super::dataset::Dataset;
use super::group::{Link, links};
use super::input::{Address, Input};
use super::members::{MOST_SAMPLES, Members};
use super::superblock;
use super::table::{Table, Value};
use super::text::Texts;

/// Most waveforms of a pulse; the number is stored in a byte.
const MOST_WAVEFORMS: u64 = 255;
/// Times of type float above this are nanoseconds, below seconds.
const MOST_SECONDS: f64 = 1e11;
/// Remedy for files without values that are needed.
const EXPORT: &str = "write the file again with SPDLib or pylidar, with origins and waveforms of its pulses";

/// Version of the layout.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SpdVersion {
    /// Pulses are records, and the header is a group; by SPDLib.
    Three,
    /// Each value of pulses and waveforms is a data set, and the header are attributes; by pylidar.
    Four,
}

/// Properties of a file.
#[derive(Clone, Debug, PartialEq)]
pub struct SpdHeader {
    /// Version of the layout.
    pub version: SpdVersion,
    /// Sampling interval, ns; 0 if the file does not state it.
    pub interval_ns: f64,
    /// Coordinate reference system of origins, as the file states it.
    pub crs_wkt: Option<String>,
    /// Size of a stored sample, bits.
    pub sample_bits: usize,
}

/// A pulse; its buffers are used again by the next one.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SpdPulse {
    /// Number that the file gives it.
    pub id: u64,
    /// GPS time or time of the system, ns; `None` if unknown.
    pub time_ns: Option<u64>,
    /// Origin, in the coordinate reference system of the file.
    pub origin: [f64; 3],
    /// Angle from the direction upwards, rad.
    pub zenith_rad: f64,
    /// Angle from the y axis to the x axis, rad.
    pub azimuth_rad: f64,
    /// Number of its scan line.
    pub scan_line: Option<u64>,
    waveforms: Vec<SpdWaveform>,
    count: usize,
}

/// A waveform of a pulse.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SpdWaveform {
    /// Channel; 0 if the file does not state it.
    pub channel: u8,
    /// Range from the origin to the first received sample, m.
    pub range_m: f64,
    /// Received digitiser steps per unit; 1 if the file does not state it.
    pub gain: f64,
    /// Index of the first transmitted sample.
    pub transmitted_at: u64,
    /// Received samples, digitiser steps.
    pub received_dn: Vec<u16>,
    /// Transmitted samples, digitiser steps.
    pub transmitted_dn: Vec<u16>,
}

impl SpdPulse {
    /// Returns the waveforms.
    pub fn waveforms(&self) -> &[SpdWaveform] {
        self.waveforms.get(..self.count).unwrap_or_default()
    }

    /// Returns the unit vector along the beam.
    pub fn direction(&self) -> [f64; 3] {
        let (sin, cos) = self.zenith_rad.sin_cos();
        [sin * self.azimuth_rad.sin(), sin * self.azimuth_rad.cos(), cos]
    }
}

/// Reads the pulses of a file, in any order.
///
/// One row of chunks of each data set is kept decoded.
pub struct SpdReader {
    header: SpdHeader,
    members: Members,
    pulses: Table,
    values: PulseValues,
    /// Waveforms of version 4; in version 3 a pulse has one, in its own row.
    waveforms: Option<Table>,
    of_waveform: WaveformValues,
    received: Dataset,
    transmitted: Option<Dataset>,
}

/// Values of the rows of pulses.
struct PulseValues {
    id: Value,
    time: Option<Value>,
    origin: [Value; 3],
    angles: [Value; 2],
    scan_line: Option<Value>,
    /// Version 4: number and first of the waveforms.
    waveforms: Option<[Value; 2]>,
}

/// Values of the rows of waveforms.
struct WaveformValues {
    range: Value,
    gain: Option<Value>,
    channel: Option<Value>,
    received: [Value; 2],
    transmitted: Option<[Value; 2]>,
}

/// Returns whether the members of the root group are those of SPD.
pub fn is_spd(input: &Input, root: &[Link]) -> Result<bool> {
    let Some(data) = member(root, "DATA") else { return Ok(false) };
    Ok(member(root, "HEADER").is_some() || member(&links(input, data)?, "PULSES").is_some())
}

fn member(group: &[Link], name: &str) -> Option<Address> {
    group.iter().find(|(link, _)| link == name).map(|&(_, at)| at)
}

impl SpdReader {
    /// Opens a file.
    ///
    /// # Errors
    /// If it is no SPD file of version 3 or 4 with waveforms, or damaged.
    pub fn open(path: &Path) -> Result<SpdReader> {
        let mut input = Input::open(path)?;
        let root_at = superblock::root(&mut input)?;
        let root = links(&input, root_at)?;
        let refused = |problem: &str| Error::unusable(path, problem, EXPORT);
        let data_at = member(&root, "DATA").ok_or_else(|| refused("no group DATA: this is no SPD file"))?;
        let data = links(&input, data_at)?;
        let mut members = Members::new(input, "", root.clone());
        let mut header = match member(&root, "HEADER") {
            Some(at) => header_3(&mut members, at)?,
            None => header_4(&members, root_at)?,
        };

        members.enter("DATA", data.clone());
        let Some(received) = members.optional("RECEIVED")? else {
            return Err(refused("no data set DATA/RECEIVED: the file has no received waveforms"));
        };
        header.sample_bits = 8 * received.element().bytes;
        let transmitted = members.optional("TRANSMITTED")?;
        let (pulses, values, waveforms, of_waveform);
        match header.version {
            SpdVersion::Three => {
                let records = members.elements("PULSES")?;
                let records = records.ok_or_else(|| refused("no data set DATA/PULSES"))?;
                pulses = Table::of_records(records);
                values = PulseValues::open(&pulses, &mut members, header.version)?;
                of_waveform = WaveformValues::open(&pulses, &mut members)?;
                waveforms = None;
            }
            SpdVersion::Four => {
                enter(&mut members, &data, "PULSES")?;
                pulses = Table::of_group(&mut members, "PULSE_ID")?;
                values = PulseValues::open(&pulses, &mut members, header.version)?;
                enter(&mut members, &data, "WAVEFORMS")?;
                let table = Table::of_group(&mut members, "RECEIVED_START_IDX")?;
                of_waveform = WaveformValues::open(&table, &mut members)?;
                waveforms = Some(table);
            }
        }
        Ok(SpdReader { header, members, pulses, values, waveforms, of_waveform, received, transmitted })
    }

    /// Returns the properties of the file.
    pub fn header(&self) -> &SpdHeader {
        &self.header
    }

    /// Returns the number of pulses.
    pub fn len(&self) -> u64 {
        self.pulses.rows()
    }

    /// Returns whether there are no pulses.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Reads a pulse; index 0 is the first.
    ///
    /// # Errors
    /// If its values are damaged, or there is no such pulse; other pulses can still be read.
    pub fn pulse(&mut self, index: u64, pulse: &mut SpdPulse) -> Result<()> {
        self.read(index, pulse).map_err(|error| match error {
            Error::Unusable { file, problem, remedy } => {
                Error::Unusable { file, problem: format!("pulse {index}: {problem}"), remedy }
            }
            Error::Malformed { file, offset, field, problem, remedy } => {
                Error::Malformed { file, offset, field: format!("pulse {index}: {field}"), problem, remedy }
            }
            error => error,
        })
    }

    fn read(&mut self, index: u64, pulse: &mut SpdPulse) -> Result<()> {
        let SpdReader { members, pulses, values, .. } = self;
        pulse.count = 0;
        pulse.id = pulses.whole(members, &mut values.id, index)?;
        pulse.time_ns = match &mut values.time {
            Some(time) if time.is_integer() => Some(pulses.whole(members, time, index)?),
            Some(time) => time_ns(pulses.number(members, time, index)?),
            None => None,
        };
        for (value, coordinate) in values.origin.iter_mut().zip(&mut pulse.origin) {
            *coordinate = pulses.number(members, value, index)?;
        }
        let [azimuth, zenith] = &mut values.angles;
        pulse.azimuth_rad = pulses.number(members, azimuth, index)?;
        pulse.zenith_rad = pulses.number(members, zenith, index)?;
        pulse.scan_line = match &mut values.scan_line {
            Some(line) => Some(pulses.whole(members, line, index)?),
            None => None,
        };
        let (count, first) = match &mut values.waveforms {
            Some([count, first]) => {
                (pulses.whole(members, count, index)?, pulses.whole(members, first, index)?)
            }
            None => (1, index),
        };
        if count > MOST_WAVEFORMS {
            return Err(members.unusable(format!("{count} waveforms, at most {MOST_WAVEFORMS}")));
        }
        if let Some(table) = &self.waveforms
            && count > 0
            && first.checked_add(count).is_none_or(|end| end > table.rows())
        {
            let (name, rows) = (table.name(), table.rows());
            let problem = format!("{count} waveforms from row {first} of {name} on, it has {rows}");
            return Err(self.members.unusable(problem));
        }
        pulse.waveforms.resize_with(pulse.waveforms.len().max(count as usize), SpdWaveform::default);
        for (row, waveform) in (first..).zip(pulse.waveforms.iter_mut().take(count as usize)) {
            self.waveform(row, waveform)?;
        }
        pulse.count = count as usize;
        Ok(())
    }

    /// Reads the waveform in a row.
    fn waveform(&mut self, row: u64, waveform: &mut SpdWaveform) -> Result<()> {
        let table = self.waveforms.as_mut().unwrap_or(&mut self.pulses);
        let (members, values) = (&mut self.members, &mut self.of_waveform);
        waveform.range_m = table.number(members, &mut values.range, row)?;
        waveform.channel = match &mut values.channel {
            Some(channel) => u8::try_from(table.whole(members, channel, row)?).unwrap_or(u8::MAX),
            None => 0,
        };
        let gain = match &mut values.gain {
            Some(gain) => table.number(members, gain, row)?,
            None => 1.0,
        };
        // Version 3 stores units per step, version 4 steps per unit.
        let gain = if self.header.version == SpdVersion::Three { 1.0 / gain } else { gain };
        waveform.gain = if gain > 0.0 && gain.is_finite() { gain } else { 1.0 };
        let [count, start] = &mut values.received;
        let place = [table.whole(members, count, row)?, table.whole(members, start, row)?];
        samples(members, &mut self.received, place, &mut waveform.received_dn)?;
        waveform.transmitted_dn.clear();
        if let (Some([count, start]), Some(transmitted)) = (&mut values.transmitted, &mut self.transmitted) {
            let place = [table.whole(members, count, row)?, table.whole(members, start, row)?];
            waveform.transmitted_at = place[1];
            samples(members, transmitted, place, &mut waveform.transmitted_dn)?;
        }
        Ok(())
    }
}

impl PulseValues {
    fn open(table: &Table, members: &mut Members, version: SpdVersion) -> Result<PulseValues> {
        let mut value = |name| required(table, members, name);
        let waveforms = match version {
            SpdVersion::Three => None,
            SpdVersion::Four => Some([value("NUMBER_OF_WAVEFORM_SAMPLES")?, value("WFM_START_IDX")?]),
        };
        let time = match version {
            SpdVersion::Three => "GPS_TIME",
            SpdVersion::Four => "TIMESTAMP",
        };
        Ok(PulseValues {
            id: value("PULSE_ID")?,
            origin: [value("X_ORIGIN")?, value("Y_ORIGIN")?, value("Z_ORIGIN")?],
            angles: [value("AZIMUTH")?, value("ZENITH")?],
            time: table.optional(members, time)?,
            scan_line: table.optional(members, "SCANLINE")?,
            waveforms,
        })
    }
}

impl WaveformValues {
    fn open(table: &Table, members: &mut Members) -> Result<WaveformValues> {
        let transmitted = match table.optional(members, "NUMBER_OF_WAVEFORM_TRANSMITTED_BINS")? {
            Some(count) => Some([count, required(table, members, "TRANSMITTED_START_IDX")?]),
            None => None,
        };
        Ok(WaveformValues {
            range: required(table, members, "RANGE_TO_WAVEFORM_START")?,
            gain: table.optional(members, "RECEIVE_WAVE_GAIN")?,
            channel: table.optional(members, "CHANNEL")?,
            received: [
                required(table, members, "NUMBER_OF_WAVEFORM_RECEIVED_BINS")?,
                required(table, members, "RECEIVED_START_IDX")?,
            ],
            transmitted,
        })
    }
}

/// Opens a value that pulses or waveforms must have.
fn required(table: &Table, members: &mut Members, name: &str) -> Result<Value> {
    let found = table.optional(members, name)?;
    let problem = || format!("{} has no {name}", table.name());
    found.ok_or_else(|| Error::unusable(members.input.path(), problem(), EXPORT))
}

/// Goes on with the members of a group in `DATA`.
fn enter(members: &mut Members, data: &[Link], name: &str) -> Result<()> {
    let at = member(data, name);
    let at =
        at.ok_or_else(|| Error::unusable(members.input.path(), format!("no group DATA/{name}"), EXPORT))?;
    let group = links(&members.input, at)?;
    members.enter(&format!("DATA/{name}"), group);
    Ok(())
}

/// Reads samples by their number and the index of the first.
fn samples(members: &mut Members, data: &mut Dataset, place: [u64; 2], into: &mut Vec<u16>) -> Result<()> {
    let [count, first] = place;
    into.clear();
    if count == 0 {
        return Ok(());
    }
    let end = first.checked_add(count).filter(|&end| end <= data.len() && count <= MOST_SAMPLES);
    let end = end.ok_or_else(|| {
        let problem =
            format!("{}: {count} samples from sample {first} on, it has {}", data.name(), data.len());
        members.unusable(problem)
    })?;
    data.append_u16(&members.input, &mut members.decoder, first..end, into)
}

/// Converts a time of type float, which is in seconds or nanoseconds, to nanoseconds.
fn time_ns(time: f64) -> Option<u64> {
    let ns = if time > MOST_SECONDS { time } else { 1e9 * time };
    (0.0..1.8e19).contains(&ns).then_some(ns.round() as u64)
}

/// Reads the header of version 3.
fn header_3(members: &mut Members, at: Address) -> Result<SpdHeader> {
    let header = links(&members.input, at)?;
    members.enter("HEADER", header);
    let mut major = members.required("VERSION_MAJOR_SPD")?;
    let major = members.whole(&mut major, 0)?;
    // Files of version 3 of the format state 2, the version of SPDLib's reader.
    if !(2..=3).contains(&major) {
        return Err(unknown_version(members.input.path(), major as f64));
    }
    let interval_ns = match members.optional("SENSOR_TEMPORAL_BIN_SPACING")? {
        Some(mut interval) => interval.f64_at(&members.input, &mut members.decoder, 0)?,
        None => 0.0,
    };
    let crs: Option<Texts> = members.elements("SPATIAL_REFERENCE")?;
    let crs_wkt = crs.map(|mut crs| crs.first(&members.input, &mut members.decoder)).transpose()?;
    let crs_wkt = crs_wkt.filter(|wkt| !wkt.is_empty());
    Ok(SpdHeader { version: SpdVersion::Three, interval_ns, crs_wkt, sample_bits: 0 })
}

/// Reads the attributes of version 4.
fn header_4(members: &Members, root: Address) -> Result<SpdHeader> {
    let input = &members.input;
    let attributes = Attributes::of(input, root)?;
    match attributes.number(input, "VERSION_SPD")? {
        Some(4.0) => {}
        Some(version) => return Err(unknown_version(input.path(), version)),
        None => {
            let problem = "an SPD file without its version: neither VERSION_SPD nor HEADER/VERSION_MAJOR_SPD";
            return Err(Error::unusable(input.path(), problem, EXPORT));
        }
    }
    let interval_ns = attributes.number(input, "SENSOR_TEMPORAL_BIN_SPACING")?.unwrap_or(0.0);
    let crs_wkt = attributes.text(input, "SPATIAL_REFERENCE")?.filter(|wkt| !wkt.is_empty());
    Ok(SpdHeader { version: SpdVersion::Four, interval_ns, crs_wkt, sample_bits: 0 })
}

fn unknown_version(path: &Path, version: f64) -> Error {
    let problem = format!("SPD of version {version}, which is not supported");
    Error::unusable(path, problem, "convert it to version 3 or 4 with SPDLib or pylidar")
}

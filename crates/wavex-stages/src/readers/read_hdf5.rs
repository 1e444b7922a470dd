//! `read_hdf5`: reads waveforms from HDF5 files: GEDI, LVIS and SPD.

use std::path::Path;
use std::sync::Arc;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::reading::bad_records::BrokenRun;
use crate::reading::recording::{
    AsDeclared, Declared, FullScale, InputCrs, OddSamples, PulseSpeed, Sampling, TimeKeys,
};
use wavex_footprints::RecordedNoise;
use wavex_geodesy::ellipsoid::{Geodetic, WGS84};
use wavex_hdf5::{Beam, BeamReader, Granule, Position, Power, Product, Shot, product_of};
use wavex_line::keys::{InvalidKey, at_least};
use wavex_line::scan_line::{
    Blocks, Channel, Emission, EmissionReference, FootprintRecord, Frame, InputInfo, Kind, ScanLine,
    TimeScale,
};
use wavex_line::stage::{
    Config, Context, LineLocation, Paths, Reason, Result, RunContext, Source, SourceConfig, StageError,
    StageSpec,
};

mod cut;
mod extent;
mod spd;
#[cfg(test)]
mod tests;

use cut::Cut;
pub use cut::ShotList;
pub use extent::ExtentKey;
use spd::SpdLineReader;

/// Registry entry of the stage.
pub const STAGE: StageSpec = StageSpec::source::<ReadHdf5>("read_hdf5", Kind::Shots);

/// Shots of a line: recordings of profiles have no scan lines.
const SHOTS_PER_LINE: usize = 256;
/// Seconds from 1980-01-06 to the origin of adjusted GPS time.
const ADJUSTED_ORIGIN_S: f64 = 1e9;
/// Sampling interval of GEDI and of younger LVIS files, ns; the positions of first and last sample give others.
const INTERVAL_NS: f64 = 1.0;
/// Step to which sampling intervals are rounded, ns: positions include delays in the atmosphere.
const INTERVAL_STEP_NS: f64 = 0.1;

/// Reads GEDI level 1B (`GEDI01_B`), LVIS level 1B (`ILVIS1B`) and SPD (SPDLib, pylidar) from HDF5 files.
///
/// The content of a file decides, not its name.
///
/// Samples of GEDI and LVIS are kept as stored: GEDI's are fractions of a digitiser step. `measure_footprints`
/// measures them; stages for whole steps (`calibrate`, `decompose`) refuse them. Every received waveform becomes a
/// sample block, and every outgoing one the reference channel. Beams follow each other, each with a
/// response and noise of its own. The geolocation of the first and the last sample gives origin and direction
/// of each shot, so heights are above the ellipsoid WGS 84, and ranges count from the first sample.
/// Flags, tides and further values of the product pass through to `write_footprints`.
///
/// `extent_deg`, `time_s` and `shots` cut the recording: a shot is read if it meets all that are given. The samples of other
/// shots are not decoded, and the shots are counted by the reason. A cut that leaves no shot is a warning, which has the
/// longitudes, latitudes, times or numbers of the file.
///
/// Files with results only (`GEDI02_A`) are refused, and named. Rejected, and counted, are shots that cannot be read
/// and shots without position.
///
/// Pulses of SPD, versions 3 and 4, become shots of scan lines in the coordinate reference system of the file, for
/// `decompose`. A sample is at the range to the start of its waveform plus its time, along the beam from the origin; azimuths
/// count from the y axis to the x axis, zeniths from upwards, and the speed of light is SPDLib's, in air of the
/// refractive index 1.000268008. Transmitted samples become the reference channel, but ranges count from the origin alone, as in
/// SPDLib. Channels follow RIEGL's files: 0 is high power, 1 is low power, 2 is saturation; a single channel is low
/// power. Gains that differ become the gain control; offsets of waveforms are part of the background. Times count from
/// any origin: `recording_time` states it. The keys `beams`, `split_beams`, `extent_deg` and `shots` do not apply. Rejected, and
/// counted, are pulses that cannot be read, or have no received samples, no finite origin, no finite angles or an impossible range.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ReadHdf5 {
    /// The `.h5` file, a list of files, or a pattern.
    pub path: Paths,
    /// Beams to read: names as in the file (`BEAM0101`), `"power"` or `"coverage"`. All if left out.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub beams: Vec<String>,
    /// Makes each beam a recording of its own: it has its own run, model, report entry and outputs, whose names end in
    /// the name of the beam, as in `GEDI01_B_2019_BEAM0101.laz`. Otherwise outputs have all beams.
    #[serde(default)]
    pub split_beams: bool,
    /// Area to read, degrees on WGS 84, the border included; the position of a shot is that of its first sample. A box is
    /// west, south, east and north; a west greater than the east crosses the antimeridian. A polygon is a list of
    /// points, each longitude and latitude, or a GeoJSON file with a Polygon or MultiPolygon. Its edges are straight in
    /// longitude and latitude and at most 180 degrees long; across the antimeridian, count longitudes beyond 180.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(transform = at_least(-180.0).at_most(360.0))]
    pub extent_deg: Option<ExtentKey>,
    /// Shots to read: their numbers as in the file (`shot_number`), or a text file with one number per line. All if
    /// left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub shots: Option<ShotList>,
    /// Range of the samples.
    #[serde(flatten)]
    pub full_scale: FullScale,
    /// Speed of the pulse.
    #[serde(flatten)]
    pub pulse_speed: PulseSpeed,
    /// Coordinate reference system of the recording.
    #[serde(flatten)]
    pub input_crs: InputCrs,
    /// Times of the recording.
    #[serde(flatten)]
    pub times: TimeKeys,
}

impl Config for ReadHdf5 {
    fn check(&self) -> std::result::Result<(), InvalidKey> {
        self.times.check()?;
        self.input_crs.check()?;
        cut::check(self)
    }

    fn inputs(&self) -> Vec<&str> {
        let shots = match &self.shots {
            Some(ShotList::File(name)) => Some(name.as_str()),
            _ => None,
        };
        let extent = self.extent_deg.as_ref().and_then(ExtentKey::file);
        shots.into_iter().chain(extent).chain(self.input_crs.file()).collect()
    }
}

impl SourceConfig for ReadHdf5 {
    fn paths(&self) -> Option<&Paths> {
        Some(&self.path)
    }

    fn part_key(&self) -> Option<&'static str> {
        self.split_beams.then_some("beams")
    }

    fn parts(&self, path: &Path) -> Vec<String> {
        if !self.split_beams {
            return Vec::new();
        }
        // The run of a file that cannot be read has the error.
        let Ok(granule) = Granule::open(path) else { return Vec::new() };
        let beams = selected(&granule, path, &self.beams).unwrap_or_default();
        beams.iter().map(|beam| beam.name.clone()).collect()
    }

    fn make(&self, run: &RunContext) -> Result<Box<dyn Source>> {
        let mut declared = Declared::new(&self.times, &self.input_crs, self.pulse_speed, run)?;
        if product_of(&run.input)? == Product::Spd {
            let source = SpdLineReader::open(&run.input, &run.stem, self, declared.crs_wkt.as_deref())?;
            declared.crs_wkt = declared.crs_wkt.map(|wkt| source.converted(wkt));
            return Ok(Box::new(AsDeclared::new(source, declared).checking_emissions()));
        }
        let cut = Cut::of(self, run)?;
        let beams = run.part.as_ref().map_or_else(|| self.beams.clone(), |beam| vec![beam.clone()]);
        let mut source = FootprintReader { cut, ..FootprintReader::open(&run.input, &run.stem, &beams)? };
        source.info = Sampling(OddSamples::default(), self.full_scale).with(source.info);
        Ok(Box::new(AsDeclared::new(source, declared)))
    }
}

/// Beams of a granule that a list of names and powers selects.
///
/// # Errors
/// An entry selects none.
fn selected<'a>(granule: &'a Granule, path: &Path, wanted: &[String]) -> Result<Vec<&'a Beam>> {
    let is = |beam: &Beam, word: &str| match word {
        "power" => beam.power == Some(Power::Full),
        "coverage" => beam.power == Some(Power::Coverage),
        name => beam.name == name,
    };
    let recorded = || granule.beams().iter().filter(|beam| beam.shots > 0);
    if let Some(none) = wanted.iter().find(|word| !recorded().any(|beam| is(beam, word))) {
        let mut names: Vec<&str> = recorded().map(|beam| beam.name.as_str()).collect();
        names.extend(["power", "coverage"].into_iter().filter(|word| recorded().any(|beam| is(beam, word))));
        return Err(StageError::failed(
            format!("{}: no beam with waveforms is `{none}`", path.display()),
            format!("choose from `beams` of: {}", names.join(", ")),
        ));
    }
    Ok(recorded().filter(|beam| wanted.is_empty() || wanted.iter().any(|word| is(beam, word))).collect())
}

/// A beam of a file, and the index of a shot in it.
pub struct BeamShot {
    /// Name of the beam.
    pub beam: String,
    /// Index, from 0.
    pub index: u64,
}

impl ReadHdf5 {
    /// Whether the shots of a file are those of beams, which [`ReadHdf5::find`] finds.
    pub fn has_beams(path: &Path) -> bool {
        // The reading has the error of other files.
        !product_of(path).is_ok_and(|product| product == Product::Spd)
    }

    /// Finds a shot by its number in its mission, or else by its running number.
    ///
    /// # Errors
    /// As [`ReadHdf5::at`].
    pub fn find(&self, path: &Path, shot: u64) -> Result<BeamShot> {
        let granule = Granule::open(path)?;
        for beam in selected(&granule, path, &self.beams)? {
            if let Some(index) = granule.beam(&beam.name)?.index_of(shot) {
                return Ok(BeamShot { beam: beam.name.clone(), index: index as u64 });
            }
        }
        self.at(path, shot)
    }

    /// Finds a shot by its running number in the selected beams, from 0.
    ///
    /// # Errors
    /// If the file cannot be read, or there is no such shot.
    pub fn at(&self, path: &Path, shot: u64) -> Result<BeamShot> {
        let granule = Granule::open(path)?;
        let mut before = 0;
        for beam in selected(&granule, path, &self.beams)? {
            let index = shot.saturating_sub(before);
            if index < beam.shots {
                return Ok(BeamShot { beam: beam.name.clone(), index });
            }
            before += beam.shots;
        }
        let problem = format!("{}: no shot {shot}", path.display());
        let remedy = format!("give a number of the column `shot_number`, or a running number below {before}");
        Err(StageError::failed(problem, remedy))
    }

    /// The reader of one beam.
    #[must_use]
    pub fn of_beam(&self, beam: &str) -> ReadHdf5 {
        ReadHdf5 { beams: vec![beam.to_owned()], ..self.clone() }
    }
}

struct FootprintReader {
    granule: Granule,
    /// Names of the beams, in the order in which they are read.
    beams: Vec<String>,
    /// Numbers of the first shot of each beam, and of all shots.
    first_shots: Vec<u64>,
    info: InputInfo,
    /// The open beam, with its number and metadata.
    open: Option<(usize, BeamReader, Arc<InputInfo>)>,
    /// Time of the first shot of the open beam, at which its clock is 0, s.
    clock_origin_s: f64,
    next_shot: u64,
    next_line: u32,
    shot: Shot,
    location: Option<LineLocation>,
    broken: BrokenRun,
    /// Shots to read; `None`: all.
    cut: Option<Cut>,
}

impl FootprintReader {
    fn open(path: &Path, stem: &str, beams: &[String]) -> Result<FootprintReader> {
        let granule = Granule::open(path)?;
        let selected = selected(&granule, path, beams)?;
        let mut total = 0;
        let mut first_shots = vec![0];
        first_shots.extend(selected.iter().map(|beam| {
            total += beam.shots;
            total
        }));
        let beams = selected.iter().map(|beam| beam.name.clone()).collect();
        let (instrument, format, time_scale) = match granule.product() {
            Product::GediL1b => ("GEDI", "GEDI L1B", TimeScale::Adjusted),
            // A granule is not opened of SPD.
            Product::LvisL1b | Product::Spd => ("LVIS", "LVIS L1B", TimeScale::Day),
        };
        let info = InputInfo {
            path: path.to_owned(),
            stem: stem.to_owned(),
            format: format.to_owned(),
            instrument: Some(instrument.to_owned()),
            sampling_interval_ns: INTERVAL_NS,
            time_scale,
            frame: Frame::Earth,
            emission_reference: EmissionReference::Clock,
            clock_sd_ns: Some(0.0),
            origin_is_sensor: false,
            ..InputInfo::default()
        };
        Ok(FootprintReader {
            granule,
            beams,
            first_shots,
            info,
            open: None,
            clock_origin_s: 0.0,
            next_shot: 0,
            next_line: 0,
            shot: Shot::default(),
            location: None,
            broken: BrokenRun::default(),
            cut: None,
        })
    }

    fn total(&self) -> u64 {
        self.first_shots.last().copied().unwrap_or(0)
    }

    /// Opens the beam of a shot, unless it is open; returns its number and the shot's index in it.
    fn open_beam_of(&mut self, shot: u64) -> Result<Option<(usize, usize)>> {
        let number = self.first_shots.partition_point(|first| *first <= shot).saturating_sub(1);
        let (Some(name), Some(first)) = (self.beams.get(number), self.first_shots.get(number)) else {
            return Ok(None);
        };
        if self.open.as_ref().is_none_or(|(open, ..)| *open != number) {
            let mut reader = self.granule.beam(name)?;
            let power =
                self.granule.beams().iter().find(|beam| beam.name == *name).and_then(|beam| beam.power);
            let info = InputInfo {
                beam: Some(name.clone()),
                beam_power: power.map(Power::name),
                columns: reader.columns(),
                ..self.info.clone()
            };
            let mut earliest = Shot::default();
            // The reading of this shot has the error.
            let is_read = reader.locate(0, &mut earliest).is_ok() && earliest.time_s.is_finite();
            self.clock_origin_s = if is_read { gps_time_s(&earliest, &info) } else { 0.0 };
            self.open = Some((number, reader, Arc::new(info)));
            self.cut.iter_mut().for_each(Cut::begin_beam);
        }
        Ok(Some((number, (shot - first) as usize)))
    }

    /// Reads shots from `next_shot` up to `until`, until the line is full or the beam ends.
    fn line(&mut self, until: u64, cx: &mut Context) -> Result<Option<ScanLine>> {
        let first_shot = self.next_shot;
        let Some((beam, _)) = self.open_beam_of(first_shot)? else { return Ok(None) };
        let end = self.first_shots.get(beam + 1).copied().unwrap_or(0).min(until);
        let (mut emissions, mut blocks) = (Vec::new(), Blocks::default());
        while self.next_shot < end && emissions.len() < SHOTS_PER_LINE {
            let number = self.next_shot;
            self.next_shot += 1;
            let Some((_, index)) = self.open_beam_of(number)? else { break };
            let Some((_, reader, info)) = &mut self.open else { break };
            if let Some(cut) = &mut self.cut {
                // The samples of shots that are cut are not decoded.
                let located = reader.locate(index, &mut self.shot);
                if !self.broken.accepts(located, cx, Reason::UnreadableShot)? {
                    continue;
                }
                if let Some(reason) = cut.reason(&self.shot, info)? {
                    cx.reject(reason, 1);
                    continue;
                }
            }
            let read = reader.shot(index, &mut self.shot);
            if !self.broken.accepts(read, cx, Reason::UnreadableShot)? {
                continue;
            }
            match emission(number, &self.shot, info) {
                Some((mut emission, interval_ns)) => {
                    let clock_s = emission.gps_time_s - self.clock_origin_s;
                    emission.clock_ps = (clock_s * 1e12).round() as i64;
                    add_blocks(emissions.len() as u32, &self.shot, interval_ns, info, &mut blocks);
                    emissions.push(emission);
                }
                None => cx.reject(Reason::ShotWithoutPosition, 1),
            }
        }
        let Some((_, _, info)) = &self.open else { return Ok(None) };
        let line = ScanLine::of_shots(Arc::clone(info), self.next_line, emissions, blocks);
        self.location = Some(LineLocation {
            records: first_shot..self.next_shot,
            row: 0,
            line: self.next_line,
            first_shot,
            is_complete: true,
        });
        self.next_line += 1;
        Ok(Some(line))
    }
}

impl Source for FootprintReader {
    fn next(&mut self, cx: &mut Context) -> Result<Option<ScanLine>> {
        while self.next_shot < self.total() {
            if let Some(line) = self.line(u64::MAX, cx)?.filter(|line| !line.emissions.is_empty()) {
                return Ok(Some(line));
            }
        }
        self.broken.check_at_end()?;
        self.cut.iter().for_each(|cut| cut.report(cx));
        Ok(None)
    }

    fn progress(&self) -> Option<f64> {
        Some(self.next_shot as f64 / self.total().max(1) as f64)
    }

    fn location(&self) -> Option<LineLocation> {
        self.location.clone()
    }

    fn line_at(&mut self, location: &LineLocation, cx: &mut Context) -> Result<Option<ScanLine>> {
        (self.next_shot, self.next_line) = (location.records.start, location.line);
        self.line(location.records.end, cx)
    }
}

/// The shot with origin and direction from the positions of its first and last sample, and its sampling interval, ns;
/// `None` without them.
fn emission(number: u64, shot: &Shot, info: &InputInfo) -> Option<(Emission, f64)> {
    let steps = shot.received_dn.len().checked_sub(1).filter(|steps| *steps > 0)? as f64;
    let [first, last] =
        [&shot.first_bin, &shot.last_bin].map(|place| ecef_m(place).filter(|_| place.is_known()));
    let (first, last) = (first?, last?);
    let along = [0, 1, 2].map(|axis| last[axis] - first[axis]);
    let length_m = along.iter().map(|part| part * part).sum::<f64>().sqrt();
    if !(length_m > 0.0 && length_m.is_finite()) {
        return None;
    }
    let gps_time_s = gps_time_s(shot, info);
    let m_per_ns = 0.5e-9 * info.group_velocity_mps;
    let interval_ns = (length_m / steps / m_per_ns / INTERVAL_STEP_NS).round() * INTERVAL_STEP_NS;
    let emission = Emission {
        shot: number,
        gps_time_s,
        clock_ps: 0,
        origin_m: first,
        direction: along.map(|part| part / length_m),
        frame_scale: length_m / (m_per_ns * interval_ns * steps),
        ..Emission::default()
    };
    (interval_ns > 0.0).then_some((emission, interval_ns))
}

/// Time of a shot on the scale of the recording, s.
fn gps_time_s(shot: &Shot, info: &InputInfo) -> f64 {
    match info.time_scale {
        TimeScale::Adjusted => shot.time_s - ADJUSTED_ORIGIN_S,
        _ => shot.time_s,
    }
}

fn ecef_m(place: &Position) -> Option<[f64; 3]> {
    let Position { longitude_rad, latitude_rad, height_m } = *place;
    let ecef_m = WGS84.ecef_of(Geodetic { latitude_rad, longitude_rad, height_m });
    ecef_m.iter().all(|value| value.is_finite()).then_some(ecef_m)
}

fn add_blocks(emission: u32, shot: &Shot, interval_ns: f64, info: &InputInfo, blocks: &mut Blocks) {
    if !shot.outgoing_dn.is_empty() {
        blocks.push_fractions(emission, Channel::Reference, 0.0, interval_ns, &shot.outgoing_dn);
    }
    blocks.push_fractions(emission, Channel::LowPower, 0.0, interval_ns, &shot.received_dn);
    let noise = RecordedNoise { mean_dn: f64::from(shot.noise_mean_dn), sd_dn: f64::from(shot.noise_sd_dn) };
    let value = |name: &str| {
        let index = info.columns.iter().position(|column| *column == name)?;
        shot.columns.get(index).copied()
    };
    let is_set = |name: &str| value(name).is_some_and(|flag| flag != 0.0);
    blocks.footprints.push(FootprintRecord {
        emission,
        shot_number: shot.shot_number,
        noise: Some(noise).filter(|noise| noise.mean_dn.is_finite() && noise.sd_dn > 0.0),
        is_degraded: is_set("degrade") || is_set("stale_return_flag"),
        columns: shot.columns.clone().into_boxed_slice(),
    });
}

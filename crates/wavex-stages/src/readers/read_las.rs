//! `read_las`: reads full-waveform LAS as scan lines of shots.

mod contradiction;
mod geometry;
mod pulse;
mod recent;

pub(crate) use contradiction::{checks, crs_check};

use std::path::Path;
use std::sync::Arc;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::reading::bad_records::BrokenRun;
use crate::reading::emission_choice::{self, ChoiceMessage, Smoothness};
use crate::reading::line_splitter::LineSplitter;
use crate::reading::recording::units::RecordingUnits;
use crate::reading::recording::{
    AsDeclared, Declared, FullScale, InputCrs, OddSamples, PulseSpeed, Sampling, TimeKeys,
};
use geometry::{FileGeometry, convert_heights, first_sample, is_usable};
use pulse::same_pulse;
use recent::RecentPackets;
use wavex_formats::RecordedCrs;
use wavex_formats::las::{GpsTime, Point, Reader};
use wavex_line::keys::InvalidKey;
use wavex_line::scan_line::{
    Channel, Emission, EmissionReference, Frame, GainControl, InputInfo, Kind, OnlineReturn, ScanLine,
    TimeScale, emission_flags,
};
use wavex_line::stage::{
    Config, Context, LineLocation, Paths, Reason, Result, RunContext, Source, SourceConfig, StageError,
    StageSpec,
};

/// Registry entry of the stage.
pub const STAGE: StageSpec = StageSpec::source::<ReadLas>("read_las", Kind::Shots);

/// Reads full-waveform LAS and LAZ.
///
/// Supports versions 1.3 and 1.4 with point formats 4, 5, 9 and 10, and waveform packets inside the
/// file or in the `.wdp` file next to it, or compressed in its `.wdz` file (LAStools).
///
/// Consecutive points with the same time and direction form one shot and share its waveforms; shots
/// keep the order of the file. Points of several scanner channels form one shot only if their
/// returns are numbered together, as `write_las` does for two receivers of one pulse. Lasers that
/// fire simultaneously have separate numbering or different directions.
///
/// The points of the file are used for one purpose only. The format has no outgoing pulse; only the
/// return locations of the points within their waveforms preserve the sub-sample offset of the
/// emission. Where a file has these locations, times of flight are tied to them (see `decompose`);
/// where it has none, the report says so. Locations can be less exact than the waveforms, for example
/// whole samples: then points of neighbouring single echoes are smoother by the waveforms' own
/// positions, and locations are not used. The reader decides this from the first 100 000 shots at
/// most, as `read_pulsewaves` does, and the report gives the figures. As there, smooth points bound the
/// jitter of emission times without locations.
///
/// The format does not store the scanner position, so ranges count from the first sample of the
/// shot's first waveform. Coordinates are not affected, but `correct` cannot correct intensities
/// for range and attenuation. The refractive index of air is that of the file: changing it would
/// require ranges from the sensor. All waveforms are assigned to the low-power receiver, including
/// those of a second receiver.
///
/// Rejects points without a waveform, points whose waveform cannot be read, and waveforms that
/// occur again after other pulses (in files not sorted by time), and continues with the next.
/// `online_points` does not restore points without a waveform, because beams are known only from
/// waveforms; the report gives their number.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ReadLas {
    /// The `.las` or `.laz` file, a list of files, or a pattern.
    pub path: Paths,
    /// Timing of the samples of a block.
    #[serde(flatten)]
    pub odd_samples: OddSamples,
    /// Range of the samples.
    #[serde(flatten)]
    pub full_scale: FullScale,
    /// Added to the time of each waveform relative to its pulse, ns. Positive values
    /// move points along the beam, away from the sensor.
    #[serde(default)]
    #[schemars(range(min = -1000.0, max = 1000.0))]
    pub range_time_offset_ns: f64,
    /// Coordinate reference system of the recording.
    #[serde(flatten)]
    pub input_crs: InputCrs,
    /// Time of emission: decided from the data, from the return locations, or from the positions of
    /// the waveforms alone. Without effect for files without return locations.
    #[serde(default)]
    pub emission: LasEmission,
    /// Direction vectors of the points: as stored, in metres per picosecond, or their directions only,
    /// with the speed of light in air. Vectors of another unit than the format's are an error
    /// otherwise.
    #[serde(default)]
    pub beam_vectors: BeamVectors,
    /// Whether points must lie at the echoes of their waveforms: the median distance of single echoes
    /// must be at most 1 m. Otherwise return locations or packets are wrong, and so are all points.
    #[serde(default = "yes")]
    pub check_locations: bool,
    /// Times of the recording.
    #[serde(flatten)]
    pub times: TimeKeys,
}

const fn yes() -> bool {
    true
}

/// Use of the direction vectors of a LAS file.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum BeamVectors {
    /// Direction and length.
    #[default]
    Stored,
    /// Direction only.
    Direction,
}

/// Time of emission of a LAS file.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum LasEmission {
    /// The return locations, unless points are clearly smoother without them.
    #[default]
    Auto,
    /// The return locations of the points.
    ReturnLocations,
    /// The positions of the waveforms.
    Clock,
}

impl Config for ReadLas {
    fn check(&self) -> std::result::Result<(), InvalidKey> {
        self.times.check()?;
        self.input_crs.check()
    }

    fn inputs(&self) -> Vec<&str> {
        self.input_crs.file()
    }
}

impl SourceConfig for ReadLas {
    fn paths(&self) -> Option<&Paths> {
        Some(&self.path)
    }

    fn make(&self, run: &RunContext) -> Result<Box<dyn Source>> {
        // A job refuses a truncated file at once.
        drop(Reader::open(&run.input)?);
        self.make_for_inspection(run, true)
    }

    fn make_for_inspection(&self, run: &RunContext, with_samples: bool) -> Result<Box<dyn Source>> {
        let mut declared = Declared::new(&self.times, &self.input_crs, PulseSpeed::default(), run)?;
        let crs_wkt = declared.crs_wkt.take();
        let open = || LasReader::open(&run.input, &run.stem, self, crs_wkt.as_deref());
        let mut source = open()?;
        declared.crs_wkt = crs_wkt.clone().map(|wkt| source.geometry.units.converted(wkt));
        contradiction::check_beams(&source.geometry)?;
        if self.check_locations {
            contradiction::check_locations(&mut Reader::open_partial(&run.input)?.0, &source.geometry)?;
        }
        source.reader.skip_unused_fields();
        (source.with_samples, source.range_time_offset_ns) = (with_samples, self.range_time_offset_ns);
        if with_samples {
            source.choose_emission(self.emission, &mut open()?);
        }
        if self.times.recording_time.is_some() {
            source.time_shift_s = 0.0;
        }
        Ok(Box::new(AsDeclared::new(source, declared)))
    }
}

struct LasReader {
    reader: Reader,
    /// If false, waveform packets are not read.
    with_samples: bool,
    /// Added to times of flight, ns.
    range_time_offset_ns: f64,
    /// Added to point times, s, to give seconds of the GPS week or adjusted GPS time.
    time_shift_s: f64,
    points_read: u64,
    points: u64,
    /// The point read last, the first of the next pulse, and its number.
    ahead: Option<(u64, Point)>,
    pulse: Vec<Point>,
    /// Number of the first point of the current pulse.
    first_point: u64,
    /// A complete shot that begins the next line.
    waiting: Option<PendingShot>,
    next_shot: u64,
    geometry: FileGeometry,
    lines: LineSplitter,
    recent: RecentPackets,
    broken: BrokenRun,
    /// Number of points without a waveform.
    without_waveform: u64,
    /// Message about the emission reference, until it is reported.
    message: Option<ChoiceMessage>,
    /// Bytes after the points that belong to nothing, until they are reported.
    surplus_bytes: u64,
    /// Number of packets with more samples than their descriptor says.
    longer_packets: u64,
    /// Error of a file with fewer points than declared, until it is returned.
    missing: Option<wavex_formats::Error>,
}

/// A shot assembled from its points.
struct PendingShot {
    first_point: u64,
    emission: Emission,
    waveforms: ShotWaveforms,
}

/// The waveforms of a shot.
#[derive(Default)]
struct ShotWaveforms {
    packets: Vec<PacketBytes>,
    /// Return locations of the pulse's points.
    online: Vec<OnlineReturn>,
    /// Position of the first sample of the first waveform; `None` without a usable waveform.
    origin_m: Option<[f64; 3]>,
}

/// One waveform of a shot.
struct PacketBytes {
    start_ns: f64,
    interval_ns: f64,
    n_samples: u32,
    /// Empty if samples are not read.
    samples: Vec<u16>,
}

/// Largest return number of the format; more points with one time and direction belong to several
/// pulses.
const MOST_RETURNS: usize = 15;

impl LasReader {
    fn open(path: &Path, stem: &str, keys: &ReadLas, declared_crs: Option<&str>) -> Result<LasReader> {
        let (reader, missing) = Reader::open_partial(path)?;
        let of_file = reader.crs();
        let units = RecordingUnits::of(declared_crs.or(of_file.wkt.as_deref()));
        let geometry = FileGeometry::learn(&mut Reader::open_partial(path)?.0, keys.beam_vectors, units)?;
        let crs = units.describe(of_file, declared_crs.is_some());
        let input =
            Sampling(keys.odd_samples, keys.full_scale).with(describe(&reader, path, stem, &geometry, crs));
        Ok(LasReader {
            with_samples: true,
            range_time_offset_ns: 0.0,
            time_shift_s: time_shift_s(&reader),
            points_read: 0,
            points: reader.header().n_points,
            ahead: None,
            pulse: Vec::new(),
            first_point: 0,
            waiting: None,
            next_shot: 0,
            lines: LineSplitter::new(Arc::new(input)),
            recent: RecentPackets::default(),
            broken: BrokenRun::default(),
            without_waveform: 0,
            message: None,
            surplus_bytes: reader.surplus_bytes(),
            longer_packets: 0,
            missing,
            reader,
            geometry,
        })
    }

    /// Decides on the emission reference from the first shots of a second reader.
    fn choose_emission(&mut self, key: LasEmission, ahead: &mut LasReader) {
        let has_locations = self.geometry.has_locations;
        let references =
            if has_locations { emission_choice::WITH_LOCATIONS } else { emission_choice::WITHOUT };
        let smoothness = Smoothness::look_ahead(ahead, references);
        let choice = match key {
            _ if !has_locations => smoothness.take(EmissionReference::Clock),
            LasEmission::Auto => smoothness.choose(EmissionReference::ReturnLocations, true),
            LasEmission::ReturnLocations => smoothness.set(EmissionReference::ReturnLocations),
            LasEmission::Clock => smoothness.set(EmissionReference::Clock),
        };
        self.lines = LineSplitter::new(Arc::new(choice.describe(self.lines.input())));
        self.message = choice.message;
    }

    /// Collects the points of the next pulse; false at the end of the file.
    fn next_pulse(&mut self, cx: &mut Context) -> Result<bool> {
        self.pulse.clear();
        if let Some((number, point)) = self.ahead.take() {
            self.first_point = number;
            self.pulse.push(point);
        }
        loop {
            let mut point = Point::default();
            if !self.reader.next_point(&mut point)? {
                return Ok(!self.pulse.is_empty());
            }
            self.points_read += 1;
            if point.wave.descriptor == 0 {
                cx.reject(Reason::PointWithoutWaveform, 1);
                self.without_waveform += 1;
                continue;
            }
            convert_heights(&mut point, self.geometry.units);
            if !is_usable(&point) {
                cx.reject(Reason::PointWithoutBeam, 1);
                continue;
            }
            let has_room = self.pulse.len() < MOST_RETURNS;
            let number = self.points_read - 1;
            if self.pulse.is_empty() {
                self.first_point = number;
                self.pulse.push(point);
            } else if has_room && same_pulse(&self.pulse, &point) {
                self.pulse.push(point);
            } else {
                self.ahead = Some((number, point));
                return Ok(true);
            }
        }
    }

    /// Assembles the current pulse; `None` without a usable waveform.
    fn shot(&mut self, cx: &mut Context) -> Result<Option<PendingShot>> {
        let Some(first) = self.pulse.first() else { return Ok(None) };
        let (time_s, scan_angle_deg, direction_positive) =
            (first.gps_time, first.scan_angle_deg, first.scan_direction);
        let beam = self.geometry.beam(&first.wave);
        let length = beam.iter().map(|x| x * x).sum::<f64>().sqrt();
        let direction = beam.map(|x| x / length);
        let metres_per_ns = self.geometry.beams.of(beam);
        let waveforms = self.waveforms(direction, metres_per_ns, cx)?;
        let Some(origin_m) = waveforms.origin_m else { return Ok(None) };
        let flag = |set: bool, bit: u16| if set { bit } else { 0 };
        let edge = self.pulse.iter().any(|point| point.edge_of_flight_line);
        let emission = Emission {
            shot: self.next_shot,
            gps_time_s: time_s + self.time_shift_s,
            clock_ps: clock_ps(time_s),
            origin_m,
            direction,
            frame_scale: metres_per_ns / (self.geometry.group_velocity_mps * 0.5e-9),
            flags: flag(edge, emission_flags::EDGE_OF_FLIGHT_LINE)
                | flag(direction_positive, emission_flags::SCAN_DIRECTION_POSITIVE),
            mta_zone: Some(0),
            scan_angle_deg,
            ..Emission::default()
        };
        self.next_shot += 1;
        Ok(Some(PendingShot { first_point: self.first_point, emission, waveforms }))
    }

    /// Reads the waveforms of the current pulse.
    fn waveforms(
        &mut self,
        direction: [f64; 3],
        metres_per_ns: f64,
        cx: &mut Context,
    ) -> Result<ShotWaveforms> {
        let mut found = ShotWaveforms::default();
        for i in 0..self.pulse.len() {
            let wave = self.pulse[i].wave;
            if self.pulse[..i].iter().any(|earlier| earlier.wave.offset == wave.offset) {
                continue;
            }
            if !self.recent.is_new(wave.offset) {
                cx.reject(Reason::SharedWaveform, 1);
                continue;
            }
            let mut samples = Vec::new();
            let read = match self.with_samples {
                true => self.reader.packet(&wave, &mut samples),
                // The same waveforms are rejected: shots have the same numbers.
                false => self.reader.packet_descriptor(&wave),
            };
            self.longer_packets += u64::from(read.as_ref().is_ok_and(|of| of.surplus_bytes(&wave) > 0));
            let (interval_ns, n_samples) = read.as_ref().map_or((0.0, 0), |descriptor| {
                (f64::from(descriptor.spacing_ps) / 1000.0, descriptor.samples)
            });
            if !self.broken.accepts(read, cx, Reason::UnreadableWaveform)? {
                continue;
            }
            let start_m = first_sample(&self.pulse, wave.offset, &self.geometry);
            let origin_m = *found.origin_m.get_or_insert(start_m);
            let along_m: f64 = (0..3).map(|axis| (start_m[axis] - origin_m[axis]) * direction[axis]).sum();
            let start_ns = along_m / metres_per_ns + self.range_time_offset_ns;
            for point in self.pulse.iter().filter(|point| point.wave.offset == wave.offset) {
                let time_ns = start_ns + f64::from(point.wave.location_ps) / 1000.0;
                found.online.push(OnlineReturn {
                    emission: 0,
                    time_ns,
                    amplitude: f32::from(point.intensity),
                });
            }
            found.packets.push(PacketBytes { start_ns, interval_ns, n_samples, samples });
        }
        found.online.sort_by(|a, b| a.time_ns.total_cmp(&b.time_ns));
        Ok(found)
    }

    /// At the end of the file: fails if no point gave a shot.
    fn check_yield(&self, cx: &Context) -> Result<()> {
        if self.next_shot > 0 || self.points_read == 0 {
            return Ok(());
        }
        let rejected = &cx.counters().rejected;
        let most = rejected.iter().max_by_key(|(_, n)| **n).map_or("", |((_, reason), _)| reason.text());
        let n = self.points_read;
        let (points, were) =
            if n == 1 { ("the only point".to_owned(), "was") } else { (format!("all {n} points"), "were") };
        Err(StageError::failed(
            format!("{points} of the file {were} rejected (most common reason: {most})"),
            "check its point format, or export it again",
        ))
    }

    fn add(&mut self, shot: PendingShot) {
        let index = self.lines.add(shot.first_point, shot.emission);
        let blocks = self.lines.blocks();
        for packet in &shot.waveforms.packets {
            let (start_ns, interval_ns) = (packet.start_ns, packet.interval_ns);
            if self.with_samples {
                blocks.push(index, Channel::LowPower, None, start_ns, interval_ns, &packet.samples);
            } else {
                let n_samples = packet.n_samples;
                blocks.push_without_samples(index, Channel::LowPower, None, start_ns, interval_ns, n_samples);
            }
        }
        if self.geometry.has_locations {
            blocks.online.extend(
                shot.waveforms.online.into_iter().map(|online| OnlineReturn { emission: index, ..online }),
            );
        }
    }
}

impl Source for LasReader {
    fn next(&mut self, cx: &mut Context) -> Result<Option<ScanLine>> {
        if let Some(message) = self.message.take() {
            message.report(cx);
        }
        if let surplus @ 1.. = std::mem::take(&mut self.surplus_bytes) {
            cx.warn(format!(
                "{surplus} bytes follow the points and belong to no record of the file; \
                 compare the number of points with that of the export"
            ));
        }
        loop {
            if let Some(shot) = self.waiting.take() {
                self.add(shot);
            }
            if !self.next_pulse(cx)? {
                // A truncated file ends with an error, after everything it contains has been
                // emitted.
                if let Some(line) = self.lines.take() {
                    return Ok(Some(line));
                }
                self.broken.check_at_end()?;
                if let Some(missing) = self.missing.take() {
                    return Err(missing.into());
                }
                self.check_yield(cx)?;
                if self.longer_packets > 0 {
                    cx.warn(format!(
                        "{} waveform packets {}: those after them are not read, and echoes there are missing; export \
                         the file again with the right number of samples",
                        self.longer_packets,
                        contradiction::MORE_SAMPLES
                    ));
                }
                if self.without_waveform > 0 {
                    cx.warn(without_waveform(self.without_waveform));
                }
                return Ok(None);
            }
            let Some(shot) = self.shot(cx)? else { continue };
            let ends = self.lines.ends_before(&shot.emission);
            self.waiting = Some(shot);
            if ends {
                return Ok(self.lines.take());
            }
        }
    }

    fn progress(&self) -> Option<f64> {
        Some(self.points_read as f64 / self.points.max(1) as f64)
    }

    fn location(&self) -> Option<LineLocation> {
        self.lines.location()
    }

    fn line_at(&mut self, location: &LineLocation, cx: &mut Context) -> Result<Option<ScanLine>> {
        self.reader.seek(location.records.start)?;
        (self.ahead, self.waiting) = (None, None);
        (self.points_read, self.next_shot) = (location.records.start, location.first_shot);
        (self.recent, self.broken) = (RecentPackets::default(), BrokenRun::default());
        self.lines.begin_at(location);
        while self.next_pulse(cx)? && self.first_point < location.records.end {
            if let Some(shot) = self.shot(cx)? {
                self.add(shot);
            }
        }
        Ok(self.lines.take())
    }
}

/// Returns the note on points without a waveform.
fn without_waveform(n: u64) -> String {
    let (points, have, are) = if n == 1 { ("point", "has", "is") } else { ("points", "have", "are") };
    format!(
        "{n} {points} of the file {have} no waveform and {are} omitted, whatever the value of \
         `online_points`, because beams are known only from waveforms; take them from the file itself"
    )
}

/// Converts seconds to whole picoseconds, modulo 1e6 s.
fn clock_ps(time_s: f64) -> i64 {
    // Adjusted times of 1e9 s do not fit. The clock may have any origin, so multiples of 1e6 s are
    // dropped.
    ((time_s.rem_euclid(1e6)) * 1e12).round() as i64
}

/// Offset from point times to adjusted GPS times, s; 0 for GPS week times.
fn time_shift_s(reader: &Reader) -> f64 {
    match reader.header().gps_time() {
        GpsTime::Standard { offset_s } => offset_s - wavex_geodesy::time::ADJUSTMENT_S,
        GpsTime::Week => 0.0,
    }
}

fn describe(
    reader: &Reader,
    path: &Path,
    stem: &str,
    geometry: &FileGeometry,
    crs: RecordedCrs,
) -> InputInfo {
    let header = reader.header();
    let (mut scale, mut offset) = (header.scale, header.offset);
    scale[2] *= geometry.units.height_factor;
    offset[2] *= geometry.units.height_factor;
    let unknown = InputInfo::default();
    let interval_ns = geometry.sampling.map(|sampling| f64::from(sampling.spacing_ps) / 1000.0);
    // 16-bit samples often hold fewer bits; the full scale is then unknown.
    let bits = geometry.sampling.map(|sampling| sampling.bits).filter(|bits| *bits < 16);
    InputInfo {
        path: path.to_path_buf(),
        stem: stem.to_string(),
        format: format!(
            "LAS {}.{}, point format {}",
            header.version.0, header.version.1, header.point_format
        ),
        instrument: Some(header.system_identifier.clone()).filter(|name| !name.is_empty()),
        sampling_interval_ns: interval_ns.unwrap_or(unknown.sampling_interval_ns),
        full_scale_dn: bits.map(|bits| (1 << bits) - 1),
        gain_control: match reader.has_different_gains() {
            true => GainControl::NotRecorded,
            false => GainControl::Off,
        },
        group_velocity_mps: geometry.group_velocity_mps,
        time_scale: match header.gps_time() {
            GpsTime::Standard { .. } => TimeScale::Adjusted,
            GpsTime::Week => TimeScale::Week,
        },
        // Many writers leave the bit of adjusted GPS time unset whatever their times are.
        time_scale_is_inferred: header.gps_time() == GpsTime::Week,
        recorded: (header.creation_year > 0).then_some((header.creation_day, header.creation_year)),
        is_file_date: header.creation_year > 0,
        frame: Frame::Map,
        crs_wkt: crs.wkt,
        crs_problems: crs.problems,
        coordinate_grid: Some((scale, offset)),
        emission_reference: match geometry.has_locations {
            true => EmissionReference::ReturnLocations,
            false => EmissionReference::Clock,
        },
        origin_is_sensor: false,
        ..unknown
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn clocks_keep_their_picoseconds() {
        assert_eq!(clock_ps(400_992.338_303), 400_992_338_303_000_000);
    }
}

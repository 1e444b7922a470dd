//! `read_sdf`: reads recorded waveforms from RIEGL SDF through RIEGL's library.

use std::collections::VecDeque;
use std::path::Path;
use std::sync::Arc;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::reading::line_splitter::LineSplitter;
use crate::reading::recording::time::{self, Axis, RecordedTimeScale, Times};
use crate::reading::recording::{self, OddSamples, PulseSpeed, TimeKeys, Watched};
use wavex_formats::extensions::is_wfm;
use wavex_formats::sdf::{CalibrationTables, SdfReader, SdfRecord, channel};
use wavex_line::keys::InvalidKey;
use wavex_line::scan_line::{
    AmplitudeTable, Channel, Emission, EmissionReference, Frame, GainControl, InputInfo, Kind, ScanLine,
};
use wavex_line::stage::{
    self, Context, LineLocation, Paths, Reason, Result, RunContext, Source, SourceConfig, StageSpec,
};

mod shot;

use shot::{ReadShot, What, channel_of, fine_ns, what_is, zero_of};

/// Registry entry of the stage.
pub const STAGE: StageSpec = StageSpec::source::<ReadSdf>("read_sdf", Kind::Shots);

/// Reads RIEGL SDF and WFM files through RIEGL's library; untested on real files.
///
/// No real SDF file was available. The stage follows RIEGL's public interface and is tested against
/// a substitute library with the same thirteen functions. If you own an SDF or WFM file, please try
/// it and report the result.
///
/// The layout of SDF is not public. RIEGL's Waveform Extraction Library (RiWAVELib) reads it;
/// owners of a RIEGL instrument get it from RIEGL, and wavex may not ship it. It is loaded at run
/// time: `sdfifc` for `.sdf`, `wfmifc-mt` for `.wfm`. It is looked for where the key `library`
/// points, then where the environment variable `WAVEX_RIWAVELIB` points, then in the usual library
/// folders. The log names the library before it is loaded.
///
/// A block belongs to the shot whose range gate was open when the echo arrived, which need not be
/// the shot that caused it: its MTA zone is unresolved. Origins and directions are in the scanner's
/// own frame. Shots are numbered in reading order.
///
/// A scan line ends with an end-of-line record, or where the facet, the sweep or the clock ends it.
/// Its last shot has the edge-of-flight-line flag, except at the end of the file and where an
/// overlong line is split. The shot's time on the instrument clock becomes whole picoseconds; the
/// double returned by the library resolves 0.5 ps below 4096 s and 58 ps (9 mm) at 409 397 s.
/// Ranges within a record are not affected: block times are read relative to their record, to a
/// millionth of a nanosecond. A reference block without samples (`.wfm`) carries the time of
/// emission: it sets the shot's clock, and the times of the other blocks count from it.
///
/// The time of emission is the peak of the reference block. SDF gives every block its time on the
/// instrument clock, so there is nothing to decide, unlike in `read_pulsewaves`.
///
/// Seconds of the week or day that wrap around within a recording are unwrapped. The GPS week is
/// taken from the recording's epoch and from a file name of the form `YYMMDD_HHMMSS`, or from the
/// key `gps_date`. Amplitude and range tables are adopted; if the library has none, or no licence
/// for them, the report says so.
///
/// The reader seeks to the start of `time_s` instead of reading up to it. `time_s` counts seconds
/// of the instrument clock if that is not synchronised with GPS.
///
/// If the library needs an index that is missing, it creates one: it reads the whole file and
/// writes the index next to the data or into `index_dir`.
///
/// Housekeeping records are skipped. Rejected, and counted with their blocks, are shots with: an
/// origin or direction that is not finite, a direction that is not a unit vector (to 1e-3; beyond
/// 1e-6 it is normalised), an infinite time, a clock that is not finite or beyond 106 days, no time
/// although `time_s` is set, or a block of an unknown channel or without a time. A record without
/// blocks and direction is not a shot; it ends a line.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ReadSdf {
    /// The `.sdf` or `.wfm` file, a list of files, or a pattern. The job runs once for each.
    pub path: Paths,
    /// RIEGL's library, or the folder that contains it. Cannot be set in a job file, which may come
    /// from others: give `--set read_sdf.library=PATH` on the command line.
    #[serde(default)]
    #[schemars(extend("x-file" = "library"))]
    pub library: Option<String>,
    /// Folder for the index that the library creates, if the folder of the data is not writable. It
    /// must support symbolic links.
    #[serde(default)]
    pub index_dir: Option<String>,
    /// Speed of the pulse.
    #[serde(flatten)]
    pub pulse_speed: PulseSpeed,
    /// Timing of the samples of a block.
    #[serde(flatten)]
    pub odd_samples: OddSamples,
    /// Times of the recording.
    #[serde(flatten)]
    pub times: TimeKeys,
}

impl stage::Config for ReadSdf {
    fn check(&self) -> std::result::Result<(), InvalidKey> {
        self.path.check()?;
        let unless = InvalidKey::unless;
        unless(
            !self.path.patterns().iter().any(|path| path == "-"),
            "path",
            "standard input cannot be read: give a file",
        )?;
        let is_given = |text: &Option<String>| text.as_ref().is_none_or(|text| !text.is_empty());
        unless(is_given(&self.library), "library", "the path is empty")?;
        unless(is_given(&self.index_dir), "index_dir", "the path is empty")?;
        self.times.check()
    }

    fn local_keys(&self) -> &'static [&'static str] {
        &["library", "index_dir"]
    }
}

impl SourceConfig for ReadSdf {
    fn paths(&self) -> Option<&Paths> {
        Some(&self.path)
    }

    fn make(&self, run: &RunContext) -> Result<Box<dyn Source>> {
        Ok(Box::new(SdfLineReader::open(self, run)?))
    }
}

/// A file being read.
struct SdfLineReader {
    reader: SdfReader,
    lines: LineSplitter,
    window: Option<TimeWindow>,
    /// Converts external times to times of the recording.
    axis: Axis,
    /// Records read ahead to inspect the file.
    ahead: VecDeque<SdfRecord>,
    /// The current record.
    record: SdfRecord,
    /// The shot of the current record, if it begins the next line.
    waiting: Option<Emission>,
    /// Number of shots emitted.
    shots: u64,
    /// Number of records read.
    records: u64,
    /// Notes not yet issued.
    remarks: Vec<String>,
    /// Whether any end-of-line mark was seen.
    ends_are_marked: bool,
    at_end: bool,
}

/// The time window to read.
struct TimeWindow {
    watched: Watched,
    /// True for external times, false for times of the instrument clock.
    is_external: bool,
    /// Time of the last shot inside the window.
    now_s: f64,
    /// Number of consecutive shots after the window.
    late: u32,
}

/// Number of records searched for an outgoing pulse.
const LOOKED_AT: usize = 1000;
/// The search stops after this many samples.
const SAMPLES_LOOKED_AT: usize = 1 << 22;
/// Consecutive late shots that end a window; fewer may have wrong times.
const LATE_SHOTS: u32 = 100;

impl SdfLineReader {
    fn open(config: &ReadSdf, run: &RunContext) -> Result<SdfLineReader> {
        let path = &run.input;
        let library = config.library.as_ref().map(|library| {
            let in_folder = run.input_path(Path::new(library));
            // A bare name that is not a file is left for the system loader to find.
            if in_folder.exists() || library.contains(['/', '\\']) { in_folder } else { library.into() }
        });
        let index_dir = config.index_dir.as_ref().map(|folder| run.input_path(Path::new(folder)));
        let mut reader = SdfReader::open(path, library.as_deref(), index_dir.as_deref(), &|file| {
            tracing::info!("loading the library {}", file.display());
        })?;
        let (tables, mut remarks) = reader.tables();
        let named = time::named(path);
        let about = match &config.times.gps_date {
            Some(date) => time::noon(date),
            None => named,
        };
        remarks.extend(time::other_day(about, named));
        let mut ahead = look_ahead(&mut reader)?;
        let is_first = |record: &&SdfRecord| !record.blocks.is_empty() && record.time_external_s.is_finite();
        let first_s = ahead.iter().find(is_first).map(|record| record.time_external_s);
        let is_external = reader.info().is_synchronised();
        let scale = match config.times.recording_time {
            _ if !is_external => RecordedTimeScale::Unknown,
            Some(said) => said.into(),
            None => RecordedTimeScale::of_epoch(&reader.info().epoch),
        };
        let misfit = first_s.and_then(|first_s| scale.misfit(first_s, None));
        remarks.extend(misfit.map(|problem| format!("{problem}; {}", time::SAY_SCALE)));
        let times = Times::new(scale, first_s, about);
        let leap_s = if config.times.utc { times.leap_s(path, first_s)? } else { 0.0 };
        let times = times.later_by(leap_s + config.times.time_offset_s);
        remarks.extend(times.remark.map(str::to_owned));
        let input = describe(config, run, &reader, &times, tables, &ahead);
        remarks.extend(recording::green_note(input.instrument.as_deref()));
        let mut at_end = false;
        let window_s = config.times.window_s(&times, path)?;
        let window = window_s.map(|window_s| TimeWindow {
            watched: Watched::new(window_s),
            is_external,
            now_s: window_s[0],
            late: 0,
        });
        if let Some([from_s, _]) = window_s {
            ahead.clear();
            at_end = !match is_external {
                true => reader.seek_time_external(from_s - times.offset_s)?,
                false => reader.seek_time(from_s)?,
            };
            if at_end {
                let first_s = first_s.map_or(f64::NAN, |first_s| times.axis().next(first_s));
                remarks.push(format!(
                    "no shot lies in the time window, which begins at {from_s:.3} s: the recording begins at \
                     {first_s:.3} s and ends earlier; set `time_s`, or the scale it counts on with `time_scale`"
                ));
            }
        }
        Ok(SdfLineReader {
            reader,
            lines: LineSplitter::new(Arc::new(input)).marking_edges(),
            window,
            axis: times.axis(),
            ahead,
            record: SdfRecord::default(),
            waiting: None,
            shots: 0,
            records: 0,
            remarks,
            ends_are_marked: false,
            at_end,
        })
    }

    /// Reads the next record; `false` at the end of the wanted records.
    fn read(&mut self) -> Result<bool> {
        if self.at_end {
            return Ok(false);
        }
        match self.ahead.pop_front() {
            Some(record) => self.record = record,
            None => self.at_end = !self.reader.next(&mut self.record)?,
        }
        self.records += 1;
        Ok(!self.at_end)
    }

    /// The shot of the current record, if valid and inside the window; invalid ones are rejected.
    fn shot(&mut self, cx: &mut Context) -> Option<Emission> {
        let mut emission = match shot::read(&self.record) {
            ReadShot::Shot(emission) => emission,
            ReadShot::Wrong(reason) => {
                self.reject(reason, cx);
                return None;
            }
        };
        emission.gps_time_s = self.axis.next(emission.gps_time_s);
        let Some(window) = &mut self.window else { return Some(emission) };
        let time_s = if window.is_external { emission.gps_time_s } else { self.record.time_s };
        if time_s.is_nan() {
            self.reject(Reason::WithoutTime, cx);
            return None;
        }
        let [_, to_s] = window.watched.window_s;
        window.late = if time_s > to_s { window.late + 1 } else { 0 };
        self.at_end = window.late == LATE_SHOTS;
        let is_inside = window.watched.contains(time_s);
        if is_inside {
            window.now_s = time_s;
        }
        is_inside.then_some(emission)
    }

    /// Counts the blocks of a record that is not a shot.
    fn pass_over(&self, cx: &mut Context) {
        let blocks = self.record.blocks.len() as u64;
        cx.reject(Reason::Housekeeping, blocks);
    }

    fn reject(&self, reason: Reason, cx: &mut Context) {
        cx.reject_with_blocks(reason, 1, self.record.blocks.len() as u64);
    }

    /// Adds the shot of the current record to the current line.
    fn add(&mut self, mut emission: Emission) {
        let zero_s = zero_of(&self.record);
        emission.shot = self.shots;
        self.shots += 1;
        let interval_ns = self.lines.input().sampling_interval_ns;
        let index = self.lines.add(self.records - 1, emission);
        for block in &self.record.blocks {
            let Some(channel) = channel_of(block.channel) else { continue };
            if zero_s.is_some() && channel == Channel::Reference && block.is_empty() {
                continue;
            }
            let start_ns = fine_ns(block.start_s - zero_s.unwrap_or(0.0));
            let samples = self.record.samples(block);
            self.lines.blocks().push(index, channel, None, start_ns, interval_ns, samples);
        }
    }

    /// The last line, with a note if it seems truncated.
    fn last_line(&mut self, cx: &mut Context) -> Option<ScanLine> {
        let line = self.lines.take();
        if let (None, Some(window)) = (&line, &self.window) {
            window.watched.report(cx);
        }
        if line.is_some() && self.ends_are_marked && self.window.is_none() {
            cx.warn("the file ends within a scan line: it may be truncated");
        }
        line
    }
}

/// Reads records up to the first with an outgoing pulse and a time.
fn look_ahead(reader: &mut SdfReader) -> Result<VecDeque<SdfRecord>> {
    let says_all = |record: &SdfRecord| has_outgoing_pulse(record) && record.time_external_s.is_finite();
    let mut ahead = VecDeque::new();
    let mut samples = 0;
    while ahead.len() < LOOKED_AT && samples < SAMPLES_LOOKED_AT && !ahead.back().is_some_and(says_all) {
        let mut record = SdfRecord::default();
        if !reader.next(&mut record)? {
            break;
        }
        samples += record.n_samples();
        ahead.push_back(record);
    }
    Ok(ahead)
}

fn has_outgoing_pulse(record: &SdfRecord) -> bool {
    record.blocks.iter().any(|block| block.channel == channel::REFERENCE && !block.is_empty())
}

/// Samples are 16-bit words that hold 8-bit values.
const FULL_SCALE_DN: u16 = 255;

fn describe(
    config: &ReadSdf,
    run: &RunContext,
    reader: &SdfReader,
    times: &Times,
    tables: CalibrationTables,
    ahead: &VecDeque<SdfRecord>,
) -> InputInfo {
    let (info, version) = (reader.info(), reader.version());
    let text = |text: &String| Some(text.clone()).filter(|text| !text.is_empty());
    InputInfo {
        full_scale_is_set: false,
        path: run.input.clone(),
        stem: run.stem.clone(),
        format: format!(
            "RIEGL {} (RiWAVELib {}.{})",
            if is_wfm(&run.input) { "WFM" } else { "SDF" },
            version.major,
            version.minor
        ),
        instrument: text(&info.instrument),
        serial: text(&info.serial),
        sampling_interval_ns: fine_ns(info.sampling_interval_s),
        odd_sample_shift: config.odd_samples.odd_sample_shift,
        full_scale_dn: Some(FULL_SCALE_DN),
        gain_control: GainControl::Off,
        group_velocity_mps: config.pulse_speed.group_velocity_mps().unwrap_or(info.group_velocity_mps),
        pulse_rate_hz: None,
        time_scale: times.scale,
        gps_week: times.gps_week,
        recorded: times.recorded,
        frame: Frame::Scanner,
        crs_wkt: None,
        crs_problems: Vec::new(),
        coordinate_grid: None,
        emission_reference: match ahead.iter().any(has_outgoing_pulse) {
            true => EmissionReference::OutgoingPulse,
            false => EmissionReference::Clock,
        },
        origin_is_sensor: true,
        first_shot: None,
        amplitude_low: AmplitudeTable::new(tables.amplitude_low),
        amplitude_high: AmplitudeTable::new(tables.amplitude_high),
        range_low: AmplitudeTable::new(tables.range_low),
        range_high: AmplitudeTable::new(tables.range_high),
        ..InputInfo::default()
    }
}

impl Source for SdfLineReader {
    fn next(&mut self, cx: &mut Context) -> Result<Option<ScanLine>> {
        self.remarks.drain(..).for_each(|remark| cx.warn(remark));
        loop {
            if let Some(emission) = self.waiting.take() {
                self.add(emission);
                if shot::ends_line(&emission) {
                    self.ends_are_marked = true;
                    return Ok(self.lines.end());
                }
            }
            if !self.read()? {
                return Ok(self.last_line(cx));
            }
            match what_is(&self.record) {
                What::Shot => self.waiting = self.shot(cx),
                What::Housekeeping => self.pass_over(cx),
                What::EndOfLine => {
                    self.pass_over(cx);
                    self.ends_are_marked = true;
                    if let Some(line) = self.lines.end() {
                        return Ok(Some(line));
                    }
                }
            }
            if self.waiting.as_ref().is_some_and(|next| self.lines.ends_before(next)) {
                return Ok(self.lines.take());
            }
        }
    }

    fn progress(&self) -> Option<f64> {
        let window = self.window.as_ref()?;
        let [from_s, to_s] = window.watched.window_s;
        let length_s = (to_s - from_s).max(f64::MIN_POSITIVE);
        Some(((window.now_s - from_s) / length_s).clamp(0.0, 1.0))
    }

    fn location(&self) -> Option<LineLocation> {
        // A time window begins at an unknown record.
        self.lines.location().filter(|_| self.window.is_none())
    }

    fn line_at(&mut self, location: &LineLocation, cx: &mut Context) -> Result<Option<ScanLine>> {
        (self.waiting, self.at_end) = (None, false);
        self.ahead.clear();
        (self.records, self.shots) = (location.records.start, location.first_shot);
        self.lines.begin_at(location);
        let first = u32::try_from(location.records.start + 1).unwrap_or(u32::MAX);
        if !self.reader.seek(first)? {
            return Ok(None);
        }
        while self.records < location.records.end && self.read()? {
            match what_is(&self.record) {
                What::Shot => self.shot(cx).into_iter().for_each(|emission| self.add(emission)),
                What::Housekeeping | What::EndOfLine => self.pass_over(cx),
            }
        }
        Ok(self.lines.take())
    }
}

#[cfg(test)]
mod tests;

//! Declarations of a job that complete or override a recording's metadata: times, CRS, refractive
//! index.

use std::sync::Arc;

use crate::reading::emission_choice::EmissionCheck;
use wavex_line::georef::declared;
use wavex_line::plausibility::Check;
use wavex_line::scan_line::{Content, Frame, GainControl, InputInfo, ScanLine};
use wavex_line::stage::{Context, LineLocation, Reason, Result, RunContext, Source, StageError};

mod keys;
pub(crate) mod time;
pub(crate) mod units;

pub(crate) use keys::Sampling;
pub use keys::{FullScale, InputCrs, OddSamples, PulseSpeed, TimeKeys};
pub use time::possible_scales;
use time::{Axis, RecordedTimeScale, Times};

/// Metadata of a recording as declared by the job.
#[derive(Clone, Debug, Default)]
pub(crate) struct Declared {
    pub(crate) times: TimeKeys,
    /// CRS of the recording's coordinates, as WKT.
    pub(crate) crs_wkt: Option<String>,
    pub(crate) group_velocity_mps: Option<f64>,
}

impl Declared {
    /// Builds the declarations from the keys of a reader.
    ///
    /// # Errors
    /// A coordinate reference system that cannot be read.
    pub(crate) fn new(
        times: &TimeKeys,
        crs: &InputCrs,
        speed: PulseSpeed,
        run: &RunContext,
    ) -> Result<Declared> {
        let word = crs.crs_of_input.as_deref();
        let crs_wkt = word.map(|word| declared::wkt(word, &run.input_dir)).transpose()?;
        Ok(Declared { times: times.clone(), crs_wkt, group_velocity_mps: speed.group_velocity_mps() })
    }
}

/// Emits the lines of a reader with the job's declarations applied.
pub(crate) struct AsDeclared<S> {
    source: S,
    declared: Declared,
    /// State of the recording; `None` before the first line.
    begun: Option<Begun>,
    copies: Copies,
    emission_check: Option<EmissionCheck>,
}

/// Waveforms read so far, and those that are copies of the waveform of the shot before.
#[derive(Default)]
struct Copies {
    waveforms: u64,
    copies: u64,
}

impl Copies {
    fn mark(&mut self, line: &mut ScanLine) {
        self.copies += line.mark_copies();
        self.waveforms += line.stats.nw;
    }

    /// Warns of the copies, once.
    ///
    /// Of thousands of waveforms with little signal, a few may be equal by chance.
    fn report(&mut self, cx: &mut Context) {
        let Copies { waveforms, copies } = std::mem::take(self);
        if copies > 2 && 1000 * copies > waveforms {
            cx.warn(format!(
                "{copies} of {waveforms} waveforms {COPIES}: \
                 their returns are repeated at other places, and calibration and statistics use each \
                 waveform once; export the recording again, or remove these shots"
            ));
        }
    }
}

/// State determined from the first line.
struct Begun {
    /// Metadata from the reader, and metadata as emitted.
    info: [Arc<InputInfo>; 2],
    /// `None` if times stay unchanged.
    axis: Option<Axis>,
    window: Option<Watched>,
}

/// A time window, and the shots read in search of it.
pub(crate) struct Watched {
    pub(crate) window_s: [f64; 2],
    /// First and last time of all shots read, s.
    read_s: [f64; 2],
    is_empty: bool,
}

impl Watched {
    pub(crate) fn new(window_s: [f64; 2]) -> Watched {
        Watched { window_s, read_s: [f64::INFINITY, f64::NEG_INFINITY], is_empty: true }
    }

    /// Whether a time, s, is inside the window.
    pub(crate) fn contains(&mut self, time_s: f64) -> bool {
        let ([from_s, to_s], [first_s, last_s]) = (self.window_s, self.read_s);
        self.read_s = [first_s.min(time_s), last_s.max(time_s)];
        let is_inside = (from_s..=to_s).contains(&time_s);
        self.is_empty &= !is_inside;
        is_inside
    }

    /// Warns if no shot was inside the window.
    pub(crate) fn report(&self, cx: &mut Context) {
        let ([from_s, to_s], [first_s, last_s]) = (self.window_s, self.read_s);
        if self.is_empty && first_s <= last_s {
            cx.warn(format!(
                "no shot lies in the time window, {from_s:.3} to {to_s:.3} s: the times read are {first_s:.3} to \
                 {last_s:.3} s; set `time_s`, or the scale it counts on with `time_scale`"
            ));
        }
    }
}

/// Warning for recordings with a varying gain that is not recorded for each block.
const UNKNOWN_GAINS: &str = "the receiver gain varies between shots, but the recording does not contain the gain of each block (LAS: \
     different digitizer gains in waveform packet descriptors): amplitudes and intensities are not comparable, and \
     thresholds and standard deviations are those of a mean gain; use a container whose blocks have a `gain`";

/// Remedy for a CRS that the beams cannot be in.
const SET_CRS: &str = "set the projected CRS of the recording with `crs_of_input`, such as `utm:33N`";

/// Words of the messages.
const COPIES: &str = "are byte-identical copies of the waveform of the shot before";
const OTHER_WEEK: &str = "the file states week";
const GREEN_WORDS: &str = "measures through water";

/// The checks of the content of every recording.
pub(crate) fn checks() -> Vec<Check> {
    vec![
        Check::warning(
            "waveforms of neighbouring shots",
            "at most 2, or 0.1 %, are equal",
            "noise differs; waveforms with little signal may be equal by chance",
            COPIES,
        ),
        Check::warning(
            "name of the instrument",
            "none of the green instruments for bathymetry",
            "refraction and the speed of light in water are not applied",
            GREEN_WORDS,
        ),
    ]
}

/// The checks of the dates of every recording.
pub(crate) fn date_checks() -> Vec<Check> {
    let check = |compared, accepted: &str, source, message, key| {
        Check::warning(compared, accepted, source, message).with_key(key)
    };
    vec![
        check(
            "times and their scale",
            "seconds of the week or day; dates from 1990 to 2079, at most a year after that of the file",
            "no recording of waveforms from the air is older",
            time::NOT_PLAUSIBLE,
            "recording_time",
        ),
        check(
            "weekdays of `gps_date` and of seconds of the week",
            "the same or the next one",
            "dates may be local",
            time::OTHER_DAY,
            "gps_date",
        ),
        check(
            "GPS weeks of `gps_date` and of the file",
            "the same",
            "a recording has one date",
            OTHER_WEEK,
            "gps_date",
        ),
        check(
            "days of `gps_date` and of the file name",
            "at most 2 days apart",
            "dates may be local, and flights last over midnight",
            time::OTHER_NAME,
            "gps_date",
        ),
    ]
}

/// Green instruments for bathymetry, without separators, in upper case.
const GREEN: [&str; 9] =
    ["VQ820G", "VQ840G", "VQ860G", "VQ870G", "VQ880G", "CHIROPTERA", "HAWKEYE", "CZMIL", "SHOALS"];

/// Warning for a green instrument.
pub(crate) fn green_note(instrument: Option<&str>) -> Option<String> {
    let instrument = instrument?;
    let name: String = instrument.chars().filter(|c| c.is_alphanumeric()).collect();
    let name = name.to_uppercase();
    GREEN.iter().any(|green| name.contains(green)).then(|| {
        format!(
            "{instrument} {GREEN_WORDS}, but refraction and the speed of light in water are not applied: points \
             under water are too deep by about a third of the depth; correct them with a program for bathymetry"
        )
    })
}

impl<S: Source> AsDeclared<S> {
    pub(crate) fn new(source: S, declared: Declared) -> AsDeclared<S> {
        AsDeclared { source, declared, begun: None, copies: Copies::default(), emission_check: None }
    }

    /// Compares the stated source of emission times with the points, for readers that do not decide on it.
    pub(crate) fn checking_emissions(self) -> AsDeclared<S> {
        AsDeclared { emission_check: Some(EmissionCheck::default()), ..self }
    }

    /// State of a line's recording; its first line determines it.
    fn begun(&mut self, line: &ScanLine, cx: &mut Context) -> Result<&mut Begun> {
        let known = self.begun.take().filter(|begun| Arc::ptr_eq(&begun.info[0], &line.input));
        let begun = known.map_or_else(|| self.begin(line, cx), Ok)?;
        Ok(self.begun.insert(begun))
    }

    /// Determines the time scale from the first line.
    fn begin(&self, first: &ScanLine, cx: &mut Context) -> Result<Begun> {
        let (keys, from) = (&self.declared.times, &first.input);
        let mut times_s: Vec<f64> =
            first.emissions.iter().map(|shot| shot.gps_time_s).filter(|time_s| time_s.is_finite()).collect();
        let first_s = times_s.first().copied();
        times_s.sort_by(f64::total_cmp);
        let scale =
            keys.recording_time.map_or(RecordedTimeScale::of(from.time_scale), RecordedTimeScale::from);
        // A time scale declared by the job takes precedence over the date of the file.
        let file_date = from.recorded.filter(|_| keys.recording_time.is_none());
        let usual_s = times_s.get(times_s.len() / 2).copied();
        if let Some(problem) = usual_s.and_then(|time_s| scale.misfit(time_s, file_date)) {
            if keys.needs_scale() {
                return Err(StageError::failed(problem, time::SAY_SCALE));
            }
            cx.warn(format!("{problem}; {}", time::SAY_SCALE));
        }
        if from.gain_control == GainControl::NotRecorded {
            cx.warn(UNKNOWN_GAINS);
        }
        if let Some(note) = green_note(from.instrument.as_deref()) {
            cx.warn(note);
        }
        let about = keys.gps_date.as_deref().and_then(time::noon);
        if let (RecordedTimeScale::Week, Some(about), Some(first_s)) = (scale, about, first_s)
            && let Some(problem) = time::other_weekday(about, first_s)
        {
            cx.warn(problem);
        }
        let is_as_read = keys.recording_time.is_none() && about.is_none();
        let times = keys.interpret(from, first_s)?;
        if let (Some(_), Some(own), Some(week)) = (about, from.gps_week, times.gps_week)
            && own != week
        {
            cx.warn(format!(
                "`gps_date` is in GPS week {week}, but {OTHER_WEEK} {own}: the key is used; check date"
            ));
        }
        if self.declared.group_velocity_mps.is_some() && !from.origin_is_sensor {
            return Err(StageError::failed(
                "`refractive_index_ppm` needs ranges from the sensor, but the ranges of this recording count from the first sample",
                "remove the key",
            ));
        }
        let window = keys.window_s(&times, &from.path)?.map(Watched::new);
        let is_changed = times.offset_s != 0.0 || times.period_s.is_some();
        let info = InputInfo {
            time_scale: times.scale,
            gps_week: times.gps_week,
            recorded: times.recorded.or(from.recorded),
            is_file_date: from.is_file_date && (is_as_read || times.recorded.is_none()),
            time_scale_is_inferred: from.time_scale_is_inferred && keys.recording_time.is_none(),
            group_velocity_mps: self.declared.group_velocity_mps.unwrap_or(from.group_velocity_mps),
            crs_wkt: self.crs(first, cx)?,
            ..InputInfo::clone(from)
        };
        let info = [Arc::clone(from), Arc::new(info)];
        Ok(Begun { info, axis: is_changed.then(|| times.axis()), window })
    }

    /// The output coordinate reference system.
    fn crs(&self, first: &ScanLine, cx: &mut Context) -> Result<Option<String>> {
        let of_file = &first.input.crs_wkt;
        first.input.crs_problems.iter().for_each(|problem| cx.warn(problem.clone()));
        let place_m = first.emissions.first().map(|shot| shot.origin_m).unwrap_or_default();
        let misfit = |wkt: &String| {
            (first.input.frame == Frame::Map).then(|| declared::not_in_degrees(wkt, place_m)).flatten()
        };
        let Some(declared) = &self.declared.crs_wkt else {
            let problem = of_file.as_ref().and_then(misfit);
            if let Some(problem) = &problem {
                cx.warn(format!("the CRS of the file is not used: {problem}; {SET_CRS}"));
            }
            return Ok(of_file.clone().filter(|_| problem.is_none()));
        };
        if let Some(problem) = misfit(declared) {
            return Err(StageError::failed(format!("`crs_of_input`: {problem}"), SET_CRS));
        }
        let frame = match first.input.frame {
            Frame::Map => None,
            Frame::Scanner => Some("the scanner frame"),
            Frame::Body => Some("the body frame of the aircraft"),
            Frame::Earth => Some("geocentric coordinates"),
        };
        if let Some(frame) = frame {
            return Err(StageError::failed(
                format!("`crs_of_input` names a projected CRS, but this recording is in {frame}"),
                "remove the key, or give recordings in other coordinates a job of their own; the output CRS is `crs` of \
                 `[job.geometry]`",
            ));
        }
        if let Some(other) = of_file.as_deref().filter(|wkt| declared::differ(wkt, declared, place_m)) {
            let [file, job] = [other, declared].map(|wkt| wkt.split('"').nth(1).unwrap_or("an unnamed CRS"));
            cx.warn(format!("the file gives {file} as its CRS; `crs_of_input` overrides it with {job}"));
        }
        Ok(Some(declared.clone()))
    }
}

impl TimeKeys {
    /// Interprets the times of a recording, whose first one is `first_s`, s.
    ///
    /// # Errors
    /// The times are UTC, but the day is not known.
    pub(crate) fn interpret(&self, from: &InputInfo, first_s: Option<f64>) -> Result<Times> {
        let times = match (self.recording_time, self.gps_date.as_deref().and_then(time::noon)) {
            (None, None) => Times::as_said(from),
            (given, about) => {
                let scale = given.map_or(RecordedTimeScale::of(from.time_scale), RecordedTimeScale::from);
                Times::new(scale, first_s, about)
            }
        };
        let leap_s = if self.utc { times.leap_s(&from.path, first_s)? } else { 0.0 };
        Ok(times.later_by(leap_s + self.time_offset_s))
    }

    /// The time window on the scale of these times, s.
    ///
    /// # Errors
    /// See [`Times::shift_s`].
    pub(crate) fn window_s(&self, times: &Times, file: &std::path::Path) -> Result<Option<[f64; 2]>> {
        let shift_s = match (self.time_s, self.time_scale) {
            (Some(_), Some(scale)) => times.shift_s(scale, file)?,
            _ => 0.0,
        };
        Ok(self.time_s.map(|asked_s| asked_s.map(|time_s| time_s + shift_s)))
    }
}

impl Begun {
    /// Converts the times of a line; returns an empty line if no shot is inside the window.
    fn line(&mut self, mut line: ScanLine, cx: &mut Context) -> ScanLine {
        line.input = Arc::clone(&self.info[1]);
        if let Some(axis) = &mut self.axis {
            line.emissions.iter_mut().for_each(|shot| shot.gps_time_s = axis.next(shot.gps_time_s));
            line.stats.gps_time_s = line.emissions.first().map_or(f64::NAN, |shot| shot.gps_time_s);
        }
        match &mut self.window {
            Some(window) => within(line, window, cx),
            None => line,
        }
    }
}

/// Keeps the shots of a line fired inside a time window.
fn within(line: ScanLine, window: &mut Watched, cx: &mut Context) -> ScanLine {
    let are_inside: Vec<bool> = line.emissions.iter().map(|shot| window.contains(shot.gps_time_s)).collect();
    if !are_inside.contains(&false) {
        return line;
    }
    let Content::Shots(mut blocks) = line.content else { return line };
    let mut place = Vec::with_capacity(line.emissions.len());
    let (mut emissions, mut without_time) = (Vec::new(), [0, 0]);
    for ((index, shot), is_inside) in (0..).zip(&line.emissions).zip(are_inside) {
        place.push(is_inside.then_some(emissions.len() as u32));
        if is_inside {
            emissions.push(*shot);
        } else if shot.gps_time_s.is_nan() {
            without_time[0] += 1;
            without_time[1] += blocks.of_emission(index).count() as u64;
        }
    }
    let [shots_without_time, blocks_without_time] = without_time;
    cx.reject_with_blocks(Reason::WithoutTime, shots_without_time, blocks_without_time);
    blocks.keep(&place);
    ScanLine::of_shots(line.input, line.line, emissions, blocks)
}

impl<S: Source> Source for AsDeclared<S> {
    fn next(&mut self, cx: &mut Context) -> Result<Option<ScanLine>> {
        loop {
            let Some(mut line) = self.source.next(cx)? else {
                self.copies.report(cx);
                self.emission_check.iter().for_each(|check| check.report(cx));
                self.begun
                    .iter()
                    .filter_map(|begun| begun.window.as_ref())
                    .for_each(|window| window.report(cx));
                return Ok(None);
            };
            self.copies.mark(&mut line);
            self.emission_check.iter_mut().for_each(|check| check.add(&line));
            let line = self.begun(&line, cx)?.line(line, cx);
            if !line.emissions.is_empty() {
                return Ok(Some(line));
            }
        }
    }

    fn progress(&self) -> Option<f64> {
        self.source.progress()
    }

    fn location(&self) -> Option<LineLocation> {
        self.source.location()
    }

    fn line_at(&mut self, location: &LineLocation, cx: &mut Context) -> Result<Option<ScanLine>> {
        let Some(mut line) = self.source.line_at(location, cx)? else { return Ok(None) };
        line.mark_copies();
        let line = self.begun(&line, cx)?.line(line, cx);
        Ok(Some(line).filter(|line| !line.emissions.is_empty()))
    }
}

#[cfg(test)]
mod tests;

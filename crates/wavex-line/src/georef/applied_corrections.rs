//! Corrections of the trajectory of one recording.

use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

use super::corrections::{CorrectionsFile, StripCorrections};
use super::{Error, Result};
use crate::plausibility::Check;
use crate::scan_line::InputInfo;
use wavex_geodesy::time_axis::{Alignment, Clock, TimeSpan};
use wavex_geodesy::trajectory::corrections::{PoseOffset, TrajectoryCorrections};

/// Time of a recording outside the span of its strip that is not reported, s.
const TOLERANCE_S: f64 = 1.0;
/// A recording that begins earlier before its strip is another one, s.
const EARLIEST_S: f64 = 3600.0;

const NO_ENTRY: &str = "has no entry in";
const NO_OVERLAP: &str = "and the recording have no time in common";
const OUTSIDE: &str = "is outside of the time span of its corrections";

/// Words in the first line of a corrected trajectory as text, before the name of its correction file.
pub const CORRECTED_BY: &str = "; corrected by ";
/// The first line of a corrected trajectory is shorter, bytes.
const LONGEST_HEADER: u64 = 4096;
const TWICE: &str = "was written with the corrections of";

/// The checks of this module.
pub fn checks() -> Vec<Check> {
    let of_times = "times of a recording and of its strip in the correction file";
    vec![
        Check::error(of_times, "at least one in common", "strips are named by their recordings", NO_OVERLAP)
            .with_key("corrections"),
        Check::warning(
            of_times,
            format!("at most {TOLERANCE_S} s of the recording outside"),
            "corrections hold for the shots that they were estimated from",
            OUTSIDE,
        )
        .with_key("corrections"),
        Check::warning(
            "recordings and strips of the correction file",
            "an entry",
            "names of files",
            NO_ENTRY,
        )
        .with_key("corrections"),
    ]
}

/// Corrections of the trajectory of one recording.
#[derive(Clone, Debug)]
pub struct AppliedCorrections {
    entry: Entry,
    corrections: TrajectoryCorrections,
    /// From the axis of the trajectory to that of the strip.
    alignment: Alignment,
}

impl AppliedCorrections {
    /// The corrections of a recording whose trajectory has these times; `None` without an entry.
    ///
    /// # Errors
    /// A strip longer than the period of the clock.
    pub(super) fn of(
        file: &Path,
        corrections: &CorrectionsFile,
        recording: &str,
        trajectory: TimeSpan,
    ) -> Result<Option<AppliedCorrections>> {
        let Some(strip) = corrections.strip(recording) else { return Ok(None) };
        let entry = Entry::of(file, corrections, strip);
        let unusable = |problem| {
            Error::unusable(format!("{}: {problem}", file.display()), "write the corrections again")
        };
        let found = strip.corrections().map_err(unusable)?;
        let alignment = Alignment::between(trajectory, entry.strip)?;
        Ok(Some(AppliedCorrections { entry, corrections: found, alignment }))
    }

    /// The correction file.
    pub fn file(&self) -> &Path {
        &self.entry.file
    }

    /// Offsets at a time on the axis of the trajectory, s.
    pub fn at(&self, time_s: f64) -> PoseOffset {
        self.corrections.at(self.alignment.on_trajectory(time_s))
    }

    /// Checks the first time of a recording, before its last is known.
    ///
    /// # Errors
    /// The strip has ended before, or begins over an hour later.
    pub(super) fn judge_start(&self, recording: TimeSpan) -> Result<()> {
        let entry = &self.entry;
        let [first_s, _] = entry.on_strip(recording)?;
        let possible_s = entry.strip.first_s - EARLIEST_S..=entry.strip.last_s + TOLERANCE_S;
        if possible_s.contains(&first_s) { Ok(()) } else { Err(entry.no_overlap(recording)) }
    }

    /// Checks the first and last time of a recording; returns a warning.
    ///
    /// # Errors
    /// The recording and the strip have no time in common.
    pub(super) fn judge(&self, recording: TimeSpan) -> Result<Option<String>> {
        self.entry.judge(recording)
    }
}

/// Entry of a recording in a correction file.
#[derive(Clone, Debug)]
struct Entry {
    file: PathBuf,
    recording: String,
    /// Time span of the strip.
    strip: TimeSpan,
}

impl Entry {
    fn of(file: &Path, corrections: &CorrectionsFile, strip: &StripCorrections) -> Entry {
        Entry { file: file.to_owned(), recording: strip.recording.clone(), strip: corrections.span(strip) }
    }

    /// As [`AppliedCorrections::judge`].
    fn judge(&self, recording: TimeSpan) -> Result<Option<String>> {
        let ([first_s, last_s], strip) = (self.on_strip(recording)?, self.strip);
        if last_s < strip.first_s - TOLERANCE_S || first_s > strip.last_s + TOLERANCE_S {
            return Err(self.no_overlap(recording));
        }
        let before_s = (strip.first_s - first_s).max(0.0);
        let after_s = (last_s - strip.last_s).max(0.0);
        Ok((before_s.max(after_s) > TOLERANCE_S).then(|| {
            format!(
                "a part of the recording {OUTSIDE} in {}, {before_s:.1} s before it and {after_s:.1} s after it: the \
                 recording lasts from {recording}, the corrections from {strip}; beyond its knots a correction is \
                 constant: estimate the corrections from the whole recording",
                self.file.display()
            )
        }))
    }

    /// First and last time of a recording on the axis of the strip, s.
    fn on_strip(&self, recording: TimeSpan) -> Result<[f64; 2]> {
        let first_s = Alignment::between(recording, self.strip)?.on_trajectory(recording.first_s);
        Ok([first_s, first_s + (recording.last_s - recording.first_s)])
    }

    fn no_overlap(&self, recording: TimeSpan) -> Error {
        let lasts = if recording.first_s == recording.last_s { "begins at" } else { "lasts from" };
        Error::unusable(
            format!(
                "{}: the corrections of `{}` {NO_OVERLAP}: the recording {lasts} {recording}, the corrections last from {}",
                self.file.display(),
                self.recording,
                self.strip
            ),
            "give the corrections of this flight, or correct `time`, the scale of the times in the file",
        )
    }
}

/// Problem of a recording with the corrections of its trajectory, as a run finds it.
///
/// `span_s` are the times of its first and last shot, if known.
pub fn problem(
    file: &Path,
    corrections: &CorrectionsFile,
    recording: &str,
    input: &InputInfo,
    span_s: Option<[f64; 2]>,
) -> Option<String> {
    let Some(strip) = corrections.strip(recording) else {
        return Some(without_entry(file, corrections, recording));
    };
    let times = recording_span(input, span_s?)?;
    Entry::of(file, corrections, strip).judge(times).unwrap_or_else(|error| Some(error.to_string()))
}

/// Time span of a recording, by its date if it is known; `None` if its time scale is unknown.
pub(super) fn recording_span(input: &InputInfo, [first_s, last_s]: [f64; 2]) -> Option<TimeSpan> {
    let clock = Clock::of(input.time_scale)?;
    Some(match input.adjusted_gps_time(first_s) {
        Some(adjusted_s) => {
            TimeSpan { clock: Clock::Adjusted, first_s: adjusted_s, last_s: adjusted_s + (last_s - first_s) }
        }
        None => TimeSpan { clock, first_s, last_s },
    })
}

/// Warning about a trajectory that was written with corrections, and is corrected again.
///
/// `None` if its first line cannot be read.
pub(super) fn corrected_twice(trajectory: &Path) -> Option<String> {
    // A pipe can be read only once.
    trajectory.is_file().then_some(())?;
    let mut first = Vec::new();
    File::open(trajectory).ok()?.take(LONGEST_HEADER).read_to_end(&mut first).ok()?;
    let first = String::from_utf8_lossy(&first);
    let (_, by) = first.lines().next().filter(|line| line.starts_with('#'))?.split_once(CORRECTED_BY)?;
    Some(format!(
        "{}: the trajectory {TWICE} {by}, and is corrected again; remove `corrections` from `[job.geometry]`, unless they \
         were estimated with this trajectory",
        trajectory.display()
    ))
}

/// Warning about a recording without corrections.
pub(super) fn without_entry(file: &Path, corrections: &CorrectionsFile, recording: &str) -> String {
    format!(
        "the recording `{recording}` {NO_ENTRY} {}, which has {}: its trajectory is not corrected; align it together with \
         the others, or check the name",
        file.display(),
        corrections.names()
    )
}

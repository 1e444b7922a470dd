//! The correction file: offsets of trajectories by strip, as TOML.

use std::collections::BTreeSet;
use std::fmt::Write as _;
use std::path::Path;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::keys::at_least;
use wavex_formats::{Error, Result, read_small_text};
use wavex_geodesy::time_axis::{Alignment, Clock, TimeSpan};
use wavex_geodesy::trajectory::corrections::{CorrectionKnot, PoseOffset, TrajectoryCorrections};

/// Version of the format.
const VERSION: u32 = 1;
/// Size limit of a correction file, bytes: about 300 000 knots.
const MOST_BYTES: u64 = 50_000_000;
/// Largest offset of a position along an axis, m.
pub const MOST_OFFSET_M: f64 = 100.0;
/// Largest offset of an angle, degrees.
pub const MOST_OFFSET_DEG: f64 = 10.0;

/// Largest time of a scale, s, either way; adjusted time gets there after 300 years.
const MOST_TIME_S: f64 = 1e10;

const REMEDY: &str = "a correction file is TOML with `version = 1`, `time` and a table `[[strip]]` with `recording`, `first_s`, \
                      `last_s` and `knots` for each strip";

/// Corrections of trajectories by strip.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct CorrectionsFile {
    /// Version of this format: 1.
    #[schemars(range(min = 1, max = 1))]
    pub version: u32,
    /// Time scale of all times.
    pub time: CorrectionsTime,
    /// The strips; a recording has at most one.
    #[serde(default, rename = "strip")]
    pub strips: Vec<StripCorrections>,
}

/// Time scale of a correction file.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum CorrectionsTime {
    /// Adjusted GPS time: seconds since 1980-01-06, minus 1e9.
    Adjusted,
    /// Seconds of the GPS week; they continue after its end.
    Week,
    /// Seconds of the day; they continue after its end.
    Day,
}

/// Corrections of the trajectory during a strip.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct StripCorrections {
    /// Stem of the recording: its file name without extension, and the name of the part if a file has
    /// several, as in the names of outputs.
    pub recording: String,
    /// Time of its first shot, s.
    pub first_s: f64,
    /// Time of its last shot, s.
    pub last_s: f64,
    /// Offsets over time: linear between knots, constant before the first and after the last.
    #[schemars(length(min = 1))]
    pub knots: Vec<StripKnot>,
}

/// Offsets of the trajectory at a time.
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct StripKnot {
    /// Time, s.
    pub time_s: f64,
    /// Added to the position: north, east, down at the aircraft, m.
    #[serde(default)]
    #[schemars(transform = at_least(-MOST_OFFSET_M).at_most(MOST_OFFSET_M))]
    pub north_east_down_m: [f64; 3],
    /// Added to the attitude: roll, pitch, heading, degrees.
    #[serde(default)]
    #[schemars(transform = at_least(-MOST_OFFSET_DEG).at_most(MOST_OFFSET_DEG))]
    pub roll_pitch_heading_deg: [f64; 3],
}

impl CorrectionsTime {
    /// Origin of the times.
    pub fn clock(self) -> Clock {
        match self {
            CorrectionsTime::Adjusted => Clock::Adjusted,
            CorrectionsTime::Week => Clock::Week,
            CorrectionsTime::Day => Clock::Day,
        }
    }

    fn word(self) -> &'static str {
        match self {
            CorrectionsTime::Adjusted => "adjusted",
            CorrectionsTime::Week => "week",
            CorrectionsTime::Day => "day",
        }
    }
}

impl From<Clock> for CorrectionsTime {
    fn from(clock: Clock) -> CorrectionsTime {
        match clock {
            Clock::Adjusted => CorrectionsTime::Adjusted,
            Clock::Week => CorrectionsTime::Week,
            Clock::Day => CorrectionsTime::Day,
        }
    }
}

impl StripCorrections {
    /// An entry of a file; angles become degrees.
    pub fn new(
        recording: impl Into<String>,
        [first_s, last_s]: [f64; 2],
        corrections: &TrajectoryCorrections,
    ) -> StripCorrections {
        let knot = |knot: &CorrectionKnot| StripKnot {
            time_s: knot.time_s,
            north_east_down_m: knot.offset.north_east_down_m,
            roll_pitch_heading_deg: knot.offset.roll_pitch_heading_rad.map(f64::to_degrees),
        };
        let knots = corrections.knots().iter().map(knot).collect();
        StripCorrections { recording: recording.into(), first_s, last_s, knots }
    }

    /// The corrections, with angles in radians.
    ///
    /// # Errors
    /// The problem: no knots, times that do not increase, an implausible offset, or an impossible span.
    pub fn corrections(&self) -> std::result::Result<TrajectoryCorrections, String> {
        let StripCorrections { first_s, last_s, .. } = *self;
        let is_time = |time_s: f64| time_s.abs() <= MOST_TIME_S;
        if !(is_time(first_s) && is_time(last_s) && first_s <= last_s) {
            return Err(format!("`first_s` and `last_s` are {first_s} and {last_s}, not a time span"));
        }
        for (n, knot) in (1..).zip(&self.knots) {
            if knot.time_s.is_finite() && !is_time(knot.time_s) {
                return Err(format!("knot {n}: its time {} s is of no time scale", knot.time_s));
            }
            let lengths = knot.north_east_down_m.map(|value| (value, MOST_OFFSET_M, "m"));
            let angles = knot.roll_pitch_heading_deg.map(|value| (value, MOST_OFFSET_DEG, "degrees"));
            let mut all = lengths.into_iter().chain(angles);
            // Offsets that are not finite have a message of their own.
            if let Some((value, most, unit)) =
                all.find(|(value, most, _)| value.abs() > *most && value.is_finite())
            {
                return Err(format!("knot {n}: an offset is {value} {unit}, at most {most} are plausible"));
            }
        }
        let knot = |knot: &StripKnot| CorrectionKnot {
            time_s: knot.time_s,
            offset: PoseOffset {
                north_east_down_m: knot.north_east_down_m,
                roll_pitch_heading_rad: knot.roll_pitch_heading_deg.map(f64::to_radians),
            },
        };
        TrajectoryCorrections::new(self.knots.iter().map(knot).collect())
            .map_err(|problem| problem.to_string())
    }
}

impl CorrectionsFile {
    /// A file of these strips.
    pub fn new(time: CorrectionsTime, strips: Vec<StripCorrections>) -> CorrectionsFile {
        CorrectionsFile { version: VERSION, time, strips }
    }

    /// Reads a correction file.
    ///
    /// # Errors
    /// A file that cannot be read, is too large, or is no correction file; the message names the line, or
    /// the strip and the knot.
    pub fn read(path: &Path) -> Result<CorrectionsFile> {
        let text = read_small_text(path, MOST_BYTES, "a correction file", REMEDY)?;
        CorrectionsFile::parse(&text).map_err(|problem| Error::unusable(path, problem, REMEDY))
    }

    /// Parses the text of a correction file.
    ///
    /// # Errors
    /// The problem, with its line, or its strip and knot.
    pub fn parse(text: &str) -> std::result::Result<CorrectionsFile, String> {
        #[derive(Deserialize)]
        struct Versioned {
            version: Option<u32>,
        }
        let in_text = |error: toml::de::Error| error.to_string().trim_end().to_owned();
        // A later version may have other keys.
        if let Some(version) = toml::from_str::<Versioned>(text).map_err(in_text)?.version
            && version != VERSION
        {
            return Err(format!(
                "it has version {version} of the format, and this program reads version {VERSION}"
            ));
        }
        let file: CorrectionsFile = toml::from_str(text).map_err(in_text)?;
        file.check()?;
        Ok(file)
    }

    /// Checks what the types alone cannot.
    fn check(&self) -> std::result::Result<(), String> {
        let mut names = BTreeSet::new();
        for (n, strip) in (1..).zip(&self.strips) {
            let name = &strip.recording;
            let at = |problem: String| format!("strip {n} (`{name}`): {problem}");
            if !names.insert(name) {
                return Err(at("an earlier strip has the same `recording`".into()));
            }
            strip.corrections().map_err(at)?;
            let period_s = self.time.clock().period_s();
            if let Some(period_s) = period_s.filter(|period_s| strip.last_s - strip.first_s >= *period_s) {
                return Err(at(format!("it lasts longer than the {period_s} s of a `{}`", self.time.word())));
            }
        }
        Ok(())
    }

    /// Text of the file: the same bytes for the same values, which it restores exactly.
    ///
    /// # Errors
    /// The problem, if such a file could not be read again.
    pub fn to_text(&self) -> std::result::Result<String, String> {
        self.check()?;
        let mut text = format!(
            "# Corrections of trajectories by strip, for `corrections` in `[job.geometry]`.\n\
             # Offsets are linear between knots, and constant before the first and after the last.\n\
             version = {VERSION}\n\
             time = \"{}\"\n",
            self.time.word()
        );
        for StripCorrections { recording, first_s, last_s, knots } in &self.strips {
            let recording = toml::Value::from(recording.as_str());
            // Writing to a text cannot fail.
            let _ = write!(
                text,
                "\n[[strip]]\nrecording = {recording}\nfirst_s = {first_s:?}\nlast_s = {last_s:?}\nknots = [\n"
            );
            for StripKnot { time_s, north_east_down_m, roll_pitch_heading_deg } in knots {
                let _ = writeln!(
                    text,
                    "  {{ time_s = {time_s:?}, north_east_down_m = {north_east_down_m:?}, \
                     roll_pitch_heading_deg = {roll_pitch_heading_deg:?} }},"
                );
            }
            text += "]\n";
        }
        Ok(text)
    }

    /// The strip of a recording.
    pub fn strip(&self, recording: &str) -> Option<&StripCorrections> {
        self.strips.iter().find(|strip| strip.recording == recording)
    }

    /// Time span of a strip.
    pub fn span(&self, strip: &StripCorrections) -> TimeSpan {
        TimeSpan { clock: self.time.clock(), first_s: strip.first_s, last_s: strip.last_s }
    }

    /// A few names of strips, for messages.
    pub(super) fn names(&self) -> String {
        let names: Vec<String> =
            self.strips.iter().take(3).map(|strip| format!("`{}`", strip.recording)).collect();
        match self.strips.len() - names.len() {
            _ if names.is_empty() => "no strip".into(),
            0 => names.join(", "),
            more => format!("{} and {more} more", names.join(", ")),
        }
    }

    /// Corrections on the axis of a trajectory: of one strip, or of all that lie on it.
    ///
    /// Between strips, they are linear from the end of one to the start of the next.
    ///
    /// # Errors
    /// The problem and its remedy: a strip that is not in the file, no strip on the trajectory, strips at
    /// the same time, or ambiguous times.
    pub fn on_trajectory(
        &self,
        only: Option<&str>,
        trajectory: TimeSpan,
    ) -> std::result::Result<TrajectoryCorrections, (String, String)> {
        let no_strip = |name: &str| {
            (format!("it has no strip `{name}`"), format!("give one of its strips: {}", self.names()))
        };
        let strips: Vec<&StripCorrections> = match only {
            Some(name) => vec![self.strip(name).ok_or_else(|| no_strip(name))?],
            None => self.strips.iter().collect(),
        };
        let mut parts = Vec::new();
        for strip in strips {
            let span = self.span(strip);
            let alignment = Alignment::between(span, trajectory)
                .map_err(|problem| (problem.to_string(), "name the strip with `--strip`".to_owned()))?;
            let [first_s, last_s] = [span.first_s, span.last_s].map(|time_s| alignment.on_trajectory(time_s));
            if last_s < trajectory.first_s || first_s > trajectory.last_s {
                continue;
            }
            let corrections = strip.corrections().map_err(|problem| (problem, REMEDY.to_owned()))?;
            let mut knots: Vec<CorrectionKnot> = corrections.knots().to_vec();
            if only.is_none() {
                // The corrections of the strip end where it ends.
                let end = |time_s| CorrectionKnot { time_s, offset: corrections.at(time_s) };
                knots.retain(|knot| knot.time_s > span.first_s && knot.time_s < span.last_s);
                knots.insert(0, end(span.first_s));
                knots.extend((span.last_s > span.first_s).then(|| end(span.last_s)));
            }
            let shift_s = first_s - span.first_s;
            knots.iter_mut().for_each(|knot| knot.time_s += shift_s);
            parts.push((strip, knots));
        }
        let start = |knots: &[CorrectionKnot]| knots.first().map_or(f64::NAN, |knot| knot.time_s);
        parts.sort_by(|(_, a), (_, b)| start(a).total_cmp(&start(b)));
        for [(first, knots), (second, later)] in parts.array_windows() {
            if knots.last().is_some_and(|last| last.time_s >= start(later)) {
                let problem = format!(
                    "its strips `{}` and `{}` have times in common, and a trajectory has one position at a time",
                    first.recording, second.recording
                );
                return Err((problem, "choose one with `--strip`, and write a trajectory for each".into()));
            }
        }
        let knots: Vec<CorrectionKnot> = parts.into_iter().flat_map(|(_, knots)| knots).collect();
        if knots.is_empty() {
            let problem =
                format!("none of its strips is at a time of the trajectory, which lasts from {trajectory}");
            return Err((problem, "give the corrections of this flight".into()));
        }
        TrajectoryCorrections::new(knots).map_err(|problem| (problem.to_string(), REMEDY.to_owned()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const HEAD: &str = "version = 1\ntime = 'week'\n";

    fn strip(recording: &str, [first_s, last_s]: [f64; 2], knots: &str) -> String {
        format!(
            "[[strip]]\nrecording = '{recording}'\nfirst_s = {first_s:?}\nlast_s = {last_s:?}\nknots = [{knots}]\n"
        )
    }

    #[track_caller]
    fn problem(text: &str) -> String {
        CorrectionsFile::parse(&format!("{HEAD}{text}")).unwrap_err()
    }

    #[test]
    fn offsets_default_to_zero_and_angles_become_radians() {
        let knot = "{ time_s = 5, roll_pitch_heading_deg = [180e-3, 0, -90e-3] }";
        let file = CorrectionsFile::parse(&format!("{HEAD}{}", strip("a", [0.0, 10.0], knot))).unwrap();
        let offset = file.strip("a").unwrap().corrections().unwrap().at(0.0);
        assert_eq!(offset.north_east_down_m, [0.0; 3]);
        let [roll, pitch, heading] = offset.roll_pitch_heading_rad;
        assert!((roll - 1e-3 * std::f64::consts::PI).abs() < 1e-18 && pitch == 0.0);
        assert!((heading + 0.5e-3 * std::f64::consts::PI).abs() < 1e-18);
        assert!(file.strip("b").is_none());
    }

    #[test]
    fn problems_name_the_line_or_the_strip_and_the_knot() {
        let two = "{ time_s = 1 }, { time_s = 1 }";
        for (text, expected) in [
            (strip("a", [0.0, 9.0], ""), "strip 1 (`a`): it has no knots"),
            (
                strip("a", [0.0, 9.0], two),
                "strip 1 (`a`): knot 2: its time 1 s is not after the 1 s of knot 1",
            ),
            (
                strip("a", [0.0, 9.0], "{ time_s = 1, north_east_down_m = [0, 0, 120] }"),
                "strip 1 (`a`): knot 1: an offset is 120 m, at most 100 are plausible",
            ),
            (
                strip("a", [0.0, 9.0], "{ time_s = 1, roll_pitch_heading_deg = [0, 0, -11] }"),
                "strip 1 (`a`): knot 1: an offset is -11 degrees, at most 10 are plausible",
            ),
            (strip("a", [0.0, 9.0], "{ time_s = nan }"), "strip 1 (`a`): knot 1: its time is NaN"),
            (
                strip("a", [0.0, 9.0], "{ time_s = 1, north_east_down_m = [0, inf, 0] }"),
                "strip 1 (`a`): knot 1: its offset to the east is inf",
            ),
            (
                strip("a", [0.0, 9.0], "{ time_s = -2e10 }"),
                "strip 1 (`a`): knot 1: its time -20000000000 s is of no time scale",
            ),
            (
                strip("a", [0.0, 604_800.0], "{ time_s = 1 }"),
                "strip 1 (`a`): it lasts longer than the 604800 s of a `week`",
            ),
            (
                strip("a", [9.0, 0.0], "{ time_s = 1 }"),
                "strip 1 (`a`): `first_s` and `last_s` are 9 and 0, not a time span",
            ),
            (
                strip("a", [0.0, 9.0], "{ time_s = 1 }") + &strip("a", [9.0, 10.0], "{ time_s = 1 }"),
                "strip 2 (`a`): an earlier strip has the same `recording`",
            ),
        ] {
            assert_eq!(problem(&text), expected, "{text}");
        }
        let unknown = problem(&strip("a", [0.0, 9.0], "{ time_s = 1, north_m = 1 }"));
        assert!(unknown.contains("line 7") && unknown.contains("unknown field `north_m`"), "{unknown}");
        assert!(problem("[[strip]\n").contains("line 3"));
        let later = CorrectionsFile::parse("version = 2\nseveral = []\n").unwrap_err();
        assert_eq!(later, "it has version 2 of the format, and this program reads version 1");
        let without = CorrectionsFile::parse("time = 'week'\n").unwrap_err();
        assert!(without.contains("missing field `version`"), "{without}");
        let scale = CorrectionsFile::parse("version = 1\ntime = 'utc'\n").unwrap_err();
        assert!(scale.contains("`utc`") && scale.contains("`adjusted`, `week`, `day`"), "{scale}");
    }

    #[test]
    fn a_file_that_could_not_be_read_is_not_written() {
        let strips =
            vec![StripCorrections { recording: "a".into(), first_s: 0.0, last_s: 1.0, knots: vec![] }];
        let error = CorrectionsFile::new(CorrectionsTime::Week, strips).to_text().unwrap_err();
        assert_eq!(error, "strip 1 (`a`): it has no knots");
    }

    fn trajectory(first_s: f64, last_s: f64) -> TimeSpan {
        TimeSpan { clock: Clock::Week, first_s, last_s }
    }

    /// Offset downwards on a trajectory from 0 to 1000 s, by time.
    fn down_m(file: &CorrectionsFile, only: Option<&str>) -> impl Fn(f64) -> f64 {
        let corrections = file.on_trajectory(only, trajectory(0.0, 1000.0)).unwrap();
        move |time_s| corrections.at(time_s).north_east_down_m[2]
    }

    #[test]
    fn strips_of_a_trajectory_are_joined_by_lines() {
        let knot = |time_s: f64, down_m: f64| {
            format!("{{ time_s = {time_s:?}, north_east_down_m = [0, 0, {down_m:?}] }}")
        };
        // The first line goes on beyond its strip; the second strip has a constant; the third is of another day.
        let line = format!("{}, {}", knot(50.0, 0.0), knot(250.0, 2.0));
        let text = HEAD.to_owned()
            + &strip("late", [300.0, 400.0], &knot(333.0, 5.0))
            + &strip("early", [100.0, 200.0], &line)
            + &strip("other", [90_000.0, 90_100.0], &knot(90_000.0, 9.0));
        let file = CorrectionsFile::parse(&text).unwrap();
        let joined = down_m(&file, None);
        for (time_s, expected) in
            [(0.0, 0.5), (100.0, 0.5), (150.0, 1.0), (200.0, 1.5), (250.0, 3.25), (300.0, 5.0), (999.0, 5.0)]
        {
            assert!((joined(time_s) - expected).abs() < 1e-12, "{time_s}: {}", joined(time_s));
        }
        let early = down_m(&file, Some("early"));
        assert_eq!([0.0, 150.0, 999.0].map(early), [0.0, 1.0, 2.0]);
    }

    #[test]
    fn strips_that_a_trajectory_cannot_have_are_named() {
        let text = HEAD.to_owned()
            + &strip("a", [100.0, 200.0], "{ time_s = 100 }")
            + &strip("b", [150.0, 250.0], "{ time_s = 200 }");
        let file = CorrectionsFile::parse(&text).unwrap();
        let problem = |only, times| file.on_trajectory(only, times).unwrap_err().0;
        assert_eq!(
            problem(None, trajectory(0.0, 1000.0)),
            "its strips `a` and `b` have times in common, and a trajectory has one position at a time"
        );
        assert!(file.on_trajectory(Some("a"), trajectory(0.0, 1000.0)).is_ok());
        assert_eq!(problem(Some("c"), trajectory(0.0, 1000.0)), "it has no strip `c`");
        let none = problem(Some("a"), trajectory(5000.0, 6000.0));
        assert!(
            none.starts_with(
                "none of its strips is at a time of the trajectory, which lasts from Sunday 01:23:20.0"
            ),
            "{none}"
        );
    }

    proptest! {
        /// Reading restores every bit, and writing again every byte.
        #[test]
        fn a_file_is_restored_exactly(
            names in proptest::collection::hash_set("[ -~äß']{1,12}", 0..4),
            first_s in -1e6..1e9, knots in proptest::collection::vec(proptest::array::uniform7(-1.0..1.0), 1..5),
            tiny in any::<f64>(),
        ) {
            let knot = |(n, [time, values @ ..]): (usize, &[f64; 7])| {
                let [north, east, down, roll, pitch, heading] = values;
                let tiny = if tiny.abs() < 100.0 { tiny } else { -0.0 };
                StripKnot {
                    time_s: first_s + n as f64 + 0.4 * time,
                    north_east_down_m: [100.0 * north, *east, tiny * down.signum()],
                    roll_pitch_heading_deg: [1e-9 * roll, *pitch, 10.0 * heading],
                }
            };
            let knots: Vec<StripKnot> = knots.iter().enumerate().map(knot).collect();
            let strip = |recording: &String| StripCorrections {
                recording: recording.clone(), first_s, last_s: first_s + 60.0, knots: knots.clone(),
            };
            let file = CorrectionsFile::new(CorrectionsTime::Adjusted, names.iter().map(strip).collect());
            let text = file.to_text().unwrap();
            let read = CorrectionsFile::parse(&text).unwrap();
            prop_assert_eq!(&read, &file);
            prop_assert_eq!(read.to_text().unwrap(), text);
            for strip in &file.strips {
                let again = StripCorrections::new(&*strip.recording, [strip.first_s, strip.last_s], &strip.corrections().unwrap());
                for (again, knot) in again.knots.iter().zip(&strip.knots) {
                    prop_assert_eq!(again.north_east_down_m, knot.north_east_down_m);
                    for (again, degrees) in again.roll_pitch_heading_deg.iter().zip(knot.roll_pitch_heading_deg) {
                        prop_assert!((again - degrees).abs() <= 1e-15 * degrees.abs());
                    }
                }
            }
        }
    }
}

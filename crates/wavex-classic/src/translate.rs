//! Translates the options of a command line into a job.

use std::collections::BTreeMap;
use std::sync::Arc;

use super::draft::{Draft, DraftText, Known, toml_number, toml_text};
use super::line::{Given, Value};
use super::options::{Becomes, Flag, Form, Opt, Part, Standard, Takes, Version};
use super::paths::Paths;
use super::problem::Problem;
use wavex_formats::format::reader_of;
use wavex_line::keys::listed;

/// Context of a translation.
pub struct Place<'a> {
    /// Stages and keys of the program.
    pub known: &'a Known,
    /// Folder at which relative paths of the line start, if the job is written to another folder.
    pub base: Option<&'a str>,
    /// Reads a file by its path relative to the current folder; `None` if it cannot be read.
    pub read: &'a dyn Fn(&str) -> Option<String>,
    /// Latitude of the first trajectory record, degrees, by path and column letters; `None` if
    /// unknown.
    pub latitude: &'a dyn Fn(&str, Option<&str>) -> Option<f64>,
}

/// Result of a translation.
#[derive(Debug, Default)]
pub struct Imported {
    /// The job; empty if the line requests commands only.
    pub job: DraftText,
    /// Commands to run besides or instead of the job, each a `wavex` command line.
    pub commands: Vec<Vec<String>>,
    /// Options without a key: as written, and the explanation.
    pub notes: Vec<(String, String)>,
    /// Options of `wavex run`.
    pub flags: Vec<Flag>,
    /// The options, for errors in the job.
    pub given: Vec<Given>,
}

/// State of a translation.
pub(super) struct Translation<'a> {
    pub(super) version: &'static Version,
    pub(super) place: &'a Place<'a>,
    /// Each option once.
    pub(super) given: Vec<Given>,
    pub(super) draft: Draft,
    pub(super) paths: Paths,
    pub(super) problems: Vec<Problem>,
    pub(super) result: Imported,
    /// The stage that replaces the section `reader`.
    pub(super) reader: &'static str,
}

/// The only optional column of a trajectory.
const ROLL: char = 'w';

/// Columns of a trajectory with their letters; all except roll are required for a pose.
const TRAJECTORY_COLUMNS: [(char, &str); 7] = [
    ('t', "time"),
    ('x', "longitude or easting"),
    ('y', "latitude or northing"),
    ('z', "height"),
    ('w', "roll"),
    ('p', "pitch"),
    ('k', "heading"),
];

/// Keys that are pairs, of which each option sets one number.
type NumberPairs = BTreeMap<(&'static str, &'static str), ([f64; 2], Vec<String>)>;

/// Translates the options of a line; later options override earlier ones.
pub fn translate(
    version: &'static Version,
    given: Vec<Given>,
    place: &Place,
) -> Result<Imported, Vec<Problem>> {
    let mut result = Imported::default();
    let given = latest(given, &mut result.notes);
    let paths = Paths::of(&given, place.base);
    let reader = "";
    let mut it = Translation {
        version,
        place,
        given,
        draft: Draft::default(),
        paths,
        problems: Vec::new(),
        result,
        reader,
    };
    it.words_for_wavex();
    if it.on(Part::OnlyScan) || it.on(Part::OnlyScanFast) || it.inputs().is_empty() {
        it.without_job();
    } else {
        it.job();
    }
    it.result.given = it.given;
    if it.problems.is_empty() { Ok(it.result) } else { Err(it.problems) }
}

/// Keeps each option once and notes overridden ones.
///
/// Several inputs of one line are joined. For other options the last one counts.
fn latest(all: Vec<Given>, notes: &mut Vec<(String, String)>) -> Vec<Given> {
    let mut latest: Vec<Given> = Vec::new();
    for mut given in all {
        let same = latest.iter().position(|other| std::ptr::eq(other.option, given.option));
        if let Some(old) = same.map(|at| latest.remove(at)) {
            let is_same_line = Arc::ptr_eq(&old.place.source, &given.place.source);
            match (old.value, &mut given.value) {
                (Value::Texts(mut first), Value::Texts(more)) if is_same_line => {
                    first.append(more);
                    *more = first;
                    // Appends, so that many inputs take linear time.
                    let more = std::mem::replace(&mut given.written, old.written);
                    given.written += " ";
                    given.written += &more;
                }
                _ => notes.push((old.written, format!("overridden by `{}`", given.written))),
            }
        }
        latest.push(given);
    }
    latest
}

impl Translation<'_> {
    /// The option of this part, if given.
    pub(super) fn part(&self, part: Part) -> Option<&Given> {
        self.given.iter().find(|given| given.option.becomes == Becomes::Part(part))
    }

    /// Returns whether the switch of this part is given and on.
    pub(super) fn on(&self, part: Part) -> bool {
        self.part(part).is_some_and(|given| given.value == Value::Switch(true))
    }

    /// The word given for this part.
    pub(super) fn text(&self, part: Part) -> Option<&str> {
        match &self.part(part)?.value {
            Value::Text(text) => Some(text),
            _ => None,
        }
    }

    /// The option of this part as written.
    pub(super) fn written(&self, part: Part) -> String {
        self.part(part).map(|given| given.written.clone()).unwrap_or_default()
    }

    /// The option that sets this key.
    pub(super) fn of_key(&self, section: &str, key: &str) -> Option<&Given> {
        let is_it = |given: &&Given| matches!(given.option.becomes, Becomes::Key(of, name, _) if of == section && name == key);
        self.given.iter().find(is_it)
    }

    /// Input files.
    pub(super) fn inputs(&self) -> Vec<String> {
        match self.part(Part::Input).map(|given| &given.value) {
            Some(Value::Texts(files)) => files.iter().map(|file| self.paths.input(file)).collect(),
            _ => Vec::new(),
        }
    }

    pub(super) fn note(&mut self, written: impl Into<String>, what: impl Into<String>) {
        self.result.notes.push((written.into(), what.into()));
    }

    /// Handles options of `wavex` itself and options without translation.
    fn words_for_wavex(&mut self) {
        let mut said = Vec::new();
        for given in &self.given {
            let is_on = given.value == Value::Switch(true);
            match given.option.becomes {
                Becomes::Flag(flag, when) if is_on == when => {
                    self.result.flags.push(flag);
                    said.push((
                        given.written.clone(),
                        format!("an option of the run: `wavex run {}`", flag.text()),
                    ));
                }
                Becomes::Command(words) if is_on => {
                    self.result.commands.push(words.iter().map(|word| (*word).to_owned()).collect());
                }
                Becomes::Nothing(why) if is_on => said.push((given.written.clone(), why.to_owned())),
                Becomes::Flag(..) | Becomes::Command(_) | Becomes::Nothing(_) => said.push(so_anyway(given)),
                _ => {}
            }
        }
        self.result.notes.extend(said);
    }

    /// Builds the job.
    fn job(&mut self) {
        let inputs = self.inputs();
        self.reader = match reader(&inputs) {
            Ok(reader) => reader,
            Err(what) => {
                self.problems.extend(self.part(Part::Input).map(|given| Problem::at(&given.place, what)));
                return;
            }
        };
        self.folders();
        let why = self.written(Part::Input);
        let files: Vec<String> = inputs.iter().map(|file| toml_text(file)).collect();
        let path =
            if let [file] = files.as_slice() { file.clone() } else { format!("[{}]", files.join(", ")) };
        self.draft.set(self.reader, "path", path, &why, true);
        let sinks = self.sinks();
        for &(section, key, toml, why) in self.version.always {
            self.draft.set(section, key, toml.to_owned(), why, false);
        }
        self.keys();
        self.speed();
        self.scans();
        self.plots();
        let stages = self.stages(&sinks);
        self.leftovers(&stages);
        self.result.job = self.draft.text(&stages, self.place.known);
    }

    /// The stages that the line requests.
    fn stages(&self, sinks: &[&'static str]) -> Vec<&'static str> {
        let is_there = |stage: &&'static str| match *stage {
            // Raw recordings have unresolved zones; all formats but LAS may have two receivers.
            "resolve_mta" => matches!(self.reader, "read_sdf" | "read_arrow"),
            "fuse_channels" => self.reader != "read_las",
            stage if stage.starts_with("write_") => sinks.contains(&stage),
            _ => true,
        };
        std::iter::once(self.reader).chain(self.version.chain.iter().copied().filter(is_there)).collect()
    }

    /// Sets the folders in `[job]`.
    fn folders(&mut self) {
        let (input, output) = (self.written(Part::InputDir), self.written(Part::OutputDir));
        for (key, dir, why) in
            [("input_dir", self.paths.input_dir(), input), ("output_dir", self.paths.output_dir(), output)]
        {
            if let Some(dir) = dir {
                self.draft.set("job", key, toml_text(&dir), &with_warning(why, &dir), true);
            }
        }
        if self.paths.is_prefixed() {
            let what = "part of the paths below, because some files contain a folder";
            self.note(self.written(Part::InputDir), what);
        }
    }

    /// Sets the keys of all options, in the order of the table.
    pub(super) fn keys(&mut self) {
        let mut ends = NumberPairs::new();
        let default_of = format!("default of {}", self.version.name);
        for option in self.version.options {
            let given = self.given.iter().find(|given| std::ptr::eq(given.option, option));
            let (value, why) = match (given, option.standard) {
                (Some(given), _) => (given.value.clone(), given.written.clone()),
                (None, Standard::Written(text)) => (written_default(option, text), default_of.clone()),
                (None, _) => continue,
            };
            let is_asked = given.is_some();
            match option.becomes {
                Becomes::Key(section, key, form) => {
                    self.key(option, section_of(section, self.reader), key, form, &value, (&why, is_asked));
                }
                Becomes::End(section, key, end, open) => {
                    let (both, from) = ends.entry((section, key)).or_insert((open, Vec::new()));
                    if let (Value::Number(number), Some(place)) = (value, both.get_mut(end)) {
                        *place = number;
                    }
                    from.push(why);
                }
                _ => {}
            }
        }
        for ((section, key), ([from, to], why)) in ends {
            let toml = format!("[{}, {}]", toml_number(from), toml_number(to));
            self.draft.set(section_of(section, self.reader), key, toml, &why.join(" "), true);
        }
    }

    fn key(
        &mut self,
        option: &'static Opt,
        section: &'static str,
        key: &'static str,
        form: Form,
        value: &Value,
        (why, is_asked): (&str, bool),
    ) {
        match (form, value) {
            (Form::Angles, _) => return self.mount(key, value, why),
            (Form::Zone, Value::Whole(zone)) => return self.zone(*zone, why),
            _ => {}
        }
        let Some(toml) = toml_of(form, value, &self.paths) else {
            self.note(why, "already the default");
            return;
        };
        if !is_asked {
            return self.draft.set(section, key, toml, why, false);
        }
        self.set_or_refuse(section, key, toml, why);
        match (form, value) {
            (Form::Remarked, _) => self.draft.remark(section, key, option.remark),
            (Form::TrajectoryColumns, Value::Text(letters)) => {
                if let Some(obstacle) = without_a_column(letters) {
                    self.draft.obstruct(section, key, obstacle);
                } else if !letters.contains(ROLL) {
                    self.draft.remark(section, key, "no roll (`w`): set to 0");
                }
            }
            _ => {}
        }
    }

    /// Sets a requested key; reports a conflict with an earlier request.
    fn set_or_refuse(&mut self, section: &str, key: &'static str, toml: String, why: &str) {
        match self.draft.asked(section, key) {
            Some((other, of)) if other != toml => {
                let what = format!("`{of}` and `{why}` exclude each other");
                let place = self.given.iter().find(|given| given.written == why);
                self.problems.extend(place.map(|given| Problem::at(&given.place, what)));
            }
            _ => self.draft.set(section, key, toml, why, true),
        }
    }

    /// Sets the mounting angles, read from a file.
    fn mount(&mut self, key: &'static str, value: &Value, why: &str) {
        let Value::Text(file) = value else { return };
        let path = self.paths.input(file);
        let angles = (self.place.read)(&self.paths.here(&path)).and_then(|text| angles(&text));
        match angles {
            Some([roll, pitch, yaw]) => {
                let toml = format!("[{}, {}, {}]", toml_number(roll), toml_number(pitch), toml_number(yaw));
                self.draft.set("geometry", key, toml, &format!("{why}: angles read from the file"), true);
            }
            None => {
                let what = format!("cannot read three angles from `{path}`");
                let place = self.given.iter().find(|given| given.written == why).map(|given| &given.place);
                let help = "a file of mounting angles has three numbers in degrees: about x, y and z";
                self.problems.extend(place.map(|place| Problem::at(place, what).help(help)));
            }
        }
    }

    /// Sets a UTM zone, on the hemisphere of the first trajectory record.
    fn zone(&mut self, zone: u64, why: &str) {
        let word = |of: &Self, key| match of.of_key("geometry", key).map(|given| &given.value) {
            Some(Value::Text(text)) => Some(text.clone()),
            _ => None,
        };
        let columns = word(self, "trajectory_columns");
        let latitude = word(self, "trajectory").and_then(|file| {
            let file = self.paths.here(&self.paths.input(&file));
            (self.place.latitude)(&file, columns.as_deref())
        });
        let (letter, remark) = match latitude {
            Some(degrees) if degrees < 0.0 => ("S", "S, from the start of the trajectory"),
            Some(_) => ("N", "N, from the start of the trajectory"),
            None => ("", "add N or S: the hemisphere is unknown"),
        };
        self.set_or_refuse("geometry", "crs", toml_text(&format!("utm:{zone}{letter}")), why);
        self.draft.remark("geometry", "crs", remark);
    }

    /// Sets the decomposition mode as far as several options define it.
    fn speed(&mut self) {
        let is_fast = self.draft.asked("decompose", "mode").is_some();
        let (slow, auto) = (self.written(Part::Slow), self.written(Part::Auto));
        match (self.on(Part::Slow), is_fast) {
            (true, false) => self.draft.set("decompose", "mode", "\"slow\"".to_owned(), &slow, true),
            (true, true) => self.note(slow, "refined waveforms get the iterations of `refined`"),
            _ => {}
        }
        match (self.on(Part::Auto), is_fast) {
            (true, true) => {
                self.draft.set("decompose", "refine_when_needed", "true".to_owned(), &auto, true);
            }
            (true, false) => self.note(auto, "no effect: every waveform is refined"),
            _ => {}
        }
    }

    /// Notes requests that no stage of the job implements, and switches that request nothing.
    fn leftovers(&mut self, stages: &[&str]) {
        let has_trajectory = self.draft.asked("geometry", "trajectory").is_some();
        let mut sections = stages.to_vec();
        sections.push("job");
        if has_trajectory {
            sections.push("geometry");
        }
        for (section, why) in self.draft.asked_outside_of(&sections) {
            let what = match section.as_str() {
                "geometry" => "no effect: `-po` is not given".to_owned(),
                stage => format!("no effect: the job has no `{stage}`"),
            };
            self.note(why, what);
        }
        if !has_trajectory {
            self.draft.remove("geometry");
        }
        let is_off = |given: &&Given| {
            matches!(given.option.becomes, Becomes::Part(part) if part != Part::Trajectory)
                && given.value == Value::Switch(false)
        };
        let off: Vec<_> = self.given.iter().filter(is_off).map(so_anyway).collect();
        self.result.notes.extend(off);
    }
}

/// Returns the reader of these files.
fn reader(files: &[String]) -> Result<&'static str, String> {
    let mut readers = files.iter().map(|file| reader_of(file));
    let first = readers.next().unwrap_or(Err("no input".to_owned()))?;
    for (reader, file) in readers.zip(files.iter().skip(1)) {
        if reader? != first {
            return Err(format!(
                "`{file}` has another format than the files before it; use one job per format"
            ));
        }
    }
    Ok(first)
}

/// Note for an option that requests the default.
fn so_anyway(given: &Given) -> (String, String) {
    (given.written.clone(), "already the default".to_owned())
}

/// Section of the job for a section of the table.
fn section_of(section: &'static str, reader: &'static str) -> &'static str {
    if section == "reader" { reader } else { section }
}

/// Converts a default of the table to a value.
fn written_default(option: &Opt, text: &str) -> Value {
    match option.takes {
        Takes::Switch => Value::Switch(text == "1"),
        // A test ensures that all other defaults in the table are numbers.
        _ => Value::Number(text.parse().unwrap_or_default()),
    }
}

/// Converts a value to TOML; `None` omits the key.
fn toml_of(form: Form, value: &Value, paths: &Paths) -> Option<String> {
    let is_zero = match value {
        Value::Number(number) => *number == 0.0,
        Value::Text(text) => text == "0",
        _ => false,
    };
    let plain = match value {
        Value::Switch(is_on) => is_on.to_string(),
        Value::Number(number) => toml_number(*number),
        Value::Whole(number) => number.to_string(),
        Value::Text(text) => toml_text(text),
        Value::Texts(texts) => toml_text(&texts.join(" ")),
    };
    match (form, value) {
        (Form::ZeroIs(other), _) if is_zero => Some(other.to_owned()),
        (Form::ZeroIsNothing, _) if is_zero => None,
        (Form::Switch(off, on), Value::Switch(is_on)) => {
            Some(if *is_on { on } else { off }.to_owned()).filter(|toml| !toml.is_empty())
        }
        (Form::File, Value::Text(file)) => Some(toml_text(&paths.input(file))),
        _ => Some(plain),
    }
}

/// Describes missing or repeated trajectory columns, with the remedy.
fn without_a_column(letters: &str) -> Option<String> {
    let of = |is_wrong: fn(usize) -> bool| -> Vec<String> {
        let count = |letter: char| letters.matches(letter).count();
        let columns = TRAJECTORY_COLUMNS.iter().filter(|(letter, _)| *letter != ROLL || count(ROLL) > 0);
        let wrong = columns.filter(|(letter, _)| is_wrong(count(*letter)));
        wrong.map(|(letter, name)| format!("the {name} (`{letter}`)")).collect()
    };
    let (absent, repeated) = (of(|count| count == 0), of(|count| count > 1));
    if absent.is_empty() {
        return (!repeated.is_empty()).then(|| format!("{} must not be repeated", listed(&repeated, "and")));
    }
    let (are, them, columns, letters) = match absent.len() {
        1 => ("is", "it", "the column", "its letter"),
        _ => ("are", "them", "the columns", "their letters"),
    };
    Some(format!(
        "{} {are} missing, and points cannot be georeferenced without {them}: give a trajectory that has {them}, or add {columns} \
         to the text file and {letters} here",
        listed(&absent, "and")
    ))
}

/// Adds a warning to the source of a folder if it has a Windows drive on another system.
fn with_warning(why: String, folder: &str) -> String {
    let mut letters = folder.chars();
    let has_drive =
        letters.next().is_some_and(|letter| letter.is_ascii_alphabetic()) && letters.next() == Some(':');
    if has_drive && !cfg!(windows) {
        format!("{why}: a Windows folder; replace it by a folder of this machine")
    } else {
        why
    }
}

/// Parses the three numbers of a text.
fn angles(text: &str) -> Option<[f64; 3]> {
    let separators = |letter: char| letter.is_whitespace() || matches!(letter, ',' | ';' | '{' | '}');
    let words = text.split(separators).filter(|word| !word.is_empty());
    let numbers: Vec<f64> =
        words.map(|word| word.parse().ok().filter(|n: &f64| n.is_finite())).collect::<Option<_>>()?;
    numbers.try_into().ok()
}

//! Lists the files that a job reads.
//!
//! Sources' files with companions, files named by other stages, and files of `[job.geometry]`.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use serde_json::Value;

use super::paths::plain;
use wavex_engine::engine::Input;
use wavex_engine::job::{Job, JobSettings};
use wavex_engine::missing;
use wavex_formats::{CompanionIndex, Error, RecordingFormat};
use wavex_geodesy::crs::Named;
use wavex_line::keys::{FileMark, Key, Keys};

/// JSON pointers of the keys in `[job]` with this mark.
pub(super) fn marked(mark: FileMark) -> Vec<String> {
    marked_among(&JobSettings::keys(), mark)
}

fn marked_among(keys: &Keys, mark: FileMark) -> Vec<String> {
    let mut found = Vec::new();
    keys.iter().for_each(|key| collect(key, "", mark, &mut found));
    found
}

/// Collects pointers of a key and of its nested keys.
fn collect(key: Key, table: &str, mark: FileMark, found: &mut Vec<String>) {
    let pointer = format!("{table}/{}", key.name);
    key.inner().for_each(|inner| collect(inner, &pointer, mark, found));
    if key.file_mark() == Some(mark) {
        found.push(pointer);
    }
}

/// All files that a run of the job over these inputs reads; `input_dir` is absolute.
///
/// # Errors
/// If a folder of inputs cannot be listed.
pub(super) fn of_job(
    job: &Job,
    settings: &Value,
    inputs: &[Input],
    input_dir: &Path,
) -> Result<BTreeSet<PathBuf>, Error> {
    FilesRead::with(job, settings, input_dir).of(inputs)
}

/// Lists the files that runs of a job read; lists each folder once.
pub struct FilesRead {
    /// Absolute folder of the inputs.
    input_dir: PathBuf,
    /// Files that do not depend on the input.
    fixed: BTreeSet<PathBuf>,
    /// Names of files in `[job]`; `*` is the stem of the input.
    named: Vec<String>,
    index: CompanionIndex,
}

impl FilesRead {
    /// Lists files of this job; `input_dir` is absolute.
    pub fn new(job: &Job, input_dir: &Path) -> FilesRead {
        FilesRead::with(job, &serde_json::to_value(&job.settings).unwrap_or_default(), input_dir)
    }

    fn with(job: &Job, settings: &Value, input_dir: &Path) -> FilesRead {
        let of_stages = job.stages.iter().flat_map(|stage| &stage.planned.inputs);
        let mut fixed: BTreeSet<PathBuf> = of_stages.map(|text| plain(&input_dir.join(text))).collect();
        fixed.extend(geoid(settings, input_dir));
        let pointers = pointers(settings, input_dir);
        let named = pointers.iter().filter_map(|pointer| settings.pointer(pointer)?.as_str());
        let named = named.map(str::to_owned).collect();
        FilesRead { input_dir: input_dir.to_owned(), fixed, named, index: CompanionIndex::default() }
    }

    /// All files that a run over these inputs reads.
    ///
    /// # Errors
    /// If a folder of inputs cannot be listed.
    pub fn of(&mut self, inputs: &[Input]) -> Result<BTreeSet<PathBuf>, Error> {
        let mut files = self.fixed.clone();
        for input in inputs.iter().filter(|input| !input.path.as_os_str().is_empty()) {
            let path = plain(&self.input_dir.join(&input.path));
            files.extend(self.index.of(&path)?);
            files.insert(path);
        }
        for text in &self.named {
            let file = |input: &Input| plain(&self.input_dir.join(text.replace('*', &input.stem)));
            files.extend(inputs.iter().map(file));
        }
        Ok(files)
    }
}

/// Describes missing files of a job over these inputs; `input_dir` is absolute.
pub fn missing_files(job: &Job, inputs: &[Input], input_dir: &Path) -> Vec<String> {
    let settings = serde_json::to_value(&job.settings).unwrap_or_default();
    let is_standard_input = |path: &PathBuf| path.file_name().is_some_and(|name| name == "-");
    let files = match of_job(job, &settings, inputs, input_dir) {
        Err(error) => return vec![error.to_string()],
        Ok(files) => files,
    };
    let files = files.into_iter().filter(|path| !is_standard_input(path) && !path.exists());
    let mut missing: Vec<String> = files.map(|path| no_such_file(&path)).collect();
    let geometry = &job.settings.geometry;
    let names_crs = |word: &str| !matches!(Named::parse(word), Ok(None)) || input_dir.join(word).is_file();
    if let Some(word) = geometry.crs.as_deref().filter(|word| !names_crs(word)) {
        missing.push(format!("{}: no such file", plain(&input_dir.join(word)).display()));
    }
    if let Some(name) = &geometry.geoid
        && geoid(&settings, input_dir).is_none()
    {
        let folder = geometry.geoid_dir.as_deref().unwrap_or_default();
        missing.push(format!("{}: no geoid {name} (.bin, .gtx)", plain(&input_dir.join(folder)).display()));
    }
    missing
}

/// Describes a missing file; the file that was meant is of the same kind.
fn no_such_file(path: &Path) -> String {
    let is_recording = |path: &Path| RecordingFormat::of(path).is_some();
    let is_like = |other: &Path| match is_recording(path) {
        true => is_recording(other),
        false => other.extension() == path.extension(),
    };
    let remedy = missing::remedy(path, is_like).map_or(String::new(), |remedy| format!("; {remedy}"));
    format!("{}: no such file{remedy}", path.display())
}

/// JSON pointers of the texts in `[job]` that name input files.
pub(super) fn pointers(settings: &Value, input_dir: &Path) -> Vec<String> {
    let text = |pointer: &str| settings.pointer(pointer).and_then(Value::as_str);
    let named = marked(FileMark::Input).into_iter().filter(|pointer| text(pointer).is_some());
    let is_file = |pointer: &String| text(pointer).is_some_and(|text| input_dir.join(text).is_file());
    named.chain(marked(FileMark::InputOrName).into_iter().filter(is_file)).collect()
}

/// JSON pointers of the geoid and of the geoid folder.
fn geoid_pointers() -> Option<(String, String)> {
    marked(FileMark::Geoid).pop().zip(marked(FileMark::GeoidFolder).pop())
}

/// Sets the geoid folder if the job names a geoid.
///
/// `place` maps a folder of the job to a path; the empty text is the input folder.
///
/// # Errors
/// Errors of `place`.
pub(super) fn place_geoid<E>(
    settings: &mut Value,
    place: impl FnOnce(&str) -> Result<String, E>,
) -> Result<(), E> {
    let Some((name, folder)) = geoid_pointers() else { return Ok(()) };
    if settings.pointer(&name).is_some_and(Value::is_string)
        && let Some(said) = settings.pointer_mut(&folder)
    {
        *said = place(said.as_str().unwrap_or_default())?.into();
    }
    Ok(())
}

/// File of the geoid: its name or stem matches the key, ignoring case.
fn geoid(settings: &Value, input_dir: &Path) -> Option<PathBuf> {
    let (name, folder) = geoid_pointers()?;
    let wanted = settings.pointer(&name)?.as_str()?.to_lowercase();
    let folder = settings.pointer(&folder).and_then(Value::as_str);
    let folder = plain(&folder.map_or(input_dir.to_owned(), |folder| input_dir.join(folder)));
    let is_grid = |path: &PathBuf| {
        let extension = path.extension().unwrap_or_default().to_string_lossy().to_lowercase();
        let names =
            [path.file_name(), path.file_stem()].map(|name| name.unwrap_or_default().to_string_lossy());
        ["bin", "gtx"].contains(&extension.as_str()) && names.iter().any(|name| name.to_lowercase() == wanted)
    };
    folder.read_dir().ok()?.flatten().map(|entry| entry.path()).find(is_grid)
}

#[cfg(test)]
mod tests {
    use std::fs;
    use wavex_stages::registry::STAGES;

    use schemars::JsonSchema;
    use serde_json::json;

    use super::*;
    use wavex_line::keys::choices;

    fn input(path: &Path, stem: &str) -> Input {
        Input { path: path.to_owned(), stem: stem.to_owned(), part: None }
    }

    #[test]
    fn files_beside_an_input_and_those_that_stages_name_are_read() {
        let folder = tempfile::tempdir().unwrap();
        let dir = folder.path();
        for name in ["a.las", "a.WDP", "b.las", "b.wdz", "other.wdp", "model.json"] {
            fs::write(dir.join(name), "").unwrap();
        }
        let text = "[[stage]]\ntype = 'read_las'\npath = '*.las'\n[[stage]]\ntype = 'calibrate'\nload = './model.json'\n";
        let job = Job::parse(STAGES, "a.toml", text, &[]).unwrap();
        let inputs = [input(&dir.join("a.las"), "a"), input(&dir.join("b.las"), "b")];
        let found = of_job(&job, &json!({}), &inputs, dir).unwrap();
        let expected = ["a.WDP", "a.las", "b.las", "b.wdz", "model.json"].map(|name| dir.join(name));
        assert_eq!(found.into_iter().collect::<Vec<_>>(), expected);
    }

    #[test]
    fn a_simulated_input_is_no_file() {
        let job = Job::parse(STAGES, "a.toml", "[[stage]]\ntype = 'simulate'\n", &[]).unwrap();
        assert!(
            of_job(&job, &json!({}), &[input(Path::new(""), "out")], Path::new("/in")).unwrap().is_empty()
        );
    }

    #[test]
    fn files_of_the_geometry_are_found_by_stem_and_by_name() {
        let folder = tempfile::tempdir().unwrap();
        let dir = folder.path();
        fs::create_dir(dir.join("geoids")).unwrap();
        for name in ["a.pof", "b.pof", "geoids/EGM96.gtx", "geoids/egm2008.bin", "zone.wkt"] {
            fs::write(dir.join(name), "").unwrap();
        }
        let job = Job::parse(STAGES, "a.toml", "[[stage]]\ntype = 'simulate'\n", &[]).unwrap();
        let inputs = [input(Path::new(""), "a"), input(Path::new(""), "b")];
        let names = |settings: Value| -> Vec<String> {
            let found = of_job(&job, &settings, &inputs, dir).unwrap();
            found.iter().map(|path| path.strip_prefix(dir).unwrap().display().to_string()).collect()
        };
        let geometry = json!({"geometry": {"trajectory": "*.pof", "crs": "zone.wkt", "geoid": "egm96", "geoid_dir": "geoids"}});
        assert_eq!(names(geometry), ["a.pof", "b.pof", "geoids/EGM96.gtx", "zone.wkt"]);
        let geometry = json!({"geometry": {"crs": "utm:33N", "geoid": "egm96", "calibration": {"e0": 1.0}}});
        assert_eq!(names(geometry), Vec::<String>::new());
    }

    /// Visits every key of `[job]`, including nested ones, with its pointer.
    fn visit(key: Key, table: &str, seen: &mut dyn FnMut(&str, Key)) {
        let pointer = format!("{table}/{}", key.name);
        key.inner().for_each(|inner| visit(inner, &pointer, seen));
        seen(&pointer, key);
    }

    /// Archives would lack the files of a key without a mark.
    #[test]
    fn every_text_of_the_job_says_whether_it_names_a_file() {
        let keys = JobSettings::keys();
        let mut marks = Vec::new();
        let mut seen = |pointer: &str, key: Key| {
            let branches =
                key.schema["anyOf"].as_array().map_or(vec![key.schema], |all| all.iter().collect());
            let is_text = |schema: &&Value| schema["type"] == "string" && choices(schema).is_none();
            let takes_text = branches.iter().any(is_text);
            assert_eq!(key.file_mark().is_some(), takes_text, "{pointer}: declare `x-file` for this key");
            marks.extend(key.file_mark().map(|mark| (pointer.to_owned(), mark)));
        };
        keys.iter().for_each(|key| visit(key, "", &mut seen));
        let with = |wanted| {
            let found = marks.iter().filter(|(_, mark)| *mark == wanted);
            found.map(|(pointer, _)| pointer.as_str()).collect::<Vec<_>>()
        };
        let inputs = ["trajectory", "trajectory_accuracy", "calibration", "corrections"]
            .map(|key| format!("/geometry/{key}"));
        assert_eq!(with(FileMark::Input), [&["/survey_model".to_owned()][..], &inputs].concat());
        assert_eq!(with(FileMark::Geoid), ["/geometry/geoid"]);
        assert_eq!(with(FileMark::GeoidFolder), ["/geometry/geoid_dir"]);
        let outputs = ["/report", "/report_page", "/survey_page", "/stat_log", "/log", "/survey/cells"];
        assert_eq!(with(FileMark::Output), outputs);
    }

    #[test]
    fn a_new_key_is_found_by_its_mark() {
        #[derive(JsonSchema)]
        #[allow(dead_code, reason = "only its schema is looked at")]
        struct Outer {
            name: String,
            #[schemars(extend("x-file" = "input"))]
            own: Option<String>,
            inner: Option<Inner>,
        }
        #[derive(JsonSchema)]
        #[allow(dead_code, reason = "only its schema is looked at")]
        struct Inner {
            #[schemars(extend("x-file" = "input"))]
            terrain: String,
            #[schemars(extend("x-file" = "output"))]
            picture: String,
        }
        let found = marked_among(&Keys::of(Outer::json_schema), FileMark::Input);
        assert_eq!(found, ["/own", "/inner/terrain"]);
    }
}

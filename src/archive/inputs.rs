//! Which files a job reads: the source's, those beside them, those that other stages name, and those of `[job.geometry]`.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use serde_json::Value;

use super::paths::plain;
use crate::engine::Input;
use crate::formats::companions;
use crate::job::Job;

/// Texts of `[job]` that name files, as JSON pointers; `*` in them is the input's stem.
const SETTINGS: [&str; 3] =
    ["/geometry/trajectory", "/geometry/trajectory_accuracy", "/geometry/calibration"];
/// A text of `[job]` that may be the name of a file or of something else.
const FILE_OR_NAME: &str = "/geometry/crs";
/// The table of `[job]` with the keys of the geoid.
const GEOMETRY: &str = "geometry";
/// The key that names a geoid.
const GEOID: &str = "geoid";
/// The key of the folder in which geoids lie; that of the inputs when not given.
pub(super) const GEOID_DIR: &str = "geoid_dir";

/// Every file that a run of the job over these inputs reads, each once; `input_dir` is absolute.
pub(super) fn of_job(job: &Job, settings: &Value, inputs: &[Input], input_dir: &Path) -> BTreeSet<PathBuf> {
    let mut files = BTreeSet::new();
    for input in inputs.iter().filter(|input| !input.path.as_os_str().is_empty()) {
        let path = plain(&input_dir.join(&input.path));
        files.extend(companions(&path));
        files.insert(path);
    }
    for text in job.stages.iter().flat_map(|stage| &stage.planned.inputs) {
        files.insert(plain(&input_dir.join(text)));
    }
    for text in pointers(settings, input_dir).iter().filter_map(|pointer| settings.pointer(pointer)?.as_str())
    {
        files.extend(inputs.iter().map(|input| plain(&input_dir.join(text.replace('*', &input.stem)))));
    }
    files.extend(geoid(settings, input_dir));
    files
}

/// Where `[job]` has texts that name files, seen from the folder of inputs, as JSON pointers.
pub(super) fn pointers(settings: &Value, input_dir: &Path) -> Vec<&'static str> {
    let text = |pointer: &str| settings.pointer(pointer).and_then(Value::as_str);
    let mut pointers = SETTINGS.to_vec();
    pointers.retain(|pointer| text(pointer).is_some());
    if text(FILE_OR_NAME).is_some_and(|text| input_dir.join(text).is_file()) {
        pointers.push(FILE_OR_NAME);
    }
    pointers
}

/// The table of `[job]` that names a geoid, where one does.
pub(super) fn table_of_geoid(settings: &mut Value) -> Option<&mut Value> {
    let table = settings.get_mut(GEOMETRY)?;
    if table.get(GEOID).is_some_and(Value::is_string) { Some(table) } else { None }
}

/// The file of the geoid: its name or its stem is the one that the job gives, in any case.
fn geoid(settings: &Value, input_dir: &Path) -> Option<PathBuf> {
    let table = settings.get(GEOMETRY)?;
    let wanted = table.get(GEOID)?.as_str()?.to_lowercase();
    let folder = table.get(GEOID_DIR).and_then(Value::as_str);
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

    use serde_json::json;

    use super::*;

    fn input(path: &Path, stem: &str) -> Input {
        Input { path: path.to_owned(), stem: stem.to_owned() }
    }

    #[test]
    fn files_beside_an_input_and_those_that_stages_name_are_read() {
        let folder = tempfile::tempdir().unwrap();
        let dir = folder.path();
        for name in ["a.las", "a.WDP", "b.las", "other.wdp", "model.json"] {
            fs::write(dir.join(name), "").unwrap();
        }
        let text = "[[stage]]\ntype = 'read_las'\npath = '*.las'\n[[stage]]\ntype = 'calibrate'\nload = './model.json'\n";
        let job = Job::parse("a.toml", text, &[]).unwrap();
        let inputs = [input(&dir.join("a.las"), "a"), input(&dir.join("b.las"), "b")];
        let found = of_job(&job, &json!({}), &inputs, dir);
        let expected = ["a.WDP", "a.las", "b.las", "model.json"].map(|name| dir.join(name));
        assert_eq!(found.into_iter().collect::<Vec<_>>(), expected);
    }

    #[test]
    fn a_simulated_input_is_no_file() {
        let job = Job::parse("a.toml", "[[stage]]\ntype = 'simulate'\n", &[]).unwrap();
        assert!(of_job(&job, &json!({}), &[input(Path::new(""), "out")], Path::new("/in")).is_empty());
    }

    #[test]
    fn files_of_the_geometry_are_found_by_stem_and_by_name() {
        let folder = tempfile::tempdir().unwrap();
        let dir = folder.path();
        fs::create_dir(dir.join("geoids")).unwrap();
        for name in ["a.pof", "b.pof", "geoids/EGM96.gtx", "geoids/egm2008.bin", "site.wkt"] {
            fs::write(dir.join(name), "").unwrap();
        }
        let job = Job::parse("a.toml", "[[stage]]\ntype = 'simulate'\n", &[]).unwrap();
        let inputs = [input(Path::new(""), "a"), input(Path::new(""), "b")];
        let names = |settings: Value| -> Vec<String> {
            let found = of_job(&job, &settings, &inputs, dir);
            found.iter().map(|path| path.strip_prefix(dir).unwrap().display().to_string()).collect()
        };
        let geometry = json!({"geometry": {"trajectory": "*.pof", "crs": "site.wkt", "geoid": "egm96", "geoid_dir": "geoids"}});
        assert_eq!(names(geometry), ["a.pof", "b.pof", "geoids/EGM96.gtx", "site.wkt"]);
        let geometry = json!({"geometry": {"crs": "utm:33N", "geoid": "egm96", "calibration": {"e0": 1.0}}});
        assert_eq!(names(geometry), Vec::<String>::new());
    }
}

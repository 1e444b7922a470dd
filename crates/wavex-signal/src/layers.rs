//! Test of the import directions of the crate.

use std::path::{Path, PathBuf};

/// Modules from bottom to top; modules of one row do not import each other.
const LAYERS: &[&[&str]] = &[
    &["cholesky", "flags", "levenberg_marquardt", "noise", "parallel", "range_walk"],
    &["fourier"],
    &["sensor_model", "penalised_spline", "mta", "outliers", "radiometry", "sensor_path"],
    &["whitening", "shape", "width_by_amplitude"],
    &["detect", "distributed", "pulse_fit", "false_alarms"],
    &["decompose"],
    &["calibrate", "outgoing", "fusion"],
    &["gain", "model_check"],
];

fn sources(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            sources(&path, found);
        } else {
            found.push(path);
        }
    }
}

#[test]
fn modules_import_only_modules_of_lower_layers() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let layer = |module: &str| LAYERS.iter().position(|row| row.contains(&module));
    let mut files = Vec::new();
    sources(&root, &mut files);
    let mut imports = 0;
    for file in files {
        let module = file.strip_prefix(&root).unwrap().iter().next().unwrap().to_str().unwrap();
        let module = module.trim_end_matches(".rs");
        if ["lib", "layers", "recordings", "simulated"].contains(&module) || file.ends_with("tests.rs") {
            continue;
        }
        let own = layer(module).unwrap_or_else(|| panic!("{module} has no layer"));
        let text = std::fs::read_to_string(&file).unwrap();
        // Tests inside a file may import anything.
        let code = text.split("#[cfg(test)]\nmod tests {").next().unwrap();
        let is_code = |line: &&str| !line.trim_start().starts_with("//");
        let code: Vec<&str> = code.lines().filter(is_code).collect();
        let code = code.join("\n");
        for import in code.split("crate::").skip(1) {
            let name = import.split(|c: char| !(c.is_alphanumeric() || c == '_')).next().unwrap();
            assert_ne!(name, "", "{}: one `use` per module", file.display());
            if name == module || file.components().any(|part| part.as_os_str() == "tests") {
                continue;
            }
            let other = layer(name).unwrap_or_else(|| panic!("{}: {name} has no layer", file.display()));
            assert!(other < own, "{}: {module} must not import {name}", file.display());
            imports += 1;
        }
    }
    assert!(imports > 100, "{imports}");
}

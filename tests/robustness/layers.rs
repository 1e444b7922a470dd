//! Import directions between the modules of `src`.

use std::collections::BTreeSet;
use std::path::Path;

/// Top-level modules from top to bottom; each may import those below it.
const LAYERS: [&str; 22] = [
    "main",
    "cli",
    "view",
    "cluster",
    "archive",
    "inspect",
    "explain",
    "report",
    "engine",
    "recording",
    "job",
    "registry",
    "checks",
    "stages",
    "stage",
    "georef",
    "scan_line",
    "keys",
    "system",
    "printable",
    "plausibility",
    "reason",
];

/// Top-level modules named after `crate::` in the code of a file.
fn imports(source: &str) -> BTreeSet<String> {
    let code: String =
        source.lines().map(|line| line.split("//").next().unwrap_or_default()).collect::<Vec<_>>().join("\n");
    let mut found = BTreeSet::new();
    for part in code.split("crate::").skip(1) {
        let word = |text: &str| -> String {
            text.chars().take_while(|c| c.is_alphanumeric() || *c == '_').collect()
        };
        match part.strip_prefix('{') {
            // `crate::{a::b, c}`: the first word of each entry at depth 0.
            Some(list) => {
                let mut depth = 0;
                let mut entry = String::new();
                for c in list.chars() {
                    match c {
                        '{' => depth += 1,
                        '}' if depth == 0 => break,
                        '}' => depth -= 1,
                        ',' if depth == 0 => {
                            found.insert(word(entry.trim()));
                            entry.clear();
                            continue;
                        }
                        _ => {}
                    }
                    entry.push(c);
                }
                found.insert(word(entry.trim()));
            }
            None => {
                found.insert(word(part));
            }
        }
    }
    found
}

/// Calls `visit` with each Rust file below a folder and its top-level module.
fn visit_sources(folder: &Path, module: Option<&str>, visit: &mut dyn FnMut(&str, &Path)) {
    let mut entries: Vec<_> = folder.read_dir().unwrap().map(|entry| entry.unwrap().path()).collect();
    entries.sort();
    for path in entries {
        let stem = path.file_stem().unwrap().to_string_lossy().into_owned();
        let module = module.unwrap_or(&stem);
        if path.is_dir() {
            visit_sources(&path, Some(module), visit);
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            visit(module, &path);
        }
    }
}

#[test]
fn modules_import_only_lower_layers() {
    let rank = |module: &str| LAYERS.iter().position(|layer| *layer == module);
    let mut wrong = Vec::new();
    let mut n_imports = 0;
    visit_sources(&Path::new(env!("CARGO_MANIFEST_DIR")).join("src"), None, &mut |module, path| {
        if module == "lib" {
            return;
        }
        let Some(own) = rank(module) else {
            wrong.push(format!("{}: module `{module}` is not in LAYERS", path.display()));
            return;
        };
        for imported in imports(&std::fs::read_to_string(path).unwrap()) {
            n_imports += usize::from(imported != module);
            let is_lower = rank(&imported).is_some_and(|rank| rank >= own);
            if !is_lower {
                wrong.push(format!("{}: `{module}` must not import `{imported}`", path.display()));
            }
        }
    });
    assert!(n_imports > 300, "only {n_imports} imports found");
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn imports_are_found_in_every_form() {
    let source =
        "use crate::stage::{Keys, Result};\nuse crate::{job::Job, engine::{a, b}, georef};\n// crate::cli\n";
    let expected = ["engine", "georef", "job", "stage"].map(str::to_owned);
    assert_eq!(imports(source), BTreeSet::from(expected));
}

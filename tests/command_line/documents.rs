//! Documents: commands of the tutorial, links between pages, and jobs in examples.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

use wavex::georef::GeometryKeys;
use wavex::job::JobSettings;
use wavex::registry;
use wavex_testkit::{Outcome, outcome};

/// A fenced code block of a Markdown page.
struct CodeBlock {
    language: String,
    /// The word after the language: in the tutorial, the file to save the block as.
    name: Option<String>,
    text: String,
}

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

fn read(path: &Path) -> String {
    let text = fs::read_to_string(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    text.replace("\r\n", "\n")
}

fn code_blocks(page: &str) -> Vec<CodeBlock> {
    let mut blocks: Vec<CodeBlock> = Vec::new();
    let mut is_open = false;
    for line in page.lines() {
        let trimmed = line.trim_start();
        if let Some(info) = trimmed.strip_prefix("```") {
            if !is_open {
                let mut words = info.split_whitespace().map(str::to_owned);
                let language = words.next().unwrap_or_default();
                blocks.push(CodeBlock { language, name: words.next(), text: String::new() });
            }
            is_open = !is_open;
        } else if is_open {
            let block = blocks.last_mut().unwrap();
            block.text += line;
            block.text.push('\n');
        }
    }
    assert!(!is_open, "a code block is not closed");
    blocks
}

/// The page without its code blocks.
fn prose(page: &str) -> String {
    page.split("```").step_by(2).collect()
}

/// Files below a folder whose names end in one of these, sorted.
fn files_below(folder: &Path, endings: &[&str]) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            found.extend(files_below(&path, endings));
        } else if endings.iter().any(|ending| path.to_str().unwrap().ends_with(ending)) {
            found.push(path);
        }
    }
    found.sort();
    found
}

/// Every page: those at the top and those in `docs`.
fn pages() -> Vec<PathBuf> {
    let top = ["README.md", "ARCHITECTURE.md", "CONTRIBUTING.md", "CHANGELOG.md", "SECURITY.md"];
    let mut pages: Vec<PathBuf> = top.iter().map(|name| root().join(name)).collect();
    pages.extend(files_below(&root().join("docs"), &[".md"]));
    pages
}

/// Targets of the links and pictures of a page.
fn links(page: &str) -> Vec<String> {
    let text = prose(page);
    let ends = text.match_indices("](").map(|(at, _)| at + 2);
    ends.map(|from| text[from..].split(')').next().unwrap().to_owned()).collect()
}

/// The anchors of a page's headings, as GitHub makes them.
fn anchors(page: &str) -> BTreeSet<String> {
    let headings = prose(page);
    let headings = headings.lines().filter(|line| line.starts_with('#'));
    let anchor = |line: &str| -> String {
        let title = line.trim_start_matches('#').trim().to_lowercase();
        let kept = title.chars().filter(|c| c.is_alphanumeric() || [' ', '-', '_'].contains(c));
        kept.map(|c| if c == ' ' { '-' } else { c }).collect()
    };
    headings.map(anchor).collect()
}

/// Runs one `wavex` command; what it prints.
fn wavex(arguments: &[&str], folder: &Path) -> String {
    let Outcome { code, out, err } = outcome(wavex_testkit::wavex().args(arguments).current_dir(folder));
    let printed = out + &err;
    assert_eq!(code, Some(0), "wavex {}\n{printed}", arguments.join(" "));
    printed
}

/// Each command succeeds and prints the lines that the tutorial shows; each file that it names is there.
#[test]
fn the_commands_of_the_tutorial_work() {
    let page = read(&root().join("docs/tutorial.md"));
    let temporary = tempfile::tempdir().unwrap();
    let mut folder = temporary.path().to_owned();
    let (mut printed, mut n_commands) = (String::new(), 0);
    for block in code_blocks(&page) {
        match (block.language.as_str(), &block.name) {
            ("toml", Some(name)) => fs::write(folder.join(name), &block.text).unwrap(),
            ("sh", _) => {
                for line in block.text.lines() {
                    let words: Vec<&str> = line.split_whitespace().collect();
                    match words[..] {
                        ["mkdir", name] => fs::create_dir(folder.join(name)).unwrap(),
                        ["cd", name] => folder.push(name),
                        // The program under test is the one that cargo built for this test.
                        ["cargo", "install", ..] => {}
                        ["wavex", ref arguments @ ..] => printed = wavex(arguments, &folder),
                        _ => panic!("the tutorial has a command that this test cannot run: {line}"),
                    }
                    n_commands += 1;
                }
            }
            ("text", _) => {
                for line in block.text.lines().filter(|line| !line.is_empty()) {
                    // Dots take the place of what differs from run to run.
                    let line = line.trim_end_matches("...");
                    assert!(
                        printed.contains(line),
                        "the tutorial shows\n{line}\nbut wavex printed\n{printed}"
                    );
                }
            }
            _ => {}
        }
    }
    assert!(n_commands > 10, "only {n_commands} commands were found");
    let named = prose(&page);
    let named = named.split('`').skip(1).step_by(2).filter(|word| {
        (word.starts_with("flight7") || word.starts_with("out/")) && word.contains('.') && !word.contains(' ')
    });
    for name in named {
        assert!(folder.join(name).is_file(), "the tutorial names {name}, which no command made");
    }
}

#[test]
fn links_lead_to_pages_and_headings() {
    for path in pages() {
        let page = read(&path);
        for link in links(&page).iter().filter(|link| !link.starts_with("http")) {
            let (file, anchor) = link.split_once('#').unwrap_or((link, ""));
            let target = if file.is_empty() { path.clone() } else { path.parent().unwrap().join(file) };
            assert!(target.exists(), "{}: {link} leads nowhere", path.display());
            if !anchor.is_empty() {
                let found = anchors(&read(&target));
                assert!(found.contains(anchor), "{}: {link}: no such heading in {found:?}", path.display());
            }
        }
    }
}

/// The index and the table of contents for mdBook list every page of `docs`.
#[test]
fn the_index_lists_every_document() {
    let docs = root().join("docs");
    for index in ["README.md", "SUMMARY.md"] {
        let listed: BTreeSet<String> = links(&read(&docs.join(index))).into_iter().collect();
        for path in files_below(&docs, &[".md"]) {
            let name = path.strip_prefix(&docs).unwrap().to_str().unwrap().replace('\\', "/");
            let is_index = ["README.md", "SUMMARY.md"].contains(&name.as_str());
            assert!(is_index || listed.contains(&name), "docs/{index} does not list {name}");
        }
    }
}

/// Code, tests and jobs name pages by their paths; a page that moves must move there, too.
#[test]
fn pages_that_the_code_names_exist() {
    let mut files = vec![root().join("Cargo.toml")];
    for folder in ["src", "crates", "tests", "benches", "examples", "jobs", "schemas"] {
        files.extend(files_below(&root().join(folder), &[".rs", ".toml", ".json"]));
    }
    let mut n = 0;
    for path in files.into_iter().chain(pages()) {
        let text = read(&path);
        for (at, _) in text.match_indices("docs/") {
            let is_path = |c: char| c.is_ascii_alphanumeric() || "/_-.".contains(c);
            let name: String = text[at..].chars().take_while(|c| is_path(*c)).collect();
            if let Some(end) = name.find(".md") {
                assert!(root().join(&name[..end + 3]).is_file(), "{} names {name}", path.display());
                n += 1;
            }
        }
    }
    assert!(n > 30, "only {n} mentions of pages were found");
}

/// Documents name files and folders of the sources; a file that moves must move there, too.
///
/// Names with `my_` are those of a recipe.
#[test]
fn paths_in_documents_exist() {
    let all =
        ["src", "crates", "tests", "benches", "examples", "python", "fuzz"].map(|folder| root().join(folder));
    let sources: Vec<PathBuf> = all.iter().flat_map(|folder| files_below(folder, &[".rs", ".py"])).collect();
    let mut n = 0;
    for path in pages().into_iter().filter(|path| !path.ends_with("CHANGELOG.md")) {
        let page = read(&path);
        let is_path = |c: char| c.is_ascii_alphanumeric() || "/_-.".contains(c);
        for code in prose(&page).split('`').skip(1).step_by(2) {
            if !code.contains('/') || !code.chars().all(is_path) || code.contains("my_") {
                continue;
            }
            let is_from_root = ["src/", "crates/", "tests/", "benches/", "examples/", "python/"]
                .iter()
                .any(|folder| code.starts_with(folder));
            let exists = match (is_from_root, code.ends_with(".rs")) {
                (true, _) => root().join(code).exists(),
                (false, true) => sources.iter().any(|source| source.ends_with(code)),
                (false, false) => continue,
            };
            assert!(exists, "{} names {code}, which does not exist", path.display());
            n += 1;
        }
    }
    assert!(n > 60, "only {n} paths were found");
}

/// Jobs in documents use stages and keys that exist.
#[test]
fn jobs_in_documents_have_known_stages_and_keys() {
    let mut n = 0;
    for path in pages() {
        for block in code_blocks(&read(&path)).iter().filter(|block| block.language == "toml") {
            let job: toml::Table = toml::from_str(&block.text)
                .unwrap_or_else(|error| panic!("{}: {error}\n{}", path.display(), block.text));
            let unknown = |table: &str, key: &str| panic!("{}: {table} has no key `{key}`", path.display());
            if let Some(settings) = job.get("job").and_then(toml::Value::as_table) {
                for key in settings.keys() {
                    if !JobSettings::keys().iter().any(|known| known.name == key) {
                        unknown("[job]", key);
                    }
                }
                if let Some(geometry) = settings.get("geometry").and_then(toml::Value::as_table) {
                    for key in geometry.keys() {
                        if !GeometryKeys::keys().iter().any(|known| known.name == key) {
                            unknown("[job.geometry]", key);
                        }
                    }
                }
            }
            let stages = job.get("stage").and_then(toml::Value::as_array);
            for stage in stages.into_iter().flatten() {
                let name = stage["type"].as_str().unwrap();
                let spec =
                    registry::find(name).unwrap_or_else(|| panic!("{}: no stage `{name}`", path.display()));
                for key in stage.as_table().unwrap().keys() {
                    let is_known = ["type", "id"].contains(&key.as_str())
                        || spec.keys().iter().any(|known| known.name == key);
                    if !is_known {
                        unknown(name, key);
                    }
                }
                n += 1;
            }
        }
    }
    assert!(n > 10, "only {n} stages were found in documents");
}

//! Translations of command lines, and messages for wrong lines.
//!
//! The cases are the text files in `lines`; their README explains the form.

use std::path::Path;
use wavex::registry::STAGES;

use wavex::classic::draft::Known;
use wavex::classic::{Place, import};
use wavex::job::{Job, JobStage};
use wavex::stage::Plan;
use wavex_testkit::cases::{self, Case};

use super::{files, in_version, read_with, words};

/// Files that a line may read.
const FILES: [&str; 4] = ["mnt.txt", "wavex.opt", "wavex.opt.txt", "stripalign.opt"];

/// Words of a line; quotation marks hold blanks together.
fn quoted_words(line: &str) -> Vec<String> {
    let parts = line.trim_end().split('"').enumerate();
    parts.flat_map(|(at, part)| if at % 2 == 1 { vec![part.to_owned()] } else { words(part) }).collect()
}

/// Keys of a job with their comments, each with its section, and comments above the job.
fn shown(text: &str) -> Vec<String> {
    let mut section = "";
    let mut shown = Vec::new();
    // The text begins with the line itself.
    for line in text.lines().skip(3) {
        let line = line.trim_end();
        if let Some(name) = line.strip_prefix("type = ") {
            section = name.trim_matches('"');
            shown.push(format!("[{section}]"));
        } else if line.starts_with("# ") {
            shown.push(line.to_owned());
        } else if let Some(name) = line.strip_prefix('[') {
            section = name.trim_matches(['[', ']']);
        } else if !matches!(line, "" | "#") {
            shown.push(format!("{section}.{}", words(line).join(" ")));
        }
    }
    shown
}

/// Input files of a job, as options.
fn inputs(stages: &[JobStage]) -> Vec<String> {
    let paths = stages.first().and_then(|stage| match &stage.planned.plan {
        Plan::Source(source) => source.paths(),
        _ => None,
    });
    let paths = paths.into_iter().flat_map(|paths| paths.patterns().to_vec());
    std::iter::once("-i".to_owned()).chain(paths).collect()
}

/// Difference between the job of a line and the job of its inputs alone, or the error.
///
/// Without a difference, the chain of the job.
fn translation(case: &Case) -> Result<String, String> {
    case.only(|name| name == "line" || FILES.contains(&name))?;
    let read = |path: &str| case.one(path).ok().map(str::to_owned);
    let words = quoted_words(case.one("line")?);
    let (classic, words) = match words.as_slice() {
        [option, version, line @ ..] if option == "--classic" => (Some(version.as_str()), line),
        line => (None, line),
    };
    let import = match in_version(classic, words, &Known::this_build(), &read) {
        Ok(import) => import,
        Err(problem) => return Ok(format!("error: {problem}")),
    };
    if import.text != in_version(classic, words, &Known::Everything, &read)?.text {
        return Err(format!("this build lacks something:\n{}", import.text));
    }
    let (mut usual, mut chain) = (Vec::new(), None);
    if import.has_job {
        let job = Job::parse(STAGES, "job", &import.text, &[])
            .map_err(|error| format!("{error}\n{}", import.text))?;
        usual = shown(&in_version(classic, &inputs(&job.stages), &Known::this_build(), &|_| None)?.text);
        chain = Some(format!("chain: {}", job.chain()));
    }
    let line = shown(&import.text);
    let mut all: Vec<String> = Vec::new();
    all.extend(line.iter().filter(|key| !usual.contains(key)).map(|key| format!("+ {key}")));
    all.extend(usual.iter().filter(|key| !line.contains(key)).map(|key| format!("- {key}")));
    let is_usual = all.is_empty();
    all.extend(chain.filter(|_| is_usual));
    all.extend(import.obstacles.iter().map(|obstacle| format!("obstacle: {obstacle}")));
    all.insert(0, format!("version {}", import.text.split(' ').nth(5).unwrap_or_default()));
    Ok(all.join("\n"))
}

#[test]
fn lines_get_the_expected_translations_and_messages() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/command_line/import/lines");
    cases::check(&folder, translation);
}

#[test]
fn a_job_in_another_folder_names_the_folder_of_the_line() {
    let place =
        Place { known: &Known::Everything, base: Some("/here"), read: &files, latitude: &|_, _| None };
    let import = import(&words("-i a.sdf -O out"), None, &place).unwrap();
    let keys = shown(&import.text);
    assert!(keys.iter().any(|key| key.starts_with("job.input_dir = \"/here\"")), "{keys:?}");
    assert!(keys.iter().any(|key| key.starts_with("job.output_dir = \"/here/out\"")), "{keys:?}");
}

/// A file of cases cannot hold these characters visibly.
#[test]
fn a_file_of_options_may_have_line_ends_of_windows_and_a_byte_order_mark() {
    let read = |path: &str| (path == "wavex.opt.txt").then(|| "\u{feff}# ours\ndet=5\r\n".to_owned());
    let import = read_with("-i data.sdf", &Known::Everything, &read).unwrap();
    let key = "decompose.detection_sigma = 5.0 # wavex.opt.txt: det=5";
    assert!(shown(&import.text).iter().any(|shown| shown == key), "{}", import.text);
}

#[test]
fn an_unknown_version_is_refused() {
    let problem = in_version(Some("2.0"), &words("-v"), &Known::Everything, &files).unwrap_err();
    assert_eq!(problem, "unknown version 2.0\n  = help: 1.0 or 1.1");
}

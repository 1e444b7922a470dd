//! `wavex import`: classic command lines as jobs.

mod documents;
mod examples;
mod lines;
mod runs;
mod table;
mod truth;

use wavex::classic::draft::Known;
use wavex::classic::{Import, Place, import};
use wavex::job::Job;
use wavex::registry::STAGES;

/// Words of a line without quoted blanks.
fn words(line: &str) -> Vec<String> {
    line.split_whitespace().map(str::to_owned).collect()
}

/// Files that the line may read: mounting angles.
fn files(path: &str) -> Option<String> {
    (path == "mnt.txt").then(|| "0.5 -0.25 90\n".to_owned())
}

/// Translates a line in the version implied by its input, with these files.
fn read_with(line: &str, known: &Known, read: &dyn Fn(&str) -> Option<String>) -> Result<Import, String> {
    in_version(None, &words(line), known, read)
}

/// Translates words in a version. Trajectories named `s*` start in the south; those named `u*`
/// cannot be read.
fn in_version(
    classic: Option<&str>,
    words: &[String],
    known: &Known,
    read: &dyn Fn(&str) -> Option<String>,
) -> Result<Import, String> {
    let latitude = |file: &str, _: Option<&str>| match file {
        file if file.starts_with('s') => Some(-33.0),
        file if file.starts_with('u') => None,
        _ => Some(47.0),
    };
    import(words, classic, &Place { known, base: None, read, latitude: &latitude })
}

/// Translation with all stages and keys available.
#[track_caller]
fn complete(line: &str) -> Import {
    read_with(line, &Known::Everything, &files).unwrap_or_else(|problem| panic!("{problem}"))
}

/// Translation for this build; the job must be valid.
#[track_caller]
fn here(line: &str) -> Import {
    let import = read_with(line, &Known::this_build(), &files).unwrap_or_else(|problem| panic!("{problem}"));
    if import.has_job {
        let job = Job::parse(STAGES, "job", &import.text, &[]);
        assert!(job.is_ok(), "{}\n{}", job.unwrap_err(), import.text);
    }
    import
}

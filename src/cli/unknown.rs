//! Command lines that cannot be parsed: what was meant.

use std::ffi::OsString;
use std::path::Path;

use clap::CommandFactory;
use clap::builder::StyledStr;
use clap::error::{ContextKind, ContextValue, ErrorKind};

use super::commands::Cli;
use super::explain::job_as_recording;
use wavex_formats::extensions::has_extension;
use wavex_formats::{RecordingFormat, unsupported};
use wavex_line::stage::nearest_of;
use wavex_stages::registry::{STAGES, find};

/// Names that other programs have for commands, and the commands.
const SYNONYMS: [(&[&str], &str); 8] = [
    (&["info", "inspect", "stat", "stats", "summary", "describe", "header", "lasinfo"], "scan"),
    (&["process", "exec", "execute", "pipeline", "go"], "run"),
    (&["validate", "lint", "test", "dry-run"], "check"),
    (&["show", "open", "gui", "serve", "plot", "display", "explore"], "view"),
    (&["new", "create", "template"], "init"),
    (&["list", "ls", "keys", "filters", "drivers", "options"], "stages"),
    (&["shot", "waveform"], "explain"),
    (&["version"], "--version"),
];

/// Returns the answer to a word that is no command, or a job in place of a recording; `None` if nothing better is known than clap's.
pub(super) fn not_a_command(problem: &clap::Error, arguments: &[OsString]) -> Option<String> {
    if problem.kind() == ErrorKind::MissingRequiredArgument {
        let mut words = arguments.iter().skip(1).skip_while(|word| word.to_string_lossy().starts_with('-'));
        let is_explain = words.next().is_some_and(|word| word == "explain");
        let file = words.next().filter(|_| is_explain)?;
        return job_as_recording(Path::new(file));
    }
    if problem.kind() != ErrorKind::InvalidSubcommand {
        return None;
    }
    let Some(ContextValue::String(word)) = problem.get(ContextKind::InvalidSubcommand) else { return None };
    of_path(word).or_else(|| {
        if find(word).is_some() {
            return Some(format!(
                "`{word}` is a stage of a job, not a command; `wavex stages {word}` describes it, and `wavex init \
                 RECORDING` writes a job"
            ));
        }
        let rest = arguments.iter().skip_while(|argument| *argument != word.as_str()).skip(1);
        let rest: String = rest.map(|word| format!(" {}", shell_word(&word.to_string_lossy()))).collect();
        if let Some((_, command)) = SYNONYMS.iter().find(|(names, _)| names.contains(&word.as_str())) {
            return Some(format!("there is no command `{word}`; use `wavex {command}{rest}`"));
        }
        let commands = Cli::command();
        let meant = nearest_of(word, commands.get_subcommands().map(clap::Command::get_name))?;
        Some(format!("there is no command `{word}`; did you mean `wavex {meant}{rest}`?"))
    })
}

/// The answer to a path in place of a command.
fn of_path(word: &str) -> Option<String> {
    let path = Path::new(word);
    let name = shell_word(word);
    if path.is_dir() {
        return Some(format!(
            "`{word}` is a folder, not a command; `wavex view {name}` shows the outputs of a run in it, and `wavex scan \
             '{}'` summarises recordings",
            path.join("*.las").display()
        ));
    }
    if has_extension(path, "toml") {
        return Some(format!(
            "`{word}` is a job, not a command; run it with `wavex run {name}`, or validate it first with `wavex check \
             {name}`"
        ));
    }
    if RecordingFormat::of(path).is_some() {
        let job = path.with_extension("toml");
        let job = shell_word(&job.file_name().unwrap_or_default().to_string_lossy());
        return Some(format!(
            "`{word}` is a recording, not a command; choose one:\n  \
             wavex scan {name}    summarise it\n  \
             wavex view {name}    show its points and waveforms in the browser\n  \
             wavex init --from {name} {job}    write its job, to be run with `wavex run {job}`"
        ));
    }
    unsupported(path).map(|error| error.to_string()).or_else(|| {
        path.is_file()
            .then(|| format!("`{word}` is a file, not a command; `wavex --help` lists the commands"))
    })
}

/// Adds what was meant to clap's message on an unexpected argument.
pub(super) fn explain_argument(problem: &mut clap::Error, arguments: &[OsString]) {
    let Some(ContextValue::String(argument)) = problem.get(ContextKind::InvalidArg) else { return };
    if problem.kind() != ErrorKind::UnknownArgument {
        return;
    }
    let words: Vec<String> = arguments.iter().skip(1).map(|word| word.to_string_lossy().into()).collect();
    let command = words.iter().find(|word| !word.starts_with('-'));
    // clap suggests arguments of similar spelling.
    let better = set_tip(&words).or_else(|| {
        let command = command?;
        // Its letters are nearly those of `--from-returns`.
        let dry_run = (argument == "--dry-run").then(|| tip(command, argument)).flatten();
        shot_tip(command, argument).or(dry_run)
    });
    if better.is_none() && problem.get(ContextKind::SuggestedArg).is_some() {
        return;
    }
    let is_first = words.first().is_some_and(|word| word.starts_with(argument.as_str()));
    let tip = match command {
        _ if better.is_some() => better,
        _ if is_first => Some(format!(
            "options follow the command, as in `wavex run JOB`; a command line of BayesWavEx is translated by \
             `wavex import -- {}`",
            words.join(" ")
        )),
        Some(command) => tip(command, argument),
        None => None,
    };
    if let Some(tip) = tip {
        problem.remove(ContextKind::SuggestedArg);
        problem.insert(ContextKind::Suggested, ContextValue::StyledStrs(vec![StyledStr::from(tip)]));
    }
}

/// How to write `--set KEY VALUE`, whose value became an argument.
fn set_tip(words: &[String]) -> Option<String> {
    let split = |word: &String| match word.strip_prefix("--set=") {
        Some(key) => vec!["--set".to_owned(), key.to_owned()],
        None => vec![word.clone()],
    };
    let words: Vec<String> = words.iter().flat_map(split).collect();
    words.windows(3).find_map(|window| match window {
        [set, key, value] if set == "--set" && !key.contains('=') && !value.starts_with("--") => {
            let word = shell_word(&format!("{key}={value}"));
            Some(format!("write key and value as one word: --set {word}"))
        }
        _ => None,
    })
}

/// The command that takes the number of a shot.
fn shot_tip(command: &str, argument: &str) -> Option<String> {
    let is_shot = command != "explain" && argument.split('=').next() == Some("--shot");
    is_shot.then(|| "one shot is shown by `wavex explain RECORDING --shot N`".to_owned())
}

/// What to use instead of an argument that a command does not have.
fn tip(command: &str, argument: &str) -> Option<String> {
    let name = argument.split('=').next().unwrap_or(argument);
    let key = name.trim_start_matches('-').replace('-', "_");
    let is_outputs = ["o", "out", "output", "outdir", "out_dir", "output_dir"].contains(&key.as_str());
    Some(match (command, key.as_str()) {
        ("run", _) if is_outputs => {
            "`path` of the job's writers names the outputs; for another folder: --set job.output_dir=FOLDER"
                .into()
        }
        ("convert", _) if is_outputs => "name the output second: wavex convert RECORDING OUTPUT.arrow".into(),
        ("import", _) => "put the command line after `--`: wavex import -- OPTIONS".into(),
        ("init", _) if is_outputs => "name the job second: wavex init RECORDING JOB.toml".into(),
        ("check" | "view", _) if is_outputs => format!("`wavex {command}` writes no outputs"),
        (_, "i" | "in" | "input" | "file") => {
            format!("name the file without an option: wavex {command} FILE")
        }
        ("run", "j" | "jobs" | "t" | "n" | "cores" | "nthreads" | "workers") => "use --threads N".into(),
        ("run", "dry_run") => "validate a job with `wavex check JOB`".into(),
        ("run" | "convert" | "scan", "f" | "force" | "y" | "overwrite") => {
            "leave it out: outputs of earlier runs are replaced".into()
        }
        (_, "silent") => "use --quiet".into(),
        (_, "debug" | "log_level" | "loglevel") => "use -v, or -vv for details".into(),
        ("explain", _) if name.parse::<u64>().is_ok() => format!("name the shot with --shot {name}"),
        ("run" | "check" | "view", _) if name.starts_with("--") => key_tip(&key)?,
        ("run" | "check" | "plan", _) if !name.starts_with('-') => {
            "name one job; a job reads several recordings by a pattern, as in `path = \"lines/*.las\"`".into()
        }
        ("init", _) if !name.starts_with('-') => {
            "name one recording and one job: wavex init RECORDING JOB.toml".into()
        }
        _ => return None,
    })
}

/// How to set a key of a job, if there is one of this name.
fn key_tip(name: &str) -> Option<String> {
    let key = name.rsplit('.').next().unwrap_or(name);
    match key {
        "crs" | "epsg" | "srs" | "t_srs" => {
            return Some("write --set job.geometry.crs=EPSG:25833".to_owned());
        }
        "beam" => return key_tip("beams"),
        _ => {}
    }
    let key = wavex_engine::job::key_with_table(key, STAGES)?;
    Some(format!("keys of a job are set with --set {key}=VALUE"))
}

/// A word as a shell reads it.
fn shell_word(word: &str) -> String {
    let is_plain = |letter: char| letter.is_alphanumeric() || "_-./:\\+,@%=".contains(letter);
    if !word.is_empty() && word.chars().all(is_plain) {
        return word.to_owned();
    }
    format!("'{}'", word.replace('\'', r"'\''"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    /// Error message for a command line.
    fn answer(line: &str) -> String {
        let arguments: Vec<OsString> = line.split(' ').map(OsString::from).collect();
        let mut problem = Cli::try_parse_from(&arguments).err().unwrap();
        not_a_command(&problem, &arguments).unwrap_or_else(|| {
            explain_argument(&mut problem, &arguments);
            problem.to_string()
        })
    }

    #[test]
    fn synonyms_are_no_commands_and_their_commands_exist() {
        let commands: Vec<String> =
            Cli::command().get_subcommands().map(|it| it.get_name().to_owned()).collect();
        for (names, command) in SYNONYMS {
            assert!(names.iter().all(|name| !commands.iter().any(|command| command == name)), "{names:?}");
            assert!(command.starts_with("--") || commands.iter().any(|name| name == command), "{command}");
        }
        assert_eq!(answer("wavex info x.las"), "there is no command `info`; use `wavex scan x.las`");
        assert_eq!(answer("wavex -q version"), "there is no command `version`; use `wavex --version`");
    }

    #[test]
    fn files_and_stages_get_their_commands() {
        for (line, expected) in [
            ("wavex x.pls", "`x.pls` is a recording, not a command; choose one:\n  wavex scan x.pls "),
            ("wavex x.toml", "`x.toml` is a job, not a command; run it with `wavex run x.toml`, or "),
            ("wavex x.sbet", "x.sbet: it is a trajectory, not a recording; "),
            ("wavex x.f5", "x.f5: F5, the layout of HydroVISH in HDF5, is not supported; "),
            ("wavex src", "`src` is a folder, not a command; `wavex view src` "),
            ("wavex Cargo.lock", "`Cargo.lock` is a file, not a command; "),
            ("wavex explain x.toml", "x.toml: it is a job, not a recording; give the recording, and "),
            ("wavex explain x.pls", "error: the following required arguments"),
            (
                "wavex explain x.pls --shot -1",
                "error: invalid value '-1' for '--shot <N>': give a whole number of ",
            ),
            (
                "wavex run x.toml --threads=-1",
                "error: invalid value '-1' for '--threads <N>': give a whole number ",
            ),
            ("wavex decompose", "`decompose` is a stage of a job, not a command; `wavex stages decompose` "),
        ] {
            assert!(answer(line).starts_with(expected), "{}", answer(line));
        }
        assert_eq!(answer("wavex rnu x.toml"), "there is no command `rnu`; did you mean `wavex run x.toml`?");
        assert_eq!(
            answer("wavex stage decompose"),
            "there is no command `stage`; did you mean `wavex stages decompose`?"
        );
        assert!(answer("wavex fly").starts_with("error: unrecognized subcommand 'fly'"));
    }

    #[test]
    fn options_of_other_programs_get_the_option_to_use() {
        for (line, expected) in [
            ("wavex run a.toml -o out", "--set job.output_dir=FOLDER"),
            ("wavex run a.toml --output=out", "--set job.output_dir=FOLDER"),
            ("wavex run a.toml --crs EPSG:25833", "write --set job.geometry.crs=EPSG:25833"),
            ("wavex run a.toml --beam BEAM0101", "keys of a job are set with --set read_hdf5.beams=VALUE"),
            ("wavex init a.pls -o a.toml", "name the job second: wavex init RECORDING JOB.toml"),
            ("wavex convert a.pls b.arrow -o c", "name the output second: "),
            ("wavex scan -i a.pls", "name the file without an option: wavex scan FILE"),
            ("wavex run a.toml -j 4", "use --threads N"),
            ("wavex run a.toml --dry-run", "validate a job with `wavex check JOB`"),
            ("wavex run a.toml --overwrite", "leave it out: outputs of earlier runs are replaced"),
            ("wavex run a.toml --debug", "use -v, or -vv for details"),
            ("wavex explain a.pls 5", "name the shot with --shot 5"),
            ("wavex run a.toml --detection-sigma 5", "--set decompose.detection_sigma=VALUE"),
            ("wavex run a.toml --decompose.detection_sigma=5", "--set decompose.detection_sigma=VALUE"),
            ("wavex run a.toml --boresight-deg 1", "--set job.geometry.calibration.boresight_deg=VALUE"),
            ("wavex run a.toml --memory_mb=500", "--set job.memory_mb=VALUE"),
            ("wavex import -i a.sdf", "put the command line after `--`: wavex import -- OPTIONS"),
            ("wavex run a.toml b.toml", "name one job; "),
            ("wavex check a.toml -o b", "`wavex check` writes no outputs"),
            ("wavex -i a.sdf -po a.pof", "is translated by `wavex import -- -i a.sdf -po a.pof`"),
            ("wavex scan --fsat a.pls", "a similar argument exists: '--fast'"),
            ("wavex scan a.pls --shot 5", "tip: one shot is shown by `wavex explain RECORDING --shot N`"),
            ("wavex view a.pls --shot=5", "tip: one shot is shown by `wavex explain RECORDING --shot N`"),
            (
                "wavex run a.toml --set decompose.detection_sigma 5",
                "write key and value as one word: --set decompose.detection_sigma=5",
            ),
            ("wavex run --set decompose.mode slow a.toml", "as one word: --set decompose.mode=slow"),
            ("wavex check a.toml --set=job.threads -1", "as one word: --set job.threads=-1"),
            ("wavex run a.toml --set job.threads=1 b.toml", "name one job; "),
        ] {
            assert!(answer(line).contains(expected), "{line}: {}", answer(line));
            let is_clap = expected.starts_with("a similar");
            assert_eq!(answer(line).contains("a similar argument"), is_clap, "{line}: {}", answer(line));
        }
    }

    #[test]
    fn words_are_quoted_for_the_shell() {
        let quoted = ["a/b-1.las", "my data.las", "it's"].map(shell_word);
        assert_eq!(quoted, ["a/b-1.las", "'my data.las'", r"'it'\''s'"]);
    }
}

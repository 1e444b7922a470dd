//! `docs/import.md`: all options of both versions with their translation.

use std::fmt::Write as _;

use super::options::{Becomes, Opt, Standard, Version};
use super::versions::VERSIONS;

const INTRODUCTION: &str = "\
# The classic command line

`wavex import` translates a command line of the classic program BayesWavEx into a job. It supports version 1.0 (2016,
full-waveform LAS) and version 1.1 (2018, SDF):

```sh
wavex import -- wavex -i data.sdf -po file.pof -fastest     # prints the job; the word wavex may be omitted
wavex import -o job.toml -- -i data.sdf -po file.pof        # writes the job to a new file
wavex import --run -- -i waveform.las -o points.laz         # runs the job
wavex import --classic 1.1 -- -i data.laz                   # default version: 1.0 for LAS and LAZ inputs, else 1.1
```

A comment at each key names its option. Defaults in which a version differs from wavex are written to the job. Options
without a key, options without effect in this command line, and options that run another command become comments above the
job. Options that this build does not support become comments in the job, and so do trajectory columns that do not suffice
for a pose. `--run` refuses a command line that requests either.

Options may be written `-d 6`, `-d6`, `-d=6`, `-det 6` or `-det=6`. A switch without 0 or 1 is on. If an option is repeated,
the last one counts. An ambiguous word such as `-awc10` is an error. Unknown options are errors in both versions (1.0 ignored
them). An options file in the current folder is read first, with one `name=argument` per line; the command line overrides it.
Relative paths start at the current folder, or at the folders of `-I` and `-O`. A command line has at most 1 MB.

This page is generated from the code by `cargo test --test command_line generated`.
";

/// Renders the page in Markdown.
pub fn page() -> String {
    let mut page = INTRODUCTION.to_owned();
    for version in VERSIONS {
        let files: Vec<String> = version.option_files.iter().map(|file| format!("`{file}`")).collect();
        let _ = write!(
            page,
            "\n## Version {}\n\nOptions file, the first that exists: {}.\n\n",
            version.name,
            files.join(", ")
        );
        page += "| option | argument | classic default | becomes |\n|---|---|---|---|\n";
        for option in version.options {
            let names: Vec<String> = option.names.iter().map(|name| format!("`-{name}`")).collect();
            let _ = writeln!(
                page,
                "| {} | {} | {} | {} |",
                names.join(", "),
                option.takes.shown(),
                default(option),
                becomes(option)
            );
        }
        page += &besides(version);
    }
    page
}

/// Describes keys that all jobs of a version have.
fn besides(version: &Version) -> String {
    let mut text = String::new();
    if !version.always.is_empty() {
        text += "\nAll jobs of this version also have\n\n| key | value | why |\n|---|---|---|\n";
        for (section, key, value, why) in version.always {
            let _ = writeln!(text, "| {} | `{value}` | {why} |", key_name(section, key));
        }
    }
    if version.has_stat_log {
        text += "\nAll jobs of this version also have `[job] stat_log`, named after the output, or after each input if there are \
                 several.\n";
    }
    text
}

fn default(option: &Opt) -> String {
    match option.standard {
        Standard::Same(text) => text.to_owned(),
        Standard::Written(text) => format!("**{text}**, written to the job"),
        Standard::Words(text) => text.to_owned(),
    }
}

/// Describes the translation of an option in Markdown.
pub fn becomes(option: &Opt) -> String {
    let becomes = match option.becomes {
        Becomes::Key(section, key, _) => key_name(section, key),
        Becomes::End(section, key, end, _) => {
            format!("{}, the {} number", key_name(section, key), if end == 0 { "first" } else { "second" })
        }
        Becomes::Part(_) => String::new(),
        Becomes::Flag(flag, _) => format!("`wavex run {}`", flag.text()),
        Becomes::Command(words) => format!("`{}`", words.join(" ")),
        Becomes::Nothing(why) => format!("nothing: {why}"),
    };
    let parts = [becomes.as_str(), option.remark];
    let parts: Vec<&str> = parts.into_iter().filter(|part| !part.is_empty()).collect();
    parts.join("; ")
}

/// Name of a key in the page.
fn key_name(section: &str, key: &str) -> String {
    match section {
        "job" => format!("`[job] {key}`"),
        "geometry" => format!("`[job.geometry] {key}`"),
        "reader" => format!("`{key}` of the reader"),
        stage => format!("`{key}` of `{stage}`"),
    }
}

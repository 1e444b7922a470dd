//! `docs/import.md`: every option of both versions, and what it becomes.

use std::fmt::Write as _;

use super::options::{Becomes, Opt, Standard, VERSIONS, Version};

const INTRODUCTION: &str = "\
# The classic command line

`wavex import` translates a command line of the classic program BayesWavEx, version 1.0 (2016, full-waveform LAS) or 1.1
(2018, SDF), into a job:

```sh
wavex import -- wavex -i data.sdf -po file.pof -fastest     # prints the job; the word wavex may be left out
wavex import -o job.toml -- -i data.sdf -po file.pof        # writes it into a file that does not exist yet
wavex import --run -- -i waveform.las -o points.laz         # runs it
wavex import --classic 1.1 -- -i data.laz                   # 1.0 is meant where the input is LAS or LAZ, else 1.1
```

Each key of the job says which option it comes from. Defaults in which a version differs from wavex are written out. An option
that is no key any more, has no effect in this line, or stands for a command stands as a comment above the job. What a build
cannot do yet, and columns of a trajectory that are not enough for a pose, stand in it as comments, too, and `--run` refuses a
line that asks for them.

Options may be written `-d 6`, `-d6`, `-d=6`, `-det 6`, `-det=6`; a switch without its 0 or 1 is on; of an option that stands
twice the last counts. Where a word can be read in two ways (`-awc10`), that is an error. Unknown options are errors in both
versions (1.0 passed over them). A file of options in the current folder is read first, one `name=argument` per line; the
line overrules it. A relative path starts in the current folder, or in the one of `-I` and `-O`.

This page is made from the code by `cargo test --test generated`.
";

/// The page in Markdown.
pub fn page() -> String {
    let mut page = INTRODUCTION.to_owned();
    for version in VERSIONS {
        let files: Vec<String> = version.option_files.iter().map(|file| format!("`{file}`")).collect();
        let _ = write!(
            page,
            "\n## Version {}\n\nFile of options, the first that exists: {}.\n\n",
            version.name,
            files.join(", ")
        );
        page += "| option | argument | default there | becomes |\n|---|---|---|---|\n";
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

/// What a version's jobs have without an option.
fn besides(version: &Version) -> String {
    let mut text = String::new();
    if !version.always.is_empty() {
        text += "\nBesides, jobs of this version always have\n\n| key | value | why |\n|---|---|---|\n";
        for (section, key, value, why) in version.always {
            let _ = writeln!(text, "| {} | `{value}` | {why} |", key_name(section, key));
        }
    }
    if version.has_stat_log {
        text += "\nBesides, jobs of this version always have `[job] stat_log`, named after the output, or, of several inputs, after \
                 each.\n";
    }
    text
}

fn default(option: &Opt) -> String {
    match option.standard {
        Standard::Same(text) => text.to_owned(),
        Standard::Written(text) => format!("**{text}**, written out"),
        Standard::Words(text) => text.to_owned(),
    }
}

/// What an option becomes, in Markdown.
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

/// A key as a page names it.
fn key_name(section: &str, key: &str) -> String {
    match section {
        "job" => format!("`[job] {key}`"),
        "geometry" => format!("`[job.geometry] {key}`"),
        "reader" => format!("`{key}` of the reader"),
        stage => format!("`{key}` of `{stage}`"),
    }
}

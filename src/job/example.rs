//! A commented job to start from, written from what the stages say of themselves, so that it cannot be out of date.

use super::JobSettings;
use super::manual::{first_sentence, summary, toml_text};
use crate::registry::find_in;
use crate::stage::{Keys, StageSpec};

/// The chain of the job; stages that do not exist are left out.
const CHAIN: &[&str] = &["read_las", "calibrate", "decompose", "georeference", "write_las", "write_lstat"];

/// Values for the keys that must be given, by stage and key.
const EXAMPLES: &[(&str, &str, &str)] = &[
    ("read_las", "path", "\"RECORDING.las\""),
    ("write_las", "path", "\"out/*.laz\""),
    ("write_lstat", "path", "\"out/*_lstat.txt\""),
];

const HEADING: &str = "\
#:schema job.schema.json

# A job of wavex: the stages that the data passes, in order.
#
# First name your recording: `path` of the first stage. For PulseWaves, SDF or a container put `read_pulsewaves`, `read_sdf` or
# `read_arrow` in the place of `read_las`; `wavex init --from RECORDING FILE` does so, and adds the stages that a raw recording
# needs.
#
#   wavex check FILE     checks it, and names the inputs that are missing
#   wavex run FILE       runs it
#   wavex stages NAME    explains a stage and all its keys
#
# `#key = value`, without a blank behind the `#`, is the default: take the `#` away to change it. The first line lets an editor
# check this file, where job.schema.json lies beside it: `wavex init` writes both, `wavex schema` prints it.
";

/// A job of these stages from waveforms to points, with every key that has a default.
pub fn example_job(stages: &[&'static StageSpec]) -> String {
    let mut text = format!("{HEADING}\n[job]\n{}", keys_text("job", &JobSettings::keys()));
    for spec in CHAIN.iter().filter_map(|name| find_in(stages, name)) {
        let (summary, keys) = (summary(spec), keys_text(spec.name, &spec.keys()));
        text += &format!("\n# {summary}\n[[stage]]\ntype = \"{}\"\n{keys}", spec.name);
    }
    text
}

/// The keys of a table: those that must be given with an example, the others with what counts when they are not.
fn keys_text(stage: &str, keys: &Keys) -> String {
    let mut text = String::new();
    for key in keys.iter() {
        let example = EXAMPLES.iter().find(|(of, name, _)| *of == stage && *name == key.name);
        let line = match (key.required, key.default()) {
            (true, _) => format!("{} = {}", key.name, example.map_or("\"...\"", |(_, _, value)| value)),
            (false, Some(default)) => format!("#{} = {}", key.name, toml_text(default)),
            (false, None) => continue,
        };
        text += &format!("# {}\n{line}\n", first_sentence(key.meaning()));
    }
    let unset = keys.iter().filter(|key| !key.required && key.default().is_none());
    let unset: Vec<&str> = unset.map(|key| key.name).collect();
    if !unset.is_empty() {
        text += &format!("# Not set: {}\n", unset.join(", "));
    }
    text
}

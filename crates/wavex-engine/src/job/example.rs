//! A commented starter job, generated from the stages' documentation.

use super::JobSettings;
use super::manual::{first_sentence, summary, toml_text};
use wavex_line::keys::Keys;
use wavex_line::stage::StageSpec;
use wavex_line::stage::find_in;

/// Stages of the job; unknown ones are omitted.
const CHAIN: &[&str] = &["read_las", "calibrate", "decompose", "georeference", "write_las", "write_lstat"];

/// Example values of required keys, by stage and key.
const EXAMPLES: &[(&str, &str, &str)] = &[
    ("read_las", "path", "\"RECORDING.las\""),
    ("write_las", "path", "\"out/*.laz\""),
    ("write_lstat", "path", "\"out/*_lstat.txt\""),
];

const HEADING: &str = "\
#:schema job.schema.json

# A wavex job: the stages that process the data, in order.
#
# Set `path` of the first stage to your recording. For PulseWaves, SDF or a container, replace
# `read_las` by `read_pulsewaves`, `read_sdf` or `read_arrow`. `wavex init --from RECORDING FILE` does
# this and adds the stages that a raw recording needs.
#
#   wavex check FILE     validates it and lists missing inputs
#   wavex run FILE       runs it
#   wavex stages NAME    describes a stage and all its keys
#
# `#key = value`, without a blank after the `#`, shows a default: remove the `#` to change it. The
# first line lets an editor validate this file if job.schema.json is in the same folder: `wavex init`
# writes both, `wavex schema` prints the schema.
";

/// Writes a starter job from waveforms to points, with all keys that have defaults.
pub fn example_job(stages: &[&'static StageSpec]) -> String {
    let mut text = format!("{HEADING}\n[job]\n{}", keys_text("job", &JobSettings::keys()));
    for spec in CHAIN.iter().filter_map(|name| find_in(stages, name)) {
        let (summary, keys) = (summary(spec), keys_text(spec.name, &spec.keys()));
        text += &format!("\n# {summary}\n[[stage]]\ntype = \"{}\"\n{keys}", spec.name);
    }
    text
}

/// Lists the keys of a table: required ones with an example, others with their default.
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

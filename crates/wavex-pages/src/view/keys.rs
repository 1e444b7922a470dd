//! Keys of `decompose` that the page can change.

use serde_json::{Value, json};

use wavex_engine::job::Job;
use wavex_line::keys::Keys;

/// Keys in the order of the page.
const SHOWN: [&str; 9] = [
    "detection_sigma",
    "detection_sigma_last",
    "mode",
    "split_evidence",
    "width_ratio",
    "template_error",
    "refine_when_needed",
    "drop_emission_crosstalk",
    "distributed_targets",
];

/// The keys with their values in a job; none without `decompose`.
pub(super) fn keys(job: &Job) -> Vec<Value> {
    let Some(stage) = job.stages.iter().find(|stage| stage.spec.name == "decompose") else {
        return Vec::new();
    };
    let keys: Keys = stage.spec.keys();
    let shown = SHOWN.iter().filter_map(|name| Some((keys.get(name)?, &stage.planned.resolved[*name])));
    shown
        .map(|(key, value)| {
            let choices = wavex_line::keys::choices(key.schema);
            let kind = match key.schema["type"].as_str() {
                _ if choices.is_some() => "choice",
                Some("boolean") => "flag",
                Some("number") => "number",
                // Such as a number or `false`.
                _ => "text",
            };
            let value = match kind {
                "text" => value.to_string().into(),
                _ => value.clone(),
            };
            json!({ "key": format!("decompose.{}", key.name), "label": key.name.replace('_', " "), "kind": kind,
                    "unit": key.unit().unwrap_or_default(), "value": value, "choices": choices,
                    "help": key.meaning().replace('\n', " ") })
        })
        .collect()
}

//! Compares the report of an earlier run with the next run.

use std::collections::BTreeSet;

use serde_json::Value;

use wavex_engine::engine::RunSummary;
use wavex_engine::job::Job;
use wavex_line::stage::Plan;

/// Keys of `[job]` that may differ: they do not affect outputs or reports.
const FREE_KEYS: [&str; 9] = [
    "include",
    "threads",
    "channel_capacity",
    "simd",
    "log",
    "on_error",
    "inputs_at_once",
    "model",
    "survey_model",
];

/// First difference of an earlier run that affects all inputs.
///
/// `free` are further keys of `[job]` that may differ.
pub fn difference(report: &Value, job: &Job, next: &RunSummary, free: &[&str]) -> Option<String> {
    let writes_no_file = |plan: &Plan| matches!(plan, Plan::Sink(_)) && plan.outputs().is_empty();
    if job.stages.iter().any(|stage| writes_no_file(&stage.planned.plan)) {
        return Some("an output goes to standard output".to_owned());
    }
    let next = serde_json::to_value(next).ok()?;
    for (key, made) in [("wavex", "by wavex"), ("commit", "by wavex of commit")] {
        if report[key] != next[key] {
            return Some(format!("the earlier run was made {made} {}", report[key].as_str().unwrap_or("?")));
        }
    }
    let differs = |table: &str, then: &Value, now: &Value, free: &[&str]| {
        let keys = |value: &Value| -> BTreeSet<String> {
            value.as_object().into_iter().flatten().map(|(key, _)| key.clone()).collect()
        };
        let mut keys = keys(then).into_iter().chain(keys(now));
        let key = keys.find(|key| !free.contains(&key.as_str()) && then[key] != now[key])?;
        Some(format!("`{key}` of {table} was different"))
    };
    if !are_same_models(&report["survey_models"], &next["survey_models"]) {
        return Some("the sensor models of the survey were different".to_owned());
    }
    if let Some(different) = differs("`[job]`", &report["job"], &next["job"], &[&FREE_KEYS, free].concat()) {
        return Some(different);
    }
    let stages = |report: &Value| report["stages"].as_array().cloned().unwrap_or_default();
    let (then, now) = (stages(report), stages(&next));
    let chain =
        |stages: &[Value]| -> Vec<Value> { stages.iter().map(|stage| stage["type"].clone()).collect() };
    if chain(&then) != chain(&now) {
        return Some("the stages were different".to_owned());
    }
    then.iter().zip(&now).zip(&job.stages).find_map(|((then, now), stage)| {
        // The files of a reader are compared one by one.
        let is_source = matches!(stage.planned.plan, Plan::Source(_));
        let mut free = stage.planned.local_keys.to_vec();
        free.extend(is_source.then_some("path"));
        differs(&format!("`{}`", stage.id), &then["keys"], &now["keys"], &free)
    })
}

/// Whether instruments have the same models in two runs, and each input that is in both has its own.
///
/// Another list of inputs does not change the models of a file `survey_model`.
fn are_same_models(then: &Value, now: &Value) -> bool {
    let without_inputs = |models: &Value| {
        let mut models = models.clone();
        let inputs = models.as_object_mut().and_then(|models| models.remove("inputs"));
        (models, inputs.as_ref().and_then(Value::as_array).cloned().unwrap_or_default())
    };
    let ((then, inputs_then), (now, inputs_now)) = (without_inputs(then), without_inputs(now));
    let differs = |input: &Value| inputs_now.iter().any(|now| now["stem"] == input["stem"] && now != input);
    then == now && !inputs_then.iter().any(differs)
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn models_are_compared_by_instrument_and_by_common_input() {
        let of = |noise_dn: f64, inputs: &[(&str, f64)]| {
            let inputs: Vec<Value> =
                inputs.iter().map(|(stem, own_dn)| json!({ "stem": stem, "own_dn": own_dn })).collect();
            json!({ "instruments": [noise_dn], "inputs": inputs })
        };
        let all = of(0.9, &[("a", 1.0), ("b", 2.0)]);
        assert!(are_same_models(&all, &of(0.9, &[("b", 2.0)])));
        assert!(are_same_models(&of(0.9, &[("b", 2.0)]), &all));
        assert!(!are_same_models(&all, &of(0.9, &[("b", 2.5)])));
        assert!(!are_same_models(&all, &of(0.8, &[("b", 2.0)])));
        assert!(!are_same_models(&all, &Value::Null) && are_same_models(&Value::Null, &Value::Null));
    }
}

//! Messages of plausibility checks in the report of a run.

use wavex::checks::checks;
use wavex::engine::RunSummary;

/// Messages and reasons of rejections of a run that belong to a plausibility check.
pub fn alarms(summary: &RunSummary) -> Vec<String> {
    let checks: Vec<_> = checks().into_iter().flat_map(|(_, checks)| checks).collect();
    let stages = || summary.inputs.iter().flat_map(|input| &input.stages);
    let notes = stages().flat_map(|stage| stage.warnings());
    let rejected = stages().flat_map(|stage| stage.rejected.keys().map(ToString::to_string));
    let is_of_check = |text: &String| checks.iter().any(|check| text.contains(check.message));
    notes.chain(rejected).filter(is_of_check).collect()
}

//! Rules that hold for every registered stage.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::json;
use wavex::engine::{self, InputSummary};
use wavex::job::{Job, JobStage};
use wavex::keys::{Key, choices};
use wavex::registry::{self, STAGES};
use wavex::scan_line::{Blocks, InputInfo, Kind, ScanLine};
use wavex::stage::{
    Config, Context, Item, Paths, Plan, Result, RoleName, RunContext, Source, SourceConfig, StageSpec,
};
use wavex_testkit::engine_stages::{into, stage};

/// Name suffixes that identify the unit of a quantity.
const UNITS: [&str; 17] = [
    "_m", "_ns", "_ps", "_s", "_us", "_deg", "_hz", "_mps", "_dn", "_db", "_mb", "_ppm", "_ratio", "_sigma",
    "_rate", "_step", "_per_km",
];
/// Names of quantities without a unit.
const PLAIN_NUMBERS: [&str; 9] = [
    "gain_range",
    "noise_autocorrelation",
    "split_evidence",
    "template_error",
    "detection_sigma_last",
    "odd_sample_shift",
    "decay_amplitude",
    "width_correction_low",
    "width_correction_high",
];

#[test]
fn every_stage_and_every_key_is_explained() {
    for spec in STAGES {
        let keys = spec.keys();
        assert!(keys.doc().len() > 80, "{}: its doc comment is its page in the manual", spec.name);
        for key in keys.iter() {
            assert!(key.meaning().len() > 10, "{}.{} has no description", spec.name, key.name);
        }
    }
}

#[test]
fn every_quantity_carries_its_unit_in_its_name() {
    for spec in STAGES {
        for key in spec.keys().iter() {
            let holds_numbers = key.schema.to_string().contains("\"number\"");
            let has_unit =
                UNITS.iter().any(|unit| key.name.ends_with(unit)) || PLAIN_NUMBERS.contains(&key.name);
            assert!(!holds_numbers || has_unit, "{}.{}: which unit?", spec.name, key.name);
        }
    }
}

/// Text keys that do not name a file.
const NAMES: [&str; 4] = ["stem", "gps_date", "columns", "project_id"];
/// Keys without a default that name rasters.
const RASTERS: [&str; 2] = ["surface", "canopy"];

/// Archives and locks learn about files from the stage's own declarations.
#[test]
fn every_key_that_names_a_file_is_an_input_or_an_output() {
    let takes_text = |schema: &serde_json::Value| {
        let branches = schema["anyOf"].as_array();
        let all = branches.map_or_else(|| vec![schema], |branches| branches.iter().collect());
        let is_text = |schema: &&serde_json::Value| schema["type"] == "string" && choices(schema).is_none();
        all.iter().any(is_text)
    };
    // Same extension as the default, if any: some stages require a certain extension.
    let file = |key: &Key| match key.default().and_then(serde_json::Value::as_str) {
        Some(pattern) if pattern.contains('.') => pattern.replace('*', key.name),
        _ if RASTERS.contains(&key.name) => format!("{}.tif", key.name),
        // None, or a word such as "auto".
        _ => format!("{}.csv", key.name),
    };
    let line = |key: &Key| format!("{} = '{}'\n", key.name, file(key));
    for spec in STAGES {
        let keys = spec.keys();
        let given: String = keys.iter().filter(|key| key.required).map(|key| line(&key)).collect();
        for key in keys.iter().filter(|key| takes_text(key.schema) && !NAMES.contains(&key.name)) {
            let mut table = if key.required { given.clone() } else { given.clone() + &line(&key) };
            if key.name == "save_model" {
                // A walk is saved only if it is learnt.
                table += "range_walk = 'auto'\n";
            }
            let planned = stage(spec, &table).planned;
            let is_path = match &planned.plan {
                Plan::Source(source) => {
                    source.paths().is_some_and(|paths| json!(paths) == planned.resolved[key.name])
                }
                _ => false,
            };
            let text = file(&key);
            let is_known = is_path
                || planned.inputs.contains(&text)
                || planned.plan.outputs().contains(&text.as_str())
                || planned.local_keys.contains(&key.name);
            assert!(is_known, "{}.{}: list it in `inputs`, `outputs` or `local_keys`", spec.name, key.name);
        }
    }
}

#[test]
fn names_are_verbs_and_roles_have_their_kinds() {
    let mut seen = BTreeMap::new();
    for spec in STAGES {
        assert!(seen.insert(spec.name, ()).is_none(), "{} is registered twice", spec.name);
        assert_eq!(spec.role == RoleName::Source, spec.accepts.is_empty(), "{}", spec.name);
        assert!(spec.after.iter().all(|name| registry::find(name).is_some()), "{}", spec.name);
    }
}

/// Lines of the simulator, with lines without emissions in between and one whose emissions have no
/// blocks.
#[derive(Clone, Default, Deserialize, Serialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
struct Gaps {
    /// Whether no line has shots.
    only_empty: bool,
    /// Whether blocks belong to the shots in whose records they were stored.
    unresolved: bool,
}

impl Config for Gaps {}

impl SourceConfig for Gaps {
    fn paths(&self) -> Option<&Paths> {
        None
    }

    fn make(&self, run: &RunContext) -> Result<Box<dyn Source>> {
        let keys = match self.unresolved {
            false => "lines = 4\nshots_per_line = 120\nseed = 7",
            true => UNRESOLVED,
        };
        let wavex::stage::Plan::Source(simulate) =
            stage(registry::find("simulate").unwrap(), keys).planned.plan
        else {
            unreachable!("simulate is a source")
        };
        Ok(Box::new(GapSource { lines: simulate.make(run)?, step: 0, only_empty: self.only_empty }))
    }
}

/// A recording with several pulses in the air.
const UNRESOLVED: &str = "lines = 4\nshots_per_line = 120\nseed = 7\nas_recorded = true\nmodulation_ns = 50\n\
                          pulse_rate_hz = 400000\nflying_height_m = 1500";

struct GapSource {
    lines: Box<dyn Source>,
    step: u32,
    only_empty: bool,
}

impl Source for GapSource {
    fn next(&mut self, cx: &mut Context) -> Result<Option<ScanLine>> {
        self.step += 1;
        let mut scan_line = match self.step {
            1 | 4 | 7 => Some(ScanLine::of_shots(empty_input(), 0, Vec::new(), Blocks::default())),
            5 if !self.only_empty => self.lines.next(cx)?.map(without_blocks),
            2 | 3 | 6 if !self.only_empty => self.lines.next(cx)?,
            2..=7 => return self.next(cx),
            _ => None,
        };
        scan_line.iter_mut().for_each(|scan_line| scan_line.line = self.step);
        Ok(scan_line)
    }
}

fn empty_input() -> Arc<InputInfo> {
    Arc::new(wavex_testkit::engine_stages::input_info())
}

fn without_blocks(line: ScanLine) -> ScanLine {
    ScanLine::of_shots(line.input, line.line, line.emissions, Blocks::default())
}

const GAPS: StageSpec = StageSpec::source::<Gaps>("gaps", Kind::Shots);

/// The shortest chain that ends in a stage: its required predecessors and the stage with defaults.
fn chain_to(spec: &'static StageSpec, only_empty: bool) -> Job {
    let keys = format!("only_empty = {only_empty}\nunresolved = {}", spec.name == "resolve_mta");
    let source = stage(&GAPS, &keys);
    let mut stages: Vec<JobStage> = vec![source];
    let chain = ["calibrate", "decompose", "georeference"].map(|name| registry::find(name).unwrap());
    let mut kind = Kind::Shots;
    for before in chain {
        let needed = spec.after.iter().any(|name| !stages.iter().any(|stage| stage.spec.name == *name));
        if before.name == spec.name || (spec.accepts.contains(&kind) && !needed) {
            break;
        }
        kind = before.makes.unwrap_or(kind);
        stages.push(stage(before, ""));
    }
    stages.push(stage(spec, ""));
    Job { stages, ..Job::default() }
}

fn run(job: &Job, folder: &Path) -> InputSummary {
    engine::run(job, &into(job, folder)).unwrap().inputs.remove(0)
}

#[test]
fn no_stage_drops_anything_without_a_reason() {
    // Footprints have longer waveforms than the simulator's, and patches need a trajectory: these have tests of their own.
    let own_tests = ["measure_footprints", "write_patches"];
    let is_tested = |spec: &&&StageSpec| spec.role != RoleName::Source && !own_tests.contains(&spec.name);
    for spec in STAGES.iter().filter(is_tested) {
        let folder = tempfile::tempdir().unwrap();
        let report = run(&chain_to(spec, false), folder.path());
        let stage = report.stages.last().unwrap();
        assert_eq!(stage.r#type, spec.name);
        assert!(stage.items_in.shots == 480, "{}: the lines reach it: {stage:?}", spec.name);
        assert_eq!(stage.lines_in, 7, "{}", spec.name);
        assert_eq!(stage.lines_out, stage.lines_in, "{}", spec.name);
        for item in Item::ALL {
            let made_here = item == Item::Returns && spec.name == "decompose";
            let used_up = item == Item::Blocks && spec.name == "decompose";
            if !made_here && !used_up {
                let (given, passed) =
                    (stage.items_in.of(item), stage.items_out.of(item) + stage.rejected_of(item));
                assert_eq!(given, passed, "{}: {}", spec.name, item.name());
            }
        }
        assert_eq!(report.outputs.len(), usize::from(spec.role == RoleName::Sink), "{}", spec.name);
    }
}

#[test]
fn sources_give_what_they_say_and_number_their_shots() {
    let folder = tempfile::tempdir().unwrap();
    let job = wavex_testkit::engine_stages::job(&[(
        registry::find("simulate").unwrap(),
        "lines = 2\nshots_per_line = 50",
    )]);
    let report = run(&job, folder.path());
    assert_eq!((report.stages[0].lines_out, report.stages[0].items_out.shots), (2, 100));
}

#[test]
fn lines_without_shots_pass_through_every_stage() {
    for spec in STAGES.iter().filter(|spec| spec.role != RoleName::Source) {
        let folder = tempfile::tempdir().unwrap();
        let job = chain_to(spec, true);
        let outcome = engine::run(&job, &into(&job, folder.path()));
        if job.stages.iter().any(|stage| stage.spec.name == "calibrate") {
            // Calibration without any waveform must fail with a clear error.
            let error = outcome.unwrap_err().to_string();
            assert!(
                error.contains("calibration needs 200 waveforms of the channel and there were 0"),
                "{error}"
            );
        } else {
            let report = outcome.unwrap().inputs.remove(0);
            assert_eq!(report.stages.last().unwrap().lines_out, 3, "{}", spec.name);
        }
    }
}

#[test]
fn the_counters_of_lines_obey_their_laws() {
    let folder = tempfile::tempdir().unwrap();
    let report = run(&chain_to(registry::find("write_table").unwrap(), false), folder.path());
    let total = |name: &str| report.totals[name];
    assert!(total("np") > 300, "{:?}", report.totals);
    assert_eq!(
        total("n_candidates") + total("n_added"),
        total("np") + total("np_filtered") + total("np_merged") + total("np_xtalk_dropped")
    );
    assert_eq!(report.filtered_by_reason.values().sum::<u64>(), total("np_filtered"));
    assert_eq!(total("nw"), total("nw_empty") + total("nw_deleted") + total("nw_with_points"));
}

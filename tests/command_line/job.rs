//! Valid jobs.

use proptest::prelude::*;
use serde_json::json;
use wavex::job::{Include, Job, JobSettings, Override, example_job};
use wavex_testkit::job_stages;

fn parse(text: &str, overrides: &[&str]) -> Job {
    let overrides: Vec<Override> = overrides.iter().copied().map(Override::new).collect();
    Job::parse_with(job_stages::STAGES, "job.toml", text, &[], &overrides)
        .unwrap_or_else(|errors| panic!("{errors}"))
}

const FULL: &str = r#"
[job]
threads = 2
input_dir = "raw"

[[stage]]
type = "read_las"
path = ["a.las", "b*.las"]
time_s = [1, 2.5]

[[stage]]
type = "calibrate"
waveforms = 0x1000

[[stage]]
type = "write_lstat"
path = "before_*.txt"

[[stage]]
type = "decompose"
split_evidence = false
start = 3.5

[[stage]]
type = "georeference"

[stage.mount]
forward_m = 1

[[stage.control]]
forward_m = 2

[[stage]]
type = "write_lstat"

[[stage]]
type = "write_las"
id = "points"
"#;

fn ids(job: &Job) -> Vec<&str> {
    job.stages.iter().map(|stage| stage.id.as_str()).collect()
}

#[test]
fn a_job_keeps_its_text_its_settings_and_its_stages() {
    let job = parse(FULL, &["calibrate.background=per_waveform"]);
    assert_eq!((job.name.as_str(), job.text.as_str()), ("job.toml", FULL));
    assert_eq!(job.overrides, [Override::new("calibrate.background=per_waveform")]);
    let expected = JobSettings { threads: 2, input_dir: Some("raw".into()), ..JobSettings::default() };
    assert_eq!(job.settings, expected);
    assert_eq!(
        ids(&job),
        ["read_las", "calibrate", "write_lstat-1", "decompose", "georeference", "write_lstat-2", "points"]
    );
    assert!(job.notes.is_empty(), "{:?}", job.notes);
}

#[test]
fn every_default_is_spelled_out() {
    let job = parse(FULL, &[]);
    let resolved: Vec<&serde_json::Value> = job.stages.iter().map(|stage| &stage.planned.resolved).collect();
    assert_eq!(resolved[0], &json!({ "path": ["a.las", "b*.las"], "time_s": [1.0, 2.5] }));
    assert_eq!(resolved[1], &json!({ "waveforms": 4096, "background": "auto" }));
    assert_eq!(resolved[3]["split_evidence"], json!(false));
    assert_eq!(resolved[3]["start"], json!(3.5));
    assert_eq!(
        resolved[4],
        &json!({
            "crs": "EPSG:2154",
            "mount": { "forward_m": 1.0, "right_m": 0.0 },
            "control": [{ "forward_m": 2.0, "right_m": 0.0 }],
        })
    );
}

#[test]
fn chain_shows_kinds_where_they_change() {
    let job = parse(FULL, &[]);
    assert_eq!(
        job.chain(),
        "read_las -> Shots -> calibrate -> write_lstat-1 -> decompose -> Returns -> georeference -> Points \
         -> write_lstat-2 -> points"
    );
}

#[test]
fn a_job_without_settings_has_the_defaults() {
    let job = parse("stage = [{ type = \"simulate\" }]\n", &[]);
    assert_eq!(job.settings, JobSettings::default());
    assert_eq!(job.chain(), "simulate -> Shots");
}

#[test]
fn report_page_takes_a_name_or_a_flag() {
    let stage = "[[stage]]\ntype = \"simulate\"\n";
    let page = |text: &str, set: &[&str]| parse(&format!("{text}\n{stage}"), set).settings.report_page;
    assert_eq!(page("", &[]), "");
    for (value, expected) in [("true", "*_report.html"), ("false", ""), ("'a.html'", "a.html"), ("''", "")] {
        assert_eq!(page(&format!("[job]\nreport_page = {value}"), &[]), expected);
        assert_eq!(page("", &[&format!("job.report_page={value}")]), expected);
    }
    assert_eq!(page("", &["job.report_page=a.html"]), "a.html");
}

/// Values without quotation marks are text, also in the nested table.
#[test]
fn overrides_set_keys_of_the_geometry() {
    let set = ["job.geometry.crs=EPSG:2154", "job.geometry.trajectory=*.out", "job.geometry.mount=[1, 2, 3]"];
    let keys = parse("[[stage]]\ntype = \"simulate\"\n", &set).settings.geometry;
    assert_eq!((keys.crs.as_deref(), keys.trajectory.as_deref()), (Some("EPSG:2154"), Some("*.out")));
    assert_eq!(keys.mount, Some(wavex::georef::mount::Mount::Angles([1.0, 2.0, 3.0])));
}

#[test]
fn a_job_that_writes_nothing_is_noted() {
    let job = parse("[[stage]]\ntype = \"simulate\"\n", &[]);
    assert_eq!(job.notes, ["no stage of this job writes a file: a run produces only the report"]);
}

#[test]
fn one_input_needs_no_star() {
    let job = "[[stage]]\ntype = \"read_las\"\npath = \"flight.las\"\n\n\
               [[stage]]\ntype = \"write_lstat\"\npath = \"lines.txt\"\n";
    assert_eq!(ids(&parse(job, &[])), ["read_las", "write_lstat"]);
}

#[test]
fn outputs_in_another_folder_do_not_replace_the_inputs() {
    let job = "[job]\noutput_dir = \"out\"\n\n[[stage]]\ntype = \"read_las\"\npath = [\"a.las\", \"b.las\"]\n\n\
               [[stage]]\ntype = \"write_lstat\"\npath = \"*.las\"\n";
    assert_eq!(ids(&parse(job, &[])), ["read_las", "write_lstat"]);
}

#[test]
fn a_sink_of_any_kind_keeps_the_chain_going() {
    let job = "[[stage]]\ntype = \"simulate\"\n\n[[stage]]\ntype = \"write_lstat\"\n\n\
               [[stage]]\ntype = \"write_shots\"\npath = \"*.arrow\"\n";
    assert_eq!(parse(job, &[]).chain(), "simulate -> Shots -> write_lstat -> write_shots");
}

#[test]
fn overrides_set_what_the_text_says_and_what_it_does_not() {
    let job = parse(
        FULL,
        &[
            "job.threads = 3",
            "decompose.split_evidence=12",
            "points.version=1.2",
            "points.path=out/*_a b.laz",
            "georeference.mount.right_m=4",
            "georeference.control=[]",
            "read_las.path=[\"c*.las\"]",
            "write_lstat-2.path=\"*_after.txt\"",
        ],
    );
    let resolved = |id: &str| &job.stages.iter().find(|stage| stage.id == id).unwrap().planned.resolved;
    assert_eq!(job.settings.threads, 3);
    assert_eq!(resolved("decompose")["split_evidence"], json!(12.0));
    assert_eq!(resolved("points"), &json!({ "path": "out/*_a b.laz", "version": "1.2" }));
    assert_eq!(resolved("georeference")["mount"], json!({ "forward_m": 1.0, "right_m": 4.0 }));
    assert_eq!(resolved("georeference")["control"], json!([]));
    assert_eq!(resolved("read_las")["path"], json!(["c*.las"]));
    assert_eq!(resolved("write_lstat-2")["path"], json!("*_after.txt"));
    assert_eq!(job.text, FULL, "the text is kept as written");
}

#[test]
fn the_last_of_several_overrides_counts() {
    let job = parse(FULL, &["job.threads=3", "job.threads=4"]);
    assert_eq!(job.settings.threads, 4);
}

#[test]
fn a_table_of_overrides_begins_where_there_is_none() {
    let text = FULL.replace("[stage.mount]\nforward_m = 1\n", "");
    let job = parse(&text, &["georeference.mount.forward_m=3", "georeference.mount.right_m=4"]);
    assert_eq!(job.stages[4].planned.resolved["mount"], json!({ "forward_m": 3.0, "right_m": 4.0 }));
}

#[test]
fn an_override_counts_as_if_it_stood_in_the_text() {
    proptest!(|(sigma in 1.0..100.0f64, waveforms in 200..u32::MAX)| {
        let set = [format!("decompose.detection_sigma={sigma:?}"), format!("calibrate.waveforms={waveforms}")];
        let job = parse(FULL, &[&set[0], &set[1]]);
        prop_assert_eq!(&job.stages[3].planned.resolved["detection_sigma"], &json!(sigma));
        prop_assert_eq!(&job.stages[1].planned.resolved["waveforms"], &json!(waveforms));
    });
}

#[test]
fn the_example_is_a_job_that_fits() {
    let job = parse(&example_job(job_stages::STAGES), &[]);
    let stages = ["read_las", "calibrate", "decompose", "georeference", "write_las", "write_lstat"];
    assert_eq!(ids(&job), stages);
}

/// The example with all its commented keys enabled.
fn uncommented(example: &str) -> String {
    let key = |line: &str| match line.strip_prefix('#') {
        Some(key) if key.starts_with(|first: char| first.is_ascii_lowercase()) => key.to_owned(),
        _ => line.to_owned(),
    };
    example.lines().map(|line| key(line) + "\n").collect()
}

#[test]
fn the_example_shows_the_defaults_as_they_are() {
    let example = example_job(job_stages::STAGES);
    let (short, long) = (parse(&example, &[]), parse(&uncommented(&example), &[]));
    assert_eq!(short.settings, long.settings);
    for (short, long) in short.stages.iter().zip(&long.stages) {
        assert_eq!(short.planned.resolved, long.planned.resolved, "{}", short.id);
    }
    assert_ne!(example, uncommented(&example));
}

#[test]
fn the_example_in_full() {
    let expected = r#"
[job]
# Number of worker threads of each parallel stage such as `decompose`; 0: one per core.
#threads = 0
# Memory limit of all scan lines in the pipeline, MB.
#memory_mb = 1024
# Maximum number of scan lines that wait between two stages.
#channel_capacity = 16
# SIMD instructions of the fast kernels.
#simd = "auto"
# Report of the run (JSON) in the output folder; `*` is replaced by the stem of the job file; empty: none.
#report = "*_report.json"
# Report as a page for browsers and printing (one HTML file) in the output folder: a name, or `true` for `*_report.html`; `false` or empty: none.
#report_page = ""
# Page of the survey in the output folder, for inputs that are strips of one survey: a name, or `true` for `*_survey.html`; `false` or empty: none.
#survey_page = ""
# Text statistics of each input in the output folder; `*` is replaced by the stem of the input and is required for several inputs; empty: none.
#stat_log = "*_stat.log"
# Log of the run in the output folder; `*` is replaced by the stem of the job file; empty: none.
#log = "*.log"
# What follows when an input fails: `continue` with the next one, or `stop` the run.
#on_error = "continue"
# Number of inputs that run at the same time; 0: as many as help.
#inputs_at_once = 0
# Sensor model of several inputs: common to the `survey`, from waveforms of all inputs, or from each `input` alone.
#model = "survey"
# Cells and limits of the survey's page: the table `[job.survey]`.
#survey = { cells = "", cell_m = 2.0, max_slope_deg = 10.0, max_roughness_m = 0.1, min_points = 6, max_difference_rms_m = 0.08, gap_width_m = 200.0 }
# Not set: include, input_dir, output_dir, survey_model, geometry

# Reads waveforms from LAS files.
[[stage]]
type = "read_las"
# The files to read, one run each.
path = "RECORDING.las"
# Not set: time_s

# Learns the sensor from the first waveforms.
[[stage]]
type = "calibrate"
# How many waveforms to learn from.
#waveforms = 100000
# How the background is found.
#background = "auto"

# Finds the returns in each waveform.
[[stage]]
type = "decompose"
"#;
    let example = example_job(job_stages::STAGES);
    assert!(example.contains(expected), "{example}");
}

/// Parses this text with included files.
fn with_includes(text: &str, files: &[&str], overrides: &[&str]) -> Job {
    let include = |text: &&str| Include { name: "base.toml".into(), text: (*text).to_owned() };
    let includes: Vec<Include> = files.iter().map(include).collect();
    let overrides: Vec<Override> = overrides.iter().copied().map(Override::new).collect();
    Job::parse_with(job_stages::STAGES, "job.toml", text, &includes, &overrides)
        .unwrap_or_else(|errors| panic!("{errors}"))
}

#[test]
fn included_keys_count_where_the_job_gives_none() {
    let text = "\
[job]
include = ['country.toml', 'base.toml']
threads = 2
geometry.crs = 'utm'
[[stage]]
type = 'read_las'
path = 'a.las'
[[stage]]
type = 'calibrate'
[[stage]]
type = 'write_lstat'
path = 'a.txt'
[[stage]]
type = 'write_lstat'
";
    let country = "[job]\nthreads = 9\nmemory_mb = 200\ngeometry = { trajectory = 'a.out', crs = 'ecef' }\n[write_las]\n";
    let base =
        "\u{feff}[job]\nmemory_mb = 300\n[write_lstat]\npath = 'b.txt'\n[calibrate]\nwaveforms = 700\n";
    let job = with_includes(text, &[country, base], &["job.channel_capacity=3"]);
    let settings = &job.settings;
    assert_eq!((settings.threads, settings.memory_mb, settings.channel_capacity), (2, 300, 3));
    assert_eq!(settings.geometry.crs.as_deref(), Some("utm"));
    assert_eq!(settings.geometry.trajectory.as_deref(), Some("a.out"), "tables are merged key by key");
    let path = |stage: usize| job.stages[stage].planned.resolved["path"].clone();
    assert_eq!((path(2), path(3)), (json!("a.txt"), json!("b.txt")));
    assert_eq!(job.stages[1].planned.resolved["waveforms"], json!(700));
    let job = with_includes(text, &[country, base], &["calibrate.waveforms=800"]);
    assert_eq!(job.stages[1].planned.resolved["waveforms"], json!(800), "overrides take precedence");
}

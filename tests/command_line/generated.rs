//! Files generated from the code.
//!
//! A test that finds an outdated file rewrites it and fails, so that the new file is reviewed and
//! committed.

use std::fs;
use std::path::Path;

use schemars::generate::SchemaSettings;
use wavex::archive::Archive;
use wavex::classify::ClassifyReport;
use wavex::cluster::SurveyPlan;
use wavex::georef::corrections::CorrectionsFile;
use wavex::inspect::ScanSummary;
use wavex::job::{Job, JobSettings, example_job, job_schema_text, manual};
use wavex::registry::{STAGES, find};
use wavex::report::RunReport;
use wavex::report::align::AlignReport;
use wavex::report::survey::Survey;
use wavex::scan_line::flags::NAMES;
use wavex::stage::{Reason, SurveyModels};
use wavex::stages::process::measure_footprints::FootprintModels;
use wavex::stages::writers::write_lstat;
use wavex_signal::sensor_model::SensorModel;

/// Rewrites an outdated file of the repository and reports it.
fn check(name: &str, expected: &str) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(name);
    // A checkout may use other line endings; a missing file is treated as empty.
    let found = fs::read_to_string(&path).unwrap_or_default().replace("\r\n", "\n");
    if found != expected {
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(&path, expected).unwrap();
        panic!("{name} was outdated and has been rewritten: review and commit it");
    }
}

#[test]
fn the_schema_of_jobs_is_up_to_date() {
    check("schemas/job.schema.json", &job_schema_text(STAGES));
}

#[test]
fn the_page_of_plausibility_checks_is_up_to_date() {
    check("docs/reference/checks.md", &wavex::checks::page());
}

#[test]
fn the_page_of_reasons_is_up_to_date() {
    check("docs/reference/reasons.md", &wavex::reason::page());
}

#[test]
fn reasons_name_stages_that_exist() {
    for reason in Reason::ALL {
        for stage in reason.description().stages {
            assert!(find(stage).is_some(), "{reason:?}: `{stage}`");
        }
    }
}

#[test]
fn the_schema_of_reports_is_up_to_date() {
    let settings = SchemaSettings::draft2020_12().for_serialize();
    let schema = settings.into_generator().into_root_schema_for::<RunReport>();
    check("schemas/report.schema.json", &format!("{:#}\n", schema.to_value()));
}

#[test]
fn the_schema_of_surveys_is_up_to_date() {
    let settings = SchemaSettings::draft2020_12().for_serialize();
    let schema = settings.into_generator().into_root_schema_for::<Survey>();
    check("schemas/survey.schema.json", &format!("{:#}\n", schema.to_value()));
}

#[test]
fn the_schema_of_alignments_is_up_to_date() {
    let settings = SchemaSettings::draft2020_12().for_serialize();
    let schema = settings.into_generator().into_root_schema_for::<AlignReport>();
    check("schemas/align.schema.json", &format!("{:#}\n", schema.to_value()));
}

#[test]
fn the_schema_of_classifications_is_up_to_date() {
    let settings = SchemaSettings::draft2020_12().for_serialize();
    let schema = settings.into_generator().into_root_schema_for::<ClassifyReport>();
    check("schemas/classify.schema.json", &format!("{:#}\n", schema.to_value()));
}

#[test]
fn the_schema_of_scans_is_up_to_date() {
    let settings = SchemaSettings::draft2020_12().for_serialize();
    let schema = settings.into_generator().into_root_schema_for::<ScanSummary>();
    check("schemas/scan.schema.json", &format!("{:#}\n", schema.to_value()));
}

#[test]
fn the_schema_of_archives_is_up_to_date() {
    let settings = SchemaSettings::draft2020_12();
    let schema = settings.into_generator().into_root_schema_for::<Archive>();
    check("schemas/archive.schema.json", &format!("{:#}\n", schema.to_value()));
}

#[test]
fn the_schema_of_plans_is_up_to_date() {
    let settings = SchemaSettings::draft2020_12();
    let schema = settings.into_generator().into_root_schema_for::<SurveyPlan>();
    check("schemas/plan.schema.json", &format!("{:#}\n", schema.to_value()));
}

#[test]
fn the_schema_of_sensor_models_is_up_to_date() {
    let settings = SchemaSettings::draft2020_12();
    let schema = settings.into_generator().into_root_schema_for::<SensorModel>();
    check("schemas/sensor_model.schema.json", &format!("{:#}\n", schema.to_value()));
}

#[test]
fn the_schema_of_corrections_is_up_to_date() {
    let settings = SchemaSettings::draft2020_12();
    let schema = settings.into_generator().into_root_schema_for::<CorrectionsFile>();
    check("schemas/corrections.schema.json", &format!("{:#}\n", schema.to_value()));
}

#[test]
fn the_schema_of_footprint_models_is_up_to_date() {
    let settings = SchemaSettings::draft2020_12();
    let schema = settings.into_generator().into_root_schema_for::<FootprintModels>();
    check("schemas/footprint_models.schema.json", &format!("{:#}\n", schema.to_value()));
}

#[test]
fn the_schema_of_survey_models_is_up_to_date() {
    let settings = SchemaSettings::draft2020_12();
    let schema = settings.into_generator().into_root_schema_for::<SurveyModels>();
    check("schemas/survey_models.schema.json", &format!("{:#}\n", schema.to_value()));
}

#[test]
fn the_columns_of_line_statistics_are_up_to_date() {
    check("schemas/lstat.json", &format!("{:#}\n", write_lstat::description()));
}

#[test]
fn the_manual_of_the_stages_is_up_to_date() {
    check("docs/stages.md", &manual(STAGES));
}

#[test]
fn the_page_on_returns_names_every_flag() {
    let page =
        fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/reference/returns.md")).unwrap();
    for (bit, (_, name)) in NAMES.iter().enumerate() {
        assert!(page.contains(&format!("| {bit} | {name} | ")), "bit {bit}, {name}");
    }
}

#[test]
fn every_stage_and_every_key_says_what_it_is_for() {
    for key in JobSettings::keys().iter() {
        assert_ne!(key.meaning(), "", "[job]: {}", key.name);
    }
    for spec in STAGES {
        assert_ne!(spec.keys().doc(), "", "{}", spec.name);
        for key in spec.keys().iter() {
            assert_ne!(key.meaning(), "", "{}: {}", spec.name, key.name);
            assert!(!["type", "id"].contains(&key.name), "{}: `{}` is taken", spec.name, key.name);
        }
    }
}

#[test]
fn names_of_stages_are_unique_and_those_they_need_exist() {
    for (at, spec) in STAGES.iter().enumerate() {
        assert!(STAGES[..at].iter().all(|other| other.name != spec.name), "{} is listed twice", spec.name);
        assert_ne!(spec.name, "job", "`--set job.KEY` means the table [job]");
        for needed in spec.after {
            assert!(find(needed).is_some(), "{} needs `{needed}`, which does not exist", spec.name);
        }
    }
}

#[test]
fn the_job_that_init_writes_fits_as_soon_as_its_stages_exist() {
    let example = example_job(STAGES);
    let needed = ["read_las", "calibrate", "decompose", "georeference", "write_las"];
    let complete = needed.iter().all(|name| find(name).is_some());
    let parsed = Job::parse(STAGES, "example", &example, &[]);
    assert!(parsed.is_ok() || !complete, "{}", parsed.unwrap_err());
}

#[test]
fn the_page_on_the_classic_command_line_is_up_to_date() {
    check("docs/import.md", &wavex::classic::page());
}

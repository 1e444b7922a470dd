//! Texts: jobs, classic command lines, reports, plans, tables, calibrations, corrections and sensor models.

use std::fs;
use std::path::Path;
use std::sync::LazyLock;

use wavex::classic::draft::Known;
use wavex::classic::{Place, import as import_line};
use wavex::cluster::SurveyPlan;
use wavex::georef::calibration::read_calibration;
use wavex::georef::corrections::CorrectionsFile;
use wavex::job::{Include, Job, Override, included};
use wavex::registry::STAGES;
use wavex::report::{read_report, write_page_of};
use wavex::stages::process::calibrate::{model_json, parse_model};
use wavex_formats::lookup_tables::LookupTables;
use wavex_geodesy::time_axis::{Clock, TimeSpan};

use super::{Files, parts};

/// Markup that no page may contain unescaped.
pub const MARKUP: &str = "<wavex-markup>";

/// A job, a file that it includes, and overrides, one per line.
pub fn job(bytes: &[u8]) {
    let parts = parts(bytes);
    let text = |k: usize| parts.get(k).map(|bytes| String::from_utf8_lossy(bytes).into_owned());
    let job = text(0).unwrap_or_default();
    let _ = included(&job);
    let includes: Vec<Include> =
        text(1).into_iter().map(|text| Include { name: "included.toml".into(), text }).collect();
    let overrides: Vec<Override> =
        text(2).iter().flat_map(|text| text.lines()).take(20).map(Override::new).collect();
    let read = || Job::parse_with(STAGES, "job.toml", &job, &includes, &overrides);
    match read() {
        Ok(job) => {
            let again = read().unwrap();
            assert_eq!(format!("{:?}", job.settings), format!("{:?}", again.settings));
            assert!(job.chain().len() < 100 * (1 + job.stages.len()) + job.text.len());
            assert!(!job.stem().is_empty());
        }
        Err(errors) => {
            assert!(!errors.errors().is_empty());
            for error in errors.errors() {
                if let Some((_, line, column)) = errors.position(error) {
                    assert!(line > 0 && column > 0);
                }
            }
            let text = errors.render(false);
            let is_clean = |letter: char| letter == '\n' || !letter.is_control();
            assert!(text.chars().all(is_clean), "control characters in {text:?}");
            assert!(!errors.render(true).is_empty());
        }
    }
}

/// Words of a classic command line, one per line, and the file of options as second part.
///
/// The job that is made of them is valid.
pub fn import(bytes: &[u8]) {
    static KNOWN: LazyLock<Known> = LazyLock::new(Known::this_build);
    let parts = parts(bytes);
    let text = |k: usize| parts.get(k).map(|bytes| String::from_utf8_lossy(bytes).into_owned());
    let words: Vec<String> = text(0).unwrap_or_default().lines().map(str::to_owned).collect();
    let read = |_: &str| text(1);
    let latitude = |_: &str, _: Option<&str>| Some(48.0);
    for (classic, base) in [(None, None), (Some("1.0"), Some("/data")), (Some("1.1"), None)] {
        let place = Place { known: &KNOWN, base, read: &read, latitude: &latitude };
        let Ok(import) = import_line(&words, classic, &place) else { continue };
        if import.has_job
            && let Err(errors) = Job::parse(STAGES, "the job of this line", &import.text, &[])
        {
            panic!("{errors}\n{}", import.text);
        }
    }
}

/// A report of a run, of which the page is made.
pub fn report(bytes: &[u8]) {
    let place = Files::with(&[("job_report.json", bytes)]);
    let page = place.path("page.html");
    let report = place.path("job_report.json");
    if read_report(&report).and_then(|stored| write_page_of(&report, &stored, &page)).is_ok() {
        let html = fs::read_to_string(&page).unwrap();
        assert!(!html.contains(MARKUP), "unescaped text in the page");
        assert!(html.len() < 1_000_000 + 1000 * bytes.len(), "a page of {} bytes", html.len());
    } else {
        assert!(!page.exists());
    }
}

/// The plan of a survey.
pub fn plan(bytes: &[u8]) {
    let place = Files::with(&[("plan.json", bytes)]);
    let Ok(plan) = SurveyPlan::read(&place.path("")) else { return };
    let text = serde_json::to_vec(&plan).unwrap();
    place.write("plan.json", &text);
    let again = SurveyPlan::read(&place.path("")).unwrap();
    assert_eq!(serde_json::to_vec(&again).unwrap(), text);
}

/// Lookup tables of receivers.
pub fn lookup_tables(bytes: &[u8]) {
    let place = Files::with(&[("a.txt", bytes)]);
    let Ok(tables) = LookupTables::open(&place.path("a.txt")) else { return };
    for rows in [&tables.low, &tables.high] {
        assert!(rows.len() != 1);
        assert!(rows.iter().all(|row| row.steps_dn.is_finite() && row.value.is_finite() && row.weight > 0.0));
    }
}

/// A calibration, as TOML and as numbers.
pub fn calibration(bytes: &[u8]) {
    for name in ["a.toml", "a.txt"] {
        let place = Files::with(&[(name, bytes)]);
        let Ok(calibration) = read_calibration(&place.path(name)) else { continue };
        assert!(calibration.lever_arm_m.iter().chain(&calibration.boresight_deg).all(|v| v.is_finite()));
        let _ = (calibration.range_m(1000.0, true), calibration.angle_correction_rad(0.3));
        let _ = calibration.keeps_angles();
    }
}

/// A correction file; it is the same after writing.
pub fn corrections(bytes: &[u8]) {
    let Ok(file) = CorrectionsFile::parse(&String::from_utf8_lossy(bytes)) else { return };
    let text = file.to_text().unwrap();
    assert_eq!(CorrectionsFile::parse(&text).as_ref(), Ok(&file));
    for strip in &file.strips {
        let corrections = strip.corrections().unwrap();
        let times_s = strip.knots.iter().map(|knot| knot.time_s).chain([strip.first_s, strip.last_s]);
        for offset in times_s.map(|time_s| corrections.at(time_s)) {
            let values = offset.north_east_down_m.into_iter().chain(offset.roll_pitch_heading_rad);
            assert!(values.into_iter().all(f64::is_finite));
        }
    }
    let week = TimeSpan { clock: Clock::Week, first_s: 0.0, last_s: 600_000.0 };
    if let Ok(joined) = file.on_trajectory(None, week) {
        assert!(!joined.knots().is_empty());
    }
}

/// A sensor model; it is the same after writing.
pub fn sensor_model(bytes: &[u8]) {
    let path = Path::new("model.json");
    let Ok(model) = parse_model(&String::from_utf8_lossy(bytes), path) else { return };
    let text = model_json(&model).unwrap();
    let again = parse_model(&text, path).unwrap();
    assert_eq!(model_json(&again).unwrap(), text);
}

//! Runs of the program's stages on recordings in memory.

use std::path::Path;

use wavex::engine::InputSummary;
use wavex::stages::process::calibrate::{model_json, parse_model};
use wavex_formats::container::{ContainerHeader, EmissionReference};
use wavex_signal::sensor_model::SensorModel;
use wavex_testkit::container::{Row, container, nadir_shot};
use wavex_testkit::recordings::{Table, run};

use super::instruments::{Instrument, Recording, Shot};

/// Codes of the low-power receiver and of the outgoing pulse in a container.
const LOW_POWER: u8 = 1;
const REFERENCE: u8 = 3;
/// Change of the time of flight from shot to shot, ns.
const SLOPE_NS: f64 = 0.01;
/// Time of the first sample after the emission, ns, and time between shots, ps.
const START_NS: f64 = 5000.0;
const SHOT_PS: i64 = 10_000_000;

/// A run.
pub struct Case {
    /// Model to load; `None`: calibrated.
    pub model: Option<SensorModel>,
    pub recording: Recording,
}

/// Model that is calibrated from a recording of an instrument.
pub fn saved_model(instrument: Instrument, place: &Path) -> SensorModel {
    run_job(&instrument.record(), "save = 'model.json'", place);
    let path = place.join("model.json");
    parse_model(&std::fs::read_to_string(&path).unwrap(), &path).unwrap()
}

/// Warnings of a run.
pub fn warnings(case: &Case, place: &Path) -> Vec<String> {
    summary(case, place).stages.iter().flat_map(|stage| stage.notes.clone()).collect()
}

/// Summary of a run.
pub fn summary(case: &Case, place: &Path) -> InputSummary {
    match &case.model {
        None => run_job(&case.recording, "", place),
        Some(model) => {
            let path = place.join("loaded.json");
            std::fs::write(&path, model_json(model).unwrap()).unwrap();
            run_job(&case.recording, &format!("load = '{}'", path.display()), place)
        }
    }
}

/// Calibrates and decomposes a recording.
pub fn run_job(recording: &Recording, calibrate: &str, place: &Path) -> InputSummary {
    write(recording, place);
    let rest = "mode = 'fastest'\n[[stage]]\ntype = 'write_lstat'\npath = '*_lines.csv'\n";
    run("sabotage", &chain(calibrate, rest), place, place, &[])
}

/// A job whose keys of `calibrate`, and whose end from the keys of `decompose` on, are these.
fn chain(calibrate: &str, rest: &str) -> String {
    format!(
        "[job]\nthreads = 1\noutput_dir = '.'\n[[stage]]\ntype = 'read_arrow'\npath = 'a.arrow'\n[[stage]]\n\
         type = 'calibrate'\n{calibrate}\n[[stage]]\ntype = 'decompose'\n{rest}"
    )
}

/// Returns of a recording by a job of default settings: number of the shot, and time of flight, ns.
pub fn returns(recording: &Recording, place: &Path) -> Vec<(usize, f64)> {
    write(recording, place);
    let rest = "[[stage]]\ntype = 'write_table'\npath = '*_returns.csv'\n";
    run("returns", &chain("", rest), place, place, &[]);
    let table = Table::read(&place.join("a_returns.csv"));
    let shots = table.column("shot").into_iter().map(|shot| shot as usize);
    shots.zip(table.column("time_of_flight_ns")).collect()
}

/// Time of flight at the first sample of a block, ns.
pub fn start_ns(number: u64, shot: &Shot) -> f64 {
    // Gently sloping ground.
    START_NS + SLOPE_NS * number as f64 - shot.main_position()
}

/// Writes the container of a recording.
fn write(recording: &Recording, place: &Path) {
    let timing = recording.timing;
    let header = ContainerHeader {
        full_scale_dn: Some(recording.full_scale_dn),
        emission_reference: Some(timing.map_or(EmissionReference::Clock, |timing| timing.emission_reference)),
        ..ContainerHeader::new(1.0, 299_707_502.0)
    };
    let mut number = 0;
    let mut row = |line: usize, of: &Shot| {
        let mut shot = nadir_shot(number, number as i64 * SHOT_PS);
        shot.line = line as u32;
        let mut blocks = vec![(LOW_POWER, START_NS, of.samples.clone())];
        if let Some(timing) = timing {
            let late = if number.is_multiple_of(10) { timing.late_samples } else { 0.0 };
            blocks[0].1 = start_ns(number, of) + of.emission + late;
            blocks.insert(0, (REFERENCE, 0.0, of.outgoing.clone()));
        }
        number += 1;
        Row { shot, blocks }
    };
    let lines: Vec<Vec<Row>> = (recording.lines.iter().enumerate())
        .map(|(line, shots)| shots.iter().map(|shot| row(line, shot)).collect())
        .collect();
    std::fs::write(place.join("a.arrow"), container(&header, &lines)).unwrap();
}

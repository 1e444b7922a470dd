//! A scene through the whole chain with both readers, compared with the truth.

use std::collections::BTreeMap;
use std::path::Path;
use wavex::registry::STAGES;

use wavex::engine::{self, Options};
use wavex::job::{Job, Override};

use crate::sdf::stand_in;

use super::recording::{NAME, Truth};

/// Tolerance for matching a return to a true one, m.
const NEAR_M: f64 = 0.15;

/// Runs the recording in `folder` with `read_arrow`, and with `read_sdf` and the stand-in.
///
/// Outputs go to folders named after the readers. `calibrate` is a list of keys.
pub fn run(folder: &Path, calibrate: &str) {
    let library = Override::new(format!("read_sdf.library='{}'", stand_in().display()));
    for (reader, set) in [("read_arrow", vec![]), ("read_sdf", vec![library])] {
        let job = Job::parse(STAGES, "job.toml", &job(reader, calibrate), &set).expect("a job");
        engine::run(&job, &Options::of_job(&job, folder, folder.join(reader))).expect("a run");
    }
}

fn job(reader: &str, calibrate: &str) -> String {
    format!(
        "[job]\nmemory_mb = 4096\n[job.geometry]\ntrajectory = 'flight.sbet'\ncrs = 'ecef'\n\
         [[stage]]\ntype = '{reader}'\npath = '{NAME}'\n\
         [[stage]]\ntype = 'resolve_mta'\n\
         [[stage]]\ntype = 'calibrate'\n{calibrate}\n\
         [[stage]]\ntype = 'decompose'\nmode = 'fastest'\n\
         [[stage]]\ntype = 'georeference'\n\
         [[stage]]\ntype = 'write_table'\npath = 'points.csv'\n"
    )
}

/// Returns whether both tables are identical, and compares their points with the truth.
pub fn compare(folder: &Path, truth: &[Truth]) -> (bool, Score) {
    let [arrow, sdf] = ["read_arrow", "read_sdf"]
        .map(|door| std::fs::read_to_string(folder.join(door).join("points.csv")).expect("a table"));
    (arrow == sdf, Score::of(truth, &arrow))
}

/// Detection statistics of the true echoes.
#[derive(Debug, Default)]
pub struct Score {
    /// Number of true echoes.
    pub echoes: usize,
    /// Echoes found with correct shot, zone and range.
    pub right: usize,
    /// Absolute range errors, m, ascending.
    pub range_errors_m: Vec<f64>,
    /// Distances of points from the truth, m, ascending.
    pub distances_m: Vec<f64>,
    /// Largest difference between the distance of a point and its range error, m.
    pub worst_beyond_range_m: f64,
    /// Largest number of pulses in the air.
    pub zone_most: u64,
}

/// Point of the table.
struct Point {
    zone: u64,
    range_m: f64,
    ecef_m: [f64; 3],
}

impl std::fmt::Display for Score {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let [middle, most] = [50, 99].map(|percent| 1e3 * quantile(&self.range_errors_m, percent));
        let points = [50, 99].map(|percent| 1e3 * quantile(&self.distances_m, percent));
        write!(
            f,
            "{} of {} right, up to zone {}; range error median {middle:.1} mm, 99 % {most:.1} mm; \
             point error {:.1} and {:.1} mm",
            self.right, self.echoes, self.zone_most, points[0], points[1]
        )
    }
}

impl Score {
    fn of(truth: &[Truth], table: &str) -> Score {
        let points = points(table);
        let mut score = Score { echoes: truth.len(), ..Score::default() };
        for truth in truth {
            let off = |point: &&Point| (point.range_m - truth.range_m).abs();
            let here = points.get(&truth.shot).into_iter().flatten();
            let nearest = here.min_by(|a, b| off(a).total_cmp(&off(b)));
            if let Some(point) = nearest.filter(|point| off(point) <= NEAR_M && point.zone == truth.zone) {
                let squares = point.ecef_m.iter().zip(truth.ecef_m).map(|(a, b)| (a - b).powi(2));
                let distance_m = squares.sum::<f64>().sqrt();
                score.right += 1;
                score.zone_most = score.zone_most.max(truth.zone);
                score.range_errors_m.push(off(&point));
                score.distances_m.push(distance_m);
                score.worst_beyond_range_m = score.worst_beyond_range_m.max((distance_m - off(&point)).abs());
            }
        }
        score.range_errors_m.sort_by(f64::total_cmp);
        score.distances_m.sort_by(f64::total_cmp);
        score
    }
}

fn points(table: &str) -> BTreeMap<u64, Vec<Point>> {
    let mut rows = table.lines().map(|row| row.split(',').collect::<Vec<_>>());
    let names = rows.next().expect("a line of names");
    let column = |name: &str| names.iter().position(|other| *other == name).expect("a column");
    let [shot, zone, range] = ["shot", "mta_zone", "range_m"].map(column);
    let place = ["x", "y", "z"].map(column);
    let mut points: BTreeMap<u64, Vec<Point>> = BTreeMap::new();
    for row in rows {
        let number = |at: usize| row.get(at).and_then(|cell| cell.parse().ok()).unwrap_or(f64::NAN);
        let point = Point { zone: number(zone) as u64, range_m: number(range), ecef_m: place.map(number) };
        points.entry(number(shot) as u64).or_default().push(point);
    }
    points
}

/// Returns a percentile of ascending values.
pub fn quantile(values: &[f64], percent: usize) -> f64 {
    values.get(values.len() * percent / 100).or(values.last()).copied().unwrap_or(f64::NAN)
}

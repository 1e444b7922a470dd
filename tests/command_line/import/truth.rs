//! Points of a LAS file against the simulated truth.

use std::collections::BTreeMap;
use std::io::Cursor;
use std::path::Path;

use wavex_formats::container::ContainerReader;
use wavex_formats::las::RawPoints;

use wavex_testkit::{TestFolder, shots};

/// Time tolerance of one pulse, s; the shortest pulse interval exceeds three of these.
const SAME_PULSE_S: f64 = 1e-6;
/// Maximum distance of a point from a return of its pulse, m; a wrong zone causes 500 m at 300 kHz.
const MATCH_M: f64 = 0.3;

/// A true return in the coordinates of the output.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Truth {
    /// Time of its pulse in the output.
    pub(crate) time_s: f64,
    /// Position, m.
    pub(crate) place: [f64; 3],
    zone: u16,
    intensity: f64,
}

/// Compared attributes of a point.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Point {
    place: [f64; 3],
    time_s: f64,
    intensity: f64,
    source_id: u16,
}

/// Returns of a flight 1000 m above level ground, in map coordinates or in the frame of the
/// scanner.
///
/// Intensities refer to 1000 m and, in the map, to normal incidence.
pub(crate) fn of_flight(csv: &str, recording: &[u8], in_scanner: bool) -> Vec<Truth> {
    let file = Box::new(Cursor::new(recording.to_vec()));
    let mut reader = ContainerReader::from_stream(Path::new("data.arrow"), file).unwrap();
    let mut shots = BTreeMap::new();
    while let Some(line) = reader.next_line().unwrap() {
        shots.extend((0..line.rows()).map(|row| (line.shot(row).shot, line.shot(row))));
    }
    let truth = |row: &str| {
        let fields: Vec<&str> = row.split(',').collect();
        let number = |column: usize| fields[column].parse::<f64>().unwrap();
        let (shot, range_m, amplitude_dn) = (shots[&fields[0].parse().unwrap()], number(5), number(6));
        let place = match in_scanner {
            true => shot.direction.map(|part| part * range_m),
            false => [number(8), number(9), number(10)],
        };
        let cosine = if in_scanner { 1.0 } else { 1000.0 / range_m };
        let intensity = amplitude_dn * (range_m / 1000.0).powi(2) / cosine;
        Truth { time_s: shot.gps_time_s.unwrap(), place, zone: number(11) as u16, intensity }
    };
    csv.lines().skip(1).map(truth).collect()
}

/// Returns of pulses at nadir, 0.1 m apart and 60 DN high.
///
/// They are at the height of the recording's own points, or at the start of the waveforms.
pub(crate) fn of_pulses(pulses: usize) -> Vec<Truth> {
    let truth = |pulse: usize| {
        let place = [0.1 * pulse as f64, 0.0, 0.0];
        Truth { time_s: shots::time_s(pulse), place, zone: 0, intensity: 60.0 }
    };
    (0..pulses).map(truth).collect()
}

/// Points of a LAS or LAZ file of format 1 or 6.
pub(crate) fn points(place: &TestFolder, file: &str) -> Vec<Point> {
    let mut reader = RawPoints::open(&place.path(file)).unwrap();
    let header = reader.header().clone();
    let source_at = if header.point_format == 1 { 18 } else { 20 };
    let mut points = Vec::new();
    while let Some(record) = reader.next_record().unwrap() {
        let u16_at = |at: usize| u16::from_le_bytes(record[at..at + 2].try_into().unwrap());
        let coordinate = |axis: usize| {
            let steps = i32::from_le_bytes(record[4 * axis..4 * axis + 4].try_into().unwrap());
            f64::from(steps) * header.scale[axis] + header.offset[axis]
        };
        points.push(Point {
            place: [0, 1, 2].map(coordinate),
            time_s: f64::from_le_bytes(record[source_at + 2..source_at + 10].try_into().unwrap()),
            intensity: u16_at(12).into(),
            source_id: u16_at(source_at),
        });
    }
    points
}

/// Asserts that each point is a true return of its pulse, and nearly each true return is a point.
///
/// `in_map` converts coordinates to those of the truth. Noise causes range SDs of 3 to 4 mm and
/// intensity SDs of 1 to 1.5 %; coordinates are rounded to 1 mm or less. For 99 % of the points,
/// errors must stay below twice (three SDs plus rounding); single errors below 3 cm and 10 %.
#[track_caller]
pub(crate) fn agrees_with_truth(
    name: &str,
    points: &[Point],
    truth: &[Truth],
    in_map: impl Fn([f64; 3]) -> [f64; 3],
) {
    let (mut errors_m, mut ratios) = (Vec::new(), Vec::new());
    let mut is_found = vec![false; truth.len()];
    for point in points {
        let [x, y, z] = in_map(point.place);
        let distance_m = |truth: &Truth| {
            let [true_x, true_y, true_z] = truth.place;
            (x - true_x).hypot(y - true_y).hypot(z - true_z)
        };
        let of_pulse =
            truth.iter().enumerate().filter(|(_, t)| (t.time_s - point.time_s).abs() < SAME_PULSE_S);
        let distances = of_pulse.map(|(k, truth)| (distance_m(truth), k));
        let nearest = distances.min_by(|a, b| a.0.total_cmp(&b.0));
        let Some((error_m, k)) = nearest.filter(|(error_m, _)| *error_m < MATCH_M) else {
            panic!("{name}: {point:?} is no true return of its pulse: {nearest:?}");
        };
        assert_eq!(point.source_id, truth[k].zone, "{name}: zone of {point:?}");
        is_found[k] = true;
        errors_m.push(error_m);
        ratios.push(point.intensity / truth[k].intensity);
    }
    let found = is_found.iter().filter(|is_found| **is_found).count();
    assert!(found * 100 >= truth.len() * 99, "{name}: {found} of {} true returns", truth.len());
    let error_m = |share: f64| quantile(&errors_m, share);
    assert!(
        error_m(0.5) <= 0.005 && error_m(0.99) <= 0.02 && error_m(1.0) <= 0.03,
        "{name}: errors of {} m (median), {} m (99 %), {} m (most)",
        error_m(0.5),
        error_m(0.99),
        error_m(1.0)
    );
    let [least, median, most] = [0.0, 0.5, 1.0].map(|share| quantile(&ratios, share));
    assert!(
        (median - 1.0).abs() <= 0.01 && least >= 0.9 && most <= 1.1,
        "{name}: intensities of {least}, {median} (median), {most} over the true ones"
    );
}

fn quantile(values: &[f64], share: f64) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted[((sorted.len() - 1) as f64 * share).round() as usize]
}

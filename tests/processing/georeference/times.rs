//! Times of recording and trajectory: week rollover, disjoint ranges, and shots without times.

use wavex::stage::{Item, Reason};
use wavex_formats::trajectory::sbet::{RECORD_BYTES, SbetRecord};

use super::flights::QUIET;
use wavex_testkit::georeferenced_flight::{Flight, Placed, distance_m, fly};

const SWAYING: &str = "roll_deg = 10.0\npitch_deg = 8.0\nmotion_period_s = 4.0\n";
/// Half of this flight's 0.36 s is after the end of the week.
const LAST_OF_WEEK: &str = "start_time_s = 604799.8\n";

fn worst_m(flight: &Flight, placed: &Placed) -> f64 {
    assert_eq!(placed.points.len(), flight.truth.len());
    let off = flight.truth.iter().zip(&placed.points).map(|(truth, point)| distance_m(truth.point_m, *point));
    off.fold(0.0, f64::max)
}

/// Modifies the records of the trajectory.
fn rewrite(flight: &Flight, change: impl Fn(SbetRecord) -> Option<SbetRecord>) {
    let bytes = std::fs::read(flight.path("a.out")).unwrap();
    let (records, rest) = bytes.as_chunks::<RECORD_BYTES>();
    assert!(rest.is_empty());
    let changed: Vec<u8> = records
        .iter()
        .map(SbetRecord::decode)
        .filter_map(change)
        .flat_map(|record| record.encode())
        .collect();
    std::fs::write(flight.path("a.out"), changed).unwrap();
}

#[track_caller]
fn placed(flight: &Flight) -> Placed {
    flight.place("trajectory = '*.out'", |truth| truth.range_m).unwrap()
}

/// Both clocks continue past the rollover, as in POSPac and `read_sdf`.
#[test]
fn across_the_end_of_the_week() {
    let flight = fly(&format!("{QUIET}{SWAYING}{LAST_OF_WEEK}"));
    let placed = placed(&flight);
    assert!(worst_m(&flight, &placed) < 1e-3);
    let times: Vec<f64> = placed.stats.iter().map(|stats| stats.gps_time_s).collect();
    assert!(times[0] < 604_800.0 && times.is_sorted() && *times.last().unwrap() > 604_800.1, "{times:?}");
}

/// The trajectory restarts with the week, or counts from an earlier week or day.
#[test]
fn trajectories_that_count_in_another_way() {
    type Count = fn(f64) -> f64;
    let counts: [(&str, &str, Count); 3] = [
        ("begins anew", "", |time_s| time_s.rem_euclid(604_800.0)),
        ("a week later", "", |time_s| time_s - 604_800.0),
        ("of the day", "trajectory_time = 'day'", |time_s| time_s.rem_euclid(86_400.0)),
    ];
    for (what, key, count) in counts {
        let flight = fly(&format!("{QUIET}{SWAYING}{LAST_OF_WEEK}"));
        rewrite(&flight, |record| Some(SbetRecord { time_s: count(record.time_s), ..record }));
        let placed = flight.place(&format!("trajectory = '*.out'\n{key}"), |truth| truth.range_m).unwrap();
        let worst_m = worst_m(&flight, &placed);
        println!("{what}: the farthest {:.4} mm off", 1e3 * worst_m);
        assert!(worst_m < 1e-3, "{what}: {worst_m}");
    }
}

#[test]
fn a_trajectory_of_another_flight_is_refused() {
    let refused = |later_s: f64| {
        let flight = fly(QUIET);
        rewrite(&flight, |record| Some(SbetRecord { time_s: record.time_s + later_s, ..record }));
        flight.place("trajectory = '*.out'", |truth| truth.range_m).err().unwrap()
    };
    assert_eq!(
        refused(3600.0),
        "the recording and the trajectory have no time in common: the recording lasts from Tuesday \
         10:00:00.0 to 10:00:00.4 GPS (208800.0 to 208800.4 s of the week), the trajectory from Tuesday \
         10:59:59.0 to 11:00:01.4 GPS (212399.0 to 212401.4 s of the week); use the trajectory of this \
         flight, or set its time scale with `trajectory_time`"
    );
    // After the end of the trajectory no later shot can be covered, so the recording is not read to
    // its end.
    assert!(refused(-3600.0).contains(
        "the recording lasts from Tuesday 10:00:00.0 GPS (208800.0 s of the week) on, the trajectory from"
    ));
}

/// Shots before and after the trajectory are dropped, counted and reported; other points are
/// unchanged.
#[test]
fn shots_outside_the_trajectory_are_counted() {
    let flight = fly(QUIET);
    let kept = 208_800.1..208_800.2;
    rewrite(&flight, |record| kept.contains(&record.time_s).then_some(record));
    let part = placed(&flight);
    let counters = part.cx.counters();
    let outside = counters.rejected[&(Item::Shots, Reason::OutsideTrajectory)];
    let blocks = counters.rejected[&(Item::Blocks, Reason::OutsideTrajectory)];
    assert!(outside > 2000 && outside < 4000 && blocks >= outside, "{outside} shots, {blocks} blocks");
    let shots: u64 = part.stats.iter().map(|stats| stats.nw).sum();
    assert!(outside + shots <= 4800 && outside + shots > 4700, "{outside} of 4800 shots, {shots} waveforms");
    let is_true =
        |point: &[f64; 3]| flight.truth.iter().any(|truth| distance_m(truth.point_m, *point) < 1e-3);
    assert!(part.points.len() > 1000 && part.points.iter().all(is_true));
    let note = &counters.notes[0];
    let expected = format!(
        "{outside} shots are rejected, because the trajectory has no pose for them: they last from Tuesday"
    );
    assert!(
        note.starts_with(&expected) && note.contains(", the trajectory from Tuesday 10:00:00.1 to"),
        "{note}"
    );
}

#[test]
fn shots_without_a_time_have_no_place() {
    let flight = fly(QUIET).without_times();
    let error = flight.place("trajectory = '*.out'", |truth| truth.range_m).err().unwrap();
    assert_eq!(
        error,
        "shot 0 has no GPS time and cannot be located on the trajectory; use a recording with GPS times, \
         or remove `trajectory` from `[job.geometry]`"
    );
    let flight = fly(QUIET).of_no_scale();
    let error = flight.place("trajectory = '*.out'", |truth| truth.range_m).err().unwrap();
    assert_eq!(
        error,
        "the time scale of the recording is unknown: its shots cannot be located on the trajectory; use a \
         recording with GPS times, or remove `trajectory` from `[job.geometry]`"
    );
}

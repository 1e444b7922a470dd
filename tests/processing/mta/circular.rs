//! A circular scanner: the beam rotates on a cone, and no line ends by facet, flag or jump.

use std::collections::BTreeMap;
use std::f64::consts::TAU;

use super::flights::{Found, Table, fly, in_sdf, lines_of, resolve, stage};
use wavex_testkit::TestFolder;
use wavex_testkit::pulsewaves::PulseWaves;

/// 1500 shots per revolution in pieces of 700, two to four pulses in the air, from a swaying
/// aircraft; zones change with azimuth.
const FLIGHT: &str = "seed = 3\nlandscape = 'country'\nscanner = 'circular'\nscan_angle_deg = [-20, 20]\n\
                      rotation_hz = 366.667\npulse_rate_hz = 550000\nmodulation_ns = 15\nlines = 48\nshots_per_line = 700\n\
                      flying_height_m = 800\nrelief_m = 120\nwater_ratio = 0.02\nfalse_alarm_rate = 0.002\n\
                      blind_gap_ns = 15\nroll_deg = 6\npitch_deg = 3\nyaw_deg = 3\nmotion_period_s = 4\nas_recorded = true\n";
/// Distance to a change of zone, shots.
const NEAR_SHOTS: usize = 25;
const CLEAR_DN: f64 = 25.0;

/// Clear true returns and those assigned to a wrong shot or zone: away from changes of zone, and
/// near.
#[derive(Debug, Default)]
struct Wrong {
    away: [usize; 2],
    near: [usize; 2],
}

impl Wrong {
    fn of(truth: &str, found: &Found) -> Wrong {
        let (truth, returns) = (Table::of(truth), Table::of(&found.returns));
        let mut by_shot: BTreeMap<u64, Vec<(f64, f64)>> = BTreeMap::new();
        let found = returns.numbers("range_m").into_iter().zip(returns.numbers("mta_zone"));
        for (shot, found) in returns.numbers("shot").into_iter().zip(found) {
            by_shot.entry(shot as u64).or_default().push(found);
        }
        let (shots, zones) = (truth.numbers("shot"), truth.numbers("zone"));
        let changes = (1..zones.len()).filter(|&row| zones[row] != zones[row - 1]).map(|row| shots[row]);
        let changes: Vec<f64> = changes.collect();
        let mut wrong = Wrong::default();
        let rows = truth.numbers("range_m").into_iter().zip(truth.numbers("amplitude_dn"));
        for (row, ((range_m, amplitude_dn), class)) in rows.zip(truth.texts("class")).enumerate() {
            if amplitude_dn < CLEAR_DN || class == "false_alarm" {
                continue;
            }
            let at = changes.partition_point(|change| *change < shots[row] - NEAR_SHOTS as f64);
            let is_near = changes.get(at).is_some_and(|change| *change <= shots[row] + NEAR_SHOTS as f64);
            let of_shot = by_shot.get(&(shots[row] as u64)).into_iter().flatten();
            let is_right = |found: &(f64, f64)| (found.0 - range_m).abs() < 1.5 && found.1 == zones[row];
            let group = if is_near { &mut wrong.near } else { &mut wrong.away };
            group[0] += 1;
            group[1] += usize::from(!of_shot.into_iter().any(is_right));
        }
        wrong
    }
}

#[test]
fn zones_of_a_circular_scanner_are_right_near_their_changes_and_away() {
    let flight = fly(FLIGHT);
    let found = resolve(&flight.recording, "");
    let wrong = Wrong::of(&flight.truth, &found);
    println!("{wrong:?}");
    assert!(wrong.away[0] > 5000 && wrong.near[0] > 4000, "{wrong:?}");
    assert!(wrong.away[1] * 1000 <= wrong.away[0] && wrong.near[1] * 1000 <= wrong.near[0], "{wrong:?}");
    let stage = stage(&found.report, "resolve_mta");
    assert_eq!(stage["notes"].as_array().unwrap().len(), 0, "{stage}");
    // Output lines equal input lines.
    let sizes: Vec<usize> = lines_of(&flight.recording).iter().map(Vec::len).collect();
    assert_eq!(sizes, [700; 48]);
}

/// In the scanner's own frame, and with lines too short to show the cone.
#[test]
fn pieces_of_a_revolution_are_resolved_as_the_revolution() {
    let keys = FLIGHT.replace("lines = 48\nshots_per_line = 700", "lines = 336\nshots_per_line = 100");
    let flight = fly(&format!("{keys}sbet = 'flight.sbet'"));
    let flight = in_sdf(flight);
    let wrong = Wrong::of(&flight.truth, &resolve(&flight.recording, ""));
    println!("{wrong:?}");
    assert!(wrong.away[0] > 5000 && wrong.near[0] > 4000, "{wrong:?}");
    assert!(wrong.away[1] * 1000 <= wrong.away[0] && wrong.near[1] * 1000 <= wrong.near[0], "{wrong:?}");
}

/// A revolution of 19 643 shots, in lines of 4096, is resolved with the default `memory_mb`.
#[test]
fn a_slow_scanner_is_resolved_with_the_default_memory() {
    let keys = FLIGHT
        .replace("rotation_hz = 366.667", "rotation_hz = 28")
        .replace("lines = 48\nshots_per_line = 700", "lines = 15\nshots_per_line = 4096");
    let flight = fly(&keys);
    let found = resolve(&flight.recording, "");
    let wrong = Wrong::of(&flight.truth, &found);
    let peak_bytes = found.report["peak_in_flight_bytes"].as_u64().unwrap();
    println!("{wrong:?}, {} MB of 1024", peak_bytes / 1_000_000);
    assert!(wrong.away[0] > 5000 && wrong.near[0] > 1000, "{wrong:?}");
    assert!(wrong.away[1] * 1000 <= wrong.away[0] && wrong.near[1] * 1000 <= wrong.near[0], "{wrong:?}");
    let stage = stage(&found.report, "resolve_mta");
    assert_eq!(stage["notes"].as_array().unwrap().len(), 0, "{stage}");
    let sizes: Vec<usize> = lines_of(&flight.recording).iter().map(Vec::len).collect();
    assert_eq!(sizes, [4096; 15]);
}

/// Over flat ground, the comparison method also works on a cone.
#[test]
fn the_least_variance_goes_around_the_cone() {
    let flat = "scanner = 'circular'\nscan_angle_deg = [-20, 20]\nrotation_hz = 366.667\npulse_rate_hz = 550000\n\
                modulation_ns = 15\nlines = 12\nshots_per_line = 750\nflying_height_m = 800\nroll_deg = 3\n\
                building_height_m = 0\ncanopy_height_m = 0\nas_recorded = true\n";
    let flight = fly(flat);
    let wrong = Wrong::of(&flight.truth, &resolve(&flight.recording, "method = 'variance'"));
    println!("{wrong:?}");
    let [count, wrong] = [0, 1].map(|k| wrong.away[k] + wrong.near[k]);
    assert!(count > 8000 && wrong * 1000 <= count, "{wrong} of {count}");
}

/// 519.5 pulses per revolution, in either direction: a file without line ends gets one line per
/// revolution.
#[test]
fn a_revolution_is_a_line_where_the_file_has_none() {
    for sense in [1.0, -1.0] {
        let mut file = PulseWaves::new(1300);
        for pulse in 0..1300 {
            let (sin, cos) = (sense * TAU * pulse as f64 / 519.5).sin_cos();
            let (away, down) = 20f64.to_radians().sin_cos();
            // 150 m, or 1000 ns, in millimetres from the anchor.
            let along = [away * cos, away * sin, -down].map(|part| (part * 149_896.0).round() as i32);
            let anchor = [100 * pulse, 0, 600_000];
            let target: Vec<u8> =
                (0..3).flat_map(|axis| (anchor[axis] + along[axis]).to_le_bytes()).collect();
            file = file.change(pulse as usize, 28, &target);
        }
        let place = TestFolder::with(&[("a.pls", &file.pls()), ("a.wvs", &file.waves)]);
        place.succeeds("read_pulsewaves", "a.pls", "[[stage]]\ntype = 'write_arrow'\npath = 'a.arrow'\n");
        let lines = lines_of(&std::fs::read(place.path("out/a.arrow")).unwrap());
        assert_eq!(lines.iter().map(Vec::len).collect::<Vec<_>>(), [520, 519, 261], "{sense}");
    }
}

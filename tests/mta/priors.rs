//! A constant pulse rate: what a prior, or a fixed zone, makes of it, and what is said without one.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::sync::OnceLock;

use crate::flights::{
    FLIGHT, Flight, Table, chain, fly, in_scanner_frame, recorded, refused, resolve, resolve_in, score, stage,
};
use crate::support::Place;

/// The flight at a constant rate.
fn constant() -> &'static Flight {
    static FOUND: OnceLock<Flight> = OnceLock::new();
    FOUND.get_or_init(|| {
        let keys = FLIGHT.replace("modulation_ns = 15", "modulation_ns = 0");
        fly(&format!("{keys}as_recorded = true"))
    })
}

#[test]
fn a_constant_rate_without_a_prior_is_refused() {
    refused(
        &constant().recording,
        "",
        "the pulse rate is constant: intervals of 2500.000 ns vary by 0.190 ns rms, at least 0.5 ns are needed to tell \
         which pulse caused an echo; give a prior (`agl_m`, `terrain`), or a fixed `zone`",
    );
}

#[test]
fn a_height_above_ground_resolves_a_constant_rate() {
    for keys in ["agl_m = [1360, 1520]", "agl_m = 1450", "agl_m = 1450\nagl_sd_m = 60"] {
        let score = score(&constant().truth, &resolve(&constant().recording, keys).returns);
        println!("{keys}: {} of {} right", score.right, score.true_returns);
        assert!(score.part_right() >= 0.999, "{keys}: {:?}", score.missed_shots);
    }
}

#[test]
fn in_the_scanners_frame_level_flight_is_assumed() {
    let flight = in_scanner_frame();
    let found = resolve(&flight.recording, "agl_m = 1450");
    assert!(score(&flight.truth, &found.returns).part_right() >= 0.999);
}

/// An ASCII grid of the ground in the truth, cells of 40 m, without heights where there is none.
fn grid(truth: &str) -> String {
    let table = Table::of(truth);
    let mut cells: BTreeMap<(i64, i64), (f64, f64)> = BTreeMap::new();
    let places = table.numbers("x").into_iter().zip(table.numbers("y")).zip(table.numbers("z"));
    for (((x, y), z), class) in places.zip(table.texts("class")) {
        if class == "ground" {
            let cell = cells.entry(((x / 40.0).floor() as i64, (y / 40.0).floor() as i64)).or_default();
            *cell = (cell.0 + z, cell.1 + 1.0);
        }
    }
    let range = |of: fn(&(i64, i64)) -> i64| {
        let values = || cells.keys().map(of);
        (values().min().unwrap() - 1, values().max().unwrap() + 1)
    };
    let ((west, east), (south, north)) = (range(|cell| cell.0), range(|cell| cell.1));
    let mut text = format!(
        "ncols {}\nnrows {}\nxllcorner {}\nyllcorner {}\ncellsize 40\nNODATA_value -9999\n",
        east - west + 1,
        north - south + 1,
        west * 40,
        south * 40
    );
    for row in (south..=north).rev() {
        for column in west..=east {
            // Cells around the swath have the height of the nearest one in their row, as a larger model would.
            let near = |by: i64| cells.get(&(column + by, row.clamp(south + 1, north - 1)));
            match (0..30).flat_map(|by| [near(by), near(-by)]).flatten().next() {
                Some((sum, count)) => write!(text, "{:.1} ", sum / count).unwrap(),
                None => text.push_str("-9999 "),
            }
        }
        text.push('\n');
    }
    text
}

#[test]
fn a_terrain_model_resolves_a_constant_rate() {
    let flight = constant();
    let place = Place::with(&[("a.arrow", &flight.recording), ("dtm.asc", grid(&flight.truth).as_bytes())]);
    let found = resolve_in(&place, "terrain = 'dtm.asc'");
    let score = score(&flight.truth, &found.returns);
    println!("{} of {} right, {} other zones", score.right, score.true_returns, score.other_zones);
    assert!(score.part_right() >= 0.9999, "{:?}", score.missed_shots);
}

#[test]
fn a_terrain_model_elsewhere_is_no_prior() {
    let flight = recorded();
    let far = "ncols 2\nnrows 2\nxllcorner 0\nyllcorner 0\ncellsize 10\n1 2 3 4\n";
    let place = Place::with(&[("a.arrow", &flight.recording), ("dtm.asc", far.as_bytes())]);
    let found = resolve_in(&place, "terrain = 'dtm.asc'");
    assert!(score(&flight.truth, &found.returns).part_right() >= 0.999);
}

#[test]
fn a_terrain_model_needs_the_place_of_the_shots() {
    let grid = "ncols 2\nnrows 2\nxllcorner 0\nyllcorner 0\ncellsize 10\n1 2 3 4\n";
    let place = Place::with(&[("a.arrow", &in_scanner_frame().recording), ("dtm.asc", grid.as_bytes())]);
    let outcome = place.read("read_arrow", "a.arrow", &chain("terrain = 'dtm.asc'"));
    let message = "stage resolve_mta: ./a.arrow: a terrain model needs shots whose place in the map is known, and those of \
                   this recording are in the scanner's own frame, without a trajectory; give the `trajectory` in \
                   `[job.geometry]`, or `agl_m` instead of `terrain`";
    place.left_nothing(outcome, message);
}

#[test]
fn a_missing_terrain_model_is_named() {
    let place = Place::with(&[("a.arrow", &recorded().recording)]);
    let outcome = place.read("read_arrow", "a.arrow", &chain("terrain = 'dtm.asc'"));
    assert_eq!(outcome.code, Some(1));
    assert!(outcome.err.contains("./dtm.asc: cannot open: "), "{}", outcome.err);
}

#[test]
fn a_fixed_zone_needs_nothing_else() {
    let flight = fly("lines = 12\nshots_per_line = 120\npulse_rate_hz = 100000\nas_recorded = true");
    let found = resolve(&flight.recording, "zone = 0");
    let score = score(&flight.truth, &found.returns);
    assert!(score.true_returns > 1000 && score.part_right() >= 0.999, "{:?}", score.missed_shots);
    let wrong = resolve(&flight.recording, "zone = 1").report;
    let rejected =
        &stage(&wrong, "resolve_mta")["rejected"]["blocks: no emission at a distance within `range_m`"];
    // Nothing was sent before the first shot of each line, and pauses are longer than pulses fly.
    assert!(rejected.as_u64().unwrap() >= 1, "{wrong}");
}

#[test]
fn the_least_variance_resolves_bare_ground() {
    let keys = "lines = 30\nshots_per_line = 200\npulse_rate_hz = 400000\nmodulation_ns = 50\nflying_height_m = 1500\n\
                building_height_m = 0\ncanopy_height_m = 0\nas_recorded = true";
    let flight = fly(keys);
    let score = score(&flight.truth, &resolve(&flight.recording, "method = 'variance'").returns);
    println!("{} of {} right", score.right, score.true_returns);
    assert!(score.part_right() >= 0.99, "{:?}", score.missed_shots);
}

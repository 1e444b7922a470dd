//! Constant pulse rate: results with a prior, with a fixed zone, and without either.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::sync::OnceLock;

use wavex_formats::container::{ContainerHeader, EmissionReference, channel};

use super::flights::{
    FLIGHT, Flight, Table, chain, fly, in_scanner_frame, lines_of, recorded, refused, resolve, resolve_in,
    score, stage,
};
use wavex_testkit::TestFolder;
use wavex_testkit::container::container;
use wavex_testkit::sdf::header;

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
        "the pulse rate is constant: intervals of 2500.000 ns vary by 0.458 ns RMS, but at least 0.5 ns \
         are needed to assign echoes to pulses; set a prior (`agl_m`, `terrain`), or a fixed `zone`",
    );
}

/// Adds clock jitter of up to this value, ns, with blocks shifted to match: the stamps jitter, but
/// not the pulses.
///
/// Keeps or removes the outgoing pulses.
fn with_jitter(flight: &Flight, jitter_ns: f64, keeps_outgoing: bool) -> Vec<u8> {
    let mut lines = lines_of(&flight.recording);
    for row in lines.iter_mut().flatten() {
        let mixed = row
            .shot
            .shot
            .wrapping_mul(0x9e37_79b9_7f4a_7c15)
            .rotate_left(31)
            .wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let early_ps = ((mixed >> 11) as f64 / (1u64 << 53) as f64 * 2.0 * jitter_ns * 1e3) as i64;
        row.shot.clock_ps -= early_ps;
        row.blocks.iter_mut().for_each(|block| block.1 += early_ps as f64 * 1e-3);
        row.blocks.retain(|block| keeps_outgoing || block.0 != channel::REFERENCE);
    }
    let reference = if keeps_outgoing { EmissionReference::OutgoingPulse } else { EmissionReference::Clock };
    container(&ContainerHeader { emission_reference: Some(reference), ..header() }, &lines)
}

#[test]
fn stamps_that_jitter_are_no_modulation() {
    // RMS jitter of 1.2 ns and 2.9 ns between stamps.
    for jitter_ns in [1.47, 3.6] {
        let recording = with_jitter(constant(), jitter_ns, true);
        let place = TestFolder::with(&[("a.arrow", &recording)]);
        let outcome = place.read("read_arrow", "a.arrow", &chain(""));
        assert_eq!(outcome.code, Some(1));
        println!("{}", outcome.err);
        let expected =
            "stage resolve_mta: ./a.arrow: the pulse rate is constant: intervals of 2500.000 ns vary by 0.";
        assert!(outcome.err.contains(expected), "outgoing pulses give the emission times: {}", outcome.err);
        let recording = with_jitter(constant(), jitter_ns, false);
        let place = TestFolder::with(&[("a.arrow", &recording)]);
        let outcome = place.read("read_arrow", "a.arrow", &chain(""));
        assert_eq!(outcome.code, Some(1));
        println!("{}", outcome.err);
        let expected =
            "stage resolve_mta: ./a.arrow: the time stamps jitter, not the pulses: intervals vary by ";
        assert!(outcome.err.contains(expected), "ranges do not follow the stamps: {}", outcome.err);
        assert!(
            outcome.err.contains("set a prior (`agl_m`, `terrain`), or a fixed `zone`"),
            "{}",
            outcome.err
        );
        // A prior resolves it; with outgoing pulses, ranges are exact.
        let recording = with_jitter(constant(), jitter_ns, true);
        let score = score(&constant().truth, &resolve(&recording, "agl_m = 1450").returns);
        assert!(score.part_right() >= 0.99, "{:?}", score.missed_shots);
    }
}

#[test]
fn pulses_that_vary_are_resolved_though_stamps_jitter_or_do_not_vary() {
    for (modulation_ns, jitter_ns) in [(15, 0.0), (15, 5.0), (5, 3.0)] {
        let flight = fly(&FLIGHT
            .replace("modulation_ns = 15", &format!("modulation_ns = {modulation_ns}\nas_recorded = true")));
        let score = score(&flight.truth, &resolve(&with_jitter(&flight, jitter_ns, true), "").returns);
        println!("{modulation_ns} ns, stamps {jitter_ns} ns: {} of {}", score.right, score.true_returns);
        assert!(score.part_right() >= 0.995, "{modulation_ns} ns, {jitter_ns} ns: {:?}", score.missed_shots);
    }
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

/// An ASCII grid of the true ground with cells of 40 m; cells without ground have no height.
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
            // Cells around the swath get the height of the nearest cell in their row, as in a
            // larger model.
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
    let place =
        TestFolder::with(&[("a.arrow", &flight.recording), ("dtm.asc", grid(&flight.truth).as_bytes())]);
    let found = resolve_in(&place, "terrain = 'dtm.asc'");
    let score = score(&flight.truth, &found.returns);
    println!("{} of {} right, {} other zones", score.right, score.true_returns, score.other_zones);
    assert!(score.part_right() >= 0.9999, "{:?}", score.missed_shots);
}

#[test]
fn a_terrain_model_elsewhere_is_no_prior() {
    let flight = recorded();
    let far = "ncols 2\nnrows 2\nxllcorner 0\nyllcorner 0\ncellsize 10\n1 2 3 4\n";
    let place = TestFolder::with(&[("a.arrow", &flight.recording), ("dtm.asc", far.as_bytes())]);
    let found = resolve_in(&place, "terrain = 'dtm.asc'");
    assert!(score(&flight.truth, &found.returns).part_right() >= 0.999);
}

#[test]
fn a_terrain_model_needs_the_place_of_the_shots() {
    let grid = "ncols 2\nnrows 2\nxllcorner 0\nyllcorner 0\ncellsize 10\n1 2 3 4\n";
    let place = TestFolder::with(&[("a.arrow", &in_scanner_frame().recording), ("dtm.asc", grid.as_bytes())]);
    let outcome = place.read("read_arrow", "a.arrow", &chain("terrain = 'dtm.asc'"));
    let message = "stage resolve_mta: ./a.arrow: a terrain model needs georeferenced shots, but those of \
                   this recording are in the scanner frame, without a trajectory; give the `trajectory` in \
                   `[job.geometry]`, or `agl_m` instead of `terrain`";
    place.left_nothing(outcome, message);
}

#[test]
fn a_missing_terrain_model_is_named() {
    let place = TestFolder::with(&[("a.arrow", &recorded().recording)]);
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
    // No pulse precedes the first shot of each line, and pauses are longer than the time of flight.
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

//! Coordinate conversion speed on one core.
//!
//! Points per second from the earth-centred frame.
//!
//!     cargo bench --bench crs

#![allow(
    clippy::print_stdout,
    clippy::expect_used,
    reason = "a bench prints its figures and panics on failure"
)]

use std::hint::black_box;
use std::sync::Arc;
use std::time::Instant;

use wavex_geodesy::crs::{Crs, Named};
use wavex_geodesy::ellipsoid::{Geodetic, WGS84};
use wavex_geodesy::geoid::{Geoid, GeoidGrid};

const POINTS: usize = 100_000;
const ROUNDS: usize = 15;
/// Required speed of UTM with a geoid, points per second and core.
const NEEDED: f64 = 3e6;

fn main() {
    println!("points per core-second from the earth-centred frame, median of {ROUNDS} rounds of {POINTS}");
    for (title, word, geoid) in [
        ("UTM", "utm:33N", false),
        ("UTM, geoid", "utm:33N", true),
        ("Lambert, geoid", "EPSG:3034", true),
        ("equal area (proj4rs), geoid", "EPSG:3035", true),
        ("geodetic, geoid", "geodetic", true),
        ("earth-centred", "ecef", false),
    ] {
        let crs = system(word, geoid);
        let rate = forward(&crs);
        let ratio = if word.starts_with("utm") {
            format!("  {:.2} of the required rate", rate / NEEDED)
        } else {
            String::new()
        };
        println!("{title:<30} {:>7.2} million/s{ratio}", rate / 1e6);
    }
    let rate = backward(&system("utm:33N", true));
    println!("{:<30} {:>7.2} million/s", "UTM, geoid, back", rate / 1e6);
}

fn system(word: &str, with_geoid: bool) -> Crs {
    let named = Named::parse(word).ok().flatten().expect("a system's name");
    let nowhere = Geodetic { latitude_rad: 0.0, longitude_rad: 0.0, height_m: 0.0 };
    Crs::new(&named, nowhere, with_geoid.then(geoid), None).expect("a system")
}

/// Creates a geoid as large as a national model.
///
/// Steps of one arc-minute.
fn geoid() -> Arc<Geoid> {
    let (rows, columns) = (601, 1201);
    let grid = GeoidGrid {
        south_deg: 45.0,
        west_deg: 5.0,
        latitude_step_deg: 1.0 / 60.0,
        longitude_step_deg: 1.0 / 60.0,
        rows,
        columns,
        heights_m: (0..rows * columns).map(|place| 40.0 + (place % 97) as f32 * 0.1).collect(),
    };
    Arc::new(Geoid::new("made up", grid).expect("a grid"))
}

/// Creates points as along scan lines of a flight to the north.
fn points() -> Vec<[f64; 3]> {
    let point = |number: usize| {
        let (line, place) = ((number / 500) as f64, (number % 500) as f64);
        WGS84.ecef_of(Geodetic {
            latitude_rad: (47.5 + line * 1e-4).to_radians(),
            longitude_rad: (12.5 + place * 1e-5).to_radians(),
            height_m: 400.0 + place % 30.0,
        })
    };
    (0..POINTS).map(point).collect()
}

fn forward(crs: &Crs) -> f64 {
    let points = points();
    rate(|| {
        points.iter().filter_map(|point| crs.from_ecef(black_box(*point)).ok()).map(|[x, _, z]| x + z).sum()
    })
}

fn backward(crs: &Crs) -> f64 {
    let points: Vec<[f64; 3]> = points().iter().filter_map(|point| crs.from_ecef(*point).ok()).collect();
    rate(|| {
        points.iter().filter_map(|point| crs.to_ecef(black_box(*point)).ok()).map(|[x, _, z]| x + z).sum()
    })
}

/// Returns the median of the rounds, points per second.
fn rate(round: impl Fn() -> f64) -> f64 {
    let mut seconds: Vec<f64> = (0..ROUNDS)
        .map(|_| {
            let start = Instant::now();
            black_box(round());
            start.elapsed().as_secs_f64()
        })
        .collect();
    seconds.sort_by(f64::total_cmp);
    POINTS as f64 / seconds[ROUNDS / 2]
}

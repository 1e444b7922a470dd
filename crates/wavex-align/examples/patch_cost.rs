//! Time of making patches: `patch_cost [SHOTS]`. Prints nanoseconds per return.
//!
//! Shots in scan lines over hills, 7 per m² from 500 m, a swath of 500 m, one in 25 shots with two returns.

#![allow(clippy::print_stdout)]

use std::error::Error;
use std::time::Instant;

use wavex_align::patch::{PatchMaker, PatchReturn, PatchSettings};
use wavex_align::scanner::{BeamSource, ScannerBeam};
use wavex_geodesy::ellipsoid::{Geodetic, WGS84};
use wavex_geodesy::frames::{LocalFrame, rotate};

const HEIGHT_M: f64 = 500.0;
const SWATH_M: f64 = 500.0;
const SPACING_M: f64 = 0.378;
const SHOTS_PER_S: f64 = 100_000.0;

fn main() -> Result<(), Box<dyn Error>> {
    let shots = std::env::args().nth(1).map_or(Ok(900_000), |word| word.parse::<usize>())?;
    let frame = LocalFrame::at(WGS84, Geodetic { latitude_rad: 0.83, longitude_rad: 0.2, height_m: 0.0 });
    let per_line = (SWATH_M / SPACING_M) as usize;
    let mut random = 1u64;
    let mut uniform = || {
        random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (random >> 11) as f64 / (1u64 << 53) as f64
    };
    let mut returns = Vec::new();
    for shot in 0..shots {
        let (line, k) = (shot / per_line, shot % per_line);
        let x = k as f64 * SPACING_M - SWATH_M / 2.0 + 0.1 * uniform();
        let y = line as f64 * SPACING_M + 0.1 * uniform();
        let n_returns = if uniform() < 0.04 { 2 } else { 1 };
        for number in 0..n_returns {
            let noise_m = 0.02 * (uniform() + uniform() - 1.0) + 5.0 * f64::from(number);
            let z = 8.0 * (x / 60.0).sin() + 6.0 * (y / 45.0).cos() + noise_m;
            let range_m = (x * x + (HEIGHT_M - z).powi(2)).sqrt();
            returns.push(PatchReturn {
                beam: ScannerBeam { time_s: shot as f64 / SHOTS_PER_S, ..ScannerBeam::default() },
                source: BeamSource::default(),
                range_sd_m: 0.01,
                n_returns,
                point_in_ecef_m: WGS84.ecef_of(frame.geodetic_of([x, y, z])),
                direction_in_ecef: rotate(
                    frame.ecef_from_local(),
                    [x / range_m, 0.0, (z - HEIGHT_M) / range_m],
                ),
            });
        }
    }
    let mut fastest_s = f64::INFINITY;
    for _ in 0..5 {
        let started = Instant::now();
        let mut maker = PatchMaker::on_tiles(PatchSettings::default());
        returns.iter().for_each(|given| maker.add(given));
        let added_s = started.elapsed().as_secs_f64();
        let (patches, counts) = maker.finish();
        let elapsed_s = started.elapsed().as_secs_f64();
        fastest_s = fastest_s.min(elapsed_s);
        println!("{} patches, {counts:?}: {elapsed_s:.3} s, {added_s:.3} s before the end", patches.len());
    }
    println!("{:.0} ns per return", 1e9 * fastest_s / returns.len() as f64);
    Ok(())
}

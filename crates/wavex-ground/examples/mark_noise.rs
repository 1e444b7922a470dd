//! Classifies a cloud with `mark_noise`: `mark_noise POINTS CLASSES`.
//!
//! POINTS has rows of 9 little-endian doubles: east, north, height (m), unit vector from the sensor to the point (3, zeros if
//! unknown), number of the return, number of returns of the shot, strip. CLASSES gets a byte per point, of the LAS
//! specification. tests/python/check_noise.py makes clouds and compares.

#![allow(clippy::print_stdout, reason = "prints the time")]

use std::error::Error;
use std::time::Instant;

use wavex_ground::point::CloudPoint;
use wavex_ground::rays::{NoiseSettings, mark_noise};

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().collect();
    let [_, from, to] = &arguments[..] else { return Err("usage: mark_noise POINTS CLASSES".into()) };
    let bytes = std::fs::read(from)?;
    let point = |row: &[u8]| {
        let value = |at: usize| f64::from_le_bytes(row[8 * at..8 * at + 8].try_into().unwrap_or_default());
        CloudPoint {
            beam: [3, 4, 5].map(|at| value(at) as f32),
            return_number: value(6) as u8,
            n_returns: value(7) as u8,
            strip: value(8) as u16,
            ..CloudPoint::at([value(0), value(1), value(2)])
        }
    };
    let points: Vec<CloudPoint> = bytes.chunks_exact(72).map(point).collect();
    let start = Instant::now();
    let classes = mark_noise(&points, &NoiseSettings::default());
    println!("{} points, {:.3} s", points.len(), start.elapsed().as_secs_f64());
    std::fs::write(to, classes.into_iter().map(|class| class as u8).collect::<Vec<u8>>())?;
    Ok(())
}

//! Measures reading: samples in order, single shots in any order, and the largest memory (on Linux).
//!
//! usage: speed_hdf5 FILE BEAM

use std::env;
use std::error::Error;
use std::fs;
use std::path::Path;
use std::time::Instant;

use wavex_hdf5::{Granule, Shot};

/// Number of single shots.
const SINGLE_SHOTS: usize = 2000;

#[allow(clippy::print_stdout, reason = "this is a program")]
fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = env::args().collect();
    let [_, file, beam] = &arguments[..] else {
        return Err("usage: speed_hdf5 FILE BEAM".into());
    };
    let start = Instant::now();
    let mut beam = Granule::open(Path::new(file))?.beam(beam)?;
    println!("opened in {:.1} ms", start.elapsed().as_secs_f64() * 1e3);

    let mut shot = Shot::default();
    let (start, mut samples) = (Instant::now(), 0);
    for index in 0..beam.len() {
        beam.shot(index, &mut shot)?;
        samples += shot.received_dn.len() + shot.outgoing_dn.len();
    }
    let time_s = start.elapsed().as_secs_f64();
    let megabytes = samples as f64 * 4e-6;
    println!("in order: {} shots, {megabytes:.0} MB of samples, {:.0} MB/s", beam.len(), megabytes / time_s);

    let (start, mut index) = (Instant::now(), 0);
    for _ in 0..SINGLE_SHOTS {
        // A step without a common divisor visits all shots.
        index = (index + 7919) % beam.len();
        beam.shot(index, &mut shot)?;
    }
    println!("single shots: {:.0} us each", start.elapsed().as_secs_f64() * 1e6 / SINGLE_SHOTS as f64);
    let status = fs::read_to_string("/proc/self/status").unwrap_or_default();
    let peak = status.lines().find(|line| line.starts_with("VmHWM")).unwrap_or("largest memory unknown");
    println!("{peak}");
    Ok(())
}

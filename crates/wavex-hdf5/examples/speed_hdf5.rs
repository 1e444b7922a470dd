//! Measures reading on Linux: processor time of all samples in order and of single shots, largest memory.
//!
//! usage: speed_hdf5 FILE BEAM

use std::env;
use std::error::Error;
use std::fs;
use std::path::Path;

use wavex_hdf5::{Granule, Shot};

/// Number of single shots.
const SINGLE_SHOTS: usize = 2000;

#[allow(clippy::print_stdout, reason = "this is a program")]
fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = env::args().collect();
    let [_, file, beam] = &arguments[..] else {
        return Err("usage: speed_hdf5 FILE BEAM".into());
    };
    let start = processor_time_s();
    let mut beam = Granule::open(Path::new(file))?.beam(beam)?;
    println!("opened in {:.0} ms", (processor_time_s() - start) * 1e3);

    let mut shot = Shot::default();
    let (start, mut samples) = (processor_time_s(), 0);
    for index in 0..beam.len() {
        beam.shot(index, &mut shot)?;
        samples += shot.received_dn.len() + shot.outgoing_dn.len();
    }
    let time_s = processor_time_s() - start;
    let megabytes = samples as f64 * 4e-6;
    println!("in order: {} shots, {megabytes:.0} MB of samples, {:.0} MB/s", beam.len(), megabytes / time_s);

    let (start, mut index) = (processor_time_s(), 0);
    for _ in 0..SINGLE_SHOTS {
        // A step without a common divisor visits all shots.
        index = (index + 7919) % beam.len();
        beam.shot(index, &mut shot)?;
    }
    println!("single shots: {:.0} us each", (processor_time_s() - start) * 1e6 / SINGLE_SHOTS as f64);
    let status = fs::read_to_string("/proc/self/status").unwrap_or_default();
    let peak = status.lines().find(|line| line.starts_with("VmHWM")).unwrap_or("largest memory unknown");
    println!("{peak}");
    Ok(())
}

/// Processor time of this program, s; in steps of 10 ms.
fn processor_time_s() -> f64 {
    let stat = fs::read_to_string("/proc/self/stat").unwrap_or_default();
    // Behind the name in brackets: the 12th and 13th value are ticks in user and system mode.
    let behind_name = stat.rsplit(')').next().unwrap_or_default();
    let ticks = behind_name.split_whitespace().skip(11).take(2).filter_map(|ticks| ticks.parse::<f64>().ok());
    ticks.sum::<f64>() / 100.0
}

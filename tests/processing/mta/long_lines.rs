//! Lines of any length are resolved at default settings, with the same result for any sufficient
//! memory.
//!
//! `WAVEX_LONG_LINES=all cargo test --release --test processing mta::long_lines -- --nocapture` prints the
//! table of docs/explanation/mta.md.

use serde_json::Value;
use wavex_formats::container::{ContainerShot, channel};

use super::flights::{Table, peak_kb};
use wavex_testkit::container::{Row, container, rows};
use wavex_testkit::sdf::{NAME, header};
use wavex_testkit::{Outcome, TestFolder, notes};

const INTERVAL_PS: f64 = 2.5e6;
/// Maximum deviation of an interval from its mean; half of it per pulse.
const MODULATION_PS: f64 = 15e3;
const GROUP_VELOCITY_MPS: f64 = 299_707_502.0;
const HALF_SWATH_DEG: f64 = 25.0;
const DEFAULT_MB: u64 = 1024;

/// A number in [0, 1), hashed from another.
fn unit(of: u64) -> f64 {
    let mixed = (of ^ (of >> 31)).wrapping_mul(0x7fb5_d329_728e_a185).rotate_left(29);
    let mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x81da_def4_bc2d_d44d);
    ((mixed ^ (mixed >> 33)) >> 11) as f64 / (1u64 << 53) as f64
}

/// A flight over gentle hills with four or five pulses in the air and one echo per shot.
#[derive(Clone, Copy)]
struct Flight {
    shots_per_line: usize,
    lines: usize,
    /// Samples per block.
    samples: usize,
    /// Whether the job finds returns; otherwise it ends with the resolved shots.
    finds_returns: bool,
    has_high_power: bool,
}

impl Flight {
    fn angle_rad(&self, shot: usize) -> f64 {
        let across = ((shot % self.shots_per_line) as f64 + 0.5) / self.shots_per_line as f64;
        ((2.0 * across - 1.0) * HALF_SWATH_DEG).to_radians()
    }

    fn clock_ps(&self, shot: usize) -> i64 {
        // A polygon pauses for half a line.
        let line = (shot / self.shots_per_line) as f64;
        let even = (shot as f64 + 0.5 * line * self.shots_per_line as f64) * INTERVAL_PS;
        (even + (unit(shot as u64) - 0.5) * MODULATION_PS) as i64 + 5_000_000_000_000
    }

    fn range_m(&self, shot: usize) -> f64 {
        let (line, angle_rad) = ((shot / self.shots_per_line) as f64, self.angle_rad(shot));
        let ground_m = 40.0 * (3.0 * angle_rad).sin() + 0.2 * line;
        (1700.0 - ground_m) / angle_rad.cos()
    }

    /// The recording, with blocks in the records in which they were received.
    fn recording(&self) -> Vec<u8> {
        let count = self.lines * self.shots_per_line;
        let clocks: Vec<i64> = (0..count).map(|shot| self.clock_ps(shot)).collect();
        let mut rows: Vec<Row> = (0..count).map(|shot| self.row(shot, clocks[shot])).collect();
        for shot in 0..count {
            let flight_ns = 2e9 * self.range_m(shot) / GROUP_VELOCITY_MPS;
            let received_ps = clocks[shot] + (flight_ns * 1e3) as i64;
            let record = clocks.partition_point(|&clock| clock <= received_ps) - 1;
            let time_ns = flight_ns - (clocks[record] - clocks[shot]) as f64 * 1e-3;
            self.add_echo(&mut rows[record], time_ns, 40.0 + 120.0 * unit(!(shot as u64)));
        }
        let lines: Vec<Vec<Row>> = rows.chunks(self.shots_per_line).map(<[Row]>::to_vec).collect();
        container(&header(), &lines)
    }

    fn row(&self, shot: usize, clock_ps: i64) -> Row {
        let angle_rad = self.angle_rad(shot);
        let shot_of = ContainerShot {
            shot: shot as u64,
            line: (shot / self.shots_per_line) as u32,
            gps_time_s: Some(208_800.0 + clock_ps as f64 * 1e-12),
            clock_ps,
            origin_m: [0.0; 3],
            direction: [0.0, angle_rad.sin(), angle_rad.cos()],
            facet: 0,
            flags: 3,
            mta_zone: None,
            scan_angle_deg: None,
            frame_scale: None,
        };
        Row { shot: shot_of, blocks: vec![(channel::REFERENCE, -10.0, pulse(20, 10.0, 90.0))] }
    }

    fn add_echo(&self, row: &mut Row, time_ns: f64, height_dn: f64) {
        let start_ns = (time_ns - 12.0).floor();
        let low = pulse(self.samples, time_ns - start_ns, height_dn);
        row.blocks.push((channel::LOW_POWER, start_ns, low));
        if self.has_high_power {
            let high = pulse(self.samples, time_ns - start_ns, 0.2 * height_dn);
            row.blocks.push((channel::HIGH_POWER, start_ns + 1.43, high));
        }
    }

    /// The job with this reader. Calibration uses few waveforms, so the first lines do not need the
    /// most memory.
    fn job(&self, reader: &str) -> String {
        let source = match reader {
            "read_sdf" => format!("type = 'read_sdf'\npath = '{NAME}'"),
            reader => format!("type = '{reader}'\npath = '{NAME}'"),
        };
        let ends = match self.finds_returns {
            true => {
                "[[stage]]\ntype = 'decompose'\nmode = 'fastest'\n[[stage]]\ntype = 'correct'\n\
                 [[stage]]\ntype = 'filter_outliers'\n[[stage]]\ntype = 'write_table'\npath = 'made'\nformat = 'csv'\n"
            }
            false => "[[stage]]\ntype = 'write_arrow'\npath = 'made'\ncompression = 'none'\n",
        };
        format!(
            "[[stage]]\n{source}\n[[stage]]\ntype = 'resolve_mta'\n\
             [[stage]]\ntype = 'fuse_channels'\nwaveforms = 1000\n\
             [[stage]]\ntype = 'calibrate'\nwaveforms = 1000\nresponse = 'gaussian'\n{ends}"
        )
    }

    /// Shots with an echo, and its range, m.
    fn ranges_m(&self, place: &TestFolder) -> Vec<(usize, f64)> {
        if !self.finds_returns {
            let shots = rows(&place.path("out/made")).into_iter().flatten();
            let range_m = |block: &(u8, f64, Vec<u16>)| {
                let highest = block.2.iter().max().unwrap();
                let peak = block.2.iter().position(|sample| sample == highest).unwrap();
                (block.1 + peak as f64) * 0.5e-9 * GROUP_VELOCITY_MPS
            };
            let low = |row: Row| {
                let low = row.blocks.iter().find(|block| block.0 == channel::LOW_POWER).map(range_m);
                low.map(|range_m| (row.shot.shot as usize, range_m))
            };
            return shots.filter_map(low).collect();
        }
        let table = Table::of(&place.text("out/made"));
        table.numbers("shot").into_iter().map(|shot| shot as usize).zip(table.numbers("range_m")).collect()
    }

    /// Asserts that each echo has the range of its shot.
    fn is_right(&self, place: &TestFolder) {
        let found = self.ranges_m(place);
        let is_wrong = |(shot, range_m): &&(usize, f64)| (range_m - self.range_m(*shot)).abs() > 0.5;
        let (count, wrong) = (found.len(), found.iter().filter(is_wrong).count());
        assert!(10 * count >= 9 * self.lines * self.shots_per_line, "{count} echoes");
        assert!(1000 * wrong <= count, "{wrong} of {count} echoes have another shot's range");
    }
}

/// A Gaussian pulse at a position, above a background.
fn pulse(samples: usize, position: f64, height_dn: f64) -> Vec<u16> {
    let sample = |k: usize| match (k as f64 - position) / 1.9 {
        away if away.abs() < 5.0 => 3.0 + height_dn * (-0.5 * away * away).exp(),
        _ => 3.0,
    };
    (0..samples).map(|k| sample(k).round() as u16).collect()
}

/// Output of a run with this memory limit, or the memory that it requests, MB.
fn run(place: &TestFolder, job: &str, memory_mb: u64) -> Result<Vec<u8>, u64> {
    let mut command = place.command(job);
    if memory_mb != DEFAULT_MB {
        command.args(["--set", &format!("job.memory_mb={memory_mb}")]);
    }
    let (outcome, peak_kb) = peak_kb(&mut command);
    if outcome.code == Some(1) {
        let message = " does not fit into memory_mb: stages hold back ";
        assert!(outcome.err.contains(message), "{}", outcome.err);
        assert!(outcome.err.contains(", and `resolve_mta` needs up to "), "{}", outcome.err);
        let needed = outcome.err.split("; set memory_mb to ").nth(1).unwrap().split(' ').next().unwrap();
        println!("  {memory_mb} MB: refused, {needed} MB asked for");
        return Err(needed.parse().unwrap());
    }
    assert_eq!(outcome, Outcome::success());
    let report: Value = serde_json::from_str(&place.text("out/job_report.json")).unwrap();
    let said = notes(&report["inputs"][0]);
    assert!(!said.iter().any(|note| note.contains("memory_mb")), "{said:?}");
    let in_flight_mb = report["inputs"][0]["peak_in_flight_bytes"].as_f64().unwrap() / 1e6;
    println!("  {memory_mb} MB: {in_flight_mb:.0} MB of lines, {:.0} MB in all", peak_kb as f64 * 1.024e-3);
    assert!(in_flight_mb <= 1.1 * memory_mb as f64, "{in_flight_mb} MB of {memory_mb}");
    Ok(std::fs::read(place.path("out/made")).unwrap())
}

/// Asserts that the flight gives the same output with the default and with other limits, or
/// requests more memory.
fn resolves(flight: &Flight, reader: &str, memories_mb: &[u64]) {
    let receivers = 1 + u32::from(flight.has_high_power);
    println!("{} lines of {} shots, {receivers} receivers, {reader}:", flight.lines, flight.shots_per_line);
    let (place, job) = (TestFolder::with(&[(NAME, &flight.recording())]), flight.job(reader));
    let expected = run(&place, &job, DEFAULT_MB).expect("the default suffices");
    flight.is_right(&place);
    for &memory_mb in memories_mb {
        let found = run(&place, &job, memory_mb)
            .or_else(|needed_mb| run(&place, &job, needed_mb))
            .expect("the requested memory suffices");
        assert!(found == expected, "different results with {memory_mb} MB");
    }
}

#[test]
fn long_lines_are_resolved_at_default_settings_and_alike_with_any_memory() {
    let flight = |shots_per_line: usize, lines, samples, has_high_power| Flight {
        shots_per_line,
        lines,
        samples,
        finds_returns: samples <= 60,
        has_high_power,
    };
    if std::env::var_os("WAVEX_LONG_LINES").is_some() {
        for shots_per_line in [100, 300, 1000, 3000, 4000, 10_000] {
            for has_high_power in [false, true] {
                // More lines than a window of 160 lines or of 256 MB.
                let lines = 200.min(400_000 / shots_per_line);
                let flight =
                    Flight { finds_returns: false, ..flight(shots_per_line, lines, 60, has_high_power) };
                resolves(&flight, "read_sdf", &[64, 128, 256, 512, 4096]);
            }
        }
        return;
    }
    // The whole chain; then long lines with long blocks, so that few lines need much memory.
    resolves(&flight(100, 90, 60, false), "read_arrow", &[64, 4096]);
    resolves(&flight(1000, 20, 60, true), "read_sdf", &[64]);
    resolves(&flight(4000, 14, 150, true), "read_arrow", &[64]);
    resolves(&flight(10_000, 6, 100, false), "read_sdf", &[64]);
}

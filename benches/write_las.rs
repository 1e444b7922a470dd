//! Speed of `write_las` compared with the `laz` crate alone.
//!
//! Both compress the same records. Writes points with all extra attributes to LAZ, on one thread
//! and on two. `cargo bench --bench write_las` prints millions of points per second. Goals: on one
//! thread at most 10 % slower than `laz` alone, on two at least 1.6 times as fast as on one.
#![allow(clippy::print_stdout, clippy::panic, reason = "a bench prints its figures and panics on failure")]

use std::io::Cursor;
use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

use laz::{LasZipCompressor, LazVlr, LazVlrBuilder};
use wavex::registry;
use wavex::scan_line::{Blocks, Content, InputInfo, Return, ScanLine, TimeScale};
use wavex::stage::{Context, Plan, RunContext, Sink};

const LINES: usize = 250;
const SHOTS: usize = 2000;
/// Two returns per shot.
const POINTS: usize = 2 * LINES * SHOTS;
const RUNS: usize = 7;
/// Length of a record, bytes.
///
/// Point format 6 and the extra attributes.
const RECORD: usize = 30 + 10;
const EXTRA: u16 = 10;

/// Random numbers as noisy as real returns.
struct Noise(u64);

impl Noise {
    /// Returns a number between 0 and 1.
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 40) as f64 / (1u64 << 24) as f64
    }
}

fn lines() -> Vec<ScanLine> {
    let input =
        Arc::new(InputInfo { time_scale: TimeScale::Adjusted, ..wavex_testkit::engine_stages::input_info() });
    let mut noise = Noise(1);
    (0..LINES).map(|line| scan_line(&input, line, &mut noise)).collect()
}

fn scan_line(input: &Arc<InputInfo>, line: usize, noise: &mut Noise) -> ScanLine {
    let mut batch = ScanLine::of_shots(Arc::clone(input), line as u32, Vec::new(), Blocks::default());
    let (mut returns, mut points) = (Vec::new(), Vec::new());
    for shot in 0..SHOTS {
        let number = line * SHOTS + shot;
        let mut emission = wavex_testkit::engine_stages::emission(number as u64);
        emission.gps_time_s = 3e8 + number as f64 * 2.5e-6;
        emission.scan_angle_deg = -30.0 + shot as f32 * 0.03;
        batch.emissions.push(emission);
        for return_number in 1..=2 {
            returns.push(found(shot as u32, return_number, noise));
            let height_m = 20.0 * noise.next() * f64::from(2 - return_number);
            points.push([shot as f64 * 0.4 + 0.05 * noise.next(), line as f64 * 0.4, height_m]);
        }
    }
    batch.content = Content::Points(returns, points);
    batch
}

fn found(emission: u32, return_number: u8, noise: &mut Noise) -> Return {
    let amplitude_dn = 20.0 + 100.0 * noise.next();
    Return {
        emission,
        return_number,
        number_of_returns: 2,
        amplitude_dn,
        amplitude_db: 10.0 * (amplitude_dn / 7.0).log10(),
        intensity: amplitude_dn,
        intensity_sd: 1.0 + noise.next(),
        range_sd_m: 0.002 + 0.01 * noise.next(),
        width_ratio: 1.0 + 0.3 * noise.next(),
        width_ratio_sd: 0.01 + 0.02 * noise.next(),
        thickness_m: 0.2 * noise.next(),
        thickness_sd_m: 0.01 + 0.05 * noise.next(),
        deviation_ratio: 2.0 * noise.next() - 1.0,
        ..Return::default()
    }
}

fn pool(threads: usize) -> rayon::ThreadPool {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
    pool.unwrap_or_else(|error| panic!("cannot start a thread: {error}"))
}

fn sink(folder: &Path, path: &str, threads: usize) -> Box<dyn Sink> {
    let run = RunContext {
        input: "made".into(),
        stem: "made".into(),
        input_dir: folder.into(),
        output_dir: folder.into(),
        pool: (threads > 1).then(|| Arc::new(pool(threads))),
        simd: wavex_simd::SimdLevel::best(),
        ..RunContext::alone("".as_ref())
    };
    let spec = registry::find("write_las").unwrap_or_else(|| panic!("write_las is a stage"));
    let Plan::Sink(keys) =
        wavex_testkit::engine_stages::stage(spec, &format!("path = '{path}'")).planned.plan
    else {
        panic!("write_las is a sink")
    };
    keys.make(&run).unwrap_or_else(|error| panic!("{error}"))
}

/// Writes all lines to a sink.
///
/// The file exists until the context is dropped.
fn write(mut sink: Box<dyn Sink>, lines: &[ScanLine]) -> Context {
    let mut cx = Context::default();
    for line in lines {
        sink.write(line, &mut cx).unwrap_or_else(|error| panic!("{error}"));
    }
    sink.finish(&mut cx).unwrap_or_else(|error| panic!("{error}"));
    cx
}

/// Returns the duration of the stage, s.
fn write_laz(folder: &Path, threads: usize, lines: &[ScanLine]) -> f64 {
    let sink = sink(folder, "points.laz", threads);
    let started = Instant::now();
    let cx = write(sink, lines);
    let seconds = started.elapsed().as_secs_f64();
    drop(cx);
    seconds
}

/// Returns the records that the stage writes for the lines.
fn records(folder: &Path, lines: &[ScanLine]) -> Vec<u8> {
    let _cx = write(sink(folder, "points.las", 1), lines);
    // Only a complete run renames the file: here it has its temporary name.
    let mut files = std::fs::read_dir(folder).unwrap_or_else(|error| panic!("{error}"));
    let Some(Ok(file)) = files.next() else { panic!("no file was written") };
    let las = std::fs::read(file.path()).unwrap_or_else(|error| panic!("{error}"));
    las[las.len() - POINTS * RECORD..].to_vec()
}

/// Returns the duration of compressing the same records with the `laz` crate, s.
fn compress(records: &[u8], laz: &LazVlr) -> f64 {
    let out = Cursor::new(Vec::with_capacity(records.len()));
    let mut compressor = LasZipCompressor::new(out, laz.clone()).unwrap_or_else(|error| panic!("{error}"));
    let started = Instant::now();
    compressor.compress_many(records).unwrap_or_else(|error| panic!("{error}"));
    compressor.done().unwrap_or_else(|error| panic!("{error}"));
    started.elapsed().as_secs_f64()
}

fn main() {
    let folder = std::env::temp_dir().join(format!("wavex-bench-las-{}", std::process::id()));
    let lines = lines();
    let records = records(&folder, &lines);
    let laz = LazVlrBuilder::default().with_point_format(6, EXTRA).unwrap_or_else(|error| panic!("{error}"));
    let laz = laz.with_fixed_chunk_size(50_000).build();
    // Alternate the variants so that other load on the machine affects all of them.
    let mut seconds = [Vec::new(), Vec::new(), Vec::new()];
    for _ in 0..RUNS {
        seconds[0].push(compress(&records, &laz));
        seconds[1].push(write_laz(&folder, 1, &lines));
        seconds[2].push(write_laz(&folder, 2, &lines));
    }
    let [alone, one, two] = seconds.map(|mut seconds| {
        seconds.sort_by(f64::total_cmp);
        POINTS as f64 / seconds[RUNS / 2] / 1e6
    });
    println!("{POINTS} points, median of {RUNS} runs, millions of points per second");
    println!("laz alone, one thread   {alone:>6.2}");
    println!("write_las, one thread   {one:>6.2}   {:.2} of laz alone (goal: at least 0.9)", one / alone);
    println!("write_las, two threads  {two:>6.2}   {:.2} of one thread (goal: at least 1.6)", two / one);
    // A failure to remove the temporary folder is harmless.
    let _ = std::fs::remove_dir_all(&folder);
}

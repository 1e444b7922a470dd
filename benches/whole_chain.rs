//! Speed and memory of the whole chain.
//!
//! From a container to LAZ with all attributes. `cargo bench --bench whole_chain` creates the mixed
//! scene (`scenes`) with a trajectory. It runs `wavex run` on a tenth of it and on all of it, on
//! two threads, and prints waveforms per second, the peak memory of each run, and the table of
//! stages. `-- 10000000` sets the number of waveforms (default three million).
//!
//! Then it does the same with what is recorded in the field: a forest and a city by `simulate`, with
//! outgoing pulses, two receivers and blocks of the length of their echoes, one to seven close echoes, and the
//! recording `riegl_example3` below `WAVEX_DATA`, calibration included. `-- scenes` measures these alone.
//!
//! `-- stages`: the overhead of stages per waveform on one thread: time of `decompose` minus that of its kernels, and
//! time of readers minus that of a copy of their files.
//!
//! `-- calibrations`: the time of `calibrate` for recordings of 4000 to 400 000 waveforms. Without these words all parts
//! are measured; `-- mixed` measures the mixed scene alone.
//!
//! The result of the mixed scene is compared with two ceilings. Each adds up the time of decomposition, of compressing
//! the same records with the `laz` crate, and of georeferencing, divided by two cores without loss.
//! Decomposition is measured by the yardstick in C (`WAVEX_YARDSTICK`), or by the kernels of the
//! stage alone.
#![allow(clippy::print_stdout, clippy::panic, reason = "a bench prints its figures and panics on failure")]
#![allow(clippy::unwrap_used, reason = "a bench panics on failure")]

use std::fs::{self, File};
use std::io::{BufWriter, Cursor, Write};
use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::Arc;
use std::time::{Duration, Instant};

use serde_json::Value;

use laz::{LasZipCompressor, LasZipDecompressor, LazVlr};
use wavex_formats::container::{
    Compression, ContainerBlock, ContainerHeader, ContainerShot, ContainerWriter, EmissionReference,
    LineBuilder, TimeScale, channel,
};
use wavex_formats::trajectory::sbet::SbetRecord;
use wavex_signal::decompose::DecomposeSettings;
use wavex_signal::decompose::Waveform;
use wavex_signal::decompose::{BatchDecomposer, Decompositions, Mode, Tables};
use wavex_signal::sensor_model::{ChannelModel, SensorModel};
use wavex_simd::SimdLevel;
use wavex_testkit::waveforms::{SAMPLES, Scene, Waveforms, model as true_model, noise};

const WAVEFORMS: usize = 3_000_000;
const SHOTS_PER_LINE: usize = 2000;
const PULSE_RATE_HZ: f64 = 400e3;
/// Time of the first shot, seconds of the week.
const START_S: f64 = 200_000.0;
const SPEED_MPS: f64 = 60.0;
const THREADS: usize = 2;
const GOAL: f64 = 0.7;
const GOAL_BUSY: f64 = 1.85;
/// Minimum time to georeference a point, ns.
///
/// Arithmetic of one rotation and one projection.
const GEOREFERENCE_NS: f64 = 75.0;
/// Scenes of `simulate`, by name and keys, and the number of lines of 1000 shots.
const SCENES: [(&str, &str); 2] = [
    ("forest", "wood_ratio = 1.0\nwater_ratio = 0.0\ncanopy_height_m = 30.0"),
    ("city", "wood_ratio = 0.05\nwater_ratio = 0.0\nhouse_ratio = 0.8\nbuilding_height_m = 25.0"),
];
const SCENE_LINES: usize = 300;
const REAL: &str = "pulsewaves/riegl_example3";
const CALIBRATE: &str = "[[stage]]\ntype = 'calibrate'\n";

/// Writes a straight, level flight northwards at 700 m above ground.
fn write_trajectory(path: &Path, duration_s: f64) {
    let mut to = BufWriter::new(File::create(path).unwrap());
    for k in 0..=((duration_s + 2.0) * 200.0) as usize {
        let since_s = k as f64 / 200.0 - 1.0;
        let record = SbetRecord {
            time_s: START_S + since_s,
            latitude_rad: 48f64.to_radians() + since_s * SPEED_MPS / 6.38e6,
            longitude_rad: 11f64.to_radians(),
            height_m: 1100.0,
            velocity_mps: [SPEED_MPS, 0.0, 0.0],
            roll_rad: 0.0,
            pitch_rad: 0.0,
            platform_heading_rad: 0.0,
            wander_angle_rad: 0.0,
            acceleration_mps2: [0.0; 3],
            angular_rate_rad_per_s: [0.0; 3],
        };
        to.write_all(&record.encode()).unwrap();
    }
    to.flush().unwrap();
}

fn header() -> ContainerHeader {
    ContainerHeader {
        instrument: Some("made up".into()),
        pulse_rate_hz: Some(PULSE_RATE_HZ),
        time_scale: TimeScale::Week,
        gps_week: Some(1747),
        recorded: Some((172, 2013)),
        full_scale_dn: Some(255),
        emission_reference: Some(EmissionReference::Clock),
        ..ContainerHeader::new(1.0, 299_707_502.0)
    }
}

/// Writes the recording.
///
/// Lines from -30 to 30 degrees, one block of the scene per shot.
fn write_recording(path: &Path, lines: usize, scene: Scene) {
    let noise = noise();
    let mut waveforms = Waveforms::new(&true_model(&noise), &noise, scene, 9);
    let to = BufWriter::new(File::create(path).unwrap());
    let mut writer = ContainerWriter::file(to, path, &header(), Compression::Lz4).unwrap();
    let mut samples = Vec::new();
    for number in 0..lines {
        let mut line = LineBuilder::new();
        for i in 0..SHOTS_PER_LINE {
            let shot = number * SHOTS_PER_LINE + i;
            let scan_angle_deg = 60.0 * (i as f64 / SHOTS_PER_LINE as f64 - 0.5);
            let (sin, cos) = scan_angle_deg.to_radians().sin_cos();
            line.shot(&ContainerShot {
                shot: shot as u64,
                line: number as u32,
                gps_time_s: Some(START_S + shot as f64 / PULSE_RATE_HZ),
                clock_ps: (shot as f64 / PULSE_RATE_HZ * 1e12) as i64,
                origin_m: [0.0; 3],
                direction: [0.0, sin as f32, cos as f32].map(f32::into),
                facet: 0,
                flags: 0,
                mta_zone: Some(1),
                scan_angle_deg: Some(scan_angle_deg as f32),
                frame_scale: None,
            });
            samples.clear();
            waveforms.next(&mut samples);
            let start_ns = (700.0 / cos / 0.149_85).floor();
            let block = ContainerBlock {
                channel: channel::HIGH_POWER,
                start_ns,
                interval_ns: None,
                zone: None,
                gain: None,
                samples: &samples,
            };
            line.block(&block);
        }
        writer.write(line).unwrap();
    }
    writer.finish().unwrap().into_inner().unwrap();
}

fn job(calibrate: &str) -> String {
    format!(
        "[job]\nthreads = {THREADS}\n[job.geometry]\ntrajectory = '*.out'\ncrs = 'utm'\n\
         [[stage]]\ntype = 'read_arrow'\npath = '*.arrow'\n{calibrate}\
         [[stage]]\ntype = 'decompose'\n[[stage]]\ntype = 'georeference'\n\
         [[stage]]\ntype = 'write_las'\npath = '*.laz'\n[[stage]]\ntype = 'write_lstat'\n"
    )
}

/// Lines of [`SHOTS_PER_LINE`] waveforms of close echoes.
const CLOSE_LINES: usize = 100;

/// Measures a recording with and without calibration.
fn scene(name: &str, folder: &Path) {
    let first = run(folder, &job(&format!("{CALIBRATE}save = '*_model.json'\n")));
    let saved = run(folder, &job(&format!("{CALIBRATE}load = 'flight_model.json'\n")));
    print_scene(name, folder, Some(&saved), &first);
}

/// Runs the scenes of `simulate`, close echoes, and the real recording.
fn scenes(folder: &Path) {
    println!(
        "\n{:<16}{:>14}{:>14}{:>12}{:>16}",
        "scene", "M wf/s saved", "calibrating", "returns/wf", "to scalar, %"
    );
    for (name, keys) in SCENES {
        let folder = folder.join(name);
        fs::create_dir_all(&folder).unwrap();
        let recording = format!(
            "[[stage]]\ntype = 'simulate'\nstem = 'flight'\nlandscape = 'country'\nlines = {SCENE_LINES}\n\
             high_power = true\nsbet = '*.out'\n{keys}\n[[stage]]\ntype = 'write_arrow'\npath = '*.arrow'\n"
        );
        run(&folder, &recording);
        scene(name, &folder);
    }
    let close = folder.join("close echoes");
    fs::create_dir_all(&close).unwrap();
    write_recording(&close.join("flight.arrow"), CLOSE_LINES, Scene::Close);
    write_trajectory(&close.join("flight.out"), (CLOSE_LINES * SHOTS_PER_LINE) as f64 / PULSE_RATE_HZ);
    scene("close echoes", &close);
    let Some(data) = std::env::var_os("WAVEX_DATA") else {
        println!("skipped: WAVEX_DATA not set: no real recording");
        return;
    };
    let folder = folder.join("real");
    fs::create_dir_all(&folder).unwrap();
    let path = Path::new(&data).join(REAL).with_extension("pls");
    let job = |calibrate: &str| {
        format!(
            "[job]\nthreads = {THREADS}\n[[stage]]\ntype = 'read_pulsewaves'\npath = '{}'\n{calibrate}\
             [[stage]]\ntype = 'decompose'\n[[stage]]\ntype = 'georeference'\n\
             [[stage]]\ntype = 'write_las'\npath = '*.laz'\n",
            path.display()
        )
    };
    let first = run(&folder, &job(&format!("{CALIBRATE}save = 'model.json'\n")));
    let saved = run(&folder, &job(&format!("{CALIBRATE}load = 'model.json'\n")));
    print_scene("riegl_example3", &folder, Some(&saved), &first);
}

/// Lines of [`SHOTS_PER_LINE`] waveforms of the comparison of stages with their work.
const STAGE_LINES: usize = 1000;

/// Prints the overhead of stages.
fn stages(folder: &Path) {
    let folder = folder.join("stages");
    fs::create_dir_all(&folder).unwrap();
    println!("\n{:<44}{:>10}{:>10}{:>10}", "ns per waveform, one thread", "stage", "work", "overhead");
    let print_row = |name: &str, stage_ns: f64, work_ns: f64| {
        println!("{name:<44}{stage_ns:>10.0}{work_ns:>10.0}{:>10.0}", stage_ns - work_ns);
    };
    write_recording(&folder.join("flight.arrow"), STAGE_LINES, Scene::One);
    let waveforms = (STAGE_LINES * SHOTS_PER_LINE) as f64;
    let job = |calibrate: &str, mode: &str| {
        format!(
            "[job]\nthreads = 1\n[[stage]]\ntype = 'read_arrow'\npath = 'flight.arrow'\n{calibrate}\
             [[stage]]\ntype = 'decompose'\nmode = '{mode}'\n[[stage]]\ntype = 'write_lstat'\n"
        )
    };
    run(&folder, &job(&format!("{CALIBRATE}save = 'model.json'\n"), "fastest"));
    let model: SensorModel = serde_json::from_slice(&fs::read(folder.join("model.json")).unwrap()).unwrap();
    let model = model.high_power.unwrap();
    let load = format!("{CALIBRATE}load = 'model.json'\n");
    for (name, mode) in [("fastest", Mode::Fastest), ("refined", Mode::Refined)] {
        let stage_ns = least_working_s(&folder, &job(&load, name), "decompose") * 1e9 / waveforms;
        let kernels_ns = kernels_ns(&model, Scene::One, mode);
        print_row(&format!("decompose, {name}, one echo"), stage_ns, kernels_ns);
        let ran = run(&folder, &job(&load, name));
        print_row(&format!("whole run, {name}, processor time"), ran.cpu_s * 1e9 / waveforms, kernels_ns);
    }
    let bytes = fs::read(folder.join("flight.arrow")).unwrap();
    let stage_ns = least_working_s(&folder, &job(&load, "fastest"), "read_arrow") * 1e9 / waveforms;
    print_row("read_arrow, LZ4", stage_ns, copy_ns(&bytes) / waveforms);
    let Some(data) = std::env::var_os("WAVEX_DATA") else {
        println!("skipped: WAVEX_DATA not set: no PulseWaves");
        return;
    };
    let path = Path::new(&data).join(REAL).with_extension("pls");
    let job = format!(
        "[job]\nthreads = 1\n[[stage]]\ntype = 'read_pulsewaves'\npath = '{}'\n[[stage]]\ntype = 'write_lstat'\n",
        path.display()
    );
    // The first line includes the look-ahead for the source of emission times.
    let stage_ns = 1e3
        * least_of(
            &folder,
            &job,
            |stage| {
                let us = stage["line_us"]["p50"].as_f64().unwrap();
                let shots =
                    stage["items_out"]["shots"].as_f64().unwrap() / stage["lines_out"].as_f64().unwrap();
                us / shots
            },
            "read_pulsewaves",
        );
    let [pulses, waves] = ["pls", "wvs"].map(|ending| fs::read(path.with_extension(ending)).unwrap());
    let records = pulses.len() as f64 / 48.0;
    print_row(
        "read_pulsewaves, riegl_example3, per pulse",
        stage_ns,
        copy_ns(&[pulses, waves].concat()) / records,
    );
}

/// Prints the time of `calibrate` for recordings of different length.
fn calibrations(folder: &Path) {
    let folder = folder.join("calibrations");
    fs::create_dir_all(&folder).unwrap();
    println!(
        "\n{:<14}{:>11}{:>15}{:>20}{:>21}",
        "scene", "waveforms", "calibrate, ms", "us per waveform", "times `decompose`"
    );
    let job = "[job]\nthreads = 1\n[[stage]]\ntype = 'read_arrow'\npath = 'flight.arrow'\n\
               [[stage]]\ntype = 'calibrate'\n[[stage]]\ntype = 'decompose'\n\
               [[stage]]\ntype = 'write_lstat'\n";
    for (name, scene) in [("one echo", Scene::One), ("mixed", Scene::Mixed), ("close echoes", Scene::Close)] {
        for lines in [2, 20, 200] {
            write_recording(&folder.join("flight.arrow"), lines, scene);
            let [calibrate_s, decompose_s] =
                ["calibrate", "decompose"].map(|stage| least_working_s(&folder, job, stage));
            let waveforms = lines * SHOTS_PER_LINE;
            println!(
                "{name:<14}{waveforms:>11}{:>15.0}{:>20.1}{:>21.1}",
                1e3 * calibrate_s,
                1e6 * calibrate_s / waveforms as f64,
                calibrate_s / decompose_s
            );
        }
    }
}

/// Least working time of a stage in several runs, s.
fn least_working_s(folder: &Path, job: &str, stage: &str) -> f64 {
    least_of(folder, job, |stage| stage["working_s"].as_f64().unwrap(), stage)
}

/// Least value of a stage's entry of the report in several runs.
fn least_of(folder: &Path, job: &str, value: impl Fn(&Value) -> f64, stage: &str) -> f64 {
    let measured = || {
        run(folder, job);
        let report = fs::read(folder.join("job_report.json")).unwrap();
        let report: Value = serde_json::from_slice(&report).unwrap();
        let stages = report["inputs"][0]["stages"].as_array().unwrap();
        value(stages.iter().find(|entry| entry["type"] == stage).unwrap())
    };
    (0..5).map(|_| measured()).fold(f64::INFINITY, f64::min)
}

/// Time to copy bytes, ns.
fn copy_ns(bytes: &[u8]) -> f64 {
    let mut copy = vec![0; bytes.len()];
    let mut run = || {
        let started = Instant::now();
        copy.copy_from_slice(std::hint::black_box(bytes));
        std::hint::black_box(&mut copy);
        started.elapsed().as_secs_f64() * 1e9
    };
    (0..9).map(|_| run()).fold(f64::INFINITY, f64::min)
}

/// Prints the figures of a scene from the report of its last run.
fn print_scene(name: &str, folder: &Path, saved: Option<&Ran>, first: &Ran) {
    let report: Value = serde_json::from_slice(&fs::read(folder.join("job_report.json")).unwrap()).unwrap();
    let stages = report["inputs"][0]["stages"].as_array().unwrap();
    let decompose = stages.iter().find(|stage| stage["type"] == "decompose").unwrap();
    let of = |name: &str| {
        let observed = &decompose["observed"][name];
        observed["count"].as_f64().unwrap_or(0.0) * observed["mean"].as_f64().unwrap_or(0.0)
    };
    let waveforms = decompose["observed"]["returns_per_waveform"]["count"].as_f64().unwrap();
    let rate = |ran: &Ran| waveforms / ran.seconds * 1e-6;
    println!(
        "{name:<16}{:>14.3}{:>14.3}{:>12.2}{:>16.2}",
        saved.map_or(f64::NAN, rate),
        rate(first),
        of("returns_per_waveform") / waveforms,
        100.0 * of("left_to_plain_kernels") / waveforms
    );
}

/// Measurements of a run.
struct Ran {
    seconds: f64,
    /// Processor time of all threads.
    cpu_s: f64,
    peak_mb: f64,
    said: String,
}

/// Runs `wavex run` in a folder.
fn run(folder: &Path, job: &str) -> Ran {
    fs::write(folder.join("job.toml"), job).unwrap();
    let started = Instant::now();
    let mut child = Command::new(env!("CARGO_BIN_EXE_wavex"))
        .args(["run", "--profile", "--progress", "never", "job.toml"])
        .current_dir(folder)
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let status = format!("/proc/{}/status", child.id());
    let times = format!("/proc/{}/stat", child.id());
    let (mut peak_kb, mut ticks) = (0.0, 0.0);
    while child.try_wait().unwrap().is_none() {
        let text = fs::read_to_string(&status).unwrap_or_default();
        let peak = text.lines().find_map(|line| line.strip_prefix("VmHWM:"));
        peak_kb = peak.and_then(|peak| peak.trim().strip_suffix(" kB")?.parse().ok()).unwrap_or(peak_kb);
        ticks = ticks_of(&fs::read_to_string(&times).unwrap_or_default()).unwrap_or(ticks);
        std::thread::sleep(Duration::from_millis(5));
    }
    let seconds = started.elapsed().as_secs_f64();
    let output = child.wait_with_output().unwrap();
    assert!(output.status.success(), "the run failed");
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    Ran { seconds, cpu_s: ticks / TICKS_PER_S, peak_mb: peak_kb / 1024.0, said }
}

/// Unit of the times in `/proc/PID/stat`; the same on all systems that Linux runs on today.
const TICKS_PER_S: f64 = 100.0;

/// Processor time in the text of `/proc/PID/stat`: the 14th and 15th field, user and system.
fn ticks_of(stat: &str) -> Option<f64> {
    // The second field, the name of the program, can contain spaces.
    let mut rest = stat.rsplit_once(')')?.1.split_whitespace().skip(11);
    let mut next = || rest.next()?.parse::<f64>().ok();
    Some(next()? + next()?)
}

/// Returns the records of a LAZ file and their LASzip record (LAS 1.4 specification, public header
/// block).
fn records(path: &Path) -> (Vec<u8>, LazVlr) {
    let bytes = fs::read(path).unwrap();
    let u16_at = |at: usize| usize::from(u16::from_le_bytes([bytes[at], bytes[at + 1]]));
    let u32_at = |at: usize| u16_at(at) + (u16_at(at + 2) << 16);
    let (points_at, record, points) = (u32_at(96), u16_at(105), u32_at(247));
    let mut at = u16_at(94);
    let vlr = loop {
        let (length, id) = (u16_at(at + 20), u16_at(at + 18));
        if bytes[at + 2..].starts_with(b"laszip encoded") && id == 22204 {
            break LazVlr::from_buffer(&bytes[at + 54..at + 54 + length]).unwrap();
        }
        at += 54 + length;
    };
    let mut from = Cursor::new(&bytes);
    from.set_position(points_at as u64);
    let mut records = vec![0; record * points];
    LasZipDecompressor::new(from, vlr.clone()).unwrap().decompress_many(&mut records).unwrap();
    (records, vlr)
}

/// Returns the duration of compressing the records, s.
fn compress(records: &[u8], vlr: &LazVlr) -> f64 {
    let out = Cursor::new(Vec::with_capacity(records.len()));
    let mut compressor = LasZipCompressor::new(out, vlr.clone()).unwrap();
    let started = Instant::now();
    compressor.compress_many(records).unwrap();
    compressor.done().unwrap();
    started.elapsed().as_secs_f64()
}

/// Returns the yardstick's time for mode `refined` on a waveform of the mixed scene, ns.
///
/// It adds up detection for all waveforms, complete single returns, joint fits of two and three
/// returns with eight iterations from two starts, a residual search, and split tests for 7 %.
fn yardstick_ns() -> Option<f64> {
    let script = std::env::var_os("WAVEX_YARDSTICK")?;
    let text = String::from_utf8(Command::new(script).output().ok()?.stdout).ok()?;
    let ns = |parts: &[&str]| -> Option<f64> {
        let line = text.lines().find(|line| parts.iter().all(|part| line.contains(part)))?;
        line.split("wf/s (").nth(1)?.split_whitespace().next()?.parse().ok()
    };
    let detect = ns(&["detect, one return"])?;
    let one = ns(&["whole single:", "GN full 4 it"])?;
    let (two, three_in_four) = (ns(&["2-peak", " 8 it"])?, ns(&["3-peak", " 4 it"])?);
    let three = three_in_four * two / ns(&["2-peak", " 4 it"])?;
    let fits = 0.15 * detect + 0.55 * one + 0.2 * (detect + 2.0 * two) + 0.1 * (detect + 2.0 * three);
    Some(fits + 0.85 * detect + 0.07 * two)
}

/// Returns the time of the kernels of `decompose` for a waveform of a scene, ns.
///
/// The minimum of several runs on one thread.
fn kernels_ns(model: &ChannelModel, scene: Scene, mode: Mode) -> f64 {
    let noise = noise();
    let mut waveforms = Waveforms::new(&true_model(&noise), &noise, scene, 9);
    let mut samples = Vec::new();
    for _ in 0..10 * SHOTS_PER_LINE {
        waveforms.next(&mut samples);
    }
    let blocks: Vec<_> = samples.chunks(SAMPLES).map(|samples| Waveform { samples }).collect();
    let tables = Tables::new(model).map(Arc::new);
    let (settings, path) = (DecomposeSettings::default(), SimdLevel::best());
    let mut kernels = BatchDecomposer::new(model, tables, &settings, mode, path).unwrap();
    let mut outcomes = Decompositions::default();
    let mut run = || {
        let started = Instant::now();
        blocks.chunks(SHOTS_PER_LINE).for_each(|line| kernels.decompose(line, &mut outcomes));
        started.elapsed().as_secs_f64() * 1e9 / blocks.len() as f64
    };
    (0..9).map(|_| run()).fold(f64::INFINITY, f64::min)
}

/// Measures and prints a part of the bench in a folder.
type Measure = fn(&Path);

fn main() {
    let folder = std::env::temp_dir().join(format!("wavex-bench-chain-{}", std::process::id()));
    let parts: [(&str, Measure); 4] =
        [("mixed", mixed_scene), ("scenes", scenes), ("stages", stages), ("calibrations", calibrations)];
    let is_asked = |part: &str| std::env::args().any(|argument| argument == part);
    let asks = parts.iter().any(|(part, _)| is_asked(part));
    for (_, measure) in parts.iter().filter(|(part, _)| !asks || is_asked(part)) {
        measure(&folder);
    }
    // A failure to remove the temporary folder is harmless.
    if std::env::var_os("WAVEX_BENCH_KEEP").is_none() {
        let _ = fs::remove_dir_all(&folder);
    }
}

/// Runs the mixed scene and compares it with the ceilings.
fn mixed_scene(folder: &Path) {
    let told = std::env::args().skip(1).find_map(|argument| argument.parse::<usize>().ok());
    let lines = told.unwrap_or(WAVEFORMS) / SHOTS_PER_LINE;
    let mut ran = Vec::new();
    for (name, lines) in [("tenth", lines / 10), ("whole", lines)] {
        let folder = folder.join(name);
        fs::create_dir_all(&folder).unwrap();
        write_recording(&folder.join("flight.arrow"), lines, Scene::Mixed);
        write_trajectory(&folder.join("flight.out"), (lines * SHOTS_PER_LINE) as f64 / PULSE_RATE_HZ);
        ran.push(run(&folder, &job(&format!("{CALIBRATE}save = '*_model.json'\n"))));
    }
    let whole = folder.join("whole");
    let with_model = job(&format!("{CALIBRATE}load = 'flight_model.json'\n"));
    let [tenth, loaded] = ["tenth", "whole"].map(|name| run(&folder.join(name), &with_model));
    let waveforms = (lines * SHOTS_PER_LINE) as f64;
    println!("{}", loaded.said);
    println!("{waveforms} waveforms, {THREADS} threads");
    println!("with calibration         {:6.3} M waveforms/s", waveforms / ran[1].seconds * 1e-6);
    let rate = waveforms / loaded.seconds * 1e-6;
    let of_tenth = (lines / 10 * SHOTS_PER_LINE) as f64 / tenth.seconds * 1e-6;
    println!("with the saved model     {rate:6.3} M waveforms/s; a tenth of the waveforms {of_tenth:.3}");
    println!(
        "cores kept busy          {:6.2} of {THREADS}, goal {GOAL_BUSY}; {:.2} us of processor time per waveform",
        loaded.cpu_s / loaded.seconds,
        loaded.cpu_s * 1e6 / waveforms
    );
    println!(
        "peak memory              {:6.0} MB; a tenth of the waveforms {:.0} MB",
        ran[1].peak_mb, ran[0].peak_mb
    );
    let (records, vlr) = records(&whole.join("flight.laz"));
    let points = records.len() as f64 / f64::from(vlr.items_size() as u32);
    let laz_ns = compress(&records, &vlr) * 1e9 / waveforms;
    println!("{:.3} points per waveform; compressing alone {laz_ns:.0} ns per waveform", points / waveforms);
    let georeference_ns = GEOREFERENCE_NS * points / waveforms;
    let print_ceiling = |by: &str, decompose_ns: f64| {
        let ceiling = THREADS as f64 * 1e3 / (decompose_ns + laz_ns + georeference_ns);
        println!(
            "ceiling from {by:<13} {ceiling:6.3} M waveforms/s (decomposition {decompose_ns:.0} \
             ns, LAZ {laz_ns:.0}, georeferencing {georeference_ns:.0}); reached {:.2} of it, goal \
             {GOAL}",
            rate / ceiling
        );
    };
    print_ceiling("our kernels", kernels_ns(&true_model(&noise()), Scene::Mixed, Mode::Refined));
    match yardstick_ns() {
        Some(decompose_ns) => print_ceiling("the yardstick", decompose_ns),
        None => println!("NO YARDSTICK: set WAVEX_YARDSTICK to its run script."),
    }
}

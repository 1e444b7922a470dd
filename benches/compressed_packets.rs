//! Speed of decoding compressed waveform packets (`.wdz`).
//!
//! MB of samples per core-second, by thread CPU time, medians, next to the decoder of the crate `laz`. The
//! packets are those of a recording if `WAVEX_DATA` is set, as stored (8 bits) and with noise in four
//! further bits (16 bits), else made ones. `cargo bench --bench compressed_packets` prints a table. If
//! `WAVEX_YARDSTICK` names the run script of the yardstick, waveforms of 60 samples per waveform of the
//! yardstick ("detect, two returns") are printed as well. Goal: 100 MB/s.
#![allow(clippy::print_stdout, clippy::panic, reason = "a bench prints its figures and panics on failure")]

use std::fs;
use std::path::Path;
use std::process::Command;

use wavex_formats::las::{Point, Reader, Wave};
use wavex_testkit::clock::cpu_s;
use wavex_testkit::compression::packet;
use wavex_testkit::las::{Las, descriptor, vlr};
use wavex_testkit::shots::echo;

const RUNS: usize = 9;
const GOAL_MB_PER_S: f64 = 100.0;
/// Number of waveforms, if they are made.
const MADE: usize = 5000;
/// Samples of a waveform of the yardstick.
const YARDSTICK_SAMPLES: f64 = 60.0;

/// Waveforms of 8 bits.
fn waveforms() -> Vec<Vec<u16>> {
    let recording = std::env::var_os("WAVEX_DATA")
        .map(|data| Path::new(&data).join("las_compressed/fwf_uncompressed.las"))
        .filter(|path| path.is_file());
    let Some(path) = recording else {
        return (0..MADE).map(|shot| echo(shot).into_iter().map(u16::from).collect()).collect();
    };
    let mut reader = Reader::open(&path).unwrap_or_else(|error| panic!("{error}"));
    let (mut point, mut all) = (Point::default(), Vec::new());
    while reader.next_point(&mut point).is_ok_and(|found| found) {
        let mut samples = Vec::new();
        if reader.packet(&point.wave, &mut samples).is_ok() {
            all.push(samples);
        }
    }
    all
}

/// Writes a recording with these packets into a folder.
fn write(folder: &Path, bits: u8, waveforms: &[Vec<u16>]) {
    let mut las = Las::new(waveforms.len());
    las.vlrs[0] = vlr("LASF_Spec", 100, &descriptor(bits, waveforms[0].len() as u32, 1000));
    las.vlrs[0][54 + 1] = 1;
    las.packets.truncate(60);
    las.packets[20..28].fill(0);
    for (point, samples) in las.points.iter_mut().zip(waveforms) {
        let packet = packet(bits, samples);
        point[31..39].copy_from_slice(&(las.packets.len() as u64).to_le_bytes());
        point[39..43].copy_from_slice(&(packet.len() as u32).to_le_bytes());
        las.packets.extend(packet);
    }
    fs::write(folder.join("a.las"), las.las()).unwrap_or_else(|error| panic!("{error}"));
    fs::write(folder.join("a.wdz"), las.packets).unwrap_or_else(|error| panic!("{error}"));
}

/// Median duration of several runs, s.
fn duration_s(mut work: impl FnMut()) -> f64 {
    let mut durations: Vec<f64> = (0..RUNS)
        .map(|_| {
            let before = cpu_s();
            work();
            cpu_s() - before
        })
        .collect();
    durations.sort_by(f64::total_cmp);
    durations[RUNS / 2]
}

/// Decodes the packets with the crate `laz`.
fn decode_with_laz(bits: u8, packets: &[Vec<u8>], samples: usize) -> i32 {
    let mut last = 0;
    for packet in packets {
        let mut decoder = laz::decoders::ArithmeticDecoder::new(&packet[usize::from(bits / 8)..]);
        decoder.read_init_bytes().unwrap_or_else(|error| panic!("{error}"));
        let mut numbers = laz::decompressors::IntegerDecompressor::new(bits.into(), 1, 8, 0);
        numbers.init();
        for _ in 1..samples {
            last = numbers.decompress(&mut decoder, last, 0).unwrap_or_else(|error| panic!("{error}"));
        }
    }
    last
}

/// The yardstick's time for a waveform, ns.
fn yardstick_ns() -> Option<f64> {
    let script = std::env::var_os("WAVEX_YARDSTICK")?;
    let text = String::from_utf8(Command::new(script).output().ok()?.stdout).ok()?;
    let line = text.lines().find(|line| line.contains("detect, two returns"))?;
    line.split("wf/s (").nth(1)?.split_whitespace().next()?.parse().ok()
}

fn main() {
    let stored = waveforms();
    let mut noise = 1u64;
    let mut with_noise = |sample: &u16| {
        noise = noise.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        16 * sample + (noise >> 60) as u16
    };
    let finer: Vec<Vec<u16>> =
        stored.iter().map(|samples| samples.iter().map(&mut with_noise).collect()).collect();
    for (bits, waveforms) in [(8, &stored), (16, &finer)] {
        let folder = tempfile::tempdir().unwrap_or_else(|error| panic!("{error}"));
        write(folder.path(), bits, waveforms);
        let mut reader = Reader::open(&folder.path().join("a.las")).unwrap_or_else(|error| panic!("{error}"));
        let (mut point, mut waves): (Point, Vec<Wave>) = (Point::default(), Vec::new());
        while reader.next_point(&mut point).is_ok_and(|found| found) {
            waves.push(point.wave);
        }
        let mut samples = Vec::new();
        let ours_s = duration_s(|| {
            for (wave, expected) in waves.iter().zip(waveforms) {
                reader.packet(wave, &mut samples).unwrap_or_else(|error| panic!("{error}"));
                assert_eq!(&samples, expected);
            }
        });
        let packets: Vec<Vec<u8>> = waveforms.iter().map(|samples| packet(bits, samples)).collect();
        let length = waveforms[0].len();
        let laz_s = duration_s(|| {
            std::hint::black_box(decode_with_laz(bits, &packets, length));
        });
        let count = (waveforms.len() * length) as f64;
        let mb = count * f64::from(bits / 8) / 1e6;
        let packed = packets.iter().map(Vec::len).sum::<usize>() as f64 * 8.0 / count;
        let verdict = if mb / ours_s >= GOAL_MB_PER_S { "reached" } else { "MISSED" };
        println!(
            "{bits:2} bits ({packed:.1} compressed): {:6.1} MB/s of samples, {:5.1} ns per sample, laz {:6.1} MB/s, goal \
             {GOAL_MB_PER_S} {verdict}",
            mb / ours_s,
            1e9 * ours_s / count,
            mb / laz_s
        );
        if let Some(yardstick_ns) = yardstick_ns() {
            let ratio = yardstick_ns / (YARDSTICK_SAMPLES * 1e9 * ours_s / count);
            println!("   waveforms of 60 samples per waveform of the yardstick: {ratio:.3}");
        }
    }
}

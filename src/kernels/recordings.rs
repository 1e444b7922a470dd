//! The plain form on real recordings, found through `WAVEX_DATA`.

use std::io::Read;
use std::path::PathBuf;

use super::calibrate::{Block, CalibrationSettings, calibrate};
use super::decompose::{DecomposeSettings, Decomposer};

fn data(name: &str) -> Option<PathBuf> {
    let Some(folder) = std::env::var_os("WAVEX_DATA") else {
        println!("skipped: WAVEX_DATA not set");
        return None;
    };
    Some(PathBuf::from(folder).join(name))
}

/// Sample lines of a text dump of PulseWaves, by kind of sampling (1 outgoing, 2 returning).
fn segments(path: &std::path::Path, kind: &str) -> Vec<Vec<u16>> {
    let mut text = String::new();
    flate2::read::GzDecoder::new(std::fs::File::open(path).unwrap()).read_to_string(&mut text).unwrap();
    text.lines()
        .filter_map(|line| line.strip_prefix("S "))
        .filter_map(|line| line.split_once(':'))
        .filter(|(head, _)| head.split_whitespace().nth(1) == Some(kind))
        .map(|(_, samples)| samples.split_whitespace().map(|s| s.parse().unwrap()).collect())
        .collect()
}

fn blocks(segments: &[Vec<u16>]) -> impl Iterator<Item = Block<'_>> + Clone {
    segments.iter().map(|samples| Block { samples, start_phase: 0 })
}

#[test]
fn explore() {
    let Some(path) = data("pulsewaves/riegl_example3.txt.gz") else { return };
    if std::env::var_os("NEON").is_none() {
        for (kind, settings) in [
            ("2", CalibrationSettings::echoes(1.0, 255.0)),
            ("1", CalibrationSettings::reference(1.0, 255.0)),
        ] {
            let segments = segments(&path, kind);
            println!("{} segments", segments.len());
            let t = std::time::Instant::now();
            let model = calibrate(blocks(&segments), &settings).unwrap();
            println!("{model:?} {:.1} us", t.elapsed().as_secs_f64() * 1e6 / segments.len() as f64);
            for (split, add) in [(None, 0), (None, 16), (Some(16.0), 16)] {
                let mut d = Decomposer::new(
                    &model,
                    &DecomposeSettings {
                        split_evidence: split,
                        max_added: add,
                        ..DecomposeSettings::default()
                    },
                    80,
                )
                .unwrap();
                let t = std::time::Instant::now();
                let mut n = 0;
                let mut dev = vec![];
                let mut after = 0;
                for s in &segments {
                    let o = d.decompose(s, 0);
                    n += o.returns.len();
                    if o.returns.len() == 1 {
                        dev.push(o.deviation_ratio());
                    }
                    for i in 1..o.returns.len() {
                        let dt = o.returns[i].position_samples - o.returns[i - 1].position_samples;
                        if (9.0..12.5).contains(&dt)
                            && o.returns[i].amplitude_dn < 0.1 * o.returns[i - 1].amplitude_dn
                        {
                            after += 1;
                        }
                    }
                }
                dev.sort_by(f64::total_cmp);
                println!(
                    "{split:?} {add}: {n} returns, after-pulses {after}, {} singles median dev {:?} {:.1} us",
                    dev.len(),
                    dev.get(dev.len() / 2),
                    t.elapsed().as_secs_f64() * 1e6 / segments.len() as f64
                );
            }
        }
    }
    let csv = std::fs::read_to_string(data("neon/return_1_250.csv").unwrap()).unwrap();
    let segments: Vec<Vec<u16>> = csv
        .lines()
        .skip(1)
        .map(|l| {
            let mut v: Vec<u16> = l.split(',').map(|s| s.parse().unwrap_or(0)).collect();
            while v.last() == Some(&0) {
                v.pop();
            }
            v
        })
        .collect();
    println!(
        "neon {} lengths {:?}",
        segments.len(),
        segments.iter().take(20).map(Vec::len).collect::<Vec<_>>()
    );
    let t = std::time::Instant::now();
    let model = calibrate(blocks(&segments), &CalibrationSettings::echoes(1.0, 4095.0)).unwrap();
    println!("{model:?} {:.1} us", t.elapsed().as_secs_f64() * 1e6 / segments.len() as f64);
    for split in [None, Some(16.0)] {
        let mut d = Decomposer::new(
            &model,
            &DecomposeSettings { split_evidence: split, ..DecomposeSettings::default() },
            80,
        )
        .unwrap();
        let r = std::fs::read_to_string(data("neon/decomposition_1_250.csv").unwrap()).unwrap();
        let rows: Vec<(usize, f64, f64)> = r
            .lines()
            .skip(1)
            .map(|l| {
                let f: Vec<f64> = l.split(',').map(|x| x.parse().unwrap_or(f64::NAN)).collect();
                (f[0] as usize, f[2], f[1])
            })
            .collect();
        let mut diffs = vec![];
        let mut total = 0;
        let (mut w3, mut w1) = (0, 0);
        let mut one = 0;
        let mut singles = 0;
        let t = std::time::Instant::now();
        for (i, s) in segments.iter().enumerate() {
            let o = d.decompose(s, 0);
            total += o.returns.len();
            let theirs: Vec<_> = rows.iter().filter(|r| r.0 == i + 1).collect();
            for t in &theirs {
                let m = o
                    .returns
                    .iter()
                    .map(|r| (r.position_samples + 1.0 - t.1).abs())
                    .fold(f64::INFINITY, f64::min);
                if m < 3.0 {
                    w3 += 1
                }
                if m < 1.0 {
                    w1 += 1
                }
            }
            if theirs.len() == 1 {
                singles += 1;
                if o.returns.len() == 1 {
                    one += 1;
                }
                if let Some(r) = o.returns.iter().max_by(|a, b| a.amplitude_dn.total_cmp(&b.amplitude_dn)) {
                    diffs.push(r.position_samples - theirs[0].1);
                }
            }
        }
        diffs.sort_by(f64::total_cmp);
        let med = diffs[diffs.len() / 2];
        println!(
            "neon {} theirs {total} ours; within 3: {w3}, 1: {w1}; single waveforms {singles} ours one {one}; median {med} within .25: {}, .5: {}, 1 {} {:.1} us",
            rows.len(),
            diffs.iter().filter(|d| (*d - med).abs() < 0.25).count(),
            diffs.iter().filter(|d| (*d - med).abs() < 0.5).count(),
            diffs.iter().filter(|d| (*d - med).abs() < 1.0).count(),
            t.elapsed().as_secs_f64() * 1e6 / segments.len() as f64
        );
    }
}
#[test]
fn explore_neon() {
    use super::sensor_model::{Background, ChannelModel};
    let Some(path) = data("neon/return_1_250.csv") else { return };
    let csv = std::fs::read_to_string(path).unwrap();
    let segments: Vec<Vec<u16>> = csv
        .lines()
        .skip(1)
        .map(|l| {
            let mut v: Vec<u16> = l.split(',').map(|s| s.parse().unwrap_or(0)).collect();
            while v.last() == Some(&0) {
                v.pop();
            }
            v
        })
        .collect();
    let r = std::fs::read_to_string(data("neon/decomposition_1_250.csv").unwrap()).unwrap();
    let rows: Vec<(usize, f64, f64)> = r
        .lines()
        .skip(1)
        .map(|l| {
            let f: Vec<f64> = l.split(',').map(|x| x.parse().unwrap_or(f64::NAN)).collect();
            (f[0] as usize, f[2], f[1])
        })
        .collect();
    for (bg, sd, fwhm, bsd, maxr, maxa) in [
        (212.0, 1.8, 18.0, 15.0, 1, 0),
        (212.0, 1.8, 18.0, 5.0, 1, 0),
        (212.0, 1.8, 18.0, 15.0, 24, 0),
        (212.0, 1.8, 18.0, 5.0, 24, 0),
        (212.0, 1.8, 15.0, 5.0, 24, 0),
        (212.0, 1.8, 18.0, 5.0, 24, 16),
        (212.0, 3.6, 18.0, 5.0, 24, 16),
        (212.0, 8.0, 18.0, 5.0, 24, 16),
        (212.0, 8.0, 18.0, 5.0, 24, 0),
        (212.0, 20.0, 18.0, 5.0, 24, 0),
        (212.0, 20.0, 18.0, 5.0, 24, 16),
    ] {
        let model = ChannelModel {
            sampling_interval_ns: 1.0,
            full_scale_dn: 4095.0,
            background: Background::PerWaveform,
            background_dn: [bg; 4],
            background_sd_dn: bsd,
            noise_sd_dn: sd,
            autocorrelation: vec![],
            ar: vec![],
            innovation_sd_dn: sd,
            pulse_fwhm_ns: fwhm,
            pulse_fwhm_sd_ns: 0.0,
            waveforms: 1,
            pulses: 1,
        };
        let mut d = Decomposer::new(
            &model,
            &DecomposeSettings {
                split_evidence: None,
                max_returns: maxr,
                max_added: maxa,
                ..DecomposeSettings::default()
            },
            80,
        )
        .unwrap();
        let mut diffs = vec![];
        let mut total = 0;
        let (mut w3, mut w1) = (0, 0);
        let mut one = 0;
        let mut res = vec![];
        let mut offs = vec![];
        for (i, s) in segments.iter().enumerate() {
            let o = d.decompose(s, 0);
            total += o.returns.len();
            res.push((o.chi_square / o.degrees_of_freedom() as f64).sqrt() * sd);
            offs.push(o.background_offset_dn);
            let theirs: Vec<_> = rows.iter().filter(|r| r.0 == i + 1).collect();
            for t in &theirs {
                let m = o
                    .returns
                    .iter()
                    .map(|r| (r.position_samples + 1.0 - t.1).abs())
                    .fold(f64::INFINITY, f64::min);
                if m < 3.0 {
                    w3 += 1
                }
                if m < 1.0 {
                    w1 += 1
                }
            }
            if theirs.len() == 1 {
                if o.returns.len() == 1 {
                    one += 1;
                }
                if let Some(r) = o.returns.iter().max_by(|a, b| a.amplitude_dn.total_cmp(&b.amplitude_dn)) {
                    diffs.push(r.position_samples - theirs[0].1);
                }
            }
        }
        diffs.sort_by(f64::total_cmp);
        res.sort_by(f64::total_cmp);
        offs.sort_by(f64::total_cmp);
        let med = diffs[diffs.len() / 2];
        println!(
            "bg {bg} sd {sd} fwhm {fwhm} bsd {bsd} max {maxr} add {maxa}: ours {total}; within 3: {w3}, 1: {w1}; ours one {one}; n {} median {med} within .25: {}, .5: {}, 1 {} res {} off {:?}",
            diffs.len(),
            diffs.iter().filter(|d| (*d - med).abs() < 0.25).count(),
            diffs.iter().filter(|d| (*d - med).abs() < 0.5).count(),
            diffs.iter().filter(|d| (*d - med).abs() < 1.0).count(),
            res[125],
            [0.1, 0.5, 0.9].map(|q| offs[(q * 250.0) as usize])
        );
    }
}

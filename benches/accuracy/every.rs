//! Every return of mixed waveforms: merged, clipped and misfitting ones included.

use super::*;

/// Limits of the bins by signal-to-noise ratio and by absolute deviation ratio.
const SNR: [f64; 6] = [4.0, 8.0, 15.0, 30.0, 60.0, 150.0];
const DEVIATION: [f64; 5] = [0.0, 1.0, 2.0, 3.0, 1e9];
/// Fewest returns of a bin with a goal.
const ENOUGH: usize = 200;

/// A return against the nearest echo.
struct Found {
    snr: f64,
    deviation_ratio: f64,
    z: f64,
}

/// C3: errors over standard deviations, by signal-to-noise ratio and by deviation ratio.
///
/// One to three echoes of SNR 6 to 130 (eight bits end at 125), half a width to four widths apart, two
/// in five widened by up to 40 %.
pub fn every_return(bench: &mut Bench, model: &ChannelModel) {
    let settings = DecomposeSettings::default();
    let cell = Cell { count: 3 * bench.count, ..bench.cell(9100, model, &settings) };
    let fwhm = bench.response.fwhm_ns;
    let all: Vec<Found> = bench
        .observe(&cell, |instrument, engine| {
            let count = 1 + instrument.uniform(0.0, 3.0) as usize;
            let mut echoes: Vec<Echo> = Vec::new();
            for _ in 0..count {
                let snr = 6.0 * (130.0_f64 / 6.0).powf(instrument.uniform(0.0, 1.0));
                let is_wide = instrument.uniform(0.0, 1.0) < 0.4;
                let width = if is_wide { instrument.uniform(1.0, 1.4) } else { 1.0 };
                let place = match echoes.last() {
                    Some(last) => last.place + fwhm * instrument.uniform(0.5, 4.0),
                    None => instrument.uniform(14.0, 20.0),
                };
                echoes.push(Echo { snr, place, width });
            }
            let samples = instrument.record(&echoes, EIGHT_BITS);
            let (returns, deviation_ratio) = engine.decompose(&samples);
            let found = |r: &Return| {
                let error = |echo: &Echo| r.position_samples - echo.place;
                let error = echoes.iter().map(error).min_by(|a, b| a.abs().total_cmp(&b.abs()))?;
                let snr = r.amplitude_dn / NOISE_SD_DN;
                Some(Found { snr, deviation_ratio, z: error / r.position_sd_samples })
            };
            returns.iter().filter_map(found).collect::<Vec<_>>()
        })
        .into_iter()
        .flatten()
        .collect();
    for range in SNR.windows(2) {
        let of_bin = all.iter().filter(|found| within(found.snr, range[0], range[1]));
        report(bench, &format!("every return, SNR {} to {}", range[0], range[1]), of_bin);
    }
    for range in DEVIATION.windows(2) {
        let of_bin = all.iter().filter(|found| within(found.deviation_ratio.abs(), range[0], range[1]));
        report(bench, &format!("every return, deviation ratio from {}", range[0]), of_bin);
    }
}

/// Robust spread of the normalised errors, and the part of them beyond 5.
fn report<'a>(bench: &mut Bench, what: &str, found: impl Iterator<Item = &'a Found>) {
    let mut z: Vec<f64> = found.map(|found| found.z.abs()).collect();
    z.sort_by(f64::total_cmp);
    let spread = z.get(z.len() / 2).map_or(f64::NAN, |median| median / 0.674_49);
    let far = z.len() - z.partition_point(|z| *z < 5.0);
    let what = format!("{what}: normalised range; beyond 5");
    let figure = format!("{spread:.3}; {:.2} % of {}", 100.0 * far as f64 / z.len().max(1) as f64, z.len());
    if z.len() < ENOUGH {
        return bench.beside("C3", &what, figure);
    }
    bench.goal("C3", &what, figure, "0.9-1.15", within(spread, 0.9, 1.15));
}

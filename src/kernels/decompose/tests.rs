use super::*;
use crate::kernels::gauss_fit::Pulse;
use crate::kernels::noise::{ArNoise, fit_by_bic};
use crate::kernels::sensor_model::Background;
use crate::kernels::simulated::{Random, analogue, digitised, moments, pulse};

const FWHM: f64 = 4.25;
const BACKGROUND: f64 = 20.3;

/// Noise before the digitiser, sd 2 DN.
fn process() -> ArNoise {
    let unit = ArNoise::new(&[0.8, -0.25], 1.0).unwrap();
    ArNoise::new(&[0.8, -0.25], 2.0 / unit.sd()).unwrap()
}

/// The model of the digitised noise: 1/12 DN² more at lag 0.
pub(crate) fn model_of(process: &ArNoise, fwhm_samples: f64, background: f64) -> ChannelModel {
    let mut lags = vec![0.0; 6];
    process.autocovariance_into(&mut lags);
    lags[0] += 1.0 / 12.0;
    let noise = fit_by_bic(&lags, 1_000_000, 4).unwrap();
    ChannelModel {
        sampling_interval_ns: 1.0,
        full_scale_dn: 255.0,
        background: Background::Fixed,
        background_dn: [background; 4],
        background_sd_dn: 0.0,
        noise_sd_dn: noise.sd(),
        autocorrelation: lags[1..].iter().map(|r| r / lags[0]).collect(),
        ar: noise.coefficients().to_vec(),
        innovation_sd_dn: noise.innovation_variance().sqrt(),
        pulse_fwhm_ns: fwhm_samples,
        pulse_fwhm_sd_ns: 0.1,
        waveforms: 1000,
        pulses: 1000,
    }
}

fn check_counts(outcome: &Decomposition<'_>) {
    let c = outcome.counts;
    assert_eq!(c.n_candidates + c.n_added, c.np + c.np_filtered + c.np_merged + c.np_xtalk_dropped);
    assert_eq!(c.np as usize, outcome.returns.len());
}

/// Decomposes `trials` digitised blocks of 60 samples with pulses that `scene` puts in.
fn run(
    seed: u64,
    trials: usize,
    scale: u16,
    mut scene: impl FnMut(&mut Random) -> Vec<Pulse>,
    mut look: impl FnMut(&[Pulse], &Decomposition<'_>),
) {
    let process = process();
    let mut model = model_of(&process, FWHM, BACKGROUND);
    model.full_scale_dn = f64::from(scale);
    let mut decomposer = Decomposer::new(&model, &DecomposeSettings::default(), 60).unwrap();
    let mut random = Random::new(seed);
    for _ in 0..trials {
        let truth = scene(&mut random);
        let samples = digitised(&analogue(&mut random, &process, 60, BACKGROUND, FWHM, &truth), scale);
        let outcome = decomposer.decompose(&samples, 0);
        check_counts(&outcome);
        look(&truth, &outcome);
    }
}

#[test]
fn explore() {
    for snr in [10.0, 20.0, 50.0, 100.0] {
        for width in [1.0, 1.5, 2.5] {
            let (mut z, mut za, mut zw, mut dev) = (vec![], vec![], vec![], vec![]);
            let (mut n, mut one, mut added) = (0, 0, 0);
            let t = std::time::Instant::now();
            run(
                7,
                4000,
                4095,
                |r| vec![pulse(2.0 * snr, 26.0 + 8.0 * r.uniform(), width)],
                |truth, out| {
                    n += 1;
                    added += out.counts.n_added;
                    dev.push(out.deviation_ratio());
                    if let [r] = out.returns {
                        one += 1;
                        z.push((r.position_samples - truth[0].position_samples) / r.position_sd_samples);
                        za.push((r.amplitude_dn - truth[0].height_dn) / r.amplitude_sd_dn);
                        zw.push(
                            (r.width_ratio.ln() - truth[0].ln_width_ratio)
                                / (r.width_ratio_sd / r.width_ratio),
                        );
                    }
                },
            );
            println!(
                "single snr {snr} w {width}: one {one}/{n} added {added} z {:.3?} za {:.3?} zw {:.3?} dev {:.3?} {:.1} us",
                moments(&z),
                moments(&za),
                moments(&zw),
                moments(&dev),
                t.elapsed().as_secs_f64() * 1e6 / 4000.0
            );
        }
    }
    for snr in [10.0, 20.0, 50.0, 100.0] {
        for sep in [0.6, 0.75, 0.8, 1.0, 1.2, 1.5, 2.0] {
            let mut z = vec![];
            let (mut two, mut three, mut counts) = (0, 0, 0);
            let t = std::time::Instant::now();
            run(
                8,
                1000,
                4095,
                |r| {
                    let p = 24.0 + 8.0 * r.uniform();
                    vec![pulse(2.0 * snr, p, 1.0), pulse(2.0 * snr, p + sep * FWHM, 1.0)]
                },
                |truth, out| {
                    if let [a, b] = out.returns {
                        if (a.position_samples - truth[0].position_samples).abs() < 0.4 * sep * FWHM
                            && (b.position_samples - truth[1].position_samples).abs() < 0.4 * sep * FWHM
                        {
                            two += 1;
                        }
                        z.push((a.position_samples - truth[0].position_samples) / a.position_sd_samples);
                        z.push((b.position_samples - truth[1].position_samples) / b.position_sd_samples);
                    }
                    if out.returns.len() > 2 {
                        three += 1;
                    }
                    counts += out.counts.n_added;
                },
            );
            println!(
                "pair snr {snr} sep {sep}: two {two} three {three} added {counts} z {:.3?} {:.1} us",
                if z.len() > 2 { moments(&z) } else { (0., 0.) },
                t.elapsed().as_secs_f64() * 1e6 / 1000.0
            );
        }
    }
    for snr in [150.0, 200.0, 400.0, 800.0] {
        let (mut e, mut z) = (vec![], vec![]);
        let mut one = 0;
        let mut sat = 0;
        run(
            9,
            2000,
            255,
            |r| vec![pulse(2.0 * snr, 26.0 + 8.0 * r.uniform(), 1.0)],
            |truth, out| {
                if let [r] = out.returns {
                    one += 1;
                    e.push(r.position_samples - truth[0].position_samples);
                    z.push((r.position_samples - truth[0].position_samples) / r.position_sd_samples);
                    sat += usize::from(r.flags & flags::SATURATED != 0);
                }
            },
        );
        println!("saturated snr {snr}: one {one} sat {sat} err {:.4?} z {:.3?}", moments(&e), moments(&z));
    }
    for n in [40000] {
        let (mut returns, mut candidates) = (0, 0);
        let t = std::time::Instant::now();
        run(
            10,
            n,
            255,
            |_| vec![],
            |_, out| {
                returns += out.returns.len();
                candidates += out.counts.n_candidates;
            },
        );
        println!(
            "noise: {returns} returns {candidates} candidates in {n} {:.1} us",
            t.elapsed().as_secs_f64() * 1e6 / n as f64
        );
    }
}

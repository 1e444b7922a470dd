//! False alarms from noise.
//!
//! In the matched filter output and in the whole chain.

use super::*;

/// Upward threshold crossings at the samples, interpolated maxima above the threshold, and returns.
#[derive(Clone, Copy, Default)]
struct Crossings {
    rises: f64,
    maxima: f64,
    kept: f64,
}

/// A6: false alarms, with the calibrated and with the true standard deviation.
pub fn false_alarms(bench: &mut Bench, model: &ChannelModel) {
    let mut truth = model.clone();
    let part = noise_sd_dn() / model.noise_sd_dn;
    (truth.noise_sd_dn, truth.innovation_sd_dn) = (noise_sd_dn(), part * model.innovation_sd_dn);
    let blocks = if bench.count < 20_000 { 50 * bench.count } else { NOISE_BLOCKS };
    for (name, model) in [("calibrated sigma", model), ("true sigma", &truth)] {
        for sigma in [3.5, 4.0, 4.5] {
            let theory = Theory::of(model, sigma);
            let settings = DecomposeSettings { detection_sigma: sigma, ..DecomposeSettings::default() };
            // Enough blocks to check the discrete formula to 2 % or better.
            let blocks = match sigma {
                3.5 => blocks / 2,
                4.0 => 2 * blocks,
                _ => blocks,
            };
            let cell = Cell { count: blocks, ..bench.cell(6000 + (10.0 * sigma) as u64, model, &settings) };
            let all = bench.observe(&cell, |instrument, engine| {
                let samples = instrument.record(&[], EIGHT_BITS);
                Crossings { kept: engine.decompose(&samples).0.len() as f64, ..theory.count(&samples, sigma) }
            });
            let sum = |f: fn(&Crossings) -> f64| all.iter().map(f).sum::<f64>() / f64::from(blocks);
            let (rises, maxima, kept) = (sum(|c| c.rises), sum(|c| c.maxima), sum(|c| c.kept));
            let known = |rate: f64| (rate / f64::from(blocks)).sqrt();
            let here = format!("T {sigma}, {name}");
            let ratio = |a: f64, b: f64| format!("{:.3} +- {:.3}", a / b, known(a) / b);
            let near = |rate: f64, theory: f64, part: f64| {
                within_known(rate / theory, 1.0 - part, 1.0 + part, known(rate) / theory)
            };
            if sigma <= 4.0 {
                bench.verdict(
                    "A6",
                    &format!("{here}: interpolated maxima over Rice"),
                    ratio(maxima, theory.rice),
                    "0.85-1.15",
                    near(maxima, theory.rice, 0.15),
                );
                bench.verdict(
                    "A6",
                    &format!("{here}: rises at samples over the discrete formula"),
                    ratio(rises, theory.discrete),
                    "0.95-1.05",
                    near(rises, theory.discrete, 0.05),
                );
            }
            bench.goal(
                "A6",
                &format!("{here}: returns over Rice"),
                ratio(kept, theory.rice),
                "1",
                kept <= theory.rice,
            );
            let figure = format!("{:.2e} +- {:.1e}", kept, known(kept));
            match sigma {
                4.5 => bench.goal("A6", &format!("{here}: returns per 60 ns"), figure, "1e-4", kept <= 1e-4),
                _ => bench.beside("A6", &format!("{here}: returns per 60 ns"), figure),
            }
        }
    }
}

/// Theoretical false alarm rates of the matched filter, and the filter itself.
struct Theory {
    detector: Detector,
    whitener: Whitener,
    background_dn: [f64; 4],
    rice: f64,
    discrete: f64,
}

impl Theory {
    fn of(model: &ChannelModel, sigma: f64) -> Theory {
        let (shape, noise) = (Shape::of(model).expect("a shape"), model.noise().expect("noise"));
        let mut whitener = Whitener::new(noise, 200);
        whitener.set_used(&[true; 200]);
        let reach = (1.5 * shape.fwhm_samples()).ceil();
        let filter = |shift: f64| {
            let mut values = vec![0.0; 200];
            let pulse = Pulse {
                height_dn: 1.0,
                position_samples: 100.0 + shift,
                ln_width_ratio: 0.0,
                ln_width_precision: 0.0,
            };
            shape.add(&pulse, 1.0, &mut values);
            let lobe = |k: usize| (k as f64 - 100.0 - shift).abs() <= reach;
            values.iter_mut().enumerate().for_each(|(k, v)| *v = if lobe(k) { *v } else { 0.0 });
            whitener.whiten(&mut values);
            values
        };
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(x, y)| x * y).sum::<f64>();
        let template = filter(0.0);
        let energy = dot(&template, &template);
        let correlation = dot(&template, &filter(1.0)) / energy;
        // The second derivative of the band-limited autocorrelation of the output, from integer
        // lags.
        let lag = |k: i32| dot(&template, &filter(f64::from(k))) / energy;
        let sinc: f64 =
            (1..60).map(|k| 4.0 * lag(k) * if k % 2 == 0 { 1.0 } else { -1.0 } / f64::from(k * k)).sum();
        let bandwidth = (std::f64::consts::PI.powi(2) / 3.0 + sinc).sqrt();
        let tail = 0.5 * libm::erfc(sigma / std::f64::consts::SQRT_2);
        let rate = bandwidth / std::f64::consts::TAU * (-0.5 * sigma * sigma).exp();
        let mut block = Whitener::new(model.noise().expect("noise"), SAMPLES);
        block.set_used(&[true; SAMPLES]);
        let mut detector = Detector::new(shape, None, &block, SAMPLES);
        detector.prepare(&block);
        let samples = SAMPLES as f64;
        Theory {
            detector,
            whitener: block,
            background_dn: model.background_dn,
            rice: samples * rate + tail,
            discrete: tail + (samples - 1.0) * (tail - both_above(sigma, correlation)),
        }
    }

    fn count(&self, samples: &[u16], sigma: f64) -> Crossings {
        let mut detector = self.detector.clone();
        let target: Vec<f64> =
            samples.iter().enumerate().map(|(k, &s)| f64::from(s) - self.background_dn[k % 4]).collect();
        let values = detector.filter(&self.whitener, &target);
        let mut count = Crossings::default();
        for k in 0..values.len() {
            let at = |k: usize| values.get(k).copied().unwrap_or(f64::NEG_INFINITY);
            let (before, here, after) = (if k > 0 { at(k - 1) } else { f64::NEG_INFINITY }, at(k), at(k + 1));
            count.rises += f64::from(u8::from(before < sigma && here >= sigma));
            let curvature = 2.0 * here - before - after;
            let peak = if curvature.is_finite() {
                here + (after - before).powi(2) / (8.0 * curvature)
            } else {
                here
            };
            count.maxima += f64::from(u8::from(here > before && here >= after && peak >= sigma));
        }
        count
    }
}

/// Returns the probability that two correlated standard normal numbers both exceed `x`.
///
/// Simpson's rule on the integral over the angle.
fn both_above(x: f64, correlation: f64) -> f64 {
    let (steps, end) = (400, correlation.asin());
    let value = |i: i32| (-x * x / (1.0 + (end * f64::from(i) / f64::from(steps)).sin())).exp();
    let weight = |i: i32| {
        if i == 0 || i == steps {
            1.0
        } else if i % 2 == 1 {
            4.0
        } else {
            2.0
        }
    };
    let integral = (0..=steps).map(|i| weight(i) * value(i)).sum::<f64>() * end / f64::from(steps) / 3.0;
    (0.5 * libm::erfc(x / std::f64::consts::SQRT_2)).powi(2) + integral / std::f64::consts::TAU
}

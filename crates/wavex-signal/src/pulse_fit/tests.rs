use nalgebra::DMatrix;

use super::*;
use crate::noise::ArNoise;
use crate::simulated::{Random, analogue, moments, pulse};

const FWHM: f64 = 4.25;

fn process() -> ArNoise {
    ArNoise::new(&[0.75, -0.2], 1.4).unwrap()
}

fn whitener(used: &[bool]) -> Whitener {
    let mut whitener = Whitener::new(process(), used.len());
    whitener.set_used(used);
    whitener
}

/// Used samples 0..60 except a gap, and three pulses, one across the start of the block.
fn scene() -> (Vec<bool>, Vec<Pulse>) {
    let used: Vec<bool> = (0..60).map(|k| !(22..25).contains(&k)).collect();
    let mut pulses = vec![pulse(40.0, 1.3, 1.2), pulse(90.0, 22.6, 0.9), pulse(30.0, 28.2, 2.0)];
    pulses[1].ln_width_precision = 1.0 / (0.15 * 0.15);
    (used, pulses)
}

fn model(pulses: &[Pulse], offset: f64, samples: usize) -> Vec<f64> {
    let mut values = vec![offset; samples];
    for p in pulses {
        Shape::from(FWHM).add(p, 1.0, &mut values);
    }
    values
}

/// One element of the parameter vector.
fn parameter<'a>(pulses: &'a mut [Pulse], offset: &'a mut f64, index: usize) -> &'a mut f64 {
    match pulses.get_mut(index / 3) {
        None => offset,
        Some(p) => [&mut p.height_dn, &mut p.position_samples, &mut p.ln_width_ratio][index % 3],
    }
}

/// Whitened derivatives by central differences.
fn numerical_columns(whitener: &Whitener, pulses: &[Pulse], samples: usize, count: usize) -> Vec<Vec<f64>> {
    (0..count)
        .map(|index| {
            let step = 1e-5;
            let side = |sign: f64| {
                let (mut shifted, mut offset) = (pulses.to_vec(), 0.0);
                *parameter(&mut shifted, &mut offset, index) += sign * step;
                model(&shifted, offset, samples)
            };
            let mut column: Vec<f64> =
                side(1.0).iter().zip(side(-1.0)).map(|(a, b)| (a - b) / (2.0 * step)).collect();
            whitener.whiten(&mut column);
            column
        })
        .collect()
}

#[test]
fn derivatives_agree_with_finite_differences() {
    let (used, pulses) = scene();
    let whitener = whitener(&used);
    let mut fit = PulseFit::new(FWHM, Some(0.0), 60, 3);
    fit.pulses.extend_from_slice(&pulses);
    fit.prepare(60, 10);
    fit.form_columns(&whitener);
    for (i, numerical) in numerical_columns(&whitener, &pulses, 60, 10).iter().enumerate() {
        for (k, (a, b)) in fit.columns[i * 60..].iter().zip(numerical).enumerate() {
            assert!((a - b).abs() < 1e-6 * (1.0 + b.abs()), "parameter {i}, sample {k}: {a} {b}");
        }
    }
}

/// The covariance is `(J' S⁻¹ J + Λ)⁻¹` with dense matrices, and exact samples reproduce the exact
/// pulses.
#[test]
fn exact_samples_give_the_pulses_back_with_the_dense_covariance() {
    let (used, mut pulses) = scene();
    pulses[1].ln_width_precision = 0.0;
    let whitener = whitener(&used);
    let target = model(&pulses, 3.0, 60);
    let mut start = pulses.clone();
    for p in &mut start {
        p.height_dn *= 0.8;
        p.position_samples += 0.4;
        p.ln_width_ratio = 0.0;
    }
    let mut fit = PulseFit::new(FWHM, Some(0.0), 60, 3);
    let outcome = fit.fit(&whitener, &target, &start, StopCriteria::exact(100));
    assert!(outcome.termination.is_optimum(), "{outcome:?}");
    assert_eq!((outcome.samples, outcome.parameters), (57, 10));
    assert!(outcome.chi_square < 1e-9, "{outcome:?}");
    for (i, (got, exact)) in fit.pulses().iter().zip(&pulses).enumerate() {
        let sd = fit.pulse_sd(i).map(|sd| 1e-4 * sd);
        assert!((got.height_dn - exact.height_dn).abs() < sd[0]);
        assert!((got.position_samples - exact.position_samples).abs() < sd[1]);
        assert!((got.ln_width_ratio - exact.ln_width_ratio).abs() < sd[2]);
    }
    assert!((fit.offset_dn() - 3.0).abs() < 1e-4 * fit.covariance(9, 9).sqrt());
    check_covariance(&fit, &whitener, &used, &pulses, &[0.0; 10]);
}

fn check_covariance(fit: &PulseFit, whitener: &Whitener, used: &[bool], pulses: &[Pulse], precision: &[f64]) {
    let n = precision.len();
    let mut lags = vec![0.0; used.len()];
    whitener.noise().autocovariance_into(&mut lags);
    let kept: Vec<usize> = (0..used.len()).filter(|&k| used[k]).collect();
    let noise = DMatrix::from_fn(kept.len(), kept.len(), |i, j| lags[kept[i].abs_diff(kept[j])]);
    let mut plain = Whitener::new(ArNoise::new(&[], 1.0).unwrap(), used.len());
    plain.set_used(&vec![true; used.len()]);
    let columns = numerical_columns(&plain, pulses, used.len(), n);
    let jacobian = DMatrix::from_fn(kept.len(), n, |k, i| columns[i][kept[k]]);
    let mut normal = jacobian.transpose() * noise.try_inverse().unwrap() * &jacobian;
    for i in 0..n {
        normal[(i, i)] += precision[i];
    }
    let exact = normal.try_inverse().unwrap();
    for i in 0..n {
        for j in 0..n {
            let scale = (exact[(i, i)] * exact[(j, j)]).sqrt();
            let difference = (fit.covariance(i, j) - exact[(i, j)]).abs() / scale;
            assert!(difference < 1e-5, "{i} {j}: {difference:e}");
        }
    }
}

/// At an optimum from noisy samples the gradient vanishes and the covariance includes the priors.
#[test]
fn priors_enter_the_optimum_and_its_covariance() {
    let (used, pulses) = scene();
    let whitener = whitener(&used);
    let values = analogue(&mut Random::new(5), &process(), 60, 0.0, FWHM, &pulses);
    let mut fit = PulseFit::new(FWHM, Some(0.25), 60, 3);
    let outcome = fit.fit(&whitener, &values, &pulses, StopCriteria::exact(100));
    assert_eq!(outcome.termination, Termination::Converged);
    let fitted = fit.pulses().to_vec();
    let mut precision = [0.0; 10];
    precision[5] = pulses[1].ln_width_precision;
    precision[9] = 0.25;
    check_covariance(&fit, &whitener, &used, &fitted, &precision);

    let objective = |shift: f64, index: usize| {
        let (mut shifted, mut offset) = (fitted.clone(), fit.offset_dn());
        *parameter(&mut shifted, &mut offset, index) += shift;
        let mut residual: Vec<f64> =
            values.iter().zip(model(&shifted, offset, 60)).map(|(y, m)| y - m).collect();
        whitener.whiten(&mut residual);
        let prior = 0.25 * offset * offset + precision[5] * shifted[1].ln_width_ratio.powi(2);
        residual.iter().map(|r| r * r).sum::<f64>() + prior
    };
    for index in 0..10 {
        let sd = fit.covariance(index, index).sqrt();
        let slope = (objective(1e-3 * sd, index) - objective(-1e-3 * sd, index)) / 2e-3;
        assert!(slope.abs() < 1e-3, "parameter {index}: {slope}");
    }
}

/// Errors over their standard deviations, for single pulses of free width in analogue noise.
#[test]
fn standard_deviations_are_true() {
    let whitener = whitener(&[true; 60]);
    let mut fit = PulseFit::new(FWHM, None, 60, 1);
    let mut random = Random::new(1);
    for (snr, width) in [(15.0, 1.0), (50.0, 1.5), (100.0, 2.5)] {
        let mut scores = [vec![], vec![], vec![]];
        let mut chi_squares = vec![];
        for _ in 0..3000 {
            let truth = pulse(snr * process().sd(), 28.0 + 4.0 * random.uniform(), width);
            let values = analogue(&mut random, &process(), 60, 0.0, FWHM, &[truth]);
            let outcome = fit.fit(&whitener, &values, &[truth], StopCriteria::exact(50));
            assert!(outcome.termination.is_optimum());
            let (got, sd) = (fit.pulses()[0], fit.pulse_sd(0));
            scores[0].push((got.height_dn - truth.height_dn) / sd[0]);
            scores[1].push((got.position_samples - truth.position_samples) / sd[1]);
            scores[2].push((got.ln_width_ratio - truth.ln_width_ratio) / sd[2]);
            chi_squares.push(outcome.chi_square);
        }
        for (what, z) in ["height", "position", "width"].iter().zip(&scores) {
            let (mean, sd) = moments(z);
            println!("SNR {snr} width {width} {what}: mean {mean:.3} sd {sd:.3}");
            assert!(mean.abs() < 0.1 && (0.95..1.05).contains(&sd), "SNR {snr} {what}: {mean} {sd}");
        }
        let (mean, sd) = moments(&chi_squares);
        assert!((mean - 57.0).abs() < 0.8 && (sd - 114f64.sqrt()).abs() < 0.5, "chi-square {mean} {sd}");
    }
}

#[test]
fn each_termination_is_said() {
    let whitener = whitener(&[true; 60]);
    let mut fit = PulseFit::new(FWHM, None, 60, 1);
    let truth = pulse(50.0, 30.0, 1.0);
    let target = model(&[truth], 0.0, 60);
    let mut far = truth;
    far.position_samples = 27.0;
    assert_eq!(
        fit.fit(&whitener, &target, &[far], StopCriteria::exact(2)).termination,
        Termination::IterationLimit
    );
    assert_eq!(
        fit.fit(&whitener, &target, &[far, far], StopCriteria::exact(9)).termination,
        Termination::TooManyPulses
    );
    let mut unfit = truth;
    unfit.height_dn = f64::NAN;
    assert_eq!(
        fit.fit(&whitener, &target, &[unfit], StopCriteria::exact(9)).termination,
        Termination::Singular
    );
    // A spike of one sample is narrower than any pulse.
    let mut spike = vec![0.0; 60];
    spike[30] = 500.0;
    assert_eq!(
        fit.fit(&whitener, &spike, &[truth], StopCriteria::exact(200)).termination,
        Termination::AtBound
    );
    let used: Vec<bool> = (0..60).map(|k| k < 2).collect();
    let mut narrow = Whitener::new(process(), 60);
    narrow.set_used(&used);
    assert_eq!(
        fit.fit(&narrow, &target, &[truth], StopCriteria::exact(9)).termination,
        Termination::TooFewSamples
    );
}

#[test]
fn no_pulse_is_a_fit_of_the_background_alone() {
    let whitener = whitener(&[true; 60]);
    let target = [2.5; 60];
    let mut free = PulseFit::new(FWHM, Some(0.0), 60, 1);
    let outcome = free.fit(&whitener, &target, &[], StopCriteria::exact(10));
    assert!(outcome.termination.is_optimum() && outcome.chi_square < 1e-9, "{outcome:?}");
    assert!((free.offset_dn() - 2.5).abs() < 1e-4 * free.covariance(0, 0).sqrt());
    let mut fixed = PulseFit::new(FWHM, None, 60, 1);
    let outcome = fixed.fit(&whitener, &target, &[], StopCriteria::exact(10));
    assert_eq!((outcome.parameters, outcome.samples), (0, 60));
    assert!(outcome.chi_square > 10.0 && outcome.termination.is_optimum());
}

#[test]
fn a_workspace_fits_as_a_new_one() {
    let (used, three) = scene();
    let whitener = whitener(&used);
    let one = vec![pulse(60.0, 45.0, 1.0)];
    let elsewhere = vec![pulse(50.0, 8.0, 1.5), pulse(70.0, 35.0, 1.0), pulse(20.0, 50.0, 0.9)];
    for offset_precision in [None, Some(0.1)] {
        let workspace = || PulseFit::new(FWHM, offset_precision, 60, 3);
        let mut used_again = workspace();
        for pulses in [&three, &one, &elsewhere] {
            let target_dn = model(pulses, 0.5, 60);
            let start: Vec<Pulse> =
                pulses.iter().map(|p| Pulse { height_dn: 0.9 * p.height_dn, ..*p }).collect();
            let fitted = |fit: &mut PulseFit| {
                let result = fit.fit(&whitener, &target_dn, &start, StopCriteria::exact(20));
                let covariances: Vec<f64> = (0..10)
                    .flat_map(|i| (0..10).map(move |j| (i, j)))
                    .map(|(i, j)| fit.covariance(i, j))
                    .collect();
                format!("{result:?} {:?} {covariances:?}", fit.pulses())
            };
            assert_eq!(fitted(&mut used_again), fitted(&mut workspace()), "{offset_precision:?}");
        }
    }
}

use super::*;
use crate::noise::ArNoise;
use crate::simulated::{Random, noise};

const FWHM: f64 = 4.25;

fn process() -> ArNoise {
    ArNoise::new(&[0.75, -0.2], 1.4).unwrap()
}

fn prepared(used: &[bool], offset_precision: Option<f64>) -> (Whitener, Detector) {
    let mut whitener = Whitener::new(process(), used.len());
    whitener.set_used(used);
    let mut detector = Detector::new(FWHM, offset_precision, &whitener, used.len());
    detector.prepare(&whitener);
    (whitener, detector)
}

fn gaussian(height: f64, position: f64, width_ratio: f64, samples: usize) -> Vec<f64> {
    let mut values = vec![0.0; samples];
    let pulse = crate::simulated::pulse(height, position, width_ratio);
    Shape::from(FWHM).add(&pulse, 1.0, &mut values);
    values
}

/// The filter as a matrix: its responses to unit samples.
fn filter_matrix(whitener: &Whitener, detector: &mut Detector, samples: usize) -> Vec<Vec<f64>> {
    (0..samples)
        .map(|k| {
            let mut unit = vec![0.0; samples];
            unit[k] = 1.0;
            detector.filter(whitener, &unit).to_vec()
        })
        .collect()
}

/// Covariance of the statistic at two lags, for noise plus an offset of the given variance.
fn covariance(matrix: &[Vec<f64>], offset_variance: f64, a: usize, b: usize) -> f64 {
    let mut lags = vec![0.0; matrix.len()];
    process().autocovariance_into(&mut lags);
    let mut sum = 0.0;
    for (i, by_i) in matrix.iter().enumerate() {
        for (j, by_j) in matrix.iter().enumerate() {
            sum += by_i[a] * by_j[b] * (lags[i.abs_diff(j)] + offset_variance);
        }
    }
    sum
}

/// At every lag, at the ends of the block and around a gap, with known and unknown background.
#[test]
fn the_statistic_has_unit_variance() {
    let used: Vec<bool> = (0..40).map(|k| !(17..20).contains(&k)).collect();
    for (precision, offset_variance) in [(None, 0.0), (Some(0.04), 25.0)] {
        let (whitener, mut detector) = prepared(&used, precision);
        let matrix = filter_matrix(&whitener, &mut detector, 40);
        let mut lags = 0;
        for lag in (0..40).filter(|&lag| matrix[0][lag].is_finite()) {
            let variance = covariance(&matrix, offset_variance, lag, lag);
            assert!((variance - 1.0).abs() < 1e-9, "lag {lag}: {variance}");
            lags += 1;
        }
        assert!(lags > 34, "{lags}");
    }
}

#[test]
fn a_pulse_between_samples_gives_one_candidate_with_its_place_height_and_significance() {
    let (whitener, mut detector) = prepared(&[true; 60], None);
    for position in [20.0, 25.3, 30.5, 3.2, 57.4] {
        detector.filter(&whitener, &gaussian(30.0, position, 1.0, 60));
        let mut found = vec![];
        detector.maxima(4.5, &mut found);
        assert_eq!(found.len(), 1, "{position}: {found:?}");
        assert!((found[0].position_samples - position).abs() < 0.06, "{position}: {found:?}");
        assert!((found[0].height_dn / 30.0 - 1.0).abs() < 0.08, "{position}: {found:?}");
        let significance = 30.0 * detector.significance_per_dn(&whitener, position);
        assert!((found[0].statistic / significance - 1.0).abs() < 0.06, "{found:?} {significance}");
    }
}

fn maxima_of(statistic: &[f64], threshold: f64) -> Vec<f64> {
    let (_, mut detector) = prepared(&vec![true; statistic.len()], None);
    detector.statistic = statistic.to_vec();
    let mut found = vec![];
    detector.maxima(threshold, &mut found);
    found.iter().map(|c| c.statistic).collect()
}

#[test]
fn shallow_dips_do_not_divide_and_deep_ones_do() {
    assert_eq!(maxima_of(&[0.0, 5.0, 4.0, 6.0, 0.0], 4.0), [6.0]);
    assert_eq!(maxima_of(&[0.0, 6.0, 4.5, 5.0, 0.0], 4.0), [6.0]);
    assert_eq!(maxima_of(&[0.0, 6.0, 2.0, 5.0, 0.0], 4.0), [6.0, 5.0]);
    // The dip before the highest maximum counts from that maximum onwards.
    assert_eq!(maxima_of(&[5.0, 4.0, 9.0, 7.5, 8.0, 5.0, 7.0], 4.0), [9.0, 7.0]);
    assert_eq!(maxima_of(&[5.0, 5.0, 5.0], 4.0), [5.0]);
    assert_eq!(maxima_of(&[3.9; 4], 4.0), [0.0; 0]);
    assert_eq!(maxima_of(&[f64::NEG_INFINITY, 5.0, f64::NAN], 4.0), [0.0; 0]);
}

/// Upper tail of the normal distribution, by the midpoint rule.
fn upper_tail(x: f64) -> f64 {
    let steps = 20_000;
    let width = 12.0 / steps as f64;
    let density = |t: f64| (-0.5 * t * t).exp() / std::f64::consts::TAU.sqrt();
    (0..steps).map(|i| density(x + (i as f64 + 0.5) * width) * width).sum()
}

/// Probability that two normal variables of correlation `r` both exceed `h` (Plackett 1954).
fn both_exceed(h: f64, r: f64) -> f64 {
    let steps = 20_000;
    let width = r / steps as f64;
    let density = |s: f64| (-h * h / (1.0 + s)).exp() / (1.0 - s * s).sqrt() / std::f64::consts::TAU;
    upper_tail(h).powi(2) + (0..steps).map(|i| density((i as f64 + 0.5) * width) * width).sum::<f64>()
}

/// Up-crossings of a threshold by the sampled statistic: `Q(T) + (M - 1)(Q(T) - L(T, T; ρ))` in a
/// block of `M` lags.
#[test]
fn noise_gives_as_many_candidates_as_theory_says() {
    let (whitener, mut detector) = prepared(&[true; 60], None);
    let matrix = filter_matrix(&whitener, &mut detector, 60);
    let lags = matrix[0].iter().filter(|v| v.is_finite()).count() as f64;
    let correlation = covariance(&matrix, 0.0, 30, 31);
    let mut random = Random::new(2);
    let mut found = vec![];
    let blocks = 20_000;
    for _ in 0..blocks {
        detector.filter(&whitener, &noise(&mut random, &process(), 60));
        detector.maxima(3.0, &mut found);
    }
    let exceed = upper_tail(3.0);
    let theory = exceed + (lags - 1.0) * (exceed - both_exceed(3.0, correlation));
    let measured = found.len() as f64 / f64::from(blocks);
    println!("candidates per block of noise at 3 sigma: {measured:.5}, theory {theory:.5}, lags {lags}");
    assert!((measured / theory - 1.0).abs() < 0.08, "{measured} {theory}");
}

#[test]
fn saturated_runs_are_plateaus_and_a_single_free_sample_does_not_divide_them() {
    let samples = [255, 1, 1, 255, 254, 255, 255, 2, 3, 255];
    assert_eq!(next_plateau(&samples, 255.0, 0), Some(0..1));
    assert_eq!(next_plateau(&samples, 255.0, 1), Some(3..7));
    assert_eq!(next_plateau(&samples, 255.0, 7), Some(9..10));
    assert_eq!(next_plateau(&samples, 255.0, 10), None);
    assert_eq!(next_plateau(&[], 255.0, 0), None);
}

#[test]
fn flanks_locate_a_clipped_pulse() {
    let clipped = |position: f64, width_ratio: f64| -> Vec<f64> {
        gaussian(600.0, position, width_ratio, 60).into_iter().map(|v| v.min(235.0)).collect()
    };
    let plateau = |values: &[f64]| {
        let start = values.iter().position(|&v| v >= 235.0).unwrap();
        start..values.iter().rposition(|&v| v >= 235.0).unwrap() + 1
    };
    for width_ratio in [1.0, 1.5, 2.0] {
        let values = clipped(30.3, width_ratio);
        let found = plateau_candidate(&values, plateau(&values), FWHM);
        assert!((found.position_samples - 30.3).abs() < 0.1, "{found:?}");
        assert!((found.height_dn / 600.0).ln().abs() < 0.4, "{found:?}");
        assert!((found.ln_width_ratio - width_ratio.ln()).abs() < 0.2, "{found:?}");
    }
    for position in [0.4, 58.7] {
        let values = clipped(position, 1.0);
        let found = plateau_candidate(&values, plateau(&values), FWHM);
        assert!((found.position_samples - position).abs() < 0.5, "{found:?}");
        assert_eq!(found.ln_width_ratio, 0.0);
    }
    let found = plateau_candidate(&[235.0; 9], 0..9, FWHM);
    assert_eq!((found.position_samples, found.height_dn), (4.0, 235.0));
}

//! Stationary correlated noise: an autoregressive (AR) model of low order.
//!
//! `n_k = φ_1 n_{k-1} + … + φ_p n_{k-p} + w_k` with white `w` of variance `σ_e²`. The model is
//! estimated from measured autocovariances by the Yule–Walker equations (Levinson 1947, Durbin
//! 1960), its order by the Bayesian information criterion (Schwarz 1978, "Estimating the dimension
//! of a model").

/// Largest order of a model.
pub const MAX_ORDER: usize = 8;

/// Stationary autoregressive process, in the unit of its innovation (here DN).
#[derive(Debug, Clone, PartialEq)]
pub struct ArNoise {
    order: usize,
    coefficients: [f64; MAX_ORDER],
    innovation_variance: f64,
    autocovariance: [f64; MAX_ORDER + 1],
}

impl ArNoise {
    /// Creates the process from coefficients `φ_1 …` and the SD of the innovation.
    ///
    /// `None` if no such stationary process exists: more than [`MAX_ORDER`] coefficients, a root on
    /// or outside the unit circle, a non-positive SD, or a non-finite value.
    pub fn new(coefficients: &[f64], innovation_sd: f64) -> Option<ArNoise> {
        let order = coefficients.len();
        if order > MAX_ORDER || !(innovation_sd > 0.0 && innovation_sd.is_finite()) {
            return None;
        }
        let mut predictor = [0.0; MAX_ORDER];
        predictor[..order].copy_from_slice(coefficients);
        let mut lower = [[0.0; MAX_ORDER]; MAX_ORDER + 1];
        let mut variance = innovation_sd * innovation_sd;
        let mut reflection = [0.0; MAX_ORDER];
        let mut variances = [variance; MAX_ORDER + 1];
        // Levinson recursion backwards. The process is stationary if every reflection is within ±1.
        for m in (1..=order).rev() {
            lower[m] = predictor;
            let k = predictor[m - 1];
            let left = 1.0 - k * k;
            if !(left > 0.0 && left.is_finite()) {
                return None;
            }
            reflection[m - 1] = k;
            let mut shorter = [0.0; MAX_ORDER];
            for (j, value) in shorter.iter_mut().enumerate().take(m - 1) {
                *value = (predictor[j] + k * predictor[m - 2 - j]) / left;
            }
            predictor = shorter;
            variance /= left;
            variances[m - 1] = variance;
        }
        let mut autocovariance = [0.0; MAX_ORDER + 1];
        autocovariance[0] = variance;
        for m in 1..=order {
            let known: f64 = (0..m - 1).map(|j| lower[m - 1][j] * autocovariance[m - 1 - j]).sum();
            autocovariance[m] = reflection[m - 1] * variances[m - 1] + known;
        }
        let mut all = [0.0; MAX_ORDER];
        all[..order].copy_from_slice(coefficients);
        Some(ArNoise {
            order,
            coefficients: all,
            innovation_variance: innovation_sd * innovation_sd,
            autocovariance,
        })
    }

    /// Order `p`, from 0 (white) to [`MAX_ORDER`].
    pub fn order(&self) -> usize {
        self.order
    }

    /// Coefficients `φ_1 … φ_p`.
    pub fn coefficients(&self) -> &[f64] {
        &self.coefficients[..self.order]
    }

    /// Variance of the innovation `w`, the unpredictable part of a sample.
    pub fn innovation_variance(&self) -> f64 {
        self.innovation_variance
    }

    /// Standard deviation of one sample.
    pub fn sd(&self) -> f64 {
        self.autocovariance[0].sqrt()
    }

    /// SD of the fourth differences of the process, over that of white noise of unit variance.
    ///
    /// It is the SD of white noise itself; a smooth process has less.
    pub fn difference_sd(&self) -> f64 {
        let mut r = [0.0; 5];
        self.autocovariance_into(&mut r);
        // Autocorrelation of the filter 1, -4, 6, -4, 1.
        ((70.0 * r[0] - 112.0 * r[1] + 56.0 * r[2] - 16.0 * r[3] + 2.0 * r[4]) / 70.0).max(0.0).sqrt()
    }

    /// Fills `out[k]` with the autocovariance at lag `k`.
    pub fn autocovariance_into(&self, out: &mut [f64]) {
        for k in 0..out.len() {
            out[k] = match self.autocovariance[..=self.order].get(k) {
                Some(&known) => known,
                None => self.coefficients().iter().zip(out[..k].iter().rev()).map(|(c, r)| c * r).sum(),
            };
        }
    }
}

/// Fits an autoregressive model to measured autocovariances (lag 0 first).
///
/// The order, from 0 to `max_order`, minimises `N ln σ_e² + p ln N`, with `N` the number of
/// `samples` of the measurement. Orders without a stationary solution, which can occur with few
/// samples, are skipped. `None` if lag 0 is not positive.
pub fn fit_by_bic(autocovariance: &[f64], samples: u64, max_order: usize) -> Option<ArNoise> {
    let (&variance, lags) = autocovariance.split_first()?;
    let mut best = ArNoise::new(&[], variance.max(0.0).sqrt())?;
    let count = (samples.max(2)) as f64;
    let mut best_score = count * variance.ln();
    let mut predictor: [f64; MAX_ORDER] = [0.0; MAX_ORDER];
    let mut error = variance;
    for m in 1..=max_order.min(MAX_ORDER).min(lags.len()) {
        let product: f64 = (0..m - 1).map(|j| predictor[j] * autocovariance[m - 1 - j]).sum();
        let k = (autocovariance[m] - product) / error;
        // Higher orders build on this reflection, so none of them is stationary.
        if k.is_nan() || k.abs() >= 1.0 {
            break;
        }
        let shorter = predictor;
        for j in 0..m - 1 {
            predictor[j] = shorter[j] - k * shorter[m - 2 - j];
        }
        predictor[m - 1] = k;
        error *= 1.0 - k * k;
        let score = count * error.ln() + m as f64 * count.ln();
        if score < best_score
            && let Some(model) = ArNoise::new(&predictor[..m], error.sqrt())
        {
            best = model;
            best_score = score;
        }
    }
    Some(best)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn autocovariance(noise: &ArNoise, lags: usize) -> Vec<f64> {
        let mut out = vec![0.0; lags];
        noise.autocovariance_into(&mut out);
        out
    }

    #[test]
    fn first_order_has_geometric_autocovariance() {
        let noise = ArNoise::new(&[0.6], 2.0).unwrap();
        for (lag, r) in autocovariance(&noise, 12).into_iter().enumerate() {
            let exact = 4.0 / (1.0 - 0.36) * 0.6f64.powi(lag as i32);
            assert!((r - exact).abs() < 1e-12, "lag {lag}: {r} {exact}");
        }
    }

    /// Box and Jenkins: `ρ1 = φ1/(1-φ2)`, `r0 = (1-φ2)/(1+φ2) σ²/((1-φ2)²-φ1²)`.
    #[test]
    fn second_order_agrees_with_its_closed_form() {
        let (a, b) = (0.9, -0.4);
        let r = autocovariance(&ArNoise::new(&[a, b], 1.5).unwrap(), 6);
        let r0 = (1.0 - b) / (1.0 + b) * 2.25 / ((1.0 - b) * (1.0 - b) - a * a);
        assert!((r[0] - r0).abs() < 1e-12);
        assert!((r[1] / r[0] - a / (1.0 - b)).abs() < 1e-12);
        assert!((r[5] - a * r[4] - b * r[3]).abs() < 1e-12);
    }

    #[test]
    fn differences_of_a_process_have_their_closed_form() {
        assert!((ArNoise::new(&[], 1.7).unwrap().difference_sd() - 1.7).abs() < 1e-12);
        // Lags 0 to 4 of 0.5^k, variance 4/3.
        let exact = ((70.0 - 56.0 + 14.0 - 2.0 + 0.125) / 70.0 * 4.0 / 3.0f64).sqrt();
        assert!((ArNoise::new(&[0.5], 1.0).unwrap().difference_sd() - exact).abs() < 1e-12);
    }

    #[test]
    fn a_process_that_is_not_stationary_is_refused() {
        assert_eq!(ArNoise::new(&[1.0], 1.0), None);
        assert_eq!(ArNoise::new(&[0.5, 0.6], 1.0), None);
        assert_eq!(ArNoise::new(&[f64::NAN], 1.0), None);
        assert_eq!(ArNoise::new(&[0.5], 0.0), None);
        assert_eq!(ArNoise::new(&[0.1; MAX_ORDER + 1], 1.0), None);
    }

    #[test]
    fn the_model_of_exact_autocovariances_is_the_process_itself() {
        let truth = ArNoise::new(&[0.9, -0.5, 0.2], 0.7).unwrap();
        let fitted = fit_by_bic(&autocovariance(&truth, 6), 100_000, 4).unwrap();
        assert_eq!(fitted.order(), 3);
        for (a, b) in fitted.coefficients().iter().zip(truth.coefficients()) {
            assert!((a - b).abs() < 1e-12);
        }
        assert!((fitted.innovation_variance() - 0.49).abs() < 1e-12);
    }

    #[test]
    fn white_autocovariances_give_order_zero_and_no_variance_gives_nothing() {
        let fitted = fit_by_bic(&[2.0, 0.002, -0.001, 0.0, 0.001], 10_000, 4).unwrap();
        assert_eq!(fitted.order(), 0);
        assert_eq!(fit_by_bic(&[0.0, 0.0], 10, 1), None);
        assert_eq!(fit_by_bic(&[], 10, 1), None);
    }

    #[test]
    fn orders_without_a_stationary_solution_are_left_out() {
        assert_eq!(fit_by_bic(&[1.0, 1.2, 0.1], 10_000, 2).unwrap().order(), 0);
    }
}

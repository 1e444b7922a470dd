//! Receiver noise: normal, stationary and autocorrelated.

use super::random::{Normal, Random};

/// An autoregressive process with a given autocorrelation at the first lags.
///
/// The order is the number of lags. The first samples of each block use the lower orders of the
/// same recursion, so a block is stationary from its first sample.
#[derive(Clone, Debug)]
pub struct Noise {
    orders: Vec<Prediction>,
    /// The same for odd samples, if they are late; `orders` are then for even samples.
    odd: Option<Vec<Prediction>>,
    normal: Normal,
}

/// Weights of past samples, oldest first, and SD of the innovation; by order.
type Prediction = (Vec<f64>, f64);

impl Noise {
    /// Noise with standard deviation `sd` and this autocorrelation at lags 1, 2, ...
    ///
    /// `None` if no process has this autocorrelation. Levinson-Durbin recursion: Brockwell and
    /// Davis 1991, "Time Series: Theory and Methods", section 5.2.
    pub fn new(sd: f64, autocorrelation: &[f64]) -> Option<Noise> {
        let mut weights: Vec<f64> = Vec::new();
        let mut variance = 1.0;
        let mut orders = vec![(Vec::new(), sd)];
        for (order, &rho) in autocorrelation.iter().enumerate() {
            let known: f64 = (0..order).map(|lag| weights[lag] * autocorrelation[order - 1 - lag]).sum();
            let reflection = (rho - known) / variance;
            variance *= 1.0 - reflection * reflection;
            // Negated, so that NaN is rejected as well.
            if !(variance > 0.0 && reflection.abs() < 1.0) {
                return None;
            }
            let previous = weights.clone();
            weights.iter_mut().zip(previous.iter().rev()).for_each(|(w, p)| *w -= reflection * p);
            weights.push(reflection);
            orders.push((weights.iter().rev().copied().collect(), sd * f64::sqrt(variance)));
        }
        Some(Noise { orders, odd: None, normal: Normal::default() })
    }

    /// The same noise with the odd samples of each block taken this much later, samples.
    ///
    /// The autocorrelation between whole lags is linear, which keeps it positive definite. At the lag
    /// after the last it is the autocorrelation of the process. The delay lies between -1 and 1.
    pub fn with_odd_samples_late(mut self, odd_sample_shift: f64) -> Noise {
        let Some((newest, sd)) = self.orders.last().filter(|_| odd_sample_shift != 0.0) else { return self };
        let (order, sd) = (newest.len(), self.orders.first().map_or(*sd, |(_, sd)| *sd));
        let mut rho = vec![1.0];
        for lag in 1..=order + 1 {
            // A sample's own order predicts its correlation with the sample `lag` before it.
            let weights = &self.orders[lag.min(order)].0;
            rho.push(0.0);
            rho[lag] = weights.iter().rev().enumerate().map(|(k, w)| w * rho[(lag - 1).abs_diff(k)]).sum();
        }
        let time = |k: usize| k as f64 + if k % 2 == 1 { odd_sample_shift } else { 0.0 };
        let correlation = |i: usize, j: usize| {
            let lag = (time(i) - time(j)).abs();
            let (whole, part) = (lag as usize, lag.fract());
            let next = rho.get(whole + 1).copied().unwrap_or(0.0);
            rho.get(whole).map_or(0.0, |rho| (1.0 - part) * rho + part * next)
        };
        let predictions = |parity: usize| {
            let of_order = |order: usize| {
                // A sample of this parity after `order` others.
                let first = (order + parity) % 2;
                let (weights, variance) = prediction(order, |i, j| correlation(first + i, first + j));
                (weights, sd * variance.sqrt())
            };
            (0..=order).map(of_order).collect::<Vec<_>>()
        };
        (self.orders, self.odd) = (predictions(0), Some(predictions(1)));
        self
    }

    /// Fills a block with noise that is independent of all other blocks.
    pub fn fill(&self, random: &mut Random, block: &mut [f64]) {
        block.iter_mut().for_each(|sample| *sample = self.normal.draw(random));
        if let Some(odd) = &self.odd {
            for k in 0..block.len() {
                let orders = if k % 2 == 1 { odd } else { &self.orders };
                let Some((weights, sd)) = orders.get(k).or(orders.last()) else { return };
                block[k] = next(&block[k - weights.len()..k], weights, sd * block[k]);
            }
            return;
        }
        for (k, (weights, sd)) in self.orders.iter().enumerate().take(block.len()) {
            block[k] = next(&block[..k], weights, sd * block[k]);
        }
        let Some((weights, sd)) = self.orders.last() else { return };
        match weights.as_slice() {
            &[a, b, c, d] => go_on_by_four([a, b, c, d], *sd, block),
            weights => {
                for k in self.orders.len()..block.len() {
                    block[k] = next(&block[k - weights.len()..k], weights, sd * block[k]);
                }
            }
        }
    }
}

/// Weights of `order` samples, oldest first, in the best prediction of the next, and its variance.
///
/// Solves the normal equations by elimination; the correlations are positive definite.
fn prediction(order: usize, correlation: impl Fn(usize, usize) -> f64) -> (Vec<f64>, f64) {
    let mut rows: Vec<Vec<f64>> =
        (0..=order).map(|i| (0..=order).map(|j| correlation(i, j)).collect()).collect();
    for pivot in 0..order {
        let known = rows[pivot].clone();
        for row in &mut rows[pivot + 1..] {
            let factor = row[pivot] / known[pivot];
            row.iter_mut().zip(&known).for_each(|(value, known)| *value -= factor * known);
        }
    }
    let mut weights = vec![0.0; order];
    for i in (0..order).rev() {
        let known: f64 = (i + 1..order).map(|j| rows[i][j] * weights[j]).sum();
        weights[i] = (rows[i][order] - known) / rows[i][i];
    }
    (weights, rows[order][order])
}

/// Recursion of order four, the usual order, from the sixth sample; past samples stay in registers.
fn go_on_by_four([a, b, c, d]: [f64; 4], sd: f64, block: &mut [f64]) {
    let Some((&mut [_, w, x, y, z], rest)) = block.split_first_chunk_mut::<5>() else { return };
    let mut past = [w, x, y, z];
    for sample in rest {
        // Same order of operations as `next`, so results are identical bit by bit.
        *sample = sd * *sample + past[0] * a + past[1] * b + past[2] * c + past[3] * d;
        past = [past[1], past[2], past[3], *sample];
    }
}

/// Next sample after `past` (oldest first); `news` is the innovation.
fn next(past: &[f64], weights: &[f64], news: f64) -> f64 {
    // The newest sample is added last, so the rest of the sum does not wait for it.
    past.iter().zip(weights).fold(news, |sum, (sample, weight)| sum + sample * weight)
}

#[cfg(test)]
mod tests {
    use super::super::random::Purpose;
    use super::*;

    const MEASURED: [f64; 4] = [0.63, 0.42, 0.22, 0.11];

    #[test]
    fn of_order_one_the_weight_is_the_correlation() {
        let noise = Noise::new(2.0, &[0.6]).unwrap();
        assert_eq!(noise.orders[1].0, [0.6]);
        assert!((noise.orders[1].1 - 1.6).abs() < 1e-15, "2 sqrt(1 - 0.6^2)");
    }

    /// The weights of the highest order satisfy the Yule-Walker equations.
    #[test]
    fn weights_reproduce_the_autocorrelation() {
        let noise = Noise::new(1.0, &MEASURED).unwrap();
        let (weights, _) = &noise.orders[4];
        let rho = |lag: i32| if lag == 0 { 1.0 } else { MEASURED[lag.unsigned_abs() as usize - 1] };
        for lag in 1..=4 {
            let sum: f64 = (1..=4).map(|j| weights[4 - j as usize] * rho(lag - j)).sum();
            assert!((sum - rho(lag)).abs() < 1e-14, "lag {lag}: {sum}");
        }
    }

    /// Every sample of a block, including the first, has the given SD and correlations.
    #[test]
    fn a_block_is_stationary_from_its_first_sample_on() {
        let (noise, n) = (Noise::new(0.93, &MEASURED).unwrap(), 200_000);
        let mut sums = [[0.0; 8]; 8];
        for shot in 0..n {
            let mut block = [0.0; 8];
            noise.fill(&mut Random::of_shot(1, 0, shot, Purpose::Noise), &mut block);
            for (i, j) in (0..8).flat_map(|i| (0..=i).map(move |j| (i, j))) {
                sums[i][j] += block[i] * block[j] / (f64::from(n) * 0.93 * 0.93);
            }
        }
        for (i, j) in (0..8).flat_map(|i: usize| (i.saturating_sub(4)..=i).map(move |j| (i, j))) {
            let expected = if i == j { 1.0 } else { MEASURED[i - j - 1] };
            assert!((sums[i][j] - expected).abs() < 0.014, "{i}, {j}: {}", sums[i][j]);
        }
    }

    /// Every pair of samples has the correlation of their true distance in time.
    #[test]
    fn late_odd_samples_have_the_correlation_of_their_times() {
        let shift = 0.2;
        let (noise, n) = (Noise::new(0.93, &MEASURED).unwrap().with_odd_samples_late(shift), 200_000);
        let mut sums = [[0.0; 8]; 8];
        for shot in 0..n {
            let mut block = [0.0; 8];
            noise.fill(&mut Random::of_shot(1, 0, shot, Purpose::Noise), &mut block);
            for (i, j) in (0..8).flat_map(|i| (0..=i).map(move |j| (i, j))) {
                sums[i][j] += block[i] * block[j] / (f64::from(n) * 0.93 * 0.93);
            }
        }
        let rho = |lag: usize| if lag == 0 { 1.0 } else { MEASURED[lag - 1] };
        for (i, j) in (0..8).flat_map(|i: usize| (i.saturating_sub(3)..=i).map(move |j| (i, j))) {
            let neighbour = match (i - j, i % 2) {
                (0 | 2, _) => i - j,
                (_, 1) => i - j + 1,
                _ => i - j - 1,
            };
            let expected = (1.0 - shift) * rho(i - j) + shift * rho(neighbour);
            assert!((sums[i][j] - expected).abs() < 0.014, "{i}, {j}: {} {expected}", sums[i][j]);
        }
    }

    #[test]
    fn samples_on_time_have_the_plain_process() {
        let (plain, lags) = (Noise::new(0.93, &MEASURED).unwrap(), [0, 1, 2, 3, 4]);
        let slightly = plain.clone().with_odd_samples_late(1e-12);
        for (order, parity) in lags.into_iter().flat_map(|order| [(order, 0), (order, 1)]) {
            let late = if parity == 0 { &slightly.orders } else { slightly.odd.as_ref().unwrap() };
            let (a, b) = (&plain.orders[order], &late[order]);
            let weights = a.0.iter().zip(&b.0);
            assert!((a.1 - b.1).abs() < 1e-9 && weights.into_iter().all(|(a, b)| (a - b).abs() < 1e-9));
        }
        assert!(plain.clone().with_odd_samples_late(0.0).odd.is_none());
    }

    /// The specialised recursion of order four gives the same bits as the general one.
    #[test]
    fn order_four_reproduces_the_autocorrelation() {
        let noise = Noise::new(0.93, &MEASURED).unwrap();
        let (weights, sd) = &noise.orders[4];
        for length in [0, 3, 5, 6, 60] {
            let mut draws = vec![0.0; length];
            let mut block = draws.clone();
            let mut random = Random::of_shot(1, 2, 3, Purpose::Noise);
            draws.iter_mut().for_each(|draw| *draw = noise.normal.draw(&mut random));
            noise.fill(&mut Random::of_shot(1, 2, 3, Purpose::Noise), &mut block);
            for k in 5..length {
                assert_eq!(block[k], next(&block[k - 4..k], weights, sd * draws[k]));
            }
        }
    }

    #[test]
    fn impossible_autocorrelations_are_rejected() {
        for impossible in [&[1.0][..], &[-1.2], &[0.9, 0.1], &[f64::NAN], &[0.5, f64::INFINITY]] {
            assert!(Noise::new(1.0, impossible).is_none(), "{impossible:?}");
        }
    }
}

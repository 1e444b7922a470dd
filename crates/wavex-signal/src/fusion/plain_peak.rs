//! Peak of a block by a parabola.

use std::ops::Range;

/// Number of initial samples for the background: one per phase.
const LEAD_SAMPLES: usize = 4;
/// Smallest distance of the peak from these samples, in half widths at half maximum.
const CLEAR_HALF_WIDTHS: f64 = 3.0;

/// A peak.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlainPeak {
    /// Position, samples from the block's first.
    pub position_samples: f64,
    /// Height above the background, DN.
    pub height_dn: f64,
}

/// Finds the strongest peak above the mean of the first samples.
///
/// `None` if a sample reaches full scale, or the peak is at the edge of the block.
pub fn plain_peak(samples: &[u16], full_scale_dn: f64) -> Option<PlainPeak> {
    if samples.iter().any(|&sample| f64::from(sample) >= full_scale_dn) {
        return None;
    }
    let lead = samples.get(..LEAD_SAMPLES)?;
    let background = lead.iter().map(|&sample| f64::from(sample)).sum::<f64>() / LEAD_SAMPLES as f64;
    let signal: Vec<f64> = samples.iter().map(|&sample| f64::from(sample) - background).collect();
    plain_peak_of(&signal)
}

/// Finds the peak of a signal without background.
///
/// `None` if it is too near to the first samples; see [`peak_above_half`].
pub(crate) fn plain_peak_of(signal: &[f64]) -> Option<PlainPeak> {
    let (peak, above_half) = peak_above_half(signal)?;
    let half_width = 0.5 * above_half.len() as f64;
    let clear = LEAD_SAMPLES as f64 + CLEAR_HALF_WIDTHS * half_width;
    (highest(signal)? as f64 >= clear).then_some(peak)
}

/// Index of the highest value; the last of equal ones.
fn highest(signal: &[f64]) -> Option<usize> {
    (0..signal.len()).max_by(|&a, &b| signal[a].total_cmp(&signal[b]))
}

/// Finds the highest peak of a signal without background, and its samples above half maximum.
///
/// The peak is the vertex of a weighted least-squares parabola through the logarithms of these
/// samples, with squared samples as weights (Guo 2011, "A simple algorithm for fitting a Gaussian
/// function", eq. 8). It is exact for a Gaussian. `None` if the signal does not fall to half maximum
/// on both sides, or with fewer than three samples above it.
pub fn peak_above_half(signal: &[f64]) -> Option<(PlainPeak, Range<usize>)> {
    let top = highest(signal)?;
    let half = 0.5 * signal[top];
    if half <= 0.0 {
        return None;
    }
    let first = signal[..top].iter().rposition(|&value| value <= half)? + 1;
    let end = top + signal[top..].iter().position(|&value| value <= half)?;
    let half_width = 0.5 * (end - first) as f64;
    if end - first < 3 {
        return None;
    }
    // Sums of the normal equations about the highest sample.
    let (mut powers, mut weighted) = ([0.0; 5], [0.0; 3]);
    for (k, &value) in signal.iter().enumerate().take(end).skip(first) {
        let (x, weight) = (k as f64 - top as f64, value * value);
        let mut power = weight;
        for (i, sum) in powers.iter_mut().enumerate() {
            *sum += power;
            if let Some(sum) = weighted.get_mut(i) {
                *sum += power * value.ln();
            }
            power *= x;
        }
    }
    let [c0, c1, c2] = solve(powers, weighted)?;
    let place = -0.5 * c1 / c2;
    let is_peak = c2 < 0.0 && place.abs() <= half_width + 1.0;
    let peak = PlainPeak { position_samples: top as f64 + place, height_dn: (c0 + 0.5 * c1 * place).exp() };
    (is_peak && peak.height_dn.is_finite()).then_some((peak, first..end))
}

/// Solves `Σ_j s_(i+j) c_j = t_i` for three unknowns by Cramer's rule.
fn solve(s: [f64; 5], t: [f64; 3]) -> Option<[f64; 3]> {
    let determinant = |a: [f64; 3], b: [f64; 3], c: [f64; 3]| {
        a[0] * (b[1] * c[2] - b[2] * c[1]) - a[1] * (b[0] * c[2] - b[2] * c[0])
            + a[2] * (b[0] * c[1] - b[1] * c[0])
    };
    let (a, b, c) = ([s[0], s[1], s[2]], [s[1], s[2], s[3]], [s[2], s[3], s[4]]);
    let all = determinant(a, b, c);
    (all != 0.0).then(|| [determinant(t, b, c) / all, determinant(a, t, c) / all, determinant(a, b, t) / all])
}

/// Noise SD of a receiver from the first samples of its blocks, DN.
///
/// Uses the median of the block variances, which few echoes affect. NaN without blocks.
pub fn lead_noise_sd_dn<'a>(blocks: impl Iterator<Item = &'a [u16]>) -> f64 {
    let variance = |samples: &[u16]| {
        let mean = samples.iter().map(|&sample| f64::from(sample)).sum::<f64>() / samples.len() as f64;
        let squares = samples.iter().map(|&sample| (f64::from(sample) - mean).powi(2)).sum::<f64>();
        squares / (samples.len() - 1) as f64
    };
    let mut variances: Vec<f64> =
        blocks.filter_map(|samples| samples.get(..LEAD_SAMPLES)).map(variance).collect();
    if variances.is_empty() {
        return f64::NAN;
    }
    // The median of a chi-square distribution with three degrees of freedom is 0.789 of its mean.
    const MEDIAN: f64 = 0.789;
    let middle = variances.len() / 2;
    (*variances.select_nth_unstable_by(middle, f64::total_cmp).1 / MEDIAN).sqrt()
}

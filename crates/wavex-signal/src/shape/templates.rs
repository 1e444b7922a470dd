//! Tables of a response widened by a Gaussian, interpolated in time and width.
//!
//! `s(t, u) = h_v(t) / max h_v` with `h_v = h ⊗ N(0, v)`, `v = v0 (e^{2u} - 1)` and `v0` the
//! variance of a Gaussian of the response's full width at half maximum: `e^u` is the width over the
//! response's (docs/explanation/method.md, Signal model). By the heat equation all derivatives are derivatives
//! in time, so one Fourier transform per width gives them all. Between table nodes the
//! interpolation is bicubic Hermite: values, slopes and mixed slope are exact at the nodes, and
//! value and slopes are continuous everywhere, as the minimisation requires.

use std::ops::Range;
use std::sync::OnceLock;

use wavex_simd::dot::{ROWS, add_rows};

use crate::fourier::{ByPhase, Complex, Synthesis};
use crate::sensor_model::response::{STEPS_PER_SAMPLE, bins, spectrum};
use crate::shape::{Lane, union};

/// Step of the table in log width.
const LN_WIDTH_STEP: f64 = 0.05;
/// Range of the table in log width ratio; ratios 0.55 and 12.2.
const LN_WIDTH_RANGE: [f64; 2] = [-0.6, 2.5];
/// Half extent of a Gaussian, in standard deviations.
const REACH_SD: f64 = 5.0;
/// Limit of the log gain: narrowing amplifies high frequencies, which contain only noise beyond
/// this.
const MAX_LN_GAIN: f64 = 4.0;
/// Values per node: shape, slope in time, slope in log width, mixed slope.
const CHANNELS: usize = 4;

/// Rows of one width: for each phase of a sample and each channel, the values from sample `first`.
#[derive(Debug, Clone)]
struct Knot {
    first: i64,
    length: usize,
    rows: Vec<f64>,
}

impl Knot {
    fn row(&self, phase: usize, channel: usize) -> &[f64] {
        let start = (phase * CHANNELS + channel) * self.length;
        &self.rows[start..start + self.length]
    }
}

/// Template tables of one response. Only a few widths are used, so each is computed on first use.
#[derive(Debug, Clone)]
pub(crate) struct Templates {
    series: Vec<Complex>,
    synthesis: Synthesis<STEPS_PER_SAMPLE>,
    /// Variance of a Gaussian of the response's width, samples².
    v0: f64,
    first_sample: i64,
    samples: i64,
    knots: Vec<OnceLock<Knot>>,
}

/// Part of a shape to evaluate.
#[derive(Debug, Clone, Copy)]
pub(crate) enum TemplatePart {
    /// Shape.
    Value,
    /// Derivative in time, per sample.
    ByTime,
    /// Derivative in log width.
    ByLnWidth,
}

impl Templates {
    /// Creates tables for a response with eight values per sample, the first at `first_sample`.
    ///
    /// `first_sample` counts from the peak. The values must satisfy
    /// [`crate::sensor_model::response::SystemResponse::check`].
    pub fn new(values: &[f64], first_sample: i32, fwhm_samples: f64) -> Templates {
        let v0 = fwhm_samples * fwhm_samples / (8.0 * std::f64::consts::LN_2);
        let samples = values.len().div_ceil(STEPS_PER_SAMPLE) as i64;
        let longest = (samples + 2 * reach(v0, LN_WIDTH_RANGE[1])) as usize;
        let steps = (longest * STEPS_PER_SAMPLE).next_power_of_two();
        let first_step = i64::from(first_sample) * STEPS_PER_SAMPLE as i64;
        let series = spectrum(values, first_step, steps, bins(steps));
        let synthesis = Synthesis::new(steps / STEPS_PER_SAMPLE, series.len());
        let count = ((LN_WIDTH_RANGE[1] - LN_WIDTH_RANGE[0]) / LN_WIDTH_STEP).round() as usize + 1;
        let knots = vec![OnceLock::new(); count];
        Templates { series, synthesis, v0, first_sample: i64::from(first_sample), samples, knots }
    }

    /// Rows of one width of the table, computed on first use.
    fn knot(&self, index: usize) -> &Knot {
        self.knots[index].get_or_init(|| {
            let u = LN_WIDTH_RANGE[0] + index as f64 * LN_WIDTH_STEP;
            let margin = if u > 0.0 { reach(self.v0, u) } else { reach(self.v0, 0.0) };
            let extent = (self.first_sample - margin, (self.samples + 2 * margin) as usize);
            knot(&self.series, &self.synthesis, self.v0, u, extent)
        })
    }

    /// Range of log width ratios covered by the tables.
    pub(crate) fn ln_width_bounds() -> [f64; 2] {
        LN_WIDTH_RANGE
    }

    /// Adds to each of `values`, samples of a block, a part of the shape times its factor.
    ///
    /// The peak is at `position_samples`; only samples of the lane are changed. Returns the range of the
    /// changed samples.
    pub(crate) fn add<const T: usize>(
        &self,
        parts: [(TemplatePart, f64); T],
        position_samples: f64,
        ln_width_ratio: f64,
        lane: Lane,
        mut values: [&mut [f64]; T],
    ) -> Range<usize> {
        let [low, high] = LN_WIDTH_RANGE;
        let at = (ln_width_ratio.clamp(low, high) - low) / LN_WIDTH_STEP;
        let index = (at.floor() as usize).min(self.knots.len() - 2);
        let by_width = Hermite::new(at - index as f64, LN_WIDTH_STEP);
        let whole = (-position_samples).floor();
        let steps = (-position_samples - whole) * STEPS_PER_SAMPLE as f64;
        let phase = (steps.floor() as usize).min(STEPS_PER_SAMPLE - 1);
        let by_time = Hermite::new(steps - phase as f64, 1.0 / STEPS_PER_SAMPLE as f64);
        let samples = values.iter().map(|values| values.len()).min().unwrap_or(0);
        let mut changed = 0..0;
        for (j, knot) in [self.knot(index), self.knot(index + 1)].into_iter().enumerate() {
            // Sample k of the block is sample k + whole of the row, counted from the peak.
            let offset = whole as i64 - knot.first;
            let begin = lane.from((-offset).clamp(0, samples as i64) as usize).min(samples);
            let skipped = (offset + begin as i64).max(0) as usize;
            if skipped >= knot.length {
                continue;
            }
            let targets = values.each_mut().map(|values| &mut values[begin..samples]);
            let rows = std::array::from_fn(|r| &knot.row(phase + r / CHANNELS, r % CHANNELS)[skipped..]);
            let weights = parts.map(|(part, factor)| weights(part, factor, &by_time, &by_width, j));
            accumulate(targets, rows, &weights, lane.step());
            changed = union(changed, begin..samples.min(begin + knot.length - skipped));
        }
        changed
    }
}

/// Weights of a part in the rows of knot `j`: the four channels of a phase, then of the next.
fn weights(part: TemplatePart, factor: f64, by_time: &Hermite, by_width: &Hermite, j: usize) -> [f64; ROWS] {
    let (time, width) = match part {
        TemplatePart::Value => (by_time.value(), by_width.value()),
        TemplatePart::ByTime => (by_time.slope(), by_width.value()),
        TemplatePart::ByLnWidth => (by_time.value(), by_width.slope()),
    };
    let (c, d) = (factor * width[2 * j], factor * width[2 * j + 1]);
    let [a, b, e, f] = time;
    [a * c, b * c, a * d, b * d, e * c, f * c, e * d, f * d]
}

/// Extent, in samples, of a response widened by `e^u` beyond its own samples.
fn reach(v0: f64, u: f64) -> i64 {
    (REACH_SD * (v0 * ((2.0 * u).exp() - 1.0)).max(v0).sqrt()).ceil() as i64
}

fn accumulate<const T: usize>(
    targets: [&mut [f64]; T],
    rows: [&[f64]; ROWS],
    weights: &[[f64; ROWS]; T],
    step: usize,
) {
    // For unit step the loop is contiguous.
    if step == 1 {
        add_rows(targets, rows, weights);
        return;
    }
    let n = rows.iter().map(|row| row.len()).min().unwrap_or(0);
    for (target, weights) in targets.into_iter().zip(weights) {
        for k in (0..n.min(target.len())).step_by(step) {
            target[k] += rows.iter().zip(weights).map(|(row, weight)| weight * row[k]).sum::<f64>();
        }
    }
}

/// Cubic Hermite weights at fraction `x` of a step: value and slope at the left, then at the right.
struct Hermite {
    x: f64,
    step: f64,
}

impl Hermite {
    fn new(x: f64, step: f64) -> Hermite {
        Hermite { x, step }
    }

    fn value(&self) -> [f64; 4] {
        let (x, rest) = (self.x, 1.0 - self.x);
        [
            (1.0 + 2.0 * x) * rest * rest,
            x * rest * rest * self.step,
            (3.0 - 2.0 * x) * x * x,
            -x * x * rest * self.step,
        ]
    }

    fn slope(&self) -> [f64; 4] {
        let x = self.x;
        let level = 6.0 * x * (x - 1.0) / self.step;
        [level, 1.0 + x * (3.0 * x - 4.0), -level, x * (3.0 * x - 2.0)]
    }
}

/// Gain of a frequency by widening by `e^u`, and its first and second derivative by `u`.
///
/// `omega` is in radians per sample; `v0` is the variance of a Gaussian of the response's width,
/// samples².
pub(crate) fn widening_gain(omega: f64, v0: f64, u: f64) -> [f64; 3] {
    let square = (2.0 * u).exp();
    let exponent = -0.5 * omega * omega * v0 * (square - 1.0);
    let by_u = -omega * omega * v0 * square;
    // Narrowing amplifies high frequencies, which are mostly noise: the exponent approaches a limit
    // smoothly.
    let (ln_gain, slope, bend) = if exponent > 0.0 {
        let bent = (exponent / MAX_LN_GAIN).tanh();
        let slope = 1.0 - bent * bent;
        (MAX_LN_GAIN * bent, slope, -2.0 * bent * slope / MAX_LN_GAIN)
    } else {
        (exponent, 1.0, 0.0)
    };
    let gain = ln_gain.exp();
    let first = slope * by_u;
    [gain, gain * first, gain * (first * first + bend * by_u * by_u + slope * 2.0 * by_u)]
}

/// Values of a periodic series at a step.
fn at(series: &ByPhase<STEPS_PER_SAMPLE>, step: i64) -> f64 {
    let step = step.rem_euclid((series.len() * STEPS_PER_SAMPLE) as i64) as usize;
    series[step / STEPS_PER_SAMPLE][step % STEPS_PER_SAMPLE]
}

/// Computes the rows of one width: `extent` is their first sample and their length.
fn knot(
    series: &[Complex],
    synthesis: &Synthesis<STEPS_PER_SAMPLE>,
    v0: f64,
    u: f64,
    extent: (i64, usize),
) -> Knot {
    let (mut shape, mut by_width) = (Vec::new(), Vec::new());
    for (j, c) in series.iter().enumerate() {
        let omega = synthesis.omega(j);
        let [gain, gain_by_width, _] = widening_gain(omega, v0, u);
        for (terms, gain) in [(&mut shape, gain), (&mut by_width, gain_by_width)] {
            let term = [c[0] * gain, c[1] * gain];
            terms.push([term, [-omega * term[1], omega * term[0]]]);
        }
    }
    let ([shape, by_time], [by_width, by_both]) = (synthesis.of(&shape), synthesis.of(&by_width));
    let (top, top_by_width) = peak(&shape, &by_time, &by_width, &by_both);
    let (first, length) = extent;
    let mut rows = Vec::with_capacity((STEPS_PER_SAMPLE + 1) * CHANNELS * length);
    for phase in 0..=STEPS_PER_SAMPLE {
        let steps = |k: usize| (first + k as i64) * STEPS_PER_SAMPLE as i64 + phase as i64;
        for values in [&shape, &by_time] {
            rows.extend((0..length).map(|k| at(values, steps(k)) / top));
        }
        for (values, by_width) in [(&shape, &by_width), (&by_time, &by_both)] {
            let value = |k| (at(by_width, steps(k)) - at(values, steps(k)) / top * top_by_width) / top;
            rows.extend((0..length).map(value));
        }
    }
    Knot { first, length, rows }
}

/// Largest value of a shape, and its derivative by log width.
fn peak(
    shape: &ByPhase<STEPS_PER_SAMPLE>,
    by_time: &ByPhase<STEPS_PER_SAMPLE>,
    by_width: &ByPhase<STEPS_PER_SAMPLE>,
    by_both: &ByPhase<STEPS_PER_SAMPLE>,
) -> (f64, f64) {
    let steps = (shape.len() * STEPS_PER_SAMPLE) as i64;
    let highest = (0..steps).fold(0, |best, k| if at(shape, k) > at(shape, best) { k } else { best });
    let step = 1.0 / STEPS_PER_SAMPLE as f64;
    let curvature = (at(by_time, highest + 1) - at(by_time, highest - 1)) / (2.0 * step);
    let slope = at(by_time, highest);
    let shift = if curvature < 0.0 { (-slope / curvature).clamp(-step, step) } else { 0.0 };
    let top = at(shape, highest) + 0.5 * slope * shift;
    (top, at(by_width, highest) + at(by_both, highest) * shift)
}

#[cfg(test)]
mod tests {
    use super::*;

    const FWHM: f64 = 4.4;

    fn gaussian(first: i32, last: i32) -> Vec<f64> {
        let steps = STEPS_PER_SAMPLE as i32;
        let shape = |k: i32| {
            let x = f64::from(k) / f64::from(steps) / FWHM;
            (-4.0 * std::f64::consts::LN_2 * x * x).exp()
        };
        (first * steps..=last * steps).map(shape).collect()
    }

    /// A Gaussian widened by a Gaussian is a Gaussian: closed forms for value and both slopes.
    #[test]
    fn a_gaussian_response_gives_gaussians() {
        let tables = Templates::new(&gaussian(-12, 30), -12, FWHM);
        for (position, u) in [(20.0, 0.0), (19.3, 0.013), (25.77, 0.4), (3.1, 0.21), (30.5, 1.3)] {
            let width = FWHM * f64::exp(u);
            let mut parts = [vec![0.0; 60], vec![0.0; 60], vec![0.0; 60]];
            for (values, part) in
                parts.iter_mut().zip([TemplatePart::Value, TemplatePart::ByTime, TemplatePart::ByLnWidth])
            {
                tables.add([(part, 1.0)], position, u, Lane::All, [values]);
            }
            for k in 0..60 {
                let x = (k as f64 - position) / width;
                let c = 8.0 * std::f64::consts::LN_2;
                let value = (-0.5 * c * x * x).exp();
                let exact = [value, -c * x / width * value, c * x * x * value];
                for (values, exact) in parts.iter().zip(exact) {
                    assert!((values[k] - exact).abs() < 2e-5, "{position} {u} {k}: {} {exact}", values[k]);
                }
            }
        }
    }

    #[test]
    fn slopes_are_those_of_the_value() {
        let skewed: Vec<f64> = {
            let plain = gaussian(-12, 50);
            let late = gaussian(-20, 42);
            plain.iter().zip(late).map(|(a, b)| a + 0.05 * b).collect()
        };
        let tables = Templates::new(&skewed, -12, FWHM);
        let value = |position: f64, u: f64| {
            let mut values = vec![0.0; 50];
            tables.add([(TemplatePart::Value, 3.0)], position, u, Lane::All, [&mut values]);
            values
        };
        let (position, u, step) = (17.4321, -0.137, 1e-6);
        let mut slopes = [vec![0.0; 50], vec![0.0; 50]];
        let columns = slopes.each_mut().map(Vec::as_mut_slice);
        tables.add(
            [(TemplatePart::ByTime, -3.0), (TemplatePart::ByLnWidth, 3.0)],
            position,
            u,
            Lane::All,
            columns,
        );
        let [ahead, behind] = [value(position + step, u), value(position - step, u)];
        let [wider, narrower] = [value(position, u + step), value(position, u - step)];
        for k in 0..50 {
            assert!(((ahead[k] - behind[k]) / (2.0 * step) - slopes[0][k]).abs() < 1e-7);
            assert!(((wider[k] - narrower[k]) / (2.0 * step) - slopes[1][k]).abs() < 1e-7);
        }
    }

    #[test]
    fn a_pulse_outside_its_block_leaves_nothing() {
        let tables = Templates::new(&gaussian(-12, 30), -12, FWHM);
        for position in [-1e4, 1e4] {
            let mut values = vec![0.0; 20];
            tables.add([(TemplatePart::Value, 1.0)], position, 0.0, Lane::All, [&mut values]);
            assert!(values.iter().all(|v| *v == 0.0));
        }
    }
}

//! Columns of the fit: the whitened system response at every grid point.

use std::ops::Range;

use super::band::{LANES, PANEL, subtract_rows};
use crate::shape::{Pulse, Shape};
use crate::simd::{Kernel, Simd, SimdLevel};
use crate::whitening::Whitener;

/// Grid points per pulse width.
pub(super) const POINTS_PER_WIDTH: f64 = 6.0;
/// Largest number of grid points; wider steps are used for longer blocks.
const MOST_POINTS: usize = 400;
/// Grid steps are multiples of this part of a sample.
const PHASES: usize = 8;
/// Samples of the highest response below this part of the noise count as zero.
const NEGLIGIBLE: f64 = 0.01;

/// Grid of the profile, samples from the first of the block.
#[derive(Clone, Copy, Debug)]
pub(super) struct Grid {
    /// Step, in parts of a sample.
    step: usize,
    pub(super) points: usize,
}

impl Grid {
    pub(super) fn of(samples: usize, fwhm_samples: f64) -> Grid {
        let length = (samples - 1) * PHASES;
        let by_width = (PHASES as f64 * fwhm_samples / POINTS_PER_WIDTH) as usize;
        let step = by_width.max(length.div_ceil(MOST_POINTS - 1)).max(1);
        Grid { step, points: length / step + 1 }
    }

    pub(super) fn step_samples(&self) -> f64 {
        self.step as f64 / PHASES as f64
    }
}

/// Whitened columns, by groups of [`PANEL`] samples.
///
/// The columns are those of pulses of height 1. A group holds, for each of its samples, the values
/// of the points that reach one of them.
#[derive(Default)]
pub(super) struct Columns {
    /// Largest distance of two points whose columns overlap.
    reach: usize,
    /// By group, the points that reach it.
    reaching: Vec<Range<usize>>,
    /// Values per sample, padded with zeros.
    stride: usize,
    values: Vec<f64>,
    /// Samples of each column; first and last do not decrease.
    extents: Vec<Range<usize>>,
    /// Responses at the phases of the grid, and the block of one column.
    templates: Vec<f64>,
    block: Vec<f64>,
}

impl Columns {
    /// Largest distance of two points whose columns overlap.
    pub(super) fn reach(&self) -> usize {
        self.reach
    }

    /// Evaluates the columns with the shape of pulses of `height_dn`.
    ///
    /// `weights` are those of the whitened samples of the block.
    pub(super) fn set(
        &mut self,
        grid: Grid,
        shape: &Shape,
        height_dn: f64,
        whitener: &Whitener,
        weights: &[f64],
    ) {
        let n = weights.len();
        // Odd and even samples may differ, therefore templates are moved by two samples.
        const PERIOD: usize = 2 * PHASES;
        let repeats =
            (1..PERIOD).find(|points| (points * grid.step).is_multiple_of(PERIOD)).unwrap_or(PERIOD);
        let peak = n.next_multiple_of(2);
        let span = 2 * peak + 2;
        let negligible = NEGLIGIBLE * whitener.noise().sd() / height_dn;
        self.templates.clear();
        self.templates.resize(repeats * span, 0.0);
        let mut bounds = [(peak, peak + 1); PERIOD];
        let templates = self.templates.chunks_exact_mut(span).enumerate();
        for ((point, template), (first, end)) in templates.zip(&mut bounds) {
            let position_samples = peak as f64 + (point * grid.step % PERIOD) as f64 / PHASES as f64;
            let pulse = Pulse { height_dn, position_samples, ln_width_ratio: 0.0, ln_width_precision: 0.0 };
            shape.add(&pulse, height_dn.recip(), template);
            let counts = |value: &f64| value.abs() > negligible;
            *first = template.iter().position(counts).unwrap_or(peak);
            *end = template.iter().rposition(counts).map_or(peak + 1, |last| last + 1);
        }
        // Sample k of the block is sample `k + peak - moved` of a template.
        let moved = |point: usize| 2 * (point * grid.step / PERIOD);
        // Whitening makes a column longer by the order of the noise.
        let order = whitener.noise().order();
        self.extents.clear();
        self.extents.extend((0..grid.points).map(|point| {
            let (first, end) = bounds[point % repeats];
            let start = (first + moved(point)).saturating_sub(peak).min(n - 1);
            start..(end + moved(point) + order).saturating_sub(peak).clamp(start + 1, n)
        }));
        self.lay_out(n);
        self.block.clear();
        self.block.resize(n, 0.0);
        for (point, extent) in self.extents.iter().enumerate() {
            let template = &self.templates[point % repeats * span + peak - moved(point)..];
            self.block[extent.clone()].copy_from_slice(&template[extent.clone()]);
            whitener.whiten_from(extent.start, &mut self.block[..extent.end]);
            for sample in extent.clone() {
                let at = sample * self.stride + point - self.reaching[sample / PANEL].start;
                self.values[at] = self.block[sample] * weights[sample];
                self.block[sample] = 0.0;
            }
        }
    }

    /// Prepares the memory of columns with these extents in a block of `n` samples.
    fn lay_out(&mut self, n: usize) {
        let extents = &mut self.extents;
        for point in 1..extents.len() {
            extents[point].end = extents[point].end.max(extents[point - 1].end);
        }
        for point in (1..extents.len()).rev() {
            extents[point - 1].start = extents[point - 1].start.min(extents[point].start);
        }
        let begun = |sample: usize| extents.partition_point(|extent| extent.start < sample);
        let ended = |sample: usize| extents.partition_point(|extent| extent.end <= sample);
        let reach = |(point, extent): (usize, &Range<usize>)| begun(extent.end) - 1 - point;
        self.reach = extents.iter().enumerate().map(reach).max().unwrap_or(0);
        self.reaching.clear();
        self.reaching.extend((0..n).step_by(PANEL).map(|sample| ended(sample)..begun(sample + PANEL)));
        let most = self.reaching.iter().map(Range::len).max().unwrap_or(0);
        self.stride = (most + LANES).next_multiple_of(LANES);
        self.values.clear();
        self.values.resize(self.reaching.len() * PANEL * self.stride, 0.0);
    }

    /// Products of each column with the samples of the block.
    pub(super) fn project_into(&self, samples: &[f64], products: &mut Vec<f64>) {
        products.clear();
        products.resize(self.extents.len() + LANES, 0.0);
        SimdLevel::best().processor().run(Projection { columns: self, samples, products });
        products.truncate(self.extents.len());
    }

    /// Products of each column with itself and the following `width - 1` columns, by rows.
    ///
    /// `width` is a multiple of [`LANES`].
    pub(super) fn multiply_into(&self, width: usize, products: &mut Vec<f64>) {
        products.clear();
        products.resize(self.extents.len() * width, 0.0);
        SimdLevel::best().processor().run(Products { columns: self, width, products });
    }

    /// Groups of samples: the points that reach them, and the values by sample.
    #[inline(always)]
    fn groups(&self) -> impl Iterator<Item = (&Range<usize>, [&[f64]; PANEL])> {
        let groups = self.values.chunks_exact(PANEL * self.stride);
        self.reaching.iter().zip(groups).map(|(points, group)| {
            (points, std::array::from_fn(|k| &group[k * self.stride..(k + 1) * self.stride]))
        })
    }
}

struct Projection<'a> {
    columns: &'a Columns,
    samples: &'a [f64],
    products: &'a mut [f64],
}

impl Kernel for Projection<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, _: S) {
        for ((points, rows), samples) in self.columns.groups().zip(self.samples.chunks(PANEL)) {
            let factors = std::array::from_fn(|k| -samples.get(k).copied().unwrap_or(0.0));
            let count = points.len().next_multiple_of(LANES);
            let end = (points.start + count).min(self.products.len());
            subtract_rows(&mut self.products[points.start..end], factors, rows.map(|row| &row[..count]));
        }
    }
}

struct Products<'a> {
    columns: &'a Columns,
    width: usize,
    products: &'a mut [f64],
}

impl Kernel for Products<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, _: S) {
        for (points, rows) in self.columns.groups() {
            let targets = self.products[points.start * self.width..].chunks_exact_mut(self.width);
            for (point, target) in (0..points.len()).zip(targets) {
                let count = (points.len() - point).next_multiple_of(LANES);
                let rows = rows.map(|row| &row[point..point + count]);
                subtract_rows(target, rows.map(|row| -row[0]), rows);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::noise::ArNoise;
    use crate::sensor_model::Digitiser;
    use crate::simulated::{channel, pulse};

    /// With a gap, weights, and odd samples that are delayed.
    #[test]
    fn products_are_those_of_whitened_pulses() {
        let process = ArNoise::new(&[0.5, -0.2], 1.0).unwrap();
        let digitiser = Digitiser { odd_sample_shift: 0.1, ..Digitiser::default() };
        let model = crate::sensor_model::ChannelModel { digitiser, ..channel(&process, 5.3, 10.0) };
        let shape = Shape::of(&model).unwrap();
        let n = 61;
        let mut whitener = Whitener::new(process, n);
        whitener.set_used(&(0..n).map(|k| !(20..24).contains(&k)).collect::<Vec<_>>());
        let weights: Vec<f64> = (0..n).map(|k| 1.0 / (1.0 + k as f64 / 50.0)).collect();
        let grid = Grid::of(n, shape.fwhm_samples());
        let mut columns = Columns::default();
        columns.set(grid, &shape, 100.0, &whitener, &weights);
        let direct: Vec<Vec<f64>> = (0..grid.points)
            .map(|point| {
                let mut column = vec![0.0; n];
                shape.add(&pulse(1.0, point as f64 * grid.step_samples(), 1.0), 1.0, &mut column);
                whitener.whiten(&mut column);
                column.iter().zip(&weights).map(|(value, weight)| value * weight).collect()
            })
            .collect();
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        let samples: Vec<f64> = (0..n).map(|k| (k as f64).sin()).collect();
        let (mut right, mut products) = (Vec::new(), Vec::new());
        columns.project_into(&samples, &mut right);
        let width = (columns.reach() + 1).next_multiple_of(LANES);
        columns.multiply_into(width, &mut products);
        assert!(columns.reach() < grid.points / 2);
        for (i, column) in direct.iter().enumerate() {
            assert!((right[i] - dot(column, &samples)).abs() < 1e-3);
            for (j, other) in direct.iter().enumerate().skip(i) {
                let found = if j - i < width { products[i * width + j - i] } else { 0.0 };
                assert!((found - dot(column, other)).abs() < 1e-3, "{i} {j}");
            }
        }
    }
}

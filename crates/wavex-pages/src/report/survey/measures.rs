//! Distributions of the measurements of the sweep, and the offsets of strips.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::Serialize;

/// Bin width of lengths, m.
const BIN_M: f64 = 0.001;
/// Largest binned length, m.
const LARGEST_M: f64 = 2.0;

/// Signed lengths in bins of 1 mm, with their moments.
///
/// The sweep is sequential, so sums of floating-point numbers are the same in every run.
#[derive(Clone, Debug)]
pub(super) struct Lengths {
    bins: Vec<u32>,
    count: u64,
    sum: f64,
    squares: f64,
    /// Sum of the variances of the values.
    variances: f64,
}

impl Lengths {
    pub(super) fn new() -> Lengths {
        let bins = vec![0; 2 * (LARGEST_M / BIN_M) as usize];
        Lengths { bins, count: 0, sum: 0.0, squares: 0.0, variances: 0.0 }
    }

    /// Adds a length with its variance; lengths beyond 2 m are in the outermost bins.
    pub(super) fn add(&mut self, length_m: f64, variance_m2: f64) {
        let bin = ((length_m + LARGEST_M) / BIN_M).floor().clamp(0.0, (self.bins.len() - 1) as f64);
        if let Some(bin) = self.bins.get_mut(bin as usize) {
            *bin = bin.saturating_add(1);
        }
        self.count += 1;
        self.sum += length_m;
        self.squares += length_m * length_m;
        self.variances += variance_m2;
    }

    pub(super) fn count(&self) -> u64 {
        self.count
    }

    pub(super) fn mean(&self) -> f64 {
        self.sum / self.count as f64
    }

    pub(super) fn rms(&self) -> f64 {
        (self.squares / self.count as f64).sqrt()
    }

    /// RMS of the standard deviations of the values.
    pub(super) fn noise(&self) -> f64 {
        (self.variances / self.count as f64).sqrt()
    }

    /// Quantile, interpolated within a bin.
    pub(super) fn quantile(&self, part: f64) -> f64 {
        let counts = self.bins.iter().map(|count| u64::from(*count));
        interpolated(counts, part * self.count as f64) * BIN_M - LARGEST_M
    }

    /// Quantile of the magnitudes.
    pub(super) fn magnitude(&self, part: f64) -> f64 {
        let half = self.bins.len() / 2;
        let (below, above) = self.bins.split_at(half);
        let counts = above.iter().zip(below.iter().rev()).map(|(a, b)| u64::from(*a) + u64::from(*b));
        interpolated(counts, part * self.count as f64) * BIN_M
    }

    /// Adds all values of another distribution.
    pub(super) fn merge(&mut self, other: &Lengths) {
        self.bins.iter_mut().zip(&other.bins).for_each(|(own, other)| *own = own.saturating_add(*other));
        self.count += other.count;
        self.sum += other.sum;
        self.squares += other.squares;
        self.variances += other.variances;
    }

    /// Bins between the first and the last with values: lower edge of the first, m, and counts.
    pub(super) fn histogram(&self) -> (f64, Vec<u64>) {
        let is_full = |count: &u32| *count > 0;
        let Some(first) = self.bins.iter().position(is_full) else { return (0.0, Vec::new()) };
        let last = self.bins.iter().rposition(is_full).unwrap_or(first);
        let counts = self.bins.iter().take(last + 1).skip(first).map(|count| u64::from(*count));
        (first as f64 * BIN_M - LARGEST_M, counts.collect())
    }
}

/// Position, in bins, below which `wanted` values lie.
fn interpolated(counts: impl Iterator<Item = u64>, wanted: f64) -> f64 {
    let mut sum = 0.0;
    let mut last = 0.0;
    for (bin, count) in counts.enumerate().filter(|(_, count)| *count > 0) {
        let next = sum + count as f64;
        if next >= wanted {
            return bin as f64 + (wanted - sum) / count as f64;
        }
        last = bin as f64 + 1.0;
        sum = next;
    }
    last
}

/// Counts of a number per cell.
#[derive(Clone, Debug, Default)]
pub(super) struct CellCounts {
    cells: BTreeMap<u32, u64>,
    sum: u64,
}

impl CellCounts {
    pub(super) fn add(&mut self, number: u32) {
        *self.cells.entry(number).or_default() += 1;
        self.sum += u64::from(number);
    }

    /// Number of cells.
    pub(super) fn cells(&self) -> u64 {
        self.cells.values().sum()
    }

    pub(super) fn sum(&self) -> u64 {
        self.sum
    }

    /// Number below which half of the cells are; 0 without cells.
    pub(super) fn quantile(&self, part: f64) -> u32 {
        let wanted = part * self.cells() as f64;
        let mut sum = 0;
        let reaches = |(_, cells): &(&u32, &u64)| {
            sum += **cells;
            sum as f64 >= wanted
        };
        self.cells.iter().find(reaches).map_or(0, |(number, _)| *number)
    }

    /// Number of cells with fewer than this.
    pub(super) fn below(&self, number: f64) -> u64 {
        self.cells.iter().filter(|(own, _)| f64::from(**own) < number).map(|(_, cells)| cells).sum()
    }
}

/// Densities of the cells with points.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
#[schemars(rename = "Density")]
pub struct CellDensity {
    /// Number divided by the area of the cells with points, 1/m².
    pub mean_per_m2: f64,
    /// Median of the cells, 1/m².
    pub median_per_m2: f64,
    /// Density below which 5 % of the cells are, 1/m².
    pub low_per_m2: f64,
}

impl CellDensity {
    pub(super) fn of(counts: &CellCounts, cell_area_m2: f64) -> CellDensity {
        let area_m2 = (counts.cells() as f64 * cell_area_m2).max(f64::MIN_POSITIVE);
        CellDensity {
            mean_per_m2: counts.sum() as f64 / area_m2,
            median_per_m2: f64::from(counts.quantile(0.5)) / cell_area_m2,
            low_per_m2: f64::from(counts.quantile(0.05)) / cell_area_m2,
        }
    }
}

/// Offset of a strip from the others.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct PairOffset {
    /// The two strips.
    pub(super) strips: [usize; 2],
    /// Height of the second above the first, m.
    pub(super) difference_m: f64,
    /// Number of cells compared.
    pub(super) weight: f64,
}

/// Heights of strips above the median strip that reproduce the differences best, m.
///
/// Weighted least squares by conjugate gradients; `None` for strips without differences. Strips
/// that no differences connect have their own median.
pub(super) fn offsets(strips: usize, links: &[PairOffset]) -> Vec<Option<f64>> {
    let apply = |values: &[f64]| {
        let mut product = vec![0.0; strips];
        for PairOffset { strips: [a, b], weight, .. } in links {
            let flow = weight * (values[*b] - values[*a]);
            product[*b] += flow;
            product[*a] -= flow;
        }
        product
    };
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let mut residual = vec![0.0; strips];
    for PairOffset { strips: [a, b], difference_m, weight } in links {
        residual[*b] += weight * difference_m;
        residual[*a] -= weight * difference_m;
    }
    let mut offsets = vec![0.0; strips];
    let mut direction = residual.clone();
    let mut size = dot(&residual, &residual);
    let first = size;
    for _ in 0..10 * strips.max(10) {
        if size <= 1e-24 * first || size == 0.0 {
            break;
        }
        let product = apply(&direction);
        let step = size / dot(&direction, &product).max(f64::MIN_POSITIVE);
        for i in 0..strips {
            offsets[i] += step * direction[i];
            residual[i] -= step * product[i];
        }
        let next = dot(&residual, &residual);
        direction.iter_mut().zip(&residual).for_each(|(own, residual)| *own = residual + next / size * *own);
        size = next;
    }
    let mut result = vec![None; strips];
    for group in connected(strips, links) {
        let mut heights: Vec<f64> = group.iter().map(|strip| offsets[*strip]).collect();
        heights.sort_by(f64::total_cmp);
        let middle = heights.len() / 2;
        let median = match heights.len() % 2 {
            0 => 0.5 * (heights[middle - 1] + heights[middle]),
            _ => heights[middle],
        };
        group.iter().for_each(|strip| result[*strip] = Some(offsets[*strip] - median));
    }
    result
}

/// Groups of at least two strips that differences connect.
fn connected(strips: usize, links: &[PairOffset]) -> Vec<Vec<usize>> {
    let mut group: Vec<usize> = (0..strips).collect();
    for PairOffset { strips: [a, b], .. } in links {
        let (from, to) = (group[*a].max(group[*b]), group[*a].min(group[*b]));
        group.iter_mut().filter(|own| **own == from).for_each(|own| *own = to);
    }
    let members = |name: usize| (0..strips).filter(|strip| group[*strip] == name).collect::<Vec<usize>>();
    (0..strips).map(members).filter(|members| members.len() > 1).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_are_interpolated() {
        let mut lengths = Lengths::new();
        (-100..=300).for_each(|i| lengths.add(f64::from(i) * 1e-3 + 5e-4, 1e-4));
        assert!((lengths.quantile(0.5) - 0.1005).abs() < 1e-9, "{}", lengths.quantile(0.5));
        assert!((lengths.magnitude(0.95) - 0.281).abs() < 2e-3, "{}", lengths.magnitude(0.95));
        assert!((lengths.mean() - 0.1005).abs() < 1e-9 && (lengths.noise() - 0.01).abs() < 1e-12);
        let (first, counts) = lengths.histogram();
        assert!((first + 0.1).abs() < 1e-9 && counts.len() == 401);
        lengths.add(-7.0, 0.0);
        assert_eq!(lengths.histogram().0, -2.0);
    }

    #[test]
    fn densities_are_of_cells_with_points() {
        let mut counts = CellCounts::default();
        [8, 8, 12, 40].into_iter().for_each(|n| counts.add(n));
        let density = CellDensity::of(&counts, 4.0);
        assert_eq!((density.mean_per_m2, density.median_per_m2), (4.25, 2.0));
        assert_eq!(counts.below(9.0), 2);
    }

    #[test]
    fn offsets_reproduce_differences() {
        let link = |a, b, difference_m| PairOffset { strips: [a, b], difference_m, weight: 50.0 + a as f64 };
        // Strip 1 is 5 cm high; strip 4 has no neighbours; 5 and 6 are on their own.
        let links = [link(0, 1, 0.05), link(1, 2, -0.05), link(2, 3, 0.0), link(0, 3, 0.0), link(5, 6, 0.02)];
        let offsets = offsets(7, &links);
        let expected = [Some(0.0), Some(0.05), Some(0.0), Some(0.0), None, Some(-0.01), Some(0.01)];
        for (offset, expected) in offsets.iter().zip(expected) {
            let is_near = offset.zip(expected).is_some_and(|(a, b): (f64, f64)| (a - b).abs() < 1e-9);
            assert!(is_near || *offset == expected, "{offsets:?}");
        }
    }
}

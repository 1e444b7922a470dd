//! Proof of a range walk on triples that did not make it.
//!
//! Each half of the recording predicts second differences of the other. The factor of that
//! prediction in the measured second differences is 1 for a walk, everywhere. A surface whose
//! height follows its reflectance has a factor that depends on the kind of surface.

use nalgebra::{SMatrix, SVector};

use super::row::{AmplitudeRow, spread_ln, weight};
use super::stretches::jackknife_variance;

/// Smallest factor in either half, in its standard deviations.
const LEAST_SD: f64 = 3.0;
/// Smallest fall of the squares of both halves, in its standard deviations.
const LEAST_FALL_SD: f64 = 3.0;
/// Smallest factor extrapolated to a perfect surface, in its standard deviations.
const LEAST_EXTRAPOLATED_SD: f64 = 2.0;
/// Largest `χ²` of the differences between kinds of triples, per degree of freedom.
///
/// The expected value: a walk is believed only if kinds of surface agree as well as chance makes
/// them agree in half of the recordings. A looser bound lets imitations pass.
const MOST_CHI_SQUARE: f64 = 1.0;
/// Largest factor of neighbours' amplitudes, in standard deviations.
const MOST_NEIGHBOURS_SD: f64 = 2.5;
/// Name of the last comparison.
const NEIGHBOURS: &str = "amplitudes of neighbouring shots";
/// Number of permutations, and of triples in which they exchange amplitudes.
const PERMUTATIONS: usize = 200;
const PERMUTED_TRIPLES: usize = 12;
/// Smallest contrast of a triple, in the logarithm of the amplitude.
const LEAST_CONTRAST_LN: f64 = 1e-3;
/// Ridge of the normal equations relative to their diagonal.
const RIDGE: f64 = 1e-9;

/// A value with its standard deviation by the jackknife over stretches.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct MeasuredDelay {
    /// Value.
    pub value: f64,
    /// Standard deviation.
    pub sd: f64,
}

impl MeasuredDelay {
    /// Whether the recording determines the value.
    fn is_determined(&self) -> bool {
        self.value.is_finite() && self.sd.is_finite() && self.sd > 0.0
    }

    /// The value in standard deviations; 0 if unknown.
    pub fn ratio(&self) -> f64 {
        let ratio = self.value / self.sd;
        if ratio.is_finite() { ratio } else { 0.0 }
    }
}

/// Figures of the proof of a walk.
#[derive(Clone, Debug, PartialEq)]
pub struct Proof {
    /// Factor of the prediction in either half, made by the other half.
    pub halves: [MeasuredDelay; 2],
    /// Fall of the weighted sum of squared second differences in either half.
    pub falls: [MeasuredDelay; 2],
    /// Fall in both halves.
    pub fall: MeasuredDelay,
    /// Factor, and largest factor of 200 permutations of amplitudes between neighbours.
    pub factor: f64,
    /// See `factor`.
    pub most_permuted: f64,
    /// Factors extrapolated to a surface without roughness, and to one without contrast.
    pub without_roughness: MeasuredDelay,
    /// See `without_roughness`.
    pub without_contrast: MeasuredDelay,
    /// Changes of the factor with properties of triples, with the names of these.
    pub differences: Vec<(&'static str, MeasuredDelay)>,
    /// Factor of the amplitudes one shot before and after.
    pub neighbours: MeasuredDelay,
}

/// Reason why a walk is not used.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum Refusal {
    /// A half does not show the walk of the other half.
    #[error(
        "what one half of the lines shows explains {0:.2} ± {1:.2} of it in the other half (at least \
         {LEAST_SD} standard deviations needed)"
    )]
    Halves(f64, f64),
    /// Second differences do not fall in the half that did not make the walk.
    #[error(
        "second differences of the half that did not make it fall by {0:.1} standard deviations (at least {1} \
         needed)"
    )]
    Fall(f64, f64),
    /// Amplitudes of neighbours explain as much.
    #[error("amplitudes permuted between neighbours explain as much: {0:.2} against {1:.2}")]
    Permutation(f64, f64),
    /// It may follow from the roughness, or from the edges, of the surface.
    #[error(
        "extrapolated to a surface without {0}, {1:.2} ± {2:.2} of it is left (at least {LEAST_EXTRAPOLATED_SD} standard \
         deviations needed)"
    )]
    Extrapolated(&'static str, f64, f64),
    /// It depends on the surface.
    #[error(
        "its factor depends on the surface, most of all {kind} ({ratio:+.1} standard deviations; χ² {chi_square:.1} of \
         all kinds, at most {most:.0} allowed): heights may follow the reflectance"
    )]
    Surface {
        /// Kind of surface with the largest difference.
        kind: &'static str,
        /// Difference in standard deviations.
        ratio: f64,
        /// Sum of squares of all of them.
        chi_square: f64,
        /// Largest sum allowed.
        most: f64,
    },
    /// Nothing shows whether it depends on the surface.
    #[error("the recording does not show whether its factor depends on {0}")]
    Undetermined(&'static str),
    /// Amplitudes of other echoes matter.
    #[error(
        "amplitudes of neighbouring shots delay echoes too ({0:+.1} standard deviations, at most \
         {MOST_NEIGHBOURS_SD} allowed): heights may follow the reflectance"
    )]
    Neighbours(f64),
}

impl Proof {
    /// `predicted_ns` are the second differences by the walk of the other half.
    pub(super) fn of(rows: &[AmplitudeRow], predicted_ns: &[f64], sds_ns: &[f64], stretches: usize) -> Proof {
        let tests = Tests::new(rows, predicted_ns, sds_ns, stretches);
        let [first, second, ..] = tests.regress(|i| {
            let is_first = rows[i].stretch.is_multiple_of(2);
            let x = predicted_ns[i];
            with_tilt(&rows[i], [if is_first { x } else { 0.0 }, if is_first { 0.0 } else { x }])
        });
        let factor = tests.factor(|i| predicted_ns[i]);
        let without_roughness = tests.extrapolated(|i| sds_ns[i]);
        let without_contrast = tests.extrapolated(|i| spread_ln(&rows[i]));
        Proof {
            halves: [first, second],
            falls: [0, 1].map(|half| tests.fall(|row| row.stretch % 2 == half)),
            fall: tests.fall(|_| true),
            factor,
            most_permuted: tests.most_permuted(),
            without_roughness,
            without_contrast,
            differences: tests.differences(),
            neighbours: tests.neighbours(),
        }
    }

    /// The first reason why the walk must not be used.
    pub fn refusal(&self) -> Option<Refusal> {
        let is_visible = |measured: &MeasuredDelay| measured.ratio() >= LEAST_SD;
        if let Some(half) = self.halves.iter().find(|half| !is_visible(half)) {
            return Some(Refusal::Halves(half.value, half.sd));
        }
        if let Some(fall) = self.falls.iter().find(|fall| fall.value <= 0.0) {
            return Some(Refusal::Fall(fall.ratio(), 0.0));
        }
        if self.fall.ratio() < LEAST_FALL_SD {
            return Some(Refusal::Fall(self.fall.ratio(), LEAST_FALL_SD));
        }
        if self.factor <= self.most_permuted {
            return Some(Refusal::Permutation(self.most_permuted, self.factor));
        }
        let extrapolated = [("roughness", self.without_roughness), ("contrast", self.without_contrast)];
        let is_left = |left: &MeasuredDelay| left.ratio() >= LEAST_EXTRAPOLATED_SD;
        if let Some((what, left)) = extrapolated.iter().find(|(_, left)| !is_left(left)) {
            return Some(Refusal::Extrapolated(what, left.value, left.sd));
        }
        let mut comparisons = self.differences.iter().copied().chain([(NEIGHBOURS, self.neighbours)]);
        if let Some((kind, _)) = comparisons.find(|(_, measured)| !measured.is_determined()) {
            return Some(Refusal::Undetermined(kind));
        }
        let squares = |(_, change): &(&str, MeasuredDelay)| change.ratio().powi(2);
        let chi_square: f64 = self.differences.iter().map(squares).sum();
        let most = MOST_CHI_SQUARE * self.differences.len() as f64;
        let largest = self.differences.iter().max_by(|a, b| squares(a).total_cmp(&squares(b)));
        if let Some(&(kind, change)) = largest.filter(|_| chi_square > most) {
            return Some(Refusal::Surface { kind, ratio: change.ratio(), chi_square, most });
        }
        let neighbours = self.neighbours.ratio();
        (neighbours.abs() > MOST_NEIGHBOURS_SD).then_some(Refusal::Neighbours(neighbours))
    }
}

/// Adds the tilt of the surface, which makes slopes towards the sensor bright, as two columns.
fn with_tilt(row: &AmplitudeRow, [a, b]: [f64; 2]) -> [f64; 4] {
    let [before, _, after] = row.ln_amplitudes;
    [a, b, before - after, before * before - after * after]
}

struct Tests<'a> {
    rows: &'a [AmplitudeRow],
    predicted_ns: &'a [f64],
    sds_ns: &'a [f64],
    /// Weights about half the prediction, ns⁻².
    ///
    /// They favour neither a walk nor none. A prediction that is large compared with the roughness is
    /// weakened by them on smooth surfaces first, which counts against it.
    weights: Vec<f64>,
    stretches: usize,
}

impl<'a> Tests<'a> {
    fn new(
        rows: &'a [AmplitudeRow],
        predicted_ns: &'a [f64],
        sds_ns: &'a [f64],
        stretches: usize,
    ) -> Tests<'a> {
        let weights = rows.iter().zip(predicted_ns).zip(sds_ns);
        let weights = weights.map(|((row, x), sd_ns)| weight(row.difference_ns - 0.5 * x, *sd_ns)).collect();
        Tests { rows, predicted_ns, sds_ns, weights, stretches }
    }

    /// Mean of a property of triples, weighted by their information about the walk.
    fn mean(&self, of: impl Fn(usize) -> f64) -> f64 {
        let (mut sum, mut weights) = (0.0, 0.0);
        for (i, (weight, x)) in self.weights.iter().zip(self.predicted_ns).enumerate() {
            let information = weight * x * x;
            if information > 0.0 {
                sum += information * of(i);
                weights += information;
            }
        }
        sum / weights
    }

    /// Weighted regression of the second differences on the columns of every triple.
    fn regress<const K: usize>(&self, columns: impl Fn(usize) -> [f64; K]) -> [MeasuredDelay; K] {
        let mut parts = vec![(SMatrix::<f64, K, K>::zeros(), SVector::<f64, K>::zeros()); self.stretches];
        for (i, (row, weight)) in self.rows.iter().zip(&self.weights).enumerate() {
            if *weight > 0.0 {
                let x = SVector::from(columns(i));
                parts[row.stretch].0 += *weight * x * x.transpose();
                parts[row.stretch].1 += *weight * row.difference_ns * x;
            }
        }
        let (matrix, right) = parts
            .iter()
            .fold((SMatrix::zeros(), SVector::zeros()), |sum, part| (sum.0 + part.0, sum.1 + part.1));
        let solve = |matrix: SMatrix<f64, K, K>, right: SVector<f64, K>| {
            let ridge = RIDGE * SMatrix::from_diagonal(&matrix.diagonal());
            (matrix + ridge).cholesky().map(|cholesky| cholesky.solve(&right))
        };
        let Some(all) = solve(matrix, right) else { return [MeasuredDelay { value: 0.0, sd: f64::NAN }; K] };
        let without_one: Vec<SVector<f64, K>> =
            parts.iter().filter_map(|part| solve(matrix - part.0, right - part.1)).collect();
        std::array::from_fn(|k| MeasuredDelay {
            value: all[k],
            sd: jackknife_variance(all[k], without_one.iter().map(|found| found[k])).sqrt(),
        })
    }

    /// Factor of a prediction in the second differences.
    fn factor(&self, predicted_ns: impl Fn(usize) -> f64) -> f64 {
        let (mut products, mut squares) = (0.0, 0.0);
        for (i, (row, weight)) in self.rows.iter().zip(&self.weights).enumerate() {
            let x = predicted_ns(i);
            products += weight * x * row.difference_ns;
            squares += weight * x * x;
        }
        products / squares
    }

    /// Fall of the weighted sum of squares by the prediction.
    fn fall(&self, is_used: impl Fn(&AmplitudeRow) -> bool) -> MeasuredDelay {
        let mut sums = vec![None; self.stretches];
        for ((row, weight), x) in self.rows.iter().zip(&self.weights).zip(self.predicted_ns) {
            if is_used(row) {
                *sums[row.stretch].get_or_insert(0.0) += weight * x * (2.0 * row.difference_ns - x);
            }
        }
        let sums: Vec<f64> = sums.into_iter().flatten().collect();
        let count = sums.len() as f64;
        let mean = sums.iter().sum::<f64>() / count;
        let variance = sums.iter().map(|sum| (sum - mean).powi(2)).sum::<f64>() / (count - 1.0);
        MeasuredDelay { value: mean * count, sd: (count * variance).sqrt() }
    }

    /// Largest factor of predictions that are permuted between neighbouring triples.
    fn most_permuted(&self) -> f64 {
        let mut random = 1u64;
        let mut below = |count: usize| {
            // Knuth's linear congruential generator; its high bits are sufficient here.
            random = random.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            (random >> 33) as usize % count
        };
        let mut most = f64::NEG_INFINITY;
        let mut order: Vec<usize> = (0..self.rows.len()).collect();
        for _ in 0..PERMUTATIONS {
            for window in order.chunks_mut(PERMUTED_TRIPLES) {
                (1..window.len()).for_each(|i| window.swap(i, below(i + 1)));
            }
            most = most.max(self.factor(|i| self.predicted_ns[order[i]]));
        }
        most
    }

    /// Changes of the factor with the kind of triple.
    fn differences(&self) -> Vec<(&'static str, MeasuredDelay)> {
        let ln = |i: usize| self.rows[i].ln_amplitudes;
        let sign = |value: f64| if value == 0.0 { 0.0 } else { value.signum() };
        let contrast = |i: usize| spread_ln(&self.rows[i]).max(LEAST_CONTRAST_LN);
        let kinds: [(&'static str, &dyn Fn(usize) -> f64); 6] = [
            ("rough against smooth", &|i| self.sds_ns[i].ln()),
            ("strong against weak contrast", &|i| contrast(i).ln()),
            ("edges against single shots", &|i| (ln(i)[0] - ln(i)[2]).abs() / contrast(i)),
            ("brighter against darker along the line", &|i| sign(ln(i)[2] - ln(i)[0])),
            ("bright against dark shots", &|i| sign(2.0 * ln(i)[1] - ln(i)[0] - ln(i)[2])),
            ("strong against weak echoes", &|i| ln(i).iter().sum()),
        ];
        kinds.iter().map(|(name, kind)| (*name, self.change(kind))).collect()
    }

    /// Factor extrapolated linearly to triples with zero of a positive property.
    fn extrapolated(&self, property: impl Fn(usize) -> f64) -> MeasuredDelay {
        let mean = self.mean(&property);
        let [factor, ..] = self.regress(|i| {
            let x = self.predicted_ns[i];
            with_tilt(&self.rows[i], [x, x * property(i) / mean])
        });
        factor
    }

    /// Change of the factor with a property of triples.
    fn change(&self, property: &dyn Fn(usize) -> f64) -> MeasuredDelay {
        let mean = self.mean(property);
        let [_, change, ..] = self.regress(|i| {
            let x = self.predicted_ns[i];
            with_tilt(&self.rows[i], [x, x * (property(i) - mean)])
        });
        change
    }

    /// Factor of the predictions one shot before and after; a receiver delays an echo by its own
    /// amplitude, a surface also follows the reflectance of its neighbourhood.
    fn neighbours(&self) -> MeasuredDelay {
        let neighbour = |i: usize, is_after: bool| {
            let other = if is_after { i.checked_add(1) } else { i.checked_sub(1) }?;
            let row = self.rows.get(other)?;
            (row.shot.abs_diff(self.rows[i].shot) == 1).then(|| self.predicted_ns[other])
        };
        let [_, sum, ..] = self.regress(|i| match (neighbour(i, false), neighbour(i, true)) {
            (Some(before), Some(after)) => {
                let [a, b, c, d] = with_tilt(&self.rows[i], [self.predicted_ns[i], before + after]);
                [a, b, c, d, after - before]
            }
            // Without both neighbours a triple shows nothing.
            _ => [0.0; 5],
        });
        sum
    }
}

//! Histograms with predefined bins, filled by a few comparisons.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use wavex_line::stage::packed;

/// Histogram of a quantity.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
pub struct QuantityHistogram {
    /// Name of the quantity.
    pub quantity: String,
    /// Unit; empty for dimensionless quantities.
    pub unit: String,
    /// Whether bin edges have a constant ratio instead of a constant distance.
    pub logarithmic: bool,
    /// Lower edge of the first bin.
    pub first_edge: f64,
    /// Bin width, or the ratio of consecutive edges for logarithmic bins.
    pub bin: f64,
    /// Number of values in each bin, separated by spaces; empty bins at both ends are omitted.
    #[serde(serialize_with = "packed::serialize", deserialize_with = "packed::deserialize")]
    #[schemars(with = "String")]
    pub counts: Vec<u64>,
    /// Number of values below the lowest possible bin.
    pub below: u64,
    /// Number of values above the highest possible bin.
    pub above: u64,
}

/// A quantity of items, and its histogram being filled.
#[derive(Clone, Debug)]
pub(in crate::report) struct Quantity<T> {
    name: &'static str,
    unit: &'static str,
    of: fn(&T) -> f64,
    bins: Bins,
}

impl<T> Quantity<T> {
    pub(in crate::report) fn new(
        name: &'static str,
        unit: &'static str,
        of: fn(&T) -> f64,
        bins: Bins,
    ) -> Quantity<T> {
        Quantity { name, unit, of, bins }
    }

    /// Counts an item; unknown values are ignored.
    pub(in crate::report) fn add(&mut self, item: &T) {
        self.bins.add((self.of)(item));
    }

    /// Returns the histogram; `None` without known values.
    pub(in crate::report) fn finish(self) -> Option<QuantityHistogram> {
        self.bins.finish(self.name, self.unit)
    }
}

/// Bins per factor of two.
const PER_OCTAVE: usize = 8;
/// `2^(i/8)` from `i = 1`.
const EDGES: [f64; PER_OCTAVE - 1] = [
    1.090_507_732_665_257_7,
    1.189_207_115_002_721,
    1.296_839_554_651_009_6,
    std::f64::consts::SQRT_2,
    1.542_210_825_407_940_7,
    1.681_792_830_507_429,
    1.834_008_086_409_342_4,
];
/// Range of octaves: from about 1e-6 to 1e6.
const OCTAVES: [i64; 2] = [-20, 20];

/// A histogram being filled.
#[derive(Clone, Debug)]
pub(in crate::report) struct Bins {
    scale: BinScale,
    counts: Vec<u64>,
    below: u64,
    above: u64,
}

#[derive(Clone, Copy, Debug)]
enum BinScale {
    Linear { first_edge: f64, width: f64 },
    Logarithmic,
}

impl Bins {
    /// Creates `bins` bins of equal width.
    pub(in crate::report) fn linear(first_edge: f64, width: f64, bins: usize) -> Bins {
        Bins { scale: BinScale::Linear { first_edge, width }, counts: vec![0; bins], below: 0, above: 0 }
    }

    /// Creates [`PER_OCTAVE`] bins per factor of two.
    pub(in crate::report) fn logarithmic() -> Bins {
        let bins = (OCTAVES[1] - OCTAVES[0]) as usize * PER_OCTAVE;
        Bins { scale: BinScale::Logarithmic, counts: vec![0; bins], below: 0, above: 0 }
    }

    /// Counts a value; NaN is ignored.
    pub(in crate::report) fn add(&mut self, value: f64) {
        if value.is_nan() {
            return;
        }
        let bin = match self.scale {
            // The cast saturates.
            BinScale::Linear { first_edge, width } => ((value - first_edge) / width).floor() as i64,
            BinScale::Logarithmic => logarithmic_bin(value),
        };
        match usize::try_from(bin) {
            Err(_) => self.below += 1,
            Ok(bin) => *self.counts.get_mut(bin).unwrap_or(&mut self.above) += 1,
        }
    }

    /// Returns the histogram; `None` if empty.
    pub(in crate::report) fn finish(self, quantity: &str, unit: &str) -> Option<QuantityHistogram> {
        let first = self.counts.iter().position(|count| *count > 0);
        let (first, counts) = match first {
            None if self.below + self.above == 0 => return None,
            None => (0, Vec::new()),
            Some(first) => {
                let last = self.counts.iter().rposition(|count| *count > 0).unwrap_or(first);
                (first, self.counts.get(first..=last).unwrap_or_default().to_vec())
            }
        };
        let (first_edge, bin) = match self.scale {
            BinScale::Linear { first_edge, width } => (first_edge + first as f64 * width, width),
            BinScale::Logarithmic => {
                let octaves = OCTAVES[0] as f64 + first as f64 / PER_OCTAVE as f64;
                (libm::exp2(octaves), EDGES[0])
            }
        };
        Some(QuantityHistogram {
            quantity: quantity.to_owned(),
            unit: unit.to_owned(),
            logarithmic: matches!(self.scale, BinScale::Logarithmic),
            first_edge,
            bin,
            counts,
            below: self.below,
            above: self.above,
        })
    }
}

/// Bin of a value from its exponent and mantissa; negative below the first bin.
fn logarithmic_bin(value: f64) -> i64 {
    if value <= 0.0 {
        return -1;
    }
    let bits = value.to_bits();
    let exponent = (bits >> 52) as i64 - 1023;
    let mantissa = f64::from_bits((bits & ((1 << 52) - 1)) | 1.0f64.to_bits());
    let within = EDGES.iter().filter(|edge| mantissa >= **edge).count();
    (exponent - OCTAVES[0]) * PER_OCTAVE as i64 + within as i64
}

impl QuantityHistogram {
    /// Each bin as its two edges and its count.
    pub fn bins(&self) -> impl Iterator<Item = ([f64; 2], u64)> + '_ {
        let edge = |i: usize| match self.logarithmic {
            true => self.first_edge * self.bin.powf(i as f64),
            false => self.first_edge + self.bin * i as f64,
        };
        self.counts.iter().enumerate().map(move |(i, count)| ([edge(i), edge(i + 1)], *count))
    }

    /// Total number of values.
    pub fn total(&self) -> u64 {
        self.counts.iter().fold(self.below.saturating_add(self.above), |sum, n| sum.saturating_add(*n))
    }

    /// Quantile, interpolated within a bin; `None` outside the bins.
    pub fn quantile(&self, part: f64) -> Option<f64> {
        let wanted = part * self.total() as f64;
        let mut sum = self.below as f64;
        for ([low, high], count) in self.bins() {
            let next = sum + count as f64;
            if next >= wanted && sum <= wanted {
                return Some(low + (high - low) * ((wanted - sum) / (next - sum).max(1.0)));
            }
            sum = next;
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn of(mut bins: Bins, values: &[f64]) -> Option<QuantityHistogram> {
        values.iter().for_each(|value| bins.add(*value));
        bins.finish("a", "m")
    }

    #[test]
    fn linear_bins_are_where_they_are_said_to_be() {
        let found = of(Bins::linear(-1.0, 0.5, 4), &[-1.0, -0.6, 0.75, 1.0, -1.1, f64::NAN, 0.9]).unwrap();
        assert_eq!(found.counts, [2, 0, 0, 2]);
        assert_eq!((found.below, found.above), (1, 1));
        assert_eq!(found.bins().last(), Some(([0.5, 1.0], 2)));
        let found = of(Bins::linear(0.0, 1.0, 9), &[3.5, 4.5, 4.5]).unwrap();
        assert_eq!((found.first_edge, found.counts.as_slice()), (3.0, &[1, 2][..]));
        assert_eq!(found.quantile(0.5), Some(4.25));
        assert!(of(Bins::linear(0.0, 1.0, 9), &[f64::NAN]).is_none());
        let beyond = of(Bins::linear(0.0, 1.0, 9), &[f64::INFINITY, -1e300]).unwrap();
        assert_eq!((beyond.below, beyond.above, beyond.counts.len()), (1, 1, 0));
        assert_eq!(beyond.quantile(0.5), None);
    }

    #[test]
    fn zero_and_less_lie_below_logarithmic_bins() {
        let found = of(Bins::logarithmic(), &[0.0, -3.0, 1e-9, 1e9, 1.0]).unwrap();
        assert_eq!((found.below, found.above, found.counts.as_slice()), (3, 1, &[1][..]));
        assert_eq!(found.first_edge, 1.0);
    }

    proptest! {
        #[test]
        fn a_value_lies_between_the_edges_of_its_logarithmic_bin(log2 in -19.9f64..19.9) {
            let value = log2.exp2();
            let found = of(Bins::logarithmic(), &[value]).unwrap();
            let ([low, high], count) = found.bins().next().unwrap();
            prop_assert_eq!(count, 1);
            prop_assert!(low <= value * (1.0 + 1e-14) && value < high * (1.0 + 1e-14));
        }
    }
}

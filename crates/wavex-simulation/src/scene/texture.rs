//! Random variation as a function of position.

use super::super::random::{Random, cell, hash};
use super::super::whole_and_part;

/// A smooth random field in [0, 1] (value noise with two grain sizes).
///
/// Values on a square lattice are interpolated.
#[derive(Clone, Copy, Debug)]
pub(super) struct Texture {
    keys: [u64; 2],
    per_cell: [f64; 2],
}

/// Weight of the coarse grain.
const COARSE: f64 = 0.6;
/// Ratio of coarse to fine grain size.
const FINENESS: f64 = 7.0;

impl Texture {
    /// Creates an independent field for each seed and `name`, with this coarse grain size, m.
    pub(super) fn new(seed: u64, name: u64, grain_m: f64) -> Texture {
        let keys = [0, 1].map(|octave| hash([seed, name, octave]));
        Texture { keys, per_cell: [1.0 / grain_m, FINENESS / grain_m] }
    }

    /// Value at a position, in [0, 1], mean 0.5.
    pub(super) fn at(&self, x: f64, y: f64) -> f64 {
        COARSE * self.coarse(x, y) + (1.0 - COARSE) * self.octave(1, x, y)
    }

    /// Value of the coarse grain alone, in [0, 1], mean 0.5.
    pub(super) fn coarse(&self, x: f64, y: f64) -> f64 {
        self.octave(0, x, y)
    }

    fn octave(&self, octave: usize, x: f64, y: f64) -> f64 {
        let (key, per_cell) = (self.keys[octave], self.per_cell[octave]);
        let ((i, u), (j, v)) = (whole_and_part(x * per_cell), whole_and_part(y * per_cell));
        let (u, v) = (smooth(u), smooth(v));
        let [south_west, south_east, north_west, north_east] = cell(key, i, j);
        let south = south_west + u * (south_east - south_west);
        let north = north_west + u * (north_east - north_west);
        south + v * (north - south)
    }

    /// Quantile of the field over all positions.
    pub(super) fn quantile(&self, share: f64) -> f64 {
        let mut random = Random::from_key(self.keys[0]);
        let reach_m = 1e4 / self.per_cell[0];
        let mut place = || reach_m * (random.uniform() - 0.5);
        let mut values: Vec<f64> =
            (0..8192).map(|_| (place(), place())).map(|(x, y)| self.at(x, y)).collect();
        values.sort_by(f64::total_cmp);
        match ((share * values.len() as f64) as usize).checked_sub(1) {
            None => -1.0,
            Some(last) => values.get(last).copied().unwrap_or(1.0),
        }
    }
}

/// Smooth step from 0 to 1 with zero slope at both ends.
fn smooth(t: f64) -> f64 {
    t * t * (3.0 - 2.0 * t)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_field_is_continuous_and_centred() {
        let texture = Texture::new(1, 2, 5.0);
        let places =
            || (0..200).flat_map(|i| (0..200).map(move |j| (0.9 * f64::from(i), 0.9 * f64::from(j))));
        let mean = places().map(|(x, y)| texture.at(x, y)).sum::<f64>() / 40_000.0;
        assert!((mean - 0.5).abs() < 0.02, "{mean}");
        for (x, y) in places() {
            let value = texture.at(x, y);
            assert!((0.0..1.0).contains(&value));
            assert!((texture.at(x + 1e-6, y + 1e-6) - value).abs() < 1e-5);
        }
    }

    #[test]
    fn quantiles_have_their_share_of_values_below() {
        let texture = Texture::new(3, 4, 5.0);
        let places = (0..300).flat_map(|i| (0..300).map(move |j| (7.3 * f64::from(i), 7.3 * f64::from(j))));
        let values: Vec<f64> = places.map(|(x, y)| texture.at(x, y)).collect();
        for share in [0.05, 0.3, 0.9] {
            let limit = texture.quantile(share);
            let below = values.iter().filter(|&&value| value < limit).count() as f64 / values.len() as f64;
            assert!((below - share).abs() < 0.02, "{below} for {share}");
        }
        let all = texture.quantile(1.0);
        assert!(values.iter().filter(|&&value| value < all).count() > 89_900);
        assert_eq!(texture.quantile(0.0), -1.0, "below every value");
    }

    #[test]
    fn fields_differ_by_name_and_seed() {
        let at = |seed, name| Texture::new(seed, name, 5.0).at(12.3, 45.6);
        assert!(at(1, 2) != at(1, 3) && at(1, 2) != at(2, 2));
    }
}

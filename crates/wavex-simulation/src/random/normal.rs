//! Normally distributed numbers by the ziggurat method.

use super::Random;

/// Number of layers of equal area.
const LAYERS: usize = 256;
/// Start of the tail, for 256 layers (Marsaglia and Tsang 2000, section 2).
const TAIL: f64 = 3.654_152_885_361_009;

/// Sampler of the standard normal distribution.
///
/// Marsaglia and Tsang 2000, "The ziggurat method for generating random variables", J. Stat. Softw.
/// 5(8), in the form of Doornik 2005, "An improved ziggurat method to generate normal random
/// samples": layer and position in the layer come from different bits, and the position has 53
/// bits.
#[derive(Clone, Debug)]
pub struct Normal {
    /// Right edge of each layer, from the lowest up; the last is 0.
    ///
    /// The first is the edge of a box with the area of the lowest layer and its tail.
    edge: [f64; LAYERS + 1],
    /// Fraction of each layer that is entirely below the density.
    inner: [f64; LAYERS],
}

impl Default for Normal {
    fn default() -> Normal {
        let area = TAIL * density(TAIL) + libm::sqrt(core::f64::consts::FRAC_PI_2) * upper_tail(TAIL);
        let mut edge = [0.0; LAYERS + 1];
        edge[0] = area / density(TAIL);
        edge[1] = TAIL;
        for layer in 2..LAYERS {
            let height = density(edge[layer - 1]) + area / edge[layer - 1];
            edge[layer] = (-2.0 * libm::log(height)).sqrt();
        }
        let inner = core::array::from_fn(|layer| edge[layer + 1] / edge[layer]);
        Normal { edge, inner }
    }
}

impl Normal {
    /// Draws a number of mean 0 and variance 1.
    #[inline]
    pub fn draw(&self, random: &mut Random) -> f64 {
        loop {
            let bits = random.bits();
            let layer = (bits % LAYERS as u64) as usize;
            let place = 2.0 * super::unit(bits) - 1.0;
            let x = place * self.edge[layer];
            if place.abs() < self.inner[layer] {
                return x;
            }
            if let Some(x) = self.draw_outside(layer, x, random) {
                return x;
            }
        }
    }

    /// Accepts or rejects a position in the part of a layer cut by the density (1 in 100 draws).
    #[cold]
    fn draw_outside(&self, layer: usize, x: f64, random: &mut Random) -> Option<f64> {
        if layer == 0 {
            return Some(draw_tail(random, x < 0.0));
        }
        let low = density(self.edge[layer]);
        let high = density(self.edge[layer + 1]);
        (low + random.uniform() * (high - low) < density(x)).then_some(x)
    }
}

/// Draws a number beyond [`TAIL`] (Marsaglia 1964, as in Marsaglia and Tsang 2000, section 2).
fn draw_tail(random: &mut Random, negative: bool) -> f64 {
    loop {
        // 1 - u is in (0, 1], where the logarithm is finite.
        let beyond = -libm::log(1.0 - random.uniform()) / TAIL;
        let exponential = -libm::log(1.0 - random.uniform());
        if 2.0 * exponential > beyond * beyond {
            let x = TAIL + beyond;
            return if negative { -x } else { x };
        }
    }
}

/// Normal density, scaled to 1 at 0.
fn density(x: f64) -> f64 {
    libm::exp(-0.5 * x * x)
}

/// Two-sided tail probability beyond `x`.
fn upper_tail(x: f64) -> f64 {
    libm::erfc(x * core::f64::consts::FRAC_1_SQRT_2)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn draws(key: u64, n: usize) -> impl Iterator<Item = f64> {
        let (normal, mut random) = (Normal::default(), Random::from_key(key));
        (0..n).map(move |_| normal.draw(&mut random))
    }

    /// The top layer closes exactly: it has the same area as the others.
    #[test]
    fn layers_have_equal_areas() {
        let normal = Normal::default();
        let area = normal.edge[0] * density(TAIL);
        let top = normal.edge[LAYERS - 1];
        assert!((top * (1.0 - density(top)) / area - 1.0).abs() < 1e-9);
        assert!(normal.edge.windows(2).all(|pair| pair[0] > pair[1]));
    }

    #[test]
    fn moments_are_those_of_the_normal_distribution() {
        let n = 2_000_000;
        let mut sums = [0.0; 4];
        for x in draws(1, n) {
            sums.iter_mut().zip(1..).for_each(|(sum, power)| *sum += x.powi(power));
        }
        let [mean, square, cube, fourth] = sums.map(|sum| sum / n as f64);
        let sd = 1.0 / (n as f64).sqrt();
        assert!(mean.abs() < 4.0 * sd, "mean {mean}");
        assert!((square - 1.0).abs() < 4.0 * sd * 2f64.sqrt(), "variance {square}");
        assert!(cube.abs() < 4.0 * sd * 15f64.sqrt(), "third moment {cube}");
        assert!((fourth - 3.0).abs() < 4.0 * sd * 96f64.sqrt(), "fourth moment {fourth}");
    }

    /// Tail probabilities, including the tail beyond the layers, agree with the error function.
    #[test]
    fn tail_probabilities_agree_with_the_error_function() {
        let n = 2_000_000;
        let places = [0.1, 0.5, 1.0, 2.0, 3.0, TAIL, 4.0];
        let mut beyond = [[0u32; 7]; 2];
        for x in draws(2, n) {
            for (k, &place) in places.iter().enumerate() {
                beyond[usize::from(x < 0.0)][k] += u32::from(x.abs() > place);
            }
        }
        for (k, &place) in places.iter().enumerate() {
            let expected = n as f64 * upper_tail(place) / 2.0;
            for count in [beyond[0][k], beyond[1][k]] {
                let z = (f64::from(count) - expected) / expected.sqrt();
                assert!(z.abs() < 4.0, "beyond {place}: {count} for {expected}");
            }
        }
    }
}

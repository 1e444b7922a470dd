//! Random numbers that depend only on a key, not on the machine.
//!
//! A [`Random`] is xoshiro256++ (Blackman and Vigna 2021, "Scrambled linear pseudorandom number
//! generators", ACM TOMS 47:36), seeded by SplitMix64 (Steele, Lea and Flood 2014, "Fast splittable
//! pseudorandom number generators", OOPSLA).
//! Streams of different keys do not overlap, so no two shots have the same noise.

mod normal;

pub use normal::Normal;
use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::{Rng, SeedableRng};

/// Purpose of a stream: separate streams keep changes of one component from affecting others.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Purpose {
    /// Time and energy of the emission.
    Laser,
    /// Noise of the receiver.
    Noise,
    /// Deviation of the emission time from the mean rate.
    Modulation,
    /// Noise of the receiver for strong echoes.
    HighPowerNoise,
    /// Spurious pulses without a target.
    FalseAlarms,
}

/// A stream of random numbers.
///
/// # Examples
///
/// ```
/// use wavex_simulation::random::{Purpose, Random};
///
/// let first = |shot| Random::of_shot(1, 0, shot, Purpose::Noise).uniform();
/// assert_eq!(first(7), first(7));
/// assert_ne!(first(7), first(8));
/// ```
#[derive(Clone, Debug)]
pub struct Random(Xoshiro256PlusPlus);

impl Random {
    /// Stream of a shot (by its index in the line) for one purpose.
    pub fn of_shot(seed: u64, line: u32, shot: u32, purpose: Purpose) -> Random {
        Random::from_key(hash([purpose as u64, seed, u64::from(line), u64::from(shot)]))
    }

    /// Stream of a key.
    pub(crate) fn from_key(key: u64) -> Random {
        Random(Xoshiro256PlusPlus::seed_from_u64(key))
    }

    /// 64 random bits.
    #[inline]
    pub(crate) fn bits(&mut self) -> u64 {
        self.0.next_u64()
    }

    /// A number in [0, 1) from 53 random bits.
    pub fn uniform(&mut self) -> f64 {
        unit(self.bits())
    }
}

/// Random numbers in [0, 1) at the corners of a lattice cell.
///
/// The corners are (x, y), (x + 1, y), (x, y + 1) and (x + 1, y + 1). A corner has the same number
/// in all four cells that share it.
pub fn cell(key: u64, x: i64, y: i64) -> [f64; 4] {
    let start = hash([key]);
    let [west, east] = [x, x + 1].map(|x| hashed_on(start, x as u64));
    let [south, north] = [y, y + 1].map(|y| y as u64);
    [(west, south), (east, south), (west, north), (east, north)]
        .map(|(column, row)| unit(hashed_on(column, row)))
}

/// 64-bit hash of `words`; keys that differ only in the last word never collide.
pub fn hash<const N: usize>(words: [u64; N]) -> u64 {
    words.into_iter().fold(0, hashed_on)
}

/// Extends a hash by one word.
fn hashed_on(hash: u64, word: u64) -> u64 {
    mix(hash.wrapping_add(GOLDEN) ^ word)
}

/// 2^64 divided by the golden ratio: the increment of SplitMix64.
pub(super) const GOLDEN: u64 = 0x9e37_79b9_7f4a_7c15;

/// Output function of SplitMix64, a permutation of 64-bit numbers.
pub(super) fn mix(z: u64) -> u64 {
    let z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// Converts the upper 53 bits to a number in [0, 1).
pub(super) fn unit(bits: u64) -> f64 {
    const STEP: f64 = 1.0 / (1u64 << 53) as f64;
    (bits >> 11) as f64 * STEP
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The first numbers of streams: equal on every machine and in every version of wavex.
    #[test]
    fn first_numbers_of_streams_are_fixed() {
        let first = |mut random: Random| [(); 3].map(|()| random.bits());
        for (key, expected) in [
            (0, [5987356902031041503, 7051070477665621255, 6633766593972829180]),
            (1, [14971601782005023387, 13781649495232077965, 1847458086238483744]),
            (7, [1021219803524665661, 3174977118032272916, 13236943193235544178]),
            (1_234_567, [437095814655224680, 8127161015984454572, 18128670339019551454]),
            (u64::MAX, [6254647548650071986, 16610832622747802512, 16422857234328439435]),
        ] {
            assert_eq!(first(Random::from_key(key)), expected, "key {key}");
        }
        let mut random = Random::of_shot(42, 3, 5, Purpose::Noise);
        assert_eq!([(); 2].map(|()| random.bits()), [7798008094871981112, 16278291905394092888]);
        assert_eq!(random.uniform(), 0.0342042647895191);
    }

    #[test]
    fn streams_differ_by_shot_line_seed_and_purpose() {
        let first = |seed, line, shot, purpose| Random::of_shot(seed, line, shot, purpose).bits();
        let base = first(1, 2, 3, Purpose::Laser);
        assert_eq!(base, first(1, 2, 3, Purpose::Laser));
        let others = [
            first(2, 2, 3, Purpose::Laser),
            first(1, 3, 3, Purpose::Laser),
            first(1, 2, 4, Purpose::Laser),
            first(1, 3, 2, Purpose::Laser),
            first(1, 2, 3, Purpose::Noise),
        ];
        assert!(others.iter().all(|&other| other != base));
    }

    #[test]
    fn uniform_numbers_fill_the_interval_evenly() {
        let mut random = Random::from_key(7);
        let mut counts = [0u32; 100];
        (0..1_000_000).for_each(|_| counts[(random.uniform() * 100.0) as usize] += 1);
        let chi2: f64 = counts.iter().map(|&n| (f64::from(n) - 1e4).powi(2) / 1e4).sum();
        assert!((60.0..145.0).contains(&chi2), "99 degrees of freedom, chi-square {chi2}");
    }

    #[test]
    fn neighbouring_cells_share_their_corners() {
        let [_, east, north, far] = cell(9, -3, 7);
        assert_eq!(cell(9, -2, 7)[0], east);
        assert_eq!(cell(9, -3, 8)[..2], [north, far]);
        assert_eq!(cell(9, -2, 8)[0], far);
    }

    #[test]
    fn lattice_neighbours_are_uncorrelated() {
        let n = 300;
        let value = |x, y| cell(5, x, y)[0] - 0.5;
        let mut products = [0.0; 2];
        for (x, y) in (-n..n).flat_map(|x| (-n..n).map(move |y| (x, y))) {
            products[0] += value(x, y) * value(x + 1, y);
            products[1] += value(x, y) * value(x, y + 1);
        }
        let sd = (4 * n * n) as f64;
        for product in products {
            assert!(product.abs() < 4.0 * sd.sqrt() / 12.0, "{product}");
        }
    }
}

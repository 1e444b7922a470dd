//! Sixteen `f32` in lock-step, on the instruction sets of the processor.
//!
//! In the SIMD kernels only this crate knows instruction sets, and only it contains `unsafe`.
//! Every kernel is written once against [`Simd`] and compiled once per level. All levels have sixteen
//! lanes (AVX2 in two registers, the portable one in an array) and round alike: a multiplication
//! followed by an addition is fused at every level, division and square root follow IEEE 754, and
//! [`Simd::sum_each`] adds in a fixed tree. The levels therefore agree to the bit.
//!
//! ```
//! use wavex_simd::{Kernel, LANES, Simd, SimdLevel, Sixteen};
//!
//! struct Sum<'a>(&'a [Sixteen]);
//!
//! impl Kernel for Sum<'_> {
//!     type Output = Sixteen;
//!
//!     // Inlined into a function that is compiled for the instruction set.
//!     #[inline(always)]
//!     fn run<S: Simd>(self, s: S) -> Sixteen {
//!         let mut sum = s.splat(0.0);
//!         for row in self.0 {
//!             sum = s.add(sum, s.load(row));
//!         }
//!         let mut out = [0.0; LANES];
//!         s.store(sum, &mut out);
//!         out
//!     }
//! }
//!
//! assert_eq!(SimdLevel::best().run(Sum(&[[1.5; LANES]; 3])), [4.5; LANES]);
//! ```
//!
//! [`statistics`] has the median. [`dot`] and [`quantise`] are loops over doubles, which the compiler vectorises for the same levels.

#[cfg(target_arch = "x86_64")]
mod avx2;
#[cfg(target_arch = "x86_64")]
mod avx512;
pub mod dot;
mod portable;
pub mod quantise;
pub mod statistics;

/// Lanes of a vector.
pub const LANES: usize = 16;

/// Samples per cache line.
#[cfg(target_arch = "x86_64")]
const CACHE_LINE_SAMPLES: usize = 32;

/// Contents of a register in memory.
pub type Sixteen = [f32; LANES];

/// Operations of one instruction set.
///
/// A value of the type proves that the processor supports it. Masks have bit `i` for lane `i`.
/// `min` and `max` return the second operand if either is NaN, as SSE does.
pub trait Simd: Copy {
    /// Sixteen lanes.
    type V: Copy;
    /// Eight lanes.
    type Half: Copy;

    /// Broadcasts a value to every lane.
    fn splat(self, value: f32) -> Self::V;
    /// Loads a vector from memory.
    fn load(self, from: &Sixteen) -> Self::V;
    /// Stores a vector in memory.
    fn store(self, value: Self::V, to: &mut Sixteen);
    /// Prefetches the first samples that will soon be read.
    ///
    /// The processor prefetches the next ones itself. Results do not depend on it.
    fn fetch(self, soon: &[u16]);
    /// Loads two neighbours into each lane, as bits.
    ///
    /// For [`Simd::transpose`], [`Simd::select`] and the operations that follow.
    fn pairs(self, from: &[u16; 2 * LANES]) -> Self::V;
    /// Loads up to thirty-two numbers as pairs, padded with zeros.
    #[inline(always)]
    fn some_pairs(self, from: &[u16]) -> Self::V {
        let mut padded = [0; 2 * LANES];
        for (to, from) in padded.iter_mut().zip(from) {
            *to = *from;
        }
        self.pairs(&padded)
    }
    /// Broadcasts a pair to every lane.
    fn splat_pair(self, pair: [u16; 2]) -> Self::V;
    /// Minimum of each number in two vectors of pairs.
    fn min_pairs(self, a: Self::V, b: Self::V) -> Self::V;
    /// Maximum of each number in two vectors of pairs.
    fn max_pairs(self, a: Self::V, b: Self::V) -> Self::V;
    /// Adds the products of each pair's two numbers to `sum`.
    ///
    /// Numbers are signed, of 16 bits in `a` and `b` and of 32 bits in the result, as bits. It
    /// wraps.
    fn dot(self, a: Self::V, b: Self::V, sum: Self::V) -> Self::V;
    /// Converts integers of 32 bits, given as bits, to `f32`, ties to even.
    fn float(self, bits: Self::V) -> Self::V;
    /// The first number of each lane's pair as `f32`.
    fn first(self, pairs: Self::V) -> Self::V;
    /// The second number of each lane's pair as `f32`.
    fn second(self, pairs: Self::V) -> Self::V;
    /// `a + b`.
    fn add(self, a: Self::V, b: Self::V) -> Self::V;
    /// `a − b`.
    fn sub(self, a: Self::V, b: Self::V) -> Self::V;
    /// `a b`.
    fn mul(self, a: Self::V, b: Self::V) -> Self::V;
    /// `a / b`.
    fn div(self, a: Self::V, b: Self::V) -> Self::V;
    /// Square root.
    fn sqrt(self, a: Self::V) -> Self::V;
    /// Minimum; `b` if either is NaN.
    fn min(self, a: Self::V, b: Self::V) -> Self::V;
    /// Maximum; `b` if either is NaN.
    fn max(self, a: Self::V, b: Self::V) -> Self::V;
    /// `a b + c`, rounded once.
    fn fma(self, a: Self::V, b: Self::V, c: Self::V) -> Self::V;
    /// `c − a b`, rounded once.
    fn fnma(self, a: Self::V, b: Self::V, c: Self::V) -> Self::V;
    /// Lanes with `a ≥ b`.
    fn ge(self, a: Self::V, b: Self::V) -> u16;
    /// Lanes with `a > b`.
    fn gt(self, a: Self::V, b: Self::V) -> u16;
    /// `yes` in the lanes of the mask, `no` in the others.
    fn select(self, mask: u16, yes: Self::V, no: Self::V) -> Self::V;
    /// Looks up table values at integers from 0 to 15.
    fn look_up(self, table: &Sixteen, at: Self::V) -> Self::V;
    /// Rounds to the nearest integer, ties to even; magnitudes below 2²².
    fn round(self, a: Self::V) -> Self::V;
    /// Converts to the nearest integers, ties to even; magnitudes below 2²².
    fn to_i32(self, a: Self::V, to: &mut [i32; LANES]);
    /// Swaps lane `j` of vector `i` with lane `i` of vector `j`.
    fn transpose(self, of: &mut [Self::V; LANES]);
    /// Bit `i` is bit `lane` of the `i`-th mask.
    fn lane_bits(self, masks: &[u16; 64], lane: usize) -> u64;
    /// Sums of lanes 8 apart.
    ///
    /// Vectors kept for [`Simd::sum_each`] take half the memory.
    fn halved(self, a: Self::V) -> Self::Half;
    /// Lane `i` is the sum of `of[i]`'s lanes: lanes 4 apart first, then 2, 1.
    fn sum_each(self, of: &[Self::Half; LANES]) -> Self::V;
}

/// A computation that is the same at every level.
///
/// Its `run` and the functions that it calls are marked `#[inline(always)]`: only then are they
/// compiled for the instruction set. Closures with vector operations are not.
pub trait Kernel {
    /// Result of the computation.
    type Output;
    /// Runs the computation with the operations of one instruction set.
    fn run<S: Simd>(self, simd: S) -> Self::Output;
}

/// Instruction set of the SIMD kernels.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SimdLevel {
    /// AVX-512 F, BW, DQ and VL.
    Avx512,
    /// AVX2 with FMA.
    Avx2,
    /// Arrays, without intrinsics.
    ///
    /// On aarch64 they compile to NEON, with the fused multiply-add of all such processors. On
    /// x86-64 without FMA this level is exact but slow, because the library computes each fused
    /// operation.
    Portable,
}

impl SimdLevel {
    /// All levels, fastest first.
    pub const ALL: [SimdLevel; 3] = [SimdLevel::Avx512, SimdLevel::Avx2, SimdLevel::Portable];

    /// Whether this processor supports it.
    #[inline]
    pub fn is_available(self) -> bool {
        match self {
            #[cfg(target_arch = "x86_64")]
            SimdLevel::Avx512 => avx512::Avx512::detect().is_some(),
            #[cfg(target_arch = "x86_64")]
            SimdLevel::Avx2 => avx2::Avx2::detect().is_some(),
            #[cfg(not(target_arch = "x86_64"))]
            SimdLevel::Avx512 | SimdLevel::Avx2 => false,
            SimdLevel::Portable => true,
        }
    }

    /// Returns the fastest level that this processor supports.
    #[inline]
    pub fn best() -> SimdLevel {
        SimdLevel::ALL.into_iter().find(|level| level.is_available()).unwrap_or(SimdLevel::Portable)
    }

    /// Returns this level, or the portable one if the processor lacks it.
    #[inline]
    pub fn processor(self) -> Processor {
        match self {
            #[cfg(target_arch = "x86_64")]
            SimdLevel::Avx512 => {
                Processor(avx512::Avx512::detect().map_or(Detected::Portable, Detected::Avx512))
            }
            #[cfg(target_arch = "x86_64")]
            SimdLevel::Avx2 => Processor(avx2::Avx2::detect().map_or(Detected::Portable, Detected::Avx2)),
            _ => Processor(Detected::Portable),
        }
    }

    /// Runs a kernel at this level, or at the portable one if the processor lacks it.
    #[inline]
    pub fn run<K: Kernel>(self, kernel: K) -> K::Output {
        self.processor().run(kernel)
    }
}

/// A level verified to be supported by the processor.
#[derive(Clone, Copy)]
pub struct Processor(Detected);

#[derive(Clone, Copy)]
enum Detected {
    #[cfg(target_arch = "x86_64")]
    Avx512(avx512::Avx512),
    #[cfg(target_arch = "x86_64")]
    Avx2(avx2::Avx2),
    Portable,
}

impl Processor {
    /// Runs a kernel in a function compiled for the level's instructions.
    #[inline]
    pub fn run<K: Kernel>(self, kernel: K) -> K::Output {
        match self.0 {
            #[cfg(target_arch = "x86_64")]
            Detected::Avx512(simd) => simd.run(kernel),
            #[cfg(target_arch = "x86_64")]
            Detected::Avx2(simd) => simd.run(kernel),
            Detected::Portable => kernel.run(portable::Portable),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every operation once, on ordinary values and on rounding edge cases.
    struct Everything;

    impl Kernel for Everything {
        type Output = Vec<u32>;

        fn run<S: Simd>(self, s: S) -> Vec<u32> {
            let mut rows = [[0.0; LANES]; LANES];
            for (r, row) in rows.iter_mut().enumerate() {
                for (k, value) in row.iter_mut().enumerate() {
                    *value = ((r * 31 + k * 17) as f32 * 0.731).sin() * 40.0 + (k as f32 - 7.5);
                }
            }
            let v: [S::V; LANES] = std::array::from_fn(|i| s.load(&rows[i]));
            let mut bits = Vec::new();
            let (ge, gt) = (s.ge(v[0], v[1]), s.gt(v[2], v[3]));
            bits.extend([
                u32::from(ge),
                u32::from(gt),
                u32::from(s.ge(v[4], v[4])),
                u32::from(s.gt(v[4], v[4])),
            ]);
            let halves = s.mul(s.round(v[5]), s.splat(0.5));
            let not_a_number = s.sqrt(s.splat(-1.0));
            let numbers = std::array::from_fn(|i| [0, 1, 255, 256, 4095, 32_768, 65_535, 9][i % 8]);
            let pairs = s.pairs(&numbers);
            let others = s.pairs(&std::array::from_fn(|i| numbers[(i + 3) % 8].wrapping_mul(40_503)));
            let dot = s.dot(pairs, others, s.splat_pair([77, 0]));
            let shown = [
                s.add(v[0], v[1]),
                s.sub(v[0], v[1]),
                s.mul(v[0], v[1]),
                s.div(v[0], v[1]),
                s.sqrt(s.mul(v[2], v[2])),
                s.min(v[0], v[1]),
                s.max(v[0], v[1]),
                s.max(not_a_number, v[6]),
                s.min(not_a_number, v[6]),
                s.fma(v[0], v[1], v[2]),
                s.fnma(v[0], v[1], v[2]),
                s.select(ge, v[7], v[8]),
                s.round(v[9]),
                s.round(halves),
                s.look_up(&rows[3], s.load(&std::array::from_fn(|i| (i * 7 % 16) as f32))),
                s.sum_each(&v.map(|v| s.halved(v))),
                s.first(pairs),
                s.second(pairs),
                s.some_pairs(&numbers[..0]),
                s.some_pairs(&numbers[..7]),
                s.some_pairs(&numbers[..31]),
                s.some_pairs(&numbers),
                s.min_pairs(pairs, others),
                s.max_pairs(pairs, others),
                s.float(dot),
                s.float(s.dot(dot, s.splat_pair([65_535, 32_767]), dot)),
            ];
            for value in shown {
                let mut out = [0.0; LANES];
                s.store(value, &mut out);
                bits.extend(out.map(f32::to_bits));
            }
            let mut turned = v;
            s.transpose(&mut turned);
            for value in turned {
                let mut out = [0.0; LANES];
                s.store(value, &mut out);
                bits.extend(out.map(f32::to_bits));
            }
            let masks = std::array::from_fn(|i| (i * 40_503 % 65_536) as u16);
            bits.extend([0, 7, 15].map(|lane| s.lane_bits(&masks, lane)).map(|b| (b ^ (b >> 32)) as u32));
            let mut whole = [0; LANES];
            s.to_i32(halves, &mut whole);
            bits.extend(whole.map(|i| i as u32));
            bits
        }
    }

    #[test]
    fn every_level_gives_the_same_bits() {
        let plain = SimdLevel::Portable.run(Everything);
        for level in SimdLevel::ALL.into_iter().filter(|level| level.is_available()) {
            assert_eq!(level.run(Everything), plain, "{level:?}");
        }
    }

    #[test]
    fn rows_become_columns_and_bits_of_a_lane_a_word() {
        struct Turn;
        impl Kernel for Turn {
            type Output = (Vec<Sixteen>, u64);
            fn run<S: Simd>(self, s: S) -> (Vec<Sixteen>, u64) {
                let row = |i: usize| s.load(&std::array::from_fn(|k| (16 * i + k) as f32));
                let mut v: [S::V; LANES] = std::array::from_fn(row);
                s.transpose(&mut v);
                let mut out = vec![[0.0; LANES]; LANES];
                v.iter().zip(&mut out).for_each(|(v, out)| s.store(*v, out));
                let masks = std::array::from_fn(|i| if i % 5 == 0 { 1 << 9 } else { !(1 << 9) });
                (out, s.lane_bits(&masks, 9))
            }
        }
        for level in SimdLevel::ALL {
            let (columns, bits) = level.run(Turn);
            for (i, column) in columns.iter().enumerate() {
                assert_eq!(*column, std::array::from_fn(|k| (16 * k + i) as f32), "{level:?}");
            }
            assert_eq!(bits, (0..64).step_by(5).fold(0, |bits, i| bits | 1u64 << i), "{level:?}");
        }
    }

    #[test]
    fn pairs_are_neighbours() {
        struct Pairs;
        impl Kernel for Pairs {
            type Output = [Sixteen; 2];
            fn run<S: Simd>(self, s: S) -> [Sixteen; 2] {
                let pairs = s.pairs(&std::array::from_fn(|i| 65_535 - i as u16));
                let mut out = [[0.0; LANES]; 2];
                s.store(s.first(pairs), &mut out[0]);
                s.store(s.second(pairs), &mut out[1]);
                out
            }
        }
        for level in SimdLevel::ALL {
            let number = |i: usize| (65_535 - i) as f32;
            let [first, second] = level.run(Pairs);
            assert_eq!(first, std::array::from_fn(|i| number(2 * i)), "{level:?}");
            assert_eq!(second, std::array::from_fn(|i| number(2 * i + 1)), "{level:?}");
        }
    }

    #[test]
    fn sums_follow_the_tree() {
        struct Sum;
        impl Kernel for Sum {
            type Output = Sixteen;
            fn run<S: Simd>(self, s: S) -> Sixteen {
                let v: [S::Half; LANES] = std::array::from_fn(|i| s.halved(s.splat(i as f32)));
                let mut out = [0.0; LANES];
                s.store(s.sum_each(&v), &mut out);
                out
            }
        }
        for level in SimdLevel::ALL {
            assert_eq!(level.run(Sum), std::array::from_fn(|i| 16.0 * i as f32), "{level:?}");
        }
        assert!(SimdLevel::best().is_available());
    }

    /// A virtual machine may hide a single instruction set of a processor.
    #[test]
    fn every_enabled_instruction_set_is_detected() {
        for file in ["avx2.rs", "avx512.rs"] {
            let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("src").join(file);
            let code = std::fs::read_to_string(path).unwrap();
            let (_, enabled) = code.split_once("#[target_feature(enable = \"").unwrap();
            let enabled: Vec<&str> = enabled.split('"').next().unwrap().split(',').collect();
            assert!(enabled.len() >= 2, "{enabled:?}");
            for set in enabled {
                assert!(code.contains(&format!("is_x86_feature_detected!(\"{set}\")")), "{file}: {set}");
            }
        }
    }
}

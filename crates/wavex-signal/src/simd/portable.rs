//! Sixteen lanes in an array.

use super::{LANES, Simd, Sixteen};

/// The portable path, without requirements on the processor.
#[derive(Clone, Copy)]
pub(super) struct Portable;

/// Computes an array lane by lane.
macro_rules! each {
    ($lane:ident => $value:expr) => {{
        let mut out = [Default::default(); LANES];
        for $lane in 0..LANES {
            out[$lane] = $value;
        }
        out
    }};
}

/// Computes a mask with one bit per lane.
macro_rules! mask {
    ($lane:ident => $set:expr) => {{
        let mut bits = 0u16;
        for $lane in 0..LANES {
            bits |= u16::from($set) << $lane;
        }
        bits
    }};
}

/// Joins two numbers into the bits of a lane.
#[inline(always)]
fn join([first, second]: [u16; 2]) -> u32 {
    u32::from(first) | u32::from(second) << 16
}

/// Splits a lane into its two numbers.
#[inline(always)]
fn split(lane: f32) -> [u16; 2] {
    [lane.to_bits() as u16, (lane.to_bits() >> 16) as u16]
}

#[inline(always)]
fn pair_by_pair(a: Sixteen, b: Sixteen, of: impl Fn(u16, u16) -> u16) -> Sixteen {
    each!(i => {
        let ([a, c], [b, d]) = (split(a[i]), split(b[i]));
        f32::from_bits(join([of(a, b), of(c, d)]))
    })
}

impl Simd for Portable {
    type V = Sixteen;
    type Half = [f32; LANES / 2];

    #[inline(always)]
    fn splat(self, value: f32) -> Sixteen {
        [value; LANES]
    }
    #[inline(always)]
    fn load(self, from: &Sixteen) -> Sixteen {
        *from
    }
    #[inline(always)]
    fn store(self, value: Sixteen, to: &mut Sixteen) {
        *to = value;
    }
    #[inline(always)]
    fn transpose(self, of: &mut [Sixteen; LANES]) {
        let rows = *of;
        for (i, column) in of.iter_mut().enumerate() {
            *column = each!(j => rows[j][i]);
        }
    }
    #[inline(always)]
    fn lane_bits(self, masks: &[u16; 64], lane: usize) -> u64 {
        masks.iter().rev().fold(0, |bits, mask| bits << 1 | u64::from(mask >> lane & 1))
    }
    #[inline(always)]
    fn fetch(self, _: &[u16]) {}
    #[inline(always)]
    fn pairs(self, from: &[u16; 2 * LANES]) -> Sixteen {
        each!(i => f32::from_bits(join([from[2 * i], from[2 * i + 1]])))
    }
    #[inline(always)]
    fn splat_pair(self, pair: [u16; 2]) -> Sixteen {
        [f32::from_bits(join(pair)); LANES]
    }
    #[inline(always)]
    fn min_pairs(self, a: Sixteen, b: Sixteen) -> Sixteen {
        pair_by_pair(a, b, u16::min)
    }
    #[inline(always)]
    fn max_pairs(self, a: Sixteen, b: Sixteen) -> Sixteen {
        pair_by_pair(a, b, u16::max)
    }
    #[inline(always)]
    fn dot(self, a: Sixteen, b: Sixteen, sum: Sixteen) -> Sixteen {
        each!(i => {
            let ([a, c], [b, d]) = (split(a[i]), split(b[i]));
            let product = |a: u16, b: u16| i32::from(a.cast_signed()) * i32::from(b.cast_signed());
            let products = product(a, b).wrapping_add(product(c, d));
            f32::from_bits(sum[i].to_bits().wrapping_add(products.cast_unsigned()))
        })
    }
    #[inline(always)]
    fn float(self, bits: Sixteen) -> Sixteen {
        each!(i => bits[i].to_bits().cast_signed() as f32)
    }
    #[inline(always)]
    fn first(self, pairs: Sixteen) -> Sixteen {
        each!(i => (pairs[i].to_bits() & 0xffff) as f32)
    }
    #[inline(always)]
    fn second(self, pairs: Sixteen) -> Sixteen {
        each!(i => (pairs[i].to_bits() >> 16) as f32)
    }
    #[inline(always)]
    fn add(self, a: Sixteen, b: Sixteen) -> Sixteen {
        each!(i => a[i] + b[i])
    }
    #[inline(always)]
    fn sub(self, a: Sixteen, b: Sixteen) -> Sixteen {
        each!(i => a[i] - b[i])
    }
    #[inline(always)]
    fn mul(self, a: Sixteen, b: Sixteen) -> Sixteen {
        each!(i => a[i] * b[i])
    }
    #[inline(always)]
    fn div(self, a: Sixteen, b: Sixteen) -> Sixteen {
        each!(i => a[i] / b[i])
    }
    #[inline(always)]
    fn sqrt(self, a: Sixteen) -> Sixteen {
        each!(i => a[i].sqrt())
    }
    #[inline(always)]
    fn min(self, a: Sixteen, b: Sixteen) -> Sixteen {
        each!(i => if a[i] < b[i] { a[i] } else { b[i] })
    }
    #[inline(always)]
    fn max(self, a: Sixteen, b: Sixteen) -> Sixteen {
        each!(i => if a[i] > b[i] { a[i] } else { b[i] })
    }
    #[inline(always)]
    fn fma(self, a: Sixteen, b: Sixteen, c: Sixteen) -> Sixteen {
        each!(i => a[i].mul_add(b[i], c[i]))
    }
    #[inline(always)]
    fn fnma(self, a: Sixteen, b: Sixteen, c: Sixteen) -> Sixteen {
        each!(i => (-a[i]).mul_add(b[i], c[i]))
    }
    #[inline(always)]
    fn ge(self, a: Sixteen, b: Sixteen) -> u16 {
        mask!(i => a[i] >= b[i])
    }
    #[inline(always)]
    fn gt(self, a: Sixteen, b: Sixteen) -> u16 {
        mask!(i => a[i] > b[i])
    }
    #[inline(always)]
    fn select(self, mask: u16, yes: Sixteen, no: Sixteen) -> Sixteen {
        each!(i => if mask & (1 << i) == 0 { no[i] } else { yes[i] })
    }
    #[inline(always)]
    fn look_up(self, table: &Sixteen, at: Sixteen) -> Sixteen {
        each!(i => table[at[i] as usize % LANES])
    }
    #[inline(always)]
    fn round(self, a: Sixteen) -> Sixteen {
        each!(i => a[i].round_ties_even())
    }
    #[inline(always)]
    fn to_i32(self, a: Sixteen, to: &mut [i32; LANES]) {
        *to = each!(i => a[i].round_ties_even() as i32);
    }
    #[inline(always)]
    fn halved(self, a: Sixteen) -> Self::Half {
        let mut sums = [0.0; LANES / 2];
        for i in 0..LANES / 2 {
            sums[i] = a[i] + a[i + LANES / 2];
        }
        sums
    }
    #[inline(always)]
    fn sum_each(self, of: &[Self::Half; LANES]) -> Sixteen {
        let mut sums = [0.0; LANES];
        for (sum, half) in sums.iter_mut().zip(of) {
            let mut lanes = *half;
            for half in [4, 2, 1] {
                for i in 0..half {
                    lanes[i] += lanes[i + half];
                }
            }
            *sum = lanes[0];
        }
        sums
    }
}

//! Sixteen lanes in an array.

use super::{LANES, Simd, Sixteen};

/// The portable level, without requirements on the processor.
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

/// Functions that are inlined where vectors stay in registers.
///
/// On x86-64 each fused operation is a call in any case, and inlining arrays into all kernels would
/// take most of the time of the build.
macro_rules! operations {
    ($(fn $name:ident($($arguments:tt)*) $(-> $output:ty)? $body:block)*) => {
        $(
            #[cfg_attr(target_arch = "x86_64", inline(never))]
            #[cfg_attr(not(target_arch = "x86_64"), inline(always))]
            fn $name($($arguments)*) $(-> $output)? $body
        )*
    };
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

    operations! {
        fn splat(self, value: f32) -> Sixteen {
            [value; LANES]
        }
        fn load(self, from: &Sixteen) -> Sixteen {
            *from
        }
        fn store(self, value: Sixteen, to: &mut Sixteen) {
            *to = value;
        }
        fn transpose(self, of: &mut [Sixteen; LANES]) {
            let rows = *of;
            for (i, column) in of.iter_mut().enumerate() {
                *column = each!(j => rows[j][i]);
            }
        }
        fn lane_bits(self, masks: &[u16; 64], lane: usize) -> u64 {
            masks.iter().rev().fold(0, |bits, mask| bits << 1 | u64::from(mask >> lane & 1))
        }
        fn fetch(self, _: &[u16]) {}
        fn pairs(self, from: &[u16; 2 * LANES]) -> Sixteen {
            each!(i => f32::from_bits(join([from[2 * i], from[2 * i + 1]])))
        }
        fn splat_pair(self, pair: [u16; 2]) -> Sixteen {
            [f32::from_bits(join(pair)); LANES]
        }
        fn min_pairs(self, a: Sixteen, b: Sixteen) -> Sixteen {
            pair_by_pair(a, b, u16::min)
        }
        fn max_pairs(self, a: Sixteen, b: Sixteen) -> Sixteen {
            pair_by_pair(a, b, u16::max)
        }
        fn dot(self, a: Sixteen, b: Sixteen, sum: Sixteen) -> Sixteen {
            each!(i => {
                let ([a, c], [b, d]) = (split(a[i]), split(b[i]));
                let product = |a: u16, b: u16| i32::from(a.cast_signed()) * i32::from(b.cast_signed());
                let products = product(a, b).wrapping_add(product(c, d));
                f32::from_bits(sum[i].to_bits().wrapping_add(products.cast_unsigned()))
            })
        }
        fn float(self, bits: Sixteen) -> Sixteen {
            each!(i => bits[i].to_bits().cast_signed() as f32)
        }
        fn first(self, pairs: Sixteen) -> Sixteen {
            each!(i => (pairs[i].to_bits() & 0xffff) as f32)
        }
        fn second(self, pairs: Sixteen) -> Sixteen {
            each!(i => (pairs[i].to_bits() >> 16) as f32)
        }
        fn add(self, a: Sixteen, b: Sixteen) -> Sixteen {
            each!(i => a[i] + b[i])
        }
        fn sub(self, a: Sixteen, b: Sixteen) -> Sixteen {
            each!(i => a[i] - b[i])
        }
        fn mul(self, a: Sixteen, b: Sixteen) -> Sixteen {
            each!(i => a[i] * b[i])
        }
        fn div(self, a: Sixteen, b: Sixteen) -> Sixteen {
            each!(i => a[i] / b[i])
        }
        fn sqrt(self, a: Sixteen) -> Sixteen {
            each!(i => a[i].sqrt())
        }
        fn min(self, a: Sixteen, b: Sixteen) -> Sixteen {
            each!(i => if a[i] < b[i] { a[i] } else { b[i] })
        }
        fn max(self, a: Sixteen, b: Sixteen) -> Sixteen {
            each!(i => if a[i] > b[i] { a[i] } else { b[i] })
        }
        fn fma(self, a: Sixteen, b: Sixteen, c: Sixteen) -> Sixteen {
            each!(i => a[i].mul_add(b[i], c[i]))
        }
        fn fnma(self, a: Sixteen, b: Sixteen, c: Sixteen) -> Sixteen {
            each!(i => (-a[i]).mul_add(b[i], c[i]))
        }
        fn ge(self, a: Sixteen, b: Sixteen) -> u16 {
            mask!(i => a[i] >= b[i])
        }
        fn gt(self, a: Sixteen, b: Sixteen) -> u16 {
            mask!(i => a[i] > b[i])
        }
        fn select(self, mask: u16, yes: Sixteen, no: Sixteen) -> Sixteen {
            each!(i => if mask & (1 << i) == 0 { no[i] } else { yes[i] })
        }
        fn look_up(self, table: &Sixteen, at: Sixteen) -> Sixteen {
            each!(i => table[at[i] as usize % LANES])
        }
        fn round(self, a: Sixteen) -> Sixteen {
            each!(i => a[i].round_ties_even())
        }
        fn to_i32(self, a: Sixteen, to: &mut [i32; LANES]) {
            *to = each!(i => a[i].round_ties_even() as i32);
        }
        fn halved(self, a: Sixteen) -> Self::Half {
            let mut sums = [0.0; LANES / 2];
            for i in 0..LANES / 2 {
                sums[i] = a[i] + a[i + LANES / 2];
            }
            sums
        }
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
}

//! Sixteen lanes in two registers of AVX2, with fused multiply-add.

use std::arch::x86_64::*;

use super::{CACHE_LINE_SAMPLES, Kernel, LANES, Simd, Sixteen};

/// Proof that the processor has these instructions; created by [`Avx2::detect`].
#[derive(Clone, Copy)]
pub(super) struct Avx2(());

/// Lanes 0 to 7, lanes 8 to 15.
type Pair = [__m256; 2];

impl Avx2 {
    #[inline]
    pub(super) fn detect() -> Option<Avx2> {
        (is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma")).then_some(Avx2(()))
    }

    /// Runs the kernel in a function compiled for these instructions.
    pub(super) fn run<K: Kernel>(self, kernel: K) -> K::Output {
        #[target_feature(enable = "avx2,fma")]
        fn inner<K: Kernel>(simd: Avx2, kernel: K) -> K::Output {
            kernel.run(simd)
        }
        // SAFETY: `self` exists, so `detect` has found every feature that `inner` is compiled for.
        unsafe { inner(self, kernel) }
    }
}

/// Operations on registers only, by half.
macro_rules! register {
    ($($name:ident($($a:ident),*) = $intrinsic:ident;)*) => {$(
        #[inline(always)]
        fn $name(self, $($a: Pair),*) -> Pair {
            // SAFETY: `self` exists, so the processor has the instruction; it touches no memory.
            unsafe { [$intrinsic($($a[0]),*), $intrinsic($($a[1]),*)] }
        }
    )*};
}

/// Integer operations on registers, as bits.
macro_rules! bits {
    ($($name:ident($($a:ident),*) = $intrinsic:ident;)*) => {$(
        #[inline(always)]
        fn $name(self, $($a: Pair),*) -> Pair {
            // SAFETY: `self` exists, so the processor has the instruction; it touches no memory.
            unsafe {
                [
                    _mm256_castsi256_ps($intrinsic($(_mm256_castps_si256($a[0])),*)),
                    _mm256_castsi256_ps($intrinsic($(_mm256_castps_si256($a[1])),*)),
                ]
            }
        }
    )*};
}

/// Returns pointers to the two halves of an array.
#[inline(always)]
fn halves<T>(of: &[T; LANES]) -> [*const T; 2] {
    let (low, high) = of.split_at(LANES / 2);
    [low.as_ptr(), high.as_ptr()]
}

impl Avx2 {
    bits! {
        products(a, b) = _mm256_madd_epi16;
        add_i32(a, b) = _mm256_add_epi32;
    }

    /// One bit per lane with the sign bit set.
    #[inline(always)]
    fn mask(self, of: Pair) -> u16 {
        // SAFETY: `self` exists, so the processor has the instruction; it touches no memory.
        unsafe { (_mm256_movemask_ps(of[0]) | (_mm256_movemask_ps(of[1]) << 8)) as u16 }
    }

    /// Transposes eight rows into eight columns.
    #[inline(always)]
    fn transpose_eight(self, v: [__m256; 8]) -> [__m256; 8] {
        // SAFETY: `self` exists, so the processor has the instructions; they touch no memory.
        unsafe {
            let mut fours = v;
            for i in 0..2 {
                let rows = &v[4 * i..4 * i + 4];
                let ab = [_mm256_unpacklo_ps(rows[0], rows[1]), _mm256_unpackhi_ps(rows[0], rows[1])];
                let cd = [_mm256_unpacklo_ps(rows[2], rows[3]), _mm256_unpackhi_ps(rows[2], rows[3])];
                for k in 0..2 {
                    fours[4 * i + 2 * k] = _mm256_shuffle_ps::<0x44>(ab[k], cd[k]);
                    fours[4 * i + 2 * k + 1] = _mm256_shuffle_ps::<0xee>(ab[k], cd[k]);
                }
            }
            let mut out = fours;
            for k in 0..4 {
                out[k] = _mm256_permute2f128_ps::<0x20>(fours[k], fours[4 + k]);
                out[k + 4] = _mm256_permute2f128_ps::<0x31>(fours[k], fours[4 + k]);
            }
            out
        }
    }

    /// Lane `i` is the sum of `v[i]`'s lanes, 4 apart first, then 2, 1.
    #[inline(always)]
    fn sum_eight(self, v: &mut [__m256; 8]) -> __m256 {
        // SAFETY: `self` exists, so the processor has the instructions; they touch no memory.
        unsafe {
            for i in 0..4 {
                let (a, b) = (v[i], v[i + 4]);
                v[i] = _mm256_add_ps(_mm256_blend_ps::<0xf0>(a, b), _mm256_permute2f128_ps::<0x21>(a, b));
            }
            for i in 0..2 {
                let (a, b) = (v[i], v[i + 2]);
                v[i] = _mm256_add_ps(_mm256_blend_ps::<0xcc>(a, b), _mm256_shuffle_ps::<0x4e>(a, b));
            }
            let (a, b) = (v[0], v[1]);
            let crossed = _mm256_permute_ps::<0xb1>(_mm256_blend_ps::<0xaa>(b, a));
            _mm256_add_ps(_mm256_blend_ps::<0xaa>(a, b), crossed)
        }
    }
}

impl Simd for Avx2 {
    type V = Pair;
    type Half = __m256;

    register! {
        add(a, b) = _mm256_add_ps;
        sub(a, b) = _mm256_sub_ps;
        mul(a, b) = _mm256_mul_ps;
        div(a, b) = _mm256_div_ps;
        sqrt(a) = _mm256_sqrt_ps;
        min(a, b) = _mm256_min_ps;
        max(a, b) = _mm256_max_ps;
        fma(a, b, c) = _mm256_fmadd_ps;
        fnma(a, b, c) = _mm256_fnmadd_ps;
    }
    bits! {
        min_pairs(a, b) = _mm256_min_epu16;
        max_pairs(a, b) = _mm256_max_epu16;
    }

    #[inline(always)]
    fn splat(self, value: f32) -> Pair {
        // SAFETY: `self` exists, so the processor has the instruction; it touches no memory.
        unsafe { [_mm256_set1_ps(value); 2] }
    }
    #[inline(always)]
    fn load(self, from: &Sixteen) -> Pair {
        let [low, high] = halves(from);
        // SAFETY: as above; each half covers the eight values that are read, at any alignment.
        unsafe { [_mm256_loadu_ps(low), _mm256_loadu_ps(high)] }
    }
    #[inline(always)]
    fn store(self, value: Pair, to: &mut Sixteen) {
        let (low, high) = to.split_at_mut(LANES / 2);
        // SAFETY: as above; each half covers the eight values that are written, at any alignment.
        unsafe {
            _mm256_storeu_ps(low.as_mut_ptr(), value[0]);
            _mm256_storeu_ps(high.as_mut_ptr(), value[1]);
        }
    }
    #[inline(always)]
    fn transpose(self, of: &mut [Pair; LANES]) {
        let mut parts = [[of[0][0]; 8]; 4];
        for i in 0..8 {
            parts[0][i] = of[i][0];
            parts[1][i] = of[i][1];
            parts[2][i] = of[i + 8][0];
            parts[3][i] = of[i + 8][1];
        }
        let (low_left, low_right) = (self.transpose_eight(parts[0]), self.transpose_eight(parts[1]));
        let (high_left, high_right) = (self.transpose_eight(parts[2]), self.transpose_eight(parts[3]));
        for i in 0..8 {
            of[i] = [low_left[i], high_left[i]];
            of[i + 8] = [low_right[i], high_right[i]];
        }
    }
    #[inline(always)]
    fn lane_bits(self, masks: &[u16; 64], lane: usize) -> u64 {
        let mut bits = 0;
        for (part, masks) in masks.as_chunks::<32>().0.iter().enumerate() {
            let (low, high) = masks.split_at(16);
            // SAFETY: `self` exists, so the processor has the instructions; each half covers the 32
            // bytes that are read, at any alignment.
            unsafe {
                let bit = _mm256_set1_epi16(1i16 << (lane & 15));
                let low = _mm256_and_si256(_mm256_loadu_si256(low.as_ptr().cast()), bit);
                let high = _mm256_and_si256(_mm256_loadu_si256(high.as_ptr().cast()), bit);
                let (low, high) = (_mm256_cmpeq_epi16(low, bit), _mm256_cmpeq_epi16(high, bit));
                // Packing works by quarters: the middle two must be swapped.
                let packed = _mm256_permute4x64_epi64::<0xd8>(_mm256_packs_epi16(low, high));
                bits |= u64::from(_mm256_movemask_epi8(packed) as u32) << (32 * part);
            }
        }
        bits
    }
    #[inline(always)]
    fn fetch(self, soon: &[u16]) {
        for line in [soon.first(), soon.get(CACHE_LINE_SAMPLES)].into_iter().flatten() {
            // SAFETY: every such processor has the instruction; it reads nothing, and faults at no
            // address.
            unsafe { _mm_prefetch::<_MM_HINT_T0>(std::ptr::from_ref(line).cast()) }
        }
    }
    #[inline(always)]
    fn pairs(self, from: &[u16; 2 * LANES]) -> Pair {
        let (low, high) = from.split_at(LANES);
        // SAFETY: as above; each half covers the 32 bytes that are read, at any alignment.
        unsafe { [low, high].map(|half| _mm256_castsi256_ps(_mm256_loadu_si256(half.as_ptr().cast()))) }
    }
    #[inline(always)]
    fn splat_pair(self, [first, second]: [u16; 2]) -> Pair {
        let pair = u32::from(first) | u32::from(second) << 16;
        // SAFETY: `self` exists, so the processor has the instruction; it touches no memory.
        unsafe { [_mm256_castsi256_ps(_mm256_set1_epi32(pair.cast_signed())); 2] }
    }
    #[inline(always)]
    fn dot(self, a: Pair, b: Pair, sum: Pair) -> Pair {
        self.add_i32(sum, self.products(a, b))
    }
    #[inline(always)]
    fn float(self, bits: Pair) -> Pair {
        // SAFETY: `self` exists, so the processor has the instruction; it touches no memory.
        unsafe {
            [
                _mm256_cvtepi32_ps(_mm256_castps_si256(bits[0])),
                _mm256_cvtepi32_ps(_mm256_castps_si256(bits[1])),
            ]
        }
    }
    #[inline(always)]
    fn first(self, pairs: Pair) -> Pair {
        // SAFETY: `self` exists, so the processor has the instructions; they touch no memory.
        unsafe {
            let part = _mm256_set1_epi32(0xffff);
            let [a, b] = [_mm256_castps_si256(pairs[0]), _mm256_castps_si256(pairs[1])];
            [_mm256_cvtepi32_ps(_mm256_and_si256(a, part)), _mm256_cvtepi32_ps(_mm256_and_si256(b, part))]
        }
    }
    #[inline(always)]
    fn second(self, pairs: Pair) -> Pair {
        // SAFETY: `self` exists, so the processor has the instructions; they touch no memory.
        unsafe {
            let [a, b] = [_mm256_castps_si256(pairs[0]), _mm256_castps_si256(pairs[1])];
            [_mm256_cvtepi32_ps(_mm256_srli_epi32::<16>(a)), _mm256_cvtepi32_ps(_mm256_srli_epi32::<16>(b))]
        }
    }
    #[inline(always)]
    fn ge(self, a: Pair, b: Pair) -> u16 {
        // SAFETY: `self` exists, so the processor has the instruction; it touches no memory.
        self.mask(unsafe {
            [_mm256_cmp_ps::<_CMP_GE_OQ>(a[0], b[0]), _mm256_cmp_ps::<_CMP_GE_OQ>(a[1], b[1])]
        })
    }
    #[inline(always)]
    fn gt(self, a: Pair, b: Pair) -> u16 {
        // SAFETY: `self` exists, so the processor has the instruction; it touches no memory.
        self.mask(unsafe {
            [_mm256_cmp_ps::<_CMP_GT_OQ>(a[0], b[0]), _mm256_cmp_ps::<_CMP_GT_OQ>(a[1], b[1])]
        })
    }
    #[inline(always)]
    fn select(self, mask: u16, yes: Pair, no: Pair) -> Pair {
        // SAFETY: `self` exists, so the processor has the instructions; they touch no memory.
        unsafe {
            let bit = _mm256_setr_epi32(1, 2, 4, 8, 16, 32, 64, 128);
            let mut out = no;
            for (half, out) in out.iter_mut().enumerate() {
                let set = _mm256_and_si256(_mm256_set1_epi32(i32::from(mask >> (8 * half))), bit);
                let lanes = _mm256_castsi256_ps(_mm256_cmpeq_epi32(set, bit));
                *out = _mm256_blendv_ps(*out, yes[half], lanes);
            }
            out
        }
    }
    #[inline(always)]
    fn look_up(self, table: &Sixteen, at: Pair) -> Pair {
        let [low, high] = self.load(table);
        // SAFETY: `self` exists, so the processor has the instructions; they touch no memory.
        unsafe {
            let mut out = at;
            for out in &mut out {
                let index = _mm256_cvtps_epi32(*out);
                // The permutation uses the last three bits of an index; the fourth, as sign,
                // selects the half.
                let is_high = _mm256_castsi256_ps(_mm256_slli_epi32::<28>(index));
                let of_low = _mm256_permutevar8x32_ps(low, index);
                *out = _mm256_blendv_ps(of_low, _mm256_permutevar8x32_ps(high, index), is_high);
            }
            out
        }
    }
    #[inline(always)]
    fn round(self, a: Pair) -> Pair {
        const NEAREST: i32 = _MM_FROUND_TO_NEAREST_INT | _MM_FROUND_NO_EXC;
        // SAFETY: `self` exists, so the processor has the instruction; it touches no memory.
        unsafe { [_mm256_round_ps::<NEAREST>(a[0]), _mm256_round_ps::<NEAREST>(a[1])] }
    }
    #[inline(always)]
    fn to_i32(self, a: Pair, to: &mut [i32; LANES]) {
        let (low, high) = to.split_at_mut(LANES / 2);
        // SAFETY: `self` exists, so the processor has the instructions; each half covers the eight
        // values that are written, at any alignment.
        unsafe {
            _mm256_storeu_si256(low.as_mut_ptr().cast(), _mm256_cvtps_epi32(a[0]));
            _mm256_storeu_si256(high.as_mut_ptr().cast(), _mm256_cvtps_epi32(a[1]));
        }
    }
    #[inline(always)]
    fn halved(self, a: Pair) -> __m256 {
        // SAFETY: `self` exists, so the processor has the instruction; it touches no memory.
        unsafe { _mm256_add_ps(a[0], a[1]) }
    }
    #[inline(always)]
    fn sum_each(self, of: &[__m256; LANES]) -> Pair {
        let (mut low, mut high) = ([of[0]; 8], [of[8]; 8]);
        low.copy_from_slice(&of[..8]);
        high.copy_from_slice(&of[8..]);
        [self.sum_eight(&mut low), self.sum_eight(&mut high)]
    }
}

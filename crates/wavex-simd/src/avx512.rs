//! Sixteen lanes in one register of AVX-512.

use std::arch::x86_64::*;

use super::{CACHE_LINE_SAMPLES, Kernel, LANES, Simd, Sixteen};

/// Proof that the processor has these instructions; created by [`Avx512::detect`].
#[derive(Clone, Copy)]
pub(super) struct Avx512(());

impl Avx512 {
    #[inline]
    pub(super) fn detect() -> Option<Avx512> {
        let found = is_x86_feature_detected!("avx512f")
            && is_x86_feature_detected!("avx512bw")
            && is_x86_feature_detected!("avx512dq")
            && is_x86_feature_detected!("avx512vl")
            && is_x86_feature_detected!("avx2")
            && is_x86_feature_detected!("fma");
        found.then_some(Avx512(()))
    }

    /// Runs the kernel in a function compiled for these instructions.
    pub(super) fn run<K: Kernel>(self, kernel: K) -> K::Output {
        #[target_feature(enable = "avx512f,avx512bw,avx512dq,avx512vl,avx2,fma")]
        fn inner<K: Kernel>(simd: Avx512, kernel: K) -> K::Output {
            kernel.run(simd)
        }
        // SAFETY: `self` exists, so `detect` has found every feature that `inner` is compiled for.
        unsafe { inner(self, kernel) }
    }
}

/// Operations on registers only.
macro_rules! register {
    ($($name:ident($($a:ident),*) = $intrinsic:ident;)*) => {$(
        #[inline(always)]
        fn $name(self, $($a: __m512),*) -> __m512 {
            // SAFETY: `self` exists, so the processor has the instruction; it touches no memory.
            unsafe { $intrinsic($($a),*) }
        }
    )*};
}

/// Integer operations on registers, as bits.
macro_rules! bits {
    ($($name:ident($($a:ident),*) = $intrinsic:ident;)*) => {$(
        #[inline(always)]
        fn $name(self, $($a: __m512),*) -> __m512 {
            // SAFETY: `self` exists, so the processor has the instruction; it touches no memory.
            unsafe { _mm512_castsi512_ps($intrinsic($(_mm512_castps_si512($a)),*)) }
        }
    )*};
}

/// Permutation that swaps lanes 4 apart: downwards from `a`, upwards from `b`.
const SWAP_4: [i32; 16] = [4, 5, 6, 7, 16, 17, 18, 19, 12, 13, 14, 15, 24, 25, 26, 27];
/// Permutation that swaps neighbouring lanes.
const SWAP_1: [i32; 16] = [1, 16, 3, 18, 5, 20, 7, 22, 9, 24, 11, 26, 13, 28, 15, 30];

impl Avx512 {
    bits! {
        products(a, b) = _mm512_madd_epi16;
        add_i32(a, b) = _mm512_add_epi32;
    }
}

impl Simd for Avx512 {
    type V = __m512;
    type Half = __m256;

    register! {
        add(a, b) = _mm512_add_ps;
        sub(a, b) = _mm512_sub_ps;
        mul(a, b) = _mm512_mul_ps;
        div(a, b) = _mm512_div_ps;
        sqrt(a) = _mm512_sqrt_ps;
        min(a, b) = _mm512_min_ps;
        max(a, b) = _mm512_max_ps;
        fma(a, b, c) = _mm512_fmadd_ps;
        fnma(a, b, c) = _mm512_fnmadd_ps;
    }
    bits! {
        min_pairs(a, b) = _mm512_min_epu16;
        max_pairs(a, b) = _mm512_max_epu16;
    }

    #[inline(always)]
    fn splat(self, value: f32) -> __m512 {
        // SAFETY: `self` exists, so the processor has the instruction; it touches no memory.
        unsafe { _mm512_set1_ps(value) }
    }
    #[inline(always)]
    fn load(self, from: &Sixteen) -> __m512 {
        // SAFETY: as above; the reference covers the sixteen values that are read, at any
        // alignment.
        unsafe { _mm512_loadu_ps(from.as_ptr()) }
    }
    #[inline(always)]
    fn store(self, value: __m512, to: &mut Sixteen) {
        // SAFETY: as above; the reference covers the sixteen values that are written, at any
        // alignment.
        unsafe { _mm512_storeu_ps(to.as_mut_ptr(), value) }
    }
    #[inline(always)]
    fn transpose(self, of: &mut [__m512; LANES]) {
        // SAFETY: `self` exists, so the processor has the instructions; they touch no memory.
        unsafe {
            let v = *of;
            let mut pairs = v;
            for i in 0..8 {
                pairs[2 * i] = _mm512_unpacklo_ps(v[2 * i], v[2 * i + 1]);
                pairs[2 * i + 1] = _mm512_unpackhi_ps(v[2 * i], v[2 * i + 1]);
            }
            // Columns k, k + 4, k + 8 and k + 12 of four rows, in the quarters of vector 4 i + k.
            let mut fours = pairs;
            for i in 0..4 {
                for k in 0..2 {
                    let (a, b) = (_mm512_castps_pd(pairs[4 * i + k]), _mm512_castps_pd(pairs[4 * i + k + 2]));
                    fours[4 * i + 2 * k] = _mm512_castpd_ps(_mm512_unpacklo_pd(a, b));
                    fours[4 * i + 2 * k + 1] = _mm512_castpd_ps(_mm512_unpackhi_pd(a, b));
                }
            }
            for k in 0..4 {
                let (a, b, c, d) = (fours[k], fours[4 + k], fours[8 + k], fours[12 + k]);
                let (ab_even, ab_odd) =
                    (_mm512_shuffle_f32x4::<0x88>(a, b), _mm512_shuffle_f32x4::<0xdd>(a, b));
                let (cd_even, cd_odd) =
                    (_mm512_shuffle_f32x4::<0x88>(c, d), _mm512_shuffle_f32x4::<0xdd>(c, d));
                of[k] = _mm512_shuffle_f32x4::<0x88>(ab_even, cd_even);
                of[k + 4] = _mm512_shuffle_f32x4::<0x88>(ab_odd, cd_odd);
                of[k + 8] = _mm512_shuffle_f32x4::<0xdd>(ab_even, cd_even);
                of[k + 12] = _mm512_shuffle_f32x4::<0xdd>(ab_odd, cd_odd);
            }
        }
    }
    #[inline(always)]
    fn lane_bits(self, masks: &[u16; 64], lane: usize) -> u64 {
        let (low, high) = masks.split_at(32);
        // SAFETY: as above; each half covers the 64 bytes that are read, at any alignment.
        unsafe {
            let bit = _mm512_set1_epi16(1i16 << (lane & 15));
            let low = _mm512_test_epi16_mask(_mm512_loadu_si512(low.as_ptr().cast()), bit);
            let high = _mm512_test_epi16_mask(_mm512_loadu_si512(high.as_ptr().cast()), bit);
            u64::from(low) | u64::from(high) << 32
        }
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
    fn pairs(self, from: &[u16; 2 * LANES]) -> __m512 {
        // SAFETY: as above; the reference covers the 64 bytes that are read, at any alignment.
        unsafe { _mm512_castsi512_ps(_mm512_loadu_si512(from.as_ptr().cast())) }
    }
    #[inline(always)]
    fn some_pairs(self, from: &[u16]) -> __m512 {
        let count = from.len().min(2 * LANES) as u32;
        let mask = 1u64.checked_shl(count).unwrap_or(0).wrapping_sub(1) as u32;
        // SAFETY: as above; the mask leaves what the slice covers, and nothing else is read.
        unsafe { _mm512_castsi512_ps(_mm512_maskz_loadu_epi16(mask, from.as_ptr().cast())) }
    }
    #[inline(always)]
    fn splat_pair(self, [first, second]: [u16; 2]) -> __m512 {
        let pair = u32::from(first) | u32::from(second) << 16;
        // SAFETY: `self` exists, so the processor has the instruction; it touches no memory.
        unsafe { _mm512_castsi512_ps(_mm512_set1_epi32(pair.cast_signed())) }
    }
    #[inline(always)]
    fn dot(self, a: __m512, b: __m512, sum: __m512) -> __m512 {
        self.add_i32(sum, self.products(a, b))
    }
    #[inline(always)]
    fn float(self, bits: __m512) -> __m512 {
        // SAFETY: `self` exists, so the processor has the instruction; it touches no memory.
        unsafe { _mm512_cvtepi32_ps(_mm512_castps_si512(bits)) }
    }
    #[inline(always)]
    fn first(self, pairs: __m512) -> __m512 {
        // SAFETY: `self` exists, so the processor has the instructions; they touch no memory.
        unsafe {
            let low = _mm512_and_si512(_mm512_castps_si512(pairs), _mm512_set1_epi32(0xffff));
            _mm512_cvtepi32_ps(low)
        }
    }
    #[inline(always)]
    fn second(self, pairs: __m512) -> __m512 {
        // SAFETY: `self` exists, so the processor has the instructions; they touch no memory.
        unsafe { _mm512_cvtepi32_ps(_mm512_srli_epi32::<16>(_mm512_castps_si512(pairs))) }
    }
    #[inline(always)]
    fn ge(self, a: __m512, b: __m512) -> u16 {
        // SAFETY: `self` exists, so the processor has the instruction; it touches no memory.
        unsafe { _mm512_cmp_ps_mask::<_CMP_GE_OQ>(a, b) }
    }
    #[inline(always)]
    fn gt(self, a: __m512, b: __m512) -> u16 {
        // SAFETY: `self` exists, so the processor has the instruction; it touches no memory.
        unsafe { _mm512_cmp_ps_mask::<_CMP_GT_OQ>(a, b) }
    }
    #[inline(always)]
    fn select(self, mask: u16, yes: __m512, no: __m512) -> __m512 {
        // SAFETY: `self` exists, so the processor has the instruction; it touches no memory.
        unsafe { _mm512_mask_blend_ps(mask, no, yes) }
    }
    #[inline(always)]
    fn look_up(self, table: &Sixteen, at: __m512) -> __m512 {
        // SAFETY: `self` exists, so the processor has the instructions; they touch no memory.
        unsafe { _mm512_permutexvar_ps(_mm512_cvtps_epi32(at), self.load(table)) }
    }
    #[inline(always)]
    fn round(self, a: __m512) -> __m512 {
        // SAFETY: `self` exists, so the processor has the instruction; it touches no memory.
        unsafe { _mm512_roundscale_ps::<{ _MM_FROUND_TO_NEAREST_INT | _MM_FROUND_NO_EXC }>(a) }
    }
    #[inline(always)]
    fn to_i32(self, a: __m512, to: &mut [i32; LANES]) {
        // SAFETY: `self` exists, so the processor has the instructions; the reference covers the
        // sixteen values that are written, at any alignment.
        unsafe { _mm512_storeu_si512(to.as_mut_ptr().cast(), _mm512_cvtps_epi32(a)) }
    }
    #[inline(always)]
    fn halved(self, a: __m512) -> __m256 {
        // SAFETY: `self` exists, so the processor has the instructions; they touch no memory.
        unsafe { _mm256_add_ps(_mm512_castps512_ps256(a), _mm512_extractf32x8_ps::<1>(a)) }
    }
    #[inline(always)]
    fn sum_each(self, of: &[__m256; LANES]) -> __m512 {
        // SAFETY: `self` exists, so the processor has the instructions; the constants cover the 64
        // bytes that are read.
        unsafe {
            let swap_4 = _mm512_loadu_si512(SWAP_4.as_ptr().cast());
            let swap_1 = _mm512_loadu_si512(SWAP_1.as_ptr().cast());
            let mut v = [_mm512_setzero_ps(); 8];
            for i in 0..8 {
                v[i] = _mm512_insertf32x8::<1>(_mm512_castps256_ps512(of[i]), of[i + 8]);
            }
            for i in 0..4 {
                let (a, b) = (v[i], v[i + 4]);
                let crossed = _mm512_permutex2var_ps(a, swap_4, b);
                v[i] = _mm512_add_ps(_mm512_mask_blend_ps(0xf0f0, a, b), crossed);
            }
            for i in 0..2 {
                let (a, b) = (v[i], v[i + 2]);
                v[i] = _mm512_add_ps(_mm512_mask_blend_ps(0xcccc, a, b), _mm512_shuffle_ps::<0x4e>(a, b));
            }
            let (a, b) = (v[0], v[1]);
            _mm512_add_ps(_mm512_mask_blend_ps(0xaaaa, a, b), _mm512_permutex2var_ps(a, swap_1, b))
        }
    }
}

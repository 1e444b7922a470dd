//! Rounding without a function call.

/// Rounds to the nearest integer, halves away from zero, like [`f64::round`].
///
/// NaN becomes 0; values beyond the type's range are clamped. On baseline x86-64 `round` is a
/// function call, and a point needs fifteen of them. The addend is the largest number below 0.5, so
/// values just below a half are not rounded up.
#[inline]
pub fn nearest(value: f64) -> i64 {
    const BELOW_HALF: f64 = 0.5 - f64::EPSILON / 4.0;
    (value + BELOW_HALF.copysign(value)) as i64
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn halves_go_away_from_zero() {
        let below_half = 0.499_999_999_999_999_94;
        for value in
            [0.0, below_half, 0.5, 1.5, 2.5, 2.4999999999999996, 1e9 + 0.5, 2f64.powi(52) + 1.0, 1e300]
        {
            assert_eq!(nearest(value), value.round() as i64, "{value}");
            assert_eq!(nearest(-value), (-value).round() as i64, "-{value}");
        }
        assert_eq!([f64::NAN, f64::INFINITY, f64::NEG_INFINITY].map(nearest), [0, i64::MAX, i64::MIN]);
    }

    proptest! {
        #[test]
        fn it_is_round(value in -1e12..1e12f64, half in -1_000_000_000i64..1_000_000_000) {
            prop_assert_eq!(nearest(value), value.round() as i64);
            let half = half as f64 + 0.5;
            prop_assert_eq!(nearest(half), half.round() as i64);
        }
    }
}

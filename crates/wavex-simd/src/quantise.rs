//! Quantises columns of values and converts decibels to ratios, bit-identical on every processor.

use crate::{Kernel, Simd, SimdLevel};

/// Quantisation of values.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Steps {
    /// Value of a stored 0.
    pub offset: f64,
    /// Value of one step.
    pub scale: f64,
    /// Smallest stored number.
    pub least: i32,
    /// Largest stored number.
    pub largest: i32,
    /// Stored number for NaN.
    pub nan: i32,
}

impl Steps {
    /// Rounds each value to the nearest step, halves away from zero, and clamps it to the range.
    ///
    /// Processes as many values as the shorter slice has.
    pub fn count(&self, values: &[f64], numbers: &mut [i32]) {
        SimdLevel::best().processor().run(Count { steps: *self, values, numbers });
    }
}

struct Count<'a> {
    steps: Steps,
    values: &'a [f64],
    numbers: &'a mut [i32],
}

/// Adding this to a small number rounds it to an integer.
///
/// Halves go to even; the integer is in the lowest bits.
pub const ROUNDING: f64 = 1.5 / f64::EPSILON;

impl Kernel for Count<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, _: S) {
        let Count { steps, values, numbers } = self;
        let (least, largest, nan) = (f64::from(steps.least), f64::from(steps.largest), f64::from(steps.nan));
        let n = values.len().min(numbers.len());
        let (values, numbers) = (&values[..n], &mut numbers[..n]);
        for i in 0..n {
            let exact = (values[i] - steps.offset) / steps.scale;
            // Comparisons instead of `clamp`, because they vectorise.
            let exact = if exact < least { least } else { exact };
            let exact = if exact > largest { largest } else { exact };
            let exact = if exact.is_nan() { nan } else { exact };
            let even = (exact + ROUNDING) - ROUNDING;
            let half = 0.5f64.copysign(exact);
            let away = if exact - even == half { even + (half + half) } else { even };
            numbers[i] = (away + ROUNDING).to_bits() as u32 as i32;
        }
    }
}

/// Converts dB to ratios, `10^(dB / 10)`, with a relative error below 1e-12.
///
/// Processes as many values as the shorter slice has. Values beyond ±3000 dB are clamped; NaN stays
/// NaN.
pub fn power_ratios(decibels: &[f64], ratios: &mut [f64]) {
    SimdLevel::best().processor().run(PowerRatios { decibels, ratios });
}

struct PowerRatios<'a> {
    decibels: &'a [f64],
    ratios: &'a mut [f64],
}

/// Decibels beyond which a ratio is not a normal double.
const MOST_DECIBELS: f64 = 3000.0;
const TERMS: usize = 11;

/// `ln(2)^k / k!`: the series of `2^x`, with a truncation error below 3e-13 for |x| <= 1/2.
const POWERS_OF_TWO: [f64; TERMS] = {
    let mut terms = [1.0; TERMS];
    let mut k = 1;
    while k < TERMS {
        terms[k] = terms[k - 1] * std::f64::consts::LN_2 / k as f64;
        k += 1;
    }
    terms
};

impl Kernel for PowerRatios<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, _: S) {
        let n = self.decibels.len().min(self.ratios.len());
        let (decibels, ratios) = (&self.decibels[..n], &mut self.ratios[..n]);
        for i in 0..n {
            let bounded = if decibels[i] < -MOST_DECIBELS { -MOST_DECIBELS } else { decibels[i] };
            let bounded = if bounded > MOST_DECIBELS { MOST_DECIBELS } else { bounded };
            let exponent = bounded * (std::f64::consts::LOG2_10 / 10.0);
            let rounded = exponent + ROUNDING;
            let rest = exponent - (rounded - ROUNDING);
            let mut power = POWERS_OF_TWO[TERMS - 1];
            for k in (0..TERMS - 1).rev() {
                power = power * rest + POWERS_OF_TWO[k];
            }
            // The integer part is shifted to the exponent bits of a double; NaN is handled
            // separately.
            let ratio = f64::from_bits(power.to_bits().wrapping_add(rounded.to_bits() << 52));
            ratios[i] = if decibels[i].is_nan() { f64::NAN } else { ratio };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn expected(steps: &Steps, value: f64) -> i32 {
        let exact = (value - steps.offset) / steps.scale;
        let number = exact.round().clamp(f64::from(steps.least), f64::from(steps.largest));
        if exact.is_nan() { steps.nan } else { number as i32 }
    }

    /// Checks all levels available on this processor.
    fn counted(steps: &Steps, values: &[f64]) -> Vec<i32> {
        let mut numbers = vec![7; values.len()];
        steps.count(values, &mut numbers);
        for level in SimdLevel::ALL {
            let mut again = vec![7; values.len()];
            level.processor().run(Count { steps: *steps, values, numbers: &mut again });
            assert_eq!(again, numbers, "{level:?}");
        }
        numbers
    }

    const BYTE: Steps = Steps { offset: 0.5, scale: 0.025, least: 0, largest: 255, nan: 3 };
    const WIDE: Steps = Steps { offset: 0.0, scale: 1.0, least: i32::MIN, largest: i32::MAX, nan: i32::MIN };

    #[test]
    fn ends_halves_and_what_is_no_number() {
        let below_half = 0.499_999_999_999_999_94;
        let values = [0.5, 1.5, 2.5, -0.5, -1.5, -2.5, below_half, -below_half, 0.0, -0.0];
        assert_eq!(counted(&WIDE, &values), [1, 2, 3, -1, -2, -3, 0, 0, 0, 0]);
        let values = [2147483646.5, 2147483647.4, 1e300, f64::INFINITY, -2147483648.4, -1e300, f64::NAN];
        let (least, largest) = (i32::MIN, i32::MAX);
        assert_eq!(counted(&WIDE, &values), [largest, largest, largest, largest, least, least, least]);
        let values = [0.4, 0.5, 1.0, 100.0, f64::NAN, f64::NEG_INFINITY];
        assert_eq!(counted(&BYTE, &values), [0, 0, 20, 255, 3, 0]);
    }

    #[test]
    fn as_far_as_both_reach() {
        let mut numbers = [9; 3];
        WIDE.count(&[1.0, 2.0], &mut numbers);
        WIDE.count(&[5.0; 40], &mut numbers[..1]);
        assert_eq!(numbers, [5, 2, 9]);
        let mut ratios = [9.0; 2];
        power_ratios(&[0.0], &mut ratios);
        assert_eq!(ratios, [1.0, 9.0]);
    }

    fn ratio(decibels: f64) -> f64 {
        let mut ratios = [0.0; 1];
        power_ratios(&[decibels], &mut ratios);
        ratios[0]
    }

    #[test]
    fn ratios_at_the_ends() {
        assert!(ratio(f64::NAN).is_nan());
        assert_eq!([ratio(f64::INFINITY), ratio(f64::NEG_INFINITY)], [ratio(3000.0), ratio(-3000.0)]);
        assert!((ratio(3000.0) / 1e300 - 1.0).abs() < 1e-12 && (ratio(-3000.0) / 1e-300 - 1.0).abs() < 1e-12);
    }

    proptest! {
        #[test]
        fn numbers_are_those_of_round(
            values in prop::collection::vec(prop_oneof![-1e3..1e3f64, -1e10..1e10f64, any::<f64>()], 0..40),
            halves in prop::collection::vec(-100_000i32..100_000, 0..40),
            scale in prop_oneof![Just(1.0), 1e-3..10.0f64],
        ) {
            let steps = Steps { scale, ..WIDE };
            prop_assert_eq!(counted(&steps, &values), values.iter().map(|value| expected(&steps, *value)).collect::<Vec<_>>());
            let byte: Vec<i32> = values.iter().map(|value| expected(&BYTE, *value)).collect();
            prop_assert_eq!(counted(&BYTE, &values), byte);
            let halves: Vec<f64> = halves.into_iter().map(|half| f64::from(half) + 0.5).collect();
            prop_assert_eq!(counted(&WIDE, &halves), halves.iter().map(|value| expected(&WIDE, *value)).collect::<Vec<_>>());
        }

        #[test]
        fn ratios_are_powers_of_ten(decibels in prop::collection::vec(prop_oneof![-60.0..60.0f64, -3000.0..3000.0f64], 1..40)) {
            let mut ratios = vec![0.0; decibels.len()];
            power_ratios(&decibels, &mut ratios);
            for level in SimdLevel::ALL {
                let mut again = vec![0.0; decibels.len()];
                level.processor().run(PowerRatios { decibels: &decibels, ratios: &mut again });
                prop_assert_eq!(&again, &ratios);
            }
            for (ratio, decibels) in ratios.iter().zip(&decibels) {
                let expected = 10f64.powf(decibels / 10.0);
                prop_assert!((ratio / expected - 1.0).abs() < 1e-12, "{decibels} dB: {ratio} instead of {expected}");
            }
        }
    }
}

//! Lossless text for numbers that are multiples of a step.

use std::fmt::Write;

/// Steps from an offset, with the number of decimals they need.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct DecimalSteps {
    step: f64,
    offset: f64,
    /// `None` if no number of decimals is exact; the shortest text that reads back exactly is then
    /// used.
    decimals: Option<usize>,
}

/// Largest number of decimals expected in user input.
const MOST_DECIMALS: usize = 12;

impl DecimalSteps {
    /// Steps of `step` (above 0) from `offset`.
    pub(super) fn new(step: f64, offset: f64) -> DecimalSteps {
        let decimals = decimals_of(step).zip(decimals_of(offset)).map(|(a, b)| a.max(b));
        DecimalSteps { step, offset, decimals }
    }

    /// Number of steps from the offset to a value.
    pub(super) fn count(&self, value: f64) -> f64 {
        ((value - self.offset) / self.step).round()
    }

    /// Appends the value at a number of steps.
    pub(super) fn write(&self, count: f64, text: &mut String) {
        // Adding 0 turns -0 into 0.
        let value = count * self.step + self.offset + 0.0;
        // Writing into a string cannot fail.
        let _ = match self.decimals {
            _ if value.is_nan() => write!(text, "nan"),
            Some(decimals) => write!(text, "{value:.decimals$}"),
            None => write!(text, "{value}"),
        };
    }
}

/// Number of decimals of a value; `None` if not finite.
fn decimals_of(value: f64) -> Option<usize> {
    (0..=MOST_DECIMALS).find(|&decimals| {
        let scaled = value * 10f64.powi(decimals as i32);
        let whole = scaled.round();
        value == 0.0 || (whole != 0.0 && (scaled - whole).abs() <= 4.0 * f64::EPSILON * scaled.abs())
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn text(steps: DecimalSteps, value: f64) -> String {
        let mut text = String::new();
        steps.write(steps.count(value), &mut text);
        text
    }

    #[test]
    fn decimals_are_those_of_step_and_offset() {
        let decimals = |step, offset| DecimalSteps::new(step, offset).decimals;
        assert_eq!(decimals(0.001, 540_000.0), Some(3));
        assert_eq!(decimals(1e-8, 11.0), Some(8));
        assert_eq!(decimals(0.25, 0.125), Some(3));
        assert_eq!(decimals(1.0, 0.0), Some(0));
        assert_eq!(decimals(1.0 / 3.0, 0.0), None);
    }

    #[test]
    fn values_are_rounded_to_the_nearest_step() {
        assert_eq!(text(DecimalSteps::new(0.001, 500_000.0), 512_345.678_4), "512345.678");
        assert_eq!(text(DecimalSteps::new(0.025, 0.5), 1.26), "1.250");
        assert_eq!(text(DecimalSteps::new(0.001, 0.0), -0.000_1), "0.000");
        assert_eq!(text(DecimalSteps::new(1.0 / 3.0, 0.0), 1.7), "1.6666666666666665");
        assert_eq!(text(DecimalSteps::new(0.001, 0.0), f64::NAN), "nan");
    }

    proptest! {
        /// A value read back is on the same step.
        #[test]
        fn no_step_is_lost(
            count in any::<i32>(),
            step in prop::sample::select(vec![1e-8, 0.001, 0.0005, 0.006, 0.01, 0.25, 1.0 / 3.0, 0.000_304_8]),
            offset in prop::sample::select(vec![0.0, -117.0, 540_000.0, 5_200_000.5, 0.1]),
        ) {
            let steps = DecimalSteps::new(step, offset);
            let mut text = String::new();
            steps.write(f64::from(count), &mut text);
            prop_assert_eq!(steps.count(text.parse().unwrap()), f64::from(count), "{}", text);
        }
    }
}

//! Linear scale of an axis, and the extent of values.

/// Linear scale: value `from[0]` maps to `to[0]`.
#[derive(Clone, Copy)]
pub struct AxisScale {
    /// Two values.
    pub from: [f64; 2],
    /// Their positions.
    pub to: [f64; 2],
}

impl AxisScale {
    /// Position of a value.
    pub fn at(&self, value: f64) -> f64 {
        let [a, b] = self.from;
        let span = if b - a == 0.0 { 1.0 } else { b - a };
        self.to[0] + (value - a) / span * (self.to[1] - self.to[0])
    }

    /// Round tick values within the scale, about `wanted`, and their decimal places.
    pub fn ticks(&self, wanted: f64) -> (Vec<f64>, usize) {
        let span = (self.from[1] - self.from[0]).abs().max(1e-9);
        let raw = span / wanted.max(1.0);
        let unit = 10f64.powf(raw.log10().floor());
        let step =
            [1.0, 2.0, 5.0, 10.0].into_iter().map(|m| m * unit).find(|step| *step >= raw).unwrap_or(unit);
        let digits = (-step.log10().floor()).max(0.0) as usize;
        let (low, high) = (self.from[0].min(self.from[1]), self.from[0].max(self.from[1]));
        let first = (low / step).ceil() as i64;
        let last = (high / step).floor() as i64;
        ((first..=last.min(first.saturating_add(100))).map(|i| i as f64 * step).collect(), digits)
    }
}

/// Smallest and largest value; infinite without values.
pub fn extent(values: impl Iterator<Item = f64>) -> [f64; 2] {
    values.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], value| [low.min(value), high.max(value)])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_and_within() {
        let ticks = |low, high, wanted| AxisScale { from: [low, high], to: [0.0, 1.0] }.ticks(wanted);
        assert_eq!(ticks(0.0, 100.0, 5.0), (vec![0.0, 20.0, 40.0, 60.0, 80.0, 100.0], 0));
        assert_eq!(ticks(-0.3, 0.31, 4.0), (vec![-0.2, 0.0, 0.2], 1));
        assert_eq!(ticks(4003.2, 4059.0, 6.0).0, [4010.0, 4020.0, 4030.0, 4040.0, 4050.0]);
        assert_eq!(ticks(5.0, 5.0, 4.0).0.len(), 1, "an empty span has one tick");
    }
}

//! Cubic B-splines on knots that stand close in the main lobe and wide in the tail.

use std::ops::Range;

/// Distance of knots in the main lobe and in the tail, in full widths at half maximum (0.75 and 2 ns of 4.4).
const LOBE_STEP_WIDTHS: f64 = 0.17;
const TAIL_STEP_WIDTHS: f64 = 0.45;
/// The first knot before the peak, and the end of the close ones behind it: past the after-pulse (11 and 14 ns of 4.4).
const LEAD_WIDTHS: f64 = 2.5;
const LOBE_WIDTHS: f64 = 3.2;

/// The splines; times are in samples from the peak.
#[derive(Debug, Clone)]
pub(super) struct Basis {
    knots: Vec<f64>,
    /// Splines before this one lie in the main lobe.
    pub(super) lobe: usize,
}

impl Basis {
    /// From 2.5 widths before the peak to `end_samples` behind it.
    pub(super) fn new(fwhm_samples: f64, end_samples: f64) -> Basis {
        let mut knots = Vec::new();
        let mut at = -LEAD_WIDTHS * fwhm_samples;
        while at < end_samples {
            knots.push(at);
            let step = if at < LOBE_WIDTHS * fwhm_samples { LOBE_STEP_WIDTHS } else { TAIL_STEP_WIDTHS };
            at += step * fwhm_samples;
        }
        knots.push(at);
        let lobe = knots.partition_point(|&knot| knot < LOBE_WIDTHS * fwhm_samples).saturating_sub(2);
        Basis { knots, lobe }
    }

    /// How many splines there are.
    pub(super) fn len(&self) -> usize {
        self.knots.len().saturating_sub(4)
    }

    /// Times between which the splines differ from zero.
    pub(super) fn extent(&self) -> Range<f64> {
        self.knots[0]..self.knots[self.knots.len() - 1]
    }

    /// The splines that differ from zero at a time, by index, and their values there (de Boor 1972).
    pub(super) fn at(&self, time: f64) -> impl Iterator<Item = (usize, f64)> {
        let t = &self.knots;
        let interval = t.partition_point(|&knot| knot <= time);
        let mut values = [0.0; 4];
        let inside = interval > 0 && interval < t.len();
        if inside {
            let i = interval - 1;
            // Beyond the ends the knots go on at the distance of the outermost two.
            let knot = |k: isize| -> f64 {
                let last = t.len() as isize - 1;
                match k {
                    k if k < 0 => t[0] + k as f64 * (t[1] - t[0]),
                    k if k > last => {
                        t[last as usize] + (k - last) as f64 * (t[last as usize] - t[last as usize - 1])
                    }
                    k => t[k as usize],
                }
            };
            values[0] = 1.0;
            for degree in 1..4isize {
                let mut saved = 0.0;
                for r in 0..degree {
                    let right = knot(i as isize + r + 1);
                    let left = knot(i as isize + 1 - degree + r);
                    let part = values[r as usize] / (right - left);
                    values[r as usize] = saved + (right - time) * part;
                    saved = (time - left) * part;
                }
                values[degree as usize] = saved;
            }
        }
        let count = self.len();
        let first = interval as isize - 4;
        values.into_iter().enumerate().filter_map(move |(r, value)| {
            let j = first + r as isize;
            (inside && j >= 0 && (j as usize) < count).then_some((j as usize, value))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn splines_sum_to_one_inside_and_vanish_at_the_ends() {
        let basis = Basis::new(4.4, 60.0);
        let sum = |time: f64| basis.at(time).map(|(_, value)| value).sum::<f64>();
        for k in 0..600 {
            let time = -8.0 + 0.1 * f64::from(k);
            if time < 50.0 {
                assert!((sum(time) - 1.0).abs() < 1e-12, "{time}: {}", sum(time));
            }
        }
        let ends = basis.extent();
        assert!(sum(ends.start) == 0.0 && sum(ends.end) == 0.0 && sum(ends.start + 1e-3) < 1e-9);
        assert_eq!(sum(-1e9) + sum(1e9), 0.0);
    }

    /// On even knots the spline of degree three is 1/6, 2/3, 1/6 at its inner knots.
    #[test]
    fn even_knots_give_the_cardinal_spline() {
        let basis = Basis::new(4.4, 60.0);
        let at_knot: Vec<f64> = basis.at(basis.knots[8]).map(|(_, value)| value).collect();
        for (got, exact) in at_knot.iter().zip([1.0 / 6.0, 2.0 / 3.0, 1.0 / 6.0, 0.0]) {
            assert!((got - exact).abs() < 1e-12, "{at_knot:?}");
        }
    }
}

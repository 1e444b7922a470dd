//! Cubic B-splines on knots dense in the main lobe, sparse in the tail.

use std::ops::Range;

/// Knot spacing in the main lobe and in the tail, in pulse widths (0.75 and 2 ns for 4.4 ns).
const LOBE_STEP_WIDTHS: f64 = 0.17;
const TAIL_STEP_WIDTHS: f64 = 0.45;
/// First knot before the peak, and end of the dense knots after it, past the after-pulse (11 and 14
/// ns for 4.4 ns).
const LEAD_WIDTHS: f64 = 2.5;
const LOBE_WIDTHS: f64 = 3.2;

/// The spline basis; times are in samples from the peak.
#[derive(Debug, Clone)]
pub(super) struct Basis {
    knots: Vec<f64>,
    /// Number of splines in the main lobe.
    pub(super) lobe: usize,
}

impl Basis {
    /// Creates the basis from 2.5 widths before the peak to `end_samples`.
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

    /// Number of splines.
    pub(super) fn len(&self) -> usize {
        self.knots.len().saturating_sub(4)
    }

    /// Interval in which the splines differ from zero, samples.
    pub(super) fn extent(&self) -> Range<f64> {
        self.knots[0]..self.knots[self.knots.len() - 1]
    }

    /// Indices and values of the non-zero splines at a time (de Boor 1972).
    pub(super) fn at(&self, time: f64) -> impl Iterator<Item = (usize, f64)> {
        let t = &self.knots;
        let interval = t.partition_point(|&knot| knot <= time);
        let mut values = [0.0; 4];
        let inside = interval > 0 && interval < t.len();
        if inside {
            let i = interval - 1;
            // Beyond the ends, knots continue at the spacing of the outermost two.
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

    /// For equidistant knots the cubic spline has the values 1/6, 2/3, 1/6 at its inner knots.
    #[test]
    fn even_knots_give_the_cardinal_spline() {
        let basis = Basis::new(4.4, 60.0);
        let at_knot: Vec<f64> = basis.at(basis.knots[8]).map(|(_, value)| value).collect();
        for (got, exact) in at_knot.iter().zip([1.0 / 6.0, 2.0 / 3.0, 1.0 / 6.0, 0.0]) {
            assert!((got - exact).abs() < 1e-12, "{at_knot:?}");
        }
    }
}

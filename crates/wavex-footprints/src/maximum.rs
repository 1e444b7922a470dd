//! Position and width of a local maximum.

/// Distances from a mode to half its height behind it and before it, samples; to the next valley if that is higher.
pub(super) fn half_widths(values: &[f32], top: usize, position: f64, height: f64) -> [f64; 2] {
    let half = 0.5 * height;
    let behind = values.get(top..).unwrap_or_default().iter().map(|dn| f64::from(*dn));
    let before = values.get(..=top).unwrap_or_default().iter().rev().map(|dn| f64::from(*dn));
    let offset = position - top as f64;
    [steps_to(behind, half) - offset, steps_to(before, half) + offset]
}

/// Number of steps, with its fraction, until values fall below a level for the first time.
pub(super) fn fall(values: &[f32], level: f64) -> f64 {
    let falling = values.iter().scan(f64::INFINITY, |least, value| {
        *least = least.min(f64::from(*value));
        Some(*least)
    });
    steps_to(falling, level)
}

/// Number of steps, with its fraction, until values fall below a level or rise again.
pub(super) fn steps_to(values: impl Iterator<Item = f64>, level: f64) -> f64 {
    let mut last = f64::INFINITY;
    for (step, value) in (0u32..).zip(values) {
        if value <= level {
            return f64::from(step) - (level - value) / (last - value);
        }
        if value > last {
            return f64::from(step.saturating_sub(1));
        }
        last = value;
    }
    f64::INFINITY
}

/// The parabola through a local maximum and its neighbours: distance of its vertex from the maximum, and its second
/// difference; `None` at the ends and elsewhere.
pub(super) fn parabola(values: &[f32], top: usize) -> Option<(f64, f64)> {
    let at = |k: usize| values.get(k).copied().map(f64::from);
    let (before, here, behind) = (at(top.checked_sub(1)?)?, at(top)?, at(top + 1)?);
    let bend = before - 2.0 * here + behind;
    (here > before && here >= behind).then(|| (0.5 * (before - behind) / bend, bend))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_triangle_has_its_half_widths() {
        let values = [0.0, 2.0, 4.0, 6.0, 8.0, 4.0, 0.0, 1.0];
        assert_eq!(half_widths(&values, 4, 4.0, 8.0), [1.0, 2.0]);
        let valley = [5.0, 4.5, 8.0, 6.0, 7.0];
        assert_eq!(half_widths(&valley, 2, 2.0, 8.0), [1.0, 1.0], "to the valleys");
        assert_eq!(half_widths(&[1.0, 8.0], 1, 1.0, 8.0)[0], f64::INFINITY, "to no end");
    }

    #[test]
    fn a_fall_passes_over_ripples() {
        assert_eq!(fall(&[8.0, 6.0, 7.0, 4.0, 0.0], 5.0), 2.5);
        assert_eq!(fall(&[8.0, 6.0], 5.0), f64::INFINITY);
    }

    #[test]
    fn only_maxima_have_a_vertex() {
        assert_eq!(parabola(&[1.0, 3.0, 1.0], 1), Some((0.0, -4.0)));
        for (values, top) in
            [([1.0, 2.0, 3.0], 1), ([3.0, 1.0, 3.0], 1), ([3.0, 1.0, 0.0], 0), ([1.0, 2.0, 3.0], 2)]
        {
            assert_eq!(parabola(&values, top), None);
        }
    }
}

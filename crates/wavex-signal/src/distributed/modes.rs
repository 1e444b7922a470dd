//! Modes: local maxima that stand out.

/// A local maximum, with the vertex of the parabola through it and its neighbours.
#[derive(Clone, Copy, Debug)]
pub(super) struct ProfileMode {
    top: usize,
    /// Distance of the vertex from the maximum, samples.
    offset: f64,
    /// Derivatives of the offset by the values before, at and behind the maximum.
    slopes: [f64; 3],
}

impl ProfileMode {
    /// The maximum `top`, which is neither the first value nor the last.
    pub(super) fn at(values: &[f64], top: usize) -> ProfileMode {
        let (before, here, behind) = (values[top - 1], values[top], values[top + 1]);
        let bend = before - 2.0 * here + behind;
        if bend >= 0.0 {
            return ProfileMode { top, offset: 0.0, slopes: [0.0; 3] };
        }
        let offset = 0.5 * (before - behind) / bend;
        let slopes = [(0.5 - offset) / bend, 2.0 * offset / bend, (-0.5 - offset) / bend];
        ProfileMode { top, offset, slopes }
    }

    /// Position of the vertex.
    pub(super) fn position(&self) -> f64 {
        self.top as f64 + self.offset
    }

    /// Adds `factor` times the derivatives of the position by the values.
    pub(super) fn add_slopes(&self, factor: f64, weights: &mut [f64]) {
        let around = weights[self.top - 1..].iter_mut();
        around.zip(self.slopes).for_each(|(weight, slope)| *weight += factor * slope);
    }
}

/// Maxima that rise by at least `least` from the value before them, and fall by as much behind them,
/// before the next one.
///
/// The least rise behind a higher maximum is at least `of_highest` times that maximum. Values begin
/// at 0.
pub(super) fn modes(values: &[f64], least: f64, of_highest: f64, found: &mut Vec<ProfileMode>) {
    found.clear();
    let (mut lowest, mut highest) = (0.0, 0.0);
    let mut top: Option<usize> = None;
    for (k, &value) in values.iter().enumerate() {
        match top {
            None => {
                lowest = value.min(lowest);
                if value - lowest >= least.max(of_highest * highest) {
                    top = Some(k);
                }
            }
            Some(at) if value > values[at] => top = Some(k),
            Some(at) if values[at] - value >= least => {
                highest = values[at].max(highest);
                if at > 0 {
                    found.push(ProfileMode::at(values, at));
                }
                (top, lowest) = (None, value);
            }
            Some(_) => {}
        }
    }
}

/// Largest rise from a value to one behind it.
pub(super) fn largest_rise(values: &[f64]) -> f64 {
    let mut lowest = f64::INFINITY;
    values.iter().fold(0.0, |largest: f64, &value| {
        lowest = lowest.min(value);
        largest.max(value - lowest)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn positions(values: &[f64], least: f64, of_highest: f64) -> Vec<usize> {
        let mut found = Vec::new();
        modes(values, least, of_highest, &mut found);
        found.iter().map(|mode| mode.top).collect()
    }

    #[test]
    fn shallow_valleys_and_low_maxima_do_not_separate() {
        let values = [0.0, 5.0, 9.0, 7.5, 10.0, 2.0, 3.5, 2.0, 6.0, 0.0];
        assert_eq!(positions(&values, 3.0, 0.0), [4, 8]);
        assert_eq!(positions(&values, 1.0, 0.0), [2, 4, 6, 8]);
        assert_eq!(positions(&values, 3.0, 0.5), [4]);
        assert_eq!(positions(&values[..9], 3.0, 0.0), [4]);
    }
}

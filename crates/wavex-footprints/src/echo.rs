//! The echo of a flat target after smoothing, with which modes are compared.

use super::kernel::Kernel;
use super::maximum::{half_widths, parabola, steps_to};
use super::model::{FootprintModel, OVERSAMPLING};
use super::profile::share_before;

/// A flat target's echo, after smoothing.
pub(super) struct Echo {
    /// Sum of its samples over its height.
    pub(super) area_samples: f64,
    /// Part of its energy behind its mode.
    pub(super) behind: f64,
    /// Distances from its mode to half its height, behind and before, samples.
    pub(super) half_widths_samples: [f64; 2],
    /// Its largest value at this distance or more behind its mode, relative to its height.
    pub(super) tail: Vec<f64>,
    /// Distance from its largest sample to its mode, samples.
    offset: f64,
}

impl Echo {
    pub(super) fn of(model: &FootprintModel, kernel: &Kernel) -> Echo {
        let response: Vec<f32> =
            model.response.iter().map(|value| *value as f32).step_by(OVERSAMPLING).collect();
        let room = 4 * response.len();
        let samples: Vec<f32> = std::iter::repeat_n(0.0, room)
            .chain(response.iter().copied())
            .chain(std::iter::repeat_n(0.0, room))
            .collect();
        let mut smoothed = Vec::new();
        kernel.smooth_into(&samples, &mut smoothed);
        let top = (0..smoothed.len()).max_by(|&a, &b| smoothed[a].total_cmp(&smoothed[b])).unwrap_or(0);
        let height = f64::from(smoothed.get(top).copied().unwrap_or(1.0));
        let position = top as f64 + parabola(&smoothed, top).map_or(0.0, |(offset, _)| offset);
        let area: f64 = smoothed.iter().map(|dn| f64::from(*dn)).sum();
        let before: f64 =
            (0..).zip(&smoothed).map(|(k, dn)| share_before(k, position) * f64::from(*dn)).sum();
        let half_widths_samples = half_widths(&smoothed, top, position, height);
        let mut tail: Vec<f64> = smoothed.iter().skip(top).map(|dn| f64::from(*dn) / height).collect();
        // The largest value from here on: a mode is not made by a ringing response.
        let mut largest = 0.0f64;
        for value in tail.iter_mut().rev() {
            largest = largest.max(*value);
            *value = largest;
        }
        let height_before = model.response.iter().copied().fold(0.0, f64::max);
        Echo {
            area_samples: area / height_before,
            behind: 1.0 - before / area,
            half_widths_samples,
            tail,
            offset: position - top as f64,
        }
    }

    /// Distance behind its mode at which it falls to this part of its height, samples.
    pub(super) fn fall_behind(&self, part: f64) -> f64 {
        steps_to(self.tail.iter().copied(), part) - self.offset
    }
}

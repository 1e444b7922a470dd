//! Pulse shape: a Gaussian or the calibrated system response.

mod pulse;
pub(crate) mod templates;

use std::ops::Range;
use std::sync::Arc;

use crate::sensor_model::response::{self, STEPS_PER_SAMPLE, SystemResponse};
use crate::sensor_model::{ChannelModel, ModelError};
use templates::{TemplatePart, Templates};

pub(crate) use pulse::FOUR_LN_2;
pub use pulse::Pulse;
pub(crate) use pulse::{LN_WIDTH_BOUNDS, Lane, SD_OF_FWHM};

/// Family of pulses by height, position and width.
#[derive(Debug, Clone)]
pub struct Shape {
    family: Family,
    /// Delay of odd samples relative to their index, samples.
    odd_sample_shift: f64,
}

#[derive(Debug, Clone)]
enum Family {
    /// Gaussians of this calibrated full width at half maximum, samples.
    Gaussian { fwhm_samples: f64 },
    /// The system response, widened by a Gaussian.
    Response(Arc<ResponseShape>),
}

/// Template tables of a channel's response.
#[derive(Debug)]
pub(crate) struct ResponseShape {
    fwhm_samples: f64,
    /// Tables by ascending height.
    nodes: Vec<(f64, Templates)>,
    /// Full widths at half maximum of the nodes' responses, samples.
    node_fwhm_samples: Vec<f64>,
}

impl From<f64> for Shape {
    /// Gaussians of this full width at half maximum, samples.
    fn from(fwhm_samples: f64) -> Shape {
        Shape { family: Family::Gaussian { fwhm_samples }, odd_sample_shift: 0.0 }
    }
}

impl Shape {
    /// Shape of a channel model.
    pub fn of(model: &ChannelModel) -> Result<Shape, ModelError> {
        let shape = match &model.response {
            None => Shape::from(model.fwhm_samples()),
            Some(response) => Shape::of_response(response, model.fwhm_samples())?,
        };
        Ok(Shape { odd_sample_shift: model.digitiser.odd_sample_shift, ..shape })
    }

    fn of_response(response: &SystemResponse, fwhm_samples: f64) -> Result<Shape, ModelError> {
        response.check()?;
        let table = |values: &[f64]| Templates::new(values, response.first_sample, fwhm_samples);
        let nodes = response.nodes.iter().map(|node| (node.peak_dn, table(&node.values))).collect();
        let width = |values: &[f64]| match response::fwhm(values) / STEPS_PER_SAMPLE as f64 {
            width if width > 0.0 => width,
            _ => fwhm_samples,
        };
        let node_fwhm_samples = response.nodes.iter().map(|node| width(&node.values)).collect();
        let family = Family::Response(Arc::new(ResponseShape { fwhm_samples, nodes, node_fwhm_samples }));
        Ok(Shape { family, odd_sample_shift: 0.0 })
    }

    /// The same shape with all samples at their nominal times.
    pub(crate) fn on_time(&self) -> Shape {
        Shape { odd_sample_shift: 0.0, ..self.clone() }
    }

    /// Full width at half maximum of a pulse of width ratio 1, samples.
    pub fn fwhm_samples(&self) -> f64 {
        match &self.family {
            Family::Gaussian { fwhm_samples } => *fwhm_samples,
            Family::Response(response) => response.fwhm_samples,
        }
    }

    /// FWHM of a pulse of this height and width ratio 1, samples.
    ///
    /// A receiver that compresses strong echoes makes them wider.
    #[inline(always)]
    pub fn fwhm_samples_at(&self, height_dn: f64) -> f64 {
        match &self.family {
            Family::Gaussian { fwhm_samples } => *fwhm_samples,
            Family::Response(response) => {
                let (low, high, share) = response.around(height_dn);
                let widths = &response.node_fwhm_samples;
                (1.0 - share) * widths[low] + share * widths[high]
            }
        }
    }

    /// Smallest and largest log width ratio that can be fitted.
    pub(crate) fn ln_width_bounds(&self) -> [f64; 2] {
        match &self.family {
            Family::Gaussian { .. } => LN_WIDTH_BOUNDS,
            Family::Response(_) => Templates::ln_width_bounds(),
        }
    }

    /// Adds `sign` times the pulse to the samples `values` of a block.
    pub fn add(&self, pulse: &Pulse, sign: f64, values: &mut [f64]) {
        for (lane, pulse) in self.lanes(pulse).into_iter().flatten() {
            match &self.family {
                Family::Gaussian { fwhm_samples } => pulse.add_lane_to(*fwhm_samples, sign, lane, values),
                Family::Response(response) => {
                    response.add([(TemplatePart::Value, sign * pulse.height_dn)], &pulse, lane, [values]);
                }
            }
        }
    }

    /// Adds the derivatives of the pulse by height, position and log width to columns of block
    /// length.
    ///
    /// Returns the samples that can differ from zero.
    pub(crate) fn add_derivatives(&self, pulse: &Pulse, columns: [&mut [f64]; 3]) -> Range<usize> {
        let [by_height, by_position, by_width] = columns;
        let mut changed = 0..0;
        for (lane, pulse) in self.lanes(pulse).into_iter().flatten() {
            let columns = [&mut *by_height, &mut *by_position, &mut *by_width];
            let by_lane = match &self.family {
                Family::Gaussian { fwhm_samples } => pulse.add_derivatives_to(*fwhm_samples, lane, columns),
                Family::Response(response) => response.add_derivatives(&pulse, lane, columns),
            };
            changed = union(changed, by_lane);
        }
        changed
    }

    /// The pulse relative to the samples of each lane: delayed samples see it earlier.
    fn lanes(&self, pulse: &Pulse) -> [Option<(Lane, Pulse)>; 2] {
        if self.odd_sample_shift == 0.0 {
            return [Some((Lane::All, *pulse)), None];
        }
        let earlier = Pulse { position_samples: pulse.position_samples - self.odd_sample_shift, ..*pulse };
        [Some((Lane::Even, *pulse)), Some((Lane::Odd, earlier))]
    }
}

impl ResponseShape {
    /// Nodes around a height, and the weight of the second.
    #[inline]
    fn around(&self, height_dn: f64) -> (usize, usize, f64) {
        if self.nodes.len() == 1 {
            return (0, 0, 0.0);
        }
        let above = self.nodes.partition_point(|(peak_dn, _)| *peak_dn <= height_dn);
        if above == 0 || above == self.nodes.len() {
            let only = above.saturating_sub(1);
            return (only, only, 0.0);
        }
        let (low, high) = (self.nodes[above - 1].0, self.nodes[above].0);
        (above - 1, above, (height_dn - low) / (high - low))
    }

    fn add_derivatives(&self, pulse: &Pulse, lane: Lane, columns: [&mut [f64]; 3]) -> Range<usize> {
        let [by_height, by_position, by_width] = columns;
        let height_dn = pulse.height_dn;
        let parts = [
            (TemplatePart::Value, 1.0),
            (TemplatePart::ByTime, -height_dn),
            (TemplatePart::ByLnWidth, height_dn),
        ];
        let changed = self.add(parts, pulse, lane, [&mut *by_height, by_position, by_width]);
        union(changed, self.add_change_with_height(pulse, lane, by_height))
    }

    /// Adds parts of the pulse, each with its factor; returns the samples that can change.
    fn add<const T: usize>(
        &self,
        parts: [(TemplatePart, f64); T],
        pulse: &Pulse,
        lane: Lane,
        mut values: [&mut [f64]; T],
    ) -> Range<usize> {
        let (low, high, share) = self.around(pulse.height_dn);
        let mut changed = 0..0;
        for (node, weight) in [(low, 1.0 - share), (high, share)] {
            if weight > 0.0 {
                let parts = parts.map(|(part, factor)| (part, weight * factor));
                let values = values.each_mut().map(|values| &mut **values);
                let (place, width) = (pulse.position_samples, pulse.ln_width_ratio);
                changed = union(changed, self.nodes[node].1.add(parts, place, width, lane, values));
            }
        }
        changed
    }

    /// Adds the change of shape with height to the height derivative; returns the samples that can change.
    fn add_change_with_height(&self, pulse: &Pulse, lane: Lane, by_height: &mut [f64]) -> Range<usize> {
        let (low, high, _) = self.around(pulse.height_dn);
        let mut changed = 0..0;
        if low == high {
            return changed;
        }
        let per_dn = pulse.height_dn / (self.nodes[high].0 - self.nodes[low].0);
        for (node, factor) in [(low, -per_dn), (high, per_dn)] {
            let table = &self.nodes[node].1;
            let (place, width) = (pulse.position_samples, pulse.ln_width_ratio);
            let by_node = table.add([(TemplatePart::Value, factor)], place, width, lane, [&mut *by_height]);
            changed = union(changed, by_node);
        }
        changed
    }
}

/// Smallest range that contains two; empty ones do not count.
fn union(a: Range<usize>, b: Range<usize>) -> Range<usize> {
    match (a.is_empty(), b.is_empty()) {
        (true, _) => b,
        (_, true) => a,
        _ => a.start.min(b.start)..a.end.max(b.end),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PULSE: Pulse =
        Pulse { height_dn: 50.0, position_samples: 12.3, ln_width_ratio: 0.2, ln_width_precision: 0.0 };

    /// Even samples are unchanged; odd ones equal those of a pulse that much earlier, for values
    /// and derivatives.
    #[test]
    fn odd_samples_are_seen_at_their_own_time() {
        let plain = Shape::from(4.5);
        let shifted = Shape { odd_sample_shift: 0.1, ..plain.clone() };
        let earlier = Pulse { position_samples: PULSE.position_samples - 0.1, ..PULSE };
        let all = |shape: &Shape, pulse: &Pulse| {
            let mut parts = vec![vec![0.0; 40]; 4];
            shape.add(pulse, 1.0, &mut parts[0]);
            let [_, a, b, c] = parts.get_disjoint_mut([0, 1, 2, 3]).unwrap();
            shape.add_derivatives(pulse, [a, b, c]);
            parts
        };
        let (seen, on_time, late) = (all(&shifted, &PULSE), all(&plain, &PULSE), all(&plain, &earlier));
        for part in 0..4 {
            for k in 0..40 {
                let expected = if k % 2 == 0 { on_time[part][k] } else { late[part][k] };
                assert_eq!(seen[part][k], expected, "{part} {k}");
            }
        }
        assert_eq!(all(&shifted.on_time(), &PULSE), on_time);
    }

    #[test]
    fn lanes_begin_at_or_after_a_sample() {
        let begins = |lane: Lane| [4, 5].map(|first| lane.from(first));
        assert_eq!([Lane::All, Lane::Even, Lane::Odd].map(begins), [[4, 5], [4, 6], [5, 5]]);
    }
}

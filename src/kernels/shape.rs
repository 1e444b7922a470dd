//! The shape that pulses have: a Gaussian, or the calibrated system response.

use std::sync::Arc;

use super::gauss_fit::{self, Pulse};
use super::response::{self, STEPS_PER_SAMPLE, SystemResponse};
use super::sensor_model::{ChannelModel, ModelError};
use super::templates::{Part, Templates};

/// A family of pulses: by height, place and width.
#[derive(Debug, Clone)]
pub enum Shape {
    /// Gaussians; the calibrated width in samples.
    Gaussian {
        /// Full width at half maximum of a pulse of width ratio 1, samples.
        fwhm_samples: f64,
    },
    /// The system response, widened by a Gaussian.
    Response(Arc<ResponseShape>),
}

/// The tables of a channel's response.
#[derive(Debug)]
pub struct ResponseShape {
    fwhm_samples: f64,
    /// By the height that they hold for, rising.
    nodes: Vec<(f64, Templates)>,
    /// Full widths at half maximum of the nodes' responses, samples.
    node_fwhm_samples: Vec<f64>,
}

impl From<f64> for Shape {
    /// Gaussians of this full width at half maximum, samples.
    fn from(fwhm_samples: f64) -> Shape {
        Shape::Gaussian { fwhm_samples }
    }
}

impl Shape {
    /// The shape that a channel's model describes.
    pub fn of(model: &ChannelModel) -> Result<Shape, ModelError> {
        match &model.response {
            None => Ok(Shape::from(model.fwhm_samples())),
            Some(response) => Shape::of_response(response, model.fwhm_samples()),
        }
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
        Ok(Shape::Response(Arc::new(ResponseShape { fwhm_samples, nodes, node_fwhm_samples })))
    }

    /// Full width at half maximum of a pulse of width ratio 1, samples.
    pub fn fwhm_samples(&self) -> f64 {
        match self {
            Shape::Gaussian { fwhm_samples } => *fwhm_samples,
            Shape::Response(response) => response.fwhm_samples,
        }
    }

    /// Full width at half maximum of a pulse of width ratio 1 and of this height, samples: a receiver that compresses
    /// strong echoes makes them wider.
    pub fn fwhm_samples_at(&self, height_dn: f64) -> f64 {
        match self {
            Shape::Gaussian { fwhm_samples } => *fwhm_samples,
            Shape::Response(response) => {
                let (low, high, share) = response.around(height_dn);
                let widths = &response.node_fwhm_samples;
                (1.0 - share) * widths[low] + share * widths[high]
            }
        }
    }

    /// The least and the greatest logarithm of a width ratio that can be fitted.
    pub fn ln_width_bounds(&self) -> [f64; 2] {
        match self {
            Shape::Gaussian { .. } => gauss_fit::LN_WIDTH_BOUNDS,
            Shape::Response(_) => Templates::ln_width_bounds(),
        }
    }

    /// Adds `sign` times the pulse to `values`, the samples of a block.
    pub fn add(&self, pulse: &Pulse, sign: f64, values: &mut [f64]) {
        match self {
            Shape::Gaussian { fwhm_samples } => pulse.add_to(*fwhm_samples, sign, values),
            Shape::Response(response) => {
                response.add(Part::Value, pulse, sign * pulse.height_dn, values);
            }
        }
    }

    /// Adds the pulse's derivatives by height, position and width's logarithm to columns of a block's length. Returns
    /// the first sample that can differ from zero.
    pub fn add_derivatives(&self, pulse: &Pulse, columns: [&mut [f64]; 3]) -> usize {
        match self {
            Shape::Gaussian { fwhm_samples } => pulse.add_derivatives_to(*fwhm_samples, columns),
            Shape::Response(response) => {
                let [by_height, by_position, by_width] = columns;
                response.add(Part::Value, pulse, 1.0, by_height);
                response.add_change_with_height(pulse, by_height);
                response.add(Part::ByTime, pulse, -pulse.height_dn, by_position);
                response.add(Part::ByLnWidth, pulse, pulse.height_dn, by_width);
                0
            }
        }
    }
}

impl ResponseShape {
    /// The nodes around a height, and the part of the second.
    fn around(&self, height_dn: f64) -> (usize, usize, f64) {
        let above = self.nodes.partition_point(|(peak_dn, _)| *peak_dn <= height_dn);
        if above == 0 || above == self.nodes.len() {
            let only = above.saturating_sub(1);
            return (only, only, 0.0);
        }
        let (low, high) = (self.nodes[above - 1].0, self.nodes[above].0);
        (above - 1, above, (height_dn - low) / (high - low))
    }

    fn add(&self, part: Part, pulse: &Pulse, factor: f64, values: &mut [f64]) {
        let (low, high, share) = self.around(pulse.height_dn);
        let mut add = |node: usize, factor: f64| {
            self.nodes[node].1.add(part, pulse.position_samples, pulse.ln_width_ratio, factor, values);
        };
        add(low, (1.0 - share) * factor);
        if share > 0.0 {
            add(high, share * factor);
        }
    }

    /// What the shape's own change with the height adds to the derivative by it.
    fn add_change_with_height(&self, pulse: &Pulse, by_height: &mut [f64]) {
        let (low, high, _) = self.around(pulse.height_dn);
        if low == high {
            return;
        }
        let per_dn = pulse.height_dn / (self.nodes[high].0 - self.nodes[low].0);
        for (node, factor) in [(low, -per_dn), (high, per_dn)] {
            let table = &self.nodes[node].1;
            table.add(Part::Value, pulse.position_samples, pulse.ln_width_ratio, factor, by_height);
        }
    }
}

//! System response: the record of an infinitely short echo from a flat target.
//!
//! It combines laser pulse, receiver and digitiser, and is asymmetric, with an after-pulse and a
//! slow tail (docs/explanation/method.md, Signal model). Its peak is at time 0 and has height 1. A receiver
//! that compresses strong echoes has several responses, each for one peak height; shapes in between
//! are interpolated linearly.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::fourier::{self, Complex, times};
use crate::sensor_model::ModelError;

/// Number of values of a response per sample.
pub(crate) const STEPS_PER_SAMPLE: usize = 8;
/// Largest length of a response, samples.
const MAX_SAMPLES: usize = 8192;
/// Taper of a response, as frequency times full width at half maximum. At the start the spectrum of
/// a pulse of this width is below 1e-4, so an estimate contains only noise.
const FADED: [f64; 2] = [1.8, 2.3];
/// Largest frequency kept, cycles per sample: just above the Nyquist frequency.
const MAX_FREQUENCY: f64 = 0.55;

/// Calibrated system response of one channel.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SystemResponse {
    /// Time of the first value, samples from the peak; negative.
    pub first_sample: i32,
    /// Responses by ascending peak height; constant below the first and above the last.
    pub nodes: Vec<ResponseNode>,
    /// SD of the pulse shape about the response, relative to the height; of an outgoing pulse as response,
    /// relative to the energy (height times width ratio).
    ///
    /// One value per sample of time from `first_sample`; 0 if not significant.
    pub template_error: Vec<f64>,
    /// Chi-square that the template error adds to a fit, relative to that in uncorrelated noise.
    ///
    /// Shape errors are smooth. Correlated noise hides them, and free widths and further returns
    /// absorb part of them.
    #[serde(default = "one", skip_serializing_if = "is_one")]
    pub excess_part: f64,
    /// Number of single echoes used; 0 if copied from another receiver.
    pub echoes: u64,
    /// RMS uncertainty of the first node's values, relative to the peak.
    pub shape_sd: f64,
}

/// Response for one peak height.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ResponseNode {
    /// Peak height, DN; positive and ascending.
    pub peak_dn: f64,
    /// Values every eighth of a sample; 1 at the peak, at index `-8 first_sample`.
    pub values: Vec<f64>,
}

fn one() -> f64 {
    1.0
}

fn is_one(part: &f64) -> bool {
    *part == 1.0
}

impl SystemResponse {
    /// Checks that the values form a response.
    pub fn check(&self) -> Result<(), ModelError> {
        let fail = |problem: String| Err(ModelError { field: "response", problem });
        let peak = -i64::from(self.first_sample) * STEPS_PER_SAMPLE as i64;
        let Some(first) = self.nodes.first() else { return fail("it has no nodes".into()) };
        let length = first.values.len();
        if length > MAX_SAMPLES * STEPS_PER_SAMPLE {
            return fail(format!("{length} values exceed the maximum of {}", MAX_SAMPLES * STEPS_PER_SAMPLE));
        }
        if peak <= 0 || peak >= length as i64 {
            return fail(format!("first_sample {} puts the peak outside the values", self.first_sample));
        }
        if !(self.excess_part >= 0.0 && self.excess_part.is_finite()) {
            return fail(format!("excess_part {} is not a factor", self.excess_part));
        }
        let mut last_dn = 0.0;
        for node in &self.nodes {
            if !(node.peak_dn > last_dn && node.peak_dn.is_finite()) {
                return fail(format!("peak_dn {} is not above 0 and the previous peak_dn", node.peak_dn));
            }
            last_dn = node.peak_dn;
            if node.values.len() != length {
                return fail(format!("{} values instead of {length}", node.values.len()));
            }
            let bad = node.values.iter().find(|value| value.is_nan() || value.abs() > 1.01);
            if let Some(value) = bad {
                return fail(format!("value {value} is not between -1.01 and 1.01"));
            }
            if (node.values[peak as usize] - 1.0).abs() > 1e-3 {
                return fail("the value at the peak is not 1".into());
            }
        }
        Ok(())
    }

    /// Full width at half maximum of the first node, samples; 0 if it does not fall to half.
    pub fn fwhm_samples(&self) -> f64 {
        self.nodes.first().map_or(0.0, |node| fwhm(&node.values)) / STEPS_PER_SAMPLE as f64
    }

    /// Relative template error at a time after the peak, samples.
    pub(crate) fn template_error_at(&self, samples: f64) -> f64 {
        let index = (samples - f64::from(self.first_sample)).round();
        if index >= 0.0 { self.template_error.get(index as usize).copied().unwrap_or(0.0) } else { 0.0 }
    }

    /// Response for the highest echoes at a time after the peak, samples; 0 outside.
    pub(crate) fn highest_at(&self, samples: f64) -> f64 {
        let step = ((samples - f64::from(self.first_sample)) * STEPS_PER_SAMPLE as f64).round();
        let values = self.nodes.last().map_or(&[][..], |node| &node.values);
        if step >= 0.0 { values.get(step as usize).copied().unwrap_or(0.0) } else { 0.0 }
    }
}

/// Full width at half maximum, steps; 0 if one side does not fall to half.
pub(crate) fn fwhm(values: &[f64]) -> f64 {
    let Some(peak) = (0..values.len()).max_by(|&i, &j| values[i].total_cmp(&values[j])) else { return 0.0 };
    let half = 0.5 * values[peak];
    let left = (1..=peak).rev().find(|&i| values[i - 1] < half);
    let right = (peak..values.len().saturating_sub(1)).find(|&i| values[i + 1] < half);
    match (left, right) {
        (Some(l), Some(r)) => {
            let rise = l as f64 - (values[l] - half) / (values[l] - values[l - 1]);
            let fall = r as f64 + (values[r] - half) / (values[r] - values[r + 1]);
            fall - rise
        }
        _ => 0.0,
    }
}

/// Fourier series of `values` in a period of `steps`, a power of two.
///
/// `values` has [`STEPS_PER_SAMPLE`] values per sample; `first_step` is the time of the first. Only
/// frequencies of a response are kept: the series has `bins` terms, and bin `j` has `j
/// STEPS_PER_SAMPLE / steps` cycles per sample.
pub(crate) fn spectrum(values: &[f64], first_step: i64, steps: usize, bins: usize) -> Vec<Complex> {
    let mut padded = vec![[0.0, 0.0]; steps];
    for (k, value) in values.iter().enumerate() {
        let at = (first_step + k as i64).rem_euclid(steps as i64) as usize;
        padded[at][0] += value;
    }
    fourier::transform(&mut padded, -1.0);
    padded.truncate(bins);
    padded.iter().map(|c| [c[0] / steps as f64, c[1] / steps as f64]).collect()
}

/// Number of terms in a series of period `steps`.
pub(crate) fn bins(steps: usize) -> usize {
    ((MAX_FREQUENCY / STEPS_PER_SAMPLE as f64 * steps as f64).floor() as usize + 1).min(steps / 2)
}

/// Band-limits an estimate, moves its peak to time 0 and scales it to height 1.
///
/// `values` are at times `first_step…`, in steps; the result is at the same times. `None` without a
/// peak.
pub(crate) fn normalised(values: &[f64], first_step: i64, fwhm_samples: f64) -> Option<Vec<f64>> {
    let steps = (2 * values.len()).next_power_of_two();
    let mut series = spectrum(values, first_step, steps, bins(steps));
    for (j, c) in series.iter_mut().enumerate() {
        let relative = j as f64 * STEPS_PER_SAMPLE as f64 / steps as f64 * fwhm_samples;
        let fade = ((relative - FADED[0]) / (FADED[1] - FADED[0])).clamp(0.0, 1.0);
        let gain = 0.5 * (1.0 + (std::f64::consts::PI * fade).cos());
        *c = [c[0] * gain, c[1] * gain];
    }
    for _ in 0..4 {
        let limited = synthesis(&series, steps);
        let at = |step: i64| limited[step.rem_euclid(steps as i64) as usize];
        let range = first_step..first_step + values.len() as i64;
        let peak = range.max_by(|&i, &j| at(i).total_cmp(&at(j)))?;
        let (before, top, after) = (at(peak - 1), at(peak), at(peak + 1));
        let curvature = before + after - 2.0 * top;
        if !(top > 0.0 && curvature < 0.0) {
            return None;
        }
        let shift = peak as f64 + 0.5 * (before - after) / curvature;
        let height = top - 0.125 * (after - before).powi(2) / curvature;
        for (j, c) in series.iter_mut().enumerate() {
            let (sin, cos) = (std::f64::consts::TAU * j as f64 * shift / steps as f64).sin_cos();
            *c = times(*c, [cos / height, sin / height]);
        }
    }
    let limited = synthesis(&series, steps);
    Some(
        (0..values.len() as i64)
            .map(|k| limited[(first_step + k).rem_euclid(steps as i64) as usize])
            .collect(),
    )
}

fn synthesis(series: &[Complex], steps: usize) -> Vec<f64> {
    let mut values = vec![[0.0, 0.0]; steps];
    values[0][0] = series[0][0];
    for (j, c) in series.iter().enumerate().skip(1) {
        values[j] = [2.0 * c[0], 2.0 * c[1]];
    }
    fourier::transform(&mut values, 1.0);
    values.iter().map(|c| c[0]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bell(centre: f64) -> Vec<f64> {
        (0..=400).map(|k| (-((f64::from(k) - centre) / 20.0).powi(2)).exp()).collect()
    }

    fn response() -> SystemResponse {
        SystemResponse {
            first_sample: -12,
            nodes: vec![ResponseNode { peak_dn: 155.0, values: bell(96.0) }],
            template_error: vec![0.0, 0.001, 0.002],
            echoes: 200,
            excess_part: 1.0,
            shape_sd: 1e-3,
        }
    }

    #[test]
    fn an_estimate_gets_its_peak_at_zero_and_the_height_one() {
        let crooked: Vec<f64> = bell(99.3).iter().map(|v| 1.7 * v).collect();
        let fwhm_samples = 40.0 * 2f64.ln().sqrt() / STEPS_PER_SAMPLE as f64;
        let values = normalised(&crooked, -96, fwhm_samples).unwrap();
        for (k, (got, exact)) in values.iter().zip(bell(96.0)).enumerate() {
            assert!((got - exact).abs() < 1e-4, "{k}: {got} {exact}");
        }
        assert!((fwhm(&values) / STEPS_PER_SAMPLE as f64 - fwhm_samples).abs() < 1e-2);
        assert_eq!(normalised(&[0.0; 100], -50, 4.0), None);
    }

    #[test]
    fn template_errors_are_per_sample() {
        let response = response();
        assert_eq!(response.check(), Ok(()));
        assert!((response.fwhm_samples() - 40.0 * 2f64.ln().sqrt() / 8.0).abs() < 1e-3);
        let errors = [-13.0, -12.0, -11.4, -9.6, 50.0].map(|t| response.template_error_at(t));
        assert_eq!(errors, [0.0, 0.0, 0.001, 0.002, 0.0]);
    }

    #[test]
    fn what_describes_no_response_is_named() {
        let check = |change: fn(&mut SystemResponse), expected: &str| {
            let mut response = response();
            change(&mut response);
            let found = response.check().unwrap_err().to_string();
            let remedy = "; recalibrate, or correct the saved model";
            assert_eq!(found, format!("sensor model: response: {expected}{remedy}"));
        };
        check(|r| r.nodes.clear(), "it has no nodes");
        check(|r| r.first_sample = 3, "first_sample 3 puts the peak outside the values");
        check(|r| r.first_sample = i32::MIN, "first_sample -2147483648 puts the peak outside the values");
        check(|r| r.first_sample = -11, "the value at the peak is not 1");
        check(|r| r.nodes[0].peak_dn = -1.0, "peak_dn -1 is not above 0 and the previous peak_dn");
        check(|r| r.nodes[0].values[7] = f64::NAN, "value NaN is not between -1.01 and 1.01");
        check(|r| r.nodes[0].values.resize(70_000, 0.0), "70000 values exceed the maximum of 65536");
        check(|r| r.nodes.push(ResponseNode { peak_dn: 171.0, values: vec![] }), "0 values instead of 401");
    }
}

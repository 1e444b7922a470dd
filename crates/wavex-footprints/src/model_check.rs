//! Checks the numbers of a model from a file.

use super::deviation::ResidualNoise;
use super::measured::MOST_SAMPLES;
use super::model::{FootprintModel, LAGS, OVERSAMPLING};

/// A number of a model that no receiver has.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum FootprintModelError {
    /// A number is beyond its bounds, or not finite.
    #[error("`{field}` must be from {least} to {most}, got {found}")]
    Number {
        /// Name of the field.
        field: &'static str,
        /// Least value.
        least: f64,
        /// Largest value.
        most: f64,
        /// Value found.
        found: f64,
    },
    /// A list is too short or too long.
    #[error("`{field}` must have {} values, got {found}", lengths(*least, *most))]
    Length {
        /// Name of the field.
        field: &'static str,
        /// Least length.
        least: usize,
        /// Largest length.
        most: usize,
        /// Length found.
        found: usize,
    },
}

fn lengths(least: usize, most: usize) -> String {
    if least == most { least.to_string() } else { format!("{least} to {most}") }
}

impl FootprintModel {
    /// Checks a model that was not learnt from the recording.
    ///
    /// # Errors
    /// A number is not finite or beyond its bounds, or a list has another length.
    pub fn check(&self) -> Result<(), FootprintModelError> {
        let FootprintModel {
            sampling_interval_ns,
            noise_sd_dn,
            autocorrelation,
            residual_noise: ResidualNoise { samples_per_independent, variance_ratio_per_dn },
            response,
            pulse_fwhm_ns,
            shots: _,
        } = self;
        let is_length = |field, list: &[f64], [least, most]: [usize; 2]| {
            let found = list.len();
            let is_wrong = !(least..=most).contains(&found);
            is_wrong.then_some(FootprintModelError::Length { field, least, most, found }).map_or(Ok(()), Err)
        };
        is_length("autocorrelation", autocorrelation, [LAGS; 2])?;
        is_length("response", response, [OVERSAMPLING, OVERSAMPLING * MOST_SAMPLES])?;
        // The response has its own width, which limits the memory of the filters.
        let samples = response.len() as f64 / OVERSAMPLING as f64;
        let widths_ns = [0.1 * sampling_interval_ns, samples * sampling_interval_ns];
        let numbers: [(_, &[f64], _); 7] = [
            ("sampling_interval_ns", &[*sampling_interval_ns], [0.01, 100.0]),
            ("noise_sd_dn", &[*noise_sd_dn], [0.0, 1e6]),
            ("autocorrelation", autocorrelation, [-2.0, 2.0]),
            ("samples_per_independent", &[*samples_per_independent], [0.0, 1e3]),
            ("variance_ratio_per_dn", &[*variance_ratio_per_dn], [0.0, 1e6]),
            ("response", response, [-2.0, 2.0]),
            ("pulse_fwhm_ns", &[*pulse_fwhm_ns], widths_ns),
        ];
        numbers.into_iter().try_for_each(|(field, values, [least, most])| {
            // NaN is in no range.
            let wrong = values.iter().find(|value| !(least..=most).contains(*value));
            wrong.map_or(Ok(()), |found| {
                Err(FootprintModelError::Number { field, least, most, found: *found })
            })
        })
    }
}

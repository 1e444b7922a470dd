//! Large footprints: ground, canopy and relative heights of waveforms that are profiles, not a few echoes.
//!
//! A footprint of 20 m and more holds ground and many layers of vegetation. Its waveform is smoothed by the
//! receiver, long, and not a sum of few pulses, therefore it is described as in GEDI's level 2A product
//! (M. Hofton and J. B. Blair, Algorithm Theoretical Basis Document for GEDI Transmit and Receive Waveform
//! Processing, 2019): it is smoothed, its signal lies between the first and the last crossing of a
//! threshold, modes are local maxima, the lowest is the ground, and heights are percentiles of the
//! energy. Everything is a function of the samples; standard deviations follow from the
//! autocovariance of the noise, which the receiver's filter correlates over several samples, and which no
//! autoregressive model describes because hardly any part of a sample is unpredictable.
//!
//! [`FootprintLearner`] learns noise and response from shots, [`FootprintEstimator`] measures shots. Samples are
//! fractions of a digitiser step. The cost is linear in their number.

mod background;
mod constants;
mod cover;
mod deviation;
mod echo;
mod estimator;
mod ground;
mod kernel;
mod maximum;
mod measured;
mod model;
mod model_check;
mod modes;
mod profile;
mod settings;
#[cfg(test)]
mod tests;

pub use cover::{cover, plant_area_index};
pub use deviation::ResidualNoise;
pub use estimator::FootprintEstimator;
pub use measured::{
    FootprintMode, GROUND_FEATURES, GroundCandidate, HEIGHTS, MOST_SAMPLES, Measured, RecordedNoise,
};
pub use model::{
    EchoWidth, FootprintLearner, FootprintModel, LEAST_SHOTS, LearningError, outgoing_fwhm_samples,
};
pub use model_check::FootprintModelError;
pub use settings::{FootprintSettings, NoiseSource};
pub use wavex_simd::statistics::WithSd;

//! Decomposition of lidar waveforms: slices in, values out, without files, clocks or threads.
//!
//! A [`Decomposer`](decompose::Decomposer) turns the samples of one waveform into returns. It needs
//! a calibrated [`ChannelModel`](sensor_model::ChannelModel). [`calibrate`] estimates one from
//! recorded waveforms; here it is written by hand:
//!
//! ```
//! use wavex_signal::decompose::{DecomposeSettings, Decomposer};
//! use wavex_signal::sensor_model::{Background, ChannelModel, Digitiser, ModelUncertainty, Provenance, ReceiverLimits};
//!
//! let model = ChannelModel {
//!     sampling_interval_ns: 1.0,
//!     full_scale_dn: 255.0,
//!     background: Background::Fixed,
//!     background_dn: [5.0; 4],
//!     background_sd_dn: 0.0,
//!     noise_sd_dn: 0.8,
//!     autocorrelation: vec![],
//!     ar: vec![],
//!     innovation_sd_dn: 0.8,
//!     pulse_fwhm_ns: 4.0,
//!     pulse_fwhm_sd_ns: 0.1,
//!     pulse_shape_error: 0.0,
//!     pulse_error_factor: 1.0,
//!     response: None,
//!     digitiser: Digitiser::default(),
//!     uncertainty: ModelUncertainty::default(),
//!     provenance: Provenance::default(),
//!     limits: ReceiverLimits::default(),
//!     waveforms: 1000,
//!     pulses: 1000,
//! };
//! // Two echoes, 16 ns apart.
//! let echo = |k: i32, height_dn: f64, at: f64| {
//!     height_dn * (-4.0 * std::f64::consts::LN_2 * ((f64::from(k) - at) / 4.0).powi(2)).exp()
//! };
//! let waveform: Vec<u16> =
//!     (0..48).map(|k| (5.0 + echo(k, 120.0, 12.3) + echo(k, 40.0, 28.3)).round() as u16).collect();
//!
//! let mut decomposer = Decomposer::new(&model, &DecomposeSettings::default(), waveform.len())?;
//! let returns = decomposer.decompose(&waveform).returns;
//! for r in returns {
//!     // Two-way travel: half the distance that light covers.
//!     let m_per_sample = 0.5 * 0.299_792_458 * model.sampling_interval_ns;
//!     let (range_m, sd_m) = (m_per_sample * r.position_samples, m_per_sample * r.position_sd_samples);
//!     println!("{range_m:.3} m ± {sd_m:.3} m after the first sample, {:.0} DN", r.amplitude_dn);
//! }
//! assert_eq!(returns.len(), 2);
//! assert!((returns[1].position_samples - returns[0].position_samples - 16.0).abs() < 0.1);
//! # Ok::<(), wavex_signal::sensor_model::ModelError>(())
//! ```
//!
//! Modules, from bottom to top; a module imports only modules of the lines above its own:
//!
//! - [`flags`], [`noise`]: bits of returns, autoregressive noise.
//! - [`sensor_model`]: channels of a sensor, with their system response.
//! - [`whitening`] of samples; [`shape`]: pulses as Gaussians or widened responses.
//! - [`detect`]: matched filter.
//! - [`decompose`]: waveforms to returns, one at a time in `f64` or in batches in `f32`.
//! - [`calibrate`] estimates models; [`outgoing`] fits the outgoing pulses; [`fusion`] combines two
//!   receivers of the same echoes.
//! - [`gain`]: receivers with automatic gain control; [`model_check`]: comparison of a model with a
//!   recording.
//! - [`distributed`]: continuous profiles of targets that are not a few echoes.
//!
//! [`sensor_path`] estimates the sensor position from its beams, and [`false_alarms`] predicts the returns caused by
//! noise. Corrections of returns and the assignment of echoes to shots are in the crate `wavex-returns`.
//!
//! docs/explanation/method.md describes the method. Positions are in samples from the waveform's
//! first, heights in digitiser steps (DN). The position of a pulse is that of its peak.

pub mod calibrate;
mod cholesky;
pub mod decompose;
pub mod detect;
pub mod distributed;
pub mod false_alarms;
pub mod flags;
mod fourier;
pub mod fusion;
pub mod gain;
mod levenberg_marquardt;
pub mod model_check;
pub mod noise;
pub mod outgoing;
mod parallel;
mod pulse_fit;
pub mod sensor_model;
pub mod sensor_path;
pub mod shape;
pub mod whitening;

#[cfg(test)]
mod recordings;
#[doc(hidden)]
pub mod simulated;

//! Numerical kernels: slices in, values out, without files, clocks, batches or stages.
//!
//! - [`calibrate`] and [`response_calibrate`] estimate a [`sensor_model`].
//! - [`decompose`] finds the pulses of one waveform in correlated noise, in `f64`. Pulses are
//!   widened copies of the system response ([`response`], [`templates`]) or Gaussians ([`shape`]).
//!   It uses [`detect`] (matched filter), [`pulse_fit`] (joint least squares), [`whitening`] and
//!   [`noise`].
//! - [`lockstep`] does the same for whole batches, in `f32` and many times faster, and leaves
//!   unsuitable waveforms to [`decompose`].
//! - [`fusion`] combines two receivers of the same echoes; [`outgoing`] fits the outgoing pulses.
//! - [`mta`] assigns echoes to emissions if several pulses are in the air.
//! - [`radiometry`], [`penalised_spline`] and [`width_by_amplitude`] serve the corrections of
//!   returns.
//! - [`outliers`] finds isolated points; [`sensor_path`] estimates the sensor position from its
//!   beams.
//!
//! docs/explanation/method.md describes the method. Positions are in samples from the block's first, heights in
//! digitiser steps (DN). The position of a pulse is that of its peak.

pub mod calibrate;
mod cholesky;
pub mod decompose;
pub mod detect;
pub mod false_alarms;
pub mod flags;
mod fourier;
pub mod fusion;
pub mod gain;
mod levenberg_marquardt;
pub mod mta;
pub mod noise;
pub mod outgoing;
pub mod outliers;
pub mod penalised_spline;
mod pulse_fit;
pub mod radiometry;
pub mod sensor_model;
pub mod sensor_path;
pub mod shape;
pub mod simd;
pub mod whitening;
pub mod width_by_amplitude;

#[cfg(test)]
mod recordings;
#[doc(hidden)]
pub mod simulated;

//! Numbers to numbers: slices in, values out. No file, no clock, no batch, no stage.
//!
//! A sensor model is found by [`calibrate`] and [`response_calibrate`]. [`decompose`] finds the pulses of one waveform in
//! correlated noise, in `f64`: widened copies of the system response ([`response`], [`templates`]), or Gaussians
//! ([`shape`]). Its parts are [`detect`] (matched filter), [`gauss_fit`] (joint least squares), [`whitening`] and [`noise`].
//! [`lockstep`] does the same for whole batches, in `f32` and many times faster, and hands to it what it is not made for.
//! [`mta`] finds the emission that caused an echo, where several pulses are in the air.
//! [`radiometry`], [`penalised_spline`] and [`width_by_amplitude`] serve the corrections of returns, and [`outliers`]
//! finds points that stand alone; [`sensor_path`] finds the sensor where beams meet.
//! docs/method.md describes the method. Positions are in samples from the block's first, heights in digitiser steps
//! (DN), and a pulse stands where its peak stands.

mod allowance;
pub mod calibrate;
mod cholesky;
pub mod decompose;
pub mod detect;
pub mod false_alarms;
pub mod flags;
mod fourier;
pub mod fusion;
pub mod gain;
pub mod gauss_fit;
pub mod lockstep;
pub mod mta;
pub mod noise;
pub mod outgoing;
pub mod outliers;
pub mod penalised_spline;
pub mod radiometry;
pub mod response;
pub mod response_calibrate;
mod rules;
pub mod sensor_model;
pub mod sensor_path;
pub mod shape;
pub(crate) mod steps;
pub mod templates;
pub mod whitening;
mod wide;
pub mod width_by_amplitude;

#[cfg(test)]
mod recordings;
#[cfg(test)]
pub(crate) mod simulated;

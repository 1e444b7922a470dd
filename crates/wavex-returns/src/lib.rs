//! Numbers of returns, without the samples of their waveforms.
//!
//! [`mta`] assigns echoes to shots if several pulses are in the air. [`radiometry`], [`penalised_spline`],
//! [`range_walk`] and [`width_by_amplitude`] serve the corrections of returns. [`outliers`] finds isolated points.

pub mod mta;
pub mod outliers;
pub mod penalised_spline;
pub mod radiometry;
pub mod range_walk;
pub mod width_by_amplitude;

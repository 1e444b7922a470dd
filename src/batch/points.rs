//! The returns found in waveforms.

/// The returns of a line, ordered by emission, then by time.
pub type Returns = Vec<Return>;

/// One return: an echo of one emission.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Return {
    /// Index of the emission, in the batch, that caused it.
    pub emission: u32,
    /// 1 for the first return of its emission.
    pub return_number: u8,
    /// How many returns the emission has, withheld ones included.
    pub number_of_returns: u8,
    /// The receiver that gave the intensity.
    pub channel: ReturnChannel,
    /// Bits of [`flags`].
    pub flags: u16,
    /// Emissions between the causing shot and the reception; -1 where unresolved.
    pub mta_zone: i16,
    /// Echo minus outgoing pulse, both at the peak of the response, ns.
    pub time_of_flight_ns: f64,
    /// Standard deviation of `time_of_flight_ns`, ns.
    pub time_of_flight_sd_ns: f64,
    /// Range along the beam from the emission's origin, m.
    pub range_m: f64,
    /// Standard deviation of `range_m`, m.
    pub range_sd_m: f64,
    /// Standard deviation of the point's place: the square root of the trace of its covariance, m; NaN where unknown, as
    /// before `georeference`.
    pub total_sd_m: f64,
    /// Height of the fitted pulse's peak above the background as recorded, digitiser steps.
    pub amplitude_dn: f64,
    /// Standard deviation of `amplitude_dn`, digitiser steps.
    pub amplitude_sd_dn: f64,
    /// Gain with which `amplitude_dn` was recorded over the reference gain; 1 without automatic gain control.
    pub gain: f64,
    /// Background and height of the peak at gain 1 in the receiver that gives the intensity, digitiser steps: where the
    /// instrument's tables are read.
    pub peak_dn: f64,
    /// Standard deviation of `peak_dn`, digitiser steps.
    pub peak_sd_dn: f64,
    /// Amplitude above the detection limit by the instrument's table, dB; NaN where there is none.
    pub amplitude_db: f64,
    /// Full width at half maximum over that of the system response; 1 for a flat target.
    pub width_ratio: f64,
    /// Standard deviation of `width_ratio`.
    pub width_ratio_sd: f64,
    /// Full width at half maximum, ns.
    pub fwhm_ns: f64,
    /// Full width at half maximum of the target along the beam, m.
    pub thickness_m: f64,
    /// Standard deviation of `thickness_m`, m.
    pub thickness_sd_m: f64,
    /// (chi-square - degrees of freedom) / sqrt(2 degrees of freedom) of the waveform's fit.
    pub deviation_ratio: f64,
    /// Amplitude after all corrections.
    pub intensity: f64,
    /// Standard deviation of `intensity`.
    pub intensity_sd: f64,
    /// Marked as an outlier: kept, and said to be one.
    pub withheld: bool,
    /// LAS class: 0, or 20 for outliers.
    pub class: u8,
}

impl Return {
    /// `amplitude_dn` and its standard deviation at gain 1: what can be compared between shots.
    pub fn amplitude_at_unit_gain_dn(&self) -> (f64, f64) {
        (self.amplitude_dn / self.gain, self.amplitude_sd_dn / self.gain)
    }
}

impl Default for Return {
    /// A first and only return of the sensitive receiver, of which nothing is known.
    fn default() -> Return {
        Return {
            emission: 0,
            return_number: 1,
            number_of_returns: 1,
            channel: ReturnChannel::Low,
            flags: 0,
            mta_zone: 0,
            time_of_flight_ns: f64::NAN,
            time_of_flight_sd_ns: f64::NAN,
            range_m: f64::NAN,
            range_sd_m: f64::NAN,
            total_sd_m: f64::NAN,
            amplitude_dn: f64::NAN,
            amplitude_sd_dn: f64::NAN,
            gain: 1.0,
            peak_dn: f64::NAN,
            peak_sd_dn: f64::NAN,
            amplitude_db: f64::NAN,
            width_ratio: 1.0,
            width_ratio_sd: f64::NAN,
            fwhm_ns: f64::NAN,
            thickness_m: 0.0,
            thickness_sd_m: f64::NAN,
            deviation_ratio: 0.0,
            intensity: f64::NAN,
            intensity_sd: f64::NAN,
            withheld: false,
            class: 0,
        }
    }
}

/// The receiver that gave a return its intensity.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ReturnChannel {
    /// The sensitive receiver.
    Low,
    /// The receiver for strong echoes.
    High,
    /// Fitted in both: heights are those of the sensitive receiver, as if its scale had no end, and the receiver for strong
    /// echoes gives the intensity.
    Joint,
}

impl ReturnChannel {
    /// As tables write it.
    pub fn name(self) -> &'static str {
        match self {
            ReturnChannel::Low => "low",
            ReturnChannel::High => "high",
            ReturnChannel::Joint => "joint",
        }
    }
}

/// Bits of [`Return::flags`]: the low byte is the LAS user data of BayesWavEx 1.1, section 3.
pub mod flags {
    pub use crate::kernels::flags::*;
}

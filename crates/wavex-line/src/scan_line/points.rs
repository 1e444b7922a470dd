//! Returns found in waveforms.

/// Returns of a line, ordered by shot, then by time.
pub type Returns = Vec<Return>;

/// Return: an echo of a shot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Return {
    /// Index of the causing shot in the line.
    pub emission: u32,
    /// Return number, from 1.
    pub return_number: u8,
    /// Number of returns of the shot, withheld ones included.
    pub number_of_returns: u8,
    /// Channel that gave the intensity.
    pub channel: ReturnChannel,
    /// Bits of [`flags`].
    pub flags: u16,
    /// MTA zone; -1 if unresolved.
    ///
    /// The number of emissions between the causing shot and the reception.
    pub mta_zone: i16,
    /// Time from outgoing pulse to echo, ns.
    ///
    /// Between the peaks of the response.
    pub time_of_flight_ns: f64,
    /// Standard deviation of `time_of_flight_ns`, ns.
    pub time_of_flight_sd_ns: f64,
    /// Range along the beam from the shot's origin, m.
    pub range_m: f64,
    /// Standard deviation of `range_m`, m.
    pub range_sd_m: f64,
    /// Total standard deviation of the position.
    ///
    /// Square root of the trace of its covariance, m. NaN if unknown, as before `georeference`.
    pub total_sd_m: f64,
    /// Recorded height of the fitted peak above the background, digitiser steps.
    pub amplitude_dn: f64,
    /// Standard deviation of `amplitude_dn`, digitiser steps.
    pub amplitude_sd_dn: f64,
    /// Gain of `amplitude_dn` relative to the reference gain.
    ///
    /// 1 without automatic gain control.
    pub gain: f64,
    /// Background plus peak height at gain 1, digitiser steps.
    ///
    /// In the channel that gives the intensity. Index into the instrument's tables.
    pub peak_dn: f64,
    /// Standard deviation of `peak_dn`, digitiser steps.
    pub peak_sd_dn: f64,
    /// Amplitude above the detection limit by the instrument's table, dB.
    ///
    /// NaN without table.
    pub amplitude_db: f64,
    /// Full width at half maximum relative to the system response.
    ///
    /// 1 for a flat target.
    pub width_ratio: f64,
    /// Standard deviation of `width_ratio`.
    pub width_ratio_sd: f64,
    /// Full width at half maximum, ns.
    pub fwhm_ns: f64,
    /// Target FWHM along the beam, m.
    pub thickness_m: f64,
    /// Standard deviation of `thickness_m`, m.
    pub thickness_sd_m: f64,
    /// Deviation ratio of the fit.
    ///
    /// (chi-square - degrees of freedom) / sqrt(2 degrees of freedom).
    pub deviation_ratio: f64,
    /// Amplitude after all corrections.
    pub intensity: f64,
    /// Standard deviation of `intensity`.
    pub intensity_sd: f64,
    /// Whether the return is marked as an outlier.
    ///
    /// It is kept.
    pub withheld: bool,
    /// LAS class: 0; of outliers 7 (low) or 18 (high).
    pub class: u8,
    /// Height above the ground, m.
    ///
    /// NaN if unknown, as before `classify`.
    pub height_above_ground_m: f32,
}

impl Return {
    /// Returns `amplitude_dn` and its standard deviation at gain 1.
    ///
    /// Comparable between shots, digitiser steps.
    pub fn amplitude_at_unit_gain_dn(&self) -> (f64, f64) {
        (self.amplitude_dn / self.gain, self.amplitude_sd_dn / self.gain)
    }
}

impl Default for Return {
    /// First and only low-power return, with unknown quantities.
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
            height_above_ground_m: f32::NAN,
        }
    }
}

/// Channel that gave a return its intensity.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ReturnChannel {
    /// Low-power channel.
    Low,
    /// High-power channel.
    High,
    /// Fitted in both channels.
    ///
    /// Heights are on the unlimited scale of the low-power channel; the high-power channel gives
    /// the intensity.
    Joint,
}

impl ReturnChannel {
    /// Returns the name used in tables.
    pub fn name(self) -> &'static str {
        match self {
            ReturnChannel::Low => "low",
            ReturnChannel::High => "high",
            ReturnChannel::Joint => "joint",
        }
    }
}

/// Bits of [`Return::flags`].
///
/// The low byte is the LAS user data of BayesWavEx 1.1, section 3.
pub mod flags {
    pub use wavex_signal::flags::*;
}

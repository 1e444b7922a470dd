//! Echoes: fitted pulses before they become returns of their shot.

use super::shot::{BLINDED, EmissionTime};
use wavex_line::scan_line::{AmplitudeTable, InputInfo, Return, ReturnChannel};
use wavex_returns::radiometry::target_thickness_m;
use wavex_signal::decompose::Return as Pulse;
use wavex_signal::sensor_model::ChannelModel;

/// Standard deviation of an unreliable range, m.
///
/// The maximum of the LAS attribute `RangeErr`.
pub(super) const UNRELIABLE_RANGE_SD_M: f64 = 0.255;

/// A return before its range is known.
#[derive(Clone, Copy)]
pub(super) struct FoundEcho {
    /// Time of the echo's peak after the shot's clock.
    pub(super) time_ns: f64,
    pub(super) time_sd_ns: f64,
    pub(super) channel: ReturnChannel,
    /// Index of the block in its shot.
    pub(super) block: usize,
    pub(super) zone: i16,
    /// Background at gain 1.
    pub(super) background_dn: f64,
    /// Gain of the recorded pulse.
    pub(super) gain: f64,
    /// Values of the high-power receiver, if both were fitted together.
    pub(super) high_power: Option<HighPowerView>,
    pub(super) fitted: Pulse,
    /// Flag bits besides the flags of the fit.
    pub(super) flags: u16,
}

/// Values of a joint return in the high-power receiver.
#[derive(Clone, Copy)]
pub(super) struct HighPowerView {
    /// Recorded height in the low-power receiver over the high-power height at gain 1.
    pub(super) gain_ratio: f64,
    /// Background of the high-power receiver at gain 1.
    pub(super) background_dn: f64,
}

impl FoundEcho {
    /// Adds the standard deviations of overdriven and clipped pulses.
    ///
    /// In fused receivers, the time of the low-power one has the error of its walk instead.
    pub(super) fn add_overdrive_sd(&mut self, model: &ChannelModel, is_fused: bool) {
        if self.fitted.flags & BLINDED == 0 {
            return;
        }
        let (time_ns, relative_height) = model.overdrive_errors();
        let is_of_walk = is_fused && self.channel == ReturnChannel::Low;
        self.add_sd((if is_of_walk { 0.0 } else { time_ns }, relative_height));
    }

    /// Adds standard deviations of time, ns, and of the height relative to it.
    pub(super) fn add_sd(&mut self, (time_ns, relative_height): (f64, f64)) {
        let fitted = &mut self.fitted;
        fitted.amplitude_sd_dn = fitted.amplitude_sd_dn.hypot(relative_height * fitted.amplitude_dn);
        self.time_sd_ns = self.time_sd_ns.hypot(time_ns);
    }

    pub(super) fn into_return(
        self,
        departure: EmissionTime,
        timing_error_ns: f64,
        input: &InputInfo,
    ) -> Return {
        let half_speed_m_per_ns = input.group_velocity_mps * 0.5e-9;
        let fitted = self.fitted;
        let time_of_flight_ns = self.time_ns - departure.time_ns;
        let time_of_flight_sd_ns =
            (self.time_sd_ns.powi(2) + departure.sd_ns.powi(2) + timing_error_ns.powi(2)).sqrt();
        let (ratio, ratio_sd) = (fitted.width_ratio, fitted.width_ratio_sd);
        let (thickness_m, thickness_sd_m) =
            target_thickness_m(half_speed_m_per_ns, fitted.fwhm_ns / ratio, ratio, ratio_sd);
        let (peak_dn, peak_sd_dn) = self.peak();
        let table = match self.channel {
            ReturnChannel::High | ReturnChannel::Joint => &input.amplitude_high,
            ReturnChannel::Low => &input.amplitude_low,
        };
        let (amplitude_db, intensity, intensity_sd) = self.intensity(table.as_ref());
        Return {
            emission: 0,
            return_number: 0,
            number_of_returns: 0,
            channel: self.channel,
            flags: fitted.flags | self.flags | departure.flags,
            mta_zone: self.zone,
            time_of_flight_ns,
            time_of_flight_sd_ns,
            range_m: half_speed_m_per_ns * time_of_flight_ns,
            range_sd_m: half_speed_m_per_ns * time_of_flight_sd_ns,
            total_sd_m: f64::NAN,
            amplitude_dn: fitted.amplitude_dn,
            amplitude_sd_dn: fitted.amplitude_sd_dn,
            gain: self.gain,
            peak_dn,
            peak_sd_dn,
            amplitude_db,
            width_ratio: fitted.width_ratio,
            width_ratio_sd: fitted.width_ratio_sd,
            fwhm_ns: fitted.fwhm_ns,
            thickness_m,
            thickness_sd_m,
            deviation_ratio: fitted.deviation_ratio,
            intensity,
            intensity_sd,
            withheld: false,
            class: 0,
            height_above_ground_m: f32::NAN,
        }
    }

    /// Background plus peak height at gain 1 and its standard deviation, DN.
    ///
    /// In the receiver that gives the intensity. Index into the instrument's tables.
    fn peak(&self) -> (f64, f64) {
        let (amplitude, sd) = (self.fitted.amplitude_dn, self.fitted.amplitude_sd_dn);
        match self.high_power {
            Some(high) => (high.background_dn + amplitude / high.gain_ratio, sd / high.gain_ratio),
            None => (self.background_dn + amplitude / self.gain, sd / self.gain),
        }
    }

    /// Amplitude in dB, intensity, and standard deviation of the intensity.
    ///
    /// dB from the instrument's table; NaN without one.
    fn intensity(&self, table: Option<&AmplitudeTable>) -> (f64, f64, f64) {
        let (peak_dn, peak_sd_dn) = self.peak();
        match table.map(|table| table.amplitude(peak_dn, peak_sd_dn)) {
            Some(amplitude) => (amplitude.db, amplitude.linear, amplitude.linear_sd),
            None => {
                let fitted = &self.fitted;
                (f64::NAN, fitted.amplitude_dn / self.gain, fitted.amplitude_sd_dn / self.gain)
            }
        }
    }
}

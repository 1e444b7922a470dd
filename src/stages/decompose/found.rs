//! A pulse of a block as a return of its shot.

use super::shots::Departure;
use crate::batch::{AmplitudeTable, InputInfo, Return, ReturnChannel, flags};
use crate::kernels::decompose::Return as Pulse;

/// Standard deviation of a range that cannot be relied upon, m: the largest that the LAS attribute `RangeErr` can hold.
const UNRELIABLE_RANGE_SD_M: f64 = 0.255;

/// A return before its range is known.
#[derive(Clone, Copy)]
pub(super) struct Found {
    /// Peak of the echo after the shot's clock.
    pub(super) time_ns: f64,
    pub(super) time_sd_ns: f64,
    pub(super) channel: ReturnChannel,
    /// The block among those of its shot.
    pub(super) block: usize,
    pub(super) zone: i16,
    pub(super) background_dn: f64,
    /// How it stands in the receiver for strong echoes, where both were fitted together.
    pub(super) high_power: Option<InHighPower>,
    pub(super) fitted: Pulse,
    /// Bits beside those of the fit.
    pub(super) flags: u16,
}

/// What a joint return is in the receiver for strong echoes.
#[derive(Clone, Copy)]
pub(super) struct InHighPower {
    /// Height in the sensitive receiver over that in the other.
    pub(super) gain_ratio: f64,
    /// The other's background.
    pub(super) background_dn: f64,
}

impl Found {
    pub(super) fn into_return(self, departure: Departure, timing_error_ns: f64, input: &InputInfo) -> Return {
        let half_speed_m_per_ns = input.group_velocity_mps * 0.5e-9;
        let fitted = self.fitted;
        let time_of_flight_ns = self.time_ns - departure.time_ns;
        let known_sd_ns =
            (self.time_sd_ns.powi(2) + departure.sd_ns.powi(2) + timing_error_ns.powi(2)).sqrt();
        // Nothing tells by how much an echo on the outgoing pulse moves it.
        let unreliable = departure.flags & flags::ECHO_ON_OUTGOING != 0;
        let least_sd_ns = if unreliable { UNRELIABLE_RANGE_SD_M / half_speed_m_per_ns } else { 0.0 };
        let time_of_flight_sd_ns = known_sd_ns.max(least_sd_ns);
        let (thickness_m, thickness_sd_m) = self.thickness(half_speed_m_per_ns);
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
        }
    }

    /// Full width at half maximum of the target along the beam, m, and its standard deviation.
    ///
    /// With `d = fwhm² − fwhm0²` and `σ_d` its standard deviation, `T = v/2 √max(d, 0)` and
    /// `σ_T = v/2 σ_d / (2 √max(d, σ_d))`, which stays finite for a flat target (docs/method.md, Uncertainties).
    fn thickness(&self, half_speed_m_per_ns: f64) -> (f64, f64) {
        let (ratio, ratio_sd) = (self.fitted.width_ratio, self.fitted.width_ratio_sd);
        let calibrated = self.fitted.fwhm_ns / ratio;
        let widening = calibrated.powi(2) * (ratio.powi(2) - 1.0);
        let widening_sd = calibrated.powi(2) * 2.0 * ratio * ratio_sd;
        let sd = widening_sd / (2.0 * widening.max(widening_sd).sqrt());
        (half_speed_m_per_ns * widening.max(0.0).sqrt(), half_speed_m_per_ns * sd)
    }

    /// Decibels by the instrument's table (NaN without one), the intensity, and its standard deviation.
    fn intensity(&self, table: Option<&AmplitudeTable>) -> (f64, f64, f64) {
        let (amplitude, sd) = (self.fitted.amplitude_dn, self.fitted.amplitude_sd_dn);
        let Some(table) = table else { return (f64::NAN, amplitude, sd) };
        let (amplitude, sd, background_dn) = match self.high_power {
            Some(high) => (amplitude / high.gain_ratio, sd / high.gain_ratio, high.background_dn),
            None => (amplitude, sd, self.background_dn),
        };
        let linear = |dn: f64| 7.0 * 10f64.powf(table.at(dn) / 10.0);
        let dn = background_dn + amplitude;
        // The table's slope around the peak: a central difference over two steps.
        let slope = (linear(dn + 1.0) - linear(dn - 1.0)) / 2.0;
        (table.at(dn), linear(dn), slope.abs() * sd)
    }
}

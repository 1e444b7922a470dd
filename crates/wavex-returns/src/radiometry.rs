//! Target properties from the amplitude and width of a return.
//!
//! See docs/explanation/corrections.md and docs/reference/returns.md.

/// Full width at half maximum of a target along the beam, m, and its standard deviation.
///
/// `fwhm_ns` is the calibrated width of a pulse, `ratio` the return's width over it. With `d =
/// fwhm² (ratio² - 1)` and `σ_d` its standard deviation, `T = v/2 √max(d, 0)` and `σ_T = v/2 σ_d /
/// (2 √max(d, σ_d))`, which stays finite for a flat target.
pub fn target_thickness_m(half_speed_m_per_ns: f64, fwhm_ns: f64, ratio: f64, ratio_sd: f64) -> (f64, f64) {
    let widening = fwhm_ns.powi(2) * (ratio.powi(2) - 1.0);
    let widening_sd = fwhm_ns.powi(2) * 2.0 * ratio * ratio_sd;
    let sd = widening_sd / (2.0 * widening.max(widening_sd).sqrt());
    (half_speed_m_per_ns * widening.max(0.0).sqrt(), half_speed_m_per_ns * sd)
}

/// Smallest cosine of incidence; more grazing beams use this value.
pub const LEAST_COS_INCIDENCE: f64 = 0.2;

/// Factor from amplitude to intensity.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct RangeAndAir {
    /// Range at which the factor is 1, m; `None` for no dependence on range.
    pub reference_range_m: Option<f64>,
    /// One-way atmospheric attenuation, dB/km.
    pub attenuation_db_per_km: Option<f64>,
}

impl RangeAndAir {
    /// Factor at a range, m, and its derivative, 1/m.
    ///
    /// `(R/r0)² · 10^(2 a (R - r0) / 10⁴)`. Without a reference range the attenuation counts from
    /// the sensor.
    pub fn factor(&self, range_m: f64) -> (f64, f64) {
        let range_m = range_m.max(0.0);
        let (spread, slope) = match self.reference_range_m {
            Some(reference_m) => ((range_m / reference_m).powi(2), 2.0 * range_m / reference_m.powi(2)),
            None => (1.0, 0.0),
        };
        let Some(attenuation) = self.attenuation_db_per_km else { return (spread, slope) };
        let per_m = 2.0 * attenuation * std::f64::consts::LN_10 / 1e4;
        let air = (per_m * (range_m - self.reference_range_m.unwrap_or(0.0))).exp();
        (spread * air, (slope + spread * per_m) * air)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_flat_target_is_thin_and_its_thickness_uncertain() {
        let (thickness_m, sd_m) = target_thickness_m(0.15, 4.5, 1.0, 0.01);
        assert_eq!(thickness_m, 0.0);
        assert!((sd_m - 0.15 * 0.5 * (2.0 * 4.5f64.powi(2) * 0.01).sqrt()).abs() < 1e-12);
        let (thickness_m, sd_m) = target_thickness_m(0.15, 4.0, 1.25, 0.01);
        assert!((thickness_m - 0.15 * 3.0).abs() < 1e-12);
        assert!((sd_m - 0.15 * 16.0 * 2.0 * 1.25 * 0.01 / 6.0).abs() < 1e-12);
    }

    #[test]
    fn range_and_air_have_their_closed_forms() {
        let both = RangeAndAir { reference_range_m: Some(1000.0), attenuation_db_per_km: Some(0.2) };
        assert_eq!(both.factor(1000.0).0, 1.0);
        // 500 m farther, two-way: 0.2 dB.
        assert!((both.factor(1500.0).0 - 2.25 * 10f64.powf(0.02)).abs() < 1e-12);
        let air = RangeAndAir { reference_range_m: None, attenuation_db_per_km: Some(0.5) };
        assert!((air.factor(2000.0).0 - 10f64.powf(0.2)).abs() < 1e-12);
        assert_eq!(RangeAndAir::default().factor(777.0), (1.0, 0.0));
        for correction in [both, air] {
            let (_, slope) = correction.factor(1200.0);
            let difference = (correction.factor(1200.5).0 - correction.factor(1199.5).0) / 1.0;
            assert!((slope - difference).abs() < 1e-8, "{slope} {difference}");
        }
        assert!(both.factor(-5.0).0.abs() < 1e-12, "nothing is nearer than the sensor");
    }
}

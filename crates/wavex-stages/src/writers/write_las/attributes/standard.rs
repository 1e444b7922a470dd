//! Attributes of the standard layout.
//!
//! Amplitude, reflectance, pulse width and deviation have the names of RIEGL's exports; the first
//! two also their type, scale and limits.

use wavex_formats::las::{DataType, ExtraAttribute};

use super::{Fill, ReturnAttribute, each, mta_zone, receivers, reflectance_db};
use DataType::{F32, I16, I32, U8, U16, U32};

/// Attributes of the standard layout, in order.
///
/// The reflectance is relative, because the response of a white target is unknown. The total
/// uncertainty is the square root of the trace of the covariance of the point.
#[rustfmt::skip]
pub(super) const ATTRIBUTES: [ReturnAttribute; 16] = [
    measured("Amplitude", "Echo signal amplitude [dB]", U16, Some(0.01), (0.0, 10_000.0), each!(|r| r.amplitude_db)),
    measured("Reflectance", "Relative reflectance [dB]", I16, Some(0.01), (-5_000.0, 15_000.0), each!(reflectance_db)),
    measured("Pulse width", "Full width at half maximum [ns]", U16, Some(0.01), LIMITS_U16, each!(|r| r.fwhm_ns)),
    measured("Deviation", "Deviation ratio of the fit", I16, Some(0.1), LIMITS_I16, each!(|r| r.deviation_ratio)),
    measured("Raw amplitude", "Pulse height [digitiser steps]", U32, Some(0.01), LIMITS_U32, each!(|r| r.amplitude_dn)),
    measured("Width ratio", "Pulse width / system response", U16, Some(0.001), LIMITS_U16, each!(|r| r.width_ratio)),
    measured("Target thickness", "Extent along the beam [m]", U16, Some(0.001), LIMITS_U16, each!(|r| r.thickness_m)),
    deviation("Range SD", "SD of the range [m]", each!(|r| r.range_sd_m)),
    deviation("Amplitude SD", "SD of raw amplitude [steps]", each!(|r| r.amplitude_sd_dn)),
    deviation("Width SD", "SD of the pulse width [ns]", each!(|r| r.width_ratio_sd * (r.fwhm_ns / r.width_ratio))),
    deviation("Thickness SD", "SD of the target thickness [m]", each!(|r| r.thickness_sd_m)),
    deviation("Intensity SD", "SD of the intensity", each!(|r| r.intensity_sd)),
    deviation("Total uncertainty", "SD of the position [m]", each!(|r| r.total_sd_m)),
    code("Channel", "0 low power, 1 high, 2 both", U8, Some((0.0, 2.0)), each!(receivers)),
    measured("MTA zone", "Emissions before reception", U8, None, (0.0, 254.0), each!(mta_zone)),
    code("Quality flags", "Flags of the fit", U16, None, each!(|r| f64::from(r.flags))),
];

/// Height above the ground of `classify`: of the layout only if it is known or named.
pub(in crate::writers::write_las) const HEIGHT_ABOVE_GROUND: ReturnAttribute = measured(
    "Height above ground",
    "Height above ground [m]",
    I32,
    Some(0.001),
    (-1e8, 1e8),
    each!(|r| f64::from(r.height_above_ground_m)),
);

/// Largest ranges of stored numbers without the no-data value.
const LIMITS_U16: (f64, f64) = (0.0, 65_534.0);
const LIMITS_I16: (f64, f64) = (-32_767.0, 32_767.0);
const LIMITS_U32: (f64, f64) = (0.0, 4_294_967_294.0);
/// Largest standard deviation, a number with 8 significant bits.
const LARGEST_SD: f64 = (1u64 << 40) as f64;

/// Measured quantity, with a no-data value outside its limits.
const fn measured(
    name: &'static str,
    description: &'static str,
    data_type: DataType,
    scale: Option<f64>,
    limits: (f64, f64),
    fill: Fill,
) -> ReturnAttribute {
    let nan = match data_type {
        U8 => u8::MAX as i64,
        U16 => u16::MAX as i64,
        U32 => u32::MAX as i64,
        I16 => i16::MIN as i64,
        I32 => i32::MIN as i64,
        _ => 0,
    };
    let (offset, nan_is_no_data, limits) = (None, true, Some(limits));
    let stored = ExtraAttribute { name, description, data_type, scale, offset, nan, nan_is_no_data, limits };
    ReturnAttribute { stored, is_uncertainty: false, fill }
}

/// Standard deviation, at least 0; NaN where unknown.
const fn deviation(name: &'static str, description: &'static str, fill: Fill) -> ReturnAttribute {
    let attribute = measured(name, description, F32, None, (0.0, LARGEST_SD), fill);
    ReturnAttribute { is_uncertainty: true, ..attribute }
}

/// Whole number that every return has.
const fn code(
    name: &'static str,
    description: &'static str,
    data_type: DataType,
    limits: Option<(f64, f64)>,
    fill: Fill,
) -> ReturnAttribute {
    let attribute = measured(name, description, data_type, None, (0.0, 0.0), fill);
    let stored = ExtraAttribute { nan: 0, nan_is_no_data: false, limits, ..attribute.stored };
    ReturnAttribute { stored, ..attribute }
}

#[cfg(test)]
mod tests {
    use super::*;
    use wavex_formats::las::quantise;

    fn named(name: &str) -> ExtraAttribute {
        ATTRIBUTES.iter().find(|attribute| attribute.stored.name == name).unwrap().stored
    }

    #[test]
    fn no_data_values_are_outside_the_limits() {
        for ReturnAttribute { stored, .. } in ATTRIBUTES.into_iter().chain([HEIGHT_ABOVE_GROUND]) {
            assert!(stored.name.len() < 32 && stored.description.len() < 32, "{}", stored.name);
            let is_outside = |(least, largest): (f64, f64)| !(least..=largest).contains(&(stored.nan as f64));
            let no_data = stored.nan_is_no_data && stored.data_type != F32;
            assert!(!no_data || stored.limits.is_some_and(is_outside), "{}", stored.name);
        }
    }

    #[test]
    fn values_are_clamped_to_their_limits() {
        let (amplitude, reflectance) = (named("Amplitude"), named("Reflectance"));
        assert_eq!(quantise(23.456, &amplitude), 2346);
        assert_eq!(quantise(1e9, &amplitude), 10_000);
        assert_eq!(quantise(f64::NAN, &amplitude), 65_535);
        assert_eq!(quantise(-1e9, &reflectance), -5000);
        assert_eq!(quantise(f64::NAN, &reflectance), -32_768);
        assert_eq!(quantise(1e9, &named("MTA zone")), 254);
        assert_eq!(quantise(-1.2344, &HEIGHT_ABOVE_GROUND.stored), -1234);
        assert_eq!(quantise(f64::NAN, &HEIGHT_ABOVE_GROUND.stored), i64::from(i32::MIN));
        assert_eq!(quantise(f64::NAN, &named("Raw amplitude")), i64::from(u32::MAX));
        let sd = |value: f64| f32::from_bits(quantise(value, &named("Range SD")) as u32);
        assert_eq!((sd(0.0), sd(-1.0), sd(0.5)), (0.0, 0.0, 0.5));
        assert!(sd(f64::NAN).is_nan() && sd(f64::INFINITY).is_finite());
    }
}

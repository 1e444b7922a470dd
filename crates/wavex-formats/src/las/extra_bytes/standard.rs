//! Attributes of the standard layout.
//!
//! Amplitude, reflectance, pulse width and deviation have the names of RIEGL's exports; the first
//! two also their type, scale and limits.

use super::{DataType, ExtraAttribute};

/// Attribute of the standard layout; the stored integer `nan` is its no-data value.
const fn scaled(
    name: &'static str,
    description: &'static str,
    data_type: DataType,
    scale: f64,
    limits: (f64, f64),
    nan: i64,
) -> ExtraAttribute {
    ExtraAttribute {
        name,
        description,
        data_type,
        scale: Some(scale),
        offset: None,
        nan,
        nan_is_no_data: true,
        limits: Some(limits),
    }
}

/// Standard deviation, at least 0; NaN where unknown.
const fn deviation(name: &'static str, description: &'static str) -> ExtraAttribute {
    let limits = Some((0.0, LARGEST_SD));
    ExtraAttribute { scale: None, limits, ..scaled(name, description, DataType::F32, 1.0, (0.0, 0.0), 0) }
}

/// Largest standard deviation, a number with 8 significant bits.
const LARGEST_SD: f64 = (1u64 << 40) as f64;
/// No-data value of unsigned 16-bit attributes.
const NO_DATA_U16: i64 = u16::MAX as i64;
/// Limits of unsigned 16-bit attributes with a no-data value.
const LIMITS_U16: (f64, f64) = (0.0, 65_534.0);

/// Echo amplitude above the detection limit, dB.
pub const AMPLITUDE: ExtraAttribute =
    scaled("Amplitude", "Echo signal amplitude [dB]", DataType::U16, 0.01, (0.0, 10_000.0), NO_DATA_U16);
/// Corrected amplitude, dB; relative, because the response of a white target is unknown.
pub const REFLECTANCE: ExtraAttribute = scaled(
    "Reflectance",
    "Relative reflectance [dB]",
    DataType::I16,
    0.01,
    (-5_000.0, 15_000.0),
    i16::MIN as i64,
);
/// Full width at half maximum, ns.
pub const PULSE_WIDTH: ExtraAttribute =
    scaled("Pulse width", "Full width at half maximum [ns]", DataType::U16, 0.01, LIMITS_U16, NO_DATA_U16);
/// Deviation ratio of the fit.
pub const DEVIATION: ExtraAttribute = scaled(
    "Deviation",
    "Deviation ratio of the fit",
    DataType::I16,
    0.1,
    (-32_767.0, 32_767.0),
    i16::MIN as i64,
);
/// Height of the fitted pulse, digitiser steps.
pub const RAW_AMPLITUDE: ExtraAttribute = scaled(
    "Raw amplitude",
    "Pulse height [digitiser steps]",
    DataType::U32,
    0.01,
    (0.0, 4_294_967_294.0),
    u32::MAX as i64,
);
/// Full width at half maximum (FWHM) over the FWHM of the system response.
pub const WIDTH_RATIO: ExtraAttribute =
    scaled("Width ratio", "Pulse width / system response", DataType::U16, 0.001, LIMITS_U16, NO_DATA_U16);
/// Extent of the target along the beam, m.
pub const TARGET_THICKNESS: ExtraAttribute =
    scaled("Target thickness", "Extent along the beam [m]", DataType::U16, 0.001, LIMITS_U16, NO_DATA_U16);
/// Standard deviation of the range, m.
pub const RANGE_SD: ExtraAttribute = deviation("Range SD", "SD of the range [m]");
/// Standard deviation of [`RAW_AMPLITUDE`], digitiser steps.
pub const AMPLITUDE_SD: ExtraAttribute = deviation("Amplitude SD", "SD of raw amplitude [steps]");
/// Standard deviation of [`PULSE_WIDTH`], ns.
pub const WIDTH_SD: ExtraAttribute = deviation("Width SD", "SD of the pulse width [ns]");
/// Standard deviation of [`TARGET_THICKNESS`], m.
pub const THICKNESS_SD: ExtraAttribute = deviation("Thickness SD", "SD of the target thickness [m]");
/// Standard deviation of the intensity of the point.
pub const INTENSITY_SD: ExtraAttribute = deviation("Intensity SD", "SD of the intensity");
/// Square root of the trace of the covariance of the point, m.
pub const TOTAL_UNCERTAINTY: ExtraAttribute = deviation("Total uncertainty", "SD of the position [m]");
/// Receivers of the return: 0 low power, 1 high power, 2 both.
pub const RECEIVERS: ExtraAttribute = ExtraAttribute {
    scale: None,
    nan_is_no_data: false,
    ..scaled("Channel", "0 low power, 1 high, 2 both", DataType::U8, 1.0, (0.0, 2.0), 0)
};
/// Emissions between the shot and the reception of its echo.
pub const MTA_ZONE: ExtraAttribute = ExtraAttribute {
    scale: None,
    ..scaled("MTA zone", "Emissions before reception", DataType::U8, 1.0, (0.0, 254.0), 255)
};
/// Flags of the fit and of the return.
pub const QUALITY_FLAGS: ExtraAttribute = ExtraAttribute {
    scale: None,
    nan_is_no_data: false,
    limits: None,
    ..scaled("Quality flags", "Flags of the fit", DataType::U16, 1.0, (0.0, 0.0), 0)
};

/// Attributes of the standard layout, in order.
pub const ATTRIBUTES_STANDARD: [ExtraAttribute; 16] = [
    AMPLITUDE,
    REFLECTANCE,
    PULSE_WIDTH,
    DEVIATION,
    RAW_AMPLITUDE,
    WIDTH_RATIO,
    TARGET_THICKNESS,
    RANGE_SD,
    AMPLITUDE_SD,
    WIDTH_SD,
    THICKNESS_SD,
    INTENSITY_SD,
    TOTAL_UNCERTAINTY,
    RECEIVERS,
    MTA_ZONE,
    QUALITY_FLAGS,
];

//! Attributes of the layouts 1.0 and 1.1 (BayesWavEx 1.0, section 2; BayesWavEx 1.1, section 3).

use wavex_formats::las::{DataType, ExtraAttribute};

use super::{Fill, ReturnAttribute, each, linear_amplitudes, power_channel};

/// Attribute of which NaN is stored as 0.
const fn measured(
    name: &'static str,
    description: &'static str,
    data_type: DataType,
    scale: Option<f64>,
    offset: Option<f64>,
    fill: Fill,
) -> ReturnAttribute {
    let (nan, nan_is_no_data, limits) = (0, false, None);
    let stored = ExtraAttribute { name, description, data_type, scale, offset, nan, nan_is_no_data, limits };
    ReturnAttribute { stored, is_uncertainty: false, fill }
}

/// Standard deviation, of which NaN is stored as the largest value: unreliable.
const fn deviation(name: &'static str, description: &'static str, scale: f64, fill: Fill) -> ReturnAttribute {
    let attribute = measured(name, description, DataType::U8, Some(scale), Some(0.0), fill);
    let stored = ExtraAttribute { nan: u8::MAX as i64, ..attribute.stored };
    ReturnAttribute { stored, is_uncertainty: true, ..attribute }
}

/// Renames an attribute.
const fn named(name: &'static str, attribute: ReturnAttribute) -> ReturnAttribute {
    ReturnAttribute { stored: ExtraAttribute { name, ..attribute.stored }, ..attribute }
}

/// Changes the scale and offset of an attribute.
const fn stepped(scale: f64, offset: f64, attribute: ReturnAttribute) -> ReturnAttribute {
    let stored = ExtraAttribute { scale: Some(scale), offset: Some(offset), ..attribute.stored };
    ReturnAttribute { stored, ..attribute }
}

/// Width of the return relative to the system response.
const WIDE_RATIO: ReturnAttribute = measured(
    "WideRatio",
    "Pulse widening ratio",
    DataType::U8,
    Some(0.025),
    Some(0.5),
    each!(|r| r.width_ratio),
);
/// Extent of the target along the beam, m.
const TARGET_THICK: ReturnAttribute = measured(
    "TargetThick",
    "Target thickness (m)",
    DataType::U8,
    Some(0.008),
    Some(0.0),
    each!(|r| r.thickness_m),
);
/// Linear amplitude of the target; the column is accurate enough for rounding to whole numbers.
const AMP: ReturnAttribute =
    measured("Amp", "Target amplitude", DataType::U16, Some(1.0), Some(0.0), linear_amplitudes);
/// Deviation ratio: residuals beyond the noise, in SDs of chi-square.
///
/// Negative values clamp at 0.
const DEV_RATIO: ReturnAttribute = measured(
    "DevRatio",
    "Residual against noise (sigma)",
    DataType::U8,
    Some(0.1),
    Some(0.0),
    each!(|r| r.deviation_ratio),
);
/// Standard deviation of the range, m.
const RANGE_ERR: ReturnAttribute =
    deviation("RangeErr", "Range std. dev. (m)", 0.001, each!(|r| r.range_sd_m));
/// Standard deviation of the corrected intensity.
const INT_ERR: ReturnAttribute =
    deviation("IntErr", "Corrected intensity std. dev.", 0.2, each!(|r| r.intensity_sd));
/// Standard deviation of the widening ratio.
const WIDE_ERR: ReturnAttribute =
    deviation("WideErr", "Pulse widening std. dev.", 0.002, each!(|r| r.width_ratio_sd));
/// Standard deviation of the target thickness, m.
const THICK_ERR: ReturnAttribute =
    deviation("ThickErr", "Target thickness std. dev. (m)", 0.001, each!(|r| r.thickness_sd_m));
/// Channel that gave the intensity: 0 low power, 1 high power.
const CHANNEL: ReturnAttribute = measured(
    "Channel",
    "Power channel (0 low, 1 high)",
    DataType::U8,
    None,
    None,
    each!(|r| f64::from(power_channel(r))),
);
/// Height of the fitted pulse, digitiser steps (BayesWavEx 1.0, section 2).
pub(crate) const RAW_AMP: ReturnAttribute =
    measured("RawAmp", "Raw pulse amplitude", DataType::U16, Some(1.0), Some(0.0), each!(|r| r.amplitude_dn));

/// Attributes of layout 1.1, in order.
pub(crate) const ATTRIBUTES_1_1: [ReturnAttribute; 9] =
    [WIDE_RATIO, TARGET_THICK, AMP, DEV_RATIO, RANGE_ERR, INT_ERR, WIDE_ERR, THICK_ERR, CHANNEL];

/// Attributes of layout 1.0, in order.
///
/// Names differ from layout 1.1, and so do the steps of widening and deviation ratio.
pub(super) const ATTRIBUTES_1_0: [ReturnAttribute; 9] = [
    named("Widening", stepped(0.02, 1.0, WIDE_RATIO)),
    named("Target Thickness", TARGET_THICK),
    named("Amplitude", AMP),
    named("Raw Amplitude", RAW_AMP),
    named("Deviation Ratio", stepped(0.05, 0.0, DEV_RATIO)),
    named("Range Error", RANGE_ERR),
    named("Intensity Error", INT_ERR),
    named("Widening Error", WIDE_ERR),
    named("Thickness Error", THICK_ERR),
];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn layout_1_1_has_the_names_steps_and_types_of_its_manual() {
        let table = [
            ("WideRatio", Some(0.025), Some(0.5), 1),
            ("TargetThick", Some(0.008), Some(0.0), 1),
            ("Amp", Some(1.0), Some(0.0), 2),
            ("DevRatio", Some(0.1), Some(0.0), 1),
            ("RangeErr", Some(0.001), Some(0.0), 1),
            ("IntErr", Some(0.2), Some(0.0), 1),
            ("WideErr", Some(0.002), Some(0.0), 1),
            ("ThickErr", Some(0.001), Some(0.0), 1),
            ("Channel", None, None, 1),
        ];
        assert_eq!(ATTRIBUTES_1_1.map(description), table);
    }

    #[test]
    fn layout_1_0_has_the_names_steps_and_types_of_its_manual() {
        let table = [
            ("Widening", Some(0.02), Some(1.0), 1),
            ("Target Thickness", Some(0.008), Some(0.0), 1),
            ("Amplitude", Some(1.0), Some(0.0), 2),
            ("Raw Amplitude", Some(1.0), Some(0.0), 2),
            ("Deviation Ratio", Some(0.05), Some(0.0), 1),
            ("Range Error", Some(0.001), Some(0.0), 1),
            ("Intensity Error", Some(0.2), Some(0.0), 1),
            ("Widening Error", Some(0.002), Some(0.0), 1),
            ("Thickness Error", Some(0.001), Some(0.0), 1),
        ];
        assert_eq!(ATTRIBUTES_1_0.map(description), table);
    }

    /// Name, scale, offset and length of an attribute.
    fn description(attribute: ReturnAttribute) -> (&'static str, Option<f64>, Option<f64>, usize) {
        let ExtraAttribute { name, scale, offset, data_type, .. } = attribute.stored;
        (name, scale, offset, data_type.bytes())
    }

    #[test]
    fn names_fit_and_types_are_unsigned() {
        for ReturnAttribute { stored, .. } in ATTRIBUTES_1_1.iter().chain(&ATTRIBUTES_1_0) {
            assert!(stored.name.len() < 32 && stored.description.len() < 32);
            assert!(matches!(stored.data_type, DataType::U8 | DataType::U16), "{}", stored.name);
        }
    }
}

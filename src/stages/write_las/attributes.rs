//! What a point holds of its return: the attributes, the class and the user data of both layouts.

use crate::batch::{Return, ReturnChannel, flags};
use crate::formats::las::{ATTRIBUTES_1_0, ATTRIBUTES_1_1, ExtraAttribute, RAW_AMP};

use super::AttributeLayout;

/// What an extra attribute tells of a return.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Quantity {
    WidthRatio,
    Thickness,
    LinearAmplitude,
    RawAmplitude,
    DeviationRatio,
    RangeSd,
    IntensitySd,
    WidthSd,
    ThicknessSd,
    Channel,
}

use Quantity::{
    Channel, DeviationRatio, IntensitySd, LinearAmplitude, RangeSd, RawAmplitude, Thickness, ThicknessSd,
    WidthRatio, WidthSd,
};

/// What the attributes of each layout tell, in their order.
const QUANTITIES_1_1: [Quantity; 9] = [
    WidthRatio,
    Thickness,
    LinearAmplitude,
    DeviationRatio,
    RangeSd,
    IntensitySd,
    WidthSd,
    ThicknessSd,
    Channel,
];
const QUANTITIES_1_0: [Quantity; 9] = [
    WidthRatio,
    Thickness,
    LinearAmplitude,
    RawAmplitude,
    DeviationRatio,
    RangeSd,
    IntensitySd,
    WidthSd,
    ThicknessSd,
];

/// Points of layout 1.0 whose waveform deviates by more belong to class 20.
const UNDEFINED_DEVIATION_RATIO: f64 = 3.0;
/// "Undefined" (BayesWavEx 1.1, section 3).
const UNDEFINED: u8 = 20;

/// The extra attributes of a file: how they are stored, and what they tell.
pub(super) struct Attributes {
    pub(super) stored: Vec<ExtraAttribute>,
    told: Vec<Quantity>,
}

impl Attributes {
    /// Those of a layout, with or without standard deviations.
    pub(super) fn of(layout: AttributeLayout, uncertainty: bool) -> Attributes {
        let (stored, told) = match layout {
            AttributeLayout::V1_1 => (ATTRIBUTES_1_1, QUANTITIES_1_1),
            AttributeLayout::V1_0 => (ATTRIBUTES_1_0, QUANTITIES_1_0),
        };
        let all = stored.into_iter().zip(told);
        let (stored, told) = all.filter(|(_, quantity)| uncertainty || !quantity.is_uncertainty()).unzip();
        Attributes { stored, told }
    }

    pub(super) fn none() -> Attributes {
        Attributes { stored: Vec::new(), told: Vec::new() }
    }

    /// Appends the extra bytes of a return.
    pub(super) fn push(&self, r: &Return, extra: &mut Vec<u8>) {
        for (attribute, quantity) in self.stored.iter().zip(&self.told) {
            attribute.push(quantity.of(r), extra);
        }
    }
}

impl Quantity {
    fn is_uncertainty(self) -> bool {
        matches!(self, RangeSd | IntensitySd | WidthSd | ThicknessSd)
    }

    fn of(self, r: &Return) -> f64 {
        match self {
            WidthRatio => r.width_ratio,
            Thickness => r.thickness_m,
            LinearAmplitude => linear_amplitude(r),
            RawAmplitude => r.amplitude_dn,
            DeviationRatio => r.deviation_ratio,
            RangeSd => r.range_sd_m,
            IntensitySd => r.intensity_sd,
            WidthSd => r.width_ratio_sd,
            ThicknessSd => r.thickness_sd_m,
            Channel => f64::from(power_channel(r)),
        }
    }
}

/// What an attribute of layout 1.1, or the raw amplitude, tells of a return; NaN for others.
pub(in crate::stages) fn value(attribute: &ExtraAttribute, r: &Return) -> f64 {
    let mut all = ATTRIBUTES_1_1.iter().zip(QUANTITIES_1_1).chain([(&RAW_AMP, RawAmplitude)]);
    let found = all.find(|(stored, _)| stored.name == attribute.name);
    found.map_or(f64::NAN, |(_, quantity)| quantity.of(r))
}

/// Linear amplitude: `7 × 10^(dB/10)` with the instrument's table, else the peak's height.
fn linear_amplitude(r: &Return) -> f64 {
    if r.amplitude_db.is_nan() { r.amplitude_dn } else { 7.0 * 10f64.powf(r.amplitude_db / 10.0) }
}

/// The receiver that gave the intensity: 0 low power, 1 high power.
pub(super) fn power_channel(r: &Return) -> u8 {
    u8::from(r.channel != ReturnChannel::Low)
}

/// The user data byte. Layout 1.0 counts iterations, which a return does not keep: a refined one says 1.
pub(super) fn user_data(layout: AttributeLayout, r: &Return) -> u8 {
    let bit = |flag: u16, bit: u8| u8::from(r.flags & flag != 0) << bit;
    match layout {
        AttributeLayout::V1_1 => r.flags as u8,
        AttributeLayout::V1_0 => bit(flags::REFINED, 0) | bit(flags::OVERLAP, 6) | bit(flags::DIVERGED, 7),
    }
}

/// The class: in layout 1.0 bad fits are undefined, too.
pub(super) fn class(layout: AttributeLayout, r: &Return) -> u8 {
    match layout {
        AttributeLayout::V1_0 if r.deviation_ratio > UNDEFINED_DEVIATION_RATIO => UNDEFINED,
        _ => r.class,
    }
}

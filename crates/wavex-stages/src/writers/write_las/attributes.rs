//! Extra attributes, class and user data of points, in all layouts.

use wavex_simd::quantise::{ROUNDING, power_ratios};

use wavex_formats::las::{
    ATTRIBUTES_1_0, ATTRIBUTES_1_1, ATTRIBUTES_STANDARD, ExtraAttribute, ExtraColumns, RAW_AMP, TOGETHER,
};
use wavex_line::scan_line::{Return, ReturnChannel, flags};

use super::AttributeLayout;

/// Defines the quantities that extra attributes store, each by its value of a return.
macro_rules! quantities {
    ($($name:ident: $of:expr,)+) => {
        /// Quantity of a return stored in an extra attribute.
        #[derive(Clone, Copy, Debug, PartialEq)]
        enum Quantity { $($name,)+ }

        use Quantity::{$($name,)+};

        impl Quantity {
            #[inline]
            fn of(self, r: &Return) -> f64 {
                match self { $($name => value_of(r, $of),)+ }
            }

            /// Applies [`Quantity::of`] to each return.
            ///
            /// Linear amplitudes are approximate, but accurate enough for rounding to whole numbers.
            fn column(self, returns: &[Return], values: &mut [f64]) {
                if self == LinearAmplitude {
                    return linear_amplitudes(values, returns);
                }
                // The quantity is matched once, not per value.
                match self { $($name => fill(values, returns, |r| value_of(r, $of)),)+ }
            }
        }
    };
}

quantities! {
    WidthRatio: |r| r.width_ratio,
    Thickness: |r| r.thickness_m,
    LinearAmplitude: linear_amplitude,
    RawAmplitude: |r| r.amplitude_dn,
    DeviationRatio: |r| r.deviation_ratio,
    RangeSd: |r| r.range_sd_m,
    IntensitySd: |r| r.intensity_sd,
    WidthSd: |r| r.width_ratio_sd,
    ThicknessSd: |r| r.thickness_sd_m,
    Channel: |r| f64::from(power_channel(r)),
    AmplitudeDb: |r| r.amplitude_db,
    ReflectanceDb: reflectance_db,
    FwhmNs: |r| r.fwhm_ns,
    FwhmSdNs: |r| r.width_ratio_sd * (r.fwhm_ns / r.width_ratio),
    AmplitudeSd: |r| r.amplitude_sd_dn,
    TotalSd: |r| r.total_sd_m,
    Receivers: receivers,
    Zone: |r| if r.mta_zone < 0 { f64::NAN } else { f64::from(r.mta_zone) },
    Flags: |r| f64::from(r.flags),
}

/// Calls `of`; it gives closures their argument type.
#[inline]
fn value_of(r: &Return, of: impl Fn(&Return) -> f64) -> f64 {
    of(r)
}

/// Quantities of the attributes of each layout, in their order.
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

const QUANTITIES_STANDARD: [Quantity; 16] = [
    AmplitudeDb,
    ReflectanceDb,
    FwhmNs,
    DeviationRatio,
    RawAmplitude,
    WidthRatio,
    Thickness,
    RangeSd,
    AmplitudeSd,
    FwhmSdNs,
    ThicknessSd,
    IntensitySd,
    TotalSd,
    Receivers,
    Zone,
    Flags,
];

/// Deviation ratio above which points of layout 1.0 are of class 20.
const UNDEFINED_DEVIATION_RATIO: f64 = 3.0;
/// "Undefined" (BayesWavEx 1.1, section 3).
const UNDEFINED: u8 = 20;
/// Classes of noise (LAS 1.4, "ASPRS Standard Point Classes"); before LAS 1.4, only the first.
const LOW_NOISE: u8 = 7;
const HIGH_NOISE: u8 = 18;

/// The extra attributes of a file: storage, and quantities.
pub(super) struct Attributes {
    pub(super) stored: Vec<ExtraAttribute>,
    quantities: Vec<Quantity>,
}

impl Attributes {
    /// The attributes of a layout, with or without standard deviations.
    pub(super) fn of(layout: AttributeLayout, uncertainty: bool) -> Attributes {
        let (stored, quantities): (&[ExtraAttribute], &[Quantity]) = match layout {
            AttributeLayout::Standard => (&ATTRIBUTES_STANDARD, &QUANTITIES_STANDARD),
            AttributeLayout::V1_1 => (&ATTRIBUTES_1_1, &QUANTITIES_1_1),
            AttributeLayout::V1_0 => (&ATTRIBUTES_1_0, &QUANTITIES_1_0),
        };
        let all = stored.iter().copied().zip(quantities.iter().copied());
        let (stored, quantities) =
            all.filter(|(_, quantity)| uncertainty || !quantity.is_uncertainty()).unzip();
        Attributes { stored, quantities }
    }

    pub(super) fn none() -> Attributes {
        Attributes { stored: Vec::new(), quantities: Vec::new() }
    }

    /// Writes the attributes of at most [`TOGETHER`] returns.
    pub(super) fn put(&self, returns: &[Return], columns: &mut ExtraColumns) {
        let mut values = [0.0; TOGETHER];
        let values = &mut values[..returns.len().min(TOGETHER)];
        for (attribute, quantity) in self.stored.iter().zip(&self.quantities) {
            quantity.column(returns, values);
            columns.put(attribute, values);
        }
    }
}

impl Quantity {
    fn is_uncertainty(self) -> bool {
        matches!(self, RangeSd | IntensitySd | WidthSd | ThicknessSd | FwhmSdNs | AmplitudeSd | TotalSd)
    }
}

/// Computes the value of each return.
#[inline]
fn fill(values: &mut [f64], returns: &[Return], of: impl Fn(&Return) -> f64) {
    values.iter_mut().zip(returns).for_each(|(value, r)| *value = of(r));
}

/// Value of an attribute of layout 1.1, or of the raw amplitude; NaN for others.
pub(crate) fn value(attribute: &ExtraAttribute, r: &Return) -> f64 {
    let mut all = ATTRIBUTES_1_1.iter().zip(QUANTITIES_1_1).chain([(&RAW_AMP, RawAmplitude)]);
    let found = all.find(|(stored, _)| stored.name == attribute.name);
    found.map_or(f64::NAN, |(_, quantity)| quantity.of(r))
}

/// Linear amplitudes that round to the same whole numbers as [`linear_amplitude`].
///
/// A value so close to a rounding boundary that this is not certain is recomputed exactly.
fn linear_amplitudes(values: &mut [f64], returns: &[Return]) {
    /// Relative uncertainty, far larger than the error of either method.
    const UNCERTAIN: f64 = 1e-11;
    let (mut decibels, mut ratios) = ([0.0; TOGETHER], [0.0; TOGETHER]);
    fill(&mut decibels, returns, |r| r.amplitude_db);
    power_ratios(&decibels[..values.len().min(TOGETHER)], &mut ratios);
    let mut is_uncertain = [false; TOGETHER];
    for (i, (value, r)) in (0..TOGETHER).zip(values.iter_mut().zip(returns)) {
        *value = if ratios[i].is_nan() { r.amplitude_at_unit_gain_dn().0 } else { 7.0 * ratios[i] };
        let from_middle = *value - 0.5;
        let nearest_middle = (from_middle + ROUNDING) - ROUNDING;
        is_uncertain[i] = (from_middle - nearest_middle).abs() <= *value * UNCERTAIN;
    }
    if is_uncertain.contains(&true) {
        let uncertain =
            values.iter_mut().zip(returns).zip(is_uncertain).filter(|(_, is_uncertain)| *is_uncertain);
        uncertain.for_each(|((value, r), _)| *value = linear_amplitude(r));
    }
}

/// Linear amplitude: `7 × 10^(dB/10)` with the instrument's table, else the peak height at gain 1.
fn linear_amplitude(r: &Return) -> f64 {
    match r.amplitude_db.is_nan() {
        true => r.amplitude_at_unit_gain_dn().0,
        false => 7.0 * 10f64.powf(r.amplitude_db / 10.0),
    }
}

/// Relative reflectance: the intensity on the scale of amplitudes in dB; NaN without a table.
fn reflectance_db(r: &Return) -> f64 {
    match r.amplitude_db.is_nan() || r.intensity <= 0.0 {
        true => f64::NAN,
        false => 10.0 * (r.intensity / 7.0).log10(),
    }
}

/// Receivers of the return: 0 low power, 1 high power, 2 both.
fn receivers(r: &Return) -> f64 {
    match r.channel {
        ReturnChannel::Low => 0.0,
        ReturnChannel::High => 1.0,
        ReturnChannel::Joint => 2.0,
    }
}

/// The receiver that gave the intensity: 0 low power, 1 high power.
pub(super) fn power_channel(r: &Return) -> u8 {
    u8::from(r.channel != ReturnChannel::Low)
}

/// User data byte.
///
/// Layout 1.0 counts iterations, which a return does not keep; it is 1 for refined returns.
pub(super) fn user_data(layout: AttributeLayout, r: &Return) -> u8 {
    let bit = |flag: u16, bit: u8| u8::from(r.flags & flag != 0) << bit;
    match layout {
        AttributeLayout::Standard | AttributeLayout::V1_1 => r.flags as u8,
        AttributeLayout::V1_0 => bit(flags::REFINED, 0) | bit(flags::OVERLAP, 6) | bit(flags::DIVERGED, 7),
    }
}

/// Class; in layout 1.0, poor fits are also undefined.
///
/// Legacy versions have only one class of noise.
pub(super) fn class(layout: AttributeLayout, is_legacy: bool, r: &Return) -> u8 {
    match (layout, r.class) {
        (AttributeLayout::V1_0, _) if r.deviation_ratio > UNDEFINED_DEVIATION_RATIO => UNDEFINED,
        (AttributeLayout::Standard, HIGH_NOISE) if is_legacy => LOW_NOISE,
        (AttributeLayout::V1_0 | AttributeLayout::V1_1, LOW_NOISE | HIGH_NOISE) => UNDEFINED,
        (_, class) => class,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use wavex_formats::las::quantise;

    /// Stored amplitudes for these decibels and heights, computed by column and individually.
    fn stored(amplitudes: &[(f64, f64)]) -> (Vec<i64>, Vec<i64>) {
        let of = |(amplitude_db, amplitude_dn): &(f64, f64)| Return {
            amplitude_db: *amplitude_db,
            amplitude_dn: *amplitude_dn,
            ..Return::default()
        };
        let returns: Vec<Return> = amplitudes.iter().map(of).collect();
        let mut values = vec![0.0; returns.len()];
        LinearAmplitude.column(&returns, &mut values);
        let amp = Attributes::of(AttributeLayout::V1_1, false).stored[2];
        let whole = |value: f64| quantise(value, &amp);
        (
            values.into_iter().map(whole).collect(),
            returns.iter().map(|r| whole(linear_amplitude(r))).collect(),
        )
    }

    #[test]
    fn amplitudes_are_stored_as_whole_numbers() {
        for layout in [AttributeLayout::V1_0, AttributeLayout::V1_1] {
            let attributes = Attributes::of(layout, true);
            let at = attributes.quantities.iter().position(|quantity| *quantity == LinearAmplitude).unwrap();
            let amplitude = &attributes.stored[at];
            assert_eq!((amplitude.scale, amplitude.offset), (Some(1.0), Some(0.0)));
        }
    }

    #[test]
    fn amplitudes_about_the_middle_of_whole_numbers_are_stored_as_their_powers() {
        for middle in (0..70_000).step_by(64) {
            let middles = (middle..middle + 64).map(|number| {
                let decibels = 10.0 * ((f64::from(number) + 0.5) / 7.0).log10();
                let nudged = f64::from_bits(decibels.to_bits() + (number % 5) as u64 - 2);
                (nudged, f64::NAN)
            });
            let (column, one_by_one) = stored(&middles.collect::<Vec<_>>());
            assert_eq!(column, one_by_one);
        }
    }

    #[test]
    fn amplitudes_that_are_no_numbers_or_too_large() {
        let nan = f64::NAN;
        let amplitudes = [
            (nan, 2.5),
            (nan, nan),
            (nan, 1e300),
            (nan, f64::INFINITY),
            (f64::INFINITY, nan),
            (f64::NEG_INFINITY, 3.0),
            (1e300, nan),
            (60.0, nan),
        ];
        let (column, one_by_one) = stored(&amplitudes);
        assert_eq!(column, [3, 0, 65_535, 65_535, 65_535, 0, 65_535, 65_535]);
        assert_eq!(column, one_by_one);
    }

    proptest! {
        #[test]
        fn amplitudes_are_stored_as_their_powers(
            amplitudes in prop::collection::vec((prop_oneof![-50.0..60.0f64, Just(f64::NAN)], any::<f64>()), 1..128)
        ) {
            let (column, one_by_one) = stored(&amplitudes);
            prop_assert_eq!(column, one_by_one);
        }
    }
}

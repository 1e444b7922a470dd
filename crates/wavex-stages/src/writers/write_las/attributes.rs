//! Extra attributes, class and user data of points, in all layouts.

mod bayes_wavex;
mod standard;

use std::slice;

use wavex_simd::quantise::{ROUNDING, power_ratios};

use wavex_formats::las::{ExtraAttribute, ExtraColumns, TOGETHER};
use wavex_line::scan_line::{Return, ReturnChannel, flags};

use super::AttributeLayout;
pub(crate) use bayes_wavex::{ATTRIBUTES_1_1, RAW_AMP};
pub(super) use standard::HEIGHT_ABOVE_GROUND;

/// Extra attribute of points: its storage, and its value of a return.
#[derive(Clone, Copy)]
pub(crate) struct ReturnAttribute {
    pub(crate) stored: ExtraAttribute,
    is_uncertainty: bool,
    fill: Fill,
}

/// Computes the value of each return, of at most [`TOGETHER`].
type Fill = fn(&[Return], &mut [f64]);

/// A [`Fill`] that applies a closure to each return.
macro_rules! each {
    ($value:expr) => {
        |returns, values| crate::writers::write_las::attributes::fill(values, returns, $value)
    };
}
use each;

/// Deviation ratio above which points of layout 1.0 are of class 20.
const UNDEFINED_DEVIATION_RATIO: f64 = 3.0;
/// "Undefined" (BayesWavEx 1.1, section 3).
const UNDEFINED: u8 = 20;
/// Classes of noise (LAS 1.4, "ASPRS Standard Point Classes"); before LAS 1.4, only the first.
const LOW_NOISE: u8 = 7;
const HIGH_NOISE: u8 = 18;

/// Returns the attributes of a layout, with or without standard deviations.
pub(super) fn attributes_of(layout: AttributeLayout, uncertainty: bool) -> Vec<ReturnAttribute> {
    let all: &[ReturnAttribute] = match layout {
        AttributeLayout::Standard => &standard::ATTRIBUTES,
        AttributeLayout::V1_1 => &ATTRIBUTES_1_1,
        AttributeLayout::V1_0 => &bayes_wavex::ATTRIBUTES_1_0,
    };
    all.iter().filter(|attribute| uncertainty || !attribute.is_uncertainty).copied().collect()
}

impl ReturnAttribute {
    /// Computes the value of a return.
    pub(crate) fn value(&self, r: &Return) -> f64 {
        let mut value = [0.0];
        (self.fill)(slice::from_ref(r), &mut value);
        value[0]
    }

    /// Writes the values of at most [`TOGETHER`] returns.
    pub(super) fn put(&self, returns: &[Return], columns: &mut ExtraColumns) {
        let mut values = [0.0; TOGETHER];
        let values = &mut values[..returns.len().min(TOGETHER)];
        (self.fill)(returns, values);
        columns.put(&self.stored, values);
    }
}

/// Applies a closure to each return.
#[inline]
fn fill(values: &mut [f64], returns: &[Return], of: impl Fn(&Return) -> f64) {
    values.iter_mut().zip(returns).for_each(|(value, r)| *value = of(r));
}

/// Linear amplitudes that round to the same whole numbers as [`linear_amplitude`].
///
/// A value so close to a rounding boundary that this is not certain is recomputed exactly.
fn linear_amplitudes(returns: &[Return], values: &mut [f64]) {
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

/// Emissions between the shot and the reception of its echo; NaN if unknown.
fn mta_zone(r: &Return) -> f64 {
    if r.mta_zone < 0 { f64::NAN } else { f64::from(r.mta_zone) }
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
        linear_amplitudes(&returns, &mut values);
        let whole = |value: f64| quantise(value, &ATTRIBUTES_1_1[2].stored);
        (
            values.into_iter().map(whole).collect(),
            returns.iter().map(|r| whole(linear_amplitude(r))).collect(),
        )
    }

    #[test]
    fn amplitudes_are_stored_as_whole_numbers() {
        for layout in [AttributeLayout::V1_0, AttributeLayout::V1_1] {
            let amplitude = attributes_of(layout, true)[2].stored;
            assert!(["Amp", "Amplitude"].contains(&amplitude.name));
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

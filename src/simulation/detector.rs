//! How high the peak of an echo stands in each receiver.
//!
//! An echo has a *linear amplitude*: the height, in digitiser steps above the background, that its peak would have in the
//! sensitive receiver if that were linear without end. A receiver gives it another height; tables say which, as decibels
//! above 7 steps (`dB = 10 log10(a / 7)` with the linear amplitude `a`) by background + height.

/// The linear amplitude that counts as 0 dB, DN.
pub const ZERO_DB_DN: f64 = 7.0;

/// Up to this height the sensitive receiver of the measured instrument is linear, DN above the background.
const LINEAR_TO_DN: f64 = 66.0;
/// Its strongest table entry: height above the background, DN, and decibels.
const SENSITIVE_END: (f64, f64) = (253.0, 19.7);
/// The other receiver's strongest entry, DN above the background and decibels, and steps per decibel on its logarithmic
/// part.
const COARSE_END: (f64, f64) = (253.0, 39.7);
const COARSE_DN_PER_DB: f64 = 10.0;
/// What a linear receiver for strong echoes makes of a linear amplitude.
const COARSE_GAIN: f64 = 0.1;

/// A kind of receiver electronics.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Detector {
    /// Height is proportional to the linear amplitude: 1 in the sensitive receiver, 1/10 in the other.
    Linear,
    /// As the tables of a RIEGL LMS-Q680i say: the sensitive receiver is linear to 68 steps (a background of 2 included)
    /// and compresses above, up to 19.7 dB at 255; the other is linear with 1/12 of the gain to 45 steps and logarithmic
    /// above, with 0.1 dB per step up to 39.7 dB at 255. Only the peak's height is compressed, not the pulse's shape.
    Riegl,
}

/// Which receiver.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sensitivity {
    /// The one for weak echoes: low power.
    Sensitive,
    /// The one for strong echoes: high power.
    Coarse,
}

use Sensitivity::{Coarse, Sensitive};

impl Detector {
    /// The height that an echo's peak has in a receiver, DN above the background.
    pub fn height_dn(self, receiver: Sensitivity, linear_dn: f64) -> f64 {
        match (self, receiver) {
            (Detector::Linear, Sensitive) => linear_dn,
            (Detector::Linear, Coarse) => COARSE_GAIN * linear_dn,
            (Detector::Riegl, Sensitive) if linear_dn <= LINEAR_TO_DN => linear_dn,
            (Detector::Riegl, Sensitive) => {
                let (slope, bend) = compression();
                let beyond_db = decibels(linear_dn) - decibels(LINEAR_TO_DN);
                LINEAR_TO_DN + beyond_db * (slope + bend * beyond_db)
            }
            (Detector::Riegl, Coarse) => {
                let (gain, from_dn) = coarse_gain();
                let height = gain * linear_dn;
                if height <= from_dn {
                    return height;
                }
                COARSE_END.0 + COARSE_DN_PER_DB * (decibels(linear_dn) - COARSE_END.1)
            }
        }
    }

    /// The decibels of an echo whose peak has this height in a receiver: the inverse.
    pub fn decibels(self, receiver: Sensitivity, height_dn: f64) -> f64 {
        match (self, receiver) {
            (Detector::Linear, Sensitive) => decibels(height_dn),
            (Detector::Linear, Coarse) => decibels(height_dn / COARSE_GAIN),
            (Detector::Riegl, Sensitive) if height_dn <= LINEAR_TO_DN => decibels(height_dn),
            (Detector::Riegl, Sensitive) => {
                let (slope, bend) = compression();
                let root = (slope * slope + 4.0 * bend * (height_dn - LINEAR_TO_DN)).sqrt();
                decibels(LINEAR_TO_DN) + (root - slope) / (2.0 * bend)
            }
            (Detector::Riegl, Coarse) => {
                let (gain, from_dn) = coarse_gain();
                if height_dn <= from_dn {
                    return decibels(height_dn / gain);
                }
                COARSE_END.1 + (height_dn - COARSE_END.0) / COARSE_DN_PER_DB
            }
        }
    }

    /// A receiver's amplitude table: pairs of background + height, for each whole step up to the digitiser's last, and
    /// decibels.
    pub fn table(
        self,
        receiver: Sensitivity,
        background_dn: f64,
        full_scale_dn: u16,
    ) -> impl Iterator<Item = (f64, f64)> {
        let lowest = background_dn as u16 + 1;
        (lowest..=full_scale_dn)
            .map(f64::from)
            .map(move |dn| (dn, self.decibels(receiver, dn - background_dn)))
    }
}

fn decibels(linear_dn: f64) -> f64 {
    10.0 * libm::log10(linear_dn / ZERO_DB_DN)
}

/// Slope and half curvature, DN per decibel and per decibel squared, of the sensitive receiver's compressed part: it
/// begins with the slope of the linear part and ends at the strongest entry.
fn compression() -> (f64, f64) {
    let slope = LINEAR_TO_DN * core::f64::consts::LN_10 / 10.0;
    let (end_dn, end_db) = SENSITIVE_END;
    let span_db = end_db - decibels(LINEAR_TO_DN);
    (slope, (end_dn - LINEAR_TO_DN - slope * span_db) / (span_db * span_db))
}

/// Gain of the coarse receiver's linear part, and the height up to which it is linear, DN: where the logarithm's slope is
/// that of a straight line from 0.
fn coarse_gain() -> (f64, f64) {
    let from_dn = COARSE_DN_PER_DB * 10.0 / core::f64::consts::LN_10;
    let from_db = COARSE_END.1 + (from_dn - COARSE_END.0) / COARSE_DN_PER_DB;
    (from_dn / (ZERO_DB_DN * libm::pow(10.0, 0.1 * from_db)), from_dn)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const ALL: [(Detector, Sensitivity); 4] = [
        (Detector::Linear, Sensitive),
        (Detector::Linear, Coarse),
        (Detector::Riegl, Sensitive),
        (Detector::Riegl, Coarse),
    ];

    /// The figures of a real instrument's tables, with their background of 2.
    #[test]
    fn tables_have_the_measured_ends() {
        let at = |receiver, dn: u16| {
            let mut table = Detector::Riegl.table(receiver, 2.0, 255);
            table.find(|pair| pair.0 == f64::from(dn)).unwrap().1
        };
        assert!(at(Sensitive, 9).abs() < 1e-12, "0 dB at 9 steps");
        assert!((at(Sensitive, 68) - 10.0 * (66.0f64 / 7.0).log10()).abs() < 1e-12);
        assert!((at(Sensitive, 255) - 19.7).abs() < 1e-12);
        assert!((at(Coarse, 255) - 39.7).abs() < 1e-12);
        assert!((at(Coarse, 255) - at(Coarse, 155) - 10.0).abs() < 1e-12, "0.1 dB per step");
        let (gain, from_dn) = coarse_gain();
        assert!((gain - 1.0 / 12.0).abs() < 0.003 && (from_dn - 43.43).abs() < 0.01, "{gain} {from_dn}");
    }

    #[test]
    fn curves_are_smooth_where_they_bend() {
        for (receiver, at) in [(Sensitive, LINEAR_TO_DN), (Coarse, coarse_gain().1 / coarse_gain().0)] {
            let height = |linear_dn| Detector::Riegl.height_dn(receiver, linear_dn);
            let (below, above) = (height(at) - height(at - 1e-4), height(at + 1e-4) - height(at));
            assert!((below / above - 1.0).abs() < 1e-4, "{below} {above}");
        }
    }

    proptest! {
        #[test]
        fn the_table_is_the_inverse_of_the_curve(linear_dn in 0.1..1e4) {
            for (detector, receiver) in ALL {
                let db = detector.decibels(receiver, detector.height_dn(receiver, linear_dn));
                prop_assert!((db - decibels(linear_dn)).abs() < 1e-9, "{:?} {:?}", detector, receiver);
            }
        }

        #[test]
        fn stronger_is_higher(linear_dn in 0.1..1e4) {
            for (detector, receiver) in ALL {
                let height = |linear_dn| detector.height_dn(receiver, linear_dn);
                prop_assert!(height(1.01 * linear_dn) > height(linear_dn));
            }
        }
    }
}

//! Peak amplitude of an echo in each receiver.
//!
//! The *linear amplitude* of an echo is the amplitude, in DN above the background, that its peak
//! would have in the sensitive receiver if that were linear without limit. Receivers record other
//! amplitudes. Tables map background + amplitude to decibels above 7 DN: `dB = 10 log10(a / 7)`
//! with the linear amplitude `a`.

/// Linear amplitude of 0 dB, DN.
const ZERO_DB_DN: f64 = 7.0;

/// Upper limit of the linear range of the measured sensitive receiver, DN above the background.
const LINEAR_TO_DN: f64 = 66.0;
/// Last table entry of the sensitive receiver: DN above the background, and dB.
const SENSITIVE_END: (f64, f64) = (253.0, 19.7);
/// Last table entry of the coarse receiver (DN above the background, dB), and slope of its
/// logarithmic range, DN/dB.
const COARSE_END: (f64, f64) = (253.0, 39.7);
const COARSE_DN_PER_DB: f64 = 10.0;
/// Gain of a linear receiver for strong echoes.
const COARSE_GAIN: f64 = 0.1;

/// Model of the receiver electronics.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DetectorModel {
    /// Amplitude is proportional to the linear amplitude: factor 1 in the sensitive receiver, 1/10
    /// in the coarse one.
    Linear,
    /// Follows the tables of a RIEGL LMS-Q680i.
    ///
    /// The sensitive receiver is linear to 68 DN (including a background of 2) and compressive
    /// above, to 19.7 dB at 255 DN. The coarse receiver has 1/12 of the gain, is linear to 45 DN
    /// and logarithmic above with 0.1 dB/DN, to 39.7 dB at 255 DN. Only the peak amplitude is
    /// compressed, not the pulse shape.
    Riegl,
}

/// One of the two receivers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sensitivity {
    /// Receiver for weak echoes: low power.
    Sensitive,
    /// Receiver for strong echoes: high power.
    Coarse,
}

use Sensitivity::{Coarse, Sensitive};

impl DetectorModel {
    /// Peak amplitude of an echo in a receiver, DN above the background.
    ///
    /// # Examples
    ///
    /// ```
    /// use wavex_simulation::detector::{DetectorModel, Sensitivity};
    ///
    /// assert_eq!(DetectorModel::Linear.height_dn(Sensitivity::Coarse, 200.0), 20.0);
    /// assert!(DetectorModel::Riegl.height_dn(Sensitivity::Sensitive, 200.0) < 200.0);
    /// ```
    pub fn height_dn(self, receiver: Sensitivity, linear_dn: f64) -> f64 {
        match (self, receiver) {
            (DetectorModel::Linear, Sensitive) => linear_dn,
            (DetectorModel::Linear, Coarse) => COARSE_GAIN * linear_dn,
            (DetectorModel::Riegl, Sensitive) if linear_dn <= LINEAR_TO_DN => linear_dn,
            (DetectorModel::Riegl, Sensitive) => {
                let (slope, bend) = compression();
                let beyond_db = decibels(linear_dn) - decibels(LINEAR_TO_DN);
                LINEAR_TO_DN + beyond_db * (slope + bend * beyond_db)
            }
            (DetectorModel::Riegl, Coarse) => {
                let (gain, from_dn) = coarse_gain();
                let height = gain * linear_dn;
                if height <= from_dn {
                    return height;
                }
                COARSE_END.0 + COARSE_DN_PER_DB * (decibels(linear_dn) - COARSE_END.1)
            }
        }
    }

    /// Inverse of [`DetectorModel::height_dn`]: decibels of an echo with this peak amplitude.
    fn decibels(self, receiver: Sensitivity, height_dn: f64) -> f64 {
        match (self, receiver) {
            (DetectorModel::Linear, Sensitive) => decibels(height_dn),
            (DetectorModel::Linear, Coarse) => decibels(height_dn / COARSE_GAIN),
            (DetectorModel::Riegl, Sensitive) if height_dn <= LINEAR_TO_DN => decibels(height_dn),
            (DetectorModel::Riegl, Sensitive) => {
                let (slope, bend) = compression();
                let root = (slope * slope + 4.0 * bend * (height_dn - LINEAR_TO_DN)).sqrt();
                decibels(LINEAR_TO_DN) + (root - slope) / (2.0 * bend)
            }
            (DetectorModel::Riegl, Coarse) => {
                let (gain, from_dn) = coarse_gain();
                if height_dn <= from_dn {
                    return decibels(height_dn / gain);
                }
                COARSE_END.1 + (height_dn - COARSE_END.0) / COARSE_DN_PER_DB
            }
        }
    }

    /// Amplitude table of a receiver.
    ///
    /// Pairs of background + amplitude, DN, for each integer up to full scale, and dB.
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

/// Slope (DN/dB) and half curvature (DN/dB²) of the sensitive receiver's compressive range.
///
/// The curve starts with the slope of the linear range and ends at the last table entry.
fn compression() -> (f64, f64) {
    let slope = LINEAR_TO_DN * core::f64::consts::LN_10 / 10.0;
    let (end_dn, end_db) = SENSITIVE_END;
    let span_db = end_db - decibels(LINEAR_TO_DN);
    (slope, (end_dn - LINEAR_TO_DN - slope * span_db) / (span_db * span_db))
}

/// Gain and upper limit (DN) of the coarse receiver's linear range.
///
/// At the limit, the slope of the logarithm equals the slope of a line through the origin.
fn coarse_gain() -> (f64, f64) {
    let from_dn = COARSE_DN_PER_DB * 10.0 / core::f64::consts::LN_10;
    let from_db = COARSE_END.1 + (from_dn - COARSE_END.0) / COARSE_DN_PER_DB;
    (from_dn / (ZERO_DB_DN * libm::pow(10.0, 0.1 * from_db)), from_dn)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const ALL: [(DetectorModel, Sensitivity); 4] = [
        (DetectorModel::Linear, Sensitive),
        (DetectorModel::Linear, Coarse),
        (DetectorModel::Riegl, Sensitive),
        (DetectorModel::Riegl, Coarse),
    ];

    /// Values from a real instrument's tables, with its background of 2 DN.
    #[test]
    fn tables_have_the_measured_ends() {
        let at = |receiver, dn: u16| {
            let mut table = DetectorModel::Riegl.table(receiver, 2.0, 255);
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
            let height = |linear_dn| DetectorModel::Riegl.height_dn(receiver, linear_dn);
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

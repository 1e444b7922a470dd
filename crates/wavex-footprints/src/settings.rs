//! Settings of the measurement of footprints.

use super::model::SD_OF_FWHM;

/// How a footprint is measured.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FootprintSettings {
    /// SD of the Gaussian that smooths the waveform for its extent and energy, ns; `None`: that of the
    /// response, the matched filter.
    pub smoothing_ns: Option<f64>,
    /// The same for modes.
    pub mode_smoothing_ns: Option<f64>,
    /// Smoothed signal over the SD of its noise at which the signal begins, seen from the instrument.
    pub front_sigma: f64,
    /// The same where it ends.
    pub back_sigma: f64,
    /// Whether every local maximum above the threshold is a mode. Otherwise a mode must also be higher than the valleys
    /// beside it and than the tails of earlier modes.
    pub takes_every_maximum: bool,
    /// Background and noise to which thresholds refer.
    pub noise: NoiseSource,
}

/// Source of background and noise.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NoiseSource {
    /// The waveform's samples without signal; thresholds are in SDs of the smoothed noise.
    Waveform,
    /// The recorded values; thresholds are in SDs of a sample, as in GEDI's level 2A product.
    Recorded,
}

impl Default for FootprintSettings {
    fn default() -> FootprintSettings {
        FootprintSettings {
            smoothing_ns: None,
            mode_smoothing_ns: None,
            front_sigma: 4.5,
            // Levels wander by more than their noise; one simulated ground of 300 is weaker.
            back_sigma: 8.0,
            takes_every_maximum: false,
            noise: NoiseSource::Waveform,
        }
    }
}

impl FootprintSettings {
    /// One of the six settings of GEDI's level 2A product, 1 to 6; `None` for other numbers.
    ///
    /// Smoothing widths, and thresholds of front and back, of its user guide.
    pub fn gedi_l2a(group: u8) -> Option<FootprintSettings> {
        let (mode_smoothing_ns, front_sigma, back_sigma) = match group {
            1 => (6.5, 3.0, 6.0),
            2 => (3.5, 3.0, 3.0),
            3 => (3.5, 3.0, 6.0),
            4 => (6.5, 6.0, 6.0),
            5 => (3.5, 3.0, 2.0),
            6 => (3.5, 3.0, 4.0),
            _ => return None,
        };
        Some(FootprintSettings {
            smoothing_ns: Some(6.5),
            mode_smoothing_ns: Some(mode_smoothing_ns),
            front_sigma,
            back_sigma,
            takes_every_maximum: true,
            noise: NoiseSource::Recorded,
        })
    }

    /// SDs of both kernels for a response of this width, ns.
    pub(super) fn smoothing_ns(&self, fwhm_ns: f64) -> [f64; 2] {
        let matched_ns = SD_OF_FWHM * fwhm_ns;
        [self.smoothing_ns, self.mode_smoothing_ns].map(|given_ns| given_ns.unwrap_or(matched_ns))
    }
}

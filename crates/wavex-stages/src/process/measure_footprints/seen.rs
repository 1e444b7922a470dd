//! One shot with its samples, for `wavex explain` and `wavex view`.

use std::sync::Arc;

use super::result::height_per_range;
use super::{MeasureFootprints, echo_block, learnt};
use wavex_footprints::{FootprintEstimator, FootprintModel};
use wavex_geodesy::ellipsoid::WGS84;
use wavex_line::scan_line::{Channel, Emission, Footprint, Frame, InputInfo, Return, ScanLine};
use wavex_line::stage::{Result, RunContext};
use wavex_simd::statistics::median;

/// A shot with its measurement and its samples.
pub struct SeenFootprint {
    /// The shot.
    pub emission: Emission,
    /// Metadata of the recording.
    pub input: Arc<InputInfo>,
    /// Ground, canopy and relative heights.
    pub footprint: Footprint,
    /// Modes, from the top downwards.
    pub modes: Vec<Return>,
    /// Samples of the waveform, DN.
    pub samples_dn: Vec<f32>,
    /// Samples of the outgoing pulse, DN; empty if it was not recorded.
    pub outgoing_dn: Vec<f32>,
    /// Range of the first sample, m.
    pub first_range_m: f64,
    /// Range per sample, m.
    pub range_step_m: f64,
    /// Height per range.
    pub height_per_range: f64,
    /// Noise and response of the beam.
    pub model: FootprintModel,
}

impl MeasureFootprints {
    /// Measures one shot of a line, by the loaded model or that of the first lines of its beam.
    ///
    /// `None` if it has no echo block, or no background beside its signal.
    ///
    /// # Errors
    /// If the first lines have too few shots to learn from, or the loaded model does not fit.
    pub fn seen(
        &self,
        run: &RunContext,
        first: &[ScanLine],
        line: &ScanLine,
        emission: u32,
    ) -> Result<Option<SeenFootprint>> {
        let model = match self.loaded(run)? {
            Some(loaded) => loaded.of_line(line)?.ok_or_else(|| loaded.without(line))?.model.clone(),
            None => learnt(first)?.model,
        };
        let mut estimator = FootprintEstimator::new(&model, self.settings());
        let (mut samples_dn, mut outgoing_dn) = (Vec::new(), Vec::new());
        let (Some(blocks), Some(shot)) = (line.blocks(), line.emissions.get(emission as usize)) else {
            return Ok(None);
        };
        let measured = self.shot(emission, line, blocks, &mut estimator, &mut samples_dn);
        let (Some((footprint, modes)), Some(block)) = (measured, echo_block(blocks, emission)) else {
            return Ok(None);
        };
        let mut of_shot = blocks.of_emission(emission).map(|(_, block)| block);
        if let Some(outgoing) = of_shot.find(|block| block.channel == Channel::Reference) {
            blocks.fractions_into(outgoing, &mut outgoing_dn);
        }
        let m_per_ns = 0.5e-9 * line.input.group_velocity_mps;
        Ok(Some(SeenFootprint {
            emission: *shot,
            input: Arc::clone(&line.input),
            footprint,
            modes,
            samples_dn,
            outgoing_dn,
            first_range_m: m_per_ns * block.start_ns,
            range_step_m: m_per_ns * block.interval_ns,
            height_per_range: height_per_range(shot, &line.input),
            model,
        }))
    }
}

impl SeenFootprint {
    /// Height of a range above the ground, m; above the first sample if the ground is missing.
    pub fn height_m(&self, range_m: f64) -> f64 {
        let ground = self.footprint.ground_range_m.value;
        let zero_m = if ground.is_nan() { self.first_range_m } else { ground };
        self.height_per_range * (zero_m - range_m)
    }

    /// Height of a range above the ellipsoid WGS 84, m; `None` if the beams are not earth-centred, or the range is NaN.
    pub fn height_above_ellipsoid_m(&self, range_m: f64) -> Option<f64> {
        let Emission { origin_m, direction, frame_scale, .. } = self.emission;
        let place_m = [0, 1, 2].map(|axis| origin_m[axis] + frame_scale * range_m * direction[axis]);
        let is_known = self.input.frame == Frame::Earth && range_m.is_finite();
        is_known.then(|| WGS84.geodetic_of(place_m).height_m)
    }

    /// Level of the background, DN; that of the median sample without modes.
    pub fn background_dn(&self) -> f64 {
        let of_mode = self.modes.first().map(|mode| mode.peak_dn - mode.amplitude_dn);
        of_mode.or_else(|| median(self.samples_dn.iter().map(|dn| f64::from(*dn)))).unwrap_or(0.0)
    }
}

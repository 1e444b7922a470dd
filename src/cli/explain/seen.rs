//! What was seen while a shot was decomposed: all that the table and the picture tell.

use std::ops::Range;
use std::sync::Arc;

use crate::batch::{Block, Blocks, Emission, Return, Returns};
use crate::kernels::decompose::{DecomposeSettings, Decomposer, Decomposition, Return as Pulse};
use crate::kernels::outgoing::Outgoing;
use crate::kernels::sensor_model::{ChannelModel, SensorModel};
use crate::stage::Context;
use crate::stages::decompose::{BlockFit, Watch};

/// Points of a curve to a sample.
pub(super) const PER_SAMPLE: usize = 8;

/// A shot and all that became of it.
pub(super) struct Explained {
    pub(super) file: String,
    pub(super) emission: Emission,
    /// In order of time.
    pub(super) returns: Returns,
    pub(super) blocks: Vec<SeenBlock>,
    pub(super) outgoing: Option<SeenPulse>,
    pub(super) model: Arc<SensorModel>,
    /// Threshold of detection, standard deviations.
    pub(super) threshold: f64,
    /// What was dropped or is worth knowing, in words.
    pub(super) remarks: Vec<String>,
}

/// The samples of a block and their fit.
pub(super) struct SeenSamples {
    /// Time of the first sample after the shot's clock, ns.
    pub(super) start_ns: f64,
    pub(super) interval_ns: f64,
    pub(super) samples_dn: Vec<u16>,
    /// The samples as they were fitted: less the receiver's tail, where the model has one.
    pub(super) fitted_dn: Vec<f64>,
    /// When each was taken, samples after the first.
    pub(super) taken_at: Vec<f64>,
    pub(super) full_scale_dn: f64,
    /// Which samples took part in the fit.
    pub(super) used: Vec<bool>,
    /// The level without a pulse, the mean over sample phases, DN.
    pub(super) background_dn: f64,
    /// The pulses above the background, by position, [`PER_SAMPLE`] points to a sample from the first.
    pub(super) pulses_dn: Vec<Vec<f64>>,
    /// What the fit leaves, standard deviations.
    pub(super) residual: Vec<f64>,
}

/// A block of echoes.
pub(super) struct SeenBlock {
    pub(super) samples: SeenSamples,
    pub(super) fit: BlockFit,
    /// Where its returns peak, after the shot's clock, ns.
    pub(super) peaks_ns: Vec<f64>,
}

/// The outgoing pulse: the block's samples, of which a window was fitted.
pub(super) struct SeenPulse {
    pub(super) samples: SeenSamples,
    /// Its place counts from the block's first sample.
    pub(super) pulse: Pulse,
    /// The first sample of the window that was fitted.
    pub(super) window: usize,
}

/// Collects while a shot is decomposed.
pub(super) struct Seen<'a> {
    line: &'a Blocks,
    blocks: Vec<SeenBlock>,
    outgoing: Option<SeenPulse>,
}

impl<'a> Seen<'a> {
    pub(super) fn new(line: &'a Blocks) -> Seen<'a> {
        Seen { line, blocks: Vec::new(), outgoing: None }
    }

    pub(super) fn explained(
        self,
        file: String,
        emission: Emission,
        returns: Returns,
        cx: &Context,
        model: Arc<SensorModel>,
        threshold: f64,
    ) -> Explained {
        let rejected = &cx.counters().rejected;
        let dropped =
            rejected.iter().map(|((item, why), n)| format!("not used: {n} of its {}: {why}", item.name()));
        let remarks = dropped.chain(cx.counters().notes.iter().cloned()).collect();
        let mut blocks = self.blocks;
        blocks.sort_by(|a, b| a.samples.start_ns.total_cmp(&b.samples.start_ns));
        Explained { file, emission, returns, blocks, outgoing: self.outgoing, model, threshold, remarks }
    }

    /// A block whose samples in `window` were decomposed; returns count their places from the window's first.
    ///
    /// `None` only for a model that describes no channel.
    fn samples(
        &self,
        block: &Block,
        window: Range<usize>,
        found: &Decomposition,
        model: &ChannelModel,
    ) -> Option<SeenSamples> {
        let samples = self.line.samples(block);
        let mut decomposer = Decomposer::new(model, &DecomposeSettings::default(), window.len()).ok()?;
        decomposer.show(samples.get(window.clone())?, (window.start % 4) as u8, found);
        let window = window.start;
        let mut fitted_dn: Vec<f64> = samples.iter().map(|&sample| f64::from(sample)).collect();
        for (k, (fitted, signal)) in
            (window..).zip(fitted_dn.iter_mut().skip(window).zip(decomposer.signal_dn()))
        {
            *fitted = signal + model.background_at(0, k);
        }
        let pulses = 0..decomposer.returns().len();
        Some(SeenSamples {
            start_ns: block.start_ns,
            interval_ns: block.interval_ns,
            samples_dn: samples.to_vec(),
            fitted_dn,
            taken_at: (0..samples.len()).map(|k| model.digitiser.time_of(k)).collect(),
            full_scale_dn: model.full_scale_dn,
            used: decomposer.used().to_vec(),
            background_dn: mean_background_dn(model) + found.background_offset_dn,
            pulses_dn: pulses.map(|i| decomposer.pulse_curve(i, PER_SAMPLE)).collect(),
            residual: decomposer.standardised_residual().to_vec(),
        })
    }
}

impl Watch for Seen<'_> {
    fn outgoing(&mut self, block: &Block, outgoing: &Outgoing, model: &ChannelModel) {
        let Outgoing { pulse, window } = outgoing.clone();
        let position_samples = pulse.position_samples - window.start as f64;
        let in_window = [Pulse { position_samples, ..pulse }];
        let found = Decomposition { returns: &in_window, ..Decomposition::default() };
        let samples = self.samples(block, window.clone(), &found, model);
        self.outgoing = samples.map(|samples| SeenPulse { samples, pulse, window: window.start });
    }

    fn echoes(&mut self, block: &Block, fit: BlockFit, found: &Decomposition, model: &ChannelModel) {
        let peaks_ns = found.returns.iter().map(|pulse| block.time_ns(pulse.position_samples)).collect();
        let samples = self.samples(block, 0..block.len(), found, model);
        self.blocks.extend(samples.map(|samples| SeenBlock { samples, fit, peaks_ns }));
    }
}

impl SeenSamples {
    /// The fit, background and all, [`PER_SAMPLE`] points to a sample, from sample `first` on.
    pub(super) fn fit_dn(&self) -> Vec<f64> {
        let points =
            self.pulses_dn.first().map_or(self.samples_dn.len().saturating_sub(1) * PER_SAMPLE + 1, Vec::len);
        let mut fit = vec![self.background_dn; points];
        for pulse in &self.pulses_dn {
            fit.iter_mut().zip(pulse).for_each(|(sum, value)| *sum += value);
        }
        fit
    }

    pub(super) fn is_saturated(&self, k: usize) -> bool {
        self.samples_dn.get(k).is_some_and(|&sample| f64::from(sample) >= self.full_scale_dn)
    }

    /// How many samples took no part in the fit.
    pub(super) fn left_out(&self) -> usize {
        self.used.iter().filter(|used| !**used).count()
    }
}

impl Explained {
    /// The time of flight of something `time_ns` after the shot's clock, ns.
    pub(super) fn time_of_flight_ns(&self, time_ns: f64) -> f64 {
        time_ns - self.emission.emission_ns
    }

    /// The number of the return that peaks so long after the shot's clock.
    pub(super) fn number_at(&self, peak_ns: f64) -> Option<&Return> {
        let flight_ns = self.time_of_flight_ns(peak_ns);
        let distance = |found: &Return| (found.time_of_flight_ns - flight_ns).abs();
        self.returns
            .iter()
            .min_by(|a, b| distance(a).total_cmp(&distance(b)))
            .filter(|found| distance(found) < 1e-6)
    }
}

/// The mean of a channel's background over the phases of its samples, DN.
pub(super) fn mean_background_dn(model: &ChannelModel) -> f64 {
    model.background_dn.iter().sum::<f64>() / model.background_dn.len() as f64
}

//! Observer that collects the data for a figure of a shot.

use std::ops::Range;

use super::{BlockFit, Observer};
use wavex_line::scan_line::{Block, Blocks, Emission, Return};
use wavex_line::stage::{CURVE_POINTS_PER_SAMPLE, FittedBlock, FittedPeak, FittedSamples};
use wavex_signal::decompose::{DecomposeSettings, Decomposer, Decomposition, Return as Pulse};
use wavex_signal::outgoing::Outgoing;
use wavex_signal::sensor_model::ChannelModel;

/// A block of echoes with its fit.
pub struct SeenBlock {
    /// Samples, fitted curve and returns.
    pub shown: FittedBlock,
    /// Statistics of the fit.
    pub fit: BlockFit,
}

/// Outgoing pulse: the samples of the block and the fit of a window.
pub struct SeenPulse {
    /// Time of the first sample after the shot's clock, ns.
    pub start_ns: f64,
    /// Samples of the block, with the fitted curve.
    pub samples: FittedSamples,
    /// Pulse; its position counts from the block's first sample.
    pub pulse: Pulse,
    /// First sample of the fitted window.
    pub window: usize,
}

/// A block of echoes before the emission time is known.
struct Echoes {
    /// Time of the first sample after the shot's clock, ns.
    start_ns: f64,
    samples: FittedSamples,
    fit: BlockFit,
    /// Positions of the returns' peaks, samples after the first.
    peaks: Vec<f64>,
}

/// Collects the results of one shot.
pub struct Seen<'a> {
    line: &'a Blocks,
    blocks: Vec<Echoes>,
    outgoing: Option<SeenPulse>,
}

impl<'a> Seen<'a> {
    /// Creates an observer for a shot of the line with these blocks.
    pub fn new(line: &'a Blocks) -> Seen<'a> {
        Seen { line, blocks: Vec::new(), outgoing: None }
    }

    /// Returns the collected blocks in order of time, and the outgoing pulse.
    ///
    /// `emission` is the shot, `returns` are its returns.
    pub fn finish(mut self, emission: &Emission, returns: &[Return]) -> (Vec<SeenBlock>, Option<SeenPulse>) {
        self.blocks.sort_by(|a, b| a.start_ns.total_cmp(&b.start_ns));
        let shown = |echoes: Echoes| {
            let first_ns = echoes.start_ns - emission.emission_ns;
            let peak = |position_samples: f64| FittedPeak {
                number: number_at(returns, first_ns + position_samples * echoes.samples.interval_ns),
                position_samples,
            };
            let fit = echoes.fit;
            let shown = FittedBlock {
                channel: fit.channel.name().to_owned(),
                first_ns,
                chi_square: fit.chi_square,
                degrees_of_freedom: u32::try_from(fit.degrees_of_freedom).unwrap_or(u32::MAX),
                peaks: echoes.peaks.into_iter().map(peak).collect(),
                samples: echoes.samples,
            };
            SeenBlock { shown, fit }
        };
        (self.blocks.into_iter().map(shown).collect(), self.outgoing)
    }

    /// FittedSamples and fit of a block of which `window` was decomposed.
    ///
    /// Positions of returns count from the start of the window. `None` only for an invalid model.
    fn samples(
        &self,
        block: &Block,
        window: Range<usize>,
        found: &Decomposition,
        model: &ChannelModel,
    ) -> Option<FittedSamples> {
        let samples = self.line.samples(block);
        let mut decomposer = Decomposer::new(model, &DecomposeSettings::default(), window.len()).ok()?;
        decomposer.show(samples.get(window.clone())?, window.start, found);
        let window = window.start;
        let mut fitted_dn: Vec<f64> = samples.iter().map(|&sample| f64::from(sample)).collect();
        for (k, (fitted, signal)) in
            (window..).zip(fitted_dn.iter_mut().skip(window).zip(decomposer.signal_dn()))
        {
            *fitted = signal + model.background_at(k);
        }
        let pulses = 0..decomposer.returns().len();
        Some(FittedSamples {
            interval_ns: block.interval_ns,
            samples_dn: samples.to_vec(),
            fitted_dn,
            taken_at: (0..samples.len()).map(|k| model.digitiser.time_of(k)).collect(),
            full_scale_dn: model.full_scale_dn,
            used: decomposer.used().to_vec(),
            background_dn: mean_background_dn(model) + found.background_offset_dn,
            pulses_dn: pulses.map(|i| decomposer.pulse_curve(i, CURVE_POINTS_PER_SAMPLE)).collect(),
            residual: decomposer.standardised_residual().to_vec(),
        })
    }
}

impl Observer for Seen<'_> {
    fn outgoing(&mut self, block: &Block, outgoing: &Outgoing, model: &ChannelModel) {
        let Outgoing { pulse, window, .. } = outgoing.clone();
        let position_samples = pulse.position_samples - window.start as f64;
        let in_window = [Pulse { position_samples, ..pulse }];
        let found = Decomposition { returns: &in_window, ..Decomposition::default() };
        let samples = self.samples(block, window.clone(), &found, model);
        let (start_ns, window) = (block.start_ns, window.start);
        self.outgoing = samples.map(|samples| SeenPulse { start_ns, samples, pulse, window });
    }

    fn echoes(
        &mut self,
        block: &Block,
        fit: BlockFit,
        found: &Decomposition,
        peak_samples: impl Fn(&Pulse) -> f64,
        model: &ChannelModel,
    ) {
        let peaks = found.returns.iter().map(peak_samples).collect();
        let samples = self.samples(block, 0..block.len(), found, model);
        self.blocks.extend(samples.map(|samples| Echoes { start_ns: block.start_ns, samples, fit, peaks }));
    }
}

/// Number of the return whose peak has this time of flight.
fn number_at(returns: &[Return], flight_ns: f64) -> Option<u8> {
    let distance = |found: &Return| (found.time_of_flight_ns - flight_ns).abs();
    let nearest = returns.iter().min_by(|a, b| distance(a).total_cmp(&distance(b)));
    nearest.filter(|found| distance(found) < 1e-6).map(|found| found.return_number)
}

/// Mean background of a channel over the sample phases, DN.
fn mean_background_dn(model: &ChannelModel) -> f64 {
    model.background_dn.iter().sum::<f64>() / model.background_dn.len() as f64
}

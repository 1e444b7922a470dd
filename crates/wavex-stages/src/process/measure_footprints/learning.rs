//! Learns noise and response from the first lines of a beam.

use wavex_footprints::{EchoWidth, FootprintLearner, FootprintModel, LEAST_SHOTS, outgoing_fwhm_samples};
use wavex_line::scan_line::{Block, Blocks, Channel, ScanLine};
use wavex_line::stage::{Result, StageError};
use wavex_simd::statistics::median;

/// Width of outgoing pulses while none has shown its own, samples.
const USUAL_WIDTH_SAMPLES: f64 = 15.0;
/// Part of the echoes, the narrowest, that give the response without outgoing pulses.
const NARROWEST: f64 = 0.02;

/// Noise and response of a beam.
pub(super) struct Learnt {
    pub(super) model: FootprintModel,
    /// Number of echoes that gave the response, and number of clear ones; `None` if outgoing pulses gave it.
    pub(super) of_echoes: Option<[usize; 2]>,
}

/// Learns noise and response from the shots of lines.
pub(super) fn learnt(lines: &[ScanLine]) -> Result<Learnt> {
    let (mut widths, mut interval_ns) = (Vec::new(), 1.0);
    let is_outgoing = |channel: Channel| channel == Channel::Reference;
    each_block(lines, is_outgoing, |_, samples| widths.extend(outgoing_fwhm_samples(samples)));
    each_block(lines, Channel::is_echo, |block, _| interval_ns = block.interval_ns);
    let narrowest = if widths.len() < LEAST_SHOTS { NarrowestEchoes::of(lines) } else { None };
    let width = narrowest.as_ref().map_or_else(|| median(widths), |echoes| Some(echoes.fwhm_samples));
    let mut learner = FootprintLearner::new(interval_ns, width.unwrap_or(USUAL_WIDTH_SAMPLES) * interval_ns);
    match &narrowest {
        None => each_block(lines, is_outgoing, |_, samples| learner.add_outgoing(samples)),
        Some(echoes) => each_block(lines, Channel::is_echo, |_, samples| {
            if echoes.includes(samples) {
                learner.add_echo(samples);
            }
        }),
    }
    each_block(lines, Channel::is_echo, |_, samples| learner.add_waveform(samples));
    let model = learner.finish().map_err(|error| {
        StageError::failed(
            error.to_string(),
            "read a longer part of the beam, leave the beam out with `beams` of read_hdf5, or `load` the models that `save` wrote of the whole recording; small footprints are for `calibrate` and `decompose`",
        )
    })?;
    Ok(Learnt { model, of_echoes: narrowest.map(|echoes| [echoes.count, echoes.of]) })
}

/// The narrowest echoes of lines, which are as wide as the outgoing pulse if they are from flat ground.
struct NarrowestEchoes {
    /// Their median full width at half maximum, samples.
    fwhm_samples: f64,
    /// Their largest spread, samples.
    spread_samples: f64,
    /// Their number, and the number of clear echoes.
    count: usize,
    of: usize,
}

impl NarrowestEchoes {
    /// `None` if there are too few.
    fn of(lines: &[ScanLine]) -> Option<NarrowestEchoes> {
        let mut widths = Vec::new();
        each_block(lines, Channel::is_echo, |_, samples| widths.extend(EchoWidth::of(samples)));
        widths.sort_unstable_by(|a, b| a.spread_samples.total_cmp(&b.spread_samples));
        let count = ((NARROWEST * widths.len() as f64) as usize).max(LEAST_SHOTS);
        let narrowest = widths.get(..count)?;
        Some(NarrowestEchoes {
            fwhm_samples: median(narrowest.iter().map(|width| width.fwhm_samples))?,
            spread_samples: narrowest.last()?.spread_samples,
            count,
            of: widths.len(),
        })
    }

    fn includes(&self, samples: &[f32]) -> bool {
        EchoWidth::of(samples).is_some_and(|width| width.spread_samples <= self.spread_samples)
    }
}

/// Least and largest number of samples of the outgoing pulses; `None` if none are recorded.
pub(super) fn outgoing_samples(lines: &[ScanLine]) -> Option<[u64; 2]> {
    let blocks = lines.iter().filter_map(|line| line.blocks()).flat_map(Blocks::iter);
    let lengths = blocks.filter(|block| block.channel == Channel::Reference).map(|block| block.len() as u64);
    lengths.clone().min().zip(lengths.max()).map(|(least, most)| [least, most])
}

/// Gives each block of these channels with its samples.
fn each_block(lines: &[ScanLine], is_wanted: fn(Channel) -> bool, mut take: impl FnMut(&Block, &[f32])) {
    let mut samples = Vec::new();
    for blocks in lines.iter().filter_map(|line| line.blocks()) {
        for block in blocks.iter().filter(|block| is_wanted(block.channel)) {
            blocks.fractions_into(block, &mut samples);
            take(block, &samples);
        }
    }
}

//! Waveforms that are byte-identical copies of the previous shot's waveforms.
//!
//! Exporters and converters write such copies. They are no measurements of their own, so calibration and
//! statistics use each waveform once.

use super::{Block, Blocks, Channel, Content, ScanLine, emission_flags};

/// Fewest bits of information for equality to be no chance.
///
/// The information of a waveform is the entropy of its histogram times its number of samples. Silent
/// waveforms of a quiet digitiser are often equal by chance and have few bits; noise of 1 DN has two
/// bits per sample, and a pulse tens of bits.
const LEAST_BITS: f64 = 64.0;
/// Number of samples by which most waveforms differ from the previous shot's waveform.
const FIRST_SAMPLES: usize = 8;

impl ScanLine {
    /// Marks the shots whose echo blocks are copies of the previous shot's blocks in the line; returns their
    /// number.
    ///
    /// The first shot of a line has none before it, so that a line alone has the marks that it has in a run.
    pub fn mark_copies(&mut self) -> u64 {
        let Content::Shots(blocks) = &self.content else { return 0 };
        self.emissions.iter_mut().for_each(|emission| emission.flags &= !emission_flags::COPY);
        let mut copies = 0;
        let mut last: Option<(u32, Option<&[u16; FIRST_SAMPLES]>)> = None;
        for block in blocks.iter().filter(|block| block.channel.is_echo()) {
            let index = block.emission;
            if last.is_some_and(|(earlier, _)| earlier == index) {
                continue;
            }
            let samples = blocks.samples(block).first_chunk();
            // The first samples of two waveforms nearly always differ, so this costs little.
            let may_be_copy = last.is_some_and(|(earlier, other)| earlier + 1 == index && samples == other);
            if may_be_copy
                && are_copies(echoes(blocks, index), echoes(blocks, index - 1))
                && let Some(emission) = self.emissions.get_mut(index as usize)
            {
                emission.flags |= emission_flags::COPY;
                copies += 1;
            }
            last = Some((index, samples));
        }
        copies
    }

    /// Number of waveforms without copies.
    pub fn distinct_waveforms(&self) -> u64 {
        let copies = self.emissions.iter().filter(|emission| emission.is_copy()).count() as u64;
        self.stats.nw.saturating_sub(copies)
    }

    /// Echo blocks and outgoing pulses of shots that are not copies; none after decomposition.
    pub fn distinct_blocks(&self) -> impl Iterator<Item = &Block> + Clone {
        let is_copy = |block: &Block| {
            self.emissions.get(block.emission as usize).is_some_and(|emission| emission.is_copy())
        };
        self.blocks().into_iter().flat_map(Blocks::iter).filter(move |block| !is_copy(block))
    }
}

/// Channels and samples of the echo blocks of a shot.
fn echoes(blocks: &Blocks, index: u32) -> impl Iterator<Item = (Channel, &[u16])> + Clone {
    let of_shot = blocks.of_emission(index).map(|(_, block)| block);
    of_shot.filter(|block| block.channel.is_echo()).map(|block| (block.channel, blocks.samples(block)))
}

/// Whether the echo blocks of two shots are equal, but not by chance.
fn are_copies<'a>(
    own: impl Iterator<Item = (Channel, &'a [u16])> + Clone,
    others: impl Iterator<Item = (Channel, &'a [u16])>,
) -> bool {
    own.clone().eq(others) && own.map(|(_, samples)| information_bits(samples)).sum::<f64>() >= LEAST_BITS
}

/// Entropy of the histogram of samples, times their number, bits.
fn information_bits(samples: &[u16]) -> f64 {
    let mut sorted = samples.to_vec();
    sorted.sort_unstable();
    let n = samples.len() as f64;
    let bits = |equal: &[u16]| equal.len() as f64 * (n / equal.len() as f64).log2();
    sorted.chunk_by(|a, b| a == b).map(bits).sum()
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::super::{Emission, InputInfo};
    use super::*;

    /// Noise of a few digitiser steps, different for each seed.
    fn noise(seed: u32, samples: u32) -> Vec<u16> {
        let mixed = |k: u32| (seed * 7919 + k).wrapping_mul(2_654_435_761) >> 27;
        (0..samples).map(|k| 10 + (mixed(k) % 5) as u16).collect()
    }

    /// Marks of shots whose low-power waveforms are these; each has the same outgoing pulse.
    fn marks(waveforms: &[Vec<u16>]) -> Vec<bool> {
        let mut blocks = Blocks::default();
        for (index, samples) in (0..).zip(waveforms) {
            blocks.push(index, Channel::Reference, None, 0.0, 1.0, &noise(99, 40));
            blocks.push(index, Channel::LowPower, None, 0.0, 1.0, samples);
        }
        let emissions = vec![Emission::default(); waveforms.len()];
        let mut line = ScanLine::of_shots(Arc::new(InputInfo::default()), 0, emissions, blocks);
        let copies = line.mark_copies();
        let marks: Vec<bool> = line.emissions.iter().map(Emission::is_copy).collect();
        assert_eq!(copies as usize, marks.iter().filter(|is_copy| **is_copy).count());
        assert_eq!(line.distinct_waveforms(), line.stats.nw - copies);
        assert_eq!(line.distinct_blocks().count() as u64, 2 * line.distinct_waveforms());
        assert_eq!(line.mark_copies(), copies, "marks are set anew");
        marks
    }

    #[test]
    fn copies_of_the_shot_before_are_marked() {
        let [a, b] = [noise(1, 60), noise(2, 60)];
        let shots = [a.clone(), a.clone(), a.clone(), b.clone(), a.clone(), b];
        assert_eq!(marks(&shots), [false, true, true, false, false, false]);
        let mut changed = a.clone();
        changed[59] += 1;
        assert_eq!(marks(&[a.clone(), changed]), [false, false]);
        assert_eq!(marks(&[a.clone(), a[..59].to_vec()]), [false, false]);
    }

    #[test]
    fn silent_and_short_waveforms_may_be_equal() {
        let mut nearly_flat = vec![10; 60];
        (nearly_flat[7], nearly_flat[31]) = (11, 9);
        for equal in [vec![10; 400], nearly_flat, noise(1, 20), Vec::new()] {
            assert_eq!(marks(&[equal.clone(), equal]), [false, false]);
        }
    }

    #[test]
    fn all_receivers_must_be_equal() {
        let mut blocks = Blocks::default();
        for index in 0..3 {
            blocks.push(index, Channel::LowPower, None, 0.0, 1.0, &noise(1, 60));
            if index != 1 {
                blocks.push(index, Channel::HighPower, None, 0.0, 1.0, &noise(2 + index, 60));
            }
        }
        let input = Arc::new(InputInfo::default());
        let mut line = ScanLine::of_shots(input, 0, vec![Emission::default(); 3], blocks);
        assert_eq!(line.mark_copies(), 0);
    }
}

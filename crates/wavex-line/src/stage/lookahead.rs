//! Holds back the first lines of a recording for a transform that learns from them.

use super::Output;
use crate::scan_line::{Channel, ScanLine};
use wavex_signal::gain::Recorded;

/// Lines held back until they contain enough waveforms.
#[derive(Debug)]
pub struct LookAhead {
    lines: Vec<ScanLine>,
    bytes: usize,
    waveforms: u64,
    wanted: u64,
}

impl LookAhead {
    /// Default number of waveforms that a stage learns from.
    pub const WAVEFORMS: u64 = 100_000;

    /// Creates a buffer for `wanted` waveforms.
    pub fn new(wanted: u64) -> LookAhead {
        LookAhead { lines: Vec::new(), bytes: 0, waveforms: 0, wanted }
    }

    /// A full buffer of these lines.
    pub fn of(lines: Vec<ScanLine>) -> LookAhead {
        LookAhead { lines, ..LookAhead::new(0) }
    }

    /// Holds back a line; returns whether the buffer is full.
    ///
    /// It is full when it contains enough waveforms or has reached its memory limit. In the second
    /// case, notes that `done` was based on fewer waveforms.
    pub fn hold(&mut self, line: ScanLine, done: &str, out: &mut Output) -> bool {
        self.waveforms += line.distinct_waveforms();
        self.bytes += line.bytes();
        self.lines.push(line);
        let is_full = self.bytes > out.may_hold_bytes();
        if is_full && self.waveforms < self.wanted {
            out.cx.warn(format!(
                "{done} from {} waveforms instead of {}: more do not fit into memory_mb",
                self.waveforms, self.wanted
            ));
        }
        is_full || self.waveforms >= self.wanted
    }

    /// Lines held back.
    pub fn lines(&self) -> &[ScanLine] {
        &self.lines
    }

    /// Samples of a channel, one slice per block that is neither empty nor too long, without copies.
    pub fn samples(&self, channel: Channel) -> impl Iterator<Item = &[u16]> + Clone {
        self.recorded(channel).map(|block| block.samples)
    }

    /// Returns the samples of each block with its gain, without copies.
    pub fn recorded(&self, channel: Channel) -> impl Iterator<Item = Recorded<'_>> + Clone {
        self.lines.iter().filter_map(|line| Some((line, line.blocks()?))).flat_map(move |(line, blocks)| {
            let of_channel = line
                .distinct_blocks()
                .filter(move |block| block.channel == channel && !block.is_empty() && !block.is_too_long());
            of_channel.map(|block| Recorded { samples: blocks.samples(block), gain: block.gain })
        })
    }

    /// Removes and returns the lines, in order.
    pub fn release(&mut self) -> Vec<ScanLine> {
        self.bytes = 0;
        std::mem::take(&mut self.lines)
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::scan_line::{Blocks, Emission, InputInfo, emission_flags};
    use crate::stage::Context;

    /// A line of ten waveforms.
    fn line() -> ScanLine {
        let mut blocks = Blocks::default();
        for shot in 0..10 {
            blocks.push(shot, Channel::LowPower, None, 0.0, 1.0, &[2; 40]);
        }
        ScanLine::of_shots(Arc::new(InputInfo::default()), 0, vec![Emission::default(); 10], blocks)
    }

    /// Number of lines held until the buffer is full, and the notes.
    fn held(wanted: u64, may_hold_bytes: usize) -> (usize, Vec<String>) {
        let (mut look_ahead, mut cx) = (LookAhead::new(wanted), Context::default());
        let mut emit = |_: ScanLine| Ok(());
        let mut out = Output::new(&mut cx, may_hold_bytes, &mut emit);
        while !look_ahead.hold(line(), "calibrated", &mut out) {}
        (look_ahead.release().len(), cx.counters().notes.clone())
    }

    #[test]
    fn lines_are_held_until_there_are_enough_waveforms_or_no_more_memory() {
        assert_eq!(held(35, usize::MAX), (4, Vec::new()));
        let few = "calibrated from 20 waveforms instead of 35: more do not fit into memory_mb";
        assert_eq!(held(35, 2 * line().bytes() - 1), (2, vec![few.to_owned()]));
        assert_eq!(held(20, 2 * line().bytes() - 1), (2, Vec::new()));
    }

    #[test]
    fn samples_are_those_of_a_channel() {
        let look_ahead = LookAhead::of(vec![line(), line()]);
        assert_eq!(look_ahead.samples(Channel::LowPower).count(), 20);
        assert_eq!(look_ahead.recorded(Channel::LowPower).next().unwrap().samples, [2; 40]);
        assert_eq!(look_ahead.samples(Channel::HighPower).count(), 0);
    }

    #[test]
    fn copies_are_neither_samples_nor_waveforms() {
        let mut copied = line();
        copied.emissions[3].flags = emission_flags::COPY;
        assert_eq!(LookAhead::of(vec![line(), copied.copied()]).samples(Channel::LowPower).count(), 19);
        let (mut look_ahead, mut cx) = (LookAhead::new(10), Context::default());
        let mut emit = |_: ScanLine| Ok(());
        assert!(!look_ahead.hold(copied, "calibrated", &mut Output::new(&mut cx, usize::MAX, &mut emit)));
    }
}

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
        self.waveforms += line.stats.nw;
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

    /// Samples of a channel, one slice per non-empty block.
    pub fn samples(&self, channel: Channel) -> impl Iterator<Item = &[u16]> + Clone {
        self.lines.iter().filter_map(ScanLine::blocks).flat_map(move |blocks| {
            let of_channel = blocks.iter().filter(move |block| block.channel == channel && !block.is_empty());
            of_channel.map(|block| blocks.samples(block))
        })
    }

    /// Returns the samples of each block with its gain.
    pub fn recorded(&self, channel: Channel) -> impl Iterator<Item = Recorded<'_>> + Clone {
        self.lines.iter().filter_map(ScanLine::blocks).flat_map(move |blocks| {
            let of_channel = blocks.iter().filter(move |block| block.channel == channel && !block.is_empty());
            of_channel.map(|block| Recorded { samples: blocks.samples(block), gain: block.gain })
        })
    }

    /// Removes and returns the lines, in order.
    pub fn release(&mut self) -> Vec<ScanLine> {
        self.bytes = 0;
        std::mem::take(&mut self.lines)
    }
}

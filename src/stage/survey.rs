//! The first lines of a recording, held back by a transform that learns from them.

use super::Output;
use crate::batch::{Batch, Channel};
use crate::kernels::gain::Recorded;

/// Lines that are held back until there are enough.
#[derive(Debug)]
pub struct Survey {
    lines: Vec<Batch>,
    bytes: usize,
    waveforms: u64,
    wanted: u64,
}

impl Survey {
    /// Of so many waveforms.
    pub fn new(wanted: u64) -> Survey {
        Survey { lines: Vec::new(), bytes: 0, waveforms: 0, wanted }
    }

    /// Holds back a line. Returns whether there are waveforms enough, or no memory for more: then what was `done` from them
    /// was done from fewer, which is noted.
    pub fn hold(&mut self, batch: Batch, done: &str, out: &mut Output) -> bool {
        self.waveforms += batch.stats.nw;
        self.bytes += batch.bytes();
        self.lines.push(batch);
        let is_full = self.bytes > out.may_hold_bytes();
        if is_full && self.waveforms < self.wanted {
            out.cx.note(format!(
                "{done} from {} waveforms instead of {}: more do not fit into memory_mb",
                self.waveforms, self.wanted
            ));
        }
        is_full || self.waveforms >= self.wanted
    }

    /// The lines at hand.
    pub fn lines(&self) -> &[Batch] {
        &self.lines
    }

    /// The samples that a receiver recorded in them, block after block; empty blocks are left out.
    pub fn samples(&self, channel: Channel) -> impl Iterator<Item = &[u16]> + Clone {
        self.lines.iter().filter_map(Batch::blocks).flat_map(move |blocks| {
            let of_channel = blocks.iter().filter(move |block| block.channel == channel && !block.is_empty());
            of_channel.map(|block| blocks.samples(block))
        })
    }

    /// The same with the gain of each block.
    pub fn recorded(&self, channel: Channel) -> impl Iterator<Item = Recorded<'_>> + Clone {
        self.lines.iter().filter_map(Batch::blocks).flat_map(move |blocks| {
            let of_channel = blocks.iter().filter(move |block| block.channel == channel && !block.is_empty());
            of_channel.map(|block| Recorded { samples: blocks.samples(block), gain: block.gain })
        })
    }

    /// Lets go of the lines, in their order.
    pub fn release(&mut self) -> Vec<Batch> {
        self.bytes = 0;
        std::mem::take(&mut self.lines)
    }
}

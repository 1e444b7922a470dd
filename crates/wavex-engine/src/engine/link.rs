//! Channels between stages.

use std::collections::BTreeMap;

use crossbeam_channel::{Receiver, Sender};

use wavex_line::scan_line::ScanLine;
use wavex_line::stage::{Result, StageError};

/// Message in a channel.
#[expect(
    clippy::large_enum_variant,
    reason = "an End is sent once: a box per line would cost more than it saves"
)]
pub(super) enum LinkMessage {
    /// A line with its position in the stream.
    Line(u64, ScanLine),
    /// The sender is finished.
    End,
}

/// Receiving end of a worker.
pub(super) struct Inlet {
    channel: Receiver<LinkMessage>,
    /// Number of senders that have not yet sent `End`.
    senders: usize,
    order: Order,
}

/// Order in which a worker receives lines.
enum Order {
    /// As received: the worker belongs to a pool.
    Any,
    /// As sent into the stream; lines that arrive early wait, limited by `memory_mb`.
    Sequence { next: u64, early: BTreeMap<u64, ScanLine> },
}

/// Sending end of a worker.
pub(super) struct Outlet {
    channel: Sender<LinkMessage>,
    receivers: usize,
}

/// Creates the channel between two stages with these numbers of workers.
///
/// Clone the outlet and the inlet for each worker.
pub(super) fn link(capacity: usize, senders: usize, receivers: usize) -> (Outlet, Inlet) {
    let (sender, receiver) = crossbeam_channel::bounded(capacity.max(1));
    (Outlet { channel: sender, receivers }, Inlet::new(receiver, senders, receivers == 1))
}

impl Inlet {
    fn new(channel: Receiver<LinkMessage>, senders: usize, ordered: bool) -> Inlet {
        let order = if ordered { Order::Sequence { next: 0, early: BTreeMap::new() } } else { Order::Any };
        Inlet { channel, senders, order }
    }

    /// The same channel for another worker of the pool.
    pub(super) fn another(&self) -> Inlet {
        Inlet::new(self.channel.clone(), self.senders, matches!(self.order, Order::Sequence { .. }))
    }

    /// Receives the next line; `None` when every sender has finished.
    pub(super) fn next(&mut self) -> Result<Option<(u64, ScanLine)>> {
        loop {
            if let Order::Sequence { next, early } = &mut self.order
                && let Some(line) = early.remove(next)
            {
                *next += 1;
                return Ok(Some((*next - 1, line)));
            }
            if self.senders == 0 {
                return Ok(None);
            }
            // A disconnect without `End` is a consequence of a failure elsewhere.
            match self.channel.recv().map_err(|_| StageError::Stopped)? {
                LinkMessage::End => self.senders -= 1,
                LinkMessage::Line(place, line) => match &mut self.order {
                    Order::Any => return Ok(Some((place, line))),
                    Order::Sequence { early, .. } => {
                        early.insert(place, line);
                    }
                },
            }
        }
    }
}

impl Outlet {
    /// The same channel for another worker of the pool.
    pub(super) fn another(&self) -> Outlet {
        Outlet { channel: self.channel.clone(), receivers: self.receivers }
    }

    /// Sends a line; blocks while the channel is full.
    pub(super) fn send(&self, place: u64, line: ScanLine) -> Result<()> {
        self.channel.send(LinkMessage::Line(place, line)).map_err(|_| StageError::Stopped)
    }

    /// Sends the end mark to each receiver.
    pub(super) fn end(&self) -> Result<()> {
        (0..self.receivers)
            .try_for_each(|_| self.channel.send(LinkMessage::End).map_err(|_| StageError::Stopped))
    }
}

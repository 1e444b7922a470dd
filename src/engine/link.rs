//! The channels between stages.

use std::collections::BTreeMap;

use crossbeam_channel::{Receiver, Sender};

use crate::batch::Batch;
use crate::stage::{Result, StageError};

/// What travels in a channel.
#[expect(
    clippy::large_enum_variant,
    reason = "an End is sent once: a box per line would cost more than it saves"
)]
pub(super) enum Message {
    /// A line, and its place in the stream.
    Line(u64, Batch),
    /// The sender has no more.
    End,
}

/// Where a worker takes its lines from.
pub(super) struct Inlet {
    channel: Receiver<Message>,
    /// How many `End`s close the stream for this worker: one from each sender.
    senders: usize,
    order: Order,
}

/// In which order a worker takes lines.
enum Order {
    /// As they come: the worker is one of a pool.
    Any,
    /// As they were sent into the stream: lines that come early wait. `memory_mb` bounds how many.
    Sequence { next: u64, early: BTreeMap<u64, Batch> },
}

/// Where a worker gives its lines on.
pub(super) struct Outlet {
    channel: Sender<Message>,
    receivers: usize,
}

/// The channel between a stage of `senders` workers and one of `receivers`: an outlet and an inlet, to be cloned for each
/// worker.
pub(super) fn link(capacity: usize, senders: usize, receivers: usize) -> (Outlet, Inlet) {
    let (sender, receiver) = crossbeam_channel::bounded(capacity.max(1));
    (Outlet { channel: sender, receivers }, Inlet::new(receiver, senders, receivers == 1))
}

impl Inlet {
    fn new(channel: Receiver<Message>, senders: usize, ordered: bool) -> Inlet {
        let order = if ordered { Order::Sequence { next: 0, early: BTreeMap::new() } } else { Order::Any };
        Inlet { channel, senders, order }
    }

    /// The same channel for another worker of the pool.
    pub(super) fn another(&self) -> Inlet {
        Inlet::new(self.channel.clone(), self.senders, matches!(self.order, Order::Sequence { .. }))
    }

    /// The next line for this worker; `None` when every sender has said that it has no more.
    pub(super) fn next(&mut self) -> Result<Option<(u64, Batch)>> {
        loop {
            if let Order::Sequence { next, early } = &mut self.order
                && let Some(batch) = early.remove(next)
            {
                *next += 1;
                return Ok(Some((*next - 1, batch)));
            }
            if self.senders == 0 {
                return Ok(None);
            }
            // A channel that hangs up without an `End` is the echo of a failure elsewhere.
            match self.channel.recv().map_err(|_| StageError::Stopped)? {
                Message::End => self.senders -= 1,
                Message::Line(place, batch) => match &mut self.order {
                    Order::Any => return Ok(Some((place, batch))),
                    Order::Sequence { early, .. } => {
                        early.insert(place, batch);
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

    /// Gives a line on; waits while the channel is full.
    pub(super) fn send(&self, place: u64, batch: Batch) -> Result<()> {
        self.channel.send(Message::Line(place, batch)).map_err(|_| StageError::Stopped)
    }

    /// Says, to each receiver, that this sender has no more.
    pub(super) fn end(&self) -> Result<()> {
        (0..self.receivers).try_for_each(|_| self.channel.send(Message::End).map_err(|_| StageError::Stopped))
    }
}

//! Result of the fit of an outgoing pulse.

use std::ops::Range;

use crate::decompose::Return;

/// An outgoing pulse and the samples to which it was fitted.
#[derive(Debug, Clone, PartialEq)]
pub struct Outgoing {
    /// The pulse; its position counts from the block's first sample.
    pub pulse: Return,
    /// Indices of the fitted samples.
    pub window: Range<usize>,
    /// Whether one pulse, or a pulse and an echo, explains the samples. `false` before
    /// [`OutgoingBatch::judge`](super::OutgoingBatch::judge) and for pulses that it does not examine.
    pub is_explained: bool,
}

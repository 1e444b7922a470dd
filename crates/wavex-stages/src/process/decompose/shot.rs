//! A shot to decompose, and its emission time.

use wavex_line::scan_line::{Block, Blocks, InputInfo};
use wavex_signal::flags;

/// Flags of returns for which the low-power receiver is not sufficient.
pub(super) const BLINDED: u16 = flags::SATURATED | flags::EXTREMELY_SATURATED | flags::OVERDRIVEN;

/// Emission time of a shot after its clock.
#[derive(Clone, Copy)]
pub(super) struct EmissionTime {
    pub(super) time_ns: f64,
    pub(super) sd_ns: f64,
    /// Flag bits of all returns of the shot.
    pub(super) flags: u16,
}

impl EmissionTime {
    /// Emission at the clock, with this SD, ns.
    pub(super) fn of_clock(sd_ns: f64) -> EmissionTime {
        EmissionTime { time_ns: 0.0, sd_ns, flags: 0 }
    }
}

/// One shot of a line.
pub struct ShotBlocks<'a> {
    /// Index of the shot in its line.
    pub index: u32,
    /// Blocks of the line.
    pub blocks: &'a Blocks,
    /// Blocks of the shot.
    pub of_shot: &'a [Block],
    /// Metadata of the recording.
    pub input: &'a InputInfo,
}

//! Counters of a scan line.

use super::Filtered;

/// Counters of a scan line; `np...` count returns, `nw...` waveforms.
///
/// Two invariants hold after `decompose`: `n_candidates + n_added + np_online = np + np_filtered +
/// np_merged + np_xtalk_dropped` and `nw = nw_empty + nw_deleted + nw_with_points`.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct LineStats {
    /// Time of the first shot, s; NaN if unknown.
    ///
    /// In the time scale of the input.
    pub gps_time_s: f64,
    /// Waveforms: shots with at least one echo block.
    pub nw: u64,
    /// Returns kept, withheld ones included.
    pub np: u64,
    /// Returns kept that have a cross-talk flag, bits 3 to 5.
    pub np_xtalk: u64,
    /// Dropped candidates and returns, by reason; their sum is `np_filtered`.
    pub filtered: Filtered,
    /// Candidates merged with another.
    pub np_merged: u64,
    /// Outliers above their neighbours.
    pub np_air: u64,
    /// Outliers below their neighbours.
    pub np_low: u64,
    /// Returns whose intensity was corrected for range.
    pub np_range: u64,
    /// Returns whose intensity was corrected for the atmosphere.
    pub np_atm: u64,
    /// Returns whose range was corrected for amplitude.
    pub np_ibrc: u64,
    /// Returns whose amplitude was corrected by the instrument's table.
    pub np_ibic: u64,
    /// Waveforms without any return.
    pub nw_empty: u64,
    /// Waveforms with saturated samples.
    pub nw_saturated: u64,
    /// Waveforms that needed iterative refinement.
    pub nw_refined1x: u64,
    /// Waveforms that needed a second iterative refinement.
    pub nw_refined2x: u64,
    /// Unusable waveforms.
    pub nw_deleted: u64,
    /// Waveforms with a return truncated by the edge of its block.
    pub nw_truncated: u64,
    /// Points with coordinates.
    pub n_georef: u64,
    /// Height above ground of the line, m, if known.
    pub agl_m: Option<f64>,
    /// Candidates found by the first detection pass.
    pub n_candidates: u64,
    /// Candidates added by later passes.
    pub n_added: u64,
    /// Waveforms with at least one return.
    pub nw_with_points: u64,
    /// Returns dropped because they overlap cross-talk from an emission.
    pub np_xtalk_dropped: u64,
    /// Returns computed by the instrument itself.
    pub np_online: u64,
}

impl LineStats {
    /// Number of dropped candidates and returns, for all reasons.
    pub fn np_filtered(&self) -> u64 {
        self.filtered.total()
    }

    /// Returns every counter with its name, in field order.
    pub fn counts(&self) -> [(&'static str, u64); 23] {
        [
            ("nw", self.nw),
            ("np", self.np),
            ("np_xtalk", self.np_xtalk),
            ("np_filtered", self.np_filtered()),
            ("np_merged", self.np_merged),
            ("np_air", self.np_air),
            ("np_low", self.np_low),
            ("np_range", self.np_range),
            ("np_atm", self.np_atm),
            ("np_ibrc", self.np_ibrc),
            ("np_ibic", self.np_ibic),
            ("nw_empty", self.nw_empty),
            ("nw_saturated", self.nw_saturated),
            ("nw_refined1x", self.nw_refined1x),
            ("nw_refined2x", self.nw_refined2x),
            ("nw_deleted", self.nw_deleted),
            ("nw_truncated", self.nw_truncated),
            ("n_georef", self.n_georef),
            ("n_candidates", self.n_candidates),
            ("n_added", self.n_added),
            ("nw_with_points", self.nw_with_points),
            ("np_xtalk_dropped", self.np_xtalk_dropped),
            ("np_online", self.np_online),
        ]
    }

    /// Returns whether both invariants hold.
    pub fn laws_hold(&self) -> bool {
        self.n_candidates + self.n_added + self.np_online
            == self.np + self.np_filtered() + self.np_merged + self.np_xtalk_dropped
            && self.nw == self.nw_empty + self.nw_deleted + self.nw_with_points
    }
}

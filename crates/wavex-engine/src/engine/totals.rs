//! Totals of the lines that have left the chain.

use std::collections::BTreeMap;
use std::sync::Arc;

use wavex_line::scan_line::{InputInfo, ScanLine};
use wavex_signal::fusion::ChannelFusion;
use wavex_signal::sensor_model::SensorModel;

/// Counters of lines that have left the chain, with what the first lines carry.
#[derive(Clone, Debug, Default)]
pub(super) struct LineTotals {
    pub(super) counts: BTreeMap<&'static str, u64>,
    /// `np_filtered` by the text of its reasons.
    pub(super) filtered: BTreeMap<&'static str, u64>,
    pub(super) input: Option<Arc<InputInfo>>,
    pub(super) model: Option<Arc<SensorModel>>,
    pub(super) fusion: Option<Arc<ChannelFusion>>,
}

impl LineTotals {
    pub(super) fn add(&mut self, line: &ScanLine) {
        for (name, count) in line.stats.counts() {
            *self.counts.entry(name).or_default() += count;
        }
        for (reason, count) in line.stats.filtered.counts() {
            *self.filtered.entry(reason.text()).or_default() += count;
        }
        if self.input.as_ref().is_none_or(|input| input.first_shot.is_none()) {
            self.input = Some(Arc::clone(&line.input));
        }
        if self.model.is_none() {
            self.model.clone_from(&line.model);
        }
        if self.fusion.is_none() {
            self.fusion.clone_from(&line.fusion);
        }
    }
}

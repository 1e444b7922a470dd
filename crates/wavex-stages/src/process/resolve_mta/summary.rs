//! Zone statistics for the report.

use wavex_line::stage::Context;
use wavex_returns::mta::Resolver;

/// Counts echoes per zone.
pub(super) struct MtaCounts {
    blind_gap_ns: f64,
}

impl MtaCounts {
    pub fn new(blind_gap_ns: f64) -> MtaCounts {
        MtaCounts { blind_gap_ns }
    }

    /// Records the assignment of a group of blocks.
    pub fn add(&self, zone: i16, margin_nats: f32, is_uncertain: bool, cx: &mut Context) {
        cx.observe("mta_zone", f64::from(zone));
        cx.observe("mta_uncertain", f64::from(u8::from(is_uncertain)));
        if margin_nats.is_finite() {
            cx.observe("mta_margin_nats", f64::from(margin_nats));
        }
    }

    /// Reports the totals of the recording.
    pub fn tell(&self, resolver: &Resolver, cx: &mut Context) {
        let summary = resolver.summary();
        if summary.interval_rms_ns().is_finite() {
            cx.observe("pulse_interval_ns", summary.interval_ns());
            cx.observe("pulse_interval_rms_ns", summary.interval_rms_ns());
        }
        if summary.echoes == 0 {
            return;
        }
        let zones = summary.zones.iter().enumerate().filter(|(_, count)| **count > 0);
        let zones: Vec<String> = zones.map(|(zone, count)| format!("{count} in {zone}")).collect();
        let percent = |count: u64| 100.0 * count as f64 / summary.echoes as f64;
        cx.info(format!(
            "echoes by zone: {}; {} without a cause, {:.2} % uncertain, {:.2} % within {} ns of an emission",
            zones.join(", "),
            summary.without_cause,
            percent(summary.uncertain),
            percent(summary.in_blind_gap),
            self.blind_gap_ns
        ));
        resolver.warnings().iter().for_each(|warning| cx.warn(warning.to_string()));
    }
}

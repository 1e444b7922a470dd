//! Results of a stage.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::Serialize;

use super::meter::{Meter, WorkInterval};
use crate::job::JobStage;
use wavex_line::stage::{Counters, Distribution, Item, Reason, RoleName};

/// Results of a stage.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub struct StageSummary {
    /// Name in the job.
    pub id: String,
    /// Type of the stage.
    pub r#type: String,
    /// Role of the stage.
    pub role: RoleName,
    /// Number of workers.
    pub workers: usize,
    /// Input scan lines.
    pub lines_in: u64,
    /// Output scan lines.
    pub lines_out: u64,
    /// Input items.
    pub items_in: ItemCounts,
    /// Output items.
    pub items_out: ItemCounts,
    /// Number of rejected items, by `item: reason`.
    pub rejected: BTreeMap<String, u64>,
    /// Entries of `rejected` that lose no data.
    pub set_aside: Vec<String>,
    /// Measured quantities.
    pub observed: BTreeMap<String, Percentiles>,
    /// Warnings of the stage.
    pub notes: Vec<String>,
    /// Consequences of causes that other stages warn of, by cause.
    pub consequences: BTreeMap<&'static str, Vec<String>>,
    /// Findings that need no action.
    pub findings: Vec<String>,
    /// Working time, s, summed over all workers.
    pub working_s: f64,
    /// Time waiting for input, s, summed over all workers.
    pub waiting_s: f64,
    /// Time waiting for space in the output, s, summed over all workers.
    pub blocked_s: f64,
    /// Working time per scan line, microseconds.
    pub line_us: Percentiles,
    #[serde(skip)]
    #[schemars(skip)]
    pub(super) spans: Vec<WorkInterval>,
}

/// Item counts by type.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, JsonSchema)]
pub struct ItemCounts {
    /// Shots.
    pub shots: u64,
    /// Sample blocks.
    pub blocks: u64,
    /// Returns and points.
    pub returns: u64,
}

/// Mean, percentiles and maximum of a distribution.
#[derive(Clone, Copy, Debug, Serialize, JsonSchema)]
pub struct Percentiles {
    /// Number of values.
    pub count: u64,
    /// Mean.
    pub mean: f64,
    /// Median.
    pub p50: f64,
    /// 90th percentile.
    pub p90: f64,
    /// 99th percentile.
    pub p99: f64,
    /// 99.9th percentile.
    pub p999: f64,
    /// Maximum.
    pub max: f64,
}

impl From<[u64; 3]> for ItemCounts {
    fn from([shots, blocks, returns]: [u64; 3]) -> ItemCounts {
        ItemCounts { shots, blocks, returns }
    }
}

impl ItemCounts {
    /// Count of one item type.
    pub fn of(&self, item: Item) -> u64 {
        match item {
            Item::Shots => self.shots,
            Item::Blocks => self.blocks,
            Item::Returns => self.returns,
        }
    }
}

impl From<&Distribution> for Percentiles {
    fn from(values: &Distribution) -> Percentiles {
        Percentiles {
            count: values.count(),
            mean: values.mean(),
            p50: values.percentile(50.0),
            p90: values.percentile(90.0),
            p99: values.percentile(99.0),
            p999: values.percentile(99.9),
            max: values.max(),
        }
    }
}

impl Percentiles {
    fn of_latency(latency_ns: &hdrhistogram::Histogram<u64>) -> Percentiles {
        let us = |percent| latency_ns.value_at_percentile(percent) as f64 / 1e3;
        Percentiles {
            count: latency_ns.len(),
            mean: latency_ns.mean() / 1e3,
            p50: us(50.0),
            p90: us(90.0),
            p99: us(99.0),
            p999: us(99.9),
            max: latency_ns.max() as f64 / 1e3,
        }
    }
}

/// Item and reason of a rejection.
fn dropped((item, reason): &(Item, Reason)) -> String {
    format!("{}: {reason}", item.name())
}

impl StageSummary {
    pub(super) fn new(stage: &JobStage, workers: usize, meter: Meter, counters: Counters) -> StageSummary {
        let expected = counters.rejected.keys().filter(|(_, reason)| reason.is_expected());
        let mut consequences: BTreeMap<&'static str, Vec<String>> = BTreeMap::new();
        for (cause, text) in counters.consequences {
            consequences.entry(cause.words()).or_default().push(text);
        }
        StageSummary {
            id: stage.id.clone(),
            r#type: stage.spec.name.to_string(),
            role: stage.spec.role,
            workers,
            lines_in: meter.lines_in,
            lines_out: meter.lines_out,
            items_in: meter.items_in.into(),
            items_out: meter.items_out.into(),
            rejected: counters.rejected.iter().map(|(what, n)| (dropped(what), *n)).collect(),
            set_aside: expected.map(dropped).collect(),
            observed: counters.observed.iter().map(|(name, d)| (name.to_string(), d.into())).collect(),
            notes: counters.notes,
            consequences,
            findings: counters.findings,
            working_s: meter.working.as_secs_f64(),
            waiting_s: meter.waiting.as_secs_f64(),
            blocked_s: meter.blocked.as_secs_f64(),
            line_us: Percentiles::of_latency(&meter.latency_ns),
            spans: meter.spans,
        }
    }

    /// Warnings, then consequences with their causes.
    pub fn warnings(&self) -> impl Iterator<Item = String> {
        let of_cause =
            |(cause, texts): (&&'static str, &Vec<String>)| format!("{cause}: {}", texts.join("; "));
        self.notes.iter().cloned().chain(self.consequences.iter().map(of_cause))
    }

    /// Number of rejected items of this type, for all reasons.
    pub fn rejected_of(&self, item: Item) -> u64 {
        let prefix = format!("{}: ", item.name());
        self.rejected.iter().filter(|(what, _)| what.starts_with(&prefix)).map(|(_, n)| n).sum()
    }

    /// Mean fraction of the run during which each worker was busy.
    pub fn load(&self, wall_s: f64) -> f64 {
        self.working_s / (self.workers as f64 * wall_s).max(1e-9)
    }
}

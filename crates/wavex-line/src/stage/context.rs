//! Counters and messages of a stage.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, Mutex};

use hdrhistogram::Histogram;

use super::{Cause, FinishedFile, RunObserver};
use crate::reason::{Item, Reason};
use crate::scan_line::ScanLine;
use crate::system::Unpoisoned as _;

impl Item {
    /// Number of such items in a scan line.
    pub fn count(self, line: &ScanLine) -> u64 {
        match self {
            Item::Shots => line.emissions.len() as u64,
            Item::Blocks => line.blocks().map_or(0, |blocks| blocks.len()) as u64,
            Item::Returns => line.n_returns() as u64,
        }
    }
}

/// Number of rejected items with their name and the reason: `1 block: too short`, `2 blocks: too short`.
pub fn counted(n: u64, what: &str) -> String {
    match what.split_once(':') {
        Some((items, reason)) if n == 1 => format!("1 {}:{reason}", items.trim_end_matches('s')),
        _ => format!("{n} {what}"),
    }
}

/// Interface of a stage to the run.
///
/// The default context logs nothing: work done apart from a run, such as the second fit of a shot for a
/// page, must not repeat the messages of the run. [`Context::of_run`] logs.
#[derive(Debug, Default)]
pub struct Context {
    /// Counters of the stage so far.
    counters: Counters,
    /// Finished files that get their final names at the end of the run.
    whole: Vec<FinishedFile>,
    /// Messages of all workers and inputs of the run, so that each is logged once; `None`: none is.
    logged: Option<Arc<Mutex<BTreeSet<String>>>>,
    /// Input that the log names with a warning, if the run has several.
    input: Option<Arc<str>>,
    /// Observer of the run, if there is one.
    observer: Option<Arc<dyn RunObserver>>,
}

/// Counts, measurements and messages of a stage.
#[derive(Debug, Default)]
pub struct Counters {
    /// Dropped items, by type and reason.
    pub rejected: BTreeMap<(Item, Reason), u64>,
    /// Measured quantities, by name.
    pub observed: BTreeMap<&'static str, Distribution>,
    /// Counted items, by name; for [`MapConfig::conclude`](super::MapConfig::conclude).
    pub counts: BTreeMap<&'static str, u64>,
    /// Warnings in order, each once.
    pub notes: Vec<String>,
    /// Consequences of a cause that another stage warns of, each once.
    pub consequences: Vec<(Cause, String)>,
    /// Findings that need no action, in order, each once.
    pub findings: Vec<String>,
}

impl Context {
    /// The same with this observer.
    pub fn observed(self, observer: Option<Arc<dyn RunObserver>>) -> Context {
        Context { observer, ..self }
    }

    /// Context of a run, whose messages are logged, each once.
    pub fn of_run() -> Context {
        Context { logged: Some(Arc::default()), ..Context::default() }
    }

    /// The same for an input that the log names with each warning.
    pub fn of_input(self, name: &str) -> Context {
        Context { input: Some(name.into()), ..self }
    }

    /// Context of another worker of the same run.
    pub fn another(&self) -> Context {
        let (logged, observer, input) = (self.logged.clone(), self.observer.clone(), self.input.clone());
        Context { logged, observer, input, ..Context::default() }
    }

    /// Observer of the run, if there is one.
    pub fn observer(&self) -> Option<&Arc<dyn RunObserver>> {
        self.observer.as_ref()
    }

    /// Drops `n` items of the reason's type.
    ///
    /// This and [`Context::reject_with_blocks`] are the only ways to drop items. Candidates that `decompose` does not report
    /// are counted in [`LineStats::filtered`](crate::scan_line::LineStats::filtered).
    pub fn reject(&mut self, reason: Reason, n: u64) {
        self.count_rejected(reason.item(), reason, n);
    }

    /// Drops shots with their blocks.
    pub fn reject_with_blocks(&mut self, reason: Reason, shots: u64, blocks: u64) {
        self.count_rejected(Item::Shots, reason, shots);
        self.count_rejected(Item::Blocks, reason, blocks);
    }

    fn count_rejected(&mut self, item: Item, reason: Reason, n: u64) {
        if n > 0 {
            *self.counters.rejected.entry((item, reason)).or_default() += n;
        }
    }

    /// Adds a value to the distribution `name`, whose unit is part of the name.
    ///
    /// Negative values count as 0.
    pub fn observe(&mut self, name: &'static str, value: f64) {
        self.counters.observed.entry(name).or_default().add(value);
    }

    /// Adds many values, each with its number, to the distribution `name`; see [`Context::observe`].
    pub fn observe_all(&mut self, name: &'static str, values: impl IntoIterator<Item = (f64, u64)>) {
        let mut values = values.into_iter().peekable();
        if values.peek().is_some() {
            let observed = self.counters.observed.entry(name).or_default();
            values.for_each(|(value, n)| observed.add_many(value, n));
        }
    }

    /// Adds to the count `name`, which is not part of the report.
    pub fn count(&mut self, name: &'static str, n: u64) {
        *self.counters.counts.entry(name).or_default() += n;
    }

    /// Adds a signed value to the distribution `name`; see [`Context::observe`].
    pub fn observe_signed(&mut self, name: &'static str, value: f64) {
        self.counters.observed.entry(name).or_default().add_signed(value);
    }

    /// Warns the user once per run: in the log and in the report.
    pub fn warn(&mut self, text: impl AsRef<str> + Into<String>) {
        if self.counters.notes.iter().any(|note| note == text.as_ref()) {
            return;
        }
        let text = text.into();
        if self.is_new(&text) {
            match &self.input {
                Some(input) => tracing::warn!("{input}: {text}"),
                None => tracing::warn!("{text}"),
            }
        }
        self.counters.notes.push(text);
    }

    /// Reports a consequence of a cause that another stage warns of.
    ///
    /// It is in the report and in the log; the end of the run lists all consequences of a cause together.
    pub fn consequence(&mut self, cause: Cause, text: impl Into<String>) {
        let consequence = (cause, text.into());
        if self.counters.consequences.contains(&consequence) {
            return;
        }
        let text = format!("{}: {}", cause.words(), consequence.1);
        if self.is_new(&text) {
            tracing::info!("{text}");
        }
        self.counters.consequences.push(consequence);
    }

    /// Reports a finding like [`Context::warn`], but not as a warning.
    pub fn info(&mut self, text: impl Into<String>) {
        let text = text.into();
        if self.counters.findings.contains(&text) {
            return;
        }
        if self.is_new(&text) {
            tracing::info!("{text}");
        }
        self.counters.findings.push(text);
    }

    /// Whether the message is to be logged: no worker of the run has given it before.
    fn is_new(&self, text: &str) -> bool {
        self.logged.as_ref().is_some_and(|logged| logged.lock().unpoisoned().insert(text.to_owned()))
    }

    /// Keeps a finished file until every stage has succeeded; it then gets its final name.
    pub fn publish(&mut self, file: FinishedFile) {
        self.whole.push(file);
    }

    /// Adds the counters and finished files of another worker of the same stage.
    pub fn merge(&mut self, other: Context) {
        self.counters.merge(other.counters);
        self.whole.extend(other.whole);
    }

    /// Takes the finished files, in the order in which they were finished.
    pub fn take_files(&mut self) -> Vec<FinishedFile> {
        std::mem::take(&mut self.whole)
    }

    /// Counters at the end of the input.
    pub fn into_counters(self) -> Counters {
        self.counters
    }

    /// Counters so far.
    pub fn counters(&self) -> &Counters {
        &self.counters
    }
}

impl Counters {
    /// Warnings, then consequences with their causes.
    pub fn warnings(&self) -> impl Iterator<Item = String> {
        let consequence = |(cause, text): &(Cause, String)| format!("{}: {text}", cause.words());
        self.notes.iter().cloned().chain(self.consequences.iter().map(consequence))
    }

    /// Adds the counters of another worker of the same stage.
    pub fn merge(&mut self, other: Counters) {
        for (key, n) in other.rejected {
            *self.rejected.entry(key).or_default() += n;
        }
        for (name, distribution) in other.observed {
            self.observed.entry(name).or_default().merge(&distribution);
        }
        for (name, n) in other.counts {
            *self.counts.entry(name).or_default() += n;
        }
        add_new(&mut self.notes, other.notes);
        add_new(&mut self.consequences, other.consequences);
        add_new(&mut self.findings, other.findings);
    }

    /// Number of dropped items of a type, for all reasons.
    pub fn rejected_of(&self, item: Item) -> u64 {
        self.rejected.iter().filter(|((of, _), _)| *of == item).map(|(_, n)| n).sum()
    }
}

/// Adds the messages that are not yet in the list.
fn add_new<T: PartialEq>(messages: &mut Vec<T>, more: Vec<T>) {
    for message in more {
        if !messages.contains(&message) {
            messages.push(message);
        }
    }
}

/// Distribution of a quantity with three significant digits and a resolution of 1e-6.
#[derive(Clone, Debug)]
pub struct Distribution {
    millionths: Histogram<u64>,
    /// Magnitudes of negative values.
    negative: Histogram<u64>,
}

impl Default for Distribution {
    fn default() -> Distribution {
        let three_digits = || {
            Histogram::new(3).unwrap_or_else(|_| unreachable!("3 digits are within hdrhistogram's limits"))
        };
        Distribution { millionths: three_digits(), negative: three_digits() }
    }
}

impl Distribution {
    /// Adds a value; negative and NaN values count as 0.
    pub fn add(&mut self, value: f64) {
        self.add_many(value, 1);
    }

    /// Adds a value `n` times.
    pub fn add_many(&mut self, value: f64, n: u64) {
        // The cast saturates: NaN and negative values become 0. Recording cannot fail, because the
        // histogram resizes itself.
        let _ = self.millionths.record_n((value * 1e6).round() as u64, n);
    }

    /// Adds a signed value; NaN counts as 0.
    pub fn add_signed(&mut self, value: f64) {
        if value < 0.0 {
            let _ = self.negative.record((-value * 1e6).round() as u64);
        } else {
            self.add(value);
        }
    }

    /// Adds another distribution.
    pub fn merge(&mut self, other: &Distribution) {
        // Adding cannot fail, because the histograms resize themselves.
        let _ = self.millionths.add(&other.millionths);
        let _ = self.negative.add(&other.negative);
    }

    /// Number of values.
    pub fn count(&self) -> u64 {
        self.millionths.len() + self.negative.len()
    }

    /// Mean.
    pub fn mean(&self) -> f64 {
        let sum = |of: &Histogram<u64>| of.mean() * of.len() as f64;
        match self.negative.len() {
            0 => self.millionths.mean() / 1e6,
            _ => (sum(&self.millionths) - sum(&self.negative)) / self.count() as f64 / 1e6,
        }
    }

    /// Percentile: the value below which `percent` of the values lie.
    pub fn percentile(&self, percent: f64) -> f64 {
        let (below, above) = (self.negative.len() as f64, self.millionths.len() as f64);
        let rank = percent / 100.0 * (below + above);
        if below == 0.0 {
            shortest(&self.millionths, self.millionths.value_at_percentile(percent))
        } else if rank <= below {
            // Same rank counted from the other end: magnitudes of negative values fall as the
            // values rise.
            let from_zero = below - rank.ceil().max(1.0) + 0.5;
            -shortest(&self.negative, self.negative.value_at_percentile(100.0 * from_zero / below))
        } else {
            shortest(&self.millionths, self.millionths.value_at_percentile(100.0 * (rank - below) / above))
        }
    }

    /// Maximum.
    pub fn max(&self) -> f64 {
        match self.millionths.len() {
            0 if !self.negative.is_empty() => -shortest(&self.negative, self.negative.min()),
            _ => shortest(&self.millionths, self.millionths.max()),
        }
    }
}

/// Number with the fewest digits in the same histogram bin, so that whole numbers stay whole.
fn shortest(histogram: &Histogram<u64>, millionths: u64) -> f64 {
    let (lowest, highest) =
        (histogram.lowest_equivalent(millionths), histogram.highest_equivalent(millionths));
    let mut steps = (0..20).rev().map(|digits| 10u64.pow(digits));
    let rounded = |step: u64| lowest.div_ceil(step).checked_mul(step).filter(|value| *value <= highest);
    steps.find_map(rounded).unwrap_or(millionths) as f64 / 1e6
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rejects_add_up_by_item_and_reason() {
        let mut cx = Context::default();
        cx.reject(Reason::UnreadableWaves, 2);
        cx.reject(Reason::UnreadableWaves, 1);
        cx.reject(Reason::PulseWithoutDirection, 4);
        cx.reject(Reason::PointTooFar, 0);
        assert_eq!(cx.counters.rejected[&(Item::Shots, Reason::UnreadableWaves)], 3);
        assert_eq!(cx.counters.rejected_of(Item::Shots), 7);
        assert_eq!(cx.counters.rejected.len(), 2, "a rejection of 0 items is not recorded");
    }

    #[test]
    fn a_note_is_said_once() {
        let mut cx = Context::default();
        cx.warn("no outgoing pulse");
        cx.warn("no outgoing pulse");
        assert_eq!(cx.counters.notes, ["no outgoing pulse"]);
    }

    #[test]
    fn consequences_follow_the_warnings_with_their_cause() {
        let (mut cx, mut other) = (Context::default(), Context::default());
        cx.consequence(Cause::NoTrajectory, "the file has no coordinate reference system");
        other.consequence(Cause::NoTrajectory, "the file has no coordinate reference system");
        other.warn("the input is not georeferenced");
        cx.merge(other);
        let warnings: Vec<String> = cx.counters.warnings().collect();
        let consequence = "without a trajectory: the file has no coordinate reference system";
        assert_eq!(warnings, ["the input is not georeferenced", consequence]);
    }

    #[test]
    fn notes_are_separate_from_warnings() {
        let mut cx = Context::default();
        cx.info("3 echoes in zone 1");
        cx.info("3 echoes in zone 1");
        cx.reject(Reason::EmptyBlock, 1);
        cx.reject(Reason::RecordedTwice, 2);
        let mut counters = Counters::default();
        counters.merge(cx.counters);
        assert_eq!(
            (counters.findings.as_slice(), counters.notes.len()),
            (&["3 echoes in zone 1".to_owned()][..], 0)
        );
        assert_eq!(counters.rejected_of(Item::Blocks), 3);
        let expected: Vec<_> = counters.rejected.keys().filter(|(_, reason)| reason.is_expected()).collect();
        assert_eq!(expected, [&(Item::Blocks, Reason::RecordedTwice)]);
    }

    #[test]
    fn distributions_have_two_sides() {
        let mut both = Distribution::default();
        [-3.0, -2.0, -1.0, 4.0, f64::NAN].into_iter().for_each(|value| both.add_signed(value));
        let near = |value: f64, exact: f64| (value - exact).abs() < 0.01;
        assert!(near(both.percentile(50.0), -1.0), "{}", both.percentile(50.0));
        assert!(near(both.percentile(1.0), -3.0) && near(both.percentile(99.0), 4.0));
        assert!(near(both.mean(), -0.4) && both.count() == 5 && near(both.max(), 4.0));
        let mut below = Distribution::default();
        below.add_signed(-2.0);
        both.merge(&below);
        assert!(near(below.max(), -2.0) && near(both.percentile(50.0), -2.0), "{}", both.percentile(50.0));
    }

    #[test]
    fn distributions_keep_three_digits() {
        let mut a = Distribution::default();
        (1..=100).for_each(|value| a.add(f64::from(value)));
        let mut b = Distribution::default();
        [f64::NAN, -1.0].into_iter().for_each(|value| b.add(value));
        a.merge(&b);
        assert_eq!(a.count(), 102);
        assert_eq!((a.percentile(50.0), a.max()), (49.0, 100.0));
    }

    #[test]
    fn whole_numbers_have_whole_percentiles() {
        for value in [0.0, 1.0, 5.0, 999.0, 1234.0, 0.25, 4096.0] {
            let mut distribution = Distribution::default();
            distribution.add(value);
            assert_eq!([distribution.percentile(50.0), distribution.max()], [value; 2]);
        }
        let mut distribution = Distribution::default();
        distribution.add(1.0 / 3.0);
        assert!((distribution.percentile(99.0) - 1.0 / 3.0).abs() < 4e-4);
    }
}

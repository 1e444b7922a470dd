//! A stage's counters, and what it has to say.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, Mutex};

use hdrhistogram::Histogram;

use super::WholeFile;
use crate::batch::Batch;
use crate::overview::Gallery;

/// What can be counted on its way through a stage.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Item {
    /// Emissions.
    Shots,
    /// Sample blocks.
    Blocks,
    /// Returns and points.
    Returns,
}

impl Item {
    /// All of them.
    pub const ALL: [Item; 3] = [Item::Shots, Item::Blocks, Item::Returns];

    /// As reports write it.
    pub fn name(self) -> &'static str {
        match self {
            Item::Shots => "shots",
            Item::Blocks => "blocks",
            Item::Returns => "returns",
        }
    }

    /// How many a batch holds.
    pub fn count(self, batch: &Batch) -> u64 {
        match self {
            Item::Shots => batch.emissions.len() as u64,
            Item::Blocks => batch.blocks().map_or(0, |blocks| blocks.len()) as u64,
            Item::Returns => batch.n_returns() as u64,
        }
    }
}

/// What a stage is given besides its lines.
#[derive(Debug, Default)]
pub struct Context {
    /// What the stage has counted so far.
    pub(crate) counters: Counters,
    /// Files that are whole and wait for the end of the run.
    pub(crate) whole: Vec<WholeFile>,
    /// The notes of all workers and inputs of the run, so that each is logged once.
    said: Arc<Mutex<BTreeSet<String>>>,
    /// The shots to be shown, where the run is to have a page.
    pub(crate) gallery: Option<Gallery>,
}

/// What a stage has counted, measured and said.
#[derive(Debug, Default)]
pub struct Counters {
    /// Items dropped, by what they are and why.
    pub rejected: BTreeMap<(Item, &'static str), u64>,
    /// Quantities measured, by name.
    pub observed: BTreeMap<&'static str, Distribution>,
    /// Of these, what nothing is lost with.
    pub set_aside: BTreeSet<(Item, &'static str)>,
    /// What the user should know, each thing once, in order.
    pub notes: Vec<String>,
    /// What came out, which is no reason to act, each thing once, in order.
    pub findings: Vec<String>,
}

impl Context {
    /// The context of another worker of the same run.
    pub(crate) fn another(&self) -> Context {
        let gallery = self.gallery.is_some().then(Gallery::default);
        Context { said: Arc::clone(&self.said), gallery, ..Context::default() }
    }

    /// The context of one input of the same run, whose shots are shown or not.
    pub(crate) fn of_input(&self, with_gallery: bool) -> Context {
        let gallery = with_gallery.then(Gallery::default);
        Context { said: Arc::clone(&self.said), gallery, ..Context::default() }
    }

    /// Where shots are shown, if the run wants any.
    pub(crate) fn gallery(&mut self) -> Option<&mut Gallery> {
        self.gallery.as_mut()
    }

    /// Drops `n` items for a reason. This and [`Context::set_aside`] are the only ways to drop anything.
    pub fn reject(&mut self, item: Item, reason: &'static str, n: u64) {
        if n > 0 {
            *self.counters.rejected.entry((item, reason)).or_default() += n;
        }
    }

    /// Drops `n` items that nothing is lost with: they are counted as rejected, and are no reason for a warning.
    pub fn set_aside(&mut self, item: Item, reason: &'static str, n: u64) {
        if n > 0 {
            self.counters.set_aside.insert((item, reason));
        }
        self.reject(item, reason, n);
    }

    /// Adds a value to the distribution `name`, whose unit is part of the name. Negative values count as 0.
    pub fn observe(&mut self, name: &'static str, value: f64) {
        self.counters.observed.entry(name).or_default().add(value);
    }

    /// Adds a value that may be negative to the distribution `name`, as [`Context::observe`] does.
    pub fn observe_signed(&mut self, name: &'static str, value: f64) {
        self.counters.observed.entry(name).or_default().add_signed(value);
    }

    /// Tells the user something, once per run: it is logged and stands in the report.
    pub fn note(&mut self, text: impl AsRef<str> + Into<String>) {
        if self.counters.notes.iter().any(|said| said == text.as_ref()) {
            return;
        }
        let text = text.into();
        if self.is_new(&text) {
            tracing::warn!("{text}");
        }
        self.counters.notes.push(text);
    }

    /// Tells the user what came out, as [`Context::note`] does, and not as a warning.
    pub fn tell(&mut self, text: impl Into<String>) {
        let text = text.into();
        if self.counters.findings.contains(&text) {
            return;
        }
        if self.is_new(&text) {
            tracing::info!("{text}");
        }
        self.counters.findings.push(text);
    }

    /// Whether no worker of the run has said this so far.
    fn is_new(&self, text: &str) -> bool {
        self.said.lock().unwrap_or_else(|poisoned| poisoned.into_inner()).insert(text.to_owned())
    }

    /// Keeps a file that is whole: it gets its final name when every stage has succeeded.
    pub fn keep(&mut self, file: WholeFile) {
        self.whole.push(file);
    }

    /// What has been counted so far.
    pub fn counters(&self) -> &Counters {
        &self.counters
    }
}

impl Counters {
    /// Adds what another worker of the same stage has counted.
    pub fn merge(&mut self, other: Counters) {
        for (key, n) in other.rejected {
            *self.rejected.entry(key).or_default() += n;
        }
        for (name, distribution) in other.observed {
            self.observed.entry(name).or_default().merge(&distribution);
        }
        self.set_aside.extend(other.set_aside);
        add_new(&mut self.notes, other.notes);
        add_new(&mut self.findings, other.findings);
    }

    /// How many of `item` were dropped, whatever the reason.
    pub fn rejected_of(&self, item: Item) -> u64 {
        self.rejected.iter().filter(|((of, _), _)| *of == item).map(|(_, n)| n).sum()
    }
}

/// Adds the texts that are not among these.
fn add_new(texts: &mut Vec<String>, more: Vec<String>) {
    for text in more {
        if !texts.contains(&text) {
            texts.push(text);
        }
    }
}

/// The distribution of a quantity, to three significant digits, from a millionth up.
#[derive(Clone, Debug)]
pub struct Distribution {
    millionths: Histogram<u64>,
    /// The sizes of negative values.
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
    /// Adds a value; negative and undefined ones count as 0.
    pub fn add(&mut self, value: f64) {
        // A float converts to the nearest integer in range: NaN and negatives become 0.
        // The histogram grows by itself: only what it can never hold fails.
        let _ = self.millionths.record((value * 1e6).round() as u64);
    }

    /// Adds a value that may be negative; undefined ones count as 0.
    pub fn add_signed(&mut self, value: f64) {
        if value < 0.0 {
            let _ = self.negative.record((-value * 1e6).round() as u64);
        } else {
            self.add(value);
        }
    }

    /// Adds another distribution.
    pub fn merge(&mut self, other: &Distribution) {
        // The histograms resize by themselves: an addition can only fail where that is switched off.
        let _ = self.millionths.add(&other.millionths);
        let _ = self.negative.add(&other.negative);
    }

    /// How many values were added.
    pub fn count(&self) -> u64 {
        self.millionths.len() + self.negative.len()
    }

    /// Their mean.
    pub fn mean(&self) -> f64 {
        let sum = |of: &Histogram<u64>| of.mean() * of.len() as f64;
        match self.negative.len() {
            0 => self.millionths.mean() / 1e6,
            _ => (sum(&self.millionths) - sum(&self.negative)) / self.count() as f64 / 1e6,
        }
    }

    /// The value below which `percent` of them lie.
    pub fn percentile(&self, percent: f64) -> f64 {
        let (below, above) = (self.negative.len() as f64, self.millionths.len() as f64);
        let rank = percent / 100.0 * (below + above);
        if below == 0.0 {
            shortest(&self.millionths, self.millionths.value_at_percentile(percent))
        } else if rank <= below {
            // The same place counted from the other end: sizes of negative values fall as the values rise.
            let from_zero = below - rank.ceil().max(1.0) + 0.5;
            -shortest(&self.negative, self.negative.value_at_percentile(100.0 * from_zero / below))
        } else {
            shortest(&self.millionths, self.millionths.value_at_percentile(100.0 * (rank - below) / above))
        }
    }

    /// The largest.
    pub fn max(&self) -> f64 {
        match self.millionths.len() {
            0 if !self.negative.is_empty() => -shortest(&self.negative, self.negative.min()),
            _ => shortest(&self.millionths, self.millionths.max()),
        }
    }
}

/// The number of fewest digits among those that a histogram counts together with this one: whole numbers stay whole.
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
        cx.reject(Item::Shots, "truncated", 2);
        cx.reject(Item::Shots, "truncated", 1);
        cx.reject(Item::Shots, "no direction", 4);
        cx.reject(Item::Returns, "outside", 0);
        assert_eq!(cx.counters.rejected[&(Item::Shots, "truncated")], 3);
        assert_eq!(cx.counters.rejected_of(Item::Shots), 7);
        assert_eq!(cx.counters.rejected.len(), 2, "nothing rejected leaves no trace");
    }

    #[test]
    fn a_note_is_said_once() {
        let mut cx = Context::default();
        cx.note("no outgoing pulse");
        cx.note("no outgoing pulse");
        assert_eq!(cx.counters.notes, ["no outgoing pulse"]);
    }

    #[test]
    fn what_is_no_warning_is_told_apart() {
        let mut cx = Context::default();
        cx.tell("3 echoes in zone 1");
        cx.tell("3 echoes in zone 1");
        cx.reject(Item::Blocks, "cut off", 1);
        cx.set_aside(Item::Blocks, "recorded twice", 2);
        cx.set_aside(Item::Shots, "recorded twice", 0);
        let mut counters = Counters::default();
        counters.merge(cx.counters);
        assert_eq!(
            (counters.findings.as_slice(), counters.notes.len()),
            (&["3 echoes in zone 1".to_owned()][..], 0)
        );
        assert_eq!(counters.rejected_of(Item::Blocks), 3);
        assert_eq!(counters.set_aside, BTreeSet::from([(Item::Blocks, "recorded twice")]));
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

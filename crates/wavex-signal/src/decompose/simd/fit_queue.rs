//! Queues of fits, run in groups of the same kind.

use wavex_simd::{Kernel, Processor, Simd};

use super::fit::{Aim, Fit, FitJob};
use super::fit_many::FitMany;
use super::fitted::{Fitted, FittedPulse};
use super::layout::Values;
use super::pulse_model::MAX_CLUSTER;
use super::rows::{BATCH, Rows};
use super::tables::Tables;
use super::template::Lookup;
use crate::pulse_fit;

/// Maximum number of iterations in each round of a fit.
///
/// Most fits need fewer than the first number. The others continue in groups.
pub(super) const ITERATIONS: [usize; 4] = [3, 4, 6, 16];
/// The same for fits of many pulses: each restart costs one more evaluation of all products.
const ITERATIONS_OF_MANY: [usize; 4] = [5, 5, 6, 16];
/// Separation above which two pulses get a frame of four vectors, samples.
///
/// Three vectors hold two pulses up to 16 samples apart.
const FAR: f32 = 14.0;
/// Distance of the first from the last pulse above which a frame of four vectors may be too short,
/// samples.
const FARTHEST: f32 = 28.0;
/// Heights above this fraction of the first node's may end above it.
///
/// Above the first node the response depends on height.
const NEARLY_STRONG: f32 = 0.93;

/// Jobs of one size, and the tags that assign their results.
#[derive(Clone)]
pub(super) struct Queue<const P: usize> {
    jobs: Vec<FitJob<P>>,
    tags: Vec<usize>,
    fitted: Vec<Fitted<P>>,
    /// Number of fits at the front that need more iterations.
    unsettled: usize,
}

impl<const P: usize> Default for Queue<P> {
    fn default() -> Queue<P> {
        Queue { jobs: Vec::new(), tags: Vec::new(), fitted: Vec::new(), unsettled: 0 }
    }
}

impl<const P: usize> Queue<P> {
    pub(super) fn push(&mut self, job: FitJob<P>, tag: usize) {
        self.jobs.push(job);
        self.tags.push(tag);
    }

    fn fit<const N: usize, const C: usize, const D: usize, const STRONG: bool>(
        &mut self,
        on: Processor,
        tables: &Tables,
        rows: &Rows,
        precision: f32,
        iterations: usize,
    ) {
        self.unsettled = 0;
        if !self.jobs.is_empty() {
            let Queue { jobs, fitted: out, .. } = self;
            on.run(Fit::<P, N, C, D, STRONG> { tables, rows, jobs, precision, iterations, out });
        }
    }
}

impl Queue<MAX_CLUSTER> {
    fn fit_many<const STRONG: bool>(
        &mut self,
        on: Processor,
        tables: &Tables,
        rows: &Rows,
        count: usize,
        precision: f32,
        iterations: usize,
    ) {
        self.unsettled = 0;
        if !self.jobs.is_empty() {
            let Queue { jobs, fitted: out, .. } = self;
            on.run(FitMany::<STRONG> { tables, rows, jobs, count, precision, iterations, out });
        }
    }
}

impl<const P: usize> Queue<P> {
    /// Outputs a finished fit of `count` pulses, or keeps it for more iterations.
    #[inline]
    fn settle(&mut self, i: usize, count: usize, is_last: bool, race: &Race, done: &mut Results) {
        let (fitted, tag) = (&self.fitted[i], self.tags[i]);
        let FitJob { row, aim, .. } = self.jobs[i];
        let is_dropped = fitted.may_go_on && aim.is_out_of_reach(fitted.objective, fitted.promised, race);
        if fitted.may_go_on && !is_dropped && !is_last {
            self.jobs[self.unsettled] = FitJob { row, pulses: fitted.values(), aim };
            self.tags[self.unsettled] = tag;
            self.unsettled += 1;
        } else {
            done.push(row, tag, count, fitted, is_dropped);
        }
    }

    /// Updates the lowest chi-square reached on each waveform.
    ///
    /// A promise does not count: if the leader missed its own, all trials would be stopped.
    fn report(&self, race: &mut Race) {
        for (job, fitted) in self.jobs.iter().zip(&self.fitted) {
            if let Some(best) = race.best.get_mut(job.aim.rivals) {
                *best = best.min(fitted.objective);
            }
        }
    }

    /// Removes all fits except those kept for more iterations.
    fn go_on(&mut self) {
        self.jobs.truncate(self.unsettled);
        self.tags.truncate(self.unsettled);
    }
}

/// Largest further decrease of a fit, in promised decreases of the next step.
const REACH: f32 = pulse_fit::REACH as f32;
/// The same for a small promise, which is accurate near an optimum.
const NEAR_REACH: f32 = 1.5;
/// Promised decreases below this are small.
const LITTLE: f32 = 4.0;
/// Minimum advantage over a rival.
///
/// A fit that cannot gain this much ends at the same optimum or at a worse one.
const BETTER: f32 = 0.5;

impl Aim {
    /// Whether a fit at `objective` need not continue.
    fn is_out_of_reach(&self, objective: f32, promised: f32, race: &Race) -> bool {
        let reach = if promised < LITTLE { NEAR_REACH } else { REACH };
        let best = race.best.get(self.rivals).copied().unwrap_or(f32::INFINITY);
        // The leading fit has itself set `best`.
        let leads = objective <= best;
        objective - REACH * promised > self.enough || (!leads && objective - reach * promised > best - BETTER)
    }
}

/// Lowest chi-square reached by any trial on each waveform.
#[derive(Clone)]
struct Race {
    best: Vec<f32>,
}

impl Default for Race {
    fn default() -> Race {
        Race { best: vec![f32::INFINITY; BATCH] }
    }
}

/// Jobs by size, and by whether the response depends on height.
#[derive(Clone, Default)]
pub(super) struct Queues {
    pub(super) one: [Queue<1>; 2],
    pub(super) two: [Queue<2>; 2],
    /// Two pulses too far apart for the smaller frame.
    far: [Queue<2>; 2],
    pub(super) three: [Queue<3>; 2],
    /// Four and more pulses, or fewer that are too far apart; by number of pulses, from two.
    many: [[Queue<MAX_CLUSTER>; 2]; MAX_CLUSTER - 1],
    race: Race,
}

/// Whether one of the pulses may reach heights that change the response.
#[inline(always)]
pub(super) fn is_strong(tables: &Tables, pulses: &[Values]) -> bool {
    pulses.iter().any(|pulse| pulse[0] > NEARLY_STRONG * tables.strong_dn())
}

/// Result of a job.
#[derive(Clone, Copy)]
pub(super) struct Done {
    pub(super) row: usize,
    pub(super) tag: usize,
    pub(super) is_optimum: bool,
    /// Whether it was stopped because it would have been useless.
    pub(super) is_dropped: bool,
    /// Decrease of chi-square promised beyond the limits of the tables.
    pub(super) beyond: f32,
    /// Range of its pulses in [`Results`].
    first: usize,
    count: usize,
}

/// Results of jobs.
#[derive(Default)]
pub(super) struct Results {
    pub(super) list: Vec<Done>,
    pulses: Vec<FittedPulse>,
}

impl Results {
    /// Returns the pulses of one of these jobs.
    pub(super) fn pulses(&self, done: &Done) -> &[FittedPulse] {
        &self.pulses[done.first..][..done.count]
    }

    fn clear(&mut self) {
        self.list.clear();
        self.pulses.clear();
    }

    #[inline]
    fn push<const P: usize>(
        &mut self,
        row: usize,
        tag: usize,
        count: usize,
        fitted: &Fitted<P>,
        is_dropped: bool,
    ) {
        let (first, is_optimum, beyond) = (self.pulses.len(), fitted.is_optimum, fitted.beyond);
        self.list.push(Done { row, tag, is_optimum, is_dropped, beyond, first, count });
        self.pulses.extend_from_slice(&fitted.pulses[..count]);
    }
}

impl Queues {
    /// Queues a fit of at most [`MAX_CLUSTER`] pulses.
    pub(super) fn push(&mut self, tables: &Tables, row: usize, pulses: &[Values], aim: Aim, tag: usize) {
        let strong = usize::from(is_strong(tables, pulses));
        match *pulses {
            [a, .., b] if b[1] - a[1] > FARTHEST => self.push_many(row, pulses, aim, tag, strong),
            [a] => self.one[strong].push(FitJob { row, pulses: [a], aim }, tag),
            [a, b] if b[1] - a[1] > FAR => self.far[strong].push(FitJob { row, pulses: [a, b], aim }, tag),
            [a, b] => self.two[strong].push(FitJob { row, pulses: [a, b], aim }, tag),
            [a, b, c] => self.three[strong].push(FitJob { row, pulses: [a, b, c], aim }, tag),
            _ => self.push_many(row, pulses, aim, tag, strong),
        }
    }

    fn push_many(&mut self, row: usize, pulses: &[Values], aim: Aim, tag: usize, strong: usize) {
        let mut job = FitJob { row, aim, ..FitJob::IDLE };
        if let Some(queues) = self.many.get_mut(pulses.len().wrapping_sub(2)) {
            job.pulses[..pulses.len()].copy_from_slice(pulses);
            queues[strong].push(job, tag);
        }
    }

    /// Runs all jobs and stores their results in `done`, which is cleared first.
    ///
    /// `precision` is that of the prior on the widths of overlapping pulses.
    pub(super) fn run(
        &mut self,
        on: Processor,
        tables: &Tables,
        rows: &Rows,
        precision: f32,
        done: &mut Results,
    ) {
        done.clear();
        let race = &mut self.race;
        race.best.fill(f32::INFINITY);
        drain::<1, 3, 2, 10>(on, &mut self.one, tables, rows, 0.0, race, done);
        drain::<2, 6, 3, 28>(on, &mut self.two, tables, rows, precision, race, done);
        drain::<2, 6, 4, 28>(on, &mut self.far, tables, rows, precision, race, done);
        drain::<3, 9, 4, 55>(on, &mut self.three, tables, rows, precision, race, done);
        for (count, queues) in (2..).zip(&mut self.many) {
            drain_with(
                queues,
                tables,
                count,
                ITERATIONS_OF_MANY,
                race,
                done,
                |queue, is_strong, iterations| match is_strong {
                    false => queue.fit_many::<false>(on, tables, rows, count, precision, iterations),
                    true => queue.fit_many::<true>(on, tables, rows, count, precision, iterations),
                },
            );
        }
    }
}

fn drain<const P: usize, const N: usize, const C: usize, const D: usize>(
    on: Processor,
    queues: &mut [Queue<P>; 2],
    tables: &Tables,
    rows: &Rows,
    precision: f32,
    race: &mut Race,
    done: &mut Results,
) {
    drain_with(queues, tables, P, ITERATIONS, race, done, |queue, is_strong, iterations| match is_strong {
        false => queue.fit::<N, C, D, false>(on, tables, rows, precision, iterations),
        true => queue.fit::<N, C, D, true>(on, tables, rows, precision, iterations),
    });
}

/// Runs the fits of `count` pulses; `fit` gets a queue, whether it is the strong one, and the number
/// of iterations.
#[inline]
fn drain_with<const P: usize>(
    [weak, strong]: &mut [Queue<P>; 2],
    tables: &Tables,
    count: usize,
    schedule: [usize; 4],
    race: &mut Race,
    done: &mut Results,
    fit: impl Fn(&mut Queue<P>, bool, usize),
) {
    for (round, iterations) in schedule.into_iter().enumerate() {
        let is_last = round + 1 == schedule.len();
        fit(weak, false, iterations);
        weak.report(race);
        for i in 0..weak.jobs.len() {
            let fitted = &weak.fitted[i];
            // It left the heights for which its response is valid; the other queue continues from there.
            if fitted.pulses[..count].iter().any(|pulse| pulse.values[0] > tables.strong_dn()) {
                strong.push(FitJob { pulses: fitted.values(), ..weak.jobs[i] }, weak.tags[i]);
            } else {
                weak.settle(i, count, is_last, race, done);
            }
        }
        weak.go_on();
        fit(strong, true, iterations);
        strong.report(race);
        for i in 0..strong.jobs.len() {
            strong.settle(i, count, is_last, race, done);
        }
        strong.go_on();
    }
}

/// Adds `sign` times a pulse to a row; a separate kernel.
pub(super) fn add(on: Processor, tables: &Tables, rows: &mut Rows, row: usize, values: Values, sign: f32) {
    on.run(Add { tables, rows, row, values, sign });
}

/// Subtracts the fitted pulses from their rows; those of dropped fits stay.
pub(super) fn take_off(on: Processor, tables: &Tables, rows: &mut Rows, done: &Results) {
    on.run(TakeOff { tables, rows, done });
}

struct TakeOff<'a> {
    tables: &'a Tables,
    rows: &'a mut Rows,
    done: &'a Results,
}

impl Kernel for TakeOff<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, s: S) {
        let TakeOff { tables, rows, done } = self;
        for of_job in done.list.iter().filter(|of_job| !of_job.is_dropped) {
            for pulse in done.pulses(of_job) {
                add_pulse(s, tables, rows, of_job.row, pulse.values, -1.0);
            }
        }
    }
}

struct Add<'a> {
    tables: &'a Tables,
    rows: &'a mut Rows,
    row: usize,
    values: Values,
    sign: f32,
}

impl Kernel for Add<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, s: S) {
        let Add { tables, rows, row, values, sign } = self;
        add_pulse(s, tables, rows, row, values, sign);
    }
}

/// Adds `sign` times a pulse to a row.
#[inline(always)]
pub(super) fn add_pulse<S: Simd>(
    s: S,
    tables: &Tables,
    rows: &mut Rows,
    row: usize,
    values: Values,
    sign: f32,
) {
    let lookup = Lookup::of(tables, values);
    if lookup.height >= tables.strong_dn() {
        rows.add::<S, true>(s, tables, row, &lookup, sign);
    } else {
        rows.add::<S, false>(s, tables, row, &lookup, sign);
    }
}

//! Blocks of scan lines along the flight, classified together with their surroundings.

use std::collections::VecDeque;
use std::sync::Arc;

use rayon::ThreadPool;

use wavex_ground::point::{Class, CloudPoint};
use wavex_line::scan_line::{Content, LineStats, Return, ScanLine};
use wavex_line::stage::{Output, Result};

/// Working memory of a classification for each point, bytes.
const WORK_BYTES: usize = 150;

/// Judges all points of a block, by their classes `T`, or more.
pub(super) type Classify<T> = Box<dyn Fn(&[CloudPoint]) -> Vec<T> + Send + Sync>;
/// Sets the classes of a line and counts them.
pub(super) type Apply<T> = Box<dyn Fn(&mut ScanLine, &[T]) + Send>;

/// Pending lines, and emitted lines whose points are needed for others.
///
/// The ends of blocks are multiples of `block_m` of the way since the first line, so they depend on the data alone.
pub(super) struct LineBlocks<T = Class> {
    pub(super) block_m: f64,
    pub(super) margin_m: f64,
    pub(super) classify: Classify<T>,
    pub(super) apply: Apply<T>,
    pub(super) pool: Option<Arc<ThreadPool>>,
    lines: VecDeque<HeldLine>,
    /// Index of the first line in `lines` not yet classified.
    next: usize,
    bytes: usize,
    way_m: f64,
    end_m: f64,
    last_place_m: Option<[f64; 3]>,
}

struct HeldLine {
    /// Taken when it is emitted.
    scan_line: Option<ScanLine>,
    cloud: Vec<CloudPoint>,
    way_m: f64,
    bytes: usize,
}

impl<T: Send> LineBlocks<T> {
    pub(super) fn new(
        [block_m, margin_m]: [f64; 2],
        pool: Option<Arc<ThreadPool>>,
        classify: Classify<T>,
        apply: Apply<T>,
    ) -> LineBlocks<T> {
        LineBlocks {
            block_m,
            margin_m,
            classify,
            apply,
            pool,
            lines: VecDeque::new(),
            next: 0,
            bytes: 0,
            way_m: 0.0,
            end_m: block_m,
            last_place_m: None,
        }
    }

    /// Adds the next line with its points and the place of its sensor, m, and emits lines of complete blocks.
    pub(super) fn push(
        &mut self,
        scan_line: ScanLine,
        cloud: Vec<CloudPoint>,
        place_m: Option<[f64; 3]>,
        out: &mut Output,
    ) -> Result<()> {
        if let (Some(from), Some(to)) = (self.last_place_m, place_m) {
            let step_m = from.iter().zip(to).map(|(a, b)| (b - a) * (b - a)).sum::<f64>().sqrt();
            self.way_m += if step_m.is_finite() { step_m } else { 0.0 };
        }
        self.last_place_m = place_m.or(self.last_place_m);
        if self.way_m >= self.end_m + self.margin_m {
            while self.next < self.lines.len() && self.way_m >= self.end_m + self.margin_m {
                let end_m = self.end_m;
                let until = self.lines.partition_point(|line| line.way_m < end_m);
                self.judge(until, out)?;
                self.end_m += self.block_m;
            }
            if self.next == self.lines.len() {
                // A gap in the flight: blocks without lines are skipped.
                self.end_m = self.end_m.max(((self.way_m / self.block_m).floor() + 1.0) * self.block_m);
            }
        }
        let bytes = scan_line.bytes() + cloud.len() * (size_of::<CloudPoint>() + WORK_BYTES);
        self.bytes += bytes;
        self.lines.push_back(HeldLine { scan_line: Some(scan_line), cloud, way_m: self.way_m, bytes });
        while self.bytes > out.may_hold_bytes() && !self.lines.is_empty() {
            out.cx.warn(
                "points are classified in shorter blocks than wanted: longer ones do not fit into memory_mb",
            );
            let pending = self.lines.len() - self.next;
            match self.next > pending {
                true => (0..self.next.div_ceil(2)).for_each(|_| self.forget_first()),
                false => self.judge(self.next + pending.div_ceil(2), out)?,
            }
        }
        Ok(())
    }

    /// Classifies and emits the remaining lines.
    pub(super) fn finish(&mut self, out: &mut Output) -> Result<()> {
        while self.next < self.lines.len() {
            let end_m = self.end_m;
            let until = self.lines.partition_point(|line| line.way_m < end_m);
            self.judge(until, out)?;
            self.end_m += self.block_m;
        }
        self.lines.clear();
        (self.next, self.bytes, self.last_place_m) = (0, 0, None);
        Ok(())
    }

    /// Classifies and emits the pending lines before the index `until`.
    fn judge(&mut self, until: usize, out: &mut Output) -> Result<()> {
        let n = until.saturating_sub(self.next);
        let Some(first) = self.lines.get(self.next).filter(|_| n > 0) else { return Ok(()) };
        let from_m = first.way_m - self.margin_m;
        while self.next > 0 && self.lines.front().is_some_and(|line| line.way_m < from_m) {
            self.forget_first();
        }
        let until = self.next + n;
        let to_m = self.lines.get(until - 1).map_or(0.0, |last| last.way_m) + self.margin_m;
        let near = || self.lines.iter().take_while(|line| line.way_m <= to_m);
        let cloud: Vec<CloudPoint> = near().flat_map(|line| &line.cloud).copied().collect();
        let mut at: usize = self.lines.range(..self.next).map(|line| line.cloud.len()).sum();
        let classes = match &self.pool {
            Some(pool) => pool.install(|| (self.classify)(&cloud)),
            None => (self.classify)(&cloud),
        };
        while self.next < until {
            let Some(line) = self.lines.get_mut(self.next) else { break };
            self.next += 1;
            let Some(mut scan_line) = line.scan_line.take() else { continue };
            let held_bytes = scan_line.bytes();
            let end = at + line.cloud.len();
            (self.apply)(&mut scan_line, classes.get(at..end).unwrap_or_default());
            at = end;
            line.bytes -= held_bytes.min(line.bytes);
            self.bytes -= held_bytes.min(self.bytes);
            out.emit(scan_line)?;
        }
        Ok(())
    }

    /// Drops the first line, which has been classified.
    fn forget_first(&mut self) {
        if let Some(gone) = self.lines.pop_front() {
            self.bytes -= gone.bytes;
            self.next -= 1;
        }
    }
}

/// Marks the noise among returns: withheld, class 7 or 18; counts them.
pub(super) fn mark(r: &mut Return, class: Class, stats: &mut LineStats) {
    match class {
        Class::LowNoise => stats.np_low += 1,
        Class::HighNoise => stats.np_air += 1,
        _ => return,
    }
    (r.withheld, r.class) = (true, class as u8);
}

/// Calls `set` with each return of a line, its class and the counters of the line.
pub(super) fn set_classes(
    scan_line: &mut ScanLine,
    classes: &[Class],
    set: impl Fn(&mut Return, Class, &mut LineStats),
) {
    let stats = &mut scan_line.stats;
    if let Content::Returns(returns) | Content::Points(returns, _) = &mut scan_line.content {
        returns.iter_mut().zip(classes).for_each(|(r, class)| set(r, *class, stats));
    }
}

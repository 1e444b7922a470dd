//! Memory budget for scan lines in flight.

use crate::system::Unpoisoned as _;
use std::sync::{Arc, Condvar, Mutex, MutexGuard};
use std::time::Duration;

/// Limit on the bytes of lines in flight.
///
/// A source waits for room before its line enters the chain. The line releases its share when it is
/// dropped.
#[derive(Debug)]
pub struct Budget {
    limit: usize,
    /// Limit common to several budgets, if there is one.
    common: Option<Arc<Budget>>,
    state: Mutex<BudgetState>,
    freed: Condvar,
}

#[derive(Debug, Default)]
struct BudgetState {
    used: usize,
    peak: usize,
    /// Number of lines in flight.
    ///
    /// `inside` is the number held by transforms.
    lines: usize,
    inside: usize,
    /// Number of transforms that are processing a line.
    busy: usize,
}

impl BudgetState {
    /// Returns whether no line can leave before another arrives.
    ///
    /// All are held by waiting transforms.
    fn stands_still(&self) -> bool {
        self.busy == 0 && self.inside == self.lines
    }
}

/// Share of a [`Budget`] held by a scan line.
#[derive(Debug)]
pub struct Ticket {
    budget: Arc<Budget>,
    bytes: usize,
    /// Whether it counts as a line in flight.
    is_line: bool,
    is_inside: bool,
}

/// Guard that marks a transform as processing a line.
#[derive(Debug)]
pub struct AtWork<'a>(&'a Budget);

/// Reason why memory cannot be granted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NoRoom {
    /// The run is ending.
    Cancelled,
    /// Transforms hold this many bytes and wait for lines.
    ///
    /// None will emit a line before it receives another.
    Full(usize),
}

impl Budget {
    /// Creates a budget of `limit` bytes.
    pub fn new(limit: usize) -> Arc<Budget> {
        Arc::new(Budget { limit, common: None, state: Mutex::default(), freed: Condvar::new() })
    }

    /// Creates a budget with the limit of `common`, whose users also share that limit.
    ///
    /// If transforms hold all lines of a budget, it may exceed the common limit, but not its own.
    /// Otherwise inputs that hold lines back could block each other.
    pub fn within(common: &Arc<Budget>) -> Arc<Budget> {
        let (limit, common) = (common.limit, Some(Arc::clone(common)));
        Arc::new(Budget { limit, common, state: Mutex::default(), freed: Condvar::new() })
    }

    /// Returns the limit, bytes.
    pub fn limit(&self) -> usize {
        self.limit
    }

    /// Returns the peak use, bytes.
    pub fn peak(&self) -> usize {
        self.lock().peak
    }

    /// Waits until `bytes` fit, or until nothing else is in flight.
    ///
    /// # Errors
    /// `cancelled` returns true, or waiting cannot succeed.
    pub fn take(self: &Arc<Self>, bytes: usize, cancelled: impl Fn() -> bool) -> Result<Ticket, NoRoom> {
        let mut state = self.lock();
        while state.used > 0 && state.used + bytes > self.limit {
            if cancelled() {
                return Err(NoRoom::Cancelled);
            }
            if state.stands_still() {
                return Err(NoRoom::Full(state.used));
            }
            // The wait times out regularly so that cancellation is noticed.
            state = self.wait(state);
        }
        drop(state);
        if let Some(common) = &self.common {
            let mut of_all = common.lock();
            while of_all.used > 0 && of_all.used + bytes > common.limit && !self.lock().stands_still() {
                if cancelled() {
                    return Err(NoRoom::Cancelled);
                }
                of_all = common.wait(of_all);
            }
        }
        self.replace(0, bytes).lines += 1;
        Ok(Ticket { budget: Arc::clone(self), bytes, is_line: true, is_inside: false })
    }

    /// Marks a transform as processing a line until the guard is dropped.
    pub fn at_work(&self) -> AtWork<'_> {
        self.lock().busy += 1;
        AtWork(self)
    }

    /// Waits until memory is released; times out regularly so that cancellation is noticed.
    fn wait<'a>(&self, state: MutexGuard<'a, BudgetState>) -> MutexGuard<'a, BudgetState> {
        let waited = self.freed.wait_timeout(state, Duration::from_millis(50));
        waited.unpoisoned().0
    }

    /// Replaces a share of `before` bytes by one of `after`, here and in the common budget.
    fn replace(&self, before: usize, after: usize) -> MutexGuard<'_, BudgetState> {
        if let Some(common) = &self.common {
            drop(common.replace(before, after));
        }
        let mut state = self.lock();
        state.used = state.used - before + after;
        state.peak = state.peak.max(state.used);
        self.freed.notify_all();
        state
    }

    fn lock(&self) -> MutexGuard<'_, BudgetState> {
        // Every state change is a single addition, so a panic cannot leave it inconsistent.
        self.state.lock().unpoisoned()
    }
}

impl Drop for AtWork<'_> {
    fn drop(&mut self) {
        self.0.lock().busy -= 1;
        self.0.freed.notify_all();
    }
}

impl Ticket {
    /// Creates an independent share of `bytes`, released with it.
    ///
    /// Never waits.
    pub fn beside(&self, bytes: usize) -> Ticket {
        let budget = Arc::clone(&self.budget);
        let mut other = Ticket { budget, bytes: 0, is_line: false, is_inside: false };
        other.resize(bytes);
        other
    }

    /// Sets whether a transform holds the line; call during [`Budget::at_work`].
    pub fn set_inside(&mut self, is_inside: bool) {
        if self.is_inside != is_inside {
            let mut state = self.budget.lock();
            state.inside = if is_inside { state.inside + 1 } else { state.inside - 1 };
            self.is_inside = is_inside;
        }
    }

    /// Changes the share to `bytes`.
    ///
    /// Never waits, because lines in flight must be able to leave.
    pub fn resize(&mut self, bytes: usize) {
        if bytes == self.bytes {
            return;
        }
        drop(self.budget.replace(self.bytes, bytes));
        self.bytes = bytes;
    }
}

impl Drop for Ticket {
    fn drop(&mut self) {
        let mut state = self.budget.replace(self.bytes, 0);
        state.lines -= usize::from(self.is_line);
        state.inside -= usize::from(self.is_inside);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn room_is_given_back_when_a_ticket_is_dropped() {
        let budget = Budget::new(100);
        let first = budget.take(60, || true).unwrap();
        assert_eq!(budget.take(60, || true).unwrap_err(), NoRoom::Cancelled);
        drop(first);
        let mut second = budget.take(60, || true).unwrap();
        second.resize(10);
        let third = budget.take(90, || true).unwrap();
        assert_eq!(budget.peak(), 100);
        drop((second, third));
        assert_eq!(budget.lock().used, 0);
    }

    #[test]
    fn what_stays_keeps_its_share_when_the_line_is_gone() {
        let budget = Budget::new(100);
        let line = budget.take(60, || true).unwrap();
        let beside = line.beside(30);
        drop(line);
        assert_eq!(
            budget.take(71, || false).unwrap_err(),
            NoRoom::Full(30),
            "no line that could leave is in flight"
        );
        drop(beside);
        assert_eq!(budget.lock().used, 0);
        assert_eq!(budget.peak(), 90);
    }

    #[test]
    fn budgets_share_a_limit_unless_they_stand_still() {
        let common = Budget::new(100);
        let [one, other] = [(); 2].map(|()| Budget::within(&common));
        let mut held = one.take(80, || true).unwrap();
        let first = other.take(30, || true).unwrap();
        assert_eq!(other.take(30, || true).unwrap_err(), NoRoom::Cancelled, "another line is in flight");
        drop(first);
        assert_eq!(common.lock().used, 80);
        held.set_inside(true);
        assert_eq!(one.take(30, || false).unwrap_err(), NoRoom::Full(80), "its own limit holds");
        let next = one.take(20, || true).unwrap();
        drop((held, next));
        assert_eq!([common.lock().used, one.lock().used], [0, 0]);
        assert_eq!(common.peak(), 110);
    }

    #[test]
    fn a_line_larger_than_the_bound_goes_alone() {
        let budget = Budget::new(10);
        assert!(budget.take(1000, || true).is_ok());
    }

    #[test]
    fn lines_that_rest_in_transforms_make_no_room() {
        let budget = Budget::new(100);
        let mut held = budget.take(60, || false).unwrap();
        let at_work = budget.at_work();
        held.set_inside(true);
        assert_eq!(budget.take(60, || true).unwrap_err(), NoRoom::Cancelled, "the line may still be emitted");
        drop(at_work);
        assert_eq!(budget.take(60, || false).unwrap_err(), NoRoom::Full(60));
        let passing = budget.take(40, || false).unwrap();
        assert_eq!(budget.take(60, || true).unwrap_err(), NoRoom::Cancelled, "a line is in flight");
        drop(passing);
        held.set_inside(false);
        assert_eq!(budget.take(60, || true).unwrap_err(), NoRoom::Cancelled);
        drop(held);
        assert!(budget.take(100, || true).is_ok());
    }
}

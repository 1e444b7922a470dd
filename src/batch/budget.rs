//! The memory that batches may take while they are under way.

use std::sync::{Arc, Condvar, Mutex, MutexGuard};
use std::time::Duration;

/// A bound on the bytes in flight. A source waits for room before its line enters the chain; the line gives its room
/// back when it is dropped, wherever that happens.
#[derive(Debug)]
pub struct Budget {
    limit: usize,
    state: Mutex<State>,
    freed: Condvar,
}

#[derive(Debug, Default)]
struct State {
    used: usize,
    peak: usize,
}

/// A batch's share of a [`Budget`].
#[derive(Debug)]
pub struct Ticket {
    budget: Arc<Budget>,
    bytes: usize,
}

impl Budget {
    /// A bound of `limit` bytes.
    pub fn new(limit: usize) -> Arc<Budget> {
        Arc::new(Budget { limit, state: Mutex::default(), freed: Condvar::new() })
    }

    /// The bound, bytes.
    pub fn limit(&self) -> usize {
        self.limit
    }

    /// The most that was ever taken at once, bytes.
    pub fn peak(&self) -> usize {
        self.lock().peak
    }

    /// Waits until `bytes` fit, or until nothing else is under way; `None` once `cancelled` says so.
    pub fn take(self: &Arc<Self>, bytes: usize, cancelled: impl Fn() -> bool) -> Option<Ticket> {
        let mut state = self.lock();
        while state.used > 0 && state.used + bytes > self.limit {
            if cancelled() {
                return None;
            }
            // The wait ends by itself from time to time, so that a cancelled run is noticed.
            let waited = self.freed.wait_timeout(state, Duration::from_millis(50));
            state = waited.unwrap_or_else(|poisoned| poisoned.into_inner()).0;
        }
        state.used += bytes;
        state.peak = state.peak.max(state.used);
        Some(Ticket { budget: Arc::clone(self), bytes })
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        // Each change of the state is one addition: a panic elsewhere cannot leave it half done.
        self.state.lock().unwrap_or_else(|poisoned| poisoned.into_inner())
    }
}

impl Ticket {
    /// A share of its own for `bytes` that stay as long as it does, whatever becomes of this one. Never waits.
    pub fn beside(&self, bytes: usize) -> Ticket {
        let mut other = Ticket { budget: Arc::clone(&self.budget), bytes: 0 };
        other.resize(bytes);
        other
    }

    /// The batch takes `bytes` now. Never waits: a line that is under way must be able to leave.
    pub fn resize(&mut self, bytes: usize) {
        if bytes == self.bytes {
            return;
        }
        let mut state = self.budget.lock();
        state.used = state.used - self.bytes + bytes;
        state.peak = state.peak.max(state.used);
        self.bytes = bytes;
        drop(state);
        self.budget.freed.notify_all();
    }
}

impl Drop for Ticket {
    fn drop(&mut self) {
        self.budget.lock().used -= self.bytes;
        self.budget.freed.notify_all();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn room_is_given_back_when_a_ticket_is_dropped() {
        let budget = Budget::new(100);
        let first = budget.take(60, || true).unwrap();
        assert!(budget.take(60, || true).is_none(), "no room, and the run is cancelled");
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
        assert!(budget.take(71, || true).is_none());
        drop(beside);
        assert_eq!(budget.lock().used, 0);
        assert_eq!(budget.peak(), 90);
    }

    #[test]
    fn a_line_larger_than_the_bound_goes_alone() {
        let budget = Budget::new(10);
        assert!(budget.take(1000, || true).is_some());
    }
}

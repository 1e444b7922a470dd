//! Measurements of a worker: time and item counts.

use std::time::{Duration, Instant};

use hdrhistogram::Histogram;

use wavex_line::scan_line::ScanLine;
use wavex_line::stage::Item;

/// Time and items of one worker, or of all workers of a stage.
#[derive(Clone, Debug)]
pub(super) struct Meter {
    pub(super) working: Duration,
    pub(super) waiting: Duration,
    pub(super) blocked: Duration,
    pub(super) lines_in: u64,
    pub(super) lines_out: u64,
    pub(super) items_in: [u64; 3],
    pub(super) items_out: [u64; 3],
    /// Working time per line, ns.
    pub(super) latency_ns: Histogram<u64>,
    /// Work intervals of each line, if a trace is requested.
    pub(super) spans: Vec<WorkInterval>,
    tracing: bool,
    lap: Instant,
    line_working: Duration,
}

/// A work interval of one line.
#[derive(Clone, Copy, Debug)]
pub(super) struct WorkInterval {
    pub(super) worker: usize,
    pub(super) start: Instant,
    pub(super) length: Duration,
}

/// Maximum number of spans per worker; a trace of a longer run shows its start.
const MAX_SPANS: usize = 100_000;

impl Meter {
    pub(super) fn new(tracing: bool) -> Meter {
        let latency_ns =
            Histogram::new(3).unwrap_or_else(|_| unreachable!("3 digits are within hdrhistogram's limits"));
        Meter {
            working: Duration::ZERO,
            waiting: Duration::ZERO,
            blocked: Duration::ZERO,
            lines_in: 0,
            lines_out: 0,
            items_in: [0; 3],
            items_out: [0; 3],
            latency_ns,
            spans: Vec::new(),
            tracing,
            lap: Instant::now(),
            line_working: Duration::ZERO,
        }
    }

    /// Time since the last call.
    fn lap(&mut self) -> Duration {
        let now = Instant::now();
        let lap = now - self.lap;
        self.lap = now;
        lap
    }

    /// Adds the time since the last call as waiting for input.
    pub(super) fn waited(&mut self) {
        let lap = self.lap();
        self.waiting += lap;
    }

    /// Adds the time since the last call as waiting for space in the output.
    pub(super) fn was_blocked(&mut self) {
        let lap = self.lap();
        self.blocked += lap;
    }

    /// Adds the time since the last call as work on the current line.
    pub(super) fn worked(&mut self) {
        let start = self.lap;
        let length = self.lap();
        self.line_working += length;
        if self.tracing && self.spans.len() < MAX_SPANS {
            self.spans.push(WorkInterval { worker: 0, start, length });
        }
    }

    /// Finishes the current line.
    pub(super) fn line_done(&mut self) {
        // Recording cannot fail: the histogram resizes itself.
        let _ = self.latency_ns.record(self.line_working.as_nanos() as u64);
        self.working += self.line_working;
        self.line_working = Duration::ZERO;
    }

    pub(super) fn took(&mut self, line: &ScanLine) {
        self.lines_in += 1;
        count(&mut self.items_in, line);
    }

    pub(super) fn gave(&mut self, line: &ScanLine) {
        self.lines_out += 1;
        count(&mut self.items_out, line);
    }

    /// Adds the measurements of another worker of the same stage.
    pub(super) fn merge(&mut self, other: Meter, worker: usize) {
        self.working += other.working;
        self.waiting += other.waiting;
        self.blocked += other.blocked;
        self.lines_in += other.lines_in;
        self.lines_out += other.lines_out;
        for item in 0..3 {
            self.items_in[item] += other.items_in[item];
            self.items_out[item] += other.items_out[item];
        }
        // Adding cannot fail: the histogram resizes itself.
        let _ = self.latency_ns.add(&other.latency_ns);
        self.spans.extend(other.spans.into_iter().map(|span| WorkInterval { worker, ..span }));
    }
}

fn count(items: &mut [u64; 3], line: &ScanLine) {
    for (count, item) in items.iter_mut().zip(Item::ALL) {
        *count += item.count(line);
    }
}

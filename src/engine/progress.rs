//! Progress display: a bar on a terminal, plain lines elsewhere.

use std::io::Write;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

use super::worker::Gauge;

/// Progress display of a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum ProgressMode {
    /// A bar, for a terminal.
    Bar,
    /// A line every 10 s.
    Lines,
    /// None.
    #[default]
    Hidden,
}

/// Displays the progress of a run on standard error.
#[derive(Debug)]
pub struct Progress {
    mode: ProgressMode,
    inputs: usize,
    begun: usize,
    stem: String,
    started: Instant,
    bar: Option<ProgressBar>,
    next_line: Duration,
}

/// Interval between plain lines.
const LINE_EVERY: Duration = Duration::from_secs(10);

impl Progress {
    /// Creates a display for this number of inputs.
    pub fn new(mode: ProgressMode, inputs: usize) -> Progress {
        let started = Instant::now();
        Progress { mode, inputs, begun: 0, stem: String::new(), started, bar: None, next_line: LINE_EVERY }
    }

    pub(super) fn begin(&mut self, stem: &str) {
        self.begun += 1;
        self.stem = stem.to_string();
        self.started = Instant::now();
        self.next_line = LINE_EVERY;
        self.bar = (self.mode == ProgressMode::Bar).then(|| {
            let bar = ProgressBar::with_draw_target(Some(1_000_000), ProgressDrawTarget::stderr());
            let style = ProgressStyle::with_template("{prefix} [{bar:30}] {percent:>3}% {msg}, {eta} left");
            bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()).progress_chars("=> "));
            bar.set_prefix(self.label());
            bar
        });
    }

    pub(super) fn show(&mut self, gauge: &Gauge) {
        let read = gauge.read_ppm.load(Ordering::Relaxed);
        let rate = self.rate(gauge);
        if let Some(bar) = &self.bar {
            if read != u64::MAX {
                bar.set_position(read);
            }
            bar.set_message(rate);
        } else if self.mode == ProgressMode::Lines && self.started.elapsed() >= self.next_line {
            self.next_line += LINE_EVERY;
            let part = if read == u64::MAX { String::new() } else { format!("{:.0} %, ", read as f64 / 1e4) };
            self.line(&format!("{part}{rate}{}", self.time_left(read)));
        }
    }

    pub(super) fn end(&mut self, gauge: &Gauge) {
        let rate = self.rate(gauge);
        if let Some(bar) = self.bar.take() {
            bar.finish_and_clear();
        }
        if self.mode != ProgressMode::Hidden {
            self.line(&format!("{rate}, {:.1} s", self.started.elapsed().as_secs_f64()));
        }
    }

    fn label(&self) -> String {
        match self.inputs {
            1 => self.stem.clone(),
            n => format!("{} ({} of {n})", self.stem, self.begun),
        }
    }

    fn rate(&self, gauge: &Gauge) -> String {
        let shots = gauge.shots.load(Ordering::Relaxed) as f64;
        let per_s = shots / self.started.elapsed().as_secs_f64().max(1e-3);
        format!("{shots:.0} shots, {:.3} M shots/s", per_s / 1e6)
    }

    fn time_left(&self, read_ppm: u64) -> String {
        match read_ppm {
            1..=1_000_000 => {
                let elapsed_s = self.started.elapsed().as_secs_f64();
                format!(", {:.0} s left", elapsed_s * (1e6 / read_ppm as f64 - 1.0))
            }
            _ => String::new(),
        }
    }

    fn line(&self, text: &str) {
        // A closed standard error does not end a run.
        let _ = writeln!(std::io::stderr(), "{}: {text}", self.label());
    }
}

//! Progress display: a bar on a terminal, plain lines elsewhere, JSON for programs.

use std::io::Write;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use serde_json::json;

use super::worker::Gauge;

/// Progress display of a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum ProgressMode {
    /// A bar, for a terminal.
    Bar,
    /// A line every 10 s.
    Lines,
    /// A JSON object every second.
    Json,
    /// None.
    #[default]
    Hidden,
}

/// Displays the progress of a run on standard error.
#[derive(Debug)]
pub struct Progress {
    mode: ProgressMode,
    /// Size of each input, bytes, at least 1.
    sizes: Vec<u64>,
    begun: usize,
    done: usize,
    failed: usize,
    stem: String,
    run_started: Instant,
    started: Instant,
    /// Shots of earlier inputs.
    shots_before: u64,
    bar: Option<ProgressBar>,
    next: Duration,
}

/// State of an input.
#[derive(Clone, Copy, Debug, Default)]
struct State {
    shots: u64,
    shots_read: u64,
    /// Part of the input that has passed the whole chain, if known.
    fraction: Option<f64>,
}

impl State {
    fn of(gauge: &Gauge) -> State {
        let get = |count: &AtomicU64| count.load(Ordering::Relaxed);
        let read = Some(get(&gauge.read_ppm)).filter(|read| *read != u64::MAX);
        // What is read is not done: a stage may hold the first lines, such as `calibrate`.
        let passed = get(&gauge.lines) as f64 / get(&gauge.lines_read).max(1) as f64;
        let fraction = read.map(|read| read as f64 * 1e-6 * passed.min(1.0));
        State { shots: get(&gauge.shots), shots_read: get(&gauge.shots_read), fraction }
    }
}

impl Progress {
    /// Creates a display for inputs of these sizes, bytes.
    pub fn new(mode: ProgressMode, sizes: Vec<u64>) -> Progress {
        let now = Instant::now();
        Progress {
            mode,
            sizes,
            begun: 0,
            done: 0,
            failed: 0,
            stem: String::new(),
            run_started: now,
            started: now,
            shots_before: 0,
            bar: None,
            next: Duration::ZERO,
        }
    }

    pub(super) fn begin(&mut self, stem: &str) {
        self.begun = self.done + self.failed + 1;
        self.stem = stem.to_string();
        self.started = Instant::now();
        self.next = self.interval();
        self.bar = (self.mode == ProgressMode::Bar).then(|| {
            let bar = ProgressBar::with_draw_target(Some(1_000_000), ProgressDrawTarget::stderr());
            let style = ProgressStyle::with_template("{prefix} [{bar:30}] {percent:>3}% {msg}");
            bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()).progress_chars("=> "));
            bar.set_prefix(self.label());
            bar
        });
        if self.mode == ProgressMode::Json {
            self.json(State::default());
        }
    }

    pub(super) fn show(&mut self, gauge: &Gauge) {
        let state = State::of(gauge);
        if let Some(bar) = &self.bar {
            bar.set_position((self.fraction(state).unwrap_or(0.0) * 1e6) as u64);
            bar.set_message(format!("{}{}", self.rate(state), self.left(state)));
            return;
        }
        if self.started.elapsed() < self.next {
            return;
        }
        self.next += self.interval();
        match self.mode {
            ProgressMode::Lines => {
                let part =
                    self.fraction(state).map_or(String::new(), |part| format!("{:.0} %, ", 100.0 * part));
                self.line(&format!("{part}{}{}", self.rate(state), self.left(state)));
            }
            ProgressMode::Json => self.json(state),
            ProgressMode::Bar | ProgressMode::Hidden => {}
        }
    }

    pub(super) fn end(&mut self, gauge: &Gauge) {
        let state = State::of(gauge);
        if let Some(bar) = self.bar.take() {
            bar.finish_and_clear();
        }
        if matches!(self.mode, ProgressMode::Bar | ProgressMode::Lines) {
            self.line(&format!("{}, {:.1} s", self.rate(state), self.started.elapsed().as_secs_f64()));
        }
        self.shots_before += state.shots;
    }

    /// Counts an input that has ended.
    pub(super) fn count(&mut self, has_failed: bool) {
        self.bar.take().inspect(ProgressBar::finish_and_clear);
        if has_failed {
            self.failed += 1
        } else {
            self.done += 1
        }
        if self.mode == ProgressMode::Json {
            self.json(State::default());
        }
    }

    fn interval(&self) -> Duration {
        Duration::from_secs(if self.mode == ProgressMode::Json { 1 } else { 10 })
    }

    fn label(&self) -> String {
        let failed = if self.failed > 0 { format!(", {} failed", self.failed) } else { String::new() };
        match self.sizes.len() {
            1 => self.stem.clone(),
            inputs => format!("{} ({} of {inputs}{failed})", self.stem, self.begun),
        }
    }

    fn rate(&self, state: State) -> String {
        if state.shots == 0 && state.shots_read > 0 {
            return format!("{} shots read", state.shots_read);
        }
        let per_s = state.shots as f64 / self.started.elapsed().as_secs_f64().max(1e-3);
        format!("{} shots, {:.3} M shots/s", state.shots, per_s / 1e6)
    }

    /// Part of the run that is done, by the size of the inputs, if known.
    fn fraction(&self, state: State) -> Option<f64> {
        let ended = self.done + self.failed;
        let size = |sizes: &[u64]| sizes.iter().sum::<u64>() as f64;
        let before = size(self.sizes.get(..ended).unwrap_or(&self.sizes));
        let current = match self.sizes.get(ended) {
            Some(current) if state.shots_read > 0 => *current as f64 * state.fraction?,
            _ => 0.0,
        };
        Some((before + current) / size(&self.sizes).max(1.0))
    }

    /// Time until the end of the run, s, if known.
    fn left_s(&self, state: State) -> Option<f64> {
        let fraction = self.fraction(state).filter(|fraction| *fraction > 0.0)?;
        Some(self.run_started.elapsed().as_secs_f64() * (1.0 / fraction - 1.0))
    }

    fn left(&self, state: State) -> String {
        self.left_s(state).map_or(String::new(), |left_s| format!(", {left_s:.0} s left"))
    }

    fn line(&self, text: &str) {
        // A closed standard error does not end a run.
        let _ = writeln!(std::io::stderr(), "{}: {text}", self.label());
    }

    fn json(&self, state: State) {
        let elapsed_s = self.run_started.elapsed().as_secs_f64();
        let shots = self.shots_before + state.shots;
        let object = json!({
            "input": self.stem,
            "number": self.begun,
            "inputs": self.sizes.len(),
            "done": self.done,
            "failed": self.failed,
            "fraction": self.fraction(state),
            "shots": shots,
            "shots_per_s": shots as f64 / elapsed_s.max(1e-3),
            "elapsed_s": elapsed_s,
            "left_s": self.left_s(state),
        });
        let _ = writeln!(std::io::stderr(), "{object}");
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn gauge(read_ppm: u64, lines_read: u64, lines: u64) -> Gauge {
        let gauge = Gauge::default();
        gauge.read_ppm.store(read_ppm, Ordering::Relaxed);
        for (count, n) in [(&gauge.lines_read, lines_read), (&gauge.lines, lines)] {
            count.store(n, Ordering::Relaxed);
        }
        gauge.shots_read.store(100 * lines_read, Ordering::Relaxed);
        gauge.shots.store(100 * lines, Ordering::Relaxed);
        gauge
    }

    #[test]
    fn what_is_read_but_held_is_not_done() {
        let progress = Progress::new(ProgressMode::Hidden, vec![1]);
        let fraction = |gauge: &Gauge| progress.fraction(State::of(gauge));
        assert_eq!(fraction(&gauge(1_000_000, 40, 0)), Some(0.0));
        assert_eq!(fraction(&gauge(500_000, 40, 20)), Some(0.25));
        assert_eq!(fraction(&gauge(1_000_000, 40, 40)), Some(1.0));
        assert_eq!(fraction(&gauge(u64::MAX, 40, 20)), None);
        assert_eq!(progress.rate(State::of(&gauge(1_000_000, 40, 0))), "4000 shots read");
        assert_eq!(progress.left(State::of(&gauge(1_000_000, 40, 0))), "", "the time left is unknown");
    }

    #[test]
    fn inputs_count_by_their_size() {
        let mut progress = Progress::new(ProgressMode::Hidden, vec![30, 10, 60]);
        let half = gauge(500_000, 2, 2);
        let mut fractions = Vec::new();
        for has_failed in [false, true, false] {
            progress.begin("a");
            fractions.push(progress.fraction(State::of(&half)));
            progress.count(has_failed);
        }
        assert_eq!(fractions, [0.15, 0.35, 0.7].map(Some));
        assert_eq!(progress.fraction(State::default()), Some(1.0));
        assert_eq!(progress.label(), "a (3 of 3, 1 failed)");
    }
}

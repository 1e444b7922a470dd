//! Progress display: a bar on a terminal, plain lines elsewhere, JSON for programs.

use std::collections::BTreeMap;
use std::io::Write;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use serde_json::json;

use super::worker::Gauge;
use wavex_line::printable::printable;

mod phase;

pub use phase::Phase;

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

/// Progress of a run for a program that shows it; clones share it.
#[derive(Clone, Debug, Default)]
pub struct ProgressWatch(Arc<[AtomicU64; 2]>);

impl ProgressWatch {
    /// Part of the run that is done, 0 to 1, and the number of shots that have passed the chain.
    pub fn get(&self) -> (f64, u64) {
        let [ppm, shots] = &*self.0;
        (ppm.load(Ordering::Relaxed) as f64 * 1e-6, shots.load(Ordering::Relaxed))
    }

    /// Sets the part, unless it is unknown, and the number of shots.
    pub fn set(&self, part: Option<f64>, passed: u64) {
        let [ppm, shots] = &*self.0;
        if let Some(part) = part {
            ppm.store((part.clamp(0.0, 1.0) * 1e6) as u64, Ordering::Relaxed);
        }
        shots.store(passed, Ordering::Relaxed);
    }
}

/// Displays the progress of a run on standard error.
#[derive(Debug)]
pub struct Progress {
    mode: ProgressMode,
    watch: Option<ProgressWatch>,
    /// Size of each input to run by its number, bytes, at least 1.
    sizes: BTreeMap<usize, u64>,
    /// Sum of the sizes of the inputs that have ended, bytes.
    ended_bytes: u64,
    begun: usize,
    done: usize,
    failed: usize,
    running: BTreeMap<usize, RunningInput>,
    /// Stem and place of the last input that ended.
    last: (String, usize),
    run_started: Instant,
    /// Shots of inputs that have ended.
    shots_before: u64,
    bar: Option<ProgressBar>,
    next: Duration,
}

/// An input that is running.
#[derive(Debug)]
struct RunningInput {
    stem: String,
    /// Its place among the inputs to run, from 1.
    place: usize,
    started: Instant,
    gauge: Arc<Gauge>,
}

impl RunningInput {
    fn state(&self) -> InputProgress {
        let state = InputProgress::of(&self.gauge);
        InputProgress {
            shots_per_s: state.shots as f64 / self.started.elapsed().as_secs_f64().max(1e-3),
            ..state
        }
    }
}

/// State of an input, or the sum of several.
#[derive(Clone, Copy, Debug, Default)]
struct InputProgress {
    shots: u64,
    shots_read: u64,
    shots_per_s: f64,
    /// Part of the input that has passed the whole chain, if known.
    fraction: Option<f64>,
}

impl InputProgress {
    fn of(gauge: &Gauge) -> InputProgress {
        let get = |count: &AtomicU64| count.load(Ordering::Relaxed);
        let read = Some(get(&gauge.read_ppm)).filter(|read| *read != u64::MAX);
        // What is read is not done: a stage may hold the first lines, such as `calibrate`.
        let passed = get(&gauge.lines) as f64 / get(&gauge.lines_read).max(1) as f64;
        let fraction = read.map(|read| read as f64 * 1e-6 * passed.min(1.0));
        InputProgress {
            shots: get(&gauge.shots),
            shots_read: get(&gauge.shots_read),
            shots_per_s: 0.0,
            fraction,
        }
    }
}

impl Progress {
    /// Creates a display for inputs with these numbers and sizes, bytes.
    pub fn new(mode: ProgressMode, sizes: BTreeMap<usize, u64>) -> Progress {
        Progress {
            mode,
            watch: None,
            sizes,
            ended_bytes: 0,
            begun: 0,
            done: 0,
            failed: 0,
            running: BTreeMap::new(),
            last: (String::new(), 0),
            run_started: Instant::now(),
            shots_before: 0,
            bar: None,
            next: interval(mode),
        }
    }

    /// The same, which also updates `watch`.
    pub fn watched(mut self, watch: Option<ProgressWatch>) -> Progress {
        self.watch = watch;
        self
    }

    fn update_watch(&self) {
        if let Some(watch) = &self.watch {
            watch.set(self.fraction(), self.shots_before + self.state().shots);
        }
    }

    /// Shows an input that begins.
    pub fn begin(&mut self, number: usize, stem: &str, gauge: &Arc<Gauge>) {
        self.begun += 1;
        let (stem, started, gauge) = (stem.to_string(), Instant::now(), Arc::clone(gauge));
        self.running.insert(number, RunningInput { stem, place: self.begun, started, gauge });
        match self.mode {
            ProgressMode::Bar => {
                let label = self.label();
                self.bar.get_or_insert_with(bar).set_prefix(printable(&label).into_owned());
            }
            ProgressMode::Json => self.json(),
            ProgressMode::Lines | ProgressMode::Hidden => {}
        }
    }

    /// Shows the state of the running inputs, if it is time.
    pub fn show(&mut self) {
        self.update_watch();
        let state = self.state();
        if let Some(bar) = &self.bar {
            bar.set_position((self.fraction().unwrap_or(0.0) * 1e6) as u64);
            bar.set_message(format!("{}{}", rate(state), self.left()));
            return;
        }
        if self.run_started.elapsed() < self.next {
            return;
        }
        self.next += interval(self.mode);
        match self.mode {
            ProgressMode::Lines => {
                let part = self.fraction().map_or(String::new(), |part| format!("{:.0} %, ", 100.0 * part));
                line(&self.label(), &format!("{part}{}{}", rate(state), self.left()));
            }
            ProgressMode::Json => self.json(),
            ProgressMode::Bar | ProgressMode::Hidden => {}
        }
    }

    /// Shows the result of an input.
    pub fn end(&mut self, number: usize) {
        self.bar.take().inspect(ProgressBar::finish_and_clear);
        let Some(ended) = self.running.remove(&number) else { return };
        let state = ended.state();
        if matches!(self.mode, ProgressMode::Bar | ProgressMode::Lines) {
            let label = label([&ended].into_iter(), self.sizes.len(), self.failed);
            line(&label, &format!("{}, {:.1} s", rate(state), ended.started.elapsed().as_secs_f64()));
        }
        self.shots_before += state.shots;
        self.ended_bytes += self.sizes.get(&number).copied().unwrap_or(0);
        self.last = (ended.stem, ended.place);
        self.update_watch();
    }

    /// Counts an input that has ended.
    pub fn count(&mut self, has_failed: bool) {
        if has_failed {
            self.failed += 1
        } else {
            self.done += 1
        }
        if self.mode == ProgressMode::Json {
            self.json();
        }
        if self.mode == ProgressMode::Bar && !self.running.is_empty() {
            let label = self.label();
            self.bar.get_or_insert_with(bar).set_prefix(printable(&label).into_owned());
        }
    }

    /// Names and places of the running inputs.
    fn label(&self) -> String {
        label(self.running.values(), self.sizes.len(), self.failed)
    }

    /// Sum of the running inputs.
    fn state(&self) -> InputProgress {
        let states = self.running.values().map(RunningInput::state);
        states.fold(InputProgress::default(), |sum, state| InputProgress {
            shots: sum.shots + state.shots,
            shots_read: sum.shots_read + state.shots_read,
            shots_per_s: sum.shots_per_s + state.shots_per_s,
            fraction: None,
        })
    }

    /// Part of the run that is done, by the size of the inputs, if known.
    fn fraction(&self) -> Option<f64> {
        let mut bytes = self.ended_bytes as f64;
        for (number, running) in &self.running {
            let state = running.state();
            if state.shots_read > 0 {
                bytes += self.sizes.get(number).copied().unwrap_or(0) as f64 * state.fraction?;
            }
        }
        Some(bytes / (self.sizes.values().sum::<u64>() as f64).max(1.0))
    }

    /// Time until the end of the run, s, if known.
    fn left_s(&self) -> Option<f64> {
        left(self.run_started.elapsed(), self.fraction()?)
    }

    fn left(&self) -> String {
        self.left_s().map_or(String::new(), |left_s| format!(", {left_s:.0} s left"))
    }

    fn json(&self) {
        let elapsed_s = self.run_started.elapsed().as_secs_f64();
        let shots = self.shots_before + self.state().shots;
        let first = self.running.values().next();
        let (stem, place) = first.map_or((&self.last.0, self.last.1), |first| (&first.stem, first.place));
        let object = json!({
            "phase": "run",
            "input": stem,
            "number": place,
            "inputs": self.sizes.len(),
            "running": self.running.len(),
            "done": self.done,
            "failed": self.failed,
            "fraction": self.fraction(),
            "shots": shots,
            "shots_per_s": shots as f64 / elapsed_s.max(1e-3),
            "elapsed_s": elapsed_s,
            "left_s": self.left_s(),
        });
        print_line(&object.to_string());
    }
}

impl Drop for Progress {
    fn drop(&mut self) {
        self.bar.take().inspect(ProgressBar::finish_and_clear);
    }
}

/// Time that the rest takes if it takes as long as this part, s.
fn left(elapsed: Duration, fraction: f64) -> Option<f64> {
    (fraction > 0.0).then(|| elapsed.as_secs_f64() * (1.0 / fraction - 1.0))
}

fn interval(mode: ProgressMode) -> Duration {
    Duration::from_secs(if mode == ProgressMode::Json { 1 } else { 10 })
}

fn bar() -> ProgressBar {
    let bar = ProgressBar::with_draw_target(Some(1_000_000), ProgressDrawTarget::stderr());
    let style = ProgressStyle::with_template("{prefix} [{bar:30}] {percent:>3}% {msg}");
    bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()).progress_chars("=> "));
    bar
}

/// Names of running inputs, their places, and how many have failed.
fn label<'a>(running: impl Iterator<Item = &'a RunningInput>, inputs: usize, failed: usize) -> String {
    let (stems, places): (Vec<&str>, Vec<String>) =
        running.map(|input| (input.stem.as_str(), input.place.to_string())).unzip();
    let failed = if failed > 0 { format!(", {failed} failed") } else { String::new() };
    match inputs {
        1 => stems.join(", "),
        inputs => format!("{} ({} of {inputs}{failed})", stems.join(", "), places.join(", ")),
    }
}

fn rate(state: InputProgress) -> String {
    match state {
        InputProgress { shots: 0, shots_read: 1.., .. } => format!("{} shots read", state.shots_read),
        _ => format!("{} shots, {:.3} M shots/s", state.shots, state.shots_per_s / 1e6),
    }
}

fn line(label: &str, text: &str) {
    print_line(&format!("{label}: {text}"));
}

fn print_line(text: &str) {
    // A closed standard error does not end a run.
    let _ = writeln!(std::io::stderr(), "{}", printable(text));
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

    fn progress(sizes: &[u64]) -> Progress {
        Progress::new(ProgressMode::Hidden, sizes.iter().copied().enumerate().collect())
    }

    #[test]
    fn what_is_read_but_held_is_not_done() {
        let running = |gauge: Gauge| {
            let mut progress = progress(&[1]);
            progress.begin(0, "a", &Arc::new(gauge));
            progress
        };
        let fraction = |gauge| running(gauge).fraction();
        assert_eq!(fraction(gauge(1_000_000, 40, 0)), Some(0.0));
        assert_eq!(fraction(gauge(500_000, 40, 20)), Some(0.25));
        assert_eq!(fraction(gauge(1_000_000, 40, 40)), Some(1.0));
        assert_eq!(fraction(gauge(u64::MAX, 40, 20)), None);
        let held = running(gauge(1_000_000, 40, 0));
        assert_eq!(rate(held.state()), "4000 shots read");
        assert_eq!(held.left(), "", "the time left is unknown");
    }

    #[test]
    fn inputs_count_by_their_size() {
        let mut progress = progress(&[30, 10, 60]);
        let half = || Arc::new(gauge(500_000, 2, 2));
        let mut fractions = Vec::new();
        for (number, has_failed) in [false, true, false].into_iter().enumerate() {
            progress.begin(number, "a", &half());
            fractions.push(progress.fraction());
            progress.end(number);
            progress.count(has_failed);
        }
        assert_eq!(fractions, [0.15, 0.35, 0.7].map(Some));
        assert_eq!(progress.fraction(), Some(1.0));
    }

    #[test]
    fn inputs_that_run_at_once_add_up() {
        let mut progress = progress(&[30, 10, 60]);
        progress.begin(0, "a", &Arc::new(gauge(500_000, 2, 2)));
        progress.begin(1, "b", &Arc::new(gauge(1_000_000, 3, 3)));
        assert_eq!((progress.fraction(), progress.state().shots), (Some(0.25), 500));
        assert_eq!(label(progress.running.values(), 3, 1), "a, b (1, 2 of 3, 1 failed)");
        progress.end(1);
        progress.begin(2, "c", &Arc::new(gauge(0, 0, 0)));
        assert_eq!(progress.fraction(), Some(0.25));
        assert_eq!(label(progress.running.values(), 3, 0), "a, c (1, 3 of 3)");
    }
    #[test]
    fn a_bar_shows_the_running_inputs_their_part_and_the_time_left() {
        let mut progress = Progress::new(ProgressMode::Bar, BTreeMap::from([(0, 30), (1, 10)]));
        progress.begin(0, "a", &Arc::new(gauge(500_000, 2, 2)));
        progress.begin(1, "b", &Arc::new(gauge(0, 0, 0)));
        progress.show();
        let bar = progress.bar.clone().unwrap();
        assert_eq!((bar.prefix().as_str(), bar.position()), ("a, b (1, 2 of 2)", 375_000));
        let message = bar.message();
        assert!(message.starts_with("200 shots, ") && message.ends_with(" s left"), "{message}");
        // A failed input clears the bar for its line; the rest has a new one.
        progress.end(0);
        assert!(bar.is_finished() && progress.bar.is_none());
        progress.count(true);
        let bar = progress.bar.clone().unwrap();
        assert_eq!(bar.prefix(), "b (2 of 2, 1 failed)");
        drop(progress);
        assert!(bar.is_finished(), "a bar does not outlast its run");
    }

    #[test]
    fn lines_and_objects_come_at_their_intervals() {
        for (mode, interval_s) in [(ProgressMode::Lines, 10), (ProgressMode::Json, 1)] {
            let mut progress = Progress::new(mode, BTreeMap::from([(0, 1)]));
            progress.begin(0, "a", &Arc::new(gauge(500_000, 2, 2)));
            progress.next = Duration::MAX;
            progress.show();
            assert_eq!(progress.next, Duration::MAX, "it is not time");
            progress.next = Duration::ZERO;
            progress.show();
            assert_eq!(progress.next, Duration::from_secs(interval_s));
        }
    }
}

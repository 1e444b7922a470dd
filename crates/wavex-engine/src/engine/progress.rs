//! Progress display: a bar on a terminal, plain lines elsewhere, JSON for programs.

use std::collections::BTreeMap;
use std::io::Write;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use serde_json::json;

use super::worker::Gauge;
use wavex_line::printable::printable;

mod bar;
mod phase;
mod words;

use bar::{Bar, shortened};
pub use bar::{terminal_columns, without_bar};
pub use phase::Phase;
use words::duration;
pub use words::rate;

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
    bar: Option<Bar>,
    next: Duration,
}

/// An input that is running.
#[derive(Debug)]
struct RunningInput {
    stem: String,
    /// Its place among the inputs to run, from 1.
    place: usize,
    started: Instant,
    /// Time at which its first line was seen to have passed the chain.
    passing_since: Option<Instant>,
    gauge: Arc<Gauge>,
}

impl RunningInput {
    fn state(&self) -> InputProgress {
        let state = InputProgress::of(&self.gauge);
        // The time before the first line has passed is no work on shots that have.
        let since = self.passing_since.unwrap_or(self.started);
        InputProgress { shots_per_s: state.shots as f64 / since.elapsed().as_secs_f64().max(1e-3), ..state }
    }

    /// What most of the work is now, and the done fraction of it, if known.
    fn activity(&self) -> (&'static str, Option<f64>) {
        let state = self.state();
        match self.gauge.calibration.fraction() {
            Some(fraction) => ("calibrating", Some(fraction)),
            None if self.passing_since.is_none() => ("reading", state.read),
            None => ("processing", state.fraction),
        }
    }
}

/// State of an input, or the sum of several.
#[derive(Clone, Copy, Debug, Default)]
struct InputProgress {
    shots: u64,
    shots_read: u64,
    shots_per_s: f64,
    /// Part of the input that has been read, if known.
    read: Option<f64>,
    /// Part of the input that has passed the whole chain, if known.
    fraction: Option<f64>,
}

impl InputProgress {
    fn of(gauge: &Gauge) -> InputProgress {
        let get = |count: &AtomicU64| count.load(Ordering::Relaxed);
        let read = Some(get(&gauge.read_ppm)).filter(|read| *read != u64::MAX).map(|ppm| ppm as f64 * 1e-6);
        // What is read is not done: a stage may hold the first lines, such as `calibrate`.
        let passed = get(&gauge.lines) as f64 / get(&gauge.lines_read).max(1) as f64;
        let fraction = read.map(|read| read * passed.min(1.0));
        InputProgress {
            shots: get(&gauge.shots),
            shots_read: get(&gauge.shots_read),
            shots_per_s: 0.0,
            read,
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
        let running = RunningInput {
            stem: stem.to_string(),
            place: self.begun,
            started: Instant::now(),
            passing_since: None,
            gauge: Arc::clone(gauge),
        };
        self.running.insert(number, running);
        match self.mode {
            ProgressMode::Bar => self.draw(),
            ProgressMode::Json => self.json(),
            ProgressMode::Lines | ProgressMode::Hidden => {}
        }
    }

    /// Draws the bar.
    fn draw(&mut self) {
        let (activity, fraction) = self.activity();
        let text = format!("{} {activity}", shortened(&self.label()));
        let bar = self.bar.get_or_insert_with(Bar::new);
        bar.show(&text, fraction);
    }

    /// Shows the state of the running inputs, if it is time.
    pub fn show(&mut self) {
        self.update_watch();
        for running in self.running.values_mut().filter(|running| running.passing_since.is_none()) {
            running.passing_since = (running.gauge.shots.load(Ordering::Relaxed) > 0).then(Instant::now);
        }
        if self.bar.is_some() {
            self.draw();
            if let Some(bar) = &self.bar {
                bar.set_message(format!("{}{}", self.rate(), self.left()).trim_start_matches(", "));
            }
            return;
        }
        if self.run_started.elapsed() < self.next {
            return;
        }
        self.next += interval(self.mode);
        match self.mode {
            ProgressMode::Lines => {
                let (activity, fraction) = self.activity();
                let percent = fraction.map_or(String::new(), |part| format!(" {:.0} %", 100.0 * part));
                line(&self.label(), &format!("{activity}{percent}{}{}", self.rate(), self.left()));
            }
            ProgressMode::Json => self.json(),
            ProgressMode::Bar | ProgressMode::Hidden => {}
        }
    }

    /// Shows the result of an input.
    pub fn end(&mut self, number: usize) {
        self.bar = None;
        let Some(ended) = self.running.remove(&number) else { return };
        let state = ended.state();
        // The end of a run says the same of a single input.
        if matches!(self.mode, ProgressMode::Bar | ProgressMode::Lines) && self.sizes.len() > 1 {
            let label = label([&ended].into_iter(), self.sizes.len(), self.failed);
            let seconds = ended.started.elapsed().as_secs_f64();
            let per_s = rate(state.shots as f64 / seconds.max(1e-3));
            line(&label, &format!("{} shots, {per_s}, {}", state.shots, duration(seconds)));
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
            self.draw();
        }
    }

    /// What most of the work is now and its done fraction; of several inputs, the fraction of the run.
    fn activity(&self) -> (&'static str, Option<f64>) {
        let first = self.running.values().next().map_or(("reading", None), RunningInput::activity);
        if self.sizes.len() == 1 { first } else { (first.0, self.fraction()) }
    }

    /// Rate at which shots pass the chain, if any have.
    fn rate(&self) -> String {
        let state = self.state();
        if state.shots > 0 { format!(", {}", rate(state.shots_per_s)) } else { String::new() }
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
            ..InputProgress::default()
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
        let of_single = || self.running.values().next().filter(|_| self.sizes.len() == 1)?.passing_since;
        left(of_single().unwrap_or(self.run_started).elapsed(), self.fraction()?)
    }

    fn left(&self) -> String {
        self.left_s().map_or(String::new(), |left_s| format!(", {} left", duration(left_s)))
    }

    fn json(&self) {
        let elapsed_s = self.run_started.elapsed().as_secs_f64();
        let shots = self.shots_before + self.state().shots;
        let first = self.running.values().next();
        let (stem, place) = first.map_or((&self.last.0, self.last.1), |first| (&first.stem, first.place));
        let (activity, activity_fraction) = self.activity();
        let object = json!({
            "phase": "run",
            "input": stem,
            "number": place,
            "inputs": self.sizes.len(),
            "running": self.running.len(),
            "done": self.done,
            "failed": self.failed,
            "fraction": self.fraction(),
            "activity": activity,
            "activity_fraction": activity_fraction,
            "shots": shots,
            "shots_per_s": shots as f64 / elapsed_s.max(1e-3),
            "elapsed_s": elapsed_s,
            "left_s": self.left_s(),
        });
        print_line(&object.to_string());
    }
}

/// Time that the rest takes if it takes as long as this part, s.
fn left(elapsed: Duration, fraction: f64) -> Option<f64> {
    (fraction > 0.0).then(|| elapsed.as_secs_f64() * (1.0 / fraction - 1.0))
}

fn interval(mode: ProgressMode) -> Duration {
    Duration::from_secs(if mode == ProgressMode::Json { 1 } else { 10 })
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
        assert_eq!(held.activity(), ("reading", Some(1.0)));
        assert_eq!((held.rate(), held.left()), (String::new(), String::new()), "both are unknown");
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
    fn the_activity_of_a_single_input_has_its_own_fraction() {
        let mut progress = progress(&[1]);
        let gauge = Arc::new(gauge(1_000_000, 40, 0));
        progress.begin(0, "a", &gauge);
        gauge.calibration.begin(100);
        assert_eq!(progress.activity(), ("calibrating", Some(0.0)));
        gauge.calibration.end();
        gauge.passed(100);
        progress.show();
        assert_eq!(progress.activity(), ("processing", Some(0.025)));
    }

    #[test]
    fn a_bar_shows_the_running_inputs_their_part_and_the_time_left() {
        let mut progress = Progress::new(ProgressMode::Bar, BTreeMap::from([(0, 30), (1, 10)]));
        progress.begin(0, "a", &Arc::new(gauge(500_000, 2, 2)));
        progress.begin(1, "b", &Arc::new(gauge(0, 0, 0)));
        progress.show();
        let bar = progress.bar.as_ref().unwrap().shown();
        assert_eq!((bar.prefix().as_str(), bar.position()), ("a, b (1, 2 of 2) processing", 375_000));
        let message = bar.message();
        assert!(message.contains(" shots/s, ") && message.ends_with(" s left"), "{message}");
        // A failed input clears the bar for its line; the rest has a new one.
        progress.end(0);
        assert!(bar.is_finished() && progress.bar.is_none());
        progress.count(true);
        let bar = progress.bar.as_ref().unwrap().shown();
        assert_eq!(bar.prefix(), "b (2 of 2, 1 failed) reading");
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

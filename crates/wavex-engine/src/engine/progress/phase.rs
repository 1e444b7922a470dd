//! Progress of work on inputs that has no shots to count.

use std::time::{Duration, Instant};

use serde_json::json;

use super::bar::{Bar, shortened};
use super::words::duration;
use super::{ProgressMode, interval, left, line, print_line};

/// Displays the progress of a phase over some inputs on standard error.
#[derive(Debug)]
pub struct Phase {
    /// Name for programs.
    name: &'static str,
    /// Name for people.
    title: &'static str,
    mode: ProgressMode,
    inputs: usize,
    started: Instant,
    bar: Option<Bar>,
    next: Duration,
}

impl Phase {
    /// Creates a display for programs (`name`) and people (`title`).
    pub fn new(name: &'static str, title: &'static str, mode: ProgressMode, inputs: usize) -> Phase {
        let bar = (mode == ProgressMode::Bar).then(Bar::new);
        Phase { name, title, mode, inputs, started: Instant::now(), bar, next: Duration::ZERO }
    }

    /// Shows the done part of an input, 0 to 1; `number` counts from 0.
    pub fn show(&mut self, stem: &str, number: usize, part: f64) {
        let fraction = (number as f64 + part) / self.inputs.max(1) as f64;
        let place = number + 1;
        let label = match self.inputs {
            1 => stem.to_owned(),
            inputs => format!("{stem} ({place} of {inputs})"),
        };
        if let Some(bar) = &self.bar {
            bar.show(&format!("{}: {}", self.title, shortened(&label)), Some(fraction));
        }
        let elapsed = self.started.elapsed();
        if elapsed < self.next {
            return;
        }
        self.next = elapsed + interval(self.mode);
        let left_s = left(elapsed, fraction);
        match self.mode {
            ProgressMode::Lines => line(self.title, &format!("{label}, {:.0} %", 100.0 * fraction)),
            ProgressMode::Json => {
                let object = json!({
                    "phase": self.name,
                    "input": stem,
                    "number": place,
                    "inputs": self.inputs,
                    "fraction": fraction,
                    "elapsed_s": elapsed.as_secs_f64(),
                    "left_s": left_s,
                });
                print_line(&object.to_string());
            }
            ProgressMode::Bar => {
                let left = left_s.map_or(String::new(), |left_s| format!("{} left", duration(left_s)));
                self.bar.iter().for_each(|bar| bar.set_message(&left));
            }
            ProgressMode::Hidden => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bar_shows_the_input_and_its_part_of_the_phase() {
        let mut phase = Phase::new("calibrate", "calibrating", ProgressMode::Bar, 4);
        phase.show("a", 0, 0.5);
        let bar = phase.bar.as_ref().unwrap().shown();
        assert_eq!((bar.prefix().as_str(), bar.position()), ("calibrating: a (1 of 4)", 125_000));
        assert!(bar.message().ends_with(" s left"), "{}", bar.message());
        phase.show("b", 3, 1.0);
        assert_eq!((bar.prefix().as_str(), bar.position()), ("calibrating: b (4 of 4)", 1_000_000));
        drop(phase);
        assert!(bar.is_finished(), "a bar does not outlast its phase");
    }

    #[test]
    fn a_single_input_has_no_number() {
        let mut phase = Phase::new("copc", "sorting", ProgressMode::Bar, 1);
        phase.show("a", 0, 0.0);
        let bar = phase.bar.as_ref().unwrap().shown();
        assert_eq!((bar.prefix().as_str(), bar.message().as_str()), ("sorting: a", ""));
    }

    #[test]
    fn lines_and_objects_come_at_their_intervals() {
        for (mode, interval_s) in [(ProgressMode::Lines, 10), (ProgressMode::Json, 1)] {
            let mut phase = Phase::new("calibrate", "calibrating", mode, 2);
            phase.show("a", 0, 0.0);
            assert!(phase.next >= Duration::from_secs(interval_s), "the first comes at once");
            phase.next = Duration::MAX;
            phase.show("a", 0, 0.5);
            assert_eq!(phase.next, Duration::MAX, "it is not time");
        }
    }
}

//! The stage `simulate`: a flight over a scene with known truth.

use wavex_line::scan_line::{Kind, ScanLine};
use wavex_line::stage::{Context, LineLocation, Paths, Result, RunContext, Source, SourceConfig, StageSpec};

mod config;
mod files;
mod flight;
mod mta_ordering;
#[cfg(test)]
mod tests;

pub use config::{DetectorKind, GainFollows, Landscape, Response, ScannerKind, Simulate};

use files::{TrajectoryFiles, TruthFile};
use flight::SimulatedFlight;

/// Registry entry of the stage.
pub const STAGE: StageSpec = StageSpec::source::<Simulate>("simulate", Kind::Shots);

/// Sampling interval, ns.
const INTERVAL_NS: f64 = 1.0;
/// Full scale of the 8-bit digitiser.
const FULL_SCALE_DN: u16 = 255;

impl SourceConfig for Simulate {
    fn paths(&self) -> Option<&Paths> {
        None
    }

    fn stem(&self) -> &str {
        &self.stem
    }

    fn outputs(&self) -> Vec<&str> {
        [&self.truth, &self.sbet, &self.pof].into_iter().flatten().map(String::as_str).collect()
    }

    fn make(&self, run: &RunContext) -> Result<Box<dyn Source>> {
        let truth = match self.truth.as_ref().filter(|_| run.has_outputs) {
            Some(pattern) => Some(TruthFile::create(run, pattern, self.has_gain_control())?),
            None => None,
        };
        let trajectory = run.has_outputs.then(|| TrajectoryFiles::create(run, self)).transpose()?;
        let flight = SimulatedFlight::new(self)?.telling_truth(truth.is_some());
        Ok(Box::new(Simulator { flight, line: 0, last: None, lines: self.lines, truth, trajectory }))
    }
}

/// Source that generates one scan line after the other.
struct Simulator {
    flight: SimulatedFlight,
    /// Number of the next line.
    line: u32,
    /// Number of the last line and of its first shot.
    last: Option<(u32, u64)>,
    lines: u32,
    /// Truth table, until it is complete.
    truth: Option<TruthFile>,
    /// Trajectory, until it is written.
    trajectory: Option<TrajectoryFiles>,
}

impl Source for Simulator {
    fn next(&mut self, cx: &mut Context) -> Result<Option<ScanLine>> {
        if self.line == self.lines {
            if let Some(truth) = self.truth.take() {
                cx.publish(truth.finish()?);
            }
            if let Some(trajectory) = self.trajectory.take() {
                trajectory.finish(cx)?;
            }
            return Ok(None);
        }
        let (scan_line, returns) = self.flight.line(self.line);
        self.last = scan_line.emissions.first().map(|first| (self.line, first.shot));
        self.line += 1;
        if let Some(truth) = &mut self.truth {
            truth.write(&returns)?;
        }
        Ok(Some(scan_line))
    }

    fn progress(&self) -> Option<f64> {
        Some(f64::from(self.line) / f64::from(self.lines))
    }

    fn location(&self) -> Option<LineLocation> {
        let (line, first_shot) = self.last?;
        let records = u64::from(line)..u64::from(line) + 1;
        Some(LineLocation { records, row: 0, line, first_shot, is_complete: true })
    }

    fn line_at(&mut self, location: &LineLocation, cx: &mut Context) -> Result<Option<ScanLine>> {
        self.line = location.line;
        // Lines of the truth table follow each other.
        self.truth = None;
        if self.line < self.lines { self.next(cx) } else { Ok(None) }
    }
}

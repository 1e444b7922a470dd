//! Runs the stages before `decompose` on the current thread.

use crate::scan_line::ScanLine;
use crate::stage::{Context, Map, Output, Result, Source, StageError, Transform};

/// A reader and the stages that follow it.
pub(super) struct Upstream {
    source: Box<dyn Source>,
    cx: Context,
    steps: Vec<Step>,
    may_hold_bytes: usize,
}

/// A stage with its counters.
pub(super) struct Step {
    stage: Stage,
    cx: Context,
}

enum Stage {
    Map(Box<dyn Map>),
    Transform(Box<dyn Transform>),
}

impl Step {
    pub(super) fn map(map: Box<dyn Map>) -> Step {
        Step { stage: Stage::Map(map), cx: Context::default() }
    }

    pub(super) fn transform(transform: Box<dyn Transform>) -> Step {
        Step { stage: Stage::Transform(transform), cx: Context::default() }
    }
}

impl Upstream {
    /// `may_hold_bytes`: memory that each transform may hold back, bytes.
    pub(super) fn new(source: Box<dyn Source>, steps: Vec<Step>, may_hold_bytes: usize) -> Upstream {
        Upstream { source, cx: Context::default(), steps, may_hold_bytes }
    }

    /// Returns the first scan line that is wanted, and reads no further.
    pub(super) fn first(&mut self, mut wanted: impl FnMut(&ScanLine) -> bool) -> Result<Option<ScanLine>> {
        let mut found = None;
        let mut take = |line: ScanLine| {
            if !wanted(&line) {
                return Ok(());
            }
            found = Some(line);
            Err(StageError::Stopped)
        };
        match self.run(&mut take) {
            Ok(()) | Err(StageError::Stopped) => Ok(found),
            Err(error) => Err(error),
        }
    }

    fn run(&mut self, take: &mut dyn FnMut(ScanLine) -> Result<()>) -> Result<()> {
        while let Some(line) = self.source.next(&mut self.cx)? {
            push(&mut self.steps, line, self.may_hold_bytes, take)?;
        }
        for i in 0..self.steps.len() {
            let (step, behind) = self.steps[i..].split_at_mut(1);
            if let Some(Step { stage: Stage::Transform(transform), cx }) = step.first_mut() {
                let mut emit = |line| push(behind, line, self.may_hold_bytes, take);
                transform.finish(&mut Output::new(cx, self.may_hold_bytes, &mut emit))?;
            }
        }
        Ok(())
    }
}

/// Passes a line through these stages and each result to the next stage.
fn push(
    steps: &mut [Step],
    line: ScanLine,
    may_hold_bytes: usize,
    take: &mut dyn FnMut(ScanLine) -> Result<()>,
) -> Result<()> {
    let Some((step, behind)) = steps.split_first_mut() else {
        return take(line);
    };
    match &mut step.stage {
        Stage::Map(map) => push(behind, map.map(line, &mut step.cx)?, may_hold_bytes, take),
        Stage::Transform(transform) => {
            let mut emit = |line| push(behind, line, may_hold_bytes, take);
            transform.process(line, &mut Output::new(&mut step.cx, may_hold_bytes, &mut emit))
        }
    }
}

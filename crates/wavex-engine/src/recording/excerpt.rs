//! A source that leaves out the lines between the start of a recording and one of its shots.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use super::Recording;
use wavex_line::scan_line::ScanLine;
use wavex_line::stage::{Context, Result, RunContext, Source, SourcePlan};

/// Plan of a source that skips to the lines around a shot once `may_skip` is set.
pub struct Excerpt {
    /// Reader of the recording.
    pub reader: Arc<dyn SourcePlan>,
    /// Keys of the reader.
    pub keys: serde_json::Value,
    /// The shot.
    pub shot: u64,
    /// Number of lines to read before and after the line of the shot.
    pub margin: usize,
    /// Set once the stages have learnt from the first lines.
    pub may_skip: Arc<AtomicBool>,
}

impl SourcePlan for Excerpt {
    fn make(&self, run: &RunContext) -> Result<Box<dyn Source>> {
        let source = self.reader.make(run)?;
        let skip = Skip {
            reader: Arc::clone(&self.reader),
            keys: self.keys.clone(),
            run: run.clone(),
            shot: self.shot,
            margin: self.margin,
            may_skip: Arc::clone(&self.may_skip),
        };
        Ok(Box::new(ExcerptSource { source, skip: Some(skip), lines: 0, ahead: None }))
    }
}

/// Arguments of the skip.
struct Skip {
    reader: Arc<dyn SourcePlan>,
    keys: serde_json::Value,
    run: RunContext,
    shot: u64,
    margin: usize,
    may_skip: Arc<AtomicBool>,
}

struct ExcerptSource {
    source: Box<dyn Source>,
    /// `None` once it has skipped or read the shot.
    skip: Option<Skip>,
    /// Number of lines read from the start.
    lines: usize,
    /// The recording and the lines to read from it.
    ahead: Option<(Recording, std::ops::Range<usize>)>,
}

impl Source for ExcerptSource {
    fn next(&mut self, cx: &mut Context) -> Result<Option<ScanLine>> {
        let may_skip =
            |skip: &mut Skip| skip.may_skip.load(Ordering::Relaxed) && self.source.location().is_some();
        if let Some(skip) = self.skip.take_if(may_skip) {
            let read_ppm = Arc::clone(&skip.run.read_ppm);
            let mut recording = Recording::of_reader(skip.reader, &skip.keys, skip.run)?;
            let index = recording.index(&mut |part| {
                read_ppm.store((part * 1e6) as u64, Ordering::Relaxed);
                Ok(())
            })?;
            if let Some(of_shot) = index.of_shot(skip.shot).next() {
                let first = of_shot.saturating_sub(skip.margin).max(self.lines);
                let end = index.lines().len().min(of_shot + skip.margin + 1);
                self.ahead = Some((recording, first..end));
            } else {
                return Ok(None);
            }
        }
        if let Some((recording, numbers)) = &mut self.ahead {
            let Some(number) = numbers.next() else { return Ok(None) };
            return recording.line(number);
        }
        let line = self.source.next(cx)?;
        self.lines += 1;
        if let (Some(line), Some(skip)) = (&line, &self.skip)
            && line.emissions.iter().any(|emission| emission.shot == skip.shot)
        {
            self.skip = None;
        }
        Ok(line)
    }

    fn progress(&self) -> Option<f64> {
        self.source.progress()
    }
}

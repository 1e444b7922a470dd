//! Random access to the scan lines and shots of a recording.
//!
//! An index of all scan lines is made in one pass and kept next to the recording
//! (`NAME.wvxi`, see [`index`]), so that later programs find a line or a shot at once.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use crate::job::{Job, Override};
use wavex_formats::format::reader_of;
use wavex_line::scan_line::{InputInfo, ScanLine};
use wavex_line::stage::{Context, Plan, Result, RunContext, Source, SourcePlan, StageError, StageSpec};

mod excerpt;
pub mod index;

pub use excerpt::Excerpt;
pub use index::{IndexedLine, LineIndex};

/// A recording whose scan lines and shots can be read in any order.
pub struct Recording {
    reader: Arc<dyn SourcePlan>,
    /// Keys of the reader that decide on the content of lines.
    keys: String,
    run: RunContext,
    source: Box<dyn Source>,
    input: Arc<InputInfo>,
    index: Option<Arc<LineIndex>>,
    cx: Context,
}

impl Recording {
    /// Opens a recording: LAS, LAZ, PulseWaves, SDF or container, recognised by its extension.
    ///
    /// `stages` contains the readers; `set` overrides keys of the reader, as `--set` of `wavex run`.
    ///
    /// # Errors
    /// The format is unknown, a key is wrong, or the file cannot be read or has no shots.
    pub fn open(
        stages: &[&'static StageSpec],
        path: &Path,
        set: &[String],
    ) -> std::result::Result<Recording, OpenError> {
        let name = path.display().to_string();
        let reader = reader_of(&name).map_err(OpenError::Format)?;
        let text = format!("[[stage]]\ntype = \"{reader}\"\npath = {}\n", toml::Value::String(name));
        let overrides: Vec<Override> = set.iter().map(Override::new).collect();
        let job = Job::parse(stages, "the reader of the recording", &text, &overrides)?;
        let stage = job.stages.into_iter().next();
        let Some((Plan::Source(reader), keys)) = stage.map(|s| (s.planned.plan, s.planned.resolved)) else {
            return Err(OpenError::Format("the recording has no reader".into()));
        };
        Ok(Recording::of_reader(reader, &keys, RunContext::alone(path))?)
    }

    /// Opens the input of a run with a reader and its keys.
    ///
    /// # Errors
    /// The file cannot be read or has no shots.
    pub fn of_reader(
        reader: Arc<dyn SourcePlan>,
        keys: &serde_json::Value,
        run: RunContext,
    ) -> Result<Recording> {
        let mut cx = Context::of_run();
        let mut source = reader.make(&run)?;
        let Some(first) = source.next(&mut cx)? else {
            let problem = format!("{} has no shots", run.input.display());
            return Err(StageError::failed(problem, "choose another recording"));
        };
        let keys = index::keys_of(keys);
        Ok(Recording { reader, keys, run, source, input: first.input, index: None, cx })
    }

    /// Path of the recording.
    pub fn path(&self) -> &Path {
        &self.run.input
    }

    /// Metadata of the recording.
    pub fn input(&self) -> &Arc<InputInfo> {
        &self.input
    }

    /// Counters and notes of all reads.
    pub fn context(&self) -> &Context {
        &self.cx
    }

    /// Reads all scan lines from the start, in the order of the file.
    ///
    /// # Errors
    /// The file cannot be opened again.
    pub fn scan_lines(&self) -> Result<ScanLines> {
        Ok(ScanLines { source: self.reader.make(&self.run)?, cx: Context::of_run() })
    }

    /// Returns the index; reads or makes it on first use.
    ///
    /// `watch` is called with the fraction read while it is made; an error of it ends that. An index
    /// that cannot be written, as in a folder without permission, is kept in memory.
    ///
    /// # Errors
    /// The recording cannot be read to its end, or its reader cannot return to lines (a stream, or
    /// an SDF file with `time_s`).
    pub fn index(&mut self, watch: &mut index::IndexObserver) -> Result<Arc<LineIndex>> {
        if let Some(index) = &self.index {
            return Ok(Arc::clone(index));
        }
        let index = LineIndex::of_file(&*self.reader, &self.keys, &self.run, watch)?;
        Ok(Arc::clone(self.index.insert(Arc::new(index))))
    }

    /// Reads a scan line by its position in the index, from 0; `None` past the end.
    ///
    /// # Errors
    /// As [`Recording::index`].
    pub fn line(&mut self, number: usize) -> Result<Option<ScanLine>> {
        let index = self.index(&mut |_| Ok(()))?;
        match index.lines().get(number) {
            Some(line) => self.source.line_at(&line.location, &mut self.cx),
            None => Ok(None),
        }
    }

    /// Reads the scan line of a shot; `None` if the recording has no shot of this number.
    ///
    /// # Errors
    /// As [`Recording::index`].
    pub fn line_of_shot(&mut self, shot: u64) -> Result<Option<ScanLine>> {
        let index = self.index(&mut |_| Ok(()))?;
        for number in index.of_shot(shot) {
            let line = self.line(number)?;
            if let Some(line) = line.filter(|line| line.emissions.iter().any(|e| e.shot == shot)) {
                return Ok(Some(line));
            }
        }
        Ok(None)
    }

    /// Number and time, s, of the shot nearest to a time; `None` if no shot has a time.
    ///
    /// # Errors
    /// As [`Recording::index`].
    pub fn nearest_shot(&mut self, gps_time_s: f64) -> Result<Option<(u64, f64)>> {
        let index = self.index(&mut |_| Ok(()))?;
        let mut nearest: Option<(f64, u64, f64)> = None;
        for (least_s, number) in index.by_time(gps_time_s) {
            if nearest.is_some_and(|(found_s, ..)| found_s < least_s) {
                break;
            }
            for emission in self.line(number)?.map(|line| line.emissions).unwrap_or_default() {
                let distance_s = (emission.gps_time_s - gps_time_s).abs();
                if distance_s.is_finite() && nearest.is_none_or(|(found_s, ..)| distance_s < found_s) {
                    nearest = Some((distance_s, emission.shot, emission.gps_time_s));
                }
            }
        }
        Ok(nearest.map(|(_, shot, time_s)| (shot, time_s)))
    }
}

/// Scan lines of a recording; see [`Recording::scan_lines`].
pub struct ScanLines {
    source: Box<dyn Source>,
    cx: Context,
}

impl ScanLines {
    /// Counters and notes of the lines read so far.
    pub fn context(&self) -> &Context {
        &self.cx
    }
}

impl Iterator for ScanLines {
    type Item = Result<ScanLine>;

    fn next(&mut self) -> Option<Result<ScanLine>> {
        self.source.next(&mut self.cx).transpose()
    }
}

/// Failure to open a recording.
#[derive(Debug, thiserror::Error)]
pub enum OpenError {
    /// No reader for the file's extension.
    #[error("{0}")]
    Format(String),
    /// A key of the reader is wrong.
    #[error(transparent)]
    Keys(#[from] crate::job::JobErrors),
    /// The file cannot be read.
    #[error(transparent)]
    Read(#[from] StageError),
}

/// Path of the index of a recording: its name, followed by `.wvxi`.
pub fn index_path(recording: &Path) -> PathBuf {
    let mut name = recording.as_os_str().to_owned();
    name.push(".wvxi");
    name.into()
}

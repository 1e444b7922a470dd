//! `write_returns`: writes decomposed scan lines, from which a run can start.

use std::sync::Arc;

use arrow_ipc::CompressionType;
use arrow_schema::{ArrowError, SchemaRef};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::returns_file::{Group, Identity, OfRecording, schema_of};
use wavex_formats::Error;
use wavex_formats::container::IpcWriter;
use wavex_line::keys::InvalidKey;
use wavex_line::scan_line::{Kind, ScanLine};
use wavex_line::stage::{
    Config, Context, OutputFile, Result, RunContext, Sink, SinkConfig, StageError, StageSpec,
};

/// Registry entry of the stage.
pub const STAGE: StageSpec =
    StageSpec::sink::<WriteReturns>("write_returns", &[Kind::Returns]).after(&["decompose"]);

/// Writes decomposed scan lines, from which a run can start without decomposing again.
///
/// Put it directly after `decompose`. `wavex run JOB --from-returns` and `wavex align JOB --apply` then read the files
/// instead of the recordings, and run only the stages after it: with another trajectory, calibration or corrections, the
/// outputs have the bytes of a run of the whole job.
///
/// A file has all values of returns, shots and counters without loss, the beams as recorded, the metadata of the
/// recording and its sensor model, as an Arrow IPC file compressed by ZSTD, one row per scan line. It also has the version of
/// wavex, a digest of the recording, and the keys of the stages before it: a run refuses a file made with others.
///
/// For tables of returns, see `write_table`.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct WriteReturns {
    /// Output file; `*` is the input's stem.
    pub path: String,
}

impl Default for WriteReturns {
    fn default() -> WriteReturns {
        WriteReturns { path: "*_decomposed.arrow".into() }
    }
}

impl Config for WriteReturns {
    fn check(&self) -> std::result::Result<(), InvalidKey> {
        InvalidKey::unless(
            self.path.ends_with(".arrow"),
            "path",
            "it must end in .arrow, such as \"*_decomposed.arrow\"",
        )
    }
}

impl SinkConfig for WriteReturns {
    fn outputs(&self) -> Vec<&str> {
        vec![&self.path]
    }

    fn needs_recorded(&self) -> bool {
        true
    }

    fn make(&self, run: &RunContext) -> Result<Box<dyn Sink>> {
        let identity = Identity::of(&run.chain, &run.input, &run.input_dir)?;
        let file = run.create(&self.path)?;
        Ok(Box::new(ReturnsWriter {
            identity,
            state: State::Waiting(file),
            of: None,
            of_shots: false,
            group: Group::default(),
        }))
    }
}

struct ReturnsWriter {
    identity: Identity,
    state: State,
    /// Of the first line; all others must have the same.
    of: Option<OfRecording>,
    /// Whether that line has shots.
    of_shots: bool,
    group: Group,
}

enum State {
    /// Waiting for the first line, which gives the header.
    Waiting(OutputFile),
    Open(Box<IpcWriter<OutputFile>>, SchemaRef),
    /// A write failed; the run ends.
    Failed,
}

impl ReturnsWriter {
    /// The writer, started with what is known of the recording.
    fn writer(&mut self) -> Result<(&mut IpcWriter<OutputFile>, &SchemaRef)> {
        if matches!(self.state, State::Waiting(_))
            && let State::Waiting(file) = std::mem::replace(&mut self.state, State::Failed)
        {
            let schema = schema_of(&self.identity, self.of.as_ref())?;
            let path = file.path().to_owned();
            let writer = IpcWriter::file(file, Arc::clone(&schema), Some(CompressionType::ZSTD));
            self.state = State::Open(Box::new(writer.map_err(|error| failed(&path, error))?), schema);
        }
        match &mut self.state {
            State::Open(writer, schema) => Ok((writer, schema)),
            _ => Err(StageError::Stopped),
        }
    }

    fn flush(&mut self) -> Result<()> {
        let mut group = std::mem::take(&mut self.group);
        let (writer, schema) = self.writer()?;
        let written = group.take(schema).and_then(|batch| writer.write(&batch));
        written.map_err(|error| failed("the returns file".as_ref(), error).into())
    }
}

fn failed(path: &std::path::Path, error: ArrowError) -> Error {
    match error {
        ArrowError::IoError(_, error) => Error::io(path, "write")(error),
        other => Error::unusable(path, other.to_string(), "please report this bug in wavex"),
    }
}

impl Sink for ReturnsWriter {
    fn write(&mut self, line: &ScanLine, _cx: &mut Context) -> Result<()> {
        let (Some(returns), Some(recorded)) = (line.returns(), &line.recorded) else {
            return Err(StageError::failed(
                "write_returns received no returns with their shots as recorded",
                "put it after `decompose`, in a job",
            ));
        };
        let input = &recorded.input;
        let of =
            OfRecording { input: Arc::clone(input), model: line.model.clone(), fusion: line.fusion.clone() };
        let has_shots = !recorded.emissions.is_empty();
        // Lines without shots have no metadata of their own.
        if has_shots && matches!(self.state, State::Waiting(_)) && !self.of_shots {
            self.of = None;
            self.of_shots = true;
        }
        if *self.of.get_or_insert_with(|| of.clone()) != of && has_shots {
            return Err(StageError::failed(
                format!(
                    "scan line {}: metadata or sensor model differ from those of the first line",
                    line.line
                ),
                "remove `write_returns`: a returns file has one sensor model",
            ));
        }
        self.group.add(line, &recorded.emissions, returns)?;
        if self.group.is_full() { self.flush() } else { Ok(()) }
    }

    fn finish(mut self: Box<Self>, cx: &mut Context) -> Result<()> {
        if !self.group.is_empty() {
            self.flush()?;
        }
        // Without lines, the file has none.
        self.writer()?;
        if let State::Open(writer, _) = self.state {
            let file = writer.finish().map_err(|error| failed("the returns file".as_ref(), error))?;
            cx.publish(file.finish()?);
        }
        Ok(())
    }
}

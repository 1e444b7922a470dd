//! `write_arrow`: recorded waveforms as the open container.

use std::io::{self, Stdout, Write};
use std::path::Path;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::container_info::{code_of, header_of};
use crate::batch::{Batch, Block, Blocks, Emission, InputInfo, Kind};
use crate::formats::container::{
    self, ContainerBlock, ContainerOnline, ContainerShot, ContainerWriter, LineBuilder,
};
use crate::stage::{
    self, Context, InvalidKey, OutputFile, Result, Sink, SinkConfig, Site, StageError, StageSpec,
};

/// The stage's place in the registry.
pub const STAGE: StageSpec = StageSpec::sink::<Config>("write_arrow", &[Kind::Shots]);

/// Writes recorded waveforms as the open waveform container (Arrow IPC).
///
/// pyarrow, Polars, DuckDB and R open it without wavex, and `read_arrow` reads it: the file format, one record batch per
/// scan line, one row per shot. The columns and metadata keys stand in `schemas/container.json`.
///
/// What comes back from `read_arrow` is equal to the bit: emissions, blocks, samples, online returns, and what is known
/// of the recording but for its path, its format and the reader's `odd_sample_shift`. Not written is what the chain finds by itself: the fitted moment of
/// emission, and the sensor model of `calibrate`.
///
/// The columns `scan_angle_deg` and `frame_scale` and the fields `zone` and `interval_ns` of blocks are this program's
/// extensions: they hold a null where there is nothing to say (no angle; a scale of 1; the row's zone; the recording's
/// sampling interval). The field `gain` of blocks is written only for recordings with automatic gain control; a null is 1.
///
/// Without a single shot no container is written, which is said in the report. Nothing is rejected.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Config {
    /// The file to write; `*` is the input's name. `-` is standard output, in the stream format.
    pub path: String,
    /// How the buffers are packed: 8-bit samples, which take 16 bits here, shrink to about a half with `lz4` and to
    /// about a third with `zstd`.
    pub compression: Compression,
}

impl Default for Config {
    fn default() -> Config {
        Config { path: "*.arrow".into(), compression: Compression::Lz4 }
    }
}

/// How the buffers of an Arrow file are packed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Compression {
    /// Not at all: the fastest to read, and other programs can map the file into memory.
    None,
    /// LZ4 frames.
    Lz4,
    /// ZSTD, level 3.
    Zstd,
}

impl stage::Config for Config {
    fn check(&self) -> std::result::Result<(), InvalidKey> {
        InvalidKey::unless(!self.path.is_empty(), "path", "the path is empty")
    }
}

/// The path that stands for standard output.
const STANDARD_OUTPUT: &str = "-";

impl SinkConfig for Config {
    fn outputs(&self) -> Vec<&str> {
        if self.path == STANDARD_OUTPUT { vec![] } else { vec![&self.path] }
    }

    fn make(&self, site: &Site) -> Result<Box<dyn Sink>> {
        let to = match self.path == STANDARD_OUTPUT {
            true => Target::Stream(io::stdout()),
            false => Target::File(site.create(&self.path)?),
        };
        let compression = match self.compression {
            Compression::None => container::Compression::None,
            Compression::Lz4 => container::Compression::Lz4,
            Compression::Zstd => container::Compression::Zstd,
        };
        Ok(Box::new(WriteArrow { state: State::Waiting(to), compression }))
    }
}

/// A container that is being written.
struct WriteArrow {
    state: State,
    compression: container::Compression,
}

enum State {
    /// The first line brings what the header says.
    Waiting(Target),
    Open(Box<ContainerWriter<Target>>),
    /// A write failed: the run is over.
    Failed,
}

/// Where the bytes go.
enum Target {
    File(OutputFile),
    Stream(Stdout),
}

impl Write for Target {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        match self {
            Target::File(file) => file.write(bytes),
            Target::Stream(stream) => stream.write(bytes),
        }
    }

    fn flush(&mut self) -> io::Result<()> {
        match self {
            Target::File(file) => file.flush(),
            Target::Stream(stream) => stream.flush(),
        }
    }
}

impl WriteArrow {
    /// The writer, begun with the first line's facts.
    fn writer(&mut self, info: &InputInfo) -> Result<&mut ContainerWriter<Target>> {
        if let State::Waiting(_) = self.state
            && let State::Waiting(to) = std::mem::replace(&mut self.state, State::Failed)
        {
            let header = header_of(info);
            let writer = match &to {
                Target::File(file) => {
                    let path = file.path().to_path_buf();
                    ContainerWriter::file(to, &path, &header, self.compression)?
                }
                Target::Stream(_) => {
                    ContainerWriter::stream(to, Path::new(STANDARD_OUTPUT), &header, self.compression)?
                }
            };
            self.state = State::Open(Box::new(writer));
        }
        match &mut self.state {
            State::Open(writer) => Ok(writer),
            _ => Err(StageError::Stopped),
        }
    }
}

impl Sink for WriteArrow {
    fn write(&mut self, batch: &Batch, _cx: &mut Context) -> Result<()> {
        let Some(blocks) = batch.blocks() else {
            return Err(StageError::failed(
                format!("write_arrow was given {}, and writes Shots", batch.kind()),
                "put it before `decompose`",
            ));
        };
        if batch.emissions.is_empty() {
            return Ok(());
        }
        let line = line_of(batch, blocks);
        Ok(self.writer(&batch.input)?.write(line)?)
    }

    fn finish(self: Box<Self>, cx: &mut Context) -> Result<()> {
        match self.state {
            State::Open(writer) => {
                if let Target::File(file) = writer.finish()? {
                    cx.keep(file.finish()?);
                }
            }
            State::Waiting(_) => cx.note("no container is written: there was not a single shot"),
            State::Failed => {}
        }
        Ok(())
    }
}

fn line_of(batch: &Batch, blocks: &Blocks) -> LineBuilder {
    let mut line = LineBuilder::new();
    let mut rest = blocks.iter().peekable();
    let mut online = blocks.online.iter().peekable();
    for (index, emission) in (0..).zip(&batch.emissions) {
        line.shot(&shot_of(emission, batch.line));
        while let Some(block) = rest.next_if(|block| block.emission == index) {
            line.block(&block_of(block, blocks, &batch.input));
        }
        while let Some(found) = online.next_if(|online| online.emission == index) {
            line.online(&ContainerOnline { time_ns: found.time_ns, amplitude: found.amplitude });
        }
    }
    line
}

fn shot_of(emission: &Emission, line: u32) -> ContainerShot {
    ContainerShot {
        shot: emission.shot,
        line,
        gps_time_s: Some(emission.gps_time_s).filter(|time| !time.is_nan()),
        clock_ps: emission.clock_ps,
        origin_m: emission.origin_m,
        direction: emission.direction,
        facet: emission.facet,
        flags: emission.flags,
        mta_zone: emission.mta_zone,
        scan_angle_deg: Some(emission.scan_angle_deg).filter(|angle| !angle.is_nan()),
        frame_scale: Some(emission.frame_scale).filter(|&scale| scale != 1.0),
    }
}

fn block_of<'a>(block: &Block, blocks: &'a Blocks, info: &InputInfo) -> ContainerBlock<'a> {
    ContainerBlock {
        channel: code_of(block.channel),
        start_ns: block.start_ns,
        interval_ns: Some(block.interval_ns).filter(|&interval| interval != info.sampling_interval_ns),
        zone: block.zone,
        gain: Some(block.gain).filter(|&gain| gain != 1.0),
        samples: blocks.samples(block),
    }
}

#[cfg(test)]
mod tests;

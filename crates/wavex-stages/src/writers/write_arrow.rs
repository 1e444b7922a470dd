//! `write_arrow`: writes recorded waveforms as the open container.

use std::io::{self, Stdout, Write};
use std::path::Path;
use std::sync::Arc;

use arrow_array::RecordBatch;
use arrow_schema::SchemaRef;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::container_info::{code_of, header_of};
use wavex_formats::container::{
    self, ContainerBlock, ContainerFootprint, ContainerOnline, ContainerShot, ContainerWriter, LineBuilder,
};
use wavex_line::keys::InvalidKey;
use wavex_line::scan_line::{Block, Blocks, Emission, InputInfo, Kind, ScanLine};
use wavex_line::stage::{
    self, Context, OutputFile, Result, RunContext, Sink, SinkConfig, StageError, StageSpec,
};

/// Registry entry of the stage.
pub const STAGE: StageSpec = StageSpec::sink::<WriteArrow>("write_arrow", &[Kind::Shots, Kind::Footprints]);

/// Writes recorded waveforms as the open waveform container (Arrow IPC).
///
/// pyarrow, Polars, DuckDB and R open it without wavex, and `read_arrow` reads it. It is an Arrow
/// file with one record line per scan line and one row per shot. `schemas/container.json`
/// describes the columns and metadata keys.
///
/// `read_arrow` restores the data bit by bit: emissions, blocks, samples, online returns, and the
/// metadata of the recording except its path, its format and the reader's `odd_sample_shift`.
/// Results of the chain are not written: the fitted time of emission, and the sensor model of
/// `calibrate`.
///
/// The columns `scan_angle_deg` and `frame_scale`, and the fields `zone` and `interval_ns` of
/// blocks, are extensions of this program. They are null for default values (no angle; a scale of
/// 1; the zone of the row; the sampling interval of the recording). The field `gain` of blocks is
/// written only for recordings with automatic gain control; null means 1.
///
/// Samples that are fractions of a digitiser step (GEDI and LVIS in HDF5) are written as 32-bit floats, in version 2
/// of the container, with the beam of each shot, its number in the mission, and background, noise and flag by the
/// instrument's processing. Further values of the product are not written. All other recordings have version 1.
///
/// Without any shots no container is written, and the report says so. Nothing is rejected.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct WriteArrow {
    /// Output file; `*` is the input's stem. `-` is standard output, in the stream format.
    pub path: String,
    /// Compression of the buffers. 8-bit samples take 16 bits here; `lz4` reduces them to about a
    /// half, `zstd` to about a third.
    pub compression: ContainerCompression,
}

impl Default for WriteArrow {
    fn default() -> WriteArrow {
        WriteArrow { path: "*.arrow".into(), compression: ContainerCompression::Lz4 }
    }
}

/// Compression of the buffers of an Arrow file.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ContainerCompression {
    /// None: fastest to read, and other programs can memory-map the file.
    None,
    /// LZ4 frames.
    Lz4,
    /// ZSTD, level 3.
    Zstd,
}

impl stage::Config for WriteArrow {
    fn check(&self) -> std::result::Result<(), InvalidKey> {
        InvalidKey::unless(!self.path.is_empty(), "path", "the path is empty")
    }
}

/// Path that means standard output.
const STANDARD_OUTPUT: &str = "-";

impl SinkConfig for WriteArrow {
    fn outputs(&self) -> Vec<&str> {
        if self.path == STANDARD_OUTPUT { vec![] } else { vec![&self.path] }
    }

    fn make(&self, run: &RunContext) -> Result<Box<dyn Sink>> {
        let to = match self.path == STANDARD_OUTPUT {
            true => ContainerTarget::Stream(io::stdout()),
            false => ContainerTarget::File(run.create(&self.path)?),
        };
        let compression = match self.compression {
            ContainerCompression::None => container::Compression::None,
            ContainerCompression::Lz4 => container::Compression::Lz4,
            ContainerCompression::Zstd => container::Compression::Zstd,
        };
        Ok(Box::new(ArrowLineWriter { state: ContainerState::Waiting(to), compression }))
    }
}

/// A container being written.
struct ArrowLineWriter {
    state: ContainerState,
    compression: container::Compression,
}

enum ContainerState {
    /// Waiting for the first line, which gives the header.
    Waiting(ContainerTarget),
    Open(Box<ContainerWriter<ContainerTarget>>),
    /// A write failed; the run ends.
    Failed,
}

/// Destination of the bytes.
enum ContainerTarget {
    File(OutputFile),
    Stream(Stdout),
}

impl Write for ContainerTarget {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        match self {
            ContainerTarget::File(file) => file.write(bytes),
            ContainerTarget::Stream(stream) => stream.write(bytes),
        }
    }

    fn flush(&mut self) -> io::Result<()> {
        match self {
            ContainerTarget::File(file) => file.flush(),
            ContainerTarget::Stream(stream) => stream.flush(),
        }
    }
}

impl ArrowLineWriter {
    /// The writer, started with the metadata of the first line.
    fn writer(
        &mut self,
        info: &InputInfo,
        has_fractions: bool,
    ) -> Result<&mut ContainerWriter<ContainerTarget>> {
        if let ContainerState::Waiting(_) = self.state
            && let ContainerState::Waiting(to) = std::mem::replace(&mut self.state, ContainerState::Failed)
        {
            let header = header_of(info, has_fractions);
            let writer = match &to {
                ContainerTarget::File(file) => {
                    let path = file.path().to_path_buf();
                    ContainerWriter::file(to, &path, &header, self.compression)?
                }
                ContainerTarget::Stream(_) => {
                    ContainerWriter::stream(to, Path::new(STANDARD_OUTPUT), &header, self.compression)?
                }
            };
            self.state = ContainerState::Open(Box::new(writer));
        }
        match &mut self.state {
            ContainerState::Open(writer) => Ok(writer),
            _ => Err(StageError::Stopped),
        }
    }
}

impl Sink for ArrowLineWriter {
    fn write(&mut self, scan_line: &ScanLine, _cx: &mut Context) -> Result<()> {
        let Some(blocks) = scan_line.blocks() else {
            return Err(StageError::failed(
                format!("write_arrow received {}, but writes Shots", scan_line.kind()),
                "put it before `decompose`",
            ));
        };
        if scan_line.emissions.is_empty() {
            return Ok(());
        }
        let line = line_of(scan_line, blocks);
        Ok(self.writer(&scan_line.input, blocks.has_fractions())?.write(line)?)
    }

    fn finish(self: Box<Self>, cx: &mut Context) -> Result<()> {
        match self.state {
            ContainerState::Open(writer) => {
                if let ContainerTarget::File(file) = writer.finish()? {
                    cx.publish(file.finish()?);
                }
            }
            ContainerState::Waiting(_) => cx.warn("no container is written: there were no shots"),
            ContainerState::Failed => {}
        }
        Ok(())
    }
}

/// Schema of the record batches of a recording, as in a container.
///
/// `has_fractions`: whether samples are fractions of a digitiser step ([`Blocks::has_fractions`]).
pub fn shot_schema(info: &InputInfo, has_fractions: bool) -> SchemaRef {
    header_of(info, has_fractions).schema()
}

/// Shots and blocks of a scan line as a record batch, as in a container; `None` without blocks.
///
/// `schema` is [`shot_schema`].
///
/// # Errors
/// If a list has more than 2^31 items.
pub fn shot_batch(scan_line: &ScanLine, schema: &SchemaRef) -> Option<Result<RecordBatch>> {
    let blocks = scan_line.blocks()?;
    let batch = line_of(scan_line, blocks).finish(Arc::clone(schema));
    Some(batch.map_err(|error| StageError::failed(error.to_string(), "read shorter scan lines")))
}

fn line_of(scan_line: &ScanLine, blocks: &Blocks) -> LineBuilder {
    let mut line = LineBuilder::new();
    let mut rest = blocks.iter().peekable();
    let mut online = blocks.online.iter().peekable();
    for (index, emission) in (0..).zip(&scan_line.emissions) {
        line.shot(&shot_of(emission, scan_line.line));
        while let Some(block) = rest.next_if(|block| block.emission == index) {
            let of_container = block_of(block, blocks, &scan_line.input);
            match block.has_fractions() {
                true => line.block_of_fractions(&of_container, blocks.fractions(block)),
                false => line.block(&of_container),
            }
        }
        if let Some(record) = blocks.footprint_of(index) {
            line.footprint(&ContainerFootprint {
                beam: scan_line.input.beam.as_deref(),
                shot_number: Some(record.shot_number),
                noise_mean_dn: record.noise.map(|noise| noise.mean_dn),
                noise_sd_dn: record.noise.map(|noise| noise.sd_dn),
                is_advised_against: record.is_degraded,
            });
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

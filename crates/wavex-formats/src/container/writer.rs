//! Writer of containers.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use arrow_ipc::CompressionType;
use arrow_schema::{ArrowError, SchemaRef};

use super::{ContainerHeader, IpcWriter, LineBuilder};
use crate::{Error, Result};

/// Compression of the buffers of a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Compression {
    /// None.
    None,
    /// LZ4 frames.
    Lz4,
    /// ZSTD, level 3.
    Zstd,
}

/// Writer of a container, one record batch per scan line.
pub struct ContainerWriter<W: Write> {
    writer: IpcWriter<W>,
    schema: SchemaRef,
    file: PathBuf,
}

impl<W: Write> ContainerWriter<W> {
    /// Starts a container in the file format; `file` is its name, for errors.
    pub fn file(
        to: W,
        file: &Path,
        header: &ContainerHeader,
        compression: Compression,
    ) -> Result<ContainerWriter<W>> {
        ContainerWriter::begin(to, file, header, compression, (true, true))
    }

    /// Starts a container in the stream format.
    ///
    /// It has an end-of-stream marker but no list of record batches.
    pub fn stream(
        to: W,
        file: &Path,
        header: &ContainerHeader,
        compression: Compression,
    ) -> Result<ContainerWriter<W>> {
        ContainerWriter::begin(to, file, header, compression, (false, true))
    }

    /// Starts a container; the last two are whether it is a file and has digests.
    pub(super) fn begin(
        to: W,
        file: &Path,
        header: &ContainerHeader,
        compression: Compression,
        (is_file, with_digests): (bool, bool),
    ) -> Result<ContainerWriter<W>> {
        let schema = header.schema();
        let codec = match compression {
            Compression::None => None,
            Compression::Lz4 => Some(CompressionType::LZ4_FRAME),
            Compression::Zstd => Some(CompressionType::ZSTD),
        };
        let writer = IpcWriter::begin(to, Arc::clone(&schema), codec, is_file, with_digests);
        let writer = writer.map_err(|error| failed(file, error))?;
        Ok(ContainerWriter { writer, schema, file: file.to_path_buf() })
    }

    /// Writes a scan line.
    pub fn write(&mut self, line: LineBuilder) -> Result<()> {
        let batch = line.finish(Arc::clone(&self.schema));
        let written = batch.and_then(|batch| self.writer.write(&batch));
        written.map_err(|error| failed(&self.file, error))
    }

    /// Writes the end of the container and returns the underlying writer.
    pub fn finish(self) -> Result<W> {
        self.writer.finish().map_err(|error| failed(&self.file, error))
    }
}

fn failed(file: &Path, error: ArrowError) -> Error {
    match error {
        ArrowError::IoError(_, source) => Error::io(file, "write")(source),
        other => Error::unusable(file, other.to_string(), "write shorter scan lines"),
    }
}

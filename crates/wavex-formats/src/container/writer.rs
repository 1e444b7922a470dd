//! Writer of containers.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use arrow_ipc::CompressionType;
use arrow_ipc::writer::{FileWriter, IpcWriteOptions, StreamWriter};
use arrow_schema::{ArrowError, SchemaRef};

use super::{ContainerHeader, LineBuilder};
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
    form: Form<W>,
    schema: SchemaRef,
    file: PathBuf,
}

enum Form<W: Write> {
    File(FileWriter<W>),
    Stream(StreamWriter<W>),
}

impl<W: Write> ContainerWriter<W> {
    /// Starts a container in the file format; `file` is its name, for errors.
    pub fn file(
        to: W,
        file: &Path,
        header: &ContainerHeader,
        compression: Compression,
    ) -> Result<ContainerWriter<W>> {
        let schema = header.schema();
        let form = options(compression)
            .and_then(|options| FileWriter::try_new_with_options(to, &schema, options))
            .map(Form::File)
            .map_err(|error| failed(file, error))?;
        Ok(ContainerWriter { form, schema, file: file.to_path_buf() })
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
        let schema = header.schema();
        let form = options(compression)
            .and_then(|options| StreamWriter::try_new_with_options(to, &schema, options))
            .map(Form::Stream)
            .map_err(|error| failed(file, error))?;
        Ok(ContainerWriter { form, schema, file: file.to_path_buf() })
    }

    /// Writes a scan line.
    pub fn write(&mut self, line: LineBuilder) -> Result<()> {
        let batch = line.finish(Arc::clone(&self.schema));
        batch
            .and_then(|batch| match &mut self.form {
                Form::File(writer) => writer.write(&batch),
                Form::Stream(writer) => writer.write(&batch),
            })
            .map_err(|error| failed(&self.file, error))
    }

    /// Writes the end of the container and returns the underlying writer.
    pub fn finish(self) -> Result<W> {
        match self.form {
            Form::File(writer) => writer.into_inner(),
            Form::Stream(writer) => writer.into_inner(),
        }
        .map_err(|error| failed(&self.file, error))
    }
}

fn options(compression: Compression) -> std::result::Result<IpcWriteOptions, ArrowError> {
    IpcWriteOptions::default().try_with_compression(match compression {
        Compression::None => None,
        Compression::Lz4 => Some(CompressionType::LZ4_FRAME),
        Compression::Zstd => Some(CompressionType::ZSTD),
    })
}

fn failed(file: &Path, error: ArrowError) -> Error {
    match error {
        ArrowError::IoError(_, source) => Error::io(file, "write")(source),
        other => Error::unusable(file, other.to_string(), "write shorter scan lines"),
    }
}

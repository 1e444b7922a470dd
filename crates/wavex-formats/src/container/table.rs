//! Reader of Arrow tables, with the validation of containers.

use std::path::{Path, PathBuf};

use arrow_array::RecordBatch;
use arrow_schema::Schema;

use super::decode::Decoder;
use super::location::ContainerLocation;
use super::messages::Messages;
use crate::{Result, regular_file};

/// Reader of an Arrow file or stream with any columns, one record batch at a time.
pub struct TableReader {
    file: PathBuf,
    schema: Schema,
    messages: Messages,
    decoder: Decoder,
    /// Number of rows read.
    rows: u64,
}

impl TableReader {
    /// Opens a file in the file format or the stream format.
    ///
    /// # Errors
    /// The file is not Arrow, or damaged.
    pub fn open(path: &Path) -> Result<TableReader> {
        regular_file(path)?;
        let (messages, schema) = Messages::open(path)?;
        let columns = (0..schema.fields().len()).map(Some).collect();
        let decoder = Decoder::new(&schema, columns);
        Ok(TableReader { file: path.to_path_buf(), schema, messages, decoder, rows: 0 })
    }

    /// Schema: columns and metadata.
    pub fn schema(&self) -> &Schema {
        &self.schema
    }

    /// Fraction of the file that was read, 0 to 1, if its length is known.
    pub fn progress(&self) -> Option<f64> {
        self.messages.progress()
    }

    /// Returns the next record batch, or `None` at the end; columns may contain nulls.
    ///
    /// # Errors
    /// The record batch is damaged, or exceeds [`MAX_BATCH_BYTES`](super::MAX_BATCH_BYTES).
    pub fn next_batch(&mut self) -> Result<Option<RecordBatch>> {
        while let Some(message) = self.messages.next()? {
            let location =
                ContainerLocation { file: &self.file, offset: message.offset, first_row: self.rows };
            if let Some(batch) = self.decoder.batch(&message, location)? {
                self.rows += batch.num_rows() as u64;
                return Ok(Some(batch));
            }
        }
        Ok(None)
    }
}

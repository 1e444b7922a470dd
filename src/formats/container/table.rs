//! Reading any table of Arrow, with the same care as a container.

use std::path::{Path, PathBuf};

use arrow_array::RecordBatch;
use arrow_schema::Schema;

use super::decode::Decoder;
use super::messages::Messages;
use super::place::Place;
use crate::formats::Result;

/// An Arrow file or stream of any columns that is being read, one record batch after the other.
pub struct TableReader {
    file: PathBuf,
    schema: Schema,
    messages: Messages,
    decoder: Decoder,
    /// How many rows were read.
    rows: u64,
}

impl TableReader {
    /// Opens a file of the file or of the stream format, as its first bytes say.
    ///
    /// # Errors
    /// The file is not Arrow, or damaged.
    pub fn open(path: &Path) -> Result<TableReader> {
        let (messages, schema) = Messages::open(path)?;
        let columns = (0..schema.fields().len()).map(Some).collect();
        let decoder = Decoder::new(&schema, columns);
        Ok(TableReader { file: path.to_path_buf(), schema, messages, decoder, rows: 0 })
    }

    /// The columns and the metadata.
    pub fn schema(&self) -> &Schema {
        &self.schema
    }

    /// The next record batch, or `None` at the end; each column may hold nulls there.
    ///
    /// # Errors
    /// The record batch is damaged, or has over [`MAX_BATCH_BYTES`](super::MAX_BATCH_BYTES).
    pub fn next_batch(&mut self) -> Result<Option<RecordBatch>> {
        while let Some(message) = self.messages.next()? {
            let place = Place { file: &self.file, offset: message.offset, first_row: self.rows };
            if let Some(batch) = self.decoder.batch(&message, place)? {
                self.rows += batch.num_rows() as u64;
                return Ok(Some(batch));
            }
        }
        Ok(None)
    }
}

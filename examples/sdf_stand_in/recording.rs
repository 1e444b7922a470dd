//! Serves a container as a sequence of records.
//!
//! Its shots, and an end-of-line record after each line.

use std::path::{Path, PathBuf};

use wavex_formats::Result;
use wavex_formats::container::{ContainerHeader, ContainerLine, ContainerReader, ContainerShot};
use wavex_formats::sdf::record_flags::END_OF_LINE;

/// Container flag of the last shot of a line.
const EDGE: u16 = wavex::scan_line::emission_flags::EDGE_OF_FLIGHT_LINE;

/// Record as returned by the interface.
pub(crate) struct Record {
    pub(crate) time_sorg: f64,
    pub(crate) time_external: f64,
    pub(crate) origin: [f64; 3],
    pub(crate) direction: [f64; 3],
    pub(crate) flags: u16,
    pub(crate) facet: u16,
    /// Channel, time of the first sample relative to `time_sorg` (s), and samples of each block.
    pub(crate) blocks: Vec<(u32, f64, Vec<u16>)>,
}

pub(crate) struct Recording {
    path: PathBuf,
    reader: ContainerReader,
    line: Option<ContainerLine>,
    /// Next row of the current line.
    ///
    /// The row after the last is the end-of-line record.
    row: usize,
    /// Number of the next record, from 1.
    next: u32,
}

impl Recording {
    pub(crate) fn open(path: &Path) -> Result<Recording> {
        let mut reader = ContainerReader::open(path)?;
        let line = reader.next_line()?;
        Ok(Recording { path: path.to_path_buf(), reader, line, row: 0, next: 1 })
    }

    pub(crate) fn header(&self) -> &ContainerHeader {
        self.reader.header()
    }

    /// Returns the number of the next record, from 1.
    pub(crate) fn tell(&self) -> u32 {
        self.next
    }

    pub(crate) fn next(&mut self) -> Result<Option<Record>> {
        let Some(line) = &self.line else { return Ok(None) };
        let record = match self.row < line.rows() {
            true => record_of(line, self.row),
            false => end_of(line),
        };
        self.row += 1;
        self.next += 1;
        if self.row > line.rows() {
            self.line = self.reader.next_line()?;
            self.row = 0;
        }
        Ok(Some(record))
    }

    /// Seeks to a record; `false` if it does not exist.
    pub(crate) fn seek(&mut self, record: u32) -> Result<bool> {
        self.find(|next, _| next == record)
    }

    /// Seeks to the last record.
    pub(crate) fn seek_last(&mut self) -> Result<bool> {
        let mut last = 0;
        self.find(|next, _| {
            last = next;
            false
        })?;
        self.seek(last)
    }

    /// Seeks to the first shot at or after a time.
    ///
    /// `time_of` returns the time of a shot.
    pub(crate) fn seek_time(&mut self, time_s: f64, time_of: impl Fn(&ContainerShot) -> f64) -> Result<bool> {
        self.find(|_, shot| shot.is_some_and(|shot| time_of(shot) >= time_s))
    }

    /// Seeks to the first record that `wanted` accepts, by number and shot.
    fn find(&mut self, mut wanted: impl FnMut(u32, Option<&ContainerShot>) -> bool) -> Result<bool> {
        *self = Recording::open(&self.path)?;
        while let Some(line) = &self.line {
            let shot = (self.row < line.rows()).then(|| line.shot(self.row));
            if wanted(self.next, shot.as_ref()) {
                return Ok(true);
            }
            self.next()?;
        }
        Ok(false)
    }
}

fn record_of(line: &ContainerLine, row: usize) -> Record {
    let shot = line.shot(row);
    let blocks = line.blocks(row);
    Record {
        time_sorg: seconds(&shot),
        time_external: external(&shot),
        origin: shot.origin_m,
        direction: shot.direction,
        flags: (shot.flags & 7) | if shot.flags & EDGE != 0 { END_OF_LINE } else { 0 },
        facet: shot.facet,
        blocks: blocks
            .map(|block| (u32::from(block.channel), block.start_ns / 1e9, block.samples.to_vec()))
            .collect(),
    }
}

/// Creates the end-of-line record: no blocks and no direction.
fn end_of(line: &ContainerLine) -> Record {
    let last = line.rows().checked_sub(1).map(|row| line.shot(row));
    Record {
        time_sorg: last.as_ref().map_or(f64::NAN, seconds),
        time_external: last.as_ref().map_or(f64::NAN, external),
        origin: [f64::NAN; 3],
        direction: [f64::NAN; 3],
        flags: 15,
        facet: last.map_or(0, |shot| shot.facet),
        blocks: Vec::new(),
    }
}

/// Returns the shot's time on the instrument's clock, s.
pub(crate) fn seconds(shot: &ContainerShot) -> f64 {
    shot.clock_ps as f64 / 1e12
}

/// Returns the shot's external time, s.
pub(crate) fn external(shot: &ContainerShot) -> f64 {
    shot.gps_time_s.unwrap_or(f64::NAN)
}

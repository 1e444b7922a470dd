//! Reader of SDF and WFM files.

use std::ffi::CString;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use super::fault::{CallResult, LibraryFault, code};
use super::interface::{Handle, LibraryVersion};
use super::{SdfInfo, SdfRecord, index_dir, library};
use crate::other_format::other_format;
use crate::{Error, Result};

/// The four calibration tables.
///
/// Pairs of digitiser steps and value; empty if missing.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CalibrationTables {
    /// Amplitude in dB, low-power channel.
    pub amplitude_low: Vec<(f64, f64)>,
    /// Amplitude in dB, high-power channel.
    pub amplitude_high: Vec<(f64, f64)>,
    /// Range in seconds, low-power channel.
    pub range_low: Vec<(f64, f64)>,
    /// Range in seconds, high-power channel.
    pub range_high: Vec<(f64, f64)>,
}

/// Sequential reader of the records of a file.
pub struct SdfReader {
    file: PathBuf,
    handle: Handle,
    version: LibraryVersion,
    info: SdfInfo,
    /// Number of the next record, from 1.
    next_record: u32,
    /// Whether the index was already rebuilt.
    reindexed: bool,
}

/// Speed of light in vacuum, m/s.
///
/// The upper limit of the group velocity.
const LIGHT_MPS: f64 = 299_792_458.0;

impl SdfReader {
    /// Opens a file.
    ///
    /// `library` is RIEGL's library or its folder, if named. `index_dir` is a folder for the index,
    /// if it is not the folder of the data. `announce` gets the file of a library before it is loaded.
    ///
    /// # Errors
    /// The file or the library is missing or unusable; each return code of the library has its own
    /// message.
    pub fn open(
        file: &Path,
        library: Option<&Path>,
        index_dir: Option<&Path>,
        announce: &dyn Fn(&Path),
    ) -> Result<SdfReader> {
        let metadata = fs::metadata(file).map_err(Error::io(file, "open"))?;
        if metadata.is_dir() {
            return Err(Error::io(file, "open")(io::ErrorKind::IsADirectory.into()));
        }
        if let Some(error) = other_format(file, &[], "read_sdf") {
            return Err(error);
        }
        let (functions, version) = library::find(file, library, announce)?;
        let path = match index_dir {
            Some(folder) => index_dir::link(file, folder)?,
            None => file.to_path_buf(),
        };
        let path = CString::new(path.as_os_str().as_encoded_bytes())
            .map_err(|_| Error::unusable(file, "the path contains a zero byte", "rename the file"))?;
        let of_file = |fault: LibraryFault| fault.of_file(file);
        let mut handle = functions.open(&path).map_err(of_file)?;
        handle.set_relative().map_err(of_file)?;
        let info = handle.info().and_then(checked).map_err(of_file)?;
        Ok(SdfReader { file: file.to_path_buf(), handle, version, info, next_record: 1, reindexed: false })
    }

    /// Returns the version of the library.
    pub fn version(&self) -> &LibraryVersion {
        &self.version
    }

    /// Returns the metadata of the recording.
    pub fn info(&self) -> &SdfInfo {
        &self.info
    }

    /// Returns the number of the next record, from 1.
    pub fn next_record(&self) -> u32 {
        self.next_record
    }

    /// Returns the calibration tables and remarks on unavailable ones.
    pub fn tables(&mut self) -> (CalibrationTables, Vec<String>) {
        let mut remarks = Vec::new();
        let mut table = |kind: u16, consequence: &str| {
            self.handle.table(kind).unwrap_or_else(|fault| {
                remarks.push(format!("{}; {consequence}", fault.problem()));
                Vec::new()
            })
        };
        let tables = CalibrationTables {
            amplitude_low: table(1, "the low power channel has no amplitudes in dB"),
            amplitude_high: table(0, "the high power channel has no amplitudes in dB"),
            range_low: table(3, "the range correction of the low power channel is off"),
            range_high: table(2, "the range correction of the high power channel is off"),
        };
        (tables, remarks)
    }

    /// Reads the next record.
    ///
    /// `false` at the end of the file.
    ///
    /// # Errors
    /// The library reports an error or returns invalid counts.
    pub fn next(&mut self, record: &mut SdfRecord) -> Result<bool> {
        let mut read = self.handle.read(record);
        if self.needs_index(&read)? {
            let again = self.handle.seek(self.next_record);
            read = again.and_then(|()| self.handle.read(record));
        }
        match read {
            Ok(()) => {
                self.next_record = self.next_record.saturating_add(1);
                Ok(true)
            }
            Err(fault) if fault.code() == Some(code::END_OF_FILE) => Ok(false),
            Err(fault) => Err(at_record(fault.of_file(&self.file), self.next_record)),
        }
    }

    /// Seeks to a record, from 1; `u32::MAX` is the last.
    ///
    /// `false` if it does not exist.
    pub fn seek(&mut self, record: u32) -> Result<bool> {
        self.navigate(|handle| handle.seek(record))
    }

    /// Seeks to a time of the instrument's clock, s.
    ///
    /// `false` if all records are earlier.
    pub fn seek_time(&mut self, time_s: f64) -> Result<bool> {
        self.navigate(|handle| handle.seek_time(time_s))
    }

    /// Seeks to an external time, s.
    ///
    /// `false` if all records are earlier.
    pub fn seek_time_external(&mut self, time_s: f64) -> Result<bool> {
        self.navigate(|handle| handle.seek_time_external(time_s))
    }

    fn navigate(&mut self, go: impl Fn(&mut Handle) -> CallResult<()>) -> Result<bool> {
        let mut gone = go(&mut self.handle);
        if self.needs_index(&gone)? {
            gone = go(&mut self.handle);
        }
        match gone.and_then(|()| self.handle.tell()) {
            Ok(record) => {
                self.next_record = record;
                Ok(true)
            }
            Err(fault) if fault.code() == Some(code::END_OF_FILE) => Ok(false),
            Err(fault) => Err(fault.of_file(&self.file)),
        }
    }

    /// Builds a missing index; returns whether to repeat the call.
    fn needs_index<T>(&mut self, answer: &CallResult<T>) -> Result<bool> {
        let missing = answer.as_ref().err().and_then(LibraryFault::code) == Some(code::MISSING_INDEX);
        if !missing || self.reindexed {
            return Ok(false);
        }
        self.reindexed = true;
        tracing::info!("{}: building the index, which reads the whole file", self.file.display());
        self.handle.reindex().map_err(|fault| {
            Error::unusable(
                &self.file,
                format!("the file has no index, and it cannot be built: {}", fault.problem()),
                "the library writes it next to the data: make that folder writable, copy or link \
                 the file to a writable folder, or set one with the key `index_dir`",
            )
        })?;
        Ok(true)
    }
}

/// Checks the metadata for plausibility.
fn checked(info: SdfInfo) -> CallResult<SdfInfo> {
    const NAME: &str = "fwifc_get_info";
    if !(info.group_velocity_mps > 0.0 && info.group_velocity_mps <= LIGHT_MPS) {
        let problem = format!("a group velocity of {} m/s", info.group_velocity_mps);
        return Err(LibraryFault::nonsense(NAME, problem));
    }
    if !(info.sampling_interval_s > 0.0 && info.sampling_interval_s <= 1e-6) {
        let problem = format!("a sampling interval of {} s", info.sampling_interval_s);
        return Err(LibraryFault::nonsense(NAME, problem));
    }
    Ok(info)
}

/// Adds the record number to an error.
fn at_record(error: Error, record: u32) -> Error {
    match error {
        Error::Unusable { file, problem, remedy } => {
            Error::Unusable { file, problem: format!("record {record}: {problem}"), remedy }
        }
        other => other,
    }
}

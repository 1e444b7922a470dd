//! Data sets of a group, with one value or waveform per shot.

use std::ops::Range;

use wavex_formats::{Error, Result};

use super::dataset::{Dataset, ElementType, Elements};
use super::filters::Decoder;
use super::group::Link;
use super::input::{Address, COPY_AGAIN, Input};

/// Most samples of a waveform.
pub const MOST_SAMPLES: u64 = 65_536;

/// Most shots of a beam.
const MOST_SHOTS: u64 = 10_000_000;

/// Most bytes of all decoded chunks that a reader keeps.
const KEPT_BYTES: u64 = 512 << 20;

/// A file with the members of one of its groups.
pub struct Members {
    /// The file.
    pub input: Input,
    /// Decodes chunks of all data sets.
    pub decoder: Decoder,
    prefix: String,
    links: Vec<Link>,
    kept_bytes: u64,
}

/// A data set with one value per shot, or none.
pub type Column = Option<Dataset>;

impl Members {
    /// Members of a group with this name, "" for the root.
    pub fn new(input: Input, group: &str, links: Vec<Link>) -> Members {
        let prefix = if group.is_empty() { String::new() } else { format!("{group}/") };
        Members { input, decoder: Decoder::new(), prefix, links, kept_bytes: 0 }
    }

    /// Goes on with the members of another group.
    pub fn enter(&mut self, group: &str, links: Vec<Link>) {
        self.prefix = format!("{group}/");
        self.links = links;
    }

    /// Returns the name and address of a member; letter case does not matter.
    pub fn find(&self, name: &str) -> Option<(String, Address)> {
        self.links.iter().find(|(link, _)| link.eq_ignore_ascii_case(name)).cloned()
    }

    /// Returns the name of the group, with a `/` at its end.
    pub fn prefix(&self) -> &str {
        &self.prefix
    }

    /// Opens a data set of numbers, if there is one of this name; letter case does not matter.
    ///
    /// # Errors
    /// If it cannot be read, or the decoded chunks of all would be too large.
    pub fn optional(&mut self, name: &str) -> Result<Column> {
        self.elements(name)
    }

    /// Opens a data set of any type, as [`Members::optional`].
    ///
    /// # Errors
    /// As [`Members::optional`].
    pub fn elements<T: ElementType>(&mut self, name: &str) -> Result<Option<Elements<T>>> {
        let Some((name, at)) = self.find(name) else { return Ok(None) };
        let dataset = Elements::open(&self.input, &format!("{}{name}", self.prefix), at)?;
        self.kept_bytes += dataset.band_bytes();
        if self.kept_bytes > KEPT_BYTES {
            let problem = format!("{}: more than {KEPT_BYTES} bytes of chunks", dataset.name());
            let remedy = "rewrite the file with smaller chunks: `h5repack -l CHUNK=10000`";
            return Err(Error::unusable(self.input.path(), problem, remedy));
        }
        Ok(Some(dataset))
    }

    /// Opens a data set.
    ///
    /// # Errors
    /// As [`Members::optional`], and if no data set has this name.
    pub fn required(&mut self, name: &str) -> Result<Dataset> {
        let found = self.optional(name)?;
        found.ok_or_else(|| self.unusable(format!("no data set {}{name}", self.prefix)))
    }

    /// Opens a data set with one value per shot, if there is one of this name.
    ///
    /// # Errors
    /// As [`Members::optional`], and if it has another number of values.
    pub fn column(&mut self, name: &str, shots: u64) -> Result<Column> {
        let found = self.optional(name)?;
        if let Some(dataset) = &found {
            self.check_rows(dataset, shots)?;
        }
        Ok(found)
    }

    /// Checks that a data set has a row per shot.
    ///
    /// # Errors
    /// If not.
    pub fn check_rows(&self, dataset: &Dataset, shots: u64) -> Result<()> {
        if dataset.rows() == shots {
            return Ok(());
        }
        Err(self.unusable(format!("{}: {} values for {shots} shots", dataset.name(), dataset.rows())))
    }

    /// Checks the number of shots.
    ///
    /// # Errors
    /// If it is too large.
    pub fn check_shots(&self, shots: u64) -> Result<usize> {
        if shots <= MOST_SHOTS {
            return Ok(shots as usize);
        }
        let group = self.prefix.trim_end_matches('/');
        Err(self.unusable(format!("{group}: {shots} shots, at most {MOST_SHOTS}")))
    }

    /// Reads the value of a shot; NaN without a data set.
    ///
    /// # Errors
    /// If its chunk is damaged.
    pub fn value(&mut self, column: &mut Column, shot: u64) -> Result<f64> {
        match column {
            Some(dataset) => dataset.f64_at(&self.input, &mut self.decoder, shot),
            None => Ok(f64::NAN),
        }
    }

    /// Reads a whole number of a shot.
    ///
    /// # Errors
    /// If its chunk is damaged, or it is negative or has a fraction.
    pub fn whole(&mut self, dataset: &mut Dataset, shot: u64) -> Result<u64> {
        let value = dataset.u64_at(&self.input, &mut self.decoder, shot)?;
        value.ok_or_else(|| self.unusable(format!("{}: not a whole number", dataset.name())))
    }

    /// Reads samples, at most [`MOST_SAMPLES`]; `samples` is emptied before.
    ///
    /// # Errors
    /// If their chunk is damaged, or they are beyond the end.
    pub fn samples(
        &mut self,
        dataset: &mut Dataset,
        elements: Range<u64>,
        samples: &mut Vec<f32>,
    ) -> Result<()> {
        samples.clear();
        dataset.append_f32(&self.input, &mut self.decoder, elements, samples)
    }

    /// Creates an error about the file.
    pub fn unusable(&self, problem: String) -> Error {
        Error::unusable(self.input.path(), problem, COPY_AGAIN)
    }
}

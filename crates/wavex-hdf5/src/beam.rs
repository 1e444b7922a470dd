//! Reader of the shots of a beam.

use wavex_formats::{Error, Result};

use super::gedi::GediBeam;
use super::lvis::LvisBeam;
use super::shot::Shot;

/// Reads the shots of a beam, in any order.
///
/// One row of chunks of each data set is kept decoded.
pub struct BeamReader {
    name: String,
    data: Data,
}

/// Data sets of the products.
pub enum Data {
    Gedi(GediBeam),
    Lvis(LvisBeam),
}

impl BeamReader {
    /// Creates a reader of a beam with this name.
    pub(crate) fn new(name: &str, data: Data) -> BeamReader {
        BeamReader { name: name.to_owned(), data }
    }

    /// Returns the name of the beam.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Returns the number of shots.
    pub fn len(&self) -> usize {
        match &self.data {
            Data::Gedi(beam) => beam.len(),
            Data::Lvis(beam) => beam.len(),
        }
    }

    /// Returns whether there are no shots.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Returns the names of [`Shot::columns`]; a name without its unit is the product's, with the product's unit.
    pub fn columns(&self) -> Vec<&'static str> {
        match &self.data {
            Data::Gedi(beam) => beam.columns(),
            Data::Lvis(beam) => beam.columns(),
        }
    }

    /// Reads a shot; index 0 is the first.
    ///
    /// # Errors
    /// If its values are damaged, or there is no such shot; other shots can still be read.
    pub fn shot(&mut self, index: usize, shot: &mut Shot) -> Result<()> {
        let read = match &mut self.data {
            Data::Gedi(beam) => beam.read(index as u64, shot),
            Data::Lvis(beam) => beam.read(index as u64, shot),
        };
        read.map_err(|error| of_shot(error, &self.name, index))
    }
}

/// Adds beam and shot to an error.
fn of_shot(error: Error, beam: &str, index: usize) -> Error {
    match error {
        Error::Malformed { file, offset, field, problem, remedy } => {
            let field = format!("shot {index} of {beam}: {field}");
            Error::Malformed { file, offset, field, problem, remedy }
        }
        Error::Unusable { file, problem, remedy } => {
            Error::Unusable { file, problem: format!("shot {index} of {beam}: {problem}"), remedy }
        }
        error => error,
    }
}

//! Reader of the shots of a beam.

use wavex_formats::{Error, Result};

use super::shot::Shot;

/// Reads the shots of a beam, in any order.
///
/// One row of chunks of each data set is kept decoded.
pub struct BeamReader {
    name: String,
    shots: Box<dyn Shots + Send>,
}

/// Shots of a beam, as a product stores them.
pub trait Shots {
    /// Returns the number of shots.
    fn len(&self) -> usize;

    /// Returns the names of the further values.
    fn columns(&self) -> Vec<&'static str>;

    /// Reads the number of a shot in its mission.
    ///
    /// # Errors
    /// If it is no whole number, or there is no such shot.
    fn number(&mut self, index: u64) -> Result<u64>;

    /// Reads number, time and positions of a shot.
    ///
    /// # Errors
    /// As [`Shots::read`].
    fn locate(&mut self, index: u64, shot: &mut Shot) -> Result<()>;

    /// Reads a shot.
    ///
    /// # Errors
    /// If its values are damaged, or there is no such shot.
    fn read(&mut self, index: u64, shot: &mut Shot) -> Result<()>;
}

impl BeamReader {
    /// Creates a reader of a beam with this name.
    pub(crate) fn new(name: &str, shots: impl Shots + Send + 'static) -> BeamReader {
        BeamReader { name: name.to_owned(), shots: Box::new(shots) }
    }

    /// Returns the name of the beam.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Returns the number of shots.
    pub fn len(&self) -> usize {
        self.shots.len()
    }

    /// Returns whether there are no shots.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Returns the names of [`Shot::columns`].
    ///
    /// A name without a unit is the product's, with the product's unit.
    pub fn columns(&self) -> Vec<&'static str> {
        self.shots.columns()
    }

    /// Returns the index of the shot with this number in its mission; damaged numbers are passed over.
    ///
    /// Reads the numbers of all shots before it.
    pub fn index_of(&mut self, shot_number: u64) -> Option<usize> {
        (0..self.len()).find(|index| self.number(*index).is_ok_and(|found| found == shot_number))
    }

    /// Reads the number of a shot in its mission; index 0 is the first.
    ///
    /// # Errors
    /// If it is no whole number, or there is no such shot.
    pub fn number(&mut self, index: usize) -> Result<u64> {
        self.shots.number(index as u64).map_err(|error| of_shot(error, &self.name, index))
    }

    /// Reads number, time and positions of a shot, and leaves its other values as they are; index 0 is the first.
    ///
    /// Decodes no samples.
    ///
    /// # Errors
    /// As [`BeamReader::shot`].
    pub fn locate(&mut self, index: usize, shot: &mut Shot) -> Result<()> {
        self.shots.locate(index as u64, shot).map_err(|error| of_shot(error, &self.name, index))
    }

    /// Reads a shot; index 0 is the first.
    ///
    /// # Errors
    /// If its values are damaged, or there is no such shot; other shots can still be read.
    pub fn shot(&mut self, index: usize, shot: &mut Shot) -> Result<()> {
        self.shots.read(index as u64, shot).map_err(|error| of_shot(error, &self.name, index))
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

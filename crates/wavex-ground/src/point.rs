//! Points with what is known of their returns, and their classes.

/// A point of a cloud with what its instrument knows of it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CloudPoint {
    /// East, north and height, m.
    pub position_m: [f64; 3],
    /// Unit vector from the sensor to the point; zeros if unknown.
    pub beam: [f32; 3],
    /// SD of the height, m; NaN if unknown.
    pub height_sd_m: f32,
    /// Number of the return within its shot, from 1; 0 if unknown.
    pub return_number: u8,
    /// Number of returns of the shot; 0 if unknown.
    pub n_returns: u8,
    /// Strip of the point; points of one strip share errors.
    pub strip: u16,
}

impl CloudPoint {
    /// A point of which only the position is known.
    pub fn at(position_m: [f64; 3]) -> CloudPoint {
        CloudPoint {
            position_m,
            beam: [0.0; 3],
            height_sd_m: f32::NAN,
            return_number: 0,
            n_returns: 0,
            strip: 0,
        }
    }

    /// Whether it may be the last return of its shot.
    pub fn may_be_last(&self) -> bool {
        self.return_number >= self.n_returns
    }
}

/// Class of a point, by the numbers of the LAS specification (1.4 R15, table 17).
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[repr(u8)]
pub enum Class {
    /// Neither ground nor noise.
    Unclassified = 1,
    /// Ground.
    Ground = 2,
    /// Below the ground.
    LowNoise = 7,
    /// Water surface.
    Water = 9,
    /// In the air, where other beams met nothing.
    HighNoise = 18,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_without_return_numbers_may_be_last() {
        assert!(CloudPoint::at([0.0; 3]).may_be_last());
        assert!(!CloudPoint { return_number: 1, n_returns: 2, ..CloudPoint::at([0.0; 3]) }.may_be_last());
    }
}

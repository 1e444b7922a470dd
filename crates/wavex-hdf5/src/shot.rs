//! One shot: its waveforms, times and positions.

/// Position on WGS 84; all values are NaN if it is unknown.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Position {
    /// Longitude, rad, -π to π.
    pub longitude_rad: f64,
    /// Latitude, rad.
    pub latitude_rad: f64,
    /// Height above the ellipsoid, m.
    pub height_m: f64,
}

impl Position {
    /// An unknown position.
    pub const UNKNOWN: Position =
        Position { longitude_rad: f64::NAN, latitude_rad: f64::NAN, height_m: f64::NAN };

    /// Creates a position from degrees; unknown if a value is impossible, as fill values are.
    pub fn from_degrees(longitude_deg: f64, latitude_deg: f64, height_m: f64) -> Position {
        // Fill values are -9999, -999999 and the like; lidars are below 2000 km.
        let possible = (-360.0..=360.0).contains(&longitude_deg)
            && (-90.0..=90.0).contains(&latitude_deg)
            && (-9990.0..2e6).contains(&height_m);
        if !possible {
            return Position::UNKNOWN;
        }
        let turns = ((longitude_deg + 180.0) / 360.0).floor();
        Position {
            longitude_rad: (longitude_deg - 360.0 * turns).to_radians(),
            latitude_rad: latitude_deg.to_radians(),
            height_m,
        }
    }

    /// Returns whether the position is known.
    pub fn is_known(&self) -> bool {
        !self.height_m.is_nan()
    }
}

/// Meaning of [`Shot::time_s`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum TimeScale {
    /// GPS seconds since 1980-01-06.
    Gps,
    /// UTC seconds of the day of the flight, without leap seconds.
    UtcOfDay,
}

/// One shot; its buffers are used again by the next one.
#[derive(Clone, Debug, PartialEq)]
pub struct Shot {
    /// Number that the product gives the shot.
    pub shot_number: u64,
    /// Emission time, s; [`TimeScale`] says since when.
    pub time_s: f64,
    /// Received waveform, counts.
    pub received_dn: Vec<f32>,
    /// Outgoing pulse, counts; empty if it is not recorded.
    pub outgoing_dn: Vec<f32>,
    /// Mean of the noise, counts; NaN if unknown.
    pub noise_mean_dn: f32,
    /// Standard deviation of the noise, counts; NaN if unknown.
    pub noise_sd_dn: f32,
    /// Position of the first received sample.
    pub first_bin: Position,
    /// Position of the last received sample.
    pub last_bin: Position,
    /// Position of the instrument at the emission.
    pub instrument: Position,
    /// One-way time of flight to the first received sample, s; NaN if unknown.
    pub first_bin_delay_s: f64,
    /// One-way time of flight to the last received sample, s; NaN if unknown.
    pub last_bin_delay_s: f64,
    /// Further values of the shot, in the order of [`crate::BeamReader::columns`].
    pub columns: Vec<f64>,
}

impl Default for Shot {
    fn default() -> Shot {
        Shot {
            shot_number: 0,
            time_s: f64::NAN,
            received_dn: Vec::new(),
            outgoing_dn: Vec::new(),
            noise_mean_dn: f32::NAN,
            noise_sd_dn: f32::NAN,
            first_bin: Position::UNKNOWN,
            last_bin: Position::UNKNOWN,
            instrument: Position::UNKNOWN,
            first_bin_delay_s: f64::NAN,
            last_bin_delay_s: f64::NAN,
            columns: Vec::new(),
        }
    }
}

//! Start of simulated flights.

/// Initial position of the aircraft, m: easting and northing in UTM zone 33 north.
///
/// It is 180 km west of the central meridian, where the map scale is 1.
pub const START_M: [f64; 2] = [320_000.0, 5_300_000.0];
/// Height of the level ground above the ellipsoid, m.
pub const GROUND_HEIGHT_M: f64 = 400.0;

//! Time scales and geodesy, as pure computations.

pub mod beam_length;
pub mod cone;
pub mod conformal;
pub mod crs;
pub mod ellipsoid;
pub mod frames;
pub mod geoid;
pub mod lambert;
pub mod time;
pub mod time_axis;
pub mod trajectory;
pub mod transverse_mercator;
pub mod vertical;

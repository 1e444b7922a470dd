//! Terrain and surface models as GeoTIFF, from points in temporary files: memory does not depend on the area.

mod points;
mod rasters;
mod spool;
mod surface;

pub use points::{GroundPoints, SQUARE_M, Square};
pub use rasters::{RasterRequest, WrittenRasters, write_rasters};
pub use spool::{Spool, SpoolBuffers, SpoolWriter};
pub use surface::SurfacePoints;

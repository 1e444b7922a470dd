//! Terrain, surface and canopy heights of classified clouds.

use std::path::{Path, PathBuf};

use rayon::ThreadPoolBuilder;
use wavex_engine::engine::Cancel;
use wavex_line::stage::{FinishedFile, StageError};
use wavex_stages::terrain::{RasterRequest, write_rasters};

use super::{GroundTiles, INTERRUPTED};
use crate::Failure;

/// Rasters of clouds to write.
#[derive(Clone, Debug)]
pub struct TerrainRequest<'a> {
    /// GeoTIFF of the terrain.
    pub path: &'a Path,
    /// GeoTIFF of the surface; the clouds must be classified with a `surface_cell_m` for it.
    pub surface: Option<&'a Path>,
    /// GeoTIFF of the heights of the surface above the terrain; as `surface`.
    pub canopy: Option<&'a Path>,
    /// Edge of the cells, m.
    pub cell_m: f64,
    /// Number of threads; 0: one per core.
    pub threads: usize,
    /// Ends the computation early when set.
    pub cancel: Cancel,
}

/// A written terrain model.
#[derive(Clone, Debug)]
pub struct WrittenTerrain {
    /// The files.
    pub written: Vec<PathBuf>,
    /// Summary for people.
    pub text: String,
    /// What was assumed because the data did not determine it.
    pub warnings: Vec<String>,
}

/// Writes the terrain of classified clouds, and surface and canopy heights, as Cloud Optimized GeoTIFF: [`write_rasters`].
///
/// # Errors
/// There are no ground points, the raster would be too large, a file cannot be written, an interruption.
pub fn write_terrain(ground: &GroundTiles, request: &TerrainRequest<'_>) -> Result<WrittenTerrain, Failure> {
    let pool = ThreadPoolBuilder::new().num_threads(request.threads).build();
    let pool =
        pool.map_err(|error| Failure::Run(format!("cannot start threads: {error}; set fewer `--threads`")))?;
    let rasters = RasterRequest {
        terrain: request.path,
        surface: request.surface,
        canopy: request.canopy,
        cell_m: request.cell_m,
        cell_option: "`--cell`",
        crs_wkt: ground.wkt.clone(),
        units_m: ground.units_m,
        sds: ground.sds,
        extent_m: None,
        is_cancelled: &|| request.cancel.is_cancelled(),
    };
    let of_ground = &ground.ground;
    let written = pool.install(|| write_rasters(&of_ground.points, of_ground.surface.as_ref(), &rasters));
    let written = written.map_err(|error| match error {
        StageError::Stopped => Failure::Run(INTERRUPTED.into()),
        error => Failure::Run(error.to_string()),
    })?;
    let published = written.files.into_iter().map(FinishedFile::publish).collect::<Result<Vec<_>, _>>();
    let published = published.map_err(|error| Failure::Run(error.to_string()))?;
    Ok(WrittenTerrain { written: published, text: written.text, warnings: written.warnings })
}

//! `write_dem`: writes the terrain of a flight line as GeoTIFF, with the SD of each height.

use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use rayon::ThreadPool;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::terrain::{GroundPoints, RasterRequest, SpoolBuffers, Square, SurfacePoints, write_rasters};
use wavex_geodesy::crs::{Crs, units_of_wkt};
use wavex_geodesy::vertical::down_at;
use wavex_ground::point::{Class, CloudPoint};
use wavex_ground::terrain::PointSds;
use wavex_line::keys::InvalidKey;
use wavex_line::scan_line::{InputInfo, Kind, Return, ScanLine};
use wavex_line::stage::{Config, Context, Result, RunContext, Sink, SinkConfig, StageError, StageSpec};

/// Registry entry of the stage.
pub const STAGE: StageSpec = StageSpec::sink::<WriteDem>("write_dem", &[Kind::Points]).after(&["classify"]);

/// Writes the terrain of a flight line as Cloud Optimized GeoTIFF, with the standard deviation of each height.
///
/// The ground points (class 2) of `classify` are the measurements. Four bands of 32-bit floats: height of the terrain at the
/// centre of the cell, its SD, number of ground points in the cell, distance from the centre to the nearest ground point (m).
/// Heights are in the unit and vertical system of the points: above the ellipsoid, or above the geoid of `[job.geometry]`.
/// Cells without data have -9999. They are outside the ground points, or in a gap wider than 50 m. Cells are multiples of
/// `cell_m`, so the rasters of several flight lines fit together. `docs/explanation/ground.md` describes method and accuracy.
///
/// The total uncertainty of the points, which needs `trajectory_accuracy`, gives the error that all points of the flight line
/// share. Without it, 5 cm are assumed, with a warning. One flight line has no overlap from which this error could be estimated;
/// `wavex classify --dem` over all flight lines of a survey has.
///
/// Without ground points, for example over water, all cells have no data, and a warning says so. Points must be in a projected
/// system. Temporary files next to the output need 30 bytes per ground point, and 20 per first return for `surface` and `canopy`.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct WriteDem {
    /// Terrain model, ending in `.tif`; `*` is the input's stem.
    pub path: String,
    /// Edge of the cells, m.
    #[schemars(range(min = 0.05, max = 100.0))]
    pub cell_m: f64,
    /// Surface model with the same cells: the highest first return of each cell that is neither noise nor withheld.
    pub surface: Option<String>,
    /// Canopy heights with the same cells: surface minus terrain.
    pub canopy: Option<String>,
}

impl Default for WriteDem {
    fn default() -> WriteDem {
        WriteDem { path: "*_terrain.tif".into(), cell_m: 1.0, surface: None, canopy: None }
    }
}

impl WriteDem {
    /// Keys and paths of all rasters.
    fn rasters(&self) -> impl Iterator<Item = (&'static str, &str)> {
        let others = [("surface", &self.surface), ("canopy", &self.canopy)];
        let others = others.into_iter().filter_map(|(key, path)| Some((key, path.as_deref()?)));
        [("path", self.path.as_str())].into_iter().chain(others)
    }
}

impl Config for WriteDem {
    fn check(&self) -> std::result::Result<(), InvalidKey> {
        for (at, (key, path)) in self.rasters().enumerate() {
            let is_tiff = [".tif", ".tiff"].iter().any(|end| path.ends_with(end));
            InvalidKey::unless(is_tiff, key, "it must end in .tif, such as \"*_terrain.tif\"")?;
            let is_new = self.rasters().take(at).all(|(_, earlier)| earlier != path);
            InvalidKey::unless(is_new, key, "another raster of this stage has the same name")?;
        }
        Ok(())
    }
}

impl SinkConfig for WriteDem {
    fn outputs(&self) -> Vec<&str> {
        self.rasters().map(|(_, path)| path).collect()
    }

    fn make(&self, run: &RunContext) -> Result<Box<dyn Sink>> {
        let classify = run.chain.iter().find(|stage| stage.name == "classify");
        if classify.is_some_and(|stage| stage.keys["ground"] == false) {
            return Err(StageError::failed(
                "`write_dem` needs the ground, but `classify` has `ground = false`",
                "remove that key, or the stage `write_dem`",
            ));
        }
        let path = run.output_path(&self.path);
        let folder = path.parent().filter(|folder| *folder != Path::new("")).unwrap_or(Path::new("."));
        std::fs::create_dir_all(folder).map_err(wavex_formats::Error::io(folder, "create the folder"))?;
        let has_surface = self.surface.is_some() || self.canopy.is_some();
        let surface = has_surface.then(|| SurfacePoints::new(folder, self.cell_m)).transpose();
        let others = [&self.surface, &self.canopy];
        Ok(Box::new(DemWriter {
            ground: GroundPoints::new(folder).map_err(|error| no_room(&path, &error))?,
            surface: surface.map_err(|error| no_room(&path, &error))?,
            others: others.map(|other| other.as_deref().map(|other| run.output_path(other))),
            path,
            cell_m: self.cell_m,
            buffers: Default::default(),
            system: None,
            n_without_total: 0,
            extent_m: None,
            pool: run.pool.clone(),
            cancelled: Arc::clone(&run.cancelled),
        }))
    }
}

fn no_room(path: &Path, error: &io::Error) -> StageError {
    let problem = format!("{}: cannot use a temporary file next to the output: {error}", path.display());
    StageError::failed(problem, "free disk space")
}

/// Coordinate reference system of the points.
struct MapSystem {
    input: Arc<InputInfo>,
    /// Lengths of the units of x and y, and of z, m.
    units_m: [f64; 2],
}

impl MapSystem {
    /// # Errors
    /// The points of the line are not in a map, or in degrees.
    fn of(line: &ScanLine) -> Result<MapSystem> {
        let wkt = line.input.crs_wkt.as_deref();
        let system = wkt.and_then(Crs::horizontal_of_wkt);
        if !line.input.frame.is_georeferenced() || system.as_ref().is_some_and(Crs::is_ecef) {
            return Err(StageError::failed(
                "a terrain model needs points in a map",
                "give [job.geometry] a `trajectory` and a projected `crs`, such as \"utm\"",
            ));
        }
        if system.as_ref().is_some_and(Crs::is_geodetic) {
            return Err(StageError::failed(
                "a terrain model needs points in metres or feet, but these are in degrees",
                "give [job.geometry] a projected `crs`, such as \"utm\"",
            ));
        }
        Ok(MapSystem { input: Arc::clone(&line.input), units_m: wkt.map_or([1.0; 2], units_of_wkt) })
    }
}

struct DemWriter {
    path: PathBuf,
    /// Surface and canopy.
    others: [Option<PathBuf>; 2],
    cell_m: f64,
    ground: GroundPoints,
    surface: Option<SurfacePoints>,
    /// Of the ground and of the surface.
    buffers: [SpoolBuffers<Square>; 2],
    system: Option<MapSystem>,
    /// Ground points whose total uncertainty is unknown.
    n_without_total: u64,
    /// South-west and north-east corner of all points, m.
    extent_m: Option<[[f64; 2]; 2]>,
    pool: Option<Arc<ThreadPool>>,
    cancelled: Arc<AtomicBool>,
}

impl DemWriter {
    fn add(&mut self, found: &Return, position_m: [f64; 3], vertical: f64) -> io::Result<()> {
        let [x, y, _] = position_m;
        let [low, high] = self.extent_m.get_or_insert([[x, y]; 2]);
        (*low, *high) = ([low[0].min(x), low[1].min(y)], [high[0].max(x), high[1].max(y)]);
        let [of_ground, of_surface] = &mut self.buffers;
        if found.class == Class::Ground as u8 {
            let is_total = found.total_sd_m.is_finite();
            self.n_without_total += u64::from(!is_total);
            let sd_m = if is_total { found.total_sd_m } else { found.range_sd_m * vertical };
            let point = CloudPoint { height_sd_m: sd_m as f32, ..CloudPoint::at(position_m) };
            self.ground.push(of_ground, &point)?;
        }
        match &self.surface {
            Some(surface) if found.return_number <= 1 => surface.push(of_surface, position_m),
            _ => Ok(()),
        }
    }
}

impl Sink for DemWriter {
    fn write(&mut self, line: &ScanLine, _: &mut Context) -> Result<()> {
        let (Some(returns), Some(points)) = (line.returns(), line.points()) else { return Ok(()) };
        if returns.is_empty() {
            return Ok(());
        }
        let system = match self.system.take() {
            Some(known) if Arc::ptr_eq(&known.input, &line.input) => known,
            _ => MapSystem::of(line)?,
        };
        let [map_m, height_m] = system.units_m;
        self.system = Some(system);
        let down = line.emissions.first().and_then(|first| down_at(line.input.frame, first.origin_m));
        let noise = [Class::LowNoise as u8, Class::HighNoise as u8];
        for (found, point) in returns.iter().zip(points) {
            if found.withheld || noise.contains(&found.class) || !point.iter().all(|x| x.is_finite()) {
                continue;
            }
            let beam = line.emissions.get(found.emission as usize).map(|emission| emission.direction);
            let vertical = down.zip(beam).map_or(1.0, |(down, beam)| {
                down.iter().zip(beam).map(|(down, beam)| down * beam).sum::<f64>().abs()
            });
            let position_m = [map_m * point[0], map_m * point[1], height_m * point[2]];
            self.add(found, position_m, vertical).map_err(|error| no_room(&self.path, &error))?;
        }
        Ok(())
    }

    fn finish(mut self: Box<Self>, cx: &mut Context) -> Result<()> {
        let [of_ground, of_surface] = &mut self.buffers;
        let flushed = self.ground.flush(of_ground);
        let flushed =
            flushed.and_then(|()| self.surface.as_ref().map_or(Ok(()), |surface| surface.flush(of_surface)));
        flushed.map_err(|error| no_room(&self.path, &error))?;
        let [surface, canopy] = &self.others;
        let system = self.system.as_ref();
        let request = RasterRequest {
            terrain: &self.path,
            surface: surface.as_deref(),
            canopy: canopy.as_deref(),
            cell_m: self.cell_m,
            cell_option: "`cell_m`",
            crs_wkt: system.and_then(|system| system.input.crs_wkt.clone()),
            units_m: system.map_or([1.0; 2], |system| system.units_m),
            sds: if self.n_without_total == 0 { PointSds::Total } else { PointSds::Own },
            extent_m: Some(self.extent_m.unwrap_or_default()),
            is_cancelled: &|| self.cancelled.load(Ordering::Relaxed),
        };
        let write = || write_rasters(&self.ground, self.surface.as_ref(), &request);
        let written = match &self.pool {
            Some(pool) => pool.install(write),
            None => write(),
        }?;
        written.warnings.iter().for_each(|warning| cx.warn(warning));
        cx.info(written.text.lines().next().unwrap_or_default());
        written.files.into_iter().for_each(|file| cx.publish(file));
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_rasters_are_checked() {
        let key = |config: WriteDem| config.check().map_err(|error| error.key);
        assert!(key(WriteDem::default()).is_ok());
        assert_eq!(key(WriteDem { path: "*.png".into(), ..WriteDem::default() }), Err("path"));
        let surface = Some("*.tif".to_owned());
        assert!(key(WriteDem { surface: surface.clone(), ..WriteDem::default() }).is_ok());
        assert_eq!(key(WriteDem { canopy: surface.clone(), surface, ..WriteDem::default() }), Err("canopy"));
    }
}

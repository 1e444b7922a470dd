//! Terrain model of classified clouds as GeoTIFF.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use rayon::ThreadPoolBuilder;
use wavex_engine::engine::Cancel;
use wavex_formats::geotiff::{NO_DATA, RasterGrid, RasterWriter, TILE, TileValues, empty_tile_of};
use wavex_ground::point::CloudPoint;
use wavex_ground::terrain::{CellRange, TerrainModel, TerrainOptions, learn_terrain, terrain_of_tile};
use wavex_line::stage::OutputFile;

use super::{GroundTiles, TILE_M, Tile};
use crate::Failure;

/// Edge of a sample from which roughness and noise are learnt, m.
const SAMPLE_M: f64 = 128.0;
/// Most samples.
const MOST_SAMPLES: usize = 16;
/// Most points of all samples.
const MOST_SAMPLE_POINTS: usize = 4_000_000;
/// Largest edge of the cells that are computed together, m: memory is bounded by their points.
const BLOCK_M: f64 = 256.0;
/// Most tiles of a raster: their directory stays below 100 MB.
const MOST_TILES: u64 = 8_000_000;
/// Bands: height, SD, number of points, distance.
const BANDS: usize = 4;

/// A terrain model to write.
#[derive(Clone, Debug)]
pub struct TerrainRequest<'a> {
    /// GeoTIFF to write.
    pub path: &'a Path,
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
    /// The GeoTIFF.
    pub path: PathBuf,
    /// Summary for people.
    pub text: String,
    /// What was assumed because the data did not determine it.
    pub warnings: Vec<String>,
}

/// Writes the terrain of classified clouds as Cloud Optimized GeoTIFF.
///
/// Bands: height at the cell's centre, its SD, number of ground points, distance to the nearest one; heights and
/// distances in the units of the clouds. Cells are multiples of their size, so models of neighbouring areas fit.
///
/// # Errors
/// There are no ground points, the raster would be too large, a file cannot be written.
pub fn write_terrain(ground: &GroundTiles, request: &TerrainRequest<'_>) -> Result<WrittenTerrain, Failure> {
    let pool = ThreadPoolBuilder::new().num_threads(request.threads).build();
    let pool =
        pool.map_err(|error| Failure::Run(format!("cannot start threads: {error}; set fewer `--threads`")))?;
    pool.install(|| write(ground, request))
}

fn write(ground: &GroundTiles, request: &TerrainRequest<'_>) -> Result<WrittenTerrain, Failure> {
    let path = request.path;
    let failed = |problem: String| Failure::Run(format!("{}: {problem}", path.display()));
    let Some(extent) = Extent::of(ground)? else {
        return Err(failed(
            "no terrain model is written: the clouds have no ground points; check the classes".into(),
        ));
    };
    let options = TerrainOptions::default();
    let model = learn_terrain(&extent.samples(ground)?, None, options.widest_gap_m);
    let cell_m = request.cell_m;
    let [first_column, south_row] = extent.low.map(|low| (low / cell_m).floor() as i64);
    let [last_column, north_row] = extent.high.map(|high| (high / cell_m).floor() as i64);
    let (columns, rows) = (last_column.abs_diff(first_column) + 1, north_row.abs_diff(south_row) + 1);
    let tiles = [columns, rows].map(|cells| cells.div_ceil(TILE as u64));
    if tiles[0].saturating_mul(tiles[1]) > MOST_TILES {
        return Err(failed(format!(
            "{columns} by {rows} cells are too many; set a larger `--cell`, or leave out clouds far away"
        )));
    }
    let [unit_m, height_unit_m] = ground.units_m;
    let unit = if height_unit_m == 1.0 { "m" } else { "units of the heights" };
    let grid = RasterGrid {
        columns: columns as u32,
        rows: rows as u32,
        west: first_column as f64 * cell_m / unit_m,
        north: (north_row + 1) as f64 * cell_m / unit_m,
        cell: cell_m / unit_m,
        crs_wkt: ground.wkt.clone(),
        bands: vec![
            format!("height, {unit}"),
            format!("SD of the height, {unit}"),
            "number of ground points".into(),
            "distance to the nearest ground point, m".into(),
        ],
    };
    let io_failed =
        |error: std::io::Error| Failure::Run(wavex_formats::Error::io(path, "write")(error).to_string());
    let formats_failed = |error: wavex_formats::Error| Failure::Run(error.to_string());
    if let Some(folder) = path.parent().filter(|folder| *folder != Path::new("")) {
        std::fs::create_dir_all(folder).map_err(io_failed)?;
    }
    // The tiles are spooled next to the file; the spool is never published.
    let spool = OutputFile::create(&path.with_extension("tif.tiles")).map_err(formats_failed)?;
    let mut writer = RasterWriter::new(grid, spool);
    let mut summary = Summary::default();
    for row in 0..tiles[1] as u32 {
        for column in 0..tiles[0] as u32 {
            super::check_interruption(&request.cancel)?;
            let cells = CellRange {
                first_column: first_column + i64::from(column) * TILE as i64,
                north_row: north_row - i64::from(row) * TILE as i64,
                columns: TILE.min((columns - u64::from(column) * TILE as u64) as usize),
                rows: TILE.min((rows - u64::from(row) * TILE as u64) as usize),
            };
            if let Some(values) =
                raster_tile(ground, cells, cell_m, &model, &options, height_unit_m, &mut summary)?
            {
                writer.tile(row, column, values).map_err(io_failed)?;
            }
        }
    }
    let (spool, raster) = writer.finish().map_err(io_failed)?;
    let spool = spool.finish().map_err(formats_failed)?;
    let mut tiles = spool.open().map_err(io_failed)?;
    let mut file = OutputFile::create(path).map_err(formats_failed)?;
    raster.assemble(&mut tiles, &mut file).map_err(io_failed)?;
    let path = file.finish().and_then(|file| file.publish()).map_err(formats_failed)?;
    let warnings =
        model.assumptions.iter().map(|assumption| format!("{}: {assumption}", path.display())).collect();
    Ok(WrittenTerrain { text: summary.text(cell_m, &model), path, warnings })
}

/// Computes a tile of the raster in blocks; `None` if no ground is near.
fn raster_tile(
    ground: &GroundTiles,
    cells: CellRange,
    cell_m: f64,
    model: &TerrainModel,
    options: &TerrainOptions,
    height_unit_m: f64,
    summary: &mut Summary,
) -> Result<Option<TileValues>, Failure> {
    let mut values: Option<TileValues> = None;
    let step = ((BLOCK_M / cell_m) as usize).clamp(1, TILE);
    for top in (0..cells.rows).step_by(step) {
        for left in (0..cells.columns).step_by(step) {
            let block = CellRange {
                first_column: cells.first_column + left as i64,
                north_row: cells.north_row - top as i64,
                columns: step.min(cells.columns - left),
                rows: step.min(cells.rows - top),
            };
            let margin_m = options.margin_m();
            let west = block.first_column as f64 * cell_m;
            let north = (block.north_row + 1) as f64 * cell_m;
            let low = [west - margin_m, north - block.rows as f64 * cell_m - margin_m];
            let high = [west + block.columns as f64 * cell_m + margin_m, north + margin_m];
            let points = points_within(ground, low, high)?;
            if points.is_empty() {
                continue;
            }
            let terrain = terrain_of_tile(&points, block, cell_m, model, options);
            for i in 0..block.columns * block.rows {
                let (height_m, sd_m) = (terrain.height_m[i], terrain.sd_m[i]);
                if !height_m.is_finite() {
                    continue;
                }
                summary.add(sd_m);
                let values = values.get_or_insert_with(|| empty_tile_of(BANDS));
                let at = (top + i / block.columns) * TILE + left + i % block.columns;
                let in_units = |value: f32| (f64::from(value) / height_unit_m) as f32;
                values[at * BANDS..][..BANDS].copy_from_slice(&[
                    in_units(height_m),
                    in_units(sd_m),
                    terrain.n_points[i],
                    terrain.distance_m[i],
                ]);
            }
        }
    }
    Ok(values.map(|mut values| {
        values.iter_mut().filter(|value| value.is_nan()).for_each(|value| *value = NO_DATA);
        values
    }))
}

/// Ground points of a rectangle.
fn points_within(ground: &GroundTiles, low: [f64; 2], high: [f64; 2]) -> Result<Vec<CloudPoint>, Failure> {
    let tile = |at: [f64; 2]| at.map(|x| (x / TILE_M).floor() as i64);
    let (from, to) = (tile(low), tile(high));
    let mut points = Vec::new();
    for east in from[0]..=to[0] {
        for north in from[1]..=to[1] {
            let near = ground.points([east, north], 0.0)?;
            points.extend(
                near.into_iter()
                    .filter(|p| (0..2).all(|axis| (low[axis]..=high[axis]).contains(&p.position_m[axis]))),
            );
        }
    }
    Ok(points)
}

/// Where the ground points are.
struct Extent {
    low: [f64; 2],
    high: [f64; 2],
    /// Number of points of each square of [`SAMPLE_M`].
    squares: BTreeMap<Tile, usize>,
}

impl Extent {
    fn of(ground: &GroundTiles) -> Result<Option<Extent>, Failure> {
        let mut extent =
            Extent { low: [f64::INFINITY; 2], high: [f64::NEG_INFINITY; 2], squares: BTreeMap::new() };
        for tile in ground.tiles() {
            for point in ground.points(tile, 0.0)? {
                for axis in 0..2 {
                    extent.low[axis] = extent.low[axis].min(point.position_m[axis]);
                    extent.high[axis] = extent.high[axis].max(point.position_m[axis]);
                }
                let square = [0, 1].map(|axis| (point.position_m[axis] / SAMPLE_M).floor() as i64);
                *extent.squares.entry(square).or_insert(0) += 1;
            }
        }
        Ok((!extent.squares.is_empty()).then_some(extent))
    }

    /// Points of squares that are spread over the area, by a choice that depends on the points alone.
    fn samples(&self, ground: &GroundTiles) -> Result<Vec<Vec<CloudPoint>>, Failure> {
        let mut counts: Vec<usize> = self.squares.values().copied().collect();
        counts.sort_unstable();
        // Squares at the edge with few points say little.
        let fewest = counts[counts.len() / 2] / 4;
        let mut squares: Vec<(u64, Tile, usize)> = self
            .squares
            .iter()
            .filter(|(_, n)| **n >= fewest)
            .map(|(square, n)| (mixed(*square), *square, *n))
            .collect();
        squares.sort_unstable();
        let mut samples = Vec::new();
        let mut n_points = 0;
        for (_, square, n) in squares.into_iter().take(MOST_SAMPLES) {
            if n_points > 0 && n_points + n > MOST_SAMPLE_POINTS {
                break;
            }
            n_points += n;
            let low = square.map(|i| i as f64 * SAMPLE_M);
            samples.push(points_within(ground, low, low.map(|x| x + SAMPLE_M))?);
        }
        Ok(samples)
    }
}

/// Order of squares without a direction.
fn mixed(square: Tile) -> u64 {
    square.iter().fold(0u64, |state, i| {
        let mixed = (state ^ *i as u64).wrapping_mul(0x9E37_79B9_7F4A_7C15);
        mixed ^ (mixed >> 29)
    })
}

/// What a model's cells are like.
#[derive(Debug, Default)]
struct Summary {
    n_cells: u64,
    /// Cells by SD in steps of 10 %, from 1 mm.
    by_sd: BTreeMap<i32, u64>,
}

impl Summary {
    fn add(&mut self, sd_m: f32) {
        self.n_cells += 1;
        *self.by_sd.entry((f64::from(sd_m.max(0.001)) / 0.001).log(1.1) as i32).or_insert(0) += 1;
    }

    fn quantile(&self, part: f64) -> f64 {
        let mut n = 0;
        let step = self.by_sd.iter().find(|(_, cells)| {
            n += **cells;
            n as f64 >= part * self.n_cells as f64
        });
        step.map_or(f64::NAN, |(step, _)| 0.1 * 1.1f64.powf(f64::from(*step) + 0.5))
    }

    fn text(&self, cell_m: f64, model: &TerrainModel) -> String {
        format!(
            "terrain: {} cells of {cell_m} m, SD of heights {:.1} cm (median), {:.1} cm (95 %)\n  {model}\n",
            self.n_cells,
            self.quantile(0.5),
            self.quantile(0.95)
        )
    }
}

//! Terrain, surface and canopy heights as Cloud Optimized GeoTIFF.

use std::collections::BTreeMap;
use std::io;
use std::path::Path;

use wavex_formats::geotiff::{NO_DATA, RasterGrid, RasterWriter, TILE, TileValues, empty_tile_of};
use wavex_ground::point::CloudPoint;
use wavex_ground::terrain::{
    CellRange, PointSds, TerrainModel, TerrainOptions, learn_terrain, terrain_of_tile,
};
use wavex_line::stage::{FinishedFile, OutputFile, Result, StageError};

use super::points::{GroundPoints, SQUARE_M, Square};
use super::surface::SurfacePoints;

/// Most samples from which roughness and noise are learnt, each a square of [`SQUARE_M`].
const MOST_SAMPLES: usize = 16;
/// Most points of all samples.
const MOST_SAMPLE_POINTS: usize = 4_000_000;
/// Largest edge of the cells that are computed together, m: memory is bounded by their points.
const BLOCK_M: f64 = 256.0;
/// Most tiles of a raster: their directory stays below 100 MB.
const MOST_TILES: u64 = 8_000_000;
/// Bands of a terrain model: height, SD, number of points, distance.
const BANDS: usize = 4;

/// Rasters to write.
pub struct RasterRequest<'a> {
    /// Terrain model.
    pub terrain: &'a Path,
    /// Surface model: highest first return of each cell.
    pub surface: Option<&'a Path>,
    /// Height of the surface above the terrain.
    pub canopy: Option<&'a Path>,
    /// Edge of the cells, m; that of the surface points, if there are any.
    pub cell_m: f64,
    /// Name of the option that sets it, for messages.
    pub cell_option: &'a str,
    /// Coordinate reference system as WKT.
    pub crs_wkt: Option<String>,
    /// Lengths of the units of x and y, and of z in this system, m.
    pub units_m: [f64; 2],
    /// What the SDs of the points include.
    pub sds: PointSds,
    /// South-west and north-east corner, m, of rasters without ground points; `None`: they are an error.
    pub extent_m: Option<[[f64; 2]; 2]>,
    /// Whether to end early.
    pub is_cancelled: &'a (dyn Fn() -> bool + Sync),
}

/// Rasters with temporary names.
pub struct WrittenRasters {
    /// The files: terrain, then surface and canopy.
    pub files: Vec<FinishedFile>,
    /// Summary for people.
    pub text: String,
    /// What was assumed because the data did not determine it.
    pub warnings: Vec<String>,
}

/// Writes the terrain, and with `surface` the surface and canopy heights, as Cloud Optimized GeoTIFF.
///
/// Bands of the terrain: height at the cell's centre, its SD, number of ground points, distance to the nearest one, m. Heights
/// are in the units of the CRS. Cells are multiples of their size, so models of neighbouring areas fit. All rasters have
/// the same cells.
///
/// # Errors
/// There are no ground points, a raster would be too large, a file cannot be written, or it ends early
/// ([`StageError::Stopped`]).
pub fn write_rasters(
    ground: &GroundPoints,
    surface: Option<&SurfacePoints>,
    request: &RasterRequest<'_>,
) -> Result<WrittenRasters> {
    let path = request.terrain.display();
    let temporary = |error: io::Error| {
        let problem = format!("{path}: cannot use a temporary file next to the output: {error}");
        StageError::failed(problem, "free disk space")
    };
    let found = Extent::of(ground, request.cell_m).map_err(temporary)?;
    let has_ground = found.is_some();
    let without =
        || Some(Extent { cells: cells_of(request.extent_m?, request.cell_m), squares: BTreeMap::new() });
    let Some(mut extent) = found.or_else(without) else {
        return Err(StageError::failed(
            format!("{path}: no terrain model is written: there are no ground points"),
            "check the classes of the points, and whether they are a water surface or clouds",
        ));
    };
    if let Some(cells) = surface.map(SurfacePoints::extent).transpose().map_err(temporary)?.flatten() {
        extent.add(cells);
    }
    let options = TerrainOptions::default();
    let samples = extent.samples(ground).map_err(temporary)?;
    let model = learn_terrain(&samples, None, request.sds, options.widest_gap_m);
    let [[first_column, south_row], [last_column, north_row]] = extent.cells;
    let (columns, rows) = (
        last_column.abs_diff(first_column).saturating_add(1),
        north_row.abs_diff(south_row).saturating_add(1),
    );
    let tiles = [columns, rows].map(|cells| cells.div_ceil(TILE as u64));
    if tiles[0].saturating_mul(tiles[1]) > MOST_TILES {
        return Err(StageError::failed(
            format!("{path}: {columns} by {rows} cells are too many"),
            format!("set a larger {}, or leave out points far away", request.cell_option),
        ));
    }
    let [unit_m, height_unit_m] = request.units_m;
    let unit = if height_unit_m == 1.0 { "m" } else { "units of the heights" };
    let grid = |bands: Vec<String>| RasterGrid {
        columns: columns as u32,
        rows: rows as u32,
        west: first_column as f64 * request.cell_m / unit_m,
        north: (north_row + 1) as f64 * request.cell_m / unit_m,
        cell: request.cell_m / unit_m,
        crs_wkt: request.crs_wkt.clone(),
        bands,
    };
    let of_terrain = vec![
        format!("height, {unit}"),
        format!("SD of the height, {unit}"),
        "number of ground points".into(),
        "distance to the nearest ground point, m".into(),
    ];
    let mut terrain_raster = Raster::create(request.terrain, grid(of_terrain))?;
    let others = [
        (request.surface, format!("height of the highest first return, {unit}")),
        (request.canopy, format!("height of the highest first return above the terrain, {unit}")),
    ];
    let others =
        others.map(|(path, band)| path.map(|path| Raster::create(path, grid(vec![band]))).transpose());
    let [surface_raster, canopy_raster] = others;
    let (mut surface_raster, mut canopy_raster) = (surface_raster?, canopy_raster?);
    let mut summary = Summary::default();
    for row in 0..tiles[1] as u32 {
        for column in 0..tiles[0] as u32 {
            if (request.is_cancelled)() {
                return Err(StageError::Stopped);
            }
            let cells = CellRange {
                first_column: first_column + i64::from(column) * TILE as i64,
                north_row: north_row - i64::from(row) * TILE as i64,
                columns: TILE.min((columns - u64::from(column) * TILE as u64) as usize),
                rows: TILE.min((rows - u64::from(row) * TILE as u64) as usize),
            };
            let terrain = terrain_tile(ground, cells, request.cell_m, &model, &options, &mut summary);
            let terrain = terrain.map_err(temporary)?;
            if let Some(surface) = surface {
                let highest = surface.highest(cells).map_err(temporary)?;
                let place = [row, column];
                add_single(surface_raster.as_mut(), place, cells, height_unit_m, |i| highest[i])?;
                let above = |i: usize| match &terrain {
                    Some(terrain) => highest[i] - terrain[tile_index(cells, i) * BANDS],
                    None => f32::NAN,
                };
                add_single(canopy_raster.as_mut(), place, cells, height_unit_m, above)?;
            }
            if let Some(mut values) = terrain {
                let in_units = |value: &mut f32| *value = (f64::from(*value) / height_unit_m) as f32;
                values.chunks_exact_mut(BANDS).flat_map(|cell| &mut cell[..2]).for_each(in_units);
                terrain_raster.add(row, column, values)?;
            }
        }
    }
    let rasters = [Some(terrain_raster), surface_raster, canopy_raster].into_iter().flatten();
    let files = rasters.map(Raster::finish).collect::<Result<Vec<_>>>()?;
    let warnings = match has_ground {
        true => model.assumptions.iter().map(|assumption| format!("{path}: {assumption}")).collect(),
        false => vec![format!(
            "{path}: no cell of the terrain model has data: there are no ground points; the points may be a water surface or \
             clouds"
        )],
    };
    Ok(WrittenRasters { files, text: summary.text(request.cell_m, &model), warnings })
}

/// A raster being written.
struct Raster<'a> {
    path: &'a Path,
    writer: RasterWriter<OutputFile>,
}

impl<'a> Raster<'a> {
    fn create(path: &'a Path, grid: RasterGrid) -> Result<Raster<'a>> {
        // The tiles are spooled next to the file; the spool is never published.
        let spool = OutputFile::create(&path.with_extension("tif.tiles"))?;
        Ok(Raster { path, writer: RasterWriter::new(grid, spool) })
    }

    /// Adds a tile; values that are not numbers are stored as no data.
    fn add(&mut self, row: u32, column: u32, mut values: TileValues) -> Result<()> {
        values.iter_mut().filter(|value| value.is_nan()).for_each(|value| *value = NO_DATA);
        let written = self.writer.tile(row, column, values);
        Ok(written.map_err(wavex_formats::Error::io(self.path, "write"))?)
    }

    fn finish(self) -> Result<FinishedFile> {
        let failed = |error| wavex_formats::Error::io(self.path, "write")(error);
        let (spool, raster) = self.writer.finish().map_err(failed)?;
        let spool = spool.finish_without_sync()?;
        let mut tiles = spool.open().map_err(failed)?;
        let mut file = OutputFile::create(self.path)?;
        raster.assemble(&mut tiles, &mut file).map_err(failed)?;
        Ok(file.finish()?)
    }
}

/// Index in a raster's tile of the cell `i` of a range.
fn tile_index(cells: CellRange, i: usize) -> usize {
    i / cells.columns * TILE + i % cells.columns
}

/// Adds heights to a raster of one band, if it is written and there are any; `height_m` may be NaN.
fn add_single(
    raster: Option<&mut Raster<'_>>,
    [row, column]: [u32; 2],
    cells: CellRange,
    unit_m: f64,
    height_m: impl Fn(usize) -> f32,
) -> Result<()> {
    let Some(raster) = raster else { return Ok(()) };
    let mut values: Option<TileValues> = None;
    for i in 0..cells.columns * cells.rows {
        let height_m = height_m(i);
        if height_m.is_finite() {
            let values = values.get_or_insert_with(|| empty_tile_of(1));
            values[tile_index(cells, i)] = (f64::from(height_m) / unit_m) as f32;
        }
    }
    values.map_or(Ok(()), |values| raster.add(row, column, values))
}

/// Terrain of a tile of the raster, computed in blocks; m, NaN without data. `None` if it has no cell with data.
fn terrain_tile(
    ground: &GroundPoints,
    cells: CellRange,
    cell_m: f64,
    model: &TerrainModel,
    options: &TerrainOptions,
    summary: &mut Summary,
) -> io::Result<Option<TileValues>> {
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
            let points = ground.within(low, high)?;
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
                let values =
                    values.get_or_insert_with(|| vec![f32::NAN; TILE * TILE * BANDS].into_boxed_slice());
                let at = (top + i / block.columns) * TILE + left + i % block.columns;
                values[at * BANDS..][..BANDS].copy_from_slice(&[
                    height_m,
                    sd_m,
                    terrain.n_points[i],
                    terrain.distance_m[i],
                ]);
            }
        }
    }
    Ok(values)
}

/// Where the ground points are.
struct Extent {
    /// First and last column and row.
    cells: [[i64; 2]; 2],
    /// Number of points of each square.
    squares: BTreeMap<Square, usize>,
}

impl Extent {
    fn of(ground: &GroundPoints, cell_m: f64) -> io::Result<Option<Extent>> {
        let mut low = [f64::INFINITY; 2];
        let mut high = [f64::NEG_INFINITY; 2];
        let mut squares = BTreeMap::new();
        for square in ground.squares() {
            let n = ground.each(square, |point| {
                for axis in 0..2 {
                    low[axis] = low[axis].min(point.position_m[axis]);
                    high[axis] = high[axis].max(point.position_m[axis]);
                }
            })?;
            squares.insert(square, n);
        }
        let cells = cells_of([low, high], cell_m);
        Ok((!squares.is_empty()).then_some(Extent { cells, squares }))
    }

    /// Extends the cells by other cells.
    fn add(&mut self, [low, high]: [[i64; 2]; 2]) {
        for axis in 0..2 {
            self.cells[0][axis] = self.cells[0][axis].min(low[axis]);
            self.cells[1][axis] = self.cells[1][axis].max(high[axis]);
        }
    }

    /// Points of squares that are spread over the area, by a choice that depends on the points alone.
    fn samples(&self, ground: &GroundPoints) -> io::Result<Vec<Vec<CloudPoint>>> {
        let mut counts: Vec<usize> = self.squares.values().copied().collect();
        counts.sort_unstable();
        // Squares at the edge with few points say little.
        let fewest = counts.get(counts.len() / 2).map_or(0, |median| median / 4);
        let mut squares: Vec<(u64, Square, usize)> = self
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
            let low = square.map(|i| i as f64 * SQUARE_M);
            samples.push(ground.within(low, low.map(|x| x + SQUARE_M))?);
        }
        Ok(samples)
    }
}

/// Cells of two corners, m.
fn cells_of(corners_m: [[f64; 2]; 2], cell_m: f64) -> [[i64; 2]; 2] {
    corners_m.map(|corner| corner.map(|x| (x / cell_m).floor() as i64))
}

/// Order of squares without a direction.
fn mixed(square: Square) -> u64 {
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
        if self.n_cells == 0 {
            return "terrain: no cell has data\n".to_owned();
        }
        format!(
            "terrain: {} cells of {cell_m} m, SD of heights {:.1} cm (median), {:.1} cm (95 %)\n  {model}\n",
            self.n_cells,
            self.quantile(0.5),
            self.quantile(0.95)
        )
    }
}

//! Rasters of a survey, written row by row from the north.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use wavex_formats::geotiff::{RasterGrid, RasterWriter, TILE, TileValues, empty_tile};
use wavex_formats::{Error, Result};
use wavex_line::stage::OutputFile;

/// Quantity of a raster, with the end of its file name and its description.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum RasterContent {
    Pulses,
    Points,
    Strips,
    Difference,
    Roughness,
}

/// The rasters of a survey: content, end of the name, description with unit.
const LAYERS: [(RasterContent, &str, &str); 5] = [
    (RasterContent::Pulses, "pulse_density", "pulse density (first returns of all strips), 1/m2"),
    (RasterContent::Points, "point_density", "point density (returns of all strips), 1/m2"),
    (RasterContent::Strips, "strips", "number of strips"),
    (
        RasterContent::Difference,
        "height_difference",
        "largest height difference of two strips, later minus earlier, m",
    ),
    (RasterContent::Roughness, "roughness", "largest SD of the points of a strip from their plane, m"),
];

/// Largest number of tiles of a raster: their directory stays below 100 MB.
const MOST_TILES: u64 = 8_000_000;

/// Grid common to all rasters.
#[derive(Clone, Debug)]
pub(super) struct RasterFrame {
    /// Westernmost and northernmost cell.
    pub(super) west: i32,
    pub(super) north: i32,
    pub(super) columns: u32,
    pub(super) rows: u32,
    /// Level of the cells.
    pub(super) level: u8,
    /// Cell size in units of the CRS.
    pub(super) cell: f64,
    pub(super) crs_wkt: Option<String>,
}

impl RasterFrame {
    /// Whether rasters of this size can be written.
    pub(super) fn is_possible(&self) -> bool {
        let tiles = |cells: u32| u64::from(cells.div_ceil(TILE as u32));
        tiles(self.columns) * tiles(self.rows) <= MOST_TILES
    }

    fn grid(&self, description: &str) -> RasterGrid {
        RasterGrid {
            columns: self.columns,
            rows: self.rows,
            west: f64::from(self.west) * self.cell,
            north: (f64::from(self.north) + 1.0) * self.cell,
            cell: self.cell,
            crs_wkt: self.crs_wkt.clone(),
            bands: vec![description.to_owned()],
        }
    }
}

/// The rasters being written.
pub(super) struct Rasters {
    frame: RasterFrame,
    rasters: Vec<Raster>,
    /// Row of the tiles being filled.
    row: u32,
}

struct Raster {
    layer: RasterContent,
    writer: RasterWriter<OutputFile>,
    tiles: BTreeMap<u32, TileValues>,
    path: PathBuf,
}

impl Rasters {
    /// Starts rasters of all layers, `STEM_LAYER.tif`; `stem` is a path.
    ///
    /// # Errors
    /// If a file cannot be created.
    pub(super) fn create(frame: RasterFrame, stem: &Path) -> Result<Rasters> {
        let mut rasters = Rasters { frame, rasters: Vec::new(), row: 0 };
        for ((layer, _, description), path) in LAYERS.into_iter().zip(paths(stem)) {
            rasters.add(layer, description, path)?;
        }
        Ok(rasters)
    }

    /// Starts the raster of the pulse density of one strip.
    ///
    /// # Errors
    /// If the file cannot be created.
    pub(super) fn of_strip(frame: RasterFrame, path: &Path) -> Result<Rasters> {
        let mut rasters = Rasters { frame, rasters: Vec::new(), row: 0 };
        rasters.add(RasterContent::Pulses, "pulse density (first returns), 1/m2", path.to_owned())?;
        Ok(rasters)
    }

    fn add(&mut self, layer: RasterContent, description: &str, path: PathBuf) -> Result<()> {
        // The tiles are spooled next to the file; the spool is never published.
        let spool = OutputFile::create(&path.with_extension("tif.tiles"))?;
        let writer = RasterWriter::new(self.frame.grid(description), spool);
        self.rasters.push(Raster { layer, writer, tiles: BTreeMap::new(), path });
        Ok(())
    }

    /// Starts a row of cells; rows come from north to south.
    ///
    /// # Errors
    /// If a file cannot be written.
    pub(super) fn begin_row(&mut self, row: i32) -> Result<()> {
        let tile_row = self.row_index(row) / TILE as u32;
        if tile_row != self.row {
            self.store()?;
            self.row = tile_row;
        }
        Ok(())
    }

    /// Sets a value of the current row.
    pub(super) fn set(&mut self, layer: RasterContent, row: i32, column: i32, value: f64) {
        let (y, x) = (self.row_index(row) as usize % TILE, column.wrapping_sub(self.frame.west) as u32);
        if let Some(raster) = self.rasters.iter_mut().find(|raster| raster.layer == layer) {
            let tile = raster.tiles.entry(x / TILE as u32).or_insert_with(empty_tile);
            tile[y * TILE + x as usize % TILE] = value as f32;
        }
    }

    fn row_index(&self, row: i32) -> u32 {
        self.frame.north.wrapping_sub(row) as u32
    }

    /// Writes the current row of tiles.
    fn store(&mut self) -> Result<()> {
        for raster in &mut self.rasters {
            for (column, tile) in std::mem::take(&mut raster.tiles) {
                let written = raster.writer.tile(self.row, column, tile);
                written.map_err(Error::io(&raster.path, "write"))?;
            }
        }
        Ok(())
    }

    /// Completes the files and returns their paths.
    ///
    /// # Errors
    /// If a file cannot be written.
    pub(super) fn finish(mut self) -> Result<Vec<PathBuf>> {
        self.store()?;
        let mut written = Vec::new();
        for Raster { writer, path, .. } in self.rasters {
            let failed = |error| Error::io(&path, "write")(error);
            let (spool, raster) = writer.finish().map_err(failed)?;
            let spool = spool.finish()?;
            let mut tiles = spool.open().map_err(failed)?;
            let mut file = OutputFile::create(&path)?;
            raster.assemble(&mut tiles, &mut file).map_err(failed)?;
            written.push(file.finish()?.publish()?);
        }
        Ok(written)
    }
}

/// Description of the raster of a survey with this path; `None` for other files.
pub(crate) fn description(path: &Path) -> Option<&'static str> {
    let stem = path.file_stem()?.to_str().filter(|_| path.extension().is_some_and(|end| end == "tif"))?;
    LAYERS.iter().find(|(_, end, _)| stem.ends_with(&format!("_{end}"))).map(|(_, _, text)| *text)
}

/// Paths of the rasters of this stem.
pub(super) fn paths(stem: &Path) -> Vec<PathBuf> {
    let name = stem.file_name().unwrap_or_default().to_string_lossy();
    LAYERS.iter().map(|(_, end, _)| stem.with_file_name(format!("{name}_{end}.tif"))).collect()
}

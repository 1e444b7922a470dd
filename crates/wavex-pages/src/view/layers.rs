//! Rasters of a survey and terrain models as pictures.

use std::path::Path;

use serde_json::{Value, json};

use crate::plot::{HEIGHTS, Picture};
use crate::report::survey::{DIFFERENCES, raster_description};
use wavex_formats::terrain::Terrain;

/// Most rasters of a folder that are shown.
const MOST_LAYERS: usize = 20;
/// Limit of the columns or rows of a picture; larger rasters are thinned out.
const MAX_CELLS: usize = 2048;

/// Bands of terrain models that are shown: beginnings of their descriptions.
const TERRAIN_BANDS: [&str; 2] = ["height", "SD of the height"];

/// Path, band and label of the pictures of a raster; none for rasters that are neither of a survey nor terrain with SDs.
fn pictured(path: &Path) -> Vec<(&Path, usize, String)> {
    if let Some(label) = raster_description(path) {
        return vec![(path, 0, label.to_owned())];
    }
    if !path.extension().is_some_and(|end| end.eq_ignore_ascii_case("tif")) {
        return Vec::new();
    }
    let bands = Terrain::band_descriptions(path).unwrap_or_default();
    let is_terrain = bands.len() >= TERRAIN_BANDS.len()
        && bands.iter().zip(TERRAIN_BANDS).all(|(band, begin)| band.starts_with(begin));
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    let shown = (0..).zip(bands).take(if is_terrain { TERRAIN_BANDS.len() } else { 0 });
    shown.map(|(band, description)| (path, band, format!("{stem}: {description}"))).collect()
}

/// A raster of a survey, or a band of a terrain model.
pub(super) struct RasterLayer {
    name: String,
    label: String,
    /// South-west and north-east corner, m.
    corners_m: [[f64; 2]; 2],
    /// Values of the first and the last colour.
    range: [f64; 2],
    is_diverging: bool,
    picture: Picture,
}

impl RasterLayer {
    /// Reads the rasters of surveys and the terrain models in a folder; those that cannot be read become warnings.
    pub(super) fn of_folder(folder: &Path) -> (Vec<RasterLayer>, Vec<String>) {
        let entries = folder.read_dir().into_iter().flatten().flatten();
        let mut paths: Vec<_> = entries.map(|entry| entry.path()).collect();
        paths.sort();
        let (mut layers, mut warnings) = (Vec::new(), Vec::new());
        for (path, band, label) in paths.iter().flat_map(|path| pictured(path)).take(MOST_LAYERS) {
            match RasterLayer::read(path, band, label) {
                Ok(layer) => layers.push(layer),
                Err(error) => warnings.push(error.to_string()),
            }
        }
        (layers, warnings)
    }

    fn read(path: &Path, band: usize, label: String) -> wavex_formats::Result<RasterLayer> {
        let raster = Terrain::open_band(path, band)?;
        let [columns, rows] = raster.size();
        let step = columns.max(rows).div_ceil(MAX_CELLS).max(1);
        let cells: Vec<Option<f64>> = (0..rows)
            .step_by(step)
            .flat_map(|row| (0..columns).step_by(step).map(move |column| row * columns + column))
            .map(|at| {
                raster.values().get(at).map(|&value| f64::from(value)).filter(|value| value.is_finite())
            })
            .collect();
        let columns = columns.div_ceil(step);
        let is_diverging = label.contains("difference");
        let (mut picture, mut range) = Picture::of(&cells, columns, &HEIGHTS);
        if is_diverging {
            let limit = range[0].abs().max(range[1].abs());
            range = [-limit, limit];
            picture = Picture::within(&cells, columns, &DIFFERENCES, range);
        }
        let mut name = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        if band > 0 {
            name += &format!(" {}", band + 1);
        }
        Ok(RasterLayer { name, label, corners_m: raster.corners_m(), range, is_diverging, picture })
    }

    pub(super) fn name(&self) -> &str {
        &self.name
    }

    /// Description for the page.
    pub(super) fn describe(&self) -> Value {
        json!({
            "name": self.name, "label": self.label, "unit": "", "min": self.corners_m[0],
            "max": self.corners_m[1], "range": self.range, "diverging": self.is_diverging,
        })
    }

    /// The picture as PNG.
    pub(super) fn png(&self) -> Vec<u8> {
        self.picture.png()
    }
}

//! One pass over the cells of all strips, row by row from north to south.

use std::collections::BTreeMap;
use std::path::Path;

use super::cell::{CellSums, Plane, STEPS_PER_CELL};
use super::cells_file::CellsReader;
use super::grid::PlacedCell;
use super::measures::{CellCounts, Lengths};
use super::mosaic::Mosaic;
use super::rasters::{RasterContent, RasterFrame, Rasters};
use wavex_engine::job::SurveyKeys;
use wavex_formats::Result;

/// Measurements of one strip.
#[derive(Clone, Debug)]
pub(super) struct StripMeasures {
    pub(super) pulses: CellCounts,
    pub(super) points: CellCounts,
    /// SD of the points from the plane of each smooth cell.
    pub(super) roughness: Lengths,
    /// Range of heights in each smooth cell less the part of the slope.
    pub(super) precision: Lengths,
}

/// Measurements of all strips together.
#[derive(Debug)]
pub(super) struct Measures {
    pub(super) strips: Vec<StripMeasures>,
    /// Differences of pairs of strips, later minus earlier.
    pub(super) pairs: BTreeMap<(usize, usize), Lengths>,
    pub(super) pulses: CellCounts,
    pub(super) points: CellCounts,
    /// Cells with points of two strips or more.
    pub(super) overlap_cells: u64,
    pub(super) mosaic: Mosaic,
    /// Written rasters.
    pub(super) rasters: Vec<std::path::PathBuf>,
}

/// Scale and limits of the cells.
pub(super) struct CellScale<'k> {
    pub(super) keys: &'k SurveyKeys,
    /// Level of all cells.
    pub(super) level: u8,
    /// Unit of horizontal coordinates in sums, m.
    pub(super) step_m: f64,
    /// Edge of a cell, m.
    pub(super) edge_m: f64,
}

impl<'k> CellScale<'k> {
    /// `cell_m` is the edge of a cell of level 0.
    pub(super) fn new(keys: &'k SurveyKeys, level: u8, cell_m: f64) -> CellScale<'k> {
        let edge_m = cell_m * f64::from(level).exp2();
        CellScale { keys, level, step_m: cell_m / STEPS_PER_CELL as f64, edge_m }
    }

    pub(super) fn area_m2(&self) -> f64 {
        self.edge_m * self.edge_m
    }

    /// Plane of a smooth cell.
    fn smooth(&self, sums: &CellSums) -> Option<Plane> {
        let keys = self.keys;
        let plane = (sums.n >= keys.min_points).then(|| sums.plane(self.step_m)).flatten()?;
        let is_flat = plane.steepness() <= libm::tan(keys.max_slope_deg.to_radians());
        (is_flat && plane.residual_sd_m <= keys.max_roughness_m).then_some(plane)
    }
}

/// Measures the strips; `stem` is the path of the rasters to write.
///
/// # Errors
/// If the cells of a strip are damaged, or a raster cannot be written.
pub(super) fn sweep(
    readers: &mut [CellsReader],
    scale: &CellScale,
    frame: &RasterFrame,
    stem: Option<&Path>,
) -> Result<Measures> {
    let empty = StripMeasures {
        pulses: CellCounts::default(),
        points: CellCounts::default(),
        roughness: Lengths::new(),
        precision: Lengths::new(),
    };
    let mut measures = Measures {
        strips: vec![empty; readers.len()],
        pairs: BTreeMap::new(),
        pulses: CellCounts::default(),
        points: CellCounts::default(),
        overlap_cells: 0,
        mosaic: Mosaic::new(frame.clone(), scale.area_m2()),
        rasters: Vec::new(),
    };
    let mut rasters = stem.map(|stem| Rasters::create(frame.clone(), stem)).transpose()?;
    let mut cells: Vec<(usize, PlacedCell)> = Vec::new();
    let mut of_strip = Vec::new();
    while let Some(row) = readers.iter().filter_map(|reader| reader.next_row(scale.level)).max() {
        cells.clear();
        for (strip, reader) in readers.iter_mut().enumerate() {
            reader.read_row(scale.level, row, &mut of_strip)?;
            cells.extend(of_strip.drain(..).map(|cell| (strip, cell)));
        }
        cells.sort_by_key(|(strip, cell)| (cell.column, *strip));
        if let Some(rasters) = &mut rasters {
            rasters.begin_row(row)?;
        }
        for of_cell in cells.chunk_by(|(_, a), (_, b)| a.column == b.column) {
            measures.add(of_cell, scale, rasters.as_mut());
        }
    }
    if let Some(rasters) = rasters {
        measures.rasters = rasters.finish()?;
    }
    Ok(measures)
}

impl Measures {
    /// Adds a cell with the sums of all strips that have points in it.
    fn add(&mut self, strips: &[(usize, PlacedCell)], scale: &CellScale, rasters: Option<&mut Rasters>) {
        let Some((_, PlacedCell { column, row, .. })) = strips.first() else { return };
        let (mut pulses, mut points) = (0u32, 0u32);
        let mut planes: Vec<(usize, Plane)> = Vec::new();
        for (strip, PlacedCell { sums, .. }) in strips {
            pulses = pulses.saturating_add(sums.pulses);
            points = points.saturating_add(sums.points);
            let plane = scale.smooth(sums);
            planes.extend(plane.map(|plane| (*strip, plane)));
            let Some(of_strip) = self.strips.get_mut(*strip) else { continue };
            of_strip.pulses.add(sums.pulses);
            of_strip.points.add(sums.points);
            if let Some(plane) = plane {
                of_strip.roughness.add(plane.residual_sd_m, 0.0);
                // Lidar Base Specification: range less slope times the diagonal of the cell.
                let by_slope_m = plane.steepness() * scale.edge_m * std::f64::consts::SQRT_2;
                of_strip.precision.add((plane.range_m - by_slope_m).max(0.0), 0.0);
            }
        }
        self.pulses.add(pulses);
        self.points.add(points);
        self.overlap_cells += u64::from(strips.len() > 1);
        let largest = self.compare(&planes);
        self.mosaic.add(*row, *column, pulses, strips.len() as u32, largest);
        if let Some(rasters) = rasters {
            let mut set = |layer, value| rasters.set(layer, *row, *column, value);
            set(RasterContent::Pulses, f64::from(pulses) / scale.area_m2());
            set(RasterContent::Points, f64::from(points) / scale.area_m2());
            set(RasterContent::Strips, strips.len() as f64);
            if let Some(largest) = largest {
                set(RasterContent::Difference, largest);
            }
            let roughness = planes.iter().map(|(_, plane)| plane.residual_sd_m).reduce(f64::max);
            if let Some(roughness) = roughness {
                set(RasterContent::Roughness, roughness);
            }
        }
    }

    /// Adds the differences of all pairs of planes; returns the one of the largest magnitude.
    ///
    /// Heights are compared in the middle between the centroids of both strips.
    fn compare(&mut self, planes: &[(usize, Plane)]) -> Option<f64> {
        let mut largest: Option<f64> = None;
        for (i, (earlier, a)) in planes.iter().enumerate() {
            for (later, b) in planes.iter().skip(i + 1) {
                let middle = [0, 1].map(|axis| 0.5 * (a.centre_m[axis] + b.centre_m[axis]));
                let ((low_m, low_m2), (high_m, high_m2)) = (a.at(middle), b.at(middle));
                let difference_m = high_m - low_m;
                let pair = self.pairs.entry((*earlier, *later)).or_insert_with(Lengths::new);
                pair.add(difference_m, low_m2 + high_m2);
                if largest.is_none_or(|largest| difference_m.abs() > largest.abs()) {
                    largest = Some(difference_m);
                }
            }
        }
        largest
    }
}

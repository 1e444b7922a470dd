//! Patches of smooth surface from the returns of a strip.

use std::collections::{BTreeMap, HashMap};

use nalgebra::{Matrix3, SymmetricEigen, Vector3};
use wavex_geodesy::ellipsoid::{Geodetic, WGS84};
use wavex_geodesy::frames::{LocalFrame, Rotation, Vector, inverse, rotate};
use wavex_simd::statistics::median;

use crate::scanner::{BeamSource, ScannerBeam};
use crate::vector::{cross, difference, dot, length, scaled, sum};

/// A local horizontal frame: east, north, up of an origin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Horizon {
    origin_in_ecef_m: Vector,
    local_from_ecef: Rotation,
}

impl Horizon {
    /// The frame at a position.
    pub fn at(place: Geodetic) -> Horizon {
        Horizon {
            origin_in_ecef_m: WGS84.ecef_of(place),
            local_from_ecef: inverse(LocalFrame::at(WGS84, place).ecef_from_local()),
        }
    }

    /// East, north, up of a position in the earth-centred frame, m.
    pub fn local_m(&self, ecef_m: Vector) -> Vector {
        rotate(&self.local_from_ecef, difference(ecef_m, self.origin_in_ecef_m))
    }

    /// Position in the earth-centred frame of east, north, up, m.
    fn ecef_m(&self, local_m: Vector) -> Vector {
        sum(self.ecef_direction(local_m), self.origin_in_ecef_m)
    }

    /// Direction in the earth-centred frame of components east, north, up.
    pub fn ecef_direction(&self, local: Vector) -> Vector {
        rotate(&inverse(&self.local_from_ecef), local)
    }

    /// Components east, north, up of a direction in the earth-centred frame.
    pub fn local_direction(&self, in_ecef: Vector) -> Vector {
        rotate(&self.local_from_ecef, in_ecef)
    }
}

/// Index of a tile of the earth: geocentric latitude and longitude in steps of [`TILE_RAD`].
type Tile = (i32, i32);

/// Edge of a tile: 28 km, so that the horizon of its centre is level to 3 mrad and true to 3 ppm.
const TILE_RAD: f64 = core::f64::consts::PI / 720.0;

/// Frame in which the cells of patches are.
#[derive(Debug)]
enum Frame {
    /// One horizon for all cells.
    One(Horizon),
    /// The horizon of the centre of each tile.
    Tiles(Tiles),
}

/// Horizons of tiles.
#[derive(Debug, Default)]
struct Tiles {
    horizons: BTreeMap<Tile, Horizon>,
    latest: Option<LatestTile>,
}

/// The tile used last, with its bounds.
#[derive(Clone, Copy, Debug)]
struct LatestTile {
    tile: Tile,
    horizon: Horizon,
    /// Tangents of its latitudes.
    latitude_tangents: [f64; 2],
    /// Sines and cosines of its longitudes.
    longitudes: [(f64, f64); 2],
}

impl LatestTile {
    /// Whether a position is in the tile; saves two arc tangents.
    fn contains(&self, [x, y, z]: Vector) -> bool {
        let from_axis = (x * x + y * y).sqrt();
        let [south, north] = self.latitude_tangents.map(|tangent| z - from_axis * tangent);
        let [west, east] = self.longitudes.map(|(sine, cosine)| y * cosine - x * sine);
        south >= 0.0 && north < 0.0 && west >= 0.0 && east < 0.0
    }
}

impl Frame {
    /// Tile of a position in the earth-centred frame.
    fn tile(&self, [x, y, z]: Vector) -> Tile {
        match self {
            Frame::One(_) => (0, 0),
            Frame::Tiles(Tiles { latest: Some(latest), .. }) if latest.contains([x, y, z]) => latest.tile,
            Frame::Tiles(_) => {
                let index = |angle_rad: f64| (angle_rad / TILE_RAD).floor() as i32;
                (index(libm::atan2(z, (x * x + y * y).sqrt())), index(libm::atan2(y, x)))
            }
        }
    }

    /// Horizon of the cells of a tile.
    fn horizon(&mut self, tile: Tile) -> Horizon {
        match self {
            Frame::One(horizon) => *horizon,
            Frame::Tiles(tiles) => match tiles.latest {
                Some(latest) if latest.tile == tile => latest.horizon,
                _ => {
                    let horizon = *tiles.horizons.entry(tile).or_insert_with(|| tile_horizon(tile));
                    let edges_rad = |index: i32| [index, index + 1].map(|edge| f64::from(edge) * TILE_RAD);
                    tiles.latest = Some(LatestTile {
                        tile,
                        horizon,
                        latitude_tangents: edges_rad(tile.0).map(libm::tan),
                        longitudes: edges_rad(tile.1).map(libm::sincos),
                    });
                    horizon
                }
            },
        }
    }
}

/// Horizon of the centre of a tile, on the ellipsoid.
fn tile_horizon((latitude, longitude): Tile) -> Horizon {
    let middle_rad = |index: i32| (f64::from(index) + 0.5) * TILE_RAD;
    let ((sine, cosine), (east, north)) =
        (libm::sincos(middle_rad(latitude)), libm::sincos(middle_rad(longitude)));
    let ecef_m = [cosine * north, cosine * east, sine].map(|part| part * 6_371_000.0);
    Horizon::at(Geodetic { height_m: 0.0, ..WGS84.geodetic_of(ecef_m) })
}

/// A return with its beam.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PatchReturn {
    /// Beam in the scanner frame, without corrections.
    pub beam: ScannerBeam,
    /// Origin of the beam in the scanner frame, and scale of its range.
    pub source: BeamSource,
    /// SD of the range, m.
    pub range_sd_m: f64,
    /// Number of returns of the shot.
    pub n_returns: u8,
    /// Position in the earth-centred frame, m.
    pub point_in_ecef_m: Vector,
    /// Unit direction of the beam in the earth-centred frame.
    pub direction_in_ecef: Vector,
}

/// A plane of a strip: three beams that end on it, and its uncertainty.
///
/// Times and directions are those of recorded beams; their ranges end on the plane that was fitted to all returns of
/// the cell. The beams therefore give the plane for any value of the parameters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Patch {
    /// Index of the strip.
    pub strip: u32,
    /// Number of returns.
    pub n_returns: u16,
    /// Origin of the beams, and scale of their ranges.
    pub source: BeamSource,
    /// Beams, anticlockwise as seen from above.
    pub beams: [ScannerBeam; 3],
    /// SD of the plane along its normal, at the mean of the ends of the beams, m.
    pub sd_m: f32,
    /// SD of the slope of the plane.
    pub slope_sd: f32,
    /// RMS distance of the returns from the plane beyond their range SDs, m.
    pub roughness_m: f32,
}

/// Sizes and thresholds of patches.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PatchSettings {
    /// Size of the cells, m; above 0.
    pub cell_m: f64,
    /// Fewest returns of a patch.
    pub least_returns: usize,
    /// Largest RMS distance from the plane, m.
    pub most_rms_m: f64,
    /// Largest part of returns from shots with several returns.
    pub most_multiple: f64,
    /// Steepest plane, rad.
    pub most_slope_rad: f64,
    /// A cell is complete after this time without a return, s.
    pub patience_s: f64,
    /// Most patches that are kept; of more, whole blocks of the ground are dropped, frequent slopes first.
    pub most_patches: usize,
}

impl Default for PatchSettings {
    fn default() -> PatchSettings {
        PatchSettings {
            cell_m: 3.0,
            least_returns: 8,
            most_rms_m: 0.05,
            most_multiple: 0.2,
            most_slope_rad: 1.2,
            patience_s: 2.0,
            most_patches: 60_000,
        }
    }
}

/// Numbers of cells and patches.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PatchCounts {
    /// Returns whose position or beam is not finite.
    pub unusable_returns: u64,
    /// Cells with too few returns.
    pub sparse: u64,
    /// Cells with many shots of several returns.
    pub multiple: u64,
    /// Cells that are not planar, or too steep.
    pub rough: u64,
    /// Patches that were dropped because there were too many.
    pub thinned: u64,
}

/// Most returns that a cell holds.
const MOST_RETURNS: usize = 200;
/// Cells are examined for completeness after this many returns.
const RETURNS_PER_SWEEP: u32 = 20_000;
/// Most cells in work; more are completed early.
const MOST_CELLS: usize = 200_000;
/// Edge of the blocks that are kept or dropped as a whole, in cells.
pub const BLOCK_CELLS: i64 = 8;
/// Distances above this many robust SDs are outliers of the plane.
const OUTLIER_SDS: f64 = 3.5;
/// Smallest cosine between beam and normal.
const LEAST_INCIDENCE: f64 = 0.2;
/// Classes of slope and aspect.
const SLOPE_CLASSES: usize = 9;

/// Makes patches from the returns of one strip in their order.
#[derive(Debug)]
pub struct PatchMaker {
    strip: u32,
    frame: Frame,
    settings: PatchSettings,
    cells: HashMap<CellKey, Cell>,
    latest_s: f64,
    since_sweep: u32,
    patches: Vec<Kept>,
    counts: PatchCounts,
}

/// Tile, column, row, and whether ranges are on the scale of the low-power receiver.
type CellKey = (Tile, i64, i64, bool);

#[derive(Debug, Default)]
struct Cell {
    returns: Vec<PatchReturn>,
    n_multiple: usize,
    latest_s: f64,
}

/// A patch with its rank in the order of keeping.
#[derive(Clone, Copy, Debug)]
struct Kept {
    patch: Patch,
    ends_in_ecef_m: [Vector; 3],
    class: usize,
    rank: u64,
}

impl PatchMaker {
    /// For the strip of this index; strips that are compared need the same horizon and cell size.
    pub fn new(strip: u32, horizon: Horizon, settings: PatchSettings) -> PatchMaker {
        PatchMaker::in_frame(strip, Frame::One(horizon), settings)
    }

    /// With cells that are the same for every strip of the earth, whatever the survey; its patches are of strip 0.
    pub fn on_tiles(settings: PatchSettings) -> PatchMaker {
        PatchMaker::in_frame(0, Frame::Tiles(Tiles::default()), settings)
    }

    fn in_frame(strip: u32, frame: Frame, settings: PatchSettings) -> PatchMaker {
        PatchMaker {
            strip,
            frame,
            settings,
            cells: HashMap::new(),
            latest_s: f64::NEG_INFINITY,
            since_sweep: 0,
            patches: Vec::new(),
            counts: PatchCounts::default(),
        }
    }

    /// Adds a return.
    pub fn add(&mut self, given: &PatchReturn) {
        let numbers = [given.beam.time_s, given.beam.range_m, given.range_sd_m].into_iter();
        let vectors = [given.beam.direction, given.point_in_ecef_m, given.direction_in_ecef];
        if !numbers.chain(vectors.into_iter().flatten()).all(f64::is_finite) {
            self.counts.unusable_returns += 1;
            return;
        }
        let tile = self.frame.tile(given.point_in_ecef_m);
        let [east_m, north_m, _] = self.frame.horizon(tile).local_m(given.point_in_ecef_m);
        let index = |along_m: f64| (along_m / self.settings.cell_m).floor() as i64;
        let key = (tile, index(east_m), index(north_m), given.source.on_low_power_scale);
        let cell = self.cells.entry(key).or_default();
        cell.n_multiple += usize::from(given.n_returns > 1);
        cell.latest_s = cell.latest_s.max(given.beam.time_s);
        if cell.returns.len() < MOST_RETURNS {
            cell.returns.push(*given);
        }
        self.latest_s = self.latest_s.max(given.beam.time_s);
        self.since_sweep += 1;
        if self.since_sweep >= RETURNS_PER_SWEEP {
            self.since_sweep = 0;
            let complete_s = if self.cells.len() > MOST_CELLS {
                f64::INFINITY
            } else {
                self.latest_s - self.settings.patience_s
            };
            let complete = self.cells.extract_if(|_, cell| cell.latest_s < complete_s).collect();
            self.complete_all(complete);
        }
    }

    /// Patches in the order of their times, and counts.
    pub fn finish(self) -> (Vec<Patch>, PatchCounts) {
        self.finish_with(|_, patch| Some(patch.beams))
    }

    /// The same with beams made of their ends in the earth-centred frame; a patch without beams is not kept.
    ///
    /// Only few returns become beams of a patch: this saves to convert the others.
    pub fn finish_with(
        mut self,
        mut beams_to: impl FnMut(&[Vector; 3], &Patch) -> Option<[ScannerBeam; 3]>,
    ) -> (Vec<Patch>, PatchCounts) {
        let cells = std::mem::take(&mut self.cells).into_iter().collect();
        self.complete_all(cells);
        self.thin(self.settings.most_patches);
        self.patches.sort_by(|a, b| a.patch.beams[0].time_s.total_cmp(&b.patch.beams[0].time_s));
        let patches = self.patches.iter().filter_map(|Kept { patch, ends_in_ecef_m, .. }| {
            Some(Patch { beams: beams_to(ends_in_ecef_m, patch)?, ..*patch })
        });
        (patches.collect(), self.counts)
    }

    /// Completes cells in the order of their places.
    fn complete_all(&mut self, mut cells: Vec<(CellKey, Cell)>) {
        cells.sort_unstable_by_key(|(key, _)| *key);
        for (key, cell) in cells {
            self.complete(key, &cell);
        }
    }

    fn complete(&mut self, key: CellKey, cell: &Cell) {
        let n = cell.returns.len();
        if n < self.settings.least_returns {
            self.counts.sparse += 1;
        } else if cell.n_multiple as f64 > self.settings.most_multiple * n as f64 {
            self.counts.multiple += 1;
        } else if let Some((mut patch, normal, ends_m)) =
            fit(&cell.returns, &self.frame.horizon(key.0), &self.settings)
        {
            patch.strip = self.strip;
            let horizon = self.frame.horizon(key.0);
            let ends_in_ecef_m = ends_m.map(|end_m| horizon.ecef_m(end_m));
            let block = (key.1.div_euclid(BLOCK_CELLS), key.2.div_euclid(BLOCK_CELLS));
            self.patches.push(Kept {
                patch,
                ends_in_ecef_m,
                class: slope_class(normal),
                rank: block_rank(block),
            });
            if self.patches.len() > 2 * self.settings.most_patches {
                self.thin(self.settings.most_patches);
            }
        } else {
            self.counts.rough += 1;
        }
    }

    /// Keeps at most this many patches: of each class, the blocks of lowest rank.
    ///
    /// Ranks depend on the place alone, so all strips keep the same places.
    fn thin(&mut self, most: usize) {
        let before = self.patches.len();
        if before <= most {
            return;
        }
        let mut counts = [0; SLOPE_CLASSES];
        for kept in &self.patches {
            counts[kept.class] += 1;
        }
        let quota = level(&counts, most);
        self.patches.sort_by_key(|kept| (kept.class, kept.rank));
        let mut taken = [0; SLOPE_CLASSES];
        self.patches.retain(|kept| {
            taken[kept.class] += 1;
            taken[kept.class] <= quota
        });
        self.counts.thinned += (before - self.patches.len()) as u64;
    }
}

/// Largest quota of each class for which all classes together have at most `most`.
pub(crate) fn level(counts: &[usize], most: usize) -> usize {
    let mut sorted = counts.to_vec();
    sorted.sort_unstable();
    let (mut left, mut classes) = (most, sorted.len());
    for count in sorted {
        if count * classes > left {
            return left / classes;
        }
        left -= count;
        classes -= 1;
    }
    usize::MAX
}

/// Class of slope and aspect: flat, and four aspects of gentle and steep slopes.
pub(crate) fn slope_class(normal: Vector) -> usize {
    let [east, north, up] = normal;
    let slope = east.hypot(north) / up.abs().max(1e-9);
    if slope < 0.1 {
        return 0;
    }
    let aspect = match (east.abs() > north.abs(), east > 0.0, north > 0.0) {
        (true, true, _) => 0,
        (true, false, _) => 1,
        (false, _, true) => 2,
        (false, _, false) => 3,
    };
    1 + aspect + if slope > 0.35 { 4 } else { 0 }
}

/// Pseudo-random rank of a block of the ground (finaliser of SplitMix64).
pub fn block_rank((x, y): (i64, i64)) -> u64 {
    let mut z =
        (x as u64).wrapping_mul(0x9E37_79B9_7F4A_7C15) ^ (y as u64).wrapping_mul(0xC2B2_AE3D_27D4_EB4F);
    z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    z ^ (z >> 31)
}

/// A plane through points: centre, axes and spread along them, and normal (upwards).
struct Plane {
    centre: Vector,
    normal: Vector,
    axes: [Vector; 2],
    variances: [f64; 2],
}

impl Plane {
    fn of(points: &[Vector]) -> Option<Plane> {
        let n = points.len() as f64;
        let centre = scaled(points.iter().fold([0.0; 3], |a, b| sum(a, *b)), 1.0 / n);
        let mut covariance = Matrix3::zeros();
        for point in points {
            let d = Vector3::from(difference(*point, centre));
            covariance += d * d.transpose() / n;
        }
        let eigen = SymmetricEigen::try_new(covariance, f64::EPSILON, 200)?;
        let mut order = [0, 1, 2];
        order.sort_by(|a, b| eigen.eigenvalues[*a].total_cmp(&eigen.eigenvalues[*b]));
        let axis = |k: usize| -> Vector { eigen.eigenvectors.column(order[k]).clone_owned().into() };
        let normal = axis(0);
        let normal = if normal[2] < 0.0 { scaled(normal, -1.0) } else { normal };
        let first = axis(2);
        Some(Plane {
            centre,
            normal,
            axes: [first, cross(normal, first)],
            variances: [eigen.eigenvalues[order[2]], eigen.eigenvalues[order[1]]],
        })
    }

    fn distance(&self, point: Vector) -> f64 {
        dot(self.normal, difference(point, self.centre))
    }
}

/// Patch of the returns of a cell, with its normal and the ends of its beams (east, north, up); `None` if they are not planar.
fn fit(
    returns: &[PatchReturn],
    horizon: &Horizon,
    settings: &PatchSettings,
) -> Option<(Patch, Vector, [Vector; 3])> {
    let mut used: Vec<(Vector, &PatchReturn)> =
        returns.iter().map(|given| (horizon.local_m(given.point_in_ecef_m), given)).collect();
    let points = |used: &[(Vector, &PatchReturn)]| used.iter().map(|(point, _)| *point).collect::<Vec<_>>();
    let plane = Plane::of(&points(&used))?;
    let distances: Vec<f64> = used.iter().map(|(point, _)| plane.distance(*point).abs()).collect();
    let limit_m = OUTLIER_SDS * 1.4826 * median(distances.iter().copied())?;
    let n_all = used.len();
    let mut at = distances.into_iter();
    used.retain(|_| at.next().is_some_and(|distance| distance <= limit_m));
    if used.len() < settings.least_returns || (used.len() as f64) < 0.9 * n_all as f64 {
        return None;
    }
    let plane = if used.len() < n_all { Plane::of(&points(&used))? } else { plane };
    let n = used.len() as f64;
    let squares: f64 = used.iter().map(|(point, _)| plane.distance(*point).powi(2)).sum();
    let rms_m = (squares / n).sqrt();
    let incidence = |given: &PatchReturn| dot(horizon.local_direction(given.direction_in_ecef), plane.normal);
    let noise: f64 =
        used.iter().map(|(_, given)| (given.range_sd_m * incidence(given)).powi(2)).sum::<f64>() / n;
    let is_planar = rms_m <= settings.most_rms_m
        && plane.normal[2] >= settings.most_slope_rad.cos()
        && plane.variances[1].sqrt() > 0.12 * settings.cell_m
        && n > 3.0;
    if !is_planar {
        return None;
    }
    // Few returns do not show their noise: the stated SDs count as a few more.
    let variance = (squares + PRIOR_RETURNS * noise) / (n - 3.0 + PRIOR_RETURNS);
    let (patch, ends_m) = place_beams(&used, &plane, horizon)?;
    let at = mean(&ends_m);
    let [along, across] = plane.axes.map(|axis| dot(axis, difference(at, plane.centre)));
    let [v_along, v_across] = plane.variances;
    let plane_variance = variance / n * (1.0 + along * along / v_along + across * across / v_across);
    let patch = Patch {
        n_returns: used.len().min(usize::from(u16::MAX)) as u16,
        sd_m: plane_variance.sqrt() as f32,
        slope_sd: (variance / n / v_across).sqrt() as f32,
        roughness_m: (rms_m * rms_m - noise).max(0.0).sqrt() as f32,
        ..patch
    };
    Some((patch, plane.normal, ends_m))
}

/// Weight of the stated range SDs in the noise of a patch, in returns.
const PRIOR_RETURNS: f64 = 6.0;

fn mean(ends: &[Vector; 3]) -> Vector {
    scaled(sum(sum(ends[0], ends[1]), ends[2]), 1.0 / 3.0)
}

/// Patch with three beams that end on the plane, and their ends.
fn place_beams(
    used: &[(Vector, &PatchReturn)],
    plane: &Plane,
    horizon: &Horizon,
) -> Option<(Patch, [Vector; 3])> {
    let radius_m = plane.variances.map(|variance| 1.2 * variance.sqrt());
    let mut chosen: Vec<usize> = Vec::with_capacity(3);
    for k in 0..3 {
        let angle = core::f64::consts::TAU * f64::from(k) / 3.0;
        let wanted = [angle.cos() * radius_m[0], angle.sin() * radius_m[1]];
        let miss = |point: Vector| -> f64 {
            (0..2).map(|j| (dot(plane.axes[j], difference(point, plane.centre)) - wanted[j]).powi(2)).sum()
        };
        let free = (0..used.len()).filter(|index| !chosen.contains(index));
        chosen.push(free.min_by(|a, b| miss(used[*a].0).total_cmp(&miss(used[*b].0)))?);
    }
    let mut patch = Patch {
        strip: 0,
        n_returns: 0,
        source: used[chosen[0]].1.source,
        beams: [ScannerBeam::default(); 3],
        sd_m: 0.0,
        slope_sd: 0.0,
        roughness_m: 0.0,
    };
    let mut ends = [[0.0; 3]; 3];
    for ((beam, end), index) in patch.beams.iter_mut().zip(&mut ends).zip(chosen) {
        let (point, given) = used[index];
        let direction = horizon.local_direction(given.direction_in_ecef);
        let incidence = dot(direction, plane.normal);
        if incidence.abs() < LEAST_INCIDENCE {
            return None;
        }
        let further_m = -plane.distance(point) / incidence;
        *beam = ScannerBeam { range_m: given.beam.range_m + further_m, ..given.beam };
        *end = sum(point, scaled(direction, further_m));
    }
    let area = cross(difference(ends[1], ends[0]), difference(ends[2], ends[0]));
    let least_area = 0.5 * radius_m[0] * radius_m[1];
    if length(area) < least_area {
        return None;
    }
    Some((patch, ends))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulated::{Normal, PLACE};

    const SPACING_M: f64 = 0.5;
    const ABOVE_M: f64 = 500.0;

    /// Returns of vertical beams on a grid of `edge` by `edge`; the time of a return is its number in 10 microseconds.
    fn returns(edge: usize, seed: u64, noise_m: f64, height: impl Fn(f64, f64) -> f64) -> Vec<PatchReturn> {
        let mut normal = Normal::new(seed);
        let frame = LocalFrame::at(WGS84, PLACE);
        let down = rotate(frame.ecef_from_local(), [0.0, 0.0, -1.0]);
        let made = (0..edge * edge).map(|k| {
            let [x, y] = place(edge, k);
            let z = height(x, y) + noise_m * normal.draw();
            PatchReturn {
                beam: ScannerBeam {
                    time_s: k as f64 * 1e-5,
                    direction: [0.0, 0.0, 1.0],
                    range_m: ABOVE_M - z,
                },
                source: BeamSource::default(),
                range_sd_m: noise_m,
                n_returns: 1,
                point_in_ecef_m: WGS84.ecef_of(frame.geodetic_of([x, y, z])),
                direction_in_ecef: down,
            }
        });
        made.collect()
    }

    fn place(edge: usize, k: usize) -> [f64; 2] {
        [(k % edge) as f64 * SPACING_M + 0.1, (k / edge) as f64 * SPACING_M + 0.1]
    }

    fn patches(returns: &[PatchReturn], settings: PatchSettings) -> (Vec<Patch>, PatchCounts) {
        let mut maker = PatchMaker::new(7, Horizon::at(PLACE), settings);
        returns.iter().for_each(|given| maker.add(given));
        maker.finish()
    }

    #[test]
    fn beams_end_on_the_plane() {
        let plane = |x: f64, y: f64| 3.0 + 0.3 * x - 0.2 * y;
        let (found, counts) = patches(&returns(24, 1, 0.01, plane), PatchSettings::default());
        assert_eq!((found.len(), counts), (16, PatchCounts::default()));
        let mut squares = 0.0;
        for patch in &found {
            assert!(patch.strip == 7 && (33..=36).contains(&patch.n_returns), "{patch:?}");
            let ends = patch.beams.map(|beam| {
                let [x, y] = place(24, (beam.time_s / 1e-5).round() as usize);
                [x, y, ABOVE_M - beam.range_m]
            });
            let area = cross(difference(ends[1], ends[0]), difference(ends[2], ends[0]));
            assert!(area[2] > 1.0, "anticlockwise: {area:?}");
            let mean = ends.iter().map(|[x, y, z]| z - plane(*x, *y)).sum::<f64>() / 3.0;
            // Errors of vertical beams along the normal.
            let error = mean / (1.0f64 + 0.3 * 0.3 + 0.2 * 0.2).sqrt();
            squares += (error / f64::from(patch.sd_m)).powi(2);
            assert!((0.001..0.0025).contains(&patch.sd_m), "{}", patch.sd_m);
            assert!(patch.roughness_m < 0.006 && patch.slope_sd < 0.004, "{patch:?}");
        }
        let ratio = (squares / 16.0).sqrt();
        assert!((0.6..1.5).contains(&ratio), "errors over SDs: {ratio}");
    }

    #[test]
    fn unsuitable_cells_are_rejected() {
        let of = |returns: &[PatchReturn]| patches(returns, PatchSettings::default());
        let mut normal = Normal::new(3);
        let noise: Vec<f64> = (0..10_000).map(|_| 0.3 * normal.draw()).collect();
        let rough = returns(24, 1, 0.01, |x, y| noise[(x * 60.0 + y * 1000.0) as usize % 10_000]);
        assert_eq!((of(&rough).0.len(), of(&rough).1.rough), (0, 16));
        let kerb = returns(24, 1, 0.01, |x, _| if x % 3.0 < 1.5 { 0.0 } else { 0.4 });
        assert_eq!((of(&kerb).0.len(), of(&kerb).1.rough), (0, 16));
        let wall = returns(24, 1, 0.01, |x, _| 4.0 * x);
        assert_eq!((of(&wall).0.len(), of(&wall).1.rough), (0, 16));
        let mut trees = returns(24, 1, 0.01, |_, _| 0.0);
        trees.iter_mut().step_by(3).for_each(|given| given.n_returns = 3);
        assert_eq!((of(&trees).0.len(), of(&trees).1.multiple), (0, 16));
        let few: Vec<_> = returns(24, 1, 0.01, |_, _| 0.0).into_iter().step_by(7).collect();
        assert_eq!((of(&few).0.len(), of(&few).1.sparse), (0, 16));
        let mut unusable = returns(24, 1, 0.01, |_, _| 0.0);
        unusable[5].beam.range_m = f64::NAN;
        unusable[6].point_in_ecef_m[1] = f64::INFINITY;
        assert_eq!((of(&unusable).0.len(), of(&unusable).1.unusable_returns), (16, 2));
    }

    /// One car in a cell of a road is an outlier, not the end of the patch.
    #[test]
    fn few_outliers_are_left_out() {
        let road = returns(24, 1, 0.01, |x, y| if x < 1.0 && y < 0.5 { 1.5 } else { 0.0 });
        let (found, _) = patches(&road, PatchSettings::default());
        assert_eq!(found.len(), 16);
        assert_eq!(found.iter().filter(|patch| patch.n_returns == 34).count(), 1);
    }

    #[test]
    fn receivers_have_patches_of_their_own() {
        let mut both = returns(24, 1, 0.01, |_, _| 0.0);
        both.iter_mut().step_by(2).for_each(|given| given.source.on_low_power_scale = true);
        let (found, _) = patches(&both, PatchSettings::default());
        let low = found.iter().filter(|patch| patch.source.on_low_power_scale).count();
        assert_eq!((found.len(), low), (32, 16));
    }

    /// Strips that are thinned keep the same places, and rare slopes before frequent ones.
    #[test]
    fn strips_are_thinned_alike() {
        // A plain with a slope in its last eighth.
        let height = |_: f64, y: f64| 0.3 * (y - 84.0).max(0.0);
        let settings = PatchSettings { most_patches: 300, ..PatchSettings::default() };
        let kept = |seed| {
            let (found, counts) = patches(&returns(192, seed, 0.01, height), settings);
            assert!(found.len() <= 300 && counts.thinned > 500, "{} {counts:?}", found.len());
            let mut cells: Vec<_> = found
                .iter()
                .map(|patch| {
                    let [x, y] = place(192, (patch.beams[0].time_s / 1e-5).round() as usize);
                    ((x / 3.0) as i64, (y / 3.0) as i64)
                })
                .collect();
            cells.sort_unstable();
            cells
        };
        let (first, second) = (kept(1), kept(2));
        let shared = first.iter().filter(|cell| second.contains(cell)).count();
        assert!(shared * 10 >= first.len() * 9, "{shared} of {}", first.len());
        let steep = first.iter().filter(|(_, y)| *y >= 28).count();
        assert!(steep > 100, "{steep} of {}", first.len());
    }

    /// Cells are completed while the strip is read.
    #[test]
    fn memory_is_bounded_by_the_cells_in_work() {
        let settings = PatchSettings { patience_s: 0.02, ..PatchSettings::default() };
        let mut maker = PatchMaker::new(0, Horizon::at(PLACE), settings);
        let all = returns(300, 1, 0.01, |_, _| 0.0);
        let mut most_cells = 0;
        for given in &all {
            maker.add(given);
            most_cells = most_cells.max(maker.cells.len());
        }
        assert!(most_cells < 1700, "{most_cells} of 2500 cells");
        assert_eq!(maker.finish().0.len(), 2500);
    }

    /// Strips that do not know each other have the same cells: those of any horizon on another one would be cut.
    #[test]
    fn cells_of_tiles_do_not_depend_on_the_strip() {
        let all = returns(192, 1, 0.01, |_, _| 0.0);
        let made = |given: &[PatchReturn]| {
            let mut maker =
                PatchMaker::on_tiles(PatchSettings { most_patches: 300, ..PatchSettings::default() });
            given.iter().for_each(|given| maker.add(given));
            maker.finish().0
        };
        // The second strip begins 30 m to the north of the first.
        let (first, second) = (made(&all), made(&all[60 * 192..]));
        assert!(first.len() > 200 && second.len() > 200, "{} {}", first.len(), second.len());
        let inside: Vec<&Patch> = first.iter().filter(|patch| patch.beams[0].time_s > 0.13).collect();
        let shared = inside.iter().filter(|patch| second.contains(patch)).count();
        assert!(shared == inside.len() && shared > 100, "{shared} of {}", inside.len());
        let corner_m = tile_horizon((0, 0)).local_m([6_378_137.0, 0.0, 0.0]);
        assert!((19_000.0..20_000.0).contains(&corner_m[0].hypot(corner_m[1])), "{corner_m:?}");
        let tiles: Vec<Tile> = [[1.0, 1.0], [1.0, -1.0], [-1.0, 1.0], [-1.0, -1.0]]
            .map(|[y, z]| Frame::Tiles(Tiles::default()).tile([6_378_137.0, y, z]))
            .to_vec();
        assert_eq!(tiles, [(0, 0), (-1, 0), (0, -1), (-1, -1)]);
    }

    #[test]
    fn quotas_fill_the_limit() {
        assert_eq!(level(&[10, 20, 30], 60), usize::MAX);
        assert_eq!(level(&[10, 20, 30], 50), 20);
        assert_eq!(level(&[10, 20, 30], 30), 10);
        assert_eq!(level(&[1, 1000, 1000], 101), 50);
        assert_eq!(level(&[], 5), usize::MAX);
    }
}

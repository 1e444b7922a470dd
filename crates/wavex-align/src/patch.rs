//! Patches of smooth surface from the returns of a strip.

use std::cmp::Ordering;
use std::collections::HashMap;

use wavex_geodesy::frames::Vector;

use crate::scanner::{BeamSource, ScannerBeam};
use fit::fit;
use frame::{Frame, Tile, Tiles};

pub use budget::{LEAST_OF_STRIP, MOST_TOGETHER, PatchBudget};
pub use frame::Horizon;

mod budget;
mod fit;
mod frame;

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
    /// Number of returns that give the plane, of a cell with many a part of them.
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
    /// Most patches that are kept; of more, blocks of the ground are dropped, frequent slopes first.
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

/// Most returns that a cell holds: of more, every second one is kept, then every fourth, and so on.
const MOST_RETURNS: usize = 64;
/// Cells are examined for completeness after this many returns.
const RETURNS_PER_SWEEP: u32 = 20_000;
/// Most cells in work; more are completed early.
const MOST_CELLS: usize = 200_000;
/// Most cells in work for which memory of completed cells is used again: it has room for [`MOST_RETURNS`].
const MOST_CELLS_WITH_ROOM: usize = 10_000;
/// Edge of the blocks that are kept or dropped as a whole, in cells.
pub const BLOCK_CELLS: i64 = 8;
/// Classes of slope and aspect.
const SLOPE_CLASSES: usize = 9;

/// Makes patches from the returns of one strip in their order.
#[derive(Debug)]
pub struct PatchMaker {
    strip: u32,
    frame: Frame,
    settings: PatchSettings,
    cells: HashMap<CellKey, Cell>,
    /// The cell of the latest return, taken out of the others: neighbouring returns are mostly of one cell.
    open: Option<(CellKey, Cell)>,
    /// Memory of completed cells.
    emptied: Vec<Vec<CellReturn>>,
    latest_s: f64,
    since_sweep: u32,
    patches: Vec<Kept>,
    /// Most patches of a class so far.
    quota: usize,
    counts: PatchCounts,
}

/// Tile, column, row, and whether ranges are on the scale of the low-power receiver.
type CellKey = (Tile, i64, i64, bool);

#[derive(Debug, Default)]
struct Cell {
    /// Every `2^halvings`-th return.
    returns: Vec<CellReturn>,
    halvings: u32,
    n_returns: u64,
    n_multiple: u64,
    latest_s: f64,
}

/// A return in the horizon of its cell.
#[derive(Clone, Copy, Debug)]
struct CellReturn {
    beam: ScannerBeam,
    source: BeamSource,
    range_sd_m: f64,
    /// East, north, up, m.
    point_m: Vector,
    /// Components east, north, up of the direction of the beam.
    direction: Vector,
}

impl Cell {
    /// Whether the next return is kept.
    fn keeps_next(&self) -> bool {
        self.n_returns.is_multiple_of(1 << self.halvings)
    }

    fn keep(&mut self, kept: CellReturn) {
        if self.returns.len() == MOST_RETURNS {
            self.halvings += 1;
            let mut place = 0;
            self.returns.retain(|_| {
                place += 1;
                place % 2 == 1
            });
        }
        self.returns.push(kept);
    }
}

/// A patch with its rank in the order of keeping.
#[derive(Clone, Copy, Debug)]
struct Kept {
    patch: Patch,
    ends_in_ecef_m: [Vector; 3],
    class: usize,
    rank: u64,
}

impl Kept {
    /// Order within the classes, by content alone.
    fn order(&self, other: &Kept) -> Ordering {
        let key = |kept: &Kept| (kept.class, kept.rank, kept.patch.source.on_low_power_scale);
        let beams = self.patch.beams.iter().zip(&other.patch.beams);
        let of_times = beams.map(|(a, b)| a.time_s.total_cmp(&b.time_s));
        let of_sds = self.patch.sd_m.total_cmp(&other.patch.sd_m);
        of_times.chain([of_sds]).fold(key(self).cmp(&key(other)), Ordering::then)
    }
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
            open: None,
            emptied: Vec::new(),
            latest_s: f64::NEG_INFINITY,
            since_sweep: 0,
            patches: Vec::new(),
            quota: usize::MAX,
            counts: PatchCounts::default(),
        }
    }

    /// Adds a return.
    pub fn add(&mut self, given: &PatchReturn) {
        let numbers = [given.beam.time_s, given.beam.range_m, given.range_sd_m];
        let vectors = [given.beam.direction, given.point_in_ecef_m, given.direction_in_ecef];
        let is_finite = |vector: &Vector| vector.iter().all(|part| part.is_finite());
        if !(is_finite(&numbers) && vectors.iter().all(is_finite)) {
            self.counts.unusable_returns += 1;
            return;
        }
        let tile = self.frame.tile(given.point_in_ecef_m);
        let horizon = self.frame.horizon(tile);
        let point_m = horizon.local_m(given.point_in_ecef_m);
        let index = |along_m: f64| (along_m / self.settings.cell_m).floor() as i64;
        let key = (tile, index(point_m[0]), index(point_m[1]), given.source.on_low_power_scale);
        if self.open.as_ref().is_none_or(|(open, _)| *open != key) {
            self.close();
        }
        let (_, cell) = self.open.get_or_insert_with(|| {
            let new = || Cell { returns: self.emptied.pop().unwrap_or_default(), ..Cell::default() };
            (key, self.cells.remove(&key).unwrap_or_else(new))
        });
        if cell.keeps_next() {
            let PatchReturn { beam, source, range_sd_m, .. } = *given;
            let direction = horizon.local_direction(given.direction_in_ecef);
            cell.keep(CellReturn { beam, source, range_sd_m, point_m, direction });
        }
        cell.n_returns += 1;
        cell.n_multiple += u64::from(given.n_returns > 1);
        cell.latest_s = cell.latest_s.max(given.beam.time_s);
        self.latest_s = self.latest_s.max(given.beam.time_s);
        self.since_sweep += 1;
        if self.since_sweep >= RETURNS_PER_SWEEP {
            self.since_sweep = 0;
            self.close();
            let complete_s = if self.cells.len() > MOST_CELLS {
                f64::INFINITY
            } else {
                self.latest_s - self.settings.patience_s
            };
            let complete = self.cells.extract_if(|_, cell| cell.latest_s < complete_s).collect();
            self.complete_all(complete);
        }
    }

    /// Puts the open cell back.
    fn close(&mut self) {
        if let Some((key, cell)) = self.open.take() {
            self.cells.insert(key, cell);
        }
    }

    /// Patches in the order of keeping, and counts.
    ///
    /// Any first patches are those that a lower limit keeps: of each class, the blocks of lowest rank.
    pub fn finish(self) -> (Vec<Patch>, PatchCounts) {
        self.finish_with(|_, patch| Some(patch.beams))
    }

    /// The same with beams made of their ends in the earth-centred frame; a patch without beams is not kept.
    ///
    /// Only few returns become beams of a patch: this saves to convert the others. `beams_to` gets patches in the order of
    /// their times.
    pub fn finish_with(
        mut self,
        mut beams_to: impl FnMut(&[Vector; 3], &Patch) -> Option<[ScannerBeam; 3]>,
    ) -> (Vec<Patch>, PatchCounts) {
        self.close();
        let cells = std::mem::take(&mut self.cells).into_iter().collect();
        self.complete_all(cells);
        let places = self.thin(self.settings.most_patches);
        let mut patches: Vec<((usize, usize), Kept)> = places.into_iter().zip(self.patches).collect();
        patches.sort_by(|(_, a), (_, b)| a.patch.beams[0].time_s.total_cmp(&b.patch.beams[0].time_s));
        let of_patch = |(place, Kept { patch, ends_in_ecef_m, .. }): ((usize, usize), Kept)| {
            Some((place, Patch { beams: beams_to(&ends_in_ecef_m, &patch)?, ..patch }))
        };
        let mut patches: Vec<((usize, usize), Patch)> = patches.into_iter().filter_map(of_patch).collect();
        patches.sort_unstable_by_key(|(place, _)| *place);
        (patches.into_iter().map(|(_, patch)| patch).collect(), self.counts)
    }

    /// Completes cells in the order of their places.
    fn complete_all(&mut self, mut cells: Vec<(CellKey, Cell)>) {
        cells.sort_unstable_by_key(|(key, _)| *key);
        let room = MOST_CELLS_WITH_ROOM.saturating_sub(self.cells.len());
        for (key, mut cell) in cells {
            self.complete(key, &cell);
            if self.emptied.len() < room {
                cell.returns.clear();
                self.emptied.push(cell.returns);
            }
        }
        self.emptied.truncate(room);
    }

    fn complete(&mut self, key: CellKey, cell: &Cell) {
        let n = cell.returns.len();
        if n < self.settings.least_returns {
            self.counts.sparse += 1;
        } else if cell.n_multiple as f64 > self.settings.most_multiple * cell.n_returns as f64 {
            self.counts.multiple += 1;
        } else if let Some((mut patch, normal, ends_m)) = fit(&cell.returns, &self.settings) {
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

    /// Keeps at most this many patches: of each class, the blocks of lowest rank. Returns the place of each in its class, and
    /// the class.
    ///
    /// Ranks depend on the place alone, so all strips keep the same places. Quotas only fall, so the result is the same
    /// whether patches are thinned once or often.
    fn thin(&mut self, most: usize) -> Vec<(usize, usize)> {
        let before = self.patches.len();
        let mut counts = [0; SLOPE_CLASSES];
        for kept in &self.patches {
            counts[kept.class] += 1;
        }
        self.quota = self.quota.min(level(&counts, most));
        self.patches.sort_by(Kept::order);
        let mut taken = [0; SLOPE_CLASSES];
        let mut places = Vec::with_capacity(before.min(most));
        self.patches.retain(|kept| {
            let place = taken[kept.class];
            taken[kept.class] += 1;
            if place < self.quota {
                places.push((place, kept.class));
            }
            place < self.quota
        });
        self.counts.thinned += (before - self.patches.len()) as u64;
        places
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

#[cfg(test)]
mod tests;

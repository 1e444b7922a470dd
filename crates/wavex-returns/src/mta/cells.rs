//! Cells of neighbouring echoes: phase of their surface and smoothness of each zone.
//!
//! A band is a few lines, divided into cells across the line. All echoes of one surface share one
//! *phase*, their range modulo the pulse interval, however the zones change within it. The phase is
//! therefore found first, and zones are counted from it. Each cell then has one unknown: the zone
//! of its surface.

use super::held::{Held, HeldEcho};
use super::pulses::CELL_SHOTS;
use super::{Prior, Settings};

/// Number of scan lines in a band.
pub const BAND_LINES: usize = 8;
/// Number of phase bins per interval, and number of bins that form the surface.
const BINS: usize = 32;
const SURFACE_BINS: usize = 8;
/// Fewest echoes from which the phase of a cell is estimated, if [`LEAST_PART`] of them are at the
/// surface.
const LEAST_ECHOES: u16 = 8;
/// The same in a band without a cell of [`LEAST_ECHOES`].
const FEWEST_ECHOES: u16 = 3;
const LEAST_PART: f32 = 0.55;
/// Scale of the Laplace distribution of range differences between neighbours, and its cap, m.
const SCALE_M: f32 = 0.5;
const CAP_M: f32 = 5.0;
/// Weight of the evidence of one pair: pairs of neighbours share echoes.
const PAIR_PART: f32 = 0.25;
/// Weight of a second difference relative to a first difference.
const CURVATURE_PART: f32 = 1.0;
/// Most neighbours of an echo in its line and the next.
const NEIGHBOURS: [usize; 2] = [4, 5];
/// Largest distance of neighbours in the own line and in the next, columns.
const REACH: [i32; 2] = [2, 1];
/// Number of cells without phase over which a slope is extrapolated.
const EXTENDED_CELLS: f32 = 3.0;
/// Largest distance from the phase of echoes that determine the slope, in intervals.
const SLOPE_PART: f32 = 0.25;
/// Minimum advantage of the surface of an adjacent cell, m.
const BESIDE_M: f32 = 5.0;
/// Zones are processed in groups of this size.
pub(super) const LANES: usize = 8;
/// Largest number of zones.
pub(super) const MOST_ZONES: usize = 126;
/// Cap of the cost of a height above ground, nats. Its error is common to many cells, so each cell
/// counts [`AGL_PART`] of it.
const AGL_CAP_NATS: f32 = 8.0;
const AGL_PART: f32 = 1.0 / 16.0;
/// Cap of the cost of an expected range, nats.
const EXPECTED_CAP_NATS: f32 = 24.0;
/// Cost of a range outside the feasible interval, nats per metre.
const INFEASIBLE_NATS_PER_M: f32 = 0.5;

/// State of a cell.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Cell {
    /// Number of echoes used.
    pub count: u16,
    /// Whether the cell's own echoes determine the phase.
    pub known: bool,
    /// Range of the surface in zone 0, mid-cell, m.
    pub phase_m: f32,
    /// Slope of the surface's range, m per column.
    pub slope_m: f32,
    /// Sum and number of the expected ranges, m.
    prior: (f32, u16),
    /// Range of the surface at the middle of the cell, m, once decided.
    pub surface_m: f32,
    /// Evidence for the decided zone over any other, nats.
    pub margin_nats: f32,
}

impl Cell {
    /// Whether the cell has echoes but no surface.
    pub(crate) fn is_clutter(&self) -> bool {
        !self.known && self.count >= LEAST_ECHOES
    }
}

/// Least-squares line through points of a cell.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Slope {
    count: f32,
    x: f32,
    y: f32,
    xx: f32,
    xy: f32,
}

impl Slope {
    /// Adds a point `x` columns from the cell's middle.
    pub fn add(&mut self, x: f32, y_m: f32) {
        self.count += 1.0;
        self.x += x;
        self.y += y_m;
        self.xx += x * x;
        self.xy += x * y_m;
    }

    /// Value of the line in the middle, and its slope; `None` for fewer than four points.
    pub fn fit(&self) -> Option<(f32, f32)> {
        if self.count < 4.0 {
            return None;
        }
        let (x, y) = (self.x / self.count, self.y / self.count);
        // Two virtual points at the ends, on a level, regularise the slope: a few points in a few
        // columns do not determine it.
        let spread = self.xx - self.count * x * x + (CELL_SHOTS * CELL_SHOTS) as f32 * 0.5;
        let slope = (self.xy - self.count * x * y) / spread;
        Some((y - slope * x, slope))
    }
}

/// A group of lines, divided into cells.
#[derive(Debug, Default)]
pub(super) struct Band {
    /// Number of the first cell: cell `i` holds the columns from `(first + i) * CELL_SHOTS`.
    pub first: i32,
    pub cells: Vec<Cell>,
    /// Mean pulse interval of the lines, m.
    pub interval_m: f32,
    /// Number of zones considered, from 0.
    pub zones: usize,
    /// Roughness by cell and zone, nats; `stride` entries per cell, the largest zone first.
    rough: Vec<f32>,
    stride: usize,
    /// The last cell is adjacent to the first.
    pub is_ring: bool,
}

/// Number of the cell that contains a column.
pub(super) fn cell_of(column: i32) -> i32 {
    column.div_euclid(CELL_SHOTS)
}

impl Band {
    /// Builds the band of `lines`; counts the zones of their echoes from the cells' phases.
    pub fn new(lines: &mut [Held], settings: &Settings) -> Band {
        let columns = || lines.iter().flat_map(|line| &line.pulses.column[line.pulses.lead..]);
        let (Some(&least), Some(&most)) = (columns().min(), columns().max()) else {
            return Band { interval_m: 1.0, zones: 1, ..Band::default() };
        };
        let own = lines.iter().filter(|line| line.pulses.own() > 0);
        let sum: (f64, f64) =
            own.fold((0.0, 0.0), |sum, line| (sum.0 + f64::from(line.pulses.interval_m), sum.1 + 1.0));
        let interval_m = (sum.0 / sum.1) as f32;
        let zones =
            ((settings.range_m[1] as f32 / interval_m).ceil() + 1.0).clamp(2.0, MOST_ZONES as f32) as usize;
        let stride = zones.next_multiple_of(LANES);
        let ring = lines.iter().map(|line| line.ring).max().unwrap_or(0);
        let (first, last) = if ring > 0 { (0, cell_of(ring) - 1) } else { (cell_of(least), cell_of(most)) };
        let count = (last - first) as usize + 1;
        let mut band = Band {
            first,
            cells: vec![Cell::default(); count],
            interval_m,
            zones,
            rough: vec![0.0; count * stride],
            stride,
            is_ring: ring > 0,
        };
        band.find_phases(lines);
        band.find_slopes(lines);
        band.add_priors(lines);
        band.count_from_phases(lines);
        band
    }

    /// Index of the cell that contains a column, or of the nearest cell.
    ///
    /// The band must have cells.
    pub fn index(&self, column: i32) -> usize {
        (cell_of(column) - self.first).clamp(0, self.cells.len() as i32 - 1) as usize
    }

    /// Distance of a range from the surface of a cell, m.
    pub fn apart_m(&self, index: usize, column: i32, range_m: f32) -> f32 {
        let cell = &self.cells[index];
        (range_m - cell.surface_m - cell.slope_m * self.off_middle(index, column)).abs()
    }

    /// Cell at a column, or adjacent, whose surface is nearest to a range, and the distance, m.
    pub fn nearest(&self, column: i32, range_m: f32) -> (&Cell, f32) {
        let index = self.index(column);
        let mut found = (index, self.apart_m(index, column, range_m));
        let count = self.cells.len();
        let before = index.checked_sub(1).or(self.is_ring.then_some(count - 1));
        let after = if index + 1 < count { Some(index + 1) } else { self.is_ring.then_some(0) };
        for other in before.into_iter().chain(after) {
            let apart_m = self.apart_m(other, column, range_m) + BESIDE_M;
            if apart_m < found.1 {
                found = (other, apart_m);
            }
        }
        (&self.cells[found.0], found.1)
    }

    fn find_phases(&mut self, lines: &[Held]) {
        let mut bins = vec![[(0u16, 0f32); BINS]; self.cells.len()];
        for line in lines {
            let interval_m = line.pulses.interval_m;
            let inside = inside_from(line, self.zones);
            for echo in line.echoes.iter().filter(|echo| echo.last >= inside) {
                let bin = (echo.range_m / interval_m * BINS as f32).clamp(0.0, BINS as f32 - 1.0) as usize;
                let bin = &mut bins[self.index(line.column(echo))][bin];
                bin.0 = bin.0.saturating_add(1);
                bin.1 += echo.range_m;
            }
        }
        for (cell, bins) in self.cells.iter_mut().zip(&bins) {
            find_phase(cell, bins, self.interval_m);
        }
        let has = |cell: &Cell, least: u16| cell.known && cell.count >= least;
        let least = match self.cells.iter().any(|cell| has(cell, LEAST_ECHOES)) {
            true => LEAST_ECHOES,
            false => FEWEST_ECHOES,
        };
        self.cells.iter_mut().for_each(|cell| cell.known = has(cell, least));
    }

    /// Distance of a column from the middle of a cell, columns.
    pub(crate) fn off_middle(&self, index: usize, column: i32) -> f32 {
        let middle = (self.first + index as i32) * CELL_SHOTS;
        (column - middle) as f32 - 0.5 * (CELL_SHOTS - 1) as f32
    }

    /// Fits the slopes of the cells with a phase, from the echoes near it.
    fn find_slopes(&mut self, lines: &[Held]) {
        let mut slopes = vec![Slope::default(); self.cells.len()];
        for line in lines {
            let interval_m = line.pulses.interval_m;
            let inside = inside_from(line, self.zones);
            for echo in line.echoes.iter().filter(|echo| echo.last >= inside) {
                let column = line.column(echo);
                let index = self.index(column);
                let apart = echo.range_m - self.cells[index].phase_m;
                let apart = apart - (apart / interval_m).round() * interval_m;
                if apart.abs() < SLOPE_PART * interval_m {
                    slopes[index].add(self.off_middle(index, column), apart);
                }
            }
        }
        for (cell, slope) in self.cells.iter_mut().zip(&slopes).filter(|(cell, _)| cell.known) {
            if let Some((middle_m, slope_m)) = slope.fit() {
                cell.phase_m = (cell.phase_m + middle_m).rem_euclid(self.interval_m);
                cell.slope_m = slope_m;
            }
        }
    }

    /// Counts the zones of all echoes from the phase of their cell, or of the nearest cell with
    /// one.
    fn count_from_phases(&mut self, lines: &mut [Held]) {
        fill(&mut self.cells, self.is_ring);
        for line in lines {
            let interval_m = line.pulses.interval_m;
            for i in 0..line.echoes.len() {
                let column = line.column(&line.echoes[i]);
                let index = self.index(column);
                let cell = &self.cells[index];
                let at_m = cell.phase_m + cell.slope_m * self.off_middle(index, column);
                let apart = line.echoes[i].range_m - at_m;
                let by = (apart / interval_m).round().clamp(-2.0, 2.0);
                if by != 0.0 {
                    line.echoes[i].count_from(by as i32, interval_m);
                }
            }
        }
    }

    /// Whether any cell has a phase from its own echoes.
    pub fn is_known(&self) -> bool {
        self.cells.iter().any(|cell| cell.known)
    }

    /// Expected range of a cell, m.
    pub fn prior_m(&self, index: usize) -> Option<f32> {
        let (sum, count) = self.cells[index].prior;
        (count > 0).then(|| sum / f32::from(count))
    }

    fn add_priors(&mut self, lines: &[Held]) {
        for line in lines.iter() {
            let own = line.pulses.column.iter().zip(&line.pulses.expected_m).skip(line.pulses.lead);
            for (&column, &range_m) in own.filter(|(_, range_m)| range_m.is_finite()) {
                let index = self.index(column);
                let prior = &mut self.cells[index].prior;
                (prior.0, prior.1) = (prior.0 + range_m, prior.1.saturating_add(1));
            }
        }
    }

    /// Adds the evidence of neighbours within a line.
    pub fn add_line(&mut self, line: &Held) {
        let inside = inside_from(line, self.zones);
        for (i, echo) in line.echoes.iter().enumerate().filter(|(_, echo)| echo.last >= inside) {
            let column = line.column(echo);
            let cell = self.index(column);
            let near =
                line.echoes[i + 1..].iter().take_while(|other| line.column(other) <= column + REACH[0]);
            let near = near.filter(|other| other.last != echo.last && other.last >= inside);
            for other in near.take(NEIGHBOURS[0]) {
                self.add_pair(cell, (line, echo), (line, other));
            }
        }
    }

    /// Adds the evidence of neighbours between `line`, a line of this band, and the following line.
    pub(crate) fn add_next(&mut self, line: &Held, next: &Held) {
        let mut from = 0;
        let (inside, next_inside) = (inside_from(line, self.zones), inside_from(next, self.zones));
        for echo in line.echoes.iter().filter(|echo| echo.last >= inside) {
            let column = line.column(echo);
            while next.echoes.get(from).is_some_and(|other| next.column(other) < column - REACH[1]) {
                from += 1;
            }
            let cell = self.index(column);
            let near = next.echoes[from..].iter().take_while(|other| next.column(other) <= column + REACH[1]);
            for other in near.filter(|other| other.last >= next_inside).take(NEIGHBOURS[1]) {
                self.add_pair(cell, (line, echo), (next, other));
            }
        }
    }

    /// Adds the evidence of the last echoes of three neighbouring shots: their curvature is
    /// independent of slope.
    pub(crate) fn add_curvature(&mut self, line: &Held) {
        let ends = |pair: &[HeldEcho]| pair.len() == 1 || pair[0].last != pair[1].last;
        let inside = inside_from(line, self.zones);
        let mut shots = (0..line.echoes.len())
            .filter(|&i| ends(&line.echoes[i..(i + 2).min(line.echoes.len())]))
            .map(|i| &line.echoes[i])
            .filter(|echo| echo.last >= inside);
        let (Some(mut before), Some(mut echo)) = (shots.next(), shots.next()) else { return };
        for after in shots {
            if line.column(after) - line.column(before) == 2 {
                self.add_three(line, [before, echo, after]);
            }
            (before, echo) = (echo, after);
        }
    }

    /// Adds `min(|difference of ranges|, cap)` in each zone.
    #[inline]
    fn add_pair(&mut self, cell: usize, (line, echo): (&Held, &HeldEcho), (next, other): (&Held, &HeldEcho)) {
        let (base, even_m) = beside(echo, other, next.pulses.interval_m);
        let Some(here) = offsets(line, echo.base, self.stride) else { return };
        let Some(there) = offsets(next, base, self.stride) else { return };
        let even = even_m - echo.even_m;
        let rough = &mut self.rough[cell * self.stride..][..self.stride];
        let groups = rough.chunks_exact_mut(LANES);
        for ((rough, here), there) in groups.zip(here.chunks_exact(LANES)).zip(there.chunks_exact(LANES)) {
            for lane in 0..LANES {
                rough[lane] += (even + here[lane] - there[lane]).abs().min(CAP_M);
            }
        }
    }

    /// Adds `min(|second difference of ranges|, cap)` in each zone.
    #[inline]
    fn add_three(&mut self, line: &Held, [before, echo, after]: [&HeldEcho; 3]) {
        let interval_m = line.pulses.interval_m;
        let sides = [before, after].map(|other| beside(echo, other, interval_m));
        let even = sides[0].1 + sides[1].1 - 2.0 * echo.even_m;
        let Some(here) = offsets(line, echo.base, self.stride) else { return };
        let Some(first) = offsets(line, sides[0].0, self.stride) else { return };
        let Some(second) = offsets(line, sides[1].0, self.stride) else { return };
        let cell = self.index(line.column(echo));
        let rough = &mut self.rough[cell * self.stride..][..self.stride];
        let sides = first.chunks_exact(LANES).zip(second.chunks_exact(LANES));
        let groups = rough.chunks_exact_mut(LANES).zip(here.chunks_exact(LANES));
        for ((rough, here), (first, second)) in groups.zip(sides) {
            for lane in 0..LANES {
                let curvature = even + 2.0 * here[lane] - first[lane] - second[lane];
                rough[lane] += CURVATURE_PART * curvature.abs().min(CAP_M);
            }
        }
    }

    /// Writes the cost of each zone of a cell, nats, to the first `zones` entries of `costs`.
    pub fn costs(&self, index: usize, settings: &Settings, costs: &mut [f32]) {
        let cell = &self.cells[index];
        let rough = &self.rough[index * self.stride..][..self.stride];
        let [least_m, most_m] = settings.range_m.map(|range_m| range_m as f32);
        let prior_m = cell.prior.0 / f32::from(cell.prior.1);
        for (zone, cost) in costs.iter_mut().enumerate().take(self.zones) {
            let range_m = cell.phase_m + zone as f32 * self.interval_m;
            let beyond_m = (least_m - range_m).max(range_m - most_m).max(0.0);
            *cost = rough[self.stride - 1 - zone] * (PAIR_PART / SCALE_M) + beyond_m * INFEASIBLE_NATS_PER_M;
            let (sd_m, part, cap_nats) = match settings.prior {
                Prior::None => continue,
                Prior::Agl { sd_m, .. } => (sd_m, AGL_PART, AGL_CAP_NATS),
                Prior::PerEmission { sd_m } => (sd_m, 1.0, EXPECTED_CAP_NATS),
            };
            if cell.prior.1 > 0 {
                let apart = (range_m - prior_m) / sd_m as f32;
                *cost += part * (0.5 * apart * apart).min(cap_nats);
            }
        }
    }
}

/// Zone origin and even-interval range of `other`, shifted to lie within half an interval of
/// `echo`.
#[inline]
fn beside(echo: &HeldEcho, other: &HeldEcho, interval_m: f32) -> (i32, f32) {
    let apart = other.range_m - echo.range_m;
    if apart.abs() <= 0.5 * interval_m {
        return (other.base, other.even_m);
    }
    let by = if apart > 0.0 { 1 } else { -1 };
    (other.base + by, other.even_m - by as f32 * interval_m)
}

/// Offsets of the emissions in all zones counted from `base`, the largest zone first.
///
/// `None` if they are not all known: a lost record would bias against all zones beyond it and none
/// before it.
#[inline]
fn offsets(line: &Held, base: i32, stride: usize) -> Option<&[f32]> {
    let end = usize::try_from(base).ok()? + 1;
    let begin = end.checked_sub(stride)?;
    let regular = *line.pulses.regular.get(end - 1)? as usize;
    if regular + 1 < stride { None } else { line.pulses.offset_m.get(begin..end) }
}

/// First position from which no echo comes from the previous line.
///
/// The other end of the swath is another surface; its phase and evidence do not apply to the cells
/// here. A revolution continues where the previous one ended.
fn inside_from(line: &Held, zones: usize) -> u32 {
    let margin = if line.pulses.lead == 0 || line.ring > 0 { 0 } else { zones.min(line.pulses.own() / 4) };
    (line.pulses.lead + margin) as u32
}

/// Finds the phase of a cell: the quarter interval with most echoes, and their mean range.
fn find_phase(cell: &mut Cell, bins: &[(u16, f32); BINS], interval_m: f32) {
    let count: u16 = bins.iter().fold(0, |sum, bin| sum.saturating_add(bin.0));
    cell.count = count;
    if count == 0 {
        return;
    }
    let held = |start: usize| (0..SURFACE_BINS).map(move |i| (start + i) % BINS);
    let within = |start: usize| held(start).map(|i| u32::from(bins[i].0)).sum::<u32>();
    let Some(start) = (0..BINS).rev().max_by_key(|&start| within(start)) else { return };
    let surface = within(start) as f32;
    let turned = |i: usize| if i < start { interval_m * f32::from(bins[i].0) } else { 0.0 };
    let sum: f32 = held(start).map(|i| bins[i].1 + turned(i)).sum();
    let phase_m = sum / surface;
    cell.phase_m = if phase_m >= interval_m { phase_m - interval_m } else { phase_m };
    cell.known = surface >= LEAST_PART * f32::from(count);
}

/// Fills cells without a phase from the nearest cell; cyclic for a ring.
fn fill(cells: &mut [Cell], is_ring: bool) {
    let count = cells.len() as i32;
    let mut known: Vec<i32> = (0..count).filter(|&i| cells[i as usize].known).collect();
    let (Some(&first), Some(&last)) = (known.first(), known.last()) else { return };
    let (mut before, mut next) = (first, 0);
    if is_ring {
        before = last - count;
        known.push(first + count);
    }
    for i in 0..count {
        if known.get(next) == Some(&i) {
            (before, next) = (i, next + 1);
        } else {
            let after = known.get(next).copied().unwrap_or(before);
            let nearest = if after.abs_diff(i) < before.abs_diff(i) { after } else { before };
            let apart = (i - nearest) as f32;
            let along = apart.clamp(-EXTENDED_CELLS, EXTENDED_CELLS);
            let (i, nearest) = (i as usize, nearest.rem_euclid(count) as usize);
            let slope_m = cells[nearest].slope_m;
            cells[i].slope_m = if apart == along { slope_m } else { 0.0 };
            cells[i].phase_m = cells[nearest].phase_m + slope_m * along * CELL_SHOTS as f32;
        }
    }
}

//! Cells of neighbouring echoes: where their surface lies up to whole intervals, and how smooth each choice makes it.
//!
//! A band is a few lines, cut into cells across. All echoes of one surface lie at one *phase*, their range modulo the interval
//! between pulses, however the zones change within. So the phase is found first, and zones are counted from it: for every cell
//! there is one unknown, the zone of its surface.

use super::held::{Held, HeldEcho};
use super::{Prior, Settings};

/// Lines of a band.
pub(super) const BAND_LINES: usize = 8;
/// Shots of a cell.
pub(super) const CELL_SHOTS: i32 = 16;
/// Bins of the interval in which the phase is looked for, and how many of them make the surface.
const BINS: usize = 32;
const SURFACE_BINS: usize = 8;
/// A cell has a phase from so many echoes on, where this part of them are at the surface.
const LEAST_ECHOES: u16 = 8;
/// The same in a band where no cell has as many.
const FEWEST_ECHOES: u16 = 3;
const LEAST_PART: f32 = 0.55;
/// Differences of neighbouring ranges: scale of a Laplace distribution and where it gives way to anything, m.
const SCALE_M: f32 = 0.5;
const CAP_M: f32 = 3.4;
/// Pairs of neighbours share echoes: what a pair counts of its evidence.
const PAIR_PART: f32 = 0.25;
/// What a second difference counts, against a difference.
const CURVATURE_PART: f32 = 3.0;
/// Most neighbours of an echo in its line, and in the next.
const NEIGHBOURS: [usize; 2] = [4, 5];
/// How far neighbours stand away, columns.
const REACH: [i32; 2] = [2, 1];
/// How much nearer a surface beside must be, m.
const BESIDE_M: f32 = 5.0;
/// Zones are handled in groups of so many.
pub(super) const LANES: usize = 8;
/// Most zones.
pub(super) const MOST_ZONES: usize = 126;
/// Costs of a prior end here, nats.
const PRIOR_CAP_NATS: f32 = 8.0;
/// A height above ground is wrong in the same way in many cells.
const AGL_PART: f32 = 1.0 / 16.0;
/// Cost of a range beyond the feasible ones, nats per metre.
const INFEASIBLE_NATS_PER_M: f32 = 0.5;

/// What is known of a cell.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Cell {
    /// Echoes that count.
    pub count: u16,
    /// Whether the echoes, and not only neighbours, tell the phase.
    pub known: bool,
    /// Range of the surface in zone 0, m.
    pub phase_m: f32,
    /// Sum and number of the expected ranges.
    prior: (f32, u16),
    /// Range of the surface, m: once decided.
    pub surface_m: f32,
    /// How much better the decided zone is than any other, nats.
    pub margin_nats: f32,
}

/// Some lines, cut into cells.
#[derive(Debug, Default)]
pub(super) struct Band {
    /// Number of the first cell: cell `i` holds the columns from `(first + i) * CELL_SHOTS` on.
    pub first: i32,
    pub cells: Vec<Cell>,
    /// The usual interval, m.
    pub interval_m: f32,
    /// Zones that are looked at: 0 up to this.
    pub zones: usize,
    /// Roughness by cell and zone, nats: the greatest zone first, `stride` for a cell.
    rough: Vec<f32>,
    stride: usize,
}

/// Number of the cell that a column lies in.
pub(super) fn cell_of(column: i32) -> i32 {
    column.div_euclid(CELL_SHOTS)
}

impl Band {
    /// The band of `lines`, whose echoes are made to count from the cells' phases.
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
        let first = cell_of(least);
        let count = (cell_of(most) - first) as usize + 1;
        let mut band = Band {
            first,
            cells: vec![Cell::default(); count],
            interval_m,
            zones,
            rough: vec![0.0; count * stride],
            stride,
        };
        band.find_phases(lines);
        band.add_priors(lines);
        band.count_from_phases(lines);
        band
    }

    /// The index of the cell that holds a column, or the nearest.
    ///
    /// There must be cells.
    pub fn index(&self, column: i32) -> usize {
        (cell_of(column) - self.first).clamp(0, self.cells.len() as i32 - 1) as usize
    }

    /// The cell at a column, or beside it, whose surface is nearest to a range, and how far it is away, m.
    pub fn nearest(&self, column: i32, range_m: f32) -> (&Cell, f32) {
        let index = self.index(column);
        let beside = &self.cells[index.saturating_sub(1)..(index + 2).min(self.cells.len())];
        let apart = |cell: &Cell| (range_m - cell.surface_m).abs();
        let mut found = (&self.cells[index], apart(&self.cells[index]));
        for cell in beside {
            if apart(cell) + BESIDE_M < found.1 {
                found = (cell, apart(cell) + BESIDE_M);
            }
        }
        found
    }

    /// Surfaces and margins of all cells.
    pub fn surfaces(&self) -> Vec<(f32, f32)> {
        self.cells.iter().map(|cell| (cell.surface_m, cell.margin_nats)).collect()
    }

    /// Sets surfaces and margins to what they were.
    pub fn restore(&mut self, surfaces: &[(f32, f32)]) {
        for (cell, surface) in self.cells.iter_mut().zip(surfaces) {
            (cell.surface_m, cell.margin_nats) = *surface;
        }
    }

    fn find_phases(&mut self, lines: &[Held]) {
        let mut bins = vec![[(0u16, 0f32); BINS]; self.cells.len()];
        for line in lines {
            let interval_m = line.pulses.interval_m;
            for echo in line.echoes.iter().filter(|echo| is_inside(line, echo, self.zones)) {
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

    /// Counts the zones of all echoes from the phase of their cell, or of the nearest that has one.
    fn count_from_phases(&mut self, lines: &mut [Held]) {
        fill(&mut self.cells);
        for line in lines {
            let interval_m = line.pulses.interval_m;
            for i in 0..line.echoes.len() {
                let cell = self.index(line.column(&line.echoes[i]));
                let apart = line.echoes[i].range_m - self.cells[cell].phase_m;
                let by = (apart / interval_m).round().clamp(-2.0, 2.0);
                if by != 0.0 {
                    line.echoes[i].count_from(by as i32, interval_m);
                }
            }
        }
    }

    /// Whether any cell's echoes tell its phase.
    pub fn is_known(&self) -> bool {
        self.cells.iter().any(|cell| cell.known)
    }

    /// The expected range of a cell, m.
    pub fn prior_m(&self, index: usize) -> Option<f32> {
        let (sum, count) = self.cells[index].prior;
        (count > 0).then(|| sum / f32::from(count))
    }

    fn add_priors(&mut self, lines: &[Held]) {
        for line in lines.iter().filter(|line| !line.prior_m.is_empty()) {
            let own = line.pulses.column[line.pulses.lead..].iter().zip(&line.prior_m);
            for (&column, &range_m) in own.filter(|(_, range_m)| range_m.is_finite()) {
                let index = self.index(column);
                let prior = &mut self.cells[index].prior;
                (prior.0, prior.1) = (prior.0 + range_m, prior.1.saturating_add(1));
            }
        }
    }

    /// Adds the evidence of neighbours within a line.
    pub fn add_line(&mut self, line: &Held) {
        for (i, echo) in line.echoes.iter().enumerate() {
            let column = line.column(echo);
            let cell = self.index(column);
            let near = line.echoes[i + 1..].iter().take_while(|other| line.column(other) <= column + REACH[0]);
            for other in near.filter(|other| other.last != echo.last).take(NEIGHBOURS[0]) {
                self.add_pair(cell, (line, echo), (line, other));
            }
        }
    }

    /// Adds the evidence of neighbours in the line after `line`, which is one of this band's.
    pub fn add_next(&mut self, line: &Held, next: &Held) {
        let mut from = 0;
        for echo in &line.echoes {
            let column = line.column(echo);
            while next.echoes.get(from).is_some_and(|other| next.column(other) < column - REACH[1]) {
                from += 1;
            }
            let cell = self.index(column);
            let near = next.echoes[from..].iter().take_while(|other| next.column(other) <= column + REACH[1]);
            for other in near.take(NEIGHBOURS[1]) {
                self.add_pair(cell, (line, echo), (next, other));
            }
        }
    }

    /// Adds the evidence of three neighbouring shots' last echoes: their curvature does not see a slope.
    pub fn add_curvature(&mut self, line: &Held) {
        let ends = |pair: &[HeldEcho]| pair.len() == 1 || pair[0].last != pair[1].last;
        let mut shots = (0..line.echoes.len())
            .filter(|&i| ends(&line.echoes[i..(i + 2).min(line.echoes.len())]))
            .map(|i| &line.echoes[i]);
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

    /// Cost of each zone of a cell, nats, into the first `zones` entries of `costs`.
    pub fn costs(&self, index: usize, settings: &Settings, costs: &mut [f32]) {
        let cell = &self.cells[index];
        let rough = &self.rough[index * self.stride..][..self.stride];
        let [least_m, most_m] = settings.range_m.map(|range_m| range_m as f32);
        let prior_m = cell.prior.0 / f32::from(cell.prior.1);
        for (zone, cost) in costs.iter_mut().enumerate().take(self.zones) {
            let range_m = cell.phase_m + zone as f32 * self.interval_m;
            let beyond_m = (least_m - range_m).max(range_m - most_m).max(0.0);
            *cost = rough[self.stride - 1 - zone] * (PAIR_PART / SCALE_M) + beyond_m * INFEASIBLE_NATS_PER_M;
            let (sd_m, part) = match settings.prior {
                Prior::None => continue,
                Prior::Agl { sd_m, .. } => (sd_m, AGL_PART),
                Prior::PerEmission { sd_m } => (sd_m, 1.0),
            };
            if cell.prior.1 > 0 {
                let apart = (range_m - prior_m) / sd_m as f32;
                *cost += part * (0.5 * apart * apart).min(PRIOR_CAP_NATS);
            }
        }
    }
}

/// Where `other` counts its zones from and its even range, so that it lies within half an interval of `echo`.
#[inline]
fn beside(echo: &HeldEcho, other: &HeldEcho, interval_m: f32) -> (i32, f32) {
    let apart = other.range_m - echo.range_m;
    if apart.abs() <= 0.5 * interval_m {
        return (other.base, other.even_m);
    }
    let by = if apart > 0.0 { 1 } else { -1 };
    (other.base + by, other.even_m - by as f32 * interval_m)
}

/// The offsets of the emissions in all zones counted from `base`, the greatest zone first.
#[inline]
fn offsets(line: &Held, base: i32, stride: usize) -> Option<&[f32]> {
    let end = usize::try_from(base).ok()? + 1;
    line.pulses.offset_m.get(end.checked_sub(stride)?..end)
}

/// Whether an echo cannot come from a line before: the other end of the swath is another surface.
fn is_inside(line: &Held, echo: &HeldEcho, zones: usize) -> bool {
    let own = echo.last as usize;
    let margin = if line.pulses.lead == 0 { 0 } else { zones.min(line.pulses.own() / 4) };
    own >= line.pulses.lead + margin
}

/// Finds where most echoes of a cell lie: the quarter of the interval that holds most, and their mean in it.
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

/// Gives cells without a phase of their own that of the nearest cell in the band.
fn fill(cells: &mut [Cell]) {
    let known: Vec<usize> = (0..cells.len()).filter(|&i| cells[i].known).collect();
    let (Some(&first), mut next) = (known.first(), 0) else { return };
    let mut before = first;
    for i in 0..cells.len() {
        if known.get(next) == Some(&i) {
            (before, next) = (i, next + 1);
        } else {
            let after = known.get(next).copied().unwrap_or(before);
            let nearest = if after.abs_diff(i) < before.abs_diff(i) { after } else { before };
            cells[i].phase_m = cells[nearest].phase_m;
        }
    }
}

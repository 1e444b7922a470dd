//! Assigns one zone to each cell, from its own evidence and continuity with neighbours.
//!
//! Min-sum belief propagation on the grid of cells, swept along and across the lines. Two
//! neighbours whose surfaces are `d` apart cost `CONTINUITY_NATS · min(|d| / interval, 1)`.
//! Surfaces half an interval apart are ambiguous, and no step costs more than the evidence of a few
//! cells can outweigh.

use std::collections::VecDeque;

use super::Settings;
use super::cells::Band;
use super::pulses::CELL_SHOTS;

/// Cost of a step of one interval or more, nats.
const CONTINUITY_NATS: f32 = 48.0;
/// Number of sweeps in both directions, along and across the lines.
const ROUNDS: usize = 3;
/// Direction from which a message comes.
const LEFT: usize = 0;
const RIGHT: usize = 1;
const BEFORE: usize = 2;
const AFTER: usize = 3;

/// A cell of the grid and its row.
#[derive(Clone, Copy)]
struct GridPlace {
    row: usize,
    cell: usize,
}

/// The cells of some bands.
struct Grid<'a> {
    bands: &'a VecDeque<Band>,
    /// Index of the first cell of each band.
    starts: Vec<usize>,
    stride: usize,
    costs: Vec<f32>,
    messages: [Vec<f32>; 4],
}

/// Decides the zone and surface range of every cell.
pub(super) fn decide(bands: &mut VecDeque<Band>, settings: &Settings) {
    fill_bands(bands);
    let mut grid = Grid::new(bands, settings);
    for _ in 0..ROUNDS {
        grid.sweep();
    }
    let decided = grid.decided();
    let cells = bands.iter_mut().flat_map(|band| {
        let interval_m = band.interval_m;
        band.cells.iter_mut().map(move |cell| (cell, interval_m))
    });
    for ((cell, interval_m), (zone, margin_nats)) in cells.zip(decided) {
        cell.surface_m = cell.phase_m + zone as f32 * interval_m;
        cell.margin_nats = if cell.is_clutter() { 0.0 } else { margin_nats };
    }
}

/// Fills bands without a phase from the prior, the nearest previous band, or the next.
fn fill_bands(bands: &mut VecDeque<Band>) {
    let known: Vec<usize> = (0..bands.len()).filter(|&row| bands[row].is_known()).collect();
    for row in 0..bands.len() {
        if bands[row].is_known() {
            continue;
        }
        let from = known.iter().rev().find(|&&other| other < row).or(known.first()).copied();
        for i in 0..bands[row].cells.len() {
            let interval_m = bands[row].interval_m;
            let expected_m = match (bands[row].prior_m(i), from) {
                (Some(prior_m), _) => prior_m,
                (None, Some(other)) if !bands[other].cells.is_empty() => {
                    let place = (bands[row].first + i as i32 - bands[other].first)
                        .clamp(0, bands[other].cells.len() as i32 - 1);
                    bands[other].cells[place as usize].phase_m
                }
                _ => 0.0,
            };
            bands[row].cells[i].phase_m = expected_m.rem_euclid(interval_m);
        }
    }
}

impl<'a> Grid<'a> {
    fn new(bands: &'a VecDeque<Band>, settings: &Settings) -> Grid<'a> {
        let stride = bands.iter().map(|band| band.zones).max().unwrap_or(1);
        let mut starts = Vec::with_capacity(bands.len());
        let mut cells = 0;
        for band in bands {
            starts.push(cells);
            cells += band.cells.len();
        }
        let mut costs = vec![0.0; cells * stride];
        for (band, &start) in bands.iter().zip(&starts) {
            for (i, costs) in costs[start * stride..].chunks_mut(stride).enumerate().take(band.cells.len()) {
                band.costs(i, settings, costs);
            }
        }
        let messages = [(); 4].map(|()| vec![0.0; cells * stride]);
        Grid { bands, starts, stride, costs, messages }
    }

    fn sweep(&mut self) {
        let mut held = vec![0.0; self.stride];
        let rows = self.bands.len();
        for row in 0..rows {
            let cells = self.bands[row].cells.len();
            for cell in 1..cells {
                self.send(GridPlace { row, cell: cell - 1 }, GridPlace { row, cell }, LEFT, &mut held);
            }
            let is_ring = self.bands[row].is_ring && cells > 2;
            if is_ring {
                self.send(GridPlace { row, cell: cells - 1 }, GridPlace { row, cell: 0 }, LEFT, &mut held);
            }
            for cell in (1..cells).rev() {
                self.send(GridPlace { row, cell }, GridPlace { row, cell: cell - 1 }, RIGHT, &mut held);
            }
            if is_ring {
                self.send(GridPlace { row, cell: 0 }, GridPlace { row, cell: cells - 1 }, RIGHT, &mut held);
            }
        }
        for row in 1..rows {
            self.send_row(row - 1, row, BEFORE, &mut held);
        }
        for row in (1..rows).rev() {
            self.send_row(row, row - 1, AFTER, &mut held);
        }
    }

    /// Sends messages between cells of two bands at the same columns.
    fn send_row(&mut self, from: usize, to: usize, side: usize, held: &mut [f32]) {
        let shift = self.bands[from].first - self.bands[to].first;
        for cell in 0..self.bands[from].cells.len() {
            let other = cell as i32 + shift;
            if (0..self.bands[to].cells.len() as i32).contains(&other) {
                let to = GridPlace { row: to, cell: other as usize };
                self.send(GridPlace { row: from, cell }, to, side, held);
            }
        }
    }

    /// Sends the message of `from`, which is on side `side` of `to`.
    fn send(&mut self, from: GridPlace, to: GridPlace, side: usize, held: &mut [f32]) {
        let (band, other) = (&self.bands[from.row], &self.bands[to.row]);
        let zones = band.zones;
        let start = (self.starts[from.row] + from.cell) * self.stride;
        let back = [RIGHT, LEFT, AFTER, BEFORE][side];
        let held = &mut held[..zones];
        held.copy_from_slice(&self.costs[start..start + zones]);
        for (_, messages) in self.messages.iter().enumerate().filter(|(kind, _)| *kind != back) {
            for (sum, message) in held.iter_mut().zip(&messages[start..start + zones]) {
                *sum += message;
            }
        }
        let least = held.iter().copied().fold(f32::INFINITY, f32::min);
        held.iter_mut().for_each(|cost| *cost = (*cost - least).min(CONTINUITY_NATS));
        let begin = (self.starts[to.row] + to.cell) * self.stride;
        let message = &mut self.messages[side][begin..begin + other.zones];
        let (here, there) = (&band.cells[from.cell], &other.cells[to.cell]);
        // Along the line, surfaces are compared at the boundary of the cells.
        let half = match side {
            LEFT => 0.5 * CELL_SHOTS as f32,
            RIGHT => -0.5 * CELL_SHOTS as f32,
            _ => 0.0,
        };
        let (here_m, there_m) = (here.phase_m + half * here.slope_m, there.phase_m - half * there.slope_m);
        let at = |zone: i32| held.get(zone as usize).copied().unwrap_or(CONTINUITY_NATS);
        for (zone, message) in message.iter_mut().enumerate() {
            let place = (there_m + zone as f32 * other.interval_m - here_m) / band.interval_m;
            let below = place.floor();
            let part = place - below;
            let (low, high) = (at(below as i32), at(below as i32 + 1));
            let nearest = (low + CONTINUITY_NATS * part).min(high + CONTINUITY_NATS * (1.0 - part));
            *message = nearest.min(CONTINUITY_NATS);
        }
    }

    /// Best zone of each cell, and its margin over the second-best.
    fn decided(&self) -> Vec<(usize, f32)> {
        let mut decided = Vec::new();
        for (band, &start) in self.bands.iter().zip(&self.starts) {
            for cell in 0..band.cells.len() {
                let at = (start + cell) * self.stride;
                let cost = |zone: usize| {
                    self.costs[at + zone]
                        + self.messages.iter().map(|messages| messages[at + zone]).sum::<f32>()
                };
                let (mut best, mut second) = ((0, f32::INFINITY), f32::INFINITY);
                for zone in 0..band.zones {
                    let cost = cost(zone);
                    if cost < best.1 {
                        (best, second) = ((zone, cost), best.1);
                    } else {
                        second = second.min(cost);
                    }
                }
                decided.push((best.0, second - best.1));
            }
        }
        decided
    }
}

//! The method `Blocks`: cells of neighbouring echoes decide jointly.
//!
//! Each echo is then assigned to the emission that puts it nearest to the surface.

use std::collections::VecDeque;

use super::cells::{BAND_LINES, Band, Cell, Slope};
use super::held::{Held, HeldEcho};
use super::pending;
use super::summary::Summary;
use super::{MtaError, Prior, Resolved, Settings, grid};

/// Number of bands decided at a time, of bands of look-ahead, and of past bands kept.
const CORE_BANDS: usize = 16;
const AHEAD_BANDS: usize = 4;
const PAST_BANDS: usize = 16;
const FULL_BANDS: usize = CORE_BANDS + AHEAD_BANDS;
/// Largest number of lines held back.
pub(super) const LOOK_AHEAD_LINES: usize = FULL_BANDS * BAND_LINES;
/// Memory above which lines are decided early, bytes.
///
/// It counts the memory that the caller holds for undecided lines ([`super::Line::bytes`]). Above
/// it, lines that are followed by at least one band are decided at once.
pub const LOOK_AHEAD_BYTES: usize = 256_000_000;
/// Distance from the surface beyond which an echo is uncertain, in intervals.
const FAR_PART: f32 = 0.45;
/// Evidence below which an echo is uncertain, nats.
const LEAST_MARGIN_NATS: f32 = 5.0;
/// Evidence of an echo's position for its zone, nats per interval of advantage over the next zone.
const PLACE_NATS: f32 = 40.0;

/// Largest distance from the surface of echoes that refine it, in intervals.
const SURFACE_PART: f32 = 0.25;
/// Usual largest height of objects above the terrain, m.
const ABOVE_M: f32 = 60.0;
/// Number of emissions considered before and after the expected one.
const SPAN: usize = 3;
/// Distance to the surface below which no other emission is considered, m.
const AT_SURFACE_M: f32 = 8.0;

/// The state of the method.
#[derive(Debug)]
pub(super) struct Blocks {
    settings: Settings,
    /// Undecided lines.
    lines: VecDeque<Held>,
    /// Number of the first band held.
    first_band: u64,
    /// Bands of past lines, then of pending lines.
    bands: VecDeque<Band>,
    /// Number of decided bands.
    decided: usize,
}

impl Blocks {
    pub fn new(settings: &Settings) -> Blocks {
        Blocks {
            settings: *settings,
            lines: VecDeque::new(),
            first_band: 0,
            bands: VecDeque::new(),
            decided: 0,
        }
    }

    pub fn push(
        &mut self,
        line: Held,
        summary: &mut Summary,
        ready: &mut VecDeque<Resolved>,
    ) -> Result<(), MtaError> {
        self.lines.push_back(line);
        if self.lines.len().is_multiple_of(BAND_LINES) {
            self.add_band();
        }
        if !self.lines.len().is_multiple_of(BAND_LINES) {
            return Ok(());
        }
        let waiting = self.bands.len() - self.decided;
        let is_much = self.lines.iter().map(|line| line.bytes).sum::<usize>() > LOOK_AHEAD_BYTES;
        match waiting {
            FULL_BANDS => self.decide(CORE_BANDS, summary, ready),
            2.. if is_much => self.decide(waiting - AHEAD_BANDS.min(waiting / 2), summary, ready),
            _ => Ok(()),
        }
    }

    pub fn finish(&mut self, summary: &mut Summary, ready: &mut VecDeque<Resolved>) -> Result<(), MtaError> {
        if !self.lines.len().is_multiple_of(BAND_LINES) {
            self.add_band();
        }
        match self.bands.len() - self.decided {
            0 => Ok(()),
            left => self.decide(left, summary, ready),
        }
    }

    /// Makes a band of the last lines.
    fn add_band(&mut self) {
        let from = (self.lines.len() - 1) / BAND_LINES * BAND_LINES;
        let lines = self.lines.make_contiguous();
        let mut band = Band::new(&mut lines[from..], &self.settings);
        for i in from..lines.len() {
            band.add_line(&lines[i]);
            band.add_curvature(&lines[i]);
            if let Some(next) = lines.get(i + 1) {
                band.add_next(&lines[i], next);
            }
        }
        if let (Some(before), true) = (self.bands.back_mut(), from > 0) {
            before.add_next(&lines[from - 1], &lines[from]);
        }
        self.bands.push_back(band);
    }

    /// Decides the first `count` undecided bands and finishes their lines.
    fn decide(
        &mut self,
        count: usize,
        summary: &mut Summary,
        ready: &mut VecDeque<Resolved>,
    ) -> Result<(), MtaError> {
        summary.check_rate(&self.settings)?;
        let past: Vec<Vec<Cell>> =
            self.bands.iter().take(self.decided).map(|band| band.cells.clone()).collect();
        grid::decide(&mut self.bands, &self.settings);
        for (band, cells) in self.bands.iter_mut().zip(past) {
            band.cells = cells;
        }
        let lines = (count * BAND_LINES).min(self.lines.len());
        self.refine(lines);
        for i in 0..lines {
            let (line, next) = (&self.lines[i], self.lines.get(i + 1));
            let found: Vec<Nearest> = line.echoes.iter().map(|echo| self.nearest(line, echo)).collect();
            let causes: Vec<Option<usize>> = found.iter().map(|found| found.cause).collect();
            summary.add_differences(line, &causes, &self.settings);
            let assigned = line.echoes.iter().zip(&found).map(|(echo, found)| {
                let last = line.last_emission(echo, next);
                let uncertain = found.is_uncertain(line.pulses.interval_m);
                (
                    echo.input,
                    line.assigned(echo, found.cause, found.margin_nats, uncertain, &last, &self.settings),
                )
            });
            ready.push_back(pending::finish(line, assigned, next, &self.settings, summary));
        }
        summary.check_clock(&self.settings)?;
        self.lines.drain(..lines);
        self.decided += count;
        while self.decided > PAST_BANDS {
            self.bands.pop_front();
            self.first_band += 1;
            self.decided -= 1;
        }
        Ok(())
    }

    /// Refits the surfaces to the echoes assigned to each cell.
    fn refine(&mut self, lines: usize) {
        let mut slopes: Vec<Vec<Slope>> =
            self.bands.iter().map(|band| vec![Slope::default(); band.cells.len()]).collect();
        for line in self.lines.iter().take(lines) {
            for echo in &line.echoes {
                let found = self.nearest(line, echo);
                let Some(place) = found.cause else { continue };
                if found.apart_m > SURFACE_PART * line.pulses.interval_m {
                    continue;
                }
                if let Some(row) = self.row(line.pulses.cause(place, line.number).line) {
                    let (band, column) = (&self.bands[row], line.pulses.column[place]);
                    let index = band.index(column);
                    let range_m = line.range_m(echo, place, &self.settings) - band.cells[index].surface_m;
                    slopes[row][index].add(band.off_middle(index, column), range_m);
                }
            }
        }
        let until = self.decided + lines.div_ceil(BAND_LINES);
        let rows = self.bands.iter_mut().zip(&slopes).take(until).skip(self.decided);
        for (cell, slope) in rows.flat_map(|(band, slopes)| band.cells.iter_mut().zip(slopes)) {
            if let Some((middle_m, slope_m)) = slope.fit() {
                cell.surface_m += middle_m;
                cell.slope_m = slope_m;
            }
        }
    }

    /// Index of the band that contains a line.
    fn row(&self, line: u64) -> Option<usize> {
        let row = (line / BAND_LINES as u64).checked_sub(self.first_band)? as usize;
        self.bands.get(row).filter(|band| !band.cells.is_empty()).map(|_| row)
    }

    /// Finds the emission that puts an echo nearest to that emission's surface.
    fn nearest(&self, line: &Held, echo: &HeldEcho) -> Nearest {
        let row = self.row(line.number);
        let expected = row.and_then(|row| expected_place(&self.bands[row], line, echo, &self.settings));
        if let (Some(row), Some(place)) = (row, expected)
            && let Some(found) = self.at_surface(&self.bands[row], line, echo, place)
        {
            return found;
        }
        let mut found =
            Nearest { cause: None, apart_m: f32::INFINITY, second_m: f32::INFINITY, margin_nats: 0.0 };
        let last = echo.last as usize;
        let lead = line.pulses.lead;
        match expected {
            Some(place) => {
                for place in (place - SPAN).max(lead)..=(place + SPAN).min(last) {
                    self.consider(row, line, echo, place, &mut found);
                }
            }
            // Near the start of a line, the previous line may contain the cause.
            None => {
                for place in 0..=last {
                    let row = if place < lead { self.row(line.pulses.cause(place, 0).line) } else { row };
                    self.consider(row, line, echo, place, &mut found);
                }
            }
        }
        let place_nats = PLACE_NATS * (found.second_m - found.apart_m) / line.pulses.interval_m;
        found.margin_nats = found.margin_nats.min(place_nats);
        found
    }

    /// Accepts the emission at `place` if the echo is at its surface.
    ///
    /// No other emission is then considered.
    fn at_surface(&self, band: &Band, line: &Held, echo: &HeldEcho, place: usize) -> Option<Nearest> {
        let [least_m, most_m] = self.settings.range_m.map(|range_m| range_m as f32);
        let (range_m, column) = (line.range_m(echo, place, &self.settings), line.pulses.column[place]);
        let index = band.index(column);
        let apart_m = band.apart_m(index, column, range_m);
        let is_expected = match self.settings.prior {
            // NaN, if no range is expected, counts as 0.
            Prior::PerEmission { sd_m } => {
                let beyond_m = (range_m - line.pulses.expected_m[place]).abs();
                (beyond_m - 3.0 * sd_m as f32).max(0.0) <= ABOVE_M
            }
            _ => true,
        };
        if apart_m >= AT_SURFACE_M || !(least_m..=most_m).contains(&range_m) || !is_expected {
            return None;
        }
        let second_m = line.pulses.interval_m - apart_m;
        let place_nats = PLACE_NATS * (second_m - apart_m) / line.pulses.interval_m;
        let margin_nats = band.cells[index].margin_nats.min(place_nats);
        Some(Nearest { cause: Some(place), apart_m, second_m, margin_nats })
    }

    /// Considers the emission at `place`, of a line in the band `row`.
    fn consider(&self, row: Option<usize>, line: &Held, echo: &HeldEcho, place: usize, found: &mut Nearest) {
        let [least_m, most_m] = self.settings.range_m.map(|range_m| range_m as f32);
        let range_m = line.range_m(echo, place, &self.settings);
        let Some(band) = row.and_then(|row| self.bands.get(row)) else { return };
        if !(least_m..=most_m).contains(&range_m) {
            return;
        }
        let (cell, mut apart_m) = band.nearest(line.pulses.column[place], range_m);
        if let Prior::PerEmission { sd_m } = self.settings.prior {
            // NaN, if no range is expected, is ignored by `min` and `max`.
            let beyond_m = (range_m - line.pulses.expected_m[place]).abs();
            let sd_m = sd_m as f32;
            apart_m = apart_m.min(beyond_m + sd_m) + (beyond_m - ABOVE_M - 3.0 * sd_m).max(0.0);
        }
        if apart_m < found.apart_m {
            found.second_m = found.apart_m;
            (found.cause, found.apart_m, found.margin_nats) = (Some(place), apart_m, cell.margin_nats);
        } else {
            found.second_m = found.second_m.min(apart_m);
        }
    }
}

/// Most likely emission given the surface; `None` if it or its neighbours are outside the line.
fn expected_place(band: &Band, line: &Held, echo: &HeldEcho, settings: &Settings) -> Option<usize> {
    let (pulses, last) = (&line.pulses, echo.last as usize);
    let surface_m = band.cells[band.index(pulses.column[last])].surface_m;
    let zone = ((surface_m - line.range_m(echo, last, settings)) / pulses.interval_m).round();
    last.checked_sub(zone.clamp(0.0, 1e6) as usize).filter(|&place| place > pulses.lead + SPAN)
}

/// Result of the search for the emission nearest to the surface.
struct Nearest {
    cause: Option<usize>,
    /// Distance of the best and of the second-best emission to the surface, m.
    apart_m: f32,
    second_m: f32,
    margin_nats: f32,
}

impl Nearest {
    fn is_uncertain(&self, interval_m: f32) -> bool {
        self.cause.is_none() || self.apart_m > FAR_PART * interval_m || self.margin_nats < LEAST_MARGIN_NATS
    }
}

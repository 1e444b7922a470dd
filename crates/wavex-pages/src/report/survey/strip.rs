//! What the survey's page keeps of one strip, collected while its lines pass.

use std::collections::BTreeMap;
use std::sync::{Mutex, MutexGuard};

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::grid::{PlacedCell, StripGrid};
use crate::report::overview::QuantityHistogram;
use crate::report::overview::histogram::Bins;
use crate::report::overview::view::{MapAxes, MapProjection};
use wavex_line::scan_line::{InputInfo, Return, ScanLine};
use wavex_line::system::Unpoisoned as _;

/// Deviation ratio above which returns do not explain their waveform.
pub(in crate::report) const UNEXPLAINED: f64 = 5.0;
/// Number of classes of returns per pulse; the last class has this number or more.
pub(super) const MOST_RETURNS: usize = 8;
/// Maximum number of positions along a strip.
const MOST_POSITIONS: usize = 64;
/// International and US survey foot, m.
const FOOT_M: f64 = 0.3048;
const US_SURVEY_FOOT_M: f64 = 1200.0 / 3937.0;

/// Facts about a strip, stored with its cells.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
pub struct StripFacts {
    /// Stem of the input.
    pub stem: String,
    /// Why the strip has no cells, if it has none.
    #[serde(default)]
    pub without_map: Option<String>,
    /// Coordinate reference system of the points as WKT.
    pub crs_wkt: Option<String>,
    /// Unit of the horizontal coordinates, m.
    pub unit_m: f64,
    /// Size of a cell of level 0, units of the coordinates.
    pub cell: f64,
    /// Binary logarithm of the strip's cell size relative to `cell`.
    pub level: u8,
    /// Lowest column and row of the cells, and highest ones, in cells of the strip.
    pub extent: Option<[[i32; 2]; 2]>,
    /// Number of scan lines.
    pub lines: u64,
    /// Number of shots, with or without returns.
    pub shots: u64,
    /// Number of waveforms: shots with an echo block.
    pub waveforms: u64,
    /// Waveforms without any return.
    pub waveforms_without_return: u64,
    /// Waveforms whose deviation ratio exceeds 5.
    pub unexplained_waveforms: u64,
    /// Number of returns, withheld ones included.
    pub returns: u64,
    /// Returns marked as outliers.
    pub withheld: u64,
    /// Points that are not withheld but have no valid coordinates.
    pub without_coordinates: u64,
    /// Number of shots with 1, 2, ... returns; the last number is of 8 or more.
    pub shots_by_returns: Vec<u64>,
    /// First and last time of a scan line, s, in the time scale of the recording.
    pub time_s: Option<[f64; 2]>,
    /// Median total standard deviation of the points, m.
    pub total_sd_m: Option<f64>,
    /// Total standard deviation below which 95 % of the points lie, m.
    pub total_sd_95_m: Option<f64>,
    /// Median standard deviation of the ranges, m.
    pub range_sd_m: Option<f64>,
    /// Positions along the strip: east and north of the middle of some scan lines.
    pub track: Vec<[f64; 2]>,
}

/// Collects the facts and cells of a strip; lines may come in any order and from any thread.
#[derive(Debug)]
pub struct StripCollector {
    state: Mutex<CollectorState>,
}

impl StripCollector {
    /// An empty collector; `cell_m` is the cell size of level 0, m.
    pub fn new(cell_m: f64) -> StripCollector {
        StripCollector { state: Mutex::new(CollectorState::new(cell_m)) }
    }

    /// Adds a line that leaves the chain.
    pub fn add(&self, line: &ScanLine) {
        self.locked().add(line);
    }

    /// Takes the strip collected so far and starts the next one.
    pub fn take(&self, stem: &str) -> CollectedStrip {
        let mut state = self.locked();
        let next = CollectorState::new(state.cell_m);
        std::mem::replace(&mut *state, next).finish(stem)
    }

    fn locked(&self) -> MutexGuard<'_, CollectorState> {
        self.state.lock().unpoisoned()
    }
}

/// A strip: facts, and cells from north to south, then from west to east.
#[derive(Clone, Debug)]
pub struct CollectedStrip {
    /// Facts about it.
    pub facts: StripFacts,
    pub(super) cells: Vec<PlacedCell>,
}

/// Units of coordinates, m.
#[derive(Clone, Copy, Debug)]
struct CoordinateUnits {
    horizontal_m: f64,
    height_m: f64,
}

/// What a map can be made of.
#[derive(Debug)]
struct Mapped {
    units: CoordinateUnits,
    crs_wkt: Option<String>,
    grid: StripGrid,
}

#[derive(Debug)]
struct CollectorState {
    cell_m: f64,
    /// Grid, or the reason why points cannot be mapped; set by the first point.
    map: Option<Result<Mapped, &'static str>>,
    lines: u64,
    shots: u64,
    waveforms: u64,
    empty: u64,
    unexplained: u64,
    returns: u64,
    withheld: u64,
    without_coordinates: u64,
    shots_by_returns: [u64; MOST_RETURNS],
    time_s: Option<[f64; 2]>,
    total_sd: Bins,
    range_sd: Bins,
    /// Lines whose number is a multiple of this have a position.
    every: u32,
    track: BTreeMap<u32, [f64; 2]>,
}

impl CollectorState {
    fn new(cell_m: f64) -> CollectorState {
        CollectorState {
            cell_m,
            map: None,
            lines: 0,
            shots: 0,
            waveforms: 0,
            empty: 0,
            unexplained: 0,
            returns: 0,
            withheld: 0,
            without_coordinates: 0,
            shots_by_returns: [0; MOST_RETURNS],
            time_s: None,
            total_sd: Bins::logarithmic(),
            range_sd: Bins::logarithmic(),
            every: 1,
            track: BTreeMap::new(),
        }
    }

    fn add(&mut self, line: &ScanLine) {
        self.lines += 1;
        self.shots += line.emissions.len() as u64;
        self.waveforms += line.stats.nw;
        self.empty += line.stats.nw_empty;
        let time_s = line.stats.gps_time_s;
        if time_s.is_finite() {
            let [first, last] = self.time_s.unwrap_or([time_s, time_s]);
            self.time_s = Some([first.min(time_s), last.max(time_s)]);
        }
        let Some(returns) = line.returns() else { return };
        self.returns += returns.len() as u64;
        for found in returns {
            self.count(found);
        }
        if let Some(points) = line.points() {
            self.add_points(line.line, &line.input, returns, points);
        }
    }

    fn count(&mut self, found: &Return) {
        self.withheld += u64::from(found.withheld);
        if found.return_number == 1 {
            let class = usize::from(found.number_of_returns.max(1)).min(MOST_RETURNS) - 1;
            self.shots_by_returns[class] += 1;
            self.unexplained += u64::from(found.deviation_ratio > UNEXPLAINED);
        }
        if !found.withheld {
            self.total_sd.add(found.total_sd_m);
            self.range_sd.add(found.range_sd_m);
        }
    }

    fn add_points(&mut self, line: u32, input: &InputInfo, returns: &[Return], points: &[[f64; 3]]) {
        let cell_m = self.cell_m;
        let Some(first) = points.first() else { return };
        let map = self.map.get_or_insert_with(|| mapped(input, *first, cell_m));
        let Ok(map) = map else { return };
        let mut ends: Option<[[f64; 3]; 2]> = None;
        for (found, point) in returns.iter().zip(points).filter(|(found, _)| !found.withheld) {
            match map.grid.add(found, *point, map.units.height_m) {
                true => ends = Some([ends.map_or(*point, |[first, _]| first), *point]),
                false => self.without_coordinates += 1,
            }
        }
        if let Some([first, last]) = ends.filter(|_| line.is_multiple_of(self.every)) {
            self.track.insert(line, [0, 1].map(|axis| 0.5 * (first[axis] + last[axis])));
        }
        while self.track.len() > MOST_POSITIONS {
            self.every = self.every.saturating_mul(2);
            let every = self.every;
            self.track.retain(|line, _| line.is_multiple_of(every));
        }
    }

    fn finish(self, stem: &str) -> CollectedStrip {
        let at = |bins: Bins, parts: [f64; 2]| {
            let histogram: Option<QuantityHistogram> = bins.finish("", "m");
            parts.map(|part| histogram.as_ref().and_then(|histogram| histogram.quantile(part)))
        };
        let [total_sd_m, total_sd_95_m] = at(self.total_sd, [0.5, 0.95]);
        let [range_sd_m, _] = at(self.range_sd, [0.5, 0.95]);
        let mut facts = StripFacts {
            stem: stem.to_owned(),
            without_map: None,
            crs_wkt: None,
            unit_m: 1.0,
            cell: self.cell_m,
            level: 0,
            extent: None,
            lines: self.lines,
            shots: self.shots,
            waveforms: self.waveforms,
            waveforms_without_return: self.empty,
            unexplained_waveforms: self.unexplained,
            returns: self.returns,
            withheld: self.withheld,
            without_coordinates: self.without_coordinates,
            shots_by_returns: self.shots_by_returns.to_vec(),
            time_s: self.time_s,
            total_sd_m,
            total_sd_95_m,
            range_sd_m,
            track: self.track.into_values().collect(),
        };
        let cells = match self.map {
            None => {
                facts.without_map = Some(WITHOUT_POINTS.to_owned());
                Vec::new()
            }
            Some(Err(reason)) => {
                facts.without_map = Some(reason.to_owned());
                Vec::new()
            }
            Some(Ok(map)) => {
                facts.crs_wkt = map.crs_wkt;
                facts.unit_m = map.units.horizontal_m;
                facts.cell = self.cell_m / map.units.horizontal_m;
                facts.level = map.grid.level();
                let cells = map.grid.finish();
                facts.extent = extent(&cells);
                cells
            }
        };
        CollectedStrip { facts, cells }
    }
}

const WITHOUT_POINTS: &str = "it has no points with coordinates; add the stage `georeference`";
const NOT_PROJECTED: &str = "its coordinates are not those of a map; set `crs` of `[job.geometry]` to a projected system such as `utm`";

/// Lowest column and row, and highest ones.
fn extent(cells: &[PlacedCell]) -> Option<[[i32; 2]; 2]> {
    let places = cells.iter().map(|cell| [cell.column, cell.row]);
    places.map(|at| [at, at]).reduce(|[low, high], [at, _]| {
        [[low[0].min(at[0]), low[1].min(at[1])], [high[0].max(at[0]), high[1].max(at[1])]]
    })
}

/// Grid for points like this one.
fn mapped(input: &InputInfo, point: [f64; 3], cell_m: f64) -> Result<Mapped, &'static str> {
    let view = MapProjection::of(input, point);
    if view.axes() != MapAxes::Coordinates {
        return Err(NOT_PROJECTED);
    }
    let units = units(input.crs_wkt.as_deref().unwrap_or_default());
    let grid = StripGrid::new(cell_m / units.horizontal_m);
    Ok(Mapped { units, crs_wkt: input.crs_wkt.clone(), grid })
}

/// Units of projected coordinates and of heights.
fn units(wkt: &str) -> CoordinateUnits {
    let unit = |text: &str| {
        let is = |words: [&str; 2]| words.iter().any(|word| text.contains(word));
        match (is(["US survey foot", "Foot_US"]), is(["foot", "Foot"])) {
            (true, _) => US_SURVEY_FOOT_M,
            (false, true) => FOOT_M,
            (false, false) => 1.0,
        }
    };
    let vertical = ["VERT_CS[", "VERTCRS["].iter().find_map(|word| wkt.find(word));
    let (horizontal, vertical) = wkt.split_at(vertical.unwrap_or(wkt.len()));
    let horizontal_m = unit(horizontal);
    let height_m = if vertical.is_empty() { horizontal_m } else { unit(vertical) };
    CoordinateUnits { horizontal_m, height_m }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::Arc;
    use wavex_line::scan_line::{Blocks, Content, Emission};

    fn line(number: u32, crs_wkt: Option<&str>, place: [f64; 2]) -> ScanLine {
        let input = InputInfo { crs_wkt: crs_wkt.map(str::to_owned), ..InputInfo::default() };
        let mut line =
            ScanLine::of_shots(Arc::new(input), number, vec![Emission::default()], Blocks::default());
        let first =
            Return { number_of_returns: 2, deviation_ratio: 6.0, range_sd_m: 0.01, ..Return::default() };
        let second = Return { return_number: 2, withheld: true, ..first };
        let point = [place[0], place[1], 10.0];
        line.content = Content::Points(vec![first, second], vec![point, point]);
        line
    }

    #[test]
    fn facts_are_counted_over_lines_in_any_order() {
        let lines: Vec<ScanLine> = (0..200).map(|i| line(i, None, [f64::from(i), 5.0])).collect();
        let [forwards, backwards] = [StripCollector::new(2.0), StripCollector::new(2.0)];
        lines.iter().for_each(|line| forwards.add(line));
        lines.iter().rev().for_each(|line| backwards.add(line));
        let [forwards, backwards] = [forwards.take("a"), backwards.take("a")];
        assert_eq!((&forwards.facts, &forwards.cells), (&backwards.facts, &backwards.cells));
        let facts = forwards.facts;
        assert_eq!((facts.lines, facts.shots, facts.returns, facts.withheld), (200, 200, 400, 200));
        assert_eq!((facts.unexplained_waveforms, facts.shots_by_returns[1]), (200, 200));
        assert_eq!(facts.extent, Some([[0, 2], [99, 2]]));
        assert_eq!((facts.track.len(), facts.track[1]), (50, [4.0, 5.0]));
        assert!(
            facts.range_sd_m.is_some_and(|sd_m| (sd_m / 0.01 - 1.0).abs() < 0.09)
                && facts.total_sd_m.is_none()
        );
    }

    #[test]
    fn coordinates_in_feet_have_cells_in_feet() {
        let collector = StripCollector::new(3.048);
        collector.add(&line(0, Some("PROJCS[\"a\",UNIT[\"foot\",0.3048]]"), [35.0, 5.0]));
        let strip = collector.take("a");
        assert_eq!((strip.facts.unit_m, strip.cells[0].column), (0.3048, 3));
        let mixed = units("PROJCS[UNIT[\"US survey foot\",0.3]],VERT_CS[UNIT[\"metre\",1]]");
        assert_eq!((mixed.horizontal_m, mixed.height_m), (US_SURVEY_FOOT_M, 1.0));
    }

    #[test]
    fn a_strip_without_a_map_says_why() {
        let collector = StripCollector::new(2.0);
        collector.add(&line(0, Some("GEOGCS[\"WGS 84\"]"), [11.0, 48.0]));
        let strip = collector.take("a");
        assert!(strip.cells.is_empty() && strip.facts.without_map.is_some_and(|why| why.contains("`crs`")));
        assert!(collector.take("b").facts.without_map.is_some_and(|why| why.contains("`georeference`")));
    }
}

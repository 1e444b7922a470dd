//! Overview of a run over one input: histograms, a map, classes, times, counts along the flight, the
//! flight itself, and a few waveforms with their fits.
//!
//! It is collected while lines leave the chain, in constant memory, and depends only on the lines,
//! not on their order: sums are of integers, bins and cells double on a fixed grid, and of several
//! equally suitable shots the first is shown.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard};

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use wavex_geodesy::time_axis::Alignment;
use wavex_geodesy::trajectory::Trajectory;
use wavex_line::scan_line::{Return, ScanLine};
use wavex_line::stage::{DecomposedLine, FitShot, Result, RunObserver, RunObservers};

mod flight;
mod footprints;
mod gallery;
pub(in crate::report) mod ground;
pub(in crate::report) mod histogram;
mod lines;
pub(in crate::report) mod map;
mod points;
mod times;
pub(crate) mod view;
mod weak_returns;
mod zones;

pub use crate::plot::Picture;
pub use flight::Flight;
pub use footprints::Footprints;
pub use gallery::{ShownKind, ShownReturn, ShownShot};
pub use ground::GroundSummary;
pub use histogram::QuantityHistogram;
pub use lines::LineGroups;
pub use map::{Densities, Density, MapLine, MapPicture};
pub use points::PointSummary;
pub use times::TimeCoverage;
pub use view::MapAxes;
pub use weak_returns::WeakReturns;
pub use zones::{ZoneCloud, ZoneClouds, ZoneShare, Zones};

use gallery::Gallery;
use histogram::{Bins, Quantity};
use lines::Groups;
use map::MapGrid;
use wavex_line::system::Unpoisoned as _;

/// Overview of a run over one input.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
pub struct Overview {
    /// Histograms of the quantities of returns; quantities without known values are omitted.
    pub histograms: Vec<QuantityHistogram>,
    /// Waveforms, returns and points along the flight.
    pub lines: LineGroups,
    /// Map of the points, if there are any.
    pub map: Option<MapPicture>,
    /// Returns by MTA zone, if there is a zone other than 0.
    #[serde(default)]
    pub zones: Option<Zones>,
    /// Extent, classes, return numbers and scan angles.
    #[serde(default)]
    pub points: Option<PointSummary>,
    /// Times of the shots, if they have any.
    #[serde(default)]
    pub times: Option<TimeCoverage>,
    /// Flight during the recording, with a trajectory.
    #[serde(default)]
    pub flight: Option<Flight>,
    /// Weak returns behind strong ones, if there are strong returns.
    #[serde(default)]
    pub weak_returns: Option<WeakReturns>,
    /// Ground, canopy and sensitivity, if the shots have large footprints.
    #[serde(default)]
    pub footprints: Option<Footprints>,
    /// Ground points, if the ground was searched.
    #[serde(default)]
    pub ground: Option<GroundSummary>,
    /// Selected waveforms with their fits.
    pub waveforms: Vec<ShownShot>,
}

/// Maximum length of a list of numbers in a stored overview.
const MOST_NUMBERS: usize = 100_000;

impl Overview {
    /// First list that is longer than a run makes it: a page would become very large.
    pub(in crate::report) fn excess(&self) -> Option<String> {
        let numbers = |name, length| (name, length, MOST_NUMBERS);
        let mut lists = vec![
            ("histograms", self.histograms.len(), 64),
            ("waveforms", self.waveforms.len(), 16),
            numbers("lines", self.lines.lines.len()),
            numbers("lines", self.lines.waveforms.len()),
            numbers("lines", self.lines.returns.len()),
            numbers("lines", self.lines.points.len()),
        ];
        let of_footprints = self.footprints.iter().flat_map(|found| &found.histograms);
        lists.push(("histograms of footprints", of_footprints.clone().count(), 64));
        let histograms = self.histograms.iter().chain(of_footprints);
        lists.extend(histograms.map(|of| numbers("counts", of.counts.len())));
        if let Some(map) = &self.map {
            lists.push(("lines of the map", map.lines.len(), 1000));
            lists.extend(map.lines.iter().map(|line| numbers("places", line.places.len())));
        }
        if let Some(zones) = &self.zones {
            lists.push(("shares", zones.shares.len(), 1000));
            let clouds = zones.clouds.iter().flat_map(|clouds| &clouds.clouds);
            lists.push(("clouds", clouds.clone().count(), 100));
            lists.extend(clouds.map(|cloud| numbers("points of a cloud", cloud.points.len())));
        }
        if let Some(points) = &self.points {
            lists.push(("shots_by_returns", points.shots_by_returns.len(), 10_000));
            lists.push(("by_return_number", points.by_return_number.len(), 10_000));
        }
        lists.extend(self.weak_returns.iter().map(|of| numbers("weak_returns", of.counts.len())));
        for shot in &self.waveforms {
            lists.push(("blocks", shot.blocks.len(), 64));
            for block in &shot.blocks {
                lists.push(("peaks", block.peaks.len(), 1000));
                lists.push(("pulses_dn", block.samples.pulses_dn.len(), 1000));
                lists.extend(block.samples.pulses_dn.iter().map(|pulse| numbers("pulses_dn", pulse.len())));
                lists.push(numbers("samples_dn", block.samples.samples_dn.len()));
                lists.push(numbers("fitted_dn", block.samples.fitted_dn.len()));
                lists.push(numbers("residual", block.samples.residual.len()));
            }
        }
        let (name, length, most) = lists.into_iter().find(|(_, length, most)| length > most)?;
        Some(format!("`{name}` has {length} entries, more than {most}"))
    }
}

/// Collects the overview of each input of a run.
#[derive(Debug, Default)]
pub struct Overviews(Mutex<BTreeMap<String, Arc<Collector>>>);

/// Collects the overview of one input.
#[derive(Debug, Default)]
struct Collector {
    gathering: Mutex<OverviewCollector>,
    gallery: Mutex<Gallery>,
}

impl Overviews {
    /// Returns the overview of an input that has ended.
    pub fn take(&self, stem: &str) -> Option<Overview> {
        let collector = locked(&self.0).remove(stem)?;
        let gallery = std::mem::take(&mut *locked(&collector.gallery));
        let gathering = std::mem::take(&mut *locked(&collector.gathering));
        Some(gathering.finish(gallery))
    }
}

impl RunObservers for Overviews {
    fn of_input(&self, stem: &str) -> Arc<dyn RunObserver> {
        let collector = Arc::<Collector>::default();
        locked(&self.0).insert(stem.to_owned(), Arc::clone(&collector));
        collector
    }
}

impl RunObserver for Collector {
    fn line(&self, line: &ScanLine) {
        locked(&self.gathering).add(line);
    }

    fn trajectory(&self, trajectory: &Trajectory, alignment: &Alignment) {
        let mut gathering = locked(&self.gathering);
        let span_s =
            gathering.times.span_s().map(|span_s| span_s.map(|time_s| alignment.on_trajectory(time_s)));
        gathering.flight = span_s.and_then(|span_s| Flight::of(trajectory, span_s));
    }

    /// Fits the shots to show, without holding the lock.
    fn decomposed(&self, line: &DecomposedLine, fit: &mut FitShot) -> Result<()> {
        let candidates = locked(&self.gallery).candidates(line);
        for candidate in candidates {
            if let Some(shot) = fit(candidate.emission)? {
                locked(&self.gallery).show(&candidate, shot);
            }
        }
        Ok(())
    }
}

fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unpoisoned()
}

/// Collects an [`Overview`] line by line, without the shots.
#[derive(Clone, Debug)]
struct OverviewCollector {
    quantities: [Quantity<Return>; 5],
    lines: Groups,
    grid: MapGrid,
    zones: zones::ZoneCounts,
    points: points::PointCounts,
    times: times::TimeCounts,
    flight: Option<Flight>,
    weak_returns: weak_returns::WeakReturnCounts,
    footprints: footprints::FootprintCounts,
    ground: ground::GroundCounts,
}

impl Default for OverviewCollector {
    fn default() -> OverviewCollector {
        OverviewCollector {
            quantities: [
                Quantity::new("amplitude", "DN", |r| r.amplitude_dn, Bins::logarithmic()),
                Quantity::new("width ratio", "", |r| r.width_ratio, Bins::linear(0.0, 0.02, 300)),
                Quantity::new("deviation ratio", "", |r| r.deviation_ratio, Bins::linear(-10.0, 0.25, 240)),
                Quantity::new("range uncertainty", "m", |r| r.range_sd_m, Bins::logarithmic()),
                Quantity::new("total uncertainty", "m", |r| r.total_sd_m, Bins::logarithmic()),
            ],
            lines: Groups::default(),
            grid: MapGrid::default(),
            zones: zones::ZoneCounts::default(),
            points: points::PointCounts::default(),
            times: times::TimeCounts::default(),
            flight: None,
            weak_returns: weak_returns::WeakReturnCounts::default(),
            footprints: footprints::FootprintCounts::default(),
            ground: ground::GroundCounts::default(),
        }
    }
}

impl OverviewCollector {
    /// Adds a line that leaves the chain.
    fn add(&mut self, scan_line: &ScanLine) {
        self.lines.add(scan_line);
        self.points.add(scan_line);
        self.times.add(scan_line);
        self.footprints.add(scan_line);
        self.ground.add(scan_line);
        let Some(returns) = scan_line.returns() else { return };
        for quantity in &mut self.quantities {
            // Copies of waveforms are no measurements of their own.
            let of_copy = |found: &Return| {
                scan_line.emissions.get(found.emission as usize).is_some_and(|emission| emission.is_copy())
            };
            let measured = returns.iter().filter(|found| !of_copy(found));
            measured.for_each(|found| quantity.add(found));
        }
        self.zones.add(scan_line, returns);
        self.weak_returns.add(scan_line, returns);
        if let Some(points) = scan_line.points() {
            self.grid.add_line(scan_line.line, &scan_line.input, returns, points);
        }
    }

    /// Returns the overview, with the selected waveforms.
    fn finish(self, gallery: Gallery) -> Overview {
        let histograms = self.quantities.into_iter();
        Overview {
            histograms: histograms.filter_map(Quantity::finish).collect(),
            lines: self.lines.finish(),
            map: self.grid.finish(),
            zones: self.zones.finish(),
            points: self.points.finish(),
            times: self.times.finish(),
            flight: self.flight,
            weak_returns: self.weak_returns.finish(),
            footprints: self.footprints.finish(),
            ground: self.ground.finish(),
            waveforms: gallery.finish(),
        }
    }
}

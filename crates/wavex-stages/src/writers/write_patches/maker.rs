//! Patches of a strip from its scan lines.

use std::sync::Arc;

use wavex_align::patch::{Patch, PatchCounts, PatchMaker, PatchReturn, PatchSettings};
use wavex_align::scanner::{BeamSource, Scanner, ScannerBeam};
use wavex_geodesy::frames::{Vector, inverse, rotate};
use wavex_geodesy::time_axis::Clock;
use wavex_line::georef::Geometry;
use wavex_line::georef::calibration::is_on_low_power_scale;
use wavex_line::scan_line::{Content, ScanLine};
use wavex_line::stage::{Result, StageError};

/// Makes patches from the lines of a strip, in their order.
pub struct StripMaker {
    geometry: Arc<Geometry>,
    scanner: Scanner,
    settings: PatchSettings,
    found: Option<Found>,
    /// Times of the shots of a line, s on the axis of the trajectory.
    times_s: Vec<f64>,
}

/// Content of a strip so far.
struct Found {
    maker: PatchMaker,
    clock: Clock,
    span_s: [f64; 2],
    n_shots: u64,
}

/// A strip with its patches.
#[derive(Clone, Debug)]
pub struct StripPatches {
    /// Trajectory and installation.
    pub geometry: Arc<Geometry>,
    /// Size of the cells, m.
    pub cell_m: f64,
    /// Time scale of the trajectory.
    pub clock: Clock,
    /// First and last shot, s on the axis of the trajectory.
    pub span_s: [f64; 2],
    /// Number of shots with a pose.
    pub n_shots: u64,
    /// Cells without a patch.
    pub counts: PatchCounts,
    /// Patches of strip 0, in the order of keeping of [`PatchMaker`].
    pub patches: Vec<Patch>,
}

/// Scanner with mount and calibration of a job.
pub(crate) fn scanner_of(geometry: &Geometry) -> Scanner {
    Scanner {
        body_from_mount: geometry.keys().mount.unwrap_or_default().body_from_scanner(),
        calibration: *geometry.installation().calibration(),
    }
}

impl StripMaker {
    /// For a strip with this trajectory and installation.
    pub fn new(geometry: Arc<Geometry>, settings: PatchSettings) -> StripMaker {
        StripMaker { scanner: scanner_of(&geometry), geometry, settings, found: None, times_s: Vec::new() }
    }

    /// Adds the points of a line.
    ///
    /// # Errors
    /// The recording is already georeferenced.
    pub fn add(&mut self, line: &ScanLine) -> Result<()> {
        let Some(first) = line.emissions.first() else { return Ok(()) };
        let Some(alignment) = line.input.first_shot.and_then(|shot| shot.alignment) else {
            return Err(StageError::failed(
                "patches need beams in the frame of the scanner, but this recording is already georeferenced or has no \
                 trajectory",
                "give the recording of the instrument, and `trajectory` in `[job.geometry]`",
            ));
        };
        self.times_s.clear();
        self.times_s
            .extend(line.emissions.iter().map(|emission| alignment.on_trajectory(emission.gps_time_s)));
        let first_s = alignment.on_trajectory(first.gps_time_s);
        let found = self.found.get_or_insert_with(|| Found {
            maker: PatchMaker::on_tiles(self.settings),
            clock: alignment.trajectory.clock,
            span_s: [first_s; 2],
            n_shots: 0,
        });
        for &time_s in &self.times_s {
            found.span_s = [found.span_s[0].min(time_s), found.span_s[1].max(time_s)];
        }
        found.n_shots += line.emissions.len() as u64;
        let Content::Points(returns, _) = &line.content else { return Ok(()) };
        for given in returns.iter().filter(|given| !given.withheld) {
            let index = given.emission as usize;
            let shot = line.emissions.get(index).zip(self.times_s.get(index));
            let Some((emission, &time_s)) = shot else { continue };
            let point_in_ecef_m: Vector = std::array::from_fn(|axis| {
                emission.origin_m[axis] + given.range_m * emission.direction[axis]
            });
            let on_low_power_scale = is_on_low_power_scale(given.channel, line.fusion.is_some());
            found.maker.add(&PatchReturn {
                // `finish` makes beams of the ends.
                beam: ScannerBeam { time_s, ..ScannerBeam::default() },
                source: BeamSource { origin_m: [0.0; 3], on_low_power_scale },
                range_sd_m: given.range_sd_m,
                n_returns: given.number_of_returns,
                point_in_ecef_m,
                direction_in_ecef: emission.direction,
            });
        }
        Ok(())
    }

    /// The strip; `None` if no shot has a pose.
    pub fn finish(self) -> Option<StripPatches> {
        let Found { maker, clock, span_s, n_shots } = self.found?;
        let (scanner, geometry, cell_m) = (self.scanner, self.geometry, self.settings.cell_m);
        let (_, trajectory) = geometry.trajectory()?;
        let mut poses = trajectory.poses();
        let (patches, counts) = maker.finish_with(|ends_m, patch| {
            let mut beams = patch.beams;
            for (beam, end_m) in beams.iter_mut().zip(ends_m) {
                let time_s = beam.time_s + scanner.calibration.time_offset_s;
                let pose = poses.at(time_s)?;
                let corrections = geometry.corrections();
                let pose = corrections.map_or(pose, |corrections| corrections.at(time_s).applied_to(&pose));
                let from_nav_m = std::array::from_fn(|axis| end_m[axis] - pose.origin_in_ecef_m[axis]);
                // Counted from the origin of the scanner, whatever the recording counts from.
                let in_body_m = rotate(&inverse(&pose.ecef_from_body), from_nav_m);
                *beam = scanner.beam_to(beam.time_s, in_body_m, patch.source.on_low_power_scale)?;
            }
            Some(beams)
        });
        Some(StripPatches { geometry, cell_m, clock, span_s, n_shots, counts, patches })
    }
}

//! Shot geometry: positions across the line, and expected ranges to the ground.

use std::sync::Arc;

use wavex_formats::terrain::Terrain;
use wavex_geodesy::cone::Turning;
use wavex_geodesy::vertical::{down_at, main_axis};
use wavex_line::georef::Geometry as Placed;
use wavex_line::georef::output_crs::OutputCrs;
use wavex_line::scan_line::{Emission, Frame, ScanLine};
use wavex_line::stage::{Result, StageError};
use wavex_returns::mta;

/// Smallest change of direction, m per m, that defines a sweep direction.
const LEAST_SWEEP: f64 = 1e-6;
/// Length over which an earth-frame beam is treated as straight in the projected CRS, m.
const REACH_M: f64 = 1000.0;
/// A scanner is not circular after this many restarts of the cone search, or this many beams.
const MOST_RESTARTS: usize = 3;
const MOST_BEAMS: usize = 4096;

/// Beam geometry of a recording.
#[derive(Clone, Debug)]
pub(super) struct BeamGeometry {
    frame: Frame,
    range_m: [f64; 2],
    /// Straight down, or the best estimate in frames without a vertical.
    down: [f64; 3],
    /// Projected CRS of the terrain model, if beams are in the earth-centred frame.
    map: Option<Arc<OutputCrs>>,
    /// Direction across the line: from the first shot of a line to its last, or between consecutive
    /// lines of one shot; `None` until there were two shots.
    across: Option<[f64; 3]>,
    /// The last beam so far.
    last: Option<[f64; 3]>,
    turning: Turning,
    beams: usize,
    /// Whether beams turn on a cone; `None` until known.
    is_circular: Option<bool>,
}

impl BeamGeometry {
    /// The geometry of a recording, from its first line.
    ///
    /// In the scanner frame, down is the axis nearest to the mean direction of the line.
    pub fn of(
        line: &ScanLine,
        range_m: [f64; 2],
        terrain: Option<&Terrain>,
        placed: &Placed,
    ) -> Result<BeamGeometry> {
        let frame = line.input.frame;
        let map = match terrain {
            Some(terrain) if frame == Frame::Earth => {
                placed.map_of(&line.input, terrain.epsg())?.map(Arc::new)
            }
            _ => None,
        };
        if terrain.is_some() && frame != Frame::Map && map.is_none() {
            let frame = if frame == Frame::Scanner { "scanner" } else { "body" };
            return Err(StageError::failed(
                format!(
                    "a terrain model needs georeferenced shots, but those of this recording are in the \
                     {frame} frame, without a trajectory"
                ),
                "give the `trajectory` in `[job.geometry]`, or `agl_m` instead of `terrain`",
            ));
        }
        let down = match (frame, line.emissions.first()) {
            (Frame::Map | Frame::Earth, Some(first)) => down_at(frame, first.origin_m),
            _ => None,
        };
        let down = down.unwrap_or_else(|| match frame {
            Frame::Body => [0.0, 0.0, 1.0],
            _ => main_axis(line.emissions.iter().map(|emission| emission.direction)),
        });
        Ok(BeamGeometry {
            frame,
            range_m,
            down,
            map,
            across: None,
            last: None,
            turning: Turning::default(),
            beams: 0,
            is_circular: None,
        })
    }

    /// Adds the beams of the next line; returns whether the scanner type is known.
    pub fn follow(&mut self, emissions: &[Emission]) -> bool {
        if self.is_circular != Some(false) {
            emissions.iter().for_each(|emission| self.turning.add(emission.direction));
            self.beams += emissions.len();
        }
        if self.turning.cone().is_some() {
            self.is_circular.get_or_insert(true);
        } else if self.turning.restarts() >= MOST_RESTARTS || self.beams >= MOST_BEAMS {
            self.is_circular.get_or_insert(false);
        }
        self.is_circular.is_some()
    }

    /// Whether positions across the line are azimuths; settles the answer if still unknown.
    pub fn is_circular(&mut self) -> bool {
        *self.is_circular.get_or_insert(false)
    }

    /// Determines the direction across the line.
    pub fn learn(&mut self, emissions: &[Emission]) {
        if self.across.is_some() {
            return;
        }
        let (Some(first), Some(last)) = (emissions.first(), emissions.last()) else { return };
        let first =
            self.last.replace(last.direction).filter(|_| emissions.len() == 1).unwrap_or(first.direction);
        let step: [f64; 3] = std::array::from_fn(|axis| last.direction[axis] - first[axis]);
        let fall = dot(step, self.down);
        let level: [f64; 3] = std::array::from_fn(|axis| step[axis] - fall * self.down[axis]);
        let length = dot(level, level).sqrt();
        if length > LEAST_SWEEP {
            self.across = Some(level.map(|part| part / length));
        }
    }

    /// Converts a shot for the kernel.
    pub fn emission(&self, emission: &Emission, terrain: Option<&Terrain>) -> mta::Emission {
        let cos_nadir = dot(emission.direction, self.down);
        let expected_m = terrain.map_or(f64::NAN, |terrain| {
            let (origin_m, beam) = self.in_map(emission);
            terrain.range_m(origin_m, beam, self.range_m)
        });
        mta::Emission {
            clock_ps: emission.clock_ps,
            shot: emission.shot,
            scan_angle_deg: self.scan_angle_deg(emission, cos_nadir) as f32,
            cos_nadir: cos_nadir as f32,
            prior_range_m: expected_m as f32,
        }
    }

    /// Beam origin in the projected CRS, and its displacement per metre; NaN outside the CRS.
    fn in_map(&self, emission: &Emission) -> ([f64; 3], [f64; 3]) {
        let (origin_m, direction) = (emission.origin_m, emission.direction);
        let Some(map) = &self.map else {
            return (origin_m, direction.map(|d| d * emission.frame_scale));
        };
        let far_m = std::array::from_fn(|axis| origin_m[axis] + REACH_M * direction[axis]);
        let [near, far] = [origin_m, far_m].map(|place_m| map.coordinates(place_m).unwrap_or([f64::NAN; 3]));
        (near, std::array::from_fn(|axis| (far[axis] - near[axis]) / REACH_M))
    }

    /// Position across the line, degrees: azimuth on a cone, else the recorded scan angle, else the
    /// angle of the beam.
    fn scan_angle_deg(&self, emission: &Emission, cos_nadir: f64) -> f64 {
        if let (Some(true), Some(cone)) = (self.is_circular, self.turning.cone()) {
            return cone.azimuth_rad(emission.direction).to_degrees();
        }
        match (self.frame, self.across) {
            _ if emission.scan_angle_deg.is_finite() => f64::from(emission.scan_angle_deg),
            (Frame::Scanner | Frame::Body | Frame::Earth, Some(across)) => {
                dot(emission.direction, across).atan2(cos_nadir).to_degrees()
            }
            _ => f64::NAN,
        }
    }
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

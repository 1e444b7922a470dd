//! `georeference`: converts returns to points with coordinates.

use std::sync::Arc;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use wavex_geodesy::frames::Vector;
use wavex_line::georef::Geometry;
use wavex_line::georef::calibration::is_on_low_power_scale;
use wavex_line::georef::output_crs::OutputCrs;
use wavex_line::georef::scan_angles::complete_in_own_axes;
use wavex_line::scan_line::{Content, Emission, Frame, InputInfo, Kind, Return, ScanLine};
use wavex_line::stage::{Config, Context, Map, MapConfig, Result, RunContext, StageError, StageSpec};

mod above_ground;
mod physics;
mod uncertainty;

use above_ground::ReferenceLevel;
pub(crate) use physics::checks;
use uncertainty::Uncertainty;

/// Registry entry of the stage.
pub const STAGE: StageSpec =
    StageSpec::map::<Georeference>("georeference", &[Kind::Returns], Some(Kind::Points));

/// Computes the coordinates of every return.
///
/// **With a trajectory** (`[job.geometry]`), beams are already in the earth-centred frame. A point
/// is beam origin + direction × range, converted to the coordinates set by `crs`, `geoid` and
/// `unit` of `[job.geometry]`. Defaults are UTM in the zone of the first shot and ellipsoidal
/// heights in metres. Ranges are first corrected by `e0`, `e1` and `e7` of the calibration.
/// `docs/explanation/georeferencing.md` gives the formulas. If the trajectory has accuracies
/// (`trajectory_accuracy`), each point gets its total standard deviation.
///
/// **Already earth-centred** (PulseWaves in ECEF, containers with poses): as with a trajectory, but
/// without one.
///
/// **Already in a projected CRS** (LAS, other PulseWaves, `simulate` without a trajectory): points stay
/// in that CRS, and ranges are scaled along each beam like the geometry of the input. Another `crs` is
/// an error; `crs_of_input` of the reader names the CRS of the recording.
///
/// **Otherwise**, points stay in the frame of the aircraft or the scanner, and the report says so.
///
/// The coordinate reference system is written to the outputs. `AGL` of the line statistics is the
/// height of the sensor above the ground of the line: the median difference between the heights of
/// beam origin and point, over the last returns of the shots that are not withheld. Both heights
/// are ellipsoidal, or those of the projected CRS.
///
/// Counts `n_georef`.
#[derive(Clone, Debug, Default, Deserialize, Serialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Georeference {
    /// Without a trajectory: velocity, m/s, that spreads scan lines for viewing. Points are moved
    /// along the first axis (forward, with the `mount` of the scanner) by this velocity times the
    /// time since the first shot.
    #[schemars(range(min = -1000.0, max = 1000.0))]
    pub dummy_velocity_mps: f64,
}

impl Config for Georeference {}

impl MapConfig for Georeference {
    fn make(&self, run: &RunContext) -> Result<Box<dyn Map>> {
        Ok(Box::new(Georeferencer {
            geometry: Arc::clone(&run.geometry),
            dummy_velocity_mps: self.dummy_velocity_mps,
            target: None,
            input: None,
        }))
    }

    fn conclude(&self, cx: &mut Context) {
        physics::conclude(cx);
    }
}

struct Georeferencer {
    geometry: Arc<Geometry>,
    dummy_velocity_mps: f64,
    /// Output CRS.
    target: Option<OutputCrs>,
    /// Metadata of the incoming lines, and of the outgoing lines.
    input: Option<[Arc<InputInfo>; 2]>,
}

impl Map for Georeferencer {
    fn map(&mut self, mut line: ScanLine, cx: &mut Context) -> Result<ScanLine> {
        let Content::Returns(mut returns) = line.content else {
            return Err(StageError::failed("georeference received no returns", "put decompose before it"));
        };
        let frame = line.input.frame;
        if frame != Frame::Map {
            self.correct_ranges(&line.input, &mut returns, line.fusion.is_some(), cx);
        }
        let mut points: Vec<Vector> =
            returns.iter().map(|r| position(&line.emissions[r.emission as usize], r)).collect();
        line.stats.agl_m = ReferenceLevel::of(frame, &line.emissions)
            .filter(|_| line.input.origin_is_sensor)
            .and_then(|level| level.agl_m(&line.emissions, &returns, &points));
        physics::count(&line.input, &line.emissions, &returns, &points, cx);
        match frame {
            Frame::Map => self.keep_map(&line.input, cx)?,
            Frame::Earth => {
                Uncertainty::new(&self.geometry, &line.input).set(&line.emissions, &points, &mut returns);
                self.project(&mut line.input, &mut points, cx)?;
            }
            Frame::Scanner | Frame::Body => {
                self.geometry.judge(&line.input)?;
                let axes = if frame == Frame::Body { "body frame of the aircraft" } else { "scanner frame" };
                cx.warn(format!(
                    "the input is not georeferenced: its points are in the {axes}; give [job.geometry] a `trajectory` \
                     and a `crs`"
                ));
                complete_in_own_axes(frame, &mut line.emissions);
                self.spread(&line.input, &line.emissions, &returns, &mut points);
            }
        }
        line.stats.n_georef = points.len() as u64;
        line.content = Content::Points(returns, points);
        Ok(line)
    }
}

impl Georeferencer {
    /// Applies the range calibration.
    fn correct_ranges(&self, input: &InputInfo, returns: &mut [Return], fused: bool, cx: &mut Context) {
        let mut calibration = *self.geometry.installation().calibration();
        if !input.origin_is_sensor && calibration.e1 != 0.0 {
            cx.warn(
                "ranges are not corrected by `e1`: the recording does not contain the sensor position, and ranges count \
                 from a point near the waveform; remove `e1` from the calibration",
            );
            calibration.e1 = 0.0;
        }
        for r in returns {
            r.range_m = calibration.range_m(r.range_m, is_on_low_power_scale(r.channel, fused));
        }
    }

    /// Converts points from the earth-centred frame to the output CRS.
    fn project(&mut self, input: &mut Arc<InputInfo>, points: &mut [Vector], cx: &mut Context) -> Result<()> {
        // Without a first shot there are no points.
        if self.target.is_none() {
            self.geometry.judge(input)?.into_iter().for_each(|problem| cx.warn(problem));
            self.target = self.geometry.target(input)?;
        }
        let Some(target) = &self.target else { return Ok(()) };
        target.replace(points)?;
        *input = match &self.input {
            Some([from, to]) if Arc::ptr_eq(from, input) => Arc::clone(to),
            _ => {
                let (crs_wkt, coordinate_grid) = (Some(target.wkt().to_owned()), target.grid());
                let to = Arc::new(InputInfo { crs_wkt, coordinate_grid, ..InputInfo::clone(input) });
                self.input = Some([Arc::clone(input), Arc::clone(&to)]);
                to
            }
        };
        Ok(())
    }

    /// Checks once that points in a projected CRS may stay there.
    fn keep_map(&mut self, input: &Arc<InputInfo>, cx: &mut Context) -> Result<()> {
        if !self.input.as_ref().is_some_and(|[from, _]| Arc::ptr_eq(from, input)) {
            self.geometry.judge(input)?.into_iter().for_each(|problem| cx.warn(problem));
            self.input = Some([Arc::clone(input), Arc::clone(input)]);
        }
        Ok(())
    }

    /// Spreads points along a straight flight at the dummy velocity.
    fn spread(&self, input: &InputInfo, emissions: &[Emission], returns: &[Return], points: &mut [Vector]) {
        if self.dummy_velocity_mps == 0.0 {
            return;
        }
        let first_s = input.first_shot.map_or(0.0, |first| first.time_s);
        for (point, r) in points.iter_mut().zip(returns) {
            let since_s = emissions[r.emission as usize].time_s() - first_s;
            point[0] += self.dummy_velocity_mps * since_s;
        }
    }
}

/// Position of a return in the frame of its shot, m.
fn position(emission: &Emission, r: &Return) -> Vector {
    let reach_m = r.range_m * emission.frame_scale;
    std::array::from_fn(|axis| emission.origin_m[axis] + emission.direction[axis] * reach_m)
}

//! Outliers by a model: returns that contradict other beams.

use wavex_geodesy::vertical::{down_at, main_axis};
use wavex_ground::point::CloudPoint;
use wavex_ground::rays::{NoiseSettings, mark_noise};
use wavex_line::scan_line::{Frame, Return, ScanLine};
use wavex_line::stage::{Output, Result, RunContext, Transform};

use super::geometry::{AssumedMotion, ReturnPositions, dot, has_vertical};
use crate::process::classify::cloud::level_axes;
use crate::process::line_blocks::{LineBlocks, mark, set_classes};

/// Length of blocks, and of the lines around them that take part, m.
const BLOCK_AND_MARGIN_M: [f64; 2] = [250.0, 100.0];
/// Mean radius of the earth (IUGG 1980), m.
const RADIUS_M: f64 = 6_371_008.8;

/// Holds blocks of lines and marks their noise.
pub(super) struct ModelFilter {
    blocks: LineBlocks,
    motion: AssumedMotion,
    level: Option<Level>,
}

/// Level frame at the first beam of a recording.
struct Level {
    origin_m: [f64; 3],
    axes: [[f64; 3]; 3],
    /// Half the curvature of the earth in this frame, 1/m.
    half_curvature: f64,
}

impl ModelFilter {
    pub(super) fn new(step_m: f64, run: &RunContext) -> ModelFilter {
        let settings = NoiseSettings { step_m, ..NoiseSettings::default() };
        let blocks = LineBlocks::new(
            BLOCK_AND_MARGIN_M,
            run.pool.clone(),
            Box::new(move |points| mark_noise(points, &settings)),
            Box::new(|scan_line, classes| set_classes(scan_line, classes, mark)),
        );
        ModelFilter { blocks, motion: AssumedMotion::default(), level: None }
    }
}

impl Transform for ModelFilter {
    fn process(&mut self, line: ScanLine, out: &mut Output) -> Result<()> {
        if !has_vertical(line.input.frame) {
            out.cx.info("without a trajectory, outliers are detected as if the sensor moved straight on by half a shot spacing per line");
        }
        let places = ReturnPositions::of(&line, &mut self.motion);
        if self.level.is_none() {
            self.level = Level::of(&line);
        }
        let returns = line.returns().map(Vec::as_slice).unwrap_or_default();
        let cloud = match &self.level {
            Some(level) => level.cloud(&line, returns, &places),
            None => Vec::new(),
        };
        self.blocks.push(line, cloud, places.middle_m, out)
    }

    fn finish(&mut self, out: &mut Output) -> Result<()> {
        self.blocks.finish(out)
    }
}

impl Level {
    /// Frame at the first shot of a line; `None` without shots.
    fn of(line: &ScanLine) -> Option<Level> {
        let frame = line.input.frame;
        let first = line.emissions.first()?;
        let down = down_at(frame, first.origin_m)
            .unwrap_or_else(|| main_axis(line.emissions.iter().map(|emission| emission.direction)));
        let half_curvature = if frame == Frame::Earth { 0.5 / RADIUS_M } else { 0.0 };
        let unit_m = line.input.map_unit_m();
        Some(Level { origin_m: first.origin_m.map(|x| unit_m * x), axes: level_axes(down), half_curvature })
    }

    /// Points of a line.
    fn cloud(&self, line: &ScanLine, returns: &[Return], places: &ReturnPositions) -> Vec<CloudPoint> {
        let point = |(r, place): (&Return, &wavex_returns::outliers::LinePoint)| {
            let from_origin = [0, 1, 2].map(|axis| place.position_m[axis] - self.origin_m[axis]);
            let [east, north, up] = self.axes.map(|axis| dot(axis, from_origin));
            let up = up + self.half_curvature * (east * east + north * north);
            let direction = line.emissions.get(r.emission as usize).map_or([0.0; 3], |shot| shot.direction);
            CloudPoint {
                beam: self.axes.map(|axis| dot(axis, direction) as f32),
                return_number: r.return_number,
                n_returns: r.number_of_returns,
                ..CloudPoint::at([east, north, up])
            }
        };
        returns.iter().zip(places.line.points()).map(point).collect()
    }
}

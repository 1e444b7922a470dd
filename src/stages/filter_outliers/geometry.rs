//! A line of returns as the search for outliers sees it.

use crate::batch::{Batch, Emission, Frame};
use crate::geo::vertical::{down_at, main_axis};
use crate::kernels::outliers::{Extent, Line, Point};

/// Beams nearer to each other than this have no direction between them, m per m.
const LEAST_SWEEP: f64 = 1e-9;

/// Where the returns of a line are.
#[derive(Debug)]
pub(super) struct Places {
    /// The returns, in their order in the batch.
    pub(super) line: Line,
    /// Distance of neighbouring shots at each return, m.
    pub(super) spacing_m: Vec<f32>,
    /// Heights of the returns over any level, m.
    pub(super) height_m: Vec<f64>,
    /// Where the middle shot's beam begins, m; `None` without shots.
    pub(super) middle_m: Option<[f64; 3]>,
}

/// Whether lines of this frame tell of each other.
pub(super) fn has_vertical(frame: Frame) -> bool {
    matches!(frame, Frame::Map | Frame::Earth)
}

impl Places {
    pub(super) fn of(batch: &Batch) -> Places {
        let emissions = &batch.emissions;
        let down = emissions.first().and_then(|first| down_at(batch.input.frame, first.origin_m));
        let down = down.unwrap_or_else(|| main_axis(emissions.iter().map(|emission| emission.direction)));
        let returns = batch.returns().map(Vec::as_slice).unwrap_or_default();
        let mut points = Vec::with_capacity(returns.len());
        let mut spacing_m = Vec::with_capacity(returns.len());
        let mut height_m = Vec::with_capacity(returns.len());
        let unknown = Emission::default();
        for r in returns {
            let emission = emissions.get(r.emission as usize).unwrap_or(&unknown);
            let reach_m = r.range_m * emission.frame_scale;
            let position_m: [f64; 3] =
                std::array::from_fn(|axis| emission.origin_m[axis] + emission.direction[axis] * reach_m);
            points.push(Point { position_m, waveform: r.emission });
            spacing_m.push((reach_m.abs() * turn(emissions, r.emission as usize)) as f32);
            height_m.push(-dot(position_m, down));
        }
        let along = along(emissions, down);
        let middle_m = emissions.get(emissions.len() / 2).map(|middle| middle.origin_m);
        Places { line: Line::new(points, along), spacing_m, height_m, middle_m }
    }

    /// The memory taken, bytes.
    pub(super) fn bytes(&self) -> usize {
        self.line.bytes()
            + self.spacing_m.capacity() * size_of::<f32>()
            + self.height_m.capacity() * size_of::<f64>()
    }

    /// The highest and the lowest of some returns of one waveform; `None` of none.
    pub(super) fn extent(&self, returns: std::ops::Range<usize>) -> Option<Extent> {
        let place =
            |index: usize| Some((self.line.points().get(index)?.position_m, *self.height_m.get(index)?));
        let places = || returns.clone().filter_map(place);
        let by_height = |a: &([f64; 3], f64), b: &([f64; 3], f64)| a.1.total_cmp(&b.1);
        Some(Extent { highest: places().max_by(by_height)?, lowest: places().min_by(by_height)? })
    }
}

/// How far the beam turns from one shot to the next, m per m.
fn turn(emissions: &[Emission], shot: usize) -> f64 {
    let between = |a: usize, b: usize| {
        let (a, b) = (emissions.get(a)?, emissions.get(b)?);
        let step: [f64; 3] = std::array::from_fn(|axis| b.direction[axis] - a.direction[axis]);
        Some(dot(step, step).sqrt())
    };
    between(shot, shot + 1).or_else(|| between(shot.checked_sub(1)?, shot)).unwrap_or(0.0)
}

/// The level direction from the first shot of a line to its last; any where there is none.
fn along(emissions: &[Emission], down: [f64; 3]) -> [f64; 3] {
    let any = if down[0].abs() < 0.6 { [1.0, 0.0, 0.0] } else { [0.0, 1.0, 0.0] };
    let (Some(first), Some(last)) = (emissions.first(), emissions.last()) else { return any };
    let step: [f64; 3] = std::array::from_fn(|axis| last.direction[axis] - first.direction[axis]);
    let fall = dot(step, down);
    let level: [f64; 3] = std::array::from_fn(|axis| step[axis] - fall * down[axis]);
    let length = dot(level, level).sqrt();
    if length > LEAST_SWEEP { level.map(|part| part / length) } else { any }
}

pub(super) fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

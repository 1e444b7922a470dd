//! Positions of a line's returns for the outlier search.

use wavex_geodesy::vertical::{down_at, main_axis};
use wavex_line::scan_line::{Emission, Frame, ScanLine};
use wavex_returns::outliers::{Extent, LinePoint, PointLine};
use wavex_simd::statistics::median;

/// Smallest change of direction, m per m, that defines a sweep direction.
const LEAST_SWEEP: f64 = 1e-9;
/// Assumed line spacing without a trajectory, as a multiple of the shot spacing.
///
/// docs/explanation/outliers.md compares values.
const ASSUMED_LINE_SPACING: f64 = 0.5;

/// Positions of the returns of a line.
#[derive(Debug)]
pub(super) struct ReturnPositions {
    /// The returns, in their order in the line.
    pub(super) line: PointLine,
    /// Spacing to the neighbouring shot at each return, m.
    pub(super) spacing_m: Vec<f32>,
    /// Heights of the returns above an arbitrary level, m.
    pub(super) height_m: Vec<f64>,
    /// Beam origin of the middle shot, m; `None` without shots.
    pub(super) middle_m: Option<[f64; 3]>,
}

/// Whether this frame is fixed to the earth.
pub(super) fn has_vertical(frame: Frame) -> bool {
    matches!(frame, Frame::Map | Frame::Earth)
}

/// Assumed motion of a sensor without a trajectory: straight on, by half a shot spacing per line.
#[derive(Debug, Default)]
pub(super) struct AssumedMotion {
    /// Unit vector, across the first line with a sweep.
    forward: Option<[f64; 3]>,
    /// Median shot spacing of the last line with returns, m.
    spacing_m: f64,
    /// Distance from the first line, m.
    distance_m: f64,
}

impl AssumedMotion {
    /// Offset of the next line from the first one, m.
    fn next_m(&mut self, spacings_m: &[f32], across: Option<[f64; 3]>) -> [f64; 3] {
        self.forward = self.forward.or(across);
        self.spacing_m = median(spacings_m.iter().copied().map(f64::from))
            .filter(|m| m.is_finite())
            .unwrap_or(self.spacing_m);
        self.distance_m += ASSUMED_LINE_SPACING * self.spacing_m;
        self.forward.map_or([0.0; 3], |forward| forward.map(|part| part * self.distance_m))
    }
}

impl ReturnPositions {
    /// Positions of a line's returns; `motion` applies if the frame has no vertical.
    pub(super) fn of(scan_line: &ScanLine, motion: &mut AssumedMotion) -> ReturnPositions {
        let emissions = &scan_line.emissions;
        let down = emissions.first().and_then(|first| down_at(scan_line.input.frame, first.origin_m));
        let down = down.unwrap_or_else(|| main_axis(emissions.iter().map(|emission| emission.direction)));
        let returns = scan_line.returns().map(Vec::as_slice).unwrap_or_default();
        let mut points = Vec::with_capacity(returns.len());
        let mut spacing_m = Vec::with_capacity(returns.len());
        let mut height_m = Vec::with_capacity(returns.len());
        let unknown = Emission::default();
        let unit_m = scan_line.input.map_unit_m();
        for r in returns {
            let emission = emissions.get(r.emission as usize).unwrap_or(&unknown);
            let reach = r.range_m * emission.frame_scale;
            let position_m: [f64; 3] = std::array::from_fn(|axis| {
                unit_m * (emission.origin_m[axis] + emission.direction[axis] * reach)
            });
            points.push(LinePoint { position_m, waveform: r.emission });
            let apart_m = match scan_line.input.origin_is_sensor {
                true => unit_m * reach.abs() * turn(emissions, r.emission as usize),
                false => to_next_beam_m(emissions, r.emission as usize, position_m, unit_m),
            };
            spacing_m.push(apart_m as f32);
            height_m.push(-dot(position_m, down));
        }
        let sweep = sweep(emissions, down);
        let mut middle_m =
            emissions.get(emissions.len() / 2).map(|middle| middle.origin_m.map(|x| unit_m * x));
        if !has_vertical(scan_line.input.frame) {
            let offset_m = motion.next_m(&spacing_m, sweep.map(|along| cross(along, down)));
            let positions = points.iter_mut().map(|point| &mut point.position_m).chain(&mut middle_m);
            positions.for_each(|position_m| (0..3).for_each(|axis| position_m[axis] += offset_m[axis]));
        }
        // Any direction is right without a sweep; it only affects the speed of searches.
        let along = sweep.unwrap_or([1.0, 0.0, 0.0]);
        ReturnPositions { line: PointLine::new(points, along), spacing_m, height_m, middle_m }
    }

    /// Memory used, bytes.
    pub(super) fn bytes(&self) -> usize {
        self.line.bytes()
            + self.spacing_m.capacity() * size_of::<f32>()
            + self.height_m.capacity() * size_of::<f64>()
    }

    /// Highest and lowest of some returns of one waveform; `None` if empty.
    pub(super) fn extent(&self, returns: std::ops::Range<usize>) -> Option<Extent> {
        let place =
            |index: usize| Some((self.line.points().get(index)?.position_m, *self.height_m.get(index)?));
        let places = || returns.clone().filter_map(place);
        let by_height = |a: &([f64; 3], f64), b: &([f64; 3], f64)| a.1.total_cmp(&b.1);
        Some(Extent { highest: places().max_by(by_height)?, lowest: places().min_by(by_height)? })
    }
}

/// Change of beam direction from one shot to the next, m per m.
fn turn(emissions: &[Emission], shot: usize) -> f64 {
    let between = |a: usize, b: usize| {
        let (a, b) = (emissions.get(a)?, emissions.get(b)?);
        let step: [f64; 3] = std::array::from_fn(|axis| b.direction[axis] - a.direction[axis]);
        Some(dot(step, step).sqrt())
    };
    between(shot, shot + 1).or_else(|| between(shot.checked_sub(1)?, shot)).unwrap_or(0.0)
}

/// Distance of a point from the next shot's beam, m.
///
/// For the last shot, from the previous shot.
fn to_next_beam_m(emissions: &[Emission], shot: usize, position_m: [f64; 3], unit_m: f64) -> f64 {
    let next = emissions.get(shot + 1).or_else(|| emissions.get(shot.checked_sub(1)?));
    next.map_or(0.0, |next| {
        let from_origin: [f64; 3] =
            std::array::from_fn(|axis| position_m[axis] - unit_m * next.origin_m[axis]);
        let along = dot(from_origin, next.direction);
        (dot(from_origin, from_origin) - along * along).max(0.0).sqrt()
    })
}

/// Horizontal direction from the first shot of a line to its last.
fn sweep(emissions: &[Emission], down: [f64; 3]) -> Option<[f64; 3]> {
    let (first, last) = (emissions.first()?, emissions.last()?);
    let step: [f64; 3] = std::array::from_fn(|axis| last.direction[axis] - first.direction[axis]);
    let fall = dot(step, down);
    let level: [f64; 3] = std::array::from_fn(|axis| step[axis] - fall * down[axis]);
    let length = dot(level, level).sqrt();
    (length > LEAST_SWEEP).then(|| level.map(|part| part / length))
}

pub(super) fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

pub(super) fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use wavex_line::scan_line::{Blocks, Content, InputInfo, Return};

    /// Beams 0.01 rad apart from 1000 m, with the sensor or points 5 m above the ground as origins.
    #[test]
    fn shots_are_as_far_apart_wherever_ranges_count_from() {
        let spacings = |origin_is_sensor: bool| {
            let before_m = if origin_is_sensor { 0.0 } else { 995.0 };
            let emission = |index: u32| {
                let (sin, cos) = (0.01 * f64::from(index)).sin_cos();
                let origin_m = [before_m * sin, 0.0, 1000.0 - before_m * cos];
                Emission { origin_m, direction: [sin, 0.0, -cos], ..Emission::default() }
            };
            let found = |emission| Return { emission, range_m: 1000.0 - before_m, ..Return::default() };
            let input = InputInfo { frame: Frame::Map, origin_is_sensor, ..InputInfo::default() };
            let emissions = (0..3).map(emission).collect();
            let mut scan_line = ScanLine::of_shots(Arc::new(input), 0, emissions, Blocks::default());
            scan_line.content = Content::Returns((0..3).map(found).collect());
            ReturnPositions::of(&scan_line, &mut AssumedMotion::default()).spacing_m
        };
        for origin_is_sensor in [true, false] {
            let spacings_m = spacings(origin_is_sensor);
            assert!(spacings_m.iter().all(|apart_m| (apart_m - 10.0).abs() < 0.01), "{spacings_m:?}");
        }
    }
}

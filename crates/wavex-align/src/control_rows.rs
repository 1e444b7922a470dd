//! Rows of the normal equations from control points.

use wavex_geodesy::frames::Vector;
use wavex_geodesy::trajectory::Poses;

use crate::control::{ControlDifference, ControlPair, ControlResult, match_control, reach_m};
use crate::normal::{Problem, Row, Weighting};
use crate::residual::{centre, distance_from, gradient_from};
use crate::survey::State;
use crate::vector::{difference, dot};

impl Problem<'_> {
    /// Differences of the strips from the control points, m; `None` without a pose.
    pub(crate) fn control_residuals(&self, state: &State, pairs: &[ControlPair]) -> Vec<Option<f64>> {
        let mut poses = self.survey.poses();
        pairs
            .iter()
            .map(|pair| {
                let ends = self.survey.ends(&self.survey.patches[pair.patch as usize], state, &mut poses)?;
                self.control_residual(pair, &ends)
            })
            .collect()
    }

    fn control_residual(&self, pair: &ControlPair, ends: &[Vector; 3]) -> Option<f64> {
        let point = &self.points[pair.point as usize];
        match point.normal {
            Some(_) => Some(dot(pair.direction, difference(centre(ends), point.position_in_ecef_m))),
            None => distance_from(ends, point.position_in_ecef_m),
        }
    }

    /// Rows of the control points that count, with their weights.
    pub(crate) fn control_rows(&self, state: &State, weighting: &Weighting) -> Vec<(Row, f64)> {
        let mut poses = self.survey.poses();
        let row = |pair: &ControlPair| {
            let row = self.control_row(state, pair, &mut poses)?;
            let weight = weighting.control_weight(pair, row.residual_m);
            (weight > 0.0).then_some((row, weight))
        };
        self.control.iter().filter_map(row).collect()
    }

    fn control_row(&self, state: &State, pair: &ControlPair, poses: &mut [Poses<'_>]) -> Option<Row> {
        let patch = &self.survey.patches[pair.patch as usize];
        let point = &self.points[pair.point as usize];
        let (ends, derivatives) = self.derivatives(patch, state, poses)?;
        let by_ends = match point.normal {
            Some(_) => [pair.direction.map(|part| part / 3.0); 3],
            None => gradient_from(&ends, point.position_in_ecef_m, pair.direction)?,
        };
        let mut entries = Vec::with_capacity(32);
        self.add_entries(&mut entries, state, patch, &derivatives, &by_ends);
        Some(Row::new(self.control_residual(pair, &ends)?, entries))
    }

    /// What is reported of the control points.
    pub(crate) fn control_result(&self, state: &State, weighting: &Weighting, cell_m: f64) -> ControlResult {
        let before = match_control(self.survey, self.points, &self.start, cell_m);
        let before_m = self.control_residuals(&self.start, &before);
        let strip = |pair: &ControlPair| self.survey.patches[pair.patch as usize].strip;
        let after_m = self.control_residuals(state, &self.control);
        let mut differences = vec![Vec::new(); self.points.len()];
        for (pair, after_m) in self.control.iter().zip(after_m) {
            let Some(after_m) = after_m else { continue };
            let is_same = |(other, _): &(&ControlPair, &Option<f64>)| {
                other.point == pair.point && strip(other) == strip(pair)
            };
            differences[pair.point as usize].push(ControlDifference {
                strip: strip(pair),
                before_m: before.iter().zip(&before_m).find(is_same).and_then(|(_, before_m)| *before_m),
                after_m,
                sd_m: pair.sd_m,
                is_used: weighting.control_weight(pair, after_m) > 0.0,
            });
        }
        ControlResult { differences, scale: weighting.control_scale, search_m: reach_m(cell_m) }
    }
}

impl Weighting {
    /// Weight of the difference from a control point, 1/m²; 0 if it is rejected.
    pub(crate) fn control_weight(&self, pair: &ControlPair, residual_m: f64) -> f64 {
        let size = residual_m.abs() / (pair.sd_m * self.control_scale);
        if size > self.reject {
            return 0.0;
        }
        let huber = if size > self.huber { self.huber / size } else { 1.0 };
        huber / (pair.weighting_sd_m * self.control_scale).powi(2)
    }
}

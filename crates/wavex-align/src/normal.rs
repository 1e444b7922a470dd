//! Normal equations of an adjustment.

use nalgebra::DVector;
use rayon::prelude::*;
use wavex_geodesy::frames::Vector;
use wavex_geodesy::trajectory::Poses;

use crate::control::{ControlPair, ControlPoint};
use crate::matching::Pair;
use crate::parameters::{GLOBALS, Global, Layout, OFFSETS, knot_weights};
use crate::patch::{Patch, block_rank};
use crate::residual::{gradient, residual};
use crate::sparse::BlockMatrix;
use crate::survey::{State, Survey};
use crate::vector::dot;

/// Information of the priors, about the start values.
#[derive(Clone, Debug)]
pub(crate) struct Priors {
    /// SDs by installation; 0 keeps a value.
    pub(crate) globals: Vec<[f64; GLOBALS]>,
    /// SDs by strip; 0 keeps a component.
    pub(crate) offsets: Vec<[f64; OFFSETS]>,
    /// Knot times by strip.
    pub(crate) knot_times_s: Vec<Vec<f64>>,
    /// Correlation time of position and attitude, s.
    pub(crate) correlation_s: [f64; 2],
}

/// A residual and its derivatives.
pub(crate) struct Row {
    pub(crate) residual_m: f64,
    /// Unknowns in ascending order, and derivatives.
    pub(crate) entries: Vec<(usize, f64)>,
}

impl Row {
    /// Entries of the same unknown are added.
    pub(crate) fn new(residual_m: f64, mut entries: Vec<(usize, f64)>) -> Row {
        entries.sort_by_key(|(unknown, _)| *unknown);
        entries.dedup_by(|next, kept| {
            let is_same = next.0 == kept.0;
            if is_same {
                kept.1 += next.1;
            }
            is_same
        });
        Row { residual_m, entries }
    }
}

/// Unknowns and values.
type Entries<'a> = &'a [(usize, f64)];

/// Weights of residuals: Huber's, relative to the pair's SD times a common scale.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Weighting {
    pub(crate) scale: f64,
    /// Residuals beyond this many SDs count linearly.
    pub(crate) huber: f64,
    /// Residuals beyond this many SDs do not count.
    pub(crate) reject: f64,
    /// Scale of the control points.
    pub(crate) control_scale: f64,
    /// Factor of the variances for errors that pairs of the same time share.
    pub(crate) shared: f64,
}

impl Weighting {
    /// Weight of a residual, 1/m²; 0 if it is rejected.
    pub(crate) fn weight(&self, pair: &Pair, residual_m: f64) -> f64 {
        let sd_m = pair.sd_m * self.scale;
        let size = residual_m.abs() / sd_m;
        if size > self.reject {
            return 0.0;
        }
        let huber = if size > self.huber { self.huber / size } else { 1.0 };
        huber * pair.share / (sd_m * sd_m * self.shared)
    }
}

/// Normal equations `matrix dx = right`, and gradients of groups of tiles.
pub(crate) struct Normal {
    pub(crate) matrix: BlockMatrix,
    pub(crate) right: DVector<f64>,
    /// Gradient of each group of tiles, without priors.
    pub(crate) groups: Vec<DVector<f64>>,
}

/// Groups of the jackknife: tiles are spread over them at random.
const GROUPS: usize = 48;
/// Pairs per parallel step.
const CHUNK: usize = 4096;
const PART: usize = 128;

/// The problem: survey, layout of the unknowns, priors.
pub(crate) struct Problem<'a> {
    pub(crate) survey: &'a Survey<'a>,
    pub(crate) layout: Layout,
    pub(crate) priors: Priors,
    /// Start values, about which the priors are.
    pub(crate) start: State,
    /// Control points.
    pub(crate) points: &'a [ControlPoint],
    /// Patches at the control points; none before the strips are near each other.
    pub(crate) control: Vec<ControlPair>,
    /// First and last time of the patches of each strip, s; the first is the larger one without patches.
    pub(crate) spans_s: Vec<[f64; 2]>,
    /// Factor of the variances for errors that pairs of the same time share.
    pub(crate) shared: f64,
}

impl Problem<'_> {
    /// Residuals of pairs, m; `None` without a pose.
    pub(crate) fn residuals(&self, state: &State, pairs: &[Pair]) -> Vec<Option<f64>> {
        let survey = self.survey;
        pairs
            .par_chunks(PART)
            .flat_map_iter(|part| {
                let mut poses = survey.poses();
                let of = move |pair: &Pair| {
                    let [a, b] = pair.patches.map(|patch| &survey.patches[patch as usize]);
                    let (a, b) = (survey.ends(a, state, &mut poses)?, survey.ends(b, state, &mut poses)?);
                    Some(residual(&a, &b)?.0)
                };
                part.iter().map(of).collect::<Vec<_>>()
            })
            .collect()
    }

    /// Normal equations at a state. The result does not depend on threads.
    pub(crate) fn normal(
        &self,
        state: &State,
        pairs: &[Pair],
        weighting: &Weighting,
        with_groups: bool,
    ) -> Normal {
        let size = self.layout.len();
        let groups = if with_groups { vec![DVector::zeros(size); GROUPS] } else { Vec::new() };
        let mut normal = Normal { matrix: self.layout.matrix(), right: DVector::zeros(size), groups };
        for chunk in pairs.chunks(CHUNK) {
            let rows: Vec<Option<Row>> = chunk
                .par_chunks(PART)
                .flat_map_iter(|part| {
                    let mut poses = self.survey.poses();
                    part.iter().map(|pair| self.row(state, pair, &mut poses)).collect::<Vec<_>>()
                })
                .collect();
            for (pair, row) in chunk.iter().zip(rows) {
                let Some(row) = row else { continue };
                let weight = weighting.weight(pair, row.residual_m);
                if weight > 0.0 {
                    self.add(&mut normal, &row, weight);
                    if with_groups {
                        let [x, y] = pair.tile.map(i64::from);
                        let group = &mut normal.groups[(block_rank((x, y)) % GROUPS as u64) as usize];
                        for (unknown, value) in &row.entries {
                            group[*unknown] -= weight * row.residual_m * value;
                        }
                    }
                }
            }
        }
        for (row, weight) in self.control_rows(state, weighting) {
            self.add(&mut normal, &row, weight);
        }
        self.add_priors(&mut normal, state);
        normal
    }

    fn add(&self, normal: &mut Normal, row: &Row, weight: f64) {
        for (unknown, value) in &row.entries {
            normal.right[*unknown] -= weight * row.residual_m * value;
        }
        let mut parts: Vec<(usize, usize, Entries<'_>)> = Vec::with_capacity(6);
        let mut left = row.entries.as_slice();
        while let Some((first, _)) = left.first() {
            let (node, _) = self.layout.place(*first);
            let end = self.layout.node_start(node + 1);
            let count = left.partition_point(|(unknown, _)| *unknown < end);
            let (own, rest) = left.split_at(count);
            parts.push((node, self.layout.node_start(node), own));
            left = rest;
        }
        for (k, (row_node, row_start, row_part)) in parts.iter().enumerate() {
            for (column_node, column_start, column_part) in &parts[..=k] {
                let block = normal.matrix.block_mut(*row_node, *column_node);
                for (j, column_value) in *column_part {
                    let weighted = weight * column_value;
                    for (i, row_value) in *row_part {
                        block[(i - row_start, j - column_start)] += weighted * row_value;
                    }
                }
            }
        }
    }

    fn row(&self, state: &State, pair: &Pair, poses: &mut [Poses<'_>]) -> Option<Row> {
        let [a, b] = pair.patches.map(|patch| &self.survey.patches[patch as usize]);
        let (ends_a, of_a) = self.derivatives(a, state, poses)?;
        let (ends_b, of_b) = self.derivatives(b, state, poses)?;
        let (residual_m, _) = residual(&ends_a, &ends_b)?;
        let direction = self.survey.horizon.ecef_direction(pair.direction.map(f64::from));
        let by_ends = gradient(&ends_a, &ends_b, direction)?;
        let mut entries: Vec<(usize, f64)> = Vec::with_capacity(64);
        for ((patch, derivatives), by_ends) in [(a, of_a), (b, of_b)].into_iter().zip(by_ends) {
            self.add_entries(&mut entries, state, patch, &derivatives, &by_ends);
        }
        Some(Row::new(residual_m, entries))
    }

    /// Adds derivatives of a row by all unknowns, from its derivatives by the ends of a patch.
    pub(crate) fn add_entries(
        &self,
        entries: &mut Vec<(usize, f64)>,
        state: &State,
        patch: &Patch,
        derivatives: &[crate::georeference::Derivatives; 3],
        by_ends: &[Vector; 3],
    ) {
        let strip = patch.strip as usize;
        let installation = self.survey.strips[strip].installation;
        let times_s = &self.priors.knot_times_s[strip];
        for ((by_parameter, by_end), beam) in derivatives.iter().zip(by_ends).zip(&patch.beams) {
            for (global, by) in by_parameter.globals.iter().enumerate() {
                if self.priors.globals[installation][global] > 0.0 {
                    entries.push((self.layout.global(installation, global), dot(*by, *by_end)));
                }
            }
            let time_s = beam.time_s + state.scanners[installation].calibration.time_offset_s;
            let Some((first, weights)) = knot_weights(times_s, time_s) else { continue };
            for (k, weight) in weights.into_iter().enumerate().filter(|(_, weight)| *weight > 0.0) {
                for (component, by) in by_parameter.offsets.iter().enumerate() {
                    if self.priors.offsets[strip][component] > 0.0 {
                        let unknown = self.layout.knot(strip, first + k) + component;
                        entries.push((unknown, weight * dot(*by, *by_end)));
                    }
                }
            }
        }
    }

    pub(crate) fn derivatives(
        &self,
        patch: &Patch,
        state: &State,
        poses: &mut [Poses<'_>],
    ) -> Option<([Vector; 3], [crate::georeference::Derivatives; 3])> {
        let strip = self.survey.strips.get(patch.strip as usize)?;
        let scanner = state.scanners.get(strip.installation)?;
        let corrections = state.corrections.get(patch.strip as usize)?.as_ref();
        let with_time = self.priors.globals[strip.installation][Global::Time as usize] > 0.0;
        let poses = poses.get_mut(strip.trajectory)?;
        let mut at =
            |beam| scanner.locate_with_derivatives(&patch.source, beam, poses, corrections, with_time);
        let [a, b, c] = [at(&patch.beams[0])?, at(&patch.beams[1])?, at(&patch.beams[2])?];
        Some(([a.0, b.0, c.0], [a.1, b.1, c.1]))
    }

    fn add_priors(&self, normal: &mut Normal, state: &State) {
        let deviation = self.deviation(state);
        let mut at = vec![0.0; self.layout.len()];
        self.prior_times(&deviation, &mut at, Some(&mut normal.matrix));
        for (right, by_prior) in normal.right.iter_mut().zip(at) {
            *right -= by_prior;
        }
    }

    /// Deviation of all unknowns from their start values.
    pub(crate) fn deviation(&self, state: &State) -> DVector<f64> {
        let mut deviation = DVector::zeros(self.layout.len());
        for (installation, (scanner, start)) in state.scanners.iter().zip(&self.start.scanners).enumerate() {
            for global in Global::ALL {
                deviation[self.layout.global(installation, global as usize)] =
                    global.of(scanner) - global.of(start);
            }
        }
        for (strip, corrections) in state.corrections.iter().enumerate() {
            for (k, knot) in corrections.iter().flat_map(|corrections| corrections.knots()).enumerate() {
                let offset = &knot.offset;
                for component in 0..3 {
                    let unknown = self.layout.knot(strip, k) + component;
                    deviation[unknown] = offset.north_east_down_m[component];
                    deviation[unknown + 3] = offset.roll_pitch_heading_rad[component];
                }
            }
        }
        deviation
    }

    /// Product of the prior information with a vector; adds it to a matrix.
    ///
    /// Errors of a trajectory are a Gauss-Markov process of first order: `x_k+1 = rho x_k + e` with
    /// `rho = exp(-step / correlation)` and a constant variance. Unknowns that are kept have unit information in the
    /// matrix, and none in the product.
    pub(crate) fn prior_times(
        &self,
        x: &DVector<f64>,
        product: &mut [f64],
        mut matrix: Option<&mut BlockMatrix>,
    ) {
        self.for_each_prior(|row, column, information, is_kept| {
            if !is_kept {
                product[row] += information * x[column];
            }
            if let Some(matrix) = matrix.as_deref_mut() {
                let ((row_node, i), (column_node, j)) = (self.layout.place(row), self.layout.place(column));
                if row_node >= column_node {
                    matrix.block_mut(row_node, column_node)[(i, j)] += information;
                }
            }
        });
    }

    /// Visits the information of the priors: row, column, information, and whether the unknown is kept.
    pub(crate) fn for_each_prior(&self, mut add: impl FnMut(usize, usize, f64, bool)) {
        for (installation, sds) in self.priors.globals.iter().enumerate() {
            for (global, sd) in sds.iter().enumerate() {
                let unknown = self.layout.global(installation, global);
                let is_kept = *sd == 0.0;
                add(unknown, unknown, if is_kept { 1.0 } else { 1.0 / (sd * sd) }, is_kept);
            }
        }
        for (strip, (sds, times_s)) in self.priors.offsets.iter().zip(&self.priors.knot_times_s).enumerate() {
            for (component, sd) in sds.iter().enumerate() {
                let unknown = |knot: usize| self.layout.knot(strip, knot) + component;
                if *sd == 0.0 {
                    (0..times_s.len()).for_each(|knot| add(unknown(knot), unknown(knot), 1.0, true));
                    continue;
                }
                let information = 1.0 / (sd * sd);
                if !times_s.is_empty() {
                    add(unknown(0), unknown(0), information, false);
                }
                for (k, pair) in times_s.windows(2).enumerate() {
                    let step_s = pair[1] - pair[0];
                    let rho = (-step_s / self.priors.correlation_s[component / 3]).exp();
                    let of_step = information / (1.0 - rho * rho);
                    add(unknown(k), unknown(k), rho * rho * of_step, false);
                    add(unknown(k + 1), unknown(k + 1), of_step, false);
                    add(unknown(k + 1), unknown(k), -rho * of_step, false);
                    add(unknown(k), unknown(k + 1), -rho * of_step, false);
                }
            }
        }
    }
}

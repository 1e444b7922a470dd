//! Time and memory of an alignment by number of strips: `many_strips STRIPS [SECONDS [KNOT_SECONDS [PATCHES [MOST]]]]`.
//!
//! Strips are parallel, in groups of thirty with a cross strip each, at 1000 m over hills. `PATCHES` of each strip are made
//! directly, as if all returns had been read, and thinned to `MOST` of all strips. Prints unknowns, pairs, seconds, peak memory (Linux), and the error of the
//! boresight. Then solves a matrix of the same form alone, as blocks and, up to 4500 unknowns, as a dense matrix.

#![allow(clippy::print_stdout)]

use std::error::Error;
use std::f64::consts::{FRAC_PI_2, PI};
use std::time::Instant;

use nalgebra::DMatrix;
use wavex_align::adjust::{AlignSettings, align};
use wavex_align::parameters::{Global, GlobalPriors, TrajectoryModel};
use wavex_align::patch::{Horizon, Patch, PatchBudget};
use wavex_align::scanner::{BeamSource, Scanner, ScannerBeam};
use wavex_align::sparse::BlockMatrix;
use wavex_align::survey::{Installation, Strip, Survey};
use wavex_geodesy::ellipsoid::{Geodetic, WGS84};
use wavex_geodesy::frames::{Attitude, IDENTITY, LocalFrame, Vector, inverse, rotate, rotation_of_angles};
use wavex_geodesy::trajectory::{Sample, Trajectory};

const HEIGHT_M: f64 = 1000.0;
const SPEED_MPS: f64 = 60.0;
const SPACING_M: f64 = 500.0;
const GROUP: usize = 31;
const CELL_M: f64 = 3.0;
const SWATH_M: f64 = 577.0;
const BORESIGHT_RAD: Vector = [3e-4, -2e-4, 5e-4];
const NOISE_M: f64 = 0.004;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<f64> = std::env::args().skip(1).map(|word| word.parse()).collect::<Result<_, _>>()?;
    let argument = |k: usize, default: f64| arguments.get(k).copied().unwrap_or(default);
    let (n, seconds, knots_s, wanted) =
        (argument(0, 31.0) as usize, argument(1, 100.0), argument(2, 10.0), argument(3, 20_000.0));
    let place = Geodetic { latitude_rad: 0.83, longitude_rad: 0.2, height_m: 300.0 };
    let (frame, horizon) = (LocalFrame::at(WGS84, place), Horizon::at(place));
    let length_m = seconds * SPEED_MPS;
    let mut random = Random(1);
    let (mut trajectories, mut strips) = (Vec::new(), Vec::new());
    let mut budget =
        arguments.get(4).map_or_else(PatchBudget::default, |most| PatchBudget::new(*most as usize));
    let mut n_made = 0;
    let boresight_to_scanner = inverse(&rotation_of_angles(BORESIGHT_RAD));
    for strip in 0..n {
        let (group, line) = (strip / GROUP, strip % GROUP);
        let is_cross = line == GROUP - 1;
        let middle = [group as f64 * 1.1 * length_m, (GROUP - 2) as f64 * SPACING_M / 2.0];
        // Parallel strips run north and south, the cross strip east, as long as the group is wide.
        let (start, course, own_m) = if is_cross {
            let own_m = (GROUP - 1) as f64 * SPACING_M;
            ([0.0, middle[0]], FRAC_PI_2, own_m)
        } else {
            let x = line as f64 * SPACING_M;
            let from = if line % 2 == 0 { middle[0] - length_m / 2.0 } else { middle[0] + length_m / 2.0 };
            ([x, from], if line % 2 == 0 { 0.0 } else { PI }, length_m)
        };
        let start_s = 1e4 * strip as f64;
        let (ahead, right) = ([course.sin(), course.cos()], [course.cos(), -course.sin()]);
        let step_s = 0.05;
        let samples = (0..((own_m / SPEED_MPS + 4.0) / step_s) as usize).map(|k| {
            let t = k as f64 * step_s - 2.0;
            let along = SPEED_MPS * t;
            let roll_rad = 0.02 * (0.6 * t + strip as f64).sin();
            Sample {
                time_s: start_s + t,
                place: frame.geodetic_of([
                    start[0] + ahead[0] * along,
                    start[1] + ahead[1] * along,
                    HEIGHT_M,
                ]),
                attitude: Attitude { roll_rad, pitch_rad: 0.01 * (0.5 * t).cos(), heading_rad: course },
            }
        });
        let trajectory = Trajectory::new(samples.collect())?;
        let mut poses = trajectory.poses();
        let mut patches: Vec<(u64, Patch)> = Vec::new();
        let cells = own_m * 2.0 * SWATH_M / (CELL_M * CELL_M);
        let part = (wanted * own_m / length_m / cells).min(1.0);
        for i in 0..(own_m / CELL_M) as usize {
            for j in 0..(2.0 * SWATH_M / CELL_M) as usize {
                let (along, across) = (i as f64 * CELL_M, j as f64 * CELL_M - SWATH_M);
                let mut at: [f64; 2] =
                    std::array::from_fn(|axis| start[axis] + ahead[axis] * along + right[axis] * across);
                at.iter_mut().for_each(|x| *x = (*x / CELL_M).floor() * CELL_M);
                // Blocks of 24 m are kept as a whole, at the same places in all strips.
                let block = at.map(|x| (x / 24.0).floor() as i64 as u64);
                let rank = Random(
                    block[0].wrapping_mul(0x9E37_79B9_7F4A_7C15)
                        ^ block[1].wrapping_mul(0xC2B2_AE3D_27D4_EB4F),
                );
                if { rank }.uniform() > part {
                    continue;
                }
                let time_s = start_s + along / SPEED_MPS;
                let Some(pose) = poses.at(time_s) else { continue };
                let noise_m = NOISE_M * random.normal();
                let (jitter_x, jitter_y) = (random.uniform(), random.uniform());
                let corners = [(-1.0, -1.0), (1.0, -1.0), (0.0, 1.2)].map(|(dx, dy)| {
                    let (x, y) = (at[0] + jitter_x + dx, at[1] + jitter_y + dy);
                    let local = [x, y, hills(x, y) + noise_m];
                    let ecef = WGS84.ecef_of(frame.geodetic_of(local));
                    let sight: Vector = std::array::from_fn(|axis| ecef[axis] - pose.origin_in_ecef_m[axis]);
                    let body = rotate(&inverse(&pose.ecef_from_body), sight);
                    let range_m = body.iter().map(|part| part * part).sum::<f64>().sqrt();
                    let direction = rotate(&boresight_to_scanner, body.map(|part| part / range_m));
                    ScannerBeam { time_s, direction, range_m }
                });
                let patch = Patch {
                    strip: 0,
                    n_returns: 30,
                    source: BeamSource::default(),
                    beams: corners,
                    sd_m: NOISE_M as f32,
                    slope_sd: 1e-3,
                    roughness_m: 0.0,
                };
                patches.push(({ rank }.bits(), patch));
            }
        }
        patches.sort_by_key(|(rank, _)| *rank);
        n_made += patches.len();
        budget.add(patches.into_iter().map(|(_, patch)| patch).collect());
        strips.push(Strip { trajectory: strip, installation: 0 });
        trajectories.push(trajectory);
    }
    let (patches, _) = budget.finish();
    let scanner = Scanner { body_from_mount: IDENTITY, calibration: Default::default() };
    let survey = Survey {
        trajectories: &trajectories,
        installations: &[Installation { scanner, priors: GlobalPriors::default() }],
        strips: &strips,
        patches: &patches,
        horizon,
    };
    let settings =
        AlignSettings { trajectory_model: TrajectoryModel::Spline(knots_s), ..AlignSettings::default() };
    let started = Instant::now();
    let result = align(&survey, &settings)?;
    let elapsed_s = started.elapsed().as_secs_f64();
    let errors: Vec<String> = [Global::Roll, Global::Pitch, Global::Yaw]
        .iter()
        .zip(BORESIGHT_RAD)
        .map(|(global, truth)| {
            let found = result.parameters[0][*global as usize];
            format!("{:.3} of {:.3}", 1e3 * (found.value - truth).to_degrees(), 1e3 * found.sd.to_degrees())
        })
        .collect();
    println!(
        "{n} strips, {} of {n_made} patches, {} pairs, {} unknowns: {elapsed_s:.1} s, {} of peak memory; errors and SDs, mdeg: {}",
        patches.len(),
        result.n_pairs,
        result.n_unknowns,
        peak_memory(),
        errors.join(", ")
    );
    compare_solvers(n, ((seconds / knots_s).ceil() as usize + 1).div_ceil(8));
    Ok(())
}

/// Times of a block and of a dense factor and inverse, for strips of this many nodes that overlap their neighbours.
fn compare_solvers(strips: usize, nodes: usize) {
    const NODE: usize = 48;
    let sizes = vec![NODE; strips * nodes].into_iter().chain([14]).collect::<Vec<_>>();
    let globals = sizes.len() - 1;
    let mut blocks = BlockMatrix::new(sizes.clone());
    let mut random = Random(7);
    let mut link = |blocks: &mut BlockMatrix, row: usize, column: usize| {
        blocks
            .block_mut(row.max(column), row.min(column))
            .iter_mut()
            .for_each(|x| *x = random.uniform() - 0.5);
    };
    for strip in 0..strips {
        for node in 0..nodes {
            let own = strip * nodes + node;
            link(&mut blocks, globals, own);
            if node > 0 {
                link(&mut blocks, own, own - 1);
            }
            if strip % GROUP > 0 {
                // Opposite courses, and the cross strip of the group.
                link(&mut blocks, own, (strip - 1) * nodes + (nodes - 1 - node));
                let cross = (strip / GROUP * GROUP + GROUP - 1).min(strips - 1);
                if cross != strip {
                    link(&mut blocks, own, cross * nodes + node);
                }
            }
        }
    }
    for (node, size) in sizes.into_iter().enumerate() {
        blocks.block_mut(node, node).copy_from(&(DMatrix::identity(size, size) * 500.0));
    }
    let unknowns = blocks.len();
    let started = Instant::now();
    let Some(factor) = blocks.factor() else { return };
    let factored_s = started.elapsed().as_secs_f64();
    let inverse = factor.selected_inverse();
    let inverted_s = started.elapsed().as_secs_f64() - factored_s;
    let megabytes = |values: usize| values as f64 * 8e-6;
    println!(
        "blocks: {unknowns} unknowns, factor {factored_s:.2} s, inverse {inverted_s:.2} s, {:.0} MB each ({})",
        megabytes(factor.stored_values()),
        if inverse.diagonal(globals).is_some() { "complete" } else { "incomplete" }
    );
    if unknowns <= 4500 {
        let dense = DMatrix::identity(unknowns, unknowns) * 500.0;
        let started = Instant::now();
        let Some(factor) = dense.cholesky() else { return };
        let factored_s = started.elapsed().as_secs_f64();
        let inverse = factor.inverse();
        let inverted_s = started.elapsed().as_secs_f64() - factored_s;
        println!(
            "dense: factor {factored_s:.2} s, inverse {inverted_s:.2} s, {:.0} MB each",
            megabytes(inverse.len())
        );
    }
}

fn hills(x: f64, y: f64) -> f64 {
    25.0 * (x / 170.0).sin() + 20.0 * (y / 130.0 + 1.0).sin() + 8.0 * ((x + y) / 47.0).cos()
}

fn peak_memory() -> String {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find(|line| line.starts_with("VmHWM"));
    line.map_or("unknown".to_owned(), |line| line.trim_start_matches("VmHWM:").trim().to_owned())
}

/// SplitMix64.
#[derive(Clone, Copy)]
struct Random(u64);

impl Random {
    fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }

    fn uniform(&mut self) -> f64 {
        self.bits() as f64 / u64::MAX as f64
    }

    fn normal(&mut self) -> f64 {
        (0..12).map(|_| self.uniform()).sum::<f64>() - 6.0
    }
}

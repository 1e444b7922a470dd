//! Plane of the returns of a cell.

use nalgebra::{Matrix3, SymmetricEigen};
use wavex_geodesy::frames::Vector;
use wavex_simd::statistics::median;

use super::{CellReturn, Patch, PatchSettings};
use crate::scanner::ScannerBeam;
use crate::vector::{cross, difference, dot, length, scaled, sum};

/// Distances above this many robust SDs are outliers of the plane.
const OUTLIER_SDS: f64 = 3.5;
/// Smallest cosine between beam and normal.
const LEAST_INCIDENCE: f64 = 0.2;
/// Weight of the stated range SDs in the noise of a patch, in returns.
const PRIOR_RETURNS: f64 = 6.0;

/// A plane through points: centre, axes and spread along them, and normal (upwards).
struct Plane {
    centre: Vector,
    normal: Vector,
    axes: [Vector; 2],
    variances: [f64; 2],
}

impl Plane {
    fn of(points: &[CellReturn]) -> Option<Plane> {
        let n = points.len() as f64;
        let centre = scaled(points.iter().fold([0.0; 3], |a, b| sum(a, b.point_m)), 1.0 / n);
        let [mut xx, mut xy, mut xz, mut yy, mut yz, mut zz] = [0.0; 6];
        for point in points {
            let [x, y, z] = difference(point.point_m, centre);
            xx += x * x;
            xy += x * y;
            xz += x * z;
            yy += y * y;
            yz += y * z;
            zz += z * z;
        }
        let covariance = Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz) / n;
        let eigen = SymmetricEigen::try_new(covariance, f64::EPSILON, 200)?;
        let mut order = [0, 1, 2];
        order.sort_by(|a, b| eigen.eigenvalues[*a].total_cmp(&eigen.eigenvalues[*b]));
        let axis = |k: usize| -> Vector { eigen.eigenvectors.column(order[k]).clone_owned().into() };
        let normal = axis(0);
        let normal = if normal[2] < 0.0 { scaled(normal, -1.0) } else { normal };
        let first = axis(2);
        Some(Plane {
            centre,
            normal,
            axes: [first, cross(normal, first)],
            variances: [eigen.eigenvalues[order[2]], eigen.eigenvalues[order[1]]],
        })
    }

    fn distance(&self, point: Vector) -> f64 {
        dot(self.normal, difference(point, self.centre))
    }
}

/// Patch of the returns of a cell, with its normal and the ends of its beams (east, north, up); `None` if they are not planar.
pub(super) fn fit(returns: &[CellReturn], settings: &PatchSettings) -> Option<(Patch, Vector, [Vector; 3])> {
    let plane = Plane::of(returns)?;
    let distance_m = |given: &CellReturn| plane.distance(given.point_m).abs();
    let limit_m = OUTLIER_SDS * 1.4826 * median(returns.iter().map(distance_m))?;
    let near: Vec<CellReturn>;
    let (used, plane) = if returns.iter().all(|given| distance_m(given) <= limit_m) {
        (returns, plane)
    } else {
        near = returns.iter().filter(|given| distance_m(given) <= limit_m).copied().collect();
        (&near[..], Plane::of(&near)?)
    };
    if used.len() < settings.least_returns || (used.len() as f64) < 0.9 * returns.len() as f64 {
        return None;
    }
    let n = used.len() as f64;
    let squares: f64 = used.iter().map(|given| plane.distance(given.point_m).powi(2)).sum();
    let rms_m = (squares / n).sqrt();
    let noise = |given: &CellReturn| (given.range_sd_m * dot(given.direction, plane.normal)).powi(2);
    let noise = used.iter().map(noise).sum::<f64>() / n;
    let is_planar = rms_m <= settings.most_rms_m
        && plane.normal[2] >= settings.most_slope_rad.cos()
        && plane.variances[1].sqrt() > 0.12 * settings.cell_m
        && n > 3.0;
    if !is_planar {
        return None;
    }
    // Few returns do not show their noise: the stated SDs count as a few more.
    let variance = (squares + PRIOR_RETURNS * noise) / (n - 3.0 + PRIOR_RETURNS);
    let (patch, ends_m) = place_beams(used, &plane)?;
    let at = mean(&ends_m);
    let [along, across] = plane.axes.map(|axis| dot(axis, difference(at, plane.centre)));
    let [v_along, v_across] = plane.variances;
    let plane_variance = variance / n * (1.0 + along * along / v_along + across * across / v_across);
    let patch = Patch {
        n_returns: used.len().min(usize::from(u16::MAX)) as u16,
        sd_m: plane_variance.sqrt() as f32,
        slope_sd: (variance / n / v_across).sqrt() as f32,
        roughness_m: (rms_m * rms_m - noise).max(0.0).sqrt() as f32,
        ..patch
    };
    Some((patch, plane.normal, ends_m))
}

fn mean(ends: &[Vector; 3]) -> Vector {
    scaled(sum(sum(ends[0], ends[1]), ends[2]), 1.0 / 3.0)
}

/// Patch with three beams that end on the plane, and their ends.
fn place_beams(used: &[CellReturn], plane: &Plane) -> Option<(Patch, [Vector; 3])> {
    let radius_m = plane.variances.map(|variance| 1.2 * variance.sqrt());
    let mut chosen: Vec<usize> = Vec::with_capacity(3);
    for k in 0..3 {
        let angle = core::f64::consts::TAU * f64::from(k) / 3.0;
        let wanted = [angle.cos() * radius_m[0], angle.sin() * radius_m[1]];
        let miss = |(index, given): (usize, &CellReturn)| {
            let from_centre = difference(given.point_m, plane.centre);
            let [along, across] = plane.axes.map(|axis| dot(axis, from_centre));
            ((along - wanted[0]).powi(2) + (across - wanted[1]).powi(2), index)
        };
        let free = used.iter().enumerate().filter(|(index, _)| !chosen.contains(index));
        chosen.push(free.map(miss).min_by(|a, b| a.0.total_cmp(&b.0))?.1);
    }
    let mut patch = Patch {
        strip: 0,
        n_returns: 0,
        source: used[chosen[0]].source,
        beams: [ScannerBeam::default(); 3],
        sd_m: 0.0,
        slope_sd: 0.0,
        roughness_m: 0.0,
    };
    let mut ends = [[0.0; 3]; 3];
    for ((beam, end), index) in patch.beams.iter_mut().zip(&mut ends).zip(chosen) {
        let CellReturn { beam: given, point_m, direction, .. } = used[index];
        let incidence = dot(direction, plane.normal);
        if incidence.abs() < LEAST_INCIDENCE {
            return None;
        }
        let further_m = -plane.distance(point_m) / incidence;
        *beam = ScannerBeam { range_m: given.range_m + further_m, ..given };
        *end = sum(point_m, scaled(direction, further_m));
    }
    let area = cross(difference(ends[1], ends[0]), difference(ends[2], ends[0]));
    let least_area = 0.5 * radius_m[0] * radius_m[1];
    if length(area) < least_area {
        return None;
    }
    Some((patch, ends))
}

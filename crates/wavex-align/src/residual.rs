//! Distance of two planes along their common normal.

use wavex_geodesy::frames::Vector;

use crate::vector::{cross, difference, dot, length, scaled, sum};

/// Mean of three points.
pub(crate) fn centre(ends: &[Vector; 3]) -> Vector {
    scaled(sum(sum(ends[0], ends[1]), ends[2]), 1.0 / 3.0)
}

/// Unit normal of a triangle; `None` if it has no area.
pub(crate) fn normal(ends: &[Vector; 3]) -> Option<Vector> {
    let area = area(ends);
    let size = length(area);
    (size > 1e-6).then(|| scaled(area, 1.0 / size))
}

fn area(ends: &[Vector; 3]) -> Vector {
    cross(difference(ends[1], ends[0]), difference(ends[2], ends[0]))
}

/// Distance of the centres of two patches along the mean of their normals, m, and across it.
///
/// With the mean of the normals, surfaces of constant curvature have distance 0 (S. Rusinkiewicz, A Symmetric Objective
/// Function for ICP, 2019).
pub(crate) fn residual(a: &[Vector; 3], b: &[Vector; 3]) -> Option<(f64, f64)> {
    let mean = sum(normal(a)?, normal(b)?);
    let size = length(mean);
    let between = difference(centre(a), centre(b));
    let along = dot(mean, between) / size;
    (size > 0.5).then(|| (along, (dot(between, between) - along * along).max(0.0).sqrt()))
}

/// Derivatives of [`residual`] by the corners of both triangles, if they move along `direction`.
///
/// They are exact if it is the mean of the normals.
pub(crate) fn gradient(a: &[Vector; 3], b: &[Vector; 3], direction: Vector) -> Option<[[Vector; 3]; 2]> {
    let (normal_a, normal_b) = (normal(a)?, normal(b)?);
    let sum_of_normals = sum(normal_a, normal_b);
    let size = length(sum_of_normals);
    let mean = scaled(sum_of_normals, 1.0 / size);
    let between = difference(centre(a), centre(b));
    // d(mean . between) = mean . d(between) + across . (d normal_a + d normal_b) / size
    let across = scaled(difference(between, scaled(mean, dot(mean, between))), 1.0 / size);
    Some([
        by_corners(a, normal_a, across, direction),
        by_corners(b, normal_b, across, scaled(direction, -1.0)),
    ])
}

/// Distance of a plane from a point along the normal of the plane, m: positive above the point.
pub(crate) fn distance_from(plane: &[Vector; 3], point: Vector) -> Option<f64> {
    Some(dot(normal(plane)?, difference(centre(plane), point)))
}

/// Derivatives of [`distance_from`] by the corners, if they move along `direction`.
///
/// They are exact if it is the normal.
pub(crate) fn gradient_from(plane: &[Vector; 3], point: Vector, direction: Vector) -> Option<[Vector; 3]> {
    let normal = normal(plane)?;
    let between = difference(centre(plane), point);
    let across = difference(between, scaled(normal, dot(normal, between)));
    Some(by_corners(plane, normal, across, direction))
}

/// Derivatives of `direction . centre + across . normal` by the corners.
fn by_corners(ends: &[Vector; 3], normal: Vector, across: Vector, direction: Vector) -> [Vector; 3] {
    let turned = difference(across, scaled(normal, dot(normal, across)));
    let turned = scaled(turned, 1.0 / length(area(ends)));
    let by_second = cross(difference(ends[2], ends[0]), turned);
    let by_third = cross(turned, difference(ends[1], ends[0]));
    let shared = scaled(direction, 1.0 / 3.0);
    [difference(shared, sum(by_second, by_third)), sum(shared, by_second), sum(shared, by_third)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn triangle(corner: [f64; 9]) -> [Vector; 3] {
        let [a, b, c, d, e, f, g, h, i] = corner;
        [[a, b, c], [d + 3.0, e, f], [g, h + 3.0, i]]
    }

    proptest! {
        #[test]
        fn gradients_are_differences(
            a in proptest::array::uniform9(-0.6..0.6), b in proptest::array::uniform9(-0.6..0.6),
        ) {
            let (a, b) = (triangle(a), triangle(b));
            let mean = sum(normal(&a).unwrap(), normal(&b).unwrap());
            let [by_a, by_b] = gradient(&a, &b, scaled(mean, 1.0 / length(mean))).unwrap();
            let step = 1e-5;
            for corner in 0..3 {
                for axis in 0..3 {
                    let moved = |mut ends: [Vector; 3], step: f64| { ends[corner][axis] += step; ends };
                    let r = |a: &[Vector; 3], b: &[Vector; 3]| residual(a, b).unwrap().0;
                    let by_a_numeric = (r(&moved(a, step), &b) - r(&moved(a, -step), &b)) / (2.0 * step);
                    let by_b_numeric = (r(&a, &moved(b, step)) - r(&a, &moved(b, -step))) / (2.0 * step);
                    prop_assert!((by_a[corner][axis] - by_a_numeric).abs() < 1e-8);
                    prop_assert!((by_b[corner][axis] - by_b_numeric).abs() < 1e-8);
                }
            }
            let point = [0.8, -0.3, 0.4];
            let by_a = gradient_from(&a, point, normal(&a).unwrap()).unwrap();
            for corner in 0..3 {
                for axis in 0..3 {
                    let r = |step: f64| {
                        let mut moved = a;
                        moved[corner][axis] += step;
                        distance_from(&moved, point).unwrap()
                    };
                    let numeric = (r(step) - r(-step)) / (2.0 * step);
                    prop_assert!((by_a[corner][axis] - numeric).abs() < 1e-8);
                }
            }
        }
    }

    /// Tangent planes of a parabola have no distance, wherever they touch it.
    #[test]
    fn constant_curvature_has_no_distance() {
        let tangent = |x: f64| {
            let at = |dx: f64, y: f64| [x + dx, y, 0.05 * x * x + 0.1 * x * dx];
            [at(-1.0, -1.0), at(2.0, -1.0), at(-1.0, 2.0)]
        };
        let (a, b) = (tangent(-0.4), tangent(0.9));
        assert!(residual(&a, &b).unwrap().0.abs() < 1e-3);
        let one_sided = dot(normal(&b).unwrap(), difference(centre(&a), centre(&b)));
        assert!(one_sided.abs() > 0.05);
    }
}

//! Heights of points above the ground points around them.

use spade::{DelaunayTriangulation, FloatTriangulation as _, HasPosition, Point2, Triangulation as _};

use crate::point::{Class, CloudPoint};

/// Ground point of a triangulation.
#[derive(Clone, Copy)]
struct GroundVertex {
    place_m: Point2<f64>,
    height_m: f64,
}

impl HasPosition for GroundVertex {
    type Scalar = f64;

    fn position(&self) -> Point2<f64> {
        self.place_m
    }
}

/// Heights of points above the triangulated ground points among them, m.
///
/// NaN outside the triangulation, and for points without coordinates. The result depends on the points and their
/// order only.
pub fn heights_above_ground(points: &[CloudPoint], classes: &[Class]) -> Vec<f32> {
    let is_place = |point: &CloudPoint| point.position_m.iter().all(|x| x.is_finite());
    let ground =
        points.iter().zip(classes).filter(|(point, class)| **class == Class::Ground && is_place(point));
    let vertices = ground.map(|(point, _)| {
        let [east_m, north_m, height_m] = point.position_m;
        GroundVertex { place_m: Point2::new(east_m, north_m), height_m }
    });
    let unknown = || vec![f32::NAN; points.len()];
    let Ok(triangulation) = DelaunayTriangulation::<GroundVertex>::bulk_load(vertices.collect()) else {
        return unknown();
    };
    if triangulation.num_vertices() < 3 {
        return unknown();
    }
    let ground = triangulation.barycentric();
    let height = |point: &CloudPoint| {
        let [east_m, north_m, height_m] = point.position_m;
        let below = || ground.interpolate(|vertex| vertex.data().height_m, Point2::new(east_m, north_m));
        is_place(point).then(below).flatten().map_or(f32::NAN, |ground_m| (height_m - ground_m) as f32)
    };
    points.iter().map(height).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Ground on a slope, and points above and below it.
    #[test]
    fn heights_are_above_a_plane_through_ground_points() {
        let ground = |x: f64, y: f64| CloudPoint::at([5e5 + x, 5e6 + y, 100.0 + 0.25 * x - 0.5 * y]);
        let mut points: Vec<CloudPoint> =
            (0..100).map(|i| ground(f64::from(i % 10), f64::from(i / 10))).collect();
        let mut classes = vec![Class::Ground; 100];
        for (above_m, class) in
            [(7.5, Class::Unclassified), (-20.0, Class::LowNoise), (90.0, Class::HighNoise)]
        {
            let mut point = ground(4.3, 5.6);
            point.position_m[2] += above_m;
            points.push(point);
            classes.push(class);
        }
        let outside = [ground(-0.5, 3.0), ground(4.0, 9.5), CloudPoint::at([f64::NAN; 3])];
        points.extend(outside);
        classes.extend([Class::Unclassified, Class::Unclassified, Class::Ground]);
        let heights_m = heights_above_ground(&points, &classes);
        assert!(heights_m[..100].iter().all(|height_m| height_m.abs() < 1e-6));
        for (height_m, expected_m) in heights_m[100..103].iter().zip([7.5, -20.0, 90.0]) {
            assert!((height_m - expected_m).abs() < 1e-5, "{height_m}");
        }
        assert!(heights_m[103..].iter().all(|height_m| height_m.is_nan()), "{heights_m:?}");
    }

    #[test]
    fn without_ground_no_height_is_known() {
        let points = [[0.0; 3], [1.0, 0.0, 0.0], [0.0, 0.0, 5.0]].map(CloudPoint::at);
        let of = |classes: [Class; 3]| heights_above_ground(&points, &classes);
        // Two of the three points have one place: they are no triangle.
        for classes in [[Class::Unclassified; 3], [Class::Ground; 3]] {
            assert!(of(classes).iter().all(|height_m| height_m.is_nan()), "{classes:?}");
        }
        assert!(heights_above_ground(&[], &[]).is_empty());
    }
}

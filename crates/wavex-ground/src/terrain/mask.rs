//! Where heights are interpolated: Delaunay triangles of limited size.

use spade::{DelaunayTriangulation, Point2, Triangulation};

use super::neighbours::PointIndex;

/// Marks the cells whose centres are inside a Delaunay triangle with a circumradius of at most `most_m`.
///
/// Such a triangle depends on the points within `2 most_m` of its corners alone, so tiles with that margin
/// have the same triangles. `x` are the centres of columns from the west, `y` those of rows from the north, m.
pub(crate) fn covered(index: &PointIndex, [x, y]: [&[f64]; 2], most_m: f64) -> Vec<bool> {
    let mut mask = vec![false; x.len() * y.len()];
    // Coordinates are not reduced to the tile: rounding would differ between tiles.
    let corners = index.points().iter().map(|p| Point2::new(p.position_m[0], p.position_m[1]));
    let Ok(triangulation) = DelaunayTriangulation::<Point2<f64>>::bulk_load(corners.collect()) else {
        return mask;
    };
    for face in triangulation.inner_faces() {
        let mut corners = face.vertices().map(|v| v.position());
        corners.sort_unstable_by(|a, b| a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y)));
        if circumradius_squared(corners) > most_m * most_m {
            continue;
        }
        let low_y = corners.iter().map(|c| c.y).fold(f64::INFINITY, f64::min);
        let high_y = corners.iter().map(|c| c.y).fold(f64::NEG_INFINITY, f64::max);
        // Rows run south.
        let first = y.partition_point(|y| *y > high_y);
        for row in first..y.partition_point(|y| *y >= low_y) {
            let (mut from, mut to) = (f64::INFINITY, f64::NEG_INFINITY);
            for k in 0..3 {
                let (a, b) = (corners[k], corners[(k + 1) % 3]);
                if (a.y - y[row]) * (b.y - y[row]) <= 0.0 && a.y != b.y {
                    let at = a.x + (b.x - a.x) * ((y[row] - a.y) / (b.y - a.y));
                    (from, to) = (from.min(at), to.max(at));
                }
            }
            let cells = x.partition_point(|x| *x < from)..x.partition_point(|x| *x <= to);
            for column in cells {
                mask[row * x.len() + column] = true;
            }
        }
    }
    mask
}

fn circumradius_squared([a, b, c]: [Point2<f64>; 3]) -> f64 {
    let squared = |p: Point2<f64>, q: Point2<f64>| (p.x - q.x).powi(2) + (p.y - q.y).powi(2);
    let area2 = (b.x - a.x) * (c.y - a.y) - (c.x - a.x) * (b.y - a.y);
    squared(a, b) * squared(b, c) * squared(c, a) / (4.0 * area2 * area2)
}

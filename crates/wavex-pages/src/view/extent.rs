//! Boxes around points, with and without outliers.

use super::points::ViewPoint;

/// Number of points from which quantiles are estimated.
const SAMPLE: usize = 100_000;
/// Quantiles between which an axis has its usual spread.
const USUAL: [f64; 2] = [0.05, 0.95];
/// Distance of an outlier from them: this many spreads of its axis, and this part of the spread of the longest axis.
const FENCE: [f64; 2] = [2.0, 0.25];

/// A corner with the smallest, and one with the largest coordinates, m.
type Corners = [[f64; 3]; 2];

/// Box around all points; infinite and inverted without any.
pub(super) fn box_of<'p>(points: impl IntoIterator<Item = &'p ViewPoint>) -> Corners {
    box_within(points, [[f64::NEG_INFINITY; 3], [f64::INFINITY; 3]])
}

/// Box around the points that are neither withheld nor far from all others on an axis.
///
/// A return below the ground, withheld or not, would shrink all others to a dot.
pub(super) fn usual_box(points: &[ViewPoint]) -> Corners {
    let kept = || points.iter().filter(|point| !point.withheld);
    if kept().next().is_none() {
        return box_of(points);
    }
    let step = kept().count().div_ceil(SAMPLE);
    let quantiles = [0, 1, 2].map(|axis| {
        let mut values: Vec<f32> = kept().step_by(step).map(|point| point.position_m[axis]).collect();
        values.sort_by(f32::total_cmp);
        USUAL.map(|part| {
            values.get((part * (values.len() - 1) as f64).round() as usize).copied().unwrap_or_default()
        })
    });
    let spreads_m = quantiles.map(|[low, high]| f64::from(high - low));
    let longest_m = spreads_m.iter().copied().fold(0.0, f64::max);
    let fence_m = spreads_m.map(|spread_m| (FENCE[0] * spread_m).max(FENCE[1] * longest_m));
    let limits = [
        [0, 1, 2].map(|i| f64::from(quantiles[i][0]) - fence_m[i]),
        [0, 1, 2].map(|i| f64::from(quantiles[i][1]) + fence_m[i]),
    ];
    box_within(kept(), limits)
}

/// Box around the coordinates within limits, axis by axis.
fn box_within<'p>(points: impl IntoIterator<Item = &'p ViewPoint>, [least, largest]: Corners) -> Corners {
    let (mut low, mut high) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
    for point in points {
        for i in 0..3 {
            let at_m = f64::from(point.position_m[i]);
            if (least[i]..=largest[i]).contains(&at_m) {
                low[i] = low[i].min(at_m);
                high[i] = high[i].max(at_m);
            }
        }
    }
    [low, high]
}

#[cfg(test)]
mod tests {
    use super::*;
    use wavex_line::scan_line::Return;

    fn point(position_m: [f32; 3], withheld: bool) -> ViewPoint {
        ViewPoint::of(&Return { withheld, ..Return::default() }, 0, 0, position_m)
    }

    /// A slope of 100 by 50 m, 10 m high.
    fn slope() -> Vec<ViewPoint> {
        (0..5000_u16)
            .map(|i| point([f32::from(i % 100), f32::from(i / 100), f32::from(i % 100) / 9.9], false))
            .collect()
    }

    #[test]
    fn outliers_do_not_extend_the_usual_box() {
        let mut points = slope();
        assert_eq!(usual_box(&points), [[0.0; 3], [99.0, 49.0, 10.0]]);
        assert_eq!(usual_box(&points), box_of(&points));
        points.push(point([50.0, 20.0, -245.0], true));
        points.push(point([50.0, 20.0, 900.0], false));
        points.push(point([50.0, 4000.0, 5.0], false));
        // A mast is no outlier.
        points.push(point([50.0, 20.0, 30.0], false));
        assert_eq!(usual_box(&points), [[0.0; 3], [99.0, 49.0, 30.0]]);
        assert_eq!(box_of(&points), [[0.0, 0.0, -245.0], [99.0, 4000.0, 900.0]]);
    }

    #[test]
    fn withheld_points_alone_have_a_box() {
        let points = [point([1.0, 2.0, 3.0], true), point([2.0, 2.0, 2.0], true)];
        assert_eq!(usual_box(&points), [[1.0, 2.0, 2.0], [2.0, 2.0, 3.0]]);
        assert_eq!(usual_box(&points[..1]), [[1.0, 2.0, 3.0]; 2]);
    }
}

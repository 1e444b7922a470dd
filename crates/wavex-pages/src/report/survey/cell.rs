//! Sums over the points of a cell, as integers, and the plane through them.

use wavex_line::scan_line::Return;

/// Coordinate steps per cell of level 0.
pub(super) const STEPS_PER_CELL: i64 = 256;
/// Unit of heights in sums, m.
pub(super) const HEIGHT_STEP_M: f64 = 1e-4;

/// Sums over the points of a cell.
///
/// Integers, so the order of points does not matter. Additions wrap: sums of squares of heights may
/// exceed 64 bits, but relative to a height of the cell they do not, and that conversion is exact
/// modulo 2^64. Coordinates are relative to the centre of the cell, in steps of 1/256 cell of level
/// 0; heights in [`HEIGHT_STEP_M`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct CellSums {
    /// Points that are not withheld.
    pub(super) points: u32,
    /// First returns among them.
    pub(super) pulses: u32,
    /// Single returns among them: all further fields are sums over these.
    pub(super) n: u32,
    pub(super) lowest: i32,
    pub(super) highest: i32,
    pub(super) x: i64,
    pub(super) y: i64,
    pub(super) z: i64,
    pub(super) xx: i64,
    pub(super) xy: i64,
    pub(super) yy: i64,
    pub(super) xz: i64,
    pub(super) yz: i64,
    pub(super) zz: i64,
}

impl CellSums {
    /// Adds a point at `[x, y]` steps from the centre; `height` is in steps.
    pub(super) fn add(&mut self, found: &Return, [x, y]: [i64; 2], height: i32) {
        self.points = self.points.saturating_add(1);
        self.pulses = self.pulses.saturating_add(u32::from(found.return_number == 1));
        if found.number_of_returns != 1 {
            return;
        }
        let z = i64::from(height);
        let one = CellSums {
            n: 1,
            lowest: height,
            highest: height,
            x,
            y,
            z,
            xx: x * x,
            xy: x * y,
            yy: y * y,
            xz: x.wrapping_mul(z),
            yz: y.wrapping_mul(z),
            zz: z * z,
            ..CellSums::default()
        };
        self.merge(&one);
    }

    /// Adds the sums of another cell with the same centre.
    pub(super) fn merge(&mut self, other: &CellSums) {
        if other.n > 0 {
            let is_first = self.n == 0;
            self.lowest = if is_first { other.lowest } else { self.lowest.min(other.lowest) };
            self.highest = if is_first { other.highest } else { self.highest.max(other.highest) };
        }
        self.points = self.points.saturating_add(other.points);
        self.pulses = self.pulses.saturating_add(other.pulses);
        self.n = self.n.saturating_add(other.n);
        let own = [
            &mut self.x,
            &mut self.y,
            &mut self.z,
            &mut self.xx,
            &mut self.xy,
            &mut self.yy,
            &mut self.xz,
            &mut self.yz,
            &mut self.zz,
        ];
        for (own, other) in own.into_iter().zip(other.sums()) {
            *own = own.wrapping_add(other);
        }
    }

    fn sums(&self) -> [i64; 9] {
        [self.x, self.y, self.z, self.xx, self.xy, self.yy, self.xz, self.yz, self.zz]
    }

    /// The same sums relative to a centre that is `[-dx, -dy]` steps away.
    pub(super) fn moved(&self, [dx, dy]: [i64; 2]) -> CellSums {
        let n = i64::from(self.n);
        let product = |a: i64, b: i64| a.wrapping_mul(b);
        let sum = |terms: [i64; 4]| terms.into_iter().fold(0i64, i64::wrapping_add);
        CellSums {
            x: self.x.wrapping_add(product(n, dx)),
            y: self.y.wrapping_add(product(n, dy)),
            xx: sum([self.xx, product(2 * dx, self.x), product(n, product(dx, dx)), 0]),
            xy: sum([self.xy, product(dx, self.y), product(dy, self.x), product(n, product(dx, dy))]),
            yy: sum([self.yy, product(2 * dy, self.y), product(n, product(dy, dy)), 0]),
            xz: self.xz.wrapping_add(product(dx, self.z)),
            yz: self.yz.wrapping_add(product(dy, self.z)),
            ..*self
        }
    }

    /// The same sums with heights relative to `reference`.
    pub(super) fn lowered(&self, reference: i32) -> CellSums {
        let (n, r) = (i64::from(self.n), i64::from(reference));
        let twice = r.wrapping_mul(2).wrapping_mul(self.z);
        CellSums {
            lowest: self.lowest.saturating_sub(reference),
            highest: self.highest.saturating_sub(reference),
            z: self.z.wrapping_sub(n.wrapping_mul(r)),
            xz: self.xz.wrapping_sub(r.wrapping_mul(self.x)),
            yz: self.yz.wrapping_sub(r.wrapping_mul(self.y)),
            zz: self.zz.wrapping_sub(twice).wrapping_add(n.wrapping_mul(r.wrapping_mul(r))),
            ..*self
        }
    }

    /// Mean height of the single returns, rounded down, in steps.
    pub(super) fn reference(&self) -> i32 {
        self.z.checked_div_euclid(i64::from(self.n)).map_or(0, |mean| mean as i32)
    }

    /// Plane through the single returns; `None` if they do not determine it.
    ///
    /// `step_m` is the unit of the horizontal coordinates.
    pub(super) fn plane(&self, step_m: f64) -> Option<Plane> {
        if self.n < 4 {
            return None;
        }
        let reference = self.reference();
        let low = self.lowered(reference);
        let n = f64::from(self.n);
        let [x, y, z] = [low.x, low.y, low.z].map(|sum| sum as f64 / n);
        let about = |square: i64, a: f64, b: f64| square as f64 / n - a * b;
        let (xx, xy, yy) = (about(low.xx, x, x), about(low.xy, x, y), about(low.yy, y, y));
        let (xz, yz, zz) = (about(low.xz, x, z), about(low.yz, y, z), about(low.zz, z, z));
        let determinant = xx * yy - xy * xy;
        // Points on a line, such as a single scan line, do not determine a plane.
        if determinant <= LEAST_SPREAD * (xx + yy) * (xx + yy) {
            return None;
        }
        let slope = [(xz * yy - yz * xy) / determinant, (yz * xx - xz * xy) / determinant];
        let left = (zz - slope[0] * xz - slope[1] * yz).max(0.0);
        let variance = n * left / (n - 3.0);
        let metres = HEIGHT_STEP_M / step_m;
        Some(Plane {
            n,
            centre_m: [x * step_m, y * step_m],
            height_m: (f64::from(reference) + z) * HEIGHT_STEP_M,
            slope: slope.map(|slope| slope * metres),
            residual_sd_m: variance.sqrt() * HEIGHT_STEP_M,
            range_m: f64::from(self.highest.saturating_sub(self.lowest)) * HEIGHT_STEP_M,
            inverse: [yy, -xy, xx].map(|entry| entry / (determinant * step_m * step_m)),
        })
    }
}

/// Smallest determinant of the points' scatter, relative to its squared trace.
///
/// 0.25 for a circular scatter; 0.02 for one whose axes are 1 to 7 in length.
const LEAST_SPREAD: f64 = 0.02;

/// Plane through the single returns of a cell.
#[derive(Clone, Copy, Debug)]
pub(super) struct Plane {
    n: f64,
    /// Centroid of the points, relative to the centre of the cell.
    pub(super) centre_m: [f64; 2],
    /// Height at the centroid.
    pub(super) height_m: f64,
    /// Rise per metre to the east and to the north.
    pub(super) slope: [f64; 2],
    /// Standard deviation of the points from the plane.
    pub(super) residual_sd_m: f64,
    /// Difference of the highest and the lowest point.
    pub(super) range_m: f64,
    /// Inverse of the scatter matrix of the points (xx, xy, yy), 1/m².
    inverse: [f64; 3],
}

impl Plane {
    /// Tangent of the slope.
    pub(super) fn steepness(&self) -> f64 {
        (self.slope[0] * self.slope[0] + self.slope[1] * self.slope[1]).sqrt()
    }

    /// Height at a place relative to the centre of the cell, and its variance, m².
    pub(super) fn at(&self, [x, y]: [f64; 2]) -> (f64, f64) {
        let [dx, dy] = [x - self.centre_m[0], y - self.centre_m[1]];
        let height_m = self.height_m + self.slope[0] * dx + self.slope[1] * dy;
        let [xx, xy, yy] = self.inverse;
        let leverage = 1.0 + dx * dx * xx + 2.0 * dx * dy * xy + dy * dy * yy;
        (height_m, self.residual_sd_m * self.residual_sd_m * leverage / self.n)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const STEP_M: f64 = 2.0 / STEPS_PER_CELL as f64;

    fn cell(points: &[([i64; 2], i32)]) -> CellSums {
        let mut cell = CellSums::default();
        points.iter().for_each(|(place, height)| cell.add(&Return::default(), *place, *height));
        cell
    }

    /// Points of z = 4 km + 0.05 x − 0.02 y with an error of ±1 cm.
    fn rough_plane(n: i64) -> Vec<([i64; 2], i32)> {
        let of = |i: i64| {
            let (x, y) = ((i * 37) % 250 - 125, (i * 91) % 250 - 125);
            let error = if (i / 2) % 2 == 0 { 100 } else { -100 };
            let height_m = 4000.0 + STEP_M * (0.05 * x as f64 - 0.02 * y as f64);
            ([x, y], (height_m / HEIGHT_STEP_M).round() as i32 + error)
        };
        (0..n).map(of).collect()
    }

    #[test]
    fn a_plane_is_found_with_its_residual() {
        let plane = cell(&rough_plane(400)).plane(STEP_M).unwrap();
        assert!((plane.slope[0] - 0.05).abs() < 2e-3 && (plane.slope[1] + 0.02).abs() < 2e-3, "{plane:?}");
        assert!((plane.residual_sd_m - 0.01).abs() < 2e-4, "{plane:?}");
        let (height_m, variance) = plane.at([0.5, -0.5]);
        assert!((height_m - 4000.035).abs() < 1e-3, "{height_m}");
        assert!((variance.sqrt() - 0.01 / 20.0) < 4e-4, "{variance}");
    }

    #[test]
    fn points_on_a_line_are_no_plane() {
        let line: Vec<_> = (0..50).map(|i| ([3 * i - 75, i - 25], 1000)).collect();
        assert!(cell(&line).plane(STEP_M).is_none());
        assert!(cell(&rough_plane(3)).plane(STEP_M).is_none());
    }

    #[test]
    fn only_single_returns_are_in_planes() {
        let mut cell = cell(&rough_plane(10));
        let second = Return { return_number: 2, number_of_returns: 2, ..Return::default() };
        cell.add(&second, [0, 0], 5);
        assert_eq!((cell.points, cell.pulses, cell.n), (11, 10, 10));
    }

    proptest! {
        /// Moving sums is the same as adding the points relative to the other centre.
        #[test]
        fn sums_can_be_moved(points in prop::collection::vec(((-128i64..128, -128i64..128), -90_000_000i32..90_000_000), 1..40)) {
            let points: Vec<([i64; 2], i32)> = points.into_iter().map(|((x, y), z)| ([x, y], z)).collect();
            let moved: Vec<_> = points.iter().map(|([x, y], z)| ([x + 128, y - 128], *z)).collect();
            prop_assert_eq!(cell(&points).moved([128, -128]), cell(&moved));
            let lowered: Vec<_> = points.iter().map(|(at, z)| (*at, z - 777)).collect();
            prop_assert_eq!(cell(&points).lowered(777), cell(&lowered));
        }
    }
}

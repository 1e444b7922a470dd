//! Geoid heights above the ellipsoid, from a grid.

/// A grid of geoid heights.
#[derive(Clone, Debug, PartialEq)]
pub struct Geoid {
    name: String,
    grid: GeoidGrid,
}

/// Layout and values of a grid.
#[derive(Clone, Debug, PartialEq)]
pub struct GeoidGrid {
    /// Latitude of the southernmost row, degrees.
    pub south_deg: f64,
    /// Longitude of the westernmost column, degrees east of Greenwich, modulo 360.
    pub west_deg: f64,
    /// Row spacing to the north, degrees, positive.
    pub latitude_step_deg: f64,
    /// Column spacing to the east, degrees, positive.
    pub longitude_step_deg: f64,
    /// Number of rows, at least 2.
    pub rows: usize,
    /// Number of columns, at least 2.
    pub columns: usize,
    /// Geoid heights above the ellipsoid, m: `rows * columns` values from south to north, each row
    /// from west to east; NaN if missing.
    pub heights_m: Vec<f32>,
}

/// The geoid has no height at a point.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error(
    "geoid {geoid}: the point at latitude {latitude_deg:.6}, longitude {longitude_deg:.6} degrees {problem}; \
     use a geoid that covers the survey, or remove it for ellipsoidal heights"
)]
pub struct GeoidError {
    /// Name of the geoid.
    pub geoid: String,
    /// Latitude of the point.
    pub latitude_deg: f64,
    /// Longitude of the point.
    pub longitude_deg: f64,
    /// Description of the problem.
    pub problem: String,
}

/// Distance by which a point may lie outside, in steps: angles are rounded.
const SLACK_STEPS: f64 = 1e-9;

impl Geoid {
    /// A geoid of this name; `None` for an invalid grid.
    ///
    /// A grid is invalid with fewer than two rows or columns, steps that are not positive, or
    /// another number of heights.
    ///
    /// # Examples
    ///
    /// ```
    /// use wavex_geodesy::geoid::{Geoid, GeoidGrid};
    ///
    /// let grid = GeoidGrid {
    ///     south_deg: 47.0,
    ///     west_deg: 8.0,
    ///     latitude_step_deg: 1.0,
    ///     longitude_step_deg: 1.0,
    ///     rows: 2,
    ///     columns: 2,
    ///     heights_m: vec![46.0, 48.0, 48.0, 50.0],
    /// };
    /// let geoid = Geoid::new("plane", grid).ok_or("invalid grid")?;
    /// assert_eq!(geoid.height_m(47.5, 8.5)?, 48.0);
    /// assert!(geoid.height_m(50.0, 8.5).is_err());
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn new(name: &str, grid: GeoidGrid) -> Option<Geoid> {
        let steps = [grid.latitude_step_deg, grid.longitude_step_deg];
        let sound = steps.iter().all(|step| step.is_finite() && *step > 0.0)
            && grid.south_deg.is_finite()
            && grid.west_deg.is_finite()
            && grid.rows >= 2
            && grid.columns >= 2
            && grid.rows.checked_mul(grid.columns) == Some(grid.heights_m.len());
        sound.then(|| Geoid { name: name.into(), grid })
    }

    /// The requested name, or the name of the file.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The grid.
    pub fn grid(&self) -> &GeoidGrid {
        &self.grid
    }

    /// Geoid height above the ellipsoid, m, at latitude and longitude in degrees.
    ///
    /// Bilinear interpolation between the four surrounding values. The height above the geoid is
    /// the ellipsoidal height minus this.
    ///
    /// # Errors
    /// The point lies outside the grid, or one of the four values is missing.
    pub fn height_m(&self, latitude_deg: f64, longitude_deg: f64) -> Result<f64, GeoidError> {
        let grid = &self.grid;
        let rows = (latitude_deg - grid.south_deg) / grid.latitude_step_deg;
        let columns = (longitude_deg - grid.west_deg).rem_euclid(360.0) / grid.longitude_step_deg;
        let place = GridSpan::rows(grid.rows, rows).zip(self.column_span(columns));
        let Some((row, column)) = place else {
            return Err(self.error(latitude_deg, longitude_deg, self.outside()));
        };
        let value = |r: usize, c: usize| {
            grid.heights_m.get(r * grid.columns + c).copied().map_or(f64::NAN, f64::from)
        };
        let along = |r: usize| blend(value(r, column.first), value(r, column.next), column.part);
        let height_m = blend(along(row.first), along(row.next), row.part);
        if height_m.is_nan() {
            return Err(self.error(latitude_deg, longitude_deg, "lies where it has no value".into()));
        }
        Ok(height_m)
    }

    /// The columns around a point; a grid around the whole earth wraps around.
    fn column_span(&self, columns: f64) -> Option<GridSpan> {
        let grid = &self.grid;
        let around = 360.0 / grid.longitude_step_deg;
        if grid.columns as f64 >= around - 0.5 {
            let first = columns.floor().max(0.0) as usize;
            let part = columns - first as f64;
            return Some(GridSpan { first: first % grid.columns, next: (first + 1) % grid.columns, part });
        }
        // A point west of the grid by a rounding error has wrapped around.
        let columns = if around - columns <= SLACK_STEPS { 0.0 } else { columns };
        GridSpan::rows(grid.columns, columns)
    }

    fn outside(&self) -> String {
        let grid = &self.grid;
        let north_deg = grid.south_deg + grid.latitude_step_deg * (grid.rows - 1) as f64;
        let east_deg = grid.west_deg + grid.longitude_step_deg * (grid.columns - 1) as f64;
        format!(
            "lies outside its area, latitude {} to {north_deg}, longitude {} to {east_deg}",
            grid.south_deg, grid.west_deg
        )
    }

    fn error(&self, latitude_deg: f64, longitude_deg: f64, problem: String) -> GeoidError {
        GeoidError { geoid: self.name.clone(), latitude_deg, longitude_deg, problem }
    }
}

/// Two neighbouring indices, and the position between them.
#[derive(Clone, Copy)]
struct GridSpan {
    first: usize,
    next: usize,
    /// Fraction: 0 at `first`, 1 at `next`.
    part: f64,
}

impl GridSpan {
    /// The indices around a position in steps among `count` values, at least two; `None` outside.
    fn rows(count: usize, steps: f64) -> Option<GridSpan> {
        let last = (count - 1) as f64;
        if !(steps >= -SLACK_STEPS && steps <= last + SLACK_STEPS) {
            return None;
        }
        let first = (steps.max(0.0) as usize).min(count - 2);
        Some(GridSpan { first, next: first + 1, part: (steps - first as f64).clamp(0.0, 1.0) })
    }
}

/// Linear interpolation; a missing value of weight 0 has no effect.
fn blend(first: f64, next: f64, part: f64) -> f64 {
    if part == 0.0 {
        first
    } else if part == 1.0 {
        next
    } else {
        first + (next - first) * part
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn grid(south_deg: f64, west_deg: f64, step_deg: f64, rows: usize, columns: usize) -> GeoidGrid {
        let heights_m = (0..rows * columns).map(|place| place as f32).collect();
        GeoidGrid {
            south_deg,
            west_deg,
            latitude_step_deg: step_deg,
            longitude_step_deg: step_deg,
            rows,
            columns,
            heights_m,
        }
    }

    fn geoid(grid: GeoidGrid) -> Geoid {
        Geoid::new("g", grid).unwrap()
    }

    /// Heights increase by 1 per step to the east and by 3 to the north.
    #[test]
    fn heights_are_bilinear() {
        let geoid = geoid(grid(40.0, 10.0, 0.5, 3, 3));
        for (latitude, longitude, height_m) in
            [(40.0, 10.0, 0.0), (41.0, 11.0, 8.0), (40.25, 10.0, 1.5), (40.5, 10.75, 4.5), (41.0, 10.0, 6.0)]
        {
            assert_eq!(geoid.height_m(latitude, longitude).unwrap(), height_m);
        }
    }

    #[test]
    fn longitudes_are_modulo_360_degrees() {
        for west_deg in [-60.0, 300.0] {
            let geoid = geoid(grid(14.0, west_deg, 0.5, 3, 3));
            for longitude in [-59.25, 300.75] {
                assert_eq!(geoid.height_m(14.0, longitude).unwrap(), 1.5, "{west_deg} {longitude}");
            }
            // A point outside by a rounding error is accepted.
            assert_eq!(geoid.height_m(14.0 - 1e-13, -60.0 - 1e-13).unwrap(), 0.0);
            assert_eq!(geoid.height_m(15.0 + 1e-13, -59.0 + 1e-13).unwrap(), 8.0);
        }
    }

    #[test]
    fn a_grid_around_the_earth_is_closed() {
        let open = geoid(grid(-90.0, 0.0, 90.0, 3, 4));
        assert_eq!(open.height_m(-90.0, -45.0).unwrap(), 1.5);
        assert_eq!(open.height_m(90.0, 359.999_999).unwrap().round(), 8.0);
        // The last column may repeat the first.
        let mut twice = grid(-90.0, -180.0, 90.0, 3, 5);
        (0..3).for_each(|row| twice.heights_m[row * 5 + 4] = twice.heights_m[row * 5]);
        let twice = geoid(twice);
        assert_eq!(twice.height_m(-90.0, 135.0).unwrap(), 1.5);
        assert_eq!(twice.height_m(0.0, 180.0).unwrap(), 5.0);
    }

    #[test]
    fn points_without_a_height_are_named() {
        let mut holed = grid(40.0, 10.0, 0.5, 3, 3);
        holed.heights_m[4] = f32::NAN;
        let geoid = geoid(holed);
        let remedy = "use a geoid that covers the survey, or remove it for ellipsoidal heights";
        for (latitude, longitude, problem) in [
            (39.9, 10.5, "lies outside its area, latitude 40 to 41, longitude 10 to 11"),
            (41.1, 10.5, "lies outside its area, latitude 40 to 41, longitude 10 to 11"),
            (40.5, 9.9, "lies outside its area, latitude 40 to 41, longitude 10 to 11"),
            (40.5, 11.1, "lies outside its area, latitude 40 to 41, longitude 10 to 11"),
            (40.75, 10.75, "lies where it has no value"),
        ] {
            assert_eq!(
                geoid.height_m(latitude, longitude).unwrap_err().to_string(),
                format!(
                    "geoid g: the point at latitude {latitude:.6}, longitude {longitude:.6} degrees {problem}; {remedy}"
                )
            );
        }
        assert!(geoid.height_m(f64::NAN, 10.5).is_err() && geoid.height_m(40.5, f64::NAN).is_err());
        // On the line between two values, the values to its sides have no effect.
        assert_eq!(geoid.height_m(40.0, 10.5).unwrap(), 1.0);
    }

    #[test]
    fn invalid_grids_are_rejected() {
        let whole = grid(40.0, 10.0, 0.5, 3, 3);
        for damage in [
            |grid: &mut GeoidGrid| grid.rows = 1,
            |grid: &mut GeoidGrid| grid.columns = 4,
            |grid: &mut GeoidGrid| grid.latitude_step_deg = 0.0,
            |grid: &mut GeoidGrid| grid.longitude_step_deg = f64::NAN,
            |grid: &mut GeoidGrid| grid.south_deg = f64::INFINITY,
            |grid: &mut GeoidGrid| grid.rows = usize::MAX,
        ] {
            let mut damaged = whole.clone();
            damage(&mut damaged);
            assert_eq!(Geoid::new("g", damaged), None);
        }
    }

    proptest! {
        #[test]
        fn any_point_gives_a_height_or_an_error(latitude in -1e3..1e3, longitude in -1e4..1e4) {
            let (part, whole) = (geoid(grid(40.0, 10.0, 0.5, 3, 3)), geoid(grid(-90.0, 0.0, 30.0, 7, 12)));
            prop_assert_eq!(whole.height_m(latitude, longitude).is_ok(), latitude.abs() <= 90.0);
            let inside = (40.0..=41.0).contains(&latitude) && (10.0..=11.0).contains(&longitude.rem_euclid(360.0));
            prop_assert_eq!(part.height_m(latitude, longitude).is_ok(), inside);
        }
    }
}

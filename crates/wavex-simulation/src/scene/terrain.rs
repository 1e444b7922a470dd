//! Ground with hills, and lakes in its hollows.

use super::super::start::GROUND_HEIGHT_M;
use super::{SceneBeam, Texture};

/// Size of hills, m; knolls are a seventh of it.
const HILL_M: f64 = 400.0;
/// Maximum horizontal step when tracing a beam, m; well below the size of knolls.
const STEP_M: f64 = 12.0;
/// Baseline of slopes, m.
const SLOPE_M: f64 = 0.25;
/// Precision of the range to the ground, m.
const PRECISION_M: f64 = 1e-7;

/// Ground between [`GROUND_HEIGHT_M`] and `relief_m` above it.
#[derive(Clone, Debug)]
pub(super) struct SimulatedTerrain {
    relief_m: f64,
    hills: Texture,
    /// Value of the field at the shores.
    shore: f64,
}

impl SimulatedTerrain {
    /// Hills of this height; the lowest fraction `water_ratio` of the land is under water.
    pub(super) fn new(seed: u64, relief_m: f64, water_ratio: f64) -> SimulatedTerrain {
        let hills = Texture::new(seed, 40, HILL_M);
        let shore = hills.quantile(water_ratio).max(0.0);
        SimulatedTerrain { relief_m, hills, shore }
    }

    /// Height of the ground, or of the water surface, m.
    pub(super) fn height_m(&self, x: f64, y: f64) -> f64 {
        if self.relief_m == 0.0 {
            return GROUND_HEIGHT_M;
        }
        GROUND_HEIGHT_M + self.relief_m * self.hills.at(x, y).max(self.shore)
    }

    /// Returns whether there is water.
    pub(super) fn is_water(&self, x: f64, y: f64) -> bool {
        self.shore > 0.0 && self.hills.at(x, y) < self.shore
    }

    /// Lower and upper bound of the ground height, m.
    pub(super) fn bounds_m(&self) -> [f64; 2] {
        [GROUND_HEIGHT_M, GROUND_HEIGHT_M + self.relief_m]
    }

    /// Range at which a beam first meets the ground, m.
    pub(super) fn range_to(&self, beam: &SceneBeam) -> f64 {
        let [lowest, highest] = self.bounds_m();
        if lowest == highest {
            return beam.range_to(lowest);
        }
        let above_m = |range_m: f64| {
            let [x, y, z] = beam.at(range_m);
            z - self.height_m(x, y)
        };
        let (start, end) = (beam.range_to(highest).max(0.0), beam.range_to(lowest));
        let [dx, dy, _] = beam.direction;
        let steps = ((end - start) * (dx * dx + dy * dy).sqrt() / STEP_M).ceil().max(1.0);
        let step = (end - start) / steps;
        let (mut before, mut above_before) = (start, above_m(start));
        for k in 1..=steps as u32 {
            let after = start + f64::from(k) * step;
            let above_after = above_m(after);
            if above_after <= 0.0 {
                return crossing([before, after], [above_before, above_after], above_m);
            }
            (before, above_before) = (after, above_after);
        }
        end
    }

    /// Cosine of the angle between a beam and the ground's normal at a range.
    pub(super) fn cosine(&self, beam: &SceneBeam, range_m: f64) -> f64 {
        if self.relief_m == 0.0 {
            return beam.cosine();
        }
        let [x, y, _] = beam.at(range_m);
        let here = self.height_m(x, y);
        let slope_x = (self.height_m(x + SLOPE_M, y) - here) / SLOPE_M;
        let slope_y = (self.height_m(x, y + SLOPE_M) - here) / SLOPE_M;
        let [dx, dy, dz] = beam.direction;
        let along = dx * slope_x + dy * slope_y - dz;
        // Lower bound for grazing beams: their echo is weak and wider than the tables allow.
        (along / (1.0 + slope_x * slope_x + slope_y * slope_y).sqrt()).clamp(0.05, 1.0)
    }
}

/// Root of a function that is positive at the first position and not at the second.
///
/// Regula falsi in the Illinois form: Dowell and Jarratt 1971, BIT 11:168-174.
fn crossing(
    [mut low, mut high]: [f64; 2],
    [mut at_low, mut at_high]: [f64; 2],
    f: impl Fn(f64) -> f64,
) -> f64 {
    for _ in 0..100 {
        if high - low < PRECISION_M || at_high == 0.0 {
            break;
        }
        let middle = low + (high - low) * at_low / (at_low - at_high);
        let middle = if middle > low && middle < high { middle } else { 0.5 * (low + high) };
        let value = f(middle);
        if value.abs() < PRECISION_M {
            return middle;
        }
        if value > 0.0 {
            (low, at_low) = (middle, value);
            at_high *= 0.5;
        } else {
            (high, at_high) = (middle, value);
            at_low *= 0.5;
        }
    }
    high
}

#[cfg(test)]
mod tests {
    use super::*;

    fn beam(x: f64, direction: [f64; 3]) -> SceneBeam {
        let length = direction.iter().map(|d| d * d).sum::<f64>().sqrt();
        SceneBeam { origin_m: [x, 77.0, GROUND_HEIGHT_M + 1500.0], direction: direction.map(|d| d / length) }
    }

    #[test]
    fn a_beam_ends_on_the_ground() {
        let terrain = SimulatedTerrain::new(5, 200.0, 0.1);
        for k in 0..2000 {
            let beam = beam(3.7 * f64::from(k), [0.9 * (f64::from(k % 21) / 10.0 - 1.0), 0.1, -1.0]);
            let range_m = terrain.range_to(&beam);
            let [x, y, z] = beam.at(range_m);
            assert!((z - terrain.height_m(x, y)).abs() < 1e-6, "{k}");
            for part in 1..40 {
                let [x, y, z] = beam.at(range_m * (0.8 + 0.2 * f64::from(part) / 41.0));
                assert!(z > terrain.height_m(x, y) - 0.3, "{k}: through a hill");
            }
            let cosine = terrain.cosine(&beam, range_m);
            assert!((0.05..=1.0).contains(&cosine));
        }
    }

    #[test]
    fn lakes_are_level_and_have_their_share() {
        let terrain = SimulatedTerrain::new(5, 100.0, 0.3);
        let places = (0..200).flat_map(|i| (0..200).map(move |j| (40.0 * f64::from(i), 40.0 * f64::from(j))));
        let (mut water, mut heights) = (0, Vec::new());
        for (x, y) in places {
            heights.push(terrain.height_m(x, y));
            water += u32::from(terrain.is_water(x, y));
        }
        assert!((f64::from(water) / 40_000.0 - 0.3).abs() < 0.05, "{water}");
        let level = heights.iter().copied().fold(f64::INFINITY, f64::min);
        let at_level = heights.iter().filter(|&&height| height == level).count();
        assert!(at_level as u32 >= water && heights.iter().all(|h| (400.0..500.0).contains(h)));
    }

    #[test]
    fn without_relief_the_ground_is_level() {
        let terrain = SimulatedTerrain::new(1, 0.0, 0.0);
        let beam = beam(0.0, [0.3, 0.0, -1.0]);
        assert_eq!(terrain.range_to(&beam), beam.range_to(GROUND_HEIGHT_M));
        assert_eq!((terrain.height_m(1.0, 2.0), terrain.is_water(1.0, 2.0)), (GROUND_HEIGHT_M, false));
        assert_eq!(terrain.cosine(&beam, 1.0), beam.cosine());
    }
}

//! Unbounded land: hills, lakes, houses, woods and power lines.

use super::super::random::cell;
use super::building::{Building, Materials};
use super::canopy::Canopy;
use super::terrain::SimulatedTerrain;
use super::wires::Wires;
use super::{LEAST_SHARE, MapArea, SceneBeam, Surface, Texture, TracedPulse};

/// Size of woods and clearings, m.
const WOOD_M: f64 = 150.0;
/// Side of a plot of land, which may carry one house, m.
const PLOT_M: f64 = 40.0;
/// Minimum and maximum side of houses, m; a house stays within its plot.
const HOUSE_M: [f64; 2] = [8.0, 28.0];
/// Height of the lowest house relative to the highest.
const LOWEST_HOUSE: f64 = 0.4;

/// Properties of the land.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CountrySettings {
    /// Height of the highest hill above the deepest hollow, m.
    pub relief_m: f64,
    /// Fraction of the land under water.
    pub water_ratio: f64,
    /// Fraction of the land covered by woods.
    pub wood_ratio: f64,
    /// Height of the highest trees, m.
    pub wood_height_m: f64,
    /// Fraction of the plots with a house.
    pub house_ratio: f64,
    /// Height of the highest houses, m.
    pub house_height_m: f64,
    /// Height of a power line's lowest wires above the ground at its pylons, m; 0: no power lines.
    pub wire_height_m: f64,
}

/// The land as a function of position only.
#[derive(Clone, Debug)]
pub(super) struct Country {
    settings: CountrySettings,
    terrain: SimulatedTerrain,
    ground: Surface,
    /// Woods grow where this field is below this value.
    woods: (Texture, f64),
    canopy: Canopy,
    plots: u64,
    materials: Materials,
    wires: Option<Wires>,
}

impl Country {
    pub(super) fn new(seed: u64, ground: Surface, settings: CountrySettings) -> Country {
        let woods = Texture::new(seed, 41, WOOD_M);
        Country {
            settings,
            terrain: SimulatedTerrain::new(seed, settings.relief_m, settings.water_ratio),
            ground,
            woods: (woods, woods.quantile(settings.wood_ratio)),
            canopy: Canopy::new(seed, settings.wood_height_m),
            plots: super::super::random::hash([seed, 42]),
            materials: Materials::new(seed),
            wires: (settings.wire_height_m > 0.0).then(|| Wires::new(seed, settings.wire_height_m)),
        }
    }

    /// Range at which a beam reaches the ground, m.
    pub(super) fn range_to_ground(&self, beam: &SceneBeam) -> f64 {
        self.terrain.range_to(beam)
    }

    /// Adds the echoes of a pulse, in any order.
    pub(super) fn trace(&self, pulse: &mut TracedPulse) {
        let (beam, ground_m) = (pulse.beam, pulse.ground_m);
        if let Some(wires) = &self.wires {
            wires.trace(pulse, &self.terrain);
        }
        if self.settings.wood_ratio > 0.0 {
            let height_m = |x: f64, y: f64| self.terrain.height_m(x, y);
            let [_, _, near_m] = beam.at(ground_m);
            let is_wood = |x: f64, y: f64| self.is_wood(x, y);
            self.canopy.trace(pulse, near_m, height_m, is_wood);
        }
        if self.settings.house_ratio > 0.0 {
            self.trace_houses(pulse);
        }
        let [x, y, _] = beam.at(ground_m);
        // Still water reflects all light away from the aircraft.
        if pulse.left >= LEAST_SHARE && !self.terrain.is_water(x, y) {
            pulse.reflect(&self.ground, ground_m, self.terrain.cosine(beam, ground_m), pulse.left);
        }
    }

    fn is_wood(&self, x: f64, y: f64) -> bool {
        let (field, limit) = &self.woods;
        field.at(x, y) < *limit && !self.terrain.is_water(x, y)
    }

    /// Adds the echoes of the first house that the beam hits; it shades those behind it.
    fn trace_houses(&self, pulse: &mut TracedPulse) {
        let (beam, ground_m) = (pulse.beam, pulse.ground_m);
        // Upper bound of roofs above the ground at the beam's end: the maximum house height plus a
        // slope of 1:1 on the way there.
        let [x, y, z] = beam.at(ground_m);
        let [x_high, y_high, _] = beam.at(beam.range_to(z + 2.0 * self.settings.house_height_m).max(0.0));
        let plots = |a: f64, b: f64| (a.min(b) / PLOT_M).floor() as i64..=(a.max(b) / PLOT_M).floor() as i64;
        let houses = plots(x, x_high)
            .flat_map(|column| plots(y, y_high).filter_map(move |row| self.house(column, row)));
        let met = houses.filter_map(|house| {
            let mut hits = Vec::new();
            let mut past = TracedPulse { hits: &mut hits, ..*pulse };
            house.trace(&mut past);
            let left = past.left;
            let range_m = hits.first().map_or(ground_m, |hit| hit.range_m);
            (!hits.is_empty() || left < pulse.left).then_some((range_m, left, hits))
        });
        if let Some((_, left, hits)) = met.min_by(|a, b| a.0.total_cmp(&b.0)) {
            pulse.hits.extend(hits);
            pulse.left = left;
        }
    }

    /// The house on a plot.
    fn house(&self, column: i64, row: i64) -> Option<Building> {
        let [chance, width, depth, height] = cell(self.plots, 2 * column, 2 * row);
        if chance >= self.settings.house_ratio {
            return None;
        }
        let corner = |plot: i64, size: f64, chance: f64| {
            let size = HOUSE_M[0] + size * (HOUSE_M[1] - HOUSE_M[0]);
            let from = PLOT_M * plot as f64 + chance * (PLOT_M - size);
            [from, from + size]
        };
        let [x_chance, y_chance, ..] = cell(self.plots ^ 1, 2 * column, 2 * row);
        let area = MapArea { x: corner(column, width, x_chance), y: corner(row, depth, y_chance) };
        let middle = |[from, to]: [f64; 2]| 0.5 * (from + to);
        let (x, y) = (middle(area.x), middle(area.y));
        if self.terrain.is_water(x, y) || self.is_wood(x, y) {
            return None;
        }
        let height_m = self.settings.house_height_m * (LOWEST_HOUSE + (1.0 - LOWEST_HOUSE) * height);
        Some(Building::new(area, self.terrain.height_m(x, y) + height_m, &self.materials))
    }
}

#[cfg(test)]
mod tests {
    use super::super::super::start::GROUND_HEIGHT_M;
    use super::super::{Class, Hit, Scene};
    use super::*;

    const SETTINGS: CountrySettings = CountrySettings {
        relief_m: 60.0,
        water_ratio: 0.1,
        wood_ratio: 0.4,
        wood_height_m: 25.0,
        house_ratio: 0.3,
        house_height_m: 20.0,
        wire_height_m: 20.0,
    };

    /// Hits of 40 000 beams at angles up to 35 degrees.
    fn flown(settings: CountrySettings) -> Vec<(SceneBeam, Vec<Hit>)> {
        let scene = Scene::country(1, 900.0, settings);
        let beam = |k: u32| {
            let across = 1.4 * (f64::from(k % 500) / 499.0 - 0.5);
            let length = (1.0 + across * across).sqrt();
            let y = 7.3 * f64::from(k / 500);
            let origin_m = [320_000.0, 5_300_000.0 + y, GROUND_HEIGHT_M + 900.0];
            SceneBeam { origin_m, direction: [across / length, 0.0, -1.0 / length] }
        };
        (0..40_000)
            .map(|k| {
                let mut hits = Vec::new();
                let beam = beam(k);
                scene.hits(&beam, &mut hits);
                (beam, hits)
            })
            .collect()
    }

    #[test]
    fn all_targets_are_hit_on_or_above_the_ground() {
        let terrain = SimulatedTerrain::new(1, SETTINGS.relief_m, SETTINGS.water_ratio);
        let mut counts = std::collections::HashMap::new();
        let mut empty = 0;
        for (beam, hits) in flown(SETTINGS) {
            empty += u32::from(hits.is_empty());
            for hit in hits {
                *counts.entry(hit.class).or_insert(0) += 1;
                let [x, y, z] = beam.at(hit.range_m);
                let above = z - terrain.height_m(x, y);
                assert!(above > -1e-6 && above < 40.0, "{:?} {above} m above the ground", hit.class);
                assert!((hit.class == Class::Ground) == (above < 1e-6), "{:?} at {above} m", hit.class);
            }
        }
        for class in [Class::Ground, Class::Roof, Class::Wall, Class::Leaves, Class::Wire] {
            assert!(counts.get(&class).is_some_and(|&n| n > 100), "{class:?}: {counts:?}");
        }
        assert!((2000..6000).contains(&empty), "a tenth falls on water: {empty}");
    }

    #[test]
    fn without_relief_and_targets_the_land_is_level() {
        let bare = CountrySettings {
            relief_m: 0.0,
            water_ratio: 0.0,
            wood_ratio: 0.0,
            house_ratio: 0.0,
            wire_height_m: 0.0,
            ..SETTINGS
        };
        for (beam, hits) in flown(bare) {
            assert_eq!(hits.len(), 1);
            assert!((beam.at(hits[0].range_m)[2] - GROUND_HEIGHT_M).abs() < 1e-9);
        }
    }
}

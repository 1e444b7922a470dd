//! Targets of a pulse: ground, water, buildings, woods and wires.
//!
//! The scene is a function of position only, without state, so a spot is the same in every line.

mod building;
mod canopy;
mod landscape;
mod terrain;
mod texture;
mod wires;

pub use landscape::CountrySettings;

use building::{Building, Materials};
use canopy::Canopy;
use landscape::Country;
use texture::Texture;

use super::start::GROUND_HEIGHT_M;

/// Half divergence: angle from the beam axis to the 1/e² intensity, rad.
const HALF_DIVERGENCE_RAD: f64 = 0.25e-3;
/// Minimum fraction of the pulse for a hit.
const LEAST_SHARE: f64 = 0.02;
/// Building and wood, as fractions of the swath across and along the flight.
const BUILDING_AREA: MapArea = MapArea { x: [0.15, 0.30], y: [0.25, 0.75] };
const CANOPY_AREA: MapArea = MapArea { x: [0.55, 0.95], y: [0.0, 1.0] };

/// A rectangle of the map, m.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MapArea {
    /// West and east edge.
    pub x: [f64; 2],
    /// South and north edge.
    pub y: [f64; 2],
}

/// Source of an echo.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Class {
    /// Ground.
    Ground,
    /// Roof of a building.
    Roof,
    /// Wall of a building.
    Wall,
    /// Layer of leaves.
    Leaves,
    /// Wire.
    Wire,
    /// No target: light or noise that resembles a pulse.
    FalseAlarm,
}

/// The part of a pulse that a target reflects.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    /// Source of the echo.
    pub class: Class,
    /// Distance along the beam, m.
    pub range_m: f64,
    /// Returned energy, relative to level ground of mean reflectance at nadir.
    pub energy: f64,
    /// SD of the distance within the beam, m.
    pub spread_m: f64,
}

/// The land below a flight.
///
/// # Examples
///
/// ```
/// use wavex_simulation::scene::{MapArea, SceneBeam, Class, Scene};
/// use wavex_simulation::world::{GROUND_HEIGHT_M, START_M};
///
/// let [x, y] = START_M;
/// let swath = MapArea { x: [x - 300.0, x + 300.0], y: [y, y + 100.0] };
/// let scene = Scene::strips(1, swath, 600.0, 0.0, 0.0);
/// let beam = SceneBeam { origin_m: [x, y, GROUND_HEIGHT_M + 600.0], direction: [0.0, 0.0, -1.0] };
/// let mut hits = Vec::new();
/// scene.hits(&beam, &mut hits);
/// assert_eq!((hits[0].class, hits[0].range_m), (Class::Ground, 600.0));
/// ```
#[derive(Clone, Debug)]
pub struct Scene {
    land: Land,
    /// Range at which level ground returns energy 1, m.
    reference_range_m: f64,
}

#[derive(Clone, Debug)]
enum Land {
    Strips(Box<Strips>),
    Country(Box<Country>),
}

/// Level ground with a long building and a long wood.
#[derive(Clone, Debug)]
struct Strips {
    ground: Surface,
    building: Option<Building>,
    canopy: Option<(MapArea, Canopy)>,
}

/// A material.
#[derive(Clone, Copy, Debug)]
struct Surface {
    class: Class,
    /// Mean reflectance relative to the ground.
    reflectance: f64,
    /// SD of its height within a footprint, m.
    roughness_m: f64,
    texture: Texture,
}

/// A beam in the scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SceneBeam {
    /// Origin, m.
    pub origin_m: [f64; 3],
    /// Unit vector along the beam; it points down.
    pub direction: [f64; 3],
}

impl Scene {
    /// Level ground in the swath `area`, with one building and one wood along the flight.
    ///
    /// `flying_height_m` is the height above the ground. A height of 0 omits the building or the
    /// wood.
    pub fn strips(
        seed: u64,
        area: MapArea,
        flying_height_m: f64,
        building_height_m: f64,
        canopy_height_m: f64,
    ) -> Scene {
        let building = |height_m| {
            Building::new(area.part(BUILDING_AREA), GROUND_HEIGHT_M + height_m, &Materials::new(seed))
        };
        let canopy = |height_m| (area.part(CANOPY_AREA), Canopy::new(seed, height_m));
        let strips = Strips {
            ground: ground(seed),
            building: (building_height_m > 0.0).then(|| building(building_height_m)),
            canopy: (canopy_height_m > 0.0).then(|| canopy(canopy_height_m)),
        };
        Scene { land: Land::Strips(Box::new(strips)), reference_range_m: flying_height_m }
    }

    /// Unbounded land, seen from `flying_height_m` above its lowest ground.
    pub fn country(seed: u64, flying_height_m: f64, settings: CountrySettings) -> Scene {
        let country = Country::new(seed, ground(seed), settings);
        Scene { land: Land::Country(Box::new(country)), reference_range_m: flying_height_m }
    }

    /// Finds the hits of a beam, sorted by range.
    pub fn hits(&self, beam: &SceneBeam, hits: &mut Vec<Hit>) {
        hits.clear();
        match &self.land {
            Land::Strips(strips) => {
                strips.trace(&mut self.pulse(beam, beam.range_to(GROUND_HEIGHT_M), hits));
            }
            Land::Country(country) => {
                country.trace(&mut self.pulse(beam, country.range_to_ground(beam), hits));
            }
        }
        hits.sort_by(|a, b| a.range_m.total_cmp(&b.range_m));
    }

    fn pulse<'a>(&self, beam: &'a SceneBeam, ground_m: f64, hits: &'a mut Vec<Hit>) -> TracedPulse<'a> {
        TracedPulse { beam, ground_m, reference_range_m: self.reference_range_m, left: 1.0, hits }
    }
}

impl Strips {
    fn trace(&self, pulse: &mut TracedPulse) {
        let beam = pulse.beam;
        let [x, ..] = beam.at(pulse.ground_m);
        if let Some((area, canopy)) = self.canopy.as_ref().filter(|(area, canopy)| {
            // Most beams miss the wood over the whole distance below its top.
            let [x_high, ..] = beam.at(beam.range_to(GROUND_HEIGHT_M + canopy.height_m()));
            x.max(x_high) >= area.x[0] && x.min(x_high) <= area.x[1]
        }) {
            let level = |_, _| GROUND_HEIGHT_M;
            let is_wood = |x, y| area.depth_m(x, y) >= 0.0;
            canopy.trace(pulse, GROUND_HEIGHT_M, level, is_wood);
        }
        if let Some(building) = &self.building {
            building.trace(pulse);
        }
        if pulse.left >= LEAST_SHARE {
            pulse.reflect(&self.ground, pulse.ground_m, beam.cosine(), pulse.left);
        }
    }
}

/// Material of the ground.
fn ground(seed: u64) -> Surface {
    Surface { class: Class::Ground, reflectance: 1.0, roughness_m: 0.02, texture: Texture::new(seed, 1, 6.0) }
}

/// A pulse on its way down.
struct TracedPulse<'a> {
    beam: &'a SceneBeam,
    /// Range to the ground, m.
    ground_m: f64,
    /// Range at which level ground returns energy 1, m.
    reference_range_m: f64,
    /// Fraction that is not yet reflected.
    left: f64,
    hits: &'a mut Vec<Hit>,
}

impl TracedPulse<'_> {
    /// Adds the echo of the fraction `share` that reaches a surface: see [`Surface::hit`].
    fn reflect(&mut self, surface: &Surface, range_m: f64, cosine: f64, share: f64) {
        self.hits.push(surface.hit(self.beam, range_m, cosine, share, self.reference_range_m));
    }
}

impl Surface {
    /// Echo of the fraction `share` of a pulse that reaches the surface at a range.
    ///
    /// `cosine` is the cosine of the angle between beam and normal. An inclined footprint spreads the
    /// echo.
    fn hit(&self, beam: &SceneBeam, range_m: f64, cosine: f64, share: f64, reference_range_m: f64) -> Hit {
        let [x, y, z] = beam.at(range_m);
        // The texture of walls varies with height.
        let grain = 0.5 + self.texture.at(x + z, y);
        let distance = reference_range_m / range_m;
        // The intensity's SD is half the radius at 1/e².
        let footprint_sd_m = 0.5 * HALF_DIVERGENCE_RAD * range_m;
        let tangent2 = 1.0 / (cosine * cosine) - 1.0;
        let spread2 = self.roughness_m * self.roughness_m + footprint_sd_m * footprint_sd_m * tangent2;
        Hit {
            class: self.class,
            range_m,
            energy: share * self.reflectance * grain * cosine * distance * distance,
            spread_m: spread2.sqrt(),
        }
    }
}

impl SceneBeam {
    /// Point at a range, m.
    pub fn at(&self, range_m: f64) -> [f64; 3] {
        core::array::from_fn(|axis| self.origin_m[axis] + range_m * self.direction[axis])
    }

    /// Range at which the beam reaches a height, m.
    fn range_to(&self, height_m: f64) -> f64 {
        (self.origin_m[2] - height_m) / self.cosine()
    }

    /// Cosine of the angle from nadir.
    fn cosine(&self) -> f64 {
        -self.direction[2]
    }
}

impl MapArea {
    /// Part of the area between two fractions of its width and its length.
    fn part(&self, shares: MapArea) -> MapArea {
        let part = |[from, to]: [f64; 2], shares: [f64; 2]| shares.map(|share| from + share * (to - from));
        MapArea { x: part(self.x, shares.x), y: part(self.y, shares.y) }
    }

    /// Distance of a point from the edge inside the area, m; negative outside.
    fn depth_m(&self, x: f64, y: f64) -> f64 {
        let inside = |[from, to]: [f64; 2], at: f64| (at - from).min(to - at);
        inside(self.x, x).min(inside(self.y, y))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SWATH: MapArea = MapArea { x: [-400.0, 600.0], y: [0.0, 100.0] };

    /// A beam from 600 m above the ground that reaches it at (x, 50).
    fn beam_to(x: f64) -> SceneBeam {
        let length = (x * x + 600.0 * 600.0).sqrt();
        let direction = [x / length, 0.0, -600.0 / length];
        SceneBeam { origin_m: [0.0, 50.0, GROUND_HEIGHT_M + 600.0], direction }
    }

    fn hits(scene: &Scene, x: f64) -> Vec<Hit> {
        let (beam, mut hits) = (beam_to(x), Vec::new());
        scene.hits(&beam, &mut hits);
        hits
    }

    #[test]
    fn bare_ground_is_level() {
        let scene = Scene::strips(1, SWATH, 600.0, 0.0, 0.0);
        for x in [-390.0, 0.0, 123.4, 580.0] {
            let hits = hits(&scene, x);
            assert_eq!(hits.len(), 1);
            let [px, _, pz] = beam_to(x).at(hits[0].range_m);
            assert!((px - x).abs() < 1e-9 && (pz - GROUND_HEIGHT_M).abs() < 1e-9);
        }
        // At 45 degrees the footprint's spread along the beam equals that across it.
        let hit = hits(&scene, 600.0)[0];
        let footprint_sd = 0.125e-3 * hit.range_m;
        assert!((hit.spread_m.powi(2) - footprint_sd.powi(2) - 0.02f64.powi(2)).abs() < 1e-12);
    }

    #[test]
    fn energy_falls_with_the_square_of_the_range_and_the_cosine() {
        let scene = Scene::strips(1, SWATH, 600.0, 0.0, 0.0);
        let n = 4000;
        let mean = |from: f64| {
            (0..n).map(|k| hits(&scene, from + 0.05 * f64::from(k))[0].energy).sum::<f64>() / f64::from(n)
        };
        let cosine = 600.0 / 600f64.hypot(400.0);
        assert!((mean(-100.0) - 1.0).abs() < 0.05, "{}", mean(-100.0));
        assert!((mean(300.0) / cosine.powi(3) - 1.0).abs() < 0.06, "{}", mean(300.0));
    }

    #[test]
    fn a_roof_casts_a_shadow() {
        let scene = Scene::strips(1, SWATH, 600.0, 8.0, 0.0);
        // The building extends from -250 to -100: one wall faces the aircraft, the other is in
        // shadow.
        let height = |x: f64| beam_to(x).at(hits(&scene, x)[0].range_m)[2] - GROUND_HEIGHT_M;
        assert!((height(-180.0) - 8.0).abs() < 1e-9);
        assert!(height(-99.0).abs() < 1e-9);
        let wall = height(-100.6);
        assert!((0.5..7.5).contains(&wall), "the wall is hit below its top: {wall}");
        let x = beam_to(-100.6).at(hits(&scene, -100.6)[0].range_m)[0];
        assert!((x + 100.0).abs() < 1e-9);
        assert!((height(-252.0) - 8.0).abs() < 1e-9, "the roof casts a shadow beyond its far edge");
        assert!(height(-255.0).abs() < 1e-9);
    }

    #[test]
    fn a_footprint_across_a_roof_edge_gives_two_echoes() {
        let scene = Scene::strips(1, SWATH, 600.0, 8.0, 0.0);
        // The beam axis passes the far edge of the roof (at x = -250) at 2 cm outside.
        let at_ground = -250.02 * 600.0 / 592.0;
        let found = hits(&scene, at_ground);
        assert_eq!(found.len(), 2);
        let heights: Vec<f64> =
            found.iter().map(|hit| beam_to(at_ground).at(hit.range_m)[2] - GROUND_HEIGHT_M).collect();
        assert!((heights[0] - 8.0).abs() < 1e-9 && heights[1].abs() < 1e-9, "{heights:?}");
    }

    #[test]
    fn a_wood_gives_one_to_four_echoes() {
        let scene = Scene::strips(1, SWATH, 600.0, 0.0, 18.0);
        let mut counts = [0; 6];
        for k in 0..4000 {
            let hits = hits(&scene, 160.0 + 0.09 * f64::from(k));
            assert!(hits.windows(2).all(|pair| pair[0].range_m < pair[1].range_m));
            assert!(hits.iter().map(|hit| hit.energy).sum::<f64>() < 2.0);
            counts[hits.len()] += 1;
        }
        assert_eq!((counts[0], counts[5]), (0, 0));
        assert!(counts[1..5].iter().all(|&n| n > 100), "{counts:?}");
        assert_eq!(hits(&scene, 100.0).len(), 1, "outside the wood");
    }
}

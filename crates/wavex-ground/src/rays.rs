//! Noise below and above the surface, by the free space that beams have crossed.
//!
//! Points that are linked by short steps are objects. The object that covers most land is the surface, and
//! objects that hang together with it, or stand on it, are accepted. Other objects are compared with the beams
//! that pass through their place: see [`mark_noise`].

mod low;
mod objects;
mod passes;
mod surface;
#[cfg(test)]
mod tests;

use crate::point::{Class, CloudPoint};
use low::LowSurface;
use objects::{Object, Objects};
use passes::{Evidence, passes};
use surface::Envelope;

/// Thresholds of [`mark_noise`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NoiseSettings {
    /// Smallest length of a step between two points of an object, m; larger where points are sparse.
    pub step_m: f64,
    /// Free height below an object, m, from which it is noise if beams pass through it; twice this height if beams are not
    /// known.
    pub free_air_m: f64,
    /// Free height below an object, m, from which it is noise in any case; also the depth of objects below the
    /// surface.
    pub isolated_m: f64,
    /// Smallest depth below the surface at which a point is low noise, m.
    pub depth_m: f64,
}

impl Default for NoiseSettings {
    fn default() -> NoiseSettings {
        NoiseSettings { step_m: 4.0, free_air_m: 60.0, isolated_m: 300.0, depth_m: 1.0 }
    }
}

/// Fewest points of an object that chance does not explain.
const FEWEST_POINTS: usize = 3;
/// Most points of a bird or a flock.
const BIRDS: usize = 30;
/// Points of walls are within this distance of the vertical below a roof, m, and within this height.
const COVER_M: f64 = 1.5;
const HOUSE_M: f64 = 150.0;
/// More points than a cluster of low noise has.
const SURFACE: usize = 2000;
/// Largest extent of a flock, m; parts of wires are longer.
const FLOCK_M: f64 = 5.0;
/// Largest extent of a bird or a dense flock, m.
const BIRD_M: f64 = 2.5;
/// Fewest points of a wire or a mast far above the ground.
const WIRE: usize = 8;
/// Probability that noise forms an accepted object by chance.
const CHANCE: f64 = 1e-3;
/// Thickness of layers with one density of noise, m.
const LAYER_M: f64 = 50.0;

/// Marks points that contradict what other beams have seen.
///
/// Returns the class of each point: unclassified, low noise or high noise. Points whose coordinates are not
/// finite are unclassified. The result does not depend on the order of points.
pub fn mark_noise(points: &[CloudPoint], settings: &NoiseSettings) -> Vec<Class> {
    let mut classes = vec![Class::Unclassified; points.len()];
    let objects = Objects::find(points, settings.step_m);
    for &(point, is_above) in &objects.far {
        classes[point] = if is_above { Class::HighNoise } else { Class::LowNoise };
    }
    let fewest = FewestPoints::by_layer(&objects, points);
    let by_chance = |object: &Object| object.n_points < fewest.at(0.5 * (object.low_m[2] + object.high_m[2]));
    let mut order: Vec<usize> = (0..objects.list.len()).filter(|&at| !by_chance(&objects.list[at])).collect();
    order.sort_by_key(|&at| {
        let object = &objects.list[at];
        (std::cmp::Reverse(object.columns.len()), std::cmp::Reverse(object.n_points), at)
    });

    // Places of all objects relative to the accepted ones, then the beams through the doubtful ones.
    let mut envelope = Envelope::default();
    let mut is_accepted = vec![false; objects.list.len()];
    // Whether an object is below all others around.
    let mut is_separate = vec![false; objects.list.len()];
    let mut doubtful = Vec::new();
    // Without beams, the shadows of high objects are not below them.
    let has_beams = points.iter().any(|point| point.beam[2] < 0.0);
    let free_air_m = settings.free_air_m * if has_beams { 1.0 } else { 2.0 };
    for &at in &order {
        let object = &objects.list[at];
        let place = envelope.place_of(object);
        let is_near = place.above_m <= free_air_m;
        let is_thin = object.is_thin(objects.step_m) && (is_near || object.n_points >= WIRE);
        let is_small =
            object.n_points <= BIRDS && object.extent_m() <= FLOCK_M && place.above_m > objects.step_m;
        match place.above_m {
            above_m if above_m > settings.isolated_m || place.below_m > settings.isolated_m => continue,
            _ if is_thin => {}
            above_m if above_m > free_air_m || is_small => {
                doubtful.push((at, place.above_m));
                continue;
            }
            _ => {}
        }
        is_accepted[at] = true;
        is_separate[at] = place.below_m > settings.depth_m;
        envelope.add(object);
    }
    let of_object: Vec<usize> = doubtful.iter().map(|&(at, _)| at).collect();
    let evidence = passes(points, &objects, &of_object, &is_accepted);
    for (&(at, above_m), seen) in doubtful.iter().zip(&evidence) {
        let is_compact = objects.list[at].extent_m() <= BIRD_M;
        let is_noise = if above_m > free_air_m { seen.is_transparent() } else { seen.is_bird(is_compact) };
        is_accepted[at] = !is_noise;
        if !is_noise {
            envelope.add(&objects.list[at]);
        }
    }
    // Walls below roofs that have just been accepted.
    for &(at, _) in &doubtful {
        let object = &objects.list[at];
        is_accepted[at] |= object.n_points <= BIRDS && envelope.place_of(object).above_m < 0.0;
    }

    let mut is_kept = vec![false; points.len()];
    for (_, object) in objects.list.iter().enumerate().filter(|(at, _)| is_accepted[*at]) {
        objects.points_of(object).for_each(|point| is_kept[point] = true);
    }
    let low = LowSurface::new(points, &objects, &is_accepted, settings.depth_m);
    for (at, object) in objects.list.iter().enumerate() {
        for point in objects.points_of(object) {
            let position_m = points[point].position_m;
            let offset = low.offset(position_m);
            let is_low = offset.is_some_and(|offset| offset.is_below());
            classes[point] = if is_accepted[at] {
                // Deep points of the surface itself hang together with it by a wall.
                let is_wall = object.n_points > SURFACE
                    && offset.is_some_and(|offset| offset.above_m < -2.0 * objects.step_m);
                let is_doubtful =
                    is_low && !is_wall || is_separate[at] && offset.is_some_and(|offset| offset.is_lower());
                let is_contradicted = is_doubtful && low.is_crossed_surface(points, &objects, &points[point])
                    || low.is_alone_below(points, &objects, position_m);
                if is_contradicted { Class::LowNoise } else { Class::Unclassified }
            } else if by_chance(object)
                && !envelope.is_below(object)
                && is_covered(&objects, points, &is_kept, position_m)
            {
                Class::Unclassified
            } else if is_low || envelope.is_below(object) {
                Class::LowNoise
            } else if by_chance(object) && offset.is_some_and(|offset| offset.is_on()) {
                Class::Unclassified
            } else {
                Class::HighNoise
            };
        }
    }
    classes
}

/// Whether kept points are straight above a place and below it, as roofs and the ground are of points of walls.
fn is_covered(objects: &Objects, points: &[CloudPoint], is_kept: &[bool], [x, y, z]: [f64; 3]) -> bool {
    let has_kept = |reach_m: f64, low_m: f64, high_m: f64| {
        let mut found =
            objects.points_in([x - reach_m, y - reach_m, low_m], [x + reach_m, y + reach_m, high_m]);
        found.any(|point| {
            let [px, py, pz] = points[point].position_m;
            let is_near = (px - x) * (px - x) + (py - y) * (py - y) <= reach_m * reach_m;
            is_kept[point] && is_near && (low_m..=high_m).contains(&pz)
        })
    };
    has_kept(COVER_M, z, z + HOUSE_M) && has_kept(2.0 * COVER_M, z - HOUSE_M, z)
}

/// Number of points from which an object is not noise by chance, in layers of equal height.
struct FewestPoints {
    low_m: f64,
    layers: Vec<usize>,
}

impl FewestPoints {
    /// Counts single points in each layer over the covered land.
    ///
    /// If noise of a constant density is linked with a mean number of `m` others, the sizes of its objects have
    /// Borel's distribution (the total progeny of a branching process).
    fn by_layer(objects: &Objects, points: &[CloudPoint]) -> FewestPoints {
        let singles: Vec<f64> = objects
            .list
            .iter()
            .filter(|object| object.n_points == 1)
            .map(|object| points[objects.first_point(object)].position_m[2])
            .collect();
        let low_m = singles.iter().copied().fold(f64::INFINITY, f64::min);
        let high_m = singles.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let n = if low_m <= high_m { ((high_m - low_m) / LAYER_M) as usize + 1 } else { 0 };
        // Absurd heights have no neighbours.
        let mut counts = vec![0u32; n.min(1000)];
        for z in singles {
            if let Some(count) = counts.get_mut(((z - low_m) / LAYER_M) as usize) {
                *count += 1;
            }
        }
        let covered = objects.list.iter().map(|object| object.columns.len()).max().unwrap_or(0);
        let area_m2 = covered as f64 * objects.column_m() * objects.column_m();
        let reach_m3 = 4.2 * objects.step_m * objects.step_m * objects.step_m;
        let fewest = |count: &u32| fewest_points(f64::from(*count) * reach_m3 / (area_m2 * LAYER_M));
        FewestPoints { low_m, layers: counts.iter().map(fewest).collect() }
    }

    fn at(&self, z: f64) -> usize {
        let layer = (z - self.low_m) / LAYER_M;
        if layer >= 0.0 {
            self.layers.get(layer as usize).copied().unwrap_or(FEWEST_POINTS)
        } else {
            FEWEST_POINTS
        }
    }
}

/// Smallest size of an object that chance reaches with a probability below [`CHANCE`], by Borel's distribution.
fn fewest_points(mean: f64) -> usize {
    const MOST: usize = 12;
    let mean = mean.min(0.8);
    let mut tail = 1.0;
    let mut factorial = 1.0;
    for n in 1..MOST {
        factorial *= n as f64;
        let product = mean * n as f64;
        tail -= libm::exp(-product) * libm::pow(product, n as f64 - 1.0) / factorial;
        if tail < CHANCE {
            return (n + 1).max(FEWEST_POINTS);
        }
    }
    MOST
}

impl Evidence {
    /// Whether the beams that pass through an object's place show that it is not solid.
    fn is_transparent(&self) -> bool {
        (self.passes + self.partial_hits) * 2 > self.hits
    }

    /// Whether most beams through the place of a small object meet nothing, or it covers only parts of beams.
    fn is_bird(&self, is_compact: bool) -> bool {
        self.passes >= 2 * self.hits && self.passes >= 4 || is_compact && 2 * self.partial_hits >= self.hits
    }
}

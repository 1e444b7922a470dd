//! A block with a flat roof.

use super::super::scanner::GROUND_HEIGHT_M;
use super::{Area, Beam, HALF_DIVERGENCE_RAD, Hit, LEAST_SHARE, Surface, Texture};

/// A block with a flat roof, whose brightest spots overload a receiver that is set for the ground.
#[derive(Clone, Debug)]
pub(super) struct Building {
    area: Area,
    roof_height_m: f64,
    roof: Surface,
    wall: Surface,
}

impl Building {
    pub(super) fn new(seed: u64, area: Area, height_m: f64) -> Building {
        Building {
            area,
            roof_height_m: GROUND_HEIGHT_M + height_m,
            roof: Surface { reflectance: 2.0, roughness_m: 0.005, texture: Texture::new(seed, 2, 3.0) },
            wall: Surface { reflectance: 0.8, roughness_m: 0.01, texture: Texture::new(seed, 3, 2.0) },
        }
    }

    /// Adds the echoes of a beam of which the share `left` arrives, and says what is left of it for the ground.
    pub(super) fn hits(&self, beam: &Beam, left: f64, reference_range_m: f64, hits: &mut Vec<Hit>) -> f64 {
        let range_m = beam.range_to(self.roof_height_m);
        let [x, y, _] = beam.at(range_m);
        let depth_m = self.area.depth_m(x, y);
        let on_roof = left * coverage(depth_m, HALF_DIVERGENCE_RAD * range_m);
        if on_roof >= LEAST_SHARE {
            hits.push(self.roof.hit(beam, range_m, beam.cosine(), on_roof, reference_range_m));
        }
        let left = left - on_roof;
        match self.wall(beam) {
            None => left,
            Some((range_m, cosine)) => {
                // What slips past the edge of a roof below which the wall faces the beam grazes it, and is lost.
                if depth_m < 0.0 && left >= LEAST_SHARE {
                    hits.push(self.wall.hit(beam, range_m, cosine, left, reference_range_m));
                }
                0.0
            }
        }
    }

    /// Where a beam that would reach the ground below the block comes through a wall: range, and the cosine of the
    /// angle to the wall's normal.
    fn wall(&self, beam: &Beam) -> Option<(f64, f64)> {
        let [x, y, _] = beam.at(beam.range_to(GROUND_HEIGHT_M));
        if self.area.depth_m(x, y) < 0.0 {
            return None;
        }
        // The beam enters the block through the wall that it reaches last of those which it comes towards.
        let sides = [(self.area.x, 0), (self.area.y, 1)];
        let facing = sides.into_iter().filter_map(|([low, high], axis)| {
            let towards = beam.direction[axis];
            let wall = if towards > 0.0 { low } else { high };
            (towards != 0.0).then(|| ((wall - beam.origin_m[axis]) / towards, towards.abs()))
        });
        facing.max_by(|a, b| a.0.total_cmp(&b.0))
    }
}

/// The share of a footprint of this radius that lies on an area whose edge is `depth_m` away (negative: the axis passes
/// outside).
fn coverage(depth_m: f64, radius_m: f64) -> f64 {
    (0.5 + 0.5 * depth_m / radius_m).clamp(0.0, 1.0)
}

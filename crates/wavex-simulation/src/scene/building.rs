//! A block with a flat roof.

use super::{Class, HALF_DIVERGENCE_RAD, LEAST_SHARE, MapArea, SceneBeam, Surface, Texture, TracedPulse};

/// A block with a flat roof, whose brightest spots saturate a receiver set for the ground.
#[derive(Clone, Debug)]
pub(super) struct Building {
    area: MapArea,
    roof_height_m: f64,
    roof: Surface,
    wall: Surface,
}

/// Materials of blocks.
#[derive(Clone, Copy, Debug)]
pub(super) struct Materials {
    roof: Surface,
    wall: Surface,
}

impl Materials {
    pub(super) fn new(seed: u64) -> Materials {
        let surface = |class, reflectance, roughness_m, name, grain_m| Surface {
            class,
            reflectance,
            roughness_m,
            texture: Texture::new(seed, name, grain_m),
        };
        Materials {
            roof: surface(Class::Roof, 2.0, 0.005, 2, 3.0),
            wall: surface(Class::Wall, 0.8, 0.01, 3, 2.0),
        }
    }
}

impl Building {
    /// A block on this area with this roof height in the scene.
    pub(super) fn new(area: MapArea, roof_height_m: f64, materials: &Materials) -> Building {
        Building { area, roof_height_m, roof: materials.roof, wall: materials.wall }
    }

    /// Adds the echoes of a pulse.
    pub(super) fn trace(&self, pulse: &mut TracedPulse) {
        let beam = pulse.beam;
        let range_m = beam.range_to(self.roof_height_m);
        let [x, y, _] = beam.at(range_m);
        let depth_m = self.area.depth_m(x, y);
        let on_roof = pulse.left * coverage(depth_m, HALF_DIVERGENCE_RAD * range_m);
        if on_roof >= LEAST_SHARE {
            pulse.reflect(&self.roof, range_m, beam.cosine(), on_roof);
        }
        pulse.left -= on_roof;
        if let Some((range_m, cosine)) = self.wall(beam, pulse.ground_m) {
            // The part of the footprint past the edge of a roof above a wall that faces the beam
            // grazes the wall and is lost.
            if depth_m < 0.0 && pulse.left >= LEAST_SHARE {
                pulse.reflect(&self.wall, range_m, cosine, pulse.left);
            }
            pulse.left = 0.0;
        }
    }

    /// Range at which a beam hits a wall, and the cosine of the angle to its normal.
    ///
    /// The beam hits a wall if it would reach the ground below the block, or leaves the block
    /// before it reaches the ground.
    fn wall(&self, beam: &SceneBeam, ground_m: f64) -> Option<(f64, f64)> {
        // The beam enters through the last of the walls that it approaches, and leaves through the
        // first of those that it moves away from.
        let sides = [(self.area.x, 0), (self.area.y, 1)];
        let towards = sides.into_iter().filter(|&(_, axis)| beam.direction[axis] != 0.0);
        let ranges = towards.map(|([low, high], axis)| {
            let towards = beam.direction[axis];
            let (near, far) = if towards > 0.0 { (low, high) } else { (high, low) };
            let range = |wall: f64| (wall - beam.origin_m[axis]) / towards;
            (range(near), range(far), towards.abs())
        });
        let (enters, cosine) =
            ranges.clone().map(|(near, _, cosine)| (near, cosine)).max_by(|a, b| a.0.total_cmp(&b.0))?;
        let [x, y, _] = beam.at(ground_m);
        let ends_inside = self.area.depth_m(x, y) >= 0.0;
        let leaves = ranges.map(|(_, far, _)| far).fold(ground_m, f64::min);
        let [x, y, z] = beam.at(enters);
        let passes = enters < leaves && z < self.roof_height_m && self.area.depth_m(x, y) > -1e-6;
        (ends_inside || passes).then_some((enters, cosine))
    }
}

/// Fraction of a footprint of this radius on an area whose edge is `depth_m` away.
///
/// Negative if the axis passes outside.
fn coverage(depth_m: f64, radius_m: f64) -> f64 {
    (0.5 + 0.5 * depth_m / radius_m).clamp(0.0, 1.0)
}

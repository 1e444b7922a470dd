//! A wood: layers of leaves with gaps.

use super::{Class, LEAST_SHARE, SceneBeam, Surface, Texture, TracedPulse};

/// Layers of leaves from the top down, each with its own gaps.
#[derive(Clone, Debug)]
pub(super) struct Canopy {
    layers: [CanopyLayer; 3],
}

#[derive(Clone, Copy, Debug)]
struct CanopyLayer {
    /// Maximum height above the ground, m.
    height_m: f64,
    /// Maximum fraction that it takes from a beam.
    density: f64,
    /// Texture value below which there is a gap.
    gap: f64,
    crowns: Texture,
    leaves: Surface,
}

/// Height range of a layer relative to its maximum height.
const RELIEF: f64 = 0.25;
/// Increase of the texture between a gap and full density.
const RISE: f64 = 0.25;

impl Canopy {
    pub(super) fn new(seed: u64, height_m: f64) -> Canopy {
        let layer = |name, height, density, gap, roughness_m| CanopyLayer {
            height_m: height * height_m,
            density,
            gap,
            crowns: Texture::new(seed, name, 5.0),
            leaves: Surface {
                class: Class::Leaves,
                reflectance: 1.1,
                roughness_m,
                texture: Texture::new(seed, name + 1, 1.0),
            },
        };
        let layers = [
            layer(10, 1.0, 0.75, 0.35, 0.30),
            layer(20, 0.6, 0.60, 0.45, 0.35),
            // Undergrowth, whose echoes overlap the echoes of the ground.
            layer(30, 0.1, 0.50, 0.45, 0.12),
        ];
        Canopy { layers }
    }

    /// Maximum height above the ground, m.
    pub(super) fn height_m(&self) -> f64 {
        self.layers[0].height_m
    }

    /// Adds the echoes of a pulse.
    ///
    /// The wood grows where `is_wood(x, y)`, on ground of height `ground_m(x, y)`, which is about
    /// `near_m` near the beam.
    pub(super) fn trace(
        &self,
        pulse: &mut TracedPulse,
        near_m: f64,
        ground_m: impl Fn(f64, f64) -> f64,
        is_wood: impl Fn(f64, f64) -> bool,
    ) {
        for layer in &self.layers {
            let range_m = layer.range_m(pulse.beam, near_m, &ground_m);
            let [x, y, _] = pulse.beam.at(range_m);
            if !is_wood(x, y) {
                continue;
            }
            let taken = pulse.left * layer.cover(x, y);
            if taken >= LEAST_SHARE {
                // Leaves reflect equally in all directions: no cosine.
                pulse.reflect(&layer.leaves, range_m, 1.0, taken);
                pulse.left -= taken;
            }
        }
    }
}

impl CanopyLayer {
    /// Range at which a beam meets the layer, which is highest in the middle of crowns.
    fn range_m(&self, beam: &SceneBeam, near_m: f64, ground_m: impl Fn(f64, f64) -> f64) -> f64 {
        let height = |ground_m: f64, relief: f64| ground_m + self.height_m * (1.0 - RELIEF * (1.0 - relief));
        let [x, y, _] = beam.at(beam.range_to(height(near_m, 0.5)));
        beam.range_to(height(ground_m(x, y), self.crowns.coarse(x, y)))
    }

    /// Fraction of a beam that the layer takes at a position.
    fn cover(&self, x: f64, y: f64) -> f64 {
        self.density * ((self.crowns.at(x, y) - self.gap) / RISE).clamp(0.0, 1.0)
    }
}

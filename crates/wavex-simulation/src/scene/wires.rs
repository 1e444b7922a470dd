//! Power lines: wires between pylons.

use super::terrain::SimulatedTerrain;
use super::{Class, HALF_DIVERGENCE_RAD, LEAST_SHARE, SceneBeam, Surface, Texture, TracedPulse};

/// Distance between power lines, which run along the track, m.
const LINE_SPACING_M: f64 = 150.0;
/// Distance between pylons, m.
const SPAN_M: f64 = 250.0;
/// Sag of the wires at mid-span, m.
const SAG_M: f64 = 6.0;
/// Positions of the wires: right of the line's centre, and above the lowest wire, m.
const WIRES_M: [[f64; 2]; 4] = [[-4.0, 0.0], [0.0, 0.0], [4.0, 0.0], [0.0, 4.0]];
/// Diameter of a wire, m.
const THICKNESS_M: f64 = 0.03;

/// Power lines all over the land.
#[derive(Clone, Debug)]
pub(super) struct Wires {
    height_m: f64,
    surface: Surface,
}

impl Wires {
    /// Lines whose lowest wires hang at this height above the ground at their pylons, m.
    pub(super) fn new(seed: u64, height_m: f64) -> Wires {
        let texture = Texture::new(seed, 43, 0.5);
        Wires {
            height_m,
            surface: Surface { class: Class::Wire, reflectance: 1.5, roughness_m: 0.0, texture },
        }
    }

    /// Adds the echoes of a pulse.
    pub(super) fn trace(&self, pulse: &mut TracedPulse, terrain: &SimulatedTerrain) {
        let beam = pulse.beam;
        let [_, highest] = terrain.bounds_m();
        let top_m = beam.range_to(highest + self.height_m + WIRES_M[3][1]).max(0.0);
        let [x_top, x_ground] = [top_m, pulse.ground_m].map(|range_m| beam.at(range_m)[0]);
        let (west, east) = (x_top.min(x_ground) - 5.0, x_top.max(x_ground) + 5.0);
        let lines = (west / LINE_SPACING_M).ceil() as i64..=(east / LINE_SPACING_M).floor() as i64;
        for line_x in lines.map(|line| line as f64 * LINE_SPACING_M) {
            for [aside, above] in WIRES_M {
                let lowest = self.height_m + above;
                let Some((range_m, off_m)) = self.nearest(beam, terrain, line_x + aside, lowest) else {
                    continue;
                };
                let taken = pulse.left * covered(off_m, HALF_DIVERGENCE_RAD * range_m);
                if taken >= LEAST_SHARE && range_m < pulse.ground_m {
                    pulse.reflect(&self.surface, range_m, 1.0, taken);
                    pulse.left -= taken;
                }
            }
        }
    }

    /// Range of closest approach of a beam to a wire, and their distance there, m.
    ///
    /// The wire is at `x` and, at its pylons, `above_m` above the ground.
    fn nearest(
        &self,
        beam: &SceneBeam,
        terrain: &SimulatedTerrain,
        x: f64,
        above_m: f64,
    ) -> Option<(f64, f64)> {
        let [dx, _, dz] = beam.direction;
        let across2 = dx * dx + dz * dz;
        let along = |z: f64| ((x - beam.origin_m[0]) * dx + (z - beam.origin_m[2]) * dz) / across2;
        let [lowest, highest] = terrain.bounds_m();
        // A beam that misses the wire at any possible height needs no terrain.
        let off = |z: f64| {
            let [at_x, _, at_z] = beam.at(along(z));
            (at_x - x) * dz - (at_z - z) * dx
        };
        let (low, high) = (off(lowest + above_m - SAG_M), off(highest + above_m));
        let reach_m = 2.0 * HALF_DIVERGENCE_RAD * along(lowest);
        if low.min(high) > reach_m || low.max(high) < -reach_m {
            return None;
        }
        let mut z = 0.5 * (lowest + highest) + above_m;
        // The height of a wire changes slowly along it: the second iteration is accurate to a
        // millimetre.
        for _ in 0..2 {
            z = hanging_m(terrain, x, beam.at(along(z))[1], above_m);
        }
        let range_m = along(z);
        Some((range_m, off(z).abs()))
    }
}

/// Height of a wire at a position along it: a parabola between pylons on the ground.
fn hanging_m(terrain: &SimulatedTerrain, x: f64, y: f64, above_m: f64) -> f64 {
    let span = (y / SPAN_M).floor();
    let part = y / SPAN_M - span;
    let pylon = |k: f64| terrain.height_m(x, SPAN_M * k) + above_m;
    let (from, to) = (pylon(span), pylon(span + 1.0));
    from + (to - from) * part - 4.0 * SAG_M * part * (1.0 - part)
}

/// Fraction of a round footprint covered by a wire at this distance from its centre.
fn covered(off_m: f64, radius_m: f64) -> f64 {
    let place = off_m / radius_m;
    if place >= 1.0 {
        return 0.0;
    }
    // Chord length times diameter, divided by the area.
    let chord_m = 2.0 * radius_m * (1.0 - place * place).sqrt();
    (chord_m * THICKNESS_M / (core::f64::consts::PI * radius_m * radius_m)).min(1.0)
}

#[cfg(test)]
mod tests {
    use super::super::super::start::GROUND_HEIGHT_M;
    use super::super::Hit;
    use super::*;

    /// A beam from 500 m that passes through a point.
    fn through(point_m: [f64; 3]) -> SceneBeam {
        let origin_m = [60.0, 20.0, GROUND_HEIGHT_M + 500.0];
        let offset: [f64; 3] = core::array::from_fn(|axis| point_m[axis] - origin_m[axis]);
        let length = offset.iter().map(|d| d * d).sum::<f64>().sqrt();
        SceneBeam { origin_m, direction: offset.map(|d| d / length) }
    }

    /// Hits of a beam, and the fraction of the pulse below the wires.
    fn traced(wires: &Wires, beam: &SceneBeam, ground_m: f64, terrain: &SimulatedTerrain) -> (Vec<Hit>, f64) {
        let mut hits = Vec::new();
        let mut pulse = TracedPulse { beam, ground_m, reference_range_m: 500.0, left: 1.0, hits: &mut hits };
        wires.trace(&mut pulse, terrain);
        let left = pulse.left;
        (hits, left)
    }

    #[test]
    fn a_beam_through_a_wire_hits_it_there() {
        let (wires, terrain) = (Wires::new(1, 20.0), SimulatedTerrain::new(1, 0.0, 0.0));
        // A quarter of the span from a pylon, the wire hangs three quarters of the sag lower.
        for (aside, z) in [(-4.0, 15.5), (0.0, 15.5), (4.0, 15.5), (0.0, 19.5)] {
            let point_m = [150.0 + aside, 62.5, GROUND_HEIGHT_M + z];
            let beam = through(point_m);
            let (hits, left) = traced(&wires, &beam, beam.range_to(GROUND_HEIGHT_M), &terrain);
            assert_eq!(hits.len(), 1, "{aside} {z}");
            let met = beam.at(hits[0].range_m);
            assert!(met.iter().zip(point_m).all(|(a, b)| (a - b).abs() < 2e-3), "{met:?} for {point_m:?}");
            assert!((0.7..0.95).contains(&left), "{left}");
        }
    }

    #[test]
    fn a_beam_that_misses_the_wires_loses_nothing() {
        let (wires, terrain) = (Wires::new(1, 20.0), SimulatedTerrain::new(1, 50.0, 0.0));
        for x in [100.0, 152.0, 157.0, 230.0] {
            let beam = through([x, 62.5, GROUND_HEIGHT_M]);
            let (hits, left) = traced(&wires, &beam, terrain.range_to(&beam), &terrain);
            if left == 1.0 {
                assert!(hits.is_empty());
            } else {
                assert!(beam.at(hits[0].range_m)[2] > terrain.height_m(x, 62.5));
            }
        }
        let beam = through([75.0, 62.5, GROUND_HEIGHT_M]);
        assert_eq!(traced(&wires, &beam, 480.0, &terrain).1, 1.0, "half way between two lines");
    }

    #[test]
    fn a_wire_covers_most_in_the_middle_of_a_footprint() {
        assert_eq!(covered(0.2, 0.15), 0.0);
        assert!((covered(0.0, 0.15) - 0.03 * 2.0 / (core::f64::consts::PI * 0.15)).abs() < 1e-12);
        assert!(covered(0.1, 0.15) < covered(0.0, 0.15));
        assert_eq!(covered(0.0, 0.001), 1.0);
    }
}

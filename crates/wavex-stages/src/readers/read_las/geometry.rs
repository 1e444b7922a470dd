//! Beam geometry of a LAS file, learnt from its first points.

use super::BeamVectors;
use crate::reading::recording::units::RecordingUnits;
use wavex_formats::las::{MAX_COORDINATE, PacketDescriptor, Point, Reader, Wave};
use wavex_geodesy::beam_length::BeamLength;
use wavex_line::stage::Result;

/// Beam properties common to a file.
pub(super) struct FileGeometry {
    pub(super) beams: BeamLength,
    pub(super) group_velocity_mps: f64,
    /// True if direction vectors point up to the sensor; files differ in this.
    towards_sensor: bool,
    vectors: BeamVectors,
    pub(super) units: RecordingUnits,
    pub(super) has_locations: bool,
    /// Descriptor of the first readable waveform.
    pub(super) sampling: Option<PacketDescriptor>,
}

/// One-way path of light in air, m per ns.
const METRES_PER_NS: f64 = 0.149_853_751;
/// Number of points used to determine the geometry of a file.
const POINTS_LOOKED_AT: usize = 10_000;

impl FileGeometry {
    /// Determines beam geometry from the first points of a file.
    pub(super) fn learn(
        reader: &mut Reader,
        of_file: BeamVectors,
        units: RecordingUnits,
    ) -> Result<FileGeometry> {
        let mut vectors: Vec<[f64; 3]> = Vec::new();
        let (mut has_locations, mut sampling) = (false, None);
        let mut point = Point::default();
        while vectors.len() < POINTS_LOOKED_AT && reader.next_point(&mut point)? {
            if point.wave.descriptor != 0 && is_usable(&point) {
                convert_heights(&mut point, units);
                vectors.push(per_ns(&point.wave, of_file, units));
                has_locations |= point.wave.location_ps != 0.0;
                sampling = sampling.or_else(|| reader.descriptor(&point.wave).ok().copied());
            }
        }
        let up = vectors.iter().filter(|vector| vector[2] > 0.0).count();
        let towards_sensor = 2 * up >= vectors.len();
        let beams = BeamLength::learn(&vectors, reader.header().scale, LEARN_BASELINE_NS, true);
        let mut lengths: Vec<f64> = vectors.iter().map(|vector| beams.of(*vector)).collect();
        lengths.sort_by(f64::total_cmp);
        let median = lengths.get(lengths.len() / 2).copied();
        let units_per_ns = beams.vertical().or(median).unwrap_or(METRES_PER_NS / units.map_m);
        let group_velocity_mps = units_per_ns * units.map_m * 2e9;
        Ok(FileGeometry {
            beams,
            group_velocity_mps,
            towards_sensor,
            vectors: of_file,
            units,
            has_locations,
            sampling,
        })
    }

    /// Displacement down the beam per nanosecond, in units of x and y.
    pub(super) fn beam(&self, wave: &Wave) -> [f64; 3] {
        let sign = if self.towards_sensor { -1.0 } else { 1.0 };
        per_ns(wave, self.vectors, self.units).map(|x| sign * x)
    }
}

/// Converts the height of a point and of its vector to the unit of x and y.
pub(super) fn convert_heights(point: &mut Point, units: RecordingUnits) {
    point.z *= units.height_factor;
    point.wave.direction_per_ps[2] *= units.height_factor as f32;
}

/// Vector of a waveform per nanosecond, in units of x and y.
fn per_ns(wave: &Wave, vectors: BeamVectors, units: RecordingUnits) -> [f64; 3] {
    let stored = wave.direction_per_ps.map(|x| 1000.0 * f64::from(x));
    let scale = match vectors {
        BeamVectors::Stored => 1.0,
        BeamVectors::Direction => {
            METRES_PER_NS / units.map_m / stored.iter().map(|x| x * x).sum::<f64>().sqrt()
        }
    };
    stored.map(|x| scale * x)
}

/// Typical time over which writers compute a beam vector, ns; sets the effect of its rounding.
const LEARN_BASELINE_NS: f64 = 1000.0;

/// Position of the first sample of a waveform: mean over its points.
///
/// Sample `i` lies at `P + (location − i × spacing) × vector` (LAS 1.4 R15, "Parametric dx, dy,
/// dz").
pub(super) fn first_sample(pulse: &[Point], packet_offset: u64, geometry: &FileGeometry) -> [f64; 3] {
    let sharing = || pulse.iter().filter(|point| point.wave.offset == packet_offset);
    let n = sharing().count().max(1) as f64;
    let mut mean_m = [0.0; 3];
    for point in sharing() {
        let beam = geometry.beam(&point.wave);
        let back_ns = f64::from(point.wave.location_ps) / 1000.0;
        for (axis, at) in [point.x, point.y, point.z].into_iter().enumerate() {
            mean_m[axis] += (at - beam[axis] * back_ns) / n;
        }
    }
    mean_m
}

pub(super) fn is_usable(point: &Point) -> bool {
    let wave = &point.wave;
    let is_placed = [point.x, point.y, point.z].iter().all(|x| x.abs() <= MAX_COORDINATE);
    let square: f32 = wave.direction_per_ps.iter().map(|x| x * x).sum();
    is_placed && wave.location_ps.is_finite() && square.is_finite() && square > 0.0
}

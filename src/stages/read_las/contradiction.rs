//! Contradictions between the beams, return locations and points of a LAS file.

use std::ops::RangeInclusive;

use super::geometry::Geometry;
use crate::stage::{Result, StageError};
use crate::stages::emission_choice::{lone_peak, median};
use wavex_formats::las::{Point, Reader};

/// Group velocities of light in air, m/s.
const VELOCITY_MPS: RangeInclusive<f64> = 2.5e8..=2.998e8;
const METRES_PER_FOOT: f64 = 0.3048;
/// Sampling intervals of waveform digitisers, ns.
const INTERVAL_NS: RangeInclusive<f64> = 0.05..=20.0;
/// Group velocity of a unit vector per picosecond, m/s.
const OF_UNIT_VECTORS_MPS: f64 = 2e12;
/// Ranges of airborne and terrestrial scanners, m.
const RANGE_M: RangeInclusive<f64> = 2.0..=50_000.0;
/// Number of points looked at, and single echoes needed.
const MOST_POINTS: usize = 5_000;
const FEWEST_ECHOES: usize = 30;
/// Largest median distance of points from the peaks of their single echoes, m.
const FARTHEST_M: f64 = 1.0;

/// Refuses vectors and sampling intervals that contradict physics.
pub(super) fn check_beams(geometry: &Geometry) -> Result<()> {
    if let Some(sampling) = geometry.sampling {
        let interval_ns = f64::from(sampling.spacing_ps) / 1000.0;
        if !INTERVAL_NS.contains(&interval_ns) {
            let is_ns = INTERVAL_NS.contains(&(1000.0 * interval_ns));
            let why = if is_ns { ": the spacing seems to be in nanoseconds, not in picoseconds" } else { "" };
            return Err(StageError::failed(
                format!(
                    "samples {interval_ns} ns apart are not those of a waveform digitiser (0.05 to 20 ns){why}"
                ),
                "export the file again with the temporal sample spacing in picoseconds",
            ));
        }
    }
    let velocity_mps = geometry.group_velocity_mps;
    if VELOCITY_MPS.contains(&velocity_mps) {
        return Ok(());
    }
    let why = explanation(velocity_mps);
    Err(StageError::failed(
        format!(
            "the direction vectors of the points give light a speed of {velocity_mps:.3e} m/s; in air it has \
             2.997e8: {why}"
        ),
        "export the vectors in metres per picosecond of one-way path, or set `beam_vectors = \"direction\"` of \
         the reader to use only their directions",
    ))
}

/// What would explain a speed.
fn explanation(velocity_mps: f64) -> &'static str {
    let is_velocity = |factor: f64| VELOCITY_MPS.contains(&(factor * velocity_mps));
    if is_velocity(METRES_PER_FOOT) {
        "they seem to be in feet, which the file does not name: set `crs_of_input`"
    } else if is_velocity(1.0 / METRES_PER_FOOT) {
        "they seem to be in metres, but the coordinates in feet"
    } else if is_velocity(0.5) {
        "they seem to be of the two-way path, twice as long"
    } else if is_velocity(2.0) {
        "they seem to be half as long, as for a two-way time"
    } else if is_velocity(1e-3) {
        "they seem to be per nanosecond, a thousand times as long"
    } else if (velocity_mps / OF_UNIT_VECTORS_MPS - 1.0).abs() < 1e-3 {
        "they seem to be unit vectors"
    } else if RANGE_M.contains(&(velocity_mps / OF_UNIT_VECTORS_MPS)) {
        "they seem to be full ranges, from the sensor to the return"
    } else {
        "no usual error explains it"
    }
}

/// Refuses return locations that do not lie at the echoes of their waveforms.
///
/// The points of the file are the reference: where a waveform has a single echo and a single point, the
/// location is to be that of its peak.
pub(super) fn check_locations(reader: &mut Reader, geometry: &Geometry) -> Result<()> {
    let mut echoes: Vec<Echo> = Vec::new();
    let (mut point, mut samples) = (Point::default(), Vec::new());
    let mut looked_at = 0;
    while looked_at < MOST_POINTS && reader.next_point(&mut point)? {
        looked_at += 1;
        if point.wave.descriptor == 0 || point.number_of_returns != 1 {
            continue;
        }
        let Ok(descriptor) = reader.packet(&point.wave, &mut samples) else { continue };
        let spacing_ns = f64::from(descriptor.spacing_ps) / 1000.0;
        let location_ns = f64::from(point.wave.location_ps) / 1000.0;
        if let Some(peak) = lone_peak(&samples).filter(|_| location_ns.is_finite()) {
            let last_ns = (samples.len() - 1) as f64 * spacing_ns;
            echoes.push(Echo { peak_ns: peak * spacing_ns, location_ns, last_ns });
        }
    }
    if echoes.len() < FEWEST_ECHOES {
        return Ok(());
    }
    let metres_per_ns = 0.5e-9 * geometry.group_velocity_mps;
    let off_m = |location_ns: fn(&Echo) -> f64| {
        metres_per_ns * median(echoes.iter().map(|echo| (echo.peak_ns - location_ns(echo)).abs()))
    };
    let as_stored_m = off_m(|echo| echo.location_ns);
    if as_stored_m <= FARTHEST_M {
        return Ok(());
    }
    let why = if echoes.iter().all(|echo| echo.location_ns == 0.0) {
        "all locations are 0, so points would have to be at the first samples of their waveforms"
    } else if off_m(|echo| 1000.0 * echo.location_ns) <= FARTHEST_M {
        "the locations seem to be in nanoseconds, not in picoseconds"
    } else if off_m(|echo| echo.last_ns - echo.location_ns) <= FARTHEST_M {
        "the locations seem to count from the last sample"
    } else {
        "the packets seem to belong to other points, or the locations are no times since the first sample"
    };
    Err(StageError::failed(
        format!(
            "the points of {} single echoes lie {as_stored_m:.1} m from the peaks of their waveforms (median, along \
             the beam), by their return locations: {why}",
            echoes.len()
        ),
        "export the file again with return locations; if the locations are right, set `check_locations = false` of \
         the reader",
    ))
}

/// A single echo with one point, times since the first sample.
struct Echo {
    peak_ns: f64,
    location_ns: f64,
    last_ns: f64,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_error_of_vectors_has_its_explanation() {
        let light = 2.997_075e8;
        for (velocity_mps, words) in [
            (2.0 * light, "two-way path"),
            (0.5 * light, "half as long"),
            (1e3 * light, "per nanosecond"),
            (2e12, "unit vectors"),
            (2e15, "full ranges"),
            (light / 0.3048, "in feet"),
            (0.3048 * light, "in metres"),
            (1.0, "no usual error"),
        ] {
            assert!(explanation(velocity_mps).contains(words), "{velocity_mps}");
        }
    }
}

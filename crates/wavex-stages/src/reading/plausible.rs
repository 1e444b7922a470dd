//! Physical limits of recordings.

use std::ops::RangeInclusive;

use wavex_line::plausibility::Check;
use wavex_line::stage::{Result, StageError};

/// Group velocities of light in air, m/s, and up to 0.4 % more, for beams in maps of a larger scale.
const VELOCITY_MPS: RangeInclusive<f64> = 2.5e8..=3.01e8;
const METRES_PER_FOOT: f64 = 0.3048;
/// Sampling intervals of waveform digitisers, ns.
pub(crate) const INTERVAL_NS: RangeInclusive<f64> = 0.05..=20.0;
/// Group velocity of a unit vector per picosecond, m/s.
const OF_UNIT_VECTORS_MPS: f64 = 2e12;
/// Ranges of airborne and terrestrial scanners, m.
const RANGE_M: RangeInclusive<f64> = 2.0..=50_000.0;
/// Metres in a frame per metre of range: maps up to 84 degrees of latitude, in metres or feet.
pub(crate) const FRAME_SCALE: RangeInclusive<f64> = 0.1..=10.0;
/// Largest time of a sample after its shot, ns: light travels 1500 km and back.
pub(crate) const MOST_START_NS: f64 = 1e7;

/// Words of the messages.
const NO_DIGITISER: &str = "are not those of a waveform digitiser";
const SPEED: &str = "give light a speed";

/// The checks of this module that all readers make.
pub(crate) fn checks() -> Vec<Check> {
    vec![
        Check::error(
            "group velocity, stated or by the length of direction vectors",
            format!("{:.3e} to {:.3e} m/s", VELOCITY_MPS.start(), VELOCITY_MPS.end()),
            "light in air; maps may be 0.4 % larger",
            SPEED,
        )
        .with_key("beam_vectors"),
        Check::error(
            "sampling interval",
            format!("{} to {} ns", INTERVAL_NS.start(), INTERVAL_NS.end()),
            "digitisers of scanners have 0.5 to 2 ns, those of research up to 10 ns",
            NO_DIGITISER,
        ),
    ]
}

/// Refuses a sampling interval that no digitiser has.
pub(crate) fn check_interval(interval_ns: f64, remedy: &str) -> Result<()> {
    if INTERVAL_NS.contains(&interval_ns) {
        return Ok(());
    }
    let why = match () {
        () if INTERVAL_NS.contains(&(1000.0 * interval_ns)) => {
            ": the spacing seems to be in nanoseconds, not in picoseconds"
        }
        () if INTERVAL_NS.contains(&(0.001 * interval_ns)) => {
            ": the spacing seems to be in picoseconds, not in nanoseconds"
        }
        () => "",
    };
    Err(StageError::failed(
        format!(
            "samples {interval_ns} ns apart {NO_DIGITISER} ({} to {} ns){why}",
            INTERVAL_NS.start(),
            INTERVAL_NS.end()
        ),
        remedy,
    ))
}

/// Refuses a group velocity that light does not have in air.
pub(crate) fn check_velocity(velocity_mps: f64, of: &str, remedy: &str) -> Result<()> {
    if VELOCITY_MPS.contains(&velocity_mps) {
        return Ok(());
    }
    let why = explanation(velocity_mps);
    Err(StageError::failed(
        format!("{of} {SPEED} of {velocity_mps:.3e} m/s; in air it has 2.997e8: {why}"),
        remedy,
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

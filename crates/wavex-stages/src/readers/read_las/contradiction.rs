//! Contradictions between the beams, return locations and points of a LAS file.

use super::geometry::FileGeometry;
use crate::reading::emission_choice::lone_peak;
use crate::reading::plausible;
use wavex_formats::las::{Point, Reader};
use wavex_line::plausibility::Check;
use wavex_line::stage::{Result, StageError};
use wavex_simd::statistics::median;

/// Number of points looked at, and single echoes needed.
const MOST_POINTS: usize = 5_000;
const FEWEST_ECHOES: usize = 30;
/// Largest median distance of points from the peaks of their single echoes, m.
const FARTHEST_M: f64 = 1.0;

/// Words of the message.
const FROM_PEAKS: &str = "from the peaks of their waveforms";

/// Words of the warning for packets with more samples than declared.
pub(super) const MORE_SAMPLES: &str = "have more samples than their descriptor says";

/// The checks of a LAS file.
pub(crate) fn checks() -> Vec<Check> {
    let packets = Check::warning(
        "size of a waveform packet and the number of samples in its descriptor",
        "fewer than two more samples; samples of 9 to 15 bits in packed form or in words of 16 bits",
        "packets may be padded to whole bytes",
        MORE_SAMPLES,
    );
    let locations = Check::error(
        "return locations of LAS and the peaks of single echoes, median along the beam",
        format!(
            "{FARTHEST_M} m, by at least {FEWEST_ECHOES} single echoes of the first {MOST_POINTS} points"
        ),
        "two sampling intervals of a slow digitiser; wrong locations are metres off",
        FROM_PEAKS,
    )
    .with_key("check_locations");
    vec![locations, packets]
}

/// The check of the records of the coordinate reference system.
pub(crate) fn crs_check() -> Check {
    Check::warning(
        "WKT and GeoTIFF records of LAS and PulseWaves",
        "each can be read, and both name one system",
        "LAS 1.4: the WKT bit says which of them counts",
        "the WKT record cannot be read",
    )
    .with_key("crs_of_input")
}

/// Refuses vectors and sampling intervals that contradict physics, if any waveform can be read.
pub(super) fn check_beams(geometry: &FileGeometry) -> Result<()> {
    let Some(sampling) = geometry.sampling else { return Ok(()) };
    plausible::check_interval(
        f64::from(sampling.spacing_ps) / 1000.0,
        "export the file again with the temporal sample spacing in picoseconds",
    )?;
    plausible::check_velocity(
        geometry.group_velocity_mps,
        "the direction vectors of the points",
        "export the vectors in metres per picosecond of one-way path, or set `beam_vectors = \"direction\"` of \
         the reader to use only their directions",
    )
}

/// Refuses return locations that do not lie at the echoes of their waveforms.
///
/// The points of the file are the reference: where a waveform has a single echo and a single point, the
/// location is to be that of its peak.
pub(super) fn check_locations(reader: &mut Reader, geometry: &FileGeometry) -> Result<()> {
    let mut echoes: Vec<SingleEcho> = Vec::new();
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
            echoes.push(SingleEcho { peak_ns: peak * spacing_ns, location_ns, last_ns });
        }
    }
    if echoes.len() < FEWEST_ECHOES {
        return Ok(());
    }
    let metres_per_ns = 0.5e-9 * geometry.group_velocity_mps;
    let off_m = |location_ns: fn(&SingleEcho) -> f64| {
        metres_per_ns
            * median(echoes.iter().map(|echo| (echo.peak_ns - location_ns(echo)).abs())).unwrap_or(f64::NAN)
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
            "the points of {} single echoes lie {as_stored_m:.1} m {FROM_PEAKS} (median, along the beam), by their \
             return locations: {why}",
            echoes.len()
        ),
        "if the packets are in a .wdp or .wdz file, copy both files again: it may be that of another recording; \
         otherwise export the file again with return locations; if points and packets belong together and the \
         locations are right, set `check_locations = false` of the reader",
    ))
}

/// A single echo with one point, times since the first sample.
struct SingleEcho {
    peak_ns: f64,
    location_ns: f64,
    last_ns: f64,
}

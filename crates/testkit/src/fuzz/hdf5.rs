//! Granules of GEDI and LVIS, and pulses of SPD, in HDF5.

use std::path::Path;

use wavex_hdf5::{Granule, Shot, SpdPulse, SpdReader};

use super::Files;

/// Most shots of a beam that are read; a file can declare millions.
const MOST_SHOTS: usize = 200;

/// Most samples of a waveform.
const MOST_SAMPLES: usize = 65_536;

/// An HDF5 file.
pub fn hdf5(bytes: &[u8]) {
    let place = Files::with(&[("a.h5", bytes)]);
    spd(&place.path("a.h5"));
    let Ok(granule) = Granule::open(&place.path("a.h5")) else { return };
    for beam in granule.beams() {
        let Ok(mut reader) = granule.beam(&beam.name) else { continue };
        assert_eq!(reader.len() as u64, beam.shots);
        let mut shots = Vec::new();
        for index in 0..reader.len().min(MOST_SHOTS) {
            let mut shot = Shot::default();
            let read = reader.shot(index, &mut shot).is_ok();
            if read {
                assert_eq!(shot.columns.len(), reader.columns().len());
                assert!(shot.received_dn.len() <= MOST_SAMPLES && shot.outgoing_dn.len() <= MOST_SAMPLES);
                for place in [shot.first_bin, shot.last_bin, shot.instrument] {
                    assert!(
                        !place.is_known()
                            || place.latitude_rad.abs() <= 1.6 && place.longitude_rad.abs() <= 3.2
                    );
                }
            }
            // As text, in which values that are no numbers are equal.
            shots.push(read.then(|| format!("{shot:?}")));
        }
        // The order of reading does not matter.
        for (index, expected) in shots.iter().enumerate().rev() {
            let mut shot = Shot::default();
            let read = reader.shot(index, &mut shot).is_ok();
            assert_eq!(read.then(|| format!("{shot:?}")), *expected, "shot {index} of {}", beam.name);
        }
    }
}

/// Pulses of a file, if it has any: the order of reading does not matter.
fn spd(path: &Path) {
    let Ok(mut reader) = SpdReader::open(path) else { return };
    let read = |reader: &mut SpdReader, index| {
        let mut pulse = SpdPulse::default();
        let is_read = reader.pulse(index, &mut pulse).is_ok();
        for waveform in pulse.waveforms() {
            assert!(waveform.gain > 0.0);
            let counts = [waveform.received_dn.len(), waveform.transmitted_dn.len()];
            assert!(counts.iter().all(|&count| count <= MOST_SAMPLES), "{counts:?}");
        }
        is_read.then(|| format!("{pulse:?}"))
    };
    let count = reader.len().min(MOST_SHOTS as u64);
    let pulses: Vec<Option<String>> = (0..count).map(|index| read(&mut reader, index)).collect();
    for (index, expected) in pulses.iter().enumerate().rev() {
        assert_eq!(read(&mut reader, index as u64), *expected, "pulse {index}");
    }
}

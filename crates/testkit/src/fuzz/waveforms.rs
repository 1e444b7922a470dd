//! PulseWaves.

use wavex_formats::pulsewaves::{Reader, WaveSegments};

use super::{Files, parts};

/// Most pulses of an input that are read.
const MOST_PULSES: u64 = 5_000;

/// A PulseWaves file (`.pls`), and its waves (`.wvs`) as second part.
pub fn pulsewaves(bytes: &[u8]) {
    read(bytes, ["a.pls", "a.wvs"]);
}

/// A compressed PulseWaves file (`.plz`), and its waves (`.wvz`) as second part.
pub fn compressed_pulses(bytes: &[u8]) {
    read(bytes, ["a.plz", "a.wvz"]);
}

fn read(bytes: &[u8], [pulses, waves]: [&str; 2]) {
    let parts = parts(bytes);
    let place = Files::with(&[(pulses, parts[0]), (waves, parts.get(1).copied().unwrap_or_default())]);
    let Ok(mut reader) = Reader::open(&place.path(pulses)) else { return };
    let _ = (reader.check_complete(), reader.stray_bytes(), reader.header().time_axis());
    let is_compressed = reader.records().iter().any(|record| record.record_id == 5);
    assert!(is_compressed || reader.pulse_count() <= parts[0].len() as u64, "more pulses than bytes");
    let mut waves = WaveSegments::new();
    for index in 0..reader.pulse_count().min(MOST_PULSES) {
        let Ok(pulse) = reader.pulse(index) else { continue };
        let _ = (pulse.position(1000.0), reader.header().gps_time_s(pulse.t));
        if reader.waves(&pulse, &mut waves).is_err() {
            assert!(waves.segments().is_empty());
            continue;
        }
        let samples = |waves: &WaveSegments| -> usize {
            waves.segments().iter().map(|segment| waves.samples(segment).len()).sum()
        };
        for segment in waves.segments() {
            assert_eq!(waves.samples(segment).len(), segment.sample_count());
            let _ = segment.duration_of(1.0);
        }
        let n_samples = samples(&waves);
        waves.read_outgoing_as_bytes();
        assert_eq!(samples(&waves), n_samples);
    }
    assert!(reader.pulse(reader.pulse_count()).is_err());
}

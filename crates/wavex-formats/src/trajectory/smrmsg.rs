//! smrmsg, the accuracies of an SBET.
//!
//! Records of ten little-endian doubles, no header. Source: Applanix, "POSPac MMS User Guide",
//! appendix on output file formats.

use super::Result;
use super::input::InputFile;
use wavex_geodesy::trajectory::{Accuracy, AccuracySample};

/// Size of a record, bytes.
pub(super) const RECORD_BYTES: usize = 80;

/// Returns whether a file of this length may be smrmsg.
///
/// It needs whole records and a plausible first record.
pub(super) fn is_one(head: &[u8], length: u64) -> bool {
    let numbers: Vec<f64> = head
        .chunks_exact(8)
        .take(10)
        .map(|bytes| f64::from_le_bytes(bytes.try_into().unwrap_or_default()))
        .collect();
    let is_deviation = |value: &f64| (0.0..1e5).contains(value);
    length.is_multiple_of(RECORD_BYTES as u64)
        && numbers.len() == 10
        && numbers[0].is_finite()
        && numbers[1..].iter().all(is_deviation)
        && numbers[1..4].iter().all(|position| *position > 1e-9)
}

/// Reads all accuracies, with times as in the file.
pub(super) fn read(input: &mut InputFile) -> Result<Vec<AccuracySample>> {
    let mut samples = Vec::new();
    input.each(RECORD_BYTES, None, |_, mut fields| {
        let time_s = fields.f64("time")?;
        let position_sd_m = [
            fields.f64("north position RMS")?,
            fields.f64("east position RMS")?,
            fields.f64("down position RMS")?,
        ];
        fields.skip(24, "velocity RMS")?;
        let minutes = [fields.f64("roll RMS")?, fields.f64("pitch RMS")?, fields.f64("heading RMS")?];
        let attitude_sd_rad = minutes.map(|minutes| (minutes / 60.0).to_radians());
        samples.push(AccuracySample { time_s, accuracy: Accuracy { position_sd_m, attitude_sd_rad } });
        Ok(())
    })?;
    Ok(samples)
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// Builds an smrmsg file of these times, with field `k` = 0.01 `k` m or arc-minutes.
    pub(in super::super) fn made(times_s: &[f64]) -> Vec<u8> {
        let record =
            |time_s: &f64| [*time_s, 0.01, 0.02, 0.03, 0.04, 0.05, 0.06, 0.6, 1.2, 6.0].map(f64::to_le_bytes);
        times_s.iter().flat_map(record).flatten().collect()
    }

    #[test]
    fn arc_minutes_become_radians() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("smrmsg_1.out");
        let bytes = made(&[10.0, 11.0]);
        assert!(
            is_one(&bytes, 160) && !is_one(&bytes, 161) && !is_one(&[0; 80], 80) && !is_one(&bytes[..72], 80)
        );
        std::fs::write(&path, bytes).unwrap();
        let samples = read(&mut InputFile::open(&path).unwrap()).unwrap();
        assert_eq!(samples[1].time_s, 11.0);
        assert_eq!(samples[0].accuracy.position_sd_m, [0.01, 0.02, 0.03]);
        assert_eq!(samples[0].accuracy.attitude_sd_rad, [0.01f64, 0.02, 0.1].map(f64::to_radians));
    }
}

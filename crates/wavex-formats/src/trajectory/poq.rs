//! POQ, the accuracies of a POF.
//!
//! The layout is taken from public readers. All fields are little-endian and packed: a header of 67
//! bytes, then records of the time, six standard deviations, the dilution of precision, and the
//! number of satellites (two counts from version 1.1 on, one before).

use super::super::Error;
use super::super::bytes::Fields;
use super::Result;
use super::input::InputFile;
use wavex_geodesy::trajectory::{Accuracy, AccuracySample};

/// First bytes of a POQ file.
///
/// A POF has a zero byte instead of the last blank.
pub(super) const MAGIC: &[u8; 27] = b"RIEGL POSITION&ORIENTATION ";

/// Size of the title at the beginning of the header, bytes.
const TITLE_BYTES: usize = 35;
/// Size of the header, bytes.
const HEADER_BYTES: usize = 67;

/// Reads all accuracies, with times as in the file.
pub(super) fn read(input: &mut InputFile) -> Result<Vec<AccuracySample>> {
    let path = input.path.clone();
    let header = input.header(HEADER_BYTES)?;
    let mut fields = Fields::new(&path, 0, &header);
    fields.skip(TITLE_BYTES, "title")?;
    let [major, minor] = [fields.u16("major version")?, fields.u16("minor version")?];
    if major != 1 {
        let remedy = "export it as POQ 1.1, or leave it out";
        return Err(fields.bad("version", format!("version {major}.{minor} is not supported"), remedy));
    }
    let begin = fields.clone();
    let data_offset = fields.u32("data offset")?;
    if (data_offset as usize) < TITLE_BYTES + 8 {
        let problem = format!("records at byte {data_offset} would lie in the header");
        return Err(Error::malformed(
            &path,
            begin.offset(),
            "data offset",
            problem,
            "the file is damaged: export it again",
        ));
    }
    input.go_to(data_offset.into())?;
    let mut samples = Vec::new();
    input.each(if minor == 0 { 66 } else { 68 }, None, |_, fields| {
        samples.push(decode(fields)?);
        Ok(())
    })?;
    Ok(samples)
}

fn decode(mut fields: Fields) -> Result<AccuracySample> {
    let time_s = fields.f64("time")?;
    let position_sd_m = [fields.f64("sigma north")?, fields.f64("sigma east")?, fields.f64("sigma down")?];
    let angles_deg = [fields.f64("sigma roll")?, fields.f64("sigma pitch")?, fields.f64("sigma yaw")?];
    let accuracy = Accuracy { position_sd_m, attitude_sd_rad: angles_deg.map(f64::to_radians) };
    Ok(AccuracySample { time_s, accuracy })
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// Builds a POQ 1.1 file of these times, with standard deviations of 1 to 6.
    pub(in super::super) fn made(times_s: &[f64]) -> Vec<u8> {
        let mut bytes = b"RIEGL POSITION&ORIENTATION QUALITY\0".to_vec();
        bytes.extend([1, 0, 1, 0]);
        bytes.extend(67u32.to_le_bytes());
        bytes.extend([0; 24]);
        for time_s in times_s {
            for value in [*time_s, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 1.5] {
                bytes.extend(value.to_le_bytes());
            }
            bytes.extend([8, 0, 6, 0]);
        }
        bytes
    }

    fn read_bytes(bytes: &[u8]) -> std::result::Result<Vec<AccuracySample>, String> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.poq");
        std::fs::write(&path, bytes).unwrap();
        let read = read(&mut InputFile::open(&path).unwrap());
        read.map_err(|error| error.to_string().replace(&format!("{}/", folder.path().display()), ""))
    }

    #[test]
    fn accuracies_in_degrees_become_radians() {
        let samples = read_bytes(&made(&[10.0, 11.0])).unwrap();
        assert_eq!(samples.iter().map(|sample| sample.time_s).collect::<Vec<_>>(), [10.0, 11.0]);
        assert_eq!(samples[0].accuracy.position_sd_m, [1.0, 2.0, 3.0]);
        assert_eq!(samples[1].accuracy.attitude_sd_rad, [4f64, 5.0, 6.0].map(f64::to_radians));
    }

    #[test]
    fn version_1_0_counts_satellites_once() {
        let mut bytes = made(&[10.0]);
        bytes[37] = 0;
        bytes.truncate(67 + 66);
        assert_eq!(read_bytes(&bytes).unwrap().len(), 1);
    }

    #[test]
    fn what_is_no_poq_is_refused() {
        let mut bytes = made(&[10.0]);
        bytes[35] = 2;
        assert_eq!(
            read_bytes(&bytes).unwrap_err(),
            "a.poq: byte 39: version: version 2.1 is not supported; export it as POQ 1.1, or leave \
             it out"
        );
        let mut bytes = made(&[10.0]);
        bytes[39] = 40;
        assert_eq!(
            read_bytes(&bytes).unwrap_err(),
            "a.poq: byte 39: data offset: records at byte 40 would lie in the header; the file is damaged: export it again"
        );
        let cut = &made(&[10.0])[..100];
        assert_eq!(
            read_bytes(cut).unwrap_err(),
            "a.poq: byte 67: record 1: 68 bytes needed, 33 left; the file is cut off: copy it \
             again from its source"
        );
    }
}

//! Calibration files, and the range scale of a return.

use std::path::Path;

use schemars::JsonSchema;

use crate::keys::Keys;
use crate::scan_line::ReturnChannel;
use wavex_formats::extensions::has_extension;
use wavex_formats::{Error, Result, read_small_text};
pub use wavex_geodesy::calibration::Calibration;

/// Size limit of a calibration file, bytes.
const MOST_BYTES: u64 = 100_000;

const REMEDY: &str = "a calibration is a TOML file with `lever_arm_m`, `boresight_deg`, `e0` to `e7` and `time_offset_s`, or text of 12 to \
                      14 numbers: lever arm X Y Z (m), boresight roll pitch yaw (degrees), e0 to e5 and optionally e6 e7";

/// Reads a calibration file.
///
/// A name ending in `.toml` means TOML. Other files hold the 12 to 14 numbers of BayesWavEx's
/// `-calib_corr` (lever arm, boresight, e0 to e7), separated by spaces, commas or line ends;
/// `#` starts a comment, and words are skipped.
///
/// # Errors
/// A file that cannot be read, or is neither.
pub fn read_calibration(path: &Path) -> Result<Calibration> {
    let text = read_small_text(path, MOST_BYTES, "a calibration", REMEDY)?;
    let is_toml = has_extension(path, "toml");
    let found = if is_toml {
        toml::from_str(&text).map_err(|error| error.to_string().trim_end().to_owned())
    } else {
        of_numbers(&text)
    };
    let found = found.map_err(|problem| Error::unusable(path, problem, REMEDY))?;
    // Implausible lengths and angles are typing or unit errors.
    match Keys::of(Calibration::json_schema).violation(&found) {
        Some(problem) => Err(Error::unusable(path, problem, REMEDY)),
        None => Ok(found),
    }
}

fn of_numbers(text: &str) -> std::result::Result<Calibration, String> {
    let lines = text.lines().map(|line| line.split('#').next().unwrap_or_default());
    let words = lines.flat_map(|line| line.split([' ', '\t', ',', ';', '{', '}', ':', '=']));
    // Names such as `e0` and `Boresight` precede their numbers; a word that starts like a
    // number must be one.
    let begins_as_number =
        |word: &&str| word.starts_with(|first: char| first.is_ascii_digit() || "+-.".contains(first));
    let mut numbers = [0.0; 14];
    let mut n = 0;
    for word in words.filter(begins_as_number) {
        let number = word.parse().map_err(|_| format!("`{word}` is not a number"))?;
        if let Some(place) = numbers.get_mut(n) {
            *place = number;
        }
        n += 1;
    }
    if !(12..=14).contains(&n) {
        return Err(format!("it has {n} numbers instead of 12 to 14"));
    }
    let [x, y, z, roll, pitch, yaw, e0, e1, e2, e3, e4, e5, e6, e7] = numbers;
    Ok(Calibration {
        lever_arm_m: [x, y, z],
        boresight_deg: [roll, pitch, yaw],
        e0,
        e1,
        e2,
        e3,
        e4,
        e5,
        e6,
        e7,
        time_offset_s: 0.0,
    })
}

/// Whether a return is on the time scale of the low-power receiver.
///
/// That holds for its own returns, and for all others once the receivers are fused, because fusion
/// shifts the times of the high-power receiver to its scale.
pub fn is_on_low_power_scale(channel: ReturnChannel, fused: bool) -> bool {
    fused || channel != ReturnChannel::High
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(name: &str, text: &str) -> std::result::Result<Calibration, String> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(name);
        std::fs::write(&path, text).unwrap();
        let here = format!("{}: ", path.display());
        read_calibration(&path).map_err(|error| error.to_string().replace(&here, ""))
    }

    #[test]
    fn numbers_stand_in_the_classic_order() {
        let text = "LeverArms: 0.1 -0.2 0.3 # m\nBoresight {0.01, 0.02, -0.03}\nInternal\n1 2e-3 3e-3 4e-3 5e-3 6 7e-3 8\n";
        let found = read("calib.txt", text).unwrap();
        assert_eq!((found.lever_arm_m, found.boresight_deg), ([0.1, -0.2, 0.3], [0.01, 0.02, -0.03]));
        let internal = [found.e0, found.e1, found.e2, found.e3, found.e4, found.e5, found.e6, found.e7];
        assert_eq!(internal, [1.0, 2e-3, 3e-3, 4e-3, 5e-3, 6.0, 7e-3, 8.0]);
        let short = read("calib.cor", "0 0 0\n0 0 0\n1 0 0 0 0 0\n").unwrap();
        assert_eq!(short, Calibration { e0: 1.0, ..Calibration::default() });
    }

    #[test]
    fn toml_has_the_names_of_the_job() {
        let found = read("calib.toml", "lever_arm_m = [1, 2.5, 3]\ne7 = -0.1\n").unwrap();
        assert_eq!(found, Calibration { lever_arm_m: [1.0, 2.5, 3.0], e7: -0.1, ..Calibration::default() });
        let error = read("calib.toml", "lever_arms_m = [1, 2, 3]\n").unwrap_err();
        assert!(error.contains("unknown field `lever_arms_m`") && error.ends_with(REMEDY), "{error}");
    }

    #[test]
    fn what_is_no_calibration_is_refused() {
        let refused = |text: &str| read("calib.txt", text).unwrap_err();
        assert_eq!(refused("1 2 3\n"), format!("it has 3 numbers instead of 12 to 14; {REMEDY}"));
        assert_eq!(refused("1..2 2 3\n"), format!("`1..2` is not a number; {REMEDY}"));
        let error = refused("200 0 0 0 0 0 0 0 0 0 0 0");
        assert_eq!(
            error,
            format!("`lever_arm_m` must be at least -100 and at most 100, got 200.0; {REMEDY}")
        );
        let error = refused("0 0 0 400 0 0 0 0 0 0 0 0");
        assert_eq!(
            error,
            format!("`boresight_deg` must be at least -360 and at most 360, got 400.0; {REMEDY}")
        );
        let error = refused("0 0 0 0 0 0 101 0 0 0 0 0");
        assert_eq!(error, format!("`e0` must be at least -100 and at most 100, got 101.0; {REMEDY}"));
        let error = refused("0 0 0 0 0 0 0 0.6 0 0 0 0");
        assert_eq!(error, format!("`e1` must be at least -0.5 and at most 0.5, got 0.6; {REMEDY}"));
        let error = read("calib.toml", "e5 = nan").unwrap_err();
        let problem = "`e5` must be at least -1000000 and at most 1000000, got a number that is not finite";
        assert_eq!(error, format!("{problem}; {REMEDY}"));
        let error = refused(&"0 ".repeat(60_000));
        assert_eq!(error, format!("120000 bytes is too large for a calibration; {REMEDY}"));
        let missing = read_calibration(Path::new("no_such_calibration")).unwrap_err().to_string();
        assert!(missing.starts_with("no_such_calibration: cannot open: "), "{missing}");
    }

    #[test]
    fn returns_know_their_range_scale() {
        let scales = [ReturnChannel::Low, ReturnChannel::High, ReturnChannel::Joint];
        assert_eq!(scales.map(|channel| is_on_low_power_scale(channel, false)), [true, false, true]);
        assert_eq!(scales.map(|channel| is_on_low_power_scale(channel, true)), [true; 3]);
    }
}

//! Ground truth: the result of a perfect evaluation of the recorded waveforms.

use std::io::Write;

use super::scene::Class;

/// A true echo in a recorded block.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrueReturn {
    /// Number of the shot.
    pub shot: u64,
    /// 1 for the first return of its shot.
    pub return_number: u8,
    /// Number of returns of the shot.
    pub number_of_returns: u8,
    /// Emission time after the shot's clock, ns.
    pub emission_ns: f64,
    /// Time from emission to echo, ns.
    pub time_of_flight_ns: f64,
    /// Distance along the beam, m.
    pub range_m: f64,
    /// Recorded peak amplitude above the background, DN.
    ///
    /// Includes the gain; exceeds the digitiser's limits if the echo is saturated.
    pub amplitude_dn: f64,
    /// FWHM relative to the FWHM of a flat target's echo (of Gaussians with the response's width).
    pub width_ratio: f64,
    /// Position of the echo, m: easting, northing and height in the map.
    pub point_m: [f64; 3],
    /// Emissions between the pulse's emission and the block that contains the echo.
    ///
    /// In a resolved recording, counted as if the laser did not pause between lines. As recorded,
    /// relative to the shot that the block is stored with.
    pub zone: i16,
    /// Whether the high-power receiver recorded it as well.
    pub in_high_power: bool,
    /// Source of the echo.
    pub class: Class,
    /// Peak amplitude in a sensitive receiver without limits, DN.
    pub linear_dn: f64,
    /// Gain of the receivers for this echo.
    pub gain: f64,
}

/// Columns of a table of ground truth.
pub const COLUMNS: &str = "shot,return_number,number_of_returns,emission_ns,time_of_flight_ns,range_m,amplitude_dn,\
                           width_ratio,x,y,z,zone,channel,class,linear_dn";

/// Column after [`COLUMNS`] for recordings with automatic gain control.
pub const GAIN_COLUMN: &str = ",gain";

impl TrueReturn {
    /// Appends a row with these [`COLUMNS`] to `out`.
    ///
    /// Numbers have as many digits as needed to read back the same bits. `with_gain` adds
    /// [`GAIN_COLUMN`].
    pub fn write(&self, out: &mut Vec<u8>, with_gain: bool) {
        let [x, y, z] = self.point_m;
        // Writing to memory cannot fail.
        let _ = write!(out, "{},{},{},", self.shot, self.return_number, self.number_of_returns);
        let _ = write!(out, "{},{},{},", self.emission_ns, self.time_of_flight_ns, self.range_m);
        let _ = write!(out, "{},{},{x},{y},{z},", self.amplitude_dn, self.width_ratio);
        let channel = if self.in_high_power { "both" } else { "low" };
        let _ = write!(out, "{},{channel},{},{}", self.zone, name_of(self.class), self.linear_dn);
        if with_gain {
            let _ = write!(out, ",{}", self.gain);
        }
        out.push(b'\n');
    }
}

/// Name of a class in the table.
fn name_of(class: Class) -> &'static str {
    match class {
        Class::Ground => "ground",
        Class::Roof => "roof",
        Class::Wall => "wall",
        Class::Leaves => "leaves",
        Class::Wire => "wire",
        Class::FalseAlarm => "false_alarm",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_round_trip_to_the_bit() {
        let truth = TrueReturn {
            shot: 7,
            return_number: 2,
            number_of_returns: 3,
            emission_ns: 0.1 + 0.2,
            time_of_flight_ns: 4003.1,
            range_m: 600.0 / 0.7,
            amplitude_dn: 1.0 / 3.0,
            width_ratio: 1.0,
            point_m: [320_000.25, 5_300_000.1, 400.0],
            zone: 3,
            in_high_power: true,
            class: Class::Leaves,
            linear_dn: 0.5,
            gain: 0.25,
        };
        let mut row = Vec::new();
        truth.write(&mut row, false);
        let row = String::from_utf8(row).unwrap();
        assert_eq!(
            row,
            "7,2,3,0.30000000000000004,4003.1,857.1428571428572,0.3333333333333333,1,320000.25,5300000.1,400,\
             3,both,leaves,0.5\n"
        );
        assert_eq!(row.split(',').count(), COLUMNS.split(',').count());
        let mut with_gain = Vec::new();
        truth.write(&mut with_gain, true);
        assert_eq!(String::from_utf8(with_gain).unwrap(), row.replace('\n', ",0.25\n"));
    }
}

//! Sensor positions from beam intersections, section by section.

use super::decimation::Pace;
use wavex_line::scan_line::Emission;
use wavex_signal::sensor_path::{Beam, Window};

/// Collects beams until a section is long enough.
pub(super) struct Met {
    pace: Pace,
    window: Window,
    has_gps_time: bool,
    /// Number of beams at the last fit, which was inconclusive.
    looked_at: u64,
    without_place: u64,
}

/// Estimated position of the sensor.
#[derive(Clone, Copy, Debug)]
pub(super) struct MetPlace {
    /// NaN if shots have no GPS time.
    pub(super) gps_time_s: f64,
    pub(super) position_m: [f64; 3],
    pub(super) sd_m: f64,
}

/// Largest accepted standard deviation of a position, m.
const MOST_SD_M: f64 = 5.0;
/// Length at which a section without a position is abandoned, s.
const LONGEST_S: f64 = 2.0;

impl Met {
    pub(super) fn new(pace: Pace) -> Met {
        Met { pace, window: Window::default(), has_gps_time: true, looked_at: 0, without_place: 0 }
    }

    /// Adds a shot; returns the position of the section that ends with it.
    pub(super) fn add(&mut self, emission: &Emission) -> Option<MetPlace> {
        let time_s = emission.time_s();
        self.window.add(&Beam { time_s, through_m: emission.origin_m, direction: emission.direction });
        self.has_gps_time &= emission.gps_time_s.is_finite();
        let (n, length_s) = (self.window.n_beams(), self.window.length_s());
        let is_given_up = !(0.0..=LONGEST_S).contains(&length_s);
        // Fit only after 25 % more beams; a fit at every shot would be slow.
        let may_look = self.pace.is_over(n, length_s) && (n >= self.looked_at * 5 / 4);
        if !is_given_up && !may_look {
            return None;
        }
        let found = self.place().filter(|_| length_s >= 0.0);
        self.looked_at = n;
        if found.is_none() && !is_given_up {
            return None;
        }
        *self = Met { without_place: self.without_place + u64::from(found.is_none()), ..Met::new(self.pace) };
        found
    }

    /// Position of the section so far, if it is accurate enough.
    pub(super) fn place(&self) -> Option<MetPlace> {
        let place = self.window.place().filter(|place| place.sd_m < MOST_SD_M)?;
        let gps_time_s = if self.has_gps_time { place.time_s } else { f64::NAN };
        Some(MetPlace { gps_time_s, position_m: place.position_m, sd_m: place.sd_m })
    }

    /// Length of the section so far, s; 0 without shots.
    pub(super) fn length_s(&self) -> f64 {
        if self.window.n_beams() == 0 { 0.0 } else { self.window.length_s() }
    }

    /// Number of abandoned sections.
    pub(super) fn n_without_place(&self) -> u64 {
        self.without_place
    }
}

//! When each pulse leaves, from where, and in which direction.

use super::scene::Area;

/// The aircraft's first position, m: easting and northing in UTM zone 33 north, 180 km west of its meridian, where the
/// map's scale is 1: a metre of the world is a metre of the map.
const START_M: [f64; 2] = [320_000.0, 5_300_000.0];
/// The height of the level ground, m above the ellipsoid.
pub const GROUND_HEIGHT_M: f64 = 400.0;
/// GPS week of the flight: from 4 May 2025 on.
pub const GPS_WEEK: u32 = 2365;
/// Day of the year, and year, of the flight: the Tuesday of that week.
pub const RECORDED: (u16, u16) = (126, 2025);
/// When it begins, s of the GPS week: at ten in the morning.
const START_S: f64 = 2.0 * 86_400.0 + 36_000.0;
/// When it begins on the instrument's clock, ns.
const CLOCK_START_NS: i64 = 1_000_000_000_000;
/// Facets of the rotating mirror.
const FACETS: u32 = 4;

/// The coordinate reference system of `START_M`: WGS 84 / UTM zone 33N (EPSG:32633) as WKT 1 (OGC 01-009).
pub const CRS_WKT: &str = concat!(
    r#"PROJCS["WGS 84 / UTM zone 33N",GEOGCS["WGS 84",DATUM["WGS_1984","#,
    r#"SPHEROID["WGS 84",6378137,298.257223563,AUTHORITY["EPSG","7030"]],AUTHORITY["EPSG","6326"]],"#,
    r#"PRIMEM["Greenwich",0,AUTHORITY["EPSG","8901"]],"#,
    r#"UNIT["degree",0.0174532925199433,AUTHORITY["EPSG","9122"]],AUTHORITY["EPSG","4326"]],"#,
    r#"PROJECTION["Transverse_Mercator"],PARAMETER["latitude_of_origin",0],"#,
    r#"PARAMETER["central_meridian",15],PARAMETER["scale_factor",0.9996],"#,
    r#"PARAMETER["false_easting",500000],PARAMETER["false_northing",0],"#,
    r#"UNIT["metre",1,AUTHORITY["EPSG","9001"]],AXIS["Easting",EAST],AXIS["Northing",NORTH],"#,
    r#"AUTHORITY["EPSG","32633"]]"#,
);

/// A rotating polygon mirror in an aircraft that flies north, level and straight.
///
/// Each facet sweeps one scan line, from the left end of the swath to the right; then half a line's time passes until
/// the next facet faces the ground.
#[derive(Clone, Debug, PartialEq)]
pub struct Scanner {
    /// Shots of each scan line.
    pub shots_per_line: u32,
    /// Pulses per second.
    pub pulse_rate_hz: f64,
    /// The first and the last shot's angle from straight down, radians, positive to the right.
    pub scan_angle_rad: [f64; 2],
    /// Height above the level ground, m.
    pub flying_height_m: f64,
    /// Speed over ground, m/s.
    pub speed_mps: f64,
}

/// A pulse on its way.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shot {
    /// Running number, from 0.
    pub number: u64,
    /// The last tick of the sample clock before the pulse leaves, ps.
    pub clock_ps: i64,
    /// The same moment, s of the GPS week.
    pub gps_time_s: f64,
    /// Where the beam starts, m in the map.
    pub origin_m: [f64; 3],
    /// Unit vector along the beam, in the map.
    pub direction: [f64; 3],
    /// Angle from straight down, radians, positive to the right.
    pub scan_angle_rad: f64,
    /// Mirror facet.
    pub facet: u16,
}

impl Scanner {
    /// A shot by its scan line and its place in the line, both from 0.
    pub fn shot(&self, line: u32, index: u32) -> Shot {
        let since_start_ns = (1e9 * self.time_s(line, index)).floor();
        let since_start_s = 1e-9 * since_start_ns;
        let scan_angle_rad = self.angle_rad(index);
        let [x, y] = START_M;
        Shot {
            number: u64::from(line) * u64::from(self.shots_per_line) + u64::from(index),
            clock_ps: 1000 * (CLOCK_START_NS + since_start_ns as i64),
            gps_time_s: START_S + since_start_s,
            origin_m: [x, y + self.speed_mps * since_start_s, GROUND_HEIGHT_M + self.flying_height_m],
            direction: [libm::sin(scan_angle_rad), 0.0, -libm::cos(scan_angle_rad)],
            scan_angle_rad,
            facet: (line % FACETS) as u16,
        }
    }

    /// The ground that `lines` scan lines cover.
    pub fn swath(&self, lines: u32) -> Area {
        let across = |angle_rad| START_M[0] + self.flying_height_m * libm::tan(angle_rad);
        let along = |line| START_M[1] + self.speed_mps * self.time_s(line, 0);
        Area { x: self.scan_angle_rad.map(across), y: [along(0), along(lines)] }
    }

    /// The nominal time of a shot since the start, s.
    fn time_s(&self, line: u32, index: u32) -> f64 {
        let pulses_per_line = 1.5 * f64::from(self.shots_per_line);
        (f64::from(line) * pulses_per_line + f64::from(index)) / self.pulse_rate_hz
    }

    fn angle_rad(&self, index: u32) -> f64 {
        let [first, last] = self.scan_angle_rad;
        let steps = f64::from(self.shots_per_line.saturating_sub(1).max(1));
        first + (last - first) * (f64::from(index) / steps)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scanner() -> Scanner {
        Scanner {
            shots_per_line: 1001,
            pulse_rate_hz: 150_000.0,
            scan_angle_rad: [-0.5, 0.5],
            flying_height_m: 600.0,
            speed_mps: 60.0,
        }
    }

    #[test]
    fn a_line_sweeps_the_swath_from_left_to_right() {
        let shots: Vec<Shot> = (0..1001).map(|index| scanner().shot(3, index)).collect();
        assert_eq!((shots[0].scan_angle_rad, shots[1000].scan_angle_rad), (-0.5, 0.5));
        assert_eq!(shots[500].direction, [0.0, 0.0, -1.0]);
        assert_eq!(shots[0].number, 3003);
        assert!(shots.iter().all(|shot| shot.facet == 3));
        for shot in &shots {
            let length = shot.direction.iter().map(|d| d * d).sum::<f64>().sqrt();
            assert!((length - 1.0).abs() < 1e-15);
            let ground = shot.origin_m[0] + 600.0 * shot.scan_angle_rad.tan();
            assert!((scanner().swath(1).x[0] - 1e-9..scanner().swath(1).x[1] + 1e-9).contains(&ground));
        }
    }

    #[test]
    fn time_goes_on_by_the_pulse_rate_and_pauses_between_lines() {
        let at = |line, index| scanner().shot(line, index);
        // 6666.67 ns between pulses: the sample clock says whole nanoseconds.
        assert_eq!(at(0, 1).clock_ps - at(0, 0).clock_ps, 6_666_000);
        assert_eq!(at(0, 3).clock_ps - at(0, 0).clock_ps, 20_000_000);
        let line_s = 1.5 * 1001.0 / 150_000.0;
        assert!((at(100, 0).gps_time_s - at(0, 0).gps_time_s - 100.0 * line_s).abs() < 2e-9);
        assert!((at(100, 0).origin_m[1] - at(0, 0).origin_m[1] - 100.0 * line_s * 60.0).abs() < 1e-6);
        assert!(at(1, 0).clock_ps > at(0, 1000).clock_ps);
    }

    /// The flight's date is that of its GPS week, which is counted from 6 January 1980.
    #[test]
    fn week_and_date_agree() {
        let days_to_year: u32 = (1980..2025).map(|year| if year % 4 == 0 { 366 } else { 365 }).sum();
        let day_of_year = 7 * GPS_WEEK + 5 + (START_S / 86_400.0) as u32 - days_to_year + 1;
        assert_eq!((day_of_year as u16, 2025), RECORDED);
    }

    #[test]
    fn a_line_of_one_shot_has_its_first_angle() {
        assert_eq!(Scanner { shots_per_line: 1, ..scanner() }.shot(0, 0).scan_angle_rad, -0.5);
    }

    #[test]
    fn the_reference_system_is_well_formed() {
        let count = |c| CRS_WKT.matches(c).count();
        assert_eq!(count('['), count(']'));
        assert_eq!(count('"') % 2, 0);
        assert!(CRS_WKT.ends_with(r#"AUTHORITY["EPSG","32633"]]"#));
    }
}

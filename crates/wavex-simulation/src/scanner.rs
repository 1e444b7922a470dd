//! Emission time and direction of each pulse.

use core::f64::consts::TAU;

use super::random::{Purpose, Random};

/// GPS week of the flight, from 4 May 2025.
pub const GPS_WEEK: u32 = 2365;
/// Default start time of the flight, s of the GPS week: Tuesday 10:00.
pub const START_S: f64 = 2.0 * 86_400.0 + 36_000.0;
/// Start of the flight on the instrument's clock, ns.
const CLOCK_START_NS: i64 = 1_000_000_000_000;
/// Facets of the rotating mirror.
const FACETS: u32 = 4;

/// Scan mechanism.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ScanMechanism {
    /// A polygon of four facets. Each sweeps one line from left to right at constant speed; a pause
    /// of half a line without pulses follows.
    RotatingPolygon,
    /// A mirror that swings sinusoidally: lines alternate between right and left, and shots are
    /// densest at the turning points. No pauses.
    Oscillating,
    /// A row of fixed fibres, used one after the other: spots are evenly spaced on level ground,
    /// and the spots of each fibre form a line along the flight. No pauses.
    ParallelLines,
    /// A mirror whose beam rotates on a cone about nadir, clockwise seen from above. No pauses; a
    /// line is a fixed number of shots.
    Circular,
}

/// A laser with a mirror and their common clock.
///
/// The scanner's frame is x forward, y right, z down; the beam sweeps across the track through
/// nadir.
#[derive(Clone, Debug, PartialEq)]
pub struct Scanner {
    /// Scan mechanism.
    pub mirror: ScanMechanism,
    /// Shots per scan line.
    pub shots_per_line: u32,
    /// Pulse rate, Hz.
    pub pulse_rate_hz: f64,
    /// Range of the pulse interval modulation, ns: each pulse is up to half of this early or late.
    ///
    /// Less than half the interval.
    pub modulation_ns: f64,
    /// Seed of the modulation.
    pub seed: u64,
    /// Angles of the first and the last shot from nadir, rad, positive to the right.
    ///
    /// A circular scanner has half of their difference as its angle from the axis.
    pub scan_angle_rad: [f64; 2],
    /// Revolutions per second of a circular scanner.
    pub rotation_hz: f64,
}

/// An emitted pulse.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ScannerShot {
    /// Shot number, from 0.
    pub number: u64,
    /// Time from the start of the flight to the last tick of the sample clock before the emission,
    /// ns.
    pub since_start_ns: i64,
    /// Angle from nadir, rad, positive to the right.
    pub scan_angle_rad: f64,
    /// Unit vector along the beam.
    pub direction_in_scanner: [f64; 3],
    /// Mirror facet.
    pub facet: u16,
    /// Whether the beam moves to the right.
    pub to_the_right: bool,
}

impl ScannerShot {
    /// Tick on the instrument's clock, ps.
    pub fn clock_ps(&self) -> i64 {
        1000 * (CLOCK_START_NS + self.since_start_ns)
    }

    /// Tick relative to the start of the flight, s.
    pub fn since_start_s(&self) -> f64 {
        1e-9 * self.since_start_ns as f64
    }
}

impl Scanner {
    /// A shot by scan line and index in the line, both from 0.
    pub fn shot(&self, line: u32, index: u32) -> ScannerShot {
        if self.mirror == ScanMechanism::Circular {
            return self.circular_shot(line, index);
        }
        let to_the_right = self.mirror != ScanMechanism::Oscillating || line.is_multiple_of(2);
        let scan_angle_rad = self.angle_rad(to_the_right, index);
        ScannerShot {
            number: self.number(line, index),
            since_start_ns: self.tick_ns(line, index),
            scan_angle_rad,
            direction_in_scanner: [0.0, libm::sin(scan_angle_rad), libm::cos(scan_angle_rad)],
            facet: if self.mirror == ScanMechanism::RotatingPolygon { (line % FACETS) as u16 } else { 0 },
            to_the_right,
        }
    }

    fn circular_shot(&self, line: u32, index: u32) -> ScannerShot {
        let [first, last] = self.scan_angle_rad;
        let (sin, cos) = libm::sincos(TAU * (self.rotation_hz * self.time_s(line, index)).fract());
        let (away, down) = libm::sincos(0.5 * (last - first));
        ScannerShot {
            number: self.number(line, index),
            since_start_ns: self.tick_ns(line, index),
            scan_angle_rad: libm::atan2(away * sin, down),
            direction_in_scanner: [away * cos, away * sin, down],
            facet: 0,
            to_the_right: cos > 0.0,
        }
    }

    /// Number of a shot.
    pub fn number(&self, line: u32, index: u32) -> u64 {
        u64::from(line) * u64::from(self.shots_per_line) + u64::from(index)
    }

    /// Scan line and index of a shot by its number.
    pub fn place(&self, number: u64) -> (u32, u32) {
        let shots = u64::from(self.shots_per_line);
        ((number / shots) as u32, (number % shots) as u32)
    }

    /// Last tick of the sample clock before a shot's emission, ns from the start.
    pub fn tick_ns(&self, line: u32, index: u32) -> i64 {
        let nominal_ns = 1e9 * self.time_s(line, index);
        if self.modulation_ns == 0.0 {
            return nominal_ns.floor() as i64;
        }
        let place = Random::of_shot(self.seed, line, index, Purpose::Modulation).uniform() - 0.5;
        (nominal_ns + self.modulation_ns * place).floor() as i64
    }

    /// Pulses from the start of one line to the start of the next if the laser never paused.
    pub fn pulses_per_line(&self) -> f64 {
        let pause = if self.mirror == ScanMechanism::RotatingPolygon { 1.5 } else { 1.0 };
        pause * f64::from(self.shots_per_line)
    }

    /// Nominal time of a shot since the start, s.
    pub fn time_s(&self, line: u32, index: u32) -> f64 {
        (f64::from(line) * self.pulses_per_line() + f64::from(index)) / self.pulse_rate_hz
    }

    fn angle_rad(&self, to_the_right: bool, index: u32) -> f64 {
        let [first, last] = self.scan_angle_rad;
        let steps = f64::from(self.shots_per_line.saturating_sub(1).max(1));
        let place = f64::from(index) / steps;
        match self.mirror {
            ScanMechanism::RotatingPolygon => first + (last - first) * place,
            ScanMechanism::Oscillating => {
                // Half a step from the turning point, so that the two shots next to it do not
                // coincide.
                let phase = (f64::from(index) + 0.5) / f64::from(self.shots_per_line);
                let swing = 0.5 - 0.5 * libm::cos(core::f64::consts::PI * phase);
                first + (last - first) * if to_the_right { swing } else { 1.0 - swing }
            }
            // On a cone, the position across follows from the azimuth.
            ScanMechanism::ParallelLines | ScanMechanism::Circular => {
                let (left, right) = (libm::tan(first), libm::tan(last));
                libm::atan(left + (right - left) * place)
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scanner() -> Scanner {
        Scanner {
            mirror: ScanMechanism::RotatingPolygon,
            shots_per_line: 1001,
            pulse_rate_hz: 150_000.0,
            modulation_ns: 0.0,
            seed: 1,
            scan_angle_rad: [-0.5, 0.5],
            rotation_hz: 100.0,
        }
    }

    fn line(mirror: ScanMechanism, line: u32) -> Vec<ScannerShot> {
        let scanner = Scanner { mirror, ..scanner() };
        (0..1001).map(|index| scanner.shot(line, index)).collect()
    }

    #[test]
    fn a_polygon_sweeps_from_left_to_right() {
        let shots = line(ScanMechanism::RotatingPolygon, 3);
        assert_eq!((shots[0].scan_angle_rad, shots[1000].scan_angle_rad), (-0.5, 0.5));
        assert_eq!(shots[500].direction_in_scanner, [0.0, 0.0, 1.0]);
        assert_eq!(shots[0].number, 3003);
        assert_eq!(scanner().place(3003), (3, 0));
        assert!(shots.iter().all(|shot| shot.facet == 3 && shot.to_the_right));
        for shot in &shots {
            let length = shot.direction_in_scanner.iter().map(|d| d * d).sum::<f64>().sqrt();
            assert!((length - 1.0).abs() < 1e-15);
        }
    }

    #[test]
    fn an_oscillating_mirror_is_slowest_at_its_turning_points() {
        let (there, back) = (line(ScanMechanism::Oscillating, 0), line(ScanMechanism::Oscillating, 1));
        assert!(there.is_sorted_by(|a, b| a.scan_angle_rad < b.scan_angle_rad));
        assert!(back.is_sorted_by(|a, b| a.scan_angle_rad > b.scan_angle_rad));
        assert!(there[0].to_the_right && !back[0].to_the_right);
        assert_eq!(there[1000].scan_angle_rad, back[0].scan_angle_rad);
        let step = |k: usize| there[k + 1].scan_angle_rad - there[k].scan_angle_rad;
        assert!(step(0) < 0.01 * step(500));
        // The largest step of a cosine is pi / 2 times the mean step.
        assert!((step(500) * 1001.0 / core::f64::consts::FRAC_PI_2 - 1.0).abs() < 1e-3);
        assert_eq!(back[0].since_start_ns - there[1000].since_start_ns, 6667, "without a pause");
    }

    #[test]
    fn fibres_are_evenly_spaced_on_the_ground() {
        let shots = line(ScanMechanism::ParallelLines, 7);
        for pair in shots.windows(2) {
            let step = pair[1].scan_angle_rad.tan() - pair[0].scan_angle_rad.tan();
            assert!((step * 1000.0 / (2.0 * 0.5f64.tan()) - 1.0).abs() < 1e-9);
        }
        assert!((shots[0].scan_angle_rad + 0.5).abs() < 1e-15 && shots[0].facet == 0);
    }

    /// 150 kHz and 100 revolutions per second: 1500 shots per revolution, independent of the lines.
    #[test]
    fn a_circular_scanner_rotates_about_nadir() {
        let shots: Vec<ScannerShot> =
            (0..4).flat_map(|number| line(ScanMechanism::Circular, number)).collect();
        for (number, shot) in shots.iter().enumerate() {
            let [forward, right, down] = shot.direction_in_scanner;
            assert!(
                (down - 0.5f64.cos()).abs() < 1e-15 && (forward.hypot(right) - 0.5f64.sin()).abs() < 1e-15
            );
            let azimuth = TAU * number as f64 / 1500.0;
            assert!((forward - 0.5f64.sin() * azimuth.cos()).abs() < 1e-9, "{number}");
            assert!((right - 0.5f64.sin() * azimuth.sin()).abs() < 1e-9, "{number}");
            assert!((shot.scan_angle_rad.tan() * down - right).abs() < 1e-12);
            assert_eq!((shot.to_the_right, shot.facet, shot.number), (forward > 0.0, 0, number as u64));
        }
        assert!(
            (shots[1001].since_start_ns - shots[1000].since_start_ns - 6667).abs() <= 1,
            "without a pause"
        );
    }

    #[test]
    fn times_follow_the_pulse_rate_with_pauses_between_lines() {
        let at = |line, index| scanner().shot(line, index);
        // 6666.67 ns between pulses: the sample clock counts whole nanoseconds.
        assert_eq!(at(0, 1).clock_ps() - at(0, 0).clock_ps(), 6_666_000);
        assert_eq!(at(0, 3).clock_ps() - at(0, 0).clock_ps(), 20_000_000);
        let line_s = 1.5 * 1001.0 / 150_000.0;
        assert!((at(100, 0).since_start_s() - at(0, 0).since_start_s() - 100.0 * line_s).abs() < 2e-9);
        assert!(at(1, 0).clock_ps() > at(0, 1000).clock_ps());
    }

    /// Independent offsets give intervals with a triangular distribution, whose SD is the half
    /// range divided by the square root of six.
    #[test]
    fn the_modulation_bounds_the_interval_between_pulses() {
        let modulated = Scanner { modulation_ns: 17.0, pulse_rate_hz: 400_000.0, ..scanner() };
        let ticks: Vec<i64> = (0..40)
            .flat_map(|line| (0..1001).map(move |k| (line, k)))
            .map(|(l, k)| modulated.tick_ns(l, k))
            .collect();
        let off: Vec<f64> = ticks
            .chunks(1001)
            .flat_map(|line| line.windows(2).map(|pair| (pair[1] - pair[0]) as f64 - 2500.0))
            .collect();
        assert!(off.iter().all(|off| off.abs() <= 18.0));
        let sd = (off.iter().map(|off| off * off).sum::<f64>() / off.len() as f64).sqrt();
        assert!((sd / (17.0 / 6f64.sqrt()) - 1.0).abs() < 0.02, "{sd}");
    }

    #[test]
    fn a_line_of_one_shot_has_its_first_angle() {
        assert_eq!(Scanner { shots_per_line: 1, ..scanner() }.shot(0, 0).scan_angle_rad, -0.5);
    }
}

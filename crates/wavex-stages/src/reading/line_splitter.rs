//! Splits shots into scan lines for formats that do not mark line ends.

use std::f64::consts::PI;
use std::ops::Range;
use std::sync::Arc;

use wavex_geodesy::cone::{Cone, Turning};
use wavex_line::scan_line::{Blocks, Emission, InputInfo, MAX_SHOTS_PER_LINE, ScanLine, emission_flags};
use wavex_line::stage::LineLocation;

/// Collects shots into scan lines.
///
/// A line ends after a shot with the edge-of-flight-line flag, and before a shot whose scan
/// direction flag or facet differs or whose beam jumps against the sweep; otherwise after
/// [`MAX_SHOTS_PER_LINE`] shots or [`MOST_BYTES`]. Conical scanners have none of these marks:
/// unless the file itself ends lines, a line is one revolution, counted from the file's first beam.
/// A line also ends where time runs backwards, as between flights merged into one file: the shots
/// of a line are in time order.
pub(crate) struct LineSplitter {
    input: Arc<InputInfo>,
    next_line: u32,
    emissions: Vec<Emission>,
    blocks: Blocks,
    sweep: Sweep,
    turning: Turning,
    /// Angle turned by the beam in the current revolution, rad.
    turned_rad: f64,
    /// The last shot added.
    last: Option<Emission>,
    /// Whether the file itself has ended a line.
    has_ends: bool,
    /// Whether the last shot of a line gets the edge-of-flight-line flag.
    marks_edges: bool,
    /// Whether the current line is complete rather than only full.
    is_complete: bool,
    /// Records of the current line.
    records: Range<u64>,
    /// Location of the line taken last.
    location: Option<LineLocation>,
}

/// Mean beam movement from shot to shot.
#[derive(Default)]
struct Sweep {
    /// Running mean of the difference of consecutive directions.
    step: [f64; 3],
    shots: usize,
}

/// Size limit of a line, 16 kB per shot; only damaged files with invalid waveform sizes exceed it.
const MOST_BYTES: usize = 64 << 20;
/// A backward movement of more than this many mean steps begins a new sweep.
const JUMP_STEPS: f64 = 8.0;
/// Number of shots needed to know the mean step before jumps are detected.
const STEADY_SHOTS: usize = 8;

impl LineSplitter {
    pub(crate) fn new(input: Arc<InputInfo>) -> LineSplitter {
        LineSplitter {
            input,
            next_line: 0,
            emissions: Vec::new(),
            blocks: Blocks::default(),
            sweep: Sweep::default(),
            turning: Turning::default(),
            turned_rad: 0.0,
            last: None,
            has_ends: false,
            marks_edges: false,
            is_complete: false,
            records: 0..0,
            location: None,
        }
    }

    /// Location of the line taken last.
    pub(crate) fn location(&self) -> Option<LineLocation> {
        self.location.clone()
    }

    /// Begins the line at a location, in place of the current one.
    ///
    /// The caller adds its shots and takes it.
    pub(crate) fn begin_at(&mut self, location: &LineLocation) {
        self.emissions.clear();
        self.blocks = self.blocks.of_same_size();
        self.sweep = Sweep::default();
        (self.last, self.next_line, self.is_complete) = (None, location.line, location.is_complete);
    }

    /// Sets the edge-of-flight-line flag on the last shot of complete lines.
    ///
    /// For formats that lack the flag or often leave it unset.
    pub(crate) fn marking_edges(self) -> LineSplitter {
        LineSplitter { marks_edges: true, ..self }
    }

    /// Properties of the recording.
    pub(crate) fn input(&self) -> &InputInfo {
        &self.input
    }

    /// Whether a shot begins a new line; if so, [`LineSplitter::take`] the current one first.
    pub(crate) fn ends_before(&mut self, next: &Emission) -> bool {
        self.is_complete = false;
        let Some(last) = self.emissions.last() else { return false };
        self.is_complete = is_end(last, next)
            || last.clock_ps > next.clock_ps
            || self.sweep.jumps(last.direction, next.direction)
            || (!self.has_ends && self.ends_revolution(last, next));
        self.is_complete || self.emissions.len() >= MAX_SHOTS_PER_LINE || self.blocks.bytes() >= MOST_BYTES
    }

    /// Whether the beam passes the azimuth of the file's first beam with this shot.
    fn ends_revolution(&self, last: &Emission, next: &Emission) -> bool {
        self.turned_rad >= PI
            && self
                .turning
                .cone()
                .is_some_and(|cone| cone.azimuth_rad(last.direction) - cone.azimuth_rad(next.direction) > PI)
    }

    /// Ends the current line at an end-of-line record of the file.
    pub(crate) fn end(&mut self) -> Option<ScanLine> {
        self.has_ends = true;
        self.is_complete = true;
        self.take()
    }

    /// Adds the shot of a record; its blocks go to [`LineSplitter::blocks`] with the returned index.
    ///
    /// Records of the file are numbered from 0, in its order.
    pub(crate) fn add(&mut self, record: u64, emission: Emission) -> u32 {
        if self.emissions.is_empty() {
            self.records.start = record;
        }
        self.records.end = record + 1;
        if let Some(last) = self.emissions.last() {
            self.sweep.learn(last.direction, emission.direction);
        }
        self.turning.add(emission.direction);
        if let Some(last) = self.last.replace(emission) {
            self.has_ends |= is_end(&last, &emission);
            let turned = |cone: &Cone| cone.turned_rad(last.direction, emission.direction);
            self.turned_rad = match self.ends_revolution(&last, &emission) {
                true => 0.0,
                false => self.turned_rad + self.turning.cone().map_or(0.0, turned),
            };
        }
        self.emissions.push(emission);
        (self.emissions.len() - 1) as u32
    }

    /// The blocks of the current line.
    pub(crate) fn blocks(&mut self) -> &mut Blocks {
        &mut self.blocks
    }

    /// Takes the current line, if it has any shots.
    pub(crate) fn take(&mut self) -> Option<ScanLine> {
        if self.emissions.is_empty() {
            return None;
        }
        let is_complete = std::mem::take(&mut self.is_complete);
        if let Some(last) = self.emissions.last_mut().filter(|_| is_complete && self.marks_edges) {
            last.flags |= emission_flags::EDGE_OF_FLIGHT_LINE;
        }
        self.sweep = Sweep::default();
        let line = self.next_line;
        self.next_line += 1;
        let first_shot = self.emissions.first().map_or(0, |first| first.shot);
        let records = self.records.clone();
        self.location = Some(LineLocation { records, row: 0, line, first_shot, is_complete });
        // The next line is about as long.
        let next = (Vec::with_capacity(self.emissions.len()), self.blocks.of_same_size());
        let emissions = std::mem::replace(&mut self.emissions, next.0);
        let blocks = std::mem::replace(&mut self.blocks, next.1);
        Some(ScanLine::of_shots(Arc::clone(&self.input), line, emissions, blocks))
    }
}

/// Whether flags or facets of consecutive shots mark a line end.
fn is_end(last: &Emission, next: &Emission) -> bool {
    let flag = |emission: &Emission| emission.flags & emission_flags::SCAN_DIRECTION_POSITIVE;
    last.flags & emission_flags::EDGE_OF_FLIGHT_LINE != 0
        || flag(last) != flag(next)
        || last.facet != next.facet
}

impl Sweep {
    fn learn(&mut self, from: [f64; 3], to: [f64; 3]) {
        self.shots += 1;
        let weight = 1.0 / self.shots.min(32) as f64;
        for axis in 0..3 {
            self.step[axis] += weight * (to[axis] - from[axis] - self.step[axis]);
        }
    }

    fn jumps(&self, from: [f64; 3], to: [f64; 3]) -> bool {
        let step: [f64; 3] = std::array::from_fn(|axis| to[axis] - from[axis]);
        let along = dot(step, self.step);
        let usual = dot(self.step, self.step);
        self.shots >= STEADY_SHOTS && along < -JUMP_STEPS * usual
    }
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[cfg(test)]
mod tests {
    use super::*;
    use wavex_line::scan_line::Channel;

    fn shot(angle_deg: f64) -> Emission {
        let (sin, cos) = angle_deg.to_radians().sin_cos();
        Emission { direction: [sin, 0.0, -cos], ..Emission::default() }
    }

    /// Lengths of the lines made from these shots.
    fn lengths(shots: impl IntoIterator<Item = Emission>) -> Vec<usize> {
        let mut lines = LineSplitter::new(Arc::new(InputInfo::default()));
        let mut lengths = Vec::new();
        for shot in shots {
            if lines.ends_before(&shot) {
                lengths.extend(lines.take().map(|line| line.emissions.len()));
            }
            lines.add(0, shot);
        }
        lengths.extend(lines.take().map(|line| line.emissions.len()));
        lengths
    }

    #[test]
    fn a_beam_that_jumps_back_begins_a_line() {
        let angles =
            [0.0, 1.0, 2.0].map(|line| (0..100).map(move |i| -30.0 + 0.6 * f64::from(i) + line * 0.001));
        assert_eq!(lengths(angles.into_iter().flatten().map(shot)), [100, 100, 100]);
    }

    #[test]
    fn gaps_in_a_sweep_do_not_end_it() {
        let angles = (0..100).filter(|i| !(40..70).contains(i)).map(|i| shot(-30.0 + 0.6 * f64::from(i)));
        assert_eq!(lengths(angles), [70]);
    }

    #[test]
    fn flags_and_facets_end_lines() {
        use emission_flags::{EDGE_OF_FLIGHT_LINE, SCAN_DIRECTION_POSITIVE};
        let with = |flags, facet| Emission { flags, facet, ..shot(0.0) };
        let edge = [with(0, 0), with(EDGE_OF_FLIGHT_LINE, 0), with(0, 0)];
        assert_eq!(lengths(edge), [2, 1]);
        let turned = [with(0, 0), with(0, 0), with(0, 0), with(SCAN_DIRECTION_POSITIVE, 0)];
        assert_eq!(lengths(turned), [3, 1]);
        assert_eq!(lengths([with(0, 0), with(0, 1), with(0, 1)]), [1, 2]);
    }

    /// Shots on a cone of 20 degrees, `per_revolution` of them, from a scanner tilted by 3 degrees.
    fn on_cone(shots: std::ops::Range<u32>, per_revolution: f64) -> impl Iterator<Item = Emission> {
        let (sin_tilt, cos_tilt) = 3f64.to_radians().sin_cos();
        let (away, down) = 20f64.to_radians().sin_cos();
        shots.map(move |k| {
            let (sin, cos) = (std::f64::consts::TAU * f64::from(k) / per_revolution).sin_cos();
            let [x, y, z] = [away * cos, away * sin, -down];
            let direction = [x, cos_tilt * y - sin_tilt * z, sin_tilt * y + cos_tilt * z];
            Emission { direction, clock_ps: i64::from(k), ..Emission::default() }
        })
    }

    #[test]
    fn a_beam_on_a_cone_makes_a_line_of_each_revolution() {
        assert_eq!(lengths(on_cone(0..2600, 500.3)), [501, 500, 500, 501, 500, 98]);
        // From any start azimuth, and in parts if a revolution exceeds the line limit.
        assert_eq!(lengths(on_cone(77..15_000, 6874.6)), [4096, 2779, 4096, 2779, 1173]);
        // The gap spans the end of the revolution.
        let with_gap = on_cone(0..2000, 500.3).filter(|shot| !(450..520).contains(&shot.clock_ps));
        assert_eq!(lengths(with_gap), [450, 481, 500, 499]);
    }

    #[test]
    fn lines_that_the_file_ends_are_those_of_a_cone_too() {
        let to_the_right = |mut shot: Emission| {
            shot.flags = if shot.clock_ps % 500 < 250 { emission_flags::SCAN_DIRECTION_POSITIVE } else { 0 };
            shot
        };
        assert_eq!(lengths(on_cone(100..1100, 500.0).map(to_the_right)), [150, 250, 250, 250, 100]);
        // Lines ended by records that are not shots: two thirds of a revolution each.
        let mut lines = LineSplitter::new(Arc::new(InputInfo::default()));
        let mut lengths = Vec::new();
        for shot in on_cone(0..2000, 500.0) {
            let ends = lines.ends_before(&shot);
            let ended = if shot.clock_ps > 0 && shot.clock_ps % 333 == 0 { lines.end() } else { None };
            lengths
                .extend(ended.or_else(|| if ends { lines.take() } else { None }).map(|l| l.emissions.len()));
            lines.add(0, shot);
        }
        assert_eq!(lengths, [333; 6]);
    }

    #[test]
    fn the_last_shot_of_a_complete_line_is_an_edge() {
        let with = |facet| Emission { facet, ..shot(3.0) };
        let facets = [0, 0, 1, 1, 1, 2].map(with).into_iter().chain((0..4999).map(|_| with(2)));
        let edges = |mut lines: LineSplitter| {
            let (mut edges, mut n) = (Vec::new(), 0);
            let mut look = |line: Option<ScanLine>| {
                let emissions = line.map_or(Vec::new(), |line| line.emissions);
                let is_edge = |e: &Emission| e.flags & emission_flags::EDGE_OF_FLIGHT_LINE != 0;
                edges.extend(emissions.iter().enumerate().filter(|(_, e)| is_edge(e)).map(|(i, _)| n + i));
                n += emissions.len();
            };
            for shot in facets.clone() {
                if lines.ends_before(&shot) {
                    look(lines.take());
                }
                lines.add(0, shot);
            }
            look(lines.take());
            edges
        };
        let lines = || LineSplitter::new(Arc::new(InputInfo::default()));
        // Neither a full line nor the end of the file marks an edge.
        assert_eq!(edges(lines().marking_edges()), [1, 4]);
        assert_eq!(edges(lines()), Vec::<usize>::new());
    }

    #[test]
    fn time_does_not_run_backwards_in_a_line() {
        let at = |clock_ps| Emission { clock_ps, ..shot(0.0) };
        assert_eq!(lengths([at(5), at(5), at(7), at(6), at(8)]), [3, 2]);
    }

    #[test]
    fn no_line_is_longer_than_the_limit() {
        assert_eq!(lengths((0..5000).map(|_| shot(3.0))), [4096, 904]);
        let mut lines = LineSplitter::new(Arc::new(InputInfo::default()));
        let megabytes = vec![0; 10 << 20];
        for shot_is_last in [false, false, true] {
            let index = lines.add(0, shot(3.0));
            lines.blocks().push(index, Channel::LowPower, None, 0.0, 1.0, &megabytes);
            assert_eq!(lines.ends_before(&shot(3.0)), shot_is_last);
        }
    }
}

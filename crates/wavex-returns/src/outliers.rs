//! Isolated points, and waveforms that jump off their line (docs/explanation/outliers.md).
//!
//! A point is supported if enough others can be reached from it in steps of limited length. Wires
//! are chains, roofs and ground are surfaces; false returns reach at most each other.

/// Number of points before and after, in time order, that are searched first.
const NEAR_IN_TIME: usize = 6;
/// Largest number of other points that a search counts.
pub const MOST_OTHERS: usize = 8;

/// Position of a return.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LinePoint {
    /// Position, m, in any undistorted frame.
    pub position_m: [f64; 3],
    /// Index of its waveform; points of one waveform are consecutive.
    pub waveform: u32,
}

/// Points of a scan line in time order, with an index sorted along the line.
#[derive(Clone, Debug, Default)]
pub struct PointLine {
    points: Vec<LinePoint>,
    along: [f64; 3],
    /// Coordinate along the line, m, ascending, and index of the point.
    sorted: Vec<(f64, u32)>,
}

impl PointLine {
    /// Creates a line along a unit vector; searches are faster the closer its points follow it.
    pub fn new(points: Vec<LinePoint>, along: [f64; 3]) -> PointLine {
        let mut sorted: Vec<(f64, u32)> =
            points.iter().zip(0..).map(|(point, index)| (dot(point.position_m, along), index)).collect();
        sorted.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        PointLine { points, along, sorted }
    }

    /// Points in time order.
    pub fn points(&self) -> &[LinePoint] {
        &self.points
    }

    /// Allocated memory, bytes.
    pub fn bytes(&self) -> usize {
        self.points.capacity() * size_of::<LinePoint>() + self.sorted.capacity() * size_of::<(f64, u32)>()
    }

    /// Indices of the points within a distance of a position.
    fn around(&self, place_m: [f64; 3], distance_m: f64) -> impl Iterator<Item = u32> + '_ {
        let at = dot(place_m, self.along);
        let from = self.sorted.partition_point(|(along, _)| *along < at - distance_m);
        let near = self.sorted.iter().skip(from).take_while(move |(along, _)| *along <= at + distance_m);
        let within = move |index: &u32| {
            self.points
                .get(*index as usize)
                .is_some_and(|point| is_within(point.position_m, place_m, distance_m))
        };
        near.map(|(_, index)| *index).filter(within)
    }
}

/// Searches for supporting points.
#[derive(Clone, Debug, Default)]
pub struct SupportSearch {
    /// Points reached so far: line and index.
    reached: Vec<(usize, u32)>,
}

impl SupportSearch {
    /// Whether `others` points can be reached in steps of `step_m`.
    ///
    /// `others` is limited to [`MOST_OTHERS`]. False for a point that does not exist.
    pub fn is_supported(
        &mut self,
        lines: &[&PointLine],
        line: usize,
        point: usize,
        step_m: f64,
        others: usize,
    ) -> bool {
        let Some(own) = lines.get(line) else { return false };
        let Some(start) = own.points.get(point) else { return false };
        let others = others.min(MOST_OTHERS);
        if near_in_time(own, point, step_m, others) {
            return true;
        }
        self.reached.clear();
        self.reached.push((line, point as u32));
        let mut next = 0;
        let mut place_m = start.position_m;
        loop {
            // Nearest lines first: they most often contain the supporting points.
            for apart in 0..lines.len() {
                let (before, behind) = (line.checked_sub(apart), (apart > 0).then_some(line + apart));
                for at in [before, behind].into_iter().flatten() {
                    let Some(other) = lines.get(at) else { continue };
                    for index in other.around(place_m, step_m) {
                        if !self.reached.contains(&(at, index)) {
                            self.reached.push((at, index));
                            if self.reached.len() > others {
                                return true;
                            }
                        }
                    }
                }
            }
            next += 1;
            let reached =
                self.reached.get(next).and_then(|&(at, index)| lines.get(at)?.points.get(index as usize));
            match reached {
                Some(point) => place_m = point.position_m,
                None => return false,
            }
        }
    }
}

/// Whether enough points recorded just before and after are near.
fn near_in_time(line: &PointLine, point: usize, step_m: f64, others: usize) -> bool {
    let Some(place) = line.points.get(point) else { return false };
    let from = point.saturating_sub(NEAR_IN_TIME);
    let near = line.points.iter().enumerate().skip(from).take(point - from + NEAR_IN_TIME + 1);
    let within = |(index, other): &(usize, &LinePoint)| {
        *index != point && is_within(other.position_m, place.position_m, step_m)
    };
    near.filter(within).take(others).count() >= others
}

/// Side of the line on which a waveform lies.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Side {
    /// Below the line.
    Low,
    /// Above the line.
    Air,
}

/// Highest and lowest return of a waveform.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Extent {
    /// Position, m, and height, m, of the highest return.
    pub highest: ([f64; 3], f64),
    /// Position, m, and height, m, of the lowest return.
    pub lowest: ([f64; 3], f64),
}

/// Side on which a waveform jumps off its neighbours; `None` if it does not.
///
/// All its returns must be more than `max_height_m` above or below both neighbours, and the angle
/// to them below `min_angle_rad`.
pub fn jump(
    before: &Extent,
    wave: &Extent,
    behind: &Extent,
    max_height_m: f64,
    min_angle_rad: f64,
) -> Option<Side> {
    let is_sharp = |at: [f64; 3], a: [f64; 3], b: [f64; 3]| angle_rad(at, a, b) < min_angle_rad;
    let above = |other: &Extent| wave.lowest.1 - other.highest.1 > max_height_m;
    let below = |other: &Extent| other.lowest.1 - wave.highest.1 > max_height_m;
    if above(before) && above(behind) && is_sharp(wave.lowest.0, before.highest.0, behind.highest.0) {
        Some(Side::Air)
    } else if below(before) && below(behind) && is_sharp(wave.highest.0, before.lowest.0, behind.lowest.0) {
        Some(Side::Low)
    } else {
        None
    }
}

/// Angle at a position between two others, rad; 0 if one of them coincides with it.
fn angle_rad(at: [f64; 3], a: [f64; 3], b: [f64; 3]) -> f64 {
    let to = |place: [f64; 3]| -> [f64; 3] { std::array::from_fn(|axis| place[axis] - at[axis]) };
    let (a, b) = (to(a), to(b));
    let across = [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
    dot(across, across).sqrt().atan2(dot(a, b))
}

fn is_within(a: [f64; 3], b: [f64; 3], distance_m: f64) -> bool {
    let d: [f64; 3] = std::array::from_fn(|axis| a[axis] - b[axis]);
    dot(d, d) <= distance_m * distance_m
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A line at `y` with points (x, z).
    fn line(y: f64, points: &[(f64, f64)]) -> PointLine {
        let point = |(waveform, &(x, z)): (u32, &(f64, f64))| LinePoint { position_m: [x, y, z], waveform };
        PointLine::new((0..).zip(points).map(point).collect(), [1.0, 0.0, 0.0])
    }

    fn supported(lines: &[PointLine], of: (usize, usize), step_m: f64, others: usize) -> bool {
        let lines: Vec<&PointLine> = lines.iter().collect();
        SupportSearch::default().is_supported(&lines, of.0, of.1, step_m, others)
    }

    #[test]
    fn a_wire_across_the_lines_is_a_chain() {
        // One point per line, 3 m between lines, above ground 20 m below.
        let ground: Vec<(f64, f64)> = (0..60).map(|k| (f64::from(k), 0.0)).collect();
        let with_wire = |y: f64| line(y, &[&ground[..30], &[(29.5, 20.0)], &ground[30..]].concat());
        let lines: Vec<PointLine> = (0..5).map(|k| with_wire(3.0 * f64::from(k))).collect();
        assert!(supported(&lines, (2, 30), 4.0, 3));
        assert!(supported(&lines, (0, 30), 4.0, 3), "from its end");
        assert!(!supported(&lines[1..4], (1, 30), 4.0, 3), "only two others exist");
        assert!(!supported(&lines, (2, 30), 2.9, 1));
        assert!(supported(&lines, (2, 10), 1.0, 2), "the ground");
    }

    #[test]
    fn points_far_apart_in_time_are_found_as_well() {
        let scattered: Vec<(f64, f64)> = (0..100)
            .map(|k| if k % 20 == 0 { (0.1 * f64::from(k), 30.0) } else { (f64::from(k), 0.0) })
            .collect();
        let lines = [line(0.0, &scattered)];
        assert!(supported(&lines, (0, 40), 2.1, 4));
        assert!(!supported(&lines, (0, 40), 2.1, 5));
        assert!(
            !supported(&lines, (0, 100), 2.1, 0) && !supported(&lines, (1, 0), 2.1, 0),
            "the point does not exist"
        );
    }

    #[test]
    fn a_search_finds_what_looking_at_all_finds() {
        use wavex_signal::simulated::Random;
        let mut random = Random::new(11);
        let mut cloud = || -> PointLine {
            let place = |random: &mut Random| std::array::from_fn(|_| 20.0 * random.uniform());
            let points =
                (0..40).map(|waveform| LinePoint { position_m: place(&mut random), waveform }).collect();
            PointLine::new(points, [0.6, 0.8, 0.0])
        };
        let lines: Vec<PointLine> = (0..4).map(|_| cloud()).collect();
        let all: Vec<[f64; 3]> = lines.iter().flat_map(|line| line.points()).map(|p| p.position_m).collect();
        let count = |start: usize, step_m: f64| {
            let mut group = vec![start];
            let mut next = 0;
            while next < group.len() {
                let from = all[group[next]];
                let new: Vec<usize> = (0..all.len())
                    .filter(|i| is_within(all[*i], from, step_m) && !group.contains(i))
                    .collect();
                group.extend(new);
                next += 1;
            }
            group.len() - 1
        };
        for (start, others) in (0..160).flat_map(|start| [(start, 1), (start, 3), (start, 8)]) {
            let expected = count(start, 2.5) >= others;
            assert_eq!(
                supported(&lines, (start / 40, start % 40), 2.5, others),
                expected,
                "{start} {others}"
            );
        }
    }

    #[test]
    fn a_waveform_jumps_only_off_both_neighbours_and_sharply() {
        let wave = |x: f64, high: f64, low: f64| Extent {
            highest: ([x, 0.0, high], high),
            lowest: ([x, 0.0, low], low),
        };
        let of = |wave_: Extent, behind: Extent| {
            jump(&wave(0.0, 2.0, 0.0), &wave_, &behind, 50.0, 2f64.to_radians())
        };
        assert_eq!(of(wave(0.5, 80.0, 80.0), wave(1.0, 1.0, 0.0)), Some(Side::Air));
        assert_eq!(of(wave(0.5, -60.0, -60.0), wave(1.0, 1.0, 0.0)), Some(Side::Low));
        assert_eq!(
            of(wave(0.5, 80.0, 0.0), wave(1.0, 1.0, 0.0)),
            None,
            "one of its returns is on the ground"
        );
        assert_eq!(of(wave(0.5, 80.0, 80.0), wave(1.0, 81.0, 0.0)), None, "a neighbour is equally high");
        assert_eq!(of(wave(0.5, 51.9, 51.9), wave(1.0, 1.0, 0.0)), None, "not high enough");
        assert_eq!(of(wave(5.0, 80.0, 80.0), wave(10.0, 1.0, 0.0)), None, "not sharp");
        assert_eq!(of(wave(0.5, 80.0, 80.0), wave(1.0, -90.0, -90.0)), Some(Side::Air));
        let between = jump(&wave(0.0, -90.0, -90.0), &wave(0.5, 0.0, 0.0), &wave(1.0, 90.0, 90.0), 50.0, 1.0);
        assert_eq!(between, None, "one neighbour is above, one below");
    }
}

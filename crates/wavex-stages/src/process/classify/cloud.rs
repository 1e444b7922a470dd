//! The points of a line with what is known of their returns.

use std::sync::Arc;

use wavex_geodesy::crs::{Crs, units_of_wkt};
use wavex_geodesy::vertical::down_at;
use wavex_ground::point::CloudPoint;
use wavex_line::scan_line::{Emission, Frame, InputInfo, Return, ScanLine};

/// Makes clouds from lines with points in a map.
#[derive(Debug, Default)]
pub(super) struct CloudOfMap {
    /// Metadata of the last line, and the lengths of the units of its points, m; none if they are not in a map.
    units: Option<(Arc<InputInfo>, Option<[f64; 2]>)>,
}

impl CloudOfMap {
    /// Points of a line, in metres; `None` if they are not in a map.
    ///
    /// Withheld returns get coordinates that are not numbers: they are not classified.
    pub(super) fn of(&mut self, line: &ScanLine) -> Option<Vec<CloudPoint>> {
        let [map_m, height_m] = self.units_of(&line.input)?;
        let (returns, points) = (line.returns()?, line.points()?);
        let beams = MapBeams::of(line, returns, points);
        let unknown = Emission::default();
        let cloud = returns.iter().zip(points).map(|(r, point)| {
            let beam = beams.of_shot(line.emissions.get(r.emission as usize).unwrap_or(&unknown));
            let position_m = [map_m * point[0], map_m * point[1], height_m * point[2]];
            CloudPoint {
                beam,
                height_sd_m: (r.range_sd_m * f64::from(beam[2].abs())) as f32,
                return_number: r.return_number,
                n_returns: r.number_of_returns,
                ..CloudPoint::at(if r.withheld { [f64::NAN; 3] } else { position_m })
            }
        });
        Some(cloud.collect())
    }

    fn units_of(&mut self, input: &Arc<InputInfo>) -> Option<[f64; 2]> {
        match &self.units {
            Some((known, units)) if Arc::ptr_eq(known, input) => *units,
            _ => {
                let wkt = input.crs_wkt.as_deref();
                let is_map = wkt
                    .and_then(Crs::horizontal_of_wkt)
                    .is_none_or(|system| !system.is_geodetic() && !system.is_ecef());
                let units =
                    (input.frame.is_georeferenced() && is_map).then(|| wkt.map_or([1.0; 2], units_of_wkt));
                self.units = Some((Arc::clone(input), units));
                units
            }
        }
    }
}

/// Directions of beams on the axes of the map.
struct MapBeams {
    frame: Frame,
    /// East, north and up at the sensor, in the earth's frame.
    axes: [[f64; 3]; 3],
    /// Cosine and sine of the angle from true north to the north of the map.
    convergence: [f64; 2],
}

impl MapBeams {
    /// In the earth's frame, the two outermost returns give the convergence of the meridians.
    fn of(line: &ScanLine, returns: &[Return], points: &[[f64; 3]]) -> MapBeams {
        let frame = line.input.frame;
        let down = line.emissions.first().and_then(|first| down_at(frame, first.origin_m));
        let axes = level_axes(down.unwrap_or([0.0, 0.0, -1.0]));
        let mut beams = MapBeams { frame, axes, convergence: [1.0, 0.0] };
        let place = |r: &Return| {
            let emission = line.emissions.get(r.emission as usize)?;
            Some([0, 1, 2].map(|axis| emission.origin_m[axis] + emission.direction[axis] * r.range_m))
        };
        let ends = returns.first().and_then(place).zip(returns.last().and_then(place));
        if let (Frame::Earth, Some((from, to)), [first, .., last]) = (frame, ends, points) {
            let [east, north, _] = beams.level([0, 1, 2].map(|axis| to[axis] - from[axis]));
            let (x, y) = (last[0] - first[0], last[1] - first[1]);
            let (dot, cross) = (east * x + north * y, east * y - north * x);
            let length = (dot * dot + cross * cross).sqrt();
            if length > 0.0 && length.is_finite() {
                beams.convergence = [dot / length, cross / length];
            }
        }
        beams
    }

    /// East, north and up of a vector.
    fn level(&self, vector: [f64; 3]) -> [f64; 3] {
        self.axes.map(|axis| axis.iter().zip(vector).map(|(a, b)| a * b).sum())
    }

    /// Unit vector from the sensor to the points of a shot.
    fn of_shot(&self, emission: &Emission) -> [f32; 3] {
        let [east, north, up] = match self.frame {
            Frame::Map => emission.direction,
            _ => self.level(emission.direction),
        };
        let [cosine, sine] = self.convergence;
        [cosine * east - sine * north, sine * east + cosine * north, up].map(|part| part as f32)
    }
}

/// East, north and up as vectors of a frame in which `down` points to the ground.
pub(in crate::process) fn level_axes(down: [f64; 3]) -> [[f64; 3]; 3] {
    let up = down.map(|part| -part);
    let level = (up[0] * up[0] + up[1] * up[1]).sqrt();
    // Any direction is east at a pole.
    let east = if level > 0.0 { [-up[1] / level, up[0] / level, 0.0] } else { [1.0, 0.0, 0.0] };
    let north = [
        up[1] * east[2] - up[2] * east[1],
        up[2] * east[0] - up[0] * east[2],
        up[0] * east[1] - up[1] * east[0],
    ];
    [east, north, up]
}

//! Distances of points from the planes through their neighbours.

use std::path::Path;

use wavex_formats::pulsewaves::Reader;

use wavex_testkit::recordings::{Table, median};

/// Neighbours used to fit a plane.
const NEIGHBOURS: usize = 12;
/// Side of the cells for sorting points, m: a few times the point spacing.
const CELL_M: f64 = 3.0;

type Point = [f64; 3];

/// A pulse's anchor and its displacement per sampling unit, as stored in a file.
pub struct Beam {
    anchor: Point,
    step: Point,
}

/// Beams by pulse of a PulseWaves file with a sampling unit of one nanosecond.
pub fn stored_beams(path: &Path) -> Vec<Beam> {
    let mut reader = Reader::open(path).unwrap();
    (0..reader.pulse_count())
        .map(|i| reader.pulse(i).unwrap())
        .map(|pulse| Beam { anchor: pulse.anchor, step: pulse.step })
        .collect()
}

/// Robust residuals of single returns from the planes through their twelve neighbours, mm.
pub struct Residuals {
    pub all_mm: f64,
    /// The half and the tenth of the points whose neighbours fit a plane best.
    pub half_mm: f64,
    pub tenth_mm: f64,
    /// All points, with the beam lengths stored in the file.
    pub stored_mm: f64,
}

impl Residuals {
    pub fn of(returns: &Table, beams: &[Beam]) -> Residuals {
        let column = |name: &str| returns.column(name);
        let (shot, number, time) = (column("shot"), column("number_of_returns"), column("time_of_flight_ns"));
        let [x, y, z] = ["x", "y", "z"].map(column);
        let singles = || (0..returns.len()).filter(|&i| number[i] == 1.0);
        let points: Vec<Point> = singles().map(|i| [x[i], y[i], z[i]]).collect();
        let stored: Vec<Point> = singles()
            .map(|i| (&beams[shot[i] as usize], time[i]))
            .map(|(beam, t)| std::array::from_fn(|axis| beam.anchor[axis] + t * beam.step[axis]))
            .collect();
        let mut found = residuals(&points);
        found.sort_by(|a, b| a.1.total_cmp(&b.1));
        let robust_mm = |part: &[(f64, f64)]| {
            let distances: Vec<f64> = part.iter().map(|(distance, _)| distance.abs()).collect();
            1482.6 * median(&distances)
        };
        Residuals {
            all_mm: robust_mm(&found),
            half_mm: robust_mm(&found[..found.len() / 2]),
            tenth_mm: robust_mm(&found[..found.len() / 10]),
            stored_mm: robust_mm(&residuals(&stored)),
        }
    }
}

/// Distance of each point from the plane of its neighbours, and their RMS distance from it, m.
fn residuals(points: &[Point]) -> Vec<(f64, f64)> {
    let cell = |p: &Point| p.map(|x| (x / CELL_M).floor() as i64);
    let mut cells: std::collections::HashMap<[i64; 3], Vec<usize>> = std::collections::HashMap::new();
    points.iter().enumerate().for_each(|(i, p)| cells.entry(cell(p)).or_default().push(i));
    let mut found = Vec::new();
    for (i, p) in points.iter().enumerate() {
        let home = cell(p);
        let around = (0..27).map(|k| [home[0] + k % 3 - 1, home[1] + k / 3 % 3 - 1, home[2] + k / 9 - 1]);
        let mut near: Vec<(f64, Point)> = around
            .filter_map(|cell| cells.get(&cell))
            .flatten()
            .filter(|&&j| j != i)
            .map(|&j| std::array::from_fn(|axis| points[j][axis] - p[axis]))
            .map(|d: Point| (dot(d, d), d))
            .collect();
        near.sort_by(|a, b| a.0.total_cmp(&b.0));
        if near.len() >= NEIGHBOURS {
            found.push(plane(&near[..NEIGHBOURS].iter().map(|n| n.1).collect::<Vec<_>>()));
        }
    }
    found
}

/// Distance of the origin from the best-fit plane of points, and their RMS distance from it.
fn plane(points: &[Point]) -> (f64, f64) {
    let n = points.len() as f64;
    let mean: Point = std::array::from_fn(|axis| points.iter().map(|p| p[axis]).sum::<f64>() / n);
    let moment = nalgebra::Matrix3::from_fn(|i, j| {
        points.iter().map(|p| (p[i] - mean[i]) * (p[j] - mean[j])).sum::<f64>() / n
    });
    let eigen = moment.symmetric_eigen();
    let least = eigen.eigenvalues.imin();
    let normal = eigen.eigenvectors.column(least);
    let distance = (0..3).map(|axis| normal[axis] * mean[axis]).sum::<f64>();
    (distance, eigen.eigenvalues[least].max(0.0).sqrt())
}

fn dot(a: Point, b: Point) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

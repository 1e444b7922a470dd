//! Our returns beside the vendor's: pairs, what is missed, what is extra.

use super::recordings::{Table, median, robust};

/// Returns farther apart than this are not the same, ns.
const PAIR_NS: f64 = 3.0;

/// One return, the vendor's or ours.
#[derive(Clone, Copy, Debug)]
pub struct Echo {
    pub time_ns: f64,
    /// Where it stands: `[x, y, z]`.
    pub place_m: [f64; 3],
    pub amplitude_dn: f64,
    pub amplitude_db: f64,
    pub fwhm_ns: f64,
    pub sd_ns: f64,
    pub deviation_ratio: f64,
}

/// The returns of one pulse.
#[derive(Default, Clone)]
pub struct Pulse {
    pub vendor: Vec<Echo>,
    pub ours: Vec<Echo>,
    /// Indices of the vendor's and of ours.
    pub pairs: Vec<(usize, usize)>,
}

impl Pulse {
    /// The nearest two first, as long as any are near enough; each return once.
    fn pair(&mut self) {
        let mut all = Vec::new();
        for (i, theirs) in self.vendor.iter().enumerate() {
            for (j, ours) in self.ours.iter().enumerate() {
                all.push(((theirs.time_ns - ours.time_ns).abs(), i, j));
            }
        }
        all.sort_by(|a, b| a.0.total_cmp(&b.0));
        for (distance, i, j) in all {
            let free = self.pairs.iter().all(|pair| pair.0 != i && pair.1 != j);
            if distance <= PAIR_NS && free {
                self.pairs.push((i, j));
            }
        }
    }

    /// The vendor's returns that have no partner.
    pub fn missed(&self) -> impl Iterator<Item = &Echo> {
        let paired = |i: &usize| self.pairs.iter().all(|pair| pair.0 != *i);
        (0..self.vendor.len()).filter(paired).map(|i| &self.vendor[i])
    }

    /// Ours that have no partner.
    pub fn extra(&self) -> impl Iterator<Item = &Echo> {
        let paired = |j: &usize| self.pairs.iter().all(|pair| pair.1 != *j);
        (0..self.ours.len()).filter(paired).map(|j| &self.ours[j])
    }

    /// The pairs; `index` is the pulse's.
    pub fn told(&self, index: usize) -> impl Iterator<Item = Told> {
        self.pairs.iter().map(move |&(i, j)| Told {
            pulse: index,
            vendor: self.vendor[i],
            ours: self.ours[j],
            vendor_separation_ns: separation_ns(&self.vendor, i),
            our_separation_ns: separation_ns(&self.ours, j),
            single: self.vendor.len() == 1 && self.ours.len() == 1,
        })
    }
}

/// A return that both tell.
pub struct Told {
    pub pulse: usize,
    pub vendor: Echo,
    pub ours: Echo,
    /// Distances to the nearest other return that the same one tells of the pulse, ns.
    pub vendor_separation_ns: f64,
    pub our_separation_ns: f64,
    /// Whether both tell one return.
    pub single: bool,
}

impl Told {
    /// Whether the vendor tells others of the pulse.
    pub fn is_multi(&self) -> bool {
        !self.single && self.vendor_separation_ns.is_finite()
    }

    /// Whether these, and ours, are more than 12 ns away: where another of ours is near, the vendor's return stands between
    /// the two.
    pub fn is_far(&self) -> bool {
        self.is_multi() && self.vendor_separation_ns.min(self.our_separation_ns) > 12.0
    }
}

fn separation_ns(echoes: &[Echo], i: usize) -> f64 {
    let others = echoes.iter().enumerate().filter(|(k, _)| *k != i);
    others.map(|(_, other)| (other.time_ns - echoes[i].time_ns).abs()).fold(f64::INFINITY, f64::min)
}

/// All pulses of a recording.
pub fn pulses(vendor: &Table, ours: &Table) -> Vec<Pulse> {
    let count = vendor.column("pulse_index").into_iter().fold(0.0, f64::max) as usize + 1;
    let mut pulses = vec![Pulse::default(); count];
    let column = |name: &str| vendor.column(name);
    let (time, db, fwhm) = (column("range_units_from_anchor"), column("amplitude_db"), column("fwhm_ns"));
    let axes = ["x", "y", "z"].map(column);
    for (i, pulse) in column("pulse_index").into_iter().enumerate() {
        pulses[pulse as usize].vendor.push(Echo {
            time_ns: time[i],
            place_m: [axes[0][i], axes[1][i], axes[2][i]],
            amplitude_dn: f64::NAN,
            amplitude_db: db[i],
            fwhm_ns: fwhm[i],
            sd_ns: f64::NAN,
            deviation_ratio: f64::NAN,
        });
    }
    let column = |name: &str| ours.column(name);
    let (time, dn, db) = (column("time_of_flight_ns"), column("amplitude_dn"), column("amplitude_db"));
    let (fwhm, sd) = (column("fwhm_ns"), column("time_of_flight_sd_ns"));
    let deviation = column("deviation_ratio");
    let axes = ["x", "y", "z"].map(column);
    for (i, pulse) in column("shot").into_iter().enumerate() {
        if let Some(pulse) = pulses.get_mut(pulse as usize) {
            pulse.ours.push(Echo {
                time_ns: time[i],
                place_m: [axes[0][i], axes[1][i], axes[2][i]],
                amplitude_dn: dn[i],
                amplitude_db: db[i],
                fwhm_ns: fwhm[i],
                sd_ns: sd[i],
                deviation_ratio: deviation[i],
            });
        }
    }
    pulses.iter_mut().for_each(Pulse::pair);
    pulses
}

/// What a walk that follows the amplitude leaves of differences: a cubic in the amplitude's logarithm, as tables of the receivers
/// are given in dB, weighted by the standard deviations. Each tenth of the pulses by the walk that the others tell.
pub fn without_trend(pairs: &[Told], differences: &[f64]) -> Vec<f64> {
    let points: Vec<Point> = pairs
        .iter()
        .zip(differences)
        .map(|(pair, &y)| Point {
            powers: powers(pair.ours.amplitude_dn),
            y,
            weight: pair.ours.sd_ns.recip(),
        })
        .collect();
    let mut left = vec![f64::NAN; points.len()];
    for tenth in 0..10 {
        let of_tenth = |i: &usize| pairs[*i].pulse % 10 == tenth;
        let coefficients = cubic((0..points.len()).filter(|i| !of_tenth(i)).map(|i| points[i]).collect());
        for i in (0..points.len()).filter(of_tenth) {
            left[i] = points[i].rest(coefficients);
        }
    }
    left
}

#[derive(Clone, Copy)]
struct Point {
    powers: [f64; 4],
    y: f64,
    weight: f64,
}

impl Point {
    fn rest(&self, coefficients: [f64; 4]) -> f64 {
        self.y - self.powers.iter().zip(coefficients).map(|(p, c)| p * c).sum::<f64>()
    }
}

fn powers(amplitude_dn: f64) -> [f64; 4] {
    let t = (amplitude_dn / 100.0).ln();
    [1.0, t, t * t, t * t * t]
}

/// A cubic by weighted least squares, twice without what lies far off.
fn cubic(mut points: Vec<Point>) -> [f64; 4] {
    let mut coefficients = [0.0; 4];
    for _ in 0..3 {
        let mut matrix = [[0.0; 5]; 4];
        for Point { powers, y, weight } in &points {
            let weight = weight * weight;
            for i in 0..4 {
                (0..4).for_each(|j| matrix[i][j] += weight * powers[i] * powers[j]);
                matrix[i][4] += weight * powers[i] * y;
            }
        }
        coefficients = solve(matrix);
        let score = |point: &Point| point.weight * point.rest(coefficients);
        let (centre, sd) = robust(&points.iter().map(score).collect::<Vec<_>>());
        points.retain(|point| (score(point) - centre).abs() < 3.5 * sd);
    }
    coefficients
}

/// Gauss's elimination of four equations.
fn solve(mut m: [[f64; 5]; 4]) -> [f64; 4] {
    for i in 0..4 {
        let pivot = m[i];
        for (_, row) in m.iter_mut().enumerate().filter(|(j, _)| *j != i) {
            let factor = row[i] / pivot[i];
            (0..5).for_each(|k| row[k] -= factor * pivot[k]);
        }
    }
    [0, 1, 2, 3].map(|i| m[i][4] / m[i][i])
}

/// Part of the values that `test` holds for.
pub fn share(values: &[f64], test: impl Fn(f64) -> bool) -> f64 {
    values.iter().filter(|value| test(**value)).count() as f64 / values.len().max(1) as f64
}

/// Robust standard deviation about the median.
pub fn spread(values: &[f64]) -> f64 {
    let centre = median(values);
    1.4826 * median(&values.iter().map(|value| (value - centre).abs()).collect::<Vec<_>>())
}

/// How far the returns that are ours alone stand from the vendor's nearest return of *another* pulse; and how far a place as
/// far on the other side of their pulse's strongest return does, m.
pub fn extras_beside_other_pulses(pulses: &[Pulse]) -> Vec<[f64; 2]> {
    let nearest_m = |of: usize, place: [f64; 3]| {
        let others = pulses.iter().enumerate().filter(|(i, _)| *i != of).flat_map(|(_, pulse)| &pulse.vendor);
        others.map(|echo| distance_m(place, echo.place_m)).fold(f64::INFINITY, f64::min)
    };
    let mut distances = Vec::new();
    for (i, pulse) in pulses.iter().enumerate() {
        let Some(strongest) = pulse.ours.iter().max_by(|a, b| a.amplitude_dn.total_cmp(&b.amplitude_dn))
        else {
            continue;
        };
        for extra in pulse.extra() {
            let mirrored = [0, 1, 2].map(|axis| 2.0 * strongest.place_m[axis] - extra.place_m[axis]);
            distances.push([extra.place_m, mirrored].map(|place| nearest_m(i, place)));
        }
    }
    distances
}

fn distance_m(a: [f64; 3], b: [f64; 3]) -> f64 {
    (0..3).map(|axis| (a[axis] - b[axis]).powi(2)).sum::<f64>().sqrt()
}

//! Comparison of our returns with the vendor's: pairs, missed and extra returns.

use wavex_testkit::recordings::{Table, median, robust};

/// Maximum time difference of a pair, ns.
const PAIR_NS: f64 = 3.0;

/// A return, the vendor's or ours.
#[derive(Clone, Copy, Debug)]
pub struct Echo {
    pub time_ns: f64,
    /// Position `[x, y, z]`.
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
    /// Pairs of indices: vendor's and ours.
    pub pairs: Vec<(usize, usize)>,
}

impl Pulse {
    /// Pairs returns, nearest first, while any are near enough; each return once.
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

    /// The vendor's returns without a partner.
    pub fn missed(&self) -> impl Iterator<Item = &Echo> {
        let paired = |i: &usize| self.pairs.iter().all(|pair| pair.0 != *i);
        (0..self.vendor.len()).filter(paired).map(|i| &self.vendor[i])
    }

    /// Our returns without a partner.
    pub fn extra(&self) -> impl Iterator<Item = &Echo> {
        let paired = |j: &usize| self.pairs.iter().all(|pair| pair.1 != *j);
        (0..self.ours.len()).filter(paired).map(|j| &self.ours[j])
    }

    /// Our strongest return.
    pub fn strongest(&self) -> Option<&Echo> {
        self.ours.iter().max_by(|a, b| a.amplitude_dn.total_cmp(&b.amplitude_dn))
    }

    /// The pairs; `index` is that of the pulse.
    pub fn reported(&self, index: usize) -> impl Iterator<Item = VendorReturn> {
        self.pairs.iter().map(move |&(i, j)| VendorReturn {
            pulse: index,
            vendor: self.vendor[i],
            ours: self.ours[j],
            vendor_separation_ns: separation_ns(&self.vendor, i),
            our_separation_ns: separation_ns(&self.ours, j),
            single: self.vendor.len() == 1 && self.ours.len() == 1,
        })
    }
}

/// A return that both report.
pub struct VendorReturn {
    pub pulse: usize,
    pub vendor: Echo,
    pub ours: Echo,
    /// Distance to the nearest other return of the same pulse by the same source, ns.
    pub vendor_separation_ns: f64,
    pub our_separation_ns: f64,
    /// Whether both report one return only.
    pub single: bool,
}

impl VendorReturn {
    /// Returns whether the vendor reports other returns of the pulse.
    pub fn is_multi(&self) -> bool {
        !self.single && self.vendor_separation_ns.is_finite()
    }

    /// Returns whether all other returns are more than 12 ns away.
    ///
    /// Where another return of ours is near, the vendor's return lies between the two.
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

/// Removes an amplitude-dependent trend from differences.
///
/// The trend is a cubic in the logarithm of the amplitude (receiver tables are in dB), weighted by
/// the standard deviations. Each tenth of the pulses is corrected with the trend of the others;
/// `tenth_of` gives the tenth of a pulse.
pub fn without_trend(
    pairs: &[VendorReturn],
    differences: &[f64],
    tenth_of: impl Fn(usize) -> usize,
) -> Vec<f64> {
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
        let of_tenth = |i: &usize| tenth_of(pairs[*i].pulse) == tenth;
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

/// Fits a cubic by weighted least squares, with two passes of outlier removal.
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

/// Gaussian elimination for four equations.
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

/// Fraction of the values that satisfy `test`.
pub fn share(values: &[f64], test: impl Fn(f64) -> bool) -> f64 {
    values.iter().filter(|value| test(**value)).count() as f64 / values.len().max(1) as f64
}

/// Robust standard deviation about the median.
pub fn spread(values: &[f64]) -> f64 {
    let centre = median(values);
    1.4826 * median(&values.iter().map(|value| (value - centre).abs()).collect::<Vec<_>>())
}

/// A return that only we report.
pub struct Extra {
    pub pulse: usize,
    pub place_m: [f64; 3],
    /// Offset from the strongest return of its pulse.
    pub offset_m: [f64; 3],
}

/// The returns that only we report.
pub fn extras(pulses: &[Pulse]) -> Vec<Extra> {
    let of_pulse = |(index, pulse): (usize, &Pulse)| {
        let strongest_m = pulse.strongest().map(|echo| echo.place_m)?;
        let extra = |echo: &Echo| Extra {
            pulse: index,
            place_m: echo.place_m,
            offset_m: [0, 1, 2].map(|axis| echo.place_m[axis] - strongest_m[axis]),
        };
        Some(pulse.extra().map(extra).collect::<Vec<_>>())
    };
    pulses.iter().enumerate().filter_map(of_pulse).flatten().collect()
}

/// Distance from a position to the vendor's nearest return of *another* pulse, m.
pub fn to_another_pulse_m(pulses: &[Pulse], pulse: usize, place_m: [f64; 3]) -> f64 {
    let others = pulses.iter().enumerate().filter(|(index, _)| *index != pulse);
    others
        .flat_map(|(_, pulse)| &pulse.vendor)
        .map(|echo| length_m(difference_m(echo.place_m, place_m)))
        .fold(f64::INFINITY, f64::min)
}

/// Fraction of positions within `near_m` of the vendor's return of another pulse by chance.
///
/// The offsets from the strongest return are those of `extras`, applied to randomly chosen pulses.
pub fn near_by_chance(pulses: &[Pulse], extras: &[Extra], near_m: f64) -> f64 {
    let (mut near, mut all) = (0, 0);
    for (index, strongest) in pulses.iter().enumerate().filter_map(|(i, pulse)| Some((i, pulse.strongest()?)))
    {
        for extra in extras.iter().filter(|extra| extra.pulse != index) {
            let place_m = [0, 1, 2].map(|axis| strongest.place_m[axis] + extra.offset_m[axis]);
            near += usize::from(to_another_pulse_m(pulses, index, place_m) <= near_m);
            all += 1;
        }
    }
    near as f64 / f64::from(all.max(1))
}

/// Random positions: each extra return's offset applied to the strongest return of a random pulse.
pub fn placed_by_chance(pulses: &[Pulse], extras: &[Extra], seed: usize) -> Vec<[f64; 3]> {
    let strongest: Vec<[f64; 3]> =
        pulses.iter().filter_map(|pulse| Some(pulse.strongest()?.place_m)).collect();
    let mut random = seed + 1;
    let place = |extra: &Extra| {
        random = scattered(random);
        let by_m = strongest[random % strongest.len()];
        [0, 1, 2].map(|axis| by_m[axis] + extra.offset_m[axis])
    };
    extras.iter().map(place).collect()
}

/// Pseudo-random number from another (finaliser of SplitMix64, Steele, Lea and Flood).
pub fn scattered(number: usize) -> usize {
    let mut z = (number as u64).wrapping_add(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    ((z ^ (z >> 31)) >> 1) as usize
}

/// Indices of the largest set of positions within `near_m` of a line through two of them at least 3
/// m apart.
pub fn on_a_line(places_m: &[[f64; 3]], near_m: f64) -> Vec<usize> {
    let mut most = Vec::new();
    for (i, from_m) in places_m.iter().enumerate() {
        for along_m in places_m[..i].iter().map(|to_m| difference_m(*to_m, *from_m)) {
            let length = length_m(along_m);
            let distance_m = |place_m: [f64; 3]| {
                let offset_m = difference_m(place_m, *from_m);
                let along = (0..3).map(|axis| offset_m[axis] * along_m[axis]).sum::<f64>() / length;
                (length_m(offset_m).powi(2) - along * along).max(0.0).sqrt()
            };
            let on: Vec<usize> = (0..places_m.len()).filter(|k| distance_m(places_m[*k]) <= near_m).collect();
            if length >= 3.0 && on.len() > most.len() {
                most = on;
            }
        }
    }
    most
}

fn difference_m(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [0, 1, 2].map(|axis| a[axis] - b[axis])
}

fn length_m(v: [f64; 3]) -> f64 {
    v.iter().map(|x| x * x).sum::<f64>().sqrt()
}

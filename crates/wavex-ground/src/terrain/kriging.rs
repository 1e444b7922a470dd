//! Prediction of a height from neighbouring points, with its variance.
//!
//! Kriging of an intrinsic random field of order 1 (Matheron 1973; Chilès and Delfiner, "Geostatistics", 2nd ed.,
//! section 4.5): the drift is linear and estimated from the neighbours, and a generalised covariance
//! `a² g(h)` without range describes the terrain around it, so that the variance grows with the distance
//! from the points as far as the data say. Points have independent noise of variance `n² d`, and the
//! points of a strip share an error of variance `s²`.

use super::neighbours::relative_spread;

/// Generalised covariance of the terrain by distance `h` in m, for variances of 1 m².
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Smoothness {
    /// `-h`: Brownian terrain.
    Linear,
    /// `-h^1.5`.
    ThreeHalves,
    /// `h² ln h`: thin plates.
    ThinPlate,
    /// `h^2.5`.
    FiveHalves,
    /// `h³`: smooth terrain.
    Cubic,
}

impl Smoothness {
    /// All, from rough to smooth.
    pub const ALL: [Smoothness; 5] = [
        Smoothness::Linear,
        Smoothness::ThreeHalves,
        Smoothness::ThinPlate,
        Smoothness::FiveHalves,
        Smoothness::Cubic,
    ];

    fn at(self, distance_squared: f64) -> f64 {
        let h = distance_squared.sqrt();
        match self {
            Smoothness::Linear => -h,
            Smoothness::ThreeHalves => -h * h.sqrt(),
            Smoothness::ThinPlate if h > 0.0 => distance_squared * libm::log(h),
            Smoothness::ThinPlate => 0.0,
            Smoothness::FiveHalves => distance_squared * h.sqrt(),
            Smoothness::Cubic => distance_squared * h,
        }
    }
}

/// A point seen from the target.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Datum {
    /// Offset from the target, m.
    pub(crate) offset_m: [f64; 2],
    /// Height above any level near it, m.
    pub(crate) height_m: f64,
    /// Variance of its noise in units of `n²`.
    pub(crate) noise: f64,
    pub(crate) strip: u16,
}

/// Standard deviations of the parts of a height.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Parts {
    /// Variance of the terrain's generalised covariance, m².
    pub(crate) terrain: f64,
    /// Variance of the points' noise, m².
    pub(crate) noise: f64,
    /// Variance shared by the points of a strip, m².
    pub(crate) strip: f64,
}

/// A predicted height with the parts of its variance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Prediction {
    pub(crate) height_m: f64,
    pub(crate) variance: Parts,
}

/// Most columns of a drift: a plane, and offsets of three more strips.
const MOST_DRIFT: usize = 6;
/// Spread across the main direction of the points, relative to their extent, below which a plane is not estimated.
const LEAST_SPREAD: f64 = 0.05;
/// Errors of a point from its neighbours, in SDs, from which it is left out: above (vegetation) and below.
const OUTLIER: [f64; 2] = [3.0, 4.5];
/// Noise of a point that is left out, in units of its own.
const LEFT_OUT: f64 = 1e4;
/// Share of the points that may be left out.
const MOST_OUTLIERS: f64 = 0.2;

/// What is estimated from the data.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Target {
    /// Height at the origin.
    Height,
    /// Height of the second strip above the first.
    StripDifference,
}

/// Work space of predictions.
#[derive(Debug, Default)]
pub(crate) struct Kriging {
    n: usize,
    p: usize,
    /// Rows of the drift, `n` by `MOST_DRIFT`.
    drift: Vec<[f64; MOST_DRIFT]>,
    /// Generalised covariances of the points, and with the target.
    g: Vec<f64>,
    g0: Vec<f64>,
    reflectors: Vec<Vec<f64>>,
    r: [[f64; MOST_DRIFT]; MOST_DRIFT],
    a: Vec<f64>,
    work: Vec<f64>,
    weights: Vec<f64>,
    solved: Vec<f64>,
}

impl Kriging {
    /// Prepares data; returns the smoothness that they support.
    ///
    /// Points on a line do not determine a plane: their drift is a constant and their covariance linear.
    fn prepare(&mut self, data: &[Datum], smoothness: Smoothness, strips: &[u16]) -> Smoothness {
        let n = data.len();
        self.n = n;
        let extent = data.iter().map(|d| d.offset_m[0].abs().max(d.offset_m[1].abs())).fold(1e-3, f64::max);
        let is_plane = n > 4 && relative_spread(data.iter().map(|d| d.offset_m)) > LEAST_SPREAD;
        let others = strips.get(1..).unwrap_or_default();
        let planar = if is_plane { 3 } else { 1 };
        self.p = (planar + others.len()).min(MOST_DRIFT);
        self.drift.clear();
        for d in data {
            let mut row = [0.0; MOST_DRIFT];
            row[0] = 1.0;
            if is_plane {
                row[1] = d.offset_m[0] / extent;
                row[2] = d.offset_m[1] / extent;
            }
            for (slot, strip) in row[planar..].iter_mut().zip(others) {
                *slot = if d.strip == *strip { 1.0 } else { 0.0 };
            }
            self.drift.push(row);
        }
        let smoothness = if is_plane { smoothness } else { Smoothness::Linear };
        self.g.clear();
        self.g.resize(n * n, 0.0);
        for i in 0..n {
            for j in 0..i {
                let [dx, dy] = [0, 1].map(|k| data[i].offset_m[k] - data[j].offset_m[k]);
                let value = smoothness.at(dx * dx + dy * dy);
                (self.g[i * n + j], self.g[j * n + i]) = (value, value);
            }
        }
        self.g0.clear();
        self.g0.extend(data.iter().map(|d| {
            let [dx, dy] = d.offset_m;
            smoothness.at(dx * dx + dy * dy)
        }));
        smoothness
    }

    /// Factors a drift by Householder reflections, which map it to its first rows.
    fn factor_drift(&mut self, scale: impl Fn(usize) -> f64) {
        let (n, p) = (self.n, self.p);
        let mut f: Vec<[f64; MOST_DRIFT]> = (0..n).map(|i| self.drift[i].map(|x| x * scale(i))).collect();
        self.reflectors.clear();
        for c in 0..p {
            let norm = f[c..].iter().map(|row| row[c] * row[c]).sum::<f64>().sqrt();
            let mut v = vec![0.0; n];
            for i in c..n {
                v[i] = f[i][c];
            }
            v[c] += if v[c] < 0.0 { -norm } else { norm };
            let length = v.iter().map(|x| x * x).sum::<f64>().sqrt();
            if length > 0.0 {
                v.iter_mut().for_each(|x| *x /= length);
            }
            for k in c..p {
                let along: f64 = v.iter().zip(&f).map(|(v, row)| v * row[k]).sum();
                f.iter_mut().zip(&v).for_each(|(row, v)| row[k] -= 2.0 * along * v);
            }
            self.reflectors.push(v);
        }
        self.r[..p].copy_from_slice(&f[..p]);
    }

    fn reflect(&self, x: &mut [f64]) {
        for v in &self.reflectors {
            let dot: f64 = v.iter().zip(x.iter()).map(|(a, b)| a * b).sum();
            x.iter_mut().zip(v).for_each(|(x, v)| *x -= 2.0 * dot * v);
        }
    }

    fn reflect_back(&self, x: &mut [f64]) {
        for v in self.reflectors.iter().rev() {
            let dot: f64 = v.iter().zip(x.iter()).map(|(a, b)| a * b).sum();
            x.iter_mut().zip(v).for_each(|(x, v)| *x -= 2.0 * dot * v);
        }
    }

    /// Reflects both sides of the symmetric matrix `self.a`.
    fn reflect_matrix(&mut self) {
        let n = self.n;
        for v in &self.reflectors {
            self.work.clear();
            self.work.extend((0..n).map(|i| dot(&self.a[i * n..(i + 1) * n], v)));
            let half = dot(&self.work, v);
            // A - v wᵀ - w vᵀ with w = 2 (A v - v (vᵀ A v)).
            self.work.iter_mut().zip(v).for_each(|(w, v)| *w = 2.0 * (*w - v * half));
            for i in 0..n {
                let (vi, wi) = (v[i], self.work[i]);
                for (j, a) in self.a[i * n..(i + 1) * n].iter_mut().enumerate() {
                    *a -= vi * self.work[j] + wi * v[j];
                }
            }
        }
    }

    /// Predicts from data with the given SDs² per part; leaves out what contradicts its neighbours.
    ///
    /// `None` if the data do not determine it.
    pub(crate) fn predict(
        &mut self,
        data: &mut [Datum],
        smoothness: Smoothness,
        parts: Parts,
        target: Target,
        strips: &[u16],
    ) -> Option<Prediction> {
        if data.is_empty() {
            return None;
        }
        self.prepare(data, smoothness, strips);
        let (n, p) = (self.n, self.p);
        if n < p {
            return None;
        }
        self.factor_drift(|_| 1.0);
        let most_outliers = ((n - p) as f64 * MOST_OUTLIERS) as usize;
        for attempt in 0..=most_outliers {
            let system = self.solve(data, parts, target, strips)?;
            if target != Target::Height || attempt == most_outliers {
                return Some(system);
            }
            match self.outlier(data) {
                Some(i) => data[i].noise *= LEFT_OUT,
                None => return Some(system),
            }
        }
        None
    }

    fn solve(&mut self, data: &[Datum], parts: Parts, target: Target, strips: &[u16]) -> Option<Prediction> {
        let (n, p) = (self.n, self.p);
        self.a.clear();
        self.a.extend(self.g.iter().map(|g| g * parts.terrain));
        for i in 0..n {
            self.a[i * n + i] += parts.noise * data[i].noise;
            if target == Target::Height && parts.strip > 0.0 {
                for j in 0..n {
                    if data[i].strip == data[j].strip {
                        self.a[i * n + j] += parts.strip;
                    }
                }
            }
        }
        self.reflect_matrix();
        // Rᵀ w1 = f0.
        let mut f0 = [0.0; MOST_DRIFT];
        match target {
            Target::Height => f0[0] = 1.0,
            Target::StripDifference => *f0.get_mut(p.checked_sub(strips.len().checked_sub(1)?)?)? = 1.0,
        }
        let mut w = vec![0.0; n];
        for c in 0..p {
            let known: f64 = (0..c).map(|k| self.r[k][c] * w[k]).sum();
            w[c] = (f0[c] - known) / self.r[c][c];
        }
        if !w.iter().all(|w| w.is_finite()) {
            return None;
        }
        let mut k0 = vec![0.0; n];
        if target == Target::Height {
            k0.iter_mut().zip(&self.g0).for_each(|(k, g)| *k = g * parts.terrain);
            self.reflect(&mut k0);
        }
        let m = n - p;
        if !cholesky(&mut self.a, n, p) {
            return None;
        }
        let mut right: Vec<f64> = (p..n).map(|i| k0[i] - dot(&self.a[i * n..i * n + p], &w[..p])).collect();
        solve_cholesky(&self.a, n, p, &mut right);
        w[p..].copy_from_slice(&right[..m]);
        self.reflect_back(&mut w);
        self.weights.clone_from(&w);
        let level = data[0].height_m;
        let height_m = level * f0[0] + w.iter().zip(data).map(|(w, d)| w * (d.height_m - level)).sum::<f64>();
        let mut terrain = 0.0;
        let mut strip = 0.0;
        for i in 0..n {
            terrain += w[i] * dot(&self.g[i * n..(i + 1) * n], &w);
            for j in 0..n {
                strip += if data[i].strip == data[j].strip { w[i] * w[j] } else { 0.0 };
            }
        }
        if target == Target::Height {
            terrain -= 2.0 * dot(&self.g0, &w);
        }
        let noise: f64 = w.iter().zip(data).map(|(w, d)| w * w * d.noise).sum();
        // Heights of the data in the space without drift, for their outliers.
        self.solved.clear();
        self.solved.extend(data.iter().map(|d| d.height_m - level));
        let mut z = std::mem::take(&mut self.solved);
        self.reflect(&mut z);
        solve_cholesky(&self.a, n, p, &mut z[p..]);
        z[..p].fill(0.0);
        self.reflect_back(&mut z);
        self.solved = z;
        let variance = Parts {
            terrain: (terrain * parts.terrain).max(0.0),
            noise: noise * parts.noise,
            strip: strip * parts.strip,
        };
        Some(Prediction { height_m, variance })
    }

    /// Weight of a strip in the last prediction.
    pub(crate) fn weight_of(&self, data: &[Datum], strip: u16) -> f64 {
        self.weights.iter().zip(data).filter(|(_, d)| d.strip == strip).map(|(w, _)| w).sum()
    }

    /// The point that contradicts its neighbours most, beyond [`OUTLIER`].
    ///
    /// Its error from a prediction without it is `(P z)_i / P_ii`, with the variance `1 / P_ii`.
    fn outlier(&self, data: &[Datum]) -> Option<usize> {
        let (n, p) = (self.n, self.p);
        let size = |i: usize| self.solved[i].abs() * data[i].noise.sqrt();
        let open = |i: &usize| data[*i].noise < LEFT_OUT * 0.5;
        let largest = (0..n).filter(open).map(size).fold(0.0, f64::max);
        let mut worst: Option<(usize, f64)> = None;
        // An inverse of each point costs as much as the prediction: only large ones are looked at.
        for i in (0..n).filter(|i| open(i) && size(*i) >= 0.5 * largest) {
            let mut unit = vec![0.0; n];
            unit[i] = 1.0;
            self.reflect(&mut unit);
            let own: f64 = forward(&self.a, n, p, &mut unit[p..]);
            if own <= 0.0 {
                continue;
            }
            let t = self.solved[i] / own.sqrt();
            let excess = if t > 0.0 { t / OUTLIER[0] } else { -t / OUTLIER[1] };
            if excess > worst.map_or(1.0, |(_, w)| w) {
                worst = Some((i, excess));
            }
        }
        worst.map(|(i, _)| i)
    }

    /// Fills `likelihood` with the log-likelihood of each pair of terrain variance and noise variance.
    ///
    /// Restricted maximum likelihood: drift and offsets of strips are projected out. Pairs are those of
    /// `terrain` times `noise`, which are geometric series of the same ratio. Returns the number of
    /// contrasts, 0 if there are none.
    pub(crate) fn likelihood(
        &mut self,
        data: &[Datum],
        smoothness: Smoothness,
        strips: &[u16],
        [terrain, noise]: [&[f64]; 2],
        likelihood: &mut Vec<f64>,
    ) -> usize {
        likelihood.clear();
        likelihood.resize(terrain.len() * noise.len(), 0.0);
        if data.len() < 2 || self.prepare(data, smoothness, strips) != smoothness || self.n <= self.p {
            return 0;
        }
        let (n, p) = (self.n, self.p);
        let roots: Vec<f64> = data.iter().map(|d| 1.0 / d.noise.sqrt()).collect();
        self.factor_drift(|i| roots[i]);
        self.a.clear();
        self.a.extend(self.g.iter().enumerate().map(|(k, g)| g * roots[k / n] * roots[k % n]));
        self.reflect_matrix();
        let level = data[0].height_m;
        let mut z: Vec<f64> = data.iter().zip(&roots).map(|(d, r)| (d.height_m - level) * r).collect();
        self.reflect(&mut z);
        let m = n - p;
        let mut matrix: Vec<f64> = Vec::with_capacity(m * m);
        for i in p..n {
            matrix.extend_from_slice(&self.a[i * n + p..(i + 1) * n]);
        }
        let mut z = z.split_off(p);
        let (diagonal, off) = tridiagonal(&mut matrix, m, &mut z);
        // a² T + n² I = a² (T + r I), r = n² / a²: one factor per ratio.
        let step = terrain.get(1).map_or(2.0, |second| second / terrain[0]);
        let log_step = libm::log(step);
        let first = noise[0] / terrain[0];
        let most = terrain.len() as i64 - 1;
        for difference in -most..noise.len() as i64 {
            let ratio = first * libm::exp(log_step * difference as f64);
            let Some([log_determinant, quadratic]) = tridiagonal_solve(&diagonal, &off, ratio, &z) else {
                for i in 0..noise.len() as i64 {
                    let j = i - difference;
                    if (0..=most).contains(&j) {
                        likelihood[j as usize * noise.len() + i as usize] = f64::NEG_INFINITY;
                    }
                }
                continue;
            };
            for i in 0..noise.len() as i64 {
                let j = i - difference;
                if (0..=most).contains(&j) {
                    let variance = terrain[j as usize];
                    likelihood[j as usize * noise.len() + i as usize] =
                        -0.5 * (m as f64 * libm::log(variance) + log_determinant + quadratic / variance);
                }
            }
        }
        m
    }
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// Factors the lower right part of `a` from row `p` in place; false if it is not positive definite.
fn cholesky(a: &mut [f64], n: usize, p: usize) -> bool {
    for i in p..n {
        for j in p..=i {
            let (before, row) = a.split_at(i * n);
            let left = if i == j { &row[p..j] } else { &before[j * n + p..j * n + j] };
            let rest = row[j] - dot(&row[p..j], left);
            if i == j {
                if rest.is_nan() || rest <= 0.0 {
                    return false;
                }
                a[i * n + i] = rest.sqrt();
            } else {
                a[i * n + j] = rest / before[j * n + j];
            }
        }
    }
    true
}

/// Solves `L x = b` in place; returns the squared norm of `x`.
fn forward(a: &[f64], n: usize, p: usize, b: &mut [f64]) -> f64 {
    for i in 0..b.len() {
        let row = &a[(p + i) * n + p..(p + i) * n + p + i + 1];
        b[i] = (b[i] - dot(&row[..i], &b[..i])) / row[i];
    }
    b.iter().map(|x| x * x).sum()
}

fn solve_cholesky(a: &[f64], n: usize, p: usize, b: &mut [f64]) {
    forward(a, n, p, b);
    for i in (0..b.len()).rev() {
        b[i] /= a[(p + i) * n + p + i];
        let x = b[i];
        let row = &a[(p + i) * n + p..(p + i) * n + p + i];
        b[..i].iter_mut().zip(row).for_each(|(b, l)| *b -= l * x);
    }
}

/// Reduces a symmetric matrix to a tridiagonal one by reflections, which are applied to `z` too.
fn tridiagonal(a: &mut [f64], m: usize, z: &mut [f64]) -> (Vec<f64>, Vec<f64>) {
    let mut off = vec![0.0; m.saturating_sub(1)];
    let (mut v, mut w) = (vec![0.0; m], vec![0.0; m]);
    for k in 0..m.saturating_sub(1) {
        let norm = (k + 1..m).map(|i| a[i * m + k] * a[i * m + k]).sum::<f64>().sqrt();
        let first = a[(k + 1) * m + k];
        let alpha = if first < 0.0 { norm } else { -norm };
        off[k] = alpha;
        for i in k + 1..m {
            v[i] = a[i * m + k];
        }
        v[k + 1] -= alpha;
        let squared = v[k + 1..].iter().map(|x| x * x).sum::<f64>();
        if squared <= 0.0 {
            continue;
        }
        let length = squared.sqrt();
        v[k + 1..].iter_mut().for_each(|x| *x /= length);
        let from = k + 1;
        for i in from..m {
            w[i] = dot(&a[i * m + from..(i + 1) * m], &v[from..]);
        }
        let half = dot(&w[from..], &v[from..]);
        for i in from..m {
            w[i] = 2.0 * (w[i] - v[i] * half);
        }
        for i in from..m {
            let (vi, wi) = (v[i], w[i]);
            for j in from..m {
                a[i * m + j] -= vi * w[j] + wi * v[j];
            }
        }
        let along = 2.0 * dot(&v[from..], &z[from..]);
        z[from..].iter_mut().zip(&v[from..]).for_each(|(z, v)| *z -= along * v);
    }
    ((0..m).map(|i| a[i * m + i]).collect(), off)
}

/// Log-determinant of `T + r I`, and `zᵀ (T + r I)⁻¹ z`; `None` if it is not positive definite.
fn tridiagonal_solve(diagonal: &[f64], off: &[f64], ratio: f64, z: &[f64]) -> Option<[f64; 2]> {
    let (mut log_determinant, mut product, mut quadratic) = (0.0, 1.0, 0.0);
    let (mut pivot, mut y) = (1.0, 0.0);
    for i in 0..diagonal.len() {
        let l = if i > 0 { off[i - 1] / pivot } else { 0.0 };
        pivot = diagonal[i] + ratio - if i > 0 { l * off[i - 1] } else { 0.0 };
        if pivot.is_nan() || pivot <= 0.0 {
            return None;
        }
        y = z[i] - l * y;
        quadratic += y * y / pivot;
        product *= pivot;
        if !(1e-200..1e200).contains(&product) {
            log_determinant += libm::log(product);
            product = 1.0;
        }
    }
    Some([log_determinant + libm::log(product), quadratic])
}

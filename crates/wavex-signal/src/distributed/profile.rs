//! Peaks and relative heights of a profile.

use std::ops::Range;

use super::columns::{Grid, POINTS_PER_WIDTH};
use super::solve::Solution;

/// Parts of the energy whose heights above the last peak are given.
pub const RELATIVE_HEIGHTS: [f64; 4] = [0.25, 0.5, 0.75, 0.98];
/// Energy of a peak or stretch over its standard deviation from which it counts.
const CLEAR: f64 = 4.5;
/// Depth of a valley between two peaks, relative to the lower of them.
const VALLEY: f64 = 0.7;

/// A value with its standard deviation.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct WithSd {
    /// The value.
    pub value: f64,
    /// Its standard deviation.
    pub sd: f64,
}

/// Profile of a distributed target. Positions are samples from the first of the block.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TargetProfile {
    /// Position of the first clear peak.
    pub first_peak_samples: WithSd,
    /// Position of the last clear peak, usually the ground.
    pub last_peak_samples: WithSd,
    /// Number of clear peaks.
    pub peaks: u32,
    /// Distance from the last peak up to where these parts ([`RELATIVE_HEIGHTS`]) of the energy lie
    /// behind, samples; negative if the part lies behind the last peak.
    pub heights_samples: [WithSd; RELATIVE_HEIGHTS.len()],
    /// Sum of the echo heights along the profile, DN.
    pub energy_dn: WithSd,
    /// `(χ² - ν)/√(2ν)` of the profile.
    pub deviation_ratio: f64,
}

/// A peak of the profile and the points between its valleys.
struct Peak {
    top: usize,
    first: usize,
    end: usize,
}

/// Peaks and relative heights; `None` without a clear peak.
pub(super) fn of(solution: &Solution, grid: Grid) -> Option<TargetProfile> {
    let nu = solution.degrees_of_freedom;
    let deviation_ratio = (solution.chi_square - nu) / (2.0 * nu).sqrt();
    // A profile that does not explain the waveform is uncertain by its misfit.
    let misfit = if deviation_ratio > 3.0 { (solution.chi_square / nu).sqrt() } else { 1.0 };
    let sd_of = |weights: &dyn Fn(usize) -> f64| misfit * solution.variance(weights).max(0.0).sqrt();
    let is_clear = |part: Range<usize>| {
        let energy = solution.values[part.clone()].iter().sum::<f64>();
        energy > CLEAR * sd_of(&|i| f64::from(u8::from(part.contains(&i))))
    };
    // Values without negative ones follow the noise where there is no target.
    let mut values = solution.values.to_vec();
    for stretch in stretches(solution.values, POINTS_PER_WIDTH as usize) {
        if !is_clear(stretch.clone()) {
            values[stretch].fill(0.0);
        }
    }
    let values = &values;
    let energy = values.iter().sum::<f64>();
    let stiffer: Vec<f64> = solution
        .stiffer
        .iter()
        .zip(values)
        .map(|(stiffer, value)| if *value > 0.0 { *stiffer } else { 0.0 })
        .collect();
    let is_clear_peak = |peak: &Peak| is_clear(peak.first..peak.end);
    let peaks: Vec<Peak> = peaks(values).into_iter().filter(is_clear_peak).collect();
    let (first, last) = (peaks.first()?, peaks.last()?);
    let ground = Vertex::of(values, last.top);
    // What the next stiffer penalty changes is uncertain as well.
    let stiffer = &stiffer;
    let stiffer_energy = stiffer.iter().sum::<f64>();
    let stiffer_ground = Vertex::near(stiffer, last.top);
    let with_sd = |value: f64, by_noise: f64, stiffer: f64| WithSd {
        value: grid.step_samples() * value,
        sd: grid.step_samples() * by_noise.hypot(value - stiffer),
    };
    let position = |vertex: &Vertex, stiffer: &Vertex| {
        with_sd(vertex.position(), sd_of(&|i| vertex.slope(i)), stiffer.position())
    };
    let heights_samples = RELATIVE_HEIGHTS.map(|part| {
        // Beams travel downwards: the part of the energy from below is the rest of that from above.
        let level = Quantile::of(values, energy, 1.0 - part);
        let stiffer_level = Quantile::of(stiffer, stiffer_energy, 1.0 - part);
        with_sd(
            ground.position() - level.position,
            sd_of(&|i| ground.slope(i) - level.slope(i)),
            stiffer_ground.position() - stiffer_level.position,
        )
    });
    Some(TargetProfile {
        first_peak_samples: position(&Vertex::of(values, first.top), &Vertex::near(stiffer, first.top)),
        last_peak_samples: position(&ground, &stiffer_ground),
        peaks: peaks.len() as u32,
        heights_samples,
        energy_dn: WithSd { value: energy, sd: sd_of(&|_| 1.0).hypot(energy - stiffer_energy) },
        deviation_ratio,
    })
}

/// Stretches of positive values, without gaps of more than `gap` points.
fn stretches(values: &[f64], gap: usize) -> Vec<Range<usize>> {
    let mut found: Vec<Range<usize>> = Vec::new();
    for (point, _) in values.iter().enumerate().filter(|(_, value)| **value > 0.0) {
        match found.last_mut() {
            Some(last) if point - last.end <= gap => last.end = point + 1,
            _ => found.push(point..point + 1),
        }
    }
    found
}

/// Local maxima separated by valleys.
fn peaks(values: &[f64]) -> Vec<Peak> {
    let mut peaks: Vec<Peak> = Vec::new();
    let at = |i: usize| values.get(i).copied().unwrap_or(0.0);
    for top in 0..values.len() {
        let is_top = at(top) > 0.0 && at(top) > at(top.wrapping_sub(1)) && at(top) >= at(top + 1);
        if !is_top {
            continue;
        }
        let Some(before) = peaks.last_mut() else {
            peaks.push(Peak { top, first: 0, end: values.len() });
            continue;
        };
        let lowest = (before.top..top).min_by(|&i, &j| at(i).total_cmp(&at(j))).unwrap_or(top);
        if at(lowest) < VALLEY * at(top).min(at(before.top)) {
            before.end = lowest;
            peaks.push(Peak { top, first: lowest, end: values.len() });
        } else if at(top) > at(before.top) {
            before.top = top;
        }
    }
    peaks
}

/// Vertex of the parabola through a maximum and its neighbours.
struct Vertex {
    top: usize,
    /// Distance from the top, points.
    offset: f64,
    /// Derivatives of the offset by the values before, at and behind the top.
    slopes: [f64; 3],
}

impl Vertex {
    fn of(values: &[f64], top: usize) -> Vertex {
        let at = |i: usize| values.get(i).copied().unwrap_or(0.0);
        let (before, here, behind) = (at(top.wrapping_sub(1)), at(top), at(top + 1));
        let bend = before - 2.0 * here + behind;
        if bend >= 0.0 {
            return Vertex { top, offset: 0.0, slopes: [0.0; 3] };
        }
        let offset = 0.5 * (before - behind) / bend;
        let slopes = [(0.5 - offset) / bend, 2.0 * offset / bend, (-0.5 - offset) / bend];
        Vertex { top, offset, slopes }
    }

    /// Vertex of the maximum uphill of a point.
    fn near(values: &[f64], from: usize) -> Vertex {
        let at = |i: usize| values.get(i).copied().unwrap_or(0.0);
        let mut top = from;
        while at(top + 1) > at(top) {
            top += 1;
        }
        while top > 0 && at(top - 1) > at(top) {
            top -= 1;
        }
        Vertex::of(values, top)
    }

    /// In points.
    fn position(&self) -> f64 {
        self.top as f64 + self.offset
    }

    fn slope(&self, point: usize) -> f64 {
        match (point + 1).wrapping_sub(self.top) {
            side @ 0..=2 => self.slopes[side],
            _ => 0.0,
        }
    }
}

/// Position up to which a part of the energy lies.
struct Quantile {
    /// In points; the energy of a point is spread evenly over one step around it.
    position: f64,
    at: usize,
    part: f64,
    /// Energy per point there.
    density: f64,
    /// Part of the energy of the point itself that counts.
    share: f64,
}

impl Quantile {
    fn of(values: &[f64], energy: f64, part: f64) -> Quantile {
        let wanted = part * energy;
        let mut sum = 0.0;
        let mut found = Quantile { position: 0.0, at: 0, part, density: f64::INFINITY, share: 0.0 };
        for (at, &density) in values.iter().enumerate().filter(|(_, value)| **value > 0.0) {
            let share = ((wanted - sum) / density).clamp(0.0, 1.0);
            found = Quantile { position: at as f64 - 0.5 + share, at, part, density, share };
            sum += density;
            if sum >= wanted {
                break;
            }
        }
        found
    }

    /// Derivative of the position by the value of a point.
    fn slope(&self, point: usize) -> f64 {
        let counted = match point.cmp(&self.at) {
            std::cmp::Ordering::Less => 1.0,
            std::cmp::Ordering::Equal => self.share,
            std::cmp::Ordering::Greater => 0.0,
        };
        (self.part - counted) / self.density
    }
}

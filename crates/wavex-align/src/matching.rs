//! Pairs of patches of different strips at the same place.

use std::collections::HashMap;

use rayon::prelude::*;
use wavex_simd::statistics::median;

use crate::patch::{block_rank, level, slope_class};
use crate::survey::{Located, State, Survey};
use crate::vector::{difference, dot};

/// Limits of a matching.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MatchSettings {
    /// Largest horizontal distance of the centres, m; above 0.
    pub search_m: f64,
    /// Largest distance along the normal, m.
    pub gate_m: f64,
    /// Largest angle between the normals, rad.
    pub turn_rad: f64,
    /// Most pairs of two strips.
    pub most_pairs: usize,
    /// Edge of the tiles of the jackknife, m; above 0.
    pub tile_m: f64,
}

/// Two patches at the same place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pair {
    /// Indices of the patches, of the strip with the lower index first.
    pub patches: [u32; 2],
    /// SD of the distance along the normal, m.
    pub sd_m: f64,
    /// Weight that makes the pairs of `k` strips at one place count as `k - 1` differences: 2 / k.
    ///
    /// For equal SDs this equals the covariances of the differences exactly: the sum of the squared differences of `k`
    /// values over all pairs is `k` times the sum of their squared deviations from the mean.
    pub share: f64,
    /// Tile of the ground, for the jackknife.
    pub tile: [i32; 2],
    /// Direction of the derivatives, east, north, up: the normal without its noise.
    ///
    /// The noise of a normal is in the residual, times the distance of the centres along the surface, and would be in its
    /// derivative: their product pulls the centres together, as if a plain showed horizontal offsets. Normals
    /// that do not differ from those around by more than noise are therefore replaced by them.
    pub direction: [f32; 3],
}

/// Largest edge of the tiles of the jackknife, m.
pub const TILE_M: f64 = 200.0;

/// Edge of the tiles of the jackknife, m: 200 tiles of the largest strip, but not below the reach of errors of surface.
pub fn tile_m(largest_strip_m2: f64) -> f64 {
    (largest_strip_m2 / 200.0).sqrt().clamp(15.0, TILE_M)
}

/// Scan angle classes of the selection, per sine of the angle between beam and vertical.
const SCAN_CLASSES: usize = 5;

type Bin = (u32, u32, usize, usize);

/// Pairs of patches with the current parameters.
///
/// Two patches are a pair if each is the nearest of its strip to the other. Of many, classes of slope, aspect and scan
/// angle are represented equally. The result is ordered and independent of threads.
pub fn match_patches(survey: &Survey<'_>, state: &State, settings: &MatchSettings) -> Vec<Pair> {
    let located = survey.locate_all(state);
    let index = GroundIndex::new(&located, settings.search_m);
    // Patch and the nearest of another strip, in order of the patches.
    let nearest: Vec<(u32, u32)> = (0..located.len() as u32)
        .into_par_iter()
        .flat_map_iter(|own| {
            let mut others = nearest_of_strips(survey, &located, &index, own, settings);
            others.sort_unstable();
            others.into_iter().map(move |other| (own, other))
        })
        .collect();
    drop(index);
    let strip = |patch: u32| survey.patches[patch as usize].strip;
    let is_mutual = |&(own, other): &(u32, u32)| {
        strip(own) < strip(other) && nearest.binary_search(&(other, own)).is_ok()
    };
    let pairs: Vec<[u32; 2]> =
        nearest.par_iter().copied().filter(is_mutual).map(|(own, other)| [own, other]).collect();
    drop(nearest);
    let mut strips_at = vec![1u32; located.len()];
    for patch in pairs.iter().flatten() {
        strips_at[*patch as usize] += 1;
    }
    let pairs = select(survey, &located, pairs, settings.most_pairs);
    let surroundings = Surroundings::new(&located);
    let pair = |patches: [u32; 2]| {
        let [a, b] = patches.map(|patch| &survey.patches[patch as usize]);
        let [at_a, at_b] = patches.map(|patch| located[patch as usize]);
        let (at_a, at_b) = (at_a?, at_b?);
        let d = difference(at_a.centre_m(), at_b.centre_m());
        let along = dot(at_a.normal(), d);
        let half_squared = 0.25 * (dot(d, d) - along * along).max(0.0);
        let square = |sd: f32| f64::from(sd) * f64::from(sd);
        let variance =
            square(a.sd_m) + square(b.sd_m) + half_squared * (square(a.slope_sd) + square(b.slope_sd));
        let strips: u32 = patches.iter().map(|patch| strips_at[*patch as usize]).sum();
        let tile = [at_a.centre_m()[0], at_a.centre_m()[1]]
            .map(|along_m| (along_m / settings.tile_m).floor() as i32);
        let noise_squared = 0.25 * (square(a.slope_sd) + square(b.slope_sd));
        let direction = surroundings.denoised(&at_a, &at_b, noise_squared);
        let sd_m = variance.sqrt().max(1e-4);
        Some(Pair { patches, sd_m, share: 4.0 / f64::from(strips), tile, direction })
    };
    pairs.into_iter().filter_map(pair).collect()
}

/// Edge of the squares whose median normals replace noisy ones, m.
const SURROUNDINGS_M: f64 = 50.0;
/// Fewest patches of such a square.
const LEAST_AROUND: usize = 8;
/// Normals differ from their surroundings if they do so by more than this many SDs.
const DIFFERENT_SDS: f64 = 4.0;

/// Median horizontal components of the normals by squares of the ground.
pub(crate) struct Surroundings(HashMap<(i32, i32), [f64; 2]>);

impl Surroundings {
    pub(crate) fn new(located: &[Option<Located>]) -> Surroundings {
        let index = GroundIndex::new(located, SURROUNDINGS_M);
        let medians = index.ranges.par_iter().filter_map(|(key, &(from, to))| {
            let patches = &index.patches[from as usize..to as usize];
            let part = |axis: usize| {
                let normals = patches.iter().filter_map(|patch| located[*patch as usize].as_ref());
                median(normals.map(|at| at.normal()[axis]))
            };
            (patches.len() >= LEAST_AROUND).then_some((*key, [part(0)?, part(1)?]))
        });
        Surroundings(medians.collect())
    }

    /// Mean normal of two patches, without its part that is not above the noise.
    pub(crate) fn denoised(&self, a: &Located, b: &Located, noise_squared: f64) -> [f32; 3] {
        let sum: [f64; 3] = core::array::from_fn(|axis| a.normal()[axis] + b.normal()[axis]);
        let size = dot(sum, sum).sqrt().max(1e-9);
        let own = sum.map(|part| part / size);
        let Some(around) = self.0.get(&cell(a, SURROUNDINGS_M)) else { return own.map(|part| part as f32) };
        let away = [own[0] - around[0], own[1] - around[1]];
        let squared = away[0] * away[0] + away[1] * away[1];
        let kept = match squared > DIFFERENT_SDS * DIFFERENT_SDS * noise_squared {
            true => 1.0 - 2.0 * noise_squared / squared,
            false => 0.0,
        };
        let [east, north] = [around[0] + kept * away[0], around[1] + kept * away[1]];
        let up = (1.0 - east * east - north * north).max(0.0).sqrt();
        [east, north, up].map(|part| part as f32)
    }
}

/// Patches by cells of the ground.
pub(crate) struct GroundIndex {
    cell_m: f64,
    /// Patches in order of their cells, and their range for each cell.
    patches: Vec<u32>,
    ranges: HashMap<(i32, i32), (u32, u32)>,
}

impl GroundIndex {
    pub(crate) fn new(located: &[Option<Located>], cell_m: f64) -> GroundIndex {
        let mut keyed: Vec<((i32, i32), u32)> = located
            .iter()
            .enumerate()
            .filter_map(|(patch, at)| Some((cell(at.as_ref()?, cell_m), patch as u32)))
            .collect();
        keyed.par_sort_unstable();
        let mut ranges: HashMap<(i32, i32), (u32, u32)> = HashMap::new();
        for (place, (key, _)) in keyed.iter().enumerate() {
            let range = ranges.entry(*key).or_insert((place as u32, place as u32));
            range.1 = place as u32 + 1;
        }
        GroundIndex { cell_m, patches: keyed.into_iter().map(|(_, patch)| patch).collect(), ranges }
    }

    /// Patches of the nine cells around a place.
    pub(crate) fn around(&self, at: &Located) -> impl Iterator<Item = u32> {
        let (x, y) = cell(at, self.cell_m);
        let keys =
            (-1..=1).flat_map(move |dy| (-1..=1).map(move |dx| (x.wrapping_add(dx), y.wrapping_add(dy))));
        keys.filter_map(|key| self.ranges.get(&key))
            .flat_map(|&(from, to)| self.patches[from as usize..to as usize].iter().copied())
    }
}

fn cell(at: &Located, cell_m: f64) -> (i32, i32) {
    ((at.centre_m()[0] / cell_m).floor() as i32, (at.centre_m()[1] / cell_m).floor() as i32)
}

/// Nearest patch of each other strip.
fn nearest_of_strips(
    survey: &Survey<'_>,
    located: &[Option<Located>],
    index: &GroundIndex,
    own: u32,
    settings: &MatchSettings,
) -> Vec<u32> {
    let Some(at) = &located[own as usize] else { return Vec::new() };
    let own_strip = survey.patches[own as usize].strip;
    let least_cosine = settings.turn_rad.cos();
    // Strip, squared distance, patch.
    let mut best: Vec<(u32, f64, u32)> = Vec::new();
    for other in index.around(at) {
        let strip = survey.patches[other as usize].strip;
        let Some(there) = located[other as usize].as_ref().filter(|_| strip != own_strip) else { continue };
        let [east, north, _] = difference(at.centre_m(), there.centre_m());
        let squared = east * east + north * north;
        let is_near = squared <= settings.search_m * settings.search_m
            && dot(at.normal(), there.normal()) >= least_cosine
            && dot(at.normal(), difference(at.centre_m(), there.centre_m())).abs() <= settings.gate_m;
        if !is_near {
            continue;
        }
        match best.iter_mut().find(|(known, ..)| *known == strip) {
            Some(known) if (known.1, known.2) > (squared, other) => *known = (strip, squared, other),
            Some(_) => {}
            None => best.push((strip, squared, other)),
        }
    }
    best.into_iter().map(|(.., other)| other).collect()
}

/// At most `most` pairs of two strips, spread over slopes, aspects and scan angles.
fn select(
    survey: &Survey<'_>,
    located: &[Option<Located>],
    pairs: Vec<[u32; 2]>,
    most: usize,
) -> Vec<[u32; 2]> {
    let mut binned: Vec<(Bin, u64, [u32; 2])> = pairs
        .into_iter()
        .filter_map(|patches| {
            let [a, b] = patches.map(|patch| &survey.patches[patch as usize]);
            let at = located[patches[0] as usize].as_ref()?;
            let scanner = &survey.installations[survey.strips[a.strip as usize].installation].scanner;
            let angle = scanner.scan_angle_rad(&a.beams[0]).clamp(-0.7, 0.7);
            let scan_class = ((angle + 0.7) / 1.4 * SCAN_CLASSES as f64) as usize;
            let bin = (a.strip, b.strip, slope_class(at.normal()), scan_class.min(SCAN_CLASSES - 1));
            let place = (at.centre_m()[0].round() as i64, at.centre_m()[1].round() as i64);
            Some((bin, block_rank(place), patches))
        })
        .collect();
    binned.par_sort_unstable();
    let mut selected = Vec::new();
    for of_strips in binned.chunk_by(|a, b| (a.0.0, a.0.1) == (b.0.0, b.0.1)) {
        let bins: Vec<_> = of_strips.chunk_by(|a, b| a.0 == b.0).collect();
        let counts: Vec<usize> = bins.iter().map(|bin| bin.len()).collect();
        // At least one of each class.
        let quota = level(&counts, most).max(1);
        let of_bins = bins.into_iter().flat_map(|bin| bin.iter().take(quota).map(|(.., patches)| *patches));
        selected.extend(of_bins.take(most));
    }
    selected
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulated::{Flight, Plan};

    const SETTINGS: MatchSettings =
        MatchSettings { search_m: 5.0, gate_m: 0.5, turn_rad: 0.3, most_pairs: 100_000, tile_m: TILE_M };

    fn matched(flight: &Flight, settings: &MatchSettings) -> Vec<Pair> {
        let survey = flight.survey();
        let scanners = vec![flight.installations[0].scanner];
        let state = State { scanners, corrections: vec![None; flight.strips.len()] };
        match_patches(&survey, &state, settings)
    }

    #[test]
    fn pairs_are_nearest_neighbours_of_different_strips() {
        let flight = Plan::cross().fly();
        let pairs = matched(&flight, &SETTINGS);
        assert!(pairs.len() > 2000, "{}", pairs.len());
        let strip = |patch: u32| flight.patches[patch as usize].strip;
        let mut sides: Vec<_> = pairs
            .iter()
            .flat_map(|Pair { patches: [a, b], .. }| [(*a, strip(*b)), (*b, strip(*a))])
            .collect();
        assert!(pairs.iter().all(|pair| strip(pair.patches[0]) < strip(pair.patches[1])));
        sides.sort_unstable();
        assert!(sides.array_windows().all(|[a, b]| a != b), "one partner in each strip");
        let survey = flight.survey();
        let state = State { scanners: vec![flight.installations[0].scanner], corrections: vec![None; 4] };
        let mut poses = survey.poses();
        for pair in &pairs {
            let [a, b] = pair.patches.map(|patch| {
                survey.locate(&flight.patches[patch as usize], &state, &mut poses).unwrap().centre_m()
            });
            let [x, y, _] = difference(a, b);
            assert!(x.hypot(y) <= 5.0);
        }
    }

    /// Pairs of a place that k strips see count as k - 1 differences.
    #[test]
    fn shares_depend_on_the_strips_at_a_place() {
        let plan = Plan { lines: vec![(0.0, 0.0); 3], ..Plan::cross() };
        let plan = Plan { heights_m: vec![0.0; 3], ..plan };
        let pairs = matched(&plan.fly(), &SETTINGS);
        let of_three = pairs.iter().filter(|pair| (pair.share - 2.0 / 3.0).abs() < 1e-12).count();
        assert!(of_three * 10 > pairs.len() * 7, "{of_three} of {}", pairs.len());
        let two = Plan { lines: vec![(0.0, 0.0); 2], heights_m: vec![0.0; 2], ..Plan::cross() };
        assert!(matched(&two.fly(), &SETTINGS).iter().all(|pair| pair.share == 1.0));
    }

    #[test]
    fn limits_are_kept() {
        let flight = Plan::cross().fly();
        let few = matched(&flight, &MatchSettings { most_pairs: 90, ..SETTINGS });
        let strip = |patch: u32| flight.patches[patch as usize].strip;
        let of_two = few.iter().filter(|pair| pair.patches.map(strip) == [0, 1]).count();
        assert!(of_two <= 90 && of_two > 60, "{of_two}");
        let scan = |pair: &&Pair| flight.patches[pair.patches[0] as usize].beams[0].direction[1] > 0.3;
        let edge = few.iter().filter(|pair| pair.patches.map(strip) == [0, 3]).filter(scan).count();
        assert!(edge > 8, "all scan angles are represented: {edge}");
        let upright = MatchSettings { turn_rad: 1e-6, ..SETTINGS };
        assert!(matched(&flight, &upright).len() < 100);
        let near = matched(&flight, &MatchSettings { gate_m: 0.001, ..SETTINGS });
        assert!(near.len() * 2 < matched(&flight, &SETTINGS).len());
    }

    /// Normals of a plain lose their noise; those of hills and roofs keep their slope.
    #[test]
    fn directions_are_normals_without_noise() {
        let at = |x: f32, slope: f32| {
            let mut normal = [-slope, 0.0, 1.0];
            let size = normal.iter().map(|part| part * part).sum::<f32>().sqrt();
            normal.iter_mut().for_each(|part| *part /= size);
            Some(Located::new([x, 5.0, 0.0], normal))
        };
        let plain: Vec<_> =
            (0..40).map(|k| at(k as f32, 0.02 + if k % 2 == 0 { 1e-3 } else { -1e-3 })).collect();
        let surroundings = Surroundings::new(&plain);
        let direction = |slope: f32, around: &Surroundings| {
            let patch = at(3.0, slope).unwrap();
            let [east, _, up] = around.denoised(&patch, &patch, 1e-6);
            -east / up
        };
        assert!((direction(0.023, &surroundings) - 0.02).abs() < 1.1e-3, "noise");
        assert!((direction(0.3, &surroundings) - 0.3).abs() < 1e-4, "a roof");
        let few = Surroundings::new(&plain[..4]);
        assert!((direction(0.023, &few) - 0.023).abs() < 1e-6, "no surroundings");
    }
}

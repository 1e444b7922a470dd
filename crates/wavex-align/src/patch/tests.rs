//! Patches of simulated returns.

use wavex_geodesy::ellipsoid::WGS84;
use wavex_geodesy::frames::{LocalFrame, rotate};

use super::frame::tile_horizon;
use super::*;
use crate::simulated::{Normal, PLACE};
use crate::vector::{cross, difference};

const SPACING_M: f64 = 0.5;
const ABOVE_M: f64 = 500.0;

/// Returns of vertical beams on a grid of `edge` by `edge`; the time of a return is its number in 10 microseconds.
fn returns(edge: usize, seed: u64, noise_m: f64, height: impl Fn(f64, f64) -> f64) -> Vec<PatchReturn> {
    let mut normal = Normal::new(seed);
    let frame = LocalFrame::at(WGS84, PLACE);
    let down = rotate(frame.ecef_from_local(), [0.0, 0.0, -1.0]);
    let made = (0..edge * edge).map(|k| {
        let [x, y] = place(edge, k);
        let z = height(x, y) + noise_m * normal.draw();
        PatchReturn {
            beam: ScannerBeam { time_s: k as f64 * 1e-5, direction: [0.0, 0.0, 1.0], range_m: ABOVE_M - z },
            source: BeamSource::default(),
            range_sd_m: noise_m,
            n_returns: 1,
            point_in_ecef_m: WGS84.ecef_of(frame.geodetic_of([x, y, z])),
            direction_in_ecef: down,
        }
    });
    made.collect()
}

fn place(edge: usize, k: usize) -> [f64; 2] {
    [(k % edge) as f64 * SPACING_M + 0.1, (k / edge) as f64 * SPACING_M + 0.1]
}

fn patches(returns: &[PatchReturn], settings: PatchSettings) -> (Vec<Patch>, PatchCounts) {
    let mut maker = PatchMaker::new(7, Horizon::at(PLACE), settings);
    returns.iter().for_each(|given| maker.add(given));
    maker.finish()
}

#[test]
fn beams_end_on_the_plane() {
    let plane = |x: f64, y: f64| 3.0 + 0.3 * x - 0.2 * y;
    let (found, counts) = patches(&returns(24, 1, 0.01, plane), PatchSettings::default());
    assert_eq!((found.len(), counts), (16, PatchCounts::default()));
    let mut squares = 0.0;
    for patch in &found {
        assert!(patch.strip == 7 && (33..=36).contains(&patch.n_returns), "{patch:?}");
        let ends = patch.beams.map(|beam| {
            let [x, y] = place(24, (beam.time_s / 1e-5).round() as usize);
            [x, y, ABOVE_M - beam.range_m]
        });
        let area = cross(difference(ends[1], ends[0]), difference(ends[2], ends[0]));
        assert!(area[2] > 1.0, "anticlockwise: {area:?}");
        let mean = ends.iter().map(|[x, y, z]| z - plane(*x, *y)).sum::<f64>() / 3.0;
        // Errors of vertical beams along the normal.
        let error = mean / (1.0f64 + 0.3 * 0.3 + 0.2 * 0.2).sqrt();
        squares += (error / f64::from(patch.sd_m)).powi(2);
        assert!((0.001..0.0025).contains(&patch.sd_m), "{}", patch.sd_m);
        assert!(patch.roughness_m < 0.006 && patch.slope_sd < 0.004, "{patch:?}");
    }
    let ratio = (squares / 16.0).sqrt();
    assert!((0.6..1.5).contains(&ratio), "errors over SDs: {ratio}");
}

#[test]
fn unsuitable_cells_are_rejected() {
    let of = |returns: &[PatchReturn]| patches(returns, PatchSettings::default());
    let mut normal = Normal::new(3);
    let noise: Vec<f64> = (0..10_000).map(|_| 0.3 * normal.draw()).collect();
    let rough = returns(24, 1, 0.01, |x, y| noise[(x * 60.0 + y * 1000.0) as usize % 10_000]);
    assert_eq!((of(&rough).0.len(), of(&rough).1.rough), (0, 16));
    let kerb = returns(24, 1, 0.01, |x, _| if x % 3.0 < 1.5 { 0.0 } else { 0.4 });
    assert_eq!((of(&kerb).0.len(), of(&kerb).1.rough), (0, 16));
    let wall = returns(24, 1, 0.01, |x, _| 4.0 * x);
    assert_eq!((of(&wall).0.len(), of(&wall).1.rough), (0, 16));
    let mut trees = returns(24, 1, 0.01, |_, _| 0.0);
    trees.iter_mut().step_by(3).for_each(|given| given.n_returns = 3);
    assert_eq!((of(&trees).0.len(), of(&trees).1.multiple), (0, 16));
    let few: Vec<_> = returns(24, 1, 0.01, |_, _| 0.0).into_iter().step_by(7).collect();
    assert_eq!((of(&few).0.len(), of(&few).1.sparse), (0, 16));
    let mut unusable = returns(24, 1, 0.01, |_, _| 0.0);
    unusable[5].beam.range_m = f64::NAN;
    unusable[6].point_in_ecef_m[1] = f64::INFINITY;
    assert_eq!((of(&unusable).0.len(), of(&unusable).1.unusable_returns), (16, 2));
}

/// One car in a cell of a road is an outlier, not the end of the patch.
#[test]
fn few_outliers_are_left_out() {
    let road = returns(24, 1, 0.01, |x, y| if x < 1.0 && y < 0.5 { 1.5 } else { 0.0 });
    let (found, _) = patches(&road, PatchSettings::default());
    assert_eq!(found.len(), 16);
    assert_eq!(found.iter().filter(|patch| patch.n_returns == 34).count(), 1);
}

#[test]
fn receivers_have_patches_of_their_own() {
    let mut both = returns(24, 1, 0.01, |_, _| 0.0);
    both.iter_mut().step_by(2).for_each(|given| given.source.on_low_power_scale = true);
    let (found, _) = patches(&both, PatchSettings::default());
    let low = found.iter().filter(|patch| patch.source.on_low_power_scale).count();
    assert_eq!((found.len(), low), (32, 16));
}

/// Strips that are thinned keep the same places, and rare slopes before frequent ones.
#[test]
fn strips_are_thinned_alike() {
    // A plain with a slope in its last eighth.
    let height = |_: f64, y: f64| 0.3 * (y - 84.0).max(0.0);
    let settings = PatchSettings { most_patches: 300, ..PatchSettings::default() };
    let kept = |seed| {
        let (found, counts) = patches(&returns(192, seed, 0.01, height), settings);
        assert!(found.len() <= 300 && counts.thinned > 500, "{} {counts:?}", found.len());
        let mut cells: Vec<_> = found
            .iter()
            .map(|patch| {
                let [x, y] = place(192, (patch.beams[0].time_s / 1e-5).round() as usize);
                ((x / 3.0) as i64, (y / 3.0) as i64)
            })
            .collect();
        cells.sort_unstable();
        cells
    };
    let (first, second) = (kept(1), kept(2));
    let shared = first.iter().filter(|cell| second.contains(cell)).count();
    assert!(shared * 10 >= first.len() * 9, "{shared} of {}", first.len());
    let steep = first.iter().filter(|(_, y)| *y >= 28).count();
    assert!(steep > 100, "{steep} of {}", first.len());
}

/// Patches are in the order of keeping, also if they are thinned several times while the strip is read.
#[test]
fn first_patches_are_those_of_a_lower_limit() {
    let height = |_: f64, y: f64| 0.3 * (y - 84.0).max(0.0);
    let strip = returns(192, 1, 0.01, height);
    let kept = |most_patches, patience_s| {
        patches(&strip, PatchSettings { most_patches, patience_s, ..PatchSettings::default() }).0
    };
    let all = kept(60_000, 2.0);
    assert!(all.len() > 1000, "{}", all.len());
    for (most, patience_s) in [(500, 2.0), (100, 0.02), (10, 0.02)] {
        let few = kept(most, patience_s);
        assert!(few.len() <= most && few.len() + 9 > most, "{} of {most}", few.len());
        assert!(few == all[..few.len()], "{most}");
    }
}

/// Of a cell with many returns, a part is used that covers it.
#[test]
fn dense_cells_use_an_even_part_of_their_returns() {
    let plane = |x: f64, y: f64| 0.3 * x - 0.2 * y;
    let settings = PatchSettings { cell_m: 6.5, ..PatchSettings::default() };
    let (found, _) = patches(&returns(52, 1, 0.01, plane), settings);
    assert_eq!(found.len(), 16);
    for patch in &found {
        // Every fourth of 169.
        assert!((39..=43).contains(&patch.n_returns), "{patch:?}");
        let places = patch.beams.map(|beam| place(52, (beam.time_s / 1e-5).round() as usize));
        for axis in 0..2 {
            let along = places.map(|place| place[axis]);
            let extent =
                along.into_iter().fold(f64::MIN, f64::max) - along.into_iter().fold(f64::MAX, f64::min);
            assert!(extent > 2.5, "{places:?}");
        }
    }
}

/// Cells are completed while the strip is read.
#[test]
fn memory_is_bounded_by_the_cells_in_work() {
    let settings = PatchSettings { patience_s: 0.02, ..PatchSettings::default() };
    let mut maker = PatchMaker::new(0, Horizon::at(PLACE), settings);
    let all = returns(300, 1, 0.01, |_, _| 0.0);
    let mut most_cells = 0;
    for given in &all {
        maker.add(given);
        most_cells = most_cells.max(maker.cells.len());
    }
    assert!(most_cells < 1700, "{most_cells} of 2500 cells");
    assert_eq!(maker.finish().0.len(), 2500);
}

/// Strips that do not know each other have the same cells: those of any horizon on another one would be cut.
#[test]
fn cells_of_tiles_do_not_depend_on_the_strip() {
    let all = returns(192, 1, 0.01, |_, _| 0.0);
    let made = |given: &[PatchReturn]| {
        let mut maker = PatchMaker::on_tiles(PatchSettings { most_patches: 300, ..PatchSettings::default() });
        given.iter().for_each(|given| maker.add(given));
        maker.finish().0
    };
    // The second strip begins 30 m to the north of the first.
    let (first, second) = (made(&all), made(&all[60 * 192..]));
    assert!(first.len() > 200 && second.len() > 200, "{} {}", first.len(), second.len());
    let inside: Vec<&Patch> = first.iter().filter(|patch| patch.beams[0].time_s > 0.13).collect();
    let shared = inside.iter().filter(|patch| second.contains(patch)).count();
    assert!(shared == inside.len() && shared > 100, "{shared} of {}", inside.len());
    let corner_m = tile_horizon((0, 0)).local_m([6_378_137.0, 0.0, 0.0]);
    assert!((19_000.0..20_000.0).contains(&corner_m[0].hypot(corner_m[1])), "{corner_m:?}");
    let tiles: Vec<Tile> = [[1.0, 1.0], [1.0, -1.0], [-1.0, 1.0], [-1.0, -1.0]]
        .map(|[y, z]| Frame::Tiles(Tiles::default()).tile([6_378_137.0, y, z]))
        .to_vec();
    assert_eq!(tiles, [(0, 0), (-1, 0), (0, -1), (-1, -1)]);
}

#[test]
fn quotas_fill_the_limit() {
    assert_eq!(level(&[10, 20, 30], 60), usize::MAX);
    assert_eq!(level(&[10, 20, 30], 50), 20);
    assert_eq!(level(&[10, 20, 30], 30), 10);
    assert_eq!(level(&[1, 1000, 1000], 101), 50);
    assert_eq!(level(&[], 5), usize::MAX);
}

use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::{Rng, SeedableRng};

use super::*;

/// Hills with noise of 3 cm, 1.5 points per m² in a square of 90 m; two strips, the second higher.
fn hills(step_m: f64) -> Vec<CloudPoint> {
    let mut random = Xoshiro256PlusPlus::seed_from_u64(7);
    let mut number = move || (random.next_u64() >> 11) as f64 / (1u64 << 53) as f64;
    (0..12_000)
        .map(|i| {
            let (x, y) = (5000.0 + 90.0 * number(), -45.0 + 90.0 * number());
            let noise = 0.03 * 12f64.sqrt() * (number() - 0.5);
            let strip = (i % 2) as u16;
            let z = height(x, y) + noise + step_m * f64::from(strip);
            CloudPoint { strip, ..CloudPoint::at([x, y, z]) }
        })
        .collect()
}

fn height(x: f64, y: f64) -> f64 {
    3.0 * (x / 15.0).sin() + 0.1 * y
}

fn cells(first_column: i64, north_row: i64, columns: usize, rows: usize) -> CellRange {
    CellRange { first_column, north_row, columns, rows }
}

fn model(points: &[CloudPoint]) -> TerrainModel {
    learn_terrain(&[points.to_vec()], None, PointSds::Total, 50.0)
}

#[test]
fn tiles_and_the_order_of_points_do_not_change_cells() {
    let points = hills(0.0);
    let model = model(&points);
    let options = TerrainOptions { widest_gap_m: 32.0 };
    let whole = terrain_of_tile(&points, cells(2500, 22, 46, 46), 2.0, &model, &options);
    let mut reversed = points.clone();
    reversed.reverse();
    let from_reversed = learn_terrain(&[reversed], None, PointSds::Total, 50.0);
    // Unknown SDs are NaN, which equal nothing.
    assert_eq!(format!("{model:?}"), format!("{from_reversed:?}"));
    for (left, top) in [(0, 0), (23, 0), (0, 23), (23, 23)] {
        let part = cells(2500 + left as i64, 22 - top as i64, 23, 23);
        let low = [part.first_column as f64 * 2.0, (part.north_row - 22) as f64 * 2.0];
        let margin_m = options.margin_m();
        let near: Vec<CloudPoint> = points
            .iter()
            .rev()
            .filter(|p| {
                (0..2).all(|i| (low[i] - margin_m..low[i] + 46.0 + margin_m).contains(&p.position_m[i]))
            })
            .copied()
            .collect();
        assert!(near.len() < points.len());
        let tile = terrain_of_tile(&near, part, 2.0, &model, &options);
        for row in 0..23 {
            for column in 0..23 {
                let (i, j) = (row * 23 + column, (row + top) * 46 + column + left);
                let of = |t: &TerrainTile, i: usize| {
                    [t.height_m[i], t.sd_m[i], t.n_points[i], t.distance_m[i]].map(f32::to_bits)
                };
                assert_eq!(of(&tile, i), of(&whole, j), "{left} {top} {row} {column}");
            }
        }
    }
}

#[test]
fn standard_deviations_grow_into_gaps_and_end_at_the_widest() {
    let mut points = hills(0.0);
    points.retain(|p| (p.position_m[0] - 5045.0).hypot(p.position_m[1]) > 12.0);
    let model = model(&points);
    let cell = |x: i64, widest_gap_m: f64| {
        let tile = terrain_of_tile(&points, cells(x, 0, 1, 1), 1.0, &model, &TerrainOptions { widest_gap_m });
        [tile.height_m[0], tile.sd_m[0], tile.distance_m[0]]
    };
    let [outside, edge, middle] = [5025, 5034, 5045].map(|x| cell(x, 50.0));
    assert!(
        outside[1] < 0.1 && middle[1] > 3.0 * edge[1] && edge[1] > outside[1],
        "{outside:?} {edge:?} {middle:?}"
    );
    assert!(middle[2] > 11.0);
    assert!(cell(5045, 20.0)[0].is_nan() && cell(5025, 20.0)[0].is_finite());
    assert!(cell(5200, 50.0)[0].is_nan(), "outside the points");
}

#[test]
fn the_error_of_strips_is_learnt_from_their_overlap() {
    let without = model(&hills(0.0));
    let with = model(&hills(0.2));
    // Two strips that agree do not prove that they have no errors: what is typical remains.
    assert!((without.strip_sd_m - 0.02 * 2f64.sqrt()).abs() < 0.002, "{without}");
    // Half of the squared difference is the variance of a strip.
    assert!(
        (with.strip_sd_m - (0.2f64.powi(2) / 2.0 + 2.0 * 0.02f64.powi(2)).sqrt()).abs() < 0.005,
        "{with}"
    );
    assert!(with.assumptions.is_empty());
    let mut alone = hills(0.0);
    alone.retain(|p| p.strip == 0);
    let alone = model(&alone);
    assert_eq!((alone.strip_sd_m, &alone.assumptions[..]), (0.05, &[Assumption::StripError][..]));
    // Of SDs of 8 cm, the noise of 3 cm is that of the points, unless they are SDs of this noise only.
    let mut known = hills(0.0);
    known.retain(|p| p.strip == 0);
    known.iter_mut().for_each(|p| p.height_sd_m = 0.08);
    let [total, own] =
        [PointSds::Total, PointSds::Own].map(|sds| learn_terrain(&[known.clone()], None, sds, 50.0));
    assert!((total.strip_sd_m - 0.074).abs() < 0.003 && total.assumptions.is_empty(), "{total}");
    assert_eq!((own.strip_sd_m, &own.assumptions[..]), (0.05, &[Assumption::StripError][..]));
}

#[test]
fn slopes_continue_into_gaps_along_scan_lines() {
    // Scan lines 1 m apart along north, with points every 0.3 m; none from 5040 to 5060 m.
    let surface = |x: f64, y: f64| height(x, y) + 0.5 * (x - 5040.0);
    let points: Vec<CloudPoint> = (0..84 * 40)
        .map(|i| {
            let line = 5000.0 + f64::from(i / 40);
            let (x, y) = (if line > 5040.0 { line + 19.0 } else { line }, 0.3 * f64::from(i % 40 - 20));
            let noise = 0.03 * (f64::from(i * 7 % 11) / 11.0 - 0.5);
            CloudPoint::at([x, y, surface(x, y) + noise])
        })
        .collect();
    let model = model(&points);
    let tile = terrain_of_tile(&points, cells(5041, 1, 2, 4), 1.0, &model, &TerrainOptions::default());
    for (i, (z, sd)) in tile.height_m.iter().zip(&tile.sd_m).enumerate() {
        let (x, y) = (5041.5 + (i % 2) as f64, 1.5 - (i / 2) as f64);
        let error_m = f64::from(*z) - surface(x, y);
        assert!(error_m.abs() < 0.1 && error_m.abs() < 3.0 * f64::from(*sd), "{x} {y}: {error_m} {sd}");
    }
}

#[test]
fn a_plant_among_ground_points_does_not_raise_the_terrain() {
    let mut points = hills(0.0);
    let model = model(&points);
    let at = cells(5040, 0, 1, 1);
    let before = terrain_of_tile(&points, at, 1.0, &model, &TerrainOptions::default());
    points.push(CloudPoint::at([5040.5, 0.5, height(5040.5, 0.5) + 1.5]));
    let after = terrain_of_tile(&points, at, 1.0, &model, &TerrainOptions::default());
    assert!((after.height_m[0] - before.height_m[0]).abs() < 0.02, "{before:?} {after:?}");
    assert_eq!(after.n_points[0], before.n_points[0] + 1.0);
}

#[test]
fn few_points_have_assumed_standard_deviations() {
    let none = learn_terrain(&[], None, PointSds::Total, 50.0);
    assert_eq!(none.assumptions, [Assumption::Roughness, Assumption::StripError, Assumption::Gaps]);
    let empty = terrain_of_tile(&[], cells(0, 0, 2, 2), 1.0, &none, &TerrainOptions::default());
    assert!(empty.height_m.iter().all(|z| z.is_nan()) && empty.n_points == [0.0; 4]);
    let one = [CloudPoint::at([0.5, 0.5, 7.0])];
    let tile = terrain_of_tile(&one, cells(0, 0, 2, 1), 1.0, &none, &TerrainOptions::default());
    assert_eq!((tile.height_m[0], tile.n_points[0]), (7.0, 1.0));
    assert!(tile.sd_m[0] > 0.05 && tile.height_m[1].is_nan());
    let on_a_line: Vec<_> = (0..50).map(|i| CloudPoint::at([f64::from(i), 0.5, 7.0])).collect();
    let tile = terrain_of_tile(&on_a_line, cells(0, 0, 50, 1), 1.0, &none, &TerrainOptions::default());
    assert!(tile.height_m.iter().all(|z| (z - 7.0).abs() < 1e-3) && tile.sd_m.iter().all(|sd| *sd > 0.04));
    let same = [one[0], one[0], one[0]];
    let tile = terrain_of_tile(&same, cells(0, 0, 1, 1), 1.0, &none, &TerrainOptions::default());
    assert_eq!(tile.height_m[0], 7.0);
}

//! Terrain model of a text file of ground points: `terrain_cells POINTS CELL_M OUT [STRIP_SD_M]`.
//!
//! Lines of POINTS hold east, north, height, SD of the height and strip (m; `nan`: unknown SD). Lines of OUT
//! hold east, north (centre of the cell), height, SD, number of points and distance to the nearest point.
//! The tests of accuracy (`tests/python/check_terrain.py`) run it.

#![allow(clippy::print_stdout)]

use std::error::Error;
use std::fmt::Write;
use std::time::Instant;

use wavex_ground::point::CloudPoint;
use wavex_ground::terrain::{CellRange, PointSds, TerrainOptions, learn_terrain, terrain_of_tile};

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [points, cell_m, out, rest @ ..] = &arguments[..] else {
        return Err("usage: terrain_cells POINTS CELL_M OUT [STRIP_SD_M]".into());
    };
    let cell_m: f64 = cell_m.parse()?;
    let strip_sd_m = rest.first().map(|sd| sd.parse()).transpose()?;
    let points = std::fs::read_to_string(points)?.lines().map(point).collect::<Result<Vec<_>, _>>()?;
    let options = TerrainOptions::default();
    let start = Instant::now();
    let samples = [points];
    let model = learn_terrain(&samples, strip_sd_m, PointSds::Total, options.widest_gap_m);
    let [points] = samples;
    println!("{model}, learnt in {:.1} s", start.elapsed().as_secs_f64());
    let start = Instant::now();
    let column = |p: &CloudPoint| (p.position_m[0] / cell_m).floor() as i64;
    let row = |p: &CloudPoint| (p.position_m[1] / cell_m).floor() as i64;
    let first_column = points.iter().map(column).min().unwrap_or(0);
    let north_row = points.iter().map(row).max().unwrap_or(0);
    let columns = points.iter().map(column).max().map_or(0, |last| (last - first_column + 1) as usize);
    let rows = points.iter().map(row).min().map_or(0, |south| (north_row - south + 1) as usize);
    let cells = CellRange { first_column, north_row, columns, rows };
    let tile = terrain_of_tile(&points, cells, cell_m, &model, &options);
    println!(
        "{} cells from {} points in {:.1} s",
        columns * rows,
        points.len(),
        start.elapsed().as_secs_f64()
    );
    let mut text = String::new();
    for i in (0..columns * rows).filter(|i| tile.height_m[*i].is_finite()) {
        let x = ((first_column + (i % columns) as i64) as f64 + 0.5) * cell_m;
        let y = ((north_row - (i / columns) as i64) as f64 + 0.5) * cell_m;
        let [z, sd, n, d] =
            [&tile.height_m, &tile.sd_m, &tile.n_points, &tile.distance_m].map(|band| band[i]);
        writeln!(text, "{x} {y} {z} {sd} {n} {d}")?;
    }
    std::fs::write(out, text)?;
    Ok(())
}

fn point(line: &str) -> Result<CloudPoint, Box<dyn Error>> {
    let numbers = line.split_whitespace().map(str::parse).collect::<Result<Vec<f64>, _>>()?;
    let [x, y, z, sd, strip] = numbers[..] else {
        return Err(format!("five numbers expected: {line}").into());
    };
    Ok(CloudPoint { height_sd_m: sd as f32, strip: strip as u16, ..CloudPoint::at([x, y, z]) })
}

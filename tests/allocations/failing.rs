//! Readers without memory: a large request that fails, because a file asks for much, is an error.
//!
//! Not covered: buffers of libraries (Arrow's arrays and its decompressors, the crates `tiff` and `laz`), and
//! trajectories, whose records are collected one by one. They end the process. Limits bound their sizes.

use std::path::Path;

use wavex_formats::container::{Compression, ContainerHeader, ContainerReader, TimeScale, channel};
use wavex_formats::las::{Point, Reader};
use wavex_formats::{Error, Result, geoid, terrain::Terrain};
use wavex_testkit::container::{Row, compressed, nadir_shot};
use wavex_testkit::las::Las;

use super::{LARGE, LARGE_UNTIL_FAILURE, RUNNING};

/// Fails the first `most` large requests of a reader one by one; each must be its error.
#[track_caller]
fn each_failure_is_an_error(name: &str, most: usize, read: impl Fn() -> Result<()>) {
    let _running = RUNNING.lock();
    read().expect("the file is valid");
    let mut failed = 0;
    while failed < most {
        LARGE_UNTIL_FAILURE.set(failed + 1);
        let done = read();
        let has_failed = LARGE_UNTIL_FAILURE.replace(0) == 0;
        if !has_failed {
            assert!(done.is_ok(), "{name}: {done:?}");
            break;
        }
        failed += 1;
        let error = done.expect_err(name);
        let is_memory =
            matches!(&error, Error::Io { source, .. } if source.kind() == std::io::ErrorKind::OutOfMemory);
        assert!(is_memory, "{name}, request {failed}: {error}");
    }
    println!("{name}: {failed} requests of {LARGE} bytes or more failed one by one");
    assert!(failed > 0, "{name}: no large request");
}

/// A file in a new folder.
fn file(name: &str, bytes: &[u8]) -> (tempfile::TempDir, std::path::PathBuf) {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join(name);
    std::fs::write(&path, bytes).expect("a file");
    (folder, path)
}

#[test]
fn an_uncompressed_container() {
    let header = ContainerHeader { time_scale: TimeScale::Week, ..ContainerHeader::new(1.0, 299_707_502.0) };
    let row = |shot: u64| Row {
        shot: nadir_shot(shot, 1_000_000 * shot as i64),
        blocks: vec![(channel::LOW_POWER, 0.0, vec![3; 50_000])],
    };
    let bytes = compressed(&header, &[(0..50).map(row).collect()], Compression::None);
    let (_folder, path) = file("a.arrow", &bytes);
    let lines = |mut reader: ContainerReader| {
        while reader.next_line()?.is_some() {}
        Ok(())
    };
    each_failure_is_an_error("container", usize::MAX, || lines(ContainerReader::open(&path)?));
    each_failure_is_an_error("container as stream", usize::MAX, || {
        let from = std::fs::File::open(&path).map_err(Error::io(&path, "open"))?;
        lines(ContainerReader::from_stream(&path, Box::new(from))?)
    });
}

#[test]
fn a_terrain_model() {
    let (columns, rows) = (1000, 1000);
    let header = format!("ncols {columns}\nnrows {rows}\nxllcorner 0\nyllcorner 0\ncellsize 1\n");
    let (_folder, path) = file("a.asc", (header + &"1 ".repeat(columns * rows)).as_bytes());
    each_failure_is_an_error("terrain", usize::MAX, || Terrain::open(&path).map(drop));
}

#[test]
fn a_geoid() {
    let (columns, rows) = (1000i32, 1000i32);
    let mut bytes: Vec<u8> =
        [40.0f64, 0.0, 0.01, 0.01].iter().flat_map(|value| value.to_be_bytes()).collect();
    bytes.extend([rows, columns].iter().flat_map(|value| value.to_be_bytes()));
    bytes.resize(bytes.len() + 4 * (columns * rows) as usize, 0);
    let (folder, _) = file("a.gtx", &bytes);
    each_failure_is_an_error("geoid", usize::MAX, || geoid::find(folder.path(), "a").map(drop));
}

#[test]
fn points_in_one_large_chunk() {
    let las = Las::new(50_000);
    let (_folder, path) = file("a.laz", &noisy(&las));
    std::fs::write(path.with_extension("wdp"), &las.packets).expect("a file");
    // The decoder of the crate `laz` copies layers of a chunk.
    each_failure_is_an_error("chunk of LAZ", 1, || points(&path));
}

/// The recording as LAZ whose points compress badly.
fn noisy(las: &Las) -> Vec<u8> {
    let (mut las, mut random) =
        (Las { vlrs: las.vlrs.clone(), points: las.points.clone(), packets: Vec::new() }, 12345u64);
    for point in &mut las.points {
        // Time, return location and direction of the waveform.
        let (start, end) = point.split_at_mut(43);
        for byte in start[22..30].iter_mut().chain(end) {
            // Constants of Knuth's MMIX generator.
            random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            *byte = (random >> 40) as u8;
        }
    }
    las.laz()
}

fn points(path: &Path) -> Result<()> {
    let (mut reader, mut point) = (Reader::open(path)?, Point::default());
    while reader.next_point(&mut point)? {}
    Ok(())
}

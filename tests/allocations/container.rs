//! A container with wrong lengths causes no larger allocation than a valid one of its size could
//! need.

use std::io::Cursor;
use std::path::Path;
use std::sync::atomic::Ordering;

use wavex_formats::Result;
use wavex_formats::container::{
    Compression, ContainerBlock, ContainerHeader, ContainerReader, ContainerShot, ContainerWriter,
    LineBuilder, TimeScale, channel,
};

use super::{LARGEST, RUNNING};

/// Largest single request that a container of a few KB may cause.
///
/// The read-ahead of a stream (4 MiB), or the largest block of an LZ4 frame (8 MiB) with its
/// window.
const MOST_BYTES: usize = 16 << 20;

fn container(compression: Compression) -> Result<Vec<u8>> {
    let header = ContainerHeader { time_scale: TimeScale::Week, ..ContainerHeader::new(1.0, 299_707_502.0) };
    let mut line = LineBuilder::new();
    line.shot(&ContainerShot {
        shot: 0,
        line: 0,
        gps_time_s: None,
        clock_ps: 0,
        origin_m: [0.0; 3],
        direction: [0.0, 0.0, 1.0],
        facet: 0,
        flags: 0,
        mta_zone: None,
        scan_angle_deg: None,
        frame_scale: None,
    });
    line.block(&ContainerBlock {
        channel: channel::LOW_POWER,
        start_ns: 0.0,
        interval_ns: None,
        zone: None,
        gain: None,
        samples: &[3; 200],
    });
    let mut writer = ContainerWriter::file(Vec::new(), Path::new("made.arrow"), &header, compression)?;
    writer.write(line)?;
    writer.finish()
}

fn read(path: &Path) -> usize {
    let Ok(mut reader) = ContainerReader::open(path) else { return 0 };
    std::iter::from_fn(|| reader.next_line().ok().flatten()).count()
}

fn read_stream(bytes: Vec<u8>) -> usize {
    let from = Box::new(Cursor::new(bytes));
    let Ok(mut reader) = ContainerReader::from_stream(Path::new("-"), from) else { return 0 };
    std::iter::from_fn(|| reader.next_line().ok().flatten()).count()
}

#[test]
fn no_length_that_lies_takes_memory() {
    let _running = RUNNING.lock();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("made.arrow");
    for compression in [Compression::None, Compression::Lz4, Compression::Zstd] {
        let whole = container(compression).unwrap();
        std::fs::write(&path, &whole).unwrap();
        assert_eq!((read(&path), read_stream(whole.clone())), (1, 1));
        LARGEST.store(0, Ordering::Relaxed);
        for at in (0..whole.len() - 4).step_by(4) {
            for lie in [i32::MAX, 0x0fff_fff8] {
                let mut bytes = whole.clone();
                bytes[at..at + 4].copy_from_slice(&lie.to_le_bytes());
                // A file reads the footer and the data it points to; all else is read as in a
                // stream.
                if at % 16 == 0 || at > whole.len() - 200 {
                    std::fs::write(&path, &bytes).unwrap();
                    assert!(read(&path) <= 1);
                }
                assert!(read_stream(bytes) <= 1);
                let largest = LARGEST.load(Ordering::Relaxed);
                assert!(largest < MOST_BYTES, "{compression:?}, {lie} at byte {at}: {largest} bytes");
            }
        }
    }
}

//! A container with wrong lengths causes no larger allocation than a valid one of its size could
//! need.

use std::io::Cursor;
use std::path::Path;
use std::sync::atomic::Ordering;

use wavex_formats::container::{Compression, ContainerHeader, ContainerReader, TimeScale, channel};
use wavex_testkit::container::{Row, compressed, nadir_shot, of_fractions};

use super::{LARGEST, RUNNING};

/// Largest single request that a container of a few KB may cause.
///
/// The read-ahead of a stream (4 MiB), or the largest block of an LZ4 frame (8 MiB) with its
/// window.
const MOST_BYTES: usize = 16 << 20;

fn made(compression: Compression) -> Vec<u8> {
    let header = ContainerHeader { time_scale: TimeScale::Week, ..ContainerHeader::new(1.0, 299_707_502.0) };
    let row = Row { shot: nadir_shot(0, 0), blocks: vec![(channel::LOW_POWER, 0.0, vec![3; 200])] };
    compressed(&header, &[vec![row]], compression)
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
    let whole = [Compression::None, Compression::Lz4, Compression::Zstd].map(made);
    for (kind, whole) in
        ["uncompressed", "LZ4", "ZSTD", "fractions"].iter().zip(whole.into_iter().chain([of_fractions()]))
    {
        std::fs::write(&path, &whole).unwrap();
        let lines = read(&path);
        assert!(lines > 0 && read_stream(whole.clone()) == lines, "{kind}");
        LARGEST.store(0, Ordering::Relaxed);
        for at in (0..whole.len() - 4).step_by(4) {
            for lie in [i32::MAX, 0x0fff_fff8] {
                let mut bytes = whole.clone();
                bytes[at..at + 4].copy_from_slice(&lie.to_le_bytes());
                // A file reads the footer and the data it points to; all else is read as in a
                // stream.
                if at % 16 == 0 || at > whole.len() - 200 {
                    std::fs::write(&path, &bytes).unwrap();
                    assert!(read(&path) <= lines);
                }
                assert!(read_stream(bytes) <= lines);
                let largest = LARGEST.load(Ordering::Relaxed);
                assert!(largest < MOST_BYTES, "{kind}, {lie} at byte {at}: {largest} bytes");
            }
        }
    }
}

//! Damaged files: an error or values, never a panic, and no large allocation.
//!
//! Cargo runs the tests of a program side by side, and they share the allocator: there is only one.
#![allow(clippy::unwrap_used, reason = "a test fails by it")]

use std::alloc::{GlobalAlloc, Layout, System};
use std::fs;
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};

use wavex_hdf5::{Granule, Shot, SpdPulse, SpdReader};

/// The system allocator with the size of its largest request.
struct Largest;

static LARGEST: AtomicUsize = AtomicUsize::new(0);

// SAFETY: every request is forwarded unchanged to the system allocator.
unsafe impl GlobalAlloc for Largest {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        LARGEST.fetch_max(layout.size(), Ordering::Relaxed);
        // SAFETY: the caller upholds the contract of `System`, which is the same.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: the caller upholds the contract of `System`, which is the same.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Largest = Largest;

/// Largest request for a file of 40 kB: deflate makes data at most 1032 times smaller, and there are 12 shots.
const MOST_BYTES: usize = 8 << 20;

/// Shots of a beam that are read; damage can change their number to millions.
const MOST_SHOTS: usize = 20;

/// Reads a file; returns whether all was read.
fn read(path: &Path) -> bool {
    let Ok(granule) = Granule::open(path) else { return read_pulses(path) };
    let (mut sound, mut shot) = (true, Shot::default());
    for beam in granule.beams().iter().filter(|beam| beam.shots > 0) {
        let Ok(mut reader) = granule.beam(&beam.name) else { return false };
        for index in 0..reader.len().min(MOST_SHOTS) {
            sound &= reader.shot(index, &mut shot).is_ok();
        }
    }
    sound
}

/// Reads the pulses of an SPD file; returns whether all were read.
fn read_pulses(path: &Path) -> bool {
    let Ok(mut reader) = SpdReader::open(path) else { return false };
    let (mut sound, mut pulse) = (true, SpdPulse::default());
    for index in 0..reader.len().min(MOST_SHOTS as u64) {
        sound &= reader.pulse(index, &mut pulse).is_ok();
    }
    sound
}

#[test]
fn damaged_files_are_errors_or_values() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("damaged.h5");
    let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data");
    // The steps of a generator that visits all values: reproducible, and different at each file.
    let mut state = 0x2545_f491_4f6c_dd1d_u64;
    let mut random = |below: usize| {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        state as usize % below
    };
    let mut failed = 0;
    for name in [
        "gedi_product.h5",
        "gedi_latest.h5",
        "gedi_extensible.h5",
        "gedi_v110.h5",
        "gedi_implicit.h5",
        "gedi_compact_fill.h5",
        "gedi_shuffle_checksum.h5",
        "lvis_432.h5",
        "lvis_1216.h5",
        "many_links.h5",
        "spd_3.spd",
        "spd_3_latest.spd",
        "spd_4.spd",
        "spd_4_latest.spd",
    ] {
        let sound = fs::read(data.join(name)).unwrap();
        fs::write(&path, &sound).unwrap();
        assert!(read(&path), "{name}");
        for part in 0..24 {
            fs::write(&path, &sound[..sound.len() * part / 24]).unwrap();
            assert!(!read(&path), "{name} cut to {part} of 24");
        }
        for round in 0..150 {
            let mut bytes = sound.clone();
            for _ in 0..1 + round % 8 {
                let at = random(bytes.len());
                bytes[at] = [random(256) as u8, 0xff, 0, bytes[at] ^ 1 << random(8)][random(4)];
            }
            // In the second half, the first kilobytes: superblock and groups.
            if round > 75 {
                let at = random(bytes.len().min(4096));
                bytes[at] = random(256) as u8;
            }
            fs::write(&path, &bytes).unwrap();
            failed += usize::from(!read(&path));
        }
    }
    assert!(failed > 100, "only {failed} of 2100 damaged files are noticed");
    let largest = LARGEST.load(Ordering::Relaxed);
    assert!(largest <= MOST_BYTES, "a request for {largest} bytes");
}

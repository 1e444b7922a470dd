//! A longer file needs no more memory.
#![cfg(target_os = "linux")]

use super::flights::{self, fly};
use wavex_testkit::TestFolder;

/// Peak memory of a run on this recording, kB.
fn peak_kb(recording: &[u8]) -> u64 {
    let place = TestFolder::with(&[("a.arrow", recording)]);
    let stages = "[[stage]]\ntype = 'read_arrow'\npath = 'a.arrow'\n[[stage]]\ntype = 'resolve_mta'\n\
                  [[stage]]\ntype = 'calibrate'\nwaveforms = 2000\nresponse = 'gaussian'\n\
                  [[stage]]\ntype = 'decompose'\nmode = 'fastest'\n[[stage]]\ntype = 'write_lstat'\n";
    let (outcome, peak_kb) = flights::peak_kb(place.command(stages).args(["--set", "job.memory_mb=64"]));
    assert_eq!(outcome.code, Some(0), "{}", outcome.err);
    assert!(place.text("out/a_lstat.txt").lines().count() > 400);
    peak_kb
}

#[test]
fn ten_times_the_file_takes_no_more_memory() {
    let fly = |lines: u32| {
        fly(&format!(
            "lines = {lines}\nshots_per_line = 60\npulse_rate_hz = 400000\nmodulation_ns = 15\nflying_height_m = 1500\n\
             as_recorded = true"
        ))
        .recording
    };
    let (short, long) = (fly(420), fly(4200));
    assert!(long.len() > 9 * short.len());
    let (mut short_kb, mut long_kb) = (peak_kb(&short), peak_kb(&long));
    // The allocator's arenas of the pool's threads take 8 MB more in some runs, of either length.
    for _ in 0..2 {
        if long_kb as f64 > 1.1 * short_kb as f64 {
            (short_kb, long_kb) = (short_kb.max(peak_kb(&short)), long_kb.min(peak_kb(&long)));
        }
    }
    println!("{short_kb} kB for {} bytes, {long_kb} kB for {}", short.len(), long.len());
    assert!(long_kb as f64 <= 1.1 * short_kb as f64, "{short_kb} kB grew to {long_kb} kB");
}

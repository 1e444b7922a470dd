//! A recording read through the interface equals its container.

use std::thread;
use wavex::registry::STAGES;

use wavex::engine::{self, Options};
use wavex::job::{Job, Override};

use wavex_testkit::container::container;
use wavex_testkit::sdf::{NAME, copy, flight, flight_container, header, place, read, stand_in};
use wavex_testkit::{TestFolder, notes, rejected};

/// Result of `read_arrow` for the same file.
fn by_read_arrow(place: &TestFolder) -> Vec<u8> {
    std::fs::copy(place.path(NAME), place.path("250506_100000.arrow")).unwrap();
    let copy = "[[stage]]\ntype = 'write_arrow'\npath = 'arrow.arrow'\ncompression = 'none'\n";
    place.succeeds("read_arrow", "250506_100000.arrow", copy);
    std::fs::read(place.path("out/arrow.arrow")).unwrap()
}

#[test]
fn a_recording_comes_out_as_read_arrow_gives_it_to_the_byte() {
    let place = place(&flight_container(), "");
    let (report, lines) = read(&place, "");
    assert_eq!(lines, flight());
    let several = |row: &wavex_testkit::container::Row| row.blocks.len() > 3;
    assert!(lines.iter().flatten().any(several), "several blocks of a channel are part of it");
    assert_eq!(rejected(&report).len(), 0, "{report}");
    assert_eq!(notes(&report), Vec::<String>::new());
    assert_eq!(report["format"], "RIEGL SDF (RiWAVELib 1.7)");
    let through_the_interface = std::fs::read(place.path("out/sdf.arrow")).unwrap();
    assert!(through_the_interface == by_read_arrow(&place));
}

#[test]
fn blocks_may_lie_farther_apart_than_they_are_long() {
    for stride in [40, 57] {
        let place = place(&flight_container(), &format!("stride {stride}"));
        assert_eq!(read(&place, "").1, flight(), "{stride}");
    }
}

#[test]
fn line_statistics_are_the_same() {
    let place = place(&flight_container(), "");
    let statistics = "[[stage]]\ntype = 'write_lstat'\npath = 'sdf.txt'\n";
    assert_eq!(place.run(&format!("{}{statistics}", copy(""))).code, Some(0));
    let sdf = place.text("out/sdf.txt");
    std::fs::copy(place.path(NAME), place.path("a.arrow")).unwrap();
    place.succeeds("read_arrow", "a.arrow", &statistics.replace("sdf.txt", "arrow.txt"));
    assert_eq!(sdf, place.text("out/arrow.txt"));
}

#[test]
fn a_library_that_serves_one_caller_at_a_time_serves_two_runs() {
    let place = place(&container(&header(), &flight()[..2]), "slow_us 20");
    let run = |name: &'static str| {
        let text = copy("").replace("sdf.arrow", name);
        let folder = place.path("");
        move || {
            let library = Override::new(format!("read_sdf.library='{}'", stand_in().display()));
            let job = Job::parse(STAGES, "job", &text, &[library]).unwrap();
            let options = Options::of_job(&job, &folder, folder.join("out"));
            engine::run(&job, &options).map(|report| report.inputs[0].totals["nw"]).map_err(|e| e.to_string())
        }
    };
    let threads = ["one.arrow", "two.arrow"].map(|name| thread::spawn(run(name)));
    let waveforms = flight()[..2].iter().flatten().filter(|row| row.blocks.len() > 1).count() as u64;
    for thread in threads {
        assert_eq!(thread.join().unwrap(), Ok(waveforms));
    }
    let files = ["one.arrow", "two.arrow"].map(|name| std::fs::read(place.path("out").join(name)).unwrap());
    assert!(files[0] == files[1]);
}

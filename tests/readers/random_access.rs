//! Scan lines read in any order equal those of a run.

use std::fs;
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, UNIX_EPOCH};
use wavex::registry::STAGES;

use wavex::job::{Job, Override};
use wavex::recording::{LineIndex, OpenError, Recording, index_path};
use wavex::scan_line::{Content, ScanLine};
use wavex::stage::{Context, Plan, RunContext};
use wavex_testkit::las::Las;
use wavex_testkit::{Outcome, TestFolder, sdf};

/// Shots and blocks of a line as text, in which NaN equals NaN.
fn text(line: &ScanLine) -> String {
    let Content::Shots(blocks) = &line.content else { panic!("readers make shots") };
    format!("{} {:?} {blocks:?}", line.line, line.emissions)
}

/// All lines as a run reads them.
fn lines_of_run(path: &Path, reader: &str, set: &[String]) -> Vec<String> {
    let text_of_job = format!("[[stage]]\ntype = '{reader}'\npath = '{}'\n", path.display());
    let set: Vec<Override> = set.iter().map(Override::new).collect();
    let job = Job::parse(STAGES, "job", &text_of_job, &set).unwrap();
    let Plan::Source(source) = &job.stages[0].planned.plan else { panic!("a reader") };
    let mut source = source.make(&RunContext::alone(path)).unwrap();
    let mut cx = Context::default();
    std::iter::from_fn(|| source.next(&mut cx).unwrap()).map(|line| text(&line)).collect()
}

/// Asserts that random access gives the lines of a run; returns their number.
#[track_caller]
fn assert_same_lines(path: &Path, reader: &str, set: &[String]) -> usize {
    let expected = lines_of_run(path, reader, set);
    let mut recording = Recording::open(STAGES, path, set).unwrap();
    let index = recording.index(&mut |_| Ok(())).unwrap();
    assert_eq!(index.lines().len(), expected.len(), "{}", path.display());
    let mut order: Vec<usize> = (0..expected.len()).rev().collect();
    // Backwards, then every third line forwards.
    order.extend((0..expected.len()).step_by(3));
    for number in order {
        let line = recording.line(number).unwrap().unwrap();
        assert_eq!(text(&line), expected[number], "line {number} of {}", path.display());
        let last = line.emissions[line.emissions.len() - 1];
        let of_shot = recording.line_of_shot(last.shot).unwrap().unwrap();
        assert!(of_shot.emissions.iter().any(|emission| emission.shot == last.shot));
        let (nearest, time_s) = recording.nearest_shot(last.gps_time_s).unwrap().unwrap();
        assert_eq!(time_s, last.gps_time_s);
        let time_of =
            |line: &ScanLine, shot| line.emissions.iter().find(|e| e.shot == shot).unwrap().gps_time_s;
        let line = recording.line_of_shot(nearest).unwrap().unwrap();
        assert_eq!(time_of(&line, nearest), last.gps_time_s);
    }
    assert!(recording.line(expected.len()).unwrap().is_none());
    assert!(recording.line_of_shot(u64::MAX).unwrap().is_none());
    expected.len()
}

#[test]
fn containers_and_las_are_read_in_any_order() {
    let place = TestFolder::new();
    let job = "[[stage]]\ntype = 'simulate'\nstem = 'flight'\nlines = 9\nshots_per_line = 1300\n\
               [[stage]]\ntype = 'write_arrow'\npath = 'plain.arrow'\ncompression = 'none'\n\
               [[stage]]\ntype = 'write_arrow'\npath = 'packed.arrow'\ncompression = 'zstd'\n\
               [[stage]]\ntype = 'calibrate'\n[[stage]]\ntype = 'decompose'\nmode = 'fastest'\n\
               [[stage]]\ntype = 'georeference'\n\
               [[stage]]\ntype = 'write_las'\npath = 'points.las'\nwave_packets = 'internal'\n\
               [[stage]]\ntype = 'write_las'\npath = 'points.laz'\nwave_packets = 'external'\n";
    assert_eq!(place.run(job), Outcome::success());
    for (file, reader) in [
        ("plain.arrow", "read_arrow"),
        ("packed.arrow", "read_arrow"),
        ("points.las", "read_las"),
        ("points.laz", "read_las"),
    ] {
        assert!(assert_same_lines(&place.path(&format!("out/{file}")), reader, &[]) >= 3, "{file}");
    }
    // Small recordings are read in no time: their folders stay as they are.
    assert!(
        fs::read_dir(place.path("out"))
            .unwrap()
            .all(|entry| { entry.unwrap().path().extension().is_none_or(|extension| extension != "wvxi") })
    );
}

#[test]
fn a_waveform_outside_its_file_is_no_shot_of_the_index() {
    let las = Las::new(400).change(10, 31, &u64::MAX.to_le_bytes());
    let place = TestFolder::with(&[("a.las", &las.las()), ("a.wdp", &las.packets)]);
    let path = place.path("a.las");
    assert!(assert_same_lines(&path, "read_las", &[]) > 0);
    let index = Recording::open(STAGES, &path, &[]).unwrap().index(&mut |_| Ok(())).unwrap();
    assert_eq!(index.shots(), 399);
}

/// Index of a recording, and whether it was made rather than read.
fn index_of(path: &Path, set: &[String]) -> (Arc<LineIndex>, bool) {
    let mut is_made = false;
    let mut watch = |_| {
        is_made = true;
        Ok(())
    };
    let index = Recording::open(STAGES, path, set).unwrap().index(&mut watch).unwrap();
    (index, is_made)
}

#[test]
fn the_index_of_a_large_recording_is_kept_while_it_fits() {
    let las = Las::new(400);
    let place = TestFolder::with(&[("a.las", &las.las()), ("a.wdp", &las.packets)]);
    let path = place.path("a.las");
    // A hole after the points makes the file large, but takes no space.
    let file = fs::File::options().write(true).open(&path).unwrap();
    file.set_len(64 << 20).unwrap();
    let (first, is_made) = index_of(&path, &[]);
    let kept = index_path(&path);
    assert!(is_made && first.shots() == 400 && kept.ends_with("a.las.wvxi") && kept.is_file());
    assert_eq!(index_of(&path, &[]), (Arc::clone(&first), false));
    assert!(assert_same_lines(&path, "read_las", &[]) > 0, "lines are those of a run");
    // Other keys may mean other shots.
    let set = ["read_las.odd_sample_shift = 0.1".to_owned()];
    assert_eq!(
        [index_of(&path, &set).1, index_of(&path, &set).1, index_of(&path, &[]).1],
        [true, false, true]
    );
    fs::write(&kept, b"ARROW1 and nothing more").unwrap();
    assert_eq!(index_of(&path, &[]), (Arc::clone(&first), true), "a damaged index is replaced");
    file.set_modified(UNIX_EPOCH + Duration::from_secs(1)).unwrap();
    assert_eq!([index_of(&path, &[]).1, index_of(&path, &[]).1], [true, false], "the recording has changed");
    // An index that cannot be written is made by each program.
    fs::remove_file(&kept).unwrap();
    fs::create_dir(&kept).unwrap();
    assert_eq!([index_of(&path, &[]).1, index_of(&path, &[]).1], [true, true]);
}

#[test]
fn sdf_is_read_in_any_order() {
    let place = sdf::place(&sdf::flight_container(), "");
    let set = [format!("read_sdf.library = '{}'", sdf::stand_in().display())];
    assert!(assert_same_lines(&place.path(sdf::NAME), "read_sdf", &set) > 1);
}

#[test]
fn real_recordings_are_read_in_any_order() {
    let Some(folder) = std::env::var_os("WAVEX_DATA").map(std::path::PathBuf::from) else {
        println!("skipped: real recordings, because WAVEX_DATA is not set");
        return;
    };
    for name in ["riegl_example3", "optech_example1", "geolas_example1", "lvis_example1"] {
        assert_same_lines(&folder.join(format!("pulsewaves/{name}.pls")), "read_pulsewaves", &[]);
    }
    assert_same_lines(&folder.join("riegl_q680i_dev/riegl_q680i_dev.las"), "read_las", &[]);
}

#[test]
fn a_stream_and_an_unknown_format_are_refused() {
    let place = TestFolder::with(&[("notes.txt", b"")]);
    let job = "[[stage]]\ntype = 'simulate'\nlines = 2\nshots_per_line = 300\n\
               [[stage]]\ntype = 'write_arrow'\npath = '-'\n";
    let stream = place.command(job).output().unwrap().stdout;
    place.write("stream.arrow", &stream);
    let mut recording = Recording::open(STAGES, &place.path("stream.arrow"), &[]).unwrap();
    let error = recording.line(0).err().unwrap().to_string();
    let remedy = "use a container in the file format of Arrow, or a reader without `time_s`";
    let path = place.path("stream.arrow");
    assert_eq!(error, format!("{}: scan lines cannot be read in any order; {remedy}", path.display()));
    assert!(matches!(Recording::open(STAGES, &place.path("notes.txt"), &[]), Err(OpenError::Format(_))));
}

#[test]
fn a_recording_has_its_path_and_metadata() {
    let place = TestFolder::new();
    let job = "[[stage]]\ntype = 'simulate'\nstem = 'flight'\nlines = 2\nshots_per_line = 300\n\
               [[stage]]\ntype = 'write_arrow'\n";
    assert_eq!(place.run(job), Outcome::success());
    let path = place.path("out/flight.arrow");
    let mut recording = Recording::open(STAGES, &path, &[]).unwrap();
    assert_eq!(recording.path(), path);
    assert_eq!(recording.input().sampling_interval_ns, 1.0);
    assert!(recording.line(2).unwrap().is_none(), "past the end");
    assert!(recording.line_of_shot(600).unwrap().is_none());
    let none = Recording::open(STAGES, &path, &["read_arrow.time_s=[1.0, 2.0]".to_owned()]).err().unwrap();
    let problem = format!("{} has no shots; choose another recording", path.display());
    assert_eq!(none.to_string(), problem);
    let wrong = Recording::open(STAGES, &path, &["read_arrow.colour=1".to_owned()]).err().unwrap();
    assert!(matches!(wrong, OpenError::Keys(_)), "{wrong}");
}

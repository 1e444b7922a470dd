//! Damaged LAS and LAZ.

use serde_json::json;

use wavex_testkit::las::{HEADER, Las, descriptor};
use wavex_testkit::shots::{SAMPLES, time_s};
use wavex_testkit::{TO_TABLE, TestFolder, notes, outcome, rejected};

/// Size of a point written by `write_las`, bytes: format 6 and the extra attributes.
const WRITTEN_POINT: usize = 30 + 44;

const CUT: &str = "the file is cut off: copy it again from its source";
const LIES: &str = "the header is wrong or the file is cut off: copy it again from its source";
const DAMAGED: &str = "the file is cut off or damaged: copy it again from its source";

/// A folder with a recording whose points are modified.
fn place(las: &Las, change: impl Fn(&mut Vec<u8>)) -> TestFolder {
    let mut points = las.las();
    change(&mut points);
    TestFolder::with(&[("a.las", &points), ("a.wdp", &las.packets)])
}

/// Asserts that reading a file fails with a message that names a file.
#[track_caller]
fn refused(place: &TestFolder, input: &str, message: &str) {
    place.fails("read_las", input, &format!("stage read_las: ./{message}"));
}

/// Asserts that a recording of three pulses with replaced bytes is refused.
#[track_caller]
fn refused_with(at: usize, bytes: &[u8], message: &str) {
    let place = place(&Las::new(3), |las| las[at..at + bytes.len()].copy_from_slice(bytes));
    refused(&place, "a.las", &format!("a.las: {message}"));
}

#[test]
fn missing_waveforms() {
    let place = TestFolder::with(&[("a.las", &Las::new(3).las())]);
    let message = "a.las: its waveforms are missing: neither inside the file nor in `a.wdp` next \
                   to it; copy `a.wdp` into the same folder, or export the file with its waveforms \
                   inside";
    refused(&place, "a.las", message);
}

#[test]
fn points_that_were_cut_off() {
    let las = Las::new(3);
    for (cut, problem) in [
        (
            las.offset_of(3) - 1,
            "byte 247: number of point records: the header declares 3 points of 59 bytes, but only \
             2 fit into the file",
        ),
        (
            las.offset_of(0),
            "byte 247: number of point records: the header declares 3 points of 59 bytes, but only \
             0 fit into the file",
        ),
        (HEADER, "byte 96: offset to point data: 455 is beyond the end of the file (375 bytes)"),
        (100, "byte 96: offset to point data: 455 is beyond the end of the file (100 bytes)"),
        (94, "byte 94: header size: 2 bytes needed, 0 left"),
    ] {
        refused(&place(&las, |bytes| bytes.truncate(cut)), "a.las", &format!("a.las: {problem}; {CUT}"));
    }
}

#[test]
fn waveforms_that_were_cut_off() {
    let las = Las::new(3);
    let end = las.packets.len();
    for (cut, message) in [
        (0, "the file is empty; copy it again from its source".to_string()),
        (
            59,
            "byte 0: header: this is not a waveform packet file (LASF_Spec/65535); give the `.wdp` \
             or `.wdz` file that was exported together with the points"
                .to_string(),
        ),
        (
            60,
            format!(
                "byte 20: record length after header: LASF_Spec/65535 declares 144 bytes, 0 left; \
                 {LIES}"
            ),
        ),
        (
            end - 1,
            format!(
                "byte 20: record length after header: LASF_Spec/65535 declares 144 bytes, 143 \
                 left; {LIES}"
            ),
        ),
    ] {
        let place = TestFolder::with(&[("a.las", &las.las()), ("a.wdp", &las.packets[..cut])]);
        refused(&place, "a.las", &format!("a.wdp: {message}"));
    }
}

#[test]
fn waveforms_that_were_cut_off_where_their_header_does_not_say_how_many_there_are() {
    let mut las = Las::new(3);
    // Writers that do not seek back leave a length of 0.
    las.packets[20..28].fill(0);
    let cut = las.packets.len() - 2 * SAMPLES;
    let place = TestFolder::with(&[("a.las", &las.las()), ("a.wdp", &las.packets[..cut])]);
    let message = "a.wdp: byte 108: waveform packet: 48 bytes at offset 108 are outside the \
                   packets (60 to 108); the point is damaged or the waveforms belong to another \
                   file: export both again";
    refused(&place, "a.las", message);
}

#[test]
fn compressed_points_that_were_cut_off() {
    let las = Las::new(300);
    let whole = las.laz();
    let points = 555;
    for (cut, problem) in [
        (
            whole.len() - 1,
            "byte 2912: chunk table: they cannot be decoded (failed to fill whole buffer)".to_string(),
        ),
        (
            2000,
            format!(
                "byte {points}: offset to the chunk table: 2912 is not between the points and the \
                 end of the file (2000 bytes)"
            ),
        ),
        (560, format!("byte {points}: offset to the chunk table: the file ends before it")),
    ] {
        let place = TestFolder::with(&[("a.laz", &whole[..cut]), ("a.wdp", &las.packets)]);
        refused(&place, "a.laz", &format!("a.laz: {problem}; {DAMAGED}"));
    }
}

#[test]
fn sizes_that_lie() {
    refused_with(
        96,
        &u32::MAX.to_le_bytes(),
        &format!(
            "byte 96: offset to point data: 4294967295 is beyond the end of the file (632 bytes); \
             {CUT}"
        ),
    );
    refused_with(
        100,
        &u32::MAX.to_le_bytes(),
        &format!("byte 455: variable length record: record 2 needs 54 bytes, 0 left; {LIES}"),
    );
    refused_with(
        105,
        &u16::MAX.to_le_bytes(),
        &format!(
            "byte 247: number of point records: the header declares 3 points of 65535 bytes, but \
             only 0 fit into the file; {CUT}"
        ),
    );
    refused_with(
        247,
        &u64::MAX.to_le_bytes(),
        &format!(
            "byte 247: number of point records: the header declares 18446744073709551615 points of \
             59 bytes, but only 3 fit into the file; {CUT}"
        ),
    );
    let evlrs = |start: u64, n: u32| [&start.to_le_bytes()[..], &n.to_le_bytes()].concat();
    let left = |start: u64, left: u64| {
        format!("byte {start}: variable length record: record 1 needs 60 bytes, {left} left; {LIES}")
    };
    refused_with(235, &evlrs(600, u32::MAX), &left(600, 32));
    refused_with(235, &evlrs(u64::MAX, u32::MAX), &left(u64::MAX, 0));
    refused_with(
        HEADER + 20,
        &u16::MAX.to_le_bytes(),
        &format!(
            "byte 395: record length after header: LASF_Spec/100 declares 65535 bytes, 26 left; \
             {LIES}"
        ),
    );
}

#[test]
fn a_count_of_compressed_points_that_lies() {
    let las = Las::new(300);
    let stored = |n: u64| {
        format!("byte 622: number of points of a chunk: it is 300, but header and chunk table give {n}")
    };
    let most = |n: u64| {
        format!(
            "byte 247: number of point records: the header declares {n} points, but the chunks hold at \
             most 50000"
        )
    };
    for (count, problem) in [
        (295, stored(295)),
        (301, stored(301)),
        (50_000, stored(50_000)),
        (50_001, most(50_001)),
        (u64::MAX, most(u64::MAX)),
    ] {
        let mut points = las.laz();
        points[247..255].copy_from_slice(&count.to_le_bytes());
        let place = TestFolder::with(&[("a.laz", &points), ("a.wdp", &las.packets)]);
        refused(&place, "a.laz", &format!("a.laz: {problem}; {DAMAGED}"));
    }
}

#[test]
fn a_descriptor_of_more_samples_than_a_waveform_has() {
    let mut las = Las::new(3);
    las.vlrs[0].splice(54.., descriptor(8, u32::MAX, 1000));
    refused(
        &place(&las, |_| {}),
        "a.las",
        "a.las: waveform descriptor 1 (LASF_Spec/100): 4294967295 samples exceed the limit of \
         4194304; the descriptor is damaged: export the file again",
    );
}

#[test]
fn waveforms_that_overlap_take_no_more_memory_than_a_line_may() {
    // 600 waveforms of 1 MB each from a file of 1 MB.
    let mut las = Las::new(600);
    let long = 1 << 20;
    las.vlrs[0].splice(54.., descriptor(8, long, 1000));
    las.packets.resize(60 + 600 * SAMPLES + long as usize, 3);
    let length = las.packets.len() as u64 - 60;
    las.packets[20..28].copy_from_slice(&length.to_le_bytes());
    for point in &mut las.points {
        point[39..43].copy_from_slice(&long.to_le_bytes());
    }
    let place = place(&las, |_| {});
    let mut command =
        place.command("[[stage]]\ntype = 'read_las'\npath = 'a.las'\n[[stage]]\ntype = 'write_lstat'\n");
    command.args(["--set", "job.memory_mb=64"]);
    let message = "stage read_las: ./a.las: scan line 0 needs 67.1 MB, too much for the job's memory_mb; \
                   set memory_mb to 135 or more";
    place.left_nothing(outcome(&mut command), message);
}

/// Asserts that one bad point in the middle of a recording is skipped and counted, and all others
/// are read.
#[track_caller]
fn loses_one_pulse(las: &Las, what: &str, note: &str) {
    let place = place(las, |_| {});
    let input = place.succeeds("read_las", "a.las", TO_TABLE);
    assert_eq!(json!(rejected(&input)), json!({ what: 1 }));
    let said = format!("{what} was rejected; further ones are only counted: ./{note}");
    assert_eq!(notes(&input), [said.split_once(": ").unwrap().1]);
    let expected: Vec<String> = (0..250).filter(|i| *i != 100).map(|i| format!("{:?}", time_s(i))).collect();
    assert_eq!(place.times("out/a.csv"), expected);
}

#[test]
fn a_point_of_a_descriptor_that_is_missing_is_counted_and_passed_over() {
    loses_one_pulse(
        &Las::new(250).change(100, 30, &[77]),
        "blocks: a point's waveform that cannot be read",
        "a.las: a point refers to waveform descriptor 77, but LASF_Spec/176 is missing; the point \
         or the header is damaged: export the file again",
    );
}

#[test]
fn a_point_whose_waveform_lies_outside_of_the_file_is_counted_and_passed_over() {
    for offset in [0u64, 59, 1 << 20, u64::MAX] {
        loses_one_pulse(
            &Las::new(250).change(100, 31, &offset.to_le_bytes()),
            "blocks: a point's waveform that cannot be read",
            &format!(
                "a.wdp: byte {offset}: waveform packet: 48 bytes at offset {offset} are outside \
                 the packets (60 to 12060); the point is damaged or the waveforms belong to \
                 another file: export both again"
            ),
        );
    }
}

#[test]
fn a_point_whose_waveform_is_too_short_is_counted_and_passed_over() {
    loses_one_pulse(
        &Las::new(250).change(100, 39, &[47]),
        "blocks: a point's waveform that cannot be read",
        "a.las: the waveform packet at byte 4860 has 47 bytes, but 48 samples of 8 bits need 48; \
         the point or its descriptor is damaged: export the file again",
    );
}

#[test]
fn a_point_without_waveform_or_direction_is_counted_and_passed_over() {
    for (at, bytes, what) in [
        (30, vec![0], "returns: a point without waveform"),
        (43, f32::NAN.to_le_bytes().to_vec(), "returns: a point without direction or location"),
        (47, f32::INFINITY.to_le_bytes().to_vec(), "returns: a point without direction or location"),
        (47, vec![0; 12], "returns: a point without direction or location"),
    ] {
        let place = place(&Las::new(250).change(100, at, &bytes), |_| {});
        let input = place.succeeds("read_las", "a.las", TO_TABLE);
        assert_eq!(json!(rejected(&input)), json!({ what: 1 }));
        assert_eq!(place.times("out/a.csv").len(), 249);
    }
}

#[test]
fn a_recording_whose_points_are_all_rejected_fails() {
    for (at, bytes, reason) in [
        (30, vec![0], "a point without waveform"),
        (47, vec![0; 12], "a point without direction or location"),
    ] {
        let las = (1..20).fold(Las::new(20), |las, point| las.change(point, at, &bytes));
        let las = las.change(0, 43, &f32::NAN.to_le_bytes());
        let message = format!(
            "stage read_las: ./a.las: all 20 points of the file were rejected (most common reason: {reason}); \
             check its point format, or export it again"
        );
        place(&las, |_| {}).fails("read_las", "a.las", &message);
    }
}

/// The instrument's own returns cannot replace a missing waveform: without it the beam is unknown.
#[test]
fn points_without_waveform_are_said_to_be_left_out() {
    for (skipped, said) in
        [(1, "1 point of the file has no waveform"), (3, "3 points of the file have no waveform")]
    {
        let las = (0..skipped).fold(Las::new(250), |las, point| las.change(100 + point, 30, &[0]));
        let stages = TO_TABLE.replace("type = 'decompose'", "type = 'decompose'\nonline_points = 'fallback'");
        let input = place(&las, |_| {}).succeeds("read_las", "a.las", &stages);
        let notes = notes(&input);
        assert!(
            notes.iter().any(|note| note.starts_with(said) && note.contains("`online_points`")),
            "{notes:?}"
        );
        assert_eq!(json!(rejected(&input)), json!({ "returns: a point without waveform": skipped }));
    }
}

#[test]
fn a_point_at_an_impossible_place_does_not_cost_the_others() {
    let stages = TO_TABLE.replace("write_table'\npath = '*.csv'", "write_las'\npath = '*_points.las'");
    let good = place(&Las::new(250), |_| {});
    good.succeeds("read_las", "a.las", &stages);
    let good = std::fs::read(good.path("out/a_points.las")).unwrap();
    let place = place(&Las::new(250).change(100, 43, &1e30f32.to_le_bytes()), |_| {});
    let input = place.succeeds("read_las", "a.las", &stages);
    assert_eq!(
        json!(rejected(&input)),
        json!({"returns: a point too far away for the coordinates of the file": 1})
    );
    let points = std::fs::read(place.path("out/a_points.las")).unwrap();
    assert_eq!(good.len() - points.len(), WRITTEN_POINT);
}

#[test]
fn points_that_all_lie_at_impossible_places_are_an_error() {
    let mut las = Las::new(250);
    las.points.iter_mut().for_each(|point| point[43..47].copy_from_slice(&1e30f32.to_le_bytes()));
    let stages = TO_TABLE.replace("write_table'\npath = '*.csv'", "write_las'\npath = '*_points.las'");
    let place = place(&las, |_| {});
    place.left_nothing(
        place.read("read_las", "a.las", &format!("check_locations = false\n{stages}")),
        "stage write_las: ./out/a_points.las: point 0 at [0.0, 0.0, 1.4985374807957656e26] cannot be stored: \
         z = 149853748079576560000000000 is too far from the offset 0 for steps of 0.001; \
         choose an offset near the points, or a larger scale",
    );
}

#[test]
fn missing_metadata_is_noted() {
    let mut las = Las::new(250);
    las.points.iter_mut().for_each(|point| point[43..47].fill(0));
    let stages = TO_TABLE.replace("write_table'\npath = '*.csv'", "write_las'");
    let unchecked = format!("check_locations = false\n{stages}");
    let input = place(&las, |_| {}).succeeds("read_las", "a.las", &unchecked);
    let expected = [
        "emission times are those of the clock: standard deviations of ranges include a jitter of one \
         sample, because no smooth points prove a smaller one; set `emission_jitter_ns` of `decompose` if the clock is more exact",
        "the input has no coordinate reference system (WKT or EPSG code), so the file has none; set it \
         with the reader's key `crs_of_input`",
    ];
    assert_eq!(notes(&input), expected);
    let input = place(&Las::new(250).with_crs("LOCAL_CS[\"made up\"]"), |_| {})
        .succeeds("read_las", "a.las", &stages);
    assert_eq!(notes(&input), Vec::<String>::new());
}

#[test]
fn how_waveforms_are_sampled_is_taken_from_the_file() {
    let mut las = Las::new(3);
    las.vlrs[0].splice(54.., descriptor(8, SAMPLES as u32, 400));
    let input = place(&las, |_| {}).succeeds("read_las", "a.las", "[[stage]]\ntype = 'write_lstat'\n");
    assert_eq!(input["sampling_interval_ns"], json!(0.4));
}

//! Recordings that the stand-in can serve without loss, and jobs that read them.

use std::path::PathBuf;
use std::sync::OnceLock;

use serde_json::Value;
use wavex::scan_line::emission_flags::{EDGE_OF_FLIGHT_LINE, SCAN_DIRECTION_POSITIVE};
use wavex_formats::container::{ContainerHeader, ContainerShot, EmissionReference, TimeScale, channel};

use crate::container::{Row, container, rows};
use crate::{Outcome, TestFolder};

/// Name of a recording with the start time of the simulator.
pub const NAME: &str = "250506_100000.sdf";

/// The stand-in, which cargo builds with the other examples before the tests.
pub fn stand_in() -> PathBuf {
    let (before, after) = (std::env::consts::DLL_PREFIX, std::env::consts::DLL_SUFFIX);
    crate::built(&format!("examples/{before}sdf_stand_in{after}"))
}

/// Header of a recording as SDF can store it: only what the interface provides.
pub fn header() -> ContainerHeader {
    ContainerHeader {
        instrument: Some("LMS-Q680i".into()),
        serial: Some("9997".into()),
        time_scale: TimeScale::Week,
        gps_week: Some(2365),
        amplitude_low: Some(vec![(9.0, 0.0), (68.0, 9.75), (255.0, 19.7)]),
        amplitude_high: Some(vec![(3.0, 10.5), (255.0, 39.7)]),
        range_low: Some(vec![(9.0, -4.3e-11), (255.0, 3.5e-11)]),
        range_high: Some(vec![(3.0, 1e-12), (255.0, 2e-12)]),
        recorded: Some((126, 2025)),
        full_scale_dn: Some(255),
        emission_reference: Some(EmissionReference::OutgoingPulse),
        ..ContainerHeader::new(1.0, 299_707_502.0)
    }
}

/// A simulated flight of six lines of 200 shots, as an instrument with two receivers records it.
///
/// In the scanner's frame, with unknown zones, several blocks per channel, and each echo also in
/// the high-power receiver.
pub fn flight() -> &'static [Vec<Row>] {
    static FLIGHT: OnceLock<Vec<Vec<Row>>> = OnceLock::new();
    FLIGHT.get_or_init(|| {
        let place = TestFolder::new();
        let job = "[[stage]]\ntype = 'simulate'\nlines = 6\nshots_per_line = 200\nseed = 3\n\
                   [[stage]]\ntype = 'write_arrow'\npath = 'flight.arrow'\n";
        assert_eq!(place.run(job), Outcome::success());
        let mut lines = rows(&place.path("out/flight.arrow"));
        lines.iter_mut().flatten().for_each(as_sdf);
        lines
    })
}

/// Removes content that SDF cannot store.
fn as_sdf(row: &mut Row) {
    row.shot.mta_zone = None;
    row.shot.scan_angle_deg = None;
    row.shot.frame_scale = None;
    row.shot.flags &= !SCAN_DIRECTION_POSITIVE;
    let echoes: Vec<_> = row.blocks.iter().filter(|block| block.0 == channel::LOW_POWER).cloned().collect();
    let weak = |samples: Vec<u16>| samples.into_iter().map(|sample| sample / 8).collect();
    row.blocks.extend(
        echoes.into_iter().map(|(_, start, samples)| (channel::HIGH_POWER, start + 1.43, weak(samples))),
    );
    // Block times are rounded to 1e-6 ns, the resolution at which they are read.
    row.blocks.iter_mut().for_each(|block| block.1 = (block.1 * 1e6).round() / 1e6);
}

/// The flight as a container.
pub fn flight_container() -> Vec<u8> {
    container(&header(), flight())
}

/// A folder with a recording and the control file of the stand-in.
pub fn place(recording: &[u8], mischief: &str) -> TestFolder {
    let place = TestFolder::with(&[(NAME, recording)]);
    if !mischief.is_empty() {
        place.write(&format!("{NAME}.txt"), mischief.as_bytes());
    }
    place
}

/// Stages of a job that copies a recording, read with these keys, to `out/sdf.arrow`.
pub fn copy(keys: &str) -> String {
    format!(
        "[[stage]]\ntype = 'read_sdf'\npath = '{NAME}'\n{keys}\n\
         [[stage]]\ntype = 'write_arrow'\npath = 'sdf.arrow'\ncompression = 'none'\n"
    )
}

/// Copies a recording successfully; returns the report of the input and the rows.
#[track_caller]
pub fn read(place: &TestFolder, keys: &str) -> (Value, Vec<Vec<Row>>) {
    assert_eq!(place.run(&copy(keys)), Outcome::success());
    let report: Value = serde_json::from_str(&place.text("out/job_report.json")).unwrap();
    (report["inputs"][0].clone(), rows(&place.path("out/sdf.arrow")))
}

/// Asserts that copying a recording fails with this message about the file.
#[track_caller]
pub fn fails(recording: &[u8], mischief: &str, keys: &str, message: &str) {
    let place = place(recording, mischief);
    let outcome = place.run(&copy(keys));
    place.left_nothing(outcome, &format!("stage read_sdf: ./{NAME}: {message}"));
}

/// A shot at nadir with an outgoing pulse and one echo, 0.1 s after the previous shot.
pub fn plain(shot: u64, line: u32) -> Row {
    Row {
        shot: ContainerShot {
            shot,
            line,
            gps_time_s: Some(208_800.0 + shot as f64 / 10.0),
            clock_ps: (5_000 + shot as i64 * 100) * 1_000_000_000,
            origin_m: [0.0; 3],
            direction: [0.0, 0.6, -0.8],
            facet: 0,
            flags: 3,
            mta_zone: None,
            scan_angle_deg: None,
            frame_scale: None,
        },
        blocks: vec![
            (channel::REFERENCE, -5.0, vec![2, 90, 2]),
            (channel::LOW_POWER, 4000.5, vec![2, 9, 30, 9, 2]),
        ],
    }
}

/// A line of such shots.
pub fn plain_line(shots: impl IntoIterator<Item = u64>, line: u32) -> Vec<Row> {
    shots.into_iter().map(|shot| plain(shot, line)).collect()
}

/// The lines as they are read where records say that they end: the last shot of each is an edge of the flight line.
pub fn with_edges(mut lines: Vec<Vec<Row>>) -> Vec<Vec<Row>> {
    lines.iter_mut().filter_map(|rows| rows.last_mut()).for_each(|row| row.shot.flags |= EDGE_OF_FLIGHT_LINE);
    lines
}

/// (line, number of shots) of each record batch.
pub fn lengths(lines: &[Vec<Row>]) -> Vec<(u32, usize)> {
    lines.iter().map(|rows| (rows[0].shot.line, rows.len())).collect()
}

//! Time scales, and reading a time window of a recording.

use wavex_formats::container::{ContainerHeader, ContainerReader, TimeScale};

use wavex_testkit::container::{Row, container, rows};
use wavex_testkit::sdf::{NAME, copy, header, lengths, place, plain_line, read, with_edges};
use wavex_testkit::{TestFolder, notes, rejected};

fn lines() -> Vec<Vec<Row>> {
    vec![plain_line(0..5, 0), plain_line(5..10, 1), plain_line(10..15, 2)]
}

fn clocks(lines: &[Vec<Row>]) -> Vec<i64> {
    lines.iter().flatten().map(|row| row.shot.clock_ps).collect()
}

fn header_of(place: &TestFolder) -> ContainerHeader {
    ContainerReader::open(&place.path("out/sdf.arrow")).unwrap().header().clone()
}

#[test]
fn a_window_is_sought_and_its_shots_are_those_of_the_whole() {
    let given = lines();
    // Reading from the beginning fails: the window can only be reached by seeking.
    let place = place(&container(&header(), &given), "fail fwifc_read 6 3");
    let (report, part) = read(&place, "time_s = [208800.65, 208801.2]");
    assert_eq!(lengths(&part), [(0, 3), (1, 3)]);
    assert_eq!(clocks(&part), clocks(&given)[7..13]);
    assert_eq!(part[0][0].shot.shot, 0, "shots are numbered as they are read");
    assert_eq!((notes(&report), rejected(&report).len()), (vec![], 0));
}

#[test]
fn both_ends_of_a_window_belong_to_it() {
    let place = place(&container(&header(), &lines()), "");
    assert_eq!(lengths(&read(&place, "time_s = [208800.5, 208800.5]").1), [(0, 1)]);
    assert_eq!(clocks(&read(&place, "time_s = [0.0, 1e9]").1), clocks(&lines()));
}

#[test]
fn a_window_behind_the_end_or_between_shots_is_empty() {
    let place = place(&container(&header(), &lines()), "");
    for window in ["[208900.0, 208901.0]", "[208800.51, 208800.52]"] {
        assert_eq!(place.run(&copy(&format!("time_s = {window}"))).err, "");
        assert!(!place.path("out/sdf.arrow").exists(), "{window}");
    }
}

#[test]
fn shots_without_a_time_are_rejected_where_a_window_is_asked_for() {
    let mut given = lines();
    given[1][2].shot.gps_time_s = None;
    let place = place(&container(&header(), &given), "");
    assert_eq!(lengths(&read(&place, "").1), [(0, 5), (1, 5), (2, 5)]);
    let (report, part) = read(&place, "time_s = [208800.55, 208801.05]");
    assert_eq!(lengths(&part), [(0, 3), (1, 1)]);
    let reason = |item: &str| format!("{item}: no time, although `time_s` is set");
    assert_eq!(
        rejected(&report).into_iter().collect::<Vec<_>>(),
        [(reason("blocks"), 2), (reason("shots"), 1)]
    );
}

#[test]
fn a_recording_that_was_not_synchronised_is_sought_by_its_clock() {
    let place = place(&container(&header(), &lines()), "unsynchronised");
    let (report, part) = read(&place, "time_s = [5.45, 5.85]");
    assert_eq!(clocks(&part), clocks(&lines())[5..9]);
    let remark = "the time scale of the recording is unknown: no trajectory can be matched to its times";
    assert_eq!(notes(&report), [remark]);
    assert_eq!((header_of(&place).time_scale, header_of(&place).gps_week), (TimeScale::Unknown, None));
}

#[test]
fn a_file_without_its_date_lacks_the_week_unless_the_job_says_the_day() {
    let place = TestFolder::with(&[("flight.sdf", &container(&header(), &lines()))]);
    let job = |keys: &str| copy(keys).replace(NAME, "flight.sdf");
    let run = |keys: &str| {
        assert_eq!(place.run(&job(keys)).err, "");
        let report: serde_json::Value = serde_json::from_str(&place.text("out/job_report.json")).unwrap();
        (notes(&report["inputs"][0]), header_of(&place).gps_week, header_of(&place).recorded)
    };
    let remark = "the GPS week is unknown: the file name does not begin with its date as in \
                  130621_101500.sdf; set the day with the key `gps_date`";
    assert_eq!(run(""), (vec![remark.to_owned()], None, None));
    assert_eq!(run("gps_date = '2025-05-06'"), (vec![], Some(2365), Some((126, 2025))));
}

#[test]
fn an_epoch_that_is_a_date_gives_adjusted_seconds_and_a_window_counts_them() {
    let given = lines();
    let place = place(&container(&header(), &given), "epoch 2025-05-04T00:00:00");
    let (_, whole) = read(&place, "");
    let header = header_of(&place);
    assert_eq!((header.time_scale, header.gps_week), (TimeScale::Adjusted, Some(2365)));
    let begins = 2365.0 * 604_800.0 - 1e9;
    assert_eq!(whole[0][0].shot.gps_time_s, Some(begins + 208_800.0));
    let (_, part) = read(&place, &format!("time_s = [{}, {}]", begins + 208_800.55, begins + 208_800.75));
    assert_eq!(clocks(&part), clocks(&given)[6..8]);
}

#[test]
fn seconds_that_begin_anew_are_counted_on() {
    let mut given = lines();
    for (index, row) in given.iter_mut().flatten().enumerate() {
        row.shot.gps_time_s = Some((604_799.0 + index as f64 / 4.0) % 604_800.0);
    }
    // The name gives Saturday the 3rd: the week ends within the recording.
    let place = TestFolder::with(&[("250503_235959.sdf", &container(&header(), &given))]);
    assert_eq!(place.run(&copy("").replace(NAME, "250503_235959.sdf")).err, "");
    let times: Vec<_> =
        rows(&place.path("out/sdf.arrow")).concat().iter().map(|row| row.shot.gps_time_s).collect();
    let expected: Vec<_> = (0..15).map(|index| Some(604_799.0 + f64::from(index) / 4.0)).collect();
    assert_eq!(times, expected);
    assert_eq!(header_of(&place).gps_week, Some(2364));
}

#[test]
fn a_time_that_is_wrong_moves_no_other() {
    let mut given = lines();
    given[0][0].shot.gps_time_s = None;
    given[0][2].shot.gps_time_s = Some(0.0);
    given[1][3].shot.gps_time_s = Some(604_000.0);
    let place = place(&container(&header(), &given), "");
    let times = |lines: &[Vec<Row>]| lines.concat().iter().map(|row| row.shot.gps_time_s).collect::<Vec<_>>();
    assert_eq!(times(&read(&place, "").1), times(&given));
    assert_eq!(header_of(&place), header());
    let (_, part) = read(&place, "time_s = [208800.65, 208801.2]");
    assert_eq!(clocks(&part).len(), 5, "a shot whose time is far too late does not end the window");
}

#[test]
fn behind_the_window_nothing_more_is_read() {
    let long = vec![plain_line(0..200, 0)];
    // Of the 200 shots, at most 100 after the window are read.
    let place = place(&container(&header(), &long), "fail fwifc_read 6 112");
    assert_eq!(lengths(&read(&place, "time_s = [208800.0, 208801.05]").1), [(0, 11)]);
}

#[test]
fn seconds_of_the_day_become_seconds_of_the_week() {
    let mut given = lines();
    for row in given.iter_mut().flatten() {
        row.shot.gps_time_s = row.shot.gps_time_s.map(|time_s| time_s - 2.0 * 86_400.0);
    }
    let place = place(&container(&header(), &given), "epoch DAYSEC");
    assert_eq!(read(&place, "").1, with_edges(lines()));
    assert_eq!(header_of(&place), header());
}

fn times(lines: &[Vec<Row>]) -> Vec<f64> {
    lines.concat().iter().map(|row| row.shot.gps_time_s.unwrap()).collect()
}

/// GPS time was 18 s ahead of UTC in 2025.
#[test]
fn leap_seconds_and_an_offset_are_added() {
    let place = place(&container(&header(), &lines()), "");
    let (report, found) = read(&place, "utc = true\ntime_offset_s = 0.25");
    let expected: Vec<f64> = times(&lines()).iter().map(|time_s| time_s + 18.25).collect();
    assert_eq!((times(&found), clocks(&found)), (expected, clocks(&lines())));
    assert_eq!(notes(&report), Vec::<String>::new());
    let (_, part) = read(&place, "time_offset_s = 100.0\ntime_s = [208900.65, 208901.2]");
    assert_eq!(clocks(&part), clocks(&lines())[7..13], "the window applies to the shifted times");
}

#[test]
fn a_window_may_count_another_scale_than_the_recording() {
    let week_s = 2365.0 * 604_800.0 - 1e9;
    let in_weeks = place(&container(&header(), &lines()), "");
    let asked =
        format!("time_s = [{}, {}]\ntime_scale = 'adjusted'", week_s + 208_800.65, week_s + 208_801.25);
    let (_, part) = read(&in_weeks, &asked);
    assert_eq!(clocks(&part), clocks(&lines())[7..13]);
    assert_eq!(times(&part)[0], 208_800.7, "times stay on the scale of the recording");
    let (_, part) = read(&in_weeks, "time_s = [208800.65, 208801.2]\ntime_scale = 'week'");
    assert_eq!(clocks(&part), clocks(&lines())[7..13]);
    let adjusted = place(&container(&header(), &lines()), "epoch 2025-05-04T00:00:00");
    let (_, part) = read(&adjusted, "time_s = [208800.55, 208800.75]\ntime_scale = 'week'");
    assert_eq!(clocks(&part), clocks(&lines())[6..8]);
    assert_eq!(header_of(&adjusted).time_scale, TimeScale::Adjusted);
}

#[test]
fn keys_that_need_the_day_say_so() {
    let place = TestFolder::with(&[("flight.sdf", &container(&header(), &lines()))]);
    let remedy = "set the day with the key `gps_date`, or remove the key";
    for (keys, problem) in [
        ("utc = true", "its times are UTC, but the day is unknown, and with it the number of leap seconds"),
        (
            "time_s = [0.0, 1.0]\ntime_scale = 'adjusted'",
            "`time_scale` needs the GPS week of the recording, which is unknown",
        ),
    ] {
        let outcome = place.run(&copy(keys).replace(NAME, "flight.sdf"));
        place.left_nothing(outcome, &format!("stage read_sdf: ./flight.sdf: {problem}; {remedy}"));
    }
    assert_eq!(place.run(&copy("utc = true\ngps_date = '2025-05-06'").replace(NAME, "flight.sdf")).err, "");
}

#[test]
fn the_air_may_be_another_than_the_recording_says() {
    let place = place(&container(&header(), &lines()), "");
    read(&place, "refractive_index_ppm = 280.0");
    assert_eq!(header_of(&place).group_velocity_mps, 299_792_458.0 / 1.000_28);
}

use super::*;
use proptest::prelude::*;

fn times(clock: Clock, first_s: f64, last_s: f64) -> TimeSpan {
    TimeSpan { clock, first_s, last_s }
}

/// 2025-05-06: Tuesday of GPS week 2365.
const MIDNIGHT_S: f64 = 2365.0 * WEEK_S + 2.0 * DAY_S - 1e9;

#[test]
fn clocks_are_those_of_recordings() {
    let scales = [TimeScale::Adjusted, TimeScale::Week, TimeScale::Day, TimeScale::Unknown];
    let clocks = scales.map(Clock::of);
    assert_eq!(clocks, [Some(Clock::Adjusted), Some(Clock::Week), Some(Clock::Day), None]);
}

#[test]
fn dates_round_trip() {
    assert_eq!(adjusted_of_date([2025, 5, 6]), Some(MIDNIGHT_S));
    assert_eq!(date(MIDNIGHT_S - 0.1), Some([2025, 5, 5]));
    assert_eq!(date(MIDNIGHT_S), Some([2025, 5, 6]));
    assert_eq!(adjusted_of_date([1980, 1, 6]), Some(-1e9));
    assert_eq!(date(adjusted_of_date([2024, 2, 29]).unwrap() + DAY_S), Some([2024, 3, 1]));
    for wrong in [[2025, 2, 29], [2025, 13, 1], [2025, 0, 1], [2025, 1, 0], [1979, 12, 31], [0, 0, 0]] {
        assert_eq!(adjusted_of_date(wrong), None, "{wrong:?}");
    }
}

#[test]
fn utc_falls_behind() {
    let at = |date: [u16; 3], seconds: f64| leap_seconds(adjusted_of_date(date).unwrap() + seconds);
    assert_eq!(at([1980, 1, 6], 0.0), 0.0);
    assert_eq!(at([1981, 7, 1], 0.0), 1.0);
    assert_eq!(at([1999, 6, 1], 0.0), 13.0);
    assert_eq!(at([2012, 6, 30], 86_399.0), 15.0);
    assert_eq!(at([2012, 7, 1], 0.0), 16.0);
    assert_eq!(at([2016, 12, 31], 86_399.0), 17.0);
    assert_eq!(at([2017, 1, 1], 0.0), 18.0);
    assert_eq!(at([2025, 5, 6], 0.0), 18.0);
}

#[test]
fn times_continue_across_midnight() {
    let run_on = |clock, times: [f64; 4]| {
        let mut unwrap = Unwrap::new(clock);
        times.map(|time_s| unwrap.next(time_s))
    };
    assert_eq!(
        run_on(Clock::Week, [604_799.5, 0.5, 302_000.0, 1.0]),
        [604_799.5, 604_800.5, 906_800.0, 604_801.0],
        "a step back by less than half a week is kept"
    );
    assert_eq!(
        run_on(Clock::Day, [86_399.0, 1.0, 86_000.0, 2.0]),
        [86_399.0, 86_401.0, 172_400.0, 172_802.0]
    );
    assert_eq!(run_on(Clock::Adjusted, [1e8, 0.0, 2e8, 1.0]), [1e8, 0.0, 2e8, 1.0]);
    assert!(run_on(Clock::Day, [1.0, f64::NAN, 2.0, 3.0])[1].is_nan());
}

#[test]
fn times_out_of_order_around_midnight_keep_their_day() {
    for (clock, period_s) in [(Clock::Week, WEEK_S), (Clock::Day, DAY_S)] {
        let mut unwrap = Unwrap::new(clock);
        for off_s in [-1.0, 0.25, -0.5, 1.0, -30.0, f64::NAN, 0.5, 2.0] {
            let found_s = unwrap.next(f64::rem_euclid(off_s, period_s));
            assert!(found_s == period_s + off_s || off_s.is_nan() && found_s.is_nan(), "{off_s}: {found_s}");
        }
        // The first time is the one after midnight.
        let mut unwrap = Unwrap::new(clock);
        assert_eq!([0.5, period_s - 0.5, 1.0].map(|time_s| unwrap.next(time_s)), [0.5, -0.5, 1.0]);
        // A NaN does not hide a midnight.
        let mut unwrap = Unwrap::new(clock);
        unwrap.next(period_s - 1.0);
        unwrap.next(f64::NAN);
        assert_eq!(unwrap.next(1.0), period_s + 1.0);
    }
}

#[test]
fn time_spans_are_formatted_as_dates_and_seconds() {
    let text = |clock, first_s, last_s| times(clock, first_s, last_s).to_string();
    assert_eq!(
        text(Clock::Adjusted, MIDNIGHT_S + 36_000.0, MIDNIGHT_S + 37_812.46),
        "2025-05-06 10:00:00.0 to 10:30:12.5 GPS (430560800.0 to 430562612.5 s, adjusted)"
    );
    assert_eq!(
        text(Clock::Adjusted, MIDNIGHT_S - 1.0, MIDNIGHT_S + 59.96),
        "2025-05-05 23:59:59.0 to 2025-05-06 00:01:00.0 GPS (430524799.0 to 430524860.0 s, adjusted)"
    );
    assert_eq!(
        text(Clock::Week, 604_790.0, 604_810.0),
        "Saturday 23:59:50.0 to Sunday 00:00:10.0 GPS (604790.0 to 604810.0 s of the week)"
    );
    assert_eq!(
        text(Clock::Day, 36_000.0, 36_001.0),
        "10:00:00.0 to 10:00:01.0 GPS (36000.0 to 36001.0 s of the day)"
    );
    assert_eq!(
        text(Clock::Adjusted, -2e9, -2e9 + 1.0),
        "no date 22:13:20.0 to 22:13:21.0 GPS (-2000000000.0 to -1999999999.0 s, adjusted)"
    );
}

#[test]
fn a_recording_is_aligned_to_week_and_day() {
    let flight = times(Clock::Adjusted, MIDNIGHT_S + 36_000.0, MIDNIGHT_S + 40_000.0);
    let day = times(Clock::Day, 36_500.0, 37_000.0);
    let week = times(Clock::Week, 2.0 * DAY_S + 36_500.0, 2.0 * DAY_S + 37_000.0);
    let adjusted = times(Clock::Adjusted, MIDNIGHT_S + 36_500.0, MIDNIGHT_S + 37_000.0);
    for recording in [day, week, adjusted] {
        let alignment = align(recording, flight).unwrap();
        assert_eq!(alignment.on_trajectory(recording.first_s), MIDNIGHT_S + 36_500.0, "{recording:?}");
    }
    // Vice versa, and with a trajectory clock of shorter period than that of the recording.
    for trajectory in [times(Clock::Week, 208_800.0, 212_800.0), times(Clock::Day, 36_000.0, 40_000.0)] {
        for recording in [day, week, adjusted] {
            let time_s = align(recording, trajectory).unwrap().on_trajectory(recording.last_s);
            assert_eq!(time_s - trajectory.first_s, 1000.0, "{recording:?} {trajectory:?}");
        }
    }
}

#[test]
fn the_end_of_the_week_may_be_anywhere() {
    let trajectory = times(Clock::Week, 604_000.0, 605_600.0);
    for (first_s, last_s) in
        [(604_100.0, 604_200.0), (604_700.0, 100.0), (604_700.0, 604_900.0), (10.0, 20.0)]
    {
        let alignment = align(times(Clock::Week, first_s, last_s), trajectory).unwrap();
        assert_eq!(alignment.on_trajectory(604_799.0), 604_799.0);
        assert_eq!(alignment.on_trajectory(1.0), 604_801.0);
        assert_eq!(alignment.on_trajectory(604_801.0), 604_801.0);
    }
}

#[test]
fn partial_overlap_is_enough() {
    let trajectory = times(Clock::Week, 1000.0, 2000.0);
    for (first_s, last_s) in [(500.0, 1500.0), (1500.0, 2500.0), (500.0, 2500.0)] {
        assert!(align(times(Clock::Week, first_s, last_s), trajectory).is_ok());
    }
}

#[test]
fn disjoint_and_ambiguous_times_are_errors() {
    let text = |recording, trajectory| align(recording, trajectory).unwrap_err().to_string();
    assert_eq!(
        text(times(Clock::Day, 100.0, 200.0), times(Clock::Week, 36_000.0, 37_000.0)),
        "the recording and the trajectory have no time in common: the recording lasts from 00:01:40.0 to 00:03:20.0 GPS \
         (100.0 to 200.0 s of the day), the trajectory from Sunday 10:00:00.0 to 10:16:40.0 GPS (36000.0 to 37000.0 s \
         of the week); use the trajectory of this flight, or set its time scale with `trajectory_time`"
    );
    assert_eq!(
        text(times(Clock::Day, 100.0, 200.0), times(Clock::Week, 0.0, 90_000.0)),
        "the trajectory lasts from Sunday 00:00:00.0 to Monday 01:00:00.0 GPS (0.0 to 90000.0 s of the week), longer than \
         the period of the clock: seconds of the day of the recording, which lasts from 00:01:40.0 to 00:03:20.0 GPS \
         (100.0 to 200.0 s of the day), are ambiguous; cut the trajectory to the flight"
    );
    let late = text(times(Clock::Week, 36_982.5, 36_999.0), times(Clock::Day, 36_000.0, 36_981.0));
    assert!(late.ends_with("or set `time_offset_s` of the reader"), "{late}");
    let week = times(Clock::Adjusted, MIDNIGHT_S, MIDNIGHT_S + WEEK_S);
    assert!(align(week, week).is_ok(), "dates are never ambiguous");
}

proptest! {
    /// A flight time is recovered from its value on the recording's clock.
    #[test]
    fn flight_times_are_recovered(start in 0.0..2e9f64, flight in 1.0..80_000.0f64, part in 0.0..=1.0f64, clocks in 0..9usize) {
        let all = [Clock::Adjusted, Clock::Week, Clock::Day];
        let (recorder, navigator) = (all[clocks / 3], all[clocks % 3]);
        let first_s = (start - 1e9).floor();
        let count = |clock: Clock, time_s: f64| match clock.period_s() {
            Some(period_s) => (time_s + 1e9).rem_euclid(period_s),
            None => time_s,
        };
        let begin_s = count(navigator, first_s);
        let trajectory = times(navigator, begin_s, begin_s + flight.floor());
        let moment_s = (part * flight.floor()).floor();
        let recorded_s = count(recorder, first_s + moment_s);
        let alignment = align(times(recorder, recorded_s, recorded_s), trajectory).unwrap();
        prop_assert_eq!(alignment.on_trajectory(recorded_s), begin_s + moment_s);
    }
}

#[test]
fn gps_times_become_utc_about_a_leap_second() {
    // 18 seconds from 2017-01-01 on.
    let begin = adjusted_of_date([2017, 1, 1]).unwrap();
    let at = |gps_s: f64| utc_of_gps(begin + gps_s).unwrap();
    assert_eq!(at(18.0), "2017-01-01T00:00:00.000Z");
    assert_eq!(at(16.5), "2016-12-31T23:59:59.500Z");
    assert_eq!(at(17.25), "2017-01-01T00:00:00.250Z", "within the leap second");
    assert_eq!(at(18.9996), "2017-01-01T00:00:01.000Z");
    assert_eq!(utc_of_gps(f64::NAN), None);
    assert_eq!(utc_of_gps(-2e9), None);
}

#[test]
fn the_date_of_a_trajectory_gives_the_week_of_seconds() {
    // 2025-05-06 is the Tuesday of week 2365.
    let span = |clock, first_s: f64| TimeSpan { clock, first_s, last_s: first_s + 1000.0 };
    let week = |recording, trajectory| {
        Alignment::between(recording, trajectory).unwrap().gps_week(recording.first_s)
    };
    let dated = span(Clock::Adjusted, 430_560_700.0);
    assert_eq!(week(span(Clock::Week, 208_800.0), dated), Some(2365));
    assert_eq!(week(span(Clock::Week, 208_800.0 + WEEK_S), dated), Some(2364), "continued after its end");
    assert_eq!(week(span(Clock::Week, 208_800.0), span(Clock::Week, 208_700.0)), None);
    assert_eq!(week(span(Clock::Day, 36_000.0), dated), None);
}

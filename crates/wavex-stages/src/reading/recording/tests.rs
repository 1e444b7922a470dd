//! Time windows, implausible time scales, and CRSs. `tests/readers/declared.rs` covers whole jobs.

use super::time::RecordingTime;
use super::*;
use wavex_line::scan_line::{Blocks, Channel, Emission, TimeScale};
use wavex_line::stage::Item;

/// Lines of shots with these times.
struct Lines(std::vec::IntoIter<Vec<f64>>, Arc<InputInfo>);

impl Source for Lines {
    fn next(&mut self, _cx: &mut Context) -> Result<Option<ScanLine>> {
        let Some(times_s) = self.0.next() else { return Ok(None) };
        let mut blocks = Blocks::default();
        (0..times_s.len() as u32)
            .for_each(|shot| blocks.push(shot, Channel::LowPower, None, 0.0, 1.0, &[2, 3]));
        let shot = |gps_time_s| Emission { gps_time_s, ..Emission::default() };
        let emissions = times_s.into_iter().map(shot).collect();
        Ok(Some(ScanLine::of_shots(Arc::clone(&self.1), 0, emissions, blocks)))
    }
}

fn read(scale: TimeScale, lines: Vec<Vec<f64>>, times: TimeKeys) -> Result<(Vec<ScanLine>, Context)> {
    let info = InputInfo { time_scale: scale, frame: Frame::Map, ..InputInfo::default() };
    let declared = Declared { times, ..Declared::default() };
    let mut source = AsDeclared::new(Lines(lines.into_iter(), Arc::new(info)), declared);
    let mut cx = Context::default();
    let mut read = Vec::new();
    while let Some(line) = source.next(&mut cx)? {
        read.push(line);
    }
    Ok((read, cx))
}

fn times(lines: &[ScanLine]) -> Vec<Vec<f64>> {
    lines.iter().map(|line| line.emissions.iter().map(|shot| shot.gps_time_s).collect()).collect()
}

#[test]
fn a_window_keeps_the_blocks_of_its_shots_and_drops_empty_lines() {
    let lines = vec![vec![1.0, 2.0], vec![3.0, f64::NAN, 4.0], vec![9.0]];
    let keys = TimeKeys { time_s: Some([2.0, 3.5]), ..TimeKeys::default() };
    let (read, cx) = read(TimeScale::Week, lines, keys).unwrap();
    assert_eq!(times(&read), [[2.0], [3.0]]);
    assert!(read.iter().all(|line| line.blocks().unwrap().len() == 1 && line.stats.nw == 1));
    assert_eq!(read[0].stats.gps_time_s, 2.0);
    let rejected: Vec<_> = cx.counters().rejected.iter().collect();
    let reason = Reason::WithoutTime;
    assert_eq!(rejected, [(&(Item::Shots, reason), &1), (&(Item::Blocks, reason), &1)]);
}

#[test]
fn green_instruments_are_named() {
    for green in ["VQ-880-GII", "RIEGL VQ-840-GL", "CZMIL Nova", "Leica Chiroptera 4X"] {
        assert!(green_note(Some(green)).is_some_and(|note| note.starts_with(green)), "{green}");
    }
    for other in [Some("VQ-880"), Some("LMS-Q680i"), Some("VQ-1560i"), None] {
        assert_eq!(green_note(other), None);
    }
}

#[test]
fn an_empty_window_names_window_and_times() {
    let keys = TimeKeys { time_s: Some([5.0, 6.0]), ..TimeKeys::default() };
    let (read, cx) = read(TimeScale::Week, vec![vec![1.0, 2.0], vec![3.0]], keys).unwrap();
    assert!(read.is_empty());
    let expected = "no shot lies in the time window, 5.000 to 6.000 s: the times read are 1.000 to 3.000 s; set \
                    `time_s`, or the scale it counts on with `time_scale`";
    assert_eq!(cx.counters().notes, [expected]);
}

#[test]
fn times_that_do_not_fit_their_label_are_named() {
    let said = |scale, time_s| {
        let (_, cx) = read(scale, vec![vec![time_s]], TimeKeys::default()).unwrap();
        cx.counters().notes.clone()
    };
    let expected = "the recording's times, such as 1000061758.0 s, are not plausible as seconds of the GPS \
                    week (as adjusted GPS time: 2043-05-23, as standard GPS time: 2011-09-14); set the time \
                    scale with the reader's key `recording_time`";
    assert_eq!(said(TimeScale::Week, 1_000_061_758.0), [expected]);
    assert_eq!(said(TimeScale::Day, 400_000.0).len(), 1);
    assert_eq!(said(TimeScale::Adjusted, 1_400_000_000.0 + 2e9).len(), 1);
    for (scale, time_s) in [
        (TimeScale::Week, 604_801.0),
        (TimeScale::Day, 86_401.0),
        (TimeScale::Adjusted, 4e8),
        (TimeScale::Unknown, -5.0),
    ] {
        assert_eq!(said(scale, time_s), Vec::<String>::new(), "{scale:?}");
    }
}

#[test]
fn the_date_of_a_file_shows_seconds_of_the_week_called_adjusted() {
    let adjusted = RecordedTimeScale::of(TimeScale::Adjusted);
    assert_eq!(adjusted.misfit(400_000.0, Some((260, 2011))), None);
    assert!(adjusted.misfit(400_000.0, Some((188, 2015))).is_some());
    assert!(adjusted.misfit(430_000_000.0, Some((188, 2015))).is_some(), "2025 in a file of 2015");
    assert_eq!(adjusted.misfit(120_000_000.0, Some((188, 2015))), None);
}

#[test]
fn keys_that_build_on_a_label_refuse_one_that_does_not_fit() {
    let keys = |recording_time| TimeKeys {
        gps_date: Some("2011-09-14".into()),
        recording_time,
        ..TimeKeys::default()
    };
    let lines = || vec![vec![1_000_061_758.0]];
    let error = read(TimeScale::Week, lines(), keys(None)).unwrap_err().to_string();
    assert!(error.ends_with(time::SAY_SCALE), "{error}");
    let (lines, cx) = read(TimeScale::Week, lines(), keys(Some(RecordingTime::Standard))).unwrap();
    assert_eq!((times(&lines), cx.counters().notes.len()), (vec![vec![61_758.0]], 0));
    assert_eq!((lines[0].input.time_scale, lines[0].input.gps_week), (TimeScale::Adjusted, Some(1653)));
}

#[test]
fn a_day_dates_seconds_that_begin_anew() {
    let keys = TimeKeys { gps_date: Some("2025-05-03".into()), ..TimeKeys::default() };
    let lines = vec![vec![604_799.0], vec![1.0]];
    let (lines, _) = read(TimeScale::Week, lines, keys).unwrap();
    assert_eq!(times(&lines), [[604_799.0], [604_801.0]]);
    assert_eq!((lines[1].input.gps_week, lines[1].input.recorded), (Some(2364), Some((123, 2025))));
}

#[test]
fn a_date_of_another_weekday_than_the_seconds_of_the_week_is_a_warning() {
    // 2025-05-03 is a Saturday.
    let notes = |first_s: f64| {
        let keys = TimeKeys { gps_date: Some("2025-05-03".into()), ..TimeKeys::default() };
        let (_, cx) = read(TimeScale::Week, vec![vec![first_s]], keys).unwrap();
        cx.counters().notes.clone()
    };
    for near in [6.5, 0.5, 5.5] {
        assert_eq!(notes(near * 86_400.0), Vec::<String>::new(), "the date may be local");
    }
    let [note] = &notes(3.5 * 86_400.0)[..] else { panic!("a warning") };
    assert!(note.starts_with("`gps_date` is a Saturday, but") && note.contains("on a Wednesday"), "{note}");
}

#[test]
fn copies_of_waveforms_are_a_warning() {
    struct Twice(Vec<ScanLine>);
    impl Source for Twice {
        fn next(&mut self, _: &mut Context) -> Result<Option<ScanLine>> {
            Ok(self.0.pop())
        }
    }
    let line = |factors: &[u32]| {
        let mut blocks = Blocks::default();
        for (index, factor) in (0..).zip(factors) {
            let noise = |k: u32| (10 + (factor * (k + 1)).wrapping_mul(2_654_435_761) % 7) as u16;
            let samples: Vec<u16> = (0..80).map(noise).collect();
            blocks.push(index, wavex_line::scan_line::Channel::LowPower, None, 0.0, 1.0, &samples);
        }
        ScanLine::of_shots(Arc::default(), 0, vec![Emission::default(); factors.len()], blocks)
    };
    let notes = |lines: Vec<ScanLine>| {
        let (mut source, mut cx) = (AsDeclared::new(Twice(lines), Declared::default()), Context::default());
        while source.next(&mut cx).unwrap().is_some() {}
        cx.counters().notes.clone()
    };
    assert_eq!(notes(vec![line(&[1, 2, 3])]), Vec::<String>::new());
    assert_eq!(notes(vec![line(&[1, 1, 1, 4])]), Vec::<String>::new(), "two of four may be chance");
    let [note] = &notes(vec![line(&[1, 1, 1, 4]), line(&[5, 6, 6])])[..] else { panic!("one warning") };
    assert!(note.starts_with("3 of 7 waveforms are byte-identical copies"), "{note}");
}

#[test]
fn a_map_that_is_declared_must_be_one() {
    let keys = |word: &str| InputCrs { crs_of_input: Some(word.to_owned()) };
    for word in ["utm", "geodetic", "ecef", "", "EPSG:4978", "EPSG:99999"] {
        assert_eq!(keys(word).check().unwrap_err().key, "crs_of_input", "{word}");
    }
    assert!(keys("utm:99N").check().is_err());
    for word in ["EPSG:2154", "utm:33N", "zone.wkt"] {
        assert_eq!(keys(word).check(), Ok(()));
    }
    assert_eq!(keys("zone.wkt").file(), ["zone.wkt"]);
    assert!(keys("utm:33N").file().is_empty());
}

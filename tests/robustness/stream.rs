//! Streams of a chain's results, as the Python package uses them.

use std::time::Duration;

use wavex::engine::{self, Convert, Input, Next, Options, ProgressWatch, RunError, Stream};
use wavex::scan_line::ScanLine;
use wavex::stage::{Result, StageError, StageSpec};
use wavex_testkit::engine_stages::{COUNT, WORK, WRITE_NUMBERS, into, job};

/// Long enough for any result of these chains; a test that waits for it fails.
const LONG: Duration = Duration::from_secs(60);

/// Groups line numbers; the last group may be smaller.
struct Groups {
    size: usize,
    group: Vec<u32>,
    /// Line that cannot be converted.
    fails_at: Option<u32>,
}

impl Groups {
    fn of(size: usize) -> Groups {
        Groups { size, group: Vec::new(), fails_at: None }
    }
}

impl Convert for Groups {
    type Item = Vec<u32>;

    fn line(&mut self, line: &ScanLine) -> Result<Option<Vec<u32>>> {
        if self.fails_at == Some(line.line) {
            return Err(StageError::failed("the line has no table", "choose other columns"));
        }
        self.group.push(line.line);
        Ok((self.group.len() == self.size).then(|| std::mem::take(&mut self.group)))
    }

    fn finish(&mut self) -> Result<Option<Vec<u32>>> {
        Ok(Some(std::mem::take(&mut self.group)).filter(|group| !group.is_empty()))
    }
}

/// A stream of these stages with three workers and room for one item.
fn stream<C: Convert + 'static>(stages: &[(&'static StageSpec, &str)], convert: C) -> Stream<C::Item> {
    let job = job(stages);
    let input = Input { path: "generated".into(), stem: "generated".into(), part: None };
    let options = Options { threads: 3, ..into(&job, std::path::Path::new(".")) };
    engine::stream(&job, input, &options, 1, convert).unwrap()
}

/// Items up to the end, and the error with which the run ended.
fn drained<T>(stream: &mut Stream<T>) -> (Vec<T>, Option<RunError>) {
    let mut items = Vec::new();
    loop {
        match stream.next_within(LONG) {
            Ok(Next::Item(item)) => items.push(item),
            Ok(Next::Waiting) => panic!("no item within {LONG:?}"),
            Ok(Next::End) => return (items, None),
            Err(error) => return (items, Some(error)),
        }
    }
}

#[test]
fn a_stream_gives_the_items_in_order_and_then_its_summary() {
    let stages: [(&StageSpec, &str); 2] = [(&COUNT, "lines = 10"), (&WORK, "longest_us = 200")];
    let mut stream = stream(&stages, Groups::of(4));
    assert_eq!(format!("{stream:?}"), "Stream { has_ended: false, .. }");
    assert!(stream.summary().is_none(), "the run has not ended");
    let (items, error) = drained(&mut stream);
    assert!(error.is_none(), "{error:?}");
    assert_eq!(items, [vec![0, 1, 2, 3], vec![4, 5, 6, 7], vec![8, 9]]);
    let summary = stream.summary().unwrap();
    assert_eq!((summary.totals["nw"], summary.outputs.len()), (30, 0));
    assert_eq!(stream.next_within(LONG).unwrap(), Next::End, "an ended stream has no more items");
    assert_eq!(format!("{stream:?}"), "Stream { has_ended: true, .. }");
}

#[test]
fn a_stage_that_fails_ends_a_stream_with_its_error_once() {
    let mut stream = stream(&[(&COUNT, "fail_at = 7")], Groups::of(2));
    let (items, error) = drained(&mut stream);
    assert!(items.len() <= 3, "{items:?}");
    let expected = "stage count: generated: byte 77 is wrong; copy the file again";
    assert_eq!(error.unwrap().to_string(), expected);
    assert_eq!(stream.next_within(LONG).unwrap(), Next::End);
    assert!(stream.summary().is_none(), "a failed run has no summary");
}

#[test]
fn a_line_that_cannot_be_converted_is_the_cause() {
    let groups = Groups { fails_at: Some(5), ..Groups::of(2) };
    let (items, error) = drained(&mut stream(&[(&COUNT, "lines = 1000000")], groups));
    assert_eq!(items, [[0, 1], [2, 3]]);
    let expected = "stage stream: generated: the line has no table; choose other columns";
    assert_eq!(error.unwrap().to_string(), expected);
}

#[test]
fn a_stage_that_panics_ends_a_stream_with_the_place() {
    let (_, error) = drained(&mut stream(&[(&COUNT, ""), (&WORK, "panic_at = 3")], Groups::of(1)));
    let error = error.unwrap().to_string();
    assert!(error.contains("bug in wavex: line 3 is a bug (crates/testkit/src/engine_stages.rs:"), "{error}");
}

/// Waits for a permit before each line.
struct Permitted(std::sync::mpsc::Receiver<()>);

impl Convert for Permitted {
    type Item = u32;

    fn line(&mut self, line: &ScanLine) -> Result<Option<u32>> {
        self.0.recv().map_err(|_| StageError::Stopped)?;
        Ok(Some(line.line))
    }
}

#[test]
fn a_stream_waits_no_longer_than_requested() {
    let (permit, permitted) = std::sync::mpsc::sync_channel(1);
    let mut stream = stream(&[(&COUNT, "lines = 1")], Permitted(permitted));
    assert_eq!(stream.next_within(Duration::from_millis(1)).unwrap(), Next::Waiting);
    permit.send(()).unwrap();
    assert_eq!(drained(&mut stream).0, [0]);
}

#[test]
fn a_stream_that_is_closed_ends_its_run() {
    // More lines than any test could wait for.
    let mut stream = stream(&[(&COUNT, "lines = 4000000000"), (&WORK, "")], Groups::of(1));
    assert_eq!(stream.next_within(LONG).unwrap(), Next::Item(vec![0]));
    stream.close();
    assert_eq!(stream.next_within(LONG).unwrap(), Next::End);
    assert!(stream.summary().is_none());
}

#[test]
fn a_watch_has_the_progress_of_a_run_that_is_not_displayed() {
    let folder = tempfile::tempdir().unwrap();
    let job = job(&[(&COUNT, "lines = 10"), (&WRITE_NUMBERS, "")]);
    let watch = ProgressWatch::default();
    assert_eq!(watch.get(), (0.0, 0));
    let options = Options { watch: Some(watch.clone()), ..into(&job, folder.path()) };
    engine::run(&job, &options).unwrap();
    assert_eq!(watch.get(), (1.0, 30));
}

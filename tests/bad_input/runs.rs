//! Runs that are ended from outside.

use std::fs;
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use crate::support::Place;

/// A flight that takes hours, on its way into every kind of output.
const LONG: &str = "\
[[stage]]
type = 'simulate'
lines = 1000000
shots_per_line = 20
canopy_height_m = 0.0
truth = '*_truth.csv'
[[stage]]
type = 'write_arrow'
[[stage]]
type = 'calibrate'
waveforms = 300
[[stage]]
type = 'decompose'
[[stage]]
type = 'georeference'
[[stage]]
type = 'write_las'
path = '*.laz'
[[stage]]
type = 'write_table'
[[stage]]
type = 'write_lstat'
";

/// Starts a long run, and waits until it has begun all its outputs and written to some.
fn begin(place: &Place) -> Child {
    let child = place.command(LONG).stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
    let is_written =
        |name: &String| fs::metadata(place.path("out").join(name)).is_ok_and(|about| about.len() > 0);
    loop {
        let outputs = place.outputs();
        if outputs.iter().any(is_written) && outputs.len() >= 6 {
            return child;
        }
        std::thread::sleep(Duration::from_millis(20));
    }
}

#[cfg(unix)]
#[test]
fn a_signal_ends_a_run_in_order() {
    for signal in ["INT", "TERM", "HUP"] {
        let place = Place::new();
        let child = begin(&place);
        assert!(place.outputs().iter().all(|name| name.ends_with(".partial")), "{:?}", place.outputs());
        let killed =
            Command::new("kill").args([&format!("-{signal}"), &child.id().to_string()]).status().unwrap();
        assert!(killed.success());
        let output = child.wait_with_output().unwrap();
        let err = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(1), "SIG{signal}: {err}");
        assert_eq!(err, "error: interrupted; no unfinished output was left behind\n");
        assert_eq!(place.outputs(), Vec::<String>::new(), "SIG{signal}");
    }
}

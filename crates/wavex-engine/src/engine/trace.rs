//! Trace of a profiled run in Trace Event Format, for Perfetto and chrome://tracing.

use std::io::{self, Write};

use serde_json::{Value, json};

use super::summary::RunSummary;

/// Writes one track per worker and one slice per work interval.
///
/// Times are in microseconds from the first slice.
pub(super) fn write(run: &RunSummary, out: &mut dyn Write) -> io::Result<()> {
    let spans = || run.inputs.iter().flat_map(|input| &input.stages).flat_map(|stage| &stage.spans);
    let origin = spans().map(|span| span.start).min();
    write!(out, r#"{{"displayTimeUnit":"ms","traceEvents":["#)?;
    // One event at a time: the values of all events of a long run take 100 MB.
    let mut separator = "";
    let mut push = |event: Value| {
        out.write_all(std::mem::replace(&mut separator, ",").as_bytes())?;
        serde_json::to_writer(&mut *out, &event).map_err(io::Error::from)
    };
    let mut track = 0;
    for input in &run.inputs {
        for stage in &input.stages {
            for worker in 0..stage.workers {
                track += 1;
                let name = format!("{} {} #{worker}", input.stem, stage.id);
                push(
                    json!({"ph": "M", "name": "thread_name", "pid": 1, "tid": track, "args": {"name": name}}),
                )?;
                for span in stage.spans.iter().filter(|span| span.worker == worker) {
                    let start_us = origin.map_or(0.0, |origin| (span.start - origin).as_secs_f64() * 1e6);
                    let length_us = span.length.as_secs_f64() * 1e6;
                    push(json!({
                        "ph": "X", "name": stage.r#type, "pid": 1, "tid": track, "ts": start_us, "dur": length_us
                    }))?;
                }
            }
        }
    }
    writeln!(out, "]}}")
}

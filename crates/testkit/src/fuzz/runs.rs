//! Small runs of jobs on recordings.

use std::fs;
use std::path::{Path, PathBuf};
use wavex::registry::STAGES;

use wavex::engine::{self, Cause, Options, RunError, RunSummary};
use wavex::inspect::{self, Inspection, RecordingSummary};
use wavex::job::{Job, Override};
use wavex::recording::Recording;
use wavex::scan_line::ScanLine;
use wavex_formats::las::RawPoints;
use wavex_formats::sdf::{SdfReader, SdfRecord};

use super::{Files, parts};

/// Names the library with any values, for programs that cargo does not build with it.
const LIBRARY_VARIABLE: &str = "WAVEX_FUZZ_SDF";
/// Largest recording, bytes; the time of a run grows with it.
const MOST_BYTES: usize = 1 << 17;
/// Most records or lines that are read.
const MOST_RECORDS: usize = 2_000;

/// End of a job that decomposes and writes points; `KEYS` are the keys of `calibrate`.
const TO_POINTS: &str = "\
[[stage]]
type = 'resolve_mta'
[[stage]]
type = 'write_arrow'
path = 'copy.arrow'
[[stage]]
type = 'calibrate'
KEYS
[[stage]]
type = 'decompose'
[[stage]]
type = 'correct'
[[stage]]
type = 'filter_outliers'
[[stage]]
type = 'georeference'
[[stage]]
type = 'write_las'
path = 'points.laz'
[[stage]]
type = 'write_table'
path = 'points.csv'
[[stage]]
type = 'write_lstat'
";

/// A recording, as container, LAS or PulseWaves, its companion, and a sensor model.
///
/// Without a sensor model the job calibrates with the recording.
pub fn run(bytes: &[u8]) {
    let parts = parts(bytes);
    if parts[0].len() > MOST_BYTES {
        return;
    }
    let place = Files::new();
    let Some((reader, recording)) = write(&place, &parts) else { return };
    let stages = |keys: &str| {
        format!("[[stage]]\ntype = '{reader}'\npath = '{recording}'\n{}", TO_POINTS.replace("KEYS", keys))
    };
    match parts.get(2) {
        Some(model) => {
            place.write("model.json", model);
            points(&place, &stages("load = 'model.json'"));
        }
        None => points(&place, &stages("waveforms = 200")),
    }
}

/// Writes a recording and its companion; returns the reader and the name.
fn write(place: &Files, parts: &[&[u8]]) -> Option<(&'static str, &'static str)> {
    let (reader, name, companion) = match parts[0] {
        bytes if bytes.starts_with(b"LASF") => ("read_las", "a.las", "a.wdp"),
        bytes if bytes.starts_with(b"PulseWavesPulse") => ("read_pulsewaves", "a.pls", "a.wvs"),
        bytes if bytes.starts_with(b"ARROW1") => ("read_arrow", "a.arrow", ""),
        _ => return None,
    };
    place.write(name, parts[0]);
    if let Some(bytes) = parts.get(1)
        && !companion.is_empty()
    {
        place.write(companion, bytes);
    }
    Some((reader, name))
}

/// Decomposed lines, from which points are made.
pub fn returns(bytes: &[u8]) {
    if bytes.len() > MOST_BYTES {
        return;
    }
    let place = Files::with(&[("a_decomposed.arrow", bytes)]);
    let (_, after) = TO_POINTS.split_once("type = 'decompose'\n").unwrap();
    points(&place, &format!("[[stage]]\ntype = 'read_returns'\npath = 'a_decomposed.arrow'\n{after}"));
}

/// Runs a job of these stages and checks its outputs.
fn points(place: &Files, stages: &str) {
    let job = Job::parse(STAGES, "job.toml", stages, &[]).unwrap_or_else(|errors| panic!("{errors}"));
    if let Ok(summary) = run_job(&job, place) {
        let path = place.path("out/points.laz");
        let mut points = RawPoints::open(&path).unwrap();
        let mut n_points = 0;
        while points.next_record().unwrap().is_some() {
            n_points += 1;
        }
        assert_eq!(n_points, points.header().n_points);
        assert!(place.path("out/points.csv").is_file() && summary.inputs.len() == 1);
    }
}

/// Runs a job with one worker; a failed run leaves no outputs.
fn run_job(job: &Job, place: &Files) -> Result<RunSummary, RunError> {
    let output_dir = place.path("out");
    let mut options = Options::of_job(job, place.path(""), &output_dir);
    options.threads = 1;
    let done = engine::run(job, &options);
    if let Err(error) = &done {
        assert!(!matches!(error.cause, Cause::Panic(_) | Cause::Interrupted), "{error}");
        let left: Vec<_> = fs::read_dir(&output_dir).into_iter().flatten().flatten().collect();
        assert!(left.is_empty(), "{error}, and {left:?} is left");
    }
    done
}

/// A recording and its companion, read at random and inspected.
pub fn recording(bytes: &[u8]) {
    let parts = parts(bytes);
    if parts[0].len() > MOST_BYTES {
        return;
    }
    let place = Files::new();
    let Some((_, name)) = write(&place, &parts) else { return };
    let path = place.path(name);
    let Ok(mut recording) = Recording::open(STAGES, &path, &[]) else { return };
    let mut inspection = Inspection::new(true);
    let mut first: Option<ScanLine> = None;
    if let Ok(index) = recording.index(&mut |_| Ok(())) {
        for number in 0..index.lines().len().min(MOST_RECORDS) {
            let Ok(Some(line)) = recording.line(number) else { continue };
            inspection.add(&line);
            let (found, expected) = (line.emissions.len(), index.lines()[number].shots as usize);
            // Whether the waves of a pulse can be read is known only once they are read.
            let is_as_indexed = if name == "a.pls" { found <= expected } else { found == expected };
            assert!(is_as_indexed, "{found} shots of line {number} instead of {expected}");
            first.get_or_insert(line);
        }
        let shot = first.as_ref().and_then(|line| line.emissions.first()).map(|emission| emission.shot);
        if let Some(shot) = shot {
            let line = recording.line_of_shot(shot);
            assert!(matches!(&line, Ok(Some(line)) if line.emissions.iter().any(|e| e.shot == shot)));
        }
        let _ = recording.nearest_shot(0.0);
    }
    inspection.finish();
    let counters = recording.context().counters();
    let summary = RecordingSummary::of(Path::new(name), &inspection, counters, None);
    assert!(!summary.text().is_empty());
    let html = inspect::page(&summary, &inspection, counters, None);
    assert!(html.len() < 20_000_000, "a page of {} bytes", html.len());
    let _ = inspect::histogram_files(&inspection);
}

/// Values that a library returns for an SDF file.
///
/// `examples/sdf_any_values` reads them from the file.
pub fn sdf(bytes: &[u8]) {
    let place = Files::with(&[("250506_100000.sdf", bytes)]);
    let path = place.path("250506_100000.sdf");
    let library = library();
    if let Ok(mut reader) = SdfReader::open(&path, Some(&library), None, &|_| ()) {
        let (tables, _) = reader.tables();
        assert!(tables.amplitude_low.len() <= 1 << 16);
        let mut record = SdfRecord::default();
        let mut count = 0;
        while count < MOST_RECORDS {
            count += 1;
            match reader.next(&mut record) {
                Ok(true) => {
                    let samples: usize = record.blocks.iter().map(|block| record.samples(block).len()).sum();
                    assert_eq!(samples, record.n_samples());
                }
                _ => break,
            }
        }
        let _ = (reader.seek(1), reader.seek_time(1.0), reader.seek_time_external(f64::NAN));
        let _ = (reader.next(&mut record), reader.next_record());
    }
    let stages = "[[stage]]\ntype = 'read_sdf'\npath = '250506_100000.sdf'\n\
                  [[stage]]\ntype = 'write_arrow'\npath = 'copy.arrow'\n";
    let library = Override::new(format!("read_sdf.library={}", library.display()));
    let job = Job::parse(STAGES, "job.toml", stages, &[library]).unwrap_or_else(|errors| panic!("{errors}"));
    let _ = run_job(&job, &place);
}

/// Path of the library with any values.
fn library() -> PathBuf {
    let named = std::env::var_os(LIBRARY_VARIABLE).map(PathBuf::from);
    named.unwrap_or_else(|| {
        let (before, after) = (std::env::consts::DLL_PREFIX, std::env::consts::DLL_SUFFIX);
        crate::built(&format!("examples/{before}sdf_any_values{after}"))
    })
}

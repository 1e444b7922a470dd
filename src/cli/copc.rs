//! `wavex copc`: converts points to a cloud-optimised point cloud.

use std::collections::BTreeSet;
use std::io::{Read, Write};
use std::path::{Path, PathBuf};

use super::{Failure, terminal};
use wavex_engine::engine::{Phase, ProgressMode};
use wavex_formats::extensions::{LAZ, has_extension};
use wavex_formats::las::{CopcSummary, indexes_beside, write_copc};
use wavex_formats::{Error, RecordingFormat};
use wavex_line::stage::{FinishedFile, OutputFile, OutputLock, Outputs};
use wavex_stages::stac;

/// Maximum number of sorted runs, claimed in advance.
///
/// Enough for 3e9 points of 40 bytes.
const CLAIMED_RUNS: usize = 512;

/// Converts each input; among several, those that are COPC already are left out.
pub(super) fn copc_each(
    inputs: &[PathBuf],
    out: Option<PathBuf>,
    with_item: bool,
    progress: ProgressMode,
    quiet: bool,
) -> Result<(), Failure> {
    if let [input] = inputs {
        return copc(input, out, with_item, progress, quiet);
    }
    if let Some(out) = out {
        let problem =
            "--out is the name of one file; leave it out, and each COPC file is written next to its input";
        return Err(Failure::Wrong(format!("{}: {problem}", out.display())));
    }
    let is_copc = |path: &Path| path.file_stem().is_some_and(|stem| has_extension(Path::new(stem), "copc"));
    let points = inputs.iter().filter(|input| !is_copc(input));
    points.into_iter().try_for_each(|input| copc(input, None, with_item, progress, quiet))
}

/// Writes the points of `input` to `out`, which appears only when complete; on request with a STAC item.
fn copc(
    input: &Path,
    out: Option<PathBuf>,
    with_item: bool,
    progress: ProgressMode,
    quiet: bool,
) -> Result<(), Failure> {
    if RecordingFormat::of(input).is_some_and(|format| format.reader != "read_las") {
        return Err(Failure::Wrong(recording_without_points(input)));
    }
    let out = out.unwrap_or_else(|| input.with_extension("copc.laz"));
    check_name(input, &out).map_err(Failure::Wrong)?;
    let folder = out.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    // The claim lets a later process remove what a killed process left.
    let item = with_item.then(|| stac::item_path(&out));
    let runs = (0..CLAIMED_RUNS).map(|number| run_path(&out, number));
    let written = runs.chain([out.clone()]).chain(item.clone());
    let claimed = Outputs::from([(folder.to_path_buf(), written.collect::<BTreeSet<_>>())]);
    let lock = OutputLock::acquire(&claimed).map_err(|error| Failure::Run(error.to_string()))?;
    let written = write(input, &out, item.as_deref(), progress);
    let (summary, has_item) = written.map_err(|error| Failure::Run(error.to_string()))?;
    drop(lock);
    summary.crs_problems.iter().for_each(|problem| tracing::warn!("{problem}"));
    if with_item && !has_item {
        tracing::warn!("{}", stac::NO_DATE);
    }
    if quiet { Ok(()) } else { terminal::print(&summary_text(&out, &summary)) }
}

/// The answer to a recording in place of points.
fn recording_without_points(input: &Path) -> String {
    let job = input.with_extension("toml");
    let job = Path::new(job.file_name().unwrap_or_default()).display();
    format!(
        "{}: a recording has no points before a run; write its job with `wavex init --from {0} {job}`, run it with \
         `wavex run {job}`, and give the LAS or LAZ that it writes",
        input.display()
    )
}

fn check_name(input: &Path, out: &Path) -> Result<(), String> {
    if !has_extension(out, LAZ) {
        return Err(format!("{}: COPC is LAZ; give a name that ends in .copc.laz", out.display()));
    }
    let real = |path: &Path| path.canonicalize().ok();
    match (real(input), real(out)) {
        (Some(input), Some(there)) if input == there => {
            Err(format!("{}: this is the input; give another name with --out", out.display()))
        }
        _ => Ok(()),
    }
}

/// Writes the points, and the item if it has a path; returns whether there is an item.
fn write(
    input: &Path,
    out: &Path,
    item: Option<&Path>,
    progress: ProgressMode,
) -> Result<(CopcSummary, bool), Error> {
    let mut file = OutputFile::create(out)?;
    // Runs are removed when dropped.
    let mut runs: Vec<FinishedFile> = Vec::new();
    let mut keep = |run: &[u8]| {
        let path = run_path(out, runs.len());
        let mut file = OutputFile::create(&path)?;
        file.write_all(run).map_err(Error::io(&path, "write"))?;
        let whole = file.finish()?;
        let input = whole.open().map_err(Error::io(&path, "open"))?;
        runs.push(whole);
        Ok(Box::new(input) as Box<dyn Read>)
    };
    let stem = input.file_stem().unwrap_or_default().to_string_lossy();
    let mut phase = Phase::new("copc", "converting", progress, 1);
    let mut watch = |part| phase.show(&stem, 0, part);
    let summary = write_copc(input, &mut file, out, &mut keep, &mut watch)?;
    drop(phase);
    let points = file.finish()?;
    let item = item.map(|path| finish_item(path, &points, &summary)).transpose()?.flatten();
    let has_item = item.is_some();
    let stale = indexes_beside(out).into_iter().chain(item.iter().map(|item| item.path().to_path_buf()));
    points.replacing(stale.collect::<Vec<_>>()).publish()?;
    item.map(FinishedFile::publish).transpose()?;
    Ok((summary, has_item))
}

/// Completes the STAC item of complete points; `None` if they have no date.
fn finish_item(
    path: &Path,
    points: &FinishedFile,
    summary: &CopcSummary,
) -> Result<Option<FinishedFile>, Error> {
    let about = stac::describe(points)?;
    let (wkt, times_s) = (about.crs().wkt, Some(summary.times_s).filter(|times_s| *times_s != [0.0; 2]));
    if !stac::names_system(wkt.as_deref()) {
        tracing::warn!("{}", stac::NO_SYSTEM);
    }
    let points = stac::ItemPoints { about: &about, path: points.path(), wkt: wkt.as_deref(), times_s };
    stac::finish(OutputFile::create(path)?, &points)
}

/// Path of a sorted run.
fn run_path(out: &Path, number: usize) -> PathBuf {
    let name = out.file_name().unwrap_or_default().to_string_lossy();
    out.with_file_name(format!("{name}.sorted_{number}"))
}

fn summary_text(out: &Path, summary: &CopcSummary) -> String {
    let without = if summary.is_without_waveforms { ", without their waveforms" } else { "" };
    let plural = |n: u64| if n == 1 { "" } else { "s" };
    format!(
        "wrote {}: {} point{}{without}, {} node{} on {} level{}\n",
        out.display(),
        summary.n_points,
        plural(summary.n_points),
        summary.n_nodes,
        plural(summary.n_nodes as u64),
        summary.n_levels,
        plural(summary.n_levels.into()),
    )
}

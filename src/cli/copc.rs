//! `wavex copc`: converts points to a cloud-optimised point cloud.

use std::collections::BTreeSet;
use std::io::{Read, Write};
use std::path::{Path, PathBuf};

use super::{Failure, terminal};
use crate::engine::{Phase, ProgressMode};
use crate::stage::{FinishedFile, OutputFile, OutputLock, Outputs};
use wavex_formats::Error;
use wavex_formats::las::{CopcSummary, indexes_beside, write_copc};

/// Maximum number of sorted runs, claimed in advance.
///
/// Enough for 3e9 points of 40 bytes.
const CLAIMED_RUNS: usize = 512;

/// Writes the points of `input` to `out`, which appears only when complete.
pub(super) fn copc(
    input: &Path,
    out: Option<PathBuf>,
    progress: ProgressMode,
    quiet: bool,
) -> Result<(), Failure> {
    let out = out.unwrap_or_else(|| input.with_extension("copc.laz"));
    check_name(input, &out).map_err(Failure::Wrong)?;
    let folder = out.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    // The claim lets a later process remove what a killed process left.
    let written = (0..CLAIMED_RUNS).map(|number| run_path(&out, number)).chain([out.clone()]);
    let claimed = Outputs::from([(folder.to_path_buf(), written.collect::<BTreeSet<_>>())]);
    let lock = OutputLock::acquire(&claimed).map_err(|error| Failure::Run(error.to_string()))?;
    let summary = write(input, &out, progress).map_err(|error| Failure::Run(error.to_string()))?;
    drop(lock);
    if quiet { Ok(()) } else { terminal::print(&summary_text(&out, &summary)) }
}

fn check_name(input: &Path, out: &Path) -> Result<(), String> {
    let extension = out.extension().unwrap_or_default();
    if !extension.eq_ignore_ascii_case("laz") {
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

fn write(input: &Path, out: &Path, progress: ProgressMode) -> Result<CopcSummary, Error> {
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
    file.finish()?.replacing(indexes_beside(out)).publish()?;
    Ok(summary)
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

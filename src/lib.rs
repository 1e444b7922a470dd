//! Open engine that turns full-waveform lidar recordings into point clouds.
//!
//! `ARCHITECTURE.md` describes the structure of the crate. `docs/stages.md` and `wavex stages`
//! document the stages.
//!
//! ```
//! use wavex::engine::{self, Options};
//! use wavex::job::Job;
//! use wavex::registry::STAGES;
//!
//! let text = "
//! [[stage]]
//! type = 'simulate'
//! lines = 2
//! shots_per_line = 100
//!
//! [[stage]]
//! type = 'write_arrow'
//! path = 'flight.arrow'
//! ";
//! let job = Job::parse(STAGES, "flight.toml", text, &[])?;
//! let folder = tempfile::tempdir()?;
//! let run = engine::run(&job, &Options::of_job(&job, ".", folder.path()))?;
//! assert!(run.inputs[0].totals["nw"] >= 200);
//! assert!(folder.path().join("flight.arrow").is_file());
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

use std::path::Path;

pub mod cli;

pub use wavex_classic as classic;
pub use wavex_engine::{engine, job, recording};
pub use wavex_line::{georef, keys, plausibility, reason, scan_line, stage};
pub use wavex_pages::{inspect, report, view};
pub use wavex_run::{Failure, align, archive, classify, cluster, explain, job_file, run};
pub use wavex_stages as stages;
pub use wavex_stages::{checks, registry};

/// Opens a recording of any supported format, recognised by its extension.
///
/// ```no_run
/// for line in wavex::open("flight7.pls".as_ref())?.scan_lines()? {
///     let line = line?;
///     println!("line {}: {} shots", line.line, line.emissions.len());
/// }
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// The format is unknown, or the file cannot be read or has no shots.
pub fn open(path: &Path) -> Result<recording::Recording, recording::OpenError> {
    recording::Recording::open(registry::STAGES, path, &[])
}

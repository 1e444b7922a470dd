//! Open engine that turns full-waveform lidar recordings into point clouds.
//!
//! `ARCHITECTURE.md` describes the structure of the crate. `docs/stages.md` and `wavex stages`
//! document the stages.
//!
//! ```
//! use wavex::engine::{self, Options};
//! use wavex::job::Job;
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
//! let job = Job::parse("flight.toml", text, &[])?;
//! let folder = tempfile::tempdir()?;
//! let run = engine::run(&job, &Options::of_job(&job, ".", folder.path()))?;
//! assert!(run.inputs[0].totals["nw"] >= 200);
//! assert!(folder.path().join("flight.arrow").is_file());
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

pub mod archive;
pub mod checks;
pub mod cli;
pub mod cluster;
pub mod engine;
mod explain;
pub mod georef;
pub mod inspect;
pub mod job;
pub mod keys;
pub mod plausibility;
mod printable;
pub mod reason;
pub mod recording;
pub mod registry;
pub mod report;
pub mod scan_line;
pub mod stage;
pub mod stages;
mod system;
pub mod view;

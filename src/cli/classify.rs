//! `wavex classify`: classifies the ground of clouds of points.

use std::io::IsTerminal;

use super::align::print;
use super::args::ClassifyArgs;
use super::{Failure, run};
use wavex_engine::engine::Cancel;
use wavex_run::classify::{ClassifyRequest, GroundSettings, TerrainRequest, classify_clouds, write_terrain};

/// Classifies, writes the copies, prints the points of each class.
pub(super) fn classify(args: &ClassifyArgs, quiet: bool) -> Result<(), Failure> {
    let cancel = Cancel::default();
    run::stop_on_signals(&cancel, run::end_run);
    if let Some(path) = &args.dem {
        let is_tiff = path
            .extension()
            .is_some_and(|end| ["tif", "tiff"].iter().any(|tif| end.eq_ignore_ascii_case(tif)));
        if !is_tiff {
            let path = path.display();
            return Err(Failure::Wrong(format!(
                "{path}: the terrain model is a GeoTIFF; give a name with .tif"
            )));
        }
    }
    let classified = classify_clouds(&ClassifyRequest {
        inputs: &args.inputs,
        output: &args.output,
        kept_classes: &args.keep,
        settings: GroundSettings::default(),
        memory_mb: args.memory_mb,
        threads: args.threads,
        report: args.report.as_deref(),
        progress: args.progress.mode(quiet, std::io::stderr().is_terminal()),
        cancel: cancel.clone(),
    })?;
    print(&classified.warnings, &classified.written, &classified.text, quiet)?;
    if let Some(path) = &args.dem {
        let request = TerrainRequest { path, cell_m: args.cell, threads: args.threads, cancel };
        let terrain = write_terrain(&classified.ground, &request)?;
        print(&terrain.warnings, &[terrain.path], &terrain.text, quiet)?;
    }
    classified.failure.map_or(Ok(()), Err)
}

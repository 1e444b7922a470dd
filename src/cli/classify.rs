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
    let rasters = [("terrain", &args.dem), ("surface", &args.surface), ("canopy", &args.canopy)];
    let mut seen = Vec::new();
    for (name, path) in rasters.into_iter().filter_map(|(name, path)| Some((name, path.as_ref()?))) {
        let is_tiff = path
            .extension()
            .is_some_and(|end| ["tif", "tiff"].iter().any(|tif| end.eq_ignore_ascii_case(tif)));
        let problem = match is_tiff {
            false => format!("the {name} model is a GeoTIFF; give a name with .tif"),
            true if seen.contains(&path) => "two models would have this name; give each its own".to_owned(),
            true => String::new(),
        };
        if !problem.is_empty() {
            return Err(Failure::Wrong(format!("{}: {problem}", path.display())));
        }
        seen.push(path);
    }
    let classified = classify_clouds(&ClassifyRequest {
        inputs: &args.inputs,
        output: &args.output,
        kept_classes: &args.keep,
        settings: GroundSettings::default(),
        surface_cell_m: args.surface.as_ref().or(args.canopy.as_ref()).map(|_| args.cell),
        memory_mb: args.memory_mb,
        threads: args.threads,
        report: args.report.as_deref(),
        progress: args.progress.mode(quiet, std::io::stderr().is_terminal()),
        cancel: cancel.clone(),
    })?;
    print(&classified.warnings, &classified.written, &classified.text, quiet)?;
    if let Some(path) = &args.dem {
        let request = TerrainRequest {
            path,
            surface: args.surface.as_deref(),
            canopy: args.canopy.as_deref(),
            cell_m: args.cell,
            threads: args.threads,
            cancel,
        };
        let terrain = write_terrain(&classified.ground, &request)?;
        print(&terrain.warnings, &terrain.written, &terrain.text, quiet)?;
    }
    classified.failure.map_or(Ok(()), Err)
}

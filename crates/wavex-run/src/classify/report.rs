//! Results of a classification for programs: `wavex classify --report`.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::Serialize;
use wavex_engine::build;

use super::files::{ClassCounts, Cloud};
use super::text::{n_ground, percent};
use super::{ClassifyRequest, CloudResult};

/// Report of `wavex classify`.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub struct ClassifyReport {
    /// Version of this format.
    pub version: u32,
    /// Version of wavex.
    pub wavex: &'static str,
    /// Commit of wavex.
    pub commit: &'static str,
    /// Classes of points that stay as they are.
    pub kept_classes: Vec<u8>,
    /// Clouds in the order of their paths.
    pub clouds: Vec<ClassifiedCloud>,
    /// Clouds that were left out, with problem and remedy.
    pub failures: Vec<String>,
}

/// A classified cloud.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub struct ClassifiedCloud {
    /// The file.
    pub file: String,
    /// Its copy with other classes.
    pub output: String,
    /// Number of points.
    pub points: u64,
    /// Number of points with another class than before.
    pub changed_points: u64,
    /// Share of the points that is ground, from 0 to 1.
    pub ground_ratio: f64,
    /// Number of points of each class of the file.
    pub classes_before: BTreeMap<u8, u64>,
    /// Number of points of each class of the copy.
    pub classes_after: BTreeMap<u8, u64>,
    /// Points that keep their class.
    pub left_alone: PointsLeftAlone,
}

/// Points of a cloud that keep their class, by reason.
#[derive(Clone, Copy, Debug, Serialize, JsonSchema)]
pub struct PointsLeftAlone {
    /// Withheld or synthetic.
    pub withheld_or_synthetic: u64,
    /// Noise according to the file.
    pub noise: u64,
    /// Of the classes to keep.
    pub kept_classes: u64,
    /// Class 12 of point formats 0 to 5, which marks the overlap of strips.
    pub overlap: u64,
}

/// Makes the report.
pub(super) fn report(
    request: &ClassifyRequest<'_>,
    rows: &[(&Cloud, CloudResult)],
    failures: &[String],
) -> ClassifyReport {
    let classes = |counts: &ClassCounts| {
        (0..=u8::MAX).zip(counts).filter(|(_, n)| **n > 0).map(|(class, n)| (class, *n)).collect()
    };
    let cloud = |(cloud, result): &(&Cloud, CloudResult)| ClassifiedCloud {
        file: cloud.path.display().to_string(),
        output: cloud.output.display().to_string(),
        points: result.copy.n_points,
        changed_points: result.copy.n_changed,
        ground_ratio: percent(n_ground(&result.after), result.copy.n_points) / 100.0,
        classes_before: classes(&result.before),
        classes_after: classes(&result.after),
        left_alone: PointsLeftAlone {
            withheld_or_synthetic: result.left.n_withheld,
            noise: result.left.n_noise,
            kept_classes: result.left.n_kept,
            overlap: result.left.n_overlap,
        },
    };
    ClassifyReport {
        version: 1,
        wavex: build::VERSION,
        commit: build::COMMIT,
        kept_classes: request.kept_classes.to_vec(),
        clouds: rows.iter().map(cloud).collect(),
        failures: failures.to_vec(),
    }
}

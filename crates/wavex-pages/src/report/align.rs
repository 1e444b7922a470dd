//! Results of a strip alignment: report (`align.json`), residuals (`residuals.arrow`) and page (`align.html`).

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use wavex_align::estimable::Verdict;

mod control;
mod figures;
mod page;
mod residual_map;
mod residuals;
mod trajectory_sds;

pub use control::{ControlPointReport, ControlReport, ControlStrip, ControlUse};
pub use page::page;
pub use residuals::{residual_batches, write_residuals};
pub use trajectory_sds::{SdFactor, TrajectorySds};

/// Version of the report.
pub const VERSION: u32 = 1;

/// Report of a strip alignment (`align.json`).
///
/// Names carry units. What is unknown is `null`.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
pub struct AlignReport {
    /// Version of this format.
    pub version: u32,
    /// Version of wavex.
    pub wavex: String,
    /// Commit of wavex.
    pub commit: String,
    /// Name of the job.
    pub job: String,
    /// Form of the corrections of trajectories.
    pub trajectory_model: TrajectoryForm,
    /// Rating.
    pub verdict: AlignVerdict,
    /// Reasons of a verdict that is not good.
    pub problems: Vec<String>,
    /// What to do if the verdict is not good.
    pub remedy: Option<String>,
    /// Strips that were left out or not aligned, and other notes.
    pub warnings: Vec<String>,
    /// Installations of the jobs; none for a single job.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub installations: Vec<AlignedInstallation>,
    /// Parameters of each installation.
    pub parameters: Vec<AlignedParameter>,
    /// Covariance of the parameters that are not given.
    pub covariance: Covariance,
    /// Correlations above 0.9.
    pub correlations: Vec<ParameterCorrelation>,
    /// Strips in the order of the inputs, without failed ones.
    pub strips: Vec<AlignedStrip>,
    /// Inputs that could not be used.
    pub failed_strips: Vec<FailedStrip>,
    /// Differences of the strips that overlap.
    pub overlaps: Vec<Overlap>,
    /// Robust SD of all differences with the start values, m; `null` if strips were too far apart for pairs.
    pub spread_before_m: Option<f64>,
    /// Robust SD of all differences with the results, m.
    pub spread_after_m: Option<f64>,
    /// Robust SD of the differences over their stated SDs.
    pub residual_scale: f64,
    /// Number of unknowns.
    pub unknowns: usize,
    /// Number of pairs of patches, used and rejected.
    pub pairs: usize,
    /// Rejected pairs.
    pub rejected_pairs: usize,
    /// What the pairs show of the flight.
    pub flight: Flight,
    /// Trajectories that were read.
    pub trajectories: Vec<FileDigest>,
    /// Calibration file of the start values, if the job names one.
    pub calibration: Option<FileDigest>,
    /// Control points, if given.
    pub control: Option<ControlReport>,
    /// Names of strips whose trajectories are not corrected.
    pub reference_strips: Vec<String>,
    /// Factors of the SDs of the trajectories.
    pub trajectory_sds: Option<TrajectorySds>,
    /// Errors that corrections of the trajectories cannot follow; absent if there are none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub shared_errors: Option<SharedErrors>,
}

/// Errors that pairs of the same time share, because trajectories change faster than their corrections.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
pub struct SharedErrors {
    /// Factor by which the SDs of all pairs were raised.
    pub sd_factor: f64,
    /// Length of the intervals in which they were found, s.
    pub interval_s: f64,
    /// Variances of sums of residuals over those of independent ones: north, east, down, roll, pitch, heading.
    pub variance_ratios: [f64; 6],
}

/// A job of an alignment with several.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
pub struct AlignedInstallation {
    /// Name, that of the folder of its calibration and corrections.
    pub name: String,
    /// Name of the job.
    pub job: String,
    /// Calibration file of the start values, if the job names one.
    pub calibration: Option<FileDigest>,
}

/// Rating of an alignment.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum AlignVerdict {
    /// The remaining differences are noise.
    Good,
    /// The result needs a person's check.
    Doubtful,
    /// The result must not be used.
    Bad,
}

impl AlignVerdict {
    /// Word of the report.
    pub fn word(self) -> &'static str {
        match self {
            AlignVerdict::Good => "good",
            AlignVerdict::Doubtful => "doubtful",
            AlignVerdict::Bad => "bad",
        }
    }
}

impl From<Verdict> for AlignVerdict {
    fn from(verdict: Verdict) -> AlignVerdict {
        match verdict {
            Verdict::Good => AlignVerdict::Good,
            Verdict::Doubtful => AlignVerdict::Doubtful,
            Verdict::Bad => AlignVerdict::Bad,
        }
    }
}

/// Form of the corrections of trajectories.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(untagged)]
pub enum TrajectoryForm {
    /// One form for each strip as a whole.
    Word(TrajectoryWord),
    /// Linear between knots at most this far apart, s.
    KnotsEvery(f64),
}

/// Form of the corrections of a strip's trajectory as a whole.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum TrajectoryWord {
    /// No corrections.
    None,
    /// One offset.
    Constant,
    /// Linear in time.
    Linear,
}

/// How a parameter was treated.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ParameterTreatment {
    /// Kept: its start value has no SD.
    Given,
    /// Estimated.
    Estimated,
    /// Left at its start value: the flight says less about it than was known before.
    NotEstimable,
    /// Changed, but only a combination with other parameters is determined.
    OnlyCombined,
}

/// A parameter of the installation, in the unit of its name.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
pub struct AlignedParameter {
    /// Name with unit.
    pub name: String,
    /// Installation; absent for a single job.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub installation: Option<String>,
    /// Start value.
    pub start: f64,
    /// Value after alignment.
    pub value: f64,
    /// Larger of the formal SD and that of the jackknife; that of the start value if not estimable.
    pub sd: f64,
    /// SD from the inverse of the normal matrix.
    pub formal_sd: f64,
    /// SD from the scatter between tiles of the ground.
    pub jackknife_sd: f64,
    /// SD of the start value; 0 if given.
    pub prior_sd: f64,
    /// How it was treated.
    pub treatment: ParameterTreatment,
    /// Why the flight does not determine it, and what to fly.
    pub reasons: Vec<NotDetermined>,
}

impl AlignedParameter {
    /// Change in SDs of the start value; `None` for a given one.
    pub(crate) fn change_sds(&self) -> Option<f64> {
        (self.prior_sd > 0.0).then(|| (self.value - self.start).abs() / self.prior_sd)
    }
}

/// Reason why a flight does not determine a parameter.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
pub struct NotDetermined {
    /// Cause.
    pub cause: String,
    /// What to fly.
    pub remedy: String,
}

/// Covariance matrix: formal correlations, variances of the stated SDs.
#[derive(Clone, Debug, Default, PartialEq, Deserialize, Serialize, JsonSchema)]
pub struct Covariance {
    /// Names of the parameters of rows and columns, with units.
    pub parameters: Vec<String>,
    /// Rows of the matrix.
    pub matrix: Vec<Vec<f64>>,
}

/// Correlation of two parameters.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
pub struct ParameterCorrelation {
    /// Names.
    pub parameters: [String; 2],
    /// Correlation, -1 to 1.
    pub correlation: f64,
}

/// A strip with its corrections.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
pub struct AlignedStrip {
    /// Stem of the recording, after installation and `/` if there are several jobs.
    pub name: String,
    /// Installation; absent for a single job.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub installation: Option<String>,
    /// Path of the recording.
    pub recording: String,
    /// Size of the recording, bytes; `null` if it could not be read again.
    pub bytes: Option<u64>,
    /// BLAKE3 digest of the recording, 64 hexadecimal digits; `null` if it could not be read again.
    pub blake3: Option<String>,
    /// Path of its trajectory.
    pub trajectory: Option<String>,
    /// First shot, s on the axis of the trajectory.
    pub first_s: f64,
    /// Last shot, s on the axis of the trajectory.
    pub last_s: f64,
    /// Shots with a pose.
    pub shots: u64,
    /// Patches of smooth surface.
    pub patches: usize,
    /// Cells with too few returns.
    pub sparse_cells: u64,
    /// Cells with several returns per shot.
    pub cells_of_several_returns: u64,
    /// Cells that are too rough.
    pub rough_cells: u64,
    /// Patches that were dropped, because the strip has more than are needed.
    pub thinned_patches: u64,
    /// Pairs with other strips; 0: the strip is not aligned.
    pub pairs: usize,
    /// Patches outside of the trajectory.
    pub patches_without_pose: usize,
    /// SDs of the trajectory: north, east, down, m, roll, pitch, heading, rad.
    pub prior_sds: [f64; 6],
    /// Corrections; linear between knots, constant before the first and after the last.
    pub knots: Vec<Knot>,
}

/// Correction of a trajectory at a time.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
pub struct Knot {
    /// Time on the axis of the trajectory, s.
    pub time_s: f64,
    /// Offset of the position, m.
    pub north_east_down_m: [f64; 3],
    /// Offset of the attitude, rad.
    pub roll_pitch_heading_rad: [f64; 3],
    /// SDs of the six offsets, m and rad.
    pub sds: [f64; 6],
}

/// An input that could not be used.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
pub struct FailedStrip {
    /// Stem of the recording.
    pub name: String,
    /// Problem and remedy.
    pub problem: String,
}

/// Differences of two strips along the normals of the surface, first minus second.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
pub struct Overlap {
    /// Names of the strips.
    pub strips: [String; 2],
    /// Pairs, used and rejected.
    pub pairs: usize,
    /// Rejected pairs.
    pub rejected_pairs: usize,
    /// Median with the start values, m; `null` if the strips were too far apart for pairs.
    pub median_before_m: Option<f64>,
    /// Median with the results, m; `null` if all pairs are rejected.
    pub median_after_m: Option<f64>,
    /// Robust SD about zero with the start values, m.
    pub spread_before_m: Option<f64>,
    /// Robust SD about zero with the results, m.
    pub spread_after_m: Option<f64>,
}

/// What the pairs show of the flight.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
pub struct Flight {
    /// Largest angle between the courses of two overlapping strips, 0 to 90 degrees.
    pub crossing_deg: f64,
    /// The same, 0 to 180 degrees: opposite strips.
    pub turn_deg: f64,
    /// Part of the pairs on slopes above 10 %.
    pub sloped_ratio: f64,
    /// Smallest and largest range, m; `null` without pairs.
    pub ranges_m: Option<[f64; 2]>,
    /// Largest difference of the scan angles of a pair, degrees.
    pub scan_angle_difference_deg: f64,
    /// Pairs of different receivers.
    pub receiver_pairs: usize,
}

/// A file that was read.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
pub struct FileDigest {
    /// Path.
    pub path: String,
    /// Size, bytes; `null` if it could not be read again.
    pub bytes: Option<u64>,
    /// BLAKE3 digest, 64 hexadecimal digits; `null` if it could not be read again.
    pub blake3: Option<String>,
}

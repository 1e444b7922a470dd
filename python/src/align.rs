//! Alignment of the strips of a survey.

use std::path::PathBuf;
use std::sync::Arc;

use arrow_array::{ArrayRef, Float64Array, RecordBatch, StringArray, UInt64Array};
use arrow_schema::ArrowError;
use numpy::{IntoPyArray, PyArray2, PyArrayMethods};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyList};

use wavex::align::{AlignConstraints, AlignJob, AlignRequest, Aligned, OptionalParameter, TrajectoryModel};
use wavex::engine::{Cancel, ProgressMode};
use wavex::report::align::{
    AlignReport, AlignedParameter, AlignedStrip, Knot, Overlap, ParameterTreatment, residual_batches,
};

use crate::batches::Table;
use crate::errors;
use crate::job::job_of;
use crate::wait::interruptible;

/// Result of :func:`wavex.align`. Units are part of the names of columns and parameters.
#[pyclass(module = "wavex", frozen)]
pub struct Alignment {
    done: Aligned,
}

/// Align the strips of a survey: calibration and corrections of trajectories from their overlaps.
///
/// Files are those of ``wavex align``, byte for byte. The GIL is released; Ctrl-C ends the alignment in order.
///
/// Parameters
/// ----------
/// job : Job, str, os.PathLike, or list of paths
///     A job over the strips, with a trajectory and the stage ``georeference``, or the path of a job file. Several job files
///     if strips were flown with several mounts, one for each.
/// output : str or os.PathLike
///     Folder to write; existing files are replaced.
/// trajectory : str or float, optional
///     Corrections of each strip's trajectory: ``"none"``, ``"constant"``, ``"linear"``, or the distance of
///     knots in seconds.
/// control : str or os.PathLike, optional
///     CSV file of control points, as ``--control`` reads it.
/// control_crs : str, optional
///     Coordinate reference system of the control points; that of the job by default.
/// reference : list of str, optional
///     Names of strips whose trajectories are not corrected.
/// estimate : list of str, optional
///     Parameters to estimate that are otherwise given: ``"e1"`` to ``"e4"``.
/// patches : list of str or os.PathLike, optional
///     Files of ``write_patches``, or folders with them, in place of the recordings.
/// set : dict, optional
///     Overrides of keys of a job file.
///
/// Returns
/// -------
/// Alignment
///
/// Raises
/// ------
/// JobError
///     If the job is invalid or no survey.
/// RunError
///     If the strips cannot be aligned, or the alignment is bad; report and page of a bad one are written.
#[pyfunction]
#[pyo3(signature = (
    job, output, *, trajectory=None, control=None, control_crs=None, reference=None, estimate=None, patches=None, set=None
))]
#[expect(clippy::too_many_arguments, reason = "keywords of Python")]
pub fn align(
    py: Python<'_>,
    job: &Bound<'_, PyAny>,
    output: PathBuf,
    trajectory: Option<&Bound<'_, PyAny>>,
    control: Option<PathBuf>,
    control_crs: Option<String>,
    reference: Option<Vec<String>>,
    estimate: Option<Vec<String>>,
    patches: Option<Vec<PathBuf>>,
    set: Option<&Bound<'_, PyDict>>,
) -> PyResult<Alignment> {
    let jobs = match job.cast::<PyList>() {
        Ok(list) => list.iter().map(|job| job_of(py, &job, set)).collect::<PyResult<Vec<_>>>()?,
        Err(_) => vec![job_of(py, job, set)?],
    };
    let jobs: Vec<AlignJob<'_>> = jobs.iter().map(|(job, folder)| AlignJob { job, folder }).collect();
    let estimate = estimate.unwrap_or_default();
    let constraints = AlignConstraints {
        control,
        control_crs,
        references: reference.unwrap_or_default(),
        estimate: estimate.iter().map(|name| optional(name)).collect::<PyResult<_>>()?,
    };
    let patches = patches.unwrap_or_default();
    let trajectory = match trajectory {
        Some(given) => model(&given.str()?.to_string())?,
        None => TrajectoryModel::Constant,
    };
    let cancel = Cancel::default();
    let done = interruptible(
        py,
        &cancel,
        |_| Ok(()),
        || {
            wavex::align::align(&AlignRequest {
                jobs: &jobs,
                output: &output,
                trajectory,
                constraints: constraints.clone(),
                patches: &patches,
                progress: ProgressMode::Hidden,
                cancel: cancel.clone(),
            })
        },
    )?;
    let done = done.map_err(|failure| errors::of_command(&failure))?;
    match &done.failure {
        Some(failure) => Err(errors::of_command(failure)),
        None => Ok(Alignment { done }),
    }
}

fn optional(name: &str) -> PyResult<OptionalParameter> {
    OptionalParameter::of_name(name).ok_or_else(|| {
        errors::job(
            format!("`estimate` has no parameter {name}"),
            "give e1, e2, e3 or e4; e0 and e7 are estimated anyway".to_owned(),
        )
    })
}

fn model(text: &str) -> PyResult<TrajectoryModel> {
    text.parse().map_err(|remedy: String| {
        errors::job(format!("`trajectory` is neither a form of corrections nor a time: {text}"), remedy)
    })
}

/// Table of columns with names.
fn table(columns: Vec<(&str, ArrayRef)>) -> PyResult<Table> {
    of_arrow(RecordBatch::try_from_iter(columns)).map(|batch| Table::new(vec![batch]))
}

fn of_arrow<T>(made: Result<T, ArrowError>) -> PyResult<T> {
    made.map_err(|error| errors::data(error.to_string(), "please report this bug in wavex"))
}

fn texts<'t>(values: impl Iterator<Item = &'t str>) -> ArrayRef {
    Arc::new(values.map(Some).collect::<StringArray>())
}

fn counts(values: impl Iterator<Item = usize>) -> ArrayRef {
    Arc::new(values.map(|value| value as u64).collect::<UInt64Array>())
}

/// Unknown numbers are null.
fn numbers(values: impl Iterator<Item = Option<f64>>) -> ArrayRef {
    Arc::new(values.collect::<Float64Array>())
}

/// Word of a treatment in the report.
fn word(treatment: ParameterTreatment) -> String {
    serde_json::to_value(treatment).ok().and_then(|word| word.as_str().map(str::to_owned)).unwrap_or_default()
}

/// Names of the six offsets of a trajectory.
const OFFSETS: [&str; 6] = ["north_m", "east_m", "down_m", "roll_rad", "pitch_rad", "heading_rad"];
const OFFSET_SDS: [&str; 6] =
    ["north_sd_m", "east_sd_m", "down_sd_m", "roll_sd_rad", "pitch_sd_rad", "heading_sd_rad"];

impl Alignment {
    fn report(&self) -> &AlignReport {
        &self.done.report
    }
}

#[pymethods]
impl Alignment {
    /// ``good`` or ``doubtful``; a bad alignment is an error.
    #[getter]
    fn verdict(&self) -> &str {
        self.report().verdict.word()
    }

    /// Strips that were left out or not aligned, and reasons of a doubtful verdict.
    #[getter]
    fn warnings(&self) -> Vec<String> {
        self.done.warnings.clone()
    }

    /// Parameters with start value, value, SDs and treatment.
    ///
    /// With several jobs, the first column is ``installation``, the name of the job.
    /// ``treatment`` is ``given``, ``estimated``, ``not_estimable`` or ``only_combined``; ``reasons`` says why the
    /// flight does not determine a parameter, and what to fly.
    #[getter]
    fn parameters(&self) -> PyResult<Table> {
        let all = || self.report().parameters.iter();
        let number = |of: fn(&AlignedParameter) -> f64| numbers(all().map(|found| Some(of(found))));
        let treatments: Vec<String> = all().map(|found| word(found.treatment)).collect();
        let reasons: Vec<String> = all()
            .map(|found| {
                let reasons = found.reasons.iter();
                reasons
                    .map(|reason| format!("{}: {}", reason.cause, reason.remedy))
                    .collect::<Vec<_>>()
                    .join("; ")
            })
            .collect();
        let installation = || all().map(|found| found.installation.as_deref());
        let of_several = || ("installation", texts(installation().map(Option::unwrap_or_default)));
        let own = vec![
            ("name", texts(all().map(|found| found.name.as_str()))),
            ("start", number(|found| found.start)),
            ("value", number(|found| found.value)),
            ("sd", number(|found| found.sd)),
            ("formal_sd", number(|found| found.formal_sd)),
            ("jackknife_sd", number(|found| found.jackknife_sd)),
            ("prior_sd", number(|found| found.prior_sd)),
            ("treatment", texts(treatments.iter().map(String::as_str))),
            ("reasons", texts(reasons.iter().map(String::as_str))),
        ];
        let has_several = installation().all(|name| name.is_some());
        table(has_several.then(of_several).into_iter().chain(own).collect())
    }

    /// Names of the rows and columns of :attr:`covariance`.
    #[getter]
    fn covariance_names(&self) -> Vec<String> {
        self.report().covariance.parameters.clone()
    }

    /// Covariance of the parameters that are not given, shape (n, n), in the squares of their units.
    #[getter]
    fn covariance<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let rows = &self.report().covariance.matrix;
        let all: Vec<f64> = rows.iter().flatten().copied().collect();
        all.into_pyarray(py).reshape([rows.len(), rows.len()])
    }

    /// Correlations above 0.9: ``first``, ``second``, ``correlation``.
    #[getter]
    fn correlations(&self) -> PyResult<Table> {
        let all = || self.report().correlations.iter();
        table(vec![
            ("first", texts(all().map(|found| found.parameters[0].as_str()))),
            ("second", texts(all().map(|found| found.parameters[1].as_str()))),
            ("correlation", numbers(all().map(|found| Some(found.correlation)))),
        ])
    }

    /// Strips with their recordings, times, and numbers of patches and pairs; 0 pairs: not aligned.
    #[getter]
    fn strips(&self) -> PyResult<Table> {
        let all = || self.report().strips.iter();
        let number = |of: fn(&AlignedStrip) -> f64| numbers(all().map(|strip| Some(of(strip))));
        table(vec![
            ("name", texts(all().map(|strip| strip.name.as_str()))),
            ("recording", texts(all().map(|strip| strip.recording.as_str()))),
            ("first_s", number(|strip| strip.first_s)),
            ("last_s", number(|strip| strip.last_s)),
            ("patches", counts(all().map(|strip| strip.patches))),
            ("patches_without_pose", counts(all().map(|strip| strip.patches_without_pose))),
            ("pairs", counts(all().map(|strip| strip.pairs))),
        ])
    }

    /// Corrections of the trajectories: strip, time and six offsets of each knot with their SDs.
    #[getter]
    fn corrections(&self) -> PyResult<Table> {
        let all: Vec<(&str, &Knot)> = self
            .report()
            .strips
            .iter()
            .flat_map(|strip| strip.knots.iter().map(|knot| (strip.name.as_str(), knot)))
            .collect();
        let mut columns = vec![
            ("strip", texts(all.iter().map(|(name, _)| *name))),
            ("time_s", numbers(all.iter().map(|(_, knot)| Some(knot.time_s)))),
        ];
        for (offset, name) in OFFSETS.into_iter().enumerate() {
            let of = |knot: &Knot| {
                let mut both = knot.north_east_down_m.into_iter().chain(knot.roll_pitch_heading_rad);
                both.nth(offset)
            };
            columns.push((name, numbers(all.iter().map(|(_, knot)| of(knot)))));
        }
        for (offset, name) in OFFSET_SDS.into_iter().enumerate() {
            columns.push((name, numbers(all.iter().map(|(_, knot)| knot.sds.get(offset).copied()))));
        }
        table(columns)
    }

    /// Differences of the strips that overlap, before and after; null before: too far apart for pairs.
    #[getter]
    fn overlaps(&self) -> PyResult<Table> {
        let all = || self.report().overlaps.iter();
        let number = |of: fn(&Overlap) -> Option<f64>| numbers(all().map(of));
        table(vec![
            ("first_strip", texts(all().map(|overlap| overlap.strips[0].as_str()))),
            ("second_strip", texts(all().map(|overlap| overlap.strips[1].as_str()))),
            ("pairs", counts(all().map(|overlap| overlap.pairs))),
            ("rejected_pairs", counts(all().map(|overlap| overlap.rejected_pairs))),
            ("median_before_m", number(|overlap| overlap.median_before_m)),
            ("median_after_m", number(|overlap| overlap.median_after_m)),
            ("spread_before_m", number(|overlap| overlap.spread_before_m)),
            ("spread_after_m", number(|overlap| overlap.spread_after_m)),
        ])
    }

    /// Differences of all pairs of patches: the rows of ``residuals.arrow``.
    #[getter]
    fn residuals(&self) -> PyResult<Table> {
        let names: Vec<&str> = self.report().strips.iter().map(|strip| strip.name.as_str()).collect();
        let batches = residual_batches(&self.done.observations, &names).collect::<Result<_, _>>();
        of_arrow(batches).map(Table::new)
    }

    /// Paths of the written files.
    #[getter]
    fn files(&self) -> Vec<String> {
        self.done.written.iter().map(|path| path.display().to_string()).collect()
    }

    /// Table of parameters and differences, as ``wavex align`` prints it.
    #[getter]
    fn text(&self) -> &str {
        &self.done.text
    }

    fn __str__(&self) -> &str {
        &self.done.text
    }

    fn __repr__(&self) -> String {
        let report = self.report();
        format!("<wavex.Alignment of {} strips: {}>", report.strips.len(), report.verdict.word())
    }
}

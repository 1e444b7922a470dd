//! Calibration, decomposition and explanation of recordings.

use std::ops::ControlFlow;
use std::path::PathBuf;
use std::sync::Arc;

use numpy::{IntoPyArray, PyArray1};
use pyo3::prelude::*;
use pyo3::types::{PyBool, PyDict};
use toml::Table as Keys;

use wavex::engine::{self, Cancel};
use wavex::explain::{Explanation as Explained, explain_shot};
use wavex::scan_line::ScanLine;
use wavex::stage::{Context, FittedBlock};
use wavex::stages::writers::write_table::{ReturnRow, return_batch, return_schema};

use crate::batches::{BatchReader, Table};
use crate::chain::{options, use_model};
use crate::convert::{Columns, Returns};
use crate::errors;
use crate::model::SensorModel;
use crate::recording::{WAITING_BATCHES, recording_of, settings};
use crate::toml_value::table;
use crate::wait::interruptible;

/// Calibrate a sensor model from a recording.
///
/// Parameters
/// ----------
/// recording : Recording or path
/// threads : int, optional
///     Number of threads; one per core by default.
/// **keys
///     Keys of the stage ``calibrate``, such as ``waveforms=50_000`` or ``preset="riegl_q680i"``.
///
/// Returns
/// -------
/// SensorModel
///
/// Raises
/// ------
/// RunError
///     If the recording has too few waveforms.
#[pyfunction]
#[pyo3(signature = (recording, *, threads=None, **keys))]
pub fn calibrate(
    py: Python<'_>,
    recording: &Bound<'_, PyAny>,
    threads: Option<i64>,
    keys: Option<&Bound<'_, PyDict>>,
) -> PyResult<SensorModel> {
    let recording = recording_of(py, recording)?;
    let place = &recording.get().place;
    let job = place.job(settings(threads, None), &[("calibrate", table(keys)?)])?;
    let cancel = Cancel::default();
    let options = options(&job, &cancel);
    let look = |model: &mut Option<_>, line: &ScanLine| {
        *model = line.model.clone();
        if model.is_some() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    };
    let model = interruptible(
        py,
        &cancel,
        |_| Ok(()),
        || engine::observe(&job, place.input(), &options, Context::of_run(), None, look),
    )?;
    let model = model.map_err(|error| errors::of_run(&error))?;
    model.map(SensorModel::new).ok_or_else(|| {
        errors::read(
            format!("{}: the recording has no shots; choose another file", place.path.display()),
            &place.path,
        )
    })
}

/// Keys of a stage that is used if an argument is true or a dictionary.
fn wanted(name: &str, argument: Option<&Bound<'_, PyAny>>) -> PyResult<Option<Keys>> {
    let Some(argument) = argument else { return Ok(None) };
    if let Ok(is_wanted) = argument.cast::<PyBool>() {
        return Ok(is_wanted.is_true().then(Keys::new));
    }
    match argument.cast::<PyDict>() {
        Ok(keys) => table(Some(keys)).map(Some),
        Err(_) => Err(errors::job(
            format!("`{name}` is neither a truth value nor a dictionary"),
            format!("give `{name}=True`, or its keys as a dictionary"),
        )),
    }
}

/// Decompose a recording into returns with standard deviations, as a stream.
///
/// Rows and columns are those of the stage ``write_table``, value for value.
///
/// Parameters
/// ----------
/// recording : Recording or path
/// model : SensorModel, optional
///     By default the recording is calibrated first.
/// columns : list of str, optional
///     Columns to keep; all by default.
/// correct, georeference : bool or dict, optional
///     Whether these stages follow; a dictionary gives their keys. ``georeference`` fills ``x``, ``y``, ``z``.
/// geometry : dict, optional
///     Keys of the table ``[job.geometry]``, such as ``trajectory`` and ``crs``.
/// threads : int, optional
///     Number of threads; one per core by default.
/// memory_mb : int, optional
///     Memory limit of all scan lines, MB.
/// **keys
///     Keys of the stage ``decompose``, such as ``mode="refined"`` or ``detection_sigma=5``.
///
/// Returns
/// -------
/// BatchReader
#[pyfunction]
#[pyo3(signature = (
    recording, model=None, *, columns=None, correct=None, georeference=None, geometry=None, threads=None,
    memory_mb=None, **keys
))]
#[allow(clippy::too_many_arguments, reason = "keyword arguments of a Python function")]
pub fn decompose(
    py: Python<'_>,
    recording: &Bound<'_, PyAny>,
    model: Option<&Bound<'_, SensorModel>>,
    columns: Option<Vec<String>>,
    correct: Option<&Bound<'_, PyAny>>,
    georeference: Option<&Bound<'_, PyAny>>,
    geometry: Option<&Bound<'_, PyDict>>,
    threads: Option<i64>,
    memory_mb: Option<i64>,
    keys: Option<&Bound<'_, PyDict>>,
) -> PyResult<BatchReader> {
    let columns = Columns::of_returns(columns)?;
    let recording = recording_of(py, recording)?;
    let mut stages = vec![("calibrate", Keys::new()), ("decompose", table(keys)?)];
    stages.extend(wanted("correct", correct)?.map(|keys| ("correct", keys)));
    stages.extend(wanted("georeference", georeference)?.map(|keys| ("georeference", keys)));
    let mut settings = settings(threads, memory_mb);
    if let Some(geometry) = geometry {
        settings.insert("geometry".into(), table(Some(geometry))?.into());
    }
    let place = &recording.get().place;
    let mut job = place.job(settings, &stages)?;
    if let Some(model) = model {
        use_model(&mut job, &model.get().model);
    }
    let options = options(&job, &Cancel::default());
    let stream = engine::stream(&job, place.input(), &options, WAITING_BATCHES, Returns::new(columns));
    Ok(BatchReader::new(stream.map_err(|error| errors::of_run(&error))?))
}

/// Explain the returns of one shot.
///
/// Parameters
/// ----------
/// recording : Recording or path
/// shot : int
///     Running number of the shot; of large footprints, their ``shot_number``. These are
///     measured as by ``measure_footprints``: ``model`` and ``keys`` are not for them.
/// model : SensorModel, optional
///     By default the recording is calibrated first.
/// **keys
///     Keys of the stage ``decompose``.
///
/// Returns
/// -------
/// Explanation
///     Shown as a picture in a notebook.
#[pyfunction]
#[pyo3(signature = (recording, shot, model=None, **keys))]
pub fn explain(
    py: Python<'_>,
    recording: &Bound<'_, PyAny>,
    shot: u64,
    model: Option<&Bound<'_, SensorModel>>,
    keys: Option<&Bound<'_, PyDict>>,
) -> PyResult<Explanation> {
    let recording = recording_of(py, recording)?;
    let place = &recording.get().place;
    let of_stage = |name: &str, keys: &Keys| -> Vec<String> {
        keys.iter().map(|(key, value)| format!("{name}.{key}={value}")).collect()
    };
    let mut set = of_stage(place.reader, &place.keys);
    set.extend(of_stage("decompose", &table(keys)?));
    let model = model.map(|model| Arc::clone(&model.get().model));
    let cancel = Cancel::default();
    let explained = interruptible(
        py,
        &cancel,
        |_| Ok(()),
        || explain_shot(&place.path, shot, &set, model, cancel.clone()),
    )?;
    Ok(Explanation { explained: explained.map_err(|failure| errors::of_command(&failure))? })
}

/// One shot with its fit.
#[pyclass(module = "wavex", frozen)]
pub struct Explanation {
    explained: Explained,
}

#[pymethods]
impl Explanation {
    /// Running number of the shot; ``shot_number`` of large footprints.
    #[getter]
    fn shot(&self) -> u64 {
        self.explained.emission.shot
    }

    /// Returns of the shot, with the columns of :func:`wavex.decompose`.
    #[getter]
    fn returns(&self) -> PyResult<Table> {
        let Explained { emission, returns, input, .. } = &self.explained;
        let row = |found: &wavex::scan_line::Return| ReturnRow {
            shot: emission.shot,
            gps_time_s: emission.gps_time_s,
            found: *found,
            point: None,
            profile: None,
        };
        let rows: Vec<ReturnRow> = returns.iter().map(row).collect();
        let batch = return_batch(&return_schema(input, false), &rows);
        Ok(Table::new(vec![batch.map_err(|error| errors::of_stage(&error))?]))
    }

    /// Echo blocks of the shot with their fits, in order of time.
    #[getter]
    fn blocks(&self) -> Vec<FittedSamples> {
        self.explained.blocks.iter().cloned().map(|block| FittedSamples { block }).collect()
    }

    /// Residual of the first block, standard deviations, shape (n,).
    #[getter]
    fn residual<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        let first = self.explained.blocks.first();
        first.map(|block| block.samples.residual.clone()).unwrap_or_default().into_pyarray(py)
    }

    /// Table of the returns and fit statistics, as ``wavex explain`` prints it.
    #[getter]
    fn text(&self) -> &str {
        &self.explained.text
    }

    /// Picture of samples, fit and residual, SVG.
    #[getter]
    fn svg(&self) -> &str {
        &self.explained.svg
    }

    /// Write the picture.
    ///
    /// Parameters
    /// ----------
    /// path : str or os.PathLike
    ///     Ends in ``.svg``.
    fn save(&self, path: PathBuf) -> PyResult<()> {
        if !path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("svg")) {
            return Err(errors::data(
                format!("{}: the picture is SVG", path.display()),
                "give a name that ends in `.svg`; browsers and Inkscape convert it",
            ));
        }
        Ok(std::fs::write(path, &self.explained.svg)?)
    }

    fn _repr_svg_(&self) -> &str {
        &self.explained.svg
    }

    fn __str__(&self) -> &str {
        &self.explained.text
    }

    fn __repr__(&self) -> String {
        let Explained { emission, returns, blocks, .. } = &self.explained;
        format!(
            "<wavex.Explanation of shot {}: {} returns in {} blocks>",
            emission.shot,
            returns.len(),
            blocks.len()
        )
    }
}

/// Samples of an echo block and their fit.
#[pyclass(module = "wavex", frozen)]
pub struct FittedSamples {
    block: FittedBlock,
}

#[pymethods]
impl FittedSamples {
    /// Channel: ``low``, ``high`` or ``joint``.
    #[getter]
    fn channel(&self) -> &str {
        &self.block.channel
    }

    /// Time of flight of each sample, ns, shape (n,).
    #[getter]
    fn time_ns<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        let of = |position: &f64| self.block.first_ns + position * self.block.samples.interval_ns;
        self.block.samples.taken_at.iter().map(of).collect::<Vec<f64>>().into_pyarray(py)
    }

    /// Recorded samples, digitiser steps, shape (n,).
    #[getter]
    fn samples<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<u16>> {
        self.block.samples.samples_dn.clone().into_pyarray(py)
    }

    /// Fitted curve at the samples: background and all pulses, digitiser steps, shape (n,).
    #[getter]
    fn fitted<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        let samples = &self.block.samples;
        let step = wavex::stage::CURVE_POINTS_PER_SAMPLE;
        let at = |k: usize| {
            let pulses = samples.pulses_dn.iter().filter_map(|pulse| pulse.get(k * step));
            samples.background_dn + pulses.sum::<f64>()
        };
        (0..samples.samples_dn.len()).map(at).collect::<Vec<f64>>().into_pyarray(py)
    }

    /// Residual of the fit, standard deviations, shape (n,).
    #[getter]
    fn residual<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        self.block.samples.residual.clone().into_pyarray(py)
    }

    /// Whether each sample was used, shape (n,).
    #[getter]
    fn used<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<bool>> {
        self.block.samples.used.clone().into_pyarray(py)
    }

    /// Weighted sum of squared residuals.
    #[getter]
    fn chi_square(&self) -> f64 {
        self.block.chi_square
    }

    /// Number of samples minus number of parameters.
    #[getter]
    fn degrees_of_freedom(&self) -> u32 {
        self.block.degrees_of_freedom
    }

    fn __repr__(&self) -> String {
        let n = self.block.samples.samples_dn.len();
        format!("<wavex.FittedSamples {}: {n} samples>", self.block.channel)
    }
}

/// Adds the classes to the module.
pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<Explanation>()?;
    module.add_class::<FittedSamples>()
}

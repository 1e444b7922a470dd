//! Recordings: opening, metadata, random access, simulation.

use std::path::PathBuf;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use wavex::registry::STAGES;

use pyo3::exceptions::{PyIndexError, PyKeyError};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use toml::Table as Keys;

use wavex::engine::{self, Cancel};
use wavex::recording::{LineIndex, OpenError, Recording as Access};
use wavex::scan_line::{Channel, GainControl, InputInfo};
use wavex::stage::{Plan, RunContext, Source, SourcePlan, StageError};

use crate::batches::BatchReader;
use crate::chain::{Place, options};
use crate::convert::{Columns, Shots};
use crate::errors;
use crate::lines::{Line, Lines, Shot, channel_name};
use crate::toml_value::{self, table};
use crate::wait::interruptible;

/// Batches that wait between the engine and Python.
pub const WAITING_BATCHES: usize = 4;

/// Recording of waveforms: LAS, LAZ, PulseWaves, SDF or the container.
///
/// Made by :func:`wavex.open` and :func:`wavex.simulate`. It can be used from several threads.
#[pyclass(module = "wavex", frozen)]
pub struct Recording {
    pub place: Place,
    access: Arc<Mutex<Access>>,
    input: Arc<InputInfo>,
    /// Index, once it is known.
    index: Mutex<Option<Arc<LineIndex>>>,
    /// Path of the true returns, for simulated recordings.
    #[pyo3(get)]
    truth_path: Option<PathBuf>,
    /// Keeps a temporary folder until the recording is deleted.
    _folder: Option<Py<PyAny>>,
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Recording {
    pub fn open(
        py: Python<'_>,
        place: Place,
        truth_path: Option<PathBuf>,
        folder: Option<Py<PyAny>>,
    ) -> PyResult<Recording> {
        let set: Vec<String> =
            place.keys.iter().map(|(key, value)| format!("{}.{key}={value}", place.reader)).collect();
        let path = place.path.clone();
        let opened = py.detach(|| Access::open(STAGES, &path, &set));
        let access = opened.map_err(|error| match error {
            OpenError::Format(text) => errors::read(text, &place.path),
            OpenError::Keys(errors) => errors::of_job(&errors),
            OpenError::Read(error) => errors::of_stage(&error),
        })?;
        let input = Arc::clone(access.input());
        let access = Arc::new(Mutex::new(access));
        Ok(Recording { place, access, input, index: Mutex::default(), truth_path, _folder: folder })
    }

    /// The index of scan lines, made or read on first use.
    pub fn index(&self, py: Python<'_>) -> PyResult<Arc<LineIndex>> {
        if let Some(index) = &*lock(&self.index) {
            return Ok(Arc::clone(index));
        }
        let cancel = Cancel::default();
        let index = interruptible(
            py,
            &cancel,
            |_| Ok(()),
            || {
                let mut watch = |_| match cancel.is_cancelled() {
                    true => Err(StageError::Stopped),
                    false => Ok(()),
                };
                lock(&self.access).index(&mut watch)
            },
        )?;
        let index = index.map_err(|error| errors::of_stage(&error))?;
        Ok(Arc::clone(lock(&self.index).insert(index)))
    }

    /// Reads line `number`.
    pub fn line(&self, py: Python<'_>, number: usize) -> PyResult<Line> {
        self.index(py)?;
        let line = py.detach(|| lock(&self.access).line(number)).map_err(|error| errors::of_stage(&error))?;
        line.map(Line::new).ok_or_else(|| PyIndexError::new_err(format!("there is no line {number}")))
    }
}

#[pymethods]
impl Recording {
    /// Path of the file.
    #[getter]
    fn path(&self) -> PathBuf {
        self.place.path.clone()
    }

    /// Metadata of the recording; counts need a pass over it and are read on first use.
    #[getter]
    fn info(slf: &Bound<'_, Self>) -> Info {
        Info { recording: slf.clone().unbind(), input: Arc::clone(&slf.get().input) }
    }

    /// Scan lines of the recording, a sequence of :class:`Line`.
    ///
    /// The index for it is made in one pass; for a large recording it is kept next to the file
    /// (``NAME.wvxi``).
    #[getter]
    fn lines(slf: &Bound<'_, Self>) -> Lines {
        Lines { recording: slf.clone().unbind() }
    }

    /// Read a shot by its running number.
    ///
    /// Parameters
    /// ----------
    /// number : int
    ///     Running number of the shot in the recording.
    ///
    /// Returns
    /// -------
    /// Shot
    ///
    /// Raises
    /// ------
    /// KeyError
    ///     If the recording has no such shot.
    fn shot(&self, py: Python<'_>, number: u64) -> PyResult<Shot> {
        let index = self.index(py)?;
        let line = py.detach(|| lock(&self.access).line_of_shot(number));
        let line = line.map_err(|error| errors::of_stage(&error))?.map(Arc::new);
        let found = line.and_then(|line| {
            let at = line.emissions.iter().position(|emission| emission.shot == number)?;
            Some(Shot { line, index: at })
        });
        found.ok_or_else(|| {
            let range = index.shot_range().map_or_else(
                || "there are no shots".to_owned(),
                |[first, last]| format!("the {} shots are numbered {first} to {last}", index.shots()),
            );
            PyKeyError::new_err(format!("{}: no shot {number}; {range}", self.place.path.display()))
        })
    }

    /// Stream the shots and their samples, one batch per scan line.
    ///
    /// Columns are those of the container, described in ``schemas/container.json``.
    ///
    /// Parameters
    /// ----------
    /// columns : list of str, optional
    ///     Columns to keep; all by default. Without ``blocks``, samples are not read where the format
    ///     permits it.
    /// memory_mb : int, optional
    ///     Memory limit of all scan lines, MB.
    ///
    /// Returns
    /// -------
    /// BatchReader
    #[pyo3(signature = (columns=None, *, memory_mb=None))]
    fn shots(&self, columns: Option<Vec<String>>, memory_mb: Option<i64>) -> PyResult<BatchReader> {
        let columns = Columns::of_shots(columns)?;
        let settings = settings(None, memory_mb);
        let mut job = self.place.job(settings, &[])?;
        if !columns.has(BLOCKS)
            && let Some(stage) = job.stages.first_mut()
            && let Plan::Source(source) = &stage.planned.plan
        {
            stage.planned.plan = Plan::Source(Arc::new(WithoutSamples(Arc::clone(source))));
        }
        let options = options(&job, &Cancel::default());
        let input = self.place.input();
        let stream = engine::stream(&job, input, &options, WAITING_BATCHES, Shots::new(columns));
        Ok(BatchReader::new(stream.map_err(|error| errors::of_run(&error))?))
    }

    /// Numbers of scan lines and shots, if they are known without a pass over the recording.
    #[getter]
    fn _counts(&self) -> Option<(usize, u64)> {
        lock(&self.index).as_ref().map(|index| (index.lines().len(), index.shots()))
    }

    /// True returns of a simulated recording, as a ``pyarrow.Table``; ``None`` for others.
    #[getter]
    fn truth<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyAny>>> {
        let Some(path) = &self.truth_path else { return Ok(None) };
        Ok(Some(py.import("pyarrow.csv")?.call_method1("read_csv", (path,))?))
    }

    fn __repr__(&self) -> String {
        format!("<wavex.Recording {}: {}>", self.place.path.display(), self.input.format)
    }

    fn __reduce__(slf: &Bound<'_, Self>) -> PyResult<(Py<PyAny>, (PathBuf,))> {
        let this = slf.get();
        if !this.place.keys.is_empty() || this._folder.is_some() {
            return Err(errors::data(
                "a recording opened with keys of its reader, or in a temporary folder, cannot be pickled",
                "open it in the other process",
            ));
        }
        Ok((slf.py().import("wavex")?.getattr("open")?.unbind(), (this.place.path.clone(),)))
    }
}

/// Index of the column `blocks`.
const BLOCKS: usize = 9;

/// Settings of a job.
pub fn settings(threads: Option<i64>, memory_mb: Option<i64>) -> Keys {
    let mut settings = Keys::new();
    let given = [("threads", threads), ("memory_mb", memory_mb)];
    settings.extend(given.into_iter().filter_map(|(key, value)| Some((key.to_owned(), value?.into()))));
    settings
}

/// A source that leaves out samples where its format permits.
struct WithoutSamples(Arc<dyn SourcePlan>);

impl SourcePlan for WithoutSamples {
    fn paths(&self) -> Option<&wavex::stage::Paths> {
        self.0.paths()
    }
    fn stem(&self) -> &str {
        self.0.stem()
    }
    fn outputs(&self) -> Vec<&str> {
        self.0.outputs()
    }
    fn make(&self, run: &RunContext) -> wavex::stage::Result<Box<dyn Source>> {
        self.0.make_for_inspection(run, false)
    }
    fn make_for_inspection(
        &self,
        run: &RunContext,
        with_samples: bool,
    ) -> wavex::stage::Result<Box<dyn Source>> {
        self.0.make_for_inspection(run, with_samples)
    }
}

/// Metadata of a recording.
#[pyclass(module = "wavex", frozen)]
pub struct Info {
    recording: Py<Recording>,
    input: Arc<InputInfo>,
}

#[pymethods]
impl Info {
    /// Format of the file.
    #[getter]
    fn format(&self) -> &str {
        &self.input.format
    }

    /// Name of the instrument, if recorded.
    #[getter]
    fn instrument(&self) -> Option<&str> {
        self.input.instrument.as_deref()
    }

    /// Serial number of the instrument, if recorded.
    #[getter]
    fn serial(&self) -> Option<&str> {
        self.input.serial.as_deref()
    }

    /// Coordinate reference system as WKT, if known.
    #[getter]
    fn crs_wkt(&self) -> Option<&str> {
        self.input.crs_wkt.as_deref()
    }

    /// Frame of origins and directions.
    #[getter]
    fn frame(&self) -> String {
        format!("{:?}", self.input.frame).to_lowercase()
    }

    /// Time scale of ``gps_time_s``.
    #[getter]
    fn time_scale(&self) -> String {
        format!("{:?}", self.input.time_scale).to_lowercase()
    }

    /// GPS week of the first shot, if known.
    #[getter]
    fn gps_week(&self) -> Option<u32> {
        self.input.gps_week
    }

    /// Sampling interval, ns.
    #[getter]
    fn sampling_interval_ns(&self) -> f64 {
        self.input.sampling_interval_ns
    }

    /// Largest value of the digitiser, if known.
    #[getter]
    fn full_scale_dn(&self) -> Option<u16> {
        self.input.full_scale_dn
    }

    /// Nominal pulse rate, Hz, if recorded.
    #[getter]
    fn pulse_rate_hz(&self) -> Option<f64> {
        self.input.pulse_rate_hz
    }

    /// Group velocity of the pulse in air, m/s.
    #[getter]
    fn group_velocity_mps(&self) -> f64 {
        self.input.group_velocity_mps
    }

    /// Whether the gain of the receiver varies.
    #[getter]
    fn has_gain_control(&self) -> bool {
        self.input.gain_control != GainControl::Off
    }

    /// Names of the channels in the first scan line.
    #[getter]
    fn channels(&self, py: Python<'_>) -> PyResult<Vec<&'static str>> {
        let line = self.recording.get().line(py, 0)?;
        let blocks = line.line.blocks().into_iter().flat_map(|blocks| blocks.iter());
        let mut channels: Vec<Channel> = blocks.map(|block| block.channel).collect();
        channels.sort_unstable();
        channels.dedup();
        Ok(channels.into_iter().map(channel_name).collect())
    }

    /// Number of shots.
    #[getter]
    fn shots(&self, py: Python<'_>) -> PyResult<u64> {
        Ok(self.recording.get().index(py)?.shots())
    }

    /// Number of scan lines.
    #[getter]
    fn lines(&self, py: Python<'_>) -> PyResult<usize> {
        Ok(self.recording.get().index(py)?.lines().len())
    }

    /// Smallest and largest shot number; ``None`` without shots.
    #[getter]
    fn shot_range(&self, py: Python<'_>) -> PyResult<Option<(u64, u64)>> {
        Ok(self.recording.get().index(py)?.shot_range().map(|[first, last]| (first, last)))
    }

    /// Time of the first and the last shot, s, on :attr:`time_scale`; ``None`` if unknown.
    #[getter]
    fn time_span_s(&self, py: Python<'_>) -> PyResult<Option<(f64, f64)>> {
        let index = self.recording.get().index(py)?;
        let ranges = || index.lines().iter().map(|line| line.time_range_s);
        let first = ranges().map(|range| range[0]).fold(f64::NAN, f64::min);
        let last = ranges().map(|range| range[1]).fold(f64::NAN, f64::max);
        Ok(first.is_finite().then_some((first, last)))
    }

    fn __repr__(&self) -> String {
        let instrument = self.input.instrument.as_deref().unwrap_or("unknown instrument");
        format!(
            "<wavex.Info {}, {instrument}, samples every {} ns>",
            self.input.format, self.input.sampling_interval_ns
        )
    }
}

/// Open a recording.
///
/// Parameters
/// ----------
/// path : str or os.PathLike
///     LAS or LAZ with waveforms, PulseWaves, the container (``.arrow``), or SDF and WFM through RIEGL's
///     library.
/// **keys
///     Keys of its reader, such as ``full_scale_dn`` or ``sensor_position``; ``wavex.stages()`` lists
///     them.
///
/// Returns
/// -------
/// Recording
///
/// Raises
/// ------
/// ReadError
///     If the file is missing or invalid.
/// JobError
///     If a key is wrong.
#[pyfunction]
#[pyo3(signature = (path, **keys))]
pub fn open(py: Python<'_>, path: PathBuf, keys: Option<&Bound<'_, PyDict>>) -> PyResult<Recording> {
    Recording::open(py, Place::of(&path, table(keys)?)?, None, None)
}

/// Simulate a recording with known true returns.
///
/// Parameters
/// ----------
/// path : str or os.PathLike, optional
///     Container to write (``.arrow``); by default in a temporary folder that is deleted with the
///     recording.
/// **keys
///     Keys of the stage ``simulate``, such as ``lines=20``, ``shots_per_line=1000`` or ``seed=1``.
///
/// Returns
/// -------
/// Recording
///     Its attribute ``truth`` is the table of true returns.
#[pyfunction]
#[pyo3(signature = (path=None, **keys))]
pub fn simulate(
    py: Python<'_>,
    path: Option<PathBuf>,
    keys: Option<&Bound<'_, PyDict>>,
) -> PyResult<Recording> {
    let (path, folder) = match path {
        Some(path) => (path, None),
        None => {
            let folder = py.import("tempfile")?.call_method1("TemporaryDirectory", ("", "wavex_"))?;
            let name: String = folder.getattr("name")?.extract()?;
            (PathBuf::from(name).join("simulated.arrow"), Some(folder.unbind()))
        }
    };
    let path = std::path::absolute(&path).unwrap_or(path);
    let truth = path.with_extension("truth.csv");
    let mut simulate = table(keys)?;
    simulate.entry("truth").or_insert(truth.to_string_lossy().into_owned().into());
    let truth = simulate.get("truth").and_then(toml::Value::as_str).map_or(truth.clone(), PathBuf::from);
    let mut container = Keys::new();
    container.insert("path".into(), path.to_string_lossy().into_owned().into());
    let text = format!(
        "[job]\nreport = \"\"\nstat_log = \"\"\nlog = \"\"\n\n{}\n{}",
        toml_value::stage("simulate", &simulate)?,
        toml_value::stage("write_arrow", &container)?
    );
    let job = wavex::job::Job::parse(STAGES, "the job of wavex.simulate", &text, &[]);
    let job = job.map_err(|errors| errors::of_job(&errors))?;
    let cancel = Cancel::default();
    let options = options(&job, &cancel);
    let run = interruptible(py, &cancel, |_| Ok(()), || engine::run(&job, &options))?;
    run.map_err(|error| errors::of_run(&error))?;
    Recording::open(py, Place::of(&path, Keys::new())?, Some(truth), folder)
}

/// The argument of a call that takes a recording or its path.
pub fn recording_of(py: Python<'_>, recording: &Bound<'_, PyAny>) -> PyResult<Py<Recording>> {
    if let Ok(recording) = recording.cast::<Recording>() {
        return Ok(recording.clone().unbind());
    }
    let path: PathBuf = recording.extract().map_err(|_| {
        errors::data("the recording is neither a path nor a `wavex.Recording`", "open it with `wavex.open`")
    })?;
    Py::new(py, Recording::open(py, Place::of(&path, Keys::new())?, None, None)?)
}

/// Adds the classes to the module.
pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<Recording>()?;
    module.add_class::<Info>()?;
    Ok(())
}

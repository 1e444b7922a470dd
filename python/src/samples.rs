//! Decomposition of arrays of samples.

use std::ops::Range;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use wavex::registry::STAGES;

use arrow_array::ffi::{FFI_ArrowArray, FFI_ArrowSchema, from_ffi_and_data_type};
use arrow_array::{
    Array, ArrayRef, Float64Array, GenericListArray, OffsetSizeTrait, PrimitiveArray, RecordBatch,
    UInt8Array, UInt16Array, UInt64Array, make_array, types,
};
use arrow_schema::{DataType, Field, Metadata, Schema};
use numpy::{Element, PyReadonlyArray1, PyReadonlyArray2, PyUntypedArray, PyUntypedArrayMethods};
use pyo3::prelude::*;
use pyo3::types::{PyCapsule, PyDict, PyTuple};

use wavex::engine::Cancel;
use wavex::job::Job;
use wavex::stages::process::decompose::{Decompose, Mode};
use wavex_signal::calibrate::CalibrationError;
use wavex_signal::decompose::{Decompositions, Tables, Waveform};
use wavex_signal::sensor_model::ChannelModel;
use wavex_simd::SimdLevel;

use crate::batches::Table;
use crate::errors;
use crate::model::SensorModel;
use crate::toml_value::{self, table};
use crate::wait::interruptible;

/// Waveforms of one call of the kernels.
const CALL: usize = 2048;
/// Waveforms of one task of a thread, which makes one record batch.
const CHUNK: usize = 4 * CALL;
/// Maximum number of samples of a waveform.
const MAX_SAMPLES: usize = 1 << 20;

/// Samples of many waveforms: those of waveform `i` are `values[ends[i]..ends[i + 1]]`.
struct Samples<'a> {
    values: std::borrow::Cow<'a, [u16]>,
    ends: Ends<'a>,
}

/// Where waveforms end.
enum Ends<'a> {
    /// All have this number of samples; and the number of waveforms.
    Equal(usize, usize),
    /// Rows of this number of samples, and how many of each row are the waveform.
    Padded(usize, Vec<usize>),
    Small(&'a [i32]),
    Large(&'a [i64]),
}

impl Samples<'_> {
    fn waveforms(&self) -> usize {
        match self.ends {
            Ends::Equal(_, waveforms) => waveforms,
            Ends::Padded(_, ref lengths) => lengths.len(),
            Ends::Small(ends) => ends.len().saturating_sub(1),
            Ends::Large(ends) => ends.len().saturating_sub(1),
        }
    }

    fn range(&self, waveform: usize) -> Range<usize> {
        match self.ends {
            Ends::Equal(samples, _) => waveform * samples..(waveform + 1) * samples,
            Ends::Padded(samples, ref lengths) => waveform * samples..waveform * samples + lengths[waveform],
            // Arrow checks that offsets are not negative and do not fall.
            Ends::Small(ends) => ends[waveform] as usize..ends[waveform + 1] as usize,
            Ends::Large(ends) => ends[waveform] as usize..ends[waveform + 1] as usize,
        }
    }

    fn get(&self, waveform: usize) -> &[u16] {
        &self.values[self.range(waveform)]
    }
}

/// A number that may be a sample.
trait Sample: Copy {
    /// The number as a digitiser step; `None` if it is not a whole number from 0 to 65535.
    fn step(self) -> Option<u16>;
    /// The number as text.
    fn shown(self) -> String;
}

macro_rules! whole_samples {
    ($($t:ty)*) => {$(
        impl Sample for $t {
            fn step(self) -> Option<u16> {
                u16::try_from(self).ok()
            }
            fn shown(self) -> String {
                self.to_string()
            }
        }
    )*};
}
whole_samples!(u8 u16 u32 u64 i8 i16 i32 i64);

macro_rules! float_samples {
    ($($t:ty)*) => {$(
        impl Sample for $t {
            fn step(self) -> Option<u16> {
                ((0.0..=65535.0).contains(&self) && self.fract() == 0.0).then_some(self as u16)
            }
            fn shown(self) -> String {
                format!("{self:?}")
            }
        }
    )*};
}
float_samples!(f32 f64);

/// Converts samples to digitiser steps.
fn steps<T: Sample>(values: &[T]) -> PyResult<Vec<u16>> {
    let mut steps = Vec::with_capacity(values.len());
    for (index, value) in values.iter().enumerate() {
        match value.step() {
            Some(step) => steps.push(step),
            None => {
                return Err(errors::data(
                    format!("sample {index} of the array is {}, not a digitiser step", value.shown()),
                    "samples are whole numbers from 0 to 65535; fill gaps and NaN, and scale voltages to steps",
                ));
            }
        }
    }
    Ok(steps)
}

/// Decomposes all waveforms with some threads.
fn decompose(
    samples: &Samples,
    t0_ns: &[f64],
    channel: &ChannelModel,
    config: &Decompose,
    threads: usize,
    cancel: &Cancel,
) -> PyResult<Vec<RecordBatch>> {
    let invalid = |error: &wavex_signal::sensor_model::ModelError| {
        errors::data(format!("the sensor model: {}: {}", error.field, error.problem), "calibrate again")
    };
    let tables = (config.mode != Mode::Slow).then(|| Tables::new(channel)).flatten().map(Arc::new);
    let kernels = config.kernels(channel, tables, SimdLevel::best()).map_err(|error| invalid(&error))?;
    let (waveforms, next) = (samples.waveforms(), AtomicUsize::new(0));
    let chunks = waveforms.div_ceil(CHUNK);
    let work = |mut kernels: wavex_signal::decompose::BatchDecomposer| {
        let (mut done, mut outcomes) = (Vec::new(), Decompositions::default());
        let mut blocks = Vec::with_capacity(CALL);
        loop {
            let chunk = next.fetch_add(1, Ordering::Relaxed);
            if chunk >= chunks || cancel.is_cancelled() {
                return done;
            }
            let some = chunk * CHUNK..((chunk + 1) * CHUNK).min(waveforms);
            let mut columns = Columns::with_room(3 * some.len() / 2);
            for first in some.clone().step_by(CALL) {
                let call = first..(first + CALL).min(some.end);
                blocks.clear();
                blocks.extend(call.clone().map(|i| Waveform { samples: samples.get(i) }));
                kernels.decompose(&blocks, &mut outcomes);
                for (waveform, outcome) in call.zip(outcomes.iter()) {
                    let start_ns = if t0_ns.len() == 1 { t0_ns[0] } else { t0_ns[waveform] };
                    columns.add(waveform, start_ns, channel.sampling_interval_ns, outcome.returns);
                }
            }
            done.push((chunk, columns));
        }
    };
    let threads = threads.clamp(1, chunks.max(1));
    let mut done: Vec<(usize, Columns)> = std::thread::scope(|scope| {
        let others: Vec<_> = (1..threads)
            .map(|_| {
                let kernels = kernels.another();
                scope.spawn(|| work(kernels))
            })
            .collect();
        let own = work(kernels);
        let others = others.into_iter().flat_map(|thread| thread.join().unwrap_or_default());
        own.into_iter().chain(others).collect()
    });
    done.sort_by_key(|(chunk, _)| *chunk);
    if done.len() != chunks && !cancel.is_cancelled() {
        return Err(errors::data("a kernel failed", "please report this bug in wavex with the samples"));
    }
    if done.is_empty() {
        // A table without rows still has its columns.
        done.push((0, Columns::default()));
    }
    done.into_iter().map(|(_, columns)| columns.into_batch()).collect()
}

/// Columns of returns.
#[derive(Default)]
struct Columns {
    waveform: Vec<u64>,
    return_number: Vec<u8>,
    number_of_returns: Vec<u8>,
    flags: Vec<u16>,
    /// Time, amplitude, width ratio, each with its SD, FWHM, deviation ratio.
    values: [Vec<f64>; 8],
}

/// Names of [`Columns::values`].
const VALUES: [(&str, &str); 8] = [
    ("time_ns", "time of the peak: `t0` of the waveform plus its position, ns"),
    ("time_sd_ns", "standard deviation of time_ns"),
    ("amplitude_dn", "peak height above the background, digitiser steps"),
    ("amplitude_sd_dn", "standard deviation of amplitude_dn"),
    ("width_ratio", "full width at half maximum relative to the system response"),
    ("width_ratio_sd", "standard deviation of width_ratio"),
    ("fwhm_ns", "full width at half maximum, ns"),
    ("deviation_ratio", "deviation ratio of the fit of the waveform"),
];

impl Columns {
    fn with_room(returns: usize) -> Columns {
        Columns {
            waveform: Vec::with_capacity(returns),
            return_number: Vec::with_capacity(returns),
            number_of_returns: Vec::with_capacity(returns),
            flags: Vec::with_capacity(returns),
            values: std::array::from_fn(|_| Vec::with_capacity(returns)),
        }
    }

    fn add(
        &mut self,
        waveform: usize,
        start_ns: f64,
        interval_ns: f64,
        returns: &[wavex_signal::decompose::Return],
    ) {
        for (number, found) in (1..).zip(returns) {
            self.waveform.push(waveform as u64);
            self.return_number.push(number);
            self.number_of_returns.push(returns.len().min(255) as u8);
            self.flags.push(found.flags);
            let values = [
                start_ns + found.position_samples * interval_ns,
                found.position_sd_samples * interval_ns,
                found.amplitude_dn,
                found.amplitude_sd_dn,
                found.width_ratio,
                found.width_ratio_sd,
                found.fwhm_ns,
                found.deviation_ratio,
            ];
            self.values.iter_mut().zip(values).for_each(|(column, value)| column.push(value));
        }
    }

    fn into_batch(self) -> PyResult<RecordBatch> {
        let describe = |name: &str, kind: DataType, meaning: &str| {
            let about = [("description".to_owned(), meaning.to_owned())];
            Field::new(name, kind, false).with_metadata(about.into_iter().collect::<Metadata>())
        };
        let mut fields = vec![
            describe("waveform", DataType::UInt64, "index of the waveform, from 0"),
            describe("return_number", DataType::UInt8, "1 for the first return of its waveform"),
            describe("number_of_returns", DataType::UInt8, "number of returns of the waveform"),
        ];
        let mut arrays: Vec<ArrayRef> = vec![
            Arc::new(UInt64Array::from(self.waveform)),
            Arc::new(UInt8Array::from(self.return_number)),
            Arc::new(UInt8Array::from(self.number_of_returns)),
        ];
        for ((name, meaning), values) in VALUES.into_iter().zip(self.values) {
            fields.push(describe(name, DataType::Float64, meaning));
            arrays.push(Arc::new(Float64Array::from(values)));
        }
        fields.push(describe("flags", DataType::UInt16, "bits as in docs/reference/returns.md"));
        arrays.push(Arc::new(UInt16Array::from(self.flags)));
        RecordBatch::try_new(Arc::new(Schema::new(fields)), arrays)
            .map_err(|error| errors::data(error.to_string(), "please report this bug in wavex"))
    }
}

/// Keys of `decompose` from keyword arguments.
fn config_of(keys: Option<&Bound<'_, PyDict>>) -> PyResult<Decompose> {
    let text = format!(
        "{}\n{}\n{}",
        toml_value::stage("simulate", &toml::Table::new())?,
        toml_value::stage("calibrate", &toml::Table::new())?,
        toml_value::stage("decompose", &table(keys)?)?
    );
    let job =
        Job::parse(STAGES, "the keys of decompose", &text, &[]).map_err(|errors| errors::of_job(&errors))?;
    let stage = job.stages.into_iter().next_back();
    let keys = stage.map(|stage| stage.planned.resolved).unwrap_or_default();
    serde_json::from_value(keys)
        .map_err(|error| errors::job(format!("decompose: {error}"), "please report this bug in wavex"))
}

/// Times of the first samples: one number, or one per waveform.
fn start_times(t0: &Bound<'_, PyAny>, waveforms: usize) -> PyResult<Vec<f64>> {
    let wrong = |problem: String| errors::data(problem, "give one number, or one per waveform, ns");
    if let Ok(one) = t0.extract::<f64>() {
        return if one.is_finite() { Ok(vec![one]) } else { Err(wrong(format!("t0 is {one}"))) };
    }
    let array = t0.py().import("numpy")?.call_method1("ascontiguousarray", (t0, "f8"));
    let array = array.map_err(|error| wrong(format!("t0 cannot be converted to an array: {error}")))?;
    let array: PyReadonlyArray1<f64> =
        array.extract().map_err(|_| wrong("t0 is not one-dimensional".to_owned()))?;
    let times = array.as_slice().map_err(|error| wrong(error.to_string()))?;
    if times.len() != waveforms {
        return Err(wrong(format!("t0 has {} values for {waveforms} waveforms", times.len())));
    }
    match times.iter().position(|time| !time.is_finite()) {
        Some(index) => Err(wrong(format!("t0[{index}] is {}", times[index]))),
        None => Ok(times.to_vec()),
    }
}

/// Numbers of samples of the rows of an array of a shape.
fn row_lengths(lengths: &Bound<'_, PyAny>, (waveforms, samples): (usize, usize)) -> PyResult<Vec<usize>> {
    let wrong = |problem: String| errors::data(problem, "give one number of samples per waveform");
    let list = lengths.call_method0("tolist").unwrap_or_else(|_| lengths.clone());
    let lengths: Vec<usize> =
        list.extract().map_err(|error| wrong(format!("`lengths` cannot be converted: {error}")))?;
    if lengths.len() != waveforms {
        return Err(wrong(format!("`lengths` has {} values for {waveforms} waveforms", lengths.len())));
    }
    match lengths.iter().position(|&length| length > samples) {
        Some(row) => {
            Err(wrong(format!("lengths[{row}] is {}, but rows have {samples} samples", lengths[row])))
        }
        None => Ok(lengths),
    }
}

/// What is decomposed, and how.
struct Task<'a> {
    t0: &'a Bound<'a, PyAny>,
    channel: &'a ChannelModel,
    config: Decompose,
    threads: usize,
}

impl Work for Task<'_> {
    type Output = Table;

    fn run(&self, samples: &Samples) -> PyResult<Table> {
        let py = self.t0.py();
        let longest = match samples.ends {
            Ends::Equal(length, _) => length,
            _ => (0..samples.waveforms()).map(|i| samples.range(i).len()).max().unwrap_or(0),
        };
        if longest > MAX_SAMPLES {
            return Err(errors::data(
                format!("a waveform has {longest} samples; the maximum is {MAX_SAMPLES}"),
                "give one waveform per row",
            ));
        }
        let t0_ns = start_times(self.t0, samples.waveforms())?;
        let cancel = Cancel::default();
        let (channel, config, threads) = (self.channel, &self.config, self.threads);
        let batches = interruptible(
            py,
            &cancel,
            |_| Ok(()),
            || decompose(samples, &t0_ns, channel, config, threads, &cancel),
        )??;
        Ok(Table::new(batches))
    }
}

/// Work on samples of any form.
trait Work: Sized {
    type Output;

    fn run(&self, samples: &Samples) -> PyResult<Self::Output>;

    fn of(&self, samples: &Bound<'_, PyAny>, lengths: Option<&Bound<'_, PyAny>>) -> PyResult<Self::Output> {
        with_samples(samples, |given| match given {
            Given::Array(array) => self.of_array(array, lengths),
            Given::Arrow(_) if lengths.is_some() => {
                Err(errors::data("lists have their own lengths", "leave out `lengths`"))
            }
            Given::Arrow(array) => self.of_arrow(array),
        })
    }

    /// Uses a two-dimensional array.
    fn of_array(
        &self,
        array: &Bound<'_, PyUntypedArray>,
        lengths: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Self::Output> {
        let shape = match array.shape() {
            [waveforms, samples] => (*waveforms, *samples),
            shape => {
                return Err(errors::data(
                    format!("the array of samples has {} dimensions", shape.len()),
                    "give one waveform per row: an array of shape (n, m); lists of different lengths as an Arrow \
                     list array",
                ));
            }
        };
        let ends = match lengths {
            Some(lengths) => Ends::Padded(shape.1, row_lengths(lengths, shape)?),
            None => Ends::Equal(shape.1, shape.0),
        };
        // Other byte orders and strides are copied.
        let numpy = array.py().import("numpy")?;
        let native = array.dtype().call_method1("newbyteorder", ("=",))?;
        let array = numpy.call_method1("ascontiguousarray", (array, native))?;
        macro_rules! of_types {
            ($($t:ty)*) => {$(
                if let Ok(array) = array.extract::<PyReadonlyArray2<$t>>() {
                    return self.run(&Samples { values: u16_of(slice(&array)?)?, ends });
                }
            )*};
        }
        of_types!(u16 u8 i16 i32 f32 f64 u32 i64 u64 i8);
        let dtype = array.getattr("dtype")?;
        Err(errors::data(
            format!("samples of type {dtype} cannot be used"),
            "convert them to whole numbers, such as uint16",
        ))
    }

    /// Uses a list array.
    fn of_list<O: OffsetSizeTrait>(
        &self,
        list: &GenericListArray<O>,
        ends: impl for<'a> Fn(&'a [O]) -> Ends<'a>,
    ) -> PyResult<Self::Output> {
        if list.null_count() > 0 || list.values().null_count() > 0 {
            return Err(errors::data(
                "the list array has nulls",
                "use empty lists for missing waveforms, and fill missing samples",
            ));
        }
        let values = list.values();
        macro_rules! of_types {
            ($($t:ident)*) => {$(
                if let Some(values) = values.as_any().downcast_ref::<PrimitiveArray<types::$t>>() {
                    let values = u16_of(values.values())?;
                    return self.run(&Samples { values, ends: ends(list.offsets()) });
                }
            )*};
        }
        of_types!(UInt16Type UInt8Type Int16Type Int32Type UInt32Type Int64Type UInt64Type Int8Type Float32Type Float64Type);
        Err(errors::data(
            format!("samples of type {} cannot be used", values.data_type()),
            "convert them to whole numbers, such as uint16",
        ))
    }

    fn of_arrow(&self, array: &dyn Array) -> PyResult<Self::Output> {
        if let Some(list) = array.as_any().downcast_ref::<GenericListArray<i32>>() {
            return self.of_list(list, |ends| Ends::Small(ends));
        }
        if let Some(list) = array.as_any().downcast_ref::<GenericListArray<i64>>() {
            return self.of_list(list, |ends| Ends::Large(ends));
        }
        Err(errors::data(
            format!("the Arrow array has the type {}", array.data_type()),
            "give a list array, one list of samples per waveform",
        ))
    }
}

fn slice<'a, T: Element>(array: &'a PyReadonlyArray2<'_, T>) -> PyResult<&'a [T]> {
    array.as_slice().map_err(|error| errors::data(error.to_string(), "give a contiguous array"))
}

/// Digitiser steps of samples; those of type `u16` are not copied.
fn u16_of<T: Sample + 'static>(values: &[T]) -> PyResult<std::borrow::Cow<'_, [u16]>> {
    if std::any::TypeId::of::<T>() == std::any::TypeId::of::<u16>() {
        // SAFETY: `T` is `u16`.
        let same = unsafe { std::slice::from_raw_parts(values.as_ptr().cast::<u16>(), values.len()) };
        return Ok(same.into());
    }
    Ok(steps(values)?.into())
}

/// Takes an array of another library through the Arrow PyCapsule interface.
pub fn import_array(object: &Bound<'_, PyAny>) -> PyResult<ArrayRef> {
    let pair = object.call_method0("__arrow_c_array__")?;
    let pair = pair
        .cast_into::<PyTuple>()
        .map_err(|error| errors::data(error.to_string(), "give an Arrow array"))?;
    let schema = pair.get_item(0)?.cast_into::<PyCapsule>()?;
    let array = pair.get_item(1)?.cast_into::<PyCapsule>()?;
    let schema = schema.pointer_checked(Some(c"arrow_schema"))?.cast::<FFI_ArrowSchema>();
    let array = array.pointer_checked(Some(c"arrow_array"))?.cast::<FFI_ArrowArray>();
    let failed =
        |error: arrow_schema::ArrowError| errors::data(error.to_string(), "give a valid Arrow array");
    // SAFETY: the capsules have the names of these structures, and live until the end of the function.
    let (data_type, array) = unsafe {
        let data_type = DataType::try_from(schema.as_ref()).map_err(failed)?;
        // The array is moved out: the capsule's destructor then releases nothing.
        (data_type, FFI_ArrowArray::from_raw(array.as_ptr()))
    };
    // SAFETY: array and type belong together.
    let data = unsafe { from_ffi_and_data_type(array, data_type) }.map_err(failed)?;
    data.validate_full().map_err(failed)?;
    Ok(make_array(data))
}

/// Decompose arrays of samples into returns.
///
/// The GIL is released, and Ctrl-C ends the work. Results do not depend on the number of threads.
///
/// Parameters
/// ----------
/// samples : numpy.ndarray, shape (n, m), or Arrow list array
///     One waveform per row, digitiser steps: whole numbers from 0 to 65535. ``uint16`` in C order is used
///     without a copy; other types, strides and byte orders are converted. An Arrow list array (PyArrow,
///     Polars through ``to_arrow()``) may hold waveforms of different lengths.
/// t0 : float or array, shape (n,)
///     Time of the first sample of each waveform, ns.
/// model : SensorModel
///     Model of the receiver, from :func:`wavex.calibrate` or :func:`wavex.calibrate_samples`.
/// channel : str, optional
///     Channel of the model; defaults to the first with echoes.
/// lengths : array of int, shape (n,), optional
///     Number of samples of each waveform, if rows are padded at their ends.
/// threads : int, optional
///     Number of threads; 0: one per core.
/// **keys
///     Keys of the stage ``decompose``, such as ``mode="fastest"`` or ``detection_sigma=5``. Keys that need
///     a recording, such as ``online_points``, have no effect.
///
/// Returns
/// -------
/// Table
///     One row per return: ``waveform`` (its index), ``time_ns``, ``amplitude_dn``, ``width_ratio``, their
///     standard deviations, ``fwhm_ns``, ``deviation_ratio`` and ``flags``.
///
/// Raises
/// ------
/// DataError
///     If the samples are not digitiser steps.
#[pyfunction]
#[pyo3(signature = (samples, t0, model, *, channel=None, lengths=None, threads=0, **keys))]
pub fn decompose_samples<'py>(
    samples: &Bound<'py, PyAny>,
    t0: &Bound<'py, PyAny>,
    model: &Bound<'py, SensorModel>,
    channel: Option<&str>,
    lengths: Option<&Bound<'py, PyAny>>,
    threads: usize,
    keys: Option<&Bound<'py, PyDict>>,
) -> PyResult<Table> {
    let threads = if threads == 0 { wavex::engine::cores().unwrap_or(1) } else { threads };
    let task = Task { t0, channel: model.get().channel(channel)?, config: config_of(keys)?, threads };
    task.of(samples, lengths)
}

enum Given<'a, 'py> {
    Array(&'a Bound<'py, PyUntypedArray>),
    Arrow(&'a dyn Array),
}

fn with_samples<'py, T>(
    samples: &Bound<'py, PyAny>,
    take: impl FnOnce(Given<'_, 'py>) -> PyResult<T>,
) -> PyResult<T> {
    if samples.hasattr("__arrow_c_array__")? && samples.cast::<PyUntypedArray>().is_err() {
        return take(Given::Arrow(&*import_array(samples)?));
    }
    if samples.hasattr("combine_chunks")? {
        // A chunked array of PyArrow.
        let whole = samples.call_method0("combine_chunks")?;
        return take(Given::Arrow(&*import_array(&whole)?));
    }
    let array = samples.py().import("numpy")?.call_method1("asarray", (samples,));
    let array = array.map_err(|error| {
        errors::data(
            format!("the samples are no array: {error}"),
            "give one waveform per row, or an Arrow list array",
        )
    })?;
    take(Given::Array(array.cast::<PyUntypedArray>()?))
}

/// Calibrate from an array of samples.
///
/// Parameters
/// ----------
/// samples : numpy.ndarray, shape (n, m), or Arrow list array
///     One waveform per row, digitiser steps; at least 200 with an echo. Without `lengths`, zeros that fill
///     rows at their ends are left out.
/// interval_ns : float
///     Sampling interval, ns.
/// full_scale_dn : float, optional
///     Largest value of the digitiser: samples of this value are saturated.
/// lengths : array of int, shape (n,), optional
///     Number of samples of each waveform, if rows are padded at their ends.
///
/// Returns
/// -------
/// SensorModel
///     With the channel ``low``.
#[pyfunction]
#[pyo3(signature = (samples, interval_ns=1.0, full_scale_dn=65535.0, *, lengths=None))]
pub fn calibrate_samples(
    py: Python<'_>,
    samples: &Bound<'_, PyAny>,
    interval_ns: f64,
    full_scale_dn: f64,
    lengths: Option<&Bound<'_, PyAny>>,
) -> PyResult<SensorModel> {
    if !(interval_ns > 0.0 && interval_ns.is_finite() && full_scale_dn > 0.0) {
        return Err(errors::data(
            format!("an interval of {interval_ns} ns or a full scale of {full_scale_dn} is impossible"),
            "give positive numbers",
        ));
    }
    Calibration { py, interval_ns, full_scale_dn }.of(samples, lengths)
}

/// Calibration of a receiver.
struct Calibration<'py> {
    py: Python<'py>,
    interval_ns: f64,
    full_scale_dn: f64,
}

impl Work for Calibration<'_> {
    type Output = SensorModel;

    fn run(&self, samples: &Samples) -> PyResult<SensorModel> {
        use wavex_signal::calibrate::response::calibrate_response;
        use wavex_signal::calibrate::{CalibrationSettings, calibrate};
        let Calibration { py, interval_ns, full_scale_dn } = *self;
        let model = interruptible(
            py,
            &Cancel::default(),
            |_| Ok(()),
            || {
                let blocks = (0..samples.waveforms())
                    .map(|i| Waveform { samples: without_padding(samples.get(i)) })
                    .filter(|waveform| !waveform.samples.is_empty());
                let settings = CalibrationSettings {
                    simd: SimdLevel::best(),
                    ..CalibrationSettings::echoes(interval_ns, full_scale_dn)
                };
                let model = calibrate(blocks.clone(), &settings)?;
                calibrate_response(blocks, &model, &settings)
            },
        )?;
        let model = model
            .map_err(|error: CalibrationError| errors::data(error.to_string(), "give other waveforms"))?;
        let model =
            wavex_signal::sensor_model::SensorModel { low_power: Some(model.model), ..Default::default() };
        Ok(SensorModel::new(Arc::new(model)))
    }
}

/// Fewest zeros at the end of a waveform that are padding.
const PADDING: usize = 8;

/// A waveform without zeros that fill its row; with a background of 0, zeros are samples.
fn without_padding(samples: &[u16]) -> &[u16] {
    let length = samples.iter().rposition(|&sample| sample > 0).map_or(0, |last| last + 1);
    let kept = &samples[..length];
    let zeros = kept.iter().filter(|&&sample| sample == 0).count();
    if samples.len() - length >= PADDING && 2 * zeros < length { kept } else { samples }
}

//! Record batches for Python, through the Arrow PyCapsule interface.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::thread::ThreadId;

use arrow_array::ffi_stream::FFI_ArrowArrayStream;
use arrow_array::{Array, RecordBatch, RecordBatchIterator, RecordBatchReader};
use arrow_schema::{ArrowError, SchemaRef};
use numpy::{IntoPyArray, PyArray1};
use pyo3::exceptions::{PyImportError, PyKeyError, PyStopIteration};
use pyo3::prelude::*;
use pyo3::types::{PyCapsule, PyDict, PyIterator, PyTuple};

use wavex::engine::{Next, RunError, Stream};

use crate::errors;
use crate::wait::SIGNALS;

/// Thread that imported the module: the only one that handles signals.
static MAIN: OnceLock<ThreadId> = OnceLock::new();

/// Remembers the importing thread.
pub fn remember_thread() {
    MAIN.get_or_init(|| std::thread::current().id());
}

/// Source of record batches and the batch read ahead for its schema.
struct Reading {
    source: Stream<RecordBatch>,
    ahead: VecDeque<RecordBatch>,
}

enum Step {
    Batch(RecordBatch),
    End,
    Signal(PyErr),
}

impl Reading {
    /// Next batch; looks for signals while it waits. The GIL is not held.
    fn next(&mut self) -> Result<Step, RunError> {
        if let Some(batch) = self.ahead.pop_front() {
            return Ok(Step::Batch(batch));
        }
        let is_main = MAIN.get() == Some(&std::thread::current().id());
        loop {
            match self.source.next_within(SIGNALS)? {
                Next::Item(batch) => return Ok(Step::Batch(batch)),
                Next::End => return Ok(Step::End),
                Next::Waiting if is_main => {
                    if let Some(Err(error)) = Python::try_attach(|py| py.check_signals()) {
                        self.source.close();
                        return Ok(Step::Signal(error));
                    }
                }
                Next::Waiting => {}
            }
        }
    }

    /// Schema of the batches: that of the first one.
    fn schema(&mut self) -> Result<Result<SchemaRef, PyErr>, RunError> {
        if self.ahead.is_empty() {
            match self.next()? {
                Step::Batch(batch) => self.ahead.push_back(batch),
                Step::End => return Ok(Err(ended())),
                Step::Signal(error) => return Ok(Err(error)),
            }
        }
        Ok(self.ahead.front().map(RecordBatch::schema).ok_or_else(ended))
    }
}

fn ended() -> PyErr {
    errors::data("the reader has no more batches", "open it again")
}

/// Reader of record batches, which come from a run of the engine.
///
/// Iterating yields tables of one batch. Any library that knows the Arrow PyCapsule interface takes a
/// reader as it is: ``pyarrow.table(reader)``, ``polars.DataFrame(reader)``, ``duckdb.sql("from reader")``.
/// A reader is read once. Memory is bounded: the run waits until a batch is taken. Closing or deleting the
/// reader ends the run.
#[pyclass(module = "wavex", frozen)]
pub struct BatchReader {
    reading: Shared,
}

/// The source of a reader and of its exported streams, which may be several: DuckDB takes one for the schema
/// and one for the batches. `None` after it was closed, or once a stream has begun to read.
type Shared = Arc<Mutex<Option<Reading>>>;

impl BatchReader {
    pub fn new(source: Stream<RecordBatch>) -> BatchReader {
        BatchReader { reading: Arc::new(Mutex::new(Some(Reading { source, ahead: VecDeque::new() }))) }
    }

    fn take(&self) -> PyResult<Reading> {
        self.reading.lock().unwrap_or_else(PoisonError::into_inner).take().ok_or_else(|| {
            errors::data("the reader is closed or was handed to another library", "open it again")
        })
    }

    fn put(&self, reading: Reading) {
        *self.reading.lock().unwrap_or_else(PoisonError::into_inner) = Some(reading);
    }
}

#[pymethods]
impl BatchReader {
    fn __iter__(slf: PyRef<'_, Self>) -> PyRef<'_, Self> {
        slf
    }

    fn __next__(&self, py: Python<'_>) -> PyResult<Table> {
        let Ok(mut reading) = self.take() else { return Err(PyStopIteration::new_err(())) };
        let (reading, step) = py.detach(|| {
            let step = reading.next();
            (reading, step)
        });
        match step {
            Ok(Step::Batch(batch)) => {
                self.put(reading);
                Ok(Table::new(vec![batch]))
            }
            Ok(Step::End) => Err(PyStopIteration::new_err(())),
            Ok(Step::Signal(error)) => Err(error),
            Err(error) => Err(errors::of_run(&error)),
        }
    }

    /// Hand the batches to another library, as a capsule ``arrow_array_stream``.
    ///
    /// Parameters
    /// ----------
    /// requested_schema : object, optional
    ///     Ignored: the batches have their own schema.
    #[pyo3(signature = (requested_schema=None))]
    fn __arrow_c_stream__<'py>(
        &self,
        py: Python<'py>,
        requested_schema: Option<Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyCapsule>> {
        drop(requested_schema);
        let mut reading = self.take()?;
        let (reading, schema) = py.detach(|| {
            let schema = reading.schema();
            (reading, schema)
        });
        let schema = schema.map_err(|error| errors::of_run(&error))??;
        self.put(reading);
        stream_capsule(py, Box::new(Exported { shared: Arc::clone(&self.reading), reading: None, schema }))
    }

    /// Refuse to become an array: `pandas.DataFrame` would make one of the batches as objects.
    #[pyo3(signature = (*_args, **_kwargs))]
    fn __array__(&self, _args: Bound<'_, PyTuple>, _kwargs: Option<Bound<'_, PyDict>>) -> PyResult<()> {
        Err(errors::data(
            "a reader is not an array",
            "use `reader.to_pandas()`, or a column: `reader.read_all()[\"range_m\"]`",
        ))
    }

    /// Read all batches into a :class:`Table`.
    ///
    /// Returns
    /// -------
    /// Table
    fn read_all(&self, py: Python<'_>) -> PyResult<Table> {
        let mut reading = self.take()?;
        let (reading, all) = py.detach(|| {
            let mut all = Vec::new();
            let end = loop {
                match reading.next() {
                    Ok(Step::Batch(batch)) => all.push(batch),
                    Ok(Step::End) => break Ok(()),
                    Ok(Step::Signal(error)) => break Err(error),
                    Err(error) => break Err(errors::of_run(&error)),
                }
            };
            (reading, end.map(|()| all))
        });
        drop(reading);
        let mut all = all?;
        // The last batch of a run without rows only has the schema.
        if all.len() > 1 {
            all.retain(|batch| batch.num_rows() > 0);
        }
        Ok(Table::new(all))
    }

    /// The batches as a ``pyarrow.RecordBatchReader``, without copying.
    ///
    /// Returns
    /// -------
    /// pyarrow.RecordBatchReader
    fn to_arrow<'py>(slf: &Bound<'py, Self>) -> PyResult<Bound<'py, PyAny>> {
        let reader = pyarrow(slf.py())?.getattr("RecordBatchReader")?;
        reader.call_method1("from_stream", (slf,))
    }

    /// End the run. Further reading finds no batches.
    fn close(&self, py: Python<'_>) {
        let reading = self.reading.lock().unwrap_or_else(PoisonError::into_inner).take();
        py.detach(|| drop(reading));
    }

    fn __enter__(slf: PyRef<'_, Self>) -> PyRef<'_, Self> {
        slf
    }

    #[pyo3(signature = (*_args))]
    fn __exit__(&self, py: Python<'_>, _args: Bound<'_, PyTuple>) {
        self.close(py);
    }
}

impl Drop for BatchReader {
    fn drop(&mut self) {
        // Exported streams outlive the reader.
        let Some(reading) = Arc::get_mut(&mut self.reading) else { return };
        let reading = reading.get_mut().unwrap_or_else(PoisonError::into_inner).take();
        // The engine's threads may need the GIL to end.
        if reading.is_some() {
            let mut reading = Some(reading);
            let _ = Python::try_attach(|py| {
                let reading = reading.take();
                py.detach(|| drop(reading));
            });
        }
    }
}

/// A reader in the hands of another library, which may call it without the GIL.
struct Exported {
    shared: Shared,
    /// `None` before the first batch.
    reading: Option<Reading>,
    schema: SchemaRef,
}

impl Iterator for Exported {
    type Item = Result<RecordBatch, ArrowError>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.reading.is_none() {
            self.reading = self.shared.lock().unwrap_or_else(PoisonError::into_inner).take();
        }
        let Some(reading) = &mut self.reading else {
            let problem = "the reader is closed or has been read; open it again";
            return Some(Err(ArrowError::ExternalError(problem.into())));
        };
        match reading.next() {
            Ok(Step::Batch(batch)) => Some(Ok(batch)),
            Ok(Step::End) => None,
            Ok(Step::Signal(_)) => {
                // Python handles the signal again once the other library has returned to it.
                // SAFETY: may be called without the GIL and from any thread.
                unsafe { pyo3::ffi::PyErr_SetInterrupt() };
                Some(Err(ArrowError::ExternalError("interrupted".into())))
            }
            Err(error) => Some(Err(ArrowError::ExternalError(Box::new(error)))),
        }
    }
}

impl RecordBatchReader for Exported {
    fn schema(&self) -> SchemaRef {
        SchemaRef::clone(&self.schema)
    }
}

fn stream_capsule<'py>(
    py: Python<'py>,
    reader: Box<dyn RecordBatchReader + Send>,
) -> PyResult<Bound<'py, PyCapsule>> {
    PyCapsule::new_with_value(py, Sendable(FFI_ArrowArrayStream::new(reader)), c"arrow_array_stream")
}

/// A structure of Arrow's C interface, which its consumer moves out of the capsule.
#[repr(transparent)]
struct Sendable<T>(#[allow(dead_code, reason = "the consumer reads it through a pointer")] T);

// SAFETY: structures of the C interface may be moved between threads; the capsule is used with the GIL.
unsafe impl<T> Send for Sendable<T> {}

fn pyarrow(py: Python<'_>) -> PyResult<Bound<'_, PyModule>> {
    py.import("pyarrow").map_err(|error| {
        if !error.is_instance_of::<PyImportError>(py) {
            return error;
        }
        let text = "pyarrow is not installed; run `pip install pyarrow`, or pass the object to another \
                    library that takes Arrow tables, such as Polars";
        let missing = PyImportError::new_err(text);
        missing.set_cause(py, Some(error));
        missing
    })
}

/// Table in memory: columns of equal length.
///
/// A mapping of names to columns as NumPy arrays: ``table["range_m"]``, ``"range_m" in table``,
/// ``dict(table)``. As for frames of pandas, ``len(table)`` is the number of rows, and ``len(table.keys())``
/// that of columns. Libraries that know the Arrow PyCapsule interface take a table as it is:
/// ``pyarrow.table(table)``, ``polars.DataFrame(table)``, ``duckdb.sql("from table")``.
#[pyclass(module = "wavex", frozen)]
pub struct Table {
    batches: Vec<RecordBatch>,
}

impl Table {
    pub fn new(batches: Vec<RecordBatch>) -> Table {
        Table { batches }
    }

    fn schema(&self) -> SchemaRef {
        self.batches
            .first()
            .map_or_else(|| SchemaRef::new(arrow_schema::Schema::empty()), RecordBatch::schema)
    }
}

#[pymethods]
impl Table {
    fn __len__(&self) -> usize {
        self.batches.iter().map(RecordBatch::num_rows).sum()
    }

    /// Names of the columns.
    #[getter]
    fn column_names(&self) -> Vec<String> {
        self.schema().fields().iter().map(|field| field.name().clone()).collect()
    }

    fn __repr__(&self) -> String {
        format!("<wavex.Table of {} rows: {}>", self.__len__(), self.column_names().join(", "))
    }

    /// Names of the columns, as :attr:`column_names`.
    ///
    /// Returns
    /// -------
    /// list of str
    fn keys(&self) -> Vec<String> {
        self.column_names()
    }

    fn __iter__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyIterator>> {
        self.column_names().into_pyobject(py)?.try_iter()
    }

    fn __contains__(&self, column: &Bound<'_, PyAny>) -> bool {
        let schema = self.schema();
        column.extract::<String>().is_ok_and(|name| schema.fields().find(&name).is_some())
    }

    /// Columns as NumPy arrays.
    ///
    /// Returns
    /// -------
    /// list of numpy.ndarray
    fn values<'py>(&self, py: Python<'py>) -> PyResult<Vec<Bound<'py, PyAny>>> {
        self.column_names().iter().map(|name| self.__getitem__(py, name)).collect()
    }

    /// Names and columns.
    ///
    /// Returns
    /// -------
    /// list of (str, numpy.ndarray)
    fn items<'py>(&self, py: Python<'py>) -> PyResult<Vec<(String, Bound<'py, PyAny>)>> {
        Ok(self.column_names().into_iter().zip(self.values(py)?).collect())
    }

    /// A column, or `default` if the table has none of this name.
    #[pyo3(signature = (column, default=None, /))]
    fn get<'py>(
        &self,
        py: Python<'py>,
        column: &Bound<'py, PyAny>,
        default: Option<Bound<'py, PyAny>>,
    ) -> PyResult<Option<Bound<'py, PyAny>>> {
        match column.extract::<String>() {
            Ok(name) if self.__contains__(column) => self.__getitem__(py, &name).map(Some),
            _ => Ok(default),
        }
    }

    /// Refuse to become an array: `pandas.DataFrame` would make one of the names of the columns.
    #[pyo3(signature = (*_args, **_kwargs))]
    fn __array__(&self, _args: Bound<'_, PyTuple>, _kwargs: Option<Bound<'_, PyDict>>) -> PyResult<()> {
        Err(errors::data(
            "a table is not an array",
            "use `table.to_pandas()`, or a column: `table[\"range_m\"]`",
        ))
    }

    /// A column as a NumPy array, shape (n,), of lists of equal length (n, m).
    ///
    /// Nulls are NaN, and columns with nulls are ``float64``.
    fn __getitem__<'py>(&self, py: Python<'py>, column: &str) -> PyResult<Bound<'py, PyAny>> {
        let schema = self.schema();
        let Some((index, _)) = schema.fields().find(column) else {
            return Err(PyKeyError::new_err(format!(
                "no column {column}; columns: {}",
                self.column_names().join(", ")
            )));
        };
        let parts: Vec<&dyn Array> = self.batches.iter().map(|batch| batch.column(index).as_ref()).collect();
        to_numpy(py, column, &parts)
    }

    #[pyo3(signature = (requested_schema=None))]
    fn __arrow_c_stream__<'py>(
        &self,
        py: Python<'py>,
        requested_schema: Option<Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyCapsule>> {
        drop(requested_schema);
        let batches: Vec<_> = self.batches.iter().cloned().map(Ok).collect();
        stream_capsule(py, Box::new(RecordBatchIterator::new(batches, self.schema())))
    }

    /// The table as a ``pyarrow.Table``, without copying.
    ///
    /// Returns
    /// -------
    /// pyarrow.Table
    fn to_arrow<'py>(slf: &Bound<'py, Self>) -> PyResult<Bound<'py, PyAny>> {
        pyarrow(slf.py())?.call_method1("table", (slf,))
    }
}

/// Numbers of columns as `f64`.
mod num_like {
    /// Conversion of a value of a column.
    pub trait ToF64 {
        /// Nearest `f64`.
        fn to_f64(self) -> f64;
    }
    macro_rules! to_f64 {
        ($($t:ty)*) => {$(
            impl ToF64 for $t {
                fn to_f64(self) -> f64 {
                    self as f64
                }
            }
        )*};
    }
    to_f64!(u8 u16 u32 u64 i16 i64 f32 f64);
}

/// Values of a column of several batches as one array.
fn to_numpy<'py>(py: Python<'py>, column: &str, parts: &[&dyn Array]) -> PyResult<Bound<'py, PyAny>> {
    use arrow_array::types::{
        ArrowPrimitiveType, Float32Type, Float64Type, Int16Type, Int64Type, UInt8Type, UInt16Type,
        UInt32Type, UInt64Type,
    };
    use arrow_array::{ArrayRef, BooleanArray, FixedSizeListArray, PrimitiveArray, StringArray};
    use arrow_schema::DataType;
    /// Values as they are; whole numbers with nulls become floating-point numbers.
    fn values<'py, T>(py: Python<'py>, parts: &[&dyn Array]) -> Bound<'py, PyAny>
    where
        T: ArrowPrimitiveType,
        T::Native: numpy::Element + num_like::ToF64,
    {
        let parts = parts.iter().filter_map(|part| part.as_any().downcast_ref::<PrimitiveArray<T>>());
        let rows = parts.clone().map(|part| part.len()).sum();
        if parts.clone().any(|part| part.null_count() > 0) {
            let mut all = Vec::with_capacity(rows);
            parts.for_each(|part| {
                all.extend(part.iter().map(|value| value.map_or(f64::NAN, num_like::ToF64::to_f64)))
            });
            return all.into_pyarray(py).into_any();
        }
        let mut all = Vec::with_capacity(rows);
        parts.for_each(|part| all.extend_from_slice(part.values()));
        all.into_pyarray(py).into_any()
    }
    let Some(first) = parts.first() else {
        return Ok(PyArray1::<f64>::zeros(py, 0, false).into_any());
    };
    Ok(match first.data_type() {
        DataType::Float64 => values::<Float64Type>(py, parts),
        DataType::Float32 => values::<Float32Type>(py, parts),
        DataType::UInt8 => values::<UInt8Type>(py, parts),
        DataType::UInt16 => values::<UInt16Type>(py, parts),
        DataType::UInt32 => values::<UInt32Type>(py, parts),
        DataType::UInt64 => values::<UInt64Type>(py, parts),
        DataType::Int16 => values::<Int16Type>(py, parts),
        DataType::Int64 => values::<Int64Type>(py, parts),
        DataType::Boolean => {
            let of = |part: &&dyn Array| part.as_any().downcast_ref::<BooleanArray>().cloned();
            let all: Vec<bool> = parts
                .iter()
                .filter_map(of)
                .flat_map(|part| part.values().iter().collect::<Vec<_>>())
                .collect();
            all.into_pyarray(py).into_any()
        }
        DataType::Utf8 => {
            let of = |part: &&dyn Array| part.as_any().downcast_ref::<StringArray>().cloned();
            let all: Vec<String> = parts
                .iter()
                .filter_map(of)
                .flat_map(|part| part.iter().flatten().map(str::to_owned).collect::<Vec<_>>())
                .collect();
            py.import("numpy")?.call_method1("array", (all,))?
        }
        DataType::FixedSizeList(_, length) => {
            let of = |part: &&dyn Array| {
                Some(ArrayRef::clone(part.as_any().downcast_ref::<FixedSizeListArray>()?.values()))
            };
            let values: Vec<ArrayRef> = parts.iter().filter_map(of).collect();
            let values: Vec<&dyn Array> = values.iter().map(AsRef::as_ref).collect();
            to_numpy(py, column, &values)?.call_method1("reshape", (-1, *length))?
        }
        DataType::List(_) | DataType::LargeList(_) => {
            return Err(errors::data(
                format!("column {column}: lists have no simple NumPy form"),
                "take it with `to_arrow()` or `to_polars()`, choose others with `columns=[...]`, or read samples \
                 with `Recording.waveforms()`",
            ));
        }
        other => {
            return Err(errors::data(
                format!("column {column}: {other} has no simple NumPy form"),
                "take it with `to_arrow()` or `to_polars()`",
            ));
        }
    })
}

//! Stages written in Python.

use std::sync::Arc;

use numpy::PyReadonlyArray1;
use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyTuple};

use wavex::scan_line::{Content, Kind, ScanLine};
use wavex::stage::{
    Context, Item, MakeMap, Map, Reason, Result, RoleName, RunContext, StageError, StageSpec,
};
use wavex::stages::writers::write_table::{return_batch, return_schema, rows_of};

use crate::batches::Table;

/// Registry entry of all stages in Python.
pub static PYTHON: StageSpec = StageSpec::in_code("python", RoleName::Map, &[Kind::Returns, Kind::Points]);

/// Stage of a job, written in Python: the decorator :func:`wavex.stage`.
///
/// The function receives the returns of one scan line as a :class:`Table` with the columns of
/// :func:`wavex.decompose`. It returns one of:
///
/// * ``None``: nothing changes;
/// * a Boolean array, one value per row: rows with ``False`` are rejected, and counted with ``reason``;
/// * a dictionary or a table of changed columns, with the same rows: ``intensity``, ``intensity_sd``,
///   ``class``, ``withheld``; columns equal to those received are ignored, and others may not change;
/// * a pair of such a table and a Boolean array.
///
/// It is called from the engine's threads, one call at a time, and not always in the order of the lines. Its
/// time is part of the profile of the run.
#[pyclass(module = "wavex", frozen)]
pub struct Stage {
    function: Py<PyAny>,
    /// Name in reports.
    #[pyo3(get)]
    name: String,
    /// Reason of rejections in reports.
    reason: &'static str,
}

#[pymethods]
impl Stage {
    #[new]
    #[pyo3(signature = (function, *, name=None, reason=None))]
    fn new(function: Bound<'_, PyAny>, name: Option<String>, reason: Option<String>) -> PyResult<Stage> {
        if !function.is_callable() {
            return Err(PyTypeError::new_err("wavex.stage decorates a function"));
        }
        let name = match name {
            Some(name) => name,
            None => function
                .getattr("__name__")
                .and_then(|name| name.extract())
                .unwrap_or_else(|_| "python".into()),
        };
        let reason = reason.unwrap_or_else(|| format!("rejected by {name}"));
        // Reports name reasons for as long as the program runs; there are few.
        let reason: &'static str = Box::leak(reason.into_boxed_str());
        Ok(Stage { function: function.unbind(), name, reason })
    }

    /// Call the function itself.
    #[pyo3(signature = (*args, **kwargs))]
    fn __call__<'py>(
        &self,
        py: Python<'py>,
        args: &Bound<'py, PyTuple>,
        kwargs: Option<&Bound<'py, PyDict>>,
    ) -> PyResult<Bound<'py, PyAny>> {
        self.function.bind(py).call(args, kwargs)
    }

    /// Reason of rejections in reports.
    #[getter]
    fn reason(&self) -> &str {
        self.reason
    }

    fn __repr__(&self) -> String {
        format!("<wavex.Stage {}>", self.name)
    }
}

impl Stage {
    /// Name in reports.
    pub fn id(&self) -> &str {
        &self.name
    }

    /// The stage as part of a job.
    pub fn plan(stage: &Py<Stage>, py: Python<'_>) -> Arc<dyn MakeMap> {
        let this = stage.get();
        Arc::new(Function {
            function: this.function.clone_ref(py),
            name: this.name.clone(),
            reason: this.reason,
        })
    }
}

struct Function {
    function: Py<PyAny>,
    name: String,
    reason: &'static str,
}

impl Function {
    fn another(&self) -> Function {
        Python::attach(|py| Function {
            function: self.function.clone_ref(py),
            name: self.name.clone(),
            reason: self.reason,
        })
    }

    fn failed(&self, py: Python<'_>, error: &PyErr) -> StageError {
        let trace = error.traceback(py).and_then(|trace| {
            let line: usize = trace
                .getattr("tb_next")
                .ok()
                .filter(|next| !next.is_none())
                .unwrap_or(trace.into_any())
                .getattr("tb_lineno")
                .ok()?
                .extract()
                .ok()?;
            Some(format!(" (line {line})"))
        });
        StageError::failed(
            format!("the Python stage {} failed{}: {error}", self.name, trace.unwrap_or_default()),
            "correct the function",
        )
    }

    fn wrong(&self, problem: impl std::fmt::Display) -> StageError {
        StageError::failed(
            format!("the Python stage {} returned {problem}", self.name),
            "return None, a mask, changed columns, or both as a pair",
        )
    }
}

impl MakeMap for Function {
    fn make(&self, _: &RunContext) -> Result<Box<dyn Map>> {
        Ok(Box::new(self.another()))
    }

    fn conclude(&self, _: &mut Context) {}
}

impl Map for Function {
    fn map(&mut self, mut line: ScanLine, cx: &mut Context) -> Result<ScanLine> {
        let n = line.n_returns();
        if n == 0 {
            return Ok(line);
        }
        let schema = return_schema(&line.input, line.kind() == Kind::Points);
        let rows: Vec<_> = rows_of(&line).collect();
        if rows.len() != n {
            return Err(StageError::failed(
                "a return belongs to no shot of its line",
                "please report this bug in wavex",
            ));
        }
        let table = Table::new(vec![return_batch(&schema, &rows)?]);
        let removed = Python::attach(|py| {
            let table = Bound::new(py, table).map_err(|error| self.failed(py, &error))?;
            let given = self.function.bind(py).call1((&table,)).map_err(|error| self.failed(py, &error))?;
            let (columns, mask) = match given.cast::<PyTuple>() {
                Ok(pair) if pair.len() == 2 => {
                    let item = |index| pair.get_item(index).map_err(|error| self.failed(py, &error));
                    (Some(item(0)?), Some(item(1)?))
                }
                Ok(other) => return Err(self.wrong(format!("a tuple of {}", other.len()))),
                Err(_) if given.is_none() => (None, None),
                Err(_) if is_table(&given) => (Some(given), None),
                Err(_) => (None, Some(given)),
            };
            if let Some(columns) = columns.filter(|columns| !columns.is_none()) {
                self.change(&columns, &table, &mut line)?;
            }
            mask.filter(|mask| !mask.is_none()).map(|mask| self.removed(&mask, n)).transpose()
        })?;
        if let Some(removed) = removed {
            let reason = Reason::Custom(Item::Returns, self.reason);
            let n = line.remove_returns(&removed, reason);
            cx.reject(reason, n);
        }
        Ok(line)
    }
}

/// Whether an object is a table or a dictionary of columns.
fn is_table(object: &Bound<'_, PyAny>) -> bool {
    object.is_instance_of::<PyDict>()
        || object.hasattr("__arrow_c_stream__").unwrap_or(false)
            && object.hasattr("column_names").unwrap_or(false)
        || object.hasattr("columns").unwrap_or(false)
}

impl Function {
    /// Returns to remove, from a mask of those to keep.
    fn removed(&self, mask: &Bound<'_, PyAny>, n: usize) -> Result<Vec<bool>> {
        let py = mask.py();
        let array = py.import("numpy").and_then(|numpy| numpy.call_method1("ascontiguousarray", (mask,)));
        let array = array.map_err(|error| self.failed(py, &error))?;
        let Ok(array) = array.extract::<PyReadonlyArray1<bool>>() else {
            let kind =
                mask.get_type().name().map_or_else(|_| "an object".to_owned(), |name| name.to_string());
            return Err(self.wrong(format!("a {kind} that is no one-dimensional Boolean array")));
        };
        match array.as_slice() {
            Ok(keep) if keep.len() == n => Ok(keep.iter().map(|keep| !keep).collect()),
            _ => Err(self.wrong(format!("a mask of {} values for {n} rows", array.as_array().len()))),
        }
    }

    /// Takes over changed columns.
    fn change(
        &self,
        columns: &Bound<'_, PyAny>,
        given: &Bound<'_, Table>,
        line: &mut ScanLine,
    ) -> Result<()> {
        let py = columns.py();
        let failed = |error: PyErr| self.failed(py, &error);
        let names = match columns.cast::<PyDict>() {
            Ok(columns) => columns.keys().into_any(),
            Err(_) if columns.hasattr("column_names").unwrap_or(false) => {
                columns.getattr("column_names").map_err(failed)?
            }
            Err(_) => columns.getattr("columns").map_err(failed)?,
        };
        let numpy = py.import("numpy").map_err(failed)?;
        let names: Vec<String> =
            names.try_iter().and_then(|names| names.map(|name| name?.extract()).collect()).map_err(failed)?;
        let returns = match &mut line.content {
            Content::Returns(returns) | Content::Points(returns, _) => returns,
            Content::Shots(_) => return Ok(()),
        };
        for name in names {
            let column = columns.get_item(&name).map_err(failed)?;
            let column = if column.hasattr("to_numpy").unwrap_or(false) {
                let options = PyDict::new(py);
                if column.hasattr("combine_chunks").unwrap_or(false) {
                    options.set_item("zero_copy_only", false).map_err(failed)?;
                }
                column
                    .call_method("to_numpy", (), Some(&options))
                    .or_else(|_| column.call_method0("to_numpy"))
            } else {
                numpy.call_method1("asarray", (column,))
            };
            let column = column.map_err(failed)?;
            let as_type =
                |kind: &str| numpy.call_method1("ascontiguousarray", (&column, kind)).map_err(failed);
            let wrong = |len: usize| self.wrong(format!("{len} values of {name} for {} rows", returns.len()));
            macro_rules! set {
                ($kind:literal, $t:ty, $field:ident) => {{
                    let column = as_type($kind)?;
                    let column: PyReadonlyArray1<$t> = column
                        .extract()
                        .map_err(|_| self.wrong(format!("{name} that is not one-dimensional")))?;
                    let values = column.as_slice().map_err(|error| self.wrong(error))?;
                    if values.len() != returns.len() {
                        return Err(wrong(values.len()));
                    }
                    returns.iter_mut().zip(values).for_each(|(found, value)| found.$field = *value);
                }};
            }
            match name.as_str() {
                "intensity" => set!("f8", f64, intensity),
                "intensity_sd" => set!("f8", f64, intensity_sd),
                "class" => set!("u1", u8, class),
                "withheld" => set!("?", bool, withheld),
                _ => {
                    let before = given.get_item(&name).ok();
                    let is_known = before.is_some();
                    let options = PyDict::new(py);
                    let has_nan =
                        column.getattr("dtype").and_then(|kind| kind.getattr("kind")?.extract::<String>());
                    options.set_item("equal_nan", has_nan.is_ok_and(|kind| kind == "f")).map_err(failed)?;
                    let same = before.map(|before| {
                        numpy.call_method("array_equal", (before, &column), Some(&options))?.is_truthy()
                    });
                    // Columns without a simple form cannot be compared: they are left as they are.
                    if !is_known && line_has(&name) {
                        continue;
                    }
                    if !same.transpose().map_err(failed)?.unwrap_or(false) {
                        return Err(StageError::failed(
                            format!("the Python stage {} changed the column {name}", self.name),
                            "change intensity, intensity_sd, class or withheld; write other results to a table of your own",
                        ));
                    }
                }
            }
        }
        Ok(())
    }
}

/// Whether the table of returns has a column.
fn line_has(name: &str) -> bool {
    let schema = return_schema(&wavex::scan_line::InputInfo::default(), false);
    schema.fields().find(name).is_some()
}

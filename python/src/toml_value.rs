//! Python values as TOML.

use pyo3::prelude::*;
use pyo3::types::{PyBool, PyDict, PyFloat, PyInt, PyList, PyString, PyTuple};
use toml::{Table, Value};

use crate::errors;

/// Maximum depth of nested lists and dictionaries.
const DEPTH: u32 = 16;

/// Converts keyword arguments to the keys of a table; `None` values are left out.
pub fn table(keys: Option<&Bound<'_, PyDict>>) -> PyResult<Table> {
    keys.map_or(Ok(Table::new()), |keys| of_dict(keys, DEPTH))
}

fn of_dict(keys: &Bound<'_, PyDict>, depth: u32) -> PyResult<Table> {
    let mut table = Table::new();
    for (key, value) in keys {
        let name: String = key
            .extract()
            .map_err(|_| errors::job(format!("the key {key} is not text"), "give names of keys as text"))?;
        if !value.is_none() {
            table.insert(name.clone(), of_value(&name, &value, depth)?);
        }
    }
    Ok(table)
}

/// Converts a value; errors name it `name`.
fn of_value(name: &str, value: &Bound<'_, PyAny>, depth: u32) -> PyResult<Value> {
    let wrong = || {
        let kind = value.get_type().name().map_or_else(|_| "object".to_owned(), |name| name.to_string());
        errors::job(
            format!("`{name}`: a value of type {kind} cannot be part of a job"),
            "give text, a path, a number, a truth value, a list or a dictionary",
        )
    };
    let Some(depth) = depth.checked_sub(1) else { return Err(wrong()) };
    if value.is_instance_of::<PyBool>() {
        return Ok(Value::Boolean(value.extract()?));
    }
    if value.is_instance_of::<PyInt>() {
        return value.extract().map(Value::Integer).map_err(|_| wrong());
    }
    if value.is_instance_of::<PyFloat>() {
        return Ok(Value::Float(value.extract()?));
    }
    if value.is_instance_of::<PyString>() {
        return Ok(Value::String(value.extract()?));
    }
    if let Ok(keys) = value.cast::<PyDict>() {
        return Ok(Value::Table(of_dict(keys, depth)?));
    }
    if value.is_instance_of::<PyList>() || value.is_instance_of::<PyTuple>() {
        let items = value.try_iter()?.map(|item| of_value(name, &item?, depth));
        return Ok(Value::Array(items.collect::<PyResult<_>>()?));
    }
    if value.hasattr("__fspath__")? {
        return Ok(Value::String(value.call_method0("__fspath__")?.extract()?));
    }
    // Numbers and arrays of NumPy.
    if value.hasattr("tolist")? {
        let plain = value.call_method0("tolist")?;
        if !plain.is(value) {
            return of_value(name, &plain, depth);
        }
    }
    Err(wrong())
}

/// Text of a stage of a job.
pub fn stage(name: &str, keys: &Table) -> PyResult<String> {
    let mut stage = Table::new();
    stage.insert("type".into(), Value::String(name.to_owned()));
    stage.extend(keys.clone());
    let mut job = Table::new();
    job.insert("stage".into(), Value::Array(vec![Value::Table(stage)]));
    text(&job)
}

/// Text of a table.
pub fn text(table: &Table) -> PyResult<String> {
    toml::to_string(table)
        .map_err(|error| errors::job(format!("the keys cannot be written as TOML: {error}"), "simplify them"))
}

//! Python package of wavex: the module `wavex._wavex`.
//!
//! Glue between Python and the crate `wavex`: it converts arguments, results and errors. `wavex/*.py`
//! has what is shorter in Python.

use std::ffi::OsString;

use pyo3::prelude::*;

mod align;
mod batches;
mod chain;
mod convert;
mod errors;
mod job;
mod lines;
mod model;
mod process;
mod recording;
mod samples;
mod stage;
mod toml_value;
mod wait;
mod waveforms;

/// Runs the command line; returns the exit code.
#[pyfunction]
fn main(py: Python<'_>, arguments: Vec<OsString>) -> u8 {
    py.detach(|| wavex::cli::main_with(arguments))
}

#[pymodule]
fn _wavex(module: &Bound<'_, PyModule>) -> PyResult<()> {
    batches::remember_thread();
    errors::register(module)?;
    lines::register(module)?;
    recording::register(module)?;
    process::register(module)?;
    module.add_class::<align::Alignment>()?;
    module.add_class::<batches::BatchReader>()?;
    module.add_class::<batches::Table>()?;
    module.add_class::<job::Job>()?;
    module.add_class::<model::SensorModel>()?;
    module.add_class::<stage::Stage>()?;
    module.add_function(wrap_pyfunction!(main, module)?)?;
    module.add_function(wrap_pyfunction!(align::align, module)?)?;
    module.add_function(wrap_pyfunction!(recording::open, module)?)?;
    module.add_function(wrap_pyfunction!(recording::simulate, module)?)?;
    module.add_function(wrap_pyfunction!(process::calibrate, module)?)?;
    module.add_function(wrap_pyfunction!(process::decompose, module)?)?;
    module.add_function(wrap_pyfunction!(process::explain, module)?)?;
    module.add_function(wrap_pyfunction!(samples::calibrate_samples, module)?)?;
    module.add_function(wrap_pyfunction!(samples::decompose_samples, module)?)?;
    module.add_function(wrap_pyfunction!(waveforms::read_blocks, module)?)?;
    module.add_function(wrap_pyfunction!(job::run, module)?)?;
    module.add_function(wrap_pyfunction!(job::stages, module)?)?;
    module.add("__version__", env!("CARGO_PKG_VERSION"))
}

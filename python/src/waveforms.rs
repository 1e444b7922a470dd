//! Sample blocks of one channel, for `wavex/_waveforms.py`.

use numpy::IntoPyArray;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::lines::{at, channel_name};
use crate::recording::Recording;

/// Blocks of a channel as columns, and all their samples in one.
#[derive(Default)]
struct Columns {
    shot: Vec<u64>,
    t0_ns: Vec<f64>,
    interval_ns: Vec<f64>,
    gain: Vec<f64>,
    length: Vec<u64>,
    samples: Vec<u16>,
    fractions: Vec<f32>,
}

/// Reads the sample blocks of a channel from scan lines.
///
/// Returns a dictionary of arrays: one value per block, and ``samples``, those of all blocks: ``float32`` if they are
/// fractions of a step.
#[pyfunction]
pub fn read_blocks<'py>(
    recording: &Bound<'py, Recording>,
    channel: &str,
    lines: Vec<isize>,
) -> PyResult<Bound<'py, PyDict>> {
    let py = recording.py();
    let recording = recording.get();
    let count = recording.index(py)?.lines().len();
    let mut columns = Columns::default();
    for number in lines {
        py.check_signals()?;
        let line = recording.line(py, at(number, count, "line")?)?.line;
        let Some(blocks) = line.blocks() else { continue };
        for block in blocks.iter().filter(|block| channel_name(block.channel) == channel) {
            columns.shot.push(line.emissions[block.emission as usize].shot);
            columns.t0_ns.push(block.start_ns);
            columns.interval_ns.push(block.interval_ns);
            columns.gain.push(block.gain);
            columns.length.push(block.len() as u64);
            columns.samples.extend_from_slice(blocks.samples(block));
            columns.fractions.extend_from_slice(blocks.fractions(block));
        }
    }
    let arrays = PyDict::new(py);
    arrays.set_item("shot", columns.shot.into_pyarray(py))?;
    arrays.set_item("t0_ns", columns.t0_ns.into_pyarray(py))?;
    arrays.set_item("interval_ns", columns.interval_ns.into_pyarray(py))?;
    arrays.set_item("gain", columns.gain.into_pyarray(py))?;
    arrays.set_item("length", columns.length.into_pyarray(py))?;
    match columns.fractions.is_empty() {
        true => arrays.set_item("samples", columns.samples.into_pyarray(py))?,
        false => arrays.set_item("samples", columns.fractions.into_pyarray(py))?,
    }
    Ok(arrays)
}

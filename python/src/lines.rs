//! Scan lines, shots and sample blocks.

use std::sync::Arc;

use numpy::ndarray::ArrayView1;
use numpy::{Element, PyArray1, PyArrayMethods};
use pyo3::exceptions::PyIndexError;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyTuple};

use wavex::scan_line::{Block as SampleBlock, Channel, ScanLine};

use crate::batches::Table;
use crate::errors;
use crate::recording::Recording;

/// Scan lines of a recording: a sequence.
#[pyclass(module = "wavex", frozen, sequence)]
pub struct Lines {
    pub recording: Py<Recording>,
}

#[pymethods]
impl Lines {
    fn __len__(&self, py: Python<'_>) -> PyResult<usize> {
        Ok(self.recording.get().index(py)?.lines().len())
    }

    fn __getitem__(&self, py: Python<'_>, number: isize) -> PyResult<Line> {
        let recording = self.recording.get();
        recording.line(py, at(number, recording.index(py)?.lines().len(), "line")?)
    }
}

/// Index from the start; a negative one counts from the end.
pub fn at(number: isize, len: usize, what: &str) -> PyResult<usize> {
    let index = if number < 0 { number.checked_add_unsigned(len) } else { Some(number) };
    let index = index.and_then(|index| usize::try_from(index).ok()).filter(|index| *index < len);
    index.ok_or_else(|| PyIndexError::new_err(format!("no {what} {number} of {len}")))
}

/// Scan line: a sequence of :class:`Shot`.
#[pyclass(module = "wavex", frozen, sequence)]
pub struct Line {
    pub line: Arc<ScanLine>,
}

impl Line {
    pub fn new(line: ScanLine) -> Line {
        Line { line: Arc::new(line) }
    }
}

#[pymethods]
impl Line {
    /// Number of the line, from 0.
    #[getter]
    fn number(&self) -> u32 {
        self.line.line
    }

    fn __len__(&self) -> usize {
        self.line.emissions.len()
    }

    fn __getitem__(&self, number: isize) -> PyResult<Shot> {
        let index = at(number, self.line.emissions.len(), "shot")?;
        Ok(Shot { line: Arc::clone(&self.line), index })
    }

    /// Shots and samples as a table, one row per shot.
    ///
    /// Returns
    /// -------
    /// Table
    fn table(&self) -> PyResult<Table> {
        let schema = wavex::stages::writers::write_arrow::shot_schema(
            &self.line.input,
            self.line.blocks().is_some_and(|blocks| blocks.has_fractions()),
        );
        let batch = wavex::stages::writers::write_arrow::shot_batch(&self.line, &schema).transpose();
        let batch = batch.map_err(|error| errors::of_stage(&error))?;
        Ok(Table::new(batch.into_iter().collect()))
    }

    fn __repr__(&self) -> String {
        format!("<wavex.Line {} of {} shots>", self.line.line, self.line.emissions.len())
    }
}

/// One emission of the laser and what was recorded for it.
#[pyclass(module = "wavex", frozen)]
pub struct Shot {
    pub line: Arc<ScanLine>,
    /// Position in the line.
    pub index: usize,
}

impl Shot {
    fn emission(&self) -> &wavex::scan_line::Emission {
        &self.line.emissions[self.index]
    }

    fn sample_blocks(&self) -> impl Iterator<Item = (usize, &SampleBlock)> {
        let index = self.index as u32;
        self.line.blocks().into_iter().flat_map(move |blocks| blocks.of_emission(index))
    }
}

/// Name of a channel in Python.
pub fn channel_name(channel: Channel) -> &'static str {
    match channel {
        Channel::HighPower => "high",
        Channel::LowPower => "low",
        Channel::Saturation => "saturation",
        Channel::Reference => "reference",
    }
}

#[pymethods]
impl Shot {
    /// Running number of the shot in the recording.
    #[getter]
    fn number(&self) -> u64 {
        self.emission().shot
    }

    /// Number of its scan line.
    #[getter]
    fn line(&self) -> u32 {
        self.line.line
    }

    /// Time of the shot, s; NaN where unknown.
    #[getter]
    fn gps_time_s(&self) -> f64 {
        self.emission().gps_time_s
    }

    /// Time on the clock of the instrument, ps.
    #[getter]
    fn clock_ps(&self) -> i64 {
        self.emission().clock_ps
    }

    /// Origin of the beam, m, in the frame of the recording.
    #[getter]
    fn origin_m(&self) -> [f64; 3] {
        self.emission().origin_m
    }

    /// Unit vector along the outgoing beam.
    #[getter]
    fn direction(&self) -> [f64; 3] {
        self.emission().direction
    }

    /// Mirror facet.
    #[getter]
    fn facet(&self) -> u16 {
        self.emission().facet
    }

    /// Samples of the first block of each channel, digitiser steps: arrays without a copy, as :attr:`Block.samples`.
    ///
    /// Arrays are read-only. :attr:`blocks` has all blocks.
    #[getter]
    fn samples<'py>(slf: &Bound<'py, Self>) -> PyResult<Bound<'py, PyDict>> {
        Shot::by_channel(slf, |block| Block::samples(&block))
    }

    /// Time of the first sample of each channel's first block after the shot's clock, ns.
    #[getter]
    fn t0_ns<'py>(slf: &Bound<'py, Self>) -> PyResult<Bound<'py, PyDict>> {
        Shot::by_channel(slf, |block| Ok(block.get().block().start_ns.into_pyobject(block.py())?.into_any()))
    }

    /// All sample blocks, in the order of the recording.
    #[getter]
    fn blocks(&self) -> Vec<Block> {
        self.sample_blocks().map(|(index, _)| Block { line: Arc::clone(&self.line), index }).collect()
    }

    fn __repr__(&self) -> String {
        let blocks: Vec<String> = self
            .sample_blocks()
            .map(|(_, block)| format!("{} {} samples", channel_name(block.channel), block.len()))
            .collect();
        format!("<wavex.Shot {}: {}>", self.emission().shot, blocks.join(", "))
    }
}

impl Shot {
    fn by_channel<'py>(
        slf: &Bound<'py, Self>,
        value: impl Fn(Bound<'py, Block>) -> PyResult<Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let values = PyDict::new(slf.py());
        for block in slf.get().blocks() {
            let name = channel_name(block.block().channel);
            if !values.contains(name)? {
                values.set_item(name, value(Bound::new(slf.py(), block)?)?)?;
            }
        }
        Ok(values)
    }
}

/// Contiguous samples of one channel.
#[pyclass(module = "wavex", frozen)]
pub struct Block {
    line: Arc<ScanLine>,
    index: usize,
}

impl Block {
    fn block(&self) -> SampleBlock {
        // Made by `Shot::blocks`, from the blocks of the line.
        self.line
            .blocks()
            .and_then(|blocks| blocks.get(self.index).copied())
            .unwrap_or_else(|| unreachable!("the line has the block"))
    }
}

#[pymethods]
impl Block {
    /// Channel: ``low``, ``high``, ``saturation`` or ``reference`` (the outgoing pulse).
    #[getter]
    fn channel(&self) -> &'static str {
        channel_name(self.block().channel)
    }

    /// Time of the first sample after the shot's clock, ns.
    #[getter]
    fn t0_ns(&self) -> f64 {
        self.block().start_ns
    }

    /// Sampling interval, ns.
    #[getter]
    fn interval_ns(&self) -> f64 {
        self.block().interval_ns
    }

    /// Gain relative to the reference gain.
    #[getter]
    fn gain(&self) -> f64 {
        self.block().gain
    }

    /// Samples, digitiser steps: a read-only array without a copy, shape (n,). ``float32`` if they are
    /// fractions of a step, else ``uint16``.
    #[getter]
    fn samples<'py>(slf: &Bound<'py, Self>) -> PyResult<Bound<'py, PyAny>> {
        let this = slf.get();
        let block = this.block();
        let blocks = this.line.blocks();
        Ok(match block.has_fractions() {
            true => borrowed(slf, blocks.map_or(&[][..], |blocks| blocks.fractions(&block))),
            false => borrowed(slf, blocks.map_or(&[][..], |blocks| blocks.samples(&block))),
        })
    }

    fn __len__(&self) -> usize {
        self.block().len()
    }

    fn __repr__(&self) -> String {
        let block = self.block();
        format!(
            "<wavex.Block {}: {} samples from {} ns>",
            channel_name(block.channel),
            block.len(),
            block.start_ns
        )
    }
}

/// Read-only array of samples that belong to the line of a block.
fn borrowed<'py, T: Element>(block: &Bound<'py, Block>, samples: &[T]) -> Bound<'py, PyAny> {
    // SAFETY: the samples belong to the line, which the array's base, the block, keeps; nothing changes
    // them, and the array is read-only.
    let array = unsafe { PyArray1::borrow_from_array(&ArrayView1::from(samples), block.clone().into_any()) };
    array.readwrite().make_nonwriteable();
    array.into_any()
}

/// Adds the classes to the module.
pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<Lines>()?;
    module.add_class::<Line>()?;
    module.add_class::<Shot>()?;
    module.add_class::<Block>()?;
    let sequence = module.py().import("collections.abc")?.getattr("Sequence")?;
    for name in ["Lines", "Line"] {
        sequence.call_method1("register", PyTuple::new(module.py(), [module.getattr(name)?])?)?;
    }
    Ok(())
}

//! Sensor models.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use numpy::{IntoPyArray, PyArray1};
use pyo3::prelude::*;
use pyo3::types::PyType;

use wavex::stages::process::calibrate::{load_model, model_json, parse_model};
use wavex_signal::sensor_model::{ChannelModel, SensorModel as Model};
use wavex_signal::shape::Shape;

use crate::errors;

/// Sensor model: noise, background and system response of each channel.
///
/// Made by :func:`wavex.calibrate`, or read with :meth:`load`.
#[pyclass(module = "wavex", frozen)]
pub struct SensorModel {
    pub model: Arc<Model>,
}

/// Names of the channels in Python.
pub const CHANNELS: [&str; 3] = ["low", "high", "reference"];

impl SensorModel {
    pub fn new(model: Arc<Model>) -> SensorModel {
        SensorModel { model }
    }

    /// Model of a channel; without a name, of the first that records echoes.
    pub fn channel(&self, name: Option<&str>) -> PyResult<&ChannelModel> {
        let Model { low_power, high_power, reference, .. } = &*self.model;
        let found = match name {
            None => low_power.as_ref().or(high_power.as_ref()),
            Some("low") => low_power.as_ref(),
            Some("high") => high_power.as_ref(),
            Some("reference") => reference.as_ref(),
            Some(other) => {
                return Err(errors::data(
                    format!("there is no channel `{other}`"),
                    format!("channels: {}", CHANNELS.join(", ")),
                ));
            }
        };
        found.ok_or_else(|| {
            errors::data(
                format!("the sensor model has no channel {}", name.unwrap_or("that records echoes")),
                format!("it has: {}", self.channels().join(", ")),
            )
        })
    }
}

#[pymethods]
impl SensorModel {
    /// Parse the JSON text of a model.
    ///
    /// Parameters
    /// ----------
    /// text : str
    ///
    /// Returns
    /// -------
    /// SensorModel
    #[classmethod]
    fn from_json(_: &Bound<'_, PyType>, text: &str) -> PyResult<SensorModel> {
        let model =
            parse_model(text, Path::new("the sensor model")).map_err(|error| errors::of_stage(&error))?;
        Ok(SensorModel::new(Arc::new(model)))
    }

    /// Read a model file, as ``save`` of the stage ``calibrate`` writes it.
    ///
    /// Parameters
    /// ----------
    /// path : str or os.PathLike
    ///
    /// Returns
    /// -------
    /// SensorModel
    #[classmethod]
    fn load(_: &Bound<'_, PyType>, path: PathBuf) -> PyResult<SensorModel> {
        let model = load_model(&path).map_err(|error| errors::of_stage(&error))?;
        Ok(SensorModel::new(Arc::new(model)))
    }

    /// The model as JSON, which ``load`` of the stage ``calibrate`` reads.
    ///
    /// Returns
    /// -------
    /// str
    fn to_json(&self) -> PyResult<String> {
        model_json(&self.model).map_err(|error| errors::of_stage(&error))
    }

    /// Write the model to a file.
    ///
    /// Parameters
    /// ----------
    /// path : str or os.PathLike
    fn save(&self, path: PathBuf) -> PyResult<()> {
        let text = self.to_json()?;
        let written = write_whole(&path, &text);
        written.map_err(|error| errors::of_stage(&error.into()))
    }

    /// Names of the calibrated channels: of ``low``, ``high`` and ``reference`` (the outgoing pulse).
    #[getter]
    fn channels(&self) -> Vec<&'static str> {
        let Model { low_power, high_power, reference, .. } = &*self.model;
        let has = [low_power.is_some(), high_power.is_some(), reference.is_some()];
        CHANNELS.into_iter().zip(has).filter_map(|(name, has)| has.then_some(name)).collect()
    }

    /// Sampling interval of a channel, ns.
    ///
    /// Parameters
    /// ----------
    /// channel : str, optional
    ///     Defaults to the first channel with echoes.
    #[pyo3(signature = (channel=None))]
    fn sampling_interval_ns(&self, channel: Option<&str>) -> PyResult<f64> {
        Ok(self.channel(channel)?.sampling_interval_ns)
    }

    /// Standard deviation of the noise of a channel, digitiser steps.
    #[pyo3(signature = (channel=None))]
    fn noise_sd_dn(&self, channel: Option<&str>) -> PyResult<f64> {
        Ok(self.channel(channel)?.noise_sd_dn)
    }

    /// Background of a channel, mean over the sample phases, digitiser steps.
    #[pyo3(signature = (channel=None))]
    fn background_dn(&self, channel: Option<&str>) -> PyResult<f64> {
        let background = self.channel(channel)?.background_dn;
        Ok(background.iter().sum::<f64>() / background.len() as f64)
    }

    /// Full width at half maximum of the system response, ns.
    #[pyo3(signature = (channel=None))]
    fn pulse_fwhm_ns(&self, channel: Option<&str>) -> PyResult<f64> {
        Ok(self.channel(channel)?.pulse_fwhm_ns)
    }

    /// System response of a channel: the waveform of a flat target.
    ///
    /// Parameters
    /// ----------
    /// channel : str, optional
    ///     Defaults to the first channel with echoes.
    ///
    /// Returns
    /// -------
    /// time_ns : numpy.ndarray, shape (n,)
    ///     Time from the peak, ns, eight points per sample.
    /// value : numpy.ndarray, shape (n,)
    ///     Value relative to the peak.
    #[pyo3(signature = (channel=None))]
    #[allow(clippy::type_complexity, reason = "two arrays")]
    fn response<'py>(
        &self,
        py: Python<'py>,
        channel: Option<&str>,
    ) -> PyResult<(Bound<'py, PyArray1<f64>>, Bound<'py, PyArray1<f64>>)> {
        const POINTS: usize = 8;
        let channel = self.channel(channel)?;
        let shape = Shape::of(channel).map_err(|error| {
            errors::data(format!("{}: {}", error.field, error.problem), "calibrate again")
        })?;
        let before = (3.0 * channel.fwhm_samples()).ceil();
        let samples = (9.0 * channel.fwhm_samples()).ceil() as usize;
        let (mut times, mut values) = (vec![0.0; samples * POINTS], vec![0.0; samples * POINTS]);
        for point in 0..POINTS {
            let offset = point as f64 / POINTS as f64;
            let mut samples_dn = vec![0.0; samples];
            let pulse = wavex_signal::simulated::pulse(1.0, before - offset, 1.0);
            shape.add(&pulse, 1.0, &mut samples_dn);
            for (k, value) in samples_dn.into_iter().enumerate() {
                values[k * POINTS + point] = value;
                times[k * POINTS + point] = (k as f64 + offset - before) * channel.sampling_interval_ns;
            }
        }
        Ok((times.into_pyarray(py), values.into_pyarray(py)))
    }

    /// Draw the system response of each channel with Matplotlib.
    ///
    /// Parameters
    /// ----------
    /// ax : matplotlib.axes.Axes, optional
    ///     Axes to draw on; new ones by default.
    ///
    /// Returns
    /// -------
    /// matplotlib.axes.Axes
    #[pyo3(signature = (ax=None))]
    fn plot<'py>(slf: &Bound<'py, Self>, ax: Option<Bound<'py, PyAny>>) -> PyResult<Bound<'py, PyAny>> {
        slf.py().import("wavex._plot")?.call_method1("plot_model", (slf, ax))
    }

    fn __repr__(&self) -> String {
        let channels = self.channels();
        let of = |name: &&str| {
            self.channel(Some(name)).map_or_else(
                |_| String::new(),
                |of| {
                    let (noise, fwhm) = (of.noise_sd_dn, of.pulse_fwhm_ns);
                    format!("{name}: noise SD {noise:.3} DN, pulse FWHM {fwhm:.3} ns")
                },
            )
        };
        format!("<wavex.SensorModel {}>", channels.iter().map(of).collect::<Vec<_>>().join("; "))
    }

    fn __eq__(&self, other: &Bound<'_, PyAny>) -> bool {
        other.cast::<SensorModel>().is_ok_and(|other| other.get().model == self.model)
    }

    fn __reduce__(slf: &Bound<'_, Self>) -> PyResult<(Py<PyAny>, (String,))> {
        let text = slf.get().to_json()?;
        Ok((slf.get_type().getattr("from_json")?.unbind(), (text,)))
    }
}

/// Writes a file, which gets its final name only when complete.
fn write_whole(path: &Path, text: &str) -> wavex_formats::Result<()> {
    use std::io::Write;
    let mut file = wavex::stage::OutputFile::create(path)?;
    file.write_all(text.as_bytes()).map_err(wavex_formats::Error::io(path, "write"))?;
    file.finish()?.publish()?;
    Ok(())
}

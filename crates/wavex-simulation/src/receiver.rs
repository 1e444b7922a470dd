//! Recorded sample blocks of the digitisers.

use super::noise::Noise;
use super::pulse::{PulseShape, PulseTable, WidthIndex};
use super::random::Random;

/// Number of samples of the outgoing pulse's block.
const REFERENCE_SAMPLES: usize = 24;
/// Samples from the start of that block to the shot's clock, on the same raster.
const REFERENCE_LEAD: i64 = 10;
/// Peak amplitude of the outgoing pulse above the background, DN.
const REFERENCE_AMPLITUDE_DN: f64 = 177.0;

/// Increment of the length of an echo block, samples, while echoes continue.
const BLOCK_SAMPLES: i64 = 60;
/// Samples from the start of a block to the echo that opened it.
const ECHO_LEAD: i64 = 16;
/// Minimum number of samples after an echo's peak; otherwise the block grows.
const ECHO_HOLD: i64 = 24;
/// Weakest echo that opens or extends a block, DN; in real recordings, weaker echoes appear only
/// next to stronger ones.
pub const TRIGGER_DN: f64 = 5.5;
/// Delay of echo samples relative to the raster of the shot's clock, ns: two digitisers are never
/// synchronous.
const ECHO_RASTER_NS: f64 = 0.375;

/// Delay of the high-power receiver's samples relative to samples of the other receiver, ns; a
/// constant measured on a real instrument.
const HIGH_POWER_RASTER_NS: f64 = 1.43;

/// Variance of the digitiser's rounding errors (steps of 1 DN), DN².
const QUANTISATION_VARIANCE: f64 = 1.0 / 12.0;

/// Settings of a [`SimulatedReceiver`].
#[derive(Clone, Debug)]
pub struct ReceiverSettings {
    /// Sampling interval, ns.
    pub interval_ns: f64,
    /// Full scale of the digitiser, DN.
    pub full_scale_dn: u16,
    /// Background of even and odd samples of a block, DN.
    pub background_dn: [f64; 2],
    /// SD of the recorded noise, including rounding, DN; 0: rounding errors only.
    pub noise_sd_dn: f64,
    /// Autocorrelation of the recorded noise at lags 1, 2, ... samples.
    pub noise_autocorrelation: Vec<f64>,
    /// Delay of the odd samples of a block, samples.
    pub odd_sample_shift: f64,
    /// Response to a flat target.
    pub response: PulseShape,
    /// Shape of the outgoing pulse.
    pub reference: PulseShape,
    /// Second receiver, for strong echoes, if any.
    pub high_power: Option<HighPower>,
}

/// A receiver for strong echoes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HighPower {
    /// Minimum peak amplitude in the other receiver for its block to be recorded, DN.
    pub from_dn: f64,
    /// SD of its recorded noise, including rounding, DN; 0: rounding errors only.
    pub noise_sd_dn: f64,
    /// Delay of its echoes relative to the other receiver, ns.
    pub delay_ns: f64,
}

/// A receiver with one or two echo digitisers and one for the outgoing pulse.
#[derive(Debug)]
pub struct SimulatedReceiver {
    interval_ns: f64,
    full_scale_dn: u16,
    background_dn: [f64; 2],
    odd_sample_shift: f64,
    noise: Option<Noise>,
    high_power: Option<(HighPower, Option<Noise>)>,
    response: PulseTable,
    reference: PulseTable,
    scratch: Scratch,
    /// Gain of the echo receivers for the next recorded blocks.
    gain: f64,
}

/// Buffers for one block: signal, one of its pulses, noise and samples.
#[derive(Debug, Default)]
struct Scratch {
    signal: Vec<f64>,
    pulse: Vec<f64>,
    noise_dn: Vec<f64>,
    samples: Vec<u16>,
}

/// An echo as it arrives.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ReceivedEcho {
    /// Peak time after the shot's clock, ns; for a widened echo, of the flat target's response.
    pub time_ns: f64,
    /// Peak amplitude above the background at gain 1, DN, before digitiser limits.
    pub amplitude_dn: f64,
    /// Peak amplitude in the receiver for strong echoes, DN.
    pub high_power_dn: f64,
    /// Peak amplitude in a receiver without limits, DN.
    pub linear_dn: f64,
    /// Width.
    pub width: WidthIndex,
}

/// A range of the echo digitiser's samples.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SampleWindow {
    start: i64,
    len: i64,
}

impl ReceiverSettings {
    /// Noise before the digitiser, which adds rounding errors; `None` for no noise.
    ///
    /// # Errors
    /// If no process gives the requested noise after rounding.
    pub fn noise(&self) -> Result<Option<Noise>, NoSuchNoise> {
        self.noise_of(self.noise_sd_dn)
    }

    /// Noise of the high-power receiver, with the same autocorrelation.
    ///
    /// # Errors
    /// If no process gives the requested noise after rounding.
    pub fn high_power_noise(&self) -> Result<Option<Noise>, NoSuchNoise> {
        self.high_power.map_or(Ok(None), |receiver| self.noise_of(receiver.noise_sd_dn))
    }

    fn noise_of(&self, recorded_sd_dn: f64) -> Result<Option<Noise>, NoSuchNoise> {
        if recorded_sd_dn == 0.0 {
            return Ok(None);
        }
        let recorded = recorded_sd_dn * recorded_sd_dn;
        let analog = recorded - QUANTISATION_VARIANCE;
        if analog.is_nan() || analog <= 0.0 {
            return Err(NoSuchNoise);
        }
        let correlation: Vec<f64> =
            self.noise_autocorrelation.iter().map(|rho| rho * recorded / analog).collect();
        let noise = Noise::new(analog.sqrt(), &correlation).ok_or(NoSuchNoise)?;
        Ok(Some(noise.with_odd_samples_late(self.odd_sample_shift)))
    }
}

/// No process has the requested SD and autocorrelation after rounding.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("no noise process has this standard deviation and autocorrelation after rounding")]
pub struct NoSuchNoise;

impl SimulatedReceiver {
    /// Creates a receiver.
    ///
    /// # Errors
    /// If no process has the requested SD and autocorrelation.
    pub fn new(settings: &ReceiverSettings) -> Result<SimulatedReceiver, NoSuchNoise> {
        let high_power_noise = settings.high_power_noise()?;
        Ok(SimulatedReceiver {
            interval_ns: settings.interval_ns,
            full_scale_dn: settings.full_scale_dn,
            background_dn: settings.background_dn,
            odd_sample_shift: settings.odd_sample_shift,
            noise: settings.noise()?,
            high_power: settings.high_power.map(|receiver| (receiver, high_power_noise)),
            response: PulseTable::new(settings.response.clone(), settings.interval_ns),
            reference: PulseTable::new(settings.reference.clone(), settings.interval_ns),
            scratch: Scratch::default(),
            gain: 1.0,
        })
    }

    /// Sets the gain of the echo receivers.
    ///
    /// Applies to signal and noise, not to background and rounding.
    pub fn set_gain(&mut self, gain: f64) {
        self.gain = gain;
    }

    /// Gain of the echo receivers.
    pub fn gain(&self) -> f64 {
        self.gain
    }

    /// Response to echoes, with its widths and peak amplitudes.
    pub fn response(&self) -> &PulseTable {
        &self.response
    }

    /// Records the outgoing pulse.
    ///
    /// `emission_ns` is the peak time after the shot's clock, `energy` relative to the usual
    /// energy. Returns the time of the first sample after the clock, ns, and the samples.
    pub fn record_emission(&mut self, emission_ns: f64, energy: f64, random: &mut Random) -> (f64, &[u16]) {
        self.clear(REFERENCE_SAMPLES);
        let start_ns = -(REFERENCE_LEAD as f64) * self.interval_ns;
        let position = (emission_ns - start_ns) / self.interval_ns;
        let flat = self.reference.width(0.0);
        let energy = energy * REFERENCE_AMPLITUDE_DN;
        self.scratch.add(&self.reference, flat, position, energy, self.odd_sample_shift);
        (start_ns, digitise(self.noise.as_ref(), 1.0, self.full_scale_dn, &mut self.scratch, random))
    }

    /// Blocks that the instrument records for these echoes (sorted by time), in order.
    ///
    /// Each starts on an even sample of the digitiser, so even and odd samples keep their
    /// backgrounds.
    pub fn windows(&self, echoes: &[ReceivedEcho], windows: &mut Vec<SampleWindow>) {
        windows.clear();
        for echo in echoes.iter().filter(|echo| echo.amplitude_dn >= TRIGGER_DN) {
            let peak = self.position(echo.time_ns).floor() as i64;
            match windows.last_mut().filter(|open| peak < open.end() + ECHO_LEAD) {
                Some(open) => {
                    let missing = peak + ECHO_HOLD - open.end();
                    open.len += (missing + BLOCK_SAMPLES - 1).max(0) / BLOCK_SAMPLES * BLOCK_SAMPLES;
                }
                None => windows.push(SampleWindow { start: (peak - ECHO_LEAD) & !1, len: BLOCK_SAMPLES }),
            }
        }
    }

    /// Returns whether an echo's peak is inside a block.
    pub fn is_in(&self, window: &SampleWindow, echo: &ReceivedEcho) -> bool {
        let position = self.position(echo.time_ns);
        (window.start as f64..window.end() as f64).contains(&position)
    }

    /// Records a block; returns the time of its first sample after the shot's clock, ns, and the
    /// samples.
    pub fn record(
        &mut self,
        window: &SampleWindow,
        echoes: &[ReceivedEcho],
        random: &mut Random,
    ) -> (f64, &[u16]) {
        self.clear(window.len as usize);
        for echo in echoes {
            let position = self.position(echo.time_ns) - window.start as f64;
            let energy = self.gain * echo.amplitude_dn / self.response.peak(echo.width);
            self.scratch.add(&self.response, echo.width, position, energy, self.odd_sample_shift);
        }
        let start_ns = self.start_ns(window);
        (start_ns, digitise(self.noise.as_ref(), self.gain, self.full_scale_dn, &mut self.scratch, random))
    }

    /// Returns whether the high-power receiver records its block of this window.
    pub fn is_strong(&self, window: &SampleWindow, echoes: &[ReceivedEcho]) -> bool {
        let Some((receiver, _)) = &self.high_power else { return false };
        echoes.iter().any(|echo| echo.amplitude_dn >= receiver.from_dn && self.is_in(window, echo))
    }

    /// Records the window with the high-power receiver, if there is one.
    pub fn record_high_power(
        &mut self,
        window: &SampleWindow,
        echoes: &[ReceivedEcho],
        random: &mut Random,
    ) -> Option<(f64, &[u16])> {
        let delay_ns = self.high_power.as_ref()?.0.delay_ns;
        self.clear(window.len as usize);
        let start_ns = self.start_ns(window) + HIGH_POWER_RASTER_NS;
        for echo in echoes {
            let position = (echo.time_ns + delay_ns - start_ns) / self.interval_ns;
            let energy = self.gain * echo.high_power_dn / self.response.peak(echo.width);
            self.scratch.add(&self.response, echo.width, position, energy, self.odd_sample_shift);
        }
        let (_, noise) = self.high_power.as_ref()?;
        let samples = digitise(noise.as_ref(), self.gain, self.full_scale_dn, &mut self.scratch, random);
        Some((start_ns, samples))
    }

    /// Time of a window's first sample after the shot's clock, ns.
    pub fn start_ns(&self, window: &SampleWindow) -> f64 {
        window.start as f64 * self.interval_ns + ECHO_RASTER_NS
    }

    /// Position of a time after the shot's clock on the echo digitiser's raster, samples.
    fn position(&self, time_ns: f64) -> f64 {
        (time_ns - ECHO_RASTER_NS) / self.interval_ns
    }

    /// Starts a block that contains only background.
    fn clear(&mut self, len: usize) {
        let signal = &mut self.scratch.signal;
        signal.clear();
        signal.resize(len, self.background_dn[0]);
        signal.iter_mut().skip(1).step_by(2).for_each(|odd| *odd = self.background_dn[1]);
    }
}

impl Scratch {
    /// Adds a pulse to the signal; late odd samples see it earlier.
    fn add(
        &mut self,
        table: &PulseTable,
        width: WidthIndex,
        position: f64,
        energy: f64,
        odd_sample_shift: f64,
    ) {
        if odd_sample_shift == 0.0 {
            table.add(width, position, energy, &mut self.signal);
            return;
        }
        for (parity, position) in [(0, position), (1, position - odd_sample_shift)] {
            self.pulse.clear();
            self.pulse.resize(self.signal.len(), 0.0);
            table.add(width, position, energy, &mut self.pulse);
            let samples = self.signal.iter_mut().zip(&self.pulse).skip(parity).step_by(2);
            samples.for_each(|(sample, value)| *sample += value);
        }
    }
}

/// Adds amplified noise to the signal and rounds to integer DN.
fn digitise<'s>(
    noise: Option<&Noise>,
    gain: f64,
    full_scale_dn: u16,
    scratch: &'s mut Scratch,
    random: &mut Random,
) -> &'s [u16] {
    let Scratch { signal, noise_dn, samples, .. } = scratch;
    noise_dn.clear();
    noise_dn.resize(signal.len(), 0.0);
    if let Some(noise) = noise {
        noise.fill(random, noise_dn);
    }
    let full_scale = i32::from(full_scale_dn);
    samples.clear();
    samples.extend(signal.iter().zip(noise_dn).map(|(signal, noise)| {
        // Below zero the conversion rounds towards zero; the clamp corrects this.
        ((*signal + gain * *noise + 0.5) as i32).clamp(0, full_scale) as u16
    }));
    samples
}

impl SampleWindow {
    /// Start and end on the digitiser's raster, ns.
    pub fn limits_ns(&self, interval_ns: f64) -> [f64; 2] {
        [self.start, self.end()].map(|sample| sample as f64 * interval_ns + ECHO_RASTER_NS)
    }

    /// The same window relative to a clock that is ahead by this many samples.
    pub fn by_clock_ahead(&self, samples: i64) -> SampleWindow {
        SampleWindow { start: self.start - samples, len: self.len }
    }

    /// Index after the last sample.
    fn end(&self) -> i64 {
        self.start + self.len
    }
}

#[cfg(test)]
mod tests;

//! What is recorded of the light that arrives: sample blocks of the digitisers.

use super::noise::Noise;
use super::pulse::{PulseTable, Shape, Width};
use super::random::Random;

/// Samples of the outgoing pulse's block.
pub const REFERENCE_SAMPLES: usize = 24;
/// Where its block begins: on the sample raster of the shot's clock, this many samples before it.
const REFERENCE_LEAD: i64 = 10;
/// Height of the outgoing pulse's peak above the background, DN.
const REFERENCE_AMPLITUDE_DN: f64 = 177.0;

/// An echo block grows by this many samples as long as echoes come.
const BLOCK_SAMPLES: i64 = 60;
/// Samples between the start of a block and the echo that opened it.
const ECHO_LEAD: i64 = 16;
/// Samples that an echo needs behind its peak: where the block ends earlier, it grows.
const ECHO_HOLD: i64 = 24;
/// The weakest echo that opens a block or lets it grow, DN: as in recordings, where weaker ones only stand beside others.
pub const TRIGGER_DN: f64 = 5.5;
/// Echo samples lie this far behind the raster of the shot's clock, ns: two digitisers are never in step.
const ECHO_RASTER_NS: f64 = 0.375;

/// Samples of the receiver for strong echoes lie this far behind those of the other, ns: a constant of the instrument that
/// was measured.
const HIGH_POWER_RASTER_NS: f64 = 1.43;

/// Steps of the digitiser are 1 DN: their rounding errors have this variance, DN^2.
const QUANTISATION_VARIANCE: f64 = 1.0 / 12.0;

/// What a [`Receiver`] is set to.
#[derive(Clone, Debug)]
pub struct Settings {
    /// Time between samples, ns.
    pub interval_ns: f64,
    /// The largest value that the digitiser gives.
    pub full_scale_dn: u16,
    /// Background of the even and of the odd samples of a block, DN.
    pub background_dn: [f64; 2],
    /// Standard deviation of the recorded noise, rounding included, DN; 0: only the rounding is left.
    pub noise_sd_dn: f64,
    /// Autocorrelation of the recorded noise at lags 1, 2, ... samples.
    pub noise_autocorrelation: Vec<f64>,
    /// What an echo from a flat target looks like.
    pub response: Shape,
    /// What the outgoing pulse looks like.
    pub reference: Shape,
    /// The second receiver, for strong echoes, where there is one.
    pub high_power: Option<HighPower>,
}

/// A receiver for strong echoes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HighPower {
    /// Its block is kept where an echo's peak has this height or more in the other receiver, DN.
    pub from_dn: f64,
    /// Standard deviation of its recorded noise, rounding included, DN; 0: only the rounding is left.
    pub noise_sd_dn: f64,
    /// How much later it sees an echo than the other does, ns.
    pub delay_ns: f64,
}

/// A receiver with one or two digitisers for echoes and one for the outgoing pulse.
#[derive(Debug)]
pub struct Receiver {
    interval_ns: f64,
    full_scale_dn: u16,
    background_dn: [f64; 2],
    noise: Option<Noise>,
    high_power: Option<(HighPower, Option<Noise>)>,
    response: PulseTable,
    reference: PulseTable,
    scratch: Scratch,
    /// Of the echo receivers, for what is recorded next.
    gain: f64,
}

/// Room for one block: what arrives, its noise, and its samples.
#[derive(Debug, Default)]
struct Scratch {
    signal: Vec<f64>,
    noise_dn: Vec<f64>,
    samples: Vec<u16>,
}

/// An echo as it arrives.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Echo {
    /// Time of its peak (of the response's, were the target flat) after the shot's clock, ns.
    pub time_ns: f64,
    /// Height of its peak above the background at gain 1, DN, before the digitiser's limits.
    pub amplitude_dn: f64,
    /// The same in the receiver for strong echoes.
    pub high_power_dn: f64,
    /// The height that it would have in a receiver without limits.
    pub linear_dn: f64,
    /// How wide it is.
    pub width: Width,
}

/// A run of the echo digitiser's samples.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Window {
    start: i64,
    len: i64,
}

impl Settings {
    /// The noise before the digitiser, which adds its own rounding errors; `None` where there is none.
    ///
    /// # Errors
    /// Where no noise becomes the wanted one by rounding.
    pub fn noise(&self) -> Result<Option<Noise>, NoSuchNoise> {
        self.noise_of(self.noise_sd_dn)
    }

    /// The same for the receiver for strong echoes, whose noise has the same autocorrelation.
    ///
    /// # Errors
    /// Where no noise becomes the wanted one by rounding.
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
        Noise::new(analog.sqrt(), &correlation).map(Some).ok_or(NoSuchNoise)
    }
}

/// No noise has the wanted spread and autocorrelation after rounding.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NoSuchNoise;

impl Receiver {
    /// A receiver with these settings.
    ///
    /// # Errors
    /// Where no noise has the wanted spread and autocorrelation.
    pub fn new(settings: &Settings) -> Result<Receiver, NoSuchNoise> {
        let high_power_noise = settings.high_power_noise()?;
        Ok(Receiver {
            interval_ns: settings.interval_ns,
            full_scale_dn: settings.full_scale_dn,
            background_dn: settings.background_dn,
            noise: settings.noise()?,
            high_power: settings.high_power.map(|receiver| (receiver, high_power_noise)),
            response: PulseTable::new(settings.response.clone(), settings.interval_ns),
            reference: PulseTable::new(settings.reference.clone(), settings.interval_ns),
            scratch: Scratch::default(),
            gain: 1.0,
        })
    }

    /// Sets the gain of the echo receivers: of signal and noise, not of background and rounding.
    pub fn set_gain(&mut self, gain: f64) {
        self.gain = gain;
    }

    /// Their gain.
    pub fn gain(&self) -> f64 {
        self.gain
    }

    /// The response to echoes, which knows widths and the height of peaks.
    pub fn response(&self) -> &PulseTable {
        &self.response
    }

    /// Records the outgoing pulse, whose peak lies `emission_ns` after the shot's clock and whose energy is `energy`
    /// times the usual one: the time of the first sample after the clock, ns, and the samples.
    pub fn record_emission(&mut self, emission_ns: f64, energy: f64, random: &mut Random) -> (f64, &[u16]) {
        self.clear(REFERENCE_SAMPLES);
        let start_ns = -(REFERENCE_LEAD as f64) * self.interval_ns;
        let position = (emission_ns - start_ns) / self.interval_ns;
        let flat = self.reference.width(0.0);
        self.reference.add(flat, position, energy * REFERENCE_AMPLITUDE_DN, &mut self.scratch.signal);
        (start_ns, digitise(self.noise.as_ref(), 1.0, self.full_scale_dn, &mut self.scratch, random))
    }

    /// The blocks that these echoes (in order of time) let the instrument record, in order. Each begins on an even
    /// sample of the digitiser, so that even and odd samples keep their backgrounds.
    pub fn windows(&self, echoes: &[Echo], windows: &mut Vec<Window>) {
        windows.clear();
        for echo in echoes.iter().filter(|echo| echo.amplitude_dn >= TRIGGER_DN) {
            let peak = self.position(echo.time_ns).floor() as i64;
            match windows.last_mut().filter(|open| peak < open.end() + ECHO_LEAD) {
                Some(open) => {
                    let missing = peak + ECHO_HOLD - open.end();
                    open.len += (missing + BLOCK_SAMPLES - 1).max(0) / BLOCK_SAMPLES * BLOCK_SAMPLES;
                }
                None => windows.push(Window { start: (peak - ECHO_LEAD) & !1, len: BLOCK_SAMPLES }),
            }
        }
    }

    /// Whether an echo's peak lies in a block.
    pub fn is_in(&self, window: &Window, echo: &Echo) -> bool {
        let position = self.position(echo.time_ns);
        (window.start as f64..window.end() as f64).contains(&position)
    }

    /// Records one of these blocks: the time of its first sample after the shot's clock, ns, and the samples.
    pub fn record(&mut self, window: &Window, echoes: &[Echo], random: &mut Random) -> (f64, &[u16]) {
        self.clear(window.len as usize);
        for echo in echoes {
            let position = self.position(echo.time_ns) - window.start as f64;
            let energy = self.gain * echo.amplitude_dn / self.response.peak(echo.width);
            self.response.add(echo.width, position, energy, &mut self.scratch.signal);
        }
        let start_ns = self.start_ns(window);
        (start_ns, digitise(self.noise.as_ref(), self.gain, self.full_scale_dn, &mut self.scratch, random))
    }

    /// Whether the receiver for strong echoes keeps its block of this window.
    pub fn is_strong(&self, window: &Window, echoes: &[Echo]) -> bool {
        let Some((receiver, _)) = &self.high_power else { return false };
        echoes.iter().any(|echo| echo.amplitude_dn >= receiver.from_dn && self.is_in(window, echo))
    }

    /// Records the same window with the receiver for strong echoes; nothing where there is none.
    pub fn record_high_power(
        &mut self,
        window: &Window,
        echoes: &[Echo],
        random: &mut Random,
    ) -> Option<(f64, &[u16])> {
        let delay_ns = self.high_power.as_ref()?.0.delay_ns;
        self.clear(window.len as usize);
        let start_ns = self.start_ns(window) + HIGH_POWER_RASTER_NS;
        for echo in echoes {
            let position = (echo.time_ns + delay_ns - start_ns) / self.interval_ns;
            let energy = self.gain * echo.high_power_dn / self.response.peak(echo.width);
            self.response.add(echo.width, position, energy, &mut self.scratch.signal);
        }
        let (_, noise) = self.high_power.as_ref()?;
        let samples = digitise(noise.as_ref(), self.gain, self.full_scale_dn, &mut self.scratch, random);
        Some((start_ns, samples))
    }

    /// The time of a window's first sample after the shot's clock, ns.
    pub fn start_ns(&self, window: &Window) -> f64 {
        window.start as f64 * self.interval_ns + ECHO_RASTER_NS
    }

    /// A time after the shot's clock as a place on the echo digitiser's raster, samples.
    fn position(&self, time_ns: f64) -> f64 {
        (time_ns - ECHO_RASTER_NS) / self.interval_ns
    }

    /// Begins a block: there is nothing in it but the background.
    fn clear(&mut self, len: usize) {
        let signal = &mut self.scratch.signal;
        signal.clear();
        signal.resize(len, self.background_dn[0]);
        signal.iter_mut().skip(1).step_by(2).for_each(|odd| *odd = self.background_dn[1]);
    }
}

/// Adds noise, amplified, to background and signal and rounds them to the digitiser's steps.
fn digitise<'s>(
    noise: Option<&Noise>,
    gain: f64,
    full_scale_dn: u16,
    scratch: &'s mut Scratch,
    random: &mut Random,
) -> &'s [u16] {
    let Scratch { signal, noise_dn, samples } = scratch;
    noise_dn.clear();
    noise_dn.resize(signal.len(), 0.0);
    if let Some(noise) = noise {
        noise.fill(random, noise_dn);
    }
    let full_scale = i32::from(full_scale_dn);
    samples.clear();
    samples.extend(signal.iter().zip(noise_dn).map(|(signal, noise)| {
        // Below zero the conversion rounds towards zero, which the limit makes good.
        ((*signal + gain * *noise + 0.5) as i32).clamp(0, full_scale) as u16
    }));
    samples
}

impl Window {
    /// Where it begins and ends on the digitiser's raster, ns.
    pub fn limits_ns(&self, interval_ns: f64) -> [f64; 2] {
        [self.start, self.end()].map(|sample| sample as f64 * interval_ns + ECHO_RASTER_NS)
    }

    /// The same window by a clock that is so many samples ahead.
    pub fn by_clock_ahead(&self, samples: i64) -> Window {
        Window { start: self.start - samples, len: self.len }
    }

    /// The sample after the last.
    fn end(&self) -> i64 {
        self.start + self.len
    }
}

#[cfg(test)]
mod tests {
    use super::super::random::Purpose;
    use super::*;

    fn settings() -> Settings {
        Settings {
            interval_ns: 1.0,
            full_scale_dn: 255,
            background_dn: [2.0, 4.0],
            noise_sd_dn: 0.0,
            noise_autocorrelation: Vec::new(),
            response: Shape::gaussian(4.5),
            reference: Shape::gaussian(4.5),
            high_power: None,
        }
    }

    fn receiver() -> Receiver {
        Receiver::new(&settings()).unwrap()
    }

    fn random() -> Random {
        Random::of_shot(1, 0, 0, Purpose::Noise)
    }

    /// Echoes of flat targets at these times, of these amplitudes.
    fn echoes(receiver: &Receiver, echoes: &[(f64, f64)]) -> Vec<Echo> {
        let width = receiver.response().width(0.0);
        echoes.iter().map(|&(time_ns, amplitude_dn)| echo(time_ns, amplitude_dn, width)).collect()
    }

    fn echo(time_ns: f64, amplitude_dn: f64, width: Width) -> Echo {
        Echo { time_ns, amplitude_dn, high_power_dn: 0.1 * amplitude_dn, linear_dn: amplitude_dn, width }
    }

    /// Start and length of the blocks that echoes of 100 DN at these times open.
    fn windows(times_ns: &[f64]) -> Vec<(i64, i64)> {
        let (receiver, mut windows) = (receiver(), Vec::new());
        let strong: Vec<(f64, f64)> = times_ns.iter().map(|&time_ns| (time_ns, 100.0)).collect();
        receiver.windows(&echoes(&receiver, &strong), &mut windows);
        windows.iter().map(|window| (window.start, window.len)).collect()
    }

    #[test]
    fn a_block_grows_while_echoes_come() {
        assert_eq!(windows(&[]), []);
        assert_eq!(windows(&[100.0]), [(82, 60)]);
        assert_eq!(windows(&[101.0]), [(84, 60)], "blocks begin on even samples");
        assert_eq!(windows(&[100.0, 118.0]), [(82, 60)]);
        assert_eq!(windows(&[100.0, 120.0]), [(82, 120)], "24 samples are needed behind the second");
        assert_eq!(windows(&[100.0, 157.0]), [(82, 120)], "blocks do not overlap");
        assert_eq!(windows(&[100.0, 159.0]), [(82, 60), (142, 60)]);
        assert_eq!(windows(&[100.0, 150.0, 200.0]), [(82, 180)]);
    }

    #[test]
    fn a_weak_echo_opens_no_block_but_stands_in_one() {
        let (receiver, mut windows) = (receiver(), Vec::new());
        let weak = echoes(&receiver, &[(60.0, 5.0), (100.0, 6.0), (120.0, 5.0), (300.0, 5.0)]);
        receiver.windows(&weak, &mut windows);
        assert_eq!(windows, [Window { start: 82, len: 60 }]);
        let inside: Vec<bool> = weak.iter().map(|echo| receiver.is_in(&windows[0], echo)).collect();
        assert_eq!(inside, [false, true, true, false]);
    }

    #[test]
    fn a_block_without_noise_spelled_out() {
        let (mut receiver, mut windows) = (receiver(), Vec::new());
        let one = echoes(&receiver, &[(100.375, 100.0)]);
        receiver.windows(&one, &mut windows);
        let (start_ns, samples) = receiver.record(&windows[0], &one, &mut random());
        assert_eq!((start_ns, samples.len()), (84.375, 60));
        // 100 DN at sample 16, where 2 of background are, and 100 * 2^-(2 k / 4.5)^2 at k samples from it.
        assert_eq!(samples[8..25], [2, 4, 3, 7, 13, 33, 60, 91, 102, 91, 60, 33, 13, 7, 3, 4, 2]);
        assert!(samples[..8].chunks(2).chain(samples[26..].chunks(2)).all(|pair| pair == [2, 4]));
    }

    #[test]
    fn an_echo_beyond_the_digitisers_end_is_clipped() {
        let (mut receiver, mut windows) = (receiver(), Vec::new());
        let strong = echoes(&receiver, &[(100.375, 1000.0)]);
        receiver.windows(&strong, &mut windows);
        let (_, samples) = receiver.record(&windows[0], &strong, &mut random());
        assert_eq!(samples[12..21], [114, 255, 255, 255, 255, 255, 255, 255, 114]);
    }

    #[test]
    fn the_outgoing_pulse_begins_on_the_raster_and_lies_between_samples() {
        let mut receiver = receiver();
        let (start_ns, samples) = receiver.record_emission(0.5, 1.0, &mut random());
        assert_eq!((start_ns, samples.len()), (-10.0, 24));
        // 177 DN * 2^-(2 k / 4.5)^2 at k = 0.5, 1.5 and 2.5 samples from the peak, above 2 and 4 DN.
        assert_eq!(samples[8..14], [77, 134, 173, 175, 132, 79]);
    }

    #[test]
    fn the_second_receiver_sees_strong_echoes_later_and_on_its_own_raster() {
        let high_power = HighPower { from_dn: 150.0, noise_sd_dn: 0.0, delay_ns: 0.43 };
        let mut receiver = Receiver::new(&Settings { high_power: Some(high_power), ..settings() }).unwrap();
        let mut windows = Vec::new();
        let strong = echoes(&receiver, &[(101.375, 1000.0)]);
        receiver.windows(&strong, &mut windows);
        assert!(receiver.is_strong(&windows[0], &strong));
        let (start_ns, samples) = receiver.record_high_power(&windows[0], &strong, &mut random()).unwrap();
        assert_eq!((start_ns, samples.len()), (84.375 + 1.43, 60));
        // 100 DN at 101.805 ns, which is sample 16.
        assert_eq!(samples[12..21], [13, 33, 60, 91, 102, 91, 60, 33, 13]);
        let weak = echoes(&receiver, &[(101.375, 149.0), (400.0, 500.0)]);
        assert!(!receiver.is_strong(&windows[0], &weak));
        assert!(self::receiver().record_high_power(&windows[0], &strong, &mut random()).is_none());
    }

    #[test]
    fn rounding_is_part_of_the_recorded_noise() {
        let settings =
            |noise_sd_dn, rho| Settings { noise_sd_dn, noise_autocorrelation: vec![rho], ..settings() };
        assert!(settings(0.0, 0.5).noise().unwrap().is_none());
        assert!(settings(0.93, 0.5).noise().unwrap().is_some());
        assert_eq!(settings(0.28, 0.0).noise().unwrap_err(), NoSuchNoise);
        // 0.9 of 0.25 would be 1.35 of what is left without the rounding's twelfth.
        assert_eq!(settings(0.5, 0.9).noise().unwrap_err(), NoSuchNoise);
    }
}

//! Simulated instruments whose pulses differ a little from shot to shot.

use wavex_formats::container::EmissionReference;
use wavex_testkit::waveforms::Random;

/// Lines of a recording.
const LINES: usize = 4;
/// Samples of an outgoing pulse, and its height over full scale.
const OUTGOING_SAMPLES: usize = 90;
const OUTGOING_PART: f64 = 0.6;
/// Level above which a receiver may be compressed.
const LINEAR_DN: f64 = 200.0;

/// Type of instrument.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Kind {
    /// 8 bits, pulse of 4.4 ns with an after-pulse and a tail, correlated noise, fixed background.
    Riegl,
    /// 8 bits, pulse of 6 ns with an undershoot, a background that differs between waveforms.
    Leica,
    /// 12 bits, pulse of 14 ns, waveforms of 200 samples of canopy over ground.
    LargeFootprint,
}

impl Kind {
    pub const ALL: [Kind; 3] = [Kind::Riegl, Kind::Leica, Kind::LargeFootprint];

    /// An instrument of another type.
    pub fn other(self) -> Kind {
        match self {
            Kind::Riegl => Kind::Leica,
            Kind::Leica => Kind::LargeFootprint,
            Kind::LargeFootprint => Kind::Riegl,
        }
    }
}

/// A shot of a recording.
#[derive(Clone)]
pub struct Shot {
    pub samples: Vec<u16>,
    /// Height, position in samples, and width ratio of each echo.
    pub echoes: Vec<[f64; 3]>,
    /// Outgoing pulse and its position, samples.
    pub outgoing: Vec<u16>,
    pub emission: f64,
}

impl Shot {
    /// Position of the only echo, or of the ground, samples.
    pub fn main_position(&self) -> f64 {
        self.echoes[0][1]
    }
}

/// What a recording with outgoing pulses states of its times.
#[derive(Clone, Copy)]
pub struct Timing {
    pub emission_reference: EmissionReference,
    /// Samples by which every tenth waveform is late.
    pub late_samples: f64,
}

/// Shots of a recording.
#[derive(Clone)]
pub struct Recording {
    pub lines: Vec<Vec<Shot>>,
    /// `None`: without outgoing pulses, and with unrelated ranges.
    pub timing: Option<Timing>,
    pub full_scale_dn: u16,
    pub background_dn: f64,
}

impl Recording {
    /// Changes the samples of each shot; gets its number in the recording.
    pub fn changed(&self, mut change: impl FnMut(usize, &mut Vec<u16>)) -> Recording {
        let mut recording = self.clone();
        let shots = recording.lines.iter_mut().flatten();
        shots.enumerate().for_each(|(number, shot)| change(number, &mut shot.samples));
        recording
    }

    /// Number of shots.
    pub fn shots(&self) -> usize {
        self.lines.iter().map(Vec::len).sum()
    }
}

/// Properties of an instrument.
pub struct Instrument {
    kind: Kind,
    random: Random,
    shots_per_line: usize,
    samples: usize,
    full_scale_dn: u16,
    background_dn: f64,
    background_sd_dn: f64,
    noise_sd_dn: f64,
    ar: [f64; 2],
    /// SD of width and tail from shot to shot, relative.
    width_jitter: f64,
    tail_jitter: f64,
    /// Positions of outgoing pulses, samples.
    emission: [f64; 2],
    /// Part of large footprints without canopy.
    open_part: f64,
    /// Height of the highest echoes of small footprints, DN.
    highest_dn: f64,
    /// Slope of the receiver above 200 DN.
    compression: f64,
}

impl Instrument {
    pub fn new(kind: Kind, seed: u64) -> Instrument {
        let random = Random::new(0x5eed + 977 * seed + 131 * kind as u64);
        let common = Instrument {
            kind,
            random,
            shots_per_line: 500,
            samples: 60,
            full_scale_dn: 255,
            background_dn: 12.3,
            background_sd_dn: 0.1,
            noise_sd_dn: 0.9,
            ar: [0.62, 0.05],
            width_jitter: 0.01,
            tail_jitter: 0.35,
            emission: [24.0, 25.0],
            open_part: 0.6,
            highest_dn: 235.0,
            compression: 1.0,
        };
        match kind {
            Kind::Riegl => common,
            Kind::Leica => Instrument {
                highest_dn: 225.0,
                samples: 110,
                background_dn: 14.6,
                background_sd_dn: 2.5,
                noise_sd_dn: 1.3,
                ar: [0.3, 0.0],
                ..common
            },
            Kind::LargeFootprint => Instrument {
                shots_per_line: 200,
                samples: 200,
                full_scale_dn: 4095,
                background_dn: 220.0,
                background_sd_dn: 12.0,
                noise_sd_dn: 6.0,
                ar: [0.9, -0.3],
                tail_jitter: 0.05,
                emission: [20.0, 26.0],
                ..common
            },
        }
    }

    /// Large footprints over closed canopy, by pulses that differ by 2 % of the peak from shot to shot.
    pub fn forest(seed: u64) -> Instrument {
        let large = Instrument::new(Kind::LargeFootprint, seed);
        Instrument { open_part: 0.0, tail_jitter: 0.35, shots_per_line: 100, ..large }
    }

    /// The instrument with a stable response, other highest echoes, and this slope of the receiver above 200 DN.
    pub fn stable(self, highest_dn: f64, compression: f64) -> Instrument {
        Instrument { tail_jitter: 0.0, highest_dn, compression, ..self }
    }

    /// Lines of waveforms.
    pub fn record(mut self) -> Recording {
        let line =
            |instrument: &mut Instrument| (0..instrument.shots_per_line).map(|_| instrument.shot()).collect();
        Recording {
            lines: (0..LINES).map(|_| line(&mut self)).collect(),
            timing: None,
            full_scale_dn: self.full_scale_dn,
            background_dn: self.background_dn,
        }
    }

    /// Response with its peak near time 0; `tail` scales what follows the main lobe.
    fn response(&self, time_ns: f64, tail: f64) -> f64 {
        let bell = |t: f64, fwhm: f64| (-2.772_588_7 * (t / fwhm).powi(2)).exp();
        // A rise and a slower fall, continuous in slope.
        let lobe = |t: f64, rise: f64, fall: f64| bell(t, if t < 0.0 { 2.0 * rise } else { 2.0 * fall });
        let after = |t: f64, decay: f64| if t > 0.0 { t / decay * (1.0 - t / decay).exp() } else { 0.0 };
        match self.kind {
            Kind::Riegl => {
                lobe(time_ns, 1.9, 2.5)
                    + tail * (0.05 * bell(time_ns - 11.0, 4.0) + 0.025 * after(time_ns - 4.0, 12.0))
            }
            Kind::Leica => {
                lobe(time_ns, 2.7, 3.3)
                    + tail * (0.035 * after(time_ns - 8.0, 14.0) - 0.06 * bell(time_ns - 10.0, 6.0))
            }
            Kind::LargeFootprint => {
                lobe(time_ns, 6.0, 8.0)
                    + tail * (0.05 * bell(time_ns - 26.0, 12.0) + 0.03 * after(time_ns - 16.0, 20.0))
            }
        }
    }

    fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.random.uniform()
    }

    /// Log-uniform height, DN.
    fn height(&mut self, low: f64, high: f64) -> f64 {
        (self.between(low.ln(), high.ln())).exp()
    }

    /// Height, position and width ratio of the echoes of a shot.
    fn echoes(&mut self) -> Vec<[f64; 3]> {
        let mut echoes = Vec::new();
        match self.kind {
            Kind::Riegl | Kind::Leica => {
                let count =
                    1 + usize::from(self.random.uniform() < 0.3) + usize::from(self.random.uniform() < 0.1);
                let first = if self.kind == Kind::Riegl { 17.0 } else { 34.0 };
                let mut position = self.between(first, first + 7.0);
                for _ in 0..count {
                    let wide = self.random.uniform() < 0.25;
                    let width = if wide { self.between(1.0, 1.4) } else { 1.0 };
                    let height = self.height(12.0, self.highest_dn / count as f64);
                    echoes.push([height, position, width]);
                    position += self.between(5.0, 20.0);
                }
            }
            Kind::LargeFootprint => {
                let ground = self.between(105.0, 120.0);
                let height = self.height(150.0, 3600.0);
                let is_open = self.random.uniform() < self.open_part;
                echoes.push([height, ground, 1.0]);
                if !is_open {
                    let (top, canopy) = (self.between(20.0, 50.0), self.height(100.0, 900.0));
                    for _ in 0..5 {
                        let place = ground - 25.0 - top * self.random.uniform();
                        let height = canopy * 0.6 * self.random.uniform();
                        echoes.push([height, place, 1.3]);
                    }
                }
            }
        }
        echoes
    }

    fn shot(&mut self) -> Shot {
        let echoes = self.echoes();
        let width = 1.0 + self.width_jitter * self.random.normal();
        // Uniform, so that no single shot dominates.
        let tail = 1.0 + self.tail_jitter * 3f64.sqrt() * self.between(-1.0, 1.0);
        let samples = self.waveform(&echoes, width, tail, self.samples);
        let emission = self.between(self.emission[0], self.emission[1]);
        let height = OUTGOING_PART * f64::from(self.full_scale_dn);
        let outgoing = self.waveform(&[[height, emission, 1.0]], width, tail, OUTGOING_SAMPLES);
        Shot { samples, echoes, outgoing, emission }
    }

    fn waveform(&mut self, echoes: &[[f64; 3]], width: f64, tail: f64, samples: usize) -> Vec<u16> {
        let [a, b] = self.ar;
        // Variance of the process for an innovation of 1.
        let gain = ((1.0 - b) / ((1.0 + b) * ((1.0 - b).powi(2) - a * a))).sqrt();
        let innovation = self.noise_sd_dn / gain;
        let level = self.background_dn + self.background_sd_dn * self.random.normal();
        let (mut last, mut before) = (0.0, 0.0);
        let mut noise = Vec::with_capacity(samples);
        for k in 0..samples + 30 {
            let value = a * last + b * before + innovation * self.random.normal();
            (last, before) = (value, last);
            if k >= 30 {
                noise.push(value);
            }
        }
        let sample = |(k, noise): (usize, &f64)| {
            let echo = |[height, position, ratio]: &[f64; 3]| {
                height * self.response((k as f64 - position) / (width * ratio), tail)
            };
            let value = level + noise + echoes.iter().map(echo).sum::<f64>();
            let linear = value.min(LINEAR_DN);
            (linear + self.compression * (value - linear)).round().clamp(0.0, f64::from(self.full_scale_dn))
                as u16
        };
        noise.iter().enumerate().map(sample).collect()
    }
}

//! A simulated instrument with known truth, and its noise bounds.
//!
//! Response: a normal distribution with an SD of 1.65 ns convolved with a decay of 0.9 ns, plus
//! ringing from 4 ns on. The ringing is a damped sine with a period of 11 ns and a decay of 7 ns,
//! convolved with the same normal distribution; its extreme is 5 % of the peak. Noise: 2 DN, of
//! which 85 % is Gaussian band-limited and 15 % white, on a background of 20.3 DN.

use std::f64::consts::TAU;
use std::sync::{Arc, OnceLock};

use nalgebra::{DMatrix, DVector, Matrix3};
use wavex_simulation::noise::Noise;
use wavex_simulation::random::{Normal, Purpose, Random};

/// Samples per waveform, 1 ns apart.
pub const SAMPLES: usize = 60;
/// SD of a sample's noise before rounding.
pub const NOISE_SD_DN: f64 = 2.0;
/// Level without an echo.
pub const BACKGROUND_DN: f64 = 20.3;
/// Full scale of 8 bits.
pub const EIGHT_BITS: f64 = 255.0;
/// Full scale at which strong echoes are not clipped.
pub const TWELVE_BITS: f64 = 4095.0;

const NORMAL_SD_NS: f64 = 1.65;
const DECAY_NS: f64 = 0.9;
const RINGING_FROM_NS: f64 = 4.0;
const RINGING_PERIOD_NS: f64 = 11.0;
const RINGING_DECAY_NS: f64 = 7.0;
/// Extreme of the ringing relative to the peak.
const RINGING_PART: f64 = 0.05;
/// Correlation of receiver noise at lag 1 and its share; the correlation at lag `k` is
/// `share · ρ^(k²)`.
const BAND_CORRELATION: f64 = 0.61 / BAND_PART;
const BAND_PART: f64 = 0.85;
/// Number of lags, more than those with measurable correlation.
const LAGS: usize = 8;
/// Table of the response: steps per nanosecond, and times from the centre of the normal
/// distribution.
const STEPS_PER_NS: f64 = 8.0;
const FIRST_NS: f64 = -14.0;
const LAST_NS: f64 = 66.0;
/// Step of width ratios from 1 to 2.6; the truth is rounded to it.
const WIDTH_STEP: f64 = 0.002;
const WIDTHS: usize = 801;

/// Table of one width: main lobe and ringing separately.
#[derive(Debug)]
struct Row {
    lobe: Vec<f64>,
    ringing: Vec<f64>,
    /// Peak of the sum.
    peak: f64,
}

/// The response and all its widened forms.
#[derive(Debug)]
pub struct Response {
    /// Position and value of the response's peak, from the centre of the normal distribution.
    peak_ns: f64,
    /// Full width at half maximum.
    pub fwhm_ns: f64,
    ringing_scale: f64,
    rows: Vec<OnceLock<Row>>,
}

impl Response {
    /// Tabulates the response.
    pub fn new() -> Response {
        let mut response = Response {
            peak_ns: 0.0,
            fwhm_ns: 0.0,
            ringing_scale: 0.0,
            rows: (0..WIDTHS).map(|_| OnceLock::new()).collect(),
        };
        let flat = response.row_of(NORMAL_SD_NS);
        let (top, _) = greatest(&flat.lobe);
        let deepest = flat.ringing.iter().fold(0.0, |low: f64, v| low.min(*v));
        response.ringing_scale = RINGING_PART * top / -deepest;
        let row = response.row_of(NORMAL_SD_NS);
        let sum: Vec<f64> = row.lobe.iter().zip(&row.ringing).map(|(a, b)| a + b).collect();
        response.peak_ns = FIRST_NS + greatest(&sum).1 / STEPS_PER_NS;
        let half = |low: f64, high: f64| {
            let (mut low, mut high) = (low, high);
            for _ in 0..60 {
                let middle = 0.5 * (low + high);
                if row.at(response.peak_ns + middle, 1.0) > 0.5 * row.peak {
                    low = middle
                } else {
                    high = middle
                }
            }
            low
        };
        response.fwhm_ns = half(0.0, 5.0) - half(0.0, -5.0);
        response
    }

    /// Variance of a normal distribution with the width of the response.
    fn variance_ns2(&self) -> f64 {
        self.fwhm_ns.powi(2) / (8.0 * 2f64.ln())
    }

    fn row_of(&self, sd_ns: f64) -> Row {
        let count = ((LAST_NS - FIRST_NS) * STEPS_PER_NS) as usize + 1;
        let times = (0..count).map(|k| FIRST_NS + k as f64 / STEPS_PER_NS);
        let lobe: Vec<f64> = times.clone().map(|t| decayed(t, sd_ns)).collect();
        let reach = (6.0 * sd_ns * STEPS_PER_NS).ceil() as i64;
        let step = 1.0 / STEPS_PER_NS;
        let kernel: Vec<f64> = (-reach..=reach)
            .map(|k| (-0.5 * (k as f64 * step / sd_ns).powi(2)).exp() * step / (sd_ns * TAU.sqrt()))
            .collect();
        let sharp: Vec<f64> = (-reach..count as i64 + reach)
            .map(|k| {
                let t = FIRST_NS + k as f64 * step - RINGING_FROM_NS;
                if t > 0.0 {
                    -(-t / RINGING_DECAY_NS).exp() * (TAU * t / RINGING_PERIOD_NS).sin()
                } else {
                    0.0
                }
            })
            .collect();
        let scale = if self.ringing_scale == 0.0 { 1.0 } else { self.ringing_scale };
        let ringing: Vec<f64> = sharp
            .windows(kernel.len())
            .map(|window| scale * window.iter().zip(&kernel).map(|(a, b)| a * b).sum::<f64>())
            .collect();
        let sum: Vec<f64> = lobe.iter().zip(&ringing).map(|(a, b)| a + b).collect();
        Row { peak: greatest(&sum).0, lobe, ringing }
    }

    fn widened(&self, width: f64) -> Row {
        self.row_of((NORMAL_SD_NS.powi(2) + self.variance_ns2() * (width * width - 1.0)).sqrt())
    }

    fn row(&self, width: f64) -> &Row {
        let index = (((width - 1.0) / WIDTH_STEP).round().max(0.0) as usize).min(WIDTHS - 1);
        self.rows[index].get_or_init(|| self.widened(1.0 + index as f64 * WIDTH_STEP))
    }

    /// Response with this width ratio and peak 1, at a time from the peak of the unwidened
    /// response.
    pub fn at(&self, time_ns: f64, width: f64) -> f64 {
        let row = self.row(width);
        row.at(time_ns + self.peak_ns, 1.0) / row.peak
    }
}

impl Row {
    fn at(&self, time_ns: f64, ringing: f64) -> f64 {
        let place = (time_ns - FIRST_NS) * STEPS_PER_NS;
        if place < 1.0 || place > self.lobe.len() as f64 - 3.0 {
            return 0.0;
        }
        let (first, x) = (place as usize - 1, place.fract());
        let weights = lagrange(x);
        (0..4).map(|i| weights[i] * (self.lobe[first + i] + ringing * self.ringing[first + i])).sum()
    }
}

/// Weights of cubic interpolation between four equidistant points, at a fraction of the middle
/// interval.
fn lagrange(x: f64) -> [f64; 4] {
    let (a, b, c) = (x + 1.0, x - 1.0, x - 2.0);
    [-x * b * c / 6.0, a * b * c / 2.0, -a * x * c / 2.0, a * x * b / 6.0]
}

/// An exponential decay from 0, convolved with a normal distribution; area 1.
fn decayed(time_ns: f64, sd_ns: f64) -> f64 {
    let ratio = sd_ns / DECAY_NS;
    let below = libm::erfc((ratio - time_ns / sd_ns) * std::f64::consts::FRAC_1_SQRT_2);
    (0.5 * ratio * ratio - time_ns / DECAY_NS).exp() * below / (2.0 * DECAY_NS)
}

/// Maximum of a smooth table, and its position in steps.
fn greatest(values: &[f64]) -> (f64, f64) {
    let at = (0..values.len()).fold(0, |best, k| if values[k] > values[best] { k } else { best });
    let fine = (-1000..=1000).map(|i| f64::from(i) * 1e-3).map(|shift| {
        let place = at as f64 + shift;
        let (first, weights) = (place as usize - 1, lagrange(place.fract()));
        ((0..4).map(|i| weights[i] * values[first + i]).sum::<f64>(), place)
    });
    fine.fold((f64::NEG_INFINITY, 0.0), |best, one| if one.0 > best.0 { one } else { best })
}

/// An echo: peak signal-to-noise ratio, position of the response's peak, and width ratio.
#[derive(Clone, Copy, Debug)]
pub struct Echo {
    /// Peak amplitude divided by the noise SD.
    pub snr: f64,
    /// Position of the peak, samples.
    pub place: f64,
    /// Width relative to the response.
    pub width: f64,
}

/// Generates waveforms.
#[derive(Clone)]
pub struct Instrument {
    /// System response.
    pub response: Arc<Response>,
    noise: Arc<Noise>,
    random: Random,
    normal: Normal,
    /// Relative SD of the ringing from pulse to pulse.
    pub ringing_sd: f64,
}

impl Instrument {
    /// Two seeds: the cell, and the part of its waveforms.
    pub fn new(response: &Arc<Response>, cell: u64, part: u32) -> Instrument {
        let lags: Vec<f64> = (1..=LAGS).map(autocorrelation).collect();
        Instrument {
            response: response.clone(),
            noise: Arc::new(Noise::new(NOISE_SD_DN, &lags).expect("a process")),
            random: Random::of_shot(cell, part, 0, Purpose::Noise),
            normal: Normal::default(),
            ringing_sd: 0.0,
        }
    }

    /// A uniform random number in an interval.
    pub fn uniform(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.random.uniform()
    }

    /// An echo at a random phase, well within the block.
    pub fn echo(&mut self, snr: f64, width: f64) -> Echo {
        Echo { snr, place: self.uniform(18.0, 24.0), width }
    }

    /// Samples of a waveform with these echoes.
    pub fn record(&mut self, echoes: &[Echo], full_scale_dn: f64) -> Vec<u16> {
        let mut block = [0.0; SAMPLES];
        self.noise.fill(&mut self.random, &mut block);
        for echo in echoes {
            let row = self.response.row(echo.width);
            let ringing = if self.ringing_sd > 0.0 {
                1.0 + self.ringing_sd * self.normal.draw(&mut self.random)
            } else {
                1.0
            };
            let height = NOISE_SD_DN * echo.snr / row.peak;
            for (k, value) in block.iter_mut().enumerate() {
                *value += height * row.at(k as f64 - echo.place + self.response.peak_ns, ringing);
            }
        }
        block.iter().map(|value| (value + BACKGROUND_DN).round().clamp(0.0, full_scale_dn) as u16).collect()
    }

    /// A waveform for calibration.
    ///
    /// 60 % of the targets are flat except for a mean widening of 1 % of the response's variance;
    /// 40 % are widened up to 1.5 times. 30 % have a second return. Signal-to-noise ratios are 15
    /// to 110.
    pub fn record_any(&mut self, full_scale_dn: f64) -> Vec<u16> {
        let width = if self.random.uniform() < 0.6 {
            (1.0 - 0.01 * (1.0 - self.random.uniform()).ln()).sqrt()
        } else {
            self.uniform(1.0, 1.5)
        };
        let snr = self.uniform(15.0, 110.0);
        let first = self.echo(snr, width);
        if self.random.uniform() >= 0.3 {
            return self.record(&[first], full_scale_dn);
        }
        let second =
            Echo { snr: self.uniform(15.0, 60.0), place: first.place + self.uniform(5.0, 30.0), width: 1.0 };
        self.record(&[first, second], full_scale_dn)
    }
}

/// Autocorrelation of the noise without rounding.
pub fn autocorrelation(lag: usize) -> f64 {
    if lag == 0 { 1.0 } else { BAND_PART * BAND_CORRELATION.powi((lag * lag) as i32) }
}

/// SD of a sample's noise, including rounding.
pub fn noise_sd_dn() -> f64 {
    (NOISE_SD_DN.powi(2) + 1.0 / 12.0).sqrt()
}

/// Cramér-Rao bound of an echo: relative amplitude, position (samples), logarithm of width.
///
/// All three are free; only the used samples of a block count.
pub fn bound(response: &Response, echo: Echo, used: &[bool]) -> [f64; 3] {
    let kept: Vec<usize> = (0..used.len()).filter(|k| used[*k]).collect();
    let covariance = |lag: usize| match lag {
        0 => noise_sd_dn().powi(2),
        _ => autocorrelation(lag) * NOISE_SD_DN.powi(2),
    };
    let matrix = DMatrix::from_fn(kept.len(), kept.len(), |i, j| covariance(kept[i].abs_diff(kept[j])));
    let solver = matrix.cholesky().expect("a covariance");
    const STEP: f64 = 1e-3;
    let rows = [0.0, STEP, -STEP].map(|u: f64| response.widened(echo.width * u.exp()));
    let height = NOISE_SD_DN * echo.snr;
    let value = |row: usize, shift: f64| {
        let at =
            |k: usize| rows[row].at(k as f64 - echo.place - shift + response.peak_ns, 1.0) / rows[row].peak;
        DVector::from_fn(kept.len(), |i, _| height * at(kept[i]))
    };
    let columns = [
        value(0, 0.0),
        (value(0, STEP) - value(0, -STEP)) / (2.0 * STEP),
        (value(1, 0.0) - value(2, 0.0)) / (2.0 * STEP),
    ];
    let fisher = Matrix3::from_fn(|i, j| columns[i].dot(&solver.solve(&columns[j])));
    let inverse = fisher.try_inverse().expect("an echo that can be measured");
    [0, 1, 2].map(|i| inverse[(i, i)].sqrt())
}

/// Bound averaged over sample phases: root of the mean variance.
pub fn mean_bound(response: &Response, snr: f64, width: f64) -> [f64; 3] {
    let mut sums = [0.0; 3];
    for phase in 0..8 {
        let echo = Echo { snr, place: 20.0 + f64::from(phase) / 8.0, width };
        let variances = bound(response, echo, &[true; SAMPLES]).map(|sd| sd * sd / 8.0);
        sums.iter_mut().zip(variances).for_each(|(sum, variance)| *sum += variance);
    }
    sums.map(f64::sqrt)
}

/// Mean and standard deviation.
pub fn moments(values: &[f64]) -> (f64, f64) {
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    (mean, (values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (n - 1.0)).sqrt())
}

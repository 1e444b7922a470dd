//! Decomposes an array of samples without a file or job.
//!
//! Calibrates from waveforms in memory, then fits one.
//!
//!     cargo run --example decompose_samples
#![allow(clippy::print_stdout, reason = "an example prints what it finds")]

use anyhow::{Context, Result};
use wavex_signal::calibrate::{CalibrationSettings, calibrate};
use wavex_signal::decompose::Waveform;
use wavex_signal::decompose::{DecomposeSettings, Decomposer};

/// Samples per waveform, at 1 ns.
const SAMPLES: usize = 60;
/// Largest value of the digitiser.
const FULL_SCALE_DN: f64 = 255.0;

fn main() -> Result<()> {
    // 400 single echoes, 20 to 120 DN high and 4.5 ns wide, on a background of 3 DN.
    let mut noise = Noise(1);
    let recorded: Vec<Vec<u16>> = (0..400)
        .map(|shot| {
            waveform(&[(20.0 + 0.37 * f64::from(shot % 50), 20.0 + f64::from(shot % 101))], &mut noise)
        })
        .collect();
    let blocks = recorded.iter().map(|samples| Waveform { samples });
    let model = calibrate(blocks, &CalibrationSettings::echoes(1.0, FULL_SCALE_DN))?;
    println!("noise SD {:.2} DN, pulse FWHM {:.2} ns", model.noise_sd_dn, model.pulse_fwhm_ns);

    // Two echoes 6 ns apart, 80 and 40 DN high.
    let samples = waveform(&[(25.3, 80.0), (31.3, 40.0)], &mut noise);
    let mut decomposer = Decomposer::new(&model, &DecomposeSettings::default(), SAMPLES)?;
    let result = decomposer.decompose(&samples);
    for found in result.returns {
        println!(
            "echo at {:.2} +- {:.2} samples, amplitude {:.1} +- {:.1} DN",
            found.position_samples, found.position_sd_samples, found.amplitude_dn, found.amplitude_sd_dn
        );
    }
    result.returns.first().context("no echo found")?;
    Ok(())
}

/// Simulates digitised echoes (position in samples, height in DN) with noise.
fn waveform(echoes: &[(f64, f64)], noise: &mut Noise) -> Vec<u16> {
    let sample = |k: usize| {
        let pulse =
            |(at, height): &(f64, f64)| height * (-4.0 * 2f64.ln() * ((k as f64 - at) / 4.5).powi(2)).exp();
        let value = 3.0 + echoes.iter().map(pulse).sum::<f64>() + noise.next();
        value.round().clamp(0.0, FULL_SCALE_DN) as u16
    };
    (0..SAMPLES).map(sample).collect()
}

/// Noise with an SD of about 1 DN.
///
/// The sum of 12 uniform numbers of a linear congruential generator.
struct Noise(u64);

impl Noise {
    fn next(&mut self) -> f64 {
        let mut uniform = || {
            self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (self.0 >> 40) as f64 / (1u64 << 24) as f64
        };
        (0..12).map(|_| uniform()).sum::<f64>() - 6.0
    }
}

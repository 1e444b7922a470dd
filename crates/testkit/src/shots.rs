//! A recording of simple pulses, the same in every format: level ground below a scanner at nadir.

/// Samples per waveform, 1 ns apart.
pub const SAMPLES: usize = 48;

/// Range per nanosecond of time of flight, m.
pub const METRES_PER_NS: f64 = 0.149_853_751;

/// A Gaussian pulse at sample `peak` with an FWHM of 4.5 ns, on a background of 3 DN with noise of
/// about 1 DN.
pub fn waveform(shot: usize, peak: f64, amplitude_dn: f64) -> Vec<u8> {
    waveform_with(shot, peak, amplitude_dn, 0.0)
}

/// The same, with odd samples taken late by this fraction of a sample.
fn waveform_with(shot: usize, peak: f64, amplitude_dn: f64, odd_sample_shift: f64) -> Vec<u8> {
    let mut state = (shot as u64 + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15);
    let mut uniform = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) as f64 / (1u64 << 31) as f64
    };
    let sample = |i: usize| {
        // The sum of 12 uniform numbers is nearly normal with variance 1.
        let noise: f64 = (0..12).map(|_| uniform()).sum::<f64>() - 6.0;
        let taken = i as f64 + if i % 2 == 1 { odd_sample_shift } else { 0.0 };
        let x = (taken - peak) / (4.5 / 2.354_82);
        (3.0 + noise + amplitude_dn * (-0.5 * x * x).exp()).round().clamp(0.0, 255.0) as u8
    };
    (0..SAMPLES).map(sample).collect()
}

/// Echo of a shot.
pub fn echo(shot: usize) -> Vec<u8> {
    echo_with(shot, 0.0)
}

/// The same, with odd samples taken late by this fraction of a sample.
pub fn echo_with(shot: usize, odd_sample_shift: f64) -> Vec<u8> {
    waveform_with(shot, peak(shot), 60.0, odd_sample_shift)
}

/// Position of a shot's echo, samples.
pub fn peak(shot: usize) -> f64 {
    24.0 + 0.1 * (shot % 10) as f64
}

/// Time of a shot, s.
pub fn time_s(shot: usize) -> f64 {
    1000.0 + shot as f64 / 1024.0
}

//! Calibration time per waveform, on one thread.

use super::*;

/// Calibrates from simulated waveforms, and from recorded ones if available.
pub fn calibration(bench: &Bench) {
    let mut instrument = Instrument::new(&bench.response, 1, 0);
    let waveforms: Vec<Vec<u16>> = (0..CALIBRATION).map(|_| instrument.record_any(EIGHT_BITS)).collect();
    calibrating(bench, "simulated", &waveforms);
    if let Some(data) = wavex_testkit::data() {
        let path = data.join("pulsewaves/riegl_example3.pls");
        calibrating(bench, "riegl_example3", &wavex_testkit::recordings::samples("read_pulsewaves", &path));
    }
}

fn calibrating(bench: &Bench, name: &str, waveforms: &[Vec<u16>]) {
    let blocks = || waveforms.iter().map(|samples| Waveform { samples });
    let settings = CalibrationSettings::echoes(1.0, EIGHT_BITS);
    let each = |started: Instant| 1e6 * started.elapsed().as_secs_f64() / waveforms.len() as f64;
    let started = Instant::now();
    let gaussian = calibrate(blocks(), &settings).expect("a calibration");
    let noise_us = each(started);
    let started = Instant::now();
    let found = calibrate_response(blocks(), &gaussian, &settings).expect("a response");
    let response_us = each(started);
    bench.beside(
        "A10",
        &format!("calibrating {} {name} waveforms: time for one", waveforms.len()),
        format!("{:.1} us", noise_us + response_us),
    );
    bench.beside(
        "A10",
        &format!("of which noise, and response of {} echoes", found.usable_echoes),
        format!("{noise_us:.1}, {response_us:.1} us"),
    );
}

//! Strong returns: variable ringing and saturated peaks.

use super::*;

/// A9: false returns after strong returns with variable ringing.
///
/// And detection of weak returns there.
pub fn late_returns(bench: &mut Bench) {
    let model = calibrated(&bench.response, 9, TWELVE_BITS, 0.25);
    let error =
        model.response.as_ref().map_or(0.0, |r| r.template_error.iter().fold(0.0, |a: f64, b| a.max(*b)));
    bench.beside(
        "A9",
        "template error, the greatest; error factor",
        format!("{:.2} %; {:.3}", 100.0 * error, model.pulse_error_factor),
    );
    let settings = DecomposeSettings::default();
    for snr in [50.0, 100.0, 200.0, 400.0] {
        let cell = Cell { ringing_sd: 0.25, ..bench.cell(9000 + snr as u64, &model, &settings) };
        let all = bench.observe(&cell, |instrument, engine| {
            let echo = instrument.echo(snr, 1.0);
            let samples = instrument.record(&[echo], TWELVE_BITS);
            let found = engine.decompose(&samples).0;
            let late = found.iter().filter(|r| r.position_samples > echo.place + 3.0).count();
            let nearest = found
                .iter()
                .map(|r| r.position_samples - echo.place)
                .min_by(|a, b| a.abs().total_cmp(&b.abs()));
            (late, found.len().saturating_sub(1 + late), nearest.unwrap_or(f64::NAN))
        });
        let n = f64::from(bench.count);
        let late = all.iter().map(|a| a.0).sum::<usize>() as f64 / n;
        let early = all.iter().map(|a| a.1).sum::<usize>() as f64 / n;
        bench.goal(
            "A9",
            &format!("SNR {snr}: late false returns per waveform (others)"),
            format!("{late:.1e} ({early:.1e})"),
            "<= 1e-3",
            late <= 1e-3,
        );
        bench.beside(
            "A9",
            &format!("SNR {snr}: bias of range"),
            format!("{:+.2} ps", 1e3 * moments(&all.iter().map(|a| a.2).collect::<Vec<f64>>()).0),
        );
    }
    let cell = Cell { ringing_sd: 0.25, ..bench.cell(9900, &model, &settings) };
    let fwhm = bench.response.fwhm_ns;
    let kept = bench.observe(&cell, |instrument, engine| {
        let strong = instrument.echo(100.0, 1.0);
        let weak = Echo { snr: 10.0, place: strong.place + fwhm * instrument.uniform(2.0, 4.0), width: 1.0 };
        let samples = instrument.record(&[strong, weak], TWELVE_BITS);
        engine.decompose(&samples).0.iter().any(|r| (r.position_samples - weak.place).abs() < 1.5)
    });
    let kept = 100.0 * kept.iter().filter(|kept| **kept).count() as f64 / f64::from(bench.count);
    bench.goal(
        "A9",
        "SNR 10 kept 2 to 4 widths after SNR 100",
        format!("{kept:.2} %"),
        ">= 99 %",
        kept >= 99.0,
    );
}

/// A11: saturated peaks, compared with the bound of the unsaturated samples.
pub fn saturated(bench: &mut Bench, model: &ChannelModel) {
    let settings = DecomposeSettings::default();
    for snr in [150.0, 200.0, 300.0, 400.0, 600.0, 800.0] {
        let cell =
            Cell { count: bench.count.min(10_000), ..bench.cell(11_000 + snr as u64, model, &settings) };
        let response = bench.response.clone();
        let all = bench.observe(&cell, |instrument, engine| {
            let echo = instrument.echo(snr, 1.0);
            let samples = instrument.record(&[echo], EIGHT_BITS);
            let near =
                engine.decompose(&samples).0.iter().find(|r| (r.position_samples - echo.place).abs() < 0.5);
            let score = near.map(|r| scores(r, &echo).0[0]);
            // The bound is almost constant: a tenth of the waveforms suffices.
            let told = instrument.uniform(0.0, 1.0) < 0.1;
            (score, told.then(|| bound(&response, echo, &unsaturated(&samples))[1]))
        });
        let found: Vec<Score> = all.iter().filter_map(|(score, _)| *score).collect();
        let squares: Vec<f64> = all.iter().filter_map(|(_, bound)| bound.map(|b| b * b)).collect();
        let bound = moments(&squares).0.sqrt();
        let (mean, sd) = moments(&found.iter().map(|s| s.error).collect::<Vec<f64>>());
        let z = spread(&found);
        let failures = all.len() - found.len();
        bench.goal(
            "A11",
            &format!("SNR {snr}: range over its bound ({:.1} ps)", 1e3 * bound),
            format!("{:.3}", sd / bound),
            "<= 1.10",
            sd / bound <= 1.1,
        );
        bench.goal(
            "A11",
            &format!("SNR {snr}: normalised error; bias"),
            format!("{z:.3}; {:+.1} ps", 1e3 * mean),
            "0.9-1.1",
            within(z, 0.9, 1.1),
        );
        bench.goal(
            "A11",
            &format!("SNR {snr}: failures of {}", all.len()),
            format!("{failures}"),
            "0",
            failures == 0,
        );
    }
}

/// A11: clipped echoes of a model whose calibration had none.
///
/// As a run does, the behaviour near full scale is proven by other clipped echoes, and the standard
/// deviations contain the errors of a receiver that may be overdriven unless it is proven to be linear.
pub fn clipped(bench: &mut Bench, model: &ChannelModel) {
    let mut instrument = Instrument::new(&bench.response, 11_900, 0);
    let waveforms: Vec<Vec<u16>> = (0..2000)
        .map(|i| {
            let snr =
                if i % 2 == 0 { instrument.uniform(20.0, 110.0) } else { instrument.uniform(150.0, 400.0) };
            let echo = instrument.echo(snr, 1.0);
            instrument.record(&[echo], EIGHT_BITS)
        })
        .collect();
    let blocks = waveforms.iter().map(|samples| Waveform { samples });
    let limits = receiver_limits(blocks, model, &CalibrationSettings::echoes(1.0, EIGHT_BITS));
    let limits = limits.expect("limits");
    bench.beside("A11", "clipped echoes: the receiver is proven to be linear", limits.is_linear.to_string());
    let model = ChannelModel { limits, ..model.clone() };
    let (time_ns, _) = model.overdrive_errors();
    let settings = DecomposeSettings::default();
    for snr in [150.0, 200.0, 300.0, 400.0] {
        let cell =
            Cell { count: bench.count.min(10_000), ..bench.cell(11_900 + snr as u64, &model, &settings) };
        let found = bench.observe(&cell, |instrument, engine| {
            let echo = instrument.echo(snr, 1.0);
            let samples = instrument.record(&[echo], EIGHT_BITS);
            let found = engine.decompose(&samples).0;
            let near = found.iter().find(|r| (r.position_samples - echo.place).abs() < 0.5);
            near.map(|r| {
                let fitted = scores(r, &echo).0[0];
                Score { sd: fitted.sd.hypot(time_ns), ..fitted }
            })
        });
        let found: Vec<Score> = found.into_iter().flatten().collect();
        let z = spread(&found);
        bench.goal(
            "A11",
            &format!("SNR {snr}: normalised error with the run's evidence"),
            format!("{z:.3}"),
            "0.9-1.1",
            within(z, 0.9, 1.1),
        );
    }
}

/// Marks unsaturated samples, except the one after a saturated sample.
fn unsaturated(samples: &[u16]) -> Vec<bool> {
    let at_end = |k: usize| f64::from(samples[k]) >= EIGHT_BITS;
    (0..samples.len()).map(|k| samples[k] > 0 && !(at_end(k) || k > 0 && at_end(k - 1))).collect()
}

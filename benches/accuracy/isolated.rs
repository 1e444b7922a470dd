//! Calibration results and isolated returns.

use super::*;

/// A10: compares the calibration with the truth.
///
/// Returns the delay of its time zero relative to the truth, samples. The delay is not an error: it
/// also applies to the outgoing pulse, which is subtracted.
pub fn calibration(bench: &mut Bench, model: &ChannelModel) -> f64 {
    let noise = 100.0 * (model.noise_sd_dn / noise_sd_dn() - 1.0);
    bench.goal("A10", "noise's standard deviation", format!("{noise:+.2} %"), "+- 1.5 %", noise.abs() <= 1.5);
    let lag = |lag: usize| autocorrelation(lag) * (NOISE_SD_DN / noise_sd_dn()).powi(2);
    let worst =
        model.autocorrelation.iter().enumerate().map(|(k, rho)| (rho - lag(k + 1)).abs()).fold(0.0, f64::max);
    bench.goal("A10", "correlation, the worst lag", format!("{worst:.4}"), "0.02", worst <= 0.02);
    let worst = model.background_dn.iter().map(|b| (b - BACKGROUND_DN).abs()).fold(0.0, f64::max);
    bench.goal("A10", "background, the worst phase", format!("{worst:.3} DN"), "0.1 DN", worst <= 0.1);
    let response = model.response.as_ref().expect("a response");
    let width = 100.0 * (model.pulse_fwhm_ns / bench.response.fwhm_ns - 1.0);
    bench.goal(
        "A10",
        "response's full width at half maximum",
        format!("{width:+.2} %"),
        "0.6 %",
        width.abs() <= 0.6,
    );
    let mut shift = 0.0;
    for (i, node) in response.nodes.iter().enumerate() {
        let [rms, lag, width] = shape_error(&bench.response, &node.values, response.first_sample);
        if i == 0 {
            shift = lag;
        }
        let what = format!("response for {:.0} DN, shape against the widened truth", node.peak_dn);
        bench.goal("A10", &what, format!("{:.3} %", 100.0 * rms), "0.1 %", rms <= 1e-3);
        let gauge = format!("{:+.2} ps, {width:.4}", 1e3 * lag);
        bench.beside("A10", "  ... time zero and width relative to the truth", gauge);
    }
    let factor = model.pulse_error_factor;
    bench.goal(
        "A10",
        "error factor on the pulse",
        format!("{factor:.3}"),
        "1.00 +- 0.01",
        within(factor, 0.99, 1.01),
    );
    let error = 100.0 * response.template_error.iter().fold(0.0, |a: f64, b| a.max(*b));
    bench.beside("A10", "template error, the greatest", format!("{error:.3} %"));
    bench.beside(
        "A10",
        "order of the noise, echoes of the response",
        format!("{}, {}", model.ar.len(), response.echoes),
    );
    shift
}

/// Returns the RMS deviation from the best-fitting truth.
///
/// Also the shift and width of that fit.
fn shape_error(truth: &Response, values: &[f64], first_sample: i32) -> [f64; 3] {
    let times: Vec<f64> = (0..values.len()).map(|k| f64::from(first_sample) + k as f64 / 8.0).collect();
    let inside: Vec<usize> = (0..times.len()).filter(|&k| within(times[k], -9.0, 34.0)).collect();
    let rms = |p: [f64; 3]| {
        let square = |&k: &usize| (values[k] - p[2] * truth.at(times[k] + p[0], p[1])).powi(2);
        (inside.iter().map(square).sum::<f64>() / inside.len() as f64).sqrt()
    };
    let mut best = [0.0, 1.0, 1.0];
    let mut step = [0.016, 0.016, 0.016];
    while step[0] > 1e-5 {
        let mut moved = false;
        for i in 0..3 {
            for sign in [-1.0, 1.0] {
                let mut trial = best;
                // Widths of the truth are quantised to 0.002.
                trial[i] += sign * if i == 1 { f64::max(step[i], 0.002) } else { step[i] };
                if rms(trial) < rms(best) {
                    (best, moved) = (trial, true);
                }
            }
        }
        if !moved {
            step = step.map(|s| 0.5 * s);
        }
    }
    // A delay of the response appears as the same delay of fitted positions.
    [rms(best), best[0], best[1]]
}

/// A1 to A4 and coverage: isolated returns.
pub fn isolated(bench: &mut Bench, model: &ChannelModel, gauge: f64) {
    let settings = DecomposeSettings::default();
    for width in [1.0, 1.5, 2.5] {
        for snr in [6.0, 8.0, 10.0, 15.0, 20.0, 50.0, 100.0] {
            let cell = bench.cell(100 + (10.0 * width + 100.0 * snr) as u64, model, &settings);
            let all = bench.observe(&cell, |instrument, engine| {
                let echo = instrument.echo(snr, width);
                let samples = instrument.record(&[echo], EIGHT_BITS);
                match engine.decompose(&samples).0 {
                    [r] if (r.position_samples - echo.place).abs() < 3.0 => Some(scores(r, &echo)),
                    _ => None,
                }
            });
            let found: Vec<([Score; 3], f64)> = all.into_iter().flatten().collect();
            isolated_cell(bench, snr, width, gauge, &found);
        }
    }
}

fn isolated_cell(bench: &mut Bench, snr: f64, width: f64, gauge: f64, found: &[([Score; 3], f64)]) {
    let part = |i: usize| -> Vec<Score> { found.iter().map(|(s, _)| s[i]).collect() };
    let (place, height, spreads) = (part(0), part(1), part(2));
    let bounds = mean_bound(&bench.response, snr, width);
    let (mean, sd) = moments(&place.iter().map(|s| s.error).collect::<Vec<f64>>());
    let here = format!("width {width}, SNR {snr}");
    let asked = if snr >= 10.0 { 1.05 } else { 1.15 };
    let ratio = sd / bounds[1];
    bench.goal(
        "A1",
        &format!("{here}: range over its bound ({:.1} ps)", 1e3 * bounds[1]),
        format!("{ratio:.3}"),
        &format!("{asked}"),
        ratio <= asked,
    );
    if snr >= 20.0 {
        let bias = mean - gauge;
        let asked = (0.03 * bounds[1]).min(0.003);
        let known = sd / (found.len() as f64).sqrt();
        bench.verdict(
            "A2",
            &format!("{here}: range bias, time zero removed"),
            format!("{:+.2} ps (raw {:+.2}, +- {:.2})", 1e3 * bias, 1e3 * mean, 1e3 * known),
            &format!("{:.2} ps", 1e3 * asked),
            within_known(bias, -asked, asked, known),
        );
    }
    if snr >= 10.0 {
        let z = [spread(&place), spread(&height), spread(&spreads)];
        let asked = if snr >= 15.0 { 3 } else { 2 };
        let known = known_spread(found.len());
        let each = z[..asked].iter().map(|z| within_known(*z, 0.95, 1.05, known));
        let reached = each.fold([true, true], |all, one| [all[0] && one[0], all[1] && one[1]]);
        bench.verdict(
            "A3",
            &format!("{here}: normalised errors of range, height, width"),
            format!("{:.3} {:.3} {:.3}", z[0], z[1], z[2]),
            "0.95-1.05",
            reached,
        );
        let covered = 100.0 * coverage(&place);
        bench.verdict(
            "cov",
            &format!("{here}: range coverage within 1 SD"),
            format!("{covered:.1} %"),
            "66-70 %",
            within_known(covered, 66.0, 70.0, known_coverage(found.len())),
        );
    }
    let (centre, fit) = moments(&found.iter().map(|(_, fit)| *fit).collect::<Vec<f64>>());
    bench.goal(
        "A4",
        &format!("{here}: deviation ratio, mean and spread"),
        format!("{centre:+.3} {fit:.3}"),
        "0 +- 0.05, 1 +- 0.05",
        centre.abs() <= 0.05 && within(fit, 0.95, 1.05),
    );
    let heights: Vec<f64> = height.iter().map(|s| s.error / (NOISE_SD_DN * snr)).collect();
    let missing = bench.count as usize - found.len();
    bench.beside(
        "",
        &format!("{here}: bias of height, of width; count differs from 1"),
        format!(
            "{:+.2} %, {:+.2} %; {missing}",
            100.0 * moments(&heights).0,
            100.0 * moments(&spreads.iter().map(|s| s.error / width).collect::<Vec<f64>>()).0
        ),
    );
}

/// A5: isolated returns in mode `fastest`.
///
/// One step from the width bank.
pub fn fastest(bench: &mut Bench, model: &ChannelModel, gauge: f64) {
    let settings = DecomposeSettings::default();
    for width in [1.0, 1.5, 2.0, 2.5] {
        for snr in [15.0, 20.0, 50.0, 100.0] {
            let seed = 5100 + (10.0 * width + 100.0 * snr) as u64;
            let cell = Cell { mode: Mode::Fastest, ..bench.cell(seed, model, &settings) };
            let all = bench.observe(&cell, |instrument, engine| {
                let echo = instrument.echo(snr, width);
                let samples = instrument.record(&[echo], EIGHT_BITS);
                match engine.decompose(&samples).0 {
                    [r] => Some((r.position_samples - echo.place - gauge, r.amplitude_dn)),
                    _ => None,
                }
            });
            let found: Vec<(f64, f64)> = all.into_iter().flatten().collect();
            let square = found.iter().map(|(error, _)| error * error).sum::<f64>() / found.len() as f64;
            let height = found.iter().map(|(_, height)| height).sum::<f64>() / found.len() as f64;
            let ratio = square.sqrt() / mean_bound(&bench.response, snr, width)[1];
            let here = format!("fastest, width {width}, SNR {snr}");
            let known = known_spread(found.len());
            bench.verdict(
                "A5",
                &format!("{here}: error of range over its bound"),
                format!(
                    "{ratio:.3} ({:.2} % not one)",
                    100.0 * (1.0 - found.len() as f64 / f64::from(cell.count))
                ),
                "1.03",
                [ratio <= 1.03, ratio <= 1.03 + 2.0 * known],
            );
            let bias = 100.0 * (height / (NOISE_SD_DN * snr) - 1.0);
            bench.goal(
                "A5",
                &format!("{here}: bias of height"),
                format!("{bias:+.2} %"),
                "0.5 %",
                bias.abs() <= 0.5,
            );
        }
    }
}

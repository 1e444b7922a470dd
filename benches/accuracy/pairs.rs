//! Overlapping returns, and false splits of single returns.

use super::*;

/// Scores both returns of a pair.
///
/// `None` unless exactly two are found, each within 0.4 of the separation.
fn pair_scores(found: &[Return], echoes: &[Echo; 2]) -> Option<[[Score; 3]; 2]> {
    let separation = echoes[1].place - echoes[0].place;
    let near = |r: &Return, e: &Echo| (r.position_samples - e.place).abs() < 0.4 * separation;
    match found {
        [a, b] if near(a, &echoes[0]) && near(b, &echoes[1]) => {
            Some([scores(a, &echoes[0]).0, scores(b, &echoes[1]).0])
        }
        _ => None,
    }
}

/// Returns the pairs found.
///
/// `kind` is SNR, separation in widths, and relative height of the second.
fn pairs(bench: &Bench, model: &ChannelModel, evidence: f64, kind: [f64; 3]) -> Vec<[[Score; 3]; 2]> {
    let [snr, widths, part] = kind;
    let settings = settings(evidence);
    let model = of_scale(model, TWELVE_BITS);
    let cell = bench.cell(7000 + (1000.0 * widths + 10.0 * snr + part) as u64, &model, &settings);
    let separation = widths * bench.response.fwhm_ns;
    let all = bench.observe(&cell, |instrument, engine| {
        let first = instrument.echo(snr, 1.0);
        let echoes = [first, Echo { snr: part * snr, place: first.place + separation, width: 1.0 }];
        let samples = instrument.record(&echoes, TWELVE_BITS);
        pair_scores(engine.decompose(&samples).0, &echoes)
    });
    all.into_iter().flatten().collect()
}

/// A7 and A8: detection of overlapping returns.
///
/// Their A3 and coverage.
pub fn overlapping(bench: &mut Bench, model: &ChannelModel) {
    let goals = [
        ("A7", 20.0, 0.9, 1.0, 95.0),
        ("A7", 50.0, 0.7, 1.0, 95.0),
        ("A7", 100.0, 0.6, 1.0, 95.0),
        ("A8", 20.0, 1.0, 0.3, 85.0),
        ("A8", 50.0, 0.7, 0.3, 95.0),
        ("A8", 100.0, 0.6, 0.3, 95.0),
    ];
    for (goal, snr, widths, part, asked) in goals {
        let [at_11, at_16] = [11.0, 16.0].map(|evidence| {
            100.0 * pairs(bench, model, evidence, [snr, widths, part]).len() as f64 / f64::from(bench.count)
        });
        let what = format!("SNR {snr}, {widths} widths, second {part} x: both found at evidence 11 (16)");
        bench.goal(
            goal,
            &what,
            format!("{at_11:.1} % ({at_16:.1} %)"),
            &format!(">= {asked} %"),
            at_11 >= asked,
        );
    }
    for (snr, widths) in [(20.0, 0.8), (20.0, 1.0), (20.0, 1.5), (50.0, 0.8), (50.0, 1.0), (100.0, 0.8)] {
        let found = pairs(bench, model, 16.0, [snr, widths, 1.0]);
        let z =
            [0, 1, 2].map(|i| spread(&found.iter().flat_map(|p| [p[0][i], p[1][i]]).collect::<Vec<Score>>()));
        let what = format!("pairs, SNR {snr}, {widths} widths: normalised range (height, width)");
        bench.goal(
            "A3",
            &what,
            format!("{:.3} ({:.3}, {:.3})", z[0], z[1], z[2]),
            "0.85-1.15",
            within(z[0], 0.85, 1.15),
        );
    }
    let found = pairs(bench, model, 16.0, [50.0, 0.75, 1.0]);
    let covered = 100.0 * coverage(&found.iter().flat_map(|p| [p[0][0], p[1][0]]).collect::<Vec<Score>>());
    bench.goal(
        "cov",
        "pairs, SNR 50, 0.75 widths: range within one SD",
        format!("{covered:.1} %"),
        "62-76 %",
        within(covered, 62.0, 76.0),
    );
}

/// C2: two equal returns in eight bits, up to full scale.
///
/// Clipped ones have no goal: they lose the dip between the returns. Overdriven receivers are not
/// simulated: the response is that of weaker returns.
pub fn bright(bench: &mut Bench, model: &ChannelModel) {
    let settings = DecomposeSettings::default();
    let kinds = [
        (100.0, 0.8),
        (100.0, 1.0),
        (150.0, 1.0),
        (150.0, 1.5),
        (200.0, 1.0),
        (200.0, 1.5),
        (230.0, 1.0),
        (230.0, 1.5),
        (245.0, 1.5),
    ];
    for (height_dn, widths) in kinds {
        let snr = height_dn / NOISE_SD_DN;
        let cell = bench.cell(7900 + (height_dn + 1000.0 * widths) as u64, model, &settings);
        let separation = widths * bench.response.fwhm_ns;
        let all = bench.observe(&cell, |instrument, engine| {
            let first = instrument.echo(snr, 1.0);
            let echoes = [first, Echo { place: first.place + separation, ..first }];
            let samples = instrument.record(&echoes, EIGHT_BITS);
            let is_clipped = samples.iter().any(|&sample| f64::from(sample) >= EIGHT_BITS);
            (is_clipped, pair_scores(engine.decompose(&samples).0, &echoes))
        });
        for clipped in [false, true] {
            let of_kind: Vec<_> = all.iter().filter(|(is_clipped, _)| *is_clipped == clipped).collect();
            if of_kind.len() * 20 < all.len() {
                continue;
            }
            let found: Vec<_> = of_kind.iter().filter_map(|(_, scores)| *scores).collect();
            let part = 100.0 * found.len() as f64 / of_kind.len() as f64;
            let z = spread(&found.iter().flat_map(|p| [p[0][0], p[1][0]]).collect::<Vec<Score>>());
            let what = format!("two of {height_dn} DN, {widths} widths: both found; z of range");
            let figure = format!("{part:.1} %; {z:.3}");
            if clipped {
                bench.beside("C2", &format!("clipped: {what}"), figure);
            } else {
                let reached = part >= 95.0 && within(z, 0.85, 1.15);
                bench.goal("C2", &what, figure, ">= 95 %; 0.85-1.15", reached);
            }
        }
    }
}

/// A7: false splits of single returns.
pub fn false_splits(bench: &mut Bench, model: &ChannelModel) {
    for width in [1.0, 1.5, 2.0] {
        for snr in [20.0, 50.0, 100.0] {
            let [at_11, at_16] = [11.0, 16.0].map(|evidence| {
                let settings = settings(evidence);
                let cell = bench.cell(7500 + (snr + 1000.0 * width) as u64, model, &settings);
                let all = bench.observe(&cell, |instrument, engine| {
                    let echo = instrument.echo(snr, width);
                    let samples = instrument.record(&[echo], EIGHT_BITS);
                    engine.decompose(&samples).0.len() > 1
                });
                100.0 * all.iter().filter(|more| **more).count() as f64 / f64::from(bench.count)
            });
            bench.goal(
                "A7",
                &format!("width {width}, SNR {snr}: false splits at evidence 11 (16)"),
                format!("{at_11:.2} % ({at_16:.2} %)"),
                "<= 0.5 %",
                at_11 <= 0.5,
            );
        }
    }
}

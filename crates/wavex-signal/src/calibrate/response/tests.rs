use super::*;
use crate::calibrate::calibrate;
use crate::noise::ArNoise;
use crate::simulated::{Random, digitised, moments, noise};
use wavex_simulation::pulse::PulseShape as Truth;

/// Single echoes of the simulated receiver on a background of 5 DN.
fn waveforms(count: usize) -> Vec<Vec<u16>> {
    waveforms_of(&mut Random::new(3), count)
}

fn waveforms_of(random: &mut Random, count: usize) -> Vec<Vec<u16>> {
    let (truth, process) = (Truth::riegl(), ArNoise::new(&[0.6], 0.7).unwrap());
    (0..count)
        .map(|_| {
            let (height, place) = (60.0 + 120.0 * random.uniform(), 14.0 + 8.0 * random.uniform());
            let widening = if random.uniform() < 0.6 { 0.0 } else { 2.0 * random.uniform() };
            let mut values = noise(random, &process, 60);
            for (k, value) in values.iter_mut().enumerate() {
                *value += 5.0 + height * truth.at(k as f64 - place, widening);
            }
            digitised(&values, 255)
        })
        .collect()
}

fn blocks(waveforms: &[Vec<u16>]) -> impl Iterator<Item = Waveform<'_>> + Clone {
    waveforms.iter().map(|samples| Waveform { samples })
}

#[test]
fn the_response_of_a_simulated_receiver_is_found() {
    let waveforms = waveforms(800);
    let settings = CalibrationSettings::echoes(1.0, 255.0);
    let gaussian = calibrate(blocks(&waveforms), &settings).unwrap();
    let found = calibrate_response(blocks(&waveforms), &gaussian, &settings).unwrap();
    let response = found.model.response.as_ref().unwrap();
    let truth = Truth::riegl();
    let rms = |times: std::ops::Range<i32>| {
        let square = |t: i32| {
            let at = (t - response.first_sample) as usize * STEPS_PER_SAMPLE;
            (response.nodes[0].values[at] - truth.at(f64::from(t), 0.0)).powi(2)
        };
        (times.clone().map(square).sum::<f64>() / times.len() as f64).sqrt()
    };
    println!(
        "{} of {} echoes; lobe {:.5}, tail {:.5}, width {:.4} of {:.4}, factor {:.3}, sd {:.5}",
        response.echoes,
        found.usable_echoes,
        rms(-8..14),
        rms(14..40),
        found.model.pulse_fwhm_ns,
        truth.fwhm_ns(),
        found.model.pulse_error_factor,
        response.shape_sd
    );
    assert!(found.usable_echoes > 600);
    assert!(rms(-8..14) < 2e-3 && rms(14..40) < 1e-3);
    assert!((found.model.pulse_fwhm_ns / truth.fwhm_ns() - 1.0).abs() < 0.01);
    assert_eq!(found.model.pulse_error_factor, 1.0);
    assert!(response.template_error.iter().all(|error| *error < 0.005));
}

#[test]
fn too_few_single_echoes_leave_the_gaussian() {
    let waveforms = waveforms(240);
    let settings = CalibrationSettings::echoes(1.0, 255.0);
    let gaussian = calibrate(blocks(&waveforms), &settings).unwrap();
    let found = calibrate_response(blocks(&waveforms).take(140), &gaussian, &settings).unwrap();
    assert_eq!(found.model, gaussian);
    assert!((100..150).contains(&found.usable_echoes), "{}", found.usable_echoes);
}

/// Sixteen recordings of one receiver: widths and values at two times scatter as their reported
/// SDs.
#[test]
fn responses_of_repeated_recordings_spread_as_they_say() {
    let mut random = Random::new(21);
    let (mut widths, mut values, mut reported) =
        (Vec::new(), [Vec::new(), Vec::new()], [Vec::new(), Vec::new()]);
    for _ in 0..16 {
        let waveforms = waveforms_of(&mut random, 400);
        let settings = CalibrationSettings::echoes(1.0, 255.0);
        let gaussian = calibrate(blocks(&waveforms), &settings).unwrap();
        let model = calibrate_response(blocks(&waveforms), &gaussian, &settings).unwrap().model;
        let response = model.response.as_ref().unwrap();
        widths.push(model.pulse_fwhm_ns);
        for (values, time) in values.iter_mut().zip([-3, 6]) {
            let at = (time - response.first_sample) as usize * STEPS_PER_SAMPLE;
            values.push(response.nodes[0].values[at]);
        }
        reported[0].push(model.uncertainty.pulse_fwhm_ns);
        reported[1].push(response.shape_sd);
    }
    let [width_sd, shape_sd] = reported.each_ref().map(|reported| moments(reported).0);
    let spreads = values.each_ref().map(|values| moments(values).1);
    println!(
        "width {:.5}, reported {width_sd:.5}; values {spreads:.5?}, reported {shape_sd:.5}",
        moments(&widths).1
    );
    // The relative uncertainty of an SD of sixteen values is 18 %.
    assert!((0.5..1.6).contains(&(moments(&widths).1 / width_sd)));
    // The uncertainty of single values on the flanks differs from the average.
    assert!(spreads.iter().all(|spread| (0.25..4.0).contains(&(spread / shape_sd))));
}

/// A digitiser that stretches echoes above 120 DN makes them narrower than the pulse that caused them.
#[test]
fn a_response_narrower_than_the_outgoing_pulse_is_not_used() {
    let stretched = |dn: u16| if dn > 120 { 120 + 3 * (dn - 120) } else { dn };
    let settings = CalibrationSettings::echoes(1.0, 1000.0);
    let mut random = Random::new(12);
    let high = waveforms_of(&mut random, 500);
    let high: Vec<Vec<u16>> = high.iter().map(|of| of.iter().map(|&dn| stretched(dn)).collect()).collect();
    let low: Vec<Vec<u16>> = waveforms_of(&mut random, 900)
        .into_iter()
        .filter(|of| of.iter().all(|&dn| dn <= 120))
        .chain(
            waveforms_of(&mut random, 300).into_iter().map(|of| of.iter().map(|&dn| dn.min(120)).collect()),
        )
        .filter(|of: &Vec<u16>| of.iter().filter(|&&dn| dn == 120).count() < 2)
        .collect();
    let calibrated = |recorded: &[Vec<u16>]| {
        let gaussian = calibrate(blocks(recorded), &settings).unwrap();
        calibrate_response(blocks(recorded), &gaussian, &settings).unwrap()
    };
    let outgoing = calibrated(&low).model;
    let own = calibrated(&high);
    println!("outgoing {:.2} ns, echoes {:.2} ns", outgoing.pulse_fwhm_ns, own.model.pulse_fwhm_ns);
    assert!(is_too_narrow(&own.model, &outgoing) && !is_too_narrow(&outgoing, &outgoing));
    // Echoes as low as the outgoing pulses are not distorted.
    let limit_dn = comparable_height_dn(blocks(&low), &outgoing).unwrap();
    assert!((110.0..135.0).contains(&limit_dn), "{limit_dn}");
    let mixed = [low.as_slice(), high.as_slice()].concat();
    let mut start = calibrated(&mixed).model;
    (start.limits.overdriven_dn, start.pulse_fwhm_ns) = (Some(limit_dn), outgoing.pulse_fwhm_ns);
    let lower = calibrate_response(blocks(&mixed), &start, &settings).unwrap().model;
    assert!(lower.response.is_some() && !is_too_narrow(&lower, &outgoing), "{}", lower.pulse_fwhm_ns);
    // Without them, the outgoing pulse is the response, however small its residual.
    let chosen = with_outgoing_pulse(blocks(&high), &own, &outgoing, &settings).unwrap();
    assert_eq!(chosen.model.provenance.response, ResponseSource::OutgoingPulse);
    assert!((chosen.model.pulse_fwhm_ns / outgoing.pulse_fwhm_ns - 1.0).abs() < 1e-9);
}

/// A response without its after-pulse, which is 4 % of the peak 11 samples later.
#[test]
fn a_missing_after_pulse_is_found_on_the_waveforms() {
    let waveforms = waveforms(600);
    let settings = CalibrationSettings::echoes(1.0, 255.0);
    let gaussian = calibrate(blocks(&waveforms), &settings).unwrap();
    let complete = calibrate_response(blocks(&waveforms), &gaussian, &settings).unwrap().model;
    let recorded: Vec<Waveform> = blocks(&waveforms).collect();
    let measured = |change: fn(&mut SystemResponse)| {
        let mut model = complete.clone();
        model.response.as_mut().map(change);
        all_waveforms::measure_error(&recorded, &mut model, &settings).unwrap();
        model.response.unwrap()
    };
    let right = measured(|_| {});
    let without = measured(|response| {
        let from = (8 - response.first_sample) as usize * STEPS_PER_SAMPLE;
        response.nodes.iter_mut().for_each(|node| node.values[from..].fill(0.0));
    });
    let greatest = |response: &SystemResponse| {
        (9..14).map(|lag| response.template_error_at(f64::from(lag))).fold(0.0, f64::max)
    };
    println!("right {:.4}, without after-pulse {:.4}", greatest(&right), greatest(&without));
    assert!(greatest(&right) < 0.01);
    assert!((0.02..0.06).contains(&greatest(&without)));
}

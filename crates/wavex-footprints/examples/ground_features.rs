//! Prints features and choice of the ground of shots, for `tests/python/fit_ground.py`.
//!
//! Standard input has the shots of one beam: numbers of outgoing and received samples (`u32`), and the samples (`f32`), all
//! little-endian. Each line has position, features, SD, probability, total SD, position, SD and probability of the second candidate,
//! and deviation; without ground they are NaN.
#![allow(
    clippy::print_stdout,
    clippy::unwrap_used,
    reason = "an example prints its figures and panics on failure"
)]

use std::io::{Read, stdin};

use wavex_footprints::{
    FootprintEstimator, FootprintLearner, FootprintSettings, Measured, WithSd, outgoing_fwhm_samples,
};

/// Shots from which noise and response are learnt.
const LEARNT: usize = 1000;

fn main() {
    let mut bytes = Vec::new();
    stdin().read_to_end(&mut bytes).unwrap();
    let words: Vec<[u8; 4]> = bytes.as_chunks().0.to_vec();
    let mut rest = words.as_slice();
    let mut shots = Vec::new();
    while let [outgoing, received, samples @ ..] = rest {
        let (outgoing, samples) = samples.split_at(u32::from_le_bytes(*outgoing) as usize);
        let (received, samples) = samples.split_at(u32::from_le_bytes(*received) as usize);
        let floats =
            |words: &[[u8; 4]]| words.iter().map(|word| f32::from_le_bytes(*word)).collect::<Vec<_>>();
        shots.push([floats(outgoing), floats(received)]);
        rest = samples;
    }
    let width = outgoing_fwhm_samples(&shots[0][0]).unwrap();
    let mut learner = FootprintLearner::new(1.0, width);
    for [outgoing, received] in shots.iter().take(LEARNT) {
        learner.add_outgoing(outgoing);
        learner.add_waveform(received);
    }
    let model = learner.finish().unwrap();
    let mut estimator = FootprintEstimator::new(&model, FootprintSettings::default());
    for [_, received] in &shots {
        let line = estimator.measure(received, None).map(|found| line(&found)).unwrap_or_default();
        let texts: Vec<String> = line.iter().map(f64::to_string).collect();
        println!("{}", texts.join(" "));
    }
}

fn line(found: &Measured) -> Vec<f64> {
    let ground = found.ground().map_or(WithSd::UNKNOWN, |mode| mode.position_samples);
    let second = found.second_ground.map_or([f64::NAN; 3], |second| {
        [second.position_samples.value, second.position_samples.sd, second.probability]
    });
    let mut line = vec![ground.value];
    line.extend(found.ground_features);
    line.extend([ground.sd, found.ground_probability, found.ground_total_sd_samples]);
    line.extend(second);
    line.push(found.deviation);
    line
}

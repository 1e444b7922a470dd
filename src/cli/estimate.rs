//! Expected time of a run for `wavex check`, from measured costs of its stages.
//!
//! docs/explanation/performance.md lists the assumptions and measurements.

use wavex_engine::job::{Job, JobStage};

/// Time of the program's start and of the files of a run, s.
const START_S: f64 = 0.2;
/// Time for each further input, s.
const INPUT_S: f64 = 0.02;
/// Time of `calibrate`, s, and per waveform that it learns from, µs.
const CALIBRATION_S: f64 = 0.5;
const LEARNING_US: f64 = 9.0;
/// Time of `correct` to learn the range walk, s.
const CORRECTION_S: f64 = 1.0;
/// Size of a shot to which the costs refer, bytes: a waveform of 60 to 120 samples, an outgoing pulse, the beam.
const SHOT_BYTES: f64 = 180.0;
/// Longest shots that are estimated, in usual ones: the costs are measured with shots of up to 1.5.
const LONGEST: f64 = 3.0;
/// Time of a stage per shot on one core, µs.
const STAGES_US: [(&str, f64); 18] = [
    ("read_las", 2.0),
    ("read_pulsewaves", 0.4),
    ("read_sdf", 1.0),
    ("read_arrow", 0.5),
    ("simulate", 3.0),
    ("resolve_mta", 1.0),
    ("fuse_channels", 0.3),
    ("correct", 0.3),
    ("filter_outliers", 0.3),
    ("georeference", 0.3),
    ("write_las", 0.5),
    ("write_ascii", 2.0),
    ("write_trajectory", 0.1),
    ("write_patches", 0.4),
    ("write_dem", 15.0),
    ("write_lstat", 0.1),
    ("write_table", 1.0),
    ("write_arrow", 1.5),
];
/// Time of `decompose` per shot on one core by its mode, µs.
const MODES_US: [(&str, f64); 4] =
    [("fastest", 2.3), ("fast_separated", 3.0), ("refined", 5.0), ("slow", 100.0)];
/// Stages that use several cores.
const PARALLEL: [&str; 6] = ["decompose", "correct", "georeference", "write_las", "write_dem", "simulate"];

/// Inputs of a run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Amount {
    /// Number of inputs.
    pub(super) inputs: usize,
    /// Their size, bytes.
    pub(super) bytes: u64,
    /// Their shots, if known.
    pub(super) shots: Option<u64>,
}

/// Expected time of a run, s; `None` for long shots, whose calibration and decomposition may take any time.
pub(super) fn seconds(job: &Job, amount: Amount, cores: usize) -> Option<f64> {
    let bytes = amount.bytes as f64;
    let shots = amount.shots.map_or(bytes / SHOT_BYTES, |shots| shots as f64);
    let size = (bytes / shots.max(1.0) / SHOT_BYTES).max(1.0);
    if size > LONGEST {
        return None;
    }
    let (mut sum_us, mut serial_us, mut learning_s) = (0.0, 0.0f64, 0.0);
    for stage in &job.stages {
        // Long waveforms have dozens of pulses, which this mode fits together.
        let power = if mode_of(stage) == Some("slow") { 4 } else { 1 };
        let us = size.powi(power) * us_per_shot(stage);
        sum_us += us;
        if !PARALLEL.contains(&stage.spec.name) {
            serial_us = serial_us.max(us);
        }
        if stage.spec.name == "calibrate" {
            learning_s += learning_s_of(stage, shots);
        } else if stage.spec.name == "correct" {
            learning_s += CORRECTION_S;
        }
    }
    let us = serial_us.max(sum_us / cores.max(1) as f64);
    Some(START_S + INPUT_S * amount.inputs as f64 + learning_s + 1e-6 * shots * us)
}

/// Time of a stage per shot of usual size on one core, µs.
fn us_per_shot(stage: &JobStage) -> f64 {
    let of =
        |table: &[(&str, f64)], name: &str| table.iter().find(|(known, _)| *known == name).map(|(_, us)| *us);
    match stage.spec.name {
        "decompose" => mode_of(stage).and_then(|mode| of(&MODES_US, mode)).unwrap_or(5.0),
        name => of(&STAGES_US, name).unwrap_or(0.1),
    }
}

/// Mode of `decompose`; `None` for other stages.
fn mode_of(stage: &JobStage) -> Option<&str> {
    stage.planned.resolved.get("mode").and_then(serde_json::Value::as_str)
}

/// Time in which `calibrate` learns from the first of these shots, s.
fn learning_s_of(stage: &JobStage, shots: f64) -> f64 {
    let key = |name: &str| stage.planned.resolved.get(name).filter(|value| !value.is_null());
    if key("load").is_some() || key("preset").is_some() {
        return 0.0;
    }
    let waveforms = key("waveforms").and_then(serde_json::Value::as_f64).unwrap_or(f64::INFINITY);
    CALIBRATION_S + 1e-6 * LEARNING_US * waveforms.min(shots)
}

/// Formats a time with the precision of an estimate: "about 2 s", "about 3 min".
pub(super) fn words(seconds: f64) -> String {
    let rounded = |value: f64, step: f64| ((value / step).round() * step).max(step);
    match seconds {
        s if s < 9.5 => format!("about {:.0} s", rounded(s, 1.0)),
        s if s < 57.5 => format!("about {:.0} s", rounded(s, 5.0)),
        s if s < 9.5 * 60.0 => format!("about {:.0} min", rounded(s / 60.0, 1.0)),
        s if s < 57.5 * 60.0 => format!("about {:.0} min", rounded(s / 60.0, 5.0)),
        s if s < 9.75 * 3600.0 => format!("about {} h", rounded(s / 3600.0, 0.5)),
        s => format!("about {:.0} h", rounded(s / 3600.0, 1.0)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use wavex_stages::registry::{STAGES, find};

    fn job(stages: &str) -> Job {
        Job::parse(
            STAGES,
            "a.toml",
            &format!("[[stage]]\ntype = 'read_arrow'\npath = 'a.arrow'\n{stages}"),
            &[],
        )
        .unwrap()
    }

    #[test]
    fn times_are_rounded_to_what_is_known() {
        let words = [0.1, 1.6, 9.4, 12.0, 57.0, 58.0, 100.0, 569.0, 571.0, 3400.0, 3500.0, 9000.0, 50_000.0]
            .map(words);
        let expected = [
            "1 s", "2 s", "9 s", "10 s", "55 s", "1 min", "2 min", "9 min", "10 min", "55 min", "1 h",
            "2.5 h", "14 h",
        ];
        assert_eq!(words, expected.map(|time| format!("about {time}")));
    }

    /// Times measured on two cores are within a factor of two.
    #[test]
    fn estimates_are_near_measured_times() {
        let chain = "[[stage]]\ntype = 'calibrate'\n[[stage]]\ntype = 'decompose'\nmode = 'MODE'\n\
                     [[stage]]\ntype = 'georeference'\n[[stage]]\ntype = 'write_las'\npath = '*.laz'\n";
        let amount = |shots: u64, bytes: u64| Amount { inputs: 1, bytes, shots: Some(shots) };
        for (mode, amount, cores, measured_s) in [
            ("refined", amount(400_000, 72_000_000), 1, 3.8),
            ("fastest", amount(400_000, 72_000_000), 1, 2.7),
            ("refined", amount(16_486, 3_534_810), 2, 1.27),
            ("slow", amount(22_472, 6_117_105), 2, 8.2),
        ] {
            let job = job(&chain.replace("MODE", mode));
            let estimate_s = seconds(&job, amount, cores).unwrap();
            let ratio = estimate_s / measured_s;
            assert!(
                (0.5..2.0).contains(&ratio),
                "{mode}, {amount:?}: {estimate_s:.1} s, measured {measured_s} s"
            );
        }
    }

    #[test]
    fn times_grow_with_the_amount_and_shrink_with_cores() {
        let amount = Amount { inputs: 1, bytes: 180_000_000_000, shots: None };
        let chain = job("[[stage]]\ntype = 'calibrate'\nload = 'm.json'\n[[stage]]\ntype = 'decompose'\n");
        let of = |amount, cores| seconds(&chain, amount, cores).unwrap();
        // 1e9 shots of 5.5 µs on one core.
        assert_eq!(words(of(amount, 1)), "about 1.5 h");
        assert_eq!(words(of(amount, 4)), "about 25 min");
        assert!(of(Amount { shots: Some(500_000_000), ..amount }, 4) > 0.9 * of(amount, 4), "long waveforms");
        // The reader is serial.
        let ten = Amount { bytes: amount.bytes / 100, ..amount };
        assert_eq!(words(of(ten, 1000)), "about 5 s");
    }

    /// As of LVIS: 500 shots of 432 samples.
    #[test]
    fn long_shots_are_not_estimated() {
        let chain = job("[[stage]]\ntype = 'calibrate'\n[[stage]]\ntype = 'decompose'\n");
        let amount = |shots| Amount { inputs: 1, bytes: 281_288, shots };
        assert_eq!(seconds(&chain, amount(Some(500)), 2), None);
        assert!(seconds(&chain, amount(None), 2).is_some(), "their length is not known");
    }

    #[test]
    fn stages_with_costs_exist() {
        let names = STAGES_US.iter().map(|(name, _)| *name).chain(PARALLEL);
        names.for_each(|name| assert!(find(name).is_some(), "{name}"));
    }
}

//! Footprints of made shots, through the stage.

use std::path::Path;

use super::*;
use wavex_footprints::RecordedNoise;
use wavex_line::scan_line::{Channel, Emission, FootprintRecord, Frame, footprint_flags};
use wavex_line::stage::Context;

/// Samples of a waveform, and the sample of its ground.
const SAMPLES: usize = 700;
const GROUND: f64 = 420.0;
/// SD of the outgoing pulse, samples.
const PULSE_SD: f64 = 6.6;
const LEVEL_DN: f64 = 220.0;

/// Noise of SD 1 that neighbours share, from a counter.
struct Noise(u32);

impl Noise {
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        f64::from(self.0 >> 8) / f64::from(1 << 24) - 0.5
    }

    fn samples(&mut self) -> Vec<f64> {
        let white: Vec<f64> = (0..SAMPLES + 8).map(|_| self.next()).collect();
        white.windows(9).map(|window| window.iter().sum::<f64>() / 3.0 * 12f64.sqrt()).collect()
    }
}

fn pulse(height_dn: f64, at: f64, k: usize) -> f64 {
    height_dn * (-0.5 * ((k as f64 - at) / PULSE_SD).powi(2)).exp()
}

/// A line of shots with ground and a layer 10 m above it, straight down from a height of 1 km.
fn line(input: &Arc<InputInfo>, number: u32, shots: u32, has_outgoing: bool) -> ScanLine {
    let (mut blocks, mut noise) = (Blocks::default(), Noise(number + 1));
    for shot in 0..shots {
        let outgoing: Vec<f32> = (0..128).map(|k| (200.0 + pulse(1000.0, 60.3, k)) as f32).collect();
        if has_outgoing {
            blocks.push_fractions(shot, Channel::Reference, 0.0, 1.0, &outgoing);
        }
        let echo = noise.samples().into_iter().enumerate().map(|(k, noise)| {
            (LEVEL_DN + 1.5 * noise + pulse(120.0, GROUND, k) + pulse(80.0, GROUND - 66.7, k)) as f32
        });
        blocks.push_fractions(shot, Channel::LowPower, 0.0, 1.0, &echo.collect::<Vec<_>>());
        blocks.footprints.push(FootprintRecord {
            emission: shot,
            shot_number: 19_000 + u64::from(shot),
            noise: Some(RecordedNoise { mean_dn: LEVEL_DN, sd_dn: 1.5 }),
            is_degraded: shot == 1,
            columns: Box::new([f64::from(shot)]),
        });
    }
    let emissions = (0..shots).map(|shot| Emission { shot: u64::from(shot), ..Emission::default() });
    ScanLine::of_shots(Arc::clone(input), number, emissions.collect(), blocks)
}

fn input(beam: &str) -> Arc<InputInfo> {
    Arc::new(InputInfo { frame: Frame::Map, beam: Some(beam.to_owned()), ..InputInfo::default() })
}

/// Runs the stage with this number of shots to learn from.
fn run(shots: u64, lines: Vec<ScanLine>) -> (Result<()>, Vec<ScanLine>, Context) {
    run_stage(Measurer::new(MeasureFootprints { shots, ..MeasureFootprints::default() }), lines)
}

fn run_stage(mut stage: Measurer, lines: Vec<ScanLine>) -> (Result<()>, Vec<ScanLine>, Context) {
    let (mut cx, mut given) = (Context::default(), Vec::new());
    let mut emit = |line: ScanLine| {
        given.push(line);
        Ok(())
    };
    let mut out = Output::new(&mut cx, usize::MAX, &mut emit);
    let outcome = lines.into_iter().try_for_each(|line| stage.process(line, &mut out));
    let outcome = outcome.and_then(|()| stage.finish(&mut out));
    (outcome, given, cx)
}

#[test]
fn the_ground_is_the_lowest_mode_and_heights_count_from_it() {
    let (outcome, given, _) = run(100, vec![line(&input("BEAM0101"), 0, 40, true)]);
    outcome.unwrap();
    let [line] = given.as_slice() else { panic!("{} lines", given.len()) };
    assert_eq!((line.footprints.len(), line.kind()), (40, Kind::Returns));
    let m_per_sample = 0.5e-9 * line.input.group_velocity_mps;
    for footprint in &line.footprints {
        let error_m = footprint.ground_range_m.value - m_per_sample * GROUND;
        assert!(error_m.abs() < 0.15 && footprint.ground_range_m.sd > 0.0, "{footprint:?}");
        assert!(footprint.modes == 2 && footprint.ground_probability > 0.5, "{footprint:?}");
        let [low_m, middle_m, high_m] = [25, 50, 90].map(|percent| footprint.heights_m[percent]);
        assert!(
            low_m.abs() < 1.0 && (0.0..9.0).contains(&middle_m) && (8.0..13.0).contains(&high_m),
            "{footprint:?}"
        );
        assert!(footprint.heights_m.is_sorted(), "{footprint:?}");
        assert!((footprint.cover.value - 0.31).abs() < 0.08, "{footprint:?}");
    }
    let returns = line.returns().unwrap();
    let classes: Vec<u8> = returns.iter().take(2).map(|found| found.class).collect();
    assert_eq!((returns.len(), classes), (80, vec![0, 2]));
}

#[test]
fn what_the_recording_says_of_a_shot_is_kept() {
    let (outcome, given, _) = run(100, vec![line(&input("BEAM0101"), 0, 20, true)]);
    outcome.unwrap();
    let [first, second, ..] = given[0].footprints.as_slice() else { panic!("no shots") };
    assert_eq!((first.shot_number, second.shot_number), (19_000, 19_001));
    let degraded = [first, second].map(|footprint| footprint.flags & footprint_flags::DEGRADED);
    assert_eq!(degraded, [0, footprint_flags::DEGRADED]);
    assert_eq!((&*first.columns, &*second.columns), (&[0.0][..], &[1.0][..]));
}

/// Each beam has a model of its own; lines keep their order.
#[test]
fn beams_are_learnt_one_after_the_other() {
    let beams = [input("BEAM0001"), input("BEAM0101")];
    let lines = (0..6).map(|number| line(&beams[number as usize / 3], number, 20, true)).collect();
    let (outcome, given, cx) = run(30, lines);
    outcome.unwrap();
    let numbers: Vec<u32> = given.iter().map(|line| line.line).collect();
    assert_eq!(numbers, [0, 1, 2, 3, 4, 5]);
    let learnt: Vec<&str> = cx.counters().findings.iter().map(|note| &note[..8]).collect();
    assert_eq!(learnt, ["BEAM0001", "BEAM0101"]);
}

/// A beam from which nothing can be learnt leaves the others; without any other it is an error.
#[test]
fn a_short_beam_is_counted() {
    let [short, long] = [input("BEAM0001"), input("BEAM0101")];
    let (outcome, given, cx) = run(100, vec![line(&short, 0, 5, true), line(&long, 1, 20, true)]);
    outcome.unwrap();
    let measured: Vec<usize> = given.iter().map(|line| line.footprints.len()).collect();
    assert_eq!((measured, cx.counters().rejected_of(Reason::BeamNotLearnt.item())), (vec![0, 20], 5));
    let note = &cx.counters().notes[0];
    assert!(
        note.starts_with("BEAM0001 is not measured: 5 shots have a recorded outgoing pulse, and 10"),
        "{note}"
    );
    let (outcome, ..) = run(100, vec![line(&short, 0, 5, true)]);
    assert!(outcome.unwrap_err().to_string().contains("and 10 are needed"));
}

/// A shot with echoes of these heights and positions, among sound shots; samples of 340 DN are clipped.
fn shot_of(echoes: &[[f64; 2]]) -> Footprint {
    let input = Arc::new(InputInfo { full_scale_dn: Some(340), ..InputInfo::clone(&input("BEAM0101")) });
    let mut line = line(&input, 0, 20, true);
    let Content::Shots(blocks) = &mut line.content else { panic!("no blocks") };
    let samples = Noise(99).samples().into_iter().enumerate().map(|(k, noise)| {
        let signal: f64 = echoes.iter().map(|[height_dn, at]| pulse(*height_dn, *at, k)).sum();
        (LEVEL_DN + 1.5 * noise + signal).min(340.0) as f32
    });
    // A longer block takes the place of the last shot's own.
    let samples: Vec<f32> = samples.chain([LEVEL_DN as f32; 1]).collect();
    blocks.push_fractions(19, Channel::LowPower, 0.0, 1.0, &samples);
    let (outcome, given, _) = run(100, vec![line]);
    outcome.unwrap();
    given[0].footprints[19].clone()
}

fn flags_of(echoes: &[[f64; 2]]) -> u8 {
    shot_of(echoes).flags
}

#[test]
fn a_ground_that_merges_with_a_layer_is_the_second_candidate() {
    let hidden = shot_of(&[[60.0, 380.0], [50.0, 388.0], [30.0, 400.0]]);
    let height_m = hidden.second_ground_height_m;
    assert!((-6.0..-0.3).contains(&height_m.value) && height_m.sd > 0.1, "{hidden:?}");
    let sum = hidden.ground_probability + hidden.second_ground_probability;
    assert!(hidden.second_ground_probability > 0.05 && sum <= 1.0, "{hidden:?}");
    assert!(hidden.ground_total_sd_m > hidden.ground_range_m.sd, "{hidden:?}");
    let clear = shot_of(&[[60.0, 300.0], [100.0, 400.0]]);
    assert!(
        clear.second_ground_probability.is_nan() && clear.second_ground_height_m.value.is_nan(),
        "{clear:?}"
    );
    assert!(clear.deviation.abs() < 5.0, "{clear:?}");
    assert!(shot_of(&[[150.0, 400.0]]).deviation > 5.0, "clipped");
}

#[test]
fn each_flag_says_what_is_wrong() {
    use footprint_flags::{AMBIGUOUS, CLIPPED, GROUND_MISSING, TOP_MISSING};
    assert_eq!(flags_of(&[]) & GROUND_MISSING, GROUND_MISSING, "no signal");
    assert_eq!(flags_of(&[[90.0, 400.0], [90.0, 699.0]]) & GROUND_MISSING, GROUND_MISSING, "cut at the end");
    assert_eq!(flags_of(&[[90.0, 1.0], [90.0, 400.0]]) & (TOP_MISSING | GROUND_MISSING), TOP_MISSING);
    assert_eq!(flags_of(&[[150.0, 400.0]]) & CLIPPED, CLIPPED);
    // Layers 1.3 m apart merge into a broad mode, below which any ground may be hidden.
    let merged: Vec<[f64; 2]> = (0..6).map(|layer| [30.0, 400.0 - 9.0 * f64::from(layer)]).collect();
    assert_eq!(flags_of(&merged) & AMBIGUOUS, AMBIGUOUS);
    assert_eq!(flags_of(&[[60.0, 300.0], [100.0, 400.0]]), 0, "a narrow ground below a canopy");
}

#[test]
fn without_outgoing_pulses_the_narrowest_echoes_are_the_response() {
    let (outcome, given, cx) = run(100, vec![line(&input("BEAM0101"), 0, 40, false)]);
    outcome.unwrap();
    let m_per_sample = 0.5e-9 * given[0].input.group_velocity_mps;
    for footprint in &given[0].footprints {
        let error_m = footprint.ground_range_m.value - m_per_sample * GROUND;
        assert!(error_m.abs() < 0.15 && footprint.modes == 2, "{footprint:?}");
    }
    let [warning] = cx.counters().notes.as_slice() else { panic!("{:?}", cx.counters()) };
    let expected = "BEAM0101: no outgoing pulses are recorded: the response is the mean of the 10 narrowest of 40 echoes, ";
    assert!(warning.starts_with(expected), "{warning}");
}

#[test]
fn few_shots_without_outgoing_pulses_have_no_response() {
    let (outcome, ..) = run(100, vec![line(&input("BEAM0101"), 0, 9, false)]);
    let error = outcome.unwrap_err().to_string();
    assert!(error.contains("0 shots have a recorded outgoing pulse"), "{error}");
}

#[test]
fn a_waveform_without_background_is_rejected() {
    let mut line = line(&input("BEAM0101"), 0, 20, true);
    let Content::Shots(blocks) = &mut line.content else { panic!("no blocks") };
    blocks.push_fractions(19, Channel::LowPower, 0.0, 1.0, &[f32::NAN; SAMPLES + 1]);
    let (outcome, given, cx) = run(100, vec![line]);
    outcome.unwrap();
    assert_eq!(
        (given[0].footprints.len(), cx.counters().rejected_of(Reason::WithoutBackground.item())),
        (19, 1)
    );
}

#[test]
fn lines_without_shots_pass_through() {
    let empty = || ScanLine::of_shots(input("BEAM0101"), 0, Vec::new(), Blocks::default());
    let (outcome, given, _) = run(100, vec![empty(), empty()]);
    outcome.unwrap();
    assert!(given.len() == 2 && given.iter().all(|line| line.kind() == Kind::Returns));
}

/// Saves the models of two beams; returns the measured lines and the path of the file.
fn saved(folder: &Path) -> (Vec<ScanLine>, PathBuf) {
    let path = folder.join("model.json");
    let config = MeasureFootprints { shots: 100, ..MeasureFootprints::default() };
    let save = Some(OutputFile::create(&path).unwrap());
    let (outcome, given, mut cx) = run_stage(Measurer { save, ..Measurer::new(config) }, two_beams());
    outcome.unwrap();
    cx.take_files().into_iter().for_each(|file| drop(file.publish().unwrap()));
    (given, path)
}

fn two_beams() -> Vec<ScanLine> {
    let [first, second] = [input("BEAM0001"), input("BEAM0101")];
    vec![line(&first, 0, 30, true), line(&second, 1, 20, true), line(&second, 2, 20, false)]
}

/// The stage with the models of a file.
fn with_models(path: &Path) -> Measurer {
    let loaded = LoadedModels::read(path.to_owned()).unwrap();
    Measurer { loaded: Some(loaded), ..Measurer::new(MeasureFootprints::default()) }
}

#[test]
fn saved_models_give_the_same_results() {
    let folder = tempfile::tempdir().unwrap();
    let (learnt, path) = saved(folder.path());
    let (outcome, loaded, cx) = run_stage(with_models(&path), two_beams());
    outcome.unwrap();
    let results = |lines: &[ScanLine]| -> Vec<String> {
        lines.iter().map(|line| format!("{:?} {:?}", line.footprints, line.returns())).collect()
    };
    assert!(results(&learnt) == results(&loaded), "results differ");
    let notes: Vec<&str> = cx.counters().findings.iter().map(|note| &note[..41]).collect();
    let expected = ["BEAM0001", "BEAM0101"].map(|beam| format!("{beam}: loaded model: outgoing pulse of"));
    assert_eq!(notes, expected);
    // Five shots are too few to learn from.
    let (outcome, few, _) = run_stage(with_models(&path), vec![line(&input("BEAM0101"), 0, 5, true)]);
    outcome.unwrap();
    assert_eq!(few[0].footprints.len(), 5);
}

#[test]
fn a_beam_without_a_loaded_model_is_counted() {
    let folder = tempfile::tempdir().unwrap();
    let (_, path) = saved(folder.path());
    let other = || line(&input("BEAM0110"), 0, 20, true);
    let lines = vec![other(), line(&input("BEAM0101"), 1, 20, true)];
    let (outcome, given, cx) = run_stage(with_models(&path), lines);
    outcome.unwrap();
    let measured: Vec<usize> = given.iter().map(|line| line.footprints.len()).collect();
    assert_eq!((measured, cx.counters().rejected_of(Reason::BeamNotLearnt.item())), (vec![0, 20], 20));
    let problem = "model.json: `beams` has no model of BEAM0110, only of BEAM0001, BEAM0101; load a model of this \
                   instrument and setting, or learn from the recording";
    let note = &cx.counters().notes[0];
    assert!(note.starts_with("BEAM0110 is not measured: ") && note.ends_with(problem), "{note}");
    let (outcome, ..) = run_stage(with_models(&path), vec![other()]);
    assert!(outcome.unwrap_err().to_string().ends_with(problem));
    // A recording without beams has one model.
    let nameless = Arc::new(InputInfo { beam: None, ..InputInfo::clone(&input("")) });
    let (outcome, ..) = run_stage(with_models(&path), vec![line(&nameless, 0, 20, true)]);
    let error = outcome.unwrap_err().to_string();
    assert!(error.contains("no model of a recording without beams, only of BEAM0001"), "{error}");
}

#[test]
fn models_of_another_receiver_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let (_, path) = saved(folder.path());
    let text = std::fs::read_to_string(&path).unwrap();
    let error = |from: &str, to: &str| {
        assert!(text.contains(from), "{from}");
        std::fs::write(&path, text.replace(from, to)).unwrap();
        run_stage(with_models(&path), two_beams()).0.unwrap_err().to_string()
    };
    let found = error("\"sampling_interval_ns\": 1.0", "\"sampling_interval_ns\": 0.5");
    let problem = "model.json: the model of BEAM0001: its `sampling_interval_ns` is 0.5, but that of the recording is 1; \
                   load a model of this instrument and setting, or learn from the recording";
    assert!(found.ends_with(problem), "{found}");
    let found = error("128", "100");
    let problem = "its `outgoing_samples` are 100 to 100, but those of the recording 128 to 128; ";
    assert!(found.contains(problem), "{found}");
}

#[test]
fn shots_to_learn_from_have_no_effect_on_a_loaded_model() {
    let folder = tempfile::tempdir().unwrap();
    let (_, path) = saved(folder.path());
    let notes = |shots| {
        let mut stage = with_models(&path);
        stage.config.shots = shots;
        run_stage(stage, two_beams()).2.counters().notes.clone()
    };
    assert_eq!(notes(1000), Vec::<String>::new());
    let expected =
        "`shots` of measure_footprints has no effect with `load`: remove it, or learn from the recording";
    assert_eq!(notes(2000), [expected]);
}

/// Without noise the correlation of the noise is not a number.
#[test]
fn models_that_cannot_be_loaded_are_not_saved() {
    let folder = tempfile::tempdir().unwrap();
    let config = MeasureFootprints { shots: 100, ..MeasureFootprints::default() };
    let save = Some(OutputFile::create(&folder.path().join("other.json")).unwrap());
    let mut stage = Measurer { save, ..Measurer::new(config) };
    let (_, path) = saved(folder.path());
    stage.models = LoadedModels::read(path).unwrap().models;
    stage.models.beams[0].model.noise_sd_dn = f64::NAN;
    let (outcome, ..) = run_stage(stage, Vec::new());
    let error = outcome.unwrap_err().to_string();
    let problem = "the model of BEAM0001: `noise_sd_dn` must be from 0 to 1000000, got NaN; leave out `save`, or learn from \
                   another part of the recording";
    assert!(error.ends_with(problem), "{error}");
}

//! Table of sabotage: each diagnostic is broken, and the run must say so.
//!
//! Recordings of three simulated instruments are run with sensor models or samples that were changed.
//! A change is noticed if a warning of the run names its area. With the right model no such warning
//! may appear. `cargo test --test sabotage -- --nocapture` runs one recording of the first instrument
//! and prints the table; `WAVEX_SABOTAGE=100` runs a hundred of each (`just sabotage`), and
//! `WAVEX_SABOTAGE_INSTRUMENT=Riegl` selects instruments by the start of their name,
//! `WAVEX_SABOTAGE_CHANGE=none` changes by a part of theirs.
//! docs/explanation/sabotage.md has the results.
#![allow(
    clippy::expect_used,
    clippy::panic,
    clippy::print_stdout,
    clippy::unwrap_used,
    reason = "a test fails by panicking, and prints its table"
)]

mod changes;
mod instruments;
mod runs;

use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

use changes::{Change, changes};
use instruments::{Instrument, Kind, Recording, Timing};
use runs::{Case, returns, run_job, saved_model, start_ns, summary, warnings};
use wavex_formats::container::EmissionReference;

/// Smallest fraction of noticed changes, and largest fraction of false alarms.
const NOTICED: f64 = 0.95;
const FALSE_ALARMS: f64 = 0.01;

/// Row of the table: by instrument, noticed and all cases.
#[derive(Clone, Default)]
struct Row([[usize; 2]; 3]);

impl Row {
    fn sum(&self) -> [usize; 2] {
        self.0.iter().fold([0, 0], |sum, cell| [sum[0] + cell[0], sum[1] + cell[1]])
    }
}

/// Cases of one recording: index of the row, and whether a warning was given.
fn recording_cases(kind: Kind, seed: u64, changes: &[Change]) -> Vec<(usize, bool, Vec<String>)> {
    let place = tempfile::tempdir().unwrap();
    let model = saved_model(Instrument::new(kind, 2 * seed), place.path());
    let other = saved_model(Instrument::new(kind.other(), 2 * seed), place.path());
    let recording = Instrument::new(kind, 2 * seed + 1).record();
    let mut results = Vec::new();
    for (row, change) in changes.iter().enumerate() {
        let case = change.apply(&model, &other, &recording);
        let start = std::time::Instant::now();
        let said = warnings(&case, place.path());
        if std::env::var_os("WAVEX_SABOTAGE_TIMES").is_some() {
            println!("{kind:?} {}: {:.2} s", change.name, start.elapsed().as_secs_f64());
        }
        let is_said = match change.areas.is_empty() {
            true => changes::is_alarm(&said),
            false => said.iter().any(|text| change.areas.iter().any(|area| text.contains(area))),
        };
        results.push((row, is_said, said));
    }
    results
}

#[test]
fn sabotage_is_noticed() {
    let asked: Option<u64> = std::env::var("WAVEX_SABOTAGE").ok().map(|text| text.parse().unwrap());
    let of_kind = std::env::var("WAVEX_SABOTAGE_INSTRUMENT").unwrap_or_default();
    let kinds = if asked.is_some() { &Kind::ALL[..] } else { &Kind::ALL[..1] };
    let kinds: Vec<Kind> =
        kinds.iter().filter(|kind| format!("{kind:?}").starts_with(&of_kind)).copied().collect();
    let name = std::env::var("WAVEX_SABOTAGE_CHANGE").unwrap_or_default();
    let changes: Vec<Change> = changes().into_iter().filter(|change| change.name.contains(&name)).collect();
    let tasks: Vec<(Kind, u64)> =
        (1..=asked.unwrap_or(1)).flat_map(|seed| kinds.iter().map(move |kind| (*kind, seed))).collect();
    assert!(!tasks.is_empty() && !changes.is_empty(), "no case has these names");
    let (next, rows) = (AtomicUsize::new(0), Mutex::new(vec![Row::default(); changes.len()]));
    let work = || {
        while let Some(&(kind, seed)) = tasks.get(next.fetch_add(1, Ordering::Relaxed)) {
            for (row, is_said, said) in recording_cases(kind, seed, &changes) {
                let cell = &mut rows.lock().unwrap()[row].0[kind as usize];
                cell[1] += 1;
                cell[0] += usize::from(is_said);
                if is_said == changes[row].areas.is_empty() {
                    println!("{:?} {seed}, {}: {said:#?}", kind, changes[row].name);
                }
            }
        }
    };
    std::thread::scope(|scope| (0..2).for_each(|_| drop(scope.spawn(work))));
    let rows = rows.into_inner().unwrap();
    print_table(&changes, &rows);
    for (change, row) in changes.iter().zip(&rows) {
        let [said, all] = row.sum();
        let share = said as f64 / all as f64;
        let is_kept = match change.areas.is_empty() {
            true => share <= FALSE_ALARMS,
            false => share >= NOTICED,
        };
        assert!(is_kept, "{}: {said} of {all}", change.name);
    }
}

/// Last returns over closed canopy are echoes, although the response differs from shot to shot.
#[test]
fn last_returns_are_the_ground() {
    const METRE_NS: f64 = 6.67;
    const WIDTH_NS: f64 = 14.0;
    let place = tempfile::tempdir().unwrap();
    let timing = Timing { emission_reference: EmissionReference::OutgoingPulse, late_samples: 0.0 };
    let recording = Recording { timing: Some(timing), ..Instrument::forest(3).record() };
    let returns = returns(&recording, place.path());
    let (mut last_behind, mut strong, mut strong_found) = (0, 0, 0);
    for (number, shot) in recording.lines.iter().flatten().enumerate() {
        let of_shot: Vec<f64> =
            returns.iter().filter(|(of, _)| *of == number).map(|(_, flight_ns)| *flight_ns).collect();
        let ground_ns = |position: f64| start_ns(number as u64, shot) + position;
        let last = shot.echoes.iter().map(|[_, position, _]| ground_ns(*position)).fold(0.0, f64::max);
        last_behind += usize::from(of_shot.iter().any(|ns| *ns > last + METRE_NS));
        // The ground is the first echo of the list, at least 20 noise SDs high.
        if shot.echoes.iter().all(|[height, ..]| *height <= shot.echoes[0][0]) {
            strong += 1;
            strong_found += usize::from(of_shot.iter().any(|ns| (ns - last).abs() < 0.75 * WIDTH_NS));
        }
    }
    let shots = recording.shots();
    println!(
        "{shots} shots: {last_behind} last returns behind the ground; {strong_found} of {strong} strongest grounds"
    );
    assert!(last_behind as f64 <= 0.02 * shots as f64, "{last_behind} of {shots}");
    assert!(strong_found as f64 >= 0.985 * strong as f64, "{strong_found} of {strong}");
}

/// A given model is completed by clipped echoes, of which its own recording had none.
#[test]
fn flanks_of_clipped_echoes_prove_a_linear_receiver() {
    let place = tempfile::tempdir().unwrap();
    let instrument = |seed| Instrument::new(Kind::Riegl, seed);
    let model = saved_model(instrument(1).stable(190.0, 1.0), place.path());
    assert!(!model.low_power.as_ref().unwrap().limits.is_linear);
    let is_said = |highest_dn: f64, compression: f64| {
        let recording = instrument(2).stable(highest_dn, compression).record();
        let stages = summary(&Case { model: Some(model.clone()), recording }, place.path()).stages;
        stages
            .iter()
            .flat_map(|stage| &stage.findings)
            .any(|text| text.contains("as its strongest echoes show"))
    };
    assert!(is_said(700.0, 1.0));
    assert!(!is_said(700.0, 0.5), "a receiver that compresses strong echoes");
    assert!(!is_said(190.0, 1.0), "no strong echoes");
}

/// The rule for silent blocks follows the model in use, whose background is free after the first lines.
#[test]
fn blocks_without_echo_are_kept_once_the_background_is_free() {
    let place = tempfile::tempdir().unwrap();
    let mut model = saved_model(Instrument::new(Kind::Riegl, 1), place.path());
    model.low_power.as_mut().unwrap().background_dn.iter_mut().for_each(|level_dn| *level_dn += 30.0);
    let mut recording = Instrument::new(Kind::Riegl, 2).record();
    recording.lines.extend(recording.lines.clone());
    let level_dn = recording.background_dn as u16;
    let is_flat = |number: usize| number.is_multiple_of(3);
    let recording = recording.changed(|number, samples| {
        if is_flat(number) {
            (0..).zip(samples).for_each(|(k, dn)| *dn = level_dn + (number + k * k) as u16 % 3);
        }
    });
    let held = (0..recording.shots() / 2).filter(|number| is_flat(*number)).count() as u64;
    let stages = summary(&Case { model: Some(model), recording }, place.path()).stages;
    let rejected = stages.iter().flat_map(|stage| &stage.rejected);
    let away: u64 =
        rejected.filter(|(what, _)| what.contains("far from the background")).map(|(_, n)| n).sum();
    assert_eq!(away, held);
}

#[test]
fn a_dead_receiver_has_no_returns() {
    let place = tempfile::tempdir().unwrap();
    let good = Instrument::new(Kind::Riegl, 1).record();
    let np_and_constant = |dead_from: usize, calibrate: &str| {
        let recording = good.changed(|number, samples| {
            if number >= dead_from {
                samples.fill(77);
            }
        });
        let summary = run_job(&recording, calibrate, place.path());
        let rejected = summary.stages.iter().flat_map(|stage| &stage.rejected);
        let constant =
            rejected.filter(|(what, _)| what.contains("all samples are equal")).map(|(_, n)| n).sum();
        (summary.totals["np"], constant)
    };
    assert_eq!(np_and_constant(0, "preset = 'riegl_lms_q680i'"), (0, good.shots() as u64));
    let (before, _) = np_and_constant(good.shots(), "waveforms = 500");
    let (half, constant): (u64, u64) = np_and_constant(good.shots() / 2, "waveforms = 500");
    assert_eq!(constant, good.shots() as u64 / 2);
    assert!((0.4..0.6).contains(&(half as f64 / before as f64)), "{half} of {before}");
}

fn print_table(changes: &[Change], rows: &[Row]) {
    println!("| change | noticed by | RIEGL-like | Leica-like | large footprint |");
    println!("|---|---|---:|---:|---:|");
    for (change, row) in changes.iter().zip(rows) {
        let cell =
            |[said, all]: [usize; 2]| if all == 0 { "-".to_owned() } else { format!("{said} / {all}") };
        let cells: Vec<String> = row.0.iter().map(|counts| cell(*counts)).collect();
        let areas = if change.areas.is_empty() { "nothing".to_owned() } else { change.areas.join("; ") };
        println!("| {} | {areas} | {} |", change.name, cells.join(" | "));
    }
}

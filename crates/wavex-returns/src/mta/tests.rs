use proptest::prelude::*;

use super::*;

mod lines;
mod sweeps;

use wavex_simulation::mta_scenes::{
    EchoScene, METRES_PER_NS, RecordedLine, RecordingSettings, SCENES, TargetClass,
};

const INTERVAL_PS: i64 = 2_500_000;
const LINE_PS: i64 = 1_000_000_000;

/// Pseudo-random numbers in [0, 1) from a key.
fn random(key: u64) -> f64 {
    let z = key.wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ 0x5851_f42d_4c95_7f2d;
    let z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
}

/// Lines with pauses, one echo per shot at `range_m(line, shot)`, emission times displaced by up to
/// half of `modulation_ns`; and the emission that caused each echo.
fn strip(
    lines: usize,
    shots: usize,
    modulation_ns: f64,
    range_m: impl Fn(usize, usize) -> f64,
) -> (Vec<Line>, Vec<Vec<u32>>) {
    let clock = |line: usize, shot: usize| {
        let displaced_ps = (random((line * shots + shot) as u64) - 0.5) * modulation_ns * 1e3;
        line as i64 * LINE_PS + shot as i64 * INTERVAL_PS + displaced_ps as i64
    };
    let mut causes = Vec::new();
    let made = (0..lines).map(|line| {
        let clocks: Vec<i64> = (0..shots).map(|shot| clock(line, shot)).collect();
        let mut echoes: Vec<(i64, u32)> = (0..shots)
            .map(|shot| (clocks[shot] + (range_m(line, shot) / METRES_PER_NS * 1e3) as i64, shot as u32))
            .collect();
        echoes.sort();
        causes.push(echoes.iter().map(|echo| echo.1).collect());
        let echo = |&(time_ps, _): &(i64, u32)| {
            let emission = clocks.partition_point(|&clock| clock <= time_ps) - 1;
            Echo { emission: emission as u32, time_ns: (time_ps - clocks[emission]) as f64 * 1e-3 }
        };
        let emission = |(shot, &clock_ps): (usize, &i64)| Emission {
            clock_ps,
            shot: (line * shots + shot) as u64,
            cos_nadir: 1.0,
            prior_range_m: range_m(line, shot) as f32 + 50.0,
            ..Emission::default()
        };
        Line {
            emissions: clocks.iter().enumerate().map(emission).collect(),
            echoes: echoes.iter().map(echo).collect(),
            ..Line::default()
        }
    });
    (made.collect(), causes)
}

fn settings(method: Method) -> Settings {
    Settings { method, group_velocity_mps: 2e9 * METRES_PER_NS, ..Settings::default() }
}

fn resolve(settings: &Settings, lines: &[Line]) -> (Vec<Resolved>, Resolver) {
    let mut resolver = Resolver::new(settings).unwrap();
    for line in lines {
        resolver.push(line).unwrap();
    }
    resolver.finish().unwrap();
    let resolved = std::iter::from_fn(|| resolver.pop()).collect();
    (resolved, resolver)
}

/// Number of echoes with a wrong cause.
fn wrong(resolved: &[Resolved], causes: &[Vec<u32>]) -> usize {
    let line = |(number, (resolved, causes)): (usize, (&Resolved, &Vec<u32>))| {
        assert_eq!(resolved.line, number as u64);
        assert_eq!(resolved.echoes.len(), causes.len());
        let truth = causes.iter().map(|&emission| Cause { line: number as u64, emission });
        resolved.echoes.iter().zip(truth).filter(|(echo, truth)| echo.cause != Some(*truth)).count()
    };
    assert_eq!(resolved.len(), causes.len());
    resolved.iter().zip(causes).enumerate().map(line).sum()
}

/// A surface whose range goes from 1010 m to 1250 m across the line: zones 2 and 3, with blind
/// gaps.
fn slope(_: usize, shot: usize) -> f64 {
    1010.0 + 0.6 * shot as f64
}

#[test]
fn flat_ground_lies_in_one_zone() {
    let (lines, causes) = strip(20, 200, 17.0, |_, _| 1010.0);
    let (resolved, resolver) = resolve(&settings(Method::Blocks), &lines);
    assert_eq!(wrong(&resolved, &causes), 0);
    let summary = resolver.summary();
    // After the last emission of a line none follows for a while: the last two echoes are received
    // in its record.
    assert_eq!((summary.zones[2], summary.zones[1], summary.zones[0]), (20 * 198, 20, 20));
    assert_eq!((summary.echoes, summary.without_cause, summary.in_blind_gap), (4000, 0, 0));
    assert!((summary.interval_ns() - 2500.0).abs() < 0.05, "{}", summary.interval_ns());
    // Differences of two uniform displacements of ±8.5 ns.
    let rms_ns = 17.0 / 6f64.sqrt();
    assert!((summary.interval_rms_ns() / rms_ns - 1.0).abs() < 0.03, "{}", summary.interval_rms_ns());
    let flight_ns = 1010.0 / METRES_PER_NS;
    assert!(
        resolved.iter().flat_map(|line| &line.echoes).all(|echo| (echo.flight_ns - flight_ns).abs() < 0.002)
    );
}

#[test]
fn a_change_of_zone_within_the_line_costs_nothing() {
    for method in [Method::Blocks, Method::Variance { buffer: 50 }] {
        let (lines, causes) = strip(24, 400, 17.0, slope);
        let (resolved, resolver) = resolve(&settings(method), &lines);
        assert_eq!(wrong(&resolved, &causes), 0, "{method:?}");
        let zones = &resolver.summary().zones;
        assert!(zones[2] > 2000 && zones[3] > 2000, "{:?}", &zones[..5]);
    }
}

#[test]
fn echoes_near_to_an_emission_are_marked() {
    let (lines, _) = strip(24, 400, 17.0, slope);
    let (resolved, resolver) = resolve(&settings(Method::Blocks), &lines);
    let mut count = 0;
    for (line, resolved) in lines.iter().zip(&resolved) {
        let clocks: Vec<i64> = line.emissions.iter().map(|emission| emission.clock_ps).collect();
        for (echo, assigned) in line.echoes.iter().zip(&resolved.echoes) {
            let time_ps = clocks[echo.emission as usize] as f64 + echo.time_ns * 1e3;
            let is_blind = clocks.iter().any(|&clock| (time_ps - clock as f64).abs() <= 15e3);
            assert_eq!(assigned.in_blind_gap, is_blind);
            count += u64::from(is_blind);
        }
    }
    assert!(count > 20);
    assert_eq!(resolver.summary().in_blind_gap, count);
}

#[test]
fn a_constant_rate_is_refused_without_a_prior() {
    let (lines, _) = strip(4, 100, 0.0, |_, _| 1010.0);
    for method in [Method::Blocks, Method::Variance { buffer: 50 }] {
        let mut resolver = Resolver::new(&settings(method)).unwrap();
        let pushed = lines.iter().try_for_each(|line| resolver.push(line));
        let error = pushed.and_then(|()| resolver.finish()).unwrap_err();
        assert_eq!(
            error.to_string(),
            "the pulse rate is constant: intervals of 2500.000 ns vary by 0.000 ns RMS, but at least 0.5 ns are needed to \
             assign echoes to pulses; give a prior (height above ground, terrain model, trajectory) or a fixed zone"
        );
    }
}

#[test]
fn a_prior_stands_in_for_modulation() {
    let (lines, causes) = strip(24, 400, 0.0, slope);
    for prior in [Prior::PerEmission { sd_m: 50.0 }, Prior::Agl { agl_m: 1130.0, sd_m: 100.0 }] {
        for method in [Method::Blocks, Method::Variance { buffer: 50 }] {
            let (resolved, _) = resolve(&Settings { prior, ..settings(method) }, &lines);
            assert_eq!(wrong(&resolved, &causes), 0, "{prior:?} {method:?}");
        }
    }
}

#[test]
fn little_modulation_is_warned_of() {
    let (lines, _) = strip(24, 400, 5.0, slope);
    let (_, resolver) = resolve(&settings(Method::Blocks), &lines);
    let [Warning::WeakModulation { rms_ns }] = resolver.warnings()[..] else {
        panic!("{:?}", resolver.warnings())
    };
    assert!((rms_ns - 2.04).abs() < 0.1);
    assert_eq!(
        Warning::WeakModulation { rms_ns: 2.04 }.to_string(),
        "pulse intervals vary by only 2.04 ns RMS and there is no prior: check the margins, or give a prior"
    );
}

#[test]
fn little_evidence_is_warned_of_and_marked() {
    // Unrelated ranges: no surface.
    let (lines, _) = strip(16, 200, 17.0, |line, shot| 1000.0 + 900.0 * random((line * 1000 + shot) as u64));
    let (_, resolver) = resolve(&settings(Method::Blocks), &lines);
    let [Warning::WeakEvidence { median_margin_nats }] = resolver.warnings()[..] else {
        panic!("{:?}", resolver.warnings())
    };
    assert!(median_margin_nats < 10.0);
    assert!(resolver.summary().uncertain > 16 * 200 / 4, "{}", resolver.summary().uncertain);
    assert_eq!(
        Warning::WeakEvidence { median_margin_nats: 4.0 }.to_string(),
        "the median margin over the second-best zone is only 4 nats: give a prior"
    );
}

#[test]
fn a_fixed_zone_counts_running_numbers() {
    let (mut lines, _) = strip(2, 10, 0.0, |_, _| 760.0);
    // The record of shot 4 is lost: its number, and the echo in it (that of shot 2).
    lines[0].emissions.remove(4);
    lines[0].echoes.retain(|echo| echo.emission != 4);
    lines[0].echoes.iter_mut().filter(|echo| echo.emission > 4).for_each(|echo| echo.emission -= 1);
    let (resolved, resolver) = resolve(&settings(Method::Fixed(2)), &lines);
    let causes: Vec<Option<u32>> =
        resolved[0].echoes.iter().map(|echo| echo.cause.map(|cause| cause.emission)).collect();
    // Zone 2 of shot 6 is the lost one. The last two echoes are received after the last emission,
    // shot 9, whose zone 2 is shot 7.
    assert_eq!(causes, [Some(0), Some(1), Some(3), None, Some(4), Some(5), Some(6), Some(6), Some(6)]);
    assert!(resolved[0].echoes.iter().all(|echo| echo.margin_nats == f32::INFINITY));
    assert_eq!(resolver.summary().without_cause, 1);
    assert_eq!(resolver.warnings(), []);
}

#[test]
fn the_variance_method_is_right_on_bare_ground_and_poisoned_by_false_alarms() {
    let (mut lines, causes) = strip(24, 400, 17.0, slope);
    let variance = settings(Method::Variance { buffer: 50 });
    assert_eq!(wrong(&resolve(&variance, &lines).0, &causes), 0);
    // One echo in 200 at a random range.
    for (number, line) in lines.iter_mut().enumerate() {
        for at in (number % 50..line.echoes.len()).step_by(200) {
            line.echoes[at].time_ns = 100.0 + 2000.0 * random(at as u64);
        }
    }
    let right_of = |method| wrong(&resolve(&settings(method), &lines).0, &causes);
    // These are wrong with both methods; the others only with `Variance`.
    assert!(right_of(Method::Blocks) <= 60);
    assert!(right_of(Method::Variance { buffer: 50 }) > 500);
}

/// Vegetation of 20 m over ground that passes from zone 2 to 3 and back.
fn wood(line: usize, shot: usize) -> f64 {
    1120.0 + 60.0 * (shot as f64 / 60.0).sin() + 20.0 * random((1 << 32) + (line * 400 + shot) as u64)
}

/// Wrong zones neither get a second chance from their other buffer nor lie outside `range_m`.
#[test]
fn the_variance_method_considers_each_possible_zone_once() {
    let (lines, causes) = strip(24, 400, 30.0, wood);
    let right = |range_m: [f64; 2], buffer: usize| {
        let settings = Settings { range_m, ..settings(Method::Variance { buffer }) };
        let (resolved, _) = resolve(&settings, &lines);
        let ranges = resolved.iter().flat_map(|line| &line.echoes).map(|echo| echo.flight_ns * METRES_PER_NS);
        assert!(ranges.clone().all(|range| (range_m[0]..=range_m[1]).contains(&range)));
        1.0 - wrong(&resolved, &causes) as f64 / (24.0 * 400.0)
    };
    let shares = [right([600.0, 1500.0], 20), right([600.0, 1500.0], 200), right([1000.0, 1300.0], 20)];
    assert!(shares[0] > 0.86 && shares[1] > 0.95 && shares[2] == 1.0, "{shares:?}");
}

fn recorded(scene: &EchoScene, recorded: &[RecordedLine]) -> Vec<Line> {
    let mut shot = 0;
    let mut emission = |line: usize, index: usize, recorded: &RecordedLine| {
        shot += 1;
        Emission {
            clock_ps: recorded.clocks_ps[index],
            shot,
            prior_range_m: scene.prior_m(line, index, recorded.ground_m[index], 20.0),
            ..Emission::default()
        }
    };
    let line = |(number, recorded): (usize, &RecordedLine)| Line {
        emissions: (0..recorded.clocks_ps.len()).map(|index| emission(number, index, recorded)).collect(),
        echoes: recorded
            .echoes
            .iter()
            .map(|echo| Echo { emission: echo.emission, time_ns: echo.time_ns })
            .collect(),
        ..Line::default()
    };
    recorded.iter().enumerate().map(line).collect()
}

/// Echoes and wrong ones: away from transitions, near transitions, and in the first and last eight
/// lines.
fn tally(how: &RecordingSettings, prior: Prior, lines: u32, part: f64) -> [(u64, u64); 3] {
    let mut tally = [(0, 0); 3];
    for (i, spec) in (0u64..).zip(SCENES) {
        let scene = EchoScene::new(spec, 500 + i, lines, part);
        let truth = scene.record(how);
        let (resolved, _) =
            resolve(&Settings { prior, ..settings(Method::Blocks) }, &recorded(&scene, &truth));
        for (line, resolved) in truth.iter().zip(&resolved) {
            let is_end = resolved.line < 8 || resolved.line + 8 >= u64::from(lines);
            let echoes = line.echoes.iter().zip(&resolved.echoes);
            for (echo, assigned) in echoes.filter(|(echo, _)| echo.class != TargetClass::FalseAlarm) {
                let cause = Cause { line: u64::from(echo.cause.0), emission: echo.cause.1 };
                let wrong = u64::from(assigned.cause != Some(cause));
                for group in [Some(usize::from(echo.near)), is_end.then_some(2)].into_iter().flatten() {
                    tally[group].0 += 1;
                    tally[group].1 += wrong;
                }
            }
        }
    }
    tally
}

fn recording(modulation_ns: f64) -> RecordingSettings {
    RecordingSettings { pulse_rate_hz: 400e3, modulation_ns, blind_ns: 15.0, lost_records: 0.0 }
}

fn assert_right(tally: [(u64, u64); 3], percent: f64) {
    for (count, wrong) in tally {
        assert!(count > 1000 && wrong as f64 <= (1.0 - percent / 100.0) * count as f64, "{tally:?}");
    }
}

#[test]
fn scenes_are_right_by_modulation_away_from_and_near_to_transitions_and_at_the_ends() {
    assert_right(tally(&recording(15.0), Prior::None, 40, 0.3), 99.9);
    assert_right(tally(&recording(9.0), Prior::None, 40, 0.3), 99.8);
    assert_right(tally(&recording(5.0), Prior::None, 40, 0.3), 99.0);
}

#[test]
fn scenes_are_right_by_a_terrain_model_where_the_rate_is_constant() {
    assert_right(tally(&recording(0.0), Prior::PerEmission { sd_m: 20.0 }, 40, 0.3), 99.99);
}

#[test]
fn lost_records_harm_none_but_their_own_echoes() {
    let how = RecordingSettings { lost_records: 0.01, ..recording(15.0) };
    assert_right(tally(&how, Prior::None, 24, 0.2), 99.8);
}

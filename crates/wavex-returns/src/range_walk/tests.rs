use super::*;
use wavex_signal::simulated::Random;

/// Delay of the simulated receiver, ns.
fn truth_ns(amplitude_dn: f64) -> f64 {
    let t = (amplitude_dn / 160.0).ln();
    -0.08 * t - 0.05 * t * t
}

/// Lines of 200 shots over a rough surface with patches of different reflectance.
fn recording(seed: u64, lines: usize, late_ns: impl Fn(f64) -> f64) -> Vec<Triple> {
    let mut random = Random::new(seed);
    let mut triples = Vec::new();
    for line in 0..lines {
        let (mut height_ns, mut slope_ns, mut patch_dn) = (0.0, 0.0, 120.0);
        let mut echoes = Vec::new();
        for shot in 0..200 {
            slope_ns += 0.03 * random.normal();
            height_ns += slope_ns + if shot == 90 { 20.0 } else { 0.0 };
            if shot % 7 == 0 {
                patch_dn = (120.0 + 40.0 * random.normal()).clamp(30.0, 200.0);
            }
            let amplitude_dn = patch_dn + 8.0 * random.normal();
            let noise_ns = 0.015 * random.normal() + 0.05 * random.normal();
            let flight_ns = 5000.0 + height_ns + noise_ns + late_ns(amplitude_dn);
            echoes.push(SingleEcho { flight_ns, flight_sd_ns: 0.015, amplitude_dn });
        }
        add(line, &echoes, &mut triples);
    }
    triples
}

/// Adds the triples of a scan line.
fn add(line: usize, echoes: &[SingleEcho], triples: &mut Vec<Triple>) {
    triples.extend(
        echoes
            .windows(3)
            .enumerate()
            .map(|(i, of)| Triple { echoes: [of[0], of[1], of[2]], shot: (1000 * line + i) as u64 }),
    );
}

/// Ground whose height follows its reflectance.
#[derive(Clone, Copy, Debug)]
enum Ground {
    /// Bright grass above a dark road, with kerbs between.
    Grass,
    /// Dark roofs of several metres' height among gardens.
    Roofs,
    /// Steep furrows, which are bright on the side towards the sensor.
    Slopes,
    /// Leaves: each echo is the brighter, the higher it is.
    Leaves,
}

const GROUNDS: [Ground; 4] = [Ground::Grass, Ground::Roofs, Ground::Slopes, Ground::Leaves];

/// A flight over ground that imitates a walk, seen by a receiver without one.
fn imitation(ground: Ground, seed: u64) -> Vec<Triple> {
    let mut random = Random::new(1000 + seed);
    let between = |random: &mut Random, least: f64, most: f64| least + (most - least) * random.uniform();
    // Of the flight: height of the bright material, ns; relation of height and brightness, ns;
    // roughness of both materials, ns.
    let step_ns = between(&mut random, 0.1, 0.8);
    let relation_ns = between(&mut random, -0.1, 0.2);
    let rough_ns = [between(&mut random, 0.02, 0.05), between(&mut random, 0.05, 0.2)];
    let patch_shots = between(&mut random, 3.0, 12.0);
    let mut triples = Vec::new();
    for line in 0..60 {
        let (mut slope_ns, mut height_ns) = (0.0, 0.0);
        let (mut is_bright, mut patch_ns, mut patch_ln) = (false, 0.0, 0.0);
        let mut echoes = Vec::new();
        for _ in 0..200 {
            slope_ns += 0.01 * random.normal();
            height_ns += slope_ns;
            if random.uniform() < 1.0 / patch_shots {
                is_bright = random.uniform() < 0.5;
                patch_ns = step_ns * (1.0 + 0.3 * random.normal());
                patch_ln = 0.15 * random.normal();
            }
            let texture = 0.15 * random.normal();
            let (of_material, of_echo_ns, tilt) = match ground {
                Ground::Grass => (if is_bright { 130.0 } else { 50.0 }, 0.0, 0.0),
                Ground::Roofs => (if is_bright { 50.0 } else { 130.0 }, 0.0, 0.0),
                Ground::Slopes => (100.0, 0.0, random.normal()),
                Ground::Leaves => (if is_bright { 120.0 } else { 50.0 }, relation_ns * texture / 0.15, 0.0),
            };
            let of_patch_ns = match ground {
                Ground::Roofs => 30.0 * patch_ns,
                Ground::Slopes => 0.0,
                _ => patch_ns,
            };
            slope_ns += 0.3 * step_ns * tilt * 0.2;
            let rough_ns = rough_ns[usize::from(is_bright)];
            let up_ns = if is_bright { of_patch_ns + of_echo_ns } else { 0.0 };
            let amplitude_dn = of_material * (patch_ln + texture + 0.1 * tilt).exp();
            let noise_ns = 0.015 * random.normal() + rough_ns * random.normal();
            let flight_ns = 5000.0 - height_ns - up_ns + noise_ns;
            echoes.push(SingleEcho { flight_ns, flight_sd_ns: 0.015, amplitude_dn });
        }
        add(line, &echoes, &mut triples);
    }
    triples
}

/// Number of imitations that are applied somewhere between 30 and 200 DN.
fn believed(flights: std::ops::Range<u64>) -> (usize, usize) {
    let (mut applied, mut seen) = (0, 0);
    for seed in flights {
        let learnt = RangeWalk::learn(&imitation(GROUNDS[seed as usize % 4], seed), None).unwrap();
        let is_at = |dn: u32| learnt.walk.correction(f64::from(dn)).late_ns != 0.0;
        let is_beyond = (30..200).any(is_at);
        seen += usize::from(is_beyond);
        applied += usize::from(is_beyond && learnt.proof.refusal().is_none());
    }
    (applied, seen)
}

#[test]
fn ground_that_imitates_a_walk_is_refused() {
    let (applied, seen) = believed(0..24);
    assert!(seen >= 12, "the flights do imitate a walk: {seen} of 24");
    assert_eq!(applied, 0, "of 24");
}

/// The full number of flights.
#[test]
#[ignore = "a minute; `cargo test -p wavex-returns range_walk -- --ignored`"]
fn at_most_one_imitation_in_two_hundred_is_believed() {
    let (applied, seen) = believed(0..400);
    assert!(applied <= 2 && seen >= 200, "{applied} of 400, {seen} without proof");
}

#[test]
fn a_walk_is_found_within_its_uncertainty() {
    let (mut squares, mut proven) = (Vec::new(), 0);
    for seed in 0..20 {
        let learnt = RangeWalk::learn(&recording(seed, 60, truth_ns), None).unwrap();
        proven += usize::from(learnt.proof.refusal().is_none());
        let walk = learnt.walk;
        for amplitude_dn in [60.0, 90.0, 160.0, 190.0] {
            let (late_ns, sd_ns) = walk.late_ns(amplitude_dn);
            let true_ns = truth_ns(amplitude_dn) - truth_ns(walk.reference_dn);
            assert!((late_ns - true_ns).abs() < 0.03, "{amplitude_dn} DN: {late_ns} {true_ns} {sd_ns}");
            squares.push(((late_ns - true_ns) / sd_ns).powi(2));
        }
    }
    let rms = (squares.iter().sum::<f64>() / squares.len() as f64).sqrt();
    assert!((0.7..1.3).contains(&rms), "{rms}");
    // The proof refuses most walks, so that it refuses nearly all imitations.
    assert!(proven >= 1, "{proven} of 20");
}

#[test]
fn no_walk_is_proven_where_there_is_none() {
    for seed in 0..20 {
        let learnt = RangeWalk::learn(&recording(seed, 20, |_| 0.0), None).unwrap();
        assert_ne!(learnt.proof.refusal(), None, "{seed}");
    }
    let few = recording(1, 4, truth_ns);
    assert_eq!(RangeWalk::learn(&few, None), Err(NoWalk::TooFew(few.len())));
    let mut equal = recording(1, 20, truth_ns);
    equal.iter_mut().flat_map(|triple| &mut triple.echoes).for_each(|echo| echo.amplitude_dn = 100.0);
    assert_eq!(RangeWalk::learn(&equal, None), Err(NoWalk::OneAmplitude));
}

#[test]
fn a_receiver_that_changes_is_not_believed() {
    let mut changing = recording(3, 40, truth_ns);
    changing.extend(recording(4, 40, |dn| -truth_ns(dn)));
    assert_ne!(RangeWalk::learn(&changing, None).unwrap().proof.refusal(), None);
}

#[test]
fn amplitudes_of_other_echoes_prove_nothing() {
    // The delay follows the amplitude of the shot before.
    let mut random = Random::new(5);
    let mut triples = Vec::new();
    for line in 0..60 {
        let mut before_dn: f64 = 100.0;
        let mut echoes = Vec::new();
        for _ in 0..200 {
            let amplitude_dn = 0.6 * before_dn + 0.4 * (20.0 + 160.0 * random.uniform());
            let flight_ns = 5000.0 + 2.0 * truth_ns(before_dn) + 0.05 * random.normal();
            echoes.push(SingleEcho { flight_ns, flight_sd_ns: 0.015, amplitude_dn });
            before_dn = amplitude_dn;
        }
        add(line, &echoes, &mut triples);
    }
    let proof = RangeWalk::learn(&triples, None).unwrap().proof;
    assert!(proof.neighbours.ratio().abs() > 5.0, "{proof:?}");
    assert_ne!(proof.refusal(), None);
}

/// Every part of the proof, broken alone, refuses.
#[test]
fn each_part_of_the_proof_can_refuse() {
    let of = |value: f64, sd: f64| MeasuredDelay { value, sd };
    let sound = Proof {
        halves: [of(1.0, 0.1); 2],
        falls: [of(50.0, 10.0); 2],
        fall: of(100.0, 15.0),
        factor: 1.0,
        most_permuted: 0.3,
        without_roughness: of(0.9, 0.2),
        without_contrast: of(0.9, 0.2),
        differences: vec![("rough against smooth", of(0.1, 0.1)), ("a second kind", of(0.0, 0.1))],
        neighbours: of(0.1, 0.1),
    };
    assert_eq!(sound.refusal(), None);
    type Change = fn(&mut Proof);
    let cases: [(Change, &str); 11] = [
        (|proof| proof.halves[1].value = 0.2, "explains 0.20 ± 0.10 of it in the other half"),
        (|proof| proof.halves[0].sd = f64::NAN, "in the other half"),
        (|proof| proof.falls[0].value = -1.0, "fall by -0.1 standard deviations"),
        (|proof| proof.fall.sd = 50.0, "fall by 2.0 standard deviations (at least 3 needed)"),
        (|proof| proof.most_permuted = 1.1, "permuted between neighbours explain as much: 1.10 against 1.00"),
        (|proof| proof.without_roughness.value = 0.2, "without roughness, 0.20 ± 0.20 of it is left"),
        (|proof| proof.without_contrast.value = 0.2, "without contrast, 0.20 ± 0.20 of it is left"),
        (|proof| proof.differences[1].1.value = 0.3, "a second kind (+3.0 standard deviations; χ² 10.0"),
        (
            |proof| proof.differences[0].1.sd = f64::NAN,
            "does not show whether its factor depends on rough against",
        ),
        (
            |proof| proof.neighbours.sd = 0.0,
            "does not show whether its factor depends on amplitudes of neigh",
        ),
        (|proof| proof.neighbours.value = -0.3, "neighbouring shots delay echoes too (-3.0"),
    ];
    for (change, expected) in cases {
        let mut broken = sound.clone();
        change(&mut broken);
        let text = broken.refusal().map(|refusal| refusal.to_string()).unwrap_or_default();
        assert!(text.contains(expected), "{text}, not {expected}");
    }
}

#[test]
fn a_walk_returns_to_its_prior_beyond_the_evidence() {
    let walk = RangeWalk::learn(&recording(7, 60, truth_ns), None).unwrap().walk;
    for (amplitude_dn, largest_ns) in [(0.5, 0.02), (20_000.0, 0.02)] {
        let (late_ns, sd_ns) = walk.late_ns(amplitude_dn);
        assert!(
            late_ns.abs() < largest_ns && (0.04..0.06).contains(&sd_ns),
            "{amplitude_dn}: {late_ns} {sd_ns}"
        );
        assert_eq!(walk.correction(amplitude_dn).late_ns, 0.0);
    }
}

#[test]
fn a_few_triples_leave_the_prior() {
    let expected = RangeWalk::learn(&recording(7, 60, truth_ns), None).unwrap().walk;
    let few = recording(8, 6, truth_ns);
    let from_zero = RangeWalk::learn(&few, None).unwrap().walk;
    let from_it = RangeWalk::learn(&few, Some(&expected)).unwrap().walk;
    let error_ns =
        |walk: &RangeWalk| (walk.late_ns(60.0).0 - truth_ns(60.0) + truth_ns(walk.reference_dn)).abs();
    assert!(error_ns(&from_it) < 0.02, "{}", error_ns(&from_it));
    assert!(from_zero.late_ns(60.0).0.abs() < truth_ns(60.0).abs());
    assert_eq!(from_it.reference_dn, expected.reference_dn);
}

#[test]
fn a_correction_is_continuous_and_keeps_what_it_leaves() {
    let walk = RangeWalk::learn(&recording(7, 60, truth_ns), None).unwrap().walk;
    let mut before = walk.correction(0.5);
    let (mut parts, mut whole) = (0, 0);
    for k in 1..40_000 {
        let amplitude_dn = 0.5 * (1.0 + 2.5e-4f64).powi(k);
        let now = walk.correction(amplitude_dn);
        assert!((now.late_ns - before.late_ns).abs() < 5e-4, "{amplitude_dn}: {before:?} {now:?}");
        let (late_ns, sd_ns) = walk.late_ns(amplitude_dn);
        let left_ns = late_ns - now.late_ns;
        assert!((now.remaining_sd_ns - sd_ns.hypot(left_ns)).abs() < 1e-9);
        assert!(late_ns.abs() > 3.0 * sd_ns || now.late_ns == 0.0);
        parts += usize::from(now.late_ns != 0.0 && left_ns != 0.0);
        whole += usize::from(now.late_ns != 0.0 && left_ns == 0.0);
        before = now;
    }
    assert!(parts > 0 && whole > 0, "{parts} {whole}");
    let numeric = (walk.correction(70.01).late_ns - walk.correction(69.99).late_ns) / 0.02;
    assert!((walk.slope_ns_per_dn(70.0) - numeric).abs() < 2e-4);
    assert_eq!(walk.late_ns(walk.reference_dn).0, 0.0);
    assert_eq!((walk.slope_ns_per_dn(5e6), walk.late_ns(f64::NAN)), (0.0, (0.0, 0.0)));
}

#[test]
fn unusable_numbers_are_noticed() {
    let walk = RangeWalk::learn(&recording(7, 20, truth_ns), None).unwrap().walk;
    assert!(walk.is_valid());
    assert!(!RangeWalk { reference_dn: 0.0, ..walk.clone() }.is_valid());
    let mut far = walk.clone();
    far.nodes[3].late_ns = 1e9;
    assert!(!far.is_valid());
    let mut unsorted = walk;
    unsorted.nodes.swap(0, 1);
    assert!(!unsorted.is_valid());
}

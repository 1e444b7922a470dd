use std::sync::Arc;

use super::*;
use wavex_line::scan_line::{InputInfo, OnlineReturn};
use wavex_line::stage::Result;

/// Metres per nanosecond of two-way travel.
const METRES_PER_NS: f64 = 0.15;
/// Time of flight of the first echo of a line, ns.
const FLIGHT_NS: f64 = 3000.0;
const SHOTS_PER_LINE: usize = 100;

/// How a made recording relates its times to the emissions.
#[derive(Clone, Copy, PartialEq)]
enum Made {
    /// The clock is the first sample of the outgoing pulse.
    FirstSample,
    /// The clock is the sample nearest to the peak of the outgoing pulse.
    NearestSample,
    /// The clock is the emission.
    Exact,
    /// As `FirstSample`, with origins moved so that points are right by the clock.
    MovingOrigin,
    /// As `FirstSample`, without outgoing pulses: return locations of whole samples.
    Locations,
    /// The clock is the sample before the emission, whose phase drifts; no outgoing pulses.
    Drifting,
}

struct Recording(Vec<ScanLine>);

impl Source for Recording {
    fn next(&mut self, cx: &mut Context) -> Result<Option<ScanLine>> {
        cx.warn("read");
        Ok(self.0.pop())
    }
}

/// Pseudo-random number, uniform from 0 to 1.
fn random(of: usize) -> f64 {
    let mut bits = (of as u64 + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15);
    bits = (bits ^ (bits >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    bits = (bits ^ (bits >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    (bits >> 40) as f64 / (1u64 << 24) as f64
}

fn pulse(position: f64) -> Vec<u16> {
    let dn = |k: usize| 10.0 + 150.0 * (-0.5 * ((k as f64 - position) / 2.0).powi(2)).exp();
    (0..60).map(|k| dn(k).round() as u16).collect()
}

/// Lines over a gentle slope that is rough by `roughness_ns`.
fn recording(made: Made, lines: usize, roughness_ns: f64) -> Recording {
    let input = Arc::new(InputInfo { group_velocity_mps: METRES_PER_NS * 2e9, ..InputInfo::default() });
    let line = |line: usize| {
        let (mut emissions, mut blocks) = (Vec::new(), Blocks::default());
        for i in 0..SHOTS_PER_LINE {
            let shot = line * SHOTS_PER_LINE + i;
            let outgoing = 15.0 + 6.0 * random(shot);
            let flight_ns = FLIGHT_NS + 0.05 * i as f64 + roughness_ns * (random(shot + 7777) - 0.5);
            let emission_ns = match made {
                Made::FirstSample | Made::MovingOrigin | Made::Locations => outgoing,
                Made::NearestSample => outgoing - outgoing.round(),
                Made::Exact => 0.0,
                Made::Drifting => (0.03 * shot as f64).fract(),
            };
            let origin_ns = if made == Made::MovingOrigin { -outgoing } else { 0.0 };
            emissions.push(Emission {
                shot: shot as u64,
                origin_m: [i as f64, 0.0, -origin_ns * METRES_PER_NS],
                ..Emission::default()
            });
            let index = i as u32;
            match made {
                Made::Drifting => {}
                Made::Locations => {
                    let online = OnlineReturn { emission: index, time_ns: flight_ns.round(), amplitude: 1.0 };
                    blocks.online.push(online);
                }
                _ => blocks.push(index, Channel::Reference, None, 0.0, 1.0, &pulse(outgoing)),
            }
            let echo_ns = flight_ns + emission_ns;
            let start_ns = echo_ns.floor() - 30.0;
            blocks.push(index, Channel::LowPower, None, start_ns, 1.0, &pulse(echo_ns - start_ns));
        }
        ScanLine::of_shots(Arc::clone(&input), line as u32, emissions, blocks)
    };
    Recording((0..lines).map(line).collect())
}

fn decided(made: Made, lines: usize, roughness_ns: f64, default: EmissionReference) -> (Smoothness, Choice) {
    let references = match made {
        Made::Locations => WITH_LOCATIONS,
        Made::Drifting => WITHOUT,
        _ => WITH_OUTGOING,
    };
    let found = Smoothness::look_ahead(&mut recording(made, lines, roughness_ns), references);
    let choice = found.choose(default, false);
    (found, choice)
}

fn finding(choice: &Choice) -> &str {
    match &choice.message {
        Some(ChoiceMessage::Finding(text)) => text,
        _ => "",
    }
}

fn warning(choice: &Choice) -> &str {
    match &choice.message {
        Some(ChoiceMessage::Warning(text)) => text,
        _ => "",
    }
}

#[test]
fn the_smoothest_points_decide_whatever_the_default() {
    for (made, expected) in [
        (Made::FirstSample, EmissionReference::OutgoingPulse),
        (Made::NearestSample, EmissionReference::OutgoingPulseFraction),
        (Made::Exact, EmissionReference::Clock),
        (Made::MovingOrigin, EmissionReference::Clock),
    ] {
        for &default in WITH_OUTGOING {
            let (found, choice) = decided(made, 10, 0.2, default);
            assert_eq!(choice.reference, expected);
            let head = format!("emission times by `emission = \"{}\"`: second differences", name(expected));
            assert!(finding(&choice).starts_with(&head), "{}", finding(&choice));
            // Of 980 triples; without noise, some waveforms are copies of the one before.
            assert!((950..=980).contains(&found.points_ns.len()), "{}", found.text());
            assert_eq!(found.origins_follow_outgoing(), made != Made::Exact && made != Made::NearestSample);
        }
    }
}

#[test]
fn the_clock_moves_by_the_usual_peak_of_the_outgoing_pulse() {
    let (found, _) = decided(Made::FirstSample, 10, 0.2, EmissionReference::OutgoingPulse);
    assert!((found.outgoing_ns() - 18.0).abs() < 0.5, "{}", found.outgoing_ns());
}

#[test]
fn a_rough_or_short_recording_keeps_the_default_and_says_so() {
    for &default in WITH_OUTGOING {
        let (_, choice) = decided(Made::FirstSample, 10, 200.0, default);
        assert_eq!(choice.reference, default);
        let expected = format!("`emission = \"{}\"` is assumed", name(default));
        assert!(warning(&choice).contains(&expected), "{}", warning(&choice));
        let (_, choice) = decided(Made::FirstSample, 1, 0.2, default);
        assert_eq!(choice.reference, default);
        let why = "(98 triples of neighbouring single echoes in the first 100 shots, 100 needed)";
        assert!(warning(&choice).contains(why), "{}", warning(&choice));
    }
}

#[test]
fn a_stated_reference_needs_no_decision() {
    let short = Smoothness::look_ahead(&mut recording(Made::Exact, 1, 0.2), WITH_OUTGOING);
    let choice = short.choose(EmissionReference::OutgoingPulse, true);
    assert!(choice.reference == EmissionReference::OutgoingPulse && choice.message.is_none());
    let rough = Smoothness::look_ahead(&mut recording(Made::Exact, 10, 200.0), WITH_OUTGOING);
    let choice = rough.choose(EmissionReference::OutgoingPulse, true);
    assert_eq!(choice.reference, EmissionReference::OutgoingPulse);
    assert!(finding(&choice).contains("second differences"));
    let smooth = Smoothness::look_ahead(&mut recording(Made::Exact, 10, 0.2), WITH_OUTGOING);
    assert_eq!(smooth.choose(EmissionReference::OutgoingPulse, true).reference, EmissionReference::Clock);
}

#[test]
fn return_locations_that_are_worse_than_the_clock_are_not_used() {
    // Whole samples are rougher than the emissions of an exact clock, but not than a jitter of 6 ns.
    let (_, choice) = decided(Made::Locations, 10, 0.2, EmissionReference::ReturnLocations);
    assert_eq!(choice.reference, EmissionReference::ReturnLocations, "{}", finding(&choice));
    let mut exact = recording(Made::Exact, 10, 0.2);
    for line in &mut exact.0 {
        let wavex_line::scan_line::Content::Shots(blocks) = &mut line.content else { panic!("shots") };
        let online = |emission: u32| {
            let time_ns = FLIGHT_NS + 3.0 * random(emission as usize);
            OnlineReturn { emission, time_ns, amplitude: 1.0 }
        };
        blocks.online = (0..SHOTS_PER_LINE as u32).map(online).collect();
    }
    let found = Smoothness::look_ahead(&mut exact, WITH_LOCATIONS);
    assert_eq!(found.choose(EmissionReference::ReturnLocations, true).reference, EmissionReference::Clock);
}

#[test]
fn only_single_strong_unclipped_echoes_count() {
    let at = |samples: &[u16]| single_peak(samples, true);
    assert!((at(&pulse(25.3)).unwrap() - 25.3).abs() < 0.05);
    let two: Vec<u16> = pulse(15.0).iter().zip(pulse(45.0)).map(|(a, b)| a / 2 + b - 5).collect();
    assert_eq!(at(&two), None);
    assert!(outgoing_peak(&two).is_some());
    let weak: Vec<u16> = (0..60).map(|k| 10 + (random(k) * 8.0) as u16 + pulse(25.0)[k] / 20).collect();
    assert_eq!(at(&weak), None);
    assert_eq!(at(&pulse(0.0)), None, "cut off");
    assert_eq!(at(&[]), None);
}

/// SDs of the clock and of the choice, ns.
fn sds_ns(choice: &Choice) -> (Option<f64>, f64) {
    let input = choice.describe(&InputInfo::default());
    (input.clock_sd_ns, input.emission_choice_sd_ns)
}

#[test]
fn smooth_points_bound_the_jitter_of_the_clock() {
    // Roughness is uniform; echoes add the errors of their positions.
    let (_, choice) = decided(Made::Exact, 10, 0.2, EmissionReference::OutgoingPulse);
    let (clock_sd_ns, choice_sd_ns) = sds_ns(&choice);
    let of_terrain_ns = 0.2 / 12f64.sqrt();
    let clock_sd_ns = clock_sd_ns.unwrap();
    assert!((of_terrain_ns..1.3 * of_terrain_ns).contains(&clock_sd_ns), "{clock_sd_ns} ns");
    assert_eq!(choice_sd_ns, 0.0);
    assert!(finding(&choice).contains("include a jitter of the clock of 0.0"), "{}", finding(&choice));
    // Terrain may be as rough as a clock of one sample.
    let (_, choice) = decided(Made::Exact, 10, 2.0, EmissionReference::Clock);
    assert_eq!(sds_ns(&choice).0, None);
    let (_, choice) = decided(Made::NearestSample, 10, 0.2, EmissionReference::Clock);
    assert_eq!(choice.reference, EmissionReference::OutgoingPulseFraction);
    // 98 triples are too few.
    let (_, choice) = decided(Made::Exact, 1, 0.2, EmissionReference::Clock);
    assert_eq!(sds_ns(&choice).0, None);
}

#[test]
fn the_rougher_half_of_the_points_bounds_the_clock() {
    let mut lines = recording(Made::Exact, 5, 0.1).0;
    lines.extend(recording(Made::Exact, 5, 0.4).0);
    let found = Smoothness::look_ahead(&mut Recording(lines), WITH_OUTGOING);
    let clock_sd_ns = sds_ns(&found.take(EmissionReference::Clock)).0.unwrap();
    assert!(clock_sd_ns > 0.4 / 12f64.sqrt(), "{clock_sd_ns} ns");
}

#[test]
fn a_clock_that_drifts_through_the_samples_proves_nothing() {
    let found = Smoothness::look_ahead(&mut recording(Made::Drifting, 20, 0.2), WITHOUT);
    let [(_, figure)] = found.figures(&found.points_ns)[..] else { panic!("one reference") };
    assert!(figure.whole_ns < 0.4, "neighbouring shots have nearly the same error");
    assert_eq!(sds_ns(&found.take(EmissionReference::Clock)).0, None);
}

#[test]
fn an_undecided_choice_has_the_spread_of_its_candidates() {
    let (_, choice) = decided(Made::FirstSample, 10, 200.0, EmissionReference::OutgoingPulseFraction);
    let (clock_sd_ns, choice_sd_ns) = sds_ns(&choice);
    // Outgoing pulses are within ±3 ns of their mean: the spread is at least the mean of that.
    assert!((1.5 / 12f64.sqrt()..6.0 / 12f64.sqrt()).contains(&choice_sd_ns), "{choice_sd_ns} ns");
    assert_eq!(clock_sd_ns, None);
    let text = format!("standard deviations of ranges include {choice_sd_ns:.2} ns for the choice");
    assert!(warning(&choice).contains(&text), "{}", warning(&choice));
    // Without second differences the candidates differ as much.
    let (_, short) = decided(Made::FirstSample, 1, 0.2, EmissionReference::OutgoingPulseFraction);
    assert!(sds_ns(&short).1 > 0.4, "{}", sds_ns(&short).1);
    // A decision, a statement of the file, or of the job, is no choice.
    for (roughness_ns, is_stated) in [(0.2, false), (200.0, true)] {
        let found = Smoothness::look_ahead(&mut recording(Made::Exact, 10, roughness_ns), WITH_OUTGOING);
        assert_eq!(sds_ns(&found.choose(EmissionReference::OutgoingPulse, is_stated)).1, 0.0);
        assert_eq!(sds_ns(&found.take(EmissionReference::OutgoingPulseFraction)).1, 0.0);
    }
}

#[test]
fn copies_of_waveforms_are_no_smooth_points() {
    let noise = |shot: usize, k: usize| (random(shot * 60 + k) * 3.0) as u16;
    let found = |copies: usize| {
        let mut lines = recording(Made::Locations, 10, 4.0).0;
        for (number, line) in lines.iter_mut().enumerate() {
            let wavex_line::scan_line::Content::Shots(blocks) = &line.content else { panic!("shots") };
            let (mut emissions, mut with_copies) = (Vec::new(), Blocks::default());
            for block in blocks.iter() {
                let samples = blocks.samples(block).iter().enumerate();
                let shot = number * SHOTS_PER_LINE + block.emission as usize;
                let samples: Vec<u16> = samples.map(|(k, dn)| dn + noise(shot, k)).collect();
                for _ in 0..=copies {
                    let index = emissions.len() as u32;
                    with_copies.push(index, block.channel, None, block.start_ns, 1.0, &samples);
                    emissions.push(line.emissions[block.emission as usize]);
                }
            }
            *line = ScanLine::of_shots(Arc::clone(&line.input), line.line, emissions, with_copies);
        }
        Smoothness::look_ahead(&mut Recording(lines), WITHOUT).text()
    };
    assert_eq!(found(2), found(0));
}

#[test]
fn a_reference_that_points_contradict_is_a_warning() {
    let found = |made: Made| Smoothness::look_ahead(&mut recording(made, 10, 0.2), WITH_OUTGOING);
    let set = |made: Made, reference: EmissionReference| found(made).set(reference);
    let text = "by `clock`, but points are smoother by `outgoing_pulse`";
    assert!(warning(&set(Made::FirstSample, EmissionReference::Clock)).contains(text));
    let text = "by `outgoing_pulse`, but points are smoother by `clock`";
    assert!(warning(&set(Made::Exact, EmissionReference::OutgoingPulse)).contains(text));
    for (made, reference) in [
        (Made::FirstSample, EmissionReference::OutgoingPulse),
        (Made::NearestSample, EmissionReference::OutgoingPulseFraction),
        (Made::Exact, EmissionReference::Clock),
    ] {
        let choice = set(made, reference);
        assert!(choice.reference == reference && warning(&choice).is_empty(), "{}", warning(&choice));
    }
}

/// Second differences of ten lines whose shots are late by a sample, or without an echo.
fn smoothness_of(is_late: impl Fn(u32) -> bool, is_empty: impl Fn(u32) -> bool) -> Smoothness {
    let mut lines = recording(Made::FirstSample, 10, 0.2).0;
    for line in &mut lines {
        let wavex_line::scan_line::Content::Shots(blocks) = &line.content else { panic!("shots") };
        let mut changed = Blocks::default();
        for block in blocks.iter().filter(|block| !(block.channel.is_echo() && is_empty(block.emission))) {
            let is_late = block.channel.is_echo() && is_late(block.emission);
            let start_ns = block.start_ns + f64::from(u8::from(is_late));
            changed.push(block.emission, block.channel, None, start_ns, 1.0, blocks.samples(block));
        }
        *line = ScanLine::of_shots(Arc::clone(&line.input), line.line, line.emissions.clone(), changed);
    }
    Smoothness::look_ahead(&mut Recording(lines), WITH_OUTGOING)
}

#[test]
fn waveforms_displaced_by_a_sample_are_a_warning() {
    let is_said = |is_late: fn(u32) -> bool| {
        let found = smoothness_of(is_late, |_| false);
        warning(&found.set(EmissionReference::OutgoingPulse)).contains("displaced by a sample")
    };
    assert!(is_said(|shot| shot % 10 == 0));
    assert!(!is_said(|shot| shot % 100 == 0), "too few");
    assert!(!is_said(|shot| shot / 10 % 2 == 0), "steps of the ground");
}

#[test]
fn displaced_shots_show_beside_shots_without_an_echo() {
    let late = |shot: u32| shot.is_multiple_of(10);
    let part = |is_empty: fn(u32) -> bool| smoothness_of(late, is_empty).displaced_part(0);
    assert!((0.05..0.12).contains(&part(|shot| shot % 3 == 2)), "{}", part(|shot| shot % 3 == 2));
    assert_eq!(part(|shot| shot % 3 != 0), 0.0, "neighbours are three shots apart");
}

/// Recording with these second differences, ns; the interval is 1 ns.
fn differences(of: impl Fn(usize) -> f64) -> Smoothness {
    let made_ns: Vec<[f64; REFERENCES]> = (0..1000).map(|i| [of(i); REFERENCES]).collect();
    Smoothness { interval_ns: 1.0, points_ns: made_ns.clone(), spaced_ns: made_ns, ..Smoothness::by(WITHOUT) }
}

#[test]
fn the_limit_of_displaced_shots_follows_the_spread() {
    let part = |usual: f64, displaced: f64| {
        differences(|i| if i % 20 == 0 { displaced } else { usual }).displaced_part(0)
    };
    assert_eq!(part(0.01, 2.0), 0.05);
    assert_eq!(part(0.1, 2.25), 0.05);
    assert_eq!(part(0.01, 2.25), 0.0);
}

#[test]
fn jumps_among_rough_points_disprove_the_bound_of_the_clock() {
    let clock_sd_ns = |jumps: usize| {
        differences(|i| if i % 25 < jumps { 1.0 } else { 0.9 * random(i) - 0.45 }).clock_sd_ns()
    };
    assert_eq!(clock_sd_ns(2), None);
    assert!(clock_sd_ns(0).is_some());
}

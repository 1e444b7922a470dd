use std::sync::Arc;

use super::*;
use crate::scan_line::{InputInfo, OnlineReturn};
use crate::stage::Result;

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
            };
            let origin_ns = if made == Made::MovingOrigin { -outgoing } else { 0.0 };
            emissions.push(Emission {
                shot: shot as u64,
                origin_m: [i as f64, 0.0, -origin_ns * METRES_PER_NS],
                ..Emission::default()
            });
            let index = i as u32;
            if made != Made::Locations {
                blocks.push(index, Channel::Reference, None, 0.0, 1.0, &pulse(outgoing));
            } else {
                let online = OnlineReturn { emission: index, time_ns: flight_ns.round(), amplitude: 1.0 };
                blocks.online.push(online);
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
    let references = if made == Made::Locations { WITH_LOCATIONS } else { WITH_OUTGOING };
    let found = Smoothness::look_ahead(&mut recording(made, lines, roughness_ns), references);
    let choice = found.choose(default, false);
    (found, choice)
}

fn finding(choice: &Choice) -> &str {
    match &choice.message {
        Some(Message::Finding(text)) => text,
        _ => "",
    }
}

fn warning(choice: &Choice) -> &str {
    match &choice.message {
        Some(Message::Warning(text)) => text,
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
            assert!(found.text().ends_with("(robust SD of 980)"), "{}", found.text());
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
        let crate::scan_line::Content::Shots(blocks) = &mut line.content else { panic!("shots") };
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

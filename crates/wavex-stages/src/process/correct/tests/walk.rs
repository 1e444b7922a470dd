//! The delay by amplitude.

use super::*;
use wavex_returns::range_walk::{DelayNode, RangeWalk};

/// A random number generator with normal values.
struct Random(u64);

impl Random {
    fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (self.0 >> 33) as f64 / (1u64 << 31) as f64
    }

    /// Sum of twelve uniform values.
    fn normal(&mut self) -> f64 {
        (0..12).map(|_| self.uniform()).sum::<f64>() - 6.0
    }
}

/// Delay of the receiver, ns.
fn late_ns(amplitude_dn: f64) -> f64 {
    -0.03 * (amplitude_dn / 90.0).ln()
}

/// 60 lines of 200 single returns on level ground; `time_ns` is the time of an amplitude and of a
/// patch of ground.
fn lines(seed: u64, time_ns: impl Fn(f64, bool) -> f64) -> Vec<ScanLine> {
    let mut random = Random(seed);
    let mut line = |line: u32| {
        let mut is_bright = false;
        let mut single = |shot: u32| {
            if shot.is_multiple_of(6) {
                is_bright = random.uniform() < 0.5;
            }
            let amplitude_dn = (90.0 * (0.3 * random.normal()).exp()).clamp(20.0, 200.0);
            let noise_ns = 0.06 * random.normal();
            let mut r =
                found(ReturnChannel::Low, 6000.0 + time_ns(amplitude_dn, is_bright) + noise_ns, amplitude_dn);
            (r.emission, r.width_ratio) = (shot, 1.0);
            r
        };
        let mut scan_line = line_of(map(), (0..200).map(&mut single).collect());
        scan_line.emissions = vec![emission([0.0, 0.0, -1.0]); 200];
        scan_line.line = line;
        scan_line
    };
    (0..60).map(&mut line).collect()
}

fn keys(range_walk: WalkKey) -> Correct {
    Correct { range_table: TableKey::Own(true), range_walk, ..nothing() }
}

fn times_ns(lines: &[ScanLine]) -> Vec<f64> {
    lines.iter().flat_map(|line| line.returns().unwrap()).map(|r| r.time_of_flight_ns).collect()
}

/// Slope of the times over `ln a`, ns.
fn slope_ns(lines: &[ScanLine]) -> f64 {
    let returns = lines.iter().flat_map(|line| line.returns().unwrap());
    let (mut products, mut squares) = (0.0, 0.0);
    for r in returns {
        let x = (r.amplitude_dn / 90.0).ln();
        products += x * (r.time_of_flight_ns - 6000.0);
        squares += x * x;
    }
    products / squares
}

/// Largest SD of the times of flight, ns.
fn most_sd_ns(lines: &[ScanLine]) -> f64 {
    let returns = lines.iter().flat_map(|line| line.returns().unwrap());
    returns.map(|r| r.time_of_flight_sd_ns).fold(0.0, f64::max)
}

#[test]
fn a_delay_is_removed_only_if_it_is_proven() {
    let (mut proven, mut refused) = (0, 0);
    for seed in 0..8 {
        let before = lines(seed, |dn, _| late_ns(dn));
        let recorded = lines(seed, |dn, _| late_ns(dn));
        let (after, _, findings) = run_with_findings(&keys(WalkKey::Auto(Auto::Auto)), recorded);
        if findings[0].contains("ranges are corrected for the delay by amplitude") {
            proven += 1;
            assert!(
                findings[0].contains("Proof: the delay from one half of the lines explains"),
                "{findings:?}"
            );
            assert!(slope_ns(&after).abs() < 0.012 && slope_ns(&before) < -0.025, "{}", slope_ns(&after));
        } else {
            refused += 1;
            assert!(findings[0].contains("because it is not proven"), "{findings:?}");
            assert_eq!(times_ns(&after), times_ns(&before));
            assert!(most_sd_ns(&after) > 0.035, "the walk that was seen enters the standard deviations");
        }
    }
    assert!(proven >= 1, "{proven} proven, {refused} refused");
}

#[test]
fn without_being_asked_nothing_is_learnt() {
    for key in [WalkKey::Loaded(Loaded::Model), WalkKey::Without(false)] {
        let before = lines(1, |dn, _| late_ns(dn));
        let (after, _, findings) = run_with_findings(&keys(key), lines(1, |dn, _| late_ns(dn)));
        assert_eq!((times_ns(&after), findings), (times_ns(&before), Vec::new()));
        assert_eq!(most_sd_ns(&after), 0.03);
    }
    assert_eq!(Correct::default().range_walk, WalkKey::Loaded(Loaded::Model));
}

#[test]
fn ground_that_follows_its_reflectance_is_refused() {
    for seed in 0..4 {
        let mut before = lines(seed, |_, is_bright| if is_bright { 0.15 } else { 0.0 });
        for line in &mut before {
            let Content::Returns(returns) = &mut line.content else { unreachable!() };
            for r in returns {
                r.amplitude_dn *= if r.time_of_flight_ns > 6000.075 { 1.2 } else { 0.8 };
            }
        }
        let before_ns = times_ns(&before);
        let (after, _, findings) = run_with_findings(&keys(WalkKey::Auto(Auto::Auto)), before);
        assert!(findings[0].contains("because it is not proven"), "{findings:?}");
        assert_eq!(times_ns(&after), before_ns);
    }
}

/// A model whose low-power receiver has this delay.
fn model() -> wavex_signal::sensor_model::SensorModel {
    let node =
        |amplitude_dn: f64| DelayNode { amplitude_dn, late_ns: late_ns(amplitude_dn), late_sd_ns: 0.0001 };
    wavex_signal::sensor_model::SensorModel {
        low_power_range_walk: Some(RangeWalk {
            reference_dn: 90.0,
            amplitudes_dn: [20.0, 200.0],
            nodes: [10.0, 300.0].map(node).to_vec(),
            triples: 5000,
        }),
        ..Default::default()
    }
}

#[test]
fn the_walk_of_the_loaded_model_is_used_and_kept() {
    for key in [WalkKey::Loaded(Loaded::Model), WalkKey::Auto(Auto::Auto)] {
        let mut before = lines(2, |dn, _| late_ns(dn));
        before.iter_mut().for_each(|line| line.model = Some(Arc::new(model())));
        let (after, _, findings) = run_with_findings(&keys(key), before);
        assert!(findings[0].contains("of the loaded sensor model"), "{findings:?}");
        assert!(slope_ns(&after).abs() < 0.012, "{}", slope_ns(&after));
        assert!(after.iter().all(|line| line.stats.np_ibrc > 100));
    }
}

#[test]
fn keys_of_the_walk_are_checked() {
    let error = |keys: Correct| format!("{:?}", keys.check().unwrap_err());
    for range_walk in [WalkKey::Without(false), WalkKey::Loaded(Loaded::Model)] {
        let save_model = Some("model.json".into());
        let unsaved = Correct { range_walk, save_model, ..Correct::default() };
        assert!(error(unsaved).contains("it saves the range walk"));
    }
    let of = |text: &str| toml::from_str::<Correct>(text).unwrap().range_walk;
    assert_eq!(of("range_walk = 'auto'"), WalkKey::Auto(Auto::Auto));
    assert_eq!(of("range_walk = 'model'"), WalkKey::Loaded(Loaded::Model));
    assert_eq!(of("range_walk = 'model.json'"), WalkKey::File("model.json".into()));
}

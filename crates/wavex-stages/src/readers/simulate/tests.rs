use std::path::PathBuf;

use proptest::prelude::*;

use super::*;
use wavex_line::scan_line::{Block, Blocks, Channel, emission_flags};
use wavex_line::stage::Config;
use wavex_simulation::pulse::{FWHM_OF_NORMAL, PulseShape};
use wavex_simulation::truth::{COLUMNS, TrueReturn};
use wavex_simulation::{GROUP_VELOCITY_MPS, time_of_flight_ns};

mod instrument;
mod keys;
mod mta_ordering;
mod trajectory;

/// Flight over empty level ground.
fn bare() -> Simulate {
    Simulate { building_height_m: 0.0, canopy_height_m: 0.0, dropout_rate: 0.0, ..Simulate::default() }
}

fn lines(config: &Simulate, lines: std::ops::Range<u32>) -> Vec<(ScanLine, Vec<TrueReturn>)> {
    let mut flight = SimulatedFlight::new(config).unwrap();
    lines.map(|line| flight.line(line)).collect()
}

fn blocks_of(blocks: &Blocks, emission: usize, channel: Channel) -> impl Iterator<Item = &Block> {
    blocks.iter().filter(move |block| block.emission as usize == emission && block.channel == channel)
}

/// Time of the highest sample, ns after the shot's clock.
///
/// Refined by the parabola through the logarithms of the sample and its neighbours, which is exact
/// for a Gaussian.
fn gaussian_peak_ns(samples: &[u16], block: &Block, background_dn: f64) -> f64 {
    let top = (1..samples.len() - 1).max_by_key(|&k| samples[k]).unwrap();
    let [a, b, c] = [top - 1, top, top + 1].map(|k| (f64::from(samples[k]) - background_dn).ln());
    block.time_ns(top as f64 + 0.5 * (a - c) / (a - 2.0 * b + c))
}

#[test]
fn the_first_shot_spelled_out() {
    let (scan_line, truth) = &lines(&Simulate::default(), 0..1)[0];
    let blocks = scan_line.blocks().unwrap();
    let first: Vec<_> = blocks.iter().take(2).map(|block| (block.start_ns, blocks.samples(block))).collect();
    let pulse: &[u16] =
        &[3, 3, 2, 2, 2, 4, 12, 37, 84, 141, 179, 172, 126, 72, 32, 13, 5, 4, 3, 2, 2, 2, 2, 3];
    let echo: &[u16] = &[
        2, 2, 2, 2, 1, 3, 1, 2, 2, 3, 3, 3, 3, 8, 20, 42, 66, 81, 76, 56, 34, 18, 9, 7, 7, 7, 6, 7, 6, 6, 5,
        5, 4, 5, 5, 3, 4, 3, 3, 3, 4, 4, 4, 3, 4, 4, 3, 4, 3, 4, 3, 4, 3, 3, 3, 2, 1, 2, 2, 2,
    ];
    assert_eq!(first, [(-10.0, pulse), (4606.375, echo)]);
    let emission = scan_line.emissions[0];
    assert_eq!(
        (emission.shot, emission.clock_ps, emission.gps_time_s),
        (0, 1_000_000_000_000_000, 208_800.0)
    );
    assert_eq!(emission.direction.map(f64::to_bits), [0xbfdfffffffffffff, 0, 0xbfebb67ae8584cab]);
    let returned = [truth[0].emission_ns, truth[0].time_of_flight_ns, truth[0].amplitude_dn];
    assert_eq!(returned.map(f64::to_bits), [0x3fd67d714792e1ca, 0x40b20f43530aa22e, 0x4053d4b1330666ca]);
}

#[test]
fn signal_free_samples_have_the_spread_and_correlation_that_were_asked_for() {
    // A background that keeps the noise above 0.
    let config = Simulate { background_dn: [20.18, 20.41], ..bare() };
    let (mut n, mut mean, mut products) = (0.0, [0.0; 2], [0.0; 5]);
    for (scan_line, _) in lines(&config, 0..60) {
        let blocks = scan_line.blocks().unwrap();
        for block in blocks.iter().filter(|block| block.channel == Channel::LowPower) {
            // Echoes are at sample 16 or later, and contribute nothing 8 samples before.
            let noise: [f64; 8] =
                core::array::from_fn(|k| f64::from(blocks.samples(block)[k]) - config.background_dn[k % 2]);
            n += 1.0;
            (0..8).for_each(|k| mean[k % 2] += noise[k] / 4.0);
            (0..5).for_each(|lag| {
                products[lag] += (lag..8).map(|k| noise[k] * noise[k - lag]).sum::<f64>() / (8 - lag) as f64
            });
        }
    }
    assert_eq!(n, 60_000.0);
    for mean in mean {
        assert!((mean / n).abs() < 0.015, "{}", mean / n);
    }
    let variance = products[0] / n;
    assert!((variance.sqrt() / 0.93 - 1.0).abs() < 0.006, "{}", variance.sqrt());
    for (product, wanted) in products[1..].iter().zip(&config.noise_autocorrelation) {
        let found = product / n / variance;
        assert!((found - wanted).abs() < 0.01, "{found} for {wanted}");
    }
}

/// Samples minus background and true echoes have a mean of 0 at every distance from the echo.
#[test]
fn the_mean_of_many_echoes_is_the_response() {
    for (response, shape) in
        [(Response::Riegl, PulseShape::riegl()), (Response::Gaussian, PulseShape::gaussian(4.5))]
    {
        let config = Simulate { response, background_dn: [20.18, 20.41], ..bare() };
        let variance = (shape.fwhm_ns() / FWHM_OF_NORMAL).powi(2);
        let (mut sums, mut counts) = (vec![0.0; 140], vec![0.0; 140]);
        for (scan_line, truth) in lines(&config, 0..20) {
            let blocks = scan_line.blocks().unwrap();
            for (truth, block) in truth.iter().zip(blocks.iter().filter(|b| b.channel == Channel::LowPower)) {
                let echo_ns = truth.emission_ns + truth.time_of_flight_ns;
                let widening = variance * (truth.width_ratio.powi(2) - 1.0);
                let energy = truth.amplitude_dn / shape.at(shape.peak_ns(widening), widening);
                for (k, &sample) in blocks.samples(block).iter().enumerate() {
                    let time_ns = block.time_ns(k as f64) - echo_ns;
                    let expected = config.background_dn[k % 2] + energy * shape.at(time_ns, widening);
                    let bin = ((time_ns + 20.0) * 2.0) as usize;
                    sums[bin] += f64::from(sample) - expected;
                    counts[bin] += 1.0;
                }
            }
        }
        assert!(counts.iter().filter(|&&n| n > 9000.0).count() > 100, "{counts:?}");
        for (bin, (sum, n)) in sums.iter().zip(&counts).enumerate().filter(|(_, (_, n))| **n > 100.0) {
            let z = sum / n / (0.93 / f64::sqrt(*n));
            assert!(z.abs() < 4.5, "{} ns from the echo: {} DN, z {z}", bin as f64 / 2.0 - 20.0, sum / n);
        }
    }
}

#[test]
fn without_noise_pulse_and_echo_peak_at_their_true_times() {
    let config = Simulate {
        noise_sd_dn: 0.0,
        background_dn: [20.0, 20.0],
        ground_amplitude_dn: 140.0,
        response: Response::Gaussian,
        ..bare()
    };
    let (mut n, mut sums) = (0.0, [0.0; 2]);
    for (scan_line, truth) in lines(&config, 0..3) {
        let blocks = scan_line.blocks().unwrap();
        for truth in truth.iter().filter(|truth| truth.amplitude_dn < 230.0) {
            let emission = (truth.shot % 1000) as usize;
            let peak_ns = |channel| {
                let block = blocks_of(blocks, emission, channel).next().unwrap();
                gaussian_peak_ns(blocks.samples(block), block, 20.0)
            };
            let (sent, received) = (peak_ns(Channel::Reference), peak_ns(Channel::LowPower));
            let errors = [sent - truth.emission_ns, received - sent - truth.time_of_flight_ns];
            assert!(errors.iter().all(|error| error.abs() < 0.06), "{errors:?} {truth:?}");
            n += 1.0;
            (0..2).for_each(|k| sums[k] += errors[k]);
        }
    }
    assert!(n > 2500.0);
    assert!(sums.iter().all(|sum| (sum / n).abs() < 0.0005), "{sums:?}");
}

#[test]
fn truth_agrees_with_the_geometry() {
    let config = Simulate::default();
    let mut returns = [0; 5];
    for (scan_line, truth) in lines(&config, 0..20) {
        for truth in truth {
            let emission = &scan_line.emissions[(truth.shot % 1000) as usize];
            assert_eq!(emission.shot, truth.shot);
            for axis in 0..3 {
                let at = emission.origin_m[axis] + truth.range_m * emission.direction[axis];
                assert!((at - truth.point_m[axis]).abs() < 1e-6);
            }
            assert!((truth.time_of_flight_ns * 1e-9 * GROUP_VELOCITY_MPS / 2.0 - truth.range_m).abs() < 1e-9);
            assert!((399.999..419.0).contains(&truth.point_m[2]), "{truth:?}");
            assert!(truth.width_ratio >= 1.0 && truth.amplitude_dn > 0.0);
            returns[usize::from(truth.number_of_returns)] += 1;
        }
    }
    assert!(returns[1..].iter().all(|&n| n > 100), "one to four returns: {returns:?}");
}

#[test]
fn every_emission_has_its_pulse_its_blocks_and_its_truth() {
    let config = Simulate { dropout_rate: 0.1, ..Simulate::default() };
    let (mut lost, mut saturated) = (0, 0);
    for (scan_line, truth) in lines(&config, 100..110) {
        let blocks = scan_line.blocks().unwrap();
        assert_eq!(scan_line.emissions.len(), 1000);
        assert_eq!(scan_line.stats.nw, blocks.waveforms() as u64);
        for (index, emission) in scan_line.emissions.iter().enumerate() {
            let rows: Vec<_> = truth.iter().filter(|truth| truth.shot == emission.shot).collect();
            let references: Vec<_> = blocks_of(blocks, index, Channel::Reference).collect();
            assert_eq!((references.len(), references[0].len()), (1, 24));
            let echoes: Vec<_> = blocks_of(blocks, index, Channel::LowPower).collect();
            assert!(echoes.iter().all(|block| block.len() % 60 == 0));
            assert!(echoes.windows(2).all(|pair| pair[0].time_ns(pair[0].len() as f64) <= pair[1].start_ns));
            assert_eq!(rows.is_empty(), echoes.is_empty(), "a block has returns, and a return has its block");
            lost += u32::from(rows.is_empty());
            for (number, row) in (1..).zip(&rows) {
                assert_eq!((row.return_number, usize::from(row.number_of_returns)), (number, rows.len()));
                let time_ns = row.emission_ns + row.time_of_flight_ns;
                let covers =
                    |block: &&Block| (block.start_ns..block.time_ns(block.len() as f64)).contains(&time_ns);
                assert!(echoes.iter().any(covers));
            }
        }
        let samples = blocks.iter().flat_map(|block| blocks.samples(block));
        saturated += samples.filter(|&&sample| sample == FULL_SCALE_DN).count();
    }
    assert!((900..1100).contains(&lost), "a tenth of the pulses is lost: {lost}");
    assert!(saturated > 0 && saturated < 2000, "bright roofs reach the digitiser's end: {saturated}");
}

#[test]
fn the_emission_lies_anywhere_between_two_samples() {
    let mut counts = [0.0; 20];
    for truth in lines(&bare(), 0..40).iter().flat_map(|(_, truth)| truth) {
        counts[(truth.emission_ns * 20.0) as usize] += 1.0;
    }
    let chi2: f64 = counts.iter().map(|n| (n - 2000.0f64).powi(2) / 2000.0).sum();
    assert!((5.0..45.0).contains(&chi2), "19 degrees of freedom, chi-square {chi2}");
}

#[test]
fn a_line_alone_is_the_line_in_sequence() {
    let config = Simulate::default();
    let text = |line: &(ScanLine, Vec<TrueReturn>)| format!("{:?} {:?}", line.0, line.1);
    let sequence = lines(&config, 0..6);
    let alone = SimulatedFlight::new(&config).unwrap().line(5);
    assert_eq!(text(&sequence[5]), text(&alone));
    assert_ne!(text(&sequence[4]), text(&alone));
    let other = SimulatedFlight::new(&Simulate { seed: 2, ..config }).unwrap().line(5);
    assert_ne!(text(&other), text(&alone));
}

/// All features together: modulated pulses in the air, moving aircraft, hills, houses, forests,
/// wires, water, two receivers, false echoes, a blind gap.
fn rich() -> Simulate {
    Simulate {
        lines: 6,
        shots_per_line: 400,
        scanner: ScannerKind::Oscillating,
        pulse_rate_hz: 400_000.0,
        modulation_ns: 17.0,
        flying_height_m: 1500.0,
        heading_deg: 35.0,
        roll_deg: 2.0,
        pitch_deg: 1.0,
        yaw_deg: 1.5,
        lever_arm_m: [0.3, -0.1, 0.5],
        boresight_deg: [0.2, -0.1, 0.3],
        landscape: Landscape::Country,
        relief_m: 120.0,
        house_ratio: 0.4,
        false_alarm_rate: 0.01,
        blind_gap_ns: 15.0,
        detector: DetectorKind::Riegl,
        high_power: true,
        high_power_from_dn: 60.0,
        ..Simulate::default()
    }
}

/// FNV-1a hash of a line's times, directions, samples and truth.
fn digest((scan_line, truth): &(ScanLine, Vec<TrueReturn>)) -> u64 {
    let mut bytes = Vec::new();
    for emission in &scan_line.emissions {
        bytes.extend(emission.clock_ps.to_le_bytes());
        emission.direction.iter().for_each(|d| bytes.extend(d.to_le_bytes()));
    }
    let blocks = scan_line.blocks().unwrap();
    for block in blocks.iter() {
        bytes.extend(block.start_ns.to_le_bytes());
        blocks.samples(block).iter().for_each(|sample| bytes.extend(sample.to_le_bytes()));
    }
    truth.iter().for_each(|row| row.write(&mut bytes, false));
    let step = |hash: u64, byte: &u8| (hash ^ u64::from(*byte)).wrapping_mul(0x100_0000_01b3);
    bytes.iter().fold(0xcbf2_9ce4_8422_2325, step)
}

/// The bytes of every part of the simulator are the same on every machine.
#[test]
fn lines_of_everything_have_these_bytes() {
    let in_map = Simulate { as_recorded: false, ..rich() };
    let in_scanner = Simulate { as_recorded: true, pof: Some("*.pof".to_owned()), ..rich() };
    let found = [in_map, in_scanner].map(|config| digest(&lines(&config, 0..2)[1]));
    assert_eq!(found, [12_939_115_138_710_305_480, 13_471_780_268_874_308_598]);
}

#[test]
fn any_kind_of_line_alone_is_the_line_in_sequence() {
    for as_recorded in [false, true] {
        use ScannerKind::{Circular, Oscillating, ParallelLines, RotatingPolygon};
        for scanner in [Oscillating, RotatingPolygon, ParallelLines, Circular] {
            let config =
                Simulate { as_recorded, scanner, sbet: as_recorded.then(|| "*.sbet".to_owned()), ..rich() };
            let sequence = lines(&config, 0..6);
            assert_eq!(digest(&sequence[4]), digest(&SimulatedFlight::new(&config).unwrap().line(4)));
            assert!(sequence.iter().map(|line| line.1.len()).sum::<usize>() > 2000);
        }
    }
}

#[test]
fn changing_the_noise_leaves_the_scene_as_it_was() {
    let quiet = Simulate { noise_sd_dn: 0.0, ..Simulate::default() };
    assert_eq!(lines(&quiet, 0..2)[1].1, lines(&Simulate::default(), 0..2)[1].1);
}

/// At 400 kHz and 2000 m several pulses are in the air: zones and times are relative to the causing
/// pulses.
#[test]
fn pulses_in_the_air_are_resolved() {
    let config = Simulate { flying_height_m: 2000.0, pulse_rate_hz: 400_000.0, ..Simulate::default() };
    let mut zones = [0; 10];
    for (scan_line, truth) in lines(&config, 0..2) {
        for truth in truth.iter().filter(|truth| truth.return_number == 1) {
            let zone = scan_line.emissions[(truth.shot % 1000) as usize].mta_zone.unwrap();
            let pulses = truth.time_of_flight_ns / 2500.0;
            // A block begins 16 samples before its echo.
            assert!((f64::from(zone)..f64::from(zone) + 1.01).contains(&pulses), "{zone} {pulses}");
            zones[zone as usize] += 1;
        }
    }
    assert!(zones[5] > 100 && zones[6] > 100 && zones[..5].iter().all(|&n| n == 0), "{zones:?}");
}

#[test]
fn the_recording_says_what_it_is() {
    let (scan_line, _) = &lines(&Simulate { stem: "demo".to_owned(), ..bare() }, 0..1)[0];
    let input = &scan_line.input;
    assert_eq!(
        (input.stem.as_str(), input.gps_week, input.recorded),
        ("demo", Some(2365), Some((126, 2025)))
    );
    let table = input.amplitude_low.as_ref().unwrap();
    // 70 DN above the background is ten times 7 DN. Whole steps are exact; between them the table
    // is linear.
    assert!((table.at(2.295 + 70.0) - 10.0).abs() < 1e-3);
    assert!((table.at(9.0) - 10.0 * (6.705f64 / 7.0).log10()).abs() < 1e-12);
    let last = scan_line.emissions.last().unwrap();
    assert!(last.flags & emission_flags::EDGE_OF_FLIGHT_LINE != 0);
    assert!(scan_line.emissions[0].flags & emission_flags::EDGE_OF_FLIGHT_LINE == 0);
    assert_eq!(last.scan_angle_deg, 30.0);
}

fn run(folder: &std::path::Path) -> RunContext {
    RunContext {
        input: PathBuf::new(),
        stem: "simulated".to_owned(),
        input_dir: folder.to_path_buf(),
        output_dir: folder.to_path_buf(),
        simd: wavex_simd::SimdLevel::best(),
        ..RunContext::alone("".as_ref())
    }
}

#[test]
fn the_table_of_truth_is_handed_over_once_it_is_whole() {
    let folder = tempfile::tempdir().unwrap();
    let config = Simulate { lines: 3, shots_per_line: 50, truth: Some("*_truth.csv".to_owned()), ..bare() };
    let (mut source, mut cx) = (config.make(&run(folder.path())).unwrap(), Context::default());
    let mut shots = 0;
    while let Some(scan_line) = source.next(&mut cx).unwrap() {
        shots += scan_line.emissions.len();
        assert!(cx.take_files().is_empty());
        assert_eq!(source.progress(), Some(f64::from(scan_line.line + 1) / 3.0));
    }
    assert!(source.next(&mut cx).unwrap().is_none(), "the end stays the end");
    let mut files = cx.take_files();
    assert_eq!((shots, files.len()), (150, 1));
    let path = files.pop().unwrap().publish().unwrap();
    assert_eq!(path, folder.path().join("simulated_truth.csv"));
    let text = std::fs::read_to_string(path).unwrap();
    let rows: Vec<&str> = text.lines().collect();
    assert_eq!((rows.len(), rows[0]), (151, COLUMNS));
    let range: f64 = rows[150].split(',').nth(5).unwrap().parse().unwrap();
    assert_eq!(range, lines(&config, 0..3)[2].1[49].range_m);
}

#[test]
fn a_run_that_ends_early_leaves_no_truth() {
    let folder = tempfile::tempdir().unwrap();
    let config = Simulate { truth: Some("*_truth.csv".to_owned()), ..bare() };
    let mut source = config.make(&run(folder.path())).unwrap();
    source.next(&mut Context::default()).unwrap();
    drop(source);
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
}

/// The demo's flight can be simulated in a short time.
#[test]
fn the_demonstration_starts_with_this_stage() {
    let job: toml::Table = include_str!("../../../../../jobs/demo.toml").parse().unwrap();
    let mut keys = job["stage"][0].as_table().unwrap().clone();
    assert_eq!(keys.remove("type").unwrap().as_str(), Some("simulate"));
    let config: Simulate = keys.try_into().unwrap();
    assert_eq!(config.check(), Ok(()));
    assert!(config.lines * config.shots_per_line <= 200_000);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(60))]

    /// For any valid keys, a line is complete and consistent with its truth.
    #[test]
    fn any_flight_can_be_flown(
        seed: u64,
        line in 0u32..1000,
        shots_per_line in 1u32..80,
        pulse_rate_hz in 1e3..2e6,
        (from, width) in (-60.0..59.0, 0.1..119.0),
        (flying_height_m, building_height_m, canopy_height_m) in (220.0..10_000.0, 0.0..200.0, 0.0..200.0),
        ground_amplitude_dn in 1.0..10_000.0,
        (noise_sd_dn, rho) in (0.5..100.0, -0.6..0.6),
    ) {
        let config = Simulate {
            seed,
            lines: 1000, shots_per_line, pulse_rate_hz, flying_height_m, building_height_m, canopy_height_m,
            ground_amplitude_dn, noise_sd_dn,
            scan_angle_deg: [from, f64::min(from + width, 60.0)],
            noise_autocorrelation: vec![rho],
            ..Simulate::default()
        };
        prop_assert_eq!(config.check(), Ok(()));
        let (scan_line, truth) = SimulatedFlight::new(&config).unwrap().line(line);
        let blocks = scan_line.blocks().unwrap();
        prop_assert_eq!(scan_line.emissions.len(), shots_per_line as usize);
        prop_assert!(scan_line.emissions.windows(2).all(|pair| pair[0].clock_ps <= pair[1].clock_ps));
        prop_assert!(blocks.iter().all(|block| blocks.samples(block).iter().all(|&dn| dn <= FULL_SCALE_DN)));
        for truth in truth {
            prop_assert!((time_of_flight_ns(truth.range_m) - truth.time_of_flight_ns).abs() < 1e-9);
            let index = (truth.shot % u64::from(shots_per_line)) as usize;
            let time_ns = truth.emission_ns + truth.time_of_flight_ns;
            let covers = |block: &Block| (block.start_ns..block.time_ns(block.len() as f64)).contains(&time_ns);
            prop_assert!(blocks_of(blocks, index, Channel::LowPower).any(covers));
        }
    }
}

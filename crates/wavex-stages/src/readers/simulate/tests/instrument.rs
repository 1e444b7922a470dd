//! Two receivers, false alarms, modulated pulses and the gap around emissions.

use super::*;
use wavex_simulation::scene::Class;

#[test]
fn the_second_receiver_begins_later_by_a_constant_and_changes_nothing_in_the_first() {
    let config = Simulate { as_recorded: false, ..rich() };
    let alone = lines(&Simulate { high_power: false, ..config.clone() }, 0..2);
    let mut strong = 0;
    for ((scan_line, truth), (one, _)) in lines(&config, 0..2).iter().zip(&alone) {
        let blocks = scan_line.blocks().unwrap();
        let low = |b: &&Block| b.channel == Channel::LowPower;
        let mut low_blocks = blocks.iter().filter(low).map(|b| (b.start_ns, blocks.samples(b).to_vec()));
        let one = one.blocks().unwrap();
        assert!(
            low_blocks.all(|b| one.iter().filter(low).any(|o| (o.start_ns, one.samples(o)) == (b.0, &b.1)))
        );
        for pair in blocks.iter().collect::<Vec<_>>().windows(2) {
            if pair[1].channel == Channel::HighPower {
                assert_eq!((pair[0].channel, pair[0].emission), (Channel::LowPower, pair[1].emission));
                assert!((pair[1].start_ns - pair[0].start_ns - 1.43).abs() < 1e-9);
                assert_eq!(pair[0].zone, pair[1].zone);
                strong += 1;
            }
        }
        for row in truth.iter().filter(|row| row.amplitude_dn >= 60.0) {
            assert!(row.in_high_power && row.linear_dn >= row.amplitude_dn, "{row:?}");
        }
    }
    assert!(strong > 100, "{strong}");
}

/// Level ground in both receivers: the ratio of the peaks is the gain, and the times differ by the delay.
#[test]
fn both_receivers_see_the_same_echo() {
    let config = Simulate {
        high_power: true,
        high_power_from_dn: 0.0,
        high_power_delay_ns: 0.4,
        noise_sd_dn: 0.0,
        high_power_noise_sd_dn: 0.0,
        background_dn: [20.0, 20.0],
        ground_amplitude_dn: 1500.0,
        response: Response::Gaussian,
        ..bare()
    };
    let (mut n, mut off_ns, mut gain) = (0.0, 0.0, 0.0);
    for (scan_line, truth) in lines(&config, 0..3) {
        let blocks = scan_line.blocks().unwrap();
        for truth in truth.iter().filter(|truth| (800.0..2000.0).contains(&truth.linear_dn)) {
            let block = blocks_of(blocks, (truth.shot % 1000) as usize, Channel::HighPower).next().unwrap();
            let samples = blocks.samples(block);
            let peak_ns = gaussian_peak_ns(samples, block, 20.0);
            n += 1.0;
            off_ns += peak_ns - truth.emission_ns - truth.time_of_flight_ns;
            gain += (f64::from(*samples.iter().max().unwrap()) - 20.0) / truth.linear_dn;
        }
    }
    assert!(n > 1000.0 && (off_ns / n - 0.4).abs() < 0.001, "{n} {}", off_ns / n);
    // The highest of the samples lies up to half a sample from the peak.
    assert!((0.097..0.1).contains(&(gain / n)), "{}", gain / n);
}

#[test]
fn false_alarms_have_their_rate_and_their_name() {
    let config = Simulate { false_alarm_rate: 0.05, ..bare() };
    let rows: Vec<TrueReturn> = lines(&config, 0..20).into_iter().flat_map(|line| line.1).collect();
    let alarms = rows.iter().filter(|row| row.class == Class::FalseAlarm).count();
    assert!((900..1100).contains(&alarms), "{alarms} of 20 000");
    assert!(rows.iter().all(|row| row.class != Class::FalseAlarm || (5.5..11.0).contains(&row.amplitude_dn)));
    let quiet: Vec<TrueReturn> = lines(&bare(), 0..20).into_iter().flat_map(|line| line.1).collect();
    let same = |row: &TrueReturn| (row.shot, row.range_m.to_bits());
    let others: Vec<_> = rows.iter().filter(|row| row.class != Class::FalseAlarm).map(same).collect();
    assert_eq!(others, quiet.iter().map(same).collect::<Vec<_>>(), "the others stay as they were");
}

/// With modulation the zone counts emissions, not intervals of the mean rate.
#[test]
fn zones_of_modulated_pulses_are_counted() {
    let config = Simulate { as_recorded: false, false_alarm_rate: 0.0, ..rich() };
    let scanner = config.scanner();
    let tick = |number: u64| scanner.tick_ns((number / 400) as u32, (number % 400) as u32);
    for (scan_line, truth) in lines(&config, 0..3) {
        let blocks = scan_line.blocks().unwrap();
        for block in blocks.iter().filter(|block| block.channel == Channel::LowPower) {
            let emission = &scan_line.emissions[block.emission as usize];
            let zone = block.zone.or(emission.mta_zone).unwrap() as u64;
            let at_ns = tick(emission.shot) as f64 + block.start_ns;
            assert!(
                tick(emission.shot + zone) as f64 <= at_ns && at_ns < tick(emission.shot + zone + 1) as f64
            );
        }
        assert!(truth.iter().all(|row| (3..7).contains(&row.zone)));
    }
}

#[test]
fn nothing_is_recorded_around_an_emission() {
    let config = Simulate { as_recorded: false, false_alarm_rate: 0.5, blind_gap_ns: 100.0, ..rich() };
    let scanner = config.scanner();
    let ticks: Vec<i64> =
        (0..6).flat_map(|l| (0..400).map(move |k| (l, k))).map(|(l, k)| scanner.tick_ns(l, k)).collect();
    let to_emission_ns = |row: &TrueReturn| {
        let at_ns = ticks[row.shot as usize] as f64 + row.emission_ns + row.time_of_flight_ns;
        let after = ticks.partition_point(|&tick| (tick as f64) < at_ns);
        let near = ticks[after.saturating_sub(1)..(after + 1).min(ticks.len())].iter();
        near.map(|&tick| (tick as f64 - at_ns).abs()).fold(f64::INFINITY, f64::min)
    };
    let rows = |config: &Simulate| -> Vec<TrueReturn> {
        lines(config, 0..6).into_iter().flat_map(|line| line.1).collect()
    };
    let (gapped, all) = (rows(&config), rows(&Simulate { blind_gap_ns: 0.0, ..config }));
    assert!(gapped.iter().all(|row| to_emission_ns(row) > 100.0));
    let outside = all.iter().filter(|row| to_emission_ns(row) > 100.0).count();
    // A weak echo next to one in the gap may have been in that block only.
    assert!(
        gapped.len() <= outside && gapped.len() > outside - outside / 50,
        "{} {outside} {}",
        gapped.len(),
        all.len()
    );
}

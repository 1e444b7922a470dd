//! Lines whose blocks belong to the latest shot before their reception.

use std::collections::BTreeSet;

use super::*;
use wavex_simulation::scene::Class;

/// Times of a line's blocks, ns on the instrument's clock, by channel.
fn starts_ns(line: &ScanLine) -> Vec<(Channel, f64)> {
    let absolute =
        |block: &Block| line.emissions[block.emission as usize].clock_ps as f64 / 1000.0 + block.start_ns;
    line.blocks().unwrap().iter().map(|block| (block.channel, absolute(block))).collect()
}

#[test]
fn blocks_stand_with_the_last_shot_before_them() {
    for scanner in [ScannerKind::Oscillating, ScannerKind::RotatingPolygon] {
        let flown = lines(&Simulate { as_recorded: true, scanner, ..rich() }, 0..6);
        let clocks: Vec<i64> =
            flown.iter().flat_map(|(line, _)| line.emissions.iter().map(|e| e.clock_ps)).collect();
        for (line, _) in &flown {
            assert!(line.emissions.iter().all(|emission| emission.mta_zone.is_none()));
            for block in line.blocks().unwrap().iter().filter(|block| block.channel == Channel::LowPower) {
                let shot = line.emissions[block.emission as usize].shot as usize;
                let next_ns = clocks
                    .get(shot + 1)
                    .map_or(f64::INFINITY, |clock| (clock - clocks[shot]) as f64 / 1000.0);
                assert!((0.0..next_ns).contains(&block.start_ns), "{shot}: {}", block.start_ns);
                assert_eq!(block.zone, None);
            }
        }
    }
}

/// Every true return is in a block of the shot given by its zone, and the emitting shot and the range say
/// where.
#[test]
fn truth_leads_to_the_block() {
    let flown = lines(&Simulate { as_recorded: true, ..rich() }, 0..6);
    let mut zones = [0; 12];
    for row in flown.iter().flat_map(|(_, truth)| truth) {
        let of = |number: u64| (&flown[(number / 400) as usize].0, (number % 400) as usize);
        let (emitter, emitted) = of(row.shot);
        let (receiver, received) = of(row.shot + row.zone as u64);
        let clock_ns = (receiver.emissions[received].clock_ps - emitter.emissions[emitted].clock_ps) / 1000;
        let at_ns = row.emission_ns + row.time_of_flight_ns - clock_ns as f64;
        let blocks = receiver.blocks().unwrap();
        let covers = |channel| {
            blocks_of(blocks, received, channel)
                .any(|block| (block.start_ns - 1.5..block.time_ns(block.len() as f64)).contains(&at_ns))
        };
        assert!(covers(Channel::LowPower), "{row:?}");
        assert_eq!(row.in_high_power, covers(Channel::HighPower), "{row:?}");
        // No pulse is emitted after the last shots; false alarms occur at any time.
        if row.shot < 2390 && row.class != Class::FalseAlarm {
            zones[row.zone as usize] += 1;
        }
    }
    assert!(zones[4] > 1000 && zones[..3].iter().all(|&n| n == 0), "{zones:?}");
}

/// The same flight, sorted by the shots that caused the blocks: the same returns and blocks, but for those where it
/// matters that blocks begin on even samples of another clock.
#[test]
fn recorded_and_resolved_are_the_same_flight() {
    let config = Simulate { false_alarm_rate: 0.0, ..rich() };
    let (recorded, resolved) =
        (lines(&Simulate { as_recorded: true, ..config.clone() }, 0..6), lines(&config, 0..6));
    let rows = |flown: &[(ScanLine, Vec<TrueReturn>)]| -> BTreeSet<(u64, u64)> {
        let rows = flown.iter().flat_map(|(_, truth)| truth);
        rows.map(|row| (row.shot, row.range_m.to_bits())).collect()
    };
    let (a, b) = (rows(&recorded), rows(&resolved));
    let (differ, n) = (a.symmetric_difference(&b).count(), a.len());
    assert!(n > 3000 && differ < n / 200, "{differ} of {n}");

    let blocks = |flown: &[(ScanLine, Vec<TrueReturn>)]| {
        let mut all: Vec<f64> = Vec::new();
        for (line, _) in flown {
            let low = starts_ns(line).into_iter().filter(|block| block.0 == Channel::LowPower);
            all.extend(low.map(|block| block.1));
        }
        all.sort_by(f64::total_cmp);
        all
    };
    let (a, b) = (blocks(&recorded), blocks(&resolved));
    let near = |at: &f64| {
        let after = b.partition_point(|start| start < at);
        b[after.saturating_sub(1)..(after + 1).min(b.len())].iter().any(|start| (start - at).abs() < 1.5)
    };
    let met = a.iter().filter(|at| near(at)).count();
    assert!(a.len() > 1500 && met > a.len() - a.len() / 200, "{met} of {} and {}", a.len(), b.len());
}

/// A short line receives echoes of shots of many earlier lines; none is lost or doubled.
#[test]
fn lines_of_one_shot_are_lines_like_others() {
    let config = Simulate { shots_per_line: 1, lines: 300, as_recorded: true, blind_gap_ns: 0.0, ..rich() };
    let short = lines(&config, 0..300);
    let long = lines(&Simulate { shots_per_line: 1, lines: 300, blind_gap_ns: 0.0, ..rich() }, 0..300);
    let count = |flown: &[(ScanLine, Vec<TrueReturn>)]| {
        let blocks = flown.iter().flat_map(|(line, _)| line.blocks().unwrap().iter());
        let echoes = blocks.filter(|block| block.channel == Channel::LowPower).count();
        (echoes, flown.iter().map(|(_, truth)| truth.len()).sum::<usize>())
    };
    assert_eq!(count(&short), count(&long));
    assert!(count(&short).0 > 250);
    let zones: Vec<i16> = short.iter().flat_map(|(_, truth)| truth.iter().map(|row| row.zone)).collect();
    assert!(zones[..200].iter().all(|zone| (3..7).contains(zone)), "{zones:?}");
}

use std::path::Path;

use super::*;
use wavex_line::stage::Context;

/// A line of shots, 2500 ns apart from `start_ps` on, straight down, with times.
fn line(
    input: &Arc<InputInfo>,
    number: u32,
    shots: std::ops::Range<u64>,
    start_ps: i64,
    blocks: Blocks,
) -> ScanLine {
    let emission = |shot: u64| {
        let clock_ps = start_ps + (shot - shots.start) as i64 * 2_500_000;
        Emission {
            shot,
            clock_ps,
            gps_time_s: 100.0 + clock_ps as f64 * 1e-12,
            facet: (number % 2) as u16,
            flags: emission_flags::SYNCHRONISED,
            mta_zone: Some(0),
            scan_angle_deg: shot as f32 - 2.0,
            ..Emission::default()
        }
    };
    ScanLine::of_shots(Arc::clone(input), number, shots.clone().map(emission).collect(), blocks)
}

fn input() -> Arc<InputInfo> {
    Arc::new(InputInfo {
        full_scale_dn: Some(255),
        group_velocity_mps: 3e8,
        emission_reference: EmissionReference::OutgoingPulse,
        ..InputInfo::default()
    })
}

/// Two lines; shot 0 has a reference block and two echo blocks, shot 3 a saturated block of zone 1.
fn surveyed(with_samples: bool) -> Inspection {
    let input = input();
    let mut first = Blocks::default();
    first.push(0, Channel::Reference, None, -2.0, 1.0, &[0, 10, 40, 30, 5]);
    first.push(0, Channel::LowPower, None, 1000.0, 1.0, &[1, 2, 20, 2, 1, 0]);
    first.push(0, Channel::HighPower, None, 1001.5, 1.0, &[1, 3, 9, 3]);
    first.online.push(wavex_line::scan_line::OnlineReturn { emission: 0, time_ns: 1002.0, amplitude: 3.0 });
    let mut second = Blocks::default();
    second.push(0, Channel::LowPower, Some(1), 2000.0, 1.0, &[7, 255, 255, 7]);
    let mut inspection = Inspection::new(with_samples);
    inspection.add(&line(&input, 0, 0..3, 0, first));
    inspection.add(&line(&input, 1, 3..5, 20_000_000, second));
    inspection.finish();
    inspection
}

#[test]
fn shots_lines_and_times_are_counted() {
    let inspection = surveyed(true);
    let shots = &inspection.shots;
    assert_eq!((shots.count, shots.with_echoes, shots.synchronised, shots.online), (5, 2, 5, [1, 1]));
    assert_eq!(shots.by_facet, BTreeMap::from([(0, 3), (1, 2)]));
    assert_eq!((inspection.lines.count, inspection.lines.shots.range()), (2, Some([2.0, 3.0])));
    assert_eq!(inspection.times.first_last_s, Some([100.0, 100.0 + 22.5e-6]));
    assert_eq!(inspection.times.shots.usual_ps(), Some([2_500_000.0, 0.0]));
    assert_eq!(inspection.times.lines.usual_ps(), Some([20_000_000.0, 0.0]));
    assert_eq!((inspection.times.without, inspection.times.backwards), (0, (0, None)));
    assert_eq!((inspection.angle, inspection.angles_deg.range()), (Some(Angle::Scan), Some([-2.0, 2.0])));
    assert_eq!(inspection.angles_over_time.items()[1][1], -1.0);
}

#[test]
fn inspection_lists_channels_zones_and_ranges() {
    let inspection = surveyed(true);
    let low = inspection.channel(Channel::LowPower);
    assert_eq!((low.blocks, low.samples, low.lengths.range()), (2, 10, Some([4.0, 6.0])));
    assert_eq!(low.starts_ns.range(), Some([1000.0, 2000.0]));
    assert_eq!(low.values.as_ref().unwrap().saturated(), Some([2, 1]));
    assert_eq!(inspection.channel(Channel::Saturation).blocks, 0);
    assert_eq!(inspection.zones, BTreeMap::from([(Some(0), 2), (Some(1), 1)]));
    assert_eq!(inspection.blocks_per_shot.bins().collect::<Vec<_>>(), [(0.0, 3), (1.0, 1), (2.0, 1)]);
    // The parabola of the outgoing pulse peaks at sample 2.25, 0.25 ns after the clock; the parabola of
    // the low-power echo peaks at 1002 ns.
    let [nearest_m, farthest_m] = inspection.ranges_m.range().unwrap();
    assert!((nearest_m - (1002.0 - 0.25) * 0.15).abs() < 1e-9, "{nearest_m}");
    assert!((farthest_m - 2001.5 * 0.15).abs() < 1e-9, "{farthest_m}");
    let shown = inspection.waveforms.items();
    assert_eq!((shown.len(), shown[0].shot, shown[0].blocks.len()), (2, 0, 2));
    assert_eq!(shown[1].blocks[0].samples_dn, [7, 255, 255, 7]);
}

#[test]
fn without_samples_all_else_is_the_same() {
    let (with, without) = (surveyed(true), surveyed(false));
    assert!(without.ranges_m.is_empty() && without.waveforms.items().is_empty());
    assert!(without.channels.iter().all(|channel| channel.values.is_none()));
    for (a, b) in with.channels.iter().zip(&without.channels) {
        assert_eq!(
            (a.blocks, a.samples, &a.lengths, &a.starts_ns),
            (b.blocks, b.samples, &b.lengths, &b.starts_ns)
        );
    }
    assert_eq!((with.zones, with.angles_deg), (without.zones, without.angles_deg));
}

#[test]
fn a_clock_that_runs_backwards_and_shots_without_time_are_counted() {
    let input = input();
    let mut inspection = Inspection::new(false);
    inspection.add(&line(&input, 0, 0..3, 50_000_000, Blocks::default()));
    let mut back = line(&input, 1, 3..6, 0, Blocks::default());
    back.emissions.iter_mut().for_each(|emission| emission.gps_time_s = f64::NAN);
    inspection.add(&back);
    inspection.finish();
    assert_eq!((inspection.times.backwards, inspection.times.without), ((1, Some(3)), 3));
    assert_eq!(inspection.times.lines.count(), 0, "a backward step is not an interval");
    let text =
        RecordingSummary::of(Path::new("a.pls"), &inspection, Context::of_run().counters(), None).text();
    let said = "1 time, first at shot 3: shots are not in order of time, as in a clipped or merged file; each step begins \
                a scan line, which does not change the points of a shot\n";
    assert!(text.contains(said), "{text}");
    assert_eq!(inspection.blocks_per_shot.bins().collect::<Vec<_>>(), [(0.0, 6)]);
}

#[test]
fn parts_of_a_line_are_one_line() {
    let input = input();
    let mut inspection = Inspection::new(false);
    inspection.add(&line(&input, 7, 0..3, 0, Blocks::default()));
    inspection.add(&line(&input, 7, 3..5, 7_500_000, Blocks::default()));
    inspection.finish();
    assert_eq!((inspection.lines.count, inspection.lines.shots.range()), (1, Some([5.0, 5.0])));
    assert_eq!(inspection.times.shots.count(), 4, "including the step between the parts");
}

#[test]
fn beams_without_scan_angles_have_an_angle_from_the_vertical() {
    let (sin, cos) = (0.5, 0.75f64.sqrt());
    let beam = |direction, origin_m| Emission { direction, origin_m, ..Emission::default() };
    let angle = |emission, frame| {
        let (angle, deg): (Angle, f64) = angle_of(&emission, frame);
        (angle, (deg * 1e9).round() / 1e9)
    };
    assert_eq!(angle(beam([sin, 0.0, -cos], [5e5, 5.2e6, 800.0]), Frame::Map), (Angle::FromNadir, 30.0));
    let geocentric = beam([-cos, sin, 0.0], [6.3e6, 0.0, 6e4]);
    assert!((angle(geocentric, Frame::Map).1 - 30.0).abs() < 0.6);
    assert_eq!(angle(beam([0.0, sin, cos], [0.0; 3]), Frame::Scanner), (Angle::FromAxis, 30.0));
}

//! Properties of the recordings that the stages rely on.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use super::peer::data;
use crate::pulsewaves::{PulseRecord, Reader, SegmentKind, TimeAxis, WaveSegments};

const EXAMPLE_3: &str = "pulsewaves/riegl_example3.pls";
const Q680I: &str = "riegl_q680i_dev/riegl_q680i_dev.pls";

/// Calls `each` with every pulse and its waves.
fn for_each(reader: &mut Reader, mut each: impl FnMut(&PulseRecord, &WaveSegments)) {
    let mut waves = WaveSegments::new();
    for index in 0..reader.pulse_count() {
        let pulse = reader.pulse(index).unwrap();
        reader.waves(&pulse, &mut waves).unwrap();
        each(&pulse, &waves);
    }
}

/// Returns the cells of a CSV file without its heading.
fn csv(path: &Path) -> Vec<Vec<String>> {
    let text = std::fs::read_to_string(path).unwrap();
    text.lines().skip(1).map(|line| line.split(',').map(str::to_string).collect()).collect()
}

/// Returns mean and standard deviation.
fn moments(values: &[f64]) -> (f64, f64) {
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    (mean, (values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (n - 1.0)).sqrt())
}

/// Returns the distance of a number from the nearest integer.
fn off_whole(value: f64) -> f64 {
    value - value.round()
}

#[test]
fn the_q680i_file_says_what_it_is() {
    let Some(data) = data() else { return };
    let reader = Reader::open(&data.join(Q680I)).unwrap();
    reader.check_complete().unwrap();
    let header = reader.header();
    assert_eq!((reader.pulse_count(), header.creation_day, header.creation_year), (607, 188, 2015));
    assert_eq!(header.system_identifier, "RiPROCESS 1.6.5.664");
    assert_eq!(header.time_axis(), TimeAxis::WeekSeconds);
    let scanner = &reader.scanners()[&1];
    assert_eq!((scanner.instrument.as_str(), scanner.serial.as_str()), ("Q680i", "9997848"));
    assert_eq!((scanner.mirror_facets, scanner.pulse_frequency_khz), (4, 400.0));
    let crs = reader.crs();
    let keys = crs.geo_keys.as_ref().unwrap();
    let key = |i: usize| u16::from_le_bytes([keys[2 * i], keys[2 * i + 1]]);
    assert_eq!(keys.len(), 8 * (1 + usize::from(key(3))));
    assert_eq!(crs.geo_doubles.as_deref(), Some(&[0; 64][..]));
    assert_eq!(
        crs.geo_ascii.as_deref(),
        Some(&b"UTM_North zone 33|WGS84|UTM_North zone 33|UTM_North zone 33|"[..])
    );
    assert_eq!((&crs.wkt, &crs.math_transform_wkt), (&None, &None));
    let appended: Vec<u32> = reader.records().iter().filter(|r| r.appended).map(|r| r.record_id).collect();
    assert_eq!((reader.records().len(), appended.len()), (18, 0));
}

#[test]
fn the_q680i_tables_are_the_instruments() {
    let Some(data) = data() else { return };
    let reader = Reader::open(&data.join(Q680I)).unwrap();
    let rows = csv(&data.join("riegl_q680i_dev/lookup_tables.csv"));
    let [low, high] = [1, 2].map(|index| &reader.tables()[&index]);
    assert_eq!((low.tables.len(), high.tables.len()), (1, 1));
    let [low, high] = [&low.tables[0], &high.tables[0]];
    assert_eq!(low.description, "amplitude conversion table for low channel");
    assert_eq!(high.description, "amplitude conversion table for high channel");
    assert_eq!((low.entries.len(), high.entries.len(), rows.len()), (256, 256, 256));
    for (step, row) in rows.iter().enumerate() {
        assert_eq!(row[0], step.to_string());
        for (found, expected) in [(low.entries[step], &row[1]), (high.entries[step], &row[2])] {
            let expected: f32 = expected.parse().unwrap();
            let same = if expected < -1e30 { found < -1e30 } else { (found - expected).abs() <= 5e-5 };
            assert!(same, "step {step}: {found} {expected}");
        }
    }
    for descriptor in reader.descriptors().values() {
        for sampling in &descriptor.samplings {
            assert_eq!(sampling.lookup_table_index, if sampling.channel == 0 { 2 } else { 1 });
        }
    }
}

#[test]
fn the_q680i_channels_are_reference_and_low_power() {
    let Some(data) = data() else { return };
    let mut reader = Reader::open(&data.join(Q680I)).unwrap();
    let mut seen: BTreeMap<(bool, u8, usize), usize> = BTreeMap::new();
    let mut facets = BTreeSet::new();
    for_each(&mut reader, |pulse, waves| {
        facets.insert((pulse.mirror_facet, pulse.scan_direction, pulse.edge_of_scan_line));
        for s in waves.segments() {
            *seen.entry((s.kind == SegmentKind::Outgoing, s.channel, s.sample_count())).or_default() += 1;
        }
    });
    let expected = [((false, 1, 60), 578), ((false, 1, 120), 30), ((true, 3, 24), 607)];
    assert_eq!(seen, BTreeMap::from(expected));
    assert_eq!(facets, (0..4).map(|facet| (facet, true, false)).collect());
}

#[test]
fn the_vendors_returns_lie_on_the_beams() {
    let Some(data) = data() else { return };
    let mut reader = Reader::open(&data.join(Q680I)).unwrap();
    let mut waves = WaveSegments::new();
    let rows = csv(&data.join("riegl_q680i_dev/riegl_q680i_dev_vendor_returns.csv"));
    assert_eq!(rows.len(), 667);
    for row in rows {
        let number = |column: usize| row[column].parse::<f64>().unwrap();
        let pulse = reader.pulse(number(1) as u64).unwrap();
        assert_eq!(pulse.t.to_string(), row[2]);
        reader.waves(&pulse, &mut waves).unwrap();
        let starts = waves.segments().iter().filter(|s| s.channel.to_string() == row[17]);
        let nearest = starts.map(|s| (s.duration_of(0.0) - number(16)).abs()).fold(f64::MAX, f64::min);
        assert!(nearest <= 1e-5, "{row:?}: {nearest}");
        let at = pulse.position(number(14));
        let distance = (0..3).map(|axis| (at[axis] - number(5 + axis)).powi(2)).sum::<f64>().sqrt();
        assert!((distance - number(15)).abs() <= 2e-4, "{row:?}: {distance}");
    }
}

/// Returns lengths from anchor to target, m, and the SD predicted from their rounding.
///
/// Both have uniform errors of one step, projected on the beam.
fn lengths(reader: &mut Reader) -> (Vec<f64>, f64) {
    let scale = reader.header().scale;
    let (mut lengths, mut variance) = (Vec::new(), 0.0);
    for index in 0..reader.pulse_count() {
        let step = reader.pulse(index).unwrap().step;
        let length = step.iter().map(|s| s * s).sum::<f64>().sqrt();
        lengths.push(1000.0 * length);
        variance += (0..3).map(|axis| (step[axis] / length * scale[axis]).powi(2) / 6.0).sum::<f64>();
    }
    let predicted = (variance / lengths.len() as f64).sqrt();
    (lengths, predicted)
}

#[test]
fn anchor_and_target_are_a_constant_apart_but_for_their_rounding() {
    let Some(data) = data() else { return };
    for (name, expected_m, step_m) in [(EXAMPLE_3, 149.856_897, 0.000_25), (Q680I, 149.855_255, 0.001)] {
        let mut reader = Reader::open(&data.join(name)).unwrap();
        let (lengths, predicted) = lengths(&mut reader);
        let (mean, sd) = moments(&lengths);
        let of_mean = predicted / (lengths.len() as f64).sqrt();
        println!("{name}: mean {mean:.6} m, sd {sd:.6} m, predicted {predicted:.6} m");
        assert!((mean - expected_m).abs() < 3.0 * of_mean, "{mean}");
        assert!((0.85..1.05).contains(&(sd / predicted)), "{sd} {predicted}");
        // The scale of the durations is a round distance divided by the same length, to the
        // precision of a 32-bit float.
        let scale = reader.descriptors()[&2].samplings[1].duration_scale;
        assert!((1000.0 * step_m / scale - expected_m).abs() < 1e-5, "{}", 1000.0 * step_m / scale);
    }
}

#[test]
fn outgoing_segments_start_nowhere_in_2013_and_on_a_whole_sample_before_the_anchor_in_2015() {
    let Some(data) = data() else { return };
    let mut counted = 0;
    for_each(&mut Reader::open(&data.join(EXAMPLE_3)).unwrap(), |_, waves| {
        assert_eq!((waves.segments()[0].kind, waves.segments()[0].duration), (SegmentKind::Outgoing, None));
        counted += 1;
    });
    assert_eq!(counted, 16_486);
    let (mut outgoing, mut returning, mut peaks) = (Vec::new(), Vec::new(), Vec::new());
    for_each(&mut Reader::open(&data.join(Q680I)).unwrap(), |_, waves| {
        for s in waves.segments() {
            let start = s.duration.unwrap();
            match s.kind {
                SegmentKind::Outgoing => {
                    assert!((-13.01..=-8.99).contains(&start));
                    outgoing.push(off_whole(start));
                    peaks.push(s.duration_of(peak(waves.samples(s))));
                }
                _ => returning.push(off_whole(start)),
            }
        }
    });
    let half_step = 0.5 / 149.855_255;
    assert!(outgoing.iter().all(|d| d.abs() <= half_step), "{:?}", moments(&outgoing));
    let (mean, sd) = moments(&returning);
    println!("2015: returning starts lie {mean:.4} off whole samples, sd {sd:.4}");
    assert!((mean + 0.0537).abs() < 0.0005 && sd < 0.0025, "{mean} {sd}");
    let (mean, sd) = moments(&peaks);
    println!("2015: outgoing peaks lie {mean:.3} samples after the anchor, sd {sd:.3}");
    assert!(peaks.iter().all(|p| p.abs() < 0.55));
    assert!((sd - (1.0_f64 / 12.0).sqrt()).abs() < 0.02, "{sd}");
}

/// Returns the peak position in samples.
///
/// A parabola through the logarithms of the three highest samples.
fn peak(samples: &[u16]) -> f64 {
    let k = (0..samples.len()).max_by_key(|&k| samples[k]).unwrap();
    let [a, b, c] = [k - 1, k, k + 1].map(|i| f64::from(samples[i]).ln());
    k as f64 + 0.5 * (a - c) / (a - 2.0 * b + c)
}

#[test]
fn returning_segments_of_2013_start_near_whole_samples() {
    let Some(data) = data() else { return };
    let mut starts = Vec::new();
    for_each(&mut Reader::open(&data.join(EXAMPLE_3)).unwrap(), |pulse, waves| {
        for s in &waves.segments()[1..] {
            starts.push(off_whole(s.duration.unwrap()));
        }
        let first = waves.segments()[1..].iter().filter_map(|s| s.duration).fold(f64::MAX, f64::min);
        assert_eq!(f64::from(pulse.first_returning_sample), first.round());
    });
    let (mean, sd) = moments(&starts);
    println!("2013: returning starts lie {mean:.4} off whole samples, sd {sd:.4}");
    assert!(starts.iter().all(|d| d.abs() < 0.05));
    assert!((mean - 0.0028).abs() < 0.0005 && (sd - 0.0147).abs() < 0.0005, "{mean} {sd}");
}

#[test]
fn the_time_axis_of_the_recordings() {
    let Some(data) = data() else { return };
    let axis = |name: &str| Reader::open(&data.join(name)).unwrap().header().time_axis();
    assert_eq!(axis("pulsewaves/las13fwf_example1.pls"), TimeAxis::WeekSeconds);
    assert_eq!(axis("pulsewaves/lvis_example1.pls"), TimeAxis::WeekSeconds);
    for name in [EXAMPLE_3, "pulsewaves/test.pls", "pulsewaves/geolas_example1.pls"] {
        assert_eq!(axis(name), TimeAxis::Undecided, "{name}");
    }
}

#[test]
fn the_compressed_twin_has_the_same_pulses_and_waves() {
    let Some(data) = data() else { return };
    let open = |name: &str| Reader::open(&data.join(name)).unwrap();
    let (mut plain, mut compressed) = (open("pulsewaves/test.pls"), open("pulsewaves/tezt.plz"));
    assert_eq!((plain.pulse_count(), compressed.pulse_count()), (15, 15));
    assert_eq!((compressed.stray_bytes(), compressed.check_complete().is_ok()), (0, true));
    let (mut waves, mut decoded) = (WaveSegments::new(), WaveSegments::new());
    for index in (0..15).rev() {
        let (pulse, of_compressed) = (plain.pulse(index).unwrap(), compressed.pulse(index).unwrap());
        plain.waves(&pulse, &mut waves).unwrap();
        compressed.waves(&of_compressed, &mut decoded).unwrap();
        assert_eq!(waves, decoded);
        assert_eq!(PulseRecord { wave_offset: pulse.wave_offset, ..of_compressed }, pulse);
    }
}

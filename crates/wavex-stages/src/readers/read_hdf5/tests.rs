//! Lines of made HDF5 files; `tests/python/make_hdf5.py` has the formulas of their values.

use std::path::PathBuf;

use super::*;

fn file(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../wavex-hdf5/tests/data").join(name)
}

fn open(name: &str, beams: &[&str]) -> Result<FootprintReader> {
    let beams: Vec<String> = beams.iter().map(|beam| (*beam).to_owned()).collect();
    FootprintReader::open(&file(name), "a", &beams)
}

fn lines(reader: &mut FootprintReader, cx: &mut Context) -> Vec<ScanLine> {
    std::iter::from_fn(|| reader.next(cx).unwrap()).collect()
}

#[test]
fn samples_numbers_and_flags_are_those_of_the_file() {
    let mut cx = Context::default();
    let lines = lines(&mut open("gedi_product.h5", &[]).unwrap(), &mut cx);
    let [line] = lines.as_slice() else { panic!("{} lines", lines.len()) };
    assert_eq!(
        (line.kind(), line.emissions.len(), line.input.beam.as_deref()),
        (Kind::Footprints, 12, Some("BEAM0101"))
    );
    let blocks = line.blocks().unwrap();
    let mut samples = Vec::new();
    for (shot, emission) in (0u16..).zip(&line.emissions) {
        let channels: Vec<Channel> =
            blocks.of_emission(shot.into()).map(|(_, block)| block.channel).collect();
        assert_eq!(channels, [Channel::Reference, Channel::LowPower]);
        let (_, received) = blocks.of_emission(shot.into()).last().unwrap();
        blocks.fractions_into(received, &mut samples);
        let expected = |k: u16| f32::from(200 + (7 * shot + 3 * k) % 101) + f32::from(shot % 4) / 4.0;
        assert_eq!(samples, (0..20 + shot % 3).map(expected).collect::<Vec<f32>>());
        let record = blocks.footprint_of(shot.into()).unwrap();
        assert_eq!(record.shot_number, 19_640_513_500_108_370 + 200_000_001 * u64::from(shot));
        assert_eq!(record.noise.unwrap().mean_dn, 200.0 + f64::from(shot) / 8.0);
        assert_eq!(record.is_degraded, shot % 3 != 0 || shot % 2 != 0, "degrade and stale_return_flag");
        let gps_time_s = 1_198_800_018.0 + 4.08e7 + 0.00826 * f64::from(shot) - 1e9;
        assert!((emission.gps_time_s - gps_time_s).abs() < 1e-6);
        let since_first_ps = 0.00826e12 * f64::from(shot);
        assert!((emission.clock_ps as f64 - since_first_ps).abs() < 1e6, "{}", emission.clock_ps);
    }
}

/// The first sample is at the origin, and the last at the end of the beam.
#[test]
fn beams_lead_from_the_first_sample_to_the_last() {
    let mut cx = Context::default();
    let lines = lines(&mut open("gedi_product.h5", &[]).unwrap(), &mut cx);
    let (line, shot) = (&lines[0], 5u32);
    let emission = &line.emissions[shot as usize];
    let (_, block) = line.blocks().unwrap().of_emission(shot).last().unwrap();
    let range_m = 0.5e-9 * line.input.group_velocity_mps * block.time_ns(block.len() as f64 - 1.0);
    let end_m = [0, 1, 2]
        .map(|axis| emission.origin_m[axis] + emission.frame_scale * range_m * emission.direction[axis]);
    for (place_m, height_m) in [(emission.origin_m, 850.0 + 2.5), (end_m, 730.0 + 2.5)] {
        let place = WGS84.geodetic_of(place_m);
        assert!((place.height_m - height_m).abs() < 1e-6, "{}", place.height_m);
        assert!((place.longitude_rad.to_degrees() - (-44.25 + 5.0 / 1024.0)).abs() < 1e-9);
    }
    assert!(
        (0.99..1.01).contains(&emission.frame_scale),
        "the interval takes the rest: {}",
        emission.frame_scale
    );
}

#[test]
fn beams_are_chosen_by_name_or_power() {
    for choice in ["BEAM0101", "power"] {
        assert_eq!(open("gedi_product.h5", &[choice]).unwrap().total(), 12, "{choice}");
    }
    let error = open("gedi_product.h5", &["coverage"]).err().unwrap().to_string();
    assert!(
        error.contains("no beam with waveforms is `coverage`; choose from `beams` of: BEAM0101, power"),
        "{error}"
    );
}

#[test]
fn a_line_is_read_again() {
    let (mut reader, mut cx) = (open("lvis_432.h5", &[]).unwrap(), Context::default());
    let first = reader.next(&mut cx).unwrap().unwrap();
    let location = reader.location().unwrap();
    assert!(reader.next(&mut cx).unwrap().is_none());
    let again = reader.line_at(&location, &mut cx).unwrap().unwrap();
    let origins = |line: &ScanLine| line.emissions.iter().map(|shot| shot.origin_m).collect::<Vec<_>>();
    assert!(
        again.line == first.line && origins(&again) == origins(&first) && again.blocks() == first.blocks()
    );
    let intervals_ns =
        |line: &ScanLine| line.blocks().unwrap().iter().map(|block| block.interval_ns).collect::<Vec<_>>();
    assert_eq!(intervals_ns(&again), [2.0; 12], "6 shots of 432 samples of 2 ns");
}

/// A damaged shot is counted, and those after it are read.
#[test]
fn bad_shots_are_counted() {
    let (mut reader, mut cx) = (open("gedi_bad_shots.h5", &[]).unwrap(), Context::default());
    let (total, mut read) = (reader.total(), 0);
    while let Ok(Some(line)) = reader.next(&mut cx) {
        read += line.emissions.len() as u64;
    }
    let rejected = cx.counters().rejected_of(Reason::UnreadableShot.item());
    assert!(rejected > 0 && read + rejected == total, "{read} + {rejected} of {total}");
}

#[test]
fn shots_without_positions_have_no_beam() {
    let sound = Shot {
        received_dn: vec![1.0; 3],
        first_bin: Position::from_degrees(10.0, 50.0, 100.0),
        last_bin: Position::from_degrees(10.0, 50.0, 99.7),
        ..Shot::default()
    };
    let (found, interval_ns) = emission(0, &sound, &InputInfo::default()).unwrap();
    assert!(
        (found.direction[0].powi(2) + found.direction[1].powi(2) + found.direction[2].powi(2) - 1.0).abs()
            < 1e-12
    );
    assert!((interval_ns - 1.0).abs() < 1e-9);
    let unknown = Shot { last_bin: Position::UNKNOWN, ..sound.clone() };
    let level = Shot { last_bin: sound.first_bin, ..sound.clone() };
    let single = Shot { received_dn: vec![1.0], ..sound };
    for shot in [unknown, level, single] {
        assert!(emission(0, &shot, &InputInfo::default()).is_none());
    }
}

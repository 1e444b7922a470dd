//! Invalid pulses and waves, and truncated files.

use super::*;

/// Returns the message of reading the waves of pulse 1 of three; the other pulses can be read.
fn waves_of(pair: &Pair) -> String {
    let (mut reader, dir) = pair.open();
    let mut waves = WaveSegments::new();
    let bad = reader.pulse(1).unwrap();
    let mut found = String::new();
    for index in [0, 1, 2] {
        let pulse = reader.pulse(index).unwrap();
        match reader.waves(&pulse, &mut waves) {
            Ok(()) => assert_eq!(waves.segments().len(), 2),
            Err(error) => {
                assert_eq!((index, waves.segments().len()), (bad.index, 0));
                found = message(dir.path(), &error);
            }
        }
    }
    found
}

#[test]
fn a_bad_pulse_is_an_error_of_that_pulse_alone() {
    let with = |offset: i64, descriptor: u8| {
        let mut pair = Pair::plain(3);
        pair.pulses[1] = pulse(0, offset, descriptor, 0);
        waves_of(&pair)
    };
    let offset = |offset: i64| {
        format!(
            "t.pls: byte 804: pulse 1: offset to waves: {offset} is outside the waves file's bytes \
             60 to 75; copy both files again: the waves file may be cut off, or that of \
             another recording"
        )
    };
    assert_eq!(with(-1, 1), offset(-1));
    assert_eq!(with(59, 1), offset(59));
    assert_eq!(with(75, 1), offset(75));
    assert_eq!(with(65, 1), "");
    assert_eq!(
        with(72, 1),
        "t.wvs: byte 75: pulse 1: samples: 2 bytes needed, 0 left in the file; copy both \
         files again: the waves file may be cut off, or that of another recording"
    );
    assert_eq!(
        with(65, 9),
        "t.pls: byte 840: pulse 1: pulse descriptor index: the file has no descriptor 9; \
         export the files with 8 or 16 bit uncompressed waves"
    );
}

#[test]
fn a_descriptor_that_is_not_supported_spoils_its_pulses_alone() {
    let with = |change: &dyn Fn(&mut PulseDescriptor)| {
        let mut pair = Pair::plain(3);
        let mut d = descriptor(vec![sampling(SegmentKind::Outgoing, 1, 3)]);
        change(&mut d);
        pair.records.push(("PulseWaves_Spec", 200_002, encode(&d, 0)));
        pair.pulses[1] = pulse(0, 65, 2, 0);
        let message = waves_of(&pair);
        let start = "t.pls: byte 1132: pulse 1: descriptor 2: ";
        let end = "; export the files with 8 or 16 bit uncompressed waves";
        message.strip_prefix(start).and_then(|m| m.strip_suffix(end)).unwrap_or(&message).to_string()
    };
    let first =
        |change: fn(&mut SamplingRecord)| with(&|d: &mut PulseDescriptor| change(&mut d.samplings[0]));
    assert_eq!(with(&|d| d.compression = 1), "compression: scheme 1 is unknown");
    assert_eq!(with(&|d| d.sample_units_ns = 0.0), "sample units: 0 ns is not a time above zero");
    for (found, expected) in [
        (first(|s| s.bits_per_sample = 32), "bits per sample: 32 bits are not supported, only 8 and 16"),
        (
            first(|s| s.duration_bits = 24),
            "bits for duration from anchor: 24 bits are not supported, only 0, 8, 16 and 32",
        ),
        (
            first(|s| s.duration_scale = 0.0),
            "scale and offset for duration from anchor: 0 and 0 are not a valid time",
        ),
        (
            first(|s| s.segment_count_bits = 32),
            "bits for number of segments: 32 bits are not supported, only 0, 8 and 16",
        ),
        (
            first(|s| s.sample_count = 0),
            "bits for number of samples: neither a stored number nor a fixed one is declared",
        ),
        (first(|s| s.sample_units_ns = f64::NAN), "sample units: NaN ns is not a time above zero"),
        (first(|s| s.compression = 2), "compression: scheme 2 is unknown"),
    ] {
        assert_eq!(found, format!("sampling 0: {expected}"));
    }
}

#[test]
fn a_pulse_of_megabytes_is_refused_before_it_is_read() {
    let mut pair = Pair::plain(3);
    let d = descriptor(vec![sampling(SegmentKind::Outgoing, 1, 5_000_000)]);
    pair.records.push(("PulseWaves_Spec", 200_002, encode(&d, 0)));
    pair.pulses[1] = pulse(0, 60, 2, 0);
    pair.waves.resize(6_000_000, 0);
    assert_eq!(
        waves_of(&pair),
        "t.wvs: byte 60: pulse 1: samples: the waves of the pulse take more than 4194304 bytes; \
         copy both files again: the waves file may be cut off, or that of another recording"
    );
    pair.pulses[1] = pulse(0, 1000, 2, 0);
    let mut many = sampling(SegmentKind::Outgoing, 60_000, 0);
    many.sample_count_bits = 8;
    pair.records[1].2 = encode(&descriptor(vec![many.clone(), many]), 0);
    assert_eq!(
        waves_of(&pair),
        "t.wvs: byte 66536: pulse 1: segments: there are more than 65536; \
         copy both files again: the waves file may be cut off, or that of another recording"
    );
}

#[test]
fn a_promise_of_too_many_pulses_is_checked_against_the_file() {
    let pair = Pair::plain(2);
    let mut pls = pair.pls();
    pls[184..192].copy_from_slice(&i64::MAX.to_le_bytes());
    let dir = tempfile::tempdir().unwrap();
    let mut reader = Reader::open(&write(dir.path(), &pls, &pair.waves)).unwrap();
    assert_eq!(reader.pulse_count(), 2);
    let missing = "pulse 2: the header declares 9223372036854775807 pulses, but the file has 2";
    let expected = format!("t.pls: byte 844: {missing}; the file is cut off: copy it again from its source");
    assert_eq!(message(dir.path(), &reader.check_complete().unwrap_err()), expected);
    assert_eq!(message(dir.path(), &reader.pulse(2).unwrap_err()), expected);
    assert!(reader.pulse(u64::MAX).is_err());
    assert!(reader.pulse(1).is_ok());
    let (mut reader, dir) = pair.open();
    assert!(reader.check_complete().is_ok());
    let error = message(dir.path(), &reader.pulse(2).unwrap_err());
    assert_eq!(error, "t.pls: byte 844: pulse 2: the file has 2 pulses; request one of them");
}

/// Counts readable pulses, and pulses with readable waves.
///
/// All others must give an error.
fn read_all(path: &Path) -> (u64, u64) {
    let Ok(mut reader) = Reader::open(path) else { return (0, 0) };
    let (mut waves, mut with_waves) = (WaveSegments::new(), 0);
    for index in 0..reader.pulse_count() {
        let pulse = reader.pulse(index).unwrap();
        with_waves += u64::from(reader.waves(&pulse, &mut waves).is_ok());
    }
    let complete = reader.pulse_count() == reader.header().pulse_count;
    assert_eq!(reader.check_complete().is_ok(), complete);
    assert!(reader.pulse(reader.pulse_count()).is_err());
    (reader.pulse_count(), with_waves)
}

/// Returns cut positions for a file of `n` bytes.
///
/// 40 in its first kilobytes and 40 over the whole, in order.
fn cuts(n: usize) -> Vec<usize> {
    let places = (0..40).flat_map(|i| [i * n.min(4000) / 40 + i % 7, i * n / 40 + i % 5]);
    let mut places: Vec<usize> = places.filter(|&cut| cut < n).collect();
    places.sort_unstable();
    places
}

#[test]
fn a_recording_cut_anywhere_never_panics_and_loses_only_what_is_gone() {
    let Some(data) = data() else { return };
    let recordings =
        ["geolas_example1", "las13fwf_example1", "lvis_example1", "optech_example1", "riegl_example3"];
    let recordings = recordings.map(|name| data.join("pulsewaves").join(name));
    let more = [data.join("pulsewaves/test"), data.join("riegl_q680i_dev/riegl_q680i_dev")];
    for name in recordings.iter().chain(&more) {
        let read = |ending: &str| std::fs::read(name.with_extension(ending)).unwrap();
        let (pls, wvs) = (read("pls"), read("wvs"));
        let dir = tempfile::tempdir().unwrap();
        let path = write(dir.path(), &pls, &wvs);
        let all = read_all(&path).0;
        assert_eq!(read_all(&path), (all, all));
        let start = Reader::open(&path).unwrap().header().offset_to_pulses as usize;
        for cut in cuts(pls.len()) {
            write(dir.path(), &pls[..cut], &wvs);
            let held = (cut.saturating_sub(start) / 48) as u64;
            assert_eq!(read_all(&path), (held.min(all), held.min(all)), "{} cut at {cut}", name.display());
        }
        let mut before = 0;
        for cut in cuts(wvs.len()) {
            write(dir.path(), &pls, &wvs[..cut]);
            let (pulses, with_waves) = read_all(&path);
            assert_eq!(pulses, if cut < 60 { 0 } else { all });
            assert!(with_waves >= before && with_waves < all, "{} cut at {cut}", name.display());
            before = with_waves;
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(256))]

    #[test]
    fn damaged_bytes_never_panic(damage in prop::collection::vec((0..2000_usize, any::<u8>()), 1..12)) {
        let mut pair = Pair::plain(3);
        let mut stored = sampling(SegmentKind::Returning, 0, 0);
        (stored.duration_bits, stored.segment_count_bits, stored.sample_count_bits) = (16, 16, 8);
        pair.records.push(("PulseWaves_Spec", 200_002, encode(&descriptor(vec![stored]), 0)));
        pair.appended = vec![("PulseWaves_Spec", u32::MAX, vec![]), ("PulseWaves_Proj", 2112, b"WKT".to_vec())];
        pair.add(2, &[1, 0, 5, 0, 2, 9, 9]);
        let (mut pls, mut wvs) = (pair.pls(), pair.waves);
        for (at, value) in damage {
            let whole = if at % 8 == 0 { &mut wvs } else { &mut pls };
            let at = at % whole.len();
            whole[at] = value;
        }
        let dir = tempfile::tempdir().unwrap();
        let (pulses, with_waves) = read_all(&write(dir.path(), &pls, &wvs));
        // Damage to both the count and the marker after the pulses may turn pulses into records.
        prop_assert!(352 + 48 * pulses <= pls.len() as u64 && with_waves <= pulses);
    }
}

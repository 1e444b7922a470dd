use std::fs::File;
use std::path::PathBuf;

use arrow_ipc::CompressionType;
use serde_json::{Value, json};

use super::*;
use wavex_formats::container::IpcWriter;
use wavex_line::scan_line::{Blocks, ReturnChannel};
use wavex_signal::distributed::WithSd;

/// A file in a temporary folder.
struct Place(tempfile::TempDir);

impl Place {
    fn new() -> Place {
        Place(tempfile::tempdir().unwrap())
    }

    fn path(&self) -> PathBuf {
        self.0.path().join("a_decomposed.arrow")
    }

    /// Writes a line; `change` may change the schema.
    fn write(&self, line: &ScanLine, of: Option<&OfRecording>, change: impl Fn(Schema) -> Schema) {
        let schema = schema_of(&identity(), of).unwrap();
        let mut group = Group::default();
        group.add(line, &line.emissions, line.returns().unwrap()).unwrap();
        let batch = group.take(&schema).unwrap();
        let schema = Arc::new(change(Schema::clone(&schema)));
        let batch = RecordBatch::try_new(Arc::clone(&schema), batch.columns().to_vec()).unwrap();
        let file = File::create(self.path()).unwrap();
        let mut writer = IpcWriter::file(file, schema, Some(CompressionType::ZSTD)).unwrap();
        writer.write(&batch).unwrap();
        writer.finish().unwrap();
    }

    fn read(&self) -> Result<Vec<ScanLine>> {
        let mut reader = ReturnsReader::open(&self.path(), "a")?;
        let mut lines = Vec::new();
        while let Some(more) = reader.next_lines()? {
            lines.extend(more);
        }
        Ok(lines)
    }

    /// The problem without name and remedy.
    fn problem(&self) -> String {
        let text = self.read().unwrap_err().to_string();
        let text = text.strip_prefix(&format!("{}: ", self.path().display())).unwrap().to_owned();
        text.strip_suffix(&format!("; {REMEDY}")).unwrap_or(&text).to_owned()
    }
}

fn identity() -> Identity {
    let settings = json!([
        {"type": "read_arrow", "keys": {"odd_sample_shift": 0.0}},
        {"type": "decompose", "keys": {"mode": "fast", "load": "blake3:01"}},
    ]);
    Identity { wavex: "1.2.3".into(), settings, recording: Some("ab".into()) }
}

/// Counts up, so that no two values are equal.
fn counter() -> impl FnMut() -> f64 {
    let mut n = 0.0;
    move || {
        n += 1.0;
        n + 0.1
    }
}

/// A line of three shots whose fields all have values of their own.
fn line() -> ScanLine {
    let mut n = counter();
    let mut shot = |number: u64, mta_zone| Emission {
        shot: number,
        gps_time_s: n(),
        clock_ps: -(n() as i64),
        origin_m: [n(), n(), n()],
        direction: [0.0, 0.6, -0.8],
        frame_scale: 1.0 + 1e-3 * n(),
        emission_ns: n(),
        emission_sd_ns: n(),
        facet: n() as u16,
        flags: 5,
        mta_zone,
        scan_angle_deg: n() as f32,
    };
    let emissions = vec![shot(7, None), shot(8, Some(-3)), shot(9, Some(4))];
    let mut found = |emission, channel, withheld| Return {
        emission,
        return_number: n() as u8,
        number_of_returns: n() as u8,
        channel,
        flags: n() as u16,
        mta_zone: n() as i16,
        time_of_flight_ns: n(),
        time_of_flight_sd_ns: n(),
        range_m: n(),
        range_sd_m: n(),
        total_sd_m: n(),
        amplitude_dn: n(),
        amplitude_sd_dn: n(),
        gain: n(),
        peak_dn: n(),
        peak_sd_dn: n(),
        amplitude_db: n(),
        width_ratio: n(),
        width_ratio_sd: n(),
        fwhm_ns: n(),
        thickness_m: n(),
        thickness_sd_m: n(),
        deviation_ratio: n(),
        intensity: n(),
        intensity_sd: n(),
        withheld,
        class: n() as u8,
        // Not in the file: `classify` comes later.
        height_above_ground_m: f32::NAN,
    };
    let returns = vec![
        found(0, ReturnChannel::Low, false),
        found(0, ReturnChannel::High, true),
        found(2, ReturnChannel::Joint, false),
    ];
    let mut with_sd = || WithSd { value: n(), sd: n() };
    let profile = ShotProfile {
        emission: 1,
        first_range_m: with_sd(),
        last_range_m: with_sd(),
        peaks: 3,
        heights_m: [with_sd(), with_sd(), with_sd(), with_sd()],
        top_m: with_sd(),
        energy_dn: with_sd(),
        flags: 2,
    };
    let mut filtered = Filtered::default();
    (100..).zip(reasons()).for_each(|(n, reason)| filtered.add(reason, n));
    let mut count = || n() as u64;
    let stats = LineStats {
        gps_time_s: 3.5,
        nw: count(),
        np: count(),
        np_xtalk: count(),
        filtered,
        np_merged: count(),
        np_air: count(),
        np_low: count(),
        np_range: count(),
        np_atm: count(),
        np_ibrc: count(),
        np_ibic: count(),
        nw_empty: count(),
        nw_saturated: count(),
        nw_refined1x: count(),
        nw_refined2x: count(),
        nw_deleted: count(),
        nw_truncated: count(),
        n_georef: count(),
        agl_m: None,
        n_candidates: count(),
        n_added: count(),
        nw_with_points: count(),
        np_xtalk_dropped: count(),
        np_online: count(),
    };
    let line = ScanLine::of_shots(Arc::new(info()), 12, emissions, Blocks::default());
    ScanLine { stats, content: Content::Returns(returns), profiles: vec![profile], ..line }
}

fn info() -> InputInfo {
    InputInfo { coordinate_grid: Some(([0.01; 3], [1.0, 2.0, 3.0])), ..InputInfo::default() }
}

fn of() -> OfRecording {
    OfRecording { input: Arc::new(info()), model: None, fusion: None }
}

#[test]
fn every_field_is_restored() {
    let (place, line) = (Place::new(), line());
    place.write(&line, Some(&of()), |schema| schema);
    let read = place.read().unwrap();
    let [again] = read.as_slice() else { panic!("{read:?}") };
    assert_eq!(again.emissions, line.emissions);
    // Unknown numbers are not equal.
    assert_eq!(format!("{:?}", again.returns()), format!("{:?}", line.returns()));
    assert_eq!((&again.profiles, &again.stats, again.line), (&line.profiles, &line.stats, 12));
    let named = InputInfo { path: place.path(), stem: "a".into(), ..info() };
    assert_eq!(*again.input, named);
    assert_eq!(Identity::read(&place.path()).unwrap(), identity());
}

#[test]
fn shots_without_a_pose_are_kept_and_marked() {
    let (place, whole) = (Place::new(), line());
    let mut later = line();
    // The first shot has no pose, so the others have other places.
    later.emissions.remove(0);
    later.emissions[0].emission_ns = 77.0;
    let returns = vec![Return { emission: 1, ..later.returns().unwrap()[0] }];
    later.profiles[0].emission = 0;
    let mut group = Group::default();
    group.add(&later, &whole.emissions, &returns).unwrap();
    assert_eq!((group.returns[0].emission, group.profiles[0].emission), (2, 1));
    let flags: Vec<u16> = group.shots.iter().map(|shot| shot.flags).collect();
    assert_eq!(flags, [5 | emission_flags::NOT_DECOMPOSED, 5, 5]);
    assert_eq!(group.shots[1].emission_ns, 77.0);
    later.emissions[0].shot = 100;
    let changed = group.add(&later, &whole.emissions, &returns).unwrap_err().to_string();
    assert_eq!(
        changed,
        "scan line 12: a stage before `write_returns` has changed its shots; put it after `write_returns`"
    );
    drop(place);
}

#[test]
fn files_of_other_layouts_are_refused() {
    let place = Place::new();
    let with = |key: &str, value: Option<&str>| {
        place.write(&line(), Some(&of()), |mut schema| {
            schema.metadata.remove(key);
            schema.metadata.extend(value.map(|value| (key.to_owned(), value.to_owned())));
            schema
        });
        place.problem()
    };
    let expected = "not a returns file: the metadata `wavex.returns` is missing";
    assert_eq!(with(VERSION_KEY, None), expected);
    let expected = "version 9 of returns files is not supported; this is version 1";
    assert_eq!(with(VERSION_KEY, Some("9")), expected);
    let expected = "the metadata `wavex.settings` is invalid: expected value at line 1 column 1";
    assert_eq!(with(SETTINGS_KEY, Some("x")), expected);
    let expected = "the metadata `wavex.filtered` names other reasons than this version of wavex";
    assert_eq!(with(FILTERED_KEY, Some("[\"bad\"]")), expected);
    let expected = "record batch 1: it has lines, but the metadata `wavex.input` is missing";
    assert_eq!(with(INPUT_KEY, None), expected);
    assert!(with(INPUT_KEY, Some("{}")).starts_with("the metadata `wavex.input` is invalid: missing field"));
    let info = InputInfo { coordinate_grid: Some(([0.0; 3], [0.0; 3])), ..info() };
    let text = serde_json::to_string(&info).unwrap();
    let expected = "the metadata `wavex.input` has an invalid `coordinate_grid`";
    assert_eq!(with(INPUT_KEY, Some(&text)), expected);
    let model = serde_json::to_string(&SensorModel::default()).unwrap();
    let expected = "the metadata `wavex.model`: the sensor model has no echo receiver";
    assert_eq!(with(MODEL_KEY, Some(&model)), expected);
    let fusion = ChannelFusion {
        pairs: 1,
        gain_ratio: 0.0,
        gain_ratio_sd: 0.0,
        delay_ns: 0.0,
        delay_sd_ns: 0.0,
        walk: Vec::new(),
        walk_is_known: false,
    };
    let expected = "the metadata `wavex.fusion` has invalid numbers";
    assert_eq!(with(FUSION_KEY, Some(&serde_json::to_string(&fusion).unwrap())), expected);
    place.write(&line(), Some(&of()), |schema| {
        let fields = schema.fields().iter().map(|field| match field.name().as_str() {
            "shots" => Field::clone(field).with_name("pulses"),
            _ => Field::clone(field),
        });
        Schema::new(fields.collect::<Vec<Field>>()).with_metadata(schema.metadata.clone())
    });
    assert_eq!(place.problem(), "column 5 must be `shots`, in the layout of version 1");
}

#[test]
fn impossible_values_are_refused() {
    let place = Place::new();
    let with = |change: &dyn Fn(&mut ScanLine)| {
        let mut line = line();
        change(&mut line);
        place.write(&line, Some(&of()), |schema| schema);
        let problem = place.problem();
        problem.strip_prefix("record batch 1: scan line 12: ").unwrap_or(&problem).to_owned()
    };
    let returns = |change: fn(&mut Vec<Return>)| {
        with(&|line| {
            let Content::Returns(returns) = &mut line.content else { unreachable!() };
            change(returns);
        })
    };
    let many = |line: &mut ScanLine| line.emissions = vec![line.emissions[0]; 4097];
    assert_eq!(with(&many), "4097 shots, where 4096 are possible");
    assert_eq!(with(&|line| line.stats.nw = 1 << 41), "the counter `nw` is 2199023255552");
    assert_eq!(
        with(&|line| line.emissions[1].direction[0] = 0.1),
        "shot 8: its direction is not a unit vector"
    );
    let nan = "shot 8: its direction is not a unit vector";
    assert_eq!(with(&|line| line.emissions[1].direction[0] = f64::NAN), nan);
    assert_eq!(with(&|line| line.emissions[1].origin_m[0] = f64::NAN), "shot 8: its origin is not finite");
    let expected = "shot 9: its frame scale is not between 0.1 and 10";
    assert_eq!(with(&|line| line.emissions[2].frame_scale = 0.0), expected);
    assert_eq!(with(&|line| line.emissions[2].clock_ps = i64::MIN), "shot 9: its time is impossible");
    assert_eq!(returns(|returns| returns.swap(0, 2)), "returns are not in the order of their shots");
    assert_eq!(returns(|returns| returns[2].gain = 0.0), "a return of shot 2 of the line has the gain 0");
    let twice = |line: &mut ScanLine| line.profiles.push(line.profiles[0]);
    assert_eq!(with(&twice), "profiles are not in the order of their shots");
    let mut unknown = line();
    unknown.emissions[2].flags = emission_flags::NOT_DECOMPOSED;
    let checked = |line: &ScanLine| check(&line.stats, &line.emissions, line.returns().unwrap(), &[]);
    let expected = Err("a return of shot 2 of the line, which has none".to_owned());
    assert_eq!(checked(&unknown), expected);
    unknown.emissions.pop();
    assert_eq!(checked(&unknown), expected);
}

#[test]
fn codes_that_are_not_written_are_refused() {
    let found = line().returns().unwrap().to_vec();
    let at = RETURNS.iter().position(|column| column.name == "channel").unwrap();
    let mut columns = arrays(RETURNS, &found);
    columns[at] = Arc::new(arrow_array::UInt8Array::from(vec![0, 3, 1]));
    let table = StructArray::try_new(fields(RETURNS), columns, None).unwrap();
    let InvalidValue { row, column } = rows(RETURNS, &table, &Return::default()).err().unwrap();
    assert_eq!((row, column), (1, "channel"));
}

#[test]
fn differences_are_named() {
    let then = identity();
    let with = |pointer: &str, value: Value| {
        let mut settings = then.settings.clone();
        *settings.pointer_mut(pointer).unwrap() = value;
        then.difference(&Identity { settings, ..then.clone() }).unwrap()
    };
    assert_eq!(then.difference(&then), None);
    assert_eq!(
        then.difference(&Identity { wavex: "1.2.4".into(), ..then.clone() }).unwrap(),
        "it was made by wavex 1.2.3, not 1.2.4"
    );
    assert_eq!(with("/1/keys/mode", json!("slow")), "`mode` of `decompose` was \"fast\", and is \"slow\"");
    let expected = "`load` of `decompose` was \"blake3:01\", and is \"blake3:02\"";
    assert_eq!(with("/1/keys/load", json!("blake3:02")), expected);
    let expected = "`mode` of `decompose` was \"fast\", and is not set";
    assert_eq!(with("/1/keys", json!({"load": "blake3:01"})), expected);
    let expected = "the stages before it were read_arrow, decompose, and are read_las, decompose";
    assert_eq!(with("/0/type", json!("read_las")), expected);
    let other = |recording: Option<&str>| Identity { recording: recording.map(Into::into), ..then.clone() };
    assert_eq!(then.difference(&other(Some("cd"))).unwrap(), "the recording has changed");
    assert_eq!(then.difference(&other(None)), None, "the recording is elsewhere");
}

#[test]
fn a_digest_changes_with_every_piece() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.las");
    let mut bytes = vec![0; 20 << 20];
    let mut digest = |at: Option<usize>| {
        at.into_iter().for_each(|at| bytes[at] ^= 1);
        std::fs::write(&path, &bytes).unwrap();
        recording_digest(&path).unwrap()
    };
    let digests = [None, Some(0), Some((20 << 20) - 1), Some(10 << 20)].map(&mut digest);
    assert!(digests.iter().collect::<std::collections::BTreeSet<_>>().len() >= 3, "{digests:?}");
    std::fs::write(path.with_extension("wdp"), "waves").unwrap();
    assert_ne!(recording_digest(&path).unwrap(), digests[3]);
    std::fs::write(&path, "").unwrap();
    recording_digest(&path).unwrap();
}

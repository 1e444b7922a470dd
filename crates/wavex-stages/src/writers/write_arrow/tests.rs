//! Round trip: written lines are read back unchanged.

use std::path::PathBuf;
use std::sync::Arc;

use proptest::collection::vec;
use proptest::option;
use proptest::prelude::*;

use super::*;
use crate::readers::read_arrow;
use wavex_line::scan_line::{
    AmplitudeTable, Channel, EmissionReference, Frame, GainControl, OnlineReturn, TimeScale, emission_flags,
};
use wavex_line::stage::{Config as _, Source, SourceConfig};

fn run(folder: &Path, input: &str) -> RunContext {
    RunContext {
        input: folder.join(input),
        stem: "made".into(),
        input_dir: folder.to_path_buf(),
        output_dir: folder.to_path_buf(),
        simd: wavex_simd::SimdLevel::best(),
        ..RunContext::alone("".as_ref())
    }
}

/// Writes lines as a job does; returns the notes and counters.
fn write(folder: &Path, config: &WriteArrow, batches: &[ScanLine]) -> Context {
    let mut cx = Context::default();
    let mut sink = config.make(&run(folder, "")).unwrap();
    batches.iter().for_each(|scan_line| sink.write(scan_line, &mut cx).unwrap());
    sink.finish(&mut cx).unwrap();
    for whole in cx.take_files() {
        whole.publish().unwrap();
    }
    cx
}

fn read(folder: &Path) -> Vec<ScanLine> {
    let config: read_arrow::ReadArrow = toml::from_str("path = \"made.arrow\"").unwrap();
    let mut source: Box<dyn Source> = config.make(&run(folder, "made.arrow")).unwrap();
    let mut cx = Context::default();
    let batches = std::iter::from_fn(|| source.next(&mut cx).unwrap()).collect();
    // Made-up times may be implausible for their time scale, and made-up systems cannot be read.
    let is_of_content = |note: &String| {
        ["the recording's times", "the receiver gain varies", "the WKT record cannot be read"]
            .iter()
            .any(|words| note.starts_with(words))
    };
    assert!(cx.counters().rejected.is_empty(), "{:?}", cx.counters());
    assert!(cx.counters().notes.iter().all(is_of_content), "{:?}", cx.counters());
    batches
}

fn number() -> impl Strategy<Value = f64> {
    prop_oneof![-1e9..1e9, Just(0.0), Just(-0.0), Just(f64::MIN_POSITIVE), Just(0.1 + 0.2)]
}

fn positive() -> impl Strategy<Value = f64> {
    prop_oneof![1e-9..1e9, Just(1.0), Just(0.5)]
}

fn interval_ns() -> impl Strategy<Value = f64> {
    prop_oneof![0.05..20.0, Just(1.0), Just(0.5)]
}

fn table() -> impl Strategy<Value = Option<AmplitudeTable>> {
    option::of(vec((number(), number()), 2..5).prop_map(AmplitudeTable::new)).prop_map(Option::flatten)
}

fn unit() -> impl Strategy<Value = [f64; 3]> {
    (-3.2..3.2, -1.6..1.6_f64).prop_map(|(azimuth, elevation): (f64, f64)| {
        let across = elevation.cos();
        [across * azimuth.cos(), across * azimuth.sin(), elevation.sin()]
    })
}

prop_compose! {
    fn sensor()(
        instrument in option::of(".{0,8}"),
        serial in option::of("[0-9]{4}"),
        sampling_interval_ns in interval_ns(),
        full_scale_dn in option::of(any::<u16>()),
        group_velocity_mps in 2.5e8..299_792_458.0,
        pulse_rate_hz in option::of(positive()),
        recorded in option::of((1..=365_u16, 1..=9999_u16)),
        may_be_file_date in any::<bool>(),
        clock_sd_ns in option::of(positive()),
        emission_choice_sd_ns in prop_oneof![Just(0.0), positive()],
        emission_reference in prop::sample::select(vec![
            EmissionReference::OutgoingPulse, EmissionReference::ReturnLocations, EmissionReference::Clock,
        ]),
        origin_is_sensor in any::<bool>(),
        gain_control in prop::sample::select(vec![
            GainControl::Off, GainControl::Recorded, GainControl::NotRecorded,
        ]),
        tables in (table(), table(), table(), table()),
    ) -> InputInfo {
        InputInfo {
        full_scale_is_set: false,
            path: PathBuf::from("made.sdf"),
            stem: "made".into(),
            format: "made".into(),
            instrument,
            serial,
            odd_sample_shift: 0.0,
            sampling_interval_ns,
            full_scale_dn,
            gain_control,
            group_velocity_mps,
            pulse_rate_hz,
            time_scale: TimeScale::Unknown,
            gps_week: None,
            recorded,
            is_file_date: may_be_file_date && recorded.is_some(),
            time_scale_is_inferred: false,
            frame: Frame::Scanner,
            crs_problems: Vec::new(),
            crs_wkt: None,
            coordinate_grid: None,
            emission_reference,
            clock_sd_ns,
            emission_choice_sd_ns,
            origin_is_sensor,
            first_shot: None,
            beam: None,
            beam_power: None,
            columns: Vec::new(),
            has_heights_above_ground: false,
            amplitude_low: tables.0,
            amplitude_high: tables.1,
            range_low: tables.2,
            range_high: tables.3,
        }
    }
}

prop_compose! {
    fn info()(
        sensor in sensor(),
        time_scale in prop::sample::select(vec![
            TimeScale::Week, TimeScale::Day, TimeScale::Adjusted, TimeScale::Unknown,
        ]),
        gps_week in option::of(any::<u32>()),
        frame in prop::sample::select(vec![Frame::Scanner, Frame::Body, Frame::Map]),
        crs_wkt in option::of("[A-Z\\[\\]\"]{1,20}"),
        coordinate_grid in option::of((prop::array::uniform3(positive()), prop::array::uniform3(number()))),
    ) -> InputInfo {
        InputInfo { time_scale, gps_week, frame, crs_wkt, coordinate_grid, ..sensor }
    }
}

prop_compose! {
    fn emission()(
        shot in any::<u64>(),
        gps_time_s in prop_oneof![number(), Just(f64::NAN)],
        origin_m in prop::array::uniform3(number()),
        direction in unit(),
        frame_scale in prop_oneof![Just(1.0), 0.9..1.1],
        facet in any::<u16>(),
        // The reader determines copies itself.
        flags in any::<u16>().prop_map(|flags| flags & !emission_flags::COPY),
        mta_zone in option::of(any::<i16>()),
        scan_angle_deg in prop_oneof![Just(f32::NAN), -90.0..90.0_f32],
    ) -> Emission {
        Emission {
            shot,
            gps_time_s,
            clock_ps: 0,
            origin_m,
            direction,
            frame_scale,
            emission_ns: 0.0,
            emission_sd_ns: f64::NAN,
            facet,
            flags,
            mta_zone,
            scan_angle_deg,
        }
    }
}

type MadeBlock = (Channel, f64, Option<f64>, Option<i16>, f64, Vec<u16>);
type MadeShot = (Emission, u32, Vec<MadeBlock>, Vec<(f64, f32)>);

fn block() -> impl Strategy<Value = MadeBlock> {
    let channels = vec![Channel::HighPower, Channel::LowPower, Channel::Saturation, Channel::Reference];
    let samples = vec(any::<u16>(), 0..30);
    let gain = prop_oneof![Just(1.0), 1.0 / 1024.0..1024.0_f64];
    (
        prop::sample::select(channels),
        prop_oneof![-1e7..1e7, Just(0.0), Just(-0.0)],
        option::of(interval_ns()),
        option::of(any::<i16>()),
        gain,
        samples,
    )
}

fn shot() -> impl Strategy<Value = MadeShot> {
    let amplitude = prop_oneof![any::<f32>(), Just(f32::NAN)];
    (emission(), any::<u32>(), vec(block(), 0..4), vec((number(), amplitude), 0..3))
}

fn scan_line(info: &Arc<InputInfo>, line: u32, shots: Vec<MadeShot>) -> ScanLine {
    let mut emissions = Vec::new();
    let mut blocks = Blocks::default();
    let mut clock_ps = i64::from(line) - 7_000_000_000;
    for (index, (mut emission, later_ps, own, online)) in (0..).zip(shots) {
        clock_ps += i64::from(later_ps);
        emission.clock_ps = clock_ps;
        emissions.push(emission);
        for (channel, start_ns, interval_ns, zone, gain, samples) in own {
            let interval_ns = interval_ns.unwrap_or(info.sampling_interval_ns);
            blocks.push(index, channel, zone, start_ns, interval_ns, &samples);
            if info.gain_control == GainControl::Recorded {
                blocks.set_last_gain(gain);
            }
        }
        let online = online.into_iter();
        blocks.online.extend(online.map(|(time_ns, amplitude)| OnlineReturn {
            emission: index,
            time_ns,
            amplitude,
        }));
    }
    ScanLine::of_shots(Arc::clone(info), line, emissions, blocks)
}

/// All contents of a line as text, with every bit of its numbers: NaN equals NaN, and -0 differs
/// from 0.
fn words(scan_line: &ScanLine) -> String {
    format!("{} {:?} {:?} {:?}", scan_line.line, scan_line.emissions, scan_line.content, scan_line.stats)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(96))]

    #[test]
    fn what_is_written_comes_back(
        info in info(),
        lines in vec((any::<u32>(), vec(shot(), 1..6)), 1..4),
        compression in prop::sample::select(vec![ContainerCompression::None, ContainerCompression::Lz4, ContainerCompression::Zstd]),
    ) {
        let info = Arc::new(info);
        let batches: Vec<ScanLine> =
            lines.into_iter().map(|(line, shots)| scan_line(&info, line, shots)).collect();
        let folder = tempfile::tempdir().unwrap();
        let cx = write(folder.path(), &WriteArrow { compression, ..WriteArrow::default() }, &batches);
        prop_assert!(cx.counters().rejected.is_empty());
        let found = read(folder.path());
        let expected: Vec<String> = batches.iter().map(words).collect();
        prop_assert_eq!(found.iter().map(words).collect::<Vec<_>>(), expected);
        let about = InputInfo {
            path: folder.path().join("made.arrow"),
            format: "wavex container 1 (Arrow IPC file)".into(),
            crs_problems: found[0].input.crs_problems.clone(),
            ..info.as_ref().clone()
        };
        prop_assert_eq!(found[0].input.as_ref(), &about);
    }
}

fn plain_info() -> Arc<InputInfo> {
    let table = AmplitudeTable::new([(9.0, 0.0), (255.0, 19.7)]);
    Arc::new(InputInfo {
        full_scale_is_set: false,
        path: "made.sdf".into(),
        stem: "made".into(),
        format: "made".into(),
        instrument: None,
        serial: None,
        odd_sample_shift: 0.0,
        sampling_interval_ns: 1.0,
        full_scale_dn: None,
        gain_control: GainControl::Off,
        group_velocity_mps: 299_707_502.0,
        pulse_rate_hz: None,
        time_scale: TimeScale::Week,
        gps_week: None,
        recorded: None,
        frame: Frame::Body,
        crs_wkt: None,
        coordinate_grid: None,
        emission_reference: EmissionReference::Clock,
        origin_is_sensor: true,
        first_shot: None,
        amplitude_low: table,
        amplitude_high: None,
        range_low: None,
        range_high: None,
        ..InputInfo::default()
    })
}

#[test]
fn without_a_shot_there_is_no_file_but_a_note() {
    let folder = tempfile::tempdir().unwrap();
    let empty = ScanLine::of_shots(plain_info(), 0, vec![], Blocks::default());
    for batches in [&[][..], &[empty][..]] {
        let cx = write(folder.path(), &WriteArrow::default(), batches);
        assert_eq!(cx.counters().notes, ["no container is written: there were no shots"]);
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    }
}

#[test]
fn an_abandoned_container_leaves_no_file() {
    let folder = tempfile::tempdir().unwrap();
    let mut sink = WriteArrow::default().make(&run(folder.path(), "")).unwrap();
    let shot = Emission {
        shot: 0,
        gps_time_s: 0.0,
        clock_ps: 0,
        origin_m: [0.0; 3],
        direction: [0.0, 0.0, 1.0],
        frame_scale: 1.0,
        emission_ns: 0.0,
        emission_sd_ns: f64::NAN,
        facet: 0,
        flags: 0,
        mta_zone: None,
        scan_angle_deg: 0.0,
    };
    let scan_line = ScanLine::of_shots(plain_info(), 0, vec![shot], Blocks::default());
    sink.write(&scan_line, &mut Context::default()).unwrap();
    drop(sink);
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
}

#[test]
fn keys_have_defaults_and_limits() {
    let config: WriteArrow = toml::from_str("").unwrap();
    assert_eq!((config.path.as_str(), config.compression), ("*.arrow", ContainerCompression::Lz4));
    assert_eq!(config.outputs(), ["*.arrow"]);
    let config: WriteArrow = toml::from_str("path = \"-\"\ncompression = \"none\"").unwrap();
    assert_eq!((config.outputs().len(), config.compression), (0, ContainerCompression::None));
    assert_eq!(config.check(), Ok(()));
    let config: WriteArrow = toml::from_str("path = \"\"").unwrap();
    assert_eq!(config.check(), Err(InvalidKey::new("path", "the path is empty")));
    let error = toml::from_str::<WriteArrow>("compression = \"gzip\"").unwrap_err().to_string();
    assert!(error.contains("expected one of `none`, `lz4`, `zstd`"), "{error}");
    let error = toml::from_str::<WriteArrow>("level = 3").unwrap_err().to_string();
    assert!(error.contains("unknown field `level`"), "{error}");
}

#[test]
fn other_kinds_of_batches_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let mut sink = WriteArrow::default().make(&run(folder.path(), "")).unwrap();
    let mut scan_line = ScanLine::of_shots(plain_info(), 0, vec![], Blocks::default());
    scan_line.content = wavex_line::scan_line::Content::Returns(vec![]);
    let error = sink.write(&scan_line, &mut Context::default()).unwrap_err().to_string();
    assert_eq!(error, "write_arrow received Returns, but writes Shots; put it before `decompose`");
}

#[test]
fn only_recordings_with_gain_control_have_a_field_for_the_gain() {
    for (gain_control, has_field) in
        [(GainControl::Off, false), (GainControl::NotRecorded, false), (GainControl::Recorded, true)]
    {
        let folder = tempfile::tempdir().unwrap();
        let info = Arc::new(InputInfo { gain_control, ..plain_info().as_ref().clone() });
        let mut blocks = Blocks::default();
        blocks.push(0, Channel::LowPower, None, 0.0, 1.0, &[1, 2]);
        let emission = Emission { mta_zone: Some(0), ..Emission::default() };
        write(folder.path(), &WriteArrow::default(), &[ScanLine::of_shots(info, 0, vec![emission], blocks)]);
        let table = container::TableReader::open(&folder.path().join("made.arrow")).unwrap();
        let fields = format!("{:?}", table.schema().field_with_name("blocks").unwrap());
        assert_eq!(fields.contains("gain"), has_field, "{fields}");
        let found = &read(folder.path())[0];
        assert_eq!(found.input.gain_control, gain_control);
        assert!(found.blocks().unwrap().iter().all(|block| block.gain == 1.0));
    }
}

#[test]
fn a_gain_that_the_header_does_not_announce_is_an_error() {
    let folder = tempfile::tempdir().unwrap();
    let mut blocks = Blocks::default();
    blocks.push(0, Channel::LowPower, None, 0.0, 1.0, &[1, 2]);
    blocks.set_last_gain(2.0);
    let scan_line = ScanLine::of_shots(plain_info(), 0, vec![Emission::default()], blocks);
    let mut sink = WriteArrow::default().make(&run(folder.path(), "")).unwrap();
    let error = sink.write(&scan_line, &mut Context::default()).unwrap_err().to_string();
    assert!(error.contains("a block has a gain, but the container header declares none"), "{error}");
}

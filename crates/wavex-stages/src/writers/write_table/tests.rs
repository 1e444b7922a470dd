//! Tables are read back by the libraries that users read them with.

use std::fs::{self, File};
use std::path::Path;
use std::sync::Arc;

use arrow_array::RecordBatch;
use arrow_array::cast::AsArray;
use arrow_array::types::{Float64Type, Int16Type, UInt64Type};
use arrow_ipc::reader::FileReader;
use parquet::arrow::arrow_reader::ParquetRecordBatchReaderBuilder;
use parquet::file::reader::{FileReader as _, SerializedFileReader};

use super::*;
use wavex_line::scan_line::{
    Blocks, Content, Emission, EmissionReference, Frame, InputInfo, Return, ReturnChannel,
};
use wavex_line::stage::{Config as _, Item};

const NAMES: &str = "shot,gps_time_s,return_number,number_of_returns,channel,mta_zone,range_m,range_sd_m,\
    time_of_flight_ns,time_of_flight_sd_ns,amplitude_dn,amplitude_sd_dn,amplitude_db,width_ratio,\
    width_ratio_sd,fwhm_ns,thickness_m,thickness_sd_m,deviation_ratio,intensity,intensity_sd,flags,withheld,\
    class,x,y,z,total_uncertainty_m,height_above_ground_m,profile_peaks,profile_first_range_m,profile_first_range_sd_m,\
    profile_last_range_m,profile_last_range_sd_m,rh25_m,rh25_sd_m,rh50_m,rh50_sd_m,rh75_m,rh75_sd_m,rh98_m,\
    rh98_sd_m,rh100_m,rh100_sd_m,profile_energy_dn,profile_energy_sd_dn,profile_flags";

fn info() -> Arc<InputInfo> {
    Arc::new(InputInfo {
        full_scale_is_set: false,
        gain_control: wavex_line::scan_line::GainControl::Off,
        path: "made.sdf".into(),
        stem: "made".into(),
        format: "made".into(),
        instrument: None,
        serial: None,
        odd_sample_shift: 0.0,
        sampling_interval_ns: 1.0,
        full_scale_dn: None,
        group_velocity_mps: 299_707_502.0,
        pulse_rate_hz: None,
        time_scale: wavex_line::scan_line::TimeScale::Adjusted,
        gps_week: None,
        recorded: None,
        frame: Frame::Body,
        crs_wkt: None,
        coordinate_grid: None,
        emission_reference: EmissionReference::Clock,
        origin_is_sensor: true,
        first_shot: None,
        amplitude_low: None,
        amplitude_high: None,
        range_low: None,
        range_high: None,
        ..InputInfo::default()
    })
}

fn emission(shot: u64) -> Emission {
    Emission {
        shot,
        gps_time_s: if shot == 11 { f64::NAN } else { shot as f64 / 3.0 },
        clock_ps: shot as i64,
        origin_m: [0.0; 3],
        direction: [0.0, 0.0, 1.0],
        frame_scale: 1.0,
        emission_ns: 0.0,
        emission_sd_ns: f64::NAN,
        facet: 0,
        flags: 0,
        mta_zone: None,
        scan_angle_deg: 0.0,
    }
}

fn found(emission: u32, value: f64) -> Return {
    Return {
        emission,
        return_number: 1,
        number_of_returns: 2,
        channel: ReturnChannel::Low,
        flags: 0x0201,
        mta_zone: 3,
        time_of_flight_ns: value,
        time_of_flight_sd_ns: 0.02,
        range_m: value * 0.15,
        range_sd_m: 0.003,
        amplitude_dn: 0.1 + 0.2,
        amplitude_sd_dn: 0.9,
        gain: 1.0,
        peak_dn: 2.5,
        peak_sd_dn: 0.9,
        amplitude_db: 12.5,
        width_ratio: 1.25,
        width_ratio_sd: 0.5,
        total_sd_m: f64::NAN,
        fwhm_ns: 4.5,
        thickness_m: 0.25,
        thickness_sd_m: 0.125,
        deviation_ratio: -1.5,
        intensity: 1e-7,
        intensity_sd: f64::NAN,
        withheld: true,
        class: 18,
        height_above_ground_m: 2.5,
    }
}

/// A line of three shots from `shot` on, with three returns and optional coordinates.
fn line(shot: u64, with_points: bool) -> ScanLine {
    let emissions = (shot..shot + 3).map(emission).collect();
    let mut returns = vec![found(0, 1000.0), found(1, 2000.0), found(1, 3000.5)];
    returns[1].channel = ReturnChannel::High;
    returns[1].amplitude_db = f64::NAN;
    returns[2].channel = ReturnChannel::Joint;
    returns[2].mta_zone = -1;
    returns[2].total_sd_m = 0.0625;
    let mut scan_line = ScanLine::of_shots(info(), 0, emissions, Blocks::default());
    scan_line.content = match with_points {
        true => Content::Points(returns, vec![[1.5, 2.5, 3.5], [4.0, 5.0, 6.0], [7.0, 8.0, -9.125]]),
        false => Content::Returns(returns),
    };
    scan_line
}

fn write(folder: &Path, config: &WriteTable, lines: &[ScanLine]) -> Context {
    let run = RunContext {
        input: "made.sdf".into(),
        stem: "made".into(),
        input_dir: folder.into(),
        output_dir: folder.into(),
        simd: wavex_simd::SimdLevel::best(),
        ..RunContext::alone("".as_ref())
    };
    let mut cx = Context::default();
    let mut sink = config.make(&run).unwrap();
    lines.iter().for_each(|scan_line| sink.write(scan_line, &mut cx).unwrap());
    sink.finish(&mut cx).unwrap();
    for whole in cx.take_files() {
        whole.publish().unwrap();
    }
    cx
}

fn config(path: &str) -> WriteTable {
    WriteTable { path: path.into(), format: None }
}

fn arrow(path: &Path) -> Vec<RecordBatch> {
    FileReader::try_new(File::open(path).unwrap(), None).unwrap().map(|batch| batch.unwrap()).collect()
}

fn parquet(path: &Path) -> Vec<RecordBatch> {
    let builder = ParquetRecordBatchReaderBuilder::try_new(File::open(path).unwrap()).unwrap();
    builder.build().unwrap().map(|batch| batch.unwrap()).collect()
}

#[test]
fn arrow_and_parquet_hold_the_same_columns() {
    let folder = tempfile::tempdir().unwrap();
    for with_points in [false, true] {
        let lines = [line(10, with_points)];
        write(folder.path(), &config("*.arrow"), &lines);
        write(folder.path(), &config("*.parquet"), &lines);
        let of_arrow = arrow(&folder.path().join("made.arrow")).remove(0);
        let of_parquet = parquet(&folder.path().join("made.parquet")).remove(0);
        // The geometry is the last column.
        assert_eq!(of_parquet.num_columns() - of_arrow.num_columns(), usize::from(with_points));
        let common: Vec<usize> = (0..of_arrow.num_columns()).collect();
        let of_parquet = of_parquet.project(&common).unwrap();
        // Compared as text, because NaN is not equal to itself.
        assert_eq!(format!("{:?}", of_arrow.columns()), format!("{:?}", of_parquet.columns()));
        let schema = of_arrow.schema();
        assert_eq!(schema.fields(), of_parquet.schema().fields());
        let names: Vec<&str> = schema.fields().iter().map(|field| field.name().as_str()).collect();
        assert_eq!(names.join(","), NAMES);
        assert_eq!(schema.metadata().get("wavex.time_scale").unwrap(), "adjusted");

        let column = |name| of_arrow.column_by_name(name).unwrap();
        assert_eq!(column("shot").as_primitive::<UInt64Type>().values(), &[10, 11, 11]);
        let channels: Vec<_> = column("channel").as_string::<i32>().iter().flatten().collect();
        assert_eq!(channels, ["low", "high", "joint"]);
        let zones: Vec<_> = column("mta_zone").as_primitive::<Int16Type>().iter().collect();
        assert_eq!(zones, [Some(3), Some(3), None]);
        let numbers = |name| column(name).as_primitive::<Float64Type>().iter().collect::<Vec<_>>();
        assert_eq!(numbers("gps_time_s"), [Some(10.0 / 3.0), None, None]);
        assert_eq!(numbers("amplitude_db"), [Some(12.5), None, Some(12.5)]);
        assert_eq!(numbers("time_of_flight_ns"), [Some(1000.0), Some(2000.0), Some(3000.5)]);
        assert!(numbers("intensity_sd").iter().all(|sd| sd.unwrap().is_nan()), "unknown, but not null");
        let z = if with_points { [Some(3.5), Some(6.0), Some(-9.125)] } else { [None; 3] };
        assert_eq!(numbers("z"), z);
        assert_eq!(numbers("height_above_ground_m"), [Some(2.5); 3]);
        assert_eq!(numbers("total_uncertainty_m"), [None, None, Some(0.0625)]);
    }
}

#[test]
fn csv_is_text_with_all_digits_and_nothing_for_null() {
    let folder = tempfile::tempdir().unwrap();
    write(folder.path(), &config("*.csv"), &[line(10, false), line(20, true)]);
    let text = fs::read_to_string(folder.path().join("made.csv")).unwrap();
    let lines: Vec<&str> = text.lines().collect();
    assert_eq!(lines.len(), 7);
    assert_eq!(lines[0], NAMES);
    assert_eq!(
        lines[1],
        "10,3.3333333333333335,1,2,low,3,150.0,0.003,1000.0,0.02,0.30000000000000004,0.9,12.5,1.25,0.5,4.5,\
         0.25,0.125,-1.5,1e-7,NaN,513,true,18,,,,,2.5,,,,,,,,,,,,,,,,,,"
    );
    assert!(lines[2].starts_with("11,,1,2,high,3,300.0,"), "{}", lines[2]);
    assert!(lines[3].starts_with("11,,1,2,joint,,"), "{}", lines[3]);
    assert!(lines[6].ends_with(",513,true,18,7.0,8.0,-9.125,0.0625,2.5,,,,,,,,,,,,,,,,,,"), "{}", lines[6]);
}

#[test]
fn a_table_without_returns_has_its_columns() {
    let folder = tempfile::tempdir().unwrap();
    for path in ["*.arrow", "*.parquet", "*.csv"] {
        write(folder.path(), &config(path), &[]);
    }
    assert!(arrow(&folder.path().join("made.arrow")).is_empty());
    let file = File::open(folder.path().join("made.parquet")).unwrap();
    let metadata = ParquetRecordBatchReaderBuilder::try_new(file).unwrap();
    assert_eq!(metadata.schema().fields().len(), 47);
    assert_eq!(metadata.metadata().file_metadata().num_rows(), 0);
    assert_eq!(fs::read_to_string(folder.path().join("made.csv")).unwrap(), format!("{NAMES}\n"));
}

#[test]
fn rows_are_grouped_by_their_number_whatever_the_lines_and_the_bytes_repeat() {
    let emissions: Vec<Emission> = (0..4).map(emission).collect();
    let scan_line = |n: usize| {
        let mut scan_line = ScanLine::of_shots(info(), 0, emissions.clone(), Blocks::default());
        scan_line.content = Content::Returns((0..n).map(|i| found((i % 4) as u32, 7.0)).collect());
        scan_line
    };
    // Multiples of 4, so that the rows are the same for any division into lines.
    let total = ROWS_PER_GROUP + 4000;
    let cuts = [vec![total], vec![1000, ROWS_PER_GROUP - 1000, 4000], vec![total / 2; 2]];
    for (path, name) in [("*.arrow", "made.arrow"), ("*.parquet", "made.parquet"), ("*.csv", "made.csv")] {
        let bytes = cuts.clone().map(|sizes| {
            let folder = tempfile::tempdir().unwrap();
            let lines: Vec<ScanLine> = sizes.into_iter().map(scan_line).collect();
            write(folder.path(), &config(path), &lines);
            let path = folder.path().join(name);
            let groups: Vec<usize> = match name {
                "made.arrow" => arrow(&path).iter().map(RecordBatch::num_rows).collect(),
                "made.parquet" => {
                    let file = SerializedFileReader::new(File::open(&path).unwrap()).unwrap();
                    file.metadata().row_groups().iter().map(|group| group.num_rows() as usize).collect()
                }
                _ => vec![
                    ROWS_PER_GROUP,
                    fs::read_to_string(&path).unwrap().lines().count() - 1 - ROWS_PER_GROUP,
                ],
            };
            assert_eq!(groups, [ROWS_PER_GROUP, 4000], "{name}");
            fs::read(path).unwrap()
        });
        assert!(bytes[0] == bytes[1] && bytes[0] == bytes[2], "{name}");
    }
}

#[test]
fn a_parquet_file_says_who_made_it_and_what_its_times_count() {
    let folder = tempfile::tempdir().unwrap();
    write(folder.path(), &config("*.parquet"), &[line(0, false)]);
    let file = SerializedFileReader::new(File::open(folder.path().join("made.parquet")).unwrap()).unwrap();
    let by = file.metadata().file_metadata().created_by().unwrap();
    assert_eq!(by, format!("wavex {}", env!("CARGO_PKG_VERSION")));
    let about = file.metadata().file_metadata().key_value_metadata().unwrap();
    let scale = about.iter().find(|about| about.key == "wavex.time_scale").unwrap();
    assert_eq!(scale.value.as_deref(), Some("adjusted"));
}

#[test]
fn a_return_of_no_emission_is_counted() {
    let folder = tempfile::tempdir().unwrap();
    let mut scan_line = line(0, false);
    if let Content::Returns(returns) = &mut scan_line.content {
        returns[2].emission = 3;
    }
    let cx = write(folder.path(), &config("*.csv"), &[scan_line]);
    assert_eq!(cx.counters().rejected[&(Item::Returns, Reason::ReturnWithoutShot)], 1);
    assert_eq!(fs::read_to_string(folder.path().join("made.csv")).unwrap().lines().count(), 3);
}

#[test]
fn the_extension_or_the_key_names_the_format() {
    assert_eq!(format_of("a/b.PARQUET", None), Ok(TableFormat::Parquet));
    assert_eq!(format_of("a.csv", None), Ok(TableFormat::Csv));
    assert_eq!(config("a.csv.arrow").check(), Ok(()));
    let problem = "it does not end in .arrow, .parquet or .csv: set the key `format`";
    for path in ["a.txt", "arrow", ".csv"] {
        assert_eq!(config(path).check(), Err(InvalidKey::new("path", problem)), "{path}");
    }
    let spreadsheet = "files of spreadsheet programs are not written; they read .csv: end the name in .csv";
    assert_eq!(format_of("a.xlsx", Some(TableFormat::Parquet)), Err(InvalidKey::new("path", spreadsheet)));
    assert_eq!(config("").check(), Err(InvalidKey::new("path", "the path is empty")));
    let given: WriteTable = toml::from_str("path = \"a.txt\"\nformat = \"csv\"").unwrap();
    assert_eq!((format_of(&given.path, given.format), given.check()), (Ok(TableFormat::Csv), Ok(())));
    let default: WriteTable = toml::from_str("").unwrap();
    assert_eq!(
        (default.outputs(), format_of(&default.path, default.format)),
        (vec!["*_returns.parquet"], Ok(TableFormat::Parquet))
    );
    let error = toml::from_str::<WriteTable>("compression = \"lz4\"").unwrap_err().to_string();
    assert!(error.contains("unknown field `compression`"), "{error}");
    let error = toml::from_str::<WriteTable>("format = \"xlsx\"").unwrap_err().to_string();
    assert!(error.contains("expected one of `arrow`, `parquet`, `csv`"), "{error}");
}

#[test]
fn shots_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let run = RunContext {
        input: "made.sdf".into(),
        stem: "made".into(),
        input_dir: folder.path().into(),
        output_dir: folder.path().into(),
        simd: wavex_simd::SimdLevel::best(),
        ..RunContext::alone("".as_ref())
    };
    let mut sink = config("*.csv").make(&run).unwrap();
    let scan_line = ScanLine::of_shots(info(), 0, vec![], Blocks::default());
    let error = sink.write(&scan_line, &mut Context::default()).unwrap_err().to_string();
    assert_eq!(error, "write_table received Shots, but writes Returns or Points; put it after `decompose`");
    drop(sink);
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
}

#[test]
fn the_columns_stand_in_the_schemas() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../schemas/return_table.json");
    let expected = serde_json::to_string_pretty(&description()).unwrap() + "\n";
    if fs::read_to_string(&path).ok().as_deref() != Some(&expected) {
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(&path, expected).unwrap();
        panic!("schemas/return_table.json was out of date and has been rewritten; commit it");
    }
}

/// A disk that is full after some bytes.
struct Full(usize);

impl std::io::Write for Full {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        self.0 = self.0.checked_sub(bytes.len()).ok_or_else(|| std::io::Error::other("no space left"))?;
        Ok(bytes.len())
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

#[test]
fn a_full_disk_is_an_error_in_each_format() {
    for format in [TableFormat::Arrow, TableFormat::Parquet, TableFormat::Csv] {
        for room in [0, 5000] {
            let rows = (0..1000).map(|shot| ReturnRow {
                shot,
                gps_time_s: shot as f64,
                found: found(0, shot as f64),
                point: None,
                profile: None,
            });
            let written = TableWriter::new(
                Full(room),
                Path::new("a.table"),
                format,
                ReturnColumns,
                TableInfo::default(),
            )
            .and_then(|mut table| {
                rows.into_iter().try_for_each(|row| table.push(row))?;
                table.finish()
            });
            let Err(error) = written else { panic!("{format:?} was written") };
            assert_eq!(error.to_string(), "a.table: cannot write: no space left", "{format:?}");
        }
    }
}

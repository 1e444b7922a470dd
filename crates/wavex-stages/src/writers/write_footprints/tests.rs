//! Tables of footprints.

use std::path::Path;

use arrow_array::cast::AsArray;
use arrow_array::types::{Float32Type, Float64Type, UInt64Type};
use wavex_footprints::{HEIGHTS, WithSd};
use wavex_line::scan_line::{Content, Emission, Footprint, InputInfo, Return};

use super::*;
use crate::writers::table::TableColumns;

fn footprint(emission: u32) -> Footprint {
    let known = |value: f64| WithSd { value, sd: 0.1 * value };
    Footprint {
        emission,
        shot_number: 19_640_119_100_108_615 + u64::from(emission),
        ground_range_m: known(60.0),
        ground_probability: 0.9,
        ground_total_sd_m: 7.0,
        second_ground_height_m: WithSd { value: -4.0, sd: 0.5 },
        second_ground_probability: 0.08,
        ground_amplitude_dn: known(80.0),
        ground_half_width_ratios: [1.1, 1.3],
        heights_m: Box::new(std::array::from_fn(|percent| percent as f32 * 0.25)),
        heights_sd_m: Box::new([0.5; HEIGHTS]),
        modes: 2,
        energy_dn: known(200.0),
        ground_energy_ratio: known(0.5),
        cover: known(0.4),
        plant_area_index: known(1.0),
        sensitivity: 0.97,
        deviation: 0.3,
        flags: 8,
        columns: Box::new([1.5, f64::from(emission)]),
    }
}

/// Two shots; the second has no ground.
fn line() -> ScanLine {
    let input = InputInfo {
        beam: Some("BEAM0101".to_owned()),
        columns: vec!["degrade", "geoid"],
        ..InputInfo::default()
    };
    let emissions = (5..7).map(|shot| Emission { shot, gps_time_s: 10.0, ..Emission::default() }).collect();
    let found = |class: u8| Return { emission: 0, class, ..Return::default() };
    let points = vec![[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]];
    let line = ScanLine::of_shots(Arc::new(input), 0, emissions, Default::default());
    let footprints = vec![footprint(0), footprint(1)];
    ScanLine { content: Content::Points(vec![found(0), found(2)], points), footprints, ..line }
}

#[test]
fn a_row_is_a_shot_with_the_position_of_its_ground() {
    let line = line();
    let rows: Vec<FootprintRow> = rows_of(&line).collect();
    let columns = FootprintColumns::of(&line.input.columns);
    let schema = columns.schema("adjusted", None);
    let batch = columns.batch(&schema, &rows).unwrap();
    let of = |name: &str| {
        batch.column_by_name(name).unwrap_or_else(|| panic!("{name}")).as_primitive::<Float64Type>()
    };
    assert_eq!((batch.num_rows(), of("x").value(0), of("z").value(0)), (2, 4.0, 6.0));
    assert!(arrow_array::Array::is_null(of("x"), 1), "without ground");
    assert_eq!((of("ground_sd_m").value(0), of("geoid").value(1)), (6.0, 1.0));
    let second =
        ["ground_total_sd_m", "second_ground_height_m", "second_ground_sd_m", "second_ground_probability"];
    assert_eq!(second.map(|name| of(name).value(0)), [7.0, -4.0, 0.5, 0.08]);
    assert_eq!(of("deviation").value(0), 0.3);
    let numbers = batch.column_by_name("shot_number").unwrap().as_primitive::<UInt64Type>();
    assert_eq!(numbers.value(1), 19_640_119_100_108_616, "more digits than a double");
    let heights = batch.column_by_name("rh_m").unwrap().as_fixed_size_list().value(1);
    assert_eq!((heights.len(), heights.as_primitive::<Float32Type>().value(98)), (101, 24.5));
}

#[test]
fn text_has_a_column_for_each_height() {
    let line = line();
    let rows: Vec<FootprintRow> = rows_of(&line).collect();
    let columns = FootprintColumns::of(&line.input.columns);
    let header = columns.csv_header();
    let names: Vec<&str> = header.trim_end().split(',').collect();
    let text = columns.csv(&rows);
    let values: Vec<&str> = text.lines().next().unwrap().split(',').collect();
    assert_eq!(names.len(), values.len());
    let of = |name: &str| values[names.iter().position(|column| *column == name).unwrap()];
    assert_eq!((of("rh98_m"), of("rh0_sd_m"), of("beam"), of("degrade")), ("24.5", "0.5", "BEAM0101", "1.5"));
}

#[test]
fn every_column_says_what_it_is() {
    let columns = FootprintColumns::of(&["geoid"]);
    for field in columns.schema("adjusted", None).fields() {
        assert!(field.metadata().contains_key("description"), "{}", field.name());
    }
}

#[test]
fn the_extension_or_the_format_says_what_to_write() {
    use wavex_line::stage::Config;
    let of = |path: &str, format| WriteFootprints { path: path.to_owned(), format };
    assert!(of("a.xlsx", None).check().is_err() && of("", None).check().is_err());
    assert!(of("a.xlsx", Some(TableFormat::Csv)).check().is_err(), "spreadsheet programs read .csv");
    assert!(of("a.txt", Some(TableFormat::Csv)).check().is_ok() && of("a.CSV", None).check().is_ok());
    assert_eq!(Path::new(&WriteFootprints::default().path).extension().unwrap(), "parquet");
}

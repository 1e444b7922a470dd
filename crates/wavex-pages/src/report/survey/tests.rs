//! Surveys of strips made in memory.

use std::sync::Arc;

use super::*;
use wavex_line::scan_line::{Blocks, Content, Emission, InputInfo, Return, ScanLine};

const UTM: &str = "PROJCS[\"WGS 84 / UTM zone 33N\",GEOGCS[\"WGS 84\"],UNIT[\"metre\",1]]";

/// A strip of points every 0.5 m on a plane, from a corner, with an area in metres.
///
/// Heights have an error of ±5 mm.
fn strip(stem: &str, [x0, y0]: [f64; 2], [width, length]: [u32; 2], raised_m: f64) -> CollectedStrip {
    let collector = StripCollector::new(2.0);
    let input = Arc::new(InputInfo { crs_wkt: Some(UTM.to_owned()), ..InputInfo::default() });
    for line in 0..2 * length {
        let mut scan_line = ScanLine::of_shots(Arc::clone(&input), line, Vec::new(), Blocks::default());
        let points = (0..2 * width).map(|i| {
            let (x, y) = (x0 + 0.5 * f64::from(i) + 0.1, y0 + 0.5 * f64::from(line) + 0.1);
            let error_m = if (i / 2 + line) % 2 == 0 { 0.005 } else { -0.005 };
            [x, y, 400.0 + 0.02 * (x - 320_000.0) - 0.01 * (y - 5_300_000.0) + raised_m + error_m]
        });
        let points: Vec<[f64; 3]> = points.collect();
        scan_line.emissions = vec![Emission::default(); points.len()];
        scan_line.stats.nw = points.len() as u64;
        scan_line.content = Content::Points(vec![Return::default(); points.len()], points);
        collector.add(&scan_line);
    }
    collector.take(stem)
}

/// Writes cells and returns the input.
fn stored(folder: &Path, strip: &CollectedStrip) -> SurveyInput {
    let path = folder.join(format!("{}_cells.arrow", strip.facts.stem));
    let cells = write_cells(strip, OutputFile::create(&path).unwrap()).unwrap();
    SurveyInput { stem: strip.facts.stem.clone(), cells: Some(cells), ..SurveyInput::default() }
}

fn survey_of(inputs: &[SurveyInput], keys: &SurveyKeys) -> Survey {
    survey(inputs, keys, None).unwrap().0
}

fn near(value: f64, expected: f64, tolerance: f64) -> bool {
    (value - expected).abs() <= tolerance
}

#[test]
fn overlapping_strips_are_compared() {
    let folder = tempfile::tempdir().unwrap();
    let keys = SurveyKeys { target_pulses_per_m2: Some(5.0), ..SurveyKeys::default() };
    let a = strip("a", [320_000.0, 5_300_000.0], [60, 80], 0.0);
    let b = strip("b", [320_040.0, 5_300_000.0], [60, 80], 0.03);
    let survey = survey_of(&[stored(folder.path(), &a), stored(folder.path(), &b)], &keys);
    assert_eq!((survey.area_m2, survey.overlap_m2), (8000.0, 1600.0));
    assert_eq!(survey.extent, Some([320_000.0, 5_300_000.0, 320_100.0, 5_300_080.0]));
    // 4 pulses per m² in each strip, 8 in the overlap.
    assert!(survey.pulses.as_ref().is_some_and(|of| near(of.median_per_m2, 4.0, 1e-9)));
    assert!(survey.pulses.as_ref().is_some_and(|of| near(of.mean_per_m2, 4.8, 1e-9)));
    assert_eq!(survey.below_target_m2, Some(6400.0));
    let [pair] = survey.pairs.as_slice() else { panic!("{:?}", survey.pairs) };
    assert_eq!((&pair.strips, pair.differences.cells), (&["a".to_owned(), "b".to_owned()], 400));
    assert!(near(pair.differences.median_m, 0.03, 5e-4), "{pair:?}");
    assert!(near(pair.differences.rms_m, 0.03, 5e-4) && !pair.exceeds_limit, "{pair:?}");
    assert!(near(pair.differences.noise_rms_m, 0.005 * (2.0f64 / 13.0).sqrt(), 1e-3), "{pair:?}");
    let offsets: Vec<f64> = survey.strips.iter().filter_map(|strip| strip.offset_m).collect();
    assert!(near(offsets[1] - offsets[0], 0.03, 5e-4), "{offsets:?}");
    assert!(survey.roughness.is_some_and(|of| near(of.median_m, 0.0055, 1e-3)));
    assert_eq!(survey.gaps.count, 0);
}

/// A coarser strip has the densities and differences of a fine one: sums move exactly.
#[test]
fn strips_with_larger_cells_are_compared_at_their_size() {
    let folder = tempfile::tempdir().unwrap();
    let keys = SurveyKeys::default();
    let a = strip("a", [320_000.0, 5_300_000.0], [64, 64], 0.0);
    let mut b = strip("b", [320_000.0, 5_300_000.0], [64, 64], 0.01);
    let mut cells: Vec<grid::PlacedCell> = b.cells.iter().map(|cell| grid::coarser(*cell, 1)).collect();
    cells.sort_by_key(|cell| (std::cmp::Reverse(cell.row), cell.column));
    cells.dedup_by(|later, first| {
        let is_same = (later.row, later.column) == (first.row, first.column);
        if is_same {
            first.sums.merge(&later.sums);
        }
        is_same
    });
    b.cells = cells;
    b.facts.level = 1;
    b.facts.extent = b.facts.extent.map(|extent| extent.map(|corner| corner.map(|at| at >> 1)));
    let survey = survey_of(&[stored(folder.path(), &a), stored(folder.path(), &b)], &keys);
    assert_eq!((survey.cell_m, survey.area_m2, survey.overlap_m2), (4.0, 4096.0, 4096.0));
    assert_eq!(survey.pairs[0].differences.cells, 256);
    assert!(near(survey.pairs[0].differences.median_m, 0.01, 5e-4), "{:?}", survey.pairs);
}

#[test]
fn a_strip_that_does_not_fit_is_left_out_with_a_reason() {
    let folder = tempfile::tempdir().unwrap();
    let a = strip("a", [320_000.0, 5_300_000.0], [20, 20], 0.0);
    let mut b = strip("b", [320_000.0, 5_300_000.0], [20, 20], 0.0);
    b.facts.crs_wkt = None;
    let failed =
        SurveyInput { stem: "c".to_owned(), failure: Some("cut off".to_owned()), ..SurveyInput::default() };
    let inputs = [stored(folder.path(), &a), stored(folder.path(), &b), failed];
    let survey = survey_of(&inputs, &SurveyKeys::default());
    let failures: Vec<Option<&str>> = survey.strips.iter().map(|strip| strip.failure.as_deref()).collect();
    let other = "its coordinate reference system is not that of a; name a missing one by `crs_of_input` of the reader, \
                 set `crs` of `[job.geometry]` for recordings in the earth-centred or the scanner's frame, and give \
                 recordings of different frames jobs of their own and their outputs to `wavex survey`";
    assert_eq!(failures, [None, Some(other), Some("cut off")]);
    let written = write_survey(&inputs, &SurveyKeys::default(), &folder.path().join("page.html")).unwrap();
    // The run has reported the failed strip.
    assert_eq!(written.not_compared, [format!("b is not on the page of the survey: {other}")]);
    assert!(survey.pairs.is_empty() && survey.area_m2 == 400.0);
    // Without any strip there is still a page.
    let none = survey_of(&inputs[2..], &SurveyKeys::default());
    assert!(page::page(&none, None).contains("cut off"));
}

#[test]
fn damaged_cells_are_noticed() {
    let folder = tempfile::tempdir().unwrap();
    let mut a = strip("a", [320_000.0, 5_300_000.0], [20, 20], 0.0);
    let input = stored(folder.path(), &a);
    let path = input.cells.clone().unwrap();
    let bytes = std::fs::read(&path).unwrap();
    for length in [0, 5, 100, bytes.len() / 2, bytes.len() - 40] {
        std::fs::write(&path, &bytes[..length]).unwrap();
        let found = survey(std::slice::from_ref(&input), &SurveyKeys::default(), None);
        assert!(
            found.is_err() || found.is_ok_and(|(found, _)| found.strips[0].failure.is_some()),
            "{length}"
        );
    }
    a.cells.swap(0, 1);
    let swapped = survey(&[stored(folder.path(), &a)], &SurveyKeys::default(), None);
    let message = swapped.err().map(|error| error.to_string()).unwrap_or_default();
    assert!(message.contains("not sorted from north to south; run its strip again"), "{message}");
}

/// The page of a large survey stays small; rasters are written once.
#[test]
fn the_page_of_three_hundred_strips_is_small() {
    let folder = tempfile::tempdir().unwrap();
    let of = |i: u32| {
        let crosses = i % 10 == 9;
        let place = if crosses {
            [320_000.0, 5_300_000.0 + f64::from(i)]
        } else {
            [320_000.0 + 25.0 * f64::from(i), 5_300_000.0]
        };
        let size = if crosses { [1500, 12] } else { [40, 300] };
        strip(&format!("{i:03}_strip_of_the_survey"), place, size, 0.001 * f64::from(i % 7))
    };
    let inputs: Vec<SurveyInput> = (0..300).map(|i| stored(folder.path(), &of(i))).collect();
    let page = folder.path().join("survey.html");
    let started = std::time::Instant::now();
    let written = write_survey(&inputs, &SurveyKeys::default(), &page).unwrap();
    assert_eq!(written.files, [vec![page.clone()], survey_files(&page)].concat());
    assert!(written.not_compared.is_empty(), "{:?}", written.not_compared);
    let bytes = std::fs::metadata(&page).unwrap().len();
    println!("page of 300 strips: {bytes} bytes, {:.1} s", started.elapsed().as_secs_f64());
    assert!(bytes < 10_000_000, "{bytes}");
    if let Some(kept) = std::env::var_os("WAVEX_KEEP_PAGE") {
        std::fs::copy(&page, kept).unwrap();
    }
    let leftovers: Vec<_> =
        folder.path().read_dir().unwrap().flatten().map(|entry| entry.file_name()).collect();
    assert!(leftovers.iter().all(|name| !name.to_string_lossy().contains("partial")), "{leftovers:?}");
}

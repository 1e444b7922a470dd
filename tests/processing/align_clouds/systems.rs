//! Clouds as COPC, in feet, and in degrees.

use super::*;

const SECOND: Strip = Strip { seed: 2, errors_m: [[0.05, 0.03, 0.08]; 2], ..GOOD };

/// Difference of the corrections of two strips, x, y, z, with its SD, m.
fn corrections_apart(report: &Value) -> [[f64; 2]; 3] {
    let [first, second] = [0, 1].map(|strip| knots(report, strip)[0]);
    [0, 1, 2].map(|axis| [first[axis][0] - second[axis][0], 2.0 * second[axis][1]])
}

/// Checks that the second strip's errors are found.
fn expect_errors(report: &Value, errors_m: [f64; 3]) {
    for (axis, ([found_m, sd_m], error_m)) in corrections_apart(report).into_iter().zip(errors_m).enumerate()
    {
        println!("axis {axis}: {found_m} instead of {error_m}, SD {sd_m}");
        let most_m = if axis == 2 { 0.001 } else { 0.01 };
        assert!((found_m - error_m).abs() < (3.5 * sd_m).min(most_m), "axis {axis}: {found_m} {sd_m}");
    }
}

fn read_report(place: &TestFolder, folder: &str) -> Value {
    serde_json::from_str(&place.text(&format!("{folder}/align.json"))).unwrap()
}

/// A cloud without coordinate reference system as LAS 1.4, format 6, which COPC needs.
fn version_1_4(las: &[u8]) -> Vec<u8> {
    let (header, records) = las.split_at(227);
    let mut bytes = header.to_vec();
    let mut set = |at: usize, value: &[u8]| bytes[at..at + value.len()].copy_from_slice(value);
    // The system is WKT, if there is one; sizes; the counts of earlier versions are 0.
    set(6, &16u16.to_le_bytes());
    set(25, &[4]);
    set(94, &375u16.to_le_bytes());
    set(96, &375u32.to_le_bytes());
    set(104, &[6, 30, 0]);
    set(107, &[0; 24]);
    let n = (records.len() as u64 / 28).to_le_bytes();
    bytes.extend([0; 20]);
    bytes.extend(n);
    bytes.extend(n);
    bytes.extend([0; 112]);
    for record in records.chunks(28) {
        bytes.extend(&record[..14]);
        let (number, of) = (record[14] & 7, record[14] >> 3 & 7);
        bytes.extend([number | of << 4, 0, record[15], record[17], 0, 0]);
        bytes.extend(&record[18..]);
    }
    bytes
}

/// The points of a COPC file are in no order of time; corrected clouds lose the octree, and that is said.
#[test]
fn copc_is_aligned_like_las() {
    let place = TestFolder::new();
    for (strip, cloud) in [("a", GOOD), ("b", SECOND)] {
        place.write(&format!("{strip}.las"), &version_1_4(&las(&[Strip { epsg: None, ..cloud }])));
        succeeds(&place, &["copc", &format!("{strip}.las"), "--quiet"]);
    }
    let outcome = succeeds(&place, &["align", "a.copc.laz", "b.copc.laz", "-o", "aligned", "--apply"]);
    let found = report(&place);
    expect_errors(&found, SECOND.errors_m[0]);
    assert!(
        outcome
            .err
            .contains("b.laz: written as LAZ without the octree of COPC; convert it again for viewers"),
        "{}",
        outcome.err
    );
    assert!(place.path("aligned/a.laz").exists() && !place.path("aligned/a.copc.laz").exists());
    succeeds(&place, &["align", "aligned/a.laz", "aligned/b.laz", "-o", "again", "--quiet"]);
    expect_errors(&read_report(&place, "again"), [0.0; 3]);
    // As LAS: the same points, in another order.
    succeeds(&place, &["align", "a.las", "b.las", "-o", "las", "--quiet"]);
    let las = corrections_apart(&read_report(&place, "las"));
    for ([copc_m, _], [las_m, sd_m]) in corrections_apart(&found).into_iter().zip(las) {
        assert!((copc_m - las_m).abs() < 0.2 * sd_m, "{copc_m} {las_m} {sd_m}");
    }
}

/// Corrections of clouds in US survey feet are metres, and corrected clouds are in feet.
#[test]
fn clouds_in_feet_are_corrected_by_metres() {
    // NAD83 / California zone 5.
    let feet = |strip: Strip| Strip { epsg: Some(2229), unit_m: 1200.0 / 3937.0, ..strip };
    let place = clouds(&[("a.las", feet(GOOD)), ("b.las", feet(SECOND))]);
    succeeds(&place, &["align", "a.las", "b.las", "-o", "aligned", "--apply"]);
    expect_errors(&report(&place), SECOND.errors_m[0]);
    succeeds(&place, &["align", "aligned", "-o", "again", "--quiet"]);
    expect_errors(&read_report(&place, "again"), [0.0; 3]);
    // With others in metres.
    place.write("c.las", &las(&[SECOND]));
    let Outcome { code, err, .. } = place.wavex(&["align", "a.las", "c.las", "-o", "mixed"]);
    assert!(code == Some(1) && err.contains("c.las: its coordinate reference system is WGS 84"), "{err}");
}

#[test]
fn clouds_in_degrees_are_refused_with_a_remedy() {
    let degrees = |strip: Strip| Strip { epsg: Some(4326), unit_m: 111_120.0, ..strip };
    let place = clouds(&[("a.las", degrees(GOOD)), ("b.las", degrees(SECOND)), ("c.las", GOOD)]);
    let Outcome { code, err, .. } = place.wavex(&["align", "a.las", "b.las", "c.las", "-o", "aligned"]);
    assert_eq!(code, Some(1), "{err}");
    assert!(err.contains("alignment needs two strips, but only `c` can be used"), "{err}");
    for name in ["a.las", "b.las"] {
        let problem = "its coordinates are degrees; project the clouds to a system in metres, such as UTM";
        assert!(err.contains(&format!("{name}: {problem}")), "{err}");
    }
    assert!(!place.path("aligned").exists());
}

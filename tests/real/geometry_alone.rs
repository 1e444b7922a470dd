//! Results that need no returns of the vendor: the range walk.

use std::path::Path;

use wavex_returns::range_walk::RangeWalk;
use wavex_signal::sensor_model::SensorModel;
use wavex_testkit::data;
use wavex_testkit::recordings::robust;

use super::{Comparison, corrected};

/// Robust SD of the times of single returns about RIEGL's, ps.
///
/// RIEGL's time is the start of the segment plus the location in it, which has more digits than its
/// coordinates.
fn spread_ps(comparison: &Comparison) -> f64 {
    let [start, location_ps] =
        ["segment_start_units", "wave_location_ps"].map(|name| comparison.vendor.column(name));
    let ours_ns = comparison.ours.column("time_of_flight_ns");
    let difference_ps =
        |pair: &super::Pair| 1000.0 * (ours_ns[pair.ours] - start[pair.vendor]) - location_ps[pair.vendor];
    robust(&comparison.singles().iter().map(difference_ps).collect::<Vec<f64>>()).1
}

/// What `correct` finds in a recording of the LMS-Q680, and the model that it saves.
fn learnt_of(data: &Path, out: &Path, recording: &str) -> (String, SensorModel) {
    let job = Path::new(env!("CARGO_MANIFEST_DIR")).join("jobs/example3.toml");
    let text = std::fs::read_to_string(job).unwrap().replace("riegl_example3", recording);
    let georeference = "[[stage]]\ntype = \"georeference\"";
    let correct = format!(
        "[[stage]]\ntype = \"correct\"\nrange_walk = \"auto\"\nsave_model = \"{recording}.json\"\n{georeference}"
    );
    let text = text.replace(georeference, &correct);
    let report = wavex_testkit::recordings::run("walk.toml", &text, data, out, &[]);
    let stage = report.stages.iter().find(|stage| stage.r#type == "correct").unwrap();
    let finding = stage.findings.iter().find(|finding| finding.contains("delay by amplitude")).unwrap();
    println!("{recording}: {finding}");
    let model = std::fs::read_to_string(out.join(format!("{recording}.json"))).unwrap();
    (finding.clone(), serde_json::from_str(&model).unwrap())
}

#[test]
fn a_range_walk_learnt_from_geometry_agrees_with_riegls_times() {
    let Some(data) = data() else { return };
    let out = tempfile::tempdir().unwrap();
    // The same receiver, 20 s apart.
    let [first, second] =
        ["riegl_example3", "riegl_example4"].map(|recording| learnt_of(&data, out.path(), recording));
    for (finding, model) in [&first, &second] {
        assert_eq!(model.low_power_range_walk.is_some(), !finding.contains("not proven"), "{finding}");
    }
    if let (Some(a), Some(b)) = (&first.1.low_power_range_walk, &second.1.low_power_range_walk) {
        for dn in (40..=180).step_by(10).map(f64::from) {
            let change = |walk: &RangeWalk| {
                let [(at_ns, at_sd_ns), (from_ns, from_sd_ns)] = [dn, 100.0].map(|dn| walk.late_ns(dn));
                (at_ns - from_ns, at_sd_ns.hypot(from_sd_ns))
            };
            let [(a_ns, a_sd_ns), (b_ns, b_sd_ns)] = [a, b].map(change);
            assert!((a_ns - b_ns).abs() <= 2.0 * a_sd_ns.hypot(b_sd_ns), "{dn} DN: {a_ns} {b_ns}");
        }
    }

    let (raw, report) = corrected(&data, "range_walk = \"auto\"");
    let stage = report.stages.iter().find(|stage| stage.r#type == "correct").unwrap();
    let findings = stage.findings.join("\n");
    assert!(findings.contains("no delay by amplitude was learnt"), "{findings}");
    let raw_ps = spread_ps(&raw);
    let Some(_) = first.1.low_power_range_walk else {
        println!("LMS-Q680i about RIEGL's times: {raw_ps:.1} ps; no walk of riegl_example3 is proven");
        return;
    };
    let model = out.path().join("riegl_example3.json");
    let walk_ps = spread_ps(&corrected(&data, &format!("range_walk = '{}'", model.display())).0);
    println!(
        "single returns of the LMS-Q680i about RIEGL's: {raw_ps:.1} ps, with the walk of an LMS-Q680 \
         learnt from geometry alone {walk_ps:.1} ps (goal 10)"
    );
    // A cubic fitted to RIEGL's own times leaves 9.2 ps; the walk is that of another instrument.
    assert!(walk_ps <= 10.0 && walk_ps <= 0.7 * raw_ps, "{walk_ps} {raw_ps}");
}

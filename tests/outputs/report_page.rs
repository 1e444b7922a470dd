//! `wavex report`: the page of a run.

pub(crate) mod browser;

use browser::Look;
use serde_json::Value;
use wavex_testkit::{Outcome, TestFolder, outcome};

/// Asserts that elements are properly nested; returns their counts.
#[track_caller]
fn elements(page: &str) -> std::collections::BTreeMap<String, usize> {
    let mut open: Vec<&str> = Vec::new();
    let mut count = std::collections::BTreeMap::new();
    let body = page.strip_prefix("<!DOCTYPE html>").unwrap();
    for part in body.split('<').skip(1) {
        let (tag, text) = part.split_once('>').unwrap_or_else(|| panic!("no end: {part}"));
        let inside_style = open.last() == Some(&"style");
        assert!(inside_style || !text.contains('>'), "unescaped: {text}");
        if let Some(name) = tag.strip_prefix('/') {
            assert_eq!(open.pop(), Some(name), "behind {part}");
            continue;
        }
        let name = tag.trim_end_matches('/').split_whitespace().next().unwrap();
        *count.entry(name.to_owned()).or_default() += 1;
        assert_eq!(tag.matches('"').count() % 2, 0, "{tag}");
        if !tag.ends_with('/') && name != "meta" {
            open.push(name);
        }
    }
    assert_eq!(open, Vec::<&str>::new());
    count
}

fn report(place: &TestFolder, arguments: &[&str]) -> Outcome {
    place.wavex(&[&["--quiet", "report"], arguments].concat())
}

const JOB: &str = "[[stage]]\ntype = 'simulate'\nstem = 'a<b&c'\nlines = 8\nshots_per_line = 150\n\
                   ground_amplitude_dn = 180.0\n\
                   [[stage]]\ntype = 'calibrate'\nwaveforms = 600\n[[stage]]\ntype = 'decompose'\n\
                   [[stage]]\ntype = 'georeference'\n[[stage]]\ntype = 'write_las'\npath = '*.las'\n";

/// The job with a page and further keys of `[job]`, which come first in its text.
fn with_page(keys: &str) -> String {
    format!("report_page = 'page.html'\n{keys}\n{JOB}")
}

/// A run with a page, and its report.
fn run() -> (TestFolder, Value) {
    let place = TestFolder::new();
    assert_eq!(place.run(&with_page("")), Outcome::success());
    let report = serde_json::from_str(&place.text("out/job_report.json")).unwrap();
    (place, report)
}

#[test]
fn the_page_is_whole_and_needs_nothing_else() {
    let (place, _) = run();
    assert_eq!(place.outputs(), ["a<b&c.las", "a<b&c_stat.log", "job_report.json", "page.html"]);
    let page = place.text("out/page.html");
    let count = elements(&page);
    assert_eq!(count["image"], 4, "heights, intensities and two densities");
    assert!(count["rect"] >= 5 * 5 && count["polyline"] >= 30 && count["polygon"] == 5, "{count:?}");
    for forbidden in ["<script", "http:", "https:", "url(", "src=", "@import", "<link"] {
        assert!(!page.contains(forbidden), "{forbidden}");
    }
    let links = || page.split("href=\"").skip(1).filter_map(|rest| rest.split(['"', ',']).next());
    assert_eq!(links().filter(|link| *link == "data:image/png;base64").count(), 4);
    let within: Vec<&str> = links().filter_map(|link| link.strip_prefix('#')).collect();
    assert!(within.len() > 8 && links().count() == within.len() + 4, "{within:?}");
    assert!(within.iter().all(|id| page.contains(&format!(" id=\"{id}\""))), "{within:?}");
    assert!(page.contains("content=\"default-src 'none'; style-src 'unsafe-inline'; img-src data:\""));
    assert!(page.contains("prefers-color-scheme:dark") && page.contains("@media print"));
    assert!(page.contains("<h1 class=\"input\" id=\"input-0\">a&lt;b&amp;c</h1>"));
}

#[test]
fn page_has_all_parts_of_a_run() {
    let (place, _) = run();
    let page = place.text("out/page.html");
    let headings = [
        "Job with all keys",
        "Warnings",
        "Points by height",
        "Points by intensity",
        "Swath on the map grid",
        "Waveforms and returns along the flight",
        "Amplitude",
        "Width ratio",
        "Deviation ratio",
        "Range uncertainty",
        "Good: shot",
        "Overlapping: shot",
        "Saturated: shot",
        "Worst fit: shot",
        "Time per stage",
        "System response, low power",
        "Noise, low power",
        "System response, outgoing pulse",
        "Counters",
        "Candidates rejected, by reason",
        "Extent",
        "Returns per pulse",
        "Returns by class",
        "Pulse density",
        "Shots over time",
        "Scan angle",
        "Sensor model, low power",
        "Outputs",
    ];
    for heading in headings {
        assert!(page.contains(&format!(">{heading}")), "{heading}");
    }

    assert!(page.contains("detection_sigma = 4.5"), "all keys with defaults");
}

#[test]
fn warnings_stand_first_with_their_stage() {
    let place = TestFolder::new();
    let fused = "[[stage]]\ntype = 'fuse_channels'\n[[stage]]\ntype = 'calibrate'";
    assert_eq!(place.run(&with_page("").replace("[[stage]]\ntype = 'calibrate'", fused)), Outcome::success());
    let page = place.text("out/page.html");
    let (before, rest) = page.split_once("<h2>Warnings</h2>").unwrap();
    let (_, findings) = rest.split_once("</section>").unwrap();
    let said = "<li><b>fuse_channels</b>: the recording has one receiver: there is nothing to fuse</li>";
    assert!(findings.contains(said), "{findings}");
    assert!(!before.contains("<figure>"));
}

#[test]
fn what_is_normal_is_no_warning() {
    let place = TestFolder::new();
    let two = "lines = 8\nshots_per_line = 100\nhigh_power = true\n[[stage]]\ntype = 'fuse_channels'\n\
               gain_ratio = 0.1\ndelay_ns = 0.0\n[[stage]]\ntype = 'calibrate'\nwaveforms = 300\n\
               [[stage]]\ntype = 'decompose'\n";
    let job = format!("report_page = 'page.html'\n[[stage]]\ntype = 'simulate'\nstem = 'two'\n{two}");
    assert_eq!(place.run(&format!("{job}[[stage]]\ntype = 'write_table'\n")), Outcome::success());
    let page = place.text("out/page.html");
    let (_, rest) = page.split_once("<h2>Warnings</h2>").unwrap();
    let (warnings, found) = rest.split_once("<h2>Findings</h2>").unwrap();
    let found = found.split_once("</section>").unwrap().0;
    let said = "blocks: the low-power receiver recorded it as well</li>";
    assert!(found.contains("<li><b>decompose</b>: set aside ") && found.contains(said), "{found}");
    assert!(!warnings.contains(said), "{warnings}");
}

#[test]
fn the_page_is_made_again_without_the_inputs() {
    let (place, _) = run();
    let page = place.text("out/page.html");
    assert_eq!(report(&place, &["out"]), Outcome::success());
    assert_eq!(place.text("out/job_report.html"), page);
    assert_eq!(report(&place, &["out/job_report.json", "-o", "other.html"]), Outcome::success());
    assert_eq!(place.text("other.html"), page);
}

#[test]
fn a_run_without_a_page_gathers_nothing_and_writes_the_same() {
    let (with, _) = run();
    let without = TestFolder::new();
    assert_eq!(without.run(JOB), Outcome::success());
    assert_eq!(without.outputs(), ["a<b&c.las", "a<b&c_stat.log", "job_report.json"]);
    let las = |place: &TestFolder| std::fs::read(place.path("out/a<b&c.las")).unwrap();
    assert!(las(&with) == las(&without), "the page changes an output");
    let found: Value = serde_json::from_str(&without.text("out/job_report.json")).unwrap();
    assert!(found["inputs"][0].get("overview").is_none());
    assert_eq!(report(&without, &["out"]), Outcome::success());
    let page = without.text("out/job_report.html");
    let count = elements(&page);
    assert_eq!(count["svg"], 5, "times, and responses and noise of two receivers");
    assert!(!page.contains("withheld returns") && page.contains("class=\"badge"));
}

#[test]
fn what_is_gathered_does_not_depend_on_threads() {
    let overview = |threads: &str| {
        let place = TestFolder::new();
        let mut command = place.command(&with_page(""));
        assert_eq!(outcome(command.args(["--threads", threads])), Outcome::success());
        let report: Value = serde_json::from_str(&place.text("out/job_report.json")).unwrap();
        report["inputs"][0]["overview"].clone()
    };
    let one = overview("1");
    assert!(one["waveforms"].as_array().is_some_and(|shots| shots.len() == 4), "{}", one["waveforms"]);
    assert_eq!(one, overview("5"));
}

/// The numbers of the page equal the counters of the run.
#[test]
fn what_is_gathered_adds_up() {
    let (_, report) = run();
    let input = &report["inputs"][0];
    let (overview, totals) = (&input["overview"], &input["totals"]);
    let sum = |packed: &Value| -> u64 {
        packed.as_str().unwrap().split(' ').map(|count| count.parse::<u64>().unwrap()).sum()
    };
    for histogram in overview["histograms"].as_array().unwrap() {
        let beyond = histogram["below"].as_u64().unwrap() + histogram["above"].as_u64().unwrap();
        assert_eq!(sum(&histogram["counts"]) + beyond, totals["np"].as_u64().unwrap(), "{histogram}");
    }
    let lines = &overview["lines"];
    let counted = ["lines", "waveforms", "returns", "points"].map(|what| sum(&lines[what]));
    let wanted = ["nw", "np", "n_georef"].map(|what| totals[what].as_u64().unwrap());
    assert_eq!(counted, [8, wanted[0], wanted[1], wanted[2]]);
    let map = &overview["map"];
    assert_eq!(map["points"].as_u64().unwrap() + map["outside"].as_u64().unwrap(), wanted[2]);
    assert_eq!(map["lines"].as_array().unwrap().len(), 8);
    let returns = totals["np"].as_u64().unwrap();
    let points = &overview["points"];
    assert_eq!(sum(&points["by_return_number"]), returns);
    assert_eq!(points["by_class"]["0"].as_u64(), Some(returns));
    let shots = sum(&points["shots_by_returns"]);
    assert_eq!(
        (shots, sum(&overview["times"]["shots"]), sum(&points["scan_angles"]["counts"])),
        (1200, 1200, 1200)
    );
    let densities = &map["densities"];
    assert_eq!(densities["points"]["count"], map["points"]);
    assert!(densities["pulses"]["count"].as_u64() <= Some(wanted[0]));
    let kinds: Vec<&str> =
        overview["waveforms"].as_array().unwrap().iter().map(|shot| shot["kind"].as_str().unwrap()).collect();
    assert_eq!(kinds, ["good", "overlapping", "saturated", "worst"]);
}

/// Several pulses in the air: shares, the swath by zone, and scatter plots of six candidate zones.
#[test]
fn zones_are_shown_where_several_pulses_are_in_the_air() {
    let job = "report_page = 'page.html'\n[[stage]]\ntype = 'simulate'\nlines = 4\nshots_per_line = 240\n\
               pulse_rate_hz = 400000\nmodulation_ns = 40\nflying_height_m = 1450\n\
               [[stage]]\ntype = 'calibrate'\nwaveforms = 600\nresponse = 'gaussian'\n\
               [[stage]]\ntype = 'decompose'\nmode = 'fastest'\n[[stage]]\ntype = 'georeference'\n\
               [[stage]]\ntype = 'write_table'\npath = 'points.csv'\n";
    let place = TestFolder::new();
    assert_eq!(place.run(job), Outcome::success());
    let run: Value = serde_json::from_str(&place.text("out/job_report.json")).unwrap();
    let overview = &run["inputs"][0]["overview"];
    let shares = overview["zones"]["shares"].as_array().unwrap();
    let returns = |share: &Value| share["returns"].as_u64().unwrap();
    let all: u64 = shares.iter().map(returns).sum();
    assert_eq!(Some(all), run["inputs"][0]["totals"]["np"].as_u64());
    let most = shares.iter().max_by_key(|share| returns(share)).unwrap()["zone"].as_i64().unwrap();
    assert!((3..=4).contains(&most), "{shares:?}");
    let clouds = overview["zones"]["clouds"]["clouds"].as_array().unwrap();
    let zones: Vec<i64> = clouds.iter().map(|cloud| cloud["zone"].as_i64().unwrap()).collect();
    assert_eq!(zones, [0, 1, 2, 3, 4, 5]);
    let rough_m = |cloud: &Value| cloud["roughness_m"].as_f64().unwrap_or(f64::INFINITY);
    let smooth = clouds.iter().min_by(|a, b| rough_m(a).total_cmp(&rough_m(b))).unwrap();
    assert_eq!(smooth["zone"], most, "{clouds:?}");
    let page = place.text("out/page.html");
    elements(&page);
    for part in
        ["Returns by MTA zone", "Points by MTA zone", "Range with each MTA zone", "Multiple time around"]
    {
        assert!(page.contains(part), "{part}");
    }
    assert!(page.contains(&format!("zone {most}: ")));
    // A page made from the report alone is identical.
    assert_eq!(report_of(&place), page);
}

/// The page that `wavex report` makes from a run's report.
fn report_of(place: &TestFolder) -> String {
    assert_eq!(report(place, &["out", "-o", "again.html"]), Outcome::success());
    place.text("again.html")
}

/// The waveforms shown have exactly the returns that the run wrote.
#[test]
fn the_fits_shown_are_those_of_the_run() {
    let place = TestFolder::new();
    let table = "[[stage]]\ntype = 'write_table'\npath = '*.csv'\n";
    assert_eq!(place.run(&(with_page("") + table)), Outcome::success());
    let report: Value = serde_json::from_str(&place.text("out/job_report.json")).unwrap();
    let text = place.text("out/a<b&c.csv");
    let mut rows = text.lines().map(|row| row.split(',').collect::<Vec<&str>>());
    let heads = rows.next().unwrap();
    let column = |name: &str| heads.iter().position(|head| *head == name).unwrap();
    let [shot, range, amplitude] = ["shot", "range_m", "amplitude_dn"].map(column);
    let rows: Vec<Vec<&str>> = rows.collect();
    let shown = report["inputs"][0]["overview"]["waveforms"].as_array().unwrap();
    for waveform in shown {
        let number = waveform["shot"].to_string();
        let value = |row: &Vec<&str>, column: usize| row[column].parse::<f64>().unwrap();
        let wanted = rows.iter().filter(|row| row[shot] == number);
        let wanted: Vec<[f64; 2]> = wanted.map(|row| [value(row, range), value(row, amplitude)]).collect();
        let returns = waveform["returns"].as_array().unwrap().iter();
        let found = returns.map(|found| ["range_m", "amplitude_dn"].map(|key| found[key].as_f64().unwrap()));
        assert_eq!(found.collect::<Vec<[f64; 2]>>(), wanted, "shot {number}");
        assert!(!wanted.is_empty());
    }
    assert_eq!(shown.len(), 4);
}

#[test]
fn a_recording_without_returns_has_a_page_of_its_own() {
    let place = TestFolder::new();
    let job = "report_page = 'page.html'\n[[stage]]\ntype = 'simulate'\nstem = 'raw'\nlines = 3\nshots_per_line = 20\n\
               [[stage]]\ntype = 'write_arrow'\n";
    assert_eq!(place.run(job), Outcome::success());
    let page = place.text("out/page.html");
    elements(&page);
    assert!(page.contains("<h3>Shots over time") && !page.contains("Points by height"));
    assert!(page.contains("None: no warnings and no rejected items"));
}

/// Two recordings of one job, each with its part of the page.
#[test]
fn a_run_with_several_inputs_has_one_page() {
    let place = TestFolder::new();
    for (stem, lines) in [("a<b", 8), ("second", 6)] {
        let simulate = JOB.split_inclusive("ground_amplitude_dn = 180.0\n").next().unwrap();
        let simulate =
            simulate.replace("stem = 'a<b&c'\nlines = 8", &format!("stem = '{stem}'\nlines = {lines}"));
        assert_eq!(place.run(&format!("{simulate}[[stage]]\ntype = 'write_arrow'\n")), Outcome::success());
        let name = format!("{stem}.arrow");
        place.write(&name, &std::fs::read(place.path("out").join(&name)).unwrap());
    }
    let stages = JOB.split_once("ground_amplitude_dn = 180.0\n").unwrap().1;
    let reader = "report_page = 'page.html'\n[[stage]]\ntype = 'read_arrow'\npath = '*.arrow'\n";
    assert_eq!(place.run(&format!("{reader}{stages}")), Outcome::success());

    let page = place.text("out/page.html");
    let count = elements(&page);
    assert_eq!((count["image"], count["h1"]), (8, 3), "{count:?}");
    let of_all = page.split("<h1 class=\"input\"").next().unwrap();
    assert!(of_all.contains("<h3>Sensor model, low power") && of_all.contains("<h3>Noise, outgoing pulse"));
    assert!(page.contains("<title>wavex report: a&lt;b, second</title>"));
    let parts: Vec<&str> = page.split("<h1 class=\"input\"").skip(1).collect();
    let names: Vec<&str> = parts.iter().map(|part| part.split_once("</h1>").unwrap().0).collect();
    assert_eq!(names, [" id=\"input-0\">a&lt;b", " id=\"input-1\">second"]);
    let report: Value = serde_json::from_str(&place.text("out/job_report.json")).unwrap();
    for (part, input) in parts.iter().zip(report["inputs"].as_array().unwrap()) {
        let headings = ["<h3>Points by height<", "<h3>Worst fit: shot ", "<h3>Time per stage", "<h3>Outputs"];
        for heading in headings {
            assert_eq!(part.matches(heading).count(), 1, "{heading}");
        }
        let returns = format!("<td>returns</td><td>{}</td>", input["totals"]["np"]);
        assert!(part.contains(&returns), "{returns}");
    }
    let values = |name: &str| -> Vec<&str> {
        let begin = format!(" {name}=\"");
        let rest = page.split(&begin).skip(1);
        rest.filter_map(|rest| rest.split_once('"').map(|(value, _)| value)).collect()
    };
    let mut ids = values("id");
    ids.sort_unstable();
    assert!(ids.windows(2).all(|pair| pair[0] != pair[1]), "{ids:?}");
    let within: Vec<&str> = values("href").iter().filter_map(|href| href.strip_prefix('#')).collect();
    assert!(["intensities-0", "intensities-1", "input-0", "input-1"].iter().all(|id| within.contains(id)));
    assert!(within.iter().all(|id| ids.contains(id)), "{ids:?}");

    assert_eq!(self::report(&place, &["out"]), Outcome::success());
    assert_eq!(place.text("out/job_report.html"), page);
}

#[test]
fn the_key_asks_for_a_page() {
    let place = TestFolder::new();
    let refused = place.run(&format!("report_page = 'page.pdf'\n{JOB}"));
    assert_eq!(refused.code, Some(2));
    assert!(refused.err.contains("`report_page`: it must end in .html"), "{}", refused.err);
    assert_eq!(place.run(&format!("report_page = true\n{JOB}")), Outcome::success());
    assert!(place.text("out/job_report.html").starts_with("<!DOCTYPE html>"));
}

/// The page in a browser: readable, with all pictures and without console messages.
#[test]
fn a_browser_shows_the_page() {
    let Some(browser) = browser::find() else { return };
    let (place, _) = run();
    let page = place.text("out/page.html");
    for look in [Look::Light, Look::Dark] {
        let (dom, said) = browser::show(&browser, &place.path("out/page.html"), look);
        assert_eq!(said, [] as [&str; 0], "{look:?}: the console");
        assert!(dom.contains("Report of a run"));
        let found = browser::measured(&browser, &page, look);
        for nothing in ["empty", "faint", "small", "overlapping", "cut", "loaded"] {
            assert_eq!(found[nothing], serde_json::json!([]), "{look:?}: {nothing}");
        }
        assert_eq!(found["wide"], false, "{look:?}: the page scrolls horizontally");
        let images = found["images"].as_array().unwrap();
        assert!(images.len() == 4 && images.iter().all(|size| size[0].as_u64() > Some(20)), "{images:?}");
        assert!(found["texts"].as_u64().unwrap() > 200, "{}", found["texts"]);
        let wanted = match look {
            Look::Light => "rgb(255, 255, 255)",
            Look::Dark => "rgb(18, 20, 23)",
        };
        assert_eq!(found["page"], wanted);
    }
}

/// The checks of the previous test detect a faulty page.
#[test]
fn the_browser_notices_what_is_wrong() {
    let Some(browser) = browser::find() else { return };
    let place = TestFolder::new();
    let policy = "<meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'; style-src 'unsafe-inline'\"/>";
    let page = format!(
        "<!DOCTYPE html><html><head>{policy}<title>t</title><style>body{{background:#fff}}p{{color:#aaa}}</style></head>\
         <body><p>faint</p><p style=\"color:#000;font-size:8px\">small</p>\
         <svg aria-label=\"s\" viewBox=\"0 0 100 100\" width=\"100\" height=\"100\"><text x=\"9\" y=\"50\">one</text>\
         <text x=\"12\" y=\"52\">two</text><text x=\"95\" y=\"20\">three</text></svg>\
         <svg width=\"1\" height=\"1\"></svg><img width=\"50\" height=\"50\" src=\"https://example.com/a.png\"></body></html>"
    );
    place.write("bad.html", page.as_bytes());
    let (_, said) = browser::show(&browser, &place.path("bad.html"), Look::Light);
    assert!(said.iter().any(|line| line.contains("https://example.com/a.png")), "{said:?}");
    let found = browser::measured(&browser, &page, Look::Light);
    let counts = ["empty", "faint", "small", "overlapping", "cut", "loaded"]
        .map(|what| found[what].as_array().unwrap().len());
    assert_eq!(counts, [1, 1, 1, 1, 1, 1], "{found}");
    assert_eq!(found["images"], serde_json::json!(["broken"]));
}

#[test]
fn what_is_no_report_is_said() {
    let overview = br#"{"inputs": [{"stem": "s", "overview": {"histograms": 7}}]}"#;
    let place = TestFolder::with(&[("a.json", b"{}"), ("b.json", b"not JSON"), ("c.json", overview)]);
    let refused = |path: &str, problem: &str| {
        let Outcome { code, err, .. } = report(&place, &[path]);
        assert!(code == Some(1) && err.starts_with(&format!("error: {problem}")), "{err}");
    };
    refused("a.json", "a.json: not a report of a run: no `inputs`; give the report of a run");
    refused("b.json", "b.json: not a report of a run: expected");
    refused("c.json", "c.json: the overview of \"s\" is invalid: invalid type: integer `7`");
    refused("gone.json", "gone.json: cannot open: ");
    refused(".", ".: no report of a run in this folder; give the report or the job of a run");
    for name in ["a_report.json", "b_report.json"] {
        place.write(name, b"{}");
    }
    let several = ".: several reports in this folder: a_report.json and b_report.json; give the report or the job of a run";
    refused(".", several);
}

/// A report of an earlier version, without the newer parts of the overview, still makes a page.
#[test]
fn a_report_without_newer_fields_has_a_page() {
    let (place, mut report) = run();
    let overview = report["inputs"][0]["overview"].as_object_mut().unwrap();
    let newer = ["points", "times", "flight"];
    assert!(newer.iter().all(|field| overview.remove(*field).is_some()));
    assert!(overview["map"].as_object_mut().unwrap().remove("densities").is_some());
    place.write("old.json", serde_json::to_string(&report).unwrap().as_bytes());
    assert_eq!(self::report(&place, &["old.json", "-o", "old.html"]), Outcome::success());
    let page = place.text("old.html");
    elements(&page);
    assert!(page.contains("mean pulse density: 0 pulses, 100 needed"));
    assert!(page.contains("<h3>Points by height") && !page.contains("<h3>Extent"));
}

/// Replaces each value that is not a table or a list.
fn replace(value: &mut Value, new: &Value) {
    match value {
        Value::Array(items) => items.iter_mut().for_each(|item| replace(item, new)),
        Value::Object(entries) => entries.values_mut().for_each(|entry| replace(entry, new)),
        Value::Null => {}
        value => *value = new.clone(),
    }
}

#[test]
fn markup_in_any_value_of_a_report_is_shown_as_text() {
    let (place, original) = run();
    let markup = Value::from("<script>x</script>\" onload=\"y\" '><b>");
    // A text instead of a number in the overview is refused.
    let mut hostile = original.clone();
    hostile["inputs"][0]["overview"] = Value::Null;
    let fields: Vec<String> = hostile.as_object().unwrap().keys().cloned().collect();
    for field in fields {
        let mut changed = hostile.clone();
        replace(&mut changed[field.as_str()], &markup);
        place.write("hostile.json", changed.to_string().as_bytes());
        assert_eq!(report(&place, &["hostile.json", "--out", "hostile.html"]), Outcome::success(), "{field}");
        let page = place.text("hostile.html");
        elements(&page);
        assert!(!page.contains("<script") && !page.contains("onload=\""), "{field}");
    }
    // Texts of the overview.
    let mut hostile = original;
    let overview = &mut hostile["inputs"][0]["overview"];
    for path in ["/map/unit", "/histograms/0/quantity", "/histograms/0/unit", "/waveforms/0/returns/0/flags"]
    {
        *overview.pointer_mut(path).unwrap_or_else(|| panic!("{path}")) = markup.clone();
    }
    place.write("hostile.json", hostile.to_string().as_bytes());
    assert_eq!(report(&place, &["hostile.json", "--out", "hostile.html"]), Outcome::success());
    let page = place.text("hostile.html");
    elements(&page);
    assert!(page.contains("&lt;script&gt;") && !page.contains("<script") && !page.contains("onload=\""));
}

#[test]
fn a_small_report_makes_no_huge_page() {
    let (place, original) = run();
    let refused = |report_text: &str| {
        place.write("large.json", report_text.as_bytes());
        let ended = report(&place, &["large.json", "--out", "large.html"]);
        assert_eq!(ended.code, Some(1), "{}", ended.err);
        assert!(!place.path("large.html").exists());
        ended.err
    };
    let inputs = vec!["{}"; 250_000].join(",");
    let problem = refused(&format!("{{\"inputs\":[{inputs}]}}"));
    let expected =
        "error: large.json: its page would be larger than 39 MB; run the job again to make a new report\n";
    assert_eq!(problem, expected);
    // Lists that no run makes so long.
    let with = |path: &str, value: Value| {
        let mut report = original.clone();
        *report["inputs"][0]["overview"].pointer_mut(path).unwrap_or_else(|| panic!("{path}")) = value;
        refused(&report.to_string())
    };
    let overview = &original["inputs"][0]["overview"];
    let many = |path: &str, n: usize| Value::from(vec![overview.pointer(path).unwrap().clone(); n]);
    let numbers = Value::from(vec!["1"; 100_001].join(" "));
    for (path, value, what) in [
        ("/histograms", many("/histograms/0", 65), "`histograms` has 65 entries, more than 64"),
        ("/histograms/0/counts", numbers.clone(), "`counts` has 100001 entries, more than 100000"),
        ("/lines/returns", numbers.clone(), "`lines` has 100001 entries, more than 100000"),
        ("/map/lines", many("/map/lines/0", 1001), "`lines of the map` has 1001 entries, more than 1000"),
        ("/map/lines/0/places", numbers.clone(), "`places` has 100001 entries, more than 100000"),
        ("/waveforms", many("/waveforms/0", 17), "`waveforms` has 17 entries, more than 16"),
        ("/waveforms/0/blocks", many("/waveforms/0/blocks/0", 65), "`blocks` has 65 entries, more than 64"),
        ("/waveforms/0/blocks/0/residual", numbers, "`residual` has 100001 entries, more than 100000"),
    ] {
        let problem = with(path, value);
        let expected = format!(
            "error: large.json: the overview of \"a<b&c\" is invalid: {what}; run the job again to make a new report\n"
        );
        assert_eq!(problem, expected);
    }
}

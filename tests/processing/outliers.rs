//! `filter_outliers` on simulated scenes: detected false returns and wrongly marked true ones.

use wavex::engine::{self, Options};
use wavex::job::Job;
use wavex::registry::STAGES;
use wavex::scan_line::ScanLine;
use wavex_testkit::false_returns::{SCENES, copy, filtered, fly, kept, score_of_stage, without_trajectory};

#[test]
fn false_returns_are_withheld_and_true_ones_kept() {
    for scene in &SCENES {
        let flight = fly(scene, 1);
        let (lines, cx, _) = filtered(flight.lines.iter().map(copy).collect(), "", usize::MAX);
        let score = score_of_stage(&flight, &lines, scene.margin_m);
        println!(
            "{}: {:.2} % of {} detected, {:.3} % of the true returns taken for outliers {:?}",
            scene.name,
            score.detected_percent(),
            score.outliers[0],
            score.lost_percent(None),
            score.true_returns
        );
        assert!(score.outliers[0] > 200 && score.detected_percent() >= 95.0, "{}", scene.name);
        assert!(score.lost_percent(None) <= 0.1, "{}", scene.name);
        assert!(score.lost_percent(Some("roof")) <= 0.1, "{}", scene.name);
        assert!(cx.counters().notes.is_empty());
        // Marked and rejected returns are counted, and no return is lost.
        let total = |of: fn(&ScanLine) -> u64| lines.iter().map(of).sum::<u64>();
        let detected: usize = [score.outliers, score.among].iter().map(|[_, detected]| detected).sum();
        let lost: usize = score.true_returns.values().map(|[_, lost]| lost).sum();
        assert_eq!(
            total(|line| line.stats.np_air + line.stats.np_low),
            (detected + lost) as u64,
            "{}",
            scene.name
        );
        assert_eq!(total(|line| line.stats.np), lines.iter().map(ScanLine::n_returns).sum::<usize>() as u64);
        assert_eq!(total(|line| line.stats.np_filtered()), score.rejected as u64);
        assert!(lines.iter().map(|line| line.line).eq(flight.lines.iter().map(|line| line.line)));

        // Wide spacing, and beams that the attitude moves from line to line.
        if !["sparse", "swinging mirror", "circular"].contains(&scene.name) {
            continue;
        }
        let (alone, cx, _) = filtered(without_trajectory(&flight, scene, 1), "", usize::MAX);
        let score = score_of_stage(&flight, &alone, scene.margin_m);
        let differ = kept(&lines).symmetric_difference(&kept(&alone)).count();
        println!("without a trajectory: {differ} returns differ, {score:?}");
        assert!(score.detected_percent() >= 95.0, "{}", scene.name);
        assert!(score.lost_percent(None) <= 0.1 && score.lost_percent(Some("wire")) < 5.0, "{}", scene.name);
        assert!(differ <= 20, "{differ} in {}", scene.name);
        assert!(cx.counters().notes.is_empty());
    }
}

/// Method `model`: the same scenes, with beams in a map and in the frame of the scanner.
#[test]
fn the_model_finds_false_returns_and_keeps_true_ones() {
    let model = "method = 'model'";
    let (mut outliers, mut detected, mut trues, mut lost) = (0, 0, 0, 0);
    for scene in &SCENES {
        let flight = fly(scene, 1);
        let (lines, cx, seconds) = filtered(flight.lines.iter().map(copy).collect(), model, usize::MAX);
        let score = score_of_stage(&flight, &lines, scene.margin_m);
        let (alone, ..) = filtered(without_trajectory(&flight, scene, 1), model, usize::MAX);
        let of_alone = score_of_stage(&flight, &alone, scene.margin_m);
        println!(
            "{}: {:.2} % of {} detected, {:.4} % lost {:?}; in the scanner's frame {:.2} %, {:.4} %; {seconds:.2} s",
            scene.name,
            score.detected_percent(),
            score.outliers[0],
            score.lost_percent(None),
            score.true_returns,
            of_alone.detected_percent(),
            of_alone.lost_percent(None),
        );
        assert!(score.detected_percent() >= 95.0 && score.lost_percent(None) <= 0.1, "{}", scene.name);
        outliers += score.outliers[0];
        detected += score.outliers[1];
        score.true_returns.values().for_each(|[n, out]| (trues, lost) = (trues + n, lost + out));
        assert!(cx.counters().notes.is_empty());
        let marked: u64 = lines.iter().map(|line| line.stats.np_air + line.stats.np_low).sum();
        let in_lines = lines.iter().flat_map(|line| line.returns().unwrap()).filter(|r| r.withheld).count();
        assert_eq!((marked, score.rejected), (in_lines as u64, 0));
    }
    println!("{detected} of {outliers} detected, {lost} of {trues} lost");
    assert!(detected * 100 >= outliers * 99 && lost * 10_000 <= trues * 2, "{detected} {lost}");
}

/// The side of false returns is identified: those above the highest ground and house are air
/// points.
#[test]
fn low_points_are_low_and_air_points_are_in_the_air() {
    let flight = fly(&SCENES[0], 5);
    let (lines, ..) = filtered(flight.lines.iter().map(copy).collect(), "waves = false", usize::MAX);
    let (mut air, mut low) = (0, 0);
    let height_m = |row: &wavex_testkit::false_returns::True| row.point_m[2];
    let of_ground = flight.truth.iter().flatten().filter(|row| row.class == "ground").map(height_m);
    let (ground_m, roof_m) = (of_ground.fold(f64::INFINITY, f64::min), 20.0);
    for (line, rows) in lines.iter().zip(&flight.truth) {
        let marked = line.returns().unwrap().iter().zip(rows).filter(|(r, _)| r.withheld);
        let heights: Vec<f64> = marked.map(|(_, row)| height_m(row) - ground_m).collect();
        assert_eq!(line.stats.np_low, heights.iter().filter(|height| **height < 0.0).count() as u64);
        assert!(heights.iter().all(|height| *height < 0.0 || *height > 2.0 && *height < 600.0 + roof_m));
        (air, low) = (air + line.stats.np_air, low + line.stats.np_low);
    }
    assert!(air > 200 && low > 20, "{air} {low}");
}

/// The whole chain: false returns as weak as in real recordings, found in waveforms.
#[test]
fn false_returns_of_waveforms_are_withheld() {
    let folder = tempfile::tempdir().unwrap();
    let run = |threads: usize| {
        let text = "[[stage]]\ntype = 'simulate'\nstem = 'flight'\ntruth = '*_truth.csv'\nlines = 40\nshots_per_line = 300\n\
                    pulse_rate_hz = 50000\nscan_angle_deg = [-12.0, 12.0]\nfalse_alarm_rate = 0.03\n\
                    [[stage]]\ntype = 'calibrate'\nwaveforms = 2000\n[[stage]]\ntype = 'decompose'\n\
                    [[stage]]\ntype = 'correct'\n[[stage]]\ntype = 'filter_outliers'\n\
                    [[stage]]\ntype = 'write_lstat'\n[[stage]]\ntype = 'write_table'\npath = '*.csv'\n";
        let job = Job::parse(STAGES, "chain.toml", text, &[]).unwrap_or_else(|errors| panic!("{errors}"));
        let out = folder.path().join(threads.to_string());
        let options = Options { threads, ..Options::of_job(&job, folder.path(), &out) };
        let report = engine::run(&job, &options).unwrap().inputs.remove(0);
        let read = |name: &str| std::fs::read_to_string(out.join(name)).unwrap();
        (report.totals, read("flight.csv"), read("flight_truth.csv"))
    };
    let (totals, table, truth) = run(1);
    assert_eq!((&totals, &table), (&run(3).0, &run(3).1), "for any number of threads");
    assert_eq!(
        totals["n_candidates"] + totals["n_added"],
        totals["np"] + totals["np_filtered"] + totals["np_merged"] + totals["np_xtalk_dropped"]
    );
    assert_eq!(totals["nw"], totals["nw_empty"] + totals["nw_deleted"] + totals["nw_with_points"]);
    let columns = |text: &str, names: &[&str]| -> Vec<Vec<String>> {
        let mut lines = text.lines().map(|line| line.split(',').map(str::to_owned).collect::<Vec<_>>());
        let heads = lines.next().unwrap();
        let at: Vec<usize> =
            names.iter().map(|name| heads.iter().position(|head| head == name).unwrap()).collect();
        lines.map(|row| at.iter().map(|&at| row[at].clone()).collect()).collect()
    };
    let number = |cell: &String| cell.parse::<f64>().unwrap();
    let truth = columns(&truth, &["shot", "range_m", "class", "z"]);
    let found = columns(&table, &["shot", "range_m", "withheld"]);
    let kept = |row: &&Vec<String>| row[2] == "false";
    let is_at = |row: &[String], other: &[String]| {
        row[0] == other[0] && (number(&row[1]) - number(&other[1])).abs() < 0.3
    };
    // Ground is at 400 m; wood and building are up to 20 m higher.
    let is_off = |row: &&Vec<String>| row[2] == "false_alarm" && !(390.0..430.0).contains(&number(&row[3]));
    let off: Vec<&Vec<String>> = truth.iter().filter(is_off).collect();
    let left = off.iter().filter(|row| found.iter().filter(kept).any(|other| is_at(row, other))).count();
    let others: Vec<&Vec<String>> = truth.iter().filter(|row| row[2] != "false_alarm").collect();
    let taken = found.iter().filter(|row| !kept(row));
    let lost = taken.filter(|row| others.iter().any(|other| is_at(row, other))).count();
    println!(
        "{left} of {} false returns are left, {lost} of {} true ones taken for them",
        off.len(),
        others.len()
    );
    assert!(off.len() > 200 && left * 20 <= off.len(), "{left} of {}", off.len());
    assert!(lost * 1000 <= others.len(), "{lost} of {}", others.len());
    assert!(totals["np_low"] > 10 && totals["np_air"] > 100);
}

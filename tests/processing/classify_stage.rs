//! `classify`: ground and noise in blocks of lines.

use std::sync::Arc;

use wavex::registry;
use wavex::scan_line::{Blocks, Content, Emission, Frame, InputInfo, Return, ScanLine};
use wavex::stage::{Context, Output, Plan, RunContext};
use wavex_geodesy::crs::wkt_of_epsg;
use wavex_testkit::engine_stages::stage;

const SHOTS: u32 = 80;
const HEIGHT_M: f64 = 500.0;

/// Line `at` over level ground with 1 m spacing, and a house 8 m high across lines 60 to 80; `other` replaces the height of
/// shots.
fn line(frame: Frame, at: u32, other: impl Fn(u32) -> Option<f64>) -> ScanLine {
    let mut emissions = Vec::new();
    let (mut returns, mut points) = (Vec::new(), Vec::new());
    for shot in 0..SHOTS {
        let across_m = f64::from(shot) - 0.5 * f64::from(SHOTS);
        let range_m = HEIGHT_M.hypot(across_m);
        emissions.push(Emission {
            origin_m: [0.0, f64::from(at), HEIGHT_M],
            direction: [across_m / range_m, 0.0, -HEIGHT_M / range_m],
            ..Emission::default()
        });
        let is_house = (60..80).contains(&at) && (30..50).contains(&shot);
        let height_m = other(shot).unwrap_or(if is_house { 8.0 } else { 0.0 });
        let part = 1.0 - height_m / HEIGHT_M;
        points.push([across_m * part, f64::from(at), height_m]);
        returns.push(Return {
            emission: shot,
            range_m: range_m * part,
            range_sd_m: 0.01,
            ..Return::default()
        });
    }
    let input = Arc::new(InputInfo { frame, ..InputInfo::default() });
    let mut scan_line = ScanLine::of_shots(input, at, emissions, Blocks::default());
    scan_line.content = Content::Points(returns, points);
    scan_line
}

/// Flight with a low point in line 20, a bird of four points at lines 100 and 101, and a withheld return in line 50.
fn flight(frame: Frame) -> Vec<ScanLine> {
    let other = |at: u32, shot: u32| match (at, shot) {
        (20, 40) => Some(-30.0),
        (100 | 101, 20 | 21) => Some(60.0),
        _ => None,
    };
    let mut lines: Vec<ScanLine> = (0..140).map(|at| line(frame, at, |shot| other(at, shot))).collect();
    if let Content::Points(returns, _) = &mut lines[50].content {
        (returns[10].withheld, returns[10].class) = (true, 18);
    }
    lines
}

fn run(keys: &str, lines: Vec<ScanLine>, may_hold_bytes: usize) -> (Vec<ScanLine>, Context) {
    let Plan::Transform(stage) = stage(registry::find("classify").unwrap(), keys).planned.plan else {
        panic!("a transform")
    };
    let mut stage = stage.make(&RunContext::alone("".as_ref())).unwrap();
    let (mut cx, mut emitted) = (Context::default(), Vec::new());
    let mut emit = |scan_line: ScanLine| {
        emitted.push(scan_line);
        Ok(())
    };
    let mut out = Output::new(&mut cx, may_hold_bytes, &mut emit);
    lines.into_iter().for_each(|line| stage.process(line, &mut out).unwrap());
    stage.finish(&mut out).unwrap();
    assert!(emitted.iter().map(|line| line.line).eq(0..emitted.len() as u32));
    (emitted, cx)
}

/// Line and shot of each return of a class.
fn of_class(lines: &[ScanLine], class: u8) -> Vec<(u32, u32)> {
    let of_line = |line: &ScanLine| {
        let returns = line.returns().unwrap().iter().filter(|r| r.class == class);
        returns.map(|r| (line.line, r.emission)).collect::<Vec<_>>()
    };
    lines.iter().flat_map(of_line).collect()
}

#[test]
fn ground_and_noise_are_found_in_blocks() {
    for keys in ["", "block_m = 30\nmargin_m = 40"] {
        let (lines, cx) = run(keys, flight(Frame::Map), usize::MAX);
        assert_eq!(of_class(&lines, 7), [(20, 40)]);
        assert_eq!(of_class(&lines, 18), [(50, 10), (100, 20), (100, 21), (101, 20), (101, 21)]);
        let counts = |at: usize| (lines[at].stats.np_low, lines[at].stats.np_air);
        assert_eq!([counts(20), counts(50), counts(100)], [(1, 0), (0, 0), (0, 2)]);
        let (ground, others) = (of_class(&lines, 2).len(), of_class(&lines, 1).len());
        assert_eq!(ground + others, 140 * 80 - 6);
        assert!((380..=600).contains(&others), "the house has 400 points: {others}");
        assert!(cx.counters().notes.is_empty());
        assert!(lines.iter().flat_map(|line| line.returns().unwrap()).all(|r| r.withheld == (r.class > 6)));
    }
    let (lines, _) = run("ground = false", flight(Frame::Map), usize::MAX);
    assert_eq!((of_class(&lines, 7).len(), of_class(&lines, 2).len()), (1, 0));
}

/// Heights of the returns of a line, rounded to 1 cm.
fn heights_cm(line: &ScanLine) -> Vec<Option<i32>> {
    let height_cm = |r: &Return| Some(r.height_above_ground_m).filter(|height_m| !height_m.is_nan());
    line.returns().unwrap().iter().map(|r| height_cm(r).map(|m| (100.0 * m).round() as i32)).collect()
}

#[test]
fn heights_are_above_the_ground_of_the_block() {
    let (lines, _) = run("height_above_ground = true", flight(Frame::Map), usize::MAX);
    assert!(lines.iter().all(|line| line.input.has_heights_above_ground));
    let house = heights_cm(&lines[70]);
    assert_eq!((house[40], house[31]), (Some(800), Some(800)));
    // Its ground points are the ends of the line.
    assert_eq!([10, 70].map(|shot| house[shot]), [Some(0); 2]);
    assert_eq!((heights_cm(&lines[20])[40], heights_cm(&lines[100])[20]), (Some(-3000), Some(6000)));
    assert_eq!(heights_cm(&lines[50])[10], None, "withheld before");
    let (lines, _) = run("", flight(Frame::Map), usize::MAX);
    assert!(lines.iter().all(|line| !line.input.has_heights_above_ground));
    assert!(heights_cm(&lines[70]).iter().all(Option::is_none));
}

/// The house does not change the height above ground, as it does for the median of last returns.
#[test]
fn the_height_above_ground_of_a_line_is_that_above_ground_points() {
    let narrow = |frame| {
        let mut lines = flight(frame);
        for line in &mut lines {
            line.stats.agl_m = Some(492.0);
        }
        run("", lines, usize::MAX).0
    };
    let lines = narrow(Frame::Map);
    assert!(lines.iter().all(|line| (line.stats.agl_m.unwrap() - 500.0).abs() < 0.01));
    assert!(narrow(Frame::Scanner).iter().all(|line| line.stats.agl_m == Some(492.0)), "without ground");
    let mut lines = flight(Frame::Map);
    let input = Arc::new(InputInfo { frame: Frame::Map, origin_is_sensor: false, ..InputInfo::default() });
    lines.iter_mut().for_each(|line| line.input = Arc::clone(&input));
    let lines = run("", lines, usize::MAX).0;
    assert!(lines.iter().all(|line| line.stats.agl_m.is_none()), "the sensor's position is unknown");
}

#[test]
fn blocks_are_shorter_if_memory_is_short() {
    let of_line = line(Frame::Map, 0, |_| None).bytes();
    let (lines, cx) = run("", flight(Frame::Map), 120 * of_line);
    assert_eq!(lines.len(), 140);
    assert_eq!(of_class(&lines, 7), [(20, 40)]);
    let note = "points are classified in shorter blocks than wanted: longer ones do not fit into memory_mb";
    assert_eq!(cx.counters().notes, [note]);
    assert_eq!(run("", flight(Frame::Map), 1).0.len(), 140);
}

#[test]
fn points_outside_a_map_pass_through() {
    let in_system = |epsg| {
        let input = Arc::new(InputInfo {
            crs_wkt: wkt_of_epsg(epsg),
            ..flight(Frame::Map)[0].input.as_ref().clone()
        });
        let mut lines = flight(Frame::Map);
        lines.iter_mut().for_each(|line| line.input = Arc::clone(&input));
        lines
    };
    for lines in [flight(Frame::Scanner), in_system(4326), in_system(4978)] {
        let (lines, cx) = run("", lines, usize::MAX);
        assert_eq!(of_class(&lines, 0).len(), 140 * 80 - 1);
        let [note] = &cx.counters().notes[..] else { panic!("one warning") };
        assert!(note.contains("in degrees or not in a map"), "{note}");
    }
    let (lines, cx) = run("", in_system(32633), usize::MAX);
    assert_eq!((of_class(&lines, 7), cx.counters().notes.len()), (vec![(20, 40)], 0));
}

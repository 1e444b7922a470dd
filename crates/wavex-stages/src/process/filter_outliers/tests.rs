use std::sync::Arc;

use super::geometry::cross;
use super::*;
use wavex_geodesy::ellipsoid::{Geodetic, WGS84};
use wavex_line::scan_line::{Blocks, Content, Emission, Frame, InputInfo, Return};
use wavex_line::stage::{Context, Item, Reason};

const SHOTS: u32 = 60;
const HEIGHT_M: f64 = 500.0;

fn found(emission: u32, range_m: f64) -> Return {
    Return { emission, range_m, range_sd_m: 0.003, amplitude_dn: 50.0, ..Return::default() }
}

/// Axes (east, north, up) of the frame, and its origin.
struct Lying {
    frame: Frame,
    axes: [[f64; 3]; 3],
    origin_m: [f64; 3],
}

const MAP: Lying = Lying {
    frame: Frame::Map,
    axes: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
    origin_m: [0.0; 3],
};

/// Line `line` over level ground, with 1 m line and shot spacing; `other` replaces the ranges of
/// shots.
fn line(lying: &Lying, line: u32, other: impl Fn(u32) -> Option<Vec<f64>>) -> ScanLine {
    let turned = |v: [f64; 3]| -> [f64; 3] {
        std::array::from_fn(|k| (0..3).map(|axis| lying.axes[axis][k] * v[axis]).sum())
    };
    let mut emissions = Vec::new();
    let mut returns = Vec::new();
    for shot in 0..SHOTS {
        let across_m = f64::from(shot) - 0.5 * f64::from(SHOTS);
        let range_m = HEIGHT_M.hypot(across_m);
        // In its own frame, the scanner is at the origin.
        let place = match lying.frame {
            Frame::Scanner => [0.0; 3],
            _ => turned([0.0, f64::from(line), HEIGHT_M]),
        };
        let origin_m = std::array::from_fn(|k| lying.origin_m[k] + place[k]);
        let direction = turned([across_m / range_m, 0.0, -HEIGHT_M / range_m]);
        emissions.push(Emission {
            shot: u64::from(line * SHOTS + shot),
            origin_m,
            direction,
            ..Emission::default()
        });
        let ranges = other(shot).unwrap_or_else(|| vec![range_m]);
        returns.extend(ranges.into_iter().map(|range_m| found(shot, range_m)));
    }
    let input = Arc::new(InputInfo { frame: lying.frame, ..InputInfo::default() });
    let mut scan_line = ScanLine::of_shots(input, line, emissions, Blocks::default());
    scan_line.stats.nw = u64::from(SHOTS);
    scan_line.stats.nw_with_points =
        (0..SHOTS).filter(|shot| returns.iter().any(|r| r.emission == *shot)).count() as u64;
    scan_line.stats.nw_empty = scan_line.stats.nw - scan_line.stats.nw_with_points;
    (scan_line.stats.np, scan_line.stats.n_candidates) = (returns.len() as u64, returns.len() as u64);
    scan_line.content = Content::Returns(returns);
    scan_line
}

/// A false return 30 m above the ground in line 4, one 20 m below it in line 9, a wire across all
/// lines 20 m above it, and a waveform 100 m above it in line 6.
fn scene(lying: &Lying) -> Vec<ScanLine> {
    let other = |at: u32, shot: u32| match (at, shot) {
        (4, 10) => Some(vec![HEIGHT_M - 30.0, HEIGHT_M.hypot(20.0)]),
        (9, 30) => Some(vec![HEIGHT_M + 20.0]),
        (6, 40) => Some(vec![HEIGHT_M - 100.0]),
        (_, 50) => Some(vec![HEIGHT_M - 20.0]),
        _ => None,
    };
    (0..20).map(|at| line(lying, at, |shot| other(at, shot))).collect()
}

/// Runs the stage; returns its lines, counters and notes.
fn run(keys: &FilterOutliers, lines: Vec<ScanLine>, may_hold_bytes: usize) -> (Vec<ScanLine>, Context) {
    let mut stage = OutlierFilter { strip: OutlierWindow::new(keys.clone()) };
    let (mut cx, mut given_on) = (Context::default(), Vec::new());
    let mut emit = |scan_line: ScanLine| {
        given_on.push(scan_line);
        Ok(())
    };
    let mut out = Output::new(&mut cx, may_hold_bytes, &mut emit);
    lines.into_iter().for_each(|line| stage.process(line, &mut out).unwrap());
    stage.finish(&mut out).unwrap();
    (given_on, cx)
}

/// Line and shot of every marked return.
fn marked(lines: &[ScanLine]) -> Vec<(u32, u32)> {
    let of_line = |scan_line: &ScanLine| {
        let marked = scan_line.returns().unwrap().iter().filter(|r| r.withheld && matches!(r.class, 7 | 18));
        marked.map(|r| (scan_line.line, r.emission)).collect::<Vec<_>>()
    };
    lines.iter().flat_map(of_line).collect()
}

#[test]
fn false_returns_are_marked_and_waveforms_that_jump_rejected() {
    let (lines, cx) = run(&FilterOutliers::default(), scene(&MAP), usize::MAX);
    assert_eq!(lines.iter().map(|scan_line| scan_line.line).collect::<Vec<_>>(), (0..20).collect::<Vec<_>>());
    assert_eq!(marked(&lines), [(4, 10), (9, 30)], "the wire is not marked");
    let sides = |at: usize| (lines[at].stats.np_air, lines[at].stats.np_low);
    assert_eq!([sides(4), sides(6), sides(9), sides(12)], [(1, 0), (1, 0), (0, 1), (0, 0)]);
    let rejected = &lines[6].stats;
    assert_eq!((rejected.nw_deleted, rejected.np, rejected.np_filtered()), (1, u64::from(SHOTS) - 1, 1));
    assert_eq!(lines[6].n_returns() as u64, rejected.np);
    assert!(lines.iter().all(|scan_line| scan_line.stats.laws_hold()));
    let rejected: Vec<_> = cx.counters().rejected.iter().collect();
    assert_eq!(rejected, [(&(Item::Returns, Reason::DeviatingWaveform), &1)]);
    assert!(cx.counters().notes.is_empty());
}

#[test]
fn waveforms_or_points_may_be_left_alone() {
    let without_waves = FilterOutliers { waves: false, ..FilterOutliers::default() };
    let (lines, _) = run(&without_waves, scene(&MAP), usize::MAX);
    assert_eq!(marked(&lines), [(4, 10), (6, 40), (9, 30)]);
    assert_eq!(lines[6].stats.nw_deleted, 0);
    let without_points = FilterOutliers { points: false, ..FilterOutliers::default() };
    let (lines, _) = run(&without_points, scene(&MAP), usize::MAX);
    assert_eq!(marked(&lines), []);
    assert_eq!((lines[6].stats.nw_deleted, lines[6].stats.np_air, lines[4].stats.np_air), (1, 1, 0));
}

#[test]
fn the_earth_s_frame_is_judged_as_a_map_is() {
    let (latitude_rad, longitude_rad) = (0.83f64, 0.27f64);
    let place = Geodetic { latitude_rad, longitude_rad, height_m: 200.0 };
    let ((sin_b, cos_b), (sin_l, cos_l)) = (latitude_rad.sin_cos(), longitude_rad.sin_cos());
    let earth = Lying {
        frame: Frame::Earth,
        axes: [
            [-sin_l, cos_l, 0.0],
            [-sin_b * cos_l, -sin_b * sin_l, cos_b],
            [cos_b * cos_l, cos_b * sin_l, sin_b],
        ],
        origin_m: WGS84.ecef_of(place),
    };
    let (lines, _) = run(&FilterOutliers::default(), scene(&earth), usize::MAX);
    assert_eq!(marked(&lines), [(4, 10), (9, 30)]);
    assert_eq!((lines[6].stats.nw_deleted, lines[9].stats.np_low), (1, 1));
}

#[test]
fn without_a_trajectory_the_same_returns_are_marked() {
    for (along, down) in [([1.0, 0.0, 0.0], [0.0, 0.0, 1.0]), ([0.0, -1.0, 0.0], [-1.0, 0.0, 0.0])] {
        let scanner = Lying {
            frame: Frame::Scanner,
            axes: [cross(down, along), along, down.map(|part: f64| -part)],
            origin_m: [0.0; 3],
        };
        let (lines, cx) = run(&FilterOutliers::default(), scene(&scanner), usize::MAX);
        assert_eq!(marked(&lines), [(4, 10), (9, 30)], "the wire is not marked");
        assert_eq!((lines[6].stats.nw_deleted, lines[9].stats.np_low), (1, 1));
        assert!(cx.counters().notes.is_empty());
        assert_eq!(
            cx.counters().findings,
            ["without a trajectory, outliers are detected as if the sensor moved straight on by half a \
                 shot spacing per line"]
        );
    }
}

/// False returns at one place of the scanner's frame, in every sixth line, are 3 m apart.
#[test]
fn without_a_trajectory_lines_are_apart() {
    let scanner = Lying { frame: Frame::Scanner, ..MAP };
    let is_false = |at: u32, shot: u32| at % 6 == 3 && shot == 20;
    let other = |at: u32| move |shot: u32| is_false(at, shot).then(|| vec![HEIGHT_M - 30.0]);
    let lines = (0..40).map(|at| line(&scanner, at, other(at))).collect();
    let keys = FilterOutliers { max_range_m: 1.0, ..FilterOutliers::default() };
    let (lines, _) = run(&keys, lines, usize::MAX);
    assert_eq!(marked(&lines), [3, 9, 15, 21, 27, 33, 39].map(|at| (at, 20)));
}

#[test]
fn the_first_and_the_last_lines_are_judged_as_the_others_are() {
    let keys = FilterOutliers::default();
    for at in [0, 19] {
        let with_false = |k: u32| line(&MAP, k, |shot| ((k, shot) == (at, 7)).then(|| vec![HEIGHT_M - 30.0]));
        let (lines, _) = run(&keys, (0..20).map(with_false).collect(), usize::MAX);
        assert_eq!(marked(&lines), [(at, 7)]);
    }
    let empty = || {
        ScanLine::of_shots(
            Arc::new(InputInfo { frame: Frame::Map, ..InputInfo::default() }),
            0,
            Vec::new(),
            Blocks::default(),
        )
    };
    let no_returns = || ScanLine { content: Content::Returns(Vec::new()), ..empty() };
    let (lines, _) = run(&keys, (0..40).map(|_| no_returns()).collect(), usize::MAX);
    assert_eq!(lines.len(), 40);
}

#[test]
fn what_memory_holds_is_held_and_what_it_does_not_is_said() {
    let of_line = line(&MAP, 0, |_| None).bytes();
    let keys = FilterOutliers { waves: false, ..FilterOutliers::default() };
    let (lines, cx) = run(&keys, scene(&MAP), 12 * of_line);
    assert_eq!(
        cx.counters().notes,
        ["outliers are detected with fewer neighbouring lines than wanted: more do not fit into memory_mb"]
    );
    assert_eq!(lines.iter().map(|scan_line| scan_line.line).collect::<Vec<_>>(), (0..20).collect::<Vec<_>>());
    let marked = marked(&lines);
    assert!([(4, 10), (6, 40), (9, 30)].iter().all(|at| marked.contains(at)), "{marked:?}");
}

/// Changes a key.
type Change = fn(&mut FilterOutliers);

#[test]
fn keys_that_cannot_be_used_say_why() {
    let of = |change: Change| {
        let mut keys = FilterOutliers::default();
        change(&mut keys);
        keys.check().map_err(|error| (error.key, error.problem))
    };
    let cases: [(Change, &str, &str); 1] = [(
        |keys| (keys.waves, keys.points) = (false, false),
        "points",
        "with `waves = false` it must be `true`; otherwise the stage does nothing",
    )];
    for (change, key, problem) in cases {
        assert_eq!(of(change), Err((key, problem.to_owned())));
    }
    assert_eq!(of(|_| {}), Ok(()));
}

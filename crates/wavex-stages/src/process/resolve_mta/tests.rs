use super::*;
use wavex_line::scan_line::{Blocks, Channel, Emission, Frame, InputInfo, OnlineReturn};
use wavex_line::stage::{Context, Item};

/// Mean time between pulses, ps.
const INTERVAL_PS: i64 = 2_500_000;

fn input() -> Arc<InputInfo> {
    Arc::new(InputInfo { frame: Frame::Map, ..InputInfo::default() })
}

/// Shots at constant intervals, numbered from `first`.
fn shots(first: u64, count: u64) -> Vec<Emission> {
    let shot = |shot: u64| Emission { shot, clock_ps: shot as i64 * INTERVAL_PS, ..Emission::default() };
    (first..first + count).map(shot).collect()
}

const PULSE: [u16; 9] = [2, 2, 2, 12, 40, 12, 2, 2, 2];

/// Runs the stage on these lines; returns its result, lines and counters.
fn run(
    config: &ResolveMta,
    lines: Vec<ScanLine>,
    may_hold_bytes: usize,
) -> (Result<()>, Vec<ScanLine>, Context) {
    let terrain = config.terrain.as_ref().map(|path| Terrain::open(path).unwrap());
    let mut stage = MtaResolver { config: config.clone(), terrain, placed: Arc::default(), strip: None };
    let (mut cx, mut given) = (Context::default(), Vec::new());
    let mut emit = |scan_line: ScanLine| {
        given.push(scan_line);
        Ok(())
    };
    let mut out = Output::new(&mut cx, may_hold_bytes, &mut emit);
    let outcome = lines
        .into_iter()
        .try_for_each(|line| stage.process(line, &mut out))
        .and_then(|()| stage.finish(&mut out));
    (outcome, given, cx)
}

fn fixed(zone: u16) -> ResolveMta {
    ResolveMta { zone: ZoneKey::Fixed(zone), ..ResolveMta::default() }
}

/// Shot, channel, zone and start of each block.
fn blocks_of(scan_line: &ScanLine) -> Vec<(u64, Channel, Option<i16>, f64)> {
    let shot = |block: &wavex_line::scan_line::Block| scan_line.emissions[block.emission as usize].shot;
    scan_line
        .blocks()
        .unwrap()
        .iter()
        .map(|block| (shot(block), block.channel, block.zone, block.start_ns))
        .collect()
}

#[test]
fn blocks_go_to_the_shot_before_even_in_the_line_before() {
    let mut first = Blocks::default();
    (0..3).for_each(|shot| first.push(shot, Channel::Reference, None, -4.0, 1.0, &[2, 90, 2]));
    let mut second = Blocks::default();
    second.push(0, Channel::LowPower, None, 700.0, 1.0, &PULSE);
    second.push(1, Channel::LowPower, None, 800.0, 1.0, &PULSE);
    second.push(2, Channel::LowPower, None, 900.0, 1.0, &PULSE);
    second.push(2, Channel::LowPower, None, 300.0, 1.0, &PULSE);
    second.online = vec![OnlineReturn { emission: 2, time_ns: 904.0, amplitude: 3.0 }];
    let lines = vec![
        ScanLine::of_shots(input(), 0, shots(0, 3), first),
        ScanLine::of_shots(input(), 1, shots(3, 3), second),
    ];
    let (outcome, given, cx) = run(&fixed(2), lines, usize::MAX);
    outcome.unwrap();
    let low = Channel::LowPower;
    let reference = |shot| (shot, Channel::Reference, None, -4.0);
    assert_eq!(
        blocks_of(&given[0]),
        [reference(0), reference(1), (1, low, None, 5700.0), reference(2), (2, low, None, 5800.0)]
    );
    assert_eq!(blocks_of(&given[1]), [(3, low, None, 5300.0), (3, low, None, 5900.0)]);
    assert_eq!(given.iter().map(|line| line.stats.nw).collect::<Vec<_>>(), [2, 1]);
    let zones = |line: &ScanLine| line.emissions.iter().map(|shot| shot.mta_zone).collect::<Vec<_>>();
    assert_eq!(zones(&given[0]), [Some(0), Some(2), Some(2)]);
    assert_eq!(zones(&given[1]), [Some(2), Some(0), Some(0)]);
    let online = &given[1].blocks().unwrap().online;
    assert_eq!(online.iter().map(|one| (one.emission, one.time_ns)).collect::<Vec<_>>(), [(0, 5904.0)]);
    assert_eq!(cx.counters().rejected_of(Item::Blocks), 0);
}

#[test]
fn a_zone_counts_to_the_begin_of_the_block() {
    // An emission between the first sample of the block and its peak.
    let mut blocks = Blocks::default();
    blocks.push(1, Channel::LowPower, None, 2497.0, 1.0, &PULSE);
    let lines = vec![ScanLine::of_shots(input(), 0, shots(0, 3), blocks)];
    let (outcome, given, _) = run(&fixed(1), lines, usize::MAX);
    outcome.unwrap();
    assert_eq!(blocks_of(&given[0]), [(1, Channel::LowPower, None, 2497.0)]);
    assert_eq!(given[0].emissions[1].mta_zone, Some(0));
}

#[test]
fn what_has_no_cause_is_rejected() {
    let mut blocks = Blocks::default();
    blocks.push(0, Channel::LowPower, None, 700.0, 1.0, &PULSE);
    blocks.push(0, Channel::LowPower, None, 3e9, 1.0, &PULSE);
    blocks.online = vec![OnlineReturn { emission: 0, time_ns: 900.0, amplitude: 3.0 }];
    let (outcome, given, cx) =
        run(&fixed(4), vec![ScanLine::of_shots(input(), 0, shots(0, 3), blocks)], usize::MAX);
    outcome.unwrap();
    assert_eq!((given[0].blocks().unwrap().len(), given[0].stats.nw), (0, 0));
    let rejected: Vec<_> =
        cx.counters().rejected.iter().map(|((_, reason), n)| (reason.text(), *n)).collect();
    assert_eq!(
        rejected,
        [("a block a second or more from its shot", 1), ("no emission at a distance within `range_m`", 1)]
    );
    assert_eq!(cx.counters().notes[0], "online returns without an assigned shot are skipped");
}

#[test]
fn a_block_whose_zone_is_known_stays() {
    let mut blocks = Blocks::default();
    blocks.push(1, Channel::LowPower, Some(3), 9000.0, 1.0, &PULSE);
    blocks.push(2, Channel::LowPower, None, 700.0, 1.0, &PULSE);
    let lines = vec![ScanLine::of_shots(input(), 0, shots(0, 3), blocks)];
    let (outcome, given, _) = run(&fixed(1), lines, usize::MAX);
    outcome.unwrap();
    let low = Channel::LowPower;
    assert_eq!(
        blocks_of(&given[0]),
        [(1, low, Some(3), 9000.0), (1, low, None, 3200.0)]
            .map(|mut block| {
                // The earlier block's zone is the shot's.
                block.2 = if block.3 == 3200.0 { None } else { block.2 };
                block
            })
            .into_iter()
            .rev()
            .collect::<Vec<_>>()
    );
}

#[test]
fn what_is_held_back_is_foreseen_with_the_terrain_model() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("dtm.asc");
    // 100 000 heights of 4 bytes.
    let rows = format!("{}\n", "5 ".repeat(500)).repeat(200);
    let head = "ncols 500\nnrows 200\nxllcorner 0\nyllcorner 0\ncellsize 10\n";
    std::fs::write(&path, format!("{head}{rows}")).unwrap();
    let config = ResolveMta { terrain: Some(path), ..ResolveMta::default() };
    let line = |number: u32| {
        let mut blocks = Blocks::default();
        (0..50).for_each(|shot| blocks.push(shot, Channel::LowPower, None, 700.0, 1.0, &PULSE));
        ScanLine::of_shots(input(), number, shots(u64::from(number) * 50, 50), blocks)
    };
    let mut stage = MtaResolver {
        terrain: Some(Terrain::open(config.terrain.as_deref().unwrap()).unwrap()),
        config,
        placed: Arc::default(),
        strip: None,
    };
    let mut foreseen = Vec::new();
    for number in 0..200 {
        let (mut cx, mut emit) = (Context::default(), |_| Ok(()));
        let mut out = Output::new(&mut cx, 0, &mut emit);
        stage.process(line(number), &mut out).unwrap();
        let held_bytes = stage.strip.as_ref().unwrap().held_bytes;
        assert!(held_bytes + 400_000 <= out.foreseen_bytes(), "{held_bytes} after line {number}");
        foreseen.push(out.foreseen_bytes());
    }
    let [least, most] = [foreseen.iter().min(), foreseen.iter().max()].map(|bytes| *bytes.unwrap() as f64);
    assert!(most < 1.01 * least, "the estimate is stable from the first line: {least} to {most}");
}

#[test]
fn lines_without_shots_keep_their_place() {
    let line = |number: u32, count: u64| {
        let mut blocks = Blocks::default();
        if count > 0 {
            blocks.push(0, Channel::LowPower, None, 700.0, 1.0, &PULSE);
        }
        ScanLine::of_shots(input(), number, shots(u64::from(number) * 50, count), blocks)
    };
    let lines = vec![line(0, 0), line(1, 5), line(2, 0), line(3, 5), line(4, 0)];
    let (outcome, given, _) = run(&fixed(0), lines, usize::MAX);
    outcome.unwrap();
    assert_eq!(given.iter().map(|line| line.line).collect::<Vec<_>>(), [0, 1, 2, 3, 4]);
}

#[test]
fn the_departure_from_a_single_height_is_spelled_out() {
    let departure = |keys: &str| {
        let mut config: ResolveMta = toml::from_str(keys).unwrap();
        config.spell_out();
        config.agl_sd_m
    };
    assert_eq!(
        ["agl_m = 900", "agl_m = 900\nagl_sd_m = 9", "agl_m = [800, 900]", ""].map(departure),
        [Some(100.0), Some(9.0), None, None]
    );
}

#[test]
fn keys_that_contradict_one_another_are_refused() {
    let problem = |keys: &str| {
        let config: ResolveMta = toml::from_str(keys).unwrap();
        config.check().err().map(|error| format!("{}: {}", error.key, error.problem)).unwrap_or_default()
    };
    for (keys, expected) in [
        ("", ""),
        ("zone = 'auto'\nagl_m = [900, 1100]\nmethod = 'variance'", ""),
        ("range_m = [50, 20]", "range_m: it must be two ascending distances"),
        ("agl_m = [9, 8]", "agl_m: it must be a height, or two ascending ones"),
        (
            "agl_m = [900, 1000]\nagl_sd_m = 9",
            "agl_sd_m: it needs a single `agl_m`: two heights already define the spread of the terrain",
        ),
        ("agl_m = 9\nterrain = 'a.tif'", "agl_m: `terrain` is the more detailed prior: remove one of them"),
        ("zone = 1\nagl_m = 9", "zone: a fixed zone needs no prior: remove `agl_m` and `terrain`"),
    ] {
        assert_eq!(problem(keys), expected, "{keys}");
    }
}

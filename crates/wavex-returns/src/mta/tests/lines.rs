//! Look-ahead, order and errors.

use super::*;

#[test]
fn what_is_held_back_is_bounded_and_popping_early_changes_nothing() {
    let (mut lines, _) = strip(400, 30, 17.0, |line, shot| 1010.0 + 0.5 * (line + shot) as f64);
    lines[300].echoes.clear();
    lines[301] = Line::default();
    for method in [Method::Blocks, Method::Variance { buffer: 50 }, Method::Fixed(2)] {
        let (late, _) = resolve(&settings(method), &lines);
        let mut resolver = Resolver::new(&settings(method)).unwrap();
        let mut early = Vec::new();
        for (pushed, line) in lines.iter().enumerate() {
            resolver.push(line).unwrap();
            early.extend(std::iter::from_fn(|| resolver.pop()));
            assert!(pushed + 1 - early.len() <= resolver.look_ahead_lines());
        }
        resolver.finish().unwrap();
        early.extend(std::iter::from_fn(|| resolver.pop()));
        assert_eq!(format!("{late:?}"), format!("{early:?}"));
        assert!(early.iter().enumerate().all(|(number, line)| line.line == number as u64));
        assert!(early.windows(2).all(|pair| pair[0].settled_lines <= pair[1].settled_lines));
        assert_eq!(early.last().map(|line| line.settled_lines), Some(400));
    }
}

#[test]
fn lines_that_take_much_are_decided_sooner_and_as_well() {
    let (mut lines, causes) = strip(80, 200, 17.0, slope);
    let (full, _) = resolve(&settings(Method::Blocks), &lines);
    for (share, most) in [(20, 24), (7, 16), (1, 16)] {
        lines.iter_mut().for_each(|line| line.bytes = LOOK_AHEAD_BYTES / share);
        let mut resolver = Resolver::new(&settings(Method::Blocks)).unwrap();
        let (mut resolved, mut held) = (Vec::new(), 0);
        for (pushed, line) in (1..).zip(&lines) {
            resolver.push(line).unwrap();
            held = held.max(pushed - resolved.len());
            resolved.extend(std::iter::from_fn(|| resolver.pop()));
        }
        resolver.finish().unwrap();
        resolved.extend(std::iter::from_fn(|| resolver.pop()));
        assert_eq!(held, most, "a {share}th of the bytes");
        let found = |of: &[Resolved]| -> Vec<_> {
            of.iter().flat_map(|line| &line.echoes).map(|echo| (echo.cause, echo.zone)).collect()
        };
        assert_eq!(found(&resolved), found(&full));
    }
    let wrong = full.iter().zip(&causes).flat_map(|(line, causes)| line.echoes.iter().zip(causes));
    assert_eq!(
        wrong.filter(|(echo, cause)| echo.cause.map(|cause| cause.emission) != Some(**cause)).count(),
        0
    );
}

#[test]
fn an_echo_takes_no_more_than_it_is_said_to() {
    let found = size_of::<(Option<usize>, f32)>() + size_of::<Assigned>();
    assert!(size_of::<held::HeldEcho>() + found <= BYTES_PER_ECHO);
}

#[test]
fn the_order_of_echoes_within_a_line_is_that_of_the_caller() {
    let (lines, _) = strip(16, 120, 17.0, slope);
    let turned: Vec<Line> = lines
        .iter()
        .map(|line| Line {
            emissions: line.emissions.clone(),
            echoes: line.echoes.iter().rev().copied().collect(),
            ..Line::default()
        })
        .collect();
    let (straight, _) = resolve(&settings(Method::Blocks), &lines);
    let (reversed, _) = resolve(&settings(Method::Blocks), &turned);
    for (a, b) in straight.iter().zip(&reversed) {
        assert!(a.echoes.iter().eq(b.echoes.iter().rev()));
    }
}

#[test]
fn echoes_of_the_line_before_are_found_there_and_say_when_it_is_settled() {
    // Lines without a pause: echoes of each line's last shots are received in the next line.
    let shots = 100;
    let (lines, _) = strip(1, 30 * shots, 17.0, |_, shot| 1010.0 + 0.3 * (shot % shots) as f64);
    let lines = sweeps::cut(&lines[0], shots);
    let (resolved, _) = resolve(&settings(Method::Blocks), &lines);
    let first = resolved[5].echoes[0].cause.unwrap();
    assert_eq!((first.line, first.emission), (4, 98));
    for line in &resolved[..29] {
        // Later lines may have echoes from the last shots of this line.
        assert_eq!(line.settled_lines, line.line);
        for echo in &line.echoes {
            let cause = echo.cause.unwrap();
            let expected_ns = (1010.0 + 0.3 * f64::from(cause.emission)) / METRES_PER_NS;
            assert!((echo.flight_ns - expected_ns).abs() < 0.01, "{cause:?}");
        }
    }
}

#[test]
fn scan_angles_bring_lines_of_both_directions_together() {
    let (mut lines, causes) = strip(24, 200, 9.0, |line, shot| {
        let column = if line % 2 == 0 { shot } else { 199 - shot };
        1010.0 + 0.8 * column as f64
    });
    for (number, line) in lines.iter_mut().enumerate() {
        for (shot, emission) in line.emissions.iter_mut().enumerate() {
            let column = if number % 2 == 0 { shot } else { 199 - shot };
            emission.scan_angle_deg = -10.0 + 0.1 * column as f32;
        }
    }
    for method in [Method::Blocks, Method::Variance { buffer: 50 }] {
        assert_eq!(wrong(&resolve(&settings(method), &lines).0, &causes), 0, "{method:?}");
    }
}

#[test]
fn lines_of_one_shot_and_clocks_that_jump_are_taken_as_they_are() {
    let (lines, causes) = strip(1, 600, 17.0, |_, _| 300.0);
    let single = sweeps::cut(&lines[0], 1);
    let (resolved, _) = resolve(&settings(Method::Blocks), &single);
    let found: Vec<u32> = resolved
        .iter()
        .flat_map(|line| {
            line.echoes.iter().map(|echo| echo.cause.map_or(u32::MAX, |cause| cause.line as u32))
        })
        .collect();
    assert_eq!(found, causes[0]);

    let (mut lines, causes) = strip(32, 100, 17.0, |_, _| 1010.0);
    let shifts = [0, -5_000_000_000_000, i64::MAX / 2, i64::MIN / 2];
    for (number, line) in lines.iter_mut().enumerate() {
        line.emissions.iter_mut().for_each(|emission| emission.clock_ps += shifts[number / 8]);
    }
    let (resolved, _) = resolve(&settings(Method::Blocks), &lines);
    assert_eq!(wrong(&resolved, &causes), 0);
}

#[test]
fn nothing_and_next_to_nothing_are_taken_without_complaint() {
    for method in [Method::Blocks, Method::Variance { buffer: 50 }, Method::Fixed(1)] {
        let (resolved, _) = resolve(&settings(method), &[]);
        assert_eq!(resolved, []);
        let one = Line {
            emissions: vec![Emission { clock_ps: i64::MAX, ..Emission::default() }],
            echoes: vec![Echo { emission: 0, time_ns: -3.0 }, Echo { emission: 0, time_ns: 900.0 }],
            ..Line::default()
        };
        let early = Line {
            emissions: vec![Emission { clock_ps: i64::MIN, ..Emission::default() }],
            ..Line::default()
        };
        let (resolved, _) = resolve(&settings(method), &[Line::default(), early, one]);
        assert_eq!(resolved.iter().map(|line| line.echoes.len()).collect::<Vec<_>>(), [0, 0, 2]);
        assert_eq!(resolved[2].echoes[0].cause, None, "{method:?}");
    }
}

#[test]
fn each_error_says_where_and_what() {
    let line = |clocks: &[i64], echo: Echo| Line {
        emissions: (7u64..)
            .zip(clocks)
            .map(|(shot, &clock_ps)| Emission { clock_ps, shot, ..Emission::default() })
            .collect(),
        echoes: vec![echo],
        ..Line::default()
    };
    let said = |line: &Line| {
        let mut resolver = Resolver::new(&Settings::default()).unwrap();
        resolver.push(&Line::default()).unwrap();
        resolver.push(line).unwrap_err().to_string()
    };
    assert_eq!(
        said(&line(&[1, 2], Echo { emission: 2, time_ns: 1.0 })),
        "line 1: echo 0 refers to emission 2, but the line has 2 emissions"
    );
    assert_eq!(
        said(&line(&[1, 2], Echo { emission: 1, time_ns: f64::NAN })),
        "line 1: echo 0 has an invalid time: NaN ns after its emission"
    );
    assert_eq!(
        said(&line(&[2, 2], Echo { emission: 1, time_ns: 1.0 })),
        "line 1: the clock does not increase at shot 8: 2 ps after 2 ps; start a new line there"
    );
}

#[test]
fn settings_that_contradict_themselves_are_refused() {
    let said = |change: fn(&mut Settings)| {
        let mut settings = Settings::default();
        change(&mut settings);
        Resolver::new(&settings).unwrap_err().to_string()
    };
    assert_eq!(said(|s| s.range_m = [5.0, 5.0]), "range_m: must be two ascending distances of at least 0 m");
    assert_eq!(said(|s| s.group_velocity_mps = 0.0), "group_velocity_mps: must be between 1e8 and 3e8 m/s");
    assert_eq!(said(|s| s.blind_gap_ns = -1.0), "blind_gap_ns: must be at least 0 ns");
    assert_eq!(said(|s| s.method = Method::Variance { buffer: 3 }), "buffer: must be 4 to 10000 ranges");
    assert_eq!(
        said(|s| s.prior = Prior::Agl { agl_m: 0.0, sd_m: 1.0 }),
        "prior: height and standard deviation must be above 0 m"
    );
    assert_eq!(
        said(|s| s.prior = Prior::PerEmission { sd_m: f64::NAN }),
        "prior: standard deviation must be above 0 m"
    );
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(12))]

    #[test]
    fn shifting_all_clocks_changes_nothing(shift_ps in -1_000_000_000_000_000i64..1_000_000_000_000_000) {
        let (mut lines, _) = strip(20, 60, 9.0, |line, shot| 1100.0 + 2.0 * shot as f64 + 3.0 * random((line * 60 + shot) as u64));
        for method in [Method::Blocks, Method::Variance { buffer: 50 }] {
            let (before, _) = resolve(&settings(method), &lines);
            lines.iter_mut().flat_map(|line| &mut line.emissions).for_each(|emission| emission.clock_ps += shift_ps);
            let (after, _) = resolve(&settings(method), &lines);
            prop_assert_eq!(before, after);
        }
    }

    #[test]
    fn no_line_makes_it_panic(
        lines in prop::collection::vec(
            (
                prop::collection::btree_set(any::<i64>(), 0..20),
                prop::collection::vec((0u32..20, -1e9f64..1e9), 0..20),
                -400f32..400.0,
            ),
            0..40,
        ),
        variance in any::<bool>(),
    ) {
        let prior = Prior::PerEmission { sd_m: 20.0 };
        let method = if variance { Method::Variance { buffer: 50 } } else { Method::Blocks };
        let mut resolver = Resolver::new(&Settings { prior, ..settings(method) }).unwrap();
        let mut echoes = 0;
        for (clocks, found, angle) in lines {
            let emissions: Vec<Emission> = (0u16..)
                .zip(clocks)
                .map(|(shot, clock_ps)| Emission {
                    clock_ps,
                    shot: u64::from(shot),
                    scan_angle_deg: angle + angle * f32::from(shot % 7),
                    prior_range_m: angle * 10.0,
                    ..Emission::default()
                })
                .collect();
            let count = emissions.len() as u32;
            let found = found.into_iter().filter(|echo| echo.0 < count);
            let echoes_of_line = found.map(|(emission, time_ns)| Echo { emission, time_ns }).collect();
            let line = Line { emissions, echoes: echoes_of_line, bytes: 0 };
            echoes += line.echoes.len();
            resolver.push(&line).unwrap();
        }
        resolver.finish().unwrap();
        let resolved: usize = std::iter::from_fn(|| resolver.pop()).map(|line| line.echoes.len()).sum();
        prop_assert_eq!(resolved, echoes);
    }
}

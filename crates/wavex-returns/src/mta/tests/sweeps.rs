//! Consecutive lines without a pause, and partial lines.

use super::*;

/// Cuts a line into lines of `shots` shots.
pub fn cut(line: &Line, shots: usize) -> Vec<Line> {
    let piece = |(number, emissions): (usize, &[Emission])| {
        let first = (number * shots) as u32;
        let within = |echo: &&Echo| (first..first + shots as u32).contains(&echo.emission);
        let moved = |echo: &Echo| Echo { emission: echo.emission - first, ..*echo };
        let echoes = line.echoes.iter().filter(within).map(moved).collect();
        Line { emissions: emissions.to_vec(), echoes, ..Line::default() }
    };
    line.emissions.chunks(shots).enumerate().map(piece).collect()
}

/// Number of echoes of a cut line with a wrong cause.
fn wrong_of(resolved: &[Resolved], shots: usize, causes: &[u32]) -> usize {
    let found = resolved
        .iter()
        .flat_map(|line| &line.echoes)
        .map(|echo| echo.cause.map(|cause| (cause.line * shots as u64) as u32 + cause.emission));
    let found: Vec<Option<u32>> = found.collect();
    assert_eq!(found.len(), causes.len());
    found.iter().zip(causes).filter(|(found, cause)| **found != Some(**cause)).count()
}

/// Echoes from the end of a line do not affect the start of the next.
///
/// One edge of the swath is a wood on a terrace; the other end is bare ground so much nearer that
/// its zone, counted from the phase of the wood, differs. Without a pause its last echoes are
/// received in the first records of the next line, which belong to the wood, and must not count as
/// evidence there.
#[test]
fn the_end_of_a_line_says_nothing_of_the_begin_of_the_next() {
    const SHOTS: usize = 120;
    let range_m = |_: usize, shot: usize| match shot % SHOTS {
        0..24 => 3112.0 + 16.0 * (random(77 + shot as u64) - 0.5),
        column => 2942.0 - 92.0 / 96.0 * (column - 24) as f64,
    };
    let (lines, causes) = strip(1, 40 * SHOTS, 15.0, range_m);
    let (resolved, _) = resolve(&settings(Method::Blocks), &cut(&lines[0], SHOTS));
    assert_eq!(wrong_of(&resolved, SHOTS, &causes[0]), 0);
}

/// Sweeps of 200 shots across a slope, as lines of `shots` shots.
fn pieces(shots: usize, modulation_ns: f64) -> (Vec<Line>, Vec<u32>) {
    let range_m = |_: usize, shot: usize| 1010.0 + 0.8 * (shot % 200) as f64;
    let (mut lines, causes) = strip(1, 24 * 200, modulation_ns, range_m);
    for (shot, emission) in lines[0].emissions.iter_mut().enumerate() {
        emission.scan_angle_deg = -10.0 + 0.1 * (shot % 200) as f32;
    }
    (cut(&lines[0], shots), causes.concat())
}

#[test]
fn pieces_of_a_sweep_are_resolved_as_the_sweep() {
    for shots in [1, 5, 8] {
        let (lines, causes) = pieces(shots, 15.0);
        let mut resolver = Resolver::new(&settings(Method::Blocks)).unwrap();
        let mut resolved = Vec::new();
        for (pushed, line) in lines.iter().enumerate() {
            resolver.push(line).unwrap();
            resolved.extend(std::iter::from_fn(|| resolver.pop()));
            assert!(pushed + 1 - resolved.len() <= resolver.look_ahead_lines());
        }
        resolver.finish().unwrap();
        resolved.extend(std::iter::from_fn(|| resolver.pop()));
        assert_eq!(wrong_of(&resolved, shots, &causes), 0, "{shots}");
        assert!(resolved.iter().enumerate().all(|(number, line)| line.line == number as u64));
        assert_eq!(resolver.warnings(), []);
        // No cause lies in a line that was reported complete.
        let mut settled = 0;
        for line in &resolved {
            assert!(line.echoes.iter().flat_map(|echo| echo.cause).all(|cause| cause.line >= settled));
            assert!(line.settled_lines >= settled && line.settled_lines <= line.line + 1);
            settled = line.settled_lines;
        }
        assert_eq!(settled, lines.len() as u64);
    }
}

/// A conical scan of 1000 shots per revolution, in lines that are not a whole fraction of it.
///
/// The ground has a step that the end and the start of the revolution share. Neighbours are found
/// by azimuth, across the wrap.
#[test]
fn revolutions_are_compared_by_azimuth() {
    let range_m = |_: usize, shot: usize| {
        let azimuth = shot % 1000;
        let wood = f64::from(u8::from(!(60..930).contains(&azimuth)));
        let tilted = 1010.0 + 90.0 * (azimuth as f64 / 1000.0 * std::f64::consts::TAU + 0.4).sin();
        tilted + wood * (8.0 * random(7 + shot as u64) - 30.0)
    };
    let (mut lines, causes) = strip(1, 24_000, 15.0, range_m);
    for (shot, emission) in lines[0].emissions.iter_mut().enumerate() {
        emission.scan_angle_deg = 0.36 * (shot % 1000) as f32;
    }
    for shots in [1, 300, 1000, 1600] {
        let settings = Settings { is_cyclic: true, ..settings(Method::Blocks) };
        let lines = cut(&lines[0], shots);
        let (resolved, resolver) = resolve(&settings, &lines);
        assert_eq!(wrong_of(&resolved, shots, &causes[0]), 0, "{shots}");
        assert!(resolved.iter().enumerate().all(|(number, line)| line.line == number as u64));
        assert_eq!(resolver.warnings(), []);
    }
}

#[test]
fn a_constant_rate_is_refused_for_pieces_of_a_sweep_too() {
    let (lines, _) = pieces(1, 0.0);
    let mut resolver = Resolver::new(&settings(Method::Blocks)).unwrap();
    let pushed = lines.iter().try_for_each(|line| resolver.push(line));
    let error = pushed.and_then(|()| resolver.finish()).unwrap_err();
    assert!(matches!(error, MtaError::ConstantRate { .. }), "{error}");
}

/// Without angles the end of a sweep is unknown; range and modulation suffice.
#[test]
fn pieces_without_angles_are_resolved_on_level_ground() {
    let (mut lines, causes) = pieces(1, 15.0);
    let emissions = lines.iter_mut().flat_map(|line| &mut line.emissions);
    emissions.for_each(|emission| emission.scan_angle_deg = f32::NAN);
    let (resolved, _) = resolve(&settings(Method::Blocks), &lines);
    assert_eq!(wrong_of(&resolved, 1, &causes), 0);
}

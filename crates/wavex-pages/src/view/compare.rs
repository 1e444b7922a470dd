//! What other keys change in the returns of shots and scan lines.

use std::collections::{BTreeMap, BTreeSet};
use std::iter::Peekable;
use std::ops::{Range, RangeInclusive};
use std::time::{Duration, Instant};

use serde_json::{Value, json};

use super::lines::InputLines;
use super::placed::{PlacedReturn, placed, text};
use super::session::{Placing, Session};
use wavex_line::scan_line::ScanLine;

/// Limit of the shots that are decomposed for one answer.
const MAX_SHOTS: usize = 50_000;
/// Time after which a comparison ends with its results so far.
const MAX_TIME: Duration = Duration::from_secs(5);
/// Limit of the entries of each list of changes.
const MAX_CHANGES: usize = 5000;
/// Lines that are decomposed at once.
const LINES_AT_ONCE: usize = 16;
/// Returns nearer than this in time of flight are the same return, ns.
const SAME_NS: f64 = 1.5;
/// Smallest difference of times of flight that counts as a move, ns: a tenth of a millimetre.
const MOVED_NS: f64 = 7e-4;

/// What other keys change in scan lines: of one shot, or of shots by input.
pub(super) fn compare(
    session: &Session,
    shots: &BTreeMap<usize, BTreeSet<u64>>,
    whole_lines: bool,
    set: &[String],
) -> Result<Value, String> {
    let (base, other, placing) = (session.with(&[])?, session.with(set)?, session.placing());
    let begin = Instant::now();
    let is_over = || begin.elapsed() > MAX_TIME;
    let mut compared = Compared::default();
    for (&input, wanted) in shots {
        if compared.shots > 0 && is_over() {
            compared.is_limited = true;
            break;
        }
        session.with_lines(input, |lines| {
            let mut rest = wanted.iter().copied().peekable();
            let mut done = BTreeSet::new();
            while rest.peek().is_some() {
                let most = MAX_SHOTS.saturating_sub(compared.shots);
                if most == 0 || (compared.shots > 0 && is_over()) {
                    compared.is_limited = true;
                    break;
                }
                for numbers in ranges(&next_lines(lines, &mut rest, &mut done, most, is_over)?) {
                    let before = lines.with_points(&base.job, numbers.clone()).map_err(text)?;
                    let after = lines.with_points(&other.job, numbers).map_err(text)?;
                    for lines in before.iter().zip(&after) {
                        compared.add(input, lines, (!whole_lines).then_some(wanted), placing.as_ref());
                    }
                }
            }
            Ok(())
        })?;
    }
    Ok(compared.value())
}

/// Positions of the lines of the next shots: one line, and more up to a number of shots or the end of the time.
///
/// Lines that are `done` are left out; those found are added to them.
fn next_lines(
    lines: &mut InputLines,
    shots: &mut Peekable<impl Iterator<Item = u64>>,
    done: &mut BTreeSet<usize>,
    most: usize,
    is_over: impl Fn() -> bool,
) -> Result<BTreeSet<usize>, String> {
    let (mut found, mut sum) = (BTreeSet::new(), 0);
    let mut own: Option<RangeInclusive<u64>> = None;
    while let Some(&shot) = shots.peek() {
        if !own.as_ref().is_some_and(|range| range.contains(&shot)) {
            if found.len() == LINES_AT_ONCE || (!found.is_empty() && is_over()) {
                break;
            }
            if let Some(number) = lines.of_shot(shot).map_err(text)? {
                let line = &lines.index().lines()[number];
                let [first, last] = line.shot_range;
                // Shot numbers of a line that has as many shots as numbers are its own.
                own = (last - first == u64::from(line.shots).saturating_sub(1)).then_some(first..=last);
                if !done.contains(&number) {
                    sum += line.shots as usize;
                    if !found.is_empty() && sum > most {
                        break;
                    }
                    found.insert(number);
                    done.insert(number);
                }
            }
        }
        shots.next();
    }
    Ok(found)
}

/// Adjacent positions as ranges of limited length.
fn ranges(numbers: &BTreeSet<usize>) -> Vec<Range<usize>> {
    let mut ranges: Vec<Range<usize>> = Vec::new();
    for &number in numbers {
        match ranges.last_mut() {
            Some(last) if last.end == number && last.len() < LINES_AT_ONCE => last.end += 1,
            _ => ranges.push(number..number + 1),
        }
    }
    ranges
}

/// A change of a return.
pub(super) struct ReturnChange<'p> {
    pub(super) kind: &'static str,
    pub(super) before: Option<&'p PlacedReturn>,
    pub(super) after: Option<&'p PlacedReturn>,
    pub(super) moved_m: Option<f64>,
}

/// Pairs the returns of a shot before and after a change of keys, both in order of time.
pub(super) fn changes<'p>(before: &'p [PlacedReturn], after: &'p [PlacedReturn]) -> Vec<ReturnChange<'p>> {
    let mut left: Vec<&PlacedReturn> = after.iter().collect();
    let mut changes: Vec<ReturnChange> = Vec::new();
    for old in before {
        let distance =
            |new: &&PlacedReturn| (new.found.time_of_flight_ns - old.found.time_of_flight_ns).abs();
        let nearest = left.iter().enumerate().min_by(|a, b| distance(a.1).total_cmp(&distance(b.1)));
        match nearest.filter(|(_, new)| distance(new) < SAME_NS).map(|(at, _)| at) {
            Some(at) => {
                let new = left.remove(at);
                let kind = if distance(&new) < MOVED_NS { "same" } else { "moved" };
                let moved_m = (new.found.range_m - old.found.range_m).abs();
                changes.push(ReturnChange {
                    kind,
                    before: Some(old),
                    after: Some(new),
                    moved_m: Some(moved_m),
                });
            }
            None => {
                changes.push(ReturnChange { kind: "gone", before: Some(old), after: None, moved_m: None })
            }
        }
    }
    let new = left.into_iter().map(|new| ReturnChange {
        kind: "new",
        before: None,
        after: Some(new),
        moved_m: None,
    });
    changes.extend(new);
    changes.sort_by(|a, b| {
        let time_ns = |change: &ReturnChange| {
            change.before.or(change.after).map_or(0.0, |placed| placed.found.time_of_flight_ns)
        };
        time_ns(a).total_cmp(&time_ns(b))
    });
    changes
}

/// Sum of the changes of many shots.
#[derive(Default)]
struct Compared {
    shots: usize,
    before: usize,
    after: usize,
    /// Entries and total of the kinds.
    lists: BTreeMap<&'static str, (Vec<Value>, usize)>,
    is_limited: bool,
}

/// For each shot of a line, whether it is compared: `wanted`: shots with returns; `returns`: returns of each shot.
///
/// A shot without returns is compared if the nearest ones with returns before and after it in the line are.
fn are_compared(
    shots: impl Iterator<Item = u64>,
    returns: &[Vec<PlacedReturn>],
    wanted: &BTreeSet<u64>,
) -> Vec<bool> {
    let own = shots.zip(returns);
    let own = own.map(|(shot, returns)| (!returns.is_empty()).then(|| wanted.contains(&shot)));
    let own: Vec<Option<bool>> = own.collect();
    let nearest = |last: &mut Option<bool>, own: &Option<bool>| {
        *last = own.or(*last);
        Some(*last)
    };
    let before: Vec<Option<bool>> = own.iter().scan(None, nearest).collect();
    let mut after: Vec<Option<bool>> = own.iter().rev().scan(None, nearest).collect();
    after.reverse();
    let sides = before.into_iter().zip(after);
    // At an end of the line, only one side has returns.
    sides.map(|(before, after)| before.or(after) == Some(true) && after.or(before) == Some(true)).collect()
}

impl Compared {
    /// Adds a line before and after a change of keys: the shots of `wanted`, or all.
    fn add(
        &mut self,
        input: usize,
        (before, after): (&ScanLine, &ScanLine),
        wanted: Option<&BTreeSet<u64>>,
        placing: Option<&Placing>,
    ) {
        let (olds, news) = (placed(before, placing), placed(after, placing));
        let are_compared = wanted
            .map(|wanted| are_compared(before.emissions.iter().map(|emission| emission.shot), &olds, wanted));
        for (at, (old, new)) in olds.iter().zip(&news).enumerate() {
            if are_compared.as_ref().is_some_and(|are| !are[at]) {
                continue;
            }
            let shot = before.emissions[at].shot;
            self.shots += 1;
            self.before += old.len();
            self.after += new.len();
            for change in changes(old, new).iter().filter(|change| change.kind != "same") {
                let (entries, total) = self.lists.entry(change.kind).or_default();
                *total += 1;
                if let Some(placed) = change.after.or(change.before)
                    && entries.len() < MAX_CHANGES
                {
                    entries.push(json!({
                        "input": input, "shot": shot, "return_number": placed.found.return_number,
                        "position": placed.position, "time_of_flight_ns": placed.found.time_of_flight_ns,
                        "moved_m": change.moved_m,
                    }));
                }
            }
        }
    }

    fn value(mut self) -> Value {
        let mut value = json!({ "shots": self.shots, "before": self.before, "after": self.after,
                                "limited": self.is_limited });
        for kind in ["new", "gone", "moved"] {
            let (entries, total) = self.lists.remove(kind).unwrap_or_default();
            value[kind] = entries.into();
            value[format!("{kind}_total")] = total.into();
        }
        value
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use wavex_line::scan_line::Return;

    fn placed(number: u8, flight_ns: f64) -> PlacedReturn {
        let found = Return {
            return_number: number,
            time_of_flight_ns: flight_ns,
            range_m: 0.15 * flight_ns,
            ..Return::default()
        };
        PlacedReturn { found, position: None }
    }

    #[test]
    fn changes_pair_returns_of_nearly_the_same_time() {
        let before = [placed(1, 100.0), placed(2, 110.0), placed(3, 120.0)];
        let after = [placed(1, 100.00001), placed(2, 110.2), placed(3, 115.0)];
        let found = changes(&before, &after);
        let kinds: Vec<&str> = found.iter().map(|change| change.kind).collect();
        assert_eq!(kinds, ["same", "moved", "new", "gone"]);
        assert!((found[1].moved_m.unwrap() - 0.03).abs() < 1e-9);
    }

    #[test]
    fn shots_without_returns_are_compared_between_those_with_returns() {
        let returns = [0, 1, 0, 1, 0, 1].map(|n| vec![placed(1, 100.0); n]);
        let found = are_compared(0..6, &returns, &BTreeSet::from([1, 3]));
        assert_eq!(found, [true, true, true, true, false, false]);
    }

    #[test]
    fn adjacent_lines_are_read_together() {
        let numbers = (0..20).chain([30, 40, 41]).collect();
        assert_eq!(ranges(&numbers), [0..16, 16..20, 30..31, 40..42]);
    }
}

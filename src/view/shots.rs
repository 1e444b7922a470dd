//! Answers about shots: their fit, their scan line, and what other keys change.

use std::collections::{BTreeMap, BTreeSet};
use std::iter::Peekable;
use std::ops::{Range, RangeInclusive};
use std::time::{Duration, Instant};

use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use serde_json::{Value, json};

use super::lines::Lines;
use super::session::{Placing, Session};
use crate::explain::{ExplainError, Explained};
use crate::job::Job;
use crate::scan_line::{Block, Channel, Content, Emission, Return, ScanLine, flags};

/// Limit of the rows of a picture of a scan line.
const MAX_ROWS: usize = 2000;
/// Limit of the shots that are decomposed for one answer.
const MAX_SHOTS: usize = 50_000;
/// Time after which a comparison ends with what it has.
const MAX_TIME: Duration = Duration::from_secs(5);
/// Limit of the entries of each list of changes.
const MAX_CHANGES: usize = 5000;
/// Lines that are decomposed at once.
const LINES_AT_ONCE: usize = 16;
/// Returns nearer than this in time of flight are the same return, ns.
const SAME_NS: f64 = 1.5;
/// Smallest difference of times of flight that counts as a move, ns: a tenth of a millimetre.
const MOVED_NS: f64 = 7e-4;

/// A return with its position.
#[derive(Clone, Debug)]
struct Placed {
    found: Return,
    position: Option<[f64; 3]>,
}

/// A shot with the keys of the job, and its difference by other keys.
pub(super) fn shot(session: &Session, input: usize, shot: u64, set: &[String]) -> Result<Value, String> {
    let (base, chosen, placing) = (session.with(&[])?, session.with(set)?, session.placing());
    let placing = placing.as_ref();
    session.with_lines(input, |lines| {
        let number = place(lines, shot)?;
        let shots_of = |at: Option<usize>| Some(lines.index().lines().get(at?)?.shot_range);
        let [line_before, line_after] = [number.checked_sub(1), number.checked_add(1)].map(shots_of);
        let file = session.inputs[input].input.path.display().to_string();
        let file = if file.is_empty() { session.inputs[input].input.stem.clone() } else { file };
        let simd = lines.simd();
        let before = lines.before_decompose(&chosen.job, number..number + 1).map_err(text)?;
        let Some(line) = before.first() else { return Err(format!("shot {shot}: its line cannot be read")) };
        let explained = match Explained::of(line, shot, &chosen.decompose, simd, &file) {
            Ok(explained) => Ok(explained),
            Err(ExplainError::Without(problem)) => Err(problem),
            Err(ExplainError::Stage(error)) => return Err(error.to_string()),
        };
        let place = line.emissions.iter().position(|emission| emission.shot == shot);
        let of_line = place.map(|place| json!({ "number": line.line, "shot": place, "shots": line.emissions.len() }));
        let others = || line.emissions.iter().map(|emission| emission.shot);
        let previous = others().filter(|&other| other < shot).max().or(line_before.map(|[_, last]| last));
        let next = others().filter(|&other| other > shot).min().or(line_after.map(|[first, _]| first));
        let explained = match explained {
            Ok(explained) => explained,
            // The page can go on to the next shot.
            Err(problem) => {
                let emission = place.and_then(|place| line.emissions.get(place));
                let gps_time_s = emission.map_or(f64::NAN, |emission| emission.gps_time_s);
                let none: [Value; 0] = [];
                return Ok(json!({
                    "input": input, "shot": shot, "gps_time_s": number_or_null(gps_time_s), "problem": problem,
                    "title": format!("shot {shot}"), "text": "", "svg": null,
                    "line": of_line, "previous": previous, "next": next,
                    "returns": none, "instrument": none, "blocks": none, "difference": null,
                }));
            }
        };
        let online: Vec<Value> = line.blocks().map_or(Vec::new(), |blocks| {
            let of_shot = blocks.online.iter().filter(|online| Some(online.emission as usize) == place);
            let velocity_m_per_ns = line.input.group_velocity_mps * 1e-9;
            of_shot
                .map(|online| {
                    let flight_ns = online.time_ns - explained.emission.emission_ns;
                    json!({ "time_of_flight_ns": flight_ns, "range_m": 0.5 * flight_ns * velocity_m_per_ns,
                            "amplitude_dn": number_or_null(online.amplitude.into()) })
                })
                .collect()
        });
        let after = returns_of(lines, &chosen.job, number, shot, placing)?;
        let difference = match set {
            [] => Value::Null,
            _ => {
                let before = returns_of(lines, &base.job, number, shot, placing)?;
                let changes: Vec<Value> = changes(&before, &after)
                    .iter()
                    .map(|change| {
                        json!({ "change": change.kind, "moved_m": change.moved_m,
                                "before": change.before.map(return_value), "after": change.after.map(return_value) })
                    })
                    .collect();
                json!({ "before": before.len(), "after": after.len(), "changes": changes })
            }
        };
        let blocks: Vec<Value> = explained.blocks.iter().map(|block| {
            let (shown, samples) = (&block.shown, &block.shown.samples);
            json!({ "channel": shown.channel, "first_ns": shown.first_ns, "interval_ns": samples.interval_ns,
                    "chi_square": number_or_null(shown.chi_square), "degrees_of_freedom": shown.degrees_of_freedom,
                    "samples_dn": samples.samples_dn, "used": samples.used, "residual": samples.residual,
                    "background_dn": samples.background_dn, "full_scale_dn": samples.full_scale_dn,
                    "peaks": shown.peaks.iter().map(|peak| peak.position_samples).collect::<Vec<f64>>() })
        }).collect();
        let table = explained.table();
        Ok(json!({
            "input": input, "shot": shot, "gps_time_s": number_or_null(explained.emission.gps_time_s), "problem": null,
            "title": explained.title(), "text": table, "svg": explained.picture(),
            "line": of_line, "previous": previous, "next": next,
            "returns": after.iter().map(return_value).collect::<Vec<Value>>(),
            "instrument": online, "blocks": blocks, "difference": difference,
        }))
    })
}

/// The waveforms of the scan line of a shot as a picture, and its returns.
pub(super) fn line(session: &Session, input: usize, shot: u64) -> Result<Value, String> {
    let base = session.with(&[])?;
    session.with_lines(input, |lines| {
        let number = place(lines, shot)?;
        let decomposed = lines.with_points(&base.job, number..number + 1).map_err(text)?;
        let before = lines.before_decompose(&base.job, number..number + 1).map_err(text)?;
        let (Some(recorded), Some(decomposed)) = (before.first(), decomposed.first()) else {
            return Err(format!("shot {shot}: its line cannot be read"));
        };
        let mut picture = LinePicture::of(recorded, &decomposed.emissions)?;
        let image = picture.png()?;
        let returns: Vec<Value> = decomposed
            .returns()
            .into_iter()
            .flatten()
            .map(|found| {
                json!({ "column": found.emission, "time_of_flight_ns": found.time_of_flight_ns,
                    "return_number": found.return_number, "flags": names(found.flags) })
            })
            .collect();
        Ok(json!({
            "line": recorded.line, "first_shot": recorded.emissions.first().map(|e| e.shot),
            "shots": recorded.emissions.iter().map(|e| e.shot).collect::<Vec<u64>>(),
            "first_ns": picture.first_ns, "interval_ns": picture.interval_ns,
            "width": picture.width, "height": picture.height, "highest_dn": picture.highest_dn,
            "image": BASE64_STANDARD.encode(image), "returns": returns,
        }))
    })
}

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

/// Position of the line of a shot.
fn place(lines: &mut Lines, shot: u64) -> Result<usize, String> {
    lines.of_shot(shot).map_err(text)?.ok_or_else(|| format!("the recording has no shot {shot}"))
}

/// Positions of the lines of the next shots: one line, and more up to a number of shots or the end of the time.
///
/// Lines that are `done` are left out; those found are added to them.
fn next_lines(
    lines: &mut Lines,
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

/// Returns of a shot by the keys of a job.
fn returns_of(
    lines: &mut Lines,
    job: &Job,
    number: usize,
    shot: u64,
    placing: Option<&Placing>,
) -> Result<Vec<Placed>, String> {
    let found = lines.with_points(job, number..number + 1).map_err(text)?;
    let Some(line) = found.first() else { return Ok(Vec::new()) };
    let of_shot =
        line.emissions.iter().zip(placed(line, placing)).find(|(emission, _)| emission.shot == shot);
    Ok(of_shot.map_or(Vec::new(), |(_, returns)| returns))
}

/// Returns of each emission of a line, with their positions on the map.
fn placed(line: &ScanLine, placing: Option<&Placing>) -> Vec<Vec<Placed>> {
    let mut placed = vec![Vec::new(); line.emissions.len()];
    let position = |at: usize| {
        let on_map = placing?.on_map(*line.points()?.get(at)?);
        on_map.iter().all(|coordinate| coordinate.is_finite()).then_some(on_map)
    };
    for (at, found) in line.returns().into_iter().flatten().enumerate() {
        if let Some(of_emission) = placed.get_mut(found.emission as usize) {
            of_emission.push(Placed { found: *found, position: position(at) });
        }
    }
    placed
}

/// A change of a return.
struct Change<'p> {
    kind: &'static str,
    before: Option<&'p Placed>,
    after: Option<&'p Placed>,
    moved_m: Option<f64>,
}

/// Pairs the returns of a shot before and after a change of keys, both in order of time.
fn changes<'p>(before: &'p [Placed], after: &'p [Placed]) -> Vec<Change<'p>> {
    let mut left: Vec<&Placed> = after.iter().collect();
    let mut changes: Vec<Change> = Vec::new();
    for old in before {
        let distance = |new: &&Placed| (new.found.time_of_flight_ns - old.found.time_of_flight_ns).abs();
        let nearest = left.iter().enumerate().min_by(|a, b| distance(a.1).total_cmp(&distance(b.1)));
        match nearest.filter(|(_, new)| distance(new) < SAME_NS).map(|(at, _)| at) {
            Some(at) => {
                let new = left.remove(at);
                let kind = if distance(&new) < MOVED_NS { "same" } else { "moved" };
                let moved_m = (new.found.range_m - old.found.range_m).abs();
                changes.push(Change { kind, before: Some(old), after: Some(new), moved_m: Some(moved_m) });
            }
            None => changes.push(Change { kind: "gone", before: Some(old), after: None, moved_m: None }),
        }
    }
    let new =
        left.into_iter().map(|new| Change { kind: "new", before: None, after: Some(new), moved_m: None });
    changes.extend(new);
    changes.sort_by(|a, b| {
        let time_ns = |change: &Change| {
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

/// For each shot of a line, whether it is compared: `wanted` are shots with returns; `returns` are those of each shot.
///
/// A shot without returns is compared if the nearest ones with returns before and after it in the line are.
fn are_compared(
    shots: impl Iterator<Item = u64>,
    returns: &[Vec<Placed>],
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

/// Waveforms of a scan line: amplitudes by shot and time of flight.
struct LinePicture {
    width: usize,
    height: usize,
    first_ns: f64,
    interval_ns: f64,
    highest_dn: f64,
    /// Heights above the background, DN, row by row.
    heights_dn: Vec<f32>,
}

impl LinePicture {
    /// Waveforms of the echoes of a line; `emissions` have the fitted emission times.
    fn of(line: &ScanLine, emissions: &[Emission]) -> Result<LinePicture, String> {
        let Content::Shots(blocks) = &line.content else { return Err("the line has no samples".into()) };
        let has_low = blocks.iter().any(|block| block.channel == Channel::LowPower);
        let is_shown = |block: &&Block| {
            if has_low { block.channel == Channel::LowPower } else { block.channel.is_echo() }
        };
        let emission_ns = |index: usize| emissions.get(index).map_or(0.0, |emission| emission.emission_ns);
        let mut shown: Vec<(usize, f64, &Block)> = Vec::new();
        for (index, of_shot) in blocks.by_emission() {
            let index = index as usize;
            shown.extend(
                of_shot
                    .iter()
                    .filter(is_shown)
                    .map(|block| (index, block.start_ns - emission_ns(index), block)),
            );
        }
        let interval_ns = shown.first().map_or(1.0, |(_, _, block)| block.interval_ns);
        let first_ns = shown.iter().map(|(_, start_ns, _)| *start_ns).fold(f64::INFINITY, f64::min);
        let end_ns =
            |(_, start_ns, block): &(usize, f64, &Block)| start_ns + block.interval_ns * block.len() as f64;
        let last_ns = shown.iter().map(end_ns).fold(f64::NEG_INFINITY, f64::max);
        // Without blocks, the last time is before the first.
        if shown.is_empty() || last_ns <= first_ns {
            return Err("the line has no recorded echoes".into());
        }
        let interval_ns = interval_ns.max((last_ns - first_ns) / MAX_ROWS as f64);
        let height = (((last_ns - first_ns) / interval_ns).ceil() as usize).clamp(1, MAX_ROWS);
        let width = line.emissions.len();
        let background = |channel: Channel| {
            let model = line.model.as_deref()?;
            let of = if channel == Channel::LowPower { &model.low_power } else { &model.high_power };
            let levels_dn = &of.as_ref()?.background_dn;
            Some(levels_dn.iter().sum::<f64>() / levels_dn.len().max(1) as f64)
        };
        let mut heights_dn = vec![0.0_f32; width * height];
        for (index, start_ns, block) in &shown {
            let background_dn = background(block.channel).unwrap_or_default();
            for (k, &sample) in blocks.samples(block).iter().enumerate() {
                let row = ((start_ns + block.interval_ns * k as f64 - first_ns) / interval_ns) as usize;
                if let Some(height_dn) = heights_dn.get_mut(row.min(height - 1) * width + index) {
                    *height_dn = height_dn.max((f64::from(sample) - background_dn) as f32);
                }
            }
        }
        let highest_dn = heights_dn.iter().copied().fold(1.0, f32::max).into();
        Ok(LinePicture { width, height, first_ns, interval_ns, highest_dn, heights_dn })
    }

    /// The picture as PNG, 8 bits of grey: 255 is the highest sample.
    fn png(&mut self) -> Result<Vec<u8>, String> {
        let grey = |height_dn: &f32| (f64::from(*height_dn) / self.highest_dn * 255.0).round() as u8;
        let pixels: Vec<u8> = self.heights_dn.iter().map(grey).collect();
        grey_png(self.width, self.height, &pixels).map_err(text)
    }
}

/// A picture in 8 bits of grey as PNG, row by row from the top.
fn grey_png(width: usize, height: usize, pixels: &[u8]) -> Result<Vec<u8>, png::EncodingError> {
    let mut bytes = Vec::new();
    // Both are limited: a line has at most 4096 shots.
    let mut encoder = png::Encoder::new(&mut bytes, width as u32, height as u32);
    encoder.set_color(png::ColorType::Grayscale);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.set_compression(png::Compression::Fast);
    let mut writer = encoder.write_header()?;
    writer.write_image_data(pixels)?;
    writer.finish()?;
    Ok(bytes)
}

/// All quantities of a return.
fn return_value(placed: &Placed) -> Value {
    let found = &placed.found;
    json!({
        "return_number": found.return_number, "number_of_returns": found.number_of_returns,
        "channel": found.channel.name(),
        "time_of_flight_ns": number_or_null(found.time_of_flight_ns),
        "time_of_flight_sd_ns": number_or_null(found.time_of_flight_sd_ns),
        "range_m": number_or_null(found.range_m), "range_sd_m": number_or_null(found.range_sd_m),
        "amplitude_dn": number_or_null(found.amplitude_dn), "amplitude_sd_dn": number_or_null(found.amplitude_sd_dn),
        "width_ratio": number_or_null(found.width_ratio), "width_ratio_sd": number_or_null(found.width_ratio_sd),
        "thickness_m": number_or_null(found.thickness_m), "thickness_sd_m": number_or_null(found.thickness_sd_m),
        "deviation_ratio": number_or_null(found.deviation_ratio),
        "total_sd_m": number_or_null(found.total_sd_m), "intensity": number_or_null(found.intensity),
        "mta_zone": found.mta_zone, "class": found.class, "flags": names(found.flags),
        "position": placed.position,
    })
}

/// Names of the flags that are set.
pub(super) fn names(of: u16) -> Vec<&'static str> {
    flags::NAMES.iter().filter(|(bit, _)| of & bit != 0).map(|(_, name)| *name).collect()
}

/// A number; `null` if it is not finite.
pub(super) fn number_or_null(value: f64) -> Value {
    serde_json::Number::from_f64(value).map_or(Value::Null, Value::Number)
}

fn text(error: impl std::fmt::Display) -> String {
    error.to_string()
}

/// The job with these keys of `decompose`, as text.
///
/// # Errors
/// If a key or value is invalid.
pub(super) fn job(session: &Session, set: &[String]) -> Result<String, String> {
    session.with(set)?;
    let opened = &session.opened;
    let given = opened.job.overrides.iter().map(|given| given.text.clone());
    let set: Vec<String> = given.chain(set.iter().cloned()).collect();
    let text = format!("{}\n", opened.job.text.trim_end());
    if set.is_empty() {
        return Ok(text);
    }
    let (edited, left) = with_keys(&text, &set);
    // Such as a value on several lines, or a library, which no text may name.
    let is_valid = match opened.job.includes.is_empty() {
        true => Job::parse(&opened.job.name, &edited, &[]).is_ok(),
        false => toml::from_str::<toml::Table>(&edited).is_ok(),
    };
    let (text, left) = if is_valid { (edited, left) } else { (text, set.clone()) };
    let list = |set: &[String]| -> String {
        set.iter()
            .map(|set| format!("#   {}\n", set.replacen('=', " = ", 1).replace(['\n', '\r'], " ")))
            .collect()
    };
    let mut head = format!("# Keys changed in `wavex view`:\n{}", list(&set));
    if !left.is_empty() {
        head += &format!("# Of these, not in the text below; give them with --set:\n{}", list(&left));
    }
    if opened.kind == "job" {
        let arguments: Vec<String> = set.iter().map(|set| format!("--set {}", shell_word(set))).collect();
        let name = shell_word(&opened.job.name.replace(['\n', '\r'], " "));
        head += &format!(
            "# On the command line: wavex run {name} {}\n",
            arguments.join(" ").replace(['\n', '\r'], " ")
        );
    }
    Ok(format!("{head}\n{text}"))
}

/// Text of a job with these keys in its tables, and the keys whose tables it does not have.
fn with_keys(text: &str, set: &[String]) -> (String, Vec<String>) {
    let key_of = |line: &str| line.split_once('=').map(|(key, _)| key.trim().to_owned());
    let tables: Vec<(Names, Vec<&str>)> =
        tables(text).into_iter().map(|lines| (Names::of(&lines), lines)).collect();
    let is_id = |name: &str| tables.iter().any(|(names, _)| names.id.as_deref() == Some(name));
    let mut left = set.to_vec();
    let mut edited = String::new();
    for (names, lines) in &tables {
        let is_own = |set: &String| {
            let name = set.split_once('.').map(|(name, _)| name);
            name.is_some()
                && name == if name.is_some_and(is_id) { names.id.as_deref() } else { names.kind.as_deref() }
        };
        let (own, others): (Vec<String>, Vec<String>) = left.into_iter().partition(is_own);
        left = others;
        // The last of several values holds.
        let keys: BTreeMap<&str, &str> = own
            .iter()
            .filter_map(|set| set.split_once('.').and_then(|(_, key)| key.split_once('=')))
            .map(|(key, value)| (key.trim(), value.trim()))
            .collect();
        let place = lines.iter().position(|line| key_of(line).as_deref() == Some("type")).unwrap_or(0);
        for (at, line) in lines.iter().enumerate() {
            let is_replaced = key_of(line).is_some_and(|key| keys.contains_key(key.as_str()));
            if !is_replaced {
                edited += line;
                edited.push('\n');
            }
            if at == place {
                edited.extend(keys.iter().map(|(key, value)| format!("{key} = {}\n", toml_value(value))));
            }
        }
    }
    (edited, left)
}

/// Names by which `--set` addresses a table.
#[derive(Default)]
struct Names {
    /// `job`, or the type of a stage.
    kind: Option<String>,
    id: Option<String>,
}

impl Names {
    fn of(lines: &[&str]) -> Names {
        let Ok(table) = toml::from_str::<toml::Table>(&lines.join("\n")) else { return Names::default() };
        if table.contains_key("job") {
            return Names { kind: Some("job".into()), id: None };
        }
        let stage = table.get("stage").and_then(|stages| stages.as_array()?.first());
        let text = |key: &str| stage.and_then(|stage| Some(stage.get(key)?.as_str()?.to_owned()));
        Names { kind: text("type"), id: text("id") }
    }
}

/// Lines of each table of a job, with its header.
fn tables(text: &str) -> Vec<Vec<&str>> {
    let mut tables = vec![Vec::new()];
    for line in text.lines() {
        if line.starts_with('[') {
            tables.push(Vec::new());
        }
        if let Some(table) = tables.last_mut() {
            table.push(line);
        }
    }
    tables
}

/// A value as TOML: text gets quotation marks.
fn toml_value(value: &str) -> String {
    match toml::from_str::<toml::Table>(&format!("key = {value}")) {
        Ok(_) => value.to_owned(),
        Err(_) => toml::Value::String(value.to_owned()).to_string(),
    }
}

/// A word for a shell.
fn shell_word(text: &str) -> String {
    let is_plain = |c: char| c.is_ascii_alphanumeric() || "-_./=,:".contains(c);
    if text.chars().all(is_plain) { text.to_owned() } else { format!("'{}'", text.replace('\'', "'\\''")) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn placed(number: u8, flight_ns: f64) -> Placed {
        let found = Return {
            return_number: number,
            time_of_flight_ns: flight_ns,
            range_m: 0.15 * flight_ns,
            ..Return::default()
        };
        Placed { found, position: None }
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
    fn keys_are_written_into_their_stage() {
        let text = "[[stage]]\ntype = \"read_las\"\nmode = 1\n\n[[stage]]\ntype = 'decompose'\n\
                    detection_sigma = 4.5\n# why\n\n[[stage]]\ntype = \"write_las\"\n";
        let set = ["decompose.detection_sigma=6".to_owned(), "decompose.mode=slow".to_owned()];
        assert_eq!(
            with_keys(text, &set).0,
            "[[stage]]\ntype = \"read_las\"\nmode = 1\n\n[[stage]]\ntype = 'decompose'\n\
             detection_sigma = 6\nmode = \"slow\"\n# why\n\n[[stage]]\ntype = \"write_las\"\n"
        );
    }

    #[test]
    fn keys_without_a_table_are_left() {
        let set = ["job.threads=2".to_owned(), "fit.mode=slow".to_owned(), "georeference.crs=utm".to_owned()];
        let text = "[job]\nname = 'a'\n[[stage]]\ntype = 'decompose' # why\nid = 'fit'\n";
        let (edited, left) = with_keys(text, &set);
        assert_eq!(
            edited,
            "[job]\nthreads = 2\nname = 'a'\n[[stage]]\ntype = 'decompose' # why\nmode = \"slow\"\nid = 'fit'\n"
        );
        assert_eq!(left, ["georeference.crs=utm"]);
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

    #[test]
    fn words_for_a_shell_are_quoted() {
        assert_eq!(shell_word("decompose.mode=slow"), "decompose.mode=slow");
        assert_eq!(shell_word("a b'c"), "'a b'\\''c'");
    }
}

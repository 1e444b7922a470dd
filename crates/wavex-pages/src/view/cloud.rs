//! Answers about points: the tree, positions and values, profiles, searches.

use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;

use serde_json::{Value, json};

use super::attributes::{ATTRIBUTES, Attribute, Condition};
use super::extent::{box_of, usual_box};
use super::points::{ViewPoint, ViewPoints};
use super::session::{Placing, Session, SessionState};
use super::shots::{names, number_or_null};
use wavex_ground::point::Class;
use wavex_line::scan_line::flags;

/// Most points of an answer with positions or values.
const MAX_POINTS: usize = 100_000;
/// Most points of a profile.
const MAX_PROFILE: usize = 200_000;
/// Most entries of a search.
const MAX_FOUND: usize = 5000;
/// Most shots of a rectangle.
const MAX_SHOTS: usize = 200_000;

/// Why a request about points has no answer.
pub(super) enum Refused {
    /// The points are ordered anew: reload `info`.
    Outdated,
    Wrong(String),
}

impl From<String> for Refused {
    fn from(problem: String) -> Refused {
        Refused::Wrong(problem)
    }
}

type CloudAnswer<T> = Result<T, Refused>;

/// State of the view.
pub(super) fn info(session: &Session) -> Value {
    let (state, mut warnings) = session.state();
    let points = session.points();
    let (state, error) = match state {
        SessionState::Reading => ("reading", None),
        SessionState::Ready => ("ready", None),
        SessionState::Failed(problem) => ("failed", Some(problem)),
    };
    if points.kept_one_of() > 1 {
        warnings.push(format!(
            "only one of {} shots is shown, to stay within the memory limit; raise it with --memory-mb",
            points.kept_one_of()
        ));
    }
    let inputs: Vec<Value> = session
        .inputs
        .iter()
        .map(|viewed| {
            let shots = viewed.shots.load(std::sync::atomic::Ordering::Relaxed);
            json!({ "name": viewed.input.stem, "shots": shots })
        })
        .collect();
    let mut info = json!({
        "title": session.opened.title, "kind": session.opened.kind, "version": env!("CARGO_PKG_VERSION"),
        "state": state, "progress": session.progress(), "error": error, "warnings": warnings,
        "inputs": inputs, "generation": points.generation(), "points": points.len(),
        "kept_one_of": points.kept_one_of(), "keys": super::keys::keys(&session.opened.job),
        "flags": flags::NAMES.iter().enumerate().map(|(bit, (_, name))| json!({ "bit": bit, "name": name })).collect::<Vec<Value>>(),
        "layers": session.layers.iter().map(super::layers::RasterLayer::describe).collect::<Vec<Value>>(),
        "attributes": [], "without_waveforms": session.opened.without_waveforms,
    });
    if let Some(placing) = session.placing() {
        let [unit, height_unit] = placing.units;
        info["crs"] = placing.crs.clone().into();
        info["unit"] = unit.into();
        info["height_unit"] = height_unit.into();
        info["axes"] =
            json!([format!("east, {unit}"), format!("north, {unit}"), format!("height, {height_unit}")]);
        info["origin"] = json!(placing.origin_m);
        let described = session.described(points.generation(), || describe(&points, &placing));
        for (key, value) in described.as_object().into_iter().flatten() {
            info[key] = value.clone();
        }
    }
    info
}

/// Bounds and attributes of the points in the tree.
fn describe(points: &ViewPoints, placing: &Placing) -> Value {
    let origin_m = placing.origin_m;
    let absolute = |corner_m: [f64; 3]| [0, 1, 2].map(|i| corner_m[i] + origin_m[i]);
    let [low, high] = box_of(points.in_tree()).map(absolute);
    let [usual_low, usual_high] = usual_box(points.in_tree()).map(absolute);
    let attributes =
        ATTRIBUTES.iter().filter_map(|of| of.describe(points.in_tree(), origin_m[2], placing.units[1]));
    json!({ "min": low, "max": high, "usual_min": usual_low, "usual_max": usual_high,
            "attributes": attributes.collect::<Vec<Value>>() })
}

/// Points in the tree; an error if their generation is no longer this one.
fn current(points: &ViewPoints, generation: u32) -> CloudAnswer<&[ViewPoint]> {
    if points.generation() == generation { Ok(points.in_tree()) } else { Err(Refused::Outdated) }
}

/// All nodes.
pub(super) fn tree(session: &Session, generation: u32) -> CloudAnswer<Value> {
    let points = session.points();
    current(&points, generation)?;
    let nodes: Vec<Value> = points
        .nodes()
        .iter()
        .map(|node| {
            json!({ "level": node.level, "x": node.place[0], "y": node.place[1],
                    "first": node.points.start, "count": node.points.len(), "z": node.z_m })
        })
        .collect();
    let square = points.square();
    Ok(
        json!({ "generation": generation, "size_m": square.side_m, "corner": square.corner_m, "nodes": nodes }),
    )
}

/// Points of a range of indices.
fn range(points: &[ViewPoint], first: usize, count: usize) -> CloudAnswer<&[ViewPoint]> {
    if count > MAX_POINTS {
        return Err(format!("at most {MAX_POINTS} points at once").into());
    }
    let range = first..first.saturating_add(count);
    Ok(points.get(range).ok_or_else(|| "there are no such points".to_owned())?)
}

/// Positions, m relative to the origin, as 32-bit numbers.
pub(super) fn positions(
    session: &Session,
    generation: u32,
    first: usize,
    count: usize,
) -> CloudAnswer<Vec<u8>> {
    let points = session.points();
    let chosen = range(current(&points, generation)?, first, count)?;
    Ok(chosen.iter().flat_map(|point| point.position_m).flat_map(f32::to_le_bytes).collect())
}

/// Values of an attribute, as 32-bit numbers.
pub(super) fn values(
    session: &Session,
    generation: u32,
    first: usize,
    count: usize,
    attribute: &Attribute,
) -> CloudAnswer<Vec<u8>> {
    let origin_m = session.placing().map_or(0.0, |placing| placing.origin_m[2]);
    let points = session.points();
    let chosen = range(current(&points, generation)?, first, count)?;
    let bytes = chosen.iter().flat_map(|point| (attribute.value(point, origin_m) as f32).to_le_bytes());
    Ok(bytes.collect())
}

/// Position in the coordinates of the page, m.
fn absolute(point: &ViewPoint, placing: &Placing) -> [f64; 3] {
    std::array::from_fn(|i| f64::from(point.position_m[i]) + placing.origin_m[i])
}

/// All quantities of a point.
pub(super) fn point(session: &Session, generation: u32, index: usize) -> CloudAnswer<Value> {
    let placing = session.placing().ok_or(Refused::Outdated)?;
    let points = session.points();
    let found = range(current(&points, generation)?, index, 1)?;
    let Some(point) = found.first() else { return Err(Refused::Outdated) };
    let mut values = serde_json::Map::new();
    for attribute in &ATTRIBUTES {
        values.insert(attribute.name.to_owned(), number_or_null(attribute.value(point, placing.origin_m[2])));
    }
    Ok(json!({
        "input": point.input, "shot": point.shot, "return_number": point.return_number,
        "position": absolute(point, &placing), "values": values, "flags": names(point.flags),
    }))
}

/// Line of a profile.
pub(super) struct ProfileLine {
    /// Both ends, in the coordinates of the page.
    pub(super) ends: [[f64; 2]; 2],
    pub(super) width_m: f64,
}

/// Points within half a width of a line: distance along it, and index; with the length of the line.
fn points_of_line(
    line: &ProfileLine,
    placing: &Placing,
    points: &ViewPoints,
    all: &[ViewPoint],
) -> CloudAnswer<(Vec<(f32, u32)>, f64)> {
    let ([from, to], width_m) = (line.ends, line.width_m);
    let relative = |place: [f64; 2]| [0, 1].map(|i| place[i] - placing.origin_m[i]);
    let (from, to) = (relative(from), relative(to));
    let length_m = libm::hypot(to[0] - from[0], to[1] - from[1]);
    if !(length_m > 0.0 && length_m.is_finite() && width_m > 0.0 && width_m.is_finite()) {
        return Err("a profile needs two places and a width".to_owned().into());
    }
    let along = [0, 1].map(|i| (to[i] - from[i]) / length_m);
    let half_m = 0.5 * width_m;
    let low = [0, 1].map(|i| from[i].min(to[i]) - half_m);
    let high = [0, 1].map(|i| from[i].max(to[i]) + half_m);
    let mut found: Vec<(f32, u32)> = Vec::new();
    for index in points.near(low, high).flatten() {
        let point = &all[index];
        let offset = [0, 1].map(|i| f64::from(point.position_m[i]) - from[i]);
        let along_m = offset[0] * along[0] + offset[1] * along[1];
        let across_m = offset[1] * along[0] - offset[0] * along[1];
        if (0.0..=length_m).contains(&along_m) && across_m.abs() <= half_m {
            found.push((along_m as f32, index as u32));
        }
    }
    Ok((found, length_m))
}

/// Points within half a width of a line: distance along it, height, value and index of each.
pub(super) fn profile(
    session: &Session,
    generation: u32,
    line: &ProfileLine,
    attribute: &Attribute,
) -> CloudAnswer<Vec<u8>> {
    let placing = session.placing().ok_or(Refused::Outdated)?;
    let points = session.points();
    let all = current(&points, generation)?;
    let (found, _) = points_of_line(line, &placing, &points, all)?;
    let total = found.len();
    // Points of a node are in random order, so that every n-th is a fair sample.
    let step = total.div_ceil(MAX_PROFILE).max(1);
    let found: Vec<(f32, u32)> = found.into_iter().step_by(step).collect();
    let of = |index: u32| &all[index as usize];
    let mut bytes = Vec::with_capacity(8 + 16 * found.len());
    bytes.extend((found.len() as u32).to_le_bytes());
    bytes.extend(u32::try_from(total).unwrap_or(u32::MAX).to_le_bytes());
    bytes.extend(found.iter().flat_map(|(along_m, _)| along_m.to_le_bytes()));
    let height_m = |point: &ViewPoint| (f64::from(point.position_m[2]) + placing.origin_m[2]) as f32;
    bytes.extend(found.iter().flat_map(|&(_, index)| height_m(of(index)).to_le_bytes()));
    let value = |point: &ViewPoint| attribute.value(point, placing.origin_m[2]) as f32;
    bytes.extend(found.iter().flat_map(|&(_, index)| value(of(index)).to_le_bytes()));
    bytes.extend(found.iter().flat_map(|(_, index)| index.to_le_bytes()));
    Ok(bytes)
}

/// Number of steps in which the ground along a line is averaged.
const GROUND_STEPS: usize = 300;
/// Number of steps without ground at which its line is interrupted.
const GROUND_GAP: usize = 15;

/// Ground along a line: pairs of distance and median height of the ground points, in parts without larger gaps.
pub(super) fn ground_line(session: &Session, generation: u32, line: &ProfileLine) -> CloudAnswer<Value> {
    let placing = session.placing().ok_or(Refused::Outdated)?;
    let points = session.points();
    let all = current(&points, generation)?;
    let (found, length_m) = points_of_line(line, &placing, &points, all)?;
    let mut steps: BTreeMap<usize, Vec<(f32, f32)>> = BTreeMap::new();
    for (along_m, index) in found {
        let point = &all[index as usize];
        if point.class == Class::Ground as u8 && !point.withheld {
            let step = (f64::from(along_m) / length_m * GROUND_STEPS as f64) as usize;
            steps.entry(step).or_default().push((point.position_m[2], along_m));
        }
    }
    let (mut parts, mut last): (Vec<Vec<[f64; 2]>>, _) = (Vec::new(), None);
    for (step, mut found) in steps {
        let middle = found.len() / 2;
        let (_, (height_m, along_m), _) = found.select_nth_unstable_by(middle, |a, b| a.0.total_cmp(&b.0));
        let place = [f64::from(*along_m), f64::from(*height_m) + placing.origin_m[2]];
        match parts.last_mut().filter(|_| last.is_some_and(|last| step - last <= GROUND_GAP)) {
            Some(part) => part.push(place),
            None => parts.push(vec![place]),
        }
        last = Some(step);
    }
    Ok(json!({ "ground": parts }))
}

/// A search for points.
pub(super) struct Search {
    pub(super) sort: &'static Attribute,
    pub(super) is_descending: bool,
    pub(super) conditions: Vec<Condition>,
    /// Bit of a flag that must be set.
    pub(super) flag: Option<u16>,
    pub(super) limit: usize,
}

/// The first shots of a search, each by the point that comes first.
pub(super) fn find(session: &Session, generation: u32, search: &Search) -> CloudAnswer<Value> {
    let placing = session.placing().ok_or(Refused::Outdated)?;
    let points = session.points();
    let all = current(&points, generation)?;
    let origin_m = placing.origin_m[2];
    let is_wanted = |point: &ViewPoint| {
        search.flag.is_none_or(|bit| point.flags & bit != 0)
            && search.conditions.iter().all(|condition| condition.holds(point, origin_m))
    };
    let value = |point: &ViewPoint| {
        let value = search.sort.value(point, origin_m);
        if search.is_descending { -value } else { value }
    };
    let mut found: Vec<(f64, u32)> = (0_u32..)
        .zip(all)
        .filter(|(_, point)| is_wanted(point))
        .map(|(index, point)| (value(point), index))
        .filter(|(value, _)| value.is_finite())
        .collect();
    let total = found.len();
    let limit = search.limit.clamp(1, MAX_FOUND);
    // Several returns of a shot may come first.
    let enough = 8 * limit;
    if found.len() > enough {
        found.select_nth_unstable_by(enough, |a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        found.truncate(enough);
    }
    let identity = |index: u32| {
        let point = &all[index as usize];
        (point.input, point.shot, point.return_number)
    };
    found.sort_by(|a, b| a.0.total_cmp(&b.0).then_with(|| identity(a.1).cmp(&identity(b.1))));
    let mut seen = BTreeSet::new();
    found.retain(|&(_, index)| seen.insert((all[index as usize].input, all[index as usize].shot)));
    let entry = |&(_, index): &(f64, u32)| {
        let point = &all[index as usize];
        json!({
            "index": index, "input": point.input, "shot": point.shot, "return_number": point.return_number,
            "position": absolute(point, &placing), "value": number_or_null(search.sort.value(point, origin_m)),
        })
    };
    let found: Vec<Value> = found.iter().take(limit).map(entry).collect();
    Ok(json!({ "total": total, "found": found }))
}

/// Shots with points in a rectangle, by input.
pub(super) fn shots_within(
    session: &Session,
    generation: u32,
    [from, to]: [[f64; 2]; 2],
) -> CloudAnswer<BTreeMap<usize, BTreeSet<u64>>> {
    let placing = session.placing().ok_or(Refused::Outdated)?;
    let points = session.points();
    let all = current(&points, generation)?;
    let low = [0, 1].map(|i| from[i].min(to[i]) - placing.origin_m[i]);
    let high = [0, 1].map(|i| from[i].max(to[i]) - placing.origin_m[i]);
    let mut shots: BTreeMap<usize, BTreeSet<u64>> = BTreeMap::new();
    let mut left = MAX_SHOTS;
    let is_inside =
        |point: &&ViewPoint| (0..2).all(|i| (low[i]..=high[i]).contains(&f64::from(point.position_m[i])));
    for Range { start, end } in points.near(low, high) {
        for point in all[start..end].iter().filter(is_inside) {
            if left > 0 && shots.entry(point.input.into()).or_default().insert(point.shot) {
                left -= 1;
            }
        }
    }
    Ok(shots)
}

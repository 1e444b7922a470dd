//! Picture of a trajectory: plan view with scale bar, and height over time.

use super::map::TrajectoryMap;
use wavex_geodesy::ellipsoid::WGS84;
use wavex_geodesy::frames::LocalFrame;
use wavex_geodesy::trajectory::{Sample, Trajectory};
use wavex_pages::plot::{Anchor, AxisScale, Plot, PlotStyle, Svg, extent};

/// Layout in SVG units.
const WIDTH: f64 = 900.0;
const HEIGHT: f64 = 860.0;
const LEFT: f64 = 90.0;
const RIGHT: f64 = 874.0;
const PLAN: [f64; 2] = [70.0, 590.0];
const HEIGHTS: [f64; 2] = [650.0, 800.0];
/// Approximate maximum number of points per line.
const POINTS: usize = 4000;

/// Draws the picture as SVG.
pub(super) fn draw(title: &str, note: &str, trajectory: &Trajectory, map: &TrajectoryMap) -> String {
    let mut svg = Svg::new();
    svg.text("title", [LEFT, 30.0], Anchor::Start, title);
    svg.text("note", [LEFT, 52.0], Anchor::Start, note);
    let parts = parts(trajectory);
    plan(&mut svg, &parts, map);
    heights(&mut svg, &parts, trajectory.span_s());
    svg.finish(WIDTH, HEIGHT, title)
}

/// Parts of the trajectory between unbridged gaps, decimated.
fn parts(trajectory: &Trajectory) -> Vec<Vec<Sample>> {
    let samples = trajectory.samples();
    let every = samples.len().div_ceil(POINTS).max(1);
    let open = trajectory.gaps().iter().filter(|gap| !gap.is_bridged).map(|gap| gap.record + 1);
    let mut ends: Vec<usize> = open.collect();
    ends.push(samples.len());
    let mut start = 0;
    let mut part = |end: usize| {
        let part = samples.get(start..end).unwrap_or_default();
        start = end;
        let thinned = part.iter().step_by(every).chain(part.last());
        thinned.copied().collect::<Vec<Sample>>()
    };
    ends.into_iter().map(&mut part).collect()
}

/// Easting and northing, m: of the map, else local at the first position.
fn on_plane(sample: &Sample, map: &TrajectoryMap, horizon: &LocalFrame) -> [f64; 2] {
    let [x, y, _] = if map.is_plane() { map.project(sample.place) } else { horizon.local_of(sample.place) };
    [x, y]
}

fn plan(svg: &mut Svg, parts: &[Vec<Sample>], map: &TrajectoryMap) {
    let Some(first) = parts.first().and_then(|part| part.first()) else { return };
    let horizon = LocalFrame::at(WGS84, first.place);
    let on_plane = |part: &Vec<Sample>| part.iter().map(|sample| on_plane(sample, map, &horizon)).collect();
    let lines: Vec<Vec<[f64; 2]>> = parts.iter().map(on_plane).collect();
    let [x, y] = fitted(&lines.concat());
    let plot = plot(x, y, PLAN, 36.0);
    plot.grid_x(svg, plot.ticks_x(5.0));
    plot.grid_y(svg, plot.ticks_y(5.0));
    for line in &lines {
        plot.curve(svg, "fit", line.iter().copied());
    }
    let last = lines.last().and_then(|line| line.last());
    for (place, word, class) in
        [(lines.first().and_then(|line| line.first()), "start", "sample"), (last, "end", "left")]
    {
        let Some(place) = place.map(|place| plot.at(*place)) else { continue };
        svg.circle(class, place, 4.0);
        svg.text("num", [place[0] + 8.0, place[1] - 6.0], Anchor::Start, word);
    }
    scale_bar(svg, &plot.x);
    let whose = if map.is_plane() { "m" } else { "m from the start" };
    plot.frame(svg, &[format!("easting, {whose}"), format!("northing, {whose}")]);
}

/// Equal-scale ranges of x and y that contain all positions, with a margin.
fn fitted(places: &[[f64; 2]]) -> [[f64; 2]; 2] {
    let ranges = [0, 1].map(|axis| extent(places.iter().map(|place| place[axis])));
    let room = [RIGHT - LEFT, PLAN[1] - PLAN[0]];
    let per_unit = ranges.iter().zip(room).map(|([low, high], room)| 1.1 * (high - low).max(1.0) / room);
    let per_unit = per_unit.fold(0.0, f64::max);
    core::array::from_fn(|axis| {
        let [low, high] = ranges[axis];
        let (middle, half) = (0.5 * (low + high), 0.5 * per_unit * room[axis]);
        [middle - half, middle + half]
    })
}

/// Draws a bar of a round length, at most a quarter of the width.
fn scale_bar(svg: &mut Svg, x: &AxisScale) {
    let span_m = x.from[1] - x.from[0];
    let unit_m = 10f64.powf((0.25 * span_m).log10().floor());
    let fits = |factor: &f64| factor * unit_m <= 0.25 * span_m;
    let length_m = [5.0, 2.0, 1.0].into_iter().find(fits).unwrap_or(1.0) * unit_m;
    let [right, y] = [RIGHT - 16.0, PLAN[1] - 16.0];
    let left = right - length_m / span_m * (RIGHT - LEFT);
    svg.line("zero", [left, y], [right, y]);
    for end in [left, right] {
        svg.line("zero", [end, y - 5.0], [end, y + 5.0]);
    }
    let text = if length_m >= 1000.0 { format!("{} km", 1e-3 * length_m) } else { format!("{length_m} m") };
    svg.text("num", [0.5 * (left + right), y - 9.0], Anchor::Middle, &text);
}

fn heights(svg: &mut Svg, parts: &[Vec<Sample>], [first_s, last_s]: [f64; 2]) {
    let [low, high] = extent(parts.iter().flatten().map(|sample| sample.place.height_m));
    let margin_m = (0.08 * (high - low)).max(0.5);
    let plot = plot([0.0, last_s - first_s], [low - margin_m, high + margin_m], HEIGHTS, 38.0);
    plot.grid(svg, [7.0, 4.0]);
    for part in parts {
        let points = part.iter().map(|sample| [sample.time_s - first_s, sample.place.height_m]);
        plot.curve(svg, "fit", points);
    }
    plot.frame(svg, &["time since the first record, s", "height, m"]);
}

/// Plot between these heights; `title`: distance of the horizontal axis's title below the frame.
fn plot(x: [f64; 2], y: [f64; 2], [top, bottom]: [f64; 2], title: f64) -> Plot {
    let (x, y) = (AxisScale { from: x, to: [LEFT, RIGHT] }, AxisScale { from: y, to: [bottom, top] });
    Plot { x, y, style: PlotStyle { below: [17.0, title, 0.0], ..PlotStyle::FILE } }
}

#[cfg(test)]
mod tests {
    use std::collections::{BTreeMap, BTreeSet};

    use super::*;
    use wavex_geodesy::ellipsoid::Geodetic;
    use wavex_geodesy::frames::Attitude;

    /// Numeric labels along each edge of the picture: left of a frame, or below it.
    fn labels(svg: &str) -> BTreeMap<String, Vec<String>> {
        let mut labels: BTreeMap<String, Vec<String>> = BTreeMap::new();
        for text in svg.lines().filter(|line| line.starts_with("<text class=\"\"")) {
            let attribute = |name: &str| text.split(&format!("{name}=\"")).nth(1)?.split('"').next();
            let [Some(x), Some(y), Some(anchor)] = ["x", "y", "text-anchor"].map(attribute) else { continue };
            let Some(label) = text.split(['<', '>']).nth(2).filter(|label| label.parse::<f64>().is_ok())
            else {
                continue;
            };
            // Edges: left of the plan, left of the heights, and below each.
            let is_of_plan = y.parse::<f64>().unwrap() < PLAN[1] + 30.0;
            let edge = format!("{anchor} {is_of_plan} {}", if anchor == "end" { x } else { y });
            labels.entry(edge).or_default().push(label.to_owned());
        }
        labels
    }

    /// Flight to the north-east of a given length, climb and duration.
    fn flight(length_m: f64, climb_m: f64, duration_s: f64) -> Trajectory {
        let sample = |step: u32| {
            let part = f64::from(step) / 20.0;
            let angle_rad = part * length_m / 6.4e6;
            let place = Geodetic {
                latitude_rad: 0.8 + angle_rad,
                longitude_rad: 0.26 + angle_rad,
                height_m: 1234.5 + part * climb_m,
            };
            let attitude = Attitude { roll_rad: 0.0, pitch_rad: 0.0, heading_rad: 0.8 };
            Sample { time_s: 345_678.9 + part * duration_s, place, attitude }
        };
        Trajectory::new((0..=20).map(sample).collect()).unwrap()
    }

    #[test]
    fn no_axis_has_the_same_label_twice() {
        for length_m in [0.0, 0.3, 7.0, 450.0, 3.3e4, 8e5] {
            for climb_m in [0.0, 0.02, 0.7, 13.0, 2400.0] {
                for duration_s in [0.01, 0.4, 3.0, 61.0, 7300.0] {
                    let trajectory = flight(length_m, climb_m, duration_s);
                    for map in ["utm:33N", "EPSG:2225", "geodetic", "ecef"] {
                        let map = TrajectoryMap::of(map, None).unwrap().unwrap();
                        let labels = labels(&draw("a", "b", &trajectory, &map));
                        assert_eq!(labels.len(), 4, "{length_m} {climb_m} {duration_s}: {labels:?}");
                        for labels in labels.values() {
                            let distinct: BTreeSet<&String> = labels.iter().collect();
                            assert_eq!(
                                distinct.len(),
                                labels.len(),
                                "{length_m} {climb_m} {duration_s}: {labels:?}"
                            );
                        }
                    }
                }
            }
        }
    }
}

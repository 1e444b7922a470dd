//! Figures of a run's results: counts along the flight, histograms, map views.

use super::plot::{Plot, WIDTH, decades, label, short, ticks};
use crate::report::overview::{
    LineGroups, MapAxes, MapLine, MapPicture, Picture, QuantityHistogram, ZoneCloud, ZoneClouds,
};
use crate::report::svg::{Anchor, Scale, Svg};

/// Draws waveforms, returns and points per scan line; `None` without lines.
pub(super) fn along(groups: &LineGroups) -> Option<String> {
    let per_line = |counts: &[u64]| -> Vec<f64> {
        let each = counts.iter().zip(&groups.lines);
        each.map(|(count, lines)| *count as f64 / (*lines).max(1) as f64).collect()
    };
    // Show points only if there are any; they are the returns that are not withheld.
    let with_points = groups.points.iter().any(|points| *points > 0);
    let found = if with_points { ("points", &groups.points) } else { ("returns", &groups.returns) };
    let curves = [
        ("waveforms", "waveforms", per_line(&groups.waveforms)),
        ("returns", "returns", per_line(&groups.returns)),
        ("found", found.0, per_line(found.1)),
    ];
    let highest = curves.iter().flat_map(|(_, _, values)| values).copied().fold(1.0, f64::max);
    let width = f64::from(groups.lines_per_group);
    let until = groups.lines.len() as f64 * width;
    let plot = Plot::new([0.0, until], [0.0, 1.12 * highest]);
    let mut svg = Svg::new();
    plot.grid(&mut svg);
    let shown = curves.iter().take(if with_points { 3 } else { 2 });
    for (i, (class, name, values)) in shown.enumerate() {
        let steps = values.iter().enumerate().flat_map(|(group, value)| {
            let left = group as f64 * width;
            [[left, *value], [left + width, *value]]
        });
        svg.curve(class, steps.map(|corner| plot.at(corner)));
        let x = 86.0 + 110.0 * i as f64;
        svg.curve(class, [[x, 26.0], [x + 22.0, 26.0]].into_iter());
        svg.text("", [x + 28.0, 30.0], Anchor::Start, name);
    }
    let title = "Waveforms, returns and points per scan line";
    (!groups.lines.is_empty()).then(|| plot.finish(svg, title, "scan line", "per line"))
}

/// Fraction of the values that a histogram may cut off at either end.
const TAIL: f64 = 0.0005;

/// Draws a histogram with its statistics as text; `None` if all values are outside its bins.
pub(super) fn histogram(histogram: &QuantityHistogram) -> Option<(String, String)> {
    let on_axis = |value: f64| if histogram.logarithmic { value.log10() } else { value };
    let ends = [TAIL, 1.0 - TAIL].map(|part| histogram.quantile(part));
    let first = histogram.bins().next()?.0[0];
    let last = histogram.bins().last()?.0[1];
    let ends = [ends[0].unwrap_or(first), ends[1].unwrap_or(last)];
    let is_shown = |&([low, high], _): &([f64; 2], u64)| high > ends[0] && low < ends[1];
    let shown: Vec<([f64; 2], u64)> = histogram.bins().filter(is_shown).collect();
    let highest = shown.iter().map(|(_, count)| *count).max()?.max(1);
    let x = [on_axis(shown.first()?.0[0]), on_axis(shown.last()?.0[1])];
    // Show at least 0.15 of the axis: a single value would fill the frame.
    let room = (0.15 - 0.5 * (x[1] - x[0])).max(0.0);
    let plot = Plot::new([x[0] - room, x[1] + room], [0.0, 1.06 * highest as f64]);
    let mut svg = Svg::new();
    plot.grid_y(&mut svg, ticks(&plot.y, 4.0));
    let values = if histogram.logarithmic { decades(plot.x.from) } else { ticks(&plot.x, 6.0) };
    plot.grid_x(&mut svg, values);
    let steps = shown
        .iter()
        .flat_map(|([low, high], count)| [[on_axis(*low), *count as f64], [on_axis(*high), *count as f64]]);
    let corners = [[x[0], 0.0]].into_iter().chain(steps).chain([[x[1], 0.0]]);
    svg.area("bars", corners.map(|corner| plot.at(corner)));
    let median = histogram.quantile(0.5);
    if let Some(median) = median {
        let [at, foot] = plot.at([on_axis(median), 0.0]);
        svg.line("middle", [at, plot.y.to[1]], [at, foot]);
    }
    let unit = if histogram.unit.is_empty() { String::new() } else { format!(", {}", histogram.unit) };
    let name = format!("{}{unit}", histogram.quantity);
    Some((plot.finish(svg, &name, &name, "returns"), in_words(histogram)))
}

fn in_words(histogram: &QuantityHistogram) -> String {
    let at = |part: f64| histogram.quantile(part).map(short);
    let count = label(histogram.total() as f64, 0);
    match (at(0.05), at(0.5), at(0.95)) {
        (Some(low), Some(median), Some(high)) => {
            let unit = format!(" {}", histogram.unit);
            let unit = unit.trim_end();
            format!("{count} returns; median {median}{unit} (dashed), 90 % interval {low} to {high}{unit}")
        }
        _ => format!("{count} returns"),
    }
}

/// Maximum size of a map view, SVG units.
const MAP: [f64; 2] = [460.0, 420.0];
const MAP_LEFT: f64 = 86.0;
const MAP_TOP: f64 = 10.0;

/// Axis labels of a map view; `frame` is the frame of the input.
pub(super) fn axes(map: &MapPicture, frame: Option<&str>) -> [String; 2] {
    let names = match (map.axes, frame) {
        (MapAxes::Degrees, _) => return ["longitude, degrees", "latitude, degrees"].map(str::to_owned),
        (MapAxes::Coordinates, Some("scanner" | "body")) => ["x", "y"],
        (MapAxes::Coordinates | MapAxes::Plane, _) => ["east", "north"],
    };
    names.map(|name| format!("{name}, {}", map.unit))
}

/// Frame of a map view, with the grid of its coordinates.
struct MapFrame<'m> {
    axes: &'m [String; 2],
    plot: Plot,
}

impl<'m> MapFrame<'m> {
    fn new(map: &MapPicture, axes: &'m [String; 2]) -> MapFrame<'m> {
        let [width, height] = [map.columns, map.rows].map(|cells| f64::from(cells.max(1)));
        let [east, north] = [map.west + width * map.cell, map.south + height * map.cell];
        // A degree of longitude is shorter than a degree of latitude.
        let slimmer = match map.axes {
            MapAxes::Degrees => (0.5 * (map.south + north)).to_radians().cos().max(0.02),
            MapAxes::Coordinates | MapAxes::Plane => 1.0,
        };
        let size = (MAP[0] / (width * slimmer)).min(MAP[1] / height);
        let (right, bottom) = (MAP_LEFT + width * slimmer * size, MAP_TOP + height * size);
        let plot = Plot {
            x: Scale { from: [map.west, east], to: [MAP_LEFT, right.max(MAP_LEFT + 40.0)] },
            y: Scale { from: [map.south, north], to: [bottom.max(MAP_TOP + 40.0), MAP_TOP] },
        };
        MapFrame { axes, plot }
    }

    /// Draws the grid lines above the image.
    fn grid(&self, svg: &mut Svg) {
        let [width, height] = [self.plot.x, self.plot.y].map(|scale| (scale.to[1] - scale.to[0]).abs());
        self.plot.grid_x(svg, ticks(&self.plot.x, (width / 95.0).max(1.0)));
        self.plot.grid_y(svg, ticks(&self.plot.y, (height / 60.0).max(1.0)));
    }

    fn finish(&self, mut svg: Svg, title: &str, below: f64) -> String {
        let [x, y] = self.axes;
        self.plot.frame(&mut svg, x, y);
        svg.inline(WIDTH, self.plot.y.to[0] + 46.0 + below, title)
    }

    /// Draws the colour scale.
    fn colours(&self, svg: &mut Svg, colours: &[String], [low, high]: [f64; 2], name: &str) {
        let top = self.plot.y.to[0] + 52.0;
        let each = 180.0 / colours.len().max(1) as f64;
        for (i, colour) in colours.iter().enumerate() {
            let left = MAP_LEFT + each * i as f64;
            svg.swatch(colour, [left, top], [left + each, top + 12.0]);
        }
        svg.text("", [MAP_LEFT - 7.0, top + 10.5], Anchor::End, &short(low));
        svg.text("", [MAP_LEFT + 187.0, top + 10.5], Anchor::Start, &format!("{}   {name}", short(high)));
    }
}

/// Draws a map view coloured by one attribute.
fn coloured(
    frame: &MapFrame,
    id: &str,
    picture: &Picture,
    colours: &[String],
    range: [f64; 2],
    name: &str,
) -> String {
    let mut svg = Svg::new();
    let ([left, right], [bottom, top]) = (frame.plot.x.to, frame.plot.y.to);
    svg.image(id, &picture.data_url(), [left, top], [right, bottom]);
    frame.grid(&mut svg);
    frame.colours(&mut svg, colours, range, name);
    frame.finish(svg, &format!("Points by {name}"), 34.0)
}

/// Draws the map view coloured by height.
pub(super) fn heights(map: &MapPicture, axes: &[String; 2], id: &str) -> String {
    coloured(
        &MapFrame::new(map, axes),
        id,
        &map.heights,
        &MapPicture::height_colours(),
        map.height_range_m,
        "height, m",
    )
}

/// Draws the map view coloured by intensity; other figures reuse the image as `id`.
pub(super) fn intensities(map: &MapPicture, axes: &[String; 2], id: &str) -> String {
    coloured(
        &MapFrame::new(map, axes),
        id,
        &map.intensities,
        &MapPicture::intensity_colours(),
        map.intensity_range,
        "intensity",
    )
}

/// Draws the map view coloured by MTA zone; `None` if all points are in zone 0.
pub(super) fn zones(map: &MapPicture, axes: &[String; 2], id: &str) -> Option<String> {
    let (frame, colours) = (MapFrame::new(map, axes), MapPicture::height_colours());
    let picture = map.zones.as_ref()?;
    Some(coloured(&frame, id, picture, &colours, map.zone_range, "MTA zone"))
}

/// Cell size of one small scatter plot, SVG units.
const CLOUD: [f64; 2] = [186.0, 132.0];
/// Small scatter plots per row.
const CLOUDS_ABREAST: usize = 3;

/// Draws the same shots with each MTA zone in turn, as small scatter plots.
pub(super) fn clouds(clouds: &ZoneClouds) -> String {
    let mut svg = Svg::new();
    for (i, cloud) in clouds.clouds.iter().enumerate() {
        let left = 44.0 + (i % CLOUDS_ABREAST) as f64 * CLOUD[0];
        let top = 20.0 + (i / CLOUDS_ABREAST) as f64 * CLOUD[1];
        one_cloud(&mut svg, cloud, [left, top], [left + CLOUD[0] - 52.0, top + CLOUD[1] - 44.0]);
    }
    let rows = clouds.clouds.len().div_ceil(CLOUDS_ABREAST) as f64;
    svg.inline(WIDTH, 20.0 + rows * CLOUD[1], "Range against shot with each zone")
}

fn one_cloud(svg: &mut Svg, cloud: &ZoneCloud, [left, top]: [f64; 2], [right, bottom]: [f64; 2]) {
    let points = || cloud.points.chunks_exact(2).map(|pair| [pair[0], pair[1]]);
    let ends = |of: fn([f64; 2]) -> f64| {
        points()
            .map(of)
            .fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], value| [low.min(value), high.max(value)])
    };
    let name = match cloud.roughness_m {
        Some(roughness_m) => format!("zone {}: {} m", cloud.zone, short(roughness_m)),
        None => format!("zone {}: no range", cloud.zone),
    };
    svg.text("", [0.5 * (left + right), top - 6.0], Anchor::Middle, &name);
    let [x, y] = [ends(|point| point[0]), ends(|point| point[1])];
    if points().next().is_some() {
        let room = (0.05 * (y[1] - y[0])).max(0.5);
        let plot = Plot {
            x: Scale { from: [x[0], x[1].max(x[0] + 1.0)], to: [left, right] },
            y: Scale { from: [y[0] - room, y[1] + room], to: [bottom, top] },
        };
        plot.grid_x(svg, ticks(&plot.x, 3.0));
        plot.grid_y(svg, ticks(&plot.y, 3.0));
        points().for_each(|point| svg.circle("dot", plot.at(point), 1.1));
    }
    svg.rect("frame", [left, top], [right, bottom]);
}

/// Maximum number of scan lines drawn.
const MOST_LINES: usize = 16;

/// Draws some scan lines over the image with the id `below`.
pub(super) fn swath(map: &MapPicture, axes: &[String; 2], below: &str) -> Option<String> {
    let frame = MapFrame::new(map, axes);
    let place = |places: &[f64]| match places {
        [x, y] => Some(frame.plot.at([map.west + x * map.cell, map.south + y * map.cell])),
        _ => None,
    };
    let places = |line: &MapLine| line.places.chunks(2).filter_map(place).collect::<Vec<[f64; 2]>>();
    let lines: Vec<Vec<[f64; 2]>> = map.lines.iter().map(places).collect();
    let mut svg = Svg::new();
    svg.again("under", below);
    frame.grid(&mut svg);
    for line in lines.iter().step_by(lines.len().div_ceil(MOST_LINES).max(1)) {
        svg.curve("scan", line.iter().copied());
    }
    let middle = |line: &Vec<[f64; 2]>| line.get(line.len() / 2).copied();
    let first = lines.first().and_then(middle)?;
    svg.circle("begin", first, 5.0);
    Some(frame.finish(svg, "Swath on the map grid", 0.0))
}

/// Caption of a map view: coordinates, cell size, density.
pub(super) fn about(map: &MapPicture, coordinates: Option<&str>) -> String {
    let mut text = match (map.axes, coordinates) {
        (MapAxes::Plane, _) => {
            "Points in geocentric coordinates, projected onto a local plane at the first point".to_owned()
        }
        (_, Some(name)) => format!("Coordinates: {name}"),
        (_, None) => "Coordinates: as in the input".to_owned(),
    };
    let unit = &map.unit;
    text += &format!("; cells of {} {unit}", short(map.cell));
    if map.axes != MapAxes::Degrees {
        text += &format!(", median density {} points per {unit}²", short(map.median_density));
    }
    if map.outside > 0 {
        text += &format!("; points outside the picture: {}", label(map.outside as f64, 0));
    }
    text
}

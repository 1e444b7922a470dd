//! Figures of a run's results: counts along the flight, histograms, map views.

use crate::numbers::{label, short, with_unit};
use crate::plot::{
    Anchor, AxisScale, HEIGHTS, INTENSITIES, Legend, MapFrame, Mark, Picture, Plot, PlotStyle, Ramp, Svg,
    WIDTH, decades, extent,
};
use crate::report::overview::{
    Density, LineGroups, MapAxes, MapLine, MapPicture, QuantityHistogram, ZoneCloud, ZoneClouds,
};

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
    // Room for the legend above the curves, also with the large text of narrow screens.
    let plot = Plot::new([0.0, until], [0.0, 1.2 * highest]);
    let mut svg = plot.with_grid([6.0, 5.0]);
    let shown = curves.iter().take(if with_points { 3 } else { 2 });
    for (i, (class, name, values)) in shown.enumerate() {
        let steps = values.iter().enumerate().flat_map(|(group, value)| {
            let left = group as f64 * width;
            [[left, *value], [left + width, *value]]
        });
        plot.curve(&mut svg, class, steps);
        Legend::CURVES.entry(&mut svg, Mark::Curve(class), [104.0 + 140.0 * i as f64, 26.0], name);
    }
    let title = "Waveforms, returns and points per scan line";
    (!groups.lines.is_empty()).then(|| plot.finish(svg, title, "scan line", "per line"))
}

/// Fraction of the values that a histogram may cut off at either end.
const TAIL: f64 = 0.0005;

/// Draws a histogram with its statistics as text; `None` if all values are outside its bins.
///
/// `items`: name of the counted items.
pub(super) fn histogram(histogram: &QuantityHistogram, items: &str) -> Option<(String, String)> {
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
    plot.grid_y(&mut svg, plot.ticks_y(4.0));
    plot.grid_x(&mut svg, if histogram.logarithmic { decades(plot.x.from) } else { plot.ticks_x(6.0) });
    plot.bars(&mut svg, shown.iter().map(|(edges, count)| (edges.map(on_axis), *count as f64)), x);
    if let Some(median) = histogram.quantile(0.5) {
        plot.line_x(&mut svg, "middle", on_axis(median));
    }
    let unit = if histogram.unit.is_empty() { String::new() } else { format!(", {}", histogram.unit) };
    let name = format!("{}{unit}", histogram.quantity);
    Some((plot.finish(svg, &name, &name, items), in_words(histogram, items)))
}

fn in_words(histogram: &QuantityHistogram, items: &str) -> String {
    let at = |part: f64| histogram.quantile(part).map(short);
    let count = label(histogram.total() as f64, 0);
    match (at(0.05), at(0.5), at(0.95)) {
        (Some(low), Some(median), Some(high)) => {
            let (median, high) = (with_unit(&median, &histogram.unit), with_unit(&high, &histogram.unit));
            format!("{count} {items}; median {median} (dashed), 90 % interval {low} to {high}")
        }
        _ => format!("{count} {items}"),
    }
}

/// Axis labels of a map view; `frame` is the frame of the input.
fn axes(map: &MapPicture, frame: Option<&str>) -> [String; 2] {
    let names = match (map.axes, frame) {
        (MapAxes::Degrees, _) => return ["longitude, degrees", "latitude, degrees"].map(str::to_owned),
        (MapAxes::Coordinates, Some("scanner" | "body")) => ["x", "y"],
        (MapAxes::Coordinates | MapAxes::Plane, _) => ["east", "north"],
    };
    names.map(|name| format!("{name}, {}", map.unit))
}

/// Map views of an input.
pub(super) struct MapView<'m> {
    map: &'m MapPicture,
    frame: MapFrame,
}

impl<'m> MapView<'m> {
    /// The views of a map; `frame` is the frame of the input.
    pub(super) fn new(map: &'m MapPicture, frame: Option<&str>) -> MapView<'m> {
        let [width, height] = [map.columns, map.rows].map(|cells| f64::from(cells.max(1)));
        let [east, north] = [map.west + width * map.cell, map.south + height * map.cell];
        // A degree of longitude is shorter than a degree of latitude.
        let slimmer = match map.axes {
            MapAxes::Degrees => (0.5 * (map.south + north)).to_radians().cos().max(0.02),
            MapAxes::Coordinates | MapAxes::Plane => 1.0,
        };
        let frame = MapFrame::new([map.west, east], [map.south, north], slimmer, axes(map, frame));
        MapView { map, frame }
    }

    /// Width of each picture, SVG units.
    pub(super) fn width(&self) -> f64 {
        self.frame.width()
    }

    /// Draws the map coloured by one attribute.
    fn coloured(&self, id: &str, picture: &Picture, colours: &Ramp, range: [f64; 2], name: &str) -> String {
        let mut svg = Svg::new();
        self.frame.image(&mut svg, id, picture);
        let [low, high] = range.map(short);
        let unit = name.rsplit_once(", ").map_or(String::new(), |(_, unit)| format!(" {unit}"));
        self.frame.finish_coloured(svg, &format!("Points by {name}"), colours, [low, high + &unit])
    }

    /// Coloured by height.
    pub(super) fn heights(&self, id: &str) -> String {
        let (picture, range) = (&self.map.heights, self.map.height_range_m);
        self.coloured(id, picture, &HEIGHTS, range, "height, m")
    }

    /// Coloured by intensity; other figures reuse the image as `id`.
    pub(super) fn intensities(&self, id: &str) -> String {
        let (picture, range) = (&self.map.intensities, self.map.intensity_range);
        self.coloured(id, picture, &INTENSITIES, range, "intensity")
    }

    /// Coloured by the density of pulses or points.
    pub(super) fn density(&self, density: &Density, kind: &str, id: &str) -> String {
        let name = format!("{kind} density, per m²");
        self.coloured(id, &density.picture, &HEIGHTS, density.range_per_m2, &name)
    }

    /// Coloured by MTA zone; `None` if all points are in zone 0.
    pub(super) fn zones(&self, id: &str) -> Option<String> {
        let picture = self.map.zones.as_ref()?;
        Some(self.coloured(id, picture, &HEIGHTS, self.map.zone_range, "MTA zone"))
    }

    /// Shaded ground; `None` without ground.
    pub(super) fn ground(&self, id: &str) -> Option<String> {
        let mut svg = Svg::new();
        self.frame.image(&mut svg, id, self.map.ground.as_ref()?);
        self.frame.grid(&mut svg);
        Some(self.frame.finish(svg, "Shaded ground"))
    }

    /// Draws some scan lines over the image with the id `below`.
    pub(super) fn swath(&self, below: &str) -> Option<String> {
        let map = self.map;
        let place = |places: &[f64]| match places {
            [x, y] => Some(self.frame.plot.at([map.west + x * map.cell, map.south + y * map.cell])),
            _ => None,
        };
        let places = |line: &MapLine| line.places.chunks(2).filter_map(place).collect::<Vec<[f64; 2]>>();
        let lines: Vec<Vec<[f64; 2]>> = map.lines.iter().map(places).collect();
        let mut svg = Svg::new();
        svg.again("under", below);
        self.frame.grid(&mut svg);
        for line in lines.iter().step_by(lines.len().div_ceil(MOST_LINES).max(1)) {
            svg.curve("scan", line.iter().copied());
        }
        let middle = |line: &Vec<[f64; 2]>| line.get(line.len() / 2).copied();
        let first = lines.first().and_then(middle)?;
        svg.circle("begin", first, 5.0);
        Some(self.frame.finish(svg, "Swath on the map grid"))
    }
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
    let name = match cloud.roughness_m {
        Some(roughness_m) => format!("zone {}: {} m", cloud.zone, short(roughness_m)),
        None => format!("zone {}: no range", cloud.zone),
    };
    svg.text("", [0.5 * (left + right), top - 6.0], Anchor::Middle, &name);
    let [x, y] = [0, 1].map(|axis| extent(points().map(|point| point[axis])));
    if points().next().is_some() {
        let room = (0.05 * (y[1] - y[0])).max(0.5);
        let plot = Plot {
            x: AxisScale { from: [x[0], x[1].max(x[0] + 1.0)], to: [left, right] },
            y: AxisScale { from: [y[0] - room, y[1] + room], to: [bottom, top] },
            style: PlotStyle::RUN,
        };
        plot.grid_x(svg, plot.ticks_x(3.0));
        plot.grid_y(svg, plot.ticks_y(3.0));
        points().for_each(|point| svg.circle("dot", plot.at(point), 1.1));
    }
    svg.rect("frame", [left, top], [right, bottom]);
}

/// Maximum number of scan lines drawn.
const MOST_LINES: usize = 16;

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
    if map.outside > 0 {
        text += &format!("; points outside the picture: {}", label(map.outside as f64, 0));
    }
    text
}

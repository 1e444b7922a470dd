//! Figures of an alignment's page.

use maud::Markup;
use wavex_align::observation::Observation;

use super::residual_map::ResidualMap;
use super::{AlignReport, AlignedStrip, Knot};
use crate::numbers::{label, short};
use crate::page::figure;
use crate::plot::{HEIGHTS, Legend, Mark, Picture, Plot, Svg, Tick, decades, extent};
use crate::report::survey::DIFFERENCES;

/// Bins of the histogram of differences.
const BINS: usize = 81;
/// Most strips with a label.
const MOST_LABELS: usize = 12;
/// Most knots that a figure shows, all strips together.
const MOST_KNOTS: usize = 4000;

/// Counts of values in equal bins; values beyond the ends are counted in the outermost bins.
fn histogram(values: impl Iterator<Item = f64>, [low, high]: [f64; 2], bins: usize) -> Vec<([f64; 2], f64)> {
    let width = (high - low) / bins as f64;
    let mut counts = vec![0u64; bins];
    for value in values {
        // The cast saturates.
        let bin = ((value - low) / width).max(0.0) as usize;
        if let Some(count) = counts.get_mut(bin.min(bins - 1)) {
            *count += 1;
        }
    }
    let edge = |i: usize| low + width * i as f64;
    counts.into_iter().enumerate().map(|(i, count)| ([edge(i), edge(i + 1)], count as f64)).collect()
}

/// The smallest of 1, 2, 5, 10 and so on that is not below a value.
fn round_up(value: f64) -> f64 {
    let unit = 10f64.powf(value.max(1e-9).log10().floor());
    [1.0, 2.0, 5.0, 10.0].map(|times| times * unit).into_iter().find(|round| *round >= value).unwrap_or(value)
}

/// Differences before and after on one scale; `None` without observations.
pub(super) fn before_and_after(report: &AlignReport, observations: &[Observation]) -> Option<Markup> {
    let before_mm = || observations.iter().filter_map(|one| one.before_m.map(|m| 1e3 * m));
    let after_mm = || observations.iter().filter(|one| one.is_used).map(|one| 1e3 * one.after_m);
    let mut sizes_mm: Vec<f64> = before_mm().chain(after_mm()).map(f64::abs).collect();
    sizes_mm.sort_by(f64::total_cmp);
    let most_mm = *sizes_mm.get(sizes_mm.len().saturating_sub(1) * 98 / 100)?;
    let wide_mm = round_up(most_mm.max(1.0));
    let bins = |values: &mut dyn Iterator<Item = f64>| histogram(values, [-wide_mm, wide_mm], BINS);
    let (before, after) = (bins(&mut before_mm()), bins(&mut after_mm()));
    let highest = before.iter().chain(&after).map(|(_, count)| *count).fold(1.0, f64::max);
    // Half a pair is the lower edge: the logarithm of 0 pairs has no place.
    let decade = |count: f64| count.max(0.5).log10();
    let plot = Plot::new([-wide_mm, wide_mm], [0.5f64.log10(), decade(highest) + 0.45]);
    let mut svg = Svg::new();
    plot.grid_x(&mut svg, plot.ticks_x(6.0));
    plot.grid_y(&mut svg, decades([0.0, decade(highest)]));
    let mut legend = Vec::new();
    for (class, name, bins, is_there) in [
        ("waveforms", "before", &before, before_mm().next().is_some()),
        ("returns", "after", &after, after_mm().next().is_some()),
    ] {
        let steps = bins.iter().flat_map(|([low, high], count)| [[*low, *count], [*high, *count]]);
        if is_there {
            plot.curve(&mut svg, class, steps.map(|[x, count]| [x, decade(count)]));
            legend.push((class, name));
        }
    }
    for (i, (class, name)) in legend.iter().enumerate() {
        Legend::CURVES.entry(&mut svg, Mark::Curve(class), [110.0 + 110.0 * i as f64, 28.0], name);
    }
    let title = "Differences before and after";
    let mut words =
        "the same pairs with the start values and with the results, along the normal of the surface; the \
                     outermost bins count all beyond; rejected pairs are in the curve before only"
            .to_owned();
    if report.spread_before_m.is_none() {
        words += "; before, the strips were too far apart to be compared as strips";
    }
    Some(figure(title, plot.finish(svg, title, "difference, mm", "pairs"), &words))
}

/// Differences over their stated SDs against the normal distribution; `None` without used observations.
pub(super) fn normalised(report: &AlignReport, observations: &[Observation]) -> Option<Markup> {
    let ratios = || observations.iter().filter(|one| one.is_used).map(|one| one.after_m / one.sd_m);
    ratios().next()?;
    let wide = round_up((4.0 * report.residual_scale).max(4.0)).max(5.0);
    let bins = histogram(ratios(), [-wide, wide], 40);
    let per_sd = ratios().count() as f64 * 2.0 * wide / 40.0;
    let bins: Vec<([f64; 2], f64)> = bins.into_iter().map(|(edges, count)| (edges, count / per_sd)).collect();
    // Far from normal, the curve would flatten the bars: it is cut off.
    let least = if report.residual_scale < 3.0 { 0.4 } else { 1e-6 };
    let highest = bins.iter().map(|(_, height)| *height).fold(least, f64::max);
    let plot = Plot::new([-wide, wide], [0.0, 1.2 * highest]);
    let mut svg = plot.with_grid([6.0, 5.0]);
    plot.bars(&mut svg, bins, [-wide, wide]);
    let normal = |k: i32| {
        let x = wide * f64::from(k) / 120.0;
        [x, (-0.5 * x * x).exp() / std::f64::consts::TAU.sqrt()]
    };
    plot.curve(&mut svg, "found", (-120..=120).map(normal));
    Legend::CURVES.entry(&mut svg, Mark::Curve("found"), [110.0, 28.0], "normal distribution, SD 1");
    let title = "Normalised residuals";
    let words = format!(
        "used differences over their stated SDs; their robust SD is {}: 1 means that the stated SDs are right. The outermost \
         bins count all beyond",
        short(report.residual_scale)
    );
    Some(figure(title, plot.finish(svg, title, "difference, SDs", "share per SD"), &words))
}

/// Map of the residuals, and that of the rejected pairs if there are any.
pub(super) fn maps(report: &AlignReport, map: &ResidualMap) -> Vec<Markup> {
    let limit_m = round_up(2.0 * report.spread_after_m.unwrap_or(0.001).max(0.0005));
    let mut svg = Svg::new();
    let picture = Picture::within(&map.means_m(), map.columns, &DIFFERENCES, [-limit_m, limit_m]);
    map.frame.image(&mut svg, "residuals", &picture);
    map.rejected.iter().for_each(|place| svg.circle("rejected", map.frame.plot.at(*place), 1.6));
    let ends = [-limit_m, limit_m].map(|value_m| label(1e3 * value_m, usize::from(limit_m < 0.001)));
    let ends = [ends[0].clone(), format!("{} mm", ends[1])];
    let cell = short(map.cell_m);
    let thinned = if map.rejected.len() < report.rejected_pairs { " (some of them)" } else { "" };
    let marks = match map.rejected.is_empty() {
        true => "no pair is rejected".to_owned(),
        false => format!("red circles: rejected pairs{thinned}"),
    };
    let title = "Residuals after alignment";
    let words = format!(
        "first strip minus second along the normal, mean of the used pairs in cells of {cell} m; {marks}; blank: no used pairs"
    );
    let after = figure(title, map.frame.finish_coloured(svg, title, &DIFFERENCES, ends), &words);
    if map.rejected.is_empty() {
        return vec![after];
    }
    let mut svg = Svg::new();
    let picture = Picture::within(&map.rejected_percent(), map.columns, &HEIGHTS, [0.0, 100.0]);
    map.frame.image(&mut svg, "rejected-pairs", &picture);
    let title = "Rejected pairs";
    let ends = ["0".to_owned(), "100 % rejected".to_owned()];
    let words = format!("share of the pairs in cells of {cell} m; blank: no pairs");
    vec![after, figure(title, map.frame.finish_coloured(svg, title, &HEIGHTS, ends), &words)]
}

/// A strip at its place on the axis of all strips.
struct Placed<'r> {
    /// Number from 1.
    number: usize,
    /// Axis positions of first and last shot, s.
    span: [f64; 2],
    strip: &'r AlignedStrip,
}

/// Corrections of the trajectories with their SDs, one figure per offset; empty without corrections.
pub(super) fn corrections(report: &AlignReport) -> Vec<Markup> {
    let mut placed: Vec<Placed> = Vec::new();
    let aligned = report.strips.iter().enumerate();
    let aligned = aligned.filter(|(_, strip)| strip.pairs > 0 && !strip.knots.is_empty());
    let duration = |strip: &AlignedStrip| (strip.last_s - strip.first_s).max(1e-3);
    let total: f64 = aligned.clone().map(|(_, strip)| duration(strip)).sum();
    let gap = 0.06 * total / aligned.clone().count().max(1) as f64;
    let mut left = 0.0;
    for (k, strip) in aligned {
        let right = left + duration(strip);
        placed.push(Placed { number: k + 1, span: [left, right], strip });
        left = right + gap;
    }
    let millidegree = 1e-3f64.to_radians();
    let offsets = [
        ("North", 1e-3, "mm"),
        ("East", 1e-3, "mm"),
        ("Down", 1e-3, "mm"),
        ("Roll", millidegree, "millidegrees"),
        ("Pitch", millidegree, "millidegrees"),
        ("Heading", millidegree, "millidegrees"),
    ];
    let all = offsets.into_iter().enumerate();
    let figures = all.filter_map(|(offset, (name, unit, unit_name))| {
        of_offset(&placed, offset, unit, &format!("{name}, {unit_name}"))
    });
    figures.collect()
}

/// Value and SD of an offset in a unit.
fn offset_of(knot: &Knot, offset: usize, unit: f64) -> [f64; 2] {
    let [north, east, down] = knot.north_east_down_m;
    let [roll, pitch, heading] = knot.roll_pitch_heading_rad;
    let value = [north, east, down, roll, pitch, heading].get(offset).copied().unwrap_or(f64::NAN);
    [value / unit, knot.sds.get(offset).copied().unwrap_or(f64::NAN) / unit]
}

/// One offset of all strips side by side.
fn of_offset(placed: &[Placed], offset: usize, unit: f64, axis: &str) -> Option<Markup> {
    let knots: usize = placed.iter().map(|one| one.strip.knots.len()).sum();
    let every = knots.div_ceil(MOST_KNOTS).max(1);
    let width = placed.last()?.span[1];
    // Position, value and SD; constant up to both ends of the strip.
    let points = |one: &Placed| -> Vec<[f64; 3]> {
        let knots = one.strip.knots.iter().step_by(every);
        let point = |knot: &Knot| {
            let [value, sd] = offset_of(knot, offset, unit);
            let at = one.span[0] + (knot.time_s - one.strip.first_s);
            [at.clamp(one.span[0], one.span[1]), value, sd]
        };
        let inner: Vec<[f64; 3]> = knots.map(point).collect();
        let ends = inner.first().zip(inner.last());
        let [first, last] = ends.map_or([[0.0; 3]; 2], |(first, last)| {
            [[one.span[0], first[1], first[2]], [one.span[1], last[1], last[2]]]
        });
        [first].into_iter().chain(inner).chain([last]).collect()
    };
    let sd_of_start = |one: &Placed| one.strip.prior_sds.get(offset).copied().unwrap_or(0.0) / unit;
    let [least, most] = extent(placed.iter().map(sd_of_start));
    if most <= 0.0 {
        return None;
    }
    let of_all = placed.iter().flat_map(points);
    let [low, high] = extent(of_all.flat_map(|[_, value, sd]| [value - sd, value + sd, 0.0]));
    let room = (0.1 * (high - low)).max(0.05);
    let plot = Plot::new([0.0, width], [low - room, high + room]);
    let mut svg = Svg::new();
    plot.grid_y(&mut svg, plot.ticks_y(5.0));
    let every_label = placed.len().div_ceil(MOST_LABELS).max(1);
    let tick = |one: &Placed| -> Tick { (0.5 * (one.span[0] + one.span[1]), one.number.to_string()) };
    plot.grid_x(&mut svg, placed.iter().step_by(every_label).map(tick));
    plot.line_y(&mut svg, "zero", 0.0);
    for one in placed {
        let points = points(one);
        let upper = points.iter().map(|[x, value, sd]| [*x, value + sd]);
        let lower = points.iter().rev().map(|[x, value, sd]| [*x, value - sd]);
        svg.area("one", upper.chain(lower).map(|corner| plot.at(corner)));
        plot.curve(&mut svg, "returns", points.iter().map(|[x, value, _]| [*x, *value]));
    }
    let spread = match short(least) == short(most) {
        true => short(most),
        false => format!("{} to {}", short(least), short(most)),
    };
    let (name, unit_name) = axis.split_once(", ").unwrap_or((axis, ""));
    let words = format!("band: ± 1 SD; SD of the trajectory before: {spread} {unit_name}");
    Some(figure(name, plot.finish(svg, name, "strips by number, each along its time", axis), &words))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn histograms_count_all() {
        let values = [-9.0, -0.9, 0.1, 0.2, 9.0, f64::NAN];
        let bins = histogram(values.into_iter(), [-1.0, 1.0], 4);
        let counts: Vec<f64> = bins.iter().map(|(_, count)| *count).collect();
        // What is not a number is never drawn in the middle.
        assert_eq!(counts, [3.0, 0.0, 2.0, 1.0]);
        assert_eq!(bins[3].0, [0.5, 1.0]);
        assert_eq!([0.3, 1.0, 12.0, 60.0].map(round_up), [0.5, 1.0, 20.0, 100.0]);
    }
}

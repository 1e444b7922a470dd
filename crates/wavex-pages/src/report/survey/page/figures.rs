//! Pictures of the survey's page.

use super::super::Survey;
use super::super::mosaic::{DIFFERENCES, Pictures};
use crate::numbers::{label, short};
use crate::plot::{Anchor, HEIGHTS, MapFrame, Plot, Svg};

/// Maximum number of strips with a number in the map.
const MOST_NUMBERS: usize = 80;

/// Frame of the maps of a survey.
pub(super) fn frame(pictures: &Pictures) -> MapFrame {
    let [width, height] = pictures.size;
    let (x, y) = ([pictures.west, pictures.west + width], [pictures.north - height, pictures.north]);
    MapFrame::new(x, y, 1.0, ["east, m", "north, m"].map(str::to_owned))
}

/// Draws the number of strips per cell, gaps, and the strips' lines with their numbers.
pub(super) fn strips(survey: &Survey, pictures: &Pictures) -> String {
    let map = frame(pictures);
    let mut svg = Svg::new();
    let (picture, [low, high]) = &pictures.strips;
    map.image(&mut svg, "strips", picture);
    if let Some(gaps) = &pictures.gaps {
        map.image(&mut svg, "gaps", gaps);
    }
    let is_numbered = survey.strips.len() <= MOST_NUMBERS;
    for (i, strip) in survey.strips.iter().enumerate().filter(|(_, strip)| strip.failure.is_none()) {
        let track = strip.facts.as_ref().map_or(&[][..], |facts| &facts.track);
        map.plot.curve(&mut svg, "track", track.iter().copied());
        if let Some(middle) = track.get(track.len() / 2).filter(|_| is_numbered) {
            let [x, y] = map.plot.at(*middle);
            svg.text("strip", [x, y + 4.0], Anchor::Middle, &(i + 1).to_string());
        }
    }
    let ends = [label(*low, 0), format!("{} strips", label(*high, 0))];
    map.finish_coloured(svg, "strips per cell", &HEIGHTS, ends)
}

/// Draws the pulse density.
pub(super) fn pulses(pictures: &Pictures) -> String {
    let map = frame(pictures);
    let mut svg = Svg::new();
    let (picture, [low, high]) = &pictures.pulses;
    map.image(&mut svg, "pulses", picture);
    if let Some(below) = &pictures.below_target {
        map.image(&mut svg, "below-target", below);
    }
    let ends = [short(*low), format!("{} per m²", short(*high))];
    map.finish_coloured(svg, "pulses per m²", &HEIGHTS, ends)
}

/// Draws the height differences; `None` without any.
pub(super) fn differences(pictures: &Pictures, limit_m: f64) -> Option<String> {
    let map = frame(pictures);
    let mut svg = Svg::new();
    map.image(&mut svg, "differences", pictures.differences.as_ref()?);
    let ends = [short(-limit_m), format!("{} m", short(limit_m))];
    Some(map.finish_coloured(svg, "height difference, m", &DIFFERENCES, ends))
}

/// Draws the histogram of height differences; `None` without any.
pub(super) fn histogram(survey: &Survey) -> Option<String> {
    let limit_m = survey.limits.max_difference_rms_m;
    let histogram = &survey.difference_histogram;
    let highest = histogram.counts.iter().max().filter(|_| survey.differences.is_some())?;
    // Shows at least twice the limit, and most of the differences.
    let wide_m = survey.differences.as_ref().map_or(0.0, |of| 1.3 * of.magnitude_95_m).max(2.0 * limit_m);
    let edge = |i: usize| histogram.first_edge_m + 0.001 * i as f64;
    let bins = histogram.counts.iter().enumerate().map(|(i, count)| (edge(i), *count));
    let shown = bins.filter(|(low, _)| (-wide_m..wide_m).contains(low));
    let shown: Vec<([f64; 2], f64)> = shown.map(|(low, count)| ([low, low + 0.001], count as f64)).collect();
    let feet = [shown.first()?.0[0], shown.last()?.0[1]];
    let plot = Plot::new([-wide_m, wide_m], [0.0, 1.06 * *highest as f64]);
    let mut svg = plot.with_grid([6.0, 5.0]);
    plot.bars(&mut svg, shown, feet);
    for at_m in [-limit_m, limit_m] {
        plot.line_x(&mut svg, "limit", at_m);
    }
    Some(plot.finish(svg, "Histogram of height differences", "height difference, m", "cells"))
}

//! Pictures of the survey's page.

use super::super::Survey;
use super::super::mosaic::{Pictures, difference_colours};
use crate::report::numbers::{label, short};
use crate::report::overview::MapPicture;
use crate::report::page::map_frame::MapFrame;
use crate::report::page::plot::Plot;
use crate::report::svg::{Anchor, Svg};

/// Maximum number of strips with a number in the map.
const MOST_NUMBERS: usize = 80;

/// Frame of the maps of a survey.
pub(super) fn frame(pictures: &Pictures) -> MapFrame {
    let [width, height] = pictures.size;
    let (x, y) = ([pictures.west, pictures.west + width], [pictures.north - height, pictures.north]);
    MapFrame::new(x, y, 1.0, ["east, m", "north, m"].map(str::to_owned))
}

/// Adds grid, frame and the colour scale with its end values.
fn finish(map: &MapFrame, mut svg: Svg, colours: &[String], ends: [String; 2], name: &str) -> String {
    map.grid(&mut svg);
    map.finish(svg, name, Some((colours, ends)))
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
        svg.curve("track", track.iter().map(|place| map.plot.at(*place)));
        if let Some(middle) = track.get(track.len() / 2).filter(|_| is_numbered) {
            let [x, y] = map.plot.at(*middle);
            svg.text("strip", [x, y + 4.0], Anchor::Middle, &(i + 1).to_string());
        }
    }
    let ends = [label(*low, 0), format!("{} strips", label(*high, 0))];
    finish(&map, svg, &MapPicture::height_colours(), ends, "strips per cell")
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
    finish(
        &map,
        svg,
        &MapPicture::height_colours(),
        [short(*low), format!("{} per m²", short(*high))],
        "pulses per m²",
    )
}

/// Draws the height differences; `None` without any.
pub(super) fn differences(pictures: &Pictures, limit_m: f64) -> Option<String> {
    let map = frame(pictures);
    let mut svg = Svg::new();
    map.image(&mut svg, "differences", pictures.differences.as_ref()?);
    let ends = [short(-limit_m), format!("{} m", short(limit_m))];
    Some(finish(&map, svg, &difference_colours(), ends, "height difference, m"))
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
    let plot = Plot::new([-wide_m, wide_m], [0.0, 1.06 * *highest as f64]);
    let mut svg = Svg::new();
    plot.grid(&mut svg);
    let steps: Vec<[f64; 2]> =
        shown.flat_map(|(low, count)| [[low, count as f64], [low + 0.001, count as f64]]).collect();
    let (first, last) = (steps.first()?[0], steps.last()?[0]);
    let corners = [[first, 0.0]].into_iter().chain(steps).chain([[last, 0.0]]);
    svg.area("bars", corners.map(|corner| plot.at(corner)));
    for at_m in [-limit_m, limit_m] {
        let [x, foot] = plot.at([at_m, 0.0]);
        svg.line("limit", [x, plot.y.to[1]], [x, foot]);
    }
    Some(plot.finish(svg, "Histogram of height differences", "height difference, m", "cells"))
}

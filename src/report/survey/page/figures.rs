//! Pictures of the survey's page.

use super::super::Survey;
use super::super::mosaic::{Pictures, difference_colours};
use crate::report::overview::{MapPicture, Picture};
use crate::report::page::plot::{Plot, WIDTH, label, short, ticks};
use crate::report::svg::{Anchor, Scale, Svg};

/// Maximum size of a map view, SVG units.
const MAP: [f64; 2] = [460.0, 420.0];
const MAP_LEFT: f64 = 86.0;
const MAP_TOP: f64 = 10.0;
/// Maximum number of strips with a number in the map.
const MOST_NUMBERS: usize = 80;

/// A map view with its colours.
struct Map {
    plot: Plot,
}

impl Map {
    fn new(pictures: &Pictures) -> Map {
        let [width, height] = pictures.size;
        let size = (MAP[0] / width).min(MAP[1] / height);
        let (right, bottom) = (MAP_LEFT + width * size, MAP_TOP + height * size);
        let plot = Plot {
            x: Scale {
                from: [pictures.west, pictures.west + width],
                to: [MAP_LEFT, right.max(MAP_LEFT + 40.0)],
            },
            y: Scale {
                from: [pictures.north - height, pictures.north],
                to: [bottom.max(MAP_TOP + 40.0), MAP_TOP],
            },
        };
        Map { plot }
    }

    fn image(&self, svg: &mut Svg, id: &str, picture: &Picture) {
        let ([left, right], [bottom, top]) = (self.plot.x.to, self.plot.y.to);
        svg.image(id, &picture.data_url(), [left, top], [right, bottom]);
    }

    /// Draws grid, frame and the colour scale with its end values.
    fn finish(&self, mut svg: Svg, colours: &[String], ends: [String; 2], name: &str) -> String {
        let [width, height] = [self.plot.x, self.plot.y].map(|scale| (scale.to[1] - scale.to[0]).abs());
        self.plot.grid_x(&mut svg, ticks(&self.plot.x, (width / 95.0).max(1.0)));
        self.plot.grid_y(&mut svg, ticks(&self.plot.y, (height / 60.0).max(1.0)));
        self.plot.frame(&mut svg, "east", "north");
        let top = self.plot.y.to[0] + 52.0;
        let each = 180.0 / colours.len().max(1) as f64;
        for (i, colour) in colours.iter().enumerate() {
            let left = MAP_LEFT + each * i as f64;
            svg.swatch(colour, [left, top], [left + each, top + 12.0]);
        }
        let [low, high] = ends;
        svg.text("", [MAP_LEFT - 7.0, top + 10.5], Anchor::End, &low);
        svg.text("", [MAP_LEFT + 187.0, top + 10.5], Anchor::Start, &format!("{high}   {name}"));
        svg.inline(WIDTH, self.plot.y.to[0] + 80.0, name)
    }
}

/// Draws the number of strips per cell, gaps, and the strips' lines with their numbers.
pub(super) fn strips(survey: &Survey, pictures: &Pictures) -> String {
    let map = Map::new(pictures);
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
    let ends = [*low, *high].map(|value| label(value, 0));
    map.finish(svg, &MapPicture::height_colours(), ends, "strips per cell")
}

/// Draws the pulse density.
pub(super) fn pulses(pictures: &Pictures) -> String {
    let map = Map::new(pictures);
    let mut svg = Svg::new();
    let (picture, [low, high]) = &pictures.pulses;
    map.image(&mut svg, "pulses", picture);
    if let Some(below) = &pictures.below_target {
        map.image(&mut svg, "below-target", below);
    }
    map.finish(svg, &MapPicture::height_colours(), [*low, *high].map(short), "pulses per m²")
}

/// Draws the height differences; `None` without any.
pub(super) fn differences(pictures: &Pictures, limit_m: f64) -> Option<String> {
    let map = Map::new(pictures);
    let mut svg = Svg::new();
    map.image(&mut svg, "differences", pictures.differences.as_ref()?);
    let ends = [-limit_m, limit_m].map(short);
    Some(map.finish(svg, &difference_colours(), ends, "height difference, m"))
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

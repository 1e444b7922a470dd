//! Text summary of a trajectory.

use std::fmt::Write;

use super::map::TrajectoryMap;
use wavex_geodesy::ellipsoid::WGS84;
use wavex_geodesy::time_axis::{Clock, TimeSpan};
use wavex_geodesy::trajectory::{Accuracy, Sample, Trajectory};
use wavex_pages::plot::extent;

/// Maximum number of gaps listed individually.
const GAPS_TOLD: usize = 5;

/// Properties of the file: name, format, time scale, clock, accuracies, notes, file of applied corrections.
pub(super) struct About<'a> {
    pub(super) file: String,
    pub(super) format: &'a str,
    pub(super) counts: &'a str,
    pub(super) clock: Clock,
    pub(super) accuracies: &'a [Accuracy],
    pub(super) notes: &'a [String],
    pub(super) corrections: Option<String>,
}

/// Returns the summary; each line ends with a line feed.
pub(super) fn text(about: &About, trajectory: &Trajectory, map: &TrajectoryMap) -> String {
    let samples = trajectory.samples();
    let mut text = format!("{}: {}, {} records\n", about.file, about.format, samples.len());
    let mut row = |name: &str, value: String| {
        let _ = writeln!(text, "  {name:<10} {value}");
    };
    let [first_s, last_s] = trajectory.span_s();
    row("clock", about.counts.to_owned());
    row("times", TimeSpan { clock: about.clock, first_s, last_s }.to_string());
    row("duration", format!("{:.3} s", last_s - first_s));
    let step_s = trajectory.median_step_s();
    row("rate", format!("{:.2} Hz, one record every {:.3} ms", 1.0 / step_s, 1e3 * step_s));
    row("gaps", gaps(trajectory));
    for gap in trajectory.gaps().iter().take(GAPS_TOLD) {
        let bridged = if gap.is_bridged { "bridged" } else { "no poses in it" };
        row("", format!("{:.3} s after {:.3} s: {bridged}", gap.length_s(), gap.between_s[0]));
    }
    let degrees = |of: fn(&Sample) -> f64| extent(samples.iter().map(|sample| of(sample).to_degrees()));
    row("latitude", span(degrees(|s| s.place.latitude_rad), 7));
    row("longitude", span(longitudes(samples), 7));
    row("height", format!("{} m", span(extent(samples.iter().map(|s| s.place.height_m)), 2)));
    row("roll", span(degrees(|s| s.attitude.roll_rad), 2));
    row("pitch", span(degrees(|s| s.attitude.pitch_rad), 2));
    let length_m = length_m(samples);
    row("path", format!("{:.3} km, {:.1} m/s", 1e-3 * length_m, length_m / (last_s - first_s)));
    row("map", map.name().to_owned());
    let places: Vec<[f64; 3]> = samples.iter().map(|sample| map.project(sample.place)).collect();
    for (axis, name) in ["x", "y", "z"].into_iter().enumerate() {
        row(name, span(extent(places.iter().map(|place| place[axis])), map.digits().min(7)));
    }
    if !about.accuracies.is_empty() {
        row("accuracy", accuracy(about.accuracies));
    }
    if let Some(file) = &about.corrections {
        row("corrected", format!("by {file}"));
    }
    for note in about.notes {
        row("note", note.clone());
    }
    text
}

fn gaps(trajectory: &Trajectory) -> String {
    let gaps = trajectory.gaps();
    let open = gaps.iter().filter(|gap| !gap.is_bridged).count();
    let longest_s = gaps.iter().map(|gap| gap.length_s()).fold(0.0, f64::max);
    match gaps.len() {
        0 => "none".to_owned(),
        count => format!(
            "{count}, the longest {longest_s:.3} s; {open} exceed the {:.3} s limit of bridging",
            trajectory.longest_bridged_s()
        ),
    }
}

fn span([low, high]: [f64; 2], digits: usize) -> String {
    format!("{low:.digits$} to {high:.digits$}")
}

/// West and east end, degrees.
///
/// The east end exceeds 180 degrees if the path crosses the antimeridian.
fn longitudes(samples: &[Sample]) -> [f64; 2] {
    let mut last_deg = samples.first().map_or(0.0, |sample| sample.place.longitude_rad.to_degrees());
    extent(samples.iter().map(|sample| {
        let step_deg = sample.place.longitude_rad.to_degrees() - last_deg;
        last_deg += step_deg - 360.0 * (step_deg / 360.0).round();
        last_deg
    }))
}

fn length_m(samples: &[Sample]) -> f64 {
    let mut places = samples.iter().map(|sample| WGS84.ecef_of(sample.place));
    let Some(mut last) = places.next() else { return 0.0 };
    let mut length_m = 0.0;
    for place in places {
        length_m += place.iter().zip(last).map(|(a, b)| (a - b) * (a - b)).sum::<f64>().sqrt();
        last = place;
    }
    length_m
}

/// Maximum standard deviations as text.
fn accuracy(accuracies: &[Accuracy]) -> String {
    let largest = |of: fn(&Accuracy) -> f64| accuracies.iter().map(of).fold(0.0, f64::max);
    format!(
        "{} records, maximum SD {:.3} m north, {:.3} m east, {:.3} m down, {:.4} roll, {:.4} pitch, {:.4} degrees heading",
        accuracies.len(),
        largest(|a| a.position_sd_m[0]),
        largest(|a| a.position_sd_m[1]),
        largest(|a| a.position_sd_m[2]),
        largest(|a| a.attitude_sd_rad[0].to_degrees()),
        largest(|a| a.attitude_sd_rad[1].to_degrees()),
        largest(|a| a.attitude_sd_rad[2].to_degrees())
    )
}

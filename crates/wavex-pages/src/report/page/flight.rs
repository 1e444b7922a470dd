//! Times, scan angles and trajectory on a run's page.

use std::collections::BTreeMap;

use maud::Markup;

use super::results;
use crate::numbers::{label, short};
use crate::page::{PagePart, figure, figures};
use crate::plot::{Legend, Mark, Plot, extent};
use crate::report::overview::{Flight, Overview, TimeCoverage};
use crate::verdict;

/// Waveforms along the flight, shots over time, scan angles, attitude, speed and height.
pub(super) fn part(overview: &Overview) -> PagePart {
    let mut drawn: Vec<Markup> = Vec::new();
    let words = match overview.lines.lines_per_group {
        0 | 1 => String::new(),
        lines => format!("means over {lines} lines"),
    };
    let along = results::along(&overview.lines);
    drawn.extend(along.map(|svg| figure("Waveforms and returns along the flight", svg, &words)));
    if let Some(times) = &overview.times {
        let words = format!(
            "longest time without shots: {} s, in bins of {} s",
            short(times.longest_gap_s()),
            short(times.bin_s)
        );
        drawn.push(figure("Shots over time", shots_over_time(times), &words));
    }
    let angles = overview.points.as_ref().and_then(|points| points.scan_angles.as_ref());
    if let Some((svg, words)) = angles.and_then(|angles| results::histogram(angles, "shots")) {
        drawn.push(figure("Scan angle", svg, &words));
    }
    let mut checks = Vec::new();
    if let Some(times) = &overview.times {
        checks.push(verdict::TIME_GAP.check(Some(times.longest_gap_s()), times.shots.iter().sum()));
    }
    if let Some(flight) = &overview.flight {
        drawn.extend(of_trajectory(flight));
        checks.push(verdict::TRAJECTORY_GAP.check(Some(flight.longest_gap_s), flight.records));
        let roll_deg = flight.roll_range_deg.map(f64::abs);
        checks.push(verdict::ROLL.check(Some(roll_deg[0].max(roll_deg[1])), flight.records));
    }
    PagePart::new("Times and flight", figures(&drawn)).judged(checks)
}

/// Maximum number of bars of the shots over time.
const MOST_BARS: u64 = 120;

/// Draws the rate of shots; empty bins are gaps.
fn shots_over_time(times: &TimeCoverage) -> String {
    let last = times.bins.last().copied().unwrap_or(0).saturating_add(1);
    let bins_per_bar = last.div_ceil(MOST_BARS).max(1);
    let mut bars: BTreeMap<u64, u64> = BTreeMap::new();
    for (bin, shots) in times.bins.iter().zip(&times.shots) {
        *bars.entry(bin / bins_per_bar).or_default() += shots;
    }
    let bar_s = times.bin_s * bins_per_bar as f64;
    let rate = |shots: u64| shots as f64 / bar_s;
    let highest = bars.values().map(|shots| rate(*shots)).fold(1.0, f64::max);
    let from = (times.span_s[0] / times.bin_s).floor() * times.bin_s - times.span_s[0];
    let plot = Plot::new([from, from + last as f64 * times.bin_s], [0.0, 1.06 * highest]);
    let mut svg = plot.with_grid([6.0, 5.0]);
    for (bar, shots) in bars {
        let left = from + bar as f64 * bar_s;
        let [[x0, y0], [x1, y1]] = [plot.at([left, rate(shots)]), plot.at([left + bar_s, 0.0])];
        svg.rect("bars", [x0, y0], [x1.max(x0 + 0.5), y1]);
    }
    plot.finish(svg, "Shots over time", "time since the first shot, s", "shots per second")
}

/// Attitude, heading, speed and height of the trajectory during the recording.
fn of_trajectory(flight: &Flight) -> [Markup; 3] {
    let span = |[low, high]: [f64; 2], unit: &str| format!("{} to {}{unit}", short(low), short(high));
    let attitude = [("returns", "roll", &flight.roll_deg), ("found", "pitch", &flight.pitch_deg)];
    let words =
        format!("roll {}, pitch {}", span(flight.roll_range_deg, "°"), span(flight.pitch_range_deg, "°"));
    let speed = [("returns", "", &flight.speed_mps)];
    let height = [("returns", "", &flight.height_m)];
    [
        figure("Attitude", curves(&flight.times_s, &attitude, "angle, degrees"), &words),
        figure("Speed", curves(&flight.times_s, &speed, "speed, m/s"), &span(flight.speed_range_mps, " m/s")),
        figure(
            "Height of the flight",
            curves(&flight.times_s, &height, "height, m"),
            &format!(
                "{} to {} m above the ellipsoid",
                label(flight.height_range_m[0], 1),
                label(flight.height_range_m[1], 1)
            ),
        ),
    ]
}

/// Draws quantities over time: class, name and values of each.
fn curves(times_s: &[f64], curves: &[(&str, &str, &Vec<f64>)], axis: &str) -> String {
    let [low, high] = extent(curves.iter().flat_map(|(_, _, values)| values.iter().copied()));
    let room = (0.08 * (high - low)).max(1e-3 * high.abs()).max(0.05);
    // Room for the legend above the curves.
    let above = if curves.len() > 1 { 4.0 * room } else { room };
    let plot = Plot::new([0.0, times_s.last().copied().unwrap_or(0.0).max(1e-3)], [low - room, high + above]);
    let mut svg = plot.with_grid([6.0, 5.0]);
    for (i, (class, name, values)) in curves.iter().enumerate() {
        plot.curve(
            &mut svg,
            class,
            times_s.iter().zip(values.iter()).map(|(time_s, value)| [*time_s, *value]),
        );
        if !name.is_empty() {
            Legend::CURVES.entry(&mut svg, Mark::Curve(class), [110.0 + 110.0 * i as f64, 28.0], name);
        }
    }
    plot.finish(svg, axis, "time since the first shot, s", axis)
}

//! One shot with a large footprint: its waveform over height, ground and relative heights.

use std::fmt::Write;

use super::table::{columns, counted, wrapped};
use crate::plot::{Anchor, AxisScale, Legend, Mark, Plot, PlotStyle, Svg, extent};
use wavex_line::scan_line::footprint_flags;
use wavex_simd::statistics::WithSd;
use wavex_stages::process::measure_footprints::SeenFootprint;

/// Relative heights of table and picture.
const SHOWN: [usize; 6] = [10, 25, 50, 75, 98, 100];
/// Layout in SVG units.
const TOP: f64 = 84.0;
const BOTTOM: f64 = 624.0;
const HEIGHT: f64 = 676.0;
const WAVEFORM: [f64; 2] = [70.0, 590.0];
const HEIGHTS: [f64; 2] = [700.0, 1000.0];
const WIDTH: f64 = 1030.0;
/// Shown above and below the signal, m.
const MARGIN_M: f64 = 10.0;

/// A shot of a large footprint with its measurement.
pub struct ExplainedFootprint {
    /// Path of the recording.
    pub file: String,
    /// The shot.
    pub seen: SeenFootprint,
}

impl ExplainedFootprint {
    /// Number and beam of the shot, name of the recording.
    pub fn title(&self) -> String {
        let name = std::path::Path::new(&self.file).file_name();
        let name = name.map_or_else(|| self.file.clone(), |name| name.to_string_lossy().into_owned());
        self.title_of(&name)
    }

    fn title_of(&self, file: &str) -> String {
        let SeenFootprint { emission, input, footprint, .. } = &self.seen;
        let time = if emission.gps_time_s.is_nan() {
            String::new()
        } else {
            format!(", GPS time {:.6} s", emission.gps_time_s)
        };
        let beam = input.beam.as_ref().map_or_else(String::new, |beam| format!(", {beam}"));
        let modes = counted(footprint.modes as usize, "mode");
        format!("shot {} of {file}{beam}{time}: {modes}", footprint.shot_number)
    }

    /// Ground, canopy, relative heights and modes as text, in lines of at most this many characters, if it is given.
    pub fn table_within(&self, width: Option<usize>) -> String {
        let width = width.unwrap_or(usize::MAX);
        let text = format!(
            "{}\n\n{}\n{}\n{}",
            self.title_of(&self.file),
            self.quantities(),
            self.modes(),
            self.remarks()
        );
        text.lines()
            .map(|line| if line.contains("  ") { format!("{line}\n") } else { wrapped(line, width) })
            .collect()
    }

    fn quantities(&self) -> String {
        let found = &self.seen.footprint;
        let height = |percent: usize| WithSd {
            value: found.heights_m.get(percent).copied().map_or(f64::NAN, f64::from),
            sd: found.heights_sd_m.get(percent).copied().map_or(f64::NAN, f64::from),
        };
        let mut rows = vec![
            ["ground, range from the first sample, m".to_owned(), with_sd(found.ground_range_m, 3)],
            ["ground, probability".to_owned(), number(found.ground_probability, 2)],
            ["ground, standard deviation with the choice, m".to_owned(), number(found.ground_total_sd_m, 3)],
        ];
        if !found.second_ground_probability.is_nan() {
            rows.extend([
                [
                    "second ground, height above the first, m".to_owned(),
                    with_sd(found.second_ground_height_m, 2),
                ],
                ["second ground, probability".to_owned(), number(found.second_ground_probability, 2)],
            ]);
        }
        let ground_m = self.seen.height_above_ellipsoid_m(found.ground_range_m.value);
        rows.extend(
            ground_m.map(|height| ["ground, height above the ellipsoid, m".to_owned(), number(height, 3)]),
        );
        rows.extend(SHOWN.iter().map(|&percent| [format!("RH{percent}, m"), with_sd(height(percent), 2)]));
        rows.extend([
            ["energy of the ground, part".to_owned(), with_sd(found.ground_energy_ratio, 3)],
            ["cover".to_owned(), with_sd(found.cover, 3)],
            ["plant area index".to_owned(), with_sd(found.plant_area_index, 2)],
            ["sensitivity".to_owned(), number(found.sensitivity, 3)],
            ["deviation of the waveform, standard deviations".to_owned(), number(found.deviation, 2)],
        ]);
        columns(&rows)
    }

    fn modes(&self) -> String {
        let head = ["mode", "height, m", "range, m", "amplitude, DN"].map(str::to_owned);
        let rows = self.seen.modes.iter().map(|mode| {
            [
                mode.return_number.to_string(),
                number(self.seen.height_m(mode.range_m), 2),
                with_sd(WithSd { value: mode.range_m, sd: mode.range_sd_m }, 3),
                with_sd(WithSd { value: mode.amplitude_dn, sd: mode.amplitude_sd_dn }, 2),
            ]
        });
        columns(&[head].into_iter().chain(rows).collect::<Vec<_>>())
    }

    fn remarks(&self) -> String {
        let mut text = String::new();
        for said in said(self.seen.footprint.flags) {
            let _ = writeln!(text, "{said}");
        }
        let SeenFootprint { model, samples_dn, .. } = &self.seen;
        let _ = writeln!(
            text,
            "waveform: {} of {} ns, background {:.2} DN",
            counted(samples_dn.len(), "sample"),
            model.sampling_interval_ns,
            self.seen.background_dn()
        );
        let _ = writeln!(
            text,
            "beam, from {}: outgoing pulse of {:.1} ns, noise of {:.2} DN",
            counted(model.shots as usize, "shot"),
            model.pulse_fwhm_ns,
            model.noise_sd_dn
        );
        text
    }

    /// Waveform with modes, ground and relative heights, and the relative heights with their standard deviations, as SVG.
    pub fn picture(&self) -> String {
        let mut svg = Svg::new();
        svg.text("title", [WAVEFORM[0], 32.0], Anchor::Start, &self.title());
        let found = &self.seen.footprint;
        let note = format!(
            "ground at a range of {} m, probability {} · cover {} · sensitivity {}",
            with_sd(found.ground_range_m, 3),
            number(found.ground_probability, 2),
            with_sd(found.cover, 2),
            number(found.sensitivity, 3)
        );
        svg.text("note", [WAVEFORM[0], 54.0], Anchor::Start, &note);
        let y = AxisScale { from: self.shown_m(), to: [BOTTOM, TOP] };
        self.waveform(&mut svg, y);
        self.heights(&mut svg, y);
        svg.finish(WIDTH, HEIGHT, &self.title())
    }

    /// Lowest and highest height of the picture, m: the signal with a margin, or all samples without a ground.
    fn shown_m(&self) -> [f64; 2] {
        let ends = [0, self.seen.samples_dn.len().saturating_sub(1)].map(|k| self.height_of(k));
        let [lowest, highest] = extent(ends.into_iter());
        // Without a ground they are NaN, which `max` and `min` pass over.
        let [bottom_m, top_m] = [0, 100].map(|percent| f64::from(self.seen.footprint.heights_m[percent]));
        [(bottom_m - MARGIN_M).max(lowest), (top_m + MARGIN_M).min(highest)]
    }

    /// Height of a sample, m.
    fn height_of(&self, sample: usize) -> f64 {
        self.seen.height_m(self.seen.first_range_m + self.seen.range_step_m * sample as f64)
    }

    fn waveform(&self, svg: &mut Svg, y: AxisScale) {
        let seen = &self.seen;
        let background_dn = seen.background_dn();
        let points = || {
            let shown = move |(k, dn): (usize, &f32)| [f64::from(*dn) - background_dn, self.height_of(k)];
            seen.samples_dn.iter().enumerate().map(shown)
        };
        let [low, high] = extent(points().map(|[dn, _]| dn));
        let x = AxisScale {
            from: [low.min(0.0) - 0.03 * (high - low), high + 0.08 * (high - low)],
            to: WAVEFORM,
        };
        let plot = Plot { x, y, style: PlotStyle::FILE };
        plot.grid(svg, [6.0, 10.0]);
        let [bottom_m, top_m] = y.from;
        let within = |height: f64| (bottom_m..=top_m).contains(&height);
        let ground = &seen.footprint.ground_range_m;
        if !ground.value.is_nan() {
            let sd_m = seen.height_per_range * ground.sd;
            if sd_m.is_finite() {
                let [low, high] = [-sd_m, sd_m].map(|height| plot.at([0.0, height])[1]);
                svg.rect("one", [x.to[0], high], [x.to[1], low]);
            }
            plot.line_y(svg, "limit", 0.0);
            for (percent, height_m) in self.relative().filter(|(_, height_m)| within(*height_m)) {
                plot.line_y(svg, "level", height_m);
                svg.text(
                    "num",
                    [x.to[1] + 6.0, y.at(height_m) + 4.0],
                    Anchor::Start,
                    &format!("RH{percent}"),
                );
            }
        }
        plot.line_x(svg, "zero", 0.0);
        plot.curve(svg, "fit", points().filter(|[_, height]| within(*height)));
        for mode in &seen.modes {
            let height = seen.height_m(mode.range_m);
            if within(height) {
                svg.circle("sat", plot.at([mode.amplitude_dn, height]), 4.5);
            }
        }
        let zero = if ground.value.is_nan() {
            "height above the first sample, m"
        } else {
            "height above the ground, m"
        };
        plot.frame(svg, &["digitiser steps above the background, DN", zero]);
        let marks = [
            (Mark::Curve("fit"), "waveform"),
            (Mark::Dot("sat"), "mode, smoothed"),
            (Mark::Line("limit"), "ground"),
            (Mark::Band("one"), "± 1 standard deviation"),
        ];
        for (i, (mark, text)) in marks.into_iter().enumerate() {
            Legend::FILE.entry(svg, mark, [WAVEFORM[0] + 140.0 * i as f64, TOP - 14.0], text);
        }
    }

    /// The relative heights of the picture: percent and metres.
    fn relative(&self) -> impl Iterator<Item = (usize, f64)> {
        let heights_m = &self.seen.footprint.heights_m;
        SHOWN.into_iter().filter_map(|percent| Some((percent, f64::from(*heights_m.get(percent)?))))
    }

    /// Height over percent of energy.
    fn heights(&self, svg: &mut Svg, y: AxisScale) {
        let plot = Plot {
            x: AxisScale { from: [0.0, 100.0], to: HEIGHTS },
            y,
            style: PlotStyle { title_x: HEIGHTS[0] - 46.0, ..PlotStyle::FILE },
        };
        plot.grid(svg, [5.0, 10.0]);
        let found = &self.seen.footprint;
        let with_sds = || {
            found
                .heights_m
                .iter()
                .zip(found.heights_sd_m.iter())
                .enumerate()
                .filter(|(_, (height, _))| !height.is_nan())
        };
        let side = |sign: f32| {
            with_sds()
                .map(move |(percent, (height, sd))| {
                    let sd = if sd.is_finite() { *sd } else { 0.0 };
                    [percent as f64, f64::from(height + sign * sd)]
                })
                .collect::<Vec<_>>()
        };
        let around = side(-1.0).into_iter().chain(side(1.0).into_iter().rev());
        svg.area("one", around.map(|point| plot.at(point)));
        plot.curve(svg, "fit", with_sds().map(|(percent, (height, _))| [percent as f64, f64::from(*height)]));
        plot.frame(svg, &["energy from below, %", "relative height, m"]);
    }
}

/// What flags mean for a reader of the results.
fn said(flags: u8) -> impl Iterator<Item = &'static str> {
    let texts = [
        (
            footprint_flags::GROUND_MISSING,
            "no ground: no mode is significant, or the signal continues behind the last sample",
        ),
        (footprint_flags::TOP_MISSING, "no top: the signal begins before the first sample"),
        (footprint_flags::CLIPPED, "samples are clipped: amplitudes and energies are too small"),
        (footprint_flags::AMBIGUOUS, "the ground has a probability below 0.9: a layer may hide it"),
        (
            footprint_flags::DEGRADED,
            "the instrument advises against this shot (degraded pointing or stale waveform)",
        ),
    ];
    texts.into_iter().filter(move |(flag, _)| flags & flag != 0).map(|(_, text)| text)
}

fn number(value: f64, digits: usize) -> String {
    if value.is_nan() { "unknown".to_owned() } else { format!("{value:.digits$}") }
}

fn with_sd(value: WithSd, digits: usize) -> String {
    if value.value.is_nan() {
        "unknown".to_owned()
    } else {
        format!("{:.digits$} ± {}", value.value, number(value.sd, digits))
    }
}

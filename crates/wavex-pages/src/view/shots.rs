//! Answers about shots: their fit, and the picture of their scan line.

use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use serde_json::{Value, json};

use super::compare::changes;
use super::lines::{InputLines, measures_footprints};
use super::placed::{PlacedReturn, placed, text};
use super::session::{Placing, Session};
use crate::explain::{ExplainError, ExplainedFootprint, ExplainedShot};
use wavex_engine::job::Job;
use wavex_line::scan_line::{Block, Channel, Content, Emission, ScanLine, flags};
use wavex_simd::statistics::median;
use wavex_stages::process::measure_footprints::MeasureFootprints;

/// Limit of the rows of a picture of a scan line.
const MAX_ROWS: usize = 2000;

/// A shot with the keys of the job, and its difference by other keys.
pub(super) fn shot(session: &Session, input: usize, shot: u64, set: &[String]) -> Result<Value, String> {
    if let Some(measure) = measures_footprints(&session.opened.job).map_err(text)? {
        return footprint(session, input, shot, &measure);
    }
    let (base, chosen, placing) = (session.with(&[])?, session.with(set)?, session.placing());
    let placing = placing.as_ref();
    session.with_lines(input, |lines| {
        let number = place(lines, shot)?;
        let around = lines_around(lines, number);
        let file = session.inputs[input].input.path.display().to_string();
        let file = if file.is_empty() { session.inputs[input].input.stem.clone() } else { file };
        let simd = lines.simd();
        let before = lines.before_decompose(&chosen.job, number..number + 1).map_err(text)?;
        let Some(line) = before.first() else { return Err(format!("shot {shot}: its line cannot be read")) };
        let place = line.emissions.iter().position(|emission| emission.shot == shot);
        let InLine { of_line, previous, next } = InLine::of(line, shot, around);
        let explained = match ExplainedShot::of(line, shot, &chosen.decompose, simd, &file) {
            Ok(explained) => explained,
            Err(ExplainError::Stage(error)) => return Err(error.to_string()),
            // The page can go on to the next shot.
            Err(ExplainError::Without(problem)) => {
                let emission = place.and_then(|place| line.emissions.get(place));
                let gps_time_s = emission.map_or(f64::NAN, |emission| emission.gps_time_s);
                let none: [Value; 0] = [];
                return Ok(json!({
                    "input": input, "shot": shot, "gps_time_s": number_or_null(gps_time_s), "problem": problem,
                    "title": format!("shot {shot}"), "text": "", "svg": null,
                    "line": of_line, "previous": previous, "next": next,
                    "returns": none, "instrument": none, "blocks": none, "difference": null,
                }));
            }
        };
        let online: Vec<Value> = line.blocks().map_or(Vec::new(), |blocks| {
            let of_shot = blocks.online.iter().filter(|online| Some(online.emission as usize) == place);
            let velocity_m_per_ns = line.input.group_velocity_mps * 1e-9;
            of_shot
                .map(|online| {
                    let flight_ns = online.time_ns - explained.emission.emission_ns;
                    json!({ "time_of_flight_ns": flight_ns, "range_m": 0.5 * flight_ns * velocity_m_per_ns,
                            "amplitude_dn": number_or_null(online.amplitude.into()) })
                })
                .collect()
        });
        let after = returns_of(lines, &chosen.job, number, shot, placing)?;
        let difference = match set {
            [] => Value::Null,
            _ => {
                let before = returns_of(lines, &base.job, number, shot, placing)?;
                let changes: Vec<Value> = changes(&before, &after)
                    .iter()
                    .map(|change| {
                        json!({ "change": change.kind, "moved_m": change.moved_m,
                                "before": change.before.map(return_value), "after": change.after.map(return_value) })
                    })
                    .collect();
                json!({ "before": before.len(), "after": after.len(), "changes": changes })
            }
        };
        let blocks: Vec<Value> = explained.blocks.iter().map(|block| {
            let (shown, samples) = (&block.shown, &block.shown.samples);
            json!({ "channel": shown.channel, "first_ns": shown.first_ns, "interval_ns": samples.interval_ns,
                    "chi_square": number_or_null(shown.chi_square), "degrees_of_freedom": shown.degrees_of_freedom,
                    "samples_dn": samples.samples_dn, "used": samples.used, "residual": samples.residual,
                    "background_dn": samples.background_dn, "full_scale_dn": samples.full_scale_dn,
                    "peaks": shown.peaks.iter().map(|peak| peak.position_samples).collect::<Vec<f64>>() })
        }).collect();
        let table = explained.table();
        Ok(json!({
            "input": input, "shot": shot, "gps_time_s": number_or_null(explained.emission.gps_time_s), "problem": null,
            "title": explained.title(), "text": table, "svg": explained.picture(),
            "line": of_line, "previous": previous, "next": next,
            "returns": after.iter().map(return_value).collect::<Vec<Value>>(),
            "instrument": online, "blocks": blocks, "difference": difference,
        }))
    })
}

/// A shot with a large footprint.
fn footprint(
    session: &Session,
    input: usize,
    shot: u64,
    measure: &MeasureFootprints,
) -> Result<Value, String> {
    let placing = session.placing();
    session.with_lines(input, |lines| {
        let number = place(lines, shot)?;
        let around = lines_around(lines, number);
        let job = session.job()?;
        let first = lines.first_of_beam(number, measure.shots).map_err(text)?;
        let found = lines.with_footprints(&job, &first, number..number + 1).map_err(text)?;
        let found = returns_in(&found, shot, placing.as_ref());
        let run = lines.run().clone();
        let before = lines.before_decompose(&job, number..number + 1).map_err(text)?;
        let Some(line) = before.first() else { return Err(format!("shot {shot}: its line cannot be read")) };
        let InLine { of_line, previous, next } = InLine::of(line, shot, around);
        let index = line.emissions.iter().position(|emission| emission.shot == shot);
        let seen = measure.seen(&run, &first, line, index.unwrap_or_default() as u32).map_err(text)?;
        let none: [Value; 0] = [];
        let file = session.inputs[input].input.path.display().to_string();
        let explained = seen.map(|seen| ExplainedFootprint { file, seen });
        let gps_time_s = index.and_then(|index| line.emissions.get(index)).map_or(f64::NAN, |shot| shot.gps_time_s);
        Ok(json!({
            "input": input, "shot": shot, "gps_time_s": number_or_null(gps_time_s),
            "problem": explained.is_none().then_some("the shot has no background beside its signal; choose another one"),
            "title": explained.as_ref().map_or_else(|| format!("shot {shot}"), ExplainedFootprint::title),
            "text": explained.as_ref().map_or_else(String::new, |explained| explained.table_within(None)),
            "svg": explained.as_ref().map(ExplainedFootprint::picture),
            "line": of_line, "previous": previous, "next": next,
            "returns": found.iter().map(return_value).collect::<Vec<Value>>(),
            "instrument": none, "blocks": none, "difference": null,
        }))
    })
}

/// Ranges of the shot numbers of the lines before and after a line.
fn lines_around(lines: &InputLines, number: usize) -> [Option<[u64; 2]>; 2] {
    let shots_of = |at: Option<usize>| Some(lines.index().lines().get(at?)?.shot_range);
    [number.checked_sub(1), number.checked_add(1)].map(shots_of)
}

/// Place of a shot in its line, and the numbers of the shots before and after it.
struct InLine {
    of_line: Option<Value>,
    previous: Option<u64>,
    next: Option<u64>,
}

impl InLine {
    fn of(line: &ScanLine, shot: u64, [before, after]: [Option<[u64; 2]>; 2]) -> InLine {
        let place = line.emissions.iter().position(|emission| emission.shot == shot);
        let others = || line.emissions.iter().map(|emission| emission.shot);
        InLine {
            of_line: place
                .map(|place| json!({ "number": line.line, "shot": place, "shots": line.emissions.len() })),
            previous: others().filter(|&other| other < shot).max().or(before.map(|[_, last]| last)),
            next: others().filter(|&other| other > shot).min().or(after.map(|[first, _]| first)),
        }
    }
}

/// The waveforms of the scan line of a shot as a picture, and its returns.
pub(super) fn line(session: &Session, input: usize, shot: u64) -> Result<Value, String> {
    let job = session.job()?;
    session.with_lines(input, |lines| {
        let number = place(lines, shot)?;
        let decomposed = lines.with_points(&job, number..number + 1).map_err(text)?;
        let before = lines.before_decompose(&job, number..number + 1).map_err(text)?;
        let (Some(recorded), Some(decomposed)) = (before.first(), decomposed.first()) else {
            return Err(format!("shot {shot}: its line cannot be read"));
        };
        let mut picture = LinePicture::of(recorded, &decomposed.emissions)?;
        let image = picture.png()?;
        let returns: Vec<Value> = decomposed
            .returns()
            .into_iter()
            .flatten()
            .map(|found| {
                json!({ "column": found.emission, "time_of_flight_ns": found.time_of_flight_ns,
                    "return_number": found.return_number, "flags": names(found.flags) })
            })
            .collect();
        Ok(json!({
            "line": recorded.line, "first_shot": recorded.emissions.first().map(|e| e.shot),
            "shots": recorded.emissions.iter().map(|e| e.shot).collect::<Vec<u64>>(),
            "first_ns": picture.first_ns, "interval_ns": picture.interval_ns,
            "width": picture.width, "height": picture.height, "highest_dn": picture.highest_dn,
            "image": BASE64_STANDARD.encode(image), "returns": returns,
        }))
    })
}

/// Position of the line of a shot.
fn place(lines: &mut InputLines, shot: u64) -> Result<usize, String> {
    lines.of_shot(shot).map_err(text)?.ok_or_else(|| format!("the recording has no shot {shot}"))
}

/// Returns of a shot by the keys of a job.
fn returns_of(
    lines: &mut InputLines,
    job: &Job,
    number: usize,
    shot: u64,
    placing: Option<&Placing>,
) -> Result<Vec<PlacedReturn>, String> {
    Ok(returns_in(&lines.with_points(job, number..number + 1).map_err(text)?, shot, placing))
}

/// Returns of a shot of the first of these lines.
fn returns_in(lines: &[ScanLine], shot: u64, placing: Option<&Placing>) -> Vec<PlacedReturn> {
    let Some(line) = lines.first() else { return Vec::new() };
    let of_shot =
        line.emissions.iter().zip(placed(line, placing)).find(|(emission, _)| emission.shot == shot);
    of_shot.map_or(Vec::new(), |(_, returns)| returns)
}

/// Waveforms of a scan line: amplitudes by shot and time of flight.
struct LinePicture {
    width: usize,
    height: usize,
    first_ns: f64,
    interval_ns: f64,
    highest_dn: f64,
    /// Heights above the background, DN, row by row.
    heights_dn: Vec<f32>,
}

impl LinePicture {
    /// Waveforms of the echoes of a line; `emissions` have the fitted emission times.
    fn of(line: &ScanLine, emissions: &[Emission]) -> Result<LinePicture, String> {
        let Content::Shots(blocks) = &line.content else { return Err("the line has no samples".into()) };
        let has_low = blocks.iter().any(|block| block.channel == Channel::LowPower);
        let is_shown = |block: &&Block| {
            if has_low { block.channel == Channel::LowPower } else { block.channel.is_echo() }
        };
        let emission_ns = |index: usize| emissions.get(index).map_or(0.0, |emission| emission.emission_ns);
        let mut shown: Vec<(usize, f64, &Block)> = Vec::new();
        for (index, of_shot) in blocks.by_emission() {
            let index = index as usize;
            shown.extend(
                of_shot
                    .iter()
                    .filter(is_shown)
                    .map(|block| (index, block.start_ns - emission_ns(index), block)),
            );
        }
        let interval_ns = shown.first().map_or(1.0, |(_, _, block)| block.interval_ns);
        let first_ns = shown.iter().map(|(_, start_ns, _)| *start_ns).fold(f64::INFINITY, f64::min);
        let end_ns =
            |(_, start_ns, block): &(usize, f64, &Block)| start_ns + block.interval_ns * block.len() as f64;
        let last_ns = shown.iter().map(end_ns).fold(f64::NEG_INFINITY, f64::max);
        // Without blocks, the last time is before the first.
        if shown.is_empty() || last_ns <= first_ns {
            return Err("the line has no recorded echoes".into());
        }
        let interval_ns = interval_ns.max((last_ns - first_ns) / MAX_ROWS as f64);
        let height = (((last_ns - first_ns) / interval_ns).ceil() as usize).clamp(1, MAX_ROWS);
        let width = line.emissions.len();
        let background = |channel: Channel| {
            let model = line.model.as_deref()?;
            let of = if channel == Channel::LowPower { &model.low_power } else { &model.high_power };
            let levels_dn = &of.as_ref()?.background_dn;
            Some(levels_dn.iter().sum::<f64>() / levels_dn.len().max(1) as f64)
        };
        let mut samples_dn = Vec::new();
        let mut heights_dn = vec![0.0_f32; width * height];
        for (index, start_ns, block) in &shown {
            blocks.fractions_into(block, &mut samples_dn);
            let usual = || median(samples_dn.iter().map(|dn| f64::from(*dn)));
            let background_dn = background(block.channel).or_else(usual).unwrap_or_default();
            for (k, &sample) in samples_dn.iter().enumerate() {
                let row = ((start_ns + block.interval_ns * k as f64 - first_ns) / interval_ns) as usize;
                if let Some(height_dn) = heights_dn.get_mut(row.min(height - 1) * width + index) {
                    *height_dn = height_dn.max((f64::from(sample) - background_dn) as f32);
                }
            }
        }
        let highest_dn = heights_dn.iter().copied().fold(1.0, f32::max).into();
        Ok(LinePicture { width, height, first_ns, interval_ns, highest_dn, heights_dn })
    }

    /// The picture as PNG, 8 bits of grey: 255 is the highest sample.
    fn png(&mut self) -> Result<Vec<u8>, String> {
        let grey = |height_dn: &f32| (f64::from(*height_dn) / self.highest_dn * 255.0).round() as u8;
        let pixels: Vec<u8> = self.heights_dn.iter().map(grey).collect();
        grey_png(self.width, self.height, &pixels).map_err(text)
    }
}

/// A picture in 8 bits of grey as PNG, row by row from the top.
fn grey_png(width: usize, height: usize, pixels: &[u8]) -> Result<Vec<u8>, png::EncodingError> {
    let mut bytes = Vec::new();
    // Both are limited: a line has at most 4096 shots.
    let mut encoder = png::Encoder::new(&mut bytes, width as u32, height as u32);
    encoder.set_color(png::ColorType::Grayscale);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.set_compression(png::Compression::Fast);
    let mut writer = encoder.write_header()?;
    writer.write_image_data(pixels)?;
    writer.finish()?;
    Ok(bytes)
}

/// All quantities of a return.
fn return_value(placed: &PlacedReturn) -> Value {
    let found = &placed.found;
    json!({
        "return_number": found.return_number, "number_of_returns": found.number_of_returns,
        "channel": found.channel.name(),
        "time_of_flight_ns": number_or_null(found.time_of_flight_ns),
        "time_of_flight_sd_ns": number_or_null(found.time_of_flight_sd_ns),
        "range_m": number_or_null(found.range_m), "range_sd_m": number_or_null(found.range_sd_m),
        "amplitude_dn": number_or_null(found.amplitude_dn), "amplitude_sd_dn": number_or_null(found.amplitude_sd_dn),
        "width_ratio": number_or_null(found.width_ratio), "width_ratio_sd": number_or_null(found.width_ratio_sd),
        "thickness_m": number_or_null(found.thickness_m), "thickness_sd_m": number_or_null(found.thickness_sd_m),
        "deviation_ratio": number_or_null(found.deviation_ratio),
        "total_sd_m": number_or_null(found.total_sd_m), "intensity": number_or_null(found.intensity),
        "mta_zone": found.mta_zone, "class": found.class, "flags": names(found.flags),
        "position": placed.position,
    })
}

/// Names of the flags that are set.
pub(super) fn names(of: u16) -> Vec<&'static str> {
    flags::NAMES.iter().filter(|(bit, _)| of & bit != 0).map(|(_, name)| *name).collect()
}

/// A number; `null` if it is not finite.
pub(super) fn number_or_null(value: f64) -> Value {
    serde_json::Number::from_f64(value).map_or(Value::Null, Value::Number)
}

//! Summary of a recording: sections of name-value rows.

use std::path::Path;

use super::dates::{recorded, time_scale, weekday_of_times};
use super::histogram_files::{CHANNELS, name_of};
use super::{Angle, BeamSummary, GrowingHistogram, Inspection, Intervals, SampleStatistics};
use crate::report::crs_name;
use wavex_geodesy::time;
use wavex_line::scan_line::{Channel, EmissionReference, Frame, GainControl, InputInfo};
use wavex_line::stage::Counters;

/// Summary of one recording.
pub struct RecordingSummary {
    /// File name without its folder.
    pub file: String,
    /// Sections of the text.
    pub sections: Vec<SummarySection>,
}

/// A titled group of rows.
pub struct SummarySection {
    /// Heading.
    pub title: String,
    /// Pairs of name and value.
    pub rows: Vec<(String, String)>,
    /// Table below the rows, headings first; empty: none.
    pub table: Vec<Vec<String>>,
}

impl RecordingSummary {
    /// `cut`: reason why the recording could not be read to its end.
    pub fn of(
        file: &Path,
        inspection: &Inspection,
        counters: &Counters,
        cut: Option<&str>,
    ) -> RecordingSummary {
        let mut sections = vec![about_file(file, inspection)];
        if inspection.shots.count > 0 {
            sections.extend([times(inspection), rates(inspection), lines(inspection), blocks(inspection)]);
            sections.extend(CHANNELS.iter().filter_map(|channel| receiver(inspection, *channel)));
            sections.push(flight(inspection));
        }
        sections.push(integrity(inspection, counters, cut));
        let name = file.file_name().unwrap_or_default().to_string_lossy().into_owned();
        RecordingSummary { file: name, sections }
    }

    /// Summary as text with aligned columns.
    pub fn text(&self) -> String {
        let rows = || self.sections.iter().flat_map(|section| &section.rows);
        let width = rows().map(|(name, _)| name.chars().count()).max().unwrap_or(0);
        let mut text = format!("{}\n", self.file);
        for section in &self.sections {
            text.push_str(&format!("\n{}\n", section.title));
            for (name, value) in &section.rows {
                text.push_str(&format!("  {name:width$}  {value}\n"));
            }
            text.push_str(&aligned(&section.table));
        }
        text
    }
}

impl SummarySection {
    fn new(title: impl Into<String>) -> SummarySection {
        SummarySection { title: title.into(), rows: Vec::new(), table: Vec::new() }
    }

    fn say(&mut self, name: &str, value: impl Into<String>) {
        self.rows.push((name.to_owned(), value.into()));
    }

    fn say_if(&mut self, name: &str, value: Option<impl Into<String>>) {
        if let Some(value) = value {
            self.say(name, value);
        }
    }
}

fn about_file(file: &Path, inspection: &Inspection) -> SummarySection {
    let mut section = SummarySection::new("File");
    section.say("file", file.display().to_string());
    section
        .say_if("size", std::fs::metadata(file).ok().map(|about| format!("{} bytes", grouped(about.len()))));
    let Some(input) = &inspection.input else {
        section.say("content", "no shots");
        return section;
    };
    section.say("format", input.format.clone());
    section.say_if("instrument", input.instrument.clone());
    section.say_if("serial number", input.serial.clone());
    let of_large = "large: profiles of ground and canopy, which `measure_footprints` measures";
    section.say_if("footprints", inspection.has_large_footprints().then_some(of_large));
    let day_of = if input.is_file_date { "file created" } else { "recorded" };
    section.say_if(day_of, recorded(input));
    section.say(
        "frame",
        match input.frame {
            Frame::Scanner => "scanner",
            Frame::Body => "aircraft body",
            Frame::Map => "map",
            Frame::Earth => "earth-centred",
        },
    );
    if input.frame == Frame::Map {
        section.say("coordinate system", input.crs_wkt.as_deref().map_or("not given".into(), crs_name));
    }
    let first_s = inspection.first_last_s().map(|[first_s, _]| first_s);
    section.say("time scale", time_scale(input, first_s));
    section.say("group velocity", format!("{:.0} m/s", input.group_velocity_mps));
    section.say("sampling interval", format!("{} ns", number(input.sampling_interval_ns, 6)));
    let full = input.full_scale_dn.map_or("unknown".into(), |full| format!("{full} DN"));
    section.say("full scale of samples", full);
    match input.gain_control {
        GainControl::Off => {}
        GainControl::Recorded => section.say("automatic gain control", "yes, with the gain of each block"),
        GainControl::NotRecorded => section
            .say("automatic gain control", "yes, but the gains are unknown: intensities are not comparable"),
    }
    section.say(
        "emission time from",
        match input.emission_reference {
            EmissionReference::OutgoingPulse => "outgoing pulse of each shot",
            EmissionReference::OutgoingPulseFraction => "outgoing pulse of each shot, without start time",
            EmissionReference::ReturnLocations => "return locations in the file",
            EmissionReference::Clock => "the shot's clock",
        },
    );
    section.say("tables", tables(input));
    section
}

fn tables(input: &InputInfo) -> String {
    let all = [
        ("amplitude low", &input.amplitude_low),
        ("amplitude high", &input.amplitude_high),
        ("range low", &input.range_low),
        ("range high", &input.range_high),
    ];
    let there = all.iter().filter_map(|(name, table)| {
        table.as_ref().map(|table| format!("{name} ({} entries)", table.pairs().len()))
    });
    let there: Vec<String> = there.collect();
    if there.is_empty() { "none".into() } else { there.join(", ") }
}

fn times(inspection: &Inspection) -> SummarySection {
    let mut section = SummarySection::new("Times");
    let (times, shots) = (&inspection.times, inspection.shots.count);
    section.say("shots", grouped(shots));
    if let (Some([first_s, last_s]), Some([least_s, largest_s])) = (inspection.first_last_s(), times.range_s)
    {
        let date = |time_s: f64| {
            let adjusted = inspection.input.as_ref().and_then(|input| input.adjusted_gps_time(time_s));
            let day = adjusted.and_then(time::day_of_year);
            day.map_or(String::new(), |(year, day)| format!(" (day {day} of {year})"))
        };
        let input = inspection.input.as_ref();
        section.say_if("day of the flight", input.and_then(|input| weekday_of_times(input, first_s)));
        section.say("first shot", format!("{first_s:.6} s{}", date(first_s)));
        section.say("last shot", format!("{last_s:.6} s{}", date(last_s)));
        section.say("duration", format!("{:.6} s", largest_s - least_s));
    }
    if times.without > 0 {
        section.say("shots without a time", share(times.without, shots));
    }
    let backwards = match times.backwards {
        (count, Some(shot)) => format!(
            "{}, first at shot {shot}: shots are not in order of time, as in a clipped or merged file; each step begins \
             a scan line, which does not change the points of a shot",
            counted(count, "time")
        ),
        _ if inspection.beams.len() > 1 => "never within a beam".into(),
        _ => "never".into(),
    };
    section.say("clock runs backwards", backwards);
    section.say("gaps within lines", gaps(&times.shots, "shot intervals"));
    section.say("gaps between lines", gaps(&times.lines, "line periods"));
    section
}

/// Describes intervals longer than 2.5 typical ones, with the longest.
fn gaps(intervals: &Intervals, unit: &str) -> String {
    let (Some(longest), Some([usual_ps, _])) = (intervals.longest_gap(), intervals.usual_ps()) else {
        return "none".into();
    };
    let at =
        if longest.gps_time_s.is_finite() { format!(", {:.6} s", longest.gps_time_s) } else { String::new() };
    format!(
        "{} of more than 2.5 {unit}, the longest {} ({:.0} {unit}) before shot {}{at}",
        grouped(intervals.gaps()),
        seconds(longest.ps as f64 * 1e-12),
        longest.ps as f64 / usual_ps.max(1.0),
        longest.shot
    )
}

/// Jitter below which LAS times cannot show modulation, ps.
///
/// LAS times are doubles of up to 1e9 s, often written with microsecond resolution.
const COARSE_LAS_PS: f64 = 1e6;
/// Minimum number of line periods to determine the typical one.
const LEAST_LINES: u64 = 3;

fn rates(inspection: &Inspection) -> SummarySection {
    let mut section = SummarySection::new("Rates");
    let input = inspection.input.as_ref();
    let nominal = input.and_then(|input| input.pulse_rate_hz);
    section
        .say("pulse rate, nominal", nominal.map_or("not given".into(), |hz| format!("{} Hz", number(hz, 3))));
    let shots = &inspection.times.shots;
    if let Some([mean_ps, sd_ps]) = shots.usual_ps().filter(|[mean_ps, _]| *mean_ps > 0.0) {
        section.say("pulse rate, measured", format!("{:.1} Hz ({:.6} µs)", 1e12 / mean_ps, mean_ps * 1e-6));
        let step_ps = shots.step_ps().unwrap_or(0) as f64;
        let is_las = input.is_some_and(|input| input.format.starts_with("LAS "));
        let modulation = if sd_ps > 0.0 && step_ps > sd_ps {
            format!("cannot be determined: the clock resolution is {} ns", number(step_ps * 1e-3, 3))
        } else if is_las && sd_ps < COARSE_LAS_PS {
            "cannot be determined: LAS times are too coarse".to_owned()
        } else {
            format!("{:.3} ns RMS", sd_ps * 1e-3)
        };
        section.say("modulation of the interval", modulation);
    } else {
        section.say("pulse rate, measured", "cannot be determined");
    }
    let lines = &inspection.times.lines;
    let line_ps = lines.usual_ps().filter(|[mean_ps, _]| *mean_ps > 0.0 && lines.count() >= LEAST_LINES);
    section.say_if("scan line rate", line_ps.map(|[mean_ps, _]| format!("{:.3} lines/s", 1e12 / mean_ps)));
    section
}

fn lines(inspection: &Inspection) -> SummarySection {
    const SHOWN: usize = 8;
    let mut section = SummarySection::new("Lines");
    section.say("scan lines", grouped(inspection.lines.count));
    section.say("shots per line", of(&inspection.lines.shots, "", 0));
    let facets = &inspection.shots.by_facet;
    section.say("facets", facets.len().to_string());
    for (facet, shots) in facets.iter().take(SHOWN).filter(|_| facets.len() > 1) {
        section.say(&format!("facet {facet}"), share(*shots, inspection.shots.count) + " of the shots");
    }
    let positive = inspection.shots.positive_direction;
    section.say("mirror in positive direction", share(positive, inspection.shots.count) + " of the shots");
    section
}

fn blocks(inspection: &Inspection) -> SummarySection {
    let mut section = SummarySection::new("Echoes");
    if !inspection.with_samples && inspection.channels.iter().all(|channel| channel.blocks == 0) {
        section.say("blocks", "not read (--fast)");
        return section;
    }
    section.say("shots with echoes", share(inspection.shots.with_echoes, inspection.shots.count));
    if inspection.shots.copies > 0 {
        let copies = share(inspection.shots.copies, inspection.shots.with_echoes);
        section.say("copies of the shot before", format!("{copies}; sample statistics leave them out"));
    }
    let few: Vec<String> = inspection
        .blocks_per_shot
        .bins()
        .filter(|(_, count)| *count > 0)
        .take(8)
        .map(|(blocks, count)| format!("{blocks}: {}", grouped(count)))
        .collect();
    section.say("shots by number of blocks", few.join("   "));
    let online = inspection.shots.online;
    let both = || format!("{} in {} shots", grouped(online[0]), grouped(online[1]));
    section.say("instrument returns", if online[0] > 0 { both() } else { "none".into() });
    // Stages that resolve zones do not take large footprints.
    if !inspection.has_fractions {
        section.say("pulses in the air", zones(inspection));
    }
    if let Some(range) = inspection.ranges_m.range() {
        let from = if inspection.ranges_from_first_sample() {
            "; from the first sample of each shot: the recording has no sensor position"
        } else if inspection.zones.contains_key(&None) {
            "; from the latest emission before reception: zones are unresolved"
        } else {
            ""
        };
        let median = inspection.ranges_m.median().unwrap_or(range[0]);
        section.say("ranges", format!("{:.1} to {:.1} m, median {median:.1} m{from}", range[0], range[1]));
    }
    section
}

fn zones(inspection: &Inspection) -> String {
    let unresolved = inspection.zones.get(&None).copied().unwrap_or(0);
    let total: u64 = inspection.zones.values().sum();
    let resolved = inspection.zones.iter().filter_map(|(zone, count)| zone.map(|zone| (zone, *count)));
    let mut parts: Vec<String> =
        resolved.take(12).map(|(zone, count)| format!("zone {zone}: {}", share(count, total))).collect();
    if unresolved > 0 {
        parts.push(format!("unresolved: {} of the blocks", share(unresolved, total)));
    }
    if parts.is_empty() { "no blocks".into() } else { parts.join("   ") }
}

fn receiver(inspection: &Inspection, channel: Channel) -> Option<SummarySection> {
    let seen = inspection.channel(channel);
    if seen.blocks == 0 {
        return None;
    }
    let mut section = SummarySection::new(format!("Channel: {}", name_of(channel)));
    section.say("blocks", grouped(seen.blocks));
    section.say("samples per block", of(&seen.lengths, "", 0));
    section.say("first sample after the clock", of(&seen.starts_ns, " ns", 2));
    if seen.gains != [1.0; 2] {
        let [least, greatest] = seen.gains;
        section.say("gain", format!("{least:.3} to {greatest:.3}; noise and peaks below include the gain"));
    }
    if let Some(values) = &seen.values {
        if inspection.has_fractions && channel.is_echo() {
            section.say("noise", NOT_MEASURED);
        } else {
            sample_rows(&mut section, values, channel);
        }
    }
    Some(section)
}

/// Noise of samples that are not evaluated.
const NOT_MEASURED: &str =
    "not measured here: samples are fractions of a digitiser step; Beams has the noise recorded by the file";
/// Minimum number of signal-free samples for noise statistics.
const LEAST_FREE: u64 = 200;

fn sample_rows(section: &mut SummarySection, values: &SampleStatistics, channel: Channel) {
    let level_dn = values.level_dn();
    if channel.is_echo() {
        match (values.background_dn(), values.noise_sd_dn()) {
            (Some(phases), Some(sd_dn)) if values.free() >= LEAST_FREE => {
                let phases: Vec<String> = phases.iter().map(|dn| format!("{dn:.2}")).collect();
                section.say("background", format!("{} DN, by sample phase", phases.join(" ")));
                section.say("noise", format!("{sd_dn:.3} DN, from {} samples", grouped(values.free())));
                let lags: Vec<String> =
                    values.noise_autocorrelation().iter().map(|r| format!("{r:.2}")).collect();
                section
                    .say("noise autocorrelation", format!("{} at lags 1 to {}", lags.join(" "), lags.len()));
            }
            _ => {
                section.say("noise", format!("too few signal-free samples to measure it: {}", values.free()))
            }
        }
    }
    let zero = level_dn.unwrap_or(0.0);
    let above = if level_dn.is_some() { "above the background" } else { "background included" };
    if let (Some([least, largest]), Some(median)) = (values.peaks_dn().range(), values.peaks_dn().median()) {
        let (least, median, largest) = (least - zero, median - zero, largest - zero);
        section.say("peaks", format!("{least:.1} to {largest:.1} DN, median {median:.1} DN, {above}"));
    }
    section.say(
        "saturated",
        match values.saturated() {
            None => "unknown: the full scale is unknown".to_owned(),
            Some([samples, blocks]) => {
                format!(
                    "{} of the samples, {} of the blocks",
                    share(samples, values.added()[0]),
                    share(blocks, values.added()[1])
                )
            }
        },
    );
}

fn flight(inspection: &Inspection) -> SummarySection {
    let mut section = SummarySection::new("Beams");
    let title = match inspection.angle {
        Some(Angle::Scan) | None => "scan angles",
        Some(Angle::FromNadir) => "angles from nadir",
        Some(Angle::FromAxis) => "angles from the third axis",
    };
    section.say(title, of(&inspection.angles_deg, "°", 2));
    let shots = &inspection.shots;
    let synchronised = match (shots.synchronised, shots.synchronised_within_last_second) {
        (0, 0) => "not reported by any shot (LAS and PulseWaves cannot)".to_owned(),
        (ever, lately) => format!(
            "{} of the shots; within the preceding second {}",
            share(ever, shots.count),
            share(lately, shots.count)
        ),
    };
    section.say("synchronised with GPS", synchronised);
    section.table = beams(inspection);
    section
}

/// Table of the beams of an instrument; empty if it names none.
fn beams(inspection: &Inspection) -> Vec<Vec<String>> {
    const HEADS: [&str; 9] = [
        "beam",
        "power",
        "shots",
        "degraded",
        "stale",
        "noise mean, DN",
        "noise SD, DN",
        "first, s",
        "last, s",
    ];
    if inspection.beams.is_empty() {
        return Vec::new();
    }
    let unknown = || "unknown".to_owned();
    let row = |beam: &BeamSummary| {
        let flagged = |count: Option<u64>| count.map_or_else(unknown, |count| share(count, beam.shots));
        let fixed =
            |value: Option<f64>, digits| value.map_or_else(unknown, |value| format!("{value:.digits$}"));
        vec![
            beam.name.clone(),
            beam.power.unwrap_or("not given").to_owned(),
            grouped(beam.shots),
            flagged(beam.degraded_shots),
            flagged(beam.stale_shots),
            fixed(beam.recorded_noise_mean_dn, 2),
            fixed(beam.recorded_noise_sd_dn, 2),
            fixed(beam.first_shot_s, 6),
            fixed(beam.last_shot_s, 6),
        ]
    };
    let heads = HEADS.map(str::to_owned).to_vec();
    std::iter::once(heads).chain(inspection.beams.iter().map(row)).collect()
}

fn integrity(inspection: &Inspection, counters: &Counters, cut: Option<&str>) -> SummarySection {
    let mut section = SummarySection::new("Integrity");
    section.say("read to the end", cut.map_or("yes".into(), |problem| format!("no: {problem}")));
    if counters.rejected.is_empty() {
        section.say("rejected", "nothing");
    }
    for ((item, reason), count) in &counters.rejected {
        section.say(&format!("rejected {}", item.name()), format!("{}: {reason}", grouped(*count)));
    }
    for note in counters.warnings() {
        section.say("note", note);
    }
    for finding in &counters.findings {
        section.say("finding", finding.clone());
    }
    if inspection.zones.contains_key(&None) && !inspection.has_fractions {
        section.say("note", "zones are unresolved: put `resolve_mta` before `decompose`");
    }
    section
}

/// Table as text; columns are two spaces apart.
fn aligned(table: &[Vec<String>]) -> String {
    let width = |column: usize| {
        table.iter().filter_map(|row| row.get(column)).map(|cell| cell.chars().count()).max().unwrap_or(0)
    };
    let cell = |(column, cell): (usize, &String)| format!("  {cell:width$}", width = width(column));
    let line =
        |row: &Vec<String>| row.iter().enumerate().map(cell).collect::<String>().trim_end().to_owned() + "\n";
    table.iter().map(line).collect()
}

/// Minimum, maximum and median as text.
fn of(histogram: &GrowingHistogram, unit: &str, digits: usize) -> String {
    match (histogram.range(), histogram.median()) {
        (Some([least, largest]), Some(_)) if least == largest => format!("{least:.digits$}{unit}"),
        (Some([least, largest]), Some(median)) => {
            format!("{least:.digits$} to {largest:.digits$}{unit}, median {median:.digits$}{unit}")
        }
        _ => "unknown".into(),
    }
}

/// Formats a whole number with grouped thousands.
pub(super) fn grouped(number: u64) -> String {
    let digits = number.to_string();
    let mut text = String::with_capacity(digits.len() + digits.len() / 3);
    for (index, digit) in digits.chars().enumerate() {
        if index > 0 && (digits.len() - index).is_multiple_of(3) {
            text.push(' ');
        }
        text.push(digit);
    }
    text
}

/// `3 times`, `1 time`.
fn counted(count: u64, what: &str) -> String {
    if count == 1 { format!("1 {what}") } else { format!("{} {what}s", grouped(count)) }
}

/// Formats a count with its percentage of a total.
fn share(count: u64, of: u64) -> String {
    let percent = 100.0 * count as f64 / of.max(1) as f64;
    let digits = if percent == 0.0 || percent >= 10.0 { 1 } else { 3 };
    format!("{} ({percent:.digits$} %)", grouped(count))
}

/// Formats a number without trailing zeros.
fn number(value: f64, digits: usize) -> String {
    let text = format!("{value:.digits$}");
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
}

/// Formats a duration with a suitable unit.
fn seconds(duration_s: f64) -> String {
    let (factor, unit) = match duration_s {
        s if s >= 1.0 => (1.0, "s"),
        s if s >= 1e-3 => (1e3, "ms"),
        _ => (1e6, "µs"),
    };
    format!("{:.3} {unit}", duration_s * factor)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_easy_to_read() {
        assert_eq!([0, 12, 123, 1234, 1_234_567].map(grouped), ["0", "12", "123", "1 234", "1 234 567"]);
        assert_eq!([share(1, 3), share(0, 0), share(1, 400)], ["1 (33.3 %)", "0 (0.0 %)", "1 (0.250 %)"]);
        assert_eq!([number(1.0, 6), number(400_000.0, 3), number(0.5, 2)], ["1", "400000", "0.5"]);
        assert_eq!([seconds(2.5), seconds(0.0025), seconds(2.5e-6)], ["2.500 s", "2.500 ms", "2.500 µs"]);
        assert_eq!([counted(1, "time"), counted(2000, "time")], ["1 time", "2 000 times"]);
    }

    #[test]
    fn columns_are_aligned() {
        let row = |cells: [&str; 2]| cells.map(str::to_owned).to_vec();
        let rows = vec![("a".to_owned(), "1".to_owned()), ("größe".to_owned(), "2".to_owned())];
        let sections = vec![SummarySection {
            title: "File".into(),
            rows,
            table: vec![row(["beam", "shots"]), row(["B1", "7"])],
        }];
        let text = RecordingSummary { file: "x.pls".into(), sections }.text();
        assert_eq!(text, "x.pls\n\nFile\n  a      1\n  größe  2\n  beam  shots\n  B1    7\n");
    }

    #[test]
    fn recordings_without_shots_have_a_short_summary() {
        let summary = RecordingSummary::of(
            Path::new("gone/a.arrow"),
            &Inspection::new(true),
            &Counters::default(),
            None,
        );
        let expected = "a.arrow\n\nFile\n  file             gone/a.arrow\n  content          no shots\n\n\
                        Integrity\n  read to the end  yes\n  rejected         nothing\n";
        assert_eq!(summary.text(), expected);
    }

    #[test]
    fn a_coordinate_system_is_called_by_its_name() {
        assert_eq!(crs_name("PROJCS[\"ETRS89 / UTM zone 32N\",GEOGCS[\"ETRS89\"]]"), "ETRS89 / UTM zone 32N");
        assert_eq!(crs_name("EPSG:25832"), "unnamed");
    }
}

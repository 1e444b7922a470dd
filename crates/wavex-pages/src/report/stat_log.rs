//! Text statistics of one input (`*_stat.log`).

use std::fmt::{Display, Write as _};
use std::path::PathBuf;

use super::tables::stage_table;
use wavex_engine::engine::{InputSummary, RunSummary, StageSummary, TrajectorySummary};
use wavex_line::georef::keys::{CalibrationKey, GeometryKeys};
use wavex_line::stage::RoleName;
use wavex_signal::sensor_model::{ChannelModel, SensorModel};

/// Descriptions of the line counters, in output order.
const COUNTS: [(&str, &str); 23] = [
    ("nw", "waveforms"),
    ("nw_with_points", "waveforms with returns"),
    ("nw_empty", "waveforms without any return"),
    ("nw_deleted", "unusable waveforms"),
    ("nw_saturated", "waveforms with saturated samples"),
    ("nw_truncated", "waveforms with a return cut off"),
    ("nw_refined1x", "waveforms refined"),
    ("nw_refined2x", "waveforms refined twice"),
    ("n_candidates", "candidates of the first detection"),
    ("n_added", "candidates added later"),
    ("np_filtered", "candidates rejected by a threshold"),
    ("np_merged", "candidates merged"),
    ("np", "returns"),
    ("np_xtalk", "returns affected by cross-talk"),
    ("np_xtalk_dropped", "returns dropped due to cross-talk"),
    ("np_online", "returns computed by the instrument"),
    ("np_air", "outliers above their neighbours"),
    ("np_low", "outliers below their neighbours"),
    ("np_range", "intensities corrected for range"),
    ("np_atm", "intensities corrected for atmospheric attenuation"),
    ("np_ibrc", "ranges corrected by amplitude"),
    ("np_ibic", "amplitudes corrected by table"),
    ("n_georef", "points with coordinates"),
];

/// A text of titled sections, with one name and value per row.
struct SectionedText(String);

impl SectionedText {
    fn title(&mut self, title: &str) {
        // Writing to a string cannot fail, here and below.
        let _ = write!(self.0, "\n{title}\n{}\n", "-".repeat(title.len()));
    }

    fn row(&mut self, name: &str, value: impl Display) {
        let _ = writeln!(self.0, "{name:<36} {value}");
    }

    /// Writes a row if the value is known.
    fn known(&mut self, name: &str, value: Option<impl Display>) {
        if let Some(value) = value {
            self.row(name, value);
        }
    }
}

/// Text statistics of one input of a run (`*_stat.log`).
///
/// Sections: run time, input, decoding, extraction, trajectory, georeferencing, output. `own` are
/// the files of the run as a whole. `failure` is the message of a failed run.
pub fn stat_log(run: &RunSummary, input: &InputSummary, own: &[PathBuf], failure: Option<&str>) -> String {
    let mut text = SectionedText(format!("wavex {}: statistics of {}\n", run.wavex, input.stem));
    run_time(&mut text, run, input, failure);
    about_input(&mut text, input);
    decoding(&mut text, input);
    extraction(&mut text, run, input);
    trajectory(&mut text, input.trajectory.as_ref());
    georeferencing(&mut text, run, input);
    output(&mut text, input, own);
    text.0
}

fn total(input: &InputSummary, name: &str) -> u64 {
    input.totals.get(name).copied().unwrap_or(0)
}

fn run_time(text: &mut SectionedText, run: &RunSummary, input: &InputSummary, failure: Option<&str>) {
    text.title("Run time");
    text.row("start", &input.started);
    text.row("end", &input.ended);
    text.row("exit status", if failure.is_some() { "1, failed" } else { "0, success" });
    text.known("failure", failure);
    text.row("duration", format_args!("{:.3} s", input.wall_s));
    let rate = total(input, "nw") as f64 / input.wall_s.max(1e-9);
    text.row("waveforms per second", format_args!("{rate:.0}"));
    text.row("threads", run.threads);
    text.row("peak memory of scan lines", format_args!("{:.1} MB", input.peak_in_flight_bytes as f64 / 1e6));
    text.known("slowest stage", input.bottleneck().map(|stage| &stage.id));
    let _ = write!(text.0, "\n{}", stage_table(input));
}

fn about_input(text: &mut SectionedText, input: &InputSummary) {
    text.title("Input");
    match input.path.as_os_str().is_empty() {
        true => text.row("file", "none: simulated"),
        false => text.row("file", input.path.display()),
    }
    text.known("format", input.format.as_ref());
    text.known("instrument", input.instrument.as_ref());
    text.known("serial number", input.serial.as_ref());
    text.known("sampling interval", input.sampling_interval_ns.map(|ns| format!("{ns} ns")));
    text.known("group velocity", input.group_velocity_mps.map(|mps| format!("{mps} m/s")));
    text.known("time scale of results", input.time_scale.as_ref());
    text.known("frame of the beams", input.frame.as_ref());
    text.known("emission time from", input.emission_reference.as_ref().map(|word| word.replace('_', " ")));
    text.known("ranges start at", input.ranges_count_from.as_ref().map(|word| word.replace('_', " ")));
}

fn decoding(text: &mut SectionedText, input: &InputSummary) {
    text.title("Decoding");
    for stage in input.stages.iter().filter(|stage| stage.role == RoleName::Source) {
        text.row("read by", &stage.id);
        text.row("scan lines", stage.lines_out);
        text.row("shots", stage.items_out.shots);
        text.row("sample blocks", stage.items_out.blocks);
        remarks(text, stage);
    }
}

fn extraction(text: &mut SectionedText, run: &RunSummary, input: &InputSummary) {
    text.title("Extraction");
    for (name, words) in COUNTS.iter().filter(|(name, _)| *name != "n_georef") {
        text.known(words, input.totals.get(name));
    }
    for (name, words) in run.sensor_model(input).into_iter().flat_map(sensor_model_words) {
        text.row(&format!("calibration, {name}"), words);
    }
    let between = |stage: &&StageSummary| stage.role != RoleName::Source && stage.role != RoleName::Sink;
    for stage in input.stages.iter().filter(between).filter(|stage| stage.r#type != GEOREFERENCE) {
        remarks(text, stage);
    }
}

/// The stage with a separate section.
const GEOREFERENCE: &str = "georeference";

/// Calibration results of each receiver, by name.
pub fn sensor_model_words(model: &SensorModel) -> impl Iterator<Item = (&'static str, String)> {
    let channels = [
        ("low power", &model.low_power),
        ("high power", &model.high_power),
        ("outgoing pulse", &model.reference),
    ];
    channels.into_iter().filter_map(|(name, channel)| Some((name, calibration(channel.as_ref()?))))
}

fn calibration(channel: &ChannelModel) -> String {
    format!(
        "noise {:.3} DN, background {:.2} DN, pulse width {:.3} ns, from {} waveforms",
        channel.noise_sd_dn,
        channel.background_dn.iter().sum::<f64>() / channel.background_dn.len() as f64,
        channel.pulse_fwhm_ns,
        channel.waveforms
    )
}

fn trajectory(text: &mut SectionedText, trajectory: Option<&TrajectorySummary>) {
    text.title("Trajectory");
    let Some(trajectory) = trajectory else {
        text.row("file", "none");
        return;
    };
    text.row("file", &trajectory.path);
    text.row("records", trajectory.records);
    let [first_s, last_s] = trajectory.span_s;
    text.row("from, to", format_args!("{first_s:.3} s, {last_s:.3} s"));
    text.row("median step", format_args!("{:.6} s", trajectory.median_step_s));
    text.row("gaps", trajectory.gaps);
    if let Some(file) = &trajectory.corrections {
        text.row("corrections", file);
    }
}

/// Mount, calibration, geoid and unit of `[job.geometry]`, by name.
pub fn geometry_words(keys: &GeometryKeys) -> [(&'static str, String); 4] {
    let calibration = keys.calibration.as_ref().map(|calibration| match calibration {
        CalibrationKey::File(file) => file.clone(),
        CalibrationKey::Inline(calibration) => words(calibration),
    });
    let folder = keys.geoid_dir.as_ref().map_or(String::new(), |folder| format!(" in {folder}"));
    let geoid = keys.geoid.as_ref().map(|name| format!("{name}{folder}"));
    let or = |word: Option<String>, otherwise: &str| word.unwrap_or_else(|| otherwise.to_owned());
    [
        ("mount", or(keys.mount.as_ref().map(words), "level")),
        ("calibration", or(calibration, "none")),
        ("geoid", or(geoid, "none: heights as in the coordinate reference system")),
        ("unit", or(keys.unit.as_ref().map(words), "as in the coordinate reference system")),
    ]
}

/// Formats a value of a job on one line.
fn words(value: &impl serde::Serialize) -> String {
    match serde_json::to_value(value) {
        Ok(serde_json::Value::String(text)) => text,
        Ok(value) => value.to_string(),
        Err(error) => error.to_string(),
    }
}

fn georeferencing(text: &mut SectionedText, run: &RunSummary, input: &InputSummary) {
    text.title("Georeferencing");
    text.row("coordinates", input.coordinates.as_deref().unwrap_or("as in the input"));
    for (name, words) in geometry_words(&run.job.geometry) {
        text.row(name, words);
    }
    text.row("points with coordinates", total(input, "n_georef"));
    for stage in input.stages.iter().filter(|stage| stage.r#type == GEOREFERENCE) {
        remarks(text, stage);
    }
}

fn output(text: &mut SectionedText, input: &InputSummary, own: &[PathBuf]) {
    text.title("Output");
    for output in input.outputs.iter().chain(own) {
        text.row("file", output.display());
    }
    if input.outputs.is_empty() && own.is_empty() {
        text.row("file", "none");
    }
    for stage in input.stages.iter().filter(|stage| stage.role == RoleName::Sink) {
        remarks(text, stage);
    }
}

/// Writes the rejections, notes and findings of a stage.
fn remarks(text: &mut SectionedText, stage: &StageSummary) {
    for (what, n) in &stage.rejected {
        text.row(&format!("{}: rejected", stage.id), format_args!("{n} {what}"));
    }
    for note in stage.warnings() {
        text.row(&format!("{}: note", stage.id), note);
    }
    for finding in &stage.findings {
        text.row(&format!("{}: finding", stage.id), finding);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use wavex_line::scan_line::LineStats;

    #[test]
    fn every_counter_has_its_words() {
        let mut named: Vec<&str> = COUNTS.iter().map(|(name, _)| *name).collect();
        let mut counted: Vec<&str> = LineStats::default().counts().iter().map(|(name, _)| *name).collect();
        named.sort_unstable();
        counted.sort_unstable();
        assert_eq!(named, counted);
    }
}

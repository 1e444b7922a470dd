//! Text table of a shot's returns, with fit statistics of its blocks.

use std::fmt::Write;

use super::ExplainedShot;
use wavex_line::scan_line::{Filtered, Return, flags};
use wavex_signal::sensor_model::{Background, ChannelModel};
use wavex_stages::process::decompose::SeenBlock;

/// Column heads.
const HEADS: [&str; 9] = [
    "return",
    "channel",
    "time of flight, ns",
    "range, m",
    "amplitude, DN",
    "width ratio",
    "thickness, m",
    "deviation",
    "flags",
];

/// The complete text for a shot.
pub(super) fn table(explained: &ExplainedShot) -> String {
    let mut text = format!("{}\n\n", title(explained, &explained.file));
    let rows: Vec<[String; 9]> = explained.returns.iter().map(row).collect();
    let width =
        |i: usize| rows.iter().map(|row| row[i].chars().count()).chain([HEADS[i].len()]).max().unwrap_or(0);
    let widths: Vec<usize> = (0..HEADS.len()).map(width).collect();
    let mut line = |cells: &[String]| {
        let padded = cells.iter().zip(&widths).map(|(cell, width)| format!("{cell:<width$}"));
        text.push_str(padded.collect::<Vec<_>>().join("  ").trim_end());
        text.push('\n');
    };
    line(&HEADS.map(str::to_owned));
    rows.iter().for_each(|row| line(row));
    text.push('\n');
    text.push_str(&outgoing(explained));
    for (number, block) in (1..).zip(&explained.blocks) {
        text.push_str(&of_block(number, block));
    }
    for remark in &explained.remarks {
        let _ = writeln!(text, "{remark}");
    }
    text.push_str(&sensor(explained));
    text
}

/// Title with shot number, time, and counts of returns and blocks.
pub(super) fn title(explained: &ExplainedShot, file: &str) -> String {
    let time = explained.emission.gps_time_s;
    let time = if time.is_nan() { String::new() } else { format!(", GPS time {time:.6} s") };
    let blocks = counted(explained.blocks.len(), "echo block");
    let returns = counted(explained.returns.len(), "return");
    format!("shot {} of {file}{time}: {returns} in {blocks}", explained.emission.shot)
}

/// `1 return`, `2 returns`.
pub(super) fn counted(n: usize, what: &str) -> String {
    format!("{n} {what}{}", if n == 1 { "" } else { "s" })
}

fn row(found: &Return) -> [String; 9] {
    [
        found.return_number.to_string(),
        found.channel.name().to_owned(),
        format!("{:.4} ± {:.4}", found.time_of_flight_ns, found.time_of_flight_sd_ns),
        format!("{:.4} ± {:.4}", found.range_m, found.range_sd_m),
        format!("{:.2} ± {:.2}", found.amplitude_dn, found.amplitude_sd_dn),
        format!("{:.4} ± {:.4}", found.width_ratio, found.width_ratio_sd),
        format!("{:.4} ± {:.4}", found.thickness_m, found.thickness_sd_m),
        format!("{:.2}", found.deviation_ratio),
        flags::words(found.flags),
    ]
}

fn outgoing(explained: &ExplainedShot) -> String {
    let emission = &explained.emission;
    match &explained.outgoing {
        Some(seen) => format!(
            "outgoing pulse: emitted {:.4} ± {:.4} ns after the shot's clock, amplitude {:.1} DN, deviation ratio {:.2}\n",
            emission.emission_ns,
            emission.emission_sd_ns,
            seen.pulse.amplitude_dn,
            seen.pulse.deviation_ratio
        ),
        None => format!(
            "no outgoing pulse fitted: emission {:.4} ± {:.4} ns after the shot's clock\n",
            emission.emission_ns, emission.emission_sd_ns
        ),
    }
}

fn of_block(number: usize, block: &SeenBlock) -> String {
    let (samples, fit) = (&block.shown.samples, &block.fit);
    let start_ns = block.shown.first_ns;
    let mut text = format!(
        "block {number}: {} power, {} of {} ns from {start_ns:.3} ns of flight; background {:.2} DN; {} not used\n",
        fit.channel.name(),
        counted(samples.samples_dn.len(), "sample"),
        samples.interval_ns,
        samples.background_dn,
        counted(samples.left_out(), "sample"),
    );
    let counts = &fit.counts;
    let _ = writeln!(
        text,
        "  candidates: {} detected + {} added = {} kept + {} filtered + {} merged + {} dropped as cross-talk",
        counts.n_candidates,
        counts.n_added,
        counts.np,
        fit.filtered.total(),
        counts.np_merged,
        counts.np_xtalk_dropped
    );
    let filtered: Vec<String> = dropped_by_reason(&fit.filtered).collect();
    if !filtered.is_empty() {
        let _ = writeln!(text, "  filtered: {}", filtered.join(", "));
    }
    let excess = match fit.expected_excess {
        excess if excess >= 0.05 => format!(" (and {excess:.1} expected from the error of the response)"),
        _ => String::new(),
    };
    let _ = writeln!(
        text,
        "  chi-square {:.1}, {} degrees of freedom{excess}, deviation ratio {:.2}",
        fit.chi_square, fit.degrees_of_freedom, fit.deviation_ratio
    );
    text
}

/// Number and reason of dropped candidates, such as `2 too weak`.
fn dropped_by_reason(filtered: &Filtered) -> impl Iterator<Item = String> {
    filtered.counts().filter(|(_, n)| *n > 0).map(|(reason, n)| format!("{n} {reason}"))
}

fn sensor(explained: &ExplainedShot) -> String {
    let model = &explained.model;
    let channels = [
        ("low power", &model.low_power),
        ("high power", &model.high_power),
        ("outgoing pulse", &model.reference),
    ];
    let known = channels.iter().filter_map(|(name, channel)| channel.as_ref().map(|channel| (name, channel)));
    known.map(|(name, channel)| format!("sensor, {name}: {}\n", of_channel(channel))).collect()
}

/// Key parameters of a channel.
fn of_channel(channel: &ChannelModel) -> String {
    let list =
        |values: &[f64]| values.iter().map(|value| format!("{value:.2}")).collect::<Vec<_>>().join(" ");
    let background = match channel.background {
        Background::Fixed => "fixed",
        Background::PerWaveform => "per waveform",
    };
    let shape = match &channel.response {
        Some(response) => format!("response from {} single echoes", response.echoes),
        None => "assumed Gaussian".to_owned(),
    };
    format!(
        "background {} DN ({background}), noise {:.3} DN with correlations {}, pulse {:.3} ns wide ({shape}), \
         error factor on the pulse {:.2}, from {} waveforms",
        list(&channel.background_dn),
        channel.noise_sd_dn,
        if channel.autocorrelation.is_empty() { "none".to_owned() } else { list(&channel.autocorrelation) },
        channel.pulse_fwhm_ns,
        channel.pulse_error_factor,
        channel.waveforms
    )
}

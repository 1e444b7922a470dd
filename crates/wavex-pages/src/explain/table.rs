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

/// The complete text for a shot, in lines of at most this many characters, if it is given.
pub(super) fn table(explained: &ExplainedShot, width: Option<usize>) -> String {
    let width = width.unwrap_or(usize::MAX);
    let returns = of_returns(explained.returns.iter().map(row).collect(), width);
    let (title, rest) = (title(explained, &explained.file), remarks(explained));
    let wrapped = |text: &str| text.lines().map(|line| wrapped(line, width)).collect::<String>();
    format!("{}\n{returns}\n{}", wrapped(&title), wrapped(&rest))
}

/// Table with one row per return; with one column per return, where rows do not fit the width.
fn of_returns(rows: Vec<[String; 9]>, width: usize) -> String {
    let by_return: Vec<[String; 9]> = [HEADS.map(str::to_owned)].into_iter().chain(rows).collect();
    let text = columns(&by_return);
    if text.lines().all(|line| line.chars().count() <= width) {
        return text;
    }
    let longest = |row: &[String; 9]| row.iter().map(|cell| cell.chars().count()).max().unwrap_or(0);
    let (heads, returns) = by_return.split_at(1);
    let heads_chars = heads.iter().map(longest).max().unwrap_or(0);
    let return_chars = returns.iter().map(longest).max().unwrap_or(0) + GAP.len();
    let at_once = (width.saturating_sub(heads_chars) / return_chars).max(1);
    let group = |returns: &[[String; 9]]| {
        let quantities = (0..HEADS.len())
            .map(|i| heads.iter().chain(returns).map(|row| row[i].clone()).collect::<Vec<String>>());
        columns(&quantities.collect::<Vec<_>>())
    };
    returns.chunks(at_once).map(group).collect::<Vec<_>>().join("\n")
}

/// Characters between two columns.
const GAP: &str = "  ";

/// Rows with aligned cells.
pub(super) fn columns(rows: &[impl AsRef<[String]>]) -> String {
    let n = rows.first().map_or(0, |row| row.as_ref().len());
    let chars = |i: usize| rows.iter().map(|row| row.as_ref()[i].chars().count()).max().unwrap_or(0);
    let widths: Vec<usize> = (0..n).map(chars).collect();
    let line = |row: &[String]| {
        let padded = row.iter().zip(&widths).map(|(cell, width)| format!("{cell:<width$}"));
        format!("{}\n", padded.collect::<Vec<_>>().join(GAP).trim_end())
    };
    rows.iter().map(|row| line(row.as_ref())).collect()
}

/// A line as one or more lines of at most `width` characters; further ones are indented.
pub(super) fn wrapped(line: &str, width: usize) -> String {
    let indent = line.len() - line.trim_start().len();
    let mut text = " ".repeat(indent);
    let mut chars = indent;
    for word in line.split_whitespace() {
        let needed = word.chars().count() + usize::from(chars > indent);
        if chars > indent && chars.saturating_add(needed) > width {
            text.push_str(&format!("\n{}", " ".repeat(indent + 4)));
            chars = indent + 4;
        } else if chars > indent {
            text.push(' ');
            chars += 1;
        }
        text.push_str(word);
        chars += word.chars().count();
    }
    text + "\n"
}

/// Outgoing pulse, blocks, remarks and sensor model.
fn remarks(explained: &ExplainedShot) -> String {
    let mut text = String::new();
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_fits_the_width() {
        let row = |n: usize| HEADS.map(|head| format!("{head} of {n}"));
        let rows: Vec<[String; 9]> = (1..=3).map(row).collect();
        let longest = |text: &str| text.lines().map(|line| line.chars().count()).max();
        let wide = of_returns(rows.clone(), usize::MAX);
        assert_eq!(wide.lines().count(), 4);
        let narrow = of_returns(rows, 70);
        assert!(longest(&narrow) <= Some(70), "{narrow}");
        // Two groups of nine quantities, and an empty line between them.
        assert_eq!(narrow.lines().count(), 2 * 9 + 1, "{narrow}");
        assert!(narrow.contains("range, m of 3"));
    }

    #[test]
    fn lines_are_wrapped_between_words() {
        assert_eq!(wrapped("  ab cd ef", 8), "  ab cd\n      ef\n");
        assert_eq!(wrapped("a", 1), "a\n");
        assert_eq!(wrapped("", 10), "\n");
        assert_eq!(wrapped("  filtered: 1 explained", usize::MAX), "  filtered: 1 explained\n");
    }
}

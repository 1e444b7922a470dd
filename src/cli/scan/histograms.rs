//! Histograms as text: a commented header, then the centre of a bin and its count per line.

use std::fmt::Write;

use crate::batch::Channel;
use crate::survey::{Angle, Histogram, Samples, Survey};

/// The histograms that there is anything in: what their files' names end with, and their text.
pub(super) fn files(survey: &Survey) -> Vec<(&'static str, String)> {
    let all = [
        ("amplitudes", amplitudes(survey)),
        ("noise", noise(survey)),
        ("angles", angles(survey)),
        ("ranges", ranges(survey)),
    ];
    let text = |parts: Vec<Part>| parts.iter().map(Part::text).collect::<Vec<_>>().join("\n\n");
    all.into_iter().filter(|(_, parts)| !parts.is_empty()).map(|(what, parts)| (what, text(parts))).collect()
}

/// A histogram with what it is.
pub(super) struct Part<'a> {
    /// What is counted.
    pub(super) title: String,
    /// The quantity with its unit.
    pub(super) quantity: &'static str,
    pub(super) histogram: &'a Histogram,
    /// What the values count from.
    zero: f64,
}

impl Part<'_> {
    /// The bins, counted from the part's zero: centre and count.
    pub(super) fn bins(&self) -> impl ExactSizeIterator<Item = (f64, u64)> + Clone + '_ {
        self.histogram.bins().map(|(centre, count)| (centre - self.zero, count))
    }

    fn text(&self) -> String {
        let (title, quantity) = (&self.title, self.quantity);
        let (total, width) = (self.histogram.total(), self.histogram.width());
        let mut text =
            format!("# {title}: {total} values, bins {width} wide\n# centre of the bin: {quantity}\tcount\n");
        for (centre, count) in self.bins() {
            let _ = writeln!(text, "{}\t{count}", rounded(centre));
        }
        text
    }
}

/// Six digits behind the point at most.
fn rounded(value: f64) -> f64 {
    let rounded = (value * 1e6).round() / 1e6;
    // No minus before a zero.
    rounded + 0.0
}

/// All channels in the order of reports.
pub(super) const CHANNELS: [Channel; 4] =
    [Channel::LowPower, Channel::HighPower, Channel::Saturation, Channel::Reference];

/// A channel's name.
pub(super) fn name_of(channel: Channel) -> &'static str {
    match channel {
        Channel::HighPower => "high power",
        Channel::LowPower => "low power",
        Channel::Saturation => "saturation",
        Channel::Reference => "outgoing pulse",
    }
}

/// The channels whose samples were looked at.
pub(super) fn with_samples(survey: &Survey) -> impl Iterator<Item = (Channel, &Samples)> {
    let values = |channel| survey.channel(channel).values.as_ref().map(|values| (channel, values));
    CHANNELS.into_iter().filter_map(values).filter(|(_, values)| !values.peaks_dn().is_empty())
}

/// The highest sample of each block above the background, by channel.
pub(super) fn amplitudes(survey: &Survey) -> Vec<Part<'_>> {
    let part = |(channel, values): (Channel, &'_ Samples)| {
        let level_dn = values.level_dn();
        let quantity = match level_dn {
            Some(_) => "highest sample of a block above the background, DN",
            None => "highest sample of a block, background included, DN",
        };
        (format!("amplitudes, {}", name_of(channel)), quantity, level_dn.unwrap_or(0.0))
    };
    let parts = with_samples(survey).map(|found| (part(found), found.1.peaks_dn()));
    parts.map(|((title, quantity, zero), histogram)| Part { title, quantity, histogram, zero }).collect()
}

/// Samples of the receivers of echoes that are free of signal, by channel.
pub(super) fn noise(survey: &Survey) -> Vec<Part<'_>> {
    let receivers = with_samples(survey).filter(|(channel, values)| channel.is_echo() && values.free() > 0);
    let part =
        |(channel, values): (Channel, _)| (format!("samples free of signal, {}", name_of(channel)), values);
    let quantity = "sample, DN";
    receivers
        .map(part)
        .map(|(title, values): (String, &Samples)| Part {
            title,
            quantity,
            histogram: values.free_dn(),
            zero: 0.0,
        })
        .collect()
}

/// Angles of the beams.
pub(super) fn angles(survey: &Survey) -> Vec<Part<'_>> {
    let title = match survey.angle {
        Some(Angle::Scan) | None => "scan angles",
        Some(Angle::FromNadir) => "angles of the beams from straight down",
        Some(Angle::FromAxis) => "angles of the beams from the frame's third axis",
    };
    one(&survey.angles_deg, title, "angle of a shot, degrees")
}

/// Ranges of the highest peaks.
pub(super) fn ranges(survey: &Survey) -> Vec<Part<'_>> {
    let title = match (survey.ranges_from_first_sample(), survey.zones.contains_key(&None)) {
        (true, _) => "ranges from the first sample of each shot",
        (false, true) => "ranges from the emission before the reception",
        (false, false) => "ranges",
    };
    one(&survey.ranges_m, title, "range of a block's highest peak, m")
}

fn one<'a>(histogram: &'a Histogram, title: &str, quantity: &'static str) -> Vec<Part<'a>> {
    let part = || Part { title: title.to_owned(), quantity, histogram, zero: 0.0 };
    if histogram.is_empty() { Vec::new() } else { vec![part()] }
}

//! Histograms as text: commented header, then bin centre and count per line.

use std::fmt::Write;

use super::{Angle, GrowingHistogram, Inspection, SampleStatistics};
use wavex_line::scan_line::Channel;

/// Non-empty histograms: suffix of the file name, and text.
pub fn files(inspection: &Inspection) -> Vec<(&'static str, String)> {
    let all = [
        ("amplitudes", amplitudes(inspection)),
        ("noise", noise(inspection)),
        ("angles", angles(inspection)),
        ("ranges", ranges(inspection)),
    ];
    let text = |parts: Vec<LabelledHistogram>| {
        parts.iter().map(LabelledHistogram::text).collect::<Vec<_>>().join("\n\n")
    };
    all.into_iter().filter(|(_, parts)| !parts.is_empty()).map(|(what, parts)| (what, text(parts))).collect()
}

/// A histogram with its labels.
pub(super) struct LabelledHistogram<'a> {
    /// Title of the histogram.
    pub(super) title: String,
    /// Counted quantity with its unit.
    pub(super) quantity: &'static str,
    pub(super) histogram: &'a GrowingHistogram,
    /// Offset subtracted from the values.
    zero: f64,
}

impl LabelledHistogram<'_> {
    /// Bins as centre minus `zero`, and count.
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

/// Rounds to six decimal places.
fn rounded(value: f64) -> f64 {
    let rounded = (value * 1e6).round() / 1e6;
    // Turns -0 into 0.
    rounded + 0.0
}

/// All channels, in report order.
pub(super) const CHANNELS: [Channel; 4] =
    [Channel::LowPower, Channel::HighPower, Channel::Saturation, Channel::Reference];

/// Name of a channel in reports.
pub(super) fn name_of(channel: Channel) -> &'static str {
    match channel {
        Channel::HighPower => "high power",
        Channel::LowPower => "low power",
        Channel::Saturation => "saturation",
        Channel::Reference => "outgoing pulse",
    }
}

/// Channels with inspected samples.
pub(super) fn with_samples(inspection: &Inspection) -> impl Iterator<Item = (Channel, &SampleStatistics)> {
    let values = |channel| inspection.channel(channel).values.as_ref().map(|values| (channel, values));
    CHANNELS.into_iter().filter_map(values).filter(|(_, values)| !values.peaks_dn().is_empty())
}

/// Histograms of the highest sample of each block above background, by channel.
pub(super) fn amplitudes(inspection: &Inspection) -> Vec<LabelledHistogram<'_>> {
    let part = |(channel, values): (Channel, &'_ SampleStatistics)| {
        let level_dn = values.level_dn();
        let quantity = match level_dn {
            Some(_) => "highest sample of a block above the background, DN",
            None => "highest sample of a block, background included, DN",
        };
        (format!("amplitudes, {}", name_of(channel)), quantity, level_dn.unwrap_or(0.0))
    };
    let parts = with_samples(inspection).map(|found| (part(found), found.1.peaks_dn()));
    parts
        .map(|((title, quantity, zero), histogram)| LabelledHistogram { title, quantity, histogram, zero })
        .collect()
}

/// Histograms of signal-free samples of the echo receivers, by channel.
pub(super) fn noise(inspection: &Inspection) -> Vec<LabelledHistogram<'_>> {
    let receivers =
        with_samples(inspection).filter(|(channel, values)| channel.is_echo() && values.free() > 0);
    let part =
        |(channel, values): (Channel, _)| (format!("signal-free samples, {}", name_of(channel)), values);
    let quantity = "sample, DN";
    receivers
        .map(part)
        .map(|(title, values): (String, &SampleStatistics)| LabelledHistogram {
            title,
            quantity,
            histogram: values.free_dn(),
            zero: 0.0,
        })
        .collect()
}

/// Histogram of beam angles.
pub(super) fn angles(inspection: &Inspection) -> Vec<LabelledHistogram<'_>> {
    let title = match inspection.angle {
        Some(Angle::Scan) | None => "scan angles",
        Some(Angle::FromNadir) => "angles of the beams from nadir",
        Some(Angle::FromAxis) => "angles of the beams from the frame's third axis",
    };
    one(&inspection.angles_deg, title, "angle of a shot, degrees")
}

/// Histogram of the range of each block's highest peak.
pub(super) fn ranges(inspection: &Inspection) -> Vec<LabelledHistogram<'_>> {
    let title = match (inspection.ranges_from_first_sample(), inspection.zones.contains_key(&None)) {
        (true, _) => "ranges from the first sample of each shot",
        (false, true) => "ranges from the latest emission before reception",
        (false, false) => "ranges",
    };
    one(&inspection.ranges_m, title, "range of a block's highest peak, m")
}

fn one<'a>(
    histogram: &'a GrowingHistogram,
    title: &str,
    quantity: &'static str,
) -> Vec<LabelledHistogram<'a>> {
    let part = || LabelledHistogram { title: title.to_owned(), quantity, histogram, zero: 0.0 };
    if histogram.is_empty() { Vec::new() } else { vec![part()] }
}

//! Summary of a recording as numbers with stable names: `wavex scan --json`.

use std::path::Path;

use schemars::JsonSchema;
use serde::Serialize;

use super::histogram_files::{CHANNELS, name_of};
use super::{BeamSummary, GrowingHistogram, Inspection};
use wavex_geodesy::time::TimeScale;
use wavex_geodesy::time_axis::utc_of_gps;
use wavex_line::scan_line::{Channel, Frame};
use wavex_line::stage::Counters;

/// Summary of a recording; names carry the units. Unknown values are null.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct ScanSummary {
    /// Path as given.
    pub file: String,
    /// Size, bytes; null if it is no file.
    pub bytes: Option<u64>,
    /// Format and version.
    pub format: Option<String>,
    /// Name of the instrument.
    pub instrument: Option<String>,
    /// Serial number of the instrument.
    pub serial_number: Option<String>,
    /// Frame of positions and directions: scanner, body, map or earth.
    pub frame: Option<&'static str>,
    /// Coordinate reference system of the positions, WKT.
    pub crs_wkt: Option<String>,
    /// Scale of the times: week (s of the GPS week), day (s of the day), adjusted (GPS seconds minus 1e9).
    pub time_scale: Option<&'static str>,
    /// GPS week of the first shot.
    pub gps_week: Option<u32>,
    /// Group velocity of the pulse in air, m/s.
    pub group_velocity_mps: Option<f64>,
    /// Sampling interval, ns.
    pub sampling_interval_ns: Option<f64>,
    /// Largest value of the digitiser, DN.
    pub full_scale_dn: Option<u16>,
    /// Number of shots.
    pub shots: u64,
    /// Time of the first shot, s, on the time scale; of several beams, the earliest.
    pub first_shot_s: Option<f64>,
    /// Time of the last shot, s, on the time scale; of several beams, the latest.
    pub last_shot_s: Option<f64>,
    /// Time of the first shot, ISO 8601, UTC; null without a week.
    pub first_shot_utc: Option<String>,
    /// Largest minus smallest time, s.
    pub duration_s: Option<f64>,
    /// Shots without a time.
    pub shots_without_time: u64,
    /// Shots with an earlier time than the shot before, of the same beam.
    pub clock_backwards: u64,
    /// Gaps within scan lines: intervals of more than 2.5 usual ones.
    pub gaps_within_lines: u64,
    /// Gaps between scan lines.
    pub gaps_between_lines: u64,
    /// Pulse rate as the file states it, Hz.
    pub nominal_pulse_rate_hz: Option<f64>,
    /// Pulse rate by the usual interval of shots, Hz.
    pub pulse_rate_hz: Option<f64>,
    /// SD of the usual intervals, ns.
    pub interval_sd_ns: Option<f64>,
    /// Number of scan lines.
    pub scan_lines: u64,
    /// Shots per scan line.
    pub shots_per_line: Option<Distribution>,
    /// Facets of the mirror with their shots.
    pub facets: Vec<FacetCount>,
    /// Shots with echoes.
    pub shots_with_echoes: u64,
    /// Shots whose echo samples equal those of the shot before.
    pub copied_shots: u64,
    /// Returns that the instrument recorded.
    pub instrument_returns: u64,
    /// Echo blocks by the zone of their range ambiguity; null: unresolved.
    pub zones: Vec<ZoneCount>,
    /// Ranges of the highest peaks, m.
    pub range_m: Option<Distribution>,
    /// Scan angles, or angles from the vertical or the third axis, degrees.
    pub angle_deg: Option<Distribution>,
    /// Beams of an instrument that names them.
    pub beams: Vec<BeamSummary>,
    /// Recorded channels.
    pub channels: Vec<ChannelSummary>,
    /// Whether the recording was read to its end.
    pub read_to_end: bool,
    /// Error that ended the reading.
    pub error: Option<String>,
    /// What the reader rejected.
    pub rejected: Vec<RejectedCount>,
    /// Notes and findings of the reader.
    pub notes: Vec<String>,
}

/// Smallest, median and largest value.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, JsonSchema)]
pub struct Distribution {
    /// Smallest value.
    pub min: f64,
    /// Median; that of a histogram.
    pub median: f64,
    /// Largest value.
    pub max: f64,
}

/// Shots of a facet.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, JsonSchema)]
pub struct FacetCount {
    /// Number of the facet.
    pub facet: u16,
    /// Its shots.
    pub shots: u64,
}

/// Echo blocks of a zone.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, JsonSchema)]
pub struct ZoneCount {
    /// Zone of the range ambiguity; null: unresolved.
    pub zone: Option<i16>,
    /// Its echo blocks.
    pub blocks: u64,
}

/// Sample blocks of a channel.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct ChannelSummary {
    /// Name: outgoing pulse, low power, high power or saturation.
    pub name: &'static str,
    /// Number of blocks.
    pub blocks: u64,
    /// Number of samples.
    pub samples: u64,
    /// Samples per block.
    pub samples_per_block: Option<Distribution>,
    /// Time of the first sample after the shot's clock, ns.
    pub start_ns: Option<Distribution>,
    /// Background by sample index modulo 4, DN; null without samples free of signal.
    pub background_dn: Option<[f64; 4]>,
    /// Standard deviation of the noise, DN.
    pub noise_sd_dn: Option<f64>,
    /// Autocorrelation of the noise at lags 1 to 4.
    pub noise_autocorrelation: Vec<f64>,
    /// Highest sample of each block, background included, DN.
    pub peak_dn: Option<Distribution>,
    /// Samples at the largest value of the digitiser; null if that is unknown.
    pub saturated_samples: Option<u64>,
    /// Blocks with such samples.
    pub saturated_blocks: Option<u64>,
}

/// Items that the reader rejected for one reason.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, JsonSchema)]
pub struct RejectedCount {
    /// Kind of the items.
    pub item: String,
    /// Reason.
    pub reason: String,
    /// Number of items.
    pub count: u64,
}

impl Distribution {
    fn of(histogram: &GrowingHistogram) -> Option<Distribution> {
        let ([min, max], median) = histogram.range().zip(histogram.median())?;
        Some(Distribution { min, median, max })
    }
}

impl ScanSummary {
    /// `cut`: reason why the recording could not be read to its end.
    pub fn of(file: &Path, inspection: &Inspection, counters: &Counters, cut: Option<&str>) -> ScanSummary {
        let input = inspection.input.as_deref();
        let (times, shots) = (&inspection.times, &inspection.shots);
        let usual = times.shots.usual_ps().filter(|[mean_ps, _]| *mean_ps > 0.0);
        let times_s = inspection.first_last_s();
        let first_adjusted_s =
            input.zip(times_s).and_then(|(input, [first_s, _])| input.adjusted_gps_time(first_s));
        ScanSummary {
            file: file.display().to_string(),
            bytes: std::fs::metadata(file).ok().filter(std::fs::Metadata::is_file).map(|about| about.len()),
            format: input.map(|input| input.format.clone()),
            instrument: input.and_then(|input| input.instrument.clone()),
            serial_number: input.and_then(|input| input.serial.clone()),
            frame: input.map(|input| match input.frame {
                Frame::Scanner => "scanner",
                Frame::Body => "body",
                Frame::Map => "map",
                Frame::Earth => "earth",
            }),
            crs_wkt: input.and_then(|input| input.crs_wkt.clone()),
            time_scale: input.and_then(|input| match input.time_scale {
                TimeScale::Week => Some("week"),
                TimeScale::Day => Some("day"),
                TimeScale::Adjusted => Some("adjusted"),
                TimeScale::Unknown => None,
            }),
            gps_week: input.and_then(|input| input.gps_week),
            group_velocity_mps: input.map(|input| input.group_velocity_mps),
            sampling_interval_ns: input.map(|input| input.sampling_interval_ns),
            full_scale_dn: input.and_then(|input| input.full_scale_dn),
            shots: shots.count,
            first_shot_s: times_s.map(|[first_s, _]| first_s),
            last_shot_s: times_s.map(|[_, last_s]| last_s),
            first_shot_utc: first_adjusted_s.and_then(utc_of_gps),
            duration_s: times.range_s.map(|[least_s, largest_s]| largest_s - least_s),
            shots_without_time: times.without,
            clock_backwards: times.backwards.0,
            gaps_within_lines: times.shots.gaps(),
            gaps_between_lines: times.lines.gaps(),
            nominal_pulse_rate_hz: input.and_then(|input| input.pulse_rate_hz),
            pulse_rate_hz: usual.map(|[mean_ps, _]| 1e12 / mean_ps),
            interval_sd_ns: usual.map(|[_, sd_ps]| sd_ps * 1e-3),
            scan_lines: inspection.lines.count,
            shots_per_line: Distribution::of(&inspection.lines.shots),
            facets: shots.by_facet.iter().map(|(&facet, &shots)| FacetCount { facet, shots }).collect(),
            shots_with_echoes: shots.with_echoes,
            copied_shots: shots.copies,
            instrument_returns: shots.online[0],
            zones: inspection.zones.iter().map(|(&zone, &blocks)| ZoneCount { zone, blocks }).collect(),
            range_m: Distribution::of(&inspection.ranges_m),
            angle_deg: Distribution::of(&inspection.angles_deg),
            beams: inspection.beams.clone(),
            channels: CHANNELS.iter().filter_map(|channel| of_channel(inspection, *channel)).collect(),
            read_to_end: cut.is_none(),
            error: cut.map(str::to_owned),
            rejected: counters
                .rejected
                .iter()
                .map(|((item, reason), &count)| RejectedCount {
                    item: item.name().to_owned(),
                    reason: reason.to_string(),
                    count,
                })
                .collect(),
            notes: counters.notes.iter().chain(&counters.findings).cloned().collect(),
        }
    }

    /// One line of JSON.
    pub fn line(&self) -> String {
        serde_json::to_string(self).unwrap_or_default() + "\n"
    }
}

/// Summary of a channel; `None` without blocks.
fn of_channel(inspection: &Inspection, channel: Channel) -> Option<ChannelSummary> {
    let seen = inspection.channel(channel);
    let values = seen.values.as_ref();
    let noise = values.filter(|_| channel.is_echo());
    let saturated = values.and_then(|values| values.saturated());
    (seen.blocks > 0).then(|| ChannelSummary {
        name: name_of(channel),
        blocks: seen.blocks,
        samples: seen.samples,
        samples_per_block: Distribution::of(&seen.lengths),
        start_ns: Distribution::of(&seen.starts_ns),
        background_dn: noise.and_then(|values| values.background_dn()),
        noise_sd_dn: noise.and_then(|values| values.noise_sd_dn()),
        noise_autocorrelation: noise.map_or(Vec::new(), |values| values.noise_autocorrelation()),
        peak_dn: values.and_then(|values| Distribution::of(values.peaks_dn())),
        saturated_samples: saturated.map(|[samples, _]| samples),
        saturated_blocks: saturated.map(|[_, blocks]| blocks),
    })
}

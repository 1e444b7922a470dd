//! Inspection of a recording: statistics of its shots, lines, blocks and samples.
//!
//! [`Inspection`] receives the lines of a reader in a single pass. Everything it keeps has a fixed
//! size: counts, histograms whose bins double their width, and a few shots. The result depends only
//! on the lines.

use std::collections::BTreeMap;
use std::sync::Arc;

use wavex_geodesy::vertical::down_at;
use wavex_line::scan_line::{
    Block, Blocks, Channel, Emission, EmissionReference, Frame, InputInfo, ScanLine, emission_flags,
    has_large_footprints,
};

mod beams;
mod dates;
mod figures;
mod histogram;
mod histogram_files;
mod intervals;
mod json;
mod page;
mod plan_view;
mod reservoir;
mod samples;
mod summary;
#[cfg(test)]
mod tests;

pub use beams::BeamSummary;
pub use histogram::GrowingHistogram;
pub use histogram_files::files as histogram_files;
pub use intervals::{Intervals, LongInterval};
pub use json::{ChannelSummary, Distribution, FacetCount, RejectedCount, ScanSummary, ZoneCount};
pub use page::page;
pub use plan_view::PlanView;
pub use reservoir::Thinned;
pub use samples::{BlockPeak, SampleStatistics, peak_of};
pub use summary::{RecordingSummary, SummarySection};

/// Maximum number of bins of a histogram.
const BINS: usize = 400;
/// Maximum number of shots whose angles, and whose waveforms, are kept.
const ANGLES: usize = 4000;
const WAVEFORMS: usize = 8;
/// Maximum number of samples kept per block.
const SHOWN_SAMPLES: usize = 1000;
/// Minimum distance from the origin that indicates geocentric coordinates, m.
const NO_MAP_M: f64 = 5e6;

/// Statistics of a recording.
#[derive(Debug)]
pub struct Inspection {
    /// Metadata of the recording; `None` before the first line.
    pub input: Option<Arc<InputInfo>>,
    /// Whether samples are inspected.
    pub with_samples: bool,
    /// Whether samples are fractions of a digitiser step, which are not evaluated.
    pub has_fractions: bool,
    /// Shot counts.
    pub shots: Shots,
    /// Times of the shots.
    pub times: Times,
    /// Beams of an instrument that names them, in the order of the recording.
    pub beams: Vec<BeamSummary>,
    /// Scan lines.
    pub lines: LineStatistics,
    /// Channels, in the order of [`Channel`].
    pub channels: [ChannelInspection; 4],
    /// Echo blocks per shot.
    pub blocks_per_shot: GrowingHistogram,
    /// Echo blocks by zone; `None` means unresolved.
    pub zones: BTreeMap<Option<i16>, u64>,
    /// Beam angles, degrees.
    pub angles_deg: GrowingHistogram,
    /// Definition of the beam angles; `None` without any.
    pub angle: Option<Angle>,
    /// Time since the first shot (s) and angle (degrees) of selected shots.
    pub angles_over_time: Thinned<[f64; 2]>,
    /// Times of echo blocks since the first shot, s.
    pub blocks_over_time_s: GrowingHistogram,
    /// Ranges of the highest peak of each echo block, m.
    pub ranges_m: GrowingHistogram,
    /// Echoes and sensor from above.
    pub plan: PlanView,
    /// Selected shots with their blocks.
    pub waveforms: Thinned<Waveform>,
}

/// Shot counts.
#[derive(Debug, Default)]
pub struct Shots {
    /// All shots.
    pub count: u64,
    /// Shots with at least one echo block.
    pub with_echoes: u64,
    /// Shots fired while the mirror moved in the positive direction.
    pub positive_direction: u64,
    /// Shots synchronised with GPS.
    pub synchronised: u64,
    /// Shots synchronised within the last second.
    pub synchronised_within_last_second: u64,
    /// Shots by mirror facet.
    pub by_facet: BTreeMap<u16, u64>,
    /// Number of online returns, and of shots with any.
    pub online: [u64; 2],
    /// Shots whose waveforms are copies of the previous shot's waveforms.
    pub copies: u64,
}

/// Times of shots.
#[derive(Debug, Default)]
pub struct Times {
    /// GPS times of the first and last shot that have one, s.
    pub first_last_s: Option<[f64; 2]>,
    /// The earliest and latest of them, s.
    pub range_s: Option<[f64; 2]>,
    /// Number of shots without a time.
    pub without: u64,
    /// Number of backward steps of the clock within a beam, and the first shot after one.
    pub backwards: (u64, Option<u64>),
    /// Intervals between shots within a line.
    pub shots: Intervals,
    /// Intervals between the first shots of consecutive lines.
    pub lines: Intervals,
    last: Option<(i64, u64)>,
    line_start_ps: Option<i64>,
    first_clock_ps: Option<i64>,
}

/// Scan lines.
#[derive(Debug)]
pub struct LineStatistics {
    /// Number of lines.
    pub count: u64,
    /// Shots per line.
    pub shots: GrowingHistogram,
    /// Number of the current line, and its shots so far.
    at: Option<(u32, u64)>,
}

/// Statistics of one channel.
#[derive(Debug)]
pub struct ChannelInspection {
    /// Number of sample blocks.
    pub blocks: u64,
    /// Number of samples.
    pub samples: u64,
    /// Samples per block.
    pub lengths: GrowingHistogram,
    /// Time of a block's first sample after the shot's clock, ns.
    pub starts_ns: GrowingHistogram,
    /// Smallest and largest gain of a block.
    pub gains: [f64; 2],
    /// Sample statistics, if samples are inspected.
    pub values: Option<SampleStatistics>,
}

/// Definition of a beam angle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Angle {
    /// The recorded scan angle, positive to the right.
    Scan,
    /// From straight down; never negative.
    FromNadir,
    /// From the third axis of the frame, in either direction; never negative.
    FromAxis,
}

/// A selected shot.
#[derive(Clone, Debug, PartialEq)]
pub struct Waveform {
    /// Shot number.
    pub shot: u64,
    /// Its echo blocks.
    pub blocks: Vec<ShownBlock>,
}

/// A block of a selected shot.
#[derive(Clone, Debug, PartialEq)]
pub struct ShownBlock {
    /// The receiver.
    pub channel: Channel,
    /// Time of the first sample after the shot's clock, ns.
    pub start_ns: f64,
    /// Time between samples, ns.
    pub interval_ns: f64,
    /// At most 1000 samples, DN.
    pub samples_dn: Vec<u16>,
}

impl Inspection {
    /// Creates empty statistics; samples are inspected if `with_samples`.
    pub fn new(with_samples: bool) -> Inspection {
        let channel = || ChannelInspection {
            blocks: 0,
            samples: 0,
            lengths: GrowingHistogram::of_whole_numbers(BINS),
            starts_ns: GrowingHistogram::new(0.125, BINS),
            gains: [f64::INFINITY, f64::NEG_INFINITY],
            values: None,
        };
        Inspection {
            input: None,
            with_samples,
            has_fractions: false,
            shots: Shots::default(),
            times: Times::default(),
            beams: Vec::new(),
            lines: LineStatistics { count: 0, shots: GrowingHistogram::of_whole_numbers(8192), at: None },
            channels: [channel(), channel(), channel(), channel()],
            blocks_per_shot: GrowingHistogram::of_whole_numbers(64),
            zones: BTreeMap::new(),
            angles_deg: GrowingHistogram::new(0.125, BINS),
            angle: None,
            angles_over_time: Thinned::new(ANGLES),
            blocks_over_time_s: GrowingHistogram::new(1.0 / 1024.0, BINS),
            ranges_m: GrowingHistogram::new(0.125, BINS),
            plan: PlanView::default(),
            waveforms: Thinned::new(WAVEFORMS),
        }
    }

    /// Adds a line.
    pub fn add(&mut self, scan_line: &ScanLine) {
        if self.input.is_none() {
            let full_scale_dn = scan_line.input.full_scale_dn;
            for channel in self.channels.iter_mut().filter(|_| self.with_samples) {
                channel.values = Some(SampleStatistics::new(full_scale_dn));
            }
            self.input = Some(Arc::clone(&scan_line.input));
        }
        self.add_to_beam(scan_line);
        let none = Blocks::default();
        let blocks = scan_line.blocks().unwrap_or(&none);
        self.has_fractions |= blocks.has_fractions();
        let mut by_emission = blocks.by_emission().peekable();
        let is_new_line = self.lines.at.is_none_or(|(line, _)| line != scan_line.line);
        for (index, emission) in scan_line.emissions.iter().enumerate() {
            self.add_shot(scan_line, emission, is_new_line && index == 0);
            let of_shot = by_emission.next_if(|(of, _)| *of as usize == index).map_or(&[][..], |(_, of)| of);
            self.add_blocks(scan_line, emission, blocks, of_shot);
            let online = blocks.online_of(index as u32).len() as u64;
            self.shots.online[0] += online;
            self.shots.online[1] += u64::from(online > 0);
        }
    }

    /// Ends the input.
    pub fn finish(&mut self) {
        self.lines.end();
        self.times.shots.finish();
        self.times.lines.finish();
        self.channels
            .iter_mut()
            .filter_map(|channel| channel.values.as_mut())
            .for_each(SampleStatistics::finish);
    }

    /// Measured pulse rate, Hz.
    pub fn pulse_rate_hz(&self) -> Option<f64> {
        let [mean_ps, _] = self.times.shots.usual_ps()?;
        (mean_ps > 0.0).then(|| 1e12 / mean_ps)
    }

    /// Median length of the waveforms of the low-power channel, samples.
    pub fn waveform_samples(&self) -> Option<f64> {
        self.channel(Channel::LowPower).lengths.median()
    }

    /// Whether the footprints are large ([`has_large_footprints`]).
    pub fn has_large_footprints(&self) -> bool {
        let Some(input) = self.input.as_deref() else { return false };
        let length_ns =
            self.waveform_samples().map_or(f64::NAN, |samples| samples * input.sampling_interval_ns);
        let rate_hz = self.pulse_rate_hz().unwrap_or(f64::NAN);
        has_large_footprints(input.instrument.as_deref(), length_ns, rate_hz)
    }

    /// Statistics of a channel.
    pub fn channel(&self, channel: Channel) -> &ChannelInspection {
        &self.channels[channel as usize]
    }

    /// Times of the first and last shot, s; of several beams, which follow each other, the earliest and latest.
    pub fn first_last_s(&self) -> Option<[f64; 2]> {
        if self.beams.len() > 1 { self.times.range_s } else { self.times.first_last_s }
    }

    /// Whether ranges count from near the waveform, for lack of a sensor position.
    pub fn ranges_from_first_sample(&self) -> bool {
        self.input.as_ref().is_some_and(|input| !input.origin_is_sensor)
    }

    /// Adds a line to its beam; the clock of another beam begins anew.
    fn add_to_beam(&mut self, scan_line: &ScanLine) {
        let name = scan_line.input.beam.as_deref();
        if self.beams.last().map(|beam| beam.name.as_str()) != name {
            self.beams.extend(BeamSummary::of(scan_line));
            self.times.begin_beam();
        }
        if let Some(beam) = self.beams.last_mut() {
            beam.add(scan_line);
        }
    }

    fn add_shot(&mut self, scan_line: &ScanLine, emission: &Emission, begins_line: bool) {
        if begins_line {
            self.lines.begin(scan_line.line);
        }
        self.lines.add_shot();
        self.times.add(emission, begins_line);
        let shots = &mut self.shots;
        shots.count += 1;
        *shots.by_facet.entry(emission.facet).or_default() += 1;
        let has = |flag: u16| u64::from(emission.flags & flag != 0);
        shots.synchronised += has(emission_flags::SYNCHRONISED);
        shots.synchronised_within_last_second += has(emission_flags::SYNCHRONISED_WITHIN_LAST_SECOND);
        shots.copies += has(emission_flags::COPY);
        shots.positive_direction += has(emission_flags::SCAN_DIRECTION_POSITIVE);
        let (angle, deg) = angle_of(emission, scan_line.input.frame);
        self.angle = self.angle.or(Some(angle)).filter(|_| deg.is_finite()).or(self.angle);
        self.angles_deg.add(deg);
        let time_s = self.times.since_first_s(emission);
        if deg.is_finite() && time_s.is_finite() {
            self.angles_over_time.add(|| [time_s, deg]);
        }
    }

    fn add_blocks(&mut self, scan_line: &ScanLine, emission: &Emission, blocks: &Blocks, of_shot: &[Block]) {
        let echoes = of_shot.iter().filter(|block| block.channel.is_echo()).count();
        self.blocks_per_shot.add(echoes as f64);
        self.shots.with_echoes += u64::from(echoes > 0);
        let mut emission_ns = 0.0;
        if self.with_samples {
            let reference = of_shot.iter().find(|block| block.channel == Channel::Reference);
            emission_ns =
                reference.map_or(0.0, |block| emission_ns_of(block, blocks.samples(block), &scan_line.input));
        }
        let time_s = self.times.since_first_s(emission);
        for block in of_shot {
            let channel = &mut self.channels[block.channel as usize];
            let peak = channel.add(block, blocks.samples(block), emission.is_copy());
            if !block.channel.is_echo() {
                continue;
            }
            *self.zones.entry(block.zone.or(emission.mta_zone)).or_default() += 1;
            self.blocks_over_time_s.add(time_s);
            let position = peak.as_ref().map_or(0.0, |peak| peak.position_samples);
            let flight_ns = block.time_ns(position) - emission_ns;
            self.plan.add(&scan_line.input, emission, flight_ns);
            if peak.is_some() {
                self.ranges_m.add(flight_ns * 0.5e-9 * scan_line.input.group_velocity_mps);
            }
        }
        if self.with_samples && echoes > 0 {
            self.waveforms.add(|| Waveform::of(emission.shot, blocks, of_shot));
        }
    }
}

impl ChannelInspection {
    /// Adds a block; sample statistics leave copies out.
    fn add(&mut self, block: &Block, samples: &[u16], is_copy: bool) -> Option<BlockPeak> {
        self.blocks += 1;
        self.samples += block.len() as u64;
        self.lengths.add(block.len() as f64);
        self.starts_ns.add(block.start_ns);
        self.gains = [self.gains[0].min(block.gain), self.gains[1].max(block.gain)];
        match &mut self.values {
            Some(values) if !is_copy => values.add(samples),
            Some(_) => peak_of(samples),
            None => None,
        }
    }
}

impl Times {
    fn add(&mut self, emission: &Emission, begins_line: bool) {
        let time_s = emission.gps_time_s;
        if time_s.is_finite() {
            let first = self.first_last_s.map_or(time_s, |[first, _]| first);
            self.first_last_s = Some([first, time_s]);
            let [least, largest] = self.range_s.unwrap_or([time_s, time_s]);
            self.range_s = Some([least.min(time_s), largest.max(time_s)]);
        } else {
            self.without += 1;
        }
        let clock_ps = emission.clock_ps;
        self.first_clock_ps.get_or_insert(clock_ps);
        let since = |earlier_ps: i64| u64::try_from(clock_ps.saturating_sub(earlier_ps)).ok();
        match self.last.map(|(last_ps, _)| since(last_ps)) {
            Some(None) => {
                self.backwards.0 += 1;
                self.backwards.1.get_or_insert(emission.shot);
            }
            Some(Some(ps)) if !begins_line => self.shots.add(ps, emission.shot, time_s),
            _ => {}
        }
        if begins_line {
            if let Some(ps) = self.line_start_ps.and_then(since) {
                self.lines.add(ps, emission.shot, time_s);
            }
            self.line_start_ps = Some(clock_ps);
        }
        self.last = Some((clock_ps, emission.shot));
    }

    /// Forgets the last shot and line: intervals to another beam have no meaning.
    fn begin_beam(&mut self) {
        (self.last, self.line_start_ps) = (None, None);
    }

    /// Time since the first shot, s: GPS time if available, else the instrument clock.
    fn since_first_s(&self, emission: &Emission) -> f64 {
        match self.first_last_s {
            Some([first_s, _]) => emission.gps_time_s - first_s,
            None => (emission.clock_ps as f64 - self.first_clock_ps.unwrap_or(0) as f64) * 1e-12,
        }
    }
}

impl LineStatistics {
    fn begin(&mut self, line: u32) {
        self.end();
        self.count += 1;
        self.at = Some((line, 0));
    }

    fn add_shot(&mut self) {
        if let Some((_, shots)) = &mut self.at {
            *shots += 1;
        }
    }

    fn end(&mut self) {
        if let Some((_, shots)) = self.at.take() {
            self.shots.add(shots as f64);
        }
    }
}

impl Waveform {
    fn of(shot: u64, blocks: &Blocks, of_shot: &[Block]) -> Waveform {
        let shown = |block: &Block| ShownBlock {
            channel: block.channel,
            start_ns: block.start_ns,
            interval_ns: block.interval_ns,
            samples_dn: blocks.samples(block).iter().take(SHOWN_SAMPLES).copied().collect(),
        };
        Waveform { shot, blocks: of_shot.iter().filter(|block| block.channel.is_echo()).map(shown).collect() }
    }
}

/// Emission time after the shot's clock, ns, from the peak of the outgoing pulse.
fn emission_ns_of(block: &Block, samples: &[u16], input: &InputInfo) -> f64 {
    let Some(peak) = peak_of(samples) else { return 0.0 };
    match input.emission_reference {
        EmissionReference::OutgoingPulse => block.time_ns(peak.position_samples),
        EmissionReference::OutgoingPulseFraction => {
            (peak.position_samples - peak.position_samples.round()) * block.interval_ns
        }
        EmissionReference::ReturnLocations | EmissionReference::Clock => 0.0,
    }
}

/// Angle of a beam, degrees, and its definition.
fn angle_of(emission: &Emission, frame: Frame) -> (Angle, f64) {
    if emission.scan_angle_deg.is_finite() {
        return (Angle::Scan, f64::from(emission.scan_angle_deg));
    }
    let [x, y, z] = emission.direction;
    if frame == Frame::Earth {
        let down = down_at(frame, emission.origin_m).unwrap_or([x, y, z]);
        let cosine = x * down[0] + y * down[1] + z * down[2];
        return (Angle::FromNadir, cosine.clamp(-1.0, 1.0).acos().to_degrees());
    }
    if frame != Frame::Map {
        return (Angle::FromAxis, z.abs().min(1.0).acos().to_degrees());
    }
    let origin = emission.origin_m;
    let distance_m = origin.iter().map(|x| x * x).sum::<f64>().sqrt();
    let is_geocentric = distance_m > NO_MAP_M && origin[2].abs() > 50_000.0;
    let down = if is_geocentric { origin.map(|x| -x / distance_m) } else { [0.0, 0.0, -1.0] };
    let cosine = x * down[0] + y * down[1] + z * down[2];
    (Angle::FromNadir, cosine.clamp(-1.0, 1.0).acos().to_degrees())
}

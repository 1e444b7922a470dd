//! `read_pulsewaves`: reads PulseWaves files as scan lines of shots.

mod description;

use std::collections::BTreeSet;
use std::path::Path;
use std::sync::Arc;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::reading::bad_records::BrokenRun;
use crate::reading::emission_choice::{self, ChoiceMessage, Smoothness};
use crate::reading::line_splitter::LineSplitter;
use crate::reading::plausible;
use crate::reading::recording::units::RecordingUnits;
use crate::reading::recording::{
    AsDeclared, Declared, FullScale, InputCrs, OddSamples, PulseSpeed, Sampling, TimeKeys,
};
use description::{describe, recorded_crs};
use wavex_formats::pulsewaves::{PulseRecord, Reader, Segment, SegmentKind, TimeAxis, WaveSegments};
use wavex_geodesy::beam_length::BeamLength;
use wavex_line::keys::InvalidKey;
use wavex_line::scan_line::{Channel, Emission, EmissionReference, Kind, ScanLine, emission_flags};
use wavex_line::stage::{
    Config, Context, LineLocation, Paths, Reason, Result, RunContext, Source, SourceConfig, StageSpec,
};
use wavex_simd::statistics::median;

/// Registry entry of the stage.
pub const STAGE: StageSpec = StageSpec::source::<ReadPulseWaves>("read_pulsewaves", Kind::Shots);

/// Reads PulseWaves 0.3: a `.pls` file of pulses and its `.wvs` file of waveforms.
///
/// Both may be compressed: `.plz` and `.wvz`.
///
/// Every pulse becomes a shot and every segment of samples a sample block. Outgoing segments become
/// the reference channel. Returning channels follow RIEGL's files: 0 is high power, 1 is low power;
/// a single returning channel is low power. Amplitude tables (digitiser steps to dB) are adopted
/// from the file.
///
/// Beams are stored as two points rounded to the file's grid. If rounding alone explains their
/// differences, the beam length per nanosecond is averaged over the file. This avoids errors of up
/// to 14 mm at a range of 500 m on a grid of 1 cm.
///
/// The time of emission is that of the outgoing pulse. Many files do not state the time of its first
/// sample: the pulse then starts at the anchor, or the anchor is the whole sample nearest to its
/// peak (RIEGL's files of 2013), or times count from the anchor alone because they are already
/// corrected (GeoLas, NASA LVIS). The reader decides from the data: with a wrong choice, points of
/// neighbouring single echoes scatter along the beam. It reads up to 100 000 shots ahead, until it has
/// 5000 triples of consecutive single echoes, and computes the robust standard deviation of their second
/// differences for each choice. A choice is ruled out if another has less than 0.8 of its second
/// differences in both halves of the triples. The default (the outgoing pulse if its start is stated,
/// otherwise the fraction of a sample) is kept unless it is ruled out. The report gives the three figures
/// and the choice; if other choices remain, or with fewer than 100 triples, it warns, and standard
/// deviations of ranges include the spread of the remaining choices.
///
/// The same second differences bound the jitter of the anchors from above, for files without outgoing
/// pulses too. If the bound is below that of a position within one sample, standard deviations of ranges
/// that count from the anchor include the bound instead (`emission_jitter_ns` of `decompose`).
///
/// If points are smooth by the anchor alone but ranges by the outgoing pulse (GeoLas), the anchors of
/// the file move with the pulse. The origin of each shot is then moved along the beam to the peak of its
/// outgoing pulse, and ranges count from there; points do not change.
///
/// Ranges count from the sensor if the descriptors place the anchors of the pulses at the optical
/// centre and durations from there are stored (RIEGL, GeoLas, Optech). Files converted from LAS and
/// files of NASA LVIS anchor pulses at their first sample: coordinates are not affected, but
/// `correct` cannot correct intensities for range and attenuation.
///
/// The format has no scan angles, and does not define the sense of its mirror direction flag: both
/// are computed from the beams and the course (`docs/reference/las.md`). The last shot of each scan line gets
/// the edge-of-flight-line flag.
///
/// Rejects pulses whose waveforms cannot be read, and continues with the next. A file that ends
/// with such pulses is truncated, which is an error.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ReadPulseWaves {
    /// The `.pls` or `.plz` file, a list of files, or a pattern.
    pub path: Paths,
    /// Timing of the samples of a block.
    #[serde(flatten)]
    pub odd_samples: OddSamples,
    /// Range of the samples.
    #[serde(flatten)]
    pub full_scale: FullScale,
    /// Speed of the pulse.
    #[serde(flatten)]
    pub pulse_speed: PulseSpeed,
    /// Coordinate reference system of the recording.
    #[serde(flatten)]
    pub input_crs: InputCrs,
    /// Time of emission: decided from the data, peak of the outgoing pulse, its fraction of a sample, or
    /// the anchor alone. Without effect for files without outgoing pulses.
    #[serde(default)]
    pub emission: PulseEmission,
    /// Times of the recording.
    #[serde(flatten)]
    pub times: TimeKeys,
}

/// Time of emission of a PulseWaves file.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum PulseEmission {
    /// The choice with the smoothest points.
    #[default]
    Auto,
    /// Peak of the outgoing pulse; its block starts at the anchor if the file does not state its start.
    OutgoingPulse,
    /// Fraction of a sample of the peak; the anchor is the nearest sample.
    OutgoingPulseFraction,
    /// The anchor of the pulse.
    Clock,
}

impl Config for ReadPulseWaves {
    fn check(&self) -> std::result::Result<(), InvalidKey> {
        self.times.check()?;
        self.input_crs.check()
    }

    fn inputs(&self) -> Vec<&str> {
        self.input_crs.file()
    }
}

impl SourceConfig for ReadPulseWaves {
    fn paths(&self) -> Option<&Paths> {
        Some(&self.path)
    }

    fn make(&self, run: &RunContext) -> Result<Box<dyn Source>> {
        let (mut source, declared) = self.open(run)?;
        source.reader.check_complete()?;
        source.choose_emission(self.emission);
        Ok(Box::new(AsDeclared::new(source, declared)))
    }

    fn make_for_inspection(&self, run: &RunContext, with_samples: bool) -> Result<Box<dyn Source>> {
        let (mut source, declared) = self.open(run)?;
        source.with_samples = with_samples;
        if with_samples {
            source.choose_emission(self.emission);
        }
        Ok(Box::new(AsDeclared::new(source, declared)))
    }
}

impl ReadPulseWaves {
    fn open(&self, run: &RunContext) -> Result<(PulseWavesReader, Declared)> {
        let mut declared = Declared::new(&self.times, &self.input_crs, self.pulse_speed, run)?;
        let of_job = declared.crs_wkt.as_deref();
        let mut source = PulseWavesReader::open(
            &run.input,
            &run.stem,
            Sampling(self.odd_samples, self.full_scale),
            of_job,
        )?;
        if self.times.recording_time.is_some() {
            source.time_shift_s = 0.0;
        }
        declared.crs_wkt = declared.crs_wkt.map(|wkt| source.units.converted(wkt));
        Ok((source, declared))
    }
}

/// Part of the waves file in which the waves of pulses begin at least, if it is theirs …
const LEAST_USED_WAVES: f64 = 0.5;
/// … and fewest pulses that show it: the waves of the last one take little of the file.
const FEWEST_PULSES: u64 = 10;

struct PulseWavesReader {
    reader: Reader,
    /// If false, the waves file is not read and shots have no blocks.
    with_samples: bool,
    /// Added to pulse times, s, to give seconds of the GPS week or adjusted GPS time.
    time_shift_s: f64,
    next_pulse: u64,
    waves: WaveSegments,
    lines: LineSplitter,
    beams: BeamLength,
    units: RecordingUnits,
    receivers: FileReceivers,
    first_t: i64,
    /// The shot that begins the next line, and its sampling unit, ns.
    last_seen: Option<(Emission, f64)>,
    /// Last byte of the waves file at which the waves of a pulse start.
    last_waves_at: u64,
    broken: BrokenRun,
    /// Correction of times and origins that the choice of the emission reference requires.
    clock: ClockShift,
    /// Message about the emission reference, until it is reported.
    message: Option<ChoiceMessage>,
    /// Whether the writer of the file stores outgoing pulses of 16 bits in 8 …
    has_outgoing_bytes: bool,
    /// … and the number of such pulses read.
    outgoing_bytes_pulses: u64,
}

/// Shift of a shot's clock to its emission.
#[derive(Clone, Copy)]
enum ClockShift {
    /// To a constant time after the anchor, ns.
    Constant(f64),
    /// To the peak of the outgoing pulse, with the origin; to this time if it has none, ns.
    WithOrigin(f64),
}

/// Maps the returning channels of a file to receivers.
struct FileReceivers {
    single: bool,
}

impl FileReceivers {
    fn of(&self, segment: &Segment) -> Option<Channel> {
        match (segment.kind, segment.channel) {
            (SegmentKind::Outgoing, _) => Some(Channel::Reference),
            (SegmentKind::Returning, _) if self.single => Some(Channel::LowPower),
            (SegmentKind::Returning, 0) => Some(Channel::HighPower),
            (SegmentKind::Returning, 1) => Some(Channel::LowPower),
            (SegmentKind::Returning, 2) => Some(Channel::Saturation),
            _ => None,
        }
    }
}

/// Number of pulses, spread over the file, used to determine beam lengths.
const BEAMS_LOOKED_AT: u64 = 10_000;
/// Sampling units between the anchor and the target of a pulse (PulseWaves 0.3, "Pulse Record").
const UNITS_TO_TARGET: f64 = 1000.0;
/// Writer whose files declare the outgoing and the returning samples of bright pulses with 16 bits
/// but store the outgoing ones with 8.
const OUTGOING_BYTES_WRITER: &str = "PULSEreaderGCW";

/// Largest plausible height, m; a larger third coordinate means a geocentric frame.
const NO_HEIGHT_M: f64 = 50_000.0;
/// Distance of ground and aircraft from the centre of the earth, m.
const EARTH_M: std::ops::Range<f64> = 6.35e6..6.41e6;

impl PulseWavesReader {
    fn open(
        path: &Path,
        stem: &str,
        sampling: Sampling,
        declared_crs: Option<&str>,
    ) -> Result<PulseWavesReader> {
        let mut reader = Reader::open(path)?;
        let of_file = recorded_crs(&reader);
        let units = RecordingUnits::of(declared_crs.or(of_file.wkt.as_deref()));
        let (beams, metres_per_ns, around_earth) = look_at_beams(&mut reader, units)?;
        let crs = units.describe(of_file, declared_crs.is_some());
        let single = returning_channels(&reader).len() < 2;
        let input = sampling.with(describe(&reader, path, stem, &beams, (units, crs, around_earth)));
        if reader.pulse_count() > 0 {
            plausible::check_interval(
                input.sampling_interval_ns,
                "export the file again with its sample units in nanoseconds",
            )?;
            plausible::check_velocity(
                2e9 * metres_per_ns,
                "the beams of the pulses",
                "export the file again with targets 1000 sample units from their anchors, in the direction of the beam",
            )?;
        }
        let input = Arc::new(input);
        let first_t = reader.header().min_t;
        let has_outgoing_bytes = reader.header().generating_software.contains(OUTGOING_BYTES_WRITER);
        let time_shift_s = match reader.header().time_axis() {
            TimeAxis::Standard => -wavex_geodesy::time::ADJUSTMENT_S,
            TimeAxis::WeekSeconds | TimeAxis::Undecided => 0.0,
        };
        Ok(PulseWavesReader {
            reader,
            with_samples: true,
            time_shift_s,
            next_pulse: 0,
            waves: WaveSegments::new(),
            lines: LineSplitter::new(input).marking_edges(),
            beams,
            units,
            receivers: FileReceivers { single },
            first_t,
            last_seen: None,
            last_waves_at: 0,
            broken: BrokenRun::default(),
            clock: ClockShift::Constant(0.0),
            message: None,
            has_outgoing_bytes,
            outgoing_bytes_pulses: 0,
        })
    }

    /// Decides on the emission reference from the first shots, and begins anew.
    fn choose_emission(&mut self, key: PulseEmission) {
        let default = self.lines.input().emission_reference;
        let has_outgoing = default != EmissionReference::Clock;
        let is_stated = default == EmissionReference::OutgoingPulse;
        let references = if has_outgoing { emission_choice::WITH_OUTGOING } else { emission_choice::WITHOUT };
        let smoothness = Smoothness::look_ahead(self, references);
        let choice = match key {
            _ if !has_outgoing => smoothness.take(EmissionReference::Clock),
            PulseEmission::Auto => smoothness.choose(default, is_stated),
            PulseEmission::OutgoingPulse => smoothness.set(EmissionReference::OutgoingPulse),
            PulseEmission::OutgoingPulseFraction => smoothness.set(EmissionReference::OutgoingPulseFraction),
            PulseEmission::Clock => smoothness.set(EmissionReference::Clock),
        };
        let outgoing_ns = smoothness.outgoing_ns();
        self.clock = match choice.reference {
            EmissionReference::OutgoingPulse if !is_stated => ClockShift::Constant(outgoing_ns),
            EmissionReference::Clock
                if self.lines.input().origin_is_sensor && smoothness.origins_follow_outgoing() =>
            {
                ClockShift::WithOrigin(outgoing_ns)
            }
            _ => ClockShift::Constant(0.0),
        };
        self.lines = LineSplitter::new(Arc::new(choice.describe(self.lines.input()))).marking_edges();
        self.message = choice.message;
        self.broken = BrokenRun::default();
        (self.next_pulse, self.last_seen, self.outgoing_bytes_pulses) = (0, None, 0);
    }

    /// Time from the anchor of the current pulse to its clock, ns.
    fn clock_ns(&self, unit_ns: f64) -> f64 {
        match self.clock {
            ClockShift::Constant(shift_ns) => shift_ns,
            ClockShift::WithOrigin(usual_ns) => {
                let mut segments = self.waves.segments().iter();
                let outgoing = segments.find(|segment| segment.kind == SegmentKind::Outgoing);
                let peak_ns = outgoing.and_then(|segment| {
                    let peak = emission_choice::outgoing_peak(self.waves.samples(segment))?;
                    Some(segment.duration_of(0.0) * unit_ns + peak * segment.sample_units_ns)
                });
                peak_ns.unwrap_or(usual_ns)
            }
        }
    }

    /// Reads the next pulse: its shot and its sampling unit, ns; `None` if it is unusable.
    fn shot(&mut self, cx: &mut Context) -> Result<Option<(Emission, f64)>> {
        let pulse = with_heights_in(self.reader.pulse(self.next_pulse)?, self.units);
        self.next_pulse += 1;
        self.last_waves_at = self.last_waves_at.max(u64::try_from(pulse.wave_offset).unwrap_or(0));
        let read = match self.with_samples {
            true => self.reader.waves(&pulse, &mut self.waves),
            false => Ok(()),
        };
        if !self.broken.accepts(read, cx, Reason::UnreadableWaves)? {
            return Ok(None);
        }
        if self.has_outgoing_bytes && self.waves.read_outgoing_as_bytes() {
            self.outgoing_bytes_pulses += 1;
        }
        let unit_ns = unit_ns(&self.reader, &pulse);
        let emission = self.emission(&pulse, unit_ns);
        if !emission.direction.iter().all(|x| x.is_finite()) {
            cx.reject(Reason::PulseWithoutDirection, 1);
            return Ok(None);
        }
        Ok(Some((emission, unit_ns)))
    }

    /// Adds a pulse to the current line.
    fn add(&mut self, (mut emission, unit_ns): (Emission, f64), cx: &mut Context) {
        let clock_ns = self.clock_ns(unit_ns);
        if let ClockShift::WithOrigin(_) = self.clock {
            let along_m = clock_ns * emission.frame_scale * self.input_speed();
            (0..3).for_each(|axis| emission.origin_m[axis] += along_m * emission.direction[axis]);
        }
        let index = self.lines.add(emission.shot, emission);
        for segment in self.waves.segments() {
            let Some(channel) = self.receivers.of(segment) else {
                cx.reject(Reason::UnknownChannel, 1);
                continue;
            };
            let start_ns = segment.duration_of(0.0) * unit_ns - clock_ns;
            let samples = self.waves.samples(segment);
            self.lines.blocks().push(index, channel, None, start_ns, segment.sample_units_ns, samples);
        }
    }

    fn emission(&self, pulse: &PulseRecord, unit_ns: f64) -> Emission {
        let beam = pulse.step.map(|metres| metres / unit_ns);
        let own_length = beam.iter().map(|x| x * x).sum::<f64>().sqrt();
        let clock_s = (pulse.t.wrapping_sub(self.first_t)) as f64 * self.reader.header().t_scale_s;
        let flag = |set: bool, bit: u16| if set { bit } else { 0 };
        Emission {
            shot: pulse.index,
            gps_time_s: pulse.gps_time_s + self.time_shift_s,
            clock_ps: (clock_s * 1e12).round() as i64,
            origin_m: pulse.anchor,
            direction: beam.map(|x| x / own_length),
            frame_scale: self.beams.of(beam) / self.input_speed(),
            facet: u16::from(pulse.mirror_facet),
            flags: flag(pulse.edge_of_scan_line, emission_flags::EDGE_OF_FLIGHT_LINE)
                | flag(pulse.scan_direction, emission_flags::SCAN_DIRECTION_POSITIVE),
            mta_zone: Some(0),
            ..Emission::default()
        }
    }

    /// Range per nanosecond of two-way travel, m.
    fn input_speed(&self) -> f64 {
        self.lines.input().group_velocity_mps * 0.5e-9
    }
}

impl Source for PulseWavesReader {
    fn next(&mut self, cx: &mut Context) -> Result<Option<ScanLine>> {
        if let Some(message) = self.message.take() {
            message.report(cx);
        }
        loop {
            if let Some(shot) = self.last_seen.take() {
                self.add(shot, cx);
            }
            if self.next_pulse == self.reader.pulse_count() {
                // A truncated file ends with an error, after everything it contains has been
                // emitted.
                if let Some(line) = self.lines.take() {
                    return Ok(Some(line));
                }
                self.broken.check_at_end()?;
                self.reader.check_complete()?;
                if self.outgoing_bytes_pulses > 0 {
                    cx.warn(format!("the file declares the outgoing pulses of {} pulses with 16 bits but stores them with 8 (an error of {OUTGOING_BYTES_WRITER}): they and their echoes were read accordingly", self.outgoing_bytes_pulses));
                }
                let waves_bytes = self.reader.waves_bytes();
                if self.next_pulse >= FEWEST_PULSES
                    && self.last_waves_at as f64 <= LEAST_USED_WAVES * waves_bytes as f64
                {
                    cx.warn(format!("the waves of all pulses begin in the first {} of the {waves_bytes} bytes of the waves file: it may be that of another recording; copy both files again, unless the pulses are a part of a recording", self.last_waves_at));
                }
                if self.reader.stray_bytes() > 0 {
                    let stray = self.reader.stray_bytes();
                    cx.warn(format!("the {stray} bytes after the last pulse are not valid records: the file may be truncated and lack its coordinate system or tables"));
                }
                return Ok(None);
            }
            let Some(shot) = self.shot(cx)? else { continue };
            self.last_seen = Some(shot);
            if self.lines.ends_before(&shot.0) {
                return Ok(self.lines.take());
            }
        }
    }

    fn progress(&self) -> Option<f64> {
        Some(self.next_pulse as f64 / self.reader.pulse_count().max(1) as f64)
    }

    fn location(&self) -> Option<LineLocation> {
        self.lines.location()
    }

    fn line_at(&mut self, location: &LineLocation, cx: &mut Context) -> Result<Option<ScanLine>> {
        (self.last_seen, self.broken) = (None, BrokenRun::default());
        self.lines.begin_at(location);
        self.next_pulse = location.records.start;
        while self.next_pulse < location.records.end {
            if let Some(shot) = self.shot(cx)? {
                self.add(shot, cx);
            }
        }
        Ok(self.lines.take())
    }
}

/// Sampling unit of a pulse, ns: anchor and target are 1000 units apart.
fn unit_ns(reader: &Reader, pulse: &PulseRecord) -> f64 {
    reader.descriptors().get(&pulse.descriptor).map_or(1.0, |descriptor| descriptor.sample_units_ns)
}

/// Converts the height of a pulse and of its vector to the unit of x and y.
fn with_heights_in(mut pulse: PulseRecord, units: RecordingUnits) -> PulseRecord {
    pulse.anchor[2] *= units.height_factor;
    pulse.step[2] *= units.height_factor;
    pulse
}

/// Beam lengths, their median, m per ns, and whether all anchors are at the earth's radius from the origin.
fn look_at_beams(reader: &mut Reader, units: RecordingUnits) -> Result<(BeamLength, f64, bool)> {
    let stride = (reader.pulse_count() / BEAMS_LOOKED_AT).max(1);
    let mut beams = Vec::new();
    let (mut projected, mut around_earth) = (true, reader.pulse_count() > 0);
    let mut index = 0;
    while index < reader.pulse_count() {
        let pulse = with_heights_in(reader.pulse(index)?, units);
        let unit_ns = unit_ns(reader, &pulse);
        projected &= pulse.anchor[2].abs() < NO_HEIGHT_M;
        let distance_m = pulse.anchor.iter().map(|x| x * x).sum::<f64>().sqrt();
        around_earth &= EARTH_M.contains(&distance_m);
        beams.push(pulse.step.map(|metres| metres / unit_ns));
        index += stride;
    }
    let metres_per_ns =
        median(beams.iter().map(|beam| beam.iter().map(|x| x * x).sum::<f64>().sqrt())).unwrap_or(f64::NAN);
    let beams = BeamLength::learn(&beams, reader.header().scale, UNITS_TO_TARGET, projected);
    Ok((beams, metres_per_ns, around_earth))
}

fn returning_channels(reader: &Reader) -> BTreeSet<u8> {
    let samplings = reader.descriptors().values().flat_map(|descriptor| &descriptor.samplings);
    samplings
        .filter(|sampling| sampling.kind == SegmentKind::Returning)
        .map(|sampling| sampling.channel)
        .collect()
}

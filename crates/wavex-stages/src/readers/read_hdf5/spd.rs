//! Lines of SPD files.

use std::path::Path;
use std::sync::Arc;

use super::ReadHdf5;
use crate::reading::bad_records::BrokenRun;
use crate::reading::line_splitter::LineSplitter;
use crate::reading::plausible;
use crate::reading::recording::units::RecordingUnits;
use crate::reading::recording::{OddSamples, Sampling};
use wavex_formats::{Error, RecordedCrs};
use wavex_hdf5::{SpdPulse, SpdReader, SpdVersion, SpdWaveform};
use wavex_line::scan_line::{Channel, Emission, Frame, GainControl, InputInfo, ScanLine};
use wavex_line::stage::{Context, LineLocation, Reason, Result, Source, StageError};

/// Group velocity of SPDLib, m/s: its refractive index of air is 1.000268008.
const GROUP_VELOCITY_MPS: f64 = 299_792_458.0 / 1.000_268_008;
/// Number of pulses, spread over the file, that decide on channels and gains.
const PULSES_LOOKED_AT: u64 = 1000;
/// Share of pulses before the previous one in time that shows a file sorted by place.
const UNSORTED: f64 = 0.01;

/// Reads the pulses of a file as scan lines.
pub(super) struct SpdLineReader {
    reader: SpdReader,
    units: RecordingUnits,
    /// Whether all waveforms have the same channel.
    has_one_channel: bool,
    /// Gain of the first waveform, to which gains of blocks are relative.
    gain: f64,
    first_ns: u64,
    next_pulse: u64,
    pulse: SpdPulse,
    /// Shot of `pulse`, which begins the next line.
    waiting: Option<Emission>,
    last_line: Option<u64>,
    lines: LineSplitter,
    broken: BrokenRun,
    /// Pulses read, and those before the previous one in time.
    order: [u64; 2],
}

/// Properties of a file that its first pulses show.
struct Seen {
    has_one_channel: bool,
    gain: f64,
    has_one_gain: bool,
    origin_is_sensor: bool,
    has_origins: bool,
    first_ns: u64,
    origin: [f64; 3],
}

impl Seen {
    /// Looks at pulses that are spread over a file; those that cannot be read are left out.
    fn of(reader: &mut SpdReader) -> Seen {
        let (mut channels, mut gains) = (Vec::new(), Vec::new());
        let (mut starts, mut pulses) = (false, 0);
        let mut seen = Seen {
            has_one_channel: true,
            gain: 1.0,
            has_one_gain: true,
            origin_is_sensor: false,
            has_origins: false,
            first_ns: 0,
            origin: [0.0; 3],
        };
        let mut pulse = SpdPulse::default();
        let stride = (reader.len() / PULSES_LOOKED_AT).max(1);
        for index in (0..reader.len()).step_by(usize::try_from(stride).unwrap_or(usize::MAX)) {
            if reader.pulse(index, &mut pulse).is_err() {
                continue;
            }
            if pulses == 0 {
                (seen.first_ns, seen.origin) = (pulse.time_ns.unwrap_or(0), pulse.origin);
            }
            pulses += 1;
            seen.has_origins |= pulse.origin != [0.0; 3];
            for waveform in pulse.waveforms() {
                starts |= waveform.range_m > 0.0;
                channels.push(waveform.channel);
                gains.push(waveform.gain);
            }
        }
        seen.gain = gains.first().copied().unwrap_or(1.0);
        seen.has_one_gain = gains.iter().all(|gain| *gain == seen.gain);
        seen.has_one_channel = channels.windows(2).all(|pair| pair[0] == pair[1]);
        seen.origin_is_sensor = starts;
        // The origin of a scanner on the ground may be 0 in its own system, with ranges from there.
        seen.has_origins |= starts || pulses == 0;
        seen
    }
}

impl SpdLineReader {
    /// Opens a file; `declared_crs` is the system that the job declares.
    pub(super) fn open(
        path: &Path,
        stem: &str,
        keys: &ReadHdf5,
        declared_crs: Option<&str>,
    ) -> Result<SpdLineReader> {
        check_keys(path, keys)?;
        let mut reader = SpdReader::open(path)?;
        let seen = Seen::of(&mut reader);
        let header = reader.header();
        plausible::check_interval(
            header.interval_ns,
            "write `SENSOR_TEMPORAL_BIN_SPACING` of the header in nanoseconds",
        )?;
        if !seen.has_origins {
            let problem = "its pulses have neither origins nor ranges: both are 0";
            let remedy = "write the file again from its source, with the positions of the sensor";
            return Err(Error::unusable(path, problem, remedy).into());
        }
        let of_file = RecordedCrs::new(header.crs_wkt.as_deref(), None, false, seen.origin);
        let units = RecordingUnits::of(declared_crs.or(of_file.wkt.as_deref()));
        let crs = units.describe(of_file, declared_crs.is_some());
        let version = match header.version {
            SpdVersion::Three => 3,
            SpdVersion::Four => 4,
        };
        let info = InputInfo {
            path: path.to_owned(),
            stem: stem.to_owned(),
            format: format!("SPD {version}"),
            sampling_interval_ns: header.interval_ns,
            full_scale_dn: (header.sample_bits == 8).then_some(255),
            gain_control: if seen.has_one_gain { GainControl::Off } else { GainControl::Recorded },
            group_velocity_mps: GROUP_VELOCITY_MPS,
            frame: Frame::Map,
            crs_wkt: crs.wkt,
            crs_problems: crs.problems,
            origin_is_sensor: seen.origin_is_sensor,
            ..InputInfo::default()
        };
        let info = Sampling(OddSamples::default(), keys.full_scale).with(info);
        Ok(SpdLineReader {
            reader,
            units,
            has_one_channel: seen.has_one_channel,
            gain: seen.gain,
            first_ns: seen.first_ns,
            next_pulse: 0,
            pulse: SpdPulse::default(),
            waiting: None,
            last_line: None,
            lines: LineSplitter::new(Arc::new(info)).marking_edges(),
            broken: BrokenRun::default(),
            order: [0; 2],
        })
    }

    /// The CRS that a job declares, with heights in the unit of the map.
    pub(super) fn converted(&self, wkt: String) -> String {
        self.units.converted(wkt)
    }

    /// Reads the next pulse; `None` if it is unusable.
    fn shot(&mut self, cx: &mut Context) -> Result<Option<Emission>> {
        let index = self.next_pulse;
        self.next_pulse += 1;
        let read = self.reader.pulse(index, &mut self.pulse);
        if !self.broken.accepts(read, cx, Reason::UnreadableShot)? {
            return Ok(None);
        }
        let pulse = &self.pulse;
        let direction = pulse.direction();
        let is_far = |waveform: &SpdWaveform| {
            let start_ns = self.start_ns(waveform);
            !start_ns.is_finite() || start_ns.abs() > plausible::MOST_START_NS
        };
        let reason = if pulse.waveforms().iter().all(|waveform| waveform.received_dn.is_empty()) {
            Some(Reason::PulseWithoutWaveform)
        } else if !pulse.origin.iter().all(|x| x.is_finite()) {
            Some(Reason::OriginNotFinite)
        } else if !direction.iter().all(|x| x.is_finite()) {
            Some(Reason::DirectionNotFinite)
        } else if pulse.waveforms().iter().any(is_far) {
            Some(Reason::FarBlock)
        } else {
            None
        };
        if let Some(reason) = reason {
            cx.reject(reason, 1);
            return Ok(None);
        }
        let [x, y, z] = pulse.origin;
        // SPDLib leaves unknown times at 0.
        let time_ns = pulse.time_ns.filter(|ns| *ns > 0);
        let since_first_ps = time_ns.map_or(0, |ns| 1000 * (i128::from(ns) - i128::from(self.first_ns)));
        Ok(Some(Emission {
            shot: index,
            gps_time_s: time_ns.map_or(f64::NAN, |ns| ns as f64 * 1e-9),
            clock_ps: i64::try_from(since_first_ps).unwrap_or(i64::MAX),
            origin_m: [x, y, z * self.units.height_factor],
            direction,
            frame_scale: 1.0 / self.units.map_m,
            mta_zone: Some(0),
            ..Emission::default()
        }))
    }

    /// Time from the emission to the first received sample, ns.
    fn start_ns(&self, waveform: &SpdWaveform) -> f64 {
        waveform.range_m / (0.5e-9 * GROUP_VELOCITY_MPS)
    }

    /// Adds the current pulse to the current line.
    fn add(&mut self, emission: Emission, cx: &mut Context) {
        self.last_line = self.pulse.scan_line;
        let interval_ns = self.reader.header().interval_ns;
        let index = self.lines.add(emission.shot, emission);
        let mut transmitted_at = None;
        for waveform in self.pulse.waveforms() {
            // Waveforms of one pulse may share their transmitted samples.
            if !waveform.transmitted_dn.is_empty()
                && transmitted_at.replace(waveform.transmitted_at) != Some(waveform.transmitted_at)
            {
                let samples = &waveform.transmitted_dn;
                self.lines.blocks().push(index, Channel::Reference, None, 0.0, interval_ns, samples);
            }
            if waveform.received_dn.is_empty() {
                continue;
            }
            let channel = match waveform.channel {
                _ if self.has_one_channel => Channel::LowPower,
                0 => Channel::HighPower,
                1 => Channel::LowPower,
                2 => Channel::Saturation,
                _ => {
                    cx.reject(Reason::UnknownChannel, 1);
                    continue;
                }
            };
            let start_ns = self.start_ns(waveform);
            let samples = &waveform.received_dn;
            self.lines.blocks().push(index, channel, None, start_ns, interval_ns, samples);
            self.lines.blocks().set_last_gain(waveform.gain / self.gain);
        }
    }

    /// Counts pulses that are before the previous one in time.
    fn watch_order(&mut self, emission: &Emission, before_ps: &mut Option<i64>) {
        let is_before = before_ps.replace(emission.clock_ps).is_some_and(|last| emission.clock_ps < last);
        self.order[0] += 1;
        self.order[1] += u64::from(is_before);
    }

    /// Warns of a file sorted by place.
    fn report_order(&self, cx: &mut Context) {
        let [pulses, before] = self.order;
        if before as f64 > UNSORTED * pulses as f64 {
            cx.warn(format!(
                "{before} of {pulses} pulses are earlier than the pulse before: the file is sorted by place, and scan \
                 lines have few shots; read the file without spatial index, if there is one"
            ));
        }
    }
}

/// Refuses keys for the beams of other products.
fn check_keys(path: &Path, keys: &ReadHdf5) -> Result<()> {
    let given = [
        ("beams", !keys.beams.is_empty()),
        ("split_beams", keys.split_beams),
        ("extent_deg", keys.extent_deg.is_some()),
        ("shots", keys.shots.is_some()),
    ];
    match given.iter().find(|(_, is_given)| *is_given) {
        Some((key, _)) => Err(StageError::failed(
            format!("{}: `{key}` is for GEDI and LVIS, but this is an SPD file", path.display()),
            "remove the key",
        )),
        None => Ok(()),
    }
}

impl Source for SpdLineReader {
    fn next(&mut self, cx: &mut Context) -> Result<Option<ScanLine>> {
        let mut before_ps = None;
        loop {
            if let Some(emission) = self.waiting.take() {
                before_ps = Some(emission.clock_ps);
                self.add(emission, cx);
            }
            if self.next_pulse >= self.reader.len() {
                if let Some(line) = self.lines.take() {
                    return Ok(Some(line));
                }
                self.broken.check_at_end()?;
                self.report_order(cx);
                return Ok(None);
            }
            let Some(emission) = self.shot(cx)? else { continue };
            self.watch_order(&emission, &mut before_ps);
            let is_other_line = self.last_line.is_some_and(|line| self.pulse.scan_line != Some(line));
            self.waiting = Some(emission);
            let ended = match is_other_line {
                true => self.lines.end(),
                false if self.lines.ends_before(&emission) => self.lines.take(),
                false => None,
            };
            if ended.is_some() {
                return Ok(ended);
            }
        }
    }

    fn progress(&self) -> Option<f64> {
        Some(self.next_pulse as f64 / self.reader.len().max(1) as f64)
    }

    fn location(&self) -> Option<LineLocation> {
        self.lines.location()
    }

    fn line_at(&mut self, location: &LineLocation, cx: &mut Context) -> Result<Option<ScanLine>> {
        (self.waiting, self.broken) = (None, BrokenRun::default());
        self.lines.begin_at(location);
        self.next_pulse = location.records.start;
        while self.next_pulse < location.records.end {
            if let Some(emission) = self.shot(cx)? {
                self.add(emission, cx);
            }
        }
        Ok(self.lines.take())
    }
}

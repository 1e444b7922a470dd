//! `read_arrow`: reads recorded waveforms from the open container.

use std::fs::File;
use std::io::Read;
use std::sync::Arc;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::container_info::{channel_of, info_of};
use crate::reading::plausible;
use crate::reading::recording::{
    AsDeclared, Declared, FullScale, InputCrs, OddSamples, PulseSpeed, Sampling, TimeKeys,
};
use wavex_footprints::RecordedNoise;
use wavex_formats::Error;
use wavex_formats::container::{
    self, ContainerBlock, ContainerFootprint, ContainerLine, ContainerOnline, ContainerReader, ContainerShot,
};
use wavex_line::keys::InvalidKey;
use wavex_line::plausibility::Check;
use wavex_line::scan_line::{
    Blocks, Emission, EmissionReference, FootprintRecord, GainControl, InputInfo, Kind, MAX_SHOTS_PER_LINE,
    OnlineReturn, ScanLine,
};
use wavex_line::stage::{
    self, Context, LineLocation, Paths, Reason, Result, RunContext, Source, SourceConfig, StageError,
    StageSpec,
};

/// Registry entry of the stage.
pub const STAGE: StageSpec = StageSpec::source::<ReadArrow>("read_arrow", Kind::Shots);

/// Reads recorded waveforms from the open waveform container (Arrow IPC).
///
/// The container has one record line per scan line and one row per shot, as written by pyarrow,
/// Polars, DuckDB and R. `schemas/container.json` describes the columns and metadata keys.
///
/// The file format and the stream format are detected from the content; both may be compressed with
/// LZ4 or ZSTD. Unknown columns and metadata keys are ignored. A missing column, a column of
/// another type, an invalid null, or a list that points outside its items ends the run with an
/// error that names the column and the row. Large lists and signed shot numbers are accepted. A group
/// velocity that light does not have in air, and a sampling interval outside 0.05 to 20 ns, are errors.
///
/// Samples of version 2 of the container are fractions of a digitiser step: `measure_footprints` measures them, and
/// stages for whole steps (`calibrate`, `decompose`) refuse them. Beams follow each other, as in `read_hdf5`.
///
/// A scan line ends with its record line, where the column `line` or `beam` changes, and after 4096 shots;
/// the parts of a longer line keep its number. Record lines are limited to 1 GiB.
///
/// Without the key `wavex.emission_reference`, the time of emission is taken from the outgoing
/// pulse if the first record line has a block of channel 3, otherwise from the shot's clock. A source
/// that the points contradict is a warning.
///
/// Rejected, and counted with their blocks, are shots with: an origin or direction that is not
/// finite, a direction that is not a unit vector (to 1e-6: 1 mm at 1 km), an infinite time, a clock
/// earlier than that of the previous shot in its line or its number, a frame scale that is not between
/// 0.1 and 10, a scan angle beyond 180 degrees, a block of an unknown channel, a block without a time, more
/// than 0.01 s from its shot, with an interval that is not between 0.05 and 20 ns or with a gain that is not
/// between 1/1024 and 1024, a sample that is not finite, or an online return without a time. The line continues without them.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ReadArrow {
    /// The container: a file, a pattern, or a list of them; `-` is standard input. The job runs
    /// once for each.
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
    /// Times of the recording.
    #[serde(flatten)]
    pub times: TimeKeys,
}

impl stage::Config for ReadArrow {
    fn check(&self) -> std::result::Result<(), InvalidKey> {
        self.path.check()?;
        self.times.check()?;
        self.input_crs.check()
    }

    fn inputs(&self) -> Vec<&str> {
        self.input_crs.file()
    }
}

impl SourceConfig for ReadArrow {
    fn paths(&self) -> Option<&Paths> {
        Some(&self.path)
    }

    fn make(&self, run: &RunContext) -> Result<Box<dyn Source>> {
        self.declare(ArrowLineReader::open(run, Sampling(self.odd_samples, self.full_scale))?, run, true)
    }

    fn make_for_inspection(&self, run: &RunContext, with_samples: bool) -> Result<Box<dyn Source>> {
        self.declare(
            ArrowLineReader::open_partial(run, Sampling(self.odd_samples, self.full_scale))?,
            run,
            with_samples,
        )
    }
}

impl ReadArrow {
    fn declare(
        &self,
        mut source: ArrowLineReader,
        run: &RunContext,
        with_samples: bool,
    ) -> Result<Box<dyn Source>> {
        if self.pulse_speed.refractive_index_ppm.is_none() {
            plausible::check_velocity(
                source.info.group_velocity_mps,
                "the metadata `wavex.group_velocity_mps`",
                "write it in metres per second, or set `refractive_index_ppm` of the reader",
            )?;
        }
        plausible::check_interval(
            source.info.sampling_interval_ns,
            "write `wavex.sampling_interval_ns` in nanoseconds",
        )?;
        if !with_samples {
            source.reader.skip_samples();
        }
        let declared = Declared::new(&self.times, &self.input_crs, self.pulse_speed, run)?;
        Ok(Box::new(
            AsDeclared::new(ArrowLineReader { with_samples, ..source }, declared).checking_emissions(),
        ))
    }
}

/// A container being read.
struct ArrowLineReader {
    reader: ContainerReader,
    /// If false, blocks have a sample count but no samples.
    with_samples: bool,
    info: Arc<InputInfo>,
    /// Metadata with the name of the current beam, of a recording with beams.
    of_beam: Option<Arc<InputInfo>>,
    /// The current record line, and its first row not yet emitted.
    at: Option<(ContainerLine, usize)>,
    /// Number of the current record line.
    number: u64,
    /// Location of the line emitted last.
    location: Option<LineLocation>,
    /// Error of a file without its end, until it is returned.
    damage: Option<StageError>,
}

/// Valid gains, relative to the reference gain.
const GAINS: std::ops::RangeInclusive<f64> = 1.0 / 1024.0..=1024.0;
/// Largest deviation of the length of a direction from 1.
const UNIT_TOLERANCE: f64 = 1e-6;

impl ArrowLineReader {
    fn open(run: &RunContext, sampling: Sampling) -> Result<ArrowLineReader> {
        let path = &run.input;
        let reader = match pipe(run).map_err(Error::io(path, "open"))? {
            Some(pipe) => ContainerReader::from_stream(path, pipe)?,
            None => ContainerReader::open(path)?,
        };
        ArrowLineReader::begin(reader, run, sampling)
    }

    /// As [`ArrowLineReader::open`]; a file without its end is read up to the damage.
    fn open_partial(run: &RunContext, sampling: Sampling) -> Result<ArrowLineReader> {
        let damage = match ArrowLineReader::open(run, sampling) {
            Err(damage) if run.input.is_file() => damage,
            opened => return opened,
        };
        let readable = File::open(&run.input).ok().and_then(|file| {
            let reader = ContainerReader::from_stream(&run.input, Box::new(file)).ok()?;
            ArrowLineReader::begin(reader, run, sampling).ok()
        });
        match readable {
            Some(readable) => Ok(ArrowLineReader { damage: Some(damage), ..readable }),
            None => Err(damage),
        }
    }

    fn begin(mut reader: ContainerReader, run: &RunContext, sampling: Sampling) -> Result<ArrowLineReader> {
        let (path, stem) = (&run.input, &run.stem);
        let first = reader.next_line()?;
        let reference = match first.as_ref().is_some_and(has_outgoing_pulse) {
            true => EmissionReference::OutgoingPulse,
            false => EmissionReference::Clock,
        };
        let format = format!("wavex container {} (Arrow IPC {})", reader.header().version(), reader.form());
        let info = info_of(reader.header(), path.clone(), stem.clone(), format, reference);
        let mut info = sampling.with(info);
        if first.as_ref().is_some_and(ContainerLine::has_gain) {
            info.gain_control = GainControl::Recorded;
        }
        let info = Arc::new(info);
        let at = first.map(|line| (line, 0));
        let (number, location, damage) = (0, None, None);
        Ok(ArrowLineReader { reader, with_samples: true, info, of_beam: None, at, number, location, damage })
    }

    /// Metadata of a beam: the same for successive lines of it.
    fn info_of_beam(&mut self, name: Option<&str>) -> Arc<InputInfo> {
        let Some(name) = name else { return Arc::clone(&self.info) };
        let current = self.of_beam.take().filter(|info| info.beam.as_deref() == Some(name));
        let of_beam = current.unwrap_or_else(|| {
            Arc::new(InputInfo { beam: Some(name.to_owned()), ..InputInfo::clone(&self.info) })
        });
        Arc::clone(self.of_beam.insert(of_beam))
    }

    /// Takes the next rows that form a line from the current record line.
    fn part(&mut self, cx: &mut Context) -> Option<ScanLine> {
        let (line, from) = self.at.take()?;
        if from >= line.rows() {
            return None;
        }
        let (number, beam) = (line.line(from), line.footprint(from).beam);
        let is_next =
            |row: usize| row < line.rows() && line.line(row) == number && line.footprint(row).beam == beam;
        let room = (from..from + MAX_SHOTS_PER_LINE).take_while(|&row| is_next(row)).count();
        let (mut emissions, mut rows) = (Vec::with_capacity(room), Vec::with_capacity(room));
        let mut row = from;
        while is_next(row) && emissions.len() < MAX_SHOTS_PER_LINE {
            let shot = line.shot(row);
            let wrong = wrong_row(&line, row, &shot, emissions.last());
            match wrong.or_else(|| wrong_samples(&line, row).filter(|_| self.with_samples)) {
                None => {
                    emissions.push(emission_of(&shot));
                    rows.push(row);
                }
                Some(reason) => {
                    cx.reject_with_blocks(reason, 1, line.blocks(row).len() as u64);
                }
            }
            row += 1;
        }
        let blocks = self.blocks(&line, &rows);
        let info = self.info_of_beam(beam);
        self.at = Some((line, row));
        self.location = (self.reader.form() == "file").then(|| LineLocation {
            records: self.number..self.number + 1,
            row: from as u32,
            line: number,
            first_shot: emissions.first().map_or(0, |first| first.shot),
            is_complete: true,
        });
        Some(ScanLine::of_shots(info, number, emissions, blocks))
    }

    /// Blocks and online returns of the rows `kept`.
    fn blocks(&self, line: &ContainerLine, kept: &[usize]) -> Blocks {
        let sizes = kept.iter().map(|&row| line.blocks_and_samples(row..row + 1));
        let (n, samples) = sizes.fold((0, 0), |sum, row| (sum.0 + row.0, sum.1 + row.1));
        let mut blocks = Blocks::with_capacity(n, if self.with_samples { samples } else { 0 });
        for (emission, &row) in (0..).zip(kept) {
            for (block, fractions) in line.blocks(row).zip(line.fractions(row)) {
                let Some(channel) = channel_of(block.channel) else { continue };
                let interval_ns = block.interval_ns.unwrap_or(self.info.sampling_interval_ns);
                let (zone, start_ns, samples) = (block.zone, block.start_ns, block.samples);
                match (self.with_samples, self.reader.header().has_fractions) {
                    (true, false) => blocks.push(emission, channel, zone, start_ns, interval_ns, samples),
                    (true, true) => {
                        blocks.push_fractions(emission, channel, start_ns, interval_ns, fractions);
                        blocks.set_last_zone(zone);
                    }
                    (false, _) => {
                        let len = samples.len().max(fractions.len()) as u32;
                        blocks.push_without_samples(emission, channel, zone, start_ns, interval_ns, len);
                    }
                }
                blocks.set_last_gain(block.gain.unwrap_or(1.0));
            }
        }
        for (emission, &row) in (0..).zip(kept) {
            let online =
                |ContainerOnline { time_ns, amplitude }| OnlineReturn { emission, time_ns, amplitude };
            blocks.online.extend(line.online(row).map(online));
            if self.reader.header().has_fractions {
                blocks.footprints.push(record_of(emission, line, row));
            }
        }
        blocks
    }
}

impl Source for ArrowLineReader {
    fn next(&mut self, cx: &mut Context) -> Result<Option<ScanLine>> {
        loop {
            match self.part(cx) {
                Some(scan_line) if !scan_line.emissions.is_empty() => return Ok(Some(scan_line)),
                // All shots of this line were rejected.
                Some(_) => continue,
                None => {}
            }
            let line = match (self.reader.next_line(), self.damage.take()) {
                (Ok(Some(line)), damage) => {
                    self.damage = damage;
                    line
                }
                (_, Some(damage)) => return Err(damage),
                (Err(error), None) => return Err(error.into()),
                (Ok(None), None) => break,
            };
            self.number += 1;
            self.at = Some((line, 0));
        }
        if self.reader.ended_without_mark() {
            cx.warn("the Arrow stream ends without its end mark: lines may be missing");
        }
        Ok(None)
    }

    fn progress(&self) -> Option<f64> {
        self.reader.progress()
    }

    fn location(&self) -> Option<LineLocation> {
        self.location.clone()
    }

    fn line_at(&mut self, location: &LineLocation, cx: &mut Context) -> Result<Option<ScanLine>> {
        let number = location.records.start;
        let is_there = self.number == number && self.at.is_some();
        if !is_there {
            if !self.reader.seek(number) {
                return Ok(None);
            }
            self.number = number;
            self.at = self.reader.next_line()?.map(|line| (line, 0));
        }
        if let Some((_, row)) = &mut self.at {
            *row = location.row as usize;
        }
        Ok(self.part(cx))
    }
}

/// Opens standard input or a named pipe; `None` for a file.
///
/// Where a wait for bytes can be ended, it ends with the run.
fn pipe(run: &RunContext) -> std::io::Result<Option<Box<dyn Read + Send>>> {
    let is_standard_input = run.input.as_os_str() == "-";
    #[cfg(unix)]
    {
        use std::os::unix::fs::FileTypeExt;
        use wavex_line::system::pipe::Pipe;
        let is_pipe = || std::fs::metadata(&run.input).is_ok_and(|about| about.file_type().is_fifo());
        let cancelled = Arc::clone(&run.cancelled);
        Ok(if is_standard_input {
            Some(Box::new(Pipe::standard_input(cancelled)?))
        } else if is_pipe() {
            Some(Box::new(Pipe::open(&run.input, cancelled)?))
        } else {
            None
        })
    }
    #[cfg(not(unix))]
    Ok(is_standard_input.then(|| Box::new(std::io::stdin()) as Box<dyn Read + Send>))
}

fn has_outgoing_pulse(line: &ContainerLine) -> bool {
    let is_reference = |block: ContainerBlock| block.channel == container::channel::REFERENCE;
    (0..line.rows()).any(|row| line.blocks(row).any(is_reference))
}

/// What the recording says of a shot with a large footprint.
fn record_of(emission: u32, line: &ContainerLine, row: usize) -> FootprintRecord {
    let ContainerFootprint { shot_number, noise_mean_dn, noise_sd_dn, is_advised_against, .. } =
        line.footprint(row);
    let noise = noise_mean_dn.zip(noise_sd_dn).map(|(mean_dn, sd_dn)| RecordedNoise { mean_dn, sd_dn });
    FootprintRecord {
        emission,
        shot_number: shot_number.unwrap_or_else(|| line.shot(row).shot),
        noise: noise
            .filter(|noise| noise.mean_dn.is_finite() && noise.sd_dn.is_finite() && noise.sd_dn > 0.0),
        is_degraded: is_advised_against,
        columns: Box::default(),
    }
}

fn emission_of(shot: &ContainerShot) -> Emission {
    Emission {
        shot: shot.shot,
        gps_time_s: shot.gps_time_s.unwrap_or(f64::NAN),
        clock_ps: shot.clock_ps,
        origin_m: shot.origin_m,
        direction: shot.direction,
        frame_scale: shot.frame_scale.unwrap_or(1.0),
        emission_ns: 0.0,
        emission_sd_ns: f64::NAN,
        facet: shot.facet,
        flags: shot.flags,
        mta_zone: shot.mta_zone,
        scan_angle_deg: shot.scan_angle_deg.unwrap_or(f32::NAN),
    }
}

/// The reason to reject a row, if any; `last` is the previous shot of its line.
fn wrong_row(
    line: &ContainerLine,
    row: usize,
    shot: &ContainerShot,
    last: Option<&Emission>,
) -> Option<Reason> {
    let earlier = last.is_some_and(|last| shot.clock_ps < last.clock_ps);
    let is_repeated = last.is_some_and(|last| shot.shot == last.shot);
    (earlier.then_some(Reason::BackwardClock))
        .or_else(|| is_repeated.then_some(Reason::RepeatedShotNumber))
        .or_else(|| wrong_shot(shot))
        .or_else(|| line.blocks(row).find_map(wrong_block))
        .or_else(|| line.online(row).find_map(wrong_online))
}

/// The checks of the rows of a container.
pub(crate) fn checks() -> Vec<Check> {
    vec![
        Check::left_out(
            "frame scale of a shot",
            "0.1 to 10",
            "scale of maps up to 84 degrees of latitude, in metres or feet",
            Reason::WrongFrameScale.text(),
        ),
        Check::left_out(
            "scan angle of a shot",
            "-180 to 180 degrees",
            "a full turn",
            Reason::WrongScanAngle.text(),
        ),
        Check::left_out(
            "number of a shot and of that before",
            "different",
            "each shot has its own number",
            Reason::RepeatedShotNumber.text(),
        ),
        Check::left_out(
            "start of a block after its shot",
            "0.01 s",
            "light travels 1500 km and back",
            Reason::FarBlock.text(),
        ),
        Check::left_out(
            "sampling interval of a block",
            "0.05 to 20 ns",
            "as for whole recordings",
            Reason::WrongInterval.text(),
        ),
    ]
}

/// The reason to reject a shot, if any.
fn wrong_shot(shot: &ContainerShot) -> Option<Reason> {
    let length = shot.direction.iter().map(|x| x * x).sum::<f64>().sqrt();
    if !shot.origin_m.iter().all(|x| x.is_finite()) {
        Some(Reason::OriginNotFinite)
    } else if !length.is_finite() {
        Some(Reason::DirectionNotFinite)
    } else if (length - 1.0).abs() > UNIT_TOLERANCE {
        Some(Reason::DirectionNotUnit)
    } else if shot.gps_time_s.is_some_and(f64::is_infinite) {
        Some(Reason::TimeInfinite)
    } else if shot.frame_scale.is_some_and(|scale| !plausible::FRAME_SCALE.contains(&scale)) {
        Some(Reason::WrongFrameScale)
    } else if shot.scan_angle_deg.is_some_and(|angle_deg| angle_deg.abs() > 180.0) {
        Some(Reason::WrongScanAngle)
    } else {
        None
    }
}

/// The reason to reject a block, if any.
fn wrong_block(block: ContainerBlock) -> Option<Reason> {
    if channel_of(block.channel).is_none() {
        Some(Reason::ShotWithUnknownChannel)
    } else if !block.start_ns.is_finite() {
        Some(Reason::BlockWithoutTime)
    } else if block.start_ns.abs() > plausible::MOST_START_NS {
        Some(Reason::FarBlock)
    } else if block.interval_ns.is_some_and(|interval_ns| !plausible::INTERVAL_NS.contains(&interval_ns)) {
        Some(Reason::WrongInterval)
    } else if block.gain.is_some_and(|gain| !GAINS.contains(&gain)) {
        Some(Reason::WrongGain)
    } else {
        None
    }
}

/// The reason to reject a row for its samples, if any: fractions of a step may be anything.
fn wrong_samples(line: &ContainerLine, row: usize) -> Option<Reason> {
    let is_finite = |samples: &[f32]| samples.iter().all(|sample| sample.is_finite());
    (!line.fractions(row).all(is_finite)).then_some(Reason::SampleNotFinite)
}

fn wrong_online(online: ContainerOnline) -> Option<Reason> {
    (!online.time_ns.is_finite()).then_some(Reason::OnlineWithoutTime)
}

#[cfg(test)]
mod tests;

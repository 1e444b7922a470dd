//! Points as LAS or LAZ.

pub(super) mod attributes;
mod files;
#[cfg(test)]
mod tests;
mod waves;

use std::path::Path;
use std::sync::{Arc, OnceLock};

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::batch::{Batch, Emission, Frame, GainControl, InputInfo, Kind, Return, TimeScale, emission_flags};
use crate::formats::Error;
use crate::formats::geokeys;
use crate::formats::las::{IndexPlace, PointOut, Version, Wave, WavePlace, Writer, WriterOptions, nearest};
use crate::geo::time::{adjusted_gps_time, day_of_year};
use crate::stage::{
    Config, Context, InvalidKey, Item, OutputFile, Result, Sink, SinkConfig, Site, StageError, StageSpec,
};
use attributes::Attributes;
use files::Files;
use waves::Waves;

/// The stage's place in the registry.
pub const STAGE: StageSpec =
    StageSpec::sink::<WriteLas>("write_las", &[Kind::Points]).after(&["georeference"]);

/// Writes points as LAS or LAZ: the extension of `path` decides which.
///
/// Intensity is the corrected intensity, rounded. Return numbers, scan angle, scan direction and edge of flight line are
/// those of the emission; times are adjusted GPS time where the input tells the week, else as the input has them, and the
/// header says which. The point source id is the multiple-time-around zone, the user data byte holds the flags of the fit
/// (bit 0 refined, 1 overlap, 2 diverged at first, 3 to 5 cross-talk, 6 saturated, 7 extremely saturated), outliers are
/// withheld and of class 20; the channel is that of the power that gave the intensity (0 low, 1 high).
///
/// LAS 1.4 has point format 6 and the coordinate reference system of the points as WKT. LAS 1.2 and 1.3, for older
/// programs, have point format 1 (at most 7 returns of a pulse, whole degrees, no channel) and GeoTIFF keys, or WKT where the system
/// has no EPSG code.
///
/// Extra attributes: `WideRatio`, `TargetThick`, `Amp`, `DevRatio`, `RangeErr`, `IntErr`, `WideErr`, `ThickErr` and
/// `Channel` (0 low, 1 high power), with the scales, offsets and types of BayesWavEx 1.1. All values are clamped to what
/// their type can hold, never wrapped.
///
/// Layout 1.0 has the names and scales of BayesWavEx 1.0 (2016): `Widening`, `Target Thickness`, `Amplitude`,
/// `Raw Amplitude`, `Deviation Ratio`, `Range Error`, `Intensity Error`, `Widening Error`, `Thickness Error`. Its user data
/// byte says in bit 0 that the return was refined (the number of iterations, for which bits 0 to 5 stand, is not kept), in
/// bit 6 overlap, in bit 7 a second refinement; points of a deviation ratio above 3 belong to class 20, too.
///
/// With `wave_packets`, each point comes with the waveform it was found in (point format 9, in LAS 1.3 format 4), so that
/// the file is itself a recording of full waveforms: `read_las` reads it back, and decomposes it into the same returns. Points
/// of one waveform share its packet; vectors point from the target to the sensor, as those of RIEGL's and Leica's files do.
/// Samples are in steps of the digitiser. Shots without any return are not in such a file.
///
/// Rejected, and counted, are waveforms beyond the 255 kinds (number of samples, time between them, 8 or 16 bits) that a
/// file can tell apart: their points come without. Rejected are points too far away for 32-bit coordinates of the step; where that is every point, it is an
/// error.
///
/// The bytes do not depend on the number of threads, and the creation date is that of the data.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct WriteLas {
    /// The file, `.las` or `.laz`; `*` is the input's stem.
    pub path: String,
    /// Version of the file.
    pub version: VersionKey,
    /// Write the extra attributes.
    pub extra_attributes: bool,
    /// Of these, write the standard deviations, too.
    pub uncertainty: bool,
    /// Names and scales of the extra attributes, and what class and user data mean.
    pub attribute_layout: AttributeLayout,
    /// Where the waveform goes that each point was found in.
    pub wave_packets: WavePacketsKey,
    /// Where the spatial index for LAStools goes.
    pub index: IndexKey,
    /// Step of the coordinates, in units of the coordinate reference system; when not given, 0.001, or that of the input or
    /// of `georeference` where it is below 0.00001, as degrees need it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub coordinate_step: Option<f64>,
    /// The names of files beside the file, once they were asked for.
    #[serde(skip)]
    beside: OnceLock<Beside>,
}

/// Patterns of files beside the file.
#[derive(Clone, Debug)]
struct Beside {
    index: String,
    packets: String,
    /// Of packets that become a part of the file: they are gathered under a temporary name that is the file's alone.
    packets_inside: String,
}

/// Version of a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
pub enum VersionKey {
    /// Point format 6, with waveforms 9.
    #[serde(rename = "1.4")]
    V1_4,
    /// Point format 1, with waveforms 4.
    #[serde(rename = "1.3")]
    V1_3,
    /// Point format 1.
    #[serde(rename = "1.2")]
    V1_2,
}

/// Where waveforms go.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum WavePacketsKey {
    /// They are not written.
    None,
    /// Into a file of the same name that ends in `.wdp`.
    External,
    /// Into the file, behind the points.
    Internal,
}

/// Where a spatial index goes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum IndexKey {
    /// There is none.
    None,
    /// Into a file of the same name that ends in `.lax`.
    File,
    /// Behind the points, in LAZ only.
    Appended,
}

/// A layout of what points tell of their returns.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
pub enum AttributeLayout {
    /// That of BayesWavEx 1.1.
    #[serde(rename = "1.1")]
    V1_1,
    /// That of BayesWavEx 1.0.
    #[serde(rename = "1.0")]
    V1_0,
}

impl Default for WriteLas {
    fn default() -> WriteLas {
        WriteLas {
            path: "*.laz".into(),
            version: VersionKey::V1_4,
            extra_attributes: true,
            uncertainty: true,
            attribute_layout: AttributeLayout::V1_1,
            wave_packets: WavePacketsKey::None,
            index: IndexKey::None,
            coordinate_step: None,
            beside: OnceLock::new(),
        }
    }
}

impl Config for WriteLas {
    fn check(&self) -> std::result::Result<(), InvalidKey> {
        let lower = self.path.to_ascii_lowercase();
        InvalidKey::unless(
            lower.ends_with(".las") || lower.ends_with(".laz"),
            "path",
            "the file's name must end in .las or .laz",
        )?;
        self.check_step()?;
        InvalidKey::unless(
            self.wave_packets == WavePacketsKey::None || self.version != VersionKey::V1_2,
            "wave_packets",
            "LAS 1.2 has no waveforms: write version 1.3 or 1.4",
        )?;
        InvalidKey::unless(
            self.index != IndexKey::Appended || lower.ends_with(".laz"),
            "index",
            "an index can only be appended to .laz: write it as a file",
        )
    }
}

impl SinkConfig for WriteLas {
    fn outputs(&self) -> Vec<&str> {
        let mut outputs = vec![self.path.as_str()];
        if self.wave_packets == WavePacketsKey::External {
            outputs.push(&self.beside().packets);
        }
        if self.index == IndexKey::File {
            outputs.push(&self.beside().index);
        }
        outputs
    }

    fn needs_waveforms(&self) -> bool {
        self.wave_packets != WavePacketsKey::None
    }

    fn make(&self, site: &Site) -> Result<Box<dyn Sink>> {
        let file = site.create(&self.path)?;
        Ok(Box::new(LasSink {
            attributes: self.attributes(),
            config: self.clone(),
            threads: site.threads,
            index: (self.index == IndexKey::File).then(|| site.create(&self.beside().index)).transpose()?,
            waves: self.waves(site)?,
            state: State::Empty(file),
            input: None,
            refused: None,
        }))
    }
}

impl WriteLas {
    /// An error where there is no such step of coordinates.
    pub(super) fn check_step(&self) -> std::result::Result<(), InvalidKey> {
        InvalidKey::unless(
            self.coordinate_step.is_none_or(|step| (1e-9..=1.0).contains(&step)),
            "coordinate_step",
            "it must lie between 1e-9 and 1",
        )
    }

    fn attributes(&self) -> Attributes {
        match self.extra_attributes {
            true => Attributes::of(self.attribute_layout, self.uncertainty),
            false => Attributes::none(),
        }
    }

    fn beside(&self) -> &Beside {
        let other =
            |ending: &str| Path::new(&self.path).with_extension(ending).to_string_lossy().into_owned();
        self.beside.get_or_init(|| Beside {
            index: other("lax"),
            packets: other("wdp"),
            packets_inside: format!("{}.wdp", self.path),
        })
    }

    fn waves(&self, site: &Site) -> Result<Option<Waves>> {
        let pattern = match self.wave_packets {
            WavePacketsKey::None => return Ok(None),
            WavePacketsKey::External => &self.beside().packets,
            WavePacketsKey::Internal => &self.beside().packets_inside,
        };
        Waves::new(site.create(pattern)?, &site.geometry).map(Some)
    }

    /// The step of each coordinate.
    pub(super) fn steps(&self, input: &InputInfo) -> [f64; 3] {
        let usual = input.coordinate_grid.map_or([USUAL_STEP; 3], |(steps, _)| {
            steps.map(|step| if step < DEGREES_STEP { step } else { USUAL_STEP })
        });
        self.coordinate_step.map_or(usual, |step| [step; 3])
    }

    /// Writes what stands before the points.
    fn begin(
        &self,
        file: OutputFile,
        input: &InputInfo,
        first: Option<[f64; 3]>,
        time_s: f64,
        attributes: &Attributes,
        threads: usize,
    ) -> Result<Writer<OutputFile>> {
        let adjusted = adjusted_gps_time(input, time_s);
        let recorded = adjusted.and_then(day_of_year).map(|(year, day)| (day, year)).or(input.recorded);
        let (creation_day, creation_year) = recorded.unwrap_or((0, 0));
        let options = WriterOptions {
            version: match self.version {
                VersionKey::V1_4 => Version::V1_4,
                VersionKey::V1_3 => Version::V1_3,
                VersionKey::V1_2 => Version::V1_2,
            },
            scale: self.steps(input),
            offset: offsets(input, first),
            wkt: input.crs_wkt.as_deref(),
            extra_attributes: &attributes.stored,
            adjusted_gps_time: adjusted.is_some(),
            creation_day,
            creation_year,
            system_identifier: input.instrument.as_deref().unwrap_or("EXTRACTION"),
            generating_software: concat!("wavex ", env!("CARGO_PKG_VERSION")),
            file_source_id: 0,
            waveforms: match self.wave_packets {
                WavePacketsKey::None => WavePlace::None,
                WavePacketsKey::External => WavePlace::Beside,
                WavePacketsKey::Internal => WavePlace::Inside,
            },
            index: match self.index {
                IndexKey::None => IndexPlace::None,
                IndexKey::File => IndexPlace::Beside,
                IndexKey::Appended => IndexPlace::Appended,
            },
            threads,
        };
        let path = file.path().to_path_buf();
        Ok(Writer::new(file, &path, &options)?)
    }
}

/// The step of coordinates in metres and feet.
const USUAL_STEP: f64 = 0.001;
/// A step below this is one of degrees, of which a millionth is a decimetre.
const DEGREES_STEP: f64 = 1e-5;

struct LasSink {
    config: WriteLas,
    attributes: Attributes,
    threads: usize,
    /// The file of the index.
    index: Option<OutputFile>,
    /// The waveforms of the points.
    waves: Option<Waves>,
    state: State,
    input: Option<Arc<InputInfo>>,
    /// Why the first point was left out that does not fit into the file's coordinates.
    refused: Option<Error>,
}

/// What becomes of a point at a place that cannot be: it must not cost the others.
const TOO_FAR: &str = "a point too far away for the coordinates of the file";

/// The header needs to know the input: it is written when the first line comes.
enum State {
    Empty(OutputFile),
    Open(Box<Writer<OutputFile>>),
    Broken,
}

impl LasSink {
    /// Begins the file, unless it has begun.
    fn begin(&mut self, input: &InputInfo, first: Option<[f64; 3]>, time_s: f64) -> Result<()> {
        if let State::Empty(_) = self.state
            && let State::Empty(file) = std::mem::replace(&mut self.state, State::Broken)
        {
            let writer = self.config.begin(file, input, first, time_s, &self.attributes, self.threads)?;
            self.state = State::Open(Box::new(writer));
        }
        Ok(())
    }

    /// What is said once about the input.
    fn note(&self, input: &InputInfo, cx: &mut Context) {
        match &input.crs_wkt {
            None if input.frame == Frame::Map => cx.note(
                "the input names no coordinate reference system by WKT or EPSG code: the file has none; name it with the \
                 reader's key `crs_of_input`",
            ),
            None => cx.note(
                "the points are not georeferenced: the file has no coordinate reference system; give [job.geometry] a \
                 trajectory, and the crs that points are to have",
            ),
            Some(wkt) if self.config.version != VersionKey::V1_4 => {
                if geokeys::of_wkt(wkt).is_none() {
                    cx.note(
                        "the coordinate reference system has neither an EPSG code nor GeoTIFF keys: the file holds it as \
                         WKT, which belongs to LAS 1.4",
                    );
                }
            }
            Some(_) => {}
        }
    }

    /// What is said once where the header cannot say what the points' times count.
    fn note_times(input: &InputInfo, time_s: f64, cx: &mut Context) {
        match input.time_scale {
            _ if time_s.is_nan() => {}
            TimeScale::Day => cx.note(
                "the times of the points are seconds of the day, and the header of the LAS file can only say seconds of \
                 the GPS week; give the day with the reader's key `gps_date`",
            ),
            TimeScale::Unknown => cx.note(
                "the recording does not say what its times count, and the header of the LAS file says seconds of the GPS \
                 week; say it with the reader's key `recording_time`",
            ),
            TimeScale::Week | TimeScale::Adjusted => {}
        }
    }
}

impl Sink for LasSink {
    fn write(&mut self, batch: &Batch, cx: &mut Context) -> Result<()> {
        let (Some(returns), Some(points)) = (batch.returns(), batch.points()) else {
            return Ok(());
        };
        let input = &batch.input;
        self.input.get_or_insert_with(|| Arc::clone(input));
        // The first point decides about the offset of the coordinates, so that a file begins with it.
        if points.is_empty() {
            return Ok(());
        }
        if let State::Empty(_) = self.state {
            self.note(input, cx);
            LasSink::note_times(input, batch.stats.gps_time_s, cx);
        }
        self.begin(input, points.first().copied(), batch.stats.gps_time_s)?;
        let State::Open(writer) = &mut self.state else {
            return Err(StageError::Stopped);
        };
        if self.waves.is_some() && input.gain_control == GainControl::Recorded {
            cx.note("waveform packets do not hold the gain of their blocks: who reads them cannot compare amplitudes; keep the container of the recording");
        }
        let blocks = self.waves.as_mut().map(|waves| waves.begin_line(batch)).transpose()?;
        let wave_of = |(waves, blocks): (&mut Waves, &_)| {
            let points = returns.iter().zip(points);
            points.map(|(r, position)| waves.of(batch, blocks, r, *position)).collect::<Result<Vec<Wave>>>()
        };
        let waves = self.waves.as_mut().zip(blocks).map_or(Ok(Vec::new()), wave_of)?;
        let layout = self.config.attribute_layout;
        let made = |number: usize| {
            let r = &returns[number];
            let point = point(input, &batch.emissions[r.emission as usize], r, points[number], layout);
            PointOut { wave: waves.get(number).copied().unwrap_or_default(), ..point }
        };
        let (mut refused, mut n_refused) = (None, 0);
        writer.write_points(
            returns.len().min(points.len()),
            made,
            |numbers, columns| self.attributes.put(&returns[numbers], columns),
            |error| {
                n_refused += 1;
                refused.get_or_insert(error);
            },
        )?;
        cx.reject(Item::Returns, TOO_FAR, n_refused);
        if let (Some(error), None) = (refused, &self.refused) {
            cx.note(format!("{TOO_FAR} was left out, and so is every further one: {error}"));
            self.refused = Some(error);
        }
        cx.observe("points_per_line", points.len() as f64);
        Ok(())
    }

    fn finish(mut self: Box<Self>, cx: &mut Context) -> Result<()> {
        let input = self.input.take().unwrap_or_default();
        self.begin(&input, None, f64::NAN)?;
        if let State::Open(writer) = self.state {
            if writer.n_points() == 0 {
                // Not one point fits: then it is the file's coordinates that are wrong.
                self.refused.map_or(Ok(()), Err)?;
                cx.note("not a single point was found");
            }
            if writer.n_points() > u64::from(u32::MAX) && self.config.index != IndexKey::None {
                cx.note("an index cannot name so many points: the file has none");
            }
            let files = Files { index: self.index, waves: self.waves, place: self.config.wave_packets };
            files.finish(*writer, cx)?;
        }
        Ok(())
    }
}

/// The offset of each coordinate: the input's own, else the first point's, rounded.
pub(super) fn offsets(input: &InputInfo, first: Option<[f64; 3]>) -> [f64; 3] {
    let near = |m: f64| (m / 1000.0).round() * 1000.0;
    let own = input.coordinate_grid.map(|(_, offset)| offset);
    own.unwrap_or_else(|| first.unwrap_or_default().map(near))
}

/// A return as LAS has it.
#[inline]
pub(super) fn point(
    input: &InputInfo,
    emission: &Emission,
    r: &Return,
    [x, y, z]: [f64; 3],
    layout: AttributeLayout,
) -> PointOut {
    let flag = |bit: u16| emission.flags & bit != 0;
    PointOut {
        x,
        y,
        z,
        // NaN is 0.
        intensity: nearest(r.intensity).clamp(0, u16::MAX.into()) as u16,
        return_number: r.return_number,
        number_of_returns: r.number_of_returns,
        scan_direction: flag(emission_flags::SCAN_DIRECTION_POSITIVE),
        edge_of_flight_line: flag(emission_flags::EDGE_OF_FLIGHT_LINE),
        classification: attributes::class(layout, r),
        withheld: r.withheld,
        scanner_channel: attributes::power_channel(r),
        scan_angle_deg: if emission.scan_angle_deg.is_nan() { 0.0 } else { emission.scan_angle_deg },
        user_data: attributes::user_data(layout, r),
        point_source_id: r.mta_zone.max(0) as u16,
        gps_time: gps_time(input, emission),
        wave: Wave::default(),
    }
}

fn gps_time(input: &InputInfo, emission: &Emission) -> f64 {
    let time_s = emission.gps_time_s;
    adjusted_gps_time(input, time_s).unwrap_or(if time_s.is_nan() { 0.0 } else { time_s })
}

//! `write_las`: writes points as LAS or LAZ.

pub(crate) mod attributes;
mod files;
mod identity;
mod keys;
#[cfg(test)]
mod tests;
mod waves;

use std::path::Path;
use std::sync::{Arc, OnceLock};

use rayon::ThreadPool;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::reading::recording::possible_scales;
use crate::stac;
use attributes::{HEIGHT_ABOVE_GROUND, ReturnAttribute, attributes_of};
use files::{CompanionFiles, StacFile};
use identity::{PointSourceKey, PointSourceRule};
pub use keys::{AttributeLayout, IndexKey, VersionKey, WavePacketsKey};
use waves::PacketFile;
use wavex_formats::Error;
use wavex_formats::extensions::PACKETS;
use wavex_formats::geokeys;
use wavex_formats::las::{IndexPlace, LasVersion, PointOut, Wave, WavePlace, Writer, WriterOptions, nearest};
use wavex_geodesy::time::day_of_year;
use wavex_line::keys::InvalidKey;
use wavex_line::scan_line::{
    Emission, Frame, GainControl, InputInfo, Kind, Return, ScanLine, TimeScale, emission_flags,
};
use wavex_line::stage::{
    Cause, Config, Context, OutputFile, Reason, Result, RunContext, Sink, SinkConfig, StageError, StageSpec,
};

/// Registry entry of the stage.
pub const STAGE: StageSpec =
    StageSpec::sink::<WriteLas>("write_las", &[Kind::Points]).after(&["georeference"]);

/// Writes points as LAS or LAZ, as set by the extension of `path`.
///
/// Intensity is the corrected intensity, rounded. Return numbers, scan angle, scan direction and
/// edge-of-flight-line flag are those of the shot. Times are adjusted GPS time if the input gives
/// the week, otherwise those of the input; the header says which. The scanner channel is the
/// receiver that gave the intensity (0 low power, 1 high power). The user data byte holds the flags
/// of the fit (bit 0 refined, 1 overlap, 2 diverged at first, 3 to 5 cross-talk, 6 saturated, 7
/// extremely saturated).
///
/// LAS 1.4 uses point format 6 and the coordinate reference system of the points as WKT. LAS 1.2
/// and 1.3, for older programs, use point format 1 (at most 7 returns per pulse, whole degrees, no
/// channel) and GeoTIFF keys, or WKT if the CRS has no EPSG code.
///
/// The standard layout has the extra attributes `Amplitude`, `Reflectance`, `Pulse width`,
/// `Deviation`, `Raw amplitude`, `Width ratio`, `Target thickness`, `Range SD`, `Amplitude SD`,
/// `Width SD`, `Thickness SD`, `Intensity SD`, `Total uncertainty`, `Channel`, `MTA zone` and
/// `Quality flags`, with units in their descriptions, limits and no-data values; with
/// `height_above_ground` of `classify` also `Height above ground`. The point source
/// ID is the flight line. Outliers are withheld and of class 7 (low) or 18 (high); of class 7 before
/// LAS 1.4. `docs/reference/las.md` lists types and scales.
///
/// The layouts of BayesWavEx have the zone as point source ID, and outliers of class 20. Layout 1.1
/// has `WideRatio`, `TargetThick`, `Amp`, `DevRatio`, `RangeErr`, `IntErr`, `WideErr`, `ThickErr`
/// and `Channel` (0 low, 1 high power). All values are clamped to the range of their type, never
/// wrapped.
///
/// Layout 1.0 has the names and scales of BayesWavEx 1.0 (2016): `Widening`, `Target Thickness`,
/// `Amplitude`, `Raw Amplitude`, `Deviation Ratio`, `Range Error`, `Intensity Error`, `Widening
/// Error`, `Thickness Error`. In its user data byte, bit 0 means that the return was refined (bits
/// 0 to 5 are meant for the number of iterations, which is not kept), bit 6 means overlap, and bit
/// 7 a second refinement. Points with a deviation ratio above 3 are also of class 20.
///
/// With `wave_packets`, each point has the waveform in which it was found (point format 9, or 4 in
/// LAS 1.3). The file is then a full-waveform recording: `read_las` reads it, and `decompose` gives
/// the same returns. Points of one waveform share its packet. Direction vectors point from the
/// target to the sensor, as in files of RIEGL and Leica. Samples are in digitiser steps. Shots
/// without returns are not in such a file.
///
/// A file can distinguish 255 kinds of waveforms (number of samples, sampling interval, 8 or 16
/// bits). Waveforms of further kinds are rejected and counted; their points are written without a
/// waveform. Points too far away for 32-bit coordinates of the given step are rejected; if that is
/// every point, the run fails.
///
/// The bytes do not depend on the number of threads. The creation date is that of the data.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct WriteLas {
    /// Output file, `.las` or `.laz`; `*` is the input's stem.
    pub path: String,
    /// LAS version.
    pub version: VersionKey,
    /// Write the extra attributes.
    pub extra_attributes: bool,
    /// Names of the extra attributes to write, such as `["Range SD", "Deviation"]`; all by default.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub attributes: Option<Vec<String>>,
    /// Include the standard deviations among the extra attributes.
    pub uncertainty: bool,
    /// Names and scales of the extra attributes, and meaning of class and user data.
    pub attribute_layout: AttributeLayout,
    /// Point source ID, which is also the file source ID: `"line"`, the number of the input in the job,
    /// from 1; `"name"`, the last number in the input's file name; a number; or `"zone"`, the
    /// multiple-time-around zone of each point, without a file source ID. Defaults to `"line"` in the
    /// standard layout, to `"zone"` in the others.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub point_source_id: Option<PointSourceKey>,
    /// Project ID of the header, a GUID such as `943FA8B0-9E3C-4E8A-8F65-0A7B1C2D3E4F`; empty: none.
    pub project_id: String,
    /// Destination of the waveforms of the points.
    pub wave_packets: WavePacketsKey,
    /// Destination of the spatial index for LAStools.
    pub index: IndexKey,
    /// Write a STAC item (STAC 1.1, extensions pointcloud and projection) in a file of the same name with
    /// the extension `.json`.
    pub stac: bool,
    /// Coordinate step, in units of the coordinate reference system. Defaults to 0.001, or to the
    /// step of the input or of `georeference` if that is below 0.00001, as required for degrees.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 1e-9, max = 1.0))]
    pub coordinate_step: Option<f64>,
    /// Names of the companion files, set on first use.
    #[serde(skip)]
    beside: OnceLock<Beside>,
}

/// Path patterns of companion files.
#[derive(Clone, Debug)]
struct Beside {
    index: String,
    stac: String,
    packets: String,
    /// Temporary file, unique to this output, for packets that become part of it.
    packets_inside: String,
}

impl Default for WriteLas {
    fn default() -> WriteLas {
        WriteLas {
            path: "*.laz".into(),
            version: VersionKey::V1_4,
            extra_attributes: true,
            attributes: None,
            uncertainty: true,
            attribute_layout: AttributeLayout::Standard,
            point_source_id: None,
            project_id: String::new(),
            wave_packets: WavePacketsKey::None,
            index: IndexKey::None,
            stac: false,
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
            "the file name must end in .las or .laz; `write_ascii` writes text, and `write_table` tables",
        )?;
        InvalidKey::unless(
            !lower.ends_with(".copc.laz"),
            "path",
            "this stage does not sort points, as COPC needs: write `*.laz`, and then convert it with `wavex copc`",
        )?;
        self.check_attributes()?;
        InvalidKey::unless(
            self.project_id.is_empty() || identity::guid(&self.project_id).is_some(),
            "project_id",
            "it must be a GUID of 32 hexadecimal digits, such as 943FA8B0-9E3C-4E8A-8F65-0A7B1C2D3E4F",
        )?;
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

    fn spell_out(&mut self) {
        self.point_source_id = Some(self.point_source());
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
        if self.stac {
            outputs.push(&self.beside().stac);
        }
        outputs
    }

    fn needs_waveforms(&self) -> bool {
        self.wave_packets != WavePacketsKey::None
    }

    fn make(&self, run: &RunContext) -> Result<Box<dyn Sink>> {
        let file = run.create(&self.path)?;
        Ok(Box::new(LasWriter {
            attributes: self.attributes(false),
            config: self.clone(),
            pool: run.pool.clone(),
            index: (self.index == IndexKey::File).then(|| run.create(&self.beside().index)).transpose()?,
            stac: self.stac.then(|| run.create(&self.beside().stac)).transpose()?,
            times_s: [f64::INFINITY, f64::NEG_INFINITY],
            waves: self.waves(run)?,
            state: LasState::Empty(file),
            input: None,
            refused: None,
            flight_line: self.point_source().flight_line(run)?,
        }))
    }
}

impl WriteLas {
    /// Source of the point source ID; the layout gives the default.
    fn point_source(&self) -> PointSourceKey {
        let usual = match self.attribute_layout {
            AttributeLayout::Standard => PointSourceRule::Line,
            _ => PointSourceRule::Zone,
        };
        self.point_source_id.unwrap_or(PointSourceKey::Rule(usual))
    }

    /// Extra attributes to write, in the order of the layout; the points may have heights above the ground.
    fn attributes(&self, has_heights: bool) -> Vec<ReturnAttribute> {
        if !self.extra_attributes {
            return Vec::new();
        }
        let mut all = attributes_of(self.attribute_layout, self.uncertainty);
        if self.attribute_layout == AttributeLayout::Standard && (has_heights || self.attributes.is_some()) {
            all.push(HEIGHT_ABOVE_GROUND);
        }
        if let Some(names) = &self.attributes {
            all.retain(|attribute| names.iter().any(|name| name == attribute.stored.name));
        }
        all
    }

    /// Checks the key `attributes`: all names belong to the layout.
    fn check_attributes(&self) -> std::result::Result<(), InvalidKey> {
        let Some(names) = &self.attributes else { return Ok(()) };
        InvalidKey::unless(
            self.extra_attributes,
            "attributes",
            "`extra_attributes = false` leaves out all: remove one of both",
        )?;
        let mut layout = attributes_of(self.attribute_layout, true);
        if self.attribute_layout == AttributeLayout::Standard {
            layout.push(HEIGHT_ABOVE_GROUND);
        }
        let known: Vec<&str> = layout.iter().map(|attribute| attribute.stored.name).collect();
        let unknown = names.iter().find(|name| !known.contains(&name.as_str()));
        let problem =
            unknown.map(|name| format!("no attribute is named `{name}`; there are: {}", known.join(", ")));
        InvalidKey::unless(problem.is_none(), "attributes", problem.as_deref().unwrap_or_default())
    }

    fn beside(&self) -> &Beside {
        let other =
            |ending: &str| Path::new(&self.path).with_extension(ending).to_string_lossy().into_owned();
        self.beside.get_or_init(|| Beside {
            index: other("lax"),
            stac: stac::item_path(Path::new(&self.path)).to_string_lossy().into_owned(),
            packets: other(PACKETS),
            packets_inside: format!("{}.{PACKETS}", self.path),
        })
    }

    fn waves(&self, run: &RunContext) -> Result<Option<PacketFile>> {
        let pattern = match self.wave_packets {
            WavePacketsKey::None => return Ok(None),
            WavePacketsKey::External => &self.beside().packets,
            WavePacketsKey::Internal => &self.beside().packets_inside,
        };
        PacketFile::new(run.create(pattern)?, &run.geometry).map(Some)
    }

    /// Step of each coordinate.
    pub(crate) fn steps(&self, input: &InputInfo) -> [f64; 3] {
        let usual = input.coordinate_grid.map_or([USUAL_STEP; 3], |(steps, _)| {
            steps.map(|step| if step < DEGREES_STEP { step } else { USUAL_STEP })
        });
        self.coordinate_step.map_or(usual, |step| [step; 3])
    }
}

/// Default coordinate step in metres and feet.
const USUAL_STEP: f64 = 0.001;
/// Smaller steps are in degrees; 1e-6 degree is about 1 dm.
const DEGREES_STEP: f64 = 1e-5;

struct LasWriter {
    config: WriteLas,
    attributes: Vec<ReturnAttribute>,
    pool: Option<Arc<ThreadPool>>,
    /// File of the spatial index.
    index: Option<OutputFile>,
    /// File of the STAC item.
    stac: Option<OutputFile>,
    /// Smallest and largest time of the points, for the STAC item, s.
    times_s: [f64; 2],
    /// The waveforms of the points.
    waves: Option<PacketFile>,
    state: LasState,
    input: Option<Arc<InputInfo>>,
    /// Error of the first rejected point, outside the range of the file's coordinates.
    refused: Option<Error>,
    /// Source ID of all points; `None`: their zones.
    flight_line: Option<u16>,
}

/// The header needs the input's metadata: it is written with the first line.
enum LasState {
    Empty(OutputFile),
    Open(Box<Writer<OutputFile>>),
    Broken,
}

impl LasWriter {
    /// Starts the file, unless already started.
    fn begin(&mut self, input: &InputInfo, first: Option<[f64; 3]>, time_s: f64) -> Result<()> {
        if let LasState::Empty(_) = self.state
            && let LasState::Empty(file) = std::mem::replace(&mut self.state, LasState::Broken)
        {
            self.attributes = self.config.attributes(input.has_heights_above_ground);
            self.state = LasState::Open(Box::new(self.header(file, input, first, time_s)?));
        }
        Ok(())
    }

    /// Writes the header and the records before the points.
    fn header(
        &self,
        file: OutputFile,
        input: &InputInfo,
        first: Option<[f64; 3]>,
        time_s: f64,
    ) -> Result<Writer<OutputFile>> {
        let config = &self.config;
        let adjusted = input.adjusted_gps_time(time_s);
        let recorded = adjusted.and_then(day_of_year).map(|(year, day)| (day, year)).or(input.recorded);
        let (creation_day, creation_year) = recorded.unwrap_or((0, 0));
        let extra_attributes: Vec<_> = self.attributes.iter().map(|attribute| attribute.stored).collect();
        let options = WriterOptions {
            version: match config.version {
                VersionKey::V1_4 => LasVersion::V1_4,
                VersionKey::V1_3 => LasVersion::V1_3,
                VersionKey::V1_2 => LasVersion::V1_2,
            },
            scale: config.steps(input),
            offset: offsets(input, first),
            wkt: input.crs_wkt.as_deref(),
            extra_attributes: &extra_attributes,
            adjusted_gps_time: adjusted.is_some(),
            creation_day,
            creation_year,
            system_identifier: input.instrument.as_deref().unwrap_or("EXTRACTION"),
            generating_software: concat!("wavex ", env!("CARGO_PKG_VERSION")),
            file_source_id: self.flight_line.unwrap_or(0),
            project_id: identity::guid(&config.project_id).unwrap_or_default(),
            waveforms: match config.wave_packets {
                WavePacketsKey::None => WavePlace::None,
                WavePacketsKey::External => WavePlace::Beside,
                WavePacketsKey::Internal => WavePlace::Inside,
            },
            index: match config.index {
                IndexKey::None => IndexPlace::None,
                IndexKey::File => IndexPlace::Beside,
                IndexKey::Appended => IndexPlace::Appended,
            },
            pool: self.pool.clone(),
        };
        let path = file.path().to_path_buf();
        Ok(Writer::new(file, &path, &options)?)
    }

    /// Notes on the input, issued once.
    fn note(&self, input: &InputInfo, cx: &mut Context) {
        match &input.crs_wkt {
            None if input.frame == Frame::Map => cx.warn(
                "the input has no coordinate reference system (WKT or EPSG code), so the file has none; set it with the \
                 reader's key `crs_of_input`",
            ),
            None => cx.consequence(Cause::NoTrajectory, "the LAS file has no coordinate reference system"),
            Some(wkt) if self.config.version != VersionKey::V1_4 => {
                if geokeys::from_wkt(wkt).is_none() {
                    cx.warn(
                        "the coordinate reference system has neither an EPSG code nor GeoTIFF keys: the file stores it as \
                         WKT, which is defined for LAS 1.4",
                    );
                }
            }
            Some(_) => {}
        }
    }

    /// Notes once if the header cannot express the time scale of the points.
    fn note_times(input: &InputInfo, time_s: f64, cx: &mut Context) {
        match input.time_scale {
            _ if time_s.is_nan() => {}
            TimeScale::Day => cx.warn(
                "the times of the points are seconds of the day, but the LAS header can only declare seconds of \
                 the GPS week; set the day with the reader's key `gps_date`",
            ),
            TimeScale::Unknown => cx.warn(format!(
                "the time scale of the recording is unknown, and the LAS header declares seconds of the GPS \
                 week; set it with the reader's key `recording_time`: {}",
                possible_scales(time_s)
            )),
            TimeScale::Week | TimeScale::Adjusted => {}
        }
    }
}

impl Sink for LasWriter {
    fn write(&mut self, scan_line: &ScanLine, cx: &mut Context) -> Result<()> {
        let (Some(returns), Some(points)) = (scan_line.returns(), scan_line.points()) else {
            return Ok(());
        };
        let input = &scan_line.input;
        self.input.get_or_insert_with(|| Arc::clone(input));
        // The first point sets the coordinate offset, so the file starts with it.
        if points.is_empty() {
            return Ok(());
        }
        if let LasState::Empty(_) = self.state {
            self.note(input, cx);
            LasWriter::note_times(input, scan_line.stats.gps_time_s, cx);
        }
        self.begin(input, points.first().copied(), scan_line.stats.gps_time_s)?;
        let LasState::Open(writer) = &mut self.state else {
            return Err(StageError::Stopped);
        };
        if self.waves.is_some() && input.gain_control == GainControl::Recorded {
            cx.warn("waveform packets do not contain the gain of their blocks, so their amplitudes are not comparable; keep the container of the recording");
        }
        let blocks = self.waves.as_mut().map(|waves| waves.begin_line(scan_line)).transpose()?;
        let wave_of = |(waves, blocks): (&mut PacketFile, &_)| {
            let points = returns.iter().zip(points);
            points
                .map(|(r, position)| waves.of(scan_line, blocks, r, *position))
                .collect::<Result<Vec<Wave>>>()
        };
        let waves = self.waves.as_mut().zip(blocks).map_or(Ok(Vec::new()), wave_of)?;
        let (layout, line) = (self.config.attribute_layout, self.flight_line);
        let is_legacy = self.config.version != VersionKey::V1_4;
        let made = |number: usize| {
            let r = &returns[number];
            let point = point(input, &scan_line.emissions[r.emission as usize], r, points[number]);
            PointOut {
                classification: attributes::class(layout, is_legacy, r),
                user_data: attributes::user_data(layout, r),
                point_source_id: line.unwrap_or(point.point_source_id),
                wave: waves.get(number).copied().unwrap_or_default(),
                ..point
            }
        };
        if self.stac.is_some() {
            let times = returns.iter().map(|r| gps_time(input, &scan_line.emissions[r.emission as usize]));
            self.times_s =
                times.fold(self.times_s, |[least, most], time_s| [least.min(time_s), most.max(time_s)]);
        }
        let (mut refused, mut n_refused) = (None, 0);
        writer.write_points(
            returns.len().min(points.len()),
            made,
            |numbers, columns| {
                let returns = &returns[numbers];
                self.attributes.iter().for_each(|attribute| attribute.put(returns, columns));
            },
            |error| {
                n_refused += 1;
                refused.get_or_insert(error);
            },
        )?;
        let reason = Reason::PointTooFar;
        cx.reject(reason, n_refused);
        if let (Some(error), None) = (refused, &self.refused) {
            cx.warn(format!("{reason} was rejected; further ones are only counted: {error}"));
            self.refused = Some(error);
        }
        cx.observe("points_per_line", points.len() as f64);
        Ok(())
    }

    fn finish(mut self: Box<Self>, cx: &mut Context) -> Result<()> {
        let input = self.input.take().unwrap_or_default();
        self.begin(&input, None, f64::NAN)?;
        if let LasState::Open(writer) = self.state {
            if writer.n_points() == 0 {
                // If no point fits, the coordinates of the file are wrong.
                self.refused.map_or(Ok(()), Err)?;
                cx.warn("no points were found");
            }
            if writer.n_points() > u64::from(u32::MAX) && self.config.index != IndexKey::None {
                cx.warn("the index format cannot address this many points: the file has no index");
            }
            let [first_s, last_s] = self.times_s;
            let item = self.stac.map(|file| StacFile {
                file,
                wkt: input.crs_wkt.clone(),
                times_s: (first_s <= last_s).then_some(self.times_s),
            });
            let files = CompanionFiles {
                index: self.index,
                waves: self.waves,
                place: self.config.wave_packets,
                item,
            };
            files.finish(*writer, cx)?;
        }
        Ok(())
    }
}

/// Offset of each coordinate: the offset of the input, else the first point rounded to 1000.
pub(crate) fn offsets(input: &InputInfo, first: Option<[f64; 3]>) -> [f64; 3] {
    let near = |m: f64| (m / 1000.0).round() * 1000.0;
    let own = input.coordinate_grid.map(|(_, offset)| offset);
    own.unwrap_or_else(|| first.unwrap_or_default().map(near))
}

/// Converts a return to a LAS point of layout 1.1.
#[inline]
pub(crate) fn point(input: &InputInfo, emission: &Emission, r: &Return, [x, y, z]: [f64; 3]) -> PointOut {
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
        classification: attributes::class(AttributeLayout::V1_1, false, r),
        withheld: r.withheld,
        scanner_channel: attributes::power_channel(r),
        scan_angle_deg: if emission.scan_angle_deg.is_nan() { 0.0 } else { emission.scan_angle_deg },
        user_data: attributes::user_data(AttributeLayout::V1_1, r),
        point_source_id: r.mta_zone.max(0) as u16,
        gps_time: gps_time(input, emission),
        wave: Wave::default(),
    }
}

fn gps_time(input: &InputInfo, emission: &Emission) -> f64 {
    let time_s = emission.gps_time_s;
    input.adjusted_gps_time(time_s).unwrap_or(if time_s.is_nan() { 0.0 } else { time_s })
}

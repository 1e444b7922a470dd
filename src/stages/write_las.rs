//! Points as LAS or LAZ.

use std::sync::Arc;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::batch::{Batch, Emission, InputInfo, Kind, Return, ReturnChannel, emission_flags};
use crate::formats::Error;
use crate::formats::las::{
    AMP, ATTRIBUTES, CHANNEL, DEV_RATIO, ExtraAttribute, INT_ERR, PointOut, RANGE_ERR, RAW_AMP, TARGET_THICK,
    THICK_ERR, WIDE_ERR, WIDE_RATIO, Writer, WriterOptions,
};
use crate::geo::time::{adjusted_gps_time, day_of_year};
use crate::stage::{
    Config, Context, InvalidKey, Item, OutputFile, Result, Sink, SinkConfig, Site, StageSpec,
};

/// The stage's place in the registry.
pub const STAGE: StageSpec =
    StageSpec::sink::<WriteLas>("write_las", &[Kind::Points]).after(&["georeference"]);

/// Writes points as LAS or LAZ 1.4, point format 6: the extension of `path` decides which.
///
/// Intensity is the corrected intensity, rounded. Return numbers, scan angle, scan direction and edge of flight line are
/// those of the emission; times are adjusted GPS time where the input tells the week, else as the input has them, and the
/// header says which. The point source id is the multiple-time-around zone, the user data byte holds the flags of the fit
/// (bit 0 refined, 1 overlap, 2 diverged at first, 3 to 5 cross-talk, 6 saturated, 7 extremely saturated), outliers are
/// withheld and of class 20. The coordinate reference system of the points goes into the file as WKT.
///
/// Extra attributes: `WideRatio`, `TargetThick`, `Amp`, `DevRatio`, `RangeErr`, `IntErr`, `WideErr`, `ThickErr` and
/// `Channel` (0 low, 1 high power), with the scales, offsets and types of BayesWavEx 1.1. All values are clamped to what
/// their type can hold, never wrapped.
///
/// Rejected, and counted, are points too far away for 32-bit coordinates of the step; where that is every point, it is an
/// error.
///
/// The bytes do not depend on the number of threads, and the creation date is that of the data.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct WriteLas {
    /// The file, `.las` or `.laz`; `*` is the input's stem.
    pub path: String,
    /// Write the extra attributes.
    pub extra_attributes: bool,
    /// Of these, write the standard deviations, too.
    pub uncertainty: bool,
    /// Step of the coordinates, in units of the coordinate reference system; when not given, 0.001, or that of the input or
    /// of `georeference` where it is below 0.00001, as degrees need it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub coordinate_step: Option<f64>,
}

impl Default for WriteLas {
    fn default() -> WriteLas {
        WriteLas { path: "*.laz".into(), extra_attributes: true, uncertainty: true, coordinate_step: None }
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
        InvalidKey::unless(
            self.coordinate_step.is_none_or(|step| (1e-9..=1.0).contains(&step)),
            "coordinate_step",
            "it must lie between 1e-9 and 1",
        )
    }
}

impl SinkConfig for WriteLas {
    fn outputs(&self) -> Vec<&str> {
        vec![&self.path]
    }

    fn make(&self, site: &Site) -> Result<Box<dyn Sink>> {
        let file = site.create(&self.path)?;
        let attributes = self.attributes();
        Ok(Box::new(LasSink {
            config: self.clone(),
            attributes,
            threads: site.threads,
            state: State::Empty(file),
            input: None,
            extra: Vec::new(),
            refused: None,
        }))
    }
}

impl WriteLas {
    /// The extra attributes to write, in their order.
    fn attributes(&self) -> Vec<ExtraAttribute> {
        let is_uncertainty =
            |attribute: &ExtraAttribute| [RANGE_ERR, INT_ERR, WIDE_ERR, THICK_ERR].contains(attribute);
        let wanted = |attribute: &&ExtraAttribute| {
            **attribute != RAW_AMP && (self.uncertainty || !is_uncertainty(attribute))
        };
        if self.extra_attributes { ATTRIBUTES.iter().filter(wanted).copied().collect() } else { Vec::new() }
    }

    /// The step of each coordinate.
    fn steps(&self, input: &InputInfo) -> [f64; 3] {
        let usual = input.coordinate_grid.map_or([USUAL_STEP; 3], |(steps, _)| {
            steps.map(|step| if step < DEGREES_STEP { step } else { USUAL_STEP })
        });
        self.coordinate_step.map_or(usual, |step| [step; 3])
    }

    /// Writes what stands before the points. The offset of the coordinates is the input's own, else the first point's,
    /// rounded.
    fn begin(
        &self,
        file: OutputFile,
        input: &InputInfo,
        first: Option<[f64; 3]>,
        time_s: f64,
        attributes: &[ExtraAttribute],
        threads: usize,
    ) -> Result<Writer<OutputFile>> {
        let offset = input.coordinate_grid.map(|(_, offset)| offset);
        let near = |m: f64| (m / 1000.0).round() * 1000.0;
        let adjusted = adjusted_gps_time(input, time_s);
        let recorded = adjusted.and_then(day_of_year).map(|(year, day)| (day, year)).or(input.recorded);
        let (creation_day, creation_year) = recorded.unwrap_or((0, 0));
        let options = WriterOptions {
            scale: self.steps(input),
            offset: offset.unwrap_or_else(|| first.unwrap_or_default().map(near)),
            wkt: input.crs_wkt.as_deref(),
            extra_attributes: attributes,
            adjusted_gps_time: adjusted.is_some(),
            creation_day,
            creation_year,
            system_identifier: input.instrument.as_deref().unwrap_or("EXTRACTION"),
            generating_software: concat!("wavex ", env!("CARGO_PKG_VERSION")),
            file_source_id: 0,
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
    attributes: Vec<ExtraAttribute>,
    threads: usize,
    state: State,
    input: Option<Arc<InputInfo>>,
    extra: Vec<u8>,
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
    fn writer(
        &mut self,
        input: &InputInfo,
        first: Option<[f64; 3]>,
        time_s: f64,
    ) -> Result<&mut Writer<OutputFile>> {
        if let State::Empty(_) = self.state
            && let State::Empty(file) = std::mem::replace(&mut self.state, State::Broken)
        {
            let writer = self.config.begin(file, input, first, time_s, &self.attributes, self.threads)?;
            self.state = State::Open(Box::new(writer));
        }
        match &mut self.state {
            State::Open(writer) => Ok(writer),
            State::Empty(_) | State::Broken => Err(crate::stage::StageError::Stopped),
        }
    }
}

impl Sink for LasSink {
    fn write(&mut self, batch: &Batch, cx: &mut Context) -> Result<()> {
        let (Some(returns), Some(points)) = (batch.returns(), batch.points()) else {
            return Ok(());
        };
        // The first point decides about the offset of the coordinates, so that a file begins with it.
        self.input.get_or_insert_with(|| Arc::clone(&batch.input));
        if points.is_empty() {
            return Ok(());
        }
        if batch.input.crs_wkt.is_none() {
            cx.note("the input names no coordinate reference system by WKT or EPSG code: the file has none");
        }
        let mut extra = std::mem::take(&mut self.extra);
        let attributes = self.attributes.clone();
        let input = &batch.input;
        let writer = self.writer(input, points.first().copied(), batch.stats.gps_time_s)?;
        let mut refused = None;
        for (r, position) in returns.iter().zip(points) {
            let point = point(input, &batch.emissions[r.emission as usize], r, *position);
            extra.clear();
            attributes.iter().for_each(|attribute| attribute.push(value(attribute, r), &mut extra));
            match writer.write_point(&point, &extra) {
                Ok(()) => {}
                Err(error @ Error::Io { .. }) => return Err(error.into()),
                Err(error) => {
                    cx.reject(Item::Returns, TOO_FAR, 1);
                    refused.get_or_insert(error);
                }
            }
        }
        if let (Some(error), None) = (refused, &self.refused) {
            cx.note(format!("{TOO_FAR} was left out, and so is every further one: {error}"));
            self.refused = Some(error);
        }
        self.extra = extra;
        cx.observe("points_per_line", points.len() as f64);
        Ok(())
    }

    fn finish(mut self: Box<Self>, cx: &mut Context) -> Result<()> {
        let input = self.input.take().unwrap_or_default();
        self.writer(&input, None, f64::NAN)?;
        if let State::Open(writer) = self.state {
            if writer.n_points() == 0 {
                // Not one point fits: then it is the file's coordinates that are wrong.
                self.refused.map_or(Ok(()), Err)?;
                cx.note("not a single point was found");
            }
            cx.keep(writer.finish()?.finish()?);
        }
        Ok(())
    }
}

fn point(input: &InputInfo, emission: &Emission, r: &Return, [x, y, z]: [f64; 3]) -> PointOut {
    let flag = |bit: u16| emission.flags & bit != 0;
    PointOut {
        x,
        y,
        z,
        // A float converts to the nearest integer in range: larger values clamp, NaN is 0.
        intensity: r.intensity.round() as u16,
        return_number: r.return_number,
        number_of_returns: r.number_of_returns,
        scan_direction: flag(emission_flags::SCAN_DIRECTION_POSITIVE),
        edge_of_flight_line: flag(emission_flags::EDGE_OF_FLIGHT_LINE),
        classification: r.class,
        withheld: r.withheld,
        scanner_channel: 0,
        scan_angle_deg: if emission.scan_angle_deg.is_nan() { 0.0 } else { emission.scan_angle_deg },
        user_data: r.flags as u8,
        point_source_id: r.mta_zone.max(0) as u16,
        gps_time: gps_time(input, emission),
    }
}

fn gps_time(input: &InputInfo, emission: &Emission) -> f64 {
    let time_s = emission.gps_time_s;
    adjusted_gps_time(input, time_s).unwrap_or(if time_s.is_nan() { 0.0 } else { time_s })
}

/// The value of an extra attribute of BayesWavEx 1.1 (section 3).
fn value(attribute: &ExtraAttribute, r: &Return) -> f64 {
    match attribute.name {
        name if name == WIDE_RATIO.name => r.width_ratio,
        name if name == TARGET_THICK.name => r.thickness_m,
        name if name == AMP.name => linear_amplitude(r),
        name if name == DEV_RATIO.name => r.deviation_ratio,
        name if name == RANGE_ERR.name => r.range_sd_m,
        name if name == INT_ERR.name => r.intensity_sd,
        name if name == WIDE_ERR.name => r.width_ratio_sd,
        name if name == THICK_ERR.name => r.thickness_sd_m,
        name if name == CHANNEL.name => f64::from(u8::from(r.channel != ReturnChannel::Low)),
        _ => f64::NAN,
    }
}

/// Linear amplitude: `7 × 10^(dB/10)` with the instrument's table, else the peak's height.
fn linear_amplitude(r: &Return) -> f64 {
    if r.amplitude_db.is_nan() { r.amplitude_dn } else { 7.0 * 10f64.powf(r.amplitude_db / 10.0) }
}

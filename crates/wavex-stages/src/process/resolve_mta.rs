//! `resolve_mta`: assigns echoes to pulses with several pulses in the air.

use std::path::PathBuf;
use std::sync::Arc;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::process::calibrate::Auto;
use wavex_formats::terrain::Terrain;
use wavex_line::georef::Geometry;
use wavex_line::keys::{InvalidKey, above, at_least};
use wavex_line::scan_line::{Kind, ScanLine};
use wavex_line::stage::{
    Config, Output, Result, RunContext, StageError, StageSpec, Transform, TransformConfig,
};
use wavex_returns::mta::{Method, MtaError, Prior, Settings};

mod echoes;
mod geometry;
mod line_window;
mod summary;
#[cfg(test)]
mod tests;

use line_window::ZoneWindow;

/// Registry entry of the stage.
pub const STAGE: StageSpec = StageSpec::transform::<ResolveMta>("resolve_mta", &[Kind::Shots]);

/// Number of scan lines before and after a shot that decide on its zone.
pub const LINES_AROUND: usize = 200;
/// Largest zone searched.
const LARGEST_ZONE: u16 = 126;
/// Default standard deviation of the terrain about a single height above ground, m.
const USUAL_AGL_SD_M: f64 = 100.0;

/// Assigns each echo to its pulse where several are in the air.
///
/// Resolves multiple time around (MTA): every block is moved to the shot that caused it, whose
/// origin and direction then apply to its echoes.
///
/// A raw recording stores a block with the latest shot before its reception, several shots too
/// late. Lasers vary the intervals between their pulses, so that only the correct shot turns the
/// ranges into a smooth surface. Evidence is collected over cells of neighbouring echoes and
/// combined over the line window (`docs/explanation/mta.md`). Circular scanners are recognised from the
/// rotation of their beams, and compared by azimuth. **If the pulse rate is constant, the recording
/// cannot distinguish one shot from the next**: a prior (`agl_m` or `terrain`) or a fixed `zone` is
/// then required, and the run fails without one. Intervals are those of the outgoing pulses if
/// these are recorded, otherwise those of the clock. If the clock jitters but the pulses do not,
/// the ranges do not follow the clock, and the run also fails without a prior.
///
/// Lines are emitted in order, and the blocks of a shot in order of time. The zone of a shot is the
/// number of emissions between it and the first sample of its first block, from 0; blocks of other
/// zones carry their own. In LAS the attribute `MTA zone` is the zone. Returns whose zone was decided on
/// weak evidence have flag bit 11 (a container written in between does not preserve it). Outgoing
/// pulses stay with their shot. Blocks of both receivers that overlap in time are treated as one,
/// as are all pulses of a block: they go to the shot with the largest total height of supporting
/// echoes. Returns computed by the instrument go with the block that contains them.
///
/// Rejected, and counted, are blocks without an emission at a distance within `range_m`, and blocks
/// a second or more from their shot. Blocks received within `blind_gap_ns` of an emission are
/// counted and kept. The report gives the number of echoes per zone, the variation of the
/// intervals, the number of uncertain zones, and whether the evidence is weak.
///
/// Lines with known zones pass through unchanged. Up to 160 lines are held back (`method =
/// "blocks"`), fewer if they take more than 256 MB. Results do not depend on `memory_mb`. If it
/// cannot hold these lines, the run ends and reports the value to set.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct ResolveMta {
    /// Method: evidence of cells of neighbouring echoes (`blocks`), or least variance of
    /// consecutive ranges (`variance`, for comparison only: it fails in forest and relief).
    pub method: MethodKey,
    /// Number of consecutive ranges compared by the method `variance`.
    #[schemars(range(min = 4, max = 10000))]
    pub buffer: u32,
    /// `"auto"`, or a fixed number of emissions between every echo and its pulse. 0 if no pulse
    /// leaves before the previous one has returned.
    #[schemars(transform = at_least(0.0).at_most(f64::from(LARGEST_ZONE)))]
    pub zone: ZoneKey,
    /// Smallest and largest distance of an echo, m. At most 126 emissions back are searched.
    #[schemars(transform = at_least(0.0).at_most(100_000.0))]
    pub range_m: [f64; 2],
    /// Height above ground as a prior, m: one height, or the smallest and the largest. Level flight
    /// is assumed if the geometry is in the scanner frame.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(transform = above(0.0).at_most(100_000.0))]
    pub agl_m: Option<HeightKey>,
    /// Standard deviation of the terrain about a single `agl_m`, m; default 100.
    #[schemars(range(min = 1.0, max = 10000.0))]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub agl_sd_m: Option<f64>,
    /// Terrain model as a prior: GeoTIFF or ESRI ASCII grid, in the projected CRS and height system
    /// of the recording. With a trajectory it is in the CRS that it names, otherwise in that of the
    /// points. A coarse model is sufficient. Shots that do not hit it have no prior.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub terrain: Option<PathBuf>,
    /// Standard deviation of ranges about those of the terrain model, m.
    #[schemars(range(min = 1.0, max = 10000.0))]
    pub terrain_sd_m: f64,
    /// Echoes closer than this to an emission, before or after it, are counted, ns. Scattering
    /// inside the instrument may also occur there.
    #[schemars(range(min = 0.0, max = 1000.0))]
    pub blind_gap_ns: f64,
}

/// Method to resolve zones.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum MethodKey {
    /// Evidence of cells of neighbouring echoes.
    Blocks,
    /// Least variance of consecutive ranges.
    Variance,
}

/// A zone, or `auto`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(untagged)]
pub enum ZoneKey {
    /// Every echo comes from this many emissions back.
    Fixed(u16),
    /// Estimated from the recording.
    Auto(Auto),
}

/// One height above ground, or the smallest and the largest.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(untagged)]
pub enum HeightKey {
    /// The typical height, m.
    Usual(f64),
    /// The smallest and the largest height, m.
    Between([f64; 2]),
}

impl Default for ResolveMta {
    fn default() -> ResolveMta {
        let settings = Settings::default();
        ResolveMta {
            method: MethodKey::Blocks,
            buffer: 50,
            zone: ZoneKey::Auto(Auto::Auto),
            range_m: settings.range_m,
            agl_m: None,
            agl_sd_m: None,
            terrain: None,
            terrain_sd_m: 20.0,
            blind_gap_ns: settings.blind_gap_ns,
        }
    }
}

impl Config for ResolveMta {
    fn check(&self) -> std::result::Result<(), InvalidKey> {
        let unless = InvalidKey::unless;
        let [near, far] = self.range_m;
        unless(near < far, "range_m", "it must be two ascending distances")?;
        let ascending = !matches!(self.agl_m, Some(HeightKey::Between([low, high])) if low >= high);
        unless(ascending, "agl_m", "it must be a height, or two ascending ones")?;
        let single = matches!(self.agl_m, Some(HeightKey::Usual(_)));
        unless(
            self.agl_sd_m.is_none() || single,
            "agl_sd_m",
            "it needs a single `agl_m`: two heights already define the spread of the terrain",
        )?;
        let one_prior = self.agl_m.is_none() || self.terrain.is_none();
        unless(one_prior, "agl_m", "`terrain` is the more detailed prior: remove one of them")?;
        let is_fixed = matches!(self.zone, ZoneKey::Fixed(_));
        let has_prior = self.agl_m.is_some() || self.terrain.is_some();
        unless(!(is_fixed && has_prior), "zone", "a fixed zone needs no prior: remove `agl_m` and `terrain`")
    }

    fn spell_out(&mut self) {
        if matches!(self.agl_m, Some(HeightKey::Usual(_))) {
            self.agl_sd_m.get_or_insert(USUAL_AGL_SD_M);
        }
    }

    fn inputs(&self) -> Vec<&str> {
        self.terrain.iter().filter_map(|path| path.to_str()).collect()
    }
}

impl ResolveMta {
    /// Kernel settings for this group velocity.
    fn settings(&self, group_velocity_mps: f64) -> Settings {
        let method = match (self.zone, self.method) {
            (ZoneKey::Fixed(zone), _) => Method::Fixed(zone),
            (_, MethodKey::Blocks) => Method::Blocks,
            (_, MethodKey::Variance) => Method::Variance { buffer: self.buffer as usize },
        };
        let prior = match (self.agl_m, &self.terrain) {
            (_, Some(_)) => Prior::PerEmission { sd_m: self.terrain_sd_m },
            (Some(HeightKey::Usual(agl_m)), _) => {
                Prior::Agl { agl_m, sd_m: self.agl_sd_m.unwrap_or(USUAL_AGL_SD_M) }
            }
            (Some(HeightKey::Between([low, high])), _) => {
                Prior::Agl { agl_m: 0.5 * (low + high), sd_m: (0.5 * (high - low)).max(1.0) }
            }
            (None, None) => Prior::None,
        };
        let (range_m, blind_gap_ns) = (self.range_m, self.blind_gap_ns);
        Settings { method, prior, range_m, group_velocity_mps, blind_gap_ns, is_cyclic: false }
    }
}

impl TransformConfig for ResolveMta {
    fn make(&self, run: &RunContext) -> Result<Box<dyn Transform>> {
        let terrain = match &self.terrain {
            Some(path) => Some(Terrain::open(&run.input_path(path))?),
            None => None,
        };
        let placed = Arc::clone(&run.geometry);
        Ok(Box::new(MtaResolver { config: self.clone(), terrain, placed, strip: None }))
    }
}

struct MtaResolver {
    config: ResolveMta,
    terrain: Option<Terrain>,
    /// Positions of the shots on the earth.
    placed: Arc<Geometry>,
    /// The pending lines, while any have unknown zones.
    strip: Option<ZoneWindow>,
}

impl Transform for MtaResolver {
    fn process(&mut self, line: ScanLine, out: &mut Output) -> Result<()> {
        let is_unresolved = line.emissions.iter().any(|emission| emission.mta_zone.is_none());
        if !is_unresolved && !line.emissions.is_empty() {
            out.cx.info("lines with known zones pass through unchanged");
            self.finish(out)?;
            return out.emit(line);
        }
        let strip = match &mut self.strip {
            Some(strip) => strip,
            // A line without shots is held back only if earlier lines are.
            None if !is_unresolved => return out.emit(line),
            None => self.strip.insert(ZoneWindow::new(
                &self.config,
                &line,
                self.terrain.as_ref(),
                &self.placed,
                out,
            )?),
        };
        strip.push(line, self.terrain.as_ref(), out)
    }

    fn finish(&mut self, out: &mut Output) -> Result<()> {
        match self.strip.take() {
            Some(strip) => strip.finish(self.terrain.as_ref(), out),
            None => Ok(()),
        }
    }
}

/// Converts a kernel error to a stage error.
fn failed(error: &MtaError) -> StageError {
    match error {
        MtaError::ConstantRate { interval_ns, rms_ns, least_ns } => StageError::failed(
            format!(
                "the pulse rate is constant: intervals of {interval_ns:.3} ns vary by {rms_ns:.3} ns RMS, but at least {least_ns} ns \
                 are needed to assign echoes to pulses"
            ),
            "set a prior (`agl_m`, `terrain`), or a fixed `zone`",
        ),
        MtaError::JitteringClock { rms_ns, following } => StageError::failed(
            format!(
                "the time stamps jitter, not the pulses: intervals vary by {rms_ns:.3} ns RMS on the clock, but neighbouring \
                 ranges contain {:.0} % of that, so echoes cannot be assigned to pulses",
                100.0 * following.max(0.0)
            ),
            "set a prior (`agl_m`, `terrain`), or a fixed `zone`",
        ),
        MtaError::Settings(problem) => {
            StageError::failed(*problem, "correct the metadata of the recording, or the keys of the stage")
        }
        other => StageError::failed(other.to_string(), "please report this bug in wavex"),
    }
}

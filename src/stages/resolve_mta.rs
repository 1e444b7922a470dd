//! Which pulse caused each echo, where several are in the air.

use std::path::PathBuf;
use std::sync::Arc;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::calibrate::Auto;
use crate::batch::{Batch, Kind};
use crate::formats::terrain::Terrain;
use crate::geometry::Geometry;
use crate::kernels::mta::{Method, MtaError, Prior, Settings};
use crate::stage::{
    Config, InvalidKey, Output, Result, Site, StageError, StageSpec, Transform, TransformConfig,
};

mod echoes;
mod geometry;
mod strip;
mod summary;
#[cfg(test)]
mod tests;

use strip::Strip;

/// The stage's place in the registry.
pub const STAGE: StageSpec = StageSpec::transform::<ResolveMta>("resolve_mta", &[Kind::Shots]);

/// Zones beyond this are never looked at.
const LARGEST_ZONE: u16 = 126;
/// How far terrain departs from a single height above ground where the job does not say it, m.
const USUAL_AGL_SD_M: f64 = 100.0;

/// Finds which pulse caused each echo, where several pulses are in the air at once (multiple time around), and puts every
/// block to the shot that caused it: origin and direction of an echo are those of that shot.
///
/// A raw recording holds a block with the shot after whose emission it came back, several shots late. Lasers vary the
/// intervals between their pulses, so that only the right shot makes a smooth surface of the ranges. Evidence is gathered
/// over cells of neighbouring echoes and joined over the strip (`docs/explanation/mta.md`). Circular scanners are recognised by how
/// their beams turn, and compared by azimuth. **Where the pulse rate is constant, nothing
/// in the recording tells one shot from the next**: then a prior is needed (`agl_m` or `terrain`) or a fixed `zone`, and the
/// run fails without one. Intervals are those of the outgoing pulses where these are recorded, else of the clock. Where the clock
/// jitters and the pulses do not, ranges do not follow it, and the run fails without a prior, too.
///
/// Lines come out in order, the blocks of a shot in order of time. The shot's zone is the number of emissions between it and
/// the first sample of its first block, from 0; a block of another zone says its own. In LAS the zone is the point source
/// id. Returns of a zone that was decided against little evidence have flag bit 11 (a container written in between does not
/// keep that). Outgoing pulses stay. Blocks of both
/// receivers that overlap in time are one, and so are all pulses of a block: they get the shot that most of them speak for,
/// weighted with their heights. What the instrument itself computed goes with the block it lies in.
///
/// Rejected, and counted, are blocks without an emission at a distance within `range_m`, and blocks a second or more from
/// their shot. Blocks received within `blind_gap_ns` of an emission are counted and kept. The report says how many echoes
/// each zone has, how much the intervals vary, how many zones are uncertain, and whether the evidence is thin.
///
/// Lines whose zones are known already pass through as they are. Up to 160 lines are held back (`method = "blocks"`), and
/// fewer where they take more than 256 MB. Results do not depend on `memory_mb`. Where it does not hold these lines, the run
/// ends with the value to set.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct ResolveMta {
    /// How zones are found: by the evidence of cells of neighbouring echoes (`blocks`), or by the least variance of
    /// consecutive ranges (`variance`, for comparisons: it fails in woods and relief).
    pub method: MethodKey,
    /// How many consecutive ranges the method `variance` compares.
    #[schemars(range(min = 4, max = 10000))]
    pub buffer: u32,
    /// `"auto"`, or a number: every echo comes from so many emissions back. 0 where no pulse leaves before the last one is
    /// back.
    pub zone: ZoneKey,
    /// Least and greatest distance that an echo may come from. At most 126 emissions back are looked at.
    pub range_m: [f64; 2],
    /// Height above ground as a prior: one height, or the least and the greatest. The aircraft is taken to fly level where
    /// the geometry is the scanner's own.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub agl_m: Option<HeightKey>,
    /// How far, as a standard deviation, terrain departs from a single `agl_m`; 100 when not given.
    #[schemars(range(min = 1.0, max = 10000.0))]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub agl_sd_m: Option<f64>,
    /// A terrain model as a prior: GeoTIFF or ESRI ASCII grid, in the map and with the heights of the recording's own
    /// geometry; with a trajectory, in the map that it names itself, else in that of the points. A coarse one will do. Shots
    /// that do not meet it have no prior.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub terrain: Option<PathBuf>,
    /// How far, as a standard deviation, ranges depart from the terrain model's.
    #[schemars(range(min = 1.0, max = 10000.0))]
    pub terrain_sd_m: f64,
    /// Echoes so near to an emission, before or after, are counted: what scatters in the instrument may lie there, too.
    #[schemars(range(min = 0.0, max = 1000.0))]
    pub blind_gap_ns: f64,
}

/// How zones are found.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum MethodKey {
    /// By the evidence of cells of neighbouring echoes.
    Blocks,
    /// By the least variance of consecutive ranges.
    Variance,
}

/// A zone, or `auto`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(untagged)]
pub enum ZoneKey {
    /// Every echo comes from so many emissions back.
    Fixed(u16),
    /// Found from the recording.
    Auto(Auto),
}

/// One height above ground, or the least and the greatest.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(untagged)]
pub enum HeightKey {
    /// The usual height, m.
    Usual(f64),
    /// The least and the greatest, m.
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
        unless((4..=10_000).contains(&self.buffer), "buffer", "it must lie between 4 and 10000")?;
        let [near, far] = self.range_m;
        let ascending = 0.0 <= near && near < far && far <= 100_000.0;
        unless(ascending, "range_m", "it must be two ascending distances between 0 and 100000")?;
        let sd = |sd: f64| (1.0..=10_000.0).contains(&sd);
        unless(self.agl_sd_m.is_none_or(sd), "agl_sd_m", "it must lie between 1 and 10000")?;
        unless(sd(self.terrain_sd_m), "terrain_sd_m", "it must lie between 1 and 10000")?;
        let gap = (0.0..=1000.0).contains(&self.blind_gap_ns);
        unless(gap, "blind_gap_ns", "it must lie between 0 and 1000")?;
        let heights = match self.agl_m {
            None => true,
            Some(HeightKey::Usual(height)) => height > 0.0 && height <= 100_000.0,
            Some(HeightKey::Between([low, high])) => 0.0 < low && low < high && high <= 100_000.0,
        };
        unless(heights, "agl_m", "it must be a height, or two ascending ones, above 0 and at most 100000")?;
        let single = matches!(self.agl_m, Some(HeightKey::Usual(_)));
        unless(
            self.agl_sd_m.is_none() || single,
            "agl_sd_m",
            "it belongs to a single `agl_m`: two heights say themselves how far terrain departs",
        )?;
        let one_prior = self.agl_m.is_none() || self.terrain.is_none();
        unless(one_prior, "agl_m", "`terrain` says more: leave one of them out")?;
        let ZoneKey::Fixed(zone) = self.zone else { return Ok(()) };
        unless(zone <= LARGEST_ZONE, "zone", "it must be \"auto\" or lie between 0 and 126")?;
        let undecided = self.agl_m.is_none() && self.terrain.is_none();
        unless(undecided, "zone", "a fixed zone leaves nothing to decide: leave `agl_m` and `terrain` out")
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
    /// What the kernel is told, for a pulse of this speed.
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
    fn make(&self, site: &Site) -> Result<Box<dyn Transform>> {
        let terrain = match &self.terrain {
            Some(path) => Some(Terrain::open(&site.input_path(path))?),
            None => None,
        };
        let placed = Arc::clone(&site.geometry);
        Ok(Box::new(Resolving { config: self.clone(), terrain, placed, strip: None }))
    }
}

struct Resolving {
    config: ResolveMta,
    terrain: Option<Terrain>,
    /// Where the shots are on the earth.
    placed: Arc<Geometry>,
    /// The lines at hand, while there are any whose zones are unknown.
    strip: Option<Strip>,
}

impl Transform for Resolving {
    fn process(&mut self, batch: Batch, out: &mut Output) -> Result<()> {
        let is_unresolved = batch.emissions.iter().any(|emission| emission.mta_zone.is_none());
        if !is_unresolved && !batch.emissions.is_empty() {
            out.cx.note("lines whose zones are known already pass through as they are");
            self.finish(out)?;
            return out.emit(batch);
        }
        let strip = match &mut self.strip {
            Some(strip) => strip,
            // A line without shots waits only where others do.
            None if !is_unresolved => return out.emit(batch),
            None => {
                self.strip.insert(Strip::new(&self.config, &batch, self.terrain.as_ref(), &self.placed, out)?)
            }
        };
        strip.push(batch, self.terrain.as_ref(), out)
    }

    fn finish(&mut self, out: &mut Output) -> Result<()> {
        match self.strip.take() {
            Some(strip) => strip.finish(self.terrain.as_ref(), out),
            None => Ok(()),
        }
    }
}

/// Why zones cannot be found, as the stage says it.
fn failed(error: &MtaError) -> StageError {
    match error {
        MtaError::ConstantRate { interval_ns, rms_ns, least_ns } => StageError::failed(
            format!(
                "the pulse rate is constant: intervals of {interval_ns:.3} ns vary by {rms_ns:.3} ns rms, at least {least_ns} ns \
                 are needed to tell which pulse caused an echo"
            ),
            "give a prior (`agl_m`, `terrain`), or a fixed `zone`",
        ),
        MtaError::JitteringClock { rms_ns, following } => StageError::failed(
            format!(
                "the time stamps jitter, and not the pulses: intervals vary by {rms_ns:.3} ns rms on the clock, but neighbouring \
                 ranges contain {:.0} % of that, so nothing says which pulse caused an echo",
                100.0 * following.max(0.0)
            ),
            "give a prior (`agl_m`, `terrain`), or a fixed `zone`",
        ),
        MtaError::Settings(problem) => {
            StageError::failed(*problem, "correct what the recording says of itself, or the stage's keys")
        }
        other => StageError::failed(other.to_string(), "report this as a defect of wavex"),
    }
}

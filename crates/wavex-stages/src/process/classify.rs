//! `classify`: ground and noise among points.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use wavex_ground::filter::{GroundSettings, classify_tile};
use wavex_ground::point::{Class, CloudPoint};
use wavex_ground::rays::{NoiseSettings, mark_noise};
use wavex_line::keys::{InvalidKey, above};
use wavex_line::scan_line::{Kind, LineStats, Return, ScanLine};
use wavex_line::stage::{Config, Output, Result, RunContext, StageSpec, Transform, TransformConfig};

use super::line_blocks::{LineBlocks, mark, set_classes};

pub(super) mod cloud;

use cloud::CloudOfMap;

/// Registry entry of the stage.
pub const STAGE: StageSpec = StageSpec::transform::<Classify>("classify", &[Kind::Points]);

/// Classifies points: ground (2), noise (7, 18), others (1).
///
/// Points of a block of scan lines are compared with the beams of the same block. A point is low noise (7) if it is below the
/// surface that other beams have met around it. An object in the air is high noise (18) if other beams have passed through its
/// place. Noise is marked as withheld; it is never removed. The ground is then found among the other points.
/// Only last returns can be ground. Echo widths, overlap flags and standard deviations are not used.
/// `docs/explanation/ground.md` gives the methods and measurements.
///
/// Blocks follow the flight. Lines within `margin_m` before and after a block are used in its classification. If `memory_mb`
/// cannot hold them, blocks are shorter, and the report says so. Only points of one flight line are compared;
/// `wavex classify` compares all points of several files.
///
/// Returns that an earlier stage has withheld keep their class and are not used. Without map coordinates, lines pass through
/// unchanged, with a warning. Water is not recognised.
///
/// Counts `np_air np_low`.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Classify {
    /// Mark noise.
    pub noise: bool,
    /// Find the ground.
    pub ground: bool,
    /// Length of a block along the flight, m.
    #[schemars(range(min = 10.0, max = 100000.0))]
    pub block_m: f64,
    /// Length before and after a block that takes part in its classification, m.
    #[schemars(transform = above(0.0).at_most(10_000.0))]
    pub margin_m: f64,
}

impl Default for Classify {
    fn default() -> Classify {
        Classify { noise: true, ground: true, block_m: 250.0, margin_m: 100.0 }
    }
}

impl Config for Classify {
    fn check(&self) -> std::result::Result<(), InvalidKey> {
        InvalidKey::unless(
            self.noise || self.ground,
            "ground",
            "with `noise = false` it must be `true`; otherwise the stage does nothing",
        )
    }
}

impl TransformConfig for Classify {
    fn make(&self, run: &RunContext) -> Result<Box<dyn Transform>> {
        let (noise, ground) = (self.noise, self.ground);
        let blocks = LineBlocks::new(
            [self.block_m, self.margin_m],
            run.pool.clone(),
            Box::new(move |points| classes(points, noise, ground)),
            Box::new(move |scan_line, classes| {
                set_classes(scan_line, classes, |r, class, stats| set(r, class, stats, ground));
            }),
        );
        Ok(Box::new(Classifier { blocks, clouds: CloudOfMap::default() }))
    }
}

/// Classes of all points of a block.
fn classes(points: &[CloudPoint], noise: bool, ground: bool) -> Vec<Class> {
    let mut classes = match noise {
        true => mark_noise(points, &NoiseSettings::default()),
        false => vec![Class::Unclassified; points.len()],
    };
    if ground {
        let (places, others): (Vec<usize>, Vec<CloudPoint>) =
            (0..points.len()).zip(points).filter(|(at, _)| classes[*at] == Class::Unclassified).unzip();
        for (at, class) in places.into_iter().zip(classify_tile(&others, &GroundSettings::default())) {
            classes[at] = class;
        }
    }
    classes
}

/// Sets the class of a return.
fn set(r: &mut Return, class: Class, stats: &mut LineStats, ground: bool) {
    if r.withheld {
        return;
    }
    match class {
        Class::LowNoise | Class::HighNoise => mark(r, class, stats),
        class if ground => r.class = class as u8,
        _ => {}
    }
}

struct Classifier {
    blocks: LineBlocks,
    clouds: CloudOfMap,
}

impl Transform for Classifier {
    fn process(&mut self, line: ScanLine, out: &mut Output) -> Result<()> {
        let Some(cloud) = self.clouds.of(&line) else {
            out.cx.warn("points that are not in a map cannot be classified: give [job.geometry] a `trajectory` and a `crs`");
            self.blocks.finish(out)?;
            return out.emit(line);
        };
        let place_m = line.emissions.get(line.emissions.len() / 2).map(|middle| middle.origin_m);
        let unit_m = line.input.map_unit_m();
        self.blocks.push(line, cloud, place_m.map(|place| place.map(|x| unit_m * x)), out)
    }

    fn finish(&mut self, out: &mut Output) -> Result<()> {
        self.blocks.finish(out)
    }
}

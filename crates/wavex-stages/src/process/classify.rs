//! `classify`: ground and noise among points.

use std::sync::Arc;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use wavex_ground::filter::{GroundSettings, classify_tile};
use wavex_ground::height::heights_above_ground;
use wavex_ground::point::{Class, CloudPoint};
use wavex_ground::rays::{NoiseSettings, mark_noise};
use wavex_line::keys::{InvalidKey, above};
use wavex_line::scan_line::{Content, Frame, InputInfo, Kind, ScanLine};
use wavex_line::stage::{Config, Output, Result, RunContext, StageSpec, Transform, TransformConfig};

use super::line_blocks::{LineBlocks, mark};

pub(super) mod cloud;

use cloud::CloudOfMap;

/// Mean radius of the earth (IUGG 1980), m.
const RADIUS_M: f64 = 6_371_008.8;

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
/// Returns that an earlier stage has withheld keep their class and are not used. Without map coordinates, or in degrees, lines pass
/// through unchanged, with a warning. Water is not recognised.
///
/// With `height_above_ground`, each point gets its height above the triangulated ground points of its block, in metres; it is
/// unknown outside the triangulation. `write_las` and `write_table` write it.
///
/// `AGL` of the line statistics becomes the median height of the sensor above the ground points of the line, if it has any.
/// Stages before this one cannot use the ground: it is known only after `georeference`, and a block later.
///
/// Counts `np_air np_low`.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Classify {
    /// Mark noise.
    pub noise: bool,
    /// Find the ground.
    pub ground: bool,
    /// Compute the height of each point above the ground.
    pub height_above_ground: bool,
    /// Length of a block along the flight, m.
    #[schemars(range(min = 10.0, max = 100000.0))]
    pub block_m: f64,
    /// Length before and after a block that takes part in its classification, m.
    #[schemars(transform = above(0.0).at_most(10_000.0))]
    pub margin_m: f64,
}

impl Default for Classify {
    fn default() -> Classify {
        Classify { noise: true, ground: true, height_above_ground: false, block_m: 250.0, margin_m: 100.0 }
    }
}

impl Config for Classify {
    fn check(&self) -> std::result::Result<(), InvalidKey> {
        InvalidKey::unless(
            self.noise || self.ground,
            "ground",
            "with `noise = false` it must be `true`; otherwise the stage does nothing",
        )?;
        InvalidKey::unless(
            self.ground || !self.height_above_ground,
            "height_above_ground",
            "it needs `ground = true`: without ground there are no heights above it",
        )
    }
}

impl TransformConfig for Classify {
    fn make(&self, run: &RunContext) -> Result<Box<dyn Transform>> {
        let (noise, ground, has_heights) = (self.noise, self.ground, self.height_above_ground);
        let blocks = LineBlocks::new(
            [self.block_m, self.margin_m],
            run.pool.clone(),
            Box::new(move |points| judged(points, classes(points, noise, ground), has_heights)),
            Box::new(move |scan_line, judged| set(scan_line, judged, ground)),
        );
        Ok(Box::new(Classifier { blocks, clouds: CloudOfMap::default(), has_heights, input: None }))
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

/// What is found of a point.
#[derive(Clone, Copy)]
struct JudgedPoint {
    class: Class,
    /// NaN if unknown.
    height_above_ground_m: f32,
    /// Upward part of the unit vector from the sensor.
    beam_up: f32,
}

/// Adds heights to classes, if wanted.
fn judged(points: &[CloudPoint], classes: Vec<Class>, has_heights: bool) -> Vec<JudgedPoint> {
    let heights_m = if has_heights { heights_above_ground(points, &classes) } else { Vec::new() };
    let heights_m = heights_m.into_iter().chain(std::iter::repeat(f32::NAN));
    let all = points.iter().zip(classes).zip(heights_m);
    all.map(|((point, class), height_above_ground_m)| JudgedPoint {
        class,
        height_above_ground_m,
        beam_up: point.beam[2],
    })
    .collect()
}

/// Sets classes and heights of the returns of a line, and its height above ground.
fn set(scan_line: &mut ScanLine, judged: &[JudgedPoint], ground: bool) {
    let stats = &mut scan_line.stats;
    let (Content::Returns(returns) | Content::Points(returns, _)) = &mut scan_line.content else { return };
    // Height of the sensor above its tangential plane at the return.
    let half_curvature = if scan_line.input.frame == Frame::Earth { 0.5 / RADIUS_M } else { 0.0 };
    let mut sensor_heights_m = Vec::new();
    for (r, of) in returns.iter_mut().zip(judged) {
        r.height_above_ground_m = of.height_above_ground_m;
        if r.withheld {
            continue;
        }
        match of.class {
            Class::LowNoise | Class::HighNoise => mark(r, of.class, stats),
            class if ground => r.class = class as u8,
            _ => {}
        }
        if of.class == Class::Ground {
            let fall_m = -r.range_m * f64::from(of.beam_up);
            sensor_heights_m.push(fall_m - half_curvature * (r.range_m * r.range_m - fall_m * fall_m));
        }
    }
    if let Some(middle) = sensor_heights_m.len().checked_sub(1).filter(|_| scan_line.input.origin_is_sensor) {
        let (_, agl_m, _) = sensor_heights_m.select_nth_unstable_by(middle / 2, f64::total_cmp);
        stats.agl_m = Some(*agl_m).filter(|agl_m| agl_m.is_finite());
    }
}

struct Classifier {
    blocks: LineBlocks<JudgedPoint>,
    clouds: CloudOfMap,
    has_heights: bool,
    /// Metadata of the incoming lines, and of the outgoing lines.
    input: Option<[Arc<InputInfo>; 2]>,
}

impl Classifier {
    /// Metadata of points with heights above the ground.
    fn with_heights(&mut self, input: &Arc<InputInfo>) -> Arc<InputInfo> {
        match &self.input {
            Some([known, with_heights]) if Arc::ptr_eq(known, input) => Arc::clone(with_heights),
            _ => {
                let with_heights =
                    Arc::new(InputInfo { has_heights_above_ground: true, ..InputInfo::clone(input) });
                self.input = Some([Arc::clone(input), Arc::clone(&with_heights)]);
                with_heights
            }
        }
    }
}

impl Transform for Classifier {
    fn process(&mut self, mut line: ScanLine, out: &mut Output) -> Result<()> {
        let Some(cloud) = self.clouds.of(&line) else {
            out.cx.warn(
                "points that are in degrees or not in a map cannot be classified: give [job.geometry] a `trajectory` and a \
                 projected `crs`, such as \"utm\"",
            );
            self.blocks.finish(out)?;
            return out.emit(line);
        };
        let place_m = line.emissions.get(line.emissions.len() / 2).map(|middle| middle.origin_m);
        let unit_m = line.input.map_unit_m();
        if self.has_heights {
            line.input = self.with_heights(&line.input);
        }
        self.blocks.push(line, cloud, place_m.map(|place| place.map(|x| unit_m * x)), out)
    }

    fn finish(&mut self, out: &mut Output) -> Result<()> {
        self.blocks.finish(out)
    }
}

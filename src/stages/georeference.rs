//! Returns to points.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::batch::{Batch, Content, Emission, Frame, Kind, Return};
use crate::stage::{Config, Context, Map, MapConfig, Result, Site, StageError, StageSpec};

/// The stage's place in the registry.
pub const STAGE: StageSpec =
    StageSpec::map::<Georeference>("georeference", &[Kind::Returns], Some(Kind::Points));

/// Gives every return its coordinates: origin of the beam + direction × range.
///
/// Input whose beams are already in a map frame (LAS, PulseWaves, `simulate`) comes out in that frame, and its coordinate
/// reference system goes into the outputs. The ranges of a map projection are stretched along each beam as the input's
/// own geometry is. Input in the scanner's frame comes out in that frame, and the report says so.
///
/// Counts `n_georef`.
#[derive(Clone, Debug, Default, Deserialize, Serialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Georeference {}

impl Config for Georeference {}

impl MapConfig for Georeference {
    fn make(&self, _site: &Site) -> Result<Box<dyn Map>> {
        Ok(Box::new(Georeferencer))
    }
}

struct Georeferencer;

impl Map for Georeferencer {
    fn map(&mut self, mut batch: Batch, cx: &mut Context) -> Result<Batch> {
        if batch.input.frame != Frame::Map {
            cx.note("the input is not georeferenced: its points are in the frame of the scanner");
        }
        let Content::Returns(returns) = batch.content else {
            return Err(StageError::failed("georeference was given no returns", "put decompose before it"));
        };
        let points: Vec<[f64; 3]> =
            returns.iter().map(|r| position(&batch.emissions[r.emission as usize], r)).collect();
        batch.stats.n_georef = points.len() as u64;
        batch.content = Content::Points(returns, points);
        Ok(batch)
    }
}

/// Where a return lies, m, in the frame of its emission.
fn position(emission: &Emission, r: &Return) -> [f64; 3] {
    let reach_m = r.range_m * emission.frame_scale;
    std::array::from_fn(|axis| emission.origin_m[axis] + emission.direction[axis] * reach_m)
}

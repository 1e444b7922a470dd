//! Coordinate reference systems from the records of a file, which may be wrong.

use super::definition::{Definition, LENGTH_UNIT, PROJECTED, VERTICAL, correct_angular_unit, unit_node};
use super::projection::Projection;
use super::wkt::{WktNode, compound};
use super::{Crs, CrsError, Unit, Vector};
use crate::ellipsoid::Geodetic;

/// A system read from a record.
#[derive(Clone, Debug, PartialEq)]
pub struct RecordedSystem {
    /// The system as WKT.
    pub wkt: String,
    /// Parts that contradict others or cannot be read, with what is used instead; for messages.
    pub problems: Vec<String>,
}

/// Reads a CRS from WKT of any dialect; the text stays as it is, if it is one system with angles in degrees.
///
/// # Errors
/// Text that is not the WKT of a projected, geodetic or earth-centred system. Unsupported
/// projections and datums are no error.
pub fn system_of_wkt(text: &str) -> Result<RecordedSystem, CrsError> {
    let mut tree = WktNode::parse(text).map_err(CrsError::Wkt)?;
    let mut problems = Vec::new();
    match Definition::of_wkt(text) {
        Err(error @ CrsError::Wkt(_)) => return Err(error),
        Ok(Definition { epsg: None, horizontal, .. }) => {
            if let Some(code) = horizontal.epsg().filter(|code| *code > 0) {
                problems
                    .push(format!("EPSG:{code} has other parameters or another unit: the code is not used"));
            }
        }
        _ => {}
    }
    let is_pair = tree.keyword == "COMPD_CS" && !text.to_uppercase().contains("COMPD_CS");
    let is_changed = correct_angular_unit(&mut tree) || is_pair;
    Ok(RecordedSystem { wkt: if is_changed { tree.to_string() } else { text.to_owned() }, problems })
}

/// Positions further apart are different, m.
const APART_M: f64 = 1.0;

/// Whether two WKTs place a point differently, by more than 1 m or with another unit of heights.
///
/// `false` if a system is not supported or has no such point.
pub fn are_contradictory(first: &str, second: &str, point: Vector) -> bool {
    let place = |text: &str| {
        let definition = Definition::of_wkt(text).ok()?;
        let height_unit = definition.vertical_unit();
        let crs = Crs::horizontal(definition)?;
        let place = crs.to_geodetic(point).ok()?;
        let on_ellipsoid = Geodetic { height_m: 0.0, ..place };
        Some((crs.ellipsoid().ecef_of(on_ellipsoid), height_unit))
    };
    let Some(((first, first_unit), (second, second_unit))) = place(first).zip(place(second)) else {
        return false;
    };
    let square_m2: f64 = first.iter().zip(second).map(|(a, b)| (a - b) * (a - b)).sum();
    let units = first_unit.zip(second_unit);
    square_m2 > APART_M * APART_M || units.is_some_and(|(first, second)| !first.is_as_long_as(&second))
}

/// Lengths of the units of a projected CRS, m: of x and y, and of heights.
///
/// Both are 1 for other systems and for text that is not WKT; the second is the first without a
/// vertical part.
pub fn units_of_wkt(text: &str) -> [f64; 2] {
    let Some((projected, vertical)) = WktNode::parse(text).ok().and_then(projected_and_vertical) else {
        return [1.0; 2];
    };
    let metres = |part: &WktNode| unit_node(part)?.value(1).filter(|metres| *metres > 0.0);
    let map_m = metres(&projected).unwrap_or(1.0);
    [map_m, vertical.as_ref().and_then(metres).unwrap_or(map_m)]
}

/// The compound CRS with heights in the unit of x and y; `None` for other systems.
pub fn with_heights_in_map_unit(text: &str) -> Option<String> {
    let (projected, vertical) = projected_and_vertical(WktNode::parse(text).ok()?)?;
    let (unit, mut vertical) = (unit_node(&projected)?, vertical?);
    vertical.remove(&|node| matches!(node.keyword.as_str(), "AUTHORITY" | "ID"));
    replace_units(&mut vertical, unit).then(|| compound(projected.clone(), vertical).to_string())
}

/// Replaces the units of length in a node; returns whether there is one.
fn replace_units(node: &mut WktNode, unit: &WktNode) -> bool {
    let mut has_unit = false;
    for part in node.nodes_mut() {
        if LENGTH_UNIT.contains(&part.keyword.as_str()) {
            *part = unit.clone();
            has_unit = true;
        } else {
            has_unit |= replace_units(part, unit);
        }
    }
    has_unit
}

fn projected_and_vertical(tree: WktNode) -> Option<(WktNode, Option<WktNode>)> {
    Some((tree.find(&PROJECTED)?.clone(), tree.find(&VERTICAL).cloned()))
}

impl Crs {
    /// The system of the horizontal positions of a WKT, with heights in metres; `None` if it is not supported.
    pub fn horizontal_of_wkt(text: &str) -> Option<Crs> {
        Crs::horizontal(Definition::of_wkt(text).ok()?)
    }

    /// The system of horizontal positions, which need no geoid; heights are in metres.
    pub(super) fn horizontal(definition: Definition) -> Option<Crs> {
        let projection = Projection::new(&definition).ok()?;
        let unit = definition.unit.clone();
        Some(Crs { definition, projection, geoid: None, unit, height_unit: Unit::metre() })
    }
}

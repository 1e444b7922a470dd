//! Formats a coordinate reference system as PROJJSON 0.7, which GeoParquet requires.

use serde_json::{Value, json};

use super::Unit;
use super::definition::{DATUM, Definition, ELLIPSOID, GEODETIC, ProjectionMethod};
use super::describe::{lambert_parameters, transverse_mercator_parameters};
use super::wkt::WktNode;

/// EPSG name and code of each parameter of WKT 1, for methods with a natural origin.
const NATURAL: [(&str, &str, u32); 5] = [
    ("latitude_of_origin", "Latitude of natural origin", 8801),
    ("central_meridian", "Longitude of natural origin", 8802),
    ("scale_factor", "Scale factor at natural origin", 8805),
    ("false_easting", "False easting", 8806),
    ("false_northing", "False northing", 8807),
];
/// The same for the Lambert projection with two parallels.
const TWO_PARALLELS: [(&str, &str, u32); 6] = [
    ("latitude_of_origin", "Latitude of false origin", 8821),
    ("central_meridian", "Longitude of false origin", 8822),
    ("standard_parallel_1", "Latitude of 1st standard parallel", 8823),
    ("standard_parallel_2", "Latitude of 2nd standard parallel", 8824),
    ("false_easting", "Easting at false origin", 8826),
    ("false_northing", "Northing at false origin", 8827),
];

/// PROJJSON of the system of a WKT.
///
/// `None` for texts that are no supported system or have impossible angles, and for projections
/// other than transverse Mercator and Lambert conformal conic.
pub fn projjson_of_wkt(text: &str) -> Option<Value> {
    let definition = Definition::of_wkt(text).ok()?;
    let horizontal = horizontal(&definition)?;
    Some(match definition.vertical.as_ref() {
        None => horizontal,
        Some(part) => {
            let vertical = vertical(&definition, part);
            let names = [&horizontal, &vertical].map(|part| part["name"].as_str().unwrap_or_default());
            json!({"type": "CompoundCRS", "name": names.join(" + "), "components": [&horizontal, &vertical]})
        }
    })
}

fn horizontal(definition: &Definition) -> Option<Value> {
    let unit = &definition.unit;
    let length = |metres: f64| metres / unit.metres;
    let (name, code, known, parameters): (_, _, &[_], _) = match &definition.method {
        ProjectionMethod::Geodetic => return Some(geographic(definition)),
        ProjectionMethod::TransverseMercator(p) => {
            ("Transverse Mercator", 9807, &NATURAL, transverse_mercator_parameters(p, &length).to_vec())
        }
        ProjectionMethod::Lambert(p) => match lambert_parameters(p, &length)? {
            ("Lambert_Conformal_Conic_1SP", list) => ("Lambert Conic Conformal (1SP)", 9801, &NATURAL, list),
            (_, list) => ("Lambert Conic Conformal (2SP)", 9802, &TWO_PARALLELS, list),
        },
        _ => return None,
    };
    let parameters: Option<Vec<Value>> = parameters
        .iter()
        .map(|(wkt, value)| {
            let (_, name, code) = known.iter().find(|known| known.0 == *wkt)?;
            let unit = match *wkt {
                "scale_factor" => json!("unity"),
                "false_easting" | "false_northing" => linear(unit),
                // The angular unit of some files is wrong.
                _ => (value.abs() <= 360.0).then(|| json!("degree"))?,
            };
            Some(json!({"name": name, "value": value, "unit": unit, "id": id(*code)}))
        })
        .collect();
    let title = definition.horizontal.name().unwrap_or("unnamed");
    Some(with_id(
        json!({
            "type": "ProjectedCRS",
            "name": title,
            "base_crs": geographic(definition),
            "conversion": {
                "name": title,
                "method": {"name": name, "id": id(code)},
                "parameters": parameters?,
            },
            "coordinate_system": {
                "subtype": "Cartesian",
                "axis": [axis("Easting", "E", "east", linear(unit)), axis("Northing", "N", "north", linear(unit))],
            },
        }),
        definition.epsg,
    ))
}

fn geographic(definition: &Definition) -> Value {
    let find = |keywords: &[&str]| definition.horizontal.find(keywords);
    let name = |keywords: &[&str]| find(keywords).and_then(WktNode::name).unwrap_or("unnamed").to_owned();
    let inverse_flattening = find(&ELLIPSOID).and_then(|node| node.value(2));
    let degree = json!("degree");
    with_id(
        json!({
            "type": "GeographicCRS",
            "name": name(&GEODETIC),
            "datum": with_id(
                json!({
                    "type": "GeodeticReferenceFrame",
                    "name": name(&DATUM).replace('_', " "),
                    "ellipsoid": {
                        "name": name(&ELLIPSOID),
                        "semi_major_axis": definition.ellipsoid.semi_major_m,
                        "inverse_flattening": inverse_flattening.unwrap_or(1.0 / definition.ellipsoid.flattening),
                    },
                }),
                find(&DATUM).and_then(WktNode::epsg),
            ),
            "coordinate_system": {
                "subtype": "ellipsoidal",
                "axis": [
                    axis("Geodetic latitude", "Lat", "north", degree.clone()),
                    axis("Geodetic longitude", "Lon", "east", degree),
                ],
            },
        }),
        find(&GEODETIC).and_then(WktNode::epsg),
    )
}

fn vertical(definition: &Definition, part: &WktNode) -> Value {
    let datum = part.child(&["VERT_DATUM", "VDATUM", "VERTICALDATUM"]);
    let unit = definition.vertical_unit().unwrap_or_else(Unit::metre);
    with_id(
        json!({
            "type": "VerticalCRS",
            "name": part.name().unwrap_or("unnamed"),
            "datum": with_id(
                json!({
                    "type": "VerticalReferenceFrame",
                    "name": datum.and_then(WktNode::name).unwrap_or("unnamed"),
                }),
                datum.and_then(WktNode::epsg),
            ),
            "coordinate_system": {"subtype": "vertical", "axis": [axis("Height", "H", "up", linear(&unit))]},
        }),
        part.epsg(),
    )
}

fn axis(name: &str, abbreviation: &str, direction: &str, unit: Value) -> Value {
    json!({"name": name, "abbreviation": abbreviation, "direction": direction, "unit": unit})
}

fn linear(unit: &Unit) -> Value {
    match unit.is_as_long_as(&Unit::metre()) {
        true => json!("metre"),
        false => json!({"type": "LinearUnit", "name": unit.name, "conversion_factor": unit.metres}),
    }
}

fn id(code: u32) -> Value {
    json!({"authority": "EPSG", "code": code})
}

fn with_id(mut value: Value, code: Option<u32>) -> Value {
    // Some files write code 0 for none.
    if let Some(code) = code.filter(|code| *code > 0) {
        value["id"] = id(code);
    }
    value
}

#[cfg(test)]
mod tests {
    use super::super::system_of_wkt;
    use super::*;
    use crate::crs::wkt_of_epsg;

    #[test]
    fn a_projected_system_keeps_its_code_and_parameters() {
        let system = projjson_of_wkt(&wkt_of_epsg(32633).unwrap()).unwrap();
        assert_eq!((&system["type"], &system["id"]["code"]), (&json!("ProjectedCRS"), &json!(32633)));
        let parameters = system["conversion"]["parameters"].as_array().unwrap();
        let values: Vec<_> = parameters.iter().map(|one| one["value"].as_f64().unwrap()).collect();
        assert_eq!(values, [0.0, 15.0, 0.9996, 500_000.0, 0.0]);
        assert_eq!(system["base_crs"]["id"]["code"], 4326);
        let lambert = projjson_of_wkt(&wkt_of_epsg(2154).unwrap()).unwrap();
        assert_eq!(lambert["conversion"]["method"]["id"]["code"], 9802);
        assert_eq!(lambert["conversion"]["parameters"].as_array().unwrap().len(), 6);
    }

    #[test]
    fn other_texts_have_none() {
        for text in ["", "PROJCS[\"x\"]", &wkt_of_epsg(3035).unwrap()] {
            assert_eq!(projjson_of_wkt(text), None, "{text}");
        }
    }

    #[test]
    fn metres_as_unit_of_angles_are_degrees() {
        let utm = wkt_of_epsg(32633).unwrap();
        let degree = r#"UNIT["degree",0.0174532925199433,AUTHORITY["EPSG","9122"]]"#;
        let in_metres = utm.replace(degree, r#"UNIT["Meter",1.0,AUTHORITY["EPSG","9001"]]"#);
        assert_ne!(utm, in_metres);
        assert_eq!(projjson_of_wkt(&in_metres), projjson_of_wkt(&utm));
        assert!(system_of_wkt(&in_metres).unwrap().wkt.contains(degree), "recordings get the right unit");
    }
}

//! Formats a coordinate reference system as WKT 1 (OGC 01-009).

use super::definition::{DATUM, Definition, ELLIPSOID, GEODETIC, ProjectionMethod};
use super::wkt::{WktNode, WktValue, compound};
use super::{Crs, Unit};
use crate::ellipsoid::{Ellipsoid, WGS84};
use crate::lambert::LambertParameters;
use crate::transverse_mercator::TransverseMercatorParameters;

/// The whole CRS; compound for heights above a geoid or not in metres.
pub(super) fn wkt(crs: &Crs) -> String {
    let horizontal = horizontal(&crs.definition, &crs.unit);
    match vertical(crs) {
        None => horizontal.to_string(),
        Some(vertical) => compound(horizontal, vertical).to_string(),
    }
}

/// Horizontal part: the source text if it is WKT 1 or ESRI WKT, with the unit replaced if
/// requested.
fn horizontal(definition: &Definition, unit: &Unit) -> WktNode {
    let source = &definition.horizontal;
    match source.keyword.as_str() {
        "GEOGCS" => source.clone(),
        "PROJCS" | "GEOCCS" if unit.is_as_long_as(&definition.unit) => source.clone(),
        "PROJCS" | "GEOCCS" => in_unit(source, &definition.unit, unit),
        _ => generated(definition, unit),
    }
}

/// A projected or earth-centred WKT 1 CRS in another unit; it loses its EPSG code.
pub(super) fn in_unit(source: &WktNode, from: &Unit, to: &Unit) -> WktNode {
    let mut node = source.clone();
    let name = format!("{} ({})", source.name().unwrap_or_default(), to.name);
    if let Some(first) = node.values.first_mut() {
        *first = WktValue::Text(name);
    }
    node.values.retain(|value| !matches!(value, WktValue::Node(part) if part.keyword == "AUTHORITY"));
    for part in node.nodes_mut() {
        let of_length = part.name().is_some_and(|name| name.to_lowercase().starts_with("false_"));
        match part.keyword.as_str() {
            "UNIT" => *part = to.wkt(),
            "PARAMETER" if of_length => {
                if let (Some(length), Some(place)) = (part.value(1), part.values.get_mut(1)) {
                    *place = WktValue::Bare((length * from.metres / to.metres).to_string());
                }
            }
            "EXTENSION" => {
                if let Some(WktValue::Text(text)) = part.values.get_mut(1) {
                    *text = text.replace("+units=m ", &format!("+to_meter={} ", to.metres));
                }
            }
            _ => {}
        }
    }
    node
}

/// Generates WKT 1 for a CRS given as WKT 2.
fn generated(definition: &Definition, unit: &Unit) -> WktNode {
    let title = definition.horizontal.name().unwrap_or("unnamed");
    let code = definition.epsg.filter(|_| unit.is_as_long_as(&definition.unit));
    let in_unit = |metres: f64| metres / unit.metres;
    let projected = |projection: &str, parameters: &[(&str, f64)]| {
        let mut node = WktNode::named("PROJCS", title).with(geodetic(definition));
        node = node.with(WktNode::named("PROJECTION", projection));
        for (name, value) in parameters {
            node = node.with(WktNode::named("PARAMETER", name).number(*value));
        }
        node.with(unit.wkt())
    };
    let axes = |node: WktNode| {
        let axis = |name: &str, to: &str| WktNode::named("AXIS", name).bare(to);
        node.with(axis("Easting", "EAST")).with(axis("Northing", "NORTH")).authority(code)
    };
    match &definition.method {
        ProjectionMethod::Geodetic => geodetic(definition),
        ProjectionMethod::Ecef => earth_centred(definition, unit).authority(code),
        ProjectionMethod::TransverseMercator(p) => {
            axes(projected("Transverse_Mercator", &transverse_mercator_parameters(p, &in_unit)))
        }
        ProjectionMethod::Lambert(p) => match lambert_parameters(p, &in_unit) {
            Some((projection, parameters)) => axes(projected(projection, &parameters)),
            None => {
                projected("custom_proj4", &[]).with(extension(&lambert_text(p, definition.ellipsoid), unit))
            }
        },
        ProjectionMethod::Other(text) => projected("custom_proj4", &[]).with(extension(text, unit)),
        // PROJ already returned it as WKT 1.
        #[cfg(feature = "proj")]
        ProjectionMethod::Foreign(_) => definition.horizontal.clone(),
    }
}

/// GDAL's extension for projections that WKT 1 cannot express.
fn extension(proj: &str, unit: &Unit) -> WktNode {
    let text = proj.replace("+units=m ", &format!("+to_meter={} ", unit.metres));
    let mut node = WktNode::named("EXTENSION", "PROJ4");
    node.values.push(WktValue::Text(text));
    node
}

/// Names and values of the parameters, in degrees and projection units.
pub(super) fn transverse_mercator_parameters(
    p: &TransverseMercatorParameters,
    in_unit: &impl Fn(f64) -> f64,
) -> [(&'static str, f64); 5] {
    [
        ("latitude_of_origin", degrees(p.latitude_of_origin_rad)),
        ("central_meridian", degrees(p.central_meridian_rad)),
        ("scale_factor", p.scale),
        ("false_easting", in_unit(p.false_easting_m)),
        ("false_northing", in_unit(p.false_northing_m)),
    ]
}

/// Projection name with names and values of its parameters; `None` if WKT 1 cannot express it.
///
/// These are a scale factor with two parallels, or an origin away from a single parallel.
pub(super) fn lambert_parameters(
    p: &LambertParameters,
    in_unit: &impl Fn(f64) -> f64,
) -> Option<(&'static str, Vec<(&'static str, f64)>)> {
    let [first, second] = p.standard_parallels_rad.map(degrees);
    let mut parameters = vec![
        ("latitude_of_origin", degrees(p.latitude_of_origin_rad)),
        ("central_meridian", degrees(p.central_meridian_rad)),
        ("false_easting", in_unit(p.false_easting_m)),
        ("false_northing", in_unit(p.false_northing_m)),
    ];
    let of_one = first == second && first == degrees(p.latitude_of_origin_rad);
    if of_one {
        parameters.insert(2, ("scale_factor", p.scale));
        return Some(("Lambert_Conformal_Conic_1SP", parameters));
    }
    parameters.splice(0..0, [("standard_parallel_1", first), ("standard_parallel_2", second)]);
    (p.scale.to_bits() == 1f64.to_bits()).then_some(("Lambert_Conformal_Conic_2SP", parameters))
}

fn lambert_text(p: &LambertParameters, ellipsoid: Ellipsoid) -> String {
    let [first, second] = p.standard_parallels_rad.map(degrees);
    format!(
        "+proj=lcc +lat_1={first} +lat_2={second} +lat_0={} +lon_0={} +k_0={} +x_0={} +y_0={} +a={} +rf={} +units=m +no_defs",
        degrees(p.latitude_of_origin_rad),
        degrees(p.central_meridian_rad),
        p.scale,
        p.false_easting_m,
        p.false_northing_m,
        ellipsoid.semi_major_m,
        1.0 / ellipsoid.flattening,
    )
}

/// Degrees rounded to 1e-13, or 10 nm: restores the value before its conversion to radians and
/// back.
pub(super) fn degrees(angle_rad: f64) -> f64 {
    (angle_rad.to_degrees() * 1e13).round() / 1e13
}

fn geodetic(definition: &Definition) -> WktNode {
    let source = definition.horizontal.find(&GEODETIC);
    let name = source.and_then(WktNode::name).unwrap_or("unnamed");
    WktNode::named("GEOGCS", name)
        .with(datum(definition))
        .with(WktNode::named("PRIMEM", "Greenwich").number(0.0).authority(Some(8901)))
        .with(WktNode::named("UNIT", "degree").bare("0.0174532925199433").authority(Some(9122)))
        .authority(source.and_then(WktNode::epsg))
}

fn earth_centred(definition: &Definition, unit: &Unit) -> WktNode {
    let axis = |name: &str, to: &str| WktNode::named("AXIS", name).bare(to);
    WktNode::named("GEOCCS", definition.horizontal.name().unwrap_or("unnamed"))
        .with(datum(definition))
        .with(WktNode::named("PRIMEM", "Greenwich").number(0.0).authority(Some(8901)))
        .with(unit.wkt())
        .with(axis("Geocentric X", "OTHER"))
        .with(axis("Geocentric Y", "OTHER"))
        .with(axis("Geocentric Z", "NORTH"))
}

/// The datum, with its WKT 1 name.
fn datum(definition: &Definition) -> WktNode {
    let source = definition.horizontal.find(&DATUM);
    let name = source.and_then(WktNode::name).unwrap_or("unknown");
    let name = match name.trim_end_matches(" ensemble") {
        "World Geodetic System 1984" => "WGS_1984".to_string(),
        // As GDAL writes names: other characters than letters, digits and plus become one
        // underscore.
        name => {
            let words = name.split(|c: char| !(c.is_alphanumeric() || c == '+'));
            words.filter(|word| !word.is_empty()).collect::<Vec<_>>().join("_")
        }
    };
    let figure = definition.horizontal.find(&ELLIPSOID).and_then(WktNode::name);
    let (inverse_flattening, code) =
        if definition.ellipsoid == WGS84 { (298.257_223_563, 7030) } else { (298.257_222_101, 7019) };
    let spheroid = WktNode::named("SPHEROID", figure.unwrap_or("unnamed"))
        .number(definition.ellipsoid.semi_major_m)
        .number(inverse_flattening)
        .authority(Some(code));
    WktNode::named("DATUM", &name).with(spheroid).authority(source.and_then(WktNode::epsg))
}

/// Types of vertical datums (OGC 01-009, section 12.3.4).
const GEOID_MODEL: f64 = 2005.0;
const ELLIPSOIDAL: f64 = 2002.0;

/// Vertical part; `None` for ellipsoidal heights in metres and for earth-centred coordinates.
fn vertical(crs: &Crs) -> Option<WktNode> {
    let unit = &crs.height_unit;
    let Some(geoid) = &crs.geoid else {
        let needed = !crs.is_ecef() && !unit.is_as_long_as(&Unit::metre());
        return needed.then(|| ellipsoidal(unit));
    };
    if let (Some(name), Some(own)) = (crs.definition.vertical_name(), &crs.definition.vertical) {
        let source = own.child(&["VERT_DATUM", "VDATUM", "VERTICALDATUM"]);
        let same = crs.definition.vertical_unit().is_some_and(|own| own.is_as_long_as(unit));
        let of =
            vertical_datum(source.and_then(WktNode::name).unwrap_or(&name), source.and_then(WktNode::epsg));
        return Some(part(&name, of, unit, own.epsg().filter(|_| same)));
    }
    Some(match known(geoid.name()) {
        Some(known) => known.part(unit),
        None => part(&format!("{} height", geoid.name()), vertical_datum(geoid.name(), None), unit, None),
    })
}

fn part(name: &str, datum: WktNode, unit: &Unit, code: Option<u32>) -> WktNode {
    let up = WktNode::named("AXIS", "Up").bare("UP");
    WktNode::named("VERT_CS", name).with(datum).with(unit.wkt()).with(up).authority(code)
}

fn vertical_datum(name: &str, code: Option<u32>) -> WktNode {
    WktNode::named("VERT_DATUM", name).number(GEOID_MODEL).authority(code)
}

/// Vertical part of heights above the ellipsoid.
pub(super) fn ellipsoidal(unit: &Unit) -> WktNode {
    let datum = WktNode::named("VERT_DATUM", "Ellipsoid").number(ELLIPSOIDAL);
    part("Ellipsoidal height", datum, unit, None)
}

/// Vertical part of an EPSG code, of its system or its datum, or of a title alone.
///
/// Heights are in `unit`, or in the unit of the code, or in the unit of the map.
pub(super) fn vertical_of_epsg(
    code: Option<u16>,
    title: Option<&str>,
    unit: Option<Unit>,
    map: &Unit,
) -> WktNode {
    let code = code.map(u32::from);
    let known = code.and_then(|code| {
        let own = |vertical: &Vertical| {
            let units = [Unit::metre(), Unit::foot(), Unit::us_survey_foot()];
            units.into_iter().find(|unit| vertical.code(unit) == Some(code))
        };
        let is_of = |vertical: &&Vertical| vertical.datum_code == code || own(vertical).is_some();
        VERTICALS.iter().find(is_of).map(|vertical| (vertical, own(vertical)))
    });
    match known {
        Some((vertical, own)) => vertical.part(&unit.or(own).unwrap_or_else(|| map.clone())),
        None => {
            let of_code = code.map_or("Height".to_owned(), |code| format!("EPSG:{code} height"));
            let (name, unit) = (title.unwrap_or(&of_code), unit.unwrap_or_else(|| map.clone()));
            part(name, vertical_datum("unknown", None), &unit, code)
        }
    }
}

/// Vertical CRS of EPSG that is realised by a geoid model.
struct Vertical {
    /// Prefixes of the names of its models, in lower case.
    models: &'static [&'static str],
    name: &'static str,
    datum: &'static str,
    datum_code: u32,
    /// EPSG code in metres.
    metric_code: u32,
}

/// Vertical CRSs by prefix of the geoid model's name.
///
/// Of the American models, only the models of the 48 states and Alaska; the others use other datums.
const VERTICALS: [Vertical; 4] = [
    Vertical {
        models: &[
            "g2018u", "g2018a", "g2012bu", "g2012ba", "g2012au", "g2012aa", "g2009u", "g2009a", "g2003u",
            "g1999u",
        ],
        name: "NAVD88 height",
        datum: "North American Vertical Datum 1988",
        datum_code: 5103,
        metric_code: 5703,
    },
    Vertical {
        models: &["egm2008", "egm08"],
        name: "EGM2008 height",
        datum: "EGM2008 geoid",
        datum_code: 1027,
        metric_code: 3855,
    },
    Vertical {
        models: &["egm96"],
        name: "EGM96 height",
        datum: "EGM96 geoid",
        datum_code: 5171,
        metric_code: 5773,
    },
    Vertical {
        models: &["raf18", "raf20", "raf09"],
        name: "NGF-IGN69 height",
        datum: "Nivellement General de la France - IGN69",
        datum_code: 5119,
        metric_code: 5720,
    },
];

fn known(geoid: &str) -> Option<&'static Vertical> {
    let name = geoid.to_lowercase();
    VERTICALS.iter().find(|vertical| vertical.models.iter().any(|model| name.starts_with(model)))
}

impl Vertical {
    fn part(&self, unit: &Unit) -> WktNode {
        part(self.name, vertical_datum(self.datum, Some(self.datum_code)), unit, self.code(unit))
    }

    fn code(&self, unit: &Unit) -> Option<u32> {
        match (self.metric_code, unit.epsg?) {
            (code, 9001) => Some(code),
            (5703, 9003) => Some(6360),
            (5703, 9002) => Some(8228),
            _ => None,
        }
    }
}

//! Definition of a coordinate reference system from an EPSG code or WKT.
//!
//! The WKT of a code comes from the crate `crs-definitions`. The crate `proj4wkt` converts the
//! projection parameters of any dialect to a PROJ string in degrees and metres; names, datum and
//! vertical part are taken from the text itself.

use super::proj_string::ProjString;
use super::wkt::WktNode;
use super::{CrsError, Unit, methods, wkt_of_epsg};
use crate::ellipsoid::{Ellipsoid, GRS80, WGS84};
use crate::lambert::LambertParameters;
use crate::transverse_mercator::TransverseMercatorParameters;

/// Definition of a CRS, before the choice of heights and units.
#[derive(Clone, Debug)]
pub(super) struct Definition {
    /// Display name.
    pub name: String,
    /// EPSG code.
    pub epsg: Option<u32>,
    pub method: ProjectionMethod,
    pub ellipsoid: Ellipsoid,
    /// Unit of eastings and northings, or of earth-centred coordinates; metre for geodetic
    /// coordinates.
    pub unit: Unit,
    /// Horizontal part, in the source's dialect.
    pub horizontal: WktNode,
    /// Vertical part, in the source's dialect.
    pub vertical: Option<WktNode>,
}

/// Projection method.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum ProjectionMethod {
    Geodetic,
    Ecef,
    TransverseMercator(TransverseMercatorParameters),
    Lambert(LambertParameters),
    /// Any other projection, as a PROJ string in metres without a datum.
    Other(String),
    /// Computed by PROJ, in the unit of the CRS.
    #[cfg(feature = "proj")]
    Foreign(String),
}

/// Keywords of the horizontal part, in both versions of WKT.
pub(super) const PROJECTED: [&str; 3] = ["PROJCS", "PROJCRS", "PROJECTEDCRS"];
pub(super) const GEODETIC: [&str; 7] =
    ["GEOGCS", "GEOGCRS", "GEOGRAPHICCRS", "BASEGEOGCRS", "GEODCRS", "GEODETICCRS", "BASEGEODCRS"];
pub(super) const GEOCENTRIC: [&str; 1] = ["GEOCCS"];
pub(super) const VERTICAL: [&str; 4] = ["VERT_CS", "VERTCS", "VERTCRS", "VERTICALCRS"];
pub(super) const DATUM: [&str; 4] = ["DATUM", "GEODETICDATUM", "TRF", "ENSEMBLE"];
pub(super) const ELLIPSOID: [&str; 2] = ["SPHEROID", "ELLIPSOID"];
pub(super) const LENGTH_UNIT: [&str; 2] = ["UNIT", "LENGTHUNIT"];

/// Datums on the WGS 84 or GRS 80 ellipsoid that are nevertheless metres away from WGS 84.
///
/// Their published shifts to WGS 84 exceed 5 m (EPSG dataset 11).
const ELSEWHERE: [&str; 7] = [
    "greek geodetic reference system 1987",
    "israel 1993",
    "kuwait utility",
    "national geodetic network",
    "cyprus geodetic reference system 1993",
    "st87 ouvea",
    "vietnam 2000",
];

impl Definition {
    /// The CRS of an EPSG code.
    pub(super) fn of_epsg(code: u32) -> Result<Definition, CrsError> {
        let wkt = u16::try_from(code).ok().and_then(wkt_of_epsg).ok_or(CrsError::UnknownEpsg(code))?;
        let tree = WktNode::parse(&wkt).map_err(CrsError::Wkt)?;
        Definition::of(&tree, Some(code))
    }

    /// The CRS of a WKT.
    pub(super) fn of_wkt(text: &str) -> Result<Definition, CrsError> {
        Definition::of(&WktNode::parse(text).map_err(CrsError::Wkt)?, None)
    }

    fn of(tree: &WktNode, epsg: Option<u32>) -> Result<Definition, CrsError> {
        let keywords = [PROJECTED.as_slice(), &GEODETIC, &GEOCENTRIC].concat();
        let horizontal = tree.find(&keywords).ok_or_else(|| {
            CrsError::Wkt(format!("{} is not a projected, geodetic or earth-centred system", tree.keyword))
        })?;
        let mut horizontal = horizontal.clone();
        // A zero shift has no meaning, and prevents other programs from recognising the CRS.
        horizontal.remove(&|node| node.keyword == "TOWGS84" && is_null_shift(node));
        correct_angular_unit(&mut horizontal);
        let vertical = tree.find(&VERTICAL).cloned();
        let title = horizontal.name().unwrap_or("an unnamed system").to_string();
        // A compound CRS has its own code; the horizontal part keeps its code.
        let own = horizontal.epsg().or(epsg.filter(|_| vertical.is_none()));
        let name = epsg.map_or(title.clone(), |code| format!("EPSG:{code} ({title})"));
        let ellipsoid = check_datum(&name, &horizontal, tree.find(&["ABRIDGEDTRANSFORMATION"]))?;
        let given = own_proj_string(&horizontal);
        let is_own = given.is_some();
        let text = given.map_or_else(|| proj_string(&horizontal), Ok)?;
        let proj = ProjString::parse(&name, &text, is_own);
        proj.check_axes(&horizontal)?;
        let unit = match proj.text("proj") {
            Some("longlat") => Unit::metre(),
            _ => proj.unit(&horizontal)?,
        };
        methods::check(&proj, &horizontal)?;
        let method = proj.method(ellipsoid)?;
        let found = Definition { epsg: own, method, ellipsoid, unit, horizontal, vertical, name };
        let is_wrong = epsg.is_none() && own.is_some_and(|code| is_other_than(&found, code));
        Ok(Definition { epsg: own.filter(|_| !is_wrong), ..found })
    }
}

/// The projected CRS of a definition read by PROJ: `EPSG:27700`, or WKT.
#[cfg(feature = "proj")]
pub(super) fn of_proj(words: &str) -> Option<Definition> {
    let tree = WktNode::parse(&super::proj::Foreign::new(words)?.wkt()?).ok()?;
    let horizontal = tree.find(&PROJECTED)?.clone();
    let unit = unit_node(&horizontal)?;
    let unit = Unit::of_metres(unit.name().unwrap_or("unit"), unit.value(1).filter(|metres| *metres > 0.0)?);
    let epsg = horizontal.epsg();
    let title = horizontal.name().unwrap_or("an unnamed system");
    let name = epsg.map_or(title.to_string(), |code| format!("EPSG:{code} ({title})"));
    let vertical = tree.find(&VERTICAL).cloned();
    let method = ProjectionMethod::Foreign(words.into());
    Some(Definition { name, epsg, method, ellipsoid: WGS84, unit, horizontal, vertical })
}

/// Replaces metres as the unit of angles, which some programs write, by degrees; returns whether it did.
pub(super) fn correct_angular_unit(node: &mut WktNode) -> bool {
    let is_geographic = node.keyword == "GEOGCS";
    let mut is_changed = false;
    for part in node.nodes_mut() {
        if is_geographic && part.keyword == "UNIT" && part.value(1) == Some(1.0) {
            *part = WktNode::named("UNIT", "degree").bare("0.0174532925199433").authority(Some(9122));
            is_changed = true;
        } else {
            is_changed |= correct_angular_unit(part);
        }
    }
    is_changed
}

/// The embedded PROJ string, if any.
///
/// GDAL adds it if WKT 1 cannot express a projection.
fn own_proj_string(horizontal: &WktNode) -> Option<String> {
    let own = horizontal.child(&["EXTENSION"]).filter(|extension| extension.name() == Some("PROJ4"));
    own.and_then(|extension| extension.text(1)).map(str::to_owned)
}

/// A PROJ string generated from the text.
fn proj_string(horizontal: &WktNode) -> Result<String, CrsError> {
    let made = proj4wkt::wkt_to_projstring(&horizontal.to_string());
    made.map_err(|error| CrsError::Wkt(error.to_string()))
}

/// Returns the ellipsoid, if the datum is equivalent to the earth-centred frame.
fn check_datum(name: &str, horizontal: &WktNode, bound: Option<&WktNode>) -> Result<Ellipsoid, CrsError> {
    let datum = horizontal.find(&DATUM);
    let datum_name = datum.and_then(WktNode::name).unwrap_or("unnamed");
    let refused = |reason: String| CrsError::Datum { name: name.into(), datum: datum_name.into(), reason };
    let figure = horizontal.find(&ELLIPSOID);
    let axis_m = figure.and_then(|node| node.value(1)).unwrap_or(f64::NAN);
    let inverse_flattening = figure.and_then(|node| node.value(2)).unwrap_or(f64::NAN);
    let same = |known: &&Ellipsoid| {
        (axis_m - known.semi_major_m).abs() < 1e-6
            && (inverse_flattening * known.flattening - 1.0).abs() < 1e-12
    };
    let Some(ellipsoid) = [WGS84, GRS80].iter().find(same).copied() else {
        let figure = figure.and_then(WktNode::name).unwrap_or("unnamed");
        return Err(refused(format!("uses another ellipsoid ({figure})")));
    };
    let plain = datum_name.replace('_', " ").to_lowercase();
    if ELSEWHERE.contains(&plain.trim_start_matches("d ")) {
        return Err(refused("is metres away from WGS 84".into()));
    }
    if horizontal.find(&["TOWGS84"]).is_some() || bound.is_some_and(|shift| !is_null_transformation(shift)) {
        return Err(refused("has a shift to WGS 84".into()));
    }
    Ok(ellipsoid)
}

fn is_null_shift(node: &WktNode) -> bool {
    (0..node.values.len()).all(|place| node.value(place) == Some(0.0))
}

/// Whether a WKT 2 transformation to WGS 84 is null.
fn is_null_transformation(shift: &WktNode) -> bool {
    let mut parameters = shift.nodes().filter(|node| node.keyword == "PARAMETER").peekable();
    parameters.peek().is_some() && parameters.all(|parameter| parameter.value(1) == Some(0.0))
}

impl ProjString<'_> {
    /// Rejects axes other than east and north, and prime meridians other than Greenwich.
    fn check_axes(&self, horizontal: &WktNode) -> Result<(), CrsError> {
        const REMEDY: &str =
            "choose a CRS with eastings and northings from Greenwich, or build wavex with the feature `proj`";
        if let Some(axes) = self.text("axis").filter(|axes| *axes != "enu") {
            return Err(self.unsupported(format!("its axes are `{axes}`"), REMEDY));
        }
        if !methods::has_plain_axes(horizontal) {
            return Err(self.unsupported("its axes do not point east and north".into(), REMEDY));
        }
        match self.text("pm").filter(|meridian| !matches!(*meridian, "0" | "greenwich")) {
            Some(meridian) => Err(self.unsupported(format!("its prime meridian is `{meridian}`"), REMEDY)),
            None => Ok(()),
        }
    }

    fn method(&self, ellipsoid: Ellipsoid) -> Result<ProjectionMethod, CrsError> {
        let scale = match self.text("k") {
            Some(_) => self.number("k", 1.0)?,
            None => self.number("k_0", 1.0)?,
        };
        let (false_easting_m, false_northing_m) = (self.number("x_0", 0.0)?, self.number("y_0", 0.0)?);
        Ok(match self.text("proj").unwrap_or_default() {
            "longlat" => ProjectionMethod::Geodetic,
            "geocent" => ProjectionMethod::Ecef,
            "utm" => ProjectionMethod::TransverseMercator(TransverseMercatorParameters::utm(
                self.number("zone", f64::NAN)? as u8,
                self.text("south").is_none(),
            )),
            "tmerc" => ProjectionMethod::TransverseMercator(TransverseMercatorParameters {
                latitude_of_origin_rad: self.radians("lat_0", 0.0)?,
                central_meridian_rad: self.radians("lon_0", 0.0)?,
                scale,
                false_easting_m,
                false_northing_m,
            }),
            "lcc" => {
                let first_deg = self.number("lat_1", f64::NAN)?;
                let second_deg = self.number("lat_2", first_deg)?;
                // With one parallel, the latitude of origin defaults to it.
                let origin_deg = if self.text("lat_2").is_some() { 0.0 } else { first_deg };
                ProjectionMethod::Lambert(LambertParameters {
                    standard_parallels_rad: [first_deg, second_deg].map(f64::to_radians),
                    latitude_of_origin_rad: self.radians("lat_0", origin_deg)?,
                    central_meridian_rad: self.radians("lon_0", 0.0)?,
                    scale,
                    false_easting_m,
                    false_northing_m,
                })
            }
            _ => ProjectionMethod::Other(self.without_datum(ellipsoid)),
        })
    }

    /// The same projection in metres and without a datum, so that nothing is shifted.
    fn without_datum(&self, ellipsoid: Ellipsoid) -> String {
        const DROPPED: [&str; 12] = [
            "type",
            "datum",
            "towgs84",
            "nadgrids",
            "geoidgrids",
            "units",
            "to_meter",
            "vunits",
            "vto_meter",
            "no_defs",
            "wktext",
            "ellps",
        ];
        let has_figure = self.pairs.iter().any(|pair| matches!(pair.0, "a" | "R"));
        let mut text = String::new();
        for (key, value) in self.pairs.iter().filter(|pair| !DROPPED.contains(&pair.0)) {
            let equals = if value.is_empty() { "" } else { "=" };
            text.push_str(&format!("+{key}{equals}{value} "));
        }
        if !has_figure {
            text.push_str(&format!("+a={} +rf={} ", ellipsoid.semi_major_m, 1.0 / ellipsoid.flattening));
        }
        text + "+units=m +no_defs"
    }

    fn unit(&self, horizontal: &WktNode) -> Result<Unit, CrsError> {
        let metres = match self.text("units") {
            None => self.number("to_meter", 1.0)?,
            Some("m") => 1.0,
            Some("ft") => Unit::foot().metres,
            Some("us-ft") => Unit::us_survey_foot().metres,
            // Other units are defined in the text.
            Some(_) => unit_node(horizontal).and_then(|unit| unit.value(1)).unwrap_or(f64::NAN),
        };
        if !(metres.is_finite() && metres > 0.0) {
            return Err(self.unsupported("its unit of length is unknown".into(), "use a WKT file"));
        }
        let name = unit_node(horizontal).and_then(WktNode::name).unwrap_or("unit");
        Ok(Unit::of_metres(name, metres))
    }
}

/// Unit node of a horizontal or vertical part, or of its first axis.
pub(super) fn unit_node(part: &WktNode) -> Option<&WktNode> {
    part.child(&LENGTH_UNIT).or_else(|| part.child(&["AXIS"])?.child(&LENGTH_UNIT))
}

/// WKT 1 vertical datum type of ellipsoidal heights (OGC 01-009, section 12.3.4).
const ELLIPSOIDAL: f64 = 2002.0;

impl Definition {
    /// Name of the vertical part, unless heights are ellipsoidal.
    pub(super) fn vertical_name(&self) -> Option<String> {
        let vertical = self.vertical.as_ref()?;
        let datum = vertical.child(&["VERT_DATUM", "VDATUM", "VERTICALDATUM"]);
        // ESRI gives heights above the ellipsoid the datum of the ellipsoid.
        let above_ellipsoid = vertical.child(&["DATUM"]).is_some()
            || datum.is_some_and(|datum| {
                datum.value(1) == Some(ELLIPSOIDAL)
                    || datum.name().is_some_and(|name| name.to_lowercase().starts_with("ellipsoid"))
            });
        (!above_ellipsoid).then(|| vertical.name().unwrap_or("of an unnamed system").to_string())
    }

    /// Unit of the vertical part.
    pub(super) fn vertical_unit(&self) -> Option<Unit> {
        let unit = unit_node(self.vertical.as_ref()?)?;
        let metres = unit.value(1).filter(|metres| *metres > 0.0)?;
        Some(Unit::of_metres(unit.name().unwrap_or("unit"), metres))
    }
}

/// Largest relative difference of equal parameters, and of equal units.
const SAME_NUMBER: f64 = 1e-6;
const SAME_UNIT: f64 = 1e-7;

/// Whether the system of an EPSG code has other parameters or another unit.
///
/// `false` for unknown codes, and for projections other than transverse Mercator and Lambert.
fn is_other_than(definition: &Definition, code: u32) -> bool {
    let Ok(known) = Definition::of_epsg(code) else { return false };
    let Some((own, of_code)) = numbers(&definition.method).zip(numbers(&known.method)) else { return false };
    let differ = |a: f64, b: f64, tolerance: f64| (a - b).abs() > tolerance * b.abs().max(1.0);
    own.len() != of_code.len()
        || own.iter().zip(&of_code).any(|(a, b)| differ(*a, *b, SAME_NUMBER))
        || differ(definition.unit.metres, known.unit.metres, SAME_UNIT)
}

/// Parameters in degrees and metres; `None` for unknown ones.
fn numbers(method: &ProjectionMethod) -> Option<Vec<f64>> {
    Some(match method {
        ProjectionMethod::Geodetic | ProjectionMethod::Ecef => Vec::new(),
        ProjectionMethod::TransverseMercator(p) => {
            let angles = [p.latitude_of_origin_rad, p.central_meridian_rad].map(f64::to_degrees);
            [angles.as_slice(), &[p.scale, p.false_easting_m, p.false_northing_m]].concat()
        }
        ProjectionMethod::Lambert(p) => {
            let [a, b] = p.standard_parallels_rad;
            let angles = [a.min(b), a.max(b), p.latitude_of_origin_rad, p.central_meridian_rad];
            [angles.map(f64::to_degrees).as_slice(), &[p.scale, p.false_easting_m, p.false_northing_m]]
                .concat()
        }
        _ => return None,
    })
}

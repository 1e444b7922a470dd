//! Coordinate reference systems as GeoTIFF keys, as in LAS before 1.4.
//!
//! GeoTIFF 1.0, sections 2.4 and 6.

mod read;

use super::Unit;
use super::definition::{Definition, GEODETIC, ProjectionMethod};
use super::describe::{lambert_parameters, transverse_mercator_parameters};
use super::wkt::WktNode;
use crate::ellipsoid::WGS84;

pub use read::system_of_geotiff_keys;

/// The three records of GeoTIFF keys, with user ID `LASF_Projection`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct GeoKeys {
    /// Record 34735, `GeoKeyDirectoryTag`.
    pub directory: Vec<u8>,
    /// Record 34736, `GeoDoubleParamsTag`; empty if no key needs it.
    pub doubles: Vec<u8>,
    /// Record 34737, `GeoAsciiParamsTag`.
    pub ascii: Vec<u8>,
}

const DOUBLES: u16 = 34736;
const ASCII: u16 = 34737;
/// Value in place of a code: defined by other keys.
const USER_DEFINED: u16 = 32767;

const MODEL_TYPE: u16 = 1024;
const RASTER_TYPE: u16 = 1025;
const CITATION: u16 = 1026;
const GEOGRAPHIC: u16 = 2048;
const ANGULAR_UNIT: u16 = 2054;
const ELLIPSOID: u16 = 2056;
const PROJECTED: u16 = 3072;
const PROJECTION: u16 = 3074;
const METHOD: u16 = 3075;
const LINEAR_UNIT: u16 = 3076;
const LINEAR_UNIT_SIZE: u16 = 3077;
const VERTICAL: u16 = 4096;
const VERTICAL_UNIT: u16 = 4099;

/// Keys of a CRS given as WKT; `None` if unsupported, or without a code and with a projection not
/// covered here.
pub fn geotiff_keys_of_wkt(text: &str) -> Option<GeoKeys> {
    let definition = Definition::of_wkt(text).ok()?;
    let unit = &definition.unit;
    let height_unit = definition.vertical_unit().unwrap_or_else(|| unit.clone());
    let vertical = definition.vertical.as_ref().and_then(WktNode::epsg);
    let mut keys = CollectedKeys::default();
    let code = definition.epsg.and_then(|code| u16::try_from(code).ok());
    let model = match definition.method {
        ProjectionMethod::Geodetic => 2,
        ProjectionMethod::Ecef => 3,
        _ => 1,
    };
    keys.short(MODEL_TYPE, model);
    keys.short(RASTER_TYPE, 1);
    keys.text(CITATION, definition.horizontal.name().unwrap_or("unnamed"));
    match (model, code) {
        (1, Some(code)) => keys.short(PROJECTED, code),
        (1, None) => projection(&mut keys, &definition)?,
        (_, Some(code)) => keys.short(GEOGRAPHIC, code),
        (_, None) => geographic(&mut keys, &definition),
    }
    if model == 2 {
        keys.short(ANGULAR_UNIT, 9102);
    } else {
        linear_unit(&mut keys, unit);
    }
    if model != 3 {
        if let Some(code) = vertical.and_then(|code| u16::try_from(code).ok()) {
            keys.short(VERTICAL, code);
        }
        keys.short(VERTICAL_UNIT, height_unit.epsg.unwrap_or(USER_DEFINED));
    }
    Some(keys.records())
}

fn linear_unit(keys: &mut CollectedKeys, unit: &Unit) {
    keys.short(LINEAR_UNIT, unit.epsg.unwrap_or(USER_DEFINED));
    if unit.epsg.is_none() {
        keys.double(LINEAR_UNIT_SIZE, unit.metres);
    }
}

/// Adds the keys of the base CRS of a projection, or of an unprojected CRS without a code.
fn geographic(keys: &mut CollectedKeys, definition: &Definition) {
    let code = definition.horizontal.find(&GEODETIC).and_then(|node| node.epsg());
    match code.and_then(|code| u16::try_from(code).ok()) {
        Some(code) => keys.short(GEOGRAPHIC, code),
        None if definition.ellipsoid == WGS84 => keys.short(GEOGRAPHIC, 4326),
        None => {
            keys.short(GEOGRAPHIC, USER_DEFINED);
            keys.short(ELLIPSOID, 7019);
        }
    }
}

fn projection(keys: &mut CollectedKeys, definition: &Definition) -> Option<()> {
    let in_unit = |metres: f64| metres / definition.unit.metres;
    // Method codes: 1 transverse Mercator, 8 Lambert with two parallels, 9 with one (section
    // 6.3.3.3).
    let (method, parameters) = match &definition.method {
        ProjectionMethod::TransverseMercator(p) => (1, transverse_mercator_parameters(p, &in_unit).to_vec()),
        ProjectionMethod::Lambert(p) => match lambert_parameters(p, &in_unit)? {
            ("Lambert_Conformal_Conic_2SP", parameters) => (8, parameters),
            (_, parameters) => (9, parameters),
        },
        _ => return None,
    };
    geographic(keys, definition);
    keys.short(PROJECTED, USER_DEFINED);
    keys.short(PROJECTION, USER_DEFINED);
    keys.short(METHOD, method);
    for (name, value) in parameters {
        keys.double(key_of_parameter(name, method == 8)?, value);
    }
    Some(())
}

/// Two parallels have a false origin, the others a natural one (section 6.2.3).
fn key_of_parameter(name: &str, of_two_parallels: bool) -> Option<u16> {
    Some(match (name, of_two_parallels) {
        ("standard_parallel_1", _) => 3078,
        ("standard_parallel_2", _) => 3079,
        ("central_meridian", false) => 3080,
        ("latitude_of_origin", false) => 3081,
        ("false_easting", false) => 3082,
        ("false_northing", false) => 3083,
        ("central_meridian", true) => 3084,
        ("latitude_of_origin", true) => 3085,
        ("false_easting", true) => 3086,
        ("false_northing", true) => 3087,
        ("scale_factor", _) => 3092,
        _ => return None,
    })
}

/// Keys being collected; the directory is sorted.
#[derive(Default)]
struct CollectedKeys {
    entries: Vec<[u16; 4]>,
    doubles: Vec<f64>,
    ascii: String,
}

impl CollectedKeys {
    fn short(&mut self, key: u16, value: u16) {
        self.entries.push([key, 0, 1, value]);
    }

    fn double(&mut self, key: u16, value: f64) {
        self.entries.push([key, DOUBLES, 1, self.doubles.len() as u16]);
        self.doubles.push(value);
    }

    /// Texts are concatenated, each terminated by a bar.
    fn text(&mut self, key: u16, text: &str) {
        let text: String = text.chars().filter(|c| c.is_ascii() && *c != '|').take(1000).collect();
        self.entries.push([key, ASCII, text.len() as u16 + 1, self.ascii.len() as u16]);
        self.ascii.push_str(&text);
        self.ascii.push('|');
    }

    fn records(mut self) -> GeoKeys {
        self.entries.sort_unstable();
        let head = [1, 1, 0, self.entries.len() as u16];
        let words = head.iter().chain(self.entries.as_flattened());
        GeoKeys {
            directory: words.flat_map(|word| word.to_le_bytes()).collect(),
            doubles: self.doubles.iter().flat_map(|value| value.to_le_bytes()).collect(),
            ascii: [self.ascii.as_bytes(), &[0]].concat(),
        }
    }
}

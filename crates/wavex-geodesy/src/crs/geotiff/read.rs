//! Reads GeoTIFF keys as WKT.

use core::ops::RangeInclusive;

use super::super::definition::Definition;
use super::super::describe::{ellipsoidal, in_unit, vertical_of_epsg};
use super::super::wkt::{WktNode, compound};
use super::super::{CrsError, RecordedSystem, Unit, wkt_of_epsg};
use super::*;

const GEOGRAPHIC_CITATION: u16 = 2049;
const GEODETIC_DATUM: u16 = 2050;
const SEMI_MAJOR_M: u16 = 2057;
/// Semi-major axes of ellipsoids of the earth, m.
const SEMI_MAJORS_M: RangeInclusive<f64> = 6.37e6..=6.39e6;
const INVERSE_FLATTENING: u16 = 2059;
const PROJECTED_CITATION: u16 = 3073;
const VERTICAL_CITATION: u16 = 4097;

/// EPSG codes of systems; smaller values are codes of GeoTIFF, larger ones are not EPSG's.
const CODES: std::ops::Range<u16> = 1024..USER_DEFINED;
/// EPSG codes of the projections UTM north and UTM south, zone 0.
const UTM_NORTH: u16 = 16000;
const UTM_SOUTH: u16 = 16100;
/// GeoTIFF codes of heights above an ellipsoid (section 6.3.4.1).
const ELLIPSOIDAL_HEIGHTS: std::ops::RangeInclusive<u16> = 5001..=5035;

/// Reads a CRS from GeoTIFF keys; `None` if they name none.
///
/// Systems are given by EPSG code, or as transverse Mercator, UTM or Lambert conformal conic with
/// their parameters. Heights in another unit, or of a named system, give a compound system.
///
/// # Errors
/// Damaged keys, an unknown code, another projection, or missing parameters.
pub fn system_of_geotiff_keys(keys: &GeoKeys) -> Result<Option<RecordedSystem>, CrsError> {
    let directory = KeyDirectory::new(keys);
    let mut problems = Vec::new();
    let system = directory.and_then(|directory| directory.system(&mut problems));
    let system = system.map_err(CrsError::GeoKeys)?;
    Ok(system.map(|system| RecordedSystem { wkt: system.to_string(), problems }))
}

/// A key directory with its values.
struct KeyDirectory<'a> {
    entries: Vec<[u16; 4]>,
    keys: &'a GeoKeys,
}

impl KeyDirectory<'_> {
    fn new(keys: &GeoKeys) -> Result<KeyDirectory<'_>, String> {
        let words: Vec<u16> =
            keys.directory.as_chunks().0.iter().map(|word| u16::from_le_bytes(*word)).collect();
        let cut_off = || "the key directory is cut off".to_owned();
        let ([_, _, _, count], entries) = words.split_first_chunk().ok_or_else(cut_off)?;
        let entries = entries.as_chunks().0.get(..usize::from(*count)).ok_or_else(cut_off)?;
        Ok(KeyDirectory { entries: entries.to_vec(), keys })
    }

    fn entry(&self, key: u16, location: u16) -> Option<[u16; 4]> {
        self.entries.iter().find(|entry| entry[0] == key && entry[1] == location).copied()
    }

    fn short(&self, key: u16) -> Option<u16> {
        self.entry(key, 0).map(|entry| entry[3])
    }

    fn code(&self, key: u16) -> Option<u16> {
        self.short(key).filter(|code| CODES.contains(code))
    }

    fn double(&self, key: u16) -> Option<f64> {
        let [.., place] = self.entry(key, DOUBLES)?;
        let value = f64::from_le_bytes(*self.keys.doubles.as_chunks().0.get(usize::from(place))?);
        value.is_finite().then_some(value)
    }

    fn text(&self, key: u16) -> Option<String> {
        let [_, _, count, place] = self.entry(key, ASCII)?.map(usize::from);
        let text = String::from_utf8_lossy(self.keys.ascii.get(place..place + count)?);
        let text = text.trim_end_matches(['|', '\0', ' ']);
        (!text.is_empty()).then(|| text.to_owned())
    }

    fn system(&self, problems: &mut Vec<String>) -> Result<Option<WktNode>, String> {
        let horizontal = match self.short(MODEL_TYPE) {
            Some(2) => self.geographic()?,
            Some(3) => return self.code(GEOGRAPHIC).map(|code| of_code(code, "GEOCCS")).transpose(),
            None if self.short(PROJECTED).or(self.short(METHOD)).is_none() => self.geographic()?,
            _ => self.projected(problems)?,
        };
        let Some(horizontal) = horizontal else { return Ok(None) };
        let vertical = self.vertical(&horizontal).unwrap_or_else(|problem| {
            problems.push(format!("{problem}: heights are taken to be in the unit of the map"));
            None
        });
        Ok(Some(match vertical {
            None => horizontal,
            Some(vertical) => compound(horizontal, vertical),
        }))
    }

    fn projected(&self, problems: &mut Vec<String>) -> Result<Option<WktNode>, String> {
        let unit = self.unit(LINEAR_UNIT);
        if let Some(code) = self.code(PROJECTED) {
            let system = of_code(code, "PROJCS")?;
            let own = Definition::of_epsg(code.into()).map(|definition| definition.unit);
            return Ok(Some(match (own, unit) {
                (Ok(own), Ok(Some(unit))) if system.keyword == "PROJCS" && !unit.is_as_long_as(&own) => {
                    problems.push(format!(
                        "EPSG:{code} is in the unit {}, but key {LINEAR_UNIT} names the unit {}: coordinates are \
                         taken to be in the latter",
                        own.name, unit.name
                    ));
                    in_unit(&system, &own, &unit)
                }
                _ => system,
            }));
        }
        let (utm, method) = (self.short(PROJECTION).unwrap_or(0), self.short(METHOD));
        let (north, south) = (utm.wrapping_sub(UTM_NORTH), utm.wrapping_sub(UTM_SOUTH));
        let is_utm = [north, south].iter().any(|zone| (1..=60).contains(zone));
        // Some writers leave all parameters 0.
        let is_empty = !self.keys.doubles.is_empty() && self.keys.doubles.iter().all(|byte| *byte == 0);
        if !is_utm && (method.is_none() || is_empty) {
            return Ok(None);
        }
        let unit = unit?.unwrap_or_else(Unit::metre);
        let (projection, parameters) = match method {
            _ if is_utm => {
                let (zone, northing_m) = if north <= 60 { (north, 0.0) } else { (south, 1e7) };
                let of_equator = [
                    ("latitude_of_origin", 0.0),
                    ("central_meridian", 6.0 * f64::from(zone) - 183.0),
                    ("scale_factor", 0.9996),
                    ("false_easting", 5e5 / unit.metres),
                    ("false_northing", northing_m / unit.metres),
                ];
                ("Transverse_Mercator", of_equator.to_vec())
            }
            Some(1) => ("Transverse_Mercator", self.parameters(&ONE_ORIGIN, false)?),
            Some(8) => ("Lambert_Conformal_Conic_2SP", self.parameters(&PARALLELS, true)?),
            Some(9) => ("Lambert_Conformal_Conic_1SP", self.parameters(&ONE_ORIGIN, false)?),
            _ => {
                let code = method.unwrap_or_default();
                return Err(format!("projection method {code} (key {METHOD}) is not supported"));
            }
        };
        let title = self.text(PROJECTED_CITATION).or_else(|| self.text(CITATION));
        let base = self.geographic()?.ok_or("they name no geographic system")?;
        let mut node = WktNode::named("PROJCS", title.as_deref().unwrap_or("unnamed"))
            .with(base)
            .with(WktNode::named("PROJECTION", projection));
        for (name, value) in parameters {
            node = node.with(WktNode::named("PARAMETER", name).number(value));
        }
        Ok(Some(node.with(unit.wkt())))
    }

    /// Values of projection parameters; some writers use the keys of the other kind of origin.
    fn parameters(
        &self,
        names: &[&'static str],
        of_two_parallels: bool,
    ) -> Result<Vec<(&'static str, f64)>, String> {
        if let Some(code) = self.short(ANGULAR_UNIT).filter(|code| ![9102, 9122].contains(code)) {
            return Err(format!("angles are in unit {code} (key {ANGULAR_UNIT}), not in degrees"));
        }
        let value = |name: &&'static str| {
            let [own, other] = [of_two_parallels, !of_two_parallels].map(|two| key_of_parameter(name, two));
            let value = [own, other].into_iter().flatten().find_map(|key| self.double(key));
            let missing = || format!("they have no {name} (key {})", own.unwrap_or_default());
            value.ok_or_else(missing).map(|value| (*name, value))
        };
        names.iter().map(value).collect()
    }

    /// The geographic system; `None` if no key names it.
    fn geographic(&self) -> Result<Option<WktNode>, String> {
        // Codes of the older datums are the codes of their systems plus 2000.
        let of_datum = || self.code(GEODETIC_DATUM).filter(|code| (6001..7000).contains(code));
        if let Some(code) = self.code(GEOGRAPHIC).or_else(|| of_datum().map(|code| code - 2000)) {
            return of_code(code, "GEOGCS").map(Some);
        }
        let figure = match self.short(ELLIPSOID) {
            Some(7030) => Some((6_378_137.0, 298.257_223_563)),
            Some(7019) => Some((6_378_137.0, 298.257_222_101)),
            _ => self.double(SEMI_MAJOR_M).zip(self.double(INVERSE_FLATTENING)),
        };
        let Some((semi_major_m, inverse_flattening)) = figure else { return Ok(None) };
        if !SEMI_MAJORS_M.contains(&semi_major_m) {
            return Err(format!(
                "the ellipsoid has a semi-major axis of {semi_major_m} m (key {SEMI_MAJOR_M})"
            ));
        }
        let title = self.text(GEOGRAPHIC_CITATION);
        let title = title.as_deref().unwrap_or("unnamed");
        let spheroid = WktNode::named("SPHEROID", "unnamed").number(semi_major_m).number(inverse_flattening);
        Ok(Some(
            WktNode::named("GEOGCS", title)
                .with(WktNode::named("DATUM", title).with(spheroid))
                .with(WktNode::named("PRIMEM", "Greenwich").number(0.0).authority(Some(8901)))
                .with(WktNode::named("UNIT", "degree").bare("0.0174532925199433").authority(Some(9122))),
        ))
    }

    /// Vertical system; `None` for heights of an unnamed system in the unit of the map.
    fn vertical(&self, horizontal: &WktNode) -> Result<Option<WktNode>, String> {
        let map = Definition::of_wkt(&horizontal.to_string()).map(|definition| definition.unit);
        let map = map.unwrap_or_else(|_| Unit::metre());
        let unit = self.unit(VERTICAL_UNIT)?;
        let differs = unit.as_ref().is_some_and(|unit| !unit.is_as_long_as(&map));
        let (code, is_ellipsoidal) = match self.code(VERTICAL) {
            Some(code) if ELLIPSOIDAL_HEIGHTS.contains(&code) => (None, true),
            code => (code, false),
        };
        // A code of its own contains the heights.
        if horizontal.keyword == "COMPD_CS" || code.is_none() && !differs {
            return Ok(None);
        }
        if is_ellipsoidal {
            return Ok(Some(ellipsoidal(&unit.unwrap_or(map))));
        }
        let title = self.text(VERTICAL_CITATION);
        Ok(Some(vertical_of_epsg(code, title.as_deref(), unit, &map)))
    }

    /// A unit of length; `None` if the key is absent or has no meaning.
    fn unit(&self, key: u16) -> Result<Option<Unit>, String> {
        match self.short(key) {
            None | Some(0 | u16::MAX) => Ok(None),
            // Only the unit of the map has a key for its size.
            Some(USER_DEFINED) => Ok(self
                .double(LINEAR_UNIT_SIZE)
                .filter(|metres| *metres > 0.0)
                .map(|metres| Unit::of_metres("unit", metres))),
            Some(code) => {
                let unit = [Unit::metre(), Unit::foot(), Unit::us_survey_foot()];
                let known = unit.into_iter().find(|unit| unit.epsg == Some(code));
                known.map(Some).ok_or_else(|| format!("unit {code} (key {key}) is not supported"))
            }
        }
    }
}

const ONE_ORIGIN: [&str; 5] =
    ["latitude_of_origin", "central_meridian", "scale_factor", "false_easting", "false_northing"];
const PARALLELS: [&str; 6] = [
    "standard_parallel_1",
    "standard_parallel_2",
    "latitude_of_origin",
    "central_meridian",
    "false_easting",
    "false_northing",
];

fn of_code(code: u16, keyword: &str) -> Result<WktNode, String> {
    let wkt = wkt_of_epsg(code).ok_or_else(|| format!("EPSG:{code} is not in the table of systems"))?;
    let node = WktNode::parse(&wkt)?;
    let is_of_kind = node.keyword == keyword || node.keyword == "COMPD_CS" && node.find(&[keyword]).is_some();
    let other = || format!("EPSG:{code} is of another kind ({})", node.keyword);
    if is_of_kind { Ok(node) } else { Err(other()) }
}

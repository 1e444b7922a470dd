//! Coordinate reference systems as named in jobs.

use super::CrsError;

/// A coordinate reference system as named by the user.
#[derive(Clone, Debug, PartialEq)]
pub enum Named {
    /// WGS 84 / UTM in the zone of the first position: `utm`.
    Utm,
    /// WGS 84 / UTM in a given zone: `utm:33N`, `utm:55S`.
    UtmZone {
        /// Zone, 1 to 60.
        zone: u8,
        /// Northern hemisphere, with northings from the equator.
        north: bool,
    },
    /// EPSG code: `EPSG:2154`.
    Epsg(u32),
    /// WKT 1, ESRI WKT, or WKT 2.
    Wkt(String),
    /// Longitude and latitude of WGS 84 in degrees, and height: `geodetic`.
    Geodetic,
    /// Earth-centred, earth-fixed frame: `ecef`.
    Ecef,
}

impl Named {
    /// Parses a name, case-insensitive; `None` for anything else, which is the path of a WKT file.
    ///
    /// # Errors
    /// An invalid UTM zone or EPSG code, or a known system in another spelling, with the right one.
    ///
    /// # Examples
    ///
    /// ```
    /// use wavex_geodesy::crs::Named;
    ///
    /// assert_eq!(Named::parse("utm:33N")?, Some(Named::UtmZone { zone: 33, north: true }));
    /// assert_eq!(Named::parse("zone.wkt")?, None);
    /// # Ok::<(), wavex_geodesy::crs::CrsError>(())
    /// ```
    pub fn parse(word: &str) -> Result<Option<Named>, CrsError> {
        let error = |problem| CrsError::Word { word: word.into(), problem };
        let lower = word.trim().to_lowercase();
        if let Some((problem, meant)) = respelled(&lower) {
            return Err(CrsError::Spelling { word: word.into(), problem, meant });
        }
        let named = match lower.as_str() {
            "utm" => Named::Utm,
            "geodetic" => Named::Geodetic,
            "ecef" => Named::Ecef,
            _ => match lower.split_once(':') {
                Some(("utm", zone)) => utm_zone(zone).ok_or_else(|| {
                    error("a zone is a number from 1 to 60 and the hemisphere's letter N or S")
                })?,
                Some(("epsg", code)) => code
                    .trim()
                    .parse()
                    .map(Named::Epsg)
                    .map_err(|_| error("an EPSG code is a whole number"))?,
                _ => return Ok(None),
            },
        };
        Ok(Some(named))
    }
}

/// The problem and the right spelling of a word that names a system in another way; lower case.
fn respelled(word: &str) -> Option<(&'static str, String)> {
    let is_code =
        |text: &str| (4..=6).contains(&text.len()) && text.bytes().all(|byte| byte.is_ascii_digit());
    let part = [' ', '_', '-', ':'];
    let plain = word.replace(part, "");
    let urn = word.strip_prefix("urn:ogc:def:crs:epsg:").and_then(|rest| rest.split(':').next_back());
    let code = urn.or(plain.strip_prefix("epsg")).unwrap_or(&plain);
    let is_right = word.strip_prefix("epsg:").is_some_and(|rest| is_code(rest.trim()));
    if is_code(code) && !is_right {
        return Some(("an EPSG code needs its prefix", format!("EPSG:{code}")));
    }
    if let Some((horizontal, vertical)) = code.split_once('+')
        && is_code(horizontal)
        && is_code(vertical)
    {
        let problem =
            "compound systems are not named by two codes; heights above a geoid are set by the key `geoid`";
        return Some((problem, format!("EPSG:{horizontal}")));
    }
    if ["wgs84", "wgs1984"].contains(&plain.as_str()) {
        return Some((
            "a datum has many coordinate systems, such as `utm:33N`; for degrees",
            "geodetic".into(),
        ));
    }
    match plain.strip_prefix("wgs84").unwrap_or(&plain).trim_start_matches('/').strip_prefix("utm") {
        Some(zone) if !word.starts_with("utm:") => {
            let zone = zone.strip_prefix("zone").unwrap_or(zone);
            utm_zone(zone)?;
            Some(("a zone follows a colon", format!("utm:{}", zone.to_uppercase())))
        }
        _ => None,
    }
}

/// Parses a zone such as `33n` or `55s`.
fn utm_zone(text: &str) -> Option<Named> {
    let (zone, north) = match text.trim().strip_suffix('n') {
        Some(zone) => (zone, true),
        None => (text.trim().strip_suffix('s')?, false),
    };
    let zone = zone.trim().parse().ok().filter(|zone| (1..=60).contains(zone))?;
    Some(Named::UtmZone { zone, north })
}

/// UTM zone, 1 to 60, of a longitude, rad.
///
/// Zones are 6 degrees wide everywhere: the wider zones of Norway and Svalbard belong to the
/// military grid reference system, not to the projection.
pub(super) fn utm_zone_at(longitude_rad: f64) -> u8 {
    let zone = ((longitude_rad.to_degrees() + 180.0) / 6.0).floor().rem_euclid(60.0);
    zone as u8 + 1
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_name_systems() {
        let parse = |word| Named::parse(word).unwrap();
        assert_eq!(parse("utm"), Some(Named::Utm));
        assert_eq!(parse("UTM:33N"), Some(Named::UtmZone { zone: 33, north: true }));
        assert_eq!(parse("utm:5s"), Some(Named::UtmZone { zone: 5, north: false }));
        assert_eq!(parse("epsg:2154"), Some(Named::Epsg(2154)));
        assert_eq!(parse("geodetic"), Some(Named::Geodetic));
        assert_eq!(parse("ECEF"), Some(Named::Ecef));
        assert_eq!(parse("zone.wkt"), None);
        assert_eq!(parse(r"C:\zone.wkt"), None);
    }

    #[test]
    fn misspelled_names_are_errors() {
        for word in ["utm:0N", "utm:61S", "utm:33", "utm:", "utm:N"] {
            assert_eq!(
                Named::parse(word).unwrap_err().to_string(),
                format!(
                    "crs `{word}`: a zone is a number from 1 to 60 and the hemisphere's letter N or S; write `utm`, \
                     `utm:33N`, `EPSG:2154`, `geodetic`, `ecef` or the path of a WKT file"
                )
            );
        }
        assert!(
            Named::parse("epsg:lambert").unwrap_err().to_string().contains("an EPSG code is a whole number")
        );
    }

    #[test]
    fn other_spellings_are_errors_with_the_right_one() {
        for (word, meant) in [
            ("25832", "EPSG:25832"),
            ("EPSG 25832", "EPSG:25832"),
            ("epsg25832", "EPSG:25832"),
            ("urn:ogc:def:crs:EPSG::25832", "EPSG:25832"),
            ("EPSG:2956+6647", "EPSG:2956"),
            ("2956+6647", "EPSG:2956"),
            ("WGS84", "geodetic"),
            ("WGS 84", "geodetic"),
            ("utm33n", "utm:33N"),
            ("UTM 33N", "utm:33N"),
            ("WGS 84 / UTM zone 33N", "utm:33N"),
        ] {
            let error = Named::parse(word).unwrap_err().to_string();
            assert!(error.ends_with(&format!("; write `{meant}`")), "{error}");
        }
        for path in ["25832.wkt", "folder/25832", "./25832", "utm33n.prj", "wgs84.prj", "33"] {
            assert_eq!(Named::parse(path).unwrap(), None, "{path}");
        }
    }

    #[test]
    fn zones_are_six_degrees_wide() {
        for (longitude, zone) in [
            (-180.0, 1),
            (-174.001, 1),
            (-174.0, 2),
            (-0.1, 30),
            (0.0, 31),
            (5.9, 31),
            (12.6, 33),
            (179.9, 60),
        ] {
            assert_eq!(utm_zone_at(f64::to_radians(longitude)), zone, "{longitude}");
        }
        assert_eq!((utm_zone_at(core::f64::consts::PI), utm_zone_at(f64::NAN)), (1, 1));
    }
}

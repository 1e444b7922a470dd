//! GeoJSON: polygons (RFC 7946).

use std::path::Path;

use serde::Deserialize;
use serde_json::Value;
use wavex_geodesy::polygon::Polygon;

use crate::{Error, Result, read_small_text};

/// Size limit of a file, bytes.
const MOST_BYTES: u64 = 64 << 20;
/// Names of longitude and latitude on WGS 84, by which older files describe themselves.
const WGS84: [&str; 3] = ["CRS84", ":4326", ":4979"];

/// Reads all polygons of a file; `key` is the key of the job that names it.
///
/// # Errors
/// If the file is not GeoJSON, has other geometries than polygons, or none, or is in another system than longitude and latitude.
pub fn read_polygons(path: &Path, key: &str) -> Result<Vec<Polygon>> {
    let remedy = format!("`{key}` takes a Polygon or MultiPolygon in longitude and latitude on WGS 84");
    let text = read_small_text(path, MOST_BYTES, "polygons", &remedy)?;
    polygons_in(&text).map_err(|problem| Error::unusable(path, problem, remedy))
}

/// A result, or the problem of the file.
type Found<T> = std::result::Result<T, String>;

fn polygons_in(text: &str) -> Found<Vec<Polygon>> {
    let value: Value = serde_json::from_str(text.trim_start_matches('\u{feff}')).map_err(not_geojson)?;
    let mut polygons = Vec::new();
    collect(&value, &mut polygons)?;
    if polygons.is_empty() { Err("it has no polygon".to_owned()) } else { Ok(polygons) }
}

fn not_geojson(error: impl std::fmt::Display) -> String {
    format!("not GeoJSON: {error}")
}

/// Adds the polygons of an object and of the objects in it.
fn collect(object: &Value, polygons: &mut Vec<Polygon>) -> Found<()> {
    check_crs(object)?;
    let mut add = |rings: Vec<Vec<Vec<f64>>>| -> Found<()> {
        let rings = rings.into_iter().map(ring).collect::<Found<_>>()?;
        polygons.push(Polygon::new(rings).map_err(|error| error.to_string())?);
        Ok(())
    };
    let coordinates = &object["coordinates"];
    match object["type"].as_str() {
        Some("Polygon") => add(Vec::deserialize(coordinates).map_err(not_geojson)?),
        Some("MultiPolygon") => {
            let parts: Vec<_> = Vec::deserialize(coordinates).map_err(not_geojson)?;
            parts.into_iter().try_for_each(add)
        }
        Some("Feature") if object["geometry"].is_null() => Ok(()),
        Some("Feature") => collect(&object["geometry"], polygons),
        Some("FeatureCollection") => {
            let features = object["features"].as_array();
            let features = features.ok_or_else(|| not_geojson("a FeatureCollection without `features`"))?;
            features.iter().try_for_each(|feature| collect(feature, polygons))
        }
        Some(other) => Err(format!("it has a {other}")),
        None => Err(not_geojson("an object without `type`")),
    }
}

/// Longitudes and latitudes of positions, which may have heights.
fn ring(positions: Vec<Vec<f64>>) -> Found<Vec<[f64; 2]>> {
    let place = |position: Vec<f64>| match position.as_slice() {
        [longitude_deg, latitude_deg, ..] => Ok([*longitude_deg, *latitude_deg]),
        _ => Err(not_geojson("a position has fewer than 2 numbers")),
    };
    positions.into_iter().map(place).collect()
}

/// Checks the member `crs` of older files.
fn check_crs(object: &Value) -> Found<()> {
    let crs = &object["crs"];
    let name = crs["properties"]["name"].as_str();
    if crs.is_null() || name.is_some_and(|name| WGS84.iter().any(|known| name.ends_with(known))) {
        return Ok(());
    }
    let shown = name.map_or_else(|| crs.to_string(), str::to_owned);
    Err(format!(
        "its `crs` is {shown}: transform it, as by `ogr2ogr -t_srs EPSG:4326 OUT.geojson IN.geojson`"
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    const SQUARE: &str =
        "[[[0, 0], [4, 0, 310.5], [4, 4], [0, 4], [0, 0]], [[1, 1], [2, 1], [2, 2], [1, 1]]]";

    fn of(kind: &str, coordinates: &str) -> String {
        format!("{{\"type\": \"{kind}\", \"coordinates\": {coordinates}}}")
    }

    #[test]
    fn polygons_are_found_in_all_objects() {
        let polygon = of("Polygon", SQUARE);
        let multi = of("MultiPolygon", &format!("[{SQUARE}, [[[10, 10], [11, 10], [11, 11]]]]"));
        let feature = format!("{{\"type\": \"Feature\", \"properties\": null, \"geometry\": {multi}}}");
        let empty = "{\"type\": \"Feature\", \"geometry\": null}";
        let crs =
            "\"crs\": {\"type\": \"name\", \"properties\": {\"name\": \"urn:ogc:def:crs:OGC:1.3:CRS84\"}}";
        let all =
            format!("\u{feff}{{\"type\": \"FeatureCollection\", {crs}, \"features\": [{empty}, {feature}]}}");
        for (text, count) in [(&polygon, 1), (&multi, 2), (&feature, 2), (&all, 2)] {
            let polygons = polygons_in(text).unwrap();
            assert_eq!(polygons.len(), count, "{text}");
            assert!(polygons[0].includes(3.0, 3.0) && !polygons[0].includes(1.8, 1.4), "{text}");
        }
    }

    #[test]
    fn other_files_are_refused_with_the_key() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("plot.geojson");
        let error = |text: &str| {
            std::fs::write(&path, text).unwrap();
            let error = read_polygons(&path, "extent_deg").unwrap_err().to_string();
            let rest = error.strip_prefix(&format!("{}: ", path.display())).unwrap_or(&error).to_owned();
            let remedy = "; `extent_deg` takes a Polygon or MultiPolygon in longitude and latitude on WGS 84";
            rest.strip_suffix(remedy).unwrap_or_else(|| panic!("{error}")).to_owned()
        };
        assert_eq!(error(""), "not GeoJSON: EOF while parsing a value at line 1 column 0");
        assert_eq!(error("{}"), "not GeoJSON: an object without `type`");
        assert_eq!(error("[1]"), "not GeoJSON: an object without `type`");
        assert_eq!(error(&of("Point", "[1, 2]")), "it has a Point");
        assert_eq!(error(&of("LineString", "[[1, 2], [3, 4]]")), "it has a LineString");
        assert_eq!(error("{\"type\": \"FeatureCollection\", \"features\": []}"), "it has no polygon");
        assert_eq!(
            error("{\"type\": \"FeatureCollection\"}"),
            "not GeoJSON: a FeatureCollection without `features`"
        );
        assert_eq!(
            error(&of("Polygon", "[[[1], [2], [3]]]")),
            "not GeoJSON: a position has fewer than 2 numbers"
        );
        assert!(error(&of("Polygon", "[1]")).starts_with("not GeoJSON: invalid type"));
        assert_eq!(error(&of("Polygon", "[[[1, 2], [3, 4]]]")), "a polygon has 2 points, and 3 are needed");
        let swapped = error(&of("Polygon", "[[[48, 170], [49, 170], [49, 171]]]"));
        assert!(
            swapped.starts_with("the latitude 170 is not from -90 to 90 degrees: points are [long"),
            "{swapped}"
        );
        let utm =
            "\"crs\": {\"type\": \"name\", \"properties\": {\"name\": \"urn:ogc:def:crs:EPSG::32633\"}}";
        assert_eq!(
            error(&of("Polygon", SQUARE).replacen('{', &format!("{{{utm}, "), 1)),
            "its `crs` is urn:ogc:def:crs:EPSG::32633: transform it, as by `ogr2ogr -t_srs EPSG:4326 OUT.geojson IN.geojson`"
        );
    }
}

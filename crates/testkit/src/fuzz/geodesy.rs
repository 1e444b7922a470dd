//! Geoids, terrain models, and coordinate reference systems.

use wavex_formats::geojson::read_polygons;
use wavex_formats::terrain::Terrain;
use wavex_formats::{geoid, geokeys};
use wavex_geodesy::crs::{
    Crs, GeoKeys, Named, Outline, RecordedSystem, geotiff_keys_of_wkt, projjson_of_wkt,
    system_of_geotiff_keys,
};
use wavex_geodesy::ellipsoid::Geodetic;

use super::Files;

/// A place in Austria.
const PLACE: Geodetic = Geodetic { latitude_rad: 0.84, longitude_rad: 0.26, height_m: 400.0 };

/// A geoid grid, in both formats.
pub fn geoid(bytes: &[u8]) {
    for name in ["a.bin", "a.gtx"] {
        let place = Files::with(&[(name, bytes)]);
        let Ok(geoid) = geoid::read(&place.path(name)) else { continue };
        assert_eq!(geoid.name(), "a");
        let grid = geoid.grid();
        assert_eq!(grid.heights_m.len(), grid.rows * grid.columns);
        let (south, west) = (grid.south_deg, grid.west_deg);
        for (rows, columns) in [(0.0, 0.0), (0.5, 0.5), (1.0, 359.9), (-1.0, -1.0), (1e9, 1e300)] {
            let latitude = south + rows * grid.latitude_step_deg;
            if let Ok(height_m) = geoid.height_m(latitude, west + columns * grid.longitude_step_deg) {
                assert!(!height_m.is_nan());
            }
        }
        assert!(geoid.height_m(f64::NAN, 0.0).is_err());
    }
}

/// Polygons as GeoJSON: a corner is on the border.
pub fn geojson(bytes: &[u8]) {
    let place = Files::with(&[("a.geojson", bytes)]);
    let Ok(polygons) = read_polygons(&place.path("a.geojson"), "extent_deg") else { return };
    for polygon in polygons {
        let [west, south, east, north] = polygon.bounds_deg();
        assert!(west <= east && south < north);
        assert!(!polygon.includes(0.5 * (west + east), north + 1.0) && !polygon.includes(f64::NAN, south));
    }
}

/// A terrain model as GeoTIFF.
pub fn terrain_geotiff(bytes: &[u8]) {
    terrain("a.tif", bytes);
}

/// A terrain model as ESRI ASCII grid.
pub fn terrain_ascii(bytes: &[u8]) {
    terrain("a.asc", bytes);
}

fn terrain(name: &str, bytes: &[u8]) {
    let place = Files::with(&[(name, bytes)]);
    let Ok(terrain) = Terrain::open(&place.path(name)) else { return };
    let [lowest_m, highest_m] = terrain.heights_m();
    assert!(lowest_m <= highest_m && terrain.bytes() > 0);
    let _ = terrain.epsg();
    for [x, y] in [[0.0, 0.0], [2.5, -3.5], [1e6, 5e6], [f64::NAN, 0.0], [f64::INFINITY, 1e308]] {
        let height_m = terrain.height_m(x, y);
        let is_within = (f64::from(lowest_m) - 0.01..=f64::from(highest_m) + 0.01).contains(&height_m);
        assert!(height_m.is_nan() || is_within, "{height_m} m is not within {lowest_m} to {highest_m} m");
        let range_m = terrain.range_m([x, y, 2000.0], [0.1, 0.1, -0.99], [10.0, 5000.0]);
        assert!(range_m.is_nan() || (9.0..=5001.0).contains(&range_m));
    }
}

/// A name or WKT of a coordinate reference system.
pub fn wkt(bytes: &[u8]) {
    let text = String::from_utf8_lossy(bytes).into_owned();
    let named = Named::parse(&text).ok().flatten().unwrap_or_else(|| Named::Wkt(text.clone()));
    let _ = (geokeys::from_wkt(&text), geotiff_keys_of_wkt(&text), projjson_of_wkt(&text));
    let _ = Outline::new(&text, [0.0; 3], [1000.0; 3]).and_then(|outline| outline.bounds());
    let Ok(crs) = Crs::new(&named, PLACE, None, None) else { return };
    let _ = (crs.name().len(), crs.epsg(), crs.is_ecef());
    let Ok(coordinates) = crs.from_geodetic(PLACE) else { return };
    let _ = crs.to_geodetic(coordinates).and_then(|place| crs.from_geodetic(place));
    let _ = crs.to_ecef([f64::NAN, 1e300, 0.0]);
    // What is written into LAS files is read again, and means the same.
    let written = crs.wkt();
    let again = Crs::new(&Named::Wkt(written.clone()), PLACE, None, None);
    let again = match again {
        Ok(again) => again.from_geodetic(PLACE),
        Err(error) => panic!("{error}: {written}"),
    };
    let Ok(again) = again else { panic!("{written} has no coordinates here") };
    for (a, b) in coordinates.iter().zip(again) {
        assert!((a - b).abs() <= 1e-6 * (1.0 + a.abs()) || a.is_nan(), "{a} became {b}: {written}");
    }
}

/// A directory of GeoTIFF keys.
pub fn geokeys(bytes: &[u8]) {
    let epsg = geokeys::epsg(bytes);
    let _ = (geokeys::is_geocentric(bytes), geokeys::is_point_raster(bytes));
    let keys = GeoKeys { directory: bytes.to_vec(), doubles: bytes.to_vec(), ascii: bytes.to_vec() };
    let Ok(Some(RecordedSystem { wkt, .. })) = system_of_geotiff_keys(&keys) else { return };
    if let Some(keys) = geokeys::from_wkt(&wkt) {
        assert_eq!(keys.directory.len() % 8, 0);
        // A deprecated code has the text of the system that replaces it, without its own code.
        let names = |code: u16| {
            let ids = [format!("\"EPSG\",{code}]"), format!("\"EPSG\",\"{code}\"]")];
            ids.iter().any(|id| wkt.contains(id))
        };
        let names_itself = epsg.is_some_and(names);
        if let Some(again) = geokeys::epsg(&keys.directory).filter(|_| names_itself) {
            assert_eq!(Some(again), epsg, "{wkt}");
        }
    }
}

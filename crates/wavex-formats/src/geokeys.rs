//! GeoTIFF keys: the CRS of older LAS and PulseWaves files.

mod from_wkt;

use wavex_geodesy::crs::{GeoKeys, geotiff_keys_of_wkt};

use from_wkt::directory_of_wkt;

/// Converts WKT 1 or 2 to GeoTIFF keys with units.
///
/// Returns all three records. For an unsupported system, such as one on another datum, only the
/// EPSG codes in the text are converted.
pub fn from_wkt(wkt: &str) -> Option<GeoKeys> {
    let of_codes = |directory| GeoKeys { directory, doubles: Vec::new(), ascii: Vec::new() };
    geotiff_keys_of_wkt(wkt).or_else(|| directory_of_wkt(wkt).map(of_codes))
}

/// Key of the model type.
///
/// 1 projected, 2 geographic, 3 geocentric (GeoTIFF 1.0, section 6.3.1.1).
const MODEL_TYPE: u16 = 1024;
/// Key of the geographic coordinate reference system (GeoTIFF 1.0, section 6.3.2.1).
const GEOGRAPHIC: u16 = 2048;
/// Key of the projected coordinate reference system (GeoTIFF 1.0, section 6.3.3.1).
const PROJECTED: u16 = 3072;
/// Key of the raster type.
///
/// 1 cells are areas, 2 cells are points (GeoTIFF 1.0, section 6.3.1.2).
const RASTER_TYPE: u16 = 1025;
/// First code that is not an EPSG code.
///
/// 32767 means "user-defined".
const USER_DEFINED: u16 = 32767;

/// Returns the EPSG code in a GeoTIFF key directory (record 34735).
///
/// `None` if the directory defines a custom system or is damaged.
pub fn epsg(directory: &[u8]) -> Option<u16> {
    let code = match value(directory, MODEL_TYPE)? {
        1 => value(directory, PROJECTED)?,
        _ => value(directory, GEOGRAPHIC)?,
    };
    (code > 1023 && code < USER_DEFINED).then_some(code)
}

/// Returns whether coordinates are geocentric (ECEF).
///
/// Either the model type or the code (EPSG:4978) says so.
pub fn is_geocentric(directory: &[u8]) -> bool {
    value(directory, MODEL_TYPE) == Some(3) || epsg(directory) == Some(4978)
}

/// Returns whether raster tie points are cell centres.
///
/// Otherwise they are cell corners.
pub fn is_point_raster(directory: &[u8]) -> bool {
    value(directory, RASTER_TYPE) == Some(2)
}

/// Returns the value of a key stored in the directory itself.
fn value(directory: &[u8], key: u16) -> Option<u16> {
    let words: Vec<u16> =
        directory.chunks_exact(2).map(|word| u16::from_le_bytes([word[0], word[1]])).collect();
    let (head, entries) = words.split_at_checked(4)?;
    // Entry: key, location of the value (0: in the entry itself), count, value.
    let mut entries = entries.chunks_exact(4).take(usize::from(head[3]));
    entries.find(|entry| entry[0] == key && entry[1] == 0).map(|entry| entry[3])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn directory(entries: &[[u16; 4]]) -> Vec<u8> {
        let head = [1, 1, 0, entries.len() as u16];
        head.iter().chain(entries.as_flattened()).flat_map(|word| word.to_le_bytes()).collect()
    }

    #[test]
    fn projected_systems_have_their_code() {
        let utm =
            directory(&[[1024, 0, 1, 1], [1026, 34737, 18, 0], [3072, 0, 1, 32633], [3076, 0, 1, 9001]]);
        assert_eq!(epsg(&utm), Some(32633));
    }

    #[test]
    fn geocentric_systems_have_their_model_or_code() {
        assert!(is_geocentric(&directory(&[[1024, 0, 1, 3], [2048, 0, 1, 4326]])));
        assert!(is_geocentric(&directory(&[[1024, 0, 1, 2], [2048, 0, 1, 4978]])));
        assert!(!is_geocentric(&directory(&[[1024, 0, 1, 1], [3072, 0, 1, 32633]])) && !is_geocentric(&[]));
    }

    #[test]
    fn geographic_systems_have_their_code() {
        assert_eq!(epsg(&directory(&[[1024, 0, 1, 2], [2048, 0, 1, 4258]])), Some(4258));
    }

    #[test]
    fn cells_are_areas_unless_said_otherwise() {
        assert!(is_point_raster(&directory(&[[1025, 0, 1, 2]])));
        assert!(!is_point_raster(&directory(&[[1025, 0, 1, 1]])));
        assert!(!is_point_raster(&[]));
    }

    #[test]
    fn a_system_of_the_files_own_has_no_code() {
        assert_eq!(epsg(&directory(&[[1024, 0, 1, 1], [3072, 0, 1, 32767]])), None);
        assert_eq!(epsg(&directory(&[[1024, 0, 1, 3]])), None);
    }

    #[test]
    fn damaged_keys_are_no_code() {
        let whole = directory(&[[1024, 0, 1, 1], [3072, 0, 1, 32633]]);
        for length in 0..whole.len() {
            assert_eq!(epsg(&whole[..length]), None, "{length}");
        }
    }
}

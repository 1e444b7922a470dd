//! Extracts GeoTIFF keys from the EPSG codes in a WKT.

use super::{GEOGRAPHIC, MODEL_TYPE, PROJECTED, RASTER_TYPE};

/// Key of the unit of lengths (GeoTIFF 1.0, section 6.3.1.3).
const LINEAR_UNIT: u16 = 3076;
/// Key of the unit of angles (GeoTIFF 1.0, section 6.3.1.4).
const ANGULAR_UNIT: u16 = 2054;
/// Key of the vertical coordinate reference system (GeoTIFF 1.0, section 6.3.4.1).
const VERTICAL: u16 = 4096;
/// Key of the unit of heights (GeoTIFF 1.0, section 6.3.4).
const VERTICAL_UNIT: u16 = 4099;

/// Builds a GeoTIFF key directory (record 34735) from WKT 1 or 2.
///
/// It holds the EPSG codes of the model, system and unit, and of the vertical system and its unit.
/// `None` if the horizontal system has no code.
pub fn directory_of_wkt(wkt: &str) -> Option<Vec<u8>> {
    let (root, _) = node(wkt)?;
    let parts = if matches!(root.keyword, "COMPD_CS" | "COMPOUNDCRS") { root.children() } else { vec![root] };
    let mut entries = Vec::new();
    for part in &parts {
        let (model, system, unit) = match part.keyword {
            "PROJCS" | "PROJCRS" => (Some(1), PROJECTED, LINEAR_UNIT),
            "GEOGCS" | "GEOGCRS" => (Some(2), GEOGRAPHIC, ANGULAR_UNIT),
            "VERT_CS" | "VERTCRS" => (None, VERTICAL, VERTICAL_UNIT),
            _ => continue,
        };
        let Some(code) = part.code() else {
            // A vertical system without a code does not invalidate the horizontal one.
            model.map_or(Some(()), |_| None)?;
            continue;
        };
        if let Some(model) = model {
            entries.extend([(MODEL_TYPE, model), (RASTER_TYPE, 1)]);
        }
        entries.push((system, code));
        entries.extend(part.unit_code().map(|code| (unit, code)));
    }
    entries.iter().any(|(key, _)| *key == MODEL_TYPE).then(|| directory(entries))
}

/// Encodes keys in ascending order.
///
/// Each entry contains its value.
fn directory(mut entries: Vec<(u16, u16)>) -> Vec<u8> {
    entries.sort_unstable();
    let head = [1, 1, 0, entries.len() as u16];
    let words = entries.into_iter().flat_map(|(key, value)| [key, 0, 1, value]);
    head.into_iter().chain(words).flat_map(u16::to_le_bytes).collect()
}

/// WKT node: `KEYWORD[...]`.
#[derive(Clone, Copy)]
struct WktSlice<'a> {
    keyword: &'a str,
    inside: &'a str,
}

impl<'a> WktSlice<'a> {
    /// Returns the direct child nodes.
    fn children(self) -> Vec<WktSlice<'a>> {
        let mut children = Vec::new();
        let mut rest = self.inside;
        while let Some((child, after)) = node(rest) {
            children.push(child);
            rest = after;
        }
        children
    }

    /// Returns the EPSG code of the node itself.
    fn code(self) -> Option<u16> {
        let of = |child: &WktSlice| {
            let (authority, code) = child.inside.split_once(',')?;
            let code = code.split(',').next()?.trim().trim_matches('"');
            (authority.trim() == "\"EPSG\"").then(|| code.parse().ok()).flatten()
        };
        self.children().iter().filter(|child| matches!(child.keyword, "AUTHORITY" | "ID")).find_map(of)
    }

    /// Returns the EPSG code of the unit of the node's coordinates.
    fn unit_code(self) -> Option<u16> {
        let is_unit = |child: &WktSlice| matches!(child.keyword, "UNIT" | "LENGTHUNIT" | "ANGLEUNIT");
        self.children().into_iter().find(is_unit)?.code()
    }
}

/// Returns the first node and the text after it.
///
/// `None` if there is no node or it is not closed.
fn node(text: &str) -> Option<(WktSlice<'_>, &str)> {
    let mut open = None;
    let (mut depth, mut quoted) = (0usize, false);
    for (at, byte) in text.bytes().enumerate() {
        match byte {
            b'"' => quoted = !quoted,
            _ if quoted => {}
            b'[' | b'(' => {
                open.get_or_insert(at);
                depth += 1;
            }
            b']' | b')' => {
                depth = depth.checked_sub(1)?;
                if let (0, Some(open)) = (depth, open) {
                    let keyword = text[..open].rsplit([',', ' ', '\n', '\r', '\t']).next()?;
                    return Some((WktSlice { keyword, inside: &text[open + 1..at] }, &text[at + 1..]));
                }
            }
            _ => {}
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::super::{epsg, value};
    use super::*;
    use wavex_geodesy::crs::wkt_of_epsg;

    #[test]
    fn codes_of_a_map_become_keys_in_order() {
        let keys = directory_of_wkt(&wkt_of_epsg(32633).unwrap()).unwrap();
        let words: Vec<u16> = keys.chunks_exact(2).map(|b| u16::from_le_bytes([b[0], b[1]])).collect();
        assert_eq!(words, [1, 1, 0, 4, 1024, 0, 1, 1, 1025, 0, 1, 1, 3072, 0, 1, 32633, 3076, 0, 1, 9001]);
        assert_eq!(epsg(&keys), Some(32633));
    }

    #[test]
    fn heights_have_keys_of_their_own() {
        let wkt = r#"COMPD_CS["a, \"b", PROJCS["x [1]", GEOGCS["y", AUTHORITY["EPSG", "4269"]],
            UNIT["US survey foot", 0.3048006, AUTHORITY["EPSG","9003"]], AUTHORITY["EPSG","2232"]],
            VERT_CS["NAVD88", UNIT["US survey foot", 0.3048006, AUTHORITY["EPSG","9003"]], AUTHORITY["EPSG","6360"]]]"#;
        let wkt = wkt.replace("\\\"", "'");
        let keys = directory_of_wkt(&wkt).unwrap();
        let found = [1024, 3072, 3076, 4096, 4099].map(|key| value(&keys, key));
        assert_eq!(found, [Some(1), Some(2232), Some(9003), Some(6360), Some(9003)]);
        let without = wkt.replace(r#", AUTHORITY["EPSG","6360"]"#, "");
        let keys = directory_of_wkt(&without).unwrap();
        assert_eq!((epsg(&keys), value(&keys, 4096)), (Some(2232), None));
    }

    #[test]
    fn newer_wkt_is_understood() {
        let wkt = r#"PROJCRS["m",BASEGEOGCRS["b",ID["EPSG",4326]],CS[Cartesian,2],LENGTHUNIT["metre",1,ID["EPSG",9001]],ID["EPSG",25832]]"#;
        assert_eq!(epsg(&directory_of_wkt(wkt).unwrap()), Some(25832));
        let geographic = directory_of_wkt(&wkt_of_epsg(4258).unwrap()).unwrap();
        assert_eq!((epsg(&geographic), value(&geographic, 2054)), (Some(4258), Some(9122)));
    }

    #[test]
    fn a_system_without_code_has_no_keys() {
        let own = r#"PROJCS["own",GEOGCS["WGS 84",AUTHORITY["EPSG","4326"]],UNIT["metre",1]]"#;
        assert_eq!(directory_of_wkt(own), None);
        assert_eq!(directory_of_wkt(&own.replace(r#"1]]"#, r#"1],AUTHORITY["ESRI","54004"]]"#)), None);
        for odd in ["", "PROJCS", "PROJCS[", "]", "LOCAL_CS[\"a\",AUTHORITY[\"EPSG\",\"5800\"]]"] {
            assert_eq!(directory_of_wkt(odd), None, "{odd}");
        }
        let whole = wkt_of_epsg(32633).unwrap();
        assert!((0..whole.trim_end().len()).all(|end| directory_of_wkt(&whole[..end]).is_none()));
    }

    #[test]
    fn depth_costs_nothing_but_time() {
        assert_eq!(directory_of_wkt(&"A[".repeat(100_000)), None);
    }
}

//! Coordinate reference systems by EPSG code: WKT and areas of use, compressed in blocks.

use std::io::Read as _;

use flate2::read::DeflateDecoder;

/// First code and offset in [`BYTES`] of each block.
static BLOCKS: &[(u16, usize)] = include!(concat!(env!("OUT_DIR"), "/epsg_blocks.rs"));
/// Blocks of lines `CODE AREA WKT` with tabs, compressed with Deflate.
static BYTES: &[u8] = include_bytes!(concat!(env!("OUT_DIR"), "/epsg.deflate"));

/// Box around the area for which a CRS is made, degrees; one of EPSG is rounded outwards to whole degrees.
///
/// `west` exceeds `east` if the box crosses the meridian of 180 degrees.
#[derive(Clone, Copy, Debug, PartialEq)]
#[allow(missing_docs, reason = "the fields are the ends of the box")]
pub struct AreaOfUse {
    pub west: f64,
    pub south: f64,
    pub east: f64,
    pub north: f64,
}

impl AreaOfUse {
    /// Whether a position lies in the box or at most `margin` outside; all in degrees.
    pub fn contains(&self, longitude: f64, latitude: f64, margin: f64) -> bool {
        let width = self.east - self.west + if self.east < self.west { 360.0 } else { 0.0 };
        (longitude - self.west + margin).rem_euclid(360.0) <= width + 2.0 * margin
            && (self.south - margin..=self.north + margin).contains(&latitude)
    }
}

/// Returns the CRS of an EPSG code as WKT 1; `None` if the table lacks it.
pub fn wkt_of_epsg(code: u16) -> Option<String> {
    row(code).map(|[_, wkt]| wkt)
}

/// Returns the area of use of an EPSG code; `None` if it is unknown or the whole earth.
pub fn area_of_epsg(code: u16) -> Option<AreaOfUse> {
    let [area, _] = row(code)?;
    let mut degrees = area.split(' ').filter_map(|degrees| degrees.parse().ok());
    let mut next = || degrees.next();
    Some(AreaOfUse { west: next()?, south: next()?, east: next()?, north: next()? })
}

/// Area of use and WKT of an EPSG code.
fn row(code: u16) -> Option<[String; 2]> {
    let next = BLOCKS.partition_point(|(first, _)| *first <= code);
    let (_, begin) = BLOCKS.get(next.checked_sub(1)?)?;
    let mut text = String::new();
    DeflateDecoder::new(BYTES.get(*begin..)?).read_to_string(&mut text).ok()?;
    text.lines().find_map(|line| {
        let (known, rest) = line.split_once('\t')?;
        let (area, wkt) = rest.split_once('\t')?;
        (known.parse() == Ok(code)).then(|| [area, wkt].map(str::to_owned))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_code_has_the_wkt_of_the_table() {
        let mut systems = 0;
        for code in 0..=u16::MAX {
            let expected = crs_definitions::from_code(code).map(|known| known.wkt);
            let expected = expected.filter(|wkt| !wkt.is_empty());
            // Codes between blocks are as expensive as others: try only some of those without a system.
            if expected.is_some() || code % 97 == 0 {
                assert_eq!(wkt_of_epsg(code).as_deref(), expected, "{code}");
            }
            systems += usize::from(expected.is_some());
        }
        assert!(systems > 5000, "{systems}");
    }

    #[test]
    fn codes_have_their_areas_of_use() {
        let ends = |code| area_of_epsg(code).map(|area| [area.west, area.south, area.east, area.north]);
        assert_eq!(ends(32633), Some([12.0, 0.0, 18.0, 84.0]));
        assert_eq!(ends(2271), Some([-81.0, 40.0, -74.0, 43.0]), "-80.53 40.6 -74.7 42.53 rounded outwards");
        assert_eq!(ends(2393), Some([19.0, 59.0, 32.0, 71.0]), "the union of two areas");
        assert_eq!(ends(4326), None, "the whole earth");
        assert_eq!([0, 31, 65535].map(area_of_epsg), [None; 3], "unknown codes");
    }

    #[test]
    fn positions_are_in_areas_of_use() {
        let is_in =
            |code, longitude, latitude| area_of_epsg(code).unwrap().contains(longitude, latitude, 1.0);
        for code in [32633, 31256, 25833] {
            assert!(is_in(code, 15.0, 47.0), "Austria and {code}");
        }
        assert!(!is_in(2271, 15.0, 47.0) && !is_in(32733, 15.0, 47.0) && !is_in(32633, 15.0, -47.0));
        assert!(is_in(32633, 18.9, 47.0) && !is_in(32633, 19.1, 47.0), "the margin");
        assert!(is_in(32633, 11.1, -0.9) && !is_in(32633, 10.9, 0.0) && !is_in(32633, 15.0, -1.1));
        // Fiji: 176 to -178.
        assert!(is_in(3143, 179.0, -18.0) && is_in(3143, -179.0, -18.0) && is_in(3143, 181.0, -18.0));
        assert!(!is_in(3143, -176.0, -18.0) && !is_in(3143, 0.0, -18.0));
        // Zones 1 and 60 end at the meridian; the margin crosses it.
        assert!(is_in(32601, 179.5, 60.0) && is_in(32660, -179.5, 60.0) && !is_in(32601, 178.5, 60.0));
        // All longitudes.
        assert!(is_in(32661, -180.0, 85.0) && is_in(32661, 180.0, 85.0) && !is_in(32661, 0.0, 47.0));
        assert!(!is_in(32633, f64::NAN, 47.0) && !is_in(32633, 15.0, f64::NAN));
    }
}

//! Coordinate reference systems by EPSG code, as WKT that is compressed in blocks.

use std::io::Read as _;

use flate2::read::DeflateDecoder;

/// First code and offset in [`BYTES`] of each block.
static BLOCKS: &[(u16, usize)] = include!(concat!(env!("OUT_DIR"), "/epsg_blocks.rs"));
/// Blocks of lines `CODE WKT`, compressed with Deflate.
static BYTES: &[u8] = include_bytes!(concat!(env!("OUT_DIR"), "/epsg.deflate"));

/// Returns the CRS of an EPSG code as WKT 1; `None` if the table lacks it.
pub fn wkt_of_epsg(code: u16) -> Option<String> {
    let next = BLOCKS.partition_point(|(first, _)| *first <= code);
    let (_, begin) = BLOCKS.get(next.checked_sub(1)?)?;
    let mut text = String::new();
    DeflateDecoder::new(BYTES.get(*begin..)?).read_to_string(&mut text).ok()?;
    let of_code = |(known, wkt): (&str, &str)| (known.parse() == Ok(code)).then(|| wkt.to_owned());
    text.lines().find_map(|line| line.split_once(' ').and_then(of_code))
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
}

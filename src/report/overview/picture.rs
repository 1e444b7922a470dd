//! PNG images in base 64 (W3C Portable Network Graphics, third edition; RFC 4648, section 4).

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// PNG image in base 64, with 256 colours: the first is transparent.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(try_from = "String", into = "String")]
#[schemars(with = "String")]
pub struct Picture(String);

impl From<Picture> for String {
    fn from(Picture(text): Picture) -> String {
        text
    }
}

impl TryFrom<String> for Picture {
    type Error = &'static str;

    fn try_from(text: String) -> Result<Picture, &'static str> {
        let fits = |byte: u8| DIGITS.contains(&byte) || byte == b'=';
        if text.bytes().all(fits) { Ok(Picture(text)) } else { Err("a picture must be in base 64") }
    }
}

/// Equally spaced colours, interpolated linearly.
pub(super) type Ramp = [[u8; 3]; 6];

/// Heights from low to high: blue, green, yellow.
///
/// Lightness increases at every step, so that they can be distinguished in grey. Both ends are
/// visible on white and on black.
pub(super) const HEIGHTS: Ramp =
    [[62, 54, 130], [48, 98, 146], [34, 138, 141], [62, 172, 112], [142, 200, 66], [226, 205, 38]];
/// Intensities from weak to strong: greys.
pub(super) const INTENSITIES: Ramp =
    [[52, 52, 54], [86, 86, 88], [120, 120, 121], [154, 154, 154], [188, 188, 186], [222, 222, 218]];

/// Fraction of the cells beyond either end of the colours.
const BEYOND: f64 = 0.01;
/// Size limit of a stored block in `Deflate`, bytes.
const MOST_STORED: usize = 65_535;

impl Picture {
    /// Converts rows of cells from the top to colours; also returns the values of the first and
    /// last colour.
    pub(super) fn of(cells: &[Option<f64>], columns: usize, ramp: &Ramp) -> (Picture, [f64; 2]) {
        let mut known: Vec<f64> = cells.iter().flatten().copied().collect();
        known.sort_by(f64::total_cmp);
        let at = |part: f64| known.get((part * known.len().saturating_sub(1) as f64).round() as usize);
        let range = [BEYOND, 1.0 - BEYOND].map(|part| at(part).copied().unwrap_or(0.0));
        let [low, high] = range;
        // The cast saturates.
        let level = |value: f64| 1 + (254.0 * (value - low) / (high - low).max(1e-9)).round() as u8;
        let levels: Vec<u8> =
            cells.iter().map(|cell| cell.map_or(0, |value| level(value.min(high)))).collect();
        (Picture(base_64(&png(&levels, columns, ramp))), range)
    }

    /// The image as a data URL.
    pub fn data_url(&self) -> String {
        format!("data:image/png;base64,{}", self.0)
    }
}

/// Colour `i` of 255.
fn mixed(ramp: &Ramp, i: usize) -> [u8; 3] {
    let place = i as f64 / 254.0 * (ramp.len() - 1) as f64;
    let below = (place as usize).min(ramp.len() - 2);
    let part = place - below as f64;
    let mix = |a: u8, b: u8| (f64::from(a) + part * (f64::from(b) - f64::from(a))).round() as u8;
    let [from, to] = [ramp[below], ramp[below + 1]];
    std::array::from_fn(|channel| mix(from[channel], to[channel]))
}

/// Colours of a ramp in CSS notation.
pub(super) fn css(ramp: &Ramp) -> Vec<String> {
    ramp.iter().map(|[red, green, blue]| format!("#{red:02x}{green:02x}{blue:02x}")).collect()
}

/// PNG bytes from one colour index per cell.
fn png(levels: &[u8], columns: usize, ramp: &Ramp) -> Vec<u8> {
    let rows = levels.len() / columns.max(1);
    let mut header = Vec::new();
    header.extend((columns as u32).to_be_bytes());
    header.extend((rows as u32).to_be_bytes());
    // 8 bits, indexed colour, the only compression and filter method, not interlaced.
    header.extend([8, 3, 0, 0, 0]);
    let palette: Vec<u8> = [[0; 3]].into_iter().chain((0..255).map(|i| mixed(ramp, i))).flatten().collect();
    // Each row starts with its filter type: none.
    let rows: Vec<u8> = levels.chunks(columns.max(1)).flat_map(|row| [&[0], row].concat()).collect();
    let mut file = b"\x89PNG\r\n\x1a\n".to_vec();
    for (name, content) in [
        (b"IHDR", header),
        (b"PLTE", palette),
        (b"tRNS", vec![0]),
        (b"IDAT", stored(&rows)),
        (b"IEND", Vec::new()),
    ] {
        file.extend((content.len() as u32).to_be_bytes());
        let named = [&name[..], &content].concat();
        file.extend(&named);
        file.extend(crc_32(&named).to_be_bytes());
    }
    file
}

/// Wraps bytes in a zlib stream of stored blocks (RFC 1950; RFC 1951, section 3.2.4).
fn stored(bytes: &[u8]) -> Vec<u8> {
    let mut stream = vec![0x78, 0x01];
    let mut blocks = bytes.chunks(MOST_STORED).peekable();
    while let Some(block) = blocks.next() {
        stream.push(u8::from(blocks.peek().is_none()));
        let length = block.len() as u16;
        stream.extend(length.to_le_bytes());
        stream.extend((!length).to_le_bytes());
        stream.extend(block);
    }
    let (low, high) = bytes.iter().fold((1u32, 0u32), |(low, high), byte| {
        let low = (low + u32::from(*byte)) % 65_521;
        (low, (high + low) % 65_521)
    });
    stream.extend((high << 16 | low).to_be_bytes());
    stream
}

/// CRC-32 of a chunk (annex D of the specification).
fn crc_32(bytes: &[u8]) -> u32 {
    let step = |crc: u32, _| if crc & 1 == 1 { 0xedb8_8320 ^ (crc >> 1) } else { crc >> 1 };
    !bytes.iter().fold(u32::MAX, |crc, byte| (0..8).fold(crc ^ u32::from(*byte), step))
}

const DIGITS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";

fn base_64(bytes: &[u8]) -> String {
    let mut text = String::with_capacity(bytes.len().div_ceil(3) * 4);
    for three in bytes.chunks(3) {
        let bits =
            three.iter().fold(0u32, |bits, byte| bits << 8 | u32::from(*byte)) << (8 * (3 - three.len()));
        for i in 0..4 {
            let digit = DIGITS[(bits >> (18 - 6 * i) & 63) as usize];
            text.push(if i <= three.len() { char::from(digit) } else { '=' });
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use std::io::Read;

    use super::*;

    /// RFC 4648, section 10.
    #[test]
    fn base_64_is_that_of_the_standard() {
        let words = ["", "f", "fo", "foo", "foob", "fooba", "foobar"];
        let texts = ["", "Zg==", "Zm8=", "Zm9v", "Zm9vYg==", "Zm9vYmE=", "Zm9vYmFy"];
        assert_eq!(words.map(|word| base_64(word.as_bytes())), texts);
    }

    /// The check value of CRC-32, and the empty last chunk of every PNG.
    #[test]
    fn checksums_are_those_of_the_standard() {
        assert_eq!(crc_32(b"123456789"), 0xcbf4_3926);
        assert_eq!(crc_32(b"IEND"), 0xae42_6082);
    }

    #[test]
    fn what_is_stored_comes_back() {
        for length in [0, 1, 65_535, 65_536, 200_000] {
            let bytes: Vec<u8> = (0..length).map(|i| (i * 7 % 251) as u8).collect();
            let mut back = Vec::new();
            let stream = stored(&bytes);
            if length > 0 {
                flate2::read::ZlibDecoder::new(stream.as_slice()).read_to_end(&mut back).unwrap();
            }
            assert_eq!(back, bytes);
        }
    }

    #[test]
    fn cells_become_the_colours_of_their_values() {
        let (picture, range) = Picture::of(&[Some(1.0), None, Some(3.0), Some(2.0)], 2, &HEIGHTS);
        assert_eq!(range, [1.0, 3.0]);
        assert!(picture.data_url().starts_with("data:image/png;base64,iVBORw0KGgo"));
        let bytes = png(&[1, 0, 255, 128], 2, &HEIGHTS);
        assert_eq!(picture.0, base_64(&bytes));
        assert_eq!(bytes[16..29], [0, 0, 0, 2, 0, 0, 0, 2, 8, 3, 0, 0, 0]);
        assert_eq!((mixed(&HEIGHTS, 0), mixed(&HEIGHTS, 254)), (HEIGHTS[0], HEIGHTS[5]));
        assert_eq!(css(&HEIGHTS)[0], "#3e3682");
        let (_, range) = Picture::of(&[None, Some(5.0)], 2, &HEIGHTS);
        assert_eq!(range, [5.0, 5.0]);
    }

    #[test]
    fn colours_become_lighter_at_every_step() {
        for ramp in [&HEIGHTS, &INTENSITIES] {
            let lightness = |i| {
                mixed(ramp, i)
                    .iter()
                    .zip([0.2126, 0.7152, 0.0722])
                    .map(|(&c, w)| f64::from(c) * w)
                    .sum::<f64>()
            };
            assert!((1..255).all(|i| lightness(i) >= lightness(i - 1) - 0.6), "apart from rounding");
        }
    }

    #[test]
    fn what_is_no_picture_is_refused() {
        let read = |text: &str| serde_json::from_str::<Picture>(text).map(|_| ()).map_err(|e| e.to_string());
        assert_eq!(read("\"iVBOR+/=\""), Ok(()));
        assert_eq!(read("\"\\\"><script>\""), Err("a picture must be in base 64".to_owned()));
    }
}

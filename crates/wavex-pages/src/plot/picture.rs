//! PNG images of coloured cells.

use base64::prelude::{BASE64_STANDARD, Engine};
use png::{BitDepth, ColorType, Encoder, EncodingError};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// PNG image in base64, with 256 colours: the first is transparent.
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
        match BASE64_STANDARD.decode(&text) {
            Ok(_) => Ok(Picture(text)),
            Err(_) => Err("a picture must be in base64"),
        }
    }
}

/// Equally spaced colours, interpolated linearly.
pub(crate) type Ramp = [[u8; 3]; 6];

/// Heights from low to high: blue, green, yellow.
///
/// Lightness increases at every step, so that they can be distinguished in grey. Both ends are
/// visible on white and on black.
pub(crate) const HEIGHTS: Ramp =
    [[62, 54, 130], [48, 98, 146], [34, 138, 141], [62, 172, 112], [142, 200, 66], [226, 205, 38]];
/// Intensities from weak to strong: greys.
pub(crate) const INTENSITIES: Ramp =
    [[52, 52, 54], [86, 86, 88], [120, 120, 121], [154, 154, 154], [188, 188, 186], [222, 222, 218]];

/// Fraction of the cells beyond either end of the colours.
const BEYOND: f64 = 0.01;

impl Picture {
    /// Converts rows of cells from the top to colours from `low` to `high`.
    pub(crate) fn within(
        cells: &[Option<f64>],
        columns: usize,
        ramp: &Ramp,
        [low, high]: [f64; 2],
    ) -> Picture {
        // The cast saturates.
        let level = |value: f64| {
            1 + (254.0 * (value.min(high).max(low) - low) / (high - low).max(1e-9)).round() as u8
        };
        let levels: Vec<u8> = cells.iter().map(|cell| cell.map_or(0, level)).collect();
        // Encoding into memory cannot fail: there is at least one cell.
        let file = encoded(&levels, columns, ramp).unwrap_or_default();
        Picture(BASE64_STANDARD.encode(file))
    }

    /// Converts rows of cells from the top to colours; also returns the values of the first and
    /// last colour.
    pub(crate) fn of(cells: &[Option<f64>], columns: usize, ramp: &Ramp) -> (Picture, [f64; 2]) {
        let mut known: Vec<f64> = cells.iter().flatten().copied().collect();
        known.sort_by(f64::total_cmp);
        let at = |part: f64| known.get((part * known.len().saturating_sub(1) as f64).round() as usize);
        let range = [BEYOND, 1.0 - BEYOND].map(|part| at(part).copied().unwrap_or(0.0));
        (Picture::within(cells, columns, ramp, range), range)
    }

    /// The image as a file.
    pub(crate) fn png(&self) -> Vec<u8> {
        BASE64_STANDARD.decode(&self.0).unwrap_or_default()
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

/// PNG file with one colour index per cell.
fn encoded(levels: &[u8], columns: usize, ramp: &Ramp) -> Result<Vec<u8>, EncodingError> {
    let columns = columns.max(1);
    let palette: Vec<u8> = [[0; 3]].into_iter().chain((0..255).map(|i| mixed(ramp, i))).flatten().collect();
    let mut file = Vec::new();
    let mut encoder = Encoder::new(&mut file, columns as u32, (levels.len() / columns) as u32);
    encoder.set_color(ColorType::Indexed);
    encoder.set_depth(BitDepth::Eight);
    encoder.set_palette(palette);
    encoder.set_trns(&[0][..]);
    let mut writer = encoder.write_header()?;
    writer.write_image_data(levels)?;
    writer.finish()?;
    Ok(file)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_become_the_colours_of_their_values() {
        let (picture, range) = Picture::of(&[Some(1.0), None, Some(3.0), Some(2.0)], 2, &HEIGHTS);
        assert_eq!(range, [1.0, 3.0]);
        let url = picture.data_url();
        let file = BASE64_STANDARD.decode(url.strip_prefix("data:image/png;base64,").unwrap()).unwrap();
        let mut image = png::Decoder::new(std::io::Cursor::new(file)).read_info().unwrap();
        let mut levels = vec![0; image.output_buffer_size().unwrap()];
        image.next_frame(&mut levels).unwrap();
        assert_eq!(levels, [1, 0, 255, 128]);
        let info = image.info();
        assert_eq!((info.width, info.height, info.trns.as_deref()), (2, 2, Some(&[0][..])));
        let palette = info.palette.as_deref().unwrap();
        assert_eq!((&palette[3..6], &palette[765..]), (&HEIGHTS[0][..], &HEIGHTS[5][..]));
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
        assert_eq!(read("\"iVBOR+8=\""), Ok(()));
        assert_eq!(read("\"\\\"><script>\""), Err("a picture must be in base64".to_owned()));
    }
}

//! Ground points of an area in a temporary file.

use std::io;
use std::path::Path;

use wavex_ground::point::CloudPoint;

use super::spool::{Spool, SpoolBuffers};

/// Edge of the squares by which points are stored, m.
pub const SQUARE_M: f64 = 128.0;
/// Bytes of a point: position, SD of the height, strip.
const RECORD_BYTES: usize = 24 + 4 + 2;

/// East and north index of a square of [`SQUARE_M`].
pub type Square = [i64; 2];

/// Square of a position, m.
pub(super) fn square_of(position_m: &[f64]) -> Square {
    let index = |axis: usize| position_m.get(axis).map_or(0, |x| (x / SQUARE_M).floor() as i64);
    [index(0), index(1)]
}

/// Squares that meet a rectangle from `low` to `high`, m.
pub(super) fn squares_within(low: [f64; 2], high: [f64; 2]) -> impl Iterator<Item = Square> {
    let (from, to) = (square_of(&low), square_of(&high));
    (from[0]..=to[0]).flat_map(move |east| (from[1]..=to[1]).map(move |north| [east, north]))
}

/// Ground points of an area: positions, SDs of their heights and strips.
pub struct GroundPoints {
    spool: Spool<Square>,
}

impl GroundPoints {
    /// No points; the temporary file is in `folder` and ends with this.
    ///
    /// # Errors
    /// The file cannot be created.
    pub fn new(folder: &Path) -> io::Result<GroundPoints> {
        Ok(GroundPoints { spool: Spool::new(folder, RECORD_BYTES)? })
    }

    /// Adds a point; points without a position are left out.
    ///
    /// # Errors
    /// The temporary file cannot be written.
    pub fn push(&self, buffers: &mut SpoolBuffers<Square>, point: &CloudPoint) -> io::Result<()> {
        if !point.position_m.iter().all(|x| x.is_finite()) {
            return Ok(());
        }
        let mut record = [0; RECORD_BYTES];
        for (bytes, value) in record.chunks_exact_mut(8).zip(point.position_m) {
            bytes.copy_from_slice(&value.to_le_bytes());
        }
        record[24..28].copy_from_slice(&point.height_sd_m.to_le_bytes());
        record[28..].copy_from_slice(&point.strip.to_le_bytes());
        buffers.push(&self.spool, square_of(&point.position_m), &record)
    }

    /// Writes the points that are still in `buffers`.
    ///
    /// # Errors
    /// The temporary file cannot be written.
    pub fn flush(&self, buffers: &mut SpoolBuffers<Square>) -> io::Result<()> {
        buffers.flush(&self.spool)
    }

    /// Squares with points, in ascending order.
    pub fn squares(&self) -> Vec<Square> {
        self.spool.keys()
    }

    /// Gives all points of a square; returns their number.
    ///
    /// # Errors
    /// The temporary file cannot be read.
    pub(super) fn each(&self, square: Square, mut each: impl FnMut(CloudPoint)) -> io::Result<usize> {
        let mut n = 0;
        self.spool.read(square, |record| {
            n += 1;
            point(record).into_iter().for_each(&mut each);
        })?;
        Ok(n)
    }

    /// Points from `low` to `high`, m, in an order that depends on the points alone.
    ///
    /// # Errors
    /// The temporary file cannot be read.
    pub fn within(&self, low: [f64; 2], high: [f64; 2]) -> io::Result<Vec<CloudPoint>> {
        let mut points = Vec::new();
        let is_within = |p: &CloudPoint| (0..2).all(|i| (low[i]..=high[i]).contains(&p.position_m[i]));
        for square in squares_within(low, high) {
            self.spool.read(square, |record| points.extend(point(record).filter(is_within)))?;
        }
        points.sort_unstable_by(|a, b| {
            let by = |i: usize| a.position_m[i].total_cmp(&b.position_m[i]);
            let sd = a.height_sd_m.total_cmp(&b.height_sd_m);
            by(0).then_with(|| by(1)).then_with(|| by(2)).then(a.strip.cmp(&b.strip)).then(sd)
        });
        Ok(points)
    }
}

fn point(record: &[u8]) -> Option<CloudPoint> {
    let (places, rest) = record.split_at_checked(24)?;
    let (places, _) = places.as_chunks();
    let position_m = <[[u8; 8]; 3]>::try_from(places).ok()?.map(f64::from_le_bytes);
    let (sd, strip) = rest.split_first_chunk()?;
    let strip = u16::from_le_bytes(*strip.first_chunk()?);
    let height_sd_m = f32::from_le_bytes(*sd);
    Some(CloudPoint { height_sd_m, strip, ..CloudPoint::at(position_m) })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_of_a_rectangle_are_found_in_one_order() {
        let ground = GroundPoints::new(&std::env::temp_dir()).unwrap();
        let mut buffers = SpoolBuffers::default();
        let at = |x: f64, sd: f32, strip: u16| CloudPoint {
            height_sd_m: sd,
            strip,
            ..CloudPoint::at([x, -0.5, 7.25])
        };
        let points = [at(200.0, 0.5, 3), at(-1.0, 0.25, 65535), at(127.0, 0.125, 0), at(900.0, 1.0, 1)];
        for point in points.iter().chain([&CloudPoint::at([f64::NAN, 0.0, 0.0])]) {
            ground.push(&mut buffers, point).unwrap();
        }
        ground.flush(&mut buffers).unwrap();
        assert_eq!(ground.squares(), [[-1, -1], [0, -1], [1, -1], [7, -1]]);
        let found = ground.within([-1.0, -1.0], [200.0, 0.0]).unwrap();
        let expected = [points[1], points[2], points[0]];
        assert_eq!(format!("{found:?}"), format!("{expected:?}"));
    }
}

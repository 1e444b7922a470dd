//! Header fields that summarise all points.

use super::header::LasHeader;

/// Number of points and bounding box of a file.
#[derive(Debug)]
pub(super) struct PointTotals {
    pub(super) points: u64,
    by_return: [u64; 15],
    min: [i32; 3],
    max: [i32; 3],
}

impl PointTotals {
    pub(super) fn new() -> PointTotals {
        PointTotals { points: 0, by_return: [0; 15], min: [i32::MAX; 3], max: [i32::MIN; 3] }
    }

    /// Counts points by return number and extends the bounds.
    ///
    /// `ends` are the smallest and largest stored coordinates of each axis. Return number 0 has no
    /// count; numbers above `most_returns` count as that.
    pub(super) fn add(&mut self, ends: [(i32, i32); 3], return_numbers: &[u8], most_returns: u8) {
        self.points += return_numbers.len() as u64;
        for return_number in return_numbers {
            let column = usize::from((*return_number).min(most_returns)).checked_sub(1);
            if let Some(count) = column.and_then(|column| self.by_return.get_mut(column)) {
                *count += 1;
            }
        }
        for (axis, (least, largest)) in ends.into_iter().enumerate() {
            self.min[axis] = self.min[axis].min(least);
            self.max[axis] = self.max[axis].max(largest);
        }
    }

    /// Returns smallest and largest coordinates, in units of the coordinate system.
    ///
    /// Scales may be negative. Needs at least one point.
    pub(super) fn bounds(&self, header: &LasHeader) -> [[f64; 3]; 2] {
        let (one, other) = (header.coordinates(self.min), header.coordinates(self.max));
        let of = |choose: fn(f64, f64) -> f64| std::array::from_fn(|axis| choose(one[axis], other[axis]));
        [of(f64::min), of(f64::max)]
    }

    /// Stores the summary in the header; without points the bounding box is unchanged.
    pub(super) fn store(&self, header: &mut LasHeader) {
        (header.n_points, header.n_points_by_return) = (self.points, self.by_return);
        if self.points > 0 {
            [header.min, header.max] = self.bounds(header);
        }
    }
}

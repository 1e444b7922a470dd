//! Hillshade: brightness of a terrain that is lit from one side.

/// Brightness of cells from 1 to 255; 0: no data at the cell.
///
/// `heights` are finite or have no data, row by row from the north-west, `columns` in each row, with cells of `cell` in the same
/// unit. The light comes from `azimuth_rad` clockwise from north, `altitude_rad` above the horizon. Slopes are Horn's (1981,
/// *Proceedings of the IEEE* 69 (1)); cells next to an edge or to cells without data take these as level with
/// themselves.
pub fn hillshade(heights: &[f32], columns: usize, cell: f64, azimuth_rad: f64, altitude_rad: f64) -> Vec<u8> {
    let columns = columns.max(1);
    let rows = heights.len() / columns;
    let (sin_azimuth, cos_azimuth) = libm::sincos(azimuth_rad);
    let (sin_altitude, cos_altitude) = libm::sincos(altitude_rad);
    let light = [sin_azimuth * cos_altitude, cos_azimuth * cos_altitude, sin_altitude];
    let shade = |i: usize| {
        let height = heights.get(i).copied().filter(|height| height.is_finite());
        let Some(height) = height.filter(|_| i < rows * columns) else { return 0 };
        let (row, column) = (i / columns, i % columns);
        let at = |south: isize, east: isize| {
            let row = row.checked_add_signed(south).filter(|row| *row < rows);
            let column = column.checked_add_signed(east).filter(|column| *column < columns);
            let other = row.zip(column).and_then(|(row, column)| heights.get(row * columns + column));
            f64::from(other.copied().filter(|other| other.is_finite()).unwrap_or(height))
        };
        let across = |east: isize| at(-1, east) + 2.0 * at(0, east) + at(1, east);
        let along = |south: isize| at(south, -1) + 2.0 * at(south, 0) + at(south, 1);
        let to_east = (across(1) - across(-1)) / (8.0 * cell);
        let to_north = (along(-1) - along(1)) / (8.0 * cell);
        let normal = [-to_east, -to_north, 1.0];
        let length = (to_east * to_east + to_north * to_north + 1.0).sqrt();
        let cosine = normal.iter().zip(light).map(|(n, l)| n * l).sum::<f64>() / length;
        (1.0 + 254.0 * cosine.clamp(0.0, 1.0)).round() as u8
    };
    (0..heights.len()).map(shade).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    const NORTH_WEST_RAD: f64 = 1.75 * std::f64::consts::PI;
    const HIGH_RAD: f64 = 0.25 * std::f64::consts::PI;

    fn slope(per_east: f32, per_north: f32) -> Vec<f32> {
        (0..25u8).map(|i| per_east * f32::from(i % 5) - per_north * f32::from(i / 5)).collect()
    }

    /// Brightness of the middle of a slope with cells of 2 m, lit from the north-west.
    fn middle(heights: &[f32]) -> u8 {
        hillshade(heights, 5, 2.0, NORTH_WEST_RAD, HIGH_RAD)[12]
    }

    #[test]
    fn slopes_are_as_bright_as_they_face_the_light() {
        // 45 degrees down to the north-west: the light falls straight on it.
        let steep = 2f32.sqrt();
        assert_eq!(middle(&slope(steep, -steep)), 255);
        assert_eq!(middle(&slope(0.0, 0.0)), (1.0 + 254.0 * HIGH_RAD.sin()).round() as u8);
        assert_eq!(middle(&slope(-2.0 * steep, 2.0 * steep)), 1);
        assert_eq!(middle(&slope(0.5, 0.5)), middle(&slope(-0.5, -0.5)));
    }

    #[test]
    fn cells_without_data_are_dark_and_do_not_spread() {
        let mut heights = slope(0.0, 0.0);
        (heights[6], heights[7]) = (f32::NAN, f32::INFINITY);
        let shaded = hillshade(&heights, 5, 2.0, NORTH_WEST_RAD, HIGH_RAD);
        let level = shaded[24];
        assert!(shaded.iter().enumerate().all(|(i, s)| *s == if i == 6 || i == 7 { 0 } else { level }));
        assert_eq!(hillshade(&[1.0; 3], 0, 1.0, 0.0, 1.0).len(), 3);
        assert_eq!(hillshade(&[1.0; 5], 2, 1.0, 0.0, 1.0)[4], 0);
    }
}

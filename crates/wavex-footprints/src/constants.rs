//! Constants of [`super::ground`], printed by `tests/python/fit_ground.py`.

use super::measured::GROUND_FEATURES;

/// Factors of the features: scores of the three parts, logarithms of SD, distance and SD of the second candidate, m.
#[rustfmt::skip]
pub(super) const OUTPUTS: [[f64; GROUND_FEATURES]; 6] = [
    [1.4227, 1.1206, -1.7826, -3.7688, 4.5090, -2.9348, 0.4649, -2.2360, -1.9151, 1.5197, -3.6503, 1.2712],
    [-0.5912, -0.8618, 1.5430, 1.7880, -2.3048, 0.8697, 0.2008, 0.9541, 0.2214, -0.6315, 1.2825, -0.2273],
    [-1.3315, -0.2588, 0.2396, 1.9809, -2.2042, 2.0651, -0.6658, 1.2819, 1.6937, -0.8882, 2.3678, -1.0439],
    [-2.7630, 3.9488, -3.4737, -6.1487, 6.1853, -0.0931, -0.0777, -0.1242, 0.2197, 0.0405, -0.2899, 0.1445],
    [3.3316, -0.1744, -0.2573, -0.0422, 0.1023, -4.2313, -0.0224, 0.8933, 1.1427, -0.3822, -2.5042, 2.5993],
    [0.7875, -0.2983, -0.4517, -0.1116, -0.2264, -2.1827, -0.1772, -0.3331, 0.3565, 0.8849, -0.5669, 1.2553],
];
/// Mean distance of grounds that the waveform does not show, m.
pub(super) const MISSED_M: f64 = 13.6402;
/// Stated SD over that of the normal distribution.
pub(super) const SD_FACTOR: f64 = 1.1104;
/// Log-odds that the mode is the ground: factors of the powers of those of the distribution.
pub(super) const CALIBRATION: [f64; 3] = [0.1517, 1.3434, -0.0872];

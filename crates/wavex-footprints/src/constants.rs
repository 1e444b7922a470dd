//! Constants of [`super::ground`], printed by `tests/python/fit_ground.py`.

use super::measured::GROUND_FEATURES;

/// Factors of the features: scores of the three parts; logarithms of SD, distance and SD of the second candidate, and mean distance
/// of a ground that is not shown, m.
#[rustfmt::skip]
pub(super) const OUTPUTS: [[f64; GROUND_FEATURES]; 7] = [
    [2.8301, 0.5019, -0.8749, -2.6907, 3.0676, -3.3174, 0.4286, -2.8049, -1.8733, 1.2792, -4.5259, 1.1983],
    [-0.6680, -0.3730, 0.7173, 1.8834, -1.2636, 1.9297, 0.2293, 1.1323, 0.1675, -1.5073, 1.7825, -0.8119],
    [-2.6621, -0.1289, 0.1575, 0.8074, -1.8040, 1.3877, -0.6579, 1.6726, 1.7058, 0.2281, 2.7434, -0.3864],
    [-2.4739, 2.8539, -2.5414, -6.3648, 6.5669, -0.2523, -0.0901, -0.2287, 0.1752, 0.0568, -0.5374, 0.1986],
    [2.1088, -0.1540, -0.1639, -0.0951, 0.1226, -6.2758, -0.0016, 2.0149, 1.1085, -0.3645, -1.4196, 2.6272],
    [0.0951, -0.1023, -0.4714, -0.0792, -0.0248, -2.9092, -0.0884, 0.1429, 0.1673, 0.6170, -0.0042, 1.0555],
    [5.4368, -0.4682, -0.3563, 0.3732, -0.1262, -0.7156, -0.3338, 0.2807, 1.2435, -1.2170, -0.8955, 0.5417],
];
/// Stated SD over that of the normal distribution.
pub(super) const SD_FACTOR: f64 = 1.1168;
/// Log-odds that the mode is the ground: factors of the powers of those of the distribution.
pub(super) const CALIBRATION: [f64; 3] = [0.0344, 1.3862, -0.0818];

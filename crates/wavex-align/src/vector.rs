//! Vectors of three components.

use wavex_geodesy::frames::Vector;

pub(crate) fn sum(a: Vector, b: Vector) -> Vector {
    core::array::from_fn(|axis| a[axis] + b[axis])
}

pub(crate) fn difference(a: Vector, b: Vector) -> Vector {
    core::array::from_fn(|axis| a[axis] - b[axis])
}

pub(crate) fn scaled(a: Vector, factor: f64) -> Vector {
    a.map(|part| part * factor)
}

pub(crate) fn dot(a: Vector, b: Vector) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

pub(crate) fn cross(a: Vector, b: Vector) -> Vector {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

pub(crate) fn length(a: Vector) -> f64 {
    dot(a, a).sqrt()
}

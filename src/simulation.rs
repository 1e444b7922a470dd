//! A lidar that exists only as numbers: what the stage `simulate` is made of.
//!
//! Each part stands by itself, so that another can take its place: the [`scanner`] says when each pulse leaves and at
//! which angle, the [`platform`] where the scanner is then and how it is turned, the [`scene`] what the pulse meets, the
//! [`detector`] how strong that comes out, the [`receiver`] what is recorded of it, the [`world`] where on the earth all
//! this takes place, and [`truth`] what a perfect evaluation would find.
//!
//! # The same bytes everywhere
//! Random numbers come from a generator of our own ([`random`]), started afresh for each shot from the seed, the scan
//! line and the shot's place in it: no line depends on another. Sines, exponentials, logarithms and error functions
//! come from the crate `libm`, never from `std`, whose results differ between platforms in the last bit. What else is
//! done with a number (`+ - * /`, square root, rounding) IEEE 754 defines to the bit.

pub mod detector;
pub mod noise;
pub mod platform;
pub mod pulse;
pub mod random;
pub mod receiver;
pub mod scanner;
pub mod scene;
pub mod truth;
pub mod world;

/// Speed of the pulse in the simulated air, m/s: as an instrument's file has said it.
pub const GROUP_VELOCITY_MPS: f64 = 299_710_540.0;

/// A number as the whole number below it and the rest, from 0 to below 1; its size is below 2^63. What `f64::floor` gives,
/// without the call that it costs where the instruction may be missing.
#[inline]
fn whole_and_part(x: f64) -> (i64, f64) {
    let towards_zero = x as i64;
    let whole = towards_zero - i64::from(x < towards_zero as f64);
    (whole, x - whole as f64)
}

/// The time from emission to echo at a range, ns.
pub fn time_of_flight_ns(range_m: f64) -> f64 {
    2e9 * range_m / GROUP_VELOCITY_MPS
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_number_is_its_whole_and_its_part() {
        for x in [0.0, 0.25, -0.25, -1.0, 7.0, -7.5, 1e15 + 0.5, -1e15 - 0.5, 5_300_000.1, -1e-300] {
            let (whole, part) = whole_and_part(x);
            assert_eq!((whole as f64, part), (x.floor(), x - x.floor()), "{x}");
        }
    }
}

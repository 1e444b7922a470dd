#![doc = include_str!("../README.md")]
#![warn(unreachable_pub)]

pub mod detector;
pub mod mta_scenes;
pub mod noise;
pub mod platform;
pub mod pulse;
pub mod random;
pub mod receiver;
pub mod scanner;
pub mod scene;
mod start;
pub mod truth;
pub mod world;

/// Group velocity of the pulse in the simulated air, m/s, from an instrument's file.
pub const GROUP_VELOCITY_MPS: f64 = 299_710_540.0;

/// Splits a number into floor and fractional part in [0, 1); its magnitude is below 2^63.
///
/// Same result as `f64::floor`, without the function call on processors that lack the instruction.
#[inline]
fn whole_and_part(x: f64) -> (i64, f64) {
    let towards_zero = x as i64;
    let whole = towards_zero - i64::from(x < towards_zero as f64);
    (whole, x - whole as f64)
}

/// Time of flight at a range, ns.
pub fn time_of_flight_ns(range_m: f64) -> f64 {
    2e9 * range_m / GROUP_VELOCITY_MPS
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn whole_and_part_add_up() {
        for x in [0.0, 0.25, -0.25, -1.0, 7.0, -7.5, 1e15 + 0.5, -1e15 - 0.5, 5_300_000.1, -1e-300] {
            let (whole, part) = whole_and_part(x);
            assert_eq!((whole as f64, part), (x.floor(), x - x.floor()), "{x}");
        }
    }
}

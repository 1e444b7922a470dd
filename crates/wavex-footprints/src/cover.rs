//! Cover and plant area index, by the definitions of GEDI02_B.

use wavex_simd::statistics::WithSd;

/// Part of the footprint that the canopy covers, seen along the beam.
///
/// From the ground's part of the energy, and the reflectance of the canopy over that of the ground.
pub fn cover(ground_energy_ratio: WithSd, reflectance_ratio: f64) -> WithSd {
    let of_canopy = 1.0 - ground_energy_ratio.value;
    let sum = of_canopy + reflectance_ratio * ground_energy_ratio.value;
    WithSd { value: of_canopy / sum, sd: reflectance_ratio / sum.powi(2) * ground_energy_ratio.sd }
}

/// Area of leaves and branches per area of ground, of leaves in random directions, half of which face the beam.
pub fn plant_area_index(cover: WithSd) -> WithSd {
    let gaps = 1.0 - cover.value;
    // The logarithm of 1 would give -0, which is printed.
    WithSd { value: 0.0 - 2.0 * libm::log(gaps), sd: 2.0 * cover.sd / gaps }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equal_reflectances_give_the_canopys_part_of_the_energy() {
        let ground = WithSd { value: 0.7, sd: 0.01 };
        let equal = cover(ground, 1.0);
        assert!((equal.value - 0.3).abs() < 1e-12 && (equal.sd - 0.01).abs() < 1e-12);
        assert!(cover(ground, 1.5).value < equal.value, "a bright canopy covers less");
        let index = plant_area_index(equal);
        assert!((index.value + 2.0 * 0.7f64.ln()).abs() < 1e-12 && (index.sd - 0.02 / 0.7).abs() < 1e-12);
        let bare = plant_area_index(cover(WithSd { value: 1.0, sd: 0.0 }, 1.5));
        assert_eq!(format!("{:.2}", bare.value), "0.00", "not -0.00");
    }
}

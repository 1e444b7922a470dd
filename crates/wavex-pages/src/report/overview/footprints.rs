//! Shots with large footprints: ground, canopy and sensitivity.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::histogram::{Bins, Quantity, QuantityHistogram};
use wavex_line::scan_line::{Footprint, ScanLine, footprint_flags};

/// Ground, canopy and sensitivity of the shots that `measure_footprints` has measured.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
pub struct Footprints {
    /// Number of shots.
    pub shots: u64,
    /// Shots without ground.
    pub ground_missing: u64,
    /// Shots whose ground has a probability below 0.9.
    pub ambiguous: u64,
    /// Shots whose signal begins before the first sample.
    pub top_missing: u64,
    /// Shots with clipped samples.
    pub clipped: u64,
    /// Shots against which the flags of the instrument advise.
    pub degraded: u64,
    /// Standard deviation and probability of the ground, RH50 and RH98, cover, sensitivity; those without known values are omitted.
    pub histograms: Vec<QuantityHistogram>,
}

/// Collects [`Footprints`] line by line.
#[derive(Clone, Debug)]
pub(super) struct FootprintCounts {
    shots: u64,
    /// Shots with each flag.
    flagged: [(u8, u64); 5],
    quantities: [Quantity<Footprint>; 6],
}

impl Default for FootprintCounts {
    fn default() -> FootprintCounts {
        let part = || Bins::linear(0.0, 0.02, 50);
        let height = || Bins::linear(-20.0, 1.0, 140);
        use footprint_flags::{AMBIGUOUS, CLIPPED, DEGRADED, GROUND_MISSING, TOP_MISSING};
        FootprintCounts {
            shots: 0,
            flagged: [GROUND_MISSING, AMBIGUOUS, TOP_MISSING, CLIPPED, DEGRADED].map(|flag| (flag, 0)),
            quantities: [
                Quantity::new(
                    "ground uncertainty",
                    "m",
                    |found| found.ground_range_m.sd,
                    Bins::logarithmic(),
                ),
                Quantity::new("ground probability", "", |found| found.ground_probability, part()),
                Quantity::new("RH50", "m", |found| found.heights_m[50].into(), height()),
                Quantity::new("RH98", "m", |found| found.heights_m[98].into(), height()),
                Quantity::new("cover", "", |found| found.cover.value, part()),
                // Most shots lie between 0.9 and 1.
                Quantity::new("sensitivity", "", |found| found.sensitivity, Bins::linear(0.0, 0.005, 200)),
            ],
        }
    }
}

impl FootprintCounts {
    pub(super) fn add(&mut self, line: &ScanLine) {
        self.shots += line.footprints.len() as u64;
        for found in &line.footprints {
            for (flag, count) in &mut self.flagged {
                *count += u64::from(found.flags & *flag != 0);
            }
            self.quantities.iter_mut().for_each(|quantity| quantity.add(found));
        }
    }

    /// Returns the counts; `None` without footprints.
    pub(super) fn finish(self) -> Option<Footprints> {
        let [ground_missing, ambiguous, top_missing, clipped, degraded] =
            self.flagged.map(|(_, count)| count);
        let histograms = self.quantities.into_iter();
        (self.shots > 0).then(|| Footprints {
            shots: self.shots,
            ground_missing,
            ambiguous,
            top_missing,
            clipped,
            degraded,
            histograms: histograms.filter_map(Quantity::finish).collect(),
        })
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;

    use wavex_line::scan_line::{Blocks, Emission, InputInfo};
    use wavex_simd::statistics::WithSd;

    fn shot(flags: u8, ground_probability: f64) -> Footprint {
        Footprint {
            emission: 0,
            shot_number: 0,
            ground_range_m: WithSd::UNKNOWN,
            ground_probability,
            ground_total_sd_m: f64::NAN,
            second_ground_height_m: WithSd::UNKNOWN,
            second_ground_probability: f64::NAN,
            ground_amplitude_dn: WithSd::UNKNOWN,
            ground_half_width_ratios: [1.0; 2],
            heights_m: Box::new([f32::NAN; 101]),
            heights_sd_m: Box::new([f32::NAN; 101]),
            modes: 1,
            energy_dn: WithSd::UNKNOWN,
            ground_energy_ratio: WithSd::UNKNOWN,
            cover: WithSd::UNKNOWN,
            plant_area_index: WithSd::UNKNOWN,
            sensitivity: 0.97,
            deviation: 0.0,
            flags,
            columns: Box::default(),
        }
    }

    #[test]
    fn flags_and_quantities_are_counted() {
        use footprint_flags::{AMBIGUOUS, DEGRADED, GROUND_MISSING};
        let info = Arc::new(InputInfo::default());
        let mut line = ScanLine::of_shots(info, 0, vec![Emission::default(); 3], Blocks::default());
        let mut counts = FootprintCounts::default();
        counts.add(&line);
        assert_eq!(counts.clone().finish(), None);
        line.footprints =
            vec![shot(0, 0.93), shot(AMBIGUOUS | DEGRADED, 0.4), shot(GROUND_MISSING, f64::NAN)];
        counts.add(&line);
        let found = counts.finish().unwrap();
        let Footprints { shots, ground_missing, ambiguous, top_missing, clipped, degraded, .. } = found;
        assert_eq!([shots, ground_missing, ambiguous, top_missing, clipped, degraded], [3, 1, 1, 0, 0, 1]);
        let of = |name: &str| found.histograms.iter().find(|of| of.quantity == name);
        assert_eq!(of("ground probability").map(QuantityHistogram::total), Some(2));
        assert_eq!(of("sensitivity").map(QuantityHistogram::total), Some(3));
        assert_eq!(of("RH98"), None, "no height is known");
    }
}

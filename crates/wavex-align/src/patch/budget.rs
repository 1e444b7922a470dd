//! Limit of the patches of many strips.

use super::{Patch, level};

/// Most patches of all strips together: 0.4 kB each during an alignment.
pub const MOST_TOGETHER: usize = 2_000_000;
/// Fewest patches that a strip may keep, whatever the number of strips.
pub const LEAST_OF_STRIP: usize = 1000;
/// Strips are thinned while they are added if they exceed the limit by this factor.
const SLACK: f64 = 1.25;

/// Patches of many strips within a limit of memory.
///
/// Strips with many patches are thinned to one number; those with fewer keep all. The result does not depend on the
/// order in which strips are added.
#[derive(Debug)]
pub struct PatchBudget {
    most: usize,
    /// Most patches of a strip so far.
    most_of_strip: usize,
    /// Patches of each strip in the order of keeping.
    strips: Vec<Vec<Patch>>,
    n_patches: usize,
}

impl Default for PatchBudget {
    fn default() -> PatchBudget {
        PatchBudget::new(MOST_TOGETHER)
    }
}

impl PatchBudget {
    /// For at most this many patches, or [`LEAST_OF_STRIP`] of each strip.
    pub fn new(most: usize) -> PatchBudget {
        PatchBudget { most, most_of_strip: usize::MAX, strips: Vec::new(), n_patches: 0 }
    }

    /// Most patches of each of this many strips.
    pub fn most_of(strips: usize) -> usize {
        (MOST_TOGETHER / strips.max(1)).max(LEAST_OF_STRIP)
    }

    /// Adds the next strip; its patches are in the order of keeping of [`PatchMaker`](super::PatchMaker).
    pub fn add(&mut self, mut patches: Vec<Patch>) {
        patches.truncate(self.most_of_strip);
        patches.shrink_to_fit();
        self.n_patches += patches.len();
        self.strips.push(patches);
        if self.n_patches as f64 > SLACK * self.most as f64 {
            self.thin();
        }
    }

    fn thin(&mut self) {
        let counts: Vec<usize> = self.strips.iter().map(Vec::len).collect();
        self.most_of_strip = self.most_of_strip.min(level(&counts, self.most).max(LEAST_OF_STRIP));
        for patches in &mut self.strips {
            if patches.len() > self.most_of_strip {
                patches.truncate(self.most_of_strip);
                patches.shrink_to_fit();
            }
        }
        self.n_patches = self.strips.iter().map(Vec::len).sum();
    }

    /// Patches with the indices of their strips, by strip and time, and the number of each strip.
    pub fn finish(mut self) -> (Vec<Patch>, Vec<usize>) {
        self.thin();
        let counts = self.strips.iter().map(Vec::len).collect();
        let mut all = Vec::with_capacity(self.n_patches);
        for (strip, mut patches) in (0..).zip(self.strips) {
            patches.sort_by(|a, b| a.beams[0].time_s.total_cmp(&b.beams[0].time_s));
            all.extend(patches.into_iter().map(|patch| Patch { strip, ..patch }));
        }
        (all, counts)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scanner::{BeamSource, ScannerBeam};

    /// Patches of a strip whose times are the reversed order of keeping.
    fn strip(n: usize) -> Vec<Patch> {
        let beam = |k: usize| ScannerBeam { time_s: (n - k) as f64, ..ScannerBeam::default() };
        let patch = |k: usize| Patch {
            strip: 0,
            n_returns: 8,
            source: BeamSource::default(),
            beams: [beam(k); 3],
            sd_m: 0.01,
            slope_sd: 0.01,
            roughness_m: 0.0,
        };
        (0..n).map(patch).collect()
    }

    fn counts(sizes: &[usize], most: usize) -> Vec<usize> {
        let mut budget = PatchBudget::new(most);
        for &size in sizes {
            budget.add(strip(size));
            assert!(budget.n_patches as f64 <= (SLACK * most as f64).max((1000 * sizes.len()) as f64));
        }
        let (patches, counts) = budget.finish();
        assert_eq!(patches.len(), counts.iter().sum::<usize>());
        assert!(patches.is_sorted_by_key(|patch| (patch.strip, patch.beams[0].time_s as u64)));
        for (index, (&size, &kept)) in sizes.iter().zip(&counts).enumerate() {
            // The first in the order of keeping have the latest times.
            let times = patches.iter().filter(|patch| patch.strip == index as u32);
            assert!(times.map(|patch| patch.beams[0].time_s as usize).eq(size - kept + 1..=size));
        }
        counts
    }

    #[test]
    fn large_strips_are_thinned_to_one_number() {
        assert_eq!(counts(&[3000, 500, 4000], 7500), [3000, 500, 4000]);
        assert_eq!(counts(&[3000, 500, 4000], 5500), [2500, 500, 2500]);
        assert_eq!(counts(&[3000, 500, 4000], 10), [1000, 500, 1000]);
    }

    #[test]
    fn order_of_strips_has_no_effect() {
        let sizes = [4000, 1500, 3000, 700, 5000, 2500, 1200];
        let sorted = |mut counts: Vec<usize>| {
            counts.sort_unstable();
            counts
        };
        let expected = [700, 1200, 1400, 1400, 1400, 1400, 1400];
        for turn in 0..sizes.len() {
            let mut turned = sizes;
            turned.rotate_left(turn);
            assert_eq!(sorted(counts(&turned, 8900)), expected, "{turn}");
        }
    }
}

//! Progress of a calibration.

use std::sync::atomic::{AtomicU64, Ordering};

/// Number of times that each block of a calibration is decomposed, on average.
const PASSES: u64 = 6;
/// Largest fraction of a calibration that has not ended: the number of passes is only expected.
const MOST: f64 = 0.99;

/// Part of a calibration that is done, shared between threads.
#[derive(Debug, Default)]
pub struct CalibrationProgress {
    decomposed: AtomicU64,
    /// Expected number; 0: no calibration is going on.
    expected: AtomicU64,
}

impl CalibrationProgress {
    /// Begins a calibration with this number of blocks.
    pub fn begin(&self, blocks: u64) {
        self.decomposed.store(0, Ordering::Relaxed);
        self.expected.store(PASSES * blocks, Ordering::Relaxed);
    }

    /// Counts decomposed blocks.
    pub(crate) fn add(&self, blocks: usize) {
        self.decomposed.fetch_add(blocks as u64, Ordering::Relaxed);
    }

    /// Ends the calibration.
    pub fn end(&self) {
        self.expected.store(0, Ordering::Relaxed);
    }

    /// Fraction done, 0 to 0.99; `None` if no calibration is going on.
    pub fn fraction(&self) -> Option<f64> {
        let expected = self.expected.load(Ordering::Relaxed);
        let decomposed = self.decomposed.load(Ordering::Relaxed);
        (expected > 0).then(|| (decomposed as f64 / expected as f64).min(MOST))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fraction_exists_during_a_calibration_only() {
        let progress = CalibrationProgress::default();
        assert_eq!(progress.fraction(), None);
        progress.begin(100);
        assert_eq!(progress.fraction(), Some(0.0));
        progress.add(150);
        assert_eq!(progress.fraction(), Some(0.25));
        progress.add(10_000);
        assert_eq!(progress.fraction(), Some(MOST));
        progress.end();
        assert_eq!(progress.fraction(), None);
    }
}

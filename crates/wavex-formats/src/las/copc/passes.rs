//! Progress of a conversion over all passes.

/// Receives the part done, 0 to 1.
pub type ProgressObserver<'a> = &'a mut dyn FnMut(f64);

/// Number of passes: bounds, sorting, writing.
const PASSES: u64 = 3;
/// Number of points between two reports.
const EVERY: u64 = 1 << 16;

/// Counts the points of all passes.
pub(super) struct Passes<'w> {
    /// Points of all passes, as the header declares them.
    expected: u64,
    counted: u64,
    watch: ProgressObserver<'w>,
}

impl<'w> Passes<'w> {
    pub(super) fn new(watch: ProgressObserver<'w>) -> Passes<'w> {
        Passes { expected: 1, counted: 0, watch }
    }

    /// Sets the number of points of one pass.
    pub(super) fn expect(&mut self, points: u64) {
        self.expected = points.saturating_mul(PASSES).max(1);
        (self.watch)(0.0);
    }

    /// Counts a point of a pass.
    pub(super) fn count(&mut self) {
        self.counted += 1;
        if self.counted.is_multiple_of(EVERY) {
            (self.watch)((self.counted as f64 / self.expected as f64).min(1.0));
        }
    }
}

//! Moments of a position over several hypotheses.

/// Probability-weighted moments of the position of an outgoing pulse.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Moments {
    pub(super) weight: f64,
    first: f64,
    second: f64,
}

impl Moments {
    pub(super) fn add(&mut self, weight: f64, place: f64, sd: f64) {
        self.weight += weight;
        self.first += weight * place;
        self.second += weight * (place * place + sd * sd);
    }

    pub(super) fn mean(&self) -> f64 {
        self.first / self.weight
    }

    pub(super) fn variance(&self) -> f64 {
        (self.second / self.weight - self.mean().powi(2)).max(0.0)
    }
}

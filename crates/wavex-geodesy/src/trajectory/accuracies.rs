//! Standard deviations over time.

use super::time_index::TimeIndex;
use super::{Accuracy, AccuracySample, TrajectoryError, index};

/// Accuracies over time.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Accuracies {
    index: TimeIndex,
    values: Vec<Accuracy>,
}

impl Accuracies {
    pub(super) fn new(samples: &[AccuracySample]) -> Result<Accuracies, TrajectoryError> {
        for (record, AccuracySample { time_s, accuracy }) in samples.iter().enumerate() {
            let [n, e, d] = accuracy.position_sd_m;
            let [roll, pitch, heading] = accuracy.attitude_sd_rad;
            let fields = [
                ("time", *time_s),
                ("standard deviation to the north", n),
                ("standard deviation to the east", e),
                ("standard deviation in height", d),
                ("standard deviation of the roll", roll),
                ("standard deviation of the pitch", pitch),
                ("standard deviation of the heading", heading),
            ];
            let is_bad =
                |&(field, value): &(&str, f64)| !value.is_finite() || (field != "time" && value < 0.0);
            if let Some((field, value)) = fields.into_iter().find(is_bad) {
                return Err(TrajectoryError::Implausible { record, field, value });
            }
        }
        let index = index(samples.iter().map(|sample| sample.time_s).collect())?;
        Ok(Accuracies { index, values: samples.iter().map(|sample| sample.accuracy).collect() })
    }

    pub(super) fn at(&self, time_s: f64) -> Option<Accuracy> {
        let before = self.index.before(time_s)?;
        let (times_s, a, b) = (self.index.times_s(), &self.values[before], &self.values[before + 1]);
        let part = (time_s - times_s[before]) / (times_s[before + 1] - times_s[before]);
        let between = |a: [f64; 3], b: [f64; 3]| core::array::from_fn(|k| a[k] + part * (b[k] - a[k]));
        Some(Accuracy {
            position_sd_m: between(a.position_sd_m, b.position_sd_m),
            attitude_sd_rad: between(a.attitude_sd_rad, b.attitude_sd_rad),
        })
    }
}

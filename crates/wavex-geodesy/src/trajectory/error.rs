//! Reasons why records are not a valid trajectory.

/// Reason why records are not a valid trajectory. Records count from 1 in messages, from 0 in
/// fields.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum TrajectoryError {
    /// Too few records to interpolate.
    #[error("{count} record(s): at least two are needed")]
    TooFew {
        /// Number of records.
        count: usize,
    },
    /// Too many records to index.
    #[error("{count} records: at most {} are supported", u32::MAX)]
    TooMany {
        /// Number of records.
        count: usize,
    },
    /// NaN, infinite, or a latitude beyond the poles.
    #[error("record {}: its {field} is {value}", record + 1)]
    Implausible {
        /// Index of the record.
        record: usize,
        /// Name of the field.
        field: &'static str,
        /// Value of the field.
        value: f64,
    },
    /// Times run backwards.
    #[error(
        "record {}: its time {time_s} s is before the {before_s} s of record {record}{}",
        record + 1,
        and_more(*more)
    )]
    Disorder {
        /// Index of the record that is out of order.
        record: usize,
        /// Time of the previous record, s.
        before_s: f64,
        /// Time of the record, s.
        time_s: f64,
        /// Number of further such records.
        more: usize,
    },
    /// Two records have the same time.
    #[error(
        "records {record} and {} have the same time {time_s} s{}",
        record + 1,
        and_more(*more)
    )]
    Duplicate {
        /// Index of the second record.
        record: usize,
        /// Time of both, s.
        time_s: f64,
        /// Number of further such records.
        more: usize,
    },
}

impl TrajectoryError {
    /// Index of the faulty record, if there is one.
    pub fn record(&self) -> Option<usize> {
        match *self {
            TrajectoryError::TooFew { .. } | TrajectoryError::TooMany { .. } => None,
            TrajectoryError::Implausible { record, .. }
            | TrajectoryError::Disorder { record, .. }
            | TrajectoryError::Duplicate { record, .. } => Some(record),
        }
    }

    /// Remedy for the user.
    pub fn remedy(&self) -> &'static str {
        match self {
            TrajectoryError::TooFew { .. } | TrajectoryError::Implausible { .. } => {
                "export it again from its source"
            }
            TrajectoryError::TooMany { .. } => "cut it into parts",
            TrajectoryError::Disorder { .. } => "sort its records by time",
            TrajectoryError::Duplicate { .. } => "keep one record of each time",
        }
    }
}

fn and_more(more: usize) -> String {
    if more == 0 { String::new() } else { format!(" (and {more} more like this)") }
}

//! The instrument's tables, as the job wants them.

use std::sync::Arc;

use super::{Correct, TableKey};
use crate::batch::{AmplitudeTable, InputInfo, ReturnChannel};
use crate::formats::lookup_tables::{LookupTables, Row};
use crate::kernels::decompose::OVERDRIVEN_PART;
use crate::kernels::penalised_spline::{Point, smooth};
use crate::kernels::sensor_model::{ChannelModel, SensorModel};
use crate::stage::{Result, StageError};

/// A correction of an echo's place beyond this is no number of seconds: 150 m.
const MOST_RANGE_CORRECTION_S: f64 = 1e-6;

/// Of the sensitive receiver, and of the one for strong echoes.
pub(super) type Both = [Option<Arc<AmplitudeTable>>; 2];

/// Which of two tables is that of a return.
pub(super) fn receiver_of(channel: ReturnChannel) -> usize {
    usize::from(channel != ReturnChannel::Low)
}

/// Where the tables of a run come from.
pub(super) struct Sources {
    range: Source,
    range_table_fit: bool,
    amplitude: Source,
}

/// Where the tables of one kind come from.
enum Source {
    Own,
    None,
    File([Vec<Row>; 2]),
}

impl Source {
    fn new(key: &TableKey, file: Option<LookupTables>) -> Source {
        match (key, file) {
            (_, Some(tables)) => Source::File([tables.low, tables.high]),
            (TableKey::Own(true), None) => Source::Own,
            _ => Source::None,
        }
    }

    /// The rows for a recording whose own tables these are.
    fn rows(&self, own: [&Option<AmplitudeTable>; 2]) -> [Vec<Row>; 2] {
        let of_table = |table: &Option<AmplitudeTable>| {
            let pairs = table.as_ref().map(AmplitudeTable::pairs).unwrap_or_default();
            pairs.iter().map(|&(steps_dn, value)| Row { steps_dn, value, weight: 1.0 }).collect()
        };
        match self {
            Source::Own => own.map(of_table),
            Source::None => Default::default(),
            Source::File(rows) => rows.clone(),
        }
    }
}

impl Sources {
    /// `range` and `amplitude` are the files' tables, where the keys name files.
    pub(super) fn new(
        keys: &Correct,
        range: Option<LookupTables>,
        amplitude: Option<LookupTables>,
    ) -> Result<Sources> {
        let rows = range.iter().flat_map(|tables| tables.low.iter().chain(&tables.high));
        let too_much = rows
            .map(|row| row.value)
            .find(|value| is_defined(*value) && value.abs() > MOST_RANGE_CORRECTION_S);
        match too_much {
            Some(value) => Err(StageError::failed(
                format!("the range table has {value:e} s, which is no correction of an echo's place"),
                "give its values in seconds",
            )),
            None => Ok(Sources {
                range: Source::new(&keys.range_table, range),
                range_table_fit: keys.range_table_fit,
                amplitude: Source::new(&keys.amplitude_table, amplitude),
            }),
        }
    }

    /// Whether tables of ranges, and of amplitudes, are wanted at all.
    pub(super) fn wanted(&self) -> [bool; 2] {
        [&self.range, &self.amplitude].map(|source| !matches!(source, Source::None))
    }

    /// The range tables, s by digitiser steps, for a recording.
    pub(super) fn range(&self, input: &InputInfo) -> Both {
        let rows = self.range.rows([&input.range_low, &input.range_high]);
        rows.map(|rows| table(if self.range_table_fit { smoothed(rows) } else { rows }))
    }

    /// The amplitude tables, dB by digitiser steps, for a recording.
    pub(super) fn amplitude(&self, input: &InputInfo) -> Both {
        self.amplitude.rows([&input.amplitude_low, &input.amplitude_high]).map(table)
    }
}

fn is_defined(value: f64) -> bool {
    value.is_finite() && value.abs() < 1e30
}

fn table(rows: Vec<Row>) -> Option<Arc<AmplitudeTable>> {
    AmplitudeTable::new(rows.into_iter().map(|row| (row.steps_dn, row.value))).map(Arc::new)
}

/// The table with its values on a smooth curve in the logarithm of the digitiser steps, of which there are none below 1.
fn smoothed(mut rows: Vec<Row>) -> Vec<Row> {
    rows.retain(|row| is_defined(row.value) && row.steps_dn >= 1.0 && row.steps_dn.is_finite());
    rows.sort_by(|a, b| a.steps_dn.total_cmp(&b.steps_dn));
    let point = |row: &Row| Point { x: row.steps_dn.ln(), y: row.value, weight: row.weight };
    let values = smooth(&rows.iter().map(point).collect::<Vec<Point>>());
    rows.iter().zip(values).map(|(row, value)| Row { value, ..*row }).collect()
}

/// By how much the range tables of the two receivers differ, s, where the sensitive one begins to be overdriven.
///
/// `fuse_channels` has moved the times of the other receiver so that both agree for such echoes as they are recorded; what
/// its table holds beyond that of the sensitive one there is in that move already.
pub(super) fn told_by_fusion_s(ranges: &Both, model: &SensorModel, gain_ratio: f64) -> f64 {
    let (Some(low), Some(high)) = (&model.low_power, &model.high_power) else { return 0.0 };
    let background_dn = |channel: &ChannelModel| channel.background_dn.iter().sum::<f64>() / 4.0;
    let height_dn = OVERDRIVEN_PART * low.full_scale_dn;
    let at = |table: &Option<Arc<AmplitudeTable>>, peak_dn: f64| {
        table.as_ref().map_or(0.0, |table| table.at(peak_dn))
    };
    at(&ranges[1], background_dn(high) + height_dn / gain_ratio)
        - at(&ranges[0], background_dn(low) + height_dn)
}

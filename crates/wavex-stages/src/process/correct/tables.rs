//! Selection of the range and amplitude tables.

use std::sync::Arc;

use super::{Correct, TableKey};
use wavex_formats::lookup_tables::{LookupRow, LookupTables};
use wavex_line::scan_line::{AmplitudeTable, InputInfo, ReturnChannel};
use wavex_line::stage::{Result, StageError};
use wavex_returns::penalised_spline::{DataPoint, smooth};
use wavex_signal::decompose::OVERDRIVEN_PART;
use wavex_signal::sensor_model::{ChannelModel, SensorModel};

/// Largest plausible range correction, s (150 m); larger values are not seconds.
const MOST_RANGE_CORRECTION_S: f64 = 1e-6;

/// Tables of the low-power and of the high-power receiver.
pub(super) type TwoTables = [Option<Arc<AmplitudeTable>>; 2];

/// Index of a return's table.
pub(super) fn receiver_of(channel: ReturnChannel) -> usize {
    usize::from(channel != ReturnChannel::Low)
}

/// Sources of the tables of a run.
pub(super) struct TableSources {
    range: TableSource,
    range_table_fit: bool,
    amplitude: TableSource,
}

/// Source of the tables of one kind.
enum TableSource {
    Own,
    None,
    File([Vec<LookupRow>; 2]),
}

impl TableSource {
    fn new(key: &TableKey, file: Option<LookupTables>) -> TableSource {
        match (key, file) {
            (_, Some(tables)) => TableSource::File([tables.low, tables.high]),
            (TableKey::Own(true), None) => TableSource::Own,
            _ => TableSource::None,
        }
    }

    /// Table rows; `own` are the tables of the recording.
    fn rows(&self, own: [&Option<AmplitudeTable>; 2]) -> [Vec<LookupRow>; 2] {
        let of_table = |table: &Option<AmplitudeTable>| {
            let pairs = table.as_ref().map(AmplitudeTable::pairs).unwrap_or_default();
            pairs.iter().map(|&(steps_dn, value)| LookupRow { steps_dn, value, weight: 1.0 }).collect()
        };
        match self {
            TableSource::Own => own.map(of_table),
            TableSource::None => Default::default(),
            TableSource::File(rows) => rows.clone(),
        }
    }
}

impl TableSources {
    /// `range` and `amplitude` are the tables of the files named by the keys.
    pub(super) fn new(
        keys: &Correct,
        range: Option<LookupTables>,
        amplitude: Option<LookupTables>,
    ) -> Result<TableSources> {
        let rows = range.iter().flat_map(|tables| tables.low.iter().chain(&tables.high));
        let too_much = rows
            .map(|row| row.value)
            .find(|value| is_defined(*value) && value.abs() > MOST_RANGE_CORRECTION_S);
        match too_much {
            Some(value) => Err(StageError::failed(
                format!("the range table has {value:e} s, which is too large for a range correction"),
                "give its values in seconds",
            )),
            None => Ok(TableSources {
                range: TableSource::new(&keys.range_table, range),
                range_table_fit: keys.range_table_fit,
                amplitude: TableSource::new(&keys.amplitude_table, amplitude),
            }),
        }
    }

    /// Whether range tables, and amplitude tables, are requested.
    pub(super) fn wanted(&self) -> [bool; 2] {
        [&self.range, &self.amplitude].map(|source| !matches!(source, TableSource::None))
    }

    /// Range tables of a recording, s by digitiser steps.
    pub(super) fn range(&self, input: &InputInfo) -> TwoTables {
        let rows = self.range.rows([&input.range_low, &input.range_high]);
        rows.map(|rows| table(if self.range_table_fit { smoothed(rows) } else { rows }))
    }

    /// Amplitude tables of a recording, dB by digitiser steps.
    pub(super) fn amplitude(&self, input: &InputInfo) -> TwoTables {
        self.amplitude.rows([&input.amplitude_low, &input.amplitude_high]).map(table)
    }
}

fn is_defined(value: f64) -> bool {
    value.is_finite() && value.abs() < 1e30
}

fn table(rows: Vec<LookupRow>) -> Option<Arc<AmplitudeTable>> {
    AmplitudeTable::new(rows.into_iter().map(|row| (row.steps_dn, row.value))).map(Arc::new)
}

/// Smooths the values over the logarithm of the digitiser steps; drops steps below 1.
fn smoothed(mut rows: Vec<LookupRow>) -> Vec<LookupRow> {
    rows.retain(|row| is_defined(row.value) && row.steps_dn >= 1.0 && row.steps_dn.is_finite());
    rows.sort_by(|a, b| a.steps_dn.total_cmp(&b.steps_dn));
    let point = |row: &LookupRow| DataPoint { x: row.steps_dn.ln(), y: row.value, weight: row.weight };
    let values = smooth(&rows.iter().map(point).collect::<Vec<DataPoint>>());
    rows.iter().zip(values).map(|(row, value)| LookupRow { value, ..*row }).collect()
}

/// Difference of the receivers' range tables, s, where the low-power receiver becomes overdriven.
///
/// `fuse_channels` has shifted the times of the high-power receiver so that both agree for such
/// echoes as recorded. That shift already contains the difference of the two tables there.
pub(super) fn delay_in_fusion_s(ranges: &TwoTables, model: &SensorModel, gain_ratio: f64) -> f64 {
    let (Some(low), Some(high)) = (&model.low_power, &model.high_power) else { return 0.0 };
    let background_dn = |channel: &ChannelModel| channel.background_dn.iter().sum::<f64>() / 4.0;
    let height_dn = OVERDRIVEN_PART * low.full_scale_dn;
    let at = |table: &Option<Arc<AmplitudeTable>>, peak_dn: f64| {
        table.as_ref().map_or(0.0, |table| table.at(peak_dn))
    };
    at(&ranges[1], background_dn(high) + height_dn / gain_ratio)
        - at(&ranges[0], background_dn(low) + height_dn)
}

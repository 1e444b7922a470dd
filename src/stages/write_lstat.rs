//! The statistics of scan lines, as text.

use std::io::Write;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use crate::batch::{Batch, Kind, LineStats};
use crate::formats::Error;
use crate::geo::time::adjusted_gps_time;
use crate::stage::{Config, Context, OutputFile, Result, Sink, SinkConfig, Site, StageSpec};

/// The stage's place in the registry.
pub const STAGE: StageSpec =
    StageSpec::sink::<WriteLstat>("write_lstat", &[Kind::Shots, Kind::Returns, Kind::Points]);

/// A column: its name, its value, and what it means.
struct Column(&'static str, Values, &'static str);

/// Where a column takes its value from.
enum Values {
    /// A counter.
    Count(fn(&LineStats) -> u64),
    /// Seconds, to a microsecond.
    Time,
    /// Metres, to a centimetre.
    Metres(fn(&LineStats) -> Option<f64>),
}

use Values::{Count, Metres, Time};

/// The columns of BayesWavEx 1.1 (section 3, stat files), in their order.
const COLUMNS: [Column; 20] = [
    Column(
        "gps_time",
        Time,
        "time of the line's first shot, s: adjusted GPS time where the input tells enough, else as the input has it",
    ),
    Column("nw", Count(|stats| stats.nw), "waveforms: shots with at least one echo block"),
    Column("np", Count(|stats| stats.np), "returns kept, withheld ones included"),
    Column("np_xtalk", Count(|stats| stats.np_xtalk), "returns touched by the emission's cross-talk"),
    Column("np_filtered", Count(|stats| stats.np_filtered), "candidates rejected by a threshold"),
    Column("np_merged", Count(|stats| stats.np_merged), "candidates merged with another"),
    Column("np_air", Count(|stats| stats.np_air), "outliers above their neighbours"),
    Column("np_low", Count(|stats| stats.np_low), "outliers below their neighbours"),
    Column("np_range", Count(|stats| stats.np_range), "returns whose intensity was corrected for range"),
    Column("np_atm", Count(|stats| stats.np_atm), "returns whose intensity was corrected for the atmosphere"),
    Column("np_ibrc", Count(|stats| stats.np_ibrc), "returns whose range was corrected by amplitude"),
    Column(
        "np_ibic",
        Count(|stats| stats.np_ibic),
        "returns whose amplitude was corrected by the instrument's table",
    ),
    Column("nw_empty", Count(|stats| stats.nw_empty), "waveforms without any return"),
    Column("nw_saturated", Count(|stats| stats.nw_saturated), "waveforms with saturated samples"),
    Column("nw_refined1x", Count(|stats| stats.nw_refined1x), "waveforms that needed iterative refinement"),
    Column("nw_refined2x", Count(|stats| stats.nw_refined2x), "waveforms that needed a second one"),
    Column("nw_deleted", Count(|stats| stats.nw_deleted), "waveforms that could not be used"),
    Column(
        "nw_truncated",
        Count(|stats| stats.nw_truncated),
        "waveforms with a return cut off by the block's edge",
    ),
    Column("n_georef", Count(|stats| stats.n_georef), "points with coordinates"),
    Column("AGL", Metres(|stats| stats.agl_m), "height above the line's own ground, m"),
];

/// Writes the counters of every scan line as text.
///
/// One row per line, separated by blanks, after a first line that begins with `#` and names the 20 columns of
/// BayesWavEx 1.1.
///
/// `gps_time` is that of the line's first shot: adjusted GPS time, as in the LAS file, where the input tells enough, else
/// as the input has it. `np...` count returns, `nw...` waveforms. `AGL` is the height above ground in metres. What is not
/// known is `nan`.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct WriteLstat {
    /// The file; `*` is the input's stem.
    pub path: String,
    /// Name the columns in a first line that begins with `#`.
    pub header: bool,
}

impl Default for WriteLstat {
    fn default() -> WriteLstat {
        WriteLstat { path: "*_lstat.txt".into(), header: true }
    }
}

impl Config for WriteLstat {}

impl SinkConfig for WriteLstat {
    fn outputs(&self) -> Vec<&str> {
        vec![&self.path]
    }

    fn make(&self, site: &Site) -> Result<Box<dyn Sink>> {
        let mut file = site.create(&self.path)?;
        if self.header {
            writeln!(file, "# {}", COLUMNS.each_ref().map(|column| column.0).join(" "))
                .map_err(Error::io(&site.output_path(&self.path), "write"))?;
        }
        Ok(Box::new(LstatWriter { file }))
    }
}

struct LstatWriter {
    file: OutputFile,
}

impl Sink for LstatWriter {
    fn write(&mut self, batch: &Batch, _cx: &mut Context) -> Result<()> {
        let time = batch.stats.gps_time_s;
        let row = row(&batch.stats, adjusted_gps_time(&batch.input, time).unwrap_or(time));
        writeln!(self.file, "{row}").map_err(|error| Error::io(self.file.path(), "write")(error))?;
        Ok(())
    }

    fn finish(self: Box<Self>, cx: &mut Context) -> Result<()> {
        cx.keep(self.file.finish()?);
        Ok(())
    }
}

/// A line's row, in the order of [`COLUMNS`].
fn row(stats: &LineStats, gps_time_s: f64) -> String {
    let text = |column: &Column| match column.1 {
        Time => number(gps_time_s, 6),
        Count(count) => count(stats).to_string(),
        Metres(metres) => number(metres(stats).unwrap_or(f64::NAN), 2),
    };
    COLUMNS.each_ref().map(text).join(" ")
}

/// The file as JSON, for people and programs: what `schemas/lstat.json` holds.
pub fn description() -> Value {
    let column = |Column(name, values, meaning): &Column| {
        let kind = match values {
            Count(_) => "u64",
            Time | Metres(_) => "f64",
        };
        json!({"name": name, "type": kind, "nullable": kind == "f64", "meaning": meaning})
    };
    json!({
        "title": "wavex statistics of scan lines: the columns of BayesWavEx 1.1",
        "format": "text: columns separated by one blank, `nan` where something is not known; a first line that begins \
                   with `#` names the columns, unless the job leaves it out",
        "row": "one scan line, in order of time",
        "columns": COLUMNS.each_ref().map(column),
    })
}

fn number(value: f64, digits: usize) -> String {
    if value.is_nan() { "nan".into() } else { format!("{value:.digits$}") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_row_has_the_columns_in_their_order() {
        let stats = LineStats {
            nw: 1,
            np: 2,
            np_xtalk: 3,
            np_filtered: 4,
            np_merged: 5,
            np_air: 6,
            np_low: 7,
            np_range: 8,
            np_atm: 9,
            np_ibrc: 10,
            np_ibic: 11,
            nw_empty: 12,
            nw_saturated: 13,
            nw_refined1x: 14,
            nw_refined2x: 15,
            nw_deleted: 16,
            nw_truncated: 17,
            n_georef: 18,
            agl_m: Some(1500.0),
            ..LineStats::default()
        };
        let row = row(&stats, 101_238_765.25);
        assert_eq!(row, "101238765.250000 1 2 3 4 5 6 7 8 9 10 11 12 13 14 15 16 17 18 1500.00");
        assert_eq!(row.split(' ').count(), COLUMNS.len());
    }

    #[test]
    fn what_is_unknown_is_nan() {
        assert!(row(&LineStats::default(), f64::NAN).starts_with("nan 0 0 "));
        assert!(row(&LineStats::default(), 0.0).ends_with(" nan"));
    }
}

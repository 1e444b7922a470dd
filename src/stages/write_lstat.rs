//! The statistics of scan lines, as text.

use std::io::Write;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::batch::{Batch, Kind, LineStats};
use crate::formats::Error;
use crate::geo::time::adjusted_gps_time;
use crate::stage::{Config, Context, OutputFile, Result, Sink, SinkConfig, Site, StageSpec};

/// The stage's place in the registry.
pub const STAGE: StageSpec =
    StageSpec::sink::<WriteLstat>("write_lstat", &[Kind::Shots, Kind::Returns, Kind::Points]);

/// The columns of BayesWavEx 1.1 (section 3, stat files), in their order.
pub const COLUMNS: [&str; 20] = [
    "gps_time",
    "nw",
    "np",
    "np_xtalk",
    "np_filtered",
    "np_merged",
    "np_air",
    "np_low",
    "np_range",
    "np_atm",
    "np_ibrc",
    "np_ibic",
    "nw_empty",
    "nw_saturated",
    "nw_refined1x",
    "nw_refined2x",
    "nw_deleted",
    "nw_truncated",
    "n_georef",
    "AGL",
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
            writeln!(file, "# {}", COLUMNS.join(" "))
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
    let counts = [
        stats.nw,
        stats.np,
        stats.np_xtalk,
        stats.np_filtered,
        stats.np_merged,
        stats.np_air,
        stats.np_low,
        stats.np_range,
        stats.np_atm,
        stats.np_ibrc,
        stats.np_ibic,
        stats.nw_empty,
        stats.nw_saturated,
        stats.nw_refined1x,
        stats.nw_refined2x,
        stats.nw_deleted,
        stats.nw_truncated,
        stats.n_georef,
    ];
    let counts = counts.map(|count| count.to_string()).join(" ");
    format!("{} {counts} {}", number(gps_time_s, 6), number(stats.agl_m.unwrap_or(f64::NAN), 2))
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

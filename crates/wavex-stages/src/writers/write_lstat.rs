//! `write_lstat`: writes statistics of scan lines as text.

use std::io::Write;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use wavex_formats::Error;
use wavex_line::scan_line::{Kind, LineStats, Return, ScanLine, flags};
use wavex_line::stage::{Config, Context, OutputFile, Result, RunContext, Sink, SinkConfig, StageSpec};

/// Registry entry of the stage.
pub const STAGE: StageSpec =
    StageSpec::sink::<WriteLstat>("write_lstat", &[Kind::Shots, Kind::Returns, Kind::Points]);

/// A column: name, value and meaning.
struct StatColumn(&'static str, StatValue, &'static str);

/// Source of a column's value.
enum StatValue {
    /// A counter.
    Count(fn(&LineStats) -> u64),
    /// Number of iteratively refined returns.
    Refined,
    /// Time, s, to a microsecond.
    Time,
    /// Length, m, to a centimetre.
    Metres(fn(&LineStats) -> Option<f64>),
}

use StatValue::{Count, Metres, Refined, Time};

/// Columns of BayesWavEx 1.1 (section 3, stat files), in order.
const COLUMNS: [StatColumn; 20] = [
    StatColumn(
        "gps_time",
        Time,
        "time of the first shot of the line, s: adjusted GPS time if it can be derived from the input, else the time of the input",
    ),
    StatColumn("nw", Count(|stats| stats.nw), "waveforms: shots with at least one echo block"),
    StatColumn("np", Count(|stats| stats.np), "returns kept, including withheld ones"),
    StatColumn("np_xtalk", Count(|stats| stats.np_xtalk), "returns affected by cross-talk of the emission"),
    StatColumn(
        "np_filtered",
        Count(LineStats::np_filtered),
        "candidates rejected by a threshold, or without a peak of their own",
    ),
    StatColumn("np_merged", Count(|stats| stats.np_merged), "candidates merged with another"),
    StatColumn("np_air", Count(|stats| stats.np_air), "outliers above their neighbours"),
    StatColumn("np_low", Count(|stats| stats.np_low), "outliers below their neighbours"),
    StatColumn("np_range", Count(|stats| stats.np_range), "returns whose intensity was corrected for range"),
    StatColumn(
        "np_atm",
        Count(|stats| stats.np_atm),
        "returns whose intensity was corrected for the atmosphere",
    ),
    StatColumn("np_ibrc", Count(|stats| stats.np_ibrc), "returns whose range was corrected for amplitude"),
    StatColumn(
        "np_ibic",
        Count(|stats| stats.np_ibic),
        "returns whose amplitude was corrected with the instrument's table",
    ),
    StatColumn("nw_empty", Count(|stats| stats.nw_empty), "waveforms without any return"),
    StatColumn("nw_saturated", Count(|stats| stats.nw_saturated), "waveforms with saturated samples"),
    StatColumn(
        "nw_refined1x",
        Count(|stats| stats.nw_refined1x),
        "waveforms that needed iterative refinement",
    ),
    StatColumn("nw_refined2x", Count(|stats| stats.nw_refined2x), "waveforms that needed a second one"),
    StatColumn("nw_deleted", Count(|stats| stats.nw_deleted), "waveforms that could not be used"),
    StatColumn(
        "nw_truncated",
        Count(|stats| stats.nw_truncated),
        "waveforms with a return truncated by the edge of the block",
    ),
    StatColumn("n_georef", Count(|stats| stats.n_georef), "points with coordinates"),
    StatColumn("AGL", Metres(|stats| stats.agl_m), "height above the ground of the line, m"),
];

/// Columns of BayesWavEx 1.0 (section 2, scanline statistics file), in order.
///
/// In 1.0, all waveforms without a valid return count as empty.
const COLUMNS_1_0: [StatColumn; 11] = [
    StatColumn("gps_time", Time, "as in layout 1.1"),
    StatColumn("n_waveforms", Count(|stats| stats.nw), "nw"),
    StatColumn("n_points", Count(|stats| stats.np), "np"),
    StatColumn("n_empty", Count(|stats| stats.nw_empty + stats.nw_deleted), "nw_empty + nw_deleted"),
    StatColumn("n_filtered", Count(LineStats::np_filtered), "np_filtered"),
    StatColumn("n_merged", Count(|stats| stats.np_merged), "np_merged"),
    StatColumn("n_refined", Refined, "iteratively refined returns"),
    StatColumn("n_air", Count(|stats| stats.np_air), "np_air"),
    StatColumn("n_low", Count(|stats| stats.np_low), "np_low"),
    StatColumn("n_range", Count(|stats| stats.np_range), "np_range"),
    StatColumn("n_atm", Count(|stats| stats.np_atm), "np_atm"),
];

/// Writes the counters of every scan line as text.
///
/// Each line is one row with columns separated by spaces. A header line starts with `#` and names
/// the columns: the 20 of BayesWavEx 1.1, or with `layout = "1.0"` the 11 of BayesWavEx 1.0,
/// `gps_time n_waveforms n_points n_empty n_filtered n_merged n_refined n_air n_low n_range n_atm`.
/// There, `n_empty` is `nw_empty + nw_deleted`, and `n_refined` counts returns.
///
/// `gps_time` is that of the first shot of the line: adjusted GPS time, as in the LAS file, if it
/// can be derived from the input, otherwise the time of the input. `np...` count returns, `nw...`
/// waveforms. `AGL` is the height above ground in metres, `nan` for recordings without the sensor
/// position. Unknown values are `nan`.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct WriteLstat {
    /// Output file; `*` is the input's stem.
    pub path: String,
    /// Write a header line that starts with `#` and names the columns.
    pub header: bool,
    /// BayesWavEx version that defines the columns.
    pub layout: StatLayout,
}

/// BayesWavEx version that defines the columns.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
pub enum StatLayout {
    /// 11 columns.
    #[serde(rename = "1.0")]
    V10,
    /// 20 columns.
    #[serde(rename = "1.1")]
    V11,
}

impl StatLayout {
    fn columns(self) -> &'static [StatColumn] {
        match self {
            StatLayout::V10 => &COLUMNS_1_0,
            StatLayout::V11 => &COLUMNS,
        }
    }
}

impl Default for WriteLstat {
    fn default() -> WriteLstat {
        WriteLstat { path: "*_lstat.txt".into(), header: true, layout: StatLayout::V11 }
    }
}

impl Config for WriteLstat {}

impl SinkConfig for WriteLstat {
    fn outputs(&self) -> Vec<&str> {
        vec![&self.path]
    }

    fn make(&self, run: &RunContext) -> Result<Box<dyn Sink>> {
        let mut file = run.create(&self.path)?;
        if self.header {
            let names: Vec<&str> = self.layout.columns().iter().map(|column| column.0).collect();
            writeln!(file, "# {}", names.join(" "))
                .map_err(Error::io(&run.output_path(&self.path), "write"))?;
        }
        Ok(Box::new(LstatWriter { file, columns: self.layout.columns() }))
    }
}

struct LstatWriter {
    file: OutputFile,
    columns: &'static [StatColumn],
}

impl Sink for LstatWriter {
    fn write(&mut self, scan_line: &ScanLine, _cx: &mut Context) -> Result<()> {
        let time = scan_line.stats.gps_time_s;
        let time = scan_line.input.adjusted_gps_time(time).unwrap_or(time);
        let refined = |found: &&Return| found.flags & flags::REFINED != 0;
        let n_refined = scan_line.returns().map_or(0, |returns| returns.iter().filter(refined).count());
        let row = row(self.columns, &scan_line.stats, time, n_refined as u64);
        writeln!(self.file, "{row}").map_err(|error| Error::io(self.file.path(), "write")(error))?;
        Ok(())
    }

    fn finish(self: Box<Self>, cx: &mut Context) -> Result<()> {
        cx.publish(self.file.finish()?);
        Ok(())
    }
}

/// Formats the row of a line.
fn row(columns: &[StatColumn], stats: &LineStats, gps_time_s: f64, n_refined: u64) -> String {
    let text = |column: &StatColumn| match column.1 {
        Time => number(gps_time_s, 6),
        Count(count) => count(stats).to_string(),
        Refined => n_refined.to_string(),
        Metres(metres) => number(metres(stats).unwrap_or(f64::NAN), 2),
    };
    columns.iter().map(text).collect::<Vec<String>>().join(" ")
}

/// Description of the file as JSON, stored in `schemas/lstat.json`.
pub fn description() -> Value {
    let column = |StatColumn(name, values, meaning): &StatColumn| {
        let kind = match values {
            Count(_) | Refined => "u64",
            Time | Metres(_) => "f64",
        };
        json!({"name": name, "type": kind, "nullable": kind == "f64", "meaning": meaning})
    };
    json!({
        "title": "wavex statistics of scan lines: the columns of BayesWavEx 1.1",
        "format": "text: columns separated by one space, `nan` for unknown values; a header line that starts \
                   with `#` names the columns, unless disabled by the job",
        "row": "one scan line, sorted by time",
        "columns": COLUMNS.each_ref().map(column),
        "columns_of_layout_1.0": COLUMNS_1_0.each_ref().map(column),
    })
}

fn number(value: f64, digits: usize) -> String {
    if value.is_nan() { "nan".into() } else { format!("{value:.digits$}") }
}

#[cfg(test)]
mod tests {
    use super::*;
    use wavex_line::scan_line::Filtered;
    use wavex_line::stage::Reason;

    fn four_filtered() -> Filtered {
        let mut filtered = Filtered::default();
        filtered.add(Reason::TooWeak, 3);
        filtered.add(Reason::TooWide, 1);
        filtered
    }

    /// A line whose counters all differ.
    fn stats() -> LineStats {
        LineStats {
            nw: 1,
            np: 2,
            np_xtalk: 3,
            filtered: four_filtered(),
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
        }
    }

    #[test]
    fn a_row_has_the_columns_in_their_order() {
        let row = |columns| row(columns, &stats(), 101_238_765.25, 19);
        assert_eq!(row(&COLUMNS), "101238765.250000 1 2 3 4 5 6 7 8 9 10 11 12 13 14 15 16 17 18 1500.00");
        assert_eq!(row(&COLUMNS_1_0), "101238765.250000 1 2 28 4 5 19 6 7 8 9");
    }

    /// The columns as printed in the documents of both versions.
    #[test]
    fn the_columns_are_those_of_the_documents() {
        let names =
            |columns: &[StatColumn]| columns.iter().map(|column| column.0).collect::<Vec<_>>().join(" ");
        assert_eq!(
            names(&COLUMNS),
            "gps_time nw np np_xtalk np_filtered np_merged np_air np_low np_range np_atm np_ibrc np_ibic \
             nw_empty nw_saturated nw_refined1x nw_refined2x nw_deleted nw_truncated n_georef AGL"
        );
        assert_eq!(
            names(&COLUMNS_1_0),
            "gps_time n_waveforms n_points n_empty n_filtered n_merged n_refined n_air n_low n_range n_atm"
        );
    }

    #[test]
    fn what_is_unknown_is_nan() {
        let row = |time| row(&COLUMNS, &LineStats::default(), time, 0);
        assert!(row(f64::NAN).starts_with("nan 0 0 "));
        assert!(row(0.0).ends_with(" nan"));
    }
}

//! `write_ascii`: writes points as columns of text.

use std::io::Write;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::writers::write_las::{WriteLas, offsets, point};
use wavex_formats::Error;
use wavex_line::keys::InvalidKey;
use wavex_line::scan_line::{InputInfo, Kind, ScanLine};
use wavex_line::stage::{Config, Context, OutputFile, Result, RunContext, Sink, SinkConfig, StageSpec};

mod columns;
mod steps;

use columns::{ATTRIBUTES, AsciiColumn, AsciiRow, attribute_steps, columns};
use steps::DecimalSteps;

/// Registry entry of the stage.
pub const STAGE: StageSpec =
    StageSpec::sink::<WriteAscii>("write_ascii", &[Kind::Points]).after(&["georeference"]);

/// Writes points as text, one row each.
///
/// `columns` selects the columns by the letters of LAStools' `-oparse`: `t` GPS time, `x` `y` `z`
/// coordinates, `X` `Y` `Z` coordinates in whole steps, `i` intensity, `r` return number, `n`
/// number of returns, `c` class, `u` user data, `a` scan angle, `e` edge of flight line, `d` scan
/// direction, `p` point source id, `h` withheld, `k` key point, `g` synthetic, `o` overlap, `l`
/// scanner channel. Digits select the extra attributes: `0` WideRatio, `1` TargetThick, `2` Amp,
/// `3` DevRatio, `4` RangeErr, `5` IntErr, `6` WideErr, `7` ThickErr, `8` Channel, `9` RawAmp.
///
/// Every value equals the one that `write_las` stores, with the number of decimals of its step.
/// Text and LAS therefore agree, and converting between them is lossless. Times have as many
/// decimals as needed to distinguish them.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct WriteAscii {
    /// Output file; `*` is the input's stem.
    pub path: String,
    /// The columns, one letter or digit each.
    pub columns: String,
    /// Column separator.
    pub separator: Separator,
    /// Write a header line with the column names.
    pub header: bool,
    /// Coordinate step, in units of the coordinate reference system. Defaults to that of
    /// `write_las`.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 1e-9, max = 1.0))]
    pub coordinate_step: Option<f64>,
}

/// Column separator.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Separator {
    /// A space.
    Space,
    /// A comma.
    Comma,
    /// A tab.
    Tab,
    /// A semicolon.
    Semicolon,
}

impl Separator {
    fn text(self) -> &'static str {
        match self {
            Separator::Space => " ",
            Separator::Comma => ",",
            Separator::Tab => "\t",
            Separator::Semicolon => ";",
        }
    }
}

impl Default for WriteAscii {
    fn default() -> WriteAscii {
        WriteAscii {
            path: "*.txt".into(),
            columns: "txyzi".into(),
            separator: Separator::Space,
            header: false,
            coordinate_step: None,
        }
    }
}

impl Config for WriteAscii {
    fn check(&self) -> std::result::Result<(), InvalidKey> {
        columns(&self.columns).map_err(|problem| InvalidKey::new("columns", problem)).map(drop)
    }
}

impl WriteAscii {
    /// The LAS sink whose values are written.
    fn as_las(&self) -> WriteLas {
        let mut las = WriteLas::default();
        las.coordinate_step = self.coordinate_step;
        las
    }
}

impl SinkConfig for WriteAscii {
    fn outputs(&self) -> Vec<&str> {
        vec![&self.path]
    }

    fn make(&self, run: &RunContext) -> Result<Box<dyn Sink>> {
        // The keys have already been checked.
        let columns = columns(&self.columns).unwrap_or_default();
        let separator = self.separator.text();
        let mut file = run.create(&self.path)?;
        if self.header {
            let names: Vec<&str> = columns.iter().map(|column| column.name).collect();
            writeln!(file, "{}", names.join(separator))
                .map_err(Error::io(&run.output_path(&self.path), "write"))?;
        }
        Ok(Box::new(AsciiWriter {
            config: self.clone(),
            columns,
            separator,
            file,
            steps: None,
            attribute_steps: attribute_steps(),
            text: String::new(),
            n_points: 0,
        }))
    }
}

struct AsciiWriter {
    config: WriteAscii,
    columns: Vec<&'static AsciiColumn>,
    separator: &'static str,
    file: OutputFile,
    /// Set with the first point.
    steps: Option<[DecimalSteps; 3]>,
    attribute_steps: [DecimalSteps; ATTRIBUTES.len()],
    /// Text of the rows of a line.
    text: String,
    n_points: u64,
}

impl AsciiWriter {
    fn steps(&mut self, input: &InputInfo, first: [f64; 3]) -> [DecimalSteps; 3] {
        *self.steps.get_or_insert_with(|| {
            let (step, offset) = (self.config.as_las().steps(input), offsets(input, Some(first)));
            std::array::from_fn(|axis| DecimalSteps::new(step[axis], offset[axis]))
        })
    }
}

impl Sink for AsciiWriter {
    fn write(&mut self, scan_line: &ScanLine, cx: &mut Context) -> Result<()> {
        let (Some(returns), Some(points)) = (scan_line.returns(), scan_line.points()) else {
            return Ok(());
        };
        let Some(first) = points.first() else { return Ok(()) };
        let steps = self.steps(&scan_line.input, *first);
        self.text.clear();
        for (found, position) in returns.iter().zip(points) {
            let emission = &scan_line.emissions[found.emission as usize];
            let point = point(&scan_line.input, emission, found, *position);
            let row =
                AsciiRow { point: &point, found, steps: &steps, attribute_steps: &self.attribute_steps };
            for (index, column) in self.columns.iter().enumerate() {
                self.text.push_str(if index == 0 { "" } else { self.separator });
                column.write(&row, &mut self.text);
            }
            self.text.push('\n');
        }
        self.n_points += points.len() as u64;
        self.file.write_all(self.text.as_bytes()).map_err(Error::io(self.file.path(), "write"))?;
        cx.observe("points_per_line", points.len() as f64);
        Ok(())
    }

    fn finish(self: Box<Self>, cx: &mut Context) -> Result<()> {
        if self.n_points == 0 {
            cx.warn("no points were found");
        }
        cx.publish(self.file.finish()?);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::Arc;
    use wavex_line::scan_line::{
        Blocks, Content, Emission, Return, ReturnChannel, TimeScale, emission_flags,
    };
    use wavex_simd::SimdLevel;

    /// Two points of one shot.
    fn line() -> ScanLine {
        let input = Arc::new(InputInfo { time_scale: TimeScale::Adjusted, ..InputInfo::default() });
        let emission = Emission {
            gps_time_s: 101_238_765.000_010_1,
            scan_angle_deg: -12.345,
            flags: emission_flags::EDGE_OF_FLIGHT_LINE,
            ..Emission::default()
        };
        let found = Return {
            intensity: 70_000.0,
            number_of_returns: 2,
            mta_zone: 3,
            flags: 0x81,
            ..Return::default()
        };
        let second = Return {
            return_number: 2,
            intensity: 12.5,
            channel: ReturnChannel::High,
            width_ratio: 1.26,
            thickness_m: 0.1,
            amplitude_dn: 41.4,
            range_sd_m: 0.0031,
            withheld: true,
            class: 20,
            ..found
        };
        let mut scan_line = ScanLine::of_shots(input, 0, vec![emission], Blocks::default());
        let points = vec![[540_123.456_7, 5_200_001.0, -0.000_2], [540_124.0, 5_200_001.999_6, f64::NAN]];
        scan_line.content = Content::Points(vec![found, second], points);
        scan_line
    }

    /// Text that a sink with these keys writes for the line.
    fn written(config: &WriteAscii) -> String {
        written_of(config, &[line()])
    }

    fn written_of(config: &WriteAscii, lines: &[ScanLine]) -> String {
        let folder = tempfile::tempdir().unwrap();
        let run = RunContext {
            input: "a.las".into(),
            stem: "a".into(),
            input_dir: folder.path().into(),
            output_dir: folder.path().into(),
            simd: SimdLevel::Portable,
            ..RunContext::alone("".as_ref())
        };
        let mut sink = config.make(&run).unwrap();
        let mut cx = Context::default();
        lines.iter().for_each(|line| sink.write(line, &mut cx).unwrap());
        sink.finish(&mut cx).unwrap();
        cx.take_files().pop().unwrap().publish().unwrap();
        std::fs::read_to_string(folder.path().join("a.txt")).unwrap()
    }

    fn with(columns: &str, separator: Separator, header: bool) -> WriteAscii {
        WriteAscii { columns: columns.into(), separator, header, ..WriteAscii::default() }
    }

    #[test]
    fn rows_hold_what_las_would() {
        assert_eq!(
            written(&WriteAscii::default()),
            "101238765.0000101 540123.457 5200001.000 0.000 65535\n\
             101238765.0000101 540124.000 5200002.000 nan 13\n"
        );
        assert_eq!(
            written(&with("rncuaedphkgolXYZ", Separator::Comma, false)),
            "1,2,0,129,-12.348,1,0,3,0,0,0,0,0,123457,1000,0\n\
             2,2,20,129,-12.348,1,0,3,1,0,0,0,1,124000,2000,NaN\n"
        );
    }

    #[test]
    fn a_header_names_the_columns_and_attributes_go_by_number() {
        assert_eq!(
            written(&with("i0123456789", Separator::Semicolon, true)),
            "intensity;WideRatio;TargetThick;Amp;DevRatio;RangeErr;IntErr;WideErr;ThickErr;Channel;RawAmp\n\
             65535;1.000;0.000;0;0.0;0.255;51.0;0.510;0.255;0;0\n\
             13;1.250;0.104;41;0.0;0.003;51.0;0.510;0.255;1;41\n"
        );
        assert!(written(&with("xy", Separator::Tab, true)).starts_with("x\ty\n540123.457\t"));
    }

    #[test]
    fn without_points_the_header_stands_all_the_same() {
        assert_eq!(written_of(&with("txy", Separator::Comma, true), &[]), "gps_time,x,y\n");
        assert_eq!(written_of(&with("txy", Separator::Comma, false), &[]), "");
    }

    #[test]
    fn a_step_of_coordinates_sets_their_decimals() {
        let config = WriteAscii { coordinate_step: Some(0.25), ..with("xz", Separator::Space, false) };
        assert_eq!(written(&config), "540123.50 0.00\n540124.00 nan\n");
        assert_eq!(with("txq", Separator::Space, false).check().unwrap_err().key, "columns");
    }
}

//! Index of the scan lines of a recording, and its file.
//!
//! The file is Arrow IPC with a row per scan line. The schema's metadata identify the recording
//! (sizes and times of its files), the keys of the reader, and the version of wavex. An index that
//! does not fit is made anew.

use std::collections::HashMap;
use std::fs;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::UNIX_EPOCH;

use arrow_array::cast::AsArray;
use arrow_array::types::{Float64Type, UInt32Type, UInt64Type};
use arrow_array::{ArrayRef, BooleanArray, Float64Array, RecordBatch, UInt32Array, UInt64Array};
use arrow_schema::{ArrowError, Schema};

use super::index_path;
use wavex_formats::Error;
use wavex_formats::container::{IpcWriter, TableReader};
use wavex_formats::format::companions;
use wavex_line::scan_line::ScanLine;
use wavex_line::stage::{Context, LineLocation, OutputFile, Result, RunContext, SourcePlan, StageError};

/// Called with the fraction of a recording that has been read; an error ends the reading.
pub type IndexObserver<'a> = dyn FnMut(f64) -> Result<()> + 'a;

/// Key of the metadata that identifies the recording.
const RECORDING_KEY: &str = "wavex.recording";
/// Smallest recording whose index is kept, bytes; the index of a smaller one is quickly made again.
const SMALLEST_KEPT_BYTES: u64 = 64 << 20;
const ROWS_PER_BATCH: usize = 1 << 16;

/// A scan line in an index.
#[derive(Clone, Debug, PartialEq)]
pub struct IndexedLine {
    /// Location in the recording.
    pub location: LineLocation,
    /// Number of shots; in PulseWaves, including pulses whose waves cannot be read.
    pub shots: u32,
    /// Smallest and largest shot number.
    pub shot_range: [u64; 2],
    /// Earliest and latest time, s; NaN if no shot has one.
    pub time_range_s: [f64; 2],
}

impl IndexedLine {
    /// Entry of a line; `None` for a line without shots.
    fn of(line: &ScanLine, location: LineLocation) -> Option<IndexedLine> {
        let numbers = || line.emissions.iter().map(|emission| emission.shot);
        let times_s = || line.emissions.iter().map(|emission| emission.gps_time_s);
        Some(IndexedLine {
            location,
            shots: u32::try_from(line.emissions.len()).ok()?,
            shot_range: [numbers().min()?, numbers().max()?],
            // `min` and `max` of floats return the number if the other is NaN.
            time_range_s: [times_s().fold(f64::NAN, f64::min), times_s().fold(f64::NAN, f64::max)],
        })
    }

    /// Distance of a time from the times of the line, s; `None` without times.
    fn distance_s(&self, time_s: f64) -> Option<f64> {
        let [first_s, last_s] = self.time_range_s;
        let distance_s = (first_s - time_s).max(time_s - last_s).max(0.0);
        (first_s.is_finite() && last_s.is_finite()).then_some(distance_s)
    }
}

/// The scan lines of a recording, in its order.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LineIndex {
    lines: Vec<IndexedLine>,
}

impl LineIndex {
    /// Reads the index of a recording, or makes it and keeps it next to a large one.
    pub(super) fn of_file(
        reader: &dyn SourcePlan,
        keys: &str,
        run: &RunContext,
        watch: &mut IndexObserver,
    ) -> Result<LineIndex> {
        let identity = identity(&run.input, keys);
        let path = index_path(&run.input);
        if let Some(index) = identity.as_ref().and_then(|identity| LineIndex::read(&path, identity)) {
            return Ok(index);
        }
        let index = LineIndex::make(reader, run, watch)?;
        let is_large = fs::metadata(&run.input).is_ok_and(|about| about.len() >= SMALLEST_KEPT_BYTES);
        if let (true, Some(identity)) = (is_large, identity) {
            // The folder may be read-only; the index is then made again by the next program.
            let _ = index.write(&path, &identity);
        }
        Ok(index)
    }

    /// Makes the index in one pass, without samples where the format permits.
    ///
    /// Ends with [`StageError::Stopped`] once the run is cancelled.
    fn make(reader: &dyn SourcePlan, run: &RunContext, watch: &mut IndexObserver) -> Result<LineIndex> {
        let mut source = reader.make_for_inspection(run, false)?;
        let (mut lines, mut cx) = (Vec::new(), Context::default());
        while let Some(line) = source.next(&mut cx)? {
            let Some(location) = source.location() else {
                let problem = format!("{}: scan lines cannot be read in any order", run.input.display());
                let remedy = "use a container in the file format of Arrow, or a reader without `time_s`";
                return Err(StageError::failed(problem, remedy));
            };
            lines.extend(IndexedLine::of(&line, location));
            if run.cancelled.load(Ordering::Relaxed) {
                return Err(StageError::Stopped);
            }
            watch(source.progress().unwrap_or_default())?;
        }
        Ok(LineIndex { lines })
    }

    /// All lines, in the order of the recording.
    pub fn lines(&self) -> &[IndexedLine] {
        &self.lines
    }

    /// Number of shots.
    pub fn shots(&self) -> u64 {
        self.lines.iter().map(|line| u64::from(line.shots)).sum()
    }

    /// Smallest and largest shot number; `None` without shots.
    pub fn shot_range(&self) -> Option<[u64; 2]> {
        let first = self.lines.iter().map(|line| line.shot_range[0]).min()?;
        Some([first, self.lines.iter().map(|line| line.shot_range[1]).max()?])
    }

    /// Earliest and latest time, s; `None` if no shot has one.
    pub fn time_range_s(&self) -> Option<[f64; 2]> {
        // `min` and `max` of floats return the number if the other is NaN.
        let first_s = self.lines.iter().map(|line| line.time_range_s[0]).fold(f64::NAN, f64::min);
        let last_s = self.lines.iter().map(|line| line.time_range_s[1]).fold(f64::NAN, f64::max);
        (first_s.is_finite() && last_s.is_finite()).then_some([first_s, last_s])
    }

    /// Positions of the lines that may contain a shot.
    pub fn of_shot(&self, shot: u64) -> impl Iterator<Item = usize> {
        let may_have = move |line: &IndexedLine| (line.shot_range[0]..=line.shot_range[1]).contains(&shot);
        (0..).zip(&self.lines).filter(move |(_, line)| may_have(line)).map(|(number, _)| number)
    }

    /// Distance of each line's times from a time, s, and its position, nearest first.
    ///
    /// Lines without times are left out.
    pub fn by_time(&self, time_s: f64) -> Vec<(f64, usize)> {
        let distance = |(number, line): (usize, &IndexedLine)| Some((line.distance_s(time_s)?, number));
        let mut lines: Vec<(f64, usize)> = self.lines.iter().enumerate().filter_map(distance).collect();
        lines.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        lines
    }

    fn write(&self, path: &Path, identity: &str) -> std::result::Result<(), Error> {
        let mut file = OutputFile::create(path)?;
        self.write_to(&mut file, identity).map_err(|error| unusable(path, &error))?;
        file.finish()?.publish().map(|_| ())
    }

    fn write_to(
        &self,
        file: &mut (impl std::io::Write + Send),
        identity: &str,
    ) -> std::result::Result<(), ArrowError> {
        let metadata = HashMap::from([(RECORDING_KEY.to_owned(), identity.to_owned())]);
        let schema = columns(&[])?.schema().as_ref().clone().with_metadata(metadata);
        let schema = Arc::new(schema);
        let mut writer = IpcWriter::file(file, Arc::clone(&schema), None)?;
        for lines in self.lines.chunks(ROWS_PER_BATCH) {
            let columns = columns(lines)?.columns().to_vec();
            writer.write(&RecordBatch::try_new(Arc::clone(&schema), columns)?)?;
        }
        writer.finish().map(|_| ())
    }

    /// Reads an index file; `None` if it is missing, damaged, or not of this recording.
    fn read(path: &Path, identity: &str) -> Option<LineIndex> {
        let mut table = TableReader::open(path).ok()?;
        let schema: &Schema = table.schema();
        if schema.metadata().get(RECORDING_KEY)? != identity {
            return None;
        }
        let mut lines = Vec::new();
        while let Some(batch) = table.next_batch().ok()? {
            lines.extend(lines_of(&batch)?);
        }
        Some(LineIndex { lines })
    }
}

/// Text of the keys of a reader that decide on its lines.
pub(super) fn keys_of(keys: &serde_json::Value) -> String {
    let mut keys = keys.clone();
    if let Some(keys) = keys.as_object_mut() {
        keys.remove("path");
    }
    keys.to_string()
}

/// Text that identifies a recording; `None` if its file has no size or time.
fn identity(recording: &Path, keys: &str) -> Option<String> {
    let of = |path: &Path| {
        let about = fs::metadata(path).ok().filter(fs::Metadata::is_file)?;
        let modified = about.modified().ok()?.duration_since(UNIX_EPOCH).ok()?;
        Some(format!("{} bytes, {} ns", about.len(), modified.as_nanos()))
    };
    let companions: Vec<String> = companions(recording).iter().filter_map(|path| of(path)).collect();
    let companions = companions.join(", ");
    Some(format!("wavex {}; {}; {companions}; {keys}", env!("CARGO_PKG_VERSION"), of(recording)?))
}

fn columns(lines: &[IndexedLine]) -> std::result::Result<RecordBatch, ArrowError> {
    let u64s =
        |of: fn(&IndexedLine) -> u64| -> ArrayRef { Arc::new(lines.iter().map(of).collect::<UInt64Array>()) };
    let u32s =
        |of: fn(&IndexedLine) -> u32| -> ArrayRef { Arc::new(lines.iter().map(of).collect::<UInt32Array>()) };
    let f64s = |of: fn(&IndexedLine) -> f64| -> ArrayRef {
        Arc::new(lines.iter().map(of).map(Some).collect::<Float64Array>())
    };
    let is_complete: BooleanArray = lines.iter().map(|line| Some(line.location.is_complete)).collect();
    RecordBatch::try_from_iter_with_nullable([
        ("first_record", u64s(|line| line.location.records.start), false),
        ("end_record", u64s(|line| line.location.records.end), false),
        ("first_shot", u64s(|line| line.location.first_shot), false),
        ("lowest_shot", u64s(|line| line.shot_range[0]), false),
        ("highest_shot", u64s(|line| line.shot_range[1]), false),
        ("row", u32s(|line| line.location.row), false),
        ("line", u32s(|line| line.location.line), false),
        ("shots", u32s(|line| line.shots), false),
        ("first_time_s", f64s(|line| line.time_range_s[0]), false),
        ("last_time_s", f64s(|line| line.time_range_s[1]), false),
        ("is_complete", Arc::new(is_complete), false),
    ])
}

/// Lines of a record batch; `None` if a column is missing or of another type, or a range is invalid.
fn lines_of(batch: &RecordBatch) -> Option<Vec<IndexedLine>> {
    let u64s = |name: &str| batch.column_by_name(name)?.as_primitive_opt::<UInt64Type>();
    let u32s = |name: &str| batch.column_by_name(name)?.as_primitive_opt::<UInt32Type>();
    let f64s = |name: &str| batch.column_by_name(name)?.as_primitive_opt::<Float64Type>();
    let (first_record, end_record) = (u64s("first_record")?, u64s("end_record")?);
    let (first_shot, lowest, highest) = (u64s("first_shot")?, u64s("lowest_shot")?, u64s("highest_shot")?);
    let (row, line, shots) = (u32s("row")?, u32s("line")?, u32s("shots")?);
    let (first_s, last_s) = (f64s("first_time_s")?, f64s("last_time_s")?);
    let is_complete = batch.column_by_name("is_complete")?.as_boolean_opt()?;
    let of_row = |i: usize| {
        let location = LineLocation {
            records: first_record.value(i)..end_record.value(i),
            row: row.value(i),
            line: line.value(i),
            first_shot: first_shot.value(i),
            is_complete: is_complete.value(i),
        };
        // A reader counts on from the numbers of the line and of its first shot.
        let may_count = location.line < u32::MAX && location.first_shot < u64::MAX >> 1;
        let is_valid = may_count && !location.records.is_empty() && lowest.value(i) <= highest.value(i);
        is_valid.then(|| IndexedLine {
            location,
            shots: shots.value(i),
            shot_range: [lowest.value(i), highest.value(i)],
            time_range_s: [first_s.value(i), last_s.value(i)],
        })
    };
    (0..batch.num_rows()).map(of_row).collect()
}

fn unusable(path: &Path, error: &ArrowError) -> Error {
    Error::unusable(path, error.to_string(), "please report this bug in wavex")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn line(line: u32, first_s: f64) -> IndexedLine {
        let start = u64::from(line) * 100;
        let location = LineLocation {
            records: start..start + 90,
            row: 7,
            line,
            first_shot: start,
            is_complete: line == 0,
        };
        IndexedLine {
            location,
            shots: 80,
            shot_range: [start, start + 79],
            time_range_s: [first_s, first_s + 1.0],
        }
    }

    #[test]
    fn an_index_comes_back_and_serves_only_its_recording() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.las.wvxi");
        let index =
            LineIndex { lines: (0..3).map(|number| line(number, 10.0 * f64::from(number))).collect() };
        index.write(&path, "64 bytes").unwrap();
        assert_eq!(LineIndex::read(&path, "64 bytes"), Some(index));
        assert_eq!(LineIndex::read(&path, "65 bytes"), None);
        let bytes = fs::read(&path).unwrap();
        fs::write(&path, &bytes[..bytes.len() / 2]).unwrap();
        assert_eq!(LineIndex::read(&path, "64 bytes"), None, "cut off");
        assert_eq!(LineIndex::read(&folder.path().join("none"), "64 bytes"), None);
    }

    #[test]
    fn an_index_with_impossible_numbers_is_not_used() {
        let read = |change: fn(&mut IndexedLine)| {
            let mut changed = line(1, 0.0);
            change(&mut changed);
            lines_of(&columns(&[line(0, 0.0), changed]).unwrap())
        };
        assert_eq!(read(|_| ()).map(|lines| lines.len()), Some(2));
        assert_eq!(read(|line| line.location.records = 5..5), None);
        assert_eq!(read(|line| line.shot_range = [2, 1]), None);
        assert_eq!(read(|line| line.location.line = u32::MAX), None);
        assert_eq!(read(|line| line.location.first_shot = u64::MAX), None);
        let batch = columns(&[line(0, 0.0)]).unwrap();
        for column in 0..batch.num_columns() {
            let mut without = batch.clone();
            without.remove_column(column);
            assert_eq!(lines_of(&without), None, "{}", batch.schema().field(column).name());
        }
    }

    #[test]
    fn lines_are_found_by_shots_and_times() {
        let without_times = IndexedLine { time_range_s: [f64::NAN; 2], ..line(1, 0.0) };
        let index = LineIndex { lines: vec![line(0, 10.0), without_times, line(2, 20.0)] };
        assert_eq!((index.shots(), index.shot_range()), (240, Some([0, 279])));
        assert_eq!(index.of_shot(150).collect::<Vec<_>>(), [1]);
        assert_eq!(index.of_shot(95).count(), 0, "between two lines");
        assert_eq!(index.by_time(18.5), [(1.5, 2), (7.5, 0)]);
        assert_eq!(index.by_time(10.5), [(0.0, 0), (9.5, 2)]);
        assert_eq!(LineIndex::default().shot_range(), None);
    }
}

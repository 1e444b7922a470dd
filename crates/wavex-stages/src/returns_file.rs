//! Returns files: decomposed scan lines, from which a run can start (Arrow IPC).
//!
//! One row is a scan line, with lists of its shots, returns and profiles; `columns` has their fields. Shots have the
//! beams of the recording, before poses, so that a later run can apply other poses. A record batch has at most
//! `LINES_PER_BATCH` lines. The metadata of the schema are
//!
//! | key | value |
//! |---|---|
//! | `wavex.returns` | version of the layout: 1 |
//! | `wavex.version` | version of wavex |
//! | `wavex.settings` | stages before the file with their keys (JSON); of files that they read, the BLAKE3 digest |
//! | `wavex.recording` | digest of the recording ([`recording_digest`]) |
//! | `wavex.filtered` | reasons of the column `filtered` (JSON) |
//! | `wavex.input` | metadata of the recording (JSON); absent without lines |
//! | `wavex.model`, `wavex.fusion` | sensor model, fusion of the receivers (JSON), if any |

use std::collections::HashMap;
use std::path::Path;
use std::sync::Arc;

use arrow_array::cast::AsArray;
use arrow_array::types::{Float64Type, UInt32Type, UInt64Type};
use arrow_array::{
    Array, ArrayRef, FixedSizeListArray, Float64Array, ListArray, RecordBatch, StructArray, UInt32Array,
    UInt64Array,
};
use arrow_buffer::OffsetBuffer;
use arrow_schema::{ArrowError, DataType, Field, Schema, SchemaRef};
use serde::Serialize;
use serde::de::DeserializeOwned;

use wavex_formats::container::TableReader;
use wavex_formats::{Error, Result};
use wavex_line::reason::Reason;
use wavex_line::scan_line::{
    Content, Emission, Filtered, InputInfo, LineStats, MAX_SHOTS_PER_LINE, Return, ScanLine, ShotProfile,
    emission_flags,
};
use wavex_line::stage::{self, StageError, check_model, is_valid_fusion};
use wavex_signal::fusion::ChannelFusion;
use wavex_signal::sensor_model::SensorModel;

mod columns;
mod identity;
#[cfg(test)]
mod tests;

use columns::{COUNTERS, Column, InvalidValue, PROFILES, RETURNS, SHOTS, arrays, fields, rows};
pub use identity::{Identity, recording_digest, settings_before};

/// Version of the layout.
const VERSION: &str = "1";
const VERSION_KEY: &str = "wavex.returns";
const PROGRAM_KEY: &str = "wavex.version";
const SETTINGS_KEY: &str = "wavex.settings";
const RECORDING_KEY: &str = "wavex.recording";
const FILTERED_KEY: &str = "wavex.filtered";
const INPUT_KEY: &str = "wavex.input";
const MODEL_KEY: &str = "wavex.model";
const FUSION_KEY: &str = "wavex.fusion";

/// Most lines of a record batch.
const LINES_PER_BATCH: usize = 64;
/// A record batch ends when it has this many shots and returns.
const ROWS_PER_BATCH: usize = 1 << 16;
/// Largest counter of a line.
const MAX_COUNT: u64 = 1 << 40;
/// Largest time of an instrument's clock from its origin, ps: about 50 days.
const MAX_CLOCK_PS: u64 = 1 << 62;
/// Largest deviation of the length of a direction from 1.
const UNIT_TOLERANCE: f64 = 1e-6;

pub(crate) const REMEDY: &str = "write it again: run the job with `write_returns`";

/// Reasons of dropped returns, in the order of their column.
fn reasons() -> Vec<Reason> {
    Filtered::default().counts().map(|(reason, _)| reason).collect()
}

/// Table of a list.
fn list<T>(columns: &[Column<T>]) -> DataType {
    DataType::List(Arc::new(Field::new("item", DataType::Struct(fields(columns)), false)))
}

fn filtered_type() -> DataType {
    let item = Field::new("item", DataType::UInt64, false);
    DataType::FixedSizeList(Arc::new(item), reasons().len() as i32)
}

/// Columns of the file.
fn table() -> Vec<Field> {
    let columns = [
        ("line", DataType::UInt32),
        ("gps_time_s", DataType::Float64),
        ("counters", DataType::Struct(fields(COUNTERS))),
        ("filtered", filtered_type()),
        ("shots", list(SHOTS)),
        ("returns", list(RETURNS)),
        ("profiles", list(PROFILES)),
    ];
    columns.into_iter().map(|(name, data_type)| Field::new(name, data_type, false)).collect()
}

/// What is the same for all lines of a recording.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct OfRecording {
    pub(crate) input: Arc<InputInfo>,
    pub(crate) model: Option<Arc<SensorModel>>,
    pub(crate) fusion: Option<Arc<ChannelFusion>>,
}

/// Schema of a file; `of` is absent without lines.
///
/// # Errors
/// A value that JSON does not restore, which is a bug.
pub(crate) fn schema_of(identity: &Identity, of: Option<&OfRecording>) -> stage::Result<SchemaRef> {
    let names: Vec<String> = reasons().iter().map(Reason::to_string).collect();
    let mut metadata = HashMap::from([
        (VERSION_KEY.to_owned(), VERSION.to_owned()),
        (PROGRAM_KEY.to_owned(), identity.wavex.clone()),
        (SETTINGS_KEY.to_owned(), identity.settings.to_string()),
        (FILTERED_KEY.to_owned(), json(&names)?),
    ]);
    metadata.extend(identity.recording.clone().map(|digest| (RECORDING_KEY.to_owned(), digest)));
    if let Some(of) = of {
        // Names belong to the run that reads the file.
        let input = InputInfo {
            path: "".into(),
            stem: String::new(),
            first_shot: None,
            ..InputInfo::clone(&of.input)
        };
        metadata.insert(INPUT_KEY.to_owned(), json(&input)?);
        let model = of.model.as_deref().map(json).transpose()?;
        let fusion = of.fusion.as_deref().map(json).transpose()?;
        metadata.extend(model.map(|text| (MODEL_KEY.to_owned(), text)));
        metadata.extend(fusion.map(|text| (FUSION_KEY.to_owned(), text)));
    }
    Ok(Arc::new(Schema::new(table()).with_metadata(metadata)))
}

/// Text from which the value is restored.
fn json<T: Serialize + DeserializeOwned + PartialEq>(value: &T) -> stage::Result<String> {
    let text = serde_json::to_string(value).ok();
    let is_restored = |text: &String| serde_json::from_str::<T>(text).is_ok_and(|again| again == *value);
    text.filter(is_restored).ok_or_else(|| {
        StageError::failed(
            "the metadata of the recording or its sensor model have numbers that a returns file cannot store",
            "remove `write_returns`, and please report this bug in wavex",
        )
    })
}

/// Lines of the next record batch.
#[derive(Default)]
pub(crate) struct Group {
    lines: Vec<u32>,
    stats: Vec<LineStats>,
    shots: Vec<Emission>,
    returns: Vec<Return>,
    profiles: Vec<ShotProfile>,
    /// Numbers of shots, returns and profiles per line.
    lengths: [Vec<usize>; 3],
}

impl Group {
    /// Adds a line with the shots as recorded.
    ///
    /// # Errors
    /// The line has other shots than were recorded.
    pub(crate) fn add(
        &mut self,
        line: &ScanLine,
        recorded: &[Emission],
        returns: &[Return],
    ) -> stage::Result<()> {
        let mut kept = line.emissions.iter().peekable();
        let mut places = Vec::with_capacity(line.emissions.len());
        for (place, shot) in (0u32..).zip(recorded) {
            let of_line = kept.next_if(|kept| (kept.shot, kept.clock_ps) == (shot.shot, shot.clock_ps));
            let flags = shot.flags & !emission_flags::NOT_DECOMPOSED;
            self.shots.push(match of_line {
                Some(&Emission { emission_ns, emission_sd_ns, mta_zone, .. }) => {
                    places.push(place);
                    Emission { emission_ns, emission_sd_ns, mta_zone, flags, ..*shot }
                }
                None => Emission { flags: flags | emission_flags::NOT_DECOMPOSED, ..*shot },
            });
        }
        let changed = || {
            let problem =
                format!("scan line {}: a stage before `write_returns` has changed its shots", line.line);
            StageError::failed(problem, "put it after `write_returns`")
        };
        if kept.next().is_some() {
            return Err(changed());
        }
        let place = |emission: u32| places.get(emission as usize).copied().ok_or_else(changed);
        for found in returns {
            self.returns.push(Return { emission: place(found.emission)?, ..*found });
        }
        for profile in &line.profiles {
            self.profiles.push(ShotProfile { emission: place(profile.emission)?, ..*profile });
        }
        self.lines.push(line.line);
        self.stats.push(line.stats.clone());
        let lengths = [recorded.len(), returns.len(), line.profiles.len()];
        self.lengths.iter_mut().zip(lengths).for_each(|(of_lines, length)| of_lines.push(length));
        Ok(())
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.lines.is_empty()
    }

    /// Whether the record batch is complete.
    pub(crate) fn is_full(&self) -> bool {
        self.lines.len() >= LINES_PER_BATCH || self.shots.len() + self.returns.len() >= ROWS_PER_BATCH
    }

    /// Takes the lines as a record batch.
    pub(crate) fn take(&mut self, schema: &SchemaRef) -> std::result::Result<RecordBatch, ArrowError> {
        let Group { lines, stats, shots, returns, profiles, lengths: [of_shots, of_returns, of_profiles] } =
            std::mem::take(self);
        let filtered = stats.iter().flat_map(|stats| stats.filtered.counts().map(|(_, n)| n));
        let filtered: ArrayRef = Arc::new(UInt64Array::from_iter_values(filtered));
        let DataType::FixedSizeList(item, size) = filtered_type() else { unreachable!("it is such a list") };
        let columns: Vec<ArrayRef> = vec![
            Arc::new(UInt32Array::from(lines)),
            Arc::new(stats.iter().map(|stats| stats.gps_time_s).collect::<Float64Array>()),
            Arc::new(StructArray::try_new(fields(COUNTERS), arrays(COUNTERS, &stats), None)?),
            Arc::new(FixedSizeListArray::try_new(item, size, filtered, None)?),
            lists(SHOTS, &shots, of_shots)?,
            lists(RETURNS, &returns, of_returns)?,
            lists(PROFILES, &profiles, of_profiles)?,
        ];
        RecordBatch::try_new(Arc::clone(schema), columns)
    }
}

/// A list of rows per line.
fn lists<T>(
    columns: &[Column<T>],
    rows: &[T],
    lengths: Vec<usize>,
) -> std::result::Result<ArrayRef, ArrowError> {
    let of_rows = StructArray::try_new(fields(columns), arrays(columns, rows), None)?;
    let item = Arc::new(Field::new("item", DataType::Struct(fields(columns)), false));
    let offsets = OffsetBuffer::from_lengths(lengths);
    Ok(Arc::new(ListArray::try_new(item, offsets, Arc::new(of_rows), None)?))
}

/// Reader of a returns file.
pub(crate) struct ReturnsReader {
    table: TableReader,
    file: std::path::PathBuf,
    of: Option<OfRecording>,
    /// Number of the next record batch.
    batch: usize,
}

/// Checked header of a returns file.
fn open(path: &Path) -> Result<(TableReader, Identity)> {
    let table = TableReader::open(path)?;
    let metadata = table.schema().metadata();
    let unusable = |problem: String| Error::unusable(path, problem, REMEDY);
    let text = |key: &str| metadata.get(key).map(String::as_str);
    match text(VERSION_KEY) {
        Some(VERSION) => {}
        None => return Err(unusable(format!("not a returns file: the metadata `{VERSION_KEY}` is missing"))),
        Some(other) => {
            return Err(unusable(format!(
                "version {other} of returns files is not supported; this is version {VERSION}"
            )));
        }
    }
    let identity = Identity {
        wavex: text(PROGRAM_KEY).unwrap_or_default().to_owned(),
        settings: parsed(path, SETTINGS_KEY, text(SETTINGS_KEY).unwrap_or_default())?,
        recording: text(RECORDING_KEY).map(str::to_owned),
    };
    Ok((table, identity))
}

impl Identity {
    /// Reads what a returns file was made from.
    ///
    /// # Errors
    /// The file cannot be read, or is no returns file of this version.
    pub fn read(path: &Path) -> Result<Identity> {
        open(path).map(|(_, identity)| identity)
    }
}

/// Value of a key of the metadata.
fn parsed<T: DeserializeOwned>(path: &Path, key: &str, text: &str) -> Result<T> {
    let problem = |error: serde_json::Error| format!("the metadata `{key}` is invalid: {error}");
    serde_json::from_str(text).map_err(|error| Error::unusable(path, problem(error), REMEDY))
}

impl ReturnsReader {
    /// Opens a file; names of the input are those of the run.
    ///
    /// # Errors
    /// The file cannot be read, is no returns file of this version, or has invalid metadata.
    pub(crate) fn open(path: &Path, stem: &str) -> Result<ReturnsReader> {
        let (table, _) = open(path)?;
        let unusable = |problem: String| Error::unusable(path, problem, REMEDY);
        let schema = table.schema();
        for (number, expected) in self::table().iter().enumerate() {
            if schema.fields().get(number).is_none_or(|found| **found != *expected) {
                let name = expected.name();
                return Err(unusable(format!(
                    "column {} must be `{name}`, in the layout of version {VERSION}",
                    number + 1
                )));
            }
        }
        let text = |key: &str| schema.metadata().get(key).map(String::as_str);
        let names: Vec<String> = parsed(path, FILTERED_KEY, text(FILTERED_KEY).unwrap_or_default())?;
        if !names.iter().eq(reasons().iter().map(Reason::to_string).collect::<Vec<_>>().iter()) {
            return Err(unusable(format!(
                "the metadata `{FILTERED_KEY}` names other reasons than this version of wavex"
            )));
        }
        let of =
            text(INPUT_KEY).map(|input| of_recording(path, stem, input, [text(MODEL_KEY), text(FUSION_KEY)]));
        Ok(ReturnsReader { of: of.transpose()?, table, file: path.to_owned(), batch: 0 })
    }

    /// Whether samples of the recording can be dated: its metadata, if there are lines.
    pub(crate) fn input(&self) -> Option<&InputInfo> {
        self.of.as_ref().map(|of| &*of.input)
    }

    pub(crate) fn progress(&self) -> Option<f64> {
        self.table.progress()
    }

    /// The lines of the next record batch; `None` at the end.
    ///
    /// # Errors
    /// The record batch is damaged or has impossible values.
    pub(crate) fn next_lines(&mut self) -> Result<Option<Vec<ScanLine>>> {
        let Some(batch) = self.table.next_batch()? else { return Ok(None) };
        self.batch += 1;
        let lines = lines_of(&batch, self.of.as_ref());
        let lines = lines.map_err(|problem| {
            Error::unusable(&self.file, format!("record batch {}: {problem}", self.batch), REMEDY)
        });
        lines.map(Some)
    }
}

fn of_recording(
    path: &Path,
    stem: &str,
    input: &str,
    [model, fusion]: [Option<&str>; 2],
) -> Result<OfRecording> {
    let unusable = |problem: String| Error::unusable(path, problem, REMEDY);
    let input: InputInfo = parsed(path, INPUT_KEY, input)?;
    let is_grid = input.coordinate_grid.is_none_or(|(scale, offset)| {
        scale.iter().all(|step| step.is_finite() && *step > 0.0) && offset.iter().all(|m| m.is_finite())
    });
    if !is_grid {
        return Err(unusable(format!("the metadata `{INPUT_KEY}` has an invalid `coordinate_grid`")));
    }
    let model: Option<SensorModel> = model.map(|text| parsed(path, MODEL_KEY, text)).transpose()?;
    if let Some(model) = &model {
        check_model(model).map_err(|problem| unusable(format!("the metadata `{MODEL_KEY}`: {problem}")))?;
    }
    let fusion: Option<ChannelFusion> = fusion.map(|text| parsed(path, FUSION_KEY, text)).transpose()?;
    if fusion.as_ref().is_some_and(|fusion| !is_valid_fusion(fusion)) {
        return Err(unusable(format!("the metadata `{FUSION_KEY}` has invalid numbers")));
    }
    let input = Arc::new(InputInfo { path: path.to_owned(), stem: stem.to_owned(), ..input });
    Ok(OfRecording { input, model: model.map(Arc::new), fusion: fusion.map(Arc::new) })
}

/// Lines of a record batch of the right columns, or the problem in words.
fn lines_of(batch: &RecordBatch, of: Option<&OfRecording>) -> std::result::Result<Vec<ScanLine>, String> {
    if batch.num_rows() == 0 {
        return Ok(Vec::new());
    }
    let Some(of) = of else { return Err(format!("it has lines, but the metadata `{INPUT_KEY}` is missing")) };
    let column = |number: usize| batch.column(number);
    if let Some(field) =
        batch.schema_ref().fields().iter().zip(batch.columns()).find(|(_, array)| array.null_count() > 0)
    {
        return Err(format!("column `{}` has nulls", field.0.name()));
    }
    let numbers = column(0).as_primitive::<UInt32Type>().values();
    let times_s = column(1).as_primitive::<Float64Type>().values();
    let in_table = |name: &'static str| {
        move |InvalidValue { row, column }| format!("row {} of `{name}`: invalid `{column}`", row + 1)
    };
    let counters = rows(COUNTERS, column(2), &LineStats::default()).map_err(in_table("counters"))?;
    let filtered = column(3).as_fixed_size_list();
    let filtered = filtered.values().as_primitive::<UInt64Type>();
    if filtered.null_count() > 0 {
        return Err("column `filtered` has nulls".to_owned());
    }
    let reasons = reasons();
    let filtered = filtered.values().chunks_exact(reasons.len());
    let shots = column(4).as_list::<i32>();
    let of_shots = rows(SHOTS, shots.values(), &Emission::default()).map_err(in_table("shots"))?;
    let returns = column(5).as_list::<i32>();
    let of_returns = rows(RETURNS, returns.values(), &Return::default()).map_err(in_table("returns"))?;
    let profiles = column(6).as_list::<i32>();
    let of_profiles = rows(PROFILES, profiles.values(), &BLANK_PROFILE).map_err(in_table("profiles"))?;
    let mut lines = Vec::with_capacity(batch.num_rows());
    for (row, ((stats, counts), (&line, &gps_time_s))) in
        counters.into_iter().zip(filtered).zip(numbers.iter().zip(times_s)).enumerate()
    {
        let mut stats = LineStats { gps_time_s, ..stats };
        reasons
            .iter()
            .zip(counts)
            .for_each(|(reason, n)| stats.filtered.add(*reason, (*n).min(MAX_COUNT + 1)));
        let emissions = part(&of_shots, shots, row);
        let returns = part(&of_returns, returns, row);
        let profiles = part(&of_profiles, profiles, row);
        check(&stats, emissions, returns, profiles)
            .map_err(|problem| format!("scan line {line}: {problem}"))?;
        lines.push(ScanLine {
            input: Arc::clone(&of.input),
            line,
            stats,
            model: of.model.clone(),
            fusion: of.fusion.clone(),
            emissions: emissions.to_vec(),
            content: Content::Returns(returns.to_vec()),
            profiles: profiles.to_vec(),
            footprints: Vec::new(),
            waveforms: None,
            recorded: None,
            ticket: None,
        });
    }
    Ok(lines)
}

/// The rows of a line.
fn part<'r, T>(rows: &'r [T], lists: &ListArray, line: usize) -> &'r [T] {
    let offset = |at: usize| lists.value_offsets().get(at).and_then(|&offset| usize::try_from(offset).ok());
    let range = offset(line).zip(offset(line + 1));
    range.and_then(|(from, until)| rows.get(from..until)).unwrap_or_default()
}

/// Profile before its fields are set.
const BLANK_PROFILE: ShotProfile = {
    use wavex_signal::distributed::WithSd;
    const UNKNOWN: WithSd = WithSd { value: f64::NAN, sd: f64::NAN };
    ShotProfile {
        emission: 0,
        first_range_m: UNKNOWN,
        last_range_m: UNKNOWN,
        peaks: 0,
        heights_m: [UNKNOWN; 4],
        top_m: UNKNOWN,
        energy_dn: UNKNOWN,
        flags: 0,
    }
};

/// Checks what later stages rely on.
fn check(
    stats: &LineStats,
    shots: &[Emission],
    returns: &[Return],
    profiles: &[ShotProfile],
) -> std::result::Result<(), String> {
    if shots.len() > MAX_SHOTS_PER_LINE {
        return Err(format!("{} shots, where {MAX_SHOTS_PER_LINE} are possible", shots.len()));
    }
    let counts = stats.counts().into_iter().chain([("gps_time_s", 0)]);
    if let Some((name, n)) = counts.into_iter().find(|(_, n)| *n > MAX_COUNT) {
        return Err(format!("the counter `{name}` is {n}"));
    }
    for shot in shots {
        let wrong = |what: &str| Err(format!("shot {}: {what}", shot.shot));
        let length = shot.direction.iter().map(|part| part * part).sum::<f64>().sqrt();
        if length.is_nan() || (length - 1.0).abs() > UNIT_TOLERANCE {
            return wrong("its direction is not a unit vector");
        }
        if !shot.origin_m.iter().all(|m| m.is_finite()) {
            return wrong("its origin is not finite");
        }
        if !(0.1..=10.0).contains(&shot.frame_scale) {
            return wrong("its frame scale is not between 0.1 and 10");
        }
        if shot.clock_ps.unsigned_abs() > MAX_CLOCK_PS || shot.gps_time_s.is_infinite() {
            return wrong("its time is impossible");
        }
    }
    let is_unknown = |found: &Return| {
        let shot = shots.get(found.emission as usize);
        shot.is_none_or(|shot| shot.flags & emission_flags::NOT_DECOMPOSED != 0)
    };
    if let Some(found) = returns.iter().find(|found| is_unknown(found)) {
        return Err(format!("a return of shot {} of the line, which has none", found.emission));
    }
    if !returns.is_sorted_by_key(|found| found.emission) {
        return Err("returns are not in the order of their shots".to_owned());
    }
    if let Some(found) = returns.iter().find(|found| !(found.gain > 0.0 && found.gain.is_finite())) {
        return Err(format!("a return of shot {} of the line has the gain {}", found.emission, found.gain));
    }
    let is_in_order = profiles.is_sorted_by(|a, b| a.emission < b.emission);
    if !is_in_order || profiles.last().is_some_and(|last| last.emission as usize >= shots.len()) {
        return Err("profiles are not in the order of their shots".to_owned());
    }
    Ok(())
}

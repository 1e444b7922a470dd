//! What a returns file was made from: recording, settings, program.

use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

use serde_json::{Map, Value, json};

use wavex_formats::{CompanionIndex, Error, regular_file};
use wavex_line::stage::{ChainStage, Result, StageError};

/// Name of the stage that writes returns files.
const WRITER: &str = "write_returns";
/// Size of a piece of a recording that its digest contains, bytes.
const PIECE: u64 = 1 << 16;
/// Most pieces of a file.
const PIECES: u64 = 64;

/// Recording, settings and program of a returns file.
#[derive(Clone, Debug, PartialEq)]
pub struct Identity {
    /// Version of wavex.
    pub wavex: String,
    /// See [`settings_before`].
    pub settings: Value,
    /// See [`recording_digest`]; `None` if the recording is no file.
    pub recording: Option<String>,
}

impl Identity {
    /// Identity of the file that a run of these stages over `recording` writes.
    ///
    /// # Errors
    /// A file that the stages read cannot be read.
    pub fn of(chain: &[ChainStage], recording: &Path, input_dir: &Path) -> Result<Identity> {
        let has_file = recording.is_file();
        Ok(Identity {
            wavex: env!("CARGO_PKG_VERSION").to_owned(),
            settings: settings_before(chain, input_dir)?,
            recording: has_file.then(|| recording_digest(recording)).transpose()?,
        })
    }

    /// What differs from the identity that a run would give now, in words.
    pub fn difference(&self, now: &Identity) -> Option<String> {
        if self.wavex != now.wavex {
            return Some(format!("it was made by wavex {}, not {}", self.wavex, now.wavex));
        }
        let stages = |of: &Identity| of.settings.as_array().cloned().unwrap_or_default();
        let (then, new) = (stages(self), stages(now));
        let chain = |stages: &[Value]| -> Vec<String> {
            stages.iter().map(|stage| stage["type"].as_str().unwrap_or("?").to_owned()).collect()
        };
        let [chain_then, chain_now] = [chain(&then), chain(&new)];
        if chain_then != chain_now {
            let [then, now] = [chain_then, chain_now].map(|chain| chain.join(", "));
            return Some(format!("the stages before it were {then}, and are {now}"));
        }
        for (then, now) in then.iter().zip(&new) {
            let keys = |stage: &Value| stage["keys"].as_object().cloned().unwrap_or_default();
            let (then_keys, now_keys) = (keys(then), keys(now));
            let mut names = then_keys.keys().chain(now_keys.keys());
            if let Some(name) = names.find(|name| then_keys.get(*name) != now_keys.get(*name)) {
                let value =
                    |keys: &Map<String, Value>| keys.get(name).map_or("not set".to_owned(), Value::to_string);
                let stage = then["type"].as_str().unwrap_or("?");
                return Some(format!(
                    "`{name}` of `{stage}` was {}, and is {}",
                    value(&then_keys),
                    value(&now_keys)
                ));
            }
        }
        match (&self.recording, &now.recording) {
            (Some(then), Some(now)) if then != now => Some("the recording has changed".to_owned()),
            _ => None,
        }
    }
}

/// Types and keys of the stages before `write_returns`, with all defaults.
///
/// Without sinks, names of outputs, the path of the reader, and keys that concern this machine only. Files have their
/// BLAKE3 digest instead of their name.
///
/// # Errors
/// `write_returns` is missing, or does not follow `decompose`; a file cannot be read.
pub fn settings_before(chain: &[ChainStage], input_dir: &Path) -> Result<Value> {
    let end = chain.iter().position(|stage| stage.name == WRITER);
    let Some(end) = end else {
        let remedy = "add it after `decompose`";
        return Err(StageError::failed("the job has no stage `write_returns`", remedy));
    };
    let before: Vec<_> = chain[..end].iter().filter(|stage| !stage.is_sink).collect();
    if before.last().is_none_or(|stage| stage.name != "decompose") {
        return Err(StageError::failed(
            "`write_returns` does not follow `decompose`: stages between them depend on the trajectory",
            "move it up, after `decompose`",
        ));
    }
    before.into_iter().map(|stage| Ok(json!({"type": stage.name, "keys": keys(stage, input_dir)?}))).collect()
}

/// Keys of a stage that its results depend on.
fn keys(stage: &ChainStage, input_dir: &Path) -> Result<Value> {
    let mut digests = Vec::new();
    for text in &stage.inputs {
        digests.push((text.clone(), format!("blake3:{}", whole_digest(&input_dir.join(text))?)));
    }
    let mut keys = stage.keys.as_object().cloned().unwrap_or_default();
    keys.retain(|name, value| {
        let is_output = value.as_str().is_some_and(|text| stage.outputs.iter().any(|output| output == text));
        let is_here = stage.local_keys.contains(&name.as_str()) || (stage.is_source && name == "path");
        !(is_output || is_here || value.is_null())
    });
    let mut keys = Value::Object(keys);
    replace(&mut keys, &digests);
    Ok(keys)
}

/// Replaces names of files by digests.
fn replace(value: &mut Value, digests: &[(String, String)]) {
    match value {
        Value::String(text) => {
            if let Some((_, digest)) = digests.iter().find(|(name, _)| name == text) {
                *text = digest.clone();
            }
        }
        Value::Array(items) => items.iter_mut().for_each(|item| replace(item, digests)),
        Value::Object(keys) => keys.values_mut().for_each(|item| replace(item, digests)),
        _ => {}
    }
}

fn whole_digest(path: &Path) -> Result<String> {
    let file = regular_file(path)?;
    let mut hasher = blake3::Hasher::new();
    hasher.update_reader(file).map_err(Error::io(path, "read"))?;
    Ok(hasher.finalize().to_hex().to_string())
}

/// BLAKE3 digest of the sizes of a recording and its companions, and of 64 pieces of 64 KiB of each.
///
/// Reads 4 MiB of a file, however large it is: another recording, or another export of it, has another digest.
///
/// # Errors
/// A file cannot be read.
pub fn recording_digest(path: &Path) -> Result<String> {
    let mut files = CompanionIndex::default().of(path)?;
    files.push(path.to_owned());
    files.sort_by(|a: &PathBuf, b| a.extension().cmp(&b.extension()));
    let mut hasher = blake3::Hasher::new();
    for path in files {
        let mut file = File::open(&path).map_err(Error::io(&path, "open"))?;
        let bytes = file.metadata().map_err(Error::io(&path, "open"))?.len();
        hasher.update(&bytes.to_le_bytes());
        let last = bytes.saturating_sub(PIECE);
        let pieces = bytes.div_ceil(PIECE).clamp(1, PIECES);
        for piece in 0..pieces {
            let start = (u128::from(last) * u128::from(piece) / u128::from((pieces - 1).max(1))) as u64;
            file.seek(SeekFrom::Start(start)).map_err(Error::io(&path, "read"))?;
            hasher.update_reader(file.by_ref().take(PIECE)).map_err(Error::io(&path, "read"))?;
        }
    }
    Ok(hasher.finalize().to_hex().to_string())
}

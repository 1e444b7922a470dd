//! Registry entry of a stage: name, input and output kinds, keys, constructor.

use std::path::Path;
use std::sync::Arc;

use schemars::{JsonSchema, Schema, SchemaGenerator};
use serde::Serialize;
use serde::de::DeserializeOwned;

use super::{ChainStage, Context, InstrumentModel, Map, Paths, Result, RunContext, Sink, Source, Transform};
use crate::keys::{InvalidKey, Keys};
use crate::scan_line::{Kind, ScanLine};

/// Keys of a stage.
///
/// The doc comment of the type is the stage's section of the manual. The doc comment of each field
/// describes that key, and the field name carries the unit.
pub trait Config: DeserializeOwned + Serialize + JsonSchema + Send + Sync + 'static {
    /// Checks constraints that the types cannot express, such as limits and exclusive keys.
    fn check(&self) -> std::result::Result<(), InvalidKey> {
        Ok(())
    }

    /// Sets omitted keys whose defaults depend on other keys.
    ///
    /// Called after [`Config::check`].
    fn spell_out(&mut self) {}

    /// Input files besides the source's `path`: texts among the keys, relative to the input folder.
    ///
    /// Archives store their digests.
    fn inputs(&self) -> Vec<&str> {
        Vec::new()
    }

    /// Keys that concern only this machine and do not affect results; archives omit them.
    fn local_keys(&self) -> &'static [&'static str] {
        &[]
    }
}

/// Keys of a [`Source`].
pub trait SourceConfig: Config {
    /// Input files, one run each; `None` if the source generates its data.
    fn paths(&self) -> Option<&Paths>;

    /// Stem of the outputs if there are no input files.
    fn stem(&self) -> &str {
        "out"
    }

    /// End of its files' names that names of outputs do not have.
    fn stem_suffix(&self) -> &'static str {
        ""
    }

    /// Key with the names of the parts to read, if each part of a file is an input of its own; `None`: each file is
    /// one.
    fn part_key(&self) -> Option<&'static str> {
        None
    }

    /// Names of the parts of a file that are inputs, see [`RunContext::part`]; none if the file cannot be read.
    fn parts(&self, _path: &Path) -> Vec<String> {
        Vec::new()
    }

    /// Patterns of additional files that the source writes.
    fn outputs(&self) -> Vec<&str> {
        Vec::new()
    }

    /// Opens the input of a run.
    fn make(&self, run: &RunContext) -> Result<Box<dyn Source>>;

    /// Opens the input for inspection.
    ///
    /// Unless `with_samples`, blocks may lack their samples or be missing, as the format permits. A
    /// truncated file may yield its readable part before the error.
    fn make_for_inspection(&self, run: &RunContext, with_samples: bool) -> Result<Box<dyn Source>> {
        let _ = with_samples;
        self.make(run)
    }
}

/// Keys of a [`Map`].
pub trait MapConfig: Config {
    /// Creates one worker.
    fn make(&self, run: &RunContext) -> Result<Box<dyn Map>>;

    /// Called at the end of a successful run with the counters of all workers.
    ///
    /// For warnings that need the whole recording.
    fn conclude(&self, _cx: &mut Context) {}
}

/// Keys of a [`Transform`].
pub trait TransformConfig: Config {
    /// Patterns of the files that the stage writes.
    fn outputs(&self) -> Vec<&str> {
        Vec::new()
    }

    /// Lines that it holds back.
    fn holds(&self) -> Holds {
        Holds::Window
    }

    /// Whether it learns from the first lines of a recording.
    fn learns(&self) -> Option<Learns> {
        None
    }

    /// Learns the same from lines of one or several recordings of an instrument.
    ///
    /// The lines are unchanged on return.
    ///
    /// # Errors
    /// If the lines are insufficient.
    fn learn(&self, _lines: &mut Vec<ScanLine>, _learning: &mut Learning) -> Result<()> {
        Ok(())
    }

    /// Creates the stage.
    fn make(&self, run: &RunContext) -> Result<Box<dyn Transform>>;
}

/// Context in which a transform learns, see [`TransformConfig::learn`].
#[derive(Debug)]
pub struct Learning<'a> {
    /// Folders and threads.
    pub run: &'a RunContext,
    /// Model of the instrument; receives what is learnt.
    pub known: &'a mut InstrumentModel,
    /// Counters and notes.
    pub cx: &'a mut Context,
    /// Whether values are only compared between recordings: a quicker estimate is sufficient.
    pub only_compares: bool,
}

/// What a transform learns from the first lines.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Learns {
    /// Number of waveforms from which it learns.
    pub waveforms: u64,
    /// Whether it makes the sensor model, so that a run cannot do without.
    pub makes_model: bool,
}

/// Lines that a transform holds back.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Holds {
    /// The first lines of a recording; none after it has emitted them.
    First,
    /// Neighbouring lines, throughout the recording.
    Window,
}

/// Keys of a [`Sink`].
pub trait SinkConfig: Config {
    /// Patterns of the files that it writes.
    fn outputs(&self) -> Vec<&str>;

    /// Whether lines must keep their sample blocks after `decompose`.
    fn needs_waveforms(&self) -> bool {
        false
    }

    /// Whether lines must keep their shots as recorded, see [`ScanLine::recorded`].
    fn needs_recorded(&self) -> bool {
        false
    }

    /// Creates the files of a run.
    fn make(&self, run: &RunContext) -> Result<Box<dyn Sink>>;
}

/// Role of a stage.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum RoleName {
    /// Produces lines.
    Source,
    /// Maps one line to one line; runs in a pool.
    Map,
    /// Holds lines back.
    Transform,
    /// Writes lines and passes them on.
    Sink,
}

impl std::fmt::Display for RoleName {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            RoleName::Source => "source",
            RoleName::Map => "map",
            RoleName::Transform => "transform",
            RoleName::Sink => "sink",
        })
    }
}

/// A stage with its keys, ready to be created on its thread.
#[derive(Clone)]
pub enum Plan {
    /// Produces lines.
    Source(Arc<dyn SourcePlan>),
    /// Maps one line to one line.
    Map(Arc<dyn MakeMap>),
    /// Holds lines back.
    Transform(Arc<dyn MakeTransform>),
    /// Writes lines.
    Sink(Arc<dyn SinkPlan>),
}

impl std::fmt::Debug for Plan {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Plan::Source(_) => "Source",
            Plan::Map(_) => "Map",
            Plan::Transform(_) => "Transform",
            Plan::Sink(_) => "Sink",
        })
    }
}

impl Plan {
    /// Patterns of the files that the stage writes.
    pub fn outputs(&self) -> Vec<&str> {
        match self {
            Plan::Source(source) => source.outputs(),
            Plan::Transform(transform) => transform.outputs(),
            Plan::Sink(sink) => sink.outputs(),
            Plan::Map(_) => Vec::new(),
        }
    }

    /// Whether lines must keep their sample blocks after `decompose`.
    pub fn needs_waveforms(&self) -> bool {
        matches!(self, Plan::Sink(sink) if sink.needs_waveforms())
    }

    /// Whether lines must keep their shots as recorded.
    pub fn needs_recorded(&self) -> bool {
        matches!(self, Plan::Sink(sink) if sink.needs_recorded())
    }
}

/// A [`Plan`], with keys and all defaults.
#[derive(Clone, Debug)]
pub struct Planned {
    /// Constructor of the stage.
    pub plan: Plan,
    /// Its keys with all defaults.
    pub resolved: serde_json::Value,
    /// Its input files, see [`Config::inputs`].
    pub inputs: Vec<String>,
    /// Keys that concern only this machine, see [`Config::local_keys`].
    pub local_keys: &'static [&'static str],
}

/// The object-safe part of [`SourceConfig`].
pub trait SourcePlan: Send + Sync {
    /// See [`SourceConfig::paths`].
    fn paths(&self) -> Option<&Paths> {
        None
    }
    /// See [`SourceConfig::stem`].
    fn stem(&self) -> &str {
        ""
    }
    /// See [`SourceConfig::stem_suffix`].
    fn stem_suffix(&self) -> &'static str {
        ""
    }
    /// See [`SourceConfig::part_key`].
    fn part_key(&self) -> Option<&'static str> {
        None
    }
    /// See [`SourceConfig::parts`].
    fn parts(&self, _path: &Path) -> Vec<String> {
        Vec::new()
    }
    /// See [`SourceConfig::outputs`].
    fn outputs(&self) -> Vec<&str> {
        Vec::new()
    }
    /// See [`SourceConfig::make`].
    fn make(&self, run: &RunContext) -> Result<Box<dyn Source>>;
    /// See [`SourceConfig::make_for_inspection`].
    fn make_for_inspection(&self, run: &RunContext, with_samples: bool) -> Result<Box<dyn Source>> {
        let _ = with_samples;
        self.make(run)
    }
}

/// The object-safe part of [`MapConfig`].
pub trait MakeMap: Send + Sync {
    /// See [`MapConfig::make`].
    fn make(&self, run: &RunContext) -> Result<Box<dyn Map>>;
    /// See [`MapConfig::conclude`].
    fn conclude(&self, cx: &mut Context);
}

/// The object-safe part of [`TransformConfig`].
pub trait MakeTransform: Send + Sync {
    /// See [`TransformConfig::outputs`].
    fn outputs(&self) -> Vec<&str>;
    /// See [`TransformConfig::holds`].
    fn holds(&self) -> Holds;
    /// See [`TransformConfig::learns`].
    fn learns(&self) -> Option<Learns>;
    /// See [`TransformConfig::learn`].
    fn learn(&self, lines: &mut Vec<ScanLine>, learning: &mut Learning) -> Result<()>;
    /// See [`TransformConfig::make`].
    fn make(&self, run: &RunContext) -> Result<Box<dyn Transform>>;
}

/// The object-safe part of [`SinkConfig`].
pub trait SinkPlan: Send + Sync {
    /// See [`SinkConfig::outputs`].
    fn outputs(&self) -> Vec<&str> {
        Vec::new()
    }
    /// See [`SinkConfig::needs_waveforms`].
    fn needs_waveforms(&self) -> bool {
        false
    }
    /// See [`SinkConfig::needs_recorded`].
    fn needs_recorded(&self) -> bool {
        false
    }
    /// See [`SinkConfig::make`].
    fn make(&self, run: &RunContext) -> Result<Box<dyn Sink>>;
}

impl Planned {
    /// The stage as other stages of its run see it; `name` is that of its type.
    pub fn in_chain(&self, name: &'static str) -> ChainStage {
        ChainStage {
            name,
            is_source: matches!(self.plan, Plan::Source(_)),
            is_sink: matches!(self.plan, Plan::Sink(_)),
            needs_recorded: self.plan.needs_recorded(),
            keys: self.resolved.clone(),
            inputs: self.inputs.clone(),
            outputs: self.plan.outputs().into_iter().map(str::to_owned).collect(),
            local_keys: self.local_keys,
        }
    }

    /// A stage without keys.
    pub fn without_keys(plan: Plan) -> Planned {
        let resolved = serde_json::Value::Object(serde_json::Map::new());
        Planned { plan, resolved, inputs: Vec::new(), local_keys: &[] }
    }
}

impl<C: SourceConfig> SourcePlan for C {
    fn paths(&self) -> Option<&Paths> {
        SourceConfig::paths(self)
    }
    fn stem(&self) -> &str {
        SourceConfig::stem(self)
    }
    fn stem_suffix(&self) -> &'static str {
        SourceConfig::stem_suffix(self)
    }
    fn part_key(&self) -> Option<&'static str> {
        SourceConfig::part_key(self)
    }
    fn parts(&self, path: &Path) -> Vec<String> {
        SourceConfig::parts(self, path)
    }
    fn outputs(&self) -> Vec<&str> {
        SourceConfig::outputs(self)
    }
    fn make(&self, run: &RunContext) -> Result<Box<dyn Source>> {
        SourceConfig::make(self, run)
    }
    fn make_for_inspection(&self, run: &RunContext, with_samples: bool) -> Result<Box<dyn Source>> {
        SourceConfig::make_for_inspection(self, run, with_samples)
    }
}

impl<C: MapConfig> MakeMap for C {
    fn make(&self, run: &RunContext) -> Result<Box<dyn Map>> {
        MapConfig::make(self, run)
    }
    fn conclude(&self, cx: &mut Context) {
        MapConfig::conclude(self, cx);
    }
}

impl<C: TransformConfig> MakeTransform for C {
    fn outputs(&self) -> Vec<&str> {
        TransformConfig::outputs(self)
    }
    fn holds(&self) -> Holds {
        TransformConfig::holds(self)
    }
    fn learns(&self) -> Option<Learns> {
        TransformConfig::learns(self)
    }
    fn learn(&self, lines: &mut Vec<ScanLine>, learning: &mut Learning) -> Result<()> {
        TransformConfig::learn(self, lines, learning)
    }
    fn make(&self, run: &RunContext) -> Result<Box<dyn Transform>> {
        TransformConfig::make(self, run)
    }
}

impl<C: SinkConfig> SinkPlan for C {
    fn outputs(&self) -> Vec<&str> {
        SinkConfig::outputs(self)
    }
    fn needs_waveforms(&self) -> bool {
        SinkConfig::needs_waveforms(self)
    }
    fn needs_recorded(&self) -> bool {
        SinkConfig::needs_recorded(self)
    }
    fn make(&self, run: &RunContext) -> Result<Box<dyn Sink>> {
        SinkConfig::make(self, run)
    }
}

/// Error in a stage's keys.
#[derive(Debug)]
pub enum ConfigError {
    /// A key is unknown, missing, or has the wrong type; with its position in the job.
    Toml(toml::de::Error),
    /// A key has an invalid value.
    Key(InvalidKey),
}

/// Registry entry of a stage.
#[derive(Debug)]
pub struct StageSpec {
    /// Name of its type in a job, a verb.
    pub name: &'static str,
    /// Role of the stage.
    pub role: RoleName,
    /// Kinds of lines that it accepts; empty for a source.
    pub accepts: &'static [Kind],
    /// Kind that it produces; `None`: the same as its input.
    pub makes: Option<Kind>,
    /// Stages of which one must precede it.
    pub after: &'static [&'static str],
    /// Key and value with which the stage requires none of them.
    pub unless: Option<(&'static str, &'static str)>,
    /// Schema of its keys.
    pub schema: fn(&mut SchemaGenerator) -> Schema,
    /// Parses its keys.
    pub parse: fn(toml::Spanned<toml::de::DeTable<'_>>) -> std::result::Result<Planned, ConfigError>,
}

impl StageSpec {
    /// A source of one kind of lines.
    pub const fn source<C: SourceConfig>(name: &'static str, makes: Kind) -> StageSpec {
        StageSpec {
            name,
            role: RoleName::Source,
            accepts: &[],
            makes: Some(makes),
            after: &[],
            unless: None,
            schema: C::json_schema,
            parse: |table| parse::<C>(table, |config| Plan::Source(config)),
        }
    }

    /// A map; `makes` is `None` if it keeps the kind.
    pub const fn map<C: MapConfig>(
        name: &'static str,
        accepts: &'static [Kind],
        makes: Option<Kind>,
    ) -> StageSpec {
        StageSpec {
            name,
            role: RoleName::Map,
            accepts,
            makes,
            after: &[],
            unless: None,
            schema: C::json_schema,
            parse: |table| parse::<C>(table, |config| Plan::Map(config)),
        }
    }

    /// A transform, which keeps the kind unless it is [`StageSpec::making`] another.
    pub const fn transform<C: TransformConfig>(name: &'static str, accepts: &'static [Kind]) -> StageSpec {
        StageSpec {
            name,
            role: RoleName::Transform,
            accepts,
            makes: None,
            after: &[],
            unless: None,
            schema: C::json_schema,
            parse: |table| parse::<C>(table, |config| Plan::Transform(config)),
        }
    }

    /// A sink, which passes on its input.
    pub const fn sink<C: SinkConfig>(name: &'static str, accepts: &'static [Kind]) -> StageSpec {
        StageSpec {
            name,
            role: RoleName::Sink,
            accepts,
            makes: None,
            after: &[],
            unless: None,
            schema: C::json_schema,
            parse: |table| parse::<C>(table, |config| Plan::Sink(config)),
        }
    }

    /// A stage that programs insert in code; a job cannot name it.
    ///
    /// It has no keys and keeps the kind of its lines.
    pub const fn in_code(name: &'static str, role: RoleName, accepts: &'static [Kind]) -> StageSpec {
        StageSpec {
            name,
            role,
            accepts,
            makes: None,
            after: &[],
            unless: None,
            schema: <()>::json_schema,
            parse: |_| {
                Err(ConfigError::Key(InvalidKey::new("type", "the stage cannot be part of a job file")))
            },
        }
    }

    /// Output kind for an input kind; `None` if unknown.
    pub fn gives(&self, given: Option<Kind>) -> Option<Kind> {
        self.makes.or(given)
    }

    /// Its keys with documentation.
    pub fn keys(&self) -> Keys {
        Keys::of(self.schema)
    }

    /// Requires one of `stages` to precede it.
    pub const fn after(mut self, stages: &'static [&'static str]) -> StageSpec {
        self.after = stages;
        self
    }

    /// Its lines are of this kind.
    pub const fn making(mut self, kind: Kind) -> StageSpec {
        self.makes = Some(kind);
        self
    }

    /// Drops the requirement of a preceding stage if `key` is `word`.
    pub const fn unless(mut self, key: &'static str, word: &'static str) -> StageSpec {
        self.unless = Some((key, word));
        self
    }
}

fn parse<C: Config>(
    table: toml::Spanned<toml::de::DeTable<'_>>,
    plan: fn(Arc<C>) -> Plan,
) -> std::result::Result<Planned, ConfigError> {
    let mut config = C::deserialize(toml::de::Deserializer::from(table)).map_err(ConfigError::Toml)?;
    config.check().map_err(ConfigError::Key)?;
    config.spell_out();
    let resolved = serde_json::to_value(&config).unwrap_or(serde_json::Value::Null);
    let inputs = config.inputs().into_iter().map(str::to_owned).collect();
    let local_keys = config.local_keys();
    Ok(Planned { plan: plan(Arc::new(config)), resolved, inputs, local_keys })
}

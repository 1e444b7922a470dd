//! How a stage stands in the registry: its name, what goes in and out, its keys, and how it is made.

use std::sync::Arc;

use schemars::{JsonSchema, Schema, SchemaGenerator};
use serde::Serialize;
use serde::de::DeserializeOwned;

use super::{Keys, Map, Paths, Result, Sink, Site, Source, Transform};
use crate::batch::Kind;

/// The keys of a stage in a job. Its doc comment is the stage's page in the manual, and each field's doc comment that
/// key's line; a field's name carries its unit.
pub trait Config: DeserializeOwned + Serialize + JsonSchema + Send + Sync + 'static {
    /// What the types alone cannot say of the keys: limits, and keys that exclude each other.
    fn check(&self) -> std::result::Result<(), InvalidKey> {
        Ok(())
    }

    /// Gives the keys that the job does not, and whose defaults hang on other keys, the values that count in their place.
    /// Comes behind [`Config::check`].
    fn spell_out(&mut self) {}

    /// The files that the stage reads besides the source's `path`: texts among its keys, which start where inputs do.
    /// Archives keep their digests.
    fn inputs(&self) -> Vec<&str> {
        Vec::new()
    }

    /// Keys that say where something lies on this machine and change no result: archives leave them out.
    fn local_keys(&self) -> &'static [&'static str] {
        &[]
    }
}

/// A key whose value cannot be used.
#[derive(Debug, PartialEq)]
pub struct InvalidKey {
    /// The key's name.
    pub key: &'static str,
    /// What is wrong with its value.
    pub problem: String,
}

impl InvalidKey {
    /// A key whose value cannot be used.
    pub fn new(key: &'static str, problem: impl Into<String>) -> InvalidKey {
        InvalidKey { key, problem: problem.into() }
    }

    /// An error unless `holds`.
    pub fn unless(holds: bool, key: &'static str, problem: &str) -> std::result::Result<(), InvalidKey> {
        if holds { Ok(()) } else { Err(InvalidKey::new(key, problem)) }
    }
}

/// The keys of a [`Source`].
pub trait SourceConfig: Config {
    /// The files to read, one run each; `None` where the source makes its own data.
    fn paths(&self) -> Option<&Paths>;

    /// What outputs are named after where there are no files.
    fn stem(&self) -> &str {
        "out"
    }

    /// Patterns of the files that the source writes besides.
    fn outputs(&self) -> Vec<&str> {
        Vec::new()
    }

    /// Opens the input of a run.
    fn make(&self, site: &Site) -> Result<Box<dyn Source>>;

    /// Opens the input to look it over. Unless `with_samples`, blocks may come without their samples, or not at all, as
    /// the format allows it. A file that is cut off may give what it holds before it ends with that error.
    fn make_survey(&self, site: &Site, with_samples: bool) -> Result<Box<dyn Source>> {
        let _ = with_samples;
        self.make(site)
    }
}

/// The keys of a [`Map`].
pub trait MapConfig: Config {
    /// Makes one worker.
    fn make(&self, site: &Site) -> Result<Box<dyn Map>>;
}

/// The keys of a [`Transform`].
pub trait TransformConfig: Config {
    /// Patterns of the files that the stage writes.
    fn outputs(&self) -> Vec<&str> {
        Vec::new()
    }

    /// Which lines it holds back.
    fn holds(&self) -> Holds {
        Holds::Window
    }

    /// Makes the stage.
    fn make(&self, site: &Site) -> Result<Box<dyn Transform>>;
}

/// Which lines a transform holds back.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Holds {
    /// The first lines of a recording, and none once it has given them on.
    First,
    /// Neighbouring lines, as long as the recording lasts.
    Window,
}

/// The keys of a [`Sink`].
pub trait SinkConfig: Config {
    /// Patterns of the files to write.
    fn outputs(&self) -> Vec<&str>;

    /// Whether lines are to keep their recorded blocks behind `decompose`.
    fn needs_waveforms(&self) -> bool {
        false
    }

    /// Begins the files of a run.
    fn make(&self, site: &Site) -> Result<Box<dyn Sink>>;
}

/// The four roles.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum RoleName {
    /// Makes lines.
    Source,
    /// One line in, one line out; runs in a pool.
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

/// A stage with its keys, ready to be made on a thread of its own.
#[derive(Clone)]
pub enum Plan {
    /// Makes lines.
    Source(Arc<dyn SourcePlan>),
    /// One line in, one line out.
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

    /// Whether lines are to keep their recorded blocks behind `decompose`.
    pub fn needs_waveforms(&self) -> bool {
        matches!(self, Plan::Sink(sink) if sink.needs_waveforms())
    }
}

/// [`Plan`], and the keys with every default spelled out.
#[derive(Clone, Debug)]
pub struct Planned {
    /// How to make the stage.
    pub plan: Plan,
    /// Its keys, every default spelled out.
    pub resolved: serde_json::Value,
    /// The files that it reads, see [`Config::inputs`].
    pub inputs: Vec<String>,
    /// Keys that concern this machine only, see [`Config::local_keys`].
    pub local_keys: &'static [&'static str],
}

/// The object-safe part of [`SourceConfig`].
pub trait SourcePlan: Send + Sync {
    /// See [`SourceConfig::paths`].
    fn paths(&self) -> Option<&Paths>;
    /// See [`SourceConfig::stem`].
    fn stem(&self) -> &str;
    /// See [`SourceConfig::outputs`].
    fn outputs(&self) -> Vec<&str>;
    /// See [`SourceConfig::make`].
    fn make(&self, site: &Site) -> Result<Box<dyn Source>>;
    /// See [`SourceConfig::make_survey`].
    fn make_survey(&self, site: &Site, with_samples: bool) -> Result<Box<dyn Source>>;
}

/// The object-safe part of [`MapConfig`].
pub trait MakeMap: Send + Sync {
    /// See [`MapConfig::make`].
    fn make(&self, site: &Site) -> Result<Box<dyn Map>>;
}

/// The object-safe part of [`TransformConfig`].
pub trait MakeTransform: Send + Sync {
    /// See [`TransformConfig::outputs`].
    fn outputs(&self) -> Vec<&str>;
    /// See [`TransformConfig::holds`].
    fn holds(&self) -> Holds;
    /// See [`TransformConfig::make`].
    fn make(&self, site: &Site) -> Result<Box<dyn Transform>>;
}

/// The object-safe part of [`SinkConfig`].
pub trait SinkPlan: Send + Sync {
    /// See [`SinkConfig::outputs`].
    fn outputs(&self) -> Vec<&str>;
    /// See [`SinkConfig::needs_waveforms`].
    fn needs_waveforms(&self) -> bool;
    /// See [`SinkConfig::make`].
    fn make(&self, site: &Site) -> Result<Box<dyn Sink>>;
}

impl<C: SourceConfig> SourcePlan for C {
    fn paths(&self) -> Option<&Paths> {
        SourceConfig::paths(self)
    }
    fn stem(&self) -> &str {
        SourceConfig::stem(self)
    }
    fn outputs(&self) -> Vec<&str> {
        SourceConfig::outputs(self)
    }
    fn make(&self, site: &Site) -> Result<Box<dyn Source>> {
        SourceConfig::make(self, site)
    }
    fn make_survey(&self, site: &Site, with_samples: bool) -> Result<Box<dyn Source>> {
        SourceConfig::make_survey(self, site, with_samples)
    }
}

impl<C: MapConfig> MakeMap for C {
    fn make(&self, site: &Site) -> Result<Box<dyn Map>> {
        MapConfig::make(self, site)
    }
}

impl<C: TransformConfig> MakeTransform for C {
    fn outputs(&self) -> Vec<&str> {
        TransformConfig::outputs(self)
    }
    fn holds(&self) -> Holds {
        TransformConfig::holds(self)
    }
    fn make(&self, site: &Site) -> Result<Box<dyn Transform>> {
        TransformConfig::make(self, site)
    }
}

impl<C: SinkConfig> SinkPlan for C {
    fn outputs(&self) -> Vec<&str> {
        SinkConfig::outputs(self)
    }
    fn needs_waveforms(&self) -> bool {
        SinkConfig::needs_waveforms(self)
    }
    fn make(&self, site: &Site) -> Result<Box<dyn Sink>> {
        SinkConfig::make(self, site)
    }
}

/// What `parse` can find wrong with a stage's keys.
#[derive(Debug)]
pub enum ConfigError {
    /// A key is unknown, missing, or of another type; carries its place in the job.
    Toml(toml::de::Error),
    /// A key's value cannot be used.
    Key(InvalidKey),
}

/// A stage's place in the registry.
#[derive(Debug)]
pub struct StageSpec {
    /// The verb that a job calls it by.
    pub name: &'static str,
    /// Which of the four roles it plays.
    pub role: RoleName,
    /// The kinds of batch it takes; none for a source.
    pub accepts: &'static [Kind],
    /// The kind it makes; `None`: the kind that it was given.
    pub makes: Option<Kind>,
    /// Stages of which one must stand before it.
    pub after: &'static [&'static str],
    /// A key and its word with which the stage needs none of them.
    pub unless: Option<(&'static str, &'static str)>,
    /// Its keys, for the schema and the manual.
    pub schema: fn(&mut SchemaGenerator) -> Schema,
    /// Reads its keys out of a job.
    pub parse: fn(toml::Spanned<toml::de::DeTable<'_>>) -> std::result::Result<Planned, ConfigError>,
}

impl StageSpec {
    /// A source that makes batches of one kind.
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

    /// A map; `makes` is `None` where it keeps the kind.
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

    /// A transform, which keeps the kind.
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

    /// A sink, which passes on what it was given.
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

    /// The kind that leaves the stage where `given` enters it; `None` where neither is known.
    pub fn gives(&self, given: Option<Kind>) -> Option<Kind> {
        self.makes.or(given)
    }

    /// Its keys with their meaning, and the stage's page of the manual.
    pub fn keys(&self) -> Keys {
        Keys::of(self.schema)
    }

    /// The same, but one of `stages` must stand before it.
    pub const fn after(mut self, stages: &'static [&'static str]) -> StageSpec {
        self.after = stages;
        self
    }

    /// The same, but none must stand before it where its `key` is `word`.
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

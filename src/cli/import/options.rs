//! What an option of the classic command line is: its names, its argument, its default, and what it becomes.

use super::v10::V10;
use super::v11::V11;

/// A version of the classic command line.
#[derive(Debug)]
pub struct Version {
    /// `1.0` or `1.1`.
    pub name: &'static str,
    /// Every option, in the order of its document.
    pub options: &'static [Opt],
    /// The stages of its jobs behind the reader, in order; which of them a job has, the line decides.
    pub chain: &'static [&'static str],
    /// What the version does without being asked and without an option to ask for it.
    pub always: &'static [Always],
    /// Names that its file of persistent options may have: the first that exists is read.
    pub option_files: &'static [&'static str],
    /// What the output is called where the line does not say it.
    pub output: &'static str,
    /// What the file of line statistics is called, behind the name of the output.
    pub line_stats: &'static str,
    /// Whether it writes `_stat.log`.
    pub has_stat_log: bool,
    /// Whether it writes the trajectory without being asked, where there is one.
    pub writes_trajectory: bool,
}

/// A key that a version's jobs always have: section, key, value in TOML, and why.
pub type Always = (&'static str, &'static str, &'static str, &'static str);

/// Both versions, the older one first.
pub const VERSIONS: [&Version; 2] = [&V10, &V11];

/// One option.
#[derive(Debug)]
pub struct Opt {
    /// Its names without the dash: the short one, the long one, and what examples and older files call it.
    pub names: &'static [&'static str],
    /// Its argument.
    pub takes: Takes,
    /// What counts without it.
    pub standard: Standard,
    /// What it becomes.
    pub becomes: Becomes,
    /// What a reader of the table should know besides; empty where the key says it all.
    pub remark: &'static str,
}

/// The argument of an option.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Takes {
    /// 0 or 1; 1 where nothing follows.
    Switch,
    /// A number.
    Number,
    /// A whole number from the first to the second.
    Whole(u64, u64),
    /// One word, and what it is.
    Text(&'static str),
    /// A day as `2018-11-14`, or 0.
    Date,
    /// One word or several, and what they are.
    Texts(&'static str),
}

/// What counts where an option is not given.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Standard {
    /// The same as here: the job need not say it.
    Same(&'static str),
    /// Something else than here: the job says it.
    Written(&'static str),
    /// In words: no key stands for it.
    Words(&'static str),
}

/// What an option becomes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Becomes {
    /// A key: its section (`job`, `geometry`, `reader` or a stage), its name, and how its value is made.
    Key(&'static str, &'static str, Form),
    /// The first (0) or second (1) number of a key that is a list of two, and that list without the option.
    End(&'static str, &'static str, usize, [f64; 2]),
    /// A part of what several options say together.
    Part(Part),
    /// An option of `wavex` itself, when the switch has this value.
    Flag(Flag, bool),
    /// A command instead of a job.
    Command(&'static [&'static str]),
    /// Nothing, and why.
    Nothing(&'static str),
}

/// How the value of a key is made from the argument.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Form {
    /// As it is.
    Plain,
    /// 0 means this value in TOML, anything else itself.
    ZeroIs(&'static str),
    /// 0 means that the key is not given.
    ZeroIsNothing,
    /// A switch: these values in TOML when it is off and when it is on; empty: the key is not given.
    Switch(&'static str, &'static str),
    /// A zone of UTM; the trajectory tells the hemisphere.
    Zone,
    /// As it is; the remark of the table stands in the job, too.
    Remarked,
    /// A file in the folder of inputs.
    File,
    /// The columns of a trajectory, of which none may be missing.
    TrajectoryColumns,
    /// A file of three angles, which the job takes over.
    Angles,
}

/// What several options say together.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    /// The files to read.
    Input,
    /// Where they are.
    InputDir,
    /// Where outputs go.
    OutputDir,
    /// What outputs are called.
    Output,
    /// The extension of the output.
    Extension(&'static str),
    /// An index of the points beside them.
    Index,
    /// An index of the points in their file.
    IndexWithin,
    /// The columns of a text.
    Columns,
    /// No points.
    NoPoints,
    /// Line statistics.
    LineStats,
    /// The trajectory as text.
    Trajectory,
    /// All texts.
    AllTexts,
    /// Statistics of the recording.
    Scan,
    /// Only these.
    OnlyScan,
    /// Only these, without the samples.
    OnlyScanFast,
    /// What these are called.
    ScanName,
    /// More refinement.
    Slow,
    /// Refinement on demand.
    Auto,
    /// The trajectory, thinned and projected, as a text of its own.
    PlotTrajectory,
    /// How much it is thinned.
    PlotEvery,
}

/// An option of `wavex` itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Flag {
    /// `--quiet`.
    Quiet,
    /// `--progress never`.
    NoProgress,
}

impl Flag {
    /// As it stands on a command line.
    pub fn text(self) -> &'static str {
        match self {
            Flag::Quiet => "--quiet",
            Flag::NoProgress => "--progress never",
        }
    }
}

impl Version {
    /// The version of this name.
    pub fn find(name: &str) -> Option<&'static Version> {
        VERSIONS.into_iter().find(|version| version.name == name)
    }

    /// The option of this name.
    pub fn option(&self, name: &str) -> Option<&'static Opt> {
        self.options.iter().find(|option| option.names.contains(&name))
    }

    /// All names of its options.
    pub fn names(&self) -> impl Iterator<Item = &'static str> {
        self.options.iter().flat_map(|option| option.names.iter().copied())
    }
}

impl Opt {
    /// The name that messages use.
    pub fn name(&self) -> &'static str {
        self.names.first().copied().unwrap_or_default()
    }
}

impl Takes {
    /// What is expected, in words.
    pub fn words(self) -> String {
        match self {
            Takes::Switch => "0 or 1".to_owned(),
            Takes::Number => "a number".to_owned(),
            Takes::Whole(least, u64::MAX) => format!("a whole number from {least} on"),
            Takes::Whole(least, most) => format!("a whole number from {least} to {most}"),
            Takes::Date => "a day as in 2018-11-14".to_owned(),
            Takes::Text(what) | Takes::Texts(what) => what.to_owned(),
        }
    }

    /// As tables show it.
    pub fn shown(self) -> String {
        match self {
            Takes::Switch => "0, 1".to_owned(),
            other => other.words(),
        }
    }
}

/// A row of a version's table.
pub const fn row(
    names: &'static [&'static str],
    takes: Takes,
    standard: Standard,
    becomes: Becomes,
    remark: &'static str,
) -> Opt {
    Opt { names, takes, standard, becomes, remark }
}

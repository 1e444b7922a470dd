//! Definition of classic options: names, argument, default, and translation.

/// A version of the classic command line.
#[derive(Debug)]
pub struct Version {
    /// `1.0` or `1.1`.
    pub name: &'static str,
    /// All options, in the order of its documentation.
    pub options: &'static [Opt],
    /// Stages that follow the reader, in order; the command line selects among them.
    pub chain: &'static [&'static str],
    /// Keys for behaviour that the version has no option for.
    pub always: &'static [Always],
    /// Possible names of its options file; the first that exists is read.
    pub option_files: &'static [&'static str],
    /// Default name of the output.
    pub output: &'static str,
    /// Suffix of the line-statistics file, after the stem of the output.
    pub line_stats: &'static str,
    /// Whether it writes `_stat.log`.
    pub has_stat_log: bool,
    /// Whether it writes the trajectory by default, if there is one.
    pub writes_trajectory: bool,
}

/// A key that all jobs of a version have: section, key, TOML value, reason.
pub type Always = (&'static str, &'static str, &'static str, &'static str);

/// One option.
#[derive(Debug)]
pub struct Opt {
    /// Names without the dash: short name, long name, and aliases of examples and older files.
    pub names: &'static [&'static str],
    /// Its argument.
    pub takes: Takes,
    /// Its default.
    pub standard: Standard,
    /// Its translation.
    pub becomes: Becomes,
    /// Additional remark for the reference table; empty if the key is self-explanatory.
    pub remark: &'static str,
}

/// The argument of an option.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Takes {
    /// 0 or 1; 1 if no argument follows.
    Switch,
    /// A number.
    Number,
    /// A whole number within these inclusive bounds.
    Whole(u64, u64),
    /// One word, with its description.
    Text(&'static str),
    /// A date such as `2018-11-14`, or 0.
    Date,
    /// One or more words, with their description.
    Texts(&'static str),
}

/// Default of an option.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Standard {
    /// Same as the default of wavex; the job omits the key.
    Same(&'static str),
    /// Differs from the default of wavex; the job writes the key.
    Written(&'static str),
    /// A description; no key represents it.
    Words(&'static str),
}

/// Translation of an option.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Becomes {
    /// A key: section (`job`, `geometry`, `reader` or a stage), name, and conversion of the value.
    Key(&'static str, &'static str, Form),
    /// One number (index 0 or 1) of a key that is a pair, with the default pair.
    End(&'static str, &'static str, usize, [f64; 2]),
    /// A part of what several options define together.
    Part(Part),
    /// An option of `wavex`, set if the switch has this value.
    Flag(Flag, bool),
    /// A command that replaces the job.
    Command(&'static [&'static str]),
    /// No translation, with the reason.
    Nothing(&'static str),
}

/// Conversion of an argument to the value of a key.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Form {
    /// Unchanged.
    Plain,
    /// 0 becomes this TOML value; any other number is unchanged.
    ZeroIs(&'static str),
    /// 0 omits the key.
    ZeroIsNothing,
    /// TOML values for off and on; an empty one omits the key.
    Switch(&'static str, &'static str),
    /// A UTM zone; the trajectory defines the hemisphere.
    Zone,
    /// Unchanged; the remark of the table is also written to the job.
    Remarked,
    /// A file in the input folder.
    File,
    /// Column letters of a trajectory; all columns except roll are required.
    TrajectoryColumns,
    /// A file of three angles, which are copied into the job.
    Angles,
}

/// Settings that several options define together.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    /// Input files.
    Input,
    /// Input folder.
    InputDir,
    /// Output folder.
    OutputDir,
    /// Name of the outputs.
    Output,
    /// Extension of the output.
    Extension(&'static str),
    /// Point index in a separate file.
    Index,
    /// Point index appended to the point file.
    IndexWithin,
    /// Columns of a text output.
    Columns,
    /// No point output.
    NoPoints,
    /// Line statistics.
    LineStats,
    /// Trajectory as text.
    Trajectory,
    /// All text outputs.
    AllTexts,
    /// Recording statistics.
    Scan,
    /// Recording statistics only.
    OnlyScan,
    /// Recording statistics only, without samples.
    OnlyScanFast,
    /// Name prefix of the recording statistics.
    ScanName,
    /// More refinement.
    Slow,
    /// Refinement when needed.
    Auto,
    /// Projected and decimated trajectory as a separate text file.
    PlotTrajectory,
    /// Decimation factor of that trajectory.
    PlotEvery,
}

/// An option of `wavex`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Flag {
    /// `--quiet`.
    Quiet,
    /// `--progress never`.
    NoProgress,
}

impl Flag {
    /// Text on a command line.
    pub fn text(self) -> &'static str {
        match self {
            Flag::Quiet => "--quiet",
            Flag::NoProgress => "--progress never",
        }
    }
}

impl Version {
    /// Returns the option of this name.
    pub fn option(&self, name: &str) -> Option<&'static Opt> {
        self.options.iter().find(|option| option.names.contains(&name))
    }

    /// All names of its options.
    pub fn names(&self) -> impl Iterator<Item = &'static str> {
        self.options.iter().flat_map(|option| option.names.iter().copied())
    }
}

impl Opt {
    /// Name used in messages.
    pub fn name(&self) -> &'static str {
        self.names.first().copied().unwrap_or_default()
    }
}

impl Takes {
    /// Description of the expected argument.
    pub fn words(self) -> String {
        match self {
            Takes::Switch => "0 or 1".to_owned(),
            Takes::Number => "a number".to_owned(),
            Takes::Whole(least, u64::MAX) => format!("a whole number of at least {least}"),
            Takes::Whole(least, most) => format!("a whole number from {least} to {most}"),
            Takes::Date => "a date such as 2018-11-14".to_owned(),
            Takes::Text(what) | Takes::Texts(what) => what.to_owned(),
        }
    }

    /// Description of the argument for tables.
    pub fn shown(self) -> String {
        match self {
            Takes::Switch => "0, 1".to_owned(),
            other => other.words(),
        }
    }
}

/// One row of a version's table.
pub const fn row(
    names: &'static [&'static str],
    takes: Takes,
    standard: Standard,
    becomes: Becomes,
    remark: &'static str,
) -> Opt {
    Opt { names, takes, standard, becomes, remark }
}

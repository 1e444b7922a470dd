//! Command-line arguments of the commands.

use std::path::PathBuf;

use clap::{Args, ValueEnum};

use wavex_formats::trajectory::{Angles, FileTime};
use wavex_run::align::{AlignConstraints, OptionalParameter, TrajectoryModel};

/// An archive and the locations of its files.
#[derive(Args)]
pub(super) struct ArchiveArgs {
    /// Archive: a folder, or a file that ends in .tar.zst
    pub(super) archive: PathBuf,
    /// Current folder of the inputs [default: as recorded in the archive]
    #[arg(long, value_name = "FOLDER")]
    pub(super) inputs: Option<PathBuf>,
    /// Current folder of the outputs [default: as recorded in the archive]
    #[arg(long, value_name = "FOLDER")]
    pub(super) outputs: Option<PathBuf>,
}

/// Recording to calibrate from and sensor model to write.
#[derive(Args)]
pub(super) struct CalibrateArgs {
    /// Recording: .las, .laz, .pls, .plz, .sdf, .wfm, .arrow, .h5, .hdf5 or .spd; or the job of a survey: .toml
    pub(super) file: PathBuf,
    /// Sensor model of the recording to write (.json)
    #[arg(long, value_name = "NAME.json")]
    pub(super) save_preset: Option<PathBuf>,
    /// Sensor models of the job's inputs to write (.json)
    #[arg(short, long, value_name = "NAME.json", conflicts_with = "save_preset")]
    pub(super) out: Option<PathBuf>,
    /// Override a key of the reader or of calibrate for this run, as for `wavex run`; may be
    /// repeated
    #[arg(long = "set", value_name = "STAGE.KEY=VALUE")]
    pub(super) set: Vec<String>,
    #[command(flatten)]
    pub(super) machine: MachineArgs,
}

/// Shot to explain and stages to decompose it with.
#[derive(Args)]
#[command(group = clap::ArgGroup::new("which").required(true))]
pub(super) struct ExplainArgs {
    /// Recording (.las, .laz, .pls, .plz, .sdf, .wfm, .arrow, .h5, .hdf5 or .spd), or a job (.toml) of one recording
    pub(super) file: PathBuf,
    /// Number of the shot, as in the column `shot` of write_table or `shot_number` of write_footprints
    #[arg(long, value_name = "N", group = "which", allow_negative_numbers = true, value_parser = whole::<u64>)]
    pub(super) shot: Option<u64>,
    /// Explain the shot nearest to this time, as in the column `gps_time_s` of write_table
    #[arg(long, value_name = "GPS_SECONDS", group = "which", allow_negative_numbers = true, value_parser = seconds)]
    pub(super) time: Option<f64>,
    /// Job to take the keys of all stages up to decompose from; its reader is used if it reads this
    /// format
    #[arg(long, value_name = "FILE")]
    pub(super) job: Option<PathBuf>,
    /// Override a key of the job for this run, as for `wavex run`; may be repeated
    #[arg(long = "set", value_name = "STAGE.KEY=VALUE")]
    pub(super) set: Vec<String>,
    /// Model written by `save` of calibrate or measure_footprints; used instead of learning it
    #[arg(long, value_name = "FILE")]
    pub(super) model: Option<PathBuf>,
    /// Picture to write [default: STEM_shot_N.svg in the current folder]
    #[arg(short, long, value_name = "FILE")]
    pub(super) out: Option<PathBuf>,
    /// When to show progress; auto: a bar on a terminal
    #[arg(long, value_name = "WHEN", default_value = "auto")]
    pub(super) progress: When,
}

/// What to view, and how it is served.
#[derive(Args)]
pub(super) struct ViewArgs {
    /// Recording (.las, .laz, .pls, .plz, .sdf, .wfm, .arrow, .h5, .hdf5, .spd), job (.toml), the report of a run (JOB_report.json), or its folder
    pub(super) place: PathBuf,
    /// Port to listen on; 0: any free port
    #[arg(long, value_name = "PORT", default_value_t = 0)]
    pub(super) port: u16,
    /// Print the address, but do not open a browser
    #[arg(long)]
    pub(super) no_open: bool,
    /// Memory limit of the points, MB; beyond it, only a part of the shots is shown
    #[arg(long, value_name = "MB", default_value_t = 1000, value_parser = clap::value_parser!(u64).range(16..=1_000_000))]
    pub(super) memory_mb: u64,
    /// Override a key of the job, as for `wavex run`; may be repeated
    #[arg(long = "set", value_name = "STAGE.KEY=VALUE")]
    pub(super) set: Vec<String>,
}

/// Recordings to inspect and files to write.
#[derive(Args)]
pub(super) struct ScanArgs {
    /// Recordings: .las, .laz, .pls, .plz, .sdf, .wfm, .arrow, .h5, .hdf5 or .spd; each may be a pattern such as
    /// 'lines/*.sdf'
    #[arg(required = true, value_name = "FILE")]
    pub(super) files: Vec<String>,
    /// Skip samples: no noise, amplitudes or ranges
    ///
    /// Does not read waveform packets of LAS or the waves of PulseWaves, and ignores samples of
    /// containers. RIEGL's library, which reads SDF, still reads the samples.
    #[arg(long)]
    pub(super) fast: bool,
    /// Print the summary as JSON, one line per recording, with units in the names of its keys
    #[arg(long)]
    pub(super) json: bool,
    /// Write the summary with pictures as a page: STEM_scan.html in the current folder
    #[arg(long)]
    pub(super) page: bool,
    /// Write all files with this beginning of their names: NAME_scan.txt, NAME_scan.html, and the histograms
    /// NAME_angles.txt, NAME_amplitudes.txt, NAME_noise.txt and NAME_ranges.txt
    ///
    /// The name may contain a folder. With several recordings, the files are named NAME_STEM with the
    /// stem of each recording; if it ends in `/`, they are named after the stems in this folder.
    #[arg(short, long, alias = "name", value_name = "NAME")]
    pub(super) out: Option<String>,
    /// Override a key of the reader for this run, as for `wavex run`; may be repeated
    #[arg(long = "set", value_name = "STAGE.KEY=VALUE")]
    pub(super) set: Vec<String>,
    /// When to show progress; auto: a bar on a terminal
    #[arg(long, value_name = "WHEN", default_value = "auto")]
    pub(super) progress: When,
}

/// Trajectory to read and outputs to write.
#[derive(Args)]
pub(super) struct TrajectoryArgs {
    /// Trajectory; the format is recognised by content
    pub(super) file: PathBuf,
    /// Coordinate system of x y z: utm (zone of the first position), utm:33N, EPSG:2154, geodetic,
    /// ecef, or a file with WKT; for a TRJ, also the map projection of the file
    #[arg(long, value_name = "CRS", default_value = "utm")]
    pub(super) crs: String,
    /// Write every N-th record
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = every)]
    pub(super) every: usize,
    /// Table to write
    #[arg(short, long, value_name = "FILE")]
    pub(super) out: Option<PathBuf>,
    /// Picture to write
    #[arg(long, value_name = "FILE")]
    pub(super) svg: Option<PathBuf>,
    /// Columns of a text file, one letter each: t time, x longitude, y latitude, z height, w roll,
    /// p pitch, k heading; other letters skip a column
    #[arg(long, value_name = "LETTERS")]
    pub(super) columns: Option<String>,
    /// Time scale of the times [default: as the format defines]
    #[arg(long, value_name = "CLOCK")]
    pub(super) time: Option<ClockName>,
    /// Unit of roll, pitch and heading in a text file [default: deg]
    #[arg(long, value_name = "UNIT")]
    pub(super) angles: Option<AnglesName>,
    /// Accuracy file: POQ or smrmsg [default: the POQ next to a POF]
    #[arg(long, value_name = "FILE")]
    pub(super) accuracy: Option<PathBuf>,
    /// Apply the corrections of a file for `corrections` in `[job.geometry]`
    #[arg(long, value_name = "FILE")]
    pub(super) corrections: Option<PathBuf>,
    /// Apply the corrections of this strip to all records [default: of each strip to its time]
    #[arg(long, value_name = "NAME", requires = "corrections")]
    pub(super) strip: Option<String>,
}

/// Time scale of a trajectory.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(super) enum ClockName {
    /// Seconds of the week
    Week,
    /// Seconds of the day
    Day,
    /// Seconds since 1980-01-06 minus 1e9
    Adjusted,
    /// Seconds since 1980-01-06
    Standard,
    /// Seconds of UTC since 1970-01-01
    Unix,
}

impl From<ClockName> for FileTime {
    fn from(name: ClockName) -> FileTime {
        match name {
            ClockName::Week => FileTime::Week,
            ClockName::Day => FileTime::Day,
            ClockName::Adjusted => FileTime::Adjusted,
            ClockName::Standard => FileTime::Standard,
            ClockName::Unix => FileTime::Unix,
        }
    }
}

/// Angle unit.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(super) enum AnglesName {
    /// Degrees
    Deg,
    /// Radians
    Rad,
}

impl From<AnglesName> for Angles {
    fn from(name: AnglesName) -> Angles {
        match name {
            AnglesName::Deg => Angles::Degrees,
            AnglesName::Rad => Angles::Radians,
        }
    }
}

/// Parses a whole number from 0.
fn whole<N: std::str::FromStr>(text: &str) -> Result<N, String> {
    text.parse().map_err(|_| "give a whole number of at least 0".to_owned())
}

/// Parses a time, s.
fn seconds(text: &str) -> Result<f64, String> {
    let with_point = text.replace(',', ".");
    match (text.parse(), with_point.parse::<f64>()) {
        (Ok(time_s), _) => Ok(time_s),
        (Err(_), Ok(_)) => Err(format!("write a decimal point: {with_point}")),
        (Err(_), Err(_)) => Err("give GPS seconds on the time scale of the recording, as in the column \
                             `gps_time_s` of write_table"
            .to_owned()),
    }
}

/// Parses a count of at least 1.
pub(super) fn every(text: &str) -> Result<usize, String> {
    text.parse()
        .ok()
        .filter(|every| *every >= 1)
        .ok_or_else(|| "give a whole number of at least 1".to_owned())
}

/// Classic command line to translate and what to do with the job.
#[derive(Args)]
pub(super) struct ImportArgs {
    /// Version of the classic program [default: 1.0 if the input is LAS or LAZ, else 1.1]
    #[arg(long, value_name = "VERSION")]
    pub(super) classic: Option<Classic>,
    /// Run the job instead of printing it
    #[arg(long)]
    pub(super) run: bool,
    /// File to write the job to; must not exist yet
    #[arg(short, long, value_name = "FILE")]
    pub(super) output: Option<PathBuf>,
    /// Classic command line, after `--`; the program name may be omitted
    #[arg(last = true, required = true, value_name = "LINE")]
    pub(super) line: Vec<String>,
}

/// Version of the classic program.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(super) enum Classic {
    /// Full-waveform LAS in, LAS 1.2 out
    #[value(name = "1.0")]
    V10,
    /// SDF in, LAS 1.4 out
    #[value(name = "1.1")]
    V11,
}

impl Classic {
    pub(super) fn name(self) -> &'static str {
        match self {
            Classic::V10 => "1.0",
            Classic::V11 => "1.1",
        }
    }
}

/// Job to run and keys to override.
#[derive(Args)]
pub(super) struct JobArgs {
    /// Job file (TOML); `-` for standard input
    pub(super) job: PathBuf,
    /// Override a key of the job for this run: STAGE is the stage's id or type, or `job`; may be
    /// repeated
    #[arg(long = "set", value_name = "STAGE.KEY=VALUE")]
    pub(super) set: Vec<String>,
}

/// Threads, profiling and progress of a run.
#[derive(Args, Clone, Copy)]
pub(super) struct MachineArgs {
    /// Number of worker threads; 0: one per core [default: the job's `threads`]
    #[arg(long, value_name = "N", allow_negative_numbers = true, value_parser = whole::<usize>)]
    pub(super) threads: Option<usize>,
    /// Print the time of each stage per scan line at the end, and write a Perfetto trace
    /// (JOB_trace.json)
    #[arg(long)]
    pub(super) profile: bool,
    /// When to show progress; auto: a bar on a terminal, lines elsewhere
    #[arg(long, value_name = "WHEN", default_value = "auto")]
    pub(super) progress: When,
}

/// What files are compared by to recognise changes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(super) enum ResumeCheck {
    /// Size and modification time
    Time,
    /// BLAKE3 digest
    Digest,
}

/// Whether all inputs of a job must be there.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(super) enum InputRule {
    /// A problem with an input is a warning
    Optional,
    /// A problem with an input is an error: exit status 2
    Required,
}

/// When to show progress.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(super) enum When {
    /// A bar on a terminal, lines elsewhere
    Auto,
    /// A bar
    Always,
    /// A JSON object per second
    Json,
    /// Nothing
    Never,
}

/// Job to plan, folder of the plan and resources of its tasks.
#[derive(Args)]
pub(super) struct PlanArgs {
    #[command(flatten)]
    pub(super) job: JobArgs,
    /// Folder to write: a new one, or that of an earlier plan of the job
    #[arg(short, long, value_name = "FOLDER")]
    pub(super) output: PathBuf,
    /// Cores per task [default: the job's `threads`, or 4]
    #[arg(long, value_name = "N", value_parser = every)]
    pub(super) cores: Option<usize>,
    /// Throughput of one core, MB of input per second, for the estimated time
    #[arg(long, value_name = "RATE", default_value_t = 5.0, value_parser = rate)]
    pub(super) mb_per_s: f64,
    /// Archive of the whole survey that `wavex collect` makes, as `wavex run --archive`
    #[arg(long, value_name = "ARCHIVE")]
    pub(super) archive: Option<PathBuf>,
    /// Folder of the alignment of all strips that `wavex collect` makes, as `wavex align -o`; needs `write_patches`
    #[arg(long, value_name = "FOLDER")]
    pub(super) align: Option<PathBuf>,
    #[command(flatten, next_help_heading = "Options of the alignment")]
    pub(super) alignment: AlignmentArgs,
}

/// Plan to collect.
#[derive(Args)]
pub(super) struct CollectArgs {
    /// Folder of the plan
    pub(super) plan: PathBuf,
    /// Compare inputs and outputs by content instead of size
    #[arg(long)]
    pub(super) digest: bool,
    /// Make no archive and no alignment yet
    #[arg(long)]
    pub(super) no_archive: bool,
}

/// Parses a positive number.
fn rate(text: &str) -> Result<f64, String> {
    let positive = text.parse().ok().filter(|rate: &f64| *rate > 0.0 && rate.is_finite());
    positive.ok_or_else(|| "give a positive number".to_owned())
}

/// What is estimated, and what is known besides the job.
#[derive(Args)]
pub(super) struct AlignmentArgs {
    /// Corrections of each strip's trajectory: none, constant, linear, or linear between knots at most this many
    /// seconds apart
    #[arg(long, value_name = "none|constant|linear|SECONDS", default_value = "constant", value_parser = str::parse::<TrajectoryModel>)]
    pub(super) trajectory: TrajectoryModel,
    /// Control points: a CSV file with the columns name, east_m, north_m (or longitude_deg, latitude_deg),
    /// ellipsoidal_height_m (or height_above_geoid_m), sd_east_m, sd_north_m, sd_height_m, and for known planes slope_deg,
    /// aspect_deg
    #[arg(long, value_name = "FILE")]
    pub(super) control: Option<PathBuf>,
    /// Coordinate reference system of the control points: utm:33N, EPSG:2154, geodetic, or a WKT file [default: the
    /// `crs` of the job]
    #[arg(long, value_name = "CRS", requires = "control")]
    pub(super) control_crs: Option<String>,
    /// Strip whose trajectory is not corrected: the others are aligned to it; may be repeated. Of several jobs, JOB/STRIP
    #[arg(long, value_name = "STRIP")]
    pub(super) reference: Vec<String>,
    /// Estimate these parameters too, separated by commas: e1 (range scale), e2, e3, e4 (scan angle scale, quadratic,
    /// cubic)
    #[arg(long, value_name = "NAMES", value_delimiter = ',', value_parser = optional_parameter)]
    pub(super) estimate: Vec<OptionalParameter>,
}

/// Survey to align.
#[derive(Args)]
pub(super) struct AlignArgs {
    /// Job of the survey (TOML), `-` for standard input; several jobs if strips were flown with several mounts; or clouds of
    /// points without trajectory: .las and .laz files, or folders or patterns of them
    #[arg(required = true, value_name = "JOB|CLOUD")]
    pub(super) inputs: Vec<PathBuf>,
    /// Override a key of the job for this run: STAGE is the stage's id or type, or `job`; may be
    /// repeated
    #[arg(long = "set", value_name = "STAGE.KEY=VALUE")]
    pub(super) set: Vec<String>,
    /// Folder to write: report (align.json, align.html) and, of a job, calibration, corrections and residuals, of clouds,
    /// corrections.csv; existing files are replaced. Of several jobs, calibration and corrections of each are in a folder with
    /// its name
    #[arg(short, long, value_name = "FOLDER")]
    pub(super) output: PathBuf,
    #[command(flatten)]
    pub(super) alignment: AlignmentArgs,
    /// Use the files *_patches.arrow of earlier runs instead of the recordings: files, or folders with them
    #[arg(long, value_name = "PATH", num_args = 1..)]
    pub(super) patches: Vec<PathBuf>,
    /// Start from the returns files that `write_returns` wrote in an earlier run, without decomposing again
    #[arg(long)]
    pub(super) from_returns: bool,
    /// Then write corrected points: of a job, its outputs with the new files, from the returns files of an earlier run; of
    /// clouds, moved copies in the folder
    ///
    /// Outputs of a job are those of `wavex run` with the new files. Nothing is written after a bad alignment.
    #[arg(long)]
    pub(super) apply: bool,
    /// SD of the position of each strip of clouds, metres [default: 0.1]
    #[arg(long, value_name = "METRES", value_parser = position_sd)]
    pub(super) position_sd: Option<f64>,
    /// Take the points of each point source ID of a cloud as a strip; a single cloud is always split
    #[arg(long)]
    pub(super) by_source: bool,
    /// Number of worker threads; 0: one per core [default: the job's `threads`]
    #[arg(long, value_name = "N", allow_negative_numbers = true, value_parser = whole::<usize>)]
    pub(super) threads: Option<usize>,
    /// When to show progress; auto: a bar on a terminal, lines elsewhere
    #[arg(long, value_name = "WHEN", default_value = "auto")]
    pub(super) progress: When,
}

impl AlignmentArgs {
    /// What is known or asked besides the job.
    pub(super) fn constraints(&self) -> AlignConstraints {
        AlignConstraints {
            control: self.control.clone(),
            control_crs: self.control_crs.clone(),
            references: self.reference.clone(),
            estimate: self.estimate.clone(),
        }
    }
}

/// Clouds to classify.
#[derive(Args)]
pub(super) struct ClassifyArgs {
    /// Clouds of points: .las and .laz files (COPC too), or folders or patterns of them
    #[arg(required = true, value_name = "CLOUD")]
    pub(super) inputs: Vec<PathBuf>,
    /// File to write for one cloud; folder for several, with the same names; existing files are replaced
    #[arg(short, long, value_name = "FILE|FOLDER")]
    pub(super) output: PathBuf,
    /// Classes of points that stay as they are, separated by commas
    #[arg(long, value_name = "CLASSES", value_delimiter = ',')]
    pub(super) keep: Vec<u8>,
    /// Report to write: points of each class before and after
    #[arg(long, value_name = "FILE.json")]
    pub(super) report: Option<PathBuf>,
    /// Terrain model of all clouds to write: heights with standard deviations
    #[arg(long, value_name = "FILE.tif")]
    pub(super) dem: Option<PathBuf>,
    /// Surface model to write: highest first return of each cell, which is neither noise nor withheld
    #[arg(long, value_name = "FILE.tif", requires = "dem")]
    pub(super) surface: Option<PathBuf>,
    /// Canopy heights to write: surface minus terrain
    #[arg(long, value_name = "FILE.tif", requires = "dem")]
    pub(super) canopy: Option<PathBuf>,
    /// Edge of the cells of all models, m
    #[arg(long, value_name = "M", default_value_t = 1.0, requires = "dem", value_parser = cell_m)]
    pub(super) cell: f64,
    /// Memory limit of the points that are classified at once, MB; a tile of dense points needs about 1200
    #[arg(long, value_name = "MB", default_value_t = 2400, value_parser = clap::value_parser!(u64).range(16..=1_000_000))]
    pub(super) memory_mb: u64,
    /// Number of worker threads; 0: one per core
    #[arg(long, value_name = "N", default_value_t = 0, allow_negative_numbers = true, value_parser = whole::<usize>)]
    pub(super) threads: usize,
    /// When to show progress; auto: a bar on a terminal, lines elsewhere
    #[arg(long, value_name = "WHEN", default_value = "auto")]
    pub(super) progress: When,
}

/// Parses the size of cells.
fn cell_m(text: &str) -> Result<f64, String> {
    let cell_m = text.parse().ok().filter(|cell_m: &f64| (0.05..=100.0).contains(cell_m));
    cell_m.ok_or_else(|| "give metres from 0.05 to 100".to_owned())
}

/// Parses the name of a parameter that is estimated only if asked.
fn optional_parameter(text: &str) -> Result<OptionalParameter, String> {
    OptionalParameter::of_name(text).ok_or_else(|| {
        "give e1, e2, e3 or e4; e0 and e7 are estimated anyway, and e6 equals the boresight roll".into()
    })
}

/// Parses the SD of positions.
fn position_sd(text: &str) -> Result<f64, String> {
    let sd_m = text.parse().ok().filter(|sd_m: &f64| (0.001..=10.0).contains(sd_m));
    sd_m.ok_or_else(|| "give metres from 0.001 to 10".to_owned())
}

/// Folders and limits of a survey.
#[derive(Args)]
pub(super) struct SurveyArgs {
    /// Output folders of the runs: all *_cells.arrow in them are strips of the survey
    #[arg(required = true, value_name = "FOLDER")]
    pub(super) folders: Vec<PathBuf>,
    /// Page; a JSON file and rasters get the same name [default: survey.html in the first folder]
    #[arg(short, long, value_name = "FILE.html")]
    pub(super) out: Option<PathBuf>,
    /// Job whose `[job.survey]` has the limits [default: the defaults of the keys]
    #[arg(long, value_name = "FILE")]
    pub(super) job: Option<PathBuf>,
    /// Override a key of the job, as for `wavex run`, such as job.survey.min_points=8; may be repeated
    #[arg(long = "set", value_name = "STAGE.KEY=VALUE", requires = "job")]
    pub(super) set: Vec<String>,
}

//! The arguments of every command.

use std::path::PathBuf;

use clap::{ArgAction, Args, Parser, Subcommand, ValueEnum};

use super::usage;
use crate::formats::trajectory::Angles;
use crate::geo::time_axis::Clock;

/// Turns recorded full-waveform lidar into point clouds.
#[derive(Parser)]
#[command(name = "wavex", version, after_help = EXIT_CODES)]
pub(super) struct Cli {
    #[command(subcommand)]
    pub(super) command: Command,
    #[command(flatten)]
    pub(super) loudness: Loudness,
}

const EXIT_CODES: &str = "Exit status: 0 done; 1 the run failed; 2 the job or the command line is wrong";

/// How much is said besides results and errors.
#[derive(Args, Clone, Copy)]
pub(super) struct Loudness {
    /// Say more: -v tells what is done, -vv also the details
    #[arg(short, long, global = true, action = ArgAction::Count)]
    pub(super) verbose: u8,
    /// Say nothing but errors
    #[arg(short, long, global = true, conflicts_with = "verbose")]
    pub(super) quiet: bool,
}

#[derive(Subcommand)]
pub(super) enum Command {
    /// Run a job
    ///
    /// Relative paths in the job start at its folder, or at its `input_dir` and `output_dir`. Outputs get their names
    /// only when the whole run has succeeded.
    #[command(after_help = usage::RUN)]
    Run {
        #[command(flatten)]
        job: JobArgs,
        #[command(flatten)]
        machine: Machine,
        /// Keep how the outputs were made: a new folder, or a file whose name ends in .tar.zst
        ///
        /// The job as written and as resolved, the digests of all inputs and outputs, the sensor model, versions, the
        /// machine, the report, the statistics of scan lines, and the log.
        #[arg(long, value_name = "ARCHIVE")]
        archive: Option<PathBuf>,
    },
    /// Run an archived job again, and say whether it gives the same outputs to the bit
    ///
    /// Runs into a temporary folder (TMPDIR says where), after the archive and its inputs were found to be as they were. Exit
    /// status 1 where something differs: which file, and the first difference in its own terms.
    #[command(after_help = usage::REPLAY)]
    Replay {
        #[command(flatten)]
        archived: ArchiveArgs,
        /// How many threads work at once; 0: one for each core [default: as many as then]
        #[arg(long, value_name = "N")]
        threads: Option<usize>,
        /// Whether to show how far the run is; auto: a bar on a terminal, lines elsewhere
        #[arg(long, value_name = "WHEN", default_value = "auto")]
        progress: When,
    },
    /// Say whether an archive, its inputs and its outputs are as they were, by their digests alone
    #[command(after_help = usage::VERIFY)]
    Verify {
        #[command(flatten)]
        archived: ArchiveArgs,
        /// The seal that was written down when the archive was made: another one is an error
        ///
        /// 64 hexadecimal digits, as `wavex run --archive` prints them. Whoever changes an archive can seal it anew, but not with
        /// this number.
        #[arg(long, value_name = "HEX", value_parser = seal)]
        seal: Option<String>,
    },
    /// Validate a job without reading data: its keys, its chain, its folders, and which inputs are missing
    #[command(after_help = usage::CHECK)]
    Check {
        #[command(flatten)]
        job: JobArgs,
    },
    /// List the stages, or explain one with all its keys
    #[command(after_help = usage::STAGES)]
    Stages {
        /// The stage to explain
        name: Option<String>,
    },
    /// Print the JSON Schema of a job, for editors that check and complete TOML
    ///
    /// Save it as job.schema.json and begin a job with the line `#:schema job.schema.json`.
    #[command(after_help = usage::SCHEMA)]
    Schema,
    /// Write a commented job to start from
    ///
    /// With --from, the job for this recording: its format, its instrument and its frame choose the stages. The schema for editors
    /// is written beside the job, as job.schema.json.
    #[command(after_help = usage::INIT)]
    Init {
        /// The file to write, which must not exist yet; standard output when not given
        file: Option<PathBuf>,
        /// The recording that the job is for
        #[arg(long, value_name = "RECORDING")]
        from: Option<PathBuf>,
    },
    /// Calibrate from a recording, and save the sensor model for others
    ///
    /// Reads the whole recording, prints noise, background and pulse width of each receiver, and writes the model as JSON. Jobs use
    /// it by `load` of `calibrate`. docs/how-to/calibrate-once.md says how to make and share one.
    #[command(after_help = usage::CALIBRATE)]
    Calibrate(CalibrateArgs),
    /// Copy recorded waveforms into the open container (Arrow)
    #[command(after_help = usage::CONVERT)]
    Convert {
        /// The recording: .las, .laz, .pls, .sdf, .wfm or .arrow; a pattern in quotation marks means several
        input: String,
        /// The container to write: .arrow; with several inputs, `*` stands for the name of each
        output: String,
        #[command(flatten)]
        machine: Machine,
    },
    /// Copy points into a cloud-optimised file (COPC), which viewers read in parts
    ///
    /// Takes LAS and LAZ of point formats 6 to 10, as `write_las` makes them. All points stay as they are to the bit, with
    /// extra attributes and coordinate system; waveforms stay behind.
    #[command(after_help = usage::COPC)]
    Copc {
        /// The points: .las or .laz
        input: PathBuf,
        /// The file to write [default: NAME.copc.laz beside the points]
        #[arg(short, long, value_name = "FILE")]
        out: Option<PathBuf>,
    },
    /// Print how many returns of noise alone each threshold lets through
    ///
    /// The table to choose `detection_sigma` by: false returns per waveform, by threshold and correlation of the noise.
    #[command(after_help = usage::FALSE_ALARMS)]
    FalseAlarms(FalseAlarmArgs),
    /// Show one shot: its samples, the fit, what the fit leaves, and its returns
    ///
    /// Calibrates from the recording as a run would, decomposes one shot, prints its returns with their standard
    /// deviations, and draws a picture (SVG, which any browser shows).
    #[command(after_help = usage::EXPLAIN)]
    Explain(ExplainArgs),
    /// Tell what a recording holds: times, rates, lines, channels, noise, integrity
    ///
    /// Prints a summary and writes it beside histograms as text and a page with pictures: NAME_scan.txt, NAME_scan.html,
    /// NAME_angles.txt, NAME_amplitudes.txt, NAME_noise.txt and NAME_ranges.txt.
    #[command(after_help = usage::SCAN)]
    Scan(ScanArgs),
    /// Show what a run did as a page: where the time went, counts, sensor model, warnings
    ///
    /// The page is one file (HTML) without scripts, which needs no network.
    #[command(after_help = usage::REPORT)]
    Report {
        /// The report.json of a run, or the folder it is in
        place: PathBuf,
        /// The page [default: beside the report, as report.html]
        #[arg(short, long, value_name = "FILE")]
        out: Option<PathBuf>,
    },
    /// Project and thin a trajectory: SBET, POF, SOL, TRJ or a text
    ///
    /// Prints a summary; writes, where asked to, a table of the columns t lon lat h x y z w p k, and a picture (SVG).
    #[command(after_help = usage::TRAJECTORY)]
    Trajectory(TrajectoryArgs),
    /// Translate a command line of BayesWavEx 1.0 or 1.1 into a job
    ///
    /// Prints the job; every key says which option it comes from, and what has no key stands there as a comment.
    /// docs/import.md lists all options.
    #[command(after_help = usage::IMPORT)]
    Import(ImportArgs),
    /// Print the completions of a shell
    #[command(after_help = usage::COMPLETIONS)]
    Completions {
        /// The shell
        shell: clap_complete::Shell,
    },
}

/// Which archive, and where its files are.
#[derive(Args)]
pub(super) struct ArchiveArgs {
    /// The archive: a folder, or a file whose name ends in .tar.zst
    pub(super) archive: PathBuf,
    /// Where the inputs are now [default: where the archive says]
    #[arg(long, value_name = "FOLDER")]
    pub(super) inputs: Option<PathBuf>,
    /// Where the outputs are now [default: where the archive says]
    #[arg(long, value_name = "FOLDER")]
    pub(super) outputs: Option<PathBuf>,
}

/// Which recording, and where its model goes.
#[derive(Args)]
pub(super) struct CalibrateArgs {
    /// The recording: .las, .laz, .pls, .sdf, .wfm or .arrow
    pub(super) file: PathBuf,
    /// The sensor model to write (.json)
    #[arg(long, value_name = "NAME.json")]
    pub(super) save_preset: Option<PathBuf>,
    /// Set a key of the reader or of calibrate, this time: as for `wavex run`; may be repeated
    #[arg(long = "set", value_name = "STAGE.KEY=VALUE")]
    pub(super) set: Vec<String>,
    #[command(flatten)]
    pub(super) machine: Machine,
}

/// Which noise, and which thresholds.
#[derive(Args)]
pub(super) struct FalseAlarmArgs {
    /// Correlations of the noise, one column each: 0.6 from one sample to the next, or 0.63:0.42:0.22 at several lags
    #[arg(long, num_args = 1.., value_delimiter = ',', allow_negative_numbers = true)]
    #[arg(value_name = "RHO", default_values = ["0", "0.3", "0.6", "0.63:0.42:0.22:0.11"])]
    pub(super) correlation: Vec<String>,
    /// Thresholds, one row each
    #[arg(long, num_args = 1.., value_delimiter = ',', allow_negative_numbers = true)]
    #[arg(value_name = "SIGMA", default_values_t = [3.5, 4.0, 4.5, 5.0, 5.5, 6.0])]
    pub(super) sigma: Vec<f64>,
    /// Full width at half maximum of a pulse, samples
    #[arg(long, default_value_t = 4.5, allow_negative_numbers = true)]
    pub(super) fwhm: f64,
    /// Samples of a waveform
    #[arg(long, default_value_t = 60.0, allow_negative_numbers = true)]
    pub(super) samples: f64,
}

/// Which shot of which recording, and how it is decomposed.
#[derive(Args)]
#[command(group = clap::ArgGroup::new("which").required(true))]
pub(super) struct ExplainArgs {
    /// The recording: .las, .laz, .pls, .sdf, .wfm or .arrow
    pub(super) file: PathBuf,
    /// The shot's number, as in the column `shot` of write_table
    #[arg(long, value_name = "N", group = "which")]
    pub(super) shot: Option<u64>,
    /// The shot nearest to this time, as in the column `gps_time_s` of write_table
    #[arg(long, value_name = "GPS_SECONDS", group = "which", allow_negative_numbers = true)]
    pub(super) time: Option<f64>,
    /// Take the keys of the stages up to decompose from this job; of its reader, too, where that reads such files
    #[arg(long, value_name = "FILE")]
    pub(super) job: Option<PathBuf>,
    /// Set a key of the job, this time: as for `wavex run`; may be repeated
    #[arg(long = "set", value_name = "STAGE.KEY=VALUE")]
    pub(super) set: Vec<String>,
    /// A sensor model that `save` of calibrate has written: nothing is calibrated anew
    #[arg(long, value_name = "FILE")]
    pub(super) model: Option<PathBuf>,
    /// The picture to write [default: STEM_shot_N.svg in the current folder]
    #[arg(long, value_name = "FILE")]
    pub(super) out: Option<PathBuf>,
}

/// Which recording, and how closely it is looked at.
#[derive(Args)]
pub(super) struct ScanArgs {
    /// The recordings: .las, .laz, .pls, .sdf, .wfm or .arrow; each may be a pattern, as 'lines/*.sdf'
    #[arg(required = true, value_name = "FILE")]
    pub(super) files: Vec<String>,
    /// Do not look at samples: nothing on noise, amplitudes and ranges
    ///
    /// Waveform packets of LAS and the .wvs file of PulseWaves stay unread, samples of containers are not looked at;
    /// RIEGL's library, which reads SDF, does so all the same.
    #[arg(long)]
    pub(super) fast: bool,
    /// What the files written are named after; may begin with a folder [default: STEM in the current folder]
    ///
    /// Those of several recordings are named after NAME and each recording's stem: NAME_STEM.
    #[arg(long, value_name = "NAME")]
    pub(super) name: Option<String>,
    /// Set a key of the reader, this time: as for `wavex run`; may be repeated
    #[arg(long = "set", value_name = "STAGE.KEY=VALUE")]
    pub(super) set: Vec<String>,
}

/// Which trajectory, and what becomes of it.
#[derive(Args)]
pub(super) struct TrajectoryArgs {
    /// The trajectory; its content tells the format
    pub(super) file: PathBuf,
    /// The coordinates x y z: utm (zone of the first place), utm:33N, EPSG:2154, geodetic, ecef or a file with WKT; of a TRJ
    /// also its own map
    #[arg(long, value_name = "CRS", default_value = "utm")]
    pub(super) crs: String,
    /// Write one record of so many
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = every)]
    pub(super) every: usize,
    /// The table to write
    #[arg(short, long, value_name = "FILE")]
    pub(super) out: Option<PathBuf>,
    /// The picture to write
    #[arg(long, value_name = "FILE")]
    pub(super) svg: Option<PathBuf>,
    /// What the columns of a text are: t time, x longitude, y latitude, z height, w roll, p pitch, k heading, others skip
    #[arg(long, value_name = "LETTERS")]
    pub(super) columns: Option<String>,
    /// What times count [default: as the format says]
    #[arg(long, value_name = "CLOCK")]
    pub(super) time: Option<ClockName>,
    /// Unit of roll, pitch and heading in a text [default: deg]
    #[arg(long, value_name = "UNIT")]
    pub(super) angles: Option<AnglesName>,
    /// The file of accuracies: POQ or smrmsg [default: the POQ beside a POF]
    #[arg(long, value_name = "FILE")]
    pub(super) accuracy: Option<PathBuf>,
}

/// What times count.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(super) enum ClockName {
    /// Seconds of the week
    Week,
    /// Seconds of the day
    Day,
    /// Seconds since 1980-01-06 less 1e9
    Adjusted,
}

impl From<ClockName> for Clock {
    fn from(name: ClockName) -> Clock {
        match name {
            ClockName::Week => Clock::Week,
            ClockName::Day => Clock::Day,
            ClockName::Adjusted => Clock::Adjusted,
        }
    }
}

/// A unit of angles.
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

/// A digest in hexadecimal digits.
fn seal(text: &str) -> Result<String, String> {
    let is_digest = text.len() == 64 && text.bytes().all(|byte| byte.is_ascii_hexdigit());
    is_digest.then(|| text.to_ascii_lowercase()).ok_or_else(|| {
        "a seal has 64 hexadecimal digits, as `wavex run --archive` prints them at its end".to_owned()
    })
}

/// A count of at least 1.
fn every(text: &str) -> Result<usize, String> {
    text.parse().ok().filter(|every| *every >= 1).ok_or_else(|| "give a whole number from 1 on".to_owned())
}

/// Which classic line, and what becomes of it.
#[derive(Args)]
pub(super) struct ImportArgs {
    /// The version that the line is for [default: 1.0 where the input is LAS or LAZ, else 1.1]
    #[arg(long, value_name = "VERSION")]
    pub(super) classic: Option<Classic>,
    /// Run the job instead of printing it
    #[arg(long)]
    pub(super) run: bool,
    /// Write the job into this file, which must not exist yet
    #[arg(short, long, value_name = "FILE")]
    pub(super) output: Option<PathBuf>,
    /// The line as it was typed, behind `--`; the program's name may be left out
    #[arg(last = true, required = true, value_name = "LINE")]
    pub(super) line: Vec<String>,
}

/// A version of the classic program.
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

/// Which job, and what is different this time.
#[derive(Args)]
pub(super) struct JobArgs {
    /// The job's file (TOML); `-` for standard input
    pub(super) job: PathBuf,
    /// Set a key of the job, this time: STAGE is the stage's id or type, or `job`; may be repeated
    #[arg(long = "set", value_name = "STAGE.KEY=VALUE")]
    pub(super) set: Vec<String>,
}

/// What a run does with the machine and with the terminal.
#[derive(Args, Clone, Copy)]
pub(super) struct Machine {
    /// How many threads work at once; 0: one for each core [default: the job's `threads`]
    #[arg(long, value_name = "N")]
    pub(super) threads: Option<usize>,
    /// Say at the end how long each stage took per scan line, and write a trace for Perfetto (trace.json)
    #[arg(long)]
    pub(super) profile: bool,
    /// Whether to show how far the run is; auto: a bar on a terminal, lines elsewhere
    #[arg(long, value_name = "WHEN", default_value = "auto")]
    pub(super) progress: When,
}

/// Whether to show progress.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(super) enum When {
    /// A bar on a terminal, lines elsewhere
    Auto,
    /// A bar
    Always,
    /// Nothing
    Never,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_seal_is_64_hexadecimal_digits() {
        assert_eq!(seal(&"aB".repeat(32)), Ok("ab".repeat(32)));
        for wrong in ["", "ab", &"ag".repeat(32), &"é".repeat(32)] {
            assert!(seal(wrong).unwrap_err().starts_with("a seal has 64 hexadecimal digits"), "{wrong}");
        }
    }
}

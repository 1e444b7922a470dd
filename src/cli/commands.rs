//! The commands of the command line.

use std::path::PathBuf;

use clap::{ArgAction, Args, Parser, Subcommand};

use super::args::{
    AlignArgs, ArchiveArgs, CalibrateArgs, ClassifyArgs, CollectArgs, ExplainArgs, ImportArgs, InputRule,
    JobArgs, MachineArgs, PlanArgs, ResumeCheck, ScanArgs, SurveyArgs, TrajectoryArgs, ViewArgs, When,
};
use super::false_alarms::FalseAlarmArgs;
use super::usage;

/// Turn full-waveform lidar recordings into point clouds
#[derive(Parser)]
#[command(name = "wavex", version, after_help = EXIT_CODES)]
pub(super) struct Cli {
    #[command(subcommand)]
    pub(super) command: Command,
    #[command(flatten)]
    pub(super) loudness: Loudness,
}

const EXIT_CODES: &str = "Exit status: 0 success; 1 the run failed; 2 the job or the command line is invalid";

/// Verbosity on standard error.
#[derive(Args, Clone, Copy)]
pub(super) struct Loudness {
    /// Print more messages: -v for progress, -vv for details
    #[arg(short, long, global = true, action = ArgAction::Count)]
    pub(super) verbose: u8,
    /// Print errors only
    #[arg(short, long, global = true, conflicts_with = "verbose")]
    pub(super) quiet: bool,
}

#[derive(Subcommand)]
pub(super) enum Command {
    /// Run a job
    ///
    /// Relative paths start at the job's folder, or at its `input_dir` and `output_dir`. Outputs
    /// get their final names only after all stages have succeeded on their input. If an input fails,
    /// the next one follows, unless the job has `on_error = "stop"`.
    #[command(after_help = usage::RUN)]
    Run {
        #[command(flatten)]
        job: JobArgs,
        #[command(flatten)]
        machine: MachineArgs,
        /// Archive how the outputs were made, in a new folder or a file that ends in .tar.zst
        ///
        /// The archive holds the job as written and as resolved, digests of all inputs and outputs,
        /// the sensor model, software versions, the machine, the report, the scan-line statistics,
        /// and the log.
        #[arg(long, value_name = "ARCHIVE")]
        archive: Option<PathBuf>,
        /// Skip inputs with complete outputs of an earlier run with the same version, job and files
        ///
        /// Reads the report of the earlier run. Prints which inputs are skipped, and why the others
        /// are not. --resume=digest compares files by content instead of size and time, and takes
        /// digests for the next run with --resume=digest.
        #[arg(long, value_name = "CHECK", num_args = 0..=1, require_equals = true)]
        #[arg(default_missing_value = "time", conflicts_with = "archive")]
        resume: Option<ResumeCheck>,
        /// Learn the sensor models of the survey again instead of keeping those of the earlier run
        ///
        /// All inputs are run again if that changes a model.
        #[arg(long, requires = "resume")]
        relearn: bool,
        /// Start from the returns files that `write_returns` wrote in an earlier run, without decomposing again
        ///
        /// For another trajectory, calibration or corrections: outputs have the bytes of a run of the whole job. Files that
        /// were made from another recording or by other stages are refused.
        #[arg(long)]
        from_returns: bool,
    },
    /// Plan a survey as tasks for several machines, one per input
    ///
    /// Writes a folder with the job of each input, its estimated cores, memory and time, and rules
    /// for Snakemake with profiles for one machine and for Slurm. All paths in it are relative.
    #[command(after_help = usage::PLAN)]
    Plan(PlanArgs),
    /// Check and merge the results of planned tasks
    ///
    /// Names every task that failed, was not run, or lacks an output. Merges reports, line
    /// statistics, digests and the archive of the others.
    #[command(after_help = usage::COLLECT)]
    Collect(CollectArgs),
    /// Run an archived job again and compare the outputs bit by bit
    ///
    /// First verifies the archive and its inputs, then runs into a temporary folder (see TMPDIR).
    /// If an output differs, prints the file and its first difference, and exits with status 1.
    #[command(after_help = usage::REPLAY)]
    Replay {
        #[command(flatten)]
        archived: ArchiveArgs,
        /// Seal noted when the archive was made; do not run if it differs
        ///
        /// An archived job may come from anyone, who may also have resealed it.
        #[arg(long, value_name = "HEX", value_parser = seal)]
        seal: Option<String>,
        /// Number of worker threads; 0: one per core [default: as in the archived run]
        #[arg(long, value_name = "N")]
        threads: Option<usize>,
        /// When to show progress; auto: a bar on a terminal, lines elsewhere
        #[arg(long, value_name = "WHEN", default_value = "auto")]
        progress: When,
    },
    /// Verify an archive, its inputs and its outputs by their digests
    #[command(after_help = usage::VERIFY)]
    Verify {
        #[command(flatten)]
        archived: ArchiveArgs,
        /// Seal noted when the archive was made; fail if it differs
        ///
        /// 64 hexadecimal digits, as `wavex run --archive` prints them. Anyone who changes an
        /// archive can reseal it, but the new seal differs from the noted one.
        #[arg(long, value_name = "HEX", value_parser = seal)]
        seal: Option<String>,
    },
    /// Validate a job without reading data: keys, chain, folders, inputs
    ///
    /// Prints number and size of the input files, the expected time, their pulses and the expected
    /// number of points if the headers have them, and the free disk space. Warns about missing and
    /// damaged inputs, and about trajectories that do not cover their recordings.
    #[command(after_help = usage::CHECK)]
    Check {
        #[command(flatten)]
        job: JobArgs,
        /// Whether all inputs must be there
        #[arg(long, value_name = "RULE", default_value = "optional")]
        inputs: InputRule,
    },
    /// List the stages, or describe one stage and its keys
    #[command(after_help = usage::STAGES)]
    Stages {
        /// Stage to describe
        name: Option<String>,
    },
    /// Print the JSON Schema of jobs, for editors that validate and complete TOML
    ///
    /// Save it as job.schema.json and start the job with the line `#:schema job.schema.json`.
    #[command(after_help = usage::SCHEMA)]
    Schema,
    /// Write a commented starter job
    ///
    /// With a recording, writes a job for it: its format, instrument and frame select the stages.
    /// Also writes the schema for editors, job.schema.json, to the folder of the job. Replaces no
    /// file.
    #[command(after_help = usage::INIT)]
    Init {
        /// Recording, job to write, or both; without a job, prints it
        #[arg(value_name = "RECORDING|JOB", num_args = 0..=2)]
        files: Vec<PathBuf>,
        /// Recording to write the job for
        #[arg(long, value_name = "RECORDING")]
        from: Option<PathBuf>,
    },
    /// Calibrate from a recording, or from all inputs of a job
    ///
    /// With a recording, reads all of it and prints noise, background and pulse width of each receiver.
    /// With --save-preset, writes the model as JSON; a job uses it with the key `load` of `calibrate`. With a job
    /// (.toml), takes waveforms from all its inputs and writes one model per instrument, which jobs use
    /// with the key `survey_model` of `[job]`. docs/how-to/calibrate-once.md describes both.
    #[command(after_help = usage::CALIBRATE)]
    Calibrate(CalibrateArgs),
    /// Copy recorded waveforms into the open container format (Arrow)
    #[command(after_help = usage::CONVERT)]
    Convert {
        /// Recording: .las, .laz, .pls, .plz, .sdf, .wfm, .arrow, .h5, .hdf5 or .spd; quote a pattern to convert several
        input: String,
        /// Container to write: .arrow; with several inputs, `*` is replaced by the name of each
        output: String,
        #[command(flatten)]
        machine: MachineArgs,
    },
    /// Convert points to a cloud-optimised point cloud (COPC)
    ///
    /// Reads LAS or LAZ of point formats 6 to 10, as `write_las` writes them. Copies all points bit
    /// by bit, with extra attributes and coordinate system, but without waveforms.
    #[command(after_help = usage::COPC)]
    Copc {
        /// Points: .las or .laz; several are converted one after the other, COPC files among them are left out
        #[arg(required = true)]
        inputs: Vec<PathBuf>,
        /// COPC file to write, for one input [default: NAME.copc.laz next to the input]
        #[arg(short, long, value_name = "FILE")]
        out: Option<PathBuf>,
        /// Write a STAC item next to it: NAME.copc.json
        #[arg(long)]
        stac: bool,
        /// When to show progress; auto: a bar on a terminal
        #[arg(long, value_name = "WHEN", default_value = "auto")]
        progress: When,
    },
    /// Print the false-return rate of pure noise for each threshold
    ///
    /// Use the table to choose `detection_sigma`: false returns per waveform, by threshold and
    /// noise correlation.
    #[command(after_help = usage::FALSE_ALARMS)]
    FalseAlarms(FalseAlarmArgs),
    /// Explain one shot: samples, fit, residuals and returns
    ///
    /// Calibrates from the recording as a run would, decomposes the shot, prints its returns with
    /// standard deviations, and draws a picture (SVG, readable by any browser).
    #[command(after_help = usage::EXPLAIN)]
    Explain(ExplainArgs),
    /// Summarise a recording: times, rates, lines, channels, noise, integrity
    ///
    /// Prints a summary. Writes files only with --page or --out.
    #[command(after_help = usage::SCAN)]
    Scan(ScanArgs),
    /// Render a run's report as a page: timing, counts, sensor model, warnings
    ///
    /// The page is one HTML file without scripts or network access.
    #[command(after_help = usage::REPORT)]
    Report {
        /// The report of a run (JOB_report.json), its folder, or its job (.toml)
        place: PathBuf,
        /// Page to write [default: JOB_report.html next to the report]
        #[arg(short, long, value_name = "FILE")]
        out: Option<PathBuf>,
    },
    /// Make the page of a survey from the strips of one or more runs
    ///
    /// The runs must have had `survey_page`. Writes page, JSON and rasters.
    #[command(after_help = usage::SURVEY)]
    Survey(SurveyArgs),
    /// Align the strips of a survey: calibration and corrections of trajectories
    ///
    /// Runs the job, or several jobs, over all inputs without outputs, and compares smooth surface where strips overlap.
    /// Writes boresight, lever arm and range offset as calibration.toml, corrections of each strip's trajectory as
    /// corrections.toml, all results with standard deviations as align.json and as a page (align.html), and the
    /// differences of all pairs of patches (residuals.arrow). Prints what the flight does not determine, and why.
    ///
    /// Clouds of points without trajectory (.las, .laz) get corrections of their positions, as corrections.csv, and with
    /// --apply are written moved. docs/how-to/align-a-survey.md describes it.
    #[command(after_help = usage::ALIGN)]
    Align(AlignArgs),
    /// Classify the ground of clouds of points: LAS, LAZ, COPC of any source
    ///
    /// Writes copies of the clouds in which only the classes differ: 1 unclassified, 2 ground, 7 low noise, 18 high noise
    /// (7 in point formats 0 to 5). Clouds are classified together, so give all strips of a survey. Points that are
    /// withheld, synthetic or noise according to the file keep their class. --dem also writes a terrain model.
    /// docs/how-to/ground-and-terrain.md describes it.
    #[command(after_help = usage::CLASSIFY)]
    Classify(ClassifyArgs),
    /// Project and decimate a trajectory: SBET, POF, SOL, TRJ or text
    ///
    /// Prints a summary. Optionally writes a table with the columns t lon lat h x y z w p k, and a
    /// picture (SVG).
    #[command(after_help = usage::TRAJECTORY)]
    Trajectory(TrajectoryArgs),
    /// Explore a recording, a job or a run's outputs in the browser: points, waveforms, fits
    ///
    /// Serves a page on this computer only (127.0.0.1), at an address with a random token, until Ctrl-C.
    /// Runs the job without its outputs; selected shots can be decomposed again with other keys. Nothing is
    /// written.
    #[command(after_help = usage::VIEW)]
    View(ViewArgs),
    /// Translate a command line of BayesWavEx 1.0 or 1.1 into a job
    ///
    /// Prints the job. A comment at each key names its option; options without a key become
    /// comments. docs/import.md lists all options.
    #[command(after_help = usage::IMPORT)]
    Import(ImportArgs),
    /// Check this machine: instructions, memory, disk space, libraries
    ///
    /// States what to do about what is missing. Fails if runs in this folder will fail.
    #[command(after_help = usage::DOCTOR)]
    Doctor,
    /// Write the manual pages, one per command
    #[command(after_help = usage::MAN)]
    Man {
        /// Folder of the pages; it is created
        folder: PathBuf,
    },
    /// Print a shell completion script
    #[command(after_help = usage::COMPLETIONS)]
    Completions {
        /// Shell to print completions for
        shell: clap_complete::Shell,
    },
}

/// Parses a seal: 64 hexadecimal digits, returned in lower case.
fn seal(text: &str) -> Result<String, String> {
    let is_digest = text.len() == 64 && text.bytes().all(|byte| byte.is_ascii_hexdigit());
    is_digest.then(|| text.to_ascii_lowercase()).ok_or_else(|| {
        "a seal has 64 hexadecimal digits, as `wavex run --archive` prints them at the end".to_owned()
    })
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

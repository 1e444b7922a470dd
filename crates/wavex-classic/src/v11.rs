//! Version 1.1 (2018): SDF to LAS 1.4.
//!
//! Options in the order of its documentation.

use super::options::Becomes::{Command, End, Flag, Key, Nothing, Part};
use super::options::Form::{
    Angles, File, Plain, Remarked, Switch, TrajectoryColumns, ZeroIs, ZeroIsNothing, Zone,
};
use super::options::Standard::{Same, Words, Written};
use super::options::Takes::{Date, Number, Switch as OnOff, Text, Texts, Whole};
use super::options::{Flag as F, Opt, Part as P, Version, row};
use wavex_formats::extensions::{LAS, LAZ};

/// Definition of the version.
pub const V11: Version = Version {
    name: "1.1",
    options: OPTIONS,
    chain: &[
        "resolve_mta",
        "fuse_channels",
        "calibrate",
        "decompose",
        "correct",
        "filter_outliers",
        "georeference",
        "write_las",
        "write_ascii",
        "write_trajectory",
        "write_lstat",
    ],
    always: &[("write_las", "attribute_layout", "\"1.1\"", "1.1")],
    option_files: &["wavex.opt.txt", "wavex.opt", "stripalign.opt"],
    output: "*.laz",
    line_stats: "_lstat.txt",
    has_stat_log: true,
    writes_trajectory: true,
};

#[rustfmt::skip]
const OPTIONS: &[Opt] = &[
    // Folders, machine, behaviour.
    row(&["I", "idir"], Text("a folder"), Words("the current one"), Part(P::InputDir), "`[job] input_dir`; not applied to a file that contains a folder"),
    row(&["O", "odir"], Text("a folder"), Words("the current one"), Part(P::OutputDir), "`[job] output_dir`"),
    row(&["mem"], Whole(1, u64::MAX), Same("1024"), Key("job", "memory_mb", Plain), ""),
    row(&["N", "nthreads"], Whole(0, u64::MAX), Words("one per core"), Key("job", "threads", Plain), ""),
    row(&["q", "quiet"], OnOff, Same("0"), Flag(F::Quiet, true), ""),
    row(&["progress"], OnOff, Same("1"), Flag(F::NoProgress, false), ""),
    // Input and output.
    row(&["i", "input"], Texts("a file, several, or a pattern"), Words("required"), Part(P::Input), "`path` of the reader for the extension"),
    row(&["o", "out"], Text("a name, `*` for the name of the input"), Words("*.laz"), Part(P::Output), "`path` of `write_las`, or of `write_ascii` if it ends in .txt; prefix of all other outputs"),
    row(&["olas"], OnOff, Same("0"), Part(P::Extension(LAS)), "the output ends in .las"),
    row(&["olaz"], OnOff, Same("0"), Part(P::Extension(LAZ)), "the output ends in .laz"),
    row(&["otxt"], OnOff, Same("0"), Part(P::Extension("txt")), "`write_ascii` instead of `write_las`"),
    row(&["oparse"], Text("a letter for each column"), Words("none"), Part(P::Columns), "`columns` of `write_ascii`"),
    row(&["oext"], OnOff, Same("1"), Key("write_las", "extra_attributes", Plain), ""),
    row(&["ounc"], OnOff, Same("1"), Key("write_las", "uncertainty", Plain), ""),
    row(&["o12"], OnOff, Same("0"), Key("write_las", "version", Switch("\"1.4\"", "\"1.2\"")), ""),
    row(&["olax"], OnOff, Same("0"), Part(P::Index), "`index` of `write_las`: \"file\""),
    row(&["lax_append"], OnOff, Same("0"), Part(P::IndexWithin), "`index` of `write_las`: \"appended\", with or without `-olax`; \"file\" if the output is LAS, which cannot contain an index"),
    row(&["nil"], OnOff, Same("0"), Part(P::NoPoints), "no sink for points"),
    // Logs and texts.
    row(&["log"], OnOff, Same("1"), Key("job", "log", Switch("\"\"", "")), ""),
    row(&["log_flush"], OnOff, Same("0"), Nothing("every log line is written immediately"), ""),
    row(&["clear_log", "clear_log_history"], OnOff, Same("0"), Nothing("logs are next to the outputs and keep no history"), ""),
    row(&["olstat", "lstat"], OnOff, Same("0"), Part(P::LineStats), "`write_lstat`"),
    row(&["otraj"], OnOff, Words("1"), Part(P::Trajectory), "`write_trajectory`, if there is a trajectory"),
    row(&["ostat"], OnOff, Same("0"), Part(P::AllTexts), "all text outputs: same as `-olstat -otraj -osdfstat`"),
    row(&["osdfstat"], OnOff, Same("0"), Part(P::Scan), "`wavex scan FILE`, in addition to the job"),
    row(&["name"], Text("a name"), Words("out"), Part(P::ScanName), "`--name` of `wavex scan`"),
    row(&["sdfscan"], OnOff, Same("0"), Part(P::OnlyScan), "`wavex scan FILE`, without a job"),
    row(&["sdfscanfast"], OnOff, Same("0"), Part(P::OnlyScanFast), "`wavex scan FILE --fast`, without a job"),
    // Information.
    row(&["h", "help"], OnOff, Same("0"), Command(&["wavex", "help"]), ""),
    row(&["v", "version"], OnOff, Same("0"), Command(&["wavex", "--version"]), ""),
    // Refinement.
    row(&["f", "fastest"], OnOff, Same("0"), Key("decompose", "mode", Switch("", "\"fastest\"")), ""),
    row(&["s", "fastsep"], OnOff, Same("0"), Key("decompose", "mode", Switch("", "\"fast_separated\"")), ""),
    row(&["a", "auto"], OnOff, Same("0"), Part(P::Auto), "`refine_when_needed` of `decompose`, with `-fastest` or `-fastsep`"),
    row(&["slow"], OnOff, Same("0"), Part(P::Slow), "`mode` of `decompose`: \"slow\", without `-fastest` and `-fastsep`"),
    // Extraction.
    row(&["d", "det"], Number, Same("4.5"), Key("decompose", "detection_sigma", Plain), ""),
    row(&["det_lm", "lm_det"], Number, Same("0"), Key("decompose", "detection_sigma_last", ZeroIs("false")), "0: same as `-d`"),
    row(&["outflt"], OnOff, Same("1"), Key("filter_outliers", "waves", Plain), ""),
    row(&["emflt"], OnOff, Same("0"), Key("decompose", "drop_emission_crosstalk", Plain), ""),
    row(&["min_width"], Number, Same("0.8"), End("decompose", "width_ratio", 0, [0.8, 10.0]), ""),
    row(&["max_width"], Number, Same("10.0"), End("decompose", "width_ratio", 1, [0.8, 10.0]), ""),
    row(&["out_min_a"], Number, Same("2.0"), Key("filter_outliers", "min_angle_deg", Plain), ""),
    row(&["out_max_h"], Number, Same("50.0"), Key("filter_outliers", "max_height_m", Plain), ""),
    row(&["out_max_r"], Number, Same("4.0"), Key("filter_outliers", "max_range_m", Plain), ""),
    row(&["bge"], OnOff, Written("1"), Key("calibrate", "background", Switch("\"fixed\"", "\"per_waveform\"")), ""),
    row(&["decay_a"], Number, Words("auto"), Key("calibrate", "decay_amplitude", Plain), "together with `-decay_t`"),
    row(&["decay_t"], Number, Words("auto"), Key("calibrate", "decay_time_ns", Plain), "in nanoseconds; together with `-decay_a`"),
    // Times.
    row(&["t_min"], Number, Words("first shot"), End("reader", "time_s", 0, [-1e10, 1e10]), ""),
    row(&["t_max"], Number, Words("last shot"), End("reader", "time_s", 1, [-1e10, 1e10]), ""),
    row(&["t_adj"], OnOff, Same("0"), Key("reader", "time_scale", Switch("\"week\"", "\"adjusted\"")), ""),
    row(&["ibrc"], OnOff, Same("1"), Key("correct", "range_table", Plain), ""),
    row(&["utc"], OnOff, Same("0"), Key("reader", "utc", Plain), ""),
    row(&["gps_date"], Date, Words("0: from the file"), Key("reader", "gps_date", ZeroIsNothing), ""),
    row(&["t_corr"], Number, Same("0.0"), Key("reader", "time_offset_s", Plain), ""),
    row(&["t_err"], Number, Written("0.02"), Key("decompose", "timing_error_ns", Plain), ""),
    row(&["n_ppm"], Number, Words("0: from the file"), Key("reader", "refractive_index_ppm", ZeroIsNothing), ""),
    row(&["odd_dt"], Number, Same("0.0"), Key("reader", "odd_sample_shift", Plain), ""),
    row(&["ibrc_fit"], OnOff, Same("1"), Key("correct", "range_table_fit", Plain), ""),
    // Amplitude, intensity, width.
    row(&["ibic"], OnOff, Same("1"), Key("correct", "amplitude_table", Plain), ""),
    row(&["icf", "F"], OnOff, Same("1"), Key("correct", "incidence", Switch("\"none\"", "\"flat\"")), "`F` in options files"),
    row(&["icr", "R"], Number, Same("1000.0"), Key("correct", "reference_range_m", ZeroIs("false")), "0: no correction; `R` in options files"),
    row(&["ica"], Number, Same("0"), Key("correct", "attenuation_db_per_km", ZeroIs("false")), "0: no correction"),
    row(&["awc"], Number, Words("auto"), Key("correct", "width_correction_low", Plain), ""),
    row(&["awc1"], Number, Words("auto"), Key("correct", "width_correction_high", Plain), ""),
    // Trajectory.
    row(&["po"], Text("a file"), Words("none"), Key("geometry", "trajectory", File), ""),
    row(&["po_adj", "A"], OnOff, Words("by format"), Key("geometry", "trajectory_time", Switch("", "\"adjusted\"")), "`-A` in the examples of its documentation"),
    row(&["po_day"], OnOff, Same("0"), Key("geometry", "trajectory_time", Switch("", "\"day\"")), ""),
    row(&["po_rad"], OnOff, Same("0"), Key("geometry", "trajectory_angles", Switch("\"deg\"", "\"rad\"")), ""),
    row(&["po_parse"], Text("a letter for each column"), Words("none"), Key("geometry", "trajectory_columns", TrajectoryColumns), "t, x, y, z, p and k are required; a missing roll (w) is set to 0, with a warning"),
    row(&["plot_po"], Text("a file"), Words("none"), Part(P::PlotTrajectory), "`wavex trajectory FILE --crs ... -o ...`, in addition to the job"),
    row(&["po_sub"], Whole(1, u64::MAX), Words("1"), Part(P::PlotEvery), "`--every` of `wavex trajectory`"),
    // Geometry.
    row(&["mount"], Text("a file"), Words("0 0 0"), Key("geometry", "mount", Angles), "its three angles, read at import"),
    row(&["calib_corr"], Text("a file"), Words("none"), Key("geometry", "calibration", File), ""),
    row(&["wkt"], Text("a file"), Words("none: UTM"), Key("geometry", "crs", File), ""),
    row(&["utm"], Whole(1, 60), Words("by position"), Key("geometry", "crs", Zone), "with N or S from the start of the trajectory, if it can be read at import; otherwise add the letter by hand"),
    row(&["geo"], OnOff, Same("0"), Key("geometry", "crs", Switch("", "\"geodetic\"")), ""),
    row(&["ecef"], OnOff, Same("0"), Key("geometry", "crs", Switch("", "\"ecef\"")), ""),
    row(&["geoid"], Text("a name"), Words("none"), Key("geometry", "geoid", Remarked), "searched for in the input folder or in `geoid_dir`"),
    row(&["metre"], OnOff, Same("0"), Key("geometry", "unit", Switch("", "\"m\"")), ""),
    row(&["feet"], OnOff, Same("0"), Key("geometry", "unit", Switch("", "\"us_ft\"")), ""),
    row(&["int_feet"], OnOff, Same("0"), Key("geometry", "unit", Switch("", "\"ft\"")), ""),
    row(&["dumv"], Number, Same("0.0"), Key("georeference", "dummy_velocity_mps", Plain), ""),
];

//! Version 1.0 (2016): full-waveform LAS 1.3 to LAS 1.2.
//!
//! Options in the order of its documentation.

use super::options::Becomes::{Command, End, Flag, Key, Nothing, Part};
use super::options::Form::{Plain, Switch, ZeroIs};
use super::options::Standard::{Same, Words, Written};
use super::options::Takes::{Number, Switch as OnOff, Text, Texts, Whole};
use super::options::{Always, Flag as F, Opt, Part as P, Version, row};

/// Definition of the version.
pub const V10: Version = Version {
    name: "1.0",
    options: OPTIONS,
    chain: &[
        "calibrate",
        "decompose",
        "correct",
        "filter_outliers",
        "georeference",
        "write_las",
        "write_trajectory",
        "write_lstat",
    ],
    always: ALWAYS,
    option_files: &["wavex.opt", "wavex.opt.txt", "stripalign.opt"],
    output: "out.laz",
    line_stats: "_stat.txt",
    has_stat_log: false,
    writes_trajectory: false,
};

const ALWAYS: &[Always] = &[
    ("job", "stat_log", "\"\"", "1.0 writes none"),
    ("calibrate", "background", "\"per_waveform\"", "1.0 has no other mode"),
    ("correct", "range_table", "false", "1.0 has no tables"),
    ("correct", "amplitude_table", "false", "1.0 has no tables"),
    ("correct", "width_correction_low", "false", "1.0 has none"),
    ("correct", "width_correction_high", "false", "1.0 has none"),
    ("filter_outliers", "points", "false", "1.0 marks no points"),
    ("write_las", "version", "\"1.2\"", "1.0 writes no other version"),
    ("write_las", "attribute_layout", "\"1.0\"", "1.0"),
    ("write_lstat", "layout", "\"1.0\"", "1.0"),
];

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
    row(&["i", "input"], Texts("a file"), Words("required"), Part(P::Input), "`path` of the reader for the extension"),
    row(&["o", "out"], Text("a name that ends in .las or .laz"), Words("out.laz"), Part(P::Output), "`path` of `write_las`; prefix of all other outputs"),
    row(&["oext"], OnOff, Same("1"), Key("write_las", "extra_attributes", Plain), ""),
    row(&["ounc"], OnOff, Same("1"), Key("write_las", "uncertainty", Plain), ""),
    row(&["nil"], OnOff, Same("0"), Part(P::NoPoints), "no sink for points"),
    // Logs and texts.
    row(&["log"], OnOff, Same("1"), Key("job", "log", Switch("\"\"", "")), "no log history"),
    row(&["olog"], OnOff, Same("1"), Key("job", "log", Switch("\"\"", "")), ""),
    row(&["clear_log_history"], OnOff, Same("0"), Nothing("logs are next to the outputs and keep no history"), ""),
    row(&["ostat", "stat"], OnOff, Same("0"), Part(P::LineStats), "`write_lstat` in the layout of 1.0"),
    row(&["otraj", "traj"], OnOff, Same("0"), Part(P::Trajectory), "`write_trajectory`"),
    // Information.
    row(&["h", "help"], OnOff, Same("0"), Command(&["wavex", "help"]), ""),
    row(&["?", "options"], OnOff, Same("0"), Command(&["wavex", "stages"]), ""),
    row(&["v", "version"], OnOff, Same("0"), Command(&["wavex", "--version"]), ""),
    // Refinement.
    row(&["f", "fastest"], OnOff, Same("0"), Key("decompose", "mode", Switch("", "\"fastest\"")), ""),
    row(&["s", "fastsep"], OnOff, Same("0"), Key("decompose", "mode", Switch("", "\"fast_separated\"")), ""),
    row(&["a", "auto"], OnOff, Same("0"), Part(P::Auto), "`refine_when_needed` of `decompose`, with `-fastest` or `-fastsep`"),
    row(&["slow"], OnOff, Same("0"), Part(P::Slow), "`mode` of `decompose`: \"slow\", without `-fastest` and `-fastsep`"),
    // Extraction.
    row(&["d", "det"], Number, Same("4.5"), Key("decompose", "detection_sigma", Plain), ""),
    row(&["min_width"], Number, Same("0.8"), End("decompose", "width_ratio", 0, [0.8, 10.0]), ""),
    row(&["max_width"], Number, Same("10.0"), End("decompose", "width_ratio", 1, [0.8, 10.0]), ""),
    row(&["out_min_a"], Number, Same("2.0"), Key("filter_outliers", "min_angle_deg", Plain), ""),
    row(&["out_max_h"], Number, Written("30.0"), Key("filter_outliers", "max_height_m", Plain), ""),
    // Intensity.
    row(&["F", "icorr_flat"], OnOff, Same("1"), Key("correct", "incidence", Switch("\"none\"", "\"flat\"")), ""),
    row(&["R", "icorr_range"], Number, Written("0"), Key("correct", "reference_range_m", ZeroIs("false")), "0: no correction"),
    row(&["A", "icorr_atm"], Number, Same("0"), Key("correct", "attenuation_db_per_km", ZeroIs("false")), "0: no correction"),
    // Times.
    row(&["dt"], Number, Same("0.0"), Key("reader", "range_time_offset_ns", Plain), ""),
    row(&["odd_dt"], Number, Same("0.0"), Key("reader", "odd_sample_shift", Plain), ""),
    row(&["t_err"], Number, Written("0.01"), Key("decompose", "timing_error_ns", Plain), ""),
];

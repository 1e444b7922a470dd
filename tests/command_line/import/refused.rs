//! Invalid lines: one test per message.

use wavex::cli::import::draft::Known;

use super::{files, in_version, read_with, words};

#[track_caller]
fn problem(line: &str) -> String {
    read_with(line, &Known::Everything, &files).unwrap_err()
}

/// Asserts the problem of a line: sentence, marked text, and help.
#[track_caller]
fn refused(line: &str, what: &str, marked: &str, help: &str) {
    let at = "wavex ".len() + line.find(marked).unwrap();
    let mut expected =
        format!("{what}\n  | wavex {line}\n  | {}{}", " ".repeat(at), "^".repeat(marked.len()));
    if !help.is_empty() {
        expected += &format!("\n  = help: {help}");
    }
    assert_eq!(problem(line), expected);
}

#[test]
fn an_unknown_option_is_named_with_the_nearest_or_with_the_version_that_has_it() {
    refused(
        "-i a.sdf -fastset",
        "version 1.1 has no option `-fastset`",
        "-fastset",
        "did you mean `-fastest`?",
    );
    refused("-i a.sdf -oxet=0", "version 1.1 has no option `-oxet`", "-oxet=0", "did you mean `-oext`?");
    refused(
        "-i a.sdf -dt 0.5",
        "version 1.1 has no option `-dt`",
        "-dt",
        "version 1.0 has this option; use `--classic 1.0`",
    );
    refused(
        "-i a.las -emflt",
        "version 1.0 has no option `-emflt`",
        "-emflt",
        "version 1.1 has this option; use `--classic 1.1`",
    );
    refused(
        "-i a.sdf -W -d5",
        "version 1.1 has no option `-W`",
        "-W",
        "similar options: `-wkt`; docs/import.md lists all options",
    );
    refused(
        "-i a.sdf -oxymoron",
        "version 1.1 has no option `-oxymoron`",
        "-oxymoron",
        "if you mean `-o xymoron`, write the blank",
    );
    refused(
        "-i a.sdf -lidarlidar",
        "version 1.1 has no option `-lidarlidar`",
        "-lidarlidar",
        "similar options: `-lax_append`, `-log`, `-log_flush`, `-lstat`, `-lm_det`; docs/import.md lists all options",
    );
    refused("-i a.sdf -Det 5", "version 1.1 has no option `-Det`", "-Det", "did you mean `-det`?");
    let help = "if you mean `-name myscan`, write the blank";
    refused("-i a.sdf -namemyscan", "version 1.1 has no option `-namemyscan`", "-namemyscan", help);
}

#[test]
fn a_missing_argument_says_what_is_expected() {
    refused("-i a.sdf -det", "`-det` lacks its argument: a number", "-det", "");
    refused("-i a.sdf -po -fastest", "`-po` lacks its argument: a file", "-po", "");
    refused("-i a.sdf -o=", "`-o=` lacks its argument: a name, `*` for the name of the input", "-o=", "");
    refused("-i", "`-i` lacks its argument: a file, several, or a pattern", "-i", "");
}

#[test]
fn an_argument_that_does_not_fit_says_what_is_expected() {
    refused("-i a.sdf -det six", "`-det` expects a number, got `six`", "six", "");
    refused("-i a.sdf -t_corr inf", "`-t_corr` expects a number, got `inf`", "inf", "");
    refused("-i a.sdf -utm 61", "`-utm` expects a whole number from 1 to 60, got `61`", "61", "");
    refused("-i a.sdf -N=few", "`-N` expects a whole number of at least 0, got `few`", "-N=few", "");
    refused("-i a.sdf -oext=yes", "`-oext` expects 0 or 1, got `yes`", "-oext=yes", "");
    let expected = "`-gps_date` expects a date such as 2018-11-14, got `14.11.2018`";
    refused("-i a.sdf -gps_date 14.11.2018", expected, "14.11.2018", "");
}

#[test]
fn a_word_that_can_be_read_in_two_ways_is_refused() {
    let help = "write a blank between the option and its argument";
    refused("-i a.sdf -awc10", "`-awc10` is ambiguous: `-awc1` or `-awc`", "-awc10", help);
}

#[test]
fn a_word_behind_no_option_is_refused() {
    let help = "put `-i` before an input, and quote text that contains blanks";
    refused("a.sdf -fastest", "`a.sdf` does not belong to an option", "a.sdf", help);
    refused("-i a.sdf -fastest 2", "`2` does not belong to an option", "2", help);
}

#[test]
fn options_that_exclude_each_other_are_refused() {
    refused("-i a.sdf -fastest -fastsep", "`-fastest` and `-fastsep` exclude each other", "-fastsep", "");
    refused("-i a.sdf -po b -utm 33 -geo", "`-utm 33` and `-geo` exclude each other", "-geo", "");
    refused("-i a.sdf -po b -wkt w.txt -utm 33", "`-wkt w.txt` and `-utm 33` exclude each other", "-utm", "");
    refused("-i a.sdf -po b -feet -metre", "`-metre` and `-feet` exclude each other", "-feet", "");
    refused("-i a.sdf -po b -po_day -A", "`-A` and `-po_day` exclude each other", "-po_day", "");
    refused("-i a.sdf -olas -otxt", "`-olas` and `-otxt` exclude each other", "-otxt", "");
    refused("-i a.sdf -o*.laz -olas", "`-o*.laz` and `-olas` exclude each other", "-o*.laz", "");
}

#[test]
fn an_output_has_one_of_the_extensions_of_its_version() {
    refused("-i a.sdf -o a.xyz", "an output must end in .las or .laz or .txt, got `a.xyz`", "-o", "");
    refused("-i a.las -o a.txt", "an output must end in .las or .laz, got `a.txt`", "-o", "");
}

#[test]
fn the_kind_of_recording_must_be_clear() {
    let known = "supported extensions: .las, .laz, .pls, .sdf, .wfm and .arrow";
    let what = format!("data: unknown recording format; {known}");
    refused("-i data", &what, "-i", "");
    let what = "`b.pls` has another format than the files before it; use one job per format";
    refused("-i a.sdf b.pls", what, "-i", "");
}

#[test]
fn a_line_without_an_input_is_refused() {
    let expected = "the line has no input\n  = help: add one with `-i`, such as `-i data.sdf`";
    for line in ["-fastest", "-sdfscan", "wavex -O out"] {
        assert_eq!(problem(line), expected, "{line}");
    }
}

#[test]
fn mounting_angles_must_be_there() {
    let help = "a file of mounting angles has three numbers in degrees: about x, y and z";
    let what = "cannot read three angles from `none.txt`";
    refused("-i a.sdf -po b -mount none.txt", what, "-mount", help);
}

#[test]
fn a_trajectory_to_be_projected_must_be_named() {
    refused("-plot_po a.txt", "`-plot_po` requires a trajectory", "-plot_po", "give one with `-po`");
}

#[test]
fn an_unknown_version_is_refused() {
    let problem = in_version(Some("2.0"), &words("-v"), &Known::Everything, &files).unwrap_err();
    assert_eq!(problem, "unknown version 2.0\n  = help: 1.0 or 1.1");
}

#[test]
fn a_file_of_options_tells_its_line() {
    let read = |path: &str| (path == "wavex.opt.txt").then(|| "mem=4096\n-det 5\ndett=5\ndet=\n".to_owned());
    let problem = read_with("-i a.sdf", &Known::Everything, &read).unwrap_err();
    let expected = "\
`-det 5` is not `name=argument`
 --> wavex.opt.txt:2
  | -det 5
  | ^^^^^^
  = help: an options file has one option per line, such as `det=5`

error: version 1.1 has no option `-dett`
 --> wavex.opt.txt:3
  | dett=5
  | ^^^^^^
  = help: did you mean `-det`?

error: `det` lacks its argument: a number
 --> wavex.opt.txt:4
  | det=
  | ^^^^";
    assert_eq!(problem, expected);
}

#[test]
fn everything_that_is_wrong_is_told_at_once_with_blanks_and_foreign_letters_in_place() {
    let line =
        ["-i".to_owned(), "my flüge.sdf".to_owned(), "-det".to_owned(), "x".to_owned(), "-y".to_owned()];
    let problem = in_version(None, &line, &Known::Everything, &files).unwrap_err();
    let expected = "\
`-det` expects a number, got `x`
  | wavex -i \"my flüge.sdf\" -det x -y
  |                              ^

error: version 1.1 has no option `-y`
  | wavex -i \"my flüge.sdf\" -det x -y
  |                                ^^
  = help: docs/import.md lists all options";
    assert_eq!(problem, expected);
}

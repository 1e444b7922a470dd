//! Folders that are not writable, and full disks.

use std::fs::{self, OpenOptions};
use std::process::{Command, Stdio};

use wavex_testkit::las::Las;
use wavex_testkit::{Outcome, TO_TABLE, TestFolder, outcome, skipped};

const READ: &str = "[[stage]]\ntype = 'read_las'\npath = 'a.las'\n";
const COPY: &str = "[[stage]]\ntype = 'write_arrow'\n";

fn place(pulses: usize) -> TestFolder {
    let las = Las::new(pulses);
    TestFolder::with(&[("a.las", &las.las()), ("a.wdp", &las.packets)])
}

/// Asserts that the run fails with this message and leaves the folder unchanged.
#[track_caller]
fn fails(place: &TestFolder, command: &mut Command, message: &str) {
    let before = place.products();
    assert_eq!(outcome(command), Outcome::failure(1, format!("error: {message}\n")));
    assert_eq!(place.products(), before);
}

#[test]
fn a_file_where_the_folder_of_outputs_should_be() {
    let place = place(3);
    place.write("out", b"");
    let remedy =
        "cannot create the folder: File exists (os error 17); choose another folder: a file is in the way";
    let stages = format!("{READ}{COPY}");
    fails(&place, &mut place.command(&stages), &format!("./out: {remedy}"));
    let mut command = place.command(&stages);
    command.args(["--set", "job.log=''", "--set", "job.report=''"]);
    fails(&place, &mut command, &format!("./out: {remedy}"));
}

#[test]
fn a_file_where_a_folder_in_the_path_of_a_sink_should_be() {
    let place = place(3);
    place.write("out/sub", b"");
    for (path, problem) in [
        ("sub/*.arrow", "./out/sub: cannot create the folder: File exists (os error 17)"),
        ("sub/deep/*.arrow", "./out/sub/deep: cannot create the folder: Not a directory (os error 20)"),
    ] {
        let mut command = place.command(&format!("{READ}{COPY}path = '{path}'\n"));
        let message = format!("{problem}; choose another folder: a file is in the way");
        fails(&place, &mut command, &message);
    }
}

#[test]
fn a_folder_of_the_name_of_an_output() {
    let problem = "a folder with the name of this output exists; choose another name or remove the folder";
    for (folder, message) in [
        ("a.arrow", format!("stage write_arrow: ./out/a.arrow: {problem}")),
        ("job_report.json", format!("./out/job_report.json: {problem}")),
    ] {
        let place = place(3);
        place.write(&format!("out/{folder}/mine"), b"");
        // The second output must not remain if the first cannot be written.
        let stages = format!("{READ}[[stage]]\ntype = 'write_lstat'\n{COPY}");
        fails(&place, &mut place.command(&stages), &message);
    }
}

#[test]
fn a_folder_that_must_not_be_written_to() {
    let place = place(3);
    fs::create_dir(place.path("out")).unwrap();
    let mut permissions = fs::metadata(place.path("out")).unwrap().permissions();
    permissions.set_readonly(true);
    fs::set_permissions(place.path("out"), permissions).unwrap();
    if fs::write(place.path("out/try"), b"").is_ok() {
        skipped("this user may write to folders that are read-only (root?)");
        return;
    }
    let message = "./out/job.log: cannot create the log: Permission denied (os error 13); \
                   check the permissions, or choose another folder";
    fails(&place, &mut place.command(&format!("{READ}{COPY}")), message);
}

#[test]
fn an_output_that_would_replace_an_input() {
    let place = place(250);
    let recording = fs::read(place.path("a.las")).unwrap();
    let to_las = TO_TABLE.replace("write_table'\npath = '*.csv'", "write_las'\npath = '*.las'");
    // The job cannot detect that both folders are the same under different names; the run reports
    // it before reading.
    let mut command = place.command(&format!("{READ}{to_las}"));
    command.args(["--set", "job.output_dir='out/..'"]);
    let message = "the output ./a.las would replace an input; give the output another folder or another name";
    fs::create_dir(place.path("out")).unwrap();
    fails(&place, &mut command, message);
    place.write("a_copy.las", &recording);
    let mut command = place.command(&format!("{READ}{to_las}"));
    command.args(["--set", "read_las.path='*.las'", "--set", "job.output_dir='.'"]);
    command.args(["--set", "write_las.path='*_copy.las'"]);
    let message =
        "the output ././a_copy.las would replace an input; give the output another folder or another name";
    fails(&place, &mut command, message);
    assert_eq!(fs::read(place.path("a.las")).unwrap(), recording);
    assert_eq!(fs::read(place.path("a_copy.las")).unwrap(), recording);
}

#[test]
fn an_output_that_would_replace_the_packets_of_an_input() {
    let place = place(250);
    place.write("a.wdp", b"packets");
    let keys = "write_las'\npath = '*.laz'\nwave_packets = 'external'";
    let mut command =
        place.command(&format!("{READ}{}", TO_TABLE.replace("write_table'\npath = '*.csv'", keys)));
    command.args(["--set", "job.output_dir='.'"]);
    let message =
        "the output ././a.wdp would replace an input; give the output another folder or another name";
    fails(&place, &mut command, message);
    assert_eq!(fs::read(place.path("a.wdp")).unwrap(), b"packets");
}

/// Runs the same command with a file size limit of 8 kB, as a full disk.
///
/// A file at the limit refuses writes like a full disk does, and needs no privileges to set up. If
/// its signal must not end the program, it is ignored in the shell, and the program inherits this.
#[cfg(unix)]
fn on_a_small_disk(command: &Command) -> Command {
    let mut small = Command::new("sh");
    small.args(["-c", "trap '' XFSZ; ulimit -f 8; exec \"$0\" \"$@\""]);
    small.arg(command.get_program()).args(command.get_args()).current_dir(command.get_current_dir().unwrap());
    small
}

#[cfg(unix)]
#[test]
fn a_full_disk() {
    let full = "cannot write: File too large (os error 27); free some space, or write to another \
                disk";
    let place = place(1000);
    let points = TO_TABLE.split("[[stage]]\ntype = 'write_table'").next().unwrap();
    let sink = |stage: &str, path: &str| format!("[[stage]]\ntype = '{stage}'\npath = '{path}'\n");
    let simulate = |keys: &str| format!("[[stage]]\ntype = 'simulate'\n{keys}\n");
    for (stages, message) in [
        (format!("{READ}{COPY}"), "stage write_arrow: ./out/a.arrow: x"),
        (format!("{READ}{points}{}", sink("write_las", "*.las")), "stage write_las: ./out/a.las: x"),
        (format!("{READ}{points}{}", sink("write_las", "*.laz")), "stage write_las: ./out/a.laz: x"),
        (format!("{READ}{points}{}", sink("write_table", "*.csv")), "stage write_table: ./out/a.csv: x"),
        (format!("{READ}{points}{}", sink("write_table", "*.arrow")), "stage write_table: ./out/a.arrow: x"),
        (
            format!("{READ}{points}{}", sink("write_table", "*.parquet")),
            "stage write_table: ./out/a.parquet: x",
        ),
        (
            format!("{}[[stage]]\ntype = 'write_lstat'\n", simulate("lines = 300\nshots_per_line = 1")),
            "stage write_lstat: ./out/simulated_lstat.txt: x",
        ),
        (
            format!(
                "{}[[stage]]\ntype = 'write_lstat'\n",
                simulate("lines = 2\nshots_per_line = 200\ntruth = '*.csv'")
            ),
            "stage simulate: ./out/simulated.csv: x",
        ),
    ] {
        fails(
            &place,
            &mut on_a_small_disk(&place.command(&stages)),
            &message.replace(": x", &format!(": {full}")),
        );
    }
}

#[cfg(target_os = "linux")]
#[test]
fn a_standard_output_that_is_full() {
    let place = place(250);
    let full = OpenOptions::new().write(true).open("/dev/full").unwrap();
    let mut command = place.command(&format!("{READ}{COPY}path = '-'\n"));
    let output = command.stdout(full).stderr(Stdio::piped()).output().unwrap();
    let message = "error: stage write_arrow: -: cannot write: No space left on device (os error \
                   28); free some space, or write to another disk\n";
    assert_eq!(
        (output.status.code(), String::from_utf8(output.stderr).unwrap()),
        (Some(1), message.to_owned())
    );
    assert_eq!(place.products(), Vec::<String>::new());
}

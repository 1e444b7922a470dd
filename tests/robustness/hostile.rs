//! Hostile surroundings: full disks, few descriptors, pipes and devices in place of files.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::Write;
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

use wavex_formats::container::{Compression, ContainerHeader, EmissionReference, TimeScale, channel};
use wavex_testkit::container::{Row, Shot, compressed, nadir_shot, of_shots};
use wavex_testkit::flight::{OUTPUTS, STAGES, files, flight, run};
use wavex_testkit::{Outcome, TestFolder, skipped};

/// Time after which a run counts as hanging.
const LONGEST: Duration = Duration::from_secs(50);
/// Size of a small disk, KiB.
const DISK_KIB: usize = 16 << 10;

/// Waits for the end of a process.
///
/// # Panics
/// If it hangs.
#[track_caller]
fn end_of(mut child: Child) -> Output {
    let started = Instant::now();
    while child.try_wait().unwrap().is_none() {
        if started.elapsed() > LONGEST {
            child.kill().unwrap();
            panic!("the run hangs: {:?}", child.wait_with_output().unwrap());
        }
        std::thread::sleep(Duration::from_millis(5));
    }
    child.wait_with_output().unwrap()
}

fn spawn(place: &TestFolder, arguments: &[&str]) -> Child {
    let mut command = wavex_testkit::wavex();
    command.arg("--quiet").args(arguments).current_dir(place.path(""));
    command.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap()
}

/// Names in a folder that begin with a dot.
fn hidden(folder: &Path) -> Vec<String> {
    let entries = fs::read_dir(folder).into_iter().flatten().map(Result::unwrap);
    let names = entries.map(|entry| entry.file_name().into_string().unwrap());
    names.filter(|name| name.starts_with('.')).collect()
}

/// A disk in memory, unmounted on drop.
struct SmallDisk(PathBuf);

impl SmallDisk {
    /// Mounts it; `None` if the system refuses.
    fn mount(at: &Path) -> Option<SmallDisk> {
        fs::create_dir(at).unwrap();
        let size = format!("size={DISK_KIB}k");
        let mount = Command::new("mount").args(["-t", "tmpfs", "-o", &size, "tmpfs"]).arg(at).output();
        mount.is_ok_and(|output| output.status.success()).then(|| SmallDisk(at.to_owned()))
    }
}

impl Drop for SmallDisk {
    fn drop(&mut self) {
        let unmounted = Command::new("umount").arg("-l").arg(&self.0).status();
        assert!(unmounted.is_ok_and(|status| status.success()));
    }
}

#[cfg(target_os = "linux")]
#[test]
fn a_disk_with_little_space_ends_a_run_in_order() {
    let place = flight();
    let Some(disk) = SmallDisk::mount(&place.path("disk")) else {
        return skipped("small disks: `mount -t tmpfs` is not permitted");
    };
    place.write("job.toml", format!("[job]\noutput_dir = 'disk/out'\nthreads = 2\n{STAGES}").as_bytes());
    let products = || {
        let mut files = files(&place.path("disk/out"));
        files.retain(|name, _| OUTPUTS.contains(&name.as_str()));
        files
    };
    assert_eq!(run(&place, &["--archive", "disk/archives/first"]), Outcome::success());
    let good: BTreeMap<String, Vec<u8>> = products();
    assert_eq!(good.len(), OUTPUTS.len());
    for free_kib in [0, 4, 8, 16, 64] {
        for folder in ["out", "archives"] {
            fs::remove_dir_all(disk.0.join(folder)).unwrap();
        }
        let filler = disk.0.join("filler");
        fs::write(&filler, vec![0; (DISK_KIB - free_kib) << 10]).unwrap();
        let Output { status, stderr, .. } =
            end_of(spawn(&place, &["run", "job.toml", "--archive", "disk/archives/second"]));
        let err = String::from_utf8(stderr).unwrap();
        assert_eq!(status.code(), Some(1), "{free_kib} KiB: {err}");
        assert!(err.contains("free some space, or write to another disk"), "{free_kib} KiB: {err}");
        for (name, bytes) in products() {
            assert!(good[&name] == bytes, "{free_kib} KiB: {name} is not complete");
        }
        assert!(!place.path("disk/archives/second").exists());
        for folder in ["out", "archives"] {
            let mut left = hidden(&disk.0.join(folder));
            // An empty lock needs no space; the next run removes it.
            left.retain(|name| name != ".wavex.lock");
            assert_eq!(left, Vec::<String>::new(), "{free_kib} KiB: {folder}");
        }
        fs::remove_file(&filler).unwrap();
        assert_eq!(run(&place, &["--archive", "disk/archives/third"]), Outcome::success(), "{free_kib} KiB");
        assert!(products() == good, "{free_kib} KiB");
        assert_eq!(place.wavex(&["--quiet", "verify", "disk/archives/third"]), Outcome::success());
        for folder in ["out", "archives"] {
            assert_eq!(hidden(&disk.0.join(folder)), Vec::<String>::new(), "{free_kib} KiB: {folder}");
        }
    }
}

/// A small container.
fn container(line: u64) -> Vec<u8> {
    let header = ContainerHeader { time_scale: TimeScale::Week, ..ContainerHeader::new(1.0, 299_707_502.0) };
    let row = |shot: u64| Row {
        shot: nadir_shot(shot, 1_000_000 * shot as i64),
        blocks: vec![(channel::LOW_POWER, 0.0, vec![3 + line as u16; 200])],
    };
    compressed(&header, &[(0..4).map(row).collect()], Compression::None)
}

/// Copies containers.
const COPY: &str = "\
[[stage]]
type = 'read_arrow'
path = 'in/*.arrow'
[[stage]]
type = 'write_arrow'
path = '*_copy.arrow'
";

#[test]
fn hundreds_of_inputs_need_few_descriptors() {
    let place = TestFolder::new();
    (0..300).for_each(|number| place.write(&format!("in/{number:03}.arrow"), &container(number)));
    place.write(
        "job.toml",
        format!("[job]\noutput_dir = 'out'\nthreads = 2\nreport_page = true\n{COPY}").as_bytes(),
    );
    let mut command = Command::new("sh");
    command.args(["-c", "ulimit -n 64; exec \"$0\" --quiet run job.toml --archive archive"]);
    command.arg(wavex_testkit::program()).current_dir(place.path("")).stdin(Stdio::null());
    assert_eq!(wavex_testkit::outcome(&mut command), Outcome::success());
    let copies = place.products().into_iter().filter(|name| name.ends_with("_copy.arrow"));
    assert_eq!(copies.count(), 300);
    assert_eq!(place.wavex(&["--quiet", "verify", "archive"]), Outcome::success());
}

fn make_pipe(path: &Path) {
    fs::create_dir_all(path.parent().unwrap()).unwrap();
    assert!(Command::new("mkfifo").arg(path).status().unwrap().success());
}

/// Waits until a process has opened a file.
#[cfg(target_os = "linux")]
fn wait_until_open(process: u32, path: &Path) {
    let path = path.canonicalize().unwrap();
    let started = Instant::now();
    let is_open = || {
        let files = fs::read_dir(format!("/proc/{process}/fd")).into_iter().flatten().flatten();
        files.map(|file| fs::read_link(file.path())).any(|file| file.is_ok_and(|file| file == path))
    };
    while !is_open() {
        assert!(started.elapsed() < LONGEST, "the pipe was never opened");
        std::thread::sleep(Duration::from_millis(5));
    }
}

/// One signal ends the wait for bytes of a pipe.
#[cfg(target_os = "linux")]
#[test]
fn a_recording_through_a_pipe_ends_at_the_first_signal() {
    let whole = container(0);
    for bytes in [0, 100, whole.len() / 2] {
        let place = TestFolder::new();
        let pipe = place.path("in/a.arrow");
        make_pipe(&pipe);
        place.write("job.toml", format!("[job]\noutput_dir = 'out'\n{COPY}").as_bytes());
        // Opened for reading too, so that it does not wait for the run.
        let mut writer = File::options().read(true).write(true).open(&pipe).unwrap();
        writer.write_all(&whole[..bytes]).unwrap();
        let child = spawn(&place, &["run", "job.toml"]);
        wait_until_open(child.id(), &pipe);
        let process = child.id().to_string();
        assert!(Command::new("kill").args(["-TERM", &process]).status().unwrap().success());
        let Output { status, stderr, .. } = end_of(child);
        let err = String::from_utf8(stderr).unwrap();
        assert_eq!(status.code(), Some(1), "{bytes} bytes: {err}");
        assert!(err.contains("interrupted"), "{bytes} bytes: {err}");
        assert_eq!(place.products(), Vec::<String>::new());
        assert_eq!(hidden(&place.path("out")), Vec::<String>::new());
    }
}

/// A line that takes minutes does not delay the end.
#[cfg(target_os = "linux")]
#[test]
fn a_run_in_a_slow_line_ends_soon_after_a_signal() {
    let mut random = 1u64;
    let mut noise = || {
        // Constants of Knuth's MMIX generator.
        random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (random >> 56) as u16
    };
    let mut shots = Vec::new();
    for number in 0..400 {
        let samples = (0..16_000).map(|_| noise()).collect();
        shots.push(Shot {
            clock_ps: 1_000_000_000 * number,
            blocks: vec![(channel::LOW_POWER, 0.0, samples)],
        });
    }
    let place = TestFolder::new();
    place.write("a.arrow", &of_shots(&shots, EmissionReference::Clock, true));
    let job = "[[stage]]\ntype = 'read_arrow'\npath = 'a.arrow'\n[[stage]]\ntype = 'calibrate'\n\
               preset = 'riegl_lms_q680i'\n[[stage]]\ntype = 'decompose'\n[[stage]]\ntype = 'write_table'\n";
    place.write("job.toml", format!("[job]\noutput_dir = 'out'\n{job}").as_bytes());
    let mut child = spawn(&place, &["run", "job.toml"]);
    std::thread::sleep(Duration::from_secs(3));
    assert!(child.try_wait().unwrap().is_none(), "the run has ended");
    let process = child.id().to_string();
    assert!(Command::new("kill").args(["-TERM", &process]).status().unwrap().success());
    let signalled = Instant::now();
    let Output { status, stderr, .. } = end_of(child);
    let err = String::from_utf8(stderr).unwrap();
    // Other tests may keep all cores busy.
    assert!(signalled.elapsed() < Duration::from_secs(5), "{:?}", signalled.elapsed());
    assert!(status.code() == Some(1) && err.contains("interrupted"), "{status}: {err}");
    assert_eq!(hidden(&place.path("out")), Vec::<String>::new());
}

#[test]
fn a_recording_through_a_pipe_is_read_to_its_end() {
    let place = TestFolder::new();
    let pipe = place.path("in/a.arrow");
    make_pipe(&pipe);
    place.write("job.toml", format!("[job]\noutput_dir = 'out'\n{COPY}").as_bytes());
    let child = spawn(&place, &["run", "job.toml"]);
    File::options().write(true).open(&pipe).unwrap().write_all(&container(0)).unwrap();
    let output = end_of(child);
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    assert_eq!(place.products(), ["a_copy.arrow"]);
}

/// Files that a job reads, as a pipe without a writer and as an endless device.
#[test]
fn pipes_and_devices_are_refused_at_once() {
    let read = |reader: &str, file: &str| format!("[[stage]]\ntype = '{reader}'\npath = '{file}'\n");
    let write = "[[stage]]\ntype = 'write_arrow'\npath = '*_copy.arrow'\n";
    let simulate = "[[stage]]\ntype = 'simulate'\nlines = 1\nshots_per_line = 20\n";
    let chain =
        "[[stage]]\ntype = 'decompose'\n[[stage]]\ntype = 'georeference'\n[[stage]]\ntype = 'write_las'\n";
    let jobs = [
        (format!("{}{write}", read("read_las", "bad.las")), "bad.las"),
        (format!("{}{write}", read("read_pulsewaves", "bad.pls")), "bad.pls"),
        (format!("{}{write}", read("read_arrow", "bad.arrow")), "bad.arrow"),
        (format!("{simulate}[[stage]]\ntype = 'calibrate'\nload = 'bad.json'\n{chain}"), "bad.json"),
        (format!("[job.geometry]\ntrajectory = 'bad.txt'\n{simulate}{write}"), "bad.txt"),
        (format!("{simulate}[[stage]]\ntype = 'resolve_mta'\nterrain = 'bad.asc'\n{write}"), "bad.asc"),
    ];
    for (job, name) in jobs {
        for is_pipe in [true, false] {
            // A container may come through a pipe.
            if is_pipe && name.ends_with(".arrow") {
                continue;
            }
            let place = TestFolder::new();
            match is_pipe {
                true => make_pipe(&place.path(name)),
                false => symlink("/dev/zero", place.path(name)).unwrap(),
            }
            let child = place.command(&job).stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
            let Output { status, stderr, .. } = end_of(child);
            let err = String::from_utf8(stderr).unwrap();
            assert!(matches!(status.code(), Some(1 | 2)), "{name}, pipe {is_pipe}: {status}: {err}");
            // A container may come through a device, too.
            let problem =
                if name.ends_with(".arrow") { "neither an Arrow IPC file" } else { "a pipe or device" };
            assert!(err.contains(name) && err.contains(problem), "{name}, pipe {is_pipe}: {err}");
            assert_eq!(place.products(), Vec::<String>::new());
        }
    }
}

//! Large and hostile jobs, command lines and names cost no more than an error message.

use std::sync::LazyLock;

use proptest::prelude::*;
use wavex::classic::draft::Known;
use wavex::classic::options::Takes;
use wavex::classic::versions::VERSIONS;
use wavex::classic::{Place, import};
use wavex::job::{Include, Job, MAX_BYTES, MAX_INCLUDES, Override, read_text};
use wavex::registry::STAGES;
use wavex_testkit::TestFolder;

/// Errors of a job, as text.
#[track_caller]
fn problem(text: &str) -> String {
    Job::parse(STAGES, "job.toml", text, &[]).map(|job| job.chain()).unwrap_err().to_string()
}

#[test]
fn a_job_with_many_errors_reports_the_first_ones() {
    let lines = "a\n".repeat(430_000);
    let keys: String = (0..90_000).map(|number| format!("k{number} = 1\n")).collect();
    let items = "1, ".repeat(280_000);
    for text in [
        format!("[[stage]]\ntype = 'simulate'\n{lines}"),
        format!("[[stage]]\ntype = 'simulate'\n{keys}"),
        keys,
        format!("[[stage]]\ntype = 'read_las'\npath = [{items}]\n"),
    ] {
        let problem = problem(&text);
        assert!(problem.len() < 200_000, "{} bytes", problem.len());
        assert_eq!(problem.matches("error: ").count(), 100);
        assert!(problem.ends_with("\nmore than 100 errors: the others are not shown\n"), "{problem}");
    }
}

#[test]
fn a_long_line_is_not_shown_but_its_place_is() {
    let padding = " ".repeat(800_000);
    let problem = problem(&format!("[[stage]]\ntype = 'simulate'\n{padding}linse = 3\n"));
    assert!(problem.len() < 2000, "{} bytes", problem.len());
    assert!(problem.contains("--> job.toml:3:800001\n"), "{problem}");
}

#[test]
fn a_long_name_has_no_similar_one() {
    let name = "l".repeat(1_000_000);
    let problem = problem(&format!("[[stage]]\ntype = '{name}'\n"));
    assert!(problem.contains("unknown stage `lll") && !problem.contains("did you mean"));
}

#[test]
fn a_job_has_at_most_1000_stages() {
    let stages = "[[stage]]\ntype='calibrate'\n".repeat(32_000);
    let problem = problem(&stages);
    assert!(problem.starts_with("error: the job has 32000 stages, more than 1000\n"), "{problem}");
    assert!(problem.contains("job.toml:2001:1") && problem.ends_with("write several jobs\n"), "{problem}");
}

#[test]
fn a_job_is_at_most_8_mb() {
    let comment = "#".repeat(MAX_BYTES as usize);
    let expected = "error: the job has 8000001 bytes, more than 8 MB\n\
                    --> job.toml\n = help: name many inputs by a pattern, as in `lines/*.laz`\n";
    assert_eq!(problem(&format!("{comment}\n")), expected);
    let include = Include { name: "a.toml".into(), text: comment };
    let parsed = |includes: &[Include]| {
        let text = "[[stage]]\ntype = 'simulate'\n";
        Job::parse_with(STAGES, "job.toml", text, includes, &[])
            .map(|job| job.chain())
            .unwrap_err()
            .to_string()
    };
    let problem = parsed(&[include]);
    assert!(
        problem.starts_with("error: the job and its included files have 8000028 bytes, more"),
        "{problem}"
    );
    let small = Include { name: "a.toml".into(), text: String::new() };
    let problem = parsed(&vec![small; MAX_INCLUDES + 1]);
    assert!(problem.starts_with("error: the job includes 33 files, more than 32\n"), "{problem}");
    assert!(problem.ends_with("help: merge some of them\n"), "{problem}");
}

#[test]
fn an_endless_job_is_read_up_to_its_limit() {
    let problem = read_text(std::io::repeat(b'#')).unwrap_err().to_string();
    assert_eq!(problem, "it is larger than 8 MB");
    assert_eq!(
        read_text(&b"\xff"[..]).unwrap_err().to_string(),
        "it is not UTF-8 text: byte 0; save it as UTF-8"
    );
    let place = TestFolder::new();
    let ended = place.wavex(&["check", "/dev/zero"]);
    assert_eq!(
        ended.err,
        "error: /dev/zero: cannot read the job: it is a pipe or device; give a file, or - for standard input\n"
    );
}

#[test]
fn an_output_has_a_name_of_visible_characters() {
    let text =
        "[[stage]]\ntype = 'simulate'\n[[stage]]\ntype = 'write_arrow'\npath = \"a\\nERROR b.arrow\"\n";
    let problem = problem(text);
    let expected = "error: the path in `path` has a control character: \"a\\nERROR b.arrow\"\n";
    assert!(problem.starts_with(expected), "{problem}");
    assert!(problem.contains("help: a backslash begins an escape; "), "{problem}");
    // A key that is no path.
    let text = "[[stage]]\ntype = 'simulate'\n[[stage]]\ntype = 'calibrate'\nsave = \"a\\nb.json\"\n";
    let problem = self::problem(text);
    assert!(problem.starts_with("error: the name of an output contains control characters: "), "{problem}");
    assert!(problem.ends_with("help: write a name of visible characters\n"), "{problem}");
}

#[cfg(unix)]
#[test]
fn a_terminal_gets_no_commands_from_names() {
    let place = TestFolder::new();
    let ended = place.wavex(&["check", "a\u{1b}[2Jb\u{9b}2J.toml"]);
    let expected = "error: a\u{fffd}[2Jb\u{fffd}2J.toml: cannot read the job: ";
    assert!(ended.err.starts_with(expected), "{}", ended.err);
    // As an input of a run: refused, and escaped in the log.
    std::fs::write(place.path("c\n\u{1b}[2J.arrow"), b"").unwrap();
    let ended =
        place.run("[[stage]]\ntype = 'read_arrow'\npath = 'c*.arrow'\n[[stage]]\ntype = 'write_arrow'\n");
    let expected = r#""c\n\u{1b}[2J.arrow": the name contains control characters; rename the file"#;
    assert!(ended.err.contains(expected) && !ended.err.contains('\u{1b}'), "{}", ended.err);
}

#[test]
fn texts_of_files_cannot_command_a_terminal_or_forge_log_messages() {
    let place = TestFolder::new();
    place.write("a.wkt", "PROJCS[\"a\u{1b}[31m\u{9b}2J\r\nERROR b\u{202e}\",GEOGCS[\"c\"".as_bytes());
    let job = "[job]\noutput_dir = 'out'\n[job.geometry]\ncrs = 'a.wkt'\n[[stage]]\ntype = 'simulate'\n\
               lines = 1\n[[stage]]\ntype = 'georeference'\n[[stage]]\ntype = 'write_arrow'\n";
    place.write("job.toml", job.as_bytes());
    for command in ["check", "run"] {
        let ended = place.wavex(&[command, "job.toml"]);
        let is_clean = |letter: char| letter == '\n' || !letter.is_control() && letter != '\u{202e}';
        assert!(ended.code != Some(0) && ended.err.chars().all(is_clean), "{:?}", ended.err);
    }
}

#[cfg(target_os = "linux")]
#[test]
fn a_log_that_cannot_be_written_is_reported() {
    let place = TestFolder::new();
    std::fs::create_dir(place.path("out")).unwrap();
    let mut program = wavex_testkit::wavex();
    let job = "[job]\noutput_dir = 'out'\nlog = '/dev/full'\n[[stage]]\ntype = 'simulate'\nlines = 1\n\
               [[stage]]\ntype = 'write_arrow'\n";
    place.write("job.toml", job.as_bytes());
    let ended = wavex_testkit::outcome(program.args(["run", "job.toml"]).current_dir(place.path("")));
    assert_eq!(ended.code, Some(0), "{}", ended.err);
    let expected = "/dev/full: cannot write the log: No space left on device (os error 28); it is incomplete";
    assert!(ended.err.contains(expected), "{}", ended.err);
}

fn translated(words: &[String], classic: Option<&str>) -> Result<wavex::classic::Import, String> {
    static KNOWN: LazyLock<Known> = LazyLock::new(Known::this_build);
    let place = Place { known: &KNOWN, base: None, read: &|_| None, latitude: &|_, _| None };
    import(words, classic, &place)
}

#[test]
fn a_line_of_many_wrong_words_has_a_short_message() {
    let words: Vec<String> = (0..25_000).map(|number| format!("x{}", number % 10)).collect();
    let problem = translated(&words, None).unwrap_err();
    assert!(problem.len() < 30_000, "{} bytes", problem.len());
    assert_eq!(problem.matches("does not belong to an option").count(), 20);
    assert!(problem.ends_with("\n\nfurther errors are not shown"), "{problem}");
    let first = problem.lines().nth(1).unwrap();
    assert!(first.starts_with("  | wavex x0 x1 x2") && first.ends_with(" ..."), "{first}");
    assert_eq!(problem.lines().nth(2), Some("  |       ^^"));
    let word = format!("-{}", "q".repeat(100_000));
    let problem = translated(&[word], None).unwrap_err();
    assert!(problem.len() < 5000, "{} bytes", problem.len());
}

#[test]
fn a_line_is_at_most_1_mb() {
    let words = vec!["-i".to_owned(), "a".repeat(1_000_000)];
    let expected = "the command line has 1000004 bytes, more than 1000000\n  \
                    = help: name many inputs by a pattern, as in `-i \"lines/*.sdf\"`";
    assert_eq!(translated(&words, None).unwrap_err(), expected);
}

#[test]
fn many_inputs_are_one_list() {
    let words: Vec<String> =
        (0..50_000).flat_map(|number| ["-i".to_owned(), format!("{number}.sdf")]).collect();
    let text = translated(&words, None).unwrap().text;
    assert!(text.contains("\"49999.sdf\"]"));
}

#[test]
fn an_error_of_the_job_is_shown_at_its_option() {
    let words: Vec<String> = "-i a.sdf -det -5 -o b.laz".split(' ').map(str::to_owned).collect();
    let problem = translated(&words, None).unwrap_err();
    assert!(
        problem.starts_with("the job of this line is invalid: `detection_sigma` must be at least "),
        "{problem}"
    );
    assert!(problem.contains("\n  | wavex -i a.sdf -det -5 -o b.laz\n  |                ^^^^"), "{problem}");
}

/// Words of classic command lines: options of both versions, and values of any kind.
fn words() -> impl Strategy<Value = Vec<String>> {
    let options: Vec<String> = VERSIONS
        .iter()
        .flat_map(|version| version.options)
        .map(|option| format!("-{}", option.name()))
        .collect();
    let takes_number: Vec<String> = VERSIONS
        .iter()
        .flat_map(|version| version.options)
        .filter(|option| matches!(option.takes, Takes::Number | Takes::Whole(..)))
        .map(|option| format!("-{}", option.name()))
        .collect();
    let values = prop::sample::select(vec![
        "0",
        "1",
        "-1",
        "2.5",
        "-7.5",
        "1e300",
        "-1e-300",
        "99",
        "32",
        "a.sdf",
        "b.las",
        "*.pls",
        "out/c.laz",
        "c.txt",
        "C:\\d\\e.laz",
        "",
        "\"",
        "#",
        "a\nb",
        "é'\"\\",
        "2018-11-14",
        "2018-99-99",
        "txyz",
        "xyzi",
        "txyzwpk",
        "a.toml",
        "*",
        ".",
        "/",
        "-",
    ]);
    let number = prop_oneof![
        Just("-3".to_owned()),
        any::<f64>().prop_map(|value| format!("{value:e}")),
        any::<u8>().prop_map(|value| value.to_string())
    ];
    let given = prop_oneof![
        (prop::sample::select(options), prop::option::of(values)).prop_map(|(option, value)| [
            Some(option),
            value.map(str::to_owned)
        ]
        .into_iter()
        .flatten()
        .collect::<Vec<_>>()),
        (prop::sample::select(takes_number), number).prop_map(|(option, value)| vec![option, value]),
    ];
    let input = prop::sample::select(vec!["a.sdf", "b.las", "c.pls", "*.sdf", "d.arrow"]);
    (input, prop::collection::vec(given, 0..5)).prop_map(|(input, given)| {
        ["-i".to_owned(), input.to_owned()].into_iter().chain(given.into_iter().flatten()).collect()
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]
    #[test]
    fn whatever_import_writes_is_a_valid_job(words in words(), classic in prop::sample::select(vec![None, Some("1.0"), Some("1.1")])) {
        match translated(&words, classic) {
            Ok(import) if import.has_job => {
                let job = Job::parse(STAGES, "job.toml", &import.text, &[] as &[Override]);
                prop_assert!(job.is_ok(), "{}\n{}", job.unwrap_err(), import.text);
            }
            Ok(_) => {}
            // Each error names the word that causes it.
            Err(problem) => prop_assert!(problem.contains("\n  | ") && problem.contains('^'), "{problem}"),
        }
    }
}

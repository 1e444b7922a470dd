//! Notations of options, and combined effects of several options.

use wavex::cli::import::draft::Known;
use wavex::cli::import::{Import, Place, import};

use super::{complete, files, here, in_version, keys, read_with, stages, words};

/// Keys in a line's job that are not in the job of another line.
#[track_caller]
fn added(line: &str, to: &str) -> Vec<String> {
    let before = keys(&complete(to).text);
    keys(&complete(line).text).into_iter().filter(|key| !before.contains(key)).collect()
}

/// Notes of a line.
fn notes(import: &Import) -> Vec<String> {
    let notes = import.text.lines().skip_while(|line| !line.starts_with("# Options without"));
    let notes = notes.skip(1).map_while(|line| line.strip_prefix("#   "));
    notes.map(str::to_owned).collect()
}

#[test]
fn an_option_may_be_written_in_every_way_of_the_documents() {
    let expected = ["decompose.detection_sigma = 6.0"];
    for option in ["-d 6", "-d6", "-d=6", "-det 6", "-det=6", "-det6", "-d 6.0", "-d6e0"] {
        assert_eq!(added(&format!("-i data.sdf {option}"), "-i data.sdf"), expected, "{option}");
    }
    for option in ["-oext 0", "-oext0", "-oext=0"] {
        assert_eq!(
            added(&format!("-i data.sdf {option}"), "-i data.sdf"),
            ["write_las.extra_attributes = false"]
        );
    }
    for input in ["-i data.sdf", "-idata.sdf", "-i=data.sdf", "-input data.sdf", "-input=data.sdf"] {
        assert_eq!(keys(&complete(input).text), keys(&complete("-i data.sdf").text), "{input}");
    }
    for output in ["-o*_x.las", "-o *_x.las", "-o=*_x.las", "-out *_x.las", "-out=*_x.las"] {
        let import = complete(&format!("-i data.sdf {output}"));
        assert!(keys(&import.text).contains(&"write_las.path = \"*_x.las\"".to_owned()), "{output}");
    }
}

#[test]
fn numbers_may_be_negative() {
    let added = added("-i data.sdf -t_corr -0.72 -odd_dt=-0.25", "-i data.sdf");
    assert_eq!(
        added,
        ["read_sdf.odd_sample_shift = -0.25", "read_sdf.time_offset_s = -0.72"].map(str::to_owned).as_slice()
    );
}

#[test]
fn a_switch_without_its_number_is_on_and_leaves_the_next_word_alone() {
    assert_eq!(added("-emflt -i data.sdf", "-i data.sdf"), ["decompose.drop_emission_crosstalk = true"]);
    assert_eq!(added("-fastest -det 5 -i data.sdf", "-i data.sdf").len(), 2);
}

#[test]
fn the_name_of_the_program_may_stand_before_the_line() {
    for program in ["wavex", "wavex.exe", "./wavex", r"C:\tools\WavEx.exe"] {
        let import = complete(&format!("{program} -i data.sdf"));
        assert_eq!(import.text, complete("-i data.sdf").text, "{program}");
    }
}

#[test]
fn the_input_tells_the_version() {
    for (line, version) in [
        ("-i a.las", "1.0"),
        ("-fastest -input=A.LAZ", "1.0"),
        ("-i a.sdf", "1.1"),
        ("-i a.WFM", "1.1"),
        ("-i a.arrow", "1.1"),
        ("-i a.pls", "1.1"),
        ("-v", "1.1"),
    ] {
        let first = format!("# Translation of this BayesWavEx {version} command line:");
        assert_eq!(complete(line).text.lines().next(), Some(first.as_str()), "{line}");
    }
    let forced = in_version(Some("1.1"), &words("-i a.las"), &Known::Everything, &files).unwrap();
    assert!(forced.text.starts_with("# Translation of this BayesWavEx 1.1 command"), "{}", forced.text);
    assert_eq!(
        stages(&forced.text)[..2],
        ["read_las", "calibrate"],
        "its zones are known, it has one receiver"
    );
}

/// The same letter has different meanings in the two versions.
#[test]
fn a_is_what_it_is_in_its_version() {
    assert_eq!(added("-i a.las -A 0.2", "-i a.las"), ["correct.attenuation_db_per_km = 0.2"]);
    let with_trajectory = "-i a.sdf -po a.txt";
    assert_eq!(added("-i a.sdf -po a.txt -A", with_trajectory), ["geometry.trajectory_time = \"adjusted\""]);
    assert_eq!(
        added("-i a.sdf -po a.txt -a -fastest", with_trajectory).len(),
        2,
        "options are case-sensitive"
    );
}

#[test]
fn several_inputs_are_one_list() {
    for line in ["-i a.sdf b.sdf -fastest", "-i a.sdf -fastest -i b.sdf"] {
        assert!(
            keys(&complete(line).text).contains(&"read_sdf.path = [\"a.sdf\", \"b.sdf\"]".to_owned()),
            "{line}"
        );
    }
    assert_eq!(stages(&complete("-i *.pls").text)[..2], ["read_pulsewaves", "fuse_channels"]);
}

#[test]
fn of_an_option_that_stands_twice_the_last_counts_and_the_other_is_noted() {
    let import = complete("-i data.sdf -det 5 -d 6");
    assert!(keys(&import.text).contains(&"decompose.detection_sigma = 6.0".to_owned()));
    assert_eq!(notes(&import), ["-det 5: overridden by `-d 6`"]);
}

#[test]
fn the_line_overrules_the_file_of_options() {
    let read = |path: &str| match path {
        "wavex.opt.txt" => Some("\u{feff}# ours\ndet=5\r\n\nodir=all my points\ni=file.sdf\n".to_owned()),
        "stripalign.opt" => Some("det=7".to_owned()),
        _ => None,
    };
    let import = read_with("-i data.sdf -det 6", &Known::Everything, &read).unwrap();
    let keys = keys(&import.text);
    for key in [
        "decompose.detection_sigma = 6.0",
        "job.output_dir = \"all my points\"",
        "read_sdf.path = \"data.sdf\"",
    ] {
        assert!(keys.contains(&key.to_owned()), "{key}\n{}", import.text);
    }
    assert!(
        import.text.contains("\"all my points\"  # wavex.opt.txt: odir=all my points\n"),
        "{}",
        import.text
    );
    let expected = [
        "wavex.opt.txt: i=file.sdf: overridden by `-i data.sdf`",
        "wavex.opt.txt: det=5: overridden by `-det 6`",
        "stripalign.opt: ignored: only the first file is read",
    ];
    assert_eq!(notes(&import), expected);
}

#[test]
fn zero_means_no_correction() {
    let added = added("-i data.sdf -icr 0 -ica 0 -det_lm 0 -icf 0 -bge 0", "-i data.sdf");
    let expected = [
        "calibrate.background = \"fixed\"",
        "decompose.detection_sigma_last = false",
        "correct.incidence = \"none\"",
        "correct.reference_range_m = false",
        "correct.attenuation_db_per_km = false",
    ];
    for key in expected {
        assert!(added.contains(&key.to_owned()), "{key}: {added:?}");
    }
    assert_eq!(added.len(), expected.len());
    assert_eq!(
        notes(&complete("-i data.sdf -n_ppm 0 -gps_date 0")),
        ["-gps_date 0: already the default", "-n_ppm 0: already the default"]
    );
}

#[test]
fn one_end_of_a_range_leaves_the_other_open() {
    assert_eq!(added("-i a.sdf -min_width 0.5", "-i a.sdf"), ["decompose.width_ratio = [0.5, 10.0]"]);
    assert_eq!(added("-i a.sdf -max_width 5", "-i a.sdf"), ["decompose.width_ratio = [0.8, 5.0]"]);
    assert_eq!(added("-i a.sdf -t_min 82300", "-i a.sdf"), ["read_sdf.time_s = [82300.0, 10000000000.0]"]);
    assert_eq!(added("-i a.sdf -t_max 82400", "-i a.sdf"), ["read_sdf.time_s = [-10000000000.0, 82400.0]"]);
    here("-i a.sdf -t_min 82300");
}

#[test]
fn speed_is_said_by_several_options() {
    let mode = |options: &str| added(&format!("-i a.sdf {options}"), "-i a.sdf");
    assert_eq!(mode("-f"), ["decompose.mode = \"fastest\""]);
    assert_eq!(mode("-s"), ["decompose.mode = \"fast_separated\""]);
    assert_eq!(mode("-slow"), ["decompose.mode = \"slow\""]);
    assert_eq!(mode("-fastest 0 -slow"), ["decompose.mode = \"slow\""]);
    assert_eq!(mode("-f -auto"), ["decompose.mode = \"fastest\"", "decompose.refine_when_needed = true"]);
    assert_eq!(mode("-auto"), Vec::<String>::new());
    assert_eq!(notes(&complete("-i a.sdf -auto")), ["-auto: no effect: every waveform is refined"]);
    let fast_and_slow = complete("-i a.sdf -f -slow");
    assert_eq!(notes(&fast_and_slow), ["-slow: refined waveforms get the iterations of `refined`"]);
}

#[test]
fn outputs_are_named_after_that_of_the_points() {
    let paths = |options: &str| {
        let all = keys(&complete(&format!("-i a.sdf -po b.pof -lstat {options}")).text);
        let paths = all.iter().filter(|key| key.contains(".path = ") || key.contains("stat_log"));
        let paths = paths.filter(|key| !key.starts_with("read"));
        paths.map(|key| key.rsplit_once(" = ").unwrap().1.trim_matches('"').to_owned()).collect::<Vec<_>>()
    };
    assert_eq!(paths(""), ["*_stat.log", "*.laz", "*_traj.txt", "*_lstat.txt"]);
    assert_eq!(paths("-olas"), ["*_stat.log", "*.las", "*_traj.txt", "*_lstat.txt"]);
    assert_eq!(paths("-otxt -o*_b"), ["*_b_stat.log", "*_b.txt", "*_b_traj.txt", "*_b_lstat.txt"]);
    assert_eq!(
        paths("-o day.1/*_b"),
        ["day.1/*_b_stat.log", "day.1/*_b.laz", "day.1/*_b_traj.txt", "day.1/*_b_lstat.txt"]
    );
    assert_eq!(paths("-o*.LAS")[1], "*.las");
    assert_eq!(paths("-o b.laz"), ["b_stat.log", "b.laz", "b_traj.txt", "b_lstat.txt"]);
    let of_several = keys(&complete("-i a.sdf b.sdf -o b.laz").text);
    assert!(
        of_several.contains(&"job.stat_log = \"*_stat.log\"".to_owned()),
        "statistics are those of an input"
    );
    assert_eq!(paths("-nil"), ["*_stat.log", "*_traj.txt", "*_lstat.txt"]);
    assert_eq!(paths("-otraj 0"), ["*_stat.log", "*.laz", "*_lstat.txt"]);
}

#[test]
fn text_output_has_columns_and_no_attributes_of_las() {
    let import = complete("-i a.sdf -otxt -oparse txyzi -ounc 0 -olax");
    assert_eq!(stages(&import.text).last().map(String::as_str), Some("write_ascii"));
    assert!(keys(&import.text).contains(&"write_ascii.columns = \"txyzi\"".to_owned()));
    assert_eq!(
        notes(&import),
        ["-olax: no effect: the job has no `write_las`", "-ounc 0: no effect: the job has no `write_las`"]
    );
    let las = complete("-i a.sdf -oparse txyzi");
    assert_eq!(notes(&las), ["-oparse txyzi: no effect: the job has no `write_ascii`"]);
}

#[test]
fn an_index_lies_beside_the_points_or_within() {
    let index = |options: &str| added(&format!("-i a.sdf {options}"), "-i a.sdf");
    assert_eq!(index("-olax"), ["write_las.index = \"file\""]);
    assert_eq!(index("-olax -lax_append"), ["write_las.index = \"appended\""]);
    assert_eq!(index("-lax_append"), ["write_las.index = \"appended\""]);
    assert_eq!(index("-olax 0"), Vec::<String>::new());
}

/// `write_las` refuses to append an index to LAS.
#[test]
fn an_index_of_las_is_a_file_of_its_own() {
    let remark = "separate file, because only LAZ can contain an index";
    for (options, said) in
        [("-olas -lax_append", "-lax_append"), ("-o points.las -olax -lax_append", "-olax -lax_append")]
    {
        let text = here(&format!("-i a.sdf -po a.pof {options}")).text;
        assert!(keys(&text).contains(&"write_las.index = \"file\"".to_owned()), "{text}");
        assert!(text.contains(&format!("  # {said}: {remark}\n")), "{text}");
    }
}

#[test]
fn coordinates_are_without_effect_where_there_is_no_trajectory() {
    let import = complete("-i a.sdf -utm 33 -feet -otraj");
    assert!(!import.text.contains("[job.geometry]"), "{}", import.text);
    assert_eq!(
        notes(&import),
        [
            "-otraj: no effect: `-po` is not given",
            "-utm 33: no effect: `-po` is not given",
            "-feet: no effect: `-po` is not given",
        ]
    );
    let las = complete("-i a.las -traj");
    assert_eq!(
        stages(&las.text).last().map(String::as_str),
        Some("write_trajectory"),
        "it is told from the beams"
    );
}

#[test]
fn the_trajectory_tells_the_hemisphere_of_a_zone() {
    let crs = |line: &str| {
        let text = complete(line).text;
        let line = text.lines().find(|line| line.starts_with("crs")).unwrap();
        line.split_whitespace().collect::<Vec<_>>().join(" ")
    };
    assert_eq!(
        crs("-i a.sdf -po n.pof -utm 33"),
        "crs = \"utm:33N\" # -utm 33: N, from the start of the trajectory"
    );
    assert_eq!(
        crs("-i a.sdf -po s.pof -utm55"),
        "crs = \"utm:55S\" # -utm55: S, from the start of the trajectory"
    );
    let unknown = "crs = \"utm:33\" # -utm 33: add N or S: the hemisphere is unknown";
    assert_eq!(crs("-i a.sdf -po u.pof -utm 33"), unknown);
}

/// Examples of the documents omit the roll.
#[test]
fn columns_without_the_roll_are_enough() {
    let import = here("-i a.sdf -po a.txt -po_parse xyztpk");
    let line = "trajectory_columns = \"xyztpk\"  # -po_parse xyztpk: no roll (`w`): set to 0\n";
    assert!(import.text.contains(line), "{}", import.text);
    assert_eq!((import.obstacles.len(), import.missing.len()), (0, 0));
}

#[test]
fn columns_of_a_trajectory_that_are_not_enough_are_told_and_not_run() {
    let import = here("-i a.sdf -po a.txt -po_parse xyztwk");
    let message = "-po_parse xyztwk: the pitch (`p`) is missing, and points cannot be georeferenced without it: give a trajectory \
                that has it, or add the column to the text file and its letter here";
    let line = format!("#trajectory_columns = \"xyztwk\"  # {message}\n");
    assert!(import.text.contains(&line), "{}", import.text);
    assert_eq!(import.obstacles, [message]);
    assert_eq!(import.missing, [] as [&str; 0]);
    let obstacles = |columns: &str| here(&format!("-i a.sdf -po a.txt -po_parse {columns}")).obstacles;
    assert_eq!(
        obstacles("txywk"),
        [
            "-po_parse txywk: the height (`z`) and the pitch (`p`) are missing, and points cannot be georeferenced without them: give a \
          trajectory that has them, or add the columns to the text file and their letters here"
        ]
    );
    assert_eq!(obstacles("txyzwpkz"), ["-po_parse txyzwpkz: the height (`z`) must not be repeated"]);
    assert_eq!(obstacles("xyz#wtpk"), [] as [&str; 0]);
    assert_eq!(obstacles("xyztwpwk"), ["-po_parse xyztwpwk: the roll (`w`) must not be repeated"]);
}

#[test]
fn statistics_of_the_recording_are_a_command() {
    let import = complete("-i a.sdf -osdfstat -I in -O out");
    assert_eq!(import.commands, [words("wavex scan in/a.sdf --name out/out")]);
    assert!(
        import.text.contains("\n# In addition to the job:\n#   wavex scan in/a.sdf --name out/out\n"),
        "{}",
        import.text
    );
    let two = complete("-i a.sdf b.sdf -osdfstat -name s");
    assert_eq!(two.commands, [words("wavex scan a.sdf b.sdf --name s")]);
    let fast = complete("-sdfscanfast -i a.sdf -det 5");
    assert_eq!(fast.commands, [words("wavex scan a.sdf --name out --fast")]);
    assert_eq!(notes(&fast), ["-det 5: no effect: this command line writes no points"]);
    let all = complete("-i a.sdf -po a.pof -ostat");
    assert_eq!(stages(&all.text)[8..], ["write_las", "write_trajectory", "write_lstat"]);
    assert_eq!(all.commands, [words("wavex scan a.sdf --name out")]);
    assert_eq!(notes(&complete("-i a.sdf -name x")), ["-name x: no effect: `-osdfstat` is not given"]);
}

#[test]
fn a_trajectory_can_be_projected_by_itself() {
    let line = "-po a.txt -po_parse txyzwpk -A -po_rad -geo -plot_po out.txt -po_sub 10 -O out -feet";
    let import = complete(line);
    let expected = "wavex trajectory a.txt --crs geodetic --columns txyzwpk --time adjusted --angles rad --every 10 -o out/out.txt";
    assert_eq!(import.commands, [words(expected)]);
    assert!(!import.has_job);
    assert_eq!(notes(&import), ["-feet: no effect: this command line writes no points"]);
    let besides = complete("-i a.sdf -I in -po a.pof -plot_po b.txt");
    assert_eq!(besides.commands, [words("wavex trajectory in/a.pof -o b.txt")]);
    assert!(besides.has_job);
    assert_eq!(notes(&complete("-i a.sdf -po_sub 5")), ["-po_sub 5: no effect: `-plot_po` is not given"]);
}

#[test]
fn a_shell_could_take_what_is_printed_of_commands() {
    let line = ["-sdfscan".to_owned(), "-i".to_owned(), "it's my data.sdf".to_owned()];
    let import = in_version(None, &line, &Known::Everything, &files).unwrap();
    assert!(import.text.ends_with("#   wavex scan 'it'\\''s my data.sdf' --name out\n"), "{}", import.text);
    assert!(import.text.contains("#   wavex -sdfscan -i \"it's my data.sdf\"\n"), "{}", import.text);
}

#[test]
fn a_job_that_stands_elsewhere_starts_where_the_line_was_typed() {
    let place =
        Place { known: &Known::Everything, base: Some("/here"), read: &files, latitude: &|_, _| None };
    let import = import(&words("-i a.sdf -O out"), None, &place).unwrap();
    let keys = keys(&import.text);
    assert!(keys.contains(&"job.input_dir = \"/here\"".to_owned()), "{}", import.text);
    assert!(keys.contains(&"job.output_dir = \"/here/out\"".to_owned()), "{}", import.text);
}

#[test]
fn files_with_folders_of_their_own_do_not_lie_in_the_folder_of_inputs() {
    let import = complete("-i a.sdf -po other/b.pof -I in");
    let keys = keys(&import.text);
    assert!(keys.contains(&"read_sdf.path = \"in/a.sdf\"".to_owned()), "{}", import.text);
    assert!(keys.contains(&"geometry.trajectory = \"other/b.pof\"".to_owned()), "{}", import.text);
    let note = "-I in: part of the paths below, because some files contain a folder";
    assert_eq!(notes(&import), [note]);
}

#[test]
fn matters_of_the_run_are_none_of_the_job() {
    let import = complete("-i a.sdf -q -progress 0 -log 0");
    assert_eq!(
        notes(&import),
        [
            "-q: an option of the run: `wavex run --quiet`",
            "-progress 0: an option of the run: `wavex run --progress never`",
        ]
    );
    assert!(keys(&import.text).contains(&"job.log = \"\"".to_owned()));
}

/// Time options apply to every reader, not only to that of SDF.
#[test]
fn options_for_times_are_keys_of_every_reader() {
    let line = "-t_min 82300 -t_max 82400 -t_adj -gps_date 2025-05-06 -utc -t_corr 0.72";
    let known = Known::this_build();
    for (file, reader) in [("a.las", "read_las"), ("a.pls", "read_pulsewaves"), ("a.arrow", "read_arrow")] {
        let import = in_version(Some("1.1"), &words(&format!("-i {file} {line}")), &known, &files).unwrap();
        assert_eq!(import.missing, Vec::<String>::new(), "{file}");
        wavex::job::Job::parse("job", &import.text, &[]).unwrap();
        for key in [
            "time_s = [82300.0, 82400.0]",
            "time_scale = \"adjusted\"",
            "gps_date = \"2025-05-06\"",
            "utc = true",
        ] {
            assert!(keys(&import.text).contains(&format!("{reader}.{key}")), "{}", import.text);
        }
        assert!(keys(&import.text).contains(&format!("{reader}.time_offset_s = 0.72")), "{}", import.text);
    }
    let air = in_version(Some("1.1"), &words("-i a.pls -n_ppm 280"), &known, &files).unwrap();
    assert!(keys(&air.text).contains(&"read_pulsewaves.refractive_index_ppm = 280.0".to_owned()));
}

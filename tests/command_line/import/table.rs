//! The option tables are complete and match the build.

use wavex::classic::Import;
use wavex::classic::draft::Known;
use wavex::classic::options::{Becomes, Form, Opt, Standard, Takes, Version};
use wavex::classic::versions::{self, VERSIONS};
use wavex::job::Job;
use wavex::registry::STAGES;

use super::{files, in_version, words};

/// All options that the two documents list or use, by version.
const V10: &str = "I idir O odir mem N nthreads q quiet progress i input o out oext ounc nil log olog clear_log_history ostat \
                   stat otraj traj h help ? options v version f fastest s fastsep a auto slow d det min_width max_width \
                   out_min_a out_max_h F icorr_flat R icorr_range A icorr_atm dt odd_dt t_err";
const V11: &str = "I idir O odir mem N nthreads q quiet progress i input o out olas otxt oparse oext ounc o12 olax lax_append \
                   nil log log_flush clear_log clear_log_history olstat lstat otraj ostat osdfstat name sdfscan sdfscanfast h \
                   help v version f fastest s fastsep a auto slow d det det_lm lm_det outflt emflt min_width max_width \
                   out_min_a out_max_h out_max_r bge decay_a decay_t t_min t_max t_adj ibrc utc gps_date t_corr t_err n_ppm \
                   odd_dt ibrc_fit ibic icf icr R ica awc awc1 po po_adj A po_day po_rad po_parse plot_po po_sub mount \
                   calib_corr wkt utm geo ecef geoid metre feet int_feet dumv";

fn version(name: &str) -> &'static Version {
    versions::find(name).unwrap()
}

#[test]
fn every_option_of_the_documents_is_known_by_each_of_its_names() {
    for (name, all) in [("1.0", V10), ("1.1", V11)] {
        for option in all.split_whitespace() {
            assert!(version(name).option(option).is_some(), "{name} does not know -{option}");
        }
    }
}

#[test]
fn no_name_stands_twice_and_none_is_made_up() {
    // LAStools' spelling of the default, next to -olas and -otxt.
    let spelled_out = ["olaz", "F"];
    for (name, all) in [("1.0", V10), ("1.1", V11)] {
        let names: Vec<&str> = version(name).names().collect();
        for (at, option) in names.iter().enumerate() {
            assert!(!names[..at].contains(option), "{name}: -{option} is listed twice");
            let is_listed = all.split_whitespace().any(|listed| listed == *option);
            assert!(is_listed || spelled_out.contains(option), "{name}: -{option} is in no document");
        }
    }
}

/// Section of the job for a section of the table.
fn section(version: &Version, section: &'static str) -> &'static str {
    match (section, version.name) {
        ("reader", "1.0") => "read_las",
        ("reader", _) => "read_sdf",
        _ => section,
    }
}

/// All keys in the table of a version.
fn keys(version: &'static Version) -> Vec<(&'static str, &'static str)> {
    let of_option = |option: &Opt| match option.becomes {
        Becomes::Key(of, key, _) | Becomes::End(of, key, ..) => Some((section(version, of), key)),
        _ => None,
    };
    let always = version.always.iter().map(|(section, key, ..)| (*section, *key));
    version.options.iter().filter_map(of_option).chain(always).collect()
}

#[test]
fn every_stage_and_every_key_is_one_of_this_build() {
    let build = Known::this_build();
    for version in VERSIONS {
        for (section, key) in keys(version) {
            assert!(build.has_key(section, key), "{section}.{key}");
        }
        for stage in version.chain {
            assert!(build.has_stage(stage), "there is no stage {stage}");
        }
    }
}

/// Defaults marked as the same must equal those of the build; otherwise jobs would silently differ.
#[test]
fn defaults_that_jobs_do_not_spell_out_are_those_of_this_build() {
    let build = Known::this_build();
    let mut compared = 0;
    for version in VERSIONS {
        for option in version.options {
            let (Becomes::Key(of, key, form), Standard::Same(text)) = (option.becomes, option.standard)
            else {
                continue;
            };
            let keys = build.keys_of(section(version, of)).unwrap();
            let Some(default) = keys.get(key).unwrap().default() else {
                continue;
            };
            let is_zero = text.parse::<f64>().unwrap() == 0.0;
            let expected = match (form, option.takes) {
                (Form::Switch(off, on), _) => if is_zero { off } else { on }.to_owned(),
                (Form::ZeroIs(other), _) if is_zero => other.to_owned(),
                (_, Takes::Switch) => (!is_zero).to_string(),
                _ => text.to_owned(),
            };
            if expected.is_empty() {
                continue;
            }
            // `4` and `4.0` are equal as numbers, but different JSON values.
            let expected: serde_json::Value = serde_json::from_str(&expected).unwrap();
            let same = match (default.as_f64(), expected.as_f64()) {
                (Some(default), Some(expected)) => default == expected,
                _ => *default == expected,
            };
            assert!(same, "{} -{}: {default} is not {expected}", version.name, option.name());
            compared += 1;
        }
    }
    assert!(compared >= 20, "only {compared} defaults could be compared");
}

#[test]
fn the_two_ends_of_a_range_begin_as_those_of_this_build() {
    let build = Known::this_build();
    let decompose = build.keys_of("decompose").unwrap();
    let default = decompose.get("width_ratio").unwrap().default().unwrap();
    for version in VERSIONS {
        for option in version.options {
            if let Becomes::End("decompose", _, _, open) = option.becomes {
                assert_eq!(*default, serde_json::json!(open), "-{}", option.name());
            }
        }
    }
}

/// A line with this option and its prerequisites, and the option as written in it.
fn line_with(version: &Version, option: &Opt) -> (String, String) {
    let argument = match (option.name(), option.takes) {
        ("mount", _) => "mnt.txt",
        ("o", _) => "new.laz",
        ("oparse" | "po_parse", _) => "txyzwpk",
        ("mem", _) => "512",
        ("icr" | "R" | "max_width" | "d" | "det_lm", _) => "5.5",
        (_, Takes::Switch) => "1",
        (_, Takes::Number) => "0.25",
        (_, Takes::Whole(..)) => "7",
        (_, Takes::Date) => "2018-11-14",
        (_, Takes::Text(_) | Takes::Texts(_)) => "some.file",
    };
    let written = format!("-{} {argument}", option.name());
    let (input, po) = match version.name {
        "1.0" => ("waveform.las", ""),
        _ => ("data.sdf", " -po file.pof"),
    };
    let companion = match option.name() {
        "decay_a" => " -decay_t 5.5",
        "decay_t" => " -decay_a 0.25",
        _ => "",
    };
    let (input, po) =
        (if option.name() == "i" { "" } else { input }, if option.name() == "po" { "" } else { po });
    let line = match option.name() {
        "i" => format!("-i {input}"),
        _ => format!("-i {input}{po} {written}{companion}"),
    };
    (line.replace("-i  ", "-i "), written)
}

fn imported(version: &Version, line: &str, known: &Known) -> Import {
    in_version(Some(version.name), &words(line), known, &files)
        .unwrap_or_else(|problem| panic!("{line}: {problem}"))
}

/// Every option leaves a key, a note or a command in the job, apart from the quoted line.
#[test]
fn every_option_leaves_its_mark_in_the_job() {
    for version in VERSIONS {
        for option in version.options.iter().filter(|option| option.name() != "i") {
            let (line, written) = line_with(version, option);
            for known in [Known::Everything, Known::this_build()] {
                let import = imported(version, &line, &known);
                let below = import.text.lines().skip(3).collect::<Vec<_>>().join("\n");
                let has_command = match option.becomes {
                    Becomes::Command(words) => below.contains(&words.join(" ")),
                    _ => !import.commands.is_empty(),
                };
                assert!(below.contains(&written) || has_command, "{line}\n{}", import.text);
            }
        }
    }
}

#[test]
fn every_option_gives_a_job_that_fits_this_build() {
    for version in VERSIONS {
        for option in version.options.iter().filter(|option| option.name() != "i") {
            let (line, _) = line_with(version, option);
            let import = imported(version, &line, &Known::this_build());
            let job = import.has_job.then(|| Job::parse(STAGES, "job", &import.text, &[]));
            assert!(job.is_none_or(|job| job.map_err(|error| panic!("{error}")).is_ok()), "{line}");
        }
    }
}

/// A switch that is off has no effect or a note; the resulting job is valid.
#[test]
fn every_switch_may_be_off() {
    for version in VERSIONS {
        for option in version.options.iter().filter(|option| option.takes == Takes::Switch) {
            let (line, written) = line_with(version, option);
            let off = written.replace(" 1", " 0");
            let import = imported(version, &line.replace(&written, &off), &Known::this_build());
            let below = import.text.lines().skip(3).collect::<Vec<_>>().join("\n");
            assert!(below.contains(&off), "{off}\n{}", import.text);
            assert!(Job::parse(STAGES, "job", &import.text, &[]).is_ok(), "{off}\n{}", import.text);
        }
    }
}

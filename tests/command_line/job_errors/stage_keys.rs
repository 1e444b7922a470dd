//! Errors that registered stages report for their own keys.

use wavex::job::Job;

/// Asserts that a stage with this key line is refused with this message at that line.
#[track_caller]
fn refused(stage: &str, line: &str, message: &str) {
    let keys = |of: &str| if of == stage { format!("{line}\n") } else { String::new() };
    let text = format!(
        "[[stage]]\ntype = \"read_arrow\"\npath = \"a.arrow\"\n{}\n[[stage]]\ntype = \"calibrate\"\n{}\n\
         [[stage]]\ntype = \"decompose\"\n{}\n",
        keys("read_arrow"),
        keys("calibrate"),
        keys("decompose")
    );
    let error = Job::parse("job.toml", &text, &[]).unwrap_err().to_string();
    let first = error.lines().next().unwrap();
    assert_eq!(first, format!("error: {message}"));
    assert!(error.contains(line.lines().next().unwrap()), "{error}");
}

#[test]
fn keys_of_decompose() {
    let problem = "`detection_sigma_last`: it must be at least `detection_sigma`, or `false`";
    refused("decompose", "detection_sigma_last = 4.0", problem);
    let problem = "`detection_sigma_last` must be at least 2 and at most 1000, got 1001";
    refused("decompose", "detection_sigma_last = 1001", problem);
    let problem =
        "`detection_sigma_last` must be a number, at least 2 and at most 1000, or `false`, got `true`";
    refused("decompose", "detection_sigma_last = true", problem);
    let problem = "`split_evidence` must be at least 4 and at most 1000000, got 3";
    refused("decompose", "split_evidence = 3", problem);
    let problem = "`drop_emission_crosstalk` must be `true` or `false`, got the number 1";
    refused("decompose", "drop_emission_crosstalk = 1", problem);
    let problem = "`mode` must be \"fastest\", \"fast_separated\", \"refined\" or \"slow\", got \"fast\"";
    refused("decompose", "mode = \"fast\"", problem);
    let problem = "`refine_when_needed`: it has no effect in this `mode`, which refines every waveform; \
                   leave it out, or choose `mode = \"fastest\"` or `\"fast_separated\"`";
    refused("decompose", "refine_when_needed = true", problem);
    refused("decompose", "refine_when_needed = true\nmode = \"slow\"", problem);
}

#[test]
fn keys_of_calibrate() {
    let problem = "`decay_amplitude` must be above -0.9 and below 0.9, got 0.9";
    refused("calibrate", "decay_amplitude = 0.9\ndecay_time_ns = 20", problem);
    let problem = "`decay_time_ns` must be above 0 and at most 1000000, got 0";
    refused("calibrate", "decay_time_ns = 0\ndecay_amplitude = 0.1", problem);
    let problem = "`decay_amplitude`: it also needs decay_time_ns";
    refused("calibrate", "decay_amplitude = 0.1", problem);
    let problem = "`decay_time_ns`: it also needs decay_amplitude";
    refused("calibrate", "decay_time_ns = 20", problem);
    let problem = "`preset`: `preset` and `load` both give a model: remove one of them";
    refused("calibrate", "preset = 'riegl_lms_q680'\nload = 'model.json'", problem);
}

#[test]
fn keys_of_readers() {
    let problem = "`odd_sample_shift` must be above -0.5 and below 0.5, got ";
    refused("read_arrow", "odd_sample_shift = 0.5", &format!("{problem}0.5"));
    for reader in ["read_las", "read_pulsewaves"] {
        let text = format!("[[stage]]\ntype = \"{reader}\"\npath = \"a\"\nodd_sample_shift = -2\n");
        let error = Job::parse("job.toml", &text, &[]).unwrap_err().to_string();
        assert!(error.starts_with(&format!("error: {problem}-2\n --> job.toml:4:20")), "{error}");
    }
    let problem = "`full_scale_dn` must be at least 15 and at most 65535, got 14";
    refused("read_arrow", "full_scale_dn = 14", problem);
    let text = "[[stage]]\ntype = \"read_las\"\npath = \"a\"\nrange_time_offset_ns = -1001.0\n";
    let error = Job::parse("job.toml", text, &[]).unwrap_err().to_string();
    let problem = "`range_time_offset_ns` must be at least -1000 and at most 1000, got -1001.0";
    assert!(error.starts_with(&format!("error: {problem}\n --> job.toml:4:24")), "{error}");
}

//! Any job text is parsed or refused with a reason.

use proptest::prelude::*;

use super::{FULL, parse};

/// Parses a job and asserts that each error is shown with its position.
fn survives(text: &str, overrides: &[&str]) {
    if let Err(errors) = parse(text, overrides) {
        let shown = errors.to_string();
        assert!(!errors.errors().is_empty(), "refused without a reason");
        assert!(shown.starts_with("error: ") && shown.contains("--> "), "{shown}");
    }
}

#[test]
fn no_prefix_of_a_job_makes_it_panic() {
    let text =
        format!("{FULL}\n[stage.mount]\nforward_m = [1.5, {{ a = 'é' }}] # x\n[job]\nthreads = 0x10\n");
    let ends = text.char_indices().map(|(at, _)| at).chain([text.len()]);
    for end in ends {
        survives(&text[..end], &["decompose.detection_sigma=5"]);
    }
    let override_text = "write_las.path=[\"é\", { a = 1 }]";
    for (end, _) in override_text.char_indices() {
        survives(FULL, &[&override_text[..end]]);
    }
}

/// Fragments of TOML and of jobs, in any order.
fn pieces() -> impl Strategy<Value = String> {
    let text = r#"[[stage]]|[job]|[stage.mount]|type = |"read_las"|"decompose"|"write_las"|path = |id = |threads = "#;
    let more = r#"control = |"é*.las"|1|-0.5e9|nan|true|[|]|{|}|=|,|.| |'|"""|#|1979-05-27|0x|\u00e9|\"#;
    let signs = ["\n", "\n", "\r\n", "\t", "\u{feff}"];
    let piece = prop::sample::select(text.split('|').chain(more.split('|')).chain(signs).collect::<Vec<_>>());
    prop::collection::vec(piece, 0..40).prop_map(|pieces| pieces.concat())
}

proptest! {
    #[test]
    fn no_text_makes_it_panic(text in "(?s).{0,200}", change in "(?s).{0,40}") {
        survives(&text, &[&change]);
    }

    #[test]
    fn nothing_that_resembles_a_job_makes_it_panic(text in pieces(), change in pieces()) {
        survives(&text, &[]);
        survives(FULL, &[&format!("decompose.{change}"), "georeference.control=[{}]"]);
    }

    #[test]
    fn a_job_with_a_character_changed_does_not_make_it_panic(at in 0..FULL.len(), new in any::<char>()) {
        let changed: String =
            FULL.char_indices().map(|(index, old)| if index == at { new } else { old }).collect();
        survives(&changed, &[]);
    }
}

//! The keys `report_page` and `survey_page`: a name or a flag.

use schemars::JsonSchema;
use serde::{Deserialize, Deserializer};

/// Default name of the page, as in `wavex report`; `*` is the stem of the job file.
const USUAL_NAME: &str = "*_report.html";
/// Default name of the survey's page.
const SURVEY_NAME: &str = "*_survey.html";

/// Name of a file of a run whose job file has this stem: `*` is replaced, and `survey_survey` becomes `survey`.
pub fn named(pattern: &str, stem: &str) -> String {
    match pattern.strip_prefix("*_survey") {
        Some(rest) if stem.ends_with("survey") => format!("{stem}{rest}"),
        _ => pattern.replace('*', stem),
    }
}

/// Message if `report` is given a Boolean value.
pub(super) const REPORT_IS_A_NAME: &str = "it is the name of the JSON report, or \"\" for none; to get the report as a page, set \
                                           `report_page = true`";

/// Accepted values.
#[derive(Deserialize, JsonSchema)]
#[serde(untagged)]
pub(super) enum PageKey {
    /// Whether to write a page with the default name.
    IsWanted(bool),
    /// Name of the page.
    Name(String),
}

/// Returns the name of the page; empty for none.
pub(super) fn name<'de, D: Deserializer<'de>>(from: D) -> Result<String, D::Error> {
    name_or(USUAL_NAME, from)
}

/// Returns the name of the survey's page; empty for none.
pub(super) fn survey_name<'de, D: Deserializer<'de>>(from: D) -> Result<String, D::Error> {
    name_or(SURVEY_NAME, from)
}

fn name_or<'de, D: Deserializer<'de>>(usual: &str, from: D) -> Result<String, D::Error> {
    Ok(match PageKey::deserialize(from)? {
        PageKey::IsWanted(true) => usual.to_owned(),
        PageKey::IsWanted(false) => String::new(),
        PageKey::Name(name) => name,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_do_not_repeat_survey() {
        let names =
            ["*_survey.html", "*_report.html", "*.html", "page.html"].map(|pattern| named(pattern, "survey"));
        assert_eq!(names, ["survey.html", "survey_report.html", "survey.html", "page.html"]);
        assert_eq!(named("*_survey.html", "night7"), "night7_survey.html");
    }
}

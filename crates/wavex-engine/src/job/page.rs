//! The keys `report_page` and `survey_page`: a name or a flag.

use schemars::JsonSchema;
use serde::{Deserialize, Deserializer};

/// Default name of the page, as in `wavex report`; `*` is the stem of the job file.
const USUAL_NAME: &str = "*_report.html";
/// Default name of the survey's page.
const SURVEY_NAME: &str = "*_survey.html";

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

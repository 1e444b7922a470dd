//! The key `report_page`: a name, or whether there is to be a page.

use schemars::JsonSchema;
use serde::{Deserialize, Deserializer};

/// What the page is called where a job only asks for one, as `wavex report` calls it.
const USUAL_NAME: &str = "report.html";

/// What is said where `report` is given a truth value.
pub(super) const REPORT_IS_A_NAME: &str = "it is the name of the report (JSON), \"\" for none; the report as a page is asked for \
                                           by `report_page = true`";

/// What a job may give.
#[derive(Deserialize, JsonSchema)]
#[serde(untagged)]
pub(super) enum PageKey {
    /// Whether there is to be one.
    IsWanted(bool),
    /// Its name.
    Name(String),
}

/// The name of the page; empty where there is none.
pub(super) fn name<'de, D: Deserializer<'de>>(from: D) -> Result<String, D::Error> {
    Ok(match PageKey::deserialize(from)? {
        PageKey::IsWanted(true) => USUAL_NAME.to_owned(),
        PageKey::IsWanted(false) => String::new(),
        PageKey::Name(name) => name,
    })
}

//! PROJ strings: their parameters by key.

use super::CrsError;

/// Parameters of a PROJ string, in order.
pub(super) struct ProjString<'a> {
    /// Name of the CRS, for errors.
    pub(super) name: &'a str,
    pub(super) pairs: Vec<(&'a str, &'a str)>,
    /// True if the text contains it: omitted parameters then have PROJ's defaults.
    pub(super) is_own: bool,
}

impl<'a> ProjString<'a> {
    /// Reads a PROJ string, as in `+proj=utm +zone=33`.
    pub(super) fn parse(name: &'a str, text: &'a str, is_own: bool) -> ProjString<'a> {
        let words = text.split_whitespace().map(|word| word.trim_start_matches('+'));
        let pairs = words.map(|word| word.split_once('=').unwrap_or((word, ""))).collect();
        ProjString { name, pairs, is_own }
    }

    /// Value of a parameter as written.
    pub(super) fn text(&self, key: &str) -> Option<&str> {
        self.pairs.iter().find(|pair| pair.0 == key).map(|pair| pair.1)
    }

    /// A numeric parameter, or its default.
    pub(super) fn number(&self, key: &str, otherwise: f64) -> Result<f64, CrsError> {
        let Some(text) = self.text(key) else { return Ok(otherwise) };
        text.parse().ok().filter(|number: &f64| number.is_finite()).ok_or_else(|| {
            self.unsupported(
                format!("its parameter {key} is `{text}`, which is not a number"),
                "check the definition of the CRS",
            )
        })
    }

    pub(super) fn radians(&self, key: &str, otherwise_deg: f64) -> Result<f64, CrsError> {
        Ok(self.number(key, otherwise_deg)?.to_radians())
    }

    pub(super) fn unsupported(&self, problem: String, remedy: &'static str) -> CrsError {
        CrsError::Unsupported { name: self.name.into(), problem, remedy }
    }
}

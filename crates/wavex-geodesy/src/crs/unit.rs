//! Units of length.

use super::wkt::WktNode;

/// Unit of length of coordinates.
#[derive(Clone, Debug, PartialEq)]
pub struct Unit {
    /// Name in WKT.
    pub name: String,
    /// Length in metres.
    pub metres: f64,
    /// EPSG code, if known.
    pub epsg: Option<u16>,
}

/// Name, metres and EPSG code of the known units.
const METRE: (&str, f64, u16) = ("metre", 1.0, 9001);
const FOOT: (&str, f64, u16) = ("foot", 0.3048, 9002);
const US_SURVEY_FOOT: (&str, f64, u16) = ("US survey foot", 1200.0 / 3937.0, 9003);
const KNOWN: [(&str, f64, u16); 3] = [METRE, FOOT, US_SURVEY_FOOT];

impl Unit {
    /// The metre (EPSG 9001).
    pub fn metre() -> Unit {
        Unit::known(METRE)
    }

    /// The international foot of 0.3048 m (EPSG 9002).
    pub fn foot() -> Unit {
        Unit::known(FOOT)
    }

    /// The US survey foot of 1200/3937 m (EPSG 9003).
    pub fn us_survey_foot() -> Unit {
        Unit::known(US_SURVEY_FOOT)
    }

    /// The unit of a job's keyword: `m`, `us_ft`, `ft`.
    pub fn of_word(word: &str) -> Option<Unit> {
        match word {
            "m" => Some(Unit::metre()),
            "ft" => Some(Unit::foot()),
            "us_ft" => Some(Unit::us_survey_foot()),
            _ => None,
        }
    }

    /// A unit of this length; a known unit if they agree within 1e-11.
    ///
    /// That is 0.1 mm in the largest possible coordinates.
    pub(crate) fn of_metres(name: &str, metres: f64) -> Unit {
        let same = |known: &&(&str, f64, u16)| (known.1 / metres - 1.0).abs() < 1e-11;
        match KNOWN.iter().find(same) {
            Some(known) => Unit::known(*known),
            None => Unit { name: name.into(), metres, epsg: None },
        }
    }

    /// Whether two units have the same length.
    pub(crate) fn is_as_long_as(&self, other: &Unit) -> bool {
        self.metres.to_bits() == other.metres.to_bits()
    }

    /// The unit as WKT 1.
    pub(crate) fn wkt(&self) -> WktNode {
        WktNode::named("UNIT", &self.name).number(self.metres).authority(self.epsg.map(u32::from))
    }

    fn known((name, metres, epsg): (&str, f64, u16)) -> Unit {
        Unit { name: name.into(), metres, epsg: Some(epsg) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn units_have_words_and_lengths() {
        let metres = |word| Unit::of_word(word).map(|unit| unit.metres);
        assert_eq!(metres("m"), Some(1.0));
        assert_eq!(metres("ft"), Some(0.3048));
        assert_eq!(metres("us_ft").map(|m| m * 3937.0), Some(1200.0));
        assert_eq!(metres("feet"), None);
        assert_eq!(Unit::of_metres("Foot_US", 0.304_800_609_601_219_2), Unit::us_survey_foot());
        assert_eq!(Unit::of_metres("link", 0.201_168).wkt().to_string(), r#"UNIT["link",0.201168]"#);
        assert_eq!(Unit::foot().wkt().to_string(), r#"UNIT["foot",0.3048,AUTHORITY["EPSG","9002"]]"#);
    }
}

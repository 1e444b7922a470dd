//! Parameters of a request.

use std::str::FromStr;

/// Longest value of a parameter, bytes.
const MAX_VALUE: usize = 1000;
/// Most parameters of a request.
const MAX_PARAMETERS: usize = 40;

/// Parameters in the order of the request, decoded.
pub(super) struct Query(Vec<(String, String)>);

impl Query {
    /// Parses the part of an address after `?`.
    ///
    /// # Errors
    /// If it has too many or too long parameters, or is not UTF-8.
    pub(super) fn parse(text: &str) -> Result<Query, String> {
        let mut parameters = Vec::new();
        for part in text.split('&').filter(|part| !part.is_empty()) {
            if parameters.len() == MAX_PARAMETERS {
                return Err(format!("more than {MAX_PARAMETERS} parameters"));
            }
            let (name, value) = part.split_once('=').unwrap_or((part, ""));
            if value.len() > 3 * MAX_VALUE {
                return Err(format!("the parameter {name:.40} is longer than {MAX_VALUE} bytes"));
            }
            parameters.push((decoded(name)?, decoded(value)?));
        }
        Ok(Query(parameters))
    }

    /// All values of a parameter.
    pub(super) fn all(&self, name: &str) -> Vec<String> {
        self.0.iter().filter(|(key, _)| key == name).map(|(_, value)| value.clone()).collect()
    }

    /// The first value of a parameter.
    pub(super) fn get(&self, name: &str) -> Option<&str> {
        self.0.iter().find(|(key, _)| key == name).map(|(_, value)| value.as_str())
    }

    /// A required number.
    ///
    /// # Errors
    /// If the parameter is missing or no such number.
    pub(super) fn number<T: FromStr>(&self, name: &str) -> Result<T, String> {
        let value = self.get(name).ok_or_else(|| format!("the parameter {name} is missing"))?;
        value.parse().map_err(|_| format!("{name}: {value:?} is not a number of this kind"))
    }

    /// A required place `x,y`, finite.
    ///
    /// # Errors
    /// If the parameter is missing or no place.
    pub(super) fn place(&self, name: &str) -> Result<[f64; 2], String> {
        let value = self.get(name).ok_or_else(|| format!("the parameter {name} is missing"))?;
        let place = value.split_once(',').and_then(|(x, y)| Some([x.parse().ok()?, y.parse().ok()?]));
        place
            .filter(|place: &[f64; 2]| place.iter().all(|coordinate| coordinate.is_finite()))
            .ok_or_else(|| format!("{name}: {value:?} is not a place such as 1.5,2.5"))
    }
}

/// Decodes `%41` and `+`.
fn decoded(text: &str) -> Result<String, String> {
    let wrong = || "the address is not encoded in UTF-8".to_owned();
    let mut bytes = Vec::with_capacity(text.len());
    let mut rest = text.bytes();
    while let Some(byte) = rest.next() {
        bytes.push(match byte {
            b'+' => b' ',
            b'%' => {
                let mut digit = || rest.next().and_then(|digit| char::from(digit).to_digit(16));
                let (high, low) = (digit().ok_or_else(wrong)?, digit().ok_or_else(wrong)?);
                (16 * high + low) as u8
            }
            other => other,
        });
    }
    String::from_utf8(bytes).map_err(|_| wrong())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parameters_are_decoded_and_bounded() {
        let query = Query::parse("set=decompose.mode%3Dslow&set=a+b&shot=12&from=1.5,-2e3&empty").unwrap();
        assert_eq!(query.all("set"), ["decompose.mode=slow", "a b"]);
        assert_eq!(query.number::<u64>("shot"), Ok(12));
        assert_eq!(query.place("from"), Ok([1.5, -2000.0]));
        assert_eq!(query.get("empty"), Some(""));
        let problems = [
            query.number::<u64>("input").unwrap_err(),
            query.number::<u64>("from").unwrap_err(),
            query.place("shot").unwrap_err(),
            Query::parse("a=%zz").err().unwrap(),
            Query::parse("a=%ff").err().unwrap(),
            Query::parse(&"a=1&".repeat(50)).err().unwrap(),
            Query::parse(&format!("a={}", "x".repeat(4000))).err().unwrap(),
        ];
        assert_eq!(
            problems,
            [
                "the parameter input is missing",
                "from: \"1.5,-2e3\" is not a number of this kind",
                "shot: \"12\" is not a place such as 1.5,2.5",
                "the address is not encoded in UTF-8",
                "the address is not encoded in UTF-8",
                "more than 40 parameters",
                "the parameter a is longer than 1000 bytes",
            ]
        );
        for place in ["nan,1", "inf,1"] {
            assert!(Query::parse(&format!("from={place}")).unwrap().place("from").is_err());
        }
    }
}

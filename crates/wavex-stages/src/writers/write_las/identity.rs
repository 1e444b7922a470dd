//! Flight line and project of a file.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use wavex_line::stage::{Result, RunContext, StageError};

/// Source of the point source ID.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(untagged)]
pub enum PointSourceKey {
    /// The same number for all points: 0 to 65535.
    Number(u16),
    /// A property of the recording or of the point.
    Rule(PointSourceRule),
}

/// Property that gives the point source ID.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum PointSourceRule {
    /// Number of the input in the job, from 1.
    Line,
    /// Last number in the input's file name.
    Name,
    /// Multiple-time-around zone of the point.
    Zone,
}

impl PointSourceKey {
    /// Flight line of a run: point source ID of all points, and file source ID.
    ///
    /// `None`: each point has its zone, and the file has no ID.
    ///
    /// # Errors
    /// The file name has no number, or the number is above 65 535.
    pub(super) fn flight_line(self, run: &RunContext) -> Result<Option<u16>> {
        match self {
            PointSourceKey::Number(number) => Ok(Some(number)),
            PointSourceKey::Rule(PointSourceRule::Zone) => Ok(None),
            PointSourceKey::Rule(PointSourceRule::Line) => {
                let problem = || format!("input {} of the job has no point source ID", run.number);
                u16::try_from(run.number).map(Some).map_err(|_| {
                    StageError::failed(problem(), "65535 is the largest: give `point_source_id` a number")
                })
            }
            PointSourceKey::Rule(PointSourceRule::Name) => {
                let digits = run.stem.split(|c: char| !c.is_ascii_digit()).rfind(|digits| !digits.is_empty());
                digits.and_then(|digits| digits.parse().ok()).map(Some).ok_or_else(|| {
                    let problem = format!("the name `{}` has no number from 0 to 65535 at its end", run.stem);
                    StageError::failed(problem, "give `point_source_id` a number, or \"line\"")
                })
            }
        }
    }
}

/// Bytes of a GUID in a header, from `943FA8B0-9E3C-4E8A-8F65-0A7B1C2D3E4F`; `None` if it is none.
///
/// The first three groups are little-endian numbers.
pub(super) fn guid(text: &str) -> Option<[u8; 16]> {
    let groups: Vec<&str> = text.split('-').collect();
    let is_guid = groups.iter().map(|group| group.len()).eq([8, 4, 4, 4, 12])
        && text.bytes().all(|c| c == b'-' || c.is_ascii_hexdigit());
    let mut bytes = u128::from_str_radix(&groups.concat(), 16).ok().filter(|_| is_guid)?.to_be_bytes();
    [0..4, 4..6, 6..8].into_iter().for_each(|group| bytes[group].reverse());
    Some(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn flight_line(key: PointSourceKey, stem: &str, number: u32) -> Result<Option<u16>> {
        let run = RunContext { stem: stem.into(), number, ..RunContext::alone("".as_ref()) };
        key.flight_line(&run)
    }

    #[test]
    fn a_flight_line_has_the_number_of_its_input_or_of_its_name() {
        let rule = PointSourceKey::Rule;
        assert_eq!(flight_line(rule(PointSourceRule::Line), "a", 3).unwrap(), Some(3));
        assert_eq!(flight_line(rule(PointSourceRule::Name), "20260512_line007b", 3).unwrap(), Some(7));
        assert_eq!(flight_line(rule(PointSourceRule::Zone), "a7", 3).unwrap(), None);
        assert_eq!(flight_line(PointSourceKey::Number(12), "a7", 3).unwrap(), Some(12));
        for name in ["flight", "flight_20260512", ""] {
            let error = flight_line(rule(PointSourceRule::Name), name, 3).unwrap_err().to_string();
            assert!(error.contains("has no number"), "{error}");
        }
        assert!(flight_line(rule(PointSourceRule::Line), "a", 65_536).is_err());
    }

    #[test]
    fn a_guid_is_stored_as_three_numbers_and_bytes() {
        let bytes = guid("00112233-4455-6677-8899-AAbbccddeeff").unwrap();
        let expected: [u8; 16] =
            [0x33, 0x22, 0x11, 0, 0x55, 0x44, 0x77, 0x66, 0x88, 0x99, 0xaa, 0xbb, 0xcc, 0xdd, 0xee, 0xff];
        assert_eq!(bytes, expected);
        for wrong in
            ["", "00112233", "00112233-4455-6677-8899-AAbbccddeefg", "+0112233-4455-6677-8899-AAbbccddeeff"]
        {
            assert_eq!(guid(wrong), None, "{wrong}");
        }
    }
}

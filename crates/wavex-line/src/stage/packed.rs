//! Long lists of numbers as one space-separated text each.
//!
//! Keeps indented reports short.

use serde::{Deserialize, Deserializer, Serializer, de::Error};

/// Element of a packed list.
pub trait Packable: Copy {
    /// Formats the value.
    fn text(self) -> String;
    /// Parses a value; `None` if invalid.
    fn read(text: &str) -> Option<Self>;
}

/// Rounded to a thousandth.
impl Packable for f64 {
    fn text(self) -> String {
        // Turns -0 into 0.
        ((self * 1e3).round() / 1e3 + 0.0).to_string()
    }

    fn read(text: &str) -> Option<f64> {
        text.parse().ok().filter(|value: &f64| value.is_finite())
    }
}

impl Packable for u16 {
    fn text(self) -> String {
        self.to_string()
    }

    fn read(text: &str) -> Option<u16> {
        text.parse().ok()
    }
}

impl Packable for u64 {
    fn text(self) -> String {
        self.to_string()
    }

    fn read(text: &str) -> Option<u64> {
        text.parse().ok()
    }
}

impl Packable for bool {
    fn text(self) -> String {
        u8::from(self).to_string()
    }

    fn read(text: &str) -> Option<bool> {
        match text {
            "0" => Some(false),
            "1" => Some(true),
            _ => None,
        }
    }
}

fn pack<T: Packable>(list: &[T]) -> String {
    list.iter().map(|value| value.text()).collect::<Vec<String>>().join(" ")
}

fn unpack<T: Packable, E: Error>(text: &str) -> Result<Vec<T>, E> {
    let number = |word| T::read(word).ok_or_else(|| E::custom(format!("{word:?} is not valid in this list")));
    text.split_ascii_whitespace().map(number).collect()
}

/// For `#[serde(serialize_with)]`.
pub fn serialize<T: Packable, S: Serializer>(list: &[T], to: S) -> Result<S::Ok, S::Error> {
    to.serialize_str(&pack(list))
}

/// For `#[serde(deserialize_with)]`.
pub fn deserialize<'de, T: Packable, D: Deserializer<'de>>(from: D) -> Result<Vec<T>, D::Error> {
    unpack(&String::deserialize(from)?)
}

/// The same for lists of lists, one text per list.
pub(crate) mod lists {
    use serde::{Deserialize, Deserializer, Serializer};

    /// For `#[serde(serialize_with)]`.
    pub fn serialize<S: Serializer>(lists: &[Vec<f64>], to: S) -> Result<S::Ok, S::Error> {
        to.collect_seq(lists.iter().map(|list| super::pack(list)))
    }

    /// For `#[serde(deserialize_with)]`.
    pub fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<Vec<Vec<f64>>, D::Error> {
        Vec::<String>::deserialize(from)?.iter().map(|text| super::unpack(text)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lists_come_back() {
        let read = |text: &str| unpack::<f64, serde_json::Error>(text).unwrap();
        assert_eq!(pack(&[1.0, -0.25, 12.345_678, -0.0001, 1e6]), "1 -0.25 12.346 0 1000000");
        assert_eq!(read("1 -0.25 12.346"), [1.0, -0.25, 12.346]);
        assert_eq!(read(&pack::<f64>(&[])), [] as [f64; 0]);
        assert_eq!(pack(&[true, false]), "1 0");
        assert_eq!(unpack::<bool, serde_json::Error>("1 0").unwrap(), [true, false]);
        assert_eq!(unpack::<u16, serde_json::Error>(&pack(&[7u16, 65535])).unwrap(), [7, 65535]);
        assert_eq!(unpack::<u64, serde_json::Error>(&pack(&[u64::MAX])).unwrap(), [u64::MAX]);
    }

    #[test]
    fn what_is_no_number_is_named() {
        let problem = |text: &str| unpack::<f64, serde_json::Error>(text).unwrap_err().to_string();
        for word in ["x", "inf", "NaN", "1e999"] {
            assert_eq!(problem(&format!("1 {word}")), format!("{word:?} is not valid in this list"));
        }
        assert!(unpack::<bool, serde_json::Error>("2").is_err());
        assert!(unpack::<u16, serde_json::Error>("65536").is_err());
    }
}

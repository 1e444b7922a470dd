//! Bounds of the numbers that a key accepts.

use schemars::Schema;
use schemars::transform::{Transform, transform_subschemas};
use serde_json::{Value, json};

use super::schema_prose;

/// Bounds of a key: `#[schemars(transform = above(0.0).at_most(1.0))]`.
///
/// They apply to a number, to the numbers of a list, and to numbers among alternatives. For a single
/// number with both bounds included, `#[schemars(range(min = 0.0, max = 1.0))]` is equivalent. Check,
/// schema and manual of a job take them from there.
#[derive(Clone, Copy, Debug)]
pub struct Bounds {
    lower: Bound,
    upper: Option<Bound>,
}

/// Schema keyword and limit.
type Bound = (&'static str, f64);

/// Bounds from `limit`, included.
pub const fn at_least(limit: f64) -> Bounds {
    Bounds { lower: ("minimum", limit), upper: None }
}

/// Bounds from `limit`, excluded.
pub const fn above(limit: f64) -> Bounds {
    Bounds { lower: ("exclusiveMinimum", limit), upper: None }
}

impl Bounds {
    /// The same up to `limit`, included.
    pub const fn at_most(self, limit: f64) -> Bounds {
        Bounds { upper: Some(("maximum", limit)), ..self }
    }

    /// The same up to `limit`, excluded.
    pub const fn below(self, limit: f64) -> Bounds {
        Bounds { upper: Some(("exclusiveMaximum", limit)), ..self }
    }
}

/// Keywords of bounds.
const KEYWORDS: [&str; 4] = ["minimum", "exclusiveMinimum", "maximum", "exclusiveMaximum"];

impl Transform for Bounds {
    fn transform(&mut self, schema: &mut Schema) {
        transform_subschemas(self, schema);
        let is_of = |name: &str| match schema.get("type") {
            Some(Value::Array(types)) => types.iter().any(|given| given == name),
            given => given.is_some_and(|given| given == name),
        };
        let is_integer = is_of("integer");
        if !is_integer && !is_of("number") {
            return;
        }
        for keyword in KEYWORDS {
            super::take(schema, keyword);
        }
        for (keyword, limit) in [Some(self.lower), self.upper].into_iter().flatten() {
            let limit = if is_integer { json!(limit as i64) } else { json!(limit) };
            schema.insert(keyword.to_owned(), limit);
        }
    }
}

/// Whether a number is within the bounds of a schema.
pub fn is_within(schema: &Value, number: f64) -> bool {
    let limit = |keyword: &str| schema.get(keyword).and_then(Value::as_f64);
    let [min, above, max, below] = KEYWORDS.map(limit);
    min.is_none_or(|min| number >= min)
        && above.is_none_or(|above| number > above)
        && max.is_none_or(|max| number <= max)
        && below.is_none_or(|below| number < below)
}

/// Describes the first number of a table that is outside the bounds of its key, if any.
///
/// For tables that are read from files of their own. Null is a number that is not finite.
pub(super) fn violation(schema: &Value, table: &Value) -> Option<String> {
    let (properties, members) = (schema.get("properties")?, table.as_object()?);
    members.iter().find_map(|(name, value)| {
        let (schema, found) = outside(properties.get(name)?, value)?;
        let found =
            if found.is_null() { "a number that is not finite".to_owned() } else { found.to_string() };
        Some(format!("`{name}` must be {}, got {found}", schema_prose::bounds(schema)?))
    })
}

/// The first number of a value, or of its items, that is outside the bounds of its schema.
fn outside<'v>(schema: &'v Value, value: &'v Value) -> Option<(&'v Value, &'v Value)> {
    match value {
        Value::Array(items) => items.iter().find_map(|item| outside(schema.get("items")?, item)),
        _ => {
            let is_wrong = value.is_null() || value.as_f64().is_some_and(|number| !is_within(schema, number));
            is_wrong.then_some((schema, value))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::keys::Keys;
    use schemars::JsonSchema;
    use serde::Serialize;

    /// Numbers of every shape.
    #[derive(Serialize, JsonSchema)]
    struct Example {
        /// One.
        #[schemars(transform = above(0.0).at_most(1.0))]
        one: f64,
        /// A list.
        #[schemars(transform = at_least(-1.0).below(1.0))]
        list: Vec<[f64; 2]>,
        /// A whole number or a word.
        #[schemars(transform = at_least(1.0).at_most(126.0))]
        either: Option<Either>,
    }

    #[derive(Serialize, JsonSchema)]
    #[serde(untagged)]
    enum Either {
        Number(u16),
        Word(String),
    }

    #[test]
    fn bounds_apply_to_numbers_in_lists_and_alternatives() {
        let keys = Keys::of(Example::json_schema);
        let takes = ["one", "list", "either"].map(|name| keys.get(name).unwrap().takes());
        assert_eq!(
            takes,
            [
                "a number, above 0 and at most 1",
                "a list of values, each a list of 2 values, each a number, at least -1 and below 1",
                "a whole number, at least 1 and at most 126, or text",
            ]
        );
    }

    #[test]
    fn numbers_outside_their_bounds_are_found() {
        let found = |one, list| {
            let either = if one == 1.0 { Either::Number(1) } else { Either::Word("all".into()) };
            let example = Example { one, list, either: Some(either) };
            Keys::of(Example::json_schema).violation(&example)
        };
        assert_eq!(found(1.0, vec![[-1.0, 0.0]]), None);
        assert_eq!(found(0.0, vec![]).unwrap(), "`one` must be above 0 and at most 1, got 0.0");
        assert_eq!(found(0.5, vec![[0.0, 1.0]]).unwrap(), "`list` must be at least -1 and below 1, got 1.0");
        let not_finite = "`one` must be above 0 and at most 1, got a number that is not finite";
        assert_eq!(found(f64::NAN, vec![]).unwrap(), not_finite);
    }
}

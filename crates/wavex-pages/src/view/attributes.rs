//! Quantities of points by which the page colours, sorts and selects them.

use serde_json::{Value, json};

use super::points::ViewPoint;

/// A quantity of points.
pub(super) struct Attribute {
    pub(super) name: &'static str,
    label: &'static str,
    unit: &'static str,
    is_class: bool,
    /// Value of a point; `height_m` lacks the height of the origin.
    pub(super) of: fn(&ViewPoint) -> f32,
}

/// All quantities.
pub(super) const ATTRIBUTES: [Attribute; 14] = [
    number("height_m", "height", "m", |point| point.position_m[2]),
    number("intensity", "intensity", "", |point| point.intensity),
    number("amplitude_dn", "amplitude at unit gain", "DN", |point| point.amplitude_dn),
    number("deviation_ratio", "deviation ratio", "", |point| point.deviation_ratio),
    number("total_sd_m", "total standard deviation", "m", |point| point.total_sd_m),
    number("range_sd_m", "standard deviation of range", "m", |point| point.range_sd_m),
    number("width_ratio", "width ratio", "", |point| point.width_ratio),
    class("return_number", "return number", |point| point.return_number.into()),
    class("number_of_returns", "number of returns", |point| point.number_of_returns.into()),
    class("mta_zone", "MTA zone", |point| point.mta_zone.into()),
    class("class", "class", |point| point.class.into()),
    class("input", "strip (recording)", |point| point.input.into()),
    class("withheld", "withheld", |point| point.withheld.into()),
    class("flags", "flags", |point| point.flags.into()),
];

/// Classes that are left out where all points have the same value.
const LEFT_OUT_IF_SAME: [&str; 4] = ["mta_zone", "class", "input", "withheld"];
/// Most values of a class that are listed.
const MOST_VALUES: usize = 64;
/// Number of points from which ranges are estimated.
const SAMPLE: usize = 100_000;

const fn number(
    name: &'static str,
    label: &'static str,
    unit: &'static str,
    of: fn(&ViewPoint) -> f32,
) -> Attribute {
    Attribute { name, label, unit, is_class: false, of }
}

const fn class(name: &'static str, label: &'static str, of: fn(&ViewPoint) -> f32) -> Attribute {
    Attribute { name, label, unit: "", is_class: true, of }
}

impl Attribute {
    /// The quantity of this name.
    ///
    /// # Errors
    /// If there is none.
    pub(super) fn named(name: &str) -> Result<&'static Attribute, String> {
        ATTRIBUTES
            .iter()
            .find(|attribute| attribute.name == name)
            .ok_or_else(|| format!("{name}: no such quantity of points"))
    }

    /// Value of a point whose origin has this height.
    pub(super) fn value(&self, point: &ViewPoint, origin_m: f64) -> f64 {
        let value = f64::from((self.of)(point));
        if self.name == "height_m" { value + origin_m } else { value }
    }

    /// Description for the page, with the range of 96 % of the points and of all; `None` if no point has
    /// it, or nothing distinguishes the points.
    ///
    /// Heights are relative to `origin_m`, and in `height_unit`.
    pub(super) fn describe(&self, points: &[ViewPoint], origin_m: f64, height_unit: &str) -> Option<Value> {
        let unit = if self.name == "height_m" { height_unit } else { self.unit };
        let step = points.len().div_ceil(SAMPLE).max(1);
        let values = points.iter().step_by(step).map(|point| self.value(point, origin_m));
        let mut values: Vec<f64> = values.filter(|value| value.is_finite()).collect();
        values.sort_by(f64::total_cmp);
        let at =
            |part: f64| values.get((part * values.len().saturating_sub(1) as f64).round() as usize).copied();
        let (low, high) = (at(0.02)?, at(0.98)?);
        let mut value = json!({ "name": self.name, "label": self.label, "unit": unit });
        value["extent"] = json!(self.extent(points, origin_m));
        if self.is_class {
            values.dedup();
            if values.len() == 1 && LEFT_OUT_IF_SAME.contains(&self.name) {
                return None;
            }
            values.truncate(MOST_VALUES);
            value["kind"] = "class".into();
            value["values"] = values.into();
        } else {
            value["kind"] = "number".into();
            value["range"] = json!([low, high]);
        }
        Some(value)
    }

    /// Smallest and largest value.
    fn extent(&self, points: &[ViewPoint], origin_m: f64) -> [f64; 2] {
        let values = points.iter().map(|point| self.value(point, origin_m)).filter(|value| value.is_finite());
        values
            .fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], value| [low.min(value), high.max(value)])
    }
}

/// A condition on a quantity, such as `amplitude_dn>20`.
pub(super) struct Condition {
    attribute: &'static Attribute,
    operator: &'static str,
    value: f64,
}

/// Largest number of conditions of a search.
const MAX_CONDITIONS: usize = 20;
/// Operators; longer ones first.
const OPERATORS: [&str; 5] = ["<=", ">=", "=", "<", ">"];

impl Condition {
    /// Parses conditions that are joined by commas.
    ///
    /// # Errors
    /// If one is not `NAME OPERATOR NUMBER`, or there are too many.
    pub(super) fn parse(text: &str) -> Result<Vec<Condition>, String> {
        let conditions = text.split(',').map(str::trim).filter(|one| !one.is_empty());
        let conditions = conditions.map(Condition::parse_one).collect::<Result<Vec<_>, _>>()?;
        match conditions.len() {
            0..=MAX_CONDITIONS => Ok(conditions),
            n => Err(format!("{n} conditions; at most {MAX_CONDITIONS} are possible")),
        }
    }

    fn parse_one(text: &str) -> Result<Condition, String> {
        let wrong = || format!("{text}: write a condition such as amplitude_dn>20 or return_number=1");
        let operator = OPERATORS
            .into_iter()
            .filter_map(|operator| Some((text.find(operator)?, operator)))
            .min_by_key(|(at, operator)| (*at, std::cmp::Reverse(operator.len())));
        let (at, operator) = operator.ok_or_else(wrong)?;
        let value: f64 = text[at + operator.len()..].trim().parse().map_err(|_| wrong())?;
        Ok(Condition { attribute: Attribute::named(text[..at].trim())?, operator, value })
    }

    /// Whether a point fulfils it; one without the quantity does not.
    pub(super) fn holds(&self, point: &ViewPoint, origin_m: f64) -> bool {
        let value = self.attribute.value(point, origin_m);
        match self.operator {
            "<=" => value <= self.value,
            ">=" => value >= self.value,
            "<" => value < self.value,
            ">" => value > self.value,
            _ => (value - self.value).abs() < 1e-6 * self.value.abs().max(1.0),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use wavex_line::scan_line::Return;

    fn point(return_number: u8, height_m: f32) -> ViewPoint {
        let found = Return { return_number, amplitude_dn: 30.0, ..Return::default() };
        ViewPoint::of(&found, 7, 0, [1.0, 2.0, height_m])
    }

    #[test]
    fn conditions_select_points() {
        let holds = |text: &str| {
            let all = Condition::parse(text).unwrap();
            all.iter().all(|condition| condition.holds(&point(2, 5.0), 100.0))
        };
        for text in ["return_number=2", "height_m>=105, amplitude_dn < 31", "", "height_m<=105.0"] {
            assert!(holds(text), "{text}");
        }
        for text in ["return_number=1", "height_m>105", "amplitude_dn>20,return_number=1", "total_sd_m>0"] {
            assert!(!holds(text), "{text}");
        }
        let problem = |text| Condition::parse(text).err().unwrap();
        assert_eq!(problem("colour=3"), "colour: no such quantity of points");
        let remedy = "write a condition such as amplitude_dn>20 or return_number=1";
        assert_eq!(problem("return_number"), format!("return_number: {remedy}"));
        let many = "class=1,".repeat(21);
        assert_eq!(problem(&many), "21 conditions; at most 20 are possible");
        assert_eq!(problem("return_number>x"), format!("return_number>x: {remedy}"));
    }

    #[test]
    fn an_attribute_that_no_point_has_is_not_described() {
        let points: Vec<ViewPoint> = (0..100).map(|i| point(1 + i % 3, f32::from(i))).collect();
        let describe = |name| Attribute::named(name).unwrap().describe(&points, 100.0, "m");
        assert_eq!(describe("total_sd_m"), None);
        assert_eq!(describe("height_m").unwrap()["range"], json!([102.0, 197.0]));
        assert_eq!(describe("height_m").unwrap()["extent"], json!([100.0, 199.0]));
        assert_eq!(describe("return_number").unwrap()["values"], json!([1.0, 2.0, 3.0]));
        // All points have the same.
        assert!(["class", "input", "withheld", "mta_zone"].into_iter().all(|name| describe(name).is_none()));
    }
}

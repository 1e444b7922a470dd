//! Bounds of the numbers of a job: all have them, and the check has those of the schema.

use serde_json::Value;
use wavex::job::{Job, JobSettings};
use wavex::registry::{STAGES, find};
use wavex::scan_line::Kind;
use wavex::stage::StageSpec;

/// A number of a job: a key, an item of a list, or an alternative.
struct Number<'k> {
    /// Table of the job: `job`, `job.survey`, or a stage.
    table: String,
    key: &'k str,
    /// Schema of the number itself.
    schema: &'k Value,
    /// Schemas from the key to the number.
    path: Vec<&'k Value>,
}

impl Number<'_> {
    fn name(&self) -> String {
        format!("{}.{}", self.table, self.key)
    }

    fn limit(&self, keyword: &str) -> Option<f64> {
        self.schema.get(keyword).and_then(Value::as_f64)
    }

    fn is_list(&self) -> bool {
        self.path.iter().any(|schema| schema["type"] == "array")
    }

    fn is_integer(&self) -> bool {
        self.schema["type"] == "integer"
    }

    /// The smallest and the largest accepted number, each with the next one beyond.
    fn ends(&self) -> [[String; 2]; 2] {
        let of =
            |inclusive: &str, exclusive: &str, beyond: fn(f64) -> f64, within: fn(f64) -> f64, step: i128| {
                let limit = &self.schema[inclusive];
                match (limit.as_i64().filter(|_| self.is_integer()), limit.as_f64(), self.limit(exclusive)) {
                    (Some(limit), ..) => [limit.to_string(), (i128::from(limit) + step).to_string()],
                    (None, Some(limit), _) => [toml_number(limit), toml_number(beyond(limit))],
                    (None, None, Some(limit)) => [toml_number(within(limit)), toml_number(limit)],
                    _ => panic!("{}: no bound: {}", self.name(), self.schema),
                }
            };
        [
            of("minimum", "exclusiveMinimum", f64::next_down, f64::next_up, -1),
            of("maximum", "exclusiveMaximum", f64::next_up, f64::next_down, 1),
        ]
    }

    /// Value of the key with `numbers` in turn.
    fn value(&self, numbers: [&str; 2]) -> String {
        let special = SPECIAL.iter().find(|special| special.0 == self.name() && self.is_list());
        if let Some((_, pattern)) = special {
            return pattern.replace("FIRST", numbers[0]).replace("SECOND", numbers[1]);
        }
        let lists = self.path.iter().rev().filter(|schema| schema["type"] == "array");
        let value = lists.fold(None, |inner: Option<String>, list| {
            let n = list["minItems"].as_u64().unwrap_or(1) as usize;
            let items: Vec<&str> =
                (0..n).map(|index| inner.as_deref().unwrap_or(numbers[index % 2])).collect();
            Some(format!("[{}]", items.join(", ")))
        });
        value.unwrap_or_else(|| numbers[0].to_owned())
    }

    /// Parses a job in which the key has this value.
    fn check(&self, value: &str) -> Result<(), String> {
        let with = WITH.iter().find(|with| with.0 == self.name()).map_or("", |with| with.1);
        let keys = format!("{} = {value}\n{with}\n", self.key);
        let text = match self.table.strip_prefix("job") {
            Some(_) => format!("[{}]\n{keys}\n[[stage]]\ntype = \"simulate\"\n", self.table),
            None => chain(find(&self.table).unwrap(), &keys),
        };
        Job::parse(STAGES, "job.toml", &text, &[]).map(drop).map_err(|errors| format!("{text}\n{errors}"))
    }
}

/// A number with all its digits, as a float of TOML.
fn toml_number(number: f64) -> String {
    format!("{number:?}")
}

/// A job in which a stage has these keys.
fn chain(spec: &StageSpec, keys: &str) -> String {
    let needed: &[&str] = match spec.accepts {
        [] => &[],
        _ if spec.name == "decompose" => &["simulate", "calibrate"],
        _ if spec.name == "write_dem" => &["simulate", "calibrate", "decompose", "georeference", "classify"],
        [Kind::Shots | Kind::Footprints, ..] => &["simulate"],
        [Kind::Returns, ..] => &["simulate", "calibrate", "decompose"],
        [Kind::Points, ..] => &["simulate", "calibrate", "decompose", "georeference"],
    };
    let path = if spec.keys().iter().any(|key| key.required) { "path = \"a.csv\"\n" } else { "" };
    let before: String = needed.iter().map(|name| format!("[[stage]]\ntype = \"{name}\"\n")).collect();
    format!("{before}[[stage]]\ntype = \"{}\"\n{path}{keys}", spec.name)
}

/// Values of lists whose items have further conditions.
const SPECIAL: [(&str, &str); 4] = [
    ("correct.width_correction_low", "[[FIRST, 1.0], [500.0, 1.0], [SECOND, 1.0]]"),
    ("correct.width_correction_high", "[[FIRST, 1.0], [500.0, 1.0], [SECOND, 1.0]]"),
    ("read_hdf5.extent_deg", "[FIRST, 1.0, SECOND, 2.0]"),
    ("simulate.start_deg", "[FIRST, 47.0]"),
];

/// Keys that must accompany a key at its bounds.
const WITH: [(&str, &str); 9] = [
    ("calibrate.decay_amplitude", "decay_time_ns = 20"),
    ("calibrate.decay_time_ns", "decay_amplitude = 0.1"),
    ("decompose.detection_sigma_last", "detection_sigma = 2"),
    ("resolve_mta.agl_sd_m", "agl_m = 500"),
    ("simulate.flying_height_m", "building_height_m = 0\ncanopy_height_m = 0"),
    ("simulate.high_power_noise_sd_dn", "noise_autocorrelation = []"),
    ("simulate.modulation_ns", "pulse_rate_hz = 1000"),
    ("simulate.noise_sd_dn", "noise_autocorrelation = []"),
    ("simulate.start_deg", "sbet = \"*.sbet\""),
];

/// Numbers whose bounds other keys always narrow, with the reason.
const NARROWED: [(&str, &str); 1] =
    [("simulate.noise_autocorrelation", "quantisation adds noise that is not correlated")];

/// All numbers of a schema.
fn numbers<'k>(table: &str, schema: &'k Value) -> Vec<Number<'k>> {
    let mut found = Vec::new();
    for (key, schema) in schema["properties"].as_object().into_iter().flatten() {
        collect(table, key, schema, Vec::new(), &mut found);
    }
    found
}

fn collect<'k>(
    table: &str,
    key: &'k str,
    schema: &'k Value,
    mut path: Vec<&'k Value>,
    found: &mut Vec<Number<'k>>,
) {
    path.push(schema);
    if schema.get("properties").is_some() {
        found.extend(numbers(&format!("{table}.{key}"), schema));
    } else if schema["type"] == "number" || schema["type"] == "integer" {
        found.push(Number { table: table.to_owned(), key, schema, path: path.clone() });
    }
    let branches = ["anyOf", "oneOf"].into_iter().filter_map(|keyword| schema.get(keyword)?.as_array());
    for branch in branches.flatten().chain(schema.get("items")) {
        collect(table, key, branch, path.clone(), found);
    }
}

/// Calls `look` for each number of a job.
fn for_each_number(mut look: impl FnMut(&Number)) {
    let job = JobSettings::keys();
    numbers("job", job.schema()).iter().for_each(&mut look);
    for spec in STAGES {
        numbers(spec.name, spec.keys().schema()).iter().for_each(&mut look);
    }
}

#[test]
fn every_number_has_a_smallest_and_a_largest_value() {
    let mut without = Vec::new();
    let mut n = 0;
    for_each_number(|number| {
        n += 1;
        let has = |keywords: [&str; 2]| keywords.iter().any(|keyword| number.limit(keyword).is_some());
        if !has(["minimum", "exclusiveMinimum"]) || !has(["maximum", "exclusiveMaximum"]) {
            without.push(number.name());
        }
    });
    assert_eq!(without, Vec::<String>::new(), "of {n} numbers");
    assert!(n > 100, "{n}");
}

#[test]
fn numbers_at_their_bounds_are_accepted_and_those_beyond_refused() {
    for_each_number(|number| {
        let [[lower, below], [upper, above]] = number.ends();
        let inside = number.value([&lower, &upper]);
        // Lists are ascending.
        let other = if number.is_list() { inside.clone() } else { number.value([&upper, &lower]) };
        if NARROWED.iter().all(|narrowed| narrowed.0 != number.name()) {
            for value in [&inside, &other] {
                number.check(value).unwrap_or_else(|error| panic!("{}: {error}", number.name()));
            }
        }
        for numbers in [[&below, &upper], [&lower, &above], [&above, &upper]] {
            let value = number.value(numbers.map(String::as_str));
            if value == inside {
                continue;
            }
            let error = number.check(&value).err();
            let error = error.unwrap_or_else(|| panic!("{} accepts {value}", number.name()));
            assert!(error.contains(" must be "), "{error}");
        }
    });
}

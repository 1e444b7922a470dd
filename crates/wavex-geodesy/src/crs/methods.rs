//! Projection methods that agree with PROJ within 1 mm, and their parameters.
//!
//! `proj4wkt` drops what it does not recognise, and `proj4rs` uses zeros for what is missing. Both
//! would silently move all points, so definitions are checked here first.

use super::CrsError;
use super::proj_string::ProjString;
use super::wkt::{WktNode, WktValue};

const PROJ_REMEDY: &str = "choose another system, or build wavex with the feature `proj`";

/// PROJ name of a method, its required parameters (alternatives separated by a bar), and its
/// optional parameters.
///
/// `tests/python/check_crs.py` compares them with PROJ. Omitted are methods with different results
/// (Miller, Mollweide), methods irrelevant here (world maps, satellites), and parameters unknown to
/// `proj4rs`.
const METHODS: [(&str, &str, &str); 24] = [
    ("longlat", "", ""),
    ("geocent", "", ""),
    ("utm", "zone", "south"),
    ("tmerc", "lat_0 lon_0 k|k_0 x_0 y_0", ""),
    ("lcc", "lat_0 lon_0 lat_1 lat_2|k|k_0 x_0 y_0", "lat_2 k k_0"),
    ("aea", "lat_0 lon_0 lat_1 lat_2 x_0 y_0", ""),
    ("aeqd", "lat_0 lon_0 x_0 y_0", "guam"),
    ("cass", "lat_0 lon_0 x_0 y_0", "hyperbolic"),
    ("cea", "lon_0 lat_ts x_0 y_0", ""),
    ("eqc", "lon_0 lat_ts|lat_0 x_0 y_0", "lat_0 lat_ts"),
    ("eqdc", "lat_0 lon_0 lat_1 lat_2 x_0 y_0", ""),
    ("eqearth", "lon_0 x_0 y_0", ""),
    ("gnom", "lat_0 lon_0 x_0 y_0", ""),
    ("krovak", "lat_0 lon_0 alpha k|k_0 x_0 y_0", ""),
    ("laea", "lat_0 lon_0 x_0 y_0", ""),
    ("merc", "lon_0 k|k_0|lat_ts x_0 y_0", "k k_0 lat_ts"),
    ("webmerc", "lon_0 x_0 y_0", "lat_0"),
    ("omerc", "lat_0 lonc alpha gamma k|k_0 x_0 y_0", "no_uoff no_off"),
    ("ortho", "lat_0 lon_0 x_0 y_0", "alpha k k_0"),
    ("poly", "lat_0 lon_0 x_0 y_0", ""),
    ("sinu", "lon_0 x_0 y_0", ""),
    ("somerc", "lat_0 lon_0 k|k_0 x_0 y_0", ""),
    ("stere", "lat_0 lon_0 k|k_0|lat_ts x_0 y_0", "k k_0 lat_ts"),
    ("sterea", "lat_0 lon_0 k|k_0 x_0 y_0", ""),
];

/// Keys allowed in any PROJ string: figure of the earth, units and axes, which are checked
/// elsewhere.
const EVERYWHERE: &str = "proj type datum ellps a b rf R R_A towgs84 nadgrids geoidgrids units to_meter vunits vto_meter \
                          no_defs wktext axis pm";

/// Checks that a PROJ string represents its horizontal part.
pub(super) fn check(proj: &ProjString, horizontal: &WktNode) -> Result<(), CrsError> {
    let method = proj.text("proj").unwrap_or_default();
    let row = METHODS.iter().find(|row| row.0 == method).filter(|_| !differs(proj, horizontal));
    let Some(&(_, needed, optional)) = row else {
        let named = horizontal.find(&["PROJECTION", "METHOD"]).and_then(WktNode::name).unwrap_or(method);
        let problem = format!("its projection method, {named}, is not known to agree with PROJ");
        return Err(proj.unsupported(problem, PROJ_REMEDY));
    };
    let known = [EVERYWHERE, needed, optional].map(|keys| keys.split([' ', '|'])).into_iter().flatten();
    let known: Vec<&str> = known.collect();
    if let Some((key, _)) = proj.pairs.iter().find(|(key, _)| !known.contains(key)) {
        let problem = format!("its PROJ parameter `{key}` is not known for `{method}`");
        return Err(proj.unsupported(problem, PROJ_REMEDY));
    }
    if proj.is_own {
        return check_own(proj, method);
    }
    let is_missing = |keys: &&str| keys.split('|').all(|key| proj.text(key).is_none());
    let needed = if is_of_two_parallels(horizontal) {
        needed.replace("lat_2|k|k_0", "lat_2")
    } else {
        needed.to_owned()
    };
    let missing: Vec<String> = needed.split_whitespace().filter(is_missing).map(in_words).collect();
    if !missing.is_empty() {
        return Err(CrsError::Incomplete { name: proj.name.into(), missing: missing.join(", ") });
    }
    match ignored_parameter(horizontal, method) {
        None => Ok(()),
        Some(name) => {
            let problem = format!("its parameter `{name}` is not known for the projection");
            Err(proj.unsupported(
                problem,
                "correct its name, use an EPSG code, or build wavex with the feature `proj`",
            ))
        }
    }
}

/// Rejects an embedded PROJ string with another figure or datum.
fn check_own(proj: &ProjString, method: &str) -> Result<(), CrsError> {
    let is_shift = |text: &str| text.split(',').any(|number| number.parse() != Ok(0.0));
    let other = |key: &str, known: &[&str]| proj.text(key).is_some_and(|value| !known.contains(&value));
    let is_other_figure = matches!(method, "utm" | "tmerc" | "lcc")
        && ["b", "R", "R_A"].iter().any(|key| proj.text(key).is_some());
    let problem = if proj.text("towgs84").is_some_and(is_shift) || other("nadgrids", &["@null"]) {
        "its PROJ string has a datum shift to WGS 84"
    } else if is_other_figure || other("ellps", &["WGS84", "GRS80"]) || other("datum", &["WGS84", "NAD83"]) {
        "its PROJ string has another figure of the earth"
    } else if method == "utm" && !(1.0..=60.0).contains(&proj.number("zone", 0.0)?) {
        "its PROJ string has no UTM zone from 1 to 60"
    } else {
        return Ok(());
    };
    Err(proj.unsupported(problem.into(), PROJ_REMEDY))
}

/// Variants for which PROJ and `proj4rs` differ: spherical equal-area, and oblique Mercator through
/// two points.
fn differs(proj: &ProjString, horizontal: &WktNode) -> bool {
    let name = || horizontal.find(&["METHOD"]).and_then(WktNode::name).unwrap_or_default().to_lowercase();
    match proj.text("proj") {
        Some("cea") => name().contains("spherical"),
        Some("omerc") => proj.text("lon_1").is_some(),
        _ => false,
    }
}

fn is_of_two_parallels(horizontal: &WktNode) -> bool {
    let method = horizontal.find(&["PROJECTION", "METHOD"]);
    method.and_then(WktNode::name).is_some_and(|name| name.to_uppercase().contains("2SP"))
}

/// Name of a parameter that has no effect although it is neither 0 nor 1, so is not recognised.
///
/// Parameters of the Krovak projection are fixed, whatever the text.
fn ignored_parameter(horizontal: &WktNode, method: &str) -> Option<String> {
    let text = |node: &WktNode| proj4wkt::wkt_to_projstring(&node.to_string()).ok();
    let as_is = text(horizontal);
    let mut names = Vec::new();
    for_each_parameter(&mut horizontal.clone(), &mut |parameter| {
        let value = parameter.value(1).unwrap_or_default();
        names.push((parameter.name().unwrap_or_default().to_owned(), value));
    });
    let is_ignored = |place: usize| {
        let (mut changed, mut at) = (horizontal.clone(), 0);
        for_each_parameter(&mut changed, &mut |parameter| {
            if let (true, Some(value)) = (at == place, parameter.values.get_mut(1)) {
                *value = WktValue::Bare((names[place].1 / 2.0).to_string());
            }
            at += 1;
        });
        text(&changed) == as_is
    };
    let is_plain = |value: f64| value == 0.0 || (value - 1.0).abs() < f64::EPSILON;
    let suspects = (0..names.len()).filter(|place| method != "krovak" && !is_plain(names[*place].1));
    let place = suspects.into_iter().find(|place| is_ignored(*place))?;
    Some(names.swap_remove(place).0)
}

fn for_each_parameter(node: &mut WktNode, act: &mut impl FnMut(&mut WktNode)) {
    if node.keyword == "PARAMETER" {
        act(node);
    }
    for part in node.nodes_mut() {
        for_each_parameter(part, act);
    }
}

/// Whether axes point east and north, or to or from a pole.
pub(super) fn has_plain_axes(horizontal: &WktNode) -> bool {
    let axes = horizontal.nodes().filter(|node| node.keyword == "AXIS");
    let directions: Vec<String> = axes
        .filter_map(|axis| match axis.values.get(1)? {
            WktValue::Bare(word) | WktValue::Text(word) => Some(word.to_lowercase()),
            WktValue::Node(_) => None,
        })
        .take(2)
        .collect();
    let souths = directions.iter().filter(|word| *word == "south").count();
    souths != 1 && !directions.iter().any(|word| word == "west")
}

/// WKT 1 name of a PROJ parameter, or of alternatives.
fn in_words(keys: &str) -> String {
    let word = |key: &str| match key {
        "lat_0" => "latitude_of_origin",
        "lon_0" => "central_meridian",
        "lonc" => "longitude_of_center",
        "lat_1" | "lat_ts" => "standard_parallel_1",
        "lat_2" => "standard_parallel_2",
        "alpha" => "azimuth",
        "gamma" => "rectified_grid_angle",
        "x_0" => "false_easting",
        "y_0" => "false_northing",
        "k" | "k_0" => "scale_factor",
        _ => "zone",
    };
    let mut words: Vec<&str> = keys.split('|').map(word).collect();
    words.dedup();
    words.join(" or ")
}

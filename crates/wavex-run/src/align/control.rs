//! Control points of an alignment: their file, and what became of them.

use std::collections::HashMap;
use std::path::Path;
use std::sync::Arc;

use super::AlignConstraints;
use crate::Failure;
use wavex_align::control::{ControlDifference, ControlPoint};
use wavex_align::result::Alignment;
use wavex_formats::{geoid, read_small_text};
use wavex_geodesy::crs::{Crs, Named, Unit};
use wavex_geodesy::ellipsoid::Geodetic;
use wavex_line::georef::{GeometryKeys, MOST_WKT_BYTES};
use wavex_pages::report::align::{ControlPointReport, ControlReport, ControlStrip, ControlUse};
use wavex_simd::statistics::median;

/// Largest file, bytes.
const MOST_BYTES: u64 = 16_000_000;
/// Largest SD of a coordinate, m.
const MOST_SD_M: f64 = 10.0;
/// Steepest plane, degrees: as for patches.
const MOST_SLOPE_DEG: f64 = 69.0;
/// Most points that the summary lists.
const LISTED: usize = 12;

/// Control points of a file.
pub(super) struct Control {
    file: String,
    /// Name of the coordinate reference system, and the reference of heights.
    crs: String,
    heights: String,
    names: Vec<String>,
    pub(super) points: Vec<ControlPoint>,
}

const REMEDY: &str = "give a CSV file with the columns name, east_m, north_m, ellipsoidal_height_m, sd_east_m, sd_north_m, \
                      sd_height_m";

/// Columns and their meaning.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
enum Column {
    Name,
    East,
    North,
    Longitude,
    Latitude,
    EllipsoidalHeight,
    HeightAboveGeoid,
    SdEast,
    SdNorth,
    SdHeight,
    Slope,
    Aspect,
}

/// Column of a heading, with the length unit that coordinates have.
fn column(heading: &str) -> Option<(Column, Option<Unit>)> {
    let fixed = match heading {
        "name" => Column::Name,
        "longitude_deg" => Column::Longitude,
        "latitude_deg" => Column::Latitude,
        "sd_east_m" => Column::SdEast,
        "sd_north_m" => Column::SdNorth,
        "sd_height_m" => Column::SdHeight,
        "slope_deg" => Column::Slope,
        "aspect_deg" => Column::Aspect,
        _ => {
            let of_length = [
                ("east_", Column::East),
                ("north_", Column::North),
                ("ellipsoidal_height_", Column::EllipsoidalHeight),
                ("height_above_geoid_", Column::HeightAboveGeoid),
            ];
            let with_unit =
                |(start, column)| Some((column, Some(Unit::of_word(heading.strip_prefix(start)?)?)));
            return of_length.into_iter().find_map(with_unit);
        }
    };
    Some((fixed, None))
}

/// Places and units of the columns.
struct Columns {
    places: HashMap<Column, usize>,
    plane_unit: Option<Unit>,
    height_unit: Unit,
    n: usize,
}

impl Columns {
    fn of(header: &str) -> Result<Columns, String> {
        let mut columns =
            Columns { places: HashMap::new(), plane_unit: None, height_unit: Unit::metre(), n: 0 };
        if !header.contains(',') && header.contains([';', '\t']) {
            return Err("columns are not separated by commas".into());
        }
        let mut plane_units = Vec::new();
        for heading in header.split(',').map(str::trim) {
            let (column, unit) = column(heading).ok_or_else(|| format!("unknown column `{heading}`"))?;
            if columns.places.insert(column, columns.n).is_some() {
                return Err(format!("a second column of the meaning of `{heading}`"));
            }
            columns.n += 1;
            match (column, unit) {
                (Column::East | Column::North, Some(unit)) => plane_units.push(unit),
                (_, Some(unit)) => columns.height_unit = unit,
                _ => {}
            }
        }
        if let [first, second] = plane_units.as_slice()
            && first != second
        {
            return Err(format!("east is in {}, north in {}", first.name, second.name));
        }
        columns.plane_unit = plane_units.into_iter().next();
        let has = |column| columns.places.contains_key(&column);
        let needed = [
            (has(Column::Name), "name"),
            (has(Column::East) || has(Column::Longitude), "east_m or longitude_deg"),
            (has(Column::North) && has(Column::East) || has(Column::Latitude), "north_m or latitude_deg"),
            (
                has(Column::EllipsoidalHeight) || has(Column::HeightAboveGeoid),
                "ellipsoidal_height_m or height_above_geoid_m",
            ),
            (has(Column::SdEast), "sd_east_m"),
            (has(Column::SdNorth), "sd_north_m"),
            (has(Column::SdHeight), "sd_height_m"),
            (has(Column::Slope) || !has(Column::Aspect), "slope_deg"),
            (has(Column::Aspect) || !has(Column::Slope), "aspect_deg"),
        ];
        if let Some((_, missing)) = needed.iter().find(|(is_there, _)| !is_there) {
            return Err(format!("column {missing} is missing"));
        }
        let exclusive = [
            (Column::East, Column::Longitude, "coordinates of two systems"),
            (Column::North, Column::Latitude, "coordinates of two systems"),
            (Column::EllipsoidalHeight, Column::HeightAboveGeoid, "heights of two systems"),
        ];
        match exclusive.iter().find(|(a, b, _)| has(*a) && has(*b)) {
            Some((.., problem)) => Err((*problem).to_owned()),
            None => Ok(columns),
        }
    }
}

/// Reads control points; `None` if none are given.
///
/// # Errors
/// A file that cannot be read, unknown columns or systems, values that are not usable; the message names file and line.
pub(super) fn read(
    constraints: &AlignConstraints,
    keys: &GeometryKeys,
    input_dir: &Path,
) -> Result<Option<Control>, Failure> {
    let Some(path) = &constraints.control else { return Ok(None) };
    let file = path.display();
    let wrong = |problem: String| Failure::Wrong(format!("{file}: {problem}"));
    let text = read_small_text(path, MOST_BYTES, "control points", REMEDY);
    let text = text.map_err(|error| Failure::Wrong(error.to_string()))?;
    let mut lines = text.trim_start_matches('\u{feff}').lines().enumerate();
    let header = lines.next().map_or("", |(_, header)| header);
    let columns = Columns::of(header).map_err(|problem| wrong(format!("line 1: {problem}; {REMEDY}")))?;
    let crs = system(constraints, keys, input_dir, &columns).map_err(wrong)?;
    let heights = match crs.geoid() {
        Some(_) => format!("above the geoid {}", keys.geoid.as_deref().unwrap_or_default()),
        None => "ellipsoidal".to_owned(),
    };
    let mut control = Control {
        file: file.to_string(),
        crs: crs.name().to_owned(),
        heights,
        names: Vec::new(),
        points: Vec::new(),
    };
    let mut known = HashMap::new();
    for (index, line) in lines.filter(|(_, line)| !line.trim().is_empty()) {
        let at_line = |problem: String| wrong(format!("line {}: {problem}", index + 1));
        let (name, point) = point(line, &columns, &crs).map_err(at_line)?;
        if let Some(first) = known.insert(name.clone(), index + 1) {
            return Err(at_line(format!(
                "`{name}` is already in line {first}; give each point its own name"
            )));
        }
        control.names.push(name);
        control.points.push(point);
    }
    match control.points.is_empty() {
        true => Err(wrong(format!("it has no points; {REMEDY}"))),
        false => Ok(Some(control)),
    }
}

/// The coordinate reference system of a file, in metres or degrees.
fn system(
    constraints: &AlignConstraints,
    keys: &GeometryKeys,
    input_dir: &Path,
    columns: &Columns,
) -> Result<Crs, String> {
    let (word, folder, of_job) = match (&constraints.control_crs, &keys.crs) {
        (Some(word), _) => (word, Path::new(""), false),
        (None, Some(word)) => (word, input_dir, true),
        (None, None) => {
            return Err(
                "its coordinate reference system is not known: give `--control-crs`, such as EPSG:25833"
                    .into(),
            );
        }
    };
    let named = match Named::parse(word).map_err(|error| error.to_string())? {
        Some(Named::Utm) => return Err("`utm` names no zone: give `--control-crs`, such as utm:33N".into()),
        Some(Named::Ecef) => {
            return Err(
                "`ecef` has no heights: give `--control-crs` with a projected system, or `geodetic`".into()
            );
        }
        Some(named) => named,
        None => {
            let remedy = "give utm:33N, EPSG:2154, geodetic or a WKT file";
            let text = read_small_text(&folder.join(word), MOST_WKT_BYTES, "WKT", remedy);
            Named::Wkt(text.map_err(|error| format!("{error}; {remedy}"))?)
        }
    };
    let geoid = match columns.places.contains_key(&Column::HeightAboveGeoid) {
        false => None,
        true => {
            let name = keys.geoid.as_ref().ok_or(
                "its heights are above a geoid, but the job names none; set `geoid` in `[job.geometry]`, or give \
                 ellipsoidal_height_m",
            )?;
            let folder = keys.geoid_dir.as_ref().map_or(input_dir.to_path_buf(), |dir| input_dir.join(dir));
            Some(Arc::new(geoid::find(&folder, name).map_err(|error| error.to_string())?))
        }
    };
    // Of no place: only `utm` depends on it.
    let place = Geodetic { latitude_rad: 0.0, longitude_rad: 0.0, height_m: 0.0 };
    let of_unit = |unit| Crs::new(&named, place, geoid.clone(), unit).map_err(|error| error.to_string());
    let job_unit = keys.unit.filter(|_| of_job).map(super::unit_of);
    let own = of_unit(job_unit)?;
    match &columns.plane_unit {
        Some(_) if own.is_geodetic() => {
            Err(format!("{} is in degrees: give longitude_deg and latitude_deg", own.name()))
        }
        None if !own.is_geodetic() => {
            Err(format!("{} is not in degrees: give east_m and north_m", own.name()))
        }
        Some(unit) if unit.metres != own.unit().metres => Err(format!(
            "the coordinates of {} are in {}, but those of the file in {}; correct the heading of the columns, or convert them",
            own.name(),
            own.unit().name,
            unit.name
        )),
        _ => of_unit(Some(Unit::metre())),
    }
}

/// Name and point of a line.
fn point(line: &str, columns: &Columns, crs: &Crs) -> Result<(String, ControlPoint), String> {
    let cells: Vec<&str> = line.split(',').map(str::trim).collect();
    if cells.len() != columns.n {
        return Err(format!(
            "{} columns instead of {}; use points as decimal separators, and no commas in names",
            cells.len(),
            columns.n
        ));
    }
    let cell = |column| columns.places.get(&column).map(|place| cells[*place]);
    let number = |column, bounds: core::ops::RangeInclusive<f64>, what: &str| {
        let text = cell(column).unwrap_or_default();
        let value = text.parse().ok().filter(|value: &f64| bounds.contains(value));
        value.ok_or_else(|| {
            format!("{what} is `{text}`; give a number from {} to {}", bounds.start(), bounds.end())
        })
    };
    let name = cell(Column::Name).unwrap_or_default().to_owned();
    if name.is_empty() {
        return Err("it has no name; give each point its own name".into());
    }
    let [x, y] = match &columns.plane_unit {
        None => [
            number(Column::Longitude, -360.0..=360.0, "longitude_deg")?,
            number(Column::Latitude, -90.0..=90.0, "latitude_deg")?,
        ],
        Some(unit) => [
            number(Column::East, -1e9..=1e9, "east")? * unit.metres,
            number(Column::North, -1e9..=1e9, "north")? * unit.metres,
        ],
    };
    let (height_column, height_name) = match columns.places.contains_key(&Column::HeightAboveGeoid) {
        true => (Column::HeightAboveGeoid, "height_above_geoid"),
        false => (Column::EllipsoidalHeight, "ellipsoidal_height"),
    };
    let height_m = number(height_column, -1e5..=1e5, height_name)? * columns.height_unit.metres;
    let sd = |column, what: &str| {
        let sd_m = number(column, 0.0..=MOST_SD_M, what)?;
        if sd_m > 0.0 { Ok(sd_m) } else { Err(format!("{what} is 0; give the SD in metres")) }
    };
    let sd_m = [
        sd(Column::SdEast, "sd_east_m")?,
        sd(Column::SdNorth, "sd_north_m")?,
        sd(Column::SdHeight, "sd_height_m")?,
    ];
    let has_plane = cell(Column::Slope).is_some_and(|text| !text.is_empty());
    let normal = match has_plane {
        false => None,
        true => {
            let slope = number(Column::Slope, 0.0..=MOST_SLOPE_DEG, "slope_deg")?.to_radians();
            let aspect = number(Column::Aspect, -360.0..=360.0, "aspect_deg")?.to_radians();
            Some([slope.sin() * aspect.sin(), slope.sin() * aspect.cos(), slope.cos()])
        }
    };
    let position_in_ecef_m = crs.to_ecef([x, y, height_m]).map_err(|error| error.to_string())?;
    Ok((name, ControlPoint { position_in_ecef_m, sd_m, normal }))
}

/// Use of a point.
fn use_of(differences: &[ControlDifference]) -> ControlUse {
    match differences {
        [] => ControlUse::Unused,
        _ if differences.iter().any(|own| own.is_used) => ControlUse::Used,
        _ => ControlUse::Rejected,
    }
}

fn median_of(differences: &[ControlDifference], of: fn(&ControlDifference) -> Option<f64>) -> Option<f64> {
    median(differences.iter().filter_map(of))
}

impl Control {
    /// Points with their differences.
    fn results<'a>(
        &'a self,
        result: &'a Alignment,
    ) -> impl Iterator<Item = (&'a str, &'a [ControlDifference], ControlUse)> {
        let both = self.names.iter().zip(&result.control.differences);
        both.map(|(name, own)| (name.as_str(), own.as_slice(), use_of(own)))
    }

    fn not_used(&self, result: &Alignment) -> String {
        format!("no strip has a smooth surface within {:.1} m of it", result.control.search_m)
    }

    /// Warnings of points that are not used, and of contradictions.
    pub(super) fn warnings(&self, result: &Alignment) -> Vec<String> {
        let file = &self.file;
        let mut found: Vec<String> = Vec::new();
        for (name, own, own_use) in self.results(result) {
            let problem = match own_use {
                ControlUse::Used => continue,
                ControlUse::Unused => format!("is not used: {}", self.not_used(result)),
                ControlUse::Rejected => {
                    let after_m = median_of(own, |one| Some(one.after_m)).unwrap_or(f64::NAN);
                    format!("is rejected: the strips differ from it by {after_m:.3} m; check its coordinates")
                }
            };
            found.push(format!("{file}: `{name}` {problem}"));
        }
        if found.len() == self.names.len() {
            found.push(format!(
                "{file}: no control point is used; check the coordinate reference system ({}) and heights ({})",
                self.crs, self.heights
            ));
        } else if result.control.contradicts() {
            found.push(format!(
                "{file}: the control points contradict the trajectories: their differences are {:.1} times as large as their \
                 SDs allow; check heights ({}) and SDs of the points, and the trajectories",
                result.control.scale, self.heights
            ));
        }
        found
    }

    /// Lines of the summary.
    pub(super) fn summary(&self, result: &Alignment) -> String {
        let mut text =
            format!("\ncontrol points ({}, {} heights), strips minus points:\n", self.crs, self.heights);
        for (name, own, own_use) in self.results(result).take(LISTED) {
            let millimetres = |of: fn(&ControlDifference) -> Option<f64>| {
                median_of(own, of).map_or("unknown".to_owned(), |m| format!("{:.1} mm", 1e3 * m))
            };
            let sd_m = own.iter().map(|one| one.sd_m).fold(f64::INFINITY, f64::min);
            let differences = || {
                format!(
                    "{} before, {} after, SD {:.1} mm, {} strip{}",
                    millimetres(|one| one.before_m),
                    millimetres(|one| Some(one.after_m)),
                    1e3 * sd_m,
                    own.len(),
                    if own.len() == 1 { "" } else { "s" }
                )
            };
            text += &match own_use {
                ControlUse::Used => format!("  {name}: {}\n", differences()),
                ControlUse::Rejected => format!("  {name}: rejected; {}\n", differences()),
                ControlUse::Unused => format!("  {name}: not used; {}\n", self.not_used(result)),
            };
        }
        if let more @ 1.. = self.names.len().saturating_sub(LISTED) {
            text += &format!("  and {more} more\n");
        }
        text
    }

    /// For the report.
    pub(super) fn report(&self, result: &Alignment, strip: impl Fn(u32) -> String) -> ControlReport {
        let points = self.results(result).map(|(name, own, own_use)| {
            let of_strip = |one: &ControlDifference| ControlStrip {
                strip: strip(one.strip),
                before_m: one.before_m,
                after_m: one.after_m,
                sd_m: one.sd_m,
                is_used: one.is_used,
            };
            ControlPointReport {
                name: name.to_owned(),
                used: own_use,
                reason: match own_use {
                    ControlUse::Used => None,
                    ControlUse::Unused => Some(self.not_used(result)),
                    ControlUse::Rejected => Some("differs by more than its SD allows".to_owned()),
                },
                strips: own.iter().map(of_strip).collect(),
            }
        });
        ControlReport {
            file: self.file.clone(),
            crs: self.crs.clone(),
            heights: self.heights.clone(),
            scale: result.control.scale,
            points: points.collect(),
        }
    }
}

#[cfg(test)]
mod tests;

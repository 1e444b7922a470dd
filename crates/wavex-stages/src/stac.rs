//! STAC item of a LAS, LAZ or COPC file.
//!
//! STAC 1.1 with the extensions pointcloud 1.0 and projection 2.0. Names and types of dimensions are
//! those of PDAL, as in the examples of the extension.

use std::io::{BufReader, Write};
use std::path::{Path, PathBuf};

use serde_json::{Value, json};

use wavex_formats::Error;
use wavex_formats::las::{ExtraBytes, GpsTime, LasDescription, LasHeader};
use wavex_geodesy::crs::{Outline, projjson_of_wkt};
use wavex_geodesy::time::{ADJUSTMENT_S, date};
use wavex_geodesy::time_axis::{adjusted_of_date, utc_of_gps};
use wavex_line::stage::{FinishedFile, OutputFile};

const POINT_CLOUD: &str = "https://stac-extensions.github.io/pointcloud/v1.0.0/schema.json";
const PROJECTION: &str = "https://stac-extensions.github.io/projection/v2.0.0/schema.json";

/// Message for points without a date, which an item requires.
pub const NO_DATE: &str = "no STAC item is written, because the points have no date; set it with the \
     reader's key `gps_date`, or the time scale with `recording_time`";

/// Message for points whose system an item cannot name.
pub const NO_SYSTEM: &str = "the STAC item names no coordinate reference system (`proj:code` is null), because the system \
     of the points has no valid EPSG code and cannot be read, or has an unsupported datum or projection";

/// Whether an item can name the system of the points; true without one.
pub fn names_system(wkt: Option<&str>) -> bool {
    wkt.is_none_or(|wkt| {
        let has_code = || Outline::new(wkt, [0.0; 3], [0.0; 3]).is_some_and(|outline| outline.epsg.is_some());
        projjson_of_wkt(wkt).is_some() || has_code()
    })
}

/// Points that an item describes.
pub struct ItemPoints<'a> {
    /// Header and records of the file.
    pub about: &'a LasDescription,
    /// Name of the file.
    pub path: &'a Path,
    /// Coordinate reference system as WKT.
    pub wkt: Option<&'a str>,
    /// Smallest and largest time, as stored, s.
    pub times_s: Option<[f64; 2]>,
}

/// Reads header and records of complete points.
///
/// # Errors
/// The file cannot be read.
pub fn describe(points: &FinishedFile) -> wavex_formats::Result<LasDescription> {
    let path = points.path();
    let file = points.open().map_err(Error::io(path, "open"))?;
    let length = file.metadata().map_err(Error::io(path, "find the length"))?.len();
    LasDescription::read(&mut BufReader::new(file), path, length)
}

/// Path of the item of a file: its extension becomes `.json`.
pub fn item_path(points: &Path) -> PathBuf {
    points.with_extension("json")
}

/// Completes the file of an item; `None` if the points have no date.
///
/// # Errors
/// A descriptor of an extra attribute is damaged, or writing fails.
pub fn finish(mut file: OutputFile, points: &ItemPoints) -> wavex_formats::Result<Option<FinishedFile>> {
    let Some(item) = item(points)? else { return Ok(None) };
    let path = file.path().to_path_buf();
    writeln!(file, "{item:#}").map_err(Error::io(&path, "write"))?;
    Ok(Some(file.finish()?))
}

fn item(points: &ItemPoints) -> wavex_formats::Result<Option<Value>> {
    let header = &points.about.header;
    let Some(times) = utc_times(header, points.times_s) else { return Ok(None) };
    let name = |name: Option<&std::ffi::OsStr>| name.unwrap_or_default().to_string_lossy().into_owned();
    let bounds = [header.min, header.max];
    let outline = points.wkt.and_then(|wkt| Outline::new(wkt, header.min, header.max));
    let mut properties = times;
    if !matches!(header.system_identifier.as_str(), "" | "EXTRACTION") {
        properties["instruments"] = json!([header.system_identifier]);
    }
    properties["pc:count"] = json!(header.n_points);
    properties["pc:type"] = json!("lidar");
    let is_copc = points.about.vlrs.iter().any(|vlr| vlr.is("copc", 1));
    let encoding = match (is_copc, header.compressed) {
        (true, _) => "COPC",
        (false, true) => "LAZ",
        (false, false) => "LAS",
    };
    properties["pc:encoding"] = json!(encoding);
    properties["pc:schemas"] = schemas(header, &points.about.extra_bytes(points.path)?);
    if header.n_points > 0 {
        properties["pc:statistics"] = statistics(bounds, points.times_s, header.n_points);
        properties["proj:bbox"] = json!(bounds.concat());
    }
    properties["proj:code"] = outline
        .as_ref()
        .and_then(|outline| outline.epsg)
        .map_or(Value::Null, |code| json!(format!("EPSG:{code}")));
    if let Some(system) = points.wkt.and_then(projjson_of_wkt) {
        properties["proj:projjson"] = system;
    }
    let mut item = json!({
        "type": "Feature",
        "stac_version": "1.1.0",
        "stac_extensions": [POINT_CLOUD, PROJECTION],
        "id": name(points.path.file_stem()),
        "geometry": null,
        "properties": properties,
        "links": [],
        "assets": {
            "data": {
                "href": format!("./{}", name(points.path.file_name())),
                "type": media_type(encoding),
                "roles": ["data"],
            },
        },
    });
    let outline = outline.filter(|_| header.n_points > 0);
    if let Some((bbox, ring)) = outline.and_then(|outline| outline.bounds().zip(outline.ring)) {
        item["geometry"] = json!({"type": "Polygon", "coordinates": [ring]});
        item["bbox"] = json!(bbox);
    }
    Ok(Some(item))
}

fn media_type(encoding: &str) -> &'static str {
    match encoding {
        "COPC" => "application/vnd.laszip+copc",
        "LAZ" => "application/vnd.laszip",
        _ => "application/vnd.las",
    }
}

/// Properties with the times of the points; without absolute times the day of the header.
fn utc_times(header: &LasHeader, times_s: Option<[f64; 2]>) -> Option<Value> {
    if let (GpsTime::Standard { offset_s }, Some(times_s)) = (header.gps_time(), times_s) {
        let [start, end] = times_s.map(|time_s| utc_of_gps(time_s + (offset_s - ADJUSTMENT_S)));
        return Some(json!({"datetime": start.as_ref()?, "start_datetime": start?, "end_datetime": end?}));
    }
    let begin_s = adjusted_of_date([header.creation_year, 1, 1])?;
    let day = f64::from(header.creation_day.checked_sub(1)?);
    let [year, month, day] = date(begin_s + 86_400.0 * day)?;
    Some(json!({"datetime": format!("{year:04}-{month:02}-{day:02}T00:00:00Z")}))
}

/// Dimensions of a point, with the types of decoded values.
fn schemas(header: &LasHeader, extra: &[ExtraBytes]) -> Value {
    let format = header.point_format;
    let is_new = format >= 6;
    let mut dimensions = vec![("X", 8, "floating"), ("Y", 8, "floating"), ("Z", 8, "floating")];
    dimensions.push(("Intensity", 2, "unsigned"));
    let bytes = ["ReturnNumber", "NumberOfReturns", "ScanDirectionFlag", "EdgeOfFlightLine"];
    dimensions.extend(bytes.map(|name| (name, 1, "unsigned")));
    dimensions
        .extend(["Classification", "Synthetic", "KeyPoint", "Withheld"].map(|name| (name, 1, "unsigned")));
    if is_new {
        dimensions.extend(["Overlap", "ScanChannel"].map(|name| (name, 1, "unsigned")));
    }
    dimensions.extend([
        ("ScanAngleRank", 4, "floating"),
        ("UserData", 1, "unsigned"),
        ("PointSourceId", 2, "unsigned"),
    ]);
    if !matches!(format, 0 | 2) {
        dimensions.push(("GpsTime", 8, "floating"));
    }
    if matches!(format, 2 | 3 | 5 | 7 | 8 | 10) {
        dimensions.extend(["Red", "Green", "Blue"].map(|name| (name, 2, "unsigned")));
    }
    if matches!(format, 8 | 10) {
        dimensions.push(("Infrared", 2, "unsigned"));
    }
    let dimension =
        |(name, size, kind): (&str, usize, &str)| json!({"name": name, "size": size, "type": kind});
    dimensions.into_iter().chain(extra.iter().filter_map(extra_dimension)).map(dimension).collect()
}

/// Name, size and type of an extra attribute; scaled ones are floating-point numbers.
fn extra_dimension(attribute: &ExtraBytes) -> Option<(&str, usize, &'static str)> {
    let name = attribute.name.as_str();
    let is_scaled = attribute.scale.is_some() || attribute.offset.is_some();
    match attribute.data_type {
        1..=8 if is_scaled => Some((name, 8, "floating")),
        1 | 3 | 5 | 7 => Some((name, attribute.bytes, "unsigned")),
        2 | 4 | 6 | 8 => Some((name, attribute.bytes, "signed")),
        9 | 10 => Some((name, attribute.bytes, "floating")),
        _ => None,
    }
}

/// Ranges of coordinates and of times.
fn statistics([min, max]: [[f64; 3]; 2], times_s: Option<[f64; 2]>, n_points: u64) -> Value {
    let range = |name: &str, [least, largest]: [f64; 2]| json!({"name": name, "count": n_points, "minimum": least, "maximum": largest});
    let axes = ["X", "Y", "Z"].iter().enumerate().map(|(axis, name)| range(name, [min[axis], max[axis]]));
    axes.chain(times_s.map(|times_s| range("GpsTime", times_s))).collect()
}

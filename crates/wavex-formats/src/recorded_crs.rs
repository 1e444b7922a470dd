//! Coordinate reference system of files that have several records of it.

use wavex_geodesy::crs::{CrsError, GeoKeys, are_contradictory, system_of_geotiff_keys, system_of_wkt};

/// Coordinate reference system of a file, and what is wrong with its records.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct RecordedCrs {
    /// The system as WKT, of the first record that can be read.
    ///
    /// WKT that cannot be read is kept if there is nothing else.
    pub wkt: Option<String>,
    /// Whether the system is from the GeoTIFF keys.
    pub is_of_keys: bool,
    /// Records that cannot be read or contradict, with what is used instead; for messages.
    pub problems: Vec<String>,
}

/// Keywords of systems without a place on the earth.
const LOCAL: [&str; 3] = ["LOCAL_CS", "ENGCRS", "ENGINEERINGCRS"];

impl RecordedCrs {
    /// Chooses between the records of a file.
    ///
    /// `prefers_keys` decides if both can be read; `point`, in coordinates of the file, whether they
    /// contradict.
    pub fn new(
        wkt: Option<&str>,
        keys: Option<&GeoKeys>,
        prefers_keys: bool,
        point: [f64; 3],
    ) -> RecordedCrs {
        let mut unreadable = Vec::new();
        let mut failed = |error: CrsError| match error {
            CrsError::Wkt(problem) => unreadable.push(format!("the WKT record cannot be read ({problem})")),
            error => unreadable.push(error.to_string()),
        };
        let of_wkt = wkt.and_then(|text| system_of_wkt(text).map_err(&mut failed).ok());
        let of_keys = keys.and_then(|keys| system_of_geotiff_keys(keys).map_err(&mut failed).ok().flatten());
        let mut problems = Vec::new();
        if let (Some(of_wkt), Some(of_keys)) = (&of_wkt, &of_keys)
            && are_contradictory(&of_wkt.wkt, &of_keys.wkt, point)
        {
            let name = |wkt: &str| wkt.split('"').nth(1).unwrap_or("an unnamed system").to_owned();
            let used = if prefers_keys { "the latter, by the header" } else { "the former" };
            problems.push(format!(
                "the WKT record gives {} as the coordinate reference system, the GeoTIFF keys give another, {}: \
                 {used}, is used; set the reader's key `crs_of_input` if it is wrong",
                name(&of_wkt.wkt),
                name(&of_keys.wkt)
            ));
        }
        let is_of_keys = of_keys.is_some() && (prefers_keys || of_wkt.is_none());
        let chosen = if is_of_keys { of_keys } else { of_wkt };
        let used = match (&chosen, is_of_keys) {
            (None, _) => "set the system with the reader's key `crs_of_input`",
            (_, true) => "the GeoTIFF keys are used",
            (_, false) => "the WKT record is used",
        };
        // A local system is a valid statement of its own.
        let is_local =
            wkt.is_some_and(|text| LOCAL.iter().any(|keyword| text.trim_start().starts_with(keyword)));
        if chosen.is_none() && is_local {
            unreadable.clear();
        }
        problems.extend(unreadable.into_iter().map(|problem| format!("{problem}: {used}")));
        let Some(chosen) = chosen else {
            let wkt = wkt.filter(|text| !text.trim().is_empty()).map(str::to_owned);
            return RecordedCrs { wkt, is_of_keys, problems };
        };
        let record = if is_of_keys { "GeoTIFF keys" } else { "WKT record" };
        problems.extend(chosen.problems.into_iter().map(|problem| format!("{record}: {problem}")));
        RecordedCrs { wkt: Some(chosen.wkt), is_of_keys, problems }
    }
}

#[cfg(test)]
mod tests {
    use wavex_geodesy::crs::wkt_of_epsg;

    use super::*;

    fn keys(entries: &[[u16; 4]], doubles: &[f64]) -> GeoKeys {
        let head = [1, 1, 0, entries.len() as u16];
        GeoKeys {
            directory: head
                .iter()
                .chain(entries.as_flattened())
                .flat_map(|word| word.to_le_bytes())
                .collect(),
            doubles: doubles.iter().flat_map(|value| value.to_le_bytes()).collect(),
            ascii: Vec::new(),
        }
    }

    fn utm(code: u16) -> GeoKeys {
        keys(&[[1024, 0, 1, 1], [3072, 0, 1, code]], &[])
    }

    /// In UTM.
    const POINT: [f64; 3] = [500_000.0, 5_300_000.0, 100.0];

    #[test]
    fn an_empty_wkt_does_not_hide_valid_keys() {
        for text in ["", " ", "PROJCS[", "LOCAL_CS[\"unknown\"]"] {
            let crs = RecordedCrs::new(Some(text), Some(&utm(25832)), false, POINT);
            assert!(crs.is_of_keys && crs.wkt.unwrap().contains("UTM zone 32N"), "{text}");
            let [problem] = crs.problems.try_into().unwrap();
            assert!(problem.starts_with("the WKT record cannot be read"), "{problem}");
            assert!(problem.ends_with("the GeoTIFF keys are used"), "{problem}");
        }
        let alone = RecordedCrs::new(Some("LOCAL_CS[\"a\"]"), None, false, POINT);
        assert_eq!((alone.wkt.as_deref(), alone.problems.len()), (Some("LOCAL_CS[\"a\"]"), 0));
        assert_eq!(RecordedCrs::new(Some(""), None, false, POINT).problems.len(), 1);
    }

    #[test]
    fn damaged_keys_are_named() {
        let wkt = wkt_of_epsg(32633).unwrap();
        let damaged = GeoKeys { directory: vec![1, 0, 1], ..GeoKeys::default() };
        let crs = RecordedCrs::new(Some(&wkt), Some(&damaged), true, POINT);
        assert_eq!((crs.wkt, crs.problems.len()), (Some(wkt), 1));
        // Keys of units alone name no system, and are no problem.
        let units = keys(&[[1024, 0, 1, 1], [3076, 0, 1, 9001], [4099, 0, 1, 9001]], &[]);
        assert_eq!(RecordedCrs::new(None, Some(&units), false, POINT), RecordedCrs::default());
    }

    #[test]
    fn the_header_decides_between_contradicting_records() {
        let wkt = wkt_of_epsg(32633).unwrap();
        let same = RecordedCrs::new(Some(&wkt), Some(&utm(32633)), false, POINT);
        assert!(same.problems.is_empty() && !same.is_of_keys);
        for prefers_keys in [false, true] {
            let crs = RecordedCrs::new(Some(&wkt), Some(&utm(32632)), prefers_keys, POINT);
            assert_eq!((crs.is_of_keys, crs.problems.len()), (prefers_keys, 1));
            assert!(crs.problems[0].contains("zone 33N") && crs.problems[0].contains("zone 32N"));
        }
    }

    #[test]
    fn a_code_of_another_system_is_not_used() {
        let wkt = wkt_of_epsg(32633).unwrap().replace("\"32633\"", "\"32632\"");
        let crs = RecordedCrs::new(Some(&wkt), None, false, POINT);
        assert!(crs.problems[0].contains("EPSG:32632 has other parameters"), "{:?}", crs.problems);
    }
}

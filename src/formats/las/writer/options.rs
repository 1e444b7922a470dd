//! What is the same for all points of a written file.

use std::path::Path;

use crate::formats::las::ExtraAttribute;
use crate::formats::las::header::HEADER_1_4;
use crate::formats::{Error, Result};

/// The versions that are written. Points have a time and no colours.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Version {
    /// LAS 1.2: point format 1.
    V1_2,
    /// LAS 1.3: point format 1, with waveforms 4.
    V1_3,
    /// LAS 1.4: point format 6, with waveforms 9.
    V1_4,
}

impl Version {
    /// The version's second number.
    pub(super) fn minor(self) -> u8 {
        match self {
            Version::V1_2 => 2,
            Version::V1_3 => 3,
            Version::V1_4 => 4,
        }
    }

    /// Length of the header, bytes.
    pub(super) fn header_bytes(self) -> u16 {
        match self {
            Version::V1_2 => 227,
            Version::V1_3 => 235,
            Version::V1_4 => HEADER_1_4,
        }
    }

    /// Points are counted in 32 bits, coordinate systems are GeoTIFF keys.
    pub(super) fn is_legacy(self) -> bool {
        self != Version::V1_4
    }
}

/// Where the waveforms of the points are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum WavePlace {
    /// Nowhere.
    None,
    /// In the file itself, behind the points.
    Inside,
    /// In a `.wdp` file of the same name.
    Beside,
}

/// Where the spatial index of LASzip (LAX) goes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum IndexPlace {
    /// None is made.
    None,
    /// The writer makes it, for a file beside the points.
    Beside,
    /// Behind compressed points, where their LASzip record says.
    Appended,
}

/// What is the same for all points of a file.
#[derive(Debug, Clone)]
pub struct WriterOptions<'a> {
    /// The version, which decides about the point format.
    pub version: Version,
    /// Steps of x, y, z, in units of the coordinate system, above 0.
    pub scale: [f64; 3],
    /// Offsets of x, y, z: coordinates are stored as 32-bit numbers of steps from here.
    pub offset: [f64; 3],
    /// Coordinate system as OGC WKT 1. Before LAS 1.4 its codes become GeoTIFF keys; a system without a code stands there
    /// as WKT all the same, which many programs understand.
    pub wkt: Option<&'a str>,
    /// What each point has behind its standard fields, in this order.
    pub extra_attributes: &'a [ExtraAttribute],
    /// The points' times are adjusted standard GPS time; `false`: seconds of the GPS week.
    pub adjusted_gps_time: bool,
    /// Day of the year of the creation, from 1.
    pub creation_day: u16,
    /// Year of the creation.
    pub creation_year: u16,
    /// What made the data; at most 32 bytes are kept.
    pub system_identifier: &'a str,
    /// The software; at most 32 bytes are kept.
    pub generating_software: &'a str,
    /// The flight line, 0 if unassigned.
    pub file_source_id: u16,
    /// Where the waveforms are, which decides about the point format, too.
    pub waveforms: WavePlace,
    /// Where the spatial index goes.
    pub index: IndexPlace,
    /// Chunks of points that are compressed at a time; the bytes of the file do not depend on it. Memory is at most 100 000
    /// points per thread and their compressed form.
    pub threads: usize,
}

impl WriterOptions<'_> {
    /// The point format: with a time, without colours.
    pub(super) fn point_format(&self) -> u8 {
        match (self.version.is_legacy(), self.waveforms) {
            (true, WavePlace::None) => 1,
            (true, _) => 4,
            (false, WavePlace::None) => 6,
            (false, _) => 9,
        }
    }

    /// Bytes of a point behind its format's fields.
    pub(super) fn extra_bytes(&self) -> usize {
        self.extra_attributes.iter().map(|attribute| attribute.data_type.bytes()).sum()
    }

    /// What keeps a file from being begun with these options.
    pub(super) fn check(&self, path: &Path) -> Result<()> {
        let bad = |problem: String, remedy| Err(Error::unusable(path, problem, remedy));
        if self.version == Version::V1_2 && self.waveforms != WavePlace::None {
            return bad("LAS 1.2 has no waveforms".into(), "write LAS 1.3 or 1.4");
        }
        if self.index == IndexPlace::Appended && !is_laz(path)? {
            let problem = "an index can only be appended to compressed points";
            return bad(problem.into(), "write LAZ, or the index as a file of its own");
        }
        if !self.scale.iter().all(|scale| scale.is_finite() && *scale > 0.0) {
            return bad(format!("the scale {:?} is not positive", self.scale), "give a scale like 0.001");
        }
        if !self.offset.iter().all(|offset| offset.is_finite()) {
            return bad(
                format!("the offset {:?} is not finite", self.offset),
                "give an offset near the points",
            );
        }
        for (number, attribute) in self.extra_attributes.iter().enumerate() {
            let name = attribute.name;
            if self.extra_attributes[..number].iter().any(|other| other.name == name) {
                return bad(format!("the extra attribute {name} stands twice in the list"), "give it once");
            }
        }
        Ok(())
    }
}

/// Whether a file's extension says that its points are compressed.
///
/// # Errors
/// It is neither `las` nor `laz`.
pub(super) fn is_laz(path: &Path) -> Result<bool> {
    let extension = path.extension().unwrap_or_default();
    match (extension.eq_ignore_ascii_case("las"), extension.eq_ignore_ascii_case("laz")) {
        (true, _) => Ok(false),
        (_, true) => Ok(true),
        _ => Err(Error::unusable(
            path,
            "the extension is neither `las` nor `laz`",
            "give the output one of them",
        )),
    }
}

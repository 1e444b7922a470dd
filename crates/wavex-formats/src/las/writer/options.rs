//! Options of a written file.

use std::path::Path;
use std::sync::Arc;

use rayon::ThreadPool;

use crate::extensions::{LAS, LAZ, has_extension};
use crate::las::ExtraAttribute;
use crate::las::encoding;
use crate::las::header::{LasHeader, header_bytes};
use crate::{Error, Result};

/// LAS versions for output.
///
/// Points have a time and no colours.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LasVersion {
    /// LAS 1.2: point format 1.
    V1_2,
    /// LAS 1.3: point format 1, or 4 with waveforms.
    V1_3,
    /// LAS 1.4: point format 6, or 9 with waveforms.
    V1_4,
}

impl LasVersion {
    /// Returns the minor version.
    pub(super) fn minor(self) -> u8 {
        match self {
            LasVersion::V1_2 => 2,
            LasVersion::V1_3 => 3,
            LasVersion::V1_4 => 4,
        }
    }

    /// Returns whether the version is older than LAS 1.4.
    ///
    /// Points are then counted in 32 bits, and the CRS is stored as GeoTIFF keys.
    pub(super) fn is_legacy(self) -> bool {
        self != LasVersion::V1_4
    }
}

/// Location of the waveforms.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum WavePlace {
    /// No waveforms.
    None,
    /// In the file itself, after the points.
    Inside,
    /// In a `.wdp` file of the same name.
    Beside,
}

/// Location of LASzip's spatial index (LAX).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum IndexPlace {
    /// No index.
    None,
    /// Built by the writer, for a separate file.
    Beside,
    /// Appended to compressed points and registered in their LASzip record.
    Appended,
}

/// Options shared by all points of a file.
#[derive(Debug, Clone)]
pub struct WriterOptions<'a> {
    /// LAS version; determines the point format.
    pub version: LasVersion,
    /// Coordinate steps of x, y, z, above 0.
    ///
    /// In units of the coordinate system.
    pub scale: [f64; 3],
    /// Offsets of x, y, z.
    ///
    /// Coordinates are stored as 32-bit multiples of the step from here.
    pub offset: [f64; 3],
    /// Coordinate system as OGC WKT 1.
    ///
    /// Before LAS 1.4 its EPSG codes become GeoTIFF keys. A system without a code is then stored as
    /// WKT as well, which many programs understand.
    pub wkt: Option<&'a str>,
    /// Extra attributes of each point, in this order.
    pub extra_attributes: &'a [ExtraAttribute],
    /// Whether times are adjusted standard GPS time.
    ///
    /// Otherwise they are seconds of the GPS week.
    pub adjusted_gps_time: bool,
    /// Day of the year of creation, from 1.
    pub creation_day: u16,
    /// Year of creation.
    pub creation_year: u16,
    /// System that created the data.
    ///
    /// At most 32 bytes are kept.
    pub system_identifier: &'a str,
    /// Software; at most 32 bytes are kept.
    pub generating_software: &'a str,
    /// File source ID (flight line), 0 if unassigned.
    pub file_source_id: u16,
    /// Project GUID as stored; zeros if unassigned.
    pub project_id: [u8; 16],
    /// Location of the waveforms; also determines the point format.
    pub waveforms: WavePlace,
    /// Location of the spatial index.
    pub index: IndexPlace,
    /// Threads that compress; `None`: the writing thread.
    ///
    /// Does not affect the bytes of the file. Each thread needs memory for at most 100 000 points
    /// and their compressed form.
    pub pool: Option<Arc<ThreadPool>>,
}

impl WriterOptions<'_> {
    /// Returns the point format: with time, without colours.
    pub(super) fn point_format(&self) -> u8 {
        match (self.version.is_legacy(), self.waveforms) {
            (true, WavePlace::None) => 1,
            (true, _) => 4,
            (false, WavePlace::None) => 6,
            (false, _) => 9,
        }
    }

    /// Returns the header without fields that depend on records or points.
    pub(super) fn header(&self) -> LasHeader {
        let minor = self.version.minor();
        let bit = |set: bool, bit: u16| if set { bit } else { 0 };
        let waves = match self.waveforms {
            WavePlace::None => 0,
            WavePlace::Inside => encoding::WAVES_INSIDE,
            WavePlace::Beside => encoding::WAVES_BESIDE,
        };
        LasHeader {
            file_source_id: self.file_source_id,
            guid: self.project_id,
            global_encoding: waves
                | bit(self.adjusted_gps_time, encoding::ADJUSTED_TIME)
                | bit(self.wkt.is_some() && !self.version.is_legacy(), encoding::WKT),
            version: (1, minor),
            system_identifier: self.system_identifier.into(),
            generating_software: self.generating_software.into(),
            creation_day: self.creation_day,
            creation_year: self.creation_year,
            header_size: header_bytes(minor),
            point_format: self.point_format(),
            scale: self.scale,
            offset: self.offset,
            ..LasHeader::default()
        }
    }

    /// Returns the number of extra bytes per point.
    pub(super) fn extra_bytes(&self) -> usize {
        self.extra_attributes.iter().map(|attribute| attribute.data_type.bytes()).sum()
    }

    /// Checks whether a file can be written with these options.
    pub(super) fn check(&self, path: &Path) -> Result<()> {
        let bad = |problem: String, remedy| Err(Error::unusable(path, problem, remedy));
        if self.version == LasVersion::V1_2 && self.waveforms != WavePlace::None {
            return bad("LAS 1.2 has no waveforms".into(), "write LAS 1.3 or 1.4");
        }
        if self.index == IndexPlace::Appended && !is_laz(path)? {
            let problem = "an index can be appended only to compressed points";
            return bad(problem.into(), "write LAZ, or a separate index file");
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
                return bad(format!("the extra attribute {name} is listed twice"), "give it once");
            }
        }
        Ok(())
    }
}

/// Returns whether the extension denotes compressed points.
///
/// # Errors
/// The extension is neither `las` nor `laz`.
pub(super) fn is_laz(path: &Path) -> Result<bool> {
    match (has_extension(path, LAS), has_extension(path, LAZ)) {
        (true, _) => Ok(false),
        (_, true) => Ok(true),
        _ => Err(Error::unusable(
            path,
            "the extension is neither `las` nor `laz`",
            "give the output one of them",
        )),
    }
}

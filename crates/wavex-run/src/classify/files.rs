//! Clouds of others: their headers, their points for a classification, and their copies.

use std::io::BufReader;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};

use las::{PointData, PointDataBuilder, Reader};
use wavex_formats::las::{
    ClassifiedCopy, ExtraBytes, LasHeader, Point, RawPoints, indexes_beside, write_classified,
};
use wavex_ground::point::{Class, CloudPoint};
use wavex_ground::terrain::PointSds;
use wavex_line::stage::{FinishedFile, OutputFile};

use super::tiles::{ClassBlock, Ground, TilePoint, Tiles};
use crate::align::clouds::{check_system, system_of};

/// Points that are decoded at once.
const AT_ONCE: u64 = 1 << 16;
/// Heights of points on the earth and in the air above it, m; others are noise.
const HEIGHTS_M: [f64; 2] = [-12_000.0, 20_000.0];
/// Classes of noise: low, and high (LAS 1.4 R15, table 17).
pub(super) const NOISE: [u8; 2] = [Class::LowNoise as u8, Class::HighNoise as u8];
/// Class of overlapping points in formats 0 to 5; formats 6 to 10 have a flag for them.
const OVERLAP: u8 = 12;

/// Attributes of `write_las`, m.
const TOTAL_SD: &str = "Total uncertainty";
const RANGE_SD: &str = "Range SD";

/// First points that are looked at for total uncertainties: without accuracies of a trajectory, all are unknown.
const FIRST_POINTS: usize = 1000;

/// Number of points by class.
pub(super) type ClassCounts = [u64; 256];

/// A cloud that can be classified.
pub(super) struct Cloud {
    pub(super) path: PathBuf,
    pub(super) output: PathBuf,
    pub(super) header: LasHeader,
    pub(super) wkt: Option<String>,
    /// Lengths of the units of x and y, and of z, m.
    pub(super) units_m: [f64; 2],
    /// What a user should know.
    pub(super) notes: Vec<String>,
    /// Attributes of the points, and which of them is the SD of their heights, m.
    attributes: Vec<ExtraBytes>,
    has_total_sds: bool,
    sd: Option<ExtraBytes>,
    /// Offset of the attributes in a record.
    attributes_at: usize,
}

/// Points of a cloud that keep their class, and why.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct LeftAlone {
    /// Withheld or synthetic.
    pub(super) n_withheld: u64,
    /// Noise according to the file.
    pub(super) n_noise: u64,
    /// Of the classes to keep.
    pub(super) n_kept: u64,
    /// Overlap points of formats 0 to 5.
    pub(super) n_overlap: u64,
}

impl LeftAlone {
    pub(super) fn total(&self) -> u64 {
        self.n_withheld + self.n_noise + self.n_kept + self.n_overlap
    }
}

/// Whether some of the first points have a known total uncertainty.
fn has_total_sds(points: &mut RawPoints) -> bool {
    let attributes = points.extra_bytes_descriptors();
    let Some(total) = attributes.iter().find(|attribute| attribute.name == TOTAL_SD).cloned() else {
        return false;
    };
    let mut point = Point::default();
    (0..FIRST_POINTS)
        .map_while(|_| points.next_point(&mut point).ok().flatten().map(|extra| total.value(extra)))
        .any(|sd_m| sd_m > 0.0 && sd_m.is_finite())
}

impl Cloud {
    /// Reads header and records.
    ///
    /// # Errors
    /// The file cannot be read, is damaged, or its coordinates are no metres or feet: problem and remedy.
    pub(super) fn open(path: &Path, output: PathBuf) -> Result<Cloud, String> {
        let mut points = RawPoints::open(path).map_err(|error| error.to_string())?;
        let (header, crs) = (points.header().clone(), points.crs());
        let system = system_of(path, crs.wkt.as_deref(), &header)?;
        let problems = crs.problems.iter().map(|problem| format!("{}: {problem}", path.display()));
        let notes = problems.chain(system.note).collect();
        Ok(Cloud {
            path: path.to_path_buf(),
            output,
            header,
            wkt: crs.wkt,
            units_m: system.units_m,
            notes,
            attributes: points.extra_bytes_descriptors().to_vec(),
            has_total_sds: has_total_sds(&mut points),
            sd: None,
            attributes_at: points.extra_start(),
        })
    }

    fn attribute(&self, name: &str) -> Option<&ExtraBytes> {
        self.attributes.iter().find(|attribute| attribute.name == name)
    }

    /// Whether its points have total uncertainties.
    pub(super) fn has_total_sds(&self) -> bool {
        self.has_total_sds
    }

    /// Uses total uncertainties, or SDs of ranges, as SDs of the points.
    pub(super) fn use_sds(&mut self, sds: PointSds) {
        let name = match sds {
            PointSds::Total => TOTAL_SD,
            PointSds::Own => RANGE_SD,
        };
        self.sd = self.attribute(name).cloned();
    }

    /// Checks that the coordinate reference system is that of `first`.
    ///
    /// # Errors
    /// It is another one: problem and remedy.
    pub(super) fn check_system(&self, first: &Cloud) -> Result<(), String> {
        let systems = (self.wkt.as_deref(), first.wkt.as_deref());
        check_system(&self.path, systems, &first.path, self.header.min)
    }

    /// Order of clouds that depends on their content only, unless it is equal.
    pub(super) fn rank(&self) -> impl Ord + use<> {
        let bits = |values: [f64; 3]| values.map(f64::to_bits);
        let header = &self.header;
        let content = (
            header.n_points,
            bits(header.min),
            bits(header.max),
            bits(header.offset),
            header.n_points_by_return,
        );
        (content, self.path.clone())
    }

    /// Spools all points; gives the number of each class and of those left alone.
    ///
    /// # Errors
    /// The file is damaged, or the spools cannot be written: problem and remedy.
    pub(super) fn spool(
        &self,
        number: u32,
        tiles: &Tiles<'_>,
        mut progress: impl FnMut(f64) -> bool,
    ) -> Result<(ClassCounts, LeftAlone), String> {
        let mut counts = ([0; 256], LeftAlone::default());
        let n_points = self.header.n_points;
        if n_points == 0 {
            return Ok(counts);
        }
        let checked = RawPoints::open(&self.path).and_then(|points| points.checked_file(&self.path));
        let checked = checked.map_err(|error| error.to_string())?;
        let mut reader = self.contained(|| Reader::new(BufReader::with_capacity(1 << 18, checked)))?;
        let mut data = PointDataBuilder::new().for_header(reader.header()).build();
        let mut writer = tiles.writer();
        let mut first = 0;
        while first < n_points {
            if !progress(first as f64 / n_points as f64) {
                return Err(super::INTERRUPTED.into());
            }
            let n = self.contained(|| reader.fill_points(AT_ONCE.min(n_points - first), &mut data))?;
            if n == 0 {
                return Err(self.damaged("it ends before its last point"));
            }
            for (point, index) in self.points(&data).zip(first..) {
                let class = point.class;
                counts.0[usize::from(class)] += 1;
                let is_of_surface = tiles.surface_cell_m.is_some() && point.may_be_surface();
                let position_m = point.position_m;
                let pushed = match self.use_of(point, tiles.kept_classes, &mut counts.1) {
                    Some(tile_point) => writer.push((number, index), &tile_point),
                    None if is_of_surface => writer.push_kept(number, position_m),
                    None => Ok(()),
                };
                pushed.map_err(|error| super::no_room(&error))?;
            }
            first += n;
        }
        writer.finish().map_err(|error| super::no_room(&error))?;
        Ok(counts)
    }

    /// Points of decoded records.
    fn points<'a>(&'a self, data: &'a PointData) -> impl Iterator<Item = ReadPoint> + 'a {
        let [plane_m, height_m] = self.units_m;
        let is_legacy = self.header.point_format <= 5;
        let places = data.x().zip(data.y()).zip(data.z());
        let returns = data.return_number().zip(data.number_of_returns());
        // Bits of synthetic and withheld points.
        let bits = if is_legacy { 0b1010_0000 } else { 0b101 };
        let of_records = data.raw_bytes().chunks_exact(data.record_len()).map(move |record| {
            let attributes = record.get(self.attributes_at..).unwrap_or_default();
            let sd_m = self.sd.as_ref().map_or(f64::NAN, |sd| sd.value(attributes));
            (record[15] & bits != 0, sd_m as f32)
        });
        let fields = data.classification().zip(returns).zip(data.point_source_id()).zip(of_records);
        places.zip(fields).map(move |(((x, y), z), (((class, returns), source), (is_withheld, sd_m)))| {
            ReadPoint {
                position_m: [x * plane_m, y * plane_m, z * height_m],
                class,
                returns,
                source,
                is_withheld,
                sd_m,
            }
        })
    }

    /// What a point is to the classification; `None` if it takes no part.
    fn use_of(&self, point: ReadPoint, kept: &[u8], left: &mut LeftAlone) -> Option<TilePoint> {
        let is_kept = kept.contains(&point.class);
        let is_overlap = self.header.point_format <= 5 && point.class == OVERLAP;
        let reason = if point.is_withheld {
            &mut left.n_withheld
        } else if NOISE.contains(&point.class) {
            &mut left.n_noise
        } else if is_kept {
            &mut left.n_kept
        } else if is_overlap {
            &mut left.n_overlap
        } else {
            return Some(self.tile_point(point, [true, false]));
        };
        *reason += 1;
        // Kept ground and overlap points are measurements like others.
        let is_kept_ground = is_kept && point.class == Class::Ground as u8;
        let takes_part = !point.is_withheld && (is_overlap || is_kept_ground);
        takes_part.then(|| self.tile_point(point, [false, is_kept_ground]))
    }

    fn tile_point(&self, point: ReadPoint, [is_classified, is_kept_ground]: [bool; 2]) -> TilePoint {
        let height_m = point.position_m[2];
        let absurd = match height_m {
            _ if height_m < HEIGHTS_M[0] => Some(Class::LowNoise),
            _ if height_m > HEIGHTS_M[1] => Some(Class::HighNoise),
            _ => None,
        };
        let (return_number, n_returns) = point.returns;
        let measured = CloudPoint {
            return_number,
            n_returns,
            strip: point.source,
            height_sd_m: point.sd_m,
            ..CloudPoint::at(point.position_m)
        };
        TilePoint { point: measured, is_classified, is_kept_ground, absurd }
    }

    /// Runs a decoder, which may panic on damaged data.
    fn contained<T>(&self, decode: impl FnOnce() -> las::Result<T>) -> Result<T, String> {
        match catch_unwind(AssertUnwindSafe(decode)) {
            Ok(result) => result.map_err(|error| self.damaged(&error.to_string())),
            Err(_) => Err(self.damaged("they are no LASzip data")),
        }
    }

    fn damaged(&self, problem: &str) -> String {
        format!(
            "{}: its points cannot be decoded: {problem}; the file is cut off or damaged: copy it again from its source",
            self.path.display()
        )
    }

    /// Class to store; formats 0 to 5 know one class of noise.
    fn stored(&self, class: u8) -> u8 {
        match self.header.point_format {
            0..=5 if class == Class::HighNoise as u8 => Class::LowNoise as u8,
            _ => class,
        }
    }

    /// Writes the copy with the classes of `ground`; gives it with the number of points of each class.
    ///
    /// # Errors
    /// [`WriteFailure`].
    pub(super) fn write(
        &self,
        number: u32,
        ground: &Ground,
        mut progress: impl FnMut(f64) -> bool,
    ) -> Result<(FinishedFile, ClassCounts, ClassifiedCopy), WriteFailure> {
        let failed = |error: wavex_formats::Error| match error.file() == self.path {
            true => WriteFailure::Source(error.to_string()),
            false => WriteFailure::Output(error.to_string()),
        };
        let mut counts = [0; 256];
        let mut output = OutputFile::create(&self.output).map_err(failed)?;
        let (mut block, mut problem) = (ClassBlock::default(), None);
        let copy = write_classified(&self.path, &mut output, &self.output, |index, class| {
            if problem.is_none() && !block.has(index) {
                if !progress(index as f64 / self.header.n_points.max(1) as f64) {
                    problem = Some(super::INTERRUPTED.to_owned());
                }
                block = ground.block(number, index).unwrap_or_else(|error| {
                    problem = Some(super::no_room(&error));
                    ClassBlock::default()
                });
            }
            let class = block.class(index).map_or(class, |class| self.stored(class));
            counts[usize::from(class)] += 1;
            class
        });
        if let Some(problem) = problem {
            return Err(WriteFailure::Output(problem));
        }
        let copy = copy.map_err(failed)?;
        let finished = output.finish().map_err(failed)?.replacing(indexes_beside(&self.output));
        Ok((finished, counts, copy))
    }
}

/// Why a copy could not be written: problem and remedy.
pub(super) enum WriteFailure {
    /// The cloud is damaged.
    Source(String),
    /// Anything else.
    Output(String),
}

/// A decoded point.
struct ReadPoint {
    position_m: [f64; 3],
    class: u8,
    /// Return number, and number of returns.
    returns: (u8, u8),
    source: u16,
    is_withheld: bool,
    /// NaN if unknown.
    sd_m: f32,
}

impl ReadPoint {
    /// Whether the file says nothing against a point of the surface: a first return that is no noise.
    fn may_be_surface(&self) -> bool {
        let is_absurd = !(HEIGHTS_M[0]..=HEIGHTS_M[1]).contains(&self.position_m[2]);
        !self.is_withheld && !NOISE.contains(&self.class) && self.returns.0 <= 1 && !is_absurd
    }
}

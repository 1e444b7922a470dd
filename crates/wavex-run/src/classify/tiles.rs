//! Points of all clouds by tiles, and their classification tile by tile.

use std::collections::BTreeSet;
use std::io;
use std::path::Path;

use rayon::prelude::*;
use wavex_ground::filter::{GroundSettings, OVERLAP_M, TILE_M, classify_tile};
use wavex_ground::point::{Class, CloudPoint};
use wavex_ground::rays::{NoiseSettings, mark_noise};
use wavex_stages::terrain::{GroundPoints, Spool, SpoolBuffers, SpoolWriter, SurfacePoints};

/// Most points that are classified together.
///
/// A tile with its margin that has more is divided into parts by a hash of the points' coordinates, and each part is
/// classified alone. 12 points per m² of a tile remain, which is denser than the cells of the filter need.
const MOST_POINTS: u64 = 6_000_000;
/// Memory for each point of a tile while it is classified, bytes.
const POINT_BYTES: u64 = 200;
/// Points of a block of classes.
const BLOCK_POINTS: u64 = 1 << 20;
/// Bytes of a spooled point: cloud, index, coordinates, returns, flag, strip, SD of the height.
const RECORD_BYTES: usize = 4 + 8 + 24 + 2 + 1 + 2 + 4;
/// Bytes of a spooled class: index in its block, class.
const CLASS_BYTES: usize = 5;

/// East and north index of a tile.
pub type Tile = [i64; 2];

/// A point of a cloud: number of the cloud, and index of the point.
type PointId = (u32, u64);

/// A point for the classification.
pub(super) struct TilePoint {
    pub(super) point: CloudPoint,
    /// Whether its class is written.
    pub(super) is_classified: bool,
    /// Whether it is ground whatever the classification says: kept class 2.
    pub(super) is_kept_ground: bool,
    /// Class by its height alone, which is absurd; it takes no part.
    pub(super) absurd: Option<Class>,
}

/// Points of all clouds by tiles.
pub(super) struct Tiles<'a> {
    pub(super) kept_classes: &'a [u8],
    /// Edge of the cells of the surface model, m; `None` without a surface model.
    pub(super) surface_cell_m: Option<f64>,
    points: Spool<Tile>,
    /// Positions of first returns that take no part but belong to the surface, by cloud.
    kept: Spool<u32>,
    /// Absurd points, by cloud and block.
    absurd: Spool<(u32, u64)>,
}

/// Tile of a position, m.
fn tile_of(position_m: [f64; 3]) -> Tile {
    [0, 1].map(|axis| (position_m[axis] / TILE_M).floor() as i64)
}

impl<'a> Tiles<'a> {
    /// No points; temporary files are in `folder`.
    pub(super) fn new(
        folder: &Path,
        kept_classes: &'a [u8],
        surface_cell_m: Option<f64>,
    ) -> io::Result<Tiles<'a>> {
        Ok(Tiles {
            kept_classes,
            surface_cell_m,
            points: Spool::new(folder, RECORD_BYTES)?,
            kept: Spool::new(folder, 24)?,
            absurd: Spool::new(folder, CLASS_BYTES)?,
        })
    }

    pub(super) fn writer(&self) -> TileWriter<'_> {
        TileWriter { points: self.points.writer(), kept: self.kept.writer(), absurd: self.absurd.writer() }
    }

    /// Classifies all points but those of failed clouds, in bounded memory.
    ///
    /// `progress` gets the done part, and returns whether to continue.
    pub(super) fn classify(
        &self,
        folder: &Path,
        settings: &GroundSettings,
        (failed, memory_mb): (&BTreeSet<u32>, u64),
        mut progress: impl FnMut(f64) -> bool,
    ) -> io::Result<Option<Ground>> {
        let surface = self.surface_cell_m.map(|cell_m| SurfacePoints::new(folder, cell_m)).transpose()?;
        let ground =
            Ground { classes: Spool::new(folder, CLASS_BYTES)?, points: GroundPoints::new(folder)?, surface };
        if let Some(surface) = &ground.surface {
            let mut buffers = SpoolBuffers::default();
            for cloud in self.kept.keys().into_iter().filter(|cloud| !failed.contains(cloud)) {
                let mut result = Ok(());
                self.kept.read(cloud, |record| {
                    if let (Ok(()), Some(position_m)) = (&result, position_of(record)) {
                        result = surface.push(&mut buffers, position_m);
                    }
                })?;
                result?;
            }
            surface.flush(&mut buffers)?;
        }
        let mut writer = ground.classes.writer();
        for key in self.absurd.keys() {
            let mut result = Ok(());
            self.absurd.read(key, |record| {
                if result.is_ok() {
                    result = writer.push(key, record);
                }
            })?;
            result?;
        }
        writer.finish()?;
        let tiles = self.points.keys();
        let n_bytes = |tile: &Tile| self.n_around(*tile).min(MOST_POINTS) * POINT_BYTES;
        let mut done = 0;
        while done < tiles.len() {
            if !progress(done as f64 / tiles.len() as f64) {
                return Ok(None);
            }
            let mut left = memory_mb.saturating_mul(1_000_000);
            let fits = |tile: &&Tile| {
                let bytes = n_bytes(tile);
                let fits = bytes <= left;
                left = left.saturating_sub(bytes);
                fits
            };
            let batch = tiles[done..].iter().take_while(fits_or_first(fits)).count();
            let batch = &tiles[done..done + batch];
            batch.par_iter().try_for_each(|tile| self.classify_tile(*tile, settings, failed, &ground))?;
            done += batch.len();
        }
        Ok(Some(ground))
    }

    /// Largest number of points of a tile with its margin.
    fn n_around(&self, tile: Tile) -> u64 {
        around(tile, OVERLAP_M).map(|tile| self.points.count(tile)).sum()
    }

    fn classify_tile(
        &self,
        tile: Tile,
        settings: &GroundSettings,
        failed: &BTreeSet<u32>,
        ground: &Ground,
    ) -> io::Result<()> {
        let mut n_points = self.n_around(tile);
        if n_points > MOST_POINTS {
            n_points = 0;
            near(&self.points, tile, OVERLAP_M, |point| {
                n_points += u64::from(!failed.contains(&point.id.0))
            })?;
        }
        let n_parts = n_points.div_ceil(MOST_POINTS).max(1);
        let mut classes = ground.classes.writer();
        let (mut of_ground, mut of_surface) = (SpoolBuffers::default(), SpoolBuffers::default());
        for part in 0..n_parts {
            let mut spooled = Vec::new();
            near(&self.points, tile, OVERLAP_M, |point| {
                let is_of_part = n_parts == 1 || hash(point.point.position_m) % n_parts == part;
                if is_of_part && !failed.contains(&point.id.0) {
                    spooled.push(point);
                }
            })?;
            spooled.sort_unstable_by_key(|point| point.id);
            let points: Vec<CloudPoint> = spooled.iter().map(|near| near.point).collect();
            for (near, class) in spooled.iter().zip(classes_of(&points, settings)) {
                if tile_of(near.point.position_m) != tile {
                    continue;
                }
                if class == Class::Ground || near.is_kept_ground {
                    ground.points.push(&mut of_ground, &near.point)?;
                }
                let is_noise = matches!(class, Class::LowNoise | Class::HighNoise);
                if let (Some(surface), false, 0..=1) = (&ground.surface, is_noise, near.point.return_number) {
                    surface.push(&mut of_surface, near.point.position_m)?;
                }
                if near.is_classified {
                    push_class(&mut classes, near.id, class)?;
                }
            }
        }
        classes.finish()?;
        ground.surface.as_ref().map_or(Ok(()), |surface| surface.flush(&mut of_surface))?;
        ground.points.flush(&mut of_ground)
    }
}

/// Lets the first item pass in any case.
fn fits_or_first<T>(mut fits: impl FnMut(&T) -> bool) -> impl FnMut(&T) -> bool {
    let mut is_first = true;
    move |item| fits(item) | std::mem::take(&mut is_first)
}

/// Classes of the points of a tile with its margin: first noise, then the ground of the other points.
fn classes_of(points: &[CloudPoint], settings: &GroundSettings) -> Vec<Class> {
    let mut classes = mark_noise(points, &NoiseSettings::default());
    let others: Vec<CloudPoint> = points
        .iter()
        .zip(&classes)
        .filter(|(_, class)| **class == Class::Unclassified)
        .map(|(point, _)| *point)
        .collect();
    let unclassified = classes.iter_mut().filter(|class| **class == Class::Unclassified);
    for (class, other) in unclassified.zip(classify_tile(&others, settings)) {
        *class = other;
    }
    classes
}

/// Tiles within this distance of a tile, itself first.
fn around(tile: Tile, margin_m: f64) -> impl Iterator<Item = Tile> {
    let n = (margin_m / TILE_M).ceil() as i64;
    (-n..=n).flat_map(move |east| (-n..=n).map(move |north| [tile[0] + east, tile[1] + north]))
}

/// Number that depends on the coordinates only.
fn hash(position_m: [f64; 3]) -> u64 {
    position_m.iter().fold(0, |state, value| {
        let mixed = (state ^ value.to_bits()).wrapping_mul(0x9E37_79B9_7F4A_7C15);
        mixed ^ mixed >> 29
    })
}

fn push_class(
    writer: &mut SpoolWriter<'_, (u32, u64)>,
    (cloud, index): PointId,
    class: Class,
) -> io::Result<()> {
    let [a, b, c, d] = ((index % BLOCK_POINTS) as u32).to_le_bytes();
    writer.push((cloud, index / BLOCK_POINTS), &[a, b, c, d, class as u8])
}

/// Writer of the points of one cloud.
pub(super) struct TileWriter<'a> {
    points: SpoolWriter<'a, Tile>,
    kept: SpoolWriter<'a, u32>,
    absurd: SpoolWriter<'a, (u32, u64)>,
}

impl TileWriter<'_> {
    pub(super) fn push(&mut self, id: PointId, point: &TilePoint) -> io::Result<()> {
        match point.absurd {
            Some(class) if point.is_classified => push_class(&mut self.absurd, id, class),
            Some(_) => Ok(()),
            None => {
                let TilePoint { point, is_classified, is_kept_ground, .. } = *point;
                let spooled = Spooled { id, is_classified, is_kept_ground, point };
                self.points.push(tile_of(point.position_m), &spooled.record())
            }
        }
    }

    /// Adds a first return that takes no part but belongs to the surface.
    pub(super) fn push_kept(&mut self, cloud: u32, position_m: [f64; 3]) -> io::Result<()> {
        let mut record = [0; 24];
        for (bytes, value) in record.chunks_exact_mut(8).zip(position_m) {
            bytes.copy_from_slice(&value.to_le_bytes());
        }
        self.kept.push(cloud, &record)
    }

    pub(super) fn finish(self) -> io::Result<()> {
        self.points.finish()?;
        self.kept.finish()?;
        self.absurd.finish()
    }
}

/// A spooled point.
struct Spooled {
    id: PointId,
    is_classified: bool,
    is_kept_ground: bool,
    point: CloudPoint,
}

impl Spooled {
    fn record(&self) -> [u8; RECORD_BYTES] {
        let mut record = [0; RECORD_BYTES];
        record[..4].copy_from_slice(&self.id.0.to_le_bytes());
        record[4..12].copy_from_slice(&self.id.1.to_le_bytes());
        for (bytes, value) in record[12..36].chunks_exact_mut(8).zip(self.point.position_m) {
            bytes.copy_from_slice(&value.to_le_bytes());
        }
        record[36] = self.point.return_number;
        record[37] = self.point.n_returns;
        record[38] = u8::from(self.is_classified) | u8::from(self.is_kept_ground) << 1;
        record[39..41].copy_from_slice(&self.point.strip.to_le_bytes());
        record[41..].copy_from_slice(&self.point.height_sd_m.to_le_bytes());
        record
    }

    fn of(record: &[u8]) -> Option<Spooled> {
        let (cloud, rest) = record.split_first_chunk()?;
        let (index, rest) = rest.split_first_chunk()?;
        let position_m = position_of(rest)?;
        let (_, rest) = rest.split_at_checked(24)?;
        let ([return_number, n_returns, flags, low, high], rest) =
            rest.split_first_chunk().map(|(chunk, rest)| (*chunk, rest))?;
        let height_sd_m = f32::from_le_bytes(*rest.first_chunk()?);
        let strip = u16::from_le_bytes([low, high]);
        Some(Spooled {
            id: (u32::from_le_bytes(*cloud), u64::from_le_bytes(*index)),
            is_classified: flags & 1 != 0,
            is_kept_ground: flags & 2 != 0,
            point: CloudPoint { return_number, n_returns, strip, height_sd_m, ..CloudPoint::at(position_m) },
        })
    }
}

/// Position at the beginning of a record, m.
fn position_of(record: &[u8]) -> Option<[f64; 3]> {
    let (places, _) = record.get(..24)?.as_chunks();
    Some(<[[u8; 8]; 3]>::try_from(places).ok()?.map(f64::from_le_bytes))
}

/// Gives all points within `margin_m` of a tile.
fn near(points: &Spool<Tile>, tile: Tile, margin_m: f64, mut each: impl FnMut(Spooled)) -> io::Result<()> {
    let is_near = |point: &Spooled| {
        (0..2).all(|axis| {
            let from_m = point.point.position_m[axis] - tile[axis] as f64 * TILE_M;
            (-margin_m..=TILE_M + margin_m).contains(&from_m)
        })
    };
    around(tile, margin_m).try_for_each(|other| {
        points.read(other, |record| Spooled::of(record).filter(is_near).into_iter().for_each(&mut each))
    })
}

/// Classes of all points, the ground points, and the first returns if a surface is modelled.
pub(super) struct Ground {
    classes: Spool<(u32, u64)>,
    pub(super) points: GroundPoints,
    pub(super) surface: Option<SurfacePoints>,
}

impl Ground {
    /// Classes of the block of a cloud that has this point.
    pub(super) fn block(&self, cloud: u32, index: u64) -> io::Result<ClassBlock> {
        let number = index / BLOCK_POINTS;
        let mut classes = vec![0; BLOCK_POINTS as usize];
        self.classes.read((cloud, number), |record| {
            let Some((at, [class])) = record.split_first_chunk() else { return };
            let place = classes.get_mut(u32::from_le_bytes(*at) as usize);
            place.into_iter().for_each(|place| *place = *class);
        })?;
        Ok(ClassBlock { number: Some(number), classes })
    }
}

/// New classes of consecutive points of a cloud.
#[derive(Default)]
pub(super) struct ClassBlock {
    number: Option<u64>,
    /// 0: the class stays.
    classes: Vec<u8>,
}

impl ClassBlock {
    pub(super) fn has(&self, index: u64) -> bool {
        self.number == Some(index / BLOCK_POINTS)
    }

    /// New class of a point of the block; `None` if it stays.
    pub(super) fn class(&self, index: u64) -> Option<u8> {
        self.classes.get((index % BLOCK_POINTS) as usize).copied().filter(|class| *class != 0)
    }
}

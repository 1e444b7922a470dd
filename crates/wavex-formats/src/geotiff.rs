//! Writer of rasters as cloud-optimised GeoTIFF (COG): bands of 32-bit floats.
//!
//! Tiles of 256 by 256 cells, compressed by Deflate, with the bands of a cell next to each other. Tiles without values are not stored. Overviews
//! halve the raster until it fits into one tile. In the file, the directories come first, then the
//! tiles of the smallest overview, and last the tiles of the raster itself (COG, "GeoTIFF file format
//! requirements"; TIFF 6.0, sections 2 and 15; OGC GeoTIFF 1.1).
//!
//! Tiles arrive row by row from the north. They are compressed at once and spooled, because the
//! layout places the overviews first: memory is bounded by one row of tiles.

use std::collections::BTreeMap;
use std::io::{self, Read, Seek, SeekFrom, Write};

use flate2::Compression;
use flate2::write::ZlibEncoder;
use wavex_geodesy::crs::GeoKeys;

use crate::geokeys;

/// Edge of a tile, cells.
pub const TILE: usize = 256;
/// Value of cells without data, also in the file as text.
pub const NO_DATA: f32 = -9999.0;
/// Largest file with 32-bit offsets, bytes.
const MAX_BYTES: u64 = u32::MAX as u64;

/// Size and position of a raster.
#[derive(Clone, Debug, PartialEq)]
pub struct RasterGrid {
    /// Number of cells from west to east.
    pub columns: u32,
    /// Number of cells from north to south.
    pub rows: u32,
    /// West edge, in units of the CRS.
    pub west: f64,
    /// North edge.
    pub north: f64,
    /// Cell size.
    pub cell: f64,
    /// Coordinate reference system as WKT.
    pub crs_wkt: Option<String>,
    /// Description of the values of each band, for GIS programs; one band at least.
    pub bands: Vec<String>,
}

/// A tile's values from its north-west corner, row by row; those of a cell's bands follow each other.
pub type TileValues = Box<[f32]>;

/// Creates a tile of one band without data.
pub fn empty_tile() -> TileValues {
    empty_tile_of(1)
}

/// Creates a tile of several bands without data.
pub fn empty_tile_of(bands: usize) -> TileValues {
    vec![NO_DATA; TILE * TILE * bands].into()
}

/// Position of a compressed tile in the spool.
#[derive(Clone, Copy, Debug)]
struct Spooled {
    offset: u64,
    bytes: u32,
}

/// The raster or one of its overviews.
#[derive(Debug, Default)]
struct RasterLevel {
    /// Cells from west to east and from north to south.
    size: [u32; 2],
    tiles: BTreeMap<(u32, u32), Spooled>,
    /// Tiles that finer tiles still fill, by row and column.
    pending: BTreeMap<(u32, u32), TileValues>,
}

/// Compresses the tiles of a raster to a spool `S`.
#[derive(Debug)]
pub struct RasterWriter<S> {
    grid: RasterGrid,
    levels: Vec<RasterLevel>,
    spool: S,
    spooled: u64,
}

/// A raster whose tiles are all in a spool.
#[derive(Debug)]
pub struct SpooledRaster {
    grid: RasterGrid,
    levels: Vec<RasterLevel>,
    spooled: u64,
}

impl<S: Write> RasterWriter<S> {
    /// Starts a raster.
    pub fn new(grid: RasterGrid, spool: S) -> RasterWriter<S> {
        let mut size = [grid.columns.max(1), grid.rows.max(1)];
        let mut levels = vec![RasterLevel { size, ..RasterLevel::default() }];
        while size.iter().any(|cells| *cells as usize > TILE) {
            size = size.map(|cells| cells.div_ceil(2));
            levels.push(RasterLevel { size, ..RasterLevel::default() });
        }
        RasterWriter { grid, levels, spool, spooled: 0 }
    }

    /// Adds a tile by its row and column; rows must not decrease, and each tile comes once.
    ///
    /// # Errors
    /// If the spool cannot be written.
    pub fn tile(&mut self, row: u32, column: u32, values: TileValues) -> io::Result<()> {
        self.store(0, row, column, values)
    }

    fn store(&mut self, level: usize, row: u32, column: u32, values: TileValues) -> io::Result<()> {
        let bands = self.grid.bands.len().max(1);
        if values.len() != TILE * TILE * bands {
            return Err(io::Error::new(io::ErrorKind::InvalidInput, "a tile has the wrong number of values"));
        }
        if level + 1 < self.levels.len() {
            // Overview tiles above this one are complete.
            self.flush(level + 1, row / 2)?;
            let coarse = &mut self.levels[level + 1];
            let target = coarse.pending.entry((row / 2, column / 2)).or_insert_with(|| empty_tile_of(bands));
            halve(&values, target, bands, [(row % 2) as usize, (column % 2) as usize]);
        }
        let bytes = compressed(&values)?;
        self.spool.write_all(&bytes)?;
        let place = Spooled { offset: self.spooled, bytes: bytes.len() as u32 };
        self.spooled += bytes.len() as u64;
        if let Some(level) = self.levels.get_mut(level) {
            level.tiles.insert((row, column), place);
        }
        Ok(())
    }

    /// Stores the pending tiles of a level north of a row.
    fn flush(&mut self, level: usize, before: u32) -> io::Result<()> {
        let Some(of_level) = self.levels.get_mut(level) else { return Ok(()) };
        let later = of_level.pending.split_off(&(before, 0));
        for ((row, column), values) in std::mem::replace(&mut of_level.pending, later) {
            self.store(level, row, column, values)?;
        }
        Ok(())
    }

    /// Stores the last overview tiles; returns the spool and the raster to assemble from it.
    ///
    /// # Errors
    /// If the spool cannot be written.
    pub fn finish(mut self) -> io::Result<(S, SpooledRaster)> {
        for level in 1..self.levels.len() {
            self.flush(level, u32::MAX)?;
        }
        Ok((self.spool, SpooledRaster { grid: self.grid, levels: self.levels, spooled: self.spooled }))
    }
}

impl SpooledRaster {
    /// Writes the file from the spool.
    ///
    /// # Errors
    /// If it would exceed 4 GiB, or a file cannot be read or written.
    pub fn assemble(&self, spool: &mut (impl Read + Seek), to: &mut impl Write) -> io::Result<()> {
        let directories: Vec<ImageDirectory> =
            (0..self.levels.len()).map(|level| self.directory(level)).collect();
        let mut starts = Vec::new();
        let mut end = 8;
        for directory in &directories {
            starts.push(end);
            end += directory.bytes();
        }
        if end + self.spooled > MAX_BYTES {
            return Err(io::Error::new(io::ErrorKind::FileTooLarge, "the raster exceeds 4 GiB"));
        }
        // Tiles of the smallest overview come first.
        let mut data = vec![0; self.levels.len()];
        let mut at = end;
        for (level, start) in self.levels.iter().zip(&mut data).rev() {
            *start = at;
            at += level.tiles.values().map(|tile| u64::from(tile.bytes)).sum::<u64>();
        }
        to.write_all(b"II\x2a\0\x08\0\0\0")?;
        for (i, directory) in directories.into_iter().enumerate() {
            let next = starts.get(i + 1).copied().unwrap_or(0);
            to.write_all(&directory.encode(starts[i], next, self.tile_places(i, data[i])))?;
        }
        let mut buffer = Vec::new();
        for level in self.levels.iter().rev() {
            for tile in level.tiles.values() {
                buffer.resize(tile.bytes as usize, 0);
                spool.seek(SeekFrom::Start(tile.offset))?;
                spool.read_exact(&mut buffer)?;
                to.write_all(&buffer)?;
            }
        }
        Ok(())
    }

    /// Offsets and lengths of the tiles of a level whose data start at `start`; 0: no data.
    fn tile_places(&self, level: usize, start: u64) -> [Vec<u32>; 2] {
        let Some(level) = self.levels.get(level) else { return [Vec::new(), Vec::new()] };
        let [across, down] = tiles(level.size);
        let mut places = [vec![0; (across * down) as usize], vec![0; (across * down) as usize]];
        let mut offset = start;
        for ((row, column), tile) in &level.tiles {
            let i = (row * across + column) as usize;
            if let [Some(at), Some(bytes)] = places.each_mut().map(|list| list.get_mut(i)) {
                (*at, *bytes) = (offset as u32, tile.bytes);
            }
            offset += u64::from(tile.bytes);
        }
        places
    }

    fn directory(&self, level: usize) -> ImageDirectory {
        let size = self.levels.get(level).map_or([1, 1], |level| level.size);
        let [across, down] = tiles(size);
        let grid = &self.grid;
        let bands = grid.bands.len().max(1);
        let mut entries = vec![
            (254, TagValue::Longs(vec![u32::from(level > 0)])),
            (256, TagValue::Longs(vec![size[0]])),
            (257, TagValue::Longs(vec![size[1]])),
            (258, TagValue::Shorts(vec![32; bands])),
            // Deflate.
            (259, TagValue::Shorts(vec![8])),
            (262, TagValue::Shorts(vec![1])),
            (277, TagValue::Shorts(vec![bands as u16])),
            (284, TagValue::Shorts(vec![1])),
            (322, TagValue::Longs(vec![TILE as u32])),
            (323, TagValue::Longs(vec![TILE as u32])),
            (OFFSETS, TagValue::Longs(vec![0; (across * down) as usize])),
            (COUNTS, TagValue::Longs(vec![0; (across * down) as usize])),
        ];
        if bands > 1 {
            // Further bands are no colours and no transparency.
            entries.push((338, TagValue::Shorts(vec![0; bands - 1])));
        }
        // IEEE floating point.
        entries.push((339, TagValue::Shorts(vec![3; bands])));
        if level == 0 {
            entries.push((33550, TagValue::Doubles(vec![grid.cell, grid.cell, 0.0])));
            entries.push((33922, TagValue::Doubles(vec![0.0, 0.0, 0.0, grid.west, grid.north, 0.0])));
            if let Some(keys) = grid.crs_wkt.as_deref().and_then(geokeys::from_wkt) {
                entries.extend(geo_entries(&keys));
            }
            let items = grid.bands.iter().enumerate().map(|(band, description)| {
                let text = description.replace('&', "&amp;").replace('<', "&lt;");
                format!("<Item name=\"DESCRIPTION\" sample=\"{band}\" role=\"description\">{text}</Item>")
            });
            let metadata = format!("<GDALMetadata>{}</GDALMetadata>", items.collect::<String>());
            entries.push((42112, TagValue::Text(metadata)));
        }
        entries.push((42113, TagValue::Text(format!("{NO_DATA}"))));
        ImageDirectory { entries }
    }
}

/// Number of tiles across and down.
fn tiles(size: [u32; 2]) -> [u32; 2] {
    size.map(|cells| cells.div_ceil(TILE as u32))
}

/// Entries of the GeoTIFF keys (OGC GeoTIFF 1.1, section 7.1).
fn geo_entries(keys: &GeoKeys) -> Vec<(u16, TagValue)> {
    let words = keys.directory.chunks_exact(2).map(|word| u16::from_le_bytes([word[0], word[1]])).collect();
    let doubles: Vec<f64> = keys
        .doubles
        .chunks_exact(8)
        .map(|bytes| f64::from_le_bytes(bytes.try_into().unwrap_or_default()))
        .collect();
    let mut entries = vec![(34735, TagValue::Shorts(words))];
    if !doubles.is_empty() {
        entries.push((34736, TagValue::Doubles(doubles)));
    }
    let text = String::from_utf8_lossy(&keys.ascii);
    let text = text.trim_end_matches('\0');
    if !text.is_empty() {
        entries.push((34737, TagValue::Text(text.to_owned())));
    }
    entries
}

/// Averages 2 by 2 cells of a tile into a quarter of the next overview's tile.
fn halve(fine: &[f32], coarse: &mut [f32], bands: usize, [down, across]: [usize; 2]) {
    const HALF: usize = TILE / 2;
    for row in 0..HALF {
        for column in 0..HALF {
            for band in 0..bands {
                let (mut sum, mut n) = (0.0f64, 0u32);
                for at in [0, 1, TILE, TILE + 1] {
                    let value = fine[(2 * row * TILE + 2 * column + at) * bands + band];
                    if value.to_bits() != NO_DATA.to_bits() {
                        sum += f64::from(value);
                        n += 1;
                    }
                }
                if n > 0 {
                    let at = (down * HALF + row) * TILE + across * HALF + column;
                    coarse[at * bands + band] = (sum / f64::from(n)) as f32;
                }
            }
        }
    }
}

fn compressed(values: &[f32]) -> io::Result<Vec<u8>> {
    let bytes: Vec<u8> = values.iter().flat_map(|value| value.to_le_bytes()).collect();
    let mut encoder = ZlibEncoder::new(Vec::new(), Compression::default());
    encoder.write_all(&bytes)?;
    encoder.finish()
}

const OFFSETS: u16 = 324;
const COUNTS: u16 = 325;

/// Image file directory; entries in ascending order of tags.
struct ImageDirectory {
    entries: Vec<(u16, TagValue)>,
}

enum TagValue {
    Shorts(Vec<u16>),
    Longs(Vec<u32>),
    Doubles(Vec<f64>),
    Text(String),
}

impl TagValue {
    /// Type code and count.
    fn kind(&self) -> (u16, u32) {
        match self {
            TagValue::Text(text) => (2, text.len() as u32 + 1),
            TagValue::Shorts(values) => (3, values.len() as u32),
            TagValue::Longs(values) => (4, values.len() as u32),
            TagValue::Doubles(values) => (12, values.len() as u32),
        }
    }

    fn encode(&self) -> Vec<u8> {
        match self {
            TagValue::Text(text) => [text.as_bytes(), b"\0"].concat(),
            TagValue::Shorts(values) => values.iter().flat_map(|value| value.to_le_bytes()).collect(),
            TagValue::Longs(values) => values.iter().flat_map(|value| value.to_le_bytes()).collect(),
            TagValue::Doubles(values) => values.iter().flat_map(|value| value.to_le_bytes()).collect(),
        }
    }
}

impl ImageDirectory {
    /// Size with the values that do not fit into entries, bytes.
    fn bytes(&self) -> u64 {
        let outside = |bytes: usize| if bytes > 4 { bytes.next_multiple_of(8) } else { 0 };
        let fixed = (2 + 12 * self.entries.len() + 4).next_multiple_of(8);
        (fixed + self.entries.iter().map(|(_, value)| outside(value.encode().len())).sum::<usize>()) as u64
    }

    /// Encodes the directory at an offset; `next` is the offset of the next directory.
    fn encode(mut self, start: u64, next: u64, [offsets, counts]: [Vec<u32>; 2]) -> Vec<u8> {
        for (tag, value) in &mut self.entries {
            match *tag {
                OFFSETS => *value = TagValue::Longs(offsets.clone()),
                COUNTS => *value = TagValue::Longs(counts.clone()),
                _ => {}
            }
        }
        let mut fixed = (self.entries.len() as u16).to_le_bytes().to_vec();
        let mut outside: Vec<u8> = Vec::new();
        let first = start + (2 + 12 * self.entries.len() + 4).next_multiple_of(8) as u64;
        for (tag, value) in &self.entries {
            let (kind, count) = value.kind();
            fixed.extend(tag.to_le_bytes());
            fixed.extend(kind.to_le_bytes());
            fixed.extend(count.to_le_bytes());
            let mut bytes = value.encode();
            if bytes.len() > 4 {
                fixed.extend(((first + outside.len() as u64) as u32).to_le_bytes());
                bytes.resize(bytes.len().next_multiple_of(8), 0);
                outside.extend(bytes);
            } else {
                bytes.resize(4, 0);
                fixed.extend(bytes);
            }
        }
        fixed.extend((next as u32).to_le_bytes());
        fixed.resize(fixed.len().next_multiple_of(8), 0);
        fixed.extend(outside);
        fixed
    }
}

#[cfg(test)]
mod tests {
    use std::io::Cursor;

    use tiff::decoder::{Decoder, DecodingResult};
    use tiff::tags::Tag;

    use super::*;

    fn grid(columns: u32, rows: u32) -> RasterGrid {
        let crs_wkt = Some(wavex_geodesy::crs::wkt_of_epsg(32633).unwrap());
        let bands = vec!["height <m> & more".to_owned()];
        RasterGrid { columns, rows, west: 320_000.0, north: 5_300_600.0, cell: 2.0, crs_wkt, bands }
    }

    /// A raster of 600 by 300 cells; cell (row, column) has the value 1000 row + column.
    fn raster() -> Vec<u8> {
        let mut writer = RasterWriter::new(grid(600, 300), Vec::new());
        for (row, column) in [(0, 0), (0, 1), (0, 2), (1, 0), (1, 2)] {
            let mut tile = empty_tile();
            for y in 0..TILE.min(300 - row * TILE) {
                for x in 0..TILE.min(600 - column * TILE) {
                    tile[y * TILE + x] = (1000 * (row * TILE + y) + column * TILE + x) as f32;
                }
            }
            writer.tile(row as u32, column as u32, tile).unwrap();
        }
        let (spool, raster) = writer.finish().unwrap();
        let mut file = Vec::new();
        raster.assemble(&mut Cursor::new(spool), &mut file).unwrap();
        file
    }

    #[test]
    fn an_independent_reader_reads_the_raster_and_its_overviews() {
        let mut decoder = Decoder::new(Cursor::new(raster())).unwrap();
        assert_eq!(decoder.dimensions().unwrap(), (600, 300));
        let tie = decoder.get_tag_f64_vec(Tag::ModelTiepointTag).unwrap();
        assert_eq!(tie, [0.0, 0.0, 0.0, 320_000.0, 5_300_600.0, 0.0]);
        let words = decoder.get_tag_u16_vec(Tag::GeoKeyDirectoryTag).unwrap();
        let bytes: Vec<u8> = words.iter().flat_map(|word| word.to_le_bytes()).collect();
        assert_eq!(geokeys::epsg(&bytes), Some(32633));
        let DecodingResult::F32(values) = decoder.read_chunk(4 - 1).unwrap() else { panic!() };
        assert_eq!(values[..3], [256_000.0, 256_001.0, 256_002.0]);
        let offsets = decoder.get_tag_u32_vec(Tag::TileOffsets).unwrap();
        assert_eq!((offsets.len(), offsets[4]), (6, 0), "a tile without values is not stored");
        decoder.next_image().unwrap();
        assert_eq!(decoder.dimensions().unwrap(), (300, 150));
        let DecodingResult::F32(values) = decoder.read_chunk(0).unwrap() else { panic!() };
        assert_eq!(values[..2], [500.5, 502.5]);
        decoder.next_image().unwrap();
        assert_eq!(decoder.dimensions().unwrap(), (150, 75));
        assert!(!decoder.more_images());
    }

    /// Bands of a cell follow each other, and have overviews of their own.
    #[test]
    fn an_independent_reader_reads_several_bands() {
        let bands = vec!["height, m".to_owned(), "SD <m>".to_owned(), "points".to_owned()];
        let mut writer = RasterWriter::new(RasterGrid { bands, ..grid(300, 200) }, Vec::new());
        for column in 0..2 {
            let mut tile = empty_tile_of(3);
            for y in 0..200 {
                for x in 0..TILE.min(300 - column * TILE) {
                    let cell = &mut tile[(y * TILE + x) * 3..][..3];
                    cell.copy_from_slice(&[(column * TILE + x) as f32, y as f32, -1.0]);
                }
            }
            // A cell without data in one band.
            tile[1] = NO_DATA;
            writer.tile(0, column as u32, tile).unwrap();
        }
        assert!(writer.tile(0, 1, empty_tile()).is_err(), "a tile of one band");
        let (spool, raster) = writer.finish().unwrap();
        let mut file = Vec::new();
        raster.assemble(&mut Cursor::new(spool), &mut file).unwrap();
        let mut decoder = Decoder::new(Cursor::new(file)).unwrap();
        assert_eq!(decoder.get_tag_u16_vec(Tag::ExtraSamples).unwrap(), [0, 0]);
        let metadata = decoder.get_tag_ascii_string(Tag::Unknown(42112)).unwrap();
        assert!(metadata.contains("sample=\"1\" role=\"description\">SD &lt;m></Item>"), "{metadata}");
        let DecodingResult::F32(values) = decoder.read_chunk(1).unwrap() else { panic!() };
        assert_eq!(values[3..9], [257.0, 0.0, -1.0, 258.0, 0.0, -1.0]);
        decoder.next_image().unwrap();
        let DecodingResult::F32(values) = decoder.read_chunk(0).unwrap() else { panic!() };
        // The mean of three cells where one has no data.
        assert_eq!(values[..6], [0.5, 2.0 / 3.0, -1.0, 2.5, 0.5, -1.0]);
    }

    /// Overviews come before the raster, so that a reader finds them near the directories.
    #[test]
    fn the_smallest_overview_comes_first() {
        let mut decoder = Decoder::new(Cursor::new(raster())).unwrap();
        let mut first = Vec::new();
        loop {
            let offsets = decoder.get_tag_u32_vec(Tag::TileOffsets).unwrap();
            first.push(offsets.into_iter().filter(|offset| *offset > 0).min().unwrap());
            if !decoder.more_images() {
                break;
            }
            decoder.next_image().unwrap();
        }
        assert!(first.is_sorted_by(|a, b| a > b), "{first:?}");
    }
}

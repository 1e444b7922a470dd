//! Compressed points: LASzip chunks, decoded by the `laz` crate.
//!
//! The crate trusts the sizes in a file and panics on some damaged streams. The chunk table and
//! layer sizes are therefore checked against the file first, and a panic of the decoder becomes an
//! error.

use std::fs::File;
use std::io::{self, BufReader, Cursor, Read, Seek, SeekFrom};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};

use laz::laszip::ChunkTable;
use laz::record::{LayeredPointRecordDecompressor, RecordDecompressor, SequentialPointRecordDecompressor};
use laz::{DecompressionSelection, LazItemRecordBuilder, LazItemType, LazVlr};

use super::header::LasHeader;
use super::point::PointLayout;
use super::vlr::Vlr;
use crate::bytes::Fields;
use crate::{Error, Result, regular_file, resize};

type ChunkDecoder = Box<dyn RecordDecompressor<Cursor<Vec<u8>>> + Send + Sync>;

/// LASzip compressor type: points in chunks, field by field.
const CHUNKED: u16 = 2;
/// LASzip compressor type: points in chunks, one layer per field.
///
/// Formats 6 to 10.
const LAYERED: u16 = 3;
/// Maximum number of extra bytes per compressed point.
///
/// The decoder needs 10 kB for each.
const EXTRA_BYTES_LIMIT: u16 = 4096;
/// Number of records decoded at once on the way to another.
const SKIPPED_AT_ONCE: u64 = 1024;
/// Bytes of a chunk that may follow its points.
///
/// The coder writes as many bytes as the decoder reads ahead.
const SPARE_BYTES: u64 = 4;
const CUT: &str = "the file is cut off or damaged: copy it again from its source";

/// Compressed points of a file.
pub(super) struct Chunks {
    file: File,
    path: PathBuf,
    laz: LazVlr,
    record_length: usize,
    /// Number of layers per chunk.
    ///
    /// `None` if points are not layered.
    layers: Option<usize>,
    table: Vec<ChunkSize>,
    /// Number of chunks started.
    started: usize,
    /// Offset of the first chunk in the file.
    start: u64,
    /// Offset of the chunk table in the file, or of the first chunk if the file has no table.
    table_at: u64,
    /// Offset of the current chunk in the file.
    at: u64,
    /// Offset of the next chunk in the file.
    next_at: u64,
    /// Number of points of the current chunk not yet decoded.
    left: u64,
    decoder: Option<ChunkDecoder>,
    /// Fields to decode; the others keep the value of the chunk's first point.
    selection: DecompressionSelection,
}

#[derive(Clone, Copy)]
struct ChunkSize {
    bytes: u64,
    points: u64,
}

impl Chunks {
    /// Starts at the first chunk.
    ///
    /// # Errors
    /// The LASzip record is missing or does not match the header, or the chunk table contradicts
    /// the file.
    pub(super) fn open(
        file: File,
        path: &Path,
        header: &LasHeader,
        vlrs: &[Vlr],
        file_length: u64,
    ) -> Result<Chunks> {
        let Some(vlr) = vlrs.iter().find(|vlr| vlr.is(LazVlr::USER_ID, LazVlr::RECORD_ID)) else {
            let problem = "the points are marked as compressed, but the LASzip record is missing";
            return Err(Error::malformed(path, 104, "point data record format", problem, CUT));
        };
        let laz = parse_vlr(path, header, vlr)?;
        let layered = Fields::new(path, vlr.offset, &vlr.data).u16("compressor")? == LAYERED;
        let layers = layered.then(|| laz.items().iter().map(|item| n_layers(item.item_type())).sum());
        let start = u64::from(header.offset_to_points) + ChunkTable::OFFSET_SIZE as u64;
        let (table_at, table) = match read_table(&file, path, header, &laz, file_length) {
            // Writers leave the table of an empty file out.
            Err(_) if header.n_points == 0 => (start, Vec::new()),
            table => {
                let (table_at, table) = table?;
                (table_at, with_counts(table, path, header, &laz)?)
            }
        };
        Ok(Chunks {
            file,
            path: path.to_path_buf(),
            laz,
            record_length: header.record_length.into(),
            layers,
            table,
            started: 0,
            start,
            table_at,
            at: start,
            next_at: start,
            left: 0,
            decoder: None,
            selection: DecompressionSelection::all(),
        })
    }

    /// See [`Reader::skip_unused_fields`](super::Reader::skip_unused_fields).
    pub(super) fn skip_unused_fields(&mut self) {
        self.selection = DecompressionSelection::all()
            .skip_classification()
            .skip_user_data()
            .skip_point_source_id()
            .skip_rgb()
            .skip_nir()
            .skip_extra_bytes();
    }

    /// Decodes records until `out` is full.
    pub(super) fn fill(&mut self, mut out: &mut [u8]) -> Result<()> {
        while !out.is_empty() {
            if self.left == 0 {
                self.start_chunk()?;
                continue;
            }
            let count = self.left.min((out.len() / self.record_length) as u64);
            let (now, later) = out.split_at_mut(count as usize * self.record_length);
            self.decode(now)?;
            self.left -= count;
            if self.left == 0 {
                self.check_whole_chunk()?;
            }
            out = later;
        }
        Ok(())
    }

    /// Continues with record `index`, from 0.
    ///
    /// Decodes the records before it in its chunk.
    pub(super) fn seek(&mut self, index: u64) -> Result<()> {
        (self.started, self.left, self.next_at) = (0, 0, self.start);
        let mut before = index;
        while let Some(chunk) = self.table.get(self.started).filter(|chunk| before >= chunk.points) {
            before -= chunk.points;
            self.next_at += chunk.bytes;
            self.started += 1;
        }
        let mut skipped = vec![0; self.record_length * SKIPPED_AT_ONCE.min(before) as usize];
        while before > 0 {
            let count = before.min(SKIPPED_AT_ONCE);
            self.fill(&mut skipped[..count as usize * self.record_length])?;
            before -= count;
        }
        Ok(())
    }

    /// Numbers of points of the chunks.
    pub(super) fn n_points(&self) -> impl Iterator<Item = u64> {
        self.table.iter().map(|chunk| chunk.points)
    }

    /// Offsets of the chunks in the file, with one for the end of the last.
    pub(super) fn offsets(&self) -> Vec<u64> {
        let ends = self.table.iter().scan(self.start, |at, chunk| {
            *at += chunk.bytes;
            Some(*at)
        });
        std::iter::once(self.start).chain(ends).collect()
    }

    /// Offset of the chunk table.
    pub(super) fn table_at(&self) -> u64 {
        self.table_at
    }

    /// The LASzip record.
    pub(super) fn laz(&self) -> &LazVlr {
        &self.laz
    }

    /// Whether the points are layered.
    pub(super) fn is_layered(&self) -> bool {
        self.layers.is_some()
    }

    /// Checks the sizes at the start of each layered chunk.
    ///
    /// # Errors
    /// The file cannot be read, or a chunk has other sizes than the table.
    pub(super) fn check_heads(&self) -> Result<()> {
        let Some(layers) = self.layers else { return Ok(()) };
        let failed = Error::io(&self.path, "read the compressed points");
        let mut file = regular_file(&self.path)?;
        let length = (self.record_length + 4 + 4 * layers) as u64;
        let mut head = Vec::new();
        for (chunk, at) in self.table.iter().zip(self.offsets()).filter(|(chunk, _)| chunk.points > 0) {
            head.clear();
            file.seek(SeekFrom::Start(at)).map_err(&failed)?;
            (&mut file).take(length.min(chunk.bytes)).read_to_end(&mut head).map_err(&failed)?;
            self.check_layers((&head, at), chunk.bytes, layers, chunk.points)?;
        }
        Ok(())
    }

    fn start_chunk(&mut self) -> Result<()> {
        let Some(&ChunkSize { bytes: length, points }) = self.table.get(self.started) else {
            return Err(self.damaged("the chunks hold fewer points than the header declares"));
        };
        self.started += 1;
        self.at = self.next_at;
        self.next_at += length;
        self.left = points;
        if points == 0 {
            return Ok(());
        }
        // One buffer serves all chunks; the sizes in the table add up to less than the file.
        let mut bytes = self.decoder.take().map(|old| old.box_into_inner().into_inner()).unwrap_or_default();
        let read = resize(&mut bytes, length as usize)
            .and_then(|()| self.file.seek(SeekFrom::Start(self.at)))
            .and_then(|_| self.file.read_exact(&mut bytes));
        read.map_err(Error::io(&self.path, "read the compressed points"))?;
        if let Some(layers) = self.layers {
            self.check_layers((&bytes, self.at), length, layers, points)?;
        }
        let input = Cursor::new(bytes);
        let mut decoder: ChunkDecoder = match self.layers {
            Some(_) => Box::new(LayeredPointRecordDecompressor::new(input)),
            None => Box::new(SequentialPointRecordDecompressor::new(input)),
        };
        decoder.set_fields_from(self.laz.items()).map_err(|error| self.damaged(&error.to_string()))?;
        decoder.set_selection(self.selection);
        self.decoder = Some(decoder);
        Ok(())
    }

    /// Checks a layered chunk.
    ///
    /// First point, number of points, size of each layer, layers. `head` are its first bytes, at `at` of the file; it has `length`.
    fn check_layers(&self, (head, at): (&[u8], u64), length: u64, layers: usize, points: u64) -> Result<()> {
        let mut fields = Fields::new(&self.path, at, head);
        fields.skip(self.record_length, "first point of a chunk")?;
        let count = fields.clone();
        let stored = fields.u32("number of points of a chunk")?;
        if u64::from(stored) != points {
            let problem = format!("it is {stored}, but header and chunk table give {points}");
            return Err(count.bad("number of points of a chunk", problem, CUT));
        }
        let mut sum = 0;
        for _ in 0..layers {
            sum += u64::from(fields.u32("size of a layer")?);
        }
        let left = length.saturating_sub(fields.offset() - at);
        if sum > left {
            let problem = format!("{sum} bytes are declared, but the chunk has {left}");
            return Err(fields.bad("layers of a chunk", problem, CUT));
        }
        Ok(())
    }

    /// Checks that a decoded chunk without layers has no further points.
    fn check_whole_chunk(&self) -> Result<()> {
        let (Some(decoder), None) = (&self.decoder, self.layers) else { return Ok(()) };
        let input = decoder.get();
        let unread = (input.get_ref().len() as u64).saturating_sub(input.position());
        if unread <= SPARE_BYTES {
            return Ok(());
        }
        Err(self.damaged(&format!("{unread} bytes of a chunk follow the points that the header declares")))
    }

    fn decode(&mut self, out: &mut [u8]) -> Result<()> {
        let Some(decoder) = &mut self.decoder else {
            return Err(self.damaged("the chunks hold fewer points than the header declares"));
        };
        let decoded = guarded(|| decoder.decompress_many(out));
        if decoded.is_err() {
            // A decoder that failed within a point must not be used again.
            self.decoder = None;
        }
        decoded.map_err(|problem| self.damaged(&problem))
    }

    fn damaged(&self, problem: &str) -> Error {
        Error::malformed(&self.path, self.at, "compressed points", problem, CUT)
    }
}

/// Runs a decoder; converts its error or panic to text.
fn guarded<T>(decode: impl FnOnce() -> io::Result<T>) -> std::result::Result<T, String> {
    match catch_unwind(AssertUnwindSafe(decode)) {
        Ok(result) => result.map_err(|error| format!("they cannot be decoded ({error})")),
        Err(_) => Err("they cannot be decoded".into()),
    }
}

/// Parses the LASzip record and checks that it matches the header.
fn parse_vlr(path: &Path, header: &LasHeader, vlr: &Vlr) -> Result<LazVlr> {
    let bad = |problem: String, remedy| Error::malformed(path, vlr.offset, "LASzip record", problem, remedy);
    let compressor = Fields::new(path, vlr.offset, &vlr.data).u16("compressor")?;
    if !(CHUNKED..=LAYERED).contains(&compressor) {
        let problem = format!("compressor {compressor} is not supported, only 2 and 3 (chunked)");
        return Err(bad(problem, "compress the file again with a LASzip of version 2 or later"));
    }
    let laz = LazVlr::from_buffer(&vlr.data).map_err(|error| bad(error.to_string(), CUT))?;
    let extra = header.record_length.saturating_sub(PointLayout::of(header.point_format).length as u16);
    if extra > EXTRA_BYTES_LIMIT {
        let problem = format!("{extra} extra bytes per point, but at most {EXTRA_BYTES_LIMIT} are supported");
        return Err(bad(problem, "remove extra attributes from the file"));
    }
    let expected = LazItemRecordBuilder::default_for_point_format_id(header.point_format, extra)
        .map_err(|error| bad(error.to_string(), CUT))?;
    let fields =
        |items: &[laz::LazItem]| items.iter().map(|item| (item.item_type(), item.size())).collect::<Vec<_>>();
    if fields(laz.items()) != fields(&expected) {
        let problem =
            format!("its fields do not match format {} with {extra} extra bytes", header.point_format);
        return Err(bad(problem, CUT));
    }
    Ok(laz)
}

fn n_layers(item: LazItemType) -> usize {
    match item {
        LazItemType::Point14 => 9,
        LazItemType::RGBNIR14 => 2,
        LazItemType::Byte14(bytes) => bytes.into(),
        _ => 1,
    }
}

/// Reads the chunk sizes and checks them against the file.
///
/// The chunks must fit between the start of the points and the table.
fn read_table(
    file: &File,
    path: &Path,
    header: &LasHeader,
    laz: &LazVlr,
    file_length: u64,
) -> Result<(u64, Vec<ChunkSize>)> {
    let mut input = BufReader::new(file);
    let start = u64::from(header.offset_to_points) + ChunkTable::OFFSET_SIZE as u64;
    let table_at = find_table(&mut input, path, header, file_length)?;
    let bad = |problem: String| Error::malformed(path, table_at, "chunk table", problem, CUT);
    let room = table_at - start;
    let head = read_8(&mut input, path, table_at)?;
    let mut fields = Fields::new(path, table_at, &head);
    fields.skip(4, "version of the chunk table")?;
    let count = fields.u32("number of chunks")?;
    // Each chunk begins with an uncompressed point.
    if u64::from(count) > room / u64::from(header.record_length) {
        return Err(bad(format!("{count} chunks do not fit into {room} bytes")));
    }
    input.seek(SeekFrom::Start(table_at)).map_err(Error::io(path, "seek to the chunk table"))?;
    let table =
        guarded(|| ChunkTable::read(&mut &mut input, laz.uses_variable_size_chunks())).map_err(bad)?;
    let mut chunks = Vec::with_capacity(table.len());
    let mut bytes = 0u64;
    for entry in &table {
        let fixed = u64::from(laz.chunk_size());
        let n = if laz.uses_variable_size_chunks() { entry.point_count } else { fixed };
        bytes = bytes.saturating_add(entry.byte_count);
        chunks.push(ChunkSize { bytes: entry.byte_count, points: n });
    }
    if bytes > room {
        return Err(bad(format!("the table declares {bytes} bytes of chunks, but {room} bytes precede it")));
    }
    Ok((table_at, chunks))
}

/// Checks the number of points in the chunks against the header.
///
/// The table has a last chunk of a fixed size as if it were full; returns its true number.
///
/// # Errors
/// The chunks hold fewer or more points than the header declares.
fn with_counts(
    mut chunks: Vec<ChunkSize>,
    path: &Path,
    header: &LasHeader,
    laz: &LazVlr,
) -> Result<Vec<ChunkSize>> {
    let declared = header.n_points;
    let bad = |holds: String| {
        let problem = format!("the header declares {declared} points, but the chunks hold {holds}");
        Err(Error::malformed(path, header.count_at(), "number of point records", problem, CUT))
    };
    let points = chunks.iter().fold(0u64, |sum, chunk| sum.saturating_add(chunk.points));
    if laz.uses_variable_size_chunks() {
        return if points == declared { Ok(chunks) } else { bad(points.to_string()) };
    }
    if points < declared {
        return bad(format!("at most {points}"));
    }
    let size = u64::from(laz.chunk_size()).max(1);
    let needed = declared.div_ceil(size);
    // An empty chunk has no first point.
    let is_full = |chunk: &ChunkSize| chunk.bytes >= u64::from(header.record_length);
    let used = chunks.iter().rposition(is_full).map_or(0, |last| last as u64 + 1);
    if used > needed {
        return bad(format!("at least {}", (used - 1) * size + 1));
    }
    chunks.truncate(usize::try_from(needed).unwrap_or(usize::MAX));
    if let Some(last) = chunks.last_mut() {
        last.points = declared - (needed - 1) * size;
    }
    Ok(chunks)
}

/// Finds the chunk table.
///
/// Its offset precedes the first chunk; writers that cannot seek back put it in the last 8 bytes of
/// the file.
fn find_table(
    input: &mut (impl Read + Seek),
    path: &Path,
    header: &LasHeader,
    file_length: u64,
) -> Result<u64> {
    let start = u64::from(header.offset_to_points);
    let first = start + ChunkTable::OFFSET_SIZE as u64;
    let fits = |at: &u64| (first..=file_length.saturating_sub(8)).contains(at);
    if first > file_length {
        let problem = "the file ends before it";
        return Err(Error::malformed(path, start, "offset to the chunk table", problem, CUT));
    }
    let named = u64::from_le_bytes(read_8(input, path, start)?);
    // The field is signed: writers that cannot seek back leave -1, or the offset of the field
    // itself.
    let at = if named > start && named <= i64::MAX as u64 {
        named
    } else {
        u64::from_le_bytes(read_8(input, path, file_length - 8)?)
    };
    if fits(&at) {
        return Ok(at);
    }
    let problem = format!("{at} is not between the points and the end of the file ({file_length} bytes)");
    Err(Error::malformed(path, start, "offset to the chunk table", problem, CUT))
}

fn read_8(input: &mut (impl Read + Seek), path: &Path, at: u64) -> Result<[u8; 8]> {
    let mut bytes = [0; 8];
    let read = input.seek(SeekFrom::Start(at)).and_then(|_| input.read_exact(&mut bytes));
    read.map_err(Error::io(path, "read the chunk table")).map(|()| bytes)
}

//! Copies of files with moved points.

use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::path::Path;

use laz::{LazVlr, ParLasZipCompressor};

use super::contained::contained;
use super::copc::COPC;
use super::header::LasHeader;
use super::point::{Point, PointLayout};
use super::point_out::RETURNS;
use super::raw::RawPoints;
use super::totals::PointTotals;
use super::vlr::{EVLR_HEADER, SPEC, VLR_HEADER, Vlr};
use super::writer::into_io;
use super::{encoding, lax};
use crate::{Error, Result, regular_file};

/// Offset of the bounding box in the header.
const BOUNDS_AT: usize = 179;
/// Offset of the start of the waveform packet record in the header, from LAS 1.3 on.
pub(super) const WAVEFORMS_AT: usize = 227;
/// Offset of the start of the first extended record in the header, from LAS 1.4 on.
pub(super) const EVLRS_AT: usize = 235;
/// Record ID of a record that is to be ignored (LAS 1.4 R15, "Superseded").
const SUPERSEDED: u16 = 7;
/// Points of a chunk if the source has chunks of variable size.
const CHUNK_POINTS: u32 = 50_000;
/// Largest uncompressed chunk, bytes.
const CHUNK_BYTES: usize = 32 << 20;
/// Records that are compressed or written at once.
const AT_ONCE: usize = 4096;

/// What a copy with moved points differs in.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ShiftedCopy {
    /// Steps of the coordinates, in units of the coordinate system.
    pub scale: [f64; 3],
    /// Number of points.
    pub n_points: u64,
    /// Whether the source is a COPC file; the copy is an ordinary LAZ file.
    pub was_copc: bool,
    /// Whether the source has a spatial index (LAX), which the copy lacks.
    pub lost_index: bool,
    /// Whether waveforms are in a file of their own, which is not copied.
    pub has_waveform_file: bool,
}

/// Copies a LAS or LAZ file with moved points; other fields, records and the point format stay.
///
/// `shift` gets each point and gives the change of its coordinates, in units of the coordinate system; it is rounded to the
/// file's steps. The header gets new bounds. `sink` starts at the first byte of the file; `path` names it in errors. Octree and
/// spatial index refer to the old places: their records are marked as superseded. The bytes do not depend on threads.
///
/// # Errors
/// The source is not LAS, is cut off or damaged; a moved coordinate does not fit into 32 bits; or writing fails.
pub fn write_shifted<W: Write + Seek + Send + Sync>(
    source: &Path,
    mut sink: W,
    path: &Path,
    mut shift: impl FnMut(&Point) -> [f64; 3],
) -> Result<ShiftedCopy> {
    let mut points = RawPoints::open(source)?;
    let header = points.header().clone();
    let mut input = regular_file(source)?;
    let mut before = Vec::new();
    let start = u64::from(header.offset_to_points);
    (&mut input).take(start).read_to_end(&mut before).map_err(Error::io(source, "read the header"))?;
    let mut summary = ShiftedCopy {
        scale: header.scale,
        has_waveform_file: header.has_waveforms() && header.global_encoding & encoding::WAVES_BESIDE != 0,
        ..ShiftedCopy::default()
    };
    let mut superseded_later = Vec::new();
    for vlr in points.vlrs() {
        let is_index = vlr.is(lax::USER_ID, lax::RECORD_ID);
        summary.lost_index |= is_index;
        summary.was_copc |= vlr.user_id == COPC;
        if !(is_index || vlr.user_id == COPC) {
            continue;
        }
        if vlr.offset <= start {
            supersede(&mut before, vlr.offset - VLR_HEADER);
        } else {
            superseded_later.push(vlr.offset - EVLR_HEADER);
        }
    }
    let laz = match header.compressed {
        true => Some(compression(source, &header, points.vlrs(), &mut before, &mut summary)?),
        false => None,
    };
    let written = Error::io(path, "write");
    sink.write_all(&before).map_err(&written)?;
    let mut totals = PointTotals::new();
    let (sink, end) = match laz {
        Some(laz) => {
            let failed = Error::io(path, "compress");
            let mut compressor = ParLasZipCompressor::new(sink, laz).map_err(into_io).map_err(&failed)?;
            let mut write = |records: &[u8]| contained(|| compressor.compress_many(records));
            copy(source, path, &mut points, &mut shift, &mut totals, &mut write)?;
            contained(|| compressor.done().map_err(into_io)).map_err(&failed)?;
            (compressor.into_inner(), None)
        }
        None => {
            copy(source, path, &mut points, &mut shift, &mut totals, &mut |records| sink.write_all(records))?;
            (sink, Some(start + header.n_points * u64::from(header.record_length)))
        }
    };
    summary.n_points = totals.points;
    finish(source, sink, path, input, (&header, &mut before), end, &superseded_later, &totals)?;
    Ok(summary)
}

/// Copies all records with moved coordinates.
fn copy(
    source: &Path,
    path: &Path,
    points: &mut RawPoints,
    shift: &mut impl FnMut(&Point) -> [f64; 3],
    totals: &mut PointTotals,
    write: &mut impl FnMut(&[u8]) -> io::Result<()>,
) -> Result<()> {
    let header = points.header().clone();
    let layout = PointLayout::of(header.point_format);
    let length = usize::from(header.record_length);
    let (mut point, mut slab) = (Point::default(), Vec::with_capacity(AT_ONCE * length));
    while let Some(record) = points.next_record()? {
        layout.decode(record, &header.scale, &header.offset, &mut point);
        let moved = shift(&point);
        let at = slab.len();
        slab.extend_from_slice(record);
        let mut raw = point.raw;
        for axis in 0..3 {
            let steps = (moved[axis] / header.scale[axis]).round();
            let Some(value) =
                (steps.abs() <= f64::from(i32::MAX)).then(|| raw[axis].checked_add(steps as i32)).flatten()
            else {
                let problem =
                    format!("a point moves by {} beyond the 32 bits of its coordinate", moved[axis]);
                return Err(Error::unusable(source, problem, "write the file with another offset"));
            };
            raw[axis] = value;
            slab[at + 4 * axis..at + 4 * axis + 4].copy_from_slice(&value.to_le_bytes());
        }
        // The compressor takes -0 and 0 as the same time, but derives later times from their bits.
        let time = layout.gps_time.and_then(|start| slab.get_mut(at + start..at + start + 8));
        if let Some(time) = time.filter(|time| header.compressed && **time == (-0.0f64).to_le_bytes()) {
            time.fill(0);
        }
        totals.add(raw.map(|raw| (raw, raw)), &[point.return_number], RETURNS);
        if slab.len() >= AT_ONCE * length {
            write(&slab).map_err(Error::io(path, "write the points"))?;
            slab.clear();
        }
    }
    // Also of no points: LAZ data begin with an offset.
    write(&slab).map_err(Error::io(path, "write the points"))
}

/// Writes what follows the points, and the header anew.
#[expect(clippy::too_many_arguments, reason = "the state of one function")]
fn finish(
    source: &Path,
    mut sink: impl Write + Seek,
    path: &Path,
    mut input: File,
    (header, before): (&LasHeader, &mut [u8]),
    end_of_points: Option<u64>,
    superseded: &[u64],
    totals: &PointTotals,
) -> Result<()> {
    let written = Error::io(path, "write");
    let minor = header.version.1;
    let waveforms =
        (minor >= 3 && header.has_waveforms() && header.global_encoding & encoding::WAVES_INSIDE != 0)
            .then_some(header.start_of_waveforms)
            .filter(|at| *at > 0);
    let evlrs = (header.n_evlrs > 0).then_some(header.start_of_evlrs);
    let tail_at = end_of_points.or_else(|| [waveforms, evlrs].into_iter().flatten().min());
    if let Some(tail_at) = tail_at {
        let new_at = sink.stream_position().map_err(&written)?;
        input.seek(SeekFrom::Start(tail_at)).map_err(Error::io(source, "seek to the extended records"))?;
        io::copy(&mut input, &mut sink).map_err(&written)?;
        let moved = |at: u64| (new_at + at.saturating_sub(tail_at)).to_le_bytes();
        for (place, at) in [(WAVEFORMS_AT, waveforms), (EVLRS_AT, evlrs)] {
            if let (Some(field), Some(at)) = (before.get_mut(place..place + 8), at) {
                field.copy_from_slice(&moved(at));
            }
        }
        for record_at in superseded {
            let mut record = [0; EVLR_HEADER as usize];
            let new_at = u64::from_le_bytes(moved(*record_at));
            input
                .seek(SeekFrom::Start(*record_at))
                .and_then(|_| input.read_exact(&mut record))
                .map_err(Error::io(source, "read an extended record"))?;
            supersede(&mut record, 0);
            sink.seek(SeekFrom::Start(new_at)).and_then(|_| sink.write_all(&record)).map_err(&written)?;
        }
    }
    if totals.points > 0 {
        let [min, max] = totals.bounds(header);
        let bounds = (0..3).flat_map(|axis| [max[axis], min[axis]]);
        for (field, value) in before[BOUNDS_AT..].chunks_exact_mut(8).zip(bounds) {
            field.copy_from_slice(&value.to_le_bytes());
        }
    }
    sink.seek(SeekFrom::Start(0)).and_then(|_| sink.write_all(before)).map_err(&written)?;
    sink.seek(SeekFrom::End(0)).and_then(|_| sink.flush()).map_err(&written)
}

/// Marks the record whose header begins at `at` as superseded.
pub(super) fn supersede(bytes: &mut [u8], at: u64) {
    let at = at as usize;
    if let Some(name) = bytes.get_mut(at + 2..at + 20) {
        name.fill(0);
        name[..SPEC.len()].copy_from_slice(SPEC.as_bytes());
        name[16..].copy_from_slice(&SUPERSEDED.to_le_bytes());
    }
}

/// Compression of the copy; changes the LASzip record before the points.
///
/// Chunks have a fixed size, and the LASzip record refers to no records after the points.
fn compression(
    source: &Path,
    header: &LasHeader,
    vlrs: &[Vlr],
    before: &mut [u8],
    summary: &mut ShiftedCopy,
) -> Result<LazVlr> {
    // The reader has found and checked it.
    let vlr = vlrs.iter().find(|vlr| vlr.is(LazVlr::USER_ID, LazVlr::RECORD_ID));
    let at = vlr.map_or(0, |vlr| vlr.offset as usize);
    let length = vlr.map_or(0, |vlr| vlr.data.len());
    let failed = |problem: String| {
        Error::malformed(source, at as u64, "LASzip record", problem, "export the file again")
    };
    let Some(data) = before.get_mut(at..at + length).filter(|data| data.len() >= 32) else {
        return Err(failed("it is not before the points".into()));
    };
    let laz = LazVlr::from_buffer(&*data).map_err(|error| failed(error.to_string()))?;
    let most = (CHUNK_BYTES / usize::from(header.record_length)).max(1) as u32;
    let size = match laz.uses_variable_size_chunks() || laz.chunk_size() == 0 {
        true => CHUNK_POINTS,
        false => laz.chunk_size(),
    };
    data[12..16].copy_from_slice(&size.min(most).to_le_bytes());
    // Number and offset of special extended records, which hold a spatial index; -1: none.
    summary.lost_index |= data[16..32] != [0xff; 16] && data[16..24] != [0; 8];
    data[16..32].fill(0xff);
    LazVlr::from_buffer(&*data).map_err(|error| failed(error.to_string()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::las::LasDescription;
    use crate::las::tests::made::{Made, evlr, vlr};
    use std::io::{BufReader, Cursor};

    /// The copy of a file, with all points moved by this.
    fn shifted(bytes: &[u8], by: [f64; 3]) -> Result<(Vec<u8>, ShiftedCopy)> {
        let folder = tempfile::tempdir().unwrap();
        let source = folder.path().join("a.laz");
        std::fs::write(&source, bytes).unwrap();
        let mut out = Cursor::new(Vec::new());
        let summary = write_shifted(&source, &mut out, Path::new("b.laz"), |_| by)?;
        Ok((out.into_inner(), summary))
    }

    fn records(bytes: &[u8]) -> (LasDescription, Vec<Vec<u8>>) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.laz");
        std::fs::write(&path, bytes).unwrap();
        let mut points = RawPoints::open(&path).unwrap();
        let mut records = Vec::new();
        while let Some(record) = points.next_record().unwrap() {
            records.push(record.to_vec());
        }
        let length = bytes.len() as u64;
        let description =
            LasDescription::read(&mut BufReader::new(Cursor::new(bytes)), &path, length).unwrap();
        (description, records)
    }

    /// Points whose fields all differ.
    fn made(minor: u8, format: u8) -> Made {
        let mut made = Made::new(minor, format);
        made.record_length += 3;
        made.records = (0..300u16)
            .map(|k| {
                (0..made.record_length)
                    .map(|byte| (k.wrapping_mul(7) ^ byte.wrapping_mul(29)) as u8)
                    .collect()
            })
            .collect();
        for (k, record) in made.records.iter_mut().enumerate() {
            for axis in 0..3 {
                let raw = (k as i32 - 100) * (axis as i32 + 1);
                record[4 * axis..4 * axis + 4].copy_from_slice(&raw.to_le_bytes());
            }
            record[14] = 0x11;
            // Times and offsets of waveforms are those of a file: the encoder subtracts them.
            let (time, packets) = if format == 4 { (20, 28) } else { (22, 30) };
            record[time..time + 8].copy_from_slice(&(1000.0 + 0.013 * k as f64).to_le_bytes());
            record[packets + 5..packets + 9].fill(0);
        }
        made.vlrs.push(vlr("someone", 9, b"a record"));
        made
    }

    fn raw(record: &[u8]) -> [i32; 3] {
        std::array::from_fn(|axis| i32::from_le_bytes(record[4 * axis..4 * axis + 4].try_into().unwrap()))
    }

    /// Steps are 0.01.
    const BY: [f64; 3] = [0.114, -0.07, 2.0];
    const STEPS: [i32; 3] = [11, -7, 200];

    #[test]
    fn only_coordinates_and_bounds_change() {
        for (minor, format) in [(3, 4), (4, 9)] {
            let mut made = made(minor, format);
            if minor == 4 {
                made.tail =
                    [evlr("someone", 1, b"after the points"), evlr("other", 2, &[7; 70_000])].concat();
                made.n_evlrs = 2;
            }
            let source = made.las();
            let (copy, summary) = shifted(&source, BY).unwrap();
            assert_eq!(summary, ShiftedCopy { n_points: 300, scale: [0.01; 3], ..ShiftedCopy::default() });
            assert_eq!(copy.len(), source.len());
            let changed: Vec<usize> = (0..copy.len()).filter(|k| copy[*k] != source[*k]).collect();
            let start = made.offset_to_points();
            for at in changed {
                let in_record = (at.wrapping_sub(start)) % usize::from(made.record_length);
                let is_coordinate = (start..made.offset_to_tail()).contains(&at) && in_record < 12;
                assert!(is_coordinate || (179..227).contains(&at), "byte {at}");
            }
            let (description, moved) = records(&copy);
            for (before, after) in made.records.iter().zip(&moved) {
                let (before, after) = (raw(before), raw(after));
                assert_eq!(std::array::from_fn(|axis| after[axis] - before[axis]), STEPS);
            }
            let expected = [-100 + 11, -200 - 7, -300 + 200].map(|raw| f64::from(raw) * 0.01);
            assert_eq!(description.header.min, expected);
            // The same of compressed points, whatever their chunks; a second copy has the same bytes.
            made.n_evlrs = 0;
            for laz in [made.laz(64), made.laz_in_two(70)] {
                let (copy, _) = shifted(&laz, BY).unwrap();
                assert_eq!(records(&copy).1, moved);
                assert!(copy == shifted(&laz, BY).unwrap().0);
            }
        }
    }

    /// Records after compressed points keep their bytes at their new place; octree and index do not count.
    #[test]
    fn extended_records_move_and_old_indexes_are_superseded() {
        let mut made = made(4, 9);
        made.vlrs.push(vlr("copc", 1, &[0; 160]));
        let mut bytes = made.laz(64);
        let at = bytes.len() as u64;
        bytes[235..243].copy_from_slice(&at.to_le_bytes());
        bytes[243..247].copy_from_slice(&3u32.to_le_bytes());
        let tail = [
            evlr("LAStools", 30, b"an index"),
            evlr("someone", 1, b"after the points"),
            evlr("copc", 1000, b"an octree"),
        ];
        bytes.extend(tail.concat());
        let (copy, summary) = shifted(&bytes, BY).unwrap();
        assert!(summary.was_copc && summary.lost_index, "{summary:?}");
        let (description, moved) = records(&copy);
        assert_eq!(moved.len(), 300);
        let found: Vec<_> =
            description.vlrs.iter().map(|vlr| (vlr.user_id.as_str(), vlr.record_id)).collect();
        let gone = ("LASF_Spec", 7);
        let expected = [gone, ("laszip encoded", 22204), gone, ("someone", 1), gone];
        assert_eq!(found[found.len() - 5..], expected, "{found:?}");
        assert_eq!(description.vlrs[found.len() - 2].data, b"after the points");
    }

    #[test]
    fn what_cannot_be_copied_is_refused() {
        let made = made(4, 9);
        let problem = shifted(&made.las(), [1e9, 0.0, 0.0]).unwrap_err().to_string();
        assert!(
            problem.contains("a point moves by 1000000000 beyond the 32 bits of its coordinate"),
            "{problem}"
        );
        let nan = shifted(&made.las(), [f64::NAN, 0.0, 0.0]).unwrap_err().to_string();
        assert!(nan.contains("a point moves by NaN"), "{nan}");
        let cut = &made.laz(64)[..1500];
        assert!(shifted(cut, BY).is_err());
        let cut = &made.las()[..3000];
        assert!(shifted(cut, BY).unwrap_err().to_string().contains("cut off"));
    }

    #[test]
    fn no_points_are_a_file_without_points() {
        let mut made = made(4, 9);
        made.records.clear();
        for bytes in [made.las(), made.laz(64)] {
            let (copy, summary) = shifted(&bytes, BY).unwrap();
            assert_eq!((summary.n_points, records(&copy).1.len()), (0, 0));
        }
    }
}

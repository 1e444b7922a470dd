//! Messages of a data set: its extent, where its data are, and the value of elements that are not stored.

use wavex_formats::Result;
use wavex_formats::bytes::Fields;

use super::chunk_index::{Chunk, Grid, Index};
use super::input::{Address, COPY_AGAIN, Input, REPACK, address};

/// Most bytes of a decoded chunk, and of a row of chunks.
pub(super) const CHUNK_BYTES: u64 = 64 << 20;

/// Where the data are.
pub(super) enum Storage {
    Compact(Vec<u8>),
    Contiguous(Option<Address>),
    Chunked(Grid, Vec<Chunk>),
}

/// Reads the extent and the largest extent, `u64::MAX` if unlimited.
pub(super) fn read_extent(fields: &mut Fields) -> Result<[Vec<u64>; 2]> {
    let field = "dataspace";
    let before = fields.clone();
    let version = fields.u8(field)?;
    let rank = usize::from(fields.u8(field)?);
    let flags = fields.u8(field)?;
    fields.skip(if version == 1 { 5 } else { 1 }, field)?;
    if rank > 2 {
        let problem = format!("{rank} dimensions, only 1 and 2 are supported");
        return Err(before.bad(field, problem, "give a file of GEDI L1B or LVIS L1B"));
    }
    let mut sizes = || (0..rank).map(|_| fields.u64(field)).collect::<Result<Vec<_>>>();
    let mut extent = sizes()?;
    let mut most = if flags & 1 == 0 { extent.clone() } else { sizes()? };
    if rank == 0 {
        (extent, most) = (vec![1], vec![1]);
    }
    Ok([extent, most])
}

/// Reads the value of elements that are not stored, if it is defined.
pub(super) fn read_fill_value(fields: &mut Fields, fill: &mut [u8]) -> Result<()> {
    let field = "fill value";
    let version = fields.u8(field)?;
    let defined = if version < 3 {
        fields.skip(2, field)?;
        fields.u8(field)? != 0
    } else {
        fields.u8(field)? & 0x20 != 0
    };
    if !defined {
        return Ok(());
    }
    let before = fields.clone();
    let length = fields.u32(field)? as usize;
    match length {
        0 => {}
        _ if length == fill.len() => fill.copy_from_slice(fields.take(length, field)?),
        _ => return Err(before.bad(field, "not as long as the numbers", COPY_AGAIN)),
    }
    Ok(())
}

/// Reads where the data are; `grid` has what other messages say.
pub(super) fn read_layout(
    input: &Input,
    fields: &mut Fields,
    mut grid: Grid,
    extent: &[u64],
) -> Result<Storage> {
    let field = "layout";
    let before = fields.clone();
    let length = extent.iter().product::<u64>() * grid.chunk_bytes;
    let version = fields.u8(field)?;
    let class = fields.u8(field)?;
    match (version, class) {
        (3..=5, 0) => {
            let bytes = usize::from(fields.u16(field)?);
            if bytes as u64 != length {
                return Err(before.bad(field, format!("{bytes} bytes of {length}"), COPY_AGAIN));
            }
            Ok(Storage::Compact(fields.take(bytes, field)?.to_vec()))
        }
        (3..=5, 1) => Ok(Storage::Contiguous(address(fields, field)?)),
        (3..=5, 2) => {
            let flags = if version > 3 { fields.u8(field)? } else { 0 };
            let dimensions = usize::from(fields.u8(field)?);
            let mut at = if version == 3 { address(fields, field)? } else { None };
            let length_bytes = if version > 3 { usize::from(fields.u8(field)?) } else { 4 };
            if dimensions != extent.len() + 1 || !(1..=8).contains(&length_bytes) {
                return Err(before.bad(field, "dimensions of chunks differ from the data's", COPY_AGAIN));
            }
            for _ in extent {
                grid.chunk_shape.push(fields.uint(length_bytes, field)?);
            }
            let number_bytes = fields.uint(length_bytes, field)?;
            let elements =
                grid.chunk_shape.iter().try_fold(1_u64, |product, &length| product.checked_mul(length));
            let bytes =
                elements.and_then(|elements| elements.checked_mul(grid.chunk_bytes)).unwrap_or(u64::MAX);
            if number_bytes != grid.chunk_bytes || bytes == 0 {
                return Err(before.bad(field, "impossible size of chunks", COPY_AGAIN));
            }
            if bytes > CHUNK_BYTES {
                let problem = format!("{bytes} bytes in a chunk, at most {CHUNK_BYTES}");
                return Err(before.bad(field, problem, REPACK));
            }
            grid.chunk_bytes = bytes;
            // Version 4 stores sizes of chunks in as few bytes as a chunk that has grown a little needs.
            grid.size_bytes = if version == 4 { (1 + (bytes.ilog2() as usize + 8) / 8).min(8) } else { 8 };
            let mut index = Index::BTree1;
            if version > 3 {
                index = Index::read(fields, flags)?;
                at = address(fields, field)?;
            }
            let grows_sideways = grid.most.get(1) == Some(&u64::MAX);
            if grows_sideways && matches!(index, Index::ExtensibleArray) {
                return Err(before.bad(field, "rows that grow are not supported", REPACK));
            }
            if flags & 1 != 0 && grid.filtered {
                return Err(before.bad(
                    field,
                    "chunks at the edge without filters are not supported",
                    REPACK,
                ));
            }
            let chunks = match at {
                Some(at) if !extent.contains(&0) => index.chunks(input, at, &grid, extent)?,
                _ => Vec::new(),
            };
            Ok(Storage::Chunked(grid, chunks))
        }
        (3..=5, _) => Err(before.bad(field, "virtual data sets are not supported", REPACK)),
        _ => Err(before.bad(field, format!("version {version} is not supported"), REPACK)),
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;

    /// Error of a layout message for eight floats; `filtered` chunks.
    fn layout_error(filtered: bool, bytes: &[u8]) -> String {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/odd_data_sets.h5");
        let input = Input::open(&path).unwrap();
        let grid = Grid { chunk_shape: Vec::new(), most: vec![8], chunk_bytes: 4, filtered, size_bytes: 8 };
        let fields = &mut Fields::new(Path::new("f.h5"), 0, bytes);
        read_layout(&input, fields, grid, &[8]).err().map(|error| error.to_string()).unwrap_or_default()
    }

    #[test]
    fn impossible_layouts_are_refused() {
        let undefined = [0xff; 8];
        let chunked = |head: &[u8], sizes: [u32; 2], flags: u8| {
            let mut bytes = vec![4, 2, flags, head[0], 4];
            sizes.into_iter().for_each(|size| bytes.extend(size.to_le_bytes()));
            [&bytes[..], &[2], &undefined].concat()
        };
        assert_eq!(layout_error(false, &chunked(&[2], [5, 4], 0)), "");
        for (filtered, bytes, expected) in [
            (false, vec![3, 0, 3, 0, 1, 2, 3], "3 bytes of 32"),
            (false, vec![2, 1], "version 2 is not supported"),
            (false, chunked(&[3], [5, 4], 0), "dimensions of chunks differ from the data's"),
            (false, chunked(&[2], [0, 4], 0), "impossible size of chunks"),
            (false, chunked(&[2], [5, 8], 0), "impossible size of chunks"),
            (true, chunked(&[2], [5, 4], 1), "chunks at the edge without filters are not supported"),
        ] {
            let found = layout_error(filtered, &bytes);
            assert!(found.contains(&format!("f.h5: byte 0: layout: {expected}")), "{found}");
        }
    }

    #[test]
    fn fill_values_have_the_size_of_the_numbers() {
        let read = |bytes: &[u8]| {
            let mut fill = vec![1, 2];
            let text = read_fill_value(&mut Fields::new(Path::new("f.h5"), 0, bytes), &mut fill);
            text.map(|_| fill).map_err(|error| error.to_string())
        };
        assert_eq!(read(&[3, 0x20, 2, 0, 0, 0, 7, 8]), Ok(vec![7, 8]));
        assert_eq!(read(&[2, 0, 0, 1, 2, 0, 0, 0, 7, 8]), Ok(vec![7, 8]));
        assert_eq!(read(&[3, 0x20, 0, 0, 0, 0]), Ok(vec![1, 2]));
        assert_eq!(read(&[3, 0]), Ok(vec![1, 2]));
        assert!(
            read(&[3, 0x20, 1, 0, 0, 0, 7]).unwrap_err().contains("fill value: not as long as the numbers")
        );
    }
}

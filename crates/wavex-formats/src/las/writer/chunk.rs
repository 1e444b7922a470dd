//! Compresses a chunk of points.

use std::io;

use laz::las::v3::{LasPoint6Compressor, LasWavepacketCompressor};
use laz::record::{LayeredFieldCompressor, RecordCompressor, SequentialPointRecordCompressor};
use laz::{LasZipError, LazItemType, LazVlr};

use super::byte_layers::{ByteLayers, TOGETHER};
use crate::las::contained::contained;

/// Length of a point of format 6, bytes.
const POINT: usize = 30;

/// Compressed chunk.
pub(super) type Chunk = io::Result<Vec<u8>>;

/// Compresses the records of a chunk.
pub(super) fn compress(records: &[u8], laz: &LazVlr) -> Chunk {
    let is_layered = laz.items().iter().any(|item| item.item_type() == LazItemType::Point14);
    contained(|| if is_layered { layered(records, laz) } else { sequential(records, laz) })
}

/// Compresses formats 1 and 4.
fn sequential(records: &[u8], laz: &LazVlr) -> Chunk {
    let mut compressor = SequentialPointRecordCompressor::new(Vec::new());
    compressor.set_fields_from(laz.items()).map_err(into_io)?;
    compressor.compress_many(records)?;
    compressor.done()?;
    Ok(compressor.into_inner())
}

/// Compresses formats 6 and 9.
///
/// Layout: uncompressed first point, number of points, lengths of all layers, layers.
fn layered(records: &[u8], laz: &LazVlr) -> Chunk {
    let length = laz.items_size() as usize;
    let mut chunk = Vec::new();
    let (Some(first), Some(others)) = (records.get(..length), records.get(length..)) else {
        return Ok(chunk);
    };
    let (mut fields, mut channel) = (StandardFields::of(laz), 0);
    let (standard, extra) = first.split_at(fields.standard_length.min(length));
    fields.begin(standard, &mut chunk, &mut channel)?;
    chunk.extend(extra);
    let mut bytes = ByteLayers::new(extra, channel as u8);
    let mut channels = Vec::with_capacity(TOGETHER);
    for records in others.chunks(TOGETHER * length) {
        channels.clear();
        for record in records.chunks_exact(length) {
            channels.push(fields.add(record)?);
        }
        bytes.add(records, length, &channels);
    }
    let layers: Vec<Vec<u8>> = bytes.finish().collect();
    chunk.extend(((records.len() / length) as u32).to_le_bytes());
    fields.write_lengths(&mut chunk)?;
    layers.iter().for_each(|layer| chunk.extend((layer.len() as u32).to_le_bytes()));
    fields.write_layers(&mut chunk)?;
    layers.iter().for_each(|layer| chunk.extend(layer));
    Ok(chunk)
}

/// Compressors of the standard fields.
struct StandardFields {
    point: LasPoint6Compressor,
    wave: Option<LasWavepacketCompressor>,
    standard_length: usize,
}

impl StandardFields {
    fn of(laz: &LazVlr) -> StandardFields {
        let wave = laz.items().iter().find(|item| item.item_type() == LazItemType::WavePacket14);
        let standard_length = POINT + wave.map_or(0, |item| usize::from(item.size()));
        StandardFields {
            point: LasPoint6Compressor::default(),
            wave: wave.map(|_| LasWavepacketCompressor::default()),
            standard_length,
        }
    }

    /// Starts with the first point; sets `channel` from it.
    fn begin(&mut self, record: &[u8], chunk: &mut Vec<u8>, channel: &mut usize) -> io::Result<()> {
        self.point.init_first_point(chunk, &record[..POINT], channel)?;
        match &mut self.wave {
            Some(wave) => wave.init_first_point(chunk, &record[POINT..self.standard_length], channel),
            None => Ok(()),
        }
    }

    /// Adds a point and returns its scanner channel.
    fn add(&mut self, record: &[u8]) -> io::Result<u8> {
        let mut channel = 0;
        // The trait functions are generic over an output that they do not use.
        LayeredFieldCompressor::<Vec<u8>>::compress_field_with(
            &mut self.point,
            &record[..POINT],
            &mut channel,
        )?;
        if let Some(wave) = &mut self.wave {
            let bytes = &record[POINT..self.standard_length];
            LayeredFieldCompressor::<Vec<u8>>::compress_field_with(wave, bytes, &mut channel)?;
        }
        Ok(channel as u8)
    }

    fn write_lengths(&mut self, chunk: &mut Vec<u8>) -> io::Result<()> {
        self.point.write_layers_sizes(chunk)?;
        self.wave.as_mut().map_or(Ok(()), |wave| wave.write_layers_sizes(chunk))
    }

    fn write_layers(&mut self, chunk: &mut Vec<u8>) -> io::Result<()> {
        self.point.write_layers(chunk)?;
        self.wave.as_mut().map_or(Ok(()), |wave| wave.write_layers(chunk))
    }
}

/// Converts an error of the LAZ coder; an I/O error keeps its kind, another one its message.
pub(in crate::las) fn into_io(error: LasZipError) -> io::Error {
    match error {
        LasZipError::IoError(error) => error,
        other => io::Error::other(other),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use laz::LazVlrBuilder;
    use laz::laszip::parallel::par_compress;
    use proptest::prelude::*;

    /// Returns the chunk as encoded by the `laz` crate and by this module.
    fn both(records: &[u8], format: u8, extra: u16) -> [Vec<u8>; 2] {
        let laz = LazVlrBuilder::default().with_point_format(format, extra).unwrap();
        let laz = laz.with_fixed_chunk_size(100_000).build();
        assert_eq!(records.len() % laz.items_size() as usize, 0);
        let mut theirs = Vec::new();
        par_compress(&mut theirs, records, &laz).unwrap();
        [theirs, compress(records, &laz).unwrap()]
    }

    /// Creates records with random changes of fields, extra bytes and channels.
    fn records(n: usize, length: usize, seed: u64, channel_every: u64) -> Vec<u8> {
        let mut state = seed;
        let mut next = |below: u64| {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 33) % below.max(1)
        };
        let mut bytes = Vec::new();
        let mut channel = 0;
        for i in 0..n {
            let mut record = vec![0; length];
            record[0] = i as u8;
            record[14] = 0x11;
            if next(channel_every) == 0 {
                channel = next(4) as u8;
            }
            record[15] = channel << 4;
            for (k, byte) in record.iter_mut().enumerate().skip(30) {
                // Layers of noise, of rare changes, and of constant bytes.
                *byte = match k % 4 {
                    0 => next(256) as u8,
                    1 => next(9) as u8,
                    2 => u8::from(next(50) == 0) * 255,
                    _ => 7,
                };
            }
            bytes.extend(record);
        }
        bytes
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(60))]
        #[test]
        fn chunks_are_those_of_laz(
            n in prop_oneof![1..4usize, 510..520usize, 1000..5000usize],
            extra in 0..12u16,
            (format, standard) in prop::sample::select(vec![(6, 30), (9, 59)]),
            channel_every in prop::sample::select(vec![1u64, 3, 700, u64::MAX]),
            seed in any::<u64>(),
        ) {
            let records = records(n, standard + usize::from(extra), seed, channel_every);
            let [theirs, ours] = both(&records, format, extra);
            prop_assert_eq!(theirs, ours);
        }

        /// A chunk has at least one point.
        #[test]
        fn old_chunks_are_those_of_laz(n in 1..1200usize, extra in 0..4u16, seed in any::<u64>()) {
            let records = records(n, 28 + usize::from(extra), seed, u64::MAX);
            let [theirs, ours] = both(&records, 1, extra);
            prop_assert_eq!(theirs, ours);
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(20))]
        /// `laz` overflows for some jumps of values, which a build with overflow checks notices.
        #[test]
        fn no_bytes_make_it_panic(
            (format, length) in prop::sample::select(vec![(1u8, 28usize), (6, 30), (9, 59)]),
            bytes in prop::collection::vec(any::<u8>(), 59 * 40),
        ) {
            let laz = LazVlrBuilder::default().with_point_format(format, 0).unwrap().build();
            let _ = compress(&bytes[..length * (bytes.len() / length)], &laz);
        }
    }

    #[test]
    fn errors_of_the_laz_coder_keep_their_kind_or_their_message() {
        let full = LasZipError::IoError(io::ErrorKind::StorageFull.into());
        assert_eq!(into_io(full).kind(), io::ErrorKind::StorageFull);
        let other = into_io(LasZipError::UnsupportedPointFormat(99));
        assert_eq!(other.kind(), io::ErrorKind::Other);
        assert_eq!(other.to_string(), LasZipError::UnsupportedPointFormat(99).to_string());
    }

    #[test]
    fn a_long_chunk_is_that_of_laz() {
        // Counts are halved after 32 768 symbols.
        let [theirs, ours] = both(&records(70_000, 36, 1, 100), 6, 6);
        assert_eq!(theirs, ours);
    }
}

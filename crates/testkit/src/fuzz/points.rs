//! LAS, LAZ and COPC.

use std::io::{Cursor, Read};

use wavex_formats::las::{LasDescription, Point, RawPoints, Reader, write_copc, write_shifted};

use super::{Files, parts};
use crate::compression::packet;

/// Most points of an input that are read: a compressed file can declare more than time allows.
const MOST_POINTS: u64 = 20_000;

/// Most samples of an input that are read.
const MOST_SAMPLES: usize = 1 << 20;
/// Most packets of an input that are compressed again.
const MOST_COMPRESSED: usize = 20;

/// A LAS or LAZ file, and its waveform packets (`.wdp`) as second part.
pub fn las(bytes: &[u8]) {
    let parts = parts(bytes);
    let place = Files::with(&[("a.las", parts[0])]);
    if let Some(packets) = parts.get(1) {
        place.write("a.wdp", packets);
    }
    let path = place.path("a.las");
    let described = LasDescription::read(&mut Cursor::new(parts[0]), &path, parts[0].len() as u64);
    if let Ok(description) = &described {
        let _ = (description.extra_bytes(&path), description.crs());
        let _ = description.header.gps_time();
    }
    let mut n_raw = 0;
    if let Ok(mut points) = RawPoints::open(&path) {
        let fields = points.fields().to_vec();
        while n_raw < MOST_POINTS
            && let Ok(Some(record)) = points.next_record()
        {
            n_raw += 1;
            if n_raw < 100 {
                fields.iter().for_each(|field| assert!(field.value(record).len() < 400));
            }
        }
    }
    let Ok(mut reader) = Reader::open(&path) else { return };
    let _ = (reader.crs(), reader.has_different_gains(), reader.projection(34735));
    let n_extra = reader.extra_bytes_descriptors().len();
    assert!(n_extra <= usize::from(u16::MAX));
    let (mut point, mut samples) = (Point::default(), Vec::new());
    let mut first: Option<String> = None;
    let mut n_points = 0;
    while n_points < MOST_POINTS
        && let Ok(true) = reader.next_point(&mut point)
    {
        n_points += 1;
        first.get_or_insert_with(|| format!("{point:?}"));
        let extra = reader.extra_bytes().to_vec();
        assert!(extra.len() <= usize::from(reader.header().record_length));
        if n_points < 200
            && let Ok(descriptor) = reader.packet(&point.wave, &mut samples)
        {
            assert_eq!(samples.len() as u64, u64::from(descriptor.samples));
            let _ = point.wave.sample_position(
                [point.x, point.y, point.z],
                1.0,
                f64::from(descriptor.spacing_ps),
            );
        }
    }
    assert!(n_points <= n_raw, "{n_points} points of {n_raw} records");
    if let Some(first) = first
        && reader.seek(0).is_ok()
        && let Ok(true) = reader.next_point(&mut point)
    {
        assert_eq!(format!("{point:?}"), first, "the first point after seeking");
    }
}

/// A LAS file, and its compressed waveform packets (`.wdz`) as second part.
///
/// Samples that are compressed again stay the same.
pub fn compressed_packets(bytes: &[u8]) {
    let parts = parts(bytes);
    let place = Files::with(&[("a.las", parts[0]), ("a.wdz", parts.get(1).copied().unwrap_or_default())]);
    let Ok(mut reader) = Reader::open(&place.path("a.las")) else { return };
    let (mut point, mut samples) = (Point::default(), Vec::new());
    let (mut left, mut n_packets) = (MOST_SAMPLES, 0);
    while left > 0
        && let Ok(true) = reader.next_point(&mut point)
    {
        left -= 1;
        let Ok(descriptor) = reader.packet(&point.wave, &mut samples) else {
            assert!(samples.is_empty(), "a damaged packet has samples");
            continue;
        };
        assert_eq!(samples.len() as u64, u64::from(descriptor.samples));
        assert_eq!(reader.packet_descriptor(&point.wave).unwrap(), descriptor);
        left = left.saturating_sub(samples.len());
        n_packets += 1;
        if descriptor.compression == 1 && n_packets <= MOST_COMPRESSED {
            let packet = packet(descriptor.bits, &samples);
            assert_eq!(decoded(&packet, descriptor.bits, descriptor.samples), samples);
        }
    }
}

/// Samples of a compressed packet, by a recording of one point.
fn decoded(packet: &[u8], bits: u8, samples: u32) -> Vec<u16> {
    let mut las = crate::las::Las::new(1);
    las.vlrs[0] = crate::las::vlr("LASF_Spec", 100, &crate::las::descriptor(bits, samples, 1000));
    las.vlrs[0][54 + 1] = 1;
    las.packets.truncate(60);
    las.packets[20..28].fill(0);
    las.packets.extend(packet);
    let las = las.change(0, 39, &(packet.len() as u32).to_le_bytes());
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("b.las");
    std::fs::write(&path, las.las()).unwrap();
    std::fs::write(folder.path().join("b.wdz"), &las.packets).unwrap();
    let mut reader = Reader::open(&path).unwrap();
    let (mut point, mut samples) = (Point::default(), Vec::new());
    assert!(reader.next_point(&mut point).unwrap());
    reader.packet(&point.wave, &mut samples).unwrap();
    samples
}

/// A LAS or LAZ file whose points become a COPC file, which has the same points.
pub fn copc(bytes: &[u8]) {
    let place = Files::with(&[("a.laz", bytes)]);
    let source = place.path("a.laz");
    // A compressed file can declare more points than time allows.
    let Ok(points) = RawPoints::open(&source) else { return };
    if points.header().n_points > MOST_POINTS {
        return;
    }
    drop(points);
    let _ = write_shifted(&source, Cursor::new(Vec::new()), &place.path("b.laz"), |_| [0.5; 3]);
    let mut copy = Cursor::new(Vec::new());
    let path = place.path("a.copc.laz");
    let mut keep = |run: &[u8]| Ok(Box::new(Cursor::new(run.to_vec())) as Box<dyn Read>);
    let Ok(summary) = write_copc(&source, &mut copy, &path, &mut keep, &mut |_| ()) else { return };
    place.write("a.copc.laz", &copy.into_inner());
    let mut copied = RawPoints::open(&path).unwrap();
    assert_eq!(copied.header().n_points, summary.n_points);
    let sorted = |points: &mut RawPoints, length: usize| {
        let mut records = Vec::new();
        while let Some(record) = points.next_record().unwrap() {
            let mut record = record[..length].to_vec();
            // COPC stores a time of -0 as 0.
            if record[22..30] == (-0.0f64).to_le_bytes() {
                record[22..30].fill(0);
            }
            records.push(record);
        }
        records.sort();
        records
    };
    // Both have at least the fields of format 6 in common.
    let copies = sorted(&mut copied, 30);
    assert_eq!(copies.len() as u64, summary.n_points);
    let sources = sorted(&mut RawPoints::open(&source).unwrap(), 30);
    let changed = copies.iter().zip(&sources).find(|(copy, source)| copy != source);
    assert_eq!((changed, copies.len()), (None, sources.len()), "a point has changed");
}

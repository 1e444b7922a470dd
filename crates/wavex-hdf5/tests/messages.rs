//! Every message about a file that cannot be read.
//!
//! Sound files are damaged at known places: all blocks with a signature get other bytes.
#![allow(clippy::unwrap_used, reason = "a test fails by it")]

use std::fs;
use std::path::{Path, PathBuf};

use tempfile::TempDir;
use wavex_hdf5::{Granule, Shot, product_of};

fn data(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data").join(name)
}

/// Reads all shots of all beams; returns the first error.
fn first_error(path: &Path) -> String {
    let read = || {
        let granule = Granule::open(path)?;
        let mut shot = Shot::default();
        for beam in granule.beams().iter().filter(|beam| beam.shots > 0) {
            let mut reader = granule.beam(&beam.name)?;
            for index in 0..reader.len() {
                reader.shot(index, &mut shot)?;
            }
        }
        Ok::<(), wavex_formats::Error>(())
    };
    read().map_or_else(|error| error.to_string(), |_| "no error".to_owned())
}

fn refused(name: &str, expected: &str) {
    let found = product_of(&data(name)).unwrap_err().to_string();
    assert!(found.contains(expected), "{name}: {found}");
}

#[test]
fn other_products_are_named() {
    refused(
        "gedi_l2a.h5",
        "GEDI L2 or L4: it holds results, not waveforms; give the GEDI01_B file of the same orbit",
    );
    refused(
        "other.h5",
        "neither GEDI L1B nor LVIS L1B nor SPD; its root group has: group_a, group_b, group_c, group_d, group_e, group_f, \
         group_g, group_h, ...; give",
    );
    let granule = Granule::open(&data("gedi_product.h5")).unwrap();
    let error = |name: &str| granule.beam(name).err().unwrap().to_string();
    assert!(error("BEAM0000").contains("beam BEAM0000 has no shots; choose another beam"));
    assert!(error("BEAM1111").contains("no beam BEAM1111; choose one of: BEAM0000, BEAM0101"));
}

#[test]
fn impossible_beams_are_refused() {
    for (name, expected) in [
        ("counts", "BEAM0101/delta_time: 3 values for 2 shots; the file is damaged"),
        ("negative", "shot 1 of BEAM0101: BEAM0101/shot_number: not a whole number"),
        ("start_missing", "shot 1 of BEAM0101: BEAM0101/rx_sample_count: not a whole number"),
        ("epoch", "BEAM0101/ancillary/master_time_epoch: element 1 is needed, it has 0"),
        ("shots", "BEAM0101: 20000000 shots, at most 10000000"),
        ("kept", "more than 536870912 bytes of chunks; rewrite the file with smaller chunks: `h5repack"),
        ("no_waveforms", "a GEDI file whose beams have no waveforms; give a whole GEDI01_B file"),
        ("beams", "65 beams, at most 64; the file is damaged"),
        ("lvis_part", "an LVIS file without RXWAVE, SHOTNUMBER or Z0; give the level 1B file"),
        ("lvis_long", "RXWAVE: 70000 samples per shot, at most 65536"),
    ] {
        let found = first_error(&data(&format!("refused_{name}.h5")));
        assert!(found.contains(expected), "{name}: {found}");
    }
    // A data set that is no longer where the list of beams says.
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("changed.h5");
    fs::copy(data("gedi_bad_shots.h5"), &path).unwrap();
    let granule = Granule::open(&path).unwrap();
    let mut bytes = fs::read(&path).unwrap();
    let at = bytes.windows(15).position(|name| name == b"rx_sample_count").unwrap();
    bytes[at] = b'X';
    fs::write(&path, bytes).unwrap();
    assert!(
        granule.beam("BEAM0110").err().unwrap().to_string().contains("no data set BEAM0110/rx_sample_count")
    );
}

/// Replaces bytes in all blocks with a signature, or at the beginning if it is empty.
fn damaged(folder: &TempDir, name: &str, signature: &[u8], offset: usize, with: &[u8]) -> PathBuf {
    let mut bytes = fs::read(data(name)).unwrap();
    let starts: Vec<usize> = match signature {
        [] => vec![0],
        _ => (0..bytes.len() - signature.len()).filter(|&at| bytes[at..].starts_with(signature)).collect(),
    };
    assert!(!starts.is_empty(), "{name} has no {signature:?}");
    for start in starts {
        bytes[start + offset..][..with.len()].copy_from_slice(with);
    }
    let path = folder.path().join(name);
    fs::write(&path, bytes).unwrap();
    path
}

/// File, signature of the blocks, offset and value of the damage, expected part of the message.
type Case = (&'static str, &'static [u8], usize, &'static [u8], &'static str);

#[test]
fn damaged_structures_are_reported() {
    const FAR: &[u8] = &0x7fff_ffff_u64.to_le_bytes();
    let cases: &[Case] = &[
        ("gedi_product.h5", b"", 0, b"?", "not an HDF5 file; give a file of GEDI L1B or LVIS L1B"),
        (
            "gedi_product.h5",
            b"",
            0,
            b"LASF",
            "this is LAS, not HDF5; rename it to .las, and read it with the stage `read_las`",
        ),
        (
            "gedi_product.h5",
            b"",
            8,
            &[9],
            "byte 8: version of the superblock: version 9 is not supported; rewrite",
        ),
        (
            "gedi_product.h5",
            b"",
            13,
            &[4],
            "sizes of offsets and lengths: 4 and 8 bytes, only 8 are supported",
        ),
        ("gedi_product.h5", b"", 40, FAR, "bytes; copy it again from its source"),
        (
            "gedi_product.h5",
            b"",
            64,
            FAR,
            "object header: 16 bytes at this address are beyond the end of the file",
        ),
        ("gedi_product.h5", b"TREE", 0, b"F", "B-tree: the signature `TREE` is missing; the file is damaged"),
        ("gedi_product.h5", b"TREE", 4, &[7], "B-tree: a node of another tree or level"),
        ("gedi_product.h5", b"HEAP", 0, b"F", "local heap: the signature `HEAP` is missing"),
        ("gedi_product.h5", b"SNOD", 8, FAR, "name of a member: beyond the end of the heap"),
        ("gedi_latest.h5", b"OHDR", 0, b"F", "object header: neither version 1 nor 2"),
        ("gedi_latest.h5", b"OHDR", 4, &[9], "object header: unknown version"),
        ("gedi_latest.h5", b"BTHD", 5, &[9], "B-tree: unexpected type or sizes"),
        ("gedi_latest.h5", b"BTHD", 24, &[200], "node of a B-tree: more records than it can hold"),
        ("gedi_latest.h5", b"BTLF", 10, &[0x10], "a name of this length is not supported"),
        ("gedi_latest.h5", b"BTLF", 13, &[0xff], "bytes at this address are beyond the end of the file"),
        ("gedi_latest.h5", b"FRHP", 7, &[1], "fractal heap: compressed links are not supported"),
        ("gedi_latest.h5", b"FRHP", 110, &[0, 0], "fractal heap: impossible sizes of blocks"),
        ("gedi_latest.h5", b"FRHP", 132, &[0xff; 8], "the heap is empty"),
        ("many_links.h5", b"FHIB", 5, &[1], "a block of another heap"),
        ("many_links.h5", b"FHIB", 17, &[0xff; 8], "beyond the end of the heap"),
        ("gedi_v110.h5", b"FAHD", 6, &[3], "array of chunks: impossible sizes of entries"),
        ("gedi_extensible.h5", b"EAHD", 9, &[3], "extensible array: impossible sizes of blocks"),
        ("gedi_extensible.h5", b"EAIB", 0, b"F", "the signature `EAIB` is missing"),
        // The chunk at the beginning of a tree's node: its stored size.
        (
            "gedi_deep_tree.h5",
            b"TREE\x01\x00",
            24,
            &[0xff; 4],
            "bytes at this address are beyond the end of the file",
        ),
        ("gedi_deep_tree.h5", b"TREE\x01\x00", 24, &[0xff, 0x20, 0, 0], "larger than without compression"),
        // Chunk 1 gets the offset of chunk 0.
        ("gedi_deep_tree.h5", b"TREE\x01\x00", 64, &[0; 8], "chunk index: lists a chunk twice"),
        ("gedi_deep_tree.h5", b"TREE\x01\x00", 24, &[3, 0, 0, 0], "shorter than the chunk's size"),
        ("gedi_checksum.h5", b"TREE\x01\x00", 28, &[0; 4], "no error"),
    ];
    let folder = tempfile::tempdir().unwrap();
    for (name, signature, offset, with, expected) in cases {
        let found = first_error(&damaged(&folder, name, signature, *offset, with));
        assert!(found.contains(expected), "{name} {signature:?} {offset}: {found}");
    }
}

#[test]
fn a_cut_file_is_reported_with_its_length() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("cut.h5");
    let bytes = fs::read(data("gedi_product.h5")).unwrap();
    fs::write(&path, &bytes[..20_000]).unwrap();
    let expected = format!("cut off: 20000 of {} bytes; copy it again from its source", bytes.len());
    assert!(first_error(&path).contains(&expected));
    fs::write(&path, &bytes[..20]).unwrap();
    assert!(first_error(&path).contains("the file is cut off: copy it again from its source"));
}

#[test]
fn damaged_samples_are_an_error_of_their_shots() {
    let folder = tempfile::tempdir().unwrap();
    // Compressed data begin with 0x78; the checksum covers the stored bytes of a chunk.
    let sound = fs::read(data("gedi_shuffle_checksum.h5")).unwrap();
    let path = folder.path().join("damaged.h5");
    let streams = (0..sound.len() - 2)
        .filter(|&at| sound[at..].starts_with(&[0x78, 0x5e]) || sound[at..].starts_with(&[0x78, 0x9c]));
    let mut texts = Vec::new();
    for at in streams {
        let mut bytes = sound.clone();
        bytes[at + 10] ^= 0x55;
        fs::write(&path, bytes).unwrap();
        texts.push(first_error(&path));
    }
    let wrong_sum =
        |text: &&String| text.contains("rxwaveform: chunk") && text.contains("its checksum is wrong");
    assert_eq!(texts.iter().filter(wrong_sum).count(), 6, "{texts:#?}");
    assert!(
        texts
            .iter()
            .any(|text| text.contains("shot 2 of BEAM0101: BEAM0101/rxwaveform: chunk 1: its checksum"))
    );

    let sound = fs::read(data("gedi_product.h5")).unwrap();
    let at = sound.windows(2).position(|pair| pair == [0x78, 0x5e] || pair == [0x78, 0x9c]).unwrap();
    let mut bytes = sound;
    bytes[at] = 0;
    fs::write(&path, bytes).unwrap();
    let text = first_error(&path);
    assert!(
        text.contains("its compressed data are damaged") && text.contains(&format!("byte {at}")),
        "{text}"
    );
}

#[test]
fn circles_of_references_end() {
    let folder = tempfile::tempdir().unwrap();
    // The continuation of the first object header is the header's own messages.
    let mut bytes = fs::read(data("gedi_product.h5")).unwrap();
    let root = u64::from_le_bytes(bytes[64..72].try_into().unwrap()) as usize;
    let message = [0x10_u8, 0, 16, 0, 0, 0, 0, 0];
    bytes[root + 16..root + 24].copy_from_slice(&message);
    bytes[root + 24..root + 32].copy_from_slice(&(root as u64 + 16).to_le_bytes());
    bytes[root + 32..root + 40].copy_from_slice(&24_u64.to_le_bytes());
    let path = folder.path().join("circle.h5");
    fs::write(&path, &bytes).unwrap();
    let text = first_error(&path);
    assert!(text.contains("references form a circle"), "{text}");

    // Empty messages of four bytes, more than an object has.
    let mut bytes = fs::read(data("gedi_latest.h5")).unwrap();
    let header = bytes.len() as u64;
    bytes.extend_from_slice(b"OHDR\x02\x02");
    bytes.extend_from_slice(&280_000_u32.to_le_bytes());
    bytes.resize(bytes.len() + 280_004, 0);
    bytes[36..44].copy_from_slice(&header.to_le_bytes());
    fs::write(&path, &bytes).unwrap();
    let text = first_error(&path);
    assert!(text.contains("more than 65536 messages"), "{text}");
}

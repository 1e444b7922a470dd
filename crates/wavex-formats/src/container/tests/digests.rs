//! Digests: every changed bit is refused or changes nothing.

use std::fs::File;

use arrow_ipc::reader::{FileReader, StreamReader};

use super::*;

/// Returns the number of flipped bits, one in `step` bytes, that change the lines without an error.
fn silent_changes(whole: &[u8], step: usize, read: impl Fn(Vec<u8>) -> Result<Vec<Vec<Row>>>) -> usize {
    let expected = lines();
    let mut bytes = whole.to_vec();
    let mut silent = 0;
    for at in (0..whole.len()).step_by(step) {
        let bit = 1 << (at / step % 8);
        bytes[at] ^= bit;
        silent += usize::from(read(bytes.clone()).is_ok_and(|found| found != expected));
        bytes[at] ^= bit;
    }
    silent
}

#[test]
fn no_flipped_bit_changes_a_line_silently() {
    for (compression, step) in [(Compression::None, 1), (Compression::Lz4, 5), (Compression::Zstd, 7)] {
        let file = write(&lines(), true, compression);
        assert_eq!(silent_changes(&file, step, |bytes| read_file(&bytes)), 0, "{compression:?}, file");
        assert_eq!(silent_changes(&file, 3 * step, read_stream), 0, "{compression:?}, file from a pipe");
        let stream = write(&lines(), false, compression);
        assert_eq!(silent_changes(&stream, step, read_stream), 0, "{compression:?}, stream");
    }
    let old = without_digests(&lines(), true, Compression::None);
    assert!(silent_changes(&old, 3, |bytes| read_file(&bytes)) > 50, "flips change files without digests");
}

/// Flips a bit of the only occurrence of `text`.
fn damage(bytes: &mut [u8], text: &[u8]) {
    let found: Vec<usize> = (0..bytes.len()).filter(|&at| bytes[at..].starts_with(text)).collect();
    let [at] = found[..] else { panic!("{found:?}") };
    bytes[at] ^= 1;
}

#[test]
fn a_wrong_digest_is_reported_with_its_record_batch() {
    // `origin_m[2]` of shot 8, in the third record batch.
    let value = [0.25_f64.to_le_bytes(), 8.0_f64.to_le_bytes()].concat();
    for file in [true, false] {
        let mut bytes = write(&lines(), file, Compression::None);
        damage(&mut bytes, &value);
        let error = if file { read_file(&bytes) } else { read_stream(bytes) }.unwrap_err().to_string();
        let error = error.split_once(": byte ").unwrap().1;
        let (offset, error) = error.split_once(": ").unwrap();
        assert!(offset.parse::<u64>().unwrap() > 1000, "{offset}");
        assert!(error.starts_with("record batch 2: its digest is "), "{error}");
        assert!(error.contains(", but its bytes give "), "{error}");
        assert!(error.ends_with("; the file is damaged: copy it again from its source"), "{error}");
    }
}

/// A compressed sample is not unpacked by a fast pass; its digest is checked nevertheless.
#[test]
fn digests_are_checked_without_samples() {
    let mut bytes = write(&lines()[..1], true, Compression::None);
    damage(&mut bytes, &[2, 0, 3, 0, 6, 0, 11, 0, 18, 0, 27, 0, 2 + 14, 0]);
    let mut reader = ContainerReader::from_bytes(Path::new("a.arrow"), bytes).unwrap();
    reader.skip_samples();
    let error = reader.next_line().unwrap_err().to_string();
    assert!(error.contains("record batch 0: its digest is "), "{error}");
}

#[test]
fn damaged_metadata_of_the_recording_are_refused() {
    for (file, name) in [(true, "footer"), (false, "schema")] {
        let mut bytes = write(&lines(), file, Compression::None);
        let text = b"299707502";
        let last = (0..bytes.len()).rfind(|&at| bytes[at..].starts_with(text)).unwrap();
        bytes[last + 3] ^= 1;
        let error = if file { read_file(&bytes) } else { read_stream(bytes) }.unwrap_err().to_string();
        assert!(error.contains(&format!(": {name}: its digest is ")), "{error}");
    }
}

#[test]
fn a_missing_digest_is_refused() {
    for file in [true, false] {
        let mut bytes = write(&lines(), file, Compression::None);
        // The key in the second record batch.
        let keys: Vec<usize> =
            (0..bytes.len()).filter(|&at| bytes[at..].starts_with(b"wavex.digest")).collect();
        bytes[keys[2]] = b'W';
        let error = if file { read_file(&bytes) } else { read_stream(bytes) }.unwrap_err().to_string();
        let expected = "record batch 1: it has no digest, but the schema has one; the file is damaged";
        assert!(error.contains(expected), "{error}");
    }
}

#[test]
fn a_digest_of_another_length_is_refused_as_text() {
    let entries = |value: &str| {
        let mut builder = flatbuffers::FlatBufferBuilder::new();
        let key = Some(builder.create_string(super::super::digest::KEY));
        let value = Some(builder.create_string(value));
        let entry = arrow_ipc::KeyValue::create(&mut builder, &arrow_ipc::KeyValueArgs { key, value });
        let custom_metadata = Some(builder.create_vector(&[entry]));
        let args = arrow_ipc::MessageArgs { custom_metadata, ..Default::default() };
        let root = arrow_ipc::Message::create(&mut builder, &args);
        builder.finish(root, None);
        builder.finished_data().to_vec()
    };
    let bytes = entries("\u{1b}[2J");
    let message = arrow_ipc::root_as_message(&bytes).unwrap();
    let location = location::ContainerLocation { file: Path::new("a"), offset: 0, first_row: 0 };
    let error = digest::check(&bytes, &[], message.custom_metadata(), "schema", location).unwrap_err();
    assert!(error.to_string().contains("its digest is \\u{1b}[2J, but"), "{error}");
}

/// Readers of Arrow ignore the digests.
#[test]
fn containers_are_read_by_arrow() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.arrow");
    for compression in ALL {
        std::fs::write(&path, write(&lines(), true, compression)).unwrap();
        let file = FileReader::try_new(File::open(&path).unwrap(), None).unwrap();
        assert_eq!(file.map(|batch| batch.unwrap().num_rows()).collect::<Vec<_>>(), [5, 0, 4]);
        let stream = write(&lines(), false, compression);
        let stream = StreamReader::try_new(Cursor::new(stream), None).unwrap();
        assert_eq!(stream.map(|batch| batch.unwrap().num_rows()).collect::<Vec<_>>(), [5, 0, 4]);
    }
}

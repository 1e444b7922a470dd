//! Numbers that lie: each is refused with words that say which.

use super::*;

/// Changes the one place where `from` stands.
fn patch(bytes: &mut [u8], from: &[u8], to: &[u8]) {
    let found: Vec<usize> =
        (0..=bytes.len() - from.len()).filter(|&at| bytes[at..].starts_with(from)).collect();
    assert_eq!(found.len(), 1, "{found:?}");
    bytes[found[0]..][..to.len()].copy_from_slice(to);
}

fn words(numbers: &[i32]) -> Vec<u8> {
    numbers.iter().flat_map(|number| number.to_le_bytes()).collect()
}

#[test]
fn a_list_that_points_outside_is_named_by_its_row() {
    let whole = write(&lines()[..1], false, Compression::None);
    // The samples of the six blocks of shots 0, 2, 2, 3, 3, 4 of the first line.
    let ends = [0, 6, 12, 34, 40, 63, 69];
    for (at, value, words_of, row) in [
        (6, 70, "a list from 63 to 70 of 69 items", 4),
        (3, 99, "a list from 12 to 99 of 69 items", 2),
        (3, -1, "a list from 12 to -1 of 69 items", 2),
        (4, 33, "a list from 34 to 33 of 69 items", 3),
    ] {
        let mut changed = ends;
        changed[at] = value;
        let mut bytes = whole.clone();
        patch(&mut bytes, &words(&ends), &words(&changed));
        let error = complaint(bytes);
        let expected = format!("column `blocks.samples`, row {row}: {words_of}; the file is damaged");
        assert!(error.contains(&expected), "{error}");
    }
    // The blocks of the rows.
    let mut bytes = whole;
    patch(&mut bytes, &words(&[0, 1, 1, 3, 5, 6]), &words(&[0, 1, 1, 3, 7, 6]));
    let error = complaint(bytes);
    assert!(error.contains("column `blocks`, row 3: a list from 3 to 7 of 6 items"), "{error}");
}

#[test]
fn a_row_is_counted_through_the_whole_container() {
    let mut bytes = write(&lines(), true, Compression::None);
    // The online returns of shots 5 to 8.
    patch(&mut bytes, &words(&[0, 2, 2, 3, 5]), &words(&[0, 2, 2, 6, 5]));
    let error = read_file(&bytes).unwrap_err().to_string();
    assert!(error.contains("column `online`, row 7: a list from 2 to 6 of 5 items"), "{error}");
}

/// A buffer's entry in the metadata of a record batch: where it is, and how long.
fn entry(offset: i64, length: i64) -> Vec<u8> {
    [offset.to_le_bytes(), length.to_le_bytes()].concat()
}

#[test]
fn lengths_of_buffers_that_lie_are_refused() {
    // The first column, of five rows, stands at the beginning of the body, and has no bitmap.
    let whole = write(&lines()[..1], false, Compression::None);
    let shot = entry(0, 40);
    for (lie, problem) in [
        (entry(0, 39), "column `shot`: a buffer of 39 bytes, where 40 are needed"),
        (entry(0, -1), "column `shot`: a buffer of -1 bytes at byte 0 of a body of"),
        (entry(-64, 40), "column `shot`: a buffer of 40 bytes at byte -64 of a body of"),
        (entry(0, 1 << 40), "column `shot`: a buffer of 1099511627776 bytes at byte 0 of a body of"),
        (entry(i64::MAX, 40), "column `shot`: a buffer of 40 bytes at byte 9223372036854775807 of a body of"),
    ] {
        let mut bytes = whole.clone();
        patch(&mut bytes, &shot, &lie);
        let error = complaint(bytes);
        assert!(error.contains(problem), "{error}");
    }
}

#[test]
fn offsets_that_are_no_whole_number_of_words_are_refused() {
    let whole = write(&lines()[..1], false, Compression::None);
    let at = whole.windows(28).position(|window| window == words(&[0, 6, 12, 34, 40, 63, 69])).unwrap();
    // The body starts behind the second message's metadata; the entry is the one of 28 bytes.
    let entries: Vec<usize> = (0..whole.len() - 16)
        .filter(|&i| i64::from_le_bytes(*whole[i + 8..].first_chunk().unwrap()) == 28)
        .filter(|&i| (0..at as i64).contains(&i64::from_le_bytes(*whole[i..].first_chunk().unwrap())))
        .collect();
    assert_eq!(entries.len(), 1, "{entries:?}");
    let mut bytes = whole;
    bytes[entries[0] + 8] = 29;
    let error = complaint(bytes);
    assert!(
        error.contains("column `blocks.samples`: offsets of 29 bytes, which is no multiple of 4"),
        "{error}"
    );
}

#[test]
fn what_a_buffer_is_said_to_unpack_to_must_be_possible() {
    for (compression, most) in [(Compression::Lz4, "255"), (Compression::Zstd, "32768")] {
        // 4000 samples of one value: 8000 bytes that pack well.
        let mut long = row(0, 0);
        long.blocks = vec![(channel::LOW_POWER, 0.0, None, None, vec![3; 4000])];
        let whole = write(&[vec![long]], false, compression);
        for (size, problem) in [
            (1_i64 << 60, "are said to unpack to 1152921504606846976"),
            (-2, "are said to unpack to -2"),
            (100_000, "a buffer that unpacks to 100000 bytes, where 8000 are needed"),
            (7998, "a buffer of 7998 bytes, where 8000 are needed"),
        ] {
            let mut bytes = whole.clone();
            patch(&mut bytes, &8000_i64.to_le_bytes(), &size.to_le_bytes());
            let error = complaint(bytes);
            let lz4_says = size == 100_000 && compression == Compression::Lz4;
            let problem = if lz4_says { "are said to unpack to 100000" } else { problem };
            assert!(error.contains("column `blocks.samples`: "), "{most}: {error}");
            assert!(error.contains(problem), "{most}: {error}");
        }
        // One that is possible but not true is found while unpacking.
        let mut bytes = whole.clone();
        patch(&mut bytes, &8000_i64.to_le_bytes(), &8002_i64.to_le_bytes());
        let error = complaint(bytes);
        assert!(error.contains("column `blocks`, rows 0 to 0: "), "{most}: {error}");
    }
}

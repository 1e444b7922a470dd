use std::sync::Arc;

use arrow_array::{ArrayRef, Float64Array, RecordBatch, UInt32Array};
use arrow_schema::Schema;
use parquet::basic::Compression;
use parquet::file::properties::WriterProperties;

use super::*;

/// First difference between two contents of a file of this name.
fn between(name: &str, then: &[u8], now: &[u8]) -> String {
    let folder = tempfile::tempdir().unwrap();
    let path = |age: &str, content: &[u8]| {
        let path = folder.path().join(format!("{age}_{name}"));
        std::fs::write(&path, content).unwrap();
        path
    };
    first_difference(&path("then", then), &path("now", now))
}

#[test]
fn texts_differ_in_a_line() {
    assert_eq!(between("a.txt", b"a\nb\nc\n", b"a\nB\nc\n"), "line 2: \"B\" instead of \"b\"");
    assert_eq!(between("a.txt", b"a\nb\n", b"a\n"), "it ends before line 2");
    assert_eq!(between("a.json", b"a\n", b"a\nb"), "it continues with line 2");
    assert_eq!(between("a.txt", b"a\n", b"a"), "it ends before byte 1", "where no line differs, a byte does");
    let long = "x".repeat(200);
    assert_eq!(
        between("a.txt", b"y", long.as_bytes()).len(),
        "line 1: ".len() + LONGEST + "... instead of \"y\"".len()
    );
}

#[test]
fn tables_of_text_differ_in_a_row_and_a_column() {
    let then = b"shot,range_m\n1,2.5\n2,3.5\n";
    assert_eq!(
        between("a.csv", then, b"shot,range_m\n1,2.5\n2,3.75\n"),
        "row 1, column range_m: 3.75 instead of 3.5"
    );
    assert_eq!(
        between("a.csv", then, b"shot,range_m\n1,\n2,3.5\n"),
        "row 0, column range_m: nothing instead of 2.5"
    );
    assert_eq!(
        between("a.csv", then, b"shot,range\n1,2.5\n"),
        "line 1: \"shot,range\" instead of \"shot,range_m\""
    );
    assert_eq!(between("a.csv", then, b"shot,range_m\n1,2,5\n"), "line 2: \"1,2,5\" instead of \"1,2.5\"");
}

#[test]
fn other_files_differ_in_a_byte() {
    assert_eq!(between("a.bin", b"abc", b"abd"), "byte 2: 100 instead of 99");
    assert_eq!(between("a.bin", b"abc", b"ab"), "it ends before byte 2");
    assert_eq!(between("a.bin", b"abc", b"abc"), "no byte differs");
    let damaged = between("a.laz", b"abc", b"abd");
    assert!(damaged.starts_with("byte 2: 100 instead of 99 ("), "{damaged}");
}

fn batch(shots: &[u32], ranges_m: &[Option<f64>], key: &str) -> RecordBatch {
    let columns: [(&str, ArrayRef); 2] = [
        ("shot", Arc::new(UInt32Array::from(shots.to_vec()))),
        ("range_m", Arc::new(Float64Array::from(ranges_m.to_vec()))),
    ];
    let batch =
        RecordBatch::try_from_iter_with_nullable(columns.map(|(name, column)| (name, column, true))).unwrap();
    let metadata = std::collections::HashMap::from([("key".to_owned(), key.to_owned())]);
    let schema = Schema::clone(&batch.schema()).with_metadata(metadata);
    batch.with_schema(Arc::new(schema)).unwrap()
}

fn arrow(batches: &[RecordBatch]) -> Vec<u8> {
    let mut writer = arrow_ipc::writer::FileWriter::try_new(Vec::new(), &batches[0].schema()).unwrap();
    batches.iter().for_each(|batch| writer.write(batch).unwrap());
    writer.into_inner().unwrap()
}

fn parquet(batches: &[RecordBatch]) -> Vec<u8> {
    parquet_of(batches, Compression::UNCOMPRESSED)
}

fn parquet_of(batches: &[RecordBatch], compression: Compression) -> Vec<u8> {
    let mut bytes = Vec::new();
    let properties = Some(WriterProperties::builder().set_compression(compression).build());
    let mut writer =
        parquet::arrow::ArrowWriter::try_new(&mut bytes, batches[0].schema(), properties).unwrap();
    batches.iter().for_each(|batch| writer.write(batch).unwrap());
    writer.close().unwrap();
    bytes
}

#[test]
fn tables_of_arrow_and_parquet_differ_in_a_row_and_a_column() {
    let first = batch(&[1, 2, 3], &[Some(1.5), None, Some(f64::NAN)], "a");
    let second = batch(&[4, 5], &[Some(4.0), Some(5.0)], "a");
    let then = [first.clone(), second.clone()];
    let cases = [
        (
            vec![first.clone(), batch(&[4, 5], &[Some(4.0), Some(5.5)], "a")],
            "row 4, column range_m: 5.5 instead of 5.0",
        ),
        (
            vec![batch(&[1, 2, 7], &[Some(1.5), Some(0.5), None], "a"), second],
            "row 1, column range_m: 0.5 instead of null",
        ),
        (vec![first], "it ends before row 3"),
        (
            vec![batch(&[1, 2, 3, 4, 5], &[Some(1.5), None, Some(f64::NAN), Some(4.0), Some(5.0)], "b")],
            "metadata, key key",
        ),
    ];
    for (now, expected) in cases {
        assert_eq!(between("a.arrow", &arrow(&then), &arrow(&now)), expected);
        let found = between("a.parquet", &parquet(&then), &parquet(&now));
        // Parquet also stores the whole Arrow schema in its metadata.
        assert!(
            found == expected || (expected.starts_with("metadata") && found.starts_with("metadata, key ")),
            "{found}"
        );
    }
    let other = RecordBatch::try_from_iter([("shot", then[0].column(0).clone())]).unwrap();
    let found = between("a.arrow", &arrow(&then), &arrow(&[other]));
    assert!(
        found.starts_with(
            "it has the columns shot UInt32 instead of the columns shot UInt32, range_m Float64"
        ),
        "{found}"
    );
}

/// Other programs use other compression methods and other column metadata.
#[test]
fn a_table_that_another_program_has_saved_is_compared_by_its_values() {
    let zstd = Compression::ZSTD(Default::default());
    let then = parquet_of(&[batch(&[1, 2, 3], &[Some(1.5), None, Some(2.0)], "a")], zstd);
    let resaved =
        |ranges_m: &[Option<f64>]| parquet_of(&[batch(&[1, 2, 3], ranges_m, "a")], Compression::SNAPPY);
    let changed = resaved(&[Some(1.5), Some(87.0), Some(2.0)]);
    assert_eq!(between("a.parquet", &then, &changed), "row 1, column range_m: 87.0 instead of null");
    let same = resaved(&[Some(1.5), None, Some(2.0)]);
    let found = between("a.parquet", &then, &same);
    assert!(found.starts_with("byte "), "where no value differs, a byte does: {found}");
    let arrow_of = |nullable: bool| {
        let batch = batch(&[1], &[Some(1.0)], "a");
        let fields: Vec<_> = batch
            .schema()
            .fields()
            .iter()
            .map(|field| field.as_ref().clone().with_nullable(nullable))
            .collect();
        let schema = Arc::new(Schema::new_with_metadata(fields, batch.schema().metadata().clone()));
        arrow(&[RecordBatch::try_new(schema, batch.columns().to_vec()).unwrap()])
    };
    let found = between("a.arrow", &arrow_of(true), &arrow_of(false));
    assert_eq!(found, "schema of the column shot");
}

#[test]
fn a_table_compressed_in_an_unknown_way_says_so_with_a_remedy() {
    let error = parquet::errors::ParquetError::General("Disabled feature at compile time: flate2".into());
    let said = tables::unreadable(Path::new("a.parquet"), &error).to_string();
    let expected = "a.parquet: its compression method is not supported by wavex: rows are not compared; save it \
                    with zstd, snappy or no compression and compare again";
    assert_eq!(said, expected);
}

#[test]
fn a_table_that_was_cut_off_is_compared_by_its_bytes() {
    let whole = batch(&[1, 2], &[Some(1.0), Some(2.0)], "a");
    for (name, bytes) in [("a.arrow", arrow(std::slice::from_ref(&whole))), ("a.parquet", parquet(&[whole]))]
    {
        let cut = &bytes[..bytes.len() / 2];
        let found = between(name, cut, &bytes);
        assert!(found.starts_with(&format!("it continues with byte {} (", cut.len())), "{found}");
    }
}

//! Record batches as other programs may write them.

use std::collections::BTreeMap;
use std::sync::Arc;

use arrow_array::types::Int8Type;
use arrow_array::{
    Array, ArrayRef, DictionaryArray, Float64Array, Int32Array, Int64Array, LargeListArray, ListArray,
    RecordBatch, StringArray, StringViewArray, StructArray, UInt16Array, UInt64Array, UnionArray,
};
use arrow_buffer::{NullBuffer, OffsetBuffer, ScalarBuffer};
use arrow_ipc::writer::{FileWriter, StreamWriter};
use arrow_schema::{DataType, Field, Fields, Schema, SchemaRef, UnionFields};

use super::*;

/// Returns the columns of the first line of [`lines`] by index.
fn columns() -> BTreeMap<usize, (Field, ArrayRef)> {
    let schema: SchemaRef =
        Arc::new(layout::schema(header().to_metadata(), layout::LayoutOptions::default()));
    let batch = builder(&lines()[0]).finish(schema.clone()).unwrap();
    let fields = schema.fields().iter().map(|field| field.as_ref().clone());
    fields.zip(batch.columns().to_vec()).enumerate().collect()
}

fn position(name: &str) -> usize {
    layout::COLUMNS.iter().position(|column| column.name == name).unwrap()
}

fn written(columns: BTreeMap<usize, (Field, ArrayRef)>) -> Vec<u8> {
    let (fields, arrays): (Vec<Field>, Vec<ArrayRef>) = columns.into_values().unzip();
    let schema = Arc::new(Schema::new_with_metadata(fields, header().to_metadata()));
    let batch = RecordBatch::try_new(schema.clone(), arrays).unwrap();
    let mut writer = StreamWriter::try_new(Vec::new(), &schema).unwrap();
    writer.write(&batch).unwrap();
    writer.into_inner().unwrap()
}

/// Returns a stream of the first line with one column replaced.
fn with_column(name: &str, array: ArrayRef) -> Vec<u8> {
    let mut columns = columns();
    let field = Field::new(name, array.data_type().clone(), true);
    columns.insert(position(name), (field, array));
    written(columns)
}

#[test]
fn missing_columns_are_reported() {
    for column in layout::COLUMNS {
        let mut columns = columns();
        columns.remove(&position(column.name));
        let result = read_stream(written(columns));
        if column.required {
            let error = result.unwrap_err().to_string();
            let expected = format!(
                "-: byte 0: column `{}`: there is no such column, a {} is expected; \
                 write it as schemas/container.json says",
                column.name,
                column.kind.name()
            );
            assert_eq!(error, expected);
        } else {
            assert_eq!(result.unwrap()[0].len(), 5, "{} is optional", column.name);
        }
    }
}

#[test]
fn wrong_types_are_reported() {
    let shots = Arc::new(Int32Array::from(vec![0, 1, 2, 3, 4]));
    assert_eq!(
        refusal(with_column("shot", shots)),
        "byte 0: column `shot`: the type is Int32 and should be u64; cast it before writing the container"
    );
    let column = |name: &'static str, list: ArrayRef| {
        let DataType::List(item) = columns()[&position("blocks")].0.data_type().clone() else { panic!() };
        let rows = columns()[&position("blocks")].1.as_any().downcast_ref::<ListArray>().unwrap().clone();
        let structs = rows.values().as_any().downcast_ref::<StructArray>().unwrap().clone();
        let (fields, mut arrays, _) = structs.into_parts();
        let at = fields.iter().position(|field| field.name() == name).unwrap();
        let mut fields: Vec<Field> = fields.iter().map(|field| field.as_ref().clone()).collect();
        fields[at] = Field::new(name, list.data_type().clone(), true);
        arrays[at] = list;
        let structs = StructArray::try_new(Fields::from(fields), arrays, None).unwrap();
        let item = Arc::new(Field::new(item.name(), structs.data_type().clone(), true));
        Arc::new(ListArray::try_new(item, rows.offsets().clone(), Arc::new(structs), None).unwrap())
    };
    let blocks = column("start_ns", Arc::new(Int32Array::from(vec![0; 6])));
    assert_eq!(
        refusal(with_column("blocks", blocks)),
        "byte 0: column `blocks.start_ns`: the type is Int32 and should be f64; \
         cast it before writing the container"
    );
    // The reference blocks of shots 0, 2, 3 and 4, and the low-power blocks of 2 and 3.
    let starts = vec![Some(0.0), Some(0.0), Some(0.0), Some(0.0), None, Some(0.0)];
    let blocks = column("start_ns", Arc::new(Float64Array::from(starts)));
    let error = refusal(with_column("blocks", blocks));
    assert!(
        error.ends_with(
            "column `blocks.start_ns`, row 3: a null, where none may be; fill it or leave the row out"
        ),
        "{error}"
    );
    let blocks = column("zone", Arc::new(Int32Array::from(vec![0; 6])));
    let error = refusal(with_column("blocks", blocks));
    assert!(error.contains("column `blocks.zone`: the type is Int32 and should be i16"), "{error}");
}

/// Replaces all lists by large lists.
fn large(array: &ArrayRef) -> ArrayRef {
    if let Some(lists) = array.as_any().downcast_ref::<ListArray>() {
        let (_, offsets, values, nulls) = lists.clone().into_parts();
        let values = large(&values);
        let item = Arc::new(Field::new("item", values.data_type().clone(), true));
        let offsets: Vec<i64> = offsets.iter().map(|&offset| offset.into()).collect();
        return Arc::new(LargeListArray::new(item, OffsetBuffer::new(offsets.into()), values, nulls));
    }
    let Some(structs) = array.as_any().downcast_ref::<StructArray>() else { return array.clone() };
    let (fields, arrays, nulls) = structs.clone().into_parts();
    let arrays: Vec<ArrayRef> = arrays.iter().map(large).collect();
    let field =
        |(field, array): (&Arc<Field>, &ArrayRef)| Field::new(field.name(), array.data_type().clone(), true);
    let fields: Fields = fields.iter().zip(&arrays).map(field).collect();
    Arc::new(StructArray::new(fields, arrays, nulls))
}

#[test]
fn large_lists_and_signed_shot_numbers_are_read() {
    let mut columns = columns();
    let signed: ArrayRef = Arc::new(Int64Array::from(vec![0, 1, 2, 3, 4]));
    columns.get_mut(&position("shot")).unwrap().1 = signed;
    for (field, array) in columns.values_mut() {
        *array = large(array);
        *field = Field::new(field.name(), array.data_type().clone(), true);
    }
    assert_eq!(read_stream(written(columns)).unwrap(), lines()[..1]);
    let error = refusal(with_column("shot", Arc::new(Int64Array::from(vec![0, 1, -2, 3, 4]))));
    assert!(error.ends_with("column `shot`, row 2: a negative number; number shots from 0"), "{error}");
}

#[test]
fn nulls_are_reported_with_column_and_row() {
    let shots = UInt64Array::from(vec![Some(0), Some(1), Some(2), None, None]);
    let error = refusal(with_column("shot", Arc::new(shots)));
    assert!(
        error.ends_with("column `shot`, row 3: a null, where none may be; fill it or leave the row out"),
        "{error}"
    );

    let nulls = || Some(NullBuffer::from(vec![true, true, false, true, true]));
    let item = Arc::new(Field::new("item", DataType::Float64, true));
    let values: ArrayRef = Arc::new(Float64Array::from(vec![0.0; 15]));
    let triples = arrow_array::FixedSizeListArray::new(item.clone(), 3, values, nulls());
    let error = refusal(with_column("origin", Arc::new(triples)));
    assert!(error.contains("column `origin`, row 2: a null"), "{error}");

    let values: Float64Array = (0..15).map(|i| (i != 13).then_some(0.5)).collect();
    let triples = arrow_array::FixedSizeListArray::new(item, 3, Arc::new(values), None);
    let error = refusal(with_column("direction", Arc::new(triples)));
    assert!(error.contains("column `direction`, row 4: a null"), "{error}");

    let blocks = columns()[&position("blocks")].1.as_any().downcast_ref::<ListArray>().unwrap().clone();
    let (item, offsets, values, _) = blocks.into_parts();
    let blocks = ListArray::new(item, offsets, values, nulls());
    let error = refusal(with_column("blocks", Arc::new(blocks)));
    assert!(error.contains("column `blocks`, row 2: a null"), "{error}");
}

#[test]
fn a_null_sample_is_reported_with_its_row() {
    let blocks = columns()[&position("blocks")].1.as_any().downcast_ref::<ListArray>().unwrap().clone();
    let (_, offsets, structs, _) = blocks.into_parts();
    let structs = structs.as_any().downcast_ref::<StructArray>().unwrap().clone();
    let (fields, mut arrays, _) = structs.into_parts();
    let samples = arrays[2].as_any().downcast_ref::<ListArray>().unwrap().clone();
    let (_, of_blocks, values, _) = samples.into_parts();
    let values = values.as_any().downcast_ref::<UInt16Array>().unwrap().clone();
    // Shot 0 has 6 samples; of shot 2 the reference block ends at 12 and the other at 34.
    let values: UInt16Array = (0..values.len()).map(|i| (i != 20).then(|| values.value(i))).collect();
    let item = Arc::new(Field::new("item", DataType::UInt16, true));
    arrays[2] = Arc::new(ListArray::new(item, of_blocks, Arc::new(values), None));
    let mut fields: Vec<Field> = fields.iter().map(|field| field.as_ref().clone()).collect();
    fields[2] = Field::new("samples", arrays[2].data_type().clone(), true);
    let structs = StructArray::new(Fields::from(fields), arrays, None);
    let item = Arc::new(Field::new("element", structs.data_type().clone(), true));
    let blocks = ListArray::new(item, offsets, Arc::new(structs), None);
    let error = refusal(with_column("blocks", Arc::new(blocks)));
    assert!(error.contains("column `blocks.samples`, row 2: a null"), "{error}");
}

#[test]
fn unknown_columns_of_any_type_are_ignored() {
    let text: ArrayRef = Arc::new(StringArray::from(vec!["a", "b", "c", "d", "e"]));
    let view: ArrayRef =
        Arc::new(StringViewArray::from(vec!["a", "b", "c", "d", "longer than twelve bytes"]));
    let names: DictionaryArray<Int8Type> = vec!["a", "b", "a", "b", "a"].into_iter().collect();
    let union = UnionArray::try_new(
        UnionFields::from_fields([Field::new("a", DataType::Int32, false)]),
        ScalarBuffer::from(vec![0_i8; 5]),
        None,
        vec![Arc::new(Int32Array::from(vec![1; 5]))],
    )
    .unwrap();
    let nothing: ArrayRef = Arc::new(arrow_array::NullArray::new(5));
    let blocks = columns()[&position("blocks")].1.clone();
    let extra = [text, view, Arc::new(names), Arc::new(union), nothing, blocks];
    let mut columns: Vec<(Field, ArrayRef)> = columns().into_values().collect();
    for (index, array) in extra.into_iter().enumerate() {
        // Before, between and after the known ones.
        let field = Field::new(format!("extra{index}"), array.data_type().clone(), true);
        columns.insert(index * 3, (field, array));
    }
    let columns: BTreeMap<usize, (Field, ArrayRef)> = columns.into_iter().enumerate().collect();
    assert_eq!(read_stream(written(columns.clone())).unwrap(), lines()[..1]);

    let (fields, arrays): (Vec<Field>, Vec<ArrayRef>) = columns.into_values().unzip();
    let schema = Arc::new(Schema::new_with_metadata(fields, header().to_metadata()));
    let batch = RecordBatch::try_new(schema.clone(), arrays).unwrap();
    let mut writer = FileWriter::try_new(Vec::new(), &schema).unwrap();
    writer.write(&batch).unwrap();
    assert_eq!(read_file(&writer.into_inner().unwrap()).unwrap(), lines()[..1]);
}

/// Returns `blocks` with an additional field.
fn with_inner_field(array: ArrayRef) -> Vec<u8> {
    let blocks = columns()[&position("blocks")].1.as_any().downcast_ref::<ListArray>().unwrap().clone();
    let (_, offsets, structs, _) = blocks.into_parts();
    let (fields, mut arrays, _) =
        structs.as_any().downcast_ref::<StructArray>().unwrap().clone().into_parts();
    let mut fields: Vec<Field> = fields.iter().map(|field| field.as_ref().clone()).collect();
    fields.insert(1, Field::new("gate", array.data_type().clone(), true));
    arrays.insert(1, array);
    let structs = StructArray::new(Fields::from(fields), arrays, None);
    let item = Arc::new(Field::new("item", structs.data_type().clone(), true));
    with_column("blocks", Arc::new(ListArray::new(item, offsets, Arc::new(structs), None)))
}

#[test]
fn unknown_fields_of_blocks_are_ignored_if_possible() {
    let gates = Arc::new(StringArray::from(vec!["a", "b", "c", "d", "e", "f"]));
    assert_eq!(read_stream(with_inner_field(gates)).unwrap(), lines()[..1]);
    let gates: DictionaryArray<Int8Type> = vec!["a", "b", "a", "b", "a", "b"].into_iter().collect();
    let error = refusal(with_inner_field(Arc::new(gates)));
    assert!(
        error.contains("column `blocks.gate`: a list cannot be passed over that holds a Dictionary"),
        "{error}"
    );
}

/// Creates the row of shot `n` as `tests/python/read_container.py` does.
fn python_row(n: u64) -> Row {
    let x = n as f64;
    let samples = |count: u64, step: u64| (0..count).map(|i| (step * n + i) as u16).collect();
    let (interval_ns, zone) = ((n == 3).then_some(0.5), (n == 6).then_some(1));
    Row {
        shot: ContainerShot {
            shot: n,
            line: (n / 4) as u32,
            gps_time_s: (n % 5 != 4).then_some(1000.0 + x / 2.0),
            clock_ps: n as i64 * 2_500_000,
            origin_m: [x, 2.0 * x, 3.0 * x],
            direction: [0.6, 0.0, -0.8],
            facet: (n % 4) as u16,
            flags: 1,
            mta_zone: (n % 2 == 1).then_some(2),
            scan_angle_deg: (n > 0).then_some(n as f32 - 6.0),
            frame_scale: (n == 7).then_some(0.9996),
        },
        blocks: vec![
            (channel::REFERENCE, 0.25, None, None, samples(6, 1)),
            (channel::LOW_POWER, 100.0 + x, interval_ns, zone, samples(8 + n, 10)),
        ],
        online: (0..n % 3).map(|i| ContainerOnline { time_ns: 100.0 + i as f64, amplitude: 1.5 }).collect(),
    }
}

/// Written by pyarrow 26 with `tests/python/read_container.py --write`.
///
/// All fields are nullable, and the first column is an unknown dictionary.
#[test]
fn containers_of_pyarrow_are_read() {
    let file = include_bytes!("pyarrow_zstd.arrow");
    let stream = include_bytes!("pyarrow_lz4.arrows");
    let expected: Vec<Vec<Row>> =
        (0..3).map(|line| (4 * line..4 * line + 4).map(python_row).collect()).collect();
    assert_eq!(read_file(file).unwrap(), expected);
    assert_eq!(read_stream(file.to_vec()).unwrap(), expected);
    assert_eq!(read_file(stream).unwrap(), expected);
    assert_eq!(read_stream(stream.to_vec()).unwrap(), expected);
}

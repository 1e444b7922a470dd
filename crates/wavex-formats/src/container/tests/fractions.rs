//! Version 2: samples that are fractions of a digitiser step.

use std::sync::Arc;

use arrow_array::{ArrayRef, Int32Array, LargeStringArray, RecordBatch, StringArray, StringViewArray};
use arrow_ipc::CompressionType;
use arrow_ipc::writer::{FileWriter, IpcWriteOptions};
use arrow_schema::{Field, Fields, Schema};

use super::*;

/// Samples of a block; the second row has whole steps and the third none.
const SAMPLES: &[f32] = &[0.25, f32::NAN, -1e30, f32::INFINITY, 3.0];
const STEPS: &[u16] = &[7, 65_535];

fn of_fractions() -> ContainerHeader {
    ContainerHeader { has_fractions: true, ..header() }
}

fn block(samples: &[u16]) -> ContainerBlock<'_> {
    let (channel, start_ns) = (channel::LOW_POWER, 0.5);
    ContainerBlock { channel, start_ns, interval_ns: None, zone: Some(2), gain: None, samples }
}

fn footprint() -> ContainerFootprint<'static> {
    ContainerFootprint {
        beam: Some("BEAM0101"),
        shot_number: Some(u64::MAX),
        noise_mean_dn: Some(0.1 + 0.2),
        noise_sd_dn: Some(4.5),
        is_advised_against: true,
    }
}

/// Three rows, of which the second has a footprint.
fn line() -> LineBuilder {
    let mut line = LineBuilder::new();
    line.block_of_fractions(&block(&[]), SAMPLES);
    line.footprint(&footprint());
    for shot in 0..3 {
        line.shot(&row(shot, 0).shot);
        match shot {
            0 => line.block_of_fractions(&block(&[]), SAMPLES),
            1 => {
                line.block(&block(STEPS));
                line.footprint(&footprint());
            }
            _ => {}
        }
    }
    line
}

fn written(header: &ContainerHeader, compression: Compression) -> Result<Vec<u8>> {
    let mut writer = ContainerWriter::file(Vec::new(), Path::new("made.arrow"), header, compression)?;
    writer.write(line())?;
    writer.finish()
}

fn first_line(bytes: Vec<u8>) -> Result<ContainerLine> {
    let mut reader = ContainerReader::from_bytes(Path::new("a.arrow"), bytes)?;
    assert!(reader.header().has_fractions);
    Ok(reader.next_line()?.unwrap())
}

#[test]
fn fractions_keep_their_bits() {
    for compression in ALL {
        let line = first_line(written(&of_fractions(), compression).unwrap()).unwrap();
        let bits = |row: usize| -> Vec<Vec<u32>> {
            line.fractions(row).map(|samples| samples.iter().map(|dn| dn.to_bits()).collect()).collect()
        };
        let expected = |samples: &[f32]| vec![samples.iter().map(|dn| dn.to_bits()).collect::<Vec<u32>>()];
        assert_eq!(bits(0), expected(SAMPLES), "{compression:?}");
        assert_eq!(bits(1), expected(&[7.0, 65_535.0]), "whole steps are fractions, too");
        assert_eq!(bits(2), Vec::<Vec<u32>>::new());
        let first = line.blocks(0).next().unwrap();
        assert_eq!((first.samples, first.start_ns, first.zone), (&[][..], 0.5, Some(2)));
        assert_eq!(
            [0, 1, 2].map(|row| line.footprint(row)),
            [ContainerFootprint::default(), footprint(), ContainerFootprint::default()]
        );
    }
}

#[test]
fn whole_steps_have_neither_fractions_nor_footprints() {
    let bytes = write(&lines(), true, Compression::None);
    let mut reader = ContainerReader::from_bytes(Path::new("a.arrow"), bytes).unwrap();
    assert_eq!(reader.header().version(), "1");
    let line = reader.next_line().unwrap().unwrap();
    assert!(line.fractions(2).len() == 2 && line.fractions(2).all(<[f32]>::is_empty));
    assert_eq!(line.footprint(2), ContainerFootprint::default());
}

#[test]
fn fractions_are_not_rounded_to_version_1() {
    let error = written(&header(), Compression::None).unwrap_err().to_string();
    let expected = "samples are fractions of a digitiser step, but the container header declares whole steps";
    assert!(error.contains(expected), "{error}");
}

/// A version with the samples of the other is refused before any is read.
#[test]
fn each_version_has_its_type() {
    for (version, other, has, needs) in [("2", "1", "Float32", "u16"), ("1", "2", "UInt16", "f32")] {
        let mut bytes = match version {
            "2" => {
                let name = Path::new("made.arrow");
                let mut writer = ContainerWriter::begin(
                    Vec::new(),
                    name,
                    &of_fractions(),
                    Compression::None,
                    (false, false),
                )
                .unwrap();
                writer.write(line()).unwrap();
                writer.finish().unwrap()
            }
            _ => without_digests(&lines(), false, Compression::None),
        };
        let key = b"wavex.container";
        let at = (0..bytes.len()).find(|&at| bytes[at..].starts_with(key)).unwrap();
        // The value is a string of its length and one character, near its key.
        let value = [1, 0, 0, 0, version.as_bytes()[0], 0];
        let near = at.saturating_sub(64)..at + 64;
        let place = near.clone().find(|&at| bytes[at..].starts_with(&value)).unwrap();
        bytes[place + 4] = other.as_bytes()[0];
        let error = refusal(bytes);
        assert!(error.contains("column `blocks.samples`: the type is List("), "{error}");
        assert!(error.contains(has) && error.contains(&format!("should be list of {needs}")), "{error}");
    }
}

/// Flipped bits and missing ends are refused, or change nothing.
#[test]
fn damage_of_fractions_is_refused() {
    let whole = written(&of_fractions(), Compression::Lz4).unwrap();
    let expected = format!("{:?}", first_line(whole.clone()).unwrap());
    let mut bytes = whole.clone();
    for at in (0..whole.len()).step_by(3) {
        let bit = 1 << (at / 3 % 8);
        bytes[at] ^= bit;
        let read = ContainerReader::from_bytes(Path::new("a.arrow"), bytes.clone())
            .and_then(|mut reader| reader.next_line());
        if let Ok(Some(line)) = read {
            assert_eq!(format!("{line:?}"), expected, "byte {at}");
        }
        bytes[at] ^= bit;
        let cut = ContainerReader::from_bytes(Path::new("a.arrow"), whole[..at].to_vec());
        assert!(cut.is_err(), "cut at {at}");
    }
}

/// A file of [`line`] with other beams, as another program writes it.
fn with_beams(beams: ArrayRef, compression: Option<CompressionType>) -> Vec<u8> {
    let options = layout::LayoutOptions { has_fractions: true, ..layout::LayoutOptions::default() };
    let schema = layout::schema(of_fractions().to_metadata(), options);
    let mut columns = line().finish(Arc::new(schema.clone())).unwrap().columns().to_vec();
    let at = schema.index_of("beam").unwrap();
    let of = |(index, field): (usize, &Arc<Field>)| match index == at {
        true => Arc::new(Field::new("beam", beams.data_type().clone(), true)),
        false => Arc::clone(field),
    };
    let fields: Fields = schema.fields().iter().enumerate().map(of).collect();
    columns[at] = beams;
    let schema = Arc::new(Schema::new_with_metadata(fields, schema.metadata().clone()));
    let batch = RecordBatch::try_new(Arc::clone(&schema), columns).unwrap();
    let options = IpcWriteOptions::default().try_with_compression(compression).unwrap();
    let mut writer = FileWriter::try_new_with_options(Vec::new(), &schema, options).unwrap();
    writer.write(&batch).unwrap();
    writer.into_inner().unwrap()
}

/// Polars writes large texts or views of texts.
#[test]
fn texts_of_every_form_are_read() {
    let names = [None, Some("BEAM0101"), Some("a name that is longer than a view has room for")];
    let forms: [ArrayRef; 3] = [
        Arc::new(StringArray::from_iter(names)),
        Arc::new(LargeStringArray::from_iter(names)),
        Arc::new(StringViewArray::from_iter(names)),
    ];
    for beams in forms {
        for compression in [None, Some(CompressionType::LZ4_FRAME), Some(CompressionType::ZSTD)] {
            let whole = with_beams(Arc::clone(&beams), compression);
            let line = first_line(whole.clone()).unwrap();
            assert_eq!([0, 1, 2].map(|row| line.footprint(row).beam), names, "{}", beams.data_type());
            assert_eq!(line.fractions(0).len(), 1, "the columns behind are found");
            let mut bytes = whole.clone();
            for at in (0..whole.len()).step_by(5) {
                bytes[at] ^= 1 << (at / 5 % 8);
                // An error is a valid result.
                let read = ContainerReader::from_bytes(Path::new("a.arrow"), bytes.clone());
                if let Ok(Some(line)) = read.and_then(|mut reader| reader.next_line()) {
                    (0..line.rows()).for_each(|row| drop(format!("{:?}", line.footprint(row))));
                }
                bytes[at] = whole[at];
            }
        }
    }
    let error = refusal(with_beams(Arc::new(Int32Array::from(vec![1, 2, 3])), None));
    assert!(error.contains("column `beam`: the type is Int32 and should be utf8; cast it"), "{error}");
}

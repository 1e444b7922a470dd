//! Arrow: containers, tables, patches of strips and the cells of surveys.

use std::io::Cursor;
use std::path::Path;

use wavex::job::SurveyKeys;
use wavex::report::survey::{SurveyInput, write_survey};
use wavex::stage::OutputFile;
use wavex::stages::writers::write_patches::read_patches;
use wavex_formats::container::{
    Compression, ContainerHeader, ContainerLine, ContainerReader, ContainerWriter, LineBuilder, TableReader,
};

use super::{Files, parts};

/// Most lines of an input that are read: they can share the bytes of the file.
const MOST_LINES: usize = 200;

/// A container as a file and as a stream; what is read is written and read again.
pub fn container(bytes: &[u8]) {
    let place = Files::with(&[("a.arrow", bytes)]);
    let path = place.path("a.arrow");
    if let Ok(reader) = ContainerReader::open(&path) {
        let (header, lines) = lines(reader);
        if lines.iter().map(String::len).sum::<usize>() < 1 << 20 {
            written_again(&path, &header, &lines);
        }
    }
    if let Ok(mut reader) = ContainerReader::open(&path) {
        reader.skip_samples();
        let mut count = 0;
        while count < MOST_LINES
            && let Ok(Some(line)) = reader.next_line()
        {
            count += 1;
            let _ = text(&line);
        }
        if reader.seek(0) {
            let _ = reader.next_line();
        }
        assert!(reader.progress().is_none_or(|part| (0.0..=1.0).contains(&part)));
    }
    if let Ok(reader) = ContainerReader::from_stream(&path, Box::new(Cursor::new(bytes.to_vec()))) {
        let _ = lines(reader);
    }
}

/// Lines of a container as text, up to the first error.
fn lines(mut reader: ContainerReader) -> (ContainerHeader, Vec<String>) {
    let mut lines = Vec::new();
    while lines.len() < MOST_LINES
        && let Ok(Some(line)) = reader.next_line()
    {
        lines.push(text(&line));
        let (blocks, samples) = line.blocks_and_samples(0..line.rows());
        let of_rows = |row: usize| {
            let blocks = line.blocks(row).zip(line.fractions(row));
            blocks.map(|(block, fractions)| block.samples.len() + fractions.len()).collect::<Vec<_>>()
        };
        let of_rows: Vec<usize> = (0..line.rows()).flat_map(of_rows).collect();
        assert_eq!((of_rows.len(), of_rows.iter().sum::<usize>()), (blocks, samples));
    }
    let _ = (reader.form(), reader.ended_without_mark());
    (reader.header().clone(), lines)
}

/// All values of a line.
fn text(line: &ContainerLine) -> String {
    let row = |row: usize| {
        let blocks: Vec<String> = line.blocks(row).map(|block| format!("{block:?}")).collect();
        let online: Vec<String> = line.online(row).map(|online| format!("{online:?}")).collect();
        let fractions: Vec<&[f32]> = line.fractions(row).collect();
        format!("{:?} {blocks:?} {fractions:?} {online:?} {:?}\n", line.shot(row), line.footprint(row))
    };
    (0..line.rows()).map(row).collect()
}

/// Writes the lines of a container again, which must not change them.
fn written_again(path: &Path, header: &ContainerHeader, lines: &[String]) {
    let mut reader = ContainerReader::open(path).unwrap();
    let mut writer = ContainerWriter::stream(Vec::new(), path, header, Compression::Lz4).unwrap();
    for _ in lines {
        let line = reader.next_line().unwrap().unwrap();
        let mut builder = LineBuilder::new();
        for row in 0..line.rows() {
            builder.shot(&line.shot(row));
            for (block, fractions) in line.blocks(row).zip(line.fractions(row)) {
                match header.has_fractions {
                    true => builder.block_of_fractions(&block, fractions),
                    false => builder.block(&block),
                }
            }
            builder.footprint(&line.footprint(row));
            line.online(row).for_each(|online| builder.online(&online));
        }
        writer.write(builder).unwrap();
    }
    let bytes = writer.finish().unwrap();
    let mut again = ContainerReader::from_stream(path, Box::new(Cursor::new(bytes))).unwrap();
    assert_eq!(again.header(), header);
    for line in lines {
        assert_eq!(&text(&again.next_line().unwrap().unwrap()), line);
    }
    assert!(again.next_line().unwrap().is_none());
}

/// Any Arrow table.
pub fn table(bytes: &[u8]) {
    let place = Files::with(&[("a.arrow", bytes)]);
    let Ok(mut reader) = TableReader::open(&place.path("a.arrow")) else { return };
    let n_columns = reader.schema().fields().len();
    let mut count = 0;
    while count < MOST_LINES
        && let Ok(Some(batch)) = reader.next_batch()
    {
        count += 1;
        assert_eq!(batch.num_columns(), n_columns);
        for column in batch.columns() {
            column.to_data().validate_full().unwrap();
        }
    }
}

/// Cells of two strips, of which a survey is made.
pub fn survey_cells(bytes: &[u8]) {
    let place = Files::new();
    let input = |(number, bytes): (usize, &&[u8])| SurveyInput {
        stem: format!("strip {number}"),
        cells: Some(place.write(&format!("{number}_cells.arrow"), bytes)),
        ..SurveyInput::default()
    };
    let inputs: Vec<SurveyInput> = parts(bytes).iter().take(2).enumerate().map(input).collect();
    let Ok(written) = write_survey(&inputs, &SurveyKeys::default(), &place.path("survey.html")) else {
        return;
    };
    assert!(written.files.iter().all(|path| path.is_file()));
}

/// Patches of a strip; the same after writing and reading again.
pub fn patches(bytes: &[u8]) {
    let place = Files::with(&[("a_patches.arrow", bytes)]);
    let Ok(found) = read_patches(&place.path("a_patches.arrow")) else { return };
    let again = place.path("b_patches.arrow");
    let mut file = OutputFile::create(&again).unwrap();
    found.write(&mut file).unwrap();
    file.finish_without_sync().unwrap().publish().unwrap();
    assert!(read_patches(&again).unwrap() == found);
}

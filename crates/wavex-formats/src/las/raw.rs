//! Points and raw records of any LAS or LAZ file.
//!
//! The fields of records have names.

use std::io::BufReader;
use std::path::Path;

use super::chunks::Chunks;
use super::description::LasDescription;
use super::extra_bytes::ExtraBytes;
use super::header::LasHeader;
use super::point::{Point, PointLayout};
use super::records::RecordReader;
use super::vlr::Vlr;
use crate::{Error, RecordedCrs, Result, regular_file};

/// Reader of header, VLRs, points and raw records of a file.
pub struct RawPoints {
    description: LasDescription,
    extra_bytes: Vec<ExtraBytes>,
    fields: Vec<RawField>,
    records: RecordReader,
}

/// Field of a point record.
#[derive(Clone, Debug, PartialEq)]
pub struct RawField {
    /// Name in the specification, or of the extra attribute.
    pub name: String,
    /// Offset in the record, bytes.
    start: usize,
    /// Data type.
    kind: FieldType,
}

/// Data type of a field, little-endian.
#[derive(Clone, Copy, Debug, PartialEq)]
enum FieldType {
    /// Unsigned integer of this many bytes.
    Unsigned(usize),
    /// Signed integer of this many bytes.
    Signed(usize),
    F32,
    F64,
}

use FieldType::{F32, F64, Signed, Unsigned};

impl RawPoints {
    /// Opens a file of any point format from 0 to 10.
    ///
    /// # Errors
    /// The file is not LAS, is cut off, or has contradictory sizes.
    pub fn open(path: &Path) -> Result<RawPoints> {
        let file = regular_file(path)?;
        let file_length = file.metadata().map_err(Error::io(path, "find the length"))?.len();
        let mut input = BufReader::new(file);
        let description = LasDescription::read(&mut input, path, file_length)?;
        let header = &description.header;
        let mut fields = standard(header.point_format);
        let extra_bytes = description.extra_bytes(path)?;
        fields.extend(extra(&extra_bytes, PointLayout::of(header.point_format).length));
        let records = RecordReader::open(path, header, &description.vlrs, file_length)?;
        Ok(RawPoints { description, extra_bytes, fields, records })
    }

    /// Returns the public header block.
    pub fn header(&self) -> &LasHeader {
        &self.description.header
    }

    /// Returns the VLRs and EVLRs.
    pub fn vlrs(&self) -> &[Vlr] {
        &self.description.vlrs
    }

    /// Returns the coordinate reference system, and what is wrong with its records.
    pub fn crs(&self) -> RecordedCrs {
        self.description.crs()
    }

    /// Returns the descriptors of the extra bytes.
    pub fn extra_bytes_descriptors(&self) -> &[ExtraBytes] {
        &self.extra_bytes
    }

    /// Offset of the extra bytes in a point record.
    pub fn extra_start(&self) -> usize {
        PointLayout::of(self.header().point_format).length
    }

    /// Returns the fields of a point record.
    ///
    /// Undocumented bytes are omitted.
    pub fn fields(&self) -> &[RawField] {
        &self.fields
    }

    /// The compressed points; `None` if they are not compressed.
    pub(super) fn compressed(&self) -> Option<&Chunks> {
        self.records.compressed()
    }

    /// Returns the next point record; `None` after the last.
    ///
    /// # Errors
    /// The file cannot be read, or its compressed points are damaged.
    pub fn next_record(&mut self) -> Result<Option<&[u8]>> {
        Ok(if self.records.advance()? { Some(self.records.record()) } else { None })
    }

    /// Reads the next point and returns its extra bytes; `None` after the last, with `point` unchanged.
    ///
    /// # Errors
    /// As [`RawPoints::next_record`].
    pub fn next_point(&mut self, point: &mut Point) -> Result<Option<&[u8]>> {
        if !self.records.advance()? {
            return Ok(None);
        }
        let (header, record) = (&self.description.header, self.records.record());
        let layout = PointLayout::of(header.point_format);
        layout.decode(record, &header.scale, &header.offset, point);
        Ok(Some(record.get(layout.length..).unwrap_or_default()))
    }
}

impl RawField {
    fn new(name: impl Into<String>, start: usize, kind: FieldType) -> RawField {
        RawField { name: name.into(), start, kind }
    }

    /// Formats the stored value of the field.
    ///
    /// Empty if the record is too short.
    pub fn value(&self, record: &[u8]) -> String {
        let length = match self.kind {
            Unsigned(length) | Signed(length) => length,
            F32 => 4,
            F64 => 8,
        };
        let Some(bytes) = record.get(self.start..self.start + length) else { return String::new() };
        let mut wide = [0; 8];
        wide.iter_mut().zip(bytes).for_each(|(to, from)| *to = *from);
        let number = u64::from_le_bytes(wide);
        match self.kind {
            Unsigned(_) => number.to_string(),
            // Sign-extends the value to eight bytes.
            Signed(length) => ((number as i64) << (64 - 8 * length) >> (64 - 8 * length)).to_string(),
            F32 => f32::from_bits(number as u32).to_string(),
            F64 => f64::from_bits(number).to_string(),
        }
    }
}

/// Returns the fields of a point format.
///
/// LAS 1.4 R15, tables of "Point Data Record Format 0" to "10".
fn standard(format: u8) -> Vec<RawField> {
    let field = RawField::new;
    let mut fields = vec![
        field("X", 0, Signed(4)),
        field("Y", 4, Signed(4)),
        field("Z", 8, Signed(4)),
        field("intensity", 12, Unsigned(2)),
    ];
    let colours = |start: usize| {
        ["red", "green", "blue"]
            .iter()
            .zip([0, 2, 4])
            .map(move |(name, at)| field(name, start + at, Unsigned(2)))
    };
    if format <= 5 {
        fields.extend([
            field("return numbers and flags", 14, Unsigned(1)),
            field("classification", 15, Unsigned(1)),
            field("scan angle rank", 16, Signed(1)),
            field("user data", 17, Unsigned(1)),
            field("point source ID", 18, Unsigned(2)),
        ]);
        if !matches!(format, 0 | 2) {
            fields.push(field("GPS time", 20, F64));
        }
        match format {
            2 => fields.extend(colours(20)),
            3 | 5 => fields.extend(colours(28)),
            _ => {}
        }
    } else {
        fields.extend([
            field("return numbers", 14, Unsigned(1)),
            field("flags", 15, Unsigned(1)),
            field("classification", 16, Unsigned(1)),
            field("user data", 17, Unsigned(1)),
            field("scan angle", 18, Signed(2)),
            field("point source ID", 20, Unsigned(2)),
            field("GPS time", 22, F64),
        ]);
        if matches!(format, 7 | 8 | 10) {
            fields.extend(colours(30));
        }
        if matches!(format, 8 | 10) {
            fields.push(field("near infrared", 36, Unsigned(2)));
        }
    }
    if let Some(start) = PointLayout::of(format).wave {
        fields.extend([
            field("wave packet descriptor", start, Unsigned(1)),
            field("byte offset to waveform data", start + 1, Unsigned(8)),
            field("waveform packet size", start + 9, Unsigned(4)),
            field("return point waveform location", start + 13, F32),
            field("X(t)", start + 17, F32),
            field("Y(t)", start + 21, F32),
            field("Z(t)", start + 25, F32),
        ]);
    }
    fields
}

/// Returns the extra attributes declared by a file.
///
/// They follow `length` bytes of standard fields.
fn extra(attributes: &[ExtraBytes], length: usize) -> Vec<RawField> {
    let field = |attribute: &ExtraBytes| {
        let kind = match attribute.data_type {
            1 | 3 | 5 | 7 => Some(Unsigned(attribute.bytes)),
            2 | 4 | 6 | 8 => Some(Signed(attribute.bytes)),
            9 => Some(F32),
            10 => Some(F64),
            // Undocumented bytes are shown as a number if at most eight.
            _ if (1..=8).contains(&attribute.bytes) => Some(Unsigned(attribute.bytes)),
            _ => None,
        };
        kind.map(|kind| RawField::new(attribute.name.clone(), length + attribute.start, kind))
    };
    attributes.iter().filter_map(field).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::las::tests::made::Made;

    #[test]
    fn fields_fill_every_format_without_a_gap() {
        for format in 0..=10 {
            let layout = PointLayout::of(format);
            let mut fields = standard(format);
            fields.sort_by_key(|field| field.start);
            let mut end = 0;
            for field in &fields {
                assert_eq!(field.start, end, "format {format}: {}", field.name);
                end += match field.kind {
                    Unsigned(length) | Signed(length) => length,
                    F32 => 4,
                    F64 => 8,
                };
            }
            assert_eq!(end, layout.length, "format {format}");
        }
    }

    #[test]
    fn values_have_their_type() {
        let record = [0xfe, 0xff, 0xff, 0xff, 0, 0, 0x80, 0x3f];
        let value = |start, kind| RawField::new("a", start, kind).value(&record);
        assert_eq!(value(0, Signed(2)), "-2");
        assert_eq!(value(0, Unsigned(2)), "65534");
        assert_eq!(value(0, Signed(4)), "-2");
        assert_eq!(value(4, F32), "1");
        assert_eq!(value(0, Unsigned(8)), "4575657225703391230");
        assert_eq!(value(6, Signed(4)), "", "the record is too short");
    }

    #[test]
    fn points_have_their_fields_and_extra_bytes() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("points.las");
        let mut made = Made::new(4, 9);
        made.record_length += 2;
        for (number, record) in (1_u8..).zip(&mut made.records) {
            record[0] = 100 * number;
            record.extend([number, 7]);
        }
        std::fs::write(&path, made.las()).unwrap();
        let mut points = RawPoints::open(&path).unwrap();
        let mut point = Point::default();
        for number in 1..=2 {
            assert_eq!(points.next_point(&mut point).unwrap(), Some(&[number, 7][..]));
            assert_eq!((point.x, point.return_number), (f64::from(number), 1));
        }
        assert_eq!(points.next_point(&mut point).unwrap(), None);
    }
}

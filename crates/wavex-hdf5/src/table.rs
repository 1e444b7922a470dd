//! Tables with named values per row: records, or a group with a data set per value.

use wavex_formats::{Error, Result};

use super::attribute::Attributes;
use super::dataset::Dataset;
use super::input::COPY_AGAIN;
use super::members::Members;
use super::record::{Member, Records};

/// A table.
pub struct Table {
    name: String,
    /// `None` if each value has a data set.
    records: Option<Records>,
    rows: u64,
}

/// A value of the rows of a table.
pub enum Value {
    /// Member of its records.
    Member(Member),
    /// Data set of its own.
    Column {
        /// Stored numbers.
        data: Box<Dataset>,
        /// Stored numbers per unit.
        gain: f64,
        /// Value of the stored number 0.
        offset: f64,
    },
}

impl Table {
    /// A table of records.
    pub fn of_records(records: Records) -> Table {
        Table { name: records.name().to_owned(), rows: records.rows(), records: Some(records) }
    }

    /// The table of the data sets of the current group; its rows are those of the data set `counted`.
    ///
    /// # Errors
    /// If there is no such data set.
    pub fn of_group(members: &mut Members, counted: &str) -> Result<Table> {
        let rows = members.required(counted)?.rows();
        Ok(Table { name: members.prefix().trim_end_matches('/').to_owned(), records: None, rows })
    }

    /// Returns its name.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Returns the number of rows.
    pub fn rows(&self) -> u64 {
        self.rows
    }

    /// Opens a value; `None` without one of this name.
    ///
    /// # Errors
    /// If its data set cannot be read, or has another number of rows.
    pub fn optional(&self, members: &mut Members, name: &str) -> Result<Option<Value>> {
        if let Some(records) = &self.records {
            return Ok(records.element().member(name).map(Value::Member));
        }
        let Some((_, at)) = members.find(name) else { return Ok(None) };
        let attributes = Attributes::of(&members.input, at)?;
        let scale =
            [attributes.number(&members.input, "GAIN")?, attributes.number(&members.input, "OFFSET")?];
        let Some(data) = members.column(name, self.rows)? else { return Ok(None) };
        let (gain, offset) = match scale {
            [Some(gain), Some(offset)] => (gain, offset),
            _ => (1.0, 0.0),
        };
        if !(gain.is_finite() && gain != 0.0 && offset.is_finite()) {
            let problem = format!("{}: its gain is {gain} and its offset {offset}", data.name());
            return Err(Error::unusable(members.input.path(), problem, COPY_AGAIN));
        }
        Ok(Some(Value::Column { data: Box::new(data), gain, offset }))
    }

    /// Reads a value of a row.
    ///
    /// # Errors
    /// If there is no such row, or its chunk is damaged.
    pub fn number(&mut self, members: &mut Members, value: &mut Value, row: u64) -> Result<f64> {
        match (&mut self.records, value) {
            (_, Value::Column { data, gain, offset }) => {
                Ok(data.f64_at(&members.input, &mut members.decoder, row)? / *gain + *offset)
            }
            (Some(records), Value::Member(member)) => {
                let record = records.bytes_at(&members.input, &mut members.decoder, row)?;
                Ok(member.number.to_f64(member.of(record)))
            }
            (None, Value::Member(_)) => Ok(f64::NAN),
        }
    }

    /// Reads a whole number of a row, without scaling.
    ///
    /// # Errors
    /// As [`Table::number`], and if it is negative or has a fraction.
    pub fn whole(&mut self, members: &mut Members, value: &mut Value, row: u64) -> Result<u64> {
        let found = match (&mut self.records, value) {
            (_, Value::Column { data, .. }) => data.u64_at(&members.input, &mut members.decoder, row)?,
            (Some(records), Value::Member(member)) => {
                let record = records.bytes_at(&members.input, &mut members.decoder, row)?;
                member.number.to_u64(member.of(record))
            }
            (None, Value::Member(_)) => None,
        };
        found.ok_or_else(|| members.unusable(format!("{}: not a whole number", self.name)))
    }
}

impl Value {
    /// Whether stored numbers are integers.
    pub fn is_integer(&self) -> bool {
        let number = match self {
            Value::Member(member) => member.number,
            Value::Column { data, .. } => *data.element(),
        };
        number.kind != super::number::Kind::Float
    }
}

//! Lookup tables: physical values of digitiser steps.

use std::path::Path;

use super::descriptor::{DESCRIPTION_BYTES, record};
use crate::Result;
use crate::bytes::Fields;

/// Size of the record before the tables, description included, bytes.
const SET_BYTES: u32 = 76;
/// Size of the fixed fields of a table, description included, bytes.
///
/// 84 with the compression field of later revisions.
const TABLE_BYTES: u32 = 80;
/// Data type of the entries.
///
/// 32-bit float, the only one defined.
const FLOAT: u8 = 8;

/// Lookup tables of a record (`PulseWaves_Spec` 300001 to 300255).
///
/// The layout follows the reference library from revision 7 on; the text of specification 0.3
/// only names them.
#[derive(Debug, Clone, PartialEq)]
pub struct LookupRecord {
    /// Description of the record.
    pub description: String,
    /// Tables, in file order.
    pub tables: Vec<LookupTable>,
}

/// Lookup table: `entries[n]` is the value of digitiser step `n`.
///
/// In files of RIEGL instruments, values are decibels above the detection limit, indexed by the
/// height of the *fitted* pulse above the digitiser's zero. Steps below the limit hold about -2e37.
#[derive(Debug, Clone, PartialEq)]
pub struct LookupTable {
    /// Unit code; no list is published; RIEGL's decibels have 1.
    pub unit_of_measurement: u16,
    /// Option bits; none is published.
    pub options: u8,
    /// Description of the table.
    pub description: String,
    /// One value per digitiser step, from step 0.
    pub entries: Vec<f32>,
}

impl LookupRecord {
    /// Parses the payload of a lookup table record at byte `base` of `file`.
    pub(super) fn parse(file: &Path, base: u64, payload: &[u8]) -> Result<LookupRecord> {
        let mut f = Fields::new(file, base, payload);
        let (mut head, description) = record(file, &mut f, "lookup tables", SET_BYTES)?;
        head.skip(8, "lookup tables: size, reserved")?;
        let count = head.u32("lookup tables: number of tables")?;
        let mut tables = Vec::new();
        for _ in 0..count {
            tables.push(LookupTable::parse(file, &mut f)?);
        }
        Ok(LookupRecord { description, tables })
    }
}

impl LookupTable {
    fn parse<'a>(file: &'a Path, f: &mut Fields<'a>) -> Result<LookupTable> {
        let (mut head, description) = record(file, f, "lookup table", TABLE_BYTES)?;
        head.skip(8, "lookup table: size, reserved")?;
        let count = head.u32("lookup table: number of entries")?;
        let unit_of_measurement = head.u16("lookup table: unit of measurement")?;
        let at = head.clone();
        let data_type = head.u8("lookup table: data type")?;
        if data_type != FLOAT {
            let problem = format!("{data_type} is unknown, only {FLOAT} (32-bit float) is defined");
            return Err(at.bad(
                "lookup table: data type",
                problem,
                "export the file again with float tables",
            ));
        }
        let options = head.u8("lookup table: options")?;
        let at = head.clone();
        let compression = if head.left() >= 4 + DESCRIPTION_BYTES { head.u32("compression")? } else { 0 };
        if compression != 0 {
            let problem = format!("scheme {compression} is unknown");
            return Err(at.bad("lookup table: compression", problem, "export the file again uncompressed"));
        }
        let bytes = (count as usize).saturating_mul(4);
        let entries = f.take(bytes, "lookup table: entries")?.chunks_exact(4);
        let entries = entries.map(|e| f32::from_le_bytes([e[0], e[1], e[2], e[3]])).collect();
        Ok(LookupTable { unit_of_measurement, options, description, entries })
    }
}

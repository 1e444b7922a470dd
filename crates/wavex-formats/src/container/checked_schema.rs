//! Schemas of Arrow files and streams, checked before the library converts them.

use arrow_ipc::convert::try_fb_to_schema;
use arrow_ipc::{Endianness, Field as FbField};
use arrow_schema::Schema;

use super::location::ContainerLocation;
use crate::Result;

/// Reads the schema at the start of a file or stream.
pub(super) fn schema_of(schema: arrow_ipc::Schema, location: ContainerLocation) -> Result<Schema> {
    if schema.endianness() != Endianness::Little {
        return Err(location.bad(
            "schema",
            "the numbers are big-endian",
            "write the file on a common machine",
        ));
    }
    for field in schema.fields().iter().flatten() {
        check_unions(field, location)?;
    }
    try_fb_to_schema(schema).map_err(|e| location.bad("schema", e.to_string(), "leave such columns out"))
}

/// `arrow-ipc` panics on a union of over 128 types.
fn check_unions(field: FbField, location: ContainerLocation) -> Result<()> {
    let children = field.children().unwrap_or_default();
    if field.type_as_union().is_some() && children.len() > 128 {
        let name = field.name().unwrap_or_default();
        return Err(location.bad(format!("column `{name}`"), "a union of over 128 types", "leave it out"));
    }
    children.iter().try_for_each(|child| check_unions(child, location))
}

//! GeoParquet 1.1: the column `geometry` and the metadata `geo`.
//!
//! Points are WKB, which every reader knows. A covering (a column of boxes) would repeat x and y,
//! whose columns already have statistics for each row group.

use std::sync::Arc;

use arrow_array::builder::BinaryBuilder;
use arrow_array::{ArrayRef, RecordBatch};
use arrow_schema::{ArrowError, DataType, Field, Schema, SchemaRef};
use serde_json::{Value, json};

use wavex_geodesy::crs::projjson_of_wkt;

/// Name of the column.
pub(super) const COLUMN: &str = "geometry";
/// WKB type of a point with z (ISO 13249-3).
const POINT_Z: u32 = 1001;

/// The points of a table.
pub struct GeoParquetColumn {
    /// Coordinate reference system as PROJJSON; null if it is unknown.
    crs: Value,
    /// Smallest and largest coordinates, if there is a point.
    bounds: Option<[[f64; 3]; 2]>,
}

impl GeoParquetColumn {
    /// Points in this coordinate reference system.
    pub(super) fn new(crs_wkt: Option<&str>) -> GeoParquetColumn {
        GeoParquetColumn { crs: crs_wkt.and_then(projjson_of_wkt).unwrap_or_default(), bounds: None }
    }

    /// Adds the column to a schema.
    pub(super) fn extend(schema: &Schema) -> SchemaRef {
        let description = [("description", "x, y and z as WKB")];
        let field = Field::new(COLUMN, DataType::Binary, true).with_metadata(description);
        let fields = schema.fields().iter().cloned().chain([Arc::new(field)]);
        Arc::new(Schema::new_with_metadata(fields.collect::<Vec<_>>(), schema.metadata().clone()))
    }

    /// Adds the column of these rows to a batch.
    pub(super) fn add(
        &mut self,
        schema: &SchemaRef,
        batch: &RecordBatch,
        points: impl ExactSizeIterator<Item = Option<[f64; 3]>>,
    ) -> Result<RecordBatch, ArrowError> {
        let mut column = BinaryBuilder::with_capacity(points.len(), points.len() * 29);
        for point in points {
            match point.filter(|point| point.iter().all(|coordinate| coordinate.is_finite())) {
                None => column.append_null(),
                Some(point) => {
                    self.include(point);
                    column.append_value(wkb(point));
                }
            }
        }
        let geometry: ArrayRef = Arc::new(column.finish());
        let columns = batch.columns().iter().cloned().chain([geometry]).collect();
        RecordBatch::try_new(Arc::clone(schema), columns)
    }

    fn include(&mut self, point: [f64; 3]) {
        let [least, largest] = self.bounds.get_or_insert([point; 2]);
        for (axis, coordinate) in point.into_iter().enumerate() {
            least[axis] = least[axis].min(coordinate);
            largest[axis] = largest[axis].max(coordinate);
        }
    }

    /// Value of the metadata `geo`.
    pub(super) fn metadata(&self) -> String {
        let mut column = json!({"encoding": "WKB", "geometry_types": ["Point Z"], "crs": self.crs});
        if let Some(bounds) = self.bounds {
            column["bbox"] = json!(bounds.concat());
        }
        json!({"version": "1.1.0", "primary_column": COLUMN, "columns": {COLUMN: column}}).to_string()
    }
}

/// A point as little-endian WKB.
fn wkb(point: [f64; 3]) -> [u8; 29] {
    let mut bytes = [0; 29];
    bytes[0] = 1;
    bytes[1..5].copy_from_slice(&POINT_Z.to_le_bytes());
    for (place, coordinate) in bytes[5..].chunks_exact_mut(8).zip(point) {
        place.copy_from_slice(&coordinate.to_le_bytes());
    }
    bytes
}

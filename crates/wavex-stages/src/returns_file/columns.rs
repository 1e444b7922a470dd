//! Columns of a returns file: the fields of shots, returns, profiles and counters.

use std::sync::Arc;

use arrow_array::cast::AsArray;
use arrow_array::{
    Array, ArrayRef, Float32Array, Float64Array, Int16Array, Int32Array, Int64Array, UInt8Array, UInt16Array,
    UInt32Array, UInt64Array,
};
use arrow_schema::{DataType, Field, Fields};

use wavex_line::scan_line::{Emission, LineStats, Return, ReturnChannel, ShotProfile};

/// A field of rows of type `T`.
pub(super) struct Column<T> {
    pub(super) name: &'static str,
    access: Access<T>,
}

/// Row and column of a value that no writer stores.
pub(super) struct InvalidValue {
    pub(super) row: usize,
    pub(super) column: &'static str,
}

macro_rules! access {
    ($($kind:ident $native:ty, $array:ident;)*) => {
        /// How a field is taken from a row and set.
        enum Access<T> {
            $($kind(fn(&T) -> $native, fn(&mut T, $native)),)*
        }

        impl<T> Column<T> {
            fn data_type(&self) -> DataType {
                match self.access {
                    $(Access::$kind(..) => DataType::$kind,)*
                }
            }

            fn array(&self, rows: &[T]) -> ArrayRef {
                match self.access {
                    $(Access::$kind(get, _) => Arc::new($array::from_iter_values(rows.iter().map(get))),)*
                }
            }

            /// Sets the field of each row from an array of the right type and length.
            fn fill(&self, array: &dyn Array, rows: &mut [T]) -> Result<(), InvalidValue> {
                let invalid = |row: usize| InvalidValue { row, column: self.name };
                if array.null_count() > 0 || array.len() != rows.len() {
                    return Err(invalid(0));
                }
                match self.access {
                    $(Access::$kind(get, set) => {
                        let values = array.as_any().downcast_ref::<$array>().ok_or_else(|| invalid(0))?;
                        for (row, (of, value)) in rows.iter_mut().zip(values.values()).enumerate() {
                            set(of, *value);
                            if get(of).to_ne_bytes() != value.to_ne_bytes() {
                                return Err(invalid(row));
                            }
                        }
                        Ok(())
                    })*
                }
            }
        }
    };
}

access! {
    Float64 f64, Float64Array;
    Float32 f32, Float32Array;
    UInt64 u64, UInt64Array;
    Int64 i64, Int64Array;
    UInt32 u32, UInt32Array;
    Int32 i32, Int32Array;
    UInt16 u16, UInt16Array;
    Int16 i16, Int16Array;
    UInt8 u8, UInt8Array;
}

/// Fields of a table.
pub(super) fn fields<T>(columns: &[Column<T>]) -> Fields {
    columns.iter().map(|column| Field::new(column.name, column.data_type(), false)).collect()
}

/// Arrays of a table, one per column.
pub(super) fn arrays<T>(columns: &[Column<T>], rows: &[T]) -> Vec<ArrayRef> {
    columns.iter().map(|column| column.array(rows)).collect()
}

/// Rows of a table from its arrays; `blank` is the row before its fields are set.
pub(super) fn rows<T: Clone>(
    columns: &[Column<T>],
    arrays: &dyn Array,
    blank: &T,
) -> Result<Vec<T>, InvalidValue> {
    let mut rows = vec![blank.clone(); arrays.len()];
    let Some(table) = arrays.as_struct_opt().filter(|table| table.null_count() == 0) else {
        return Err(InvalidValue { row: 0, column: "rows" });
    };
    for (column, array) in columns.iter().zip(table.columns()) {
        column.fill(array, &mut rows)?;
    }
    Ok(rows)
}

macro_rules! columns {
    ($row:ty: $($kind:ident $name:literal $field:ident $([$index:literal])? $(.$inner:ident)*,)* $(; $($other:expr,)*)?) => {
        &[$(Column::<$row> {
            name: $name,
            access: Access::$kind(
                |row| row.$field $([$index])? $(.$inner)*,
                |row, value| row.$field $([$index])? $(.$inner)* = value,
            ),
        },)* $($($other,)*)?]
    };
}

/// Value of a zone that is not known.
const NO_ZONE: i32 = i16::MIN as i32 - 1;

/// Shots.
pub(super) const SHOTS: &[Column<Emission>] = columns! { Emission:
    UInt64 "shot" shot,
    Float64 "gps_time_s" gps_time_s,
    Int64 "clock_ps" clock_ps,
    Float64 "origin_x_m" origin_m[0],
    Float64 "origin_y_m" origin_m[1],
    Float64 "origin_z_m" origin_m[2],
    Float64 "direction_x" direction[0],
    Float64 "direction_y" direction[1],
    Float64 "direction_z" direction[2],
    Float64 "frame_scale" frame_scale,
    Float64 "emission_ns" emission_ns,
    Float64 "emission_sd_ns" emission_sd_ns,
    UInt16 "facet" facet,
    UInt16 "flags" flags,
    Float32 "scan_angle_deg" scan_angle_deg,
    ;
    Column {
        name: "mta_zone",
        access: Access::Int32(
            |shot| shot.mta_zone.map_or(NO_ZONE, i32::from),
            |shot, zone| shot.mta_zone = i16::try_from(zone).ok(),
        ),
    },
};

/// Returns.
pub(super) const RETURNS: &[Column<Return>] = columns! { Return:
    UInt32 "emission" emission,
    UInt8 "return_number" return_number,
    UInt8 "number_of_returns" number_of_returns,
    UInt16 "flags" flags,
    Int16 "mta_zone" mta_zone,
    Float64 "time_of_flight_ns" time_of_flight_ns,
    Float64 "time_of_flight_sd_ns" time_of_flight_sd_ns,
    Float64 "range_m" range_m,
    Float64 "range_sd_m" range_sd_m,
    Float64 "total_sd_m" total_sd_m,
    Float64 "amplitude_dn" amplitude_dn,
    Float64 "amplitude_sd_dn" amplitude_sd_dn,
    Float64 "gain" gain,
    Float64 "peak_dn" peak_dn,
    Float64 "peak_sd_dn" peak_sd_dn,
    Float64 "amplitude_db" amplitude_db,
    Float64 "width_ratio" width_ratio,
    Float64 "width_ratio_sd" width_ratio_sd,
    Float64 "fwhm_ns" fwhm_ns,
    Float64 "thickness_m" thickness_m,
    Float64 "thickness_sd_m" thickness_sd_m,
    Float64 "deviation_ratio" deviation_ratio,
    Float64 "intensity" intensity,
    Float64 "intensity_sd" intensity_sd,
    UInt8 "class" class,
    ;
    Column {
        name: "channel",
        access: Access::UInt8(
            |found| match found.channel {
                ReturnChannel::Low => 0,
                ReturnChannel::High => 1,
                ReturnChannel::Joint => 2,
            },
            |found, code| {
                found.channel = match code {
                    1 => ReturnChannel::High,
                    2 => ReturnChannel::Joint,
                    _ => ReturnChannel::Low,
                }
            },
        ),
    },
    Column {
        name: "withheld",
        access: Access::UInt8(|found| found.withheld.into(), |found, code| found.withheld = code == 1),
    },
};

/// Profiles.
pub(super) const PROFILES: &[Column<ShotProfile>] = columns! { ShotProfile:
    UInt32 "emission" emission,
    Float64 "first_range_m" first_range_m.value,
    Float64 "first_range_sd_m" first_range_m.sd,
    Float64 "last_range_m" last_range_m.value,
    Float64 "last_range_sd_m" last_range_m.sd,
    UInt32 "peaks" peaks,
    Float64 "height_25_m" heights_m[0].value,
    Float64 "height_25_sd_m" heights_m[0].sd,
    Float64 "height_50_m" heights_m[1].value,
    Float64 "height_50_sd_m" heights_m[1].sd,
    Float64 "height_75_m" heights_m[2].value,
    Float64 "height_75_sd_m" heights_m[2].sd,
    Float64 "height_98_m" heights_m[3].value,
    Float64 "height_98_sd_m" heights_m[3].sd,
    Float64 "top_m" top_m.value,
    Float64 "top_sd_m" top_m.sd,
    Float64 "energy_dn" energy_dn.value,
    Float64 "energy_sd_dn" energy_dn.sd,
    UInt8 "flags" flags,
};

/// Counters of a line but those of dropped returns.
pub(super) const COUNTERS: &[Column<LineStats>] = columns! { LineStats:
    UInt64 "nw" nw,
    UInt64 "np" np,
    UInt64 "np_xtalk" np_xtalk,
    UInt64 "np_merged" np_merged,
    UInt64 "np_air" np_air,
    UInt64 "np_low" np_low,
    UInt64 "np_range" np_range,
    UInt64 "np_atm" np_atm,
    UInt64 "np_ibrc" np_ibrc,
    UInt64 "np_ibic" np_ibic,
    UInt64 "nw_empty" nw_empty,
    UInt64 "nw_saturated" nw_saturated,
    UInt64 "nw_refined1x" nw_refined1x,
    UInt64 "nw_refined2x" nw_refined2x,
    UInt64 "nw_deleted" nw_deleted,
    UInt64 "nw_truncated" nw_truncated,
    UInt64 "n_georef" n_georef,
    UInt64 "n_candidates" n_candidates,
    UInt64 "n_added" n_added,
    UInt64 "nw_with_points" nw_with_points,
    UInt64 "np_xtalk_dropped" np_xtalk_dropped,
    UInt64 "np_online" np_online,
};

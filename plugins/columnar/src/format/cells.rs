//! The columns of a batch, as cells.

use std::fmt::Display;

use abbe_core::{Error, Result};
use abbe_table::{Cell, ColumnCells};
use arrow_array::cast::AsArray;
use arrow_array::types::{
    Decimal32Type, Decimal64Type, Decimal128Type, Decimal256Type, DecimalType, Float16Type, Float32Type, Float64Type,
    Int8Type, Int16Type, Int32Type, Int64Type, UInt8Type, UInt16Type, UInt32Type, UInt64Type,
};
use arrow_array::{Array, ArrayRef, ArrowPrimitiveType, PrimitiveArray};
use arrow_schema::DataType;

/// The cells of a column. Fails for types that are neither numbers nor texts.
pub fn cells_of<'a>(array: &'a ArrayRef, name: &str) -> Result<Box<dyn ColumnCells + 'a>> {
    Ok(match array.data_type() {
        DataType::Int8 => whole::<Int8Type>(array),
        DataType::Int16 => whole::<Int16Type>(array),
        DataType::Int32 => whole::<Int32Type>(array),
        DataType::Int64 => whole::<Int64Type>(array),
        DataType::UInt8 => whole::<UInt8Type>(array),
        DataType::UInt16 => whole::<UInt16Type>(array),
        DataType::UInt32 => whole::<UInt32Type>(array),
        DataType::UInt64 => whole::<UInt64Type>(array),
        DataType::Float16 => {
            of(array, array.as_primitive::<Float16Type>(), |all, row| Cell::Number(all.value(row).to_f64()))
        }
        DataType::Float32 => {
            of(array, array.as_primitive::<Float32Type>(), |all, row| Cell::Number(f64::from(all.value(row))))
        }
        DataType::Float64 => of(array, array.as_primitive::<Float64Type>(), |all, row| Cell::Number(all.value(row))),
        DataType::Decimal32(..) => decimal::<Decimal32Type>(array),
        DataType::Decimal64(..) => decimal::<Decimal64Type>(array),
        DataType::Decimal128(..) => decimal::<Decimal128Type>(array),
        DataType::Decimal256(..) => decimal::<Decimal256Type>(array),
        DataType::Utf8 => of(array, array.as_string::<i32>(), |all, row| Cell::Text(all.value(row).into())),
        DataType::LargeUtf8 => of(array, array.as_string::<i64>(), |all, row| Cell::Text(all.value(row).into())),
        DataType::Utf8View => of(array, array.as_string_view(), |all, row| Cell::Text(all.value(row).into())),
        DataType::Boolean => {
            of(array, array.as_boolean(), |all, row| Cell::Text(if all.value(row) { "true" } else { "false" }.into()))
        }
        DataType::Null => Box::new(Nothing),
        DataType::Dictionary(..) => {
            let dictionary = array.as_any_dictionary();
            if dictionary.values().is_empty() {
                return Ok(Box::new(Nothing));
            }
            let keys = dictionary.normalized_keys();
            Box::new(Dictionary { array, keys, values: cells_of(dictionary.values(), name)? })
        }
        other => return Err(wrong_type(name, other)),
    })
}

fn wrong_type(name: &str, found: &dyn Display) -> Error {
    Error::data(format!("the column `{name}` has the type {found}; numbers or texts were expected"))
        .help("write it as numbers (a time in seconds), or leave it out: `columns` lists those that are taken")
}

/// The cells of a column whose values a function reads.
struct Values<'a, A: ?Sized, F> {
    array: &'a ArrayRef,
    values: &'a A,
    cell: F,
}

fn of<'a, A: ?Sized>(
    array: &'a ArrayRef,
    values: &'a A,
    cell: impl Fn(&'a A, usize) -> Cell<'a> + 'a,
) -> Box<dyn ColumnCells + 'a> {
    Box::new(Values { array, values, cell })
}

impl<'a, A: ?Sized, F: Fn(&'a A, usize) -> Cell<'a>> ColumnCells for Values<'a, A, F> {
    fn cell(&self, row: usize) -> Cell<'_> {
        match self.array.is_null(row) {
            true => Cell::Missing,
            false => (self.cell)(self.values, row),
        }
    }
}

fn whole<'a, T: ArrowPrimitiveType>(array: &'a ArrayRef) -> Box<dyn ColumnCells + 'a>
where
    i128: From<T::Native>,
{
    of(array, array.as_primitive::<T>(), |all: &PrimitiveArray<T>, row| Cell::Whole(i128::from(all.value(row))))
}

fn decimal<'a, T: DecimalType>(array: &'a ArrayRef) -> Box<dyn ColumnCells + 'a> {
    of(array, array.as_primitive::<T>(), |all: &PrimitiveArray<T>, row| Cell::Text(all.value_as_string(row).into()))
}

/// A column without values.
struct Nothing;

impl ColumnCells for Nothing {
    fn cell(&self, _: usize) -> Cell<'_> {
        Cell::Missing
    }
}

/// A column that refers to a list of values.
struct Dictionary<'a> {
    array: &'a ArrayRef,
    keys: Vec<usize>,
    values: Box<dyn ColumnCells + 'a>,
}

impl ColumnCells for Dictionary<'_> {
    fn cell(&self, row: usize) -> Cell<'_> {
        match self.array.is_null(row) {
            true => Cell::Missing,
            false => self.values.cell(self.keys[row]),
        }
    }
}

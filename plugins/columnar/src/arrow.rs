//! Columns of Arrow as cells: of batches that are read from files, and of those that a program holds.

use std::fmt::Display;

use abbe_core::{Cell, ColumnCells, Error, Field, Result, RowsOfTable, SharedCells};
use arrow_array::cast::AsArray;
use arrow_array::types::{
    Decimal32Type, Decimal64Type, Decimal128Type, Decimal256Type, DecimalType, Float16Type, Float32Type, Float64Type,
    Int8Type, Int16Type, Int32Type, Int64Type, UInt8Type, UInt16Type, UInt32Type, UInt64Type,
};
use arrow_array::{Array, ArrayRef, ArrowPrimitiveType, PrimitiveArray, RecordBatch};
use arrow_schema::{DataType, Schema};

/// The key of the metadata of a column that states its unit.
pub const UNIT: &str = "unit";

/// The columns that a schema describes.
pub fn fields(schema: &Schema) -> Vec<Field> {
    let field = |field: &arrow_schema::FieldRef| Field {
        name: field.name().clone(),
        unit: field.metadata().get(UNIT).cloned(),
    };
    schema.fields().iter().map(field).collect()
}

/// The rows of a batch, with the columns at these places. Nothing is copied.
///
/// Fails for types that are neither numbers nor texts.
pub fn rows_of(batch: &RecordBatch, places: &[usize]) -> Result<RowsOfTable> {
    let schema = batch.schema_ref();
    let cells = places.iter().map(|&place| cells_of(batch.column(place), schema.field(place).name()));
    Ok(RowsOfTable { rows: batch.num_rows(), cells: cells.collect::<Result<_>>()? })
}

/// The cells of a column.
fn cells_of(array: &ArrayRef, name: &str) -> Result<SharedCells> {
    Ok(match array.data_type() {
        DataType::Int8 => whole::<Int8Type>(array),
        DataType::Int16 => whole::<Int16Type>(array),
        DataType::Int32 => whole::<Int32Type>(array),
        DataType::Int64 => whole::<Int64Type>(array),
        DataType::UInt8 => whole::<UInt8Type>(array),
        DataType::UInt16 => whole::<UInt16Type>(array),
        DataType::UInt32 => whole::<UInt32Type>(array),
        DataType::UInt64 => whole::<UInt64Type>(array),
        DataType::Float16 => of(array.as_primitive::<Float16Type>(), |all, row| Cell::Number(all.value(row).to_f64())),
        DataType::Float32 => {
            of(array.as_primitive::<Float32Type>(), |all, row| Cell::Number(f64::from(all.value(row))))
        }
        DataType::Float64 => of(array.as_primitive::<Float64Type>(), |all, row| Cell::Number(all.value(row))),
        DataType::Decimal32(..) => decimal::<Decimal32Type>(array),
        DataType::Decimal64(..) => decimal::<Decimal64Type>(array),
        DataType::Decimal128(..) => decimal::<Decimal128Type>(array),
        DataType::Decimal256(..) => decimal::<Decimal256Type>(array),
        DataType::Utf8 => of(array.as_string::<i32>(), |all, row| Cell::Text(all.value(row).into())),
        DataType::LargeUtf8 => of(array.as_string::<i64>(), |all, row| Cell::Text(all.value(row).into())),
        DataType::Utf8View => of(array.as_string_view(), |all, row| Cell::Text(all.value(row).into())),
        DataType::Boolean => {
            of(array.as_boolean(), |all, row| Cell::Text(if all.value(row) { "true" } else { "false" }.into()))
        }
        DataType::Null => Box::new(Nothing),
        DataType::Dictionary(..) => {
            let dictionary = array.as_any_dictionary();
            if dictionary.values().is_empty() {
                return Ok(Box::new(Nothing));
            }
            let keys = dictionary.normalized_keys();
            Box::new(Dictionary { array: array.clone(), keys, values: cells_of(dictionary.values(), name)? })
        }
        other => return Err(wrong_type(name, other)),
    })
}

fn wrong_type(name: &str, found: &dyn Display) -> Error {
    Error::data(format!("the column `{name}` has the type {found}; numbers or texts were expected"))
        .help("write it as numbers (a time in seconds), or leave it out: `columns` lists those that are taken")
}

/// The cells of a column whose values a function reads.
struct Values<A> {
    array: A,
    cell: fn(&A, usize) -> Cell<'_>,
}

fn of<A: Array + Clone + 'static>(array: &A, cell: fn(&A, usize) -> Cell<'_>) -> SharedCells {
    Box::new(Values { array: array.clone(), cell })
}

impl<A: Array> ColumnCells for Values<A> {
    fn cell(&self, row: usize) -> Cell<'_> {
        match self.array.is_null(row) {
            true => Cell::Missing,
            false => (self.cell)(&self.array, row),
        }
    }
}

fn whole<T: ArrowPrimitiveType>(array: &ArrayRef) -> SharedCells
where
    i128: From<T::Native>,
{
    of(array.as_primitive::<T>(), |all: &PrimitiveArray<T>, row| Cell::Whole(i128::from(all.value(row))))
}

fn decimal<T: DecimalType>(array: &ArrayRef) -> SharedCells {
    of(array.as_primitive::<T>(), |all: &PrimitiveArray<T>, row| Cell::Text(all.value_as_string(row).into()))
}

/// A column without values.
struct Nothing;

impl ColumnCells for Nothing {
    fn cell(&self, _: usize) -> Cell<'_> {
        Cell::Missing
    }
}

/// A column that refers to a list of values.
struct Dictionary {
    array: ArrayRef,
    keys: Vec<usize>,
    values: SharedCells,
}

impl ColumnCells for Dictionary {
    fn cell(&self, row: usize) -> Cell<'_> {
        match self.array.is_null(row) {
            true => Cell::Missing,
            false => self.values.cell(self.keys[row]),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use arrow_array::{Float64Array, StringArray};

    use super::*;

    #[test]
    fn cells_stay_where_they_are() {
        let numbers = Float64Array::from(vec![1.5, 2.5]);
        let values = numbers.values().inner().clone();
        let columns: [(&str, ArrayRef); 2] =
            [("X_mm", Arc::new(numbers)), ("feature", Arc::new(StringArray::from(vec![Some("a"), None])))];
        let batch = RecordBatch::try_from_iter(columns).unwrap();
        let holders = values.strong_count();
        let rows = rows_of(&batch, &[1, 0]).unwrap();
        // The cells hold the same bytes: one more holder, and no copy.
        assert_eq!(values.strong_count(), holders + 1);
        drop(batch);
        let text = Cell::Text("a".into());
        assert_eq!(
            [rows.cells[0].cell(0), rows.cells[0].cell(1), rows.cells[1].cell(1)],
            [text, Cell::Missing, Cell::Number(2.5)]
        );
    }
}

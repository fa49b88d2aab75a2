//! From the columns of a data set to the statuses that a model takes.

use std::path::PathBuf;

use crate::dataset::{ColumnHeader, Dataset, Values, missing_column};
use crate::error::{Error, Result};
use crate::model::{Absent, AxisKind, KinematicModel, StatusColumn};
use crate::unit::Quantity;

/// Statuses of poses, row by row, in the column order of the model that they were gathered for.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct PoseTable {
    width: usize,
    values: Vec<f64>,
}

/// Which column (without unit) holds a status: the names to try, the first that is there is taken.
pub type ColumnNaming<'a> = &'a dyn Fn(&StatusColumn) -> Vec<String>;

/// Columns are named as the statuses are.
pub fn plain_naming(status: &StatusColumn) -> Vec<String> {
    vec![status.name.clone()]
}

/// Finds the column of every status of the model among `headers`; `None` where it is absent and may be.
///
/// Fails for an axis without a column, a column without unit and a column with the unit of another quantity.
pub fn pose_columns(
    headers: &[ColumnHeader],
    file: Option<&PathBuf>,
    model: &dyn KinematicModel,
    naming: ColumnNaming<'_>,
) -> Result<Vec<Option<String>>> {
    let mut columns = Vec::new();
    for status in model.status() {
        let names = naming(status);
        let found = names.iter().find_map(|name| headers.iter().find(|header| header.name == *name));
        let place = |error: Error| match file {
            Some(file) => error.at(file, 1, None),
            None => error,
        };
        match (found, status.absent) {
            (Some(header), _) if header.quantity == status.quantity => columns.push(Some(header.name.clone())),
            (Some(header), _) if header.quantity == Quantity::Label => {
                let written = format!("{}{}", header.name, status.quantity.usual_suffix());
                return Err(place(
                    Error::usage(format!("the column `{}` does not say its unit", header.header))
                        .help(format!("write its unit into its name: `{written}`")),
                ));
            }
            (Some(header), _) => {
                let axis = model.axes().iter().find(|axis| axis.name == status.name);
                let what = match axis.map(|axis| axis.kind) {
                    Some(AxisKind::Linear) => format!("{} is a linear axis, a length", status.name),
                    Some(AxisKind::Rotary) => format!("{} is a rotary axis, an angle", status.name),
                    None => format!("{} is in {}", status.name, status.quantity.symbol()),
                };
                return Err(place(Error::usage(format!(
                    "the column `{}` has the wrong unit: {what} was expected",
                    header.header
                ))));
            }
            (None, Absent::Taken(_)) => columns.push(None),
            (None, Absent::Refused) => {
                let name = format!("{}{}", names[0], status.quantity.usual_suffix());
                return Err(missing_column(file, &name, headers));
            }
        }
    }
    Ok(columns)
}

impl PoseTable {
    /// An empty table for a model.
    pub fn new(model: &dyn KinematicModel) -> Self {
        Self { width: model.status().len(), values: Vec::new() }
    }

    /// Appends the pose of one data row, read from `columns` (see [`pose_columns`]).
    pub fn push(
        &mut self,
        data: &Dataset,
        row: usize,
        model: &dyn KinematicModel,
        columns: &[Option<String>],
    ) -> Result<()> {
        for (status, column) in model.status().iter().zip(columns) {
            let value = match (column, status.absent) {
                (None, Absent::Taken(value)) => value,
                (None, Absent::Refused) => {
                    return Err(missing_column(data.files.first(), &status.name, &data.headers()));
                }
                (Some(name), _) => match data.column(name).map(|column| &column.values) {
                    Some(Values::Numbers(numbers)) => numbers[row],
                    Some(Values::Labels(labels)) => {
                        status.levels.iter().position(|level| *level == labels[row]).map_or(f64::NAN, |i| i as f64)
                    }
                    None => return Err(missing_column(data.files.first(), name, &data.headers())),
                },
            };
            if status.name.starts_with("dir_") && ![-1.0, 0.0, 1.0].contains(&value) {
                return Err(data.error_at(
                    row,
                    format!("`{}` is {value}; +1 or -1 was expected", column.as_deref().unwrap_or("")),
                ));
            }
            self.values.push(value);
        }
        Ok(())
    }

    /// Number of poses.
    pub fn len(&self) -> usize {
        self.values.len().checked_div(self.width).unwrap_or(0)
    }

    /// Whether there is no pose.
    pub fn is_empty(&self) -> bool {
        self.values.is_empty()
    }

    /// The status of one pose.
    pub fn row(&self, pose: usize) -> &[f64] {
        &self.values[pose * self.width..(pose + 1) * self.width]
    }

    /// The status of one pose, to change it.
    pub fn row_mut(&mut self, pose: usize) -> &mut [f64] {
        &mut self.values[pose * self.width..(pose + 1) * self.width]
    }
}

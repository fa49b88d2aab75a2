//! From the columns of a data set to the statuses that a model takes.

use std::ops::Range;
use std::path::PathBuf;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::dataset::{ColumnHeader, Dataset, Values, missing_column};
use crate::index::{DataRow, IndexRange, PoseIndex};
use crate::model::{Absent, Axis, AxisKind, KinematicModel, StatusColumn, StatusRole};
use abbe_settings::Quantity;
use abbe_settings::serial::{number, numbers};
use abbe_settings::{Error, Result};

/// Statuses of poses, row by row, in the column order of the model that they were gathered for.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
pub struct PoseTable {
    /// Number of columns of the status.
    width: usize,
    /// Pose by pose; `null` is a value that is not known.
    #[serde(deserialize_with = "numbers")]
    #[schemars(with = "Vec<Option<f64>>")]
    values: Vec<f64>,
}

/// Gives the possible names (without unit) of the column of a status, and what it means if there is no such column. The first
/// name that the data have is used. The axis is given if the status is the command of an axis.
pub type ColumnNaming<'a> = &'a dyn Fn(&StatusColumn, Option<&Axis>) -> (Vec<String>, Absent);

/// Columns are named as the statuses are.
pub fn plain_naming(status: &StatusColumn, _: Option<&Axis>) -> (Vec<String>, Absent) {
    (vec![status.name.clone()], status.absent)
}

/// Source of the values of a status: a column, or the value of [`Absent::Default`] if there is no column.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum StatusSource {
    /// Name of the column, without unit.
    Column(String),
    /// The value taken for every row.
    Taken(
        #[serde(deserialize_with = "number")]
        #[schemars(with = "Option<f64>")]
        f64,
    ),
}

/// Finds the column of every status of the model among `headers`.
///
/// Fails for a status without a column that has no value for this case ([`Absent::Required`]), a column without unit, and a
/// column with the unit of another quantity.
pub fn pose_columns(
    headers: &[ColumnHeader],
    file: Option<&PathBuf>,
    model: &dyn KinematicModel,
    naming: ColumnNaming<'_>,
) -> Result<Vec<StatusSource>> {
    let place = |error: Error| match file {
        Some(file) => error.in_file(file),
        None => error,
    };
    let mut columns = Vec::new();
    for (index, status) in model.info().status.iter().enumerate() {
        let axis = model.info().axes.iter().find(|axis| axis.status == index);
        let (names, absent) = naming(status, axis);
        let found = names.iter().find_map(|name| headers.iter().find(|header| header.name == *name));
        match (found, absent) {
            (Some(header), _) if header.quantity == status.quantity => {
                columns.push(StatusSource::Column(header.name.clone()));
            }
            (Some(header), _) if header.quantity == Quantity::Label => {
                let written = format!("{}{}", header.name, status.quantity.usual_suffix());
                return Err(place(
                    Error::usage(format!("the column `{}` does not say its unit", header.header))
                        .help(format!("write its unit into its name: `{written}`")),
                ));
            }
            (Some(header), _) => {
                let what = match axis.map(|axis| axis.kind) {
                    Some(AxisKind::Linear) => format!("{} is a linear axis, a length", status.name),
                    Some(AxisKind::Rotary) => format!("{} is a rotary axis, an angle", status.name),
                    None => format!("`{}` is in {}; that", status.name, status.quantity.symbol()),
                };
                return Err(place(Error::usage(format!(
                    "the column `{}` has the wrong unit: {what} was expected",
                    header.header
                ))));
            }
            (None, Absent::Default(value)) => columns.push(StatusSource::Taken(value)),
            (None, Absent::Required) => {
                let name = format!("{}{}", names.first().unwrap_or(&status.name), status.quantity.usual_suffix());
                return Err(missing_column(file, &name, headers));
            }
        }
    }
    Ok(columns)
}

impl PoseTable {
    /// An empty table for a model.
    pub fn new(model: &dyn KinematicModel) -> Self {
        Self { width: model.info().status.len(), values: Vec::new() }
    }

    /// Appends the pose of one data row, read from `columns` (see [`pose_columns`]).
    pub fn push(
        &mut self,
        data: &Dataset,
        row: DataRow,
        model: &dyn KinematicModel,
        columns: &[StatusSource],
    ) -> Result<()> {
        self.push_from(data, row, model, (columns, &[]))
    }

    /// The same of columns that stand at these places among those of the data, where places are known.
    pub(crate) fn push_from(
        &mut self,
        data: &Dataset,
        row: DataRow,
        model: &dyn KinematicModel,
        (columns, places): (&[StatusSource], &[usize]),
    ) -> Result<()> {
        for (index, (status, source)) in model.info().status.iter().zip(columns).enumerate() {
            let column =
                |name: &str| places.get(index).map_or_else(|| data.column(name), |place| data.columns.get(*place));
            let value = match source {
                StatusSource::Taken(value) => *value,
                StatusSource::Column(name) => match column(name).map(|column| &column.values) {
                    Some(Values::Numbers(numbers))
                        if matches!(status.role, StatusRole::Direction(_)) && numbers[row].abs() != 1.0 =>
                    {
                        let message = format!("`{name}` is {}; +1 or -1 was expected", numbers[row]);
                        return Err(data.error_at(row, message));
                    }
                    Some(Values::Numbers(numbers)) => numbers[row],
                    Some(Values::Labels(labels)) => {
                        status.levels.iter().position(|level| *level == labels[row]).map_or(f64::NAN, |i| i as f64)
                    }
                    None => return Err(missing_column(data.files.first(), name, &data.headers())),
                },
            };
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

    /// The indices of all poses.
    pub fn indices(&self) -> IndexRange<PoseIndex> {
        PoseIndex::first(self.len())
    }

    /// The index of the pose that is pushed next.
    pub fn end(&self) -> PoseIndex {
        PoseIndex(self.len())
    }

    /// The status of one pose.
    pub fn row(&self, pose: PoseIndex) -> &[f64] {
        &self.values[self.place(pose)]
    }

    /// The status of one pose, to change it.
    pub fn row_mut(&mut self, pose: PoseIndex) -> &mut [f64] {
        let place = self.place(pose);
        &mut self.values[place]
    }

    fn place(&self, PoseIndex(pose): PoseIndex) -> Range<usize> {
        pose * self.width..(pose + 1) * self.width
    }
}

//! The rows of some observations, with their poses and equations.

use std::sync::Arc;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::dataset::Dataset;
use crate::index::{DataRow, IndexRange, LayoutEquation, PoseIndex, RowIndex};
use crate::model::KinematicModel;
use crate::pose_table::{ColumnNaming, PoseTable, StatusSource, pose_columns};
use abbe_settings::{Quantity, Result};

/// One measurement: its poses, its equations, and the data row that it comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Row {
    /// First of its poses in [`Layout::poses`].
    pub first_pose: PoseIndex,
    /// Number of its poses: none (a calibrated distance between features), one or several.
    pub poses: usize,
    /// First of its equations.
    pub first_equation: LayoutEquation,
    /// How many equations it gives.
    pub equations: usize,
    /// The row of the data set; none if it is a constraint that was not measured here.
    pub data_row: Option<DataRow>,
}

impl Row {
    /// Its poses.
    pub fn pose_indices(&self) -> IndexRange<PoseIndex> {
        IndexRange::new(self.first_pose, self.poses)
    }

    /// Its equations.
    pub fn equation_indices(&self) -> IndexRange<LayoutEquation> {
        IndexRange::new(self.first_equation, self.equations)
    }
}

/// The rows of some observations: the part that has the same form for all artefacts.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
pub struct Layout {
    /// The data set. It is not serialised with the layout; it has to be stored separately.
    #[serde(skip)]
    pub data: Arc<Dataset>,
    /// The rows, each with its poses and equations.
    pub rows: Vec<Row>,
    /// The statuses of all poses.
    pub poses: PoseTable,
    /// Standard uncertainty of every equation, mm or rad.
    pub standard_uncertainties: Vec<f64>,
    /// Further rows of the data set that were combined into rows of this layout, beside the `data_row` of each: the touches
    /// of a centre.
    pub merged: Vec<DataRow>,
    /// For each pose of a row, where each column of the status comes from.
    sources: Vec<Vec<StatusSource>>,
    /// Where these columns stand in the data.
    #[serde(skip)]
    places: Vec<Vec<usize>>,
}

impl Layout {
    /// A layout without rows for a data set whose rows have one pose for each of `namings`.
    ///
    /// Fails as [`pose_columns`] does, and if an axis moves in the data that the model does not have.
    pub fn new(data: &Arc<Dataset>, model: &dyn KinematicModel, namings: &[ColumnNaming<'_>]) -> Result<Self> {
        let headers = data.headers();
        let sources = namings.iter().map(|naming| pose_columns(&headers, data.files.first(), model, naming));
        let sources = sources.collect::<Result<Vec<_>>>()?;
        unknown_axis(data, &sources)?;
        let place = |source: &StatusSource| match source {
            StatusSource::Column(name) => headers.iter().position(|header| header.name == *name).unwrap_or(0),
            StatusSource::Taken(_) => 0,
        };
        let places = sources.iter().map(|sources| sources.iter().map(place).collect()).collect();
        Ok(Self {
            data: data.clone(),
            rows: Vec::new(),
            poses: PoseTable::new(model),
            standard_uncertainties: Vec::new(),
            merged: Vec::new(),
            sources,
            places,
        })
    }

    /// The indices of all rows.
    pub fn row_indices(&self) -> IndexRange<RowIndex> {
        RowIndex::first(self.rows.len())
    }

    /// Adds a measured row: one equation for each of `standard_uncertainties`.
    pub fn push(
        &mut self,
        model: &dyn KinematicModel,
        data_row: DataRow,
        standard_uncertainties: &[f64],
    ) -> Result<()> {
        let first_pose = self.poses.end();
        for (index, sources) in self.sources.iter().enumerate() {
            let places = self.places.get(index).map_or(&[][..], Vec::as_slice);
            self.poses.push_from(&self.data, data_row, model, (sources, places))?;
        }
        self.add(first_pose, self.sources.len(), Some(data_row), standard_uncertainties);
        Ok(())
    }

    /// Adds a constraint without poses: knowledge of the artefact that was not measured here.
    ///
    /// Its standard uncertainties are used as weights only. Results get the uncertainty of the known inputs that its
    /// equations depend on, because a certificate does not scatter as readings do.
    pub fn push_constraint(&mut self, standard_uncertainties: &[f64]) {
        self.add(self.poses.end(), 0, None, standard_uncertainties);
    }

    fn add(&mut self, first_pose: PoseIndex, poses: usize, data_row: Option<DataRow>, standard_uncertainties: &[f64]) {
        let first_equation = LayoutEquation(self.standard_uncertainties.len());
        let equations = standard_uncertainties.len();
        self.standard_uncertainties.extend_from_slice(standard_uncertainties);
        self.rows.push(Row { first_pose, poses, first_equation, equations, data_row });
    }

    /// The column (without unit) in which pose `pose` of a row records a status; none if it is not recorded.
    pub fn recorded(&self, pose: usize, status: usize) -> Option<&str> {
        match self.sources.get(pose)?.get(status)? {
            StatusSource::Column(name) => Some(name),
            StatusSource::Taken(_) => None,
        }
    }
}

/// Refuses data in which an axis moves that the model does not have: its motion would be ignored without a message.
fn unknown_axis(data: &Dataset, sources: &[Vec<StatusSource>]) -> Result<()> {
    for column in &data.columns {
        let name = &column.header.name;
        let letter = name.trim_end_matches(|c: char| c.is_ascii_digit());
        let of_axis = match column.header.quantity {
            Quantity::Length => ["X", "Y", "Z", "U", "V", "W"].contains(&letter),
            Quantity::Angle => ["A", "B", "C", "S"].contains(&letter),
            _ => false,
        };
        let used = || sources.iter().flatten().any(|source| *source == StatusSource::Column(name.clone()));
        if !of_axis || used() {
            continue;
        }
        let numbers = data.numbers(name).unwrap_or_default();
        if let Some(row) = numbers.iter().position(|number| *number != numbers[0]) {
            let message = format!("`{}` changes here, but the machine has no axis {name}", column.header.header);
            return Err(data.error_at(DataRow(row), message).help("add the axis to the chain, or take the column out"));
        }
    }
    Ok(())
}

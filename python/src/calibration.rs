//! Calibrations: values, covariance, and what follows from them for a machine.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use abbe_compensation::{CompensatedPath, SetPoints, Settings, follows_log};
use abbe_core::{
    AxisKind, Error, KinematicModel, PoseTable, Poses, Registry, Result, RowOrigin, Table, machine_values,
    plain_naming, pose_columns,
};
use abbe_engine::model_of;
use abbe_volumetric::predict;
use pyo3::prelude::*;
use pyo3::types::PyByteArray;

use crate::columns::{Collected, Columns, bytes_of};
use crate::failure::OrRaise;
use crate::tables::table_of;

/// Values, their covariance, and the machine that they are of.
#[pyclass(frozen, module = "abbe._abbe")]
pub struct Calibration {
    calibration: abbe_core::Calibration,
    model: Arc<dyn KinematicModel>,
}

/// Reads a calibration file.
#[pyfunction]
pub fn read_calibration(py: Python<'_>, path: PathBuf) -> PyResult<Calibration> {
    let read = || -> Result<Calibration> {
        let text = std::fs::read_to_string(&path).map_err(|error| {
            Error::usage(format!("the file cannot be read: {error}"))
                .help("name `<estimate>.calibration.json` of a run")
        })?;
        let calibration = abbe_core::Calibration::from_json(&text)?;
        let model = model_of(&calibration, &Registry::built_in()?)?;
        Ok(Calibration::new(calibration, model))
    };
    py.detach(|| read().map_err(|error: Error| error.in_file(&path))).or_raise(py)
}

impl Calibration {
    /// A calibration and its model.
    pub fn new(calibration: abbe_core::Calibration, model: Arc<dyn KinematicModel>) -> Self {
        Self { calibration, model }
    }

    /// The statuses of poses that a table has.
    fn statuses(&self, table: &Table) -> Result<Vec<f64>> {
        let (data, _) = abbe_table::of_table(Path::new("poses"), table, &abbe_table::Layout::default())?;
        let model = self.model.as_ref();
        let columns = pose_columns(&data.headers(), data.files.first(), model, &plain_naming)?;
        let mut poses = PoseTable::new(model);
        for row in data.row_indices() {
            poses.push(&data, row, model, &columns)?;
        }
        Ok(poses.indices().flat_map(|pose| poses.row(pose).to_vec()).collect())
    }

    fn predicted(&self, table: &Table) -> Result<(Poses, Vec<abbe_volumetric::VolumetricError>)> {
        let statuses = self.statuses(table)?;
        let model = self.model.as_ref();
        let mut poses = Poses::default();
        let located = |error: Error| match error.pose {
            Some(pose) => RowOrigin { file: 0, line: 0, row: pose + 1 }.blame(error, Path::new("poses")),
            None => error,
        };
        model.poses(&statuses, &machine_values(model, &self.calibration), &[], true, &mut poses).map_err(located)?;
        Ok((poses, predict(model, &self.calibration, &statuses).map_err(located)?))
    }

    fn compensated(&self, table: &Table, settings: &str) -> Result<CompensatedPath> {
        let settings: serde_json::Value =
            serde_json::from_str(settings).map_err(|error| Error::usage(format!("settings: {error}")))?;
        let settings: Settings = abbe_core::from_settings(&settings).map_err(|wrong| {
            let error = Error::usage(wrong.to_string());
            match wrong.help {
                Some(help) => error.help(help),
                None => error,
            }
        })?;
        if follows_log(&self.calibration) {
            let error = Error::usage("errors of this calibration follow temperatures, and the log of now is missing");
            return Err(error.help("`abbe compensate --log FILE` takes one"));
        }
        let model = self.model.as_ref();
        let (data, _) = abbe_table::of_table(Path::new("set_points"), table, &abbe_table::Layout::default())?;
        let points = SetPoints::of_data(data, model, None)?;
        CompensatedPath::of(model, &self.calibration, points, &settings)
    }
}

#[pymethods]
impl Calibration {
    /// Name of the estimate.
    #[getter]
    fn estimate(&self) -> &str {
        &self.calibration.estimate
    }

    /// The text of the calibration file, to the byte.
    fn json(&self, py: Python<'_>) -> PyResult<String> {
        self.calibration.to_json().or_raise(py)
    }

    /// The parameters of the machine, or the unknowns of artefacts: name, value, unit, standard uncertainty, status.
    fn values(&self, of_artefacts: bool) -> PyResult<Columns> {
        let values = if of_artefacts { &self.calibration.artefacts } else { &self.calibration.parameters };
        let status = |status: abbe_core::Status| {
            serde_json::to_value(status).ok().and_then(|status| status.as_str().map(str::to_owned))
        };
        let mut columns = Collected::default();
        columns.texts("name", values.iter().map(|one| Some(&one.name)));
        columns.numbers("value", values.iter().map(|one| one.value).collect());
        columns.texts("unit", values.iter().map(|one| Some(&one.unit)));
        columns.numbers("standard_uncertainty", values.iter().map(|one| one.standard_uncertainty).collect());
        columns.texts("status", values.iter().map(|one| status(one.status)));
        columns.finish()
    }

    /// Names of what has a covariance, and the matrix, row by row.
    fn covariance<'py>(&self, py: Python<'py>) -> PyResult<(Vec<String>, Bound<'py, PyByteArray>)> {
        let covariance = &self.calibration.covariance;
        let all: Vec<f64> = covariance.rows.iter().flatten().copied().collect();
        Ok((covariance.order.clone(), bytes_of(py, &all)?))
    }

    /// Where the tip is at poses, and its error there with standard uncertainties; all in the table frame.
    fn predict(&self, py: Python<'_>, poses: Bound<'_, PyAny>) -> PyResult<Columns> {
        let table = table_of(&poses)?;
        let (poses, errors) = py.detach(|| self.predicted(&table)).or_raise(py)?;
        let mut columns = Collected::default();
        for (axis, letter) in ["x", "y", "z"].into_iter().enumerate() {
            columns.numbers(format!("{letter}_mm"), poses.positions.iter().map(|tip| tip[axis]).collect());
        }
        for (part, letter) in ["qw", "qx", "qy", "qz"].into_iter().enumerate() {
            columns.numbers(letter, poses.orientations.iter().map(|turned| turned[part]).collect());
        }
        for (axis, letter) in ["x", "y", "z"].into_iter().enumerate() {
            columns.numbers(format!("error_{letter}_um"), errors.iter().map(|error| error.mean[axis] * 1e3).collect());
        }
        for (axis, letter) in ["x", "y", "z"].into_iter().enumerate() {
            let uncertainty = |error: &abbe_volumetric::VolumetricError| error.covariance[axis][axis].sqrt() * 1e3;
            columns.numbers(format!("uncertainty_{letter}_um"), errors.iter().map(uncertainty).collect());
        }
        columns.finish()
    }

    /// Set-points with corrected commands, and what remains; `settings` are those of a correction, JSON.
    fn compensate(&self, py: Python<'_>, set_points: Bound<'_, PyAny>, settings: &str) -> PyResult<Columns> {
        let table = table_of(&set_points)?;
        let path = py.detach(|| self.compensated(&table, settings)).or_raise(py)?;
        let info = self.model.info();
        let mut columns = Collected::default();
        for axis in &info.axes {
            let (unit, factor) = match axis.kind {
                AxisKind::Linear => ("mm", 1.0),
                AxisKind::Rotary => ("deg", std::f64::consts::PI / 180.0),
            };
            let commands = path.statuses.chunks(info.status.len().max(1)).map(|pose| pose[axis.status] / factor);
            columns.numbers(format!("{}_{unit}", axis.name), commands.collect());
        }
        let found = &path.corrections;
        for (axis, letter) in ["x", "y", "z"].into_iter().enumerate() {
            columns.numbers(format!("before_{letter}_um"), found.iter().map(|it| it.before.tip[axis] * 1e3).collect());
        }
        columns.numbers("before_axis_urad", found.iter().map(|it| it.before.angle() * 1e6).collect());
        for (axis, letter) in ["x", "y", "z"].into_iter().enumerate() {
            columns.numbers(format!("after_{letter}_um"), found.iter().map(|it| it.after.tip[axis] * 1e3).collect());
        }
        columns.numbers("after_axis_urad", found.iter().map(|it| it.after.angle() * 1e6).collect());
        columns.numbers("standard_uncertainty_um", path.uncertainties.iter().map(|it| it * 1e3).collect());
        columns.finish()
    }
}

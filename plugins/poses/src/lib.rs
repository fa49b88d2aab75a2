//! Artefact plugin `poses`: a target that is fixed to the table, seen in six degrees of freedom by an observer that is fixed
//! to the tool: a camera, the 6-dof probe of a laser tracker, an R-test.
//!
//! With the tool at (R, p), the target at (Rg, pg) in the table frame, and the observer at (Rc, pc) in the tool frame, the
//! target stands at `Rc' (R' (pg - p) - pc)` in the observer's frame and is turned by `Rc' R' Rg`. A row has six equations:
//! observed minus predicted position, and the rotation vector from predicted to observed orientation.

mod observed;
mod positions;
mod rtest;
mod start;

use std::path::PathBuf;
use std::sync::Arc;

use abbe_core::{
    AboveZero, Artefact, ColumnHeader, Context, DataRow, Dataset, InputFile, KinematicModel, Layout, Observations,
    Quantity, Result, SettingsError, Target, plain_naming, pose_columns, positive,
};
use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use crate::observed::Observed;

abbe_core::register!(
    Artefact,
    "poses",
    "six-degree-of-freedom poses of a target on the table: cameras, laser trackers, R-tests",
    Settings,
    example,
    build,
    "../reference/artefact-poses.md",
);

/// Settings of the poses.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Settings {
    /// Standard uncertainty of each coordinate of an observed position.
    #[schemars(with = "AboveZero")]
    standard_uncertainty_um: f64,
    /// Standard uncertainty of each component of an observed orientation, as a small rotation.
    #[schemars(with = "AboveZero")]
    standard_uncertainty_urad: f64,
    /// Which pose a data row has.
    #[serde(default)]
    pose: Pose,
    /// Whether the place of the observer in the tool frame is estimated, or the observer is the tool.
    #[serde(default)]
    observer: Observer,
}

/// Which pose a data row has.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
enum Pose {
    /// The pose of the target, in the frame of the observer.
    #[default]
    TargetInObserver,
    /// The pose of the observer, in the frame of the target.
    ObserverInTarget,
}

/// Whether the place of the observer is estimated.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
enum Observer {
    /// Its place in the tool frame is estimated: `observer.x`, `.y`, `.z`, `.a`, `.b`, `.c`.
    #[default]
    Estimated,
    /// Its frame is the tool frame.
    AtTool,
}

/// How far the norm of a quaternion may be from 1 before it is taken for a mistake and not for rounding.
const NORM_TOLERANCE: f64 = 1e-2;

const POSITION: [&str; 3] = ["x", "y", "z"];
const ORIENTATION: [&str; 4] = ["qw", "qx", "qy", "qz"];

fn example() -> Value {
    json!({ "standard_uncertainty_um": 20.0, "standard_uncertainty_urad": 50.0, "observer": "estimated" })
}

fn build(settings: Settings, _: &Context) -> Result<Box<dyn Artefact>, SettingsError> {
    positive("standard_uncertainty_um", settings.standard_uncertainty_um)?;
    positive("standard_uncertainty_urad", settings.standard_uncertainty_urad)?;
    Ok(Box::new(Poses { settings }))
}

struct Poses {
    settings: Settings,
}

impl Artefact for Poses {
    fn inputs(&self) -> Vec<InputFile> {
        Vec::new()
    }

    fn check(&self, headers: &[ColumnHeader], file: Option<&PathBuf>, model: &dyn KinematicModel) -> Result<()> {
        pose_columns(headers, file, model, &plain_naming)?;
        abbe_table::require(headers, file, &POSITION.map(|name| (name, Quantity::Length)))?;
        abbe_table::require(headers, file, &ORIENTATION.map(|name| (name, Quantity::Ratio)))
    }

    fn observe(&self, data: &Arc<Dataset>, model: &Arc<dyn KinematicModel>) -> Result<Arc<dyn Observations>> {
        let model = model.as_ref();
        let observed = read(data)?;
        let mut layout = Layout::new(data, model, &[&plain_naming])?;
        let Settings { standard_uncertainty_um: um, standard_uncertainty_urad: urad, pose, observer } = self.settings;
        let (position, turn) = (um * 1e-3, urad * 1e-6);
        for row in data.row_indices() {
            layout.push(model, row, &[position, position, position, turn, turn, turn])?;
        }
        let tools = nominal_tools(&layout, model)?;
        let targets: Vec<Isometry3<f64>> = match pose {
            Pose::TargetInObserver => observed.clone(),
            Pose::ObserverInTarget => observed.iter().map(Isometry3::inverse).collect(),
        };
        let start = match observer {
            Observer::Estimated => start::target_and_observer(&tools, &targets),
            Observer::AtTool => start::target(&tools, &targets),
        };
        let start = start.map_err(|error| match data.files.first() {
            Some(file) => error.in_file(file),
            None => error,
        })?;
        Ok(Arc::new(Observed::new(layout, observed, pose, observer, start)))
    }

    fn targets(&self, _: f64) -> Result<Vec<Target>> {
        // The tip is not sent to features: the poses from which the target is seen are the programme.
        Ok(Vec::new())
    }
}

/// The observed pose of every data row, mm.
fn read(data: &Dataset) -> Result<Vec<Isometry3<f64>>> {
    let positions = abbe_table::points(data, POSITION)?;
    let mut parts = Vec::new();
    for name in ORIENTATION {
        parts.push(abbe_table::numbers(data, name, Quantity::Ratio)?);
    }
    let rows = DataRow::enumerate(positions);
    rows.map(|(row, position)| {
        let quaternion = Quaternion::new(parts[0][row], parts[1][row], parts[2][row], parts[3][row]);
        let norm = quaternion.norm();
        if (norm - 1.0).abs() > NORM_TOLERANCE {
            let message = format!("the quaternion qw, qx, qy, qz has the norm {norm:.4}; 1 was expected");
            return Err(data.error_at(row, message));
        }
        Ok(Isometry3::from_parts(Translation3::from(position), UnitQuaternion::from_quaternion(quaternion)))
    })
    .collect()
}

/// Where the nominal machine has the tool at every pose, table frame.
fn nominal_tools(layout: &Layout, model: &dyn KinematicModel) -> Result<Vec<Isometry3<f64>>> {
    let statuses: Vec<f64> = layout.poses.indices().flat_map(|pose| layout.poses.row(pose)).copied().collect();
    let nominal = &model.info().nominal;
    let mut poses = abbe_core::Poses::default();
    model.poses(&statuses, nominal, &[], true, &mut poses)?;
    Ok(tools(&poses.positions, &poses.orientations).collect())
}

/// Tool poses as rigid motions from the tool frame to the table frame.
fn tools(positions: &[[f64; 3]], orientations: &[[f64; 4]]) -> impl Iterator<Item = Isometry3<f64>> {
    positions.iter().zip(orientations).map(|(&position, &[w, x, y, z])| {
        let orientation = UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z));
        Isometry3::from_parts(Translation3::from(position), orientation)
    })
}

#[cfg(test)]
mod tests;

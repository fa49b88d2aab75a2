//! Artefact plugin `positions`: a target that the tool carries, seen as a point by an observer that stands still: a laser tracker
//! or a camera that follows a retroreflector on a robot.
//!
//! With the tip of the tool at p in the table frame, and the frame of the observer at (Ro, po) there, the observer sees the
//! target at `Ro' (p - po)`. A row has three equations: predicted minus observed coordinates. The target is the tip: where it is
//! in the tool is `dxt`, `dyt`, `dzt` of the machine.

use std::path::PathBuf;
use std::sync::Arc;

use abbe_core::{
    AboveZero, Artefact, ColumnHeader, Contact, Context, Dataset, Equations, Error, InputFile, KinematicModel, Layout,
    Observations, ObservationsInfo, Parameter, Quantity, Result, RowBatch, RowIndex, SettingsError, Target,
    plain_naming, pose_columns, positive,
};
use nalgebra::{Isometry3, Matrix3, Translation3, Vector3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use crate::observed::{OF_A_FRAME, Placed, matrix};
use crate::start::nearest_rotation;
use crate::{POSITION, nominal_tools};

abbe_core::register!(
    Artefact,
    "positions",
    "positions of a target on the tool, seen by a laser tracker or a camera: robots",
    Settings,
    example,
    build,
    "../reference/artefact-positions.md",
);

/// Settings of the positions.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Settings {
    /// Standard uncertainty of each coordinate of an observed position.
    #[schemars(with = "AboveZero")]
    standard_uncertainty_um: f64,
}

/// Largest part of their spread by which half of the positions may differ from the nominal machine: beyond, the data do not
/// belong to it.
const AGREEMENT: f64 = 0.2;

fn example() -> Value {
    json!({ "standard_uncertainty_um": 30.0 })
}

fn build(settings: Settings, _: &Context) -> Result<Box<dyn Artefact>, SettingsError> {
    positive("standard_uncertainty_um", settings.standard_uncertainty_um)?;
    Ok(Box::new(Positions { settings }))
}

struct Positions {
    settings: Settings,
}

impl Artefact for Positions {
    fn inputs(&self) -> Vec<InputFile> {
        Vec::new()
    }

    fn check(&self, headers: &[ColumnHeader], file: Option<&PathBuf>, model: &dyn KinematicModel) -> Result<()> {
        pose_columns(headers, file, model, &plain_naming)?;
        abbe_table::require(headers, file, &POSITION.map(|name| (name, Quantity::Length)))
    }

    fn observe(&self, data: &Arc<Dataset>, model: &Arc<dyn KinematicModel>) -> Result<Arc<dyn Observations>> {
        let model = model.as_ref();
        let observed: Vec<Vector3<f64>> = abbe_table::points(data, POSITION)?.into_iter().map(Vector3::from).collect();
        let mut layout = Layout::new(data, model, &[&plain_naming])?;
        let uncertainty = self.settings.standard_uncertainty_um * 1e-3;
        for row in data.row_indices() {
            layout.push(model, row, &[uncertainty; 3])?;
        }
        let tips: Vec<Vector3<f64>> =
            nominal_tools(&layout, model)?.iter().map(|tool| tool.translation.vector).collect();
        let start = observer(&tips, &observed).map_err(|error| match data.files.first() {
            Some(file) => error.in_file(file),
            None => error,
        })?;
        Ok(Arc::new(Observed::new(layout, observed, start)))
    }

    fn targets(&self, _: f64) -> Result<Vec<Target>> {
        // The tip is not sent to features: the poses in which the target is seen are the programme.
        Ok(Vec::new())
    }
}

/// Where the observer stands in the table frame, so that the tips (table frame) come as near to what it sees as they can
/// (least squares; Umeyama 1991, IEEE Trans. PAMI 13:376, without a scale).
///
/// Fails if all tips are on a line, or if the observer sees something else.
fn observer(tips: &[Vector3<f64>], seen: &[Vector3<f64>]) -> Result<Isometry3<f64>> {
    let mean = |points: &[Vector3<f64>]| points.iter().sum::<Vector3<f64>>() / points.len() as f64;
    let (of_tips, of_seen) = (mean(tips), mean(seen));
    let mut product = Matrix3::zeros();
    for (tip, seen) in tips.iter().zip(seen) {
        product += (tip - of_tips) * (seen - of_seen).transpose();
    }
    let values = product.singular_values();
    let rotation = nearest_rotation(product).filter(|_| values[1] > 1e-9 * values[0]);
    let rotation = rotation.ok_or_else(|| {
        Error::data("the positions do not determine where the observer stands")
            .help("at least three poses are needed whose tips are not on one line")
    })?;
    let start = Isometry3::from_parts(Translation3::from(of_tips - rotation * of_seen), rotation);
    let spread = tips.iter().map(|tip| (tip - of_tips).norm_squared()).sum::<f64>() / tips.len() as f64;
    let mut off: Vec<f64> = tips
        .iter()
        .zip(seen)
        .map(|(tip, seen)| (tip - start.rotation * seen - start.translation.vector).norm())
        .collect();
    off.sort_by(f64::total_cmp);
    let median = off[off.len() / 2];
    if median <= AGREEMENT * spread.sqrt() {
        return Ok(start);
    }
    let message = format!(
        "wherever the observer stands, half of the positions are {median:.0} mm or more off those of the machine, whose tips spread over {:.0} mm",
        spread.sqrt()
    );
    Err(Error::data(message).help(
        "do all joints turn the way that the model says (`reverse`), are their zeros and the unit of the positions right, and is the observer's frame right-handed?",
    ))
}

/// Observed positions.
struct Observed {
    info: ObservationsInfo,
    /// The observed position of every row, mm.
    observed: Vec<Vector3<f64>>,
    start: Isometry3<f64>,
}

impl Observed {
    fn new(layout: Layout, observed: Vec<Vector3<f64>>, start: Isometry3<f64>) -> Self {
        let unknowns = OF_A_FRAME.map(|(own, unit)| Parameter::new(format!("observer.{own}"), unit));
        let contact = Contact::Readings(POSITION.map(str::to_owned).into());
        let [x, y, z] = start.translation.vector.into();
        let info = ObservationsInfo {
            start: vec![x, y, z, 0.0, 0.0, 0.0],
            ..ObservationsInfo::new(layout, unknowns.into(), contact)
        };
        Self { info, observed, start }
    }
}

impl Observations for Observed {
    fn info(&self) -> &ObservationsInfo {
        &self.info
    }

    fn evaluate(&self, batch: RowBatch<'_>, out: &mut Equations) -> Result<()> {
        let observer = Placed::at(&self.start, batch.own);
        let to_observer = matrix(&observer.pose.rotation).transpose();
        for (&RowIndex(row), &tip) in batch.rows.iter().zip(batch.positions) {
            let from_observer = Vector3::from(tip) - observer.pose.translation.vector;
            let residual = to_observer * from_observer - self.observed[row];
            let by_turn = to_observer * from_observer.cross_matrix() * observer.turn;
            for equation in 0..3 {
                let by_shift = [0, 1, 2].map(|i| to_observer[(equation, i)]);
                out.equation(residual[equation]);
                out.position(by_shift);
                by_shift.iter().enumerate().for_each(|(unknown, derivative)| out.own(unknown, -derivative));
                (0..3).for_each(|turn| out.own(3 + turn, by_turn[(equation, turn)]));
            }
        }
        Ok(())
    }
}

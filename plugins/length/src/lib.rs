//! Artefact plugin `length`: lengths between two poses, calibrated or not.
//!
//! Equation: `|p2 - p1| - L = 0` with the tip positions of both ends in the table frame. L is the reference of the row, a
//! known input, or an unknown of the artefact. One calibrated length is what gives a self-calibration its scale.

use std::path::PathBuf;
use std::sync::Arc;

use abbe_core::{
    Absent, Artefact, Axis, AxisKind, Build, ColumnHeader, Constructor, Contact, Context, Dataset, Equations, Error,
    Feature, InputFile, KinematicModel, KnownInput, Layout, Observations, Parameter, Plugin, PoseValues, Poses,
    Quantity, Result, SettingsError, StatusColumn, Target, Unit, inventory, pose_columns, positive,
};
use nalgebra::Vector3;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

inventory::submit! {
    Plugin::built_in(
        "length",
        "lengths between two poses: scale bars, laser interferometer, step gauges",
        abbe_core::schema_of::<Settings>,
        example,
        Build::Artefact(Constructor::Static(build)),
    )
}

/// Settings of the lengths.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Settings {
    /// Standard uncertainty of one measured length.
    standard_uncertainty_um: f64,
    /// Whether the length is known (column `reference_mm`) or estimated: `length`, or `bar[1].length` for every label
    /// of the column `bar`.
    #[serde(default)]
    length: Length,
    /// Standard uncertainty of the calibration of the known length, shared by all rows.
    #[serde(default)]
    reference_standard_uncertainty_um: f64,
}

/// What is known of the length.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
enum Length {
    /// It stands in the column `reference_mm`.
    #[default]
    Known,
    /// It is an unknown of the artefact.
    Estimated,
}

fn example() -> Value {
    json!({ "standard_uncertainty_um": 0.9 })
}

fn build(settings: &Value, _: &Context) -> Result<Box<dyn Artefact>, SettingsError> {
    let settings: Settings = abbe_core::from_settings(settings)?;
    positive("standard_uncertainty_um", settings.standard_uncertainty_um)?;
    Ok(Box::new(Lengths { settings }))
}

struct Lengths {
    settings: Settings,
}

/// The columns of one end: `X1`, `B1` or, if it is the same at both ends, `B`; `dir1_X`. Rotary axes that the file does
/// not mention stand at zero.
fn naming(end: usize) -> impl Fn(&StatusColumn, Option<&Axis>) -> (Vec<String>, Absent) {
    move |status, axis| {
        let name = &status.name;
        let numbered = match name.strip_prefix("dir_") {
            Some(axis) => format!("dir{end}_{axis}"),
            None => format!("{name}{end}"),
        };
        match axis.map(|axis| axis.kind) {
            Some(AxisKind::Linear) => (vec![numbered], status.absent),
            Some(AxisKind::Rotary) => (vec![numbered, name.clone()], Absent::Taken(0.0)),
            None => (vec![numbered, name.clone()], status.absent),
        }
    }
}

impl Artefact for Lengths {
    fn inputs(&self) -> Vec<InputFile> {
        Vec::new()
    }

    fn check(&self, headers: &[ColumnHeader], file: Option<&PathBuf>, model: &dyn KinematicModel) -> Result<()> {
        pose_columns(headers, file, model, &naming(1))?;
        pose_columns(headers, file, model, &naming(2))?;
        match self.settings.length {
            Length::Known => abbe_table::require(headers, file, &[("reference", Quantity::Length)]),
            Length::Estimated => Ok(()),
        }
    }

    fn observe(&self, data: &Arc<Dataset>, model: &dyn KinematicModel) -> Result<Arc<dyn Observations>> {
        let mut layout = Layout::new(data, model, &[&naming(1), &naming(2)])?;
        for row in 0..data.rows() {
            layout.push(model, row, &[self.settings.standard_uncertainty_um * 1e-3])?;
        }
        if layout.rows.is_empty() {
            return Err(Error::data("there is no length"));
        }
        let known = self.settings.length == Length::Known;
        let references = if known { data.required_numbers("reference")?.to_vec() } else { vec![0.0; data.rows()] };
        if let Some(row) = references.iter().position(|reference| known && *reference <= 0.0) {
            return Err(data.error_at(row, format!("the reference length is {} mm", references[row])));
        }
        let mut lengths = Measured {
            layout,
            unknowns: Vec::new(),
            start: Vec::new(),
            inputs: Vec::new(),
            references,
            own: Vec::new(),
        };
        match self.settings.length {
            Length::Estimated => lengths.estimate(model)?,
            Length::Known => lengths.inputs.push(KnownInput {
                // Added to the reference of every row: zero unless the calibration is off.
                parameter: Parameter { name: "reference_error".to_owned(), unit: Unit::MM },
                value: 0.0,
                standard_uncertainty: self.settings.reference_standard_uncertainty_um * 1e-3,
            }),
        }
        Ok(Arc::new(lengths))
    }

    fn targets(&self, _: f64) -> Result<Vec<Target>> {
        // Lengths lie anywhere in the workspace: the data rows are the programme.
        Ok(Vec::new())
    }
}

/// Measured lengths.
struct Measured {
    layout: Layout,
    unknowns: Vec<Parameter>,
    start: Vec<f64>,
    inputs: Vec<KnownInput>,
    references: Vec<f64>,
    /// The unknown of every row, if lengths are estimated.
    own: Vec<usize>,
}

impl Measured {
    /// Makes the lengths unknown, starting from what the nominal machine measures.
    fn estimate(&mut self, model: &dyn KinematicModel) -> Result<()> {
        let data = self.layout.data.clone();
        let bars = data.labels("bar");
        let mut counts: Vec<f64> = Vec::new();
        let mut poses = Poses::default();
        let nominal = vec![0.0; model.parameters().len()];
        for (row, layout) in self.layout.rows.iter().enumerate() {
            let name = bars.map_or("length".to_owned(), |bars| format!("bar[{}].length", bars[row]));
            let own = self.unknowns.iter().position(|unknown| unknown.name == name).unwrap_or_else(|| {
                self.unknowns.push(Parameter { name, unit: Unit::MM });
                self.start.push(0.0);
                counts.push(0.0);
                self.unknowns.len() - 1
            });
            self.own.push(own);
            let ends =
                [self.layout.poses.row(layout.first_pose), self.layout.poses.row(layout.first_pose + 1)].concat();
            model.evaluate(&ends, &nominal, &[], false, &mut poses)?;
            self.start[own] += (Vector3::from(poses.positions[1]) - Vector3::from(poses.positions[0])).norm();
            counts[own] += 1.0;
        }
        for (start, count) in self.start.iter_mut().zip(counts) {
            *start /= count;
        }
        Ok(())
    }
}

impl Observations for Measured {
    fn layout(&self) -> &Layout {
        &self.layout
    }

    fn unknowns(&self) -> &[Parameter] {
        &self.unknowns
    }

    fn start(&self) -> Vec<f64> {
        self.start.clone()
    }

    fn inputs(&self) -> &[KnownInput] {
        &self.inputs
    }

    fn evaluate(&self, rows: &[usize], poses: PoseValues<'_>, own: &[f64], inputs: &[f64], out: &mut Equations) {
        for (&row, ends) in rows.iter().zip(poses.positions.chunks_exact(2)) {
            let between = Vector3::from(ends[1]) - Vector3::from(ends[0]);
            let direction = between.normalize();
            match self.own.get(row) {
                Some(&unknown) => {
                    out.equation(between.norm() - own[unknown]);
                    out.own(unknown, -1.0);
                }
                None => {
                    out.equation(between.norm() - self.references[row] - inputs[0]);
                    out.input(0, -1.0);
                }
            }
            out.position((-direction).into());
            out.position(direction.into());
        }
    }

    fn features(&self) -> Vec<Feature> {
        Vec::new()
    }

    fn contact(&self) -> Contact {
        Contact::LinearAxes
    }
}

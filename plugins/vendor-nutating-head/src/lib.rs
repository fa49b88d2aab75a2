//! A vendor's plugin library: a machine with three linear axes and a head whose B axis is tilted by 45 degrees.
//!
//! From the bed: X, Y, Z, then B about a line tilted in the YZ plane, then the tool along -Z. The vendor's parameters are not
//! those of ISO 230-1: the error of the tilt, the offset of the B line from the spindle, the zero of B, and the tool. All are
//! exact, and every derivative is analytic.

use std::sync::Arc;

use abbe_plugin::sdk::*;
use nalgebra::{UnitQuaternion, Vector3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

abbe_plugin::export!(Plugin::built_in(
    "vendor-nutating-head",
    "three linear axes and a nutating head, with the vendor's own parameters",
    schema_of::<Settings>,
    example,
    Build::Model(Constructor::Static(build)),
));

/// Settings of the machine.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(crate = "abbe_plugin::sdk::serde", deny_unknown_fields)]
#[schemars(crate = "abbe_plugin::sdk::schemars")]
struct Settings {
    /// Distance from the axis line of B to the tip, along the spindle.
    tool_length_mm: f64,
    /// Tilt of the axis line of B against the spindle.
    #[serde(default = "default_tilt")]
    tilt_deg: f64,
    /// Effective stylus radius.
    #[serde(default)]
    stylus_radius_mm: f64,
}

fn default_tilt() -> f64 {
    45.0
}

fn example() -> Value {
    json!({ "tool_length_mm": 180.0, "tilt_deg": 45.0 })
}

fn build(settings: &Value, _: &Context) -> Result<Box<dyn Model>, SettingsError> {
    let settings: Settings = from_settings(settings)?;
    positive("tool_length_mm", settings.tool_length_mm)?;
    not_negative("stylus_radius_mm", settings.stylus_radius_mm)?;
    if !(settings.tilt_deg > 0.0 && settings.tilt_deg < 90.0) {
        return Err(SettingsError::new("tilt_deg", "an angle between 0 and 90 was expected"));
    }
    Ok(Box::new(Description(Arc::new(NutatingHead::new(settings)))))
}

struct Description(Arc<NutatingHead>);

impl Model for Description {
    fn build(&self, _: &[&Dataset]) -> Result<Arc<dyn KinematicModel>> {
        Ok(self.0.clone())
    }
}

/// The vendor's parameters, in order.
const PARAMETERS: [(&str, Unit); 8] = [
    ("tilt", Unit::RAD),
    ("b_zero", Unit::RAD),
    ("b_offset.x", Unit::MM),
    ("b_offset.y", Unit::MM),
    ("b_offset.z", Unit::MM),
    ("dxt", Unit::MM),
    ("dyt", Unit::MM),
    ("dzt", Unit::MM),
];

struct NutatingHead {
    settings: Settings,
    info: ModelInfo,
}

impl NutatingHead {
    fn new(settings: Settings) -> Self {
        let tilted = line(settings.tilt_deg.to_radians());
        let axis = |(status, (name, direction)): (usize, (&str, Vector3<f64>))| Axis {
            name: name.to_owned(),
            kind: if name == "B" { AxisKind::Rotary } else { AxisKind::Linear },
            branch: Branch::Tool,
            sense: 1.0,
            direction: direction.into(),
            range: None,
            indexed: false,
            endless: false,
            status,
        };
        let named = [("X", Vector3::x()), ("Y", Vector3::y()), ("Z", Vector3::z()), ("B", tilted)];
        let axes: Vec<Axis> = named.into_iter().enumerate().map(axis).collect();
        let status = axes.iter().enumerate().map(|(index, axis)| StatusColumn {
            name: axis.name.clone(),
            role: StatusRole::Command(index),
            quantity: if axis.kind == AxisKind::Rotary { Quantity::Angle } else { Quantity::Length },
            levels: Vec::new(),
            absent: Absent::Required,
        });
        let status = status.collect();
        let parameters = PARAMETERS.map(|(name, unit)| match name {
            "dxt" | "dyt" | "dzt" => Parameter::new(name, unit).with_role(ParameterRole::SetUp),
            _ => Parameter::new(name, unit),
        });
        let written = serde_json::to_value(&settings).unwrap_or_default();
        let info = ModelInfo {
            stylus_radius: settings.stylus_radius_mm,
            ..ModelInfo::new(axes, status, parameters.to_vec(), written)
        };
        Self { settings, info }
    }
}

/// The direction of the B line, tilted from Z to Y.
fn line(tilt: f64) -> Vector3<f64> {
    Vector3::new(0.0, tilt.sin(), tilt.cos())
}

impl KinematicModel for NutatingHead {
    fn info(&self) -> &ModelInfo {
        &self.info
    }

    fn evaluate(&self, batch: PoseBatch<'_>, out: PosesMut<'_>) -> Result<()> {
        let PoseBatch { statuses, values, wanted, orientation } = batch;
        let tilt = self.settings.tilt_deg.to_radians() + values[0];
        let along = line(tilt);
        // Perpendicular to the line, in the plane of the tilt: where the line goes when the tilt grows.
        let across = Vector3::new(0.0, tilt.cos(), -tilt.sin());
        let offset = Vector3::new(values[2], values[3], values[4]);
        let tool = Vector3::new(values[5], values[6], values[7] - self.settings.tool_length_mm);
        for (pose, status) in statuses.chunks_exact(4).enumerate() {
            let turn = UnitQuaternion::from_scaled_axis(along * (status[3] + values[1]));
            let arm = turn * (tool - offset);
            out.positions[pose] = (Vector3::new(status[0], status[1], status[2]) + offset + arm).into();
            if orientation {
                out.orientations[pose] = [turn.w, turn.i, turn.j, turn.k];
            }
            for (k, variable) in wanted.iter().enumerate() {
                // Rotation about the tilted line, turning of the line itself, displacement.
                let (turned, moved) = match *variable {
                    Variable::Command(3) | Variable::Parameter(1) => (along, Vector3::zeros()),
                    Variable::Command(axis) => (Vector3::zeros(), unit(axis)),
                    // d(exp(u q)) for u turning about u x du: the difference of that turn before and after the rotation.
                    Variable::Parameter(0) => {
                        let about = along.cross(&across);
                        (about - turn * about, Vector3::zeros())
                    }
                    Variable::Parameter(index @ 2..=4) => (Vector3::zeros(), unit(index - 2) - turn * unit(index - 2)),
                    Variable::Parameter(index) => (Vector3::zeros(), turn * unit(index - 5)),
                };
                let by = pose * wanted.len() + k;
                out.position_derivatives[by] = (turned.cross(&arm) + moved).into();
                if orientation {
                    out.rotation_derivatives[by] = turned.into();
                }
            }
        }
        Ok(())
    }
}

fn unit(component: usize) -> Vector3<f64> {
    let mut unit = Vector3::zeros();
    unit[component] = 1.0;
    unit
}

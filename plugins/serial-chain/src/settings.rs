//! The settings of a serial chain: what `machine.yaml` says, plus the errors to model.

use std::collections::BTreeMap;

use abbe_errors::{Body, Declaration};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use crate::robot::Robot;

/// Settings of a serial chain.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Settings {
    /// Name of the machine.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub name: Option<String>,
    /// The structural loop in the notation of ISO 10791-6, e.g. `w C' B' X' b Z Y (S) t`.
    #[serde(default)]
    pub chain: String,
    /// In the place of `chain`: a robot by Denavit-Hartenberg parameters or by the lines of its joints.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub robot: Option<Robot>,
    /// Nominal tool length: the tip is at (0, 0, -length) of the last tool-branch frame.
    pub tool_length_mm: f64,
    /// Effective stylus radius; 0 if nothing is touched.
    pub stylus_radius_mm: f64,
    /// Constant offset of the probe before the tool length.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub probe_offset_mm: Option<[f64; 3]>,
    /// Styli by number (column `stylus`); stylus 1 is the tool itself and need not be listed.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub styli: BTreeMap<String, Stylus>,
    /// Where the motion errors of the axes act.
    #[serde(default)]
    pub error_frame: ErrorFrame,
    /// Geometry of the axes by name. Settings that are left out follow from the letter of the axis.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub axes: BTreeMap<String, AxisSettings>,
    /// The errors of the machine; each line is one error family.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    #[schemars(schema_with = "errors_schema")]
    pub errors: Vec<Value>,
    /// Bodies between the frames of the machine, by name, that grow and bend with their temperatures without any fit (Soons 1993,
    /// eq. 3.56 to 3.62).
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub bodies: BTreeMap<String, Body>,
    /// Terms of the effective stylus radius, for every stylus: `r0` (the same in all directions), `delay` (by the feed),
    /// `lobe[cosM,J]` and `lobe[sinM,J]` (by the direction of contact: M periods around the tool axis, power J along it).
    /// Artefacts that are touched use them.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub probe: Vec<String>,
    /// Exact transforms, or the first-order form (Soons 1993, eq. 2.24-2.28), which shows the errors of linearising.
    #[serde(default)]
    pub evaluation: Evaluation,
}

/// A stylus: its nominal tip in the last tool-branch frame, as a point or as two offsets and a length.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Stylus {
    /// The nominal tip.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tip_mm: Option<[f64; 3]>,
    /// Offset of the tip along x.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub x_mm: Option<f64>,
    /// Offset of the tip along y.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub y_mm: Option<f64>,
    /// Length of the tool with this stylus: the tip is at -length along z.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub length_mm: Option<f64>,
}

impl Stylus {
    /// The nominal tip; none unless exactly one way of saying it is used, offsets being 0 where they are left out.
    pub fn tip(&self) -> Option<[f64; 3]> {
        match (self.tip_mm, self.length_mm) {
            (Some(tip), None) if self.x_mm.is_none() && self.y_mm.is_none() => Some(tip),
            (None, Some(length)) => Some([self.x_mm.unwrap_or(0.0), self.y_mm.unwrap_or(0.0), -length]),
            _ => None,
        }
    }
}

/// Geometry of one axis.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct AxisSettings {
    /// Range of commands of a linear axis.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub range_mm: Option<[f64; 2]>,
    /// Range of commands of a rotary axis.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub range_deg: Option<[f64; 2]>,
    /// The rotary axis turns without an end: rows may have commands outside its range.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub endless: bool,
    /// Direction in the machine frame, for tilted axes; otherwise it follows from the letter.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub direction: Option<[f64; 3]>,
    /// A point on the line of a rotary axis, machine coordinates with all axes at zero.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub point_mm: Option<[f64; 3]>,
    /// A positive command moves the axis the other way.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub reverse: bool,
    /// Where the motion errors of this axis act, if not as for the others.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub error_frame: Option<ErrorFrame>,
}

/// Where motion errors act.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum ErrorFrame {
    /// In the frame that moves with the axis.
    #[default]
    Moving,
    /// In the frame at its zero position.
    Fixed,
}

/// How poses are computed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Evaluation {
    /// Exact homogeneous transforms.
    #[default]
    Exact,
    /// Linear in the errors.
    FirstOrder,
}

fn errors_schema(_: &mut schemars::SchemaGenerator) -> schemars::Schema {
    schemars::json_schema!({
        "type": "array",
        "description": "The errors of the machine; each line is one error family.",
        "items": Declaration::schema(),
    })
}

pub fn schema() -> Value {
    abbe_core::schema_of::<Settings>()
}

pub fn example() -> Value {
    json!({
        "chain": "w C' B' X' b Z Y (S) t",
        "tool_length_mm": 326.674,
        "stylus_radius_mm": 3.0,
        "axes": { "X": { "range_mm": [-400, 400] }, "B": { "range_deg": [-90, 90], "point_mm": [0, 0, 0] } },
        "errors": [
            { "location": ["EA0B", "EC0B", "EX0C"] },
            { "polynomial": ["E?X"], "degrees": [1, 2, 3] },
            { "backlash": ["EXX", "EYY"] },
            { "drift": ["dzt"], "degrees": [1, 2], "time_s": { "": [0.0, 3600.0] } },
        ],
    })
}

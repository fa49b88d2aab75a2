//! Parameters of models and unknowns of artefacts: their names, their units, and what they are.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use abbe_settings::Unit;

/// What a parameter or an unknown is.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum ParameterRole {
    /// A coefficient of an error motion of an axis (ISO 230-1: `EXX`).
    Motion {
        /// The axis, by its index among [`ModelInfo::axes`](crate::ModelInfo::axes).
        axis: usize,
        /// 0..6: x, y, z, a, b, c.
        component: usize,
    },
    /// A coefficient of a position or orientation error of an axis (ISO 230-1: `EX0C`).
    Location {
        /// The axis, by its index among [`ModelInfo::axes`](crate::ModelInfo::axes).
        axis: usize,
        /// 0..6: x, y, z, a, b, c.
        component: usize,
    },
    /// A value that depends on the set-up and is not known beforehand: the offset of a tool, the zero of an instrument.
    SetUp,
    /// A parameter of the shape of a function that coefficients multiply: a wavelength.
    Shape,
    /// A number that multiplies errors which are known from elsewhere, as the factor of a body that temperatures bend. Its nominal value
    /// is not zero, but a machine without errors has none of them.
    Factor,
    /// The place or the size of a feature of an artefact.
    Feature,
    /// A coefficient of the effective stylus radius of a touching probe. Poses do not depend on it; artefacts that are touched do, by
    /// the inputs of [`KnownInput::of_model`](crate::KnownInput::of_model).
    Probe {
        /// The stylus, by its index among the levels of the column with the role [`StatusRole::Stylus`](crate::StatusRole::Stylus); 0 if there is none.
        stylus: usize,
        /// What it multiplies.
        term: ProbeTerm,
    },
    /// Something else.
    #[default]
    Other,
}

/// A term of the effective stylus radius: what a coefficient of it multiplies.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum ProbeTerm {
    /// One: the same in all directions.
    Radius,
    /// Minus the feed: the time from the contact to the recorded position.
    Delay,
    /// `Re((nx + i ny)^around) nz^along` of the surface's outward normal, seen from the probe.
    Cosine {
        /// Periods around the axis of the tool.
        around: u8,
        /// Power along it.
        along: u8,
    },
    /// `Im((nx + i ny)^around) nz^along`.
    Sine {
        /// Periods around the axis of the tool.
        around: u8,
        /// Power along it.
        along: u8,
    },
}

/// A parameter or an unknown: name, unit, and what it is.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Parameter {
    /// Name as in the conventions, e.g. `EXX[1]`.
    pub name: String,
    /// Unit of its value.
    pub unit: Unit,
    /// What it is.
    #[serde(default)]
    pub role: ParameterRole,
}

impl Parameter {
    /// A parameter with name and unit and the role [`ParameterRole::Other`].
    pub fn new(name: impl Into<String>, unit: Unit) -> Self {
        Self { name: name.into(), unit, role: ParameterRole::Other }
    }

    /// Sets its role.
    pub fn with_role(self, role: ParameterRole) -> Self {
        Self { role, ..self }
    }
}

//! What is corrected, how, and how far.

use abbe_core::{AxisKind, Error, KinematicModel, PathItem, Result, SettingsError, positive};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// What is corrected.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(from = "CorrectText", into = "CorrectText")]
#[schemars(with = "CorrectText")]
pub enum Correct {
    /// The tip, by all linear axes. The tool axis keeps its error.
    #[default]
    Position,
    /// The tip by the linear axes, and the tool axis by the rotary ones.
    FiveAxes,
    /// The tip, as well as these linear axes can.
    Axes(Vec<String>),
}

/// How [`Correct`] is written.
#[derive(Serialize, Deserialize, JsonSchema)]
#[serde(untagged, expecting = "`position`, `five-axes`, or a list of linear axes (`[X, Z]`) was expected")]
enum CorrectText {
    /// `position` or `five-axes`.
    Name(CorrectName),
    /// Names of linear axes.
    Axes(Vec<String>),
}

#[derive(Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
enum CorrectName {
    Position,
    FiveAxes,
}

impl From<CorrectText> for Correct {
    fn from(text: CorrectText) -> Self {
        match text {
            CorrectText::Name(CorrectName::Position) => Self::Position,
            CorrectText::Name(CorrectName::FiveAxes) => Self::FiveAxes,
            CorrectText::Axes(axes) => Self::Axes(axes),
        }
    }
}

impl From<Correct> for CorrectText {
    fn from(correct: Correct) -> Self {
        match correct {
            Correct::Position => Self::Name(CorrectName::Position),
            Correct::FiveAxes => Self::Name(CorrectName::FiveAxes),
            Correct::Axes(axes) => Self::Axes(axes),
        }
    }
}

/// How corrected commands are found.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Method {
    /// Newton's method on the exact kinematics.
    #[default]
    Exact,
    /// One step with the derivatives of the nominal machine, for the errors at the programmed command (Soons 1993, 2.3.5).
    FirstOrder,
}

/// What happens where a corrected command would leave the travel of its axis.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Travel {
    /// It is an error.
    #[default]
    Refuse,
    /// The axis stands at the end of its travel, and what remains of the error is told.
    Hold,
    /// It may do so, by as much as the correction: the control has limits of its own.
    Allow,
}

/// Settings of a correction.
#[derive(Debug, Clone, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Settings {
    /// What is corrected: `position`, `five-axes`, or a list of linear axes.
    #[serde(default)]
    pub correct: Correct,
    /// `exact`, or `first-order` to compare.
    #[serde(default)]
    pub method: Method,
    /// Weights of the components x, y, z of the tip in the table frame. They matter where less than three linear axes correct.
    #[serde(default)]
    pub weights: Option<[f64; 3]>,
    /// Only the component of the error in this direction of the table frame is corrected: the normal of a surface that is cut.
    #[serde(default)]
    pub sensitive_direction: Option<[f64; 3]>,
    /// Largest correction of the command of a rotary axis. Near a pole small errors of the tool axis ask for large ones.
    #[serde(default = "fifty")]
    pub largest_rotary_correction_mrad: f64,
    /// Largest correction of the tip; beyond it the errors are not believed.
    #[serde(default = "one")]
    pub largest_tip_correction_mm: f64,
    /// Largest correction of the tool axis.
    #[serde(default = "one")]
    pub largest_axis_correction_mrad: f64,
    /// What happens at the ends of travel.
    #[serde(default)]
    pub travel: Travel,
}

fn one() -> f64 {
    1.0
}

fn fifty() -> f64 {
    50.0
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            correct: Correct::default(),
            method: Method::default(),
            weights: None,
            sensitive_direction: None,
            largest_rotary_correction_mrad: fifty(),
            largest_tip_correction_mm: one(),
            largest_axis_correction_mrad: one(),
            travel: Travel::default(),
        }
    }
}

impl Settings {
    /// Refuses settings that are wrong for every machine.
    pub fn check(&self) -> Result<(), SettingsError> {
        positive("largest_rotary_correction_mrad", self.largest_rotary_correction_mrad)?;
        positive("largest_tip_correction_mm", self.largest_tip_correction_mm)?;
        positive("largest_axis_correction_mrad", self.largest_axis_correction_mrad)?;
        let wrong = |setting: &str, message: &str| Err(SettingsError::new(setting, message));
        if self.weights.is_some() && self.sensitive_direction.is_some() {
            return wrong("weights", "either weights or one sensitive direction were expected");
        }
        if self.weights.is_some_and(|weights| !weights.iter().all(|weight| weight.is_finite() && *weight > 0.0)) {
            return wrong("weights", "three positive numbers were expected");
        }
        if self.correct == Correct::FiveAxes && self.sensitive_direction.is_some() {
            return wrong(
                "sensitive_direction",
                "rotary axes move the tip in all directions: `five-axes` corrects them all",
            );
        }
        let length = |direction: [f64; 3]| direction.iter().map(|part| part * part).sum::<f64>().sqrt();
        if self.sensitive_direction.is_some_and(|direction| !(length(direction) > 0.0 && length(direction).is_finite()))
        {
            return wrong("sensitive_direction", "a direction was expected");
        }
        if matches!(&self.correct, Correct::Axes(axes) if axes.is_empty()) {
            return wrong("correct", "at least one linear axis was expected");
        }
        Ok(())
    }

    /// The axes whose commands are corrected: indices of linear ones, then of rotary ones. Spindles are not corrected.
    ///
    /// Fails for axes that the machine does not have, and for a named axis that is not linear.
    pub(crate) fn axes(&self, model: &dyn KinematicModel) -> Result<(Vec<usize>, Vec<usize>)> {
        let axes = &model.info().axes;
        let of_kind = |kind: AxisKind| {
            let found = axes.iter().enumerate().filter(move |(_, axis)| axis.kind == kind && !axis.indexed);
            found.map(|(index, _)| index).collect::<Vec<_>>()
        };
        match &self.correct {
            Correct::Position => Ok((of_kind(AxisKind::Linear), Vec::new())),
            Correct::FiveAxes => Ok((of_kind(AxisKind::Linear), of_kind(AxisKind::Rotary))),
            Correct::Axes(names) => {
                let mut linear = Vec::new();
                for (place, name) in names.iter().enumerate() {
                    let at = |mut error: Error| {
                        error.setting = vec![PathItem::Key("correct".to_owned()), PathItem::Index(place)];
                        error
                    };
                    let index = axes.iter().position(|axis| axis.name == *name);
                    let index = index.ok_or_else(|| {
                        let names = axes.iter().map(|axis| axis.name.as_str());
                        at(Error::usage(format!("the machine has no axis {name}")).suggest(name, names))
                    })?;
                    if axes[index].kind != AxisKind::Linear {
                        let error = Error::usage(format!("{name} is a rotary axis; linear axes were expected"));
                        return Err(at(error.help("`five-axes` corrects with all axes")));
                    }
                    if linear.contains(&index) {
                        return Err(at(Error::usage(format!("{name} stands here twice"))));
                    }
                    linear.push(index);
                }
                Ok((linear, Vec::new()))
            }
        }
    }
}

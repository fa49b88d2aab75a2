//! What a recipe says of measurements that are to be chosen.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::settings::{Label, PathItem, SettingsError, positive};

/// The key `plan` of a recipe: which measurements to choose, and what makes a choice good.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Planning {
    /// The estimate that is planned. What it observes beside the candidates counts as measured already.
    pub estimate: String,
    /// The artefact stage whose rows there are to choose from.
    pub candidates: String,
    /// Column of labels whose rows are measured together (an indexation); without it every row is chosen by itself.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub by: Option<String>,
    /// How many to choose, required ones included.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub number: Option<usize>,
    /// Time that they may take together; the candidates have a column `duration_s`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub budget_s: Option<f64>,
    /// What makes a choice good.
    #[serde(default)]
    pub criterion: PlanningCriterion,
    /// Names or patterns of the unknowns that count; all of them unless said otherwise.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub parameters: Vec<String>,
    /// Whether a candidate may be measured more than once.
    #[serde(default)]
    pub replications: bool,
    /// Candidates that belong to the plan: labels of `by`, else numbers of data rows (`beams:113` where the data come from several files). One that stands twice is measured twice.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub required: Vec<Label>,
    /// Candidates that must not be chosen.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub forbidden: Vec<Label>,
    /// Random starts of the search.
    #[serde(default = "restarts")]
    pub restarts: u32,
    /// Seed of the random starts.
    #[serde(default)]
    pub seed: u64,
}

/// What makes a choice of measurements good (Soons 1993, section 4.2; Rahman 2016, Table 8-4).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
pub enum PlanningCriterion {
    /// Largest determinant of the information: smallest ellipsoid of all estimates together.
    #[default]
    D,
    /// Smallest mean variance of the estimates, each in units of its effect on the candidates.
    A,
    /// Smallest variance of the combination that is determined worst, in the same units.
    E,
    /// Smallest of the largest variances of what the candidates would measure.
    G,
    /// Smallest condition number of the equations with columns of norm 1.
    #[serde(rename = "condition")]
    Condition,
}

fn restarts() -> u32 {
    20
}

impl Planning {
    /// Refuses what no data can make right.
    pub fn check(&self) -> Result<(), SettingsError> {
        if self.number.is_none() && self.budget_s.is_none() {
            return Err(SettingsError::new("", "`number` or `budget_s` is missing: how many may be measured?"));
        }
        if self.number == Some(0) {
            return Err(SettingsError::new("number", "at least one was expected"));
        }
        if let Some(budget) = self.budget_s {
            positive("budget_s", budget)?;
        }
        if self.restarts == 0 {
            return Err(SettingsError::new("restarts", "at least one was expected"));
        }
        let both = self.required.iter().position(|required| self.forbidden.contains(required));
        match both {
            Some(index) => Err(SettingsError::new("", format!("{} is forbidden, too", self.required[index].0))
                .under([PathItem::Key("required".to_owned()), PathItem::Index(index)])),
            None => Ok(()),
        }
    }
}

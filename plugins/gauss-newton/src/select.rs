//! Leaves out terms that chance alone explains (Soons 1993, section 3.2.2): stepwise regression at the solution of all
//! unknowns. The settings of the selection by prediction are here, too.

use abbe_core::{
    Calibration, Error, Parts, PathItem, Problem, Result, Selection, SelectionDirection, SelectionStep, SettingsError,
    Unknown, Whole, matches,
};
use abbe_estimation::{ChangedParts, RowsInParts};
use abbe_numerics::{Factor, LeastSquares, StepwiseDirection};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::GaussNewton;

/// Settings of the selection.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Select {
    /// The parameters of the machine that may be left out: names and patterns. By prediction, all that a pattern matches is left
    /// out together: `"*T_column*"` is a sensor, `"*:2]"` a time constant with all its states.
    pub(crate) candidates: Vec<String>,
    /// What decides: whether a parameter is significant in the fit, or whether runs that are left out are predicted as well without it.
    #[serde(default)]
    pub(crate) by: SelectBy,
    /// By prediction: the column of labels whose rows are left out together. Default: parts of the time.
    #[serde(default)]
    pub(crate) runs: Option<String>,
    /// By prediction, without `runs`: number of parts of the time from the first row to the last one. Default: 4.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) parts: Option<Whole<2, 100>>,
    /// By prediction: part by which predictions may be worse than the best ones, for fewer unknowns. Default: 0.02.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) worse: Option<f64>,
    /// By significance: a parameter is left out if its p-value (partial F test) is at least this. The p-value is the probability
    /// that a parameter seems as significant by chance alone. Default: 0.0001.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    level: Option<f64>,
    /// By significance: `backward` starts with all parameters and removes some; `forward` starts with none and adds some; `both`
    /// also removes added ones again. Default: `backward`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    direction: Option<SelectionDirection>,
}

/// What decides whether a candidate is left out.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum SelectBy {
    /// Whether chance alone explains it.
    #[default]
    Significance,
    /// Whether readings that the estimate has not seen are predicted as well without it.
    Prediction,
}

impl GaussNewton {
    /// The estimate of all unknowns, then the estimate of the significant ones.
    pub(crate) fn estimate_selected(&self, problem: &Problem, select: &Select, explained: bool) -> Result<Calibration> {
        let candidates = select.candidates(problem)?;
        let all = self.estimate_all(problem, false)?;
        let x = problem.values_of(&all);
        let weighted = self.weighted(problem)?;
        let weights = match self.settings.robust {
            Some(_) => self.iterate(&weighted, &x, None, &self.options(1e-6, true))?.robust,
            None => None,
        };
        let factor = weighted.factor(&x, weights.as_ref().map(|report| report.weights.as_slice()))?;
        let selection = select.select(problem, &candidates, (&factor, &x), all.fit.degrees_of_freedom)?;
        let mut calibration = self.estimate_all(&reduced(&problem.with_values(&x), &selection), explained)?;
        calibration.fit.selection = Some(selection);
        Ok(calibration)
    }

    /// The same of rows in parts that can be read again: what is selected follows from the triangle of all rows at the solution of all
    /// unknowns.
    pub(crate) fn selected_of_parts(
        &self,
        problem: &Problem,
        parts: &dyn Parts,
        select: &Select,
        explained: bool,
    ) -> Result<Calibration> {
        let candidates = select.candidates(problem)?;
        let all = self.all_of_parts(problem, parts, false)?;
        let x = problem.values_of(&all);
        let factor = RowsInParts::new(problem, parts).factor(&x, None)?;
        let selection = select.select(problem, &candidates, (&factor, &x), all.fit.degrees_of_freedom)?;
        let of_part = |_: usize, part: &Problem| Ok(reduced(part, &selection));
        let of_sample = |sample: &Problem| Ok(reduced(sample, &selection));
        let parts = ChangedParts::new(parts, &of_part).with_sample(&of_sample);
        let mut calibration = self.all_of_parts(&reduced(&problem.with_values(&x), &selection), &parts, explained)?;
        calibration.fit.selection = Some(selection);
        Ok(calibration)
    }
}

impl Select {
    /// Number of parts of the time.
    pub(crate) fn parts(&self) -> Whole<2, 100> {
        self.parts.unwrap_or(Whole::new(4))
    }

    /// Part by which predictions may be worse than the best ones.
    pub(crate) fn worse(&self) -> f64 {
        self.worse.unwrap_or(0.02)
    }

    fn level(&self) -> f64 {
        self.level.unwrap_or(1e-4)
    }

    /// Refuses settings that are read with another way to decide, or beside runs.
    fn check_read(&self) -> Result<(), SettingsError> {
        let of_significance = [("level", self.level.is_some()), ("direction", self.direction.is_some())];
        let of_prediction =
            [("runs", self.runs.is_some()), ("parts", self.parts.is_some()), ("worse", self.worse.is_some())];
        let (others, other) = match self.by {
            SelectBy::Prediction => (&of_significance[..], "significance"),
            SelectBy::Significance => (&of_prediction[..], "prediction"),
        };
        if let Some((setting, _)) = others.iter().find(|(_, is_set)| *is_set) {
            let message = format!("this belongs to a selection `by: {other}`");
            return Err(SettingsError::new(setting, message).help(format!("write `by: {other}`, or leave it out")));
        }
        match self.runs.is_some() && self.parts.is_some() {
            true => Err(SettingsError::new("parts", "`runs` says which rows are left out together, and not the time")
                .help("leave out `parts`, or `runs`")),
            false => Ok(()),
        }
    }

    /// Refuses settings that make no sense.
    pub fn check(&self) -> Result<(), SettingsError> {
        if !(self.level() > 0.0 && self.level() < 1.0) {
            return Err(SettingsError::new("level", "a probability between 0 and 1 was expected"));
        }
        if self.candidates.is_empty() {
            return Err(SettingsError::new("candidates", "there is nothing to choose from"));
        }
        if !(self.worse() >= 0.0 && self.worse() < 1.0) {
            return Err(SettingsError::new("worse", "a number from 0 to below 1 was expected"));
        }
        self.check_read()
    }

    /// Indices of the candidates among the unknowns of a problem.
    pub fn candidates(&self, problem: &Problem) -> Result<Vec<usize>> {
        let of_machine = |unknown: &&Unknown| unknown.is_of_machine();
        for (index, pattern) in self.candidates.iter().enumerate() {
            let mut unknowns = problem.unknowns.iter().filter(of_machine);
            if !unknowns.any(|unknown| matches(pattern, &unknown.name)) {
                let names = problem.unknowns.iter().filter(of_machine).map(|unknown| unknown.name.as_str());
                let mut error =
                    Error::usage(format!("`{pattern}` matches no parameter of the machine that is estimated"));
                error = error.suggest(pattern, names);
                error.setting = ["select", "candidates"].map(|key| PathItem::Key(key.to_owned())).to_vec();
                error.setting.push(PathItem::Index(index));
                return Err(error);
            }
        }
        let chosen = |unknown: &Unknown| self.candidates.iter().any(|pattern| matches(pattern, &unknown.name));
        let unknowns = problem.unknowns.iter().enumerate();
        Ok(unknowns.filter(|(_, unknown)| of_machine(unknown) && chosen(unknown)).map(|(index, _)| index).collect())
    }

    /// The candidates that are kept, from the weighted rows at the solution `x` of all unknowns.
    pub fn select(
        &self,
        problem: &Problem,
        candidates: &[usize],
        (factor, x): (&Factor, &[f64]),
        degrees_of_freedom: usize,
    ) -> Result<Selection> {
        let direction = match self.direction.unwrap_or_default() {
            SelectionDirection::Backward => StepwiseDirection::Backward,
            SelectionDirection::Forward => StepwiseDirection::Forward,
            SelectionDirection::Both => StepwiseDirection::Both,
        };
        let found = factor.stepwise(x, candidates, degrees_of_freedom, self.level(), direction).ok_or_else(|| {
            Error::data("the significance of parameters cannot be told: some have no effect of their own")
                .setting("select")
        })?;
        let name = |unknown: usize| problem.unknowns[unknown].name.clone();
        let left_out = candidates.iter().copied().filter(|unknown| !found.kept.contains(unknown));
        Ok(Selection {
            level: self.level(),
            direction: self.direction.unwrap_or_default(),
            left_out: left_out.map(name).collect(),
            kept: found.kept.iter().copied().map(name).collect(),
            steps: found
                .steps
                .iter()
                .map(|step| SelectionStep {
                    parameter: name(step.term),
                    entered: step.entered,
                    probability: step.probability,
                })
                .collect(),
        })
    }
}

/// The problem without the terms that a selection leaves out.
pub fn reduced(problem: &Problem, selection: &Selection) -> Problem {
    without(problem, |unknown| selection.left_out.contains(&unknown.name))
}

/// The problem without some parameters of the machine: these are nominal, usually zero.
pub fn without(problem: &Problem, left_out: impl Fn(&Unknown) -> bool) -> Problem {
    let mut reduced = problem.without_unknowns(&left_out);
    let nominal = &problem.model.info().nominal;
    for unknown in problem.unknowns.iter().filter(|unknown| left_out(unknown)) {
        reduced.machine_values[unknown.index] = nominal[unknown.index];
    }
    reduced
}

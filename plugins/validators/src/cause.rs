//! Validator `cause`: which single error of the machine explains the residuals of a fit best.
//!
//! Every candidate is added to the unknowns of the fit by itself, linearised at the solution. Its share is the part by which
//! it reduces the weighted sum of squares. Fisher's F test with one and the remaining degrees of freedom shows whether that
//! is more than chance explains, at a level divided by the number of candidates (Bonferroni). So measurements that are
//! repeated long after a calibration show which part has worn (Soons 1993, section 5.1.1: a plate in three planes shows a
//! squareness).

use abbe_core::{
    AxisKind, Context, Dataset, Figure, Findings, Fit, KinematicModel, Owner, Problem, Result, SettingsError, Unknown,
    Validate, matches,
};
use abbe_estimation::Weighted;
use abbe_numerics::{CandidateTerm, f_test};
use schemars::JsonSchema;
use serde::Deserialize;
use serde_json::{Value, json};

use crate::figures::{ONE, ascii, outliers};

abbe_core::register!(
    Validate,
    "cause",
    "which single error of the machine explains the residuals of a fit best",
    Settings,
    example,
    build,
    "../reference/validate-cause.md",
);

/// Settings of the search.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Settings {
    /// The parameters of the machine that are tried as the cause. Default: all that the fit does not estimate.
    #[serde(default)]
    candidates: Vec<String>,
    /// Probability that a cause is named by chance alone.
    #[serde(default = "default_significance")]
    significance: f64,
}

fn default_significance() -> f64 {
    0.01
}

/// Difference of the explained sums of squares from which one cause counts as better than another, in units of the variance of
/// the residuals: a chi-squared variable with one degree of freedom exceeds it with a probability of 1 %.
const RIVAL: f64 = 6.63;

/// Causes that are shown.
const SHOWN: usize = 5;

fn example() -> Value {
    json!({ "candidates": ["E?0?"], "significance": 0.01 })
}

fn build(settings: Settings, _: &Context) -> Result<Box<dyn Validate>, SettingsError> {
    if !(settings.significance > 0.0 && settings.significance < 1.0) {
        return Err(SettingsError::new("significance", "a number between 0 and 1 was expected"));
    }
    Ok(Box::new(Cause { settings }))
}

struct Cause {
    settings: Settings,
}

impl Validate for Cause {
    fn needs_rows(&self) -> bool {
        true
    }

    fn validate(&self, fits: &[&Fit], _: &[&Dataset]) -> Result<Findings> {
        let mut findings = Findings::default();
        for fit in fits {
            self.judge(fit, &mut findings)?;
        }
        Ok(findings)
    }
}

impl Cause {
    /// The parameters that may be the cause.
    fn candidates(&self, problem: &Problem) -> Result<Vec<Unknown>> {
        let nominal = &problem.model.info().nominal;
        let known = |name: &str| problem.unknowns.iter().any(|unknown| unknown.name == name);
        let parameters = &problem.model.info().parameters;
        for (index, pattern) in self.settings.candidates.iter().enumerate() {
            if !parameters.iter().any(|parameter| matches(pattern, &parameter.name)) {
                let names = parameters.iter().map(|parameter| parameter.name.as_str());
                let mut error = abbe_core::Error::usage(format!("`{pattern}` matches no parameter of the machine"))
                    .suggest(pattern, names);
                error.setting =
                    vec![abbe_core::PathItem::Key("candidates".to_owned()), abbe_core::PathItem::Index(index)];
                return Err(error);
            }
        }
        let named = |name: &str| {
            self.settings.candidates.is_empty() || self.settings.candidates.iter().any(|pattern| matches(pattern, name))
        };
        let all = parameters.iter().enumerate();
        // A parameter that shapes a function, such as a wavelength, is no error.
        let chosen = all
            .filter(|(index, parameter)| nominal[*index] == 0.0 && named(&parameter.name) && !known(&parameter.name));
        Ok(chosen
            .map(|(index, parameter)| Unknown {
                name: parameter.name.clone(),
                unit: parameter.unit,
                owner: Owner::Machine,
                index,
            })
            .collect())
    }

    fn judge(&self, fit: &Fit, findings: &mut Findings) -> Result<()> {
        let solved = fit.problem.with_values(&fit.problem.values_of(&fit.calibration));
        let own = solved.unknowns.len();
        let mut problem = solved.clone();
        problem.unknowns.extend(self.candidates(&solved)?);
        let outliers = outliers(&solved, &fit.calibration);
        let kept: Vec<f64> = (problem.equation_rows().iter()).map(|row| f64::from(!outliers.contains(row))).collect();
        let factor = Weighted::new(&problem)?.factor(&problem.start(), Some(&kept))?;
        let left = factor.remaining_cost_of(own);
        let mut terms = factor.candidate_terms(own);
        terms.sort_by(|one, other| other.explained.total_cmp(&one.explained));
        let freedom = kept.iter().filter(|kept| **kept > 0.0).count().saturating_sub(own + 1);
        let Some(best) = terms.first().filter(|_| freedom > 0 && left > 0.0) else {
            findings
                .remarks
                .push(format!("{}: nothing is left to be explained, or nothing that could explain it", fit.name));
            return Ok(());
        };
        let test =
            |one: &CandidateTerm| one.explained / ((left - one.explained).max(f64::MIN_POSITIVE) / freedom as f64);
        let chance = |one: &CandidateTerm| f_test(test(one), 1, freedom).unwrap_or(1.0);
        for one in terms.iter().take(SHOWN) {
            let unknown = &problem.unknowns[one.unknown];
            let (unit, factor) = unknown.unit.for_people();
            let figure = |what: &str, value: f64, unit: &str| {
                Figure::new(&fit.name, format!("{what}[{}]", unknown.name), value, unit)
            };
            findings.figures.push(figure("change", one.value * factor, &ascii(&unit)));
            findings.figures.push(figure("share", one.explained / left, ONE));
            findings.figures.push(figure("F", test(one), ONE));
        }
        let level = self.settings.significance / terms.len() as f64;
        if chance(best) > level {
            findings
                .remarks
                .push(format!("{}: no single error explains the residuals better than chance does", fit.name));
            return Ok(());
        }
        // Of causes that the data cannot separate the simplest comes first: a location error before a motion error.
        let variance = (left - best.explained).max(f64::MIN_POSITIVE) / freedom as f64;
        let mut rivals: Vec<&CandidateTerm> =
            terms.iter().filter(|other| best.explained - other.explained < RIVAL * variance).collect();
        let model = problem.model.as_ref();
        rivals.sort_by_key(|one| meaning(&problem.unknowns[one.unknown].name, model).is_empty());
        let best = rivals[0];
        let unknown = &problem.unknowns[best.unknown];
        let (unit, scale) = unknown.unit.for_people();
        let same: Vec<&str> = rivals[1..].iter().map(|other| problem.unknowns[other.unknown].name.as_str()).collect();
        let same = if same.is_empty() { String::new() } else { format!("; so would {}", same.join(", ")) };
        findings.remarks.push(format!(
            "{}: {}{} changed by {:.3} {unit} explains {:.1} % of the residuals' sum of squares (F = {:.1}){same}",
            fit.name,
            unknown.name,
            meaning(&unknown.name, model),
            best.value * scale,
            100.0 * best.explained / left,
            test(best),
        ));
        Ok(())
    }
}

/// A location error in words: `, the squareness of Z,`.
fn meaning(name: &str, model: &dyn KinematicModel) -> String {
    let mut letters = name.chars();
    let (Some('E'), Some(component), Some('0')) = (letters.next(), letters.next(), letters.next()) else {
        return String::new();
    };
    let axis = letters.as_str();
    match model.info().axes.iter().find(|other| other.name == axis).map(|axis| axis.kind) {
        Some(AxisKind::Linear) if "ABC".contains(component) => format!(", the squareness of {axis},"),
        Some(_) => format!(", the location of {axis},"),
        None => String::new(),
    }
}

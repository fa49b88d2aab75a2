//! From calibrations to tests and series.

use std::collections::BTreeMap;

use abbe_core::{Calibration, ConsideredInput, Estimated, Result, Status, matches};
use abbe_numerics::chi_squared_upper_tail;
use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};

use crate::analysis::{Series, Target, Test};
use crate::change::Uncertain;
use crate::source::SharedInput;

/// A calibration with its place in time.
#[derive(Debug, Clone, Copy)]
pub struct Tested<'a> {
    /// What the test is called.
    pub label: &'a str,
    /// When it was.
    pub at: f64,
    /// Its result.
    pub calibration: &'a Calibration,
}

/// How good a test is as a whole.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Quality {
    /// What it is called.
    pub label: String,
    /// Number of equations.
    pub equations: usize,
    /// Numerical rank.
    pub rank: usize,
    /// Condition number.
    pub condition: f64,
    /// Weighted sum of squared residuals.
    pub chi_squared: f64,
    /// Degrees of freedom.
    pub degrees_of_freedom: usize,
    /// Probability of such residuals by chance.
    pub probability: f64,
    /// Whether it counts.
    pub good: bool,
}

impl Quality {
    /// That of a calibration; it is rejected below a probability. A robust loss would hide what is wrong with it.
    pub fn of(test: &Tested<'_>, rejected_below: f64) -> Self {
        let fit = &test.calibration.fit;
        let chi_squared = fit.sigma * fit.sigma * fit.degrees_of_freedom as f64;
        let probability = match fit.degrees_of_freedom {
            0 => 1.0,
            freedom => chi_squared_upper_tail(chi_squared, freedom as f64),
        };
        Self {
            label: test.label.to_owned(),
            equations: fit.observations,
            rank: fit.rank,
            condition: fit.condition,
            chi_squared,
            degrees_of_freedom: fit.degrees_of_freedom,
            probability,
            good: probability >= rejected_below,
        }
    }
}

/// A history as it is analysed.
#[derive(Debug, Clone)]
pub struct History {
    /// Every test.
    pub quality: Vec<Quality>,
    /// The tests.
    pub tests: Vec<Test>,
    /// The series, without regressors and rules.
    pub series: Vec<Series>,
    /// The covariance of all series at every test, without what the tests share.
    pub covariances: Vec<Option<DMatrix<f64>>>,
    /// What the tests share.
    pub inputs: Vec<SharedInput>,
    /// The identities of these inputs.
    pub identities: Vec<String>,
}

/// The history of the parameters that fit the patterns, from calibrations in the order of time. `baseline` has the targets: what
/// it does not estimate or state has none.
///
/// Fails for values of artefacts that were eliminated: their covariances are not known.
pub fn history(
    tests: &[Tested<'_>],
    baseline: Option<&Calibration>,
    patterns: &[String],
    rejected_below: f64,
) -> Result<History> {
    let quality: Vec<Quality> = tests.iter().map(|test| Quality::of(test, rejected_below)).collect();
    let names = names(tests, patterns);
    let own = || names.iter().map(|(name, _)| name.as_str());
    tests.iter().try_for_each(|test| test.calibration.check_covariance_of(own()))?;
    let shared = shared_inputs(tests, &names);
    let series = names.iter().enumerate().map(|(index, (name, unit))| Series {
        name: name.clone(),
        unit: unit.clone(),
        values: tests.iter().map(|test| value(test.calibration, name)).collect(),
        shared: shared.iter().map(|(input, u)| (input.sensitivities[index] * u).powi(2)).sum::<f64>().sqrt(),
        target: baseline.and_then(|baseline| target(baseline, name)),
        regressor: None,
        again: None,
        derived: false,
    });
    let series: Vec<Series> = series.collect();
    let covariance = |test: &Tested<'_>| {
        let order: Vec<&String> = names.iter().map(|(name, _)| name).collect();
        let mut own = test.calibration.covariance.block(&order);
        for (input, u) in &shared {
            let part = |row: usize, column: usize| input.sensitivities[row] * input.sensitivities[column] * u * u;
            own -= DMatrix::from_fn(names.len(), names.len(), part);
        }
        own.iter().all(|entry| entry.is_finite()).then_some(own)
    };
    Ok(History {
        tests: (tests.iter().zip(&quality))
            .map(|(test, quality)| Test { label: test.label.to_owned(), at: test.at, good: quality.good })
            .collect(),
        quality,
        covariances: tests.iter().map(covariance).collect(),
        identities: shared_identities(tests),
        inputs: shared.into_iter().map(|(input, _)| input).collect(),
        series,
    })
}

/// Names and units of what is estimated in a test and fits a pattern; without patterns the parameters of the machine.
fn names(tests: &[Tested<'_>], patterns: &[String]) -> Vec<(String, String)> {
    let mut names: Vec<(String, String)> = Vec::new();
    for calibration in tests.iter().map(|test| test.calibration) {
        let artefacts = calibration.artefacts.iter().filter(|_| !patterns.is_empty());
        for known in calibration.parameters.iter().chain(artefacts) {
            let fits = patterns.is_empty() || patterns.iter().any(|pattern| matches(pattern, &known.name));
            if known.status == Status::Estimated && fits && !names.iter().any(|(name, _)| *name == known.name) {
                names.push((known.name.clone(), known.unit.clone()));
            }
        }
    }
    names
}

fn known<'a>(calibration: &'a Calibration, name: &str) -> Option<&'a Estimated> {
    calibration.parameters.iter().chain(&calibration.artefacts).find(|known| known.name == name)
}

fn value(calibration: &Calibration, name: &str) -> Option<Uncertain> {
    let known = known(calibration, name).filter(|known| known.status == Status::Estimated)?;
    Some(Uncertain { value: known.value, standard_uncertainty: known.standard_uncertainty })
}

fn target(baseline: &Calibration, name: &str) -> Option<Target> {
    let known = known(baseline, name).filter(|known| known.status != Status::Confounded)?;
    Some(Target { value: known.value, standard_uncertainty: known.standard_uncertainty })
}

/// The inputs that all tests have, with their standard uncertainties. Sensitivities are means: those of tests of one programme
/// hardly differ.
fn shared_inputs(tests: &[Tested<'_>], names: &[(String, String)]) -> Vec<(SharedInput, f64)> {
    let found = inputs_of(tests);
    let sensitivity = |name: &str, inputs: &[(&Tested<'_>, &ConsideredInput)]| {
        let own = |(test, input): &(&Tested<'_>, &ConsideredInput)| {
            let place = test.calibration.covariance.index(name);
            place.and_then(|place| input.sensitivities.get(place)).copied().unwrap_or(0.0)
        };
        inputs.iter().map(own).sum::<f64>() / inputs.len() as f64
    };
    let shared = |inputs: Vec<(&Tested<'_>, &ConsideredInput)>| {
        let first = inputs[0].1;
        let sensitivities = names.iter().map(|(name, _)| sensitivity(name, &inputs)).collect();
        let input = SharedInput { name: first.name.clone(), unit: first.unit.clone(), sensitivities };
        (input, first.standard_uncertainty)
    };
    found.into_values().map(shared).collect()
}

/// Every input that all tests have, by its identity, with the tests.
fn inputs_of<'a>(tests: &'a [Tested<'a>]) -> BTreeMap<String, Vec<(&'a Tested<'a>, &'a ConsideredInput)>> {
    let mut found: BTreeMap<String, Vec<(&Tested<'_>, &ConsideredInput)>> = BTreeMap::new();
    for test in tests {
        for input in test.calibration.inputs.iter().flatten() {
            found.entry(input.identity.clone()).or_default().push((test, input));
        }
    }
    found.retain(|_, inputs| inputs.len() == tests.len() && inputs[0].1.standard_uncertainty > 0.0);
    found
}

fn shared_identities(tests: &[Tested<'_>]) -> Vec<String> {
    inputs_of(tests).into_keys().collect()
}

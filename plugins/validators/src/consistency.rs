//! Validator `consistency`: whether calibrations from independent data agree within their uncertainties.
//!
//! The difference d of the parameters that two fits have estimated has the covariance `C = C1 + C2 - C12 - C21`, and
//! `d^T C^-1 d` is a chi-squared quantity whose degrees of freedom are the number of nonzero eigenvalues of C (as in Soons
//! 1993, equations A.11 to A.15). C12 comes from the inputs that both share: a bar, a stylus, a certificate.

use std::collections::BTreeSet;
use std::path::Path;

use abbe_core::{
    ConsideredInput, Context, Dataset, Error, Estimated, Figure, Findings, Fit, Limit, NamedCovariance, PathItem,
    Problem, Result, SetIndex, SettingsError, Status, Validate, matches,
};
use abbe_numerics::{hotelling_quantile, hotelling_upper_tail};
use nalgebra::{DMatrix, DVector};
use schemars::JsonSchema;
use serde::Deserialize;
use serde_json::{Value, json};

use crate::figures::ONE;

abbe_core::register!(
    Validate,
    "consistency",
    "agreement of calibrations from independent data within their uncertainties",
    Settings,
    example,
    build,
    "../reference/validate-consistency.md",
);

/// Settings of the comparison.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Settings {
    /// Names or patterns of the machine parameters to compare. Default: all that both fits have estimated.
    #[serde(default)]
    parameters: Option<Vec<String>>,
    /// Probability that calibrations that agree fail.
    #[serde(default = "default_significance")]
    significance: f64,
}

fn default_significance() -> f64 {
    0.05
}

fn example() -> Value {
    json!({ "parameters": ["E*"], "significance": 0.05 })
}

fn build(settings: Settings, _: &Context) -> Result<Box<dyn Validate>, SettingsError> {
    if !(settings.significance > 0.0 && settings.significance < 1.0) {
        return Err(SettingsError::new("significance", "a number between 0 and 1 was expected"));
    }
    Ok(Box::new(Consistency { settings }))
}

/// Eigenvalues of the covariance scaled to unit diagonal below this part of the largest are zero.
const ZERO: f64 = 1e-12;

struct Consistency {
    settings: Settings,
}

impl Validate for Consistency {
    fn validate(&self, fits: &[&Fit], _: &[&Dataset]) -> Result<Findings> {
        let Some((first, others)) = fits.split_first().filter(|(_, others)| !others.is_empty()) else {
            return Err(
                Error::usage("two estimates or more were expected: they are compared with the first").setting("of")
            );
        };
        let mut findings = Findings::default();
        for other in others {
            self.judge(first, other, &mut findings)?;
        }
        Ok(findings)
    }
}

impl Consistency {
    fn judge(&self, first: &Fit, other: &Fit, findings: &mut Findings) -> Result<()> {
        let common = self.common(first, other, findings)?;
        let difference = Difference::new(first, other, &common)?;
        let Test { chi_squared, degrees_of_freedom, exact } = difference.test();
        let is_compared = |name: &str| common.iter().any(|(one, _)| one.name == name);
        let freedom = |fit: &Fit| fit.calibration.degrees_of_freedom(is_compared);
        let known_by = freedom(first).min(freedom(other));
        if degrees_of_freedom as f64 > known_by {
            return Err(Error::data(format!(
                "{} against {}: {degrees_of_freedom} parameters cannot be compared by a covariance that was found with {known_by:.1} \
                 degrees of freedom",
                other.name, first.name
            ))
            .help(format!("compare at most {:.0} `parameters`", known_by.floor()))
            .setting("parameters"));
        }
        let probability = match degrees_of_freedom {
            _ if chi_squared.is_infinite() => 0.0,
            0 => 1.0,
            quantities => hotelling_upper_tail(chi_squared, quantities, known_by),
        };
        let limit = match degrees_of_freedom {
            0 => 0.0,
            quantities => hotelling_quantile(1.0 - self.settings.significance, quantities, known_by),
        };
        // The test already contains the uncertainties: no other decision rule applies.
        let limit = limit.is_finite().then_some(Limit::from(limit));
        let normalised = difference.normalised();
        let largest = normalised.iter().copied().enumerate().max_by(|a, b| a.1.abs().total_cmp(&b.1.abs()));
        let (worst, largest) = largest.unwrap_or_default();
        findings.figures.extend([
            Figure::new(&other.name, "chi-squared", chi_squared, ONE).limited(limit),
            Figure::new(&other.name, "degrees of freedom", degrees_of_freedom as f64, ONE),
            Figure::new(&other.name, "probability", probability, ONE),
            Figure::new(&other.name, "largest normalised difference", largest.abs(), ONE),
        ]);
        let between = format!("{} against {}", other.name, first.name);
        findings.remarks.push(format!(
            "{between}: {} differs most, by {largest:+.1} of its standard uncertainties",
            common[worst].0.name
        ));
        if exact {
            findings.remarks.push(format!(
                "{between}: they differ in a direction in which neither of them has an uncertainty, so that \
                 chi-squared is infinite"
            ));
        }
        let inputs = first.calibration.shared_inputs(&other.calibration)?;
        let inputs: Vec<&str> = inputs.iter().map(|(one, _)| one.name.as_str()).collect();
        if !inputs.is_empty() {
            findings.remarks.push(format!("{between}: both share the errors of {}", listed(&inputs)));
        }
        let shared: Vec<String> =
            files(&first.problem).intersection(&files(&other.problem)).map(|file| file.display().to_string()).collect();
        if !shared.is_empty() {
            findings.remarks.push(format!(
                "{between}: both use rows of {}; the test takes their data as independent",
                shared.join(", ")
            ));
        }
        Ok(())
    }

    /// The parameters to compare, as the first and the other fit have them.
    fn common<'a>(
        &self,
        first: &'a Fit,
        other: &'a Fit,
        findings: &mut Findings,
    ) -> Result<Vec<(&'a Estimated, &'a Estimated)>> {
        let own = |parameter: &Estimated| parameter.status != Status::Fixed && parameter.status != Status::Considered;
        let pairs = (first.calibration.parameters.iter()).filter_map(|one| {
            let two = other.calibration.parameters.iter().find(|two| two.name == one.name)?;
            (own(one) && own(two)).then_some((one, two))
        });
        let mut common: Vec<(&Estimated, &Estimated)> = pairs.collect();
        if let Some(patterns) = &self.settings.parameters {
            for (index, pattern) in patterns.iter().enumerate() {
                if !common.iter().any(|(one, _)| matches(pattern, &one.name)) {
                    let message = format!(
                        "`{pattern}` matches no parameter that {} and {} both estimated",
                        first.name, other.name
                    );
                    let names = common.iter().map(|(one, _)| one.name.as_str());
                    let mut error = Error::usage(message).suggest(pattern, names);
                    error.setting = vec![PathItem::Key("parameters".to_owned()), PathItem::Index(index)];
                    return Err(error);
                }
            }
            common.retain(|(one, _)| patterns.iter().any(|pattern| matches(pattern, &one.name)));
        }
        if let Some((one, two)) = common.iter().find(|(one, two)| one.unit != two.unit) {
            return Err(Error::data(format!(
                "`{}` is in {} in {} and in {} in {}: the models differ",
                one.name, one.unit, first.name, two.unit, other.name
            )));
        }
        let confounded = |(one, two): &(&Estimated, &Estimated)| [one.status, two.status].contains(&Status::Confounded);
        let lost: Vec<&str> = common.iter().filter(|pair| confounded(pair)).map(|(one, _)| one.name.as_str()).collect();
        if !lost.is_empty() {
            findings.remarks.push(format!(
                "{} against {}: not compared, because the data of one cannot separate them: {}",
                other.name,
                first.name,
                lost.join(", ")
            ));
        }
        common.retain(|pair| !confounded(pair));
        if common.is_empty() {
            let message = format!("{} and {} estimated no parameter of the machine in common", first.name, other.name);
            return Err(Error::data(message));
        }
        Ok(common)
    }
}

/// The files that the rows of a problem come from.
fn files(problem: &Problem) -> BTreeSet<&Path> {
    let rows =
        SetIndex::enumerate(&problem.sets).flat_map(|(index, set)| set.rows.iter().map(move |row| (index, *row)));
    rows.filter_map(|(set, row)| Some(problem.origin(set, row)?.0)).collect()
}

/// The difference of two calibrations in some parameters.
struct Difference {
    /// Other less first, parameter units.
    values: Vec<f64>,
    /// Its covariance.
    covariance: DMatrix<f64>,
    /// The sum of both variances: rounding in the covariance is judged relative to it.
    variances: Vec<f64>,
}

/// Names for people, not too many.
fn listed(names: &[&str]) -> String {
    const SHOWN: usize = 6;
    let more = names.len().saturating_sub(SHOWN);
    let shown = names[..names.len() - more].join(", ");
    if more > 0 { format!("{shown} and {more} more") } else { shown }
}

/// The result of the test of a difference.
struct Test {
    /// Infinite, if there is a difference without uncertainty.
    chi_squared: f64,
    degrees_of_freedom: usize,
    /// There is a difference without uncertainty.
    exact: bool,
}

impl Difference {
    fn new(first: &Fit, other: &Fit, common: &[(&Estimated, &Estimated)]) -> Result<Self> {
        let names: Vec<&str> = common.iter().map(|(one, _)| one.name.as_str()).collect();
        let (of_first, of_other) = (&first.calibration.covariance, &other.calibration.covariance);
        let mut covariance = of_first.block(&names) + of_other.block(&names);
        let variances = covariance.diagonal().iter().copied().collect();
        for (one, two) in first.calibration.shared_inputs(&other.calibration)? {
            let of = |input: &ConsideredInput, known: &NamedCovariance| {
                let places = names.iter().map(|name| known.index(name));
                let values = places.map(|place| place.map_or(0.0, |place| input.sensitivities[place]));
                DVector::from_iterator(names.len(), values)
            };
            let (one, other) = (of(one, of_first), of(two, of_other));
            let shared = one * other.transpose() * two.standard_uncertainty.powi(2);
            covariance -= &shared + shared.transpose();
        }
        let values = common.iter().map(|(one, two)| {
            let difference = two.value - one.value;
            // A difference that is only rounding counts as zero.
            if difference.abs() > 1e-12 * one.value.abs().max(two.value.abs()) { difference } else { 0.0 }
        });
        Ok(Self { values: values.collect(), covariance, variances })
    }

    /// The variance of a difference; zero if only rounding remains.
    fn variance(&self, index: usize) -> f64 {
        let variance = self.covariance[(index, index)];
        if variance > ZERO * self.variances[index] { variance } else { 0.0 }
    }

    /// The differences divided by their standard uncertainties; infinite without an uncertainty.
    fn normalised(&self) -> Vec<f64> {
        let normalised = |(index, value): (usize, &f64)| match (*value, self.variance(index)) {
            (0.0, _) => 0.0,
            (value, variance) => value / variance.max(0.0).sqrt(),
        };
        self.values.iter().enumerate().map(normalised).collect()
    }

    /// Chi-squared with the pseudo-inverse of the covariance, scaled to unit diagonal.
    fn test(&self) -> Test {
        let normalised = self.normalised();
        let certain: Vec<usize> = (0..self.values.len()).filter(|&index| self.variance(index) <= 0.0).collect();
        let uncertain: Vec<usize> = (0..self.values.len()).filter(|index| !certain.contains(index)).collect();
        let mut exact = certain.iter().any(|&index| normalised[index] != 0.0);
        let size = uncertain.len();
        let correlation = DMatrix::from_fn(size, size, |row, column| {
            let (row, column) = (uncertain[row], uncertain[column]);
            self.covariance[(row, column)] / (self.covariance[(row, row)] * self.covariance[(column, column)]).sqrt()
        });
        let difference = DVector::from_iterator(size, uncertain.iter().map(|&index| normalised[index]));
        let (mut chi_squared, mut degrees_of_freedom) = (0.0, 0);
        if size > 0 {
            let eigen = correlation.symmetric_eigen();
            // Terms that cancel in the covariance leave rounding in proportion to their size.
            let cancelled = uncertain.iter().map(|&index| self.variances[index] / self.variance(index));
            let zero = ZERO * cancelled.fold(eigen.eigenvalues.max(), f64::max);
            for (value, vector) in eigen.eigenvalues.iter().zip(eigen.eigenvectors.column_iter()) {
                let along = vector.dot(&difference).powi(2);
                if *value > zero {
                    chi_squared += along / value;
                    degrees_of_freedom += 1;
                } else {
                    // Ten standard deviations for the largest variance that counts as zero.
                    exact |= along > 100.0 * zero;
                }
            }
        }
        Test { chi_squared: if exact { f64::INFINITY } else { chi_squared }, degrees_of_freedom, exact }
    }
}

#[cfg(test)]
mod tests;

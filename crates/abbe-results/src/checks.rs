//! Whether a calibration that was read agrees with itself.

use std::collections::{BTreeMap, BTreeSet};

use abbe_settings::{Error, Result, Unit};
use nalgebra::DMatrix;

use crate::budget::{ParameterBudget, UncertaintyBudget};
use crate::covariance::NamedCovariance;
use crate::fit::{Calibration, ConsideredInput, Estimated, Status};

/// Relative difference of numbers that are the same, but for digits that somebody has rounded away.
const ROUNDED: f64 = 1e-3;

impl Calibration {
    /// Fails for the first of these values that was estimated and whose covariance with others is not known, since it was eliminated.
    ///
    /// Values that are not here, or not estimated, are no error.
    pub fn check_covariance_of<'a>(&self, names: impl IntoIterator<Item = &'a str>) -> Result<()> {
        if self.fit.eliminated == 0 {
            return Ok(());
        }
        let known: BTreeSet<&str> = self.covariance.order.iter().map(String::as_str).collect();
        let estimated = self.artefacts.iter().filter(|own| own.status == Status::Estimated);
        let without: BTreeSet<&str> =
            estimated.map(|own| own.name.as_str()).filter(|name| !known.contains(name)).collect();
        names.into_iter().find(|name| without.contains(name)).map_or(Ok(()), |name| {
            let estimate = &self.estimate;
            let message =
                format!("`{name}` has a standard uncertainty in `{estimate}` and no covariance: it was eliminated");
            Err(Error::data(message).help(
                "raise `own_covariances` of that estimate, so that the covariances of its artefacts are found, too",
            ))
        })
    }

    /// Refuses what contradicts itself: names, units, numbers, covariance, budgets.
    pub(crate) fn check(&self) -> Result<()> {
        let mut names = BTreeSet::new();
        for estimated in self.parameters.iter().chain(&self.artefacts) {
            let name = &estimated.name;
            estimated.unit.parse::<Unit>().map_err(|error| Error::data(format!("`{name}`: {error}")))?;
            if !(estimated.value.is_finite() && estimated.standard_uncertainty >= 0.0) {
                return Err(Error::data(format!("`{name}` has no finite value with an uncertainty of at least zero")));
            }
            if !names.insert(name) {
                return Err(Error::data(format!("`{name}` stands here twice")));
            }
        }
        let NamedCovariance { order, rows } = &self.covariance;
        if let Some(unknown) = order.iter().find(|name| !names.contains(name)) {
            return Err(Error::data(format!("the covariance names `{unknown}`, which is no parameter")));
        }
        let size = order.len();
        if rows.len() != size || rows.iter().any(|row| row.len() != size) {
            return Err(Error::data(format!("the covariance is not {size} x {size} as its names promise")));
        }
        self.check_covariance()?;
        self.uncertainty.as_ref().map_or(Ok(()), |budget| self.check_budget(budget))?;
        for input in self.inputs.iter().flatten() {
            let ConsideredInput { name, value, unit, standard_uncertainty, sensitivities, .. } = input;
            unit.parse::<Unit>().map_err(|error| Error::data(format!("`{name}`: {error}")))?;
            if !(value.is_finite()
                && *standard_uncertainty > 0.0
                && sensitivities.iter().all(|value| value.is_finite()))
            {
                return Err(Error::data(format!(
                    "the input `{name}` has a number that is not finite, or no uncertainty"
                )));
            }
            if sensitivities.len() != size {
                let given = sensitivities.len();
                return Err(Error::data(format!("the input `{name}` has {given} sensitivities for {size} values")));
            }
        }
        Ok(())
    }

    /// Refuses budgets that contradict themselves or the values.
    fn check_budget(&self, budget: &UncertaintyBudget) -> Result<()> {
        let is_probability = budget.coverage_probability > 0.0 && budget.coverage_probability < 1.0;
        if !(is_probability && budget.scale.is_finite() && budget.scale >= 0.0) {
            return Err(Error::data("`uncertainty` has no probability from 0 to 1, or a negative scale"));
        }
        let alike = |one: f64, other: f64| (one - other).abs() <= ROUNDED * one.abs().max(other.abs());
        for entry in &budget.parameters {
            let ParameterBudget { name, standard_uncertainty: u, coverage_factor: k, expanded_uncertainty, .. } = entry;
            let known =
                self.get(name).ok_or_else(|| Error::data(format!("the budget of `{name}` is that of no value")))?;
            if !(*k > 0.0 && alike(*expanded_uncertainty, k * u) && alike(*u, known.standard_uncertainty)) {
                return Err(Error::data(format!("the budget of `{name}` contradicts its standard uncertainty")));
            }
        }
        Ok(())
    }

    /// Refuses a covariance that is none, or that contradicts the standard uncertainties of what is estimated.
    fn check_covariance(&self) -> Result<()> {
        let NamedCovariance { order, rows } = &self.covariance;
        let variances: BTreeMap<&str, f64> =
            order.iter().enumerate().map(|(index, name)| (name.as_str(), rows[index][index])).collect();
        if let Some(twice) = order.iter().enumerate().find(|(index, name)| order[..*index].contains(name)) {
            return Err(Error::data(format!("the covariance names `{}` twice", twice.1)));
        }
        for (row, one) in order.iter().enumerate() {
            let variance = rows[row][row];
            if !(variance.is_finite() && variance >= 0.0) {
                return Err(Error::data(format!("the variance of `{one}` is {variance}; at least zero was expected")));
            }
            for (column, other) in order.iter().enumerate().take(row) {
                let covariance = rows[row][column];
                if covariance != rows[column][row] {
                    return Err(Error::data(format!("the covariance of `{one}` and `{other}` is not symmetric")));
                }
                let most = (variance * rows[column][column]).sqrt();
                let is_possible = covariance.abs() <= most * (1.0 + ROUNDED);
                if !is_possible {
                    return Err(Error::data(format!(
                        "the covariance of `{one}` and `{other}` is larger than their variances allow"
                    )));
                }
            }
        }
        // Correlations that each are possible, but not together.
        let scale: Vec<f64> = (0..order.len()).map(|row| rows[row][row].sqrt()).collect();
        let correlation = DMatrix::from_fn(order.len(), order.len(), |row, column| {
            let size = scale[row] * scale[column];
            if size > 0.0 { rows[row][column] / size } else { f64::from(u8::from(row == column)) }
        });
        if !order.is_empty() && correlation.symmetric_eigenvalues().iter().any(|value| *value < -ROUNDED) {
            return Err(Error::data("the covariance is none: some combination of values has a negative variance"));
        }
        let has_one = |estimated: &&Estimated| estimated.status == Status::Estimated;
        let is_missing = |own: &&Estimated| has_one(own) && !variances.contains_key(own.name.as_str());
        let (missing, eliminated) = (self.artefacts.iter().filter(is_missing).count(), self.fit.eliminated);
        if eliminated > 0 && missing != eliminated {
            let message = "values were eliminated, and the covariance lacks";
            return Err(Error::data(format!("{eliminated} {message} {missing}")));
        }
        let artefacts = self.artefacts.iter().filter(|own| eliminated == 0 || !is_missing(own));
        for Estimated { name, standard_uncertainty, .. } in self.parameters.iter().chain(artefacts).filter(has_one) {
            let variance = variances.get(name.as_str());
            let variance = variance.ok_or_else(|| Error::data(format!("`{name}` is not in the covariance")))?;
            if (variance.sqrt() - standard_uncertainty).abs() > ROUNDED * standard_uncertainty {
                return Err(Error::data(format!(
                    "the standard uncertainty of `{name}` is {standard_uncertainty:e}, and by the covariance {:e}",
                    variance.sqrt()
                )));
            }
        }
        Ok(())
    }
}

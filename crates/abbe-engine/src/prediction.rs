//! Observations that an estimate is judged by and that it was not made of.

use std::collections::BTreeMap;
use std::sync::Arc;

use abbe_core::{Error, Fit, Kind, ObservationSet, Problem, Result, Validate};

use crate::batches::InBatches;
use crate::prepare::Prepared;
use crate::problems::Taken;
use crate::row_settings::Wanted;
use crate::run::Datasets;

/// Problems without unknowns on the rows that validators predict, by validator and estimate.
pub(crate) type Predicted<'a> = BTreeMap<(&'a str, &'a str), Problem>;

impl Prepared {
    /// For validators with observations of their own, by stage and estimate: these observations on the machine of the estimate.
    pub(crate) fn predicted<'a>(
        &'a self,
        problems: &BTreeMap<String, Problem>,
        batches: &InBatches<'_>,
        data: &Datasets,
        taken: &mut Taken,
    ) -> Result<Predicted<'a>> {
        let mut predicted = BTreeMap::new();
        for stage in self.stages(Kind::Validate).filter(|stage| !stage.reference("observations").is_empty()) {
            for name in stage.reference("of") {
                let own = &self.own_estimate(name)?.name;
                let Some(problem) = problems.get(own).or_else(|| batches.problem(own)) else { continue };
                let model = &problem.model;
                let sets = self.sets(stage.reference("observations"), model, data, Wanted::Predicted, taken);
                let sets = self.located(stage, sets)?;
                let other = Problem::new(name, &problem.model_plugin, model.clone(), sets, &[]);
                predicted.insert((stage.name.as_str(), name.as_str()), self.located(stage, other)?);
            }
        }
        Ok(predicted)
    }
}

/// A fit whose problem is another one without unknowns, with the values of the fit: what is left are errors of prediction.
///
/// Fails if the fit has not estimated an own unknown of the observations, unless the validator finds features itself.
pub(crate) fn prediction_fit(fit: &Fit, other: &Problem, validator: &dyn Validate) -> Result<Fit> {
    let own = |set: &ObservationSet| -> Vec<String> {
        set.observations.info().unknowns.iter().map(|unknown| format!("{}.{}", set.name, unknown.name)).collect()
    };
    let known = |name: &String| fit.calibration.artefacts.iter().any(|known| known.name == *name);
    let needed = other.sets.iter().filter(|_| !validator.finds_features());
    if let Some(name) = needed.flat_map(own).find(|name| !known(name)) {
        let error = Error::usage(format!("`{name}` is unknown, and {} has not estimated it", fit.name));
        return Err(error
            .help(format!(
                "judge an estimate of it that has `known: {}`, or one of rows with it, whose stage declares the judged rows `unseen`",
                fit.name
            ))
            .setting("observations"));
    }
    let (name, estimator, calibration) = (fit.name.clone(), fit.estimator.clone(), fit.calibration.clone());
    Ok(Fit { name, problem: Arc::new(other.starting_from(&fit.calibration)), estimator, calibration })
}

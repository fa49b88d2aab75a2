//! Calibrations that were made outside this recipe. They are read before the run, each with the model that it contains.

use std::sync::Arc;

use abbe_core::{
    Calibration, Class, Dataset, Error, Estimate, EstimateSource, Fit, Kind, KinematicModel, Model, PathItem, Problem,
    Registry, Result, SettingsError, Status, Unknown,
};
use abbe_recipe::Stage;
use serde_json::Value;

use crate::prepare::{Prepared, build_model};
use crate::readings::SavedQuantities;

/// A calibration that was made outside this recipe.
pub(crate) struct SavedCalibration {
    pub calibration: Calibration,
    pub model: Box<dyn Model>,
    /// It was made of readings that are no geometry, and has no machine.
    pub of_readings: bool,
}

impl SavedCalibration {
    /// Reads the calibration of a stage and builds its model.
    pub fn new(stage: &Stage, estimator: &dyn Estimate, registry: &Registry) -> Result<Self> {
        let found = || {
            let mut calibration = estimator.read_calibration()?;
            if let Some(worst) = calibration.fit.implausible.first() {
                let message = format!("this calibration is marked: no machine has errors like its `{}`", worst.name);
                return Err(
                    Error::data(message).help("correct the recipe that it comes from, or widen `plausible` there")
                );
            }
            calibration.estimate.clone_from(&stage.name);
            if is_of_readings(&calibration, registry) {
                let model = Box::new(SavedQuantities(calibration.clone()));
                return Ok(Self { calibration, model, of_readings: true });
            }
            let model = own_model(&calibration, registry)?;
            Ok(Self { calibration, model, of_readings: false })
        };
        // This error is found without a run, so its class is that of wrong use.
        found().map_err(|error: Error| Error { class: Class::Use, ..error })
    }
}

/// The model of a calibration, built from its own settings alone.
pub fn model_of(calibration: &Calibration, registry: &Registry) -> Result<Arc<dyn KinematicModel>> {
    model_with_log(calibration, None, registry)
}

/// The model of a calibration whose errors follow another log of sensors than the one of its measurement.
///
/// Fails for a log that does not have what its errors follow.
pub fn model_with_log(
    calibration: &Calibration,
    log: Option<&Dataset>,
    registry: &Registry,
) -> Result<Arc<dyn KinematicModel>> {
    own_model(calibration, registry)?.build(log.as_slice())
}

/// The stage of the model that a calibration contains.
fn own_model(calibration: &Calibration, registry: &Registry) -> Result<Box<dyn Model>> {
    let plugin = registry
        .find(Kind::Model, &calibration.model.plugin)
        .map_err(|error| Error::data(format!("the model of this calibration: {error}")))?;
    build_model(plugin, &calibration.model.settings)
}

/// Whether a calibration was made of readings that are no geometry.
fn is_of_readings(calibration: &Calibration, registry: &Registry) -> bool {
    let made_by = registry.find(Kind::Estimate, &calibration.model.plugin);
    made_by.is_ok_and(|plugin| plugin.estimate_source == EstimateSource::Readings)
}

/// Number of entries that the lists of some settings had before the merge: (key, number).
pub(crate) type Before = Vec<(String, usize)>;

/// Turns an error about merged settings into an error about the settings of the stage itself.
pub(crate) fn own_place(mut error: SettingsError, before: &Before) -> SettingsError {
    if let [PathItem::Key(key), PathItem::Index(index), ..] = error.path.as_slice()
        && let Some((_, count)) = before.iter().find(|(list, _)| list == key)
    {
        match index.checked_sub(*count) {
            Some(own) => error.path[1] = PathItem::Index(own),
            None => error.path.truncate(1),
        }
    }
    error
}

impl Prepared {
    /// The settings of a model stage. With `machine` they are merged into those of the machine of an estimate: lists are
    /// extended (`errors`), maps are merged, and all else replaces the old value.
    pub(crate) fn model_settings(&self, stage: &Stage) -> Result<(Value, Before)> {
        let Some(name) = stage.reference("machine").first() else { return Ok((stage.settings.clone(), Vec::new())) };
        let located = |error: Error| self.recipe.locate(error.stage(&stage.name));
        let source = self.machine_stage(self.recipe_stage(name)?).map_err(located)?;
        let (plugin, settings) = match self.saved.get(&source.name) {
            Some(saved) => (&saved.calibration.model.plugin, saved.calibration.model.settings.clone()),
            None => (&source.plugin, self.model_settings(source)?.0),
        };
        if *plugin != stage.plugin {
            let message = format!("the machine of `{name}` is a `{plugin}`, this one a `{}`", stage.plugin);
            return Err(located(Error::usage(message).setting("machine")));
        }
        let mut before = Vec::new();
        Ok((added(settings, &stage.settings, &mut before), before))
    }
}

/// Merges `more` into settings.
fn added(mut settings: Value, more: &Value, before: &mut Before) -> Value {
    let (Value::Object(own), Value::Object(more)) = (&mut settings, more) else { return more.clone() };
    for (key, value) in more {
        match (own.get_mut(key), value) {
            (Some(Value::Array(list)), Value::Array(more)) => {
                before.push((key.clone(), list.len()));
                list.extend(more.iter().cloned());
            }
            (Some(Value::Object(_)), Value::Object(_)) => {
                let old = own.get_mut(key).map(Value::take).unwrap_or_default();
                own.insert(key.clone(), merged(old, value));
            }
            _ => drop(own.insert(key.clone(), value.clone())),
        }
    }
    settings
}

/// Maps are merged; any other value of `over` replaces that of `under`.
fn merged(under: Value, over: &Value) -> Value {
    match (under, over) {
        (Value::Object(mut under), Value::Object(over)) => {
            for (key, value) in over {
                let old = under.get_mut(key).map(Value::take).unwrap_or_default();
                under.insert(key.clone(), merged(old, value));
            }
            Value::Object(under)
        }
        (_, over) => over.clone(),
    }
}

/// The fit of a calibration that was not fitted to rows of this recipe. Its problem has the values of the calibration; its
/// unknowns are the estimated machine parameters.
pub(crate) fn fit_without_rows(
    calibration: Calibration,
    model: Arc<dyn KinematicModel>,
    estimator: Arc<dyn Estimate>,
) -> Result<Fit> {
    let (name, plugin) = (calibration.estimate.clone(), calibration.model.plugin.clone());
    for parameter in &calibration.parameters {
        let of_model = model.info().parameters.iter().find(|known| known.name == parameter.name);
        let wrong = match of_model {
            None => "the model of the calibration has no such parameter".to_owned(),
            Some(known) if known.unit.to_string() != parameter.unit => {
                format!("its unit is {}, and in the model of the calibration {}", parameter.unit, known.unit)
            }
            Some(_) => continue,
        };
        return Err(Error::data(format!("`{}`: {wrong}", parameter.name)));
    }
    let problem = Problem::new(&name, &plugin, model, Vec::new(), &["*".to_owned()])?;
    let estimated = |unknown: &Unknown| {
        let found = calibration.parameters.iter().find(|parameter| parameter.name == unknown.name);
        found.is_some_and(|parameter| matches!(parameter.status, Status::Estimated | Status::Confounded))
    };
    let problem = problem.without_unknowns(|unknown| !estimated(unknown)).starting_from(&calibration);
    Ok(Fit { name, problem: Arc::new(problem), estimator, calibration })
}

//! Validator plugin `thermal`: predictions of runs that were not seen, drift in the manner of ISO 230-3, materials of references.

use std::collections::BTreeMap;

use abbe_core::{
    Context, Dataset, Error, EstimateSource, Figure, Findings, Fit, Limit, PathItem, Result, SettingsError, Validate,
};
use abbe_standards::thermal_drift::EDITION;
use schemars::JsonSchema;
use serde::Deserialize;
use serde_json::{Value, json};

use crate::drift::DriftSettings;
use crate::material::Reference;
use crate::prediction::PredictionSettings;

abbe_core::register!(
    Validate,
    "thermal",
    "thermal behaviour: prediction of unseen runs, drift in the manner of ISO 230-3, materials of references",
    Settings,
    example,
    build,
    "../reference/validate-thermal.md",
    EstimateSource::Readings,
);

/// Settings of thermal tests. At least one of the three has to be there.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Settings {
    /// Predictions of the runs under `from` by the estimates under `of`.
    #[serde(default)]
    prediction: Option<PredictionSettings>,
    /// Drift of readings over time, in the manner of ISO 230-3.
    #[serde(default)]
    drift: Option<DriftSettings>,
    /// References whose material has to suit the temperatures, by name (Muelaner et al. 2014, eq. 1).
    #[serde(default)]
    references: BTreeMap<String, Reference>,
}

fn example() -> Value {
    json!({
        "prediction": { "limits": { "max_um": 5, "rms_K": 0.2 } },
        "drift": { "readings": ["drift_x", "drift_z"], "window_s": 3600, "limits": { "range_um": 40 } },
    })
}

fn build(settings: Settings, _: &Context) -> Result<Box<dyn Validate>, SettingsError> {
    let at = |key: &'static str| move |error: SettingsError| error.under([PathItem::Key(key.to_owned())]);
    settings.prediction.iter().try_for_each(PredictionSettings::check).map_err(at("prediction"))?;
    settings.drift.iter().try_for_each(DriftSettings::check).map_err(at("drift"))?;
    for (name, reference) in &settings.references {
        reference.check().map_err(|error| error.under([PathItem::Key(name.clone())])).map_err(at("references"))?;
    }
    if settings.prediction.is_none() && settings.drift.is_none() && settings.references.is_empty() {
        return Err(SettingsError::new("", "`prediction`, `drift` or `references` was expected: what is judged?"));
    }
    Ok(Box::new(Thermal { settings }))
}

struct Thermal {
    settings: Settings,
}

impl Validate for Thermal {
    fn accepts_data(&self) -> bool {
        true
    }

    fn accepts_readings(&self) -> bool {
        true
    }

    fn validate(&self, fits: &[&Fit], data: &[&Dataset]) -> Result<Findings> {
        let mut findings = Findings::default();
        if data.is_empty() {
            return Err(Error::usage("there is no run to judge")
                .help("name ingest stages under `from`")
                .setting("from"));
        }
        if let Some(prediction) = &self.settings.prediction {
            if fits.is_empty() {
                return Err(Error::usage("predictions need an estimate of thermal states").setting("of"));
            }
            fits.iter().try_for_each(|fit| prediction.judge(fit, data, &mut findings))?;
        }
        for run in data {
            if let Some(drift) = &self.settings.drift {
                drift.judge(run, &run_name(run), &mut findings)?;
            }
        }
        if self.settings.drift.is_some() {
            findings.remarks.push(format!(
                "{EDITION} (its text was not at hand). A choice of this project: the time to a part of the drift, after DIN 8602"
            ));
        }
        self.settings.references.iter().try_for_each(|(name, reference)| reference.judge(name, data, &mut findings))?;
        Ok(findings)
    }
}

/// How a run is called: the name of its file.
pub fn run_name(data: &Dataset) -> String {
    let stem = data.files.first().and_then(|file| file.file_stem());
    stem.map_or_else(|| "run".to_owned(), |stem| stem.to_string_lossy().into_owned())
}

/// Limits by key.
pub type Limits = BTreeMap<String, Limit>;

/// Refuses limits for anything but these keys, and those that are no numbers.
pub fn check_limits(limits: &Limits, keys: &[&str]) -> Result<(), SettingsError> {
    for (key, limit) in limits {
        let at = [PathItem::Key("limits".to_owned())];
        if !keys.contains(&key.as_str()) {
            let mut error = SettingsError::new(key, format!("there is no figure `{key}` to limit"));
            error.key = true;
            return Err(error.suggest(key, keys.iter().copied()).under(at));
        }
        if !limit.value.is_finite() {
            return Err(SettingsError::new(key, "a finite number was expected").under(at));
        }
    }
    Ok(())
}

/// A figure with the limit of its key.
pub fn limited(figure: Figure, key: &str, limits: &Limits) -> Figure {
    figure.limited(limits.get(key).copied())
}

//! Validator plugin `spindle`: figures of error motions in the manner of ISO 230-7.

mod agreement;
mod checked;
mod judged;
mod tables;
mod total;
mod units;

use std::collections::BTreeMap;

use abbe_core::{
    Context, Dataset, Error, Figure, Findings, Fit, Limit, Passes, PathItem, Result, SettingsError, Validate,
    from_settings,
};
use abbe_standards::spindle::{Centre, Harmonics, Range};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use crate::motion::{Motion, held};
use crate::reversal::Reversal;
use crate::warm_up::WarmUp;
use crate::{motion, reversal, warm_up};
use checked::Checked;

abbe_core::register!(
    Validate,
    "spindle",
    "error motions of a spindle in the manner of ISO 230-7, against limits, speed and the last check",
    Spindle,
    example,
    build,
    "../reference/validate-spindle.md",
);

/// Settings of the figures of a spindle.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Spindle {
    /// What synchronous error motions are counted from.
    #[serde(default)]
    centre: CentreName,
    /// Angles of a turn at which the synchronous part is evaluated.
    #[serde(default = "angles")]
    #[schemars(range(min = 8, max = 36000))]
    angles: u16,
    /// How the fundamental axial motion is told.
    #[serde(default)]
    axial_fundamental: AxialFundamental,
    /// The form of the artefact if it is known without a reversal: coefficients `cos2`, `sin2`, ... of its form over
    /// azimuth less angle. A reversal under `of` is taken by itself.
    #[serde(default)]
    form_um: BTreeMap<String, f64>,
    /// The estimate under `of` that is the last check: changes since then are told.
    #[serde(default)]
    last: Option<String>,
    /// The runs to judge, by name. Default: all.
    #[serde(default)]
    runs: Vec<String>,
    /// Largest admissible values; each holds for all runs, or all displacements of a warm-up.
    #[serde(default)]
    limits: BTreeMap<String, Limit>,
}

/// What synchronous error motions are counted from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
enum CentreName {
    /// The least squares circle of the polar plot.
    #[default]
    LeastSquares,
    /// The circles of the smallest zone.
    MinimumZone,
    /// The centre of the polar chart: the eccentricity alone is taken off.
    PolarChart,
}

impl CentreName {
    fn centre(self) -> Centre {
        match self {
            Self::LeastSquares => Centre::LeastSquares,
            Self::MinimumZone => Centre::MinimumZone,
            Self::PolarChart => Centre::PolarChart,
        }
    }

    fn words(self) -> &'static str {
        match self {
            Self::LeastSquares => "least squares centre",
            Self::MinimumZone => "centre of the smallest zone",
            Self::PolarChart => "centre of the polar chart (the eccentricity taken off)",
        }
    }
}

/// How the fundamental axial motion is told.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
enum AxialFundamental {
    /// Its range: twice its amplitude.
    #[default]
    TwiceAmplitude,
    /// Its amplitude.
    Amplitude,
}

fn angles() -> u16 {
    720
}

fn example() -> Value {
    json!({
        "centre": "least-squares",
        "angles": 720,
        "last": "last-year",
        "limits": { "synchronous_rotating_um": 1.5, "asynchronous_rotating_um": 1.5, "warm_up_range_um": 50 },
    })
}

/// Figures of runs, without brackets.
const OF_RUNS: [&str; 13] = [
    "synchronous rotating",
    "asynchronous rotating",
    "total rotating",
    "synchronous fixed",
    "asynchronous fixed",
    "total fixed",
    "synchronous axial",
    "fundamental axial",
    "residual synchronous axial",
    "asynchronous axial",
    "total axial",
    "eccentricity",
    "backward fundamental",
];

/// Keys of limits beside those of runs and their changes.
const OTHERS: [&str; 6] = [
    "form_out_of_roundness_um",
    "reversal_synchronous_fixed_um",
    "warm_up_end_um",
    "warm_up_range_um",
    "warm_up_slope_um_per_min",
    "warm_up_time_to_95_min",
];

/// What a limit of a figure is called.
fn key(name: &str, unit: &str) -> String {
    let base = name.split('[').next().unwrap_or(name).replace([' ', '-'], "_");
    format!("{base}_{}", unit.replace('/', "_per_"))
}

fn keys() -> Vec<String> {
    let runs = OF_RUNS.iter().flat_map(|name| [key(name, "um"), key(&format!("change of {name}"), "um")]);
    runs.chain(OTHERS.map(str::to_owned)).collect()
}

fn build(settings: Spindle, _: &Context) -> Result<Box<dyn Validate>, SettingsError> {
    if !(8..=36_000).contains(&settings.angles) {
        return Err(SettingsError::new("angles", "8 to 36000 were expected"));
    }
    let keys = keys();
    for (name, limit) in &settings.limits {
        let at = [PathItem::Key("limits".to_owned())];
        if !keys.contains(name) {
            let mut error = SettingsError::new(name, format!("there is no figure `{name}` to limit"));
            error.key = true;
            return Err(error.suggest(name, keys.iter().map(String::as_str)).under(at));
        }
        if !limit.value.is_finite() {
            return Err(SettingsError::new(name, "a finite number was expected").under(at));
        }
    }
    for (name, value) in &settings.form_um {
        if form_order(name).is_none_or(|(_, order)| order < 2) || !value.is_finite() {
            let error = SettingsError::new(name, "`cos2`, `sin2` and so on with a finite value were expected");
            return Err(error.under([PathItem::Key("form_um".to_owned())]));
        }
    }
    Ok(Box::new(settings))
}

/// Whether a coefficient of a form is that of a cosine, and its order.
fn form_order(name: &str) -> Option<(bool, usize)> {
    let cos = name.strip_prefix("cos").and_then(|order| order.parse().ok()).map(|order| (true, order));
    cos.or_else(|| name.strip_prefix("sin").and_then(|order| order.parse().ok()).map(|order| (false, order)))
}

/// The estimates under `of`, by what they are.
#[derive(Default)]
struct Estimates<'a> {
    motions: Vec<(&'a Fit, Motion)>,
    last: Option<(&'a Fit, Motion)>,
    reversal: Option<(&'a Fit, Reversal)>,
    warm_ups: Vec<(&'a Fit, WarmUp)>,
}

impl Spindle {
    fn estimates<'a>(&self, fits: &[&'a Fit]) -> Result<Estimates<'a>> {
        let mut all = Estimates::default();
        for &fit in fits {
            let record = &fit.calibration.model;
            let broken =
                |error: SettingsError| Error::data(format!("the settings of `{}`: {error}", fit.name)).setting("of");
            match record.plugin.as_str() {
                motion::PLUGIN => {
                    let motion: Motion = from_settings(&record.settings).map_err(broken)?;
                    match self.last.as_ref() == Some(&fit.name) {
                        true => all.last = Some((fit, motion)),
                        false => all.motions.push((fit, motion)),
                    }
                }
                reversal::PLUGIN if all.reversal.is_some() => {
                    return Err(Error::usage("two reversals are named; one form was expected").setting("of"));
                }
                reversal::PLUGIN => all.reversal = Some((fit, from_settings(&record.settings).map_err(broken)?)),
                warm_up::PLUGIN => all.warm_ups.push((fit, from_settings(&record.settings).map_err(broken)?)),
                other => {
                    let message = format!(
                        "`{}` is an estimate of `{other}`; `{}`, `{}` and `{}` were expected",
                        fit.name,
                        motion::PLUGIN,
                        reversal::PLUGIN,
                        warm_up::PLUGIN
                    );
                    return Err(Error::usage(message).setting("of"));
                }
            }
        }
        if let (Some(last), None) = (&self.last, &all.last) {
            let message = format!("`{last}` is no estimate of `{}` under `of`", motion::PLUGIN);
            return Err(Error::usage(message).setting("last"));
        }
        if all.reversal.is_some() && !self.form_um.is_empty() {
            return Err(Error::usage("the form is known from the reversal under `of` already").setting("form_um"));
        }
        Ok(all)
    }

    fn is_judged(&self, run: &str) -> bool {
        self.runs.is_empty() || self.runs.iter().any(|name| name == run)
    }

    /// The range of a motion that depends linearly on what was estimated, µm, and its standard uncertainty.
    fn range(&self, checked: &Checked, motion: &dyn Fn(&[f64]) -> Harmonics) -> (f64, f64) {
        let range = Range::of(&motion(&checked.values), usize::from(self.angles), self.centre.centre());
        (range.value * 1e3, checked.uncertainty(&|by| range.change(&motion(by))) * 1e3)
    }

    /// What the figures mean, in one sentence.
    fn definitions(&self, motion: &Motion) -> String {
        format!(
            "in the manner of ISO 230-7:2015, whose text was not at hand: synchronous = harmonics to {} at {} angles, from the {}; \
             asynchronous = largest range within one of {} sectors; fundamental axial = {}; total (a definition of this project) = \
             range of all readings about the least squares circle of the synchronous part, axial ones with their fundamental",
            motion.harmonics,
            self.angles,
            self.centre.words(),
            motion.sectors,
            match self.axial_fundamental {
                AxialFundamental::TwiceAmplitude => "twice its amplitude",
                AxialFundamental::Amplitude => "its amplitude",
            }
        )
    }

    fn set_limits(&self, figures: &mut Vec<Figure>) {
        for figure in figures.iter_mut().filter(|figure| !figure.detail) {
            figure.set_limit(self.limits.get(&key(&figure.name, &figure.unit)).copied());
        }
        let Some(of) = figures.first().map(|figure| figure.of.clone()) else { return };
        for (limited, limit) in &self.limits {
            if !figures.iter().any(|figure| !figure.detail && key(&figure.name, &figure.unit) == *limited) {
                // What a limit asks for was not measured: it fails.
                let named = limited.strip_suffix("_um").unwrap_or(limited).replace('_', " ");
                let mut absent = Figure { of: of.clone(), ..Figure::new("", named, f64::NAN, "um") };
                absent.set_limit(Some(*limit));
                figures.push(absent);
            }
        }
    }
}

impl Validate for Spindle {
    fn estimates(&self) -> Vec<(&'static str, String)> {
        self.last.iter().map(|last| ("last", last.clone())).collect()
    }

    fn accepts_data(&self) -> bool {
        true
    }

    fn accepts_readings(&self) -> bool {
        true
    }

    fn validate(&self, fits: &[&Fit], data: &[&Dataset]) -> Result<Findings> {
        self.validate_in_passes(fits, &held(data))
    }

    fn accepts_data_in_passes(&self) -> bool {
        true
    }

    fn validate_in_passes(&self, fits: &[&Fit], data: &[&dyn Passes]) -> Result<Findings> {
        let estimates = self.estimates(fits)?;
        let mut findings = Findings::default();
        judged::runs(self, &estimates, data, &mut findings)?;
        if let Some((fit, reversal)) = &estimates.reversal {
            judged::reversal(self, fit, reversal, &mut findings);
        }
        estimates.warm_ups.iter().for_each(|(fit, warm_up)| judged::warm_up(fit, warm_up, &mut findings));
        self.set_limits(&mut findings.figures);
        Ok(findings)
    }
}

//! Validator `uncertainty`: whether parameters and the tip anywhere in the workspace are known well enough.

use std::collections::BTreeMap;
use std::fmt;

use abbe_core::{
    Calibration, Context, Dataset, Error, Estimated, Figure, Findings, Fit, Limit, PathItem, Result, SettingsError,
    Status, Unit, Validate, matches, positive,
};
use abbe_volumetric::{Grid, VolumetricError, predict, within};
use schemars::JsonSchema;
use serde::de::{Error as _, MapAccess, Visitor};
use serde::{Deserialize, Deserializer};
use serde_json::{Value, json};

use crate::figures::{ONE, Sample, UM, ascii, relative_uncertainty, suffix, uncertainty_of_scatter};

abbe_core::register!(
    Validate,
    "uncertainty",
    "limits of the uncertainty of parameters and of the tip over the workspace",
    Settings,
    example,
    build,
    "../reference/validate-uncertainty.md",
);

/// Settings of the uncertainties.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Settings {
    /// Parameters, with limits for their uncertainties.
    #[serde(default)]
    parameters: Vec<Entry>,
    /// Coverage factor for the limits `expanded_..`. Default: the expanded uncertainty is that of the calibration (of
    /// trials half the symmetric interval), or twice the standard uncertainty if the calibration has none.
    #[serde(default)]
    coverage_factor: Option<f64>,
    /// The uncertainty of the tip over the workspace.
    #[serde(default)]
    volumetric: Option<Workspace>,
}

/// Parameters with one limit for each of them.
#[derive(Debug, Clone, PartialEq, JsonSchema)]
struct Entry {
    /// Names or patterns of estimated parameters, of the machine or of artefacts.
    names: Vec<String>,
    /// One limit: `standard_uncertainty_` or `expanded_` and the unit in which people read the parameters, e.g.
    /// `expanded_um`, `expanded_urad`, `standard_uncertainty_um_per_m`.
    #[schemars(flatten)]
    limit: BTreeMap<String, Limit>,
}

// `flatten` of serde forgets at which setting something is wrong.
impl<'de> Deserialize<'de> for Entry {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct NamesAndLimits;

        impl<'de> Visitor<'de> for NamesAndLimits {
            type Value = Entry;

            fn expecting(&self, text: &mut fmt::Formatter<'_>) -> fmt::Result {
                text.write_str("a map of settings")
            }

            fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Entry, A::Error> {
                let (mut names, mut limit) = (None, BTreeMap::new());
                while let Some(setting) = map.next_key::<String>()? {
                    if setting == "names" {
                        names = Some(map.next_value()?);
                    } else {
                        limit.insert(setting, map.next_value()?);
                    }
                }
                let names = names.ok_or_else(|| A::Error::missing_field("names"))?;
                Ok(Entry { names, limit })
            }
        }

        deserializer.deserialize_map(NamesAndLimits)
    }
}

/// The uncertainty of the tip over the workspace.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Workspace {
    /// The poses.
    grid: Grid,
    /// Probability with which the ellipsoid of a pose holds its error.
    #[serde(default = "default_probability")]
    probability: f64,
    /// Largest admissible semi-axis of the ellipsoid of any pose.
    #[serde(default)]
    expanded_um: Option<Limit>,
}

fn default_probability() -> f64 {
    0.95
}

fn example() -> Value {
    json!({
        "parameters": [
            { "names": ["E?0?"], "expanded_urad": 10 },
            { "names": ["EXX[1]", "EYY[1]"], "standard_uncertainty_um_per_m": 2 }
        ],
        "volumetric": { "grid": { "points": 5 }, "expanded_um": 10 }
    })
}

fn build(settings: Settings, _: &Context) -> Result<Box<dyn Validate>, SettingsError> {
    settings.coverage_factor.map_or(Ok(0.0), |factor| positive("coverage_factor", factor))?;
    if settings.parameters.is_empty() && settings.volumetric.is_none() {
        return Err(SettingsError::new("", "`parameters` or `volumetric` were expected: nothing is judged"));
    }
    for (index, entry) in settings.parameters.iter().enumerate() {
        entry.check().map_err(|error| error.under([key("parameters"), PathItem::Index(index)]))?;
    }
    let is_expanded = |entry: &Entry| matches!(entry.limit(), Some((_, Measure::Expanded, _)));
    if settings.coverage_factor.is_some() && !settings.parameters.iter().any(is_expanded) {
        let message = "it makes expanded uncertainties, and none is limited";
        let help = "limit one under `parameters` (`expanded_um`), or leave out `coverage_factor`";
        return Err(SettingsError::new("coverage_factor", message).help(help));
    }
    if let Some(workspace) = &settings.volumetric {
        workspace.check().map_err(|error| error.under([key("volumetric")]))?;
    }
    Ok(Box::new(Uncertainty { settings }))
}

fn key(name: &str) -> PathItem {
    PathItem::Key(name.to_owned())
}

/// What a limit is about.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Measure {
    Standard,
    Expanded,
}

impl Measure {
    const ALL: [Self; 2] = [Self::Standard, Self::Expanded];

    /// How limits and figures begin.
    fn name(self) -> &'static str {
        match self {
            Self::Standard => "standard_uncertainty",
            Self::Expanded => "expanded",
        }
    }
}

impl Entry {
    fn check(&self) -> Result<(), SettingsError> {
        if self.names.is_empty() {
            return Err(SettingsError::new("names", "at least one name was expected"));
        }
        let example = "write one, e.g. `expanded_um: 5` or `standard_uncertainty_urad: 2`";
        if self.limit.len() != 1 {
            return Err(SettingsError::new("", format!("{} limits; one was expected", self.limit.len())).help(example));
        }
        for (setting, limit) in &self.limit {
            if !Measure::ALL.iter().any(|measure| setting.starts_with(measure.name())) {
                let mut error = SettingsError::new(setting, format!("unknown setting `{setting}`")).help(example);
                error.key = true;
                return Err(error);
            }
            positive(setting, limit.value)?;
        }
        Ok(())
    }

    /// The limit: its setting, what it is about, the limit itself.
    fn limit(&self) -> Option<(&str, Measure, Limit)> {
        let (setting, limit) = self.limit.iter().next()?;
        let measure = Measure::ALL.into_iter().find(|measure| setting.starts_with(measure.name()))?;
        Some((setting, measure, *limit))
    }

    /// The parameters that it is about; fails for a name that matches none with an uncertainty.
    fn matched<'a>(&self, fit: &'a Fit) -> Result<Vec<&'a Estimated>> {
        let calibration = &fit.calibration;
        let candidates: Vec<&Estimated> = (calibration.parameters.iter().chain(&calibration.artefacts))
            .filter(|parameter| parameter.status != Status::Fixed)
            .collect();
        for (index, pattern) in self.names.iter().enumerate() {
            if !candidates.iter().any(|parameter| matches(pattern, &parameter.name)) {
                let names = candidates.iter().map(|parameter| parameter.name.as_str());
                let mut error = Error::usage(format!("`{pattern}` matches no estimated parameter of {}", fit.name))
                    .suggest(pattern, names);
                error.setting = vec![key("names"), PathItem::Index(index)];
                return Err(error);
            }
        }
        let named = |parameter: &&Estimated| self.names.iter().any(|pattern| matches(pattern, &parameter.name));
        Ok(candidates.into_iter().filter(named).collect())
    }
}

impl Workspace {
    fn check(&self) -> Result<(), SettingsError> {
        self.grid.check().map_err(|error| error.under([key("grid")]))?;
        if !(self.probability > 0.0 && self.probability < 1.0) {
            return Err(SettingsError::new("probability", "a number between 0 and 1 was expected"));
        }
        self.expanded_um.map_or(Ok(()), |limit| positive("expanded_um", limit.value).map(drop))
    }
}

struct Uncertainty {
    settings: Settings,
}

impl Validate for Uncertainty {
    fn validate(&self, fits: &[&Fit], _: &[&Dataset]) -> Result<Findings> {
        let mut findings = Findings::default();
        for fit in fits {
            for (index, entry) in self.settings.parameters.iter().enumerate() {
                self.judge_parameters(fit, entry, &mut findings).map_err(|mut error| {
                    error.setting.splice(0..0, [key("parameters"), PathItem::Index(index)]);
                    error
                })?;
            }
            if let Some(workspace) = &self.settings.volumetric {
                judge_workspace(fit, workspace, &mut findings)?;
            }
        }
        Ok(findings)
    }
}

impl Uncertainty {
    /// The expanded uncertainty of a parameter, in its unit.
    fn expanded(&self, fit: &Fit, parameter: &Estimated) -> f64 {
        if let Some(factor) = self.settings.coverage_factor {
            return factor * parameter.standard_uncertainty;
        }
        let calibration = &fit.calibration;
        let simulated = calibration.monte_carlo.iter().flat_map(|found| &found.parameters);
        let simulated = simulated.filter(|found| found.name == parameter.name).map(|found| {
            let [low, high] = found.symmetric_interval;
            (high - low) / 2.0
        });
        let budget = calibration.uncertainty.iter().flat_map(|budget| &budget.parameters);
        let budget = budget.filter(|part| part.name == parameter.name).map(|part| part.expanded_uncertainty);
        simulated.chain(budget).next().unwrap_or(2.0 * parameter.standard_uncertainty)
    }

    /// The largest uncertainty of several parameters, with those of all as details.
    fn judge_parameters(&self, fit: &Fit, entry: &Entry, findings: &mut Findings) -> Result<()> {
        let Some((setting, measure, limit)) = entry.limit() else { return Ok(()) };
        let parameters = entry.matched(fit)?;
        let (mut details, mut symbol): (Vec<Figure>, _) = (Vec::new(), String::new());
        for parameter in &parameters {
            let to_people;
            (symbol, to_people) = for_people(parameter)?;
            if setting != format!("{}{}", measure.name(), suffix(&symbol)) {
                let message = format!("`{}` is in {symbol}, `{setting}` is not its limit", parameter.name);
                let error = Error::usage(message).help(format!("write `{}{}`", measure.name(), suffix(&symbol)));
                return Err(error.setting(setting));
            }
            // If the data cannot separate it from others, its uncertainty has no meaning.
            let confounded = parameter.status == Status::Confounded;
            let value = match measure {
                _ if confounded => f64::NAN,
                Measure::Standard => parameter.standard_uncertainty,
                Measure::Expanded => self.expanded(fit, parameter),
            } * to_people;
            let uncertainty = relative_to(fit, parameter).map(|own| uncertainty_of_scatter(value, own, Some(limit)));
            let detail = figure(fit, measure, &parameter.name, value, &ascii(&symbol));
            details.push(detail.uncertain(uncertainty).limited(limit));
            if confounded {
                findings.remarks.push(format!(
                    "{}: {} has no uncertainty: the data cannot separate it from others",
                    fit.name, parameter.name
                ));
            }
        }
        if let [_, _, ..] = details.as_slice() {
            let uncertainties = details.iter().map(|figure| figure.value.unwrap_or(f64::NAN)).collect();
            let largest = Sample(uncertainties).max();
            let names = entry.names.join(", ");
            let mut main = figure(fit, measure, &names, largest, &ascii(&symbol)).limited(limit);
            if let Some(worst) = details.iter().position(|figure| figure.value == Some(largest)) {
                findings.remarks.push(format!(
                    "{}: {names}: the largest is that of {} ({largest:.3} {symbol})",
                    fit.name, parameters[worst].name
                ));
                main = main.uncertain(details[worst].standard_uncertainty);
            }
            findings.figures.push(main);
            details.iter_mut().for_each(|figure| figure.detail = true);
        }
        findings.figures.extend(details);
        Ok(())
    }
}

fn figure(fit: &Fit, measure: Measure, name: &str, value: f64, unit: &str) -> Figure {
    Figure::new(&fit.name, format!("{}[{name}]", measure.name().replace('_', " ")), value, unit)
}

/// Relative standard uncertainty of the uncertainties of a parameter, from its effective degrees of freedom. None if the
/// calibration has no budget of the parameter, as after trials.
fn relative_to(fit: &Fit, parameter: &Estimated) -> Option<f64> {
    let budget = fit.calibration.uncertainty.as_ref()?;
    let part = budget.parameters.iter().find(|part| part.name == parameter.name)?;
    Some(relative_uncertainty(part.degrees_of_freedom.unwrap_or(f64::INFINITY)))
}

/// The unit in which people read a parameter, and the factor from memory's.
fn for_people(parameter: &Estimated) -> Result<(String, f64)> {
    let unit: Unit = parameter.unit.parse().map_err(Error::data)?;
    Ok(unit.for_people())
}

/// Error and uncertainty of the tip over the workspace. The uncertainty of a pose is the longest semi-axis of its
/// ellipsoid.
fn judge_workspace(fit: &Fit, workspace: &Workspace, findings: &mut Findings) -> Result<()> {
    let model = fit.problem.model.as_ref();
    let statuses = workspace.grid.statuses(model).map_err(|error| within(error, &["volumetric", "grid"]))?;
    let errors = predict(model, &fit.calibration, &statuses)?;
    let semi_axis = |error: &VolumetricError| {
        let ellipsoid = error.ellipsoid(workspace.probability)?;
        Ok(ellipsoid.semi_axes.map_or(f64::NAN, |semi_axes| semi_axes[0] * 1e3))
    };
    let expanded = errors.iter().map(semi_axis).collect::<Result<Vec<f64>>>()?;
    if let Some(error) = errors.iter().zip(&expanded).find_map(|(error, size)| size.is_nan().then_some(error)) {
        findings.remarks.push(format!(
            "{}: no volumetric ellipsoid, because the uncertainties were found with {:.1} degrees of freedom only",
            fit.name, error.degrees_of_freedom
        ));
    }
    let (sizes, expanded) = (Sample(errors.iter().map(|error| error.size() * 1e3).collect()), Sample(expanded));
    let figure = |name: &str, value, unit| Figure::new(&fit.name, format!("volumetric {name}"), value, unit);
    // Not known if the data cannot separate some parameters, or without a covariance.
    let left_out = left_out(&fit.name, &fit.calibration);
    let largest = errors.iter().max_by(|one, other| one.size().total_cmp(&other.size()));
    let uncertainty = largest.filter(|_| left_out.is_none()).and_then(VolumetricError::size_uncertainty);
    let uncertainty = uncertainty.filter(|uncertainty| *uncertainty > 0.0);
    findings.figures.extend([
        figure("error max", sizes.max(), UM).uncertain(uncertainty.map(|uncertainty| uncertainty * 1e3)),
        figure("error mean", sizes.mean(), UM),
        figure("expanded max", expanded.max(), UM).limited(workspace.expanded_um),
        figure("expanded mean", expanded.mean(), UM),
        figure("poses", errors.len() as f64, ONE),
    ]);
    findings.remarks.extend(left_out);
    Ok(())
}

/// Parameters whose part in the volumetric uncertainty is not known.
fn left_out(name: &str, calibration: &Calibration) -> Option<String> {
    let confounded = calibration.parameters.iter().filter(|parameter| parameter.status == Status::Confounded);
    let confounded: Vec<&str> = confounded.map(|parameter| parameter.name.as_str()).collect();
    (!confounded.is_empty()).then(|| {
        format!(
            "{name}: the volumetric uncertainty leaves out what the data cannot separate: {}",
            confounded.join(", ")
        )
    })
}

#[cfg(test)]
mod tests;

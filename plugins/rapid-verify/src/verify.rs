//! Validator `verify`: go or no-go of runs against the baseline, and the causes of deviations.
//!
//! No-go if any reading is outside of what the baseline had, by more than the tolerance: with repeats of the baseline each point
//! has a smallest and a largest reading (Muelaner et al. 2014, section 4.1).

use std::path::PathBuf;

use abbe_core::{
    Context, Dataset, Error, Figure, Findings, Fit, InputFile, Limit, PathItem, Result, SettingsError, Unit, Validate,
    matches, not_negative, positive,
};
use schemars::JsonSchema;
use serde::Deserialize;
use serde_json::{Value, json};

use crate::baseline::{Baseline, Probed, Run};
use crate::candidates::{Candidates, Names, ParameterGroups};
use crate::diagnosis::{Cause, Diagnoser, Diagnosis, Pattern, Scatter};
use crate::material::ArtefactSettings;
use crate::others::{OtherExplanations, shapes, undeclared};

abbe_core::register!(
    Validate,
    "verify",
    "go or no-go of probing runs against a baseline, and the likely source of deviations",
    Settings,
    example,
    build,
    "../reference/validate-verify.md",
);

/// Settings of the verification.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Settings {
    /// CSV file of the nominal points, the same as the artefact's.
    nominal: String,
    /// The tolerance that decides: a run beyond it fails the verdict.
    #[serde(default)]
    tolerance_um: Option<Limit>,
    /// Further tolerances. Their results are reported and do not change the verdict.
    #[serde(default)]
    compare_um: Vec<f64>,
    /// Patterns of the parameters that may have changed.
    #[serde(default)]
    candidates: Names,
    /// Groups of parameters that change by the same amount, by the name of the group: a shift of the probe moves the tips
    /// of all styli.
    #[serde(default)]
    together: ParameterGroups,
    /// Scatter between healthy runs.
    #[serde(default)]
    healthy: Healthy,
    /// The artefact, for the choice of its material.
    #[serde(default)]
    material: Option<ArtefactSettings>,
}

/// Standard deviations of the differences between healthy runs. They decide which cause is likely, and have no effect
/// on go or no-go.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
struct Healthy {
    /// One reading by itself: probing, resolution.
    #[schemars(range(min = 1e-6, max = 10000))]
    point_um: f64,
    /// Position of the artefact, in each direction.
    #[schemars(range(min = 0, max = 10000))]
    shift_um: f64,
    /// Orientation of the artefact, about each direction.
    #[schemars(range(min = 0, max = 10000))]
    turn_urad: f64,
    /// Expansion of the artefact relative to that of the scales.
    #[schemars(range(min = 0, max = 1000))]
    expansion_um_per_m: f64,
    /// Parameters of the machine that vary, with the temperature of the head for example.
    parameters: Vec<Varying>,
}

/// Parameters that vary between healthy runs.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Varying {
    /// Names or patterns.
    names: Vec<String>,
    /// Standard deviation of lengths.
    #[serde(default)]
    standard_um: Option<f64>,
    /// Standard deviation of angles.
    #[serde(default)]
    standard_urad: Option<f64>,
    /// Standard deviation of scales.
    #[serde(default)]
    standard_um_per_m: Option<f64>,
}

impl Default for Healthy {
    fn default() -> Self {
        // A kinematic mount repeats within about a micrometre (section 5).
        Self { point_um: 0.5, shift_um: 1.0, turn_urad: 3.0, expansion_um_per_m: 10.0, parameters: Vec::new() }
    }
}

impl Varying {
    /// The standard deviation for a parameter of this unit, in it.
    fn standard(&self, unit: Unit) -> Option<f64> {
        let (symbol, factor) = unit.for_people();
        let stated = match symbol.as_str() {
            "µm" => self.standard_um,
            "µrad" => self.standard_urad,
            "µm/m" => self.standard_um_per_m,
            _ => None,
        };
        stated.map(|stated| stated / factor)
    }
}

fn example() -> Value {
    json!({
        "nominal": "points.csv",
        "tolerance_um": 12,
        "compare_um": [4, 12, 20],
        "candidates": ["E*"],
        "together": { "dxt": ["dxt", "stylus[2].x"] },
        "healthy": { "point_um": 0.5, "shift_um": 1, "turn_urad": 3, "parameters": [{ "names": ["dzt"], "standard_um": 1 }] },
        "material": { "length_mm": 160, "temperature_half_range_degC": 2 }
    })
}

fn build(settings: Settings, context: &Context) -> Result<Box<dyn Validate>, SettingsError> {
    settings.tolerance_um.map_or(Ok(0.0), |tolerance| positive("tolerance_um", tolerance.value))?;
    for (index, tolerance) in settings.compare_um.iter().enumerate() {
        let at = |error: SettingsError| SettingsError { path: at("compare_um", index), ..error };
        positive("", *tolerance).map_err(at)?;
    }
    if settings.tolerance_um.is_none() && settings.compare_um.is_empty() {
        let error = SettingsError::new("", "there is no tolerance");
        return Err(error.help("`tolerance_um: 12` decides, `compare_um: [4, 12, 20]` only reports"));
    }
    let healthy = &settings.healthy;
    let in_healthy = |error: SettingsError| error.under([PathItem::Key("healthy".to_owned())]);
    positive("point_um", healthy.point_um).map_err(in_healthy)?;
    for (name, value) in [
        ("shift_um", healthy.shift_um),
        ("turn_urad", healthy.turn_urad),
        ("expansion_um_per_m", healthy.expansion_um_per_m),
    ] {
        not_negative(name, value).map_err(in_healthy)?;
    }
    for (index, varying) in healthy.parameters.iter().enumerate() {
        let stated = [varying.standard_um, varying.standard_urad, varying.standard_um_per_m];
        if stated.iter().flatten().any(|value| !(*value >= 0.0 && value.is_finite())) {
            let error = SettingsError::new("", "standard deviations that are not negative were expected");
            return Err(in_healthy(error.under(at("parameters", index))));
        }
    }
    let in_material = |error: SettingsError| error.under([PathItem::Key("material".to_owned())]);
    settings.material.as_ref().map_or(Ok(()), ArtefactSettings::check).map_err(in_material)?;
    Ok(Box::new(Verify { nominal: context.path(&settings.nominal), settings }))
}

fn at(key: &str, index: usize) -> Vec<PathItem> {
    vec![PathItem::Key(key.to_owned()), PathItem::Index(index)]
}

struct Verify {
    nominal: PathBuf,
    settings: Settings,
}

/// Unit of lengths in figures.
const UM: &str = "um";

/// Distance of a reading from the range of the baseline, µm. It is rounded to a picometre, because binary fractions do not
/// hold decimal ones: a deviation equal to the tolerance is within it.
fn beyond(reading: f64, probed: &Probed) -> f64 {
    let beyond = (reading - probed.max).max(0.0) + (reading - probed.min).min(0.0);
    (beyond * 1e9).round() / 1e6
}

impl Validate for Verify {
    fn inputs(&self) -> Vec<InputFile> {
        vec![InputFile { setting: "nominal", path: self.nominal.clone() }]
    }

    fn accepts_data(&self) -> bool {
        true
    }

    fn validate(&self, fits: &[&Fit], data: &[&Dataset]) -> Result<Findings> {
        let [fit] = fits else {
            return Err(Error::usage("one estimate was expected: that of the baseline").setting("of"));
        };
        if data.is_empty() {
            let error = Error::usage("`from` is missing: the ingest stage of the runs to be judged");
            return Err(error.setting("of").help("add `from: <ingest stage>`"));
        }
        let baseline = Baseline::new(fit, &self.nominal)?;
        let patterns = baseline.patterns(&self.candidates())?;
        let scatter = self.scatter(&baseline)?;
        let diagnoser = Diagnoser::new(&patterns, &scatter, baseline.points.len())
            .ok_or_else(|| Error::data("the scatter of healthy runs has no covariance; is `healthy` plausible?"))?;
        let everything = baseline.patterns(&Candidates { names: Names::default(), ..self.candidates() })?;
        let everything: Vec<Pattern> = everything.into_iter().filter(|pattern| !shapes(fit, pattern)).collect();
        let all = Diagnoser::new(&everything, &scatter, baseline.points.len());
        let missing = undeclared(fit.problem.model.as_ref());
        let others = OtherExplanations { patterns: &everything, diagnoser: all.as_ref(), undeclared: &missing };
        let mut findings = Findings::default();
        let runs = baseline.runs(data)?;
        for (index, run) in runs.iter().enumerate() {
            let report = Report { fit: &fit.name, run, baseline: &baseline, patterns: &patterns };
            self.judge(&report, &diagnoser, &others, &mut findings)?;
            let copied = baseline.copied(run, &runs[..index], scatter.point);
            findings.remarks.extend(copied.map(|copied| copied.remark(&run.name)));
        }
        if let Some(artefact) = &self.settings.material {
            for tolerance in self.tolerances() {
                let (largest, text) = artefact.advise(tolerance);
                let name = format!("largest expansion at {tolerance} um");
                findings.figures.push(Figure::new(&fit.name, name, largest, "um/m/K").detail());
                findings.remarks.push(text);
            }
        }
        Ok(findings)
    }
}

/// The data for the report on one run.
pub struct Report<'a> {
    fit: &'a str,
    run: &'a Run,
    baseline: &'a Baseline,
    pub(crate) patterns: &'a [Pattern],
}

impl Verify {
    fn candidates(&self) -> Candidates {
        Candidates { names: self.settings.candidates.clone(), together: self.settings.together.clone(), places: false }
    }

    /// All tolerances, ascending, each once.
    fn tolerances(&self) -> Vec<f64> {
        let mut all = self.settings.compare_um.clone();
        all.extend(self.settings.tolerance_um.map(|tolerance| tolerance.value));
        all.sort_by(f64::total_cmp);
        all.dedup();
        all
    }

    fn scatter(&self, baseline: &Baseline) -> Result<Scatter> {
        let Healthy { point_um, shift_um, turn_urad, expansion_um_per_m, parameters } = &self.settings.healthy;
        let all = baseline.patterns(&Candidates { places: true, ..Candidates::default() })?;
        let (machine, artefact): (Vec<_>, Vec<_>) = all.iter().partition(|pattern| !pattern.parameters.is_empty());
        let of_artefact =
            [*shift_um * 1e-3; 3].into_iter().chain([*turn_urad * 1e-6; 3]).chain([expansion_um_per_m * 1e-6]);
        let mut common: Vec<Vec<f64>> = Vec::new();
        let mut add = |pattern: &Pattern, size: f64| {
            common.push(pattern.effect.iter().map(|effect| effect * size).collect());
        };
        artefact.iter().zip(of_artefact).for_each(|(pattern, size)| add(pattern, size));
        for (index, varying) in parameters.iter().enumerate() {
            for name in &varying.names {
                let wrong = |message: String| {
                    let mut error = Error::usage(message).setting("healthy");
                    error.setting.extend(at("parameters", index));
                    error
                };
                let mut found = machine.iter().filter(|pattern| matches(name, &pattern.name)).peekable();
                if found.peek().is_none() {
                    return Err(wrong(format!("`{name}` matches no parameter of the machine")));
                }
                for pattern in found {
                    let (symbol, _) = pattern.unit.for_people();
                    let size = varying.standard(pattern.unit).ok_or_else(|| {
                        wrong(format!("there is no standard deviation for `{}`, which is in {symbol}", pattern.name))
                    })?;
                    add(pattern, size);
                }
            }
        }
        Ok(Scatter { point: point_um * 1e-3, common })
    }

    fn judge(
        &self,
        report: &Report<'_>,
        diagnoser: &Diagnoser<'_>,
        others: &OtherExplanations<'_>,
        findings: &mut Findings,
    ) -> Result<()> {
        let Report { run, baseline, .. } = report;
        let beyond: Vec<f64> =
            run.readings.iter().zip(&baseline.points).map(|(reading, probed)| beyond(*reading, probed)).collect();
        let deviations: Vec<f64> =
            run.readings.iter().zip(&baseline.points).map(|(reading, probed)| reading - probed.mean).collect();
        let worst = (0..beyond.len()).max_by(|&one, &other| beyond[one].abs().total_cmp(&beyond[other].abs()));
        let worst = worst.unwrap_or_default();
        let figure = |name: String, value: f64, unit: &str| Figure::new(report.fit, name, value, unit);
        let largest = figure(format!("largest deviation[{}]", run.name), beyond[worst].abs(), UM);
        findings.figures.push(largest.limited(self.settings.tolerance_um));
        let (mut go, mut no_go) = (Vec::new(), Vec::new());
        let mut first_out = None;
        for tolerance in self.tolerances() {
            let out = beyond.iter().filter(|beyond| beyond.abs() > tolerance).count();
            let name = format!("points out at {tolerance} um[{}]", run.name);
            findings.figures.push(figure(name, out as f64, "1").detail());
            if out == 0 {
                go.push(tolerance)
            } else {
                no_go.push(tolerance)
            }
            first_out = first_out.or((out > 0).then_some((tolerance, out)));
        }
        let label = &baseline.points[worst].point.label;
        let verdicts = [("no-go at", &no_go), ("go at", &go)].into_iter().filter(|(_, list)| !list.is_empty());
        let verdicts: Vec<String> = verdicts.map(|(word, list)| format!("{word} {} µm", listed(list))).collect();
        let mut text = format!("{}: {}: ", run.name, verdicts.join(", "));
        let Some((tolerance, out)) = first_out else {
            text.push_str(&format!("largest deviation {} µm at {label}", short(beyond[worst])));
            findings.remarks.push(text);
            return Ok(());
        };
        let noun = if out == 1 { "point is" } else { "points are" };
        text.push_str(&format!("{label} is off by {} µm, {out} {noun} beyond {tolerance} µm; ", short(beyond[worst])));
        if let Some(sentence) = elsewhere(&deviations) {
            findings.remarks.push(text + &sentence);
            return Ok(());
        }
        let mut found = diagnoser.diagnose(&deviations);
        self.refine(report, diagnoser, &deviations, &mut found)?;
        text.push_str(&report.source(&found, &deviations));
        if let Some(sentence) = others.sentence(report, &found, &deviations) {
            text.push_str(&format!("; {sentence}"));
        }
        findings.remarks.push(text);
        report.figures(&found, &deviations, findings);
        Ok(())
    }

    /// Sizes by the nonlinear model: the linear fit leaves out terms of second order.
    fn refine(
        &self,
        report: &Report<'_>,
        diagnoser: &Diagnoser<'_>,
        deviations: &[f64],
        found: &mut Diagnosis,
    ) -> Result<()> {
        for cause in found.causes.iter_mut().chain(&mut found.rivals) {
            let parameters = &report.patterns[cause.pattern].parameters;
            if parameters.is_empty() {
                continue;
            }
            for _ in 0..20 {
                let changes = report.baseline.changes(parameters, cause.size)?;
                let rest: Vec<f64> = deviations.iter().zip(changes).map(|(seen, change)| seen - change).collect();
                let step = diagnoser.step(cause.pattern, &found.touches, &rest);
                cause.size += step;
                if step.abs() <= 1e-13 * cause.size.abs() {
                    break;
                }
            }
        }
        Ok(())
    }
}

impl Report<'_> {
    fn figures(&self, found: &Diagnosis, deviations: &[f64], findings: &mut Findings) {
        let run = &self.run.name;
        let mut add = |name: String, value: f64, unit: &str| {
            findings.figures.push(Figure::new(self.fit, name, value, unit).detail());
        };
        for (what, causes) in [("likely source", &found.causes), ("nearly as likely", &found.rivals)] {
            for cause in causes {
                let pattern = &self.patterns[cause.pattern];
                add(format!("{what}[{run}]: {}", pattern.name), cause.size, &pattern.unit.to_string());
            }
        }
        for &touch in &found.touches {
            let label = &self.baseline.points[touch].point.label;
            add(format!("failing touch[{run}]: {label}"), deviations[touch] * 1e3, UM);
        }
        let (squares, freedom) = found.unexplained;
        add(format!("chi-squared left[{run}]"), squares, "1");
        add(format!("degrees of freedom[{run}]"), freedom as f64, "1");
    }

    /// A cause with its size, as people read it.
    fn cause(&self, cause: &Cause) -> String {
        let pattern = &self.patterns[cause.pattern];
        let (symbol, factor) = pattern.unit.for_people();
        format!("{} ({} {symbol})", pattern.name, short(cause.size * factor))
    }

    fn list(&self, causes: &[Cause]) -> String {
        causes.iter().map(|cause| self.cause(cause)).collect::<Vec<_>>().join(", ")
    }

    /// Where the deviations come from, in words.
    fn source(&self, found: &Diagnosis, deviations: &[f64]) -> String {
        let mut parts = Vec::new();
        match found.causes.as_slice() {
            [] => {}
            [first, rest @ ..] => {
                let explained = first.explained.clamp(0.0, 1.0) * 100.0;
                let first = self.cause(first);
                parts.push(format!("likely source: a change of {first}, which explains {explained:.1} %"));
                if !rest.is_empty() {
                    parts.push(format!("the same pattern, which these points cannot tell apart: {}", self.list(rest)));
                }
                if !found.rivals.is_empty() {
                    parts.push(format!("nearly as likely: {}", self.list(&found.rivals)));
                }
            }
        }
        if !found.touches.is_empty() {
            let touch = |&touch: &usize| {
                format!("{} ({} µm)", self.baseline.points[touch].point.label, short(deviations[touch] * 1e3))
            };
            let touches: Vec<String> = found.touches.iter().map(touch).collect();
            let what =
                if found.causes.is_empty() { "likely source: failing touches" } else { "besides, failing touches" };
            parts.push(format!(
                "{what} of {}, which no error of the machine explains: clean artefact and stylus, probe again, then check the probe",
                touches.join(", ")
            ));
        }
        if found.causes.is_empty() && found.touches.is_empty() {
            parts.push(
                "no single error explains this better than the seat and the temperature of the artefact do".to_owned(),
            );
        }
        if !found.is_complete() {
            parts.push(
                "what is left is more than healthy runs scatter by: several errors at once, or one that is no candidate"
                    .to_owned(),
            );
        }
        parts.join("; ")
    }
}

/// Deviations, mm, of half of the points that no error of a machine makes.
const ELSEWHERE: f64 = 5.0;

/// What is wrong with a run whose points are somewhere else: no error of the machine is looked for then.
fn elsewhere(deviations: &[f64]) -> Option<String> {
    let mut sizes: Vec<f64> = deviations.iter().map(|deviation| deviation.abs()).collect();
    sizes.sort_by(f64::total_cmp);
    let median = *sizes.get(sizes.len() / 2)?;
    (median > ELSEWHERE).then(|| {
        format!(
            "half of the points are off by {median:.1} mm or more, which no error of a machine makes: look for another unit, sign or \
             column, another program, or an artefact that stands elsewhere"
        )
    })
}

/// Four digits, without an exponent where people read none.
pub fn short(value: f64) -> String {
    match value.abs() {
        0.0 => "0".to_owned(),
        size if (1e-2..1e6).contains(&size) => {
            let decimals = (3 - size.log10().floor() as i32).clamp(0, 5) as usize;
            format!("{value:.decimals$}")
        }
        _ => format!("{value:.3e}"),
    }
}

/// `4, 12 and 20`.
fn listed(numbers: &[f64]) -> String {
    let texts: Vec<String> = numbers.iter().map(f64::to_string).collect();
    match texts.as_slice() {
        [first @ .., last] if !first.is_empty() => format!("{} and {last}", first.join(", ")),
        _ => texts.concat(),
    }
}

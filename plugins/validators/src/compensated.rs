//! Validator `compensated`: the errors of the tool before and after a correction, over the workspace or over a path.

use std::path::PathBuf;

use abbe_compensation::{
    Compensator, Expected, Remaining, SetPoints, Settings as Correction, Travel, Trials, check_confounded,
    check_confounded_anywhere, remaining,
};
use abbe_core::{
    Context, Dataset, Error, Export, Figure, Findings, Fit, InputFile, KinematicModel, Limit, PathItem, Result,
    SettingsError, Validate, machine_values,
};
use abbe_volumetric::{Grid, position_unit, predict, rounded_position, within};
use schemars::JsonSchema;
use serde::Deserialize;
use serde_json::{Value, json};

use crate::figures::{Limits, ONE, UM, URAD, check_limits, key};

abbe_core::register!(
    Validate,
    "compensated",
    "errors of the tool before and after a correction, for exact set-points and for exported tables",
    Settings,
    example,
    build,
    "../reference/validate-compensated.md",
);

/// Settings of the prediction.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Settings {
    /// The set-points, as a grid over the workspace. Either `grid` or `path` is needed.
    #[serde(default)]
    grid: Option<Grid>,
    /// The set-points, as a CSV file like that of the exporter `set-points`.
    #[serde(default)]
    path: Option<String>,
    /// How set-points are corrected exactly. Default: the position of the tip, and
    /// corrections may leave the travel: the control has limits of its own.
    #[serde(default)]
    correction: Option<Correction>,
    /// Number of machines that are drawn from the covariance of the calibration.
    #[serde(default = "default_trials")]
    trials: usize,
    /// Seed of their random numbers.
    #[serde(default)]
    seed: u64,
    /// Probability with which an error is below its upper limit.
    #[serde(default = "default_probability")]
    probability: f64,
    /// Largest admissible values after the correction: `tip_max_um`, `tip_rms_um`, `tip_upper_um`, `axis_max_urad`, `axis_rms_urad`,
    /// `axis_upper_urad`. They hold for every export that is judged, or for exact set-points where there is none.
    #[serde(default)]
    limits: Limits,
}

fn default_trials() -> usize {
    500
}

fn default_probability() -> f64 {
    0.95
}

/// More trials are not waited for.
const MOST_TRIALS: usize = 1_000_000;

fn example() -> Value {
    json!({ "grid": { "points": 5, "both_directions": true }, "limits": { "tip_upper_um": 10 } })
}

/// Name, unit and factor from memory of each figure, and where its value stands.
type Row = (&'static str, &'static str, f64, fn(&Remaining) -> (f64, Option<f64>));

const FIGURES: [Row; 6] = [
    ("tip max", UM, 1e3, |found| with_uncertainty(&found.tip_max)),
    ("tip rms", UM, 1e3, |found| with_uncertainty(&found.tip_rms)),
    ("tip upper", UM, 1e3, |found| (found.tip_max.upper, None)),
    ("axis max", URAD, 1e6, |found| with_uncertainty(&found.axis_max)),
    ("axis rms", URAD, 1e6, |found| with_uncertainty(&found.axis_rms)),
    ("axis upper", URAD, 1e6, |found| (found.axis_max.upper, None)),
];

fn with_uncertainty(expected: &Expected) -> (f64, Option<f64>) {
    (expected.estimate, Some(expected.standard_uncertainty))
}

fn build(settings: Settings, context: &Context) -> Result<Box<dyn Validate>, SettingsError> {
    let at = |name: &str| [PathItem::Key(name.to_owned())];
    if settings.grid.is_some() == settings.path.is_some() {
        return Err(SettingsError::new("", "either `grid` or `path` was expected"));
    }
    if let Some(grid) = &settings.grid {
        grid.check().map_err(|error| error.under(at("grid")))?;
    }
    if let Some(correction) = &settings.correction {
        correction.check().map_err(|error| error.under(at("correction")))?;
    }
    if settings.trials > MOST_TRIALS {
        return Err(SettingsError::new("trials", format!("at most {MOST_TRIALS} were expected")));
    }
    settings.all_trials().check()?;
    let keys: Vec<String> = FIGURES.iter().map(|(name, unit, ..)| key(name, unit)).collect();
    check_limits(&settings.limits, &keys.iter().map(String::as_str).collect::<Vec<_>>())?;
    let path = settings.path.as_ref().map(|path| context.path(path));
    Ok(Box::new(Compensated { settings, path }))
}

impl Settings {
    fn all_trials(&self) -> Trials {
        Trials { number: self.trials, seed: self.seed, probability: self.probability }
    }

    fn correction(&self) -> Correction {
        // Grids reach to the ends of travel, and corrections at the ends a little farther.
        self.correction.clone().unwrap_or(Correction { travel: Travel::Allow, ..Correction::default() })
    }
}

struct Compensated {
    settings: Settings,
    path: Option<PathBuf>,
}

impl Validate for Compensated {
    fn inputs(&self) -> Vec<InputFile> {
        self.path.iter().map(|path| InputFile { setting: "path", path: path.clone() }).collect()
    }

    fn accepts_exports(&self) -> bool {
        true
    }

    fn validate(&self, fits: &[&Fit], data: &[&Dataset]) -> Result<Findings> {
        self.validate_exports(fits, data, &[])
    }

    fn validate_exports(&self, fits: &[&Fit], _: &[&Dataset], exports: &[(&str, &dyn Export)]) -> Result<Findings> {
        let mut findings = Findings::default();
        for fit in fits {
            self.judge(fit, exports, &mut findings)?;
        }
        Ok(findings)
    }
}

/// One way to drive the machine along the set-points.
struct Way<'a> {
    name: &'a str,
    statuses: Vec<f64>,
    is_judged: bool,
}

impl Compensated {
    fn judge(&self, fit: &Fit, exports: &[(&str, &dyn Export)], findings: &mut Findings) -> Result<()> {
        let (model, calibration) = (fit.problem.model.as_ref(), &fit.calibration);
        let points = self.path.as_ref().map(|path| SetPoints::read(path, model)).transpose()?;
        let locate = |error: Error| match &points {
            Some(points) => points.locate(error),
            None => error,
        };
        let programmed = match (&points, &self.settings.grid) {
            (Some(points), _) => points.statuses().to_vec(),
            (None, Some(grid)) => grid.statuses(model).map_err(|error| within(error, &["grid"]))?,
            (None, None) => return Err(Error::usage("either `grid` or `path` was expected")),
        };
        match &self.settings.grid {
            // A grid stands for all that is between its points.
            Some(grid) if points.is_none() => check_confounded_anywhere(model, calibration, &grid.axes)?,
            _ => check_confounded(model, calibration, &programmed).map_err(locate)?,
        }
        let correction = self.settings.correction();
        let values = machine_values(model, calibration);
        let exact = Compensator::new(model, &values, &correction).and_then(|exact| exact.correct(&programmed));
        let (exact, _) = exact.map_err(|error| locate(within(error, &["correction"])))?;
        let mut ways = vec![
            Way { name: "before", statuses: programmed.clone(), is_judged: false },
            Way { name: "exact", statuses: exact, is_judged: exports.is_empty() },
        ];
        for (name, export) in exports {
            let correction = export
                .correction(calibration, model)?
                .ok_or_else(|| Error::usage(format!("the files of `{name}` correct nothing")).setting("exports"))?;
            ways.push(Way { name, statuses: correction.commands(&programmed).map_err(locate)?, is_judged: true });
        }
        let driven: Vec<&[f64]> = ways.iter().map(|way| way.statuses.as_slice()).collect();
        let found = remaining(model, calibration, &programmed, &driven, &self.settings.all_trials())?;
        for (way, found) in ways.iter().zip(&found) {
            findings.figures.extend(self.figures(&fit.name, way, found));
        }
        let count = programmed.len() / model.info().status.len().max(1);
        findings.figures.push(Figure::new(&fit.name, "points", count as f64, ONE));
        let several = if findings.tables.is_empty() { String::new() } else { format!("-{}", fit.name) };
        findings.tables.insert(format!("compensated{several}.csv"), table(fit, &programmed, &ways)?);
        Ok(())
    }

    fn figures(&self, fit: &str, way: &Way, found: &Remaining) -> Vec<Figure> {
        let figure = |(name, unit, factor, value): &Row| {
            let (value, uncertainty) = value(found);
            let limit: Option<Limit> = self.settings.limits.get(&key(name, unit)).copied().filter(|_| way.is_judged);
            Figure::new(fit, format!("{name}[{}]", way.name), value * factor, unit)
                .uncertain(uncertainty.map(|uncertainty| uncertainty * factor))
                .limited(limit)
        };
        FIGURES.iter().map(figure).collect()
    }
}

/// A row for every set-point: its commands, the distance of the tip from its goal for every way, and the largest standard uncertainty
/// of the tip there.
fn table(fit: &Fit, programmed: &[f64], ways: &[Way]) -> Result<String> {
    let model: &dyn KinematicModel = fit.problem.model.as_ref();
    let tips = |statuses: &[f64], values: &[f64]| {
        let mut poses = abbe_core::Poses::default();
        model.poses(statuses, values, &[], false, &mut poses).map(|()| poses.positions)
    };
    let goal = tips(programmed, &model.info().without_errors())?;
    let values = machine_values(model, &fit.calibration);
    let driven = ways.iter().map(|way| tips(&way.statuses, &values)).collect::<Result<Vec<_>>>()?;
    let known = predict(model, &fit.calibration, programmed)?;
    let mut cells: Vec<String> = (model.info().axes.iter())
        .map(|axis| format!("{}_{}", axis.name, position_unit(axis).0))
        .chain(ways.iter().map(|way| format!("{}_um", way.name)))
        .collect();
    cells.push("standard_uncertainty_um".to_owned());
    let mut text = cells.join(",") + "\n";
    for (point, status) in programmed.chunks(model.info().status.len().max(1)).enumerate() {
        let positions = model.info().axes.iter().map(|axis| {
            let (_, factor) = position_unit(axis);
            rounded_position(status[axis.status] * factor).to_string()
        });
        let distance = |tip: &[f64; 3]| {
            let apart = tip.iter().zip(&goal[point]).map(|(tip, goal)| (tip - goal).powi(2)).sum::<f64>().sqrt();
            format!("{:.6}", apart * 1e3)
        };
        let ellipsoid = known[point].ellipsoid(0.95)?;
        let largest = ellipsoid.standard_uncertainties.iter().copied().fold(0.0, f64::max);
        let cells: Vec<String> = positions
            .chain(driven.iter().map(|tips| distance(&tips[point])))
            .chain([format!("{:.6}", largest * 1e3)])
            .collect();
        text.push_str(&cells.join(","));
        text.push('\n');
    }
    Ok(text)
}

//! Validator `geometric-bias`: how far the linear axes stand from where those of the perfect machine would, and how much of
//! that the calibration explains (Viprey et al. 2019, eq. 2 and section 6).
//!
//! The tip meets a feature at given positions of the rotary axes. The bias is the recorded position of the linear axes minus
//! the position at which the nominal machine brings its tip there. The residue is the same with the calibrated machine. Both
//! are norms over the linear axes, which are the axes that are compensated.

use std::collections::BTreeSet;

use abbe_core::{
    AxisKind, Contact, Context, Dataset, Error, Figure, Findings, Fit, Problem, Result, RowIndex, SetIndex,
    SettingsError, Validate, matches, positive,
};
use abbe_estimation::at_contact;
use schemars::JsonSchema;
use serde::Deserialize;
use serde_json::{Value, json};

use crate::figures::{Limits, ONE, Sample, UM, check_limits, set_limits};

/// Unit of percentages in figures.
const PERCENT: &str = "percent";

abbe_core::register!(
    Validate,
    "geometric-bias",
    "positions of the linear axes against those of the nominal and of the calibrated machine",
    Settings,
    example,
    build,
    "../reference/validate-geometric-bias.md",
);

/// Settings of the geometric bias.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Settings {
    /// The artefact stage whose rows count.
    rows: String,
    /// Count only the first row with each label of this column. Features that are measured again to see the drift then
    /// count once.
    #[serde(default)]
    first_of: Option<String>,
    /// Parameters whose effect is subtracted first: motion errors, drift; `?` and `*` are wildcards.
    #[serde(default)]
    compensated: Vec<String>,
    /// Count the rows with a residue of this or less.
    #[serde(default)]
    within_um: Option<f64>,
    /// Largest admissible values: `bias_mean_um`, `bias_max_um`, `compensated_mean_um`, `compensated_max_um`,
    /// `remaining_bias_mean_um`, `remaining_bias_max_um`, `residue_mean_um`, `residue_max_um`.
    #[serde(default)]
    limits: Limits,
}

fn example() -> Value {
    json!({ "rows": "sphere", "first_of": "config", "compensated": ["E??[spl*]"], "limits": { "residue_mean_um": 10 } })
}

fn build(settings: Settings, _: &Context) -> Result<Box<dyn Validate>, SettingsError> {
    let keys = ["bias", "compensated", "remaining_bias", "residue"]
        .iter()
        .flat_map(|name| [format!("{name}_mean_um"), format!("{name}_max_um")]);
    let keys: Vec<String> = keys.collect();
    check_limits(&settings.limits, &keys.iter().map(String::as_str).collect::<Vec<_>>())?;
    if let Some(within) = settings.within_um {
        positive("within_um", within)?;
    }
    Ok(Box::new(GeometricBias { settings }))
}

struct GeometricBias {
    settings: Settings,
}

impl Validate for GeometricBias {
    fn observations(&self) -> Vec<(&'static str, String)> {
        vec![("rows", self.settings.rows.clone())]
    }

    fn needs_rows(&self) -> bool {
        true
    }

    fn validate(&self, fits: &[&Fit], _: &[&Dataset]) -> Result<Findings> {
        let mut figures = Vec::new();
        for fit in fits {
            figures.extend(self.figures(fit)?);
        }
        set_limits(&self.settings.limits, &mut figures);
        Ok(Findings { figures, ..Findings::default() })
    }
}

/// Positions of the linear axes, one for every row.
type Positions = Vec<Vec<f64>>;

impl GeometricBias {
    fn figures(&self, fit: &Fit) -> Result<Vec<Figure>> {
        let problem = fit.problem.as_ref();
        let missing = || Error::usage(format!("`{}` is not observed", self.settings.rows)).setting("rows");
        let set = problem.set_named(&self.settings.rows).ok_or_else(missing)?;
        if problem.sets[set].info().contact != Contact::LinearAxes {
            let error = Error::usage(format!("`{}` is read, not met by the linear axes", self.settings.rows));
            return Err(error.setting("rows"));
        }
        let rows = self.rows(problem, set)?;
        let x = problem.values_of(&fit.calibration);
        let calibrated = problem.with_values(&x);
        let nominal = self.nominal(problem, None)?;
        let recorded = positions(problem, set, &rows);
        let met = |problem: &Problem| -> Result<Positions> {
            Ok(positions(&at_contact(problem, &problem.start())?, set, &rows))
        };
        let (of_nominal, of_calibrated) = (met(&nominal)?, met(&calibrated)?);
        let mut figures = Vec::new();
        let mut add = |name: &str, sample: &Sample| {
            figures.push(Figure::new(&fit.name, format!("{name} mean"), sample.mean(), UM));
            figures.push(Figure::new(&fit.name, format!("{name} max"), sample.max(), UM));
        };
        let bias = distances(&recorded, &of_nominal);
        add("bias", &bias);
        let residue = distances(&recorded, &of_calibrated);
        let mut before = bias;
        if !self.settings.compensated.is_empty() {
            let of_compensated = met(&self.nominal(problem, Some(&calibrated))?)?;
            add("compensated", &distances(&of_compensated, &of_nominal));
            before = distances(&recorded, &of_compensated);
            add("remaining bias", &before);
        }
        add("residue", &residue);
        let characterised = 100.0 * (1.0 - residue.mean() / before.mean());
        figures.push(Figure::new(&fit.name, "characterised", characterised, PERCENT));
        figures.push(Figure::new(&fit.name, "rows", rows.len() as f64, ONE));
        if let Some(within) = self.settings.within_um {
            let count = residue.0.iter().filter(|residue| **residue <= within).count();
            figures.push(Figure::new(&fit.name, "rows within", count as f64, ONE));
        }
        Ok(figures)
    }

    /// The rows that are evaluated.
    fn rows(&self, problem: &Problem, set: SetIndex) -> Result<Vec<RowIndex>> {
        let set = &problem.sets[set];
        let layout = &set.info().layout;
        let labels = match &self.settings.first_of {
            Some(column) => Some(abbe_table::labels(&layout.data, column).map_err(|error| error.setting("first_of"))?),
            None => None,
        };
        let mut seen = BTreeSet::new();
        let counts = |row: &RowIndex| {
            let row = layout.rows[*row];
            row.poses > 0
                && row.data_row.is_some_and(|data_row| labels.is_none_or(|labels| seen.insert(&labels[data_row])))
        };
        Ok(set.rows.iter().copied().filter(counts).collect())
    }

    /// The machine without errors, apart from those that are compensated, which have the values of `values`.
    fn nominal(&self, problem: &Problem, values: Option<&Problem>) -> Result<Problem> {
        let mut nominal = problem.clone();
        nominal.machine_values = nominal.model.info().nominal.clone();
        for set in &mut nominal.sets {
            set.own = set.info().start.clone();
        }
        let Some(values) = values else { return Ok(nominal) };
        let parameters = &problem.model.info().parameters;
        for (index, pattern) in self.settings.compensated.iter().enumerate() {
            let named = (0..parameters.len()).filter(|&place| matches(pattern, &parameters[place].name));
            let named: Vec<usize> = named.collect();
            named.iter().for_each(|&place| nominal.machine_values[place] = values.machine_values[place]);
            if named.is_empty() {
                let names = parameters.iter().map(|parameter| parameter.name.as_str());
                let mut error = Error::usage(format!("`{pattern}` matches no parameter of the machine"));
                error = error.suggest(pattern, names);
                error.setting =
                    vec![abbe_core::PathItem::Key("compensated".to_owned()), abbe_core::PathItem::Index(index)];
                return Err(error);
            }
        }
        Ok(nominal)
    }
}

/// Positions of the linear axes at the poses of some rows.
fn positions(problem: &Problem, set: SetIndex, rows: &[RowIndex]) -> Positions {
    let axes = problem.model.info().axes.iter().filter(|axis| axis.kind == AxisKind::Linear);
    let axes: Vec<usize> = axes.map(|axis| axis.status).collect();
    let set = &problem.sets[set];
    let poses = set.poses_of(rows);
    poses.map(|pose| axes.iter().map(|&axis| set.poses().row(pose)[axis]).collect()).collect()
}

/// Distances between two lists of positions, µm.
fn distances(these: &Positions, those: &Positions) -> Sample {
    let distance = |(this, that): (&Vec<f64>, &Vec<f64>)| {
        this.iter().zip(that).map(|(this, that)| (this - that).powi(2)).sum::<f64>().sqrt() * 1e3
    };
    Sample(these.iter().zip(those).map(distance).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{UPWARDS, check, judge};

    #[test]
    fn positions_are_compared_with_those_of_nominal_contact() {
        let touches = [("a", "1", 0.0, 0.0), ("a", "1", 0.0, 2.0), ("b", "1", 0.0, 0.0), ("b", "1", 0.0, 4.0)];
        let (folder, fit) = crate::testing::fit(&UPWARDS, &touches, false);
        let judged = |settings: &Value| judge("geometric-bias", folder.path(), settings, &fit);
        // Facets lie 1 and 2 um too high.
        let settings = json!({ "rows": fit.problem.sets[0].name, "within_um": 1.5, "limits": { "residue_max_um": 1 } });
        let found = judged(&settings).unwrap();
        check(
            &found,
            &[
                ("bias mean", 1.5),
                ("bias max", 4.0),
                ("residue mean", 1.5),
                ("residue max", 2.0),
                ("characterised", 0.0),
                ("rows", 4.0),
                ("rows within", 2.0),
            ],
        );
        assert_eq!(found.figures.iter().filter(|figure| !figure.passes()).count(), 1);
        let first = judged(&json!({ "rows": fit.problem.sets[0].name, "first_of": "feature" })).unwrap();
        assert_eq!(first.figures.iter().find(|figure| figure.name == "rows").unwrap().value, Some(2.0));
        let wrong = judged(&json!({ "rows": fit.problem.sets[0].name, "compensated": ["EXX*"] })).unwrap_err();
        assert!(wrong.contains("`EXX*` matches no parameter of the machine"), "{wrong}");
        let column = judged(&json!({ "rows": fit.problem.sets[0].name, "first_of": "config" })).unwrap_err();
        assert!(column.contains("there is no column `config`"), "{column}");
    }
}

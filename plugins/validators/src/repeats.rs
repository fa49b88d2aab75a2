//! Validator `repeats`: the spread of the estimates of repeated measurements, each estimated by itself.
//!
//! The scatter of residuals shows how well a model fits the rows of one measurement. Rows that follow one another in a sweep
//! are not independent, and residuals do not show what changes between repeats (seating, direction, temperature). The spread
//! of the estimates of whole repeats includes all of that (Jiang & Cripps 2015, Tables 2 and 3).

use std::sync::Arc;

use abbe_core::{
    Context, Dataset, Error, Figure, Findings, Fit, LabelText, Owner, PathItem, Problem, Result, RowIndex,
    SettingsError, Unknown, Validate, in_parallel, matches,
};
use schemars::JsonSchema;
use serde::Deserialize;
use serde_json::{Value, json};

use crate::figures::{Limits, ONE, Sample, ascii, check_finite, relative_uncertainty, suffix, uncertainty_of_scatter};
use crate::folds::report;

abbe_core::register!(
    Validate,
    "repeats",
    "mean and standard deviation of the estimates of repeats, each estimated by itself",
    Settings,
    example,
    build,
    "../reference/validate-repeats.md",
);

/// Settings of the repeats.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Settings {
    /// The column whose labels tell the repeats apart. Rows of artefacts whose data do not have it take part in every repeat.
    #[serde(default = "default_column")]
    by: String,
    /// Names or patterns of the estimated parameters to report. Default: those of the machine.
    #[serde(default)]
    parameters: Option<Vec<String>>,
    /// Largest admissible standard deviation of one repeat, by unit: `standard_deviation_um`, `standard_deviation_urad`.
    #[serde(default)]
    limits: Limits,
}

fn default_column() -> String {
    "cycle".to_owned()
}

fn example() -> Value {
    json!({ "by": "cycle", "limits": { "standard_deviation_um": 1, "standard_deviation_urad": 5 } })
}

/// What the keys of limits begin with.
const LIMITED: &str = "standard_deviation";

fn build(settings: Settings, _: &Context) -> Result<Box<dyn Validate>, SettingsError> {
    for (key, limit) in &settings.limits {
        let under = |error: SettingsError| error.under([PathItem::Key("limits".to_owned())]);
        if !key.starts_with(LIMITED) {
            let mut error = SettingsError::new(key, format!("there is no figure `{key}` to limit"));
            error.key = true;
            return Err(under(error.help("write `standard_deviation_um`, or another unit of the parameters")));
        }
        check_finite(key, limit).map_err(under)?;
    }
    Ok(Box::new(Repeats { settings }))
}

struct Repeats {
    settings: Settings,
}

impl Validate for Repeats {
    fn needs_rows(&self) -> bool {
        true
    }

    fn validate(&self, fits: &[&Fit], _: &[&Dataset]) -> Result<Findings> {
        let mut findings = Findings::default();
        let mut units: Vec<String> = Vec::new();
        for fit in fits {
            let chosen = self.chosen(&fit.problem)?;
            units.extend(chosen.iter().map(|(_, unknown)| suffix(&unknown.unit.for_people().0)));
            self.judge(fit, &chosen, &mut findings)?;
        }
        let unused =
            self.settings.limits.keys().find(|key| !units.iter().any(|unit| **key == format!("{LIMITED}{unit}")));
        match unused {
            None => Ok(findings),
            Some(key) => {
                let mut error = Error::usage(format!("`{key}` limits nothing: no parameter is told in that unit"));
                error.setting = ["limits", key].map(|key| PathItem::Key(key.to_owned())).into();
                Err(error)
            }
        }
    }
}

impl Repeats {
    /// The unknowns whose scatter is reported, with their places.
    fn chosen<'a>(&self, problem: &'a Problem) -> Result<Vec<(usize, &'a Unknown)>> {
        let all = || problem.unknowns.iter().enumerate();
        let Some(patterns) = &self.settings.parameters else {
            return Ok(all().filter(|(_, unknown)| unknown.owner == Owner::Machine).collect());
        };
        for (index, pattern) in patterns.iter().enumerate() {
            if !all().any(|(_, unknown)| matches(pattern, &unknown.name)) {
                let error = Error::usage(format!("`{pattern}` matches nothing that {} estimates", problem.name));
                let mut error = error.suggest(pattern, problem.unknowns.iter().map(|unknown| unknown.name.as_str()));
                error.setting = vec![PathItem::Key("parameters".to_owned()), PathItem::Index(index)];
                return Err(error);
            }
        }
        Ok(all().filter(|(_, unknown)| patterns.iter().any(|pattern| matches(pattern, &unknown.name))).collect())
    }

    fn judge(&self, fit: &Fit, chosen: &[(usize, &Unknown)], findings: &mut Findings) -> Result<()> {
        let repeats = repeats(&fit.problem, &self.settings.by)?;
        let start = fit.problem.values_of(&fit.calibration);
        let estimated = in_parallel(&repeats, None, |(label, rows)| {
            let mut problem = fit.problem.watched_by(fit.problem.monitor.without_events()).with_values(&start);
            for (set, rows) in problem.sets.iter_mut().zip(rows) {
                set.rows.clone_from(rows);
                // Only values are needed: the scatter of repeats is the result here.
                Arc::make_mut(&mut set.uncertainty).pooled = None;
            }
            fit.estimator.estimate(&problem).map(|calibration| problem.values_of(&calibration)).map_err(|error| Error {
                message: format!("{} {label} by itself: {}", self.settings.by, error.message),
                ..error
            })
        });
        let (mut values, mut failures) = (Vec::new(), Vec::new());
        for result in estimated {
            match result {
                Ok(found) => values.push(found),
                Err(error) if error.fatal => return Err(error),
                Err(error) => failures.push(error),
            }
        }
        match failures.first() {
            // A scatter needs two.
            Some(error) if values.len() < 2 => return Err(error.clone()),
            _ => report(fit, "failed repeats", failures, findings),
        }
        for &(place, unknown) in chosen {
            let (symbol, factor) = unknown.unit.for_people();
            let unit = ascii(&symbol);
            let sample = Sample(values.iter().map(|values| values[place] * factor).collect());
            let deviation = sample.standard_deviation();
            let figure = |name: &str, value| Figure::new(&fit.name, format!("{name}[{}]", unknown.name), value, &unit);
            let limit = self.settings.limits.get(&format!("{LIMITED}{}", suffix(&symbol))).copied();
            let relative = relative_uncertainty(values.len() as f64 - 1.0);
            let uncertainty = uncertainty_of_scatter(deviation, relative, limit);
            findings.figures.extend([
                figure("mean", sample.mean()),
                figure("standard deviation", deviation).uncertain(uncertainty).limited(limit),
                figure("standard deviation of the mean", deviation / (values.len() as f64).sqrt()).detail(),
            ]);
        }
        findings.figures.push(Figure::new(&fit.name, "repeats", values.len() as f64, ONE));
        Ok(())
    }
}

/// The labels of the repeats, in the order in which they appear, and the rows of each set that belong to each.
fn repeats(problem: &Problem, by: &str) -> Result<Vec<(String, Vec<Vec<RowIndex>>)>> {
    let mut found: Vec<(String, Vec<Vec<RowIndex>>)> = Vec::new();
    let of_rows: Vec<Option<&[LabelText]>> = problem.sets.iter().map(|set| set.info().layout.data.labels(by)).collect();
    if of_rows.iter().all(Option::is_none) {
        let set = problem.sets.first().ok_or_else(|| Error::data("there are no observations"))?;
        abbe_table::labels(&set.info().layout.data, by).map_err(|error| error.setting("by"))?;
    }
    let empty = || vec![Vec::new(); problem.sets.len()];
    for (index, (set, labels)) in problem.sets.iter().zip(&of_rows).enumerate() {
        for &row in &set.rows {
            let data_row = set.info().layout.rows[row].data_row;
            let Some((labels, data_row)) = labels.zip(data_row) else { continue };
            let label = &labels[data_row];
            match found.iter_mut().find(|(other, _)| other == label) {
                Some((_, rows)) => rows[index].push(row),
                None => {
                    let mut rows = empty();
                    rows[index].push(row);
                    found.push((label.to_string(), rows));
                }
            }
        }
    }
    // Rows that were not repeated belong to every repeat.
    for (index, (set, labels)) in problem.sets.iter().zip(&of_rows).enumerate() {
        let fixed = |row: &&RowIndex| labels.is_none() || set.info().layout.rows[**row].data_row.is_none();
        let always: Vec<RowIndex> = set.rows.iter().filter(fixed).copied().collect();
        for (_, rows) in &mut found {
            rows[index].extend(&always);
            rows[index].sort_unstable();
        }
    }
    if found.len() < 2 {
        let message = format!("the column `{by}` has {} label; two repeats or more were expected", found.len());
        return Err(Error::data(message).setting("by"));
    }
    Ok(found)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{Touch, UPWARDS, check, judge};

    const TOUCHES: [Touch; 6] = [
        ("a", "1", 0.0, 1.0),
        ("b", "1", 0.0, 0.0),
        ("a", "2", 0.0, 2.0),
        ("b", "2", 0.0, 0.0),
        ("a", "3", 0.0, 6.0),
        ("b", "3", 0.0, 0.0),
    ];

    #[test]
    fn every_repeat_is_estimated_by_itself() {
        let (folder, fit) = crate::testing::fit(&UPWARDS, &TOUCHES, false);
        let settings =
            json!({ "by": "group", "parameters": ["table.facet[a].d"], "limits": { "standard_deviation_um": 2 } });
        let found = judge("repeats", folder.path(), &settings, &fit).unwrap();
        // 1, 2, 6 about 3: (4 + 1 + 9) / 2 = 7.
        check(
            &found,
            &[
                ("mean[table.facet[a].d]", 3.0),
                ("standard deviation[table.facet[a].d]", 7.0_f64.sqrt()),
                ("standard deviation of the mean[table.facet[a].d]", (7.0_f64 / 3.0).sqrt()),
                ("repeats", 3.0),
            ],
        );
        assert_eq!(found.figures.iter().filter(|figure| !figure.passes()).count(), 1);
        // Three repeats leave two degrees of freedom.
        let uncertain: Vec<_> = found.figures.iter().filter_map(|figure| figure.standard_uncertainty).collect();
        assert_eq!(uncertain.len(), 1);
        assert!((uncertain[0] - 7.0_f64.sqrt() / 2.0).abs() < 1e-6, "{uncertain:?}");
        // Below a limit it is that of a scatter as large as the limit.
        let settings =
            json!({ "by": "group", "parameters": ["table.facet[a].d"], "limits": { "standard_deviation_um": 4 } });
        let found = judge("repeats", folder.path(), &settings, &fit).unwrap();
        let uncertain: Vec<_> = found.figures.iter().filter_map(|figure| figure.standard_uncertainty).collect();
        assert!((uncertain[0] - 4.0 / 2.0).abs() < 1e-6, "{uncertain:?}");
    }

    #[test]
    fn repeats_that_make_no_sense_are_refused() {
        let (folder, fit) = crate::testing::fit(&UPWARDS, &TOUCHES, false);
        let (lone, single) = crate::testing::fit(&UPWARDS, &TOUCHES[..2], false);
        let of = |settings: &Value| judge("repeats", folder.path(), settings, &fit).unwrap_err();
        assert_eq!(
            judge("repeats", lone.path(), &json!({ "by": "group" }), &single).unwrap_err(),
            "by: the column `group` has 1 label; two repeats or more were expected"
        );
        let column = of(&json!({ "by": "grop" }));
        assert!(column.starts_with("by: touches.csv: there is no column `grop`"), "{column}");
        assert_eq!(
            of(&json!({ "by": "group", "parameters": ["EXX*"] })),
            "parameters[0]: `EXX*` matches nothing that fit estimates"
        );
        assert_eq!(
            of(&json!({ "by": "group", "limits": { "mean_um": 1 } })),
            "limits.mean_um: there is no figure `mean_um` to limit (write `standard_deviation_um`, or another unit of the parameters)"
        );
        let unused = of(&json!({ "by": "group", "limits": { "standard_deviation_urad": 1 } }));
        assert_eq!(
            unused,
            "limits.standard_deviation_urad: `standard_deviation_urad` limits nothing: no parameter is told in that unit"
        );
        // A repeat that does not measure everything is told.
        let (folder, fit) = crate::testing::fit(&UPWARDS, &[TOUCHES[0], TOUCHES[1], TOUCHES[2]], false);
        let lost = judge("repeats", folder.path(), &json!({ "by": "group" }), &fit).unwrap_err();
        assert!(lost.contains("group 2 by itself"), "{lost}");
    }
}

//! Validator `hold-out`: how well a fit predicts rows that were left out of it.

use abbe_core::{Context, Dataset, Figure, Findings, Fit, Parts, Result, SettingsError, Validate};
use schemars::JsonSchema;
use serde::Deserialize;
use serde_json::{Value, json};

use crate::figures::{Limits, ListedOutliers, ONE, check_limits, judged, outliers, residual_limits};
use crate::folds::{Folds, default_column, set_of, trained};
use crate::in_parts::{HeldOut, Predicted};

abbe_core::register!(
    Validate,
    "hold-out",
    "estimates again without some rows and predicts them",
    Settings,
    example,
    build,
    "../reference/validate-hold-out.md",
);

/// Settings of the hold-out.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Settings {
    /// The artefact stage whose rows are held out; the rows of all others always take part in the fit.
    rows: String,
    /// The column whose labels make up the folds.
    #[serde(default = "default_column")]
    column: String,
    /// A number of folds, or for each fold the labels that are held out together.
    folds: Folds,
    /// Largest admissible values: `max_um`, `mean_um`, `rms_um`, `outliers`.
    #[serde(default)]
    limits: Limits,
}

fn example() -> Value {
    json!({ "rows": "table", "column": "group", "folds": [[5, 8, 10], [16, 19]], "limits": { "rms_um": 5 } })
}

fn build(settings: Settings, _: &Context) -> Result<Box<dyn Validate>, SettingsError> {
    settings.folds.check()?;
    check_limits(&settings.limits, &residual_limits(&["outliers"]))?;
    Ok(Box::new(HoldOut { settings }))
}

struct HoldOut {
    settings: Settings,
}

impl Validate for HoldOut {
    fn observations(&self) -> Vec<(&'static str, String)> {
        vec![("rows", self.settings.rows.clone())]
    }

    fn needs_rows(&self) -> bool {
        true
    }

    fn validate(&self, fits: &[&Fit], _: &[&Dataset]) -> Result<Findings> {
        judged(fits, &self.settings.limits, |fit, findings| self.judge(fit, findings))
    }

    fn accepts_rows_in_parts(&self) -> bool {
        true
    }

    fn validate_parts(&self, fits: &[(&Fit, Option<&dyn Parts>)], _: &[&Dataset]) -> Result<Findings> {
        judged(fits, &self.settings.limits, |&(fit, parts), findings| match parts {
            Some(parts) => self.judge_parts(fit, parts, findings),
            None => self.judge(fit, findings),
        })
    }
}

impl HoldOut {
    fn judge(&self, fit: &Fit, findings: &mut Findings) -> Result<()> {
        let (problem, column) = (&fit.problem, &self.settings.column);
        let set = set_of(fit, "rows", &self.settings.rows)?;
        let folds = self.settings.folds.split(problem, set, column)?;
        let left_out = outliers(problem, &fit.calibration);
        let mut all = Predicted::default();
        for (fold, trained) in trained(fit, folds, findings, |fold| fold.train(fit, set))? {
            let found = Predicted::new((problem, set), &fold.rows, column, &trained, &left_out)?;
            findings.remarks.extend(trained.remark);
            self.add(&mut all, found, (fit, &fold.labels), findings);
        }
        self.tell(fit, &all, findings);
        Ok(())
    }

    /// The same of rows that are read again and again.
    fn judge_parts(&self, fit: &Fit, parts: &dyn Parts, findings: &mut Findings) -> Result<()> {
        let Settings { rows, column, folds, .. } = &self.settings;
        set_of(fit, "rows", rows)?;
        let rows = HeldOut { fit, parts, stage: rows, column };
        let folds = folds.labels(&rows.labels()?, rows.stage, column)?;
        let left_out = ListedOutliers::new(&fit.calibration);
        let mut all = Predicted::default();
        for (labels, trained) in trained(fit, folds, findings, |labels| rows.train(labels))? {
            let found = rows.predict(&labels, &trained, &left_out)?;
            findings.remarks.extend(trained.remark);
            self.add(&mut all, found, (fit, &labels), findings);
        }
        self.tell(fit, &all, findings);
        Ok(())
    }

    /// Adds a fold, and says which of its rows were not predicted.
    fn add(&self, all: &mut Predicted, found: Predicted, (fit, labels): (&Fit, &[String]), findings: &mut Findings) {
        if !found.missing.is_empty() {
            findings.remarks.push(format!(
                "{}: {} rows with {} {} were not predicted, because only they tell {}",
                fit.name,
                found.untold,
                self.settings.column,
                labels.join(", "),
                found.missing.join(", ")
            ));
        }
        all.join(found);
    }

    fn tell(&self, fit: &Fit, all: &Predicted, findings: &mut Findings) {
        findings.figures.extend(all.all.figures(&fit.name));
        findings.figures.extend([
            Figure::new(&fit.name, "predicted", all.rows as f64, ONE),
            Figure::new(&fit.name, "outliers", all.outliers as f64, ONE),
        ]);
        for (label, of_label) in all.by_label.iter() {
            findings.figures.extend(of_label.sizes().map(|([_, _, rms], unit)| {
                Figure::new(&fit.name, format!("rms[{}={label}]", self.settings.column), rms, unit).detail()
            }));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{Touch, UPWARDS, check, judge};

    const TOUCHES: [Touch; 7] = [
        ("a", "1", 0.0, 0.0),
        ("a", "2", 0.0, 1.0),
        ("a", "3", 0.0, 5.0),
        ("b", "1", 0.0, 0.0),
        ("b", "2", 0.0, 0.0),
        ("c", "3", 0.0, 0.0),
        ("c", "3", 0.0, 0.0),
    ];

    #[test]
    fn predictions_are_made_without_what_is_predicted() {
        let (folder, fit) = crate::testing::fit(&UPWARDS, &TOUCHES, false);
        let found = judge("hold-out", folder.path(), &json!({ "rows": "table", "folds": 3 }), &fit).unwrap();
        // Each touch on a minus the mean of the other two: -3, -1.5, 4.5. Facet c is touched in group 3 only.
        check(
            &found,
            &[
                ("max", 4.5),
                ("mean", 9.0 / 5.0),
                ("rms", ((9.0 + 2.25 + 20.25) / 5.0_f64).sqrt()),
                ("predicted", 5.0),
                ("outliers", 0.0),
                ("rms[group=1]", 4.5_f64.sqrt()),
                ("rms[group=3]", 4.5),
            ],
        );
        assert_eq!(
            found.remarks,
            ["fit: 2 rows with group 3 were not predicted, because only they tell table.facet[c].d"]
        );
        let together = json!({ "rows": "table", "folds": [[1, 2]] });
        let found = judge("hold-out", folder.path(), &together, &fit).unwrap();
        check(&found, &[("max", 5.0), ("predicted", 2.0), ("rms", 20.5_f64.sqrt())]);
        // Two folds deal out round-robin: 1 and 3, 2.
        let found = judge("hold-out", folder.path(), &json!({ "rows": "table", "folds": 2 }), &fit).unwrap();
        check(&found, &[("rms[group=2]", (1.5_f64 * 1.5 / 2.0).sqrt()), ("rms[group=3]", 4.0)]);
    }

    #[test]
    fn folds_that_make_no_sense_are_refused() {
        let (folder, fit) = crate::testing::fit(&UPWARDS, &TOUCHES, false);
        let cases = [
            (
                json!({ "rows": "table", "folds": 1 }),
                "folds: 1 folds hold out nothing or everything (write 2 or more, or \
                the labels to hold out: `[[5, 8]]`)",
            ),
            (json!({ "rows": "table", "folds": [] }), "folds: at least one fold was expected"),
            (json!({ "rows": "table", "folds": [[1], []] }), "folds[1]: a fold without labels holds out nothing"),
            (json!({ "rows": "table", "folds": [[1], [2, 1]] }), "folds[1]: the label 1 is listed twice"),
            (
                json!({ "rows": "table", "folds": "many" }),
                "folds: a whole number of folds (2 or more) or a list of lists of labels was \
                expected",
            ),
            (json!({ "rows": "table" }), "the setting `folds` is missing"),
            (
                json!({ "rows": "table", "folds": 4 }),
                "folds: 4 folds were asked for, but `group` has 3 different labels in \
                `table`",
            ),
            (json!({ "rows": "table", "folds": [[1], [99]] }), "folds: no row of `table` has the group 99"),
            (
                json!({ "rows": "table", "folds": [[1, 2, 3]] }),
                "folds: the fold with group 1, 2, 3 holds out every row of \
                `table`: nothing is left to estimate from",
            ),
            (json!({ "rows": "tabel", "folds": 2 }), "rows: fit does not observe `tabel` (did you mean `table`?)"),
            (
                json!({ "rows": "table", "folds": 2, "column": "time" }),
                "column: touches.csv: the column `time_s` holds \
                numbers; labels were expected",
            ),
            (
                json!({ "rows": "table", "folds": 2, "column": "grop" }),
                "column: touches.csv: there is no column `grop`; the \
                columns are `feature`, `group`, `time_s`, `X_mm`, `Y_mm`, `Z_mm` (did you mean `group`?)",
            ),
        ];
        for (settings, expected) in cases {
            let told = judge("hold-out", folder.path(), &settings, &fit).unwrap_err();
            assert!(told.starts_with(expected), "{told}");
        }
    }
}

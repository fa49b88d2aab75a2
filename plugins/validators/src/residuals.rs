//! Validator `residuals`: how well a fit explains the rows of its estimate, or `observations` that it did not use, where its
//! residuals are largest, and whether they depend on time.

use std::collections::BTreeSet;
use std::sync::Arc;

use abbe_core::{
    Context, Dataset, Error, Figure, Findings, Fit, Parts, PathItem, Problem, Result, RowIndex, SetIndex,
    SettingsError, Validate, Values,
};
use abbe_estimation::looked_at;
use schemars::JsonSchema;
use serde::Deserialize;
use serde_json::{Value, json};

use crate::drift::{self, DEGREES, Drift};
use crate::figures::{
    Limits, ListedOutliers, ONE, check_limits, judged, judged_side_by_side, outliers, residual_limits,
};
use crate::in_parts::{ResidualSizes, SizesByLabel};
use crate::prediction::predictable;
use crate::rivals::{self, Rival};

abbe_core::register!(
    Validate,
    "residuals",
    "residuals of a fit by indexation and feature, and whether they follow time",
    Settings,
    example,
    build,
    "../reference/validate-residuals.md",
);

/// Settings of the residuals.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Settings {
    /// Label columns for whose labels the residuals are summed up. Default: `group` and `feature`, where the data have
    /// them.
    #[serde(default)]
    by: Option<Vec<String>>,
    /// Largest admissible values: `max_um`, `mean_um`, `rms_um`, of angles `max_urad`, `mean_urad`, `rms_urad`; `outliers`.
    #[serde(default)]
    limits: Limits,
}

fn example() -> Value {
    json!({ "by": ["group", "feature"], "limits": { "max_um": 30, "mean_um": 5 } })
}

fn build(settings: Settings, _: &Context) -> Result<Box<dyn Validate>, SettingsError> {
    check_limits(&settings.limits, &residual_limits(&["outliers"]))?;
    Ok(Box::new(Residuals { settings }))
}

struct Residuals {
    settings: Settings,
}

impl Validate for Residuals {
    fn accepts_other_observations(&self) -> bool {
        true
    }

    fn needs_rows(&self) -> bool {
        true
    }

    fn validate(&self, fits: &[&Fit], _: &[&Dataset]) -> Result<Findings> {
        judged_side_by_side(fits, &self.settings.limits, |fit, findings| {
            follow_time(fit, &self.sum_up(fit, findings)?, findings)
        })
    }

    /// Whether residuals follow time refuses nothing.
    fn rehearse(&self, fits: &[&Fit], _: &[&Dataset]) -> Result<()> {
        judged_side_by_side(fits, &self.settings.limits, |fit, findings| self.sum_up(fit, findings).map(drop)).map(drop)
    }

    fn accepts_rows_in_parts(&self) -> bool {
        true
    }

    fn validate_parts(&self, fits: &[(&Fit, Option<&dyn Parts>)], _: &[&Dataset]) -> Result<Findings> {
        judged(fits, &self.settings.limits, |&(fit, parts), findings| match parts {
            Some(parts) => self.judge_parts(fit, parts, findings),
            None => follow_time(fit, &self.sum_up(fit, findings)?, findings),
        })
    }
}

/// The residuals of rows, but for outliers.
#[derive(Debug, Default)]
struct Seen {
    all: ResidualSizes,
    /// Sum of the squares of residuals over their standard uncertainties, and their number.
    weighted: (f64, usize),
    outliers: usize,
    /// In the order of the columns.
    by_label: Vec<SizesByLabel>,
}

impl Seen {
    /// Adds those of later rows.
    fn join(&mut self, later: Self) {
        self.all.join(&later.all);
        self.weighted = (self.weighted.0 + later.weighted.0, self.weighted.1 + later.weighted.1);
        self.outliers += later.outliers;
        self.by_label.iter_mut().zip(&later.by_label).for_each(|(all, own)| all.join(own));
    }
}

impl Residuals {
    /// Adds the figures of the rows of a fit; returns the outliers, which are left out.
    fn sum_up(&self, fit: &Fit, findings: &mut Findings) -> Result<BTreeSet<(SetIndex, RowIndex)>> {
        let (problem, unpredictable) = predictable(fit)?;
        findings.remarks.extend(unpredictable);
        let left_out = outliers(&problem, &fit.calibration);
        let columns = self.columns(&problem)?;
        tell(fit, &columns, &seen(&problem, fit, &left_out, &columns)?, findings);
        Ok(left_out)
    }

    /// The same of rows that are read again and again. Whether they follow time is asked of rows that are chosen at random.
    fn judge_parts(&self, fit: &Fit, parts: &dyn Parts, findings: &mut Findings) -> Result<()> {
        let sample = parts.sample()?.ok_or_else(|| Error::data("there are no rows"))?;
        let (columns, listed) = (self.columns(&sample)?, ListedOutliers::new(&fit.calibration));
        let look = |part: &Problem| seen(part, fit, &listed.among(part), &columns);
        let found = looked_at(parts, &look, &|all: &mut Seen, later| all.join(later))?;
        tell(fit, &columns, &found.unwrap_or_default(), findings);
        let left_out = listed.among(&sample);
        let Fit { name, estimator, calibration, .. } = fit;
        let of_sample = Fit {
            name: name.clone(),
            problem: Arc::new(sample),
            estimator: estimator.clone(),
            calibration: calibration.clone(),
        };
        follow_time(&of_sample, &left_out, findings)
    }

    /// The columns by which residuals are summed up. A column of the settings has to exist in some data set.
    fn columns(&self, problem: &Problem) -> Result<Vec<String>> {
        let Some(by) = &self.settings.by else { return Ok(vec!["group".to_owned(), "feature".to_owned()]) };
        for (index, name) in by.iter().enumerate() {
            let columns = || problem.sets.iter().flat_map(|set| &set.info().layout.data.columns);
            let of_labels = || columns().filter(|column| matches!(column.values, Values::Labels(_)));
            if !of_labels().any(|column| column.header.name == *name) {
                let mut error = Error::usage(format!("no observed data set has a column of labels `{name}`"))
                    .suggest(name, of_labels().map(|column| column.header.name.as_str()));
                error.setting = vec![PathItem::Key("by".to_owned()), PathItem::Index(index)];
                return Err(error);
            }
        }
        Ok(by.clone())
    }
}

/// The residuals of the rows of a problem, by the labels of some columns; rows without a column are under none of its labels.
fn seen(problem: &Problem, fit: &Fit, left_out: &BTreeSet<(SetIndex, RowIndex)>, columns: &[String]) -> Result<Seen> {
    let residuals = problem.residuals(&problem.values_of(&fit.calibration))?;
    let by_label = vec![SizesByLabel::default(); columns.len()];
    let mut seen = Seen { outliers: left_out.len(), by_label, ..Seen::default() };
    let rows = problem.equation_rows().into_iter().zip(problem.quantities()).zip(problem.standard_uncertainties());
    for (((row, quantity), uncertainty), residual) in rows.zip(residuals) {
        if left_out.contains(&row) {
            continue;
        }
        seen.all.push(quantity, residual);
        seen.weighted = (seen.weighted.0 + (residual / uncertainty).powi(2), seen.weighted.1 + 1);
        let (set, row) = row;
        let layout = &problem.sets[set].info().layout;
        for (column, by_label) in columns.iter().zip(&mut seen.by_label) {
            if let (Some(labels), Some(data_row)) = (layout.data.labels(column), layout.rows[row].data_row) {
                by_label.of(&labels[data_row]).push(quantity, residual);
            }
        }
    }
    Ok(seen)
}

/// The figures of residuals.
fn tell(fit: &Fit, columns: &[String], seen: &Seen, findings: &mut Findings) {
    findings.figures.extend(seen.all.figures(&fit.name));
    findings.figures.push(Figure::new(&fit.name, "outliers", seen.outliers as f64, ONE));
    let mut worst = Vec::new();
    for (column, by_label) in columns.iter().zip(&seen.by_label) {
        for (label, of_label) in by_label.iter() {
            for ([max, _, rms], unit) in of_label.sizes() {
                let figure = |name: &str, value| {
                    Figure::new(&fit.name, format!("{name}[{column}={label}]"), value, unit).detail()
                };
                findings.figures.extend([figure("rms", rms), figure("max", max)]);
            }
        }
        let lengths = by_label.iter().filter_map(|(label, of_label)| Some((label, of_label.rms_of_lengths()?)));
        if let Some((label, rms)) = lengths.max_by(|(_, a), (_, b)| a.total_cmp(b)) {
            worst.push(format!("{column} {label} ({rms:.1} µm)"));
        }
    }
    if !worst.is_empty() {
        findings.remarks.push(format!("{}: largest rms: {}", fit.name, worst.join(", ")));
    }
    findings.remarks.extend(too_good(fit, seen));
}

/// Part of what was stated below which residuals of so many rows that an estimate has not seen are not believed, and that of the estimate
/// above which its own are about as stated. Below the third residuals are those of exact data.
const TOO_GOOD: f64 = 0.25;
const MANY: usize = 100;
const AS_STATED: f64 = 0.5;
const EXACT: f64 = 1e-6;

/// Rows that an estimate predicts far better than what is stated of a reading, and far better than its own: they are in another unit.
fn too_good(fit: &Fit, seen: &Seen) -> Option<String> {
    let report = &fit.calibration.fit;
    // An estimate of nothing has its own rows, and factors that were found are in the scatter of the estimate.
    let is_prediction = fit.problem.unknowns.is_empty() && report.unknowns > 0 && report.variance.is_empty();
    let (squares, count) = seen.weighted;
    let size = (squares / count.max(1) as f64).sqrt();
    let is_told = is_prediction && count >= MANY && report.sigma > AS_STATED && (EXACT..TOO_GOOD).contains(&size);
    is_told.then(|| {
        format!(
            "{}: residuals of these rows are {size:.2e} of what is stated, and those of the estimate {:.2} times: is the unit of these \
             readings right?",
            fit.name, report.sigma
        )
    })
}

/// Probability below which something is not chance.
const SIGNIFICANT: f64 = 1e-3;

/// Hints that are given.
const HINTS: usize = 3;

/// Reports the test for drift, with advice if there is one.
fn follow_time(fit: &Fit, left_out: &BTreeSet<(SetIndex, RowIndex)>, findings: &mut Findings) -> Result<()> {
    let drifts = drift::test(fit, left_out)?;
    for drift in &drifts {
        let name = format!("drift_p[{}]", drift.parameter);
        findings.figures.push(Figure::new(&fit.name, name, drift.p, ONE).detail());
    }
    let Some(first) = drifts.iter().min_by(|a, b| a.p.total_cmp(&b.p)) else { return Ok(()) };
    // Each parameter is another chance of a small p (Bonferroni).
    if first.p * drifts.len() as f64 >= SIGNIFICANT {
        return Ok(());
    }
    let rivals = rivals::rivals(fit, left_out)?;
    let better = |rival: &&Rival| rival.p < SIGNIFICANT && rival.share > first.share;
    let better: Vec<&Rival> = rivals.iter().filter(better).take(HINTS).collect();
    if !better.is_empty() {
        let hint = |rival: &&Rival| format!("{} {:.0} %", rival.name, 100.0 * rival.share);
        findings.remarks.push(format!(
            "the residuals of {} look like errors that the model has and the fit does not estimate: of their sum of squares each of these \
             would explain {}; a drift of {} would explain {:.0} %",
            fit.name,
            better.iter().map(hint).collect::<Vec<_>>().join(", "),
            first.parameter,
            100.0 * first.share
        ));
        return Ok(());
    }
    // Errors that the model lacks change with the indexations, and these with time: sure is what blocks of time agree on.
    if rivals::by_blocks(fit, left_out, first.parameter)?.is_none_or(|p| p >= SIGNIFICANT) {
        return Ok(());
    }
    findings.remarks.push(advice(fit, first));
    Ok(())
}

/// What to do about a drift.
fn advice(fit: &Fit, drift: &Drift) -> String {
    let (name, parameter) = (&fit.name, drift.parameter);
    let p = if drift.p > 0.0 { format!("p = {:.0e}", drift.p) } else { "p < 1e-300".to_owned() };
    let terms = if drift.terms == 1 { "1 term".to_owned() } else { format!("{} terms", drift.terms) };
    let prefix = format!("{parameter}[");
    let modelled = fit.problem.model.info().parameters.iter().filter(|other| other.name.starts_with(&prefix)).count();
    let estimated = fit.problem.unknowns.iter().filter(|other| other.name.starts_with(&prefix)).count();
    let mut advice = if modelled == 0 {
        let degrees: Vec<String> = (1..=DEGREES).map(|degree| degree.to_string()).collect();
        format!(
            "add `{{ drift: [{parameter}], degrees: [{}] }}` to the errors of the model and `{parameter}[t?]` to the \
             parameters",
            degrees.join(", ")
        )
    } else if estimated < modelled {
        format!("add all terms of the drift of {parameter} to the parameters")
    } else {
        format!("let the drift of {parameter} in the model have more `degrees`")
    };
    if drift.sigma > 3.0 {
        advice = format!(
            "but {:.0} times the stated uncertainty would remain, so look first for other errors that the model lacks",
            drift.sigma
        );
    }
    format!(
        "the residuals of {name} follow time: a drift of {parameter} ({terms}) would explain {:.0} % of their sum of \
         squares ({p}); {advice}",
        100.0 * drift.share
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{Touch, UPWARDS, check, judge};

    #[test]
    fn figures_of_a_mean() {
        // The offset of a is 1 µm, that of b 0: residuals -1, 0, 1 and -2, 2.
        let touches: [Touch; 5] = [
            ("a", "1", 0.0, 0.0),
            ("a", "1", 0.0, 1.0),
            ("a", "2", 0.0, 2.0),
            ("b", "2", 0.0, -2.0),
            ("b", "3", 0.0, 2.0),
        ];
        let (folder, fit) = crate::testing::fit(&UPWARDS, &touches, false);
        let found = judge("residuals", folder.path(), &json!({ "limits": { "max_um": 1.5, "mean_um": 1.5 } }), &fit);
        let found = found.unwrap();
        check(
            &found,
            &[
                ("max", 2.0),
                ("mean", 1.2),
                ("rms", 2.0_f64.sqrt()),
                ("outliers", 0.0),
                ("rms[group=1]", 0.5_f64.sqrt()),
                ("max[group=2]", 2.0),
                ("rms[feature=b]", 2.0),
            ],
        );
        assert_eq!(found.remarks, ["fit: largest rms: group 3 (2.0 µm), feature b (2.0 µm)"]);
        let failed: Vec<&str> =
            found.figures.iter().filter(|figure| !figure.passes()).map(|figure| figure.name.as_str()).collect();
        assert_eq!(failed, ["max"]);
        assert_eq!(
            judge("residuals", folder.path(), &json!({ "by": ["group", "featur"] }), &fit).unwrap_err(),
            "by[1]: no observed data set has a column of labels `featur` (did you mean `feature`?)"
        );
        assert_eq!(
            judge("residuals", folder.path(), &json!({ "limits": { "rms_mm": 1 } }), &fit).unwrap_err(),
            "limits.rms_mm: there is no figure `rms_mm` to limit (did you mean `rms_um`?)"
        );
    }

    /// Touches in turn on all facets for an hour, with noise and whatever `beside` it adds.
    fn series(beside: impl Fn(f64) -> f64) -> Vec<Touch> {
        (0..120)
            .map(|i| {
                let t = f64::from(i) / 119.0;
                let noise = (f64::from(i * i) * 1.7).sin() * 1.5;
                (UPWARDS[i as usize % 4].0, "1", 3600.0 * t, noise + beside(t))
            })
            .collect()
    }

    #[test]
    fn a_drift_is_found_and_noise_is_none() {
        let (folder, fit) = crate::testing::fit(&UPWARDS, &series(|t| 4.0 * t * t), false);
        let found = judge("residuals", folder.path(), &json!({}), &fit).unwrap();
        let remark = found.remarks.last().unwrap();
        assert!(
            remark.starts_with("the residuals of fit follow time: a drift of dzt (4 terms) would explain"),
            "{remark}"
        );
        assert!(remark.ends_with(
            "; add `{ drift: [dzt], degrees: [1, 2, 3, 4] }` to the errors of the model and `dzt[t?]` to the parameters"
        ));
        let drifts: Vec<&Figure> = found.figures.iter().filter(|figure| figure.name.starts_with("drift")).collect();
        // Facets that look upwards see nothing of dxt and dyt.
        assert_eq!(drifts.iter().map(|figure| figure.name.as_str()).collect::<Vec<_>>(), ["drift_p[dzt]"]);
        assert!(drifts[0].value.unwrap() < 1e-6);

        let (folder, fit) = crate::testing::fit(&UPWARDS, &series(|_| 0.0), false);
        let found = judge("residuals", folder.path(), &json!({}), &fit).unwrap();
        assert_eq!(found.remarks.len(), 1, "{:?}", found.remarks);
        assert!(crate::testing::figure(&found, "drift_p[dzt]") > 1e-2);
    }

    #[test]
    fn outliers_are_counted_and_left_out() {
        let mut touches = series(|_| 0.0);
        touches[7].3 += 50.0;
        let (folder, fit) = crate::testing::fit(&UPWARDS, &touches, true);
        let found = judge("residuals", folder.path(), &json!({ "limits": { "max_um": 5 } }), &fit).unwrap();
        check(&found, &[("outliers", 1.0)]);
        assert!(found.figures.iter().all(Figure::passes), "{found:?}");
    }
}

//! Validator `tip-cmm`: tip positions that the calibrated model predicts against the artefact measured on a CMM (Rahman &
//! Mayer 2015; Tables 4-8 and, with folds, 4-9 of Rahman 2016).

use std::path::PathBuf;

use abbe_core::{
    Calibration, Context, Dataset, Error, Figure, Findings, Fit, InputFile, Problem, Result, RowIndex, SetIndex,
    SettingsError, Unknown, Validate,
};
use nalgebra::Vector6;
use schemars::JsonSchema;
use serde::Deserialize;
use serde_json::{Value, json};

use crate::cmm::{
    Cmm, Placement, Shift, against_cmm, best_placement, differences, distance_remark, misread_remark, rank_remark,
};
use crate::figures::{Limits, ONE, Sample, UM, check_limits, outliers};
use crate::folds::{Fold, Folds, TrainedFit, contained, default_column, own_unknown, reduced, set_of, trained};

abbe_core::register!(
    Validate,
    "tip-cmm",
    "tip positions predicted by the model against the artefact measured on a CMM",
    Settings,
    example,
    build,
    "../reference/validate-tip-cmm.md",
);

/// Settings of the comparison.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Settings {
    /// The artefact stage whose features the CMM measured.
    features: String,
    /// CSV file of the CMM: feature, x_mm, y_mm, z_mm and for facets nx, ny, nz and the measured offset d_um along it;
    /// for balls the point is the measured centre.
    cmm: String,
    /// The column whose labels make up the folds.
    #[serde(default = "default_column")]
    column: String,
    /// A number of folds, or for each fold the labels that are held out together; without folds the model of the full
    /// fit predicts all rows.
    #[serde(default)]
    folds: Option<Folds>,
    /// Largest admissible values: `max_absolute_um`, `standard_deviation_um`, `rms_um`, `outliers`.
    #[serde(default)]
    limits: Limits,
}

fn example() -> Value {
    json!({ "features": "table", "cmm": "facets-cmm.csv", "folds": 4, "limits": { "rms_um": 10 } })
}

fn build(settings: Settings, context: &Context) -> Result<Box<dyn Validate>, SettingsError> {
    settings.folds.as_ref().map_or(Ok(()), Folds::check)?;
    // Figures with a sign have no limit: a large negative value would be within it.
    check_limits(&settings.limits, &["max_absolute_um", "standard_deviation_um", "rms_um", "outliers"])?;
    Ok(Box::new(TipCmm { cmm: context.path(&settings.cmm), settings }))
}

struct TipCmm {
    cmm: PathBuf,
    settings: Settings,
}

impl Validate for TipCmm {
    fn inputs(&self) -> Vec<InputFile> {
        vec![InputFile { setting: "cmm", path: self.cmm.clone() }]
    }

    fn observations(&self) -> Vec<(&'static str, String)> {
        vec![("features", self.settings.features.clone())]
    }

    fn validate(&self, fits: &[&Fit], _: &[&Dataset]) -> Result<Findings> {
        let judge = |fit: &Fit, cmm: &Cmm, findings: &mut Findings| self.judge(fit, cmm, findings);
        against_cmm(&self.cmm, fits, &self.settings.limits, judge)
    }
}

/// A calibration, and the rows that it predicts.
struct Part {
    calibration: Calibration,
    undetermined: Vec<Unknown>,
    rows: Vec<RowIndex>,
    remark: Option<String>,
}

impl TipCmm {
    fn judge(&self, fit: &Fit, cmm: &Cmm, findings: &mut Findings) -> Result<()> {
        let problem = &fit.problem;
        let set = set_of(fit, "features", &self.settings.features)?;
        let features = &problem.sets[set].info().features;
        let matched = cmm.matched(features)?;
        let measured: Vec<Unknown> = matched.shifts.iter().map(|shift| own_unknown(problem, set, shift.own)).collect();
        let all_shifts = features.iter().flat_map(|feature| &feature.shifts);
        let unmeasured: Vec<Unknown> =
            all_shifts.map(|(own, _)| own_unknown(problem, set, *own)).filter(|own| !measured.contains(own)).collect();
        findings.remarks.extend(matched.left_out.iter().map(|text| format!("{}: {text}", fit.name)));

        let left_out = outliers(problem, &fit.calibration);
        let layout = &problem.sets[set].info().layout;
        let (mut skipped, mut unpredicted) = (0_usize, 0_usize);
        let mut cases = Vec::new();
        for part in self.parts(fit, set, findings)? {
            findings.remarks.extend(part.remark);
            let mut rows = part.rows;
            rows.retain(|&row| layout.rows[row].poses > 0);
            let before = rows.len();
            rows.retain(|&row| !left_out.contains(&(set, row)));
            skipped += before - rows.len();
            // The CMM replaces the unknowns of features that only held-out rows touch. It does not replace other
            // undetermined unknowns.
            let mut unknown = part.undetermined;
            unknown.retain(|own| !measured.contains(own));
            unknown.extend(unmeasured.iter().cloned());
            let probe = reduced(problem, &part.calibration, set, rows, unknown);
            let usable = contained(&probe)?.into_iter().zip(&probe.sets[set].rows);
            let usable: Vec<RowIndex> = usable.filter(|(lost, _)| lost.is_empty()).map(|(_, row)| *row).collect();
            unpredicted += probe.sets[set].rows.len() - usable.len();
            cases.push(reduced(problem, &part.calibration, set, usable, measured.clone()));
        }
        if unpredicted > 0 {
            findings.remarks.push(format!(
                "{}: {unpredicted} rows were not predicted, because neither the CMM nor the other rows tell what they need",
                fit.name
            ));
        }
        let touches: usize = cases.iter().map(|case| case.sets[set].rows.len()).sum();
        if touches == 0 {
            return Err(Error::data(format!("no row of `{}` can be compared with the CMM", self.settings.features)));
        }
        let (residuals, rank) = place(&cases, &matched.shifts)?;
        findings.remarks.extend(rank_remark(&fit.name, rank));
        let misread = misread_remark(&fit.name, &residuals, &matched.shifts, |shifts| Ok(place(&cases, shifts)?.0))?;
        findings.remarks.extend(misread.or_else(|| distance_remark(&fit.name, &residuals)));
        findings.figures.extend(differences(&fit.name, &residuals));
        findings.figures.extend([
            Figure::new(&fit.name, "rms", residuals.rms(), UM),
            Figure::new(&fit.name, "touches", touches as f64, ONE),
            Figure::new(&fit.name, "outliers", skipped as f64, ONE),
        ]);
        Ok(())
    }

    fn parts(&self, fit: &Fit, set: SetIndex, findings: &mut Findings) -> Result<Vec<Part>> {
        let Some(folds) = &self.settings.folds else {
            let rows = fit.problem.sets[set].rows.clone();
            return Ok(vec![Part {
                calibration: fit.calibration.clone(),
                undetermined: Vec::new(),
                rows,
                remark: None,
            }]);
        };
        let folds = folds.split(&fit.problem, set, &self.settings.column)?;
        let trained = trained(fit, folds, findings, |fold| fold.train(fit, set))?;
        let part = |(fold, trained): (Fold, TrainedFit)| {
            let TrainedFit { calibration, undetermined, remark } = trained;
            Part { calibration, undetermined, rows: fold.rows, remark }
        };
        Ok(trained.into_iter().map(part).collect())
    }
}

/// Residuals in µm after the rigid motion of the artefact, common to all cases, that makes them smallest.
fn place(cases: &[Problem], shifts: &[Shift]) -> Result<(Sample, usize)> {
    let (residuals, rank) = best_placement(Placement::of(shifts), |placement| {
        let own: Vec<f64> = shifts.iter().map(|shift| placement.shift(shift)).collect();
        let by_shift: Vec<Vector6<f64>> = shifts.iter().map(|shift| placement.effect(shift)).collect();
        let (mut residuals, mut effects) = (Vec::new(), Vec::new());
        for case in cases {
            case.linearise(&own, |block| {
                for (line, residual) in block.jacobian.chunks_exact(shifts.len().max(1)).zip(block.residuals) {
                    effects.push(line.iter().zip(&by_shift).map(|(derivative, effect)| effect * *derivative).sum());
                    residuals.push(*residual);
                }
            })?;
        }
        Ok((residuals, effects))
    })?;
    Ok((Sample(residuals.iter().map(|residual| residual * 1e3).collect()), rank))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{UPWARDS, check, judge};

    #[test]
    fn touches_against_the_cmm() {
        let touches = [
            ("a", "1", 0.0, 1.0),
            ("a", "1", 0.0, -1.0),
            ("b", "1", 0.0, 0.0),
            ("c", "2", 0.0, 0.0),
            ("d", "2", 0.0, 0.0),
        ];
        let (folder, fit) = crate::testing::fit(&UPWARDS, &touches, false);
        // Without facet d three heights are told by a rigid motion: the scatter of the touches on a is all that is left.
        let cmm = "feature,x_mm,y_mm,z_mm,nx,ny,nz,d_um\na,100,100,50,0,0,1,10\nb,-100,100,50,0,0,1,0\n\
                   c,-100,-100,50,0,0,1,4\n";
        std::fs::write(folder.path().join("cmm.csv"), cmm).unwrap();
        let settings = json!({ "features": "table", "cmm": "cmm.csv" });
        let found = judge("tip-cmm", folder.path(), &settings, &fit).unwrap();
        check(
            &found,
            &[
                ("max", 1.0),
                ("min", -1.0),
                ("max absolute", 1.0),
                ("mean", 0.0),
                ("standard deviation", (2.0_f64 / 3.0).sqrt()),
                ("rms", 0.5_f64.sqrt()),
                ("touches", 4.0),
                ("outliers", 0.0),
            ],
        );
        assert_eq!(
            found.remarks[..2],
            [
                "fit: not in the CMM file and left out: d",
                "fit: 1 rows were not predicted, because neither the CMM nor the other rows tell what they need"
            ]
        );
        // Group 2 alone touches c and d; the model does not need it, and the CMM has c.
        let settings = json!({ "features": "table", "cmm": "cmm.csv", "folds": [[1]] });
        check(&judge("tip-cmm", folder.path(), &settings, &fit).unwrap(), &[("touches", 3.0), ("max", 1.0)]);
        let settings = json!({ "features": "table", "cmm": "cmm.csv", "folds": [[2]] });
        check(&judge("tip-cmm", folder.path(), &settings, &fit).unwrap(), &[("touches", 1.0), ("max", 0.0)]);
    }
}

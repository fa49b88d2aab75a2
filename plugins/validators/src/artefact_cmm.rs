//! Validator `artefact-cmm`: the estimated artefact against the same artefact measured on a CMM (Rahman & Mayer 2015,
//! Table 4-7 of Rahman 2016).

use std::path::PathBuf;

use abbe_core::{
    Context, Dataset, Error, Feature, Figure, Findings, Fit, InputFile, Owner, Result, SetIndex, SettingsError,
    Unknown, Validate,
};
use nalgebra::Vector3;
use schemars::JsonSchema;
use serde::Deserialize;
use serde_json::{Value, json};

use crate::cmm::{Cmm, Placement, Shift, against_cmm, best_placement, differences, misread_remark, rank_remark};
use crate::figures::{Limits, ONE, Sample, UM, check_limits};
use crate::folds::set_of;

abbe_core::register!(
    Validate,
    "artefact-cmm",
    "the estimated artefact against the same artefact measured on a CMM",
    Settings,
    example,
    build,
    "../reference/validate-artefact-cmm.md",
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
    /// Largest admissible values: `max_absolute_um`, `standard_deviation_um`, `range_um`.
    #[serde(default)]
    limits: Limits,
}

fn example() -> Value {
    json!({ "features": "table", "cmm": "facets-cmm.csv", "limits": { "standard_deviation_um": 5 } })
}

fn build(settings: Settings, context: &Context) -> Result<Box<dyn Validate>, SettingsError> {
    // Figures with a sign have no limit: a large negative value would be within it.
    check_limits(&settings.limits, &["max_absolute_um", "standard_deviation_um", "range_um"])?;
    Ok(Box::new(ArtefactCmm { cmm: context.path(&settings.cmm), settings }))
}

struct ArtefactCmm {
    cmm: PathBuf,
    settings: Settings,
}

impl Validate for ArtefactCmm {
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

impl ArtefactCmm {
    fn judge(&self, fit: &Fit, cmm: &Cmm, findings: &mut Findings) -> Result<()> {
        let set = set_of(fit, "features", &self.settings.features)?;
        let values = fit.problem.starting_from(&fit.calibration).sets.swap_remove(set.0).own;
        let estimated = |own: usize| {
            fit.problem.unknowns.iter().any(|unknown| unknown.owner == Owner::Set(set) && unknown.index == own)
        };
        let mut features = fit.problem.sets[set].info().features.clone();
        features.retain(|feature: &Feature| feature.shifts.iter().all(|(own, _)| estimated(*own)));
        if features.is_empty() {
            return Err(Error::usage(format!("{} estimates no feature of `{}`", fit.name, self.settings.features))
                .setting("features"));
        }
        let matched = cmm.matched(&features)?;
        findings.remarks.extend(matched.left_out.iter().map(|text| format!("{}: {text}", fit.name)));

        let (left, rank) = placed(&matched.shifts, &values)?;
        findings.remarks.extend(rank_remark(&fit.name, rank));
        let (nominal, _) = placed(&nominal(&matched.shifts), &values)?;
        let uncertainties = matched.shifts.iter().filter_map(|shift| own_uncertainty(fit, set, shift.own));
        let stated = Sample(uncertainties.map(|u| u * 1e3).collect());
        let misread = misread_remark(&fit.name, &left, &matched.shifts, |shifts| Ok(placed(shifts, &values)?.0))?;
        let doubt = misread.or_else(|| contradiction(&fit.name, &left, &nominal));
        findings.remarks.extend(doubt.or_else(|| disagreement(&fit.name, &left, &stated)));
        let mut figures = differences(&fit.name, &left).to_vec();
        figures.push(Figure::new(&fit.name, "range", left.max() - left.min(), UM));
        if matched.shifts.len() <= rank {
            let why = format!(
                "{} places that {rank} motions between the frames of machine and CMM bring together agree whatever was measured",
                matched.shifts.len()
            );
            figures.iter_mut().for_each(|figure| figure.inconclusive = Some(why.clone()));
        }
        findings.figures.extend(figures);
        findings.figures.push(Figure::new(&fit.name, "features", matched.features as f64, ONE));
        Ok(())
    }
}

/// What is left of the estimated values of features, µm, after the motion that brings them closest to what was measured; and how many
/// of the six motions the features tell.
fn placed(shifts: &[Shift], values: &[f64]) -> Result<(Sample, usize)> {
    let (left, rank) = best_placement(Placement::of(shifts), |placement| {
        let left = shifts.iter().map(|shift| values[shift.own] - placement.shift(shift));
        Ok((left.collect(), shifts.iter().map(|shift| -placement.effect(shift)).collect()))
    })?;
    Ok((Sample(left.into_iter().map(|left| left * 1e3).collect()), rank))
}

/// The same features where their nominal points are.
fn nominal(shifts: &[Shift]) -> Vec<Shift> {
    shifts.iter().map(|shift| Shift { measured: 0.0, found: Vector3::from(shift.point), ..shift.clone() }).collect()
}

/// What the CMM says is not believed from here on: times what nominal places leave, and µm.
const WORSE: f64 = 1.5;
const FAR: f64 = 10.0;

/// A CMM whose file explains the estimated features worse than nominal places do.
fn contradiction(fit: &str, left: &Sample, nominal: &Sample) -> Option<String> {
    let [of_cmm, of_nominal] = [left, nominal].map(Sample::standard_deviation);
    (of_cmm > FAR && of_cmm > WORSE * of_nominal).then(|| {
        format!(
            "{fit}: the features differ more from what the CMM measured ({of_cmm:.1} µm) than from their nominal places \
             ({of_nominal:.1} µm): are unit, sign and labels of the CMM file right?"
        )
    })
}

/// Standard uncertainty of an own unknown of a set, mm; none if it was not estimated.
fn own_uncertainty(fit: &Fit, set: SetIndex, own: usize) -> Option<f64> {
    let is_it = |unknown: &&Unknown| unknown.owner == Owner::Set(set) && unknown.index == own;
    let unknown = fit.problem.unknowns.iter().find(is_it)?;
    fit.calibration.get(&unknown.name).map(|found| found.standard_uncertainty)
}

/// Times the standard uncertainty of the estimated features from which what the CMM measured contradicts them.
const DISAGREES: f64 = 10.0;

/// A CMM and an estimate that contradict each other: one of the certificates or files behind them belongs to something else.
fn disagreement(fit: &str, left: &Sample, stated: &Sample) -> Option<String> {
    let root =
        |sample: &Sample| (sample.0.iter().map(|value| value * value).sum::<f64>() / sample.0.len() as f64).sqrt();
    let (off, u) = (root(left), root(stated));
    (off > FAR && off > DISAGREES * u).then(|| {
        format!(
            "{fit}: the features differ by {off:.1} µm (RMS) from what the CMM measured, and their standard uncertainty is {u:.1} µm: does \
             the CMM file, or a certificate of the recipe, belong to another artefact?"
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{UPWARDS, check, judge};

    #[test]
    fn what_a_rigid_motion_cannot_explain_remains() {
        let touches = [("a", "1", 0.0, 0.0), ("b", "1", 0.0, 0.0), ("c", "1", 0.0, 0.0), ("d", "1", 0.0, 0.0)];
        let (folder, fit) = crate::testing::fit(&UPWARDS, &touches, false);
        // A height of 5, a slope of 3 along x, and a twist of 2 that no rigid motion makes.
        let cmm = "feature,x_mm,y_mm,z_mm,nx,ny,nz,d_um\na,100,100,50,0,0,1,10\nb,-100,100,50,0,0,1,0\n\
                   c,-100,-100,50,0,0,1,4\nd,100,-100,50,0,0,1,6\ne,0,0,0,0,0,1,6\n";
        std::fs::write(folder.path().join("cmm.csv"), cmm).unwrap();
        let settings = json!({ "features": "table", "cmm": "cmm.csv", "limits": { "range_um": 3 } });
        let found = judge("artefact-cmm", folder.path(), &settings, &fit).unwrap();
        check(
            &found,
            &[
                ("max", 2.0),
                ("min", -2.0),
                ("max absolute", 2.0),
                ("mean", 0.0),
                ("standard deviation", (16.0_f64 / 3.0).sqrt()),
                ("range", 4.0),
                ("features", 4.0),
            ],
        );
        assert_eq!(
            found.remarks,
            [
                "fit: not estimated and left out: e",
                "fit: the features tell only 3 of the 6 motions between the frames of machine and CMM; of those that fit \
                 equally well the smallest was taken"
            ]
        );
        assert_eq!(found.figures.iter().filter(|figure| !figure.passes()).count(), 1);
        // Three features that three motions bring together agree whatever was measured.
        let few: Vec<&str> = cmm.lines().take(4).collect();
        std::fs::write(folder.path().join("few.csv"), few.join("\n")).unwrap();
        let few = json!({ "features": "table", "cmm": "few.csv", "limits": { "range_um": 3 } });
        let found = judge("artefact-cmm", folder.path(), &few, &fit).unwrap();
        let range = found.figures.iter().find(|figure| figure.name == "range").unwrap();
        assert!(range.value.unwrap() < 1e-6 && range.inconclusive.is_some(), "{range:?}");
        let signed = json!({ "features": "table", "cmm": "cmm.csv", "limits": { "max_um": 3 } });
        assert_eq!(
            judge("artefact-cmm", folder.path(), &signed, &fit).unwrap_err(),
            "limits.max_um: there is no figure `max_um` to limit (possible are: max_absolute_um, standard_deviation_um, \
             range_um)"
        );
    }
}

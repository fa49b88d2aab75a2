//! Validator `compare`: the figures of several fits side by side.

use abbe_core::{Context, Dataset, Figure, Findings, Fit, Result, SettingsError, Validate};
use schemars::JsonSchema;
use serde::Deserialize;
use serde_json::{Value, json};

use crate::figures::{Limits, ONE, UM, URAD, check_limits, set_limits};
use crate::folds::not_converged;

abbe_core::register!(
    Validate,
    "compare",
    "unknowns, rank, condition number and residuals of several fits side by side",
    Settings,
    example,
    build,
    "../reference/validate-compare.md",
);

/// Settings of the comparison.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Settings {
    /// Largest admissible values: `condition`, `sigma`, `residual_max_um`, `residual_mean_um`, `residual_rms_um`; the residuals
    /// of angles in `_urad`.
    #[serde(default)]
    limits: Limits,
}

fn example() -> Value {
    json!({ "limits": { "condition": 1000, "residual_rms_um": 3 } })
}

fn build(settings: Settings, _: &Context) -> Result<Box<dyn Validate>, SettingsError> {
    let mut keys = vec!["condition", "sigma", "unknowns", "rank"];
    keys.extend(["residual_max_um", "residual_mean_um", "residual_rms_um"]);
    keys.extend(["residual_max_urad", "residual_mean_urad", "residual_rms_urad"]);
    check_limits(&settings.limits, &keys)?;
    Ok(Box::new(Compare { settings }))
}

struct Compare {
    settings: Settings,
}

impl Validate for Compare {
    fn validate(&self, fits: &[&Fit], _: &[&Dataset]) -> Result<Findings> {
        let mut figures = Vec::new();
        for fit in fits {
            let report = &fit.calibration.fit;
            let cells = [
                ("unknowns", report.unknowns as f64, ONE),
                ("rank", report.rank as f64, ONE),
                ("condition", report.condition, ONE),
                ("sigma", report.sigma, ONE),
                ("degrees of freedom", report.degrees_of_freedom as f64, ONE),
                ("residual max", report.residual_max_um, UM),
                ("residual mean", report.residual_mean_abs_um, UM),
                ("residual rms", report.residual_rms_um, UM),
            ];
            figures.extend(cells.map(|(name, value, unit)| Figure::new(&fit.name, name, value, unit)));
            let angles = [
                ("residual max", report.residual_max_urad),
                ("residual mean", report.residual_mean_abs_urad),
                ("residual rms", report.residual_rms_urad),
            ];
            let angles =
                angles.into_iter().filter_map(|(name, value)| Some(Figure::new(&fit.name, name, value?, URAD)));
            figures.extend(angles);
        }
        set_limits(&self.settings.limits, &mut figures);
        let remarks = fits.iter().filter_map(|fit| not_converged(&fit.name, &fit.calibration)).collect();
        Ok(Findings { figures, remarks, ..Findings::default() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{UPWARDS, check, judge};

    #[test]
    fn figures_are_those_of_the_fit() {
        let touches = [("a", "1", 0.0, 0.0), ("a", "1", 0.0, 2.0), ("b", "1", 0.0, 0.0), ("b", "1", 0.0, 0.0)];
        let (folder, fit) = crate::testing::fit(&UPWARDS, &touches, false);
        let found = judge("compare", folder.path(), &json!({ "limits": { "residual_max_um": 0.5 } }), &fit).unwrap();
        check(
            &found,
            &[
                ("unknowns", 2.0),
                ("rank", 2.0),
                ("condition", 1.0),
                ("sigma", 1.0),
                ("degrees of freedom", 2.0),
                ("residual max", 1.0),
                ("residual mean", 0.5),
                ("residual rms", 0.5_f64.sqrt()),
            ],
        );
        assert_eq!(found.figures.iter().filter(|figure| !figure.passes()).count(), 1);
    }
}

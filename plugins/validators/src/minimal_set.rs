//! Validator `minimal-set`: which of many candidate parameters the measurements can tell apart, and for each of the others why
//! it is left out: it has no effect, or others that are kept do the same.
//!
//! Of parameters that do the same, the one that people prefer is kept ([`in_order_of_preference`]).

use abbe_core::{Context, Dataset, Figure, Findings, Fit, Problem, Result, SettingsError, Validate};
use abbe_estimation::{Judgement, check_preferences, in_order_of_preference};
use abbe_numerics::UnestimableUnknown;
use schemars::JsonSchema;
use serde::Deserialize;
use serde_json::{Value, json};

use crate::figures::{Limits, ONE, check_limits, judged};

abbe_core::register!(
    Validate,
    "minimal-set",
    "which parameters the measurements can tell apart, and why each of the others is left out",
    Settings,
    example,
    build,
    "../reference/validate-minimal-set.md",
);

/// Settings of the selection.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Settings {
    /// The candidates: names and patterns of parameters and unknowns of the observations of the fit. Default: the
    /// unknowns of the fit.
    #[serde(default)]
    candidates: Vec<String>,
    /// Candidates that are kept rather than others, the most preferred first: names and patterns.
    #[serde(default)]
    prefer: Vec<String>,
    /// A candidate is left out if the others can produce all of its effect but a part smaller than this. Default: the
    /// `rank_tolerance` of the fit.
    #[serde(default)]
    tolerance: Option<f64>,
    /// Largest admissible values: `condition`, `left_out`.
    #[serde(default)]
    limits: Limits,
}

fn example() -> Value {
    json!({ "candidates": ["E?0?", "d??"], "prefer": ["d??"], "limits": { "condition": 100 } })
}

fn build(settings: Settings, _: &Context) -> Result<Box<dyn Validate>, SettingsError> {
    check_limits(&settings.limits, &["condition", "left_out"])?;
    if settings.tolerance.is_some_and(|tolerance| !(tolerance > 0.0 && tolerance < 1.0)) {
        return Err(SettingsError::new("tolerance", "a number between 0 and 1 was expected"));
    }
    Ok(Box::new(MinimalSet { settings }))
}

struct MinimalSet {
    settings: Settings,
}

/// The tolerance for fits that say none.
const DEFAULT_TOLERANCE: f64 = 1e-8;

impl Validate for MinimalSet {
    fn needs_rows(&self) -> bool {
        true
    }

    fn validate(&self, fits: &[&Fit], _: &[&Dataset]) -> Result<Findings> {
        judged(fits, &self.settings.limits, |fit, found| self.select(fit, found))
    }
}

impl MinimalSet {
    fn select(&self, fit: &Fit, found: &mut Findings) -> Result<()> {
        let problem = self.candidates(&fit.problem)?;
        let judged = Judgement::new(&problem, None)?;
        check_preferences(&problem, &self.settings.prefer)?;
        let order = in_order_of_preference(&problem, &self.settings.prefer);
        let tolerance = self.settings.tolerance.or(fit.calibration.fit.rank_tolerance).unwrap_or(DEFAULT_TOLERANCE);
        let selection = judged.factor().select(&order, tolerance);
        let figure = |name: &str, value: f64| Figure::new(&fit.name, name, value, ONE);
        found.figures.extend([
            figure("candidates", problem.unknowns.len() as f64),
            figure("rank", selection.kept.len() as f64),
            figure("left out", selection.left_out.len() as f64),
            figure("condition", selection.condition),
        ]);
        let name = |unknown: &usize| problem.unknowns[*unknown].name.clone();
        let mut kept = selection.kept.clone();
        kept.sort_unstable();
        let kept: Vec<String> = kept.iter().map(name).collect();
        found.remarks.push(format!("{}: kept are {}", fit.name, kept.join(" ")));
        let without: Vec<String> = none(&selection.left_out).map(name).collect();
        if !without.is_empty() {
            found.remarks.push(format!("{}: no effect: {}", fit.name, without.join(" ")));
        }
        for UnestimableUnknown { unknown, same_as } in selection.left_out.iter().filter(|left| !left.same_as.is_empty())
        {
            found.remarks.push(format!("{}: {} = {}", fit.name, name(unknown), sum(same_as, name)));
        }
        Ok(())
    }

    /// The problem of the nominal machine with the candidates as unknowns, at nominal contact.
    fn candidates(&self, problem: &Problem) -> Result<Problem> {
        let patterns: Vec<String> = match self.settings.candidates.is_empty() {
            true => problem.unknowns.iter().map(|unknown| unknown.name.clone()).collect(),
            false => self.settings.candidates.clone(),
        };
        let (model, sets) = (problem.model.clone(), problem.sets.clone());
        let made = Problem::new(&problem.name, &problem.model_plugin, model, sets, &patterns);
        let mut candidates = made.map_err(|mut error| {
            // Here the patterns stand under the setting `candidates`, not `parameters`.
            if let Some(first) = error.setting.first_mut() {
                *first = abbe_core::PathItem::Key("candidates".to_owned());
            }
            error
        })?;
        for set in &mut candidates.sets {
            set.own = set.info().start.clone();
        }
        Ok(candidates)
    }
}

/// The unknowns that are left out because they have no effect.
fn none(left_out: &[UnestimableUnknown]) -> impl Iterator<Item = &usize> {
    left_out.iter().filter(|left| left.same_as.is_empty()).map(|left| &left.unknown)
}

/// `-96 dxw + 148 dyw`.
fn sum(parts: &[(usize, f64)], name: impl Fn(&usize) -> String) -> String {
    let mut text = String::new();
    for (index, (unknown, factor)) in parts.iter().enumerate() {
        let sign = match (index, *factor < 0.0) {
            (0, false) => "",
            (0, true) => "-",
            (_, false) => " + ",
            (_, true) => " - ",
        };
        // Four digits are enough for people; ones are not written.
        let digits = (3 - factor.abs().log10().floor() as i32).clamp(0, 12) as usize;
        let size = format!("{:.digits$}", factor.abs());
        let size = if size.contains('.') { size.trim_end_matches('0').trim_end_matches('.') } else { &size };
        let size = if size == "1" { String::new() } else { format!("{size} ") };
        text.push_str(&format!("{sign}{size}{}", name(unknown)));
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{UPWARDS, check, judge};

    #[test]
    fn sums_are_written_as_people_do() {
        let name = |unknown: &usize| ["dxw", "dyw"][*unknown].to_owned();
        let cases = [
            (vec![(0, -96.0), (1, 148.0)], "-96 dxw + 148 dyw"),
            (vec![(0, 1.0 - 1e-14), (1, -1.0)], "dxw - dyw"),
            (vec![(1, -0.012_344)], "-0.01234 dyw"),
            (vec![(0, 12_345.6)], "12346 dxw"),
        ];
        for (parts, expected) in cases {
            assert_eq!(sum(&parts, name), expected);
        }
    }

    /// Facets that all look upwards: their heights are three shifts and tilts of the workpiece and one more.
    #[test]
    fn one_of_those_that_do_the_same_is_kept() {
        let touches = ["a", "b", "c", "d"].map(|facet| (facet, "1", 0.0, 0.0));
        let (folder, fit) = crate::testing::fit(&UPWARDS, &touches, false);
        let set = fit.problem.sets[0].name.clone();
        let judged = |settings: &Value| judge("minimal-set", folder.path(), settings, &fit);
        let own = judged(&json!({ "limits": { "left_out": 0 } })).unwrap();
        check(&own, &[("candidates", 4.0), ("rank", 4.0), ("left out", 0.0), ("condition", 1.0)]);
        let with_offsets = judged(&json!({ "candidates": [format!("{set}.*"), "dzt", "dxt"] })).unwrap();
        let told = with_offsets.remarks.join("\n");
        // Offsets are new in every set-up: they are kept rather than a facet.
        assert!(told.contains("no effect: dxt"), "{told}");
        assert!(told.contains(&format!("{set}.facet[d].d = -dzt - {set}.facet[a].d")), "{told}");
        let prefer = json!({ "candidates": [format!("{set}.*"), "dzt"], "prefer": [format!("{set}.*")] });
        let told = judged(&prefer).unwrap().remarks.join("\n");
        assert!(told.contains(&format!("dzt = -{set}.facet[a].d")), "{told}");
        let wrong = judged(&json!({ "prefer": ["dxw"] })).unwrap_err();
        assert!(wrong.contains("`dxw` matches nothing that is to be estimated"), "{wrong}");
    }
}

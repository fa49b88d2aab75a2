//! Results of a validator: figures, their limits, and the decisions.

use std::collections::{BTreeMap, BTreeSet};

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::format::{FileFormat, parse};
use abbe_settings::{Error, Result};

/// The number of the format of `verdicts.json`. The file of this format is a list and does not contain the number. A later
/// format would be a map with its number under `abbe_verdicts`.
pub const VERDICTS_FORMAT: u32 = 1;

const FORMAT: FileFormat = FileFormat { name: "verdicts", key: "abbe_verdicts", number: VERDICTS_FORMAT };

use crate::decision::{Decision, Rule};
use crate::limit::Limit;

/// One figure of a verdict.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Figure {
    /// The estimate that the figure is about, where there are several.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub of: Option<String>,
    /// What the figure is, e.g. `max` or `rms[group=5]`.
    pub name: String,
    /// Its value; a figure that could not be computed is null and fails its limit.
    pub value: Option<f64>,
    /// Its standard uncertainty where the validator knows it, in the unit of the value; never negative.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub standard_uncertainty: Option<f64>,
    /// Unit of value, standard uncertainty and limit.
    pub unit: String,
    /// The largest admissible value.
    #[serde(default)]
    pub limit: Option<f64>,
    /// The decision rule of the limit; simple acceptance if none. A verdict contains it for every limit.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub decision_rule: Option<Rule>,
    /// The reason, a sentence, if the validator cannot decide whether the limit is kept. The figure is then inconclusive for
    /// any value and rule. Without a limit it has no effect.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub inconclusive: Option<String>,
    /// The decision on the figure if it has a limit. Validators do not set it; [`Verdict::new`] does.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub decision: Option<Decision>,
    /// A detail (one of many of its kind) that summaries leave out.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub detail: bool,
}

impl Figure {
    /// A figure of one estimate, without a limit.
    pub fn new(of: &str, name: impl Into<String>, value: f64, unit: &str) -> Self {
        Self {
            of: Some(of.to_owned()),
            name: name.into(),
            value: value.is_finite().then_some(value),
            standard_uncertainty: None,
            unit: unit.to_owned(),
            limit: None,
            decision_rule: None,
            inconclusive: None,
            decision: None,
            detail: false,
        }
    }

    /// Marks it as a detail.
    pub fn detail(mut self) -> Self {
        self.detail = true;
        self
    }

    /// Sets its standard uncertainty, in the unit of the value. A value that is not finite counts as none.
    pub fn uncertain(mut self, standard_uncertainty: impl Into<Option<f64>>) -> Self {
        self.standard_uncertainty = standard_uncertainty.into().filter(|uncertainty| uncertainty.is_finite());
        self
    }

    /// Sets its limit, or none.
    pub fn limited(mut self, limit: impl Into<Option<Limit>>) -> Self {
        self.set_limit(limit.into());
        self
    }

    /// Sets its limit, or none, where it stands.
    pub fn set_limit(&mut self, limit: Option<Limit>) {
        self.limit = limit.map(|limit| limit.value);
        self.decision_rule = limit.map(|limit| limit.rule);
    }

    /// The decision on the figure; none without a limit.
    pub fn decide(&self) -> Option<Decision> {
        let limit = self.limit?;
        let rule = self.decision_rule.unwrap_or_default();
        Some(match self.inconclusive {
            Some(_) => Decision::Inconclusive,
            None => rule.decide(self.value, self.standard_uncertainty, limit),
        })
    }

    /// Whether the figure does not fail. A figure without a limit passes.
    pub fn passes(&self) -> bool {
        self.decide().is_none_or(Decision::passes)
    }

    /// The figure with its decision and its decision rule.
    fn judged(mut self) -> Self {
        self.decision = self.decide();
        self.decision_rule = self.decision.map(|_| self.decision_rule.unwrap_or_default());
        if let (None, Some(rule), Some(limit)) = (&self.inconclusive, self.decision_rule, self.limit) {
            self.inconclusive = rule.undecided(self.value, self.standard_uncertainty, limit, &self.unit);
        }
        self
    }
}

/// The return value of a validator.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
pub struct Findings {
    /// The figures, most important first.
    pub figures: Vec<Figure>,
    /// Further remarks for users: sentences.
    pub remarks: Vec<String>,
    /// Tables to plot with other programs: text by file name, written into the folder of the stage.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub tables: BTreeMap<String, String>,
}

/// The verdict of one validate stage, as it stands in `verdicts.json`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "VerdictText")]
pub struct Verdict {
    /// Name of the stage.
    pub stage: String,
    /// Name of its plugin.
    pub plugin: String,
    /// Whether no figure fails. An inconclusive verdict passes.
    pub pass: bool,
    /// The decision: it fails if one figure fails, else it is inconclusive if one figure is, else it passes.
    pub decision: Decision,
    /// The figures.
    pub figures: Vec<Figure>,
    /// Further remarks for users.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub remarks: Vec<String>,
}

impl Verdict {
    /// Judges findings by the limits of their figures.
    pub fn new(stage: &str, plugin: &str, findings: Findings) -> Self {
        let figures: Vec<Figure> = findings.figures.into_iter().map(Figure::judged).collect();
        let decision = Decision::of_all(figures.iter().filter_map(|figure| figure.decision));
        Self {
            stage: stage.to_owned(),
            plugin: plugin.to_owned(),
            pass: decision.passes(),
            decision,
            figures,
            remarks: findings.remarks,
        }
    }

    /// Reads the text of a `verdicts.json`: the verdicts of all validate stages of a run, in their order.
    ///
    /// Keys that are not known are left alone. Fails on text that is not JSON, on another format number, on anything but a list, on
    /// missing or wrong parts (with line and column), and on two verdicts of one stage.
    pub fn list_from_json(text: &str) -> Result<Vec<Self>> {
        match parse(text)? {
            Value::Array(_) => {}
            Value::Object(map) if map.contains_key(FORMAT.key) => FORMAT.check(&map[FORMAT.key])?,
            _ => return Err(Error::data("these are no verdicts: a list was expected")),
        }
        let verdicts: Vec<Self> =
            serde_json::from_str(text).map_err(|error| Error::data(format!("these verdicts are broken: {error}")))?;
        let mut stages = BTreeSet::new();
        match verdicts.iter().find(|verdict| !stages.insert(verdict.stage.as_str())) {
            Some(twice) => Err(Error::data(format!("the stage `{}` has two verdicts", twice.stage))),
            None => Ok(verdicts),
        }
    }
}

/// A verdict of any version. In the first version it has `pass` but no `decision`.
#[derive(Deserialize)]
#[serde(expecting = "a map with `stage`, `plugin`, `pass` and `figures`")]
struct VerdictText {
    stage: String,
    plugin: String,
    pass: bool,
    #[serde(default)]
    decision: Option<Decision>,
    figures: Vec<Figure>,
    #[serde(default)]
    remarks: Vec<String>,
}

impl TryFrom<VerdictText> for Verdict {
    type Error = String;

    fn try_from(text: VerdictText) -> Result<Self, String> {
        let VerdictText { stage, plugin, pass, decision, figures, remarks } = text;
        let (decision, figures) = match decision {
            Some(decision) => (decision, figures),
            None => {
                let decision = if pass { Decision::Pass } else { Decision::Fail };
                (decision, figures.into_iter().map(Figure::judged).collect())
            }
        };
        match decision.passes() == pass {
            true => Ok(Self { stage, plugin, pass, decision, figures, remarks }),
            false => {
                Err(format!("the verdict of `{stage}` contradicts itself: `pass` is {pass}, `decision` is {decision}"))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::{Value, json};

    fn verdict(figures: Vec<Figure>) -> Verdict {
        Verdict::new("judge", "residuals", Findings { figures, ..Findings::default() })
    }

    fn figure(value: f64) -> Figure {
        Figure::new("fit", "max", value, "um")
    }

    fn inconclusive(figure: Figure) -> Figure {
        Figure { inconclusive: Some("the probe was disturbed".to_owned()), ..figure }
    }

    #[test]
    fn a_verdict_is_as_good_as_its_worst_figure() {
        let limit = Limit::from(30.0);
        let (good, bad) = (figure(29.0).limited(limit), figure(31.0).limited(limit));
        let untold = inconclusive(figure(31.0).limited(limit));
        let unlimited = inconclusive(figure(31.0));
        let cases = [
            (vec![], Decision::Pass),
            (vec![figure(1e9), good.clone()], Decision::Pass),
            // Without a limit there is nothing to decide.
            (vec![unlimited], Decision::Pass),
            (vec![good.clone(), untold.clone()], Decision::Inconclusive),
            (vec![good.clone().detail(), untold.clone().detail()], Decision::Inconclusive),
            (vec![untold, bad, good], Decision::Fail),
        ];
        for (figures, expected) in cases {
            let found = verdict(figures);
            assert_eq!((found.decision, found.pass), (expected, expected != Decision::Fail), "{found:?}");
            assert_eq!(found.pass, found.figures.iter().all(Figure::passes));
        }
    }

    #[test]
    fn what_could_not_be_computed_fails_and_what_could_not_be_told_does_not() {
        let not_computed = figure(f64::NAN).limited(Limit::from(30.0));
        assert_eq!((not_computed.value, not_computed.decide()), (None, Some(Decision::Fail)));
        assert_eq!(inconclusive(not_computed).decide(), Some(Decision::Inconclusive));
        assert_eq!(figure(f64::NAN).decide(), None);
    }

    #[test]
    fn every_limit_says_its_rule_and_its_decision() {
        let told = verdict(vec![
            figure(31.0).limited(Limit::from(30.0)).uncertain(0.5),
            inconclusive(figure(1.0).limited(Limit::from(30.0))),
            // A limit without a rule, as from a plugin of an earlier version, and with a decision of the plugin.
            Figure { limit: Some(40.0), decision: Some(Decision::Fail), ..figure(31.0) },
            figure(31.0).limited(None).uncertain(None),
        ]);
        let expected = json!({
            "stage": "judge", "plugin": "residuals", "pass": false, "decision": "fail",
            "figures": [
                { "of": "fit", "name": "max", "value": 31.0, "standard_uncertainty": 0.5, "unit": "um", "limit": 30.0,
                  "decision_rule": { "rule": "simple" }, "decision": "fail" },
                { "of": "fit", "name": "max", "value": 1.0, "unit": "um", "limit": 30.0,
                  "decision_rule": { "rule": "simple" }, "inconclusive": "the probe was disturbed",
                  "decision": "inconclusive" },
                { "of": "fit", "name": "max", "value": 31.0, "unit": "um", "limit": 40.0,
                  "decision_rule": { "rule": "simple" }, "decision": "pass" },
                { "of": "fit", "name": "max", "value": 31.0, "unit": "um", "limit": null },
            ],
        });
        assert_eq!(json!(told), expected);
        assert_eq!(serde_json::from_value::<Verdict>(expected).unwrap(), told);
    }

    /// A file of the first version, with pass or fail only.
    fn old(pass: bool) -> Value {
        json!({
            "stage": "judge", "plugin": "residuals", "pass": pass,
            "figures": [
                { "of": "fit", "name": "max", "value": if pass { 29.0 } else { 31.0 }, "unit": "um", "limit": 30.0 },
                { "of": "fit", "name": "mean", "value": 3.0, "unit": "um", "limit": null },
                { "name": "none", "value": null, "unit": "1", "limit": if pass { Value::Null } else { json!(3.0) },
                  "detail": true },
            ],
        })
    }

    #[test]
    fn verdicts_of_earlier_versions_are_read() {
        for (pass, expected) in [(true, Decision::Pass), (false, Decision::Fail)] {
            let read: Verdict = serde_json::from_value(old(pass)).unwrap();
            assert_eq!((read.pass, read.decision), (pass, expected));
            let decisions: Vec<_> = read.figures.iter().map(|figure| figure.decision).collect();
            assert_eq!(decisions, [Some(expected), None, (!pass).then_some(Decision::Fail)]);
            // When written again it has the same keys and some more.
            let written = json!(read);
            for (key, value) in old(pass).as_object().unwrap() {
                assert!(key == "figures" || written[key] == *value, "{key}");
            }
            assert_eq!(serde_json::from_value::<Verdict>(written).unwrap(), read);
        }
    }

    #[test]
    fn verdicts_that_contradict_themselves_are_refused() {
        for (pass, decision) in [(true, "fail"), (false, "pass"), (false, "inconclusive")] {
            let mut text = old(pass);
            text["decision"] = json!(decision);
            let error = serde_json::from_value::<Verdict>(text).unwrap_err().to_string();
            assert!(error.contains("the verdict of `judge` contradicts itself"), "{error}");
        }
    }
}

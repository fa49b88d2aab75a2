//! Statements of conformity: whether a parameter keeps its limit, by a rule that counts the uncertainty (JCGM 106:2012; ISO/IEC 17025,
//! 7.8.6).

use abbe_core::{Decision, Error, Estimated, Limit, Result, Rule, matches};

use crate::settings::Settings;
use crate::units::dsi;

/// What is said of a parameter.
#[derive(Debug, Clone, PartialEq)]
pub struct Statement {
    /// Its name.
    pub parameter: String,
    /// The largest admissible size, in the unit of the value.
    pub limit: f64,
    /// This unit, as the D-SI has it.
    pub unit: String,
    /// Where the rule stands.
    pub rule: &'static str,
    /// The status of the schema: `pass`, `fail`; `conditionalPass` and `conditionalFail` are within the guard band, inside and outside of the
    /// limit.
    pub status: &'static str,
    /// The same in words.
    pub declaration: String,
}

/// The statements of all certified parameters that have a limit. Of several patterns that fit the longest one counts.
///
/// Fails for a limit of a parameter whose unit has no unit of limits, and for a pattern that fits none.
pub fn statements(settings: &Settings, certified: &[&Estimated]) -> Result<Vec<Statement>> {
    if let Some(pattern) =
        settings.limits.keys().find(|pattern| !certified.iter().any(|one| matches(pattern, &one.name)))
    {
        let error = Error::usage(format!("no certified parameter is called `{pattern}`"));
        return Err(error.setting("limits").help("limits are those of parameters that the certificate states"));
    }
    let statement = |(one, limit): (&Estimated, &Limit)| {
        let (factor, unit) = match one.unit.as_str() {
            "mm" => (1e-3, "um"),
            "rad" => (1e-6, "urad"),
            "1" | "mm/mm" => (1e-6, "um/m"),
            other => {
                let error = Error::usage(format!("{} has the unit {other}: there are no limits in it", one.name));
                return Err(error.setting("limits").help("limits are those of lengths, angles and numbers"));
            }
        };
        let [value, u] = [one.value, one.standard_uncertainty].map(|number| number / factor);
        let band = limit.rule.guard_band(u);
        let decision = limit.rule.answer(value, band, Some(-limit.value), Some(limit.value));
        let is_inside = value.abs() <= limit.value;
        let (status, words) = match decision {
            Decision::Pass => ("pass", "conforms"),
            Decision::Fail => ("fail", "does not conform"),
            Decision::Inconclusive if is_inside => {
                ("conditionalPass", "is within the limit, nearer to it than the guard band")
            }
            Decision::Inconclusive => ("conditionalFail", "is beyond the limit, nearer to it than the guard band"),
        };
        Ok(Statement {
            parameter: one.name.clone(),
            limit: limit.value * factor,
            unit: dsi(&one.unit).unwrap_or_default(),
            rule: source(limit.rule),
            status,
            declaration: format!(
                "{} {words}: {value:.3} {unit} with a standard uncertainty of {u:.3} {unit}, largest admissible size {} {unit}, guard band \
                 {band:.3} {unit}",
                one.name, limit.value
            ),
        })
    };
    let limited = certified.iter().filter_map(|one| {
        let patterns = settings.limits.iter().filter(|(pattern, _)| matches(pattern, &one.name));
        Some((*one, patterns.max_by_key(|(pattern, _)| pattern.len())?.1))
    });
    limited.map(statement).collect()
}

/// Where a rule stands.
fn source(rule: Rule) -> &'static str {
    match rule {
        Rule::Simple {} => "JCGM 106:2012, 8.2 (simple acceptance)",
        Rule::Iso14253Of1998 { .. } => "ISO 14253-1:1998",
        Rule::Iso14253Of2017 { .. } => "ISO 14253-1:2017",
        Rule::Binary { .. } => "JCGM 106:2012, 8.3 (guarded acceptance)",
    }
}

//! How far to trust estimates, for a terminal: weak combinations, correlations, budgets.

use abbe_core::{ParameterBudget, UncertaintyBudget, Unit, WeakDirection};

use crate::table;
use abbe_report::number::short;

/// Correlated pairs that are shown of an estimate.
const PAIRS: usize = 5;

/// The weakest combinations of an estimate, one line each; the number is the singular value relative to the largest.
pub fn weakest(vectors: &[WeakDirection]) -> String {
    vectors.iter().map(|vector| format!("  {:>9}  {}\n", short(vector.singular_value), vector.changes())).collect()
}

/// The strongest correlations of an estimate in one line; nothing if there are none.
pub fn correlations(budget: &UncertaintyBudget) -> String {
    let shown = budget.correlations.iter().take(PAIRS);
    let mut pairs: Vec<String> =
        shown.map(|pair| format!("{} and {} {:+.3}", pair.one, pair.other, pair.correlation)).collect();
    match budget.correlations.len().saturating_sub(PAIRS) {
        0 => {}
        rest => pairs.push(format!("{rest} more")),
    }
    pairs.join(", ")
}

/// Expanded uncertainty of the parameters that `of` takes, and the part of the variance that each input gives, in percent; in
/// lines of this width.
pub fn budget(budget: &UncertaintyBudget, of: impl Fn(&str) -> bool, width: usize) -> String {
    let chosen: Vec<&ParameterBudget> = budget.parameters.iter().filter(|parameter| of(&parameter.name)).collect();
    let mut inputs: Vec<&str> = Vec::new();
    for contribution in chosen.iter().flat_map(|parameter| &parameter.contributions) {
        if !inputs.contains(&contribution.input.as_str()) {
            inputs.push(&contribution.input);
        }
    }
    let mut header = vec![String::new(), String::new(), "U".to_owned(), "k".to_owned()];
    header.extend(inputs.iter().map(|input| format!("{input} %")));
    let mut rows = vec![header];
    for parameter in chosen {
        let (symbol, factor) = parameter.unit.parse::<Unit>().map_or((parameter.unit.clone(), 1.0), Unit::for_people);
        let expanded = two_digits(parameter.expanded_uncertainty * factor);
        let mut row = vec![parameter.name.clone(), symbol, expanded, format!("{:.2}", parameter.coverage_factor)];
        row.extend(inputs.iter().map(|input| {
            let part = parameter.contributions.iter().find(|contribution| contribution.input == *input);
            part.map_or_else(String::new, |part| {
                format!("{:.0}", 100.0 * (part.standard_uncertainty / parameter.standard_uncertainty).powi(2))
            })
        }));
        rows.push(row);
    }
    let right: Vec<usize> = (2..4 + inputs.len()).collect();
    table::within(&rows, &right, 2, width)
}

/// An uncertainty to two significant digits (GUM 7.2.6).
fn two_digits(uncertainty: f64) -> String {
    if uncertainty <= 0.0 || !uncertainty.is_finite() {
        return short(uncertainty);
    }
    let decimals = 1 - uncertainty.log10().floor() as i32;
    match decimals {
        0..=9 => format!("{uncertainty:.*}", decimals as usize),
        _ => format!("{uncertainty:.1e}"),
    }
}

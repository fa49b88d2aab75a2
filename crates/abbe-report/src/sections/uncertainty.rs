//! Budgets of uncertainty, and correlations.

use abbe_core::{Status, Unit};

use crate::chart::heat_map;
use crate::html::{Cell, figure, paragraph, table};
use crate::number::short;
use crate::run::FitResult;

/// Contributions that are named for each parameter.
const NAMED: usize = 3;

/// Parameters of the map at most.
const MOST: usize = 120;

/// What the uncertainty of each parameter is made of.
pub fn budget(fit: &FitResult) -> String {
    let Some(budget) = &fit.calibration.uncertainty else {
        return paragraph("This estimate states no budget.");
    };
    let rows = budget.parameters.iter().map(|entry| {
        let (unit, factor) = entry.unit.parse::<Unit>().map_or((entry.unit.clone(), 1.0), Unit::for_people);
        let whole = entry.standard_uncertainty * entry.standard_uncertainty;
        let parts = entry.contributions.iter().take(NAMED).map(|part| {
            format!("{} {:.0} %", part.input, 100.0 * part.standard_uncertainty.powi(2) / whole.max(f64::MIN_POSITIVE))
        });
        vec![
            Cell::text(&entry.name),
            Cell::figure(format!("{} {unit}", short(entry.standard_uncertainty * factor))),
            Cell::figure(format!("{:.2}", entry.coverage_factor)),
            Cell::figure(format!("{} {unit}", short(entry.expanded_uncertainty * factor))),
            Cell::figure(entry.degrees_of_freedom.map_or("∞".to_owned(), short)),
            Cell::text(parts.collect::<Vec<_>>().join(", ")),
        ]
    });
    let head = ["parameter", "standard uncertainty", "k", "expanded", "degrees of freedom", "parts of the variance"];
    let caption = format!(
        "Coverage {:.0} %; stated uncertainties of rows times {}",
        budget.coverage_probability * 100.0,
        short(budget.scale)
    );
    table(&caption, &head, &rows.collect::<Vec<_>>())
}

/// The map of correlations of the estimated parameters of the machine, and the strongest pairs.
pub fn correlations(fit: &FitResult) -> String {
    let covariance = &fit.calibration.covariance;
    let estimated = fit.calibration.parameters.iter().filter(|parameter| parameter.status == Status::Estimated);
    let known: Vec<(String, usize)> = estimated
        .filter_map(|parameter| {
            let index = covariance.index(&parameter.name).filter(|index| covariance.rows[*index][*index] > 0.0)?;
            Some((parameter.name.clone(), index))
        })
        .collect();
    if known.len() < 2 {
        return paragraph("There are not two estimated parameters with a covariance.");
    }
    let correlation = |one: usize, other: usize| {
        let scale = (covariance.rows[one][one] * covariance.rows[other][other]).sqrt();
        covariance.rows[one][other] / scale
    };
    let shown = &known[..known.len().min(MOST)];
    let names: Vec<String> = shown.iter().map(|(name, _)| name.clone()).collect();
    let title = format!("Correlations of the parameters of {}", fit.name);
    let map = heat_map(&title, &names, |row, column| correlation(shown[row].1, shown[column].1));
    let mut caption = "Correlations below 0.2 are left white; the table has the strongest.".to_owned();
    if known.len() > MOST {
        caption.push_str(&format!(" The first {MOST} of {} parameters.", known.len()));
    }
    let mut pairs: Vec<(f64, usize, usize)> = Vec::new();
    for row in 0..known.len() {
        pairs.extend((0..row).map(|column| (correlation(known[row].1, known[column].1), column, row)));
    }
    pairs.sort_by(|one, other| other.0.abs().total_cmp(&one.0.abs()));
    let rows = pairs.iter().take(10).map(|(value, one, other)| {
        vec![Cell::text(&known[*one].0), Cell::text(&known[*other].0), Cell::figure(format!("{value:+.3}"))]
    });
    figure(&map, &caption)
        + &table("The strongest correlations", &["one", "other", "correlation"], &rows.collect::<Vec<_>>())
}

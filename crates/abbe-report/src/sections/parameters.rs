//! The parameters of all estimates, with intervals.

use std::collections::BTreeMap;

use abbe_core::{Estimated, ModelInfo, ParameterRole, Status, Unit};

use crate::chart::{ForestRow, forest};
use crate::html::{Cell, details, escape, figure, paragraph, table};
use crate::number::with_uncertainty;
use crate::run::FitResult;

/// Rows of one chart.
const ROWS: usize = 40;

/// Expanded uncertainty of a value: of its budget, else k = 2.
fn expanded(fit: &FitResult, estimated: &Estimated) -> f64 {
    let budget = fit.calibration.uncertainty.as_ref();
    let entry = budget.and_then(|budget| budget.parameters.iter().find(|entry| entry.name == estimated.name));
    entry.map_or(2.0 * estimated.standard_uncertainty, |entry| entry.expanded_uncertainty)
}

/// What a parameter belongs to, for a heading.
fn owner(info: &ModelInfo, name: &str) -> String {
    let found = info.parameters.iter().find(|parameter| parameter.name == name);
    match found.map(|parameter| parameter.role) {
        Some(ParameterRole::Motion { axis, .. } | ParameterRole::Location { axis, .. }) => {
            info.axes.get(axis).map_or("Machine".to_owned(), |axis| format!("Axis {}", axis.name))
        }
        Some(ParameterRole::SetUp) => "Set-up".to_owned(),
        Some(ParameterRole::Probe { .. }) => "Probe".to_owned(),
        Some(ParameterRole::Shape) => "Shapes of errors".to_owned(),
        _ if info.axes.is_empty() => "Quantities".to_owned(),
        _ => "Other".to_owned(),
    }
}

/// The section: charts by axis and unit, then the numbers. `fits` have the names that the page uses.
pub fn parameters(fits: &[(String, &FitResult)]) -> String {
    // By heading and unit, in the order of the first estimate that has them.
    let mut order: Vec<(String, String)> = Vec::new();
    let mut members: BTreeMap<(String, String), Vec<String>> = BTreeMap::new();
    for (_, fit) in fits {
        for estimated in fit.calibration.parameters.iter().filter(|estimated| estimated.status != Status::Fixed) {
            let key = (owner(fit.model.info(), &estimated.name), estimated.unit.clone());
            if !order.contains(&key) {
                order.push(key.clone());
            }
            let names = members.entry(key).or_default();
            if !names.contains(&estimated.name) {
                names.push(estimated.name.clone());
            }
        }
    }
    if order.is_empty() {
        return paragraph("Nothing was estimated.");
    }
    let mut headings: Vec<String> = Vec::new();
    for (heading, _) in &order {
        if !headings.contains(heading) {
            headings.push(heading.clone());
        }
    }
    let mut html = legend(fits);
    for heading in &headings {
        let mut charts = String::new();
        for key in order.iter().filter(|(of, _)| of == heading) {
            let (unit, factor) = key.1.parse::<Unit>().map_or((key.1.clone(), 1.0), Unit::for_people);
            for names in members[key].chunks(ROWS) {
                let rows: Vec<ForestRow> = names.iter().map(|name| row(fits, name, factor, &unit)).collect();
                charts.push_str(&forest(&format!("{heading}, in {unit}, with intervals"), &unit, &rows));
            }
        }
        html.push_str(&details(heading, true, &figure(&charts, "Mark: value; line: expanded uncertainty.")));
    }
    html + &details("All values in numbers", false, &numbers(fits, &order, &members))
}

fn legend(fits: &[(String, &FitResult)]) -> String {
    let items = fits.iter().enumerate().map(|(series, (name, _))| {
        let mut canvas = crate::chart::Canvas::new(12.0, 12.0, "");
        canvas.mark(series, [6.0, 6.0], "");
        format!(
            "<li>{}{}</li>\n",
            canvas.svg().replace("role=\"img\" aria-label=\"\"", "aria-hidden=\"true\""),
            escape(name)
        )
    });
    format!("<ul class=\"legend\">\n{}</ul>\n", items.collect::<String>())
}

fn row(fits: &[(String, &FitResult)], name: &str, factor: f64, unit: &str) -> ForestRow {
    let value = |(label, fit): &(String, &FitResult)| {
        let estimated = fit.calibration.get(name).filter(|estimated| estimated.status != Status::Fixed)?;
        let (value, half) = (estimated.value * factor, expanded(fit, estimated) * factor);
        let doubt = if estimated.status == Status::Confounded { ", not told apart from others" } else { "" };
        Some((value, half, format!("{name} by {label}: {} {unit}{doubt}", with_uncertainty(value, half))))
    };
    ForestRow { name: name.to_owned(), values: fits.iter().map(value).collect() }
}

fn numbers(
    fits: &[(String, &FitResult)],
    order: &[(String, String)],
    members: &BTreeMap<(String, String), Vec<String>>,
) -> String {
    let mut head = vec!["parameter", "unit"];
    head.extend(fits.iter().map(|(name, _)| name.as_str()));
    let rows = order.iter().flat_map(|key| members[key].iter().map(move |name| (key, name)));
    let rows = rows.map(|(key, name)| {
        let (unit, factor) = key.1.parse::<Unit>().map_or((key.1.clone(), 1.0), Unit::for_people);
        let mut cells = vec![Cell::text(name), Cell::text(unit)];
        cells.extend(fits.iter().map(|(_, fit)| Cell::figure(cell(fit, name, factor))));
        cells
    });
    table("Values with standard uncertainties", &head, &rows.collect::<Vec<_>>())
        + &paragraph(
            "? not told apart from others by the data; (in parentheses) known from an earlier estimate; ! no machine has such an error",
        )
}

fn cell(fit: &FitResult, name: &str, factor: f64) -> String {
    let Some(estimated) = fit.calibration.get(name) else { return String::new() };
    let value = with_uncertainty(estimated.value * factor, estimated.standard_uncertainty * factor);
    let is_implausible = fit.calibration.fit.implausible.iter().any(|value| value.name == name);
    match estimated.status {
        _ if is_implausible => format!("{value} !"),
        Status::Fixed => String::new(),
        Status::Estimated => value,
        Status::Considered => format!("({value})"),
        Status::Confounded => format!("{value} ?"),
    }
}

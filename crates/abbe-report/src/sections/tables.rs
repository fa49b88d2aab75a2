//! All figures of validators, and the reports of the fits.

use abbe_core::{Decision, Figure, Verdict};

use super::{unit_of, valued};
use crate::html::{Cell, details, list, paragraph, table};
use crate::number::{short, with_uncertainty};
use crate::run::{FitResult, Run};

/// The section: one table a validator, one for the fits.
pub fn tables(run: &Run) -> String {
    let mut html = if run.fits.is_empty() { String::new() } else { fits(&run.fits) };
    for verdict in &run.verdicts {
        let body = figures(verdict) + &list(&verdict.remarks);
        html.push_str(&details(&format!("{} ({})", verdict.stage, verdict.plugin), false, &body));
    }
    html
}

fn fits(all: &[FitResult]) -> String {
    let rows = all.iter().map(|fit| {
        let report = &fit.calibration.fit;
        let counts = [report.observations, report.unknowns, report.rank, report.degrees_of_freedom];
        let mut cells = vec![Cell::text(&fit.name)];
        cells.extend(counts.map(|count| Cell::figure(count.to_string())));
        cells.extend([report.condition, report.sigma, report.residual_rms_um].map(|size| Cell::figure(short(size))));
        cells.push(Cell::figure(report.residual_radial_rms_um.map_or("–".to_owned(), short)));
        cells.push(Cell::figure(short(report.residual_max_um)));
        cells.push(Cell::figure(report.residual_rms_urad.map_or("–".to_owned(), short)));
        cells.push(Cell::figure(fit.calibration.outliers.len().to_string()));
        cells
    });
    let head = [
        "estimate",
        "equations",
        "unknowns",
        "rank",
        "degrees of freedom",
        "condition",
        "sigma",
        "RMS µm",
        "radial RMS µm",
        "largest µm",
        "RMS µrad",
        "outliers",
    ];
    table("The fits; sigma is the scatter of the residuals over what was stated", &head, &rows.collect::<Vec<_>>())
}

/// One line a figure, one column an estimate.
fn figures(verdict: &Verdict) -> String {
    let shown: Vec<&Figure> = verdict.figures.iter().filter(|figure| !figure.detail).collect();
    let left = verdict.figures.len() - shown.len();
    let mut estimates: Vec<&str> = Vec::new();
    let mut names: Vec<(&str, &str)> = Vec::new();
    for figure in &shown {
        let of = figure.of.as_deref().unwrap_or("value");
        if !estimates.contains(&of) {
            estimates.push(of);
        }
        if !names.contains(&(&figure.name, &figure.unit)) {
            names.push((&figure.name, &figure.unit));
        }
    }
    let rows = names.iter().map(|(name, unit)| {
        let mut cells = vec![Cell::text(format!("{name} {}", unit_of(unit)))];
        cells.extend(estimates.iter().map(|of| {
            let is_it = |figure: &&&Figure| {
                figure.name == *name && figure.unit == *unit && figure.of.as_deref().unwrap_or("value") == *of
            };
            Cell::figure(shown.iter().find(is_it).map_or(String::new(), |figure| cell(figure)))
        }));
        cells
    });
    let rows: Vec<Vec<Cell>> = rows.collect();
    let mut head = vec!["figure"];
    head.extend(&estimates);
    let mut html = if rows.is_empty() {
        String::new()
    } else {
        table(&format!("{}; ± is the standard uncertainty", verdict.stage), &head, &rows)
    };
    if left > 0 {
        html.push_str(&paragraph(&format!("{left} details stand in verdicts.json.")));
    }
    html
}

fn cell(figure: &Figure) -> String {
    let mark = match figure.decision {
        Some(Decision::Fail) => " ✗",
        Some(Decision::Inconclusive) => " ?",
        _ => "",
    };
    let value = match (figure.value, figure.standard_uncertainty) {
        (None, _) => "none".to_owned(),
        (Some(value), Some(uncertainty)) if uncertainty > 0.0 => with_uncertainty(value, uncertainty),
        (Some(value), _) if figure.unit == "1" => valued(value, "1"),
        (Some(value), _) => short(value),
    };
    let limit = figure.limit.map_or(String::new(), |limit| format!(" (limit {})", short(limit)));
    format!("{value}{limit}{mark}")
}

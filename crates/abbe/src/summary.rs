//! The results of a run, as text and as JSON.

use std::path::Path;

use abbe_core::{Decision, Estimated, Figure, Fit, Outlier, Status, Unit, Verdict};
use abbe_engine::{Failure, Outcome, Planned, Remark};
use serde_json::{Value, json};

use crate::table;
use crate::uncertainty_summary;
use abbe_report::number::{short, with_uncertainty};
use abbe_report::unit_of;

/// The summary of a run for a terminal.
pub fn text(name: &str, outcome: &Outcome, folder: &Path) -> String {
    let mut parts = vec![format!("{name}\n")];
    if !outcome.fits.is_empty() {
        parts.push(section("Estimated parameters, with standard uncertainties", &parameters(&outcome.fits)));
        parts.push(section("Fits", &fits(&outcome.fits)));
        parts.extend(outliers(&outcome.fits));
        parts.extend(selected(&outcome.fits));
        parts.extend(predicted(&outcome.fits));
        parts.extend(lost(&outcome.fits));
        parts.extend(alike(&outcome.fits));
        parts.extend(correlated(&outcome.fits));
        parts.extend(doubts(&outcome.doubts));
    }
    parts.extend(outcome.verdicts.iter().map(verdict));
    parts.extend(failures(&outcome.failures));
    parts.push(format!("Results: {}\n", folder.display().to_string().replace('\n', "\u{240a}")));
    parts.join("\n")
}

/// What is hard to believe, one line each.
fn doubts(doubts: &[Remark]) -> Option<String> {
    let line = |Remark { estimate, text }: &Remark| format!("  {estimate}: {text}\n");
    (!doubts.is_empty()).then(|| section("Hard to believe", &doubts.iter().map(line).collect::<String>()))
}

/// The stages without a result, and the beginning of why.
fn failures(failures: &[Failure]) -> Option<String> {
    let line = |failure: &Failure| {
        let message = failure.error.message.lines().next().unwrap_or_default();
        format!("  {} ({}): {message}\n", failure.stage, failure.kind.key())
    };
    (!failures.is_empty()).then(|| section("Failed", &failures.iter().map(line).collect::<String>()))
}

pub fn section(title: &str, body: &str) -> String {
    format!("{title}\n{body}")
}

/// One line a parameter, one column a fit.
fn parameters(fits: &[Fit]) -> String {
    let mut names: Vec<(&str, &str)> = Vec::new();
    for fit in fits {
        for estimated in fit.calibration.parameters.iter().filter(|estimated| estimated.status != Status::Fixed) {
            if !names.iter().any(|(name, _)| *name == estimated.name) {
                names.push((&estimated.name, &estimated.unit));
            }
        }
    }
    let mut header = vec![String::new(), String::new()];
    header.extend(fits.iter().map(|fit| fit.name.clone()));
    let mut rows = vec![header];
    for (name, unit) in names {
        let (symbol, factor) = unit.parse::<Unit>().map_or((unit.to_owned(), 1.0), Unit::for_people);
        let mut row = vec![name.to_owned(), symbol];
        row.extend(fits.iter().map(|fit| {
            let found = fit.calibration.parameters.iter().find(|estimated| estimated.name == name);
            found.map_or(String::new(), |estimated| cell(estimated, factor, is_implausible(fit, name)))
        }));
        rows.push(row);
    }
    let mut own = vec!["artefacts".to_owned(), "unknowns".to_owned()];
    own.extend(
        fits.iter()
            .map(|fit| fit.problem.unknowns.iter().filter(|unknown| !unknown.is_of_machine()).count().to_string()),
    );
    rows.push(own);
    let mut text = table::text(&rows, &columns(fits.len(), 2));
    let has =
        |status| fits.iter().any(|fit| fit.calibration.parameters.iter().any(|estimated| estimated.status == status));
    if has(Status::Confounded) {
        text.push_str("  ? the data cannot separate this value from others; see below\n");
    }
    if fits.iter().any(|fit| !fit.calibration.fit.implausible.is_empty()) {
        text.push_str("  ! no machine has such an error\n");
    }
    if has(Status::Considered) {
        text.push_str("  (in parentheses) known from an earlier estimate; its uncertainty counts\n");
    }
    text
}

fn is_implausible(fit: &Fit, name: &str) -> bool {
    fit.calibration.fit.implausible.iter().any(|value| value.name == name)
}

fn cell(estimated: &Estimated, factor: f64, is_implausible: bool) -> String {
    let value = with_uncertainty(estimated.value * factor, estimated.standard_uncertainty * factor);
    match estimated.status {
        _ if is_implausible => format!("{value} !"),
        Status::Fixed => String::new(),
        Status::Estimated => value,
        Status::Considered => format!("({value})"),
        Status::Confounded => format!("{value} ?"),
    }
}

pub fn columns(count: usize, first: usize) -> Vec<usize> {
    (first..first + count).collect()
}

fn fits(fits: &[Fit]) -> String {
    type Figure = (&'static str, fn(&Fit) -> String);
    let figures: [Figure; 13] = [
        ("equations", |fit| fit.calibration.fit.observations.to_string()),
        ("unknowns", |fit| fit.calibration.fit.unknowns.to_string()),
        ("rank", |fit| fit.calibration.fit.rank.to_string()),
        ("condition", |fit| short(fit.calibration.fit.condition)),
        ("sigma", |fit| short(fit.calibration.fit.sigma)),
        ("residual, largest µm", |fit| length(fit, fit.calibration.fit.residual_max_um)),
        ("residual, mean size µm", |fit| length(fit, fit.calibration.fit.residual_mean_abs_um)),
        ("residual, RMS µm", |fit| length(fit, fit.calibration.fit.residual_rms_um)),
        ("residual, radial RMS µm", |fit| if_any(fit.calibration.fit.residual_radial_rms_um)),
        ("residual, largest µrad", |fit| if_any(fit.calibration.fit.residual_max_urad)),
        ("residual, mean size µrad", |fit| if_any(fit.calibration.fit.residual_mean_abs_urad)),
        ("residual, RMS µrad", |fit| if_any(fit.calibration.fit.residual_rms_urad)),
        ("outliers", |fit| fit.calibration.outliers.len().to_string()),
    ];
    let mut header = vec![String::new()];
    header.extend(fits.iter().map(|fit| fit.name.clone()));
    let mut rows = vec![header];
    for (name, figure) in figures {
        let mut row = vec![name.to_owned()];
        row.extend(fits.iter().map(figure));
        // Most fits observe no angle.
        if row[1..].iter().any(|cell| !cell.is_empty()) {
            rows.push(row);
        }
    }
    table::text(&rows, &columns(fits.len(), 1))
}

/// A figure of residuals of lengths. Readings that are no geometry may have none.
fn length(fit: &Fit, value: f64) -> String {
    let has_machine = !fit.problem.model.info().axes.is_empty();
    if has_machine || value > 0.0 { short(value) } else { String::new() }
}

/// A figure that not every fit has.
fn if_any(value: Option<f64>) -> String {
    value.map_or(String::new(), short)
}

/// One line a row, whichever fits list it.
fn outliers(fits: &[Fit]) -> Option<String> {
    let mut rows: Vec<(&Outlier, Vec<String>)> = Vec::new();
    for fit in fits {
        for outlier in &fit.calibration.outliers {
            let off = format!("{:.1} µm in {}", outlier.residual_um, fit.name);
            let same = |other: &Outlier| {
                (&other.stage, &other.file, other.row) == (&outlier.stage, &outlier.file, outlier.row)
            };
            match rows.iter_mut().find(|(other, _)| same(other)) {
                Some((_, listed)) => listed.push(off),
                None => rows.push((outlier, vec![off])),
            }
        }
    }
    let lines = rows.iter().map(|(outlier, listed)| {
        format!("  {} row {} ({}): {}\n", outlier.stage, outlier.row, outlier.place(), listed.join(", "))
    });
    let text: String = lines.collect();
    (!text.is_empty()).then(|| section("Outliers, off by", &text))
}

fn lost(fits: &[Fit]) -> Option<String> {
    let lines = fits.iter().flat_map(|fit| {
        fit.calibration.fit.null_space.iter().map(|vector| format!("  {}: {}\n", fit.name, vector.advise()))
    });
    let text: String = lines.collect();
    (!text.is_empty()).then(|| section("Not determined", &text))
}

/// The selections of the fits: how many candidates each kept, and which.
fn selected(fits: &[Fit]) -> Option<String> {
    let lines = fits.iter().filter_map(|fit| {
        let selection = fit.calibration.fit.selection.as_ref()?;
        let candidates = selection.kept.len() + selection.left_out.len();
        let kept = selection.kept.join(" ");
        Some(format!("  {}: {} of {candidates} at level {}: {kept}\n", fit.name, selection.kept.len(), selection.level))
    });
    let text: String = lines.collect();
    (!text.is_empty()).then(|| section("Kept as significant", &text))
}

/// The selections by prediction: what each left out, and how well it predicts.
fn predicted(fits: &[Fit]) -> Option<String> {
    let lines = fits.iter().filter_map(|fit| {
        let selection = fit.calibration.fit.selection_by_prediction.as_ref()?;
        let all = selection.tried.first().map_or(f64::NAN, |all| all.error);
        let left_out = match selection.chosen.left_out.join(" ") {
            none if none.is_empty() => "nothing".to_owned(),
            some => some,
        };
        Some(format!(
            "  {}: {} runs are off by {:.2} standard uncertainties (RMS; with all candidates {all:.2}); left out: {left_out}\n",
            fit.name,
            selection.runs.len(),
            selection.chosen.error
        ))
    });
    let text: String = lines.collect();
    (!text.is_empty()).then(|| section("Selected by the prediction of runs that were left out", &text))
}

/// Heading for parameters that move the tip in the same way.
pub const ALIKE: &str = "Told apart by the choice of functions only";

fn alike(fits: &[Fit]) -> Option<String> {
    let lines = fits.iter().flat_map(|fit| {
        fit.calibration.fit.equivalent_motion_errors.iter().map(|same| format!("  {}: {}\n", fit.name, same.describe()))
    });
    let text: String = lines.collect();
    (!text.is_empty()).then(|| section(ALIKE, &text))
}

fn correlated(fits: &[Fit]) -> Option<String> {
    let budgets = fits.iter().filter_map(|fit| Some((&fit.name, fit.calibration.uncertainty.as_ref()?)));
    let lines = budgets.map(|(name, budget)| (name, uncertainty_summary::correlations(budget)));
    let text: String =
        lines.filter(|(_, pairs)| !pairs.is_empty()).map(|(name, pairs)| format!("  {name}: {pairs}\n")).collect();
    (!text.is_empty()).then(|| section("Hardly told apart, correlation above 0.95", &text))
}

fn verdict(verdict: &Verdict) -> String {
    let judged = verdict.figures.iter().any(|figure| figure.decision.is_some());
    let result = if judged { verdict.decision.to_string().to_uppercase() } else { "no limit set".to_owned() };
    let mut text = section(&format!("{} ({}): {result}", verdict.stage, verdict.plugin), &figures(&verdict.figures));
    for (figure, why) in verdict.figures.iter().filter_map(undecided) {
        let of = figure.of.as_ref().map_or(String::new(), |of| format!("{of}: "));
        text.push_str(&format!("  ? {of}{} cannot be told: {why}\n", figure.name));
    }
    for remark in &verdict.remarks {
        text.push_str(&format!("  {remark}\n"));
    }
    text
}

/// A shown figure with a limit for which the validator cannot decide, and the reason.
fn undecided(figure: &Figure) -> Option<(&Figure, &str)> {
    let inconclusive = figure.decision == Some(Decision::Inconclusive) && !figure.detail;
    figure.inconclusive.as_deref().filter(|_| inconclusive).map(|why| (figure, why))
}

/// Mark of a decision in the table of figures; a figure that passes has none.
fn mark(figure: &Figure) -> &'static str {
    match figure.decision {
        Some(Decision::Fail) => " !",
        Some(Decision::Inconclusive) => " ?",
        Some(Decision::Pass) | None => "",
    }
}

/// One line a figure, one column an estimate; details are left to `verdicts.json`.
fn figures(figures: &[Figure]) -> String {
    let shown: Vec<&Figure> = figures.iter().filter(|figure| !figure.detail).collect();
    let mut estimates: Vec<&Option<String>> = Vec::new();
    let mut names: Vec<(&str, &str)> = Vec::new();
    for figure in &shown {
        if !estimates.contains(&&figure.of) {
            estimates.push(&figure.of);
        }
        if !names.contains(&(&figure.name, &figure.unit)) {
            names.push((&figure.name, &figure.unit));
        }
    }
    let mut header = vec![String::new()];
    header.extend(estimates.iter().map(|of| of.as_deref().unwrap_or_default().to_owned()));
    let limited = shown.iter().any(|figure| figure.limit.is_some());
    if limited {
        header.push("limit".to_owned());
    }
    let mut rows = vec![header];
    for (name, unit) in names {
        let of_name = || shown.iter().filter(|figure| figure.name == name && figure.unit == unit);
        let mut row = vec![format!("{name} {}", unit_of(unit)).trim_end().to_owned()];
        row.extend(estimates.iter().map(|of| {
            let Some(figure) = of_name().find(|figure| figure.of == **of) else { return String::new() };
            let value = figure.value.map_or_else(|| "none".to_owned(), |value| counted(value, &figure.unit));
            format!("{value}{}", mark(figure))
        }));
        if limited {
            let limit = of_name().find_map(|figure| Some(measured(figure.limit?, &figure.unit)));
            row.push(limit.unwrap_or_default());
        }
        rows.push(row);
    }
    table::text(&rows, &columns(estimates.len() + usize::from(limited), 1))
}

fn counted(value: f64, unit: &str) -> String {
    if unit == "1" && value.fract() == 0.0 && value.abs() < 1e9 { format!("{value:.0}") } else { measured(value, unit) }
}

/// Sizes in mm to 0.1 µm, all else to four digits.
fn measured(value: f64, unit: &str) -> String {
    if unit == "mm" { format!("{value:.4}") } else { short(value) }
}

/// The summary of a run for machines.
pub fn json(outcome: &Outcome, folder: &Path) -> Value {
    let estimates = outcome.fits.iter().map(|fit| {
        json!({
            "estimate": fit.name,
            "calibration": folder.join(format!("{}.calibration.json", fit.name)).display().to_string(),
            "fit": fit.calibration.fit,
            "outliers": fit.calibration.outliers,
        })
    });
    let record = outcome.record();
    json!({
        "results": folder.display().to_string(),
        "pass": outcome.passes(),
        "decision": outcome.decision(),
        "estimates": estimates.collect::<Vec<_>>(),
        "verdicts": outcome.verdicts,
        "failures": record.failures,
        "remarks": record.remarks,
    })
}

/// What the planned fits can determine, for machines.
pub fn planned_json(planned: &[Planned]) -> Value {
    let planned =
        planned.iter().map(|planned| json!({ "estimate": planned.estimate, "planned": planned.identifiability, "accepted": planned.accepted }));
    json!({ "estimates": planned.collect::<Vec<_>>() })
}

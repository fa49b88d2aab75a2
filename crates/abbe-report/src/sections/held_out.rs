//! How well a fit predicts what was left out of it, beside how well it explains the same rows.

use abbe_core::Verdict;

use crate::chart::{Pair, pairs};
use crate::html::{figure, paragraph};
use crate::run::FitResult;

/// The validator that leaves rows out.
const PLUGIN: &str = "hold-out";

/// Labels of a chart at most.
const MOST: usize = 60;

/// A chart for every validator that held rows of the estimate out.
pub fn held_out(fit: &FitResult, verdicts: &[Verdict]) -> String {
    let of_fit = |verdict: &&Verdict| verdict.plugin == PLUGIN;
    verdicts.iter().filter(of_fit).map(|verdict| of_verdict(fit, verdict)).collect()
}

fn of_verdict(fit: &FitResult, verdict: &Verdict) -> String {
    let mut html = String::new();
    for (unit, is_angle) in [("um", false), ("urad", true)] {
        let mut column = String::new();
        let mut told: Vec<Pair> = Vec::new();
        let figures = verdict.figures.iter().filter(|figure| figure.of.as_deref() == Some(&fit.name));
        for figure in figures.filter(|figure| figure.unit == unit) {
            let named = figure.name.strip_prefix("rms[").and_then(|name| name.strip_suffix(']'));
            let Some(((name, label), value)) = named.and_then(|named| named.split_once('=')).zip(figure.value) else {
                continue;
            };
            name.clone_into(&mut column);
            told.push(Pair { name: label.to_owned(), first: value, second: explained(fit, name, label, is_angle) });
        }
        if told.is_empty() {
            continue;
        }
        let all = told.len();
        if all > MOST {
            told.sort_by(|one, other| other.first.total_cmp(&one.first));
            told.truncate(MOST);
        }
        let unit = super::unit_of(unit);
        let title = format!("Predicted rows of {} by {column}, {}", fit.name, verdict.stage);
        let some = if all > told.len() { format!(" The {} largest of {all}.", told.len()) } else { String::new() };
        let caption = format!(
            "{}: RMS by {column}. Bar: predicted by a fit without these rows; square: residuals of the whole fit. A bar that is much \
             longer than its square says that these rows tell something which the others do not.{some}",
            verdict.stage
        );
        html.push_str(&figure(&pairs(&title, &unit, &told), &caption));
    }
    let remarks = verdict.remarks.iter().filter(|remark| remark.starts_with(&format!("{}: ", fit.name)));
    if !html.is_empty() {
        remarks.for_each(|remark| html.push_str(&paragraph(remark)));
    }
    html
}

/// Root mean square of the residuals with a label; none without such rows.
fn explained(fit: &FitResult, column: &str, label: &str, is_angle: bool) -> Option<f64> {
    let index = fit.residuals.labels.iter().position(|name| name == column)?;
    let outliers = &fit.calibration.outliers;
    let rows = fit.residuals.rows.iter().filter(|row| row.is_angle == is_angle && row.labels[index] == label);
    let good = rows.filter(|row| {
        !outliers.iter().any(|outlier| (&outlier.stage, &outlier.file, outlier.row) == (&row.stage, &row.file, row.row))
    });
    let squares: Vec<f64> = good.map(|row| row.value * row.value).collect();
    (!squares.is_empty()).then(|| (squares.iter().sum::<f64>() / squares.len() as f64).sqrt())
}

//! Which sensors and how many time constants: what was tried, and how well each choice predicts runs that it has not seen.

use abbe_core::SelectionByPrediction;

use crate::chart::{Choice, choices};
use crate::html::{Cell, figure, paragraph, table};
use crate::number::short;
use crate::run::FitResult;

/// Choices of a chart at most.
const MOST: usize = 40;

/// The selection of an estimate; nothing without one.
pub fn selection(fit: &FitResult) -> String {
    fit.calibration.fit.selection_by_prediction.as_ref().map_or_else(String::new, |found| of(&fit.name, found))
}

fn of(name: &str, found: &SelectionByPrediction) -> String {
    let named = |left_out: &[String]| match left_out {
        [] => "all candidates".to_owned(),
        some => format!("without {}", some.join(", ")),
    };
    let taken = |choice: &abbe_core::PredictedStructure| choice.left_out == found.chosen.left_out;
    let all = found.tried.iter();
    let bars: Vec<Choice> =
        all.map(|tried| Choice { name: named(&tried.left_out), value: tried.error, taken: taken(tried) }).collect();
    let shown = &bars[..bars.len().min(MOST)];
    let best = found.tried.iter().map(|tried| tried.error).fold(f64::INFINITY, f64::min);
    let caption = format!(
        "{name}: each of {} was predicted from the others. Bars: what is predicted wrong (RMS, in standard uncertainties of the readings); \
         marked: the choice with the fewest unknowns that predicts worse by {:.0} % at most than the best one.",
        found.runs.join(", "),
        100.0 * found.worse
    );
    let mut html = figure(&choices(&format!("Predictions by the choices of {name}"), "RMS", shown), &caption);
    let list = |names: &[String]| if names.is_empty() { "nothing".to_owned() } else { names.join(", ") };
    html.push_str(&paragraph(&format!("Kept: {}. Left out: {}.", list(&found.kept), list(&found.left_out))));
    let rows: Vec<Vec<Cell>> = found
        .tried
        .iter()
        .map(|tried| {
            let more = 100.0 * (tried.error / best - 1.0);
            let worse = if more < 0.05 { "best".to_owned() } else { format!("+{more:.1} %") };
            let mark = if taken(tried) { "taken" } else { "" };
            vec![
                Cell::text(named(&tried.left_out)),
                Cell::figure(short(tried.error)),
                Cell::figure(worse),
                Cell::text(mark),
            ]
        })
        .collect();
    html + &table(
        &format!("Choices that {name} tried"),
        &["choice", "RMS of predictions", "beside the best", ""],
        &rows,
    )
}

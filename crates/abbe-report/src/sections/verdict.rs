//! Whether the limits are kept.

use abbe_core::{Decision, Figure, Verdict};

use super::{micrometres, unit_of, valued};
use crate::analysis::main_fit;
use crate::html::{Cell, details, escape, list, paragraph, table};
use crate::number::{beside_limit, with_uncertainty};
use crate::run::Run;

/// The decision of a run in a word, its class, and a sentence.
pub fn decided(run: &Run) -> (&'static str, &'static str, String) {
    let judged: Vec<(&Verdict, &Figure)> = judged(run).collect();
    let of = |decision| judged.iter().filter(|(_, figure)| figure.decision == Some(decision)).count();
    let (failed, untold, all) = (of(Decision::Fail), of(Decision::Inconclusive), judged.len());
    let failures = run.record.as_ref().map_or(0, |record| record.failures.len());
    let limits = |count: usize| if count == 1 { "1 limit".to_owned() } else { format!("{count} limits") };
    let are = |count: usize| if count == 1 { "is" } else { "are" };
    match (failures, failed, untold, all) {
        (1.., ..) => {
            let stages = if failures == 1 { "1 stage".to_owned() } else { format!("{failures} stages") };
            ("Failed", "fail", format!("{stages} of the recipe came to no result. What is below is not complete."))
        }
        (_, 1.., _, _) => ("Fail", "fail", format!("{} of {} {} broken.", failed, limits(all), are(failed))),
        (_, _, 1.., _) => {
            ("Inconclusive", "unsure", format!("Of {}, {untold} cannot be decided; none is broken.", limits(all)))
        }
        (.., 0) if run.fits.is_empty() && run.verdicts.is_empty() => {
            let text = "The recipe has no estimate and no validator: its data were read, and nothing was made of them.";
            ("No estimate", "none", text.to_owned())
        }
        (.., 0) => {
            let text = "The recipe sets no limit, so nothing says whether this is good enough. Set limits in a validator: \
                        `limits: { max_um: 10 }`.";
            ("No limit set", "none", text.to_owned())
        }
        _ => {
            let kept = match all {
                1 => "The only limit is kept.".to_owned(),
                2 => "Both limits are kept.".to_owned(),
                all => format!("All {all} limits are kept."),
            };
            match judged.iter().all(|(verdict, _)| is_of_the_fit(verdict)) {
                true => ("Machine not judged", "none", of_the_fit(run)),
                false => ("Pass", "pass", kept),
            }
        }
    }
}

/// Validators whose limits say how well a model explains readings, and nothing about how good the machine is.
const OF_THE_FIT: [&str; 4] = ["residuals", "hold-out", "compare", "influence"];

/// Whether a verdict judges a fit alone.
pub fn is_of_the_fit(verdict: &Verdict) -> bool {
    OF_THE_FIT.contains(&verdict.plugin.as_str())
}

/// What such limits leave open, and how large the errors of the machine are.
fn of_the_fit(run: &Run) -> String {
    let found = main_fit(run).and_then(|fit| fit.analysis().ok().flatten());
    let open = "The limits, which are kept, judge how well the model explains the readings; none judges the machine.";
    match found {
        None => open.to_owned(),
        Some(found) => {
            let first = found.causes.first().filter(|cause| cause.part.loss.value > 2.0 * cause.part.loss.uncertainty);
            let cause =
                first.map_or(String::new(), |cause| format!(", first of all {}: {}", cause.name, cause.meaning));
            format!("{open} Its RMS volumetric error is {}{cause}.", micrometres(found.rms))
        }
    }
}

/// How much of the main estimate the data leave open, as a sentence; empty if nothing.
pub fn undetermined(run: &Run) -> String {
    match main_fit(run).map_or(0, |fit| fit.calibration.fit.null_space.len()) {
        0 => String::new(),
        1 => " But the data leave one combination of parameters undetermined: its values are one choice of many."
            .to_owned(),
        count => format!(
            " But the data leave {count} combinations of parameters undetermined: their values are one choice of many."
        ),
    }
}

/// The figures with a limit, the worst first.
pub fn judged(run: &Run) -> impl Iterator<Item = (&Verdict, &Figure)> {
    let all = run.verdicts.iter().flat_map(|verdict| verdict.figures.iter().map(move |figure| (verdict, figure)));
    let mut all: Vec<(&Verdict, &Figure)> = all.filter(|(_, figure)| figure.decision.is_some()).collect();
    all.sort_by(|(_, one), (_, other)| {
        (other.decision, used(other)).partial_cmp(&(one.decision, used(one))).unwrap_or(std::cmp::Ordering::Equal)
    });
    all.into_iter()
}

/// Remarks of verdicts with limits that judge more than a fit.
pub fn judged_remarks(run: &Run) -> impl Iterator<Item = (&Verdict, &[String])> {
    let judges = |verdict: &&Verdict| {
        let has_limits = verdict.figures.iter().any(|figure| figure.decision.is_some());
        has_limits && !is_of_the_fit(verdict)
    };
    run.verdicts.iter().filter(judges).map(|verdict| (verdict, verdict.remarks.as_slice()))
}

/// Remarks of a verdict that are shown at once.
const REMARKS: usize = 4;

/// The part of its limit that a figure uses.
pub fn used(figure: &Figure) -> f64 {
    match (figure.value, figure.limit) {
        (Some(value), Some(limit)) if limit > 0.0 => value.abs() / limit,
        (Some(value), Some(limit)) if value <= limit => 0.0,
        _ => f64::INFINITY,
    }
}

/// Most figures with limits that are shown; all stand in `verdicts.json`.
const MOST: usize = 200;

/// Figures that are shown at once.
const FIRST: usize = 5;

/// The section.
pub fn verdict(run: &Run) -> String {
    let (word, class, sentence) = decided(run);
    let mark = match class {
        "pass" => "✓",
        "fail" => "✗",
        _ => "?",
    };
    let sentence = sentence + &undetermined(run);
    let mut html = format!("<p class=\"verdict {class}\"><span aria-hidden=\"true\">{mark}</span> {word}</p>\n");
    html.push_str(&paragraph(&sentence));
    if let Some(record) = &run.record {
        let failures = record.failures.iter().map(|failure| {
            let place = match (&failure.file, failure.line) {
                (Some(file), Some(line)) => format!(" ({file}:{line})"),
                (Some(file), None) => format!(" ({file})"),
                _ => String::new(),
            };
            let help = failure.help.as_ref().map_or(String::new(), |help| format!(" To do: {help}."));
            format!("{} {}: {}{place}.{help}", failure.kind.key(), failure.stage, failure.message)
        });
        html.push_str(&list(&failures.collect::<Vec<_>>()));
    }
    let all: Vec<(&Verdict, &Figure)> = judged(run).collect();
    if all.is_empty() {
        return html;
    }
    // All that does not pass, and the next ones.
    let open = all.iter().filter(|(_, figure)| figure.decision != Some(Decision::Pass)).count().max(FIRST);
    let rows = |figures: &[(&Verdict, &Figure)]| -> Vec<Vec<Cell>> {
        figures.iter().map(|(verdict, figure)| row(verdict, figure)).collect()
    };
    let head = ["figure", "of", "value", "limit", "used", "part of the limit", "decision"];
    let caption = "Figures with limits, the worst first; ± is the expanded uncertainty, k = 2";
    let shown = &all[..all.len().min(MOST)];
    let (first, others) = shown.split_at(open.min(shown.len()));
    html.push_str(&table(caption, &head, &rows(first)));
    if !others.is_empty() {
        html.push_str(&details(
            &format!("{} more, all kept", others.len()),
            false,
            &table(caption, &head, &rows(others)),
        ));
    }
    let said = judged_remarks(run).flat_map(|(verdict, remarks)| {
        remarks.iter().take(REMARKS).map(|remark| format!("{}: {remark}", verdict.stage))
    });
    html.push_str(&list(&said.collect::<Vec<_>>()));
    html.push_str(&paragraph(
        "A verdict is as wide as its limits: an error of the machine counts in it only where one of these figures shows it.",
    ));
    if all.len() > MOST {
        html.push_str(&paragraph(&format!("{} more stand in verdicts.json.", all.len() - MOST)));
    }
    html
}

/// Value and limit of a figure with their units; a value with its expanded uncertainty, k = 2, by two digits of which it is rounded.
pub fn told_figure(figure: &Figure) -> (String, String) {
    let value = match (figure.value, figure.standard_uncertainty) {
        (None, _) => "could not be computed".to_owned(),
        (Some(value), Some(uncertainty)) if uncertainty > 0.0 => {
            let text = match figure.limit {
                Some(limit) => beside_limit(value, 2.0 * uncertainty, limit),
                None => with_uncertainty(value, 2.0 * uncertainty),
            };
            if figure.unit == "1" { text } else { format!("{text} {}", unit_of(&figure.unit)) }
        }
        (Some(value), _) => valued(value, &figure.unit),
    };
    (value, figure.limit.map_or(String::new(), |limit| valued(limit, &figure.unit)))
}

fn row(verdict: &Verdict, figure: &Figure) -> Vec<Cell> {
    let (value, limit) = told_figure(figure);
    let part = used(figure);
    let (class, word) = match figure.decision {
        Some(Decision::Fail) => ("fail", "✗ fail".to_owned()),
        Some(Decision::Inconclusive) => (
            "unsure",
            format!("? inconclusive{}", figure.inconclusive.as_ref().map_or(String::new(), |why| format!(": {why}"))),
        ),
        _ if is_of_the_fit(verdict) => ("", "kept, by the fit".to_owned()),
        _ => ("pass", "✓ pass".to_owned()),
    };
    let percent = if part.is_finite() { format!("{:.0} %", part * 100.0) } else { "–".to_owned() };
    vec![
        Cell::text(format!("{} {}", verdict.stage, figure.name)),
        Cell::text(figure.of.clone().unwrap_or_default()),
        Cell::figure(value),
        Cell::figure(limit),
        Cell::figure(percent),
        Cell::Html(gauge(part, class)),
        Cell::Html(format!("<span class=\"{class}\">{}</span>", escape(&word))),
    ]
}

/// A bar up to a limit, which stands at two thirds.
fn gauge(part: f64, class: &str) -> String {
    let width = (part * 80.0).clamp(0.0, 120.0);
    format!(
        "<svg viewBox=\"0 0 120 12\" width=\"120\" height=\"12\" aria-hidden=\"true\"><rect class=\"gauge {class}\" x=\"0\" y=\"2\" \
         width=\"{width:.1}\" height=\"8\"/><path class=\"z\" d=\"M80 0V12\"/></svg>"
    )
}

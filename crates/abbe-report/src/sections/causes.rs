//! The worst figure, the errors behind it, and what correcting them would gain.

use abbe_core::FitReport;

use super::micrometres;
use super::verdict::{is_of_the_fit, judged, told_figure, used};
use crate::analysis::{Analysis, NamedCause, main_fit};
use crate::html::{Cell, details, escape, paragraph, table};
use crate::number::short;
use crate::run::Run;

/// Causes that are shown at once.
const FIRST: usize = 3;

/// Part of the whole from which an error is large by itself.
const HIDDEN: f64 = 0.5;

/// The section: worst figure and causes.
pub fn causes(run: &Run) -> String {
    let mut html = "<h3>The worst figure</h3>\n".to_owned();
    if let Some((verdict, figure)) = judged(run).find(|(verdict, _)| !is_of_the_fit(verdict)) {
        let (value, _) = told_figure(figure);
        let uncertainty = match figure.standard_uncertainty {
            Some(_) => " (k = 2)",
            None => "; its uncertainty is not known",
        };
        let part = used(figure);
        let percent = if part.is_finite() { format!(", {:.0} % of its limit", part * 100.0) } else { String::new() };
        let of = figure.of.as_ref().map_or(String::new(), |of| format!(" of {of}"));
        html.push_str(&paragraph(&format!("{} {}{of}: {value}{uncertainty}{percent}.", verdict.stage, figure.name)));
    }
    let Some(fit) = main_fit(run) else { return if html.ends_with("</h3>\n") { String::new() } else { html } };
    match fit.analysis() {
        Ok(Some(found)) => html + &told(&fit.name, found, &fit.calibration.fit),
        Ok(None) => {
            html + &paragraph(&format!(
                "{} has no errors of axes in a known travel, so there is no volumetric error and no share of causes; its values stand \
                 below.",
                fit.name
            ))
        }
        Err(error) => html + &paragraph(&format!("The volumetric error of {} cannot be computed: {error}.", fit.name)),
    }
}

fn told(fit: &str, found: &Analysis, report: &FitReport) -> String {
    let (residual_rms_um, is_open) = (report.residual_rms_um, !report.null_space.is_empty());
    let mut html = format!(
        "<p>Largest volumetric error by <b>{}</b>: <b>{}</b> at {}. Root mean square {} (k = 2) over {} poses in {}.</p>\n",
        escape(fit),
        escape(&micrometres(found.largest)),
        escape(&found.at),
        escape(&micrometres(found.rms)),
        found.poses,
        escape(&found.travel)
    );
    html.push_str("<h3>The largest causes</h3>\n");
    let some = found.causes.iter().filter(|cause| cause.part.alone > 0.0);
    let (first, more): (Vec<_>, Vec<_>) =
        some.enumerate().partition(|(index, cause)| *index < FIRST && cause.part.loss.value > 0.0);
    let cells = |(_, cause): &(usize, &NamedCause)| row(cause, found);
    let head = ["error", "what it is", "value", "RMS by it alone", "loss of RMS", "part of the RMS", "what to do"];
    if first.is_empty() {
        return html + &paragraph("No error alone makes the volumetric error larger.");
    }
    let caption = "If this error alone were zero, the RMS volumetric error would fall by this much; ± is k = 2";
    html.push_str(&table(caption, &head, &first.iter().map(cells).collect::<Vec<_>>()));
    html.push_str(&paragraph(
        "These losses need not add up: errors can hide or strengthen each other. They are those of the estimated values.",
    ));
    let hidden = more.iter().map(|(_, cause)| *cause).filter(|cause| cause.part.alone > HIDDEN * found.rms.value);
    let hidden: Vec<String> = hidden
        .map(|cause| format!("{} ({}, {} µm)", cause.name, cause.meaning, short(cause.part.alone * 1e3)))
        .collect();
    if !hidden.is_empty() {
        html.push_str(&paragraph(&format!(
            "Large by themselves, but partly hidden by other errors here: {}. Correct these together, not one alone.",
            hidden.join("; ")
        )));
    }
    if first.iter().chain(&more).any(|(_, cause)| cause.is_confounded) {
        html.push_str(&paragraph("? The data cannot tell this error from others; its share may belong to them."));
    }
    if !more.is_empty() {
        let body = table(caption, &head, &more.iter().map(cells).collect::<Vec<_>>());
        html.push_str(&details(
            &format!("{} smaller causes, and errors that hide others (negative loss)", more.len()),
            false,
            &body,
        ));
    }
    html.push_str("<h3>What a correction would gain</h3>\n");
    let three = found.without_three.map_or(String::new(), |left| {
        let left = left.hypot(found.unknown);
        format!(
            " With the three largest causes corrected about {} µm would stay, this uncertainty included.",
            short(left * 1e3)
        )
    });
    if found.unknown >= found.rms.value {
        return html
            + &paragraph(&format!(
                "The RMS volumetric error is {} µm, and the standard uncertainty of the calibration {} µm: a correction would gain \
                 nothing that is known.",
                short(found.rms.value * 1e3),
                short(found.unknown * 1e3)
            ));
    }
    html.push_str(&paragraph(&format!(
        "The RMS volumetric error is {} µm now. If everything that was estimated were corrected, at least {} µm would stay: the \
         standard uncertainty of the calibration.{three} What the model does not describe comes on top; the residuals have an RMS of {} µm.",
        short(found.rms.value * 1e3),
        short(found.unknown * 1e3),
        short(residual_rms_um)
    )));
    if is_open {
        html.push_str(&paragraph(
            "What the data cannot tell (below) is in none of these figures: it can be as large as you like. Measure it first.",
        ));
    }
    html
}

fn row(cause: &NamedCause, found: &Analysis) -> Vec<Cell> {
    let mark = if cause.is_confounded { " ?" } else { "" };
    let part = (cause.part.loss.value / found.rms.value.max(f64::MIN_POSITIVE)).clamp(0.0, 1.0);
    let bar = format!(
        "<svg viewBox=\"0 0 120 12\" width=\"120\" height=\"12\" aria-hidden=\"true\"><rect class=\"gauge\" x=\"0\" y=\"2\" width=\"{:.1}\" \
         height=\"8\"/></svg>",
        120.0 * part
    );
    let loss = format!("{}{}", micrometres(cause.part.loss), if cause.is_proven() { "" } else { " (not proven)" });
    vec![
        Cell::text(format!("{}{mark}", cause.name)),
        Cell::text(&cause.meaning),
        Cell::figure(&cause.value),
        Cell::figure(format!("{} µm", short(cause.part.alone * 1e3))),
        Cell::figure(loss),
        Cell::Html(bar),
        Cell::text(cause.advice(found.rms.value)),
    ]
}

/// A run in the table of several: name, verdict, estimate, RMS volumetric error, largest, largest cause.
pub fn compared_cells(run: &Run) -> [String; 6] {
    let (word, _, _) = super::verdict::decided(run);
    let analysis = main_fit(run).and_then(|fit| Some((fit, fit.analysis().ok().flatten()?)));
    let [fit, rms, largest, cause] = match &analysis {
        Some((fit, found)) => {
            let cause =
                found.causes.first().map_or(String::new(), |cause| format!("{}: {}", cause.name, cause.meaning));
            [fit.name.clone(), micrometres(found.rms), micrometres(found.largest), cause]
        }
        None => [(); 4].map(|()| String::new()),
    };
    [run.name.clone(), word.to_owned(), fit, rms, largest, cause]
}

/// Several runs beside each other: before and after.
pub fn compared(runs: &[Run]) -> String {
    let rows = runs.iter().map(|run| {
        let (word, class, _) = super::verdict::decided(run);
        let decision = Cell::Html(format!("<span class=\"{class}\">{word}</span>"));
        let [name, _, fit, rms, largest, cause] = compared_cells(run);
        vec![Cell::text(name), decision, Cell::text(fit), Cell::figure(rms), Cell::figure(largest), Cell::text(cause)]
    });
    let head = ["run", "verdict", "estimate", "RMS volumetric error", "largest", "largest cause"];
    table("The runs beside each other; ± is k = 2", &head, &rows.collect::<Vec<_>>())
        + &paragraph("Each run has its own travel: errors of different travels cannot be compared by size.")
}

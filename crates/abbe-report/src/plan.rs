//! The page about a plan of measurements: what is measured, in which order, and how well that determines the unknowns.

use abbe_engine::{Measurements, Order, PlanFigures, Revisit};

use crate::chart::{Span, sequence};
use crate::html::{Cell, figure, list, paragraph, table};
use crate::number::short;
use crate::page::whole;

/// A page about a plan; `name` is that of its recipe.
pub fn plan_page(name: &str, measurements: &Measurements) -> String {
    let title = format!("{name}: plan for {}", measurements.estimate);
    let mut parts: Vec<(String, String, String)> =
        vec![("chosen".to_owned(), "Chosen".to_owned(), chosen(measurements))];
    if let Some(order) = &measurements.plan.order {
        parts.push(("order".to_owned(), "In this order".to_owned(), ordered(order)));
        if !order.revisits.is_empty() {
            let html = order.revisits.iter().map(again).collect();
            parts.push(("again".to_owned(), "When to go back to references".to_owned(), html));
        }
    }
    parts.push(("unknowns".to_owned(), "Expected uncertainties".to_owned(), unknowns(measurements)));
    whole(&title, &[&measurements.estimate], &parts)
}

/// A figure of a plan: name and text.
type Figure = (&'static str, fn(&PlanFigures) -> String);

fn chosen(measurements: &Measurements) -> String {
    let plan = &measurements.plan;
    let number: usize = plan.chosen.iter().map(|chosen| chosen.times).sum();
    let labels: Vec<String> =
        (plan.chosen.iter())
            .map(|chosen| {
                if chosen.times > 1 {
                    format!("{} ({} times)", chosen.label, chosen.times)
                } else {
                    chosen.label.clone()
                }
            })
            .collect();
    let mut html = paragraph(&format!("{number} of {} candidates: {}.", plan.candidates, labels.join(", ")));
    let evenly = |value: fn(&PlanFigures) -> String| {
        plan.spread_evenly.as_ref().map_or_else(|| "not determined".to_owned(), value)
    };
    let figures: [Figure; 3] = [
        ("equations", |figures| figures.equations.to_string()),
        ("log determinant", |figures| short(figures.log_determinant)),
        ("condition", |figures| short(figures.condition)),
    ];
    let rows: Vec<Vec<Cell>> = (figures.into_iter())
        .map(|(name, value)| vec![Cell::text(name), Cell::figure(value(&plan.figures)), Cell::figure(evenly(value))])
        .collect();
    html.push_str(&table("Figures of the choice", &["", "plan", "spread evenly"], &rows));
    let lost: Vec<String> = measurements.identifiability.null_space.iter().map(|lost| lost.advise()).collect();
    if !lost.is_empty() {
        html.push_str(&paragraph("Not determined:"));
        html.push_str(&list(&lost));
    }
    html
}

/// Candidates with lines of their own in the chart at most.
const LINES: usize = 60;

fn ordered(order: &Order) -> String {
    let ends = order.sequence.iter().skip(1).map(|(_, from)| *from).chain([order.end]);
    let minutes = |time: f64| time / 60.0;
    let mut times: Vec<(&str, usize)> = Vec::new();
    for (label, _) in &order.sequence {
        match times.iter_mut().find(|(known, _)| known == label) {
            Some((_, count)) => *count += 1,
            None => times.push((label, 1)),
        }
    }
    let again: Vec<String> =
        times.iter().filter(|(_, count)| *count > 1).map(|(label, _)| (*label).to_owned()).collect();
    let many = times.len() > LINES;
    let spans: Vec<Span> = order
        .sequence
        .iter()
        .zip(ends)
        .map(|((label, from), to)| {
            let name = if many && !again.contains(label) { "others".to_owned() } else { label.clone() };
            Span { name, times: [minutes(*from), minutes(to)] }
        })
        .collect();
    let listed = match &order.as_listed {
        Some(listed) => format!(
            "In the order of the list {:.2} times as many measurements would be as good",
            1.0 / order.figures.efficiency_of(listed)
        ),
        None => "In the order of the list not all unknowns are determined".to_owned(),
    };
    let caption = format!(
        "When each candidate is measured, with what is measured again above. {listed}, in a random order (median) {:.2} times as many.",
        1.0 / order.random_efficiency
    );
    let rows: Vec<Vec<Cell>> = (order.sequence.iter().enumerate())
        .map(|(place, (label, from))| {
            vec![Cell::figure((place + 1).to_string()), Cell::text(label), Cell::figure(format!("{from:.0}"))]
        })
        .collect();
    figure(&sequence("Order of the measurements", "min", (&spans, minutes(order.end)), &again), &caption)
        + &crate::html::details("All times", false, &table("Order", &["", "candidate", "begins at s"], &rows))
}

fn again(revisit: &Revisit) -> String {
    let spans: Vec<Span> = (revisit.times.iter())
        .map(|time| Span {
            name: revisit.reference.clone(),
            times: [*time, time + revisit.row].map(|time| time / 60.0),
        })
        .collect();
    let moved = short(revisit.largest * 1e3);
    let until = revisit.until / 60.0;
    let caption = match revisit.shortest() {
        None => format!(
            "{}, measured at the beginning, need not be measured again until {until:.0} min: what has moved since is known to {moved} µm \
             (standard uncertainty).",
            revisit.reference
        ),
        Some(shortest) => format!(
            "{} is measured again after {:.1} min ({:.0} rows) at the latest, {} times until {until:.0} min: what has moved since is known to \
             {moved} µm (standard uncertainty).",
            revisit.reference,
            shortest / 60.0,
            (shortest / revisit.row).floor(),
            revisit.times.len()
        ),
    };
    let title = format!("When {} is measured again", revisit.reference);
    figure(&sequence(&title, "min", (&spans, until), std::slice::from_ref(&revisit.reference)), &caption)
}

fn unknowns(measurements: &Measurements) -> String {
    let all = measurements.plan.problem.unknowns.iter().zip(measurements.standard_uncertainties());
    let rows: Vec<Vec<Cell>> = all
        .map(|(unknown, uncertainty)| {
            let (symbol, factor) = unknown.unit.for_people();
            vec![Cell::text(&unknown.name), Cell::figure(short(uncertainty * factor)), Cell::text(symbol)]
        })
        .collect();
    table("Expected standard uncertainties", &["unknown", "u", ""], &rows)
}

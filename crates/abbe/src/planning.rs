//! A plan of measurements, as text and as JSON.

use std::fmt::Write as _;
use std::path::Path;

use abbe_core::WeakDirection;
use abbe_engine::{Control, LargestOfInput, Measurements, Order, Plan, Reached, Revisit};

use crate::table;
use abbe_report::number::short;

/// Chosen candidates in a line.
const IN_A_LINE: usize = 12;

/// The control of that name.
pub fn control(name: &str) -> Result<Control, String> {
    let known = || Control::ALL.iter().map(|(known, _)| *known).collect::<Vec<_>>().join(", ");
    let found = Control::ALL.iter().find(|(known, _)| *known == name);
    found.map(|(_, control)| *control).ok_or_else(|| format!("one of {} was expected", known()))
}

/// What is printed of a plan: JSON, or text for a terminal.
pub fn shown(name: &str, measurements: Measurements, out: Option<&Path>, json: bool) -> String {
    if json { measurements.record } else { text(name, &measurements, out) }
}

/// The plan for a terminal.
fn text(name: &str, measurements: &Measurements, out: Option<&Path>) -> String {
    let plan = &measurements.plan;
    let number: usize = plan.chosen.iter().map(|chosen| chosen.times).sum();
    let mut text =
        format!("{name}: measurements for {}\n\nChosen: {number} of {}\n", measurements.estimate, plan.candidates);
    let labels = plan.chosen.iter().map(|chosen| match chosen.times {
        1 => chosen.label.clone(),
        times => format!("{} ({times} times)", chosen.label),
    });
    for line in labels.collect::<Vec<_>>().chunks(IN_A_LINE) {
        text.push_str(&format!("  {}\n", line.join(", ")));
    }
    if let Some(reached) = &plan.reached {
        let _ = writeln!(text, "\n{}", wanted(reached, plan.repeats));
    }
    if let Some(seconds) = measurements.seconds {
        let _ = writeln!(text, "\n{}", program(plan, seconds));
    }
    let mut rows = vec![["", "plan", "spread evenly"].map(str::to_owned).to_vec()];
    let evenly = |value: fn(&abbe_engine::PlanFigures) -> f64| {
        plan.spread_evenly.as_ref().map_or_else(|| "not determined".to_owned(), |figures| short(value(figures)))
    };
    for (label, value) in FIGURES {
        rows.push(vec![label.to_owned(), short(value(&plan.figures)), evenly(value)]);
    }
    text.push_str(&format!("\n{}", table::text(&rows, &[1, 2])));
    if let Some(even) = &plan.spread_evenly {
        let part = plan.figures.efficiency_of(even);
        text.push_str(&format!("\nSpread evenly {:.2} times as many would be as good\n", 1.0 / part));
    }
    if let Some(part) = plan.random_efficiency {
        text.push_str(&format!("At random (median) {:.2} times as many\n", 1.0 / part));
    }
    if let Some(order) = &plan.order {
        text.push_str(&ordered(order));
    }
    let mut rows = vec![["", "", "expected u"].map(str::to_owned).to_vec()];
    for (unknown, uncertainty) in plan.problem.unknowns.iter().zip(measurements.standard_uncertainties()) {
        let (symbol, factor) = unknown.unit.for_people();
        rows.push(vec![unknown.name.clone(), symbol, short(uncertainty * factor)]);
    }
    text.push_str(&format!("\n{}", table::text(&rows, &[2])));
    let lost: Vec<String> = measurements.identifiability.null_space.iter().map(WeakDirection::advise).collect();
    if !lost.is_empty() {
        text.push_str("\nNot determined\n");
        lost.iter().for_each(|lost| text.push_str(&format!("  {lost}\n")));
    }
    if let Some(out) = out {
        let files = measurements.files.keys().map(|file| file.display().to_string()).collect::<Vec<_>>().join(", ");
        text.push_str(&format!("\nWritten: {} ({files})\n", out.display()));
    }
    text
}

/// What was wanted, what is reached, and how good a row has to be.
fn wanted(reached: &Reached, repeats: usize) -> String {
    let (unit, factor) = if reached.is_angle { ("µrad", 1e6) } else { ("µm", 1e3) };
    let people = |value: f64| format!("{} {unit}", short(value * factor));
    let mut text = format!(
        "Worst is {}: expanded uncertainty {} (factor {}); wanted {}.",
        reached.worst,
        people(reached.expanded),
        short(reached.coverage_factor),
        people(reached.wanted)
    );
    if let Some(largest) = reached.largest_of_row {
        let what = if repeats > 1 { format!("The mean of {repeats} touches") } else { "A row".to_owned() };
        text.push_str(&format!(" {what} may have a standard uncertainty of up to {} µm.", short(largest * 1e3)));
    }
    reached.largest_of_inputs.iter().for_each(|input| text.push_str(&format!("\n{}", how_good(input))));
    text
}

/// How good artefact and probe have to be.
fn how_good(input: &LargestOfInput) -> String {
    let LargestOfInput { name, stated, is_length, part } = input;
    let Some(part) = part else {
        return format!("{name}: no calibration is good enough, the rest alone leaves more than is wanted.");
    };
    match (stated, is_length) {
        (Some(stated), true) => format!(
            "{name} may have a standard uncertainty of up to {} µm ({} stated).",
            short(stated * part * 1e3),
            short(stated * 1e3)
        ),
        (Some(stated), false) => {
            format!("{name} may have a standard uncertainty of up to {:.4e} ({stated:.4e} stated).", stated * part)
        }
        (None, _) => format!("The standard uncertainties of {name} may be up to {} times those stated.", short(*part)),
    }
}

/// What the measuring program takes, and what repeats make of a touch.
fn program(plan: &Plan, seconds: f64) -> String {
    let mut text = format!("The moves of the measuring program take {:.1} minutes.", seconds / 60.0);
    if plan.repeats > 1 {
        let _ = write!(text, " Each touch is made {} times.", plan.repeats);
    }
    if let Some(of_mean) = plan.of_mean {
        let _ = write!(
            text,
            " Their mean has a standard uncertainty of {} µm: write it in the recipe, with `repeats: average` where the log is read.",
            short(of_mean * 1e3)
        );
    }
    text
}

/// The order of the measurements.
fn ordered(order: &Order) -> String {
    let mut text = "\nIn this order, candidate at seconds\n".to_owned();
    let each = order.sequence.iter().map(|(label, from)| format!("{label} at {from:.0}"));
    for line in each.collect::<Vec<_>>().chunks(IN_A_LINE) {
        text.push_str(&format!("  {}\n", line.join(", ")));
    }
    match &order.as_listed {
        Some(listed) => {
            let part = 1.0 / order.figures.efficiency_of(listed);
            text.push_str(&format!("In the order of the list {part:.2} times as many would be as good\n"));
        }
        None => text.push_str("In the order of the list not all unknowns are determined\n"),
    }
    text.push_str(&format!("In a random order (median) {:.2} times as many\n", 1.0 / order.random_efficiency));
    order.revisits.iter().for_each(|revisit| text.push_str(&again(revisit)));
    text
}

/// When a reference is measured again.
fn again(revisit: &Revisit) -> String {
    let (reference, until) = (&revisit.reference, revisit.until);
    let moved = format!("what has moved since is known to {} µm (standard uncertainty)", short(revisit.largest * 1e3));
    let Some(shortest) = revisit.shortest() else {
        return format!(
            "\nMeasured at the beginning, {reference} need not be measured again until {until:.0} s: {moved}\n"
        );
    };
    let after =
        if shortest < 120.0 { format!("{shortest:.0} s") } else { format!("{:.0} minutes", (shortest / 60.0).floor()) };
    let rows = (shortest / revisit.row).floor();
    let mut text = format!(
        "\nMeasure {reference} again after {after} ({rows:.0} rows) at the latest: {moved}. Until {until:.0} s at seconds\n"
    );
    let times: Vec<String> = revisit.times.iter().map(|time| format!("{time:.0}")).collect();
    times.chunks(IN_A_LINE).for_each(|line| text.push_str(&format!("  {}\n", line.join(", "))));
    text
}

type Figure = (&'static str, fn(&abbe_engine::PlanFigures) -> f64);

const FIGURES: [Figure; 5] = [
    ("equations", |figures| figures.equations as f64),
    ("log determinant", |figures| figures.log_determinant),
    ("condition", |figures| figures.condition),
    ("mean variance of a response", |figures| figures.response_variance[0]),
    ("largest variance of a response", |figures| figures.response_variance[1]),
];

//! A history: what happened, the charts of all parameters, when to measure again.

use abbe_core::Unit;
use abbe_trend::{Again, Analysis, Change, ParameterTrend, Quality, State, rounded};

use crate::chart::{Control, control};
use crate::html::{Cell, details, escape, figure, paragraph, table};
use crate::number::{short, with_uncertainty};

/// The section; `remarks` are what the validator said, `quality` tells how good each test is.
pub fn trend(analysis: &Analysis, quality: &[Quality], remarks: &[String]) -> String {
    let tests = analysis.tests.len();
    let rejected = analysis.tests.iter().filter(|test| !test.good).count();
    let mut html = paragraph(&format!("{tests} tests, {rejected} rejected, {} missing.", analysis.missing.len()));
    let items: String = remarks.iter().map(|remark| format!("<li>{}</li>\n", escape(remark))).collect();
    if !items.is_empty() {
        html.push_str(&format!("<ul>\n{items}</ul>\n"));
    }
    let rows: Vec<Vec<Cell>> =
        analysis.parameters.iter().filter_map(|parameter| again_row(parameter, analysis)).collect();
    if !rows.is_empty() {
        let head = ["parameter", "now", "change", "limit", "measure again after"];
        html.push_str(&table("When to measure again; ± is the standard uncertainty", &head, &rows));
    }
    let (quiet, told): (Vec<&ParameterTrend>, Vec<&ParameterTrend>) =
        analysis.parameters.iter().partition(|parameter| parameter.state == State::InControl);
    let charts = |parameters: &[&ParameterTrend]| -> String {
        let all: String = parameters.iter().map(|parameter| chart(parameter, analysis)).collect();
        figure(
            &format!("<div class=\"curves\">\n{all}</div>\n"),
            "Dots: deviation from the target over its standard uncertainty; line: moving average; broken lines: their limits; rings: \
             alarms; ×: no test, or one that does not count.",
        )
    };
    if !told.is_empty() {
        html.push_str(&charts(&told));
    }
    if !quiet.is_empty() {
        html.push_str(&details(&format!("{} in control", quiet.len()), told.is_empty(), &charts(&quiet)));
    }
    html + &tests_table(quality)
}

/// Every test: whether it counts, and why not.
fn tests_table(quality: &[Quality]) -> String {
    let row = |test: &Quality| {
        let (rank, condition) = (test.rank.to_string(), short(test.condition));
        let probability = if test.probability < 1e-16 { "below 1e-16".to_owned() } else { short(test.probability) };
        vec![
            Cell::text(&test.label),
            Cell::text(if test.good { "counts" } else { "rejected" }),
            Cell::figure(test.equations.to_string()),
            Cell::figure(rank),
            Cell::figure(condition),
            Cell::figure(format!("{} of {}", short(test.chi_squared), test.degrees_of_freedom)),
            Cell::figure(probability),
        ]
    };
    let rows: Vec<Vec<Cell>> = quality.iter().map(row).collect();
    if rows.is_empty() {
        return String::new();
    }
    let head = ["test", "", "equations", "rank", "condition", "chi-squared", "probability"];
    let caption =
        "How good each test is: its chi-squared with the degrees of freedom, and the probability of as much by chance";
    details(&format!("All {} tests", rows.len()), false, &table(caption, &head, &rows))
}

fn chart(parameter: &ParameterTrend, analysis: &Analysis) -> String {
    let charts = &parameter.charts;
    let point = |(place, test): (usize, &usize)| {
        let alarm = charts.alarms[place].of_value() > 0;
        (analysis.tests[*test].at, charts.normalised[place], charts.average[place], alarm)
    };
    let bad = analysis.tests.iter().filter(|test| !test.good).map(|test| test.at);
    let missing = analysis.missing.iter().filter_map(|label| label.parse().ok());
    control(&Control {
        name: parameter.name.clone(),
        state: state(parameter, analysis),
        time: analysis.time_unit.clone(),
        points: parameter.tests.iter().enumerate().map(point).collect(),
        limits: [analysis.limits.individuals, analysis.limits.average],
        absent: bad.chain(missing).collect(),
    })
}

fn state(parameter: &ParameterTrend, analysis: &Analysis) -> String {
    let unit = &analysis.time_unit;
    match (parameter.state, parameter.change) {
        (_, Change::Step { first, .. }) => format!("step in {unit} {}", analysis.tests[first].label),
        (_, Change::Line { .. }) => "drift".to_owned(),
        (_, Change::Exponential { .. }) => "settling".to_owned(),
        (_, Change::Regressor { .. }) => "follows an undeclared regressor".to_owned(),
        (State::Seasonal, _) => {
            let name = parameter.seasonal.as_ref().map_or("a regressor", |seasonal| seasonal.regressor.as_str());
            format!("in control, after its line in {name}")
        }
        (State::Unconfirmed, _) => "an unconfirmed alarm".to_owned(),
        (State::Alarm, _) => "in alarm".to_owned(),
        _ => "in control".to_owned(),
    }
}

fn again_row(parameter: &ParameterTrend, analysis: &Analysis) -> Option<Vec<Cell>> {
    let Again { rule, value, rate, after, now, .. } = parameter.again?;
    let (unit, factor) = parameter.unit.parse::<Unit>().map_or((parameter.unit.clone(), 1.0), Unit::for_people);
    let time = &analysis.time_unit;
    let told =
        |value: abbe_trend::Uncertain| with_uncertainty(value.value * factor, value.standard_uncertainty * factor);
    let after = match (now, after) {
        (true, _) => "at once".to_owned(),
        (_, Some(after)) => format!("{after} {time}s"),
        (_, None) => "no end in sight".to_owned(),
    };
    Some(vec![
        Cell::text(format!("{} {unit}", parameter.name)),
        Cell::figure(told(value)),
        Cell::figure(format!("{} per {time}", told(rate))),
        Cell::figure(format!("{} at {} % risk", rounded(rule.limit * factor), 100.0 * rule.risk)),
        Cell::figure(after),
    ])
}

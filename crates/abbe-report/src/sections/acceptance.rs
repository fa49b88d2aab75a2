//! The charts of acceptance tests: deviations at the targets of an axis, and circles with their figures and what makes them.

use abbe_core::{Error, Result};

use super::unit_of;
use super::verdict::told_figure;
use crate::chart::{Polar, Target, polar, targets};
use crate::html::{Cell, escape, figure, paragraph, table};
use crate::number::with_uncertainty;
use crate::run::Run;

/// Points of a circle.
const POINTS: usize = 2000;

/// The charts of all tables of acceptance tests; empty if there are none.
pub fn acceptance(run: &Run) -> String {
    let drawn = |table: &AcceptanceTable| {
        let drawn = match table.kind {
            AcceptanceKind::Positioning => positioning(&table.name, &table.text),
            AcceptanceKind::Circle => ball_bar(run, table),
            AcceptanceKind::Diagnosis if circles(run).any(|circle| circle.name == table.name) => Ok(String::new()),
            AcceptanceKind::Diagnosis => diagnosis(table),
        };
        drawn.unwrap_or_else(|error| paragraph(&format!("{}, {}: {error}", table.stage, table.name)))
    };
    run.acceptance.iter().map(drawn).collect()
}

fn circles(run: &Run) -> impl Iterator<Item = &AcceptanceTable> {
    run.acceptance.iter().filter(|table| table.kind == AcceptanceKind::Circle)
}

/// A circle on one page: the trace, its figures, and what makes it where a diagnosis says so.
fn ball_bar(run: &Run, table: &AcceptanceTable) -> Result<String> {
    let mut html = format!("<div class=\"sheet\">\n<h3>Circle, {}</h3>\n", escape(&table.name));
    html.push_str(&circle(&table.name, &table.text)?);
    html.push_str(&figures(run, table));
    for of in run.acceptance.iter().filter(|of| of.kind == AcceptanceKind::Diagnosis && of.name == table.name) {
        html.push_str(&diagnosis(of)?);
    }
    Ok(html + "</div>\n")
}

/// The figures of a circle.
fn figures(run: &Run, of: &AcceptanceTable) -> String {
    let verdict = run.verdicts.iter().find(|verdict| verdict.stage == of.stage);
    let suffix = format!("[{}]", of.name);
    let own = verdict.iter().flat_map(|verdict| &verdict.figures).filter(|figure| !figure.detail);
    let row = |figure: &abbe_core::Figure| {
        let name = figure.name.strip_suffix(&suffix)?;
        let (value, limit) = told_figure(figure);
        let decision = figure.decision.map_or(String::new(), |decision| decision.to_string());
        Some(vec![Cell::text(name), Cell::figure(value), Cell::figure(limit), Cell::text(decision)])
    };
    let rows: Vec<Vec<Cell>> = own.filter_map(row).collect();
    if rows.is_empty() {
        return String::new();
    }
    table("Figures of the readings, ± is k = 2", &["figure", "value", "limit", "decision"], &rows)
}

/// The ranked table of a diagnosis.
fn diagnosis(of: &AcceptanceTable) -> Result<String> {
    let wrong = |error: csv::Error| Error::data(format!("this is no diagnosis: {error}"));
    let mut reader = csv::Reader::from_reader(of.text.as_bytes());
    let mut rows = Vec::new();
    for record in reader.records() {
        let record = record.map_err(wrong)?;
        let text = |place: usize| record.get(place).unwrap_or_default();
        let number = |place: usize| text(place).parse::<f64>().unwrap_or(f64::NAN);
        rows.push(vec![
            Cell::text(text(1)),
            Cell::text(text(2)),
            Cell::figure(with_uncertainty(number(3), 2.0 * number(4))),
            Cell::figure(format!("{:.0} %", number(5))),
            Cell::figure(format!("{:.1}", number(6))),
        ]);
    }
    let head = ["error", "what it is", "by itself, µm", "share", "G(b) without it, µm"];
    Ok(table(&format!("What makes the circle {}, ± is k = 2; {}", of.name, of.stage), &head, &rows))
}

/// A table that a validator of acceptance tests wrote.
pub struct AcceptanceTable {
    /// Its stage.
    pub stage: String,
    /// What was measured.
    pub name: String,
    /// What it is of.
    pub kind: AcceptanceKind,
    /// CSV.
    pub text: String,
}

/// What a table of an acceptance test is of.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum AcceptanceKind {
    /// Targets of an axis.
    Positioning,
    /// A circle.
    Circle,
    /// What makes a circle.
    Diagnosis,
}

impl AcceptanceTable {
    /// The kind and the name of what was measured, by the file of a stage; none for other files.
    pub fn of_file(plugin: &str, file: &str) -> Option<(AcceptanceKind, String)> {
        let (kind, name) = match plugin {
            "positioning" => (AcceptanceKind::Positioning, file.strip_prefix("positioning-")?),
            "circular" => (AcceptanceKind::Circle, file.strip_prefix("polar-")?),
            "circular-diagnosis" => (AcceptanceKind::Diagnosis, file.strip_prefix("diagnosis-")?),
            _ => return None,
        };
        Some((kind, name.strip_suffix(".csv")?.to_owned()))
    }
}

/// Rows of numbers, NaN for empty cells, of the columns with these names; a name ends where its unit begins.
fn columns(text: &str, names: &[&str]) -> Result<(Vec<String>, Vec<Vec<f64>>)> {
    let wrong = |error: csv::Error| Error::data(format!("this is no table of an acceptance test: {error}"));
    let mut reader = csv::Reader::from_reader(text.as_bytes());
    let headers = reader.headers().map_err(wrong)?.clone();
    let mut found = Vec::new();
    for name in names {
        let own = |header: &str| header == *name || header.strip_prefix(name).is_some_and(is_unit);
        let place = headers.iter().position(own);
        found.push(place.ok_or_else(|| Error::data(format!("the table has no column `{name}`")))?);
    }
    let mut rows = Vec::new();
    for record in reader.records() {
        let record = record.map_err(wrong)?;
        let number = |place: &usize| record.get(*place).and_then(|cell| cell.parse().ok()).unwrap_or(f64::NAN);
        rows.push(found.iter().map(number).collect());
    }
    let unit =
        |place: &usize| headers.get(*place).and_then(|header| header.rsplit('_').next()).unwrap_or("").to_owned();
    Ok((found.iter().map(unit).collect(), rows))
}

fn is_unit(rest: &str) -> bool {
    ["_mm", "_deg", "_um", "_urad"].contains(&rest)
}

fn positioning(name: &str, text: &str) -> Result<String> {
    let (units, rows) = columns(text, &["position", "mean_up", "mean_down", "s_up", "s_down"])?;
    let all: Vec<Target> = rows
        .iter()
        .map(|row| Target { position: row[0], means: [row[1], row[2]], spreads: [2.0 * row[3], 2.0 * row[4]] })
        .collect();
    let svg = targets(&format!("Positioning, {name}"), [&unit_of(&units[0]), &unit_of(&units[1])], &all);
    let caption = "Lines: mean deviations; solid: approached upwards, dashed: downwards. Bars: two standard deviations on either side.";
    Ok(figure(&svg, caption))
}

fn circle(name: &str, text: &str) -> Result<String> {
    let (_, rows) = columns(text, &["direction", "angle", "centred"])?;
    let of = |sign: f64| -> Vec<(f64, f64)> {
        let own: Vec<(f64, f64)> = rows.iter().filter(|row| row[0] == sign).map(|row| (row[1], row[2])).collect();
        let every = own.len().div_ceil(POINTS).max(1);
        own.into_iter().step_by(every).collect()
    };
    let told = Polar { axis: name.to_owned(), of: String::new(), series: vec![of(1.0), of(-1.0)] };
    let svg = polar(&format!("Circle, {name}"), "µm", &told);
    let caption = "Deviations from the nominal radius about the centre of the least squares circle of both directions; an arc, and a \
                   circle of one direction, as set up. First colour: counter-clockwise, second: clockwise.";
    Ok(figure(&svg, caption))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_have_units_and_empty_cells_are_no_numbers() {
        let text = "target,position_deg,mean_up_urad,mean_down_urad,s_up_urad,s_down_urad\n1,10,2.5,,0.5,\n";
        let (units, rows) = columns(text, &["position", "mean_up", "mean_down"]).unwrap();
        assert_eq!(units, ["deg", "urad", "urad"]);
        assert_eq!((rows[0][0], rows[0][1], rows[0][2].is_nan()), (10.0, 2.5, true));
        let error = columns(text, &["angle"]).unwrap_err();
        assert!(error.message.contains("no column `angle`"), "{error}");
    }
}

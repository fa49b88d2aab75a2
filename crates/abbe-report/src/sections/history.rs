//! What changed from run to run.

use abbe_core::{Estimated, Status, Unit};

use super::micrometres;
use crate::analysis::{main_fit, same_machine};
use crate::chart::{Trend, trend};
use crate::html::{Cell, details, figure, paragraph, table};
use crate::number::with_uncertainty;
use crate::run::{FitResult, Run};

/// Parameters with a chart.
const CHARTS: usize = 12;

/// Changes that are listed at once.
const FIRST: usize = 12;

/// Expanded uncertainties from which a change is one.
const SURE: f64 = 1.0;

/// A parameter through the runs.
struct Course<'a> {
    name: &'a str,
    unit: String,
    /// Value and standard uncertainty by run, in the unit for people.
    values: Vec<Option<(f64, f64)>>,
}

impl Course<'_> {
    /// The first and the last value that are known.
    fn ends(&self) -> Option<[(f64, f64); 2]> {
        let mut known = self.values.iter().flatten();
        let first = *known.next()?;
        Some([first, *known.next_back()?])
    }

    /// Last minus first, and its expanded uncertainty.
    fn change(&self) -> Option<(f64, f64)> {
        let [(first, one), (last, other)] = self.ends()?;
        Some((last - first, 2.0 * one.hypot(other)))
    }

    /// The change over its expanded uncertainty.
    fn size(&self) -> f64 {
        match self.change() {
            Some((change, expanded)) if expanded > 0.0 => change.abs() / expanded,
            _ => 0.0,
        }
    }
}

/// The section: the volumetric error in one travel, and the parameters that changed most.
pub fn history(runs: &[Run]) -> String {
    let mains: Vec<Option<&FitResult>> = runs.iter().map(main_fit).collect();
    let mut html = in_one_travel(runs, &mains);
    let mut courses = courses(&mains);
    courses.retain(|course| course.ends().is_some());
    if courses.is_empty() {
        return html + &paragraph("No parameter was estimated by the main estimates of two of these runs.");
    }
    courses.sort_by(|one, other| other.size().total_cmp(&one.size()));
    let changed = courses.iter().filter(|course| course.size() > SURE).count();
    html.push_str(&paragraph(&format!(
        "{changed} of {} parameters changed by more than the expanded uncertainty of the change (k = 2). The uncertainties of two runs \
         are taken as independent: what both have in common, as the same artefact, makes the change better known.",
        courses.len()
    )));
    let rows: Vec<Vec<Cell>> = courses.iter().map(row).collect();
    let head = ["parameter", "first", "last", "change", "over its uncertainty"];
    let caption =
        "Changes from the first run to the last, the surest first; ± is the standard uncertainty, of the change k = 2";
    let (first, more) = (rows.len().min(FIRST), rows.len().saturating_sub(FIRST));
    html.push_str(&table(caption, &head, &rows[..first]));
    if more > 0 {
        html.push_str(&details(&format!("{more} more"), false, &table(caption, &head, &rows[first..])));
    }
    let charts: String = courses.iter().take(CHARTS).map(chart).collect();
    html + &figure(
        &format!("<div class=\"curves\">\n{charts}</div>\n"),
        "The runs in the order in which they were given; lines: expanded uncertainty, k = 2.",
    )
}

fn row(course: &Course<'_>) -> Vec<Cell> {
    let [first, last] = course.ends().unwrap_or_default();
    let (change, expanded) = course.change().unwrap_or_default();
    let told = |(value, uncertainty): (f64, f64)| Cell::figure(with_uncertainty(value, uncertainty));
    vec![
        Cell::text(format!("{} {}", course.name, course.unit)),
        told(first),
        told(last),
        told((change, expanded)),
        Cell::figure(format!("{:.1}", course.size())),
    ]
}

fn chart(course: &Course<'_>) -> String {
    let points = course.values.iter().map(|value| value.map(|(value, uncertainty)| (value, 2.0 * uncertainty)));
    trend(&Trend { name: course.name.to_owned(), unit: course.unit.clone(), points: points.collect() })
}

/// The parameters that two of the estimates have, in the order of the first.
fn courses<'a>(mains: &[Option<&'a FitResult>]) -> Vec<Course<'a>> {
    let mut found: Vec<Course<'a>> = Vec::new();
    let counts = |known: &Estimated| matches!(known.status, Status::Estimated | Status::Considered);
    for (number, fit) in mains.iter().enumerate() {
        let Some(fit) = fit else { continue };
        for known in fit.calibration.parameters.iter().filter(|known| counts(known)) {
            let (unit, factor) = known.unit.parse::<Unit>().map_or((known.unit.clone(), 1.0), Unit::for_people);
            let value = Some((known.value * factor, known.standard_uncertainty * factor));
            match found.iter_mut().find(|course| course.name == known.name && course.unit == unit) {
                Some(course) => course.values[number] = value,
                None => {
                    let mut values = vec![None; mains.len()];
                    values[number] = value;
                    found.push(Course { name: &known.name, unit, values });
                }
            }
        }
    }
    found
}

/// The volumetric error of every run in the travel of the first, where the machines have the same axes.
fn in_one_travel(runs: &[Run], mains: &[Option<&FitResult>]) -> String {
    let Some((first, analysis)) = mains[0].and_then(|fit| Some((fit, fit.analysis().ok().flatten()?))) else {
        return String::new();
    };
    let mut rows = Vec::new();
    for (run, fit) in runs.iter().zip(mains) {
        let Some(fit) = fit.filter(|fit| same_machine(first, fit)) else { continue };
        let Ok(found) = analysis.elsewhere(fit) else { continue };
        rows.push(vec![
            Cell::text(&run.name),
            Cell::figure(micrometres(found.rms)),
            Cell::figure(micrometres(found.largest)),
        ]);
    }
    if rows.len() < 2 {
        return String::new();
    }
    let caption = format!("Volumetric errors in one travel, {}; ± is k = 2", analysis.travel);
    table(&caption, &["run", "RMS", "largest"], &rows)
}

//! The residuals of an estimate: over time, by group, against quantiles, the largest with their places.

use std::collections::BTreeMap;

use crate::chart::{Point, Polar, SERIES, groups, polar, quantiles, scatter};
use crate::html::{Cell, figure, paragraph, table};
use crate::number::short;
use crate::residuals::Residual;
use crate::run::FitResult;

/// Points of a chart; of more, those that stand out and some of the others are shown.
const POINTS: usize = 4000;

/// Groups of a chart.
const GROUPS: usize = 60;

/// Largest residuals with their places.
const LARGEST: usize = 15;

/// Standard uncertainties from which a residual is ringed.
const RINGED: f64 = 4.0;

/// The charts and tables of one estimate; nothing if its residuals are not known.
pub fn residuals(fit: &FitResult) -> String {
    let mut html = String::new();
    for (is_angle, unit) in [(false, "µm"), (true, "µrad")] {
        let rows: Vec<&Residual> = fit.residuals.rows.iter().filter(|row| row.is_angle == is_angle).collect();
        if !rows.is_empty() {
            html.push_str(&of_quantity(fit, &rows, unit));
        }
    }
    if html.is_empty() { paragraph("Its residuals are not known.") } else { html }
}

fn of_quantity(fit: &FitResult, rows: &[&Residual], unit: &str) -> String {
    let stages = distinct(rows.iter().map(|row| row.stage.as_str()));
    let is_outlier = |row: &Residual| {
        let outliers = &fit.calibration.outliers;
        outliers.iter().any(|outlier| (&outlier.stage, &outlier.file, outlier.row) == (&row.stage, &row.file, row.row))
    };
    let has_time = rows.iter().all(|row| row.time.is_some());
    let mut size: Vec<f64> = rows.iter().map(|row| row.normalised().abs()).collect();
    size.sort_by(f64::total_cmp);
    // The largest tenth of what is shown is always there.
    let large = size[size.len().saturating_sub(POINTS / 10)];
    let every = (rows.len() / (POINTS * 9 / 10)).max(1);
    let shown = |index: &usize| {
        rows.len() <= POINTS
            || index.is_multiple_of(every)
            || rows[*index].normalised().abs() >= large
            || is_outlier(rows[*index])
    };
    let point = |index: usize| {
        let row = rows[index];
        let stands_out = is_outlier(row) || row.normalised().abs() > RINGED;
        Point {
            x: if has_time { row.time.unwrap_or(0.0) } else { index as f64 + 1.0 },
            y: row.value,
            series: stages.iter().position(|stage| *stage == row.stage).unwrap_or(0),
            tip: if stands_out { format!("{}: {} {unit}", row.place(), short(row.value)) } else { String::new() },
        }
    };
    let points: Vec<Point> = (0..rows.len()).filter(shown).map(point).collect();
    let mut caption = format!("{} residuals of {}", rows.len(), stages.join(", "));
    if points.len() < rows.len() {
        caption.push_str(&format!("; {} are drawn: the largest, and every {every}th of the others", points.len()));
    }
    caption.push_str(". Ringed: outliers and residuals above four standard uncertainties.");
    if stages.len() > SERIES {
        caption.push_str(" Colours repeat.");
    }
    let x_name = if has_time { "time s" } else { "row, in the order of the data" };
    let title = format!("Residuals of {} in the order of measurement", fit.name);
    let mut html = figure(&scatter(&title, [x_name, unit], &points), &caption);
    let mut ordered: Vec<f64> = rows.iter().map(|row| row.normalised()).filter(|value| value.is_finite()).collect();
    ordered.sort_by(f64::total_cmp);
    html.push_str("<div class=\"pair\">\n");
    let caption = "Residuals over their standard uncertainties, against those of a normal distribution. On the line they scatter as stated; \
                   steeper means more.";
    html.push_str(&figure(&quantiles(&format!("Quantiles of {}", fit.name), &ordered), caption));
    for told in around(fit, rows) {
        let title = format!("Residuals of {} around {}", fit.name, told.axis);
        html.push_str(&figure(
            &polar(&title, unit, &told),
            "Residuals against the angle of the axis, outwards positive.",
        ));
    }
    html.push_str("</div>\n");
    html.push_str(&by_group(fit, rows, unit));
    html + &largest(rows, unit, &is_outlier)
}

fn distinct<'a>(all: impl Iterator<Item = &'a str>) -> Vec<&'a str> {
    let mut found: Vec<&str> = Vec::new();
    for one in all {
        if !found.contains(&one) {
            found.push(one);
        }
    }
    found
}

/// A chart for every column of labels, for stages and for files, where these make groups.
fn by_group(fit: &FitResult, rows: &[&Residual], unit: &str) -> String {
    let mut html = String::new();
    let mut chart = |name: &str, of: &dyn Fn(&Residual) -> String| {
        let mut found: BTreeMap<(usize, String), Vec<f64>> = BTreeMap::new();
        for row in rows {
            let label = of(row);
            if !label.is_empty() {
                // Numbers in their order: the shorter is the smaller.
                let length = if label.bytes().all(|digit| digit.is_ascii_digit()) { label.len() } else { usize::MAX };
                found.entry((length, label)).or_default().push(row.value);
            }
        }
        if found.len() < 2 || found.len() * 2 > rows.len() {
            return;
        }
        let mut told: Vec<(String, f64, f64, usize)> = found
            .into_iter()
            .map(|((_, label), values)| {
                let count = values.len() as f64;
                let mean = values.iter().sum::<f64>() / count;
                let rms = (values.iter().map(|value| value * value).sum::<f64>() / count).sqrt();
                (label, mean, rms, values.len())
            })
            .collect();
        let all = told.len();
        if all > GROUPS {
            let mut sizes: Vec<f64> = told.iter().map(|(_, _, rms, _)| *rms).collect();
            sizes.sort_by(|one, other| other.total_cmp(one));
            let least = sizes[GROUPS - 1];
            told.retain(|(_, _, rms, _)| *rms >= least);
        }
        let title = format!("Residuals of {} by {name}", fit.name);
        let some = if all > told.len() { format!("; the {} largest of {all}", told.len()) } else { String::new() };
        let caption = format!("By {name}: bar RMS, square mean{some}.");
        html.push_str(&figure(&groups(&title, unit, &told), &caption));
    };
    chart("stage", &|row| row.stage.clone());
    chart("file", &|row| row.file.rsplit(['/', '\\']).next().unwrap_or_default().to_owned());
    for (index, name) in fit.residuals.labels.iter().enumerate() {
        chart(name, &|row| row.labels[index].clone());
    }
    html
}

/// Residuals around the rotary axes that turn most in some stage: a quarter of a turn at least, with many rows.
fn around(fit: &FitResult, rows: &[&Residual]) -> Vec<Polar> {
    let mut found = Vec::new();
    for (index, (axis, _)) in fit.residuals.axes.iter().enumerate().filter(|(_, (_, unit))| unit == "deg") {
        let at: Vec<(f64, f64)> = rows
            .iter()
            .map(|row| (row.commands[index], row.value))
            .filter(|(degrees, _)| degrees.is_finite())
            .collect();
        let mut different: Vec<i64> = at.iter().map(|(degrees, _)| degrees.round() as i64).collect();
        different.sort_unstable();
        different.dedup();
        if different.len() < 45 {
            continue;
        }
        let every = (at.len() / POINTS).max(1);
        let points = at.into_iter().step_by(every).collect();
        found.push(Polar { axis: axis.clone(), points });
    }
    found
}

/// The largest residuals, in standard uncertainties, with file and line.
fn largest(rows: &[&Residual], unit: &str, is_outlier: &dyn Fn(&Residual) -> bool) -> String {
    let mut order: Vec<&&Residual> = rows.iter().collect();
    order.sort_by(|one, other| other.normalised().abs().total_cmp(&one.normalised().abs()));
    let cells = order.iter().take(LARGEST).map(|row| {
        vec![
            Cell::text(row.place()),
            Cell::text(&row.stage),
            Cell::text(row.labels.iter().filter(|label| !label.is_empty()).cloned().collect::<Vec<_>>().join(", ")),
            Cell::figure(format!("{} {unit}", short(row.value))),
            Cell::figure(format!("{:.1}", row.normalised())),
            Cell::text(if is_outlier(row) { "outlier" } else { "" }),
        ]
    });
    let head = ["where", "stage", "labels", "residual", "over its uncertainty", ""];
    table("The largest residuals", &head, &cells.collect::<Vec<_>>())
}

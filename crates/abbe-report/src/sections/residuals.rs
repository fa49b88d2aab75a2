//! The residuals of an estimate: over time, by group, against quantiles, the largest with their places.

use std::collections::{BTreeMap, BTreeSet};

use abbe_core::Verdict;

use super::Scene;
use super::around::around;
use super::held_out::held_out;
use crate::chart::{Point, SERIES, groups, polar, quantiles, scatter};
use crate::html::{Cell, escape, figure, paragraph, table};
use crate::number::short;
use crate::residuals::Residual;
use crate::run::FitResult;
use crate::subset::{SEED, subset};

/// Points of a chart; of more, those that stand out and some of the others are shown.
const POINTS: usize = 4000;

/// Groups of a chart.
const GROUPS: usize = 60;

/// Groups beyond which a column tells rows apart and makes no groups.
const MOST_GROUPS: usize = 120;

/// Largest residuals with their places.
const LARGEST: usize = 15;

/// Outliers that are listed of an estimate without residuals.
const MOST_OUTLIERS: usize = 60;

/// Standard uncertainties from which a residual is ringed.
pub const RINGED: f64 = 4.0;

/// The charts and tables of one estimate. Rows that a viewer shows are links to their points; `verdicts` have what was predicted
/// without its fold.
pub fn residuals(fit: &FitResult, view: Option<(usize, &Scene<'_>)>, verdicts: &[Verdict]) -> String {
    let mut html = String::new();
    for (is_angle, unit) in [(false, "µm"), (true, "µrad")] {
        let rows: Vec<&Residual> = fit.residuals.rows.iter().filter(|row| row.is_angle == is_angle).collect();
        if !rows.is_empty() {
            html.push_str(&of_quantity(fit, &rows, unit, view));
        }
    }
    if fit.residuals.rows.is_empty() {
        html.push_str(&outliers(fit));
    }
    html.push_str(&held_out(fit, verdicts));
    if html.is_empty() { paragraph("Its residuals are not known.") } else { html }
}

/// The outliers of an estimate whose residuals are not known: of readings that are no geometry.
fn outliers(fit: &FitResult) -> String {
    let mut order: Vec<_> = fit.calibration.outliers.iter().collect();
    order.sort_by(|one, other| other.residual_um.abs().total_cmp(&one.residual_um.abs()));
    let all = order.len();
    let rows = order.into_iter().take(MOST_OUTLIERS).map(|outlier| {
        vec![
            Cell::text(format!("{} (row {})", outlier.place(), outlier.row)),
            Cell::text(&outlier.stage),
            Cell::figure(short(outlier.residual_um)),
            Cell::figure(format!("{:.2}", outlier.weight)),
        ]
    });
    let rows: Vec<Vec<Cell>> = rows.collect();
    if rows.is_empty() {
        return String::new();
    }
    let caption = match all > rows.len() {
        true => format!("The {} largest of {all} outliers; all stand in the calibration", rows.len()),
        false => "Readings that do not agree with the others".to_owned(),
    };
    table(&caption, &["where", "stage", "residual µm (angles: µrad)", "weight"], &rows)
}

fn of_quantity(fit: &FitResult, rows: &[&Residual], unit: &str, view: Option<(usize, &Scene<'_>)>) -> String {
    let stages = distinct(rows.iter().map(|row| row.stage.as_str()));
    let outliers: BTreeSet<(&str, &str, usize)> = fit
        .calibration
        .outliers
        .iter()
        .map(|outlier| (outlier.stage.as_str(), outlier.file.as_str(), outlier.row))
        .collect();
    let is_outlier = |row: &Residual| outliers.contains(&(row.stage.as_str(), row.file.as_str(), row.row));
    let has_time = rows.iter().all(|row| row.time.is_some());
    let mut size: Vec<f64> = rows.iter().map(|row| row.normalised().abs()).collect();
    size.sort_by(f64::total_cmp);
    // The largest tenth of what is shown is always there.
    let large = size[size.len().saturating_sub(POINTS / 10)];
    let stands_out = |index: usize| rows[index].normalised().abs() >= large || is_outlier(rows[index]);
    let shown = subset(rows.len(), POINTS, stands_out);
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
    let points: Vec<Point> = shown.into_iter().map(point).collect();
    let mut caption = format!("{} residuals of {}", rows.len(), stages.join(", "));
    if points.len() < rows.len() {
        caption.push_str(&format!("; {} are drawn: the largest, and others by chance (seed {SEED})", points.len()));
    }
    caption.push_str(". Ringed: outliers and residuals above four standard uncertainties.");
    if stages.len() > SERIES {
        caption.push_str(" Colours repeat.");
    }
    let x_name = if has_time { "time s" } else { "row, in the order of the data" };
    let title = format!("Residuals of {} in the order of measurement", fit.name);
    let good: Vec<&Residual> = rows.iter().copied().filter(|row| !is_outlier(row)).collect();
    let within = good.iter().fold([0.0_f64; 2], |[least, most], row| [least.min(row.value), most.max(row.value)]);
    if good.len() < rows.len() {
        caption.push_str(" Outliers stand at the edge with their values; the charts below are without them.");
    }
    let mut html = figure(&scatter(&title, [x_name, unit], &points, within), &caption);
    let mut ordered: Vec<f64> = good.iter().map(|row| row.normalised()).filter(|value| value.is_finite()).collect();
    ordered.sort_by(f64::total_cmp);
    html.push_str("<div class=\"pair\">\n");
    let caption = "Residuals over their standard uncertainties, against those of a normal distribution. On the line they scatter as stated; \
                   steeper means more.";
    html.push_str(&figure(&quantiles(&format!("Quantiles of {}", fit.name), &ordered), caption));
    for told in around(fit, &good) {
        let title = format!("Residuals of {} around {}", fit.name, told.axis);
        let caption = format!("Residuals against the angle {}, outwards positive.", told.of);
        html.push_str(&figure(&polar(&title, unit, &told), &caption));
    }
    html.push_str("</div>\n");
    html.push_str(&by_group(fit, &good, unit));
    html + &largest(view, rows, unit, &is_outlier)
}

/// Each once, in the order in which they come first.
fn distinct<'a>(all: impl Iterator<Item = &'a str>) -> Vec<&'a str> {
    let mut seen = BTreeSet::new();
    all.filter(|one| seen.insert(*one)).collect()
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
        if found.len() < 2 || found.len() * 2 > rows.len() || found.len() > MOST_GROUPS {
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
    let count = |of: &dyn Fn(&Residual) -> &str| distinct(rows.iter().map(|row| of(row))).len();
    let is_same = count(&|row| row.file.as_str()) == count(&|row| row.stage.as_str());
    let mut chart = |name: &str, of: &dyn Fn(&Residual) -> String| {
        if name != "file" || !is_same {
            chart(name, of);
        }
    };
    chart("file", &|row| row.file.rsplit(['/', '\\']).next().unwrap_or_default().to_owned());
    for (index, name) in fit.residuals.labels.iter().enumerate() {
        chart(name, &|row| row.labels[index].clone());
    }
    html
}

/// The largest residuals, in standard uncertainties, with file and line.
fn largest(
    view: Option<(usize, &Scene<'_>)>,
    rows: &[&Residual],
    unit: &str,
    is_outlier: &dyn Fn(&Residual) -> bool,
) -> String {
    // A row that the viewer shows is a link to it.
    let link = |row: &Residual| {
        let (number, scene) = view?;
        let index = scene.rows.iter().position(|seen| std::ptr::eq(*seen, row))?;
        Some(Cell::Html(format!("<a href=\"#point-{number}-{index}\">{}</a>", escape(&row.place()))))
    };
    let place = |row: &Residual| link(row).unwrap_or_else(|| Cell::text(row.place()));
    let mut order: Vec<&&Residual> = rows.iter().collect();
    order.sort_by(|one, other| other.normalised().abs().total_cmp(&one.normalised().abs()));
    let cells = order.iter().take(LARGEST).map(|row| {
        vec![
            place(row),
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

//! Where it was measured: points with their residuals, and the error field; to be turned and picked where the browser can, and as
//! three plane views everywhere.

use std::fmt::Write;

use crate::analysis::Analysis;
use crate::base64::base64;
use crate::chart::views;
use crate::html::{escape, figure};
use crate::residuals::Residual;
use crate::run::FitResult;

/// Points of the viewer at most; of more, evenly spaced ones are taken.
const MOST: usize = 100_000;

/// The residuals that the viewer shows, in its order: lengths with a place.
pub fn scene_rows(fit: &FitResult) -> Vec<&Residual> {
    let all: Vec<&Residual> = fit.residuals.rows.iter().filter(|row| row.tip.is_some() && !row.is_angle).collect();
    let every = all.len().div_ceil(MOST).max(1);
    all.into_iter().step_by(every).collect()
}

/// The section; empty if no residual has a place.
pub fn scene(fit: &FitResult) -> String {
    let rows = scene_rows(fit);
    if rows.is_empty() {
        return String::new();
    }
    let field = Analysis::of(fit).ok().flatten().map_or(Vec::new(), |found| found.field);
    let points: Vec<([f64; 3], f64)> = rows.iter().map(|row| (row.tip.unwrap_or_default(), row.value)).collect();
    let mut html = viewer(&rows, &field);
    let caption = format!(
        "{} places of the tip in the table frame, in three views; blue: residual below zero, orange: above. Lines: volumetric error, \
         exaggerated.",
        rows.len()
    );
    html.push_str("<div class=\"views\">\n");
    html.push_str(&figure(&views("Places that were measured", &points, &field), &caption));
    html + "</div>\n"
}

/// The element of the viewer, hidden until the script shows it, with its data: little-endian numbers as base64.
fn viewer(rows: &[&Residual], field: &[([f64; 3], [f64; 3])]) -> String {
    let (mut numbers, mut places) = (Vec::new(), Vec::new());
    let index_of = |name: &str, all: &mut Vec<String>| -> u32 {
        let found = all.iter().position(|known| known == name);
        found.unwrap_or_else(|| {
            all.push(name.to_owned());
            all.len() - 1
        }) as u32
    };
    let mut texts: Vec<String> = Vec::new();
    for row in rows {
        let tip = row.tip.unwrap_or_default();
        let direction = row.direction.unwrap_or_default();
        let all = tip.into_iter().chain(direction).chain([row.value, row.normalised()]);
        all.for_each(|number| numbers.extend((number as f32).to_le_bytes()));
        let (stage, file) = (index_of(&row.stage, &mut texts), index_of(&row.file, &mut texts));
        [stage, file, row.line as u32, row.row as u32].iter().for_each(|number| places.extend(number.to_le_bytes()));
    }
    let mut errors = Vec::new();
    for (place, error) in field {
        place.iter().chain(error).for_each(|number| errors.extend((*number as f32).to_le_bytes()));
    }
    let mut listed = String::new();
    for text in &texts {
        let _ = write!(listed, "<li>{}</li>", escape(text));
    }
    format!(
        "<div id=\"viewer\" hidden data-points=\"{}\" data-places=\"{}\" data-field=\"{}\">\n\
         <canvas tabindex=\"0\" role=\"img\" aria-label=\"Places in space. Drag or use arrow keys to turn, plus and minus to zoom, click to \
         pick a point.\"></canvas>\n<p><output id=\"picked\" aria-live=\"polite\">Click a point: file, line and residual stand here.</output></p>\n\
         <p class=\"controls\"><button type=\"button\" id=\"worse\">Next largest residual</button>\n\
         <label>Residuals × <input id=\"arrows\" type=\"range\" min=\"0\" max=\"5\" step=\"0.1\" value=\"3\"> <span id=\"arrows-told\"></span></label>\n\
         <label>Error field × <input id=\"errors\" type=\"range\" min=\"0\" max=\"5\" step=\"0.1\" value=\"2.5\"> <span \
         id=\"errors-told\"></span></label></p>\n<ul id=\"names\" hidden>{listed}</ul>\n</div>\n",
        base64(&numbers),
        base64(&places),
        base64(&errors)
    )
}

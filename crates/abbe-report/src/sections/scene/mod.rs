//! Where it was measured, in space: points with their residuals, the machine, error field, slices through it and ellipsoids of
//! uncertainty; to be turned and picked where the browser can, and as three plane views everywhere.

mod field;
mod machine;
mod points;

use std::fmt::Write;

use serde_json::{Value, json};

use crate::analysis::Analysis;
use crate::base64::base64;
use crate::chart::views;
use crate::html::{escape, figure};
use crate::residuals::Residual;
use crate::run::FitResult;
use crate::subset::subset;

/// Points of all viewers of a page at most.
const MOST: usize = 100_000;

/// What a viewer shows of an estimate.
pub struct Scene<'a> {
    /// The residuals that it shows, in its order: lengths with a place.
    pub rows: Vec<&'a Residual>,
    all: usize,
}

impl<'a> Scene<'a> {
    /// What the viewer of an estimate shows on a page with several viewers.
    pub fn of(fit: &'a FitResult, viewers: usize) -> Self {
        let all: Vec<&Residual> = fit.residuals.rows.iter().filter(|row| row.tip.is_some() && !row.is_angle).collect();
        let stands_out = |index: usize| all[index].normalised().abs() > super::RINGED;
        let chosen = subset(all.len(), MOST / viewers.max(1), stands_out);
        Self { rows: chosen.into_iter().map(|index| all[index]).collect(), all: all.len() }
    }

    /// The section, with the viewer of this number or none; empty if no residual has a place. `others` are estimates of other runs that are compared with this one.
    pub fn section(&self, viewer: Option<usize>, fit: &FitResult, others: &[(&str, &FitResult)]) -> String {
        if self.rows.is_empty() {
            return String::new();
        }
        let analysis = fit.analysis().ok().flatten();
        let field = analysis.map_or(&[][..], |found| found.field.as_slice());
        let points: Vec<([f64; 3], f64)> =
            self.rows.iter().map(|row| (row.tip.unwrap_or_default(), row.value)).collect();
        let some = match self.all > self.rows.len() {
            true => format!(" of {}, the largest residuals and others by chance", self.all),
            false => String::new(),
        };
        let caption = format!(
            "{} places of the tip in the table frame{some}, in three views; blue: residual below zero, orange: above. Lines: volumetric \
             error, exaggerated.",
            self.rows.len()
        );
        let title = format!("Places that were measured, {}", fit.name);
        let viewer = viewer.map(|number| self.viewer(number, fit, analysis, others));
        let mut html = viewer.unwrap_or_default();
        html.push_str("<div class=\"views\">\n");
        html.push_str(&figure(&views(&title, &points, field), &caption));
        html + "</div>\n"
    }

    /// The element of the viewer, hidden until the script shows it, with its data.
    fn viewer(
        &self,
        number: usize,
        fit: &FitResult,
        analysis: Option<&Analysis>,
        others: &[(&str, &FitResult)],
    ) -> String {
        let machine = machine::Machine::of(fit);
        let volume = field::Volume::of(fit);
        let shown = analysis.map_or(Vec::new(), |found| field::shown(fit, found, volume.as_ref(), others));
        let axes = &fit.residuals.axes;
        let data = json!({
            "points": points::packed(&self.rows, axes.len()),
            "field": { "places": analysis.map_or(String::new(), |found| floats(found.field.iter().map(|(place, _)| *place))) },
            "shown": shown.iter().map(field::Shown::json).collect::<Vec<Value>>(),
            "volume": volume.as_ref().map(field::Volume::json),
            "ellipsoids": analysis.map(|found| field::ellipsoids(fit, volume.as_ref(), found)),
            "machine": machine.as_ref().map(|machine| machine.json(axes)),
        });
        let mut options = String::new();
        for (index, one) in shown.iter().enumerate() {
            let _ = write!(options, "<option value=\"{index}\">{}</option>", escape(&one.name));
        }
        let mut controls = String::new();
        if !options.is_empty() {
            let _ = write!(
                controls,
                "<label>Error field <select data-part=\"shown\">{options}</select></label>\n\
                 <label>× <input data-part=\"errors\" type=\"range\" min=\"0\" max=\"5\" step=\"0.1\" value=\"2.5\" aria-label=\"Error field \
                 times\"> <span data-told=\"errors\"></span></label>\n\
                 <label>Uncertainty (95 %) × <input data-part=\"ellipsoids\" type=\"range\" min=\"0\" max=\"6\" step=\"0.1\" value=\"0\"> <span \
                 data-told=\"ellipsoids\"></span></label>\n"
            );
        }
        if let Some(volume) = &volume {
            let across: String = volume
                .names()
                .enumerate()
                .map(|(index, name)| format!("<option value=\"{index}\">{}</option>", escape(name)))
                .collect();
            let _ = write!(
                controls,
                "<label>Slice across <select data-part=\"slice\"><option value=\"\">none</option>{across}</select></label>\n\
                 <label>at <input data-part=\"at\" type=\"range\" min=\"0\" max=\"1\" step=\"0.01\" value=\"0.5\" aria-label=\"Place of the \
                 slice\"> <output data-told=\"at\"></output></label>\n"
            );
        }
        let moved = machine.map_or(String::new(), |machine| machine.controls());
        format!(
            "<div class=\"viewer\" id=\"viewer-{number}\" hidden data-scene=\"{}\">\n<div class=\"space\"><canvas tabindex=\"0\" role=\"img\" \
             aria-label=\"Places in space. Drag or use arrow keys to turn, plus and minus to zoom, click to pick a \
             point.\"></canvas></div>\n<p><output data-part=\"picked\" aria-live=\"polite\">Click a point: file, line and residual stand \
             here.</output></p>\n<p class=\"controls\"><button type=\"button\" data-part=\"worse\">Next largest residual</button>\n\
             <label>Residuals × <input data-part=\"arrows\" type=\"range\" min=\"0\" max=\"5\" step=\"0.1\" value=\"3\"> <span \
             data-told=\"arrows\"></span></label>\n{controls}</p>\n{moved}</div>\n",
            escape(&data.to_string()),
        )
    }
}

/// Triples as little-endian numbers of 32 bits, as base64.
fn floats(all: impl Iterator<Item = [f64; 3]>) -> String {
    let bytes: Vec<u8> = all.flatten().flat_map(|number| (number as f32).to_le_bytes()).collect();
    base64(&bytes)
}

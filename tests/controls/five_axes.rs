//! Random machines with two rotary axes outside their linear ones.

use serde_json::{Value, json};

use super::law::{Machine, uniform};
use super::random::of_settings;

/// Largest displacement of a rotary axis in each direction, mm.
const DISPLACED: f64 = 0.05;

/// Which errors a machine has.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Errors {
    /// Rotary axes stand elsewhere.
    Places,
    /// Rotary axes stand elsewhere and point elsewhere; their zeros are right.
    Axes,
    /// Also squareness of linear axes, zeros of rotary axes and error motions.
    All,
}

/// A machine and where its nominal axes are.
pub struct FiveAxes {
    pub machine: Machine,
    /// Axes next to the workpiece, those next to the bed first: name and nominal point in the machine frame, mm.
    pub table: Vec<(String, [f64; 3])>,
    /// Axes next to the tool, those next to the bed first.
    pub head: Vec<(String, [f64; 3])>,
    /// Length of the tool, mm.
    pub tool: f64,
}

/// How the rotary axes stand.
pub struct Layout<'a> {
    /// Axes next to the workpiece, those next to the bed first.
    pub table: &'a [&'a str],
    /// Axes next to the tool, those next to the bed first.
    pub head: &'a [&'a str],
    /// Axes that turn the other way.
    pub reversed: &'a [&'a str],
}

pub fn machine(seed: u64, layout: &Layout<'_>, errors: Errors) -> FiveAxes {
    let mut uniform = uniform(seed);
    let tool = (50.0 + 150.0 * uniform()).round();
    let mut axes = serde_json::Map::new();
    let mut lines: Vec<(String, [f64; 3])> = Vec::new();
    for axis in layout.table.iter().chain(layout.head) {
        let point = [(); 3].map(|()| (200.0 * uniform() - 100.0).round());
        let reverse = layout.reversed.contains(axis);
        axes.insert((*axis).to_owned(), json!({ "range_deg": [-100, 100], "point_mm": point, "reverse": reverse }));
        lines.push(((*axis).to_owned(), point));
    }
    let linear = ["X", "Y", "Z"];
    linear.iter().for_each(|axis| {
        axes.insert((*axis).to_owned(), json!({ "range_mm": [-300, 300] }));
    });
    let (carrying, moved) = linear.split_at((4.0 * uniform()) as usize);
    let outward: Vec<&str> = layout.table.iter().rev().copied().collect();
    let chain = [&["w"][..], &outward, carrying, &["b"], moved, layout.head, &["t"]].concat().join(" ");
    let frame = if uniform() < 0.5 { "moving" } else { "fixed" };
    let settings = json!({
        "chain": chain, "tool_length_mm": tool, "stylus_radius_mm": 0, "axes": axes, "error_frame": frame,
        "errors": declared(&lines, errors),
    });
    let head = lines.split_off(layout.table.len());
    FiveAxes { machine: of_settings(&settings, seed, DISPLACED), table: lines, head, tool }
}

fn declared(lines: &[(String, [f64; 3])], errors: Errors) -> Vec<Value> {
    let rotary = lines.iter().map(|(name, _)| name.as_str());
    if errors == Errors::All {
        let own = rotary.map(|axis| json!({ "fourier": [format!("E?{axis}")], "orders": [1] }));
        let linear = ["X", "Y", "Z"].map(|axis| json!({ "polynomial": [format!("E?{axis}")], "degrees": [1, 2] }));
        return [json!({ "location": ["E?0?"] })].into_iter().chain(linear).chain(own).collect();
    }
    let components = |axis: &str| {
        let turns = if errors == Errors::Axes { &["A", "B", "C"][..] } else { &[] };
        let across = turns.iter().filter(|letter| **letter != axis);
        let own = ["X", "Y", "Z"].iter().chain(across).map(|letter| format!("E{letter}0{axis}"));
        own.collect::<Vec<_>>()
    };
    vec![json!({ "location": rotary.flat_map(components).collect::<Vec<_>>() })]
}

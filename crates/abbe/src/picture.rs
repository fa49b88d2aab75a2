//! A picture of a machine: its chain, where its axes are, and what each of its errors does at the tool.

mod draw;
mod errors;
mod space;

use abbe_core::{Axis, AxisKind, Branch, Registry, Result};
use abbe_engine::Described;

use crate::effects::Stand;
use draw::{COLOURS, Drawing, GREY, SIDES, seen};

/// Width of the picture.
const WIDTH: f64 = 1180.0;

/// Room at its edges.
const EDGE: f64 = 20.0;

/// The picture as the text of an SVG file.
///
/// Fails for a stand that the machine does not have.
pub fn svg(machine: &Described, at: &[(String, f64)], registry: &Registry) -> Result<String> {
    let info = machine.model.info();
    let stand = Stand::new(machine.model.as_ref(), at)?;
    let mut drawing = Drawing::default();
    let chain = info.settings.get("chain").and_then(serde_json::Value::as_str).unwrap_or(&machine.stage);
    heading(&mut drawing, 30.0, &format!("The chain {chain}"));
    let mut below = chain_of(&mut drawing, &info.axes, 50.0);
    heading(&mut drawing, below + 30.0, "Frames and axes, seen from the workpiece");
    below = space::draw(&mut drawing, machine, &stand, below + 40.0)?;
    below = errors::draw(&mut drawing, machine, &stand, registry, below)?;
    Ok(drawing.finished(WIDTH, below + EDGE, &format!("The machine {chain}")))
}

fn heading(drawing: &mut Drawing, below: f64, text: &str) {
    drawing.text([EDGE, below], text, "start", "font-size=\"16\" font-weight=\"bold\"");
}

/// The colour of the side of an axis.
fn side(axis: &Axis) -> &'static str {
    SIDES[usize::from(axis.branch == Branch::Tool)]
}

/// The sense and direction in which a positive command moves the tool as seen from the workpiece.
fn tool_motion(axis: &Axis) -> [f64; 3] {
    let side = if axis.branch == Branch::Workpiece { -1.0 } else { 1.0 };
    axis.direction.map(|part| part * axis.sense * side)
}

/// A part of the row that shows the chain.
enum Cell<'a> {
    Body(&'static str, &'static str),
    Joint(&'a Axis),
}

/// The chain from the workpiece to the tool: bodies, and between them joints with how they move the tool. Gives where it ends.
fn chain_of(drawing: &mut Drawing, axes: &[Axis], above: f64) -> f64 {
    let mut cells = vec![Cell::Body("workpiece", SIDES[0])];
    let has_tool_side = axes.iter().position(|axis| axis.branch == Branch::Tool).unwrap_or(axes.len());
    let (workpiece, tool) = axes.split_at(has_tool_side);
    cells.extend(workpiece.iter().map(Cell::Joint));
    cells.push(Cell::Body("bed", GREY));
    cells.extend(tool.iter().map(Cell::Joint));
    cells.push(Cell::Body("tool", SIDES[1]));
    let wide = (WIDTH - 2.0 * EDGE) / cells.len() as f64;
    let (height, middle) = (150.0, above + 62.0);
    drawing.line([EDGE + wide / 2.0, middle], [WIDTH - EDGE - wide / 2.0, middle], GREY, 2.0, false);
    for (place, cell) in cells.iter().enumerate() {
        let centre = [EDGE + wide * (place as f64 + 0.5), middle];
        match cell {
            Cell::Body(name, colour) => {
                let size = [86.0_f64.min(wide - 10.0), 44.0];
                drawing.area_of([centre[0] - size[0] / 2.0, centre[1] - size[1] / 2.0], size, "#f4f5f7", colour);
                drawing.text(
                    [centre[0], centre[1] + 4.0],
                    name,
                    "middle",
                    &format!("fill=\"{colour}\" font-weight=\"bold\""),
                );
            }
            Cell::Joint(axis) => joint(drawing, axis, centre, wide),
        }
    }
    drawing.text(
        [EDGE, above + height + 6.0],
        "Arrows: how a positive command moves the tool as seen from the workpiece; an axis with a prime carries the workpiece, which goes the other way.",
        "start",
        &format!("fill=\"{GREY}\""),
    );
    above + height + 10.0
}

fn joint(drawing: &mut Drawing, axis: &Axis, centre: [f64; 2], wide: f64) {
    let (colour, motion) = (side(axis), tool_motion(axis));
    drawing.area_of([centre[0] - 36.0, centre[1] - 44.0], [72.0, 88.0], "white", colour);
    for (part, own) in COLOURS.iter().enumerate() {
        let mut unit = [0.0; 3];
        unit[part] = 14.0;
        let to = seen(unit);
        let from = [centre[0] - 26.0, centre[1] + 34.0];
        drawing.line(from, [from[0] + to[0], from[1] + to[1]], own, 1.0, false);
    }
    match axis.kind {
        AxisKind::Linear => {
            let half = seen(motion.map(|part| part * 28.0));
            drawing.arrow(
                [centre[0] - half[0], centre[1] - half[1]],
                [centre[0] + half[0], centre[1] + half[1]],
                colour,
                3.0,
            );
        }
        AxisKind::Rotary => {
            let half = seen(motion.map(|part| part * 34.0));
            drawing.line(
                [centre[0] - half[0], centre[1] - half[1]],
                [centre[0] + half[0], centre[1] + half[1]],
                GREY,
                1.0,
                true,
            );
            drawing.turn(centre, motion, 22.0, colour, 2.4);
        }
    }
    let prime = if axis.branch == Branch::Workpiece { "'" } else { "" };
    let name = if axis.indexed { format!("({}{prime})", axis.name) } else { format!("{}{prime}", axis.name) };
    drawing.text(
        [centre[0], centre[1] - 50.0],
        &name,
        "middle",
        &format!("fill=\"{colour}\" font-size=\"15\" font-weight=\"bold\""),
    );
    let (what, factor, unit) = match axis.kind {
        AxisKind::Linear => ("moves", 1.0, " mm"),
        AxisKind::Rotary => ("turns", 1f64.to_degrees(), "°"),
    };
    let small = format!("font-size=\"{}\"", if wide < 110.0 { 10 } else { 11 });
    let about = format!("{what} {}", crate::machine::nearest(axis));
    drawing.text([centre[0], centre[1] + 58.0], &about, "middle", &small);
    if let Some([from, to]) = axis.range {
        let range = format!("{} to {}{unit}", crate::machine::tidy(from * factor), crate::machine::tidy(to * factor));
        drawing.text([centre[0], centre[1] + 72.0], &range, "middle", &format!("{small} fill=\"{GREY}\""));
    }
}

//! Where frames, axes and tool are, at a stand.

use abbe_core::{AxisKind, Branch, KinematicModel, Poses, Result, Variable};
use abbe_engine::Described;

use super::draw::{Drawing, GREY, SIDES, seen};
use super::{EDGE, WIDTH, side};
use crate::effects::{Effect, Stand, digits, norm, vector};
use crate::explain::foot_of;

/// Room for the view.
const ROOM: [f64; 2] = [720.0, 360.0];

/// Smallest part of space that is shown, mm.
const SMALLEST: f64 = 200.0;

/// From space to the page.
struct View {
    middle: [f64; 2],
    centre: [f64; 2],
    scale: f64,
}

impl View {
    /// All points in the room below `above`.
    fn of(points: &[[f64; 3]], above: f64) -> Self {
        let flat: Vec<[f64; 2]> = points.iter().map(|point| seen(*point)).collect();
        let ends = |part: usize| {
            let each = flat.iter().map(|point| point[part]);
            each.fold((f64::INFINITY, f64::NEG_INFINITY), |(least, most), one| (least.min(one), most.max(one)))
        };
        let (x, y) = (ends(0), ends(1));
        let scale = |(from, to): (f64, f64), room: f64| (room - 180.0) / (to - from).max(SMALLEST);
        Self {
            middle: [(x.0 + x.1) / 2.0, (y.0 + y.1) / 2.0],
            centre: [EDGE + ROOM[0] / 2.0, above + ROOM[1] / 2.0],
            scale: scale(x, ROOM[0]).min(scale(y, ROOM[1])),
        }
    }

    fn at(&self, point: [f64; 3]) -> [f64; 2] {
        let flat = seen(point);
        [0, 1].map(|part| self.centre[part] + (flat[part] - self.middle[part]) * self.scale)
    }
}

/// The columns of the rotation of a unit quaternion.
fn columns([w, x, y, z]: [f64; 4]) -> [[f64; 3]; 3] {
    [
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y)],
        [2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x)],
        [2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)],
    ]
}

fn moved(from: [f64; 3], along: [f64; 3], by: f64) -> [f64; 3] {
    [0, 1, 2].map(|part| from[part] + along[part] * by)
}

/// What a positive command of each axis does to the tool, table frame.
fn motions(model: &dyn KinematicModel, stand: &Stand) -> Result<Vec<Effect>> {
    let wanted: Vec<Variable> = (0..model.info().axes.len()).map(Variable::Command).collect();
    let mut poses = Poses::default();
    model.poses(&stand.status, &model.info().without_errors(), &wanted, true, &mut poses)?;
    let both = poses.position_derivatives.iter().zip(&poses.rotation_derivatives);
    Ok(both.map(|(shift, turn)| Effect { shift: *shift, turn: *turn }).collect())
}

/// Draws the view and what stands beside it; gives where it ends.
pub fn draw(drawing: &mut Drawing, machine: &Described, stand: &Stand, above: f64) -> Result<f64> {
    let (model, info) = (machine.model.as_ref(), machine.model.info());
    let motions = motions(model, stand)?;
    let is_robot = info.axes.iter().all(|axis| axis.kind == AxisKind::Rotary && axis.branch == Branch::Tool);
    let tool = columns(stand.turned);
    let stated = info.settings.get("tool_length_mm").and_then(serde_json::Value::as_f64).unwrap_or(0.0);
    let holder = moved(stand.tip, tool[2], stated.max(0.0));
    // The point of each rotary axis that is shown: nearest to the table, to the tool, or to the joint before.
    let mut before = [0.0; 3];
    let mut lines = Vec::new();
    for (axis, motion) in info.axes.iter().zip(&motions).filter(|(axis, _)| axis.kind == AxisKind::Rotary) {
        let near = match (is_robot, axis.branch) {
            (true, _) => before,
            (false, Branch::Workpiece) => [0.0; 3],
            (false, Branch::Tool) => holder,
        };
        let foot = foot_of(stand.tip, motion);
        let along = [0, 1, 2].map(|part| motion.turn[part] / norm(motion.turn).max(1e-12));
        let by: f64 = (0..3).map(|part| (near[part] - foot[part]) * along[part]).sum();
        before = moved(foot, along, by);
        lines.push((axis, before, along));
    }
    let mut points = vec![[0.0; 3], stand.tip, holder];
    points.extend(lines.iter().map(|(_, point, _)| *point));
    let view = View::of(&points, above);
    let reach = 60.0 / view.scale;

    table(drawing, &view, reach);
    for (axis, point, along) in &lines {
        let [from, to] = [view.at(moved(*point, *along, -1.3 * reach)), view.at(moved(*point, *along, 1.3 * reach))];
        drawing.line(from, to, side(axis), 1.2, true);
        drawing.turn(view.at(*point), *along, 24.0, side(axis), 1.8);
        // Beside the arc, away from the line, so that names of lines that are near each other stand apart.
        let at = view.at(*point);
        let [right, down] = [from, to].map(|end| [end[0] - at[0], end[1] - at[1]])[1];
        let length = right.hypot(down).max(1.0);
        let name = if is_robot {
            [at[0] + 14.0 - 24.0 * down.abs() / length, at[1] - 34.0 + 10.0 * right.abs() / length]
        } else {
            [to[0] + 5.0, to[1] - 3.0]
        };
        drawing.text(name, &axis.name, "start", &label(side(axis)));
    }
    if is_robot {
        let mut from = [0.0; 3];
        for to in lines.iter().map(|(_, point, _)| *point).chain([stand.tip]) {
            drawing.line(view.at(from), view.at(to), SIDES[1], 5.0, false);
            drawing.dot(view.at(to), 4.0, SIDES[1]);
            from = to;
        }
    }
    for (axis, motion) in info.axes.iter().zip(&motions).filter(|(axis, _)| axis.kind == AxisKind::Linear) {
        let from = if axis.branch == Branch::Tool {
            moved(holder, tool[2], 0.25 * reach)
        } else {
            moved([0.0; 3], [-1.0, -1.0, 0.0], 0.75 * reach)
        };
        let to = moved(from, motion.shift, 0.85 * reach);
        drawing.arrow(view.at(from), view.at(to), side(axis), 2.4);
        let name = view.at(moved(from, motion.shift, 1.02 * reach));
        drawing.text([name[0], name[1] + 4.0], &axis.name, "middle", &label(side(axis)));
    }
    drawing.line(view.at(stand.tip), view.at(holder), SIDES[1], 3.0, false);
    drawing.dot(view.at(holder), 5.0, SIDES[1]);
    drawing.frame(view.at([0.0; 3]), [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], 34.0, true);
    drawing.frame(view.at(stand.tip), tool, 22.0, false);
    drawing.dot(view.at(stand.tip), 4.0, "black");
    beside(
        drawing,
        machine,
        stand,
        &lines.iter().map(|(axis, point, along)| (axis.name.as_str(), *point, *along)).collect::<Vec<_>>(),
        above,
    );
    Ok(above + ROOM[1])
}

fn label(colour: &str) -> String {
    format!("fill=\"{colour}\" font-size=\"14\" font-weight=\"bold\"")
}

/// The table: a square about its frame.
fn table(drawing: &mut Drawing, view: &View, reach: f64) {
    let half = 0.75 * reach;
    let corners = [[-half, -half], [half, -half], [half, half], [-half, half]].map(|[x, y]| view.at([x, y, 0.0]));
    drawing.area(&corners, "#fbf3e4", SIDES[0]);
}

/// What stands beside the view.
fn beside(drawing: &mut Drawing, machine: &Described, stand: &Stand, lines: &[(&str, [f64; 3], [f64; 3])], above: f64) {
    let left = EDGE + ROOM[0] + 10.0;
    let mut row = above + 30.0;
    let mut tell = |drawing: &mut Drawing, text: &str, style: &str| {
        for line in crate::lines::rows(text, ((WIDTH - EDGE - left) / 6.2) as usize) {
            drawing.text([left, row], line.trim(), "start", style);
            row += 17.0;
        }
        row += 4.0;
    };
    let info = machine.model.info();
    tell(drawing, &format!("Axes stand at {}.", stand.text(info)), "");
    tell(
        drawing,
        "Table frame: the large arrows x, y, z; the square is the table. Its origin is the point of the last rotary axis that carries the workpiece, else that of the machine.",
        &format!("fill=\"{}\"", SIDES[0]),
    );
    tell(
        drawing,
        &format!(
            "Tool tip: the black dot, at {} mm of the table frame; small arrows: the frame of the tool.",
            vector(stand.tip)
        ),
        &format!("fill=\"{}\"", SIDES[1]),
    );
    for (name, point, along) in lines {
        tell(
            drawing,
            &format!(
                "Line of {name}: through {} mm, direction {}.",
                vector(point.map(|part| (part * 1e3).round() / 1e3)),
                vector(*along)
            ),
            "",
        );
    }
    tell(
        drawing,
        &format!(
            "{} mm from the tip to the end of the line on the tool, its length.",
            digits(info.settings.get("tool_length_mm").and_then(serde_json::Value::as_f64).unwrap_or(0.0))
        ),
        &format!("fill=\"{GREY}\""),
    );
}

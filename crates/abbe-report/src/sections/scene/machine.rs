//! The machine as a chain of rigid motions, for a schematic: each axis moves what it carries along or about a line.

use abbe_core::{Axis, AxisKind, Branch, KinematicModel, Poses};
use abbe_volumetric::standing;
use serde_json::{Value, json};

use crate::analysis::{travel, unit};
use crate::html::escape;
use crate::run::FitResult;

/// Statuses at which the chain has to agree with the model.
const TRIED: usize = 6;

/// Largest difference, as part of the distances in the machine.
const CLOSE: f64 = 1e-6;

/// How far a linear axis moves where nothing says it, mm, and a rotary one, rad.
const UNKNOWN: [f64; 2] = [100.0, std::f64::consts::FRAC_PI_2];

/// A schematic: all in the table frame with all axes at zero.
pub struct Machine {
    axes: Vec<Link>,
    tip: [f64; 3],
    tool: [f64; 3],
    length: Option<f64>,
}

struct Link {
    name: String,
    kind: AxisKind,
    on_tool: bool,
    is_indexed: bool,
    sense: f64,
    direction: [f64; 3],
    /// A point of the line of a rotary axis.
    point: [f64; 3],
    range: [f64; 2],
}

impl Machine {
    /// The schematic; none of a machine that is no chain of such motions.
    pub fn of(fit: &FitResult) -> Option<Self> {
        let model = fit.model.as_ref();
        let axes = &model.info().axes;
        if axes.is_empty() {
            return None;
        }
        let (tip, turned) = pose(model, &standing(model))?;
        let travel = travel(fit);
        let links = axes.iter().enumerate().map(|(index, axis)| link(model, axis, index, tip, travel[index]));
        let length = model.info().settings.get("tool_length_mm").and_then(Value::as_f64);
        let machine = Self { axes: links.collect::<Option<_>>()?, tip, tool: along_tool(turned), length };
        machine.agrees(model).then_some(machine)
    }

    /// Whether the chain has the tips of the model.
    fn agrees(&self, model: &dyn KinematicModel) -> bool {
        let axes = &model.info().axes;
        (1..=TRIED).all(|number| {
            let mut status = standing(model);
            let mut commands = Vec::new();
            for (index, (axis, link)) in axes.iter().zip(&self.axes).enumerate() {
                // Places spread over the ranges, others for each axis.
                let part = (number as f64 * 0.618_034 + index as f64 * 0.414_214).fract();
                let command = link.range[0] + (link.range[1] - link.range[0]) * part;
                status[axis.status] = command;
                commands.push(command);
            }
            let Some((actual, _)) = pose(model, &status) else { return false };
            let expected = self.tip_at(&commands);
            let size = 1.0 + distance(actual, [0.0; 3]);
            distance(actual, expected) < CLOSE * size
        })
    }

    /// The tip in the table frame: the motions of the tool's side carry it, those of the workpiece's side carry the table.
    fn tip_at(&self, commands: &[f64]) -> [f64; 3] {
        let links = || self.axes.iter().zip(commands);
        // From the tool to the bed, then from the bed to the workpiece.
        let in_bed = links().rev().filter(|(link, _)| link.on_tool);
        let tip = in_bed.fold(self.tip, |at, (link, command)| link.moved(at, *command));
        let to_table = links().rev().filter(|(link, _)| !link.on_tool);
        to_table.fold(tip, |at, (link, command)| link.moved(at, -command))
    }

    /// What the script needs; `columns` are the axes whose commands the points have.
    pub fn json(&self, columns: &[(String, String)]) -> Value {
        let axes = self.axes.iter().map(|link| {
            json!({
                "name": link.name,
                "turns": link.kind == AxisKind::Rotary,
                "tool": link.on_tool,
                "sense": link.sense,
                "u": link.direction,
                "p": link.point,
                "range": link.range.map(|end| end * unit(link.kind).1),
                "column": columns.iter().position(|(name, _)| *name == link.name),
            })
        });
        json!({ "axes": axes.collect::<Vec<_>>(), "tip": self.tip, "tool": self.tool, "length": self.length })
    }

    /// A slider for each axis.
    pub fn controls(&self) -> String {
        let sliders: String = self.axes.iter().enumerate().map(|(index, link)| slider(index, link)).collect();
        format!(
            "<p class=\"controls\"><label><input data-part=\"machine\" type=\"checkbox\" checked> Machine (schematic)</label>\n{sliders}</p>\n"
        )
    }
}

fn slider(index: usize, link: &Link) -> String {
    if link.is_indexed {
        return String::new();
    }
    let (symbol, factor) = unit(link.kind);
    let [from, to] = link.range.map(|end| end * factor);
    let start = 0.0_f64.clamp(from, to);
    let step = (to - from) / 1000.0;
    format!(
        "<label>{} <input data-axis=\"{index}\" type=\"range\" min=\"{from:.4}\" max=\"{to:.4}\" step=\"{step:.4e}\" value=\"{start:.4}\"> <span \
         data-told-axis=\"{index}\"></span> {symbol}</label>\n",
        escape(&link.name)
    )
}

impl Link {
    /// A point that the axis carries, at a command.
    fn moved(&self, at: [f64; 3], command: f64) -> [f64; 3] {
        let by = self.sense * command;
        let u = self.direction;
        match self.kind {
            AxisKind::Linear => [0, 1, 2].map(|part| at[part] + by * u[part]),
            AxisKind::Rotary => {
                let (sine, cosine) = by.sin_cos();
                let arm = [0, 1, 2].map(|part| at[part] - self.point[part]);
                let along = dot(u, arm) * (1.0 - cosine);
                let across =
                    [u[1] * arm[2] - u[2] * arm[1], u[2] * arm[0] - u[0] * arm[2], u[0] * arm[1] - u[1] * arm[0]];
                [0, 1, 2].map(|part| self.point[part] + cosine * arm[part] + sine * across[part] + along * u[part])
            }
        }
    }
}

/// An axis with its line: half a turn of a rotary axis has its line in the middle of both tips.
fn link(
    model: &dyn KinematicModel,
    axis: &Axis,
    index: usize,
    tip: [f64; 3],
    travel: Option<[f64; 2]>,
) -> Option<Link> {
    let mut point = [0.0; 3];
    if axis.kind == AxisKind::Rotary {
        let mut status = standing(model);
        status[axis.status] = std::f64::consts::PI;
        let (other, _) = pose(model, &status)?;
        point = [0, 1, 2].map(|part| tip[part].midpoint(other[part]));
    }
    let most = UNKNOWN[usize::from(axis.kind == AxisKind::Rotary)];
    let range = travel.filter(|[from, to]| to > from).unwrap_or([-most, most]);
    let axis = &model.info().axes[index];
    Some(Link {
        name: axis.name.clone(),
        kind: axis.kind,
        on_tool: axis.branch == Branch::Tool,
        is_indexed: axis.indexed,
        sense: axis.sense,
        direction: axis.direction,
        point,
        range,
    })
}

/// Tip and orientation of the machine without errors.
fn pose(model: &dyn KinematicModel, status: &[f64]) -> Option<([f64; 3], [f64; 4])> {
    let mut poses = Poses::default();
    model.poses(status, &model.info().without_errors(), &[], true, &mut poses).ok()?;
    let (tip, turned) = (*poses.positions.first()?, *poses.orientations.first()?);
    tip.iter().chain(&turned).all(|number| number.is_finite()).then_some((tip, turned))
}

/// The direction from the tip into the tool: z of an orientation.
fn along_tool([w, x, y, z]: [f64; 4]) -> [f64; 3] {
    [2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)]
}

fn dot(one: [f64; 3], other: [f64; 3]) -> f64 {
    one.iter().zip(other).map(|(one, other)| one * other).sum()
}

fn distance(one: [f64; 3], other: [f64; 3]) -> f64 {
    let apart = [0, 1, 2].map(|part| one[part] - other[part]);
    dot(apart, apart).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn link(name: &str, kind: AxisKind, on_tool: bool, direction: [f64; 3], point: [f64; 3]) -> Link {
        let sense = if on_tool { 1.0 } else { -1.0 };
        Link { name: name.to_owned(), kind, on_tool, is_indexed: false, sense, direction, point, range: [-1.0, 1.0] }
    }

    /// `w C' b X t`: the table turns about the point (10, 0, 0), the tool moves along X.
    #[test]
    fn both_sides_of_the_bed_move_the_tip() {
        let axes = vec![
            link("C", AxisKind::Rotary, false, [0.0, 0.0, 1.0], [10.0, 0.0, 0.0]),
            link("X", AxisKind::Linear, true, [1.0, 0.0, 0.0], [0.0; 3]),
        ];
        let machine = Machine { axes, tip: [10.0, 0.0, 50.0], tool: [0.0, 0.0, 1.0], length: None };
        // The tool goes 5 to the right; the table turns by -90 degrees, so that the tip turns by +90 degrees in it.
        let tip = machine.tip_at(&[std::f64::consts::FRAC_PI_2, 5.0]);
        assert!(distance(tip, [10.0, 5.0, 50.0]) < 1e-12, "{tip:?}");
        assert_eq!(along_tool([1.0, 0.0, 0.0, 0.0]), [0.0, 0.0, 1.0]);
    }
}

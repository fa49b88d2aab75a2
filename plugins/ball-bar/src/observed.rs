//! The equations of a ball bar.

use abbe_core::{Contact, Equations, Feature, KnownInput, Layout, NominalReading, Observations, Parameter, PoseValues};
use nalgebra::{Quaternion, UnitQuaternion, Vector3};

/// Names of the known inputs that are the tool ball's place relative to the tip, in the directions of the tool.
pub const TOOL_BALL: [&str; 3] = ["tool_ball.x", "tool_ball.y", "tool_ball.z"];

/// A nominal pivot ball, table frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Ball {
    pub label: String,
    pub centre: Vector3<f64>,
}

/// The length of a bar from which its readings are counted.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Bar {
    /// A known input.
    Known { input: usize },
    /// An own unknown that starts at its nominal value.
    Unknown { own: usize, nominal: f64 },
}

/// Readings of a ball bar.
pub struct Observed {
    pub layout: Layout,
    /// Three offsets for every ball, then the lengths if they are estimated.
    pub unknowns: Vec<Parameter>,
    /// The tool ball's place if it is uncertain, then the lengths if they are known.
    pub inputs: Vec<KnownInput>,
    pub balls: Vec<Ball>,
    pub ball_of_row: Vec<usize>,
    pub bars: Vec<Bar>,
    pub bar_of_row: Vec<usize>,
    /// Length minus that of the bar, mm.
    pub readings: Vec<f64>,
    /// Whether the tool ball's place is a known input.
    pub tool_ball: bool,
    /// Nominal contact of the rows that have one.
    pub nominal: Vec<Option<NominalReading>>,
}

impl Observations for Observed {
    fn layout(&self) -> &Layout {
        &self.layout
    }

    fn unknowns(&self) -> &[Parameter] {
        &self.unknowns
    }

    fn start(&self) -> Vec<f64> {
        let mut start = vec![0.0; self.unknowns.len()];
        for bar in &self.bars {
            if let Bar::Unknown { own, nominal } = bar {
                start[*own] = *nominal;
            }
        }
        start
    }

    fn inputs(&self) -> &[KnownInput] {
        &self.inputs
    }

    fn needs_orientation(&self) -> bool {
        self.tool_ball
    }

    fn evaluate(&self, rows: &[usize], poses: PoseValues<'_>, own: &[f64], inputs: &[f64], out: &mut Equations) {
        for (place, (&row, position)) in rows.iter().zip(poses.positions).enumerate() {
            let orientation = match poses.orientations.get(place) {
                Some(&[w, x, y, z]) if self.tool_ball => {
                    Some(UnitQuaternion::new_unchecked(Quaternion::new(w, x, y, z)))
                }
                _ => None,
            };
            let beside =
                orientation.map_or(Vector3::zeros(), |turn| turn * Vector3::new(inputs[0], inputs[1], inputs[2]));
            let ball = self.ball_of_row[row];
            let centre = self.balls[ball].centre + Vector3::new(own[3 * ball], own[3 * ball + 1], own[3 * ball + 2]);
            let bar = Vector3::from(*position) + beside - centre;
            let direction = bar.normalize();
            let length = match self.bars[self.bar_of_row[row]] {
                Bar::Known { input } => inputs[input],
                Bar::Unknown { own: unknown, .. } => own[unknown],
            };
            out.equation(bar.norm() - (length + self.readings[row]));
            out.position(direction.into());
            (0..3).for_each(|axis| out.own(3 * ball + axis, -direction[axis]));
            match self.bars[self.bar_of_row[row]] {
                Bar::Known { input } => out.input(input, -1.0),
                Bar::Unknown { own: unknown, .. } => out.own(unknown, -1.0),
            }
            if let Some(turn) = orientation {
                // A turn w moves the tool ball by w x (its place beside the tip).
                out.rotation(beside.cross(&direction).into());
                let in_tool = turn.inverse() * direction;
                (0..3).for_each(|axis| out.input(axis, in_tool[axis]));
            }
        }
    }

    fn features(&self) -> Vec<Feature> {
        let balls = self.balls.iter().enumerate();
        let unit = |axis: usize| std::array::from_fn(|index| if index == axis { 1.0 } else { 0.0 });
        balls
            .map(|(index, ball)| Feature {
                label: ball.label.clone(),
                point: ball.centre.into(),
                shifts: (0..3).map(|axis| (3 * index + axis, unit(axis))).collect(),
            })
            .collect()
    }

    fn contact(&self) -> Contact {
        Contact::Reading("reading".to_owned())
    }

    fn nominal_reading(&self, row: usize) -> Option<&NominalReading> {
        self.nominal[row].as_ref()
    }
}

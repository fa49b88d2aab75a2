//! The equations of a ball bar.

use abbe_core::{Equations, Feature, Observations, ObservationsInfo, Result, RowBatch, RowIndex};
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
    /// Own unknowns: three offsets for every ball, then the lengths if they are estimated. Known inputs: the tool ball's place if
    /// it is uncertain, then the lengths if they are known.
    pub info: ObservationsInfo,
    pub balls: Vec<Ball>,
    pub ball_of_row: Vec<usize>,
    pub bars: Vec<Bar>,
    pub bar_of_row: Vec<usize>,
    /// Length minus that of the bar, mm.
    pub readings: Vec<f64>,
    /// Whether the tool ball's place is a known input.
    pub tool_ball: bool,
    /// The nominal direction of the bar in every row where readings follow errors to first order.
    pub directions: Option<Vec<Vector3<f64>>>,
}

impl Observations for Observed {
    fn info(&self) -> &ObservationsInfo {
        &self.info
    }

    fn evaluate(&self, batch: RowBatch<'_>, out: &mut Equations) -> Result<()> {
        let RowBatch { own, inputs, .. } = batch;
        for (place, (&RowIndex(row), position)) in batch.rows.iter().zip(batch.positions).enumerate() {
            let orientation = match batch.orientations.get(place) {
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
            let (direction, measured) = match &self.directions {
                Some(directions) => (directions[row], directions[row].dot(&bar)),
                None => (bar.normalize(), bar.norm()),
            };
            let length = match self.bars[self.bar_of_row[row]] {
                Bar::Known { input } => inputs[input],
                Bar::Unknown { own: unknown, .. } => own[unknown],
            };
            out.equation(measured - (length + self.readings[row]));
            out.position(direction.into());
            (0..3).for_each(|axis| out.own(3 * ball + axis, -direction[axis]));
            match self.bars[self.bar_of_row[row]] {
                Bar::Known { input } => out.input(input, -1.0),
                Bar::Unknown { own: unknown, .. } => out.own(unknown, -1.0),
            }
            if let Some(turn) = orientation {
                // A rotation w moves the tool ball by w x (position of the ball relative to the tip).
                out.rotation(beside.cross(&direction).into());
                let in_tool = turn.inverse() * direction;
                (0..3).for_each(|axis| out.input(axis, in_tool[axis]));
            }
        }
        Ok(())
    }
}

/// The balls as features, each shifted by its three offsets.
pub fn features(balls: &[Ball]) -> Vec<Feature> {
    let unit = |axis: usize| std::array::from_fn(|index| if index == axis { 1.0 } else { 0.0 });
    let feature = |(index, ball): (usize, &Ball)| Feature {
        label: ball.label.clone(),
        point: ball.centre.into(),
        shifts: (0..3).map(|axis| (3 * index + axis, unit(axis))).collect(),
    };
    balls.iter().enumerate().map(feature).collect()
}

//! A lost direction, and its effect on hypothetical measurements.

use abbe_core::{Owner, ParameterRole, Poses, ProbeTerm, Problem, Quantity, Result, Unknown, Variable, WeakDirection};
use nalgebra::{DMatrix, DVector, Vector3};

use super::{Measured, words};

/// Derivatives below this, in mm or rad per unit of the unknown, are rounding errors of zero.
const ZERO: f64 = 1e-9;

/// Effect of a direction on a measurement.
#[derive(Debug, Clone, Copy, Default)]
pub struct Effect {
    /// The largest change of a residual along the direction.
    pub change: f64,
    /// The largest movement of the tip, including a common movement that the place of a new feature absorbs.
    pub moved: f64,
    /// The largest change by one of the unknowns alone.
    pub single: f64,
}

impl Effect {
    /// The change relative to the largest change by a single unknown; zero if no unknown has an effect.
    pub fn relative(&self) -> f64 {
        if self.single > 0.0 { self.change / self.single } else { 0.0 }
    }
}

/// A change of unknowns.
pub struct LostDirection<'a> {
    problem: &'a Problem,
    /// The unknowns, and by how much each changes in its unit.
    members: Vec<(Unknown, f64)>,
}

impl<'a> LostDirection<'a> {
    pub fn new(problem: &'a Problem, vector: &WeakDirection) -> Result<Self> {
        let mut members = Vec::new();
        for part in &vector.combination {
            let unknown = problem.unknowns.iter().find(|unknown| unknown.name == part.name);
            let unknown = unknown.ok_or_else(|| {
                abbe_core::Error::data(format!("`{}` is no unknown of `{}`", part.name, problem.name))
            })?;
            members.push((unknown.clone(), part.coefficient));
        }
        Ok(Self { problem, members })
    }

    /// Whether a rotation of the machine takes part.
    pub fn turns(&self) -> bool {
        let of_machine = self.members.iter().filter(|(unknown, _)| unknown.is_of_machine());
        of_machine.into_iter().any(|(unknown, _)| unknown.unit.of == Quantity::Angle)
    }

    /// The effect of the direction on a measurement.
    pub fn effect(&self, measured: &Measured) -> Result<Effect> {
        match measured {
            Measured::Rows(problem) => self.on_rows(problem, &[]),
            Measured::OtherProbe(problem, own) => self.on_rows(problem, own),
            Measured::Point(statuses) => {
                let field = self.field(statuses)?;
                let mean = field.changes.iter().sum::<Vector3<f64>>() / field.changes.len().max(1) as f64;
                let change = field.changes.iter().map(|change| (change - mean).norm()).fold(0.0, f64::max);
                Ok(Effect { change, ..field.effect() })
            }
            Measured::Length(ends, along) => {
                let field = self.field(ends)?;
                let change = (field.changes[1] - field.changes[0]).dot(&Vector3::from(*along)).abs();
                Ok(Effect { change, ..field.effect() })
            }
        }
    }

    /// The effect on residuals, as multiples of their standard uncertainties, without what the unknowns `own` of the measurement
    /// take up.
    fn on_rows(&self, problem: &Problem, own: &[Unknown]) -> Result<Effect> {
        let mut problem = problem.clone();
        let members = self.members.iter().map(|(unknown, _)| unknown);
        problem.unknowns = members.chain(own).cloned().collect();
        let (uncertainties, start) = (problem.standard_uncertainties(), problem.start());
        let (mut effect, mut changes, mut taken_up) = (Effect::default(), Vec::new(), Vec::new());
        problem.linearise(&start, |block| {
            for (equation, _, line) in block.lines() {
                let uncertainty = uncertainties[equation];
                let (of_members, of_own) = line.split_at(self.members.len());
                let parts =
                    of_members.iter().zip(&self.members).map(|(by, (_, change))| clean(*by) * change / uncertainty);
                let parts: Vec<f64> = parts.collect();
                changes.push(parts.iter().sum::<f64>());
                taken_up.extend(of_own.iter().map(|by| by / uncertainty));
                effect.single = parts.iter().fold(effect.single, |single, part| single.max(part.abs()));
            }
        })?;
        let mut changes = DVector::from_vec(changes);
        if !own.is_empty() {
            let taken_up = DMatrix::from_row_slice(changes.len(), own.len(), &taken_up);
            if let Ok(fitted) = taken_up.clone().svd(true, true).solve(&changes, 1e-9) {
                changes -= taken_up * fitted;
            }
        }
        effect.change = changes.iter().fold(0.0, |largest: f64, change| largest.max(change.abs()));
        Ok(effect)
    }

    /// How the tip moves at some statuses.
    fn field(&self, statuses: &[Vec<f64>]) -> Result<Field> {
        let parameters = self.members.iter().flat_map(|(unknown, change)| match unknown.owner {
            Owner::Machine => vec![(unknown.index, *change)],
            _ => self.problem.members_of(unknown).iter().map(|(index, factor)| (*index, factor * change)).collect(),
        });
        let (wanted, changes): (Vec<Variable>, Vec<f64>) =
            parameters.map(|(index, change)| (Variable::Parameter(index), change)).unzip();
        let mut poses = Poses::default();
        self.problem.model.poses(&statuses.concat(), &self.problem.machine_values, &wanted, false, &mut poses)?;
        let mut field = Field { changes: vec![Vector3::zeros(); statuses.len()], single: 0.0 };
        let count = wanted.len().max(1);
        for (sum, derivatives) in field.changes.iter_mut().zip(poses.position_derivatives.chunks_exact(count)) {
            for (derivative, change) in derivatives.iter().zip(&changes) {
                let part = Vector3::from(derivative.map(clean)) * *change;
                field.single = field.single.max(part.norm());
                *sum += part;
            }
        }
        Ok(field)
    }

    /// Whether the delay of a probe takes part.
    fn has_delay(&self) -> bool {
        let parameters = &self.problem.model.info().parameters;
        let of_machine = self.members.iter().filter(|(unknown, _)| unknown.owner == Owner::Machine);
        let mut roles = of_machine.map(|(unknown, _)| parameters[unknown.index].role);
        roles.any(|role| matches!(role, ParameterRole::Probe { term: ProbeTerm::Delay, .. }))
    }

    /// What to do if no measurement separates the direction, given whether it moves the tip anywhere.
    pub fn without_measurement(&self, moves: bool) -> String {
        let (alone, [verb, noun, _]) = (self.members.len() == 1, words(self.problem));
        if self.members.iter().all(|(unknown, _)| !unknown.is_of_machine()) {
            let features = listed_features(&self.members);
            return format!("{verb} {features} from more directions or at more indexations");
        }
        if self.has_delay() {
            return format!("{verb} at other feeds as well: what a delay does follows the feed");
        }
        match (alone, moves) {
            (true, false) => format!("leave it out: it does nothing to the tip, no {noun} can tell it"),
            (false, false) => {
                format!("leave one out: they do the same to the tip everywhere, no {noun} can tell them apart")
            }
            (_, true) => format!(
                "{verb} features whose places on the table are known, or leave one out: everything on the table moves alike"
            ),
        }
    }
}

fn clean(derivative: f64) -> f64 {
    if derivative.abs() < ZERO { 0.0 } else { derivative }
}

/// How the tip moves along a direction.
struct Field {
    changes: Vec<Vector3<f64>>,
    single: f64,
}

impl Field {
    fn effect(&self) -> Effect {
        let moved = self.changes.iter().map(Vector3::norm).fold(0.0, f64::max);
        Effect { change: 0.0, moved, single: self.single }
    }
}

/// The features that the unknowns belong to: `table.ball[3]` for `table.ball[3].x`.
fn listed_features(members: &[(Unknown, f64)]) -> String {
    let mut features: Vec<String> = Vec::new();
    for (unknown, _) in members {
        let feature = unknown.name.rsplit_once('.').map_or(unknown.name.as_str(), |(feature, _)| feature);
        if !features.iter().any(|known| known == feature) {
            features.push(feature.to_owned());
        }
    }
    super::listed(&features)
}

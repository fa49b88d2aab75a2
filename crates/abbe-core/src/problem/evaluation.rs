//! Poses and equations of some rows, and the chain rule over both.

use std::ops::Range;

use super::rows::ObservationSet;
use crate::factored::FactoredPoses;
use crate::index::RowIndex;
use crate::model::Poses;
use crate::observations::Equations;

/// Poses and equations of some rows, and the buffers of their evaluation.
#[derive(Debug, Default)]
pub struct Evaluation {
    pub(super) statuses: Vec<f64>,
    /// The poses, one after another in the order of the rows.
    pub poses: Poses,
    /// The equations, in the same order.
    pub equations: Equations,
    /// The poses of rows that are linearised, with derivatives in factors.
    pub(super) factored: FactoredPoses,
    /// Derivatives to the unknowns of these rows, equations x unknowns.
    pub(super) jacobian: Vec<f64>,
}

impl Evaluation {
    pub(super) fn take_statuses(&mut self, set: &ObservationSet, rows: &[RowIndex]) {
        self.statuses.clear();
        set.poses_of(rows).for_each(|pose| self.statuses.extend_from_slice(set.poses().row(pose)));
    }

    /// Adds the derivatives of all equations by the machine to a matrix of `count` columns; `places` has the column of every term, and
    /// a number that the term is multiplied by.
    pub(super) fn chain_factored(
        &self,
        set: &ObservationSet,
        rows: &[RowIndex],
        places: &[(usize, f64)],
        count: usize,
        jacobian: &mut [f64],
    ) {
        self.each_effect(set, rows, |equation, factors, run, along| {
            let line = &mut jacobian[equation * count..(equation + 1) * count];
            for (&(column, own), factor) in places[run.clone()].iter().zip(&factors[run]) {
                line[column] += own * factor * along;
            }
        });
    }

    /// Calls `take` for every effect that an equation sees at a pose, with the equation, the factors of the pose, the range of those that
    /// share the effect, and d(residual)/d(effect).
    #[inline]
    pub(super) fn each_effect(
        &self,
        set: &ObservationSet,
        rows: &[RowIndex],
        mut take: impl FnMut(usize, &[f64], Range<usize>, f64),
    ) {
        let FactoredPoses { terms, effects, factors, position_effects, rotation_effects, .. } = &self.factored;
        let runs: Vec<(usize, Range<usize>)> = self.factored.runs().collect();
        let (mut equation, mut pair, mut first_pose) = (0, 0, 0);
        for row in rows.iter().map(|&row| &set.info().layout.rows[row]) {
            for _ in 0..row.equations {
                for pose in first_pose..first_pose + row.poses {
                    let by_position = &self.equations.by_position[pair];
                    let by_rotation = self.equations.by_rotation.get(pair);
                    let factors = &factors[pose * terms.len()..(pose + 1) * terms.len()];
                    for (effect, run) in &runs {
                        let effect = pose * effects + effect;
                        let turned = by_rotation.map_or(0.0, |by| along(by, &rotation_effects[effect]));
                        let along = along(by_position, &position_effects[effect]) + turned;
                        // A reading sees few of the errors.
                        if along != 0.0 {
                            take(equation, factors, run.clone(), along);
                        }
                    }
                    pair += 1;
                }
                equation += 1;
            }
            first_pose += row.poses;
        }
    }

    /// Calls `add` with (equation, number of the pair of equation and pose, derivatives of the pose to the variables,
    /// d(residual)/d(that pose)) for every equation and pose; once for positions and, where they are needed, once for rotations.
    pub fn chain(
        &self,
        set: &ObservationSet,
        rows: &[RowIndex],
        variables: usize,
        mut add: impl FnMut(usize, usize, &[[f64; 3]], &[f64; 3]),
    ) {
        let (mut equation, mut pair, mut first_pose) = (0, 0, 0);
        for row in rows.iter().map(|&row| &set.info().layout.rows[row]) {
            for _ in 0..row.equations {
                for pose in first_pose..first_pose + row.poses {
                    let range = pose * variables..(pose + 1) * variables;
                    let by_position = &self.equations.by_position[pair];
                    add(equation, pair, &self.poses.position_derivatives[range.clone()], by_position);
                    if let Some(by_rotation) = self.equations.by_rotation.get(pair) {
                        add(equation, pair, &self.poses.rotation_derivatives[range], by_rotation);
                    }
                    pair += 1;
                }
                equation += 1;
            }
            first_pose += row.poses;
        }
    }
}

fn along(weight: &[f64; 3], effect: &[f64; 3]) -> f64 {
    weight[0] * effect[0] + weight[1] * effect[1] + weight[2] * effect[2]
}

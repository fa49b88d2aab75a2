//! Interpolation tests: rotary axes turn, and linear axes keep the tip at a point of the table.

use std::collections::BTreeMap;

use abbe_core::{AxisKind, Error, PathItem, Result, StatusRole, Target};

use super::{AT_REST, Grid, MOST, wrong_grid};
use crate::settings::{Generation, Interpolation};

impl Grid<'_> {
    /// The rows of all tests: every test goes up, and back where both ways are measured. `direction` is that of the way.
    ///
    /// Fails for balls that the artefact does not have, axes that the machine does not have, and positions that its axes do not reach:
    /// a part of such a test is none.
    pub(super) fn interpolations(&self, wanted: &Generation, targets: &[Target]) -> Result<String> {
        let mut rows = Vec::new();
        for (place, test) in wanted.interpolations.iter().enumerate() {
            let at = |mut error: Error| {
                error.setting.push(PathItem::Index(place));
                error
            };
            let ball = ball(test, targets).map_err(at)?;
            let tip = [0, 1, 2].map(|axis| ball[axis] + test.beside_mm[axis]);
            let up = self.followed(test, tip).map_err(at)?;
            let mut ways = vec![(1, up.clone())];
            if test.both_ways {
                ways.push((-1, up.into_iter().rev().collect()));
            }
            for (direction, mut way) in ways {
                self.directions(&mut way);
                let labels = format!("{},{},{direction}", test.test, test.ball);
                rows.extend(way.into_iter().map(|status| (labels.clone(), vec![status])));
            }
            if rows.len() > MOST {
                return Err(wrong_grid("interpolations", format!("{} rows are too many", rows.len())));
            }
        }
        self.table("test,ball,direction", &[""], wanted, rows)
    }

    /// The statuses in which the tip is at a point of the table while the rotary axes turn.
    fn followed(&self, test: &Interpolation, tip: [f64; 3]) -> Result<Vec<Vec<f64>>> {
        let axes = &self.model.info().axes;
        let mut turns: BTreeMap<usize, Vec<f64>> = BTreeMap::new();
        for (name, positions) in &test.turns_deg {
            let rotary = || axes.iter().filter(|axis| axis.kind == AxisKind::Rotary);
            let Some(axis) = rotary().find(|axis| axis.name == *name) else {
                let error = wrong_grid("interpolations", format!("the machine has no rotary axis {name}"));
                return Err(error.suggest(name, rotary().map(|axis| axis.name.as_str())));
            };
            let positions = positions.values().map_err(|error| wrong_grid("interpolations", error.message))?;
            let beyond = positions
                .iter()
                .find(|at| axis.range.is_some_and(|[from, to]| !(from - 1e-9..=to + 1e-9).contains(&at.to_radians())));
            if let Some(beyond) = beyond {
                let message = format!("{name} does not reach {beyond} deg: {}", test.test);
                return Err(wrong_grid("interpolations", message));
            }
            turns.insert(axis.status, positions);
        }
        let steps = turns.values().map(Vec::len).max().unwrap_or(0);
        let mut statuses = Vec::with_capacity(steps);
        for step in 0..steps {
            let mut status = self.standing.clone();
            for (&axis, positions) in &turns {
                status[axis] = positions[step.min(positions.len() - 1)].to_radians();
            }
            let reached = self.reached(&status, &[tip])?.pop().flatten();
            statuses.push(reached.ok_or_else(|| {
                let message = format!("the linear axes do not follow the ball at step {} of {}", step + 1, test.test);
                wrong_grid("interpolations", message).help("move the ball, or turn the axes less")
            })?);
        }
        Ok(statuses)
    }

    /// Sets the directions in which the axes come to their positions: that of the way from the row before; at the first row that of
    /// the way from there. An axis that stands keeps what it had.
    fn directions(&self, way: &mut [Vec<f64>]) {
        for (index, axis) in self.model.info().axes.iter().enumerate() {
            let Some(column) = self.model.info().status_index(&StatusRole::Direction(index)) else { continue };
            let moves: Vec<f64> = way.windows(2).map(|pair| pair[1][axis.status] - pair[0][axis.status]).collect();
            let mut last = moves.iter().find(|by| by.abs() > AT_REST).map_or(1.0, |by| by.signum());
            for (row, status) in way.iter_mut().enumerate() {
                let by = if row == 0 { 0.0 } else { moves[row - 1] };
                if by.abs() > AT_REST {
                    last = by.signum();
                }
                status[column] = last;
            }
        }
    }
}

/// The centre of the ball of a test: where the tip is sent without a direction, or where its ways towards the ball meet.
fn ball(test: &Interpolation, targets: &[Target]) -> Result<[f64; 3]> {
    let of_ball: Vec<&Target> = targets.iter().filter(|target| target.feature == test.ball).collect();
    let itself = of_ball.iter().find(|target| target.approach.is_none()).map(|target| target.tip);
    itself.or_else(|| meeting(&of_ball)).ok_or_else(|| {
        let error =
            wrong_grid("interpolations", format!("the artefact has no ball {} that the tip follows", test.ball));
        error
            .suggest(&test.ball, targets.iter().map(|target| target.feature.as_str()))
            .help("`interpolations` are for `artefact: r-test`, and for `artefact: ball-bar` with one bar")
    })
}

/// Where the ways towards a ball meet, all tips being as far from it: `tip + distance x approach`.
fn meeting(targets: &[&Target]) -> Option<[f64; 3]> {
    let of = |target: &&Target| target.approach.map(|approach| (target.tip, approach));
    let all: Vec<([f64; 3], [f64; 3])> = targets.iter().filter_map(of).collect();
    let (tip, approach) = *all.first()?;
    let apart = |one: [f64; 3], other: [f64; 3]| [0, 1, 2].map(|k| other[k] - one[k]);
    let length = |way: [f64; 3]| way.iter().map(|own| own * own).sum::<f64>().sqrt();
    let (other, towards) =
        *all.iter().max_by(|a, b| length(apart(approach, a.1)).total_cmp(&length(apart(approach, b.1))))?;
    let distance = length(apart(tip, other)) / length(apart(approach, towards));
    let centre = [0, 1, 2].map(|k| tip[k] + distance * approach[k]);
    let is_near = |(tip, approach): &([f64; 3], [f64; 3])| {
        length(apart(centre, [0, 1, 2].map(|k| tip[k] + distance * approach[k]))) < 1e-6
    };
    all.iter().all(is_near).then_some(centre)
}

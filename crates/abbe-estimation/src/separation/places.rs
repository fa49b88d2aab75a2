//! Trials elsewhere on the table: a feature with unknown position, and a known length.

use abbe_core::{AxisKind, Problem, Result};

use super::{Group, Measured, Trial, words};
use crate::inverse_kinematics::InverseKinematics;

/// Distance between the touched features and a trial feature, mm.
const BEYOND: f64 = 100.0;

/// Lengths that are tried, mm: the first that the axes reach is taken.
const LENGTHS: [f64; 3] = [300.0, 200.0, 100.0];

/// Most indexations at which a feature is tried.
const INDEXATIONS: usize = 40;

/// A box in the table frame, mm.
struct Bounds {
    low: [f64; 3],
    high: [f64; 3],
}

impl Bounds {
    fn of(points: &[[f64; 3]]) -> Self {
        let low = |axis| points.iter().map(|point: &[f64; 3]| point[axis]).fold(f64::INFINITY, f64::min);
        let high = |axis| points.iter().map(|point: &[f64; 3]| point[axis]).fold(f64::NEG_INFINITY, f64::max);
        Self { low: [0, 1, 2].map(low), high: [0, 1, 2].map(high) }
    }

    fn centre(&self) -> [f64; 3] {
        [0, 1, 2].map(|axis| round((self.low[axis] + self.high[axis]) / 2.0))
    }

    fn contains(&self, point: &[f64; 3]) -> bool {
        (0..3).all(|axis| point[axis] > self.low[axis] - 1.0 && point[axis] < self.high[axis] + 1.0)
    }

    /// Positions of trial features: beside the centre (upwards first), at the corners of the extended box, at the centre.
    fn candidates(&self) -> Vec<[f64; 3]> {
        let centre = self.centre();
        let mut points = Vec::new();
        for axis in [2, 0, 1] {
            points.extend([BEYOND, -BEYOND].map(|shift| shifted(centre, axis, shift)));
        }
        for corner in 0..8 {
            points.push([0, 1, 2].map(|axis| match corner >> axis & 1 {
                0 => round(self.high[axis] + BEYOND),
                _ => round(self.low[axis] - BEYOND),
            }));
        }
        points.push(centre);
        // Positions outside the touched features first. For positions inside, the directions of contact matter, and these are
        // easily overlooked.
        points.sort_by_key(|point| self.contains(point));
        points
    }

    fn text(&self) -> String {
        let sides = (0..3).map(|axis| match [round(self.low[axis]), round(self.high[axis])] {
            [low, high] if low == high => format!("{} = {low}", LETTERS[axis]),
            [low, high] => format!("{} = {low} to {high}", LETTERS[axis]),
        });
        sides.collect::<Vec<_>>().join(", ")
    }
}

const LETTERS: [&str; 3] = ["x", "y", "z"];

/// Rounds to whole centimetres, which is exact enough for the position of a trial feature.
fn round(value: f64) -> f64 {
    (value / 10.0).round() * 10.0 + 0.0
}

fn shifted(mut point: [f64; 3], axis: usize, shift: f64) -> [f64; 3] {
    point[axis] += shift;
    point
}

fn text([x, y, z]: [f64; 3]) -> String {
    format!("x = {x}, y = {y}, z = {z} mm of the table frame")
}

/// Trials of features and lengths elsewhere at the indexations that occur.
pub fn places(problem: &Problem, recorded: &Problem) -> Result<Vec<Trial>> {
    let indexations = indexations(problem);
    let bounds = Bounds::of(&touched(recorded)?);
    if indexations.is_empty() || !bounds.low.iter().all(|side| side.is_finite()) {
        return Ok(Vec::new());
    }
    let reach = InverseKinematics::new(recorded.model.as_ref(), &recorded.machine_values, None);
    let mut trials = Vec::new();
    for point in bounds.candidates() {
        let points = vec![point; indexations.len()];
        let statuses: Vec<Vec<f64>> = reach.solve(indexations.clone(), &points)?.into_iter().flatten().collect();
        if statuses.len() > 1 {
            let sentence = place_sentence(words(problem), point, &bounds);
            trials.push(Trial { group: Group::Place, sentence, measured: Measured::Point(statuses) });
        }
    }
    let first = &indexations[straightest(problem, &indexations)];
    for axis in 0..3 {
        trials.extend(length(&reach, first, bounds.centre(), axis)?);
    }
    Ok(trials)
}

fn place_sentence([verb, _, done]: [&str; 3], point: [f64; 3], bounds: &Bounds) -> String {
    let near = text(point);
    match bounds.contains(&point) {
        true => format!("{verb} features in other directions of contact too, for instance near {near}"),
        false => {
            let bounds = bounds.text();
            format!("{verb} a feature elsewhere, for instance near {near} (what is {done} lies within {bounds} mm)")
        }
    }
}

/// A known length about a point, as long as the axes allow.
fn length(reach: &InverseKinematics<'_>, indexation: &[f64], centre: [f64; 3], axis: usize) -> Result<Option<Trial>> {
    for length in LENGTHS {
        let ends = [-0.5, 0.5].map(|end| shifted(centre, axis, end * length));
        let found = reach.solve(vec![indexation.to_vec(); 2], &ends)?;
        if let [Some(one), Some(other)] = found.as_slice() {
            let along = shifted([0.0; 3], axis, 1.0);
            let letter = LETTERS[axis].to_uppercase();
            return Ok(Some(Trial {
                group: Group::Length,
                sentence: format!("measure a calibrated length along {letter}, for instance a scale bar"),
                measured: Measured::Length([one.clone(), other.clone()], along),
            }));
        }
    }
    Ok(None)
}

/// Touched points, table frame: the features, or the tips if artefacts have no features.
fn touched(recorded: &Problem) -> Result<Vec<[f64; 3]>> {
    let features = recorded.sets.iter().flat_map(|set| set.info().features.clone());
    let points: Vec<[f64; 3]> = features.map(|feature| feature.point).collect();
    if points.is_empty() {
        return InverseKinematics::new(recorded.model.as_ref(), &recorded.machine_values, None)
            .tips(&recorded_statuses(recorded));
    }
    Ok(points)
}

/// The statuses of all poses of the rows that take part.
pub fn recorded_statuses(problem: &Problem) -> Vec<Vec<f64>> {
    let mut all = Vec::new();
    for set in &problem.sets {
        all.extend(set.poses_of(&set.rows).map(|pose| set.poses().row(pose).to_vec()));
    }
    all
}

/// The statuses of the rotary axes.
fn rotary(problem: &Problem) -> Vec<usize> {
    let axes = problem.model.info().axes.iter();
    axes.filter(|axis| axis.kind == AxisKind::Rotary).map(|axis| axis.status).collect()
}

/// One pose for every combination of rotary positions; evenly chosen where there are many.
fn indexations(problem: &Problem) -> Vec<Vec<f64>> {
    let rotary = rotary(problem);
    let same = |one: &[f64], other: &[f64]| rotary.iter().all(|&axis| (one[axis] - other[axis]).abs() < 1e-6);
    let mut found: Vec<Vec<f64>> = Vec::new();
    for pose in recorded_statuses(problem) {
        if !found.iter().any(|known| same(known, &pose)) {
            found.push(pose);
        }
    }
    let step = found.len().div_ceil(INDEXATIONS).max(1);
    found.into_iter().step_by(step).collect()
}

/// The indexation that is nearest to zero, where table and machine frame are parallel.
fn straightest(problem: &Problem, indexations: &[Vec<f64>]) -> usize {
    let rotary = rotary(problem);
    let turn = |pose: &[f64]| rotary.iter().map(|&axis| pose[axis].abs()).sum::<f64>();
    let turns = indexations.iter().enumerate().min_by(|(_, a), (_, b)| turn(a).total_cmp(&turn(b)));
    turns.map_or(0, |(index, _)| index)
}

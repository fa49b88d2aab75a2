//! Where rank is judged: at nominal geometry, in nominal contact, to first order. One rule for all who ask.

use std::collections::BTreeSet;

use abbe_core::{
    EquationIndex, Evaluation, FactoredPoses, IndexRange, ObservationSet, Owner, ParameterRole, PoseBatch, ProbeTerm,
    Problem, Quantity, Result, RowIndex, SetIndex, StatusRole, Unit, Unknown, Variable,
};
use abbe_numerics::{Factor, LeastSquares};

use crate::contact::{is_judged_as_recorded, rank_point};
use crate::weighted::Weighted;

/// Part of the terms that a column is the sum of below which it is rounding: contact is solved to 1e-13 of the coordinates.
const ROUNDING: f64 = 1e-11;

/// Part of its terms from which a column is far above anything that the digits of the data make of zero.
const CLEAR: f64 = 1e-2;

/// Columns that are smaller than this many times what half a digit of the data changes of them are digits.
const DIGITS: f64 = 3.0;

/// The coarsest step, in mm and in degrees, that is one of digits: what is rounder was commanded and is exact.
const COARSEST: f64 = 1e-3;

/// The steps that are looked for, mm or degrees. Numbers that need finer ones were written as they were computed.
const DIGIT_STEPS: [f64; 10] = [1.0, 1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9];

/// How far from a whole number of steps rounding leaves a number, in steps.
const ON_GRID: f64 = 1e-3;

const RADIANS_PER_DEGREE: f64 = std::f64::consts::PI / 180.0;

/// Rounding of a position, in parts of it.
const POSITION: f64 = 64.0 * f64::EPSILON;

/// A problem where its rank is judged, and what its rows tell there.
///
/// That is nominal geometry: errors move rows by products of errors only, and such products make what the data cannot tell apart look
/// determined, with uncertainties that mean nothing. It does not depend on what is known of the errors, so that a recipe that is
/// checked and one that is run are judged alike. What shapes a function has its present value, and so have the parameters that it
/// shapes: without an amplitude no data tell a wavelength.
pub struct Judgement {
    problem: Problem,
    factor: Factor,
    terms: Vec<f64>,
    at_start: bool,
}

impl Judgement {
    /// Judges a problem; `kept` has one number for every equation, 0 for those that do not count and 1 for all others.
    ///
    /// Fails where the model gives no pose, or an equation has no finite value, at nominal geometry.
    pub fn new(problem: &Problem, kept: Option<&[f64]>) -> Result<Self> {
        Self::with_terms(problem, kept, |judged| norms_of_terms(judged, kept))
    }

    /// Judges the same problem, with the same unknowns, again where parameters that shape functions, and those that they shape, have other
    /// values: of [`terms`](Self::terms) only those of these are found anew. Fails as [`new`](Self::new) does.
    pub fn again(&self, problem: &Problem) -> Result<Self> {
        let held = held(problem);
        let is_held = |unknown: &Unknown| match unknown.owner {
            Owner::Machine => held.contains(&unknown.index),
            _ => problem.members_of(unknown).iter().any(|(index, _)| held.contains(index)),
        };
        Self::with_terms(problem, None, |judged| {
            let (places, unknowns): (Vec<usize>, Vec<Unknown>) =
                (judged.unknowns.iter().cloned().enumerate()).filter(|(_, unknown)| is_held(unknown)).unzip();
            let anew = norms_of_terms(&Problem { unknowns, ..judged.clone() }, None)?;
            let mut terms = self.terms.clone();
            places.into_iter().zip(anew).for_each(|(place, anew)| terms[place] = anew);
            Ok(terms)
        })
    }

    fn with_terms(
        problem: &Problem,
        kept: Option<&[f64]>,
        terms_of: impl FnOnce(&Problem) -> Result<Vec<f64>>,
    ) -> Result<Self> {
        let nominal = at_nominal_geometry(problem);
        let at_start =
            kept.is_none() && nominal.start() == problem.start() && nominal.machine_values == problem.machine_values;
        let at_start = at_start && is_judged_as_recorded(problem);
        let judged = rank_point(&nominal, &nominal.start())?;
        let factor = Weighted::new(&judged)?.factor(&judged.start(), kept)?;
        let terms = terms_of(&judged)?;
        let idle = without_effect(&nominal, &judged, (factor.norms(), &terms), kept)?;
        let factor = if idle.contains(&true) { factor.with_zeros(&idle) } else { factor };
        Ok(Self { problem: judged, factor, terms, at_start })
    }

    /// The problem at nominal geometry, its rows in nominal contact.
    pub fn problem(&self) -> &Problem {
        &self.problem
    }

    /// The factor of its rows. Unknowns without effect have columns of zeros.
    pub fn factor(&self) -> &Factor {
        &self.factor
    }

    /// What a unit of every unknown could do to all rows together, in standard uncertainties, if nothing cancelled: no less than
    /// the norm of its column.
    pub fn terms(&self) -> &[f64] {
        &self.terms
    }

    /// The factor, if it is also that of the problem at its start values as recorded.
    pub fn factor_at_start(&self) -> Option<&Factor> {
        Some(&self.factor).filter(|_| self.at_start)
    }
}

/// The same problem with the machine and the artefacts as they are nominally.
pub(crate) fn at_nominal_geometry(problem: &Problem) -> Problem {
    let nominal_values = &problem.model.info().without_errors();
    let held = held(problem);
    let mut nominal = problem.clone();
    for (index, (value, nominal)) in nominal.machine_values.iter_mut().zip(nominal_values).enumerate() {
        if !held.contains(&index) {
            *value = *nominal;
        }
    }
    for set in &mut nominal.sets {
        set.own = set.info().start.clone();
    }
    nominal
}

/// The parameters that shape functions and are estimated, and those whose effect they shape: of a model that does not say
/// which, all.
fn held(problem: &Problem) -> BTreeSet<usize> {
    let info = problem.model.info();
    let mut held = BTreeSet::new();
    for unknown in problem.machine_unknowns() {
        let shape = unknown.index;
        if info.parameters[shape].role != ParameterRole::Shape {
            continue;
        }
        let shaped: Vec<usize> = (info.periods.iter().filter(|period| period.shapes.contains(&shape)))
            .flat_map(|period| period.parameters.iter().copied())
            .collect();
        held.insert(shape);
        match shaped.is_empty() {
            true => held.extend(0..info.parameters.len()),
            false => held.extend(shaped),
        }
    }
    held
}

/// Which unknowns have no effect on the rows of a problem.
///
/// A column is zero where it is no more than rounding leaves of the terms that cancel in it (the lever arms of a tip on the axis, a
/// motion along the surface), or than the digits of the recorded positions make of zero.
pub(crate) fn without_effect(
    nominal: &Problem,
    judged: &Problem,
    (norms, terms): (&[f64], &[f64]),
    kept: Option<&[f64]>,
) -> Result<Vec<bool>> {
    let mut idle: Vec<bool> = norms.iter().zip(terms).map(|(norm, terms)| *norm <= ROUNDING * terms).collect();
    let doubtful = |index: usize| !idle[index] && norms[index] < CLEAR * terms[index];
    let doubtful: Vec<usize> = (0..idle.len()).filter(|&index| doubtful(index)).collect();
    if doubtful.is_empty() {
        return Ok(idle);
    }
    let unknowns: Vec<Unknown> = doubtful.iter().map(|&index| judged.unknowns[index].clone()).collect();
    let moved = moved_by_digits(nominal);
    let moved = Problem { unknowns: unknowns.clone(), ..rank_point(&moved, &moved.start())? };
    let changes = column_changes(&Problem { unknowns, ..judged.clone() }, &moved, kept)?;
    for (&index, change) in doubtful.iter().zip(changes) {
        idle[index] = norms[index] <= DIGITS * change;
    }
    Ok(idle)
}

/// Norms of the columns if no term of their entries cancelled another.
///
/// A rotation moves a point by at most the size of its coordinates, whatever lever is left of them; a motion acts along a surface
/// as much as along its normal.
pub(crate) fn norms_of_terms(problem: &Problem, kept: Option<&[f64]>) -> Result<Vec<f64>> {
    let uncertainties = problem.standard_uncertainties();
    // Of a tied unknown the size is that of all members.
    let mut machine: Vec<(usize, f64)> = Vec::new();
    let mut wanted = Vec::new();
    for (column, unknown) in problem.unknowns.iter().enumerate() {
        let itself = [(unknown.index, 1.0)];
        let members = if unknown.owner == Owner::Machine { &itself } else { problem.members_of(unknown) };
        for &(index, factor) in members {
            machine.push((column, factor));
            wanted.push(Variable::Parameter(index));
        }
    }
    let angles = machine.iter().map(|&(column, _)| f64::from(problem.unknowns[column].unit == Unit::RAD));
    let angles: Vec<f64> = angles.collect();
    let of_probe: Vec<f64> = wanted.iter().map(|variable| length_of_probe(problem, variable)).collect();
    let weight = |equation: EquationIndex| kept.map_or(1.0, |kept| kept[equation]) / uncertainties[equation];
    let found = problem.in_parts(wanted.len(), |chunks| {
        let mut squares = Squares { own: vec![0.0; problem.unknowns.len()], machine: vec![0.0; machine.len()] };
        let (mut work, mut poses) = (Evaluation::default(), FactoredPoses::default());
        let mut terms = vec![0.0; machine.len()];
        for &(index, rows, first) in chunks {
            let set = &problem.sets[index];
            let own = columns_of(problem, index);
            problem.evaluate(index, rows, &[], &mut work)?;
            let statuses: Vec<f64> = set.poses_of(rows).flat_map(|pose| set.poses().row(pose)).copied().collect();
            let batch =
                PoseBatch { statuses: &statuses, values: &problem.machine_values, wanted: &wanted, orientation: true };
            let turned = problem.model.factored(batch, &mut poses);
            if turned.as_ref().is_err_and(|error| error.fatal) {
                turned?;
            } else if turned.is_err() {
                // A model may give no orientations: then what is an angle turns by itself.
                problem.model.factored(PoseBatch { orientation: false, ..batch }, &mut poses)?;
            }
            let weights = IndexRange::new(first, work.equations.residuals().len()).map(weight);
            let weights: Vec<f64> = weights.collect();
            let levers = Levers::new(set, rows, &work);
            for (equation, weight) in weights.iter().enumerate() {
                levers.machine_terms(equation, &poses, (&angles, &of_probe), &mut terms);
                squares.machine.iter_mut().zip(&terms).for_each(|(square, term)| *square += (term * weight).powi(2));
            }
            for &(equation, unknown, derivative) in work.equations.by_own() {
                if let Some(column) = own[unknown] {
                    let term = levers.own_term(equation, problem.unknowns[column].unit).max(derivative.abs());
                    squares.own[column] += (term * weights[equation]).powi(2);
                }
            }
        }
        Ok(squares)
    });
    let mut squares = vec![0.0; problem.unknowns.len()];
    for part in found {
        let Squares { own, machine: of_machine } = part?;
        squares.iter_mut().zip(own).for_each(|(sum, own)| *sum += own);
        for ((column, factor), square) in machine.iter().zip(of_machine) {
            squares[*column] += factor * factor * square;
        }
    }
    Ok(squares.into_iter().map(f64::sqrt).collect())
}

/// How far a unit of a variable moves the surface of the stylus at most, in any direction: a lobe that is zero in the directions of all
/// touches is rounding there.
fn length_of_probe(problem: &Problem, variable: &Variable) -> f64 {
    let Variable::Parameter(index) = variable else { return 0.0 };
    match problem.model.info().parameters[*index].role {
        ParameterRole::Probe { term: ProbeTerm::Delay, .. } => 0.0,
        ParameterRole::Probe { .. } => 1.0,
        _ => 0.0,
    }
}

/// Sums of squares over some rows, by unknown and by parameter of the machine.
struct Squares {
    own: Vec<f64>,
    machine: Vec<f64>,
}

/// The column of every own unknown of a set; none for those that are not estimated.
fn columns_of(problem: &Problem, set: SetIndex) -> Vec<Option<usize>> {
    let mut columns = vec![None; problem.sets[set].own.len()];
    let own = problem.unknowns.iter().enumerate().filter(|(_, unknown)| unknown.owner == Owner::Set(set));
    own.for_each(|(column, unknown)| columns[unknown.index] = Some(column));
    columns
}

/// What motions of the poses of some rows can do to their equations.
struct Levers {
    /// For every equation its poses: their index, and the sizes of its derivatives to position and to rotation.
    pairs: Vec<Vec<(usize, f64, f64)>>,
    /// Size of the coordinates of every pose, mm.
    reach: Vec<f64>,
}

impl Levers {
    fn new(set: &ObservationSet, rows: &[RowIndex], work: &Evaluation) -> Self {
        let info = set.info();
        let (by_position, by_rotation) = (work.equations.by_position(), work.equations.by_rotation());
        let (mut pairs, mut pair, mut first_pose) = (Vec::new(), 0, 0);
        for row in rows.iter().map(|&row| info.layout.rows[row]) {
            for _ in 0..row.equations {
                let of_pose = |k: usize| {
                    (first_pose + k, size(&by_position[pair + k]), by_rotation.get(pair + k).map_or(0.0, size))
                };
                pairs.push((0..row.poses).map(of_pose).collect());
                pair += row.poses;
            }
            first_pose += row.poses;
        }
        Self { pairs, reach: work.poses.positions.iter().map(size).collect() }
    }

    /// The largest that a unit of each parameter of the machine could do to an equation, given the derivatives of the poses to them;
    /// without those of rotations `angles` says how far each turns, and `of_probe` how far each moves the surface of the stylus.
    fn machine_terms(
        &self,
        equation: usize,
        poses: &FactoredPoses,
        (angles, of_probe): (&[f64], &[f64]),
        terms: &mut [f64],
    ) {
        terms.fill(0.0);
        let (effects, count) = (poses.effects, poses.terms.len());
        for &(pose, by_position, by_rotation) in &self.pairs[equation] {
            let lever = by_position * self.reach[pose] + by_rotation;
            let factors = &poses.factors[pose * count..(pose + 1) * count];
            for (effect, run) in poses.runs() {
                let moved = by_position * size(&poses.position_effects[pose * effects + effect]);
                let turned = poses.rotation_effects.get(pose * effects + effect).map_or(0.0, |by| lever * size(by));
                for ((variable, _), factor) in poses.terms[run.clone()].iter().zip(&factors[run]) {
                    terms[*variable] += (moved + turned) * factor.abs();
                }
            }
            if poses.rotation_effects.is_empty() {
                terms.iter_mut().zip(angles).for_each(|(term, angle)| *term += lever * angle);
            }
            terms.iter_mut().zip(of_probe).for_each(|(term, length)| *term += by_position * length);
        }
    }

    /// The largest that a unit of an own unknown could do to an equation: that of a point, or of a turn.
    fn own_term(&self, equation: usize, unit: Unit) -> f64 {
        let term = |&(pose, by_position, by_rotation): &(usize, f64, f64)| match unit {
            Unit::MM => by_position,
            Unit::RAD => by_position * self.reach[pose] + by_rotation,
            _ => 0.0,
        };
        self.pairs[equation].iter().map(term).fold(0.0, f64::max)
    }
}

fn size(vector: &[f64; 3]) -> f64 {
    vector.iter().map(|entry| entry * entry).sum::<f64>().sqrt()
}

/// The same problem with every recorded position changed by up to half a digit of what was written, and by its rounding.
fn moved_by_digits(problem: &Problem) -> Problem {
    let mut moved = problem.clone();
    for set in &mut moved.sets {
        let mut poses = set.poses().clone();
        for (status, column) in problem.model.info().status.iter().enumerate() {
            if !matches!(column.role, StatusRole::Command(_)) {
                continue;
            }
            let step = digit_step(poses.indices().map(|pose| poses.row(pose)[status]), column.quantity);
            for pose in poses.indices() {
                let value = &mut poses.row_mut(pose)[status];
                *value += noise(pose.0 as u64, status as u64) * (step + POSITION * value.abs());
            }
        }
        set.set_poses(poses);
    }
    moved
}

/// The last digit that some positions, mm or rad, were written with; zero if they are rounder than measured ones, or not rounded.
fn digit_step(values: impl Iterator<Item = f64> + Clone, quantity: Quantity) -> f64 {
    let of_unit = |unit: f64| {
        let is_step = |step: f64| values.clone().all(|value| off_grid(value / unit / step) <= ON_GRID);
        let mut steps = DIGIT_STEPS.into_iter().filter(|step| is_step(*step));
        steps.next().map(|step| step * unit)
    };
    let units: &[f64] = if quantity == Quantity::Angle { &[RADIANS_PER_DEGREE, 1.0] } else { &[1.0] };
    let found = units.iter().find_map(|unit| of_unit(*unit).map(|step| (step, unit)));
    found.filter(|(step, unit)| *step <= COARSEST * **unit * (1.0 + ON_GRID)).map_or(0.0, |(step, _)| step)
}

/// How far a number is from a whole one.
fn off_grid(value: f64) -> f64 {
    (value - value.round()).abs()
}

/// A number between -1/2 and 1/2 that depends on nothing but the pose and the status (the finaliser of SplitMix64, Steele et al. 2014).
fn noise(pose: u64, status: u64) -> f64 {
    let mut bits = (pose << 8 | status).wrapping_add(1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    bits = (bits ^ (bits >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    bits = (bits ^ (bits >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    ((bits ^ (bits >> 31)) >> 11) as f64 / (1_u64 << 53) as f64 - 0.5
}

/// Norms of the differences of the columns of two problems with the same rows and unknowns.
fn column_changes(one: &Problem, other: &Problem, kept: Option<&[f64]>) -> Result<Vec<f64>> {
    let count = one.unknowns.len();
    let columns = |problem: &Problem| -> Result<Vec<f64>> {
        let weighted = Weighted::new(problem)?;
        let mut all = vec![0.0; weighted.rows() * count];
        weighted.linearise(&problem.start(), &mut |first, _, derivatives| {
            all[first * count..first * count + derivatives.len()].copy_from_slice(derivatives);
        })?;
        Ok(all)
    };
    let mut squares = vec![0.0; count];
    for (row, (one, other)) in columns(one)?.chunks_exact(count).zip(columns(other)?.chunks_exact(count)).enumerate() {
        let weight = kept.map_or(1.0, |kept| kept[row]);
        let changes = one.iter().zip(other).map(|(one, other)| weight * (one - other).powi(2));
        squares.iter_mut().zip(changes).for_each(|(square, change)| *square += change);
    }
    Ok(squares.into_iter().map(f64::sqrt).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn digits_are_those_of_measured_positions() {
        let step = |values: &[f64], quantity| digit_step(values.iter().copied(), quantity);
        assert_eq!(step(&[10.0, 20.5, -3.25], Quantity::Length), 0.0);
        assert_eq!(step(&[10.0, 20.512, -3.2], Quantity::Length), 1e-3);
        assert_eq!(step(&[10.123_456, 1020.5], Quantity::Length), 1e-6);
        assert_eq!(step(&[10.0 / 3.0, 20.0], Quantity::Length), 0.0);
        let degrees = [30.0_f64, 45.1234, -90.0].map(f64::to_radians);
        assert!((step(&degrees, Quantity::Angle) - 1e-4_f64.to_radians()).abs() < 1e-18);
        assert_eq!(step(&[0.5_f64, 90.0].map(f64::to_radians), Quantity::Angle), 0.0);
        assert_eq!(step(&[0.123_456, 1.5], Quantity::Angle), 1e-6);
        assert_eq!(step(&[], Quantity::Length), 0.0);
    }

    #[test]
    fn noise_fills_its_range_evenly() {
        let all: Vec<f64> = (0..10_000).map(|pose| noise(pose, pose % 7)).collect();
        let mean = all.iter().sum::<f64>() / 1e4;
        let square = all.iter().map(|value| value * value).sum::<f64>() / 1e4;
        assert!(mean.abs() < 0.01 && (square - 1.0 / 12.0).abs() < 0.003, "{mean} {square}");
        assert!(all.iter().all(|value| value.abs() <= 0.5));
    }
}

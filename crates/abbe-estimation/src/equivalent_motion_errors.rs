//! Motion errors of one axis that have the same effect on the tip at every recorded pose.
//!
//! With one constant offset between axis and tip, a rotation error moves the tip as a translation error does. Only the
//! functions chosen for the two errors can then separate them (other knots, no line in one of them), not the machine. Rank
//! does not show this. So the derivatives of the pose to the errors of an axis are compared here, at all poses together,
//! without their functions (Soons 1993, section 5.2, leaves such errors out by hand).

use abbe_core::{
    Combination, EquivalentMotionError, ErrorFunction, Orientation, ParameterRole, Poses, Problem, Result, Unit,
    Variable,
};
use abbe_numerics::norm;

use crate::contact::rank_point;
use crate::probe_offset::{OFFSETS, tip_offsets, with_offset};
use crate::separation::thinned;

/// Parts of an effect below this are rounding.
const ROUNDING: f64 = 1e-9;

/// Motion errors that have, at every recorded pose, the same effect on the tip as other errors of the same axis. At least one
/// of these errors is estimated.
///
/// The poses are those of nominal contact on the nominal machine, because deviations of recorded poses act as if they were
/// information.
pub fn equivalent_motion_errors(problem: &Problem) -> Result<Vec<EquivalentMotionError>> {
    let functions = &problem.model.info().error_functions;
    if functions.len() < 2 {
        return Ok(Vec::new());
    }
    let mut nominal = problem.clone();
    nominal.machine_values = problem.model.info().without_errors();
    let few = judged(&thinned(&nominal));
    let mut all: Option<Problem> = None;
    let mut found = Vec::new();
    for axis in 0..problem.model.info().axes.len() {
        let of_axis: Vec<&ErrorFunction> = functions.iter().filter(|function| function.axis == axis).collect();
        // All poses are used only if some of them show a dependence.
        if of_axis.len() < 2 || dependent(&effects(&few, &of_axis)?).is_empty() {
            continue;
        }
        let all = all.get_or_insert_with(|| judged(&nominal));
        let alike = dependent(&effects(all, &of_axis)?);
        let mut told: Vec<EquivalentMotionError> =
            alike.iter().filter_map(|alike| named(problem, &of_axis, alike)).collect();
        for (letter, offset) in tip_offsets(problem) {
            let Some(other) = with_offset(&few, &offset, OFFSETS[0])? else { continue };
            let both = effects(&few, &of_axis)?.into_iter().zip(effects(&other, &of_axis)?);
            let left = dependent(&both.map(|(recorded, other)| [recorded, other].concat()).collect::<Vec<_>>());
            for same in &mut told {
                if !left.iter().any(|(index, _)| of_axis[*index].symbol == same.error) {
                    same.probe_offsets.push(letter);
                }
            }
        }
        found.extend(told);
    }
    Ok(found)
}

/// The problem at nominal contact, or as recorded where no contact is found.
fn judged(problem: &Problem) -> Problem {
    rank_point(problem, &problem.start()).unwrap_or_else(|_| problem.clone())
}

/// The effect of each of some errors of an axis on the pose, mm and rad per mm or rad of the error, at all poses where all of
/// them can be evaluated.
fn effects(problem: &Problem, functions: &[&ErrorFunction]) -> Result<Vec<Vec<f64>>> {
    let mut effects = vec![Vec::new(); functions.len()];
    let mut poses = Poses::default();
    for set in &problem.sets {
        let turned = set.info().orientation != Orientation::Unused;
        for pose in set.poses_of(&set.rows) {
            let status = set.poses().row(pose);
            let Some(known) = functions.iter().map(|function| known(problem, function, status)).collect() else {
                continue;
            };
            let known: Vec<(usize, f64)> = known;
            let wanted: Vec<Variable> = known.iter().map(|(parameter, _)| Variable::Parameter(*parameter)).collect();
            problem.model.poses(status, &problem.machine_values, &wanted, turned, &mut poses)?;
            for (index, (effect, (_, by))) in effects.iter_mut().zip(&known).enumerate() {
                effect.extend(poses.position_derivatives[index].map(|derivative| derivative / by));
                if turned {
                    effect.extend(poses.rotation_derivatives[index].map(|derivative| derivative / by));
                }
            }
        }
    }
    Ok(effects)
}

/// A parameter of an error, and the derivative of the error to it; none if the error cannot be evaluated at this status, or
/// all its derivatives are zero.
fn known(problem: &Problem, function: &ErrorFunction, status: &[f64]) -> Option<(usize, f64)> {
    let error = problem.model.motion_error(function, &problem.machine_values, status).ok()?;
    error.derivatives.into_iter().find(|(_, by)| by.is_finite() && *by != 0.0)
}

/// An error whose effect is a combination of the effects of others: its index, and the index and coefficient of each of
/// these.
type Dependent = (usize, Vec<(usize, f64)>);

/// The errors whose effects are combinations of those of errors before them, by orthogonalisation in turn.
fn dependent(effects: &[Vec<f64>]) -> Vec<Dependent> {
    let mut basis: Vec<(usize, Vec<f64>)> = Vec::new();
    // Each direction of the basis as a combination of the errors.
    let mut meaning: Vec<Vec<f64>> = Vec::new();
    let mut found = Vec::new();
    for (index, effect) in effects.iter().enumerate() {
        let size = norm(effect);
        // With fewer poses than errors no decision is possible.
        if effect.len() < 3 * effects.len() {
            return Vec::new();
        }
        let mut rest = effect.clone();
        let mut parts = vec![0.0; effects.len()];
        // Twice, so that rounding of the first pass is taken off, too.
        for _ in 0..2 {
            for ((_, direction), meaning) in basis.iter().zip(&meaning) {
                let along: f64 = rest.iter().zip(direction).map(|(rest, direction)| rest * direction).sum();
                rest.iter_mut().zip(direction).for_each(|(rest, direction)| *rest -= along * direction);
                parts.iter_mut().zip(meaning).for_each(|(part, meaning)| *part += along * meaning);
            }
        }
        let left = norm(&rest);
        if left <= ROUNDING * size {
            let share = |(other, part): (usize, &f64)| (*part != 0.0).then_some((other, *part));
            let mut of: Vec<(usize, f64)> = parts.iter().enumerate().filter_map(share).collect();
            of.retain(|(other, part)| part.abs() * norm(&effects[*other]) > ROUNDING * size);
            found.push((index, of));
            continue;
        }
        parts.iter_mut().for_each(|part| *part = -*part / left);
        parts[index] = 1.0 / left;
        rest.iter_mut().for_each(|rest| *rest /= left);
        meaning.push(parts);
        basis.push((index, rest));
    }
    found
}

/// The result with names; none if the error has no effect at all (rank shows that) or if none of these errors is estimated.
fn named(problem: &Problem, functions: &[&ErrorFunction], (error, of): &Dependent) -> Option<EquivalentMotionError> {
    let parameters = &problem.model.info().parameters;
    let estimated = |index: usize| {
        let ErrorFunction { axis, component, .. } = *functions[index];
        let mut unknowns = problem.machine_unknowns().into_iter();
        unknowns.any(|unknown| parameters[unknown.index].role == ParameterRole::Motion { axis, component })
    };
    if of.is_empty() || !(estimated(*error) || of.iter().any(|(other, _)| estimated(*other))) {
        return None;
    }
    let quantity = functions[*error].quantity;
    let combination = of.iter().map(|(other, size)| Combination {
        name: functions[*other].symbol.clone(),
        coefficient: *size,
        unit: Unit::per(functions[*other].quantity, quantity, 1).to_string(),
    });
    let held: Vec<usize> = std::iter::once(*error).chain(of.iter().map(|(other, _)| *other)).collect();
    let held = held.into_iter().filter(|index| !estimated(*index)).map(|index| functions[index].symbol.clone());
    Some(EquivalentMotionError {
        error: functions[*error].symbol.clone(),
        combination: combination.collect(),
        not_estimated: held.collect(),
        probe_offsets: Vec::new(),
    })
}

//! Variance components of rows in parts. One pass gives the triangle of the rows of every set, and with the derivatives of that place it
//! tells all that factors follow from, whatever they are. So factors settle on triangles, and another pass at where they lead says whether
//! they stay.

use std::collections::BTreeMap;

use abbe_core::{Problem, Result, Triangle};
use abbe_numerics::{Accumulator, Factor};

use crate::parts::{RowsInParts, check, joined_sets, looked_at, nothing, of_sets};
use crate::variance::{Group, ROUNDS, Round, Rounds, VarianceComponents, unsettled};

/// The rows of every set, by the names of sets.
type OfSets = Vec<(String, Triangle)>;

/// The factors on the stated uncertainties of every set, from the solution `x` of rows whose uncertainties are as they are stated.
///
/// Fails where rows of parts belong together, as [`part_evidence`](crate::part_evidence) does, where other processes read the rows, and for
/// factors that do not settle.
pub fn components_of_parts(rows: &RowsInParts<'_>, x: &[f64]) -> Result<VarianceComponents> {
    let mut rounds = Rounds::new(rows.problem().sets.len());
    let (mut x, mut count) = (x.to_vec(), 0);
    loop {
        let of_sets = recorded_sets(rows, &x)?;
        let (here, first) = (x.clone(), count);
        loop {
            let (round, step) = round(&of_sets, &rounds.factors)?;
            x = here.iter().zip(&step).map(|(value, step)| value + step).collect();
            match rounds.next(&round) {
                // They stay as they were before this pass.
                Some(degrees_of_freedom) if count == first => return Ok(rounds.settled(degrees_of_freedom, x)),
                Some(_) => break,
                None => count += 1,
            }
            if count == ROUNDS {
                return Err(unsettled());
            }
        }
    }
}

/// What the rows of all sets tell of these factors, and the step to the solution with them.
fn round(of_sets: &[Factor], factors: &[f64]) -> Result<(Round, Vec<f64>)> {
    let scaled: Vec<Factor> = of_sets.iter().zip(factors).map(|(rows, factor)| weighed(rows, 1.0 / factor)).collect();
    let all = Factor::combined(&scaled.iter().collect::<Vec<_>>()).ok_or_else(nothing)?;
    let step = all.step().ok_or_else(nothing)?;
    let root = all.covariance_root(all.unknowns());
    let group =
        |rows: &Factor| Group { rows: rows.rows(), squares: squares(rows, &step), share: root.information(rows) };
    Ok((Round::of_groups(&scaled.iter().map(group).collect::<Vec<Group>>()), step))
}

/// The factor of the same rows, each multiplied by a weight.
fn weighed(rows: &Factor, weight: f64) -> Factor {
    let count = rows.unknowns();
    let mut accumulator = Accumulator::new(count, count + 1);
    rows.lines().iter().for_each(|line| accumulator.push(&line[..count], line[count], weight));
    accumulator.finish().of_rows(rows.rows())
}

/// The sum of squares of rows after a step.
fn squares(rows: &Factor, step: &[f64]) -> f64 {
    let after =
        |line: &Vec<f64>| line.iter().zip(step.iter().chain([&1.0])).map(|(one, other)| one * other).sum::<f64>();
    rows.lines().iter().map(|line| after(line).powi(2)).sum()
}

/// The factor of the rows of every set, as they were recorded.
fn recorded_sets(rows: &RowsInParts<'_>, x: &[f64]) -> Result<Vec<Factor>> {
    let problem = rows.problem();
    let names = problem.unknowns.iter().map(|unknown| unknown.name.clone());
    let at: BTreeMap<String, f64> = names.zip(x.iter().copied()).collect();
    let look = |part: &Problem| {
        check(part)?;
        match part.equations() {
            0 => Ok(Ok(OfSets::new())),
            _ => of_sets(&part.with_values(&part.values_at(&at)), None).map(Ok),
        }
    };
    let join = |all: &mut Result<OfSets>, own: Result<OfSets>| {
        if let (Ok(one), Ok(other)) = (&*all, &own) {
            *all = joined_sets(one, other);
        }
    };
    let found = looked_at(rows.parts(), &look, &join)?.unwrap_or_else(|| Err(nothing()))?;
    let of_set = |name: &String| {
        rows.joined(x.len(), found.iter().filter(|(set, _)| set == name).map(|(_, triangle)| Some(triangle)))
    };
    problem.sets.iter().map(|set| of_set(&set.name)).collect()
}

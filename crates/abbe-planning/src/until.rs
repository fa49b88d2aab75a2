//! The fewest candidates with which a wanted uncertainty is reached, and how good a row has to be.

use abbe_core::{Error, Owner, Poses, Problem, Quantity, Result, Variable, Whole};

use crate::candidates::candidates;
use crate::settings::{Of, Planning, Until};
use crate::{Plan, counts, plan_of, wrong};

/// What a plan reaches of what was wanted.
#[derive(Debug, Clone, PartialEq)]
pub struct Reached {
    /// What is worst: the name of an unknown, or `the tip along x at row 12`.
    pub worst: String,
    /// Whether that is an angle.
    pub is_angle: bool,
    /// Its expanded uncertainty, mm or rad.
    pub expanded: f64,
    /// What was wanted, mm or rad.
    pub wanted: f64,
    /// The coverage factor.
    pub coverage_factor: f64,
    /// Largest standard uncertainty of a row with which these candidates reach what was wanted, mm: of rows that are lengths with
    /// the same one, and with nothing measured before. What known inputs add (the calibration of an artefact) is not in it.
    pub largest_of_row: Option<f64>,
}

/// A number of candidates that is tried: most restarts make the last plan better by little, and every number costs all of them.
const TRIALS: usize = 4;

/// The plan with the fewest candidates that reaches what is wanted.
///
/// Fails if the most that are allowed do not reach it, with what they reach, and how good a row would have to be.
pub fn fewest(problem: &Problem, wanted: &Planning, until: &Until) -> Result<Plan> {
    let there = candidates(problem, wanted)?;
    let free = there.iter().filter(|candidate| !candidate.forbidden).count();
    let most = wanted.number.map_or(free, Whole::get);
    let most = if wanted.replications { most } else { most.min(free.max(1)) };
    let of = |number: usize, restarts: usize| {
        let restarts = Whole::new(restarts.min(wanted.restarts.get()).max(1) as u64);
        let mut plan = plan_of(
            problem,
            &Planning { number: Some(Whole::new(number as u64)), until: None, restarts, ..wanted.clone() },
        )?;
        plan.reached = Some(reached(&plan, problem, wanted, until)?);
        Ok(plan)
    };
    // Whoever writes what the reverse answer says gets it, whatever is rounded.
    let is_enough =
        |plan: &Plan| plan.reached.as_ref().is_some_and(|reached| reached.expanded <= reached.wanted * (1.0 + 1e-9));
    let all = of(most, TRIALS)?;
    if !is_enough(&all) {
        return Err(out_of_reach(&all));
    }
    // Too few do not determine all unknowns, which is an error of the plan with this number.
    let (mut too_few, mut enough) = (0, most);
    while enough - too_few > 1 {
        let middle = too_few + (enough - too_few) / 2;
        match of(middle, TRIALS) {
            Ok(plan) if is_enough(&plan) => enough = middle,
            Err(error) if error.class == abbe_core::Class::Interrupted => return Err(error),
            _ => too_few = middle,
        }
    }
    let best = of(enough, wanted.restarts.get())?;
    // More restarts find a plan whose criterion is better; what is wanted may be another thing.
    if is_enough(&best) { Ok(best) } else { of(enough, TRIALS) }
}

/// What a plan reaches: the quantity that is nearest to what is wanted of it, or furthest beyond.
fn reached(plan: &Plan, problem: &Problem, wanted: &Planning, until: &Until) -> Result<Reached> {
    let factor = until.coverage_factor;
    let quantities = match until.of {
        Of::Parameters => of_parameters(plan, wanted, until),
        Of::Tool => of_tool(plan, problem, until)?,
    };
    let ratio = |(_, uncertainty, limit): &(String, f64, f64)| factor * uncertainty / limit;
    let worst = quantities.into_iter().max_by(|one, other| ratio(one).total_cmp(&ratio(other)));
    let Some((worst, uncertainty, limit)) = worst else {
        let error = wrong("until", "nothing that is estimated is of this kind");
        return Err(error
            .help("`expanded_um` is for lengths, `expanded_urad` for angles; `of: tool` counts what moves the tip"));
    };
    let uncertainties = problem.standard_uncertainties();
    let alike = problem.sets.iter().all(|set| set.info().angles.is_empty())
        && uncertainties.iter().all(|one| (one / uncertainties[0] - 1.0).abs() < 1e-9);
    let before = plan.figures.equations > planned_equations(plan, problem, wanted);
    let largest_of_row = (alike && !before).then(|| uncertainties[0] * limit / (factor * uncertainty));
    let is_angle =
        plan.problem.unknowns.iter().any(|unknown| unknown.name == worst && unknown.unit.of == Quantity::Angle);
    Ok(Reached {
        worst,
        is_angle,
        expanded: factor * uncertainty,
        wanted: limit,
        coverage_factor: factor,
        largest_of_row,
    })
}

/// Equations of the chosen candidates, each as often as it is measured.
fn planned_equations(plan: &Plan, problem: &Problem, wanted: &Planning) -> usize {
    let found = candidates(problem, wanted).unwrap_or_default();
    let of = |label: &str| found.iter().find(|candidate| candidate.label == label).map_or(0, |one| one.equations.len());
    plan.chosen.iter().map(|chosen| chosen.times * of(&chosen.label)).sum()
}

/// Name, standard uncertainty and limit of unknowns that count and are lengths or angles.
fn of_parameters(plan: &Plan, wanted: &Planning, until: &Until) -> Vec<(String, f64, f64)> {
    let unknowns = plan.problem.unknowns.iter().zip(plan.figures.standard_uncertainties());
    let counting = unknowns.filter(|(unknown, _)| counts(unknown, wanted));
    let limited = counting.filter_map(|(unknown, uncertainty)| {
        let alone = unknown.unit.per.is_none() && unknown.unit.and_per.is_none();
        let limit = match unknown.unit.of {
            Quantity::Length if alone => until.expanded_um.map(|limit| limit * 1e-3),
            Quantity::Angle if alone => until.expanded_urad.map(|limit| limit * 1e-6),
            _ => None,
        };
        Some((unknown.name.clone(), uncertainty, limit?))
    });
    limited.collect()
}

/// The tip along x, y and z of the table at all candidates, by the errors of the machine that are estimated; what is left of the
/// offsets of the set-up is among them.
fn of_tool(plan: &Plan, problem: &Problem, until: &Until) -> Result<Vec<(String, f64, f64)>> {
    let Some(limit) = until.expanded_um.map(|limit| limit * 1e-3) else { return Ok(Vec::new()) };
    let unknowns = &plan.problem.unknowns;
    let machine: Vec<usize> = (0..unknowns.len()).filter(|&index| unknowns[index].owner == Owner::Machine).collect();
    let variables: Vec<Variable> = machine.iter().map(|&index| Variable::Parameter(unknowns[index].index)).collect();
    let (all, covariance) = (unknowns.len(), &plan.figures.covariance);
    let mut found: Vec<(String, f64, f64)> = Vec::new();
    for set in &problem.sets {
        let layout = &set.info().layout;
        for &row in &set.rows {
            for pose in layout.rows[row].pose_indices() {
                let mut tip = Poses::default();
                let values = problem.model.info().without_errors();
                problem.model.poses(set.poses().row(pose), &values, &variables, false, &mut tip)?;
                for (part, letter) in ["x", "y", "z"].into_iter().enumerate() {
                    let by = |column: usize| tip.position_derivatives[column][part];
                    let variance: f64 = (0..machine.len())
                        .flat_map(|one| (0..machine.len()).map(move |other| (one, other)))
                        .map(|(one, other)| by(one) * by(other) * covariance[machine[one] * all + machine[other]])
                        .sum();
                    let uncertainty = variance.max(0.0).sqrt();
                    if found.first().is_none_or(|(_, most, _)| uncertainty > *most) {
                        found = vec![(format!("the tip along {letter} at row {}", row.0 + 1), uncertainty, limit)];
                    }
                }
            }
        }
    }
    Ok(found)
}

/// All that is allowed is not enough.
fn out_of_reach(all: &Plan) -> Error {
    let Some(reached) = &all.reached else { return wrong("until", "this is out of reach") };
    let number: usize = all.chosen.iter().map(|chosen| chosen.times).sum();
    let (unit, factor) = if reached.is_angle { ("µrad", 1e6) } else { ("µm", 1e3) };
    let message = format!(
        "the most that may be chosen ({number}) leave an expanded uncertainty of {:.4} {unit} of {}; {:.4} {unit} is wanted",
        reached.expanded * factor,
        reached.worst,
        reached.wanted * factor
    );
    let error = wrong("until", message);
    match reached.largest_of_row {
        Some(largest) => error.help(format!(
            "these reach it if a row has a standard uncertainty of {:.4} µm or less; or offer more candidates, or `replications: true` with a larger `number`",
            largest * 1e3
        )),
        None => error.help("offer more candidates, measure better, or allow `replications: true` with a larger `number`"),
    }
}

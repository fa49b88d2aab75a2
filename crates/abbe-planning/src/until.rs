//! The fewest candidates with which a wanted uncertainty is reached, and how good a row has to be.

use abbe_core::{Error, Owner, Poses, Problem, Quantity, Result, Variable, Whole};

use crate::candidates::candidates;
use crate::settings::{Of, Planning, Until};
use crate::{Ground, Plan, PlanFigures, counts, plan_of, wrong};

/// What a plan reaches of what was wanted.
#[derive(Debug, Clone, PartialEq)]
pub struct Reached {
    /// What is worst: the name of an unknown, or `the tip along x at row 12`.
    pub worst: String,
    /// Whether that is an angle.
    pub is_angle: bool,
    /// Its expanded uncertainty, mm or rad: by the rows and by what is known of artefact and probe.
    pub expanded: f64,
    /// What was wanted, mm or rad.
    pub wanted: f64,
    /// The coverage factor.
    pub coverage_factor: f64,
    /// Largest standard uncertainty of a row (of a mean, if touches are repeated) with which these candidates reach what was wanted, mm:
    /// of rows that are lengths with the same one, and with nothing measured before. What is known stays as stated.
    pub largest_of_row: Option<f64>,
    /// The same for each known input: how good artefact and probe have to be.
    pub largest_of_inputs: Vec<LargestOfInput>,
}

/// How large the uncertainty of a known input may be.
#[derive(Debug, Clone, PartialEq)]
pub struct LargestOfInput {
    /// Its name: `stylus_radius`, `bar.length`; or the earlier estimate that it comes from.
    pub name: String,
    /// What is stated, in the unit of its value; none where several quantities come from one estimate.
    pub stated: Option<f64>,
    /// Whether that is a length.
    pub is_length: bool,
    /// The largest part of what is stated with which what was wanted is reached, all else as stated. None if nothing suffices.
    pub part: Option<f64>,
}

impl Reached {
    /// What is reached as a part of what was wanted.
    pub fn ratio(&self) -> f64 {
        self.expanded / self.wanted
    }
}

/// Whether that is enough. Whoever writes what the reverse answer says gets it, whatever is rounded.
pub fn is_enough(reached: &Reached) -> bool {
    reached.expanded <= reached.wanted * (1.0 + 1e-9)
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
        let wanted = Planning { number: Some(Whole::new(number as u64)), until: None, restarts, ..wanted.clone() };
        plan_of(problem, &wanted, Some(until))
    };
    let is_enough = |plan: &Plan| plan.reached.as_ref().is_some_and(is_enough);
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

/// A quantity of which an uncertainty is wanted: a sum of unknowns.
struct Quantified {
    name: String,
    is_angle: bool,
    limit: f64,
    /// Its variance by the rows.
    rows: f64,
    /// Its variance by each source of known inputs.
    known: Vec<f64>,
}

impl Quantified {
    fn variance(&self) -> f64 {
        self.rows + self.known.iter().sum::<f64>()
    }
}

/// Sensitivities of all unknowns to what is considered, source by source.
struct Sensitivities<'a> {
    figures: &'a PlanFigures,
    ground: &'a Ground<'a>,
    /// Unknowns times considered quantities.
    values: Vec<f64>,
    /// The sources, each with its quantities.
    sources: Vec<(&'a str, Vec<usize>)>,
}

impl<'a> Sensitivities<'a> {
    fn new(figures: &'a PlanFigures, design: &[usize], ground: &'a Ground<'a>) -> Self {
        let considered = &ground.contact.considered;
        let mut sources: Vec<(&str, Vec<usize>)> = Vec::new();
        for (index, source) in considered.sources.iter().enumerate() {
            match sources.iter_mut().find(|(name, _)| name == source) {
                Some((_, members)) => members.push(index),
                None => sources.push((source, vec![index])),
            }
        }
        let values = ground.scaled.sensitivities(&ground.known, design, &figures.covariance);
        Self { figures, ground, values, sources }
    }

    /// A sum of unknowns, by their indices and factors.
    fn of(&self, name: String, is_angle: bool, limit: f64, terms: &[(usize, f64)]) -> Quantified {
        let (all, covariance) = (self.ground.contact.unknowns.len(), &self.figures.covariance);
        let each = |(one, by): &(usize, f64)| -> f64 {
            terms.iter().map(|(other, factor)| by * factor * covariance[one * all + other]).sum()
        };
        let considered = &self.ground.contact.considered;
        let count = considered.unknowns.len();
        let sensitivity =
            |known: usize| -> f64 { terms.iter().map(|(one, by)| by * self.values[one * count + known]).sum() };
        let by_source = |(_, members): &(&str, Vec<usize>)| -> f64 {
            let pairs = members.iter().flat_map(|&one| members.iter().map(move |&other| (one, other)));
            pairs.map(|(one, other)| sensitivity(one) * considered.covariance[one][other] * sensitivity(other)).sum()
        };
        let known = self.sources.iter().map(by_source).map(|variance| variance.max(0.0)).collect();
        Quantified { name, is_angle, limit, rows: terms.iter().map(each).sum::<f64>().max(0.0), known }
    }
}

/// What may be so many times as uncertain as it is stated has no effect but by rounding.
const NOTHING: f64 = 1e6;

/// What a design reaches: the quantity that is nearest to what is wanted of it, or furthest beyond.
pub fn reached((figures, design, ground): (&PlanFigures, &[usize], &Ground<'_>), until: &Until) -> Result<Reached> {
    let factor = until.coverage_factor;
    let sensitivities = Sensitivities::new(figures, design, ground);
    let quantities = match until.of {
        Of::Parameters => of_parameters(&sensitivities, until),
        Of::Tool => of_tool(&sensitivities, until)?,
    };
    let ratio = |one: &Quantified| factor * one.variance().sqrt() / one.limit;
    let worst = quantities.iter().max_by(|one, other| ratio(one).total_cmp(&ratio(other)));
    let Some(worst) = worst else {
        let error = wrong("until", "nothing that is estimated is of this kind");
        return Err(error
            .help("`expanded_um` is for lengths, `expanded_urad` for angles; `of: tool` counts what moves the tip"));
    };
    // The largest part of a variance with which all quantities stay within their limits.
    let part = |of: &dyn Fn(&Quantified) -> f64| -> Option<f64> {
        let mut each = quantities.iter().map(|one| {
            let (own, left) = (of(one), (one.limit / factor).powi(2) - (one.variance() - of(one)));
            if left <= 0.0 { None } else { Some(if own > 0.0 { (left / own).sqrt() } else { f64::INFINITY }) }
        });
        each.try_fold(f64::INFINITY, |least, one| Some(least.min(one?)))
    };
    let problem = &ground.contact;
    let uncertainties = problem.standard_uncertainties();
    let alike = problem.sets.iter().all(|set| set.info().angles.is_empty())
        && uncertainties.iter().all(|one| (one / uncertainties[0] - 1.0).abs() < 1e-9);
    let own = ground.of_mean.unwrap_or(uncertainties[0]);
    let largest_of_row = match alike && ground.scaled.measured_rows == 0 {
        true => part(&|one| one.rows).map(|part| own * part),
        false => None,
    };
    let inputs = sensitivities.sources.iter().enumerate().map(|(place, (name, members))| {
        let only = (members.len() == 1).then(|| members[0]);
        LargestOfInput {
            name: (*name).to_owned(),
            stated: only.map(|index| problem.considered.covariance[index][index].sqrt()),
            is_length: only.is_some_and(|index| problem.considered.unknowns[index].unit == abbe_core::Unit::MM),
            part: part(&|one| one.known[place]),
        }
    });
    Ok(Reached {
        worst: worst.name.clone(),
        is_angle: worst.is_angle,
        expanded: factor * worst.variance().sqrt(),
        wanted: worst.limit,
        coverage_factor: factor,
        largest_of_row,
        largest_of_inputs: inputs.filter(|input| input.part.is_none_or(|part| part < NOTHING)).collect(),
    })
}

/// What a plan reaches: in its order, if it has one. What is known of artefact and probe is propagated for the order of the list only, so
/// that with such inputs that order counts.
pub fn reached_by(plan: &Plan, (design, ground): (&[usize], &Ground<'_>), until: &Until) -> Result<Reached> {
    let in_order = plan.order.as_ref().filter(|_| ground.contact.considered.sources.is_empty());
    let figures = in_order.map_or(&plan.figures, |order| &order.figures);
    reached((figures, design, ground), until)
}

/// Unknowns that count and are lengths or angles.
fn of_parameters(sensitivities: &Sensitivities<'_>, until: &Until) -> Vec<Quantified> {
    let ground = sensitivities.ground;
    let unknowns = ground.problem.unknowns.iter().enumerate();
    let counting = unknowns.filter(|(_, unknown)| counts(unknown, ground.wanted));
    let limited = counting.filter_map(|(index, unknown)| {
        let alone = unknown.unit.per.is_none() && unknown.unit.and_per.is_none();
        let is_angle = unknown.unit.of == Quantity::Angle;
        let limit = match unknown.unit.of {
            Quantity::Length if alone => until.expanded_um.map(|limit| limit * 1e-3),
            Quantity::Angle if alone => until.expanded_urad.map(|limit| limit * 1e-6),
            _ => None,
        };
        Some(sensitivities.of(unknown.name.clone(), is_angle, limit?, &[(index, 1.0)]))
    });
    limited.collect()
}

/// The tip along x, y and z of the table at all candidates, by the errors of the machine that are estimated; what is left of the
/// offsets of the set-up is among them.
fn of_tool(sensitivities: &Sensitivities<'_>, until: &Until) -> Result<Vec<Quantified>> {
    let Some(limit) = until.expanded_um.map(|limit| limit * 1e-3) else { return Ok(Vec::new()) };
    let problem = sensitivities.ground.problem;
    let unknowns = &problem.unknowns;
    let machine: Vec<usize> = (0..unknowns.len()).filter(|&index| unknowns[index].owner == Owner::Machine).collect();
    let variables: Vec<Variable> = machine.iter().map(|&index| Variable::Parameter(unknowns[index].index)).collect();
    let mut found = Vec::new();
    for set in &problem.sets {
        let layout = &set.info().layout;
        for &row in &set.rows {
            for pose in layout.rows[row].pose_indices() {
                let mut tip = Poses::default();
                let values = problem.model.info().without_errors();
                problem.model.poses(set.poses().row(pose), &values, &variables, false, &mut tip)?;
                for (part, letter) in ["x", "y", "z"].into_iter().enumerate() {
                    let by = |(column, &index): (usize, &usize)| (index, tip.position_derivatives[column][part]);
                    let terms: Vec<(usize, f64)> = machine.iter().enumerate().map(by).collect();
                    let name = format!("the tip along {letter} at row {}", row.0 + 1);
                    found.push(sensitivities.of(name, false, limit, &terms));
                }
            }
        }
    }
    Ok(found)
}

/// All that is allowed is not enough.
pub fn out_of_reach(all: &Plan) -> Error {
    let Some(reached) = &all.reached else { return wrong("until", "this is out of reach") };
    let number: usize = all.chosen.iter().map(|chosen| chosen.times).sum();
    let (unit, factor) = if reached.is_angle { ("µrad", 1e6) } else { ("µm", 1e3) };
    let message = format!(
        "the most that may be chosen ({number}) leave an expanded uncertainty of {:.4} {unit} of {}; {:.4} {unit} is wanted",
        reached.expanded * factor,
        reached.worst,
        reached.wanted * factor
    );
    let mut ways: Vec<String> = Vec::new();
    ways.extend(reached.largest_of_row.map(|largest| {
        format!("these reach it if a row has a standard uncertainty of {:.4} µm or less", largest * 1e3)
    }));
    let parts = || reached.largest_of_inputs.iter().filter_map(|input| Some((input, input.part?)));
    ways.extend(parts().map(|(input, part)| match (input.stated, input.is_length) {
        (Some(stated), true) => {
            format!(
                "if {} has one of {:.4} µm or less instead of {:.4} µm",
                input.name,
                stated * part * 1e3,
                stated * 1e3
            )
        }
        _ => format!("if the uncertainty of {} is {part:.4} times what is stated", input.name),
    }));
    if !reached.largest_of_inputs.is_empty() && parts().next().is_none() {
        ways.push("no better calibration of artefact or probe suffices by itself".to_owned());
    }
    ways.push(
        "or offer more candidates, measure better, or allow `replications: true` with a larger `number`".to_owned(),
    );
    wrong("until", message).help(ways.join("; "))
}

//! Chooses which measurements to make for a planned estimate: the candidates that determine its unknowns best (Soons 1993,
//! section 4.4; Rahman 2016, section 8.3).
//!
//! A candidate is a row of an artefact's data, or all rows with one label: an indexation. What the estimate observes beside
//! the candidates has been measured already. The plan follows from the derivatives of the problem at nominal contact alone,
//! so that this crate knows no machine and no artefact.

mod again;
mod candidates;
mod generate;
mod order;
mod settings;
mod until;

use abbe_core::{
    DataRow, EquationIndex, Error, PathItem, Problem, Result, RowIndex, Unknown, Whole, in_parallel, matches,
};
use abbe_estimation::rank_point;
use abbe_numerics::{Criterion, Design, DesignFigures, DesignProblem, Generator};

pub use again::Revisit;
pub use generate::generate;
pub use order::Order;
pub use settings::{Again, Change, GeneratedLengths, Generation, Of, Ordering, Planning, PlanningCriterion, Until};
pub use until::Reached;

use candidates::{Candidate, candidates};

/// Number of random designs with which a plan is compared.
const RANDOM: u64 = 200;

/// Number of the first stream of random numbers for these designs; searches use lower numbers.
const RANDOM_STREAM: u64 = 1 << 32;

/// A plan of measurements.
#[derive(Clone)]
pub struct Plan {
    /// The chosen candidates in the order of the data.
    pub chosen: Vec<Chosen>,
    /// Number of candidates to choose from.
    pub candidates: usize,
    /// Rows of the candidates' data set, ascending. The rows of a candidate that is measured twice occur twice.
    pub data_rows: Vec<DataRow>,
    /// The problem with the rows that are measured already and the chosen rows.
    pub problem: Problem,
    /// Figures of the plan.
    pub figures: PlanFigures,
    /// Figures of candidates that are spread evenly over the list, as one would choose without a plan. None if they do not
    /// determine all unknowns.
    pub spread_evenly: Option<PlanFigures>,
    /// D-efficiency of random plans relative to this plan: ratio of the p-th roots of the determinants, p being the number of
    /// unknowns that count. The median of random plans with the same number of candidates. None if half of them do not
    /// determine all unknowns.
    pub random_efficiency: Option<f64>,
    /// Number of searches that found this plan or one that is as good.
    pub searches_that_found_it: usize,
    /// The order in which the candidates are measured, if one was wanted.
    pub order: Option<Order>,
    /// What it reaches of a wanted uncertainty, if one was wanted.
    pub reached: Option<Reached>,
}

/// A chosen candidate.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Chosen {
    /// Its label, or the number of its data row, after the name of its file if there are several.
    pub label: String,
    /// How often it is measured.
    pub times: usize,
    /// Whether it was required.
    pub required: bool,
}

/// How well a plan determines the unknowns that count.
#[derive(Debug, Clone, PartialEq)]
pub struct PlanFigures {
    /// Number of equations, including those that are measured already.
    pub equations: usize,
    /// Logarithm of the determinant of the information of the unknowns that count, in the units of memory.
    pub log_determinant: f64,
    /// Condition number of the equations with columns of norm 1.
    pub condition: f64,
    /// Mean and largest variance of what the candidates would measure, in units of the variance of one equation, times the
    /// number of equations: the larger one is at least the number of unknowns.
    pub response_variance: [f64; 2],
    /// Covariance of the unknowns, row by row, in the units of memory.
    pub covariance: Vec<f64>,
    /// The number of unknowns that count.
    pub of_interest: usize,
}

impl PlanFigures {
    /// Standard uncertainties of the unknowns, in the units of memory.
    pub fn standard_uncertainties(&self) -> Vec<f64> {
        let unknowns = self.covariance.len().isqrt();
        (0..unknowns).map(|index| self.covariance[index * unknowns + index].sqrt()).collect()
    }

    /// D-efficiency of another plan relative to this one: ratio of the p-th roots of the determinants, p being the number of
    /// unknowns that count. This plan with that part of its measurements would be as good as the other one.
    pub fn efficiency_of(&self, other: &Self) -> f64 {
        ((other.log_determinant - self.log_determinant) / self.of_interest as f64).exp()
    }
}

/// Chooses candidates for a problem.
///
/// Fails for names that the problem does not know, candidates that cannot determine the unknowns however many are measured,
/// numbers or budgets that are too small, and a wanted uncertainty that is out of reach.
pub fn plan(problem: &Problem, wanted: &Planning) -> Result<Plan> {
    match &wanted.until {
        Some(until) => until::fewest(problem, wanted, until),
        None => plan_of(problem, wanted),
    }
}

/// Chooses so many candidates.
fn plan_of(problem: &Problem, wanted: &Planning) -> Result<Plan> {
    let contact = rank_point(problem, &problem.start())?;
    let order = order(problem, wanted)?;
    let found = candidates(&contact, wanted)?;
    let scaled = Scaled::new(&contact, &found, &order)?;
    let choice = scaled.choice(&found, wanted, count(problem, wanted));
    if choice.figures(&(0..found.len()).collect::<Vec<_>>()).is_none() {
        let message = "even all candidates together leave something open";
        return Err(wrong("candidates", message).help("offer more candidates, or estimate fewer parameters"));
    }
    let searches: Vec<u64> = (0..wanted.restarts.get() as u64).collect();
    let searched = in_parallel(&searches, None, |search| choice.exchange(&mut Generator::new(wanted.seed, *search)));
    let designs: Vec<Design> = searched.into_iter().flatten().collect();
    let best = designs.iter().fold(None, |best: Option<&Design>, design| match best {
        Some(best) if best.value >= design.value => Some(best),
        _ => Some(design),
    });
    let best = best.ok_or_else(|| too_small(wanted))?;
    let scaled_figures = choice.figures(&best.chosen).ok_or_else(|| too_few(wanted, problem.unknowns.len()))?;
    let random_efficiency = random(&choice, wanted.seed, &best.chosen, scaled_figures.log_determinant);
    let alike = |design: &&Design| (design.value - best.value).abs() <= 1e-6 * best.value.abs().max(1.0);
    let figures = scaled.figures(&choice, &best.chosen, scaled_figures);
    let evenly = evenly(&choice, best.chosen.len());
    let order = order::order(&contact, (&found, &scaled, &choice), &best.chosen, wanted)?;
    Ok(Plan {
        reached: None,
        order,
        candidates: found.len(),
        chosen: chosen(&found, &best.chosen, &choice.required),
        data_rows: data_rows(&contact, &found, &best.chosen, wanted),
        problem: restricted(problem, &found, &best.chosen, wanted),
        spread_evenly: choice.figures(&evenly).map(|even| scaled.figures(&choice, &evenly, even)),
        random_efficiency,
        figures,
        searches_that_found_it: designs.iter().filter(alike).count(),
    })
}

/// An error about a setting of the plan.
fn wrong(key: &str, message: impl Into<String>) -> Error {
    Error::usage(message).setting(key)
}

fn too_small(wanted: &Planning) -> Error {
    match (wanted.number, wanted.budget_s) {
        (Some(number), _) if wanted.required.len() > number.get() => {
            wrong("required", format!("more than the {} that are wanted", number.get()))
        }
        (Some(_), None) => {
            wrong("number", "there are not so many candidates").help("allow `replications: true`, or want fewer")
        }
        _ => wrong("budget_s", "no candidate, or not what is required, fits into this time"),
    }
}

fn too_few(wanted: &Planning, unknowns: usize) -> Error {
    let key = if wanted.number.is_some() { "number" } else { "budget_s" };
    wrong(key, format!("too small to determine {unknowns} unknowns")).help("allow more, or estimate fewer parameters")
}

/// The unknowns in the order of the choice: those that count first.
fn order(problem: &Problem, wanted: &Planning) -> Result<Vec<usize>> {
    let names = || problem.unknowns.iter().map(|unknown| unknown.name.as_str());
    for (index, pattern) in wanted.parameters.iter().enumerate() {
        if !names().any(|name| matches(pattern, name)) {
            let message = format!("`{pattern}` matches nothing that is estimated");
            let mut error = wrong("parameters", message).suggest(pattern, names());
            error.setting.push(PathItem::Index(index));
            return Err(error);
        }
    }
    let (counting, others): (Vec<usize>, Vec<usize>) =
        (0..problem.unknowns.len()).partition(|&index| counts(&problem.unknowns[index], wanted));
    Ok([counting, others].concat())
}

fn counts(unknown: &Unknown, wanted: &Planning) -> bool {
    wanted.parameters.is_empty() || wanted.parameters.iter().any(|pattern| matches(pattern, &unknown.name))
}

/// How many unknowns count.
fn count(problem: &Problem, wanted: &Planning) -> usize {
    problem.unknowns.iter().filter(|unknown| counts(unknown, wanted)).count()
}

/// The weighted derivatives of all rows, with columns of norm 1.
struct Scaled {
    /// Rows of the candidates, one candidate after another.
    rows: Vec<f64>,
    ends: Vec<usize>,
    /// Information matrix of the rows that are no candidates.
    measured: Vec<f64>,
    /// Number of the rows that are no candidates.
    measured_rows: usize,
    /// Norms of the columns.
    norms: Vec<f64>,
    /// Index of the unknown of every column.
    order: Vec<usize>,
}

impl Scaled {
    fn new(contact: &Problem, candidates: &[Candidate], order: &[usize]) -> Result<Self> {
        let p = order.len();
        let mut all = weighted(contact, order)?;
        let norm = |column: usize| all.iter().skip(column).step_by(p).map(|value| value * value).sum::<f64>().sqrt();
        // A column of zeros is reported later: no plan determines its unknown.
        let norms: Vec<f64> = (0..p).map(norm).map(|norm| if norm > 0.0 { norm } else { 1.0 }).collect();
        all.chunks_exact_mut(p).for_each(|row| row.iter_mut().zip(&norms).for_each(|(value, norm)| *value /= norm));
        let (mut rows, mut ends) = (Vec::new(), Vec::new());
        let mut chosen = vec![false; all.len() / p];
        for candidate in candidates {
            for &EquationIndex(equation) in &candidate.equations {
                rows.extend_from_slice(&all[equation * p..(equation + 1) * p]);
                chosen[equation] = true;
            }
            ends.push(rows.len() / p);
        }
        let mut measured = vec![0.0; p * p];
        let others = all.chunks_exact(p).zip(&chosen).filter(|(_, chosen)| !**chosen);
        let mut measured_rows = 0;
        for (row, _) in others {
            measured_rows += 1;
            for (one, line) in row.iter().zip(measured.chunks_exact_mut(p)) {
                line.iter_mut().zip(row).for_each(|(sum, other)| *sum += one * other);
            }
        }
        Ok(Self { rows, ends, measured, measured_rows, norms, order: order.to_vec() })
    }

    /// The rows of the candidates of a problem at other poses, one candidate after another, in the same columns.
    fn rows_of(&self, problem: &Problem, candidates: &[Candidate]) -> Result<Vec<f64>> {
        let (all, p) = (weighted(problem, &self.order)?, self.order.len());
        let equations = candidates.iter().flat_map(|candidate| &candidate.equations);
        let rows = equations.flat_map(|&EquationIndex(equation)| {
            all[equation * p..(equation + 1) * p].iter().zip(&self.norms).map(|(value, norm)| value / norm)
        });
        Ok(rows.collect())
    }

    fn choice(&self, candidates: &[Candidate], wanted: &Planning, of_interest: usize) -> DesignProblem {
        let required = candidates.iter().enumerate();
        let required = required.flat_map(|(index, candidate)| std::iter::repeat_n(index, candidate.required)).collect();
        DesignProblem {
            unknowns: self.order.len(),
            of_interest,
            rows: self.rows.clone(),
            ends: self.ends.clone(),
            measured: self.measured.clone(),
            costs: candidates.iter().map(|candidate| candidate.duration).collect(),
            required,
            allowed: candidates.iter().map(|candidate| !candidate.forbidden).collect(),
            replications: wanted.replications,
            number: wanted.number.map(Whole::get),
            budget: wanted.budget_s,
            criterion: match wanted.criterion {
                PlanningCriterion::D => Criterion::D,
                PlanningCriterion::A => Criterion::A,
                PlanningCriterion::E => Criterion::E,
                PlanningCriterion::G => Criterion::G,
                PlanningCriterion::Condition => Criterion::Condition,
            },
        }
    }

    /// Figures in the units of the unknowns.
    fn figures(&self, choice: &DesignProblem, chosen: &[usize], figures: DesignFigures) -> PlanFigures {
        let p = self.order.len();
        let first = |index: usize| if index == 0 { 0 } else { choice.ends[index - 1] };
        let equations = chosen.iter().map(|&index| choice.ends[index] - first(index)).sum::<usize>();
        let equations = equations + self.measured_rows;
        let mut covariance = vec![0.0; p * p];
        for (row, &one) in self.order.iter().enumerate() {
            for (column, &other) in self.order.iter().enumerate() {
                let scaled = figures.covariance[row * p + column];
                covariance[one * p + other] = scaled / (self.norms[row] * self.norms[column]);
            }
        }
        let of_interest = choice.of_interest;
        let scales: f64 = self.norms[..of_interest].iter().map(|norm| norm.ln()).sum();
        PlanFigures {
            equations,
            log_determinant: figures.log_determinant + 2.0 * scales,
            condition: figures.condition,
            response_variance: figures.response_variance.map(|variance| variance * equations as f64),
            covariance,
            of_interest,
        }
    }
}

/// The weighted derivatives of a problem, its unknowns in this order.
fn weighted(problem: &Problem, order: &[usize]) -> Result<Vec<f64>> {
    let uncertainties = problem.standard_uncertainties();
    let mut all: Vec<f64> = Vec::with_capacity(problem.equations() * order.len());
    problem.linearise(&problem.start(), |block| {
        for (equation, _, derivatives) in block.lines() {
            let weight = 1.0 / uncertainties[equation];
            all.extend(order.iter().map(|&column| derivatives[column] * weight));
        }
    })?;
    Ok(all)
}

/// As many candidates, spread evenly over the list.
fn evenly(choice: &DesignProblem, number: usize) -> Vec<usize> {
    let allowed: Vec<usize> = (0..choice.candidates()).filter(|&index| choice.allowed[index]).collect();
    let rest = number.saturating_sub(choice.required.len());
    let spread = (0..rest.min(allowed.len())).map(|k| allowed[(2 * k + 1) * allowed.len() / (2 * rest)]);
    choice.required.iter().copied().chain(spread).collect()
}

/// D-efficiency of random designs of the same number relative to the plan, the ratio of the p-th roots of the determinants:
/// that of the median. None if half of them do not determine all unknowns.
fn random(choice: &DesignProblem, seed: u64, design: &[usize], log_determinant: f64) -> Option<f64> {
    let allowed: Vec<usize> = (0..choice.candidates()).filter(|&index| choice.allowed[index]).collect();
    let of_one = |trial: u64| {
        let mut generator = Generator::new(seed, RANDOM_STREAM + trial);
        let (mut chosen, mut free) = (choice.required.clone(), allowed.clone());
        while chosen.len() < design.len() && !free.is_empty() {
            let at = generator.index(free.len());
            chosen.push(if choice.replications { free[at] } else { free.swap_remove(at) });
        }
        choice.log_determinant(&chosen).unwrap_or(f64::NEG_INFINITY)
    };
    let mut values: Vec<f64> = (0..RANDOM).map(of_one).collect();
    values.sort_by(f64::total_cmp);
    let median = values[values.len() / 2];
    median.is_finite().then(|| ((median - log_determinant) / choice.of_interest as f64).exp())
}

fn chosen(candidates: &[Candidate], design: &[usize], required: &[usize]) -> Vec<Chosen> {
    let times = |index: usize| design.iter().filter(|chosen| **chosen == index).count();
    let of_design = candidates.iter().enumerate().filter(|(index, _)| design.contains(index));
    of_design
        .map(|(index, candidate)| Chosen {
            label: candidate.label.clone(),
            times: times(index),
            required: required.contains(&index),
        })
        .collect()
}

/// The rows of the candidates' data set that the plan contains, ascending.
fn data_rows(problem: &Problem, candidates: &[Candidate], design: &[usize], wanted: &Planning) -> Vec<DataRow> {
    let Some(set) = problem.sets.iter().find(|set| set.name == wanted.candidates) else { return Vec::new() };
    let layout = &set.info().layout;
    let rows = design.iter().flat_map(|&index| &candidates[index].rows);
    let mut rows: Vec<DataRow> = rows.filter_map(|&row| layout.rows[row].data_row).collect();
    rows.sort_unstable();
    rows
}

/// The problem with the chosen rows, each once, and the rows that are measured already.
fn restricted(problem: &Problem, candidates: &[Candidate], design: &[usize], wanted: &Planning) -> Problem {
    let Some(set) = problem.set_named(&wanted.candidates) else { return problem.clone() };
    let possible = |row: &RowIndex| candidates.iter().any(|candidate| candidate.rows.contains(row));
    let mut rows: Vec<RowIndex> = problem.sets[set].rows.iter().copied().filter(|row| !possible(row)).collect();
    rows.extend(design.iter().flat_map(|&index| candidates[index].rows.iter().copied()));
    rows.sort_unstable();
    rows.dedup();
    problem.with_rows(set, rows)
}

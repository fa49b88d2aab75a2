//! Chooses which measurements to make for a planned estimate: the candidates that determine its unknowns best (Soons 1993,
//! section 4.4; Rahman 2016, section 8.3).
//!
//! A candidate is a row of an artefact's data, or all rows with one label: an indexation. What the estimate observes beside
//! the candidates has been measured already. The plan follows from the derivatives of the problem at nominal contact alone,
//! so that this crate knows no machine and no artefact.

mod again;
mod candidates;
mod generate;
mod minutes;
mod order;
mod scaled;
mod settings;
mod until;

use abbe_core::{DataRow, Error, PathItem, Problem, Result, RowIndex, Unknown, in_parallel, matches};
use abbe_estimation::rank_point;
use abbe_measuring::Timing;
use abbe_numerics::{Design, DesignProblem, Generator};

pub use again::Revisit;
pub use generate::generate;
pub use order::Order;
pub use settings::{
    Again, Change, GeneratedLengths, Generation, Of, Ordering, Planning, PlanningCriterion, Repeating, Until,
};
pub use until::{LargestOfInput, Reached};

use candidates::{Candidate, candidates};
use scaled::{Known, Scaled};

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
    /// How often the measuring program makes each touch.
    pub repeats: usize,
    /// Standard uncertainty of such a mean, mm, if touches are repeated and all alike.
    pub of_mean: Option<f64>,
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

/// Chooses candidates for a problem. `timing` has the rows of the candidates' data as touches; `minutes` need it.
///
/// Fails for names that the problem does not know, candidates that cannot determine the unknowns however many are measured,
/// numbers or budgets that are too small, and a wanted uncertainty that is out of reach.
pub fn plan(problem: &Problem, wanted: &Planning, timing: Option<&Timing<'_>>) -> Result<Plan> {
    match (&wanted.until, wanted.minutes, timing) {
        (_, Some(minutes), Some(timing)) => minutes::within(problem, wanted, minutes, timing),
        (_, Some(_), None) => Err(wrong("minutes", "the program that measures the plan is not known")),
        (Some(until), None, _) => until::fewest(problem, wanted, until),
        (None, None, _) => plan_of(problem, wanted, None),
    }
}

/// Chooses so many candidates.
fn plan_of(problem: &Problem, wanted: &Planning, until: Option<&Until>) -> Result<Plan> {
    let ground = Ground::new(problem, wanted)?.repeated(wanted.stated_repeats())?;
    let choice = ground.choice(ground.wanted.budget_s);
    ground.check(&choice)?;
    let designs = searched(&choice, wanted.restarts.get(), wanted.seed);
    let best = best(&designs).ok_or_else(|| too_small(wanted))?;
    let alike = |design: &&Design| (design.value - best.value).abs() <= 1e-6 * best.value.abs().max(1.0);
    let mut plan = ground.plan(&choice, &best.chosen, designs.iter().filter(alike).count())?;
    let reached = until.map(|until| until::reached_by(&plan, (&best.chosen, &ground), until));
    plan.reached = reached.transpose()?;
    Ok(plan)
}

/// Designs from random starts.
fn searched(choice: &DesignProblem, restarts: usize, seed: u64) -> Vec<Design> {
    let searches: Vec<u64> = (0..restarts as u64).collect();
    let found = in_parallel(&searches, None, |search| choice.exchange(&mut Generator::new(seed, *search)));
    found.into_iter().flatten().collect()
}

/// The first of the best.
fn best(designs: &[Design]) -> Option<&Design> {
    designs.iter().fold(None, |best: Option<&Design>, design| match best {
        Some(best) if best.value >= design.value => Some(best),
        _ => Some(design),
    })
}

/// What plans of a problem are made of.
struct Ground<'a> {
    problem: &'a Problem,
    wanted: &'a Planning,
    /// The problem at nominal contact.
    contact: Problem,
    found: Vec<Candidate>,
    scaled: Scaled,
    /// What is considered beside the unknowns.
    known: Known,
    /// How often each touch is made.
    repeats: usize,
    of_mean: Option<f64>,
}

impl<'a> Ground<'a> {
    fn new(problem: &'a Problem, wanted: &'a Planning) -> Result<Self> {
        let contact = rank_point(problem, &problem.start())?;
        let order = order(problem, wanted)?;
        let found = candidates(&contact, wanted)?;
        let scaled = Scaled::new(&contact, &found, &order)?;
        let known = Known::new(&contact, &found, &scaled)?;
        Ok(Self { problem, wanted, contact, found, scaled, known, repeats: 1, of_mean: None })
    }

    /// The same with means of so many touches as rows.
    ///
    /// Fails if a row has a smaller uncertainty than the noise that repeats are to make smaller.
    fn repeated(mut self, repeats: usize) -> Result<Self> {
        self.repeats = repeats;
        let Some(repeating) = &self.wanted.repeats else { return Ok(self) };
        let uncertainties = self.problem.standard_uncertainties();
        let rows = self.found.iter().flat_map(|candidate| &candidate.equations);
        let rows: Vec<f64> = rows.map(|&equation| uncertainties[equation]).collect();
        let smallest = rows.iter().copied().fold(f64::INFINITY, f64::min);
        if repeating.noise_um * 1e-3 > smallest * (1.0 + 1e-9) {
            let message = format!(
                "a row has a standard uncertainty of {:.4} µm, and {} µm of it are to be noise",
                smallest * 1e3,
                repeating.noise_um
            );
            let mut error = wrong("repeats", message).help("the noise of a touch is a part of its uncertainty");
            error.setting.push(PathItem::Key("noise_um".to_owned()));
            return Err(error);
        }
        let factor = |row: &f64| row / repeating.of_mean(*row, repeats).max(f64::MIN_POSITIVE);
        if rows.iter().any(|row| factor(row) >= 1e6) {
            return Err(wrong("repeats", "a mean of touches would have no uncertainty"));
        }
        let is_one = rows.iter().all(|row| (row / smallest - 1.0).abs() < 1e-9);
        self.of_mean = is_one.then(|| repeating.of_mean(smallest, repeats));
        self.scaled.set_factors(rows.iter().map(factor).collect());
        Ok(self)
    }

    fn choice(&self, budget: Option<f64>) -> DesignProblem {
        let choice = self.scaled.choice(&self.found, self.wanted, count(self.problem, self.wanted));
        DesignProblem { budget, ..choice }
    }

    /// Refuses candidates that do not determine the unknowns even all together, and fewer rows than unknowns.
    fn check(&self, choice: &DesignProblem) -> Result<()> {
        if choice.number.is_some_and(|number| self.most_rows(number) < choice.unknowns)
            && choice.measured.iter().all(|known| *known == 0.0)
        {
            return Err(too_few(self.wanted, choice.unknowns));
        }
        match choice.figures(&(0..self.found.len()).collect::<Vec<_>>()) {
            Some(_) => Ok(()),
            None => {
                let message = "even all candidates together leave something open";
                Err(wrong("candidates", message).help("offer more candidates, or estimate fewer parameters"))
            }
        }
    }

    /// Rows that so many candidates have at most.
    fn most_rows(&self, number: usize) -> usize {
        let mut rows: Vec<usize> = self.found.iter().map(|candidate| candidate.equations.len()).collect();
        rows.sort_unstable_by(|one, other| other.cmp(one));
        match self.wanted.replications {
            true => rows.first().map_or(0, |most| number.saturating_mul(*most)),
            false => rows.into_iter().take(number).sum(),
        }
    }

    fn figures(&self, choice: &DesignProblem, design: &[usize]) -> Option<PlanFigures> {
        choice.figures(design).map(|figures| self.scaled.figures(choice, design, figures))
    }

    /// The plan of a design, which so many searches found.
    fn plan(&self, choice: &DesignProblem, design: &[usize], searches_that_found_it: usize) -> Result<Plan> {
        let Self { problem, wanted, contact, found, scaled, .. } = self;
        let figures = self.figures(choice, design).ok_or_else(|| too_few(wanted, problem.unknowns.len()))?;
        let log_determinant = choice.log_determinant(design).unwrap_or(f64::NEG_INFINITY);
        let evenly = evenly(choice, design.len());
        Ok(Plan {
            reached: None,
            order: order::order(contact, (found, scaled, choice), design, wanted)?,
            candidates: found.len(),
            chosen: chosen(found, design, &choice.required),
            data_rows: data_rows(contact, found, design, wanted),
            problem: restricted(problem, found, design, wanted),
            spread_evenly: self.figures(choice, &evenly),
            random_efficiency: random(choice, wanted.seed, design, log_determinant),
            figures,
            searches_that_found_it,
            repeats: self.repeats,
            of_mean: self.of_mean.filter(|_| self.repeats > 1),
        })
    }
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
    let key = match (wanted.minutes, wanted.number) {
        (Some(_), _) => "minutes",
        (None, Some(_)) => "number",
        (None, None) => "budget_s",
    };
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

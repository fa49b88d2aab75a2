//! One row that spoils a fit, or one statement: a cell that was cut off, a digit too few.

use abbe_core::{Evaluation, Problem, RowIndex, SetIndex};

use crate::compared::Fitted;
use crate::plausibility::large_errors_at;
use crate::plausible::Plausible;
use crate::weighted::Weighted;

/// Fewest and most rows of a problem in which one is looked for: a fit of all others is made for each that may be it.
const ROWS: std::ops::RangeInclusive<usize> = 10..=3000;

/// Rows with the largest residuals that may be it, at the start and after a step each.
const TRIED: usize = 2;

/// Most statements that may be it, of those that other rows check.
const STATEMENTS: usize = 30;

/// How many times residuals scatter less without a row if a model that lacks errors is right but for it, and most of what is stated then.
const FALLS: f64 = 10.0;
const GOOD: f64 = 5.0;

/// A row or a statement, and how well a problem fits with it and without.
struct Lone {
    without: Problem,
    place: String,
    before: Fitted,
    after: Fitted,
}

impl Lone {
    fn words(&self) -> String {
        format!(
            "without {} the residuals scatter {:.2} times as much as stated, and with it {:.2} times as much: is it right?",
            self.place,
            self.after.scatter(),
            self.before.scatter()
        )
    }
}

/// The sentence on one row, or on one statement of a certificate, without which residuals scatter as stated, where they do not with it. A
/// fall by 40 of chi-squared is asked for: of normal residuals one in ten million rows makes it.
///
/// ```
/// # use abbe_core::Problem;
/// fn told(problem: &Problem) -> String {
///     abbe_estimation::doubtful_row(problem).unwrap_or_else(|| "no row stands out alone".to_owned())
/// }
/// ```
pub fn doubtful_row(problem: &Problem) -> Option<String> {
    lone(problem).filter(|lone| lone.before.is_explained_by(&lone.after)).map(|lone| lone.words())
}

/// The sentence on one row without which all errors are plausible, and residuals a tenth of what they are at most.
///
/// ```
/// # use abbe_core::Problem;
/// # use abbe_estimation::Plausible;
/// fn told(problem: &Problem, plausible: &Plausible) -> String {
///     abbe_estimation::spoiling_row(problem, plausible).unwrap_or_else(|| "it is no single row".to_owned())
/// }
/// ```
pub fn spoiling_row(problem: &Problem, plausible: &Plausible) -> Option<String> {
    let lone = lone(problem)?;
    let falls = lone.before.scatter() > FALLS * lone.after.scatter() && lone.after.scatter() < GOOD;
    if !falls {
        return None;
    }
    let values = after_a_step(&lone.without)?;
    let large = large_errors_at(plausible, &lone.without.with_values(&values)).ok()?;
    (!large.iter().any(|large| large.is_implausible())).then(|| lone.words())
}

/// The row without which a problem fits best, of those with the largest residuals, and of statements.
fn lone(problem: &Problem) -> Option<Lone> {
    if !ROWS.contains(&problem.sets.iter().map(|set| set.rows.len()).sum()) {
        return None;
    }
    let before = Fitted::beyond_chance(problem, None)?;
    let mut rows = largest(problem, &problem.start());
    rows.extend(after_a_step(problem).map(|values| largest(problem, &values)).unwrap_or_default());
    rows.sort_unstable();
    rows.dedup();
    let places = rows.into_iter().filter_map(|(set, row)| {
        let (file, origin) = problem.origin(set, row)?;
        Some(((set, row), origin.in_file(file)))
    });
    let tried = places.chain(statements(problem)).filter_map(|((set, row), place)| {
        let mut without = problem.clone();
        without.sets[set].rows.retain(|own| *own != row);
        let after = Fitted::of(&without)?;
        Some(Lone { without, place, before, after })
    });
    tried.min_by(|one, other| one.after.squares.total_cmp(&other.after.squares))
}

/// The rows of statements that were not measured here, with words for what is stated; none where there are too many.
fn statements(problem: &Problem) -> Vec<((SetIndex, RowIndex), String)> {
    let mut rows: Vec<(SetIndex, RowIndex)> = problem
        .equation_rows()
        .into_iter()
        .zip(problem.constraints())
        .filter_map(|(row, is)| is.then_some(row))
        .collect();
    rows.dedup();
    rows.truncate(if rows.len() > STATEMENTS { 0 } else { STATEMENTS });
    rows.into_iter().filter_map(|(set, row)| Some(((set, row), statement(problem, set, row)?))).collect()
}

/// What a constraint states, by the name of its known input and of its artefact stage: `length[1-2] of balls, which is stated,`. None for
/// a row that depends on no known input, and where it cannot be evaluated.
pub fn statement(problem: &Problem, set: SetIndex, row: RowIndex) -> Option<String> {
    let mut work = Evaluation::default();
    problem.evaluate(set, &[row], &[], &mut work).ok()?;
    let &(_, input, _) = work.equations.by_input().first()?;
    let own = &problem.sets[set];
    Some(format!("{} of {}, which is stated,", own.info().inputs.get(input)?.parameter.name, own.name))
}

/// Values of all unknowns after one step, which is most of a fit.
fn after_a_step(problem: &Problem) -> Option<Vec<f64>> {
    let step = Weighted::new(problem).ok()?.factor(&problem.start(), None).ok()?.step()?;
    Some(problem.start().iter().zip(step).map(|(value, step)| value + step).collect())
}

/// The rows with the largest residuals.
fn largest(problem: &Problem, values: &[f64]) -> Vec<(SetIndex, RowIndex)> {
    let Ok(residuals) = problem.residuals(values) else { return Vec::new() };
    let sizes = residuals.into_iter().zip(problem.standard_uncertainties()).map(|(residual, u)| (residual / u).abs());
    let mut rows: Vec<(f64, (SetIndex, RowIndex))> =
        sizes.zip(problem.equation_rows()).filter(|(size, _)| size.is_finite()).collect();
    rows.sort_by(|(one, _), (other, _)| other.total_cmp(one));
    let mut found: Vec<(SetIndex, RowIndex)> = Vec::new();
    for (_, row) in rows {
        if !found.contains(&row) {
            found.push(row);
        }
        if found.len() == TRIED {
            break;
        }
    }
    found
}

//! One estimate from rows in parts: what each part tells, and all of it together.
//!
//! Least squares need of rows `[J | r]` the triangle of their QR decomposition alone, and triangles of parts make that of all rows
//! (Golub and Van Loan 2013, section 5.3.1; the tall and skinny QR of Demmel et al. 2012, SIAM J. Sci. Comput. 34:A206). So a
//! process holds the rows of one part, and what goes between processes has the size of the unknowns.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, Mutex, PoisonError};

use abbe_core::{
    AskedOfPart, EquationIndex, Error, PartEvidence, Parts, Problem, Quantity, QuestionToRows, ResidualSums, Result,
    SetIndex, SizeSums, Triangle, Unknown, WeighedSums,
};
use abbe_numerics::{Accumulator, Factor, LeastSquares, Weighing};

use crate::contact::rank_point;
use crate::judgement::Judgement;
use crate::residuals::point_squares;
use crate::weighted::Weighted;

/// What the rows of a part tell at some values of its unknowns.
///
/// Fails for rows that belong together with rows of other parts: repeats that are pooled, errors that rows share, constraints of
/// certificates.
pub fn part_evidence(problem: &Problem, asked: AskedOfPart, at: &[f64]) -> Result<PartEvidence> {
    check(problem)?;
    let names = |unknowns: &[Unknown]| -> Vec<String> { unknowns.iter().map(|known| known.name.clone()).collect() };
    let own = names(&problem.unknowns);
    if problem.equations() == 0 {
        return Ok(of_no_rows(asked, &own));
    }
    let recorded =
        || -> Result<Option<Triangle>> { Ok(Some(triangle(&own, &Weighted::new(problem)?.factor(at, None)?))) };
    match asked {
        AskedOfPart::Start => {
            let nominal = Judgement::new(problem, None)?;
            let nominal = Some(triangle(&own, nominal.factor()));
            Ok(PartEvidence { recorded: recorded()?, nominal, ..PartEvidence::default() })
        }
        AskedOfPart::Rows => Ok(PartEvidence { recorded: recorded()?, ..PartEvidence::default() }),
        AskedOfPart::Solution => {
            let in_contact = in_contact(problem, at, None)?;
            let residuals = Some(residual_sums(problem, problem.residuals(at)?)?);
            Ok(PartEvidence { in_contact, residuals, ..PartEvidence::default() })
        }
    }
}

/// The rows of each artefact in nominal contact, with columns for what is considered; those that are kept, with 0 or 1.
pub(crate) fn in_contact(problem: &Problem, at: &[f64], kept: Option<&[f64]>) -> Result<Vec<(String, Triangle)>> {
    let mut extended = rank_point(problem, at)?.with_values(at);
    extended.unknowns.extend(problem.considered.unknowns.iter().cloned());
    of_sets(&extended, kept)
}

/// The rows of each artefact at the values of a problem; those that are kept, with 0 or 1.
pub(crate) fn of_sets(problem: &Problem, kept: Option<&[f64]>) -> Result<Vec<(String, Triangle)>> {
    let columns: Vec<String> = problem.unknowns.iter().map(|known| known.name.clone()).collect();
    // A part need not have rows of every artefact.
    let (sets, ranges): (Vec<_>, Vec<_>) =
        problem.sets.iter().zip(problem.equation_ranges()).filter(|(_, range)| range.len() > 0).unzip();
    let factors = Weighted::new(problem)?.factors(&problem.start(), kept, &ranges)?;
    let factors = factors.iter().map(|factor| triangle(&columns, factor));
    Ok(sets.iter().map(|set| set.name.clone()).zip(factors).collect())
}

/// What a part without rows tells: nothing of its unknowns.
pub(crate) fn of_no_rows(asked: AskedOfPart, own: &[String]) -> PartEvidence {
    let rows = || Some(triangle(own, &Accumulator::new(own.len(), 0).finish()));
    match asked {
        AskedOfPart::Start => PartEvidence { recorded: rows(), nominal: rows(), ..PartEvidence::default() },
        AskedOfPart::Rows => PartEvidence { recorded: rows(), ..PartEvidence::default() },
        AskedOfPart::Solution => PartEvidence { residuals: Some(ResidualSums::default()), ..PartEvidence::default() },
    }
}

/// Refuses rows that depend on rows of other parts.
pub(crate) fn check(problem: &Problem) -> Result<()> {
    let refused = |set: usize, what: &str| {
        let message = format!("{what}, and no part has all of them");
        Err(Error::usage(message).help("estimate all rows at once: `abbe run`").stage(&problem.sets[set].name))
    };
    for (index, set) in problem.sets.iter().enumerate() {
        let layout = &set.info().layout;
        let row_of = |equation| layout.rows.partition_point(|row| row.first_equation <= equation);
        let rows_of = |equations: &[_]| equations.iter().map(|equation| row_of(*equation)).collect::<BTreeSet<_>>();
        if set.uncertainty.pooled.is_some() {
            return refused(index, "repeats are compared with each other");
        }
        if set.uncertainty.blocks.iter().any(|block| rows_of(&block.equations).len() > 1) {
            return refused(index, "rows share errors with others");
        }
        if layout.rows.iter().any(|row| row.data_row.is_none()) {
            return refused(index, "its certificate states what holds for all rows");
        }
    }
    Ok(())
}

/// What two parts of the rows tell together, as one part.
///
/// Fails for answers to different questions.
pub fn joined_evidence(one: &PartEvidence, other: &PartEvidence) -> Result<PartEvidence> {
    let both = |one: &Option<Triangle>, other: &Option<Triangle>| match (one, other) {
        (Some(one), Some(other)) => joined_triangle(one, other).map(Some),
        (None, None) => Ok(None),
        _ => Err(nothing()),
    };
    let residuals = match (&one.residuals, &other.residuals) {
        (Some(one), Some(other)) => Some(one.with(other)),
        (None, None) => None,
        _ => return Err(nothing()),
    };
    Ok(PartEvidence {
        recorded: both(&one.recorded, &other.recorded)?,
        nominal: both(&one.nominal, &other.nominal)?,
        in_contact: joined_sets(&one.in_contact, &other.in_contact)?,
        residuals,
        weighed: match (&one.weighed, &other.weighed) {
            (Some(one), Some(other)) => {
                let mut both = one.clone();
                both.join(other);
                Some(both)
            }
            (None, None) => None,
            _ => return Err(nothing()),
        },
    })
}

/// The rows of the artefacts of two parts.
pub(crate) fn joined_sets(one: &[(String, Triangle)], other: &[(String, Triangle)]) -> Result<Vec<(String, Triangle)>> {
    let mut joined = one.to_vec();
    for (set, triangle) in other {
        match joined.iter_mut().find(|(known, _)| known == set) {
            Some((_, known)) => *known = joined_triangle(known, triangle)?,
            None => joined.push((set.clone(), triangle.clone())),
        }
    }
    Ok(joined)
}

/// The triangle of the rows of both, with the columns of both.
fn joined_triangle(one: &Triangle, other: &Triangle) -> Result<Triangle> {
    let mut columns = one.columns.clone();
    let known: BTreeSet<&String> = one.columns.iter().collect();
    columns.extend(other.columns.iter().filter(|column| !known.contains(column)).cloned());
    let places = columns.iter().enumerate().map(|(place, column)| (column.as_str(), place)).collect();
    let mut accumulator = Accumulator::new(columns.len(), columns.len() + other.columns.len() + 2);
    for line in wide_lines(&places, columns.len(), one)?.into_iter().chain(wide_lines(&places, columns.len(), other)?) {
        accumulator.push(&line[..columns.len()], line[columns.len()], 1.0);
    }
    Ok(triangle(&columns, &accumulator.finish().of_rows(one.rows + other.rows)))
}

/// The lines of a triangle with a place for each of the first `count` columns, and the residual.
fn wide_lines(places: &BTreeMap<&str, usize>, count: usize, triangle: &Triangle) -> Result<Vec<Vec<f64>>> {
    let place = |name: &String| places.get(name.as_str()).copied().filter(|place| *place < count);
    let places: Option<Vec<usize>> = triangle.columns.iter().map(place).collect();
    let (places, lines) = places.zip(triangle.lines()).ok_or_else(nothing)?;
    let wide = |line: Vec<f64>| {
        let mut all = vec![0.0; count + 1];
        places.iter().chain([&count]).zip(line).for_each(|(place, value)| all[*place] = value);
        all
    };
    Ok(lines.into_iter().map(wide).collect())
}

/// A factor with the names of its columns.
pub(crate) fn triangle(columns: &[String], factor: &Factor) -> Triangle {
    let lines = factor.lines();
    let values = lines.iter().enumerate().flat_map(|(zeros, line)| line[zeros..].iter().copied());
    Triangle { columns: columns.to_vec(), values: values.collect(), rows: factor.rows() }
}

/// What `look` finds in all rows, joined in the order of the rows. It gets problems each of which has some of the rows and their unknowns,
/// from several threads; few answers wait for those before them. None if there are no rows.
///
/// Fails with the first error of `look`, and where other processes read the rows.
pub fn looked_at<T: Send>(
    parts: &dyn Parts,
    look: &(dyn Fn(&Problem) -> Result<T> + Sync),
    join: &(dyn Fn(&mut T, T) + Sync),
) -> Result<Option<T>> {
    let all: Mutex<(Option<T>, BTreeMap<usize, T>, usize)> = Mutex::new((None, BTreeMap::new(), 0));
    parts.show(&|number, problem| {
        let found = look(problem)?;
        let mut all = all.lock().unwrap_or_else(PoisonError::into_inner);
        let (sum, waiting, next) = &mut *all;
        waiting.insert(number, found);
        while let Some(found) = waiting.remove(next) {
            *next += 1;
            match sum {
                Some(sum) => join(sum, found),
                None => *sum = Some(found),
            }
        }
        Ok(())
    })?;
    Ok(all.into_inner().unwrap_or_else(PoisonError::into_inner).0)
}

/// A problem whose rows are all here, as one part.
pub struct RowsAtHand<'a>(pub &'a Problem);

impl Parts for RowsAtHand<'_> {
    fn count(&self) -> usize {
        1
    }

    fn evidence(&self, _: usize, asked: AskedOfPart, at: &BTreeMap<String, f64>) -> Result<Arc<PartEvidence>> {
        part_evidence(self.0, asked, &self.0.values_at(at)).map(Arc::new)
    }

    fn ask(&self, question: &QuestionToRows<'_>) -> Result<Option<PartEvidence>> {
        question(0, self.0).map(Some)
    }
}

/// Changes a sample of the rows.
type ChangeOfSample<'a> = dyn Fn(&Problem) -> Result<Problem> + 'a;

/// Rows in parts each of which is changed before anything is asked of it: fewer rows, other readings.
///
/// Only parts that can be read again and again are changed ([`Parts::ask`]).
pub struct ChangedParts<'a> {
    parts: &'a dyn Parts,
    change: &'a (dyn Fn(usize, &Problem) -> Result<Problem> + Sync),
    change_of_sample: Option<&'a ChangeOfSample<'a>>,
}

impl<'a> ChangedParts<'a> {
    /// The parts with a change, which gets the number of each part in the order of the rows.
    pub fn new(parts: &'a dyn Parts, change: &'a (dyn Fn(usize, &Problem) -> Result<Problem> + Sync)) -> Self {
        Self { parts, change, change_of_sample: None }
    }

    /// The same with the change of a sample of the rows, which has rows of many parts. Without it there is no sample.
    pub fn with_sample(self, change: &'a ChangeOfSample<'a>) -> Self {
        Self { change_of_sample: Some(change), ..self }
    }
}

impl Parts for ChangedParts<'_> {
    fn count(&self) -> usize {
        1
    }

    fn evidence(&self, _: usize, asked: AskedOfPart, at: &BTreeMap<String, f64>) -> Result<Arc<PartEvidence>> {
        let question = |_: usize, problem: &Problem| part_evidence(problem, asked, &problem.values_at(at));
        self.ask(&question)?.map(Arc::new).ok_or_else(nothing)
    }

    fn ask(&self, question: &QuestionToRows<'_>) -> Result<Option<PartEvidence>> {
        self.parts.ask(&|number, problem| question(number, &(self.change)(number, problem)?))
    }

    fn sample(&self) -> Result<Option<Problem>> {
        let Some(change) = self.change_of_sample else { return Ok(None) };
        self.parts.sample()?.map(|sample| change(&sample)).transpose()
    }
}

pub(crate) fn residual_sums(problem: &Problem, residuals: Vec<f64>) -> Result<ResidualSums> {
    let quantities = problem.quantities();
    let of = |angles: bool| {
        let own = residuals.iter().zip(&quantities).filter(move |(_, of)| (**of == Quantity::Angle) == angles);
        SizeSums::of(own.map(|(residual, _)| *residual))
    };
    let (lengths, angles) = (of(false), of(true));
    let points = point_squares(problem, &residuals, |_: EquationIndex| true);
    let weighted = Weighted::new(problem)?.in_uncertainties(residuals);
    Ok(ResidualSums {
        lengths,
        angles,
        weighted_squares: weighted.iter().map(|residual| residual * residual).sum(),
        points: (points.len(), points.iter().sum()),
    })
}

/// The rows of a problem in parts, as a least squares problem. Nothing of a part is kept but its triangle.
pub struct RowsInParts<'a> {
    problem: &'a Problem,
    parts: &'a dyn Parts,
    start: Vec<f64>,
    /// The columns of unknowns, then those of what is considered, by their names.
    columns: BTreeMap<&'a str, usize>,
}

/// What all parts together tell at a solution.
pub struct SolutionOfParts {
    /// The rows of every set in nominal contact, with columns for what is considered after those of the unknowns.
    pub(crate) of_sets: Vec<Factor>,
    /// All rows there.
    pub(crate) extended: Factor,
    pub(crate) residuals: ResidualSums,
    /// Of a robust estimate.
    pub(crate) kept: Option<KeptRows>,
}

/// What rows tell near the solution.
struct NearRows {
    /// Their gradient to the unknowns of all parts.
    gradient: Vec<f64>,
    /// The sum of their weighted squares.
    squares: f64,
    /// What they tell at the solution, if that was asked.
    told: Result<Option<PartEvidence>>,
}

impl NearRows {
    /// Adds rows that follow.
    fn join(&mut self, other: Self) {
        self.gradient.iter_mut().zip(other.gradient).for_each(|(sum, own)| *sum += own);
        self.squares += other.squares;
        if let (Ok(Some(one)), Ok(Some(other))) = (&self.told, &other.told) {
            self.told = joined_evidence(one, other).map(Some);
        }
    }
}

/// What a part tells at values of the unknowns of all parts, which stand at these columns.
fn told_near(problem: &Problem, (columns, x): (&BTreeMap<&str, usize>, &[f64]), is_solution: bool) -> Result<NearRows> {
    check(problem)?;
    let column = |unknown: &Unknown| columns.get(unknown.name.as_str()).copied().filter(|own| *own < x.len());
    let columns: Option<Vec<usize>> = problem.unknowns.iter().map(column).collect();
    let columns = columns.ok_or_else(nothing)?;
    let at: Vec<f64> = columns.iter().map(|column| x[*column]).collect();
    let weighted = Weighted::new(problem)?;
    let (of_part, residuals) = weighted.gradient_and_residuals(&at)?;
    let mut gradient = vec![0.0; x.len()];
    columns.iter().zip(of_part).for_each(|(column, own)| gradient[*column] += own);
    let told = || -> Result<PartEvidence> {
        let sums = Some(residual_sums(problem, residuals.clone())?);
        match problem.equations() {
            0 => Ok(PartEvidence { residuals: sums, ..PartEvidence::default() }),
            _ => Ok(PartEvidence {
                in_contact: in_contact(problem, &at, None)?,
                residuals: sums,
                ..PartEvidence::default()
            }),
        }
    };
    let told = is_solution.then(told).transpose()?;
    let squares = weighted.in_uncertainties(residuals).iter().map(|residual| residual * residual).sum();
    Ok(NearRows { gradient, squares, told: Ok(told) })
}

/// What robust weights have kept of all rows.
pub(crate) struct KeptRows {
    /// The rows that are kept where rank is judged.
    pub nominal: Factor,
    pub sums: WeighedSums,
}

impl<'a> RowsInParts<'a> {
    /// The rows of a problem that has the unknowns of all parts, and no rows.
    pub fn new(problem: &'a Problem, parts: &'a dyn Parts) -> Self {
        let all = problem.unknowns.iter().chain(&problem.considered.unknowns);
        let columns = all.enumerate().map(|(column, unknown)| (unknown.name.as_str(), column)).collect();
        Self { problem, parts, start: problem.start(), columns }
    }

    /// The parts.
    pub fn parts(&self) -> &'a dyn Parts {
        self.parts
    }

    pub(crate) fn columns(&self) -> &BTreeMap<&'a str, usize> {
        &self.columns
    }

    /// The problem, which has no rows.
    pub fn problem(&self) -> &'a Problem {
        self.problem
    }

    /// The factor of all rows in nominal contact at nominal geometry, where rank is judged.
    pub fn at_nominal_geometry(&self) -> Result<Factor> {
        let count = self.problem.unknowns.len();
        let all = self.all(AskedOfPart::Start, &self.start)?;
        self.joined(count, all.iter().map(|evidence| evidence.nominal.as_ref()))
    }

    /// What all rows tell at the solution, those of a robust estimate weighed.
    pub fn at_solution(&self, x: &[f64], weighing: Option<&Weighing>) -> Result<SolutionOfParts> {
        let all = match weighing {
            Some(weighing) => vec![Arc::new(self.weighed_solution(x, weighing)?)],
            None => self.all(AskedOfPart::Solution, x)?,
        };
        self.solution_of(all, weighing.is_some())
    }

    /// The factor of all rows at x, near the place of a factor that is known: its triangle, with the gradient and the cost at x. With
    /// `is_solution` also what all rows tell at the solution, for an x that is as good as it, in the same pass. None where the triangle
    /// is singular. Fails where other processes read the rows.
    pub fn near(
        &self,
        factor: &Factor,
        x: &[f64],
        is_solution: bool,
    ) -> Result<Option<(Factor, Option<SolutionOfParts>)>> {
        let columns = &self.columns;
        let look = |problem: &Problem| told_near(problem, (columns, x), is_solution);
        let join = |all: &mut NearRows, own: NearRows| all.join(own);
        let Some(NearRows { gradient, squares, told }) = looked_at(self.parts, &look, &join)? else { return Ok(None) };
        let Some(there) = factor.with_gradient(&gradient, squares) else { return Ok(None) };
        let told = told?.map(|told| self.solution_of(vec![Arc::new(told)], false)).transpose()?;
        Ok(Some((there, told)))
    }

    fn solution_of(&self, mut all: Vec<Arc<PartEvidence>>, is_weighed: bool) -> Result<SolutionOfParts> {
        let count = self.problem.unknowns.len() + self.problem.considered.unknowns.len();
        let of_set = |index: SetIndex| {
            let name = &self.problem.sets[index].name;
            let of_parts = all.iter().map(|part| part.in_contact.iter().find(|(set, _)| set == name));
            // A part may have no rows of an artefact.
            self.joined(count, of_parts.flatten().map(|(_, triangle)| Some(triangle)))
        };
        let of_sets = self.problem.set_indices().map(of_set).collect::<Result<Vec<Factor>>>()?;
        let extended = Factor::combined(&of_sets.iter().collect::<Vec<_>>()).ok_or_else(nothing)?;
        let sums = all.iter().map(|part| part.residuals.as_ref().ok_or_else(nothing));
        let residuals =
            sums.collect::<Result<Vec<_>>>()?.into_iter().fold(ResidualSums::default(), |all, own| all.with(own));
        let kept = match (is_weighed, all.pop()) {
            (true, Some(only)) => Some(KeptRows {
                nominal: self.joined(self.problem.unknowns.len(), std::iter::once(only.nominal.as_ref()))?,
                sums: only.weighed.clone().ok_or_else(nothing)?,
            }),
            _ => None,
        };
        Ok(SolutionOfParts { of_sets, extended, residuals, kept })
    }

    fn all(&self, asked: AskedOfPart, at: &[f64]) -> Result<Vec<Arc<PartEvidence>>> {
        let names = self.problem.unknowns.iter().map(|unknown| unknown.name.clone());
        let at = names.zip(at.iter().copied()).collect();
        (0..self.parts.count()).map(|part| self.parts.evidence(part, asked, &at)).collect()
    }

    /// The factor of all rows that some triangles are of.
    pub(crate) fn joined<'b>(
        &self,
        count: usize,
        triangles: impl Iterator<Item = Option<&'b Triangle>>,
    ) -> Result<Factor> {
        let (mut accumulator, mut rows) = (Accumulator::new(count, count + 1), 0);
        for triangle in triangles {
            let triangle = triangle.ok_or_else(nothing)?;
            rows += triangle.rows;
            for line in wide_lines(&self.columns, count, triangle)? {
                accumulator.push(&line[..count], line[count], 1.0);
            }
        }
        Ok(accumulator.finish().of_rows(rows))
    }
}

/// The error for a part that does not answer what it was asked.
pub(crate) fn nothing() -> Error {
    Error::data("a part of the rows does not tell what was asked of it")
}

impl LeastSquares for RowsInParts<'_> {
    type Error = Error;

    fn is_final(&self, error: &Error) -> bool {
        error.fatal
    }

    fn is_out_of_time(&self, error: &Error) -> bool {
        error.out_of_time
    }

    fn has_stepped(&self, iteration: usize, size: f64) {
        self.problem.monitor.iteration(iteration, size);
    }

    fn unknowns(&self) -> usize {
        self.problem.unknowns.len()
    }

    fn rows(&self) -> usize {
        self.parts.count() * (self.unknowns() + 1)
    }

    fn linearise(&self, x: &[f64], sink: &mut dyn FnMut(usize, &[f64], &[f64])) -> Result<()> {
        let asked = if x == self.start { AskedOfPart::Start } else { AskedOfPart::Rows };
        let (count, mut first) = (self.unknowns(), 0);
        // All of them: a process that asks others asks all at once.
        for evidence in self.all(asked, x)? {
            let triangle = evidence.recorded.as_ref().ok_or_else(nothing)?;
            for line in wide_lines(&self.columns, count, triangle)? {
                sink(first, &line[count..], &line[..count]);
                first += 1;
            }
        }
        Ok(())
    }
}

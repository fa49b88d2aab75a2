//! The minimum next to a point whose factor is known: trials of Monte Carlo, and the first steps of fits.

use crate::descent::Descent;
use crate::factor::Factor;
use crate::gauss_newton::{
    Before, End, LeastSquares, Minimum, Options, SAME_TRIANGLE, Solution, add, solve_after, solve_from, step_of,
};
use crate::vector::norm;

/// Part of the step before from which on a step does not shrink as it should.
const SHRINKS: f64 = 0.1;

/// Most steps.
const STEPS: usize = 30;

/// Minimises the sum of squares from `start`, by the factor of rows next to those there, or of these themselves (then it is known: true);
/// none if steps do not shrink as they should, so that [`solve`](crate::solve) has to.
///
/// Every step takes the gradient where it starts and the triangle of the factor, which is that of a minimum nearby: so it costs no
/// decomposition. Steps shrink by what the triangle is off. The end is that of [`Options`]: the minimum is that of the rows themselves,
/// whatever the triangle.
///
/// Fails if the start cannot be evaluated, and with an error that is final.
///
/// ```
/// use abbe_numerics::{LeastSquares, Options, Sink, solve, solve_near};
///
/// /// Readings of an exponential of the time.
/// struct Decay([f64; 3]);
///
/// impl LeastSquares for Decay {
///     type Error = ();
///     fn unknowns(&self) -> usize {
///         1
///     }
///     fn rows(&self) -> usize {
///         3
///     }
///     fn linearise(&self, x: &[f64], sink: Sink<'_>) -> Result<(), ()> {
///         let at = |time: f64| (-x[0] * time).exp();
///         let residuals = [1.0, 2.0, 3.0].map(at).iter().zip(self.0).map(|(model, read)| model - read).collect::<Vec<_>>();
///         sink(0, &residuals, &[1.0, 2.0, 3.0].map(|time| -time * at(time)));
///         Ok(())
///     }
/// }
/// let found = solve(&Decay([0.6, 0.37, 0.22]), &[0.5], &Options::USUAL).unwrap();
/// let other = Decay([0.61, 0.36, 0.23]);
/// let near = solve_near(&other, &found.x, (&found.factor, false), &Options::USUAL).unwrap().unwrap();
/// let full = solve(&other, &found.x, &Options::USUAL).unwrap();
/// assert!((near[0] - full.x[0]).abs() < 1e-9);
/// ```
pub fn solve_near<P: LeastSquares + ?Sized>(
    problem: &P,
    start: &[f64],
    known: (&Factor, bool),
    options: &Options,
) -> Result<Option<Vec<f64>>, P::Error> {
    let mut near = Near::after_first(problem, start, known);
    Ok(descended(problem, &mut near, known.0, options)?.then_some(near.x))
}

/// Like [`solve_from`](crate::solve_from), beginning with the steps of [`solve_near`] as far as they lead, by a factor of rows next to those
/// at the start, or of these themselves (`at_start`). From where these steps end, `solve` goes on: its end is that of the rows, whatever
/// the factor.
///
/// It pays where a gradient takes less time than a decomposition.
///
/// Fails as [`solve`](crate::solve) does.
pub fn solve_by_gradients<P: LeastSquares + ?Sized>(
    problem: &P,
    start: &[f64],
    (factor, at_start): (&Factor, bool),
    options: &Options,
) -> Result<Solution, P::Error> {
    let mut near = Near::after_first(problem, start, (factor, at_start));
    let towards = Options { tolerance: SAME_TRIANGLE, ..*options };
    let found = match descended(problem, &mut near, factor, &towards) {
        Ok(true) if near.steps < options.iterations => {
            let rest = Options { iterations: options.iterations - near.steps, ..*options };
            let solution = solve_after(problem, &near.x, None, near.before, &rest);
            solution.map(|solution| Solution { iterations: solution.iterations + near.steps, ..solution })
        }
        Err(error) if problem.has_no_more(&error) || problem.is_late(&error) => Err(error),
        Ok(_) | Err(_) => return solve_from(problem, start, at_start.then(|| factor.clone()), options),
    };
    match (found, near.before.last) {
        // These steps do not ask whether they lead down: it may be another minimum, and a worse place than the start.
        (Ok(found), _) if at_start && found.factor.cost() > factor.cost() && found.robust.is_none() => {
            solve_from(problem, start, Some(factor.clone()), options)
        }
        (Err(error), Some(last_step)) if problem.is_late(&error) => {
            let (iterations, factor) = (near.steps, factor.clone());
            Ok(Minimum { x: near.x, end: End::TimeLimit, iterations, last_step, factor }.solution(None))
        }
        (found, _) => found,
    }
}

/// Where steps have led.
struct Near {
    x: Vec<f64>,
    steps: usize,
    before: Before,
}

impl Near {
    /// The start, or where the step of the factor leads if it is that of the rows there.
    fn after_first<P: LeastSquares + ?Sized>(problem: &P, start: &[f64], (factor, at_start): (&Factor, bool)) -> Self {
        let mut near = Self { x: start.to_vec(), steps: 0, before: Before::default() };
        if let Some((step, size)) = step_of(factor).filter(|_| at_start) {
            near.take(problem, &step, size);
        }
        near
    }

    /// Takes a step of some size.
    fn take<P: LeastSquares + ?Sized>(&mut self, problem: &P, step: &[f64], size: f64) {
        add(&mut self.x, step, 1.0);
        self.steps += 1;
        self.before = Before { last: Some(size), ratio: self.before.last.map(|last| size / last) };
        problem.has_stepped(self.steps, size);
    }
}

/// Steps on to the minimum next to a place; false if steps do not shrink as they should.
fn descended<P: LeastSquares + ?Sized>(
    problem: &P,
    near: &mut Near,
    factor: &Factor,
    options: &Options,
) -> Result<bool, P::Error> {
    let before = near.steps;
    while near.steps < before + STEPS {
        let gradient = match problem.gradient(&near.x) {
            Ok(gradient) => gradient,
            Err(error) if near.steps == before || problem.has_no_more(&error) || problem.is_late(&error) => {
                return Err(error);
            }
            Err(_) => return Ok(false),
        };
        let Some((step, size)) = factor.step_against(&gradient) else { return Ok(false) };
        let Before { last, ratio: last_ratio } = near.before;
        let ratio = last.map(|last| size / last);
        if ratio.is_some_and(|ratio| ratio > SHRINKS) && size > options.tolerance {
            return Ok(false);
        }
        near.take(problem, &step, size);
        // As in `solve`, the larger of two ratios tells what is left.
        let left = ratio.zip(last_ratio).map(|(one, other): (f64, f64)| one.max(other)).map(|ratio| size * ratio);
        if size <= options.tolerance || left.is_some_and(|left| left <= options.tolerance * (1.0 - SHRINKS)) {
            return Ok(true);
        }
    }
    Ok(false)
}

impl Factor {
    /// The factor of rows next to those of this one, which have about its triangle, by their gradient `J^T r` and the sum of squares of
    /// their r; None if the triangle is singular.
    ///
    /// What follows of r is exact but for what the triangle is off: steps, costs, the cosine of the gradient.
    ///
    /// ```
    /// use abbe_numerics::Accumulator;
    ///
    /// let factor = |[first, second]: [f64; 2]| {
    ///     let mut rows = Accumulator::new(1, 2);
    ///     rows.push(&[2.0], first, 1.0);
    ///     rows.push(&[1.0], second, 1.0);
    ///     rows.finish()
    /// };
    /// let (one, other) = (factor([0.3, 0.1]), factor([0.4, -0.2]));
    /// let near = one.with_gradient(&[2.0 * 0.4 - 0.2], 0.4 * 0.4 + 0.2 * 0.2).unwrap();
    /// assert!((near.step().unwrap()[0] - other.step().unwrap()[0]).abs() < 1e-12);
    /// assert!((near.remaining_cost() - other.remaining_cost()).abs() < 1e-12);
    /// ```
    pub fn with_gradient(&self, gradient: &[f64], squares: f64) -> Option<Self> {
        let right = self.right_of(gradient)?;
        let rest = (squares - right.iter().map(|value| value * value).sum::<f64>()).max(0.0);
        Some(Self::new(self.triangle().to_owned(), right, self.norms().to_vec(), rest, self.rows()))
    }

    /// `R^-T gradient`, which is `Q^T r`; None if R is singular.
    fn right_of(&self, gradient: &[f64]) -> Option<Vec<f64>> {
        let mut right = vec![0.0; gradient.len()];
        for (column, gradient) in gradient.iter().enumerate() {
            let entries = self.triangle().col_as_slice(column);
            let known: f64 = entries[..column].iter().zip(&right).map(|(entry, value)| entry * value).sum();
            right[column] = (gradient - known) / entries[column];
        }
        right.iter().all(|value| value.is_finite()).then_some(right)
    }

    /// The step `-(R^T R)^-1 gradient`, and by how many standard uncertainties it moves all rows together; None if R is singular.
    fn step_against(&self, gradient: &[f64]) -> Option<(Vec<f64>, f64)> {
        let right = self.right_of(gradient)?;
        let size = norm(&right);
        Some((self.solved(right.into_iter().map(|value| -value).collect())?, size))
    }
}

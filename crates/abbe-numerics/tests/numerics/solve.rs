//! Proves the iteration on problems with known minima: it converges, halves steps that overshoot, says how it ended,
//! takes the shortest way where directions are lost, and does not care about the order of rows.

use std::cell::Cell;
use std::convert::Infallible;

use abbe_numerics::{
    Accumulator, End, LeastSquares, Options, RestrictedProblem, Robust, Sink, Solution, solve, solve_by_gradients,
};

use crate::problems::{Given, Linear, Linearised, Random, dot, given, norm};

const FULL: Options = Options { iterations: 50, tolerance: 1e-10, ..Options::USUAL };

/// `a exp(b t)` through points.
fn exponential(t: &[f64], y: &[f64]) -> Given<impl Fn(&[f64]) -> Linearised> {
    let points: Vec<(f64, f64)> = t.iter().copied().zip(y.iter().copied()).collect();
    let at = move |x: &[f64]| {
        let model = |t: f64| x[0] * (x[1] * t).exp();
        let rows = points.iter().map(|(t, _)| vec![(x[1] * t).exp(), t * model(*t)]).collect();
        (points.iter().map(|(t, y)| model(*t) - y).collect(), rows)
    };
    Given { unknowns: 2, rows: t.len(), at }
}

fn times(count: usize) -> Vec<f64> {
    (0..count).map(|i| 2.0 * i as f64 / count as f64 - 1.0).collect()
}

fn run(problem: &impl LeastSquares<Error = Infallible>, start: &[f64], options: &Options) -> Solution {
    let Ok(solution) = solve(problem, start, options);
    solution
}

#[test]
fn exact_data_give_the_truth() {
    let t = times(30);
    let y: Vec<f64> = t.iter().map(|t| 2.5 * (0.7 * t).exp()).collect();
    let found = run(&exponential(&t, &y), &[2.0, 0.3], &FULL);
    assert_eq!(found.end, End::Converged);
    assert!((found.x[0] - 2.5).abs() < 1e-14 && (found.x[1] - 0.7).abs() < 1e-14, "{:?}", found.x);
    assert!(found.iterations <= 6, "{}", found.iterations);
}

#[test]
fn noisy_data_end_where_the_gradient_vanishes() {
    let random = &mut Random::new(1);
    let t = times(60);
    let y: Vec<f64> = t.iter().map(|t| 2.5 * (0.7 * t).exp() + 0.1 * random.normal()).collect();
    let problem = exponential(&t, &y);
    let found = run(&problem, &[1.0, 0.0], &FULL);
    assert_eq!(found.end, End::Converged);
    let (residuals, rows) = (problem.at)(&found.x);
    for column in 0..2 {
        let column: Vec<f64> = rows.iter().map(|row| row[column]).collect();
        let gradient = dot(&column, &residuals) / norm(&column) / norm(&residuals);
        assert!(gradient.abs() < 1e-10, "{gradient:e}");
    }
}

#[test]
fn steps_that_overshoot_are_halved() {
    // Newton's iteration on the arc tangent runs away from beyond 1.39; both unknowns start there.
    let problem = Given {
        unknowns: 2,
        rows: 2,
        at: |x: &[f64]| {
            let slope = |x: f64| 1.0 / (1.0 + x * x);
            (vec![x[0].atan(), (x[1] - 1.0).atan()], vec![vec![slope(x[0]), 0.0], vec![0.0, slope(x[1] - 1.0)]])
        },
    };
    let found = run(&problem, &[5.0, -7.0], &FULL);
    assert_eq!(found.end, End::Converged);
    assert!(found.x[0].abs() < 1e-12 && (found.x[1] - 1.0).abs() < 1e-12, "{:?}", found.x);
}

#[test]
fn steps_into_what_is_not_finite_are_halved() {
    // The first full step leads to a negative argument of the square root, the next one to where it has no derivative.
    let problem =
        Given { unknowns: 1, rows: 1, at: |x: &[f64]| (vec![x[0].sqrt() - 0.5], vec![vec![0.5 / x[0].sqrt()]]) };
    let found = run(&problem, &[4.0], &Options { ..FULL });
    assert_eq!(found.end, End::Converged);
    assert!((found.x[0] - 0.25).abs() < 1e-14, "{:?}", found.x);
}

/// A residual with its derivative to the one unknown, where there is one.
struct Partial<F> {
    at: F,
    /// Evaluations that are done before one is refused for good.
    lives: usize,
    asked: Cell<usize>,
}

/// Why nothing is there.
#[derive(Debug, PartialEq)]
enum Nothing {
    /// The function is not defined at this value.
    At(f64),
    /// It is defined nowhere any more.
    Anywhere,
}

impl<F: Fn(f64) -> Option<(f64, f64)>> Partial<F> {
    fn new(at: F) -> Self {
        Self { at, lives: usize::MAX, asked: Cell::new(0) }
    }

    fn solve(&self, start: f64) -> Result<Solution, Nothing> {
        self.asked.set(0);
        solve(self, &[start], &Options { ..FULL })
    }
}

impl<F: Fn(f64) -> Option<(f64, f64)>> LeastSquares for Partial<F> {
    type Error = Nothing;

    fn is_final(&self, error: &Nothing) -> bool {
        *error == Nothing::Anywhere
    }

    fn unknowns(&self) -> usize {
        1
    }

    fn rows(&self) -> usize {
        1
    }

    fn linearise(&self, x: &[f64], sink: Sink<'_>) -> Result<(), Nothing> {
        self.asked.set(self.asked.get() + 1);
        if self.asked.get() > self.lives {
            return Err(Nothing::Anywhere);
        }
        let (residual, slope) = (self.at)(x[0]).ok_or(Nothing::At(x[0]))?;
        sink(0, &[residual], &[slope]);
        Ok(())
    }
}

/// The logarithm, of positive numbers alone: from above e the full step leads to a negative one.
fn logarithm(x: f64) -> Option<(f64, f64)> {
    (x > 0.0).then(|| (x.ln(), 1.0 / x))
}

#[test]
fn steps_to_where_nothing_can_be_evaluated_are_halved() {
    for start in [3.0, 8.0, 1e3, 1e6] {
        let found = Partial::new(logarithm).solve(start).expect("the solution is inside");
        assert_eq!(found.end, End::Converged);
        assert!((found.x[0] - 1.0).abs() < 1e-12, "{:?}", found.x);
    }
}

#[test]
fn where_no_part_of_a_step_can_be_evaluated_the_last_error_is_shown() {
    // Defined at the start alone. Half of the step from 3 to 2 twenty times over: 2^-19 of it is the last that is tried.
    let problem = Partial::new(|x| (x == 3.0).then_some((1.0, 1.0)));
    assert_eq!(problem.solve(3.0).map(|found| found.x), Err(Nothing::At(3.0 - 0.5_f64.powi(19))));
    assert_eq!(problem.asked.get(), 21);
    // Some parts can be evaluated and lead up: that is no progress, as if all could be.
    let found = Partial::new(|x| (x >= 2.5).then_some((4.0 - x, 1.0))).solve(3.0).expect("an end");
    assert_eq!((found.end, found.x), (End::NoProgress, vec![3.0]));
    // The start itself cannot be evaluated.
    assert_eq!(Partial::new(logarithm).solve(-1.0).map(|found| found.x), Err(Nothing::At(-1.0)));
}

#[test]
fn an_error_that_is_final_ends_the_iteration_at_once() {
    for lives in 0..4 {
        let problem = Partial { lives, ..Partial::new(logarithm) };
        assert_eq!(problem.solve(8.0).map(|found| found.x), Err(Nothing::Anywhere));
        assert_eq!(problem.asked.get(), lives + 1);
    }
}

#[test]
fn a_direction_that_does_not_lead_down_is_no_progress() {
    let problem = Given { unknowns: 1, rows: 1, at: |x: &[f64]| (vec![x[0] - 3.0], vec![vec![-1.0]]) };
    let found = run(&problem, &[1.0], &Options { ..FULL });
    assert_eq!((found.end, found.x), (End::NoProgress, vec![1.0]));
    // Neither does one along an unknown that has no effect, if it counts as determined.
    let problem = Given { unknowns: 2, rows: 2, at: |x: &[f64]| (vec![x[0] - 3.0; 2], vec![vec![1.0, 0.0]; 2]) };
    let found = run(&problem, &[1.0, 2.0], &FULL);
    assert_eq!((found.end, found.x), (End::NoProgress, vec![1.0, 2.0]));
}

#[test]
fn running_out_of_iterations_is_said() {
    let t = times(30);
    let y: Vec<f64> = t.iter().map(|t| 2.5 * (0.7 * t).exp()).collect();
    let problem = exponential(&t, &y);
    let mut costs = Vec::new();
    for iterations in [1, 2, 3] {
        let found = run(&problem, &[1.0, -1.0], &Options { iterations, ..FULL });
        assert_eq!((found.end, found.iterations), (End::IterationLimit, iterations));
        costs.push(norm(&(problem.at)(&found.x).0));
    }
    assert!(costs.is_sorted_by(|before, after| after < before), "{costs:?}");
    // One step is not let run away either.
    let problem =
        Given { unknowns: 1, rows: 1, at: |x: &[f64]| (vec![x[0].atan()], vec![vec![1.0 / (1.0 + x[0] * x[0])]]) };
    let found = run(&problem, &[5.0], &Options { iterations: 1, ..FULL });
    assert_eq!(found.end, End::IterationLimit);
    assert!(found.x[0].abs() < 5.0, "{:?}", found.x);
}

#[test]
fn a_linear_problem_takes_one_step() {
    let problem = Linear::random(&mut Random::new(2), 50, 2);
    let found = run(&given(&problem), &[0.0; 2], &FULL);
    let step = problem.factor(50).step().expect("full rank");
    assert!(found.iterations <= 2 && found.end == End::Converged);
    for (found, step) in found.x.iter().zip(&step) {
        assert!((found - step).abs() < 1e-14);
    }
}

/// The unknowns at the minimum within the first `rank` singular directions at the start.
fn run_within(problem: &impl LeastSquares<Error = Infallible>, start: &[f64], rank: usize) -> Vec<f64> {
    let mut accumulator = Accumulator::new(start.len(), problem.rows());
    let Ok(()) = problem.linearise(start, &mut |_, residuals, derivatives| {
        let rows = residuals.iter().zip(derivatives.chunks_exact(start.len()));
        rows.for_each(|(residual, derivatives)| accumulator.push(derivatives, *residual, 1.0));
    });
    let directions = accumulator.finish().spectrum().determined(rank);
    let within = RestrictedProblem { problem, origin: start, directions: &directions };
    let found = run(&within, &vec![0.0; rank], &FULL);
    assert_eq!(found.end, End::Converged);
    within.place(&found.x)
}

#[test]
fn lost_directions_are_gone_the_shortest_way() {
    // Only the product of 2 a and exp(b) counts beside c; effects are shared where the problem is linear.
    let t = times(40);
    let mut linear = Linear { rows: Vec::new(), residuals: Vec::new() };
    for t in &t {
        linear.rows.push(vec![1.0, 100.0, *t]);
        linear.residuals.push(-(4.0 + 3.0 * t));
    }
    let found = run_within(&given(&linear), &[0.0; 3], 2);
    // The effect 4 is shared alike, each in its own unit.
    for (found, expected) in found.iter().zip([2.0, 0.02, 3.0]) {
        assert!((found - expected).abs() < 1e-13, "{:?}", found);
    }
    let truth: Vec<f64> = t.iter().map(|t| 3.0 * (0.5 * t).exp()).collect();
    let problem = Given {
        unknowns: 3,
        rows: t.len(),
        at: |x: &[f64]| {
            let model = |t: f64| x[0] * x[1] * (x[2] * t).exp();
            let rows = t.iter().map(|&t| vec![model(t) / x[0], model(t) / x[1], t * model(t)]).collect();
            (t.iter().zip(&truth).map(|(&t, y)| model(t) - y).collect(), rows)
        },
    };
    let found = run_within(&problem, &[1.0, 2.0, 0.1], 2);
    assert!((found[0] * found[1] - 3.0).abs() < 1e-13 && (found[2] - 0.5).abs() < 1e-13, "{found:?}");
}

#[test]
fn the_order_of_rows_does_not_matter() {
    let random = &mut Random::new(3);
    let t = times(200);
    let mut points: Vec<(f64, f64)> = t.iter().map(|t| (*t, 2.5 * (0.7 * t).exp() + 0.05 * random.normal())).collect();
    let mut answers = Vec::new();
    for _ in 0..5 {
        let (t, y): (Vec<f64>, Vec<f64>) = points.iter().copied().unzip();
        answers.push(run(&exponential(&t, &y), &[1.0, 0.0], &FULL).x);
        random.shuffle(&mut points);
    }
    for answer in &answers[1..] {
        for (value, first) in answer.iter().zip(&answers[0]) {
            assert!((value / first - 1.0).abs() < 1e-9);
        }
    }
}

/// One unknown and two rows: a line, and a curve with so much residual that Gauss-Newton shrinks its error by `rate` a step.
/// The minimum is at zero.
fn slow(rate: f64) -> Given<impl Fn(&[f64]) -> Linearised> {
    // r = (x, c + k x² / 2): the gradient is x (1 + k c) + ..., Gauss-Newton's curvature 1, so that steps leave -k c of x.
    let at = move |x: &[f64]| {
        let x = x[0];
        (vec![x, -rate + 0.5 * x * x], vec![vec![1.0], vec![x]])
    };
    Given { unknowns: 1, rows: 2, at }
}

#[test]
fn slow_convergence_is_no_rounding() {
    for rate in [0.3, 0.6, 0.9, 0.95] {
        for tolerance in [1e-6, 1e-9] {
            for start in [0.5, 1e-2, 8e-4, 1e-5] {
                let options = Options { iterations: 1000, tolerance, ..Options::USUAL };
                let found = run(&slow(rate), &[start], &options);
                assert_eq!(found.end, End::Converged, "{rate} from {start}");
                // The curve makes the rest of the step a little larger than its series says, never by more than this.
                let allowed = tolerance * (1.0 + rate / (1.0 - rate));
                assert!(found.x[0].abs() <= allowed, "{rate} from {start} to {tolerance}: {:e}", found.x[0]);
                assert!(found.gradient_cosine < 1e-2, "{:e}", found.gradient_cosine);
            }
        }
    }
}

#[test]
fn a_first_step_below_the_threshold_of_rounding_is_not_the_last() {
    // One step of 5e-4 leaves a third of itself, far above the tolerance.
    let found = run(&slow(0.33), &[7e-4], &Options { tolerance: 1e-9, ..Options::USUAL });
    assert_eq!(found.end, End::Converged);
    assert!(found.iterations > 5 && found.x[0].abs() < 2e-9, "{} iterations, {:e}", found.iterations, found.x[0]);
    assert!(found.last_step <= 1e-8, "{:e}", found.last_step);
}

/// Displacements of a metre in units of 0.2 µm along a scale whose period is sought: the noise of millions of digits raises the sum of
/// squares by more than the last steps lower it.
#[test]
fn rounding_of_the_sum_of_squares_cuts_no_step() {
    for seed in 0..40 {
        let random = &mut Random::new(seed);
        let count = 3_000;
        let places: Vec<f64> = (0..count).map(|place| 3.5e6 * (f64::from(place) + 0.3) / f64::from(count)).collect();
        let wave = |place: f64, x: &[f64]| {
            let (sine, cosine) = (x[3] * place).sin_cos();
            (x[1] * sine + x[2] * cosine, sine, cosine, place * (x[1] * cosine - x[2] * sine))
        };
        let truth = [1e-6, 1.0, 0.5, 2e-5];
        let readings: Vec<f64> =
            places.iter().map(|&place| place + truth[0] * place + wave(place, &truth).0 + random.normal()).collect();
        let evaluations = Cell::new(0);
        let at = |x: &[f64]| {
            evaluations.set(evaluations.get() + 1);
            let of = |(place, reading): (&f64, &f64)| {
                let (wave, sine, cosine, slope) = wave(*place, x);
                (place + x[0] * place + wave - reading, vec![*place, sine, cosine, slope])
            };
            places.iter().zip(&readings).map(of).unzip()
        };
        let problem = Given { unknowns: 4, rows: places.len(), at };
        let found = run(&problem, &[0.0, 1.0, 0.0, 2.001e-5], &Options { iterations: 50, ..Options::USUAL });
        assert_eq!(found.end, End::Converged);
        assert!(evaluations.get() <= 12, "seed {seed}: {} evaluations", evaluations.get());
    }
}

#[test]
fn random_problems_end_within_the_tolerance() {
    // Exponentials with noise: the minimum by a far stricter iteration, in standard uncertainties of all rows.
    let random = &mut Random::new(5);
    for case in 0..2000 {
        let t = times(12);
        let noise = 10_f64.powi(-(case % 6));
        let y: Vec<f64> = t
            .iter()
            .map(|t| (1.0 + random.signed().abs()) * (random.signed() * t).exp() + noise * random.normal())
            .collect();
        let problem = exponential(&t, &y);
        let strict = Options { iterations: 2000, tolerance: 1e-13, rounding: 1e-6, ..Options::USUAL };
        let minimum = run(&problem, &[1.0, 0.0], &strict);
        let tolerance = [1e-4, 1e-6, 1e-8][case as usize % 3];
        let found = run(&problem, &[1.0, 0.0], &Options { iterations: 2000, tolerance, ..Options::USUAL });
        if minimum.end != End::Converged {
            continue;
        }
        assert_eq!(found.end, End::Converged);
        let off: Vec<f64> = found.x.iter().zip(&minimum.x).map(|(one, other)| one - other).collect();
        let off = minimum.factor.row_norm(&off);
        assert!(off <= 3.0 * tolerance, "case {case}: {off:e} off, {tolerance:e} asked");
    }
}

/// From the factor of rows nearby, of the rows at the start, or of rows that have nothing to do with the problem: the minimum is the same.
#[test]
fn steps_by_gradients_end_where_full_steps_do() {
    let random = &mut Random::new(6);
    let mut compared = 0;
    for case in 0..2000 {
        let t = times(12);
        let noise = 10_f64.powi(-(case % 6));
        let truth = [1.0 + random.signed().abs(), random.signed()];
        let y: Vec<f64> = t.iter().map(|t| truth[0] * (truth[1] * t).exp() + noise * random.normal()).collect();
        let problem = exponential(&t, &y);
        let tolerance = [1e-4, 1e-6, 1e-8][case as usize % 3];
        let options = Options { iterations: 2000, tolerance, ..Options::USUAL };
        let near = 0.1_f64.powi(case % 5);
        let start = [truth[0] + near * random.signed(), truth[1] + near * random.signed()];
        let minimum = run(&problem, &start, &Options { tolerance: 1e-13, rounding: 1e-6, ..options });
        if minimum.end != End::Converged {
            continue;
        }
        let beside = [start[0] + 0.01 * near, start[1] - 0.01 * near];
        let Ok(at_start) = problem.factor(&start, None);
        let Ok(nearby) = problem.factor(&beside, None);
        let unrelated = Linear::random(random, 9, 2).factor(9);
        for (factor, is_at_start) in [(&at_start, true), (&at_start, false), (&nearby, false), (&unrelated, false)] {
            let Ok(found) = solve_by_gradients(&problem, &start, (factor, is_at_start), &options);
            assert_eq!(found.end, End::Converged, "case {case}");
            let off: Vec<f64> = found.x.iter().zip(&minimum.x).map(|(one, other)| one - other).collect();
            let off = minimum.factor.row_norm(&off);
            assert!(off <= 3.0 * tolerance, "case {case}: {off:e} off, {tolerance:e} asked");
            // The factor is that of the minimum.
            let scale = minimum.factor.norms().iter().zip(found.factor.norms());
            assert!(scale.clone().all(|(one, other)| (one / other - 1.0).abs() < 1e-3), "case {case}");
        }
        // Fewest iterations are never exceeded, and what is missing is said.
        let Ok(short) = solve_by_gradients(&problem, &start, (&at_start, true), &Options { iterations: 2, ..options });
        assert!(
            short.iterations <= 2 && (short.end == End::Converged || short.end == End::IterationLimit),
            "{short:?}"
        );
        compared += 1;
    }
    assert!(compared > 1500, "{compared}");
}

/// The time is over after so many evaluations: the last place is told, with the size of the step that led there.
#[test]
fn steps_by_gradients_tell_where_they_were_when_the_time_is_over() {
    struct Ends<'a, P>(&'a P, Cell<usize>);
    impl<P: LeastSquares<Error = Infallible>> LeastSquares for Ends<'_, P> {
        type Error = &'static str;

        fn unknowns(&self) -> usize {
            self.0.unknowns()
        }

        fn rows(&self) -> usize {
            self.0.rows()
        }

        fn is_out_of_time(&self, _: &Self::Error) -> bool {
            true
        }

        fn linearise(&self, x: &[f64], sink: Sink<'_>) -> Result<(), Self::Error> {
            self.1.set(self.1.get().checked_sub(1).ok_or("late")?);
            let Ok(()) = self.0.linearise(x, sink);
            Ok(())
        }
    }
    let t = times(30);
    let y: Vec<f64> = t.iter().enumerate().map(|(row, t)| 2.5 * (0.7 * t).exp() + 0.01 * (row % 3) as f64).collect();
    let problem = exponential(&t, &y);
    let Ok(factor) = problem.factor(&[2.49, 0.69], None);
    let full = run(&problem, &[2.49, 0.69], &FULL);
    let mut last = f64::INFINITY;
    for evaluations in 0..12 {
        let ends = Ends(&problem, Cell::new(evaluations));
        match solve_by_gradients(&ends, &[2.49, 0.69], (&factor, true), &FULL) {
            Ok(found) if found.end == End::TimeLimit => {
                assert!(found.iterations >= 1 && found.last_step <= last, "{evaluations}: {found:?}");
                last = found.last_step;
            }
            Ok(found) => {
                assert_eq!(found.end, End::Converged);
                assert!((found.x[0] - full.x[0]).abs() < 1e-10 && evaluations > 3, "{evaluations}");
                return;
            }
            Err(error) => panic!("{evaluations}: {error}, and a step had been taken"),
        }
    }
    panic!("it does not end");
}

#[test]
fn who_does_not_converge_says_how_far_it_came() {
    let found = run(&slow(0.9), &[0.5], &Options { iterations: 5, ..Options::USUAL });
    assert_eq!((found.end, found.iterations), (End::IterationLimit, 5));
    // The next step is nearly all that is left of x, times 1 - rate.
    assert!(found.last_step > 0.01 && found.gradient_cosine > 1e-3, "{} {}", found.last_step, found.gradient_cosine);
}

/// A problem whose time is over after some evaluations.
struct Limited<'a, P> {
    problem: &'a P,
    left: Cell<usize>,
}

#[derive(Debug, PartialEq)]
struct OutOfTime;

impl<P: LeastSquares<Error = Infallible>> LeastSquares for Limited<'_, P> {
    type Error = OutOfTime;

    fn is_final(&self, _: &OutOfTime) -> bool {
        true
    }

    fn is_out_of_time(&self, _: &OutOfTime) -> bool {
        true
    }

    fn unknowns(&self) -> usize {
        self.problem.unknowns()
    }

    fn rows(&self) -> usize {
        self.problem.rows()
    }

    fn linearise(&self, x: &[f64], sink: Sink<'_>) -> Result<(), OutOfTime> {
        self.left.set(self.left.get().checked_sub(1).ok_or(OutOfTime)?);
        let Ok(()) = self.problem.linearise(x, sink);
        Ok(())
    }
}

/// Whenever the time is over after the start, there is an iterate that is no worse than the start; with more time the same
/// solution as without a limit. Plain, robust, and within some directions.
#[test]
fn a_fit_without_time_ends_with_its_last_iterate() {
    let t = times(30);
    let mut y: Vec<f64> = t.iter().map(|t| 2.5 * (0.7 * t).exp() + 0.01 * (7.0 * t).sin()).collect();
    y[4] += 0.8;
    let problem = exponential(&t, &y);
    let start = [1.0, 0.1];
    let cost = |x: &[f64]| (problem.at)(x).0.iter().map(|residual| residual * residual).sum::<f64>();
    for robust in [None, Some(Robust::TUKEY)] {
        for within in [false, true] {
            let options = Options { robust, ..FULL };
            let mut accumulator = Accumulator::new(2, 30);
            let Ok(()) = problem.linearise(&start, &mut |_, residuals, rows| {
                residuals.iter().zip(rows.chunks(2)).for_each(|(residual, row)| accumulator.push(row, *residual, 1.0));
            });
            let directions = accumulator.finish().spectrum().determined(2);
            let solved = |evaluations: usize| {
                let limited = Limited { problem: &problem, left: Cell::new(evaluations) };
                if !within {
                    return solve(&limited, &start, &options);
                }
                let within = RestrictedProblem { problem: &limited, origin: &start, directions: &directions };
                let found = solve(&within, &[0.0, 0.0], &options)?;
                Ok(Solution { x: within.place(&found.x), ..found })
            };
            assert_eq!(solved(0).err(), Some(OutOfTime));
            let whole = solved(usize::MAX).expect("a solution");
            assert_eq!(whole.end, End::Converged);
            let mut ends = 0;
            let needed = (1..10_000).find(|&evaluations| {
                let found = solved(evaluations).expect("there is an iterate");
                if found.end == End::Converged {
                    assert_eq!(found.x, whole.x);
                    return true;
                }
                assert_eq!(found.end, End::TimeLimit, "after {evaluations}");
                assert!(found.iterations <= whole.iterations && cost(&found.x) <= cost(&start), "after {evaluations}");
                ends += 1;
                false
            });
            assert!(needed.is_some() && ends >= 5, "{ends} ends");
        }
    }
}

#[test]
fn steps_that_stand_end_the_iteration() {
    // A residual that nothing moves, whatever its derivative says: each step is the one before.
    for size in [1e-3, 1.0, 1e6] {
        let problem = Given { unknowns: 1, rows: 2, at: |_: &[f64]| (vec![size, 100.0], vec![vec![1.0], vec![0.0]]) };
        let found = run(&problem, &[0.0], &Options::USUAL);
        assert!(found.end == End::Standing && found.iterations < 10, "{size}: {:?}", found.iterations);
    }
    // Steps that are cut in half, and lead to the other side again and again.
    for start in [0.1, 10.0] {
        let problem = Given { unknowns: 1, rows: 1, at: |x: &[f64]| (vec![4.0 * x[0]], vec![vec![1.0]]) };
        let found = run(&problem, &[start], &Options::USUAL);
        assert!(found.end == End::Standing && found.iterations < 10, "{start}: {:?}", found.iterations);
    }
    // Far away those that are cut may yet find a way, if each of them lowers the sum: a valley that bends.
    for (bend, end) in [(1.0 / 1024.0, End::Converged), (64.0, End::Standing)] {
        let at = |x: &[f64]| {
            let along = vec![300.0 - x[0], 30.0 * (x[1] - bend * x[0] * x[0])];
            (along, vec![vec![-1.0, 0.0], vec![-60.0 * bend * x[0], 30.0]])
        };
        let found = run(&Given { unknowns: 2, rows: 2, at }, &[-300.0, bend * 9e4], &Options::USUAL);
        assert_eq!(found.end, end, "{bend}: {}", found.iterations);
        assert!(found.end == End::Converged || found.iterations < 12, "{bend}: {}", found.iterations);
    }
    // What shrinks by less than a hundredth does not end within the limit; what shrinks more may.
    let found = run(&slow(0.997), &[1e-2], &Options::USUAL);
    assert!(found.end == End::Standing && found.iterations < 10, "{:?} {}", found.end, found.iterations);
    let found = run(&slow(0.9), &[0.5], &Options { iterations: 1000, ..Options::USUAL });
    assert_eq!(found.end, End::Converged);
    let found = run(&slow(0.997), &[1e-2], &Options { iterations: 100_000, ..Options::USUAL });
    assert_eq!(found.end, End::Converged);
}

//! Proves that robust weights find planted gross errors, also on one side and where directions are lost, give the
//! estimate of the clean rows, and report what the a-posteriori sigma is made of.

use abbe_numerics::{
    Accumulator, End, HuberPoint, InPasses, Options, RestrictedProblem, Robust, RobustPass, RowWeight, Solution,
    Weighing, scatter_factor, solve, solve_in_passes,
};

use crate::problems::{Given, Linear, Random, given, norm};

/// Rows in units of their standard uncertainty with some gross errors, all positive; which ones; the clean rows.
struct Planted {
    all: Linear,
    wrong: Vec<bool>,
    clean: Linear,
    truth: Vec<f64>,
}

/// Every `every`-th of `rows` rows is wrong by `least` to twice as many standard uncertainties.
fn planted(seed: u64, rows: usize, every: usize, least: f64) -> Planted {
    let random = &mut Random::new(seed);
    let truth = vec![30.0, -20.0, 10.0, 5.0];
    let mut all = Linear::random(random, rows, truth.len());
    let values = all.apply(&truth);
    let mut wrong = Vec::new();
    for (index, (residual, value)) in all.residuals.iter_mut().zip(values).enumerate() {
        wrong.push(index % every == 0);
        let gross = if index % every == 0 { least * (1.5 + 0.5 * random.signed()) } else { 0.0 };
        *residual = -(value + random.normal() + gross);
    }
    let kept = || (0..rows).filter(|&row| !wrong[row]);
    let clean = Linear {
        rows: kept().map(|row| all.rows[row].clone()).collect(),
        residuals: kept().map(|row| all.residuals[row]).collect(),
    };
    Planted { all, wrong, clean, truth }
}

fn estimate(problem: &Linear, robust: Option<Robust>) -> Solution {
    let options = Options { iterations: 100, robust, ..Options::USUAL };
    let Ok(solution) = solve(&given(problem), &vec![0.0; problem.unknowns()], &options);
    solution
}

/// Largest difference of two estimates in standard uncertainties of the clean rows.
fn apart(a: &[f64], b: &[f64], clean: &Linear) -> f64 {
    let covariance = clean.factor(clean.rows.len()).covariance_root(clean.unknowns()).covariance();
    (0..a.len()).map(|k| (a[k] - b[k]).abs() / covariance[k][k].sqrt()).fold(0.0, f64::max)
}

/// Sigma from weights and studentised residuals, in units of the stated uncertainties.
fn sigma(problem: &Linear, found: &Solution) -> f64 {
    let report = found.robust.as_ref().expect("a report");
    let residuals: Vec<f64> = problem.apply(&found.x).iter().zip(&problem.residuals).map(|(by, r)| by + r).collect();
    let (m, n) = (residuals.len() as f64, found.x.len() as f64);
    let influences: Vec<f64> = residuals.iter().zip(&report.weights).map(|(r, w)| r * w).collect();
    scatter_factor(&report.slopes, n) * norm(&influences) / (m - n).sqrt()
}

#[test]
fn stated_uncertainties_are_true_however_many_unknowns_there_are() {
    // Slopes of 0 and 1, as of Huber's loss, have a closed form: (1 - k) / (q - k), k unknowns a row, a part q of slopes 1.
    let slopes: Vec<f64> = (0..100).map(|row| f64::from(row % 10 != 0)).collect();
    for unknowns in [1.0, 10.0, 30.0, 60.0_f64] {
        let expected = (1.0 - unknowns / 100.0) / (0.9 - unknowns / 100.0);
        assert!((scatter_factor(&slopes, unknowns) / expected - 1.0).abs() < 1e-9, "{unknowns}");
    }
    assert!((scatter_factor(&slopes, 0.0) - 1.0 / 0.9).abs() < 1e-12);
    assert!((scatter_factor(&[1.0; 50], 20.0) - 1.0).abs() < 1e-9);
    // Where nearly all slopes are lost, the factor is large and a number; never zero or negative.
    let lost: [(&[f64], f64); 5] =
        [(&[0.9, -0.5], 1.0), (&[0.0; 10], 3.0), (&[0.0; 10], 0.0), (&[1.0, 0.0, 0.0, 0.0], 2.0), (&[-0.8; 9], 2.0)];
    for (slopes, unknowns) in lost {
        let factor = scatter_factor(slopes, unknowns);
        assert!((0.5..1e3).contains(&factor), "{slopes:?}, {unknowns}: {factor}");
    }
    assert_eq!(
        (scatter_factor(&slopes, 100.0), scatter_factor(&slopes, 120.0), scatter_factor(&[], 0.0)),
        (1.0, 1.0, 1.0)
    );

    // Deviations of estimates from the truth over what is stated, in many sets of normal noise, with and without gross errors.
    for (robust, unknowns, gross, seed) in [
        (Robust::TUKEY, 12, 0.0, 1),
        (Robust::TUKEY, 36, 0.0, 2),
        (Robust::TUKEY, 36, 60.0, 3),
        (Robust::TUKEY, 48, 0.0, 4),
        (Robust::TUKEY, 60, 0.0, 6),
        (Robust::HUBER, 36, 0.0, 5),
    ] {
        let random = &mut Random::new(seed);
        let (mut squares, mut count) = (0.0, 0.0);
        for _ in 0..150 {
            let mut problem = Linear::random(random, 120, unknowns);
            let wrong = |row: usize| gross > 0.0 && row % 40 == 7;
            for (row, residual) in problem.residuals.iter_mut().enumerate() {
                *residual = random.normal() + if wrong(row) { gross } else { 0.0 };
            }
            let found = estimate(&problem, Some(robust));
            let report = found.robust.as_ref().expect("a report");
            let kept: Vec<usize> = (0..120).filter(|&row| report.weights[row] > 0.0).collect();
            let of = |all: &[f64]| kept.iter().map(|&row| all[row]).collect();
            let used = Linear {
                rows: kept.iter().map(|&row| problem.rows[row].clone()).collect(),
                residuals: of(&problem.residuals),
            };
            let report = abbe_numerics::RobustReport {
                weights: of(&report.weights),
                studentised: of(&report.studentised),
                slopes: of(&report.slopes),
            };
            let found = Solution { robust: Some(report), ..found };
            let sigma = sigma(&used, &found);
            let covariance = used.factor(used.rows.len()).covariance_root(unknowns).covariance();
            for (k, x) in found.x.iter().enumerate() {
                squares += x * x / (sigma * sigma * covariance[k][k]);
                count += 1.0;
            }
        }
        let ratio = (squares / count).sqrt();
        println!("{:?}, {unknowns} unknowns of 120 rows, gross errors of {gross}: {ratio:.3}", robust.loss);
        assert!((ratio - 1.0).abs() < 0.04, "{ratio}");
    }
}

#[test]
fn gross_errors_are_found_and_left_out() {
    let (mut farthest, mut sigmas) = (0.0_f64, (f64::INFINITY, 0.0_f64));
    // From one in ten to three in ten, all on one side.
    for (seed, every, least) in [(0, 10, 15.0), (1, 10, 200.0), (2, 5, 50.0), (3, 4, 30.0), (4, 3, 100.0)] {
        let case = planted(seed, 300, every, least);
        let found = estimate(&case.all, Some(Robust::TUKEY));
        assert_eq!(found.end, End::Converged);
        let report = found.robust.as_ref().expect("a report");
        for (row, &wrong) in case.wrong.iter().enumerate() {
            let called = report.studentised[row].abs() >= Robust::TUKEY.outlier_at;
            assert_eq!((called, report.weights[row] == 0.0), (wrong, wrong), "seed {seed}, row {row}");
            assert!((report.weights[row] - Robust::TUKEY.weight(report.studentised[row])).abs() < 1e-12);
        }
        let clean = estimate(&case.clean, None);
        farthest = farthest.max(apart(&found.x, &clean.x, &case.clean));
        // Plain least squares is nowhere near, or the case would prove nothing.
        assert!(apart(&estimate(&case.all, None).x, &clean.x, &case.clean) > 1.0);
        assert!(apart(&found.x, &case.truth, &case.clean) < 4.0);
        let kept: Vec<usize> = (0..300).filter(|&row| report.weights[row] > 0.0).collect();
        assert_eq!(kept.len(), case.clean.rows.len());
        let inner = Solution {
            robust: Some(abbe_numerics::RobustReport {
                weights: kept.iter().map(|&row| report.weights[row]).collect(),
                studentised: kept.iter().map(|&row| report.studentised[row]).collect(),
                slopes: kept.iter().map(|&row| report.slopes[row]).collect(),
            }),
            ..found.clone()
        };
        let sigma = sigma(&case.clean, &inner);
        sigmas = (sigmas.0.min(sigma), sigmas.1.max(sigma));
    }
    println!("{farthest:.2} standard uncertainties from the clean estimate, sigma {:.3} to {:.3}", sigmas.0, sigmas.1);
    assert!(farthest < 0.6, "{farthest}");
    assert!(sigmas.0 > 0.85 && sigmas.1 < 1.15, "{sigmas:?}");
}

#[test]
fn good_rows_of_high_leverage_are_kept_and_wrong_ones_found() {
    let (random, mut called, mut found_wrong, mut high) = (&mut Random::new(8), 0, 0, 0.0_f64);
    for _ in 0..100 {
        let mut problem = Linear::random(random, 120, 24);
        for row in problem.rows.iter_mut().step_by(12) {
            row.iter_mut().for_each(|derivative| *derivative *= 4.0);
        }
        problem.residuals.iter_mut().for_each(|residual| *residual = random.normal());
        let covariance = problem.factor(120).covariance_root(24);
        let leverages: Vec<f64> = covariance.leverages(&problem.rows.concat());
        high = high.max(leverages.iter().copied().fold(0.0, f64::max));
        let outliers = |problem: &Linear| -> Vec<usize> {
            let report = estimate(problem, Some(Robust::TUKEY)).robust.expect("a report");
            (0..120).filter(|&row| report.studentised[row].abs() >= Robust::TUKEY.outlier_at).collect()
        };
        called += outliers(&problem).len();
        // One row of high leverage is wrong by ten standard deviations of what the others say of it.
        problem.residuals[60] += 10.0 / (1.0 - leverages[60]).sqrt();
        found_wrong += usize::from(outliers(&problem).contains(&60));
    }
    println!(
        "{called} good rows of 12,000 are called outliers; {found_wrong} of 100 wrong ones; leverages to {high:.2}"
    );
    assert!(high > 0.85 && called <= 4 && found_wrong >= 97, "{called} {found_wrong} {high}");
}

#[test]
fn huber_bounds_what_gross_errors_do() {
    let case = planted(5, 300, 20, 1e4);
    let found = estimate(&case.all, Some(Robust::HUBER));
    assert_eq!(found.end, End::Converged);
    let clean = estimate(&case.clean, None);
    assert!(apart(&found.x, &clean.x, &case.clean) < 1.5);
    let report = found.robust.as_ref().expect("a report");
    for (row, &wrong) in case.wrong.iter().enumerate() {
        assert_eq!(report.studentised[row].abs() > 100.0, wrong);
        assert!(report.weights[row] > 0.0 && (report.weights[row] < 0.01) == wrong);
    }
    let sigma = sigma(&case.all, &found);
    assert!((0.85..1.2).contains(&sigma), "{sigma}");
}

#[test]
fn gross_errors_are_found_where_directions_are_lost() {
    let mut case = planted(6, 300, 6, 40.0);
    // The first unknown once more: only the sum of the two is determined.
    for row in &mut case.all.rows {
        row.push(0.1 * row[0]);
    }
    let (all, origin) = (given(&case.all), [0.0, 0.0, 0.0, 0.0, 3.0]);
    let directions = case.all.factor(50).spectrum().determined(4);
    let within = RestrictedProblem { problem: &all, origin: &origin, directions: &directions };
    let options = Options { iterations: 100, robust: Some(Robust::TUKEY), ..Options::USUAL };
    let Ok(found) = solve(&within, &[0.0; 4], &options);
    assert_eq!(found.end, End::Converged);
    let report = found.robust.as_ref().expect("a report");
    for (row, &wrong) in case.wrong.iter().enumerate() {
        assert_eq!(report.weights[row] == 0.0, wrong, "row {row}: {}", report.studentised[row]);
    }
    let x = within.place(&found.x);
    let sum = [x[0] + 0.1 * x[4], x[1], x[2], x[3]];
    assert!(apart(&sum, &estimate(&case.clean, None).x, &case.clean) < 0.6);
    // What is lost stays where it was; the change is shared alike, each in its own unit.
    assert!((x[0] / (0.1 * (x[4] - 3.0)) - 1.0).abs() < 1e-9, "{x:?}");
}

#[test]
fn exact_rows_have_no_outliers() {
    let mut case = planted(7, 60, 10, 1.0);
    case.all.residuals = case.all.apply(&case.truth).iter().map(|value| -value).collect();
    let found = estimate(&case.all, Some(Robust::TUKEY));
    assert_eq!(found.end, End::Converged);
    let report = found.robust.as_ref().expect("a report");
    assert!(report.weights.iter().all(|&weight| weight > 1.0 - 1e-12));
    for (found, truth) in found.x.iter().zip(&case.truth) {
        assert!((found - truth).abs() < 1e-12);
    }
}

#[test]
fn a_robust_estimate_that_has_not_arrived_does_not_say_so() {
    // Two points and two unknowns: residuals have no size and all weights stay at 1, however far away the minimum is.
    let problem = Given {
        unknowns: 2,
        rows: 2,
        at: |x: &[f64]| {
            let model = |t: f64| x[0] * (x[1] * t).exp();
            let row = |t: f64| vec![(x[1] * t).exp(), t * model(t)];
            (vec![model(1.0) - 400.0, model(2.0) - 9000.0], vec![row(1.0), row(2.0)])
        },
    };
    let options = Options { iterations: 1, robust: Some(Robust::HUBER), ..Options::USUAL };
    let Ok(short) = solve(&problem, &[1.0, 1.0], &options);
    assert_eq!(short.end, End::IterationLimit);
    let Ok(long) = solve(&problem, &[1.0, 1.0], &Options { iterations: 50, ..options });
    assert_eq!(long.end, End::Converged);
    let slope = (9000.0_f64 / 400.0).ln();
    assert!((long.x[1] - slope).abs() < 1e-10 && (long.x[0] - 400.0 / slope.exp()).abs() < 1e-8, "{:?}", long.x);
}

#[test]
fn the_order_of_rows_does_not_matter() {
    let case = planted(8, 200, 8, 20.0);
    let random = &mut Random::new(9);
    let first = estimate(&case.all, Some(Robust::TUKEY));
    let mut order: Vec<usize> = (0..200).collect();
    for _ in 0..4 {
        random.shuffle(&mut order);
        let shuffled = Linear {
            rows: order.iter().map(|&row| case.all.rows[row].clone()).collect(),
            residuals: order.iter().map(|&row| case.all.residuals[row]).collect(),
        };
        let again = estimate(&shuffled, Some(Robust::TUKEY));
        for (value, first) in again.x.iter().zip(&first.x) {
            assert!((value / first - 1.0).abs() < 1e-9, "{value} {first}");
        }
    }
}

/// Rows that are gone through in passes; `passes` counts them.
struct Passing<'a> {
    problem: &'a Linear,
    passes: std::cell::Cell<usize>,
}

impl InPasses for Passing<'_> {
    type Error = std::convert::Infallible;

    fn is_final(&self, _: &Self::Error) -> bool {
        true
    }

    fn pass(&self, x: &[f64], weighing: &Weighing) -> Result<RobustPass, Self::Error> {
        self.passes.set(self.passes.get() + 1);
        let Linear { rows, residuals } = self.problem;
        let residuals: Vec<f64> = self.problem.apply(x).iter().zip(residuals).map(|(by, r)| by + r).collect();
        let weights = weighing.rows(x, &residuals, &rows.concat(), &vec![false; rows.len()]);
        let mut accumulator = Accumulator::new(x.len(), rows.len());
        for ((line, residual), row) in rows.iter().zip(&residuals).zip(&weights) {
            accumulator.push(line, *residual, row.weight.sqrt());
        }
        let sum = |of: &dyn Fn(&RowWeight) -> f64| weights.iter().map(of).sum();
        let mut sizes: Vec<(f64, f64)> = weights.iter().map(|row| (row.size.abs(), 1.0)).collect();
        sizes.sort_by(|one, other| one.0.total_cmp(&other.0));
        Ok(RobustPass {
            factor: accumulator.finish(),
            objective: sum(&|row| row.loss),
            weights: sum(&|row| row.weight),
            slopes: sum(&|row| row.slope),
            sizes,
        })
    }
}

/// Passes that hold no row find what rounds of weights find that hold all, from the start and from what some of the rows say.
#[test]
fn passes_find_what_rounds_find() {
    let (mut largest, mut most, mut all) = (0.0_f64, 0, 0);
    for seed in 0..60 {
        let rows = [200, 600, 2000][seed as usize % 3];
        for (every, least) in [(1000, 0.0), (9, 20.0), (7, 4.0), (4, 30.0)] {
            let Planted { all: problem, clean, .. } = planted(seed, rows, every, least);
            for robust in [Robust::TUKEY, Robust::HUBER] {
                let rounds = estimate(&problem, Some(robust));
                if rounds.end != End::Converged {
                    continue;
                }
                let some = Linear {
                    rows: problem.rows[..rows / 2].to_vec(),
                    residuals: problem.residuals[..rows / 2].to_vec(),
                };
                for start in [estimate(&problem, None), estimate(&some, Some(robust))] {
                    let passing = Passing { problem: &problem, passes: Default::default() };
                    let start = HuberPoint { x: start.x, root: None, scale: f64::INFINITY };
                    let Ok((found, _)) = solve_in_passes(&passing, start, robust, &Options::USUAL);
                    assert_eq!(found.end, End::Converged, "{seed} {rows} {every} {robust:?}");
                    let off = apart(&found.x, &rounds.x, &clean);
                    if off > 2e-3 {
                        println!(
                            "{seed} {rows} {every} {least} {robust:?}: {off:.1e}, {} passes",
                            passing.passes.get()
                        );
                    }
                    (largest, most, all) =
                        (largest.max(off), most.max(passing.passes.get()), all + passing.passes.get());
                }
            }
        }
    }
    println!("{largest:.1e} {most} {all}");
    assert!(largest < 2e-3, "{largest:.1e}");
}

/// The same where one row tells nearly alone what an unknown is: a known length among touches. Its weight follows from the others by
/// far, so that steps towards it are short.
#[test]
fn passes_find_what_one_row_tells_nearly_alone() {
    let mut largest = (0.0_f64, 0);
    for seed in 0..40 {
        for (weak, off) in [(1e-2, 0.0), (1e-2, 3.0), (1e-3, 0.5), (1e-3, 30.0), (3e-2, 8.0)] {
            let Planted { all: mut problem, mut clean, truth, .. } = planted(seed, 600, 9, 6.0);
            for part in [&mut problem, &mut clean] {
                part.rows.iter_mut().for_each(|row| row[0] *= weak);
                let mut alone = vec![0.0; part.rows[0].len()];
                alone[0] = 1.0;
                part.rows.push(alone);
                part.residuals.push(off - truth[0] / weak);
            }
            for robust in [Robust::TUKEY, Robust::HUBER] {
                let rounds = estimate(&problem, Some(robust));
                if rounds.end != End::Converged {
                    continue;
                }
                let passing = Passing { problem: &problem, passes: Default::default() };
                let start = HuberPoint { x: estimate(&problem, None).x, root: None, scale: f64::INFINITY };
                let Ok((found, _)) = solve_in_passes(&passing, start, robust, &Options::USUAL);
                let off_by = apart(&found.x, &rounds.x, &clean);
                assert_eq!(found.end, End::Converged, "{seed} {weak} {off} {robust:?}");
                largest = (largest.0.max(off_by), largest.1.max(passing.passes.get()));
            }
        }
    }
    println!("{largest:?}");
    // Where it contradicts the others, how much it counts depends on how far the search for its weight went.
    assert!(largest.0 < 0.1, "{largest:?}");
}

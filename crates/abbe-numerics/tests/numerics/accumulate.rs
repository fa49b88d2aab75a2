//! Proves that a factor accumulated in many small pieces is that of one QR, and what it says by the definitions: norms,
//! costs, step, leverage, covariance.

use abbe_numerics::{Accumulator, CovarianceRoot, Factor};

use crate::problems::{Linear, Random, dot, line, norm};

fn of_full_rank(factor: &Factor) -> CovarianceRoot {
    factor.covariance_root(factor.unknowns())
}

fn close(a: f64, b: f64, scale: f64) -> f64 {
    (a - b).abs() / scale
}

/// Largest relative difference of everything that two factors say.
fn difference(a: &Factor, b: &Factor, row: &[f64]) -> f64 {
    assert_eq!((a.rows(), a.unknowns()), (b.rows(), b.unknowns()));
    let (step_a, step_b) = (a.step().expect("full rank"), b.step().expect("full rank"));
    let (cov_a, cov_b) = (of_full_rank(a).covariance().concat(), of_full_rank(b).covariance().concat());
    let lists = |a: &[f64], b: &[f64]| {
        let size = norm(a);
        a.iter().zip(b).map(|(a, b)| close(*a, *b, size)).fold(0.0, f64::max)
    };
    [
        lists(&step_a, &step_b),
        lists(a.norms(), b.norms()),
        lists(&cov_a, &cov_b),
        lists(a.singular_values().values(), b.singular_values().values()),
        close(a.cost(), b.cost(), a.cost()),
        close(a.remaining_cost(), b.remaining_cost(), a.cost()),
        lists(&of_full_rank(a).leverages(row), &of_full_rank(b).leverages(row)),
    ]
    .into_iter()
    .fold(0.0, f64::max)
}

#[test]
fn pieces_are_as_good_as_one() {
    let mut worst = 0.0_f64;
    for seed in 0..20 {
        let random = &mut Random::new(seed);
        let unknowns = 1 + random.below(9);
        let problem = Linear::random(random, 30 + 20 * unknowns, unknowns);
        let whole = problem.factor(problem.rows.len());
        // Room for one row more than the factor itself: every row is a piece of its own.
        for hint in [0, 1, 2, 7, 40] {
            worst = worst.max(difference(&whole, &problem.factor(hint), &problem.rows[0]));
        }
    }
    println!("largest difference: {worst:.1e}");
    assert!(worst < 1e-12, "{worst:e}");
}

/// Runs of rows, each with two unknowns of its own beside those of all.
#[test]
fn rows_of_some_unknowns_are_rows_with_zeros() {
    const RUNS: usize = 40;
    const ROWS: usize = 60;
    const SHARED: usize = 20;
    let (random, unknowns) = (&mut Random::new(7), SHARED + 2 * RUNS);
    let (mut all, mut some) = (Accumulator::new(unknowns, RUNS * ROWS), Accumulator::new(unknowns, RUNS * ROWS));
    for run in 0..RUNS {
        let own: Vec<usize> = (0..SHARED).chain([SHARED + 2 * run, SHARED + 2 * run + 1]).collect();
        for _ in 0..ROWS {
            let derivatives: Vec<f64> = own.iter().map(|_| random.signed()).collect();
            let (residual, mut line) = (random.signed(), vec![0.0; unknowns]);
            own.iter().zip(&derivatives).for_each(|(&unknown, derivative)| line[unknown] = *derivative);
            all.push(&line, residual, 0.7);
            some.push_some(&own, &derivatives, residual, 0.7);
        }
    }
    let off = difference(&all.finish(), &some.finish(), &vec![1.0; unknowns]);
    assert!(off < 1e-12, "{off:e}");
}

/// Rows in any order, each of which has a few of many unknowns beside some that all have; they come in lists that lack what is zero in
/// all of them, as rows of touches do.
#[test]
fn rows_of_many_features_are_factorised_as_all_rows() {
    let mut worst = 0.0_f64;
    for seed in 0..60 {
        let random = &mut Random::new(seed);
        let (shared, features, of_each) = (1 + random.below(20), 3 + random.below(30), 1 + random.below(3));
        let (unknowns, count) = (shared + features * of_each, 400 + random.below(4000));
        // Some do without any unknown of all rows, and some lists have a column of zeros.
        let (mut dense, mut some) = (Accumulator::new(unknowns, 0), Accumulator::new(unknowns, count));
        // The same rows in parts that are factorised by themselves, in lists one after another.
        let mut parts: Vec<Accumulator> =
            (0..1 + random.below(6)).map(|_| Accumulator::new(unknowns, random.below(count))).collect();
        let mut row = 0;
        while row < count {
            let lines: Vec<Vec<f64>> = (0..1 + random.below(60))
                .map(|_| {
                    let (feature, mut line) = (random.below(features), vec![0.0; unknowns]);
                    let without = random.below(3 * shared);
                    (0..shared)
                        .filter(|unknown| *unknown != without)
                        .for_each(|unknown| line[unknown] = random.signed());
                    (0..of_each).for_each(|own| line[shared + feature * of_each + own] = random.signed());
                    line
                })
                .collect();
            let kept = random.below(unknowns);
            let is_there = |unknown: &usize| *unknown == kept || lines.iter().any(|line| line[*unknown] != 0.0);
            let columns: Vec<usize> = (0..unknowns).filter(is_there).collect();
            for line in &lines {
                let (residual, weight) = (random.signed(), 0.5 + random.below(3) as f64);
                dense.push(line, residual, weight);
                let own: Vec<f64> = columns.iter().map(|&unknown| line[unknown]).collect();
                some.push_some(&columns, &own, residual, weight);
                let part = row * parts.len() / (count + 60);
                parts[part].push_some(&columns, &own, residual, weight);
            }
            row += lines.len();
        }
        let mut all = Accumulator::new(unknowns, 0);
        for mut part in parts {
            if random.below(2) == 0 {
                part.reduce();
            }
            all.append(part);
        }
        let dense = dense.finish();
        for other in [some.finish(), all.finish()] {
            worst = worst.max(difference(&dense, &other, &vec![1.0; unknowns]));
        }
    }
    println!("largest difference: {worst:.1e}");
    assert!(worst < 1e-11, "{worst:e}");
}

/// Columns that are taken out of a factor leave that of rows without them: those at the end, in the middle, many and all.
#[test]
fn a_factor_without_unknowns_is_that_of_rows_without_columns() {
    let mut worst = 0.0_f64;
    for seed in 0..300 {
        let random = &mut Random::new(seed);
        let unknowns = 1 + random.below(12);
        let rows = unknowns + random.below(40);
        let problem = Linear::random(random, rows, unknowns);
        let one_of = 1 + random.below(4);
        let dropped: Vec<bool> = (0..unknowns).map(|_| random.below(one_of) == 0).collect();
        let kept: Vec<usize> = (0..unknowns).filter(|unknown| !dropped[*unknown]).collect();
        let mut rows = Accumulator::new(kept.len(), problem.rows.len());
        for (row, residual) in problem.rows.iter().zip(&problem.residuals) {
            rows.push(&kept.iter().map(|&unknown| row[unknown]).collect::<Vec<f64>>(), *residual, 1.0);
        }
        let (direct, found) = (rows.finish(), problem.factor(40).without_unknowns(|unknown| dropped[unknown]));
        if kept.is_empty() {
            assert!(found.unknowns() == 0 && close(found.cost(), direct.cost(), direct.cost()) < 1e-13);
            continue;
        }
        worst = worst.max(
            difference(&direct, &found, &vec![1.0; kept.len()])
                / direct.singular_values().condition(kept.len()).powi(2),
        );
    }
    println!("largest difference: {worst:.1e}");
    assert!(worst < 1e-13, "{worst:e}");
}

#[test]
fn zeros_in_a_factor_are_zeros_in_its_rows() {
    let random = &mut Random::new(11);
    let mut problem = Linear::random(random, 40, 6);
    let zero = [false, true, false, false, true, false];
    let factor = problem.factor(40).with_zeros(&zero);
    problem.scale_columns(&zero.map(|zero| if zero { 0.0 } else { 1.0 }));
    let direct = problem.factor(40);
    assert_eq!(factor.singular_values().rank(1e-12), 4);
    let same = |one: &[f64], other: &[f64]| {
        let size = norm(other);
        one.iter().zip(other).for_each(|(one, other)| assert!(close(*one, *other, size) < 1e-13, "{one} {other}"));
    };
    same(factor.norms(), direct.norms());
    same(&factor.singular_values().values()[..4], &direct.singular_values().values()[..4]);
    same(&factor.spectrum().step(4), &direct.spectrum().step(4));
    same(&[factor.cost()], &[direct.cost()]);
}

#[test]
fn a_factor_says_what_its_rows_say() {
    let mut worst = [0.0_f64; 6];
    for seed in 0..20 {
        let random = &mut Random::new(100 + seed);
        let n = 1 + random.below(8);
        let problem = Linear::random(random, 25 + 10 * n, n);
        let factor = problem.factor(3);
        let step = factor.step().expect("full rank");
        let (r, all): (&[f64], Vec<Vec<f64>>) = (&problem.residuals, (0..n).map(|k| problem.column(k)).collect());
        let after: Vec<f64> = problem.apply(&step).iter().zip(r).map(|(by, r)| r + by).collect();
        let mut note = |index: usize, value: f64| worst[index] = worst[index].max(value);
        note(0, close(factor.cost(), dot(r, r), dot(r, r)));
        note(1, close(factor.remaining_cost(), dot(&after, &after), dot(r, r)));
        for (column, length) in all.iter().zip(factor.norms()) {
            note(0, close(*length, norm(column), norm(column)));
            // The residuals that remain are at right angles to every column.
            note(2, dot(column, &after).abs() / norm(column) / norm(r));
        }
        // (J^T J)^-1 times J^T J, and the sum of all leverages, which is the number of unknowns.
        for (row, covariances) in of_full_rank(&factor).covariance().iter().enumerate() {
            for column in 0..n {
                let product: f64 = (0..n).map(|k| covariances[k] * dot(&all[k], &all[column])).sum();
                note(3, (product - f64::from(u8::from(row == column))).abs());
            }
        }
        note(4, (of_full_rank(&factor).leverages(&problem.rows.concat()).iter().sum::<f64>() - n as f64).abs());
        note(5, close(factor.row_norm(&step), norm(&problem.apply(&step)), norm(r)));
        let spectrum = factor.spectrum();
        for (full, of_spectrum) in step.iter().zip(spectrum.step(n)) {
            note(5, close(*full, of_spectrum, norm(&step)));
        }
        for (full, of_spectrum) in
            of_full_rank(&factor).covariance().concat().iter().zip(spectrum.covariance_root(n).covariance().concat())
        {
            note(5, close(*full, of_spectrum, norm(&of_full_rank(&factor).covariance().concat())));
        }
        let (full, of_spectrum) = (of_full_rank(&factor), spectrum.covariance_root(n));
        let rows = problem.rows.concat();
        for (full, of_spectrum) in full.leverages(&rows).iter().zip(of_spectrum.leverages(&rows)) {
            note(5, close(*full, of_spectrum, 1.0));
        }
        assert_eq!(factor.singular_values().values().len(), n);
        let values = factor.singular_values();
        for (a, b) in values.values().iter().zip(spectrum.singular_values().values()) {
            note(5, close(*a, *b, values.values()[0]));
        }
        // Columns of norm 1: the squares of their singular values add up to their number.
        note(5, close(dot(values.values(), values.values()), n as f64, n as f64));
    }
    println!("largest deviations: {}", worst.map(|value| format!("{value:.0e}")).join(" "));
    assert!(worst.iter().all(|&deviation| deviation < 1e-12), "{worst:?}");
}

#[test]
fn the_covariance_of_a_line_is_the_one_of_the_textbook() {
    let x: Vec<f64> = (0..25).map(|i| 3.0 + 0.7 * f64::from(i) + f64::from(i * i % 7)).collect();
    let y: Vec<f64> = x.iter().map(|x| 2.0 - 0.5 * x + (5.0 * x).sin()).collect();
    let factor = line(&x, &y).factor(4);
    let m = x.len() as f64;
    let (mean_x, mean_y) = (x.iter().sum::<f64>() / m, y.iter().sum::<f64>() / m);
    let sxx: f64 = x.iter().map(|x| (x - mean_x).powi(2)).sum();
    let sxy: f64 = x.iter().zip(&y).map(|(x, y)| (x - mean_x) * (y - mean_y)).sum();
    let slope = sxy / sxx;
    let step = factor.step().expect("full rank");
    assert!((step[1] - slope).abs() < 1e-13 && (step[0] - (mean_y - slope * mean_x)).abs() < 1e-12);
    let textbook = [[1.0 / m + mean_x * mean_x / sxx, -mean_x / sxx], [-mean_x / sxx, 1.0 / sxx]];
    for covariance in [of_full_rank(&factor).covariance(), factor.spectrum().covariance_root(2).covariance()] {
        for (row, expected) in covariance.iter().zip(&textbook) {
            for (value, expected) in row.iter().zip(expected) {
                assert!((value / expected - 1.0).abs() < 1e-12, "{value} {expected}");
            }
        }
    }
    let leverage = 1.0 / m + (x[3] - mean_x).powi(2) / sxx;
    assert!((of_full_rank(&factor).leverages(&[1.0, x[3]])[0] - leverage).abs() < 1e-13);
}

#[test]
fn a_weight_counts_as_often_as_its_square() {
    let random = &mut Random::new(1);
    let problem = Linear::random(random, 20, 3);
    let (mut weighted, mut repeated) = (Accumulator::new(3, 20), Accumulator::new(3, 20));
    for (index, (row, residual)) in problem.rows.iter().zip(&problem.residuals).enumerate() {
        let times = 1 + index % 3;
        weighted.push(row, *residual, (times as f64).sqrt());
        (0..times).for_each(|_| repeated.push(row, *residual, 1.0));
    }
    let (weighted, repeated) = (weighted.finish(), repeated.finish());
    let steps = weighted.step().into_iter().zip(repeated.step());
    for (a, b) in steps.flat_map(|(a, b)| a.into_iter().zip(b)) {
        assert!((a - b).abs() < 1e-13);
    }
    assert!((weighted.cost() - repeated.cost()).abs() < 1e-12);
}

#[test]
fn too_few_rows_are_a_singular_problem() {
    let random = &mut Random::new(2);
    let problem = Linear::random(random, 2, 5);
    let factor = problem.factor(1);
    assert_eq!((factor.rows(), factor.singular_values().rank(1e-12), factor.step()), (2, 2, None));
    assert!((factor.cost() - dot(&problem.residuals, &problem.residuals)).abs() < 1e-14);
    // What can be taken away is: two rows, and more unknowns than that.
    let step = factor.spectrum().step(2);
    for (by, residual) in problem.apply(&step).iter().zip(&problem.residuals) {
        assert!((by + residual).abs() < 1e-13);
    }
    let empty = Accumulator::new(3, 0).finish();
    assert_eq!((empty.rows(), empty.cost(), empty.singular_values().rank(1e-12)), (0, 0.0, 0));
}

/// Two ways to the same end: shift a known unknown and solve again for the others, or ask for their answer.
#[test]
fn the_answer_is_what_shifting_a_known_unknown_does() {
    let mut worst = 0.0_f64;
    for seed in 0..20 {
        let mut random = Random::new(900 + seed);
        let (own, others) = (2 + random.below(5), 1 + random.below(3));
        let problem = Linear::random(&mut random, 40, own + others);
        let factor = problem.factor(40);
        let reduced = |shift: Option<usize>| {
            let mut reduced = problem.clone();
            for (row, residual) in reduced.rows.iter_mut().zip(&mut reduced.residuals) {
                *residual += shift.map_or(0.0, |known| row[own + known]);
                row.truncate(own);
            }
            reduced.factor(40)
        };
        let step = |factor: Factor| factor.step().expect("full rank");
        let covariance_root = reduced(None).covariance_root(own);
        let (before, answers) = (step(reduced(None)), covariance_root.sensitivities(&factor));
        for known in 0..others {
            for ((after, before), answer) in step(reduced(Some(known))).iter().zip(&before).zip(&answers) {
                worst = worst.max((after - before - answer[known]).abs());
            }
        }
    }
    assert!(worst < 1e-12, "{worst}");
}

/// The covariance splits into what comes from each of several groups of rows.
#[test]
fn the_parts_of_all_rows_are_the_covariance() {
    for seed in 0..20 {
        let mut random = Random::new(1900 + seed);
        let count = 2 + random.below(5);
        let problem = Linear::random(&mut random, 40, count);
        let covariance_root = problem.factor(40).covariance_root(count);
        let group = |first: usize, last: usize| {
            let mut group = problem.clone();
            group.rows = problem.rows[first..last].to_vec();
            group.residuals = problem.residuals[first..last].to_vec();
            covariance_root.part(&group.factor(40))
        };
        let (one, other) = (group(0, 3), group(3, 40));
        for (row, line) in covariance_root.covariance().iter().enumerate() {
            for (column, whole) in line.iter().enumerate() {
                let size =
                    (covariance_root.covariance()[row][row] * covariance_root.covariance()[column][column]).sqrt();
                assert!((one[row][column] + other[row][column] - whole).abs() < 1e-11 * size, "{row} {column}");
            }
        }
    }
}
